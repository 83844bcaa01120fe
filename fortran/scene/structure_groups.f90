!> The groups of a scene that make up a structure: &structure, &element.
module viscovib_structure_groups
  use viscovib_coordinate_names, only: read_coordinates, read_kernel_place, read_units
  use viscovib_dense, only: factorize, solve
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_hysteresis_catalogue, only: new_hysteresis, order_numbers
  use viscovib_kernel_groups, only: read_system_kernels
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_law_faults, only: complain_of_law
  use viscovib_law_program, only: multiply, put_argument, put_number, subtract
  use viscovib_law_term, only: about_rest, law_term
  use viscovib_law_text, only: compile_law
  use viscovib_limits, only: least_mass
  use viscovib_matrix_market, only: read_matrix_market
  use viscovib_namelist, only: lower, namelist_type
  use viscovib_polynomial, only: max_coordinates, max_degree
  use viscovib_polynomial_text, only: expand, terms_type
  use viscovib_status, only: clipped, show, status_io_error, status_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_elements, only: element_type
  use viscovib_structure_model, only: add_linear, condense, structure_model
  use viscovib_structure_rest, only: is_symmetric
  use viscovib_subject, only: name_length
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: read_structure

  !> Most coordinates, elements, and steps of expanding a law: what takes seconds.
  integer, parameter :: max_size = 300, max_elements = 1000, max_effort = 100000

  !> Eigenvalues, and stretches by the base, below this part of the largest are 0; forces of a base
  !! motion above this part deform something.
  real(wp), parameter :: no_part = 1.0e-12_wp, strained = 1.0e-9_wp
  !> Slope of a fluid damper in series with a spring, in the linear subsystem, relative to rate r.
  real(wp), parameter :: least_slope = 1.0e-4_wp

