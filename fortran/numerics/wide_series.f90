!> Products of power series in time, many motions side by side: four blocks of lanes.
!!
!! Coefficient n of a product is a sum of n + 1 products. The blocks are taken together, so that
!! what a loop costs besides its arithmetic is shared, and so is reading the program of a law.
module viscovib_wide_series
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: product_term, product_terms, square_term

  integer, parameter, public :: n_blocks = 4, n_wide = n_blocks*n_lanes
  !> Coefficients beyond it are held there.
  real(wp), parameter, public :: largest = 1.0e60_wp

contains

  !> c sum_(j=0)^n a_j b_(n-j) in every lane; what runs away stays a number.
  pure subroutine product_term(n, c, a, b, term)
    integer, intent(in) :: n
    real(wp), intent(in) :: c
    real(wp), intent(in) :: a(n_lanes, n_blocks, 0:n), b(n_lanes, n_blocks, 0:n)
    real(wp), intent(out) :: term(n_lanes, n_blocks)
    real(wp), dimension(n_lanes) :: s1, s2, s3, s4
    integer :: j

    s1 = 0.0_wp
    s2 = 0.0_wp
    s3 = 0.0_wp
    s4 = 0.0_wp
    do j = 0, n
      call add_product(s1, a(1, 1, j), b(1, 1, n - j))
      call add_product(s2, a(1, 2, j), b(1, 2, n - j))
      call add_product(s3, a(1, 3, j), b(1, 3, n - j))
      call add_product(s4, a(1, 4, j), b(1, 4, n - j))
    end do
    call put(c, s1, term(1, 1))
    call put(c, s2, term(1, 2))
    call put(c, s3, term(1, 3))
    call put(c, s4, term(1, 4))
  end subroutine product_term

  !> The same of a x, by c, and of a y, by d.
  pure subroutine product_terms(n, c, d, a, x, y, term, other)
    integer, intent(in) :: n
    real(wp), intent(in) :: c, d
    real(wp), intent(in), dimension(n_lanes, n_blocks, 0:n) :: a, x, y
    real(wp), intent(out), dimension(n_lanes, n_blocks) :: term, other
    real(wp), dimension(n_lanes) :: s1, s2, s3, s4, t1, t2, t3, t4
    integer :: j

    s1 = 0.0_wp
    s2 = 0.0_wp
    s3 = 0.0_wp
    s4 = 0.0_wp
    t1 = 0.0_wp
    t2 = 0.0_wp
    t3 = 0.0_wp
    t4 = 0.0_wp
    do j = 0, n
      call add_product(s1, a(1, 1, j), x(1, 1, n - j))
      call add_product(t1, a(1, 1, j), y(1, 1, n - j))
      call add_product(s2, a(1, 2, j), x(1, 2, n - j))
      call add_product(t2, a(1, 2, j), y(1, 2, n - j))
      call add_product(s3, a(1, 3, j), x(1, 3, n - j))
      call add_product(t3, a(1, 3, j), y(1, 3, n - j))
      call add_product(s4, a(1, 4, j), x(1, 4, n - j))
      call add_product(t4, a(1, 4, j), y(1, 4, n - j))
    end do
    call put(c, s1, term(1, 1))
    call put(c, s2, term(1, 2))
    call put(c, s3, term(1, 3))
    call put(c, s4, term(1, 4))
    call put(d, t1, other(1, 1))
    call put(d, t2, other(1, 2))
    call put(d, t3, other(1, 3))
    call put(d, t4, other(1, 4))
  end subroutine product_terms

  !> c sum_(j=0)^n a_j a_(n-j): each product of two different ones once.
  pure subroutine square_term(n, c, a, term)
    integer, intent(in) :: n
    real(wp), intent(in) :: c
    real(wp), intent(in) :: a(n_lanes, n_blocks, 0:n)
    real(wp), intent(out) :: term(n_lanes, n_blocks)
    real(wp), dimension(n_lanes) :: s1, s2, s3, s4
    real(wp) :: middle(n_lanes, n_blocks)
    integer :: j

    s1 = 0.0_wp
    s2 = 0.0_wp
    s3 = 0.0_wp
    s4 = 0.0_wp
    do j = 0, (n + 1)/2 - 1
      call add_product(s1, a(1, 1, j), a(1, 1, n - j))
      call add_product(s2, a(1, 2, j), a(1, 2, n - j))
      call add_product(s3, a(1, 3, j), a(1, 3, n - j))
      call add_product(s4, a(1, 4, j), a(1, 4, n - j))
    end do
    middle = 0.0_wp
    if (mod(n, 2) == 0) middle = a(:, :, n/2)**2
    call put(c, 2.0_wp*s1 + middle(:, 1), term(1, 1))
    call put(c, 2.0_wp*s2 + middle(:, 2), term(1, 2))
    call put(c, 2.0_wp*s3 + middle(:, 3), term(1, 3))
    call put(c, 2.0_wp*s4 + middle(:, 4), term(1, 4))
  end subroutine square_term

  !> c x, no larger than a wall.
  pure subroutine put(c, x, term)
    real(wp), intent(in) :: c, x(n_lanes)
    real(wp), intent(out) :: term(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      term(l) = min(max(c*x(l), -largest), largest)
    end do
  end subroutine put

  !> total + x y. Not unrolled, so that gfortran 12 makes whole registers of it.
  pure subroutine add_product(total, x, y)
    real(wp), intent(inout) :: total(n_lanes)
    real(wp), intent(in) :: x(n_lanes), y(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = total(l) + x(l)*y(l)
    end do
  end subroutine add_product

end module viscovib_wide_series
