! Optimize: -O2
!> A branch of periodic motions of an oscillator over a frequency, a load factor or a parameter,
!! with given or adapted orders.
module viscovib_response_branch
  use viscovib_balance_ladder, only: balance_ladder_type, new_ladder, one_rung
  use viscovib_crossing_errors, only: branch_point_error
  use viscovib_curve_branch, only: curve_branch_type, curve_options, follow_curve
  use viscovib_curve_events, only: special_points
  use viscovib_damped_start, only: point_from_damping
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_motion_norm, only: weighted_norm
  use viscovib_newton_point, only: newton_point, point_from_rest
  use viscovib_oscillator_curve, only: oscillator_curve_type
  use viscovib_order_rules, only: most_along
  use viscovib_outcomes, only: outcome_converged, outcome_stalled
  use viscovib_response_plan, only: response_plan_type
  use viscovib_sized_curve, only: refitted
  use viscovib_stopping, only: given_up, is_set
  implicit none
  private

  public :: departure_type, follow_response

  !> Highest order of a search from zero: enough to avoid spurious solutions.
  integer, parameter :: orders_from_rest = 9

  !> Start from another branch: unknowns of all orders that the plan allows, shape (n), the
  !! parameter, and the direction, shape (n + 1); direction 0: an initial guess.
  type :: departure_type
    real(wp), allocatable :: x(:), along(:)
    real(wp) :: p = 0.0_wp
  end type departure_type

