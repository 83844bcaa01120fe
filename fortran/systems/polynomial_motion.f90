! Optimize: -O3
!> A polynomial system without memory in time, with a periodic load and piecewise polynomials:
!!
!!   M u'' = Im sum_k P_k exp(i k nu t) + F(t) - C u' - K u - f(u).
!!
!! Kernels of exponentials become additional coordinates (viscovib_hidden_memory); other kernels are
!! fitted by them (viscovib_fitted_motion). The drives are cos(nu t), sin(nu t), and the time within
!! a piece of F. Higher orders follow by rotation.
module viscovib_polynomial_motion
  use viscovib_dense, only: invert
  use viscovib_driven_system, only: driven_system_type, range_of_degree
  use viscovib_frozen_surfaces, only: frozen, jump_over, turn_over
  use viscovib_hidden_memory, only: count_hidden, hidden_text, unfold_memory
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: add_multiple, add_two, max_dof, most_sloped, multiply_lanes, n_lanes
  use viscovib_law_branches, only: slides
  use viscovib_law_program, only: wall
  use viscovib_law_slopes, only: most_arguments
  use viscovib_law_term, only: law_term, part_linear
  use viscovib_load, only: load_type
  use viscovib_modal_frame, only: has_frame, modal_frame, most_in_frame, most_with_memory, &
    new_modal_frame
  use viscovib_motion_loads, only: motion_loads
  use viscovib_moving_element, only: fastest_settling, moving_element
  use viscovib_polynomial, only: highest_degree, monomial_type, polynomial_type
  use viscovib_shaft_motion, only: new_shaft_motion, shaft_motion
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_steep_laws, only: find_steep, join_arguments, steep_force
  use viscovib_switched_laws, only: new_switched_laws, switched_laws
  implicit none
  private

  public :: polynomial_motion_type, new_polynomial_motion

  type, extends(driven_system_type) :: polynomial_motion_type
    type(monomial_type), allocatable, private :: monomials(:)
    type(switched_laws) :: laws
    type(shaft_motion), private :: shaft
    !> M^(-1), M^(-1) K and M^(-1) C, shape (n_dof, n_dof), and an upper bound of the rates of the
    !! linear system.
    real(wp), allocatable, private :: inverse(:, :), stiffness(:, :), damping(:, :)
    real(wp), private :: linear_rate = 0.0_wp
    !> As of `part_linear`.
    real(wp), allocatable, private :: parted(:, :)
    type(motion_loads), private :: loads
  contains
    procedure :: acceleration
    procedure :: linearise
    procedure :: push
    procedure :: steep_forces
    procedure :: margin
    procedure :: fastest
    procedure :: add_table, enter, hold, jump
    procedure :: take_sides
    procedure :: signal_at
    procedure :: meet
    procedure :: longest_part
    procedure :: n_laws
    procedure :: law_forces
    procedure :: settle
    procedure :: n_switches, n_contacts, keep_switches, recall_switches
    procedure, private :: but_laws, add_pushes, find_steep_surfaces
  end type polynomial_motion_type

  !> Largest angle of the fastest motion within a substep (a quarter turn), and its lower bound for
  !! short steps; shortest substep as a fraction of the step.
  real(wp), parameter :: most_turn = 1.57_wp, least_turn = most_turn/32.0_wp, &
                         shortest_part = 1.0_wp/4096.0_wp

