!> Gauss-Legendre collocation in fixed steps, the nodes side by side in the
!! vector unit.
!!
!! q_i = q_0 + c_i h v_0 + h^2 sum_j a2_ij f_j, v_i = v_0 + h sum_j a_ij f_j,
!! f_i = a(q_i, v_i): solved by fixed-point iteration from the polynomial of the
!! step before, stopped when the accelerations hardly change. Symplectic and
!! symmetric; order 2s at the step ends.
module viscovib_gauss
  use viscovib_driven_system, only: driven_system_type
  use viscovib_gauss_table, only: gauss_table_type, max_blocks, new_gauss_table
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: lane_product, n_lanes
  use viscovib_node_kernels, only: exchange, max_dof, node_states
  use viscovib_phases, only: new_phases, phases_type
  use viscovib_vector_math, only: largest_angle
  implicit none
  private

  public :: gauss_type, new_gauss

  !> Iterations of a step before it is tried again from a constant start.
  integer, parameter :: max_iterations = 40

  type :: gauss_type
    type(gauss_table_type) :: table
    type(phases_type) :: phases
    real(wp) :: h = 0.0_wp
    !> Iteration stops when accelerations change by less than this part.
    real(wp) :: tolerance = 0.0_wp
    !> State, and what rounding has left out of it, shape (n_dof).
    real(wp), allocatable :: q(:), v(:), q_rest(:), v_rest(:)
    !> Accelerations at the nodes.
    real(wp) :: f(n_lanes, max_dof, max_blocks) = 0.0_wp
    logical :: has_history = .false.
    !> Evaluations of a block of lanes, all told.
    integer(i8) :: n_evaluations = 0
  contains
    procedure :: step
    procedure :: memory_size
    procedure :: save_memory
    procedure :: load_memory
    procedure, private :: iterate
  end type gauss_type

