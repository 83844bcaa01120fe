!> A periodic motion of a polynomial system, or of a structure by its complete equations, by
!! shooting: the motion over its period, and its Floquet multipliers.
module viscovib_steady_motion_job
  use viscovib_job, only: job_report, job_type, plan_line, plan_unwanted, table_sink
  use viscovib_kinds, only: wp
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_number_text, only: exact
  use viscovib_outcomes, only: outcome_converged, outcome_names
  use viscovib_period_map, only: new_period_map, period_map
  use viscovib_shooting, only: accuracy_type, check_repeating, find_shortest_period, &
    show_repeating, steady_doubt, steady_from_rest, steady_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_table, only: listed_units, table_type
  implicit none
  private

  public :: check_repeats, steady_motion_job

  type, extends(job_type) :: steady_motion_job
    !> Frequency of the load (rad/s), and periods of it after which the motion repeats.
    real(wp) :: nu = 0.0_wp
    integer :: n_periods = 1
    !> Index in `transient_methods`.
    integer :: method = 1
    type(accuracy_type) :: accuracy
    !> A state nearby (2 n_dof); not allocated: the motion from rest settles first.
    real(wp), allocatable :: initial(:)
  contains
    procedure :: plan => plan_steady_motion
    procedure :: run
  end type steady_motion_job

contains

  !> Reject systems without a period map.
  subroutine check_repeats(subject, kind, status)
    type(subject_type), intent(in) :: subject
    !> Name of the requesting group.
    character(len=*), intent(in) :: kind
    type(status_type), intent(out) :: status

    call set_ok(status)
    if (subject%is_structure) then
      call fail(status, status_input_error, kind, '&'//kind//': takes a &structure of at most ' &
                //'512 coordinates that all have mass, without shapes and loss_factor')
    else if (.not. subject%is_polynomial) then
      call fail(status, status_input_error, kind, '&'//kind//': takes a &system, a &structure or ' &
                //'a &body with small rotations (of others see &response and &branch)')
    else if (subject%load%moves_base()) then
      call fail(status, status_input_error, kind, '&'//kind//': the base must be at rest, give ' &
                //'its inertia forces as loads')
    end if
  end subroutine check_repeats

  subroutine plan_steady_motion(self, subject, text, status)
    class(steady_motion_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    type(period_map) :: map

    text = ''
    call check_repeats(subject, self%kind, status)
    if (status%failed()) return
    call new_period_map(map, subject%polynomial, subject%load, self%nu, self%n_periods, &
                        self%method, status)
    if (status%failed()) return
    text = subject%description()//'computes: the motion that repeats after ' &
           //things(self%n_periods, 'period')//' of the load, by shooting with ' &
           //trim(transient_methods(self%method))//' in '//show(real(map%first_steps(), wp)) &
           //' steps and more'//new_line('a')
    text = text//plan_line(.not. allocated(self%initial), &
                           'the motion from rest, from which the search begins', &
                           'the motion from rest (initial is given)') &
           //'computes: Floquet multipliers, '//show(map%n_state())//new_line('a') &
           //plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_steady_motion

  subroutine run(self, subject, sink, report, status)
    class(steady_motion_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(period_map) :: map
    type(steady_type) :: steady
    real(wp), allocatable :: state(:)
    character(len=:), allocatable :: doubt
    integer :: shortest

    call check_repeats(subject, self%kind, status)
    if (status%failed()) return
    call new_period_map(map, subject%polynomial, subject%load, self%nu, self%n_periods, &
                        self%method, status)
    if (status%failed()) return
    if (allocated(self%initial)) then
      allocate (state(map%n_state()), source=0.0_wp)
      state(:size(self%initial)) = self%initial
      call check_repeating(map, state, self%accuracy, steady)
    else
      call steady_from_rest(map, self%accuracy, steady)
    end if
    shortest = find_shortest_period(map, steady)
    call put_motion(self, subject, map, steady, shortest, sink, status)
    if (.not. status%failed()) call put_multipliers(self%kind//'_1', steady, sink, status)
    report%complete = steady%found%outcome == outcome_converged
    report%summary = trim(outcome_names(steady%found%outcome))//', ' &
                     //stability_words(steady)//', repeats after '//things(shortest, 'period') &
                     //', '//things(steady%found%n_passed, 'switch', 'switches')//' of laws'
    call steady_doubt(map, steady, self%accuracy, doubt)
    report%summary = report%summary//doubt
  end subroutine run

  function stability_words(steady) result(words)
    type(steady_type), intent(in) :: steady
    character(len=:), allocatable :: words
    select case (steady%stability())
    case (1)
      words = 'stable'
    case (0)
      words = 'unstable'
    case default
      words = 'stability unknown'
    end select
  end function stability_words

  !> One row per time.
  subroutine put_motion(self, subject, map, steady, shortest, sink, status)
    type(steady_motion_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(period_map), intent(in) :: map
    type(steady_type), intent(in) :: steady
    integer, intent(in) :: shortest
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table
    character(len=:), allocatable :: name
    real(wp), allocatable :: t(:), states(:, :)
    integer :: i

    call show_repeating(map, steady, t, states)
    call table%note('periodic motion, '//trim(outcome_names(steady%found%outcome))//', ' &
                    //stability_words(steady)//'; nu '//trim(exact(self%nu))//', over ' &
                    //things(self%n_periods, 'period')//' of the load, repeats after ' &
                    //show(shortest)//'; '//things(steady%found%n_passed, 'switch', 'switches') &
                    //' of laws')
    call table%note('method '//trim(transient_methods(self%method))//', step ' &
                    //trim(exact(map%period()/steady%n_steps))//', estimated error of the first ' &
                    //'state '//trim(exact(steady%error))//' (velocities divided by nu)')
    call table%note('units: t in s, ' &
                    //listed_units(subject%coordinates(self%wanted), subject%units(self%wanted)))
    call table%hold_reals('t', t)
    do i = 1, size(self%wanted)
      associate (d => self%wanted(i))
        name = trim(subject%coordinates(d))
        call table%hold_reals(name, states(2*d - 1, :))
        call table%hold_reals(name//'_dot', states(2*d, :))
      end associate
    end do
    call sink%put(self%kind, table, status)
  end subroutine put_motion

  !> One row per multiplier, the largest first.
  subroutine put_multipliers(name, steady, sink, status)
    character(len=*), intent(in) :: name
    type(steady_type), intent(in) :: steady
    class(table_sink), intent(inout) :: sink
    type(status_type), intent(out) :: status
    type(table_type) :: table

    call table%note('Floquet multipliers over the period of the motion, '//stability_words(steady) &
                    //', estimated error '//trim(exact(steady%multiplier_error)))
    call table%hold_reals('real', real(steady%multipliers))
    call table%hold_reals('imaginary', aimag(steady%multipliers))
    call table%hold_reals('size', abs(steady%multipliers))
    call sink%put(name, table, status)
  end subroutine put_multipliers

end module viscovib_steady_motion_job
