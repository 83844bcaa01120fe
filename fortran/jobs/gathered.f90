! Optimize: -O1
!> What is gathered along a motion instead of its states: peaks and means, amplitudes, points of a
!! section, events.
module viscovib_gathered
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_kinds, only: i8, wp
  use viscovib_time_run, only: run_completed
  use viscovib_watch, only: watch_type
  implicit none
  private

  public :: gathered_type, single_request

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
    !> As of `shared_type`, of earlier runs of the motion with other step sizes.
    logical :: in_parts = .false.
    real(wp) :: longest = 0.0_wp
    !> Number of Lyapunov exponents, and largest number of steps between two renewals of their
    !! perturbations.
    integer :: n_exponents = 0
    integer(i8) :: quarter = 1
  contains
    procedure :: stride
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
    !> Lyapunov exponents, and their errors.
    real(wp), allocatable :: lyapunov(:), lyapunov_error(:)
    !> True if steps were made in parts that resolve thin layers of forces.
    logical :: in_parts = .false.
    !> Sums for amplitudes: of windowed waves with and without the motion, and of the window.
    complex(wp), allocatable, private :: waves(:, :), empty(:)
    real(wp), allocatable, private :: sums(:)
    real(wp), private :: weight = 0.0_wp
    !> Numbers of steps and of samples so far.
    integer(i8), private :: steps = 0, n_samples = 0
  contains
    procedure :: begin => begin_gathering
    procedure :: add_states
    procedure :: add_watched
    procedure :: finish
  end type gathered_type

contains

  !> Prepare for states of w numbers.
  subroutine begin_gathering(self, request, w)
    class(gathered_type), intent(out) :: self
    type(single_request), intent(in) :: request
    integer, intent(in) :: w
    integer :: n

    allocate (self%peak(w), self%mean(w), self%rms(w), self%sums(w/2), source=0.0_wp)
    allocate (self%empty(size(request%lines)), self%waves(w/2, size(request%lines)), &
              source=(0.0_wp, 0.0_wp))
    n = 0
    if (request%section_every > 0) then
      n = int((request%n_steps - request%n_discard)/request%section_every)
    end if
    allocate (self%lyapunov(request%n_exponents), source=0.0_wp)
    allocate (self%lyapunov_error, source=self%lyapunov)
    allocate (self%sections(w, n), self%times(0))
    self%sections = ieee_value(0.0_wp, ieee_quiet_nan)
  end subroutine begin_gathering

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
  subroutine add_watched(self, request, rows, watch)
    class(gathered_type), intent(inout) :: self
    type(single_request), intent(in) :: request
    !> Rows of states that are kept.
    integer, intent(in) :: rows(:)
    type(watch_type), intent(in) :: watch
    real(wp), allocatable :: sections(:, :)
    logical, allocatable :: counts(:)
    integer :: i, n

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
  end subroutine add_watched

  !> Means and amplitudes at the end of a run with steps h.
  subroutine finish(self, request, h)
    class(gathered_type), intent(inout) :: self
    type(single_request), intent(in) :: request
    real(wp), intent(in) :: h
    real(wp) :: length, mean(size(self%sums)), unset
    integer :: j

    length = h*request%n_steps - request%since
    self%mean = self%mean/length
    self%rms = sqrt(self%rms/length)
    unset = ieee_value(unset, ieee_quiet_nan)
    allocate (self%amplitudes(size(self%waves, 1), size(self%waves, 2)), &
              source=cmplx(unset, unset, wp))
    if (self%n_samples == 0 .or. self%ended /= run_completed) return
    mean = self%sums/self%weight
    do j = 1, size(self%empty)
      self%amplitudes(:, j) = 2.0_wp*(self%waves(:, j) - mean*self%empty(j))/self%weight
    end do
  end subroutine finish

end module viscovib_gathered
