!> Namelist files, read with the line of everything kept, so that an error can
!! say `file:line: what is wrong, what is allowed`.
!!
!! The compiler's own namelist reading knows neither lines nor which key is at
!! fault. Read here: groups `&name key = values /`, `!` comments, quoted
!! strings, numbers, lists over several lines, repeats `3*0.5`. No value may be
!! left out between commas: what follows would move to another place unseen.
module viscovib_namelist
  use viscovib_number_text, only: parse_integer
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_text_file, only: read_text_file
  implicit none
  private

  public :: namelist_type, group_type, read_namelist, lower

  type :: value_type
    character(len=:), allocatable :: text
    logical :: quoted = .false.
  end type value_type

  type :: entry_type
    character(len=:), allocatable :: key
    integer :: line = 0
    type(value_type), allocatable :: values(:)
  end type entry_type

  type :: group_type
    character(len=:), allocatable :: name
    integer :: line = 0
    type(entry_type), allocatable :: entries(:)
  contains
    procedure :: find
    procedure :: line_of
  end type group_type

  type :: namelist_type
    character(len=:), allocatable :: path
    type(group_type), allocatable :: groups(:)
  end type namelist_type

  !> Where in the text the parser stands.
  type :: cursor_type
    character(len=:), allocatable :: text
    integer :: at = 1, line = 1
  end type cursor_type

  character(len=*), parameter :: blank = ' '//achar(9)//achar(13)//','
  character(len=*), parameter :: line_ends = new_line('a')//achar(13)
  !> Most values of one key; stops a mistyped repeat count.
  integer, parameter :: max_values = 1000000
  character(len=*), parameter :: name_letters = &
    'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_'

