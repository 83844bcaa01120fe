!> A motion with memory as one job: a periodic load, a start, an end.
module viscovib_hereditary_job
  use viscovib_base_motion, only: base_motion_type
  use viscovib_memory_channels, only: channels_type, new_channels
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_constants, only: pi
  use viscovib_counters, only: count_up, counted_idle, counted_runs, counting
  use viscovib_hereditary, only: begun, hereditary_type, new_hereditary, no_exponentials, &
    past_direct, past_exponentials, step_too_large
  use viscovib_hereditary_run, only: run_hereditary
  use viscovib_histories, only: error_of_sums
  use viscovib_kinds, only: i8, wp
  use viscovib_law_layers, only: unseen_by_node
  use viscovib_load, only: load_type
  use viscovib_march, only: march_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_plan_text, only: tell_idle, tell_laws, tell_zeros
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: moved_coordinates, reduce, state_mask
  use viscovib_run_maker, only: located_from
  use viscovib_simulate, only: run_coarse, run_diverged, run_event
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_time_load, only: time_load_type
  use viscovib_trajectory, only: shaken
  use viscovib_transient_job, only: first_steps, make_runs, max_steps, run_maker, &
    trajectory_type, transient_job
  use viscovib_transient_plan, only: plan_steps
  use viscovib_watch, only: new_watch
  implicit none
  private

  public :: hereditary_job, hereditary_runs, run_hereditary_job, plan_hereditary, plan_forces
  public :: make_hereditary

  !> Methods by their nodes a step, and steps a fastest period to begin with.
  character(len=*), parameter, public :: hereditary_methods(5) = &
    [character(len=6) :: 'gauss8', 'gauss6', 'gauss4', 'gauss3', 'gauss2']
  integer, parameter, public :: nodes(5) = [8, 6, 4, 3, 2], per_period(5) = [2, 3, 6, 8, 12]
  !> How the past is kept; 'auto': as exponentials where the kernels are such sums.
  character(len=*), parameter, public :: past_names(3) = &
    [character(len=12) :: 'auto', 'exponentials', 'direct']
  integer, parameter :: past_auto = 1, keep_exponentials = 2, keep_direct = 3
  !> Steps up to which all of the past is affordable without being asked for.
  integer(i8), parameter :: most_direct = 20000_i8
  !> Kernels as exponentials reach so much further than the run.
  real(wp), parameter, public :: reach = 100.0_wp
  real(wp), parameter :: rounding = 1.0e-15_wp
  !> Part of the usual error of equations of memory where that met no tolerance.
  real(wp), parameter :: sharper = 1.0e-4_wp

  !> `method` is the place in `hereditary_methods`.
  type, extends(transient_job) :: hereditary_job
    !> Circular frequency of the load (rad/s), if it has one.
    real(wp) :: nu = 0.0_wp
    !> Place in `past_names`.
    integer :: past = past_auto
  end type hereditary_job

  !> Runs of one system under one load, whatever equations their steps solve.
  type, abstract, extends(run_maker) :: hereditary_runs
    class(oscillator_type), pointer :: system => null()
    type(time_load_type) :: load
    type(base_motion_type) :: base
    !> What is kept of the state, at the start, (u_1, u'_1, ...).
    real(wp), allocatable :: first(:)
    !> Part of the usual error to which equations of memory are solved, and steps of the first run:
    !! they are solved as much better as steps are shorter, as two runs that leave as much of them
    !! differ by none of it.
    real(wp) :: sharper = 1.0_wp
    integer(i8) :: n_first = 1_i8
  contains
    procedure :: make
    procedure :: make_shaken
    procedure(start_interface), deferred :: start
    procedure(shake_interface), deferred :: shake
    procedure :: align
    procedure :: renames
  end type hereditary_runs

  abstract interface

    !> A run at its start, in steps h, its past kept as `past` says; `shortest`: the shortest step
    !! that kernels are fitted for, without: h.
    subroutine start_interface(self, job, base, past, h, solved, run, reason, shortest)
      import :: base_motion_type, hereditary_job, hereditary_runs, march_type, wp
      class(hereditary_runs), intent(in) :: self
      type(hereditary_job), intent(in) :: job
      type(base_motion_type), intent(inout) :: base
      integer, intent(in) :: past
      !> `solved`: relative error of the kernels as exponentials and of a step's solution.
      real(wp), intent(in) :: h, solved
      class(march_type), allocatable, intent(out) :: run
      integer, intent(out) :: reason
      real(wp), intent(in), optional :: shortest
    end subroutine start_interface

    !> Begin at a start, with a system, whose numbers are other by as much as `shaken`; `sign`: of
    !! what is added to the start.
    subroutine shake_interface(self, sign)
      import :: hereditary_runs
      class(hereditary_runs), intent(inout) :: self
      integer, intent(in) :: sign
    end subroutine shake_interface

  end interface

  !> Runs whose state are the coordinates themselves.
  type, extends(hereditary_runs) :: coordinate_runs
    !> One of other masses.
    class(oscillator_type), pointer :: other => null()
  contains
    procedure :: start => start_coordinates
    procedure :: shake => shake_coordinates
  end type coordinate_runs

contains

  !> The motion wanted; coordinates that nothing moves are left out of the equations.
  subroutine run_hereditary_job(job, system, load, fastest, trajectory, status)
    type(hereditary_job), intent(in) :: job
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Fastest natural frequency (rad/s).
    real(wp), intent(in) :: fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    type(polynomial_type) :: reduced
    type(hereditary_job) :: part_job
    type(load_type) :: part
    logical :: moved(system%n_dof())

    moved = moved_coordinates(system, driven(job, system, load))
    if (all(moved)) then
      call run_whole(job, system, load, fastest, trajectory, status)
      return
    end if
    call reduce(system, moved, reduced)
    call load%take_part(moved, part)
    part_job = job
    part_job%initial = pack(job%initial, state_mask(moved))
    part_job%held = pack(job%held, moved)
    call run_whole(part_job, reduced, part, fastest, trajectory, status)
    if (.not. status%failed()) call trajectory%spread_out(moved)
  end subroutine run_hereditary_job

  !> Coordinates that the load, the start or the past moves; of a watched motion all are computed.
  pure function driven(job, system, load)
    type(hereditary_job), intent(in) :: job
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    logical :: driven(size(job%held))
    driven = load%drives(system) .or. abs(job%held) > 0.0_wp &
             .or. abs(job%initial(1::2)) > 0.0_wp .or. abs(job%initial(2::2)) > 0.0_wp &
             .or. allocated(job%watched)
  end function driven

  !> The same with all coordinates.
  subroutine run_whole(job, system, load, fastest, trajectory, status)
    type(hereditary_job), intent(in) :: job
    class(oscillator_type), intent(in), target :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: fastest
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    class(oscillator_type), allocatable, target :: other
    type(coordinate_runs) :: maker
    real(wp) :: frequency
    integer :: k

    maker%system => system
    allocate (other, source=system)
    call other%weigh(1.0_wp - 2.0_wp*shaken)
    maker%other => other
    maker%first = job%initial
    allocate (maker%load%frequencies(size(load%orders)))
    allocate (maker%load%amplitudes(system%n_dof(), size(load%orders)))
    allocate (maker%load%breaks(0), maker%load%pieces(system%n_dof(), 4, 0))
    frequency = fastest
    do k = 1, size(load%orders)
      maker%load%frequencies(k) = load%orders(k)*job%nu
      maker%load%amplitudes(:, k) = load%coefficient(system, load%orders(k), job%nu)
      frequency = max(frequency, maker%load%frequencies(k))
    end do
    if (load%moves_base()) then
      maker%base%frequencies = maker%load%frequencies
      allocate (maker%base%amplitudes(system%n_dof(), size(load%orders)))
      do k = 1, size(load%orders)
        maker%base%amplitudes(:, k) = load%shift(system, k)
      end do
    end if
    frequency = job%t_end*frequency*per_period(job%method)/(2.0_wp*pi)
    if (counting) call count_up(counted_idle, count( &
                                .not. moved_coordinates(system, driven(job, system, load))))
    call make_hereditary(maker, job, max(4.0_wp, frequency), trajectory, status)
  end subroutine run_whole

  !> One run, or runs until the tolerance is met. A motion with memory that is unstable enlarges
  !! what is left in equations and kernels: where no step meets it, they are solved better.
  subroutine make_hereditary(maker, job, wanted, trajectory, status)
    class(hereditary_runs), intent(inout) :: maker
    class(hereditary_job), intent(in) :: job
    !> Steps to begin with where the step is to be found.
    real(wp), intent(in) :: wanted
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status

    maker%n_first = int(first_steps(job, min(wanted, 2.0_wp*max_steps)), i8)
    call make_runs(maker, job, wanted, trajectory, status)
    if (.not. (status%failed() .and. job%dt <= 0.0_wp .and. any(maker%system%kernel_of > 0))) return
    if (status%subject /= 'tolerance') return
    maker%sharper = sharper
    call make_runs(maker, job, wanted, trajectory, status)
  end subroutine make_hereditary

  subroutine make(self, job, n, factor, parts, trajectory, status)
    class(hereditary_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor, parts
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    class(march_type), allocatable :: run
    type(base_motion_type) :: base
    real(wp), allocatable :: states(:, :), shortest
    real(wp), dimension(size(self%first)/2) :: u, v
    real(wp) :: no_times(0), no_states(size(self%first), 0), thinnest
    integer(i8) :: every, kept, i, steps
    integer :: reached, reason

    if (counting) call count_up(counted_runs, 1)
    select type (system => self%system)
    class is (polynomial_type)
      trajectory%over_kinks = any([(system%laws(i)%program%n_surfaces() > 0, &
                                    i=1, size(system%laws))])
    end select
    every = job%steps_apart(n, factor, parts)
    steps = n*factor
    trajectory%h = job%t_end/real(steps, wp)
    if (allocated(job%watched)) then
      allocate (trajectory%watch)
      call new_watch(trajectory%watch, job%watched, n_dof=size(u))
    end if
    allocate (states(size(self%first), steps/every))
    do i = 1, 2
      base = self%base
      select type (job)
      type is (hereditary_job)
        call begin(self, job, base, steps, trajectory%h, shortest, run, reason, status)
      end select
      if (status%failed()) return
      if (reason /= begun) then
        trajectory%outcome = run_coarse
        exit
      end if
      run%gives_up = job%dt <= 0.0_wp .and. factor < located_from
      call run_hereditary(run, self%system, self%load, base, 0_i8, steps, every, no_times, states, &
                          no_states, trajectory%n_steps, reached, trajectory%t_reached, &
                          trajectory%outcome, watch=trajectory%watch, thinnest=thinnest)
      trajectory%too_long = thinnest/(unseen_by_node*nodes(job%method))
      trajectory%by_phases = maxval(run%phase_errors())
      if (trajectory%outcome /= run_diverged .and. trajectory%outcome /= run_coarse) exit
      if (allocated(shortest) .or. size(self%system%kernels) == 0) exit
      if (trajectory%outcome == run_coarse .and. run%gives_up) exit
      ! Where it stops is seen by steps that the exponentials were not fitted for.
      shortest = scale(trajectory%h, -14)
      if (allocated(job%watched)) call new_watch(trajectory%watch, job%watched, n_dof=size(u))
    end do
    if (trajectory%n_steps == steps) trajectory%t_reached = job%t_end
    if (job%last_only) then
      trajectory%t = [trajectory%t_reached]
      allocate (trajectory%states(size(self%first), 1))
      trajectory%states(:, 1) = self%first
      if (reason /= begun) return
      allocate (trajectory%looks(size(self%first), 1 + trajectory%n_steps/every))
      trajectory%looks(:, 1) = self%first
      trajectory%looks(:, 2:) = states(:, :trajectory%n_steps/every)
      call run%observe(u, v)
      call base%add_to(trajectory%t_reached, u, v)
      trajectory%states(1::2, 1) = u
      trajectory%states(2::2, 1) = v
      if (trajectory%outcome == run_event) trajectory%states(:, 1) = trajectory%watch%last_state()
      return
    end if
    kept = trajectory%n_steps/every
    allocate (trajectory%states(size(self%first), kept + 1), trajectory%t(kept + 1))
    trajectory%states(:, 1) = self%first
    trajectory%states(:, 2:) = states(:, :kept)
    do i = 0, kept
      trajectory%t(i + 1) = real(every*i, wp)*trajectory%h
    end do
    ! The product is rounded.
    if (every*kept == steps) trajectory%t(kept + 1) = job%t_end
  end subroutine make

  subroutine make_shaken(self, job, n, factor, sign, trajectory, status)
    class(hereditary_runs), intent(in) :: self
    class(transient_job), intent(in) :: job
    integer(i8), intent(in) :: n
    integer, intent(in) :: factor, sign
    type(trajectory_type), intent(out) :: trajectory
    type(status_type), intent(out) :: status
    class(hereditary_runs), allocatable :: maker
    allocate (maker, source=self)
    call maker%shake(sign)
    call maker%make(job, n, factor, 1, trajectory, status)
  end subroutine make_shaken

  !> Forces have other arguments, u/(1 + s), and other values, by 1 + 2 s.
  subroutine shake_coordinates(self, sign)
    class(coordinate_runs), intent(inout) :: self
    integer, intent(in) :: sign
    self%first = self%first*(1.0_wp + sign*shaken)
    self%system => self%other
  end subroutine shake_coordinates

  subroutine start_coordinates(self, job, base, past, h, solved, run, reason, shortest)
    class(coordinate_runs), intent(in) :: self
    type(hereditary_job), intent(in) :: job
    type(base_motion_type), intent(inout) :: base
    integer, intent(in) :: past
    real(wp), intent(in) :: h, solved
    class(march_type), allocatable, intent(out) :: run
    integer, intent(out) :: reason
    real(wp), intent(in), optional :: shortest
    type(hereditary_type), allocatable :: own
    real(wp), dimension(size(self%first)/2) :: u, v

    u = self%first(1::2)
    v = self%first(2::2)
    call base%add_to(0.0_wp, u, v, share=-1.0_wp)
    allocate (own)
    call new_hereditary(own, self%system, self%load, nodes(job%method), past, job%held, u, v, h, &
                        reach*job%t_end, solved, reason, shortest=shortest)
    call move_alloc(own, run)
  end subroutine start_coordinates

  !> Whether it is such a body.
  logical function renames(self)
    class(hereditary_runs), intent(in) :: self
    renames = self%system%moving
  end function renames

  !> Select the equivalent rotation vector of bodies with large rotations.
  subroutine align(self, run, like)
    class(hereditary_runs), intent(in) :: self
    type(trajectory_type), intent(inout) :: run, like
    real(wp) :: u(size(run%states, 1)/2), v(size(run%states, 1)/2)
    logical :: renamed
    integer :: i

    if (.not. self%system%moving) return
    do i = 1, min(size(run%t), size(like%t))
      u = run%states(1::2, i)
      v = run%states(2::2, i)
      call self%system%rename_state(u, v, renamed, like%states(1::2, i))
      if (.not. renamed) cycle
      run%states(1::2, i) = u
      run%states(2::2, i) = v
    end do
  end subroutine align

  !> The run at its start, its past kept as the job wants it.
  subroutine begin(self, job, base, n, h, shortest, run, reason, status)
    class(hereditary_runs), intent(in) :: self
    type(hereditary_job), intent(in) :: job
    type(base_motion_type), intent(inout) :: base
    integer(i8), intent(in) :: n
    real(wp), intent(in) :: h
    !> Shortest step that the kernels are fitted for; not allocated: h.
    real(wp), allocatable, intent(in) :: shortest
    class(march_type), allocatable, intent(out) :: run
    integer, intent(out) :: reason
    type(status_type), intent(out) :: status
    real(wp) :: solved
    integer :: past

    call set_ok(status)
    solved = max(self%sharper*(0.1_wp*job%wanted()), rounding)
    solved = max(solved/real(n/self%n_first, wp)**3, rounding)
    ! Without memory the step alone shall decide the error.
    if (job%dt <= 0.0_wp .and. .not. any(self%system%kernel_of > 0)) solved = rounding
    past = past_exponentials
    if (job%past == keep_direct) past = past_direct
    call self%start(job, base, past, h, solved, run, reason, shortest)
    if (reason == no_exponentials .and. job%past == past_auto .and. n <= most_direct) then
      call self%start(job, base, past_direct, h, solved, run, reason, shortest)
    end if
    select case (reason)
    case (begun, step_too_large)
      return
    case (no_exponentials)
      call fail(status, status_input_error, 'memory', 'memory = ''' &
                //trim(past_names(job%past))//''': a kernel is not a sum of ' &
                //'exponentials, and there are '//show(real(n, wp))//' steps; must be ''direct''')
    case default
      call fail(status, status_input_error, 'held', 'held: a kernel has no integral, so what ' &
                //'was held for ever would leave no force; must be left out')
    end select
  end subroutine begin

  !> What will be computed and what is skipped, with the reasons.
  function plan_hereditary(job, system, load) result(text)
    type(hereditary_job), intent(in) :: job
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')
    type(polynomial_type) :: reduced
    logical :: moved(system%n_dof())

    text = 'computes: motion to t = '//show(job%t_end)//' by '//hereditary_methods(job%method) &
           //', accelerations at '//things(nodes(job%method), 'node')//' per step'//nl &
           //plan_steps(job)
    moved = moved_coordinates(system, driven(job, system, load))
    if (all(moved)) then
      text = text//plan_forces(job, system, load)
    else
      call reduce(system, moved, reduced)
      text = text//plan_forces(job, reduced, load)//tell_idle(moved)
    end if
    text = text//tell_laws(system)//tell_zeros(system, load)
  end function plan_hereditary

  !> The lines about forces and what is remembered of them.
  function plan_forces(job, system, load) result(text)
    type(hereditary_job), intent(in) :: job
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    character(len=:), allocatable :: text
    character(len=*), parameter :: nl = new_line('a')
    type(channels_type) :: channels
    type(collocation_type) :: table
    real(wp), allocatable :: weights(:), rates(:)
    real(wp) :: least
    integer :: k, first

    if (system%is_linear()) then
      text = 'skips: iteration in each step (nothing is nonlinear)'//nl
    else
      text = 'computes: nonlinear forces, by iteration in each step'//nl
    end if
    call new_channels(channels, system, 0.0_wp*system%mass(:, 1))
    call new_collocation(table, nodes(job%method))
    if (size(channels%kernel_of) == 0) then
      text = text//'skips: memory (no kernels)'//nl
      return
    end if
    least = 0.25_wp
    if (job%dt > 0.0_wp) least = job%dt
    do k = 1, size(system%kernels)
      first = count(channels%kernel_of == k)
      if (first == 0) cycle
      text = text//'computes: memory of '//things(first, 'force')//' with kernel '//show(k)//', '
      ! The step is not known before it is found; one of 1/4 tells the size.
      call system%kernels(k)%exponentials(error_of_sums(0.1_wp*job%wanted(), least), &
                                                 least*table%points(1), reach*job%t_end, weights, &
                                                 rates)
      if (job%past == keep_direct .or. size(rates) == 0) then
        text = text//'by the whole past at every step'//nl
      else if (job%dt > 0.0_wp) then
        text = text//'as '//things(size(rates), 'exponential')//nl
      else
        text = text//'as about '//things(size(rates), 'exponential')//nl
      end if
    end do
    if (any(abs(job%initial) > 0.0_wp) .or. size(load%orders) == 0) return
    if (all(load%orders > 0) .and. all(abs(aimag(load%force)) <= 0.0_wp) &
        .and. .not. load%moves_base()) then
      text = text//'skips: fine steps at a singular start (it starts from rest without load)'//nl
    end if
  end function plan_forces

end module viscovib_hereditary_job
