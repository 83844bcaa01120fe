!> A run in fixed steps: what is kept of it, and how it ends.
module viscovib_simulate
  use viscovib_driven_system, only: driven_system_type
  use viscovib_gauss, only: gauss_type
  use viscovib_kinds, only: i8, wp
  implicit none
  private

  public :: simulate

  !> All steps done; accelerations do not settle or overflow (step too large);
  !! the state left the system's physics.
  integer, parameter, public :: run_completed = 0, run_diverged = 1, run_unphysical = 2

contains

  !> Make n_steps steps, keeping every save_every-th state.
  subroutine simulate(method, system, n_steps, save_every, states, n_done, outcome)
    type(gauss_type), intent(inout) :: method
    class(driven_system_type), intent(in) :: system
    integer(i8), intent(in) :: n_steps, save_every
    !> (q_1, v_1, q_2, v_2, ...) after steps save_every, 2 save_every, ...,
    !! shape (2 n_dof, n_steps/save_every), or no columns at all to keep none.
    real(wp), intent(inout) :: states(:, :)
    !> Steps made; the state in `method` is the one after them.
    integer(i8), intent(out) :: n_done
    integer, intent(out) :: outcome
    logical :: converged
    integer(i8) :: i, column

    outcome = run_completed
    n_done = 0
    do i = 1, n_steps
      call method%step(system, converged)
      if (.not. converged) then
        outcome = run_diverged
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
      states(1::2, column) = method%q
      states(2::2, column) = method%v
    end do
  end subroutine simulate

end module viscovib_simulate
