!> A measured kernel or a record as a text file: a time (s) and a value in each line,
!! separated by blanks or a comma; what follows # or ! is left out.
module viscovib_kernel_table
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: parse_real
  use viscovib_status, only: fail, show, status_input_error, status_io_error, status_type
  use viscovib_text_file, only: count_line_ends, read_text_file
  implicit none
  private

  public :: check_pairs, read_kernel_table, read_pairs

  character(len=*), parameter :: separators = ' ,'//achar(9)//achar(13)

contains

  !> Times and values of a group, from `times` and `values` or from a `file` of two columns.
  subroutine read_pairs(reader, times, values)
    type(group_reader), intent(inout) :: reader
    real(wp), allocatable, intent(out) :: times(:), values(:)
    type(status_type) :: status
    character(len=:), allocatable :: path

    allocate (times(0), values(0))
    path = reader%read_path('file')
    if (reader%has('file')) then
      call reader%refuse([character(len=6) :: 'times', 'values'], 'is in the file already; give ' &
                         //'either file, or times and values')
      if (reader%status%failed()) return
      call read_kernel_table(path, times, values, status)
      if (status%category == status_io_error) then
        call reader%complain('file', 'file: '//status%message, status_io_error)
      else if (status%failed()) then
        ! The table's own file and line say more than the scene's.
        reader%status = status
      end if
      call reader%echo_reals('times', times)
      call reader%echo_reals('values', values)
    else
      times = reader%read_reals('times')
      values = reader%read_reals('values')
    end if
    call check_pairs(reader, 'times', 'values', size(times), size(values))
  end subroutine read_pairs

  !> Two lists of numbers must have the same length.
  subroutine check_pairs(reader, first, second, n_first, n_second)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: first, second
    integer, intent(in) :: n_first, n_second
    if (n_first /= n_second) call reader%complain(second, first//' and '//second//' have ' &
                                                  //show(n_first)//' and '//show(n_second) &
                                                  //' numbers: must match')
  end subroutine check_pairs

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
