!> The static equilibrium of a system under constant loads, with the memory of springs relaxed.
!!
!!   sum_g (1 - int_0^inf R_g dt) [K_g u + f_g(u)] = F,
!!
!! order 0 of harmonic balance, by Newton's method along loads that increase from 0.
module viscovib_equilibrium_job
  use viscovib_forced_response, only: forced_response
  use viscovib_job, only: job_report, job_type, plan_unwanted, table_sink
  use viscovib_kinds, only: wp
  use viscovib_outcomes, only: outcome_converged, outcome_names
  use viscovib_response, only: response_options, response_type
  use viscovib_response_plan, only: method_newton, new_response_plan, response_plan_type
  use viscovib_status, only: fail, set_ok, status_input_error, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: equilibrium_job

  !> Frequency of harmonics that are 0; also used as the factor of the load.
  real(wp), parameter :: any_frequency(1) = 1.0_wp

  type, extends(job_type) :: equilibrium_job
  contains
    procedure :: plan => plan_equilibrium
    procedure :: run
  end type equilibrium_job

contains

  subroutine plan_equilibrium(self, subject, text, status)
    class(equilibrium_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status

    call set_ok(status)
    text = ''
    if (any(subject%load%orders /= 0)) then
      call fail(status, status_input_error, 'load', '&equilibrium: the loads must be constant ' &
                //'(order = 0)')
      return
    end if
    text = subject%description() &
           //'computes: the static equilibrium under the constant loads, with ' &
           //'relaxed memory'//new_line('a')//plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_equilibrium

  subroutine run(self, subject, sink, report, status)
    class(equilibrium_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(response_options) :: options
    type(response_plan_type) :: plan
    type(response_type), target :: response
    type(table_type) :: table
    character(len=:), allocatable :: text
    integer :: i, mean

    call self%plan(subject, text, status)
    if (status%failed()) return
    options%harmonics = 1
    call new_response_plan(plan, subject%oscillator(), subject%load, any_frequency, method_newton, &
                           options, status)
    if (status%failed()) return
    call forced_response(plan, subject%oscillator(), subject%load, any_frequency, response)
    call subject%show_motions(response%nu, any_frequency, response%orders, self%wanted, .true., &
                              response%coefficients)
    mean = findloc(response%orders, 0, 1)
    call table%note('static equilibrium, springs with memory relaxed')
    call table%add_words('outcome', response%outcome, outcome_names)
    do i = 1, size(self%wanted)
      ! u = Im X_0.
      call table%hold_reals(trim(subject%coordinates(self%wanted(i))), &
                            aimag(response%coefficients(mean, i, :)))
    end do
    call sink%put(self%kind, table, status)
    report%complete = response%outcome(1) == outcome_converged
    report%summary = trim(outcome_names(response%outcome(1)))//', ' &
                     //things(size(self%wanted), 'coordinate')
  end subroutine run

end module viscovib_equilibrium_job
