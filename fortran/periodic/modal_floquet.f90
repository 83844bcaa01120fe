! Optimize: -O3
!> Monodromy matrices of a structure by its modes: small perturbations of a periodic motion,
!!
!!   q_m'' + rate_m q_m' + square_m q_m = sum_l pushed_ml f_l,   z_m' = pole_m z_m + right_ml f_l,
!!   f = -L(t) w - D(t) w',   w_j = sum_m seen_mj q_m + Re sum_m left_mj z_m,
!!
!! with the derivatives L and D of the forces of the elements by the deflections w and their rates
!! along the motion. Over a step the linear subsystem is exact (viscovib_section_step), f is the
!! polynomial through its values at the Gauss nodes:
!!
!!   w = W y_0 + H f,   w' = V y_0 + G f,   (I + L H + D G) f = -(L W + D V) y_0.
!!
!! There are as many equations as deflections times nodes, for any number of modes. A step whose
!! polynomial does not represent f is halved. Steps end at the kinks of laws.
module viscovib_modal_floquet
  use viscovib_constants, only: pi
  use viscovib_cycle_terms, only: has_states
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_kinked_motion, only: element_along, prepare_elements
  use viscovib_monodromy_step, only: n_nodes, new_step_table, step_table
  use viscovib_phase_roots, only: phase_list
  use viscovib_product_eigenvalues, only: largest_factor, product_type
  use viscovib_quadrature, only: lagrange, lagrange_factors, legendre_of_nodes
  use viscovib_section_step, only: driven_section, free_section, grown, legendre_moments
  use viscovib_stopping, only: is_set
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: modal_floquet, new_modal_floquet, states_of_modes

  !> Phase that the fastest mode turns in a step at first; smallest and largest number of steps
  !! relative to that.
  real(wp), parameter :: phase_a_step = 1.5_wp, least_density = 0.5_wp, largest_density = 32.0_wp
  !> Relative error of a step, by its estimate, and the number of halvings after which a step is
  !! accepted with any error.
  real(wp), parameter :: wanted_error = 2.0e-14_wp
  integer, parameter :: most_halvings = 36
  !> Largest number of steps, and of states.
  integer, parameter :: max_steps = 20000, most_states = 128
  !> Largest difference of the slopes of laws between the nodes from their polynomial, relative to
  !! the largest slope.
  real(wp), parameter :: unseen = 1.0e-3_wp
  !> Smallest pivot of the equations of a step that is short enough.
  real(wp), parameter :: least_pivot = 0.01_wp
  !> Entries beyond this are not accurate.
  real(wp), parameter :: largest = 1.0e100_wp
  !> Number of full steps along which the derivatives of laws are computed together.
  integer, parameter :: together = 16

  !> Maps of a step. A state is (q, unit q', Re z, Im z); point p of deflection j has the place
  !! (j-1) n_nodes + p, and point k of force l similarly.
  type :: step_maps
    real(wp) :: h = 0.0_wp
    !> W and V by states, shape (n_states, n_points), H and G, shape (n_points, n_points).
    real(wp), allocatable :: w(:, :), v(:, :), w_by_f(:, :), v_by_f(:, :)
    !> State at the end by that at the start: of a mode, shape (2, 2, n_modes), and of z, shape
    !! (n_poles). By f, shape (n_points, n_states).
    real(wp), allocatable :: modes(:, :, :), by_f(:, :)
    complex(wp), allocatable :: poles(:)
  end type step_maps

  type :: modal_floquet
    integer :: n_states = 0
    integer, private :: n_modes = 0, n_seen = 0
    type(harmonic_set_type), private :: set
    integer, allocatable, private :: rates(:)
    !> Upper bound of the frequencies and of the damping rates (1/s).
    real(wp), private :: fastest = 0.0_wp
    real(wp), allocatable, private :: squares(:), losses(:), seen(:, :), pushed(:, :)
    !> One pole of each conjugate pair, with twice its part of w, and the real ones; the place of Re
    !! z of each among the states, and 0 or the place of Im z.
    complex(wp), allocatable, private :: poles(:), left(:, :), right(:, :)
    integer, allocatable, private :: real_part(:), imaginary_part(:)
    !> Rates of w by forces, shape (n_seen, n_seen); sums of squares of `pushed` and `right`.
    real(wp), allocatable, private :: through(:, :)
    real(wp), allocatable, private :: push_of_modes(:), push_of_poles(:)
    type(step_table), private :: table
    !> Factors of values at the nodes in Legendre coefficients, and these coefficients of the
    !! polynomials up to each node and the end.
    real(wp), private :: to_orders(n_nodes, 0:n_nodes - 1) = 0.0_wp
    real(wp), private :: coefficients(n_nodes, n_nodes, n_nodes + 1) = 0.0_wp
    !> Points of a step before, between and after its nodes, and the values there of polynomials of
    !! unit value at one node.
    real(wp), private :: others(n_nodes + 1) = 0.0_wp, to_others(n_nodes + 1, n_nodes) = 0.0_wp
    type(step_maps), private :: maps(0:most_halvings)
    !> Frequency, unit of time and step, harmonics, perturbations, shape (n_states, n_states) with
    !! one perturbation in each row, number of steps, and whether they went well.
    real(wp), private :: nu = 0.0_wp, unit = 0.0_wp, step = 0.0_wp
    real(wp), allocatable, private :: x(:, :), y(:, :)
    integer, private :: n_steps = 0
    !> Full steps that are needed, relative to those by the phase; number of them that were halved;
    !! largest error of the others.
    real(wp), private :: density = 1.0_wp
    integer, private :: n_halved = 0
    real(wp), private :: worst = 0.0_wp
    logical, private :: fine = .true.
    !> Minus the logarithm of the determinant since the last factor, by Liouville's formula.
    real(wp), private :: shrunk = 0.0_wp
  contains
    procedure :: monodromy
    procedure, private :: slopes_along
    procedure, private :: make_maps
    procedure, private :: add_poles
    procedure, private :: pass
    procedure, private :: is_seen
    procedure, private :: try_step
    procedure, private :: move
  end type modal_floquet

contains

  !> Number of states of a structure whose perturbations can be integrated; 0: too many, or memory,
  !! or states of elements.
  integer function states_of_modes(system) result(n)
    class(structure_type), intent(in) :: system

    n = 0
    if (any(system%kernel_of > 0) .or. system%moving .or. has_states(system)) return
    associate (rest => system%rest)
      if (any(abs(rest%losses(:rest%n_modes)) > 0.0_wp) .or. any(abs(rest%flexibility) > 0.0_wp) &
          .or. any(abs(rest%flexibility_rate) > 0.0_wp)) return
      n = 2*rest%n_modes + size(rest%poles)
    end associate
    if (n > most_states) n = 0
  end function states_of_modes

  subroutine new_modal_floquet(self, system, set)
    type(modal_floquet), intent(out) :: self
    class(structure_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    integer, allocatable :: kept(:)
    integer :: i, j, l

    self%set = set
    allocate (self%rates(0))
    if (system%n_rates() > 0) self%rates = system%rates
    self%n_seen = system%n_dof()
    call new_step_table(self%table)
    self%to_orders = transpose(legendre_of_nodes(self%table%c, self%table%b, 1.0_wp))
    do i = 1, n_nodes
      self%coefficients(:, :, i) = legendre_of_nodes(self%table%c, self%table%b, self%table%c(i))
    end do
    self%coefficients(:, :, n_nodes + 1) = legendre_of_nodes(self%table%c, self%table%b, 1.0_wp)
    associate (c => self%table%c)
      self%others = 0.5_wp*([c, 1.0_wp] + [0.0_wp, c])
      self%others(1) = c(1)/3.0_wp
      self%others(n_nodes + 1) = 1.0_wp - c(1)/3.0_wp
      do i = 1, n_nodes + 1
        self%to_others(i, :) = lagrange(c, lagrange_factors(c), self%others(i))
      end do
    end associate
    associate (rest => system%rest)
      self%n_modes = rest%n_modes
      self%squares = rest%squares(:rest%n_modes)
      self%losses = rest%rates(:rest%n_modes)
      self%seen = rest%seen(:rest%n_modes, :)
      self%pushed = rest%pushed(:rest%n_modes, :)
      kept = pack([(i, i=1, size(rest%poles))], aimag(rest%poles) >= 0.0_wp)
      self%poles = rest%poles(kept)
      self%left = rest%left(kept, :)
      self%right = rest%right(kept, :)
    end associate
    self%through = matmul(transpose(self%seen), self%pushed)
    allocate (self%real_part(size(kept)), self%imaginary_part(size(kept)), source=0)
    self%n_states = 2*self%n_modes
    do i = 1, size(kept)
      self%n_states = self%n_states + 1
      self%real_part(i) = self%n_states
      if (.not. aimag(self%poles(i)) > 0.0_wp) cycle
      self%left(i, :) = 2.0_wp*self%left(i, :)
      self%n_states = self%n_states + 1
      self%imaginary_part(i) = self%n_states
    end do
    do j = 1, self%n_seen
      do l = 1, self%n_seen
        self%through(j, l) = self%through(j, l) &
                             + real(sum(self%left(:, j)*self%poles*self%right(:, l)))
      end do
    end do
    self%push_of_modes = sum(self%pushed**2, 1)
    self%push_of_poles = sum(abs(self%right)**2, 1)
    self%fastest = max(sqrt(maxval([0.0_wp, abs(self%squares)])), &
                       maxval([0.0_wp, abs(aimag(self%poles))]), tiny(1.0_wp))
    allocate (self%y(self%n_states, self%n_states))
  end subroutine new_modal_floquet

  !> The matrix that advances perturbations over a period; under half-wave symmetry minus that of
  !! half a period.
  subroutine monodromy(self, system, nu, x, matrix, found, cancel, product)
    class(modal_floquet), intent(inout) :: self
    class(structure_type), intent(in) :: system
    !> Frequency (rad/s); harmonics, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: nu, x(:, :)
    !> Shape (n_states, n_states).
    real(wp), intent(out) :: matrix(:, :)
    !> False if too many steps would be needed, or if the matrix overflows.
    logical, intent(out) :: found
    !> May be set by another thread to cancel.
    integer, intent(inout), optional :: cancel
    !> Factors of the matrix, up to the sign; `matrix` is then the last of them.
    type(product_type), intent(inout), optional :: product
    type(element_along), allocatable :: none(:)
    type(phase_list) :: breaks
    real(wp) :: turn, from, to, longest
    integer :: i

    turn = merge(pi, 2.0_wp*pi, self%set%half_wave)
    found = turn/nu*self%fastest/phase_a_step <= max_steps
    if (.not. found) return
    longest = min(phase_a_step/self%fastest, turn/nu/max(2.0_wp, &
                                                         merge(1.0_wp, 2.0_wp, self%set%half_wave) &
                                                         *maxval(self%set%orders)/n_nodes))
    self%nu = nu
    self%unit = longest
    longest = longest/self%density
    self%n_halved = 0
    self%worst = 0.0_wp
    self%x = x
    self%n_steps = 0
    self%fine = .true.
    call begin(self)
    call prepare_elements(system, self%set, x, self%set%orders*nu, none, breaks)
    from = 0.0_wp
    do i = 1, breaks%n + 1
      to = turn
      if (i <= breaks%n) to = min(breaks%theta(i), turn)
      if (to - from > 8.0_wp*epsilon(1.0_wp)*turn) then
        call between(self, system, from/nu, to/nu, longest, cancel, product)
        from = to
      end if
    end do
    ! The next motion is often a neighbour.
    if (2*self%n_halved > nint(turn/nu/longest)) then
      self%density = min(1.5_wp*self%density, largest_density)
    else if (self%n_halved == 0) then
      self%density = max(least_density, self%density*max(0.5_wp, min(1.0_wp, (2.0_wp*self%worst &
                                                            /wanted_error)**(0.5_wp/n_nodes))))
    end if
    if (present(product)) call product%append(transpose(self%y))
    matrix = merge(-1.0_wp, 1.0_wp, self%set%half_wave)*transpose(self%y)
    found = self%fine
  end subroutine monodromy

  !> Pass the time between two kinks of laws, in equal steps.
  subroutine between(self, system, from, to, longest, cancel, product)
    type(modal_floquet), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: from, to, longest
    integer, intent(inout), optional :: cancel
    type(product_type), intent(inout), optional :: product
    real(wp), allocatable :: stiffness(:, :, :), damping(:, :, :)
    integer :: first, i, n, n_full

    n_full = ceiling((to - from)/longest)
    self%step = (to - from)/n_full
    self%maps%h = 0.0_wp
    do first = 1, n_full, together
      if (is_set(cancel)) self%fine = .false.
      if (.not. self%fine) return
      n = min(together, n_full - first + 1)
      call self%slopes_along(system, from + (first - 1)*self%step, self%step, n, self%table%c, &
                             stiffness, damping)
      do i = 1, n
        call self%pass(system, 0, from + (first + i - 2)*self%step, &
                       stiffness(:, :, (i - 1)*n_nodes + 1:i*n_nodes), &
                       damping(:, :, (i - 1)*n_nodes + 1:i*n_nodes), product)
        if (.not. self%fine) return
      end do
    end do
  end subroutine between

  !> Perturbations of size 1, one of each state.
  pure subroutine begin(self)
    class(modal_floquet), intent(inout) :: self
    integer :: i
    self%shrunk = 0.0_wp
    self%y = 0.0_wp
    do i = 1, self%n_states
      self%y(i, i) = 1.0_wp
    end do
  end subroutine begin

  !> L and D at points of n steps h from time t, shape (n_seen, n_seen, n n_points).
  subroutine slopes_along(self, system, t, h, n, points, stiffness, damping)
    class(modal_floquet), intent(in) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: t, h
    integer, intent(in) :: n
    !> Points of a step, in [0, 1].
    real(wp), intent(in) :: points(:)
    real(wp), allocatable, intent(inout) :: stiffness(:, :, :), damping(:, :, :)
    real(wp) :: u(n*size(points), self%n_seen + size(self%rates))
    real(wp) :: waves(size(u, 1), size(self%x, 1))
    real(wp) :: slopes(size(u, 1), system%n_memory(), size(u, 2)), rates(size(self%x, 1))
    complex(wp) :: wave(size(u, 1)), turn(size(u, 1))
    integer :: b, i, k, m

    m = self%n_seen
    do i = 0, n - 1
      turn(i*size(points) + 1:(i + 1)*size(points)) = exp(cmplx(0.0_wp, self%nu &
                                                              *(t + h*(i + points)), wp))
    end do
    wave = turn**self%set%orders(1)
    if (self%set%half_wave) turn = turn**2
    do k = 1, size(self%set%orders)
      waves(:, 2*k - 1) = aimag(wave)
      waves(:, 2*k) = real(wave)
      wave = wave*turn
    end do
    u(:, :m) = matmul(waves, self%x)
    do b = 1, size(self%rates)
      rates(1::2) = -self%set%orders*self%nu*self%x(2::2, self%rates(b))
      rates(2::2) = self%set%orders*self%nu*self%x(1::2, self%rates(b))
      u(:, m + b) = matmul(waves, rates)
    end do
    slopes = 0.0_wp
    if (any(system%bent)) call system%deflection_slopes(u, slopes)
    do k = 1, size(system%bent)
      if (.not. system%bent(k)) slopes(:, k, :) = 0.0_wp
    end do
    if (allocated(stiffness)) deallocate (stiffness, damping)
    allocate (stiffness(m, m, size(u, 1)), damping(m, m, size(u, 1)), source=0.0_wp)
    do i = 1, size(u, 1)
      stiffness(:, :, i) = matmul(system%spread, system%gather + slopes(i, :, :m))
      if (size(self%rates) == 0) cycle
      damping(:, self%rates, i) = matmul(system%spread, slopes(i, :, m + 1:))
    end do
  end subroutine slopes_along

  !> Pass a step that was halved `level` times, in parts if necessary.
  recursive subroutine pass(self, system, level, t, stiffness, damping, product)
    class(modal_floquet), intent(inout) :: self
    class(structure_type), intent(in) :: system
    integer, intent(in) :: level
    !> Start of the step; L and D at its nodes.
    real(wp), intent(in) :: t, stiffness(:, :, :), damping(:, :, :)
    type(product_type), intent(inout), optional :: product
    real(wp), allocatable :: halves(:, :, :), drags(:, :, :)
    real(wp) :: h
    logical :: made

    self%n_steps = self%n_steps + 1
    self%fine = self%fine .and. self%n_steps <= max_steps
    if (.not. self%fine) return
    h = self%step*0.5_wp**level
    if (.not. self%maps(level)%h > 0.0_wp) call self%make_maps(self%maps(level), h)
    made = level == most_halvings .or. self%is_seen(system, t, h, stiffness, damping)
    if (made) call self%try_step(self%maps(level), level == most_halvings, stiffness, damping, made)
    if (.not. made) then
      if (level == 0) self%n_halved = self%n_halved + 1
      h = 0.5_wp*h
      call self%slopes_along(system, t, h, 2, self%table%c, halves, drags)
      call self%pass(system, level + 1, t, halves(:, :, :n_nodes), drags(:, :, :n_nodes), product)
      call self%pass(system, level + 1, t + h, halves(:, :, n_nodes + 1:), &
                     drags(:, :, n_nodes + 1:), product)
      return
    end if
    if (.not. present(product)) then
      self%fine = all(abs(self%y) <= largest)
      return
    end if
    self%shrunk = self%shrunk + h*shrinking(self, damping)
    if (maxval(abs(self%y)) <= largest_factor .and. self%shrunk <= log(largest_factor)) return
    call product%append(transpose(self%y))
    call begin(self)
  end subroutine pass

  !> True if the nodes of a step see all that force laws do in it, such as thin layers.
  logical function is_seen(self, system, t, h, stiffness, damping)
    class(modal_floquet), intent(in) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: t, h, stiffness(:, :, :), damping(:, :, :)
    real(wp), allocatable :: springs(:, :, :), drags(:, :, :)

    is_seen = .true.
    if (size(system%laws) == 0) return
    call self%slopes_along(system, t, h, 1, self%others, springs, drags)
    is_seen = follows(stiffness, springs) .and. follows(damping, drags)

  contains

    logical function follows(at_nodes, values)
      real(wp), intent(in) :: at_nodes(:, :, :), values(:, :, :)
      real(wp) :: off
      integer :: i, j
      off = 0.0_wp
      do j = 1, size(values, 2)
        do i = 1, size(values, 1)
          off = max(off, maxval(abs(values(i, j, :) - matmul(self%to_others, at_nodes(i, j, :)))))
        end do
      end do
      follows = off <= unseen*max(maxval(abs(values)), maxval(abs(at_nodes)))
    end function follows

  end function is_seen

  !> Minus the trace of the equations, its mean over a step.
  pure real(wp) function shrinking(self, damping)
    class(modal_floquet), intent(in) :: self
    real(wp), intent(in) :: damping(:, :, :)
    integer :: i

    shrinking = sum(self%losses) - sum(merge(2.0_wp, 1.0_wp, self%imaginary_part > 0) &
                                       *real(self%poles))
    do i = 1, n_nodes
      shrinking = shrinking + self%table%b(i)*sum(damping(:, :, i)*transpose(self%through))
    end do
  end function shrinking

  !> The maps of a step h.
  subroutine make_maps(self, maps, h)
    class(modal_floquet), intent(in) :: self
    type(step_maps), intent(inout) :: maps
    real(wp), intent(in) :: h
    real(wp), dimension(n_nodes) :: gain, rate_gain, by_order, rates
    real(wp) :: by_q(2), by_v(2), now
    integer :: j, l, m, n, p, row, s

    n = self%n_modes
    s = n_nodes
    if (.not. allocated(maps%w)) then
      allocate (maps%w(self%n_states, s*self%n_seen), maps%by_f(s*self%n_seen, self%n_states))
      allocate (maps%v, mold=maps%w)
      allocate (maps%w_by_f(s*self%n_seen, s*self%n_seen), maps%modes(2, 2, n), &
                maps%poles(size(self%poles)))
      allocate (maps%v_by_f, mold=maps%w_by_f)
    end if
    maps%h = h
    maps%w_by_f = 0.0_wp
    maps%v_by_f = 0.0_wp
    do p = 1, s + 1
      now = h
      if (p <= s) now = h*self%table%c(p)
      do m = 1, n
        associate (square => self%squares(m)*now**2, rate => self%losses(m)*now)
          call free_section(square, rate, by_q, by_v)
          call driven_section(square, rate, by_order, rates)
        end associate
        ! The second part of a state is unit q'.
        by_q = [1.0_wp + by_q(1), by_q(2)*self%unit/now]
        by_v = [by_v(1)*now/self%unit, 1.0_wp + by_v(2)]
        gain = now**2*matmul(by_order, self%coefficients(:, :, p))
        rate_gain = self%unit*now*matmul(rates, self%coefficients(:, :, p))
        if (p > s) then
          maps%modes(:, 1, m) = by_q
          maps%modes(:, 2, m) = by_v
          do l = 1, self%n_seen
            maps%by_f((l - 1)*s + 1:l*s, m) = self%pushed(m, l)*gain
            maps%by_f((l - 1)*s + 1:l*s, n + m) = self%pushed(m, l)*rate_gain
          end do
          cycle
        end if
        do j = 1, self%n_seen
          row = (j - 1)*s + p
          maps%w([m, n + m], row) = self%seen(m, j)*[by_q(1), by_v(1)]
          maps%v([m, n + m], row) = self%seen(m, j)/self%unit*[by_q(2), by_v(2)]
          do l = 1, self%n_seen
            associate (both => self%seen(m, j)*self%pushed(m, l), from => (l - 1)*s)
              maps%w_by_f(row, from + 1:from + s) = maps%w_by_f(row, from + 1:from + s) + both*gain
              maps%v_by_f(row, from + 1:from + s) = maps%v_by_f(row, from + 1:from + s) &
                                                    + both/self%unit*rate_gain
            end associate
          end do
        end do
      end do
      call self%add_poles(maps, now, p)
    end do
  end subroutine make_maps

  !> Add the part without real modes to the maps of a step, at its point p.
  subroutine add_poles(self, maps, now, p)
    class(modal_floquet), intent(in) :: self
    type(step_maps), intent(inout) :: maps
    real(wp), intent(in) :: now
    integer, intent(in) :: p
    complex(wp) :: gain(n_nodes), moments(n_nodes), turned, left
    integer :: j, l, m, row, s

    s = n_nodes
    do m = 1, size(self%poles)
      turned = 1.0_wp + grown(self%poles(m)*now)
      call legendre_moments(self%poles(m)*now, moments)
      gain = now*matmul(moments, self%coefficients(:, :, p))
      associate (re => self%real_part(m), im => self%imaginary_part(m))
        if (p > s) then
          maps%poles(m) = turned
          do l = 1, self%n_seen
            maps%by_f((l - 1)*s + 1:l*s, re) = real(self%right(m, l)*gain)
            if (im > 0) maps%by_f((l - 1)*s + 1:l*s, im) = aimag(self%right(m, l)*gain)
          end do
          cycle
        end if
        do j = 1, self%n_seen
          row = (j - 1)*s + p
          left = self%left(m, j)
          maps%w(re, row) = real(left*turned)
          maps%v(re, row) = real(left*self%poles(m)*turned)
          if (im > 0) then
            maps%w(im, row) = -aimag(left*turned)
            maps%v(im, row) = -aimag(left*self%poles(m)*turned)
          end if
          do l = 1, self%n_seen
            maps%w_by_f(row, (l - 1)*s + 1:l*s) = maps%w_by_f(row, (l - 1)*s + 1:l*s) &
                                                  + real(left*self%right(m, l)*gain)
            maps%v_by_f(row, (l - 1)*s + 1:l*s) = maps%v_by_f(row, (l - 1)*s + 1:l*s) &
                                                  + real(left*self%poles(m)*self%right(m, l)*gain)
          end do
        end do
      end associate
    end do
  end subroutine add_poles

  !> Advance the perturbations over a step, unless the polynomial through the nodes does not
  !! represent f.
  subroutine try_step(self, maps, last, stiffness, damping, made)
    class(modal_floquet), intent(inout) :: self
    type(step_maps), intent(in) :: maps
    !> True if any error is accepted.
    logical, intent(in) :: last
    real(wp), intent(in) :: stiffness(:, :, :), damping(:, :, :)
    logical, intent(out) :: made
    real(wp) :: f(self%n_states, n_nodes*self%n_seen), equations(size(f, 2), size(f, 2))
    real(wp) :: read_by(self%n_states, size(f, 2))
    real(wp) :: error
    integer :: i
    logical :: singular

    equations = 0.0_wp
    f = 0.0_wp
    call multiply(self%n_states, self%n_states, size(f, 2), self%y, maps%w, read_by)
    call add_forces(stiffness, maps%w_by_f, read_by, equations, f)
    if (size(self%rates) > 0) then
      call multiply(self%n_states, self%n_states, size(f, 2), self%y, maps%v, read_by)
      call add_forces(damping, maps%v_by_f, read_by, equations, f)
    end if
    do i = 1, size(equations, 1)
      equations(i, i) = equations(i, i) + 1.0_wp
    end do
    call eliminate(self%n_states, size(equations, 1), equations, f, singular)
    made = .not. singular
    if (.not. made) then
      self%fine = .not. last
      return
    end if
    error = error_of(self, maps%h, f)
    made = last .or. error <= wanted_error
    if (.not. made) return
    self%worst = max(self%worst, error)
    call self%move(maps, f)
  end subroutine try_step

  !> Add the forces of laws at the nodes, by the forces and by the states at the start.
  pure subroutine add_forces(slopes, by_f, by_state, equations, f)
    !> L or D, shape (n_seen, n_seen, n_nodes), and what they multiply.
    real(wp), intent(in) :: slopes(:, :, :), by_f(:, :), by_state(:, :)
    real(wp), intent(inout) :: equations(:, :), f(:, :)
    integer :: i, j, p

    do p = 1, n_nodes
      do j = 1, size(slopes, 2)
        do i = 1, size(slopes, 1)
          if (.not. abs(slopes(i, j, p)) > 0.0_wp) cycle
          associate (slope => slopes(i, j, p), to => (i - 1)*n_nodes + p, &
                     from => (j - 1)*n_nodes + p)
            equations(to, :) = equations(to, :) + slope*by_f(from, :)
            f(:, to) = f(:, to) - slope*by_state(:, from)
          end associate
        end do
      end do
    end do
  end subroutine add_forces

  !> Estimate of the relative error of a step, from the decay of the Legendre coefficients of each
  !! force: the product of those of degree n_nodes of f and of the adjoint solution, and that of
  !! degree 2 n_nodes, which the nodes take for a mean; times the part of f in the change of the
  !! state.
  pure real(wp) function error_of(self, h, f) result(error)
    class(modal_floquet), intent(in) :: self
    real(wp), intent(in) :: h, f(:, :)
    real(wp) :: sums(size(f, 1)), sizes(0:n_nodes - 1), total, last, decay, part, ends(2)
    integer :: i, k, l, n

    n = self%n_modes
    ends = tiny(1.0_wp)
    do i = 1, n
      ends(1) = ends(1) + sum(self%y(:, n + i)**2) + abs(self%squares(i))*self%unit**2 &
                *sum(self%y(:, i)**2)
    end do
    ends(2) = max(ends(2), sum(self%y(:, 2*n + 1:)**2))
    error = 0.0_wp
    do l = 1, self%n_seen
      do k = 0, n_nodes - 1
        sums = 0.0_wp
        do i = 1, n_nodes
          sums = sums + self%to_orders(i, k)*f(:, (l - 1)*n_nodes + i)
        end do
        sizes(k) = sum(sums**2)
      end do
      total = sum(sizes)
      if (.not. total > 0.0_wp) cycle
      part = total*h**2*max(self%unit**2*self%push_of_modes(l)/ends(1), &
                            self%push_of_poles(l)/ends(2))
      ! From a degree to that after the next: coefficients of even or odd degrees may be small.
      last = sum(sizes(n_nodes - 2:))
      decay = min(1.0_wp, max(sizes(n_nodes - 1)/max(sizes(n_nodes - 2), tiny(1.0_wp)), &
                              sqrt(last/max(sum(sizes(n_nodes - 4:n_nodes - 3)), tiny(1.0_wp)))))
      last = last/total
      error = max(error, max(2.0_wp/(2*n_nodes + 1)*last*decay**2, &
                             sqrt(last)*decay**(n_nodes/2 + 1))*min(1.0_wp, sqrt(part)))
    end do
  end function error_of

  !> The perturbations at the end of a step.
  subroutine move(self, maps, f)
    class(modal_floquet), intent(inout) :: self
    type(step_maps), intent(in) :: maps
    real(wp), intent(in) :: f(:, :)
    real(wp) :: next(self%n_states, self%n_states)
    integer :: m, n

    n = self%n_modes
    call multiply(self%n_states, size(f, 2), self%n_states, f, maps%by_f, next)
    do m = 1, n
      associate (of => maps%modes(:, :, m))
        next(:, m) = next(:, m) + of(1, 1)*self%y(:, m) + of(1, 2)*self%y(:, n + m)
        next(:, n + m) = next(:, n + m) + of(2, 1)*self%y(:, m) + of(2, 2)*self%y(:, n + m)
      end associate
    end do
    do m = 1, size(self%poles)
      associate (re => self%real_part(m), im => self%imaginary_part(m), of => maps%poles(m))
        next(:, re) = next(:, re) + real(of)*self%y(:, re)
        if (im == 0) cycle
        next(:, re) = next(:, re) - aimag(of)*self%y(:, im)
        next(:, im) = next(:, im) + aimag(of)*self%y(:, re) + real(of)*self%y(:, im)
      end associate
    end do
    self%y = next
  end subroutine move

  !> Solve a x = f for each row of f, which x replaces. The matrix of a short step is close to the
  !! identity, so rows are not exchanged.
  pure subroutine eliminate(n, m, a, f, singular)
    integer, intent(in) :: n, m
    real(wp), intent(inout) :: a(m, m), f(n, m)
    logical, intent(out) :: singular
    integer :: i, j

    singular = .false.
    do j = 1, m
      if (.not. abs(a(j, j)) > least_pivot) singular = .true.
      if (singular) return
      a(j, j) = 1.0_wp/a(j, j)
      do i = j + 1, m
        a(i, j) = a(i, j)*a(j, j)
      end do
      do i = j + 1, m
        a(j + 1:, i) = a(j + 1:, i) - a(j + 1:, j)*a(j, i)
        f(:, i) = f(:, i) - a(i, j)*f(:, j)
      end do
    end do
    do j = m, 1, -1
      f(:, j) = a(j, j)*f(:, j)
      do i = 1, j - 1
        f(:, i) = f(:, i) - a(i, j)*f(:, j)
      end do
    end do
  end subroutine eliminate

  !> c = a b, vectorized over the rows of a.
  pure subroutine multiply(n, m, k, a, b, c)
    integer, intent(in) :: n, m, k
    real(wp), intent(in) :: a(n, m), b(m, k)
    real(wp), intent(out) :: c(n, k)
    integer :: i, j

    c = 0.0_wp
    do j = 1, k
      do i = 1, m - 3, 4
        c(:, j) = c(:, j) + (a(:, i)*b(i, j) + a(:, i + 1)*b(i + 1, j)) &
                  + (a(:, i + 2)*b(i + 2, j) + a(:, i + 3)*b(i + 3, j))
      end do
      do i = m - mod(m, 4) + 1, m
        c(:, j) = c(:, j) + a(:, i)*b(i, j)
      end do
    end do
  end subroutine multiply

end module viscovib_modal_floquet
