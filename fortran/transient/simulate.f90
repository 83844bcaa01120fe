!> A run in fixed steps: what is kept of it, and how it ends.
module viscovib_simulate
  use, intrinsic :: ieee_arithmetic, only: ieee_set_underflow_mode, &
    ieee_support_underflow_control
  use viscovib_counters, only: count_up, counted_states, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  use viscovib_mesh, only: equal_steps, mesh_type
  use viscovib_stepper, only: stepper_type
  use viscovib_stopping, only: stop_wanted
  use viscovib_stops, only: find_stop, in_range, run_coarse, run_completed, run_diverged, &
    run_names, run_stopped, run_unphysical, stop_type
  implicit none
  private

  public :: simulate
  public :: run_coarse, run_completed, run_diverged, run_names, run_stopped, run_unphysical

contains

  !> Make steps first+1 ... first+n_steps, keeping every save_every-th state and
  !! those at wanted times. Underflow is abrupt meanwhile.
  subroutine simulate(method, system, first, n_steps, save_every, times, states, at_times, n_done, &
                      n_reached, t_reached, outcome, mesh)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    integer(i8), intent(in) :: first, n_steps, save_every
    !> Wanted times within these steps, ascending.
    real(wp), intent(in) :: times(:)
    !> (q_1, v_1, q_2, v_2, ...) after steps save_every, 2 save_every, ...,
    !! shape (2 n_dof, n_steps/save_every), or no columns at all to keep none;
    !! the same at the wanted times, as many as were reached.
    real(wp), intent(inout) :: states(:, :), at_times(:, :)
    !> Whole steps made; the state in `method` is that at t_reached, the end of the last
    !! step or where the motion stops inside the next.
    integer(i8), intent(out) :: n_done
    integer, intent(out) :: n_reached
    real(wp), intent(out) :: t_reached
    integer, intent(out) :: outcome
    !> Where steps end; without: equal ones.
    type(mesh_type), intent(in), optional :: mesh
    type(mesh_type) :: ends
    real(wp) :: q(size(method%q)), v(size(method%v)), now
    logical :: made, doubtful, lost
    integer(i8) :: i, column
    integer :: piece

    ! Numbers that fade below 1e-308 become 0 instead of subnormal, which would make each
    ! operation on them ten times as long; the mode is the caller's again on return.
    if (ieee_support_underflow_control(1.0_wp)) call ieee_set_underflow_mode(.false.)
    outcome = run_completed
    n_done = 0
    n_reached = 0
    ends = equal_steps(method%h)
    if (present(mesh)) ends = mesh
    piece = ends%piece_of(first)
    now = 0.0_wp
    if (first > 0) now = ends%time(piece, first)
    if (ends%is_broken()) call enter_piece(method, system, ends, piece, now)
    do i = 1, n_steps
      if (stop_wanted()) then
        outcome = run_stopped
        t_reached = now
        return
      end if
      if (first + i - 1 >= ends%made_by(piece)) then
        piece = piece + 1
        call enter_piece(method, system, ends, piece, now)
      end if
      if (system%timed) method%since = now - system%present_piece(1)
      call keep_between(method, system, now, times, n_reached, at_times, lost)
      q = method%q
      v = method%v
      call method%step(system, made)
      doubtful = .not. made
      if (made) doubtful = .not. in_range(method%q, method%v)
      if (system%limited .and. .not. doubtful) then
        doubtful = .not. method%least_margin(system, q, v) > 0.0_wp
      end if
      if (doubtful) then
        call judge_step(method, system, q, v, now, made, t_reached, outcome)
        if (outcome /= run_completed) then
          n_reached = min(n_reached, count(times <= t_reached))
          return
        end if
      end if
      if (lost) then
        ! The step is made, but not the part of it up to a wanted time.
        outcome = run_coarse
        t_reached = now
        method%q = q
        method%v = v
        return
      end if
      n_done = i
      now = ends%time(piece, first + i)
      if (mod(i, save_every) /= 0) cycle
      column = i/save_every
      if (column > size(states, 2)) cycle
      if (counting) call count_up(counted_states, 1)
      states(1::2, column) = method%q
      states(2::2, column) = method%v
    end do
    t_reached = now
    call keep_between(method, system, now, times, n_reached, at_times, lost)
  end subroutine simulate

  !> Steps of a piece of the mesh from now on; they are the same again if it was entered
  !! already.
  subroutine enter_piece(method, system, ends, piece, now)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    type(mesh_type), intent(in) :: ends
    integer, intent(in) :: piece
    real(wp), intent(in) :: now
    real(wp) :: from

    from = 0.0_wp
    if (piece > 1) from = ends%ends(piece - 1)
    call system%enter(from, ends%ends(piece))
    if (abs(method%h - ends%h(piece)) > 0.0_wp .or. abs(now - from) <= 0.0_wp) then
      call method%change_step(system, ends%h(piece))
    end if
  end subroutine enter_piece

  !> Whether a step from (q, v) that was not made, or comes near the edge of the physics,
  !! leads out; if so the state in `method` becomes that at the stop.
  subroutine judge_step(method, system, q, v, now, made, t_reached, outcome)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: q(:), v(:), now
    logical, intent(in) :: made
    real(wp), intent(out) :: t_reached
    integer, intent(out) :: outcome
    type(stop_type) :: stop
    logical :: sound

    call find_stop(system, size(q), 1, spread(system%drives, 1, n_lanes), q, v, now, method%h, stop)
    outcome = stop%outcome
    if (outcome == run_completed .or. outcome == run_coarse) then
      sound = made
      if (sound) sound = in_range(method%q, method%v)
      if (sound) sound = system%physical(method%q)
      outcome = merge(run_completed, run_coarse, sound)
      stop%ahead = 0.0_wp
      stop%q = q
      stop%v = v
    end if
    t_reached = now + stop%ahead
    if (outcome == run_completed) return
    method%q = stop%q
    method%v = stop%v
  end subroutine judge_step

  !> States at the wanted times from the present one up to the end of the step, or up to
  !! one that no step leads to: `lost`.
  subroutine keep_between(method, system, now, times, n_reached, at_times, lost)
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: now, times(:)
    integer, intent(inout) :: n_reached
    real(wp), intent(inout) :: at_times(:, :)
    logical, intent(out) :: lost
    real(wp) :: q(size(method%q)), v(size(method%v)), ahead
    type(stop_type) :: stop
    logical :: made

    lost = .false.
    do while (n_reached < size(times))
      ahead = times(n_reached + 1) - now
      if (ahead >= method%h*(1.0_wp - 4.0_wp*epsilon(1.0_wp))) return
      q = method%q
      v = method%v
      if (ahead > 4.0_wp*spacing(now)) then
        call method%look_ahead(system, ahead, q, v, made)
        if (made) made = in_range(q, v)
        if (.not. made) then
          call find_stop(system, size(q), 1, spread(system%drives, 1, n_lanes), method%q, &
                         method%v, now, ahead, stop)
          q = stop%q
          v = stop%v
          ! Where the motion stops before, the step will tell.
          lost = stop%outcome /= run_completed
          if (lost) return
        end if
      end if
      n_reached = n_reached + 1
      if (counting) call count_up(counted_states, 1)
      at_times(1::2, n_reached) = q
      at_times(2::2, n_reached) = v
    end do
  end subroutine keep_between

end module viscovib_simulate
