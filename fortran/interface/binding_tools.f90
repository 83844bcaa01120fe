! Optimize: -O1
!> Tools for tasks: create systems from arrays, and convert a status to a number and a message.
module viscovib_binding_tools
  use, intrinsic :: iso_c_binding, only: c_char, c_int
  use viscovib_body_vector, only: body_from_vector
  use viscovib_catalogue, only: kernel_none, new_kernel
  use viscovib_compliance, only: push_type
  use viscovib_frequency_law, only: frequency_law, new_frequency_law
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_mount, only: mount_parameters, mount_type, new_mount
  use viscovib_number_reader, only: number_reader
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum, only: new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_static_form, only: new_static_form
  use viscovib_status, only: clipped, fail, one_line, set_ok, status_input_error, status_type
  use viscovib_structure, only: structure_type
  use viscovib_system_vector, only: polynomial_from_vector
  use viscovib_turning_body, only: turning_body
  implicit none
  private

  public :: make_load, make_pendulum, make_system, read_formulas, report, to_complex

  character, parameter :: nl = new_line('a')

  !> Length of the vector of a mount: mass, inertia, offset, stiffness_x, stiffness_phi, damping (4,
  !! column-major), cubic_scale, memory_scale, geometry.
  integer, parameter, public :: mount_length = 12
  !> Kernel kind of the rotation that means "the same as in x".
  integer, parameter, public :: kernel_as_x = -1
  !> Kernel kind in x that means "a polynomial system, whose vector contains all its kernels".
  integer, parameter, public :: kernels_in_vector = -2
  !> Same for a condensed structure, whose vector also contains its loads.
  integer, parameter, public :: structure_in_vector = -3
  !> Same for a body with finite rotations.
  integer, parameter, public :: body_in_vector = -4

