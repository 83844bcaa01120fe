!> Basins of attraction of motions of any system, from a grid of starts. A start is a state
!! at t = 0 after rest. With memory it is not the whole state, so starts are perturbed, not
!! states on orbits.
module viscovib_basins_job
  use viscovib_basin_rules, only: check_orbit, comes_to_rest, disturbances, find_orbits, has_left, &
    n_disturbed, unsettled
  use viscovib_constants, only: pi
  use viscovib_job, only: job_report, job_type, plan_line, plan_unwanted, table_sink
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  use viscovib_many_motions, only: many_motions
  use viscovib_many_runs, only: many_runs
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_subject, only: name_length, subject_type
  use viscovib_subject_motion, only: fastest_of, move_subject, new_motion
  use viscovib_table, only: table_type
  use viscovib_time_run, only: run_completed, run_names
  use viscovib_trajectory, only: trajectory_type
  use viscovib_transient_job, only: transient_job
  implicit none
  private

  public :: basins_job

  !> Length of the name of a velocity, which ends in _dot.
  integer, parameter, public :: length = name_length + 4
  !> Number of motions for the search of the step, their accuracy, and the number of periods.
  integer, parameter :: n_probes = 16
  real(wp), parameter :: probed = 1.0e-6_wp, probed_periods = 3.0_wp
  !> Relative time after the run at which the state is compared again, without a load.
  real(wp), parameter :: again = 0.1_wp

  type, extends(job_type) :: basins_job
    !> The two varied numbers of the state, their indices in it, and their values.
    character(len=length) :: names(2) = ''
    integer :: places(2) = [1, 2]
    real(wp), allocatable :: x(:), y(:)
    !> The other numbers of the start.
    real(wp), allocatable :: initial(:)
    !> Frequency of the load of a polynomial system.
    real(wp) :: nu = 0.0_wp
    !> Length of the runs: a time, or periods of load `sections` if that is not 0.
    real(wp) :: t_end = 0.0_wp
    integer :: n_periods = 0, sections = 0
    !> Longest period considered, and largest distance of states that count as equal.
    integer :: max_period = 8
    real(wp) :: tolerance = 1.0e-4_wp
    !> Step size; 0: determined from some of the motions.
    real(wp) :: dt = 0.0_wp
  contains
    procedure :: plan => plan_basins
    procedure :: run
    procedure, private :: starts
    procedure, private :: find_step
    procedure, private :: make
  end type basins_job

  !> Results for each start, and for each attractor.
  type :: basins_type
    integer, allocatable :: labels(:), ended(:)
    real(wp), allocatable :: moved(:)
    real(wp), allocatable :: rest(:)
    !> Points of the attractors, those of the first one first, shape (width, n), and the number of
    !! points of each.
    real(wp), allocatable :: points(:, :)
    integer, allocatable :: periods(:)
    integer(i8) :: n_steps = 0
  end type basins_type