contains

  !> Start at (q, v) at time `start`.
  pure subroutine new_gauss(method, system, s, q, v, start, h, tolerance)
    type(gauss_type), intent(out) :: method
    class(driven_system_type), intent(in) :: system
    !> Number of nodes, 1 to 16.
    integer, intent(in) :: s
    real(wp), intent(in) :: q(:), v(:), start, h, tolerance

    call new_gauss_table(method%table, s, min(4, s - 1))
    call new_phases(method%phases, system%drives, start, h, &
                    method%table%nodes(:, :method%table%n_blocks))
    method%h = h
    method%tolerance = tolerance
    method%q = q
    method%v = v
    allocate (method%q_rest(size(q)), method%v_rest(size(q)), source=0.0_wp)
  end subroutine new_gauss

  !> One step; `converged` is false, and the state stays, if the iteration does
  !! not settle from either start: the step is too large.
  subroutine step(self, system, converged)
    class(gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    logical, intent(out) :: converged
    real(wp) :: drive(n_lanes, max_dof, max_blocks), guess(n_lanes, max_dof, max_blocks)
    real(wp) :: change_q, change_v
    integer :: b, d

    do b = 1, self%table%n_blocks
      call self%phases%drives(b, drive(:, :, b))
    end do
    converged = .false.
    if (self%has_history) then
      do b = 1, self%table%n_blocks
        call all_products(self%table%n_blocks, self%table%extrapolation(:, :, :, b), self%f, &
                          guess(:, :, b))
      end do
      self%f(:, :, :self%table%n_blocks) = guess(:, :, :self%table%n_blocks)
      call self%iterate(system, drive, converged)
    end if
    if (.not. converged) then
      call constant_start(self, system, drive(:, :, 1))
      call self%iterate(system, drive, converged)
      if (.not. converged) return
    end if
    self%has_history = .true.
    do d = 1, size(self%q)
      change_q = self%h*(self%v(d) + self%h*sum(self%table%weights_q*self%f(:, d, :)))
      change_v = self%h*sum(self%table%weights*self%f(:, d, :))
      call add(self%q(d), self%q_rest(d), change_q)
      call add(self%v(d), self%v_rest(d), change_v)
    end do
    call self%phases%advance()
  end subroutine step

  !> Accelerations at the start of the step, at every node.
  subroutine constant_start(self, system, drive)
    class(gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: drive(n_lanes, max_dof)
    real(wp) :: q(n_lanes, max_dof), v(n_lanes, max_dof), f(n_lanes, max_dof)
    integer :: d

    do d = 1, size(self%q)
      q(:, d) = self%q(d)
      v(:, d) = self%v(d)
    end do
    call system%acceleration(q, v, drive, f)
    self%n_evaluations = self%n_evaluations + 1
    do d = 1, size(self%q)
      self%f(:, d, :) = f(1, d)
    end do
  end subroutine constant_start

  !> Fixed point of the accelerations.
  subroutine iterate(self, system, drive, converged)
    class(gauss_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: drive(n_lanes, max_dof, max_blocks)
    logical, intent(out) :: converged
    real(wp), dimension(n_lanes, max_dof) :: q, v
    real(wp) :: f(n_lanes, max_dof, max_blocks), q_0(max_dof), v_0(max_dof)
    real(wp) :: change, before, expected, total, reach
    integer :: k, b, n

    n = size(self%q)
    q_0 = 0.0_wp
    v_0 = 0.0_wp
    q_0(:n) = self%q
    v_0(:n) = self%v
    f = 0.0_wp
    converged = .false.
    before = 0.0_wp
    do k = 1, max_iterations
      do b = 1, self%table%n_blocks
        call all_products(self%table%n_blocks, self%table%a_q(:, :, :, b), self%f, q)
        call all_products(self%table%n_blocks, self%table%a(:, :, :, b), self%f, v)
        call node_states(self%h, self%table%nodes(:, b), q_0, v_0, q, v, reach)
        ! An iterate that runs away is stopped before it overflows.
        if (.not. reach <= largest_angle) return
        call system%acceleration(q, v, drive(:, :, b), f(:, :, b))
      end do
      self%n_evaluations = self%n_evaluations + self%table%n_blocks
      change = 0.0_wp
      total = 0.0_wp
      do b = 1, self%table%n_blocks
        call exchange(f(:, :, b), self%f(:, :, b), change, total)
      end do
      ! The next correction would shrink by the same factor again.
      expected = change
      if (before > change) expected = change*(change/before)
      if (expected <= self%tolerance*total) then
        converged = .true.
        return
      end if
      before = change
    end do
  end subroutine iterate

  !> sum_j table(:,j) f_j over the nodes of all blocks.
  pure subroutine all_products(n_blocks, table, f, total)
    integer, intent(in) :: n_blocks
    real(wp), intent(in) :: table(n_lanes, n_lanes, max_blocks), f(n_lanes, max_dof, max_blocks)
    real(wp), intent(out) :: total(n_lanes, max_dof)
    real(wp) :: part(n_lanes, max_dof)
    integer :: b

    call lane_product(n_lanes, max_dof, table(:, :, 1), f(:, :, 1), total)
    do b = 2, n_blocks
      call lane_product(n_lanes, max_dof, table(:, :, b), f(:, :, b), part)
      total = total + part
    end do
  end subroutine all_products

  !> Length of all that a run must know to go on bit for bit.
  pure integer function memory_size(self)
    class(gauss_type), intent(in) :: self
    memory_size = 4*size(self%q) + 2*size(self%phases%high) + size(self%f) + 1
  end function memory_size

  !> State, rests, phases, accelerations, and whether these predict.
  pure function save_memory(self) result(memory)
    class(gauss_type), intent(in) :: self
    real(wp) :: memory(self%memory_size())
    memory = [self%q, self%v, self%q_rest, self%v_rest, self%phases%high, self%phases%low, &
              reshape(self%f, [size(self%f)]), merge(1.0_wp, 0.0_wp, self%has_history)]
  end function save_memory

  pure subroutine load_memory(self, memory)
    class(gauss_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    integer :: n, m
    n = size(self%q)
    m = size(self%phases%high)
    self%q = memory(:n)
    self%v = memory(n + 1:2*n)
    self%q_rest = memory(2*n + 1:3*n)
    self%v_rest = memory(3*n + 1:4*n)
    self%phases%high = memory(4*n + 1:4*n + m)
    self%phases%low = memory(4*n + m + 1:4*n + 2*m)
    self%f = reshape(memory(4*n + 2*m + 1:size(memory) - 1), shape(self%f))
    self%has_history = memory(size(memory)) > 0.5_wp
  end subroutine load_memory

  !> total + change, keeping what rounding leaves out for the next time.
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
