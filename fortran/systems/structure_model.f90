!> A structure as defined by the user: matrices, elements and loads. It is condensed to the
!! deflections of its elements, and solutions are expanded to all coordinates.
module viscovib_structure_model
  use viscovib_compliance, only: push_type
  use viscovib_dense, only: factorize, invert, solve
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_polynomial, only: max_coordinates, new_polynomial, polynomial_parameters
  use viscovib_resonant_compliance, only: bordered, near_modes
  use viscovib_speed_matrices, only: speed_matrices
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_structure, only: few_coordinates, structure_type, varying_push
  use viscovib_structure_elements, only: add_elements, element_type, find_directions, &
    put_laws
  use viscovib_structure_rest, only: modal_damping, new_rest, rest_type
  use viscovib_structure_supports, only: new_supports, structure_supports
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: structure_model, condense, set_rest, put_load, expand, add_linear

  !> Largest number of monomials of all elements.
  integer, parameter :: most_terms = 20000
  !> Relative deflections by a rigid body, and unsupported loads, that are rounding errors.
  real(wp), parameter :: unseen = 1.0e-10_wp, unheld = 1.0e-9_wp
  !> Largest number of coordinates for keeping the matrices if modes are complex.
  integer, parameter :: most_few = 24
  !> Largest entry of matrices, and of factors and elements.
  real(wp), parameter :: largest = 1.0e40_wp, largest_factor = 1.0e20_wp

  type, extends(speed_matrices) :: structure_model
    !> M, C and K without elements, shape (n, n); observed coordinates in terms of all coordinates,
    !! shape (n_places, n): shapes of a reduced structure, otherwise the unit matrix.
    real(wp), allocatable :: mass(:, :), damping(:, :), stiffness(:, :), places(:, :)
    type(modal_damping) :: modal
    !> True if the observed coordinates are only a part of those that the reduced model represents.
    logical :: is_reduced = .false.
    !> Displacement of observed coordinates per unit base displacement, shape (n_places).
    real(wp), allocatable :: base_direction(:)
    !> Forces of supports that were removed from the matrices; its arrays are not allocated: none.
    type(structure_supports) :: supports
    type(element_type), allocatable :: elements(:)
    !> Number of elements that are not parts of layers; -1: the user has defined another system.
    integer :: n_given = -1
    !> Results: directions (n_places, q), linear subsystem, loads on observed coordinates,
    !! (n_places, n_loads), and base motion (n_loads) by order.
    real(wp), allocatable :: directions(:, :)
    type(rest_type) :: rest
    type(load_type) :: load
    !> Order 0: inverse of the bordered matrix of deflections and rigid bodies, and the rigid bodies
    !! in terms of the modes of zero frequency.
    real(wp), allocatable, private :: held(:, :), turn(:, :)
  contains
    procedure :: description
    procedure :: all_damping
    procedure :: inertia
    procedure :: fix_damping
    procedure :: hold
    procedure :: set_speed
    procedure :: check_sizes
    procedure, private :: at_rest
  end type structure_model

