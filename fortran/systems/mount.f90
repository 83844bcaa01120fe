! Optimize: -O3
!> The mount: a rigid body on viscoelastic supports, two degrees of freedom.
!!
!! Source: seed paper 001 with its misprints corrected (docs/explanation/misprints.md).
!! Coordinates u = (x, phi); spring deflections x - l sin(phi) and phi.
module viscovib_mount
  use viscovib_checks, only: check_finite, check_not_negative, check_positive
  use viscovib_counters, only: count_up, counted_deflections, counted_forces, counted_sines, &
    counting
  use viscovib_jet, only: cosine, jet_type, operator(*), operator(+), operator(-), sine
  use viscovib_kernel_holder, only: copy_kernels, kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_limits, only: least_mass
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: mount_type, mount_parameters, new_mount

  !> Geometric nonlinearity of the equations.
  !! exact: full sine and cosine, memory on the deflection;
  !! cubic: potential expanded to fourth order, memory on every term;
  !! printed: as cubic, with the signs and factors the paper prints.
  integer, parameter, public :: geometry_exact = 1, geometry_cubic = 2, geometry_printed = 3
  character(len=*), parameter, public :: geometry_names(3) = &
    [character(len=7) :: 'exact', 'cubic', 'printed']

  type :: mount_parameters
    !> m (kg), I (kg m^2), l (m), c_x (N/m), c_phi (N m).
    real(wp) :: mass = 0.0_wp, inertia = 0.0_wp, offset = 0.0_wp
    real(wp) :: stiffness_x = 0.0_wp, stiffness_phi = 0.0_wp
    !> C (N s/m, N s; N s, N m s).
    real(wp) :: damping(2, 2) = 0.0_wp
    integer :: geometry = geometry_cubic
    !> epsilon and epsilon_1 of the paper: factors of the cubic terms and of every kernel. 0 removes
    !! the terms and their cost.
    real(wp) :: cubic_scale = 1.0_wp, memory_scale = 1.0_wp
    !> Index into the kernels given to `new_mount` for the spring in x and the
    !! spring in phi; 0: without memory.
    integer :: kernel_x = 0, kernel_phi = 0
  end type mount_parameters

  type, extends(oscillator_type) :: mount_type
    type(mount_parameters) :: parameters
    !> Factors of the cubic terms: phi^3 in x, phi^2 x and phi^3 in phi.
    real(wp), private :: x_ppp = 0.0_wp, phi_ppx = 0.0_wp, phi_ppp = 0.0_wp
  contains
    procedure :: deflection_remainder
    procedure :: force_remainder
    procedure :: deflection_slopes
    procedure :: force_slopes
    procedure :: jets
    procedure :: natural_modes
    procedure :: deflect
  end type mount_type

