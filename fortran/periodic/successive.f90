!> Successive approximations: the nonlinear steady response by fixed-point
!! iteration from the linear one.
!!
!!   D(k nu) U_k' = P_k - N_k(U)        (seed paper 001, (19), corrected)
!!
!! with N the nonlinear part of F, its memory included. The harmonics of N
!! come from samples of a period (Fourier alternation). The iteration is a
!! contraction only while N is small against the dynamic stiffness; each
!! frequency therefore reports how it ended, and only a converged one gives
!! numbers.
!!
!! Frequencies are independent: `n_lanes` of them are iterated side by side,
!! and a lane that is done takes up the next frequency at once.
module viscovib_successive
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_quiet_nan, ieee_value
  use viscovib_balance_ladder, only: judging_order
  use viscovib_counters, only: count_unknowns, count_up, counted_corrections, counted_loads, &
    counted_turns, counting
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_linear_response, only: chunk_size, compliance_table
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged, outcome_diverged, outcome_overflow, &
    outcome_singular, outcome_stalled, outcome_stopped
  use viscovib_response, only: response_options, response_type
  use viscovib_stopping, only: stop_wanted
  implicit none
  private

  public :: successive_response

  !> An iterate this much larger than the linear response, or a correction
  !! this much larger than the smallest one so far, has diverged.
  real(wp), parameter :: growth_limit = 1.0e3_wp
  !> Relaxation is halved at most this often.
  integer, parameter :: max_halvings = 4
  !> Largest factor between two turns that is believed where orders left out are judged.
  real(wp), parameter :: slowest = 0.9_wp
  !> An iteration falls short of all it will change by no more than 1/stagnant.
  real(wp), parameter :: stagnant = 1.0e-3_wp

  !> Everything that belongs to the frequencies under iteration. Real and
  !! imaginary parts are apart (second index of size 2, or names re, im) so
  !! that all loops run along the lanes.
  type :: block_type
    !> Which point of the chunk a lane works on; 0: idle.
    integer :: point(n_lanes) = 0
    integer :: iteration(n_lanes) = 0, halvings(n_lanes) = 0
    real(wp) :: relaxation(n_lanes) = 1.0_wp
    !> The last three corrections, newest first; the smallest one; the norm of
    !! the linear response.
    real(wp) :: recent(3, n_lanes) = 0.0_wp
    real(wp) :: smallest(n_lanes) = 0.0_wp, start_norm(n_lanes) = 0.0_wp
    !> Iterate, and the load, shape (n_lanes, 2, n_orders, n_dof).
    real(wp), allocatable :: u(:, :, :, :), load(:, :, :, :)
    !> Compliance, shape (n_lanes, n_dof, n_dof, n_orders).
    real(wp), allocatable :: c_re(:, :, :, :), c_im(:, :, :, :)
    !> What memory retains, shape (n_lanes, n_memory, n_orders).
    real(wp), allocatable :: f_re(:, :, :), f_im(:, :, :)
    !> Work: next iterate and nonlinear force (as u), hereditary variables
    !! (n_lanes, 2, n_orders, n_memory), and samples
    !! (n_lanes*n_samples, n_dof or n_memory).
    real(wp), allocatable :: next(:, :, :, :), force(:, :, :, :), w(:, :, :, :)
    real(wp), allocatable :: u_samples(:, :), w_samples(:, :), f_samples(:, :)
  end type block_type

