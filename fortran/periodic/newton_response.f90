!> The nonlinear steady response by Newton's method, frequency by frequency, each
!! from its neighbour: like a slow sweep, it follows the branch it is on as far as
!! that goes.
module viscovib_newton_response
  use viscovib_balance_ladder, only: balance_ladder_type
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: newton_factors
  use viscovib_motion_stability, only: judge_type, new_judge
  use viscovib_newton_point, only: newton_point, point_from_rest
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged, outcome_singular, outcome_stopped
  use viscovib_point_orders, only: choose_orders, order_choice
  use viscovib_response, only: response_options, response_type
  use viscovib_stopping, only: stop_wanted
  implicit none
  private

  public :: newton_response

  !> Orders with which a point is sought from rest: enough not to be led astray.
  integer, parameter :: orders_from_rest = 9

contains

  subroutine newton_response(system, load, nu, ladder, options, response, cancel)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequencies (rad/s).
    real(wp), intent(in) :: nu(:)
    !> Harmonics to keep, or to choose from.
    type(balance_ladder_type), intent(inout) :: ladder
    type(response_options), intent(in) :: options
    type(response_type), intent(out) :: response
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile, optional :: cancel
    type(order_choice) :: choice
    type(newton_factors) :: factors
    real(wp), dimension(2*ladder%n_orders(ladder%n_rungs), system%n_dof()) :: x, last, before
    real(wp) :: last_nu, before_nu
    !> Rows of x that may be other than 0.
    integer :: rows
    integer :: i, m, outcome, known, rest

    rest = ladder%rung_of(orders_from_rest)
    call ladder%prepare(rest, system, load, nu(1))
    call response%allocate_for(nu, ladder%rungs(rest)%balance%set%orders, system%n_dof(), 0)
    choice%rung = rest
    rows = 0
    known = 0
    x = 0.0_wp
    last = 0.0_wp
    before = 0.0_wp
    last_nu = 0.0_wp
    do i = 1, size(nu)
      if (present(cancel)) then
        if (cancel /= 0) return
      end if
      if (stop_wanted()) then
        call response%discard(i, outcome_stopped)
        cycle
      end if
      outcome = outcome_singular
      if (known >= 2) then
        x(:rows, :) = last(:rows, :) + (last(:rows, :) - before(:rows, :)) &
                      *((nu(i) - last_nu)/(last_nu - before_nu))
        call attempt()
      end if
      if (outcome /= outcome_converged .and. known >= 1) then
        x(:rows, :) = last(:rows, :)
        call attempt()
      end if
      if (outcome /= outcome_converged) then
        known = 0
        choice%rung = rest
        call raise_load()
        ! With more orders, where adding them led nowhere.
        if (outcome /= outcome_converged .and. choice%rung > rest) call raise_load()
      end if
      if (outcome /= outcome_converged) then
        call response%discard(i, outcome)
        cycle
      end if
      call keep()
      ! Equal frequencies give no direction.
      if (known > 0 .and. .not. abs(nu(i) - last_nu) > 0.0_wp) known = 0
      rows = max(rows, m)
      before(:rows, :) = last(:rows, :)
      before_nu = last_nu
      last(:rows, :) = x(:rows, :)
      last_nu = nu(i)
      known = known + 1
    end do
    if (options%stability) then
      call judge_all(system, ladder%rungs(ladder%rung_of(maxval(response%orders)))%balance%set, &
                     response, cancel)
    end if
    call response%add_base_motion(system, load)

  contains

    !> Newton's method from x, of which orders that the rung lacks are dropped.
    subroutine attempt()
      call ladder%prepare(choice%rung, system, load, nu(i))
      m = 2*ladder%n_orders(choice%rung)
      x(m + 1:rows, :) = 0.0_wp
      call newton_point(ladder%rungs(choice%rung)%balance, system, options%tolerance, x(:m, :), &
                        outcome, response%iterations(i), factors)
      call add_orders()
    end subroutine attempt

    subroutine raise_load()
      call ladder%prepare(choice%rung, system, load, nu(i))
      m = 2*ladder%n_orders(choice%rung)
      x = 0.0_wp
      call point_from_rest(ladder%rungs(choice%rung)%balance, system, load, options%tolerance, &
                           x(:m, :), outcome, response%iterations(i), cancel, factors)
      call add_orders()
    end subroutine raise_load

    subroutine add_orders()
      if (outcome /= outcome_converged) return
      call choose_orders(ladder, system, load, nu(i), options%tolerance, x, factors, choice, &
                         outcome, response%iterations(i))
      rows = max(rows, 2*ladder%n_orders(max(choice%solved, choice%rung)))
    end subroutine add_orders

    subroutine keep()
      integer :: d, k
      k = ladder%n_orders(choice%solved)
      if (k > size(response%orders)) then
        call response%widen(ladder%rungs(choice%solved)%balance%set%orders)
      end if
      do d = 1, system%n_dof()
        response%coefficients(:k, d, i) = cmplx(x(1:2*k:2, d), x(2:2*k:2, d), wp)
      end do
      response%highest(i) = ladder%highest(choice%solved)
      response%truncation(i) = choice%truncation
    end subroutine keep

  end subroutine newton_response

  !> Stability of the motions found, in coordinates relative to the base.
  subroutine judge_all(system, set, response, cancel)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    type(response_type), intent(inout) :: response
    integer, intent(inout), volatile, optional :: cancel
    type(judge_type) :: judge
    real(wp), allocatable :: x(:, :, :)

    allocate (x(2*size(set%orders), system%n_dof(), size(response%nu)))
    x(1::2, :, :) = real(response%coefficients)
    x(2::2, :, :) = aimag(response%coefficients)
    call new_judge(judge, system, set)
    call judge%judge(system, response%nu, x, response%stability, cancel)
  end subroutine judge_all

end module viscovib_newton_response
