! Optimize: -O3
!> A run without memory in fixed steps.
module viscovib_simulate
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_layers, only: unseen
  use viscovib_layer_watch, only: layer_watch
  use viscovib_mesh, only: mesh_type
  use viscovib_nearby_motion, only: nearby_motion
  use viscovib_run_history, only: run_history
  use viscovib_step_path, only: step_path
  use viscovib_stepper, only: stepper_type
  use viscovib_stops, only: find_stop, in_range, needs_small_steps, stop_type, step_visitor
  use viscovib_time_run, only: make_run, put_state, run_coarse, run_completed, run_event, &
    run_motion, run_stopped, time_run
  use viscovib_wanted_states, only: keep_along, keep_between
  use viscovib_watch, only: event_point_type, watch_type
  use viscovib_watched_step, only: begin_graded, begin_small, halve, sides_of, step_watched, &
    watched_step_type
  implicit none
  private

  public :: simulate

  type, extends(run_motion) :: plain_motion
    class(stepper_type), pointer :: method => null()
    class(driven_system_type), pointer :: system => null()
    type(watched_step_type) :: at
    type(run_history) :: past
    type(layer_watch) :: layers
    !> True if whole steps may have missed a thin layer of a force.
    logical :: missed = .false.
  contains
    procedure :: begin
    procedure :: enter
    procedure :: advance
    procedure :: store
  end type plain_motion

  type, extends(step_visitor) :: note_taker
    class(time_run), pointer :: run => null()
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

  !> Make the steps of a run, in parts if whole steps may have missed a thin layer of a force. The
  !! state in `method` becomes that at the end of the run.
  subroutine simulate(method, system, run, nearby)
    class(stepper_type), intent(inout), target :: method
    class(driven_system_type), intent(inout), target :: system
    class(time_run), intent(inout) :: run
    !> Evolution of small perturbations, for a collocation.
    type(nearby_motion), intent(inout), optional :: nearby
    type(plain_motion) :: motion
    type(watch_type), allocatable :: before
    real(wp) :: memory(method%memory_size()), h

    if (system%layers%exist()) then
      memory = method%save_memory()
      h = method%h
      if (allocated(run%watch)) before = run%watch
    end if
    motion%method => method
    motion%system => system
    if (present(nearby)) motion%at%nearby = nearby
    call make_run(motion, run)
    if (motion%layers%on .and. .not. motion%missed) then
      motion%missed = motion%layers%thinness() > unseen
    end if
    if (motion%missed) then
      system%in_parts = .true.
      call method%load_memory(memory)
      call method%change_step(system, h)
      if (allocated(run%watch)) run%watch = before
      motion%at = watched_step_type()
      motion%layers = layer_watch()
      motion%missed = .false.
      call motion%past%forget()
      if (present(nearby)) motion%at%nearby = nearby
      call make_run(motion, run)
    end if
    if (run%ended == run_completed) call keep_between(run, method, system, run%t_reached)
    associate (at => motion%at)
      if (allocated(system%signals)) then
        system%sides = at%sides
        system%fresh = at%fresh
      end if
      system%grade = at%grade
      if (present(nearby)) nearby = at%nearby
    end associate
  end subroutine simulate

  subroutine begin(self, run, piece)
    class(plain_motion), intent(inout) :: self
    class(time_run), intent(inout) :: run
    integer, intent(in) :: piece
    real(wp) :: speed(size(self%method%q))
    logical :: starts, turns

    starts = run%mesh%begins(piece, run%first)
    associate (method => self%method, system => self%system, at => self%at, now => run%t_reached)
      ! A run may continue at the end of a piece; its corner is then treated like later ones.
      turns = piece > 1 .and. starts .and. .not. system%begins
      if (turns) call system%enter(run%mesh%beginning(piece - 1), run%mesh%ends(piece - 1))
      if (run%mesh%is_broken()) call enter_piece(self, run%mesh, piece, now, turns, speed)
      system%step_length = method%h
      call find_sides(at, method, system, now)
      call begin_graded(at, system, method%q, method%v, starts)
      if (turns) call turn(self, now, speed)
      ! Steps that are made in parts check for layers themselves.
      if (system%in_parts .or. allocated(system%signals)) return
      call self%layers%begin(system%layers, now, method%q, method%v)
    end associate
  end subroutine begin

  subroutine enter(self, run, piece)
    class(plain_motion), intent(inout) :: self
    class(time_run), intent(in) :: run
    integer, intent(in) :: piece
    real(wp) :: speed(size(self%method%q))
    call enter_piece(self, run%mesh, piece, run%t_reached, .true., speed)
    call turn(self, run%t_reached, speed)
    call begin_small(self%at, self%system%first_part())
    call self%past%forget()
  end subroutine enter

  subroutine advance(self, run, piece, until)
    class(plain_motion), intent(inout) :: self
    class(time_run), intent(inout), target :: run
    integer, intent(in) :: piece
    real(wp), intent(in) :: until

    self%at%from = run%t_reached
    self%at%until = until
    if (allocated(run%watch) .or. allocated(self%system%signals) .or. self%system%in_parts &
        .or. allocated(self%at%nearby)) then
      call make_parts(self, run, piece)
    else
      call make_step(self, run)
    end if
    if (run%ended /= run_completed .or. .not. self%layers%on) return
    call self%layers%follow(self%at%until, self%method%q, self%method%v)
    self%missed = self%layers%thinnest > unseen
    if (self%missed) run%ended = run_stopped
  end subroutine advance

  subroutine store(self, t, state, dofs)
    class(plain_motion), intent(inout) :: self
    real(wp), intent(in) :: t
    real(wp), intent(inout) :: state(:)
    integer, intent(in), optional :: dofs(:)
    real(wp), dimension(size(self%method%q)) :: q, v
    if (self%system%base_motion%moves()) then
      q = self%method%q
      v = self%method%v
      call self%system%add_base(t, q, v)
      call put_state(q, v, state, dofs)
    else
      call put_state(self%method%q, self%method%v, state, dofs)
    end if
  end subroutine store

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
  subroutine make_step(self, run)
    class(plain_motion), intent(inout) :: self
    class(time_run), intent(inout), target :: run
    integer :: n_before
    logical :: doubtful

    n_before = run%n_reached
    associate (method => self%method, system => self%system, at => self%at)
      if (system%timed) method%since = at%from - system%present_piece(1)
      if (run%n_reached < size(run%times)) call keep_between(run, method, system, at%from)
      at%q = method%q
      at%v = method%v
      if (self%past%is_due()) call self%past%note(at%from, [method%q, method%v])
      call method%step(system, at%made)
      doubtful = .not. at%made
      if (at%made) doubtful = .not. in_range(system, method%q, method%v)
      if (system%limited .and. .not. doubtful) then
        doubtful = needs_small_steps(system, 1, at%q, at%v, method%h, &
                                     method%least_margin(system, at%q, at%v))
      end if
    end associate
    if (doubtful) call check_step(self, run, n_before)
    if (run%lost .and. run%ended == run_completed) call give_up(self, run)
  end subroutine make_step

  !> Set the outcome of a step that succeeded, except for the part up to a requested time.
  subroutine give_up(self, run)
    class(plain_motion), intent(inout) :: self
    class(time_run), intent(inout) :: run
    run%ended = run_coarse
    run%t_reached = self%at%from
    self%method%q = self%at%q
    self%method%v = self%at%v
  end subroutine give_up

  !> One step, in parts that end on the surfaces of the equations, with its events.
  subroutine make_parts(self, run, piece)
    class(plain_motion), intent(inout) :: self
    class(time_run), intent(inout), target :: run
    integer, intent(in) :: piece
    integer :: n_before, n_parts
    logical :: more

    n_parts = 0
    n_before = run%n_reached
    associate (method => self%method, system => self%system, at => self%at)
      at%n_passed = 0
      at%n_halved = 0
      at%short = .false.
      at%graded = .false.
      more = .true.
      if (self%past%is_due()) call self%past%note(at%from, [method%q, method%v])
      do while (more)
        call step_watched(at, method, system, run, more)
        n_parts = n_parts + 1
        at%stuck = at%stuck .or. n_parts > most_parts
        if (at%ended) then
          run%ended = run_event
          run%t_reached = at%from
          return
        end if
        if (at%stuck) then
          call give_up(self, run)
          return
        end if
        if (.not. (at%made .or. system%limited)) then
          call halve(at, method, system, more)
          if (more) cycle
        end if
        ! After a surface the equations are different, or the motion was reflected.
        if (at%n_passed > 0) call self%past%forget()
        if (.not. at%made .or. at%near_edge) then
          call system%take_sides(0*at%sides)
          if (allocated(at%nearby)) at%nearby%known = .false.
          call check_step(self, run, n_before)
          call system%take_sides(at%sides)
          if (run%ended /= run_completed) return
        end if
      end do
      if (at%n_passed > 0 .or. at%n_halved > 0 .or. at%graded) then
        call method%change_step(system, run%mesh%h(piece))
      end if
    end associate
    if (run%lost) call give_up(self, run)
  end subroutine make_parts

  !> Set the steps for a piece of the mesh. A piece that was already entered keeps its steps. At a
  !! corner of the base motion the velocity of the body is continuous: relative velocities jump.
  subroutine enter_piece(self, mesh, piece, now, turns, speed)
    class(plain_motion), intent(inout) :: self
    type(mesh_type), intent(in) :: mesh
    integer, intent(in) :: piece
    real(wp), intent(in) :: now
    !> True if the motion comes from the piece before; velocities before the corner.
    logical, intent(in) :: turns
    real(wp), intent(out) :: speed(:)
    real(wp) :: from, q(size(speed)), v(size(speed))

    from = mesh%beginning(piece)
    q = 0.0_wp
    v = 0.0_wp
    associate (method => self%method, system => self%system)
      speed = method%v
      if (turns) call system%add_base(now, q, v)
      call system%enter(from, mesh%ends(piece))
      if (turns) call system%add_base(now, q, v, share=-1.0_wp)
      if (any(abs(v) > 0.0_wp)) call method%put(method%q, method%v + v)
      if (abs(method%h - mesh%h(piece)) > 0.0_wp .or. abs(now - from) <= 0.0_wp) then
        call method%change_step(system, mesh%h(piece))
      end if
    end associate
  end subroutine enter_piece

  !> Sides of the surfaces after a corner of the base motion.
  subroutine turn(self, now, speed)
    class(plain_motion), intent(inout) :: self
    real(wp), intent(in) :: now, speed(:)
    real(wp) :: v(size(speed))
    associate (method => self%method, system => self%system)
      if (.not. system%base_motion%has_corners()) return
      if (.not. any(abs(method%v - speed) > 0.0_wp)) return
      v = method%v
      call system%jump(now, method%q, speed, v, self%at%sides)
      if (any(abs(v - method%v) > 0.0_wp)) call method%put(method%q, v)
    end associate
  end subroutine turn

  !> Handle a failed step, or one near the edge of the physical range. If the motion stops in it,
  !! the state in `method` becomes that at the stop. Otherwise small steps replace it near the edge,
  !! where the motion is stiff or fast and a step that seems to succeed may be wrong.
  subroutine check_step(self, run, n_before)
    class(plain_motion), intent(inout) :: self
    class(time_run), intent(inout), target :: run
    !> Number of requested states that were known before the step.
    integer, intent(in) :: n_before
    type(stop_type) :: stop
    real(wp) :: frequencies(n_lanes, size(self%system%drives)), h
    logical :: sound, fills

    associate (method => self%method, system => self%system, at => self%at)
      frequencies = spread(system%drives, 1, n_lanes)
      h = method%h
      if (at%short) h = at%until - at%from
      call find_stop(system, size(at%q), 1, frequencies, at%q, at%v, at%from, h, stop)
      fills = system%limited .and. (stop%near_edge .or. stop%outcome /= run_completed)
      if (fills .and. stop%outcome /= run_coarse) then
        run%n_reached = n_before
        run%lost = .false.
        call note_small_steps(system, at%q, at%v, at%from, h, run, stop)
      end if
      if (fills .and. stop%outcome == run_completed) then
        if (at%made) then
          call method%put(stop%q, stop%v)
        else
          call method%arrive(stop%q, stop%v)
        end if
        return
      end if
      if (stop%outcome == run_completed .or. stop%outcome == run_coarse) then
        sound = at%made
        if (sound) sound = in_range(system, method%q, method%v)
        if (sound) sound = system%physical(method%q)
        if (sound) return
        stop%outcome = run_coarse
      end if
      if (stop%outcome /= run_event) then
        call self%past%confirm(system, 1, size(at%q), 1, frequencies, 1.0_wp, at%from, h, stop)
      end if
      run%ended = stop%outcome
      if (stop%outcome == run_coarse) then
        stop%ahead = 0.0_wp
        stop%q = at%q
        stop%v = at%v
      end if
      run%t_reached = at%from + stop%ahead
      method%q = stop%q
      method%v = stop%v
    end associate
  end subroutine check_step

  ! States inside a step of the run that small steps replace, as near
  ! the pivot of a pendulum: events and states at requested times, from each of the small steps.

  !> Repeat the steps of `find_stop` from (q, v) and store the requested data. An event that
  !! ends the run is its stop.
  subroutine note_small_steps(system, q, v, start, h, run, stop)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: q(:), v(:), start, h
    class(time_run), intent(inout), target :: run
    !> Result of `find_stop`, other than "step too large".
    type(stop_type), intent(inout) :: stop
    type(note_taker) :: notes
    type(stop_type) :: again

    if (.not. (allocated(run%watch) .or. run%wants_state(start, h))) return
    notes%run => run
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
    until = path%start + path%h
    if (allocated(self%run%watch)) then
      associate (watch => self%run%watch)
        call watch%extremes%take(path)
        call watch%look(path, .false., found)
        do i = 1, size(found)
          call path%at([found(i)%place], t, q, v)
          call watch%keep(found(i), t(1), q(1, :), v(1, :), path%acceleration_at(found(i)%place))
          self%ended = watch%terminal(found(i)%which)
          if (.not. self%ended) cycle
          self%t = t(1)
          self%q = q(1, :)
          self%v = v(1, :)
          until = t(1)
        end do
      end associate
    end if
    call keep_along(self%run, path, until)
  end subroutine visit

end module viscovib_simulate
