!> A run in fixed steps: what is kept of it, and how it ends.
module viscovib_simulate
  use, intrinsic :: ieee_arithmetic, only: ieee_set_underflow_mode, &
    ieee_support_underflow_control
  use viscovib_counters, only: count_up, counted_states, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: i8, wp
  use viscovib_stepper, only: stepper_type
  implicit none
  private

  public :: simulate

  !> All steps done; accelerations do not settle or overflow (step too large);
  !! the state left the system's physics.
  integer, parameter, public :: run_completed = 0, run_diverged = 1, run_unphysical = 2
  character(len=*), parameter, public :: run_names(0:2) = &
    [character(len=10) :: 'completed', 'diverged', 'unphysical']

contains

  !> Make steps first+1 ... first+n_steps, keeping every save_every-th state and
  !! those at wanted times. Underflow is abrupt meanwhile.
  subroutine simulate(method, system, first, n_steps, save_every, times, states, at_times, n_done, &
                      outcome)
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(in) :: system
    integer(i8), intent(in) :: first, n_steps, save_every
    !> Wanted times within these steps, ascending.
    real(wp), intent(in) :: times(:)
    !> (q_1, v_1, q_2, v_2, ...) after steps save_every, 2 save_every, ...,
    !! shape (2 n_dof, n_steps/save_every), or no columns at all to keep none;
    !! the same at the wanted times.
    real(wp), intent(inout) :: states(:, :), at_times(:, :)
    !> Steps made; the state in `method` is the one after them.
    integer(i8), intent(out) :: n_done
    integer, intent(out) :: outcome
    logical :: made
    integer(i8) :: i, column
    integer :: next

    ! Numbers that fade below 1e-308 become 0 instead of subnormal, which would make each
    ! operation on them ten times as long; the mode is the caller's again on return.
    if (ieee_support_underflow_control(1.0_wp)) call ieee_set_underflow_mode(.false.)
    outcome = run_completed
    n_done = 0
    next = 1
    do i = 1, n_steps
      call keep_between(method, system, (first + i - 1)*method%h, times, next, at_times)
      call method%step(system, made)
      if (.not. made) then
        ! A step may also fail because it leads out of the physics.
        outcome = merge(run_diverged, run_unphysical, &
                        system%physical(method%q + method%h*method%v))
        return
      end if
      n_done = i
      if (.not. system%physical(method%q)) then
        outcome = run_unphysical
        return
      end if
      if (mod(i, save_every) /= 0) cycle
      column = i/save_every
      if (column > size(states, 2)) cycle
      if (counting) call count_up(counted_states, 1)
      states(1::2, column) = method%q
      states(2::2, column) = method%v
    end do
    call keep_between(method, system, (first + n_steps)*method%h, times, next, at_times)
  end subroutine simulate

  !> States at the wanted times from the present one up to the end of the step.
  subroutine keep_between(method, system, now, times, next, at_times)
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: now, times(:)
    integer, intent(inout) :: next
    real(wp), intent(inout) :: at_times(:, :)
    real(wp) :: q(size(method%q)), v(size(method%q)), ahead
    logical :: made

    do while (next <= size(times))
      ahead = times(next) - now
      if (ahead >= method%h*(1.0_wp - 4.0_wp*epsilon(1.0_wp))) return
      made = .true.
      if (ahead > 4.0_wp*spacing(now)) then
        call method%look_ahead(system, ahead, q, v, made)
      else
        q = method%q
        v = method%v
      end if
      if (.not. made) return
      if (counting) call count_up(counted_states, 1)
      at_times(1::2, next) = q
      at_times(2::2, next) = v
      next = next + 1
    end do
  end subroutine keep_between

end module viscovib_simulate
