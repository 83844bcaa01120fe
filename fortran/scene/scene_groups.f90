!> Which groups make up a scene: the known ones, the right number of each, one system and one
!! result.
module viscovib_scene_groups
  use viscovib_namelist, only: namelist_type
  use viscovib_near_words, only: closest
  use viscovib_status, only: clipped, fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: check_groups, place_of, place_of_motion, find_result

  !> What a scene may ask for, each by the name of its group, and what it goes with.
  type :: result_name
    character(len=20) :: name
    logical :: of_pendulum, needs_load
  end type result_name

  type(result_name), parameter :: results(*) = [ &
                                                result_name('response', .false., .true.), &
                                                result_name('branch', .true., .true.), &
                                                result_name('backbone', .true., .false.), &
                                                result_name('multiple_scales', .true., .true.), &
                                                result_name('modes', .true., .false.), &
                                                result_name('equilibrium', .false., .true.), &
                                                result_name('characteristic_roots', .false., &
                                                            .false.), &
                                                result_name('steady_motion', .false., .true.), &
                                                result_name('trace_motion', .false., .true.), &
                                                result_name('transient', .true., .false.), &
                                                result_name('ensemble', .true., .false.), &
                                                result_name('basins', .true., .false.)]

  !> Other groups: those of a mount or a system of one's own, and those of any scene.
  character(len=*), parameter :: oscillator_groups(11) = &
    [character(len=20) :: 'mount', 'system', 'spring', 'force', 'structure', 'element', 'layer', &
     'body', 'mount_point', 'kernel', 'load'], &
                                 other_groups(7) = &
    [character(len=20) :: 'scene', 'pendulum', 'spectrum', 'free_decay', 'event', 'parameters', &
     'sweep'], &
                                 repeatable(9) = &
    [character(len=20) :: 'kernel', 'load', 'spring', 'force', 'element', 'layer', 'mount_point', &
     'event', 'sweep'], &
                                 of_structures(11) = &
    [character(len=20) :: 'response', 'branch', 'backbone', 'modes', 'transient', 'basins', &
     'ensemble', 'equilibrium', 'characteristic_roots', 'steady_motion', &
     'trace_motion']

