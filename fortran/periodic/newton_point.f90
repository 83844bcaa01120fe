!> One periodic solution by Newton's method on the equations of harmonic balance.
module viscovib_newton_point
  use viscovib_counters, only: count_up, counted_turns, counting
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, follow_curve
  use viscovib_dense, only: factorize, solve
  use viscovib_harmonic_balance, only: balance_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: newton_factors, weighted_norm
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: new_oscillator_curve, oscillator_curve_type, vary_load
  use viscovib_outcomes, only: outcome_converged, outcome_diverged, outcome_overflow, &
    outcome_singular, outcome_stalled
  implicit none
  private

  public :: newton_point, point_from_rest

  !> Newton either settles within a few iterations or not at all.
  integer, parameter :: max_iterations = 25
  !> A correction this much larger than the smallest so far leads away.
  real(wp), parameter :: growth_limit = 1.0e4_wp
  !> Corrections that no longer shrink by this are rounding, if they are as small as rounding can
  !> be where stiffnesses lie far apart.
  real(wp), parameter :: shrinking = 0.7_wp, small_enough = 1.0e-5_wp
  !> Points of a branch in the load where Newton fails at once.
  integer, parameter :: max_load_points = 400

contains

  !> Solve at the frequency and load that `balance` is set to, from x on; x is left
  !! as it was found unless the outcome is converged.
  subroutine newton_point(balance, system, tolerance, x, outcome, iterations, factors, &
                          to_rounding, least)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    !> Relative size of the last correction, in the norm of `weighted_norm`.
    real(wp), intent(in) :: tolerance
    !> Shape (2 n_orders, n_dof).
    real(wp), intent(inout) :: x(:, :)
    integer, intent(out) :: outcome
    !> Added to.
    integer, intent(inout) :: iterations
    !> Left alone unless the outcome is converged.
    type(newton_factors), intent(inout), optional :: factors
    !> Whether what rounding leaves is enough where that is more than the tolerance.
    logical, intent(in), optional :: to_rounding
    !> Allowed besides, in the same norm.
    real(wp), intent(in), optional :: least
    real(wp) :: new(size(x, 1), size(x, 2)), step(size(x, 1), size(x, 2))
    real(wp) :: jacobian(size(x), size(x))
    real(wp) :: change, before, smallest, norm, besides
    integer :: pivots(size(x)), k
    logical :: singular, settled

    new = x
    besides = 0.0_wp
    if (present(least)) besides = least
    before = 0.0_wp
    smallest = sqrt(huge(1.0_wp))
    outcome = outcome_stalled
    do k = 1, max_iterations
      call balance%residual(system, new, step)
      call balance%derivatives(system, jacobian)
      call factorize(size(x), jacobian, pivots, singular)
      if (singular) then
        outcome = outcome_singular
        return
      end if
      call solve(size(x), jacobian, pivots, step)
      new = new - step
      iterations = iterations + 1
      if (counting) call count_up(counted_turns, 1)
      change = weighted_norm(system, step)
      norm = weighted_norm(system, new)
      if (.not. norm <= system%largest_amplitude()) then
        outcome = outcome_overflow
        return
      end if
      settled = .false.
      if (present(to_rounding)) settled = to_rounding .and. k > 4 .and. change > shrinking*before &
                                          .and. max(change, before) <= small_enough*norm
      before = change
      if (change <= tolerance*norm + besides .or. settled) then
        outcome = outcome_converged
        x = new
        if (present(factors)) then
          factors%lu = jacobian
          factors%pivots = pivots
        end if
        return
      end if
      if (change > growth_limit*smallest) then
        outcome = outcome_diverged
        return
      end if
      smallest = min(smallest, change)
    end do
  end subroutine newton_point

  !> Solve from the linear response, or, where that is too far away, by following
  !! the branch from no load to the whole, through folds if need be.
  subroutine point_from_rest(balance, system, load, tolerance, x, outcome, iterations, cancel, &
                             factors, to_rounding, least)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: tolerance
    real(wp), intent(out) :: x(:, :)
    integer, intent(out) :: outcome
    integer, intent(inout) :: iterations
    !> May be set from elsewhere to give up.
    integer, intent(inout), optional :: cancel
    type(newton_factors), intent(inout), optional :: factors
    !> As for `newton_point`.
    logical, intent(in), optional :: to_rounding
    real(wp), intent(in), optional :: least
    type(oscillator_curve_type) :: curve
    type(curve_branch_type) :: branch
    integer :: direct

    x = 0.0_wp
    call newton_point(balance, system, tolerance, x, outcome, iterations, factors, &
                      to_rounding, least)
    direct = outcome
    if (outcome == outcome_converged .or. size(load%orders) == 0) return
    ! Nothing leads to no load.
    if (.not. abs(balance%load_factor) > 0.0_wp) return
    call new_oscillator_curve(curve, system, load, balance%set, vary_load)
    call curve%balance%set_frequency(system, load, balance%nu)
    call follow_curve(curve, curve_options(0.0_wp, balance%load_factor, 1.0e-8_wp, &
                                           max_load_points, 0.3_wp), &
                      spread(0.0_wp, 1, curve%n), branch, cancel=cancel)
    iterations = iterations + sum(branch%iterations(:branch%n_points))
    if (branch%outcome /= curve_completed) then
      outcome = direct
      x = 0.0_wp
      return
    end if
    x = reshape(branch%x(:, branch%n_points), shape(x))
    call newton_point(balance, system, tolerance, x, outcome, iterations, factors, &
                      to_rounding, least)
  end subroutine point_from_rest

end module viscovib_newton_point
