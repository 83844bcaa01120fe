! Optimize: -O1
!> Namelist files, read with the line of everything kept, so that an error can
!! say `file:line: what is wrong, what is allowed`.
!!
!! The compiler's own namelist reading knows neither lines nor which key is at
!! fault. Read here: groups `&name key = values /`, `!` comments, quoted
!! strings, numbers, lists over several lines, repeats `3*0.5`. No value may be
!! left out between commas: what follows would move to another place unseen.
!!
!! Time and memory grow with the length of the text alone: lists double, repeats
!! are kept as such, and what no scene needs is refused with a line.
module viscovib_namelist
  use viscovib_kinds, only: wp
  use viscovib_near_words, only: longest
  use viscovib_number_text, only: parse_integer
  use viscovib_status, only: clipped, fail, show, status_input_error, status_type
  use viscovib_text_file, only: read_text_file
  implicit none
  private

  public :: namelist_type, group_type, entry_type, read_namelist, lower

  type :: value_type
    character(len=:), allocatable :: text
    !> What stood in the file, where the text is another: names of parameters, not their numbers.
    character(len=:), allocatable :: written
    logical :: quoted = .false.
    !> How often it stands here.
    integer :: repeats = 1
  end type value_type

  type :: entry_type
    character(len=:), allocatable :: key
    integer :: line = 0
    type(value_type), allocatable :: values(:)
    !> How many values, repeats counted.
    integer :: n_values = 0
  end type entry_type

  type :: group_type
    character(len=:), allocatable :: name
    integer :: line = 0
    type(entry_type), allocatable :: entries(:)
    !> How many of them are in use.
    integer :: n_entries = 0
    !> Files that it names may be anywhere, not only in the folder of the scene and below.
    logical :: anywhere = .false.
    !> Bit of the system of the scene (`system_groups`); all if it is not known.
    integer :: systems = -1
    !> Parameters that its laws may name; not allocated: the scene has none.
    character(len=longest), allocatable :: names(:)
    real(wp), allocatable :: values(:)
  contains
    procedure :: find
    procedure :: line_of
    procedure :: written
  end type group_type

  type :: namelist_type
    character(len=:), allocatable :: path
    type(group_type), allocatable :: groups(:)
  end type namelist_type

  !> Where in the text the parser stands.
  type :: cursor_type
    character(len=:), allocatable :: text
    integer :: at = 1, line = 1
    !> Values read so far, repeats counted.
    integer :: n_values = 0
  end type cursor_type

  character(len=*), parameter :: blank = ' '//achar(9)//achar(13)//','
  character(len=*), parameter :: line_ends = new_line('a')//achar(13)
  !> Most values in a file, which stops a mistyped repeat count; most groups in a file, keys of
  !! a group, letters of a text.
  integer, parameter :: max_values = 1000000, max_groups = 20000, max_keys = 100, &
                        max_text = 65536
  character(len=*), parameter :: name_letters = &
    'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_'

