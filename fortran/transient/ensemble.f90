!> Many trajectories of one kind of system, eight at a time in the lanes; what is
!! learnt from them is gathered as they pass.
module viscovib_ensemble
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_set_underflow_mode, &
    ieee_support_underflow_control, ieee_value
  use viscovib_driven_system, only: differentiable_system_type, driven_system_type
  use viscovib_explicit, only: explicit_type, new_explicit
  use viscovib_kinds, only: i8, wp
  use viscovib_lane_statistics, only: lines_type, moments_type, new_lines, new_moments
  use viscovib_lanes, only: n_lanes
  use viscovib_stops, only: find_stop, least_between, run_coarse, run_completed, stop_type
  use viscovib_tangent_system, only: new_tangent_system, tangent_system_type
  use viscovib_vector_math, only: largest_angle
  implicit none
  private

  public :: ensemble_job, ensemble_block, run_block

  !> Steps between two looks at whether the run is to be given up.
  integer, parameter :: patience = 512
  !> Steps between two rescalings of a disturbance.
  integer, parameter :: rescaling = 8
  !> Weighs velocities in the test for runaway lanes: beyond 1e15 they are.
  real(wp), parameter :: speed_weight = 1.0e-9_wp

  !> What to do with every trajectory.
  type :: ensemble_job
    !> Place in `explicit_names`.
    integer :: method = 3
    !> Steps in all; those before anything is gathered; between samples; between
    !! two points of a section (0: none wanted).
    integer(i8) :: n_steps = 1, n_discard = 0, sample_every = 1, section_every = 0
    logical :: moments = .false., lyapunov = .false.
    !> Circular frequencies of lines wanted.
    real(wp), allocatable :: lines(:)
  end type ensemble_job

  !> A block of trajectories, and what was learnt. Lane first.
  type :: ensemble_block
    !> Before: start. After: the last state, that at t_reached, shape (n_lanes, n_dof).
    real(wp), allocatable :: q(:, :), v(:, :)
    !> Load frequencies, shape (n_lanes, n_drives); steps.
    real(wp), allocatable :: frequencies(:, :)
    real(wp) :: h(n_lanes) = 0.0_wp
    integer :: outcome(n_lanes) = run_completed
    real(wp) :: t_reached(n_lanes) = 0.0_wp
    real(wp), allocatable :: peak(:, :, :), mean(:, :, :), rms(:, :, :)
    complex(wp), allocatable :: lines(:, :, :)
    !> q and v of each section point, shape (n_lanes, 2 n_dof, n_points).
    real(wp), allocatable :: sections(:, :, :)
    !> Mean rate of growth of a small disturbance; NaN of a motion that stops.
    real(wp) :: lyapunov(n_lanes) = 0.0_wp
  end type ensemble_block

