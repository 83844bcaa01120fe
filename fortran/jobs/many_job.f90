!> Many motions, one for each value of a number, in lanes or one after another: last states, peaks,
!! exponents and sections.
module viscovib_many_job
  use viscovib_column_notes, only: step_given_note, step_halved_note
  use viscovib_constants, only: pi
  use viscovib_job, only: error_text, job_report, job_type, plan_line, plan_unwanted, table_sink
  use viscovib_kinds, only: i8, wp
  use viscovib_known_motion, only: repeat_motion
  use viscovib_lanes, only: n_lanes
  use viscovib_many_motions, only: many_motions
  use viscovib_many_runs, only: many_runs
  use viscovib_motion_quantities, only: find_peaks, find_quantities, motion_quantities, &
    put_peaks, quantity_length
  use viscovib_rounded, only: error_digits
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_subject_motion, only: move_subject, new_motion
  use viscovib_table, only: listed, table_type
  use viscovib_time_run, only: run_completed, run_names
  use viscovib_trajectory, only: trajectory_type
  use viscovib_transient_job, only: transient_job
  use viscovib_varied_system, only: varied_system
  implicit none
  private

  public :: many_job

  type, extends(job_type) :: many_job
    !> The varied number and its values; its index among the names.
    character(len=:), allocatable :: vary
    integer :: place = 1
    real(wp), allocatable :: values(:)
    !> Builds the systems if a parameter of laws varies.
    class(varied_system), allocatable :: varied
    !> One start for all; the frequency of the load of a polynomial system, if it is given.
    real(wp), allocatable :: initial(:)
    real(wp) :: nu = 0.0_wp
    !> Length of the runs, and of the part before accumulation begins: times, or periods of
    !! load `sections` if that is not 0.
    real(wp) :: t_end = 0.0_wp, discard = 0.0_wp
    integer :: n_periods = 0, sections = 0
    !> Step size; 0: determined by the allowed error of last states, peaks and means.
    real(wp) :: dt = 0.0_wp
    !> Allowed error, and in addition relative to the largest value of each coordinate.
    real(wp) :: absolute = 0.0_wp, relative = 0.0_wp
    !> Frequencies of amplitudes (rad/s); not allocated: none. Steps between the samples for them.
    real(wp), allocatable :: lines(:)
    integer :: sample_every = 1
    !> Index in `lane_methods`; of motions that are computed by themselves in their methods.
    integer :: method = 4
    logical :: side_by_side = .true.
    logical :: lyapunov = .false.
    !> Whether peaks are wanted, also of accelerations and of mount forces.
    logical :: wants_peaks = .false., wants_accelerations = .false., wants_forces = .false.
  contains
    procedure :: plan => plan_many
    procedure :: run
  end type many_job

