! Optimize: -O3
!> The nonlinear equations of one step with memory: X = G z + Z y(X), where y contains the
!! nonlinear parts of hereditary variables and the force remainders at the points of the step.
!!
!! Solved by fixed-point iteration, which contracts like h^2 times the nonlinear stiffness, and by
!! Newton's method where the iteration is slow. The maps G and Z are in `hereditary_maps`.
module viscovib_step_equations
  use viscovib_collocation, only: collocation_type
  use viscovib_counters, only: count_up, counted_turns, counting
  use viscovib_dense, only: factorize, outer, solve
  use viscovib_hereditary_kernels, only: add_columns, carry_on, compare, copy, product_of
  use viscovib_hereditary_maps, only: step_map_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_quadrature, only: lagrange, lagrange_factors
  implicit none
  private

  public :: step_equations_type, new_step_equations, solved_for

  integer, parameter :: max_iterations = 50
  !> A correction whose cube may overflow: the iteration diverges.
  real(wp), parameter, public :: out_of_reach = 1.0e75_wp
  !> Contraction beyond which Newton's method replaces the iteration; iterations before this test.
  real(wp), parameter :: slow = 0.25_wp
  integer, parameter :: patience = 2
  !> Change at rounding level, relative to displacements.
  real(wp), parameter :: rounding = 1.0e-13_wp

  type :: step_equations_type
    integer :: n_iterations = 0
    !> Nonlinear inputs: hereditary variables at the start of the step, shape (n_bent),
    !! and the argument of `from_bend`.
    real(wp), allocatable :: y_start(:), y(:)
    !> Inputs of the step, and its solution.
    real(wp), allocatable :: z(:), x(:)
    !> Relative change of displacements at which a solution counts as converged.
    real(wp), private :: solved = rounding
    !> Extrapolation of nonlinear inputs to the next step: from the start and from the
    !! other points; of force remainders from nodes.
    real(wp), allocatable, private :: onward_start(:), onward(:, :), onward_nodes(:, :)
    !> From X of a coordinate to its rates at the points, times h.
    real(wp), allocatable, private :: to_rates(:, :)
    !> Workspace: linear part, next X, displacements with rates and hereditary variables at points.
    real(wp), allocatable, private :: linear(:), next(:), u_points(:, :), w_points(:, :)
    !> Zeros, shape of X.
    real(wp), allocatable, private :: nothing(:)
  contains
    procedure :: start_bends
    procedure :: sharpen
    procedure :: predict
    procedure :: iterate
    procedure :: nonlinear_share
    procedure, private :: evaluate_bends
    procedure, private :: evaluate_remainders
    procedure, private :: newton_step
    procedure, private :: at_nodes
  end type step_equations_type

