! Optimize: -O2
!> Panels of a motion in time, whose points give what forces remember (see `recalled_along`).
module viscovib_motion_panels
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_kinds, only: i8, wp
  use viscovib_mesh, only: mesh_type, new_mesh
  use viscovib_motion_balance, only: panel_points
  use viscovib_quadrature, only: lagrange, lagrange_factors
  implicit none
  private

  public :: add_past, panel_ends, panel_rows, panel_times, states_on_panels

  !> Panels of each straight line of the motion before t = 0.
  integer, parameter :: n_of_past = 4
  !> Equal parts of a panel at whose ends states give its polynomial. With more parts the polynomial
  !! amplifies rounding errors.
  integer, parameter :: fewest_parts = panel_points/2, most_parts = panel_points

contains

  !> Ends of panels from 0 to `until`: the ends of steps, as in `new_mesh`, or equal steps h.
  function panel_ends(h, until, step_ends, made_by) result(ends)
    real(wp), intent(in) :: h, until
    real(wp), intent(in), optional :: step_ends(:)
    integer(i8), intent(in), optional :: made_by(:)
    real(wp), allocatable :: ends(:)
    type(mesh_type) :: mesh
    integer(i8) :: i, n

    if (present(step_ends)) then
      call new_mesh(mesh, h, step_ends, made_by)
      n = made_by(size(made_by))
      ends = [(mesh%start_of(i), i=0, n)]
      ends = [pack(ends, ends < until*(1.0_wp - 1.0e-14_wp)), until]
    else
      n = max(1_i8, ceiling(until/h*(1.0_wp - 1.0e-12_wp), i8))
      ends = [(i*h, i=0, n - 1), until]
    end if
  end function panel_ends

  !> Times at the points of panels, each once.
  function panel_times(ends) result(times)
    real(wp), intent(in) :: ends(0:)
    real(wp) :: times((size(ends) - 1)*(panel_points + 1) + 1)
    type(collocation_type) :: table
    integer :: i, k

    call new_collocation(table, panel_points)
    k = panel_points + 1
    do i = 1, size(ends) - 1
      times((i - 1)*k + 1:i*k) = ends(i - 1) + (ends(i) - ends(i - 1))*table%points(:panel_points)
    end do
    times(size(times)) = ends(size(ends) - 1)
  end function panel_times

  !> Index among these times of each point of each of n panels.
  pure function panel_rows(n) result(rows)
    integer, intent(in) :: n
    integer :: rows(n*(panel_points + 2))
    integer :: i, j
    rows = [([(i*(panel_points + 1) + j, j=1, panel_points + 2)], i=0, n - 1)]
  end function panel_rows

  !> States at the points of panels, each once, from states at the ends of equal parts of each
  !! panel, by the polynomial with their values and slopes. Not allocated: there are no such parts.
  subroutine states_on_panels(ends, t, states, found)
    real(wp), intent(in) :: ends(0:)
    !> Times, shape (m); states (u, u') of each coordinate, shape (2 n, m).
    real(wp), intent(in) :: t(:), states(:, :)
    !> Shape (2 n, size(panel_times)).
    real(wp), allocatable, intent(out) :: found(:, :)
    real(wp) :: h, to_u(0:most_parts, 2, panel_points), to_rate(0:most_parts, 2, panel_points)
    integer :: i, k, p, parts, stride

    stride = (size(t) - 1)/(size(ends) - 1)
    parts = most_parts
    do while (mod(stride, parts) /= 0)
      parts = parts - 1
    end do
    if (stride == 0 .or. size(t) /= stride*(size(ends) - 1) + 1 .or. parts < fewest_parts) return
    do i = 1, size(t) - 1
      p = (i - 1)/stride
      h = (ends(p + 1) - ends(p))*mod(i - 1, stride)/stride
      if (abs(t(i) - ends(p) - h) > 1.0e-13_wp*ends(size(ends) - 1)) return
    end do
    call from_parts(parts, to_u, to_rate)
    k = panel_points + 1
    allocate (found(size(states, 1), size(panel_times(ends))))
    do i = 1, size(ends) - 1
      h = ends(i) - ends(i - 1)
      found(:, (i - 1)*k + 1) = states(:, (i - 1)*stride + 1)
      associate (u => states(1::2, (i - 1)*stride + 1:i*stride + 1:stride/parts), &
                 rate => h*states(2::2, (i - 1)*stride + 1:i*stride + 1:stride/parts), &
                 now => found(:, (i - 1)*k + 2:i*k))
        now(1::2, :) = matmul(u, to_u(:parts, 1, :)) + matmul(rate, to_u(:parts, 2, :))
        now(2::2, :) = (matmul(u, to_rate(:parts, 1, :)) + matmul(rate, to_rate(:parts, 2, :)))/h
      end associate
    end do
    found(:, size(found, 2)) = states(:, size(t))
  end subroutine states_on_panels

  !> Weights of the values and slopes at the ends of equal parts of [0, 1] in the polynomial with
  !! these at the points between 0 and 1, and in its slope there (Hermite).
  pure subroutine from_parts(parts, to_u, to_rate)
    integer, intent(in) :: parts
    real(wp), intent(out) :: to_u(0:, :, :), to_rate(0:, :, :)
    type(collocation_type) :: table
    real(wp), dimension(0:parts) :: x, bend, weight, slope, off
    integer :: i, j

    call new_collocation(table, panel_points)
    x = [(real(j, wp)/parts, j=0, parts)]
    do j = 0, parts
      bend(j) = sum([1.0_wp/(x(j) - x(:j - 1)), 1.0_wp/(x(j) - x(j + 1:))])
    end do
    do i = 1, panel_points
      off = table%points(i) - x
      weight = lagrange(x, lagrange_factors(x), table%points(i))
      slope = weight*(sum(1.0_wp/off) - 1.0_wp/off)
      to_u(:parts, 1, i) = (1.0_wp - 2.0_wp*bend*off)*weight**2
      to_u(:parts, 2, i) = off*weight**2
      to_rate(:parts, 1, i) = 2.0_wp*weight*((1.0_wp - 2.0_wp*bend*off)*slope - bend*weight)
      to_rate(:parts, 2, i) = weight*(weight + 2.0_wp*off*slope)
    end do
  end subroutine from_parts

  !> Add the panels of a motion before t = 0 along straight lines.
  subroutine add_past(before, moved, ends, u, rate)
    !> Times, ascending to 0, shape (m), and displacements at them, shape (n_dof, m).
    real(wp), intent(in) :: before(:), moved(:, :)
    !> As of `recalled_along`.
    real(wp), allocatable, intent(inout) :: ends(:), u(:, :), rate(:, :)
    type(collocation_type) :: table
    real(wp), allocatable :: old(:, :), speed(:, :), at(:)
    integer :: d, i, k, line

    k = panel_points + 2
    call new_collocation(table, panel_points)
    allocate (at(n_of_past*(size(before) - 1)))
    allocate (old(size(at)*k + size(u, 1), size(u, 2)), speed(size(at)*k + size(u, 1), size(u, 2)))
    do i = 1, size(at)
      line = (i - 1)/n_of_past + 1
      associate (h => before(line + 1) - before(line), begin => (i - 1)*k)
        at(i) = before(line) + h*mod(i - 1, n_of_past)/n_of_past
        do d = 1, size(u, 2)
          speed(begin + 1:begin + k, d) = (moved(d, line + 1) - moved(d, line))/h
          old(begin + 1:begin + k, d) = moved(d, line) + speed(begin + 1, d) &
                                        *(at(i) - before(line) + h/n_of_past*table%points)
        end do
      end associate
    end do
    old(size(at)*k + 1:, :) = u
    speed(size(at)*k + 1:, :) = rate
    ends = [at, ends]
    call move_alloc(old, u)
    call move_alloc(speed, rate)
  end subroutine add_past

end module viscovib_motion_panels
