!> Keys of systems whose matrices depend on the speed of a rotor.
module viscovib_speed_groups
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_matrix_groups, only: read_matrix
  use viscovib_namelist, only: group_type, lower, namelist_type
  use viscovib_oscillator, only: speed_needed
  use viscovib_scene_groups, only: find_result, place_of
  use viscovib_speed_matrices, only: speed_matrices
  use viscovib_status, only: status_type
  implicit none
  private

  public :: find_speed, is_run_up, read_speed_matrices, turns_shaft

contains

  !> The keys gyroscopic, circulatory, centrifugal and speed.
  subroutine read_speed_matrices(reader, n, found)
    type(group_reader), intent(inout) :: reader
    !> Number of coordinates.
    integer, intent(in) :: n
    class(speed_matrices), intent(inout) :: found
    type(speed_matrices) :: given
    type(status_type) :: status
    real(wp) :: speed
    logical :: are_given

    if (reader%may_have('speed')) speed = reader%read_real('speed')
    are_given = any([reader%may_have('gyroscopic'), reader%may_have('circulatory'), &
                     reader%may_have('centrifugal')])
    if (.not. are_given) then
      if (reader%has('speed')) then
        call reader%complain('speed', 'speed: has no effect without gyroscopic, circulatory or ' &
                             //'centrifugal')
      end if
      return
    end if
    call read_matrix(reader, 'gyroscopic', .false., n, given%gyroscopic)
    call read_matrix(reader, 'circulatory', .false., n, given%circulatory)
    call read_matrix(reader, 'centrifugal', .false., n, given%centrifugal)
    if (reader%status%failed()) return
    call found%take_matrices(given, status)
    call reader%place(status)
  end subroutine read_speed_matrices

  !> The constant speed of matrices that depend on it: that of the system, or the only frequency of
  !! the load. Over several frequencies, and while the speed changes in time, there is none.
  subroutine find_speed(file, reader, key, speed, is_constant)
    type(namelist_type), intent(in) :: file
    !> At the group of the system.
    type(group_reader), intent(inout) :: reader
    !> Key of the gyroscopic forces; blank: none.
    character(len=*), intent(in) :: key
    real(wp), intent(out) :: speed
    logical, intent(out) :: is_constant
    type(group_reader) :: result

    speed = 0.0_wp
    is_constant = .false.
    associate (group => file%groups(find_result(file)))
      if (key /= '') then
        if (group%name == 'modes') then
          call reader%complain(trim(key), trim(key)//': undamped modes omit it; use campbell or ' &
                               //'characteristic_roots')
        else if (group%name == 'backbone') then
          call reader%complain(trim(key), trim(key)//': must be 0 for a backbone, which omits ' &
                               //'damping and gyroscopic terms')
        end if
        if (reader%status%failed()) return
      end if
      if (group%name == 'campbell') then
        if (reader%has('speed')) then
          call reader%complain('speed', 'speed: must not be given for campbell, which varies it')
        end if
        return
      end if
      is_constant = reader%has('speed')
      if (is_constant) then
        speed = reader%read_real('speed')
        return
      end if
      if (turns_shaft(file)) return
      call result%start(file%path, group)
      if (group%name == 'response' .or. (group%name == 'branch' .and. result%has('nu_from'))) return
      is_constant = result%has('nu')
      if (is_constant) then
        speed = result%read_real('nu')
      else
        call reader%complain('speed', speed_needed)
      end if
    end associate
  end subroutine find_speed

  !> True if the speed changes in a motion in time: by a motor or a run-up.
  logical function turns_shaft(file)
    type(namelist_type), intent(in) :: file
    integer :: i
    turns_shaft = place_of(file, 'drive_torque') <= size(file%groups)
    if (place_of(file, 'transient') > size(file%groups)) return
    turns_shaft = turns_shaft .or. any([(is_run_up(file%groups(i)), i=1, size(file%groups))])
  end function turns_shaft

  !> True for a &load that is a run-up.
  logical function is_run_up(group)
    type(group_type), intent(in) :: group
    integer :: place
    is_run_up = .false.
    if (group%name /= 'load') return
    place = group%find('shape')
    if (place > 0) is_run_up = lower(group%entries(place)%values(1)%text) == 'run_up'
  end function is_run_up

end module viscovib_speed_groups
