!> Harmonic balance: derivatives against differences, and choice of orders.
module test_balance
  use testing, only: begin, check, check_close, check_ok
  use viscovib_balance_ladder, only: balance_ladder_type, new_ladder
  use viscovib_catalogue, only: kernel_rzhanitsyn, new_kernel
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_mount, only: geometry_cubic, geometry_exact, geometry_printed, mount_parameters, &
    mount_type, new_mount
  use viscovib_motion_norm, only: newton_factors
  use viscovib_newton_point, only: newton_point, point_from_rest
  use viscovib_outcomes, only: outcome_converged
  use viscovib_point_orders, only: choose_orders, order_choice
  use viscovib_status, only: status_type
  implicit none
  private

  public :: run_balance

contains

  subroutine run_balance()
    integer :: geometry
    if (begin('derivatives are those of the residual')) then
      do geometry = geometry_exact, geometry_printed
        call compare_derivatives(geometry, .true.)
        call compare_derivatives(geometry, .false.)
      end do
    end if
    if (begin('rungs hold the orders that a load moves')) then
      call climb([1], .true., [1, 3, 5, 7])
      call climb([3], .true., [3, 9, 15, 21])
      call climb([3, 5], .true., [5, 7, 9, 11])
      call climb([0, 1], .false., [1, 3, 5, 7])
      call climb([0, 4], .false., [4, 12, 20, 28])
      call climb([integer ::], .true., [1, 3, 5, 7])
    end if
    if (begin('orders are added to a solution that lacks them')) call add_orders()
  end subroutine run_balance

  subroutine example(geometry, with_memory, load, mount, series)
    integer, intent(in) :: geometry
    logical, intent(in) :: with_memory
    real(wp), intent(in) :: load
    type(mount_type), intent(out) :: mount
    type(load_type), intent(out) :: series
    type(kernel_holder) :: kernels(1)
    type(mount_parameters) :: p
    type(status_type) :: status

    p = mount_parameters(mass=1.0_wp, inertia=0.1_wp, offset=0.5_wp, stiffness_x=10.0_wp, &
                         stiffness_phi=2.0_wp, geometry=geometry)
    p%damping = 0.02_wp*reshape([10.0_wp, -5.0_wp, -5.0_wp, 4.5_wp], [2, 2])
    if (with_memory) then
      p%kernel_x = 1
      p%kernel_phi = 1
    end if
    call new_kernel(kernels(1)%kernel, kernel_rzhanitsyn, [0.048_wp, 0.1_wp, 0.05_wp], status)
    call check_ok(status)
    call new_mount(mount, p, kernels, status)
    call check_ok(status)
    call new_load(series, 2, [0, 1], reshape([(0.0_wp, 0.1_wp), (0.0_wp, 0.2_wp), &
                                              cmplx(load, 0.0_wp, wp), (0.1_wp, 0.3_wp)], [2, 2]), &
                  [(0.0_wp, 0.0_wp), (0.01_wp, 0.0_wp)], status)
    call check_ok(status)
  end subroutine example

  !> At coefficients that are not a solution, all harmonics nonzero.
  subroutine compare_derivatives(geometry, half_wave)
    integer, intent(in) :: geometry
    logical, intent(in) :: half_wave
    type(mount_type) :: mount
    type(load_type) :: load
    type(harmonic_set_type) :: set
    type(balance_type) :: balance
    real(wp), allocatable :: x(:, :), above(:, :), below(:, :), jacobian(:, :), slope(:, :)
    real(wp) :: scale
    real(wp), parameter :: h = 1.0e-5_wp
    integer :: i, d, m

    call example(geometry, .true., 0.5_wp, mount, load)
    call new_harmonic_set(set, 5, half_wave, mount%degree)
    call new_balance(balance, mount, set)
    call balance%set_frequency(mount, load, 1.7_wp)
    m = 2*size(set%orders)
    allocate (x(m, 2), above(m, 2), below(m, 2), slope(m, 2), jacobian(2*m, 2*m))
    do d = 1, 2
      do i = 1, m
        x(i, d) = 0.5_wp*sin(2.3_wp*i + d)/i
      end do
    end do
    call balance%residual(mount, x, above)
    call balance%derivatives(mount, jacobian)
    scale = maxval(abs(jacobian))
    do d = 1, 2
      do i = 1, m
        x(i, d) = x(i, d) + h
        call balance%residual(mount, x, above)
        x(i, d) = x(i, d) - 2.0_wp*h
        call balance%residual(mount, x, below)
        x(i, d) = x(i, d) + h
        call check_close(maxval(abs(reshape((above - below)/(2.0_wp*h), [2*m]) &
                                    - jacobian(:, i + m*(d - 1)))), 0.0_wp, 1.0e-9_wp, &
                         'column', floor=scale)
      end do
    end do
    call balance%residual(mount, x, above)
    call balance%frequency_derivative(mount, load, x, slope)
    call balance%set_frequency(mount, load, 1.7_wp + h)
    call balance%residual(mount, x, above)
    call balance%set_frequency(mount, load, 1.7_wp - h)
    call balance%residual(mount, x, below)
    call check_close(maxval(abs((above - below)/(2.0_wp*h) - slope)), 0.0_wp, 1.0e-9_wp, &
                     'slope in the frequency', floor=maxval(abs(slope)))
    call balance%set_frequency(mount, load, 1.7_wp)
    call balance%load_derivative(slope)
    balance%load_factor = 2.0_wp
    call balance%residual(mount, x, above)
    balance%load_factor = 1.0_wp
    call balance%residual(mount, x, below)
    call check_close(maxval(abs(above - below - slope)), 0.0_wp, 1.0e-14_wp, 'slope in the load', &
                     floor=1.0_wp)
  end subroutine compare_derivatives

  subroutine climb(orders, half_wave, highest)
    integer, intent(in) :: orders(:), highest(:)
    logical, intent(in) :: half_wave
    type(balance_ladder_type) :: ladder
    type(mount_type) :: mount
    type(load_type) :: unused, load
    type(status_type) :: status
    complex(wp) :: force(2, size(orders)), base(size(orders))
    integer :: i

    call example(geometry_cubic, .false., 0.5_wp, mount, unused)
    force = (0.0_wp, 1.0_wp)
    base = (0.0_wp, 0.0_wp)
    call new_load(load, 2, orders, force, base, status)
    call check_ok(status)
    call new_ladder(ladder, mount, load, half_wave, highest(4) + 1)
    call check(ladder%n_rungs == 4, 'as many rungs as fit')
    do i = 1, 4
      call check(ladder%highest(i) == highest(i), 'highest order')
      call check(ladder%rung_of(highest(i)) == i, 'rung of an order')
      call ladder%prepare(i, mount, load, 1.0_wp)
      call check(size(ladder%rungs(i)%balance%set%orders) == ladder%n_orders(i), 'orders')
    end do
    call check(ladder%rung_of(highest(2) + 1) == 3, 'the next rung up')
    call check(ladder%rung_of(1000) == 4, 'the highest rung')
  end subroutine climb

  !> Start with harmonics 0 and 1 only, at a load factor other than 1: the same result as with
  !! all harmonics at once.
  subroutine add_orders()
    type(mount_type) :: mount
    type(load_type) :: load
    type(balance_ladder_type) :: ladder
    type(order_choice) :: choice
    type(newton_factors) :: factors
    real(wp), allocatable :: x(:, :), exact(:, :)
    integer :: outcome, iterations, m

    call example(geometry_exact, .true., 0.5_wp, mount, load)
    call new_ladder(ladder, mount, load, .false., 41)
    allocate (x(2*ladder%n_orders(ladder%n_rungs), 2), source=0.0_wp)
    allocate (exact, source=x)
    iterations = 0
    call ladder%prepare(1, mount, load, 1.5_wp)
    m = 2*ladder%n_orders(1)
    ladder%rungs(1)%balance%load_factor = 0.8_wp
    call point_from_rest(ladder%rungs(1)%balance, mount, load, 1.0e-11_wp, x(:m, :), outcome, &
                         iterations, factors=factors)
    call check(outcome == outcome_converged, 'found with few orders')
    call choose_orders(ladder, mount, load, 1.5_wp, 1.0e-9_wp, x, factors, choice, outcome, &
                       iterations)
    call check(outcome == outcome_converged, 'found with more')
    call check(choice%truncation <= 1.0e-9_wp, 'enough of them')
    call check(choice%solved > 3 .and. choice%solved < ladder%n_rungs, 'and not too many')
    exact = x
    call ladder%prepare(ladder%n_rungs, mount, load, 1.5_wp)
    ladder%rungs(ladder%n_rungs)%balance%load_factor = 0.8_wp
    call newton_point(ladder%rungs(ladder%n_rungs)%balance, mount, 1.0e-13_wp, exact, outcome, &
                      iterations)
    call check(maxval(abs(x - exact)) < 2.0e-9_wp*maxval(abs(exact)), 'true error')
    call check(.not. any(abs(x(2*ladder%n_orders(choice%solved) + 1:, :)) > 0.0_wp), 'nothing else')
    call check(choice%rung <= choice%solved, 'the next point begins here or below')
    call check(size(ladder%rungs) == ladder%n_rungs + 1, 'one to judge the highest')
  end subroutine add_orders

end module test_balance