contains

  !> Create an oscillator: a mount and its two kernels, a polynomial system, a structure or a body.
  subroutine make_system(system, flat, kind_x, data_x, kind_phi, data_phi, status)
    class(oscillator_type), allocatable, intent(out) :: system
    real(wp), intent(in) :: flat(:), data_x(:), data_phi(:)
    integer, intent(in) :: kind_x, kind_phi
    type(status_type), intent(out) :: status
    type(mount_type), allocatable :: mount
    type(polynomial_type), allocatable :: polynomial
    type(structure_type), allocatable :: structure
    type(turning_body), allocatable :: body

    if (kind_x == body_in_vector) then
      allocate (body)
      call body_from_vector(body, flat, status)
      call move_alloc(body, system)
    else if (kind_x == structure_in_vector) then
      allocate (structure)
      call structure_from_vector(structure, flat, status)
      call move_alloc(structure, system)
    else if (kind_x == kernels_in_vector) then
      allocate (polynomial)
      call polynomial_from_vector(polynomial, flat, status)
      call move_alloc(polynomial, system)
    else if (size(flat) == mount_length) then
      allocate (mount)
      call make_mount(mount, flat, kind_x, data_x, kind_phi, data_phi, status)
      call move_alloc(mount, system)
    else
      call fail(status, status_input_error, 'system', 'system: not a mount')
    end if
  end subroutine make_system

  subroutine make_mount(mount, flat, kind_x, data_x, kind_phi, data_phi, status)
    type(mount_type), intent(out) :: mount
    real(wp), intent(in) :: flat(mount_length), data_x(:), data_phi(:)
    integer, intent(in) :: kind_x, kind_phi
    type(status_type), intent(out) :: status
    type(mount_parameters) :: parameters
    type(kernel_holder) :: kernels(2)
    integer :: n

    parameters%mass = flat(1)
    parameters%inertia = flat(2)
    parameters%offset = flat(3)
    parameters%stiffness_x = flat(4)
    parameters%stiffness_phi = flat(5)
    parameters%damping = reshape(flat(6:9), [2, 2])
    parameters%cubic_scale = flat(10)
    parameters%memory_scale = flat(11)
    parameters%geometry = nint(flat(12))
    n = 0
    if (kind_x /= kernel_none) then
      n = n + 1
      call new_kernel(kernels(n)%kernel, kind_x, data_x, status)
      if (status%failed()) return
      parameters%kernel_x = n
    end if
    if (kind_phi == kernel_as_x) then
      parameters%kernel_phi = parameters%kernel_x
    else if (kind_phi /= kernel_none) then
      n = n + 1
      call new_kernel(kernels(n)%kernel, kind_phi, data_phi, status)
      if (status%failed()) return
      parameters%kernel_phi = n
    end if
    call new_mount(mount, parameters, kernels(:n), status)
  end subroutine make_mount

  subroutine make_pendulum(pendulum, flat, status)
    type(pendulum_type), intent(out) :: pendulum
    !> e, w2, w3, alpha, c1..c3, f0, m01, m02, p1..p3, equations.
    real(wp), intent(in) :: flat(14)
    type(status_type), intent(out) :: status
    call new_pendulum(pendulum, &
                      pendulum_parameters(e=flat(1), w2=flat(2), w3=flat(3), alpha=flat(4), &
                                          damping=flat(5:7), load=flat(8:10), &
                                          frequency=flat(11:13), equations=nint(flat(14))), status)
  end subroutine make_pendulum

  !> Rows of `series`: forces on the coordinates, followed by the base motion.
  subroutine make_load(load, orders, series, formulas, status)
    type(load_type), intent(out) :: load
    !> A term of order k, or -1 - k: what the base moves each coordinate by, or -k - 10^6 i: forces
    !! multiplied by formula i.
    integer, intent(in) :: orders(:)
    complex(wp), intent(in) :: series(:, :)
    !> Functions of the frequency nu, one per line.
    character(len=*), intent(in) :: formulas
    type(status_type), intent(out) :: status
    integer, parameter :: per_formula = 1000000
    complex(wp), dimension(size(series, 1) - 1, size(orders)) :: force, moved
    type(frequency_law), allocatable :: laws(:)
    integer :: places(size(orders)), law_of(size(orders)), j, n

    call read_formulas(formulas, laws, status)
    if (status%failed()) return
    n = size(series, 1) - 1
    force = (0.0_wp, 0.0_wp)
    moved = (0.0_wp, 0.0_wp)
    law_of = 0
    do j = 1, size(orders)
      if (orders(j) <= -per_formula) then
        force(:, j) = series(:n, j)
        law_of(j) = -(orders(j)/per_formula)
        places(j) = mod(-orders(j), per_formula)
        if (law_of(j) > size(laws)) call fail(status, status_input_error, 'orders', &
                                              'orders: a term has no formula')
      else if (orders(j) < 0) then
        moved(:, j) = series(:n, j)
        places(j) = -1 - orders(j)
      else
        force(:, j) = series(:n, j)
        places(j) = orders(j)
      end if
    end do
    if (status%failed()) return
    call new_load(load, n, places, force, series(n + 1, :), status, moved, laws, law_of)
  end subroutine make_load

  !> Compile functions of the frequency, one per line.
  subroutine read_formulas(formulas, laws, status)
    character(len=*), intent(in) :: formulas
    type(frequency_law), allocatable, intent(out) :: laws(:)
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: fault
    integer :: first, i, last

    call set_ok(status)
    allocate (laws(count([(formulas(i:i) == nl, i=1, len(formulas))])))
    first = 1
    do i = 1, size(laws)
      last = first + index(formulas(first:), nl) - 2
      call new_frequency_law(laws(i), formulas(first:last), fault)
      if (fault /= '') then
        call fail(status, status_input_error, 'load', "load: '"//clipped(formulas(first:last)) &
                  //"': "//fault)
        return
      end if
      first = last + 2
    end do
  end subroutine read_formulas

  !> Complex harmonics from alternating real and imaginary parts.
  pure subroutine to_complex(x, coefficients)
    !> Shape (2 n_orders n_dof, n).
    real(wp), intent(in) :: x(:, :)
    !> Shape (n_orders, n_dof, n).
    complex(wp), intent(out) :: coefficients(:, :, :)
    integer :: d, i, k, j
    do i = 1, size(coefficients, 3)
      do d = 1, size(coefficients, 2)
        do k = 1, size(coefficients, 1)
          j = 2*(k + size(coefficients, 1)*(d - 1))
          coefficients(k, d, i) = cmplx(x(j - 1, i), x(j, i), wp)
        end do
      end do
    end do
  end subroutine to_complex

  !> Category of a status. The message of a failure is kept for this thread (`last_message`).
  subroutine report(outcome, status)
    type(status_type), intent(in) :: outcome
    integer, intent(out) :: status
    character(len=:), allocatable :: text
    interface
      subroutine keep_message(text, n) bind(c, name='viscovib_keep_message')
        import :: c_char, c_int
        character(kind=c_char), intent(in) :: text(*)
        integer(c_int), value :: n
      end subroutine keep_message
    end interface
    status = outcome%category
    if (.not. outcome%failed()) return
    text = one_line(outcome%message)
    call keep_message(text, len(text))
  end subroutine report

  ! Conversion of a vector of numbers to a condensed structure:
  !
  !   coordinates q, real modes m, complex modes p, load harmonics; squares (m); rates (m); losses
  !   (m); seen (m q); pushed (m q); poles (p); left (p q); right (p q); flexibility and
  !   flexibility_rate (q^2 each); number n of uncondensed coordinates (0: none), their mass,
  !   damping and stiffness (n^2 each), and directions of the coordinates (n q); for each harmonic:
  !   order; for forces and base: push on real modes (m), on complex modes (p), flexible deflections
  !   (q) and their rates (q); number of forces that depend on the frequency, and of each the push,
  !   and the length, instructions and numbers of its law; then laws, linear stiffness of elements
  !   with a kernel, and kernels as a polynomial system (`viscovib_system_vector`), whose mass is a
  !   weight.
  !
  ! Poles, left, right and loads are complex: two numbers each. Arrays are in column-major order.

  subroutine structure_from_vector(system, vector, status)
    type(structure_type), intent(out) :: system
    real(wp), intent(in) :: vector(:)
    type(status_type), intent(out) :: status
    type(number_reader) :: next
    logical :: singular
    integer :: i, j, m, n, p, q

    call next%start(vector, 4, 'structure', status)
    if (status%failed()) return
    q = next%whole()
    m = next%whole()
    p = next%whole()
    allocate (system%loads(next%whole()))
    associate (rest => system%rest)
      rest%squares = next%row(m)
      rest%rates = next%row(m)
      rest%losses = next%row(m)
      rest%seen = next%matrix(m, q)
      rest%pushed = next%matrix(m, q)
      rest%poles = next%pairs(p)
      rest%left = next%pair_matrix(p, q)
      rest%right = next%pair_matrix(p, q)
      rest%flexibility = next%matrix(q, q)
      rest%flexibility_rate = next%matrix(q, q)
      call rest%complete()
    end associate
    call new_static_form(system%static, system%rest, singular)
    if (singular) then
      call fail(status, status_input_error, 'elements', 'elements: the coordinates they act on ' &
                //'see too few modes of the structure to be independent (more elements than ' &
                //'modes?)')
      return
    end if
    do j = 1, size(system%loads)
      associate (load => system%loads(j))
        load%order = next%whole()
        call next_push(load%force)
        call next_push(load%base)
        load%at_rest = 0.0_wp*load%force%flexible
        if (load%order == 0) then
          if (.not. system%static%is_held(load%force)) then
            call fail(status, status_input_error, 'load', 'load[0]: its mean acts on a rigid ' &
                      //'body without support: there is no static equilibrium')
            return
          end if
          call load%find_at_rest(system%static, system%rest)
        end if
        load%has_force = is_set(load%force)
        load%moves_base = is_set(load%base)
        allocate (load%varying(next%whole()))
        do i = 1, size(load%varying)
          call next_push(load%varying(i)%push)
          associate (law => load%varying(i)%law%program)
            n = next%whole()
            law%n_arguments = 1
            law%code = nint(next%row(n))
            law%number = next%row(n)
            call law%measure()
          end associate
        end do
      end associate
    end do
    call polynomial_from_vector(system%polynomial_type, next%row(next%count_left()), status)
    system%condensed = .true.

  contains

    pure logical function is_set(push)
      type(push_type), intent(in) :: push
      is_set = any(abs(push%modes) > 0.0_wp) .or. any(abs(push%poles) > 0.0_wp) &
               .or. any(abs(push%flexible) > 0.0_wp)
    end function is_set

    subroutine next_push(push)
      type(push_type), intent(out) :: push
      push%modes = next%pairs(m)
      push%poles = next%pairs(p)
      push%flexible = next%pairs(q)
      push%flexible_rate = next%pairs(q)
      call system%rest%complete_push(push)
    end subroutine next_push

  end subroutine structure_from_vector

end module viscovib_binding_tools