contains

  !> Relative change at which solutions count as converged for a tolerance: so small that steps and
  !! kernels determine the error, even if the motion amplifies small errors.
  pure real(wp) function solved_for(tolerance) result(solved)
    real(wp), intent(in) :: tolerance
    solved = max(1.0e-6_wp*tolerance, epsilon(1.0_wp))
  end function solved_for

  subroutine new_step_equations(self, map, table, solved)
    type(step_equations_type), intent(out) :: self
    type(step_map_type), intent(in) :: map
    type(collocation_type), intent(in) :: table
    !> Relative change of displacements at which a solution counts as converged.
    real(wp), intent(in) :: solved
    real(wp) :: basis(0:table%s + 1)
    integer :: j, s

    s = table%s
    self%solved = solved
    allocate (self%y_start(size(map%bent)), self%y(size(map%from_bend, 2)))
    allocate (self%z(size(map%from_input, 2)), self%linear(size(map%from_input, 1)))
    allocate (self%x, self%next, mold=self%linear)
    allocate (self%nothing(size(self%linear)), source=0.0_wp)
    allocate (self%u_points(s + 1, map%n_dof + map%n_rates), self%w_points(s + 1, map%n_memory))
    self%y = 0.0_wp
    self%w_points = 0.0_wp
    allocate (self%to_rates(s + 1, s + 1))
    do j = 1, s + 1
      basis = table%slopes(table%points(j))
      self%to_rates(j, :) = basis(1:)
    end do
    allocate (self%onward_start(s + 1), self%onward(s + 1, s + 1), self%onward_nodes(s, s))
    do j = 1, s + 1
      basis = table%basis(1.0_wp + table%points(j))
      self%onward_start(j) = basis(0)
      self%onward(j, :) = basis(1:)
    end do
    call node_extrapolation(table, self%onward_nodes)
  end subroutine new_step_equations

  !> Extrapolation from values at the nodes of one step to the nodes of the next.
  subroutine node_extrapolation(table, onward)
    type(collocation_type), intent(in) :: table
    real(wp), intent(out) :: onward(:, :)
    real(wp) :: c(table%s), factors(table%s)
    integer :: i
    c = table%points(1:table%s)
    factors = lagrange_factors(c)
    do i = 1, table%s
      onward(i, :) = lagrange(c, factors, 1.0_wp + c(i))
    end do
  end subroutine node_extrapolation

  !> Solve to rounding from now on.
  subroutine sharpen(self)
    class(step_equations_type), intent(inout) :: self
    self%solved = min(self%solved, rounding)
  end subroutine sharpen

  !> Nonlinear part at displacements u and velocities v, for the start of the next step.
  subroutine start_bends(self, system, map, u_start, v_start)
    class(step_equations_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(step_map_type), intent(in) :: map
    real(wp), intent(in) :: u_start(:), v_start(:)
    real(wp) :: u(1, size(u_start) + map%n_rates), w(1, system%n_memory())
    integer :: b

    u(1, :size(u_start)) = u_start
    if (map%n_rates > 0) u(1, size(u_start) + 1:) = v_start(system%rates)
    w = 0.0_wp
    if (size(map%bent) > 0) call system%deflection_remainder(u, w)
    do b = 1, size(map%bent)
      self%y(b*(map%s + 1)) = w(1, map%bent(b))
    end do
  end subroutine start_bends

  !> Predict the nonlinear parts at the points of the next step: extrapolated from the last step if
  !! it was of the same kind, else constant.
  subroutine predict(self, map, rolling)
    class(step_equations_type), intent(inout) :: self
    type(step_map_type), intent(in) :: map
    logical, intent(in) :: rolling
    integer :: b, n, s

    s = map%s
    do b = 1, size(self%y_start)
      associate (part => self%y((b - 1)*(s + 1) + 1:b*(s + 1)))
        if (rolling) then
          call carry_on(s + 1, self%onward_start, self%onward, self%y_start(b), part)
        else
          self%y_start(b) = part(s + 1)
          part = part(s + 1)
        end if
      end associate
    end do
    if (map%separable .or. .not. rolling) return
    n = map%at_remainder
    do b = 1, map%n_dof
      self%y(n + 1:n + s) = matmul(self%onward_nodes, self%y(n + 1:n + s))
      n = n + s
    end do
  end subroutine predict

  !> Solve X = G z + Z y(X), starting from the predicted y.
  subroutine iterate(self, system, map, u, made)
    class(step_equations_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(step_map_type), intent(in) :: map
    !> Displacements at the start of the step, shape (n_dof).
    real(wp), intent(in), contiguous :: u(:)
    logical, intent(out) :: made
    real(wp) :: change, before, expected, size_of
    integer :: turn, n_rows, n_y
    logical :: newton

    n_rows = size(self%x)
    n_y = size(self%y)
    call product_of(n_rows, size(self%z), map%from_input, self%z, self%nothing, self%linear)
    if (n_y == 0) then
      self%x = self%linear
      made = all(abs(self%x) <= huge(1.0_wp))
      return
    end if
    call product_of(n_rows, n_y, map%from_bend, self%y, self%linear, self%x)
    newton = .false.
    before = huge(1.0_wp)
    do turn = 1, max_iterations
      self%n_iterations = self%n_iterations + 1
      if (counting) call count_up(counted_turns, 1)
      call self%evaluate_bends(system, map, u)
      call product_of(n_rows, n_y, map%from_bend, self%y, self%linear, self%next)
      if (newton) then
        call self%newton_step(system, map, made)
        if (.not. made) return
      end if
      call compare(map%n_core, self%x, self%next, change, size_of)
      call copy(n_rows, self%next, self%x)
      ! The next correction would shrink by the same factor again. It is compared with the change of
      ! the motion in the step, not with its displacement: else a short step, such as the first ones
      ! with memory, gives no velocity. The rounding error of the displacements does not shrink.
      expected = change
      if (before > change .and. turn > 1) expected = change*(change/before)
      made = expected <= self%solved*size_of &
             .or. (change >= 0.5_wp*before .and. change <= rounding*(size_of + maxval(abs(u))))
      if (made .or. .not. change <= out_of_reach) return
      if (turn >= patience .and. change > slow*before) newton = .true.
      before = change
    end do
  end subroutine iterate

  !> Displacement in the step due to the nonlinear parts, relative to the displacements.
  pure real(wp) function nonlinear_share(self, u)
    class(step_equations_type), intent(in) :: self
    !> Displacements at the start of the step, shape (n_dof).
    real(wp), intent(in) :: u(:)
    real(wp) :: size_of
    size_of = maxval(abs(self%x)) + maxval(abs(u))
    nonlinear_share = 0.0_wp
    if (size_of > 0.0_wp) nonlinear_share = maxval(abs(self%x - self%linear))/size_of
  end function nonlinear_share

  !> y(X), and the displacements at which it is evaluated.
  subroutine evaluate_bends(self, system, map, u)
    class(step_equations_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(step_map_type), intent(in) :: map
    real(wp), intent(in), contiguous :: u(:)
    integer :: b, first, s

    s = map%s
    call add_columns(s + 1, map%n_dof, u, self%x, self%u_points)
    do b = 1, map%n_rates
      first = (system%rates(b) - 1)*(s + 1)
      self%u_points(:, map%n_dof + b) = matmul(self%to_rates, self%x(first + 1:first + s + 1))/map%h
    end do
    if (size(map%bent) > 0) call system%deflection_remainder(self%u_points, self%w_points)
    do b = 1, size(map%bent)
      call copy(s + 1, self%w_points(:, map%bent(b)), self%y((b - 1)*(s + 1) + 1:b*(s + 1)))
    end do
    if (.not. map%separable) call self%evaluate_remainders(system, map)
  end subroutine evaluate_bends

  !> r(u, v) at the nodes.
  subroutine evaluate_remainders(self, system, map)
    class(step_equations_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(step_map_type), intent(in) :: map
    real(wp) :: inner(map%s, map%n_dof), variables(map%s, map%n_memory)
    real(wp) :: force(map%s, map%n_dof), rates(map%s, map%n_dof), loads(map%s, map%n_dof)
    integer :: a, first

    do a = 1, map%n_dof
      call copy(map%s, self%u_points(:, a), inner(:, a))
    end do
    first = map%variable_row
    do a = 1, map%n_memory
      call copy(map%s, self%x(first:first + map%s - 1), variables(:, a))
      first = first + map%s
    end do
    if (system%moving) then
      call self%at_nodes(map, rates, loads)
      call system%moving_remainder(inner, rates, variables, loads, force)
    else
      call system%force_remainder(inner, variables, force)
    end if
    first = map%at_remainder + 1
    do a = 1, map%n_dof
      call copy(map%s, force(:, a), self%y(first:first + map%s - 1))
      first = first + map%s
    end do
  end subroutine evaluate_remainders

  !> Rates and loads at the nodes. Accelerations are a polynomial with one term per node; the
  !! displacements and the rate at the start determine it.
  subroutine at_nodes(self, map, rates, loads)
    class(step_equations_type), intent(in) :: self
    type(step_map_type), intent(in) :: map
    real(wp), intent(out) :: rates(:, :), loads(:, :)
    integer :: a, first

    do a = 1, map%n_dof
      first = (a - 1)*(map%s + 1)
      rates(:, a) = map%rate_from_start*self%z(map%at_v + a) &
                    + matmul(map%rate_from_moved, self%x(first + 1:first + map%s))
      first = map%at_load + (a - 1)*map%s
      loads(:, a) = self%z(first + 1:first + map%s)
    end do
  end subroutine at_nodes

  !> Newton's next X: x + (1 - Z S)^-1 (next - x), S the slopes of y.
  subroutine newton_step(self, system, map, made)
    class(step_equations_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(step_map_type), intent(in) :: map
    logical, intent(out) :: made
    real(wp) :: slopes(map%s + 1, map%n_memory, map%n_dof + map%n_rates)
    real(wp) :: inner(map%s, map%n_dof), variables(map%s, map%n_memory)
    real(wp) :: by_u(map%s, map%n_dof, map%n_dof)
    real(wp) :: by_v(map%s, map%n_dof, map%n_memory), by_rate(map%s, map%n_dof, map%n_dof)
    real(wp) :: rates(map%s, map%n_dof), loads(map%s, map%n_dof)
    real(wp) :: matrix(size(self%x), size(self%x)), shift(size(self%x))
    integer :: pivots(size(self%x)), a, b, i, j, n, s, row, column, first
    logical :: singular

    s = map%s
    n = size(self%x)
    matrix = 0.0_wp
    do i = 1, n
      matrix(i, i) = 1.0_wp
    end do
    if (size(map%bent) > 0) call system%deflection_slopes(self%u_points, slopes)
    do b = 1, map%n_dof
      do j = 1, size(map%bent)
        do i = 1, s + 1
          row = (b - 1)*(s + 1) + i
          column = (j - 1)*(s + 1) + i
          matrix(:, row) = matrix(:, row) - map%from_bend(:, column)*slopes(i, map%bent(j), b)
        end do
      end do
    end do
    do b = 1, map%n_rates
      row = (system%rates(b) - 1)*(s + 1)
      do j = 1, size(map%bent)
        do i = 1, s + 1
          column = (j - 1)*(s + 1) + i
          do a = 1, s + 1
            matrix(:, row + a) = matrix(:, row + a) - map%from_bend(:, column) &
                                 *(slopes(i, map%bent(j), map%n_dof + b)*self%to_rates(i, a)/map%h)
          end do
        end do
      end do
    end do
    if (.not. map%separable) then
      first = map%variable_row
      inner = self%u_points(:s, :)
      variables = reshape(self%x(first:first + size(variables) - 1), shape(variables))
      by_rate = 0.0_wp
      if (system%moving) then
        call self%at_nodes(map, rates, loads)
        call system%moving_slopes(inner, rates, variables, loads, by_u, by_rate, by_v)
      else
        call system%force_slopes(inner, variables, by_u, by_v)
      end if
      do a = 1, map%n_dof
        do i = 1, s
          column = map%at_remainder + (a - 1)*s + i
          do b = 1, map%n_dof
            row = (b - 1)*(s + 1)
            matrix(:, row + i) = matrix(:, row + i) - map%from_bend(:, column)*by_u(i, a, b)
            if (.not. abs(by_rate(i, a, b)) > 0.0_wp) cycle
            matrix(:, row + 1:row + s) = matrix(:, row + 1:row + s) &
                                         - outer(map%from_bend(:, column), by_rate(i, a, b) &
                                                 *map%rate_from_moved(i, :))
          end do
          do j = 1, map%n_memory
            row = first + (j - 1)*s + i - 1
            matrix(:, row) = matrix(:, row) - map%from_bend(:, column)*by_v(i, a, j)
          end do
        end do
      end do
    end if
    shift = self%next - self%x
    call factorize(n, matrix, pivots, singular)
    made = .not. singular
    if (singular) return
    call solve(n, matrix, pivots, shift)
    self%next = self%x + shift
  end subroutine newton_step

end module viscovib_step_equations