contains

  subroutine plan_many(self, subject, text, status)
    class(many_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status

    call set_ok(status)
    text = 'computes: '//things(size(self%values), 'motion')//', '//self%vary//' = ' &
           //show(self%values(1))//' to '//show(self%values(size(self%values)))//', '
    if (self%side_by_side) then
      text = text//show(n_lanes)//' side by side'//new_line('a')
    else
      text = text//'one after another'//new_line('a')
    end if
    if (self%dt > 0.0_wp) then
      text = text//step_given_note//new_line('a')
    else
      text = text//step_halved_note//error_of(self)//new_line('a')
    end if
    text = text//'computes: peaks, means and rms'//new_line('a')
    if (allocated(self%lines)) then
      text = text//'computes: amplitudes at '//things(size(self%lines), 'frequency', &
                                                      'frequencies')//new_line('a')
    else
      text = text//'skips: amplitudes (not requested)'//new_line('a')
    end if
    text = text//plan_line(self%sections > 0, 'sections', 'sections (not requested)')
    if (self%wants_peaks) text = text//'computes: peaks between steps, each motion once more' &
                                 //new_line('a')
    text = text//plan_line(self%lyapunov, 'Lyapunov exponents', &
                           'Lyapunov exponents (not requested)') &
           //plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_many

  subroutine run(self, subject, sink, report, status)
    class(many_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(many_runs) :: runs
    type(many_motions) :: many
    real(wp) :: fastest, change
    integer(i8) :: n
    logical :: met

    call lay_out(self, subject, runs, fastest, status)
    if (status%failed()) return
    if (self%dt > maxval(runs%spans)) then
      call fail(status, status_input_error, 'dt', 'dt = '//show(self%dt)//': must not exceed the ' &
                //'length of the runs, '//show(maxval(runs%spans)))
    else if (self%dt > 0.0_wp) then
      call runs%steps_of(self%dt, n, status)
    else
      call runs%steps_of(0.5_wp*pi/fastest, n, status)
    end if
    if (status%failed()) return
    if (self%dt > 0.0_wp) then
      call runs%make(n, many, status)
      change = -1.0_wp
    else
      call runs%refine(n, self%absolute, self%relative, many, change, met, status)
      if (.not. (met .or. status%failed())) then
        call fail(status, status_input_error, 'tolerance', 'tolerance = '//error_of(self) &
                  //': not met with '//show(real(n, wp))//' steps; some motion may be chaotic: ' &
                  //'give dt')
      end if
    end if
    if (.not. status%failed()) call check_samples(self, runs%spans, n, status)
    if (status%failed()) return
    call put_tables(self, subject, many, change, sink, status)
    if (status%failed()) return
    if (self%wants_peaks) call put_peaks_of_motions(self, runs, many%ended, n, sink, status)
    report%complete = all(many%ended == run_completed)
    report%summary = things(size(self%values), 'motion')//', ' &
                     //show(count(many%ended == run_completed))//' completed, ' &
                     //things(int(min(n, int(huge(1), i8))), 'step')//' each'
    if (change >= 0.0_wp) report%summary = report%summary//', estimated error ' &
                                           //error_digits(change)
  end subroutine run

  !> The allowed error as a text.
  function error_of(self) result(text)
    class(many_job), intent(in) :: self
    character(len=:), allocatable :: text
    text = show(self%absolute)
    if (self%relative > 0.0_wp) text = show(self%relative)//' of the largest'
    if (min(self%absolute, self%relative) > 0.0_wp) text = show(self%absolute)//' and '//text
  end function error_of

  !> Fail if samples are too far apart for a frequency of amplitudes.
  subroutine check_samples(self, spans, n, status)
    class(many_job), intent(in) :: self
    !> Lengths of the motions, in n steps each.
    real(wp), intent(in) :: spans(:)
    integer(i8), intent(in) :: n
    type(status_type), intent(inout) :: status
    real(wp) :: apart

    if (.not. allocated(self%lines)) return
    apart = self%sample_every*maxval(spans)/n
    if (maxval(self%lines)*apart < pi) return
    call fail(status, status_input_error, 'sample_every', 'sample_every = ' &
              //show(self%sample_every)//': states '//show(apart)//' apart resolve no frequency ' &
              //'of '//show(pi/apart)//' or more, amplitudes_at has '//show(maxval(self%lines)) &
              //': must be smaller')
  end subroutine check_samples

  !> Set up the motions.
  subroutine lay_out(self, subject, runs, fastest, status)
    class(many_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    type(many_runs), intent(out) :: runs
    real(wp), intent(out) :: fastest
    type(status_type), intent(out) :: status

    runs%subject => subject
    runs%place = self%place
    runs%values = self%values
    if (allocated(self%varied)) allocate (runs%varied, source=self%varied)
    runs%starts = spread(self%initial, 2, size(self%values))
    runs%nu = self%nu
    if (self%side_by_side) then
      runs%method = self%method
    else
      runs%own_method = self%method
      runs%wanted = self%wanted
    end if
    runs%sections = self%sections
    runs%n_periods = self%n_periods
    if (self%n_periods > 0) then
      runs%periods_before = nint(self%discard)
    else
      runs%discard = self%discard
    end if
    runs%moments = .true.
    if (allocated(self%lines)) runs%lines = self%lines
    runs%sample_every = self%sample_every
    runs%lyapunov = self%lyapunov
    call runs%lay_out(self%t_end, fastest, status)
    if (.not. fastest > 0.0_wp) fastest = pi/maxval(runs%spans)
  end subroutine lay_out

  !> A row for each motion; and one for each point of the sections of motions that were completed.
  subroutine put_tables(self, subject, many, error, sink, status)
    class(many_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(many_motions), intent(in), target :: many
    !> Negative: unknown.
    real(wp), intent(in) :: error
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table, points
    character(len=:), allocatable :: name
    integer, allocatable :: whole(:)
    integer :: i, j, k, n

    call table%note('last states, largest sizes, means and rms of each motion'//error_text(error))
    call table%hold_reals(self%vary, self%values)
    call table%add_words('outcome', many%ended, run_names)
    call table%add_reals('t_reached', many%t_reached)
    do i = 1, size(self%wanted)
      j = self%wanted(i)
      name = trim(subject%coordinates(j))
      call table%hold_reals(name, many%state(2*j - 1, :))
      call table%hold_reals(name//'_dot', many%state(2*j, :))
      call table%hold_reals('peak_'//name, many%peak(2*j - 1, :))
      call table%hold_reals('mean_'//name, many%mean(2*j - 1, :))
      call table%hold_reals('rms_'//name, many%rms(2*j - 1, :))
    end do
    if (allocated(self%lines)) then
      call table%note('amplitudes at'//listed(self%lines)//' rad/s')
    end if
    do i = 1, size(self%wanted)*size(many%amplitudes, 2)
      j = self%wanted((i - 1)/size(many%amplitudes, 2) + 1)
      k = modulo(i - 1, size(many%amplitudes, 2)) + 1
      call table%add_complex(trim(subject%coordinates(j))//'_'//show(k), &
                             many%amplitudes(j, k, :))
    end do
    if (self%lyapunov) then
      call table%add_reals('lyapunov', many%lyapunov(1, :))
      call table%add_reals('lyapunov_error', many%lyapunov_error(1, :))
    end if
    call sink%put(self%kind, table, status)
    if (status%failed() .or. self%sections == 0) return
    whole = pack([(i, i=1, size(self%values))], many%ended == run_completed)
    n = size(many%sections, 2)
    call points%note('states at whole periods of load '//show(self%sections) &
                     //', of the motions that were completed')
    call points%hold_reals(self%vary, [(spread(self%values(whole(i)), 1, n), i=1, size(whole))])
    call points%hold_integers('point', [((k, k=1, n), i=1, size(whole))])
    do i = 1, size(self%wanted)
      j = self%wanted(i)
      name = trim(subject%coordinates(j))
      call points%hold_reals(name, pack(many%sections(2*j - 1, :, whole), .true.))
      call points%hold_reals(name//'_dot', pack(many%sections(2*j, :, whole), .true.))
    end do
    call sink%put(self%kind//'_1', points, status)
  end subroutine put_tables

  !> Located peaks of all motions that were completed; each is made once more.
  subroutine put_peaks_of_motions(self, runs, ended, n_steps, sink, status)
    class(many_job), intent(in) :: self
    type(many_runs), intent(in) :: runs
    integer, intent(in) :: ended(:)
    integer(i8), intent(in) :: n_steps
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    character(len=quantity_length), allocatable :: names(:)
    real(wp), allocatable :: peaks(:, :), all_peaks(:, :), values(:)
    integer, allocatable :: which(:)
    integer :: i, k

    call set_ok(status)
    allocate (all_peaks(3, 0), values(0), which(0), names(0))
    do i = 1, size(self%values)
      if (ended(i) /= run_completed) cycle
      call find_peaks_of_motion(self, runs, i, n_steps, names, peaks, status)
      if (status%failed()) return
      all_peaks = reshape([all_peaks, peaks], [3, size(which) + size(names)])
      values = [values, (self%values(i), k=1, size(names))]
      which = [which, (k, k=1, size(names))]
    end do
    call put_peaks(names, which, all_peaks, sink, status, self%vary, values)
  end subroutine put_peaks_of_motions

  !> Located peaks of one motion from the time on at which accumulation begins.
  subroutine find_peaks_of_motion(self, runs, i, n_steps, names, peaks, status)
    class(many_job), intent(in) :: self
    type(many_runs), intent(in) :: runs
    integer, intent(in) :: i
    integer(i8), intent(in) :: n_steps
    character(len=quantity_length), allocatable, intent(out) :: names(:)
    real(wp), allocatable, intent(out) :: peaks(:, :)
    type(status_type), intent(out) :: status
    type(subject_type), target :: subject
    class(transient_job), allocatable :: motion
    type(trajectory_type) :: run, late
    type(motion_quantities) :: quantities
    real(wp) :: since
    integer :: k

    call runs%subject_of(i, subject, status)
    if (status%failed()) return
    associate (nu => runs%frequency(i), span => runs%spans(i))
      call new_motion(subject, nu, self%initial, span, motion)
      motion%method = runs%own_method
      if (self%dt > 0.0_wp) then
        motion%dt = span/n_steps
      else
        motion%tolerance = self%absolute
        motion%relative = self%relative
      end if
      motion%wants_forces = self%wants_forces
      call move_subject(motion, subject, nu, [(k, k=1, size(self%initial)/2)], run, status)
      if (status%failed()) return
      since = self%discard
      if (self%n_periods > 0) since = span*nint(self%discard)/self%n_periods
      if (since > 0.0_wp) then
        call repeat_motion(motion, subject, nu, run, [since, pack(run%t, run%t > since)], .false., &
                           late, status)
        if (status%failed()) return
        late%error = run%error
        call run%become(late)
      end if
      call find_quantities(motion, subject, nu, self%wants_accelerations, run, quantities, status)
      if (status%failed()) return
      motion%wants_accelerations = self%wants_accelerations
      call find_peaks(motion, subject, nu, self%wanted, run, quantities, names, peaks, status)
    end associate
  end subroutine find_peaks_of_motion

end module viscovib_many_job
