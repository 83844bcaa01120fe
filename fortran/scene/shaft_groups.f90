!> The group &drive_torque of a scene, and run-ups of systems whose matrices depend on the speed.
module viscovib_shaft_groups
  use viscovib_fitted_memory, only: bound_hidden, copy_system
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kinds, only: wp
  use viscovib_law_faults, only: complain_of_law
  use viscovib_law_program, only: law_program
  use viscovib_law_text, only: compile_law
  use viscovib_load, only: load_type
  use viscovib_namelist, only: lower, namelist_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_scene_groups, only: place_of
  use viscovib_shaft_system, only: drive_type, put_on_shaft, torque_arguments
  use viscovib_shock_shapes, only: find_turn, shock_type
  use viscovib_speed_groups, only: is_run_up, turns_shaft
  use viscovib_status, only: set_ok, status_type
  use viscovib_subject, only: name_length, subject_type
  implicit none
  private

  public :: read_shaft

  !> Name of the coordinate of the shaft.
  character(len=*), parameter :: angle = 'angle'

contains

  !> Extend the system and its load by the angle of the shaft, if the speed changes.
  subroutine read_shaft(file, subject, load, echo, status)
    type(namelist_type), intent(in) :: file
    type(subject_type), intent(inout) :: subject
    type(load_type), intent(inout) :: load
    !> Gets the canonical text of the group.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    type(drive_type) :: drive
    type(shock_type) :: shock
    type(polynomial_type) :: whole
    type(status_type) :: built
    integer :: i, n
    logical :: has_motor

    call set_ok(status)
    if (.not. turns_shaft(file)) return
    n = size(subject%coordinates)
    has_motor = place_of(file, 'drive_torque') <= size(file%groups)
    if (.not. has_motor) then
      if (.not. subject%is_polynomial) return
      if (.not. subject%polynomial%depends_on_speed()) return
      drive%unbalance = [((0.0_wp, 0.0_wp), i=1, n)]
      call read_run_ups(file, reader, shock)
    else
      call reader%start(file%path, file%groups(place_of(file, 'drive_torque')))
      call read_drive(reader, n, drive, subject%shaft_start)
      if (.not. subject%is_polynomial .or. subject%is_turning) then
        call reader%complain('drive_torque', '&drive_torque: needs a &system, a &structure, or a ' &
                             //"&body with geometry = 'small'")
      else if (load%has_table() .or. load%moves_base()) then
        call reader%complain('drive_torque', '&drive_torque: must not be given together with ' &
                             //'shocks, records or motions of the base')
      end if
      call reader%close(echo, status)
      if (status%failed()) return
    end if
    if (any(subject%coordinates == angle)) then
      call reader%complain('drive_torque', "coordinates: must not contain '"//angle//"', the " &
                           //'name of the angle of the shaft')
    else if (bound_hidden(subject%polynomial) < 0) then
      call reader%complain('kernel', 'kernel: must be, or be fitted by, a sum of exponentials ' &
                           //'while the speed changes')
    end if
    if (.not. reader%status%failed()) then
      call put_on_shaft(subject%polynomial, drive, whole, built)
      call reader%place(built)
    end if
    status = reader%status
    if (status%failed()) return
    call copy_system(whole, subject%polynomial)
    call widen(load, n)
    if (.not. has_motor) call turn(shock, n, load, subject%shaft_start)
    subject%coordinates = [character(len=name_length) :: subject%coordinates, angle]
    subject%units = [character(len=name_length) :: subject%units, 'rad']
  end subroutine read_shaft

  !> The group &drive_torque.
  subroutine read_drive(reader, n, drive, start)
    type(group_reader), intent(inout) :: reader
    integer, intent(in) :: n
    type(drive_type), intent(inout) :: drive
    !> Angle and speed at t = 0.
    real(wp), allocatable, intent(out) :: start(:)
    type(law_program) :: program
    character(len=1) :: no_names(0)
    real(wp) :: no_values(0)
    character(len=:), allocatable :: fault
    real(wp), allocatable :: size_of(:), turned(:)
    integer :: degree, parity

    drive%torque = lower(reader%read_text('torque'))
    drive%inertia = reader%read_real('inertia')
    size_of = reader%read_reals('unbalance', n)
    turned = reader%read_reals('unbalance_phase', n)
    start = [reader%read_real('phase'), reader%read_real('speed')]
    if (reader%status%failed()) return
    drive%unbalance = size_of*cmplx(cos(turned), sin(turned), wp)
    call compile_law(drive%torque, torque_arguments, no_names, no_values, program, parity, degree, &
                     fault)
    if (fault /= '') call complain_of_law(reader, 'torque', drive%torque, fault, torque_arguments)
  end subroutine read_drive

  !> The speed of the shaft in all run-ups, which must agree.
  subroutine read_run_ups(file, reader, shock)
    type(namelist_type), intent(in) :: file
    type(group_reader), intent(inout) :: reader
    !> As of the first run-up.
    type(shock_type), intent(out) :: shock
    type(shock_type) :: other
    logical :: is_first
    integer :: i

    is_first = .true.
    do i = 1, size(file%groups)
      if (.not. is_run_up(file%groups(i))) cycle
      call reader%start(file%path, file%groups(i))
      other%start = reader%read_real('start')
      other%duration = reader%read_real('duration')
      other%speed = reader%read_reals('speed')
      other%phase = reader%read_real('phase')
      if (is_first) shock = other
      is_first = .false.
      if (any(abs([other%start, other%duration, other%speed] &
                  - [shock%start, shock%duration, shock%speed]) > 0.0_wp)) then
        call reader%complain('speed', 'start, duration, speed: must be the same in all run-ups ' &
                             //'of a shaft')
      end if
    end do
  end subroutine read_run_ups

  !> Add a coordinate without loads.
  subroutine widen(load, n)
    type(load_type), intent(inout) :: load
    integer, intent(in) :: n
    integer :: i
    load%force = reshape([transpose(load%force), spread((0.0_wp, 0.0_wp), 1, size(load%orders))], &
                         [n + 1, size(load%orders)], order=[2, 1])
    load%moved = reshape([transpose(load%moved), spread((0.0_wp, 0.0_wp), 1, size(load%orders))], &
                         [n + 1, size(load%orders)], order=[2, 1])
    do i = 1, size(load%varying)
      load%varying(i)%force = [load%varying(i)%force, (0.0_wp, 0.0_wp)]
    end do
    if (.not. load%has_table()) return
    associate (m => size(load%pushes, 2))
      load%pushes = reshape([transpose(load%pushes), spread(0.0_wp, 1, m)], [n + 1, m], &
                            order=[2, 1])
      load%floors = reshape([transpose(load%floors), spread(0.0_wp, 1, m)], [n + 1, m], &
                            order=[2, 1])
    end associate
  end subroutine widen

  !> Add the acceleration of the angle of a run-up.
  subroutine turn(shock, n, load, start)
    type(shock_type), intent(in) :: shock
    integer, intent(in) :: n
    type(load_type), intent(inout) :: load
    real(wp), allocatable, intent(out) :: start(:)
    real(wp) :: ends(2), slopes(1, 2), none(n)

    allocate (start(2))
    none = 0.0_wp
    call find_turn(shock, start, ends, slopes)
    call load%add_row(ends, slopes, [none, 1.0_wp], [none, 0.0_wp])
  end subroutine turn

end module viscovib_shaft_groups