contains

  subroutine check_groups(file, is_pendulum, status)
    type(namelist_type), intent(in) :: file
    logical, intent(out) :: is_pendulum
    type(status_type), intent(out) :: status
    logical :: is_polynomial, is_structure
    integer :: i

    is_pendulum = has(file, 'pendulum')
    is_polynomial = has(file, 'system')
    is_structure = has(file, 'structure')
    call set_ok(status)
    do i = 1, size(file%groups)
      call check_group(file, i, is_pendulum, is_polynomial, is_structure, status)
      if (status%failed()) return
    end do
    if (.not. (is_pendulum .or. is_polynomial .or. has(file, 'mount') &
               .or. has(file, 'structure') .or. has(file, 'body'))) then
      if (has(file, 'transient')) then
        call refuse(file, 'transient', '&transient: needs &mount, &system, &structure, &body or ' &
                    //'&pendulum', status)
      else
        call refuse_lack(file, 'mount', status)
      end if
    end if
    if (.not. status%failed()) call check_results(file, is_pendulum, status)
  end subroutine check_groups

  !> Whether a group is known, given once, and goes with the system.
  subroutine check_group(file, i, is_pendulum, is_polynomial, is_structure, status)
    type(namelist_type), intent(in) :: file
    integer, intent(in) :: i
    logical, intent(in) :: is_pendulum, is_polynomial, is_structure
    type(status_type), intent(inout) :: status
    character(len=:), allocatable :: name

    name = file%groups(i)%name
    if (.not. (any(oscillator_groups == name) .or. any(other_groups == name) &
               .or. any(results%name == name))) then
      call refuse_at(file, i, 'unknown group &'//clipped(name)//likely_group(name), status)
      return
    end if
    if (.not. any(repeatable == name) .and. place_of(file, name) < i) then
      call refuse_at(file, i, 'a second &'//name//': must be given once', status)
      return
    end if
    if (is_pendulum .and. (any(oscillator_groups == name) &
                           .or. any(results%name == name .and. .not. results%of_pendulum))) then
      call refuse_at(file, i, '&'//name//': belongs to a mount, and this scene has &pendulum', &
                     status)
    else if (name == 'mount' .and. is_polynomial) then
      call refuse_at(file, i, '&mount: this scene has &system already, give one of them', status)
    else if (name == 'structure' .and. (is_polynomial .or. has(file, 'mount'))) then
      call refuse_at(file, i, '&structure: this scene has &mount or &system already, give one of ' &
                     //'them', status)
    else if (name == 'body' .and. (is_polynomial .or. is_structure .or. has(file, 'mount'))) then
      call refuse_at(file, i, '&body: this scene has &mount, &system or &structure already, give ' &
                     //'one of them', status)
    else if (is_structure .and. any(results%name == name) &
             .and. .not. any(of_structures == name)) then
      call refuse_at(file, i, '&'//name//': of a &structure it is computed by Python ' &
                     //'(Scene.structure), here are '//listed(of_structures), status)
    else if (any(['element', 'layer  '] == name) .and. .not. is_structure) then
      call refuse_at(file, i, '&'//name//': needs &structure', status)
    else if (name == 'mount_point' .and. .not. has(file, 'body')) then
      call refuse_at(file, i, '&mount_point: needs &body', status)
    else if (any(['spring', 'force '] == name) .and. .not. is_polynomial) then
      call refuse_at(file, i, '&'//name//': needs &system', status)
    else if (name == 'parameters' .and. .not. (is_polynomial .or. is_structure &
                                               .or. has(file, 'body') .or. has(file, 'event'))) then
      call refuse_at(file, i, '&parameters: needs &system, &structure or &body, which have laws, ' &
                     //'or &event', status)
    else if (any(['spectrum  ', 'free_decay', 'event     '] == name) &
             .and. .not. has(file, 'transient')) then
      call refuse_at(file, i, '&'//name//': needs &transient', status)
    end if
  end subroutine check_group

  !> One result, and a load where it needs one.
  subroutine check_results(file, is_pendulum, status)
    type(namelist_type), intent(in) :: file
    logical, intent(in) :: is_pendulum
    type(status_type), intent(inout) :: status
    integer :: i, first, other

    first = 0
    other = 0
    do i = 1, size(results)
      if (.not. has(file, results(i)%name)) cycle
      if (first > 0) other = i
      if (first == 0) first = i
    end do
    if (first == 0) then
      if (is_pendulum) then
        call fail(status, status_input_error, 'transient', file%path//': no &transient group: ' &
                  //'a scene with &pendulum needs a wanted result ('//wanted(is_pendulum)//')')
      else
        call refuse_lack(file, 'response', status)
      end if
      return
    end if
    if (other > 0) then
      ! A motion in time is not the one that is too much.
      if (results(other)%name == 'transient') then
        i = first
        first = other
        other = i
      end if
      call refuse(file, trim(results(other)%name), '&'//trim(results(other)%name) &
                  //': this scene has &'//trim(results(first)%name) &
                  //' already, give one of them', status)
    else if (.not. is_pendulum .and. results(first)%needs_load .and. .not. has(file, 'load')) then
      call refuse_lack(file, 'load', status)
    end if
  end subroutine check_results

  !> The place of the group that wants motions in time, one more than there are: none does.
  pure integer function place_of_motion(file) result(place)
    type(namelist_type), intent(in) :: file
    place = min(place_of(file, 'transient'), place_of(file, 'basins'))
  end function place_of_motion

  !> The place of the group of the result, of which there is one.
  pure integer function find_result(file)
    type(namelist_type), intent(in) :: file
    do find_result = 1, size(file%groups)
      if (any(results%name == file%groups(find_result)%name)) exit
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
              //wanted(.false.)//') and, for all but a pendulum, &load with most of them')
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
    character(len=20), allocatable :: known(:)
    integer :: near
    known = [oscillator_groups, other_groups, results%name]
    near = closest(name, known)
    if (near > 0) then
      text = '; did you mean &'//trim(known(near))//'?'
    else
      text = ': must be one of '//listed(known)
    end if
  end function likely_group

  !> The results that may be wanted.
  pure function wanted(of_pendulum)
    logical, intent(in) :: of_pendulum
    character(len=:), allocatable :: wanted
    wanted = listed(pack(results%name, results%of_pendulum .or. .not. of_pendulum))
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
