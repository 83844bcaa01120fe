! Optimize: -O3
!> A run with memory, or of a structure, in fixed steps.
module viscovib_hereditary_run
  use viscovib_base_motion, only: base_motion_type
  use viscovib_collocation, only: parts
  use viscovib_kinds, only: wp
  use viscovib_law_layers, only: law_layers
  use viscovib_layer_watch, only: layer_watch
  use viscovib_march, only: march_type
  use viscovib_march_events, only: look_inside
  use viscovib_mesh, only: mesh_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_run_history, only: run_history
  use viscovib_stops, only: find_stop_of_march, stop_type
  use viscovib_time_run, only: make_run, put_state, run_coarse, run_completed, run_diverged, &
    run_event, run_motion, time_run
  implicit none
  private

  public :: run_hereditary

  type, extends(run_motion) :: hereditary_motion
    class(march_type), pointer :: march => null()
    type(base_motion_type), pointer :: base => null()
    !> True if load and base have changed; the state is relative to the new base.
    logical :: anew = .false.
    !> False if the steps of the present piece are too large.
    logical :: entered = .true.
    type(run_history) :: past
    type(layer_watch) :: layers
  contains
    procedure :: begin
    procedure :: enter
    procedure :: advance
    procedure :: store
  end type hereditary_motion

