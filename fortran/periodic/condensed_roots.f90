!> Exponents of a motion of a condensed structure: zeros of F, Hill's determinant with poles of the
!! rest multiplied out, by the secant method.
!!
!! Zeros found before are divided out, with their conjugates, so that each start leads to another.
!! It starts from exponents of a motion nearby, or from exponents of the system with its mean
!! stiffness along the motion, which are sought from the poles.
module viscovib_condensed_roots
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_condensed_hill, only: condensed_hill
  use viscovib_condensed_poles, only: gap, into_strip
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: exponent_near, find_from, find_from_poles, find_on_grid

  integer, parameter :: max_iterations = 30, max_mean_iterations = 10
  !> In units of d: range of Re lambda, longest step, last step wanted and least, distance from a
  !! line of symmetry that counts as on it, how far zeros are from a start, of the mean system and
  !! of the motion, at most.
  real(wp), parameter :: leftmost = -1.5_wp, rightmost = 45.0_wp, longest = 0.2_wp
  real(wp), parameter :: last_step = 1.0e-7_wp, smallest_step = 1.0e-12_wp
  real(wp), parameter :: on_line = 1.0e-8_wp, first_step = 1.0e-4_wp
  !> The grid of starts: real parts in units of d, and imaginary ones over [0, 1/2].
  real(wp), parameter :: grid_re(4) = [0.05_wp, 1.0e-3_wp, 0.3_wp, 1.0e-6_wp]
  integer, parameter :: grid_im = 4