contains

  subroutine plan_basins(self, subject, text, status)
    class(basins_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status

    call set_ok(status)
    text = 'computes: '//things(size(self%x)*size(self%y), 'motion')//', '//trim(self%names(1)) &
           //' = '//show(self%x(1))//' to '//show(self%x(size(self%x)))//', ' &
           //trim(self%names(2))//' = '//show(self%y(1))//' to '//show(self%y(size(self%y))) &
           //', '
    if (subject%goes_side_by_side()) then
      text = text//show(n_lanes)//' side by side'//new_line('a')
    else
      text = text//'one after another'//new_line('a')
    end if
    text = text//plan_line(.not. self%dt > 0.0_wp, 'the step, by which some of the motions are ' &
                           //'exact to '//show(probed)//' over '//show(probed_periods) &
                           //' periods', 'search for the step (it is given)') &
           //plan_line(self%sections > 0, 'motions of up to '//things(self%max_period, 'period') &
                       //' of the load', 'periodic motions (there is no load: equilibria)') &
           //'computes: stability of each attractor, by perturbed motions'//new_line('a') &
           //plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_basins

  subroutine run(self, subject, sink, report, status)
    class(basins_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(basins_type) :: found
    real(wp), allocatable :: states(:, :), points(:, :, :), scale(:), largest(:)
    integer, allocatable :: periods(:), shown(:)
    logical, allocatable :: good(:)
    real(wp) :: dt, fastest
    integer :: n, n_orbits, most

    call self%starts(size(subject%coordinates), states)
    call fastest_of(subject, self%nu, fastest, status)
    if (status%failed()) return
    fastest = max(fastest, self%nu)
    dt = self%dt
    if (.not. dt > 0.0_wp) call self%find_step(subject, states, fastest, dt, status)
    if (.not. status%failed()) call self%make(subject, states, dt, points, found, status)
    if (.not. status%failed()) call find_largest(self, subject, states, dt, largest, status)
    if (status%failed()) return
    n = size(states, 2)
    allocate (found%labels(n), found%moved(n), periods(n), shown(n), scale(size(states, 1)))
    most = merge(self%max_period, 1, self%sections > 0)
    call find_orbits(largest, points, found%ended == run_completed, most, self%tolerance, fastest, &
                     scale, found%labels, periods, found%moved, shown, n_orbits)
    call check_all(self, subject, states, points, shown(:n_orbits), periods, scale, dt, found, &
                   good, status)
    if (.not. status%failed()) call put_tables(self, subject, states, found, sink, status)
    if (status%failed()) return
    report%complete = all(found%labels >= 0)
    report%summary = things(size(found%rest), 'attractor')//', '//show(count(found%labels >= 0)) &
                     //' of '//things(n, 'start')//' settle, ' &
                     //things(int(min(found%n_steps, int(huge(1), i8))), 'step')//' each'
  end subroutine run

  !> All starts; x varies faster.
  subroutine starts(self, n_dof, states)
    class(basins_job), intent(in) :: self
    integer, intent(in) :: n_dof
    real(wp), allocatable, intent(out) :: states(:, :)
    integer :: i, j, k

    allocate (states(2*n_dof, size(self%x)*size(self%y)))
    k = 0
    do j = 1, size(self%y)
      do i = 1, size(self%x)
        k = k + 1
        states(:, k) = self%initial
        states(self%places(1), k) = self%x(i)
        states(self%places(2), k) = self%y(j)
      end do
    end do
  end subroutine starts

  !> Step size that is accurate for some of the motions over three periods of the fastest mode.
  subroutine find_step(self, subject, states, fastest, dt, status)
    class(basins_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: states(:, :), fastest
    real(wp), intent(out) :: dt
    type(status_type), intent(out) :: status
    type(many_runs) :: runs
    type(many_motions) :: many
    real(wp) :: span, of_all, change
    integer(i8) :: n
    logical :: met

    met = .false.
    dt = 0.0_wp
    if (.not. fastest > 0.0_wp) then
      call fail(status, status_input_error, 'dt', 'dt: the system has no linear period, must be ' &
                //'given')
      return
    end if
    span = probed_periods*2.0_wp*pi/fastest
    runs%starts = states(:, ::max(1, size(states, 2)/n_probes))
    if (.not. subject%goes_side_by_side()) then
      call step_of_singles(subject, self%nu, runs%starts, span, probed, dt, status)
      if (status%failed()) call report_step(show(probed), status)
      if (status%failed()) return
    else
      runs%subject => subject
      runs%nu = self%nu
      call runs%lay_out(span, of_all, status)
      if (status%failed()) return
      n = max(ceiling(span*of_all/(0.5_wp*pi), i8), 1_i8)
      call runs%refine(n, 0.0_wp, probed, many, change, met, status)
      if (status%failed()) return
      if (.not. met) then
        call report_step(show(probed)//' (with '//show(real(n, wp))//' steps)', status)
        return
      end if
      dt = span/n
    end if
    if (self%sections == 0) dt = min(dt, self%t_end)

  contains

    subroutine report_step(how, status)
      character(len=*), intent(in) :: how
      type(status_type), intent(out) :: status
      call fail(status, status_input_error, 'dt', 'dt: none follows the first periods of some of ' &
                //'the motions to '//how//', must be given')
    end subroutine report_step

  end subroutine find_step

  !> All motions, and the last points of each.
  subroutine make(self, subject, states, dt, points, found, status)
    class(basins_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: states(:, :), dt
    real(wp), allocatable, intent(out) :: points(:, :, :)
    type(basins_type), intent(inout) :: found
    type(status_type), intent(out) :: status
    type(many_motions) :: many, more
    integer(i8) :: n_more

    call make_some(self, subject, states, self%t_end, dt, 2*self%max_period, many, &
                   found%n_steps, status)
    if (status%failed()) return
    found%ended = many%ended
    if (self%sections > 0) then
      call move_alloc(many%sections, points)
      return
    end if
    if (subject%has_hidden_state()) then
      ! Its memory is not part of its state.
      call make_some(self, subject, states, (1.0_wp + again)*self%t_end, dt, 0, more, n_more, &
                     status)
    else
      ! A tenth of a short run may be less than a step.
      call make_some(self, subject, many%state, again*self%t_end, &
                     min(self%t_end/found%n_steps, again*self%t_end), 0, more, n_more, status)
    end if
    if (status%failed()) return
    ! A motion that leaves within that time has no state to compare.
    where (found%ended == run_completed) found%ended = more%ended
    allocate (points(size(states, 1), 2, size(states, 2)))
    points(:, 1, :) = many%state
    points(:, 2, :) = more%state
  end subroutine make

  !> Largest absolute value of each number of a state in all starts, and in some of the motions:
  !! numbers that start and end at 0 may be large on the way.
  subroutine find_largest(self, subject, states, dt, largest, status)
    type(basins_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: states(:, :), dt
    real(wp), allocatable, intent(out) :: largest(:)
    type(status_type), intent(out) :: status
    type(basins_job) :: whole
    type(many_motions) :: many
    integer(i8) :: n
    integer :: i

    largest = maxval(abs(states), 2)
    ! From the start on, independent of the kept states.
    whole = self
    whole%sections = 0
    whole%n_periods = 0
    if (self%sections > 0) then
      if (subject%is_pendulum) then
        whole%t_end = subject%pendulum%parameters%frequency(self%sections)
      else
        whole%t_end = self%nu
      end if
      whole%t_end = self%n_periods*2.0_wp*pi/whole%t_end
    end if
    call make_some(whole, subject, states(:, ::max(1, size(states, 2)/n_probes)), whole%t_end, &
                   dt, 0, many, n, status, peaks=.true.)
    if (status%failed()) return
    do i = 1, size(many%ended)
      if (many%ended(i) == run_completed) largest = max(largest, many%peak(:, i))
    end do
  end subroutine find_largest

  !> Motions from some states, and the number of steps of each.
  subroutine make_some(self, subject, states, t_end, dt, n_points, many, n, status, peaks)
    type(basins_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: states(:, :), t_end, dt
    !> States that are kept at the last periods of the load.
    integer, intent(in) :: n_points
    type(many_motions), intent(out) :: many
    integer(i8), intent(out) :: n
    type(status_type), intent(out) :: status
    !> Whether to compute the largest value of each number on the way.
    logical, intent(in), optional :: peaks
    type(many_runs) :: runs
    real(wp) :: of_all

    n = 0
    if (present(peaks)) runs%moments = peaks
    runs%subject => subject
    runs%starts = states
    runs%nu = self%nu
    runs%sections = self%sections
    runs%n_periods = self%n_periods
    runs%periods_before = runs%n_periods - n_points
    call runs%lay_out(t_end, of_all, status)
    if (.not. status%failed() .and. dt > runs%spans(1)) then
      call fail(status, status_input_error, 'dt', 'dt = '//show(dt)//': must not exceed the ' &
                //'length of the runs, '//show(runs%spans(1)))
    end if
    if (.not. status%failed()) call runs%steps_of(dt, n, status)
    if (.not. status%failed()) call runs%make(n, many, status)
  end subroutine make_some

  !> Remove orbits that do not attract; motions that settle on them count as unsettled.
  subroutine check_all(self, subject, states, points, shown, periods, scale, dt, found, good, &
                       status)
    class(basins_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: states(:, :), points(:, :, :), scale(:), dt
    !> Representative motions of the orbits, and the period of each motion.
    integer, intent(in) :: shown(:), periods(:)
    type(basins_type), intent(inout) :: found
    logical, allocatable, intent(out) :: good(:)
    type(status_type), intent(out) :: status
    type(many_motions) :: many
    real(wp) :: pushes(size(scale), n_disturbed), rest(size(shown)), place(size(scale))
    real(wp), allocatable :: nearby(:, :), later(:, :, :)
    logical :: by_starts, has_kernels
    integer :: new(has_left:size(shown) - 1), i, j, n
    integer(i8) :: n_steps

    call set_ok(status)
    allocate (good(size(shown)), nearby(size(scale), n_disturbed*size(shown)))
    n = size(points, 2)
    call disturbances(self%tolerance, pushes)
    by_starts = subject%has_hidden_state()
    do i = 1, size(shown)
      place = points(:, n, shown(i))
      if (by_starts) place = states(:, shown(i))
      do j = 1, n_disturbed
        nearby(:, (i - 1)*n_disturbed + j) = place + pushes(:, j)*scale
      end do
    end do
    if (size(shown) > 0) then
      call make_some(self, subject, nearby, self%t_end, dt, 1, many, n_steps, status)
      if (status%failed()) return
    end if
    has_kernels = subject%has_kernels()
    if (by_starts .and. .not. has_kernels .and. size(shown) > 0) then
      call find_later(self, subject, states(:, shown), dt, n, later, status)
      if (status%failed()) return
    end if
    new = unsettled
    new(has_left) = has_left
    n = 0
    do i = 1, size(shown)
      j = (i - 1)*n_disturbed
      call check_orbit(many%state(:, j + 1:j + n_disturbed), &
                       many%ended(j + 1:j + n_disturbed) == run_completed, &
                       points(:, size(points, 2) - periods(shown(i)) + 1:, shown(i)), scale, &
                       self%tolerance, by_starts, has_kernels, good(i), rest(i))
      if (allocated(later)) then
        good(i) = good(i) .and. comes_to_rest(points(:, :, shown(i)), later(:, :, i), &
                                              periods(shown(i)), scale)
      end if
      if (.not. good(i)) cycle
      new(i - 1) = n
      n = n + 1
    end do
    found%labels = new(found%labels)
    found%rest = pack(rest, good)
    found%periods = pack(periods(shown), good)
    allocate (found%points(size(scale), sum(found%periods)))
    n = 0
    do i = 1, size(shown)
      if (.not. good(i)) cycle
      j = periods(shown(i))
      found%points(:, n + 1:n + j) = points(:, size(points, 2) - j + 1:, shown(i))
      n = n + j
    end do
  end subroutine check_all

  !> The last points of some motions in runs twice as long.
  subroutine find_later(self, subject, starts, dt, n_points, later, status)
    class(basins_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: starts(:, :), dt
    integer, intent(in) :: n_points
    real(wp), allocatable, intent(out) :: later(:, :, :)
    type(status_type), intent(out) :: status
    type(basins_job) :: longer
    type(many_motions) :: many
    integer(i8) :: n
    integer :: i

    longer = self
    longer%n_periods = 2*self%n_periods
    allocate (later(size(starts, 1), n_points, size(starts, 2)))
    do i = 1, merge(1, n_points, self%sections > 0)
      call make_some(longer, subject, starts, (2.0_wp + again*(i - 1))*self%t_end, dt, n_points, &
                     many, n, status)
      if (status%failed()) return
      if (self%sections > 0) then
        later = many%sections
      else
        later(:, i, :) = many%state
      end if
    end do
  end subroutine find_later

  !> A row for each start; and one for each point of the attractors.
  subroutine put_tables(self, subject, states, found, sink, status)
    class(basins_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: states(:, :)
    type(basins_type), intent(in), target :: found
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table, attractors
    real(wp) :: share(size(found%rest))
    character(len=:), allocatable :: name
    integer, dimension(size(found%points, 2)) :: which, place
    integer :: i, j, k, n

    call table%note('attractor: its number in the other table, -1: has not settled, -2: the run ' &
                    //'did not reach its end; moved: change in a period (without a load in a ' &
                    //'tenth of the run), of the scale of tolerance')
    do i = 1, 2
      call table%hold_reals(trim(self%names(i)), states(self%places(i), :))
    end do
    call table%add_integers('attractor', found%labels)
    call table%add_words('outcome', found%ended, run_names)
    call table%add_reals('moved', found%moved)
    call sink%put(self%kind, table, status)
    if (status%failed()) return
    n = 0
    do i = 1, size(share)
      k = found%periods(i)
      which(n + 1:n + k) = i
      place(n + 1:n + k) = [(j, j=1, k)]
      n = n + k
      share(i) = count(found%labels == i - 1)/real(size(found%labels), wp)
    end do
    call attractors%note('states of each attractor, a period of the load apart; share: part of ' &
                         //'the starts that settle there; rest: part of a disturbance that is ' &
                         //'left after a run as long again')
    call attractors%hold_integers('attractor', which - 1)
    call attractors%hold_integers('point', place)
    call attractors%hold_reals('share', share(which))
    call attractors%hold_reals('rest', found%rest(which))
    do i = 1, size(self%wanted)
      j = self%wanted(i)
      name = trim(subject%coordinates(j))
      call attractors%hold_reals(name, found%points(2*j - 1, :))
      call attractors%hold_reals(name//'_dot', found%points(2*j, :))
    end do
    call sink%put(self%kind//'_1', attractors, status)
  end subroutine put_tables

  !> The shortest of the steps that integrate each of some motions to a relative error.
  subroutine step_of_singles(subject, nu, starts, t_end, relative, dt, status)
    type(subject_type), intent(in), target :: subject
    real(wp), intent(in) :: nu, starts(:, :), t_end, relative
    real(wp), intent(out) :: dt
    type(status_type), intent(out) :: status
    class(transient_job), allocatable :: motion
    type(trajectory_type) :: trajectory
    integer :: i, places(size(starts, 1)/2)

    call set_ok(status)
    places = [(i, i=1, size(places))]
    dt = t_end
    do i = 1, size(starts, 2)
      call new_motion(subject, nu, starts(:, i), t_end, motion)
      motion%relative = relative
      motion%last_only = .true.
      call move_subject(motion, subject, nu, places, trajectory, status)
      if (status%failed()) return
      dt = min(dt, trajectory%h)
    end do
  end subroutine step_of_singles

end module viscovib_basins_job
