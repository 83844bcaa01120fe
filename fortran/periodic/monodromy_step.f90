! Optimize: -O3
!> Steps of y'' + D y' + K(t) y = 0 by Gauss collocation, one system in each lane.
!!
!! With tau = t/h in a step, w = h y' and accelerations a_i at the nodes c_i,
!!
!!   a_i + h^2 K_i sum_j A2_ij a_j + h D sum_j A_ij a_j = -[h^2 K_i (q + c_i w) + h D w],
!!   q + w + sum_j b_j (1 - c_j) a_j -> q,   w + sum_j b_j a_j -> w,
!!
!! A2 = A A (Hairer, Lubich, Wanner, Geometric Numerical Integration, II.1.3). The linear equations
!! are solved by elimination without pivoting: the steps are so short that the matrix is close to
!! the identity.
module viscovib_monodromy_step
  use viscovib_gauss_table, only: gauss_table_type, new_gauss_table
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_quadrature, only: legendre
  implicit none
  private

  public :: step_table, new_step_table, advance, advance_drag

  !> Number of nodes; even, since equations are eliminated in pairs.
  integer, parameter, public :: n_nodes = 6

  type :: step_table
    !> Nodes c, weights b and b (1 - c), A and its square.
    real(wp) :: c(n_nodes) = 0.0_wp, b(n_nodes) = 0.0_wp, b_q(n_nodes) = 0.0_wp
    real(wp) :: a(n_nodes, n_nodes) = 0.0_wp, a_q(n_nodes, n_nodes) = 0.0_wp
    !> Give the last two Legendre coefficients of a polynomial through the nodes.
    real(wp) :: last(n_nodes) = 0.0_wp, second_last(n_nodes) = 0.0_wp
  end type step_table

