!> Harmonic balance on a torus: transforms there and back, derivatives against
!! differences, a curve with a known fold and a known branch point.
module test_torus
  use testing, only: begin, check, check_close, check_ok
  use viscovib_constants, only: pi
  use viscovib_curve, only: curve_type
  use viscovib_curve_branch, only: curve_branch_type, curve_closed, curve_completed, &
    curve_options, follow_curve
  use viscovib_free_curve, only: free_curve_type, new_free_curve
  use viscovib_kinds, only: wp
  use viscovib_pendulum, only: equations_cubic, equations_exact, equations_printed, &
    new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_status, only: status_type
  use viscovib_torus, only: new_torus, torus_type
  use viscovib_torus_balance, only: new_torus_balance, torus_balance_type, vary_amplitude, &
    vary_factor, vary_frequency
  implicit none
  private

  public :: run_torus

  !> x_1^2 + p^2 = 1, and x_2 (x_2^2 - x_1 - 1/2) = 0.
  type, extends(curve_type) :: circle_type
  contains
    procedure :: equations => circle_equations
    procedure :: raise_terms => circle_terms
  end type circle_type

contains

  subroutine run_torus()
    integer :: axes, variant
    if (begin('samples and orders lead to each other')) then
      do axes = 1, 3
        call there_and_back(axes)
      end do
    end if
    if (begin('derivatives on a torus are those of the residual')) then
      do axes = 1, 3
        do variant = equations_exact, equations_printed
          call compare_derivatives(axes, variant)
        end do
      end do
    end if
    if (begin('derivatives of free motions are those of the residual')) then
      do variant = equations_exact, equations_cubic
        call compare_free(variant, 0)
        call compare_free(variant, 2)
      end do
    end if
    if (begin('folds and branch points of a circle')) call around_a_circle()
    if (begin('lattices that are none are refused')) call refuse()
  end subroutine run_torus

  function lattice(axes) result(orders)
    integer, intent(in) :: axes
    integer, allocatable :: orders(:, :)
    select case (axes)
    case (1)
      orders = reshape([0, 1, 2, 3, 5], [1, 5])
    case (2)
      ! Fourier coefficients to 12 from 20 samples along the first axis.
      orders = reshape([0, 0, 1, 0, 0, 1, 1, -1, 2, 1, 0, 3, 3, -2, 6, -1], [2, 8])
    case default
      orders = reshape([0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, -1, 2, 0, 1, -1, 2, 1, 0], [3, 7])
    end select
  end function lattice

  subroutine there_and_back(axes)
    integer, intent(in) :: axes
    type(torus_type) :: torus
    type(status_type) :: status
    real(wp), allocatable :: x(:), y(:), u(:)
    complex(wp), allocatable :: c(:), one(:)
    real(wp) :: angle(3), direct
    integer :: k, s, rest

    call new_torus(torus, lattice(axes), status)
    call check_ok(status)
    allocate (x(torus%n), y(torus%n), u(torus%n_samples), c(torus%n_moments))
    allocate (one(size(torus%orders, 2)), source=(1.0_wp, 0.0_wp))
    x = [(cos(3.0_wp*k + 1.0_wp), k=1, torus%n)]
    call torus%to_samples(x, one, u)
    s = torus%n_samples/3 + 2
    rest = s - 1
    do k = 1, 3
      angle(k) = 2.0_wp*pi*modulo(rest, torus%n_points(k))/torus%n_points(k)
      rest = rest/torus%n_points(k)
    end do
    direct = x(1)
    do k = 2, size(torus%orders, 2)
      associate (a => sum(torus%orders(:, k)*angle(:axes)))
        direct = direct + x(2*k - 2)*sin(a) + x(2*k - 1)*cos(a)
      end associate
    end do
    call check_close(u(s), direct, 1.0e-13_wp, 'a sample', floor=1.0_wp)
    call torus%harmonics(u, y)
    call check_close(maxval(abs(x - y)), 0.0_wp, 1.0e-13_wp, 'and back', floor=1.0_wp)
    call torus%moments(u, c)
    do k = 2, size(torus%orders, 2)
      associate (one_of => c(torus%origin + torus%place(k)))
        call check_close(abs(one_of - cmplx(0.5_wp*x(2*k - 1), -0.5_wp*x(2*k - 2), wp)), 0.0_wp, &
                         1.0e-14_wp, 'a moment', floor=1.0_wp)
      end associate
    end do
    call check_close(maxval(abs(c - conjg(c(size(c):1:-1)))), 0.0_wp, 1.0e-14_wp, 'real', &
                     floor=1.0_wp)
  end subroutine there_and_back

  subroutine compare_derivatives(axes, variant)
    integer, intent(in) :: axes, variant
    type(pendulum_type), target :: system
    type(torus_type) :: torus
    type(torus_balance_type) :: balance
    type(status_type) :: status
    real(wp), allocatable :: x(:), r(:), above(:), below(:), slope(:), along(:), matrix(:, :)
    real(wp), allocatable :: spare(:, :), direction(:)
    real(wp), parameter :: h = 1.0e-5_wp
    integer, parameter :: drives(3, 3) = reshape([1, 0, 0, 1, 1, 0, 2, 0, 1], [3, 3])
    real(wp) :: p
    logical :: inside
    integer :: k, vary

    call new_pendulum(system, &
                      pendulum_parameters(e=0.1_wp, w2=0.4_wp, w3=0.8_wp, alpha=0.5_wp, &
                                          damping=[0.1_wp, 0.2_wp, 0.3_wp], load=1.0_wp, &
                                          equations=variant), status)
    call check_ok(status)
    call new_torus(torus, lattice(axes), status)
    call check_ok(status)
    call new_torus_balance(balance, system, torus, drives(:axes, :), [0.9_wp, 0.37_wp, 0.71_wp], &
                           [0.1_wp, 0.2_wp, 0.3_wp])
    allocate (r(balance%n), above(balance%n), below(balance%n), slope(balance%n))
    allocate (along(balance%n), matrix(balance%n, balance%n), spare(balance%n, balance%n))
    allocate (x(balance%n), direction(balance%n), source=0.0_wp)
    x = [(0.1_wp*cos(3.0_wp*k), k=1, balance%n)]/torus%n_axes
    direction = [(cos(2.0_wp*k + 1.0_wp), k=1, balance%n)]
    do vary = vary_frequency, vary_factor
      balance%vary = vary
      balance%which = axes
      p = merge(0.3_wp, 1.2_wp, vary == vary_amplitude)
      call balance%equations(x + h*direction, p, above, spare, slope, inside)
      call balance%equations(x - h*direction, p, below, spare, slope, inside)
      along = (above - below)/(2.0_wp*h)
      call balance%equations(x, p, r, matrix, slope, inside)
      call check(inside, 'within range')
      call check_close(maxval(abs(matmul(matrix, direction) - along)), 0.0_wp, 1.0e-8_wp, &
                       'along a direction', floor=maxval(abs(along)))
      call balance%equations(x, p + h, above, spare, along, inside)
      call balance%equations(x, p - h, below, spare, along, inside)
      call check_close(maxval(abs(slope - (above - below)/(2.0_wp*h))), 0.0_wp, 1.0e-8_wp, &
                       'along the parameter', floor=maxval(abs(slope)))
      call balance%set_parameter(p)
    end do
    x(1) = -1.5_wp
    call balance%equations(x, p, r, matrix, slope, inside)
    call check(.not. inside, 'out of range')
  end subroutine compare_derivatives

  !> Free motions by the amplitude of a coordinate, or by energy.
  subroutine compare_free(variant, dof)
    integer, intent(in) :: variant, dof
    type(pendulum_type), target :: system
    type(torus_type) :: torus
    type(free_curve_type) :: curve
    type(status_type) :: status
    real(wp), allocatable, dimension(:) :: x, r, above, below, slope, along, direction
    real(wp), allocatable :: matrix(:, :)
    real(wp), parameter :: h = 1.0e-5_wp
    logical :: inside, kept(5, 3)
    integer :: k

    call new_pendulum(system, pendulum_parameters(e=0.1_wp, w2=0.4_wp, w3=0.8_wp, alpha=0.5_wp, &
                                                  equations=variant), status)
    call check_ok(status)
    call new_torus(torus, lattice(1), status)
    call check_ok(status)
    kept = .true.
    kept(2, 1) = .false.
    call new_free_curve(curve, system, torus, kept, 0.4_wp, dof, 1)
    call check(curve%n == 15, 'cosines kept, and the frequency')
    allocate (matrix(curve%n, curve%n), r(curve%n), above(curve%n), below(curve%n))
    allocate (slope(curve%n), along(curve%n))
    x = [(0.1_wp*cos(3.0_wp*k), k=1, curve%n)]
    direction = [(cos(2.0_wp*k + 1.0_wp), k=1, curve%n)]
    call curve%equations(x + h*direction, 0.3_wp, above, matrix, slope, inside)
    call curve%equations(x - h*direction, 0.3_wp, below, matrix, slope, inside)
    along = (above - below)/(2.0_wp*h)
    call curve%equations(x, 0.3_wp, r, matrix, slope, inside)
    call check(inside, 'within range')
    call check_close(maxval(abs(matmul(matrix, direction) - along)), 0.0_wp, 1.0e-8_wp, &
                     'along a direction', floor=maxval(abs(along)))
    call curve%equations(x, 0.3_wp + h, above, matrix, along, inside)
    call curve%equations(x, 0.3_wp - h, below, matrix, along, inside)
    call check_close(maxval(abs(slope - (above - below)/(2.0_wp*h))), 0.0_wp, 1.0e-8_wp, &
                     'along the size', floor=1.0_wp)
  end subroutine compare_free

  subroutine circle_equations(self, x, p, r, jacobian, slope, inside)
    class(circle_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    real(wp), intent(inout) :: jacobian(:, :)
    real(wp), intent(out) :: slope(:)
    logical, intent(out) :: inside
    inside = p > self%lowest
    r = [x(1)**2 + p**2 - 1.0_wp, x(2)*(x(2)**2 - x(1) - 0.5_wp)]
    jacobian(1, :2) = [2.0_wp*x(1), 0.0_wp]
    jacobian(2, :2) = [-x(2), 3.0_wp*x(2)**2 - x(1) - 0.5_wp]
    slope = [2.0_wp*p, 0.0_wp]
  end subroutine circle_equations

  !> Terms that cancel at a zero of the second factor.
  subroutine circle_terms(self, x, p, terms)
    class(circle_type), intent(in) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(inout) :: terms(:)
    if (p > self%lowest) terms = max(terms, [x(1)**2, abs(x(2)**3)])
  end subroutine circle_terms

  subroutine around_a_circle()
    type(circle_type) :: circle
    type(curve_branch_type) :: branch, other
    type(curve_options) :: options
    integer :: i

    circle%n = 2
    options = curve_options(start=0.0_wp, finish=2.0_wp, max_points=500)
    call follow_curve(circle, options, [1.0_wp, 0.0_wp], branch)
    call check(branch%folds%n == 1, 'one fold before p falls back behind the start')
    call check_close(branch%folds%p(1), 1.0_wp, 1.0e-12_wp, 'fold')
    call check(branch%branch_points%n == 1, 'one branch point')
    call check_close(branch%branch_points%p(1), sqrt(0.75_wp), 1.0e-9_wp, 'branch point')
    associate (across => branch%branch_points%across(:, 1))
      call check_close(abs(across(2)), 1.0_wp, 1.0e-6_wp, 'leads along x_2')
    end associate
    ! The parabola x_2^2 = x_1 + 1/2 over the circle, a closed curve.
    options = curve_options(start=-2.0_wp, finish=2.0_wp, max_points=500)
    call follow_curve(circle, options, branch%branch_points%x(:, 1), other, &
                      branch%branch_points%p(1), branch%branch_points%across(:, 1))
    call check(other%outcome == curve_closed, 'closed')
    do i = 3, other%n_points - 2
      call check_close(other%x(2, i)**2, other%x(1, i) + 0.5_wp, 1.0e-8_wp, 'on it', floor=1.0_wp)
    end do
    options = curve_options(start=0.0_wp, finish=0.9_wp, max_points=500)
    call follow_curve(circle, options, [1.0_wp, 0.0_wp], branch)
    call check(branch%outcome == curve_completed, 'ends where wanted')
    call check_close(branch%x(1, branch%n_points), sqrt(0.19_wp), 1.0e-10_wp, 'and exactly there')
  end subroutine around_a_circle

  subroutine refuse()
    type(torus_type) :: torus
    type(status_type) :: status
    call new_torus(torus, reshape([0, 0, -1, 2], [2, 2]), status)
    call check(status%failed(), 'the wrong half')
    call new_torus(torus, reshape([1, 0], [1, 2]), status)
    call check(status%failed(), 'no mean')
    call new_torus(torus, reshape([0, 0, 0, 0], [4, 1]), status)
    call check(status%failed(), 'too many axes')
  end subroutine refuse

end module test_torus
