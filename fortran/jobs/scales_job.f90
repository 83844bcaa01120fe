!> Steady motions by multiple scales, along the frequency or the amplitude of a load, of any
!! system.
module viscovib_scales_job
  use viscovib_column_notes, only: scales_columns_note, scales_note
  use viscovib_job, only: job_report, job_type, plan_unwanted, table_sink
  use viscovib_kinds, only: wp
  use viscovib_normal_form, only: by_influence
  use viscovib_pendulum_form, only: new_pendulum_form, ordering_names
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_scales_response, only: response_along, steady_points_type, vary_frequency
  use viscovib_status, only: set_ok, show, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_system_form, only: new_oscillator_form
  use viscovib_table, only: table_type
  implicit none
  private

  public :: scales_job

  type, extends(job_type) :: scales_job
    !> The varied quantity: its name, index of the load, frequency or amplitude.
    character(len=4) :: parameter = 'p1'
    integer :: load = 1, vary = vary_frequency
    real(wp), allocatable :: values(:)
    real(wp) :: tolerance = by_influence
    !> Index in `ordering_names`, for a pendulum.
    integer :: ordering = 1
    !> Load and its frequency, for other systems; load times cos(nu t).
    real(wp), allocatable :: force(:)
    real(wp) :: nu = 1.0_wp
  contains
    procedure :: plan => plan_scales
    procedure :: run
  end type scales_job

contains

  subroutine plan_scales(self, subject, text, status)
    class(scales_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status

    call set_ok(status)
    text = 'computes: steady motions to third order at ' &
           //things(size(self%values), 'value')//' of ' &
           //trim(self%parameter)//' from '//show(self%values(1))//' to ' &
           //show(self%values(size(self%values)))//', with stability and errors'//new_line('a')
    if (self%ordering > 1 .and. subject%is_pendulum) then
      text = text//'skips: degrees above the third, e counted as one (' &
             //trim(ordering_names(self%ordering))//')'//new_line('a')
    end if
    text = text//plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_scales

  subroutine run(self, subject, sink, report, status)
    class(scales_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(polynomial_form_type) :: form
    type(steady_points_type), target :: points
    type(table_type) :: table
    integer :: cancel, i

    if (subject%is_pendulum) then
      call new_pendulum_form(form, subject%pendulum, self%ordering, status)
    else
      call new_oscillator_form(form, subject%oscillator(), self%force, self%nu, status)
    end if
    if (status%failed()) return
    cancel = 0
    call response_along(form, self%load, self%vary, self%values, self%tolerance, .true., points, &
                        status, cancel)
    if (status%failed()) return
    call tabulate(self, subject, points, table)
    call sink%put(self%kind, table, status)
    report%complete = all([(any(points%value(:points%n) == i), i=1, size(self%values))]) &
                      .and. .not. any(points%may_lack)
    report%summary = things(points%n, 'steady motion')//' at ' &
                     //things(size(self%values), 'value')//', ' &
                     //show(count(stable_points(points)))//' of them stable'
    if (any(points%may_lack)) report%summary = report%summary//'; subharmonic or superharmonic ' &
                              //'motions may be missing at '//things(count(points%may_lack), &
                                                                     'value')
  end subroutine run

  !> True without an eigenvalue with a positive real part, except rounding.
  pure function stable_points(points) result(stable)
    type(steady_points_type), intent(in) :: points
    logical :: stable(points%n)
    integer :: i
    do i = 1, points%n
      stable(i) = max(maxval(real(points%eigenvalues(:, i))), points%resting(i)) &
                  <= 1.0e-9_wp*maxval(points%frame(:, i))
    end do
  end function stable_points

  !> One row per motion.
  subroutine tabulate(self, subject, points, table)
    class(scales_job), intent(in) :: self
    type(subject_type), intent(in) :: subject
    type(steady_points_type), intent(in), target :: points
    type(table_type), intent(out) :: table
    integer :: d, i, n

    n = points%n
    call table%note(scales_note)
    call table%note(scales_columns_note)
    call table%hold_reals(trim(self%parameter), self%values(points%value(:n)))
    call table%hold_integers('stable', merge(1, 0, stable_points(points)))
    call table%hold_integers('beats', points%beats(:n))
    do i = 1, size(self%wanted)
      d = self%wanted(i)
      call table%add_complex(trim(subject%coordinates(d)), points%harmonic(d, :n))
    end do
    do d = 1, size(points%a, 1)
      call table%hold_reals('mode_'//show(d), 2.0_wp*abs(points%a(d, :n)))
    end do
    call table%hold_reals('growth', max(maxval(real(points%eigenvalues(:, :n)), 1), &
                                       points%resting(:n)))
    call table%hold_reals('growth_error', points%growth_errors(:n))
    do d = 1, 3
      call table%add_reals('order_'//show(d), points%sizes(d, :n))
    end do
    call table%hold_reals('error_estimate', maxval(points%harmonic_errors(:, :n), 1))
  end subroutine tabulate

end module viscovib_scales_job