contains

  !> Make the steps of a run. The state in `march` becomes that at its end. Events are detected by
  !! the polynomials of the steps.
  subroutine run_hereditary(march, base, run, anew, thinnest)
    class(march_type), intent(inout), target :: march
    type(base_motion_type), intent(inout), target :: base
    class(time_run), intent(inout) :: run
    !> As in `hereditary_motion`.
    logical, intent(in) :: anew
    !> Largest change of an argument of a law in a step, relative to the length that is resolved.
    real(wp), intent(out) :: thinnest
    type(hereditary_motion) :: motion

    motion%march => march
    motion%base => base
    motion%anew = anew
    call make_run(motion, run)
    thinnest = motion%layers%thinness()
  end subroutine run_hereditary

  subroutine begin(self, run, piece)
    class(hereditary_motion), intent(inout) :: self
    class(time_run), intent(inout) :: run
    integer, intent(in) :: piece
    type(law_layers) :: layers
    real(wp), dimension(self%march%n_read()) :: w, w_rate
    logical :: continues
    integer :: before

    continues = run%mesh%begins(piece, run%first)
    before = piece
    if (piece > 1 .and. continues .and. .not. self%anew) before = piece - 1
    call self%base%enter(run%mesh%beginning(before), run%mesh%ends(before))
    do while (run%wants_state(run%t_reached, spacing(run%t_reached)))
      run%n_reached = run%n_reached + 1
      call self%store(run%t_reached, run%at_times(:, run%n_reached), run%dofs)
    end do
    select type (system => self%march%system)
    class is (polynomial_type)
      if (size(system%laws) > 0) call layers%find(system%laws)
    end select
    call self%march%read_by_laws(w, w_rate)
    call self%layers%begin(layers, run%t_reached, w, w_rate)
    if (run%mesh%is_broken() .and. continues) call enter(self, run, piece)
  end subroutine begin

  subroutine enter(self, run, piece)
    class(hereditary_motion), intent(inout) :: self
    class(time_run), intent(in) :: run
    integer, intent(in) :: piece
    if (run%t_reached > 0.0_wp .and. self%base%has_corners()) call turn(self, run%mesh, piece, &
                                                                       run%t_reached)
    call self%march%enter(run%t_reached, run%mesh%h(piece), self%entered)
    call self%past%forget()
    if (self%layers%on) call look_on(self, run%t_reached, .true.)
  end subroutine enter

  subroutine advance(self, run, piece, until)
    class(hereditary_motion), intent(inout) :: self
    class(time_run), intent(inout), target :: run
    integer, intent(in) :: piece
    real(wp), intent(in) :: until
    real(wp) :: from
    logical :: made

    from = run%t_reached
    made = self%entered
    if (made) then
      if (self%past%is_due()) call self%past%note(from, self%march%save_memory())
      call self%march%step(until, made)
    end if
    if (.not. made) call find_end(self, run, piece, until)
    if (run%ended /= run_completed) return
    if (self%layers%on) call look_on(self, until, .false.)
    if (allocated(run%watch)) then
      call look_inside(self%march, self%base, run%watch, from, until, run%t_reached, run%ended)
    end if
    if (run%n_reached < size(run%times)) call keep_reached(self, run, until)
  end subroutine advance

  !> Handle a failed step.
  subroutine find_end(self, run, piece, until)
    class(hereditary_motion), intent(inout) :: self
    class(time_run), intent(inout) :: run
    integer, intent(in) :: piece
    real(wp), intent(in) :: until
    type(stop_type) :: stop
    real(wp), allocatable :: memory(:)
    real(wp) :: from, h
    logical :: made, trusted

    from = run%t_reached
    h = run%mesh%h(piece)
    associate (march => self%march)
      trusted = march%doubtful
      run%ended = run_coarse
      if (march%gives_up .and. .not. trusted) return
      allocate (memory, source=march%save_memory())
      call find_stop_of_march(march, from, until - from, stop)
      if (stop%outcome == run_coarse) then
        stop%ahead = 0.0_wp
        if (trusted) then
          march%trusted = .true.
          call march%change_step(from, h, made)
          if (made) call march%step(until, made)
          if (made) stop%outcome = run_completed
        end if
      end if
      self%entered = .true.
      run%ended = stop%outcome
      if (run%ended == run_completed) return
      if (run%ended == run_diverged .and. (allocated(run%watch) &
                                           .or. run%n_reached < size(run%times))) then
        call look_at_small_steps(self, run, from, memory, stop%lengths)
        if (run%ended == run_event) return
      end if
      call self%past%confirm_march(march, run%mesh%ends(piece), from, h, stop)
      run%ended = stop%outcome
      run%t_reached = from + stop%ahead
    end associate
  end subroutine find_end

  !> Repeat the small steps from the time `from` to a stop, and store the events and requested
  !! states in them. `run%ended` is the outcome of the stop, or a terminal event.
  subroutine look_at_small_steps(self, run, from, memory, lengths)
    class(hereditary_motion), intent(inout) :: self
    class(time_run), intent(inout) :: run
    real(wp), intent(in) :: from
    !> The data at the time `from`, and the lengths of the small steps.
    real(wp), intent(in) :: memory(:), lengths(:)
    ! The length of the data may differ, with the whole past.
    real(wp), allocatable :: last(:)
    real(wp) :: now
    logical :: made
    integer :: i

    allocate (last, source=self%march%save_memory())
    call self%march%load_memory(memory, .false.)
    now = from
    do i = 1, size(lengths)
      call self%march%change_step(now, lengths(i), made)
      if (made) call self%march%step(now + lengths(i), made)
      if (.not. made) exit
      if (allocated(run%watch)) then
        call look_inside(self%march, self%base, run%watch, now, now + lengths(i), run%t_reached, &
                         run%ended)
      end if
      now = now + lengths(i)
      call keep_reached(self, run, now)
      if (run%ended == run_event) return
    end do
    call self%march%load_memory(last, .false.)
  end subroutine look_at_small_steps

  subroutine store(self, t, state, dofs)
    class(hereditary_motion), intent(inout) :: self
    real(wp), intent(in) :: t
    real(wp), intent(inout) :: state(:)
    integer, intent(in), optional :: dofs(:)
    real(wp), dimension(self%march%n_observed()) :: u, v
    call self%march%observe(u, v)
    if (self%base%moves()) call self%base%add_to(t, u, v)
    call put_state(u, v, state, dofs)
  end subroutine store

  !> Monitor thin layers between the present state and the one before, unless it `jumps`.
  subroutine look_on(self, now, jumps)
    class(hereditary_motion), intent(inout) :: self
    real(wp), intent(in) :: now
    logical, intent(in) :: jumps
    real(wp), dimension(self%march%n_read()) :: w, w_rate
    call self%march%read_by_laws(w, w_rate)
    if (jumps) then
      call self%layers%jump(now, w, w_rate)
    else
      call self%layers%follow(now, w, w_rate)
    end if
  end subroutine look_on

  !> Store the states at the requested times that the last step has reached.
  subroutine keep_reached(self, run, now)
    class(hereditary_motion), intent(inout) :: self
    class(time_run), intent(inout) :: run
    real(wp), intent(in) :: now
    real(wp) :: u(self%march%n_observed()), v(self%march%n_observed())
    real(wp) :: ahead, part, theta, rounded

    rounded = 4.0_wp*epsilon(1.0_wp)*abs(now)
    do while (run%n_reached < size(run%times))
      ahead = run%times(run%n_reached + 1) - now
      if (abs(ahead) <= rounded) then
        call self%march%observe(u, v)
      else if (ahead < 0.0_wp) then
        theta = 1.0_wp + ahead/self%march%h
        ! Times are rounded, parts of steps are not.
        part = real(nint(theta*parts), wp)/parts
        if (abs(part - theta)*self%march%h <= rounded) theta = part
        call self%march%inside(theta, u, v)
      else
        exit
      end if
      if (self%base%moves()) call self%base%add_to(run%times(run%n_reached + 1), u, v)
      call run%keep_wanted(u, v)
    end do
  end subroutine keep_reached

  !> Apply a corner of the base motion at time `now`; the motion of the body is unchanged.
  subroutine turn(self, mesh, piece, now)
    class(hereditary_motion), intent(inout) :: self
    type(mesh_type), intent(in) :: mesh
    integer, intent(in) :: piece
    real(wp), intent(in) :: now
    real(wp), dimension(self%base%n_displacements()) :: displacement, velocity, next, next_velocity
    call self%base%along(now, displacement, velocity)
    call self%base%enter(mesh%beginning(piece), mesh%ends(piece))
    call self%base%along(now, next, next_velocity)
    call self%march%kick(self%base, displacement - next, velocity - next_velocity)
  end subroutine turn

end module viscovib_hereditary_run
