! Optimize: -O3
!> Successive approximations: the nonlinear steady response by fixed-point
!! iteration from the linear one.
!!
!!   D(k nu) U_k' = P_k - N_k(U)        (seed paper 001, (19), corrected)
!!
!! where N is the nonlinear part of F, including its memory. The harmonics of N are computed from
!! samples of a period (alternating frequency/time method). The iteration is a contraction only
!! while N is small compared with the dynamic stiffness. Each frequency therefore reports its
!! outcome, and only a converged one has results.
!!
!! Frequencies are independent: `n_lanes` of them are iterated in the vector lanes, and a finished
!! lane starts the next frequency at once.
module viscovib_successive
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_quiet_nan, ieee_value
  use viscovib_balance_ladder, only: checking_order
  use viscovib_counters, only: count_unknowns, count_up, counted_corrections, counted_turns, &
    counting
  use viscovib_cycle_terms, only: has_kinks
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set, samples_of_laws
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_linear_response, only: compliance_table, frequencies_together
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: largest_norm, share_of_motion
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged, outcome_diverged, outcome_overflow, &
    outcome_singular, outcome_stalled, outcome_stopped
  use viscovib_response, only: response_options, response_type
  use viscovib_response_lanes, only: advance, allocate_block, block_type, fill_lane, lane_norm, &
    load_lane, nonlinear_force, restart_lane, solve_lanes
  use viscovib_stopping, only: is_set, stop_wanted
  use viscovib_truncation, only: kinked_tail
  implicit none
  private

  public :: successive_response

  !> An iterate this much larger than the linear response, or a correction
  !! this much larger than the smallest one so far, has diverged.
  real(wp), parameter :: growth_limit = 1.0e3_wp
  !> Relaxation is halved at most this often.
  integer, parameter :: max_halvings = 4
  !> Largest factor between two iterations that the estimate of the truncation error uses.
  real(wp), parameter :: slowest = 0.9_wp
  !> Lower limit of 1 - rate: the remaining change is at most 1/stagnant times the last one.
  real(wp), parameter :: stagnant = 1.0e-3_wp
  !> Factor of the number of samples for estimates with forces that are not polynomials, and safety
  !! factor for the error of these samples.
  integer, parameter :: finer = 4
  real(wp), parameter :: safety = 2.0_wp
  !> Omitted orders below this fraction of the allowed error need no second iteration.
  real(wp), parameter :: far_below = 1.0e-3_wp