contains

  !> Checked constructor.
  subroutine new_mount(mount, parameters, kernels, status)
    type(mount_type), intent(out) :: mount
    type(mount_parameters), intent(in) :: parameters
    type(kernel_holder), intent(in) :: kernels(:)
    type(status_type), intent(out) :: status
    integer :: kernel_x, kernel_phi

    call check_parameters(parameters, status)
    if (status%failed()) return
    mount%parameters = parameters
    call copy_kernels(kernels, mount%kernels)
    mount%kernels%factor = parameters%memory_scale
    kernel_x = parameters%kernel_x
    kernel_phi = parameters%kernel_phi
    mount%mass = reshape([parameters%mass, 0.0_wp, 0.0_wp, parameters%inertia], [2, 2])
    mount%damping = parameters%damping
    mount%base_direction = [1.0_wp, 0.0_wp]
    mount%odd = .true.
    associate (c_x => parameters%stiffness_x, c_phi => parameters%stiffness_phi, &
               l => parameters%offset, scale => parameters%cubic_scale)
      if (parameters%geometry == geometry_exact) then
        ! w = (c_x (x - l sin phi), c_phi phi), F = (v_1, v_2 - l cos(phi) v_1).
        mount%gather = reshape([c_x, 0.0_wp, -c_x*l, c_phi], [2, 2])
        mount%spread = reshape([1.0_wp, -l, 0.0_wp, 1.0_wp], [2, 2])
        mount%kernel_of = [kernel_x, kernel_phi]
        mount%bent = [l /= 0.0_wp, .false.]
        mount%separable = l == 0.0_wp
      else
        ! w_1, w_2: force and moment of the spring in x; w_3: spring in phi.
        mount%gather = reshape([c_x, -c_x*l, 0.0_wp, -c_x*l, c_x*l**2, c_phi], [3, 2])
        mount%spread = reshape([1.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 1.0_wp], [2, 3])
        mount%kernel_of = [kernel_x, kernel_x, kernel_phi]
        mount%degree = 3
        if (parameters%geometry == geometry_cubic) then
          mount%x_ppp = scale*c_x*l/6.0_wp
          mount%phi_ppx = scale*c_x*l/2.0_wp
          mount%phi_ppp = -scale*c_x*l**2*2.0_wp/3.0_wp
        else
          mount%x_ppp = -scale*c_x*l/6.0_wp
          mount%phi_ppx = -scale*c_x*l/2.0_wp
          mount%phi_ppp = -scale*c_x*l**2*8.0_wp/6.0_wp
        end if
        mount%bent = [mount%x_ppp /= 0.0_wp, mount%x_ppp /= 0.0_wp, .false.]
        if (mount%x_ppp == 0.0_wp) mount%n_zero = 3
      end if
    end associate
    call mount%drop_zero_kernels()
  end subroutine new_mount

  subroutine check_parameters(parameters, status)
    type(mount_parameters), intent(in) :: parameters
    type(status_type), intent(out) :: status

    call check_positive('mass', parameters%mass, status)
    if (status%failed()) return
    call check_positive('inertia', parameters%inertia, status)
    if (status%failed()) return
    if (parameters%mass < least_mass) then
      call fail(status, status_input_error, 'mass', 'mass = '//show(parameters%mass) &
                //': must be at least '//show(least_mass)//': choose other units')
    else if (parameters%inertia < least_mass) then
      call fail(status, status_input_error, 'inertia', 'inertia = '//show(parameters%inertia) &
                //': must be at least '//show(least_mass)//': choose other units')
    end if
    if (status%failed()) return
    call check_finite('offset', parameters%offset, status)
    if (status%failed()) return
    call check_positive('stiffness_x', parameters%stiffness_x, status)
    if (status%failed()) return
    call check_positive('stiffness_phi', parameters%stiffness_phi, status)
    if (status%failed()) return
    call check_finite('damping', reshape(parameters%damping, [4]), status)
    if (status%failed()) return
    call check_finite('cubic_scale', parameters%cubic_scale, status)
    if (status%failed()) return
    call check_not_negative('memory_scale', parameters%memory_scale, status)
    if (status%failed()) return
    if (parameters%geometry < 1 .or. parameters%geometry > size(geometry_names)) then
      call fail(status, status_input_error, 'geometry', 'geometry = ' &
                //show(parameters%geometry)//': must be exact (1), cubic (2) or printed (3)')
    else if (parameters%geometry == geometry_exact .and. parameters%cubic_scale /= 1.0_wp) then
      call fail(status, status_input_error, 'cubic_scale', 'cubic_scale = ' &
                //show(parameters%cubic_scale)//': must be 1 for the exact geometry, ' &
                //'which has no cubic terms to scale')
    end if
  end subroutine check_parameters

  !> cubic: (eps c_x l/6 phi^3, eps [c_x l/2 phi^2 x - 2/3 c_x l^2 phi^3], -);
  !! exact: (c_x l (phi - sin phi), -).
  subroutine deflection_remainder(self, u, w)
    class(mount_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: w(:, :)
    real(wp) :: square, factor
    integer :: i

    if (counting) call count_up(counted_deflections, size(u, 1))
    if (self%parameters%geometry == geometry_exact) then
      if (counting) call count_up(counted_sines, size(u, 1))
      factor = self%parameters%stiffness_x*self%parameters%offset
      do i = 1, size(u, 1)
        w(i, 1) = factor*(u(i, 2) - sin(u(i, 2)))
      end do
    else
      do i = 1, size(u, 1)
        square = u(i, 2)**2
        w(i, 1) = self%x_ppp*square*u(i, 2)
        w(i, 2) = square*(self%phi_ppx*u(i, 1) + self%phi_ppp*u(i, 2))
      end do
    end if
  end subroutine deflection_remainder

  !> exact: (0, l (1 - cos phi) v_1); zero for the other geometries.
  subroutine force_remainder(self, u, v, f)
    class(mount_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), v(:, :)
    real(wp), intent(out), contiguous :: f(:, :)
    integer :: i

    if (counting) call count_up(counted_forces, size(u, 1))
    do i = 1, size(u, 1)
      f(i, 1) = 0.0_wp
      f(i, 2) = 2.0_wp*self%parameters%offset*sin(0.5_wp*u(i, 2))**2*v(i, 1)
    end do
  end subroutine force_remainder

  !> Deflections of the springs in x and phi, and their rates, shape (n, 2). The geometry is exact,
  !! or expanded to third order.
  pure subroutine deflect(self, u, rate, d, speed)
    class(mount_type), intent(in) :: self
    real(wp), intent(in) :: u(:, :), rate(:, :)
    real(wp), intent(out) :: d(:, :), speed(:, :)

    d(:, 2) = u(:, 2)
    speed(:, 2) = rate(:, 2)
    associate (p => self%parameters, phi => u(:, 2))
      if (p%geometry == geometry_exact) then
        d(:, 1) = u(:, 1) - p%offset*sin(phi)
        speed(:, 1) = rate(:, 1) - p%offset*cos(phi)*speed(:, 2)
      else
        d(:, 1) = u(:, 1) - p%offset*(phi - p%cubic_scale*phi**3/6.0_wp)
        speed(:, 1) = rate(:, 1) - p%offset*(1.0_wp - p%cubic_scale*phi**2/2.0_wp)*speed(:, 2)
      end if
    end associate
  end subroutine deflect

  subroutine deflection_slopes(self, u, slopes)
    class(mount_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: slopes(:, :, :)
    real(wp) :: factor
    integer :: i

    if (counting) call count_up(counted_deflections, size(u, 1))
    slopes(:, 1, 1) = 0.0_wp
    if (self%parameters%geometry == geometry_exact) then
      factor = 2.0_wp*self%parameters%stiffness_x*self%parameters%offset
      do i = 1, size(u, 1)
        slopes(i, 1, 2) = factor*sin(0.5_wp*u(i, 2))**2
      end do
    else
      do i = 1, size(u, 1)
        slopes(i, 1, 2) = 3.0_wp*self%x_ppp*u(i, 2)**2
        slopes(i, 2, 1) = self%phi_ppx*u(i, 2)**2
        slopes(i, 2, 2) = u(i, 2)*(2.0_wp*self%phi_ppx*u(i, 1) + 3.0_wp*self%phi_ppp*u(i, 2))
      end do
    end if
  end subroutine deflection_slopes

  subroutine force_slopes(self, u, v, by_u, by_v)
    class(mount_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), v(:, :)
    real(wp), intent(out), contiguous :: by_u(:, :, :), by_v(:, :, :)
    integer :: i

    if (counting) call count_up(counted_forces, size(u, 1))
    by_u = 0.0_wp
    by_v = 0.0_wp
    do i = 1, size(u, 1)
      by_u(i, 2, 2) = self%parameters%offset*sin(u(i, 2))*v(i, 1)
      by_v(i, 2, 1) = 2.0_wp*self%parameters%offset*sin(0.5_wp*u(i, 2))**2
    end do
  end subroutine force_slopes

  !> w(u) and F(u, v) as polynomials up to the third degree.
  pure subroutine jets(self, u, v, w, f)
    class(mount_type), intent(in) :: self
    !> Shapes (2), (n_memory), (n_memory) and (2).
    type(jet_type), intent(in) :: u(:), v(:)
    type(jet_type), intent(out) :: w(:), f(:)

    associate (p => self%parameters)
      if (p%geometry == geometry_exact) then
        w(1) = p%stiffness_x*(u(1) - p%offset*sine(u(2)))
        w(2) = p%stiffness_phi*u(2)
        f(1) = v(1)
        f(2) = v(2) - p%offset*(cosine(u(2))*v(1))
      else
        w(1) = p%stiffness_x*(u(1) - p%offset*u(2)) + self%x_ppp*(u(2)*u(2)*u(2))
        w(2) = (p%stiffness_x*p%offset)*(p%offset*u(2) - u(1)) &
               + u(2)*u(2)*(self%phi_ppx*u(1) + self%phi_ppp*u(2))
        w(3) = p%stiffness_phi*u(2)
        f(1) = v(1)
        f(2) = v(2) + v(3)
      end if
    end associate
  end subroutine jets

  !> Undamped natural frequencies without memory, and mode shapes.
  !!
  !! omega^2 = [S -+ sqrt(S^2 - 4 c_x c_phi/(m I))]/2 (seed paper 001, (2)) and
  !! shapes (1, a_2j), a_2j = (c_x - m omega_j^2)/(c_x l) (its (5), (6)), both
  !! in forms free of cancellation. With l = 0 the coordinates are uncoupled
  !! and the shapes are unit vectors.
  pure subroutine natural_modes(self, omega, shapes)
    class(mount_type), intent(in) :: self
    !> Circular frequencies (rad/s), ascending.
    real(wp), intent(out) :: omega(2)
    !> Column j is mode j.
    real(wp), intent(out) :: shapes(2, 2)
    real(wp) :: a, d, b, gap, root, above, below

    associate (p => self%parameters)
      a = p%stiffness_x/p%mass
      d = (p%stiffness_x*p%offset**2 + p%stiffness_phi)/p%inertia
      b = p%stiffness_x*abs(p%offset)/(sqrt(p%mass)*sqrt(p%inertia))
      ! This order preserves the difference of nearly equal frequencies.
      gap = (a - p%stiffness_phi/p%inertia) - p%stiffness_x*p%offset**2/p%inertia
      root = hypot(gap, 2.0_wp*b)
      omega(2) = sqrt(0.5_wp*(a + d + root))
      omega(1) = sqrt(a)*sqrt(p%stiffness_phi/p%inertia)/omega(2)
      if (p%offset == 0.0_wp) then
        shapes = reshape([1.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [2, 2])
        if (gap > 0.0_wp) shapes = shapes(:, 2:1:-1)
        return
      end if
      ! a - omega_1^2 = (gap + root)/2 > 0 and a - omega_2^2 = (gap - root)/2 < 0.
      if (gap >= 0.0_wp) then
        above = 0.5_wp*(gap + root)
        below = -b**2/above
      else
        below = 0.5_wp*(gap - root)
        above = -b**2/below
      end if
      shapes(1, :) = 1.0_wp
      shapes(2, :) = [above, below]/(a*p%offset)
    end associate
  end subroutine natural_modes

end module viscovib_mount
