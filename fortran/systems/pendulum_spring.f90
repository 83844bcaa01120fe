!> The spring pendulum without swinging: phi = psi = 0 and no moments. All variants of its equations
!! then reduce to the spring equation,
!!
!!   z'' = f0 cos(p1 t) - c1 z' - z (1 + 3 alpha z_r^2 + 3 alpha z_r z + alpha z^2).
module viscovib_pendulum_spring
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_pendulum, only: pendulum_type
  implicit none
  private

  public :: spring_type, new_spring, swings

  type, extends(driven_system_type) :: spring_type
    !> Load, damping, and factors of z, z^2 and z^3.
    real(wp), private :: load = 0.0_wp, damping = 0.0_wp, factors(3) = 0.0_wp
  contains
    procedure :: acceleration
    procedure :: margin
  end type spring_type

contains

  pure subroutine new_spring(spring, pendulum)
    type(spring_type), intent(out) :: spring
    type(pendulum_type), intent(in) :: pendulum
    associate (p => pendulum%parameters)
      spring%n_dof = 1
      spring%drives = p%frequency(:1)
      spring%load = p%load(1)
      spring%damping = p%damping(1)
      spring%factors = [pendulum%stiffness, 3.0_wp*p%alpha*pendulum%z_r, p%alpha]
    end associate
  end subroutine new_spring

  !> True if a moment or the state (z, z', phi, phi', psi, psi') moves phi or psi.
  pure logical function swings(pendulum, state)
    type(pendulum_type), intent(in) :: pendulum
    real(wp), intent(in) :: state(6)
    swings = any(abs(pendulum%parameters%load(2:)) > 0.0_wp) .or. any(abs(state(3:)) > 0.0_wp)
  end function swings

  pure subroutine acceleration(self, q, v, drive, a)
    class(spring_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      a(l, 1) = self%load*drive(l, 1) - self%damping*v(l, 1) &
                - q(l, 1)*(self%factors(1) + q(l, 1)*(self%factors(2) &
                                                      + self%factors(3)*q(l, 1)))
    end do
  end subroutine acceleration

  !> 1 + z, as for the pendulum.
  pure function margin(self, q)
    class(spring_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof)
    real(wp) :: margin(n_lanes)
    margin = 1.0_wp + q(:, 1)
  end function margin

end module viscovib_pendulum_spring
