!> Which groups make up a scene: the known ones, the right number of each, and one system.
module viscovib_scene_groups
  use viscovib_namelist, only: namelist_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: check_groups, place_of

  !> What a scene may ask for, each by the name of its group.
  character(len=*), parameter, public :: result_names(5) = &
    [character(len=15) :: 'response', 'branch', 'backbone', 'multiple_scales', 'transient']
  character(len=*), parameter :: group_names(15) = &
    [character(len=15) :: 'scene', 'mount', 'system', 'spring', 'force', 'kernel', 'load', &
     'pendulum', result_names, 'spectrum', 'sweep']
  !> What belongs to each system.
  character(len=*), parameter :: mount_groups(8) = &
    [character(len=15) :: 'mount', 'system', 'spring', 'force', 'kernel', 'load', 'response', &
     'branch'], &
                                 pendulum_groups(3) = &
    [character(len=15) :: 'pendulum', 'transient', 'spectrum'], &
                                 repeatable(5) = &
    [character(len=15) :: 'kernel', 'load', 'spring', 'force', 'sweep']

contains

  !> Known groups only, the right number of each, and one system.
  subroutine check_groups(file, is_pendulum, status)
    type(namelist_type), intent(in) :: file
    logical, intent(out) :: is_pendulum
    type(status_type), intent(out) :: status
    character(len=*), parameter :: results(*) = result_names(:size(result_names) - 1)
    logical :: is_polynomial, is_moving, wanted(size(results))
    integer :: i, j, n

    is_pendulum = .false.
    is_polynomial = place_of(file, 'system') <= size(file%groups)
    is_moving = place_of(file, 'transient') <= size(file%groups) &
                .and. (is_polynomial .or. place_of(file, 'mount') <= size(file%groups))
    wanted = [(place_of(file, trim(results(i))) <= size(file%groups), i=1, size(results))]
    do i = 1, size(file%groups)
      associate (group => file%groups(i))
        if (.not. any(group_names == group%name)) then
          call refuse_group(i, 'unknown group &'//group%name//': must be one of ' &
                            //listed(group_names))
          return
        end if
        if (group%name == 'pendulum') is_pendulum = .true.
      end associate
    end do
    do j = 1, size(group_names)
      n = 0
      do i = 1, size(file%groups)
        if (file%groups(i)%name /= group_names(j)) cycle
        n = n + 1
        if (n == 2 .and. .not. any(group_names(j) == repeatable)) then
          call refuse_group(i, 'a second &'//trim(group_names(j))//': must be given once')
        else if (is_pendulum .and. any(mount_groups == group_names(j)) &
                 .and. group_names(j) /= 'branch') then
          call refuse_group(i, '&'//trim(group_names(j))//': belongs to a mount, and this scene ' &
                            //'has &pendulum')
        else if (is_polynomial .and. group_names(j) == 'mount') then
          call refuse_group(i, '&mount: this scene has &system already, give one of them')
        else if (.not. is_polynomial .and. any(group_names(j) == ['spring', 'force '])) then
          call refuse_group(i, '&'//trim(group_names(j))//': needs &system')
        else if (group_names(j) == 'transient' .and. .not. (is_pendulum .or. is_moving)) then
          call refuse_group(i, '&transient: needs &mount, &system or &pendulum')
        else if (.not. is_pendulum .and. any(pendulum_groups == group_names(j)) &
                 .and. .not. is_moving) then
          call refuse_group(i, '&'//trim(group_names(j))//': needs &pendulum')
        else if (is_moving .and. any(group_names(j) == results)) then
          call refuse_group(i, '&'//trim(group_names(j))//': this scene has &transient already, ' &
                            //'give one of them')
        end if
        if (status%failed()) return
      end do
      if (n > 0) cycle
      if (is_pendulum .and. group_names(j) == 'transient') then
        if (any(wanted(2:))) cycle
        call fail(status, status_input_error, 'transient', file%path//': no &transient group: ' &
                  //'a scene with &pendulum needs a wanted result (&transient, &branch, ' &
                  //'&backbone or &multiple_scales)')
      else if (.not. is_pendulum .and. any(group_names(j) == ['mount', 'load ']) &
               .and. .not. (is_polynomial .and. group_names(j) == 'mount') &
               .and. .not. is_moving &
               .and. .not. (group_names(j) == 'load' .and. wanted(3))) then
        call refuse_lack(trim(group_names(j)))
      end if
      if (status%failed()) return
    end do
    if (is_pendulum .and. any(wanted)) then
      n = place_of(file, trim(results(findloc(wanted, .true., 1, back=.true.))))
      if (place_of(file, 'transient') <= size(file%groups)) then
        call refuse_group(n, '&'//file%groups(n)%name//': this scene has &transient already, ' &
                          //'give one of them')
      else if (place_of(file, 'spectrum') <= size(file%groups)) then
        call refuse_group(place_of(file, 'spectrum'), '&spectrum: needs &transient')
      end if
      if (status%failed()) return
    end if
    if (is_moving) return
    if (count(wanted) == 0 .and. .not. is_pendulum) call refuse_lack('response')
    if (count(wanted) < 2) return
    j = findloc(wanted, .true., 1)
    i = findloc(wanted, .true., 1, back=.true.)
    call refuse_group(place_of(file, trim(results(i))), '&'//trim(results(i)) &
                      //': this scene has &'//trim(results(j))//' already, give one of them')

  contains

    subroutine refuse_lack(name)
      character(len=*), intent(in) :: name
      call fail(status, status_input_error, name, file%path//': no &'//name//' group: a scene ' &
                //'needs &mount or &system, &load and a wanted result (&response, &branch or ' &
                //'&multiple_scales), or &mount, &system or &pendulum and &transient or ' &
                //'&backbone')
    end subroutine refuse_lack

    subroutine refuse_group(i, why)
      integer, intent(in) :: i
      character(len=*), intent(in) :: why
      call fail(status, status_input_error, file%groups(i)%name, file%path//':' &
                //show(file%groups(i)%line)//': '//why)
    end subroutine refuse_group

    pure function listed(names)
      character(len=*), intent(in) :: names(:)
      character(len=:), allocatable :: listed
      integer :: k
      listed = '&'//trim(names(1))
      do k = 2, size(names)
        listed = listed//', &'//trim(names(k))
      end do
    end function listed

  end subroutine check_groups

  !> The place of a group; past the last if it is not there.
  pure integer function place_of(file, name) result(i)
    type(namelist_type), intent(in) :: file
    character(len=*), intent(in) :: name
    do i = 1, size(file%groups)
      if (file%groups(i)%name == name) exit
    end do
  end function place_of

end module viscovib_scene_groups
