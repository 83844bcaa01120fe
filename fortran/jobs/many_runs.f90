!> Many motions, with a step given or found: of a pendulum or a polynomial system without memory
!! in lanes, of other systems one after another. A motion in a lane whose steps may have missed a
!! thin layer is repeated by itself, in parts of steps.
module viscovib_many_runs
  use viscovib_constants, only: pi
  use viscovib_ensemble, only: ensemble_job
  use viscovib_explicit_tables, only: lane_methods
  use viscovib_kinds, only: i8, wp
  use viscovib_lane_motion, only: lane_motion_type, n_scales, new_lane_motion
  use viscovib_lane_runs, only: lane_runs
  use viscovib_many_motions, only: compare, many_motions
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_pendulum, only: new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_stopping, only: stop_wanted
  use viscovib_subject, only: subject_type
  use viscovib_subject_motion, only: move_subject, new_motion
  use viscovib_time_run, only: run_stopped
  use viscovib_transient_job, only: hopeless, trajectory_type, transient_job
  use viscovib_varied_system, only: varied_system
  implicit none
  private

  public :: many_runs, many_motions

  !> Varied numbers of a polynomial system (the scales in the order of the lanes).
  character(len=*), parameter, public :: system_numbers(5) = &
    [character(len=15) :: 'nu', 'load_scale', 'stiffness_scale', 'damping_scale', 'forces_scale']
  integer, parameter :: of_nu = 1
  integer, parameter, public :: of_load = 2
  !> Index of a parameter of laws, after all of these.
  integer, parameter, public :: of_parameter = size(system_numbers) + 1
  !> Halvings of the step before a tolerance is given up.
  integer, parameter :: most_halvings = 12
  !> Smallest number of steps with samples for amplitudes, in units of the first number.
  integer, parameter :: sampled = 8
  !> Largest number of systems in memory; of steps of a motion.
  integer, parameter :: most_built = 4096
  real(wp), parameter :: most_steps = 1.0e10_wp

  !> The motions to compute.
  type, extends(lane_runs) :: many_runs
    type(subject_type), pointer :: subject => null()
    !> The varied number: its index (0: none), and its values.
    integer :: place = 0
    real(wp), allocatable :: values(:)
    !> Builds the systems if a parameter of laws varies; the first of them, built once.
    class(varied_system), allocatable :: varied
    type(polynomial_type), allocatable :: systems(:)
    integer :: n_built = 0
    !> Duration of each motion.
    real(wp), allocatable :: spans(:)
    !> Frequency of the load of a polynomial system, unless it varies.
    real(wp) :: nu = 0.0_wp
    !> Index in `lane_methods`; false if all motions are computed by themselves, with an index in
    !! the methods of such motions, and of a structure with these coordinates.
    integer :: method = 4
    logical :: side_by_side = .true.
    integer :: own_method = 1
    integer, allocatable :: wanted(:)
    !> Periods of load `sections` in all and before accumulation begins; without sections 0, and
    !! `discard` is the time before.
    integer :: sections = 0, n_periods = 0, periods_before = 0
    real(wp) :: discard = 0.0_wp
    !> Frequencies of amplitudes (not allocated: none), and steps between the samples for them.
    real(wp), allocatable :: lines(:)
    integer :: sample_every = 1
    !> Whether to compute peaks and means, and the largest exponent.
    logical :: moments = .false., lyapunov = .false.
    !> Steps of the first runs (0: none yet), and motions that are computed separately since.
    integer(i8) :: n_first = 0
    logical, allocatable :: alone(:), in_parts(:)
  contains
    procedure :: lay_out
    procedure :: steps_of
    procedure :: make
    procedure :: refine
    procedure :: frequency
    procedure :: pendulum_of
    procedure :: motion_of
    procedure, private :: system_of
    procedure :: subject_of
    procedure, private :: run_single
  end type many_runs

