!> A run in fixed steps: its stored states and its outcome.
module viscovib_simulate
  use viscovib_counters, only: count_up, counted_states, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  use viscovib_layer_watch, only: layer_watch
  use viscovib_mesh, only: equal_steps, mesh_type
  use viscovib_nearby_motion, only: nearby_motion
  use viscovib_run_history, only: run_history
  use viscovib_step_path, only: step_path
  use viscovib_stepper, only: stepper_type
  use viscovib_stopping, only: stop_wanted
  use viscovib_stops, only: find_stop, in_range, needs_small_steps, run_coarse, run_completed, &
    run_diverged, run_event, run_names, run_stopped, run_unphysical, stop_type, step_visitor
  use viscovib_subnormals, only: flushing_type
  use viscovib_wanted_states, only: wanted_states
  use viscovib_watch, only: new_watch, watch_type, event_point_type
  use viscovib_watched_step, only: begin_graded, begin_small, halve, sides_of, step_watched, &
    watched_step_type
  implicit none
  private

  public :: simulate
  public :: run_coarse, run_completed, run_diverged, run_event, run_names, run_stopped, &
    run_unphysical

  type, extends(step_visitor) :: note_taker
    type(watch_type), pointer :: watch => null()
    type(wanted_states), pointer :: wanted => null()
    !> An event has ended the run: its time and state.
    logical :: ended = .false.
    real(wp) :: t = 0.0_wp
    real(wp), allocatable :: q(:), v(:)
  contains
    procedure :: visit
  end type note_taker

  !> Number of parts of a step above which laws count as too fast for the step.
  integer, parameter :: most_parts = 32768

