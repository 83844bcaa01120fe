! Optimize: -O2 -fvect-cost-model=dynamic
!> A run in fixed steps, for any kind of motion: the states that it keeps, and its outcome.
module viscovib_time_run
  use viscovib_counters, only: count_up, counted_states, counting
  use viscovib_kinds, only: i8, wp
  use viscovib_mesh, only: equal_steps, mesh_type
  use viscovib_stopping, only: begin_piece, stop_wanted
  use viscovib_subnormals, only: flushing_type
  use viscovib_watch, only: watch_type
  implicit none
  private

  public :: make_run, put_state, run_motion, time_run

  !> Outcome of a run: all steps done; a coordinate or velocity leaves the range of
  !! numbers; the state leaves the physical range; time limit reached; the motion
  !! continues, but the steps of the run are too large for it; an event ends the run.
  integer, parameter, public :: run_completed = 0, run_diverged = 1, run_unphysical = 2, &
                                run_stopped = 3, run_coarse = 4, run_event = 5
  character(len=*), parameter, public :: run_names(0:5) = &
    [character(len=14) :: 'completed', 'diverged', 'unphysical', 'stopped', 'step too large', &
     'event']

  !> Number of steps after which progress is reported.
  integer(i8), parameter :: steps_of_piece = 1024_i8

  type :: time_run
    !> Number of steps before, number of steps to make, and steps between states that are kept.
    integer(i8) :: first = 0, n_steps = 0, save_every = 1
    !> Ends of steps.
    type(mesh_type) :: mesh
    !> Requested times within these steps, ascending.
    real(wp), allocatable :: times(:)
    !> Coordinates that are computed; the others stay 0. Not allocated: all of them.
    integer, allocatable :: dofs(:)
    !> States of the body, (q_1, v_1, q_2, v_2, ...), after steps save_every, 2 save_every, ...,
    !! or no columns to keep none; the same at the requested times, as many as were reached.
    real(wp), allocatable :: states(:, :), at_times(:, :)
    !> Accelerations at these times, relative to the base, then forces of laws, shape
    !! (n_dof - n_hidden + n_laws, size(times)); not allocated: not requested.
    real(wp), allocatable :: accelerations(:, :)
    !> Events to look for; not allocated: none.
    type(watch_type), allocatable :: watch
    !> Number of whole steps, and of requested times that were reached.
    integer(i8) :: n_done = 0
    integer :: n_reached = 0
    !> Outcome, and its time: the end of the last step, or the stop inside the next.
    integer :: ended = run_completed
    real(wp) :: t_reached = 0.0_wp
    !> True if the motion up to a requested time could not be computed.
    logical :: lost = .false.
  contains
    procedure :: allocate_states
    procedure :: wants_state
    procedure :: keep_wanted
  end type time_run

  !> A motion that a run advances.
  type, abstract :: run_motion
  contains
    procedure(begin_interface), deferred :: begin
    procedure(enter_interface), deferred :: enter
    procedure(advance_interface), deferred :: advance
    procedure(store_interface), deferred :: store
  end type run_motion

  abstract interface

    !> Prepare the first step, at time `run%t_reached` in a piece of the mesh.
    subroutine begin_interface(self, run, piece)
      import :: run_motion, time_run
      class(run_motion), intent(inout) :: self
      class(time_run), intent(inout) :: run
      integer, intent(in) :: piece
    end subroutine begin_interface

    !> Begin the next piece of the mesh, at time `run%t_reached`.
    subroutine enter_interface(self, run, piece)
      import :: run_motion, time_run
      class(run_motion), intent(inout) :: self
      class(time_run), intent(in) :: run
      integer, intent(in) :: piece
    end subroutine enter_interface

    !> Make the step from time `run%t_reached` to `until`. If the motion ends in it, `run%ended`
    !! becomes the outcome, and the motion is at `run%t_reached`.
    subroutine advance_interface(self, run, piece, until)
      import :: run_motion, time_run, wp
      class(run_motion), intent(inout) :: self
      class(time_run), intent(inout), target :: run
      integer, intent(in) :: piece
      real(wp), intent(in) :: until
    end subroutine advance_interface

    !> Store the state of the body at the present time t, by `put_state`.
    subroutine store_interface(self, t, state, dofs)
      import :: run_motion, wp
      class(run_motion), intent(inout) :: self
      real(wp), intent(in) :: t
      real(wp), intent(inout) :: state(:)
      integer, intent(in), optional :: dofs(:)
    end subroutine store_interface

  end interface