contains

  subroutine new_polynomial_motion(motion, system, load, nu, status, in_sections)
    type(polynomial_motion_type), intent(out) :: motion
    type(polynomial_type), intent(in) :: system
    !> Base motion requires `in_sections`; coordinates are then relative to the base.
    type(load_type), intent(in) :: load
    !> Circular frequency of the load (rad/s), > 0.
    real(wp), intent(in) :: nu
    type(status_type), intent(out) :: status
    !> True to use modal coordinates for more coordinates than fit in vector lanes, and coordinates
    !! for the memory of exponentials.
    logical, intent(in), optional :: in_sections
    type(polynomial_type) :: whole
    complex(wp) :: forces(system%n_dof(), size(load%orders))
    integer :: k, most, n_hidden

    most = max_dof
    if (present(in_sections)) most = merge(most_in_frame, max_dof, in_sections)
    n_hidden = 0
    if (most > max_dof) n_hidden = max(count_hidden(system), 0)
    if (n_hidden > 0) most = most_with_memory
    if (system%n_dof() + n_hidden > most) then
      call fail(status, status_input_error, 'system', 'system: has ' &
                //show(system%n_dof() + n_hidden)//' coordinates'//hidden_text(n_hidden) &
                //', motion in time takes at most '//show(most))
    else if (any(system%kernel_of > 0) .and. n_hidden == 0) then
      call fail(status, status_input_error, 'system', 'system: has memory, motion in time is ' &
                //'computed without: leave out the kernels')
    else if (load%moves_base() .and. most == max_dof) then
      call fail(status, status_input_error, 'base', 'base: must be at rest in motion in time')
    end if
    if (status%failed()) return
    motion%n_hidden = n_hidden
    do k = 1, size(load%orders)
      forces(:, k) = load%force_at(k, nu)
    end do
    if (load%moves_base()) then
      motion%base_motion%frequencies = load%orders*nu
      motion%base_motion%amplitudes = 0.0_wp*forces
      do k = 1, size(load%orders)
        motion%base_motion%amplitudes(:, k) = load%shift(system, k)
        forces(:, k) = load%coefficient(system, load%orders(k), nu)
      end do
    end if
    if (n_hidden > 0) call unfold_memory(system, whole)
    if (n_hidden > 0) call set_up(motion, whole, load%orders, forces, nu, status)
    if (n_hidden == 0) call set_up(motion, system, load%orders, forces, nu, status)
  end subroutine new_polynomial_motion

  !> Set up the motion of a system without memory.
  subroutine set_up(motion, system, orders, forces, nu, status)
    type(polynomial_motion_type), intent(inout) :: motion
    type(polynomial_type), intent(in) :: system
    !> Orders of the load, and forces on the first coordinates, shape (n, size(orders)).
    integer, intent(in) :: orders(:)
    complex(wp), intent(in) :: forces(:, :)
    real(wp), intent(in) :: nu
    type(status_type), intent(inout) :: status
    complex(wp), allocatable :: inverse(:, :)
    real(wp) :: pace
    type(law_term) :: laws(size(system%laws))
    integer :: i, n
    logical :: singular

    motion%n_dof = system%n_dof()
    motion%monomials = system%monomials
    n = system%n_dof() - motion%n_hidden
    allocate (inverse(n, n))
    call invert(cmplx(system%mass(:n, :n), 0.0_wp, wp), inverse, singular)
    ! Masses that represent memory are not coupled.
    allocate (motion%inverse(motion%n_dof, motion%n_dof), source=0.0_wp)
    motion%inverse(:n, :n) = real(inverse)
    do i = n + 1, motion%n_dof
      motion%inverse(i, i) = 1.0_wp/system%mass(i, i)
    end do
    motion%stiffness = accelerations(system%stiffness_at_rest())
    motion%damping = accelerations(system%damping)
    motion%loads%orders = orders
    motion%loads%load = matmul(motion%inverse(:, :n), forces)
    motion%drives = [(nu, i=1, 2)]
    motion%quarters = [0, 3]
    motion%limited = .false.
    motion%range = range_of_degree(highest_degree(system%monomials), size(system%laws) > 0)
    motion%linear_rate = sqrt(maxval(sum(abs(motion%stiffness(:n, :)), 2))) &
                         + maxval(sum(abs(motion%damping(:n, :n)), 2))
    laws = system%laws
    do i = 1, size(laws)
      if (laws(i)%state == 0 .and. .not. allocated(laws(i)%program%of_lanes)) then
        call join_arguments(laws(i))
      end if
    end do
    allocate (motion%parted(2*motion%n_dof, size(laws)))
    call part_linear(laws, motion%inverse, motion%stiffness, motion%damping, motion%parted)
    call find_steep(pack(laws, laws%state == 0 .and. has_frame(system%mass)), motion%steep)
    if (motion%n_dof > max_dof .or. motion%n_hidden > 0 .or. size(motion%steep) > 0) then
      allocate (motion%frame)
      call new_polynomial_frame(motion%frame, pace, system, motion%n_hidden, status)
      if (status%failed()) return
      if (n > max_dof) motion%linear_rate = pace
      motion%fading = maxval([0.0_wp, motion%frame%rates(n + 1:)])
    end if
    motion%sloped = motion%n_dof <= most_sloped .and. size(laws) > 0 .and. all(laws%state == 0) &
                    .and. .not. allocated(system%shaft)
    if (allocated(system%shaft)) then
      call new_shaft_motion(motion%shaft, system%shaft, system%mass, motion%inverse)
    end if
    do i = 1, size(laws)
      if (size(laws(i)%arguments, 1) > most_arguments) motion%sloped = .false.
    end do
    call motion%layers%find(laws)
    call new_switched_laws(motion%laws, laws, motion%inverse)
    motion%jump_at_rest = motion%laws%largest_jump()
    call motion%find_steep_surfaces()
    if (size(motion%laws%holds) == 0) return
    motion%signals = motion%laws%signals
    motion%sloped = .false.

  contains

    !> M^(-1) A.
    function accelerations(a)
      real(wp), intent(in) :: a(:, :)
      real(wp) :: accelerations(size(a, 1), size(a, 2))
      integer :: h
      accelerations(:n, :) = matmul(motion%inverse(:n, :n), a(:n, :))
      do h = n + 1, size(a, 1)
        accelerations(h, :) = motion%inverse(h, h)*a(h, :)
      end do
    end function accelerations

  end subroutine set_up

  !> The rates and accelerations of steep laws, and their surfaces.
  subroutine find_steep_surfaces(self)
    class(polynomial_motion_type), intent(inout) :: self
    logical :: of_steep(size(self%laws%holds)), smooth
    integer :: i, j, k

    allocate (self%steep_of(size(self%laws%holds)), source=0)
    allocate (self%steep_rates(size(self%steep), self%n_dof))
    allocate (self%steep_places, mold=self%steep_rates)
    allocate (self%steep_pushes(self%n_dof, size(self%steep)))
    of_steep = [(any(self%steep%law == self%laws%law_of(k)), k=1, size(of_steep))]
    do j = 1, size(self%steep)
      i = self%steep(j)%law
      self%steep_rates(j, :) = self%laws%laws(i)%rates(self%steep(j)%argument, :)
      self%steep_places(j, :) = self%laws%laws(i)%arguments(self%steep(j)%argument, :)
      self%steep_pushes(:, j) = -self%laws%weights(:, i)
      do k = 1, size(self%steep_of)
        if (self%laws%law_of(k) /= i .or. .not. self%laws%signals(k)%rough > 0.0_wp) cycle
        ! The force is not smooth where another law jumps or is rough.
        smooth = all(of_steep .or. self%laws%leader /= self%laws%leader(k))
        where (smooth .and. self%laws%leader == self%laws%leader(k)) self%steep_of = j
      end do
    end do
    self%steep_held = self%steep_pushes
    call find_alike(self)
  end subroutine find_steep_surfaces

  !> Steep laws with a common rate have one unknown: that of the smallest exponent.
  subroutine find_alike(self)
    class(polynomial_motion_type), intent(inout) :: self
    !> Relative difference of rates that is rounding error.
    real(wp), parameter :: rounding = 1.0e-12_wp
    real(wp) :: factor
    integer :: j, k, place

    do j = 1, size(self%steep)
      self%steep(j)%leader = j
      do k = 1, size(self%steep)
        associate (own => self%steep_rates(j, :), other => self%steep_rates(k, :))
          place = maxloc(abs(other), 1)
          factor = own(place)/other(place)
          if (any(abs(own - factor*other) > rounding*maxval(abs(own)))) cycle
        end associate
        associate (own => self%steep_places(j, :), other => self%steep_places(k, :))
          if (any(abs(own - factor*other) > rounding*maxval(abs(own)))) cycle
        end associate
        ! The first of those with the smallest exponent.
        associate (leader => self%steep(j)%leader, a => self%steep%exponent)
          if (a(k) > a(leader) .or. (a(k) >= a(leader) .and. k > leader)) cycle
        end associate
        self%steep(j)%leader = k
        self%steep(j)%factor = factor
      end do
    end do
  end subroutine find_alike

  !> Fix the laws on one side of each surface, or on it.
  subroutine take_sides(self, sides)
    class(polynomial_motion_type), intent(inout) :: self
    integer, intent(in) :: sides(:)
    integer :: k
    if (size(sides) == 0) return
    call self%laws%take(sides)
    do k = 1, size(sides)
      if (self%laws%changed(k)) self%signals(k)%program = self%laws%signals(k)%program
    end do
    ! Operands do not jump within a step that ends at the jump.
    if (self%layers%exist()) call self%layers%find(self%laws%laws)
    if (size(self%steep) > 0) call hold_steep(self)
  end subroutine take_sides

  !> Steep laws on the present surfaces. Between two sticking masses the rate is 0; rounding errors
  !! of it would change the force of a small exponent.
  subroutine hold_steep(self)
    class(polynomial_motion_type), intent(inout) :: self
    !> Part of the rate by a force that is rounding error.
    real(wp), parameter :: rounding = 1.0e-10_wp
    logical :: still
    integer :: j

    self%steep_held = self%steep_pushes
    call self%laws%hold_back(self%steep_held)
    do j = 1, size(self%steep)
      still = abs(dot_product(self%steep_rates(j, :), self%steep_held(:, j))) &
              <= rounding*abs(dot_product(self%steep_rates(j, :), self%steep_pushes(:, j)))
      if (still) self%steep_held(:, j) = 0.0_wp
      call self%laws%freeze(self%steep(j)%law, self%steep(j)%argument, still)
    end do
  end subroutine hold_steep

  !> Event function of a surface; in sliding 1 - lambda^2, lambda = -1 and 1 on its sides.
  subroutine signal_at(self, k, t, q, v, g)
    class(polynomial_motion_type), intent(in) :: self
    integer, intent(in) :: k
    real(wp), intent(in) :: t(:), q(:, :), v(:, :)
    real(wp), intent(out) :: g(:)
    !> Prevents rounding errors from leaving the surface where a mass may come to rest permanently.
    real(wp), parameter :: edge = 1.0e-13_wp
    real(wp) :: mu(size(t), self%laws%n_slides()), d(size(t)), rate(size(t))
    integer :: j

    if (self%laws%holds(k) /= slides) then
      if (self%laws%n_slides() > 0) then
        if (frozen(self%laws, k, q(1, :))) then
          g = merge(-1.0_wp, 1.0_wp, self%laws%holds(k) < 0)
          return
        end if
      end if
      if (self%laws%law_of(k) > 0) then
        call self%signals(k)%at(t, q, v, g)
        return
      end if
      associate (i => self%laws%element_of(k))
        d = self%laws%deflection(i, q)
        rate = self%laws%deflection(i, v)
        do j = 1, size(t)
          g(j) = self%laws%elements(i)%surface(self%laws%which(k), d(j), rate(j))
        end do
      end associate
      return
    end if
    g = 1.0_wp
    j = self%laws%place_of(k)
    ! Equal surfaces are monitored once.
    if (j == 0) return
    call weights_between(self, t, q, v, mu)
    g = mu(:, j)
    if (self%laws%law_of(k) > 0) g = g*(2.0_wp - g) + edge
  end subroutine signal_at

  !> Position mu between the sides of each sliding surface, at given states.
  subroutine weights_between(self, t, q, v, mu)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: t(:), q(:, :), v(:, :)
    real(wp), intent(out) :: mu(:, :)
    real(wp) :: a(n_lanes, self%n_dof), some_mu(n_lanes, size(mu, 2))
    integer :: i, from, place(n_lanes)

    do from = 1, size(t), n_lanes
      place = [(min(from + i - 1, size(t)), i=1, n_lanes)]
      call self%but_laws(q(place, :), v(place, :), self%drive_at(t(place)), a)
      if (self%shaft%angle > 0) then
        call self%shaft%hold(self%laws, self%n_dof, q(place, :), v(place, :), a)
      end if
      call self%laws%add(q(place, :), v(place, :), a, some_mu)
      i = min(n_lanes, size(t) - from + 1)
      mu(from:from + i - 1, :) = some_mu(:i, :)
    end do
  end subroutine weights_between

  !> Cross a surface, start sliding if both sides push towards it, or end sliding.
  subroutine meet(self, k, t, q, v, sides, touched)
    class(polynomial_motion_type), intent(inout) :: self
    integer, intent(in) :: k
    real(wp), intent(in) :: t, q(:)
    real(wp), intent(inout) :: v(:)
    integer, intent(inout) :: sides(:)
    logical, intent(inout) :: touched(:)
    !> Fraction of the larger push that counts as 0.
    real(wp), parameter :: slack = 1.0e-11_wp
    integer :: before(size(sides)), beyond(size(sides)), one
    real(wp) :: mu(1, self%laws%n_slides()), push(2), speed(size(v))
    logical :: same(size(sides))

    same = self%laws%leader == self%laws%leader(k)
    touched = touched .or. same
    one = self%laws%sense(k)
    if (self%laws%element_of(k) > 0) then
      speed = v
      call meet_element(self, k, t, q, v, sides)
      if (any(abs(v - speed) > 0.0_wp)) call jump_over(self%laws, t, q, speed, v, sides)
    else if (sides(k) == slides) then
      call weights_between(self, [t], reshape(q, [1, size(q)]), reshape(v, [1, size(v)]), mu)
      if (mu(1, self%laws%place_of(self%laws%leader(k))) > 1.0_wp) one = -one
      ! The motion leaves the surface from the surface itself.
      call self%laws%stay(q, v)
      sides = merge(one*self%laws%sense(k)*self%laws%sense, sides, same)
    else
      before = sides
      beyond = merge(-sides(k)*one*self%laws%sense, sides, same)
      sides = beyond
      ! A push that just vanishes, as when a stop opens, must not depend on rounding errors.
      push = [push_from(before), push_from(beyond)]
      if (all(push > -slack*maxval(abs(push))) .and. any(push > 0.0_wp)) then
        sides = merge(slides, sides, same)
      end if
    end if
    call self%take_sides(sides)
    if (self%laws%n_slides() > 0) call self%laws%stay(q, v)

  contains

    !> Push towards the surface for these sides.
    real(wp) function push_from(there)
      integer, intent(in) :: there(:)
      real(wp), dimension(n_lanes, self%n_dof) :: a
      call self%take_sides(there)
      call self%acceleration(spread(q, 1, n_lanes), spread(v, 1, n_lanes), &
                             self%drive_at(spread(t, 1, n_lanes)), a)
      push_from = -there(k)*self%laws%rate(k, q, v, a(1, :))
    end function push_from

  end subroutine meet

  !> Reversal or kink of hysteresis; impact or opening of a stop.
  subroutine meet_element(self, k, t, q, v, sides)
    class(polynomial_motion_type), intent(inout) :: self
    integer, intent(in) :: k
    real(wp), intent(in) :: t, q(:)
    real(wp), intent(inout) :: v(:)
    integer, intent(inout) :: sides(:)
    real(wp) :: d(1), n(size(q)), b(size(q)), away, press, height, lost, times(n_lanes)
    real(wp), dimension(n_lanes, self%n_dof) :: a
    !> The rise of a flight of this duration is within rounding errors of the motion in a step.
    real(wp), parameter :: soon = sqrt(8.0_wp*epsilon(1.0_wp))

    associate (element => self%laws%elements(self%laws%element_of(k)), which => self%laws%which(k))
      d = self%laws%deflection(self%laws%element_of(k), reshape(q, [1, size(q)]))
      if (.not. element%is_stop) then
        call element%turn(which, d(1))
        if (which == 1) sides(k) = -sides(k)
        return
      end if
      if (sides(k) == slides) then
        sides(k) = 1
        element%since(which) = -1.0_wp
        return
      end if
      call self%laws%normal(k, n, b)
      v = v - (1.0_wp + element%restitution)*(min(dot_product(n, v), 0.0_wp)/dot_product(n, b))*b
      call push_on(self%laws, k, v, sides)
      sides(k) = 1
      call self%take_sides(sides)
      times = t + [0.0_wp, spread(soon*self%step_length, 1, n_lanes - 1)]
      call self%acceleration(spread(q, 1, n_lanes), spread(v, 1, n_lanes), self%drive_at(times), a)
      away = dot_product(n, v)
      ! A load that only starts to push acts after its first instant.
      press = -min(dot_product(n, a(1, :)), dot_product(n, a(2, :)))
      ! Compared with the gap, or with the distance moved in a step.
      height = max(abs(element%gap), abs(press)*self%step_length**2)
      if (allocated(self%frame)) height = max(height, self%frame%sum_of_sizes(q, n))
      height = 4.0_wp*epsilon(1.0_wp)*height
      if (press > 0.0_wp .and. away**2 <= 2.0_wp*press*height) then
        lost = max(1.0_wp - element%restitution, epsilon(1.0_wp))
        element%since(which) = t + merge(0.0_wp, 2.0_wp*away/(press*lost), &
                                         element%restitution >= 1.0_wp)
        v = v - (away/dot_product(n, b))*b
        sides(k) = slides
      end if
    end associate
  end subroutine meet_element

  !> Longest substep allowed by the laws at these states, such as the stiffness of a contact. The
  !! angle turned within it is at most that of the linear subsystem in a step. If runs are compared,
  !! substeps are shorter by the ratio of this step size to the longest one.
  real(wp) function longest_part(self, q, v)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(:, :), v(:, :)
    real(wp) :: angle, fastest
    angle = self%thin*max(least_turn, min(most_turn, self%linear_rate*self%step_length/self%thin))
    fastest = fastest_of_laws(self, q, v) + fastest_settling(self%laws%elements, q, v)
    longest_part = max(angle/max(fastest, tiny(1.0_wp)), shortest_part*self%step_length)
  end function longest_part

  !> Initialize elements with internal state.
  subroutine settle(self, q, v)
    class(polynomial_motion_type), intent(inout) :: self
    real(wp), intent(in) :: q(:), v(:)
    call begin_elements(self%laws, q, v)
  end subroutine settle

  !> Number of saved values: internal states of elements, stops first, and the side of every
  !! surface.
  pure integer function n_switches(self)
    class(polynomial_motion_type), intent(in) :: self
    n_switches = 2*size(self%laws%holds) + self%laws%n_known()
  end function n_switches

  !> The number of these that are times of contact of stops, which are the first ones.
  pure integer function n_contacts(self)
    class(polynomial_motion_type), intent(in) :: self
    n_contacts = self%laws%n_contacts()
  end function n_contacts

  function keep_switches(self) result(kept)
    class(polynomial_motion_type), intent(in) :: self
    real(wp) :: kept(self%n_switches())
    integer :: m, n

    kept = 0.0_wp
    n = size(self%laws%holds)
    if (n == 0 .or. .not. allocated(self%sides)) return
    m = self%laws%n_known()
    kept(:m) = self%laws%known()
    kept(m + 1:m + n) = self%sides
    kept(m + n + 1:) = merge(1.0_wp, 0.0_wp, self%fresh)
  end function keep_switches

  subroutine recall_switches(self, kept)
    class(polynomial_motion_type), intent(inout) :: self
    real(wp), intent(in) :: kept(:)
    integer :: m, n

    n = size(self%laws%holds)
    m = self%laws%n_known()
    if (all(abs(kept(m + 1:m + n)) <= 0.0_wp)) return
    call self%laws%recall(kept(:m))
    self%sides = nint(kept(m + 1:m + n))
    self%fresh = kept(m + n + 1:) > 0.0_wp
  end subroutine recall_switches

  !> Add a force in time, given as polynomials between breaks.
  subroutine add_table(self, breaks, pieces)
    class(polynomial_motion_type), intent(inout) :: self
    !> Shapes (n) and (n_dof - n_hidden, n_powers, n). The last piece is not used.
    real(wp), intent(in) :: breaks(:), pieces(:, :, :)
    call self%loads%add_table(self%inverse, breaks, pieces)
    self%timed = .true.
    self%drives = [self%drives, 0.0_wp]
    self%quarters = [self%quarters, 0]
  end subroutine add_table

  !> Add constant forces on all coordinates.
  subroutine hold(self, force)
    class(polynomial_motion_type), intent(inout) :: self
    real(wp), intent(in) :: force(:)
    call self%loads%hold(matmul(self%inverse, force))
  end subroutine hold

  !> Corner of the base motion: leave or cross surfaces at once, and reverse hysteresis.
  subroutine jump(self, t, q, before, v, sides)
    class(polynomial_motion_type), intent(inout) :: self
    real(wp), intent(in) :: t, q(:), before(:)
    real(wp), intent(inout) :: v(:)
    integer, intent(inout) :: sides(:)
    if (size(sides) == 0) return
    call push_on(self%laws, 0, v, sides)
    call turn_over(self%laws, q, v, sides)
    call jump_over(self%laws, t, q, before, v, sides)
    call self%take_sides(sides)
    if (self%laws%n_slides() > 0) call self%laws%stay(q, v)
  end subroutine jump

  subroutine enter(self, from, to)
    class(polynomial_motion_type), intent(inout) :: self
    real(wp), intent(in) :: from, to
    self%present_piece = [from, to]
    call self%loads%enter(from, to)
    call self%base_motion%enter(from, to)
  end subroutine enter

  pure subroutine acceleration(self, q, v, drive, a)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    call self%but_laws(q, v, drive, a)
    if (self%shaft%angle == 0) then
      call self%laws%add(q, v, a)
    else
      call self%shaft%add_laws(self%laws, self%n_dof, q, v, a)
    end if
  end subroutine acceleration

  pure integer function n_laws(self)
    class(polynomial_motion_type), intent(in) :: self
    n_laws = size(self%parted, 2)
  end function n_laws

  subroutine law_forces(self, t, q, v, a, force)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: t, q(self%n_dof), v(self%n_dof)
    real(wp), intent(out) :: a(self%n_dof), force(:)
    real(wp), dimension(n_lanes, self%n_dof) :: some_q, some_v, lanes, held
    some_q = spread(q, 1, n_lanes)
    some_v = spread(v, 1, n_lanes)
    call self%but_laws(some_q, some_v, self%drive_at(spread(t, 1, n_lanes)), lanes)
    held = lanes
    call self%shaft%hold(self%laws, self%n_dof, some_q, some_v, held)
    call self%laws%forces(some_q, some_v, held, force)
    force = force + matmul([q, v], self%parted)
    call self%shaft%add_laws(self%laws, self%n_dof, some_q, some_v, lanes)
    a = lanes(1, :)
  end subroutine law_forces

  !> Derivatives by the product rule and by the laws' own.
  pure subroutine linearise(self, q, v, drive, a, by_q, by_v)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    real(wp), intent(out), dimension(n_lanes, self%n_dof, self%n_dof) :: by_q, by_v
    integer :: b, d

    call self%but_laws(q, v, drive, a)
    do b = 1, self%n_dof
      do d = 1, self%n_dof
        by_q(:, d, b) = -self%stiffness(d, b)
        by_v(:, d, b) = -self%damping(d, b)
      end do
    end do
    call add_monomial_slopes(self%monomials, self%n_dof, self%inverse, q, by_q)
    call self%laws%add_sloped(q, v, a, by_q, by_v)
  end subroutine linearise

  !> Accelerations without the laws.
  pure subroutine but_laws(self, q, v, drive, a)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    real(wp) :: total(n_lanes)
    integer :: b, d, last

    do d = 1, self%n_dof
      total = 0.0_wp
      ! A mass that represents memory is pulled by coordinates and its own dashpot only.
      last = self%n_dof
      if (d > last - self%n_hidden) last = last - self%n_hidden
      do b = 1, last
        call add_two(total, -self%stiffness(d, b), q(:, b), -self%damping(d, b), v(:, b))
      end do
      if (d > last) call add_multiple(total, -self%damping(d, d), v(:, d))
      a(:, d) = total
    end do
    call self%add_pushes(q, v, drive, a)
  end subroutine but_laws

  !> Accelerations without the linear subsystem and steep laws. Sliding and an unbalance need the
  !! full acceleration.
  pure subroutine push(self, q, v, drive, rest, a)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives)), rest(n_lanes, self%n_dof)
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    integer :: steep(size(self%steep))
    logical :: all_needed

    steep = self%steep%law
    all_needed = self%laws%n_slides() > 0 .or. self%shaft%angle > 0
    a = 0.0_wp
    call self%add_pushes(q, v, drive, a)
    if (all_needed) a = a + rest
    if (self%shaft%angle == 0) then
      call self%laws%add(q, v, a, but=steep)
    else
      call self%shaft%add_laws(self%laws, self%n_dof, q, v, a, steep)
    end if
    if (all_needed) a = a - rest
  end subroutine push

  subroutine steep_forces(self, which, q, v, roots, forces, slopes)
    class(polynomial_motion_type), intent(in) :: self
    integer, intent(in) :: which
    real(wp), intent(in) :: q(:, :), v(:, :), roots(:)
    real(wp), intent(out) :: forces(:), slopes(:)
    associate (law => self%laws%laws(self%steep(which)%law))
      call steep_force(law, self%steep(which), matmul(q, transpose(law%arguments)) &
                       + matmul(v, transpose(law%rates)), roots, forces, slopes)
    end associate
  end subroutine steep_forces

  !> Add the accelerations by monomials, loads and the speed of a shaft.
  pure subroutine add_pushes(self, q, v, drive, a)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(inout) :: a(n_lanes, self%n_dof)
    call take_monomials(self%monomials, self%n_dof, self%inverse, q, a)
    call self%loads%add_to(drive, a)
    if (self%shaft%angle > 0) call self%shaft%add_forces(self%n_dof, q, v, a)
  end subroutine add_pushes

  !> The equations are valid everywhere.
  pure function margin(self, q)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof)
    real(wp) :: margin(n_lanes)
    margin = 1.0_wp + 0.0_wp*q(:, 1)
  end function margin

  !> Upper bound of the rates of the linear system and of all load orders (rad/s), for the initial
  !! step size.
  pure real(wp) function fastest(self)
    class(polynomial_motion_type), intent(in) :: self
    fastest = max(self%linear_rate, self%drives(1)*self%loads%highest())
  end function fastest

  ! Initial states of hysteresis elements at the start of a solution.

  !> Set every hysteresis element from its deflection and deflection rate.
  subroutine begin_elements(laws, q, v)
    type(switched_laws), intent(inout) :: laws
    !> Shape (n_dof).
    real(wp), intent(in) :: q(:), v(:)
    real(wp) :: d(1), rate(1)
    integer :: i

    do i = 1, size(laws%elements)
      d = laws%deflection(i, reshape(q, [1, size(q)]))
      rate = laws%deflection(i, reshape(v, [1, size(v)]))
      call laws%elements(i)%set(d(1), rate(1))
    end do
  end subroutine begin_elements

  ! Impacts in the presence of stops that are already in contact.

  !> Apply successive impacts to the closed stops until none is penetrated.
  subroutine push_on(laws, first, v, sides)
    type(switched_laws), intent(inout) :: laws
    !> Surface of the stop that was hit first.
    integer, intent(in) :: first
    real(wp), intent(inout) :: v(:)
    integer, intent(inout) :: sides(:)
    integer, parameter :: most = 100
    real(wp) :: n(size(v)), b(size(v)), away
    integer :: i, k
    logical :: settled

    do i = 1, most
      settled = .true.
      do k = 1, size(sides)
        if (laws%element_of(k) == 0 .or. (sides(k) /= slides .and. k /= first)) cycle
        call laws%normal(k, n, b)
        away = dot_product(n, v)
        if (abs(away) <= 1.0e-14_wp*sum(abs(n*v))) cycle
        if (away > 0.0_wp) then
          sides(k) = 1
          laws%elements(laws%element_of(k))%since(laws%which(k)) = -1.0_wp
        else
          settled = .false.
          v = v - (1.0_wp + laws%elements(laws%element_of(k))%restitution) &
              *(away/dot_product(n, b))*b
        end if
      end do
      if (settled) return
    end do
  end subroutine push_on

  ! Modal frame of the linear subsystem of a polynomial system (`viscovib_modal_frame`).

  !> Include the linear parts of the laws.
  subroutine new_polynomial_frame(frame, pace, system, n_hidden, status)
    type(modal_frame), intent(out) :: frame
    !> Largest rate of the coordinates and of the arguments of laws (rad/s).
    real(wp), intent(out) :: pace
    type(polynomial_type), intent(in) :: system
    !> Number of last coordinates that represent memory.
    integer, intent(in) :: n_hidden
    type(status_type), intent(inout) :: status
    real(wp), dimension(system%n_dof(), system%n_dof()) :: identity, stiffness, damping
    type(law_term) :: laws(size(system%laws))
    real(wp), allocatable :: seen(:, :)
    logical :: found
    integer :: i

    pace = 0.0_wp
    identity = 0.0_wp
    do i = 1, size(identity, 1)
      identity(i, i) = 1.0_wp
    end do
    stiffness = system%stiffness_at_rest()
    damping = system%damping
    laws = system%laws
    call part_linear(laws, identity, stiffness, damping)
    call new_modal_frame(frame, system%mass, damping, stiffness, n_hidden, found)
    if (found) then
      allocate (seen(0, size(identity, 1)))
      do i = 1, size(laws)
        call add_rows(seen, system%laws(i)%arguments)
        call add_rows(seen, system%laws(i)%rates)
      end do
      pace = frame%pace(seen)
      return
    end if
    call fail(status, status_input_error, 'mass', 'mass: must be symmetric and positive definite ' &
              //'in a motion in time of so many coordinates')
  end subroutine new_polynomial_frame

  subroutine add_rows(rows, more)
    real(wp), allocatable, intent(inout) :: rows(:, :)
    real(wp), intent(in) :: more(:, :)
    real(wp) :: all_of_them(size(rows, 1) + size(more, 1), size(rows, 2))
    all_of_them(:size(rows, 1), :) = rows
    all_of_them(size(rows, 1) + 1:, :) = more
    rows = all_of_them
  end subroutine add_rows

  !> Upper bound of the rates of laws over all given states, from their slopes f_q and f_v: the
  !! square root of the sum of |M^(-1) w f_q|, plus the sum of |M^(-1) w f_v|. No law depends on
  !! coordinates that represent memory. Steps solve for steep laws.
  pure real(wp) function fastest_of_laws(self, q, v) result(fastest)
    class(polynomial_motion_type), intent(in) :: self
    !> States, shape (n, n_dof).
    real(wp), intent(in) :: q(:, :), v(:, :)
    real(wp) :: square(size(q, 1)), rate(size(q, 1)), value(size(q, 1)), weight
    real(wp) :: pushed(self%n_dof - self%n_hidden)
    integer :: i, k, n

    n = self%n_dof - self%n_hidden
    square = 0.0_wp
    rate = 0.0_wp
    do i = 1, size(self%laws%laws)
      if (any(self%steep%law == i)) cycle
      associate (law => self%laws%laws(i))
        block
          real(wp) :: slopes(size(q, 1), size(law%arguments, 1)), seen(size(q, 1), size(slopes, 2))
          pushed = 0.0_wp
          do k = 1, size(law%equations)
            if (law%equations(k) > n) cycle
            pushed = pushed + self%inverse(:n, law%equations(k))*law%weights(k)
          end do
          weight = sum(abs(pushed))
          seen = 0.0_wp
          do k = 1, n
            call add_seen(seen, q(:, k), law%arguments(:, k))
            call add_seen(seen, v(:, k), law%rates(:, k))
          end do
          call law%program%differentiate(seen, value, slopes)
          slopes = min(abs(slopes), sqrt(wall))
          do k = 1, size(slopes, 2)
            square = square + weight*sum(abs(law%arguments(k, :n)))*slopes(:, k)
            rate = rate + weight*sum(abs(law%rates(k, :n)))*slopes(:, k)
          end do
        end block
      end associate
    end do
    fastest = maxval(sqrt(square) + rate)

  contains

    !> Add x(i) by(k) to total(i, k).
    pure subroutine add_seen(total, x, by)
      real(wp), intent(inout) :: total(:, :)
      real(wp), intent(in) :: x(:), by(:)
      integer :: j
      do j = 1, size(by)
        total(:, j) = total(:, j) + x*by(j)
      end do
    end subroutine add_seen

  end function fastest_of_laws

  ! Monomials of a system for a block of vector lanes: their accelerations and derivatives.

  !> a := a - M^(-1) c prod_d u_d^p_d.
  pure subroutine take_monomials(monomials, n_dof, inverse, q, a)
    type(monomial_type), intent(in) :: monomials(:)
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: inverse(n_dof, n_dof), q(n_lanes, n_dof)
    real(wp), intent(inout) :: a(n_lanes, n_dof)
    real(wp) :: product(n_lanes)
    integer :: d, i, j

    do i = 1, size(monomials)
      associate (m => monomials(i))
        product = m%coefficient
        do j = 1, size(m%dof)
          call multiply_lanes(product, q(:, m%dof(j)), m%power(j))
        end do
        do d = 1, n_dof
          if (abs(inverse(d, m%equation)) > 0.0_wp) then
            call add_multiple(a(:, d), -inverse(d, m%equation), product)
          end if
        end do
      end associate
    end do
  end subroutine take_monomials

  !> Add the derivatives of these accelerations with respect to coordinates (product rule).
  pure subroutine add_monomial_slopes(monomials, n_dof, inverse, q, by_q)
    type(monomial_type), intent(in) :: monomials(:)
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: inverse(n_dof, n_dof), q(n_lanes, n_dof)
    !> Shape (n_lanes, equation, by).
    real(wp), intent(inout) :: by_q(n_lanes, n_dof, n_dof)
    real(wp) :: product(n_lanes)
    integer :: d, i, j, k

    do i = 1, size(monomials)
      associate (m => monomials(i))
        do j = 1, size(m%dof)
          product = m%coefficient*m%power(j)
          do k = 1, size(m%dof)
            call multiply_lanes(product, q(:, m%dof(k)), m%power(k) - merge(1, 0, k == j))
          end do
          do d = 1, n_dof
            call add_multiple(by_q(:, d, m%dof(j)), -inverse(d, m%equation), product)
          end do
        end do
      end associate
    end do
  end subroutine add_monomial_slopes

end module viscovib_polynomial_motion
