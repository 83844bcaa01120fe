!> Products of power series in time, many motions side by side, some blocks of lanes.
!!
!! Coefficient n of a product is a sum of n + 1 products. The blocks are taken together, so that
!! what a loop costs besides its arithmetic is shared, and so is reading the program of a law.
!!
!! Reading memory takes longer than the arithmetic. So an even coefficient brings what of the next
!! one is known by then,
!!
!!   c_(n+1) = a_0 b_(n+1) + [sum_(j=1)^n a_j b_(n+1-j)] + a_(n+1) b_0,
!!
!! whose factors are read anyway: it waits in the place of c_(n+1), which an odd coefficient ends.
module viscovib_wide_series
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: next_product, next_products, next_square, product_term, square_term

  !> An even number of blocks.
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
    real(wp), dimension(n_lanes) :: s1, s2
    integer :: j, p

    do p = 1, n_blocks, 2
      s1 = 0.0_wp
      s2 = 0.0_wp
      do j = 0, n
        call add_product(s1, a(1, p, j), b(1, p, n - j))
        call add_product(s2, a(1, p + 1, j), b(1, p + 1, n - j))
      end do
      call put(c, s1, term(1, p))
      call put(c, s2, term(1, p + 1))
    end do
  end subroutine product_term

  !> c sum_(j=0)^n a_j a_(n-j): each product of two different ones once.
  pure subroutine square_term(n, c, a, term)
    integer, intent(in) :: n
    real(wp), intent(in) :: c
    real(wp), intent(in) :: a(n_lanes, n_blocks, 0:n)
    real(wp), intent(out) :: term(n_lanes, n_blocks)
    real(wp), dimension(n_lanes) :: s1, s2, middle
    integer :: j, p

    middle = 0.0_wp
    do p = 1, n_blocks, 2
      s1 = 0.0_wp
      s2 = 0.0_wp
      do j = 0, (n + 1)/2 - 1
        call add_product(s1, a(1, p, j), a(1, p, n - j))
        call add_product(s2, a(1, p + 1, j), a(1, p + 1, n - j))
      end do
      if (mod(n, 2) == 0) middle = a(:, p, n/2)
      call put_square(c, s1, middle, term(1, p))
      if (mod(n, 2) == 0) middle = a(:, p + 1, n/2)
      call put_square(c, s2, middle, term(1, p + 1))
    end do
  end subroutine square_term

  !> c sum_(j=0)^n a_j b_(n-j), once for each n = 0, 1, ... in turn, all of whose factors stay as
  !! they are from then on.
  pure subroutine next_product(n, c, a, b, term)
    integer, intent(in) :: n
    real(wp), intent(in) :: c
    real(wp), intent(in) :: a(n_lanes, n_blocks, 0:n), b(n_lanes, n_blocks, 0:n)
    !> This and, if n is even, part of the next.
    real(wp), intent(inout) :: term(n_lanes, n_blocks, *)
    real(wp), dimension(n_lanes) :: s1, s2, t1, t2, before1, before2
    integer :: j, p

    if (mod(n, 2) == 1) then
      do p = 1, n_blocks
        call end_product(c, a(1, p, 0), a(1, p, n), b(1, p, 0), b(1, p, n), term(1, p, 1))
      end do
      return
    end if
    do p = 1, n_blocks, 2
      call begin_product(a(1, p, 0), b(1, p, n), s1, t1, before1)
      call begin_product(a(1, p + 1, 0), b(1, p + 1, n), s2, t2, before2)
      do j = 1, n
        call add_two(s1, t1, before1, a(1, p, j), b(1, p, n - j))
        call add_two(s2, t2, before2, a(1, p + 1, j), b(1, p + 1, n - j))
      end do
      call put(c, s1, term(1, p, 1))
      call put(c, s2, term(1, p + 1, 1))
      call keep(t1, term(1, p, 2))
      call keep(t2, term(1, p + 1, 2))
    end do
  end subroutine next_product

  !> The same of a x, by c, and of a y, by d.
  pure subroutine next_products(n, c, d, a, x, y, term, other)
    integer, intent(in) :: n
    real(wp), intent(in) :: c, d
    real(wp), intent(in), dimension(n_lanes, n_blocks, 0:n) :: a, x, y
    real(wp), intent(inout), dimension(n_lanes, n_blocks, *) :: term, other
    real(wp), dimension(n_lanes) :: s1, s2, s3, s4, t1, t2, t3, t4
    real(wp), dimension(n_lanes) :: before1, before2, before3, before4
    integer :: j, p

    if (mod(n, 2) == 1) then
      do p = 1, n_blocks
        call end_product(c, a(1, p, 0), a(1, p, n), x(1, p, 0), x(1, p, n), term(1, p, 1))
        call end_product(d, a(1, p, 0), a(1, p, n), y(1, p, 0), y(1, p, n), other(1, p, 1))
      end do
      return
    end if
    do p = 1, n_blocks, 2
      call begin_product(a(1, p, 0), x(1, p, n), s1, t1, before1)
      call begin_product(a(1, p, 0), y(1, p, n), s2, t2, before2)
      call begin_product(a(1, p + 1, 0), x(1, p + 1, n), s3, t3, before3)
      call begin_product(a(1, p + 1, 0), y(1, p + 1, n), s4, t4, before4)
      do j = 1, n
        call add_two(s1, t1, before1, a(1, p, j), x(1, p, n - j))
        call add_two(s2, t2, before2, a(1, p, j), y(1, p, n - j))
        call add_two(s3, t3, before3, a(1, p + 1, j), x(1, p + 1, n - j))
        call add_two(s4, t4, before4, a(1, p + 1, j), y(1, p + 1, n - j))
      end do
      call put(c, s1, term(1, p, 1))
      call put(d, s2, other(1, p, 1))
      call put(c, s3, term(1, p + 1, 1))
      call put(d, s4, other(1, p + 1, 1))
      call keep(t1, term(1, p, 2))
      call keep(t2, other(1, p, 2))
      call keep(t3, term(1, p + 1, 2))
      call keep(t4, other(1, p + 1, 2))
    end do
  end subroutine next_products

  !> The same of a square.
  pure subroutine next_square(n, c, a, term)
    integer, intent(in) :: n
    real(wp), intent(in) :: c
    real(wp), intent(in) :: a(n_lanes, n_blocks, 0:n)
    real(wp), intent(inout) :: term(n_lanes, n_blocks, *)
    real(wp), dimension(n_lanes) :: s1, s2, t1, t2, before1, before2
    integer :: j, p

    if (mod(n, 2) == 1) then
      do p = 1, n_blocks
        call end_square(c, a(1, p, 0), a(1, p, n), term(1, p, 1))
      end do
      return
    end if
    do p = 1, n_blocks, 2
      call begin_square(a(1, p, 0), s1, t1, before1)
      call begin_square(a(1, p + 1, 0), s2, t2, before2)
      do j = 1, n/2
        call add_two_before(s1, t1, before1, a(1, p, j), a(1, p, n + 1 - j))
        call add_two_before(s2, t2, before2, a(1, p + 1, j), a(1, p + 1, n + 1 - j))
      end do
      call put_square(c, s1, before1, term(1, p, 1))
      call put_square(c, s2, before2, term(1, p + 1, 1))
      call keep(t1, term(1, p, 2))
      call keep(t2, term(1, p + 1, 2))
    end do
  end subroutine next_square

  !> The first product of an even coefficient; nothing yet of the next.
  pure subroutine begin_product(x, y, total, next, before)
    real(wp), intent(in), dimension(n_lanes) :: x, y
    real(wp), intent(out), dimension(n_lanes) :: total, next, before
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = x(l)*y(l)
      next(l) = 0.0_wp
      before(l) = y(l)
    end do
  end subroutine begin_product

  !> x y, and x times the y before, which is of the next coefficient.
  pure subroutine add_two(total, next, before, x, y)
    real(wp), intent(inout), dimension(n_lanes) :: total, next, before
    real(wp), intent(in), dimension(n_lanes) :: x, y
    real(wp) :: first, second
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      first = x(l)
      second = y(l)
      next(l) = next(l) + first*before(l)
      total(l) = total(l) + first*second
      before(l) = second
    end do
  end subroutine add_two

  !> No product of an even coefficient of a square yet.
  pure subroutine begin_square(x, total, next, before)
    real(wp), intent(in) :: x(n_lanes)
    real(wp), intent(out), dimension(n_lanes) :: total, next, before
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = 0.0_wp
      next(l) = 0.0_wp
      before(l) = x(l)
    end do
  end subroutine begin_square

  !> The x before times y, and x y, which is of the next coefficient.
  pure subroutine add_two_before(total, next, before, x, y)
    real(wp), intent(inout), dimension(n_lanes) :: total, next, before
    real(wp), intent(in), dimension(n_lanes) :: x, y
    real(wp) :: first, second
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      first = x(l)
      second = y(l)
      total(l) = total(l) + before(l)*second
      next(l) = next(l) + first*second
      before(l) = first
    end do
  end subroutine add_two_before

  !> An odd coefficient of a product: what of it is known, and its first and last product.
  pure subroutine end_product(c, a_0, a_n, b_0, b_n, term)
    real(wp), intent(in) :: c
    real(wp), intent(in), dimension(n_lanes) :: a_0, a_n, b_0, b_n
    real(wp), intent(inout) :: term(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      term(l) = min(max(c*(term(l) + a_0(l)*b_n(l) + a_n(l)*b_0(l)), -largest), largest)
    end do
  end subroutine end_product

  !> The same of a square.
  pure subroutine end_square(c, a_0, a_n, term)
    real(wp), intent(in) :: c
    real(wp), intent(in), dimension(n_lanes) :: a_0, a_n
    real(wp), intent(inout) :: term(n_lanes)
    real(wp) :: twice
    integer :: l
    twice = 2.0_wp*c
    !GCC$ unroll 1
    do l = 1, n_lanes
      term(l) = min(max(twice*(term(l) + a_0(l)*a_n(l)), -largest), largest)
    end do
  end subroutine end_square

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

  !> c (2 x + y^2), no larger than a wall.
  pure subroutine put_square(c, x, y, term)
    real(wp), intent(in) :: c, x(n_lanes), y(n_lanes)
    real(wp), intent(out) :: term(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      term(l) = min(max(c*(2.0_wp*x(l) + y(l)*y(l)), -largest), largest)
    end do
  end subroutine put_square

  pure subroutine keep(x, y)
    real(wp), intent(in) :: x(n_lanes)
    real(wp), intent(out) :: y(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      y(l) = x(l)
    end do
  end subroutine keep

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
