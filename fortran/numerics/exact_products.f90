! Optimize: -O3 -ffp-contract=off
!> Sums of products with the accuracy of twice the working precision.
!!
!! Ogita, Rump, Oishi, Accurate sum and dot product, SIAM J. Sci. Comput. 26 (2005) 1955 (Dot2).
!! Each operation must be rounded: fused ones (-ffp-contract) leave errors of 2^-79.
module viscovib_exact_products
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_products, exact_dot, exact_product

  !> 2^27 + 1 separates the halves of a number (Dekker).
  real(wp), parameter :: splitter = 134217729.0_wp

contains

  !> sum_i x_i y_i.
  pure real(wp) function exact_dot(x, y) result(total)
    real(wp), intent(in) :: x(:), y(:)
    real(wp) :: sums(1), rests(1)
    integer :: i

    sums = 0.0_wp
    rests = 0.0_wp
    do i = 1, size(x)
      call add_products(x(i:i), y(i), sums, rests)
    end do
    total = sums(1) + rests(1)
  end function exact_dot

  !> sums + rests + y x, where rests has the rounding errors of sums.
  pure subroutine add_products(x, y, sums, rests)
    real(wp), intent(in) :: x(:), y
    real(wp), intent(inout) :: sums(:), rests(:)
    real(wp) :: product, error, new, part
    integer :: i

    do i = 1, size(x)
      call exact_product(x(i), y, product, error)
      new = sums(i) + product
      part = new - sums(i)
      rests(i) = rests(i) + (((sums(i) - (new - part)) + (product - part)) + error)
      sums(i) = new
    end do
  end subroutine add_products

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

end module viscovib_exact_products