contains

  !> Durations of the motions, and the fastest frequency of all.
  subroutine lay_out(self, t_end, fastest, status)
    class(many_runs), intent(inout) :: self
    !> Duration of each, if no periods are counted.
    real(wp), intent(in) :: t_end
    real(wp), intent(out) :: fastest
    type(status_type), intent(out) :: status
    type(pendulum_type) :: pendulum
    real(wp), allocatable :: rates(:)
    integer :: i, n

    call set_ok(status)
    n = size(self%starts, 2)
    self%spans = [(t_end, i=1, n)]
    fastest = 0.0_wp
    self%side_by_side = self%subject%goes_side_by_side(self%lyapunov)
    if (.not. allocated(self%wanted)) self%wanted = [(i, i=1, size(self%starts, 1)/2)]
    if (.not. allocated(self%lines)) allocate (self%lines(0))
    if (.not. allocated(self%in_parts)) allocate (self%in_parts(n), source=.false.)
    if (.not. self%side_by_side) then
      call lay_out_singles(self, fastest, status)
      return
    end if
    if (allocated(self%varied)) call build_systems(self, status)
    if (status%failed()) return
    self%of_pendulums = self%subject%is_pendulum
    self%one_system = .not. allocated(self%varied)
    self%load => self%subject%load
    self%frequencies = [(self%frequency(i), i=1, n)]
    allocate (self%scales(n_scales, n), source=1.0_wp)
    if (self%place > of_nu .and. self%place < of_parameter) then
      if (.not. self%of_pendulums) self%scales(self%place - 1, :) = self%values
    end if
    if (.not. self%of_pendulums) call self%load%check_at(self%frequencies, status)
    if (.not. status%failed()) call self%find_fastest(rates, status)
    if (status%failed()) return
    fastest = maxval(rates)
    do i = 1, merge(n, 0, self%n_periods > 0)
      if (self%of_pendulums) then
        call self%pendulum_of(i, pendulum, status)
        self%frequencies(i) = pendulum%parameters%frequency(max(self%sections, 1))
      end if
      if (.not. self%frequencies(i) > 0.0_wp) then
        call fail(status, status_input_error, 'sections', 'sections = '//show(self%sections) &
                  //': the frequency of that load must be greater than 0')
        return
      end if
      self%spans(i) = self%n_periods*2.0_wp*pi/self%frequencies(i)
    end do
    ! A method that exists only for lanes is replaced by the first method.
    self%own_method = max(1, findloc(transient_methods, lane_methods(self%method), 1))
  end subroutine lay_out

  !> Build the first systems once for all runs.
  subroutine build_systems(self, status)
    type(many_runs), intent(inout) :: self
    type(status_type), intent(out) :: status
    type(polynomial_type) :: system
    integer :: i

    allocate (self%systems(min(size(self%values), most_built)))
    do i = 1, size(self%systems)
      call self%system_of(i, system, status)
      if (status%failed()) return
      self%systems(i) = system
      self%n_built = i
    end do
  end subroutine build_systems

  !> Find the first number of steps of motions that are computed one by one: the larger one of the
  !! motions with the first and the last value. `fastest` is the frequency that needs it.
  subroutine lay_out_singles(self, fastest, status)
    type(many_runs), intent(inout) :: self
    real(wp), intent(out) :: fastest
    type(status_type), intent(out) :: status
    type(ensemble_job) :: no_steps
    type(trajectory_type) :: run
    integer(i8) :: steps
    integer :: i, n

    no_steps%n_steps = 0
    allocate (no_steps%lines(0))
    n = size(self%spans)
    if (self%n_periods > 0) then
      self%spans = [(self%n_periods*2.0_wp*pi/self%frequency(i), i=1, n)]
    end if
    steps = 1
    do i = 1, n, max(n - 1, 1)
      call self%subject%load%check_at([self%frequency(i)], status)
      if (.not. status%failed()) call self%run_single(i, no_steps, run, status)
      if (status%failed()) return
      steps = max(steps, run%n_steps)
    end do
    fastest = 0.5_wp*pi*steps/maxval(self%spans)
  end subroutine lay_out_singles

  !> Number of steps per motion for a given step length, a multiple of the number of periods.
  subroutine steps_of(self, dt, n, status)
    class(many_runs), intent(in) :: self
    real(wp), intent(in) :: dt
    integer(i8), intent(out) :: n
    type(status_type), intent(out) :: status
    real(wp) :: wanted
    integer :: unit

    call set_ok(status)
    n = 0
    unit = max(self%n_periods, 1)
    wanted = maxval(self%spans)/dt*(1.0_wp - 1.0e-12_wp)
    if (wanted > most_steps) then
      call fail(status, status_input_error, 'dt', 'dt: takes '//show(wanted) &
                //' steps a motion, must be at most '//show(most_steps))
    else
      n = unit*max(ceiling(wanted/unit, i8), 1_i8)
    end if
  end subroutine steps_of

  !> The frequency of the load of a polynomial system in motion i.
  pure real(wp) function frequency(self, i)
    class(many_runs), intent(in) :: self
    integer, intent(in) :: i
    frequency = self%nu
    if (self%place == of_nu) frequency = self%values(i)
  end function frequency

  !> Pendulum i.
  subroutine pendulum_of(self, i, pendulum, status)
    class(many_runs), intent(in) :: self
    integer, intent(in) :: i
    type(pendulum_type), intent(out) :: pendulum
    type(status_type), intent(out) :: status
    type(pendulum_parameters) :: p

    p = self%subject%pendulum%parameters
    if (self%place > 0) call set_number(p, self%place, self%values(i))
    call new_pendulum(pendulum, p, status)
    if (status%failed()) status%subject = 'from'
  end subroutine pendulum_of

  !> The system of motion i.
  subroutine system_of(self, i, system, status)
    class(many_runs), intent(in) :: self
    integer, intent(in) :: i
    type(polynomial_type), intent(out) :: system
    type(status_type), intent(out) :: status
    type(subject_type) :: subject

    call set_ok(status)
    if (i <= self%n_built) then
      system = self%systems(i)
    else if (allocated(self%varied)) then
      call self%varied%make(self%values(i), subject, status)
      if (status%failed()) return
      system = subject%polynomial
      if (subject%goes_side_by_side()) return
      call fail(status, status_input_error, 'vary', 'vary: with the value '//show(self%values(i)) &
                //' a law is not smooth, must be smooth')
    else
      system = self%subject%polynomial
    end if
  end subroutine system_of

  !> The system and its loads in motion i, without scales of its own forces.
  subroutine subject_of(self, i, subject, status)
    class(many_runs), intent(in) :: self
    integer, intent(in) :: i
    type(subject_type), intent(out) :: subject
    type(status_type), intent(out) :: status

    call set_ok(status)
    if (allocated(self%varied)) then
      call self%varied%make(self%values(i), subject, status)
      return
    end if
    subject = self%subject
    if (subject%is_pendulum) then
      call self%pendulum_of(i, subject%pendulum, status)
    else if (self%place == of_load) then
      call subject%load%scale(self%values(i))
      if (subject%is_structure) call subject%model%load%scale(self%values(i))
      if (allocated(subject%model%supports%waves)) then
        subject%model%supports%waves = self%values(i)*subject%model%supports%waves
      end if
    end if
  end subroutine subject_of

  !> The motion as one of many in lanes, without scales.
  subroutine motion_of(self, i, motion, status)
    class(many_runs), intent(in) :: self
    integer, intent(in) :: i
    type(lane_motion_type), intent(out) :: motion
    type(status_type), intent(out) :: status
    type(polynomial_type) :: system
    real(wp) :: own(size(self%starts, 1)/2, size(self%starts, 1)/2, 2)

    call self%system_of(i, system, status)
    if (status%failed()) return
    own(:, :, 1) = system%stiffness_at_rest()
    own(:, :, 2) = system%damping
    call new_lane_motion(motion, system, self%subject%load, own)
  end subroutine motion_of

  !> Compute all motions in n steps each.
  subroutine make(self, n, many, status)
    class(many_runs), intent(inout) :: self
    integer(i8), intent(in) :: n
    type(many_motions), intent(out) :: many
    type(status_type), intent(out) :: status
    type(ensemble_job) :: job
    real(wp) :: discarded
    integer :: cancel, m, points

    call set_ok(status)
    if (self%n_first == 0) self%n_first = n
    m = size(self%starts, 2)
    cancel = 0
    points = 0
    job%method = self%method
    job%n_steps = n
    job%moments = self%moments
    job%n_exponents = merge(1, 0, self%lyapunov)
    job%sample_every = self%sample_every
    job%lines = self%lines
    if (self%n_periods > 0) then
      job%section_every = n/self%n_periods
      job%n_discard = self%periods_before*job%section_every
      points = self%n_periods - self%periods_before
    else
      discarded = self%discard/self%spans(1)*n
      job%n_discard = ceiling(discarded*(1.0_wp - 1.0e-12_wp), i8)
      job%ahead = max(0.0_wp, job%n_discard - discarded)
    end if
    call many%begin(job, size(self%starts, 1), m, points)
    if (.not. self%side_by_side) then
      many%missed = .true.
      call make_missed(self, job, many, status)
      return
    end if
    call self%run_in_lanes(job, self%spans/n, points, many, cancel, status)
    if (.not. status%failed()) call make_missed(self, job, many, status)
  end subroutine make

  !> Compute by themselves the motions that need it, or needed it in an earlier run.
  subroutine make_missed(self, job, many, status)
    type(many_runs), intent(inout) :: self
    type(ensemble_job), intent(in) :: job
    type(many_motions), intent(inout) :: many
    type(status_type), intent(out) :: status
    integer :: i

    call set_ok(status)
    if (.not. allocated(self%alone)) self%alone = many%missed
    self%alone = self%alone .or. many%missed
    do i = 1, size(self%alone)
      if (.not. self%alone(i)) cycle
      if (stop_wanted()) then
        many%ended(i) = run_stopped
        cycle
      end if
      call make_alone(self, i, job, many, status)
      if (status%failed()) return
    end do
  end subroutine make_missed

  !> Compute motion i by itself.
  subroutine make_alone(self, i, job, many, status)
    type(many_runs), intent(inout) :: self
    integer, intent(in) :: i
    type(ensemble_job), intent(in) :: job
    type(many_motions), intent(inout) :: many
    type(status_type), intent(out) :: status
    type(trajectory_type) :: run
    integer :: k
    integer, allocatable :: rows(:)

    call self%run_single(i, job, run, status)
    if (status%failed()) return
    allocate (rows(2*size(self%wanted)))
    rows(1::2) = 2*self%wanted - 1
    rows(2::2) = 2*self%wanted
    if (size(run%gathered%state) > size(rows)) rows = [(k, k=1, size(run%gathered%state))]
    self%in_parts(i) = run%gathered%in_parts
    call many%take_single(run%gathered, rows, i)
  end subroutine make_alone

  !> The run of motion i by itself, in the steps of a job; without steps their first number.
  subroutine run_single(self, i, job, run, status)
    class(many_runs), intent(in) :: self
    integer, intent(in) :: i
    type(ensemble_job), intent(in) :: job
    type(trajectory_type), intent(out) :: run
    type(status_type), intent(out) :: status
    type(subject_type), target :: subject
    class(transient_job), allocatable :: motion
    real(wp) :: since

    call self%subject_of(i, subject, status)
    if (status%failed()) return
    call new_motion(subject, self%frequency(i), self%starts(:, i), self%spans(i), motion)
    motion%method = self%own_method
    allocate (motion%gathers)
    associate (request => motion%gathers)
      request%lines = job%lines
      if (job%n_steps > 0) then
        motion%dt = self%spans(i)/job%n_steps
        since = motion%dt*(job%n_discard - job%ahead)
        request%n_steps = job%n_steps
        request%n_discard = job%n_discard
        request%section_every = job%section_every
        request%sample_every = job%sample_every
        request%moments = self%moments
        request%n_exponents = job%n_exponents
        request%since = since
        request%in_parts = self%in_parts(i)
        request%longest = self%spans(i)/self%n_first
        ! No events; peaks and means from the time `since`.
        if (self%moments) motion%watched = [0.0_wp, since]
      end if
    end associate
    call move_subject(motion, subject, self%frequency(i), self%wanted, run, status)
  end subroutine run_single

  !> Halve the step until last states, peaks and means change by less than is allowed, as
  !! `simulate_ensemble` of Python does.
  subroutine refine(self, n, absolute, relative, many, change, met, status)
    class(many_runs), intent(inout) :: self
    !> Number of steps of the first run; on return of the last run.
    integer(i8), intent(inout) :: n
    !> Allowed absolute error, and allowed error relative to the largest value of each coordinate.
    real(wp), intent(in) :: absolute, relative
    type(many_motions), intent(out) :: many
    !> Largest change by the last halving.
    real(wp), intent(out) :: change
    logical, intent(out) :: met
    type(status_type), intent(out) :: status
    type(many_motions) :: coarse
    real(wp) :: changes(most_halvings)
    integer :: i

    met = .false.
    change = huge(1.0_wp)
    call self%make(n, coarse, status)
    do i = 1, most_halvings
      if (status%failed()) return
      n = 2*n
      call self%make(n, many, status)
      if (status%failed()) return
      call compare(coarse, many, absolute, relative, change, met)
      changes(i) = change
      if (met .or. hopeless(changes(:i))) exit
      coarse = many
    end do
    ! Samples for amplitudes need shorter steps than the states.
    if (.not. met .or. size(self%lines) == 0 .or. n >= sampled*self%n_first) return
    n = sampled*self%n_first
    call self%make(n, many, status)
  end subroutine refine

  ! Numbers of a pendulum that vary from motion to motion.

  !> Another value of the number at a place among the words of `vary` in `scenes.toml`.
  pure subroutine set_number(p, place, value)
    type(pendulum_parameters), intent(inout) :: p
    integer, intent(in) :: place
    real(wp), intent(in) :: value

    select case (place)
    case (1)
      p%e = value
    case (2)
      p%w2 = value
    case (3)
      p%w3 = value
    case (4)
      p%alpha = value
    case (5:7)
      p%damping(place - 4) = value
    case (8:10)
      p%load(place - 7) = value
    case default
      p%frequency(place - 10) = value
    end select
  end subroutine set_number

end module viscovib_many_runs
