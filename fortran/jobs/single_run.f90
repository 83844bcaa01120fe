! Optimize: -O1
!> A motion of an ensemble that is computed by itself: its last state, and what is gathered along
!! it. Motions with kinks, hysteresis, memory or surfaces end their steps at different times. So
!! they cannot be computed together in lanes.
module viscovib_single_run
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
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

  public :: gathered_type, single_request, single_run

  !> Largest number of samples in memory.
  integer(i8), parameter :: most_held = 100000_i8

  !> What is gathered along a motion, in steps.
  type :: single_request
    integer(i8) :: n_steps = 0, n_discard = 0
    !> Steps between samples for amplitudes, and between the points of a section; 0: none.
    integer(i8) :: sample_every = 1, section_every = 0
    !> Frequencies of amplitudes (rad per unit of time).
    real(wp), allocatable :: lines(:)
    !> Peaks and means of the motion from the time `since`; events count from the time `late`.
    logical :: moments = .false.
    real(wp) :: since = 0.0_wp, late = 0.0_wp
  contains
    procedure, private :: stride
  end type single_request

  !> Results, of the rows of states that are kept.
  type :: gathered_type
    real(wp), allocatable :: state(:), peak(:), mean(:), rms(:)
    integer :: ended = run_completed
    real(wp) :: t_reached = 0.0_wp
    !> NaN for a motion that ended early, shape (w/2, size(lines)).
    complex(wp), allocatable :: amplitudes(:, :)
    !> Points of the section that the motion reached, or its events, with their times.
    real(wp), allocatable :: sections(:, :), times(:)
    !> Sums for amplitudes: of windowed waves with and without the motion, and of the window.
    complex(wp), allocatable, private :: waves(:, :), empty(:)
    real(wp), allocatable, private :: sums(:)
    real(wp), private :: weight = 0.0_wp
    !> Numbers of steps and of samples so far.
    integer(i8), private :: steps = 0, n_samples = 0
  contains
    procedure, private :: add_states
    procedure, private :: add_watched
    procedure, private :: find_amplitudes
  end type gathered_type

  !> A run that can be continued.
  type :: single_run
    !> With equations and rows; its first piece holds the steps before.
    type(piece_runs) :: runs
    !> State and data after these steps.
    real(wp), allocatable :: state(:), memory(:)
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
    integer :: w

    call set_ok(status)
    w = size(self%runs%rows)
    stride = request%stride()
    allocate (found%peak(w), found%mean(w), found%rms(w), found%sums(w/2), source=0.0_wp)
    allocate (found%empty(size(request%lines)), found%waves(w/2, size(request%lines)), &
              source=(0.0_wp, 0.0_wp))
    n = 0
    if (request%section_every > 0) n = (request%n_steps - request%n_discard)/request%section_every
    allocate (found%sections(w, n), found%times(0))
    found%sections = ieee_value(0.0_wp, ieee_quiet_nan)
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
      if (allocated(run%watch)) call found%add_watched(request, self%runs%rows, run)
      done = done + n
      if (run%outcome /= run_completed) exit
    end do
    allocate (found%state, source=self%state(self%runs%rows))
    found%ended = run%outcome
    found%t_reached = run%t_reached
    associate (length => self%runs%first%h*request%n_steps - request%since)
      found%mean = found%mean/length
      found%rms = sqrt(found%rms/length)
    end associate
    call found%find_amplitudes()
  end subroutine gather

  !> Steps between the states that are needed on the way; 0: none.
  pure integer(i8) function stride(self)
    class(single_request), intent(in) :: self
    integer(i8) :: other, remainder
    stride = merge(self%sample_every, 0_i8, size(self%lines) > 0)
    other = self%section_every
    do while (other > 0)
      remainder = modulo(stride, other)
      stride = other
      other = remainder
    end do
  end function stride

  !> Add states at the distance of a stride. Amplitudes have a Hann window that is 0 one sample
  !! before the first and one after the last.
  subroutine add_states(self, request, h, states)
    class(gathered_type), intent(inout) :: self
    type(single_request), intent(in) :: request
    real(wp), intent(in) :: h, states(:, :)
    integer(i8) :: n
    integer :: j, k
    real(wp) :: window, t
    complex(wp) :: wave

    n = (request%n_steps - request%n_discard)/request%sample_every
    do k = 1, size(states, 2)
      self%steps = self%steps + request%stride()
      if (request%section_every > 0) then
        if (modulo(self%steps, request%section_every) == 0) then
          self%sections(:, int(self%steps/request%section_every)) = states(:, k)
        end if
      end if
      if (size(request%lines) == 0 .or. modulo(self%steps, request%sample_every) /= 0) cycle
      self%n_samples = self%n_samples + 1
      window = sin(pi*self%n_samples/real(n + 1, wp))**2
      t = h*(request%n_discard + request%sample_every*self%n_samples)
      do j = 1, size(request%lines)
        wave = window*exp(cmplx(0.0_wp, -t*request%lines(j), wp))
        self%waves(:, j) = self%waves(:, j) + states(1::2, k)*wave
        self%empty(j) = self%empty(j) + wave
      end do
      self%sums = self%sums + window*states(1::2, k)
      self%weight = self%weight + window
    end do
  end subroutine add_states

  !> Add peaks and integrals, and the events that count.
  subroutine add_watched(self, request, rows, run)
    class(gathered_type), intent(inout) :: self
    type(single_request), intent(in) :: request
    integer, intent(in) :: rows(:)
    type(trajectory_type), intent(in) :: run
    real(wp), allocatable :: sections(:, :)
    logical, allocatable :: counts(:)
    integer :: i, n

    associate (watch => run%watch)
      if (allocated(watch%extremes%peak)) then
        self%peak = max(self%peak, watch%extremes%peak(rows))
        self%mean = self%mean + watch%extremes%total(rows)
        self%rms = self%rms + watch%extremes%squares(rows)
      end if
      counts = watch%times(:watch%n_found) >= request%late
      n = size(self%times)
      if (.not. any(counts)) return
      self%times = [self%times, pack(watch%times(:watch%n_found), counts)]
      allocate (sections(size(rows), size(self%times)))
      sections(:, :n) = self%sections
      do i = 1, size(counts)
        if (.not. counts(i)) cycle
        n = n + 1
        sections(:, n) = watch%states(rows, i)
      end do
      call move_alloc(sections, self%sections)
    end associate
  end subroutine add_watched

  subroutine find_amplitudes(self)
    class(gathered_type), intent(inout) :: self
    real(wp) :: mean(size(self%sums)), unset
    integer :: j

    unset = ieee_value(unset, ieee_quiet_nan)
    allocate (self%amplitudes(size(self%waves, 1), size(self%waves, 2)), &
              source=cmplx(unset, unset, wp))
    if (self%n_samples == 0 .or. self%ended /= run_completed) return
    mean = self%sums/self%weight
    do j = 1, size(self%empty)
      self%amplitudes(:, j) = 2.0_wp*(self%waves(:, j) - mean*self%empty(j))/self%weight
    end do
  end subroutine find_amplitudes

end module viscovib_single_run
