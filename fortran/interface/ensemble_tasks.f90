!> Tasks about ensembles of trajectories and basins of attraction.
module viscovib_ensemble_tasks
  use viscovib_basin_rules, only: check_orbit, comes_to_rest, disturbances, find_orbits, n_disturbed
  use viscovib_binding_tools, only: make_pendulum
  use viscovib_ensemble, only: ensemble_job
  use viscovib_gathered, only: gathered_type, single_request
  use viscovib_kinds, only: i8, wp
  use viscovib_lane_motion, only: lane_motion_type, n_scales, new_lane_motion
  use viscovib_lane_runs, only: lane_runs
  use viscovib_load, only: load_type
  use viscovib_many_motions, only: compare, many_motions
  use viscovib_motion_inputs, only: load_of, read_equations, read_piece
  use viscovib_motion_piece, only: motion_equations
  use viscovib_neighbouring_runs, only: gather_run
  use viscovib_pendulum, only: pendulum_type
  use viscovib_piece_runs, only: piece_runs, shared_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: status_type
  use viscovib_stopping, only: is_set
  use viscovib_system_vector, only: polynomial_from_vector
  use viscovib_task, only: task_type
  use viscovib_trajectory, only: hopeless
  implicit none
  private

  public :: ensemble_task

  !> Input and results of all runs.
  type :: runs_type
    type(ensemble_job) :: job
    real(wp), pointer, contiguous :: initial(:, :), h(:)
    integer :: points = 0
    type(many_motions) :: found
  contains
    procedure :: read => read_runs
    procedure :: put => put_runs
  end type runs_type

  !> Systems from numbers of a task.
  type, extends(lane_runs) :: array_runs
    !> Numbers of the systems, a column each, and the count of them; scaled parts of stiffness and
    !! damping, shape (d, d, 2 m).
    real(wp), pointer, contiguous :: flat(:, :) => null(), own(:, :, :) => null()
    integer, allocatable :: lengths(:)
  contains
    procedure :: pendulum_of
    procedure :: motion_of
  end type array_runs

