!> Periodic motions by Newton's method for the map of a period (viscovib_period_map), with
!! step sizes that are halved until the state no longer changes.
module viscovib_shooting
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_eigenvalue_conditions, only: eigenvalue_conditions
  use viscovib_kinds, only: i8, wp
  use viscovib_orbit_multipliers, only: multipliers_of
  use viscovib_outcomes, only: outcome_converged, outcome_diverged, outcome_stalled, &
    outcome_stopped
  use viscovib_period_map, only: period_map, period_run
  use viscovib_status, only: show, things
  use viscovib_stopping, only: begin_piece, given_up
  use viscovib_time_run, only: run_coarse, run_completed, run_diverged
  implicit none
  private

  public :: check_repeating, find_repeating, find_shortest_period, check_periodic, &
    show_repeating, steady_doubt, steady_from_rest
  public :: accuracy_type, repeating_type, steady_type

  !> Rounding error of a state at the end of a period, relative to its largest entry.
  real(wp), parameter :: rounding = 8.0_wp*epsilon(1.0_wp)
  !> Iterations of Newton's method, and halvings of one of its steps.
  integer, parameter :: max_iterations = 30, max_halvings = 8
  !> Periods from rest before Newton's method begins, and more after each failure.
  integer, parameter :: settling(3) = [30, 100, 400]
  !> Number of times that steps from rest are made 16 times shorter if they are too large.
  integer, parameter :: max_shorter = 3
  !> Doublings of the number of steps, and allowed number of failures.
  integer, parameter :: max_doublings = 12, max_failures = 3
  !> Multipliers as large as this part of the largest determine the error of stability.
  real(wp), parameter :: leading = 0.9_wp
  !> Smallest number of states that are shown for a period.
  integer, parameter, public :: n_shown = 256

  !> The allowed error of a state: absolute + relative times its largest entry.
  type :: accuracy_type
    real(wp) :: absolute = 0.0_wp, relative = 0.0_wp
  contains
    procedure :: allowed
  end type accuracy_type

  !> Result of Newton's method.
  type :: repeating_type
    real(wp), allocatable :: state(:), by_start(:, :)
    integer :: n_passed = 0, iterations = 0
    integer :: outcome = outcome_stalled
    !> The last correction, and the factor by which errors of the map are amplified.
    real(wp) :: correction = huge(1.0_wp), enlarged = huge(1.0_wp)
  end type repeating_type

  !> A periodic motion with a sufficiently small step size.
  type :: steady_type
    type(repeating_type) :: found
    integer(i8) :: n_steps = 0
    !> Errors of the state and of the multipliers; NaN: unknown.
    real(wp) :: error = 0.0_wp, multiplier_error = 0.0_wp
    !> The largest first.
    complex(wp), allocatable :: multipliers(:)
    integer :: iterations = 0
  contains
    procedure :: stability
  end type steady_type

