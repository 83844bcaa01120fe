! Optimize: -O3
!> The sums of explicit Runge-Kutta stages, with trajectories in the
!! lanes. `viscovib_node_kernels` explains the form of the loops.
module viscovib_stage_kernels
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof, n_lanes
  implicit none
  private

  public :: stage_sums, stage_states, end_of_step, turn_drives

contains

  !> Sums over accelerations with the weights of q and of v.
  pure subroutine stage_sums(n_dof, n_terms, from, weights, f, in_q, in_v)
    integer, intent(in) :: n_dof, n_terms, from(n_terms)
    real(wp), intent(in) :: weights(2, n_terms)
    !> Lane, coordinate, stage.
    real(wp), intent(in) :: f(n_lanes, max_dof, *)
    real(wp), intent(out) :: in_q(n_lanes, max_dof), in_v(n_lanes, max_dof)
    real(wp), dimension(n_lanes) :: q_1, q_2, q_3, v_1, v_2, v_3
    integer :: d, i

    do d = 1, n_dof, 3
      q_1 = 0.0_wp
      q_2 = 0.0_wp
      q_3 = 0.0_wp
      v_1 = 0.0_wp
      v_2 = 0.0_wp
      v_3 = 0.0_wp
      !GCC$ novector
      do i = 1, n_terms
        q_1 = q_1 + weights(1, i)*f(:, d, from(i))
        v_1 = v_1 + weights(2, i)*f(:, d, from(i))
        q_2 = q_2 + weights(1, i)*f(:, d + 1, from(i))
        v_2 = v_2 + weights(2, i)*f(:, d + 1, from(i))
        q_3 = q_3 + weights(1, i)*f(:, d + 2, from(i))
        v_3 = v_3 + weights(2, i)*f(:, d + 2, from(i))
      end do
      in_q(:, d) = q_1
      in_q(:, d + 1) = q_2
      in_q(:, d + 2) = q_3
      in_v(:, d) = v_1
      in_v(:, d + 1) = v_2
      in_v(:, d + 2) = v_3
    end do
  end subroutine stage_sums

  !> q_0 + h (c v_0 + h in_q) and v_0 + h in_v.
  pure subroutine stage_states(n_dof, c, h, q_0, v_0, in_q, in_v, q, v)
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: c, h(n_lanes)
    real(wp), dimension(n_lanes, max_dof), intent(in) :: q_0, v_0, in_q, in_v
    real(wp), dimension(n_lanes, max_dof), intent(out) :: q, v
    integer :: d, l

    do d = 1, n_dof
      !GCC$ unroll 1
      do l = 1, n_lanes
        q(l, d) = q_0(l, d) + h(l)*(c*v_0(l, d) + h(l)*in_q(l, d))
        v(l, d) = v_0(l, d) + h(l)*in_v(l, d)
      end do
    end do
  end subroutine stage_states

  !> The step itself, in compensated summation: the rounding error of the
  !! state is stored in `q_rest` and `v_rest` for the next step.
  pure subroutine end_of_step(n_dof, h, in_q, in_v, q, v, q_rest, v_rest)
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: h(n_lanes)
    real(wp), dimension(n_lanes, max_dof), intent(in) :: in_q, in_v
    real(wp), dimension(n_lanes, max_dof), intent(inout) :: q, v, q_rest, v_rest
    real(wp) :: change_q, change_v, new
    integer :: d, l

    do d = 1, n_dof
      !GCC$ unroll 1
      do l = 1, n_lanes
        change_q = h(l)*(v(l, d) + h(l)*in_q(l, d)) + q_rest(l, d)
        new = q(l, d) + change_q
        q_rest(l, d) = change_q - (new - q(l, d))
        q(l, d) = new
        change_v = h(l)*in_v(l, d) + v_rest(l, d)
        new = v(l, d) + change_v
        v_rest(l, d) = change_v - (new - v(l, d))
        v(l, d) = new
      end do
    end do
  end subroutine end_of_step

  !> cos of the sum of two angles.
  pure subroutine turn_drives(n, cos_1, sin_1, cos_2, sin_2, drive)
    integer, intent(in) :: n
    real(wp), dimension(n_lanes, n), intent(in) :: cos_1, sin_1, cos_2, sin_2
    real(wp), intent(out) :: drive(n_lanes, n)
    integer :: j, l
    do j = 1, n
      !GCC$ unroll 1
      do l = 1, n_lanes
        drive(l, j) = cos_1(l, j)*cos_2(l, j) - sin_1(l, j)*sin_2(l, j)
      end do
    end do
  end subroutine turn_drives

end module viscovib_stage_kernels
