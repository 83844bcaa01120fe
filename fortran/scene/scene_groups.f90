!> Which groups make up a scene: those of `scenes.toml`, the right number of each, one system and
!! one result.
module viscovib_scene_groups
  use viscovib_namelist, only: namelist_type
  use viscovib_near_words, only: closest, longest
  use viscovib_scene_table, only: find_group, group_names, group_table, role_part, role_result, &
    role_system, system_groups
  use viscovib_status, only: clipped, fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: check_groups, place_of, place_of_motion, find_result

contains

  subroutine check_groups(file, status)
    type(namelist_type), intent(inout) :: file
    type(status_type), intent(out) :: status
    integer :: first(size(group_table))
    integer :: i

    file%groups%systems = 0
    do i = 1, size(system_groups)
      if (has(file, system_groups(i))) file%groups%systems = ibset(0, i - 1)
    end do
    call set_ok(status)
    first = [(place_of(file, trim(group_names(i))), i=1, size(group_names))]
    do i = 1, size(file%groups)
      call check_group(file, first, i, status)
      if (status%failed()) return
    end do
    if (.not. any([(has(file, system_groups(i)), i=1, size(system_groups))])) then
      if (has(file, 'transient')) then
        call refuse(file, 'transient', '&transient: needs &mount, &system, &structure, &body or ' &
                    //'&pendulum', status)
      else
        call refuse_lack(file, 'mount', status)
      end if
    end if
    if (.not. status%failed()) call check_results(file, status)
  end subroutine check_groups

  !> Whether a group is known, given once, and goes with the system.
  subroutine check_group(file, first, i, status)
    type(namelist_type), intent(in) :: file
    !> Place of the first group of each name of the table, so that no group is searched for again.
    integer, intent(in) :: first(:)
    integer, intent(in) :: i
    type(status_type), intent(inout) :: status
    character(len=:), allocatable :: name
    integer :: k, row

    name = file%groups(i)%name
    row = find_group(name)
    if (row == 0) then
      call refuse_at(file, i, 'unknown group &'//clipped(name)//likely_group(name), status)
      return
    end if
    associate (group => group_table(row), is_valid => iand(group_table(row)%systems, &
                                                           file%groups(i)%systems) /= 0)
      if (.not. group%repeats .and. first(row) < i) then
        call refuse_at(file, i, 'a second &'//name//': must be given once', status)
      else if (given('pendulum') .and. .not. btest(group%systems, size(system_groups) - 1)) then
        call refuse_at(file, i, '&'//name//': belongs to a mount, and this scene has &pendulum', &
                       status)
      else if (group%role == role_system) then
        do k = 1, size(system_groups)
          if (first(find_group(trim(system_groups(k)))) >= i) cycle
          call refuse_at(file, i, '&'//name//': this scene has &'//trim(system_groups(k)) &
                         //' already, give one of them', status)
        end do
      else if (group%role == role_result .and. given('structure') .and. .not. is_valid) then
        call refuse_at(file, i, '&'//name//': of a &structure it is computed by Python ' &
                       //'(Scene.structure), here are ' &
                       //listed(wanted(file%groups(i)%systems)), status)
      else if (group%role == role_part .and. .not. is_valid .and. popcnt(group%systems) == 1) then
        call refuse_at(file, i, '&'//name//': needs &'//trim(system_groups(1 + trailz( &
                                                             group%systems))), status)
      else if (name == 'parameters' .and. .not. any([given('system'), given('structure'), &
                                                     given('body'), given('event')])) then
        call refuse_at(file, i, '&parameters: needs &system, &structure or &body, which have ' &
                       //'laws, or &event', status)
      else if (group%role == role_part .and. group%needs /= '' .and. &
               .not. given(trim(group%needs))) then
        call refuse_at(file, i, '&'//name//': needs &'//trim(group%needs), status)
      end if
    end associate

  contains

    !> False for the empty name of a group that needs no other.
    pure logical function given(group)
      character(len=*), intent(in) :: group
      integer :: place
      place = find_group(group)
      given = place > 0
      if (given) given = first(place) <= size(file%groups)
    end function given

  end subroutine check_group

  !> One result, and a load where it needs one.
  subroutine check_results(file, status)
    type(namelist_type), intent(in) :: file
    type(status_type), intent(inout) :: status
    integer :: i, first, other

    first = 0
    other = 0
    do i = 1, size(group_table)
      if (group_table(i)%role /= role_result .or. .not. has(file, group_table(i)%name)) cycle
      if (first > 0) other = i
      if (first == 0) first = i
    end do
    if (first == 0) then
      if (has(file, 'pendulum')) then
        call fail(status, status_input_error, 'transient', file%path//': no &transient group: ' &
                  //'a scene with &pendulum needs a wanted result (' &
                  //listed(wanted(ibset(0, size(system_groups) - 1)))//')')
      else
        call refuse_lack(file, 'response', status)
      end if
      return
    end if
    if (other > 0) then
      ! A motion in time is not the one that is too much.
      if (group_table(other)%name == 'transient') then
        i = first
        first = other
        other = i
      end if
      call refuse(file, trim(group_table(other)%name), '&'//trim(group_table(other)%name) &
                  //': this scene has &'//trim(group_table(first)%name) &
                  //' already, give one of them', status)
    else if (group_table(first)%needs == 'load' .and. .not. (has(file, 'pendulum') &
                                                             .or. has(file, 'load'))) then
      call refuse_lack(file, 'load', status)
    end if
  end subroutine check_results

  !> The place of the group that wants motions in time, one more than there are: none does.
  pure integer function place_of_motion(file) result(place)
    type(namelist_type), intent(in) :: file
    place = min(place_of(file, 'transient'), place_of(file, 'basins'), place_of(file, 'ensemble'))
  end function place_of_motion

  !> The place of the group of the result, of which there is one.
  pure integer function find_result(file)
    type(namelist_type), intent(in) :: file
    character(len=longest), allocatable :: results(:)
    allocate (results, source=wanted(-1))
    do find_result = 1, size(file%groups)
      if (any(results == file%groups(find_result)%name)) exit
    end do
  end function find_result

  pure logical function has(file, name)
    type(namelist_type), intent(in) :: file
    character(len=*), intent(in) :: name
    has = place_of(file, trim(name)) <= size(file%groups)
  end function has

  !> The place of a group; past the last if it is not there.
  pure integer function place_of(file, name) result(i)
    type(namelist_type), intent(in) :: file
    character(len=*), intent(in) :: name
    do i = 1, size(file%groups)
      if (file%groups(i)%name == name) exit
    end do
  end function place_of

  subroutine refuse_lack(file, name, status)
    type(namelist_type), intent(in) :: file
    character(len=*), intent(in) :: name
    type(status_type), intent(inout) :: status
    call fail(status, status_input_error, name, file%path//': no &'//name//' group: a scene ' &
              //'needs &mount, &system, &structure, &body or &pendulum, a wanted result (' &
              //listed(wanted(-1))//') and, for all but a pendulum, &load with most of them')
  end subroutine refuse_lack

  subroutine refuse(file, name, why, status)
    type(namelist_type), intent(in) :: file
    character(len=*), intent(in) :: name, why
    type(status_type), intent(inout) :: status
    call refuse_at(file, place_of(file, name), why, status)
  end subroutine refuse

  subroutine refuse_at(file, i, why, status)
    type(namelist_type), intent(in) :: file
    integer, intent(in) :: i
    character(len=*), intent(in) :: why
    type(status_type), intent(inout) :: status
    call fail(status, status_input_error, file%groups(i)%name, file%path//':' &
              //show(file%groups(i)%line)//': '//why)
  end subroutine refuse_at

  !> Which group an unknown one may have been meant to be.
  function likely_group(name) result(text)
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: text
    integer :: near
    near = closest(name, group_names)
    if (near > 0) then
      text = '; did you mean &'//trim(group_names(near))//'?'
    else
      text = ': must be one of '//listed(group_names)
    end if
  end function likely_group

  !> The results that may be wanted of any of these systems.
  pure function wanted(systems)
    integer, intent(in) :: systems
    character(len=longest), allocatable :: wanted(:)
    wanted = pack(group_names, group_table%role == role_result &
                  .and. iand(group_table%systems, systems) /= 0)
  end function wanted

  pure function listed(names)
    character(len=*), intent(in) :: names(:)
    character(len=:), allocatable :: listed
    integer :: k
    listed = '&'//trim(names(1))
    do k = 2, size(names)
      listed = listed//', &'//trim(names(k))
    end do
  end function listed

end module viscovib_scene_groups
