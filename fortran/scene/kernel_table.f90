!> A measured kernel or a record as a text file: a time (s) and a value in each line,
!! separated by blanks or a comma; what follows # or ! is left out.
module viscovib_kernel_table
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: parse_real
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_text_file, only: count_line_ends, read_text_file
  implicit none
  private

  public :: read_kernel_table

  character(len=*), parameter :: separators = ' ,'//achar(9)//achar(13)

contains

  !> Times and values, of the same length; empty on failure.
  subroutine read_kernel_table(path, times, values, status)
    character(len=*), intent(in) :: path
    real(wp), allocatable, intent(out) :: times(:), values(:)
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: text
    real(wp), allocatable :: pairs(:, :)
    integer :: first, last, line, n

    allocate (times(0), values(0))
    call read_text_file(path, text, status)
    if (status%failed()) return
    ! No more pairs than line ends, and one for a last line without.
    allocate (pairs(2, 1 + count_line_ends(text)))
    n = 0
    line = 0
    first = 1
    do while (first <= len(text))
      line = line + 1
      last = index(text(first:), new_line('a')) + first - 2
      if (last < first - 1) last = len(text)
      call read_line(without_comment(text(first:last)), pairs(:, n + 1), n, status)
      if (status%failed()) then
        status%message = path//':'//show(line)//': '//status%message
        return
      end if
      first = last + 2
    end do
    times = pairs(1, :n)
    values = pairs(2, :n)
  end subroutine read_kernel_table

  !> A pair, counted in n, or nothing if the line is empty.
  subroutine read_line(line, pair, n, status)
    character(len=*), intent(in) :: line
    real(wp), intent(inout) :: pair(2)
    integer, intent(inout) :: n
    type(status_type), intent(out) :: status
    integer :: first, last, found
    logical :: ok

    last = 0
    found = 0
    do
      first = verify(line(last + 1:), separators) + last
      if (first == last) exit
      last = scan(line(first:), separators) + first - 2
      if (last < first) last = len(line)
      found = found + 1
      ok = found <= 2
      if (ok) call parse_real(line(first:last), pair(found), ok)
      if (.not. ok) exit
    end do
    if (found == 0) return
    if (ok .and. found == 2) then
      n = n + 1
    else
      ! The message does not contain the line: the scene may come from a foreign source.
      call fail(status, status_input_error, 'file', 'a line must be two finite numbers, a time ' &
                //'and a value')
    end if
  end subroutine read_line

  pure function without_comment(line) result(text)
    character(len=*), intent(in) :: line
    character(len=:), allocatable :: text
    integer :: n
    n = scan(line, '#!') - 1
    if (n < 0) n = len(line)
    text = line(:n)
    ! Without what Windows ends its lines with.
    n = verify(text, separators, back=.true.)
    text = text(:n)
  end function without_comment

end module viscovib_kernel_table
