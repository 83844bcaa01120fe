!> Gauss-Legendre collocation with trajectories in the lanes: procedures for its fixed-point
!! iteration.
!!
!!   f_i = a(q_0 + c_i h v_0 + h^2 sum_j a2_ij f_j, v_0 + h sum_j a_ij f_j)
!! is solved node by node, each with the newest accelerations of the other nodes (Gauss and Seidel).
!! A converged lane is not changed, so that its numbers do not depend on its neighbours.
module viscovib_lane_collocation
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof, n_lanes
  implicit none
  private

  public :: exchange_lanes, check_sweep, start_lanes

  !> Sweeps over all nodes before a step counts as too large.
  integer, parameter, public :: max_sweeps = 40
  !> Relative change of accelerations at convergence: only rounding still changes them.
  real(wp), parameter :: solved = 4.0e-15_wp
  !> Changes below this are those of numbers near underflow.
  real(wp), parameter :: negligible = 1.0e-300_wp
  !> Relative change of the state that a step does not resolve.
  real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp)
  !> States of a lane: iterating, converged, diverged.
  real(wp), parameter, public :: at_work = 1.0_wp, is_solved = 0.0_wp, ran_away = -1.0_wp

contains

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

end module viscovib_lane_collocation
