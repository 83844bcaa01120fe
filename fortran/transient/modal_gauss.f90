! Optimize: -O3
!> Gauss-Legendre collocation of the forces on a linear subsystem in modal coordinates (sections),
!! whose steps are exact (viscovib_modal_frame).
!!
!! In sections x the equations are x'' + rate x' + square x = p(x, x', t). With p the polynomial
!! through its values p_j at the nodes,
!!
!!   x(c_i h) = by_x_i x_0 + by_v_i x'_0 + sum_j gain_ij p_j,
!!
!! and similarly for x' and at the end (viscovib_section_step). Fixed-point iteration starts from
!! the polynomial of the step before. Steps need to resolve p only, not the frequencies of the
!! linear subsystem. The order at the ends of steps is that of Gauss's quadrature, twice the number
!! of nodes. The interface of the type uses the coordinates themselves as state.
module viscovib_modal_gauss
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_counters, only: count_up, counted_accelerations, counted_coordinates, &
    counted_loads, counted_turns, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_gauss_table, only: gauss_table_type, new_gauss_table
  use viscovib_hereditary_kernels, only: add_up
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_modal_frame, only: modal_frame
  use viscovib_phases, only: new_phases, phases_type, turn_phase
  use viscovib_quadrature, only: legendre_of_nodes
  use viscovib_section_step, only: driven_section, free_section, relaxing_section
  use viscovib_steep_forces, only: solve_steep
  use viscovib_steep_laws, only: root_of_rate
  use viscovib_step_path, only: new_path, step_path
  use viscovib_stepper, only: stepper_type
  implicit none
  private

  public :: modal_gauss_type, new_modal_gauss

  !> Iterations of a step before it is repeated from a constant start.
  integer, parameter :: max_iterations = 40
  !> Relative change that a step does not resolve; changes of numbers near underflow.
  real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp), negligible = 1.0e-300_wp
  !> Last coefficients of a force, relative to its largest value, that its polynomial represents.
  real(wp), parameter :: represented = 1.0e-8_wp
  !> Largest factor by which rounding errors of a rate, relative to its change by the force in a
  !! step, change the force at the nodes.
  real(wp), parameter :: enlarged = 1.0e3_wp
  !> The same of the other forces at the nodes.
  real(wp), parameter :: amplified = 100.0_wp
  !> Degree of the polynomial that predicts a step.
  integer, parameter :: prediction_degree = 5

  !> Maps of sections for steps of one length: change by the state at the
  !! nodes, shape (n_lanes, n), and the end, (n); by pushes at nodes, (n_lanes, s, n) and (s, n).
  type :: section_maps
    real(wp) :: h = 0.0_wp
    real(wp), allocatable, dimension(:, :) :: x_by_x, x_by_v, v_by_x, v_by_v, end_x, end_v
    real(wp), allocatable :: end_state(:, :, :), x_by_push(:, :, :), v_by_push(:, :, :)
    !> Change of a section, with its rate times h, by a unit push at all nodes, shape (n).
    real(wp), allocatable :: size_of_push(:)
    !> Rates of steep laws at the nodes by their forces, shape (s, n_steep, s, n_steep).
    real(wp), allocatable :: steep_gains(:, :, :, :)
  end type section_maps

  type, extends(stepper_type) :: modal_gauss_type
    type(gauss_table_type) :: table
    type(phases_type) :: phases
    !> Iteration stops when the sections change relatively by less than this.
    real(wp) :: tolerance = 0.0_wp
    !> Sections, their rates, and the rounding errors of both, shape (n).
    real(wp), allocatable :: x(:), x_rate(:), x_rest(:), rate_rest(:)
    !> True if these agree with the state; true if pushes of a previous step exist.
    logical, private :: x_follows = .false., rate_follows = .false., has_history = .false.
    !> Maps for the full steps of a run and for the last partial step; index of the present one.
    type(section_maps), private :: maps(2)
    integer, private :: now = 1
    !> Legendre coefficients of the polynomials up to each node and the end, (s, s, s + 1).
    real(wp), allocatable, private :: coefficients(:, :, :)
    !> Pushes, sections and coordinates at the nodes, shape (n_lanes, n).
    real(wp), allocatable, dimension(:, :), private :: push, x_at, rate_at, q_at, v_at
    !> Rates of steep laws by rates and places of sections, shape (n, n_steep), and pushes by their
    !! forces, also on the present surfaces, shape (n_steep, n); accelerations by steep laws at the
    !! nodes, shape (n_lanes, n); the forces of the last iteration, shape (s, n_steep).
    real(wp), allocatable, dimension(:, :), private :: steep_rates, steep_places, steep_pushes
    real(wp), allocatable, dimension(:, :), private :: steep_held
    real(wp), allocatable, dimension(:, :), private :: steep_at, steep_forces
    !> As `steep_held` of the system.
    real(wp), allocatable, private :: held(:, :)
    !> Factors of values at the nodes in the last two coefficients of Legendre, shape (2, s).
    real(wp), allocatable, private :: last(:, :)
  contains
    procedure :: step
    procedure :: arrive
    procedure :: change_step
    procedure :: put
    procedure :: memory_size
    procedure :: n_of_state
    procedure :: save_memory
    procedure :: load_memory
    procedure :: trace
    procedure, private :: pushes
    procedure, private :: follow
    procedure, private :: add_steep, make_steep_gains
    procedure, private :: move
    procedure, private :: solve
  end type modal_gauss_type

