!> Dot products with the accuracy of twice the working precision.
!!
!! Ogita, Rump, Oishi, Accurate sum and dot product, SIAM J. Sci. Comput. 26
!! (2005) 1955 (Dot2).
module viscovib_exact_sum
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: exact_dot

  real(wp), parameter :: splitter = 134217729.0_wp

contains

  !> sum_i x_i y_i.
  pure real(wp) function exact_dot(x, y) result(total)
    real(wp), intent(in) :: x(:), y(:)
    real(wp) :: product, error, new, part, rest
    integer :: i
    total = 0.0_wp
    rest = 0.0_wp
    do i = 1, size(x)
      call exact_product(x(i), y(i), product, error)
      new = total + product
      part = new - total
      rest = rest + (((total - (new - part)) + (product - part)) + error)
      total = new
    end do
    total = total + rest
  end function exact_dot

  !> x y = product + error, exactly (Dekker).
  pure subroutine exact_product(x, y, product, error)
    real(wp), intent(in) :: x, y
    real(wp), intent(out) :: product, error
    real(wp) :: x_1, x_2, y_1, y_2
    product = x*y
    x_1 = splitter*x
    x_1 = x_1 - (x_1 - x)
    x_2 = x - x_1
    y_1 = splitter*y
    y_1 = y_1 - (y_1 - y)
    y_2 = y - y_1
    error = ((x_1*y_1 - product) + x_1*y_2 + x_2*y_1) + x_2*y_2
  end subroutine exact_product

end module viscovib_exact_sum
