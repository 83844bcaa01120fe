!> Errors of special points along a branch of motions of a driven system: branch points, and changes
!! of stability. Both are located again with more shells of orders.
module viscovib_orbit_errors
  use viscovib_crossing_errors, only: branch_point_error, exponent_error
  use viscovib_kinds, only: wp
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_stability, only: orbit_spectrum
  use viscovib_status, only: set_ok, status_type
  use viscovib_stopping, only: given_up
  use viscovib_torus_orders, only: torus_ladder
  implicit none
  private

  public :: find_branch_errors, find_crossing_errors, checking_twice

contains

  !> Number of additional shells for the errors of locations: for one axis as many as the bound,
  !! since the next omitted orders may cancel each other.
  pure integer function checking_twice(n_axes, shells, bound, most) result(step)
    !> Number of shells that check motions, the bound, and its largest value.
    integer, intent(in) :: n_axes, shells, bound, most
    step = shells
    if (n_axes == 1) step = max(shells, min(bound, most - bound)/shells*shells)
  end function checking_twice

  !> Errors of branch points.
  subroutine find_branch_errors(ladder, p, x, at_p, at_x, before, error, status, cancel)
    !> The branch is one of its last rung.
    type(torus_ladder), intent(inout) :: ladder
    !> Points of the branch, and locations, with all unknowns: shapes (n), (torus%n n_dof, n).
    real(wp), intent(in) :: p(:), x(:, :), at_p(:), at_x(:, :)
    !> Index of the point before each location, from 1.
    integer, intent(in) :: before(:)
    !> Errors in the unit of p, shape (size(at_p)).
    real(wp), intent(out) :: error(:)
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    real(wp), allocatable :: ends(:, :)
    integer :: first, i

    error = 0.0_wp
    call set_ok(status)
    if (size(at_p) == 0 .or. size(p) < 2) return
    call make_ready(ladder, status)
    if (status%failed()) return
    associate (balance => ladder%rungs(ladder%last + ladder%step)%balance)
      do i = 1, size(at_p)
        if (given_up(cancel)) return
        call neighbours(ladder, x, before(i), first, ends)
        call branch_point_error(balance, p(first:first + 1), ends, at_p(i), &
                                ladder%lifted(at_x(:, i)), error(i), cancel)
      end do
    end associate
  end subroutine find_branch_errors

  !> Errors of locations where multipliers cross the unit circle, for one axis.
  subroutine find_crossing_errors(ladder, p, x, at_p, at_x, before, turn, error, status, cancel)
    type(torus_ladder), intent(inout) :: ladder
    !> As above.
    real(wp), intent(in) :: p(:), x(:, :), at_p(:), at_x(:, :)
    integer, intent(in) :: before(:)
    !> Argument of the multiplier that crosses.
    real(wp), intent(in) :: turn(:)
    !> In the unit of p; computed where it is < 0.
    real(wp), intent(inout) :: error(:)
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    type(orbit_floquet_type), target :: floquet
    type(orbit_spectrum) :: spectrum
    real(wp), allocatable :: ends(:, :)
    integer :: first, i

    call set_ok(status)
    if (.not. any(error < 0.0_wp)) return
    call make_ready(ladder, status)
    if (status%failed()) return
    associate (balance => ladder%rungs(ladder%last + ladder%step)%balance)
      spectrum%floquet => floquet
      spectrum%n = 2*balance%system%n_dof
      do i = 1, size(at_p)
        if (given_up(cancel)) return
        if (.not. error(i) < 0.0_wp) cycle
        call neighbours(ladder, x, before(i), first, ends)
        call exponent_error(balance, spectrum, p(first:first + 1), ends, at_p(i), &
                            ladder%lifted(at_x(:, i)), cmplx(0.0_wp, turn(i), wp), error(i), &
                            cancel)
      end do
    end associate
  end subroutine find_crossing_errors

  subroutine make_ready(ladder, status)
    type(torus_ladder), intent(inout) :: ladder
    type(status_type), intent(out) :: status
    call ladder%prepare(ladder%last, status)
    if (.not. status%failed()) call ladder%prepare(ladder%last + ladder%step, status)
  end subroutine make_ready

  !> The points of the branch near a location, in the unknowns of more shells.
  subroutine neighbours(ladder, x, before, first, ends)
    type(torus_ladder), intent(in) :: ladder
    real(wp), intent(in) :: x(:, :)
    integer, intent(in) :: before
    integer, intent(out) :: first
    !> Shape (balance%n, 2).
    real(wp), allocatable, intent(out) :: ends(:, :)

    first = max(1, min(before, size(x, 2) - 1))
    associate (one => ladder%lifted(x(:, first)), other => ladder%lifted(x(:, first + 1)))
      allocate (ends(size(one), 2))
      ends(:, 1) = one
      ends(:, 2) = other
    end associate
  end subroutine neighbours

end module viscovib_orbit_errors