contains

  !> Start at (q, v) at time `start`.
  subroutine new_modal_gauss(method, system, s, q, v, start, h, tolerance)
    type(modal_gauss_type), intent(out) :: method
    class(driven_system_type), intent(in) :: system
    !> Number of nodes, 2 to 8.
    integer, intent(in) :: s
    !> State of the first coordinates; further coordinates start at 0.
    real(wp), intent(in) :: q(:), v(:)
    real(wp), intent(in) :: start, h, tolerance
    type(collocation_type) :: points
    integer :: i, n

    n = system%n_dof
    call new_gauss_table(method%table, s, min(prediction_degree, s - 1))
    call new_collocation(points, s)
    allocate (method%coefficients(s, s, s + 1))
    do i = 1, s + 1
      method%coefficients(:, :, i) = legendre_of_nodes(points%points(1:s), points%b, &
                                                       points%points(i))
    end do
    method%tolerance = tolerance
    allocate (method%q(n), method%v(n), source=0.0_wp)
    method%q(:size(q)) = q
    method%v(:size(v)) = v
    allocate (method%x(n), method%x_rate(n), method%x_rest(n), method%rate_rest(n))
    allocate (method%push(n_lanes, n), source=0.0_wp)
    allocate (method%x_at, method%rate_at, method%q_at, method%v_at, mold=method%push)
    allocate (method%steep_at(n_lanes, n), source=0.0_wp)
    if (allocated(system%steep)) then
      method%steep_rates = matmul(system%frame%to_coordinates%values, &
                                  transpose(system%steep_rates))
      method%steep_places = matmul(system%frame%to_coordinates%values, &
                                   transpose(system%steep_places))
      method%steep_pushes = matmul(transpose(system%steep_pushes), &
                                   system%frame%to_sections%values)
    else
      allocate (method%steep_rates(n, 0), method%steep_places(n, 0), method%steep_pushes(0, n))
    end if
    method%steep_held = method%steep_pushes
    allocate (method%held(n, size(method%steep_pushes, 1)), source=0.0_wp)
    allocate (method%steep_forces(s, size(method%steep_pushes, 1)))
    allocate (method%resolved(size(method%steep_rates, 2)), source=.false.)
    method%last = last_coefficients(method%table)
    call new_phases(method%phases, system%drives, start, h, method%table%nodes(:, :1))
    if (allocated(system%quarters)) then
      call turn_phase(method%phases%high, method%phases%low, system%quarters)
    end if
    call method%change_step(system, h)
  end subroutine new_modal_gauss

  !> Factors of values at the nodes in the last two coefficients of Legendre's polynomials.
  pure function last_coefficients(table) result(last)
    type(gauss_table_type), intent(in) :: table
    real(wp) :: last(2, table%n_nodes), x, values(0:table%n_nodes)
    integer :: i, k, s

    s = table%n_nodes
    do i = 1, s
      x = 2.0_wp*table%nodes(i, 1) - 1.0_wp
      values(0) = 1.0_wp
      values(1) = x
      do k = 2, s - 1
        values(k) = ((2*k - 1)*x*values(k - 1) - (k - 1)*values(k - 2))/k
      end do
      last(:, i) = [2*s - 3, 2*s - 1]*values(s - 2:s - 1)*table%weights(i, 1)
    end do
  end function last_coefficients

  subroutine change_step(self, system, h)
    class(modal_gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: h
    integer :: i

    self%h = h
    self%has_history = .false.
    call self%phases%set_step(system%drives, h, self%table%nodes(:, :1))
    do i = 1, size(self%maps)
      self%now = i
      if (abs(self%maps(i)%h - h) <= 0.0_wp) return
    end do
    self%now = merge(1, 2, abs(h - system%step_length) <= 0.0_wp)
    call make_maps(self%maps(self%now), system%frame, self%table, self%coefficients, h)
    call self%make_steep_gains(self%maps(self%now))
  end subroutine change_step

  !> Take the accelerations by steep laws on the present surfaces.
  subroutine hold_steep(self, system)
    class(modal_gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    integer :: i

    if (all(abs(self%held - system%steep_held) <= 0.0_wp)) return
    self%held = system%steep_held
    self%steep_held = matmul(transpose(self%held), system%frame%to_sections%values)
    do i = 1, size(self%maps)
      if (allocated(self%maps(i)%steep_gains)) then
        call self%make_steep_gains(self%maps(i))
      end if
    end do
  end subroutine hold_steep

  !> The rates of steep laws by their own forces.
  subroutine make_steep_gains(self, maps)
    class(modal_gauss_type), intent(in) :: self
    type(section_maps), intent(inout) :: maps
    integer :: j, k, l, m, s

    s = size(maps%end_v, 1)
    l = size(self%steep_rates, 2)
    if (.not. allocated(maps%steep_gains)) allocate (maps%steep_gains(s, l, s, l))
    maps%steep_gains = 0.0_wp
    do m = 1, size(self%steep_rates, 1)
      do k = 1, l
        do j = 1, l
          maps%steep_gains(:, j, :, k) = maps%steep_gains(:, j, :, k) + self%steep_held(k, m) &
                                         *(self%steep_rates(m, j)*maps%v_by_push(:s, :, m) &
                                           + self%steep_places(m, j)*maps%x_by_push(:s, :, m))
        end do
      end do
    end do
  end subroutine make_steep_gains

  subroutine make_maps(maps, frame, table, coefficients, h)
    type(section_maps), intent(inout) :: maps
    type(modal_frame), intent(in) :: frame
    type(gauss_table_type), intent(in) :: table
    real(wp), intent(in) :: coefficients(:, :, :), h
    real(wp) :: by_q(2), by_v(2), t
    real(wp), dimension(size(coefficients, 1)) :: gain, rate_gain, by_order, by_order_rate
    integer :: i, l, m, n, s

    n = size(frame%squares)
    s = table%n_nodes
    if (.not. allocated(maps%x_by_x)) then
      allocate (maps%x_by_x(n_lanes, n), maps%end_x(s, n), maps%x_by_push(n_lanes, s, n), &
                source=0.0_wp)
      allocate (maps%x_by_v, maps%v_by_x, maps%v_by_v, source=maps%x_by_x)
      allocate (maps%v_by_push, mold=maps%x_by_push)
      allocate (maps%end_v, mold=maps%end_x)
      allocate (maps%end_state(2, 2, n), maps%size_of_push(n))
    end if
    maps%h = h
    do m = 1, n
      if (frame%like(m) < m) then
        associate (l => frame%like(m))
          maps%v_by_v(:, m) = maps%v_by_v(:, l)
          maps%v_by_push(:, :, m) = maps%v_by_push(:, :, l)
          maps%end_state(:, :, m) = maps%end_state(:, :, l)
          maps%end_v(:, m) = maps%end_v(:, l)
          maps%size_of_push(m) = maps%size_of_push(l)
        end associate
        cycle
      end if
      do i = 1, s + 1
        t = h
        if (i <= s) t = h*table%nodes(i, 1)
        if (frame%unseen(m)) then
          call relaxing_section(frame%rates(m)*t, by_v(2), by_order_rate)
          by_q = 0.0_wp
          by_v(1) = 0.0_wp
          gain = 0.0_wp
        else
          associate (square => frame%squares(m)*t**2, rate => frame%rates(m)*t)
            call free_section(square, rate, by_q, by_v)
            call driven_section(square, rate, by_order, by_order_rate)
          end associate
          gain = t**2*matmul(by_order, coefficients(:, :, i))
        end if
        rate_gain = t*matmul(by_order_rate, coefficients(:, :, i))
        if (i > s) exit
        ! Lanes beyond the last node repeat it.
        do l = i, merge(n_lanes, i, i == s)
          maps%x_by_x(l, m) = by_q(1)
          maps%v_by_x(l, m) = by_q(2)/t
          maps%x_by_v(l, m) = t*by_v(1)
          maps%v_by_v(l, m) = by_v(2)
          maps%x_by_push(l, :, m) = gain
          maps%v_by_push(l, :, m) = rate_gain
        end do
      end do
      maps%end_state(:, 1, m) = [by_q(1), by_q(2)/h]
      maps%end_state(:, 2, m) = [h*by_v(1), by_v(2)]
      maps%end_x(:, m) = gain
      maps%end_v(:, m) = rate_gain
      maps%size_of_push(m) = max(maxval(sum(abs(maps%x_by_push(:, :, m)), 2)), &
                                 h*maxval(sum(abs(maps%v_by_push(:, :, m)), 2)))
    end do
  end subroutine make_maps

  subroutine put(self, q, v)
    class(modal_gauss_type), intent(inout) :: self
    real(wp), intent(in) :: q(:), v(:)
    self%has_history = .false.
    ! Positions stay the same to the last digit, or a mass would not rest on a stop.
    if (any(abs(q - self%q) > 0.0_wp)) self%x_follows = .false.
    self%rate_follows = .false.
    self%q = q
    self%v = v
  end subroutine put

  !> Set the state at the end of a step that another method made.
  subroutine arrive(self, q, v)
    class(modal_gauss_type), intent(inout) :: self
    real(wp), intent(in) :: q(:), v(:)
    call self%put(q, v)
    call self%phases%advance()
  end subroutine arrive

  !> One step; not made if the iteration converges from neither start.
  subroutine step(self, system, made)
    class(modal_gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    logical, intent(out) :: made
    real(wp) :: drive(n_lanes, size(system%drives)), push(n_lanes, size(self%x))
    integer :: l

    if (.not. self%x_follows) then
      self%x = system%frame%to_sections%row(self%q)
      self%x_rest = 0.0_wp
    end if
    if (.not. self%rate_follows) then
      self%x_rate = system%frame%to_sections%row(self%v)
      self%rate_rest = 0.0_wp
    end if
    self%x_follows = .true.
    self%rate_follows = .true.
    if (counting) call count_up(counted_loads, size(system%drives))
    call self%phases%drives(1, drive)
    if (system%timed) drive(:, size(system%drives)) = self%since + self%h*self%table%nodes(:, 1)
    made = .false.
    if (self%has_history) then
      self%push = matmul(self%table%extrapolation(:, :self%table%n_nodes, 1, 1), &
                         self%push(:self%table%n_nodes, :))
      call self%solve(system, drive, made)
    end if
    if (.not. made) then
      do l = 1, n_lanes
        self%x_at(l, :) = self%x
        self%rate_at(l, :) = self%x_rate
      end do
      call self%pushes(system, drive, push)
      self%push = push
      call self%solve(system, drive, made)
    end if
    if (.not. made) return
    call self%move()
    self%q = system%frame%to_coordinates%row(self%x)
    self%v = system%frame%to_coordinates%row(self%x_rate)
    self%has_history = .true.
    call self%phases%advance()
  end subroutine step

  !> Forces on the sections at the nodes, from their present states.
  subroutine pushes(self, system, drive, push)
    class(modal_gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: drive(n_lanes, size(system%drives))
    real(wp), intent(out) :: push(n_lanes, size(self%x))
    real(wp), dimension(n_lanes, size(self%x)) :: rest, a, sections, more
    integer :: m, n

    n = size(self%x)
    associate (frame => system%frame)
      call frame%to_coordinates%multiply(self%x_at, self%q_at)
      call frame%to_coordinates%multiply(self%rate_at, self%v_at)
      do m = 1, n
        sections(:, m) = -frame%squares(m)*self%x_at(:, m) - frame%rates(m)*self%rate_at(:, m)
      end do
      push = 0.0_wp
      if (allocated(frame%coupling)) then
        call frame%coupling%multiply(self%x_at, more)
        push = push - more
      end if
      if (allocated(frame%drag)) then
        call frame%drag%multiply(self%rate_at, more)
        push = push - more
      end if
      sections = sections + push
      call frame%to_coordinates%multiply(sections, rest)
      rest = rest + self%steep_at
      call system%push(self%q_at, self%v_at, drive, rest, a)
      call frame%to_sections%multiply(a, more)
      push = push + more
    end associate
    self%n_evaluations = self%n_evaluations + 1
    if (counting) call count_up(counted_accelerations, 1)
    if (counting) call count_up(counted_coordinates, n)
  end subroutine pushes

  !> The sections at the nodes under the present pushes.
  subroutine follow(self)
    class(modal_gauss_type), intent(inout) :: self
    real(wp), dimension(n_lanes) :: moved, rate
    integer :: j, m

    associate (maps => self%maps(self%now))
      do m = 1, size(self%x)
        moved = maps%x_by_x(:, m)*self%x(m) + maps%x_by_v(:, m)*self%x_rate(m)
        rate = maps%v_by_x(:, m)*self%x(m) + maps%v_by_v(:, m)*self%x_rate(m)
        do j = 1, self%table%n_nodes
          moved = moved + maps%x_by_push(:, j, m)*self%push(j, m)
          rate = rate + maps%v_by_push(:, j, m)*self%push(j, m)
        end do
        self%x_at(:, m) = self%x(m) + moved
        self%rate_at(:, m) = self%x_rate(m) + rate
      end do
    end associate
  end subroutine follow

  !> Add the forces of steep laws to the pushes at the nodes. On sliding surfaces the pushes contain
  !! the response to the last forces, and changes of the forces act with their response.
  subroutine add_steep(self, system, roots, push, made)
    class(modal_gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    !> w of each steep law at each node, on entry a start.
    real(wp), intent(inout) :: roots(:, :), push(:, :)
    logical, intent(out) :: made
    real(wp), dimension(self%table%n_nodes, size(roots, 2)) :: rates, forces
    real(wp) :: rate(n_lanes), place(n_lanes), lost(size(roots, 2)), push_of_one, blurred
    integer :: j, m, s

    s = self%table%n_nodes
    rates = 0.0_wp
    lost = 0.0_wp
    push(:s, :) = push(:s, :) + matmul(self%steep_forces, self%steep_pushes - self%steep_held)
    associate (maps => self%maps(self%now))
      do m = 1, size(self%x)
        if (.not. any(abs([self%steep_rates(m, :), self%steep_places(m, :)]) > 0.0_wp)) cycle
        place = maps%x_by_x(:, m)*self%x(m) + maps%x_by_v(:, m)*self%x_rate(m)
        rate = maps%v_by_x(:, m)*self%x(m) + maps%v_by_v(:, m)*self%x_rate(m)
        do j = 1, s
          place = place + maps%x_by_push(:, j, m)*push(j, m)
          rate = rate + maps%v_by_push(:, j, m)*push(j, m)
        end do
        place = self%x(m) + place
        rate = self%x_rate(m) + rate
        do j = 1, size(rates, 2)
          rates(:, j) = rates(:, j) + self%steep_rates(m, j)*rate(:s) &
                        + self%steep_places(m, j)*place(:s)
          lost(j) = lost(j) + rounding*(abs(self%steep_rates(m, j)) &
                                        *(abs(self%x_rate(m)) + maxval(abs(rate))) &
                                        + abs(self%steep_places(m, j))*maxval(abs(place)))
        end do
      end do
      call solve_steep(system, maps%steep_gains, rates, self%q_at(:s, :), self%v_at(:s, :), roots, &
                       forces, made)
    end associate
    ! A steep force may be the small difference of springs and loads.
    blurred = amplified*rounding*(sum(abs(system%frame%squares*self%x)) + system%jump_at_rest)
    do j = 1, size(rates, 2)
      push_of_one = self%h*abs(dot_product(self%steep_rates(:, j), self%steep_pushes(j, :)))
      associate (tail => abs(matmul(self%last, forces(:, j))))
        self%resolved(j) = all(tail <= represented*maxval(abs(forces(:, j))) &
                               + enlarged*lost(j)/push_of_one &
                               + blurred/maxval(abs(self%steep_pushes(j, :))))
      end associate
    end do
    push(:s, :) = push(:s, :) + matmul(forces, self%steep_held)
    self%steep_forces = forces
    self%steep_at(:s, :) = matmul(forces, transpose(system%steep_pushes))
    do j = s + 1, n_lanes
      self%steep_at(j, :) = self%steep_at(s, :)
    end do
  end subroutine add_steep

  !> Fixed point of the pushes.
  subroutine solve(self, system, drive, made)
    class(modal_gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: drive(n_lanes, size(system%drives))
    logical, intent(out) :: made
    real(wp) :: new(n_lanes, size(self%x)), change, before, expected, way, places, moved
    real(wp) :: roots(self%table%n_nodes, size(self%steep_rates, 2)), balanced
    integer :: k, m

    made = .false.
    before = 0.0_wp
    self%steep_at = 0.0_wp
    self%steep_forces = 0.0_wp
    if (size(roots) > 0) call hold_steep(self, system)
    do m = 1, size(roots, 2)
      roots(:, m) = root_of_rate(dot_product(self%steep_rates(:, m), self%x_rate) &
                                 + dot_product(self%steep_places(:, m), self%x), &
                                 system%steep(m)%exponent)
    end do
    associate (weight => self%maps(self%now)%size_of_push, s => self%table%n_nodes)
      places = sum(abs(self%x))
      way = self%h*sum(abs(self%x_rate))
      do k = 1, max_iterations
        call self%follow()
        call self%pushes(system, drive, new)
        balanced = 0.0_wp
        if (size(roots) > 0) then
          ! Steep forces may balance the others, and amplify their rounding errors.
          do m = 1, size(self%x)
            balanced = balanced + amplified*weight(m)*(maxval(abs(new(:s, m))) &
                                                       + system%jump_at_rest)
          end do
          call self%add_steep(system, roots, new, made)
          if (.not. made) return
        end if
        if (counting) call count_up(counted_turns, 1)
        change = 0.0_wp
        moved = 0.0_wp
        do m = 1, size(self%x)
          change = change + weight(m)*maxval(abs(new(:s, m) - self%push(:s, m)))
          moved = moved + weight(m)*maxval(abs(new(:s, m)))
        end do
        self%push = new
        ! A diverging iteration is stopped before it overflows.
        if (.not. change <= self%h**2*system%range%push) return
        ! The next correction would shrink by the same factor again. It is compared with the
        ! distance moved, else a short part of a step gives no velocity.
        expected = change
        if (before > change) expected = change*(change/before)
        made = expected <= max(self%tolerance*(moved + way), negligible) &
               .or. (k > 2 .and. change >= 0.5_wp*before &
                     .and. change <= n_lanes*rounding*(moved + way + places + balanced))
        if (made) exit
        before = change
      end do
    end associate
    if (made) made = all(abs(self%q_at) <= system%range%coordinate)
  end subroutine solve

  !> Advance the sections to the end of the step, with compensated sums.
  subroutine move(self)
    class(modal_gauss_type), intent(inout) :: self
    real(wp) :: change(2)
    integer :: m, s

    s = self%table%n_nodes
    associate (maps => self%maps(self%now))
      do m = 1, size(self%x)
        change = maps%end_state(:, 1, m)*self%x(m) + maps%end_state(:, 2, m)*self%x_rate(m)
        change = change + [dot_product(maps%end_x(:, m), self%push(:s, m)), &
                           dot_product(maps%end_v(:, m), self%push(:s, m))]
        call add_up(self%x(m), self%x_rest(m), change(1))
        call add_up(self%x_rate(m), self%rate_rest(m), change(2))
      end do
    end associate
  end subroutine move

  !> The polynomial through the nodes and both ends.
  subroutine trace(self, system, memory, path)
    class(modal_gauss_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: memory(:)
    type(step_path), intent(inout) :: path
    integer :: n, s

    n = system%n_dof
    s = self%table%n_nodes
    if (.not. allocated(path%points)) then
      call new_path(path, [0.0_wp, self%table%nodes(:s, 1), 1.0_wp])
    end if
    path%h = self%h
    path%q = spread(memory(:n), 1, s + 2)
    path%v = spread(memory(n + 1:2*n), 1, s + 2)
    path%q(2:s + 1, :) = self%q_at(:s, :)
    path%v(2:s + 1, :) = self%v_at(:s, :)
    path%q(s + 2, :) = self%q
    path%v(s + 2, :) = self%v
  end subroutine trace

  !> Length of the data that a run needs to continue bit for bit.
  pure integer function memory_size(self)
    class(modal_gauss_type), intent(in) :: self
    memory_size = (6 + n_lanes)*size(self%q) + 2*size(self%phases%high) + 3
  end function memory_size

  pure integer function n_of_state(self)
    class(modal_gauss_type), intent(in) :: self
    n_of_state = 6*size(self%q)
  end function n_of_state

  !> State, sections, rounding errors, phases, pushes, and flags that show which are valid.
  pure function save_memory(self) result(memory)
    class(modal_gauss_type), intent(in) :: self
    real(wp) :: memory(self%memory_size())
    memory = [self%q, self%v, self%x, self%x_rate, self%x_rest, self%rate_rest, &
              self%phases%high, self%phases%low, self%push, merge(1.0_wp, 0.0_wp, &
                                                                      [self%x_follows, &
                                                                       self%rate_follows, &
                                                                       self%has_history])]
  end function save_memory

  subroutine load_memory(self, memory)
    class(modal_gauss_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    integer :: i, m, n

    n = size(self%q)
    m = size(self%phases%high)
    self%q = memory(:n)
    self%v = memory(n + 1:2*n)
    self%x = memory(2*n + 1:3*n)
    self%x_rate = memory(3*n + 1:4*n)
    self%x_rest = memory(4*n + 1:5*n)
    self%rate_rest = memory(5*n + 1:6*n)
    i = 6*n
    self%phases%high = memory(i + 1:i + m)
    self%phases%low = memory(i + m + 1:i + 2*m)
    i = i + 2*m
    self%push = reshape(memory(i + 1:i + n_lanes*n), [n_lanes, n])
    i = i + n_lanes*n
    self%x_follows = memory(i + 1) > 0.5_wp
    self%rate_follows = memory(i + 2) > 0.5_wp
    self%has_history = memory(i + 3) > 0.5_wp
  end subroutine load_memory

end module viscovib_modal_gauss
