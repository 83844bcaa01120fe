!> Keys of &response and &branch for additional columns of their tables.
module viscovib_extra_groups
  use viscovib_extra_columns, only: extra_columns
  use viscovib_group_reader, only: group_reader
  use viscovib_status, only: set_ok, status_type
  use viscovib_subject, only: subject_type
  implicit none
  private

  public :: read_extra

contains

  subroutine read_extra(reader, subject, extra)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(extra_columns), intent(out) :: extra
    type(status_type) :: status

    extra%sampling = reader%read_yes('sampling')
    extra%dissipation = reader%read_yes('dissipation')
    call set_ok(status)
    call extra%check(subject, status)
    call reader%place(status)
  end subroutine read_extra

end module viscovib_extra_groups
