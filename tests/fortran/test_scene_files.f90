!> Small files for tests of readers and writers, in the working folder.
module test_scene_files
  implicit none
  private

  public :: scratch, write_scratch, read_scratch, remove_scratch

contains

  !> Path of a scratch file; suites run in parallel, so names must differ.
  function scratch(name) result(path)
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: path
    path = 'scratch_'//name
  end function scratch

  !> Write exactly these bytes.
  subroutine write_scratch(name, text)
    character(len=*), intent(in) :: name, text
    integer :: unit
    open (newunit=unit, file=scratch(name), access='stream', form='unformatted', &
          action='write', status='replace')
    write (unit) text
    close (unit)
  end subroutine write_scratch

  !> Read all bytes; '(none)' if the file does not exist.
  function read_scratch(name) result(text)
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: text
    integer :: unit, n, io
    open (newunit=unit, file=scratch(name), access='stream', form='unformatted', &
          action='read', status='old', iostat=io)
    text = '(none)'
    if (io /= 0) return
    inquire (unit=unit, size=n)
    deallocate (text)
    allocate (character(len=n) :: text)
    read (unit) text
    close (unit)
  end function read_scratch

  subroutine remove_scratch(name)
    character(len=*), intent(in) :: name
    integer :: unit, io
    open (newunit=unit, file=scratch(name), status='old', iostat=io)
    if (io == 0) close (unit, status='delete')
  end subroutine remove_scratch

end module test_scene_files
