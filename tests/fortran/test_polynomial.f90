!> Polynomial systems: derivatives against differences; the mount as a polynomial system.
module test_polynomial
  use testing, only: begin, check, check_close, check_fails, check_ok
  use viscovib_backbone, only: follow_backbone
  use viscovib_backbone_plan, only: backbone_plan_type, new_backbone_plan
  use viscovib_catalogue, only: kernel_rzhanitsyn, new_kernel
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_mount, only: mount_parameters, mount_type, new_mount
  use viscovib_polynomial, only: new_polynomial, polynomial_parameters, polynomial_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: run_polynomial

contains

  subroutine run_polynomial()
    type(polynomial_type) :: system
    type(polynomial_parameters) :: p
    type(kernel_holder) :: kernels(2)
    type(status_type) :: status

    call new_kernel(kernels(1)%kernel, kernel_rzhanitsyn, [0.048_wp, 0.1_wp, 0.05_wp], status)
    call check_ok(status)
    call new_kernel(kernels(2)%kernel, kernel_rzhanitsyn, [0.03_wp, 0.5_wp, 0.1_wp], status)
    call check_ok(status)

    if (begin('derivatives of every power are those of the forces')) then
      call three_masses(p)
      call new_polynomial(system, p, kernels, status)
      call check_ok(status)
      call compare_slopes(system)
      call compare_balance(system, .false.)
    end if

    if (begin('symmetry, degree and variables are seen from the monomials')) then
      call three_masses(p)
      call new_polynomial(system, p, kernels, status)
      call check_ok(status)
      call check(.not. system%odd .and. system%degree == 5, 'one of degree 4 among them')
      call check(system%n_memory() == 7, 'a variable for each kernel and equation with a force')
      call check(.not. system%is_linear(), 'not linear')
      call three_masses(p)
      p%coefficient(3) = 0.0_wp
      call new_polynomial(system, p, kernels, status)
      call check(system%odd .and. system%degree == 5, 'odd without it')
      call compare_balance(system, .true.)
      p%coefficient = 0.0_wp
      call new_polynomial(system, p, kernels, status)
      call check(system%odd .and. system%is_linear(), 'linear without all')
    end if

    if (begin('the mount written as a polynomial system')) call compare_mount(kernels(:1))

    if (begin('free motions against the arithmetic-geometric mean')) call compare_backbone()

    if (begin('what is no such system')) then
      call three_masses(p)
      p%mass(1, 2) = 0.5_wp
      call new_polynomial(system, p, kernels, status)
      call check_fails(status, 'mass: must be symmetric')
      call three_masses(p)
      p%mass(3, 3) = -1.0_wp
      call new_polynomial(system, p, kernels, status)
      call check_fails(status, 'mass: must be symmetric and positive definite')
      call three_masses(p)
      p%powers(1, 1) = -1
      call new_polynomial(system, p, kernels, status)
      call check_fails(status, 'powers of monomial 1: must not be negative')
      call three_masses(p)
      p%powers(:, 2) = [0, 0, 1]
      call new_polynomial(system, p, kernels, status)
      call check_fails(status, 'powers of monomial 2')
      call three_masses(p)
      p%on(1) = 4
      call new_polynomial(system, p, kernels, status)
      call check_fails(status, 'on = 4: must be an equation, 1 to 3')
      call three_masses(p)
      call new_polynomial(system, p, kernels(:1), status)
      call check_fails(status, 'kernel: must be 0 (none) to 1')
    end if
  end subroutine run_polynomial

  !> Three coordinates, a full mass matrix, two kernels, degrees 3, 5 and 4.
  subroutine three_masses(p)
    type(polynomial_parameters), intent(out) :: p
    p%mass = reshape([2.0_wp, 0.1_wp, 0.0_wp, 0.1_wp, 1.0_wp, 0.2_wp, 0.0_wp, 0.2_wp, 0.5_wp], &
                     [3, 3])
    p%damping = 0.02_wp*p%mass
    p%stiffness = reshape([3.0_wp, -1.0_wp, 0.0_wp, -1.0_wp, 2.0_wp, -1.0_wp, 0.0_wp, -1.0_wp, &
                           1.5_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, &
                           0.0_wp, 0.7_wp], [3, 3, 2])
    p%spring_kernel = [1, 2]
    p%coefficient = [0.7_wp, -0.3_wp, 0.4_wp, 0.25_wp]
    p%on = [1, 3, 2, 1]
    p%monomial_kernel = [0, 2, 0, 1]
    p%powers = reshape([1, 2, 0, 0, 1, 4, 1, 2, 1, 3, 0, 0], [3, 4])
    p%base_direction = [1.0_wp, 1.0_wp, 1.0_wp]
  end subroutine three_masses

  subroutine compare_slopes(system)
    type(polynomial_type), intent(in) :: system
    real(wp), parameter :: h = 1.0e-5_wp
    real(wp) :: u(40, 3), above(40, 7), below(40, 7), slopes(40, 7, 3)
    integer :: b, i, d

    above = 0.0_wp
    below = 0.0_wp
    slopes = 0.0_wp
    do d = 1, 3
      do i = 1, 40
        u(i, d) = 1.3_wp*sin(1.7_wp*i + d)
      end do
    end do
    call system%deflection_slopes(u, slopes)
    do b = 1, 3
      u(:, b) = u(:, b) + h
      call system%deflection_remainder(u, above)
      u(:, b) = u(:, b) - 2.0_wp*h
      call system%deflection_remainder(u, below)
      u(:, b) = u(:, b) + h
      call check_close(maxval(abs((above - below)/(2.0_wp*h) - slopes(:, :, b))), 0.0_wp, &
                       1.0e-9_wp, 'slopes', floor=1.0_wp)
    end do
  end subroutine compare_slopes

  subroutine compare_balance(system, half_wave)
    type(polynomial_type), intent(in) :: system
    logical, intent(in) :: half_wave
    type(load_type) :: load
    type(harmonic_set_type) :: set
    type(balance_type) :: balance
    type(status_type) :: status
    real(wp), allocatable :: x(:, :), above(:, :), below(:, :), jacobian(:, :), slope(:, :)
    real(wp), parameter :: h = 1.0e-5_wp
    integer :: i, d, m

    call new_load(load, 3, [1], reshape([(0.5_wp, 0.0_wp), (0.0_wp, 0.1_wp), (0.0_wp, 0.0_wp)], &
                                        [3, 1]), [(0.02_wp, 0.0_wp)], status)
    call check_ok(status)
    call new_harmonic_set(set, 5, half_wave, system%degree)
    call new_balance(balance, system, set)
    call balance%set_frequency(system, load, 1.3_wp)
    m = 2*size(set%orders)
    allocate (x(m, 3), above(m, 3), below(m, 3), slope(m, 3), jacobian(3*m, 3*m))
    do d = 1, 3
      do i = 1, m
        x(i, d) = 0.6_wp*sin(2.3_wp*i + d)/i
      end do
    end do
    call balance%residual(system, x, above)
    call balance%derivatives(system, jacobian)
    do d = 1, 3
      do i = 1, m
        x(i, d) = x(i, d) + h
        call balance%residual(system, x, above)
        x(i, d) = x(i, d) - 2.0_wp*h
        call balance%residual(system, x, below)
        x(i, d) = x(i, d) + h
        call check_close(maxval(abs(reshape((above - below)/(2.0_wp*h), [3*m]) &
                                    - jacobian(:, i + m*(d - 1)))), 0.0_wp, 1.0e-9_wp, &
                         'column', floor=maxval(abs(jacobian)))
      end do
    end do
    call balance%residual(system, x, above)
    call balance%frequency_derivative(system, load, x, slope)
    call balance%set_frequency(system, load, 1.3_wp + h)
    call balance%residual(system, x, above)
    call balance%set_frequency(system, load, 1.3_wp - h)
    call balance%residual(system, x, below)
    call check_close(maxval(abs((above - below)/(2.0_wp*h) - slope)), 0.0_wp, 1.0e-9_wp, &
                     'slope in the frequency', floor=maxval(abs(slope)))
    call balance%set_frequency(system, load, 1.3_wp)
    call balance%load_derivative(slope)
    balance%load_factor = 2.0_wp
    call balance%residual(system, x, above)
    balance%load_factor = 1.0_wp
    call balance%residual(system, x, below)
    call check_close(maxval(abs(above - below - slope)), 0.0_wp, 1.0e-14_wp, 'slope in the load', &
                     floor=1.0_wp)
  end subroutine compare_balance

  !> M, C, forces and derivatives of both systems at one motion.
  subroutine compare_mount(kernels)
    type(kernel_holder), intent(in) :: kernels(:)
    type(mount_type) :: mount
    type(mount_parameters) :: q
    type(polynomial_type) :: system
    type(polynomial_parameters) :: p
    type(load_type) :: load
    type(harmonic_set_type) :: set
    type(balance_type) :: balance
    type(status_type) :: status
    real(wp) :: x(8, 2), r(8, 2), s(8, 2), one(16, 16), other(16, 16)
    integer :: i

    q = mount_parameters(mass=1.0_wp, inertia=0.1_wp, offset=0.5_wp, stiffness_x=10.0_wp, &
                         stiffness_phi=2.0_wp, kernel_x=1, kernel_phi=1)
    call new_mount(mount, q, kernels, status)
    call check_ok(status)
    p%mass = reshape([1.0_wp, 0.0_wp, 0.0_wp, 0.1_wp], [2, 2])
    p%damping = 0.0_wp*p%mass
    p%stiffness = reshape([10.0_wp, -5.0_wp, -5.0_wp, 4.5_wp], [2, 2, 1])
    p%spring_kernel = [1]
    p%coefficient = [5.0_wp/6.0_wp, 2.5_wp, -5.0_wp/3.0_wp]
    p%on = [1, 2, 2]
    p%monomial_kernel = [1, 1, 1]
    p%powers = reshape([0, 3, 1, 2, 0, 3], [2, 3])
    p%base_direction = [1.0_wp, 0.0_wp]
    call new_polynomial(system, p, kernels, status)
    call check_ok(status)
    call new_load(load, 2, [1], reshape([(0.5_wp, 0.0_wp), (0.0_wp, 0.0_wp)], [2, 1]), &
                  [(0.1_wp, 0.0_wp)], status)
    call new_harmonic_set(set, 7, system%odd, system%degree)
    x = reshape([(0.4_wp*sin(2.0_wp*i)/i, i=1, 16)], [8, 2])
    call new_balance(balance, mount, set)
    call balance%set_frequency(mount, load, 1.9_wp)
    call balance%residual(mount, x, r)
    call balance%derivatives(mount, one)
    call new_balance(balance, system, set)
    call balance%set_frequency(system, load, 1.9_wp)
    call balance%residual(system, x, s)
    call balance%derivatives(system, other)
    call check_close(maxval(abs(r - s)), 0.0_wp, 4.0e-15_wp, 'residual', floor=maxval(abs(r)))
    call check_close(maxval(abs(one - other)), 0.0_wp, 4.0e-15_wp, 'derivatives', &
                     floor=maxval(abs(one)))
  end subroutine compare_mount

  !> u'' + u + u^3 = 0 from rest at A: nu = agm(sqrt(1 + A^2), sqrt(1 + A^2/2)), for
  !! 2 K(m)/pi = 1/agm(1, sqrt(1 - m)) with m = A^2/(2 (1 + A^2)).
  subroutine compare_backbone()
    type(polynomial_type), target :: system
    type(polynomial_parameters) :: p
    type(kernel_holder) :: none(0)
    type(backbone_plan_type), target :: plan
    type(curve_branch_type) :: backbone
    type(status_type) :: status
    real(wp) :: a, b, c, largest
    integer, allocatable :: orders(:)
    integer :: i, j, set_size
    integer :: cancel

    p%mass = reshape([1.0_wp], [1, 1])
    p%damping = 0.0_wp*p%mass
    p%stiffness = reshape([1.0_wp], [1, 1, 1])
    p%spring_kernel = [0]
    p%coefficient = [1.0_wp]
    p%on = [1]
    p%monomial_kernel = [0]
    p%powers = reshape([3], [1, 1])
    p%base_direction = [0.0_wp]
    call new_polynomial(system, p, none, status)
    call check_ok(status)
    call new_backbone_plan(plan, system, 0, 1, 'x', 31, .false., 1.0e-13_wp, status)
    call check_ok(status)
    cancel = 0
    call follow_backbone(plan, curve_options(1.0e-3_wp, 2.0_wp, 1.0e-13_wp, 500, 0.1_wp), &
                         backbone, orders, cancel)
    call check(backbone%outcome == curve_completed, 'to its end')
    call check(maxval(backbone%truncation) <= 4.0e-15_wp, 'with enough orders')
    set_size = size(orders)
    largest = backbone%x(1, backbone%n_points)
    call check_close(largest, 2.0_wp, 1.0e-11_wp, 'the last amplitude')
    do i = 1, backbone%n_points
      c = sum(backbone%x(:set_size, i))
      a = sqrt(1.0_wp + c**2)
      b = sqrt(1.0_wp + 0.5_wp*c**2)
      do j = 1, 8
        c = 0.5_wp*(a + b)
        b = sqrt(a*b)
        a = c
      end do
      call check_close(backbone%x(set_size + 1, i), a, 4.0e-15_wp, 'frequency')
    end do
    cancel = 1
    call follow_backbone(plan, curve_options(1.0e-3_wp, 2.0_wp, 1.0e-13_wp, 500, 0.1_wp), &
                         backbone, orders, cancel)
    call check(backbone%n_points == 1, 'given up at once')
  end subroutine compare_backbone

end module test_polynomial