contains

  !> Make steps first+1 ... first+n_steps, storing every save_every-th state and
  !! the states at requested times. Subnormal numbers are flushed to zero.
  subroutine simulate(method, system, first, n_steps, save_every, times, states, at_times, n_done, &
                      n_reached, t_reached, outcome, mesh, watch, nearby, accelerations)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    integer(i8), intent(in) :: first, n_steps, save_every
    !> Requested times within these steps, ascending.
    real(wp), intent(in) :: times(:)
    !> (q_1, v_1, q_2, v_2, ...) after steps save_every, 2 save_every, ..., of the first
    !! coordinates, shape (2 n, n_steps/save_every), or no columns to store none;
    !! the same at the requested times, as many as were reached.
    real(wp), intent(inout) :: states(:, :), at_times(:, :)
    !> Number of whole steps; the state in `method` is that at t_reached, the end of the last
    !! step or the stop inside the next.
    integer(i8), intent(out) :: n_done
    integer, intent(out) :: n_reached
    real(wp), intent(out) :: t_reached
    integer, intent(out) :: outcome
    !> Ends of steps; absent: equal steps.
    type(mesh_type), intent(in), optional :: mesh
    !> Events to look for.
    type(watch_type), intent(inout), optional :: watch
    !> Evolution of small perturbations, for a collocation.
    type(nearby_motion), intent(inout), optional :: nearby
    !> At the wanted times accelerations relative to the base, then forces of laws, shape
    !! (n_dof - n_hidden + n_laws, size(times)).
    real(wp), intent(inout), optional :: accelerations(:, :)
    type(watch_type) :: before
    real(wp) :: memory(method%memory_size()), h
    logical :: missed

    if (system%layers%exist()) then
      memory = method%save_memory()
      h = method%h
      if (present(watch)) before = watch
    end if
    call run_through(method, system, first, n_steps, save_every, times, states, at_times, n_done, &
                     n_reached, t_reached, outcome, missed, mesh, watch, nearby, accelerations)
    if (.not. missed) return
    system%in_parts = .true.
    call method%load_memory(memory)
    call method%change_step(system, h)
    if (present(watch)) watch = before
    call run_through(method, system, first, n_steps, save_every, times, states, at_times, n_done, &
                     n_reached, t_reached, outcome, missed, mesh, watch, nearby, accelerations)
  end subroutine simulate

  !> The same, but interrupted if whole steps may have missed a thin layer of a force.
  subroutine run_through(method, system, first, n_steps, save_every, times, states, at_times, &
                         n_done, n_reached, t_reached, outcome, missed, mesh, watch, nearby, &
                         accelerations)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    integer(i8), intent(in) :: first, n_steps, save_every
    real(wp), intent(in) :: times(:)
    real(wp), intent(inout) :: states(:, :), at_times(:, :)
    integer(i8), intent(out) :: n_done
    integer, intent(out) :: n_reached
    real(wp), intent(out) :: t_reached
    integer, intent(out) :: outcome
    logical, intent(out) :: missed
    type(mesh_type), intent(in), optional :: mesh
    type(watch_type), intent(inout), optional :: watch
    type(nearby_motion), intent(inout), optional :: nearby
    real(wp), intent(inout), optional :: accelerations(:, :)
    type(mesh_type) :: ends
    type(wanted_states) :: wanted
    type(watched_step_type) :: at
    type(watch_type) :: unwatched
    type(run_history) :: past
    type(layer_watch) :: layers
    type(flushing_type) :: flushing
    integer(i8) :: i, column
    real(wp) :: now, speed(size(method%q))
    integer :: piece
    logical :: turns

    call flushing%begin()
    outcome = run_completed
    n_done = 0
    call wanted%begin(times, 2*size(method%q), system, present(accelerations))
    ends = equal_steps(method%h)
    if (present(mesh)) ends = mesh
    piece = ends%piece_of(first)
    now = ends%start_of(first)
    call come_from(system, ends, piece, first, turns)
    if (ends%is_broken()) call enter_piece(method, system, ends, piece, now, turns, speed)
    if (.not. present(watch)) call new_watch(unwatched, [real(wp) ::])
    system%step_length = method%h
    call find_sides(at, method, system, now)
    if (present(nearby)) at%nearby = nearby
    call begin_graded(at, system, method%q, method%v, ends%begins(piece, first))
    if (turns) call turn(method, system, now, speed, at%sides)
    call layers%begin(system, now, method%q, method%v)
    missed = .false.
    do i = 1, n_steps
      t_reached = now
      if (stop_wanted()) then
        outcome = run_stopped
        exit
      end if
      if (first + i - 1 >= ends%made_by(piece)) then
        piece = piece + 1
        call go_on(method, system, ends, piece, now, at)
        call past%forget()
      end if
      at%from = now
      at%until = ends%time(piece, first + i)
      if (present(watch)) then
        call make_parts(method, system, at, past, wanted, watch, ends, piece, t_reached, outcome)
      else if (allocated(system%signals) .or. system%in_parts .or. present(nearby)) then
        call make_parts(method, system, at, past, wanted, unwatched, ends, piece, t_reached, &
                        outcome)
      else
        call make_step(method, system, at, past, wanted, unwatched, t_reached, outcome)
      end if
      if (outcome /= run_completed) exit
      n_done = i
      now = at%until
      t_reached = now
      if (layers%on) call layers%see(system, now, method%q, method%v, missed)
      if (missed) return
      if (mod(i, save_every) /= 0) cycle
      column = i/save_every
      if (column > size(states, 2)) cycle
      call keep(method, system, now, states(:, column))
    end do
    if (layers%on) missed = layers%look(system)
    if (outcome == run_completed) then
      call wanted%keep_between(method, system, now)
    else if (outcome /= run_stopped) then
      wanted%n_reached = min(wanted%n_reached, count(times <= t_reached))
      ! Small steps may locate the stop before the last of the steps made.
      n_done = ends%made_until(piece, first, n_done, t_reached)
      if (present(watch)) call watch%drop_after(t_reached)
    end if
    if (allocated(system%signals)) then
      system%sides = at%sides
      system%fresh = at%fresh
    end if
    system%grade = at%grade
    if (present(nearby)) nearby = at%nearby
    n_reached = wanted%n_reached
    at_times(:, :n_reached) = wanted%states(:size(at_times, 1), :n_reached)
    if (present(accelerations)) accelerations = wanted%accelerations
  end subroutine run_through

  !> Store the present state of the body.
  subroutine keep(method, system, now, state)
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: now
    real(wp), intent(out) :: state(:)
    real(wp), allocatable :: q(:), v(:)
    integer :: n
    if (counting) call count_up(counted_states, 1)
    n = size(state)/2
    state(1::2) = method%q(:n)
    state(2::2) = method%v(:n)
    if (.not. system%base_motion%moves()) return
    allocate (q, source=method%q)
    allocate (v, source=method%v)
    call system%add_base(now, q, v)
    state(1::2) = q(:n)
    state(2::2) = v(:n)
  end subroutine keep

  !> Sides of surfaces at the start: from an earlier run, or from the state.
  subroutine find_sides(at, method, system, now)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(inout) :: system
    real(wp), intent(in) :: now

    if (allocated(system%sides)) then
      at%sides = system%sides
      at%fresh = system%fresh
      return
    end if
    call system%settle(method%q, method%v)
    at%sides = sides_of(system, now, method%q, method%v)
    at%fresh = spread(.false., 1, size(at%sides))
  end subroutine find_sides

  !> One step of equations without surfaces.
  subroutine make_step(method, system, at, past, wanted, unwatched, t_reached, outcome)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    type(watched_step_type), intent(inout) :: at
    type(run_history), intent(inout) :: past
    type(wanted_states), intent(inout) :: wanted
    type(watch_type), intent(inout) :: unwatched
    real(wp), intent(inout) :: t_reached
    integer, intent(out) :: outcome
    integer :: n_before
    logical :: doubtful

    outcome = run_completed
    n_before = wanted%n_reached
    if (system%timed) method%since = at%from - system%present_piece(1)
    if (wanted%n_reached < size(wanted%times)) call wanted%keep_between(method, system, at%from)
    at%q = method%q
    at%v = method%v
    if (past%is_due()) call note(past, at%from, method)
    call method%step(system, at%made)
    doubtful = .not. at%made
    if (at%made) doubtful = .not. in_range(system, method%q, method%v)
    if (system%limited .and. .not. doubtful) then
      doubtful = needs_small_steps(system, 1, at%q, at%v, method%h, &
                                   method%least_margin(system, at%q, at%v))
    end if
    if (doubtful) then
      call check_step(method, system, at, past, wanted, n_before, unwatched, t_reached, outcome)
      if (outcome /= run_completed) return
    end if
    if (wanted%lost) call give_up(method, at, t_reached, outcome)
  end subroutine make_step

  !> Add the present state to the history.
  subroutine note(past, t, method)
    type(run_history), intent(inout) :: past
    real(wp), intent(in) :: t
    class(stepper_type), intent(in) :: method
    integer :: n
    n = size(method%q)
    call past%note(t, reshape(method%q, [1, n]), reshape(method%v, [1, n]))
  end subroutine note

  !> Set the outcome of a step that succeeded, except for the part up to a requested time.
  subroutine give_up(method, at, t_reached, outcome)
    class(stepper_type), intent(inout) :: method
    type(watched_step_type), intent(in) :: at
    real(wp), intent(out) :: t_reached
    integer, intent(out) :: outcome
    outcome = run_coarse
    t_reached = at%from
    method%q = at%q
    method%v = at%v
  end subroutine give_up

  !> One step, in parts that end on the surfaces of the equations, with its events.
  subroutine make_parts(method, system, at, past, wanted, watch, ends, piece, t_reached, outcome)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    type(watched_step_type), intent(inout) :: at
    type(run_history), intent(inout) :: past
    type(wanted_states), intent(inout) :: wanted
    type(watch_type), intent(inout) :: watch
    !> Ends of steps, and the present piece.
    type(mesh_type), intent(in) :: ends
    integer, intent(in) :: piece
    real(wp), intent(inout) :: t_reached
    integer, intent(out) :: outcome
    integer :: n_before, n_parts
    logical :: more

    outcome = run_completed
    n_parts = 0
    at%n_passed = 0
    at%n_halved = 0
    at%short = .false.
    at%graded = .false.
    more = .true.
    n_before = wanted%n_reached
    if (past%is_due()) call note(past, at%from, method)
    do while (more)
      call step_watched(at, method, system, watch, wanted, more)
      n_parts = n_parts + 1
      at%stuck = at%stuck .or. n_parts > most_parts
      if (at%ended) then
        outcome = run_event
        t_reached = at%from
        return
      end if
      if (at%stuck) then
        call give_up(method, at, t_reached, outcome)
        return
      end if
      if (.not. (at%made .or. system%limited)) then
        call halve(at, method, system, more)
        if (more) cycle
      end if
      ! After a surface the equations are different, or the motion was reflected.
      if (at%n_passed > 0) call past%forget()
      if (.not. at%made .or. at%near_edge) then
        call system%take_sides(0*at%sides)
        if (allocated(at%nearby)) at%nearby%known = .false.
        call check_step(method, system, at, past, wanted, n_before, watch, t_reached, outcome)
        call system%take_sides(at%sides)
        if (outcome /= run_completed) return
      end if
    end do
    if (at%n_passed > 0 .or. at%n_halved > 0 .or. at%graded) then
      call method%change_step(system, ends%h(piece))
    end if
    if (wanted%lost) call give_up(method, at, t_reached, outcome)
  end subroutine make_parts

  !> Test if a run continues at the end of a piece; its corner is then treated like later ones.
  subroutine come_from(system, ends, piece, first, turns)
    class(driven_system_type), intent(inout) :: system
    type(mesh_type), intent(in) :: ends
    integer, intent(in) :: piece
    integer(i8), intent(in) :: first
    logical, intent(out) :: turns
    turns = piece > 1 .and. ends%begins(piece, first) .and. .not. system%begins
    if (turns) call system%enter(ends%beginning(piece - 1), ends%ends(piece - 1))
  end subroutine come_from

  !> Begin the next piece of the mesh.
  subroutine go_on(method, system, ends, piece, now, at)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    type(mesh_type), intent(in) :: ends
    integer, intent(in) :: piece
    real(wp), intent(in) :: now
    type(watched_step_type), intent(inout) :: at
    real(wp) :: speed(size(method%q))
    call enter_piece(method, system, ends, piece, now, .true., speed)
    call turn(method, system, now, speed, at%sides)
    call begin_small(at, system%first_part())
  end subroutine go_on

  !> Set the steps for a piece of the mesh. A piece that was already entered keeps its steps. At a
  !! corner of the base motion the velocity of the body is continuous: relative velocities jump.
  subroutine enter_piece(method, system, ends, piece, now, turns, speed)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    type(mesh_type), intent(in) :: ends
    integer, intent(in) :: piece
    real(wp), intent(in) :: now
    !> True if the motion comes from the piece before; velocities before the corner.
    logical, intent(in) :: turns
    real(wp), intent(out) :: speed(:)
    real(wp) :: from, q(size(speed)), v(size(speed))

    from = 0.0_wp
    if (piece > 1) from = ends%ends(piece - 1)
    speed = method%v
    q = 0.0_wp
    v = 0.0_wp
    if (turns) call system%add_base(now, q, v)
    call system%enter(from, ends%ends(piece))
    if (turns) call system%add_base(now, q, v, share=-1.0_wp)
    if (any(abs(v) > 0.0_wp)) call method%put(method%q, method%v + v)
    if (abs(method%h - ends%h(piece)) > 0.0_wp .or. abs(now - from) <= 0.0_wp) then
      call method%change_step(system, ends%h(piece))
    end if
  end subroutine enter_piece

  !> Sides of the surfaces after a corner of the base motion.
  subroutine turn(method, system, now, speed, sides)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    real(wp), intent(in) :: now, speed(:)
    integer, intent(inout) :: sides(:)
    real(wp) :: v(size(speed))
    if (.not. system%base_motion%has_corners()) return
    if (.not. any(abs(method%v - speed) > 0.0_wp)) return
    v = method%v
    call system%jump(now, method%q, speed, v, sides)
    if (any(abs(v - method%v) > 0.0_wp)) call method%put(method%q, v)
  end subroutine turn

  !> Handle a failed step, or one near the edge of the physical range. If the motion stops in it,
  !! the state in `method` becomes that at the stop. Otherwise small steps replace it near the edge,
  !! where the motion is stiff or fast and a step that seems to succeed may be wrong.
  subroutine check_step(method, system, at, past, wanted, n_before, watch, t_reached, outcome)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(in) :: system
    type(watched_step_type), intent(in) :: at
    type(run_history), intent(in) :: past
    type(wanted_states), intent(inout) :: wanted
    !> Number of requested states that were known before the step.
    integer, intent(in) :: n_before
    type(watch_type), intent(inout) :: watch
    real(wp), intent(out) :: t_reached
    integer, intent(out) :: outcome
    type(stop_type) :: stop
    real(wp) :: frequencies(n_lanes, size(system%drives)), h
    logical :: sound, fills

    frequencies = spread(system%drives, 1, n_lanes)
    h = method%h
    if (at%short) h = at%until - at%from
    call find_stop(system, size(at%q), 1, frequencies, at%q, at%v, at%from, h, stop)
    fills = system%limited .and. (stop%near_edge .or. stop%outcome /= run_completed)
    if (fills .and. stop%outcome /= run_coarse) then
      wanted%n_reached = n_before
      wanted%lost = .false.
      call note_small_steps(system, at%q, at%v, at%from, h, watch, wanted, stop)
    end if
    outcome = stop%outcome
    t_reached = at%from
    if (outcome == run_event) then
      t_reached = at%from + stop%ahead
      method%q = stop%q
      method%v = stop%v
      return
    end if
    if (fills .and. outcome == run_completed) then
      if (at%made) then
        call method%put(stop%q, stop%v)
      else
        call method%arrive(stop%q, stop%v)
      end if
      return
    end if
    if (outcome == run_completed .or. outcome == run_coarse) then
      outcome = run_completed
      sound = at%made
      if (sound) sound = in_range(system, method%q, method%v)
      if (sound) sound = system%physical(method%q)
      if (sound) return
      stop%outcome = run_coarse
    end if
    call past%confirm(system, 1, size(at%q), 1, frequencies, 1.0_wp, at%from, h, stop)
    outcome = stop%outcome
    if (outcome == run_coarse) then
      stop%ahead = 0.0_wp
      stop%q = at%q
      stop%v = at%v
    end if
    t_reached = at%from + stop%ahead
    method%q = stop%q
    method%v = stop%v
  end subroutine check_step

  ! States inside a step of the run that small steps replace, as near
  ! the pivot of a pendulum: events and states at requested times, from each of the small steps.

  !> Repeat the steps of `find_stop` from (q, v) and store the requested data. An event that
  !! ends the run is its stop.
  subroutine note_small_steps(system, q, v, start, h, watch, wanted, stop)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: q(:), v(:), start, h
    type(watch_type), intent(inout), target :: watch
    type(wanted_states), intent(inout), target :: wanted
    !> Result of `find_stop`, other than "step too large".
    type(stop_type), intent(inout) :: stop
    type(note_taker) :: notes
    type(stop_type) :: again

    if (watch%is_idle() .and. .not. wanted%within(start, h)) return
    notes%watch => watch
    notes%wanted => wanted
    call find_stop(system, size(q), 1, spread(system%drives, 1, n_lanes), q, v, start, h, again, &
                   notes)
    if (.not. notes%ended) return
    stop%outcome = run_event
    stop%ahead = notes%t - start
    stop%q = notes%q
    stop%v = notes%v
  end subroutine note_small_steps

  !> Store events and requested states of one small step.
  subroutine visit(self, path)
    class(note_taker), intent(inout) :: self
    type(step_path), intent(in) :: path
    type(event_point_type), allocatable :: found(:)
    real(wp) :: t(1), q(1, size(path%q, 2)), v(1, size(path%q, 2)), until
    integer :: i

    if (self%ended) return
    call self%watch%extremes%take(path)
    call self%watch%look(path, .false., found)
    until = path%start + path%h
    do i = 1, size(found)
      call path%at([found(i)%place], t, q, v)
      call self%watch%keep(found(i), t(1), q(1, :), v(1, :), path%acceleration_at(found(i)%place))
      self%ended = self%watch%terminal(found(i)%which)
      if (.not. self%ended) cycle
      self%t = t(1)
      self%q = q(1, :)
      self%v = v(1, :)
      until = t(1)
    end do
    call self%wanted%keep_along(path, until)
  end subroutine visit

end module viscovib_simulate
