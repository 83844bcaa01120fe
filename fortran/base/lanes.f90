! Optimize: -O3
!> Several problems of the same shape in parallel, one per lane of the vector unit.
!!
!! The lane is the first index of arrays. All lanes do the same operations independently of each
!! other, so a result does not depend on the other problems in its block.
module viscovib_lanes
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_multiple, add_two, lane_product, multiply_lanes, new_lane_table, turn

  !> Lanes in a block: one register of 8 doubles if available, otherwise two of 4 or four of 2.
  integer, parameter, public :: n_lanes = 8
  !> Largest number of coordinates for vectorized time integration. They are processed three at a
  !! time, so that their sums stay in registers.
  integer, parameter, public :: max_dof = 6
  !> Largest number of coordinates for computing all derivatives at once.
  integer, parameter, public :: most_sloped = 2

  !> A matrix by which lanes are multiplied, with the first and last row that is not 0 of every four
  !! columns.
  type, public :: lane_table
    real(wp), allocatable :: values(:, :)
    integer, allocatable, private :: rows(:, :)
  contains
    procedure :: multiply
    procedure :: row
  end type lane_table

contains

  !> b(:,j) = sum_i a(:,i) table(i,j). Four columns at a time, so that each
  !! a(:,i) is loaded once for four sums that stay in registers.
  pure subroutine lane_product(n_in, n_out, a, table, b, rows)
    integer, intent(in) :: n_in, n_out
    real(wp), intent(in) :: a(n_lanes, n_in), table(n_in, n_out)
    real(wp), intent(out) :: b(n_lanes, n_out)
    !> First and last row that is not 0 of every four columns.
    integer, intent(in), optional :: rows(2, (n_out + 3)/4)
    real(wp) :: s1(n_lanes), s2(n_lanes), s3(n_lanes), s4(n_lanes)
    integer :: i, j, l, reach(2)

    reach = [1, n_in]
    do j = 1, n_out - 3, 4
      if (present(rows)) reach = rows(:, (j + 3)/4)
      s1 = 0.0_wp
      s2 = 0.0_wp
      s3 = 0.0_wp
      s4 = 0.0_wp
      do i = reach(1), reach(2)
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
    if (present(rows)) reach = rows(:, (n_out + 3)/4)
    do j = n_out - mod(n_out, 4) + 1, n_out
      s1 = 0.0_wp
      do i = reach(1), reach(2)
        do l = 1, n_lanes
          s1(l) = s1(l) + a(l, i)*table(i, j)
        end do
      end do
      b(:, j) = s1
    end do
  end subroutine lane_product

  pure subroutine new_lane_table(table, values)
    type(lane_table), intent(out) :: table
    real(wp), intent(in) :: values(:, :)
    integer :: i, j

    table%values = values
    allocate (table%rows(2, (size(values, 2) + 3)/4))
    table%rows(1, :) = size(values, 1) + 1
    table%rows(2, :) = 0
    do j = 1, size(values, 2)
      do i = 1, size(values, 1)
        if (.not. abs(values(i, j)) > 0.0_wp) cycle
        associate (rows => table%rows(:, (j + 3)/4))
          rows = [min(rows(1), i), max(rows(2), i)]
        end associate
      end do
    end do
  end subroutine new_lane_table

  !> b(:,j) = sum_i a(:,i) values(i,j).
  pure subroutine multiply(self, a, b)
    class(lane_table), intent(in) :: self
    real(wp), intent(in) :: a(n_lanes, size(self%values, 1))
    real(wp), intent(out) :: b(n_lanes, size(self%values, 2))
    call lane_product(size(a, 2), size(b, 2), a, self%values, b, self%rows)
  end subroutine multiply

  !> The same for a single lane.
  pure function row(self, a) result(b)
    class(lane_table), intent(in) :: self
    real(wp), intent(in) :: a(:)
    real(wp) :: b(size(self%values, 2))
    integer :: j

    do j = 1, size(b)
      associate (i => self%rows(1, (j + 3)/4), k => self%rows(2, (j + 3)/4))
        b(j) = sum(a(i:k)*self%values(i:k, j))
      end associate
    end do
  end function row

  !> total + c x. For this and the following loops: gfortran 12 vectorizes a loop over lanes fully
  !! only if it is not unrolled before.
  pure subroutine add_multiple(total, c, x)
    real(wp), intent(inout) :: total(n_lanes)
    real(wp), intent(in) :: c, x(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = total(l) + c*x(l)
    end do
  end subroutine add_multiple

  !> total + (c x + d y).
  pure subroutine add_two(total, c, x, d, y)
    real(wp), intent(inout) :: total(n_lanes)
    real(wp), intent(in) :: c, x(n_lanes), d, y(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = total(l) + (c*x(l) + d*y(l))
    end do
  end subroutine add_two

  !> product x^power.
  pure subroutine multiply_lanes(product, x, power)
    real(wp), intent(inout) :: product(n_lanes)
    real(wp), intent(in) :: x(n_lanes)
    integer, intent(in) :: power
    integer :: k, l
    do k = 1, power
      !GCC$ unroll 1
      do l = 1, n_lanes
        product(l) = product(l)*x(l)
      end do
    end do
  end subroutine multiply_lanes

  !> Rotate cos and sin of an angle by another angle, given by its cos and sin.
  pure subroutine turn(c, s, by)
    real(wp), intent(inout) :: c(n_lanes), s(n_lanes)
    real(wp), intent(in) :: by(n_lanes, 2)
    real(wp) :: before
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      before = c(l)
      c(l) = before*by(l, 1) - s(l)*by(l, 2)
      s(l) = s(l)*by(l, 1) + before*by(l, 2)
    end do
  end subroutine turn

end module viscovib_lanes
