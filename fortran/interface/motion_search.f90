!> Task that computes a solution in time with a step size search, or the error of a given step size.
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

  public :: search_step

contains

  !> Find the step size of a solution, or (`estimate`) its error for `n_steps` steps; see
  !! `viscovib_step_search`. Input in addition to the data of pieces: `t_end_of_run`; for
  !! `piece_runs` `at_times`, `last_only`, `looks`, `tail`, `holds_places`, `most_direct`, `later`;
  !! `rows` (m): states by which runs are compared; `absolute`, `relative`: tolerances, both 0:
  !! relative to the size of the solution; `fills`: so many states that peaks between them are
  !! small.
  !!
  !! Output: `verdict` (0: step size found), `change`, `grown`, `error`; `t` (k) and `states`
  !! (m, k), all rows; `last`, `memory` and other final data of a piece; `step`, `factor`: ratio of
  !! the first step size to it, `per_step`: states per step; `found`, `n_found`, `sides` and
  !! `event_point_errors` of events. If no step size is found: `not_met` (the outcome), `cause` and
  !! `place` of `find_reason`, `coarse_t`, `coarse_states`, ... of the previous run.
  subroutine search_step(task, kind)
    type(task_type), intent(inout) :: task
    integer, intent(in) :: kind
    type(shared_type), target :: shared
    class(motion_equations), allocatable, target :: equations
    type(piece_runs) :: runs
    type(transient_job) :: job
    type(search_type) :: search
    character(len=:), allocatable :: outcome, cause
    integer :: place

    call read_piece(task, runs%first)
    if (.not. task%failed()) call read_equations(task, kind, runs%first, equations)
    if (task%failed()) return
    runs%equations => equations
    runs%t_end = task%get_real('t_end_of_run')
    runs%at_times = task%get_flag('at_times')
    runs%last_only = task%get_flag('last_only')
    runs%looks = task%get_flag('looks')
    runs%tail = task%get_real('tail')
    allocate (runs%rows, source=task%get_integers('rows'))
    runs%holds_places = task%get_flag('holds_places')
    runs%most_direct = task%get_long('most_direct')
    runs%later = task%get_real('later')
    if (task%failed()) return
    call runs%begin(shared)
    job%t_end = runs%t_end
    job%tolerance = task%get_real('absolute')
    job%relative = task%get_real('relative')
    job%save_every = int(min(runs%first%save_every, int(huge(1), i8)))
    job%last_only = runs%last_only .or. runs%at_times .or. runs%tail > 0.0_wp
    job%fills = task%get_flag('fills')
    job%initial = runs%first%initial(runs%rows)
    if (runs%first%is_watched) job%watched = runs%first%watched
    if (task%failed()) return
    if (task%get_flag('estimate')) then
      job%dt = runs%first%h
      call estimate_error(runs, job, runs%first%n_steps, search, task%status)
    else
      call find_step(runs, job, runs%first%n_steps, search, task%status)
    end if
    if (task%failed()) return
    associate (found => task%found)
      call found%put_integer('verdict', int(search%verdict, i8))
      call found%put_real('change', search%change)
      call found%put_real('grown', search%grown)
      call found%put_integer('factor', int(search%factor, i8))
      call found%put_integer('per_step', int(search%per_step, i8))
      call found%put_integer('was_shaken', merge(1_i8, 0_i8, search%was_shaken))
      call found%put_integer('in_parts', merge(1_i8, 0_i8, shared%in_parts))
      call found%put_integer('past', int(shared%past, i8))
      call found%put_real('shortest', shared%shortest)
      call put_run(task, '', search%run)
      if (search%verdict == step_found) return
      call find_reason(job, runs%first%n_steps, search, outcome, cause, place)
      call found%put_text('not_met', outcome)
      call found%put_text('cause', cause)
      call found%put_integer('place', int(place, i8))
      if (.not. allocated(search%coarse%states)) return
      call put_run(task, 'coarse_', search%coarse)
    end associate
  end subroutine search_step

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
    call task%found%put_real('solved', run%solved)
    call task%found%put_real('error', run%error)
    call task%found%put_real('resolution', run%resolution)
    call task%found%put_real('too_long', run%too_long)
    call task%found%put_real('by_phases', run%by_phases)
    call task%found%put_real('represented', run%represented)
    if (.not. allocated(run%watch)) return
    n_found = run%watch%n_found
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
