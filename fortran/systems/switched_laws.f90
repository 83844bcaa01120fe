! Optimize: -O2 -fvect-cost-model=dynamic
!> Force laws and elements in time integration, each on one side of its switching surfaces or
!! sliding.
!!
!! A jump, such as in sign(v), is set-valued on its surface g = 0 (Filippov). If the solution is
!! pushed to the surface from both sides it stays there (sliding), and the law takes the
!! intermediate value that keeps it there. With the acceleration a_+ on one side, and the difference
!! 2 b_j to the other side of surface j,
!!
!!   a = a_+ + sum_j mu_j b_j,  0 <= mu_j <= 2,  d g_j/dt = c_j + n_j . a = 0,
!!
!! c_j = dg_j/dq . v and n_j = dg_j/dv. These are linear equations for mu (equivalent control, V. I.
!! Utkin, Sliding Modes in Control and Optimization, 1992). Sliding ends when mu_j leaves this
!! interval. Similarly, a closed stop pushes with b = M^(-1) n and mu >= 0.
module viscovib_switched_laws
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: add_multiple, n_lanes
  use viscovib_few_equations, only: solve
  use viscovib_law_branches, only: find_signals, held, signal_type, slides
  use viscovib_law_lanes, only: evaluate_lanes, evaluate_term
  use viscovib_law_program, only: law_program, wall
  use viscovib_law_roots, only: find_roots
  use viscovib_law_slopes, only: differentiate_term, most_arguments
  use viscovib_law_term, only: law_term
  use viscovib_moving_element, only: moving_element, new_moving_element
  implicit none
  private

  public :: switched_laws, new_switched_laws, slide_directions

  !> Other side of a sliding law: index of the law, and its program there.
  type :: other_side
    integer :: law = 0
    type(law_program) :: program
  end type other_side

  !> A sliding surface: the first of equal surfaces, and the laws that jump on it.
  type :: slide_type
    integer :: leader = 0
    type(other_side), allocatable :: others(:)
    !> Element of a closed stop, 0: none.
    integer :: stop = 0
  end type slide_type

  type :: switched_laws
    integer :: n_dof = 0
    type(law_term), allocatable :: laws(:)
    !> Elements with internal state.
    type(moving_element), allocatable :: elements(:)
    !> The place of each of these among all laws as they were given.
    integer, allocatable, private :: place_of_law(:), place_of_element(:)
    !> Of each surface, its law or behind those its element (the other is 0), which one of it, the
    !! first surface that is the same, and whether both signals have the same sign (1) or not (-1).
    integer, allocatable :: law_of(:), element_of(:), which(:), leader(:), sense(:)
    !> Position relative to each surface: side 1 or -1; unknown, 0; on it, `slides`.
    integer, allocatable :: holds(:)
    type(signal_type), allocatable :: signals(:)
    !> True for signals that the last call of `take` changed.
    logical, allocatable :: changed(:)
    !> Sides of the laws as of the last call of `take`.
    integer, allocatable, private :: taken(:)
    type(law_term), allocatable, private :: free(:)
    !> M^(-1) w of each law, shape (n_dof, n_laws).
    real(wp), allocatable :: weights(:, :)
    type(slide_type), allocatable, private :: sliding(:)
  contains
    procedure :: take
    procedure :: add
    procedure :: add_sloped
    procedure :: forces
    procedure :: rate
    procedure :: stay
    procedure :: hold_back
    procedure :: freeze
    procedure :: largest_jump
    procedure :: n_slides
    procedure :: place_of
    procedure :: n_known
    procedure :: n_contacts
    procedure :: known
    procedure :: recall
    procedure :: normal
    procedure :: deflection
  end type switched_laws