contains

  pure subroutine new_step_table(table)
    type(step_table), intent(out) :: table
    type(gauss_table_type) :: gauss
    real(wp) :: p(0:n_nodes)
    integer :: i

    call new_gauss_table(gauss, n_nodes, 0)
    table%c = gauss%nodes(:n_nodes, 1)
    table%b = gauss%weights(:n_nodes, 1)
    table%b_q = gauss%weights_q(:n_nodes, 1)
    table%a = gauss%a(:n_nodes, :n_nodes, 1, 1)
    table%a_q = gauss%a_q(:n_nodes, :n_nodes, 1, 1)
    do i = 1, n_nodes
      p = legendre(n_nodes, table%c(i))
      table%last(i) = (2*n_nodes - 1)*table%b(i)*p(n_nodes - 1)
      table%second_last(i) = (2*n_nodes - 3)*table%b(i)*p(n_nodes - 2)
    end do
  end subroutine new_step_table

  !> Advance y by a step, and add an estimate of its relative error to `error`.
  !! The error is that of the Gauss rule for the residual times the adjoint solution. It is
  !! determined by their Legendre coefficients of degree s, which are estimated from the decay of
  !! the last two coefficients of the accelerations.
  pure subroutine advance(table, n, nodes, first, k, damping, y, g, error)
    type(step_table), intent(in) :: table
    !> Number of coordinates, number of nodes, and the first node of this step.
    integer, intent(in) :: n, nodes, first
    !> h^2 K at the nodes, and h D.
    real(wp), intent(in) :: k(n_lanes, nodes, n, n), damping(n_lanes, n, n)
    !> Each column is a solution (q, w).
    real(wp), intent(inout) :: y(n_lanes, 2*n, 2*n)
    !> Workspace.
    real(wp), intent(inout) :: g(n_lanes, n_nodes*n, n_nodes*n + 2*n)
    real(wp), intent(inout) :: error(n_lanes)

    call assemble(table, n, nodes, first, k, damping, y, g)
    call eliminate(n_nodes*n, 2*n, g)
    call update(table, n, g(1, 1, n_nodes*n + 1), y, error)
  end subroutine advance

  !> The same if D varies: h D at the nodes.
  pure subroutine advance_drag(table, n, nodes, first, k, damping, y, g, error)
    type(step_table), intent(in) :: table
    integer, intent(in) :: n, nodes, first
    real(wp), intent(in) :: k(n_lanes, nodes, n, n), damping(n_lanes, nodes, n, n)
    real(wp), intent(inout) :: y(n_lanes, 2*n, 2*n)
    real(wp), intent(inout) :: g(n_lanes, n_nodes*n, n_nodes*n + 2*n)
    real(wp), intent(inout) :: error(n_lanes)
    real(wp) :: total(n_lanes)
    integer :: a, b, c, i, j, node

    do i = 1, n_nodes
      node = first - 1 + i
      do a = 1, n
        do j = 1, n_nodes
          do b = 1, n
            g(:, (i - 1)*n + a, (j - 1)*n + b) = table%a_q(i, j)*k(:, node, a, b) &
                                                 + table%a(i, j)*damping(:, node, a, b)
          end do
        end do
        do c = 1, 2*n
          total = 0.0_wp
          do b = 1, n
            total = total - (k(:, node, a, b)*(y(:, b, c) + table%c(i)*y(:, n + b, c)) &
                             + damping(:, node, a, b)*y(:, n + b, c))
          end do
          g(:, (i - 1)*n + a, n_nodes*n + c) = total
        end do
      end do
    end do
    do i = 1, n_nodes*n
      g(:, i, i) = g(:, i, i) + 1.0_wp
    end do
    call eliminate(n_nodes*n, 2*n, g)
    call update(table, n, g(1, 1, n_nodes*n + 1), y, error)
  end subroutine advance_drag

  !> The matrix and its right-hand sides.
  pure subroutine assemble(table, n, nodes, first, k, damping, y, g)
    type(step_table), intent(in) :: table
    integer, intent(in) :: n, nodes, first
    real(wp), intent(in) :: k(n_lanes, nodes, n, n), damping(n_lanes, n, n), y(n_lanes, 2*n, 2*n)
    real(wp), intent(inout) :: g(n_lanes, n_nodes*n, n_nodes*n + 2*n)
    integer :: b, c, i, j

    do j = 1, n_nodes
      do b = 1, n
        call fill_column(table, n, nodes, first, j, k(:, :, :, b), damping(:, :, b), &
                         g(:, :, (j - 1)*n + b))
      end do
    end do
    do i = 1, n_nodes*n
      g(:, i, i) = g(:, i, i) + 1.0_wp
    end do
    do c = 1, 2*n
      call fill_right(table, n, nodes, first, k, damping, y(:, :, c), g(:, :, n_nodes*n + c))
    end do
  end subroutine assemble

  !> The accelerations at the nodes that follow from the solution at the start of the step.
  pure subroutine fill_right(table, n, nodes, first, k, damping, y, right)
    type(step_table), intent(in) :: table
    integer, intent(in) :: n, nodes, first
    real(wp), intent(in) :: k(n_lanes, nodes, n, n), damping(n_lanes, n, n), y(n_lanes, 2*n)
    real(wp), intent(inout) :: right(n_lanes, n_nodes*n)
    real(wp) :: total(n_lanes)
    integer :: a, b, i, l
    do i = 1, n_nodes
      do a = 1, n
        total = 0.0_wp
        do b = 1, n
          !GCC$ unroll 1
          do l = 1, n_lanes
            total(l) = total(l) - (k(l, first - 1 + i, a, b)*(y(l, b) + table%c(i)*y(l, n + b)) &
                                   + damping(l, a, b)*y(l, n + b))
          end do
        end do
        right(:, (i - 1)*n + a) = total
      end do
    end do
  end subroutine fill_right

  !> Contribution of node j of a coordinate to the equations at each node, of each coordinate.
  pure subroutine fill_column(table, n, nodes, first, j, k, damping, g)
    type(step_table), intent(in) :: table
    integer, intent(in) :: n, nodes, first, j
    real(wp), intent(in) :: k(n_lanes, nodes, n), damping(n_lanes, n)
    real(wp), intent(inout) :: g(n_lanes, n_nodes*n)
    integer :: a, i, l
    do i = 1, n_nodes
      do a = 1, n
        !GCC$ unroll 1
        do l = 1, n_lanes
          g(l, (i - 1)*n + a) = table%a_q(i, j)*k(l, first - 1 + i, a) &
                                + table%a(i, j)*damping(l, a)
        end do
      end do
    end do
  end subroutine fill_column

  !> Solve m equations with r right-hand sides, both even, in blocks of two; the solution overwrites
  !! the right-hand sides.
  pure subroutine eliminate(m, r, g)
    integer, intent(in) :: m, r
    real(wp), intent(inout) :: g(n_lanes, m, m + r)
    real(wp), dimension(n_lanes) :: s_11, s_21, s_12, s_22
    integer :: i, j, k, l

    do j = 1, m + r, 2
      do i = 1, m, 2
        s_11 = g(:, i, j)
        s_21 = g(:, i + 1, j)
        s_12 = g(:, i, j + 1)
        s_22 = g(:, i + 1, j + 1)
        do k = 1, min(i, j) - 1
          !GCC$ unroll 1
          do l = 1, n_lanes
            s_11(l) = s_11(l) - g(l, i, k)*g(l, k, j)
            s_21(l) = s_21(l) - g(l, i + 1, k)*g(l, k, j)
            s_12(l) = s_12(l) - g(l, i, k)*g(l, k, j + 1)
            s_22(l) = s_22(l) - g(l, i + 1, k)*g(l, k, j + 1)
          end do
        end do
        ! Diagonals are kept as reciprocals.
        if (i < j) then
          s_21 = s_21 - g(:, i + 1, i)*s_11
          s_22 = s_22 - g(:, i + 1, i)*s_12
        else if (i == j) then
          s_11 = 1.0_wp/s_11
          s_21 = s_21*s_11
          s_22 = 1.0_wp/(s_22 - s_21*s_12)
        else
          s_11 = s_11*g(:, j, j)
          s_21 = s_21*g(:, j, j)
          s_12 = (s_12 - s_11*g(:, j, j + 1))*g(:, j + 1, j + 1)
          s_22 = (s_22 - s_21*g(:, j, j + 1))*g(:, j + 1, j + 1)
        end if
        g(:, i, j) = s_11
        g(:, i + 1, j) = s_21
        g(:, i, j + 1) = s_12
        g(:, i + 1, j + 1) = s_22
      end do
    end do
    do j = m + 1, m + r, 2
      do i = m - 1, 1, -2
        s_11 = g(:, i, j)
        s_21 = g(:, i + 1, j)
        s_12 = g(:, i, j + 1)
        s_22 = g(:, i + 1, j + 1)
        do k = i + 2, m
          !GCC$ unroll 1
          do l = 1, n_lanes
            s_11(l) = s_11(l) - g(l, i, k)*g(l, k, j)
            s_21(l) = s_21(l) - g(l, i + 1, k)*g(l, k, j)
            s_12(l) = s_12(l) - g(l, i, k)*g(l, k, j + 1)
            s_22(l) = s_22(l) - g(l, i + 1, k)*g(l, k, j + 1)
          end do
        end do
        s_21 = s_21*g(:, i + 1, i + 1)
        s_22 = s_22*g(:, i + 1, i + 1)
        g(:, i + 1, j) = s_21
        g(:, i + 1, j + 1) = s_22
        g(:, i, j) = (s_11 - g(:, i, i + 1)*s_21)*g(:, i, i)
        g(:, i, j + 1) = (s_12 - g(:, i, i + 1)*s_22)*g(:, i, i)
      end do
    end do
  end subroutine eliminate

  pure subroutine update(table, n, acceleration, y, error)
    type(step_table), intent(in) :: table
    integer, intent(in) :: n
    real(wp), intent(in) :: acceleration(n_lanes, n, n_nodes, 2*n)
    real(wp), intent(inout) :: y(n_lanes, 2*n, 2*n), error(n_lanes)
    real(wp), dimension(n_lanes) :: q, w, last, second, squares, lasts, seconds
    integer :: a, c, i, l

    squares = 0.0_wp
    lasts = 0.0_wp
    seconds = 0.0_wp
    do c = 1, 2*n
      do a = 1, n
        q = y(:, a, c) + y(:, n + a, c)
        w = y(:, n + a, c)
        last = 0.0_wp
        second = 0.0_wp
        do i = 1, n_nodes
          !GCC$ unroll 1
          do l = 1, n_lanes
            q(l) = q(l) + table%b_q(i)*acceleration(l, a, i, c)
            w(l) = w(l) + table%b(i)*acceleration(l, a, i, c)
            last(l) = last(l) + table%last(i)*acceleration(l, a, i, c)
            second(l) = second(l) + table%second_last(i)*acceleration(l, a, i, c)
            squares(l) = squares(l) + table%b(i)*acceleration(l, a, i, c)**2
          end do
        end do
        y(:, a, c) = q
        y(:, n + a, c) = w
        lasts = lasts + last**2
        seconds = seconds + second**2
      end do
    end do
    squares = max(squares, tiny(1.0_wp))
    lasts = lasts/squares
    seconds = max(lasts, seconds/squares, tiny(1.0_wp))
    error = error + 2.0_wp/(2*n_nodes + 1)*lasts*(lasts/seconds)
  end subroutine update

end module viscovib_monodromy_step
