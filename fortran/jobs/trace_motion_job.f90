!> A branch of periodic motions in time along the frequency or the factor of the load.
module viscovib_trace_motion_job
  use viscovib_job, only: job_report, job_type, plan_unwanted, table_sink
  use viscovib_kinds, only: wp
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_motion_branch, only: branch_completed, branch_endings, branch_options, &
    check_branch, motion_branch, trace_motion
  use viscovib_motion_events, only: event_fold, event_grazing, event_names
  use viscovib_motion_path, only: plain_family
  use viscovib_number_text, only: exact
  use viscovib_period_map, only: new_period_map
  use viscovib_status, only: show, status_type, things
  use viscovib_steady_motion_job, only: check_repeats
  use viscovib_subject, only: subject_type
  use viscovib_table, only: listed_units, table_type
  implicit none
  private

  public :: trace_motion_job

  type, extends(job_type) :: trace_motion_job
    !> True if the frequency varies, else the factor of the load.
    logical :: is_frequency = .true.
    !> Frequency of the load (rad/s), at the start of the range if it varies.
    real(wp) :: nu = 0.0_wp
    integer :: n_periods = 1
    !> Index in `transient_methods`.
    integer :: method = 1
    type(branch_options) :: options
  contains
    procedure :: plan => plan_branch
    procedure :: run
    procedure, private :: varies
    procedure, private :: make_family
  end type trace_motion_job

contains

  pure function varies(self)
    class(trace_motion_job), intent(in) :: self
    character(len=:), allocatable :: varies
    varies = trim(merge('nu         ', 'load_factor', self%is_frequency))
  end function varies

  subroutine make_family(self, subject, family, status)
    class(trace_motion_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    type(plain_family), intent(out) :: family
    type(status_type), intent(out) :: status
    call check_repeats(subject, self%kind, status)
    if (status%failed()) return
    family%is_frequency = self%is_frequency
    call new_period_map(family%map, subject%polynomial, subject%load, self%nu, self%n_periods, &
                        self%method, status)
    if (self%is_frequency .and. .not. status%failed()) then
      call subject%load%check_between(self%options%start, self%options%finish, status)
    end if
  end subroutine make_family

  subroutine plan_branch(self, subject, text, status)
    class(trace_motion_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    type(plain_family) :: family

    text = ''
    call self%make_family(subject, family, status)
    if (status%failed()) return
    text = subject%description()//'computes: motions that repeat after ' &
           //things(self%n_periods, 'period')//' of the load, by shooting with ' &
           //trim(transient_methods(self%method))//', along '//self%varies()//' from ' &
           //show(self%options%start)//' to '//show(self%options%finish)//new_line('a') &
           //'computes: folds, branch points, period doublings, Neimark-Sacker points, grazing, ' &
           //'Floquet multipliers'//new_line('a')//plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_branch

  subroutine run(self, subject, sink, report, status)
    class(trace_motion_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(plain_family), target :: family
    type(motion_branch) :: branch
    character(len=:), allocatable :: doubts

    call self%make_family(subject, family, status)
    if (status%failed()) return
    call trace_motion(family, self%options, branch)
    call check_branch(branch, self%varies(), self%options%start, doubts, status)
    if (status%failed()) return
    call put_branch(self, subject, branch, sink, status)
    report%complete = branch%outcome == branch_completed
    report%summary = trim(branch_endings(branch%outcome))//', '//things(branch%n_points, 'point') &
                     //', '//things(count(branch%kind == event_fold), 'fold')//', ' &
                     //things(count(branch%kind == event_grazing), 'grazing')//doubts
  end subroutine run

  !> One row per point.
  subroutine put_branch(self, subject, branch, sink, status)
    type(trace_motion_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(motion_branch), intent(in) :: branch
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table
    character(len=:), allocatable :: name
    integer :: d, i, k, n

    n = branch%n_points
    call table%note('periodic motions along '//self%varies()//', ' &
                    //trim(branch_endings(branch%outcome))//'; over ' &
                    //things(self%n_periods, 'period')//' of the load, method ' &
                    //trim(transient_methods(self%method)))
    do i = 1, size(branch%kind)
      call table%note(event_note(self, branch, i))
    end do
    call table%note('stable: 1, not: 0, undecided: -1; multiplier: size of the largest; error: ' &
                    //'estimated, of the state at t = 0 with velocities divided by nu')
    call table%note('units: nu in rad/s, ' &
                    //listed_units(subject%coordinates(self%wanted), subject%units(self%wanted)))
    associate (motions => branch%motions(:n))
      call table%hold_reals(self%varies(), branch%p(:n))
      call table%hold_integers('stable', [(motions(i)%stability(), i=1, n)])
      call table%hold_reals('multiplier', [(abs(motions(i)%multipliers(1)), i=1, n)])
      call table%hold_integers('switches', motions%found%n_passed)
      call table%hold_integers('repeats_after', branch%repeats_after(:n))
      call table%hold_reals('error', motions%error)
      do k = 1, size(self%wanted)
        d = self%wanted(k)
        name = trim(subject%coordinates(d))
        call table%hold_reals(name, [(motions(i)%found%state(2*d - 1), i=1, n)])
        call table%hold_reals(name//'_dot', [(motions(i)%found%state(2*d), i=1, n)])
        call table%hold_reals(name//'_min', branch%low(d, :n))
        call table%hold_reals(name//'_max', branch%high(d, :n))
      end do
    end associate
    call sink%put(self%kind, table, status)
  end subroutine put_branch

  !> The line about an event.
  function event_note(self, branch, i) result(text)
    type(trace_motion_job), intent(in) :: self
    type(motion_branch), intent(in) :: branch
    integer, intent(in) :: i
    character(len=:), allocatable :: text
    text = trim(event_names(branch%kind(i)))//' after point '//show(branch%before(i))
    associate (place => branch%place(i))
      if (.not. abs(place) <= huge(place)) then
        text = text//', not located'
        return
      end if
      text = text//' at '//self%varies()//' = '//trim(exact(place))//', estimated error ' &
             //trim(exact(branch%place_error(i)))
    end associate
    if (.not. branch%is_sure(i)) text = text//', stability next to it is undecided'
  end function event_note

end module viscovib_trace_motion_job
