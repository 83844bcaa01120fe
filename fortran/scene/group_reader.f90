! Optimize: -O1
!> Typed reading of one group: every key is read by name and type. Its default, bounds and allowed
!! words are those of its row in `scenes.toml`. A key that is not read is an error.
!!
!! The reader also writes down, in `echo`, each value as it was understood,
!! defaults included; the echoes of all groups make up the canonical scene.
module viscovib_group_reader
  use viscovib_files, only: real_path
  use viscovib_growing_text, only: growing_text
  use viscovib_kinds, only: wp
  use viscovib_namelist, only: group_type, lower
  use viscovib_near_words, only: closest, doubled, listed, longest, means, off_by
  use viscovib_number_text, only: exact, exact_list, parse_integer, parse_real
  use viscovib_scene_table, only: find_group, group_table, key_names, key_row, key_table, words_of
  use viscovib_status, only: clipped, fail, show, status_input_error, status_type
  implicit none
  private

  public :: group_reader

  type :: group_reader
    character(len=:), allocatable :: path
    type(group_type) :: group
    !> The first thing that went wrong; later reads then do nothing.
    type(status_type) :: status
    !> Canonical lines of the group.
    character(len=:), allocatable :: echo
    !> Rows of the group in `key_table`, and which of them were read.
    integer, private :: first = 1, last = 0
    logical, allocatable, private :: was_read(:)
  contains
    procedure :: start
    procedure :: has
    procedure :: may_have
    procedure :: read_real
    procedure :: read_formula
    procedure :: read_integer
    procedure :: read_count
    procedure :: read_yes
    procedure :: read_text
    procedure :: read_reals
    procedure :: read_integers
    procedure :: read_some_integers
    procedure :: read_words
    procedure :: read_path
    procedure :: echo_reals
    procedure :: refuse
    procedure :: place
    procedure :: complain
    procedure :: finish
    procedure :: close
    procedure, private :: look_up
    procedure, private :: row_of
    procedure, private :: check
    procedure, private :: choose
    procedure, private :: known
    procedure, private :: miss
    procedure, private :: one_value
    procedure, private :: number
  end type group_reader

