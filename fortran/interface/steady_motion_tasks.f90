!> Tasks about periodic motions in time by shooting.
module viscovib_steady_motion_tasks
  use viscovib_kinds, only: i8, wp
  use viscovib_load, only: load_type
  use viscovib_motion_inputs, only: load_of, polynomial_of
  use viscovib_period_map, only: new_period_map, period_map, period_run
  use viscovib_polynomial, only: polynomial_type
  use viscovib_shooting, only: accuracy_type, check_repeating, find_shortest_period, &
    show_repeating, steady_from_rest, steady_type
  use viscovib_task, only: task_type
  implicit none
  private

  public :: run_period, steady_motion

contains

  !> The map of a polynomial system under the load `orders` (k), `series` (n + 1, k) of frequency
  !! `nu`, over `n_periods`, by `method` as of `viscovib_method_catalogue`.
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

  !> A motion over the time of the map from the state `begin`, in `n_steps`, 0: as many as a search
  !! begins with. `by_start`(i, j) is the derivative of number i of the `last` state by number j of
  !! `begin`; empty without `derivatives`, which take most of the time. `at_times`: states at the
  !! ascending `times` as far as they were reached, without hidden states. `n_passed`: switches of
  !! laws; `known` = 0: the derivatives do not exist.
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
      call found%put_integer('ended', int(ran%outcome, i8))
      call found%put_integer('n_steps', n_steps)
    end associate
  end subroutine run_period

  !> The motion that repeats after the time of the map, near the state `begin`, or if that is not
  !! given after the motion from rest. Errors of the state may be `absolute` + `relative` times its
  !! largest entry. `outcome`: as of `viscovib_outcomes`; `stable`: 1, 0, or -1 if it is undecided.
  subroutine steady_motion(task)
    type(task_type), intent(inout) :: task
    type(period_map) :: map
    type(accuracy_type) :: wanted
    type(steady_type) :: steady
    real(wp), pointer, contiguous :: begin(:)
    real(wp), allocatable :: t(:), states(:, :)

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
      call found%put_real('correction', steady%found%correction)
      call found%put_real('enlarged', steady%found%enlarged)
      call found%put_real('allowed', wanted%allowed(map, steady%found%state))
    end associate
  end subroutine steady_motion

end module viscovib_steady_motion_tasks
