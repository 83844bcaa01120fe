!> Text files read and written as a whole.
!!
!! Writing goes through the C library: the compiler's run-time library loses
!! the error when a buffer cannot be written out, so that a table cut short by
!! a full disk would pass for a whole one.
module viscovib_text_file
  use, intrinsic :: iso_c_binding, only: c_associated, c_char, c_int, c_null_char, c_null_ptr, &
    c_ptr, c_size_t
  use viscovib_files, only: remove_file, replace_file
  use viscovib_status, only: fail, show, status_input_error, status_io_error, status_type
  implicit none
  private

  public :: read_text_file, text_writer

  !> Longest text that is read (bytes).
  integer, parameter :: max_size = 100000000

  !> A file in the making, beside the place where it will stand: it takes the
  !! name asked for in one step at the end, whole, or is not there at all.
  type :: text_writer
    character(len=:), allocatable, private :: path
    type(c_ptr), private :: handle = c_null_ptr
    logical, private :: broken = .false.
  contains
    procedure :: create
    procedure :: add_line
    procedure :: add_comments
    procedure :: finish
  end type text_writer

  interface
    type(c_ptr) function c_fopen(path, mode) bind(c, name='fopen')
      import :: c_char, c_ptr
      character(kind=c_char), intent(in) :: path(*), mode(*)
    end function c_fopen

    integer(c_size_t) function c_fwrite(text, size, n, handle) bind(c, name='fwrite')
      import :: c_char, c_ptr, c_size_t
      character(kind=c_char), intent(in) :: text(*)
      integer(c_size_t), value :: size, n
      type(c_ptr), value :: handle
    end function c_fwrite

    integer(c_int) function c_fclose(handle) bind(c, name='fclose')
      import :: c_int, c_ptr
      type(c_ptr), value :: handle
    end function c_fclose
  end interface

contains

  !> The whole file. Bytes that no UTF-8 text has are an input error with their
  !! line; a mark of byte order at the start is dropped.
  subroutine read_text_file(path, text, status)
    character(len=*), intent(in) :: path
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    character(len=*), parameter :: byte_order_mark = char(239)//char(187)//char(191)
    integer :: unit, io, n, i
    character(len=200) :: message

    message = ''
    open (newunit=unit, file=path, access='stream', form='unformatted', action='read', &
          status='old', iostat=io, iomsg=message)
    if (io == 0) then
      inquire (unit=unit, size=n)
      if (n < 0 .or. n > max_size) then
        close (unit)
        call fail(status, status_io_error, 'file', path//': cannot be read (not a file of at ' &
                  //'most '//show(max_size)//' bytes)')
        return
      end if
      allocate (character(len=n) :: text)
      read (unit, iostat=io, iomsg=message) text
      close (unit)
    end if
    if (io /= 0) then
      call fail(status, status_io_error, 'file', path//': cannot be read ('//reason(message)//')')
      return
    end if
    if (index(text, byte_order_mark) == 1) text = text(4:)
    i = first_strange_byte(text)
    if (i > 0) call fail(status, status_input_error, 'file', path//':' &
                         //show(count_lines(text(:i)))//': byte '//show(iachar(text(i:i))) &
                         //' found: this is not a text file (UTF-8)')
  end subroutine read_text_file

  !> Start a file.
  subroutine create(self, path, status)
    class(text_writer), intent(out) :: self
    character(len=*), intent(in) :: path
    type(status_type), intent(out) :: status
    character(len=200) :: message
    integer :: unit, io

    self%path = path
    message = ''
    ! Fortran's own opening says why it is not possible.
    open (newunit=unit, file=path//'.part', action='write', status='replace', iostat=io, &
          iomsg=message)
    if (io == 0) then
      close (unit)
      self%handle = c_fopen(path//'.part'//c_null_char, 'w'//c_null_char)
    end if
    if (.not. c_associated(self%handle)) then
      call fail(status, status_io_error, 'out', path//': cannot be written ('//reason(message)//')')
    end if
  end subroutine create

  !> Add a line; whether it went well is told at the end.
  subroutine add_line(self, line)
    class(text_writer), intent(inout) :: self
    character(len=*), intent(in) :: line
    integer(c_size_t) :: n
    if (self%broken .or. .not. c_associated(self%handle)) return
    n = int(len(line) + 1, c_size_t)
    self%broken = c_fwrite(line//new_line('a'), 1_c_size_t, n, self%handle) /= n
  end subroutine add_line

  !> Add lines, separated by new-line characters, each behind a "# ".
  subroutine add_comments(self, text)
    class(text_writer), intent(inout) :: self
    character(len=*), intent(in) :: text
    integer :: first, last
    first = 1
    do while (first <= len(text))
      last = index(text(first:), new_line('a')) + first - 2
      if (last < first - 1) last = len(text)
      call self%add_line('# '//text(first:last))
      first = last + 2
    end do
  end subroutine add_comments

  !> Put the file in its place; on any failure nothing is left.
  subroutine finish(self, status)
    class(text_writer), intent(inout) :: self
    type(status_type), intent(out) :: status
    if (.not. c_associated(self%handle)) return
    if (c_fclose(self%handle) /= 0_c_int) self%broken = .true.
    self%handle = c_null_ptr
    if (self%broken) then
      call remove_file(self%path//'.part')
      call fail(status, status_io_error, 'out', self%path//': writing failed (disk full?)')
      return
    end if
    call replace_file(self%path//'.part', self%path, status)
  end subroutine finish

  !> What the system says, less the file name that the compiler puts before it.
  pure function reason(message)
    character(len=*), intent(in) :: message
    character(len=:), allocatable :: reason
    integer :: colon
    colon = index(message, "': ", back=.true.)
    if (colon > 0) then
      reason = trim(message(colon + 3:))
    else
      reason = trim(message)
    end if
  end function reason

  !> Position of the first control byte, or byte out of place in UTF-8; else 0.
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

  pure integer function count_lines(text)
    character(len=*), intent(in) :: text
    integer :: i
    count_lines = 1
    do i = 1, len(text)
      if (text(i:i) == new_line('a')) count_lines = count_lines + 1
    end do
  end function count_lines

end module viscovib_text_file
