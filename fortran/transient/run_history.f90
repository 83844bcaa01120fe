! Optimize: -O1
!> Stored states of a run, from which its stop is confirmed.
!!
!! Near a time T at which a motion diverges it is self-similar: steps of length h
!! at distances of a few h from T have a relative error that does not decrease with h, and the
!! predicted T has an error proportional to h. From a state `stride` steps before, small steps find
!! a T whose error decreases with the order of the method.
module viscovib_run_history
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_march, only: march_type
  use viscovib_stops, only: find_stop, find_stop_of_march, stop_type
  use viscovib_time_run, only: run_coarse, run_completed, run_diverged
  implicit none
  private

  public :: run_history

  !> Steps between two stored states.
  integer, parameter :: stride = 32
  !> Number of steps after the present one within which the predicted stop must occur.
  real(wp), parameter :: beyond = 8.0_wp

  !> Coordinates and then velocities, each for a number of lanes, or the memory of a run, which may
  !! grow.
  type :: stored_state
    real(wp), allocatable :: x(:)
  end type stored_state

  !> The last two states, the older first.
  type :: run_history
    !> Steps since the last stored state, and number of stored states.
    integer :: n_steps = 0, n_kept = 0
    !> Times, in any unit, and states.
    real(wp) :: t(2) = 0.0_wp
    type(stored_state) :: at(2)
  contains
    procedure :: is_due
    procedure :: note
    procedure :: forget
    procedure :: confirm
    procedure :: confirm_march
  end type run_history

contains

  !> Count a step; true if the state at its start is to be stored.
  logical function is_due(self)
    class(run_history), intent(inout) :: self
    is_due = self%n_steps == 0
    self%n_steps = self%n_steps + 1
    if (self%n_steps == stride) self%n_steps = 0
  end function is_due

  !> Store a state.
  subroutine note(self, t, state)
    class(run_history), intent(inout) :: self
    real(wp), intent(in) :: t, state(:)
    if (self%n_kept == 2) then
      self%t(1) = self%t(2)
      call move_alloc(self%at(2)%x, self%at(1)%x)
      self%n_kept = 1
    end if
    self%n_kept = self%n_kept + 1
    self%t(self%n_kept) = t
    self%at(self%n_kept)%x = state
  end subroutine note

  !> Discard the stored states: from here on the equations are different.
  subroutine forget(self)
    class(run_history), intent(inout) :: self
    self%n_steps = 0
    self%n_kept = 0
  end subroutine forget

  !> Outcome of a motion that seems to stop in the step after `from`, or whose step there
  !! fails: by small steps from the older state. Only a stop that they find is accepted.
  subroutine confirm(self, system, lanes, n, lane, frequencies, unit, from, h, stop)
    class(run_history), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    !> Number of lanes of the stored states; the other arguments as in `find_stop`.
    integer, intent(in) :: lanes, n, lane
    !> Unit of the stored times.
    real(wp), intent(in) :: frequencies(:, :), unit
    real(wp), intent(in) :: from, h
    !> On entry by small steps from `from`; `ahead` is the time from there, also on return.
    type(stop_type), intent(inout) :: stop
    type(stop_type) :: other
    real(wp) :: begin, until
    integer :: half

    if (self%n_kept == 0) return
    begin = self%t(1)*unit
    until = from + (1.0_wp + beyond)*h
    if (system%timed) until = min(until, max(system%present_piece(2), from + h))
    half = size(self%at(1)%x)/2
    call find_stop(system, n, lane, frequencies, self%at(1)%x(lane:lanes*n:lanes), &
                   self%at(1)%x(half + lane:half + lanes*n:lanes), begin, until - begin, other)
    if (other%outcome == run_coarse) return
    if (other%outcome == run_completed) then
      stop%outcome = run_coarse
      return
    end if
    stop = other
    stop%ahead = (begin - from) + other%ahead
  end subroutine confirm

  !> The same of a run with memory, in steps h of a piece of time that ends at `end`. The run is set
  !! to the stop if it is found, and is otherwise unchanged.
  subroutine confirm_march(self, march, end, from, h, stop)
    class(run_history), intent(in) :: self
    class(march_type), intent(inout) :: march
    real(wp), intent(in) :: end, from, h
    type(stop_type), intent(inout) :: stop
    type(stop_type) :: other
    real(wp) :: memory(march%memory_size()), until

    if (self%n_kept == 0) return
    memory = march%save_memory()
    call march%load_memory(self%at(1)%x, .false.)
    until = min(end, from + stop%ahead + (1.0_wp + beyond)*h)
    call find_stop_of_march(march, self%t(1), until - self%t(1), other)
    if (other%outcome == run_diverged) then
      stop = other
      stop%ahead = (self%t(1) - from) + other%ahead
    else
      call march%load_memory(memory, .false.)
    end if
  end subroutine confirm_march

end module viscovib_run_history