contains

  !> A structure with the names and units of its coordinates.
  subroutine read_structure(file, model, system, coordinates, units, echo, status)
    type(namelist_type), intent(in) :: file
    type(structure_model), intent(out) :: model
    type(structure_type), intent(out) :: system
    character(len=name_length), allocatable, intent(out) :: coordinates(:), units(:)
    !> Gets the canonical text of the groups added.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(kernel_holder), allocatable :: kernels(:)
    type(group_reader) :: reader
    type(element_type), allocatable :: springs(:)
    real(wp), allocatable :: matrix(:, :)
    type(status_type) :: built
    integer, allocatable :: held(:)
    integer :: at, i, n

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
      n = size(model%mass, 1)
      call read_matrix(reader, 'stiffness', .true., n, matrix)
      call finish_layer(reader, matrix, model%is_reduced, size(kernels), springs)
      call reader%close(echo, status)
      if (status%failed()) return
      call append(model%elements, springs)
    end do
    call reader%start(file%path, file%groups(at))
    call add_inner_coordinates(reader, model, coordinates, units)
    if (size(held) > 0 .and. .not. reader%status%failed()) then
      call remove_supports(reader, model, held, coordinates, units)
    end if
    if (.not. reader%status%failed()) call damp_outside(reader, model)
    status = reader%status
    if (status%failed()) return
    call condense(model, kernels, system, built)
    call reader%place(built)
    status = reader%status

  end subroutine read_structure

  !> Replace the damping of modes without internal coordinates, the last ones, by a damping matrix.
  subroutine damp_outside(reader, model)
    type(group_reader), intent(inout) :: reader
    type(structure_model), intent(inout) :: model
    type(structure_model) :: plain
    real(wp), allocatable :: stiffness(:, :), damping(:, :), squares(:), shapes(:, :)
    integer :: i, n

    n = size(model%mass, 1) - count(model%elements%series(1) > 0.0_wp)
    if (n == size(model%mass, 1) .or. .not. any(abs([model%modal%ratios, model%modal%rayleigh]) &
                                                > 0.0_wp)) return
    plain%mass = model%mass(:n, :n)
    plain%stiffness = model%stiffness(:n, :n)
    plain%damping = 0.0_wp*plain%mass
    plain%places = model%places(:n, :n)
    plain%elements = pack(model%elements, .not. model%elements%series(1) > 0.0_wp)
    do i = 1, size(plain%elements)
      plain%elements(i)%direction = plain%elements(i)%direction(:n)
    end do
    allocate (stiffness(n, n), damping(n, n), shapes(n, n), squares(n))
    call add_linear(plain, stiffness, damping)
    damping = model%modal%rayleigh(1)*plain%mass + model%modal%rayleigh(2)*stiffness
    if (any(abs(model%modal%ratios) > 0.0_wp)) then
      if (any([(.not. plain%mass(i, i) > 0.0_wp, i=1, n)])) then
        call reader%complain('modal_damping', 'modal_damping: not for coordinates without mass ' &
                             //'with series_stiffness of an &element')
        return
      end if
      call find_symmetric_modes(plain%mass, stiffness, squares, shapes)
      squares = 2.0_wp*model%modal%ratios(:n)*sqrt(max(squares, 0.0_wp))
      shapes = matmul(plain%mass, shapes)
      damping = damping + matmul(shapes*spread(squares, 1, n), transpose(shapes))
    end if
    model%damping(:n, :n) = model%damping(:n, :n) + damping
    model%modal%ratios = 0.0_wp*model%modal%ratios
    model%modal%rayleigh = 0.0_wp
  end subroutine damp_outside

  !> Add internal coordinates s of Maxwell elements with springs k and rates h(force) of dampers, so
  !! that the spring has the deflection s' + r s:
  !!
  !!   k s'' + k r s' + k h(s' + r s) = k d', force k (s' + r s).
  !!
  !! At rest h has no slope for exponents below 1. A small one is added to the linear subsystem and
  !! taken from the law.
  subroutine add_inner_coordinates(reader, model, coordinates, units)
    type(group_reader), intent(inout) :: reader
    type(structure_model), intent(inout) :: model
    character(len=name_length), allocatable, intent(inout) :: coordinates(:), units(:)
    real(wp) :: e(size(model%mass, 1)), rate, softness
    character(len=:), allocatable :: fault, q
    integer :: i, j, m, n

    n = size(model%mass, 1)
    m = count([(model%elements(i)%series(1) > 0.0_wp, i=1, size(model%elements))])
    if (m == 0) return
    if (model%is_reduced) then
      call reader%complain('shapes', 'shapes: not with series_stiffness of an &element')
    else if (abs(model%modal%loss) > 0.0_wp) then
      call reader%complain('loss_factor', 'loss_factor: not with series_stiffness of an ' &
                           //'&element, use damping or modal_damping')
    end if
    if (reader%status%failed()) return
    call widen(model%mass, m)
    call widen(model%damping, m)
    call widen(model%stiffness, m)
    call widen(model%places, m)
    model%modal%ratios = [model%modal%ratios, (0.0_wp, i=1, m)]
    if (size(model%base_direction) == n) model%base_direction = [model%base_direction, &
                                                                 (0.0_wp, i=1, m)]
    call lengthen(coordinates, m)
    call lengthen(units, m)
    do j = 1, m
      coordinates(n + j) = 'maxwell'//show(j)
      units(n + j) = 'm s'
      model%places(n + j, n + j) = 1.0_wp
    end do
    do i = 1, size(model%elements)
      model%elements(i)%direction = [model%elements(i)%direction, (0.0_wp, j=1, m)]
    end do
    j = n
    do i = 1, size(model%elements)
      associate (one => model%elements(i), k => model%elements(i)%series(1))
        if (.not. k > 0.0_wp) cycle
        j = j + 1
        e = one%direction(:n)
        softness = 0.0_wp
        do m = 1, n
          if (model%mass(m, m) > 0.0_wp) softness = softness + e(m)**2/model%mass(m, m)
        end do
        rate = 1.0_wp
        if (softness > 0.0_wp) rate = sqrt(k*softness)
        model%mass(j, j) = k
        model%damping(:n, j) = k*e
        model%damping(j, :n) = -k*e
        model%damping(j, j) = k*rate
        model%stiffness(:n, j) = k*rate*e
        one%direction = 0.0_wp
        one%direction(j) = 1.0_wp
        associate (c => one%series(2), a => one%series(3))
          if (a < 1.0_wp) then
            q = '(v + '//show(rate)//'*d)'
            q = show(k)//'*sign'//q//'*abs('//show(k)//'*'//q//'/'//show(c)//')^'//show(1.0_wp/a)
            call read_function(one, q, fault)
            one%damping = least_slope*rate*k
            associate (law => one%laws(1)%program)
              law%code = [law%code, put_argument, put_number, multiply, subtract, put_argument, &
                          put_number, multiply, subtract]
              law%number = [law%number, 1.0_wp, rate*one%damping, 0.0_wp, 0.0_wp, 2.0_wp, &
                            one%damping, 0.0_wp, 0.0_wp]
              call law%measure()
            end associate
          else
            one%damping = k*k/c
          end if
          one%stiffness = rate*one%damping
        end associate
      end associate
    end do

  contains

    !> Append m rows and columns of 0.
    subroutine widen(matrix, m)
      real(wp), allocatable, intent(inout) :: matrix(:, :)
      integer, intent(in) :: m
      real(wp), allocatable :: wider(:, :)
      allocate (wider(size(matrix, 1) + m, size(matrix, 2) + m), source=0.0_wp)
      wider(:size(matrix, 1), :size(matrix, 2)) = matrix
      call move_alloc(wider, matrix)
    end subroutine widen

    !> Append m names.
    subroutine lengthen(names, m)
      character(len=name_length), allocatable, intent(inout) :: names(:)
      integer, intent(in) :: m
      character(len=name_length) :: longer(size(names) + m)
      longer = ''
      longer(:size(names)) = names
      names = longer
    end subroutine lengthen

  end subroutine add_inner_coordinates

  !> Elements and more of them, each copied on its own.
  subroutine append(elements, more)
    type(element_type), allocatable, intent(inout) :: elements(:)
    type(element_type), intent(in) :: more(:)
    type(element_type), allocatable :: longer(:)
    integer :: i

    allocate (longer(size(elements) + size(more)))
    do i = 1, size(elements)
      longer(i) = elements(i)
    end do
    do i = 1, size(more)
      longer(size(elements) + i) = more(i)
    end do
    call move_alloc(longer, elements)
  end subroutine append

  !> The &structure group.
  subroutine read_body(reader, model, coordinates, units, held)
    type(group_reader), intent(inout) :: reader
    type(structure_model), intent(inout) :: model
    character(len=name_length), allocatable, intent(out) :: coordinates(:), units(:)
    !> Supports among the coordinates.
    integer, allocatable, intent(out) :: held(:)
    character(len=:), allocatable :: names
    character(len=name_length), allocatable :: own(:)
    integer :: i, n, n_modes, rows

    allocate (coordinates(0), units(0), held(0))
    call read_size(reader, n)
    call read_matrix(reader, 'mass', .true., n, model%mass)
    reader%echo = reader%echo//'  size = '//show(n)//new_line('a')
    call read_matrix(reader, 'stiffness', .true., n, model%stiffness)
    call read_matrix(reader, 'damping', .false., n, model%damping)
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
    model%is_reduced = reader%has('shapes')
    if (model%is_reduced .and. n_modes < n) then
      call reader%complain('mass', 'mass: of a structure with shapes must be positive definite')
    end if
    if (model%is_reduced) then
      call reader%refuse(['base_direction', 'supports      '], 'belongs to a structure in all ' &
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

  !> Keep the free coordinates u_f = r y + w of a structure whose supports move by u_s = d y:
  !!
  !!   M_ff w'' + C_ff w' + K_ff w + elements(w) = p - (M_ff r + M_fs d) y'',
  !!
  !! where K_ff r + K_fs d = 0, C_ff r + C_fs d = 0, and no element is stretched by (r, d).
  subroutine remove_supports(reader, model, held, coordinates, units)
    type(group_reader), intent(inout) :: reader
    type(structure_model), intent(inout) :: model
    integer, intent(in) :: held(:)
    character(len=name_length), allocatable, intent(inout) :: coordinates(:), units(:)
    real(wp), dimension(size(model%mass, 1), size(model%mass, 1)) :: damping, stiffness, low
    real(wp) :: moved(size(model%mass, 1)), pulled(size(model%mass, 1))
    integer :: i, n
    integer, allocatable :: free(:)

    n = size(moved)
    free = pack([(i, i=1, n)], [(all(held /= i), i=1, n)])
    call add_linear(model, stiffness, damping, low)
    moved = 0.0_wp
    if (size(model%base_direction) == n) then
      moved = model%base_direction
    else
      moved(held) = model%base_direction
      if (any(abs(moved) > 0.0_wp)) moved(free) = static(stiffness(free, free), &
                                                 -matmul(stiffness(free, held), moved(held)))
    end if
    do i = 1, size(model%elements)
      associate (e => model%elements(i)%direction)
        if (.not. any(abs(e(free)) > 0.0_wp)) then
          call reader%complain('supports', '&element '//show(i)//': acts on supports only, must ' &
                               //'act on a free coordinate')
        else if (abs(sum(e*moved)) > no_part*sum(abs(e*moved))) then
          call reader%complain('base_direction', 'base_direction: stretches &element '//show(i) &
                               //', must not here; Structure of Python takes it')
        end if
        if (reader%status%failed()) return
      end associate
      model%elements(i)%direction = model%elements(i)%direction(free)
    end do
    pulled = matmul(stiffness, moved)
    if (any(abs(pulled(free)) > strained*matmul(abs(stiffness(free, :)), abs(moved)))) then
      call reader%complain('base_direction', 'base_direction: deforms springs, must not; the ' &
                           //'motion of the supports alone is enough')
      return
    end if
    pulled = matmul(damping, moved)
    model%base_strains = any(abs(pulled(free)) > strained*matmul(abs(damping(free, :)), abs(moved)))
    model%support_mass = matmul(model%mass(free, held), moved(held))
    model%base_direction = moved(free)
    model%mass = model%mass(free, free)
    model%damping = model%damping(free, free)
    model%stiffness = model%stiffness(free, free)
    model%places = model%places(free, free)
    coordinates = coordinates(free)
    units = units(free)

  contains

    !> Static deflection; 0 without supports that hold the structure.
    function static(matrix, forces) result(found)
      real(wp), intent(in) :: matrix(:, :), forces(:)
      real(wp) :: found(size(forces)), factors(size(forces), size(forces))
      integer :: pivots(size(forces))
      logical :: singular
      factors = matrix
      found = forces
      call factorize(size(forces), factors, pivots, singular)
      if (singular) then
        found = 0.0_wp
      else
        call solve(size(forces), factors, pivots, found)
      end if
    end function static

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

  !> Numbers (n: a diagonal; n^2: row by row) or the name of a file of them; 0 if absent.
  subroutine read_matrix(reader, key, required, n, matrix)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: key
    logical, intent(in) :: required
    !> 0: found here.
    integer, intent(inout) :: n
    real(wp), allocatable, intent(out) :: matrix(:, :)
    character(len=:), allocatable :: names
    real(wp), allocatable :: values(:)
    integer :: i

    allocate (matrix(n, n), source=0.0_wp)
    if (is_file(reader, key)) then
      call read_file(reader, key, max_size, matrix, names)
      if (reader%status%failed()) return
      if (n == 0) n = size(matrix, 1)
      if (size(matrix, 1) /= n .or. size(matrix, 2) /= n) then
        call reader%complain(key, key//': its file is '//show(size(matrix, 1))//' x ' &
                             //show(size(matrix, 2))//', must be '//show(n)//' x '//show(n))
        return
      end if
      if (is_triangular(matrix)) then
        call reader%complain(key, key//': its file has entries on one side of the diagonal only: ' &
                             //'store both triangles, or declare it symmetric; a coupling in one ' &
                             //'direction must be given as numbers')
        return
      end if
      call reader%echo_reals(key, reshape(transpose(matrix), [n*n]))
      return
    end if
    if (required) then
      values = reader%read_reals(key)
    else
      values = reader%read_reals(key, default=[(0.0_wp, i=1, n)])
    end if
    if (reader%status%failed()) return
    if (n == 0) n = size_of(size(values), names_given(reader))
    if (n > max_size) then
      call reader%complain(key, key//' is of '//show(n)//' coordinates: must be at most ' &
                           //show(max_size))
      return
    end if
    if (size(values) /= n .and. size(values) /= n*n) then
      call reader%complain(key, key//' has '//show(size(values))//' values: must be '//show(n) &
                           //' (a diagonal) or '//show(n*n)//' (row by row)')
      return
    end if
    deallocate (matrix)
    allocate (matrix(n, n), source=0.0_wp)
    if (size(values) == n) then
      do i = 1, n
        matrix(i, i) = values(i)
      end do
    else
      matrix = reshape(values, [n, n], order=[2, 1])
    end if
  end subroutine read_matrix

  !> True if entries off the diagonal are on one side of it only.
  pure logical function is_triangular(matrix)
    real(wp), intent(in) :: matrix(:, :)
    logical :: above, below
    integer :: j
    above = .false.
    below = .false.
    do j = 1, size(matrix, 2)
      above = above .or. any(abs(matrix(:j - 1, j)) > 0.0_wp)
      below = below .or. any(abs(matrix(j + 1:, j)) > 0.0_wp)
    end do
    is_triangular = above .neqv. below
  end function is_triangular

  !> How many coordinates a mass of so many numbers is for: a diagonal, unless names say otherwise.
  pure integer function size_of(n_values, n_names) result(n)
    integer, intent(in) :: n_values, n_names
    n = n_values
    if (n_names > 0 .and. n_names < 46340) then
      if (n_names**2 == n_values) n = n_names
    end if
  end function size_of

  pure integer function names_given(reader) result(n)
    type(group_reader), intent(in) :: reader
    n = reader%group%find('coordinates')
    if (n > 0) n = reader%group%entries(n)%n_values
  end function names_given

  logical function is_file(reader, key)
    type(group_reader), intent(in) :: reader
    character(len=*), intent(in) :: key
    integer :: i
    i = reader%group%find(key)
    is_file = .false.
    if (i > 0) is_file = reader%group%entries(i)%values(1)%quoted
  end function is_file

  !> A matrix from a file in the folder of the scene.
  subroutine read_file(reader, key, most_rows, matrix, names)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: key
    integer, intent(in) :: most_rows
    real(wp), allocatable, intent(out) :: matrix(:, :)
    character(len=:), allocatable, intent(out) :: names
    character(len=:), allocatable :: path
    type(status_type) :: status
    integer :: dot

    allocate (matrix(0, 0))
    names = ''
    path = reader%read_path(key)
    if (reader%status%failed()) return
    dot = index(path, '.', back=.true.)
    if (all(lower(path(max(dot, 1):)) /= [character(len=4) :: '.mtx', '.mm'])) then
      call reader%complain(key, key//" = '"//clipped(path)//"': must be a Matrix Market file " &
                           //'(.mtx); .npz and Harwell-Boeing files are read by Python ' &
                           //'(Structure.read), which reduces sparse matrices')
      return
    end if
    call read_matrix_market(path, most_rows, max_size, matrix, names, status)
    if (status%category == status_io_error) then
      call reader%complain(key, key//': '//status%message, status_io_error)
    else if (status%failed()) then
      ! The file's own name and line say more than the scene's.
      reader%status = status
    end if
  end subroutine read_file

  !> What the places with names are in terms of the coordinates: those themselves, or of a reduced
  !! structure its shapes.
  subroutine read_shapes(reader, n, places, names)
    type(group_reader), intent(inout) :: reader
    integer, intent(in) :: n
    real(wp), allocatable, intent(out) :: places(:, :)
    !> As the file tells them.
    character(len=:), allocatable, intent(out) :: names
    real(wp), allocatable :: values(:)
    real(wp) :: none(0)
    integer :: i, rows

    names = ''
    allocate (places(n, n), source=0.0_wp)
    if (is_file(reader, 'shapes')) then
      call read_file(reader, 'shapes', max_size, places, names)
      if (reader%status%failed()) return
      if (size(places, 2) /= n) then
        call reader%complain('shapes', 'shapes: its file has '//show(size(places, 2)) &
                             //' columns, must have '//show(n))
        return
      end if
      call reader%echo_reals('shapes', reshape(transpose(places), [size(places)]))
      return
    end if
    values = reader%read_reals('shapes', default=none)
    if (size(values) == 0) then
      do i = 1, n
        places(i, i) = 1.0_wp
      end do
      return
    end if
    rows = size(values)/n
    if (rows*n /= size(values)) then
      call reader%complain('shapes', 'shapes has '//show(size(values))//' values: must be rows ' &
                           //'of '//show(n))
    else if (rows > max_size) then
      call reader%complain('shapes', 'shapes has '//show(rows)//' rows: must be at most ' &
                           //show(max_size))
    else
      places = reshape(values, [rows, n], order=[2, 1])
    end if
  end subroutine read_shapes

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

  !> One &element: [k d + law(d)] with a kernel or none, and c d', along a direction.
  subroutine read_element(reader, element, coordinates, n_kernels)
    type(group_reader), intent(inout) :: reader
    type(element_type), intent(out) :: element
    character(len=name_length), intent(in) :: coordinates(:)
    integer, intent(in) :: n_kernels
    character(len=name_length), allocatable :: on(:)
    character(len=:), allocatable :: law, fault
    real(wp), allocatable :: weights(:)
    type(terms_type) :: terms
    integer :: effort, i, place

    allocate (element%direction(size(coordinates)), source=0.0_wp)
    allocate (element%laws(0), on(0), weights(0))
    on = reader%read_words('on', name_length, size(coordinates))
    if (size(on) == 1) weights = reader%read_reals('weights', 1, [1.0_wp])
    if (size(on) == 2) weights = reader%read_reals('weights', 2, [1.0_wp, -1.0_wp])
    if (size(on) > 2) weights = reader%read_reals('weights', size(on))
    do i = 1, size(on)
      place = findloc(coordinates, lower(on(i)), 1)
      if (place == 0) then
        call reader%complain('on', "on = '"//trim(on(i))//"': must be one of the " &
                             //show(size(coordinates))//' coordinates '//some(coordinates))
        return
      end if
      element%direction(place) = element%direction(place) + weights(i)
    end do
    if (.not. any(abs(element%direction) > 0.0_wp)) then
      call reader%complain('weights', 'weights: is not a direction: all of them are 0')
    end if
    element%stiffness = reader%read_real('stiffness')
    element%damping = reader%read_real('damping')
    element%kernel = read_kernel_place(reader, n_kernels)
    law = reader%read_text('law')
    call add_fluid_damper(reader, element, law)
    call add_hysteresis(reader, element)
    if (reader%status%failed()) return
    effort = max_effort
    call expand(law, ['d'], terms, fault, effort)
    ! What is not 0 at rest, a static force, is taken as other laws are.
    if (fault /= '' .or. any(sum(terms%powers, 1) == 0)) then
      call read_function(element, law, fault)
      if (fault /= '') call complain_of_law(reader, 'law', law, fault, ['d', 'v'])
      return
    end if
    do i = 1, size(terms%coefficients)
      select case (terms%powers(1, i))
      case (1)
        element%stiffness = element%stiffness + terms%coefficients(i)
      case (2:max_degree)
        element%powers(terms%powers(1, i)) = terms%coefficients(i)
      case default
        call complain_of_law(reader, 'law', law, 'has degree '//show(terms%powers(1, i)) &
                             //', must be at most '//show(max_degree))
      end select
    end do
  end subroutine read_element

  !> Add a fluid viscous damper to the law of an element; a linear one to its damping.
  subroutine add_fluid_damper(reader, element, law)
    type(group_reader), intent(inout) :: reader
    type(element_type), intent(inout) :: element
    character(len=:), allocatable, intent(inout) :: law
    real(wp) :: c, a, limit, relief, series

    c = reader%read_real('fluid_coefficient')
    a = reader%read_real('fluid_exponent')
    limit = reader%read_real('fluid_limit')
    relief = reader%read_real('fluid_relief')
    series = reader%read_real('series_stiffness')
    if (series > 0.0_wp) then
      if (.not. c > 0.0_wp .or. limit > 0.0_wp .or. law /= '0' .or. element%kernel > 0 &
          .or. any(abs([element%stiffness, element%damping]) > 0.0_wp)) then
        call reader%complain('series_stiffness', 'series_stiffness = '//show(series)//': needs a ' &
                             //'fluid_coefficient, and kernel = 0; other parts belong to ' &
                             //'another &element')
      else if (a > 1.0_wp) then
        call reader%complain('fluid_exponent', 'fluid_exponent = '//show(a)//': must be 0.1 to 1 ' &
                             //'with series_stiffness')
      end if
      element%series = [series, c, a]
      return
    end if
    if (.not. c > 0.0_wp) return
    if (element%kernel > 0) then
      call reader%complain('fluid_coefficient', 'fluid_coefficient = '//show(c)//': must be 0 in ' &
                           //'an element with a kernel: use kernel = 0, or another &element')
    else if (limit > 0.0_wp) then
      law = '('//law//') + relief(v, '//show(c)//', '//show(a)//', '//show(limit)//', ' &
            //show(relief)//')'
    else if (abs(a - 1.0_wp) > 0.0_wp) then
      law = '('//law//') + '//show(c)//'*sign(v)*abs(v)^'//show(a)
    else
      element%damping = element%damping + c
    end if
    if (law(:min(6, len(law))) == '(0) + ') law = law(7:)
  end subroutine add_fluid_damper

  !> Add hysteresis to an element.
  subroutine add_hysteresis(reader, element)
    type(group_reader), intent(inout) :: reader
    type(element_type), intent(inout) :: element
    class(hysteresis_type), allocatable :: memory
    character(len=:), allocatable :: fault, kind
    real(wp), allocatable :: numbers(:)
    type(law_term) :: law
    integer :: i, state

    kind = reader%read_text('hysteresis')
    if (reader%status%failed() .or. kind == 'none') return
    if (element%series(1) > 0.0_wp) then
      call reader%complain('hysteresis', "hysteresis = '"//kind//"': belongs to another " &
                           //'&element, without series_stiffness')
      return
    end if
    numbers = reader%read_reals('hysteresis_numbers')
    if (reader%status%failed()) return
    call order_numbers(kind, numbers, state, fault)
    if (fault == '' .and. element%kernel > 0) fault = "hysteresis = '"//kind//"': must be 'none' " &
      //'in an element with a kernel: use kernel = 0, or another &element'
    if (fault /= '') then
      call reader%complain('hysteresis_numbers', fault)
      return
    end if
    call new_hysteresis(memory, state, numbers)
    element%stiffness = element%stiffness + memory%stiffness_at_rest()
    law%state = state
    law%parity = -1
    law%text = kind
    law%program%code = [put_argument, (put_number, i=1, size(numbers))]
    law%program%number = [1.0_wp, numbers]
    law%program%n_arguments = 1
    call law%program%measure()
    law%arguments = reshape([1.0_wp], [1, 1])
    law%rates = reshape([0.0_wp], [1, 1])
    element%laws = [law]
  end subroutine add_hysteresis

  !> A law that is no polynomial, if it is one; else the fault stays, or is said better.
  subroutine read_function(element, text, fault)
    type(element_type), intent(inout) :: element
    character(len=*), intent(in) :: text
    character(len=:), allocatable, intent(inout) :: fault
    character(len=name_length) :: none(0)
    real(wp) :: no_values(0), slopes(2)
    character(len=:), allocatable :: other

    element%laws = [law_term(), element%laws]
    associate (law => element%laws(1))
      call compile_law(lower(text), ['d', 'v'], none, no_values, law%program, law%parity, &
                       law%degree, other)
      if (other /= '') then
        if (scan(text, '(<>vV') > 0) fault = other
        return
      end if
      law%kernel = element%kernel
      law%text = text
      call about_rest(law, slopes, fault)
      law%arguments = reshape([1.0_wp, 0.0_wp], [2, 1])
      law%rates = reshape([0.0_wp, 1.0_wp], [2, 1])
      call law%drop_unread()
    end associate
    element%stiffness = element%stiffness + slopes(1)
    element%damping = element%damping + slopes(2)
  end subroutine read_function

  pure function some(names)
    character(len=*), intent(in) :: names(:)
    character(len=:), allocatable :: some
    integer :: i
    some = trim(names(1))
    do i = 2, min(size(names), 4)
      some = some//', '//trim(names(i))
    end do
    if (size(names) > 4) some = some//', ...'
  end function some

  ! The &layer groups of a scene: stiffness matrices of a structure that relax as a whole.

  !> A layer (1 - R*) K u as springs along the eigenvectors of K, which is the same.
  subroutine finish_layer(reader, matrix, is_reduced, n_kernels, springs)
    type(group_reader), intent(inout) :: reader
    !> K, shape (n, n).
    real(wp), intent(in) :: matrix(:, :)
    !> Whether the places with names are not the coordinates.
    logical, intent(in) :: is_reduced
    integer, intent(in) :: n_kernels
    type(element_type), allocatable, intent(out) :: springs(:)
    real(wp), allocatable :: unit(:, :), sizes(:), shapes(:, :)
    integer, allocatable :: touched(:), kept(:)
    integer :: i, kernel, m

    allocate (springs(0))
    kernel = read_kernel_place(reader, n_kernels)
    if (reader%status%failed()) return
    if (is_reduced) then
      call reader%complain('stiffness', '&layer: belongs to a structure in all its coordinates, ' &
                           //'not to one with shapes')
    else if (.not. is_symmetric(matrix)) then
      call reader%complain('stiffness', 'stiffness: must be symmetric, as that of a layer')
    end if
    if (reader%status%failed()) return
    touched = pack([(i, i=1, size(matrix, 1))], any(abs(matrix) > 0.0_wp, 2))
    m = size(touched)
    if (m == 0) return
    allocate (unit(m, m), sizes(m), shapes(m, m))
    unit = 0.0_wp
    do i = 1, m
      unit(i, i) = 1.0_wp
    end do
    call find_symmetric_modes(unit, matrix(touched, touched), sizes, shapes)
    kept = pack([(i, i=1, m)], abs(sizes) > no_part*maxval(abs(sizes)))
    if (kernel > 0 .and. size(kept) > max_coordinates) then
      call reader%complain('stiffness', 'stiffness: its layer acts in '//show(size(kept)) &
                           //' directions, must be at most '//show(max_coordinates)//' here; ' &
                           //'Structure(layers=) of Python takes any number with a kernel that ' &
                           //'is a sum of exponentials')
      return
    end if
    deallocate (springs)
    allocate (springs(size(kept)))
    do i = 1, size(kept)
      allocate (springs(i)%direction(size(matrix, 1)), source=0.0_wp)
      allocate (springs(i)%laws(0))
      springs(i)%direction(touched) = shapes(:, kept(i))
      springs(i)%stiffness = sizes(kept(i))
      springs(i)%kernel = kernel
    end do
  end subroutine finish_layer

end module viscovib_structure_groups