contains

  !> Run a block from time 0; `cancel` may be set from elsewhere to give up.
  subroutine run_block(job, system, block, cancel)
    type(ensemble_job), intent(in) :: job
    class(differentiable_system_type), intent(in) :: system
    type(ensemble_block), intent(inout) :: block
    integer, intent(inout), volatile :: cancel
    type(tangent_system_type) :: disturbed

    if (job%lyapunov) then
      call new_tangent_system(disturbed, system)
      call run(job, disturbed, system%n_dof, block, cancel)
    else
      call run(job, system, system%n_dof, block, cancel)
    end if
  end subroutine run_block

  subroutine run(job, system, n, block, cancel)
    type(ensemble_job), intent(in) :: job
    class(driven_system_type), intent(in) :: system
    !> Coordinates of the motion itself; the others are its disturbance.
    integer, intent(in) :: n
    type(ensemble_block), intent(inout) :: block
    integer, intent(inout), volatile :: cancel
    type(explicit_type) :: method
    type(moments_type) :: moments
    type(lines_type) :: lines
    real(wp), dimension(n_lanes, system%n_dof) :: q, v, q_before, v_before
    real(wp), dimension(n_lanes) :: growth, margin, rate, margin_before, rate_before, nowhere
    logical, dimension(n_lanes) :: alive, good, doubtful
    integer(i8) :: i, n_samples
    integer :: l

    ! As in viscovib_simulate.
    if (ieee_support_underflow_control(1.0_wp)) call ieee_set_underflow_mode(.false.)
    q = 0.0_wp
    v = 0.0_wp
    q(:, :n) = block%q
    v(:, :n) = block%v
    ! A disturbance in no special direction.
    if (system%n_dof > n) q(:, n + 1:) = 1.0_wp/sqrt(real(n, wp))
    call new_explicit(method, system%n_dof, job%method, block%frequencies, q, v, 0.0_wp, block%h)
    call new_moments(moments, n)
    n_samples = (job%n_steps - job%n_discard)/job%sample_every
    call new_lines(lines, n, job%lines, block%h*real(job%n_discard + job%sample_every, wp), &
                   block%h*real(job%sample_every, wp), n_samples)
    alive = .true.
    growth = 0.0_wp
    call measure_margin()
    do i = 1, job%n_steps
      if (mod(i, int(patience, i8)) == 0) then
        if (cancel /= 0) exit
        if (.not. any(alive)) exit
      end if
      q_before = q
      v_before = v
      margin_before = margin
      rate_before = rate
      call method%step(system)
      call method%get_state(q, v)
      good = sum(abs(q(:, :n)), 2) + speed_weight*sum(abs(v(:, :n)), 2) <= largest_angle
      call measure_margin()
      doubtful = alive .and. .not. (good .and. least_between(margin_before, rate_before, margin, &
                                                             rate) > 0.0_wp)
      if (any(doubtful)) call judge_lanes()
      if (system%n_dof > n .and. (mod(i, int(rescaling, i8)) == 0 .or. i == job%n_discard &
                                  .or. i == job%n_steps)) call rescale()
      if (i <= job%n_discard) cycle
      if (mod(i - job%n_discard, job%sample_every) == 0) then
        if (job%moments) call moments%add(q, v, alive)
        if (lines%n > 0) call lines%add(q, alive)
      end if
      if (job%section_every > 0) then
        if (mod(i - job%n_discard, job%section_every) == 0) call keep_section()
      end if
    end do
    where (alive) block%t_reached = block%h*real(job%n_steps, wp)
    do l = 1, n_lanes
      if (.not. alive(l)) cycle
      block%q(l, :) = q(l, :n)
      block%v(l, :) = v(l, :n)
    end do
    if (job%moments) then
      allocate (block%mean(n_lanes, n, 2), block%rms(n_lanes, n, 2))
      call moments%means(block%mean, block%rms)
      block%peak = moments%peak(:, :n, :)
    end if
    ! Of a motion that stopped, peaks and means are those until then; what belongs to the
    ! whole of it is not known.
    nowhere = merge(0.0_wp, ieee_value(1.0_wp, ieee_quiet_nan), alive)
    if (lines%n > 0) then
      block%lines = lines%amplitudes()
      block%lines = block%lines + spread(spread(nowhere, 2, lines%n), 3, n)
    end if
    block%lyapunov = growth/(block%h*real(job%n_steps - job%n_discard, wp)) + nowhere

  contains

    !> Margin of the physics in every lane, and its change in a step.
    subroutine measure_margin()
      margin = system%margin(q)
      rate = system%margin(q + spread(block%h, 2, system%n_dof)*v) - margin
    end subroutine measure_margin

    !> Lanes whose motion stops inside the step stand still from now on.
    subroutine judge_lanes()
      type(stop_type) :: stop
      integer :: l
      do l = 1, n_lanes
        if (.not. doubtful(l)) cycle
        call find_stop(system, n, l, block%frequencies, q_before(l, :), v_before(l, :), &
                       real(i - 1, wp)*block%h(l), block%h(l), stop)
        if (stop%outcome == run_completed .or. stop%outcome == run_coarse) then
          if (good(l) .and. margin(l) > 0.0_wp) cycle
          stop%outcome = run_coarse
          stop%ahead = 0.0_wp
          stop%q = q_before(l, :)
          stop%v = v_before(l, :)
        end if
        block%outcome(l) = stop%outcome
        block%t_reached(l) = real(i - 1, wp)*block%h(l) + stop%ahead
        alive(l) = .false.
        block%q(l, :) = stop%q(:n)
        block%v(l, :) = stop%v(:n)
        ! Beside a stop accelerations may be infinite: the lane waits at rest instead.
        q(l, :) = 0.0_wp
        v(l, :) = 0.0_wp
        call method%set_lane(l, q(l, :), v(l, :))
        call method%stop_lane(l)
      end do
    end subroutine judge_lanes

    subroutine rescale()
      real(wp) :: size_now(n_lanes)
      size_now = sqrt(sum(q(:, n + 1:)**2, 2) + sum(v(:, n + 1:)**2, 2))
      where (alive .and. size_now > 0.0_wp)
        growth = growth + log(size_now)
      else where
        size_now = 1.0_wp
      end where
      if (i <= job%n_discard) growth = 0.0_wp
      call method%scale_lanes(n + 1, 1.0_wp/size_now)
    end subroutine rescale

    subroutine keep_section()
      integer :: point, d, l
      point = int((i - job%n_discard)/job%section_every)
      if (point > size(block%sections, 3)) return
      do l = 1, n_lanes
        if (.not. alive(l)) cycle
        do d = 1, n
          block%sections(l, 2*d - 1, point) = q(l, d)
          block%sections(l, 2*d, point) = v(l, d)
        end do
      end do
    end subroutine keep_section

  end subroutine run

end module viscovib_ensemble
