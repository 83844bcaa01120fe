!> The groups of a scene that make up a body in space: &body, &mount_point.
module viscovib_body_groups
  use viscovib_body_checks, only: check_inertia, doubt_units
  use viscovib_coordinate_names, only: read_kernel_place
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kernel_groups, only: read_system_kernels
  use viscovib_kinds, only: wp
  use viscovib_law_faults, only: complain_of_law
  use viscovib_law_functions, only: wall
  use viscovib_law_program, only: put_argument
  use viscovib_law_term, only: law_term
  use viscovib_law_text, only: compile_law
  use viscovib_mounted_body, only: build_small, build_turning, mounted_body, rest_type
  use viscovib_namelist, only: lower, namelist_type
  use viscovib_kernel_holder, only: copy_kernels, kernel_holder
  use viscovib_polynomial, only: max_degree
  use viscovib_polynomial_text, only: expand, terms_type
  use viscovib_scene_groups, only: place_of
  use viscovib_speed_groups, only: find_speed
  use viscovib_spring_products, only: n_products
  use viscovib_status, only: clipped, show, status_type
  use viscovib_subject, only: name_length, subject_type
  use viscovib_turning_body, only: body_spring
  implicit none
  private

  public :: read_body

  !> Most mounts; longest name of one; most products of coordinates of one power of a law.
  integer, parameter :: max_mounts = 100, mount_name = 14
  real(wp), parameter :: max_products = 10000.0_wp

