!> The loops of a collocation step that run along the lanes.
!!
!! gfortran 12 unrolls a loop of 8 turns before it looks for vectors, and then
!! finds none in some of these; `unroll 1` keeps the loop for the vectoriser
!! (four to ten times as fast). In a module of their own they also stay clear of
!! the iteration that calls them.
module viscovib_node_kernels
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: node_states, exchange

  !> Coordinates there is room for: as many as `lane_product` takes at once.
  integer, parameter, public :: max_dof = 4
  !> Counts velocities beyond 1e45 as having run away.
  real(wp), parameter :: speed_weight = 1.0e-40_wp

contains

  !> States at the nodes from the sums over accelerations, in place; `reach` is
  !! larger than any coordinate, and huge where a velocity is absurd.
  pure subroutine node_states(h, nodes, q_0, v_0, q, v, reach)
    real(wp), intent(in) :: h, nodes(n_lanes), q_0(max_dof), v_0(max_dof)
    real(wp), intent(inout) :: q(n_lanes, max_dof), v(n_lanes, max_dof)
    real(wp), intent(out) :: reach
    real(wp) :: far(n_lanes)
    integer :: d, l

    far = 0.0_wp
    do d = 1, max_dof
      !GCC$ unroll 1
      do l = 1, n_lanes
        q(l, d) = q_0(d) + h*(nodes(l)*v_0(d) + h*q(l, d))
        v(l, d) = v_0(d) + h*v(l, d)
        far(l) = far(l) + abs(q(l, d)) + abs(v(l, d))*speed_weight
      end do
    end do
    reach = sum(far)
  end subroutine node_states

  !> Put new accelerations in the place of old ones, and add up the sizes of
  !! changes and values (sums, since maxima would keep the loop scalar).
  pure subroutine exchange(new, old, change, total)
    real(wp), intent(in) :: new(n_lanes, max_dof)
    real(wp), intent(inout) :: old(n_lanes, max_dof), change, total
    real(wp) :: lane_change(n_lanes), lane_total(n_lanes)
    integer :: d, l

    lane_change = 0.0_wp
    lane_total = 0.0_wp
    do d = 1, max_dof
      !GCC$ unroll 1
      do l = 1, n_lanes
        lane_change(l) = lane_change(l) + abs(new(l, d) - old(l, d))
        lane_total(l) = lane_total(l) + abs(new(l, d))
        old(l, d) = new(l, d)
      end do
    end do
    change = change + sum(lane_change)
    total = total + sum(lane_total)
  end subroutine exchange

end module viscovib_node_kernels
