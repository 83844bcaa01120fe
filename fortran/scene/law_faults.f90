!> Errors in the text of a law. Messages show the text of the file, with names of parameters
!! instead of their numbers.
module viscovib_law_faults
  use viscovib_group_reader, only: group_reader
  use viscovib_law_program, only: law_program
  use viscovib_law_text, only: compile_law
  use viscovib_namelist, only: lower
  use viscovib_status, only: clipped
  implicit none
  private

  public :: complain_of_law

contains

  !> Refuse a law. The message for an unknown name contains the nearest parameter.
  subroutine complain_of_law(reader, key, text, fault, arguments, must)
    type(group_reader), intent(inout) :: reader
    !> Its key, and what was read: numbers stand for names.
    character(len=*), intent(in) :: key, text, fault
    !> What it may depend on; without: the fault is no matter of names.
    character(len=*), intent(in), optional :: arguments(:)
    !> What it must be, before the fault.
    character(len=*), intent(in), optional :: must
    character(len=:), allocatable :: written, description, other
    type(law_program) :: program
    integer :: parity, degree

    written = reader%group%written(key, text)
    description = fault
    if (present(arguments) .and. allocated(reader%group%names)) then
      call compile_law(lower(written), arguments, reader%group%names, reader%group%values, &
                       program, parity, degree, other)
      if (other /= '') description = other
    end if
    if (present(must)) description = must//': '//description
    call reader%complain(key, key//" = '"//clipped(written)//"': "//description)
  end subroutine complain_of_law

end module viscovib_law_faults