contains

  subroutine start(self, path, group)
    class(group_reader), intent(out) :: self
    character(len=*), intent(in) :: path
    type(group_type), intent(in) :: group
    self%path = path
    self%group = group
    self%echo = '&'//group%name//new_line('a')
    associate (row => group_table(max(find_group(group%name), 1)))
      self%first = row%first
      self%last = row%last
    end associate
    allocate (self%was_read(self%first:self%last), source=.false.)
  end subroutine start

  pure logical function has(self, key)
    class(group_reader), intent(in) :: self
    character(len=*), intent(in) :: key
    has = self%group%find(key) > 0
  end function has

  !> Whether a key is there, which the group may have.
  logical function may_have(self, key)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    may_have = self%has(key)
    if (.not. may_have) self%was_read(self%row_of(key)) = .true.
  end function may_have

  !> The row of a key for the system of the scene; 0 if there is none.
  pure integer function row_of(self, key) result(row)
    class(group_reader), intent(in) :: self
    character(len=*), intent(in) :: key
    do row = self%last, self%first, -1
      if (iand(key_table(row)%systems, self%group%systems) == 0) cycle
      if (key_table(row)%name == key .or. key_table(row)%name == '*') return
    end do
    row = 0
  end function row_of

  !> True if a key has been read.
  pure logical function known(self, key)
    class(group_reader), intent(in) :: self
    character(len=*), intent(in) :: key
    integer :: row
    row = self%row_of(key)
    known = row > 0
    if (known) known = self%was_read(row)
  end function known

  !> Fail if a number is out of the bounds of its row.
  subroutine check(self, key, row, value)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    type(key_row), intent(in) :: row
    real(wp), intent(in) :: value
    character(len=:), allocatable :: shown
    if (row%allows(value)) return
    shown = show(value)
    if (row%whole) shown = show(nint(value))
    call self%complain(key, key//' = '//shown//': '//trim(row%must))
  end subroutine check

  !> Fail at the line of a key.
  subroutine complain(self, key, message, category)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key, message
    !> Default: an input error.
    integer, intent(in), optional :: category
    integer :: kind
    if (self%status%failed()) return
    kind = status_input_error
    if (present(category)) kind = category
    call fail(self%status, kind, key, &
              self%path//':'//show(self%group%line_of(key))//': '//message)
  end subroutine complain

  !> Fail if the group contains keys that have no meaning together with the other keys.
  subroutine refuse(self, keys, why)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: keys(:), why
    integer :: i
    do i = 1, size(keys)
      if (self%has(trim(keys(i)))) call self%complain(trim(keys(i)), trim(keys(i))//': '//why)
    end do
  end subroutine refuse

  !> Give a failure from elsewhere the line of its subject in this group.
  subroutine place(self, status)
    class(group_reader), intent(inout) :: self
    type(status_type), intent(in) :: status
    if (status%failed()) call self%complain(status%subject, status%message)
  end subroutine place

  !> Index of a key and its row. It may be absent if there is a default.
  integer function look_up(self, key, optional, row) result(i)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    logical, intent(in) :: optional
    type(key_row), intent(out) :: row
    integer :: place

    i = 0
    place = self%row_of(key)
    if (place == 0) then
      call self%complain(key, "'"//key//"' has no row for this system in &"//self%group%name &
                         //' of fortran/spec/scenes.toml')
      return
    end if
    row = key_table(place)
    self%was_read(place) = .true.
    i = self%group%find(key)
    if (i == 0 .and. .not. (optional .or. row%has_default)) call self%miss(key)
    if (self%status%failed()) i = 0
  end function look_up

  !> A required key is absent: perhaps it is there misspelt.
  subroutine miss(self, key)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    integer :: i

    do i = 1, self%group%n_entries
      associate (given => self%group%entries(i)%key)
        if (self%row_of(given) > 0) cycle
        if (off_by(given, key) > max(len(key)/4, 1) .and. .not. means(given, key)) cycle
        call self%complain(given, unknown(given, self%group%name)//"; did you mean '"//key//"'?")
      end associate
    end do
    call self%complain(self%group%name, '&'//self%group%name//' lacks '//key)
  end subroutine miss

  pure function unknown(key, group)
    character(len=*), intent(in) :: key, group
    character(len=:), allocatable :: unknown
    unknown = "unknown key '"//clipped(key)//"' in &"//group
  end function unknown

  !> Text of a key that must have one value.
  function one_value(self, i, quoted, what) result(text)
    class(group_reader), intent(inout) :: self
    integer, intent(in) :: i
    logical, intent(in) :: quoted
    character(len=*), intent(in) :: what
    character(len=:), allocatable :: text

    text = ''
    associate (entry => self%group%entries(i))
      if (entry%n_values > 1) then
        call self%complain(entry%key, entry%key//' has '//show(entry%n_values) &
                           //' values: must be '//what)
      else if (entry%values(1)%quoted .neqv. quoted) then
        call self%complain(entry%key, entry%key//' = '//clipped(entry%values(1)%text) &
                           //': must be '//what)
      else
        text = entry%values(1)%text
      end if
    end associate
  end function one_value

  !> A finite number from text such as 1, 0.5, 1e-3, 1d-3.
  real(wp) function number(self, key, text)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key, text
    logical :: ok
    call parse_real(text, number, ok)
    if (.not. ok) call self%complain(key, key//' = '//clipped(text)//': must be a finite number')
  end function number

  real(wp) function read_real(self, key, default) result(value)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    !> In place of that of the table.
    real(wp), intent(in), optional :: default
    type(key_row) :: row
    integer :: i

    i = self%look_up(key, present(default), row)
    value = row%default
    if (present(default)) value = default
    if (i > 0) then
      value = self%number(key, self%one_value(i, .false., 'a number'))
      call self%check(key, row, value)
    end if
    self%echo = self%echo//'  '//key//' = '//exact(value)//new_line('a')
  end function read_real

  !> A number, or a quoted text; the text is empty for a number, which is 1 for a text.
  subroutine read_formula(self, key, value, text, default)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    real(wp), intent(out) :: value
    character(len=:), allocatable, intent(out) :: text
    !> In place of that of the table.
    real(wp), intent(in), optional :: default
    logical :: quoted
    integer :: i

    i = self%group%find(key)
    quoted = .false.
    if (i > 0) quoted = self%group%entries(i)%values(1)%quoted
    value = 1.0_wp
    text = ''
    if (quoted) then
      text = self%read_text(key)
      if (text == '') call self%complain(key, key//" = '': must be a number or a formula in nu")
    else
      value = self%read_real(key, default)
    end if
  end subroutine read_formula

  integer function read_integer(self, key, default) result(value)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    !> In place of that of the table.
    integer, intent(in), optional :: default
    type(key_row) :: row
    character(len=:), allocatable :: text
    logical :: ok
    integer :: i

    i = self%look_up(key, present(default), row)
    value = nint(row%default)
    if (present(default)) value = default
    if (i > 0) then
      text = self%one_value(i, .false., 'an integer')
      call parse_integer(text, value, ok)
      if (.not. ok) call self%complain(key, key//' = '//clipped(text) &
                                       //': must be an integer of at most '//show(huge(value)))
      ! Its size has no opposite: abs and sign overflow.
      if (ok .and. value < -huge(value)) call self%complain(key, key//' = '//text &
                                                            //': must be an integer of at least ' &
                                                            //show(-huge(value)))
      call self%check(key, row, real(value, wp))
    end if
    self%echo = self%echo//'  '//key//' = '//show(value)//new_line('a')
  end function read_integer

  !> An integer, or 'auto'; then the default, and `chosen` is true.
  subroutine read_count(self, key, value, chosen)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    !> Hold the default on entry.
    integer, intent(inout) :: value
    logical, intent(out) :: chosen
    character(len=:), allocatable :: text
    integer :: i

    i = self%group%find(key)
    chosen = i == 0
    if (i > 0) then
      chosen = self%group%entries(i)%values(1)%quoted
      text = self%group%entries(i)%values(1)%text
      if (.not. chosen .and. text == 'auto') then
        call self%complain(key, key//" = auto: must be an integer or, in quotes, 'auto'")
        return
      end if
    end if
    if (chosen) then
      text = self%read_text(key, allowed=['auto'])
    else
      value = self%read_integer(key)
    end if
  end subroutine read_count

  !> 'yes' or 'no'.
  logical function read_yes(self, key)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    read_yes = self%read_text(key) == 'yes'
  end function read_yes

  !> A quoted text; one of the words of the table, or of `allowed` in place of them, if there are
  !! any. The position of the word is `choice`.
  function read_text(self, key, default, allowed, choice) result(text)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    character(len=*), intent(in), optional :: default, allowed(:)
    integer, intent(out), optional :: choice
    type(key_row) :: row
    character(len=:), allocatable :: text
    integer :: i

    i = self%look_up(key, present(default), row)
    if (i > 0) then
      text = self%one_value(i, .true., 'a quoted text')
    else if (present(default)) then
      text = default
    else
      text = trim(row%default_text)
    end if
    i = 1
    if (present(allowed)) then
      call self%choose(key, allowed, text, i)
    else if (row%words /= '') then
      call self%choose(key, words_of(row%words), text, i)
    end if
    if (present(choice)) choice = i
    self%echo = self%echo//'  '//key//" = '"//doubled(self%group%written(key, text))//"'" &
                //new_line('a')
  end function read_text

  !> Which of the words a text is, 1 if it is none.
  subroutine choose(self, key, words, text, choice)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key, words(:)
    character(len=:), allocatable, intent(inout) :: text
    integer, intent(out) :: choice
    character(len=:), allocatable :: meant

    text = lower(text)
    do choice = size(words), 1, -1
      if (words(choice) == text) return
    end do
    meant = ''
    choice = closest(text, words)
    if (choice > 0) meant = "; did you mean '"//trim(words(choice))//"'?"
    call self%complain(key, key//" = '"//clipped(text)//"': must be one of "//listed(words, "'") &
                       //meant)
    choice = 1
  end subroutine choose

  !> A list of numbers, of size n or that of the table if given; if absent, so many times the
  !! default of the table.
  function read_reals(self, key, n, default) result(values)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    integer, intent(in), optional :: n
    real(wp), intent(in), optional :: default(:)
    real(wp), allocatable :: values(:)
    type(key_row) :: row
    real(wp) :: value
    integer :: i, j, last, length

    i = self%look_up(key, present(default), row)
    length = row%length
    if (present(n)) length = n
    if (i > 0) then
      associate (entry => self%group%entries(i))
        if ((present(n) .or. length > 0) .and. entry%n_values /= length) then
          call self%complain(key, key//' has '//show(entry%n_values)//' values: must be ' &
                             //show(length))
        end if
        if (.not. self%status%failed()) then
          allocate (values(entry%n_values))
          last = 0
          value = 0.0_wp
          do j = 1, size(entry%values)
            if (entry%values(j)%quoted) then
              call self%complain(key, key//" = '"//clipped(entry%values(j)%text) &
                                 //"': must be numbers")
            else
              value = self%number(key, entry%values(j)%text)
              call self%check(key, row, value)
            end if
            if (self%status%failed()) exit
            values(last + 1:last + entry%values(j)%repeats) = value
            last = last + entry%values(j)%repeats
          end do
        end if
      end associate
    else if (present(default)) then
      values = default
    else
      if (.not. present(n)) length = max(length, 1)
      allocate (values(length), source=row%default)
    end if
    if (self%status%failed()) values = [(0.0_wp, j=1, length)]
    call self%echo_reals(key, values)
  end function read_reals

  !> A list of n integers.
  function read_integers(self, key, n) result(values)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    integer, intent(in) :: n
    integer :: values(n)
    type(growing_text) :: line
    type(key_row) :: row
    logical :: ok
    integer :: i, j, last, value

    values = 0
    i = self%look_up(key, .false., row)
    if (i == 0) return
    associate (entry => self%group%entries(i))
      if (entry%n_values /= n) then
        call self%complain(key, key//' has '//show(entry%n_values)//' values: must be '//show(n))
        return
      end if
      last = 0
      do j = 1, size(entry%values)
        ok = .not. entry%values(j)%quoted
        if (ok) call parse_integer(entry%values(j)%text, value, ok)
        if (ok) ok = value >= -huge(n)
        if (.not. ok) then
          call self%complain(key, key//' = '//clipped(entry%values(j)%text) &
                             //': must be integers of at most '//show(huge(n)))
          return
        end if
        values(last + 1:last + entry%values(j)%repeats) = value
        last = last + entry%values(j)%repeats
      end do
    end associate
    call line%add('  '//key//' =')
    do j = 1, n
      call line%add(' '//show(values(j)))
    end do
    self%echo = self%echo//line%text()//new_line('a')
  end function read_integers

  !> A list of at most so many integers; empty, and not echoed, if absent.
  function read_some_integers(self, key, most) result(values)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    integer, intent(in) :: most
    integer, allocatable :: values(:)
    type(key_row) :: row
    integer :: i

    allocate (values(0))
    i = self%look_up(key, .true., row)
    if (i == 0) return
    associate (given => self%group%entries(i)%n_values)
      if (given <= most) then
        values = self%read_integers(key, given)
      else
        call self%complain(key, key//': '//show(given)//' of them, must be at most '//show(most))
      end if
    end associate
  end function read_some_integers

  !> A list of at most so many quoted words of at most `length` letters.
  function read_words(self, key, length, most, default) result(words)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    integer, intent(in) :: length, most
    character(len=*), intent(in), optional :: default(:)
    character(len=length), allocatable :: words(:)
    type(growing_text) :: line
    type(key_row) :: row
    integer :: i, j, last

    allocate (words(0))
    i = self%look_up(key, present(default), row)
    if (i > 0) then
      associate (entry => self%group%entries(i))
        if (entry%n_values > most) then
          call self%complain(key, key//': '//show(entry%n_values)//' texts, must be at most ' &
                             //show(most))
          return
        end if
        deallocate (words)
        allocate (words(entry%n_values))
        words = ''
        last = 0
        do j = 1, size(entry%values)
          associate (given => entry%values(j))
            if (.not. given%quoted) then
              call self%complain(key, key//' = '//clipped(given%text)//': must be quoted texts')
            else if (len(given%text) > length .or. given%text == '') then
              call self%complain(key, key//" = '"//clipped(given%text)//"': must have 1 to " &
                                 //show(length)//' characters')
            else
              words(last + 1:last + given%repeats) = given%text
            end if
            last = last + given%repeats
          end associate
        end do
      end associate
    else if (present(default)) then
      words = default
    end if
    if (size(words) == 0) return
    call line%add('  '//key//' =')
    do j = 1, size(words)
      call line%add(" '"//doubled(trim(words(j)))//"'")
    end do
    self%echo = self%echo//line%text()//new_line('a')
  end function read_words

  !> Write down a list that stands for what was read.
  subroutine echo_reals(self, key, values)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    real(wp), intent(in) :: values(:)
    if (size(values) == 0) return
    self%echo = self%echo//'  '//key//' ='//exact_list(values)//new_line('a')
  end subroutine echo_reals

  !> A file name, seen from the folder of the scene; empty if absent. Not
  !! echoed: what is in the file is.
  function read_path(self, key) result(path)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    character(len=:), allocatable :: path, given
    type(key_row) :: row
    integer :: i
    path = ''
    i = self%look_up(key, .true., row)
    if (i == 0) return
    path = self%one_value(i, .true., 'a quoted file name')
    if (self%status%failed()) return
    given = path
    if (path == '') call self%complain(key, key//" = '': must be a file name")
    if (index(path, '/') /= 1) path = self%path(:index(self%path, '/', back=.true.))//path
    if (self%group%anywhere .or. self%status%failed()) return
    if (.not. below(given, path, self%path)) then
      call self%complain(key, key//" = '"//clipped(given)//"': must be in the folder of the " &
                         //'scene or below it; --allow-paths, in Python allow_paths=True, lifts ' &
                         //'this')
    end if
  end function read_path

  !> Whether a file is in the folder of another or below it, links followed. Of one that is not
  !! there, its name tells.
  logical function below(given, path, scene)
    !> As it is named, and seen from here.
    character(len=*), intent(in) :: given, path
    character(len=*), intent(in) :: scene
    character(len=:), allocatable :: folder, file

    folder = scene(:index(scene, '/', back=.true.))
    folder = real_path(folder//'.')//'/'
    if (folder == '//') folder = '/'
    file = real_path(path)
    if (file == '') then
      below = index(given, '/') /= 1 .and. index('/'//given//'/', '/../') == 0
    else
      below = index(file, folder) == 1
    end if
  end function below

  !> Close the group: keys that were never asked for are errors.
  subroutine finish(self)
    class(group_reader), intent(inout) :: self
    character(len=longest), allocatable :: names(:)
    integer :: i, near

    self%echo = self%echo//'/'//new_line('a')
    do i = 1, self%group%n_entries
      associate (key => self%group%entries(i)%key)
        if (self%known(key)) cycle
        names = pack(key_names(self%first:self%last), self%was_read)
        near = closest(key, names)
        if (near > 0) then
          call self%complain(key, unknown(key, self%group%name)//"; did you mean '" &
                             //trim(names(near))//"'?")
        else
          call self%complain(key, unknown(key, self%group%name)//': must be one of ' &
                             //listed(names, '')//elsewhere(key))
        end if
      end associate
    end do
  end subroutine finish

  !> Groups that have a key, for the message about one that stands in another group.
  pure function elsewhere(key) result(text)
    character(len=*), intent(in) :: key
    character(len=:), allocatable :: text
    integer :: i
    text = ''
    do i = 1, size(group_table)
      associate (group => group_table(i))
        if (any(key_names(group%first:group%last) == key)) text = text//', &'//trim(group%name)
      end associate
    end do
    if (text /= '') text = "; '"//key//"' is a key of "//text(3:)
  end function elsewhere

  !> Finish a group, and hand on its failure and its canonical text.
  subroutine close(self, canonical, status)
    class(group_reader), intent(inout) :: self
    type(growing_text), intent(inout) :: canonical
    type(status_type), intent(out) :: status
    call self%finish()
    status = self%status
    call canonical%add(self%echo)
  end subroutine close

end module viscovib_group_reader