contains

  subroutine new_switched_laws(self, laws, inverse)
    type(switched_laws), intent(out) :: self
    type(law_term), intent(in) :: laws(:)
    !> M^(-1).
    real(wp), intent(in) :: inverse(:, :)
    integer :: i, j, k, n

    self%n_dof = size(inverse, 1)
    self%free = pack(laws, laws%state == 0)
    self%place_of_law = pack([(i, i=1, size(laws))], laws%state == 0)
    self%place_of_element = pack([(i, i=1, size(laws))], laws%state > 0)
    self%laws = self%free
    allocate (self%weights(self%n_dof, size(self%free)), self%elements(count(laws%state > 0)))
    allocate (self%law_of(0), self%element_of(0), self%which(0))
    do i = 1, size(self%free)
      associate (law => self%free(i))
        self%weights(:, i) = matmul(inverse(:, law%equations), law%weights)
        n = law%program%n_surfaces()
        self%law_of = [self%law_of, spread(i, 1, n)]
        self%which = [self%which, (j, j=1, n)]
      end associate
    end do
    self%element_of = 0*self%law_of
    j = 0
    do i = 1, size(laws)
      if (laws(i)%state == 0) cycle
      j = j + 1
      call new_moving_element(self%elements(j), laws(i), inverse)
      n = self%elements(j)%n_surfaces()
      self%law_of = [self%law_of, spread(0, 1, n)]
      self%element_of = [self%element_of, spread(j, 1, n)]
      self%which = [self%which, (k, k=1, n)]
    end do
    n = size(self%law_of)
    allocate (self%holds(n), self%sense(n), source=0)
    self%leader = [(i, i=1, n)]
    self%sense = 1
    allocate (self%signals(n))
    do k = 1, n
      if (self%law_of(k) == 0) cycle
      self%signals(k)%by_q = self%free(self%law_of(k))%arguments
      self%signals(k)%by_v = self%free(self%law_of(k))%rates
    end do
    call self%take(self%holds)
    do i = 2, count(self%law_of > 0)
      do j = 1, i - 1
        if (self%leader(j) /= j) cycle
        self%sense(i) = likeness(self%signals(j), self%signals(i), size(inverse, 1))
        if (self%sense(i) /= 0) then
          self%leader(i) = j
          exit
        end if
      end do
      if (self%leader(i) == i) self%sense(i) = 1
    end do
    call set_roughness(self)
  end subroutine new_switched_laws

  !> Smallest exponent of a force at each surface, of all laws with the same surface.
  subroutine set_roughness(self)
    type(switched_laws), intent(inout) :: self
    integer :: j, k
    real(wp) :: least(size(self%signals))

    least = 0.0_wp
    do k = 1, size(self%signals)
      if (self%element_of(k) > 0) then
        least(k) = self%elements(self%element_of(k))%roughness(self%which(k))
      else
        least(k) = rough_surface(self%free(self%law_of(k))%program, self%which(k))
      end if
    end do
    do k = 1, size(self%signals)
      associate (mine => self%signals(k)%rough)
        mine = least(k)
        do j = 1, size(self%signals)
          if (self%leader(j) /= self%leader(k) .or. .not. least(j) > 0.0_wp) cycle
          if (.not. mine > 0.0_wp .or. least(j) < mine) mine = least(j)
        end do
      end associate
    end do
  end subroutine set_roughness

  !> Sign of the constant factor between two signals; 0 if they are not proportional. They are
  !! compared at generic points.
  integer function likeness(one, other, n_dof)
    type(signal_type), intent(in) :: one, other
    integer, intent(in) :: n_dof
    integer, parameter :: n = 5
    real(wp) :: q(n, n_dof), v(n, n_dof), g(n), f(n), factor
    integer :: d, i

    do d = 1, n_dof
      do i = 1, n
        q(i, d) = sin(1.7_wp*i + 2.3_wp*d + 0.4_wp*i*d)
        v(i, d) = cos(2.9_wp*i - 1.3_wp*d + 0.7_wp*i*d)
      end do
    end do
    likeness = 0
    call one%at([(0.0_wp, i=1, n)], q, v, g)
    call other%at([(0.0_wp, i=1, n)], q, v, f)
    if (maxval(abs(g)) >= wall .or. maxval(abs(f)) >= wall) return
    i = maxloc(abs(g), 1)
    if (.not. min(abs(g(i)), abs(f(i))) > 0.0_wp) return
    factor = f(i)/g(i)
    if (all(abs(f - factor*g) <= 1.0e-12_wp*maxval(abs(f)))) likeness = nint(sign(1.0_wp, factor))
  end function likeness

  !> Fix the laws on the given sides.
  subroutine take(self, holds)
    class(switched_laws), intent(inout) :: self
    !> For each surface: 1, -1, 0 or `slides`.
    integer, intent(in) :: holds(:)
    type(law_program), allocatable :: programs(:)
    integer :: sides(size(self%law_of)), other(size(self%law_of)), i, j, k, n

    self%holds = holds
    sides = merge(self%sense, holds, holds == slides)
    if (.not. allocated(self%changed)) allocate (self%changed(size(holds)))
    self%changed = .true.
    if (allocated(self%taken)) self%changed = self%taken /= sides
    self%taken = sides
    k = 0
    do i = 1, size(self%free)
      associate (law => self%free(i))
        n = law%program%n_surfaces()
        self%changed(k + 1:k + n) = any(self%changed(k + 1:k + n))
        if (n > 0 .and. any(self%changed(k + 1:k + n))) then
          self%laws(i)%program = held(law%program, sides(k + 1:k + n))
          call find_signals(law%program, sides(k + 1:k + n), programs)
          do j = 1, n
            self%signals(k + j)%program = programs(j)
          end do
        end if
        k = k + n
      end associate
    end do
    if (allocated(self%sliding)) deallocate (self%sliding)
    n = 0
    do k = 1, size(holds)
      if (holds(k) == slides .and. self%leader(k) == k) n = n + 1
    end do
    allocate (self%sliding(n))
    j = 0
    do k = 1, size(holds)
      if (holds(k) /= slides .or. self%leader(k) /= k) cycle
      j = j + 1
      if (self%element_of(k) > 0) then
        self%sliding(j)%leader = k
        self%sliding(j)%stop = self%element_of(k)
        allocate (self%sliding(j)%others(0))
      else
        other = merge(-sides, sides, self%leader == k)
        call slide_on(self, k, other, self%sliding(j))
      end if
    end do
  end subroutine take

  !> Initial exponent of a law on its surface j.
  pure real(wp) function rough_surface(program, j)
    type(law_program), intent(in) :: program
    integer, intent(in) :: j
    logical :: roots(size(program%code))
    real(wp) :: rough(program%n_surfaces())
    call find_roots(program%code, program%number, roots, rough)
    rough_surface = rough(j)
  end function rough_surface

  !> Find the laws that jump on a surface.
  subroutine slide_on(self, k, other, slide)
    class(switched_laws), intent(in) :: self
    integer, intent(in) :: k, other(:)
    type(slide_type), intent(out) :: slide
    integer :: first, i, m, n

    slide%leader = k
    allocate (slide%others(size(self%free)))
    m = 0
    first = 0
    do i = 1, size(self%free)
      n = count(self%law_of == i)
      if (any(self%leader(first + 1:first + n) == k)) then
        m = m + 1
        slide%others(m)%law = i
        slide%others(m)%program = held(self%free(i)%program, other(first + 1:first + n))
      end if
      first = first + n
    end do
    slide%others = slide%others(:m)
  end subroutine slide_on

  !> Number of surfaces on which the solution slides.
  pure integer function n_slides(self)
    class(switched_laws), intent(in) :: self
    n_slides = 0
    if (allocated(self%sliding)) n_slides = size(self%sliding)
  end function n_slides

  !> Index of the slide whose first surface is k; 0: none.
  pure integer function place_of(self, k)
    class(switched_laws), intent(in) :: self
    integer, intent(in) :: k
    integer :: j
    place_of = 0
    do j = 1, self%n_slides()
      if (self%sliding(j)%leader == k) place_of = j
    end do
  end function place_of

  !> Number of values that the elements save for a continuation.
  pure integer function n_known(self)
    class(switched_laws), intent(in) :: self
    integer :: i
    n_known = 0
    do i = 1, size(self%elements)
      n_known = n_known + self%elements(i)%n_kept()
    end do
  end function n_known

  !> The number of these that are times of contact, which are the first ones.
  pure integer function n_contacts(self)
    class(switched_laws), intent(in) :: self
    integer :: i
    n_contacts = 0
    do i = 1, size(self%elements)
      if (self%elements(i)%is_stop) n_contacts = n_contacts + self%elements(i)%n_kept()
    end do
  end function n_contacts

  !> Saved values of the elements, stops first.
  function known(self) result(kept)
    class(switched_laws), intent(in) :: self
    real(wp) :: kept(self%n_known())
    integer :: i, m, n, turn
    n = 0
    do turn = 1, 2
      do i = 1, size(self%elements)
        if (self%elements(i)%is_stop .neqv. turn == 1) cycle
        m = self%elements(i)%n_kept()
        kept(n + 1:n + m) = self%elements(i)%keep()
        n = n + m
      end do
    end do
  end function known

  subroutine recall(self, kept)
    class(switched_laws), intent(inout) :: self
    real(wp), intent(in) :: kept(:)
    integer :: i, m, n, turn
    n = 0
    do turn = 1, 2
      do i = 1, size(self%elements)
        if (self%elements(i)%is_stop .neqv. turn == 1) cycle
        m = self%elements(i)%n_kept()
        call self%elements(i)%recall(kept(n + 1:n + m))
        n = n + m
      end do
    end do
  end subroutine recall

  !> Subtract the laws from the accelerations of all other forces.
  pure subroutine add(self, q, v, a, mu, but)
    class(switched_laws), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(inout) :: a(n_lanes, self%n_dof)
    !> Position between the sides of each sliding surface, shape (n_lanes, n_slides).
    real(wp), intent(out), optional :: mu(:, :)
    !> Laws that are left out, by their index among those without state.
    integer, intent(in), optional :: but(:)
    real(wp) :: value(n_lanes)
    integer :: d, i, l

    do i = 1, size(self%elements)
      if (self%elements(i)%is_stop) cycle
      value = self%deflection(i, q)
      do l = 1, n_lanes
        value(l) = self%elements(i)%force(value(l))
      end do
      do d = 1, self%n_dof
        call add_multiple(a(:, d), -self%elements(i)%weights(d), value)
      end do
    end do
    do i = 1, size(self%laws)
      if (present(but)) then
        if (any(but == i)) cycle
      end if
      call evaluate_term(self%laws(i), q, v, value)
      do d = 1, size(a, 2)
        call add_multiple(a(:, d), -self%weights(d, i), value)
      end do
    end do
    if (self%n_slides() == 0) return
    call slide_along(self, q, v, a, mu)
  end subroutine add

  !> The force of each law at a state, in the order in which the laws were given: of hysteresis with
  !! its linear part, of a law that slides between its sides, of a stop while the motion rests.
  pure subroutine forces(self, q, v, a, force)
    class(switched_laws), intent(in) :: self
    !> The same state in every lane, and the accelerations that all else gives.
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: a(n_lanes, self%n_dof)
    real(wp), intent(out) :: force(:)
    real(wp) :: value(n_lanes), d(1), mu(n_lanes, self%n_slides()), total(n_lanes, self%n_dof)
    integer :: i, j, k

    force = 0.0_wp
    do i = 1, size(self%elements)
      if (self%elements(i)%is_stop) cycle
      d = self%deflection(i, q(:1, :))
      force(self%place_of_element(i)) = self%elements(i)%force(d(1)) &
                                        + self%elements(i)%stiffness*d(1)
    end do
    do i = 1, size(self%laws)
      call evaluate_term(self%laws(i), q, v, value)
      force(self%place_of_law(i)) = value(1)
    end do
    total = a
    call self%add(q, v, total, mu)
    do j = 1, self%n_slides()
      if (self%sliding(j)%stop > 0) then
        i = self%place_of_element(self%sliding(j)%stop)
        k = self%which(self%sliding(j)%leader)
        force(i) = force(i) + merge(mu(1, j), -mu(1, j), k == 1)
      end if
      do k = 1, size(self%sliding(j)%others)
        associate (pair => self%sliding(j)%others(k))
          i = self%place_of_law(pair%law)
          call evaluate_lanes(pair%program, self%laws(pair%law)%arguments_of_lanes(q, v), value)
          force(i) = force(i) - 0.5_wp*mu(1, j)*(one_side(pair%law) - value(1))
        end associate
      end do
    end do

  contains

    !> A law on the side that it is held on.
    pure real(wp) function one_side(law)
      integer, intent(in) :: law
      real(wp) :: values(n_lanes)
      call evaluate_term(self%laws(law), q, v, values)
      one_side = values(1)
    end function one_side

  end subroutine forces

  !> The same of laws without surfaces, with their derivatives (see `linearise` of systems).
  pure subroutine add_sloped(self, q, v, a, by_q, by_v)
    class(switched_laws), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(inout) :: a(n_lanes, self%n_dof)
    real(wp), intent(inout), dimension(n_lanes, self%n_dof, self%n_dof) :: by_q, by_v
    real(wp) :: value(n_lanes), slopes(n_lanes, most_arguments)
    integer :: b, d, i, k

    do i = 1, size(self%laws)
      associate (law => self%laws(i))
        call differentiate_term(law, q, v, value, slopes)
        do d = 1, self%n_dof
          call add_multiple(a(:, d), -self%weights(d, i), value)
          do b = 1, self%n_dof
            do k = 1, size(law%arguments, 1)
              call add_some(by_q(:, d, b), -self%weights(d, i)*law%arguments(k, b), slopes(:, k))
              call add_some(by_v(:, d, b), -self%weights(d, i)*law%rates(k, b), slopes(:, k))
            end do
          end do
        end do
      end associate
    end do
  end subroutine add_sloped

  !> total + c x. Most c are 0.
  pure subroutine add_some(total, c, x)
    real(wp), intent(inout) :: total(n_lanes)
    real(wp), intent(in) :: c, x(n_lanes)
    if (abs(c) > 0.0_wp) call add_multiple(total, c, x)
  end subroutine add_some

  !> Deflections of an element.
  pure function deflection(self, i, q) result(d)
    class(switched_laws), intent(in) :: self
    integer, intent(in) :: i
    real(wp), intent(in) :: q(:, :)
    real(wp) :: d(size(q, 1))
    integer :: j
    d = 0.0_wp
    do j = 1, self%n_dof
      if (abs(self%elements(i)%e(j)) > 0.0_wp) d = d + self%elements(i)%e(j)*q(:, j)
    end do
  end function deflection

  !> Normal of a stop's surface, and M^(-1) times it.
  pure subroutine normal(self, k, n, b)
    class(switched_laws), intent(in) :: self
    integer, intent(in) :: k
    real(wp), intent(out) :: n(self%n_dof), b(self%n_dof)
    real(wp) :: way
    way = merge(-1.0_wp, 1.0_wp, self%which(k) == 1)
    n = way*self%elements(self%element_of(k))%e
    b = way*self%elements(self%element_of(k))%weights
  end subroutine normal

  !> Correct the accelerations so that the solution remains on its sliding surfaces.
  pure subroutine slide_along(self, q, v, a, mu)
    class(switched_laws), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(inout) :: a(n_lanes, self%n_dof)
    real(wp), intent(out), optional :: mu(:, :)
    real(wp), dimension(n_lanes, self%n_dof, size(self%sliding)) :: b, n
    real(wp) :: c(n_lanes, size(self%sliding))
    real(wp) :: m(size(self%sliding), size(self%sliding)), x(size(self%sliding))
    integer :: i, j, l, turn

    call slide_directions(self, q, v, b, c, n)
    do i = 1, size(a, 1)
      if (present(mu)) mu(i, :) = 0.0_wp
      ! The second pass removes rounding errors of large forces. Without it a sticking mass would
      ! creep steadily.
      do turn = 1, 2
        do j = 1, size(x)
          x(j) = -(c(i, j) + dot_product(n(i, :, j), a(i, :)))
          m(j, :) = matmul(n(i, :, j), b(i, :, :))
        end do
        call solve(m, x)
        do l = 1, size(a, 2)
          a(i, l) = a(i, l) + dot_product(b(i, l, :), x)
        end do
        if (present(mu)) mu(i, :) = mu(i, :) + x
      end do
    end do
  end subroutine slide_along

  !> Project the velocities of a state onto the sliding surfaces, from which they differ by rounding
  !! errors, which would otherwise persist.
  subroutine stay(self, q, v)
    class(switched_laws), intent(in) :: self
    real(wp), intent(in) :: q(:)
    real(wp), intent(inout) :: v(:)
    real(wp), dimension(n_lanes, self%n_dof, size(self%sliding)) :: b, n
    real(wp), dimension(n_lanes, self%n_dof) :: some_q, some_v
    real(wp) :: m(size(self%sliding), size(self%sliding)), x(size(self%sliding))
    real(wp) :: c(n_lanes, size(self%sliding)), g(1)
    integer :: j

    some_q = spread(q, 1, n_lanes)
    some_v = spread(v, 1, n_lanes)
    call slide_directions(self, some_q, some_v, b, c, n)
    do j = 1, size(x)
      m(j, :) = matmul(n(1, :, j), b(1, :, :))
      if (self%sliding(j)%stop > 0) then
        x(j) = -dot_product(n(1, :, j), v)
      else
        call self%signals(self%sliding(j)%leader)%at([0.0_wp], some_q(:1, :), some_v(:1, :), g)
        x(j) = -g(1)
      end if
    end do
    call solve(m, x)
    if (all(abs(x) < wall)) v = v + matmul(b(1, :, :), x)
  end subroutine stay

  !> Accelerations by forces, shape (n_dof, n), less the parts that the sliding surfaces prevent.
  subroutine hold_back(self, pushes)
    class(switched_laws), intent(in) :: self
    real(wp), intent(inout) :: pushes(:, :)
    real(wp), dimension(n_lanes, self%n_dof, self%n_slides()) :: b, n
    real(wp), dimension(n_lanes, self%n_dof) :: at_rest
    real(wp) :: m(self%n_slides(), self%n_slides()), x(self%n_slides())
    real(wp) :: c(n_lanes, self%n_slides())
    integer :: j, k

    if (size(x) == 0) return
    at_rest = 0.0_wp
    call slide_directions(self, at_rest, at_rest, b, c, n)
    do k = 1, size(pushes, 2)
      do j = 1, size(x)
        m(j, :) = matmul(n(1, :, j), b(1, :, :))
        x(j) = -dot_product(n(1, :, j), pushes(:, k))
      end do
      call solve(m, x)
      if (all(abs(x) < wall)) pushes(:, k) = pushes(:, k) + matmul(b(1, :, :), x)
    end do
  end subroutine hold_back

  !> Largest acceleration by a law that jumps at rest. It balances the other forces on its surface.
  real(wp) function largest_jump(self)
    class(switched_laws), intent(in) :: self
    integer, allocatable :: sides(:)
    real(wp) :: above(1), below(1)
    integer :: i, j, k

    largest_jump = 0.0_wp
    do i = 1, size(self%free)
      associate (program => self%free(i)%program, n => size(self%free(i)%arguments, 1))
        sides = [(1, k=1, program%n_surfaces())]
        do j = 1, size(sides)
          call evaluate(held(program, sides), n, above)
          sides(j) = -1
          call evaluate(held(program, sides), n, below)
          sides(j) = 1
          if (max(abs(above(1)), abs(below(1))) >= wall) cycle
          largest_jump = max(largest_jump, 0.5_wp*abs(above(1) - below(1)) &
                             *maxval(abs(self%weights(:, i))))
        end do
      end associate
    end do

  contains

    subroutine evaluate(program, n, value)
      type(law_program), intent(in) :: program
      integer, intent(in) :: n
      real(wp), intent(out) :: value(1)
      real(wp) :: at_rest(1, n)
      at_rest = 0.0_wp
      call program%evaluate(at_rest, value)
    end subroutine evaluate

  end function largest_jump

  !> Evaluate a law with the rate 0 of an argument, or with its rate.
  subroutine freeze(self, law, argument, still)
    class(switched_laws), intent(inout) :: self
    integer, intent(in) :: law, argument
    logical, intent(in) :: still
    self%laws(law)%rates(argument, :) = self%free(law)%rates(argument, :)
    if (still) self%laws(law)%rates(argument, :) = 0.0_wp
  end subroutine freeze

  !> For each slide: b, the change of accelerations by its force; c and n, the derivatives of its
  !! signal along the velocities and by accelerations.
  pure subroutine slide_directions(self, q, v, b, c, n)
    class(switched_laws), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(out), dimension(n_lanes, self%n_dof, size(self%sliding)) :: b, n
    real(wp), intent(out) :: c(n_lanes, size(self%sliding))
    real(wp) :: one(n_lanes), other(n_lanes)
    real(wp), dimension(self%n_dof) :: normal, push
    integer :: d, j, k
    b = 0.0_wp
    do j = 1, size(self%sliding)
      if (self%sliding(j)%stop > 0) then
        call self%normal(self%sliding(j)%leader, normal, push)
        n(:, :, j) = spread(normal, 1, n_lanes)
        b(:, :, j) = spread(push, 1, n_lanes)
        c(:, j) = 0.0_wp
        cycle
      end if
      do k = 1, size(self%sliding(j)%others)
        associate (pair => self%sliding(j)%others(k))
          associate (law => self%laws(pair%law))
            call evaluate_lanes(law%program, law%arguments_of_lanes(q, v), one)
            call evaluate_lanes(pair%program, law%arguments_of_lanes(q, v), other)
          end associate
          do d = 1, self%n_dof
            b(:, d, j) = b(:, d, j) + self%weights(d, pair%law)*(0.5_wp*(one - other))
          end do
        end associate
      end do
      call gradient(self%signals(self%sliding(j)%leader), q, v, c(:, j), n(:, :, j))
    end do
  end subroutine slide_directions

  !> Time derivative of a signal: c from the velocities, n . a from the accelerations.
  pure subroutine gradient(signal, q, v, c, n)
    type(signal_type), intent(in) :: signal
    real(wp), intent(in) :: q(:, :), v(:, :)
    real(wp), intent(out) :: c(:), n(:, :)
    real(wp) :: slopes(size(c), size(signal%by_q, 1)), value(size(c)), by_q(size(c), size(n, 2))
    call signal%program%differentiate(matmul(q, transpose(signal%by_q)) &
                                      + matmul(v, transpose(signal%by_v)), value, slopes)
    by_q = matmul(slopes, signal%by_q)
    c = sum(by_q*v, 2)
    n = matmul(slopes, signal%by_v)
  end subroutine gradient

  !> Time derivative of a signal at a state with given accelerations.
  real(wp) function rate(self, k, q, v, a)
    class(switched_laws), intent(in) :: self
    integer, intent(in) :: k
    real(wp), intent(in) :: q(:), v(:), a(:)
    real(wp) :: c(1), n(1, size(q))
    call gradient(self%signals(k), reshape(q, [1, size(q)]), reshape(v, [1, size(v)]), c, n)
    rate = c(1) + dot_product(n(1, :), a)
  end function rate

end module viscovib_switched_laws
