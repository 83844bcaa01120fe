! Optimize: -O1
!> Lyapunov exponents from neighbouring runs, of motions with switches or memory.
!!
!! Neighbours at a small distance in coordinates and velocities are followed with a motion. Their
!! differences are repeatedly orthogonalized and scaled to that distance (Benettin et al.,
!! Meccanica 15, 1980, with differences instead of the variational equation). Each neighbour is a
!! separate run with its own switching times, so the difference includes the effect of kinks, jumps
!! and impacts on perturbations (saltation).
!!
!! With memory the state is the whole past. A perturbation changes coordinates and velocities at
!! t = 0, with an unperturbed past. Afterwards its own past belongs to it and is scaled with it.
!! Exponents are the growth rates of the present coordinates and velocities; the past follows them.
!!
!! All data of a run except its state (phases of loads, first guesses, flags) are copied from the
!! motion. Phases differ by rounding errors where steps end at kinks. If such errors were scaled
!! with a decaying difference, they would never decay and would become the largest perturbation.
!!
!! A `single_run` is a motion of an ensemble that is computed by itself: its last state, and what
!! is gathered along it. Motions with kinks, hysteresis, memory or surfaces end their steps at
!! different times. So they cannot be computed together in lanes.
module viscovib_neighbouring_runs
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_negative_inf, ieee_quiet_nan, &
    ieee_value
  use viscovib_gathered, only: gathered_type, single_request
  use viscovib_kinds, only: i8, wp
  use viscovib_motion_piece, only: as_before, motion_equations, of_contact, of_switch
  use viscovib_motion_request, only: transient_job
  use viscovib_piece_runs, only: piece_runs, shared_type
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  use viscovib_time_run, only: run_completed
  use viscovib_trajectory, only: trajectory_type
  use viscovib_watch, only: n_event_rows
  implicit none
  private

  public :: gather_run

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
    procedure :: begin => begin_run
    procedure :: advance => advance_run
    procedure :: gather => gather_states
  end type single_run

  !> Relative distance of a neighbour; relative length below which a difference has vanished.
  real(wp), parameter :: near = 1.0e-7_wp, none = 1.0e-7_wp
  !> Growth between two renewals that may be due to a switch of one motion only; largest number of
  !! successive renewals that wait for a neighbour to switch.
  real(wp), parameter :: leap = 1.0e3_wp
  integer, parameter :: patience = 2
  !> Smallest remaining difference above rounding errors, which sets the interval of renewals.
  real(wp), parameter :: left = 1.0e-2_wp
  !> Smallest remaining difference after one step, and refinement of steps if less remains.
  real(wp), parameter :: left_of_step = 1.0e-5_wp
  integer, parameter :: finer = 8
  !> Error of a mean rate, in units of the range of deviations from linear growth over the time.
  real(wp), parameter :: in_ranges = 2.0_wp
  !> Smallest difference of states of switches (whole numbers); bound of flags and counts.
  real(wp), parameter :: marked = 0.5_wp, counted = 1.0e6_wp
  !> Number of states for the size of a motion, and of renewals for its recent size.
  integer, parameter :: n_looks = 512, n_recent = 16
  !> Smallest distance of neighbours.
  real(wp), parameter :: least_apart = 1.0e-100_wp
  !> Largest share of the history in a perturbation, relative to the first perturbation, and the
  !! largest share of one that is followed.
  real(wp), parameter :: most_hidden = 1.0e4_wp, lost = 1.0e12_wp
  !> A large factor, which leaves no pattern in fractions.
  real(wp), parameter :: scatter = 43758.5453_wp

  !> A run, and the equations of its start.
  type :: neighbour_type
    class(motion_equations), allocatable :: equations
    real(wp), allocatable :: initial(:)
    type(single_run) :: run
  end type neighbour_type

  !> A motion (index 0) and its neighbours.
  type :: neighbours_type
    type(neighbour_type), allocatable :: runs(:)
    !> Rows of the state that measure distances, and their scales.
    integer, allocatable :: rows(:)
    real(wp), allocatable :: scale(:)
    !> Largest number of steps between two renewals; true if steps cannot become shorter.
    integer(i8) :: quarter = 1
    logical :: last_try = .false.
    !> Sums of the logarithms of growth.
    real(wp), allocatable :: grown(:)
    !> Undetermined exponents: the history and its rounding errors hide the present state.
    logical, allocatable :: unset(:)
    !> Reduction of the distance of each neighbour, so that its past is near too.
    real(wp), allocatable :: nearer(:)
    !> Distance of neighbours, and recent sizes of the motion.
    real(wp) :: apart = 0.0_wp
    real(wp), allocatable :: sizes(:)
    !> Orthogonalized and scaled differences, and the length of each before in units of the
    !! distance.
    real(wp), allocatable :: parts(:, :), lengths(:)
    !> Numbers of steps at renewals, and the growth until then.
    integer(i8), allocatable :: done_at(:)
    real(wp), allocatable :: course(:, :)
    integer :: n_course = 0
  contains
    procedure :: follow
    procedure, private :: begin => begin_neighbours
    procedure, private :: advance
    procedure, private :: compare
    procedure, private :: renew
    procedure, private :: are_astride
    procedure, private :: note
    procedure, private :: unsure
  end type neighbours_type

