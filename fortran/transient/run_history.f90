!> States that a run has left behind, from which its stop is confirmed.
!!
!! Near a time T at which a motion runs away it looks the same at every scale: steps of length h
!! at distances of a few h from T are wrong by a part that does not fall with h, and so is the T
!! that they lead to, by a part of h. From a state `stride` steps before, small steps lead to
!! the T of that state, whose distance from the true one falls with the order of the method.
module viscovib_run_history
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_stops, only: find_stop, run_coarse, run_completed, stop_type
  implicit none
  private

  public :: run_history

  !> Steps between two states that are remembered.
  integer, parameter :: stride = 32
  !> Steps beyond the present one within which a stop that it seems to lead to must be.
  real(wp), parameter :: beyond = 8.0_wp

  !> The last two states, the older first: of every lane.
  type :: run_history
    !> Steps since it began, and states remembered.
    integer :: n_steps = 0, n_kept = 0
    !> Times, in whatever unit; states, shape (lanes, coordinates, 2).
    real(wp) :: t(2) = 0.0_wp
    real(wp), allocatable :: q(:, :, :), v(:, :, :)
  contains
    procedure :: is_due
    procedure :: note
    procedure :: forget
    procedure :: confirm
  end type run_history

contains

  !> Count a step; whether the state it begins at is to be remembered.
  logical function is_due(self)
    class(run_history), intent(inout) :: self
    is_due = self%n_steps == 0
    self%n_steps = self%n_steps + 1
    if (self%n_steps == stride) self%n_steps = 0
  end function is_due

  !> Remember a state.
  subroutine note(self, t, q, v)
    class(run_history), intent(inout) :: self
    real(wp), intent(in) :: t
    !> Shape (lanes, coordinates).
    real(wp), intent(in) :: q(:, :), v(:, :)
    if (.not. allocated(self%q)) then
      allocate (self%q(size(q, 1), size(q, 2), 2), self%v(size(q, 1), size(q, 2), 2))
    end if
    if (self%n_kept == 2) then
      self%t(1) = self%t(2)
      self%q(:, :, 1) = self%q(:, :, 2)
      self%v(:, :, 1) = self%v(:, :, 2)
      self%n_kept = 1
    end if
    self%n_kept = self%n_kept + 1
    self%t(self%n_kept) = t
    self%q(:, :, self%n_kept) = q
    self%v(:, :, self%n_kept) = v
  end subroutine note

  !> What was before does not lead here by the equations as they are now.
  subroutine forget(self)
    class(run_history), intent(inout) :: self
    self%n_steps = 0
    self%n_kept = 0
  end subroutine forget

  !> How a motion ends that seems to stop in the step from `from` on, or whose step there cannot
  !! be made: by small steps from the older state. A stop that they do not find is not one.
  subroutine confirm(self, system, row, n, lane, frequencies, unit, from, h, stop)
    class(run_history), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    !> Lane of the states remembered; what follows as of `find_stop`.
    integer, intent(in) :: row, n, lane
    !> Unit of the times remembered.
    real(wp), intent(in) :: frequencies(:, :), unit
    real(wp), intent(in) :: from, h
    !> By small steps from `from`; `ahead` from there, also in return.
    type(stop_type), intent(inout) :: stop
    type(stop_type) :: other
    real(wp) :: begin, until

    if (self%n_kept == 0) return
    begin = self%t(1)*unit
    until = from + (1.0_wp + beyond)*h
    if (system%timed) until = min(until, max(system%present_piece(2), from + h))
    call find_stop(system, n, lane, frequencies, self%q(row, :n, 1), self%v(row, :n, 1), begin, &
                   until - begin, other)
    if (other%outcome == run_coarse) return
    if (other%outcome == run_completed) then
      stop%outcome = run_coarse
      return
    end if
    stop = other
    stop%ahead = (begin - from) + other%ahead
  end subroutine confirm

end module viscovib_run_history
