! Optimize: -O3
!> Runge-Kutta methods in fixed steps, with trajectories in the lanes of the vector unit: explicit
!! methods, and collocations whose stages are iterated. Each lane may have its own step and its own
!! load frequencies. Its results do not depend on the other lanes.
module viscovib_explicit
  use viscovib_aligned, only: alignment_slack, first_aligned, settle
  use viscovib_counters, only: count_up, counted_accelerations, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_explicit_tables, only: explicit_table_type, new_explicit_table
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: max_dof, n_lanes
  use viscovib_phases, only: split_phase, step_phase, turn_phase
  use viscovib_stage_kernels, only: end_of_step, stage_states, stage_sums, turn_drives
  use viscovib_vector_math, only: sine_cosine_lanes
  implicit none
  private

  public :: explicit_type, new_explicit

  !> Offsets of the arrays in the workspace, in columns.
  type :: work_plan
    integer :: h = 1, q = 0, v = 0, q_rest = 0, v_rest = 0, in_q = 0, in_v = 0, stage_q = 0
    integer :: stage_v = 0, drive = 0, cosine = 0, sine = 0, stage_cosine = 0, stage_sine = 0
    !> For collocations only: accelerations of the previous step (after f), new accelerations, and
    !! coordinates at the nodes.
    integer :: f = 0, f_old = 0, f_new = 0, node_q = 0, n_columns = 0
  end type work_plan

  !> Sweeps over all nodes before a step counts as too large.
  integer, parameter :: max_sweeps = 40
  !> Relative change of accelerations at convergence: only rounding still changes them.
  real(wp), parameter :: solved = 4.0e-15_wp
  !> Changes below this are those of numbers near underflow.
  real(wp), parameter :: negligible = 1.0e-300_wp
  !> Relative change of the state that a step does not resolve.
  real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp)
  !> States of a lane: iterating, converged, diverged.
  real(wp), parameter :: at_work = 1.0_wp, is_solved = 0.0_wp, ran_away = -1.0_wp

  type :: explicit_type
    type(explicit_table_type) :: table
    integer :: n_dof = 0, n_drives = 0
    !> Time since the present piece of a load began, for systems that need it.
    real(wp) :: since = 0.0_wp
    !> Total number of evaluations of a block of trajectories.
    integer(i8) :: n_evaluations = 0
    !> Lanes in which the last step solved its equations; all lanes for an explicit method.
    logical :: made(n_lanes) = .true.
    !> Lanes without accelerations of a previous step for prediction.
    logical, private :: fresh(n_lanes) = .true.
    !> Load phases and their growth in a step, in two parts, shape (n_lanes, n).
    real(wp), allocatable, private :: high(:, :), low(:, :), step_high(:, :), step_low(:, :)
    type(work_plan), private :: plan
    real(wp), allocatable, private :: work(:)
    !> Index of its first column.
    integer, private :: first = 1
  contains
    procedure :: begin_again
    procedure :: step
    procedure :: get_state
    procedure :: get_accelerations
    procedure :: change_steps
    procedure :: turn_phases
    procedure :: set_lane
    procedure :: scale_lanes
    procedure :: set_from
    procedure :: lane_memory_size
    procedure :: save_lane
    procedure :: load_lane
    procedure :: stop_lane
    procedure :: margin_at_nodes
    procedure, private :: step_in_arrays
    procedure, private :: stage
    procedure, private :: solve
    procedure, private :: predict
    procedure, private :: iterate
    procedure, private :: margin_in_arrays
    procedure, private :: accelerate
    procedure, private :: place
  end type explicit_type