contains

  !> Make a whole run, with what is gathered along it and its exponents.
  subroutine gather_run(runs, request, shared, found, status)
    !> With equations, rows and the length of a step, at its start.
    type(piece_runs), intent(inout) :: runs
    type(single_request), intent(in) :: request
    type(shared_type), intent(inout), target :: shared
    type(gathered_type), intent(out) :: found
    type(status_type), intent(out) :: status
    type(single_run), target :: run

    run%runs = runs
    call run%begin(shared)
    call run%gather(request, found, status)
    if (.not. status%failed() .and. request%n_exponents > 0) then
      call find_exponents(runs, request, shared, found%lyapunov, found%lyapunov_error, status)
    end if
    found%in_parts = shared%in_parts
  end subroutine gather_run

  !> Mean growth rates of perturbations, and errors; NaN if the motion ends early. -inf: the
  !! perturbation vanishes, for example by sticking friction. NaN: it nearly vanishes from
  !! coordinates and velocities but remains in the past.
  subroutine find_exponents(runs, request, shared, rates, errors, status)
    type(piece_runs), intent(in) :: runs
    type(single_request), intent(in) :: request
    type(shared_type), intent(inout), target :: shared
    real(wp), intent(out) :: rates(:), errors(:)
    type(status_type), intent(out) :: status
    type(neighbours_type), allocatable, target :: nearby
    type(piece_runs) :: shorter
    logical :: too_far

    allocate (nearby)
    nearby%quarter = request%quarter
    call nearby%follow(runs, request%n_steps, request%n_discard, shared, rates, errors, too_far, &
                       status)
    if (.not. too_far .or. status%failed()) return
    deallocate (nearby)
    allocate (nearby)
    nearby%quarter = finer*request%quarter
    nearby%last_try = .true.
    shorter = runs
    shorter%first%h = runs%first%h/finer
    call nearby%follow(shorter, finer*request%n_steps, finer*request%n_discard, shared, rates, &
                       errors, too_far, status)
  end subroutine find_exponents

  !> Follow the motions: mean growth between the first and the last counted renewal.
  subroutine follow(self, runs, n_steps, n_discard, shared, rates, errors, too_far, status)
    class(neighbours_type), intent(inout), target :: self
    type(piece_runs), intent(in) :: runs
    integer(i8), intent(in) :: n_steps, n_discard
    type(shared_type), intent(inout), target :: shared
    real(wp), intent(out) :: rates(:), errors(:)
    !> True if a difference nearly vanishes within one step.
    logical, intent(out) :: too_far
    type(status_type), intent(out) :: status
    type(single_run), allocatable :: before(:)
    integer(i8) :: done, look, n, renewed, since
    integer :: i, waited
    real(wp) :: least, most, span
    logical :: goes_on

    too_far = .false.
    rates = ieee_value(0.0_wp, ieee_quiet_nan)
    errors = rates
    call set_ok(status)
    if (n_discard >= n_steps) return
    call self%begin(runs, n_steps, size(rates), shared, goes_on, status)
    if (.not. goes_on .or. status%failed()) return
    done = 0
    renewed = 0
    since = merge(0_i8, -1_i8, n_discard == 0)
    look = self%quarter
    waited = 0
    call self%note(0_i8)
    do while (done < n_steps)
      n = min(look, merge(n_discard, n_steps, done < n_discard) - done)
      before = [(self%runs(i)%run, i=0, size(rates))]
      call self%advance(n, goes_on, status)
      if (.not. goes_on .or. status%failed()) return
      call self%compare(status)
      if (status%failed()) return
      least = minval([1.0_wp, pack(self%lengths, ieee_is_finite(self%grown))])
      most = maxval([1.0_wp, pack(self%lengths, ieee_is_finite(self%grown))])
      if (n > 1 .and. (least < left .or. most > leap)) then
        do i = 0, size(rates)
          self%runs(i)%run = before(i + 1)
        end do
        look = max(1_i8, n/4)
        cycle
      end if
      too_far = least < left_of_step .and. .not. self%last_try
      if (too_far) return
      done = done + n
      ! One motion has switched and the other not yet: the difference is temporary.
      if ((most > leap .or. self%are_astride()) .and. waited < patience) then
        waited = waited + 1
        if (done < n_steps .or. renewed > max(since, 0_i8)) cycle
      end if
      waited = 0
      call self%renew()
      renewed = done
      if (since < 0 .and. done >= n_discard) then
        since = done
        where (ieee_is_finite(self%grown)) self%grown = 0.0_wp
        self%unset = .false.
        self%n_course = 0
      end if
      call self%note(done)
      if (least > sqrt(left)) look = min(self%quarter, 2*look)
    end do
    if (since < 0 .or. renewed <= since) return
    span = self%runs(0)%run%runs%first%h*(renewed - since)
    where (.not. self%unset) rates = self%grown/span
    where (.not. self%unset) errors = self%unsure()/span
  end subroutine follow

  !> Start the motion and its neighbours; `goes_on` is false if the motion ends early.
  subroutine begin_neighbours(self, runs, n_steps, count, shared, goes_on, status)
    class(neighbours_type), intent(inout), target :: self
    type(piece_runs), intent(in) :: runs
    integer(i8), intent(in) :: n_steps
    integer, intent(in) :: count
    type(shared_type), intent(inout), target :: shared
    logical, intent(out) :: goes_on
    type(status_type), intent(out) :: status
    type(trajectory_type) :: looked
    type(single_run), target :: scout
    integer(i8) :: every, m
    real(wp) :: length, time
    integer :: i, j

    self%rows = runs%rows
    allocate (self%runs(0:count))
    allocate (self%grown(count), source=0.0_wp)
    allocate (self%unset(count), source=.false.)
    allocate (self%nearer(count), source=1.0_wp)
    do j = 0, count
      associate (one => self%runs(j))
        allocate (one%equations, source=runs%equations)
        call one%equations%move_all()
        one%initial = runs%first%initial
        one%run%runs = runs
        one%run%runs%equations => one%equations
        one%run%runs%first%initial => one%initial
        one%run%runs%first%is_watched = .false.
        one%run%runs%first%marks = .true.
        one%run%runs%first%in_parts = shared%in_parts
      end associate
    end do
    scout%runs = self%runs(0)%run%runs
    every = max(1_i8, n_steps/n_looks)
    call scout%begin(shared)
    call scout%advance(n_steps, every, looked, status)
    if (status%failed()) return
    goes_on = looked%outcome == run_completed
    if (.not. goes_on) return
    ! Common scales of all coordinates and of all velocities.
    time = self%quarter*runs%first%h
    length = max(maxval(abs(looked%states(1::2, :))), time*maxval(abs(looked%states(2::2, :))))
    if (.not. length > 0.0_wp) length = 1.0_wp
    self%scale = [(length*[1.0_wp, 1.0_wp/time], i=1, size(self%rows)/2)]
    ! A motion may grow or decay by many orders: distances refer to its size at this time.
    m = min(2 + 4*self%quarter/every, size(looked%states, 2, i8))
    self%sizes = [maxval([(norm2(looked%states(:, i)/self%scale), i=1, int(m))])]
    if (.not. self%sizes(1) > 0.0_wp) self%sizes = [1.0_wp]
    self%apart = near*self%sizes(1)
    call move_starts(self, time)
    do j = 0, count
      self%runs(j)%run%runs%first%in_parts = shared%in_parts
      call self%runs(j)%run%begin(shared)
    end do
  end subroutine begin_neighbours

  !> Change the start of each neighbour, orthogonally to those of the others.
  subroutine move_starts(self, time)
    class(neighbours_type), intent(inout) :: self
    real(wp), intent(in) :: time
    real(wp), allocatable :: changes(:, :), seen(:, :)
    real(wp) :: along
    integer :: d, i, j, k, m, w

    m = self%runs(0)%equations%n_start(size(self%runs(0)%initial))
    w = size(self%runs(0)%initial)
    d = size(self%grown)
    allocate (changes(m, d), seen(w, d))
    do j = 1, d
      associate (one => self%runs(j), x => changes(:, j), y => seen(:, j))
        ! Pseudo-random numbers.
        x = [(modulo(scatter*sin(real(i + (j - 1)*m, wp)), 1.0_wp) - 0.5_wp, i=1, m)]
        x(2::2) = x(2::2)/time
        y = one%equations%seen_at_start(x, w)
        do k = 1, 2
          do i = 1, j - 1
            along = dot_product(seen(self%rows, i)/self%scale, y(self%rows)/self%scale)
            x = x - along*changes(:, i)
            y = y - along*seen(:, i)
          end do
          along = norm2(y(self%rows)/self%scale)
          if (along > 0.0_wp) x = x/along
          if (along > 0.0_wp) y = y/along
        end do
        call one%equations%move_start(self%apart*x)
        one%initial = one%initial + self%apart*y
      end associate
    end do
  end subroutine move_starts

  !> Make n steps of all motions; `goes_on` is false if one of them ends.
  subroutine advance(self, n, goes_on, status)
    class(neighbours_type), intent(inout), target :: self
    integer(i8), intent(in) :: n
    logical, intent(out) :: goes_on
    type(status_type), intent(out) :: status
    type(trajectory_type) :: run
    integer :: j

    do j = 0, ubound(self%runs, 1)
      call self%runs(j)%run%advance(n, 0_i8, run, status)
      if (status%failed()) return
      goes_on = run%outcome == run_completed
      if (.not. goes_on) return
    end do
  end subroutine advance

  !> Differences from the motion, each orthogonal to those before and of the length of the
  !! distance, and their lengths before. A difference that has vanished is 0.
  subroutine compare(self, status)
    class(neighbours_type), intent(inout) :: self
    type(status_type), intent(out) :: status
    real(wp), allocatable :: own(:), its(:)
    real(wp) :: along
    integer :: i, j, k, n

    call set_ok(status)
    allocate (own, source=whole_of(self%runs(0)%run))
    n = size(self%runs(0)%run%state)
    if (allocated(self%parts)) deallocate (self%parts)
    allocate (self%parts(size(own), size(self%grown)), source=0.0_wp)
    self%lengths = 0.0_wp*self%grown
    do j = 1, size(self%grown)
      self%lengths(j) = 0.0_wp
      if (self%grown(j) /= self%grown(j)) cycle
      its = whole_of(self%runs(j)%run)
      if (size(its) /= size(own)) then
        call fail(status, status_input_error, 'lyapunov', 'lyapunov: neighbouring motions end ' &
                  //'their steps at kinks and have different histories; must be False, or the ' &
                  //'kernels sums of exponentials')
        return
      end if
      associate (part => self%parts(:, j))
        part = its - own
        where (self%runs(0)%run%marks < of_switch .or. are_flags(own(n + 1:), its(n + 1:)))
          part(n + 1:) = 0.0_wp
        end where
        part = part/self%nearer(j)
        do k = 1, 2
          do i = 1, j - 1
            along = dot_product(self%parts(self%rows, i)/self%scale, part(self%rows)/self%scale)
            part = part - along/self%apart*(self%parts(:, i)/self%apart)
          end do
        end do
        self%lengths(j) = norm2(part(self%rows)/self%scale)/self%apart
        if (self%lengths(j) > none) then
          part = part/self%lengths(j)
        else
          part = 0.0_wp
        end if
      end associate
    end do
  end subroutine compare

  !> Move the neighbours back to the small distance.
  subroutine renew(self)
    class(neighbours_type), intent(inout) :: self
    real(wp), allocatable :: own(:), moved(:)
    real(wp) :: apart, share, times
    integer :: j, n

    allocate (own, source=whole_of(self%runs(0)%run))
    n = size(self%runs(0)%run%state)
    self%sizes = [self%sizes(max(1, size(self%sizes) - n_recent + 2):), &
                  norm2(own(self%rows)/self%scale)]
    apart = near*maxval(self%sizes)
    ! For a motion at rest at zero keep the distance.
    times = 1.0_wp
    if (apart > least_apart) times = apart/self%apart
    do j = 1, size(self%grown)
      associate (part => self%parts(:, j), run => self%runs(j)%run)
        if (self%lengths(j) > none) then
          self%grown(j) = self%grown(j) + log(self%lengths(j))
        else
          self%grown(j) = self%grown(j) + ieee_value(0.0_wp, ieee_negative_inf)
        end if
        share = hidden(part, self%parts(:, 1), n)
        if (share > most_hidden) self%unset(j:) = .true.
        if (share > lost) self%grown(j:) = ieee_value(0.0_wp, ieee_quiet_nan)
        self%nearer(j) = 1.0_wp/max(1.0_wp, share)
        moved = own + times*self%nearer(j)*part
        run%state = moved(:n)
        run%memory = moved(n + 1:)
      end associate
    end do
    self%apart = times*self%apart
  end subroutine renew

  !> True if a neighbour is on the other side of a switching surface.
  pure logical function are_astride(self)
    class(neighbours_type), intent(in) :: self
    integer :: j
    are_astride = .false.
    associate (mine => self%runs(0)%run%memory, marks => self%runs(0)%run%marks)
      do j = 1, size(self%grown)
        if (any((marks == of_switch .or. marks == of_contact) &
                .and. abs(self%runs(j)%run%memory - mine) &
                >= max(marked, 1.0e-3_wp*abs(mine)))) are_astride = .true.
      end do
    end associate
  end function are_astride

  !> Store the growth at a renewal.
  subroutine note(self, done)
    class(neighbours_type), intent(inout) :: self
    integer(i8), intent(in) :: done
    integer :: n

    n = self%n_course
    if (.not. allocated(self%done_at)) then
      allocate (self%done_at(n_looks), self%course(size(self%grown), n_looks))
    else if (n == size(self%done_at)) then
      self%done_at = [self%done_at, self%done_at]
      self%course = reshape([self%course, self%course], [size(self%grown), 2*n])
    end if
    self%n_course = n + 1
    self%done_at(n + 1) = done
    self%course(:, n + 1) = self%grown
  end subroutine note

  !> Error of mean rates times the time, as of `growth_course`; 0 of what has vanished.
  function unsure(self) result(off)
    class(neighbours_type), intent(in) :: self
    real(wp), dimension(size(self%grown)) :: off, least, most, nearby
    real(wp) :: part
    integer :: i

    least = 0.0_wp
    most = 0.0_wp
    associate (n => self%n_course)
      do i = 1, n
        part = real(self%done_at(i) - self%done_at(1), wp)/(self%done_at(n) - self%done_at(1))
        nearby = self%course(:, i) - self%course(:, 1) &
                 - part*(self%course(:, n) - self%course(:, 1))
        least = min(least, nearby)
        most = max(most, nearby)
      end do
    end associate
    off = 0.0_wp
    where (ieee_is_finite(self%grown)) off = in_ranges*(most - least)
  end function unsure

  !> Share of the history (after n numbers) in a perturbation, relative to the first one.
  pure real(wp) function hidden(part, first, n)
    real(wp), intent(in) :: part(:), first(:)
    integer, intent(in) :: n
    real(wp) :: past, seen
    seen = maxval(abs(part(:n)))*maxval([0.0_wp, abs(first(n + 1:))])
    past = maxval([0.0_wp, abs(part(n + 1:))])*maxval(abs(first(:n)))
    hidden = 1.0_wp
    ! A vanished perturbation has no parts.
    if (past > seen .and. seen > 0.0_wp) hidden = past/seen
  end function hidden

  !> Flags and counts in a memory: small whole numbers.
  elemental logical function are_flags(own, its)
    real(wp), intent(in) :: own, its
    are_flags = .false.
    if (max(abs(own), abs(its)) < counted) are_flags = is_whole(own) .and. is_whole(its)
  end function are_flags

  elemental logical function is_whole(value)
    real(wp), intent(in) :: value
    is_whole = abs(value - anint(value)) <= 0.0_wp
  end function is_whole

  !> State and memory, which are sufficient to continue a run.
  pure function whole_of(run) result(whole)
    type(single_run), intent(in) :: run
    real(wp), allocatable :: whole(:)
    whole = [run%state, run%memory]
  end function whole_of

  !> Start a run from the start of its first piece.
  subroutine begin_run(self, shared)
    class(single_run), intent(inout) :: self
    type(shared_type), intent(inout), target :: shared
    self%runs%counts = .true.
    self%state = self%runs%first%initial
    self%runs%begun = self%state
    allocate (self%memory(0))
    call self%runs%begin(shared)
  end subroutine begin_run

  !> Make n steps; keep every `every`-th state, 0: the last one.
  subroutine advance_run(self, n, every, run, status)
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
  end subroutine advance_run

  !> Make the whole run.
  subroutine gather_states(self, request, found, status)
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
  end subroutine gather_states

end module viscovib_neighbouring_runs
