!> Typed reading of one group: every key is asked for by name and type, and
!! what nobody asked for is an error.
!!
!! The reader also writes down, in `echo`, each value as it was understood,
!! defaults included; the echoes of all groups make up the canonical scene.
module viscovib_group_reader
  use, intrinsic :: ieee_arithmetic, only: ieee_get_halting_mode, ieee_is_finite, &
    ieee_overflow, ieee_set_halting_mode
  use viscovib_kinds, only: wp
  use viscovib_namelist, only: group_type, lower
  use viscovib_status, only: fail, show, status_input_error, status_type
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
    character(len=32), allocatable, private :: known(:)
  contains
    procedure :: start
    procedure :: has
    procedure :: read_real
    procedure :: read_integer
    procedure :: read_text
    procedure :: read_reals
    procedure :: place
    procedure :: complain
    procedure :: finish
    procedure, private :: look_up
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
    allocate (self%known(0))
  end subroutine start

  pure logical function has(self, key)
    class(group_reader), intent(in) :: self
    character(len=*), intent(in) :: key
    has = self%group%find(key) > 0
  end function has

  !> Fail at the line of a key.
  subroutine complain(self, key, message)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key, message
    if (self%status%failed()) return
    call fail(self%status, status_input_error, key, &
              self%path//':'//show(self%group%line_of(key))//': '//message)
  end subroutine complain

  !> Give a failure from elsewhere the line of its subject in this group.
  subroutine place(self, status)
    class(group_reader), intent(inout) :: self
    type(status_type), intent(in) :: status
    if (status%failed()) call self%complain(status%subject, status%message)
  end subroutine place

  !> Index of a key that may be absent if a default is given.
  integer function look_up(self, key, optional) result(i)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    logical, intent(in) :: optional
    self%known = [character(len=32) :: self%known, key]
    i = self%group%find(key)
    if (i == 0 .and. .not. optional) call self%miss(key)
    if (self%status%failed()) i = 0
  end function look_up

  !> A required key is absent: perhaps it is there misspelt.
  subroutine miss(self, key)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    integer :: i

    do i = 1, size(self%group%entries)
      associate (given => self%group%entries(i)%key)
        if (any(self%known == given) .or. distance(given, key) > max(len(key)/4, 1)) cycle
        call self%complain(given, unknown(given, self%group%name)//"; did you mean '"//key//"'?")
      end associate
    end do
    call self%complain(self%group%name, '&'//self%group%name//' lacks '//key)
  end subroutine miss

  pure function unknown(key, group)
    character(len=*), intent(in) :: key, group
    character(len=:), allocatable :: unknown
    unknown = "unknown key '"//key//"' in &"//group
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
      if (size(entry%values) > 1) then
        call self%complain(entry%key, entry%key//' has '//show(size(entry%values)) &
                           //' values: must be '//what)
      else if (entry%values(1)%quoted .neqv. quoted) then
        call self%complain(entry%key, entry%key//' = '//entry%values(1)%text//': must be '//what)
      else
        text = entry%values(1)%text
      end if
    end associate
  end function one_value

  !> A finite number from text such as 1, 0.5, 1e-3, 1d-3.
  real(wp) function number(self, key, text)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key, text
    logical :: halting
    integer :: io

    number = 0.0_wp
    io = verify(lower(text), '0123456789.+-ed')
    if (text == '' .or. scan(text, '0123456789') == 0) io = 1
    if (io == 0) then
      ! A number too large becomes infinite and is refused below; do not trap.
      call ieee_get_halting_mode(ieee_overflow, halting)
      call ieee_set_halting_mode(ieee_overflow, .false.)
      read (text, *, iostat=io) number
      call ieee_set_halting_mode(ieee_overflow, halting)
    end if
    if (io == 0) then
      if (.not. ieee_is_finite(number)) io = 1
    end if
    if (io /= 0) then
      call self%complain(key, key//' = '//text//': must be a finite number')
      number = 0.0_wp
    end if
  end function number

  real(wp) function read_real(self, key, default) result(value)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    real(wp), intent(in), optional :: default
    integer :: i

    value = 0.0_wp
    i = self%look_up(key, present(default))
    if (i > 0) then
      value = self%number(key, self%one_value(i, .false., 'a number'))
    else if (present(default)) then
      value = default
    end if
    self%echo = self%echo//'  '//key//' = '//exact(value)//new_line('a')
  end function read_real

  integer function read_integer(self, key, default) result(value)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    integer, intent(in), optional :: default
    character(len=:), allocatable :: text
    integer :: i, io

    value = 0
    i = self%look_up(key, present(default))
    if (i > 0) then
      text = self%one_value(i, .false., 'an integer')
      io = verify(text, '0123456789+-')
      if (io == 0) read (text, *, iostat=io) value
      if (io /= 0) then
        call self%complain(key, key//' = '//text//': must be an integer')
        value = 0
      end if
    else if (present(default)) then
      value = default
    end if
    self%echo = self%echo//'  '//key//' = '//show(value)//new_line('a')
  end function read_integer

  !> A quoted word; with `allowed`, its position there is `choice`.
  function read_text(self, key, default, allowed, choice) result(text)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    character(len=*), intent(in), optional :: default, allowed(:)
    integer, intent(out), optional :: choice
    character(len=:), allocatable :: text
    integer :: i

    text = ''
    i = self%look_up(key, present(default))
    if (i > 0) then
      text = self%one_value(i, .true., 'a quoted text')
    else if (present(default)) then
      text = default
    end if
    if (present(allowed)) then
      text = lower(text)
      do i = size(allowed), 1, -1
        if (allowed(i) == text) exit
      end do
      if (i == 0) call self%complain(key, key//" = '"//text//"': must be one of " &
                                     //listed(allowed, "'"))
      if (present(choice)) choice = max(i, 1)
    end if
    self%echo = self%echo//'  '//key//" = '"//doubled(text)//"'"//new_line('a')
  end function read_text

  !> A list of numbers, of size n if given; empty without a default if absent.
  function read_reals(self, key, n, default) result(values)
    class(group_reader), intent(inout) :: self
    character(len=*), intent(in) :: key
    integer, intent(in), optional :: n
    real(wp), intent(in), optional :: default(:)
    real(wp), allocatable :: values(:)
    integer :: i, j

    allocate (values(0))
    i = self%look_up(key, present(default))
    if (i > 0) then
      associate (entry => self%group%entries(i))
        values = [(0.0_wp, j=1, size(entry%values))]
        do j = 1, size(entry%values)
          if (entry%values(j)%quoted) call self%complain(key, key//" = '" &
                                                         //entry%values(j)%text &
                                                         //"': must be numbers")
          if (.not. self%status%failed()) values(j) = self%number(key, entry%values(j)%text)
        end do
      end associate
      if (present(n)) then
        if (size(values) /= n) call self%complain(key, key//' has '//show(size(values)) &
                                                  //' values: must be '//show(n))
      end if
    else if (present(default)) then
      values = default
    end if
    if (self%status%failed()) values = [(0.0_wp, j=1, merge(n, 0, present(n)))]
    if (size(values) == 0) return
    self%echo = self%echo//'  '//key//' ='
    do j = 1, size(values)
      self%echo = self%echo//' '//exact(values(j))
      if (mod(j, 4) == 0 .and. j < size(values)) self%echo = self%echo//new_line('a')//'    '
    end do
    self%echo = self%echo//new_line('a')
  end function read_reals

  !> Close the group: keys that were never asked for are errors.
  subroutine finish(self)
    class(group_reader), intent(inout) :: self
    integer :: i, near

    self%echo = self%echo//'/'//new_line('a')
    do i = 1, size(self%group%entries)
      associate (key => self%group%entries(i)%key)
        if (any(self%known == key)) cycle
        near = closest(key, self%known)
        if (near > 0) then
          call self%complain(key, unknown(key, self%group%name)//"; did you mean '" &
                             //trim(self%known(near))//"'?")
        else
          call self%complain(key, unknown(key, self%group%name)//': must be one of ' &
                             //listed(self%known, ''))
        end if
      end associate
    end do
  end subroutine finish

  !> Text that reads back to the same number.
  pure function exact(value)
    real(wp), intent(in) :: value
    character(len=24) :: exact
    write (exact, '(es24.16e3)') value
    exact = adjustl(exact)
  end function exact

  !> Quotes doubled, as inside a quoted text.
  pure function doubled(text)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: doubled
    integer :: i
    doubled = ''
    do i = 1, len(text)
      doubled = doubled//text(i:i)
      if (text(i:i) == "'") doubled = doubled//"'"
    end do
  end function doubled

  pure function listed(words, quote)
    character(len=*), intent(in) :: words(:), quote
    character(len=:), allocatable :: listed
    integer :: i
    listed = ''
    do i = 1, size(words)
      if (i > 1) listed = listed//', '
      listed = listed//quote//trim(words(i))//quote
    end do
  end function listed

  !> The word that differs least, if by at most a third of its letters.
  pure integer function closest(key, words)
    character(len=*), intent(in) :: key, words(:)
    integer :: i, best, d
    closest = 0
    best = max(len(key)/3, 1) + 1
    do i = 1, size(words)
      d = distance(key, trim(words(i)))
      if (d < best) then
        best = d
        closest = i
      end if
    end do
  end function closest

  !> Letters to change, add or drop (Levenshtein).
  pure integer function distance(a, b)
    character(len=*), intent(in) :: a, b
    integer :: row(0:len(b)), i, j, corner, above
    row = [(j, j=0, len(b))]
    do i = 1, len(a)
      corner = row(0)
      row(0) = i
      do j = 1, len(b)
        above = row(j)
        row(j) = min(row(j) + 1, row(j - 1) + 1, corner + merge(0, 1, a(i:i) == b(j:j)))
        corner = above
      end do
    end do
    distance = row(len(b))
  end function distance

end module viscovib_group_reader
