! Optimize: -O2
!> One periodic solution by Newton's method on the equations of harmonic balance.
module viscovib_newton_point
  use viscovib_counters, only: count_up, counted_turns, counting
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, follow_curve
  use viscovib_curve_newton, only: surely_near
  use viscovib_dense, only: factorize, solve
  use viscovib_harmonic_balance, only: balance_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: largest_norm, newton_factors, weighted_norm
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: new_oscillator_curve, oscillator_curve_type, vary_load
  use viscovib_outcomes, only: outcome_converged, outcome_diverged, outcome_overflow, &
    outcome_singular, outcome_stalled
  implicit none
  private

  public :: newton_point, point_from_rest

  !> Newton's method converges within a few iterations or not at all.
  integer, parameter :: max_iterations = 25
  !> A correction this much larger than the smallest so far means divergence.
  real(wp), parameter :: growth_limit = 1.0e4_wp
  !> Corrections that no longer shrink by this factor are rounding error, if they are below the
  !! second value: stiffnesses may differ by orders of magnitude.
  real(wp), parameter :: shrinking = 0.7_wp, small_enough = 1.0e-5_wp
  !> Rounding error of forces, sums of many products, relative to the largest term.
  real(wp), parameter :: rounded = 30.0_wp*epsilon(1.0_wp)
  !> Usual fraction of the largest possible rounding error.
  real(wp), parameter :: usual = 0.1_wp
  !> Largest number of points of a branch in the load.
  integer, parameter :: max_load_points = 2000

contains

  !> Solve at the present frequency and load of `balance`, from the initial guess x; x is unchanged
  !! unless the outcome is converged.
  subroutine newton_point(balance, system, tolerance, x, outcome, iterations, factors, &
                          to_rounding, least, second)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    !> Relative tolerance of the last correction, in the norm of `weighted_norm`.
    real(wp), intent(in) :: tolerance
    !> Shape (2 n_orders, n_dof).
    real(wp), intent(inout) :: x(:, :)
    integer, intent(out) :: outcome
    !> Iterations are added to it.
    integer, intent(inout) :: iterations
    !> Unchanged unless the outcome is converged. If present, corrections as small as the rounding
    !! error of forces are accepted; `rounding` is then their size.
    type(newton_factors), intent(inout), optional :: factors
    !> True if rounding error is accepted where it exceeds the tolerance.
    logical, intent(in), optional :: to_rounding
    !> Additional absolute tolerance, in the same norm.
    real(wp), intent(in), optional :: least
    !> The second correction relative to the first; 0 if there is none.
    real(wp), intent(out), optional :: second
    real(wp) :: new(size(x, 1), size(x, 2)), step(size(x, 1), size(x, 2))
    real(wp) :: jacobian(size(x), size(x))
    real(wp) :: change, before, smallest, norm, largest, besides, left, known
    integer :: pivots(size(x)), k
    logical :: singular, settled, stays

    new = x
    besides = 0.0_wp
    if (present(least)) besides = least
    if (present(second)) second = 0.0_wp
    largest = largest_norm(system)
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
      if (present(second) .and. k == 2) second = change/before
      norm = weighted_norm(system, new)
      if (.not. norm <= largest) then
        outcome = outcome_overflow
        return
      end if
      left = max(change, before)
      stays = k > 4 .and. change > shrinking*before .and. left <= small_enough*norm
      settled = .false.
      if (present(to_rounding)) settled = to_rounding .and. stays
      if (present(factors) .and. stays .and. .not. settled) then
        known = rounding_of(balance, system, new, jacobian, pivots)
        settled = left <= known
        ! Successive corrections share an error that they do not show.
        left = max(left, usual*known)
      end if
      before = change
      if (change <= tolerance*norm + besides .or. settled) then
        outcome = outcome_converged
        x = new
        if (present(factors)) then
          factors%lu = jacobian
          factors%pivots = pivots
          factors%rounding = merge(0.0_wp, left/norm, change <= tolerance*norm + besides)
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

  !> Size of corrections due to rounding of the forces, in the norm of `weighted_norm`: the error of
  !! each equation is `rounded` times its largest term of any order, since all orders share the
  !! errors of the samples. The signs are irregular.
  real(wp) function rounding_of(balance, system, x, lu, pivots) result(most)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(:, :)
    !> Factorized derivatives near x.
    real(wp), intent(in) :: lu(:, :)
    integer, intent(in) :: pivots(:)
    real(wp) :: derivatives(size(x), size(x)), moved(size(x, 1), size(x, 2))
    integer :: i, d

    call balance%derivatives(system, derivatives)
    moved = reshape(matmul(abs(derivatives), abs(reshape(x, [size(x)]))), shape(x))
    do d = 1, size(x, 2)
      moved(:, d) = rounded*maxval(moved(:, d))
      do i = 1, size(x, 1)
        moved(i, d) = sign(moved(i, d), cos(real((i + d)**2, wp)))
      end do
    end do
    moved(:balance%set%held(), :) = 0.0_wp
    call solve(size(x), lu, pivots, moved)
    most = weighted_norm(system, moved)
  end function rounding_of

  !> The motion on the curve that starts at zero without load, at the first point with the load of
  !! `balance`, through folds if necessary. If Newton's method from zero converges fast at once, its
  !! solution is that motion by the theorem of Kantorovich.
  subroutine point_from_rest(balance, system, load, tolerance, x, outcome, iterations, cancel, &
                             factors, to_rounding, least)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: tolerance
    real(wp), intent(out) :: x(:, :)
    integer, intent(out) :: outcome
    integer, intent(inout) :: iterations
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(newton_factors), intent(inout), optional :: factors
    !> As in `newton_point`.
    logical, intent(in), optional :: to_rounding
    real(wp), intent(in), optional :: least
    type(oscillator_curve_type) :: curve
    type(curve_branch_type) :: branch
    real(wp) :: second

    x = 0.0_wp
    call newton_point(balance, system, tolerance, x, outcome, iterations, factors, &
                      to_rounding, least, second)
    if (outcome == outcome_converged .and. second <= surely_near) return
    ! Without a load there is no curve to follow.
    if (size(load%orders) == 0 .or. .not. abs(balance%load_factor) > 0.0_wp) return
    call new_oscillator_curve(curve, system, load, balance%set, vary_load)
    call curve%balance%set_frequency(system, load, balance%nu)
    call follow_curve(curve, curve_options(0.0_wp, balance%load_factor, 1.0e-8_wp, &
                                           max_load_points, 0.3_wp), &
                      spread(0.0_wp, 1, curve%n), branch, cancel=cancel)
    iterations = iterations + sum(branch%iterations(:branch%n_points))
    if (branch%outcome /= curve_completed) return
    x = reshape(branch%x(:, branch%n_points), shape(x))
    call newton_point(balance, system, tolerance, x, outcome, iterations, factors, &
                      to_rounding, least)
  end subroutine point_from_rest

end module viscovib_newton_point
