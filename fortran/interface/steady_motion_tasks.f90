!> Tasks about periodic solutions in time by shooting.
module viscovib_steady_motion_tasks
  use viscovib_binding_tools, only: kernels_in_vector
  use viscovib_kinds, only: i8, wp
  use viscovib_load, only: load_type
  use viscovib_locks, only: lock_texts, unlock_texts
  use viscovib_motion_branch, only: branch_options, check_branch, motion_branch, trace_motion
  use viscovib_motion_extremes, only: find_extremes
  use viscovib_motion_inputs, only: load_of, polynomial_of
  use viscovib_motion_path, only: map_family, map_motion, plain_family
  use viscovib_oscillator, only: oscillator_type
  use viscovib_period_map, only: new_period_map, period_map, period_run
  use viscovib_polynomial, only: polynomial_type
  use viscovib_shooting, only: accuracy_type, check_repeating, find_shortest_period, &
    show_repeating, steady_doubt, steady_from_rest, steady_type
  use viscovib_status, only: status_type
  use viscovib_task, only: task_type
  use viscovib_vector_builder, only: vector_builder
  implicit none
  private

  public :: find_motion_extremes, run_period, steady_motion, trace_branch

  !> Family in a parameter of the system, which is rebuilt at each value.
  type, extends(map_family) :: built_family
    type(period_map) :: map
    type(vector_builder) :: builder
    class(oscillator_type), allocatable :: own
  contains
    procedure :: map_at => built_map
  end type built_family

