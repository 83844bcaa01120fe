!> Steady motions with many harmonics: solution on two levels against all harmonics at once, and
!! automatic harmonics for each row.
module test_torus_orders
  use testing, only: begin, check, check_close, check_ok
  use viscovib_curve_newton, only: solve_on_curve
  use viscovib_drive_torus, only: drive_torus_type, every_order => lattice, kept_by_symmetry
  use viscovib_kinds, only: wp
  use viscovib_outcomes, only: outcome_converged
  use viscovib_pendulum, only: new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_status, only: status_type
  use viscovib_torus, only: new_torus, torus_type
  use viscovib_torus_balance, only: new_torus_balance, torus_balance_type, vary_amplitude
  use viscovib_torus_levels, only: new_levels, solve_on_levels, torus_levels
  use viscovib_torus_orders, only: new_ladder, torus_ladder, torus_responses
  use viscovib_torus_response, only: solve_from_rest
  implicit none
  private

  public :: run_torus_orders

contains

  subroutine run_torus_orders()
    integer :: axes
    if (begin('two levels of orders lead where all at once do')) then
      do axes = 2, 3
        call compare_levels(axes)
      end do
    end if
    if (begin('orders come and go with what a row of motions needs')) then
      do axes = 1, 2
        call choose_orders(axes)
      end do
    end if
  end subroutine run_torus_orders

  !> Solutions from rest via few harmonics, and from a neighbour, against Newton's method
  !! with all harmonics.
  subroutine compare_levels(axes)
    integer, intent(in) :: axes
    type(pendulum_type), target :: system
    type(torus_type) :: torus
    type(torus_balance_type) :: balance
    type(drive_torus_type) :: drives
    type(torus_levels) :: levels
    type(status_type) :: status
    real(wp), parameter :: amplitude(3) = [0.02_wp, 0.004_wp, 0.003_wp]
    real(wp), allocatable :: x(:), y(:), r(:)
    logical :: inside
    integer :: outcome, iterations, cancel

    call new_pendulum(system, &
                      pendulum_parameters(e=0.1_wp, w2=0.4_wp, w3=0.8_wp, alpha=0.5_wp, &
                                          damping=0.1_wp, load=1.0_wp), status)
    call check_ok(status)
    drives%n_axes = axes
    drives%orders = reshape([1, 0, 0, 0, 1, 0, 0, merge(1, 0, axes == 2), 1], [3, 3])
    drives%orders = drives%orders(:axes, :)
    call new_torus(torus, every_order(axes, merge(9, 5, axes == 2)), status)
    call check_ok(status)
    call new_torus_balance(balance, system, torus, drives%orders, &
                           [0.93_wp, 0.37_wp, 0.71_wp], amplitude, &
                           kept_by_symmetry(drives, torus%orders, amplitude, 0))
    balance%which = 1
    allocate (x(balance%n), r(balance%n))
    call new_levels(levels, balance, 60)
    call check(levels%ready .and. levels%inner%n < 100 .and. balance%n > 200, 'few of many')
    iterations = 0
    call solve_from_rest(balance, 0.93_wp, 1.0e-12_wp, x, outcome, iterations)
    call check(outcome == outcome_converged .and. iterations > 8, 'from rest')
    allocate (y, source=x)
    call solve_on_curve(balance, 0.93_wp, 1.0e-12_wp, y, outcome, iterations)
    call check(outcome == outcome_converged, 'from there')
    call check_close(maxval(abs(x - y)), 0.0_wp, 1.0e-14_wp, 'as Newton has it', floor=1.0_wp)
    call solve_on_levels(levels, balance, 0.95_wp, 1.0e-12_wp, x, outcome, iterations)
    call check(outcome == outcome_converged, 'a neighbour')
    call solve_on_curve(balance, 0.95_wp, 1.0e-12_wp, y, outcome, iterations)
    call check(outcome == outcome_converged, 'a neighbour by Newton')
    call check_close(maxval(abs(x - y)), 0.0_wp, 1.0e-14_wp, 'the same one', floor=1.0_wp)
    call balance%residual(x, 0.95_wp, r, inside)
    call check_close(maxval(abs(r)), 0.0_wp, 1.0e-13_wp, 'balanced', floor=1.0_wp)
    cancel = 1
    call solve_from_rest(balance, 0.93_wp, 1.0e-12_wp, x, outcome, iterations, cancel)
    call check(outcome /= outcome_converged, 'given up')
  end subroutine compare_levels

  !> A small motion, a large motion, and the small motion again.
  subroutine choose_orders(axes)
    integer, intent(in) :: axes
    type(pendulum_type), target :: system
    type(torus_ladder) :: ladder
    type(drive_torus_type) :: drives
    type(status_type) :: status
    integer, parameter :: last = 16
    real(wp), parameter :: amplitude(3) = [0.0_wp, 0.01_wp, 0.0_wp], tolerance = 1.0e-8_wp, &
                           p(4) = [0.002_wp, 0.02_wp, 0.002_wp, 0.002_wp]
    integer, allocatable :: orders(:, :)
    real(wp), allocatable :: x(:, :), guess(:)
    real(wp) :: truncation(4), error(4)
    integer :: outcome(4), iterations(4), highest(4)

    call new_pendulum(system, &
                      pendulum_parameters(e=0.1_wp, w2=0.4_wp, w3=0.8_wp, alpha=0.5_wp, &
                                          damping=0.1_wp, load=1.0_wp), status)
    call check_ok(status)
    drives%n_axes = axes
    if (axes == 1) drives%orders = reshape([2, 1, 0], [1, 3])
    if (axes == 2) drives%orders = reshape([0, 1, 1, 0, 0, 0], [2, 3])
    orders = every_order(axes, last + 2)
    call new_ladder(ladder, system, orders, kept_by_symmetry(drives, orders, [0.0_wp, 1.0_wp, &
                                                                              0.0_wp], 4), &
                    drives%orders, [0.37_wp, 0.93_wp], amplitude, vary_amplitude, 1, 3, last, 2)
    allocate (x((2*size(every_order(axes, last), 2) - 1)*3, 4))
    allocate (guess(size(x, 1)), source=0.0_wp)
    call torus_responses(ladder, p, tolerance, guess, x, outcome, iterations, highest, &
                         truncation, error, status)
    call check_ok(status)
    call check(all(outcome == outcome_converged), 'converged')
    call check(all(error > 0.0_wp .and. error <= tolerance), 'what is left')
    call check(all(truncation <= tolerance .and. truncation > 0.0_wp), 'judged')
    call check(highest(2) > highest(1) .and. highest(4) < highest(2), 'as many as needed')
    call check_close(maxval(abs(x(:, 4) - x(:, 1))), 0.0_wp, 2.0_wp*tolerance, 'as before', &
                     floor=maxval(abs(x(:, 1))))
  end subroutine choose_orders

end module test_torus_orders
