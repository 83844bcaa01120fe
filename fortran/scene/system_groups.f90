!> The groups of a scene that make up a polynomial system: &system, &spring, &force.
module viscovib_system_groups
  use viscovib_coordinate_names, only: read_coordinates, read_kernel_place, read_units
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kernel_groups, only: read_system_kernels
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_law_faults, only: read_law
  use viscovib_law_term, only: law_term
  use viscovib_matrix_groups, only: read_matrix
  use viscovib_namelist, only: namelist_type
  use viscovib_polynomial, only: max_coordinates, max_degree, new_polynomial, &
    polynomial_parameters, polynomial_type
  use viscovib_number_text, only: exact
  use viscovib_polynomial_text, only: terms_type
  use viscovib_speed_groups, only: find_speed, read_speed_matrices
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_subject, only: name_length
  implicit none
  private

  public :: read_system

  !> Most monomials of all laws, numbers of all stiffnesses, and steps of expanding all laws: what
  !! is read within a second.
  integer, parameter :: max_monomials = 10000, max_stiffness = 2000000, max_effort = 10000000, &
                        max_laws = 100

contains

  !> A system with the names and units of its coordinates.
  subroutine read_system(file, system, coordinates, units, echo, status)
    type(namelist_type), intent(in) :: file
    type(polynomial_type), intent(out) :: system
    character(len=name_length), allocatable, intent(out) :: coordinates(:), units(:)
    !> Gets the canonical text of the groups added.
    type(growing_text), intent(inout) :: echo
    type(status_type), intent(out) :: status
    type(polynomial_parameters) :: p
    type(kernel_holder), allocatable :: kernels(:)
    type(group_reader) :: reader
    type(status_type) :: built
    real(wp), allocatable :: matrix(:, :)
    real(wp) :: speed
    integer :: i, at, n_springs, n_monomials, effort
    logical :: is_constant

    call read_system_kernels(file, kernels, echo, status)
    if (status%failed()) return
    n_springs = count([(file%groups(i)%name == 'spring', i=1, size(file%groups))])
    at = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name == 'system') at = i
    end do
    call reader%start(file%path, file%groups(at))
    call read_body(reader, p, n_springs, coordinates, units, size(kernels))
    call reader%close(echo, status)
    if (status%failed()) return
    allocate (p%coefficient(0), p%on(0), p%monomial_kernel(0), p%powers(size(coordinates), 0))
    n_springs = 1
    n_monomials = 0
    effort = max_effort
    do i = 1, size(file%groups)
      if (file%groups(i)%name == 'spring') then
        n_springs = n_springs + 1
        call reader%start(file%path, file%groups(i))
        call read_matrix(reader, 'stiffness', .true., size(coordinates), matrix)
        p%stiffness(:, :, n_springs) = matrix
        p%spring_kernel(n_springs) = read_kernel_place(reader, size(kernels))
      else if (file%groups(i)%name == 'force') then
        call reader%start(file%path, file%groups(i))
        call read_force(reader, p, n_monomials, coordinates, size(kernels), effort)
      else
        cycle
      end if
      call reader%close(echo, status)
      if (status%failed()) return
    end do
    call p%resize_monomials(n_monomials)
    call reader%start(file%path, file%groups(at))
    call new_polynomial(system, p, kernels, built)
    call reader%place(built)
    if (system%depends_on_speed()) then
      call find_speed(file, reader, merge('gyroscopic', '          ', &
                                          any(abs(system%gyroscopic) > 0.0_wp)), speed, is_constant)
      if (is_constant) call system%set_speed(speed)
    end if
    status = reader%status
  end subroutine read_system

  !> The &system group.
  subroutine read_body(reader, p, n_springs, coordinates, units, n_kernels)
    type(group_reader), intent(inout) :: reader
    type(polynomial_parameters), intent(inout) :: p
    !> &spring groups to come.
    integer, intent(in) :: n_springs, n_kernels
    character(len=name_length), allocatable, intent(out) :: coordinates(:), units(:)
    real(wp), allocatable :: stiffness(:, :)
    integer :: n

    call read_coordinates(reader, max_coordinates, coordinates)
    n = size(coordinates)
    call read_units(reader, n, units)
    if (reader%status%failed()) return
    if (n_springs >= max_stiffness/n**2) then
      call fail(reader%status, status_input_error, 'spring', reader%path//': '//show(n_springs) &
                //' &spring groups of '//show(n)//' coordinates: must be fewer, what has the ' &
                //'same kernel adds up')
      return
    end if
    call read_matrix(reader, 'mass', .true., n, p%mass)
    allocate (p%stiffness(n, n, n_springs + 1), p%spring_kernel(n_springs + 1))
    call read_matrix(reader, 'stiffness', .false., n, stiffness)
    p%stiffness(:, :, 1) = stiffness
    call read_matrix(reader, 'damping', .false., n, p%damping)
    p%spring_kernel(1) = read_kernel_place(reader, n_kernels)
    p%base_direction = reader%read_reals('base_direction', n)
    call read_speed_matrices(reader, n, p)
  end subroutine read_body

  !> One force: a law such as 0.5*(x1 - x2)^3, or coefficient and powers of one
  !! monomial. The canonical text has monomials only.
  subroutine read_force(reader, p, n, coordinates, n_kernels, effort)
    type(group_reader), intent(inout) :: reader
    type(polynomial_parameters), intent(inout) :: p
    !> Monomials in use, of those there is work for.
    integer, intent(inout) :: n
    integer, intent(in) :: n_kernels
    !> Steps of expanding that are left.
    integer, intent(inout) :: effort
    character(len=name_length), intent(in) :: coordinates(:)
    type(terms_type) :: terms
    type(law_term), allocatable :: other
    character(len=:), allocatable :: word, law
    real(wp) :: slopes(2*size(coordinates))
    integer :: i, on, kernel, powers(size(coordinates))

    on = 1
    if (size(coordinates) > 1) then
      word = reader%read_text('on', allowed=coordinates, choice=on)
    else
      word = reader%read_text('on', trim(coordinates(1)), coordinates, on)
    end if
    kernel = read_kernel_place(reader, n_kernels)
    if (reader%has('law') .or. .not. (reader%has('coefficient') .or. reader%has('powers'))) then
      call reader%refuse([character(len=11) :: 'coefficient', 'powers'], 'the law says it ' &
                         //'already; give either law, or coefficient and powers')
      law = reader%read_text('law')
      if (reader%status%failed()) return
      call read_law(reader, law, [character(len=name_length + 4) :: coordinates, &
                                  rates_of(coordinates)], kernel, effort, terms, other, slopes)
      if (allocated(other)) then
        if (.not. reader%status%failed()) call add_function(reader, p, other, on, slopes)
        return
      end if
    else
      terms%coefficients = [reader%read_real('coefficient')]
      powers = reader%read_integers('powers', size(coordinates))
      terms%powers = reshape(powers, [size(powers), 1])
    end if
    if (reader%status%failed()) return
    if (n + size(terms%coefficients) > max_monomials) then
      call reader%complain('force', '&force: all of them together must have at most ' &
                           //show(max_monomials)//' monomials')
      return
    end if
    if (n + size(terms%coefficients) > size(p%coefficient)) then
      call p%resize_monomials(2*(n + size(terms%coefficients)))
    end if
    do i = 1, size(terms%coefficients)
      powers = terms%powers(:, i)
      if (any(powers < 0) .or. sum(min(powers, max_degree + 1)) < 2 &
          .or. sum(min(powers, max_degree + 1)) > max_degree) then
        word = 'powers'
        if (reader%has('law')) word = 'law'
        call reader%complain(word, word//': powers must not be negative, and their sum 2 to ' &
                             //show(max_degree)//' (what is linear belongs to the stiffness, ' &
                             //'what is constant to the load)')
        return
      end if
      n = n + 1
      p%coefficient(n) = terms%coefficients(i)
      p%on(n) = on
      p%monomial_kernel(n) = kernel
      p%powers(:, n) = powers
    end do
    if (.not. reader%has('law')) return
    ! A law that names parameters is kept as it is written, so that they can be changed.
    if (reader%group%written('law', law) == law) call echo_monomials()

  contains

    !> The group once for each monomial; its end is still to come.
    subroutine echo_monomials()
      type(growing_text) :: text
      integer :: j, k
      do j = 1, size(terms%coefficients)
        if (j > 1) call text%add('/'//new_line('a'))
        call text%add('&force'//new_line('a')//"  on = '"//trim(coordinates(on)) &
                      //"'"//new_line('a')//'  kernel = '//show(kernel)//new_line('a') &
                      //'  coefficient = '//exact(terms%coefficients(j))//new_line('a') &
                      //'  powers =')
        do k = 1, size(powers)
          call text%add(' '//show(terms%powers(k, j)))
        end do
        call text%add(new_line('a'))
      end do
      reader%echo = text%text()
      if (size(terms%coefficients) == 0) reader%echo = '&force'//new_line('a') &
                                                       //"  on = '"//trim(coordinates(on))//"'" &
                                                       //new_line('a')//"  law = '0'" &
                                                       //new_line('a')
    end subroutine echo_monomials

  end subroutine read_force

  !> Add a law that has no monomials.
  subroutine add_function(reader, p, law, on, slopes)
    type(group_reader), intent(inout) :: reader
    type(polynomial_parameters), intent(inout) :: p
    type(law_term), intent(inout) :: law
    integer, intent(in) :: on
    real(wp), intent(in) :: slopes(:)
    type(law_term), allocatable :: laws(:)
    real(wp) :: zero(size(p%mass, 1), size(p%mass, 1))
    integer :: i, n

    n = size(p%mass, 1)
    law%equations = [on]
    law%weights = [1.0_wp]
    law%variables = [0]
    if (.not. allocated(p%laws)) allocate (p%laws(0))
    if (size(p%laws) >= max_laws) then
      call reader%complain('force', '&force: at most '//show(max_laws)//' may be no polynomials')
      return
    end if
    allocate (laws(size(p%laws) + 1))
    do i = 1, size(p%laws)
      laws(i) = p%laws(i)
    end do
    laws(size(laws)) = law
    call move_alloc(laws, p%laws)
    ! What is linear in it.
    zero = 0.0_wp
    zero(on, :) = slopes(:n)
    p%stiffness = reshape([p%stiffness, zero], [shape(zero), size(p%stiffness, 3) + 1])
    p%spring_kernel = [p%spring_kernel, law%kernel]
    p%damping(on, :) = p%damping(on, :) + slopes(n + 1:)
  end subroutine add_function

  !> Names of velocities.
  pure function rates_of(coordinates) result(names)
    character(len=name_length), intent(in) :: coordinates(:)
    character(len=name_length + 4) :: names(size(coordinates))
    integer :: i
    do i = 1, size(coordinates)
      names(i) = trim(coordinates(i))//'_dot'
    end do
  end function rates_of

end module viscovib_system_groups