contains

  subroutine built_map(self, p, map, made)
    class(built_family), intent(inout), target :: self
    real(wp), intent(in) :: p
    type(period_map), intent(out) :: map
    logical, intent(out) :: made
    type(status_type) :: status

    call self%builder%build(p, self%own, status)
    made = .not. status%failed()
    if (.not. made) return
    map = self%map
    select type (own => self%own)
    type is (polynomial_type)
      map%system => own
    class default
      made = .false.
    end select
  end subroutine built_map

  !> Map of a polynomial system with the load `orders` (k), `series` (n + 1, k) at the frequency
  !! `nu`, over `n_periods`, by `method` of `viscovib_method_catalogue`.
  subroutine read_map(task, map)
    type(task_type), intent(inout) :: task
    type(period_map), intent(out) :: map
    type(polynomial_type), pointer :: system
    type(load_type) :: load

    system => polynomial_of(task)
    if (task%failed()) return
    call load_of(task, system%n_dof(), load)
    if (task%failed()) return
    call new_period_map(map, system, load, task%get_real('nu'), task%get_integer('n_periods'), &
                        task%get_integer('method'), task%status)
  end subroutine read_map

  !> Solution over the time of the map from the state `begin`, in `n_steps`, 0: the initial number
  !! of a search. `by_start`(i, j): derivative of entry i of the `last` state by entry j of `begin`;
  !! empty without `derivatives`, which take most of the time. `at_times`: states at the ascending
  !! `times` that were reached, without memory coordinates. `n_passed`: number of switches of laws;
  !! `known` = 0: the derivatives do not exist.
  subroutine run_period(task)
    type(task_type), intent(inout) :: task
    type(period_map) :: map
    type(period_run) :: ran
    real(wp), pointer, contiguous :: begin(:), times(:)
    integer(i8) :: n_steps

    call read_map(task, map)
    if (task%failed()) return
    begin => task%get_reals('begin')
    times => task%get_reals('times')
    n_steps = task%get_long('n_steps')
    call task%check_extents('begin', shape(begin), [map%n_state()])
    if (task%failed()) return
    if (n_steps == 0) n_steps = map%first_steps()
    call map%run(begin, n_steps, ran, times, task%get_flag('derivatives'))
    associate (found => task%found)
      call found%put_reals('last', ran%last, shape(ran%last))
      call found%put_reals('by_start', ran%by_start, shape(ran%by_start))
      call found%put_reals('at_times', ran%at_times(:, :ran%n_reached), &
                           [size(ran%at_times, 1), ran%n_reached])
      call found%put_integer('n_passed', int(ran%n_passed, i8))
      call found%put_integer('known', merge(1_i8, 0_i8, ran%known))
      call found%put_integer('ended', int(ran%ended, i8))
      call found%put_integer('n_steps', n_steps)
    end associate
  end subroutine run_period

  !> Periodic solution of the map near the state `begin`, or, without it, near the solution from
  !! rest. The tolerance of the state is `absolute` + `relative` times its largest entry. `outcome`:
  !! as in `viscovib_outcomes`; `stable`: 1, 0, or -1 if undecided.
  subroutine steady_motion(task)
    type(task_type), intent(inout) :: task
    type(period_map) :: map
    type(accuracy_type) :: wanted
    type(steady_type) :: steady
    real(wp), pointer, contiguous :: begin(:)
    real(wp), allocatable :: t(:), states(:, :)
    character(len=:), allocatable :: doubt

    call read_map(task, map)
    if (task%failed()) return
    wanted = accuracy_type(task%get_real('absolute'), task%get_real('relative'))
    if (task%has('begin')) then
      begin => task%get_reals('begin')
      call task%check_extents('begin', shape(begin), [map%n_state()])
      if (task%failed()) return
      call check_repeating(map, begin, wanted, steady)
    else
      call steady_from_rest(map, wanted, steady)
    end if
    call show_repeating(map, steady, t, states)
    associate (found => task%found)
      call found%put_reals('t', t, shape(t))
      call found%put_reals('states', states, shape(states))
      call found%put_reals('begin', steady%found%state, shape(steady%found%state))
      call found%put_complexes('multipliers', steady%multipliers, shape(steady%multipliers))
      call found%put_integer('repeats_after', int(find_shortest_period(map, steady), i8))
      call found%put_integer('stable', int(steady%stability(), i8))
      call found%put_integer('outcome', int(steady%found%outcome, i8))
      call found%put_integer('iterations', int(steady%iterations, i8))
      call found%put_integer('n_passed', int(steady%found%n_passed, i8))
      call found%put_integer('n_steps', steady%n_steps)
      call found%put_real('error', steady%error)
      call found%put_real('multiplier_error', steady%multiplier_error)
    end associate
    call lock_texts()
    call steady_doubt(map, steady, wanted, doubt)
    call unlock_texts()
    call task%found%put_text('doubt', doubt)
  end subroutine steady_motion

  !> Extremes `low`, `high` of each displacement of the solution from `begin` in `n_steps`, between
  !! the ascending `times`, with a relative error of `tolerance`.
  subroutine find_motion_extremes(task)
    type(task_type), intent(inout) :: task
    type(map_motion) :: motion
    real(wp), pointer, contiguous :: begin(:), times(:)
    real(wp), allocatable :: low(:), high(:)

    call read_map(task, motion%map)
    if (task%failed()) return
    begin => task%get_reals('begin')
    times => task%get_reals('times')
    motion%n_steps = task%get_long('n_steps')
    call task%check_extents('begin', shape(begin), [motion%map%n_state()])
    if (task%failed()) return
    motion%state = begin
    call find_extremes(motion, times, task%get_real('tolerance'), low, high)
    call task%found%put_reals('low', low, shape(low))
    call task%found%put_reals('high', high, shape(high))
  end subroutine find_motion_extremes

  !> Branch of periodic solutions from `start` to `finish` of the parameter `varies`: 'nu',
  !! 'load_factor', or a system parameter, with `flat` and `direction` as for a branch of responses.
  !! The first solution is as in `steady_motion`; `max_step`, `max_points`.
  subroutine trace_branch(task)
    type(task_type), intent(inout) :: task
    class(map_family), allocatable, target :: family
    type(plain_family), allocatable :: plain
    type(built_family), allocatable :: built
    type(branch_options) :: options
    type(motion_branch) :: branch
    real(wp), pointer, contiguous :: flat(:), direction(:), begin(:)
    character(len=:), allocatable :: doubts, varies

    call task%take_text('varies', varies)
    options%start = task%get_real('start')
    options%finish = task%get_real('finish')
    options%max_step = task%get_real('max_step')
    options%max_points = task%get_integer('max_points')
    options%accuracy = accuracy_type(task%get_real('absolute'), task%get_real('relative'))
    if (task%failed()) return
    if (.not. task%has('direction')) then
      allocate (plain)
      plain%is_frequency = varies == 'nu'
      call read_map(task, plain%map)
      if (plain%is_frequency .and. .not. task%failed()) then
        call plain%map%load%check_between(options%start, options%finish, task%status)
      end if
      call move_alloc(plain, family)
    else
      allocate (built)
      call read_map(task, built%map)
      flat => task%get_reals('flat')
      direction => task%get_reals('direction')
      if (task%failed()) return
      built%builder = vector_builder(flat, direction, [real(wp) ::], [real(wp) ::], &
                                     kernels_in_vector, 0)
      call move_alloc(built, family)
    end if
    if (task%failed()) return
    if (task%has('begin')) then
      begin => task%get_reals('begin')
      options%begin = begin
    end if
    call trace_motion(family, options, branch)
    call lock_texts()
    call check_branch(branch, varies, options%start, doubts, task%status)
    call unlock_texts()
    if (task%failed()) return
    call task%found%put_text('doubts', doubts)
    call put_branch(task, branch)
  end subroutine trace_branch

  !> `ended` as in `viscovib_motion_branch`; points in columns of `begin`, `low`, `high`,
  !! `multipliers`; events with their kinds of `viscovib_motion_events`, the points `before` them
  !! (from 1), NaN if they are not located.
  subroutine put_branch(task, branch)
    type(task_type), intent(inout) :: task
    type(motion_branch), intent(in) :: branch
    real(wp), allocatable :: states(:, :)
    complex(wp), allocatable :: multipliers(:, :)
    integer :: i, n, m

    n = branch%n_points
    m = 0
    if (n > 0) m = size(branch%motions(1)%found%state)
    allocate (states(m, n), multipliers(m, n))
    do i = 1, n
      states(:, i) = branch%motions(i)%found%state
      multipliers(:, i) = branch%motions(i)%multipliers
    end do
    associate (found => task%found, motions => branch%motions(:n))
      call found%put_integer('ended', int(branch%outcome, i8))
      call found%put_reals('p', branch%p(:n), [n])
      call found%put_reals('begin', states, shape(states))
      call found%put_complexes('multipliers', multipliers, shape(multipliers))
      call found%put_reals('low', branch%low(:, :n), [size(branch%low, 1), n])
      call found%put_reals('high', branch%high(:, :n), [size(branch%low, 1), n])
      call found%put_integers('stable', [(motions(i)%stability(), i=1, n)], [n])
      call found%put_integers('n_passed', motions%found%n_passed, [n])
      call found%put_integers('outcome', motions%found%outcome, [n])
      call found%put_integers('repeats_after', branch%repeats_after(:n), [n])
      call found%put_longs('n_steps', motions%n_steps, [n])
      call found%put_reals('error', motions%error, [n])
      call found%put_reals('multiplier_error', motions%multiplier_error, [n])
      call found%put_integers('kind', branch%kind, shape(branch%kind))
      call found%put_integers('before', branch%before, shape(branch%kind))
      call found%put_reals('place', branch%place, shape(branch%kind))
      call found%put_reals('place_error', branch%place_error, shape(branch%kind))
      call found%put_integers('sure', merge(1, 0, branch%is_sure), shape(branch%kind))
      call found%put_reals('largest', branch%largest, shape(branch%largest))
    end associate
  end subroutine put_branch

end module viscovib_steady_motion_tasks
