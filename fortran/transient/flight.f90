! Optimize: -O3
!> A block of trajectories in progress, one per lane: their states, their stops, and the
!! quantities accumulated along the way.
module viscovib_flight
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_driven_system, only: differentiable_system_type, driven_system_type
  use viscovib_explicit, only: explicit_type, new_explicit
  use viscovib_explicit_tables, only: is_series
  use viscovib_kinds, only: i8, wp
  use viscovib_lane_moments, only: moments_type, new_moments
  use viscovib_lane_watch, only: lane_watch
  use viscovib_lanes, only: max_dof, n_lanes
  use viscovib_phases, only: split_phase, step_phase
  use viscovib_run_history, only: run_history
  use viscovib_stops, only: find_stop, needs_small_steps, stop_type, within_reach
  use viscovib_time_run, only: run_coarse, run_completed
  use viscovib_vector_math, only: sine_cosine_lanes
  implicit none
  private

  public :: after_step, before_step, ensemble_block, ensemble_job, flight_type, gather, land, &
    take_off

  !> Number of samples; error of the mean rate in units of the range of the deviation from a
  !! straight line, over the time: for a random walk a factor of 2 is 2.5 standard deviations.
  integer, parameter :: most_looks = 64
  real(wp), parameter :: in_ranges = 2.0_wp, golden = 0.5_wp*(sqrt(5.0_wp) - 1.0_wp)

  !> Growth of perturbations at samples of the averaging time, from its beginning.
  type :: growth_course
    integer :: n = 0
    !> Number of steps of the averaging time, and step of the next sample.
    integer(i8) :: steps = 0, next = 0
    !> Fractions of that time, and logarithms, shape (n_lanes, n_exponents, 0:most_looks).
    real(wp) :: at(0:most_looks) = 0.0_wp
    real(wp), allocatable :: growth(:, :, :)
  contains
    procedure :: begin
    procedure :: see
    procedure :: unsure
    procedure, private :: place_next
  end type growth_course

  !> Amplitudes at given frequencies: u = mean + Re(X exp(i omega t)), by
  !! projection under a Hann window over the whole record.
  type :: lines_type
    integer :: n_dof = 0, n = 0
    integer(i8) :: n_samples = 0, i = 0
    real(wp), allocatable, private :: high(:, :), low(:, :), step_high(:, :), step_low(:, :)
    !> Lane; lane and line; lane and coordinate; lane, line and coordinate.
    real(wp), private :: weight(n_lanes) = 0.0_wp, mean(n_lanes, max_dof) = 0.0_wp
    complex(wp), allocatable, private :: empty(:, :), sums(:, :, :)
  contains
    procedure :: add => add_lines
    procedure :: amplitudes
  end type lines_type

  !> Steps between two normalizations of the perturbations.
  integer, parameter :: rescaling = 8
  !> Relative rounding error of a rate.
  real(wp), parameter :: rounding = 8.0_wp*epsilon(1.0_wp)

  !> Options for every trajectory.
  type :: ensemble_job
    !> Index in `lane_methods`.
    integer :: method = 3
    !> Number of steps; steps before accumulation begins; steps between samples of lines; steps
    !! between points of a section (0: no section).
    integer(i8) :: n_steps = 1, n_discard = 0, sample_every = 1, section_every = 0
    !> Request peaks, means and rms; their interval begins this part of a step earlier.
    logical :: moments = .false.
    real(wp) :: ahead = 0.0_wp
    !> Number of Lyapunov exponents, from the largest on.
    integer :: n_exponents = 0
    !> Circular frequencies of the requested lines.
    real(wp), allocatable :: lines(:)
  end type ensemble_job

  !> A block of trajectories and their results. Lane first.
  type :: ensemble_block
    !> On entry the start; on return the state at t_reached, shape (n_lanes, n_dof).
    real(wp), allocatable :: q(:, :), v(:, :)
    !> Load frequencies, shape (n_lanes, n_drives); step sizes.
    real(wp), allocatable :: frequencies(:, :)
    real(wp) :: h(n_lanes) = 0.0_wp
    integer :: outcome(n_lanes) = run_completed
    real(wp) :: t_reached(n_lanes) = 0.0_wp
    real(wp), allocatable :: peak(:, :, :), mean(:, :, :), rms(:, :, :)
    complex(wp), allocatable :: lines(:, :, :)
    !> q and v of each section point, shape (n_lanes, 2 n_dof, n_points).
    real(wp), allocatable :: sections(:, :, :)
    !> Lyapunov exponents, shape (n_lanes, n_exponents); NaN for a motion
    !! that stops.
    real(wp), allocatable :: lyapunov(:, :)
    !> Errors of the exponents due to the finite averaging time.
    real(wp), allocatable :: lyapunov_error(:, :)
    !> True if steps may have missed a thin layer of a force.
    logical :: missed(n_lanes) = .false.
  contains
    procedure :: set_starts
  end type ensemble_block

  !> A block in progress: states of its lanes, margins to a stop, and accumulators.
  type :: flight_type
    !> Number of coordinates of the motion itself; further ones are its perturbation.
    integer :: n = 0
    !> True if the steps are made for many blocks together; else by `method`.
    logical :: together = .false.
    type(explicit_type) :: method
    !> The same motion with further perturbations, one each.
    type(explicit_type), allocatable :: others(:)
    type(moments_type) :: moments
    type(lines_type) :: lines
    real(wp), allocatable :: q(:, :), v(:, :), q_before(:, :), v_before(:, :)
    !> Accelerations, if peaks and means are requested.
    real(wp) :: a(n_lanes, max_dof) = 0.0_wp
    real(wp), dimension(n_lanes) :: margin = 0.0_wp, rate = 0.0_wp
    real(wp), allocatable :: growth(:, :)
    type(growth_course) :: course
    logical :: alive(n_lanes) = .true.
    !> Previous states, times in steps.
    type(run_history) :: past
    type(lane_watch) :: layers
  end type flight_type