contains

  !> Make steps first+1 ... first+n_steps. Subnormal numbers are flushed to zero.
  subroutine make_run(motion, run)
    class(run_motion), intent(inout) :: motion
    class(time_run), intent(inout), target :: run
    type(flushing_type) :: flushing
    real(wp) :: until
    integer(i8) :: i, k
    integer :: piece

    call flushing%begin()
    run%ended = run_completed
    run%n_done = 0
    run%n_reached = 0
    run%lost = .false.
    if (allocated(run%dofs)) run%states = 0.0_wp
    piece = run%mesh%piece_of(run%first)
    run%t_reached = run%mesh%start_of(run%first)
    call motion%begin(run, piece)
    do i = 1, run%n_steps
      if (stop_wanted()) then
        run%ended = run_stopped
        return
      end if
      if (mod(i, steps_of_piece) == 0) call begin_piece()
      k = run%first + i - 1
      if (k >= run%mesh%made_by(piece)) then
        piece = piece + 1
        call motion%enter(run, piece)
      end if
      until = run%mesh%time(piece, k + 1)
      call motion%advance(run, piece, until)
      if (run%ended /= run_completed) exit
      run%n_done = i
      run%t_reached = until
      if (mod(i, run%save_every) /= 0 .or. i/run%save_every > size(run%states, 2)) cycle
      call motion%store(run%t_reached, run%states(:, i/run%save_every), run%dofs)
    end do
    if (run%ended == run_completed .or. run%ended == run_stopped) return
    ! Small steps may locate the stop before the last of the steps made.
    run%n_reached = min(run%n_reached, count(run%times <= run%t_reached))
    run%at_times(:, run%n_reached + 1:) = 0.0_wp
    run%n_done = run%mesh%made_until(piece, run%first, run%n_done, run%t_reached)
    if (allocated(run%watch)) call run%watch%drop_after(run%t_reached)
  end subroutine make_run

  !> Allocate kept states of n numbers, this many of them; equal steps h unless there is a mesh.
  subroutine allocate_states(self, n, columns, h)
    class(time_run), intent(inout) :: self
    integer, intent(in) :: n, columns
    real(wp), intent(in) :: h
    if (.not. allocated(self%mesh%ends)) self%mesh = equal_steps(h)
    if (.not. allocated(self%times)) allocate (self%times(0))
    allocate (self%states(n, columns))
    allocate (self%at_times(n, size(self%times)), source=0.0_wp)
  end subroutine allocate_states

  !> True if the next state is requested in a step from a time on.
  pure logical function wants_state(self, from, h)
    class(time_run), intent(in) :: self
    real(wp), intent(in) :: from, h
    wants_state = .false.
    if (self%n_reached < size(self%times)) wants_state = self%times(self%n_reached + 1) < from + h
  end function wants_state

  !> Store the state of a body, of which only the coordinates `dofs` are computed, if present.
  subroutine put_state(q, v, state, dofs)
    real(wp), intent(in) :: q(:), v(:)
    real(wp), intent(inout) :: state(:)
    integer, intent(in), optional :: dofs(:)
    integer :: n
    if (counting) call count_up(counted_states, 1)
    if (present(dofs)) then
      n = size(dofs)
      state(2*dofs - 1) = q(:n)
      state(2*dofs) = v(:n)
    else
      n = size(state)/2
      state(1::2) = q(:n)
      state(2::2) = v(:n)
    end if
  end subroutine put_state

  !> Store the state of the body at the next requested time.
  subroutine keep_wanted(self, q, v)
    class(time_run), intent(inout) :: self
    real(wp), intent(in) :: q(:), v(:)
    self%n_reached = self%n_reached + 1
    call put_state(q, v, self%at_times(:, self%n_reached), self%dofs)
  end subroutine keep_wanted

end module viscovib_time_run