contains

  subroutine successive_response(system, load, nu, set, options, response)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequencies (rad/s).
    real(wp), intent(in) :: nu(:)
    !> Harmonics to keep.
    type(harmonic_set_type), intent(in) :: set
    type(response_options), intent(in) :: options
    type(response_type), intent(out) :: response
    type(block_type) :: work, judging
    type(harmonic_set_type) :: more
    integer :: first, last

    call new_harmonic_set(more, judging_order(load, system%degree, set%orders(size(set%orders))), &
                          set%half_wave, system%degree)
    call response%allocate_for(nu, set%orders, system%n_dof(), &
                               merge(options%max_iterations, 0, options%keep_history))
    call allocate_block(work, system, set)
    call allocate_block(judging, system, more)
    do first = 1, size(nu), chunk_size
      last = min(first + chunk_size - 1, size(nu))
      call iterate_chunk(system, load, set, options, work, response, first, last, more, judging)
    end do
    call response%add_base_motion(system, load)
  end subroutine successive_response

  subroutine allocate_block(work, system, set)
    type(block_type), intent(out) :: work
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    integer :: k, d, m, s

    k = size(set%orders)
    d = system%n_dof()
    m = system%n_memory()
    s = n_lanes*set%n_samples
    allocate (work%u(n_lanes, 2, k, d), work%load(n_lanes, 2, k, d), &
              work%next(n_lanes, 2, k, d), work%force(n_lanes, 2, k, d), &
              work%w(n_lanes, 2, k, m), &
              work%c_re(n_lanes, d, d, k), work%c_im(n_lanes, d, d, k), &
              work%f_re(n_lanes, m, k), work%f_im(n_lanes, m, k), &
              work%u_samples(s, d), work%w_samples(s, m), work%f_samples(s, d), source=0.0_wp)
  end subroutine allocate_block

  !> Bring the points first..last of the response to an end, and judge them with `more`
  !! orders.
  subroutine iterate_chunk(system, load, set, options, work, response, first, last, more, judging)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    type(harmonic_set_type), intent(in) :: set
    type(response_options), intent(in) :: options
    type(block_type), intent(inout) :: work
    type(response_type), intent(inout) :: response
    integer, intent(in) :: first, last
    type(harmonic_set_type), intent(in) :: more
    type(block_type), intent(inout) :: judging
    complex(wp), allocatable :: fraction(:, :, :), compliance(:, :, :, :)
    logical :: singular(last - first + 1)
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
      if (stop_wanted()) then
        call give_up()
        exit
      end if
      call nonlinear_force(work, system, set)
      call solve_lanes(work)
      call judge_lanes(work, system, set, options, response, first)
    end do
    call compliance_table(system, more%orders(m + 1:), response%nu(first:last), &
                          fraction(:, :, m + 1:), compliance(:, :, :, m + 1:), singular)
    ! Undamped and in resonance: an order of any size may be missing.
    do i = 1, n
      if (singular(i) .and. response%outcome(first + i - 1) == outcome_converged) then
        response%truncation(first + i - 1) = 1.0_wp
      end if
    end do
    call judge_chunk(system, load, more, judging, response, first, last, fraction, compliance)

  contains

    !> No solution at the points that are not finished.
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

  !> A motion that was found, and not given up; NaN where none was found is not compared.
  pure logical function to_be_judged(response, i)
    type(response_type), intent(in) :: response
    integer, intent(in) :: i
    to_be_judged = .false.
    if (response%outcome(i) == outcome_converged) to_be_judged = response%truncation(i) < 1.0_wp
  end function to_be_judged

  !> What the orders left out would change: two turns with `more` of them from the motion
  !! found, the first of which finds them and the second what they do to the others, which
  !! then goes on by the rate of the iteration.
  subroutine judge_chunk(system, load, more, work, response, first, last, fraction, compliance)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    type(harmonic_set_type), intent(in) :: more
    type(block_type), intent(inout) :: work
    type(response_type), intent(inout) :: response
    integer, intent(in) :: first, last
    complex(wp), intent(in) :: fraction(:, :, :), compliance(:, :, :, :)
    !> Sizes of the motion, of what the first turn finds, of its change in the second, and
    !! of the change of the orders kept.
    real(wp), dimension(n_lanes) :: whole, found, rest, back
    real(wp), allocatable :: kept(:, :, :, :)
    complex(wp) :: p(system%n_dof())
    integer :: lane, i, k, m, at
    real(wp) :: short

    m = size(response%orders)
    i = first
    do
      work%point = 0
      lane = 0
      do while (i <= last .and. lane < n_lanes)
        if (to_be_judged(response, i)) then
          lane = lane + 1
          at = i - first + 1
          work%point(lane) = i
          work%f_re(lane, :, :) = real(fraction(at, :, :))
          work%f_im(lane, :, :) = aimag(fraction(at, :, :))
          work%c_re(lane, :, :, :) = real(compliance(:, :, at, :))
          work%c_im(lane, :, :, :) = aimag(compliance(:, :, at, :))
          do k = 1, size(more%orders)
            p = load%coefficient(system, more%orders(k), response%nu(i))
            work%load(lane, 1, k, :) = real(p)
            work%load(lane, 2, k, :) = aimag(p)
          end do
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
      call nonlinear_force(work, system, more)
      call solve_lanes(work)
      rest = lane_norm(system, work%next(:, :, m + 1:, :) - work%u(:, :, m + 1:, :))
      ! Against the first turn, and so without what the iteration has left.
      back = lane_norm(system, work%next(:, :, :m, :) - kept)
      do lane = 1, n_lanes
        at = work%point(lane)
        if (at == 0 .or. .not. whole(lane) > 0.0_wp) cycle
        short = 1.0_wp
        if (found(lane) > 0.0_wp) short = 1.0_wp/(1.0_wp - min(rest(lane)/found(lane), slowest))
        back(lane) = back(lane)/max(1.0_wp - response%rate(at), stagnant)
        response%truncation(at) = short*max(found(lane), back(lane))/whole(lane)
      end do
    end do
  end subroutine judge_chunk

  !> Largest of sqrt(M_dd) (|Re X| + |Im X|) of each lane.
  pure function lane_norm(system, x) result(norm)
    class(oscillator_type), intent(in) :: system
    !> Shape (n_lanes, 2, n_orders, n_dof).
    real(wp), intent(in) :: x(:, :, :, :)
    real(wp) :: norm(n_lanes)
    integer :: d, k
    norm = 0.0_wp
    do d = 1, size(x, 4)
      do k = 1, size(x, 3)
        norm = max(norm, sqrt(system%mass(d, d))*(abs(x(:, 1, k, d)) + abs(x(:, 2, k, d))))
      end do
    end do
  end function lane_norm

  !> Start a point from its linear response.
  subroutine load_lane(work, lane, point, system, load, set, relaxation, nu, fraction, &
                       compliance)
    type(block_type), intent(inout) :: work
    integer, intent(in) :: lane, point
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: relaxation, nu
    complex(wp), intent(in) :: fraction(:, :), compliance(:, :, :)
    complex(wp) :: p(system%n_dof())
    integer :: k

    if (counting) call count_up(counted_loads, size(load%orders))
    work%point(lane) = point
    work%halvings(lane) = 0
    work%relaxation(lane) = merge(relaxation, 1.0_wp, relaxation > 0.0_wp)
    work%f_re(lane, :, :) = real(fraction)
    work%f_im(lane, :, :) = aimag(fraction)
    work%c_re(lane, :, :, :) = real(compliance)
    work%c_im(lane, :, :, :) = aimag(compliance)
    do k = 1, size(set%orders)
      p = load%coefficient(system, set%orders(k), nu)
      work%load(lane, 1, k, :) = real(p)
      work%load(lane, 2, k, :) = aimag(p)
    end do
    call restart_lane(work, lane)
  end subroutine load_lane

  !> (Re-)start a lane from its linear response.
  subroutine restart_lane(work, lane)
    type(block_type), intent(inout) :: work
    integer, intent(in) :: lane
    complex(wp) :: p(size(work%u, 4)), x(size(work%u, 4))
    integer :: k

    do k = 1, size(work%u, 3)
      p = cmplx(work%load(lane, 1, k, :), work%load(lane, 2, k, :), wp)
      x = matmul(cmplx(work%c_re(lane, :, :, k), work%c_im(lane, :, :, k), wp), p)
      work%u(lane, 1, k, :) = real(x)
      work%u(lane, 2, k, :) = aimag(x)
    end do
    work%iteration(lane) = 0
    work%recent(:, lane) = 0.0_wp
    work%smallest(lane) = huge(1.0_wp)
  end subroutine restart_lane

  !> Harmonics of the nonlinear force at the present iterates.
  subroutine nonlinear_force(work, system, set)
    type(block_type), intent(inout) :: work
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    integer :: j, d

    do d = 1, system%n_dof()
      call set%to_samples(work%u(:, :, :, d), work%u_samples(:, d))
    end do
    call system%deflection_remainder(work%u_samples, work%w_samples)
    do j = 1, system%n_memory()
      if (.not. system%bent(j)) cycle
      call set%to_harmonics(work%w_samples(:, j), work%w(:, :, :, j))
      if (system%kernel_of(j) == 0) cycle
      call retain(work%f_re(:, j, :), work%f_im(:, j, :), work%w(:, :, :, j))
    end do
    work%force = 0.0_wp
    if (.not. system%separable) call inseparable_force(work, system, set)
    do d = 1, system%n_dof()
      do j = 1, system%n_memory()
        if (.not. system%bent(j) .or. system%spread(d, j) == 0.0_wp) cycle
        work%force(:, :, :, d) = work%force(:, :, :, d) + system%spread(d, j)*work%w(:, :, :, j)
      end do
    end do
  end subroutine nonlinear_force

  !> The part F(u, v) - B v, for which v is needed in time, linear part and all.
  subroutine inseparable_force(work, system, set)
    type(block_type), intent(inout) :: work
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    real(wp) :: v(n_lanes, 2, size(set%orders))
    integer :: j, d

    do j = 1, system%n_memory()
      v = 0.0_wp
      do d = 1, system%n_dof()
        v = v + system%gather(j, d)*work%u(:, :, :, d)
      end do
      if (system%kernel_of(j) > 0) call retain(work%f_re(:, j, :), work%f_im(:, j, :), v)
      if (system%bent(j)) v = v + work%w(:, :, :, j)
      call set%to_samples(v, work%w_samples(:, j))
    end do
    call system%force_remainder(work%u_samples, work%w_samples, work%f_samples)
    do d = 1, system%n_dof()
      call set%to_harmonics(work%f_samples(:, d), work%force(:, :, :, d))
    end do
  end subroutine inseparable_force

  !> Multiply harmonics by what memory retains of each.
  pure subroutine retain(f_re, f_im, w)
    real(wp), intent(in) :: f_re(:, :), f_im(:, :)
    real(wp), intent(inout) :: w(:, :, :)
    real(wp) :: re
    integer :: k, l
    do k = 1, size(w, 3)
      do l = 1, n_lanes
        re = f_re(l, k)*w(l, 1, k) - f_im(l, k)*w(l, 2, k)
        w(l, 2, k) = f_re(l, k)*w(l, 2, k) + f_im(l, k)*w(l, 1, k)
        w(l, 1, k) = re
      end do
    end do
  end subroutine retain

  !> next_k = C_k (load_k - force_k).
  pure subroutine solve_lanes(work)
    type(block_type), intent(inout) :: work
    real(wp) :: re(n_lanes), im(n_lanes), p_re, p_im
    integer :: a, b, k, l

    do a = 1, size(work%u, 4)
      do k = 1, size(work%u, 3)
        re = 0.0_wp
        im = 0.0_wp
        do b = 1, size(work%u, 4)
          do l = 1, n_lanes
            p_re = work%load(l, 1, k, b) - work%force(l, 1, k, b)
            p_im = work%load(l, 2, k, b) - work%force(l, 2, k, b)
            re(l) = re(l) + work%c_re(l, a, b, k)*p_re - work%c_im(l, a, b, k)*p_im
            im(l) = im(l) + work%c_re(l, a, b, k)*p_im + work%c_im(l, a, b, k)*p_re
          end do
        end do
        work%next(:, 1, k, a) = re
        work%next(:, 2, k, a) = im
      end do
    end do
  end subroutine solve_lanes

  !> Compare next with present iterates and decide, lane by lane.
  !!
  !! Norm: the largest of sqrt(M_dd) (|Re X| + |Im X|), so that metres and
  !! radians weigh by inertia. With q the factor by which corrections shrink,
  !! the error left is about delta q/(1-q); both it and delta must meet the
  !! tolerance.
  subroutine judge_lanes(work, system, set, options, response, first)
    type(block_type), intent(inout) :: work
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    type(response_options), intent(in) :: options
    type(response_type), intent(inout) :: response
    integer, intent(in) :: first
    real(wp) :: norm(n_lanes), delta(n_lanes), poison(n_lanes), weight, start(n_lanes)
    real(wp) :: rate, error, largest
    integer :: d, k, l, i, outcome

    largest = system%largest_amplitude()
    norm = 0.0_wp
    delta = 0.0_wp
    start = 0.0_wp
    poison = 0.0_wp
    do d = 1, system%n_dof()
      weight = sqrt(system%mass(d, d))
      do k = 1, size(set%orders)
        do l = 1, n_lanes
          ! What is not a number may pass unseen through a maximum, but not through a sum.
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
        ! The step from rest to the linear response is the zeroth correction.
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
      rate = shrinkage(work%recent(:, l))
      error = delta(l)
      if (rate < 1.0_wp) error = delta(l)*max(1.0_wp, rate/(1.0_wp - rate))
      if (.not. ieee_is_finite(poison(l))) then
        outcome = outcome_overflow
      else if (error <= options%tolerance*norm(l) .and. rate < 1.0_wp) then
        outcome = outcome_converged
      else if (.not. norm(l) <= growth_limit*work%start_norm(l) .or. norm(l) > largest &
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
        cycle
      end if
      call store(work, l, response, i, outcome, rate)
    end do
  end subroutine judge_lanes

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

  !> Take the wanted fraction of the correction.
  pure subroutine advance(work, lane)
    type(block_type), intent(inout) :: work
    integer, intent(in) :: lane
    real(wp) :: fraction

    fraction = work%relaxation(lane)
    if (fraction < 1.0_wp) then
      work%u(lane, :, :, :) = work%u(lane, :, :, :) &
                              + fraction*(work%next(lane, :, :, :) - work%u(lane, :, :, :))
    else
      work%u(lane, :, :, :) = work%next(lane, :, :, :)
    end if
  end subroutine advance

  !> Write a lane's end into the response and free the lane.
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