contains

  pure real(wp) function allowed(self, map, state)
    class(accuracy_type), intent(in) :: self
    type(period_map), intent(in) :: map
    real(wp), intent(in) :: state(:)
    allowed = self%absolute + self%relative*map%size_of(state)
  end function allowed

  !> 1: perturbations decay; 0: some grow; -1: undecided.
  pure integer function stability(self)
    class(steady_type), intent(in) :: self
    real(wp) :: largest
    stability = -1
    if (self%found%outcome /= outcome_converged .or. size(self%multipliers) == 0) return
    largest = abs(self%multipliers(1))
    if (abs(largest - 1.0_wp) > self%multiplier_error) stability = merge(1, 0, largest < 1.0_wp)
  end function stability

  !> Newton's method for a periodic state.
  subroutine find_repeating(map, start, n_steps, tolerance, found)
    type(period_map), intent(in) :: map
    real(wp), intent(in) :: start(:)
    integer(i8), intent(in) :: n_steps
    !> Tolerance of corrections, with velocities divided by the frequency of the load.
    real(wp), intent(in) :: tolerance
    type(repeating_type), intent(out) :: found
    type(period_run) :: ran
    real(wp), allocatable :: step(:), left(:)
    real(wp) :: before
    integer :: turn
    logical :: done, made

    allocate (found%state, source=start)
    call map%run(start, n_steps, ran)
    call take(ran, found)
    if (.not. ran%is_complete()) then
      if (ran%ended == run_diverged) found%outcome = outcome_diverged
      return
    end if
    before = huge(before)
    do turn = 1, max_iterations
      found%iterations = turn
      left = ran%last - found%state
      call map%step_back(ran%by_start, left, step, found%enlarged)
      found%correction = map%size_of(step)
      associate (correction => found%correction)
        done = correction <= max(1.0e-3_wp*tolerance, &
                                 rounding*map%size_of(found%state)*max(1.0_wp, found%enlarged)) &
               .or. (correction <= tolerance .and. correction > 0.5_wp*before)
        before = correction
      end associate
      call go_ahead(map, step, map%size_of(left), n_steps, done, found%state, ran, made)
      if (.not. made) return
      call take(ran, found)
      if (done) found%outcome = outcome_converged
      if (done) return
    end do
    found%enlarged = huge(1.0_wp)
  end subroutine find_repeating

  subroutine take(ran, found)
    type(period_run), intent(in) :: ran
    type(repeating_type), intent(inout) :: found
    found%by_start = ran%by_start
    found%n_passed = ran%n_passed
  end subroutine take

  !> The part of a Newton step that reduces the remainder; `made` is false if there is none.
  subroutine go_ahead(map, step, before, n_steps, last, state, ran, made)
    type(period_map), intent(in) :: map
    real(wp), intent(in) :: step(:), before
    integer(i8), intent(in) :: n_steps
    !> True for the last step, which need not reduce the remainder.
    logical, intent(in) :: last
    real(wp), intent(inout) :: state(:)
    type(period_run), intent(inout) :: ran
    logical, intent(out) :: made
    type(period_run) :: trial
    real(wp) :: moved(size(state)), part
    integer :: k

    made = .false.
    part = 1.0_wp
    do k = 1, max_halvings
      moved = state + part*step
      call map%run(moved, n_steps, trial)
      if (trial%is_complete()) then
        made = last
        if (.not. made) made = map%size_of(trial%last - moved) <= (1.0_wp - 0.25_wp*part)*before
      end if
      if (made) then
        state = moved
        ran = trial
        return
      end if
      if (given_up()) return
      part = 0.5_wp*part
    end do
  end subroutine go_ahead

  !> Let the motion from rest settle before Newton's method.
  subroutine steady_from_rest(map, wanted, steady)
    type(period_map), intent(in) :: map
    type(accuracy_type), intent(in) :: wanted
    type(steady_type), intent(out) :: steady
    type(period_map) :: one
    type(period_run) :: ran
    real(wp) :: state(map%n_state())
    integer :: i, k

    state = 0.0_wp
    one = map
    one%n_periods = 1
    do i = 1, size(settling)
      do k = 1, settling(i)
        call begin_piece()
        call run_one_period(one, state, ran)
        if (ran%ended /= run_completed) exit
        state = ran%last
      end do
      call check_repeating(map, state, wanted, steady)
      if (steady%found%outcome == outcome_converged .or. given_up()) return
    end do
  end subroutine steady_from_rest

  !> Run one period in few steps; from rest against a stop a motion needs short steps.
  subroutine run_one_period(one, state, ran)
    type(period_map), intent(in) :: one
    real(wp), intent(in) :: state(:)
    type(period_run), intent(inout) :: ran
    integer :: k
    do k = 0, max_shorter
      call one%run(state, 16_i8**k*one%first_steps(), ran, derivatives=.false.)
      if (ran%ended /= run_coarse) exit
    end do
  end subroutine run_one_period

  !> Double the number of steps until the periodic state changes by no more than is allowed.
  !!
  !! The last two runs differ by one step, so that no position of a switch within its step is common
  !! to both. Their difference is the estimated error.
  subroutine check_repeating(map, start, wanted, steady)
    type(period_map), intent(in) :: map
    real(wp), intent(in) :: start(:)
    type(accuracy_type), intent(in) :: wanted
    type(steady_type), intent(out) :: steady
    type(repeating_type) :: found, latest, other
    real(wp) :: tolerance
    integer(i8) :: n_steps
    integer :: failures, iterations, k
    logical :: agrees, has_latest

    n_steps = map%first_steps()
    has_latest = .false.
    failures = 0
    iterations = 0
    latest%state = start
    do k = 1, max_doublings
      call begin_piece()
      call find_repeating(map, latest%state, n_steps, wanted%allowed(map, latest%state), found)
      iterations = iterations + found%iterations
      if (given_up()) then
        found%outcome = outcome_stopped
        call estimate(map, found, n_steps, iterations, steady)
        return
      end if
      if (found%outcome /= outcome_converged) then
        failures = failures + 1
        if (failures >= max_failures) then
          call estimate(map, found, n_steps, iterations, steady)
          return
        end if
        n_steps = 2*n_steps
        cycle
      end if
      tolerance = max(wanted%allowed(map, found%state), rounding_of(map, found))
      agrees = has_latest
      if (agrees) agrees = apart(map, latest, found) <= tolerance
      if (agrees) then
        call find_repeating(map, found%state, n_steps + 1, tolerance, other)
        iterations = iterations + other%iterations
        agrees = other%outcome == outcome_converged .and. apart(map, found, other) <= tolerance
      end if
      if (agrees) then
        call estimate(map, other, n_steps + 1, iterations, steady, found)
        ! Rounding alone may exceed the motion, as at the resonance of an undamped system.
        if (.not. steady%error <= max(map%size_of(other%state), &
                                      wanted%allowed(map, other%state))) then
          steady%found%outcome = outcome_stalled
        end if
        return
      end if
      latest = found
      has_latest = .true.
      n_steps = 2*n_steps
    end do
    found%outcome = outcome_stalled
    call estimate(map, found, n_steps/2, iterations, steady)
  end subroutine check_repeating

  pure real(wp) function apart(map, one, other)
    type(period_map), intent(in) :: map
    type(repeating_type), intent(in) :: one, other
    apart = map%size_of(one%state - other%state)
  end function apart

  !> Amplified rounding error of the periodic state.
  pure real(wp) function rounding_of(map, found)
    type(period_map), intent(in) :: map
    type(repeating_type), intent(in) :: found
    rounding_of = rounding*map%size_of(found%state)*max(1.0_wp, found%enlarged)
  end function rounding_of

  !> Multipliers of a motion, and errors by comparison with another run, if present.
  subroutine estimate(map, found, n_steps, iterations, steady, other)
    type(period_map), intent(in) :: map
    type(repeating_type), intent(in) :: found
    integer(i8), intent(in) :: n_steps
    integer, intent(in) :: iterations
    type(steady_type), intent(out) :: steady
    type(repeating_type), intent(in), optional :: other

    steady%found = found
    steady%n_steps = n_steps
    steady%iterations = iterations
    allocate (steady%multipliers(size(found%by_start, 1)))
    call multipliers_of(found%by_start, steady%multipliers)
    steady%error = ieee_value(0.0_wp, ieee_quiet_nan)
    steady%multiplier_error = steady%error
    if (.not. present(other)) return
    steady%error = apart(map, found, other) + found%correction*epsilon(1.0_wp) &
                   + rounding_of(map, found)
    steady%multiplier_error = error_of_multipliers(map, found%by_start, other%by_start, &
                                                   steady%multipliers)
  end subroutine estimate

  !> Error of the leading multipliers, from the difference of two derivatives and rounding,
  !! amplified by the condition of the eigenvalues.
  real(wp) function error_of_multipliers(map, by_start, other, multipliers) result(error)
    type(period_map), intent(in) :: map
    real(wp), intent(in) :: by_start(:, :), other(:, :)
    complex(wp), intent(in) :: multipliers(:)
    real(wp), allocatable :: balanced(:, :), change(:, :), weights(:), conditions(:)
    integer :: n

    n = size(multipliers)
    error = 0.0_wp
    if (n == 0) return
    allocate (weights, source=map%weights())
    allocate (balanced, source=spread(weights, 2, n)*by_start/spread(weights, 1, n))
    allocate (change, source=spread(weights, 2, n)*(by_start - other)/spread(weights, 1, n))
    n = count(abs(multipliers) >= leading*abs(multipliers(1)))
    allocate (conditions(n), source=1.0_wp)
    if (abs(multipliers(1)) > 0.0_wp) then
      call eigenvalue_conditions(balanced, multipliers(:n), conditions)
    end if
    error = max(1.0_wp, maxval(conditions))*(norm2(change) + rounding*norm2(balanced))
  end function error_of_multipliers

  !> Errors of a periodic state by comparison with twice as many steps and one.
  subroutine check_periodic(map, state, n_steps, correction, steady)
    type(period_map), intent(in) :: map
    real(wp), intent(in) :: state(:)
    integer(i8), intent(in) :: n_steps
    !> The last correction of Newton's method.
    real(wp), intent(in) :: correction
    type(steady_type), intent(out) :: steady
    type(period_run) :: one, other
    type(repeating_type) :: found, finer
    real(wp), allocatable :: step(:)
    real(wp) :: enlarged

    call map%run(state, n_steps, one)
    call map%run(state, 2*n_steps + 1, other)
    call map%step_back(one%by_start, other%last - one%last, step, found%enlarged)
    if (one%is_complete() .and. other%is_complete()) found%outcome = outcome_converged
    found%state = state
    call take(one, found)
    found%correction = correction
    finer = found
    finer%state = state + step
    call take(other, finer)
    call estimate(map, found, n_steps, 0, steady, finer)
    ! The last correction may have been found on the other side of grazing.
    call map%step_back(one%by_start, one%last - state, step, enlarged)
    steady%error = steady%error + max(correction, map%size_of(step))
  end subroutine check_periodic

  !> The smallest number of load periods after which a motion repeats within its error.
  !!
  !! Newton's step of the map of a part of the time is the distance to the nearest motion that
  !! repeats after that part.
  integer function find_shortest_period(map, steady) result(shortest)
    type(period_map), intent(in) :: map
    type(steady_type), intent(in) :: steady
    type(period_map) :: part
    type(period_run) :: ran
    real(wp), allocatable :: step(:)
    real(wp) :: enlarged
    integer(i8) :: n_steps

    if (steady%found%outcome == outcome_converged) then
      do shortest = 1, map%n_periods - 1
        if (mod(map%n_periods, shortest) /= 0) cycle
        part = map
        part%n_periods = shortest
        n_steps = (steady%n_steps*shortest + map%n_periods - 1)/map%n_periods
        associate (state => steady%found%state)
          call part%run(state, n_steps, ran)
          if (.not. ran%is_complete()) cycle
          call part%step_back(ran%by_start, ran%last - state, step, enlarged)
          if (map%size_of(step) <= 2.0_wp*steady%error &
              + rounding*map%size_of(state)*max(1.0_wp, enlarged)) return
        end associate
      end do
    end if
    shortest = map%n_periods
  end function find_shortest_period

  !> What is wrong with a motion, as a further clause of a sentence; empty if nothing is.
  subroutine steady_doubt(map, steady, accuracy, doubt)
    type(period_map), intent(in) :: map
    type(steady_type), intent(in) :: steady
    type(accuracy_type), intent(in) :: accuracy
    character(len=:), allocatable, intent(out) :: doubt

    doubt = ''
    if (steady%found%outcome /= outcome_converged) then
      doubt = ': no motion was found that repeats after '//things(map%n_periods, 'period') &
              //' (the last correction is '//show(steady%found%correction) &
              //'); give a nearer initial state, or another n_periods'
    else if (steady%error > accuracy%allowed(map, steady%found%state)) then
      doubt = '; the error '//show(steady%error)//' is above the tolerance: rounding is ' &
              //'amplified '//show(steady%found%enlarged)//' times in the motion that repeats'
    end if
  end subroutine steady_doubt

  !> States at equidistant times over the period, shape (2 n_dof, size(t)).
  subroutine show_repeating(map, steady, t, states)
    type(period_map), intent(in) :: map
    type(steady_type), intent(in) :: steady
    real(wp), allocatable, intent(out) :: t(:), states(:, :)
    type(period_run) :: ran
    real(wp), allocatable :: times(:)
    integer(i8) :: n
    integer :: i

    n = (n_shown + steady%n_steps - 1)/steady%n_steps*steady%n_steps
    allocate (times(n + 1))
    do i = 1, size(times)
      times(i) = (i - 1)*(map%period()/n)
    end do
    times(n + 1) = map%period()
    call map%run(steady%found%state, steady%n_steps, ran, times, derivatives=.false.)
    allocate (t, source=times(:ran%n_reached))
    allocate (states, source=ran%at_times(:, :ran%n_reached))
  end subroutine show_repeating

end module viscovib_shooting
