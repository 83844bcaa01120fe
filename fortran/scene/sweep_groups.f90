!> The &sweep groups of a scene: parameters that take a list of values each.
module viscovib_sweep_groups
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_namelist, only: lower
  use viscovib_status, only: show
  implicit none
  private

  public :: read_sweep

  character(len=*), parameter :: grid_keys(4) = &
    [character(len=7) :: 'min', 'max', 'count', 'spacing']

contains

  !> Read one group and check that it names a number of the scene.
  subroutine read_sweep(reader, canonical, key)
    type(group_reader), intent(inout) :: reader
    !> The groups before, every key written out.
    character(len=*), intent(in) :: canonical
    !> What is swept: `group.name`, `group(i).name`, `group.name(j)`.
    character(len=:), allocatable, intent(out) :: key
    character(len=:), allocatable :: why
    real(wp), allocatable :: values(:)

    allocate (values(0))
    key = lower(reader%read_text('key'))
    if (.not. reader%status%failed()) then
      why = lack(key, canonical)
      if (why /= '') call reader%complain('key', "key = '"//key//"': "//why)
    end if
    if (reader%may_have('values')) then
      call reader%refuse(grid_keys, 'values lists them already; give either values, or min, max, ' &
                         //'count and spacing')
      values = reader%read_reals('values')
    else
      call read_range(reader)
    end if
  end subroutine read_sweep

  !> min, max, count and spacing.
  subroutine read_range(reader)
    type(group_reader), intent(inout) :: reader
    character(len=:), allocatable :: spacing
    real(wp) :: lowest, highest
    integer :: n

    lowest = reader%read_real('min')
    highest = reader%read_real('max')
    n = reader%read_integer('count')
    spacing = reader%read_text('spacing')
    if (reader%status%failed()) return
    if (spacing == 'log' .and. lowest <= 0) then
      call reader%complain('min', 'min = '//show(lowest) &
                           //": must be greater than 0 with spacing = 'log'")
    else if (highest <= lowest) then
      call reader%complain('max', 'max = '//show(highest)//': must be greater than min = ' &
                           //show(lowest))
    end if
  end subroutine read_range

  !> Why the scene has no such number; empty if it has.
  function lack(key, canonical) result(why)
    character(len=*), intent(in) :: key, canonical
    character(len=:), allocatable :: why
    character(len=:), allocatable :: group, name, keys
    integer :: dot, which, element, first, last, n

    why = ''
    dot = index(key, '.')
    call split(key(:max(dot - 1, 0)), group, which)
    call split(key(dot + 1:), name, element)
    if (dot == 0 .or. group == '' .or. name == '' .or. which < 0 .or. element < 0) then
      why = "must be a key in its group, as 'mount.stiffness_x' or 'load(2).amplitude'"
      return
    end if
    n = 0
    first = 1
    keys = ''
    do
      last = index(canonical(first:), '&'//group//new_line('a'))
      if (last == 0) exit
      first = first + last
      n = n + 1
      if (n /= max(which, 1)) cycle
      keys = canonical(first:first + index(canonical(first:), new_line('a')//'/'))
    end do
    if (n == 0 .or. group == 'sweep') then
      why = 'this scene has no &'//group
    else if (which > n) then
      why = 'this scene has &'//group//' '//show(n)//' times'
    else if (which == 0 .and. n > 1) then
      why = 'this scene has &'//group//' '//show(n)//" times, select one, as '"//group//'(1).' &
            //name//"'"
    else if (index(keys, new_line('a')//'  '//name//' =') == 0) then
      why = '&'//group//' has no '//name//' here'
    end if
  end function lack

  !> A name and the number in parentheses after it: 0 without, -1 if it is none.
  subroutine split(text, name, number)
    character(len=*), intent(in) :: text
    character(len=:), allocatable, intent(out) :: name
    integer, intent(out) :: number
    integer :: opening, io

    number = 0
    opening = index(text, '(')
    if (opening == 0) then
      name = text
      return
    end if
    name = text(:opening - 1)
    number = -1
    if (len(text) < opening + 2) return
    if (text(len(text):) /= ')' .or. len(text) - opening > 8) return
    if (verify(text(opening + 1:len(text) - 1), '0123456789') /= 0) return
    read (text(opening + 1:len(text) - 1), '(i8)', iostat=io) number
    if (io /= 0 .or. number < 1) number = -1
  end subroutine split

end module viscovib_sweep_groups
