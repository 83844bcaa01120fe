! Optimize: -O3
!> Gauss-Legendre collocation in fixed steps, with the nodes in the lanes of the
!! vector unit.
!!
!! q_i = q_0 + c_i h v_0 + h^2 sum_j a2_ij f_j, v_i = v_0 + h sum_j a_ij f_j,
!! f_i = a(q_i, v_i): solved by fixed-point iteration from the polynomial of the
!! step before, until the accelerations hardly change, or by Newton's method for
!! small systems with laws of functions (viscovib_node_newton). Symplectic and
!! symmetric; order 2s at the step ends.
module viscovib_gauss
  use viscovib_aligned, only: alignment_slack, first_aligned, settle
  use viscovib_counters, only: count_up, counted_accelerations, counted_coordinates, &
    counted_loads, counted_turns, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_gauss_table, only: gauss_table_type, new_gauss_table
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof, n_lanes
  use viscovib_node_kernels, only: exchange, lane_product_sum, lane_sum, node_states, predict
  use viscovib_node_newton, only: newton_nodes, step_start
  use viscovib_phases, only: new_phases, phases_type, turn_phase
  use viscovib_step_path, only: new_path, step_path
  use viscovib_stepper, only: stepper_type
  implicit none
  private

  public :: gauss_type, new_gauss

  !> Iterations of a step before it is repeated from a constant start.
  integer, parameter :: max_iterations = 40
  !> Changes below this are those of numbers near underflow.
  real(wp), parameter :: negligible = 1.0e-300_wp
  !> Relative change of the state that a step does not resolve.
  real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp)
  !> Degree of the polynomial that predicts a step, at most through all its nodes. The fixed-point
  !! iteration then takes 10 % fewer evaluations than with degree 5; Newton's method converges from
  !! larger errors.
  integer, parameter :: prediction_degree = 7, newton_degree = 6

  !> Offsets of the arrays in the workspace of a method, in columns of lanes.
  type :: work_plan
    integer :: sums = 0, prediction = 0, times = 0, drive = 0, f = 0, f_new = 0, q = 0, v = 0
    integer :: n_columns = 0
  end type work_plan

  type, extends(stepper_type) :: gauss_type
    type(gauss_table_type) :: table
    type(phases_type) :: phases
    !> Iteration stops when accelerations change relatively by less than this.
    real(wp) :: tolerance = 0.0_wp
    !> Accumulated rounding errors of the state, shape (n_dof).
    real(wp), allocatable :: q_rest(:), v_rest(:)
    !> True if accelerations of a previous step exist for prediction.
    logical :: has_history = .false.
    !> Largest distance of two nodes, in steps.
    real(wp), private :: widest = 1.0_wp
    type(work_plan), private :: plan
    !> Tables, and accelerations and states at the nodes.
    real(wp), allocatable, private :: work(:)
    !> Index of its first column.
    integer, private :: first = 1
  contains
    procedure :: step
    procedure :: arrive
    procedure :: change_step
    procedure :: put
    procedure :: memory_size
    procedure :: n_of_state
    procedure :: save_memory
    procedure :: load_memory
    procedure :: least_margin
    procedure :: trace
    procedure, private :: step_in_arrays
    procedure, private :: solve
    procedure, private :: iterate
    procedure, private :: margin_at_nodes
  end type gauss_type

