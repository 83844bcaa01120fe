!> The groups &element and &layer of a structure.
module viscovib_element_groups
  use viscovib_coordinate_names, only: read_kernel_place, some
  use viscovib_group_reader, only: group_reader
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_hysteresis_catalogue, only: new_hysteresis, order_numbers
  use viscovib_kinds, only: wp
  use viscovib_law_faults, only: compile_term, complain_of_law, read_law
  use viscovib_law_program, only: multiply, put_argument, put_number, subtract
  use viscovib_law_term, only: law_term
  use viscovib_matrix_groups, only: read_matrix
  use viscovib_namelist, only: lower
  use viscovib_polynomial, only: max_coordinates, max_degree
  use viscovib_polynomial_text, only: terms_type
  use viscovib_status, only: show
  use viscovib_structure_elements, only: element_type
  use viscovib_structure_model, only: structure_model
  use viscovib_structure_rest, only: is_symmetric
  use viscovib_subject, only: name_length
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: add_inner_coordinates, read_element, read_layer

  !> Largest number of steps of expanding a law.
  integer, parameter :: max_effort = 100000
  !> Eigenvalues below this part of the largest are 0.
  real(wp), parameter :: no_part = 1.0e-12_wp
  !> Slope of a fluid damper in series with a spring, in the linear subsystem, relative to rate r.
  real(wp), parameter :: least_slope = 1.0e-4_wp

contains

  !> One &element: [k d + law(d)] with a kernel or none, and c d', along a direction.
  subroutine read_element(reader, element, coordinates, n_kernels)
    type(group_reader), intent(inout) :: reader
    type(element_type), intent(out) :: element
    character(len=name_length), intent(in) :: coordinates(:)
    integer, intent(in) :: n_kernels
    character(len=name_length), allocatable :: on(:)
    character(len=:), allocatable :: law
    real(wp), allocatable :: weights(:)
    real(wp) :: slopes(2)
    type(law_term), allocatable :: other
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
    call read_law(reader, law, ['d', 'v'], element%kernel, effort, terms, other, slopes)
    if (allocated(other)) then
      element%laws = [other, element%laws]
      element%stiffness = element%stiffness + slopes(1)
      element%damping = element%damping + slopes(2)
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
      end if
      element%series = [series, c, a, 0.0_wp]
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

  !> A layer (1 - R*) K u as springs along the eigenvectors of K, which is the same.
  subroutine read_layer(reader, model, n_kernels)
    type(group_reader), intent(inout) :: reader
    !> Gets the springs.
    type(structure_model), intent(inout) :: model
    integer, intent(in) :: n_kernels
    type(element_type), allocatable :: springs(:)
    real(wp), allocatable :: matrix(:, :), unit(:, :), sizes(:), shapes(:, :)
    integer, allocatable :: touched(:), kept(:)
    integer :: i, kernel, m

    call read_matrix(reader, 'stiffness', .true., size(model%mass, 1), matrix)
    kernel = read_kernel_place(reader, n_kernels)
    if (reader%status%failed()) return
    if (model%is_reduced) then
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
    allocate (springs(size(kept)))
    do i = 1, size(kept)
      allocate (springs(i)%direction(size(matrix, 1)), source=0.0_wp)
      allocate (springs(i)%laws(0))
      springs(i)%direction(touched) = shapes(:, kept(i))
      springs(i)%stiffness = sizes(kept(i))
      springs(i)%kernel = kernel
    end do
    call append(model%elements, springs)
  end subroutine read_layer

  !> Add internal coordinates s of Maxwell elements with springs k and rates h(force) of dampers, so
  !! that the spring has the deflection s' + r s:
  !!
  !!   k s'' + k r s' + k h(s' + r s) = k d', force k (s' + r s).
  !!
  !! At rest h has no slope for exponents below 1, an infinite one above. A small one is added to
  !! the linear subsystem and taken from the law.
  subroutine add_inner_coordinates(reader, model, coordinates, units)
    type(group_reader), intent(inout) :: reader
    type(structure_model), intent(inout) :: model
    character(len=name_length), allocatable, intent(inout) :: coordinates(:), units(:)
    real(wp) :: e(size(model%mass, 1)), rate, softness, slopes(2)
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
    if (model%depends_on_speed()) then
      call widen(model%gyroscopic, m)
      call widen(model%circulatory, m)
      call widen(model%centrifugal, m)
    end if
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
        one%series(4) = rate
        one%across = one%direction
        model%mass(j, j) = k
        model%damping(:n, j) = k*e
        model%damping(j, :n) = -k*e
        model%damping(j, j) = k*rate
        model%stiffness(:n, j) = k*rate*e
        one%direction = 0.0_wp
        one%direction(j) = 1.0_wp
        associate (c => one%series(2), a => one%series(3))
          if (abs(a - 1.0_wp) > 0.0_wp) then
            q = '(v + '//show(rate)//'*d)'
            q = show(k)//'*sign'//q//'*abs('//show(k)//'*'//q//'/'//show(c)//')^'//show(1.0_wp/a)
            one%laws = [law_term()]
            call compile_term(one%laws(1), q, ['d', 'v'], one%kernel, slopes, fault)
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

  end subroutine add_inner_coordinates

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

end module viscovib_element_groups