contains

  !> Zeros from exponents nearby.
  subroutine find_from(hill, system, near, zeros)
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    !> NaN is passed over, and so are those below the real axis.
    complex(wp), intent(in) :: near(:)
    !> Those found, with their conjugates.
    complex(wp), allocatable, intent(inout) :: zeros(:)
    complex(wp) :: root
    integer :: i
    logical :: made

    do i = 1, size(near)
      if (ieee_is_nan(real(near(i))) .or. aimag(near(i)) < 0.0_wp) cycle
      if (size(zeros) >= hill%poles%n_multiplied .and. .not. hill%remembers) return
      call secant(hill, system, zeros, near(i), root, made)
      if (made) call append(hill, root, zeros)
    end do
  end subroutine find_from

  !> Zeros from the poles, as the mean stiffness moves them.
  subroutine find_from_poles(hill, system, zeros)
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    complex(wp), allocatable, intent(inout) :: zeros(:)
    complex(wp) :: start
    integer :: i

    ! The last ones are those that move least, and were perhaps let be at a motion nearby.
    do i = size(hill%poles%starts), 1, -1
      if (size(zeros) >= hill%poles%n_multiplied) return
      call mean_exponent(hill, system, hill%poles%starts(i), start)
      if (hill%stride == 2) start = start - cmplx(0.0_wp, hill%nu, wp)
      start = into_strip(start, hill%period)
      call find_from(hill, system, [cmplx(real(start), abs(aimag(start)), wp)], zeros)
    end do
  end subroutine find_from_poles

  !> Zeros that are left, from where memory alone relaxes, and right of the line from a grid, until
  !! as many as counted are found there.
  subroutine find_on_grid(hill, system, counted, zeros)
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    integer, intent(in) :: counted
    complex(wp), allocatable, intent(inout) :: zeros(:)
    complex(wp) :: root
    integer :: i, j
    logical :: made

    do i = 1, size(grid_re)
      do j = 0, grid_im
        if (count(real(zeros) > hill%line) >= counted) return
        call secant(hill, system, zeros, hill%period*cmplx(grid_re(i), 0.5_wp*j/grid_im, wp), &
                    root, made)
        if (made) call append(hill, root, zeros)
      end do
    end do
  end subroutine find_on_grid

  !> One exponent from the place it had at a motion nearby.
  subroutine exponent_near(hill, system, start, exponent, made)
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: start
    complex(wp), intent(out) :: exponent
    logical, intent(out) :: made
    complex(wp) :: none(0)
    made = .false.
    exponent = start
    if (hill%ready) call secant(hill, system, none, start, exponent, made)
  end subroutine exponent_near

  subroutine append(hill, root, zeros)
    type(condensed_hill), intent(in) :: hill
    complex(wp), intent(in) :: root
    complex(wp), allocatable, intent(inout) :: zeros(:)
    zeros = [zeros, root]
    if (aimag(root) > 0.0_wp .and. aimag(root) < 0.5_wp*hill%period) zeros = [zeros, conjg(root)]
  end subroutine append

  !> An exponent of the system with its mean stiffness, near a pole of the rest.
  subroutine mean_exponent(hill, system, pole, root)
    type(condensed_hill), intent(in) :: hill
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: pole
    complex(wp), intent(out) :: root
    complex(wp) :: before, value_before, value, step
    integer :: i

    before = pole + 1.0e-3_wp*hill%period*(1.0_wp, 1.0_wp)
    root = pole + 1.0e-4_wp*hill%period*(0.1_wp, 1.0_wp)
    call reduced(before, value_before)
    do i = 1, max_mean_iterations
      call reduced(root, value)
      if (.not. abs(value - value_before) > 0.0_wp) exit
      step = -value*((root - before)/(value - value_before))
      if (abs(step) > hill%period) step = hill%period*step/abs(step)
      before = root
      value_before = value
      root = root + step
      if (abs(step) <= first_step*hill%period) exit
    end do
    if (.not. abs(root - pole) <= 4.0_wp*hill%period) root = pole

  contains

    subroutine reduced(s, value)
      complex(wp), intent(in) :: s
      complex(wp), intent(out) :: value
      call hill%average(system, s, value)
      value = value*(s - pole)
    end subroutine reduced

  end subroutine mean_exponent

  !> A zero with 0 <= Im lambda <= d/2, those known divided out.
  subroutine secant(hill, system, known, start, root, made)
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: known(:), start
    complex(wp), intent(out) :: root
    logical, intent(out) :: made
    complex(wp) :: before, value_before, value, step
    real(wp) :: last, earlier, error
    integer :: i
    logical :: about_half

    made = .false.
    ! All the way with the same orders: with others F has another scale.
    about_half = abs(aimag(start)) > 0.25_wp*hill%period
    last = huge(last)
    earlier = huge(earlier)
    ! Off the real axis, or it would never be left.
    before = start + first_step*hill%period*(1.0_wp, 1.0_wp)
    root = start
    call reduced(before, value_before)
    do i = 1, max_iterations
      call reduced(root, value)
      if (.not. abs(value) <= huge(1.0_wp)) return
      if (.not. abs(value - value_before) > 0.0_wp) exit
      step = -value*((root - before)/(value - value_before))
      if (.not. abs(step) <= huge(1.0_wp)) return
      if (abs(step) > longest*hill%period) step = step*(longest*hill%period/abs(step))
      before = root
      value_before = value
      root = root + step
      if (real(root) < leftmost*hill%period .or. real(root) > rightmost*hill%period) return
      ! Steps go with the product of the two before: what the next one would be.
      error = abs(step)
      if (i > 2 .and. error < last .and. last < earlier) error = error*(error/earlier)
      made = error <= smallest_step*hill%period &
             .or. (abs(step) <= last_step*hill%period .and. abs(step) >= last)
      if (made) exit
      earlier = last
      last = abs(step)
    end do
    if (.not. made) return
    root = into_strip(root, hill%period)
    root = cmplx(real(root), abs(aimag(root)), wp)
    if (aimag(root) < on_line*hill%period) root = real(root)
    if (aimag(root) > (0.5_wp - on_line)*hill%period) then
      root = cmplx(real(root), 0.5_wp*hill%period, wp)
    end if

  contains

    subroutine reduced(lambda, value)
      complex(wp), intent(in) :: lambda
      complex(wp), intent(out) :: value
      complex(wp) :: factor
      integer :: k

      call hill%determinant(system, lambda, value, about_half)
      do k = 1, size(known)
        factor = gap(2.0_wp*pi/hill%period*(known(k) - lambda))
        if (abs(factor) > 0.0_wp) value = value/factor
      end do
    end subroutine reduced

  end subroutine secant

end module viscovib_condensed_roots
