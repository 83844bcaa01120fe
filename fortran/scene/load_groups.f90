!> The &load groups of a scene.
module viscovib_load_groups
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_namelist, only: namelist_type
  use viscovib_status, only: status_type
  use viscovib_subject, only: subject_type
  implicit none
  private

  public :: read_loads

contains

  !> Every &load is a term amplitude sin(order nu t + phase), times (order nu)^2 for an unbalance.
  !! The terms are added.
  subroutine read_loads(file, subject, load, echo, status)
    type(namelist_type), intent(in) :: file
    !> What it acts on.
    type(subject_type), intent(in) :: subject
    type(load_type), intent(out) :: load
    !> Gets the canonical text of the groups added.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=:), allocatable :: word
    integer, allocatable :: orders(:)
    complex(wp), allocatable :: force(:, :), base(:), moved(:, :), inertial(:, :)
    real(wp), allocatable :: shape(:)
    real(wp) :: amplitude, phase
    complex(wp) :: term
    integer :: i, n, kind, on
    logical :: apart

    n = count([(file%groups(i)%name == 'load', i=1, size(file%groups))])
    allocate (orders(n), force(size(subject%coordinates), n), base(n))
    force = (0.0_wp, 0.0_wp)
    moved = force
    inertial = force
    base = (0.0_wp, 0.0_wp)
    n = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'load') cycle
      n = n + 1
      on = 1
      call reader%start(file%path, file%groups(i))
      word = reader%read_text('kind', choice=kind)
      apart = subject%is_polynomial .or. subject%is_turning
      if (kind == 2) then
        apart = apart .and. reader%has('on')
        call read_base(reader, subject, on)
        shape = unit(on)
      else if (reader%has('force') .or. reader%has('torque')) then
        call read_direction(reader, subject, shape)
      else
        call reader%refuse(['at'], 'needs force')
        word = reader%read_text('on', trim(subject%coordinates(1)), subject%coordinates, on)
        shape = unit(on)
      end if
      orders(n) = reader%read_integer('order')
      if (reader%has('force') .or. reader%has('torque')) then
        amplitude = reader%read_real('amplitude', 1.0_wp)
      else
        amplitude = reader%read_real('amplitude')
      end if
      if (orders(n) == 0) then
        call reader%refuse(['phase'], 'the mean (order 0) has none')
        term = cmplx(0.0_wp, amplitude, wp)
      else
        phase = reader%read_real('phase')
        term = amplitude*cmplx(cos(phase), sin(phase), wp)
      end if
      if (kind == 1) then
        force(:, n) = shape*term
      else if (kind == 3) then
        inertial(:, n) = shape*term
        if (orders(n) == 0) call reader%complain('order', "order = 0: kind = 'unbalance' turns, " &
                                                 //'must be 1, 2, ...')
      else if (apart) then
        moved(:, n) = shape*term
      else
        base(n) = term
      end if
      call reader%close(echo, status)
      if (status%failed()) return
    end do
    call new_load(load, size(subject%coordinates), orders, force, base, status, moved, &
                  inertial)

  contains

    pure function unit(place) result(values)
      integer, intent(in) :: place
      real(wp) :: values(size(subject%coordinates))
      values = 0.0_wp
      values(place) = 1.0_wp
    end function unit

  end subroutine read_loads

  !> A base that moves along the direction of its system, or one coordinate of it.
  subroutine read_base(reader, subject, on)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    !> The coordinate.
    integer, intent(out) :: on
    character(len=:), allocatable :: word
    integer :: n

    on = 1
    call reader%refuse(['force ', 'torque', 'at    '], 'only a force has this key')
    if (.not. reader%has('on')) then
      if (.not. any(abs(subject%base_direction()) > 0.0_wp)) then
        call reader%complain('kind', "kind = 'base': needs base_direction in &system, or on = " &
                             //'the coordinate that moves')
      end if
      return
    end if
    if (.not. (subject%is_polynomial .or. subject%is_turning) &
        .or. size(subject%coordinates) == 1) then
      call reader%complain('on', 'on: the base moves as a whole; only a force has this key here')
      return
    end if
    n = size(subject%coordinates)
    if (subject%is_body) n = 6
    word = reader%read_text('on', trim(subject%coordinates(1)), subject%coordinates(:n), on)
    if (.not. subject%is_turning) return
    if (on > 3) then
      call reader%complain('on', "on = '"//word//"': must not turn the floor with geometry = " &
                           //"'exact', give x, y or z")
    else if (subject%turning%loads_turn) then
      call reader%complain('on', "load_axes = 'body': must be 'space' where the floor moves with " &
                           //"geometry = 'exact'")
    end if
  end subroutine read_base

  !> A force in any direction at a point of a body, and a torque, on its coordinates.
  subroutine read_direction(reader, subject, shape)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    real(wp), allocatable, intent(out) :: shape(:)
    real(wp) :: force(3), torque(3), arm(3)

    allocate (shape(size(subject%coordinates)), source=0.0_wp)
    call reader%refuse(['on'], 'force and torque say where it acts')
    if (.not. subject%is_body) then
      call reader%refuse(['force ', 'torque'], 'is of a &body, must be left out')
      return
    end if
    force = reader%read_reals('force')
    torque = reader%read_reals('torque')
    arm = reader%read_reals('at', 3, subject%center) - subject%center
    if (reader%status%failed()) return
    if (subject%is_turning) then
      if (.not. subject%turning%loads_turn .and. any(abs(arm) > 0.0_wp)) then
        call reader%complain('at', "at: with geometry = 'exact' and load_axes = 'space' the arm " &
                             //'of a force turns with the body: must be the centre of mass')
      end if
    end if
    arm = matmul(subject%axes, arm)
    shape(:3) = force
    shape(4:6) = torque + [arm(2)*force(3) - arm(3)*force(2), arm(3)*force(1) - arm(1)*force(3), &
                           arm(1)*force(2) - arm(2)*force(1)]
  end subroutine read_direction

end module viscovib_load_groups
