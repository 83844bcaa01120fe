!> The groups of a scene that make up a structure: &structure, &element.
module viscovib_structure_groups
  use viscovib_coordinate_names, only: read_coordinates, read_units, some
  use viscovib_element_groups, only: add_inner_coordinates, read_element, read_layer
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kernel_groups, only: read_system_kernels
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_limits, only: least_mass
  use viscovib_matrix_groups, only: read_matrix, read_shapes, refuse_ambiguous
  use viscovib_namelist, only: lower, namelist_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_scene_groups, only: place_of
  use viscovib_speed_groups, only: find_speed, read_speed_matrices
  use viscovib_status, only: show, status_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_model, only: condense, structure_model
  use viscovib_structure_rest, only: is_symmetric
  use viscovib_subject, only: name_length
  use viscovib_whole_structure, only: may_be_whole, whole_polynomial
  implicit none
  private

  public :: read_structure

  !> Largest number of elements.
  integer, parameter :: max_elements = 1000

contains

  !> A structure with the names and units of its coordinates. It is condensed, or a system of all
  !! coordinates for results over several speeds.
  subroutine read_structure(file, model, system, whole, is_whole, coordinates, units, echo, status)
    type(namelist_type), intent(in) :: file
    type(structure_model), intent(out) :: model
    type(structure_type), intent(out) :: system
    type(polynomial_type), intent(out) :: whole
    logical, intent(out) :: is_whole
    character(len=name_length), allocatable, intent(out) :: coordinates(:), units(:)
    !> Gets the canonical text of the groups added.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(kernel_holder), allocatable :: kernels(:)
    type(group_reader) :: reader
    type(status_type) :: built
    logical :: is_constant
    real(wp) :: speed
    integer, allocatable :: held(:)
    integer :: at, i, n

    is_whole = .false.
    call read_system_kernels(file, kernels, echo, status)
    if (status%failed()) return
    n = count([(file%groups(i)%name == 'element', i=1, size(file%groups))])
    at = findloc([(file%groups(i)%name == 'structure', i=1, size(file%groups))], .true., 1)
    call reader%start(file%path, file%groups(at))
    call read_body(reader, model, coordinates, units, held)
    call reader%close(echo, status)
    if (status%failed()) return
    if (n > max_elements) then
      call reader%complain('structure', show(n)//' &element groups: must be at most ' &
                           //show(max_elements))
      status = reader%status
      return
    end if
    allocate (model%elements(n))
    model%n_given = n
    n = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'element') cycle
      n = n + 1
      call reader%start(file%path, file%groups(i))
      call read_element(reader, model%elements(n), coordinates, size(kernels))
      call reader%close(echo, status)
      if (status%failed()) return
    end do
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'layer') cycle
      call reader%start(file%path, file%groups(i))
      call read_layer(reader, model, size(kernels))
      call reader%close(echo, status)
      if (status%failed()) return
    end do
    call reader%start(file%path, file%groups(at))
    call add_inner_coordinates(reader, model, coordinates, units)
    if (size(held) > 0 .and. .not. reader%status%failed()) then
      call remove_supports(reader, model, held, coordinates, units)
    end if
    if (any(model%elements%series(1) > 0.0_wp) .and. .not. reader%status%failed()) then
      call model%fix_damping(built)
      call reader%place(built)
    end if
    is_whole = min(place_of(file, 'campbell'), place_of(file, 'drive_torque')) <= size(file%groups)
    if (model%depends_on_speed() .and. .not. reader%status%failed()) then
      call find_speed(file, reader, merge('gyroscopic', '          ', &
                                          any(abs(model%gyroscopic) > 0.0_wp)), speed, is_constant)
      is_whole = .not. is_constant
      if (is_constant .and. .not. reader%status%failed()) then
        call model%set_speed(speed, built)
        call reader%place(built)
      end if
    end if
    if (is_whole .and. .not. reader%status%failed()) call check_whole(reader, model)
    status = reader%status
    if (status%failed()) return
    if (is_whole) then
      call whole_polynomial(model, kernels, whole, built)
    else
      call condense(model, kernels, system, built)
    end if
    call reader%place(built)
    status = reader%status
  end subroutine read_structure

  !> What a structure over several speeds must be.
  subroutine check_whole(reader, model)
    type(group_reader), intent(inout) :: reader
    type(structure_model), intent(in) :: model
    type(status_type) :: sizes

    call model%check_sizes(sizes)
    call reader%place(sizes)
    if (model%is_reduced) then
      call reader%complain('shapes', 'shapes: a structure over several speeds must have all its ' &
                           //'coordinates')
    else if (abs(model%modal%loss) > 0.0_wp) then
      call reader%complain('loss_factor', 'loss_factor: must be 0 over several speeds, use ' &
                           //'damping or modal_damping')
    else if (.not. may_be_whole(model)) then
      call reader%complain('mass', 'mass: must be positive definite over several speeds; give ' &
                           //'speed for a constant one')
    end if
  end subroutine check_whole

  !> The &structure group.
  subroutine read_body(reader, model, coordinates, units, held)
    type(group_reader), intent(inout) :: reader
    type(structure_model), intent(inout) :: model
    character(len=name_length), allocatable, intent(out) :: coordinates(:), units(:)
    !> Supports among the coordinates.
    integer, allocatable, intent(out) :: held(:)
    character(len=:), allocatable :: names
    character(len=name_length), allocatable :: own(:)
    integer :: given, i, n, n_modes, rows

    allocate (coordinates(0), units(0), held(0))
    call read_size(reader, given)
    call read_matrix(reader, 'mass', .true., given, model%mass)
    n = size(model%mass, 1)
    reader%echo = reader%echo//'  size = '//show(n)//new_line('a')
    call read_matrix(reader, 'stiffness', .true., n, model%stiffness)
    call read_matrix(reader, 'damping', .false., n, model%damping)
    if (reader%status%failed()) return
    if (given == 0) call refuse_ambiguous(reader, model%mass, model%stiffness)
    if (reader%status%failed()) return
    call check_mass(reader, model%mass)
    call read_shapes(reader, n, model%places, names)
    if (reader%status%failed()) return
    rows = size(model%places, 1)
    allocate (own(rows))
    call default_names(names, own)
    call read_coordinates(reader, rows, coordinates, own)
    if (size(coordinates) /= rows) then
      call reader%complain('coordinates', 'coordinates: '//show(size(coordinates)) &
                           //' names, must be '//show(rows))
      return
    end if
    call read_units(reader, rows, units)
    call read_supports(reader, coordinates, held)
    if (reader%status%failed()) return
    n_modes = count([(any(abs(model%mass(:, i)) > 0.0_wp) .and. all(held /= i), i=1, n)])
    model%modal%ratios = reader%read_reals('modal_damping')
    if (size(model%modal%ratios) == 1) model%modal%ratios = [(model%modal%ratios(1), i=1, n_modes)]
    if (size(model%modal%ratios) /= n_modes) then
      call reader%complain('modal_damping', 'modal_damping has '//show(size(model%modal%ratios)) &
                           //' values: must be one, or '//show(n_modes))
    end if
    model%modal%rayleigh = reader%read_reals('rayleigh')
    model%modal%loss = reader%read_real('loss_factor')
    call read_speed_matrices(reader, n, model)
    if (model%depends_on_speed() .and. abs(model%modal%loss) > 0.0_wp) then
      call reader%complain('loss_factor', 'loss_factor: must be 0 with gyroscopic, circulatory ' &
                           //'or centrifugal')
    end if
    model%is_reduced = reader%has('shapes')
    if (model%is_reduced .and. n_modes < n) then
      call reader%complain('mass', 'mass: of a structure with shapes must be positive definite')
    end if
    if (model%is_reduced) then
      call reader%refuse([character(len=14) :: 'base_direction', 'supports', 'gyroscopic', &
                          'circulatory', 'centrifugal'], 'belongs to a structure in all ' &
                         //'its coordinates, not to one with shapes')
      allocate (model%base_direction(rows), source=0.0_wp)
    else if (size(held) == 0) then
      model%base_direction = reader%read_reals('base_direction', rows)
    else
      model%base_direction = reader%read_reals('base_direction', &
                                               default=[(0.0_wp, i=1, size(held))])
      if (all(size(model%base_direction) /= [size(held), rows])) then
        call reader%complain('base_direction', 'base_direction has ' &
                             //show(size(model%base_direction))//' values: must be ' &
                             //show(size(held))//', of the supports, or '//show(rows))
      end if
    end if
  end subroutine read_body

  subroutine read_supports(reader, coordinates, held)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: coordinates(:)
    integer, allocatable, intent(out) :: held(:)
    character(len=name_length), allocatable :: names(:)
    integer :: i

    allocate (names(0))
    names = reader%read_words('supports', name_length, size(coordinates), names)
    allocate (held(size(names)))
    do i = 1, size(names)
      held(i) = findloc(coordinates, lower(names(i)), 1)
      if (held(i) == 0) then
        call reader%complain('supports', "supports: '"//trim(names(i))//"' must be one of the " &
                             //show(size(coordinates))//' coordinates '//some(coordinates))
      else if (any(held(:i - 1) == held(i))) then
        call reader%complain('supports', 'supports: must differ')
      end if
      if (reader%status%failed()) return
    end do
    if (size(held) == size(coordinates)) then
      call reader%complain('supports', 'supports: all coordinates are supports, at least one ' &
                           //'must be free')
    end if
  end subroutine read_supports

  !> Keep the free coordinates of a structure with supports.
  subroutine remove_supports(reader, model, held, coordinates, units)
    type(group_reader), intent(inout) :: reader
    type(structure_model), intent(inout) :: model
    integer, intent(in) :: held(:)
    character(len=name_length), allocatable, intent(inout) :: coordinates(:), units(:)
    type(status_type) :: status
    integer, allocatable :: free(:)
    integer :: i

    free = pack([(i, i=1, size(coordinates))], [(all(held /= i), i=1, size(coordinates))])
    call model%hold(free, held, status)
    call reader%place(status)
    model%supports%names = coordinates(held)
    allocate (model%supports%orders(0), model%supports%waves(size(held), 0))
    coordinates = coordinates(free)
    units = units(free)
  end subroutine remove_supports

  !> Number of coordinates, where the matrices alone do not determine it; 0: they do.
  subroutine read_size(reader, n)
    type(group_reader), intent(inout) :: reader
    integer, intent(out) :: n
    character(len=:), allocatable :: echo

    echo = reader%echo
    n = reader%read_integer('size')
    if (reader%status%failed()) n = 0
    ! What it is found to be is echoed.
    reader%echo = echo
  end subroutine read_size

  !> Those of the file, or x1, x2, ...
  subroutine default_names(description, names)
    character(len=*), intent(in) :: description
    character(len=name_length), intent(out) :: names(:)
    character(len=:), allocatable :: left
    integer :: i, n

    left = trim(adjustl(description))
    do i = 1, size(names)
      n = index(left//' ', ' ') - 1
      names(i) = left(:n)
      left = trim(adjustl(left(n + 1:)))
      if (n == 0 .or. n > name_length) exit
    end do
    if (i > size(names) .and. left == '') return
    do i = 1, size(names)
      names(i) = 'x'//show(i)
    end do
  end subroutine default_names

  subroutine check_mass(reader, mass)
    type(group_reader), intent(inout) :: reader
    real(wp), intent(in) :: mass(:, :)
    real(wp) :: l(size(mass, 1), size(mass, 1)), pivot
    integer :: i, j

    if (.not. any(abs(mass) > 0.0_wp)) then
      call reader%complain('mass', 'mass: must not be 0 everywhere')
    end if
    l = 0.0_wp
    do j = 1, size(mass, 1)
      if (.not. any(abs(mass(:, j)) > 0.0_wp)) cycle
      if (mass(j, j) > 0.0_wp .and. mass(j, j) < least_mass) then
        call reader%complain('mass', 'mass: has '//show(mass(j, j))//' in row '//show(j) &
                             //', must be 0 or at least '//show(least_mass)//': choose other units')
      end if
      pivot = mass(j, j) - sum(l(j, :j - 1)**2)
      if (.not. pivot > 0.0_wp .or. .not. is_symmetric(mass)) then
        call reader%complain('mass', 'mass: must be symmetric and positive definite, but for ' &
                             //'coordinates without mass')
        return
      end if
      l(j, j) = sqrt(pivot)
      do i = j + 1, size(mass, 1)
        l(i, j) = (mass(i, j) - sum(l(i, :j - 1)*l(j, :j - 1)))/l(j, j)
      end do
    end do
  end subroutine check_mass

end module viscovib_structure_groups