contains

  !> Follow the branch from a motion at options%start, or from a departure.
  subroutine follow_response(curve, plan, options, branch, set, outcome, departure, cancel)
    !> Created with the orders of the plan, at its start; has the orders of `set` on return.
    class(oscillator_curve_type), intent(inout) :: curve
    type(response_plan_type), intent(in) :: plan
    type(curve_options), intent(in) :: options
    !> Unknowns are those of `set`; each point may have fewer orders.
    type(curve_branch_type), intent(out) :: branch
    type(harmonic_set_type), intent(out) :: set
    !> Outcome of the search for the first motion; there is no branch unless it is converged.
    integer, intent(out) :: outcome
    type(departure_type), intent(in), optional :: departure
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(balance_ladder_type) :: ladder
    real(wp), allocatable :: x(:, :)
    real(wp) :: nu, factor
    integer :: iterations, rung, i
    logical :: made

    outcome = outcome_converged
    rung = 1
    nu = curve%balance%nu
    factor = curve%balance%load_factor
    if (plan%chosen) then
      call new_ladder(ladder, curve%system, curve%load, plan%set%half_wave, &
                      min(plan%most, most_along(curve%system, curve%load)))
      rung = ladder%rung_of(orders_from_rest)
      if (present(departure)) then
        if (any(abs(departure%along) > 0.0_wp)) rung = 1
        rung = max(rung, rung_with(ladder, departure, curve%blocks))
      end if
    else
      call one_rung(ladder, curve%system, curve%load, plan%set)
    end if
    ladder%least = plan%options%least
    call ladder%prepare(rung, curve%system, curve%load, nu)
    call curve%choose_from(ladder, rung, options%tolerance)
    if (present(departure)) then
      associate (m => size(departure%x))
        if (.not. any(abs(departure%along) > 0.0_wp)) then
          call follow_from(curve, options, departure, branch, outcome, cancel)
        else
          call follow_curve(curve, options, refitted(curve%blocks, departure%x, curve%n), branch, &
                            departure%p, [refitted(curve%blocks, departure%along(:m), curve%n), &
                                          departure%along(m + 1)], cancel)
        end if
      end associate
    else
      do
        x = reshape([real(wp) ::], [curve%n/curve%blocks, curve%blocks], pad=[0.0_wp])
        iterations = 0
        call point_from_rest(curve%balance, curve%system, curve%load, options%tolerance, x, &
                             outcome, iterations, cancel, to_rounding=.true., &
                             least=ladder%least)
        if (outcome /= outcome_converged) then
          call point_from_damping(curve%balance, curve%system, nu, options%tolerance, x, made, &
                                  cancel)
          if (made) outcome = outcome_converged
        end if
        if (outcome == outcome_converged) then
          call follow_curve(curve, options, reshape(x, [curve%n]), branch, cancel=cancel)
          if (branch%n_points > 0) exit
        end if
        if (rung == ladder%n_rungs) exit
        if (is_set(cancel)) exit
        ! A motion with few orders may have no counterpart with more: start with more.
        rung = ladder%rung_of(2*ladder%highest(rung) + 1)
        call ladder%prepare(rung, curve%system, curve%load, nu)
        call curve%balance%set_frequency(curve%system, curve%load, nu)
        curve%balance%load_factor = factor
        call curve%choose_from(ladder, rung, options%tolerance)
      end do
    end if
    call branch%end_with_numbers()
    call branch%doubt_near_folds([(curve%system%mass(i, i), i=1, curve%blocks)])
    ! There is no branch if the first point could not be corrected.
    if (outcome == outcome_converged .and. branch%n_points == 0) outcome = outcome_stalled
    if (outcome == outcome_converged) then
      call keep_used(curve, branch)
      call find_errors(curve, branch, cancel)
    end if
    branch%allowed = [(ladder%allowed(options%tolerance, size_of(branch%x(:, i))), &
                       i=1, branch%n_points)]
    set = curve%balance%set

  contains

    pure real(wp) function size_of(x)
      real(wp), intent(in) :: x(:)
      size_of = weighted_norm(curve%system, reshape(x, [size(x)/curve%blocks, curve%blocks]))
    end function size_of

  end subroutine follow_response

  !> Follow the branch from a motion near the given one.
  subroutine follow_from(curve, options, departure, branch, outcome, cancel)
    class(oscillator_curve_type), intent(inout) :: curve
    type(curve_options), intent(in) :: options
    type(departure_type), intent(in) :: departure
    type(curve_branch_type), intent(out) :: branch
    integer, intent(out) :: outcome
    integer, intent(inout), optional :: cancel
    real(wp) :: x(curve%n/curve%blocks, curve%blocks)
    integer :: iterations
    logical :: inside

    outcome = outcome_stalled
    call curve%set(departure%p, inside)
    if (.not. inside) return
    x = reshape(refitted(curve%blocks, departure%x, curve%n), shape(x))
    iterations = 0
    call newton_point(curve%balance, curve%system, options%tolerance, x, outcome, iterations, &
                      to_rounding=.true.)
    if (outcome /= outcome_converged) return
    call follow_curve(curve, options, reshape(x, [curve%n]), branch, departure%p, cancel=cancel)
  end subroutine follow_from

  !> The lowest rung that includes all nonzero orders of a departure.
  pure integer function rung_with(ladder, departure, blocks) result(rung)
    type(balance_ladder_type), intent(in) :: ladder
    type(departure_type), intent(in) :: departure
    integer, intent(in) :: blocks
    real(wp) :: sizes(size(departure%x)/blocks)
    integer :: last
    associate (m => size(departure%x))
      sizes = sum(reshape(abs(departure%x) + abs(departure%along(:m)), [m/blocks, blocks]), 2)
    end associate
    last = findloc(sizes > 0.0_wp, .true., 1, back=.true.)
    do rung = 1, ladder%n_rungs - 1
      if (2*ladder%n_orders(rung) >= last) exit
    end do
  end function rung_with

  !> Errors of branch points: with twice the orders.
  subroutine find_errors(curve, branch, cancel)
    class(oscillator_curve_type), intent(inout) :: curve
    type(curve_branch_type), intent(inout) :: branch
    integer, intent(inout), optional :: cancel
    real(wp), allocatable :: ends(:, :)
    integer :: first, i, j

    if (branch%branch_points%n == 0 .or. branch%n_points < 2) return
    call curve%enlarge()
    associate (points => branch%branch_points)
      do i = 1, points%n
        if (given_up(cancel)) exit
        first = max(1, min(points%before(i), branch%n_points - 1))
        ends = reshape([(refitted(curve%blocks, branch%x(:, first + j), curve%n), j=0, 1)], &
                       [curve%n, 2])
        call branch_point_error(curve, branch%parameter(first:first + 1), ends, points%p(i), &
                                refitted(curve%blocks, points%x(:, i), curve%n), points%error(i), &
                                cancel)
      end do
    end associate
    call curve%restore()
  end subroutine find_errors

  !> Reduce the unknowns to the highest orders that any point has.
  subroutine keep_used(curve, branch)
    class(oscillator_curve_type), intent(inout) :: curve
    type(curve_branch_type), intent(inout) :: branch
    real(wp), allocatable :: x(:, :)
    integer :: i, n

    n = maxval(branch%kept(:branch%n_points))
    call curve%stay_with(n)
    allocate (x(curve%n, branch%n_points))
    do i = 1, branch%n_points
      x(:, i) = refitted(curve%blocks, branch%x(:, i), curve%n)
    end do
    call move_alloc(x, branch%x)
    call cut(branch%folds)
    call cut(branch%branch_points)

  contains

    subroutine cut(points)
      type(special_points), intent(inout) :: points
      integer :: old
      old = size(points%x, 1)
      points%across = reshape([(refitted(curve%blocks, points%across(:old, i), curve%n), &
                                points%across(old + 1, i), i=1, points%n)], &
                              [curve%n + 1, points%n])
      points%x = reshape([(refitted(curve%blocks, points%x(:, i), curve%n), i=1, points%n)], &
                         [curve%n, points%n])
    end subroutine cut

  end subroutine keep_used

end module viscovib_response_branch
