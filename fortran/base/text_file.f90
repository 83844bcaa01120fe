!> Reads and writes whole text files.
!!
!! Writing uses the C library. The compiler's run-time library ignores the error if a buffer cannot
!! be written, so a table truncated by a full disk would go unnoticed.
module viscovib_text_file
  use, intrinsic :: iso_c_binding, only: c_associated, c_char, c_int, c_int64_t, c_null_char, &
    c_null_ptr, c_ptr
  use viscovib_files, only: reason, remove_file, replace_file
  use viscovib_status, only: fail, show, status_input_error, status_io_error, status_type
  use viscovib_stopping, only: set_unfinished
  implicit none
  private

  public :: count_line_ends, read_text_file, text_writer

  !> Longest text that can be read (bytes).
  integer, parameter :: max_size = 100000000

  !> Writes a new file PATH.part, which is renamed to PATH at the end or removed. A link of either
  !! name is replaced and never followed.
  type :: text_writer
    character(len=:), allocatable, private :: path
    type(c_ptr), private :: handle = c_null_ptr
    !> Error code of writing; 0: no error.
    integer(c_int), private :: broken = 0
  contains
    procedure :: create
    procedure :: add_line
    procedure :: add_comments
    procedure :: finish
  end type text_writer

  interface
    integer(c_int) function c_open_to_read(path, size) bind(c, name='viscovib_open_to_read')
      import :: c_char, c_int, c_int64_t
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int64_t), intent(out) :: size
    end function c_open_to_read

    integer(c_int) function c_read_and_close(file, text, size) &
      bind(c, name='viscovib_read_and_close')
      import :: c_char, c_int, c_int64_t
      integer(c_int), value :: file
      character(kind=c_char), intent(out) :: text(*)
      integer(c_int64_t), value :: size
    end function c_read_and_close

    subroutine c_close(file) bind(c, name='viscovib_close')
      import :: c_int
      integer(c_int), value :: file
    end subroutine c_close

    type(c_ptr) function c_open_to_write(path, why) bind(c, name='viscovib_open_to_write')
      import :: c_char, c_int, c_ptr
      character(kind=c_char), intent(in) :: path(*)
      integer(c_int), intent(out) :: why
    end function c_open_to_write

    integer(c_int) function c_write(text, n, handle) bind(c, name='viscovib_write')
      import :: c_char, c_int, c_int64_t, c_ptr
      character(kind=c_char), intent(in) :: text(*)
      integer(c_int64_t), value :: n
      type(c_ptr), value :: handle
    end function c_write

    integer(c_int) function c_close_written(handle, failed_before) &
      bind(c, name='viscovib_close_written')
      import :: c_int, c_ptr
      type(c_ptr), value :: handle
      integer(c_int), value :: failed_before
    end function c_close_written
  end interface

contains

  !> Read a whole file. Bytes that are invalid in UTF-8 text are an input error with their line. A
  !! byte order mark at the start is removed.
  subroutine read_text_file(path, text, status)
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    character(len=*), parameter :: byte_order_mark = char(239)//char(187)//char(191)
    integer(c_int64_t) :: n
    integer(c_int) :: file, why
    integer :: i

    file = c_open_to_read(path//c_null_char, n)
    if (file < 0) then
      call fail(status, status_io_error, 'file', path//': cannot be read ('//reason(file)//')')
      return
    end if
    if (n > max_size) then
      call c_close(file)
      call fail(status, status_io_error, 'file', path//': cannot be read (not a file of at ' &
                //'most '//show(max_size)//' bytes)')
      return
    end if
    allocate (character(len=n) :: text)
    why = c_read_and_close(file, text, n)
    if (why /= 0) then
      call fail(status, status_io_error, 'file', path//': cannot be read ('//reason(why)//')')
      return
    end if
    if (index(text, byte_order_mark) == 1) text = text(4:)
    i = first_strange_byte(text)
    if (i > 0) call fail(status, status_input_error, 'file', path//':' &
                         //show(1 + count_line_ends(text(:i)))//': byte '//show(iachar(text(i:i))) &
                         //' found: this is not a text file (UTF-8)')
  end subroutine read_text_file

  !> Start a file.
  subroutine create(self, path, status)
    class(text_writer), intent(out) :: self
    character(len=*), intent(in) :: path
    type(status_type), intent(out) :: status
    integer(c_int) :: why

    self%path = path
    call set_unfinished(self%path//'.part')
    self%handle = c_open_to_write(self%path//'.part'//c_null_char, why)
    if (.not. c_associated(self%handle)) then
      call fail(status, status_io_error, 'out', path//': cannot be written ('//reason(why)//')')
    end if
  end subroutine create

  !> Add a line; an error is reported by `finish`.
  subroutine add_line(self, line)
    class(text_writer), intent(inout) :: self
    character(len=*), intent(in) :: line
    if (self%broken /= 0 .or. .not. c_associated(self%handle)) return
    self%broken = c_write(line//new_line('a'), len(line, c_int64_t) + 1, self%handle)
  end subroutine add_line

  !> Add lines separated by new-line characters, each prefixed by "# ". Empty lines are omitted.
  subroutine add_comments(self, text)
    class(text_writer), intent(inout) :: self
    character(len=*), intent(in) :: text
    integer :: first, last
    first = 1
    do while (first <= len(text))
      last = index(text(first:), new_line('a')) + first - 2
      if (last < first - 1) last = len(text)
      if (last >= first) call self%add_line('# '//text(first:last))
      first = last + 2
    end do
  end subroutine add_comments

  !> Rename the file to its final name, or remove it after a failure.
  subroutine finish(self, status)
    class(text_writer), intent(inout) :: self
    type(status_type), intent(out) :: status
    if (.not. c_associated(self%handle)) return
    self%broken = c_close_written(self%handle, self%broken)
    self%handle = c_null_ptr
    if (self%broken /= 0) then
      call remove_file(self%path//'.part')
      call fail(status, status_io_error, 'out', self%path//': writing failed (' &
                //reason(self%broken)//')')
      return
    end if
    call replace_file(self%path//'.part', self%path, status)
    call set_unfinished('')
  end subroutine finish

  !> Position of the first control byte or invalid UTF-8 byte; otherwise 0.
  pure integer function first_strange_byte(text) result(start)
    character(len=*), intent(in) :: text
    integer :: i, code, following

    following = 0
    start = 0
    do i = 1, len(text)
      code = iachar(text(i:i))
      if (following > 0) then
        if (code < 128 .or. code > 191) return
        following = following - 1
        cycle
      end if
      start = i
      select case (code)
      case (9, 10, 13, 32:126)
        following = 0
      case (194:223)
        following = 1
      case (224:239)
        following = 2
      case (240:244)
        following = 3
      case default
        return
      end select
    end do
    if (following == 0) start = 0
  end function first_strange_byte

  pure integer function count_line_ends(text)
    character(len=*), intent(in) :: text
    integer :: i
    count_line_ends = 0
    do i = 1, len(text)
      if (text(i:i) == new_line('a')) count_line_ends = count_line_ends + 1
    end do
  end function count_line_ends

end module viscovib_text_file