contains

  !> Start at (q, v) at time `start`, all lanes together.
  subroutine new_explicit(method, n_dof, which, frequencies, q, v, start, h)
    type(explicit_type), intent(out) :: method
    integer, intent(in) :: n_dof
    !> Index in `lane_methods`.
    integer, intent(in) :: which
    !> Circular frequencies of the loads, shape (n_lanes, n_drives).
    real(wp), intent(in) :: frequencies(:, :)
    !> Shape (n_lanes, n_dof, n_blocks).
    real(wp), intent(in) :: q(:, :), v(:, :)
    real(wp), intent(in) :: start, h(n_lanes)
    integer :: n

    call new_explicit_table(method%table, which)
    method%n_dof = n_dof
    n = size(frequencies, 2)
    method%n_drives = n
    method%plan = new_work_plan(n, method%table%n_stages, method%table%implicit)
    allocate (method%work(n_lanes*method%plan%n_columns + alignment_slack), source=0.0_wp)
    method%first = first_aligned(method%work)
    allocate (method%high(n_lanes, n), method%low(n_lanes, n))
    allocate (method%step_high(n_lanes, n), method%step_low(n_lanes, n))
    call method%begin_again(frequencies, q, v, start, h)
  end subroutine new_explicit

  !> Start again as `new_explicit` does, without building the table, which takes as long as
  !! some steps.
  subroutine begin_again(self, frequencies, q, v, start, h)
    class(explicit_type), intent(inout) :: self
    real(wp), intent(in) :: frequencies(:, :), q(:, :), v(:, :), start, h(n_lanes)
    integer :: i

    self%since = 0.0_wp
    call split_phase(frequencies, start, self%high, self%low)
    do i = 1, n_lanes
      call self%set_lane(i, q(i, :), v(i, :))
    end do
    call self%change_steps(frequencies, h)
  end subroutine begin_again

  !> Continue with other step sizes.
  subroutine change_steps(self, frequencies, h)
    class(explicit_type), intent(inout) :: self
    real(wp), intent(in) :: frequencies(:, :), h(n_lanes)
    call settle(self%work, self%first)
    self%fresh = .true.
    call split_phase(frequencies, spread(h, 2, size(frequencies, 2)), self%step_high, &
                     self%step_low)
    call furnish(self%table, self%plan, frequencies, h, self%work(self%first))
  end subroutine change_steps

  !> Advance the phase of each load by some quarter turns.
  pure subroutine turn_phases(self, quarters)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: quarters(:)
    call turn_phase(self%high, self%low, spread(quarters, 1, n_lanes))
  end subroutine turn_phases

  !> One step of every lane. Nothing is checked: a lane that overflows contains
  !! infinities and does not affect other lanes.
  subroutine step(self, system)
    class(explicit_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    call self%step_in_arrays(system, self%work(self%first))
    call step_phase(self%high, self%low, self%step_high, self%step_low)
  end subroutine step

  subroutine step_in_arrays(self, system, work)
    class(explicit_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns)
    integer :: i, n

    n = self%n_dof
    associate (p => self%plan, t => self%table)
      call phase_cosines(self%n_drives, self%high, self%low, work(1, p%cosine), work(1, p%sine))
      if (t%implicit) then
        call self%solve(system, work)
      else
        do i = 1, t%n_stages
          call self%stage(system, i, t%n_terms(i), t%from(1, i), t%weights(1, 1, i), work, &
                          work(1, p%f + max_dof*(i - 1)))
        end do
        call count_stages(self, t%n_stages)
      end if
      i = t%n_stages + 1
      call stage_sums(n, t%n_terms(i), t%from(1, i), t%weights(1, 1, i), work(1, p%f), &
                      work(1, p%in_q), work(1, p%in_v))
      call end_of_step(n, work(1, p%h), work(1, p%in_q), work(1, p%in_v), work(1, p%q), &
                       work(1, p%v), work(1, p%q_rest), work(1, p%v_rest))
    end associate
  end subroutine step_in_arrays

  subroutine count_stages(self, n)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: n
    self%n_evaluations = self%n_evaluations + n
    if (counting) call count_up(counted_accelerations, n)
  end subroutine count_stages

  !> Accelerations of stage i, from the accelerations of other stages and their weights.
  subroutine stage(self, system, i, n_terms, from, weights, work, f)
    class(explicit_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    integer, intent(in) :: i, n_terms, from(n_terms)
    real(wp), intent(in) :: weights(2, n_terms)
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns), f(n_lanes, max_dof)
    integer :: m, n

    n = self%n_dof
    m = self%n_drives
    associate (p => self%plan, t => self%table)
      call stage_sums(n, n_terms, from, weights, work(1, p%f), work(1, p%in_q), work(1, p%in_v))
      call stage_states(n, t%c(i), work(1, p%h), work(1, p%q), work(1, p%v), work(1, p%in_q), &
                        work(1, p%in_v), work(1, p%stage_q), work(1, p%stage_v))
      call turn_drives(m, work(1, p%cosine), work(1, p%sine), &
                       work(1, p%stage_cosine + m*(i - 1)), work(1, p%stage_sine + m*(i - 1)), &
                       work(1, p%drive))
      if (system%timed) work(:, p%drive + m - 1) = self%since + t%c(i)*work(:, p%h)
      call system%acceleration(work(1, p%stage_q), work(1, p%stage_v), work(1, p%drive), f)
    end associate
  end subroutine stage

  !> Accelerations at the nodes of a collocation, predicted by those of the step before; in lanes
  !! where that fails, the iteration starts from those at the start of the step.
  subroutine solve(self, system, work)
    class(explicit_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns)
    real(wp) :: state(n_lanes)
    logical :: constant(n_lanes), again(n_lanes)

    associate (p => self%plan)
      work(:, p%f_old:p%f_new - 1) = work(:, p%f:p%f_old - 1)
    end associate
    state = merge(is_solved, at_work, self%fresh)
    if (.not. all(self%fresh)) call self%predict(system, work, state)
    constant = state < at_work
    if (any(constant)) call start_again(self, system, constant, work)
    state = at_work
    call self%iterate(system, work, state)
    again = .not. (abs(state - is_solved) <= 0.0_wp .or. constant)
    if (any(again)) then
      call start_again(self, system, again, work)
      state = merge(at_work, state, again)
      call self%iterate(system, work, state)
    end if
    self%made = abs(state - is_solved) <= 0.0_wp
    self%fresh = .not. self%made
  end subroutine solve

  !> Start some lanes from the accelerations at the start of the step.
  subroutine start_again(self, system, lanes, work)
    class(explicit_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    logical, intent(in) :: lanes(n_lanes)
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns)
    associate (p => self%plan)
      call self%accelerate(system, work, work(1, p%f_new))
      call start_lanes(self%table%n_stages, self%n_dof, lanes, work(1, p%f_new), work(1, p%f))
    end associate
  end subroutine start_again

  !> Accelerations at the start of a step, whose load phases are in the workspace.
  subroutine accelerate(self, system, work, a)
    class(explicit_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns), a(n_lanes, max_dof)
    associate (p => self%plan)
      call turn_drives(self%n_drives, work(1, p%cosine), work(1, p%sine), &
                       0.0_wp*work(:, p%sine:p%stage_cosine - 1) + 1.0_wp, &
                       0.0_wp*work(:, p%sine:p%stage_cosine - 1), work(1, p%drive))
      if (system%timed) work(:, p%drive + self%n_drives - 1) = self%since
      call system%acceleration(work(1, p%q), work(1, p%v), work(1, p%drive), a)
      call count_stages(self, 1)
    end associate
  end subroutine accelerate

  !> The first sweep over the nodes, for active lanes.
  subroutine predict(self, system, work, state)
    class(explicit_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns), state(n_lanes)
    real(wp), dimension(n_lanes) :: change, total
    integer :: i

    change = 0.0_wp
    total = 0.0_wp
    associate (p => self%plan, t => self%table)
      do i = 1, t%n_stages
        call self%stage(system, i, t%n_first, t%first_from(1, i), t%first_weights(1, 1, i), work, &
                        work(1, p%f_new))
        call exchange_lanes(self%n_dof, system%range%push, work(1, p%f_new), &
                            work(1, p%f + max_dof*(i - 1)), state, change, total)
      end do
      call count_stages(self, t%n_stages)
    end associate
  end subroutine predict

  !> Sweep over the nodes until every active lane has converged or diverged.
  subroutine iterate(self, system, work, state)
    class(explicit_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: work(n_lanes, self%plan%n_columns), state(n_lanes)
    real(wp), dimension(n_lanes) :: change, before, total, scale
    integer :: d, i, k

    scale = 0.0_wp
    associate (p => self%plan, t => self%table)
      do d = 0, self%n_dof - 1
        scale = scale + abs(work(:, p%q + d)) + abs(work(:, p%h)*work(:, p%v + d))
      end do
      before = 0.0_wp
      do k = 1, max_sweeps
        change = 0.0_wp
        total = 0.0_wp
        do i = 1, t%n_stages
          call self%stage(system, i, t%n_terms(i), t%from(1, i), t%weights(1, 1, i), work, &
                          work(1, p%f_new))
          work(:, p%node_q + max_dof*(i - 1):p%node_q + max_dof*(i - 1) + self%n_dof - 1) = &
            work(:, p%stage_q:p%stage_q + self%n_dof - 1)
          call exchange_lanes(self%n_dof, system%range%push, work(1, p%f_new), &
                              work(1, p%f + max_dof*(i - 1)), state, change, total)
        end do
        call count_stages(self, t%n_stages)
        call check_sweep(k, t%n_stages, work(1, p%h), scale, change, before, total, state)
        if (.not. any(state >= at_work)) exit
        before = change
      end do
    end associate
  end subroutine iterate

  !> Least margin of the system at the nodes of the last step of a collocation, for each lane.
  function margin_at_nodes(self, system) result(least)
    class(explicit_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp) :: least(n_lanes)
    least = self%margin_in_arrays(system, self%work(self%first))
  end function margin_at_nodes

  function margin_in_arrays(self, system, work) result(least)
    class(explicit_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: work(n_lanes, self%plan%n_columns)
    real(wp) :: least(n_lanes)
    integer :: first, i

    least = huge(1.0_wp)
    do i = 1, self%table%n_stages
      first = self%plan%node_q + max_dof*(i - 1)
      least = min(least, system%margin(work(:, first:first + self%n_dof - 1)))
    end do
  end function margin_in_arrays

  !> cos and sin of phases in two parts.
  pure subroutine phase_cosines(n, high, low, cosine, sine)
    integer, intent(in) :: n
    real(wp), intent(in) :: high(n_lanes, n), low(n_lanes, n)
    real(wp), intent(out) :: cosine(n_lanes, n), sine(n_lanes, n)
    real(wp) :: c(n_lanes), s(n_lanes)
    integer :: j
    do j = 1, n
      call sine_cosine_lanes(high(:, j), s, c)
      cosine(:, j) = c - s*low(:, j)
      sine(:, j) = s + c*low(:, j)
    end do
  end subroutine phase_cosines

  !> States of all lanes, shape (n_lanes, n_dof).
  pure subroutine get_state(self, q, v)
    class(explicit_type), intent(in) :: self
    real(wp), intent(out) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    integer :: d, at
    do d = 1, self%n_dof
      at = self%place(self%plan%q + d - 1)
      q(:, d) = self%work(at + 1:at + n_lanes)
      at = self%place(self%plan%v + d - 1)
      v(:, d) = self%work(at + 1:at + n_lanes)
    end do
  end subroutine get_state

  !> Accelerations of all lanes, shape (n_lanes, max_dof); the next step is not affected.
  subroutine get_accelerations(self, system, a)
    class(explicit_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: a(n_lanes, max_dof)
    associate (p => self%plan)
      call phase_cosines(self%n_drives, self%high, self%low, &
                         self%work(self%place(p%cosine) + 1), self%work(self%place(p%sine) + 1))
    end associate
    call self%accelerate(system, self%work(self%first), a)
  end subroutine get_accelerations

  !> Number of elements before a column of the workspace.
  pure integer function place(self, column)
    class(explicit_type), intent(in) :: self
    integer, intent(in) :: column
    place = self%first - 1 + n_lanes*(column - 1)
  end function place

  !> Replace the state in a lane, without its rounding error.
  pure subroutine set_lane(self, lane, q, v)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: lane
    real(wp), intent(in) :: q(:), v(:)
    integer :: d
    self%fresh(lane) = .true.
    associate (p => self%plan)
      do d = 1, size(q)
        self%work(self%place(p%q + d - 1) + lane) = q(d)
        self%work(self%place(p%v + d - 1) + lane) = v(d)
        self%work(self%place(p%q_rest + d - 1) + lane) = 0.0_wp
        self%work(self%place(p%v_rest + d - 1) + lane) = 0.0_wp
      end do
    end associate
  end subroutine set_lane

  !> Replace coordinates first ... n_dof and their velocities in all lanes.
  pure subroutine set_from(self, first, q, v)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: first
    !> Shape (n_lanes, n_dof).
    real(wp), intent(in) :: q(:, :), v(:, :)
    integer :: d
    self%fresh = .true.
    associate (p => self%plan, work => self%work)
      do d = first, self%n_dof
        work(self%place(p%q + d - 1) + 1:self%place(p%q + d)) = q(:, d)
        work(self%place(p%v + d - 1) + 1:self%place(p%v + d)) = v(:, d)
        work(self%place(p%q_rest + d - 1) + 1:self%place(p%q_rest + d)) = 0.0_wp
        work(self%place(p%v_rest + d - 1) + 1:self%place(p%v_rest + d)) = 0.0_wp
      end do
    end associate
  end subroutine set_from

  !> Multiply coordinates first ... n_dof, their velocities and rounding errors by one factor
  !! per lane.
  pure subroutine scale_lanes(self, first, factors)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: first
    real(wp), intent(in) :: factors(n_lanes)
    integer :: d, i, at
    do d = first, self%n_dof
      do i = 0, 3
        at = self%place(self%plan%q + max_dof*i + d - 1)
        self%work(at + 1:at + n_lanes) = factors*self%work(at + 1:at + n_lanes)
      end do
      ! Accelerations predict the next step: those of a perturbation are proportional to it.
      do i = 0, self%table%n_stages - 1
        at = self%place(self%plan%f + max_dof*i + d - 1)
        self%work(at + 1:at + n_lanes) = factors*self%work(at + 1:at + n_lanes)
      end do
    end do
  end subroutine scale_lanes

  !> Length of the data that a lane needs to continue bit for bit.
  pure integer function lane_memory_size(self)
    class(explicit_type), intent(in) :: self
    lane_memory_size = 4*max_dof + 2*self%n_drives
  end function lane_memory_size

  !> State, rounding errors and phases of a lane.
  pure function save_lane(self, lane) result(memory)
    class(explicit_type), intent(in) :: self
    integer, intent(in) :: lane
    real(wp) :: memory(self%lane_memory_size())
    integer :: i
    memory = [(self%work(self%place(self%plan%q + i) + lane), i=0, 4*max_dof - 1), &
              self%high(lane, :), self%low(lane, :)]
  end function save_lane

  pure subroutine load_lane(self, lane, memory)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: lane
    real(wp), intent(in) :: memory(:)
    integer :: i
    do i = 0, 4*max_dof - 1
      self%work(self%place(self%plan%q + i) + lane) = memory(i + 1)
    end do
    i = 4*max_dof + self%n_drives
    self%high(lane, :) = memory(4*max_dof + 1:i)
    self%low(lane, :) = memory(i + 1:i + self%n_drives)
  end subroutine load_lane

  !> Stop the motion of a lane from now on.
  pure subroutine stop_lane(self, lane)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: lane
    self%work(self%place(self%plan%h) + lane) = 0.0_wp
  end subroutine stop_lane

  ! The workspace of a method that runs in lanes: states, stages and load phases in one array, in
  ! columns of lanes.

  !> Store steps and the load phases of the stages in the workspace.
  pure subroutine furnish(table, plan, frequencies, h, work)
    type(explicit_table_type), intent(in) :: table
    type(work_plan), intent(in) :: plan
    real(wp), intent(in) :: frequencies(:, :), h(n_lanes)
    real(wp), intent(inout) :: work(n_lanes, plan%n_columns)
    real(wp) :: angle
    integer :: i, j, k, column

    work(:, plan%h) = h
    do i = 1, table%n_stages
      do j = 1, size(frequencies, 2)
        column = size(frequencies, 2)*(i - 1) + j - 1
        work(:, plan%stage_cosine + column) = 1.0_wp
        work(:, plan%stage_sine + column) = 0.0_wp
        do k = 1, n_lanes
          angle = frequencies(k, j)*(h(k)*table%c(i))
          ! Stopped lanes, and constant loads: most of them when a single motion is computed.
          if (angle == 0.0_wp) cycle
          work(k, plan%stage_cosine + column) = cos(angle)
          work(k, plan%stage_sine + column) = sin(angle)
        end do
      end do
    end do
  end subroutine furnish

  pure type(work_plan) function new_work_plan(n_drives, n_stages, implicit) result(plan)
    integer, intent(in) :: n_drives, n_stages
    logical, intent(in) :: implicit
    plan%q = plan%h + 1
    plan%v = plan%q + max_dof
    plan%q_rest = plan%v + max_dof
    plan%v_rest = plan%q_rest + max_dof
    plan%in_q = plan%v_rest + max_dof
    plan%in_v = plan%in_q + max_dof
    plan%stage_q = plan%in_v + max_dof
    plan%stage_v = plan%stage_q + max_dof
    plan%drive = plan%stage_v + max_dof
    plan%cosine = plan%drive + n_drives
    plan%sine = plan%cosine + n_drives
    plan%stage_cosine = plan%sine + n_drives
    plan%stage_sine = plan%stage_cosine + n_drives*n_stages
    plan%f = plan%stage_sine + n_drives*n_stages
    plan%n_columns = plan%f + max_dof*n_stages - 1
    if (.not. implicit) return
    plan%f_old = plan%n_columns + 1
    plan%f_new = plan%f_old + max_dof*n_stages
    plan%node_q = plan%f_new + max_dof
    plan%n_columns = plan%node_q + max_dof*n_stages - 1
  end function new_work_plan

  ! Gauss-Legendre collocation with trajectories in the lanes: procedures for its fixed-point
  ! iteration.
  !
  !   f_i = a(q_0 + c_i h v_0 + h^2 sum_j a2_ij f_j, v_0 + h sum_j a_ij f_j)
  ! is solved node by node, each with the newest accelerations of the other nodes (Gauss and
  ! Seidel). A converged lane is not changed, so that its numbers do not depend on its neighbours.

  !> Set the same accelerations at all nodes in the selected lanes.
  pure subroutine start_lanes(n_nodes, n_dof, wanted, f_0, f)
    integer, intent(in) :: n_nodes, n_dof
    logical, intent(in) :: wanted(n_lanes)
    real(wp), intent(in) :: f_0(n_lanes, max_dof)
    real(wp), intent(inout) :: f(n_lanes, max_dof, *)
    integer :: d, i
    do i = 1, n_nodes
      do d = 1, n_dof
        f(:, d, i) = merge(f_0(:, d), f(:, d, i), wanted)
      end do
    end do
  end subroutine start_lanes

  !> Replace the accelerations of a node in active lanes; accumulate changes and
  !! sizes.
  pure subroutine exchange_lanes(n_dof, runaway, new, old, state, change, total)
    integer, intent(in) :: n_dof
    !> Accelerations that change by more than this diverge.
    real(wp), intent(in) :: runaway
    real(wp), intent(in) :: new(n_lanes, max_dof)
    real(wp), intent(inout) :: old(n_lanes, max_dof)
    real(wp), intent(inout), dimension(n_lanes) :: state, change, total
    real(wp) :: part
    integer :: d, l

    do d = 1, n_dof
      !GCC$ unroll 1
      do l = 1, n_lanes
        part = abs(new(l, d) - old(l, d))
        state(l) = merge(state(l), ran_away, part <= runaway .or. state(l) < at_work)
        change(l) = change(l) + merge(part, 0.0_wp, state(l) >= at_work)
        old(l, d) = merge(new(l, d), old(l, d), state(l) >= at_work)
        total(l) = total(l) + abs(old(l, d))
      end do
    end do
  end subroutine exchange_lanes

  !> Mark the lanes that have converged after sweep `sweep`.
  pure subroutine check_sweep(sweep, n_nodes, h, size_of_state, change, before, total, state)
    integer, intent(in) :: sweep, n_nodes
    !> Steps; sum of the sizes of coordinates, and of velocities times the step; changes of this
    !! sweep and of the one before, 0 before the first; sum of the sizes of accelerations.
    real(wp), intent(in), dimension(n_lanes) :: h, size_of_state, change, before, total
    real(wp), intent(inout) :: state(n_lanes)
    real(wp) :: expected
    integer :: l

    do l = 1, n_lanes
      if (state(l) < at_work) cycle
      ! The next correction would shrink by the same factor again.
      expected = change(l)
      if (before(l) > change(l)) expected = change(l)*(change(l)/before(l))
      if (expected <= max(solved*total(l), negligible)) state(l) = is_solved
      ! If accelerations are small differences of large terms, only rounding still changes them.
      if (sweep > 2 .and. change(l) >= 0.5_wp*before(l) &
          .and. h(l)**2*change(l) <= n_nodes*rounding*size_of_state(l)) state(l) = is_solved
    end do
  end subroutine check_sweep

end module viscovib_explicit
