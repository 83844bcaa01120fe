!> Rules for the number of orders to add to a periodic solution, and for the number of orders of the
!! next one.
module viscovib_order_rules
  use viscovib_balance_ladder, only: balance_ladder_type, lowest_order
  use viscovib_kinds, only: wp
  use viscovib_limits, only: most_harmonics_chosen
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: weighted_norm
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: better_bound, better_rung, most_along, rung_for_next, times_as_many

  !> Orders below this fraction of the tolerance are dropped at the next point; if they are needed
  !! there, an additional solution is computed.
  real(wp), parameter, public :: idle = 0.1_wp
  !> Number of additions that do not halve the estimate before it counts as rounding error.
  integer, parameter, public :: max_vain = 2
  !> Highest order along a branch for polynomial forces.
  integer, parameter :: modest = 63

contains

  !> Upper limit of the orders along a branch, unless the load has higher ones: polynomial forces
  !! never need more, other forces may.
  pure integer function most_along(system, load)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    most_along = max(merge(modest, most_harmonics_chosen, system%degree > 0), &
                     lowest_order(load))
  end function most_along

  !> Factor of the number of orders that geometric decay suggests.
  pure real(wp) function times_as_many(truncation, tolerance) result(times)
    real(wp), intent(in) :: truncation, tolerance
    times = log(tolerance)/log(max(min(truncation, 0.5_wp), tiny(1.0_wp)))
  end function times_as_many

  !> The bound that the decay of the orders suggests, with a margin, at most about twice the bound.
  pure integer function better_bound(bound, truncation, tolerance, step, last) result(next)
    integer, intent(in) :: bound, step, last
    real(wp), intent(in) :: truncation, tolerance
    next = ceiling(1.05_wp*bound*times_as_many(truncation, tolerance))
    next = min(max(bound + step, next), 2*bound + 1, last)
  end function better_bound

  !> The rung that the decay of the orders suggests, at most about twice the orders.
  pure integer function better_rung(ladder, rung, truncation, tolerance) result(next)
    type(balance_ladder_type), intent(in) :: ladder
    integer, intent(in) :: rung
    real(wp), intent(in) :: truncation, tolerance
    integer :: k
    k = ladder%highest(rung)
    next = ceiling(k*min(times_as_many(truncation, tolerance), 2.0_wp))
    next = ladder%rung_of(min(next, 2*k + 1))
    next = min(max(next, rung + 1), ladder%n_rungs)
  end function better_rung

  !> The lowest rung that would still suffice here: the largest dropped order, scaled by the ratio
  !! of the truncation error to the omitted orders, must stay well below the tolerance.
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

end module viscovib_order_rules
