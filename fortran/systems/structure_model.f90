!> A structure as defined by the user: matrices, elements and loads. It is condensed to the
!! deflections of its elements.
module viscovib_structure_model
  use viscovib_compliance, only: push_type
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_polynomial, only: max_coordinates, new_polynomial, polynomial_parameters
  use viscovib_speed_matrices, only: speed_matrices
  use viscovib_static_form, only: new_static_form
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_structure, only: structure_type, varying_push
  use viscovib_structure_elements, only: add_elements, element_type, find_directions, &
    put_laws
  use viscovib_structure_rest, only: modal_damping, new_rest, rest_type
  use viscovib_structure_supports, only: new_supports, structure_supports
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: structure_model, condense, set_rest, put_load, add_linear

  !> Largest number of monomials of all elements.
  integer, parameter :: most_terms = 20000
  !> Relative deflections by a rigid body that are rounding errors.
  real(wp), parameter :: unseen = 1.0e-10_wp
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
  contains
    procedure :: description
    procedure :: all_damping
    procedure :: inertia
    procedure :: fix_damping
    procedure :: hold
    procedure :: set_speed
    procedure :: check_sizes
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
    call set_rest(model, system, weights, status)
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
  subroutine set_rest(model, system, weights, status)
    type(structure_model), intent(inout) :: model
    type(structure_type), intent(inout) :: system
    !> H tends to 1/(weight s^2) at high frequency, shape (q).
    real(wp), allocatable, intent(out) :: weights(:)
    type(status_type), intent(out) :: status
    real(wp), allocatable :: seen(:, :)
    logical :: singular
    integer :: a, q

    q = size(model%directions, 2)
    associate (rest => system%rest, modes => model%rest)
      seen = matmul(transpose(modes%shapes), model%directions)
      where (spread(.not. abs(modes%squares) > 0.0_wp, 2, q) .and. abs(seen) <= unseen &
             *matmul(transpose(abs(modes%shapes)), abs(model%directions))) seen = 0.0_wp
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
      call rest%complete()
    end associate
    call set_ok(status)
    call new_static_form(system%static, system%rest, singular)
    if (singular) then
      call fail(status, status_input_error, 'element', '&element: the deflections see too few ' &
                //'modes of the structure to be independent')
      return
    end if
  end subroutine set_rest

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
    complex(wp), allocatable :: force(:, :)
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
        call set_push(load%force(:, j), own%force)
        own%at_rest = nothing
        if (own%order == 0 .and. .not. in_time) then
          if (.not. system%static%is_held(own%force)) then
            call fail(status, status_input_error, 'load', '&load: its mean (order 0) acts on a ' &
                      //'rigid body without support: there is no static equilibrium')
            return
          end if
          call own%find_at_rest(system%static, system%rest)
        end if
        own%has_force = any(abs(load%force(:, j)) > 0.0_wp)
        call set_push(inertia*load%base(j), own%base)
        own%moves_base = any(abs(own%base%modes) > 0.0_wp) .or. any(abs(own%base%poles) > 0.0_wp)
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
        call set_push(load%varying(i)%force, pushes(k)%push)
      end do
    end function varying_pushes

    subroutine set_push(forces, push)
      complex(wp), intent(in) :: forces(:)
      type(push_type), intent(out) :: push
      push%modes = matmul(forces, model%rest%shapes)
      push%poles = matmul(forces, model%rest%right)
      push%flexible = nothing
      push%flexible_rate = nothing
      call system%rest%complete_push(push)
    end subroutine set_push

  end subroutine put_load

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