contains

  !> Start at (q, v) at time `start`.
  subroutine new_gauss(method, system, s, q, v, start, h, tolerance)
    type(gauss_type), intent(out) :: method
    class(driven_system_type), intent(in) :: system
    !> Number of nodes, 1 to 16.
    integer, intent(in) :: s
    real(wp), intent(in) :: q(:), v(:), start, h, tolerance

    call new_gauss_table(method%table, s, min(merge(newton_degree, prediction_degree, &
                                                    system%sloped), s - 1))
    call new_phases(method%phases, system%drives, start, h, &
                    method%table%nodes(:, :method%table%n_blocks))
    if (allocated(system%quarters)) then
      call turn_phase(method%phases%high, method%phases%low, system%quarters)
    end if
    method%h = h
    method%tolerance = tolerance
    method%q = q
    method%v = v
    allocate (method%q_rest(size(q)), method%v_rest(size(q)), source=0.0_wp)
    method%plan = new_work_plan(method%table%n_blocks)
    allocate (method%work(n_lanes*method%plan%n_columns + alignment_slack), source=0.0_wp)
    method%first = first_aligned(method%work)
    call furnish(method%table, h, method%plan, method%work(method%first))
    associate (c => pack(method%table%nodes, method%table%nodes > 0.0_wp))
      method%widest = max(maxval(c(2:) - c(:size(c) - 1)), c(1))
    end associate
  end subroutine new_gauss

  !> Store the tables, scaled by the step, in the workspace.
  pure subroutine furnish(table, h, plan, work)
    type(gauss_table_type), intent(in) :: table
    real(wp), intent(in) :: h
    type(work_plan), intent(in) :: plan
    real(wp), intent(inout) :: work(n_lanes, plan%n_columns)
    integer :: from, to, j, k

    do to = 1, table%n_blocks
      work(:, plan%times + to - 1) = h*table%nodes(:, to)
      do from = 1, table%n_blocks
        do j = 1, n_lanes
          k = j - 1 + n_lanes*(from - 1 + table%n_blocks*(to - 1))
          work(:, plan%sums + 2*k) = h**2*table%a_q(:, j, from, to)
          work(:, plan%sums + 2*k + 1) = h*table%a(:, j, from, to)
          work(:, plan%prediction + k) = table%extrapolation(:, j, from, to)
        end do
      end do
    end do
  end subroutine furnish

  pure type(work_plan) function new_work_plan(n_blocks) result(plan)
    integer, intent(in) :: n_blocks
    integer :: square
    square = n_lanes*n_blocks**2
    plan%sums = 1
    plan%prediction = plan%sums + 2*square
    plan%times = plan%prediction + square
    plan%drive = plan%times + n_blocks
    plan%f = plan%drive + max_dof*n_blocks
    plan%f_new = plan%f + max_dof*n_blocks
    plan%q = plan%f_new + max_dof*n_blocks
    plan%v = plan%q + max_dof*n_blocks
    plan%n_columns = plan%v + max_dof*n_blocks - 1
  end function new_work_plan

  subroutine change_step(self, system, h)
    class(gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: h
    self%h = h
    self%has_history = .false.
    call settle(self%work, self%first)
    call self%phases%set_step(system%drives, h, self%table%nodes(:, :self%table%n_blocks))
    call furnish(self%table, h, self%plan, self%work(self%first))
  end subroutine change_step

  subroutine put(self, q, v)
    class(gauss_type), intent(inout) :: self
    real(wp), intent(in) :: q(:), v(:)
    self%q = q
    self%v = v
    self%q_rest = 0.0_wp
    self%v_rest = 0.0_wp
    self%has_history = .false.
  end subroutine put

  !> One step; not made if the iteration converges from neither start.
  subroutine step(self, system, made)
    class(gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    logical, intent(out) :: made
    call self%step_in_arrays(system, self%work(self%first), made)
  end subroutine step

  !> Set the state at the end of a step that another method made.
  subroutine arrive(self, q, v)
    class(gauss_type), intent(inout) :: self
    real(wp), intent(in) :: q(:), v(:)
    call self%put(q, v)
    call self%phases%advance()
  end subroutine arrive

  subroutine step_in_arrays(self, system, work, converged)
    class(gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns)
    logical, intent(out) :: converged
    integer :: b, blocks, dofs

    blocks = self%table%n_blocks
    dofs = size(self%q)
    if (counting) call count_up(counted_loads, size(self%phases%high))
    associate (p => self%plan)
      do b = 1, blocks
        call self%phases%drives(b, work(1, p%drive + max_dof*(b - 1)))
        if (system%timed) then
          work(:, p%drive + max_dof*(b - 1) + size(self%phases%high) - 1) = &
            self%since + work(:, p%times + b - 1)
        end if
      end do
      converged = .false.
      if (self%has_history) then
        do b = 1, blocks
          call predict(blocks, dofs, work(1, p%prediction + n_lanes*blocks*(b - 1)), &
                       work(1, p%f), work(1, p%f_new + max_dof*(b - 1)))
        end do
        work(:, p%f:p%f_new - 1) = work(:, p%f_new:p%f_new + max_dof*blocks - 1)
        call self%solve(system, work, converged)
      end if
      if (.not. converged) then
        call constant_start(self, system, work)
        call self%solve(system, work, converged)
      end if
      if (.not. converged .and. system%sloped) then
        call constant_start(self, system, work)
        call self%iterate(system, work, converged)
      end if
      if (.not. converged) return
      call advance(self, blocks, work(1, p%f))
    end associate
  end subroutine step_in_arrays

  !> Advance to the end of the step, from the accelerations at its nodes.
  subroutine advance(self, blocks, f)
    class(gauss_type), intent(inout) :: self
    integer, intent(in) :: blocks
    real(wp), intent(in) :: f(n_lanes, max_dof, blocks)
    real(wp) :: change_q, change_v
    integer :: b, d

    self%has_history = .true.
    do d = 1, size(self%q)
      change_q = 0.0_wp
      change_v = 0.0_wp
      do b = 1, blocks
        change_q = change_q + lane_product_sum(self%table%weights_q(1, b), f(1, d, b))
        change_v = change_v + lane_product_sum(self%table%weights(1, b), f(1, d, b))
      end do
      call add(self%q(d), self%q_rest(d), self%h*(self%v(d) + self%h*change_q))
      call add(self%v(d), self%v_rest(d), self%h*change_v)
    end do
    call self%phases%advance()
  end subroutine advance

  !> Use the accelerations at the start of the step at every node.
  subroutine constant_start(self, system, work)
    class(gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns)
    integer :: b, d

    associate (p => self%plan)
      do d = 1, size(self%q)
        work(:, p%q + d - 1) = self%q(d)
        work(:, p%v + d - 1) = self%v(d)
      end do
      call system%acceleration(work(1, p%q), work(1, p%v), work(1, p%drive), work(1, p%f_new))
      self%n_evaluations = self%n_evaluations + 1
      do b = 0, self%table%n_blocks - 1
        do d = 0, size(self%q) - 1
          work(:, p%f + b*max_dof + d) = work(1, p%f_new + d)
        end do
      end do
    end associate
  end subroutine constant_start

  !> Solve for the accelerations at the nodes, from the present ones: by Newton's method if the
  !! system has derivatives.
  subroutine solve(self, system, work, converged)
    class(gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns)
    logical, intent(out) :: converged
    type(step_start) :: start
    integer :: n, blocks

    if (.not. system%sloped) then
      call self%iterate(system, work, converged)
      return
    end if
    n = size(self%q)
    blocks = self%table%n_blocks
    start%q(:n) = self%q
    start%v(:n) = self%v
    start%h_2 = self%h**2
    start%lost = blocks*n_lanes*rounding*(sum(abs(start%q)) + abs(self%h)*sum(abs(start%v)))
    associate (p => self%plan)
      start%total = size_of(n, blocks, work(1, p%f))
      start%wanted = max(self%tolerance*start%total, negligible)
      call newton_nodes(system, n, blocks, work(1, p%times), work(1, p%sums), work(1, p%drive), &
                        start, work(1, p%f), work(1, p%f_new), work(1, p%q), work(1, p%v), &
                        self%n_evaluations, converged)
      if (.not. converged) return
      converged = all(abs(work(1, p%q:p%q + n - 1)) <= system%range%coordinate)
    end associate
  end subroutine solve

  !> Fixed-point iteration for the accelerations.
  subroutine iterate(self, system, work, converged)
    class(gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns)
    logical, intent(out) :: converged
    real(wp) :: q_0(max_dof), v_0(max_dof), change, before, expected, wanted, lost
    integer :: k, b, n, blocks

    n = size(self%q)
    blocks = self%table%n_blocks
    ! Coordinates are processed in groups of three, including unused ones.
    q_0 = 0.0_wp
    v_0 = 0.0_wp
    q_0(:n) = self%q
    v_0(:n) = self%v
    converged = .false.
    before = 0.0_wp
    associate (p => self%plan)
      wanted = max(self%tolerance*size_of(n, blocks, work(1, p%f)), negligible)
      lost = blocks*n_lanes*rounding*(sum(abs(q_0)) + abs(self%h)*sum(abs(v_0)))
      do k = 1, max_iterations
        do b = 0, blocks - 1
          call node_states(blocks, n, work(1, p%times + b), work(1, p%sums + 2*n_lanes*blocks*b), &
                           work(1, p%f), q_0, v_0, work(1, p%q + max_dof*b), &
                           work(1, p%v + max_dof*b))
          call system%acceleration(work(1, p%q + max_dof*b), work(1, p%v + max_dof*b), &
                                   work(1, p%drive + max_dof*b), work(1, p%f_new + max_dof*b))
        end do
        self%n_evaluations = self%n_evaluations + blocks
        if (counting) call count_up(counted_turns, 1)
        if (counting) call count_up(counted_accelerations, blocks)
        if (counting) call count_up(counted_coordinates, n*blocks)
        change = 0.0_wp
        do b = 0, blocks - 1
          call exchange(n, work(1, p%f_new + max_dof*b), work(1, p%f + max_dof*b), change)
        end do
        ! A diverging iteration is stopped before it overflows.
        if (.not. change <= system%range%push) return
        ! The next correction would shrink by the same factor again.
        expected = change
        if (before > change) expected = change*(change/before)
        if (expected <= wanted) exit
        ! If accelerations are small differences of large terms, only rounding still changes them.
        if (k > 2 .and. change >= 0.5_wp*before .and. self%h**2*change <= lost) exit
        before = change
      end do
      converged = k <= max_iterations &
                  .and. all(abs(work(1, p%q:p%q + n - 1)) <= system%range%coordinate)
    end associate
  end subroutine iterate

  !> Least margin from the nodes of the step and the rates there.
  real(wp) function least_margin(self, system, q_before, v_before) result(least)
    class(gauss_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: q_before(:), v_before(:)
    real(wp) :: ends(n_lanes, max_dof), margins(n_lanes)
    integer :: b, d

    do d = 1, size(self%q)
      ends(:, d) = self%q(d)
      ends(2, d) = q_before(d)
      ends(3, d) = q_before(d) + self%widest/3.0_wp*self%h*v_before(d)
    end do
    margins = system%margin(ends(:, :size(self%q)))
    ! The last position before the first node follows from the motion at the start.
    least = min(margins(1), margins(2) + min(0.0_wp, margins(3) - margins(2)))
    do b = 0, self%table%n_blocks - 1
      least = min(least, self%margin_at_nodes(system, self%work(self%first), b))
    end do
  end function least_margin

  !> Lower bound of the margin from the hull of cubics between the nodes of a block.
  real(wp) function margin_at_nodes(self, system, work, b) result(least)
    class(gauss_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: work(n_lanes, self%plan%n_columns)
    integer, intent(in) :: b
    integer :: n

    n = size(self%q)
    associate (q => work(:, self%plan%q + max_dof*b:self%plan%q + max_dof*b + n - 1), &
               v => work(:, self%plan%v + max_dof*b:self%plan%v + max_dof*b + n - 1))
      least = minval(system%margin_within(q, v, self%widest/3.0_wp*self%h))
    end associate
  end function margin_at_nodes

  !> The collocation polynomial.
  subroutine trace(self, system, memory, path)
    class(gauss_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: memory(:)
    type(step_path), intent(inout) :: path
    real(wp) :: nodes(size(self%table%nodes))
    integer :: d, first, i, n, s

    n = system%n_dof
    s = self%table%n_nodes
    if (.not. allocated(path%points)) then
      ! Lanes beyond the last node repeat it.
      nodes = reshape(self%table%nodes, shape(nodes))
      call new_path(path, [0.0_wp, nodes(:s), 1.0_wp])
    end if
    path%h = self%h
    path%q = spread(memory(:n), 1, s + 2)
    path%v = spread(memory(n + 1:2*n), 1, s + 2)
    do i = 1, s
      first = self%first - 1 + n_lanes*(max_dof*((i - 1)/n_lanes) - 1) + mod(i - 1, n_lanes) + 1
      do d = 1, n
        path%q(i + 1, d) = self%work(first + n_lanes*(self%plan%q + d - 1))
        path%v(i + 1, d) = self%work(first + n_lanes*(self%plan%v + d - 1))
      end do
    end do
    path%q(s + 2, :) = self%q
    path%v(s + 2, :) = self%v
  end subroutine trace

  !> Sum of the sizes of all accelerations.
  pure real(wp) function size_of(n_dof, blocks, f)
    integer, intent(in) :: n_dof, blocks
    real(wp), intent(in) :: f(n_lanes, max_dof, blocks)
    real(wp) :: lanes(n_lanes)
    integer :: b, d
    lanes = 0.0_wp
    do b = 1, blocks
      do d = 1, n_dof
        lanes = lanes + abs(f(:, d, b))
      end do
    end do
    size_of = lane_sum(lanes)
  end function size_of

  !> Length of the data that a run needs to continue bit for bit.
  pure integer function memory_size(self)
    class(gauss_type), intent(in) :: self
    memory_size = 4*size(self%q) + 2*size(self%phases%high) + n_nodes_values(self) + 1
  end function memory_size

  pure integer function n_of_state(self)
    class(gauss_type), intent(in) :: self
    n_of_state = 4*size(self%q)
  end function n_of_state

  pure integer function n_nodes_values(self)
    class(gauss_type), intent(in) :: self
    n_nodes_values = n_lanes*max_dof*self%table%n_blocks
  end function n_nodes_values

  !> State, rounding errors, phases, accelerations, and the flag that these can predict.
  pure function save_memory(self) result(memory)
    class(gauss_type), intent(in) :: self
    real(wp) :: memory(self%memory_size())
    integer :: first
    first = self%first + n_lanes*(self%plan%f - 1)
    memory = [self%q, self%v, self%q_rest, self%v_rest, self%phases%high, self%phases%low, &
              self%work(first:first + n_nodes_values(self) - 1), &
              merge(1.0_wp, 0.0_wp, self%has_history)]
  end function save_memory

  subroutine load_memory(self, memory)
    class(gauss_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    integer :: n, m, first
    n = size(self%q)
    m = size(self%phases%high)
    self%q = memory(:n)
    self%v = memory(n + 1:2*n)
    self%q_rest = memory(2*n + 1:3*n)
    self%v_rest = memory(3*n + 1:4*n)
    self%phases%high = memory(4*n + 1:4*n + m)
    self%phases%low = memory(4*n + m + 1:4*n + 2*m)
    first = self%first + n_lanes*(self%plan%f - 1)
    self%work(first:first + n_nodes_values(self) - 1) = &
      memory(4*n + 2*m + 1:4*n + 2*m + n_nodes_values(self))
    self%has_history = memory(self%memory_size()) > 0.5_wp
  end subroutine load_memory

  !> total + change, keeping the rounding error for the next addition.
  pure subroutine add(total, rest, change)
    real(wp), intent(inout) :: total, rest
    real(wp), intent(in) :: change
    real(wp) :: increment, new
    increment = change + rest
    new = total + increment
    rest = increment - (new - total)
    total = new
  end subroutine add

end module viscovib_gauss
