!> Real matrices in Matrix Market files (Boisvert, Pozo and Remington, NISTIR 5935, 1996).
module viscovib_matrix_market
  use viscovib_kinds, only: wp
  use viscovib_namelist, only: lower
  use viscovib_number_text, only: parse_integer, parse_real
  use viscovib_status, only: clipped, fail, show, status_input_error, status_type
  use viscovib_text_file, only: read_text_file
  implicit none
  private

  public :: read_matrix_market

  character(len=*), parameter :: blanks = ' '//achar(9)//achar(13)
  !> What `Structure.write` puts before the names of rows.
  character(len=*), parameter :: names_mark = 'rows: '

  !> The text and where in it the reader stands.
  type :: cursor_type
    character(len=:), allocatable :: path, text
    integer :: at = 1, line = 0
  end type cursor_type

contains

  !> The whole matrix; `names`, blank where the file tells none, are those of its rows.
  subroutine read_matrix_market(path, most_rows, most_columns, matrix, names, status)
    character(len=*), intent(in) :: path
    integer, intent(in) :: most_rows, most_columns
    real(wp), allocatable, intent(out) :: matrix(:, :)
    character(len=:), allocatable, intent(out) :: names
    type(status_type), intent(out) :: status
    type(cursor_type) :: cursor
    character(len=:), allocatable :: line
    logical :: in_places
    integer :: sign_below, sizes(3)

    allocate (matrix(0, 0))
    names = ''
    cursor%path = path
    call read_text_file(path, cursor%text, status)
    if (status%failed()) return
    call next_line(cursor, line)
    call read_header(cursor, line, in_places, sign_below, status)
    if (status%failed()) return
    do
      call next_line(cursor, line)
      if (index(line, '%') /= 1) then
        if (line /= '' .or. ended(cursor)) exit
      end if
      if (index(line, names_mark) > 0) names = line(index(line, names_mark) + len(names_mark):)
    end do
    call read_sizes(cursor, line, in_places, sizes, status)
    if (status%failed()) return
    if (sizes(1) < 1 .or. sizes(1) > most_rows .or. sizes(2) < 1 .or. sizes(2) > most_columns) then
      call blame(cursor, 'is '//show(sizes(1))//' x '//show(sizes(2))//', must be at most ' &
                 //show(most_rows)//' x '//show(most_columns)//' here; Python reduces larger ' &
                 //'structures (Structure.reduce) and writes what is left (Structure.write)', &
                 status)
    else if (sign_below /= 0 .and. sizes(1) /= sizes(2)) then
      call blame(cursor, 'is symmetric, must be square', status)
    end if
    if (status%failed()) return
    deallocate (matrix)
    allocate (matrix(sizes(1), sizes(2)), source=0.0_wp)
    if (in_places) then
      call read_entries(cursor, sizes(3), sign_below, matrix, status)
    else
      call read_columns(cursor, sign_below, matrix, status)
    end if
    if (status%failed()) return
    do
      if (ended(cursor)) exit
      call next_line(cursor, line)
      if (line == '' .or. index(line, '%') == 1) cycle
      call blame(cursor, 'has more entries than it says', status)
      return
    end do
  end subroutine read_matrix_market

  !> %%MatrixMarket matrix coordinate real symmetric
  subroutine read_header(cursor, line, in_places, sign_below, status)
    type(cursor_type), intent(in) :: cursor
    character(len=*), intent(in) :: line
    !> Whether entries have places, else all of them are there, column by column.
    logical, intent(out) :: in_places
    !> Entries above the diagonal if the file contains only those below: 1 the same, -1 the
    !! negative; 0: the file contains all entries.
    integer, intent(out) :: sign_below
    type(status_type), intent(out) :: status
    character(len=20) :: words(5)
    character(len=:), allocatable :: left
    integer :: i, n

    left = lower(line)
    words = ''
    do i = 1, size(words)
      n = verify(left//'.', blanks)
      left = left(n:)
      n = scan(left//' ', blanks) - 1
      words(i) = left(:n)
      left = left(n + 1:)
    end do
    in_places = words(3) == 'coordinate'
    sign_below = 0
    if (words(1) /= '%%matrixmarket' .or. words(2) /= 'matrix' &
        .or. .not. (in_places .or. words(3) == 'array')) then
      call blame(cursor, "is not a Matrix Market file: must begin with '%%MatrixMarket matrix ' " &
                 //"and 'coordinate' or 'array'", status)
    else if (words(4) == 'complex' .or. words(5) == 'hermitian') then
      call blame(cursor, 'contains complex numbers, must be real', status)
    else if (words(4) == 'pattern') then
      call blame(cursor, 'contains a pattern without values, must be real', status)
    else if (all(words(4) /= [character(len=7) :: 'real', 'double', 'integer'])) then
      call blame(cursor, "holds '"//clipped(trim(words(4)))//"', must be real", status)
    else if (words(5) == 'symmetric') then
      sign_below = 1
    else if (words(5) == 'skew-symmetric') then
      sign_below = -1
    else if (words(5) /= 'general') then
      call blame(cursor, "is '"//clipped(trim(words(5)))//"', must be general, symmetric or " &
                 //'skew-symmetric', status)
    end if
  end subroutine read_header

  subroutine read_sizes(cursor, line, in_places, sizes, status)
    type(cursor_type), intent(in) :: cursor
    character(len=*), intent(in) :: line
    logical, intent(in) :: in_places
    integer, intent(out) :: sizes(3)
    type(status_type), intent(out) :: status
    real(wp) :: values(3)
    logical :: ok
    integer :: n

    n = merge(3, 2, in_places)
    values = 0.0_wp
    call read_numbers(line, values(:n), n, ok)
    if (ok) ok = all(values >= 0.0_wp)
    sizes = 0
    if (ok) sizes = nint(values)
    if (.not. ok) call blame(cursor, 'must say how many rows and columns it has' &
                             //trim(merge(', and how many entries', '                      ', &
                                          in_places)), status)
  end subroutine read_sizes

  !> Row, column and value of each entry; entries of one place add up. A symmetric file stores each
  !! pair of entries once: the second of them would double both.
  subroutine read_entries(cursor, n, sign_below, matrix, status)
    type(cursor_type), intent(inout) :: cursor
    integer, intent(in) :: n, sign_below
    real(wp), intent(inout) :: matrix(:, :)
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: line
    real(wp) :: values(3)
    integer :: i, j, k
    logical :: ok

    do k = 1, n
      call next_entry(cursor, line, n, status)
      if (status%failed()) return
      call read_numbers(line, values, 2, ok)
      if (ok) ok = values(1) >= 1.0_wp .and. values(1) <= size(matrix, 1) &
                   .and. values(2) >= 1.0_wp .and. values(2) <= size(matrix, 2)
      if (.not. ok) then
        call blame(cursor, 'a line must be a row and a column within the matrix, and a finite ' &
                   //'number', status)
        return
      end if
      i = nint(values(1))
      j = nint(values(2))
      matrix(i, j) = matrix(i, j) + values(3)
    end do
    if (sign_below == 0) return
    do j = 1, size(matrix, 2)
      do i = j + 1, size(matrix, 1)
        if (abs(matrix(i, j)) > 0.0_wp .and. abs(matrix(j, i)) > 0.0_wp) then
          call blame(cursor, 'is declared '//trim(merge('symmetric     ', 'skew-symmetric', &
                                                        sign_below > 0))//' but stores both (' &
                     //show(i)//', '//show(j)//') and ('//show(j)//', '//show(i) &
                     //'): store one triangle, or declare it general', status)
          return
        end if
        values(1) = matrix(i, j)
        matrix(i, j) = matrix(i, j) + sign_below*matrix(j, i)
        matrix(j, i) = matrix(j, i) + sign_below*values(1)
      end do
    end do
  end subroutine read_entries

  !> All entries column by column; of symmetric matrices from the diagonal down.
  subroutine read_columns(cursor, sign_below, matrix, status)
    type(cursor_type), intent(inout) :: cursor
    integer, intent(in) :: sign_below
    real(wp), intent(inout) :: matrix(:, :)
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: line
    real(wp) :: value(1)
    integer :: i, j, first
    logical :: ok

    do j = 1, size(matrix, 2)
      first = 1
      if (sign_below == 1) first = j
      if (sign_below == -1) first = j + 1
      do i = first, size(matrix, 1)
        call next_entry(cursor, line, size(matrix), status)
        if (status%failed()) return
        call read_numbers(line, value, 0, ok)
        if (.not. ok) then
          call blame(cursor, 'a line must be a finite number', status)
          return
        end if
        matrix(i, j) = value(1)
        if (sign_below /= 0 .and. i /= j) matrix(j, i) = sign_below*value(1)
      end do
    end do
  end subroutine read_columns

  !> The next line that says something.
  subroutine next_entry(cursor, line, n, status)
    type(cursor_type), intent(inout) :: cursor
    character(len=:), allocatable, intent(out) :: line
    !> Entries that there must be.
    integer, intent(in) :: n
    type(status_type), intent(inout) :: status
    do
      if (ended(cursor)) then
        call blame(cursor, 'is truncated: it declares '//show(n)//' entries', status)
        return
      end if
      call next_line(cursor, line)
      if (line /= '' .and. index(line, '%') /= 1) return
    end do
  end subroutine next_entry

  !> So many numbers and no more, the first few of them integers.
  subroutine read_numbers(line, values, n_integers, ok)
    character(len=*), intent(in) :: line
    real(wp), intent(out) :: values(:)
    integer, intent(in) :: n_integers
    logical, intent(out) :: ok
    integer :: first, k, last, whole

    last = 0
    values = 0.0_wp
    do k = 1, size(values)
      first = verify(line(last + 1:), blanks) + last
      ok = first > last
      if (.not. ok) return
      last = scan(line(first:), blanks) + first - 2
      if (last < first) last = len(line)
      if (k <= n_integers) then
        call parse_integer(line(first:last), whole, ok)
        values(k) = whole
      else
        call parse_real(line(first:last), values(k), ok)
      end if
      if (.not. ok) return
    end do
    ok = verify(line(last + 1:), blanks) == 0
  end subroutine read_numbers

  pure logical function ended(cursor)
    type(cursor_type), intent(in) :: cursor
    ended = cursor%at > len(cursor%text)
  end function ended

  !> The next line, without blanks at its ends; empty past the last.
  subroutine next_line(cursor, line)
    type(cursor_type), intent(inout) :: cursor
    character(len=:), allocatable, intent(out) :: line
    integer :: last, n

    line = ''
    if (ended(cursor)) return
    cursor%line = cursor%line + 1
    last = index(cursor%text(cursor%at:), new_line('a')) + cursor%at - 2
    if (last < cursor%at - 1) last = len(cursor%text)
    line = cursor%text(cursor%at:last)
    cursor%at = last + 2
    n = verify(line, blanks, back=.true.)
    line = line(:n)
    n = max(verify(line, blanks), 1)
    line = line(n:)
  end subroutine next_line

  subroutine blame(cursor, what, status)
    type(cursor_type), intent(in) :: cursor
    character(len=*), intent(in) :: what
    type(status_type), intent(inout) :: status
    call fail(status, status_input_error, 'file', cursor%path//':'//show(max(cursor%line, 1)) &
              //': '//what)
  end subroutine blame

end module viscovib_matrix_market
