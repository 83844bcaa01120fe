!> Detection of the end of a motion with memory: a failed step is repeated with small steps
!! of the same method, each compared with two half steps.
!!
!! The memory must be accurate for lags as short as these steps; a sum of
!! exponentials that was not fitted for them causes an additional error.
module viscovib_hereditary_stops
  use, intrinsic :: ieee_arithmetic, only: ieee_all, ieee_get_halting_mode, ieee_set_flag, &
    ieee_set_halting_mode
  use viscovib_kinds, only: i8, wp
  use viscovib_march, only: march_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_time_load, only: time_load_type
  use viscovib_time_run, only: run_coarse, run_diverged
  implicit none
  private

  public :: stop_hereditary, hereditary_past

  !> Steps between two stored states; number of steps after the present one within which the
  !! predicted stop must occur, as in `run_history`.
  integer, parameter :: stride = 32
  real(wp), parameter :: beyond = 8.0_wp

  !> Allowed difference of a step and two half steps, relative to the state.
  real(wp), parameter :: closeness = 1.0e-11_wp
  !> A motion that no step follows has escaped if it exceeds the largest earlier displacement
  !! by this factor.
  real(wp), parameter :: far = 1.0e3_wp
  !> Small steps after which a step of the run counts as too large.
  integer, parameter :: max_steps = 2000

  !> The data needed to continue, and the state.
  type :: scout_type
    real(wp) :: ahead = 0.0_wp
    real(wp), allocatable :: memory(:), u(:), v(:)
  end type scout_type

  !> The data needed to continue from two earlier times, the older first: near an escape the steps
  !! of a run have the same relative error at every scale, unlike small steps from earlier states.
  type :: hereditary_past
    integer :: n_steps = 0, n_kept = 0
    real(wp) :: t(2) = 0.0_wp
    integer(i8) :: n_before(2) = 0
    type(scout_type) :: at(2)
  contains
    procedure :: note
    procedure :: forget
    procedure :: confirm
  end type hereditary_past

