! Optimize: -O3
!> The spring pendulum: a rigid body on a nonlinear spring, three degrees of
!! freedom q = (z, phi, psi), dimensionless.
!!
!! Equations in `viscovib_pendulum_equations`.
module viscovib_pendulum
  use viscovib_checks, only: check_finite, check_not_negative, check_positive
  use viscovib_driven_system, only: differentiable_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_pendulum_equations, only: cubic_acceleration, cubic_tangent, exact_acceleration, &
    exact_tangent, i_alpha, i_damping, i_e, i_inverse, i_load, i_r, i_square, i_stiffness, i_w2, &
    i_w3, n_constants, printed_tangent
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: pendulum_type, pendulum_parameters, new_pendulum, static_elongation

  integer, parameter, public :: equations_exact = 1, equations_cubic = 2, equations_printed = 3
  character(len=*), parameter, public :: equations_names(3) = &
    [character(len=7) :: 'exact', 'cubic', 'printed']

  type :: pendulum_parameters
    !> e = E/L; w2, w3 over omega_1; alpha = k_2 L^2/k_1.
    real(wp) :: e = 0.0_wp, w2 = 0.0_wp, w3 = 0.0_wp, alpha = 0.0_wp
    !> Viscous damping of z, phi, psi.
    real(wp) :: damping(3) = 0.0_wp
    !> Amplitudes f0, m01, m02 and frequencies p1, p2, p3 of the loads.
    real(wp) :: load(3) = 0.0_wp, frequency(3) = 0.0_wp
    integer :: equations = equations_exact
  contains
    procedure :: shaken
  end type pendulum_parameters

  type, extends(differentiable_system_type) :: pendulum_type
    type(pendulum_parameters) :: parameters
    !> r = w3^2/w2^2; static elongation z_r; stiffness 1 + 3 alpha z_r^2.
    real(wp) :: r = 0.0_wp, z_r = 0.0_wp, stiffness = 0.0_wp
    !> Constants of the equations in each vector lane. All lanes are equal unless `set_lane` changes
    !! them.
    real(wp), private :: constants(n_lanes, n_constants) = 0.0_wp
  contains
    procedure :: acceleration
    procedure :: tangent
    procedure :: margin
    procedure :: margin_within
    procedure :: set_lane
    procedure :: energy
    procedure :: potential
    procedure :: power
    procedure :: natural_modes
  end type pendulum_type

