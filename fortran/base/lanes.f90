!> Several problems of one shape side by side, one a lane of the vector unit.
!!
!! Arrays carry the lane as their first index. Every lane does the same
!! arithmetic whatever its neighbours hold, so a result does not depend on
!! which problems travel together.
module viscovib_lanes
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: lane_product

  !> Lanes in a block: one register of 8 doubles where there are such, two of
  !! 4 or four of 2 elsewhere.
  integer, parameter, public :: n_lanes = 8
  !> Coordinates there is room for in time integration; they are taken three at
  !! a time, so that their sums stay in registers.
  integer, parameter, public :: max_dof = 6

contains

  !> b(:,j) = sum_i a(:,i) table(i,j). Four columns at a time, so that each
  !! a(:,i) is loaded once for four sums that stay in registers.
  pure subroutine lane_product(n_in, n_out, a, table, b)
    integer, intent(in) :: n_in, n_out
    real(wp), intent(in) :: a(n_lanes, n_in), table(n_in, n_out)
    real(wp), intent(out) :: b(n_lanes, n_out)
    real(wp) :: s1(n_lanes), s2(n_lanes), s3(n_lanes), s4(n_lanes)
    integer :: i, j, l

    do j = 1, n_out - 3, 4
      s1 = 0.0_wp
      s2 = 0.0_wp
      s3 = 0.0_wp
      s4 = 0.0_wp
      do i = 1, n_in
        do l = 1, n_lanes
          s1(l) = s1(l) + a(l, i)*table(i, j)
          s2(l) = s2(l) + a(l, i)*table(i, j + 1)
          s3(l) = s3(l) + a(l, i)*table(i, j + 2)
          s4(l) = s4(l) + a(l, i)*table(i, j + 3)
        end do
      end do
      b(:, j) = s1
      b(:, j + 1) = s2
      b(:, j + 2) = s3
      b(:, j + 3) = s4
    end do
    do j = n_out - mod(n_out, 4) + 1, n_out
      s1 = 0.0_wp
      do i = 1, n_in
        do l = 1, n_lanes
          s1(l) = s1(l) + a(l, i)*table(i, j)
        end do
      end do
      b(:, j) = s1
    end do
  end subroutine lane_product

end module viscovib_lanes
