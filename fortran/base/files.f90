!> Operations on folders and files that Fortran lacks.
module viscovib_files
  use, intrinsic :: iso_c_binding, only: c_char, c_int, c_null_char
  use viscovib_status, only: fail, set_ok, status_io_error, status_type
  implicit none
  private

  public :: make_folder, replace_file, remove_file, stem, reason, real_path, ignore_file_limit, &
    print_line

  interface
    integer(c_int) function c_make_folder(path) bind(c, name='viscovib_make_folder')
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: path(*)
    end function c_make_folder

    integer(c_int) function c_rename(from, to) bind(c, name='viscovib_replace')
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: from(*), to(*)
    end function c_rename

    integer(c_int) function c_remove(path) bind(c, name='remove')
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: path(*)
    end function c_remove

    integer(c_int) function c_reason(code, text, work) bind(c, name='viscovib_reason')
      import :: c_char, c_int
      integer(c_int), value :: code, work
      character(kind=c_char), intent(out) :: text(*)
    end function c_reason

    integer(c_int) function c_real_path(path, text, work) bind(c, name='viscovib_real_path')
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: path(*)
      character(kind=c_char), intent(out) :: text(*)
      integer(c_int), value :: work
    end function c_real_path

    integer(c_int) function c_print(text, n) bind(c, name='viscovib_print')
      import :: c_char, c_int
      character(kind=c_char), intent(in) :: text(*)
      integer(c_int), value :: n
    end function c_print

    !> Make writing beyond the file size limit an error instead of terminating the program.
    subroutine ignore_file_limit() bind(c, name='viscovib_ignore_file_limit')
    end subroutine ignore_file_limit
  end interface

contains

  !> Create a folder and its parents; an existing folder is unchanged.
  subroutine make_folder(path)
    character(len=*), intent(in) :: path
    integer(c_int) :: code
    integer :: i
    do i = 2, len(path)
      if (path(i:i) == '/') code = c_make_folder(path(:i - 1)//c_null_char)
    end do
    code = c_make_folder(path//c_null_char)
  end subroutine make_folder

  !> Replace a file by a finished file atomically. A link is replaced, not followed.
  subroutine replace_file(from, to, status)
    character(len=*), intent(in) :: from, to
    type(status_type), intent(out) :: status
    if (c_rename(from//c_null_char, to//c_null_char) /= 0_c_int) then
      call remove_file(from)
      call fail(status, status_io_error, 'file', to//': cannot be written (not a regular file)')
    end if
  end subroutine replace_file

  subroutine remove_file(path)
    character(len=*), intent(in) :: path
    integer(c_int) :: code
    code = c_remove(path//c_null_char)
  end subroutine remove_file

  !> Print a line to standard output.
  subroutine print_line(line, status)
    character(len=*), intent(in) :: line
    type(status_type), intent(out) :: status
    integer(c_int) :: code
    code = c_print(line//new_line('a'), len(line, c_int) + 1_c_int)
    call set_ok(status)
    if (code /= 0_c_int) call fail(status, status_io_error, 'standard output', &
                                   'standard output: cannot be written ('//reason(code)//')')
  end subroutine print_line

  !> System message for an error code.
  function reason(code)
    integer(c_int), intent(in) :: code
    character(len=:), allocatable :: reason
    character(len=200) :: text
    integer :: n
    n = c_reason(code, text, len(text, c_int))
    reason = text(:n)
  end function reason

  !> Absolute path with links and dots resolved; empty if it does not exist.
  function real_path(path)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: real_path
    character(len=4096) :: text
    integer :: n
    n = c_real_path(path//c_null_char, text, len(text, c_int))
    real_path = text(:n)
  end function real_path

  !> File name without folder and last extension.
  pure function stem(path)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: stem
    integer :: dot
    stem = path(index(path, '/', back=.true.) + 1:)
    dot = index(stem, '.', back=.true.)
    if (dot > 1) stem = stem(:dot - 1)
  end function stem

end module viscovib_files
