!> The spring pendulum: a rigid body on a nonlinear spring, three degrees of
!! freedom q = (z, phi, psi), dimensionless.
!!
!! Source: "Plane motion of the rigid body with the spring-damper suspension"
!! (seed paper 000), its misprints corrected (docs/theory.md). With
!! s = sin(phi-psi), c = cos(phi-psi), Z = 1+z and p = psi'' all three variants
!! read
!!
!!   z''   + e S p            = A1,
!!   Q phi'' + e G p          = A2,
!!   p + r (S z'' + H phi'')  = A3,
!!
!! exact:   S = s, G = H = Z c, Q = Z^2;
!! cubic:   everything expanded to third order, S = d, G = H = 1 + z - d^2/2,
!!          d = phi - psi;
!! printed: G = 0 (its psi'' is printed as psi'), H = c, Q = Z^2.
module viscovib_pendulum
  use viscovib_checks, only: check_finite, check_not_negative, check_positive
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_vector_math, only: sine_cosine_lanes
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
  end type pendulum_parameters

  type, extends(driven_system_type) :: pendulum_type
    type(pendulum_parameters) :: parameters
    !> r = w3^2/w2^2; static elongation z_r; stiffness 1 + 3 alpha z_r^2.
    real(wp) :: r = 0.0_wp, z_r = 0.0_wp, stiffness = 0.0_wp
  contains
    procedure :: acceleration
    procedure :: physical
    procedure :: energy
    procedure :: power
    procedure :: natural_modes
  end type pendulum_type

contains

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

  !> q'' from the closed-form solution of the mass matrix.
  pure subroutine acceleration(self, q, v, drive, a)
    class(pendulum_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)

    select case (self%parameters%equations)
    case (equations_exact)
      call exact_acceleration(self%parameters, self%r, self%z_r, self%stiffness, q, v, drive, a)
    case (equations_cubic)
      call cubic_acceleration(self%parameters, self%r, self%z_r, self%stiffness, q, v, drive, a)
    case default
      call printed_acceleration(self%parameters, self%r, self%z_r, self%stiffness, q, v, drive, a)
    end select
  end subroutine acceleration

  pure subroutine exact_acceleration(p, r, z_r, stiffness, q, v, drive, a)
    type(pendulum_parameters), intent(in) :: p
    real(wp), intent(in) :: r, z_r, stiffness
    real(wp), intent(in) :: q(n_lanes, 3), v(n_lanes, 3), drive(n_lanes, 3)
    real(wp), intent(out) :: a(n_lanes, 3)
    real(wp) :: sines(n_lanes, 3), cosines(n_lanes, 3), d(n_lanes)
    real(wp) :: z, length, a1, a2, a3, s, c, inverse
    integer :: l

    d = q(:, 2) - q(:, 3)
    call sine_cosine_lanes(q(:, 2), sines(:, 1), cosines(:, 1))
    call sine_cosine_lanes(q(:, 3), sines(:, 2), cosines(:, 2))
    call sine_cosine_lanes(d, sines(:, 3), cosines(:, 3))
    inverse = 1.0_wp/(1.0_wp - p%e*r)
    do l = 1, n_lanes
      z = q(l, 1)
      length = 1.0_wp + z
      s = sines(l, 3)
      c = cosines(l, 3)
      a1 = p%load(1)*drive(l, 1) - p%damping(1)*v(l, 1) + p%w2**2*(cosines(l, 1) - 1.0_wp) &
           - z*(stiffness + p%alpha*z*(3.0_wp*z_r + z)) + length*v(l, 2)**2 + p%e*c*v(l, 3)**2
      a2 = (p%load(2)*drive(l, 2) - p%damping(2)*v(l, 2))/length - p%w2**2*sines(l, 1) &
           - 2.0_wp*v(l, 1)*v(l, 2) - p%e*s*v(l, 3)**2
      a3 = p%load(3)*drive(l, 3) - p%damping(3)*v(l, 3) - p%w3**2*sines(l, 2) &
           - r*(2.0_wp*c*v(l, 1)*v(l, 2) - length*s*v(l, 2)**2)
      a(l, 3) = (a3 - r*(s*a1 + c*a2))*inverse
      a(l, 1) = a1 - p%e*s*a(l, 3)
      a(l, 2) = (a2 - p%e*c*a(l, 3))/length
    end do
  end subroutine exact_acceleration

  pure subroutine cubic_acceleration(p, r, z_r, stiffness, q, v, drive, a)
    type(pendulum_parameters), intent(in) :: p
    real(wp), intent(in) :: r, z_r, stiffness
    real(wp), intent(in) :: q(n_lanes, 3), v(n_lanes, 3), drive(n_lanes, 3)
    real(wp), intent(out) :: a(n_lanes, 3)
    real(wp) :: z, phi, psi, d, g, square, a1, a2, a3
    integer :: l

    do l = 1, n_lanes
      z = q(l, 1)
      phi = q(l, 2)
      psi = q(l, 3)
      d = phi - psi
      g = 1.0_wp + z - 0.5_wp*d**2
      square = (1.0_wp + z)**2
      a1 = p%load(1)*drive(l, 1) - p%damping(1)*v(l, 1) - 0.5_wp*p%w2**2*phi**2 &
           - z*(stiffness + p%alpha*z*(3.0_wp*z_r + z)) + (1.0_wp + z)*v(l, 2)**2 &
           + p%e*v(l, 3)**2
      a2 = p%load(2)*drive(l, 2) - p%damping(2)*v(l, 2) &
           - p%w2**2*(phi*(1.0_wp + z) - phi**3/6.0_wp) &
           - 2.0_wp*(1.0_wp + z)*v(l, 1)*v(l, 2) - p%e*d*v(l, 3)**2
      a3 = p%load(3)*drive(l, 3) - p%damping(3)*v(l, 3) - p%w3**2*(psi - psi**3/6.0_wp) &
           - r*(2.0_wp*v(l, 1)*v(l, 2) - d*v(l, 2)**2)
      a(l, 3) = (a3 - r*(d*a1 + g*a2/square))/(1.0_wp - p%e*r*(d**2 + g**2/square))
      a(l, 1) = a1 - p%e*d*a(l, 3)
      a(l, 2) = (a2 - p%e*g*a(l, 3))/square
    end do
  end subroutine cubic_acceleration

  pure subroutine printed_acceleration(p, r, z_r, stiffness, q, v, drive, a)
    type(pendulum_parameters), intent(in) :: p
    real(wp), intent(in) :: r, z_r, stiffness
    real(wp), intent(in) :: q(n_lanes, 3), v(n_lanes, 3), drive(n_lanes, 3)
    real(wp), intent(out) :: a(n_lanes, 3)
    real(wp) :: sines(n_lanes, 3), cosines(n_lanes, 3), d(n_lanes)
    real(wp) :: z, length, a1, a2, a3, s, c
    integer :: l

    d = q(:, 2) - q(:, 3)
    call sine_cosine_lanes(q(:, 2), sines(:, 1), cosines(:, 1))
    call sine_cosine_lanes(q(:, 3), sines(:, 2), cosines(:, 2))
    call sine_cosine_lanes(d, sines(:, 3), cosines(:, 3))
    do l = 1, n_lanes
      z = q(l, 1)
      length = 1.0_wp + z
      s = sines(l, 3)
      c = cosines(l, 3)
      a1 = p%load(1)*drive(l, 1) - p%damping(1)*v(l, 1) + p%w2**2*(cosines(l, 1) - 1.0_wp) &
           - z*(stiffness + p%alpha*z*(3.0_wp*z_r + z)) + length*v(l, 2)**2 + p%e*c*v(l, 3)**2
      a2 = p%load(2)*drive(l, 2) - p%damping(2)*v(l, 2) - p%w2**2*length*sines(l, 1) &
           - 2.0_wp*z*v(l, 1)*v(l, 2) - p%e*length*s*v(l, 3)**2 - p%e*length*c*v(l, 3)
      a3 = p%load(3)*drive(l, 3) - p%damping(3)*v(l, 3) - p%w3**2*sines(l, 2) &
           - r*(2.0_wp*c*v(l, 1)*v(l, 2) - length*s*v(l, 2)**2)
      a(l, 2) = a2/length**2
      a(l, 3) = (a3 - r*(s*a1 + c*a(l, 2)))/(1.0_wp - p%e*r*s**2)
      a(l, 1) = a1 - p%e*s*a(l, 3)
    end do
  end subroutine printed_acceleration

  !> Z = 1 + z > 0: the spring does not pass through the pivot.
  pure logical function physical(self, q)
    class(pendulum_type), intent(in) :: self
    real(wp), intent(in) :: q(:)
    physical = self%n_dof > 0 .and. q(1) > -1.0_wp
  end function physical

  !> Energy of the exact equations (over m L^2 omega_1^2); kept without loads
  !! and damping.
  pure function energy(self, q, v) result(total)
    class(pendulum_type), intent(in) :: self
    !> Shape (3).
    real(wp), intent(in) :: q(3), v(3)
    real(wp) :: total, length, d
    associate (p => self%parameters, z => q(1))
      length = 1.0_wp + z
      d = q(2) - q(3)
      total = 0.5_wp*(v(1)**2 + length**2*v(2)**2 + p%e/self%r*v(3)**2) &
              + p%e*v(3)*(sin(d)*v(1) + length*cos(d)*v(2)) &
              + z**2*(0.5_wp*self%stiffness + self%z_r*p%alpha*z + 0.25_wp*p%alpha*z**2) &
              + 2.0_wp*p%w2**2*(length*sin(0.5_wp*q(2))**2 + p%e*sin(0.5_wp*q(3))**2)
    end associate
  end function energy

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

  !> Undamped linear modes, the inertial coupling of phi and psi included:
  !! (w2^2 - L)(w3^2 - L) = e r L^2 for L = omega^2, and (z) apart.
  pure subroutine natural_modes(self, omega, shapes)
    class(pendulum_type), intent(in) :: self
    !> Over omega_1: of z, then of the two swinging modes, ascending.
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
      ! Of the two equations, the one whose coefficients are larger.
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