contains

  !> A body, and the system made of it about where it rests.
  subroutine read_body(file, subject, echo, status)
    type(namelist_type), intent(in) :: file
    type(subject_type), intent(inout) :: subject
    !> Gets the canonical text of the groups added.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(mounted_body) :: body
    type(kernel_holder), allocatable :: kernels(:)
    type(rest_type) :: rest
    type(group_reader) :: reader
    type(status_type) :: built
    real(wp) :: center(3), speed
    real(wp), allocatable :: angles(:, :)
    logical :: is_constant
    character(len=name_length), allocatable :: names(:)
    integer :: i, n

    call read_system_kernels(file, kernels, echo, status)
    if (status%failed()) return
    call reader%start(file%path, file%groups(place_of(file, 'body')))
    call read_masses(reader, body, center)
    call reader%close(echo, status)
    if (status%failed()) return
    n = count([(file%groups(i)%name == 'mount_point', i=1, size(file%groups))])
    allocate (body%springs(0), body%track_mass(0), body%track_damping(0), names(0))
    allocate (body%mount_of(0), body%axis_of(0), angles(3, n))
    subject%coordinates = [character(len=name_length) :: 'x', 'y', 'z', 'rx', 'ry', 'rz']
    subject%units = [character(len=name_length) :: 'm', 'm', 'm', 'rad', 'rad', 'rad']
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'mount_point') cycle
      call reader%start(file%path, file%groups(i))
      if (n > max_mounts) call reader%complain('name', '&mount_point: '//show(n)//' of them, ' &
                                               //'must be at most '//show(max_mounts))
      call read_mount_point(reader, body, center, names, angles(:, size(names) + 1), subject, &
                            size(kernels))
      call reader%close(echo, status)
      if (status%failed()) return
    end do
    call reader%start(file%path, file%groups(place_of(file, 'body')))
    if (any(abs(body%rotor) > 0.0_wp)) then
      call find_speed(file, reader, 'rotor', speed, is_constant)
      if (is_constant) then
        body%spin = body%spin + speed*body%rotor
        body%rotor = 0.0_wp
      else if (any(abs(body%base_direction(4:6)) > 0.0_wp)) then
        call reader%complain('base_direction', 'base_direction: must not turn the floor with a ' &
                             //'rotor at the speed of the load: give speed')
      end if
    end if
    if (any(abs(body%spin) > 0.0_wp)) then
      do i = 1, size(file%groups)
        if (file%groups(i)%name == 'modes' .or. file%groups(i)%name == 'backbone') then
          call reader%complain('spin', 'spin: modes of a body with parts that spin are complex, ' &
                               //'must be 0 for &'//file%groups(i)%name)
        end if
      end do
    end if
    if (n == 0) call reader%complain('mass', '&body: needs &mount_point, what it stands on')
    body%base_direction = [body%base_direction, (0.0_wp, i=1, size(body%track_mass))]
    if (.not. reader%status%failed()) then
      call body%find_rest(kernels, rest, built)
      if (.not. built%failed() .and. body%exact) then
        call build_turning(body, kernels, rest, subject%turning)
      else if (.not. built%failed()) then
        call build_small(body, kernels, rest, subject%polynomial, built)
      end if
      call reader%place(built)
    end if
    subject%is_polynomial = .not. body%exact
    subject%is_turning = body%exact
    subject%is_body = .true.
    body%names = names
    subject%body = body
    call copy_kernels(kernels, subject%body_kernels)
    subject%warned = doubt_units(body, pack([(i, i=1, size(body%axis_of))], body%axis_of == 1), &
                                 names, angles)
    subject%center = center
    subject%rest = rest
    subject%axes = rest%axes(body%exact)
    status = reader%status
  end subroutine read_body

  !> The &body group.
  subroutine read_masses(reader, body, center)
    type(group_reader), intent(inout) :: reader
    type(mounted_body), intent(inout) :: body
    real(wp), intent(out) :: center(3)
    real(wp), allocatable :: inertia(:)
    real(wp) :: speed
    type(status_type) :: checked
    integer :: i

    body%mass = reader%read_real('mass')
    allocate (inertia(0))
    inertia = reader%read_reals('inertia')
    center = reader%read_reals('center')
    body%gravity = reader%read_reals('gravity')
    body%exact = reader%read_text('geometry') == 'exact'
    body%loads_turn = reader%read_text('load_axes') == 'body'
    body%base_direction = reader%read_reals('base_direction')
    body%spin = reader%read_reals('spin')
    body%rotor = reader%read_reals('rotor')
    if (reader%may_have('speed')) speed = reader%read_real('speed')
    if (reader%status%failed()) return
    if (.not. any(abs(body%rotor) > 0.0_wp)) then
      if (reader%has('speed')) call reader%complain('speed', 'speed: has no effect without rotor')
    else if (body%exact) then
      call reader%complain('rotor', "rotor: must be 0 with geometry = 'exact': give spin, the " &
                           //'angular momentum')
    end if
    if (size(inertia) == 3) then
      do i = 1, 3
        body%inertia(i, i) = inertia(i)
      end do
    else if (size(inertia) == 9) then
      body%inertia = reshape(inertia, [3, 3], order=[2, 1])
    else
      call reader%complain('inertia', 'inertia has '//show(size(inertia))//' values: must be 3 ' &
                           //'(a diagonal) or 9 (row by row)')
    end if
    if (reader%status%failed()) return
    call check_inertia(body%inertia, checked)
    call reader%place(checked)
    if (.not. body%exact .or. reader%status%failed()) return
    if (any(abs(body%base_direction(4:6)) > 0.0_wp)) then
      call reader%complain('base_direction', 'base_direction: must not turn the floor with ' &
                           //"geometry = 'exact'")
    else if (any(abs(body%base_direction) > 0.0_wp) .and. body%loads_turn) then
      call reader%complain('load_axes', "load_axes = 'body': must be 'space' where the floor " &
                           //"moves with geometry = 'exact'")
    end if
  end subroutine read_masses

  !> One &mount_point: springs along its axes, about them, and the track of a fluid mount.
  subroutine read_mount_point(reader, body, center, names, angles, subject, n_kernels)
    type(group_reader), intent(inout) :: reader
    type(mounted_body), intent(inout) :: body
    real(wp), intent(in) :: center(3)
    !> Of the mounts so far; gets this one.
    character(len=name_length), allocatable, intent(inout) :: names(:)
    real(wp), intent(out) :: angles(3)
    !> Gets the coordinate of a track.
    type(subject_type), intent(inout) :: subject
    integer, intent(in) :: n_kernels
    type(body_spring) :: springs(3), turning(3)
    real(wp) :: arm(3), axes(3, 3), stiffness(3), damping(3), held(3)
    real(wp), allocatable :: track(:)
    character(len=:), allocatable :: name, word
    integer :: kernel_of(3), along, i, j

    name = reader%read_text('name')
    arm = reader%read_reals('position') - center
    stiffness = reader%read_reals('stiffness')
    angles = reader%read_reals('angles')
    damping = reader%read_reals('damping')
    held = reader%read_reals('rotational_stiffness')
    call read_kernels_of(reader, n_kernels, kernel_of)
    call check_name(reader, name, names)
    if (reader%status%failed()) return
    names = [character(len=name_length) :: names, lower(name)]
    axes = turned_axes(angles)
    do j = 1, 3
      springs(j)%kernel = kernel_of(j)
      springs(j)%direction = axes(:, j)
      springs(j)%arm = arm
      springs(j)%stiffness = stiffness(j)
      springs(j)%damping = damping(j)
      call read_law(reader, 'law_'//'xyz'(j:j), body%exact, springs(j))
      allocate (turning(j)%coefficient(0), turning(j)%laws(0))
      turning(j)%kernel = kernel_of(j)
      turning(j)%turning = .true.
      turning(j)%direction = axes(:, j)
      turning(j)%stiffness = held(j)
    end do
    allocate (track(0))
    track = reader%read_reals('track')
    word = reader%read_text('track_axis', choice=along)
    if (reader%status%failed()) return
    do j = 1, 3
      call append(body%springs, springs(j))
    end do
    body%axis_of = [body%axis_of, 1, 2, 3]
    do j = 1, 3
      if (held(j) > 0.0_wp) call append(body%springs, turning(j))
    end do
    if (any(abs(track) > 0.0_wp)) then
      if (.not. track(1) > 0.0_wp .or. track(2) < 0.0_wp .or. .not. track(3) > 0.0_wp) then
        call reader%complain('track', 'track: mass and stiffness must be greater than 0, damping ' &
                             //'not negative')
        return
      end if
      body%track_mass = [body%track_mass, track(1)]
      body%track_damping = [body%track_damping, track(2)]
      call append(body%springs, track_spring(springs(along), track(3), body%n_dof()))
      subject%coordinates = [character(len=name_length) :: subject%coordinates, &
                             lower(name)//'_y']
      subject%units = [character(len=name_length) :: subject%units, 'm']
    else if (.not. any(stiffness > 0.0_wp) .and. .not. any(held > 0.0_wp) .and. &
             .not. any([(size(springs(i)%coefficient) + size(springs(i)%laws) > 0, i=1, 3)])) then
      call reader%complain('stiffness', name//': stiffness = 0 0 0: must not be 0 in every ' &
                           //'direction')
    end if
    body%axis_of = [body%axis_of, (0, i=size(body%axis_of) + 1, size(body%springs))]
    body%mount_of = [body%mount_of, (size(names), i=size(body%mount_of) + 1, size(body%springs))]
  end subroutine read_mount_point

  !> The name is a new one.
  subroutine check_name(reader, name, names)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: name, names(:)
    character(len=*), parameter :: letters = 'abcdefghijklmnopqrstuvwxyz_', digits = '0123456789'

    if (reader%status%failed()) return
    if (verify(lower(name), letters//digits) > 0 .or. len(name) > mount_name .or. &
        scan(name//' ', digits//' ') == 1) then
      call reader%complain('name', "name = '"//clipped(name)//"': must be letters, digits and " &
                           //'_, not begin with a digit, and have at most '//show(mount_name) &
                           //' characters')
    else if (any(names == lower(name))) then
      call reader%complain('name', "name = '"//name//"': is given twice, names " &
                           //'must differ')
    end if
  end subroutine check_name

  !> One &kernel for all three directions, or one for each.
  subroutine read_kernels_of(reader, n_kernels, kernel_of)
    type(group_reader), intent(inout) :: reader
    integer, intent(in) :: n_kernels
    integer, intent(out) :: kernel_of(3)
    integer, allocatable :: given(:)

    kernel_of = 0
    allocate (given(0))
    if (.not. reader%may_have('kernels')) then
      kernel_of = read_kernel_place(reader, n_kernels)
      return
    end if
    call reader%refuse(['kernel'], 'kernels has one for each direction already')
    given = reader%read_integers('kernels', 3)
    if (reader%status%failed()) return
    if (any(given < 0) .or. any(given > n_kernels)) then
      call reader%complain('kernels', 'kernels: must be 0 (none) to '//show(n_kernels) &
                           //', places of &kernel groups')
    else
      kernel_of = given
    end if
  end subroutine read_kernels_of

  !> g(d) of a direction: a polynomial, or another law, whole, as one that is not 0 at d = 0.
  subroutine read_law(reader, key, exact, spring)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: key
    logical, intent(in) :: exact
    type(body_spring), intent(inout) :: spring
    character(len=name_length) :: none(0)
    character(len=:), allocatable :: text, fault, other
    real(wp) :: no_values(0), powers(max_degree), value(1), slopes(1, 2)
    type(terms_type) :: terms
    type(law_term) :: law
    integer :: effort, i, power
    logical :: preloads

    allocate (spring%coefficient(0), spring%laws(0))
    text = reader%read_text(key)
    if (reader%status%failed()) return
    effort = 100000
    call expand(lower(text), ['d'], terms, fault, effort)
    preloads = .false.
    if (fault == '') preloads = any(terms%powers(1, :) == 0 .and. abs(terms%coefficients) > 0.0_wp)
    if (fault /= '' .or. preloads) then
      call compile_law(lower(text), ['d', 'v'], none, no_values, law%program, law%parity, &
                       law%degree, other)
      if (other /= '') then
        if (scan(text, '(<>vV') > 0) fault = other
        call complain_of_law(reader, key, text, fault, ['d', 'v'])
        return
      end if
      if (exact .and. any(law%program%code == put_argument &
                            .and. nint(law%program%number) == 2)) then
        call complain_of_law(reader, key, text, 'must not depend on the rate v with geometry = ' &
                             //"'exact'")
        return
      end if
      call law%program%differentiate(reshape([0.0_wp, 0.0_wp], [1, 2]), value, slopes)
      if (abs(value(1)) >= wall) then
        call complain_of_law(reader, key, text, 'must have a value at d = 0')
        return
      end if
      if (any(abs(slopes) >= wall)) then
        call complain_of_law(reader, key, text, 'must have a finite derivative at d = 0')
        return
      end if
      spring%laws = [law]
      return
    end if
    powers = 0.0_wp
    do i = 1, size(terms%coefficients)
      power = terms%powers(1, i)
      if (power < 1 .or. power > max_degree) then
        call complain_of_law(reader, key, text, 'has the power '//show(power) &
                             //', must be 1 to '//show(max_degree))
        return
      end if
      powers(power) = terms%coefficients(i)
    end do
    spring%stiffness = spring%stiffness + powers(1)
    power = findloc(abs(powers) > 0.0_wp, .true., 1, back=.true.)
    if (power < 2) return
    spring%coefficient = powers(2:power)
    if (.not. exact .and. 6*n_products(6, power) > max_products) then
      call complain_of_law(reader, key, text, 'has the power '//show(power) &
                           //", too many products of six coordinates, must be at most 8 with " &
                           //"geometry = 'small'")
    end if
  end subroutine read_law

  !> The spring of a chamber behind which a column of fluid moves.
  pure function track_spring(spring, stiffness, coordinate) result(track)
    type(body_spring), intent(in) :: spring
    real(wp), intent(in) :: stiffness
    integer, intent(in) :: coordinate
    type(body_spring) :: track
    track%direction = spring%direction
    track%arm = spring%arm
    track%stiffness = stiffness
    track%track = coordinate
    allocate (track%coefficient(0), track%laws(0))
  end function track_spring

  subroutine append(springs, spring)
    type(body_spring), allocatable, intent(inout) :: springs(:)
    type(body_spring), intent(in) :: spring
    type(body_spring), allocatable :: more(:)
    integer :: i
    allocate (more(size(springs) + 1))
    do i = 1, size(springs)
      more(i) = springs(i)
    end do
    more(size(more)) = spring
    call move_alloc(more, springs)
  end subroutine append

  !> Rz Ry Rx of angles about x, y and z.
  pure function turned_axes(angles) result(axes)
    real(wp), intent(in) :: angles(3)
    real(wp) :: axes(3, 3), c(3), s(3)
    c = cos(angles)
    s = sin(angles)
    axes(:, 1) = [c(3)*c(2), s(3)*c(2), -s(2)]
    axes(:, 2) = [c(3)*s(2)*s(1) - s(3)*c(1), s(3)*s(2)*s(1) + c(3)*c(1), c(2)*s(1)]
    axes(:, 3) = [c(3)*s(2)*c(1) + s(3)*s(1), s(3)*s(2)*c(1) - c(3)*s(1), c(2)*c(1)]
  end function turned_axes

end module viscovib_body_groups
