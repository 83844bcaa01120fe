! Optimize: -O1
!> A motion of an ensemble that is computed by itself: its last state, and what is gathered along
!! it. Motions with kinks, hysteresis, memory or surfaces end their steps at different times. So
!! they cannot be computed together in lanes.
module viscovib_single_run
  use viscovib_gathered, only: gathered_type, single_request
  use viscovib_kinds, only: i8, wp
  use viscovib_motion_piece, only: as_before
  use viscovib_motion_request, only: transient_job
  use viscovib_piece_runs, only: piece_runs, shared_type
  use viscovib_status, only: set_ok, status_type
  use viscovib_time_run, only: run_completed
  use viscovib_trajectory, only: trajectory_type
  use viscovib_watch, only: n_event_rows
  implicit none
  private

  public :: single_run

  !> Largest number of samples in memory.
  integer(i8), parameter :: most_held = 100000_i8

  !> A run that can be continued.
  type :: single_run
    !> With equations and rows; its first piece holds the steps before.
    type(piece_runs) :: runs
    !> State and data after these steps.
    real(wp), allocatable :: state(:), memory(:)
    !> Kinds of the numbers of the data, if its first piece requests them.
    integer, allocatable :: marks(:)
  contains
    procedure :: begin
    procedure :: advance
    procedure :: gather
  end type single_run

contains

  !> Start a run from the start of its first piece.
  subroutine begin(self, shared)
    class(single_run), intent(inout) :: self
    type(shared_type), intent(inout), target :: shared
    self%runs%counts = .true.
    self%state = self%runs%first%initial
    self%runs%begun = self%state
    allocate (self%memory(0))
    call self%runs%begin(shared)
  end subroutine begin

  !> Make n steps; keep every `every`-th state, 0: the last one.
  subroutine advance(self, n, every, run, status)
    class(single_run), intent(inout), target :: self
    integer(i8), intent(in) :: n, every
    type(trajectory_type), intent(out) :: run
    type(status_type), intent(out) :: status
    type(transient_job) :: job
    real(wp) :: none(n_event_rows, 0)
    integer :: i

    associate (first => self%runs%first)
      first%initial => self%state
      first%memory => self%memory
      self%runs%last_only = every == 0
      self%runs%t_end = real(first%first + n, wp)*first%h
      job%dt = first%h
      job%save_every = int(min(max(every, 1_i8), int(huge(1), i8)))
      call self%runs%make(job, n, 1, 1, run, status)
      if (status%failed()) return
      self%state = run%last
      if (allocated(run%memory)) call move_alloc(run%memory, self%memory)
      if (allocated(run%kinds)) call move_alloc(run%kinds, self%marks)
      first%first = run%n_steps
      first%resume = as_before
      first%shortest = run%shortest
      if (allocated(run%watch)) call run%watch%hand_over(first%sides, none, i)
    end associate
  end subroutine advance

  !> Make the whole run.
  subroutine gather(self, request, found, status)
    class(single_run), intent(inout) :: self
    type(single_request), intent(in) :: request
    type(gathered_type), intent(out) :: found
    type(status_type), intent(out) :: status
    type(trajectory_type) :: run
    integer(i8) :: done, every, n, stride

    call set_ok(status)
    stride = request%stride()
    call found%begin(request, size(self%runs%rows))
    done = 0
    do while (done < request%n_steps)
      n = request%n_discard - done
      every = 0
      if (n <= 0) then
        n = request%n_steps - done
        if (stride > 0 .and. n >= stride) then
          every = stride
          n = min(n/stride, max(1_i8, most_held/stride))*stride
        end if
      end if
      call self%advance(n, every, run, status)
      if (status%failed()) return
      if (every > 0) call found%add_states(request, self%runs%first%h, run%states(:, 2:))
      if (allocated(run%watch)) call found%add_watched(request, self%runs%rows, run%watch)
      done = done + n
      if (run%outcome /= run_completed) exit
    end do
    allocate (found%state, source=self%state(self%runs%rows))
    found%ended = run%outcome
    found%t_reached = run%t_reached
    call found%finish(request, self%runs%first%h)
  end subroutine gather

end module viscovib_single_run
