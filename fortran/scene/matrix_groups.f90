!> Matrices in groups of a scene: numbers, or names of Matrix Market files.
module viscovib_matrix_groups
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_matrix_market, only: read_matrix_market
  use viscovib_namelist, only: lower
  use viscovib_status, only: clipped, show, status_io_error, status_type
  implicit none
  private

  public :: read_matrix, read_shapes, refuse_ambiguous

  !> Largest number of coordinates.
  integer, parameter :: max_size = 300

contains

  !> Numbers (n: a diagonal; n^2: row by row) or the name of a file of them; 0 if absent.
  subroutine read_matrix(reader, key, required, n_given, matrix)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: key
    logical, intent(in) :: required
    !> Number of rows; 0: that of the matrix.
    integer, intent(in) :: n_given
    !> Shape (n, n), 0 if the reader has failed.
    real(wp), allocatable, intent(out) :: matrix(:, :)
    character(len=:), allocatable :: names
    real(wp), allocatable :: values(:), found(:, :)
    integer :: i, n

    n = n_given
    allocate (matrix(n, n), source=0.0_wp)
    if (is_file(reader, key)) then
      call read_file(reader, key, max_size, found, names)
      if (reader%status%failed()) return
      if (n == 0) n = size(found, 1)
      if (size(found, 1) /= n .or. size(found, 2) /= n) then
        call reader%complain(key, key//': its file is '//show(size(found, 1))//' x ' &
                             //show(size(found, 2))//', must be '//show(n)//' x '//show(n))
        return
      end if
      if (is_triangular(found)) then
        call reader%complain(key, key//': its file has entries on one side of the diagonal only: ' &
                             //'store both triangles, or declare it symmetric; a coupling in one ' &
                             //'direction must be given as numbers')
        return
      end if
      call reader%echo_reals(key, reshape(transpose(found), [n*n]))
      call move_alloc(found, matrix)
      return
    end if
    if (required) then
      values = reader%read_reals(key)
    else
      values = reader%read_reals(key, default=[(0.0_wp, i=1, n)])
    end if
    if (reader%status%failed()) return
    if (n == 0) n = size_of(size(values), values_of(reader, 'coordinates'))
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
    if (size(values) == n) then
      if (n_given == 0) matrix = reshape([(0.0_wp, i=1, n*n)], [n, n])
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

  !> Number of values of a key; 0 if it is absent.
  pure integer function values_of(reader, key) result(n)
    type(group_reader), intent(in) :: reader
    character(len=*), intent(in) :: key
    n = reader%group%find(key)
    if (n > 0) n = reader%group%entries(n)%n_values
  end function values_of

  !> Fail if mass and stiffness, read as diagonals of n coordinates, are full matrices of sqrt(n)
  !! coordinates as well: both symmetric, the mass of any two coordinates positive definite.
  subroutine refuse_ambiguous(reader, mass, stiffness)
    type(group_reader), intent(inout) :: reader
    !> Shape (n, n).
    real(wp), intent(in) :: mass(:, :), stiffness(:, :)
    real(wp), allocatable :: m(:, :), k(:, :)
    integer :: i, j, n, rows

    n = size(mass, 1)
    rows = nint(sqrt(real(n, wp)))
    if (n == 1 .or. rows*rows /= n .or. values_of(reader, 'coordinates') > 0) return
    if (values_of(reader, 'mass') /= n .or. values_of(reader, 'stiffness') /= n) return
    m = reshape([(mass(i, i), i=1, n)], [rows, rows])
    k = reshape([(stiffness(i, i), i=1, n)], [rows, rows])
    if (any(abs(m - transpose(m)) > 0.0_wp) .or. any(abs(k - transpose(k)) > 0.0_wp)) return
    do j = 1, rows
      do i = 1, j - 1
        if (.not. m(i, i)*m(j, j) > m(i, j)**2) return
      end do
    end do
    call reader%complain('size', 'mass and stiffness have '//show(n)//' values each: give size = ' &
                         //show(n)//' (diagonals) or size = '//show(rows)//' (row by row)')
  end subroutine refuse_ambiguous

  !> True for a text, but for a number in quotes.
  logical function is_file(reader, key)
    type(group_reader), intent(in) :: reader
    character(len=*), intent(in) :: key
    integer :: i
    i = reader%group%find(key)
    is_file = .false.
    if (i == 0) return
    associate (value => reader%group%entries(i)%values(1))
      is_file = value%quoted .and. verify(value%text, '+-.0123456789 eEdD') > 0
    end associate
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

end module viscovib_matrix_groups