contains

  !> M b of a base that moves the coordinates by b.
  pure function inertia(self)
    class(structure_model), intent(in) :: self
    real(wp) :: inertia(size(self%base_direction))
    inertia = 0.0_wp
    if (any(abs(self%base_direction) > 0.0_wp)) inertia = matmul(self%mass, self%base_direction)
  end function inertia

  !> Keep the free coordinates of a structure with supports, relative to the base.
  subroutine hold(self, free, held, status)
    class(structure_model), intent(inout) :: self
    integer, intent(in) :: free(:), held(:)
    type(status_type), intent(out) :: status
    real(wp), dimension(size(self%mass, 1), size(self%mass, 1), 3) :: matrices
    real(wp) :: moved(size(self%mass, 1))
    integer :: i

    matrices(:, :, 1) = self%mass
    call add_linear(self, matrices(:, :, 3), matrices(:, :, 2))
    call new_supports(self%supports, matrices, self%elements, free, held, self%base_direction, &
                      moved, status)
    if (.not. status%failed()) then
      matrices(:, :, 2) = self%damping
      matrices(:, :, 3) = self%stiffness
      associate (rows => self%supports%rows)
        rows%free = matrices(held, free, :)
        rows%held = matrices(held, held, :)
        allocate (rows%based(size(held), 3))
        do i = 1, 3
          rows%based(:, i) = matmul(matrices(held, :, i), moved)
        end do
      end associate
    end if
    if (self%depends_on_speed() .and. .not. status%failed()) then
      self%supports%are_turned = any(abs(self%gyroscopic(free, held)) > 0.0_wp .or. &
                                     abs(self%circulatory(free, held)) > 0.0_wp .or. &
                                     abs(self%centrifugal(free, held)) > 0.0_wp)
      if (self%supports%are_turned .and. any(abs(moved) > 0.0_wp)) then
        call fail(status, status_input_error, 'base_direction', 'base_direction: must be 0 where ' &
                  //'gyroscopic, circulatory or centrifugal act on supports')
      end if
      allocate (self%supports%turning(size(held), size(free), 3))
      self%supports%turning(:, :, 1) = self%gyroscopic(held, free)
      self%supports%turning(:, :, 2) = self%circulatory(held, free)
      self%supports%turning(:, :, 3) = self%centrifugal(held, free)
      self%speed_matrices = self%matrices_of(free)
    end if
    if (status%failed()) return
    do i = 1, size(self%elements)
      associate (one => self%elements(i))
        one%ends = one%direction(held)
        one%direction = one%direction(free)
        if (allocated(one%across)) one%across = one%across(free)
      end associate
    end do
    self%base_direction = moved(free)
    self%mass = self%mass(free, free)
    self%damping = self%damping(free, free)
    self%stiffness = self%stiffness(free, free)
    self%places = self%places(free, free)
  end subroutine hold

  !> Replace the damping of modes by a damping matrix, that at rest. The modes are those of the
  !! coordinates that are not internal to an element; the internal coordinates are the last ones.
  subroutine fix_damping(self, status)
    class(structure_model), intent(inout) :: self
    type(status_type), intent(out) :: status
    type(structure_model) :: plain
    real(wp), allocatable :: stiffness(:, :), damping(:, :), squares(:), shapes(:, :)
    integer :: i, n

    call set_ok(status)
    if (.not. any(abs([self%modal%ratios, self%modal%rayleigh]) > 0.0_wp)) return
    n = size(self%mass, 1) - count(self%elements%series(1) > 0.0_wp)
    plain%mass = self%mass(:n, :n)
    plain%stiffness = self%stiffness(:n, :n)
    plain%damping = 0.0_wp*plain%mass
    plain%places = self%places(:n, :n)
    plain%elements = pack(self%elements, .not. self%elements%series(1) > 0.0_wp)
    do i = 1, size(plain%elements)
      plain%elements(i)%direction = plain%elements(i)%direction(:n)
    end do
    allocate (stiffness(n, n), damping(n, n), shapes(n, n), squares(n))
    call add_linear(plain, stiffness, damping)
    damping = self%modal%rayleigh(1)*plain%mass + self%modal%rayleigh(2)*stiffness
    if (any(abs(self%modal%ratios) > 0.0_wp)) then
      if (any([(.not. plain%mass(i, i) > 0.0_wp, i=1, n)])) then
        call fail(status, status_input_error, 'modal_damping', 'modal_damping: not for ' &
                  //'coordinates without mass, with series_stiffness of an &element or matrices ' &
                  //'that depend on the speed')
        return
      end if
      call find_symmetric_modes(plain%mass, stiffness, squares, shapes)
      squares = 2.0_wp*self%modal%ratios(:n)*sqrt(max(squares, 0.0_wp))
      shapes = matmul(plain%mass, shapes)
      damping = damping + matmul(shapes*spread(squares, 1, n), transpose(shapes))
    end if
    self%damping(:n, :n) = self%damping(:n, :n) + damping
    self%modal%ratios = 0.0_wp*self%modal%ratios
    self%modal%rayleigh = 0.0_wp
  end subroutine fix_damping

  !> Fix the speed: the matrices become constant. The damping of modes is that at rest.
  subroutine set_speed(self, speed, status)
    class(structure_model), intent(inout) :: self
    !> rad/s.
    real(wp), intent(in) :: speed
    type(status_type), intent(out) :: status

    call self%fix_damping(status)
    if (status%failed()) return
    self%damping = self%damping + speed*self%gyroscopic
    self%stiffness = self%stiffness + speed*(self%circulatory + speed*self%centrifugal)
    if (allocated(self%supports%turning)) then
      associate (rows => self%supports%rows, turning => self%supports%turning)
        turning(:, :, 2) = speed*(turning(:, :, 2) + speed*turning(:, :, 3))
        turning(:, :, 1) = speed*turning(:, :, 1)
        rows%free(:, :, 2:) = rows%free(:, :, 2:) + turning(:, :, :2)
        rows%based(:, 2) = rows%based(:, 2) + matmul(turning(:, :, 1), self%base_direction)
        rows%based(:, 3) = rows%based(:, 3) + matmul(turning(:, :, 2), self%base_direction)
      end associate
      deallocate (self%supports%turning)
    end if
    call self%drop_matrices()
  end subroutine set_speed

  !> Condense the structure, without loads.
  subroutine condense(model, kernels, system, status)
    type(structure_model), intent(inout) :: model
    type(kernel_holder), intent(in) :: kernels(:)
    type(structure_type), intent(out) :: system
    type(status_type), intent(out) :: status
    type(polynomial_parameters) :: p
    real(wp), dimension(size(model%mass, 1), size(model%mass, 1)) :: stiffness, damping, low
    real(wp), allocatable :: weights(:)
    integer :: a, q

    call model%check_sizes(status)
    if (status%failed()) return
    call add_linear(model, stiffness, damping, low)
    call new_rest(model%rest, model%mass, damping, stiffness, model%places, model%modal, status, &
                  low)
    if (status%failed()) return
    call find_directions(model%elements, size(model%places, 1), model%directions)
    call model%rest%refuse_on_idle(model%directions, 'element', '&element: a law or a kernel', &
                                   status)
    q = size(model%directions, 2)
    if (q > max_coordinates) then
      call fail(status, status_input_error, 'element', '&element: '//show(q)//' deflections that ' &
                //'are nonlinear or remember, must be at most '//show(max_coordinates))
    end if
    if (status%failed()) return
    call put_laws(model%elements, q, size(kernels), p)
    if (size(p%coefficient) > most_terms) then
      call fail(status, status_input_error, 'element', '&element: '//show(size(p%coefficient)) &
                //' monomials, must be at most '//show(most_terms))
      return
    end if
    call set_rest(model, system, stiffness, weights, status)
    if (status%failed()) return
    allocate (p%mass(q, q), p%damping(q, q), source=0.0_wp)
    do a = 1, q
      p%mass(a, a) = weights(a)
    end do
    p%base_direction = matmul(model%base_direction, model%directions)
    call new_polynomial(system%polynomial_type, p, kernels, status)
    system%condensed = .true.
    allocate (system%loads(0))
  end subroutine condense

  !> Set the linear subsystem of the condensed system from the modes.
  subroutine set_rest(model, system, stiffness, weights, status)
    type(structure_model), intent(inout) :: model
    type(structure_type), intent(inout) :: system
    !> Including the linear parts of elements, shape (n, n).
    real(wp), intent(in) :: stiffness(:, :)
    !> H tends to 1/(weight s^2) at high frequency, shape (q).
    real(wp), allocatable, intent(out) :: weights(:)
    type(status_type), intent(out) :: status
    real(wp), allocatable :: seen(:, :)
    integer :: a, q

    q = size(model%directions, 2)
    seen = matmul(transpose(model%rest%shapes), model%directions)
    associate (rest => system%rest, modes => model%rest)
      rest%squares = modes%squares
      rest%rates = modes%rates
      rest%losses = modes%losses*modes%squares
      rest%seen = seen
      rest%pushed = seen
      rest%poles = modes%poles
      rest%left = matmul(transpose(modes%left), model%directions)
      rest%right = matmul(transpose(modes%right), model%directions)
      allocate (rest%flexibility(q, q), rest%flexibility_rate(q, q), source=0.0_wp)
      allocate (weights(q))
      weights = sum(seen**2, 1)
      do a = 1, q
        weights(a) = weights(a) + real(sum(rest%left(:, a)*rest%right(:, a)*rest%poles))
      end do
      where (weights > 0.0_wp)
        weights = 1.0_wp/weights
      else where
        weights = 1.0_wp
      end where
    end associate
    call find_static(model, system, status)
    if (status%failed()) return
    call system%rest%complete()
    if (size(model%rest%poles) > 0 .and. size(model%mass, 1) <= most_few &
        .and. .not. any(model%rest%idle)) then
      call keep_matrices(model, model%all_damping(), stiffness, system%few)
    end if
  end subroutine set_rest

  !> Keep the uncondensed matrices, scaled to unit masses.
  subroutine keep_matrices(model, damping, stiffness, few)
    type(structure_model), intent(in) :: model
    real(wp), intent(in) :: damping(:, :), stiffness(:, :)
    type(few_coordinates), intent(out) :: few
    complex(wp) :: inverse(size(damping, 1), size(damping, 1))
    real(wp) :: left(size(damping, 1), size(damping, 1)), unit(size(damping, 1))
    logical :: singular
    integer :: a

    call invert(cmplx(model%mass, 0.0_wp, wp), inverse, singular)
    if (singular) return
    unit = [(sqrt(model%mass(a, a)), a=1, size(unit))]
    do a = 1, size(unit)
      left(a, :) = unit(a)*real(inverse(a, :))
    end do
    few%damping = matmul(left, damping)
    few%stiffness = matmul(left, stiffness)
    few%seen = matmul(transpose(model%places), model%directions)
    few%pushed = matmul(left, few%seen)
    do a = 1, size(unit)
      few%damping(:, a) = few%damping(:, a)/unit(a)
      few%stiffness(:, a) = few%stiffness(:, a)/unit(a)
      few%seen(a, :) = few%seen(a, :)/unit(a)
    end do
  end subroutine keep_matrices

  !> Check that squares and products of all numbers do not overflow.
  subroutine check_sizes(model, status)
    class(structure_model), intent(in) :: model
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: name
    integer :: i

    call set_ok(status)
    name = ''
    if (maxval(abs(model%modal%ratios)) > largest_factor) name = 'modal_damping'
    if (maxval(abs(model%modal%rayleigh)) > largest_factor) name = 'rayleigh'
    if (abs(model%modal%loss) > largest_factor) name = 'loss_factor'
    if (name /= '') then
      call fail(status, status_input_error, name, name//': must be at most '//show(largest_factor))
      return
    end if
    if (maxval(abs(model%damping)) > largest) name = 'damping'
    if (maxval(abs(model%stiffness)) > largest) name = 'stiffness'
    if (maxval(abs(model%mass)) > largest) name = 'mass'
    if (maxval(abs(model%places)) > largest_factor) name = 'shapes'
    if (maxval(abs(model%base_direction)) > largest_factor) name = 'base_direction'
    do i = 1, size(model%elements)
      associate (one => model%elements(i))
        if (max(maxval(abs(one%direction)), abs(one%stiffness), abs(one%damping), &
                maxval(abs(one%powers))) > largest_factor) name = 'element'
      end associate
    end do
    if (name /= '') call fail(status, status_input_error, name, name//': all of its numbers must ' &
                              //'be at most '//show(merge(largest_factor, largest, &
                                                          any(name == [character(len=14) :: &
                                                                       'shapes', 'element', &
                                                                       'base_direction']))))
    do i = 1, size(model%mass, 1)
      if (any(abs(model%mass(:, i)) > 0.0_wp) .and. name == '' &
          .and. model%mass(i, i) < 1.0_wp/largest) then
        call fail(status, status_input_error, 'mass', 'mass: must be at least ' &
                  //show(1.0_wp/largest)//' of each coordinate')
        return
      end if
    end do
  end subroutine check_sizes

  !> K and C including the linear parts of elements.
  pure subroutine add_linear(model, stiffness, damping, low)
    type(structure_model), intent(in) :: model
    real(wp), intent(out) :: stiffness(:, :), damping(:, :)
    !> As in `add_elements`.
    real(wp), intent(out), optional :: low(:, :)

    stiffness = model%stiffness
    damping = model%damping
    call add_elements(model%elements, model%places, stiffness, damping, low)
  end subroutine add_linear

  !> C including the dampers of elements and Rayleigh damping.
  function all_damping(self) result(damping)
    class(structure_model), intent(in) :: self
    real(wp), dimension(size(self%mass, 1), size(self%mass, 1)) :: damping, stiffness
    call add_linear(self, stiffness, damping)
    damping = damping + self%modal%rayleigh(1)*self%mass + self%modal%rayleigh(2)*stiffness
  end function all_damping

  !> Static limit of H^-1: y = elastic h + seen eta, 0 = seen^T h + loads on rigid bodies, with
  !! forces h and rigid-body displacements eta.
  subroutine find_static(model, system, status)
    type(structure_model), intent(inout) :: model
    type(structure_type), intent(inout) :: system
    type(status_type), intent(out) :: status
    real(wp), allocatable :: border(:, :), bodies(:, :), gram(:, :), sizes(:), unit(:, :)
    integer, allocatable :: pivots(:)
    integer :: a, b, i, m, q
    logical :: singular

    call set_ok(status)
    associate (rest => system%rest)
      q = size(model%directions, 2)
      bodies = model%rest%shapes(:, pack([(i, i=1, size(rest%squares))], .not. &
                                         abs(rest%squares) > 0.0_wp))
      m = size(bodies, 2)
      gram = matmul(transpose(model%directions), bodies)
      where (abs(gram) <= unseen*matmul(transpose(abs(model%directions)), abs(bodies)))
        gram = 0.0_wp
      end where
      allocate (sizes(m), unit(m, m), model%turn(m, m))
      unit = 0.0_wp
      do i = 1, m
        unit(i, i) = 1.0_wp
      end do
      bodies = gram
      if (m > 0) call find_symmetric_modes(unit, matmul(transpose(gram), gram), sizes, model%turn)
      ! Order rigid bodies without deflections last.
      a = count(sizes <= 1.0e-13_wp*maxval([sizes, 0.0_wp]))
      model%turn = cshift(model%turn, a, 2)
      m = m - a
      bodies = matmul(bodies, model%turn(:, :m))
      allocate (border(q + m, q + m), pivots(q + m))
      border = 0.0_wp
      do b = 1, q
        do a = 1, q
          border(a, b) = sum(rest%seen(:, a)*rest%seen(:, b)/rest%squares, &
                             abs(rest%squares) > 0.0_wp) &
                         - real(sum(rest%left(:, a)*rest%right(:, b)/rest%poles))
        end do
      end do
      border(:q, q + 1:) = bodies
      border(q + 1:, :q) = transpose(bodies)
      call factorize(q + m, border, pivots, singular)
      allocate (model%held(q + m, q + m), source=0.0_wp)
      if (singular) then
        call fail(status, status_input_error, 'element', '&element: the deflections see too few ' &
                  //'modes of the structure to be independent')
        return
      end if
      do i = 1, q + m
        model%held(i, i) = 1.0_wp
        call solve(q + m, border, pivots, model%held(:, i))
      end do
      rest%stiffness_at_rest = model%held(:q, :q)
    end associate
  end subroutine find_static

  !> Set the loads on observed coordinates and the equivalent loads on the condensed coordinates.
  subroutine put_load(model, load, in_time, system, condensed, status)
    type(structure_model), intent(inout) :: model
    type(load_type), intent(in) :: load
    !> True for integration in time, which needs no static equilibrium.
    logical, intent(in) :: in_time
    type(structure_type), intent(inout) :: system
    !> It only defines the orders and the base motion.
    type(load_type), intent(out) :: condensed
    type(status_type), intent(out) :: status
    complex(wp), allocatable :: force(:, :), push(:), pole(:), eta(:)
    real(wp), allocatable :: inertia(:)
    complex(wp) :: nothing(size(model%directions, 2))
    integer :: j, n

    call model%rest%refuse_on_idle(reshape(merge(1.0_wp, 0.0_wp, load%touches()), &
                                           [size(load%force, 1), 1]), 'load', '&load: it', status)
    if (status%failed()) return
    if (load%has_table()) then
      call model%rest%refuse_on_idle(load%pushes, 'load', '&load: it', status)
      if (status%failed()) return
    end if
    model%load = load
    n = size(load%orders)
    nothing = (0.0_wp, 0.0_wp)
    allocate (inertia, source=model%inertia())
    deallocate (system%loads)
    allocate (system%loads(n), force(size(nothing), n))
    do j = 1, n
      associate (own => system%loads(j))
        own%order = load%orders(j)
        call set_push(load%force(:, j), push, pole)
        own%force%modes = push
        own%force%poles = pole
        own%at_rest = nothing
        if (own%order == 0 .and. .not. in_time) then
          call model%at_rest(system, nothing, push, pole, own%at_rest, eta, status)
          if (status%failed()) return
          own%at_rest = -own%at_rest
        end if
        own%has_force = any(abs(load%force(:, j)) > 0.0_wp)
        call set_push(inertia*load%base(j), own%base%modes, own%base%poles)
        own%moves_base = any(abs(own%base%modes) > 0.0_wp) .or. any(abs(own%base%poles) > 0.0_wp)
        call complete(own%force)
        call complete(own%base)
        own%varying = varying_pushes(j)
        force(:, j) = merge((0.0_wp, 1.0_wp), (1.0_wp, 0.0_wp), own%order == 0)
      end associate
    end do
    call new_load(condensed, size(nothing), load%orders, force, load%base, status)
    condensed%n_zero = load%n_zero
    ! Their frequencies are checked; the forces themselves are in the system.
    condensed%varying = load%varying
    do j = 1, size(condensed%varying)
      condensed%varying(j)%force = nothing
    end do

  contains

    !> Forces of one order that depend on the frequency, in modes.
    function varying_pushes(place) result(pushes)
      integer, intent(in) :: place
      type(varying_push), allocatable :: pushes(:)
      integer :: i, k
      allocate (pushes(count(load%varying%place == place)))
      k = 0
      do i = 1, size(load%varying)
        if (load%varying(i)%place /= place) cycle
        k = k + 1
        pushes(k)%law = load%varying(i)%law
        call set_push(load%varying(i)%force, pushes(k)%push%modes, pushes(k)%push%poles)
        call complete(pushes(k)%push)
      end do
    end function varying_pushes

    subroutine complete(one)
      type(push_type), intent(inout) :: one
      one%flexible = nothing
      one%flexible_rate = nothing
      call system%rest%complete_push(one)
    end subroutine complete

    subroutine set_push(forces, modes, poles)
      complex(wp), intent(in) :: forces(:)
      complex(wp), allocatable, intent(out) :: modes(:), poles(:)
      modes = matmul(forces, model%rest%shapes)
      poles = matmul(forces, model%rest%right)
    end subroutine set_push

  end subroutine put_load

  !> Static forces h at given deflections, and rigid-body displacements. For zero deflections, h is
  !! the negative effective load.
  subroutine at_rest(self, system, y, push, pole, h, eta, status)
    class(structure_model), intent(in) :: self
    type(structure_type), intent(in) :: system
    !> Deflections (q); the load on real and on complex modes.
    complex(wp), intent(in) :: y(:), push(:), pole(:)
    complex(wp), intent(out) :: h(:)
    complex(wp), allocatable, intent(out) :: eta(:)
    type(status_type), intent(out) :: status
    complex(wp), allocatable :: right(:), bodies(:), found(:)
    integer :: i, m, q

    call set_ok(status)
    q = size(y)
    m = size(self%held, 1) - q
    associate (rest => self%rest)
      bodies = matmul(pack(push, .not. abs(rest%squares) > 0.0_wp), self%turn)
      if (norm2(abs(bodies(m + 1:))) > unheld*norm2(abs(bodies))) then
        call fail(status, status_input_error, 'load', '&load: its mean (order 0) acts on a rigid ' &
                  //'body without support: there is no static equilibrium')
        return
      end if
      allocate (right(q + m))
      do i = 1, q
        right(i) = y(i) - sum(system%rest%seen(:size(push), i)*push/rest%squares, &
                              abs(rest%squares) > 0.0_wp) &
                   + sum(system%rest%left(:, i)*pole/rest%poles)
      end do
      right(q + 1:) = -bodies(:m)
    end associate
    found = matmul(self%held, right)
    h = found(:q)
    eta = matmul(self%turn(:, :m), found(q + 1:))
  end subroutine at_rest

  !> Harmonics of observed coordinates from those of the deflections: U_k = D_k^-1 (P_k + E h), with
  !! the element forces h for these deflections.
  subroutine expand(model, system, nu, factor, orders, y, wanted, u)
    type(structure_model), intent(in) :: model
    type(structure_type), intent(in) :: system
    !> Frequency, and load factor.
    real(wp), intent(in) :: nu, factor
    integer, intent(in) :: orders(:), wanted(:)
    !> Relative to the base, shape (n_orders, q).
    complex(wp), intent(in) :: y(:, :)
    !> Absolute, shape (n_orders, n_wanted).
    complex(wp), intent(out) :: u(:, :)
    complex(wp), allocatable :: push(:), pole(:), h(:), eta(:), t(:), w(:), y0(:), amplitudes(:)
    complex(wp), allocatable :: found(:)
    integer, allocatable :: near(:)
    complex(wp) :: c(size(y, 2), size(y, 2)), s, base
    type(status_type) :: status
    integer :: j, k, q

    q = size(y, 2)
    do k = 1, size(orders)
      s = cmplx(0.0_wp, orders(k)*nu, wp)
      j = findloc(model%load%orders, orders(k), 1)
      push = 0.0_wp*model%rest%squares + (0.0_wp, 0.0_wp)
      pole = 0.0_wp*model%rest%poles
      base = (0.0_wp, 0.0_wp)
      if (j > 0) then
        call system%loads(j)%modal_forces(aimag(s), amplitudes, pole)
        push = factor*amplitudes(:size(push))
        pole = factor*pole
        base = factor*model%load%base(j)
      end if
      associate (rest => model%rest, seen => system%rest%seen(:size(push), :))
        if (orders(k) == 0) then
          allocate (h(q))
          call model%at_rest(system, y(k, :), push, pole, h, eta, status)
          t = merge(1.0_wp, 0.0_wp, abs(rest%squares) > 0.0_wp) &
              /merge(rest%squares, 1.0_wp, abs(rest%squares) > 0.0_wp)
          w = -1.0_wp/rest%poles
        else
          t = rest%squares*cmplx(1.0_wp, rest%losses, wp) + rest%rates*s + s**2
          ! Without damping and at resonance the difference is only rounding error.
          where (.not. abs(t) > 0.0_wp) t = epsilon(1.0_wp)*abs(rest%squares) + tiny(1.0_wp)
          t = 1.0_wp/t
          w = 1.0_wp/(s - rest%poles)
          near = near_modes(system%rest, aimag(s))
          amplitudes = push(near)
          ! Modes near resonance are separate unknowns.
          t(near) = 0.0_wp
          y0 = matmul(t*push, seen) + matmul(w*pole, system%rest%left)
          if (size(near) > 0) then
            found = near_answer(system, near, aimag(s), [y(k, :) - y0, -amplitudes])
            h = found(:q)
            amplitudes = found(q + 1:)
          else
            call system%rest%evaluate(s, c)
            h = forces(c, y(k, :) - y0)
          end if
        end if
        push = t*(push + matmul(seen, h))
        if (orders(k) /= 0) push(near) = amplitudes
        if (orders(k) == 0) push = unpack(eta, .not. abs(rest%squares) > 0.0_wp, push)
        pole = w*(pole + matmul(system%rest%right, h))
        u(k, :) = matmul(rest%shapes(wanted, :), push) + matmul(rest%left(wanted, :), pole) &
                  + model%base_direction(wanted)*base
      end associate
      deallocate (h)
    end do
  end subroutine expand

  !> Forces, and amplitudes of modes near resonance.
  function near_answer(system, near, mu, right) result(x)
    type(structure_type), intent(in) :: system
    integer, intent(in) :: near(:)
    real(wp), intent(in) :: mu
    complex(wp), intent(in) :: right(:)
    complex(wp) :: x(size(right)), inverse(size(right), size(right))
    call bordered(system%rest, near, mu, inverse)
    x = matmul(inverse, right)
  end function near_answer

  !> H^-1 y.
  pure function forces(h, y) result(x)
    complex(wp), intent(in) :: h(:, :), y(:)
    complex(wp) :: x(size(y))
    real(wp) :: matrix(2*size(y), 2*size(y)), right(2*size(y))
    integer :: pivots(2*size(y)), n
    logical :: singular
    n = size(y)
    matrix(:n, :n) = real(h)
    matrix(n + 1:, n + 1:) = real(h)
    matrix(:n, n + 1:) = -aimag(h)
    matrix(n + 1:, :n) = aimag(h)
    right = [real(y), aimag(y)]
    x = (0.0_wp, 0.0_wp)
    call factorize(2*n, matrix, pivots, singular)
    if (singular) return
    call solve(2*n, matrix, pivots, right)
    x = cmplx(right(:n), right(n + 1:), wp)
  end function forces

  !> Line of a plan: the condensation.
  function description(self) result(text)
    class(structure_model), intent(in) :: self
    character(len=:), allocatable :: text
    integer :: rigid, below, q

    associate (rest => self%rest)
      q = size(self%directions, 2)
      rigid = count(.not. abs(rest%squares) > 0.0_wp)
      below = count(rest%squares < 0.0_wp)
      if (size(rest%squares) > 0) then
        text = things(size(rest%squares), 'real mode')
      else
        text = things(size(rest%poles)/2, 'pair of complex modes', 'pairs of complex modes')
      end if
      if (rigid > 0) text = text//', '//show(rigid)//' of rigid bodies'
      if (below > 0) text = text//', '//show(below)//' unstable without the elements'
      text = 'computes: '//things(size(self%mass, 1), 'coordinate')//' condensed to ' &
             //things(q, 'deflection')//' by '//text//new_line('a')
    end associate
  end function description

end module viscovib_structure_model