contains

  subroutine successive_response(system, load, nu, set, options, response, cancel)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequencies (rad/s).
    real(wp), intent(in) :: nu(:)
    !> Included harmonics.
    type(harmonic_set_type), intent(in) :: set
    type(response_options), intent(in) :: options
    !> The response relative to the base.
    type(response_type), intent(out) :: response
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(block_type) :: work, checking
    type(harmonic_set_type) :: more
    integer :: first, last, together

    call new_harmonic_set(more, checking_order(load, system%degree, set%orders(size(set%orders))), &
                          set%half_wave, merge(system%degree, finer*samples_of_laws - 1, &
                                               system%degree > 0))
    call response%allocate_for(nu, set%orders, system%n_dof(), &
                               merge(options%max_iterations, 0, options%keep_history))
    if (options%keep_iterates) then
      allocate (response%iterates(size(set%orders), system%n_dof(), 1 + options%max_iterations, &
                                  size(nu)))
      response%iterates = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
    end if
    call allocate_block(work, system, set)
    call allocate_block(checking, system, more)
    together = frequencies_together(system%n_dof(), size(more%orders))
    do first = 1, size(nu), together
      last = min(first + together - 1, size(nu))
      call iterate_chunk(system, load, set, options, work, response, first, last, more, checking, &
                         cancel)
    end do
  end subroutine successive_response

  !> Finish the points first..last of the response, and estimate their truncation error with `more`
  !! orders.
  subroutine iterate_chunk(system, load, set, options, work, response, first, last, more, &
                           checking, &
                           cancel)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    type(harmonic_set_type), intent(in) :: set
    type(response_options), intent(in) :: options
    type(block_type), intent(inout) :: work
    type(response_type), intent(inout) :: response
    integer, intent(in) :: first, last
    type(harmonic_set_type), intent(in) :: more
    type(block_type), intent(inout) :: checking
    integer, intent(inout), optional :: cancel
    complex(wp), allocatable :: fraction(:, :, :), compliance(:, :, :, :)
    logical :: singular(last - first + 1), stopped
    integer :: n, m, next_point, lane, i

    n = last - first + 1
    m = size(set%orders)
    allocate (fraction(n, system%n_memory(), size(more%orders)), &
              compliance(system%n_dof(), system%n_dof(), n, size(more%orders)))
    if (counting) call count_unknowns(set%orders, system%n_dof(), n)
    call compliance_table(system, set%orders, response%nu(first:last), fraction(:, :, :m), &
                          compliance(:, :, :, :m), singular)
    next_point = 1
    do
      do lane = 1, n_lanes
        if (work%point(lane) > 0) cycle
        do while (next_point <= n)
          i = next_point
          next_point = next_point + 1
          if (singular(i)) then
            call response%discard(first + i - 1, outcome_singular)
            cycle
          end if
          call load_lane(work, lane, i, system, load, set, options%relaxation, &
                         response%nu(first + i - 1), fraction(i, :, :m), compliance(:, :, i, :m))
          exit
        end do
      end do
      if (all(work%point == 0)) exit
      stopped = stop_wanted()
      if (.not. stopped) stopped = is_set(cancel)
      if (stopped) then
        call give_up()
        exit
      end if
      call nonlinear_force(work, system, set)
      call solve_lanes(work)
      call check_lanes(work, system, load, set, options, response, first)
    end do
    call compliance_table(system, more%orders(m + 1:), response%nu(first:last), &
                          fraction(:, :, m + 1:), compliance(:, :, :, m + 1:), singular)
    ! Undamped and in resonance: the omitted harmonic may have any amplitude.
    do i = 1, n
      if (singular(i) .and. response%outcome(first + i - 1) == outcome_converged) then
        response%truncation(first + i - 1) = 1.0_wp
      end if
    end do
    call check_chunk(system, load, more, checking, response, first, last, fraction, compliance)

  contains

    !> Mark the points that are not finished as stopped.
    subroutine give_up()
      integer :: k
      do k = 1, n_lanes
        if (work%point(k) > 0) call response%discard(first + work%point(k) - 1, outcome_stopped)
      end do
      work%point = 0
      do k = next_point, n
        call response%discard(first + k - 1, outcome_stopped)
      end do
    end subroutine give_up

  end subroutine iterate_chunk

  !> True for a motion that was found and has no truncation error of 1 yet.
  pure logical function to_be_checked(response, i)
    type(response_type), intent(in) :: response
    integer, intent(in) :: i
    to_be_checked = .false.
    if (response%outcome(i) == outcome_converged) to_be_checked = response%truncation(i) < 1.0_wp
  end function to_be_checked

  !> Truncation error: two iterations with `more` orders from the motion found. The first one
  !! computes the omitted orders, the second one their effect on the included orders, which then
  !! continues with the rate of the iteration. If the first is far below the allowed error, that
  !! rate replaces the second. With kinks, orders beyond `more` count too. For forces that are not
  !! polynomials the first also shows the sampling error of the included orders.
  subroutine check_chunk(system, load, more, work, response, first, last, fraction, compliance)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    type(harmonic_set_type), intent(in) :: more
    type(block_type), intent(inout) :: work
    type(response_type), intent(inout) :: response
    integer, intent(in) :: first, last
    complex(wp), intent(in) :: fraction(:, :, :), compliance(:, :, :, :)
    !> Norms of the motion, of the omitted orders in the first iteration, of their change in the
    !! second, and of the changes of the included orders by both and by sampling.
    real(wp), dimension(n_lanes) :: whole, found, rest, back, aliased, rate
    real(wp), allocatable :: kept(:, :, :, :)
    integer :: lane, i, m, at
    real(wp) :: short, reach
    logical :: kinked, moves

    kinked = has_kinks(system)
    moves = load%moves_base()
    m = size(response%orders)
    i = first
    do
      work%point = 0
      lane = 0
      do while (i <= last .and. lane < n_lanes)
        if (to_be_checked(response, i)) then
          lane = lane + 1
          at = i - first + 1
          call fill_lane(work, lane, i, system, load, more, response%nu(i), fraction(at, :, :), &
                         compliance(:, :, at, :))
          work%u(lane, 1, :m, :) = real(response%coefficients(:, :, i))
          work%u(lane, 2, :m, :) = aimag(response%coefficients(:, :, i))
          work%u(lane, :, m + 1:, :) = 0.0_wp
        end if
        i = i + 1
      end do
      if (lane == 0) return
      call nonlinear_force(work, system, more)
      call solve_lanes(work)
      whole = lane_norm(system, work%u)
      found = lane_norm(system, work%next(:, :, m + 1:, :))
      work%u(:, :, m + 1:, :) = work%next(:, :, m + 1:, :)
      kept = work%next(:, :, :m, :)
      aliased = 0.0_wp
      if (.not. system%degree > 0) aliased = safety*lane_norm(system, kept - work%u(:, :, :m, :))
      rate = 0.0_wp
      do lane = 1, n_lanes
        at = work%point(lane)
        if (at == 0) cycle
        rate(lane) = response%rate(at)
        if (.not. moves) cycle
        associate (x => response%coefficients(:, :, at))
          whole(lane) = whole(lane) &
                        *share_of_motion(system, load, 1.0_wp, response%orders, rows_of(x))
        end associate
      end do
      if (kinked .or. any(work%point > 0 .and. .not. is_far_below())) then
        call nonlinear_force(work, system, more)
        call solve_lanes(work)
        rest = lane_norm(system, work%next(:, :, m + 1:, :) - work%u(:, :, m + 1:, :))
        ! Relative to the first iteration, so without the remaining error of the iteration.
        back = lane_norm(system, work%next(:, :, :m, :) - kept)
      else
        rest = rate*found
        back = rate*found
      end if
      do lane = 1, n_lanes
        at = work%point(lane)
        if (at == 0 .or. .not. whole(lane) > 0.0_wp) cycle
        short = 1.0_wp
        if (found(lane) > 0.0_wp) short = 1.0_wp/(1.0_wp - min(rest(lane)/found(lane), slowest))
        found(lane) = found(lane)*short
        reach = 1.0_wp
        if (kinked) call kinked_tail(system, rows_of(response%coefficients(:, :, at)), &
                                     more%orders, found(lane), reach, short)
        back(lane) = (back(lane)*short + aliased(lane))/max(1.0_wp - rate(lane), stagnant)
        response%truncation(at) = max(found(lane)*reach, back(lane))/whole(lane)
      end do
    end do

  contains

    !> True if the error after the worst possible second iteration is far below the allowed one.
    pure function is_far_below()
      logical :: is_far_below(n_lanes)
      real(wp) :: allowed(n_lanes)
      allowed = 0.0_wp
      where (work%point > 0) allowed = response%allowed(max(work%point, 1))
      is_far_below = (found/(1.0_wp - slowest) + aliased)/max(1.0_wp - rate, stagnant) &
                     <= far_below*allowed*whole
    end function is_far_below

  end subroutine check_chunk

  !> Alternating real and imaginary parts, shape (2 n_orders, n_dof).
  pure function rows_of(x) result(rows)
    complex(wp), intent(in) :: x(:, :)
    real(wp) :: rows(2*size(x, 1), size(x, 2))
    rows(1::2, :) = real(x)
    rows(2::2, :) = aimag(x)
  end function rows_of

  !> Compare the next iterates with the present ones and decide, lane by lane.
  !!
  !! Norm: the largest of sqrt(M_dd) (|Re X| + |Im X|), so that metres and radians are weighted by
  !! inertia. If corrections delta shrink by the factor q, the remaining error is about delta
  !! q/(1-q); this error and delta must both meet the tolerance.
  subroutine check_lanes(work, system, load, set, options, response, first)
    type(block_type), intent(inout) :: work
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    type(harmonic_set_type), intent(in) :: set
    type(response_options), intent(in) :: options
    type(response_type), intent(inout) :: response
    integer, intent(in) :: first
    real(wp) :: norm(n_lanes), delta(n_lanes), poison(n_lanes), weight, start(n_lanes)
    real(wp) :: rate, error, largest
    integer :: d, k, l, i, outcome

    largest = largest_norm(system)
    norm = 0.0_wp
    delta = 0.0_wp
    start = 0.0_wp
    poison = 0.0_wp
    do d = 1, system%n_dof()
      weight = sqrt(system%mass(d, d))
      do k = 1, size(set%orders)
        do l = 1, n_lanes
          ! NaN may pass unseen through a maximum, but not through a sum.
          poison(l) = poison(l) + 0.0_wp*(work%next(l, 1, k, d) + work%next(l, 2, k, d))
          norm(l) = max(norm(l), weight*(abs(work%next(l, 1, k, d)) + abs(work%next(l, 2, k, d))))
          start(l) = max(start(l), weight*(abs(work%u(l, 1, k, d)) + abs(work%u(l, 2, k, d))))
          delta(l) = max(delta(l), weight*(abs(work%next(l, 1, k, d) - work%u(l, 1, k, d)) &
                                           + abs(work%next(l, 2, k, d) - work%u(l, 2, k, d))))
        end do
      end do
    end do
    do l = 1, n_lanes
      if (work%point(l) == 0) cycle
      i = first + work%point(l) - 1
      delta(l) = delta(l) + poison(l)
      if (work%iteration(l) == 0) then
        ! The step from zero to the linear response is the zeroth correction.
        if (allocated(response%iterates)) call keep(1, work%u(l, :, :, :))
        work%start_norm(l) = start(l)
        work%recent(1, l) = start(l)
      end if
      if (counting) call count_up(counted_turns, 1)
      work%iteration(l) = work%iteration(l) + 1
      work%recent(2:3, l) = work%recent(1:2, l)
      work%recent(1, l) = delta(l)
      work%smallest(l) = min(work%smallest(l), delta(l))
      if (size(response%corrections, 1) > 0) then
        if (counting) call count_up(counted_corrections, 1)
        response%corrections(work%iteration(l), i) = delta(l)/max(norm(l), tiny(norm))
      end if
      if (allocated(response%iterates)) call keep(1 + work%iteration(l), work%next(l, :, :, :))
      rate = shrinkage(work%recent(:, l))
      error = delta(l)
      if (rate < 1.0_wp) error = delta(l)*max(1.0_wp, rate/(1.0_wp - rate))
      if (.not. ieee_is_finite(poison(l)) .or. norm(l) > largest) then
        outcome = outcome_overflow
      else if (error <= options%tolerance*seen(l) + options%least .and. rate < 1.0_wp) then
        outcome = outcome_converged
      else if (.not. norm(l) <= growth_limit*work%start_norm(l) &
               .or. delta(l) > growth_limit*work%smallest(l)) then
        outcome = outcome_diverged
      else if (work%iteration(l) >= options%max_iterations) then
        outcome = merge(outcome_diverged, outcome_stalled, rate > 1.0_wp)
      else
        call advance(work, l)
        cycle
      end if
      if (outcome /= outcome_converged .and. options%relaxation <= 0.0_wp &
          .and. work%halvings(l) < max_halvings) then
        work%halvings(l) = work%halvings(l) + 1
        work%relaxation(l) = 0.5_wp*work%relaxation(l)
        call restart_lane(work, l)
        response%corrections(:, i) = ieee_value(0.0_wp, ieee_quiet_nan)
        if (allocated(response%iterates)) response%iterates(:, :, :, i) = &
          cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
        cycle
      end if
      call store(work, l, response, i, outcome, rate)
      call response%allow(options, i, seen(l))
    end do

  contains

    subroutine keep(row, x)
      integer, intent(in) :: row
      real(wp), intent(in) :: x(:, :, :)
      response%iterates(:, :, row, i) = cmplx(x(1, :, :), x(2, :, :), wp)
    end subroutine keep

    !> Norm of the absolute motion.
    real(wp) function seen(lane)
      integer, intent(in) :: lane
      seen = norm(lane)
      if (load%moves_base()) then
        seen = seen*share_of_motion(system, load, 1.0_wp, set%orders, &
                                    rows_of(cmplx(work%next(lane, 1, :, :), &
                                                  work%next(lane, 2, :, :), wp)))
      end if
    end function seen

  end subroutine check_lanes

  !> Geometric mean of the last one or two factors between corrections.
  pure real(wp) function shrinkage(recent)
    real(wp), intent(in) :: recent(3)
    shrinkage = 0.0_wp
    if (recent(1) <= 0.0_wp) return
    if (recent(3) > 0.0_wp) then
      shrinkage = sqrt(recent(1)/recent(3))
    else if (recent(2) > 0.0_wp) then
      shrinkage = recent(1)/recent(2)
    end if
  end function shrinkage

  !> Store the result of a lane in the response and free the lane.
  subroutine store(work, lane, response, i, outcome, rate)
    type(block_type), intent(inout) :: work
    integer, intent(in) :: lane, i, outcome
    type(response_type), intent(inout) :: response
    real(wp), intent(in) :: rate

    response%iterations(i) = work%iteration(lane)
    response%rate(i) = rate
    if (outcome /= outcome_converged) then
      call response%discard(i, outcome)
    else
      response%coefficients(:, :, i) = cmplx(work%next(lane, 1, :, :), work%next(lane, 2, :, :), wp)
    end if
    work%point(lane) = 0
    work%u(lane, :, :, :) = 0.0_wp
    work%load(lane, :, :, :) = 0.0_wp
  end subroutine store

end module viscovib_successive