contains

  !> Store the state every `stride` steps; `n_before`: number of steps so far.
  subroutine note(self, run, t, n_before)
    class(hereditary_past), intent(inout) :: self
    class(march_type), intent(in) :: run
    real(wp), intent(in) :: t
    integer(i8), intent(in) :: n_before
    self%n_steps = self%n_steps + 1
    if (mod(self%n_steps, stride) /= 1) return
    if (self%n_kept == 2) then
      self%t(1) = self%t(2)
      self%n_before(1) = self%n_before(2)
      call move_alloc(self%at(2)%memory, self%at(1)%memory)
      self%n_kept = 1
    end if
    self%n_kept = self%n_kept + 1
    self%t(self%n_kept) = t
    self%n_before(self%n_kept) = n_before
    self%at(self%n_kept)%memory = run%save_memory()
  end subroutine note

  !> Discard the stored states: from here on the equations are different.
  subroutine forget(self)
    class(hereditary_past), intent(inout) :: self
    self%n_steps = 0
    self%n_kept = 0
  end subroutine forget

  !> Search the stop of a failed step by small steps from the older stored state. The run is set to
  !! the stop if it is found, and is otherwise unchanged.
  subroutine confirm(self, run, system, load, until, h, t_reached, outcome)
    class(hereditary_past), intent(in) :: self
    class(march_type), intent(inout) :: run
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    !> End of the present piece of time; length of the steps.
    real(wp), intent(in) :: until, h
    real(wp), intent(inout) :: t_reached
    integer, intent(inout) :: outcome
    type(scout_type) :: here
    real(wp) :: t
    integer :: found

    if (self%n_kept == 0) return
    here%memory = run%save_memory()
    call run%load_memory(self%at(1)%memory, .false.)
    call stop_hereditary(run, system, load, self%n_before(1), self%t(1), &
                         min(until, t_reached + (1.0_wp + beyond)*h), t, found)
    if (found == run_diverged) then
      t_reached = t
      outcome = found
    else
      call run%load_memory(here%memory, .false.)
    end if
  end subroutine confirm

  !> Outcome of the step that failed. The run is set to the stop, or to the
  !! start of the step if the motion does not stop.
  subroutine stop_hereditary(run, system, load, n_before, start, until, t_reached, outcome)
    class(march_type), intent(inout) :: run
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    !> Number of steps before; start and end of this one.
    integer(i8), intent(in) :: n_before
    real(wp), intent(in) :: start, until
    real(wp), intent(out) :: t_reached
    integer, intent(out) :: outcome
    type(scout_type) :: begin, at
    logical :: halting(size(ieee_all))

    call run%sharpen()
    begin%memory = run%save_memory()
    call run%get_state(begin%u, begin%v)
    ! Steps that are too large may overflow; the result shows it.
    call ieee_get_halting_mode(ieee_all, halting)
    call ieee_set_halting_mode(ieee_all, .false.)
    at = begin
    call march(run, system, load, n_before, start, until - start, at, outcome)
    call ieee_set_flag(ieee_all, .false.)
    call ieee_set_halting_mode(ieee_all, halting)
    if (outcome == run_coarse) at = begin
    call run%load_memory(at%memory, .false.)
    t_reached = start + at%ahead
  end subroutine stop_hereditary

  !> Small steps up to h or to the stop; returns the last state before it.
  subroutine march(run, system, load, n_before, start, h, at, outcome)
    class(march_type), intent(inout) :: run
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    integer(i8), intent(in) :: n_before
    real(wp), intent(in) :: start, h
    type(scout_type), intent(inout) :: at
    integer, intent(out) :: outcome
    type(scout_type) :: whole, half, rest, double
    real(wp) :: s, shortest, scale_of_motion
    logical :: made
    integer :: i

    outcome = run_coarse
    s = 0.5_wp*h
    scale_of_motion = max(maxval(abs(at%u)), run%furthest())
    shortest = 4.0_wp*spacing(abs(start) + h)
    do i = 1, max_steps
      s = min(s, h - at%ahead)
      if (s <= shortest) then
        if (h - at%ahead > shortest .and. maxval(abs(at%u)) > far*scale_of_motion) then
          outcome = run_diverged
        end if
        return
      end if
      call advance(at, s, whole, made)
      if (made) call advance(at, 0.5_wp*s, half, made)
      if (made .and. n_before == 0 .and. .not. at%ahead > 0.0_wp) then
        ! The second half of a first step ends like a first step: it is split in two.
        call advance(half, 0.25_wp*s, rest, made)
        if (made) call advance(rest, 0.25_wp*s, double, made)
      else if (made) then
        call advance(half, 0.5_wp*s, double, made)
      end if
      if (made) made = alike(whole, double, s)
      if (made) then
        at = double
        s = 2.0_wp*s
      else
        s = 0.5_wp*s
      end if
    end do

  contains

    subroutine advance(from, length, to, made)
      type(scout_type), intent(in) :: from
      real(wp), intent(in) :: length
      type(scout_type), intent(out) :: to
      logical, intent(out) :: made
      integer(i8) :: before
      before = n_before
      if (from%ahead > 0.0_wp) before = before + 1
      call run%load_memory(from%memory, .false.)
      call run%change_step(system, load, start + from%ahead, length, made)
      if (made) call run%step(system, load, before, start + from%ahead + length, made)
      to%ahead = from%ahead + length
      call run%get_state(to%u, to%v)
      to%memory = run%save_memory()
    end subroutine advance

  end subroutine march

  !> True if two ends of a step agree.
  pure logical function alike(one, other, s)
    type(scout_type), intent(in) :: one, other
    real(wp), intent(in) :: s
    real(wp) :: size_of
    size_of = maxval(abs(other%u)) + s*maxval(abs(other%v))
    ! Test each number: a maximum skips NaN.
    alike = all(abs(one%u - other%u) <= closeness*size_of) &
            .and. all(s*abs(one%v - other%v) <= closeness*size_of)
  end function alike

end module viscovib_hereditary_stops