contains

  !> Read and split a file; values stay text.
  subroutine read_namelist(path, file, status, text)
    character(len=*), intent(in) :: path
    type(namelist_type), intent(out) :: file
    type(status_type), intent(out) :: status
    !> The text itself, instead of the file.
    character(len=*), intent(in), optional :: text
    type(cursor_type) :: cursor
    type(group_type) :: group

    file%path = path
    allocate (file%groups(0))
    if (present(text)) then
      cursor%text = text
    else
      call read_text_file(path, cursor%text, status)
    end if
    if (status%failed()) return
    do
      call skip_blank(cursor)
      if (cursor%at > len(cursor%text)) exit
      call read_group(cursor, path, group, status)
      if (status%failed()) return
      file%groups = [file%groups, group]
    end do
    if (size(file%groups) == 0) call fail(status, status_input_error, 'scene', &
                                              path//': no group such as &mount found')
  end subroutine read_namelist

  !> Past blanks, commas, comments and line ends.
  subroutine skip_blank(cursor, commas)
    type(cursor_type), intent(inout) :: cursor
    !> How many commas were passed.
    integer, intent(out), optional :: commas
    if (present(commas)) commas = 0
    do while (cursor%at <= len(cursor%text))
      if (cursor%text(cursor%at:cursor%at) == '!') then
        do while (cursor%at <= len(cursor%text))
          if (cursor%text(cursor%at:cursor%at) == new_line('a')) exit
          cursor%at = cursor%at + 1
        end do
      else if (cursor%text(cursor%at:cursor%at) == new_line('a')) then
        cursor%line = cursor%line + 1
        cursor%at = cursor%at + 1
      else if (index(blank, cursor%text(cursor%at:cursor%at)) > 0) then
        if (present(commas) .and. cursor%text(cursor%at:cursor%at) == ',') commas = commas + 1
        cursor%at = cursor%at + 1
      else
        exit
      end if
    end do
  end subroutine skip_blank

  function peek(cursor) result(letter)
    type(cursor_type), intent(in) :: cursor
    character(len=1) :: letter
    letter = ' '
    if (cursor%at <= len(cursor%text)) letter = cursor%text(cursor%at:cursor%at)
  end function peek

  !> The longest run of the given letters from here.
  function take(cursor, letters) result(run)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: letters
    character(len=:), allocatable :: run
    integer :: n
    n = verify(cursor%text(cursor%at:), letters) - 1
    if (n < 0) n = len(cursor%text) - cursor%at + 1
    run = cursor%text(cursor%at:cursor%at + n - 1)
    cursor%at = cursor%at + n
  end function take

  subroutine read_group(cursor, path, group, status)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: path
    type(group_type), intent(out) :: group
    type(status_type), intent(out) :: status
    type(entry_type) :: entry
    integer :: i

    if (peek(cursor) /= '&') then
      call fail_at(path, cursor%line, "'"//word(cursor)//"' stands outside a group: groups " &
                   //'start with &name and end with /', status)
      return
    end if
    cursor%at = cursor%at + 1
    group%name = lower(take(cursor, name_letters))
    group%line = cursor%line
    allocate (group%entries(0))
    if (group%name == '') then
      call fail_at(path, group%line, '& without a name: groups start with &name', status)
      return
    end if
    do
      call skip_blank(cursor)
      if (cursor%at > len(cursor%text)) then
        call fail_at(path, group%line, '&'//group%name//' is not ended: the file stops before ' &
                     //'its /', status)
        return
      end if
      if (peek(cursor) == '/') exit
      if (peek(cursor) == '&') then
        cursor%at = cursor%at + 1
        call fail_at(path, cursor%line, "'&"//take(cursor, name_letters)//"' inside &"//group%name &
                     //' (line '//show(group%line)//'): a group ends with /', status)
        return
      end if
      call read_entry(cursor, path, group%name, entry, status)
      if (status%failed()) return
      i = group%find(entry%key)
      if (i > 0) then
        call fail_at(path, entry%line, entry%key//' is given twice in &'//group%name &
                     //' (first in line '//show(group%entries(i)%line)//')', status)
        return
      end if
      group%entries = [group%entries, entry]
    end do
    cursor%at = cursor%at + 1
  end subroutine read_group

  subroutine read_entry(cursor, path, group, entry, status)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: path, group
    type(entry_type), intent(out) :: entry
    type(status_type), intent(out) :: status
    type(value_type) :: value
    integer :: repeats, commas, n, at, line
    logical :: key_follows

    entry%line = cursor%line
    entry%key = lower(take(cursor, name_letters))
    call skip_blank(cursor)
    if (entry%key == '' .or. peek(cursor) /= '=') then
      if (entry%key == '') entry%key = word(cursor)
      call fail_at(path, entry%line, "'"//entry%key//"' in &"//group//" is not followed by '=': " &
                   //'keys are given as key = value, a group ends with /', status)
      return
    end if
    cursor%at = cursor%at + 1
    allocate (entry%values(8))
    n = 0
    do
      call skip_blank(cursor, commas)
      if (cursor%at > len(cursor%text) .or. index('/&', peek(cursor)) > 0) exit
      at = cursor%at
      line = cursor%line
      key_follows = take(cursor, name_letters) /= ''
      call skip_blank(cursor)
      key_follows = key_follows .and. peek(cursor) == '='
      cursor%at = at
      cursor%line = line
      if (key_follows) exit
      if (commas > merge(1, 0, n > 0)) then
        call fail_at(path, line, entry%key//': no value before a comma', status)
        return
      end if
      call read_value(cursor, path, entry%key, value, repeats, status)
      if (status%failed()) return
      if (n + repeats > max_values) then
        call fail_at(path, line, entry%key//': must have at most '//show(max_values)//' values', &
                     status)
        return
      end if
      call append(entry%values, n, value, repeats)
    end do
    call resize(entry%values, n)
    if (n == 0) call fail_at(path, entry%line, entry%key//' has no value', status)
  end subroutine read_entry

  !> Add a value some times to a list of which n are in use.
  pure subroutine append(values, n, value, repeats)
    type(value_type), allocatable, intent(inout) :: values(:)
    integer, intent(inout) :: n
    type(value_type), intent(in) :: value
    integer, intent(in) :: repeats
    if (n + repeats > size(values)) call resize(values, 2*(n + repeats))
    values(n + 1:n + repeats) = value
    n = n + repeats
  end subroutine append

  !> Another length for a list; the texts are moved, not copied.
  pure subroutine resize(values, n)
    type(value_type), allocatable, intent(inout) :: values(:)
    integer, intent(in) :: n
    type(value_type), allocatable :: moved(:)
    integer :: i
    allocate (moved(n))
    do i = 1, min(n, size(values))
      moved(i)%quoted = values(i)%quoted
      call move_alloc(values(i)%text, moved(i)%text)
    end do
    call move_alloc(moved, values)
  end subroutine resize

  subroutine read_value(cursor, path, key, value, repeats, status)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: path, key
    type(value_type), intent(out) :: value
    integer, intent(out) :: repeats
    type(status_type), intent(out) :: status
    character(len=1) :: quote
    logical :: ok
    integer :: n, star

    repeats = 1
    quote = peek(cursor)
    if (quote == '"' .or. quote == "'") then
      value%quoted = .true.
      value%text = ''
      do
        n = index(cursor%text(cursor%at + 1:), quote)
        if (n == 0 .or. &
            scan(cursor%text(cursor%at + 1:cursor%at + max(n, 1)), line_ends) > 0) then
          call fail_at(path, cursor%line, key//': the quoted text is not ended', status)
          return
        end if
        value%text = value%text//cursor%text(cursor%at + 1:cursor%at + n - 1)
        cursor%at = cursor%at + n + 1
        if (peek(cursor) /= quote) exit
        value%text = value%text//quote
      end do
      return
    end if
    value%text = word(cursor)
    cursor%at = cursor%at + len(value%text)
    star = index(value%text, '*')
    if (star > 0) then
      call parse_integer(value%text(:star - 1), repeats, ok)
      if (.not. ok .or. repeats < 1 .or. repeats > max_values .or. star == len(value%text)) then
        call fail_at(path, cursor%line, key//' = '//value%text//': must be a value, or a count ' &
                     //'(1 to '//show(max_values)//') and a value as in 3*0.5', status)
        return
      end if
      value%text = value%text(star + 1:)
    end if
  end subroutine read_value

  !> From here to the next separator.
  function word(cursor)
    type(cursor_type), intent(in) :: cursor
    character(len=:), allocatable :: word
    integer :: n
    n = scan(cursor%text(cursor%at:), blank//new_line('a')//'/!=&') - 1
    if (n < 0) n = len(cursor%text) - cursor%at + 1
    n = max(n, 1)
    word = cursor%text(cursor%at:min(cursor%at + n - 1, len(cursor%text)))
  end function word

  subroutine fail_at(path, line, message, status)
    character(len=*), intent(in) :: path, message
    integer, intent(in) :: line
    type(status_type), intent(out) :: status
    call fail(status, status_input_error, 'scene', path//':'//show(line)//': '//message)
  end subroutine fail_at

  !> Index of a key, 0 if absent.
  pure integer function find(self, key)
    class(group_type), intent(in) :: self
    character(len=*), intent(in) :: key
    do find = size(self%entries), 1, -1
      if (self%entries(find)%key == key) return
    end do
    find = 0
  end function find

  !> Line of a key (what follows a blank is ignored), else of the group.
  pure integer function line_of(self, key)
    class(group_type), intent(in) :: self
    character(len=*), intent(in) :: key
    integer :: i, n
    n = index(key, ' ') - 1
    if (n < 0) n = len(key)
    i = self%find(key(:n))
    line_of = self%line
    if (i > 0) line_of = self%entries(i)%line
  end function line_of

  pure function lower(text)
    character(len=*), intent(in) :: text
    character(len=len(text)) :: lower
    integer :: i
    lower = text
    do i = 1, len(text)
      if (text(i:i) >= 'A' .and. text(i:i) <= 'Z') lower(i:i) = achar(iachar(text(i:i)) + 32)
    end do
  end function lower

end module viscovib_namelist