contains

  !> Set the starts of some runs, one per lane.
  subroutine set_starts(self, runs, starts, h, n_drives, n_points)
    class(ensemble_block), intent(out) :: self
    !> Displacements and velocities alternately, a column per run; step size of each run.
    integer, intent(in) :: runs(n_lanes)
    real(wp), intent(in) :: starts(:, :), h(:)
    !> Number of load frequencies, and of points of a section.
    integer, intent(in) :: n_drives, n_points

    integer :: l

    allocate (self%q(n_lanes, size(starts, 1)/2))
    allocate (self%v, mold=self%q)
    do l = 1, n_lanes
      self%q(l, :) = starts(1::2, runs(l))
      self%v(l, :) = starts(2::2, runs(l))
      self%h(l) = h(runs(l))
    end do
    allocate (self%frequencies(n_lanes, n_drives))
    allocate (self%sections(n_lanes, size(starts, 1), n_points), source=0.0_wp)
  end subroutine set_starts

  !> Initialize at time 0.
  subroutine take_off(f, job, system, motion, block)
    type(flight_type), intent(out) :: f
    type(ensemble_job), intent(in) :: job
    class(driven_system_type), intent(in) :: system
    class(differentiable_system_type), intent(in) :: motion
    type(ensemble_block), intent(in) :: block
    integer(i8) :: n_samples
    integer :: n
    n = motion%n_dof
    f%n = n
    allocate (f%q(n_lanes, system%n_dof), f%v(n_lanes, system%n_dof), source=0.0_wp)
    f%q(:, :n) = block%q
    f%v(:, :n) = block%v
    ! A perturbation in no special direction.
    if (system%n_dof > n) f%q(:, n + 1:) = 1.0_wp/sqrt(real(n, wp))
    allocate (f%growth(n_lanes, max(job%n_exponents, 1)), source=0.0_wp)
    call f%course%begin(size(f%growth, 2), job%n_steps - job%n_discard)
    f%q_before = f%q
    f%v_before = f%v
    f%together = is_series(job%method)
    if (.not. f%together) then
      call new_explicit(f%method, system%n_dof, job%method, block%frequencies, f%q, f%v, 0.0_wp, &
                        block%h)
      if (allocated(system%quarters)) call f%method%turn_phases(system%quarters)
    end if
    if (job%n_exponents > 1) call take_others(f, n, job%n_exponents - 1)
    if (job%moments) call new_moments(f%moments, n, block%h)
    if (job%moments .and. .not. f%together) call gather(f, system, job, 0_i8)
    n_samples = (job%n_steps - job%n_discard)/job%sample_every
    call new_lines(f%lines, n, job%lines, &
                   block%h*real(job%n_discard + job%sample_every, wp), &
                   block%h*real(job%sample_every, wp), n_samples)
    call measure_margin(f, system, block%h)
    call f%layers%begin(motion, f%q, f%v, f%together)
  end subroutine take_off

  !> Add step i, which ends here, to peaks and means; before their interval begins only its
  !! end is stored.
  subroutine gather(f, system, job, i)
    type(flight_type), intent(inout) :: f
    class(driven_system_type), intent(in) :: system
    type(ensemble_job), intent(in) :: job
    integer(i8), intent(in) :: i

    if (i < job%n_discard - 2) return
    if (.not. f%together) call f%method%get_accelerations(system, f%a)
    if (i > job%n_discard) then
      call f%moments%add(f%q, f%v, f%a, f%alive, 1.0_wp)
    else if (i == job%n_discard .and. job%ahead > 0.0_wp) then
      call f%moments%add(f%q, f%v, f%a, f%alive, job%ahead)
    else
      call f%moments%begin(f%q, f%v, f%a)
    end if
  end subroutine gather

  !> Start further perturbations, each along its own coordinate or velocity.
  subroutine take_others(f, n, count)
    type(flight_type), intent(inout) :: f
    integer, intent(in) :: n, count
    real(wp) :: q(n_lanes, 2*n), v(n_lanes, 2*n)
    integer :: j

    allocate (f%others(count))
    do j = 1, count
      f%others(j) = f%method
      q = f%q
      v = f%v
      q(:, n + 1:) = 0.0_wp
      v(:, n + 1:) = 0.0_wp
      if (j <= n) then
        v(:, n + j) = 1.0_wp
      else
        q(:, j) = 1.0_wp
      end if
      call f%others(j)%set_from(n + 1, q, v)
    end do
    call rescale(f, .true.)
  end subroutine take_others

  !> Store the state at the start of step i.
  subroutine before_step(f, i)
    type(flight_type), intent(inout) :: f
    integer(i8), intent(in) :: i
    call keep(size(f%q, 2), f%q, f%v, f%q_before, f%v_before)
    if (f%past%is_due()) call f%past%note(real(i - 1, wp), [f%q, f%v])
  end subroutine before_step

  pure subroutine keep(n, q, v, q_before, v_before)
    integer, intent(in) :: n
    real(wp), intent(in), dimension(n_lanes, n) :: q, v
    real(wp), intent(out), dimension(n_lanes, n) :: q_before, v_before
    integer :: d, l
    do d = 1, n
      do l = 1, n_lanes
        q_before(l, d) = q(l, d)
        v_before(l, d) = v(l, d)
      end do
    end do
  end subroutine keep

  !> Process step i: lanes in which the motion stops remain constant from then on; requested
  !! quantities are accumulated in the other lanes.
  subroutine after_step(f, job, system, motion, block, i, made)
    type(flight_type), intent(inout) :: f
    type(ensemble_job), intent(in) :: job
    class(driven_system_type), intent(in) :: system
    class(differentiable_system_type), intent(in) :: motion
    type(ensemble_block), intent(inout) :: block
    integer(i8), intent(in) :: i
    logical, intent(in) :: made(n_lanes)

    call find_stops(f, job, system, motion, block, i, made)
    if (f%layers%on) then
      call f%layers%see(motion, real(i, wp), block%h, f%q, f%v, f%alive, block%missed)
      if (i == job%n_steps) call f%layers%look(motion, block%h, f%alive, block%missed)
    end if
    if (job%moments) call gather(f, system, job, i)
    if (system%n_dof > f%n .and. (mod(i, int(rescaling, i8)) == 0 .or. i == job%n_discard &
                                  .or. i == job%n_steps &
                                  .or. i - job%n_discard == f%course%next)) then
      call rescale(f, i <= job%n_discard)
      if (i > job%n_discard) call f%course%see(i - job%n_discard, f%growth)
    end if
    if (i <= job%n_discard) return
    if (f%lines%n > 0 .and. mod(i - job%n_discard, job%sample_every) == 0) then
      call f%lines%add(f%q, f%alive)
    end if
    if (job%section_every > 0) then
      if (mod(i - job%n_discard, job%section_every) == 0) then
        call keep_section(f, int((i - job%n_discard)/job%section_every), block)
      end if
    end if
  end subroutine after_step

  !> Detect lanes in which the motion stops within step i.
  subroutine find_stops(f, job, system, motion, block, i, made)
    type(flight_type), intent(inout) :: f
    type(ensemble_job), intent(in) :: job
    class(driven_system_type), intent(in) :: system
    class(differentiable_system_type), intent(in) :: motion
    type(ensemble_block), intent(inout) :: block
    integer(i8), intent(in) :: i
    logical, intent(in) :: made(n_lanes)
    real(wp), dimension(n_lanes) :: margin_before, rate_before, least
    logical, dimension(n_lanes) :: good, doubtful
    integer :: l

    good = made .and. size_in_range(f%n, f%q, f%v, system%range%coordinate, system%range%speed) &
           <= 1.0_wp
    doubtful = f%alive .and. .not. good
    ! Equations that are valid everywhere have a constant margin.
    if (system%limited) then
      margin_before = f%margin
      rate_before = f%rate
      call measure_margin(f, system, block%h)
      ! As `least_between`, which no compiler puts into lanes.
      least = min(margin_before, f%margin, margin_before + rate_before/3.0_wp, &
                  f%margin - f%rate/3.0_wp)
      if (f%method%table%implicit) least = min(least, f%method%margin_at_nodes(system))
      do l = 1, n_lanes
        if (doubtful(l) .or. .not. f%alive(l) .or. least(l) > within_reach) cycle
        doubtful(l) = needs_small_steps(motion, l, f%q_before(l, :f%n), f%v_before(l, :f%n), &
                                        block%h(l), least(l))
      end do
    end if
    if (.not. any(doubtful)) return
    do l = 1, n_lanes
      if (doubtful(l)) call check_lane(f, job, system, motion, block, i, l, good(l))
    end do
  end subroutine find_stops

  !> The size of motions relative to the largest allowed size.
  pure function size_in_range(n, q, v, coordinate, speed) result(part)
    integer, intent(in) :: n
    real(wp), intent(in) :: q(n_lanes, n), v(n_lanes, n), coordinate, speed
    real(wp) :: part(n_lanes), rates(n_lanes)
    integer :: d, l

    part = 0.0_wp
    rates = 0.0_wp
    do d = 1, n
      !GCC$ unroll 1
      do l = 1, n_lanes
        part(l) = part(l) + abs(q(l, d))
        rates(l) = rates(l) + abs(v(l, d))
      end do
    end do
    part = part/coordinate + rates/speed
  end function size_in_range

  !> Margin to the edge of the physical range in every lane, and its change in a step.
  subroutine measure_margin(f, system, h)
    type(flight_type), intent(inout) :: f
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: h(n_lanes)
    real(wp) :: ahead(n_lanes, system%n_dof)
    integer :: d
    do d = 1, system%n_dof
      ahead(:, d) = f%q(:, d) + h*f%v(:, d)
    end do
    f%margin = system%margin(f%q)
    f%rate = system%margin(ahead) - f%margin
  end subroutine measure_margin

  !> Test if the motion of a lane stops inside step i, and where.
  subroutine check_lane(f, job, system, motion, block, i, l, good)
    type(flight_type), intent(inout) :: f
    type(ensemble_job), intent(in) :: job
    class(driven_system_type), intent(in) :: system
    class(differentiable_system_type), intent(in) :: motion
    type(ensemble_block), intent(inout) :: block
    integer(i8), intent(in) :: i
    integer, intent(in) :: l
    logical, intent(in) :: good
    type(stop_type) :: stop
    integer :: k, point

    call find_stop(motion, f%n, l, block%frequencies, f%q_before(l, :f%n), f%v_before(l, :f%n), &
                   real(i - 1, wp)*block%h(l), block%h(l), stop)
    if (stop%outcome == run_completed .or. stop%outcome == run_coarse) then
      if (stop%outcome == run_completed .and. system%limited .and. stop%near_edge) then
        call put_motion(f, l, stop%q, stop%v)
        call measure_margin(f, system, block%h)
        return
      end if
      if (good .and. f%margin(l) > 0.0_wp) return
      stop%outcome = run_coarse
    end if
    call f%past%confirm(motion, n_lanes, f%n, l, block%frequencies, block%h(l), &
                        real(i - 1, wp)*block%h(l), block%h(l), stop)
    if (stop%outcome == run_coarse) then
      stop%ahead = 0.0_wp
      stop%q = f%q_before(l, :f%n)
      stop%v = f%v_before(l, :f%n)
    end if
    block%outcome(l) = stop%outcome
    block%t_reached(l) = real(i - 1, wp)*block%h(l) + stop%ahead
    ! Small steps may find the stop before points that were kept.
    do point = 1, size(block%sections, 3)
      if (block%t_reached(l) >= block%h(l)*real(job%n_discard + point*job%section_every, wp)) cycle
      block%sections(l, :, point) = ieee_value(1.0_wp, ieee_quiet_nan)
    end do
    f%alive(l) = .false.
    block%q(l, :) = stop%q
    block%v(l, :) = stop%v
    ! Near a stop accelerations may be infinite, so the lane continues at rest.
    f%q(l, :) = 0.0_wp
    f%v(l, :) = 0.0_wp
    if (f%together) return
    call f%method%set_lane(l, f%q(l, :), f%v(l, :))
    call f%method%stop_lane(l)
    if (allocated(f%others)) then
      do k = 1, size(f%others)
        call f%others(k)%set_lane(l, f%q(l, :), f%v(l, :))
        call f%others(k)%stop_lane(l)
      end do
    end if
  end subroutine check_lane

  !> Set the motion of a lane to the result of small steps; its perturbations remain.
  subroutine put_motion(f, l, q, v)
    type(flight_type), intent(inout) :: f
    integer, intent(in) :: l
    real(wp), intent(in) :: q(:), v(:)
    real(wp), dimension(n_lanes, size(f%q, 2)) :: other_q, other_v
    integer :: k

    f%q(l, :f%n) = q
    f%v(l, :f%n) = v
    call f%method%set_lane(l, f%q(l, :), f%v(l, :))
    if (.not. allocated(f%others)) return
    do k = 1, size(f%others)
      call f%others(k)%get_state(other_q, other_v)
      other_q(l, :f%n) = q
      other_v(l, :f%n) = v
      call f%others(k)%set_lane(l, other_q(l, :), other_v(l, :))
    end do
  end subroutine put_motion

  !> Orthonormalize the perturbations (Gram and Schmidt); their growth counts once
  !! accumulation has begun.
  subroutine rescale(f, too_early)
    type(flight_type), intent(inout) :: f
    logical, intent(in) :: too_early
    real(wp), dimension(n_lanes, size(f%q, 2)) :: q, v
    real(wp), allocatable :: at(:, :, :)
    real(wp) :: along(n_lanes)
    integer :: i, j, k

    allocate (at(n_lanes, 2*(size(f%q, 2) - f%n), size(f%growth, 2)))
    do j = 1, size(f%growth, 2)
      if (j == 1) then
        call f%method%get_state(q, v)
      else
        call f%others(j - 1)%get_state(q, v)
      end if
      at(:, :f%n, j) = q(:, f%n + 1:)
      at(:, f%n + 1:, j) = v(:, f%n + 1:)
      ! Twice: a single pass leaves the rounding error of large components.
      do k = 1, merge(2, 0, j > 1)
        do i = 1, j - 1
          along = sum(at(:, :, i)*at(:, :, j), 2)
          at(:, :, j) = at(:, :, j) - spread(along, 2, size(at, 2))*at(:, :, i)
        end do
      end do
      along = sqrt(sum(at(:, :, j)**2, 2))
      where (f%alive .and. along > 0.0_wp)
        f%growth(:, j) = f%growth(:, j) + log(along)
      else where
        along = 1.0_wp
      end where
      at(:, :, j) = at(:, :, j)/spread(along, 2, size(at, 2))
      if (j == 1) then
        call f%method%scale_lanes(f%n + 1, 1.0_wp/along)
      else
        q(:, f%n + 1:) = at(:, :f%n, j)
        v(:, f%n + 1:) = at(:, f%n + 1:, j)
        call f%others(j - 1)%set_from(f%n + 1, q, v)
      end if
    end do
    if (too_early) f%growth = 0.0_wp
  end subroutine rescale

  subroutine keep_section(f, point, block)
    type(flight_type), intent(in) :: f
    integer, intent(in) :: point
    type(ensemble_block), intent(inout) :: block
    integer :: d, l
    if (point > size(block%sections, 3)) return
    do l = 1, n_lanes
      if (.not. f%alive(l)) cycle
      do d = 1, f%n
        block%sections(l, 2*d - 1, point) = f%q(l, d)
        block%sections(l, 2*d, point) = f%v(l, d)
      end do
    end do
  end subroutine keep_section

  !> Store final states and accumulated quantities.
  subroutine land(f, job, block)
    type(flight_type), intent(inout) :: f
    type(ensemble_job), intent(in) :: job
    type(ensemble_block), intent(inout) :: block
    real(wp) :: nowhere(n_lanes)
    integer :: l

    where (f%alive) block%t_reached = block%h*real(job%n_steps, wp)
    do l = 1, n_lanes
      if (.not. f%alive(l)) cycle
      block%q(l, :) = f%q(l, :f%n)
      block%v(l, :) = f%v(l, :f%n)
    end do
    if (job%moments) then
      allocate (block%peak(n_lanes, f%n, 2))
      allocate (block%mean, block%rms, mold=block%peak)
      call f%moments%hand_over(block%peak, block%mean, block%rms)
    end if
    ! For a motion that stopped, peaks and means are those until the stop; quantities of the
    ! whole motion are NaN.
    nowhere = merge(0.0_wp, ieee_value(1.0_wp, ieee_quiet_nan), f%alive)
    if (f%lines%n > 0) then
      block%lines = f%lines%amplitudes()
      block%lines = block%lines + spread(spread(cmplx(nowhere, nowhere, wp), 2, f%lines%n), 3, f%n)
    end if
    block%lyapunov = f%growth/spread(block%h*real(job%n_steps - job%n_discard, wp), 2, &
                                     size(f%growth, 2)) + spread(nowhere, 2, size(f%growth, 2))
    block%lyapunov_error = f%course%unsure()/spread(block%h*real(job%n_steps - job%n_discard, wp), &
                                                    2, size(f%growth, 2)) &
                           + rounding*abs(block%lyapunov) + spread(nowhere, 2, size(f%growth, 2))
  end subroutine land

  ! Growth of small perturbations along a motion, and the error of its mean rate.

  pure subroutine begin(self, n_exponents, steps)
    class(growth_course), intent(inout) :: self
    integer, intent(in) :: n_exponents
    integer(i8), intent(in) :: steps
    allocate (self%growth(n_lanes, n_exponents, 0:most_looks), source=0.0_wp)
    self%steps = steps
    call self%place_next()
  end subroutine begin

  !> Samples are not equidistant, to avoid equal phases of oscillations: each is a fraction from the
  !! golden section before an equidistant time. The last is at the end.
  pure subroutine place_next(self)
    class(growth_course), intent(inout) :: self
    real(wp) :: k
    k = real(self%n + 1, wp)
    if (self%n + 1 < most_looks) k = k - modulo(k*golden, 1.0_wp)
    self%next = max(self%next + 1, int(self%steps*(k/most_looks), i8))
    if (self%n + 1 == most_looks) self%next = self%steps
  end subroutine place_next

  !> Store the growth after `done` steps, if a sample is due.
  pure subroutine see(self, done, growth)
    class(growth_course), intent(inout) :: self
    integer(i8), intent(in) :: done
    real(wp), intent(in) :: growth(:, :)
    if (done /= self%next .and. done /= self%steps) return
    self%n = self%n + 1
    self%at(self%n) = real(done, wp)/real(self%steps, wp)
    self%growth(:, :, self%n) = growth
    call self%place_next()
  end subroutine see

  !> Error of the mean growth rate, times the time. If the growth fluctuates about a straight line,
  !! as near chaos, or approaches one, as after a start, the error of its mean rate is a part of the
  !! deviation: for a random walk over a time T the mean range of the deviation from its chord is
  !! 1.25 standard deviations of its end; for a start that adds C, it is C.
  pure function unsure(self) result(off)
    class(growth_course), intent(in) :: self
    real(wp) :: off(size(self%growth, 1), size(self%growth, 2))
    real(wp), dimension(size(off, 1), size(off, 2)) :: least, most, nearby
    integer :: k
    least = 0.0_wp
    most = 0.0_wp
    do k = 1, self%n
      nearby = self%growth(:, :, k) - self%at(k)*self%growth(:, :, self%n)
      least = min(least, nearby)
      most = max(most, nearby)
    end do
    off = in_ranges*(most - least)
  end function unsure

  ! Amplitudes at given frequencies, accumulated along trajectories without storing them:
  ! one accumulator per lane.

  !> Lines at circular frequencies omega from samples at start + i step, i = 0
  !! ... n_samples - 1; step differs from lane to lane.
  pure subroutine new_lines(lines, n_dof, omega, start, step, n_samples)
    type(lines_type), intent(out) :: lines
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: omega(:), start(n_lanes), step(n_lanes)
    integer(i8), intent(in) :: n_samples
    integer :: n

    n = size(omega)
    lines%n_dof = n_dof
    lines%n = n
    lines%n_samples = n_samples
    allocate (lines%high(n_lanes, n), lines%low(n_lanes, n))
    allocate (lines%step_high(n_lanes, n), lines%step_low(n_lanes, n))
    call split_phase(spread(omega, 1, n_lanes), spread(start, 2, n), lines%high, lines%low)
    call split_phase(spread(omega, 1, n_lanes), spread(step, 2, n), lines%step_high, &
                     lines%step_low)
    allocate (lines%empty(n_lanes, n), lines%sums(n_lanes, n, n_dof), source=(0.0_wp, 0.0_wp))
  end subroutine new_lines

  pure subroutine add_lines(self, q, alive)
    class(lines_type), intent(inout) :: self
    real(wp), intent(in) :: q(n_lanes, *)
    logical, intent(in) :: alive(n_lanes)
    real(wp) :: window(n_lanes), s(n_lanes), c(n_lanes)
    complex(wp) :: turned(n_lanes)
    integer :: j, d

    ! The window vanishes one sample before the first and one after the last.
    window = merge(sin(pi*real(self%i + 1, wp)/real(self%n_samples + 1, wp))**2, 0.0_wp, alive)
    self%i = self%i + 1
    self%weight = self%weight + window
    do d = 1, self%n_dof
      self%mean(:, d) = self%mean(:, d) + window*q(:, d)
    end do
    do j = 1, self%n
      call sine_cosine_lanes(self%high(:, j), s, c)
      turned = window*cmplx(c - s*self%low(:, j), -(s + c*self%low(:, j)), wp)
      self%empty(:, j) = self%empty(:, j) + turned
      do d = 1, self%n_dof
        self%sums(:, j, d) = self%sums(:, j, d) + q(:, d)*turned
      end do
    end do
    call step_phase(self%high, self%low, self%step_high, self%step_low)
  end subroutine add_lines

  !> X, shape (n_lanes, n, n_dof), without the leakage of the mean.
  pure function amplitudes(self) result(x)
    class(lines_type), intent(in) :: self
    complex(wp) :: x(n_lanes, self%n, self%n_dof)
    integer :: l, d
    do d = 1, self%n_dof
      do l = 1, n_lanes
        if (self%weight(l) > 0.0_wp) then
          x(l, :, d) = 2.0_wp*(self%sums(l, :, d) &
                               - self%mean(l, d)/self%weight(l)*self%empty(l, :))/self%weight(l)
        else
          x(l, :, d) = (0.0_wp, 0.0_wp)
        end if
      end do
    end do
  end function amplitudes

end module viscovib_flight