contains

  !> Parameters perturbed by the relative amount `part`, to estimate the effect of rounding errors.
  !! The body remains rigid. Load frequencies are not rounded: phases use two reals.
  pure type(pendulum_parameters) function shaken(self, part) result(other)
    class(pendulum_parameters), intent(in) :: self
    real(wp), intent(in) :: part
    other = self
    other%e = self%e*(1.0_wp - part)
    other%w2 = self%w2*(1.0_wp + part)
    other%w3 = self%w3*(1.0_wp - part)
    other%alpha = self%alpha*(1.0_wp + part)
    other%damping = self%damping*(1.0_wp + [part, -part, part])
    other%load = self%load*(1.0_wp + [part, -part, part])
  end function shaken

  !> Checked constructor.
  subroutine new_pendulum(pendulum, parameters, status)
    type(pendulum_type), intent(out) :: pendulum
    type(pendulum_parameters), intent(in) :: parameters
    type(status_type), intent(out) :: status
    character(len=*), parameter :: damping_names(3) = ['c1', 'c2', 'c3'], &
                                   load_names(3) = [character(len=3) :: 'f0', 'm01', 'm02'], &
                                   frequency_names(3) = ['p1', 'p2', 'p3']
    integer :: i

    associate (p => parameters)
      call check_not_negative('e', p%e, status)
      if (status%failed()) return
      call check_positive('w2', p%w2, status)
      if (status%failed()) return
      call check_positive('w3', p%w3, status)
      if (status%failed()) return
      call check_not_negative('alpha', p%alpha, status)
      if (status%failed()) return
      do i = 1, 3
        call check_finite(damping_names(i), p%damping(i), status)
        if (status%failed()) return
        call check_finite(trim(load_names(i)), p%load(i), status)
        if (status%failed()) return
        call check_not_negative(frequency_names(i), p%frequency(i), status)
        if (status%failed()) return
      end do
      if (p%equations < 1 .or. p%equations > size(equations_names)) then
        call fail(status, status_input_error, 'equations', 'equations = '//show(p%equations) &
                  //': must be exact (1), cubic (2) or printed (3)')
        return
      end if
      pendulum%r = (p%w3/p%w2)**2
      if (p%e*pendulum%r >= 1.0_wp) then
        call fail(status, status_input_error, 'e', 'e w3^2/w2^2 = '//show(p%e*pendulum%r) &
                  //': must be less than 1 (no rigid body has I_A <= m E^2)')
        return
      end if
      pendulum%z_r = static_elongation(p%alpha, p%w2)
      pendulum%stiffness = 1.0_wp + 3.0_wp*p%alpha*pendulum%z_r**2
      pendulum%drives = p%frequency
    end associate
    pendulum%n_dof = 3
    pendulum%parameters = parameters
    associate (k => pendulum%constants, p => parameters)
      k(:, i_e) = p%e
      k(:, i_r) = pendulum%r
      k(:, i_w2) = p%w2**2
      k(:, i_w3) = p%w3**2
      k(:, i_stiffness) = pendulum%stiffness
      k(:, i_square) = 3.0_wp*p%alpha*pendulum%z_r
      k(:, i_alpha) = p%alpha
      k(:, i_inverse) = 1.0_wp/(1.0_wp - p%e*pendulum%r)
      do i = 1, 3
        k(:, i_damping + i - 1) = p%damping(i)
        k(:, i_load + i - 1) = p%load(i)
      end do
    end associate
  end subroutine new_pendulum

  !> The only real root of alpha z^3 + z = w2^2, without cancellation:
  !! z = 2/sqrt(3 alpha) sinh(asinh(3 sqrt(3 alpha) w2^2/2)/3).
  elemental real(wp) function static_elongation(alpha, w2)
    real(wp), intent(in) :: alpha, w2
    real(wp) :: scale
    scale = sqrt(3.0_wp*alpha)
    if (scale*w2**2 < 1.0e-8_wp) then
      static_elongation = w2**2*(1.0_wp - alpha*w2**4)
    else
      static_elongation = 2.0_wp/scale*sinh(asinh(1.5_wp*scale*w2**2)/3.0_wp)
    end if
  end function static_elongation

  !> Set the constants of a vector lane from another pendulum with the same equations.
  pure subroutine set_lane(self, lane, other)
    class(pendulum_type), intent(inout) :: self
    integer, intent(in) :: lane
    type(pendulum_type), intent(in) :: other
    self%constants(lane, :) = other%constants(1, :)
  end subroutine set_lane

  !> q'', with the mass matrix inverted in closed form.
  pure subroutine acceleration(self, q, v, drive, a)
    class(pendulum_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    real(wp), dimension(n_lanes, 3) :: still, unused

    select case (self%parameters%equations)
    case (equations_exact)
      call exact_acceleration(self%constants, q, v, drive, a)
    case (equations_cubic)
      call cubic_acceleration(self%constants, q, v, drive, a)
    case default
      still = 0.0_wp
      call printed_tangent(self%constants, q, v, drive, still, still, a, unused)
    end select
  end subroutine acceleration

  !> q'' and its change in the direction (dq, dv).
  pure subroutine tangent(self, q, v, drive, dq, dv, a, da)
    class(pendulum_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(in) :: dq(n_lanes, self%n_dof), dv(n_lanes, self%n_dof)
    real(wp), intent(out) :: a(n_lanes, self%n_dof), da(n_lanes, self%n_dof)

    select case (self%parameters%equations)
    case (equations_exact)
      call exact_tangent(self%constants, q, v, drive, dq, dv, a, da)
    case (equations_cubic)
      call cubic_tangent(self%constants, q, v, drive, dq, dv, a, da)
    case default
      call printed_tangent(self%constants, q, v, drive, dq, dv, a, da)
    end select
  end subroutine tangent

  !> Margin Z = 1 + z: the spring does not pass through the pivot.
  pure function margin(self, q)
    class(pendulum_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof)
    real(wp) :: margin(n_lanes)
    margin = 1.0_wp + q(:, 1)
  end function margin

  !> The same within a short time.
  pure function margin_within(self, q, v, time) result(least)
    class(pendulum_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof), time
    real(wp) :: least(n_lanes)
    least = 1.0_wp + q(:, 1) - abs(time*v(:, 1))
  end function margin_within

  !> Energy (over m L^2 omega_1^2), conserved without loads and damping. The printed equations
  !! conserve no energy; the energy of the exact equations is returned for them. The cubic equations
  !! are Lagrange's equations for the energies to fourth degree.
  pure function energy(self, q, v) result(total)
    class(pendulum_type), intent(in) :: self
    !> Shape (3).
    real(wp), intent(in) :: q(3), v(3)
    real(wp) :: total, length, d, along, across, slope(3)
    associate (p => self%parameters)
      length = 1.0_wp + q(1)
      d = q(2) - q(3)
      if (p%equations == equations_cubic) then
        along = d
        across = length - 0.5_wp*d**2
      else
        along = sin(d)
        across = length*cos(d)
      end if
      call self%potential(q, total, slope)
      total = total + 0.5_wp*(v(1)**2 + length**2*v(2)**2 + p%e/self%r*v(3)**2) &
              + p%e*v(3)*(along*v(1) + across*v(2))
    end associate
  end function energy

  !> Potential energy and its gradient.
  pure subroutine potential(self, q, value, slope)
    class(pendulum_type), intent(in) :: self
    real(wp), intent(in) :: q(self%n_dof)
    real(wp), intent(out) :: value, slope(self%n_dof)
    real(wp) :: lift(2), lift_slope(2)
    associate (p => self%parameters, z => q(1))
      ! 1 - cos, without cancellation.
      if (p%equations == equations_cubic) then
        lift = 0.5_wp*q(2:3)**2*(1.0_wp - q(2:3)**2/12.0_wp)
        lift_slope = q(2:3)*(1.0_wp - q(2:3)**2/6.0_wp)
      else
        lift = 2.0_wp*sin(0.5_wp*q(2:3))**2
        lift_slope = sin(q(2:3))
      end if
      value = z**2*(0.5_wp*self%stiffness + self%z_r*p%alpha*z + 0.25_wp*p%alpha*z**2) &
              + p%w2**2*(lift(1) + p%e*lift(2))
      slope(1) = z*(self%stiffness + 3.0_wp*self%z_r*p%alpha*z + p%alpha*z**2)
      slope(2:3) = p%w2**2*[lift_slope(1), p%e*lift_slope(2)]
      if (p%equations == equations_cubic) then
        ! z phi^2/2 is the only coupling term up to fourth degree.
        value = value + 0.5_wp*p%w2**2*z*q(2)**2
        slope(1:2) = slope(1:2) + p%w2**2*q(2)*[0.5_wp*q(2), z]
      else
        value = value + p%w2**2*z*lift(1)
        slope(1:2) = slope(1:2) + p%w2**2*[lift(1), z*lift_slope(1)]
      end if
    end associate
  end subroutine potential

  !> Rate of change of the energy: work of the loads less dissipation.
  pure function power(self, v, drive) result(rate)
    class(pendulum_type), intent(in) :: self
    real(wp), intent(in) :: v(3), drive(3)
    real(wp) :: rate
    associate (p => self%parameters)
      rate = v(1)*(p%load(1)*drive(1) - p%damping(1)*v(1)) &
             + v(2)*(p%load(2)*drive(2) - p%damping(2)*v(2)) &
             + p%e/self%r*v(3)*(p%load(3)*drive(3) - p%damping(3)*v(3))
    end associate
  end function power

  !> Undamped linear modes, including the inertial coupling of phi and psi: (w2^2 - L)(w3^2 - L) = e
  !! r L^2 for L = omega^2; z is uncoupled.
  pure subroutine natural_modes(self, omega, shapes)
    class(pendulum_type), intent(in) :: self
    !> Frequencies over omega_1: of z, then of the two swinging modes, ascending.
    real(wp), intent(out) :: omega(3)
    !> Column j is mode j in (z, phi, psi), its largest entry 1 or -1.
    real(wp), intent(out) :: shapes(3, 3)
    real(wp) :: a, b, coupling, root, lambda(2), phi, psi
    integer :: j

    a = self%parameters%w2**2
    b = self%parameters%w3**2
    coupling = self%parameters%e*self%r
    root = sqrt((a - b)**2 + 4.0_wp*coupling*a*b)
    lambda(2) = 0.5_wp*(a + b + root)/(1.0_wp - coupling)
    lambda(1) = 2.0_wp*a*b/(a + b + root)
    omega = sqrt([self%stiffness, lambda])
    shapes = 0.0_wp
    shapes(1, 1) = 1.0_wp
    do j = 1, 2
      ! Use the equation with the larger coefficients.
      if (abs(a - lambda(j)) >= abs(b - lambda(j))) then
        psi = 1.0_wp
        phi = self%parameters%e*lambda(j)/(a - lambda(j))
      else
        phi = 1.0_wp
        psi = self%r*lambda(j)/(b - lambda(j))
      end if
      shapes(2:3, j + 1) = [phi, psi]/max(abs(phi), abs(psi))
    end do
  end subroutine natural_modes

end module viscovib_pendulum