contains

  subroutine ensemble_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('of pendulums', 'of oscillators')
      call run_lanes(task)
    case ('rates of pendulums', 'rates of oscillators')
      call find_rates(task)
    case ('of members')
      call run_members(task)
    case ('comparison')
      call compare_runs(task)
    case ('orbits')
      call find_last_orbits(task)
    case ('disturbances')
      call find_disturbances(task)
    case ('judgement')
      call check_one_orbit(task)
    case ('rest')
      call check_rest(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine ensemble_task

  !> Input: `initial` (2 d, n), `h` (n), `method`, `n_steps`, `n_discard`; `ahead`: fraction of a
  !! step before the end of the discarded steps at which peaks and means start; `sample_every`,
  !! `section_every`, `points` of a section, `moments`: whether to compute peaks and means,
  !! `n_exponents`, `lines` (m).
  subroutine read_runs(self, task)
    class(runs_type), intent(out) :: self
    type(task_type), intent(inout) :: task
    integer :: d, n

    self%initial => task%get_matrix('initial')
    self%h => task%get_reals('h')
    self%job%method = task%get_integer('method')
    self%job%n_steps = task%get_long('n_steps')
    self%job%n_discard = task%get_long('n_discard')
    self%job%ahead = task%get_real('ahead')
    self%job%sample_every = task%get_long('sample_every')
    self%job%section_every = task%get_long('section_every')
    self%job%moments = task%get_flag('moments')
    self%job%n_exponents = task%get_integer('n_exponents')
    allocate (self%job%lines, source=task%get_reals('lines'))
    self%points = task%get_integer('points')
    d = size(self%initial, 1)/2
    n = size(self%h)
    call task%check_extents('initial', shape(self%initial), [2*d, n])
    if (task%failed()) return
    call self%found%begin(self%job, 2*d, n, self%points)
  end subroutine read_runs

  subroutine put_runs(self, task)
    class(runs_type), intent(in) :: self
    type(task_type), intent(inout) :: task
    if (task%failed()) return
    associate (found => task%found, runs => self%found)
      call found%put_reals('state', runs%state, shape(runs%state))
      call found%put_integers('ended', runs%ended, shape(runs%ended))
      call found%put_reals('t_reached', runs%t_reached, shape(runs%t_reached))
      call found%put_reals('peak', runs%peak, shape(runs%peak))
      call found%put_reals('mean', runs%mean, shape(runs%mean))
      call found%put_reals('rms', runs%rms, shape(runs%rms))
      call found%put_complexes('amplitudes', runs%amplitudes, shape(runs%amplitudes))
      call found%put_reals('sections', runs%sections, shape(runs%sections))
      call found%put_reals('lyapunov', runs%lyapunov, shape(runs%lyapunov))
      call found%put_reals('lyapunov_error', runs%lyapunov_error, shape(runs%lyapunov_error))
    end associate
  end subroutine put_runs

  !> Runs from time 0 of the systems of `read_systems`. Additional result: `missed`(i) /= 0: steps
  !! of run i may have skipped a thin layer of a force.
  subroutine run_lanes(task)
    type(task_type), intent(inout) :: task
    type(runs_type) :: runs
    type(array_runs) :: systems
    type(load_type), target :: load

    call runs%read(task)
    call read_systems(systems, task, load)
    if (task%failed()) return
    call systems%run_in_lanes(runs%job, runs%h, runs%points, runs%found, task%cancel, task%status)
    call runs%put(task)
    call task%found%put_integers('missed', merge(1, 0, runs%found%missed), shape(runs%h))
  end subroutine run_lanes

  !> Upper bounds `rates` (n) of the rates of linear subsystems and loads, as of `find_fastest`.
  subroutine find_rates(task)
    type(task_type), intent(inout) :: task
    type(array_runs) :: systems
    type(load_type), target :: load
    real(wp), allocatable :: rates(:)

    call read_systems(systems, task, load)
    if (.not. task%failed()) call systems%find_fastest(rates, task%status)
    if (.not. task%failed()) call task%found%put_reals('rates', rates, shape(rates))
  end subroutine find_rates

  !> The systems of runs with starts `initial` (2 d, n). Pendulums: `flat` (14, n). Oscillators: the
  !! load as for a run without memory, its frequency `nu` (n), the `scales` (4, n) of
  !! `viscovib_lane_motion`, the scaled parts `own` (d, d, 2 m) of stiffness and damping, and the
  !! first `lengths` (m) of the numbers `flat` (k, m): one system for all runs (m = 1), or one per
  !! run (m = n).
  subroutine read_systems(self, task, load)
    type(array_runs), intent(inout) :: self
    type(task_type), intent(inout) :: task
    type(load_type), intent(inout), target :: load
    integer :: d, m, n

    allocate (self%starts, source=task%get_matrix('initial'))
    self%flat => task%get_matrix('flat')
    self%of_pendulums = .not. task%has('own')
    d = size(self%starts, 1)/2
    n = size(self%starts, 2)
    if (task%failed()) return
    if (self%of_pendulums) then
      call task%check_extents('flat', shape(self%flat), [14, n])
      call task%check_extents('initial', shape(self%starts), [6, n])
      return
    end if
    self%own => task%get_cube('own')
    allocate (self%lengths, source=task%get_integers('lengths'))
    allocate (self%frequencies, source=task%get_reals('nu'))
    allocate (self%scales, source=task%get_matrix('scales'))
    self%one_system = size(self%flat, 2) == 1
    m = merge(1, n, self%one_system)
    call task%check_extents('flat', shape(self%flat), [size(self%flat, 1), m])
    call task%check_extents('lengths', shape(self%lengths), [m])
    call task%check_extents('own', shape(self%own), [d, d, 2*m])
    call task%check_extents('nu', shape(self%frequencies), [n])
    call task%check_extents('scales', shape(self%scales), [n_scales, n])
    call load_of(task, d, load)
    if (.not. task%failed()) call load%check_at(self%frequencies, task%status)
    self%load => load
  end subroutine read_systems

  subroutine pendulum_of(self, i, pendulum, status)
    class(array_runs), intent(in) :: self
    integer, intent(in) :: i
    type(pendulum_type), intent(out) :: pendulum
    type(status_type), intent(out) :: status
    call make_pendulum(pendulum, self%flat(:, i), status)
  end subroutine pendulum_of

  subroutine motion_of(self, i, motion, status)
    class(array_runs), intent(in) :: self
    integer, intent(in) :: i
    type(lane_motion_type), intent(out) :: motion
    type(status_type), intent(out) :: status
    type(polynomial_type) :: system
    integer :: j

    j = min(i, size(self%flat, 2))
    call polynomial_from_vector(system, self%flat(:self%lengths(j), j), status)
    if (status%failed()) return
    call new_lane_motion(motion, system, self%load, self%own(:, :, 2*j - 1:2*j))
  end subroutine motion_of

  !> Runs that are computed one by one. Each is an object with its start and its equations, as of
  !! a motion in time; `longest`: step size of its first run with another step; `rows` (2 d): rows
  !! of its states that are kept. Peaks and means begin at the time `since` (n), events count
  !! from the time `late` (n). `first_steps` (n): number of steps of the first run of a search.
  !! Additional results: `in_parts`(i) /= 0: run i has missed a thin layer
  !! of a law, so that its steps are divided; `passed` (n): numbers of events, their `times` (m) and
  !! states `points` (2 d, m).
  subroutine run_members(task)
    type(task_type), intent(inout) :: task
    type(runs_type) :: runs
    type(single_request) :: request
    type(gathered_type), allocatable :: found(:)
    real(wp), pointer, contiguous :: since(:), late(:)
    integer, allocatable :: first_steps(:), in_parts(:)
    integer :: i, k, n

    call runs%read(task)
    since => task%get_reals('since')
    late => task%get_reals('late')
    allocate (first_steps, source=task%get_integers('first_steps'))
    n = size(runs%h)
    if (.not. allocated(task%parents)) allocate (task%parents(0))
    call task%check_extents('members', shape(task%parents), [n])
    call task%check_extents('since', shape(since), [n])
    call task%check_extents('late', shape(late), [n])
    call task%check_extents('first_steps', shape(first_steps), [n])
    if (task%failed()) return
    request%n_steps = runs%job%n_steps
    request%n_discard = runs%job%n_discard
    request%sample_every = runs%job%sample_every
    request%section_every = runs%job%section_every
    request%lines = runs%job%lines
    request%n_exponents = runs%job%n_exponents
    allocate (found(n))
    allocate (in_parts(n), source=0)
    do i = 1, n
      if (is_set(task%cancel)) return
      request%since = since(i)
      request%late = late(i)
      request%quarter = max(1_i8, nint(real(request%n_steps, wp)/max(1, first_steps(i)), i8))
      call run_member(task%parents(i)%to, request, size(runs%initial, 1), found(i), in_parts(i), &
                      task%status)
      if (task%failed()) return
      call runs%found%take_single(found(i), [(k, k=1, size(runs%initial, 1))], i)
    end do
    call runs%put(task)
    call task%found%put_integers('in_parts', in_parts, [n])
    call task%found%put_integers('passed', [(size(found(i)%times), i=1, n)], [n])
    call put_passages(task, found, size(runs%initial, 1))
  end subroutine run_members

  !> Make the run of an object.
  subroutine run_member(member, request, width, found, in_parts, status)
    type(task_type), intent(inout) :: member
    type(single_request), intent(in) :: request
    !> Number of rows of states that are kept.
    integer, intent(in) :: width
    type(gathered_type), intent(out) :: found
    integer, intent(out) :: in_parts
    type(status_type), intent(out) :: status
    class(motion_equations), allocatable, target :: equations
    type(shared_type) :: shared
    type(piece_runs) :: runs
    integer :: i

    call read_piece(member, runs%first)
    shared%longest = member%get_real('longest', 0.0_wp)
    runs%most_direct = member%get_long('most_direct', 0_i8)
    if (.not. member%failed()) call read_equations(member, runs%first, equations)
    if (member%has('rows')) then
      allocate (runs%rows, source=member%get_integers('rows'))
    else
      allocate (runs%rows, source=[(i, i=1, size(runs%first%initial))])
    end if
    call member%check_extents('rows', shape(runs%rows), [width])
    in_parts = 0
    status = member%status
    if (status%failed()) return
    runs%equations => equations
    call gather_run(runs, request, shared, found, status)
    in_parts = merge(1, 0, shared%in_parts)
  end subroutine run_member

  !> Times and states of all events, run after run.
  subroutine put_passages(task, found, width)
    type(task_type), intent(inout) :: task
    type(gathered_type), intent(in) :: found(:)
    integer, intent(in) :: width
    real(wp), allocatable :: times(:), points(:, :)
    integer :: i, n

    n = sum([(size(found(i)%times), i=1, size(found))])
    allocate (times(n), points(width, n))
    n = 0
    do i = 1, size(found)
      associate (its => found(i))
        times(n + 1:n + size(its%times)) = its%times
        if (size(its%times) > 0) points(:, n + 1:n + size(its%times)) = its%sections
        n = n + size(its%times)
      end associate
    end do
    call task%found%put_reals('times', times, shape(times))
    call task%found%put_reals('points', points, shape(points))
  end subroutine put_passages

  !> Compare all runs with runs of half the step size, see `compare`. Both are objects with some of
  !! the results of runs. Input: the allowed errors `absolute` and `relative`, and the `changes` of
  !! earlier comparisons. Results: `change`; `worst`: the run that changes most, from 0; `met`;
  !! `goes_on`: true if half the step size may help; `lyapunov_error` of the finer runs.
  subroutine compare_runs(task)
    type(task_type), intent(inout) :: task
    type(many_motions) :: many(2)
    real(wp) :: change
    logical :: met
    integer :: i

    do i = 1, 2
      associate (given => task%parents(i)%to, its => many(i))
        allocate (its%state, source=given%get_matrix('state'))
        allocate (its%ended, source=given%get_integers('ended'))
        allocate (its%t_reached, source=given%get_reals('t_reached'))
        allocate (its%peak, source=given%get_matrix('peak'))
        allocate (its%mean, source=given%get_matrix('mean'))
        allocate (its%rms, source=given%get_matrix('rms'))
        allocate (its%lyapunov, source=given%get_matrix('lyapunov'))
        allocate (its%lyapunov_error, source=given%get_matrix('lyapunov_error'))
      end associate
    end do
    call compare(many(1), many(2), task%get_real('absolute'), task%get_real('relative'), change, &
                 met)
    associate (found => task%found, finer => many(2))
      call found%put_real('change', change)
      call found%put_integer('worst', int(finer%worst - 1, i8))
      call found%put_integer('met', merge(1_i8, 0_i8, met))
      call found%put_integer('goes_on', merge(0_i8, 1_i8, &
                                              hopeless([task%get_reals('changes'), change])))
      call found%put_reals('lyapunov_error', finer%lyapunov_error, shape(finer%lyapunov_error))
    end associate
  end subroutine compare_runs

  !> Periodic orbits in the last `points` (w, k, n) of n solutions, see `viscovib_basin_rules`;
  !! `ended` (n) /= 0: end time reached. `shown`: a solution on each orbit, from 0.
  subroutine find_last_orbits(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: largest(:), points(:, :, :)
    integer, allocatable :: ended(:), labels(:), periods(:), shown(:)
    real(wp), allocatable :: scale(:), moved(:)
    integer :: n_orbits

    largest => task%get_reals('largest')
    points => task%get_cube('points')
    allocate (ended, source=task%get_integers('ended'))
    call task%check_extents('largest', shape(largest), [size(points, 1)])
    call task%check_extents('ended', shape(ended), [size(points, 3)])
    if (task%failed()) return
    allocate (labels(size(ended)), periods(size(ended)), moved(size(ended)), scale(size(largest)))
    allocate (shown(size(ended)), source=0)
    call find_orbits(largest, points, ended /= 0, task%get_integer('most'), task%get_real('near'), &
                     task%get_real('fastest'), scale, labels, periods, moved, shown, n_orbits)
    shown = shown(:n_orbits) - 1
    associate (found => task%found)
      call found%put_reals('scale', scale, shape(scale))
      call found%put_integers('labels', labels, shape(labels))
      call found%put_integers('periods', periods, shape(periods))
      call found%put_reals('moved', moved, shape(moved))
      call found%put_integers('shown', shown, shape(shown))
    end associate
  end subroutine find_last_orbits

  !> Perturbations of orbits of `width` relative to the scale, one column per solution: `pushes`.
  subroutine find_disturbances(task)
    type(task_type), intent(inout) :: task
    real(wp), allocatable :: pushes(:, :)
    allocate (pushes(task%get_integer('width'), n_disturbed))
    call disturbances(task%get_real('near'), pushes)
    call task%found%put_reals('pushes', pushes, shape(pushes))
  end subroutine find_disturbances

  !> Check whether an orbit is attracting, from the ends of solutions that start near it; `rest`:
  !! the remaining fraction of a perturbation.
  subroutine check_one_orbit(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: ends(:, :), orbit(:, :), scale(:)
    integer, allocatable :: ended(:)
    real(wp) :: rest
    logical :: good

    ends => task%get_matrix('ends')
    allocate (ended, source=task%get_integers('ended'))
    orbit => task%get_matrix('orbit')
    scale => task%get_reals('scale')
    call task%check_extents('ended', shape(ended), [size(ends, 2)])
    call task%check_extents('orbit', shape(orbit), [size(ends, 1)])
    call task%check_extents('scale', shape(scale), [size(ends, 1)])
    if (task%failed()) return
    call check_orbit(ends, ended /= 0, orbit, scale, task%get_real('near'), &
                     task%get_flag('of_starts'), task%get_flag('has_kernels'), good, rest)
    call task%found%put_integer('attracts', merge(1_i8, 0_i8, good))
    call task%found%put_real('rest', rest)
  end subroutine check_one_orbit

  !> Whether a motion `comes` to rest, from the last `points` and `later` ones (w, k) of two runs.
  subroutine check_rest(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: points(:, :), later(:, :), scale(:)
    logical :: comes

    points => task%get_matrix('points')
    later => task%get_matrix('later')
    scale => task%get_reals('scale')
    call task%check_extents('later', shape(later), shape(points))
    call task%check_extents('scale', shape(scale), [size(points, 1)])
    if (task%failed()) return
    comes = comes_to_rest(points, later, task%get_integer('period'), scale)
    call task%found%put_integer('comes', merge(1_i8, 0_i8, comes))
  end subroutine check_rest

end module viscovib_ensemble_tasks
