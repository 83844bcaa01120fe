! Optimize: -O3
!> The motion inside a step: the polynomial through its states at both ends and at the nodes.
module viscovib_step_path
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: lagrange, lagrange_factors
  implicit none
  private

  public :: step_path, new_path

  type :: step_path
    !> Start and length of the step.
    real(wp) :: start = 0.0_wp, h = 0.0_wp
    !> Positions in [0, 1] of known states, ascending, including both ends, shape (n);
    !! states there, shape (n, n_dof).
    real(wp), allocatable :: points(:), q(:, :), v(:, :)
    !> Change of velocities by forces that cancel; rounding errors are relative to it.
    real(wp) :: cancelled = 0.0_wp
    real(wp), allocatable, private :: factors(:)
  contains
    procedure :: at
    procedure :: acceleration_at
  end type step_path

contains

  subroutine new_path(path, points)
    type(step_path), intent(inout) :: path
    real(wp), intent(in) :: points(:)
    path%points = points
    path%factors = lagrange_factors(points)
  end subroutine new_path

  !> States at some positions in the step.
  subroutine at(self, x, t, q, v)
    class(step_path), intent(in) :: self
    real(wp), intent(in) :: x(:)
    !> Shapes (n) and (n, n_dof).
    real(wp), intent(out) :: t(:), q(:, :), v(:, :)
    real(wp) :: basis(size(self%points))
    integer :: i
    t = self%start + self%h*x
    do i = 1, size(x)
      basis = lagrange(self%points, self%factors, x(i))
      q(i, :) = matmul(basis, self%q)
      v(i, :) = matmul(basis, self%v)
    end do
  end subroutine at

  !> Accelerations at a position, by a difference quotient of velocities.
  function acceleration_at(self, x) result(a)
    class(step_path), intent(in) :: self
    real(wp), intent(in) :: x
    real(wp) :: a(size(self%v, 2))
    real(wp), parameter :: nearby = 1.0e-4_wp
    real(wp) :: places(2)
    places = min(max([x - nearby, x + nearby], 0.0_wp), 1.0_wp)
    a = matmul(lagrange(self%points, self%factors, places(2)) &
               - lagrange(self%points, self%factors, places(1)), self%v) &
        /((places(2) - places(1))*self%h)
  end function acceleration_at

end module viscovib_step_path
