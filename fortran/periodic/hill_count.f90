!> Exponents of a periodic solution that grow, counted by the argument principle.
!!
!! Hill's determinant D has no poles right of the imaginary axis, is periodic along
!! it, real at 0 and at half the period i d, and does not wind at large Re lambda.
!! Around the half strip |Im lambda| <= d/2, Re lambda >= 0, the sides along which it
!! is periodic cancel, and
!!
!!   number of zeros = -[arg D(i d/2) - arg D(0)]/pi.
!!
!! Zeros that are known are divided out, D/(1 - exp(2 pi (lambda_k - lambda)/d)), which has all
!! of these properties: what is left turns slowly, also where zeros lie next to the axis. Those
!! with positive real part count on their own; were one of them no zero, it would count as a
!! pole of what is left, so that the sum is right whatever is thought to be known.
module viscovib_hill_count
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_constants, only: pi
  use viscovib_hill, only: hill_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: count_growing

  !> The argument between neighbours of a node may turn by this at most, and the
  !! logarithm of the modulus change by that, so that no whole turn is missed.
  real(wp), parameter :: largest_turn = 0.9_wp, largest_ratio = 1.3_wp
  !> Pairs of intervals at first, determinants at most, halvings at most.
  integer, parameter :: most_pairs = 4, max_evaluations = 1000, max_depth = 44
  !> A count must be this near to an integer.
  real(wp), parameter :: margin = 0.2_wp
  !> Real parts that count as 0, in d.
  real(wp), parameter :: on_axis = 1.0e-13_wp
  !> Where a kernel has no integral: a small circle around the branch point, in d.
  real(wp), parameter :: radius = 1.0e-12_wp
  integer, parameter :: n_arc = 8

contains

  !> Exponents with positive real part in the strip |Im lambda| <= d/2; -1: unknown.
  subroutine count_growing(hill, system, known, n_growing, evaluations)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> Exponents found, both of conjugate pairs; NaN is passed over.
    complex(wp), intent(in) :: known(:)
    integer, intent(out) :: n_growing
    !> Determinants that it took.
    integer, intent(out) :: evaluations
    complex(wp) :: left, middle, right, stack(2, max_depth), before
    real(wp) :: total, low, high, here, next, ends(max_depth), counted
    complex(wp), allocatable :: there(:)
    integer :: depths(max_depth), depth, top, n_pairs, i
    logical :: singular

    n_growing = -1
    evaluations = 0
    if (.not. hill%ready) return
    there = pack(known,.not. ieee_is_nan(real(known)))
    ! On the axis to rounding: who could tell.
    if (any(abs(real(there)) <= on_axis*hill%period)) return
    ! With zeros divided out half of them will do.
    n_pairs = merge(most_pairs/2, most_pairs, size(there) > 0)
    total = 0.0_wp
    low = 0.0_wp
    high = 0.5_wp*hill%period
    singular = system%kernel_without_integral() /= 0
    if (singular) then
      if (hill%stride == 1) then
        low = radius*hill%period
        call around((0.0_wp, 0.0_wp), 0.0_wp)
      else
        high = high - radius*hill%period
        call around(cmplx(0.0_wp, 0.5_wp*hill%period, wp), -0.5_wp*pi)
      end if
    end if
    call value_at(cmplx(0.0_wp, low, wp), left)
    here = low
    do i = n_pairs, 1, -1
      ! The stack holds ends of intervals still to be passed, the nearest on top.
      ends(n_pairs + 1 - i) = low + (high - low)*i/n_pairs
      depths(n_pairs + 1 - i) = 0
    end do
    top = n_pairs
    do i = 1, n_pairs
      call value_at(cmplx(0.0_wp, ends(i), wp), stack(1, i))
      call value_at(cmplx(0.0_wp, ends(i) - 0.5_wp*(high - low)/n_pairs, wp), stack(2, i))
    end do
    do while (top > 0)
      next = ends(top)
      depth = depths(top)
      right = stack(1, top)
      middle = stack(2, top)
      if (.not. abs(left)*abs(middle)*abs(right) > 0.0_wp) return
      if (safe(left, middle) .and. safe(middle, right)) then
        total = total + turn(left, middle) + turn(middle, right)
        left = right
        here = next
        top = top - 1
      else
        if (depth >= max_depth - n_pairs .or. evaluations > max_evaluations) return
        call value_at(cmplx(0.0_wp, here + 0.75_wp*(next - here), wp), stack(2, top))
        depths(top:top + 1) = depth + 1
        ends(top + 1) = 0.5_wp*(here + next)
        stack(1, top + 1) = middle
        call value_at(cmplx(0.0_wp, here + 0.25_wp*(next - here), wp), stack(2, top + 1))
        top = top + 1
      end if
    end do
    counted = -(total + hill%tail(high) - hill%tail(low))/pi
    if (.not. abs(counted - nint(counted)) <= margin) return
    i = nint(counted) + count(real(there) > 0.0_wp)
    if (i >= 0) n_growing = i

  contains

    subroutine value_at(lambda, value)
      complex(wp), intent(in) :: lambda
      complex(wp), intent(out) :: value
      call hill%determinant(system, lambda, value)
      value = value/product(1.0_wp - exp(2.0_wp*pi/hill%period*(there - lambda)))
      evaluations = evaluations + 1
    end subroutine value_at

    !> A quarter of the small circle, counterclockwise from an angle.
    subroutine around(centre, from)
      complex(wp), intent(in) :: centre
      real(wp), intent(in) :: from
      complex(wp) :: value
      real(wp) :: angle
      integer :: k
      do k = 0, n_arc
        angle = from + 0.5_wp*pi*k/n_arc
        call value_at(centre + radius*hill%period*cmplx(cos(angle), sin(angle), wp), value)
        if (k > 0) total = total + turn(before, value)
        before = value
      end do
    end subroutine around

  end subroutine count_growing

  elemental real(wp) function turn(from, to)
    complex(wp), intent(in) :: from, to
    complex(wp) :: z
    z = to*conjg(from)
    turn = atan2(aimag(z), real(z))
  end function turn

  elemental logical function safe(from, to)
    complex(wp), intent(in) :: from, to
    safe = abs(turn(from, to)) <= largest_turn &
           .and. abs(log(abs(to)/abs(from))) <= largest_ratio
  end function safe

end module viscovib_hill_count
