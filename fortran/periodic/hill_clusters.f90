!> Exponents close to each other, computed together.
!!
!! Memory that hardly couples gives each spring an exponent of nearly the same size. Near m zeros
!! Hill's determinant D is so small that rounding moves each by the m-th root of its own size,
!! while their mean stays sharp. On a circle about them, lambda = c + r z, |z| = 1,
!!
!!   log(D/z^m) = a_0 + sum_k a_k z^k + sum_k b_k z^(-k),  b_k = -s_k/k,
!!   s_k = sum_i ((lambda_i - c)/r)^k
!!
!! if the circle holds m zeros and nothing else (it turns D by 2 pi m). Newton's identities give the
!! polynomial of the zeros. The a_k and b_k of high k are rounding errors. Zeros whose sums are
!! these are right as they were found. Of others those of the polynomial are taken, and where these
!! lie no further apart than the m-th root of that rounding says, all get their mean.
!! (Kravanja and Van Barel, Computing the Zeros of Analytic Functions, Springer 2000.)
module viscovib_hill_clusters
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_constants, only: pi
  use viscovib_hill, only: hill_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial_zeros, only: polynomial_zeros
  use viscovib_sorting, only: sort_falling
  implicit none
  private

  public :: sharpen_clusters

  !> Exponents nearer than this, in d, are side by side.
  real(wp), parameter :: near = 1.0e-4_wp
  !> Values on a circle, those above the line of symmetry; zeros at most that its turns show.
  integer, parameter :: half = 12, most = 6
  !> Circles tried, each twice as wide, from this many times the distance of the outermost zero, and
  !! the least radius in d: within it D itself is lost.
  integer, parameter :: n_circles = 6
  real(wp), parameter :: wider = 8.0_wp, least = 2.0e-5_wp
  !> Numbers are distinct beyond this multiple of their rounding error.
  real(wp), parameter :: sure = 8.0_wp

