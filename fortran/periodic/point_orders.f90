!> Adaptation of the orders of one periodic solution: orders are added until the truncation error is
!! negligible, and the next solution nearby starts with as few as will probably suffice.
!!
!! The next solution may be at another frequency or at a step along a branch.
module viscovib_point_orders
  use viscovib_balance_ladder, only: balance_ladder_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: newton_factors, share_of_motion, weighted_norm
  use viscovib_newton_point, only: newton_point
  use viscovib_order_rules, only: better_rung, max_vain, rung_for_next
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged
  use viscovib_truncation, only: estimate_truncation
  implicit none
  private

  public :: choose_orders, order_choice

  type :: order_choice
    !> Rung to begin with at the next point, or at this point again if it failed.
    integer :: rung = 1
    !> Rung of this solution, and its estimated relative error.
    integer :: solved = 1
    real(wp) :: truncation = 0.0_wp
  end type order_choice

contains

  !> From a solution on the rung `choice%rung`, add orders until the estimated truncation error
  !! meets the tolerance or the highest rung is reached.
  subroutine choose_orders(ladder, system, load, nu, tolerance, x, factors, choice, outcome, &
                           iterations)
    type(balance_ladder_type), intent(inout) :: ladder
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequency (rad/s); the load factor is that of the rung's balance.
    real(wp), intent(in) :: nu
    !> Relative tolerance of the iteration and of the truncation; the ladder adds the absolute one.
    real(wp), intent(in) :: tolerance
    !> Shape (2 n_orders of the highest rung, n_dof), 0 beyond the included orders.
    real(wp), intent(inout) :: x(:, :)
    !> Factorized derivatives at x.
    type(newton_factors), intent(inout) :: factors
    type(order_choice), intent(inout) :: choice
    !> Converged, or the failure of Newton's method with more orders.
    integer, intent(out) :: outcome
    !> Iterations are added to it.
    integer, intent(inout) :: iterations
    real(wp), allocatable :: change(:, :)
    real(wp) :: outside, previous, factor, allowed, share
    integer :: rung, next, m, n, vain

    rung = choice%rung
    factor = ladder%rungs(rung)%balance%load_factor
    outcome = outcome_converged
    previous = huge(1.0_wp)
    vain = 0
    do
      m = 2*ladder%n_orders(rung)
      n = 2*ladder%n_orders(ladder%probe_of(rung))
      call ladder%prepare_probe(rung, system, load, nu)
      if (allocated(change)) deallocate (change)
      allocate (change(n, size(x, 2)))
      associate (probe => ladder%rungs(ladder%probe_of(rung)))
        probe%balance%load_factor = factor
        call estimate_truncation(probe%balance, probe%compliance, system, x(:m, :), factors, &
                                 change, choice%truncation, outside)
      end associate
      choice%solved = rung
      ! More orders do not improve the motion beyond its rounding error.
      share = share_of_motion(system, load, factor, ladder%rungs(rung)%balance%set%orders, x(:m, :))
      choice%truncation = max(choice%truncation, factors%rounding)/share
      outside = outside/share
      allowed = max(ladder%allowed(tolerance, share*weighted_norm(system, x)), &
                    factors%rounding/share)
      if (choice%truncation <= allowed .or. rung == ladder%n_rungs) exit
      if (choice%truncation > 0.5_wp*previous .and. outside <= allowed) vain = vain + 1
      if (vain >= max_vain) exit
      previous = choice%truncation
      next = better_rung(ladder, rung, choice%truncation, allowed)
      n = min(n, 2*ladder%n_orders(next))
      x(:n, :) = x(:n, :) + change(:n, :)
      rung = next
      call ladder%prepare(rung, system, load, nu)
      m = 2*ladder%n_orders(rung)
      ladder%rungs(rung)%balance%load_factor = factor
      call newton_point(ladder%rungs(rung)%balance, system, tolerance, x(:m, :), outcome, &
                        iterations, factors, least=ladder%least)
      if (outcome /= outcome_converged) then
        choice%rung = rung
        return
      end if
    end do
    choice%rung = rung_for_next(ladder, system, x, choice%truncation, outside, allowed, rung)
  end subroutine choose_orders

end module viscovib_point_orders
