! Optimize: -O3
!> The loops of a collocation step over the lanes.
!!
!! gfortran 12 uses whole vector registers here in two cases only. A loop over the lanes
!! is unrolled before the vectoriser sees it, unless `unroll 1` prevents that. If
!! sums stay in registers over a loop, that loop must not be vectorized (`novector`)
!! and the lanes must be array expressions; otherwise they are split in halves that go
!! through memory. Each is worth a factor of two to ten.
module viscovib_node_kernels
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof, n_lanes
  implicit none
  private

  public :: node_states, predict, exchange, lane_sum, lane_product_sum

contains

  !> States at the nodes of a block from the accelerations at all nodes:
  !! q = q_0 + h c v_0 + h^2 sum_j a_q_j f_j, v = v_0 + h sum_j a_j f_j.
  pure subroutine node_states(n_blocks, n_dof, times, sums, f, q_0, v_0, q, v)
    integer, intent(in) :: n_blocks, n_dof
    !> h c in the lanes, and h^2 a_q and h a; the node of the sum is the
    !! last index, block by block.
    real(wp), intent(in) :: times(n_lanes), sums(n_lanes, 2, n_lanes*n_blocks)
    real(wp), intent(in) :: f(n_lanes, max_dof, n_blocks), q_0(max_dof), v_0(max_dof)
    real(wp), intent(out) :: q(n_lanes, max_dof), v(n_lanes, max_dof)
    real(wp), dimension(n_lanes) :: q_1, q_2, q_3, v_1, v_2, v_3
    integer :: b, d, j

    if (n_dof == 1) then
      call one_state(n_blocks, times, sums, f, q_0(1), v_0(1), q(1, 1), v(1, 1))
      return
    end if
    do d = 1, n_dof, 3
      q_1 = q_0(d) + times*v_0(d)
      q_2 = q_0(d + 1) + times*v_0(d + 1)
      q_3 = q_0(d + 2) + times*v_0(d + 2)
      v_1 = v_0(d)
      v_2 = v_0(d + 1)
      v_3 = v_0(d + 2)
      do b = 1, n_blocks
        !GCC$ novector
        do j = 1, n_lanes
          q_1 = q_1 + sums(:, 1, j + n_lanes*(b - 1))*f(j, d, b)
          v_1 = v_1 + sums(:, 2, j + n_lanes*(b - 1))*f(j, d, b)
          q_2 = q_2 + sums(:, 1, j + n_lanes*(b - 1))*f(j, d + 1, b)
          v_2 = v_2 + sums(:, 2, j + n_lanes*(b - 1))*f(j, d + 1, b)
          q_3 = q_3 + sums(:, 1, j + n_lanes*(b - 1))*f(j, d + 2, b)
          v_3 = v_3 + sums(:, 2, j + n_lanes*(b - 1))*f(j, d + 2, b)
        end do
      end do
      q(:, d) = q_1
      q(:, d + 1) = q_2
      q(:, d + 2) = q_3
      v(:, d) = v_1
      v(:, d + 1) = v_2
      v(:, d + 2) = v_3
    end do
  end subroutine node_states

  !> The same for one coordinate, in independent sums of pairs.
  pure subroutine one_state(n_blocks, times, sums, f, q_0, v_0, q, v)
    integer, intent(in) :: n_blocks
    real(wp), intent(in) :: times(n_lanes), sums(n_lanes, 2, n_lanes*n_blocks)
    real(wp), intent(in) :: f(n_lanes, max_dof, n_blocks), q_0, v_0
    real(wp), intent(out) :: q(n_lanes), v(n_lanes)
    integer :: b, k, l

    !GCC$ unroll 1
    do l = 1, n_lanes
      q(l) = q_0 + times(l)*v_0
      v(l) = v_0
    end do
    do b = 1, n_blocks
      k = n_lanes*(b - 1)
      !GCC$ unroll 1
      do l = 1, n_lanes
        q(l) = q(l) + (((sums(l, 1, k + 1)*f(1, 1, b) + sums(l, 1, k + 2)*f(2, 1, b)) &
                        + (sums(l, 1, k + 3)*f(3, 1, b) + sums(l, 1, k + 4)*f(4, 1, b))) &
                       + ((sums(l, 1, k + 5)*f(5, 1, b) + sums(l, 1, k + 6)*f(6, 1, b)) &
                          + (sums(l, 1, k + 7)*f(7, 1, b) + sums(l, 1, k + 8)*f(8, 1, b))))
        v(l) = v(l) + (((sums(l, 2, k + 1)*f(1, 1, b) + sums(l, 2, k + 2)*f(2, 1, b)) &
                        + (sums(l, 2, k + 3)*f(3, 1, b) + sums(l, 2, k + 4)*f(4, 1, b))) &
                       + ((sums(l, 2, k + 5)*f(5, 1, b) + sums(l, 2, k + 6)*f(6, 1, b)) &
                          + (sums(l, 2, k + 7)*f(7, 1, b) + sums(l, 2, k + 8)*f(8, 1, b))))
      end do
    end do
  end subroutine one_state

  !> sum_j table_j f_j over the nodes of all blocks.
  pure subroutine predict(n_blocks, n_dof, table, f, total)
    integer, intent(in) :: n_blocks, n_dof
    real(wp), intent(in) :: table(n_lanes, n_lanes*n_blocks), f(n_lanes, max_dof, n_blocks)
    real(wp), intent(out) :: total(n_lanes, max_dof)
    real(wp), dimension(n_lanes) :: s_1, s_2, s_3
    integer :: b, d, j

    do d = 1, n_dof, 3
      s_1 = 0.0_wp
      s_2 = 0.0_wp
      s_3 = 0.0_wp
      do b = 1, n_blocks
        !GCC$ novector
        do j = 1, n_lanes
          s_1 = s_1 + table(:, j + n_lanes*(b - 1))*f(j, d, b)
          s_2 = s_2 + table(:, j + n_lanes*(b - 1))*f(j, d + 1, b)
          s_3 = s_3 + table(:, j + n_lanes*(b - 1))*f(j, d + 2, b)
        end do
      end do
      total(:, d) = s_1
      total(:, d + 1) = s_2
      total(:, d + 2) = s_3
    end do
  end subroutine predict

  !> Replace old accelerations by new ones, and accumulate the sizes of the
  !! changes (a sum, since a maximum would keep the loop scalar).
  pure subroutine exchange(n_dof, new, old, change)
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: new(n_lanes, max_dof)
    real(wp), intent(inout) :: old(n_lanes, max_dof), change
    real(wp) :: part(n_lanes)
    integer :: d, l

    part = 0.0_wp
    do d = 1, n_dof, 3
      !GCC$ unroll 1
      do l = 1, n_lanes
        part(l) = part(l) + (abs(new(l, d) - old(l, d)) + abs(new(l, d + 1) - old(l, d + 1)) &
                             + abs(new(l, d + 2) - old(l, d + 2)))
        old(l, d) = new(l, d)
        old(l, d + 1) = new(l, d + 1)
        old(l, d + 2) = new(l, d + 2)
      end do
    end do
    change = change + lane_sum(part)
  end subroutine exchange

  !> Sum of the lanes in pairs: three dependent additions instead of seven.
  pure real(wp) function lane_sum(x)
    real(wp), intent(in) :: x(n_lanes)
    lane_sum = ((x(1) + x(5)) + (x(3) + x(7))) + ((x(2) + x(6)) + (x(4) + x(8)))
  end function lane_sum

  pure real(wp) function lane_product_sum(x, y)
    real(wp), intent(in) :: x(n_lanes), y(n_lanes)
    real(wp) :: products(n_lanes)
    products = x*y
    lane_product_sum = lane_sum(products)
  end function lane_product_sum

end module viscovib_node_kernels
