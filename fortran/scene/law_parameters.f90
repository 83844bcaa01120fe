!> The &parameters group of a scene: numbers with names, which laws may use.
!!
!! Each name in a text of a law stands for its number; the scene as it was understood keeps the
!! names, so that sweeps find `parameters.k3`.
module viscovib_law_parameters
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: functions
  use viscovib_namelist, only: entry_type, lower, namelist_type
  use viscovib_near_words, only: longest
  use viscovib_number_text, only: exact
  use viscovib_scene_groups, only: place_of
  use viscovib_shaft_system, only: torque_arguments
  use viscovib_status, only: clipped, show, status_type
  implicit none
  private

  public :: read_parameters

  character(len=*), parameter :: letters = 'abcdefghijklmnopqrstuvwxyz' &
                                           //'ABCDEFGHIJKLMNOPQRSTUVWXYZ_', &
                                 digits = '0123456789', &
                                 keys(8) = [character(len=9) :: 'law', 'law_x', 'law_y', 'law_z', &
                                                             'function', 'amplitude', 'phase', &
                                                             'torque']

  type :: parameter_type
    character(len=longest) :: name = ''
    character(len=:), allocatable :: number
    logical :: used = .false.
  end type parameter_type

contains

  !> Read the group, if there is one, and put its numbers into the laws of all groups.
  subroutine read_parameters(file, unused, echo, status)
    type(namelist_type), intent(inout) :: file
    !> Error of the first parameter that is in no law, empty if all are used. It is reported last,
    !! because a name in a law may be misspelt.
    character(len=:), allocatable, intent(out) :: unused
    !> Gets the canonical text of the group added.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(parameter_type), allocatable :: known(:)
    type(group_reader) :: reader
    real(wp), allocatable :: values(:)
    integer :: i, j, at

    unused = ''
    at = place_of(file, 'parameters')
    if (at > size(file%groups)) return
    call reader%start(file%path, file%groups(at))
    allocate (known(file%groups(at)%n_entries), values(file%groups(at)%n_entries))
    do i = 1, size(known)
      associate (name => file%groups(at)%entries(i)%key)
        call check_name(reader, file, name)
        if (reader%status%failed()) exit
        known(i)%name = name
        values(i) = reader%read_real(name)
        known(i)%number = '('//trim(exact(values(i)))//')'
      end associate
    end do
    call reader%close(echo, status)
    if (status%failed()) return
    do i = 1, size(file%groups)
      if (.not. any([character(len=12) :: 'force', 'element', 'mount_point', 'event', 'load', &
                     'drive_torque'] == file%groups(i)%name)) cycle
      file%groups(i)%names = known%name
      file%groups(i)%values = values
      do j = 1, file%groups(i)%n_entries
        associate (entry => file%groups(i)%entries(j))
          if (.not. any(keys == entry%key) .or. entry%n_values /= 1) cycle
          if (entry%values(1)%quoted) call put_numbers(entry, known)
        end associate
      end do
    end do
    do i = 1, size(known)
      if (known(i)%used) cycle
      unused = file%path//':'//show(file%groups(at)%line_of(trim(known(i)%name)))//': ' &
               //trim(known(i)%name)//': is in no law, must be in one'
      return
    end do
  end subroutine read_parameters

  !> A parameter has a name of its own, that no coordinate, function or argument has.
  subroutine check_name(reader, file, name)
    type(group_reader), intent(inout) :: reader
    type(namelist_type), intent(in) :: file
    character(len=*), intent(in) :: name
    integer :: system, k

    if (len(name) > longest .or. verify(name, letters//digits) > 0 &
        .or. scan(name, digits) == 1) then
      call reader%complain(name, "'"//clipped(name)//"': must be a name of at most " &
                           //show(longest)//' letters, digits and _, not begun by a digit')
    else if (any(functions == name) .or. any(['d ', 'v ', 'pi'] == name)) then
      call reader%complain(name, name//': is a name that laws have already, must be another')
    end if
    if (name == 'nu' .and. has_formulas(file)) call reader%complain(name, 'nu: is the frequency ' &
      //'in a formula of a &load, must be another name')
    if (any(torque_arguments == name) &
        .and. place_of(file, 'drive_torque') <= size(file%groups)) then
      call reader%complain(name, name//': is an argument of a torque, must be another name')
    end if
    system = place_of(file, 'system')
    if (system > size(file%groups)) return
    k = file%groups(system)%find('coordinates')
    if (k == 0) return
    associate (names => file%groups(system)%entries(k)%values)
      do k = 1, size(names)
        if (lower(names(k)%text) == name .or. lower(names(k)%text)//'_dot' == name) then
          call reader%complain(name, name//': is the name of a coordinate, must be another')
        end if
      end do
    end associate
  end subroutine check_name

  !> True if an amplitude or a phase of a load is a text.
  pure logical function has_formulas(file)
    type(namelist_type), intent(in) :: file
    integer :: i, k

    has_formulas = .false.
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'load') cycle
      do k = 1, file%groups(i)%n_entries
        associate (entry => file%groups(i)%entries(k))
          if (.not. any(['amplitude', 'phase    '] == entry%key)) cycle
          if (entry%values(1)%quoted) has_formulas = .true.
        end associate
      end do
    end do
  end function has_formulas

  !> A law with numbers instead of names. The original text is kept.
  subroutine put_numbers(entry, known)
    type(entry_type), intent(inout) :: entry
    type(parameter_type), intent(inout) :: known(:)
    type(growing_text) :: made
    integer :: first, last, k

    associate (text => entry%values(1)%text)
      first = 1
      do while (first <= len(text))
        last = first
        if (scan(text(first:first), letters) > 0) then
          last = end_of(text, first, letters//digits)
          k = 0
          if (.not. is_called(text, last)) then
            do k = size(known), 1, -1
              if (known(k)%name == lower(text(first:last))) exit
            end do
          end if
          if (k > 0) then
            known(k)%used = .true.
            call made%add(known(k)%number)
          else
            call made%add(text(first:last))
          end if
        else
          if (scan(text(first:first), digits//'.') > 0) last = end_of_number(text, first)
          call made%add(text(first:last))
        end if
        first = last + 1
      end do
      if (made%text() == text) return
      entry%values(1)%written = text
      entry%values(1)%text = made%text()
    end associate
  end subroutine put_numbers

  !> Whether a bracket follows, as behind a function.
  pure logical function is_called(text, last)
    character(len=*), intent(in) :: text
    integer, intent(in) :: last
    integer :: next
    next = verify(text(last + 1:), ' ')
    is_called = .false.
    if (next > 0) is_called = text(last + next:last + next) == '('
  end function is_called

  !> The last of the letters of a set that begin at a place.
  pure integer function end_of(text, first, set) result(last)
    character(len=*), intent(in) :: text, set
    integer, intent(in) :: first
    last = verify(text(first:), set)
    if (last == 0) then
      last = len(text)
    else
      last = first + last - 2
    end if
  end function end_of

  !> The end of a number such as 1, 0.5, 2e-3: its e is no name.
  pure integer function end_of_number(text, first) result(last)
    character(len=*), intent(in) :: text
    integer, intent(in) :: first
    integer :: at

    last = end_of(text, first, digits//'.')
    at = last + 1
    if (at > len(text)) return
    if (scan(text(at:at), 'eEdD') == 0) return
    at = at + 1
    if (at > len(text)) return
    if (scan(text(at:at), '+-') > 0) at = at + 1
    if (at > len(text)) return
    if (scan(text(at:at), digits) > 0) last = end_of(text, at, digits)
  end function end_of_number

end module viscovib_law_parameters
