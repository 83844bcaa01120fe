!> A scene: the system, its load and the results wanted, as one namelist file. Its &sweep groups
!! name parameters that take a list of values each.
module viscovib_scene
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_job, only: job_type
  use viscovib_kinds, only: wp
  use viscovib_law_parameters, only: read_parameters
  use viscovib_locks, only: lock_texts, unlock_texts
  use viscovib_namelist, only: group_type, lower, namelist_type, read_namelist
  use viscovib_scene_groups, only: check_groups, find_result
  use viscovib_scene_results, only: read_result
  use viscovib_scene_subject, only: read_subject
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_subject, only: subject_type
  implicit none
  private

  public :: scene_type, read_scene

  type :: scene_type
    character(len=:), allocatable :: path, title
    type(subject_type) :: subject
    class(job_type), allocatable :: job
    !> Line of the first &sweep, 0 without: one point is computed, or a grid of them.
    integer :: sweep_line = 0
    !> The group of the result. Its lines are part of error messages of the computation.
    type(group_type) :: asked
    !> Whether it was read from a text that stands for the file, whose lines are others.
    logical :: of_text = .false.
    !> The scene as it was understood, every default written out; reads back
    !! to the same numbers.
    character(len=:), allocatable :: canonical
  end type scene_type

  character(len=*), parameter :: grid_keys(4) = &
    [character(len=7) :: 'min', 'max', 'count', 'spacing']

contains

  !> Read and check everything; nothing is computed yet.
  subroutine read_scene(path, scene, status, text, allow_paths)
    character(len=*), intent(in) :: path
    type(scene_type), intent(out), target :: scene
    type(status_type), intent(out) :: status
    !> The scene itself, instead of the file; its path then only names it.
    character(len=*), intent(in), optional :: text
    !> Whether files that it names may be anywhere; else in its folder or below.
    logical, intent(in), optional :: allow_paths
    type(namelist_type) :: file
    type(growing_text) :: canonical
    character(len=:), allocatable :: unused

    call lock_texts()
    scene%path = path
    scene%of_text = present(text)
    call read_namelist(path, file, status, text)
    if (present(allow_paths)) file%groups%anywhere = allow_paths
    if (.not. status%failed()) call check_groups(file, status)
    if (.not. status%failed()) call read_title(file, scene, canonical, status)
    if (.not. status%failed()) call read_parameters(file, unused, canonical, status)
    if (.not. status%failed()) call read_subject(file, scene%subject, canonical, status)
    if (.not. status%failed()) then
      scene%asked = file%groups(find_result(file))
      call read_result(file, scene%subject, scene%job, canonical, status)
    end if
    if (.not. status%failed()) call read_sweeps(file, scene, canonical, status)
    if (.not. status%failed() .and. allocated(unused)) then
      if (unused /= '') call fail(status, status_input_error, 'parameters', unused)
    end if
    scene%canonical = canonical%text()
    call unlock_texts()
  end subroutine read_scene

  subroutine read_title(file, scene, canonical, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(growing_text), intent(inout) :: canonical
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    integer :: i

    scene%title = ''
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'scene') cycle
      call reader%start(file%path, file%groups(i))
      scene%title = reader%read_text('title')
      call reader%close(canonical, status)
    end do
  end subroutine read_title

  !> Every &sweep is a parameter; no two may be the same.
  subroutine read_sweeps(file, scene, canonical, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(growing_text), intent(inout) :: canonical
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=:), allocatable :: key, keys
    integer :: i, n
    ! A grid of more is beyond what is computed, and its size beyond what is counted.
    integer, parameter :: max_sweeps = 16

    keys = ';'
    n = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'sweep') cycle
      call reader%start(file%path, file%groups(i))
      call read_sweep(reader, canonical%text(), key)
      n = n + 1
      if (n > max_sweeps) then
        call reader%complain('sweep', '&sweep: must be at most '//show(max_sweeps)//' of them')
      end if
      if (index(keys, ';'//key//';') > 0) then
        call reader%complain('key', "key = '"//key//"': is swept already")
      end if
      keys = keys//key//';'
      if (scene%sweep_line == 0) scene%sweep_line = file%groups(i)%line
      call reader%close(canonical, status)
      if (status%failed()) return
    end do
  end subroutine read_sweeps

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

end module viscovib_scene
