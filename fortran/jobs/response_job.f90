!> A steady response at given frequencies, of a mount or a polynomial system.
module viscovib_response_job
  use viscovib_column_notes, only: response_note, unsolved_note
  use viscovib_counters, only: count_up, counted_columns, counting
  use viscovib_extra_columns, only: extra_columns
  use viscovib_forced_response, only: forced_response
  use viscovib_job, only: job_report, job_type, plan_unwanted, table_sink
  use viscovib_kinds, only: wp
  use viscovib_motion_checks, only: errors_of, relative_motions
  use viscovib_outcomes, only: outcome_converged, outcome_names
  use viscovib_response, only: response_options, response_type
  use viscovib_response_plan, only: method_linear, method_names, method_successive, &
                                    new_response_plan, response_plan_type
  use viscovib_status, only: show, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: response_job, tabulate_response

  character(len=*), parameter :: lacking = &
    "; forces without a finite slope at rest are left out by method = 'linear', take 'auto'"

  type, extends(job_type) :: response_job
    !> Frequencies (rad/s); index in `method_names`.
    real(wp), allocatable :: nu(:)
    integer :: method = 0
    type(response_options) :: options
    !> Additional columns.
    type(extra_columns) :: extra
  contains
    procedure :: plan => plan_response
    procedure :: run
    procedure :: may_condense
  end type response_job

contains

  !> False if columns need all coordinates; a linear response gains nothing from condensation.
  subroutine may_condense(self, may, stability)
    class(response_job), intent(in) :: self
    logical, intent(out) :: may, stability
    may = self%method /= method_linear .and. .not. (self%extra%sampling .or. self%extra%dissipation)
    stability = .false.
  end subroutine may_condense

  subroutine plan_response(self, subject, text, status)
    class(response_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    type(response_plan_type) :: plan

    text = ''
    call new_response_plan(plan, subject%oscillator(), subject%load, self%nu, self%method, &
                           self%options, status)
    if (status%failed()) return
    call plan%describe(subject%oscillator(), subject%load, size(self%nu))
    text = subject%description()//plan%text//plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_response

  subroutine run(self, subject, sink, report, status)
    class(response_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(response_plan_type) :: plan
    type(response_type), target :: response
    type(table_type) :: table
    type(extra_columns) :: extra
    complex(wp), allocatable :: motions(:, :, :)
    real(wp), allocatable :: errors(:), ones(:)
    integer :: found, short

    call new_response_plan(plan, subject%oscillator(), subject%load, self%nu, self%method, &
                           self%options, status)
    if (status%failed()) return
    call forced_response(plan, subject%oscillator(), subject%load, self%nu, response)
    found = count(response%outcome == outcome_converged)
    allocate (ones(size(self%nu)), source=1.0_wp)
    extra = self%extra
    call extra%find(subject, response%orders, response%nu, ones, response%highest, &
                    plan%method == method_linear, .true., response%coefficients)
    allocate (errors(size(self%nu)))
    allocate (motions, source=response%coefficients)
    call relative_motions(subject%oscillator(), subject%load, response%orders, ones, motions)
    call errors_of(subject%oscillator(), subject%load, response%orders, response%nu, &
                   response%highest, plan%method == method_linear, motions, errors)
    call subject%show_motions(response%nu, ones, response%orders, &
                              self%wanted, .true., response%coefficients, &
                              plan%method == method_linear)
    call tabulate_response(response, subject%coordinates(self%wanted), &
                           subject%units(self%wanted), table, errors, extra)
    call sink%put(self%kind, table, status)
    short = count(pack(response%truncation, response%outcome == outcome_converged) &
                  > pack(response%allowed, response%outcome == outcome_converged))
    report%complete = found == size(self%nu) .and. short == 0
    report%summary = show(found)//' of ' &
                     //things(size(self%nu), 'frequency', 'frequencies')//' solved'
    if (short > 0) report%summary = report%summary//', '//show(short) &
                                    //' of them with too few harmonics'//worst_of(response)
    if (found < size(self%nu)) report%summary = report%summary//gaps_of(response)
    if (plan%lacks_forces) report%summary = report%summary//lacking
  end subroutine run

  !> The motion with the largest truncation error, and this error.
  function worst_of(response) result(text)
    type(response_type), intent(in) :: response
    character(len=:), allocatable :: text
    logical :: lacks(size(response%nu))
    integer :: i
    lacks = .false.
    where (response%outcome == outcome_converged) lacks = response%truncation > response%allowed
    i = maxloc(response%truncation, 1, lacks)
    text = ' (worst at nu = '//show(response%nu(i))//', with an estimated ' &
           //'relative error of '//show(response%truncation(i)) &
           //' by neglected harmonics above '//show(response%highest(i))//')'
  end function worst_of

  !> Outcomes and frequencies without a solution.
  function gaps_of(response) result(text)
    type(response_type), intent(in) :: response
    character(len=:), allocatable :: text
    real(wp), allocatable :: lost(:)
    integer :: i, n

    lost = pack(response%nu, response%outcome /= outcome_converged)
    text = ''
    do i = outcome_converged + 1, ubound(outcome_names, 1)
      n = count(response%outcome == i)
      if (n > 0) text = text//', '//show(n)//' '//trim(outcome_names(i))
    end do
    text = '; no solution ('//text(3:)//') at nu = '//show(minval(lost))
    if (size(lost) > 1) text = text//' to '//show(maxval(lost))
    text = text//', nan there'
    if (all(response%method == method_successive)) text = text//": try method = 'auto', which " &
                                                          //"continues with Newton's method"
  end function gaps_of

  !> One row per frequency.
  subroutine tabulate_response(response, coordinates, units, table, errors, extra)
    type(response_type), intent(in), target :: response
    !> Names and units of the coordinates.
    character(len=*), intent(in) :: coordinates(:), units(:)
    type(table_type), intent(out) :: table
    !> Error of each motion as a solution of its equations.
    real(wp), intent(in) :: errors(:)
    type(extra_columns), intent(in), optional :: extra
    character(len=:), allocatable :: names
    integer :: d, k

    if (counting) call count_up(counted_columns, size(coordinates))
    call table%note(response_note)
    names = ''
    do d = 1, size(coordinates)
      names = names//trim(coordinates(d))//'_k_re, '//trim(coordinates(d))//'_k_im: X_k of ' &
              //trim(coordinates(d))//' ('//trim(units(d))//'); '
    end do
    call table%note(names//unsolved_note)
    call table%add_reals('nu', response%nu)
    call table%add_words('outcome', response%outcome, outcome_names)
    call table%add_words('method', response%method, [repeat(' ', len(method_names)), method_names])
    call table%add_integers('iterations', response%iterations)
    call table%add_reals('rate', response%rate)
    call table%add_integers('highest', response%highest)
    call table%add_reals('truncation', response%truncation)
    call table%hold_reals('error', errors)
    if (present(extra)) call extra%add(table)
    if (allocated(response%stability%stable)) then
      call table%note('stable: 1: stable, 0: not, -1: unknown')
      ! The reason of an unknown stability is not part of the table.
      call table%hold_integers('stable', max(response%stability%stable, -1))
    end if
    do d = 1, size(response%coefficients, 2)
      do k = 1, size(response%orders)
        call table%add_complex(trim(coordinates(d))//'_'//show(response%orders(k)), &
                               response%coefficients(k, d, :))
      end do
    end do
  end subroutine tabulate_response

end module viscovib_response_job