contains

  !> The text of a key as it stands in the file, where that is not what was read.
  pure function written(self, key, otherwise) result(text)
    class(group_type), intent(in) :: self
    character(len=*), intent(in) :: key, otherwise
    character(len=:), allocatable :: text
    integer :: i
    text = otherwise
    i = self%find(key)
    if (i == 0) return
    if (allocated(self%entries(i)%values(1)%written)) text = self%entries(i)%values(1)%written
  end function written

  !> Read and split a file; values stay text.
  subroutine read_namelist(path, file, status, text)
    character(len=*), intent(in) :: path
    type(namelist_type), intent(out) :: file
    type(status_type), intent(out) :: status
    !> The text itself, instead of the file.
    character(len=*), intent(in), optional :: text
    type(cursor_type) :: cursor
    type(group_type), allocatable :: groups(:)
    integer :: n

    file%path = path
    allocate (file%groups(0), groups(16))
    n = 0
    if (present(text)) then
      cursor%text = text
    else
      call read_text_file(path, cursor%text, status)
    end if
    if (status%failed()) return
    do
      call skip_blank(cursor)
      if (cursor%at > len(cursor%text)) exit
      if (n == size(groups)) call resize_groups(groups, 2*n)
      n = n + 1
      if (n > max_groups) then
        call fail_at(path, cursor%line, 'a scene must have at most '//show(max_groups)//' groups', &
                     status)
        return
      end if
      call read_group(cursor, path, groups(n), status)
      if (status%failed()) return
    end do
    call resize_groups(groups, n)
    call move_alloc(groups, file%groups)
    if (n == 0) call fail(status, status_input_error, 'scene', &
                                              path//': no group such as &mount found')
  end subroutine read_namelist

  !> Another length for a list of groups; what they hold is moved, not copied.
  subroutine resize_groups(groups, n)
    type(group_type), allocatable, intent(inout) :: groups(:)
    integer, intent(in) :: n
    type(group_type), allocatable :: moved(:)
    integer :: i
    allocate (moved(n))
    do i = 1, min(n, size(groups))
      moved(i)%line = groups(i)%line
      moved(i)%n_entries = groups(i)%n_entries
      call move_alloc(groups(i)%name, moved(i)%name)
      call move_alloc(groups(i)%entries, moved(i)%entries)
    end do
    call move_alloc(moved, groups)
  end subroutine resize_groups

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
    integer :: i, n

    if (peek(cursor) /= '&') then
      call fail_at(path, cursor%line, "'"//clipped(word(cursor))//"' stands outside a group: " &
                   //'groups start with &name and end with /', status)
      return
    end if
    cursor%at = cursor%at + 1
    group%name = lower(take(cursor, name_letters))
    group%line = cursor%line
    allocate (group%entries(4))
    n = 0
    if (group%name == '') then
      call fail_at(path, group%line, '& without a name: groups start with &name', status)
      return
    end if
    do
      call skip_blank(cursor)
      if (cursor%at > len(cursor%text)) then
        call fail_at(path, group%line, '&'//clipped(group%name)//' is not ended: the file stops ' &
                     //'before its /', status)
        return
      end if
      if (peek(cursor) == '/') exit
      if (peek(cursor) == '&') then
        cursor%at = cursor%at + 1
        call fail_at(path, cursor%line, "'&"//clipped(take(cursor, name_letters))//"' inside &" &
                     //clipped(group%name)//' (line '//show(group%line)//'): a group ends with /', &
                     status)
        return
      end if
      if (n == max_keys) then
        call fail_at(path, cursor%line, '&'//clipped(group%name)//': must have at most ' &
                     //show(max_keys)//' keys', status)
        return
      end if
      if (n == size(group%entries)) call resize_entries(group%entries, 2*n)
      associate (entry => group%entries(n + 1))
        call read_entry(cursor, path, group%name, entry, status)
        if (status%failed()) return
        i = group%find(entry%key)
        if (i > 0) then
          call fail_at(path, entry%line, clipped(entry%key)//' is given twice in &' &
                       //clipped(group%name)//' (first in line '//show(group%entries(i)%line) &
                       //')', status)
          return
        end if
      end associate
      n = n + 1
      group%n_entries = n
    end do
    cursor%at = cursor%at + 1
  end subroutine read_group

  !> As `resize_groups`, for the keys of a group.
  subroutine resize_entries(entries, n)
    type(entry_type), allocatable, intent(inout) :: entries(:)
    integer, intent(in) :: n
    type(entry_type), allocatable :: moved(:)
    integer :: i
    allocate (moved(n))
    do i = 1, min(n, size(entries))
      moved(i)%line = entries(i)%line
      moved(i)%n_values = entries(i)%n_values
      call move_alloc(entries(i)%key, moved(i)%key)
      call move_alloc(entries(i)%values, moved(i)%values)
    end do
    call move_alloc(moved, entries)
  end subroutine resize_entries

  subroutine read_entry(cursor, path, group, entry, status)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: path, group
    type(entry_type), intent(out) :: entry
    type(status_type), intent(out) :: status
    integer :: commas, n, at, line
    logical :: key_follows

    entry%line = cursor%line
    entry%key = lower(take(cursor, name_letters))
    call skip_blank(cursor)
    if (entry%key == '' .or. peek(cursor) /= '=') then
      if (entry%key == '') entry%key = word(cursor)
      call fail_at(path, entry%line, "'"//clipped(entry%key)//"' in &"//clipped(group) &
                   //" is not followed by '=': keys are given as key = value, a group ends " &
                   //'with /', status)
      return
    end if
    cursor%at = cursor%at + 1
    allocate (entry%values(1))
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
        call fail_at(path, line, clipped(entry%key)//': no value before a comma', status)
        return
      end if
      if (n == size(entry%values)) call resize(entry%values, 4*n)
      n = n + 1
      associate (value => entry%values(n))
        call read_value(cursor, path, clipped(entry%key), value, status)
        if (status%failed()) return
        entry%n_values = entry%n_values + value%repeats
        cursor%n_values = cursor%n_values + value%repeats
      end associate
      if (cursor%n_values > max_values) then
        call fail_at(path, line, clipped(entry%key)//': a scene must have at most ' &
                     //show(max_values)//' values', status)
        return
      end if
    end do
    call resize(entry%values, n)
    if (n == 0) call fail_at(path, entry%line, clipped(entry%key)//' has no value', status)
  end subroutine read_entry

  !> Another length for a list; the texts are moved, not copied.
  pure subroutine resize(values, n)
    type(value_type), allocatable, intent(inout) :: values(:)
    integer, intent(in) :: n
    type(value_type), allocatable :: moved(:)
    integer :: i
    if (n == size(values)) return
    allocate (moved(n))
    do i = 1, min(n, size(values))
      moved(i)%quoted = values(i)%quoted
      moved(i)%repeats = values(i)%repeats
      call move_alloc(values(i)%text, moved(i)%text)
    end do
    call move_alloc(moved, values)
  end subroutine resize

  subroutine read_value(cursor, path, key, value, status)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: path, key
    type(value_type), intent(out) :: value
    type(status_type), intent(out) :: status
    character(len=1) :: letter
    logical :: ok
    integer :: star

    letter = peek(cursor)
    if (letter == '"' .or. letter == "'") then
      value%quoted = .true.
      call read_quoted(cursor, path, key, value%text, status)
      return
    end if
    value%text = word(cursor)
    cursor%at = cursor%at + len(value%text)
    if (len(value%text) > max_text) then
      call fail_at(path, cursor%line, key//': must have at most '//show(max_text) &
                   //' characters', status)
      return
    end if
    star = index(value%text, '*')
    if (star > 0) then
      call parse_integer(value%text(:star - 1), value%repeats, ok)
      if (.not. ok .or. value%repeats < 1 .or. value%repeats > max_values &
          .or. star == len(value%text)) then
        call fail_at(path, cursor%line, key//' = '//clipped(value%text)//': must be a value, or ' &
                     //'a count (1 to '//show(max_values)//') and a value as in 3*0.5', status)
        return
      end if
      value%text = value%text(star + 1:)
    end if
  end subroutine read_value

  !> What stands between quotes on one line; two of them inside stand for one.
  subroutine read_quoted(cursor, path, key, text, status)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: path, key
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status
    character(len=1) :: quote, letter
    character(len=max_text) :: work
    integer :: n, at

    quote = peek(cursor)
    n = 0
    at = cursor%at + 1
    do
      if (at > len(cursor%text)) exit
      letter = cursor%text(at:at)
      if (index(line_ends, letter) > 0) exit
      if (letter == quote) then
        if (at == len(cursor%text)) then
          text = work(:n)
        else if (cursor%text(at + 1:at + 1) /= quote) then
          text = work(:n)
        else
          at = at + 1
        end if
      end if
      at = at + 1
      if (allocated(text)) then
        cursor%at = at
        return
      end if
      n = n + 1
      if (n > max_text) then
        call fail_at(path, cursor%line, key//': must have at most '//show(max_text) &
                     //' characters', status)
        return
      end if
      work(n:n) = letter
    end do
    call fail_at(path, cursor%line, key//': the quoted text is not ended', status)
  end subroutine read_quoted

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
    do find = self%n_entries, 1, -1
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
