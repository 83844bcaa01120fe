!> A run with memory in fixed steps: its stored states and its outcome.
module viscovib_hereditary_run
  use viscovib_base_motion, only: base_motion_type
  use viscovib_collocation, only: parts
  use viscovib_counters, only: count_up, counted_states, counting
  use viscovib_hereditary_stops, only: hereditary_past, stop_hereditary
  use viscovib_kinds, only: i8, wp
  use viscovib_layer_watch, only: layer_watch
  use viscovib_march, only: march_type
  use viscovib_march_events, only: look_inside
  use viscovib_mesh, only: equal_steps, mesh_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_simulate, only: run_coarse, run_completed, run_stopped
  use viscovib_stopping, only: stop_wanted
  use viscovib_subnormals, only: flushing_type
  use viscovib_time_load, only: time_load_type
  use viscovib_watch, only: watch_type
  implicit none
  private

  public :: run_hereditary

contains

  !> Make steps first+1 ... first+n_steps, storing every save_every-th state and
  !! the states at requested times. Subnormal numbers are flushed to zero.
  subroutine run_hereditary(run, system, load, base, first, n_steps, save_every, times, states, &
                            at_times, n_done, n_reached, t_reached, outcome, mesh, anew, watch, &
                            thinnest)
    class(march_type), intent(inout) :: run
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    type(base_motion_type), intent(inout) :: base
    integer(i8), intent(in) :: first, n_steps, save_every
    !> Requested times within these steps, ascending.
    real(wp), intent(in) :: times(:)
    !> States of the body, (u_1, u'_1, u_2, u'_2, ...) after steps save_every, 2 save_every, ...,
    !! shape (2 n_observed, n_steps/save_every), or no columns to store none; the same at the
    !! requested times, as many as were reached.
    real(wp), intent(inout) :: states(:, :), at_times(:, :)
    !> Number of whole steps; the state in `run` is that at t_reached, the end of the last step or
    !! the stop inside the next.
    integer(i8), intent(out) :: n_done
    real(wp), intent(out) :: t_reached
    integer, intent(out) :: n_reached, outcome
    !> Ends of steps; absent: equal steps.
    type(mesh_type), intent(in), optional :: mesh
    !> True if load and base have changed; the state is relative to the new base.
    logical, intent(in), optional :: anew
    !> Events to detect, by the polynomials of the steps; their states are those of the body.
    type(watch_type), intent(inout), optional :: watch
    !> Largest change of an argument of a law in a step, relative to the length that is resolved.
    real(wp), intent(out), optional :: thinnest
    type(layer_watch) :: layers
    type(flushing_type) :: flushing

    call flushing%begin()
    call make_steps(run, system, load, base, layers, first, n_steps, save_every, times, states, &
                    at_times, n_done, n_reached, t_reached, outcome, mesh, anew, watch)
    if (present(thinnest)) thinnest = layers%thinness()
  end subroutine run_hereditary

  !> Make the steps; `layers` monitors them.
  subroutine make_steps(run, system, load, base, layers, first, n_steps, save_every, times, &
                        states, at_times, n_done, n_reached, t_reached, outcome, mesh, anew, watch)
    class(march_type), intent(inout) :: run
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    type(base_motion_type), intent(inout) :: base
    type(layer_watch), intent(inout) :: layers
    integer(i8), intent(in) :: first, n_steps, save_every
    real(wp), intent(in) :: times(:)
    real(wp), intent(inout) :: states(:, :), at_times(:, :)
    integer(i8), intent(out) :: n_done
    real(wp), intent(out) :: t_reached
    integer, intent(out) :: n_reached, outcome
    type(mesh_type), intent(in), optional :: mesh
    logical, intent(in), optional :: anew
    type(watch_type), intent(inout), optional :: watch
    type(mesh_type) :: ends
    real(wp) :: u(run%n_observed()), v(run%n_observed()), now, from
    real(wp) :: w(run%n_read()), w_rate(run%n_read())
    integer(i8) :: i, column
    logical :: made, trusted
    type(hereditary_past) :: past
    integer :: piece, before

    outcome = run_completed
    n_done = 0
    n_reached = 0
    ends = equal_steps(run%h)
    if (present(mesh)) ends = mesh
    piece = ends%piece_of(first)
    now = 0.0_wp
    if (first > 0) now = ends%time(piece, first)
    before = piece
    if (piece > 1 .and. ends%begins(piece, first)) before = piece - 1
    if (present(anew)) before = merge(piece, before, anew)
    call base%enter(ends%beginning(before), ends%ends(before))
    call keep_present(run, base, times, now, at_times, n_reached)
    call run%read_by_laws(w, w_rate)
    call layers%begin_to_follow(system, now, w, w_rate)
    do i = 1, n_steps
      if (stop_wanted()) then
        outcome = run_stopped
        t_reached = now
        return
      end if
      piece = ends%piece_of_next(piece, first + i - 1)
      made = .true.
      if (ends%is_broken() .and. ends%begins(piece, first + i - 1)) then
        if (first + i > 1 .and. base%has_corners()) call turn(run, base, ends, piece, now)
        call run%enter(system, load, now, ends%h(piece), made)
        call past%forget()
        if (layers%on) call look_on(run, layers, now, .true.)
      end if
      if (made) call past%note(run, now, first + i - 1)
      from = now
      now = ends%time(piece, first + i)
      if (made) call run%step(system, load, first + i - 1, now, made)
      if (.not. made) then
        trusted = run%doubtful
        outcome = run_coarse
        t_reached = from
        if (run%gives_up .and. .not. trusted) return
        call stop_hereditary(run, system, load, first + i - 1, from, now, t_reached, outcome)
        if (outcome == run_coarse .and. trusted) then
          run%trusted = .true.
          call run%change_step(system, load, from, ends%h(piece), made)
          if (made) call run%step(system, load, first + i - 1, now, made)
          if (made) outcome = run_completed
        end if
        if (outcome /= run_completed) then
          call past%confirm(run, system, load, ends%ends(piece), ends%h(piece), t_reached, outcome)
          n_reached = min(n_reached, count(times <= t_reached))
          n_done = ends%made_until(piece, first, n_done, t_reached)
          if (present(watch)) call watch%drop_after(t_reached)
          return
        end if
      end if
      n_done = i
      if (layers%on) call look_on(run, layers, now, .false.)
      if (present(watch)) then
        call look_inside(run, base, watch, from, now, t_reached, outcome)
        if (outcome /= run_completed) then
          ! The step extends beyond the event: it does not count.
          n_done = i - 1
          call keep_reached(run, base, times, now, at_times, n_reached, u, v)
          n_reached = min(n_reached, count(times <= t_reached))
          return
        end if
      end if
      if (n_reached < size(times)) then
        call keep_reached(run, base, times, now, at_times, n_reached, u, v)
      end if
      if (mod(i, save_every) /= 0) cycle
      column = i/save_every
      if (column > size(states, 2)) cycle
      call run%observe(u, v)
      call keep(base, now, u, v, states(:, column))
    end do
    t_reached = now
  end subroutine make_steps

  !> Monitor thin layers between the present state and the one before, unless it `jumps`.
  subroutine look_on(run, layers, now, jumps)
    class(march_type), intent(in) :: run
    type(layer_watch), intent(inout) :: layers
    real(wp), intent(in) :: now
    logical, intent(in) :: jumps
    real(wp), dimension(run%n_read()) :: w, w_rate
    call run%read_by_laws(w, w_rate)
    if (jumps) then
      call layers%jump(now, w, w_rate)
    else
      call layers%follow(now, w, w_rate)
    end if
  end subroutine look_on

  !> Store the state at the start of a run for the requested times up to then.
  subroutine keep_present(run, base, times, now, at_times, n_reached)
    class(march_type), intent(inout) :: run
    type(base_motion_type), intent(inout) :: base
    real(wp), intent(in) :: times(:), now
    real(wp), intent(inout) :: at_times(:, :)
    integer, intent(inout) :: n_reached
    real(wp) :: u(run%n_observed()), v(run%n_observed())
    do while (n_reached < size(times))
      if (times(n_reached + 1) > now) exit
      n_reached = n_reached + 1
      call run%observe(u, v)
      call keep(base, now, u, v, at_times(:, n_reached))
    end do
  end subroutine keep_present

  !> Store the states at the requested times that the last step has reached.
  subroutine keep_reached(run, base, times, now, at_times, n_reached, u, v)
    class(march_type), intent(inout) :: run
    type(base_motion_type), intent(inout) :: base
    real(wp), intent(in) :: times(:), now
    real(wp), intent(inout) :: at_times(:, :)
    integer, intent(inout) :: n_reached
    !> Workspace (n_observed).
    real(wp), intent(out) :: u(:), v(:)
    real(wp) :: ahead, part, theta, rounded

    rounded = 4.0_wp*epsilon(1.0_wp)*abs(now)
    do while (n_reached < size(times))
      ahead = times(n_reached + 1) - now
      if (abs(ahead) <= rounded) then
        call run%observe(u, v)
      else if (ahead < 0.0_wp) then
        theta = 1.0_wp + ahead/run%h
        ! Times are rounded, parts of steps are not.
        part = real(nint(theta*parts), wp)/parts
        if (abs(part - theta)*run%h <= rounded) theta = part
        call run%inside(theta, u, v)
      else
        exit
      end if
      n_reached = n_reached + 1
      call keep(base, times(n_reached), u, v, at_times(:, n_reached))
    end do
  end subroutine keep_reached

  !> Store (u, v), relative to the base, as the state of the body at time t.
  subroutine keep(base, t, u, v, state)
    type(base_motion_type), intent(inout) :: base
    real(wp), intent(in) :: t
    real(wp), intent(inout) :: u(:), v(:), state(:)
    if (base%moves()) call base%add_to(t, u, v)
    if (counting) call count_up(counted_states, 1)
    state(1::2) = u
    state(2::2) = v
  end subroutine keep

  !> Apply a corner of the base motion at time `now`; the motion of the body is unchanged.
  subroutine turn(run, base, ends, piece, now)
    class(march_type), intent(inout) :: run
    type(base_motion_type), intent(inout) :: base
    type(mesh_type), intent(in) :: ends
    integer, intent(in) :: piece
    real(wp), intent(in) :: now
    real(wp), dimension(base%n_displacements()) :: displacement, velocity, next, next_velocity
    call base%along(now, displacement, velocity)
    call base%enter(ends%beginning(piece), ends%ends(piece))
    call base%along(now, next, next_velocity)
    call run%kick(base, displacement - next, velocity - next_velocity)
  end subroutine turn

end module viscovib_hereditary_run
