!> Roots of the characteristic equation of free motion about rest: a table of decay and frequency.
module viscovib_characteristic_roots_job
  use viscovib_characteristic_matrix, only: characteristic_matrix, oscillator_matrix, &
    structure_matrix
  use viscovib_characteristic_roots, only: find_characteristic_roots, roots_type
  use viscovib_job, only: job_report, job_type, table_sink
  use viscovib_kinds, only: wp
  use viscovib_status, only: show, status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: characteristic_roots_job

  type, extends(job_type) :: characteristic_roots_job
  contains
    procedure :: plan => plan_roots
    procedure :: run
  end type characteristic_roots_job

contains

  subroutine plan_roots(self, subject, text, status)
    class(characteristic_roots_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    type(characteristic_matrix) :: matrix

    text = ''
    call find_matrix(subject, matrix, status)
    if (status%failed()) return
    text = 'computes: roots s of free motion exp(s t) about rest, with damping and memory, of ' &
           //things(matrix%n_dof(), 'coordinate')//new_line('a') &
           //'skips: loads'//new_line('a')
    associate (no_columns => self%wanted)
    end associate
  end subroutine plan_roots

  subroutine find_matrix(subject, matrix, status)
    type(subject_type), intent(in), target :: subject
    type(characteristic_matrix), intent(out) :: matrix
    type(status_type), intent(out) :: status
    if (subject%is_structure) then
      call structure_matrix(matrix, subject%model, subject%structure, status)
    else
      call oscillator_matrix(matrix, subject%oscillator(), status)
    end if
  end subroutine find_matrix

  subroutine run(self, subject, sink, report, status)
    class(characteristic_roots_job), intent(in) :: self
    type(subject_type), intent(in), target :: subject
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(characteristic_matrix) :: matrix
    type(roots_type) :: roots
    type(table_type) :: table
    complex(wp), allocatable, target :: s(:)
    integer :: i

    call find_matrix(subject, matrix, status)
    if (status%failed()) return
    call find_characteristic_roots(matrix, roots)
    s = [roots%oscillatory, cmplx(roots%real, 0.0_wp, wp)]
    call table%note('s: roots (1/s) of free motion exp(s t); first those with Im s > 0, whose ' &
                    //'conjugates are roots too, then real ones')
    call table%note(show(roots%n_unstable)//' with Re s > 0, conjugates included')
    if (roots%complete) then
      call table%note('complete in '//trim(roots%region))
    else
      call table%note('not known to be complete in '//trim(roots%region))
    end if
    call table%hold_integers('root', [(i - 1, i=1, size(s))])
    call table%add_complex('s', s)
    call table%hold_reals('damping_ratio', -real(s)/max(abs(s), tiny(1.0_wp)))
    call sink%put(self%kind, table, status)
    associate (no_columns => self%wanted)
    end associate
    report%complete = roots%complete
    report%summary = things(size(roots%oscillatory), 'oscillatory root')//', ' &
                     //things(size(roots%real), 'real root')//', '//show(roots%n_unstable) &
                     //' with a positive real part'
  end subroutine run

end module viscovib_characteristic_roots_job