contains

  !> Each group of exponents on the line of symmetry, or about it, that lie side by side, made
  !! sharp. Others, and groups that no circle holds alone, are left as they are.
  subroutine sharpen_clusters(hill, system, exponents)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> Largest real part first, NaN behind the last; again so on exit.
    complex(wp), intent(inout) :: exponents(:)
    complex(wp), allocatable :: zeros(:)
    logical :: taken(size(exponents)), group(size(exponents))
    complex(wp) :: whole
    integer :: i, n, grown

    whole = cmplx(0.0_wp, hill%period, wp)
    n = count(.not. ieee_is_nan(real(exponents)))
    taken = ieee_is_nan(real(exponents))
    ! Both of a pair about the line Im lambda = d/2 on that line's two sides.
    where (aimag(exponents(:n)) < -0.25_wp*hill%period) exponents(:n) = exponents(:n) + whole
    do i = 1, n
      if (taken(i)) cycle
      group = .false.
      group(i) = .true.
      do
        grown = count(group)
        call spread_out(exponents, taken, near*hill%period, group)
        if (count(group) == grown) exit
      end do
      taken = taken .or. group
      if (grown < 2 .or. grown > most) cycle
      zeros = pack(exponents, group)
      call sharpen(hill, system, zeros)
      exponents = unpack(zeros, group, exponents)
    end do
    where (aimag(exponents(:n)) > 0.5_wp*hill%period) exponents(:n) = exponents(:n) - whole
    call sort_falling(exponents(:n), real(exponents(:n)))
  end subroutine sharpen_clusters

  !> A group contains zeros that are near one of its members.
  pure subroutine spread_out(exponents, taken, distance, group)
    complex(wp), intent(in) :: exponents(:)
    logical, intent(in) :: taken(:)
    real(wp), intent(in) :: distance
    logical, intent(inout) :: group(:)
    integer :: i, k

    do k = 1, size(exponents)
      if (taken(k)) cycle
      do i = 1, size(exponents)
        ! What is no number is in no group.
        if (.not. group(i)) cycle
        if (abs(exponents(i) - exponents(k)) < distance) group(k) = .true.
      end do
    end do
  end subroutine spread_out

  !> The zeros of one group.
  subroutine sharpen(hill, system, zeros)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(inout) :: zeros(:)
    complex(wp) :: found(size(zeros)), better(size(zeros))
    real(wp) :: centre, radius, line, lost, smallest
    integer :: i
    logical :: made, confirmed, upper

    line = merge(0.5_wp, 0.0_wp, any(abs(aimag(zeros)) > 0.25_wp*hill%period))*hill%period
    ! About the line, with the conjugate of each: only then D is real along it.
    upper = line > 0.0_wp
    if (abs(sum(aimag(zeros))/size(zeros) - line) > 1.0e-9_wp*hill%period) return
    centre = sum(real(zeros))/size(zeros)
    radius = max(least*hill%period, wider*maxval(abs(zeros - cmplx(centre, line, wp))))
    smallest = huge(smallest)
    better = zeros
    do i = 1, n_circles
      ! What lies on both sides of the axis stays as it was counted.
      if (abs(centre) <= radius) exit
      found = zeros
      call on_circle(hill, system, cmplx(centre, line, wp), radius, upper, found, lost, made, &
                     confirmed)
      if (.not. made) exit
      if (confirmed) return
      if (lost < smallest) then
        smallest = lost
        better = found
      end if
      radius = 2.0_wp*radius
    end do
    zeros = better
  end subroutine sharpen

  !> The zeros in a circle from what was found of them, and how far their mean may be off; not made
  !! where they are not alone.
  subroutine on_circle(hill, system, centre, radius, upper, zeros, lost, made, confirmed)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: centre
    real(wp), intent(in) :: radius
    logical, intent(in) :: upper
    complex(wp), intent(inout) :: zeros(:)
    real(wp), intent(out) :: lost
    logical, intent(out) :: made
    !> Whether they are right as they were found.
    logical, intent(out) :: confirmed
    complex(wp) :: z(half), value(half), logarithm(half)
    real(wp) :: sums(size(zeros)), given(size(zeros)), floor, mean
    integer :: j, k, m

    m = size(zeros)
    made = .false.
    confirmed = .false.
    lost = huge(lost)
    do j = 1, half
      z(j) = exp(cmplx(0.0_wp, pi*(j - 0.5_wp)/half, wp))
      call hill%determinant(system, centre + radius*z(j), value(j), about_half=upper)
      if (.not. (abs(value(j)) <= huge(1.0_wp) .and. abs(value(j)) > 0.0_wp)) return
    end do
    ! D/z^m turns by nothing from the real axis on one side to that on the other.
    value = value/z**m
    logarithm(1) = log(value(1))
    if (abs(aimag(logarithm(1))) > 0.5_wp*pi) then
      value = -value
      logarithm(1) = log(value(1))
    end if
    do j = 2, half
      logarithm(j) = logarithm(j - 1) + log(value(j)/value(j - 1))
    end do
    if (abs(aimag(logarithm(half))) > 0.5_wp*pi) return
    sums = [(-k*moment(-k), k=1, m)]
    floor = maxval([(abs(moment(k)), abs(moment(-k)), k=2*half/3, half - 1)])
    if (.not. floor < 0.1_wp) return
    lost = floor*radius
    given = [(real(sum(((zeros - centre)/radius)**k)), k=1, m)]
    confirmed = all(abs(given - sums) <= sure*floor*[(k, k=1, m)])
    made = confirmed
    if (made) return
    mean = sums(1)/m
    call from_sums(sums, zeros, made)
    if (.not. made) return
    if (maxval(abs(zeros - mean)) < sure*floor**(1.0_wp/m)) zeros = mean
    made = maxval(abs(zeros)) < 0.5_wp
    zeros = centre + radius*zeros

  contains

    !> The coefficient of z^k; values below the line are conjugates.
    pure real(wp) function moment(k)
      integer, intent(in) :: k
      moment = sum(real(logarithm*conjg(z)**k))/half
    end function moment

  end subroutine on_circle

  !> Zeros of a real polynomial from the sums of their powers.
  subroutine from_sums(sums, zeros, made)
    real(wp), intent(in) :: sums(:)
    complex(wp), intent(out) :: zeros(:)
    logical, intent(out) :: made
    real(wp) :: c(0:size(sums))
    integer :: k

    c(0) = 1.0_wp
    do k = 1, size(sums)
      c(k) = -dot_product(c(k - 1:0:-1), sums(:k))/k
    end do
    call polynomial_zeros(c, zeros, made)
  end subroutine from_sums

end module viscovib_hill_clusters
