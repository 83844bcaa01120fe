! Optimize: -O1
!> Task that computes a solution in time with a given step size, or with a step size search.
module viscovib_motion_search
  use viscovib_kinds, only: i8, wp
  use viscovib_motion_inputs, only: read_equations, read_piece
  use viscovib_motion_piece, only: motion_equations
  use viscovib_motion_request, only: transient_job
  use viscovib_piece_runs, only: piece_runs, shared_type
  use viscovib_search_reason, only: find_reason
  use viscovib_step_search, only: estimate_error, find_step, search_type, step_found
  use viscovib_task, only: task_type
  use viscovib_trajectory, only: trajectory_type
  use viscovib_watch, only: n_event_rows
  implicit none
  private

  public :: run_motion

  !> What a task makes: one run, one run and its error, or runs with decreasing steps.
  integer, parameter :: one_run = 0, with_error = 1, with_search = 2
  !> Number of columns for what is gathered along a motion: peaks, integrals of values and squares.
  integer, parameter :: n_gathered = 3

  type :: equations_holder
    class(motion_equations), allocatable :: it
  end type equations_holder

contains

  !> Make `n_steps` steps of a solution (`aim` = 0), find its error as well (1), or a step size (2);
  !! see `viscovib_step_search`. Input in addition to the data of a run: `longest`: step size of the
  !! first of the runs that are compared; `t_end_of_run`; for `piece_runs` `last_only`, `looks`,
  !! `tail`, `holds_places`, `most_direct`, `later`; `rows` (m): states by which runs are compared;
  !! `absolute`, `relative`: tolerances, both 0: relative to the size of the solution; `fills`: so
  !! many states that peaks between them are small. A run that continues has `begun`, its state at
  !! time 0, and `remakes`. If it had other loads before, the task is 'motion run' of objects with
  !! the equations of its parts; `until`: number of steps at the end of all but one.
  !!
  !! Output: `t` (k) and `states` (m, k), all rows; `last`, `memory` and other final data; `step`;
  !! `found`, `n_found`, `sides` and `event_point_errors` of events. With an error or a search also
  !! `verdict` (0: step size found), `error`, `factor`: ratio of the first step size to `step`, and
  !! `per_step`: states per step. If no step size is found: `not_met` (the outcome), `cause` and
  !! `place` of `find_reason`, `coarse_t`, `coarse_states`, ... of the previous run.
  subroutine run_motion(task)
    type(task_type), intent(inout) :: task
    type(shared_type), target :: shared
    type(equations_holder), allocatable, target :: parts(:)
    type(piece_runs) :: runs
    type(transient_job) :: job
    type(search_type) :: search
    character(len=:), allocatable :: outcome, cause
    integer(i8) :: n
    integer :: aim, i, place

    aim = task%get_integer('aim')
    call read_piece(task, runs%first)
    if (task%failed()) return
    allocate (parts(merge(size(task%parents), 1, task%has('until'))))
    call read_parts(task, runs, parts)
    if (task%failed()) return
    runs%counts = aim == one_run
    runs%t_end = task%get_real('t_end_of_run')
    runs%at_times = size(runs%first%times) > 0
    runs%last_only = task%get_flag('last_only', .false.)
    runs%looks = task%get_flag('looks', .false.)
    runs%tail = task%get_real('tail', 0.0_wp)
    if (task%has('rows')) then
      allocate (runs%rows, source=task%get_integers('rows'))
    else
      allocate (runs%rows, source=[(i, i=1, size(runs%first%initial))])
    end if
    runs%holds_places = task%get_flag('holds_places', .false.)
    runs%most_direct = task%get_long('most_direct', 0_i8)
    runs%later = task%get_real('later', 0.0_wp)
    shared%longest = task%get_real('longest', 0.0_wp)
    n = task%get_long('n_steps')
    if (task%failed()) return
    call runs%begin(shared)
    job%t_end = runs%t_end
    job%tolerance = task%get_real('absolute', 0.0_wp)
    job%relative = task%get_real('relative', 0.0_wp)
    job%save_every = int(min(runs%first%save_every, int(huge(1), i8)))
    job%last_only = runs%last_only .or. runs%at_times .or. runs%tail > 0.0_wp
    job%fills = task%get_flag('fills', .false.)
    job%initial = runs%first%initial(runs%rows)
    if (runs%first%is_watched) job%watched = runs%first%watched
    if (aim /= with_search) job%dt = runs%first%h
    if (task%failed()) return
    select case (aim)
    case (one_run)
      call runs%make(job, n, 1, 1, search%run, task%status)
    case (with_error)
      call estimate_error(runs, job, n, search, task%status)
    case default
      call find_step(runs, job, n, search, task%status)
    end select
    if (task%failed()) return
    associate (found => task%found)
      call found%put_integer('in_parts', merge(1_i8, 0_i8, shared%in_parts))
      call found%put_integer('past', int(shared%past, i8))
      call put_run(task, '', search%run)
      if (aim == one_run) return
      call found%put_integer('verdict', int(search%verdict, i8))
      call found%put_integer('factor', int(search%factor, i8))
      call found%put_integer('per_step', int(search%per_step, i8))
      call found%put_integer('was_shaken', merge(1_i8, 0_i8, search%was_shaken))
      call found%put_real('solved', search%run%solved)
      call found%put_real('error', search%run%error)
      if (search%verdict == step_found) return
      call find_reason(job, n, search, outcome, cause, place)
      call found%put_text('not_met', outcome)
      call found%put_text('cause', cause)
      call found%put_integer('place', int(place, i8))
      if (.not. allocated(search%coarse%states)) return
      call put_run(task, 'coarse_', search%coarse)
    end associate
  end subroutine run_motion

  !> The equations of a run and of its parts under earlier loads.
  subroutine read_parts(task, runs, parts)
    type(task_type), intent(inout) :: task
    type(piece_runs), intent(inout) :: runs
    type(equations_holder), target, intent(inout) :: parts(:)
    integer(i8), allocatable :: until(:)
    integer :: i, n

    if (runs%first%first > 0) then
      allocate (runs%begun, source=task%get_reals('begun'))
      runs%remakes = task%get_flag('remakes')
      call task%check_extents('begun', shape(runs%begun), shape(runs%first%initial))
    end if
    if (.not. task%has('until')) then
      call read_equations(task, runs%first, parts(1)%it)
      runs%equations => parts(1)%it
      return
    end if
    allocate (until, source=task%get_longs('until'))
    n = size(until)
    call task%check_extents('until', [n + 1], shape(parts))
    allocate (runs%earlier(n))
    do i = 1, n + 1
      if (task%failed()) return
      call read_equations(task%parents(i)%to, runs%first, parts(i)%it)
      task%status = task%parents(i)%to%status
    end do
    runs%equations => parts(n + 1)%it
    do i = 1, n
      runs%earlier(i)%equations => parts(i)%it
      runs%earlier(i)%until = until(i)
    end do
  end subroutine read_parts

  subroutine put_run(task, prefix, run)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: prefix
    type(trajectory_type), intent(inout) :: run

    call task%found%put_reals(prefix//'last', run%last, shape(run%last))
    call task%found%put_real(prefix//'step', run%h)
    call task%found%put_real(prefix//'reached', run%t_reached)
    call task%found%put_integer(prefix//'ended', int(run%outcome, i8))
    call task%found%put_integer(prefix//'made', run%n_steps)
    if (prefix == '') call put_further(task, run)
    call task%found%put_reals(prefix//'t', run%t, shape(run%t))
    if (allocated(run%whole)) then
      call task%found%put_reals(prefix//'states', run%whole, shape(run%whole))
    else
      call task%found%put_reals(prefix//'states', run%states, shape(run%states))
    end if
  end subroutine put_run

  !> Results of the last run only.
  subroutine put_further(task, run)
    type(task_type), intent(inout) :: task
    type(trajectory_type), intent(inout) :: run
    real(wp), allocatable :: found(:, :)
    integer, allocatable :: sides(:)
    integer :: n_found

    if (.not. allocated(run%memory)) allocate (run%memory(0))
    call task%found%put_reals('memory', run%memory, shape(run%memory))
    call task%found%put_integer('counted', run%counted)
    call task%found%put_real('resolution', run%resolution)
    call task%found%put_real('shortest', run%shortest)
    if (allocated(run%accelerations)) then
      call task%found%put_reals('accelerations', run%accelerations, shape(run%accelerations))
    end if
    if (.not. allocated(run%watch)) return
    n_found = run%watch%n_found
    ! The events are followed by what is gathered along the motion.
    if (run%watch%extremes%wanted) n_found = n_found + n_gathered
    allocate (found(n_event_rows + 3*(size(run%last)/2), n_found), source=0.0_wp)
    allocate (sides(3*size(run%watch%sides)), source=0)
    call run%watch%hand_over(sides, found, n_found)
    call task%found%put_reals('found', found, shape(found))
    call task%found%put_integer('n_found', int(n_found, i8))
    call task%found%put_integers('sides', sides, shape(sides))
    if (.not. allocated(run%event_point_errors)) return
    call task%found%put_reals('passage_errors', run%event_point_errors, &
                              shape(run%event_point_errors))
  end subroutine put_further

end module viscovib_motion_search
