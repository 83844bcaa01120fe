!> The choice of orders for one periodic solution: added until what is left out does not
!! count, and for the next solution nearby as few as will probably do.
!!
!! Nothing here knows what the next solution is, a frequency further or a step along a
!! branch.
module viscovib_point_orders
  use viscovib_balance_ladder, only: balance_ladder_type, probe_rungs
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_newton_point, only: newton_factors, newton_point, weighted_norm
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged
  use viscovib_truncation, only: estimate_truncation
  implicit none
  private

  public :: choose_orders, order_choice

  !> Orders are idle below this part of the tolerance: what is dropped here and missed at
  !! the next point costs another solution.
  real(wp), parameter :: idle = 0.1_wp
  !> Additions that may fail to halve the estimate before it is taken for rounding.
  integer, parameter :: max_vain = 2

  type :: order_choice
    !> Where to begin at the next point, or at this one again if it failed.
    integer :: rung = 1
    !> What this point was solved with, and its estimated relative error.
    integer :: solved = 1
    real(wp) :: truncation = 0.0_wp
  end type order_choice

contains

  !> From a solution on the rung `choice%rung`, add orders until the estimated truncation
  !! meets the tolerance or the rungs end.
  subroutine choose_orders(ladder, system, load, nu, tolerance, x, factors, choice, outcome, &
                           iterations)
    type(balance_ladder_type), intent(inout) :: ladder
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequency (rad/s); the load's factor is that of the rung's balance.
    real(wp), intent(in) :: nu
    !> Relative, of the iteration and of the truncation.
    real(wp), intent(in) :: tolerance
    !> Shape (2 n_orders of the highest rung, n_dof), 0 beyond the orders kept.
    real(wp), intent(inout) :: x(:, :)
    !> The derivatives at x.
    type(newton_factors), intent(inout) :: factors
    type(order_choice), intent(inout) :: choice
    !> Converged, or how Newton's method failed with more orders.
    integer, intent(out) :: outcome
    !> Added to.
    integer, intent(inout) :: iterations
    real(wp), allocatable :: change(:, :)
    real(wp) :: outside, previous, factor
    integer :: rung, next, m, n, vain

    rung = choice%rung
    factor = ladder%rungs(rung)%balance%load_factor
    outcome = outcome_converged
    previous = huge(1.0_wp)
    vain = 0
    do
      m = 2*ladder%n_orders(rung)
      n = 2*ladder%n_orders(rung + probe_rungs)
      call ladder%prepare_probe(rung, system, load, nu)
      if (allocated(change)) deallocate (change)
      allocate (change(n, size(x, 2)))
      associate (probe => ladder%rungs(rung + probe_rungs))
        probe%balance%load_factor = factor
        call estimate_truncation(probe%balance, probe%compliance, system, x(:m, :), factors, &
                                 change, choice%truncation, outside)
      end associate
      choice%solved = rung
      if (choice%truncation <= tolerance .or. rung == ladder%n_rungs) exit
      if (choice%truncation > 0.5_wp*previous .and. outside <= tolerance) vain = vain + 1
      if (vain >= max_vain) exit
      previous = choice%truncation
      next = better_rung(ladder, rung, choice%truncation, tolerance)
      n = min(n, 2*ladder%n_orders(next))
      x(:n, :) = x(:n, :) + change(:n, :)
      rung = next
      call ladder%prepare(rung, system, load, nu)
      m = 2*ladder%n_orders(rung)
      ladder%rungs(rung)%balance%load_factor = factor
      call newton_point(ladder%rungs(rung)%balance, system, tolerance, x(:m, :), outcome, &
                        iterations, factors)
      if (outcome /= outcome_converged) then
        choice%rung = rung
        return
      end if
    end do
    choice%rung = rung_for_next(ladder, system, x, choice%truncation, outside, tolerance, rung)
  end subroutine choose_orders

  !> Orders fall off geometrically: go on as far as that suggests, at most to twice as
  !! many.
  pure integer function better_rung(ladder, rung, truncation, tolerance) result(next)
    type(balance_ladder_type), intent(in) :: ladder
    integer, intent(in) :: rung
    real(wp), intent(in) :: truncation, tolerance
    real(wp) :: fall
    integer :: k
    fall = log(tolerance)/log(max(min(truncation, 0.5_wp), tiny(1.0_wp)))
    k = ladder%highest(rung)
    next = ladder%rung_of(min(ceiling(k*min(fall, 2.0_wp)), 2*k + 1))
    next = min(max(next, rung + 1), ladder%n_rungs)
  end function better_rung

  !> The lowest rung that would still do here: with the share of the change that the orders
  !! left out have in it, the largest order beyond stays well below the tolerance.
  pure integer function rung_for_next(ladder, system, x, truncation, outside, tolerance, rung) &
    result(next)
    type(balance_ladder_type), intent(in) :: ladder
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(:, :), truncation, outside, tolerance
    integer, intent(in) :: rung
    real(wp) :: limit
    integer :: m

    next = rung
    if (truncation > idle*tolerance) return
    limit = idle*tolerance*weighted_norm(system, x)
    if (outside > 0.0_wp) limit = limit*min(1.0_wp, outside/truncation)
    do while (next > 1)
      m = 2*ladder%n_orders(next - 1)
      if (weighted_norm(system, x(m + 1:2*ladder%n_orders(next), :)) > limit) exit
      next = next - 1
    end do
  end function rung_for_next

end module viscovib_point_orders
