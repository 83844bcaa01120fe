!> How many orders to add to a periodic solution that lacks some, and how many will do for
!! the next one.
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

  !> Orders are idle below this part of the tolerance: what is dropped here and missed at
  !! the next point costs another solution.
  real(wp), parameter, public :: idle = 0.1_wp
  !> Additions that may fail to halve the estimate before it is taken for rounding.
  integer, parameter, public :: max_vain = 2
  !> Highest order that is chosen along a branch whatever it brings.
  integer, parameter :: modest = 63

contains

  !> Highest order that is chosen along a branch, unless the load has higher ones: forces that are
  !! polynomials never need more, others may.
  pure integer function most_along(system, load)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    most_along = max(merge(modest, most_harmonics_chosen, system%degree > 0), &
                     lowest_order(load))
  end function most_along

  !> Orders fall off geometrically: how many times as many that suggests.
  pure real(wp) function times_as_many(truncation, tolerance) result(times)
    real(wp), intent(in) :: truncation, tolerance
    times = log(tolerance)/log(max(min(truncation, 0.5_wp), tiny(1.0_wp)))
  end function times_as_many

  !> As far as the fall of the orders suggests, and a little more, at most to twice as far.
  pure integer function better_bound(bound, truncation, tolerance, step, last) result(next)
    integer, intent(in) :: bound, step, last
    real(wp), intent(in) :: truncation, tolerance
    next = ceiling(1.05_wp*bound*times_as_many(truncation, tolerance))
    next = min(max(bound + step, next), 2*bound + 1, last)
  end function better_bound

  !> Go on as far as the fall of the orders suggests, at most to twice as many.
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

end module viscovib_order_rules
