!> Natural frequencies and mode shapes of any system about rest, without damping and memory.
module viscovib_modes_job
  use viscovib_constants, only: pi
  use viscovib_free_structure, only: structure_modes
  use viscovib_job, only: job_report, job_type, plan_unwanted, table_sink
  use viscovib_kinds, only: wp
  use viscovib_oscillator_modes, only: oscillator_modes
  use viscovib_status, only: set_ok, show, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: modes_job

  type, extends(job_type) :: modes_job
  contains
    procedure :: plan => plan_modes
    procedure :: run
  end type modes_job

contains

  subroutine plan_modes(self, subject, text, status)
    class(modes_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status

    call set_ok(status)
    text = 'computes: natural frequencies and shapes of ' &
           //things(subject%n_modes(), 'mode')//new_line('a') &
           //'skips: damping, memory and loads (modes are those of the ' &
           //'system about rest without them)'//new_line('a') &
           //plan_unwanted('columns', subject, self%wanted)
  end subroutine plan_modes

  subroutine run(self, subject, sink, report, status)
    class(modes_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    real(wp), allocatable :: omega(:)
    real(wp), allocatable, target :: shapes(:, :)
    type(table_type) :: table
    integer :: i, n

    n = subject%n_modes()
    allocate (omega(n), shapes(size(subject%coordinates), n))
    if (subject%is_structure) then
      call structure_modes(subject%model, omega, shapes, status)
      if (status%failed()) return
      call table%note('omega: circular frequency (rad/s), with the linear stiffness of elements, ' &
                      //'negative where rest is unstable; frequency (Hz); shapes in the units of ' &
                      //'the coordinates')
    else if (subject%is_pendulum) then
      call subject%pendulum%natural_modes(omega, shapes)
      call set_ok(status)
      call table%note('omega: circular frequency (omega_1); shapes: z (L), phi (rad), psi (rad)')
    else
      call oscillator_modes(subject%oscillator(), omega, shapes, status)
      if (status%failed()) return
      call table%note('omega: circular frequency (rad/s); frequency (Hz); shapes in the units of ' &
                      //'the coordinates')
    end if
    call table%hold_integers('mode', [(i - 1, i=1, n)])
    call table%hold_reals('omega', omega)
    if (.not. subject%is_pendulum) call table%hold_reals('frequency', omega/(2.0_wp*pi))
    do i = 1, size(self%wanted)
      call table%add_reals(trim(subject%coordinates(self%wanted(i))), shapes(self%wanted(i), :))
    end do
    call sink%put(self%kind, table, status)
    report%summary = things(n, 'mode')//', omega = '//show(omega(1))//' to '//show(omega(n))
  end subroutine run

end module viscovib_modes_job
