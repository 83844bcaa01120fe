!> A system together with a small perturbation of its solution: the variational equation, in
!! coordinates (q, dq).
module viscovib_tangent_system
  use viscovib_driven_system, only: differentiable_system_type, driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: tangent_system_type, new_tangent_system

  type, extends(driven_system_type) :: tangent_system_type
    class(differentiable_system_type), allocatable :: base
  contains
    procedure :: acceleration
    procedure :: margin
  end type tangent_system_type

contains

  subroutine new_tangent_system(system, base)
    type(tangent_system_type), intent(out) :: system
    class(differentiable_system_type), intent(in) :: base
    allocate (system%base, source=base)
    system%n_dof = 2*base%n_dof
    system%drives = base%drives
    if (allocated(base%quarters)) system%quarters = base%quarters
    system%limited = base%limited
    system%range = base%range
  end subroutine new_tangent_system

  pure subroutine acceleration(self, q, v, drive, a)
    class(tangent_system_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    integer :: n
    n = self%base%n_dof
    call self%base%tangent(q, v, drive, q(1, n + 1), v(1, n + 1), a, a(1, n + 1))
  end subroutine acceleration

  pure function margin(self, q)
    class(tangent_system_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof)
    real(wp) :: margin(n_lanes)
    margin = self%base%margin(q)
  end function margin

end module viscovib_tangent_system
