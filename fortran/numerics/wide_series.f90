! Optimize: -O3
!> Products of power series in time, for many motions in some blocks of lanes.
!!
!! Coefficient n of a product is a sum of n + 1 products. The blocks are processed together, so that
!! they share the overhead of loops and of interpreting the program of a law.
!!
!! Reading memory takes longer than the arithmetic. Therefore an even coefficient also computes the
!! known part of the next one,
!!
!!   c_(n+1) = a_0 b_(n+1) + [sum_(j=1)^n a_j b_(n+1-j)] + a_(n+1) b_0,
!!
!! whose factors are read anyway. It is stored in the position of c_(n+1), and an odd coefficient
!! completes it. Operands of two products are read one iteration ahead, since gfortran 12 would
!! read them for each. Loops with at least one iteration have the exit at their end, since
!! gfortran 12 would otherwise keep all sums in memory before and after them.
module viscovib_wide_series
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: next_product, next_products, next_square, product_term, square_term

  !> Number of blocks, a multiple of four.
  integer, parameter, public :: n_blocks = 4, n_wide = n_blocks*n_lanes
  !> Bound of coefficients; larger ones are clipped.
  real(wp), parameter, public :: largest = 1.0e60_wp

contains

  !> c sum_(j=0)^n a_j b_(n-j) in every lane; diverging values are clipped.
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

  !> c sum_(j=0)^n a_j a_(n-j), with each product of different factors computed once.
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

  !> c sum_(j=0)^n a_j b_(n-j), to be called for n = 0, 1, ... in turn; the factors must not change
  !! afterwards.
  pure subroutine next_product(n, c, a, b, term)
    integer, intent(in) :: n
    real(wp), intent(in) :: c
    real(wp), intent(in) :: a(n_lanes, n_blocks, 0:n), b(n_lanes, n_blocks, 0:n)
    !> This coefficient and, if n is even, part of the next.
    real(wp), intent(inout) :: term(n_lanes, n_blocks, *)
    real(wp), dimension(n_lanes) :: s1, s2, t1, t2, before1, before2, x1, x2
    integer :: j, p

    if (mod(n, 2) == 1) then
      do p = 1, n_blocks
        call end_product(c, a(1, p, 0), a(1, p, n), b(1, p, 0), b(1, p, n), term(1, p, 1))
      end do
    else if (n == 0) then
      do p = 1, n_blocks
        call first_product(c, a(1, p, 0), b(1, p, 0), term(1, p, 1), term(1, p, 2))
      end do
    else
      do p = 1, n_blocks, 2
        call begin_product(a(1, p, 0), b(1, p, n), a(1, p, 1), s1, t1, before1, x1)
        call begin_product(a(1, p + 1, 0), b(1, p + 1, n), a(1, p + 1, 1), s2, t2, before2, x2)
        j = 1
        do
          call add_two(s1, t1, before1, x1, b(1, p, n - j), a(1, p, j + 1))
          call add_two(s2, t2, before2, x2, b(1, p + 1, n - j), a(1, p + 1, j + 1))
          j = j + 1
          if (j == n) exit
        end do
        call put_two(c, s1, t1, before1, x1, b(1, p, 0), term(1, p, 1), term(1, p, 2))
        call put_two(c, s2, t2, before2, x2, b(1, p + 1, 0), term(1, p + 1, 1), term(1, p + 1, 2))
      end do
    end if
  end subroutine next_product

  !> The same for the products a x, times c, and a y, times d.
  pure subroutine next_products(n, c, d, a, x, y, term, other)
    integer, intent(in) :: n
    real(wp), intent(in) :: c, d
    real(wp), intent(in), dimension(n_lanes, n_blocks, 0:n) :: a, x, y
    real(wp), intent(inout), dimension(n_lanes, n_blocks, *) :: term, other
    real(wp), dimension(n_lanes) :: s1, s2, s3, s4, t1, t2, t3, t4, x1, x2
    real(wp), dimension(n_lanes) :: before1, before2, before3, before4
    integer :: j, p, q

    if (mod(n, 2) == 1) then
      do p = 1, n_blocks
        call end_product(c, a(1, p, 0), a(1, p, n), x(1, p, 0), x(1, p, n), term(1, p, 1))
        call end_product(d, a(1, p, 0), a(1, p, n), y(1, p, 0), y(1, p, n), other(1, p, 1))
      end do
    else if (n == 0) then
      do p = 1, n_blocks
        call first_product(c, a(1, p, 0), x(1, p, 0), term(1, p, 1), term(1, p, 2))
        call first_product(d, a(1, p, 0), y(1, p, 0), other(1, p, 1), other(1, p, 2))
      end do
    else
      do p = 1, n_blocks, 2
        q = p + 1
        call begin_product(a(1, p, 0), x(1, p, n), a(1, p, 1), s1, t1, before1, x1)
        call begin_product(a(1, p, 0), y(1, p, n), a(1, p, 1), s2, t2, before2, x1)
        call begin_product(a(1, q, 0), x(1, q, n), a(1, q, 1), s3, t3, before3, x2)
        call begin_product(a(1, q, 0), y(1, q, n), a(1, q, 1), s4, t4, before4, x2)
        j = 1
        do
          call add_four(s1, t1, before1, s2, t2, before2, x1, x(1, p, n - j), y(1, p, n - j), &
                        a(1, p, j + 1))
          call add_four(s3, t3, before3, s4, t4, before4, x2, x(1, q, n - j), y(1, q, n - j), &
                        a(1, q, j + 1))
          j = j + 1
          if (j == n) exit
        end do
        call put_two(c, s1, t1, before1, x1, x(1, p, 0), term(1, p, 1), term(1, p, 2))
        call put_two(d, s2, t2, before2, x1, y(1, p, 0), other(1, p, 1), other(1, p, 2))
        call put_two(c, s3, t3, before3, x2, x(1, q, 0), term(1, q, 1), term(1, q, 2))
        call put_two(d, s4, t4, before4, x2, y(1, q, 0), other(1, q, 1), other(1, q, 2))
      end do
    end if
  end subroutine next_products

  !> The same for a square.
  pure subroutine next_square(n, c, a, term)
    integer, intent(in) :: n
    real(wp), intent(in) :: c
    real(wp), intent(in) :: a(n_lanes, n_blocks, 0:n)
    real(wp), intent(inout) :: term(n_lanes, n_blocks, *)
    real(wp), dimension(n_lanes) :: s1, s2, t1, t2, before1, before2, y1, y2
    integer :: j, p

    if (mod(n, 2) == 1) then
      do p = 1, n_blocks
        call end_square(c, a(1, p, 0), a(1, p, n), term(1, p, 1))
      end do
    else if (n == 0) then
      do p = 1, n_blocks
        call first_product(c, a(1, p, 0), a(1, p, 0), term(1, p, 1), term(1, p, 2))
      end do
    else
      do p = 1, n_blocks, 2
        call begin_square(a(1, p, 0), a(1, p, n), s1, t1, before1, y1)
        call begin_square(a(1, p + 1, 0), a(1, p + 1, n), s2, t2, before2, y2)
        j = 1
        do
          call add_two_before(s1, t1, before1, y1, a(1, p, j), a(1, p, n - j))
          call add_two_before(s2, t2, before2, y2, a(1, p + 1, j), a(1, p + 1, n - j))
          j = j + 1
          if (j > n/2) exit
        end do
        call put_square(c, s1, before1, term(1, p, 1))
        call put_square(c, s2, before2, term(1, p + 1, 1))
        call keep(t1, term(1, p, 2))
        call keep(t2, term(1, p + 1, 2))
      end do
    end if
  end subroutine next_square

  !> The coefficient of order 0, without part of the next.
  pure subroutine first_product(c, x, y, term, next)
    real(wp), intent(in) :: c
    real(wp), intent(in), dimension(n_lanes) :: x, y
    real(wp), intent(out), dimension(n_lanes) :: term, next
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      term(l) = min(max(c*(x(l)*y(l)), -largest), largest)
      next(l) = 0.0_wp
    end do
  end subroutine first_product

  !> First product of an even coefficient; 0 for the next; load the x that follows.
  pure subroutine begin_product(x, y, following, total, next, before, ahead)
    real(wp), intent(in), dimension(n_lanes) :: x, y, following
    real(wp), intent(out), dimension(n_lanes) :: total, next, before, ahead
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = x(l)*y(l)
      next(l) = 0.0_wp
      before(l) = y(l)
      ahead(l) = following(l)
    end do
  end subroutine begin_product

  !> Add x y, and x times the previous y to the next coefficient; load the x that follows.
  pure subroutine add_two(total, next, before, x, y, following)
    real(wp), intent(inout), dimension(n_lanes) :: total, next, before, x
    real(wp), intent(in), dimension(n_lanes) :: y, following
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      next(l) = next(l) + x(l)*before(l)
      before(l) = y(l)
      total(l) = total(l) + x(l)*before(l)
      x(l) = following(l)
    end do
  end subroutine add_two

  !> The same for two products with factors y and z.
  pure subroutine add_four(total, next, before, other, other_next, other_before, x, y, z, following)
    real(wp), intent(inout), dimension(n_lanes) :: total, next, before, x
    real(wp), intent(inout), dimension(n_lanes) :: other, other_next, other_before
    real(wp), intent(in), dimension(n_lanes) :: y, z, following
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      next(l) = next(l) + x(l)*before(l)
      other_next(l) = other_next(l) + x(l)*other_before(l)
      before(l) = y(l)
      other_before(l) = z(l)
      total(l) = total(l) + x(l)*before(l)
      other(l) = other(l) + x(l)*other_before(l)
      x(l) = following(l)
    end do
  end subroutine add_four

  !> Add the last products of `add_two`, and store both coefficients.
  pure subroutine put_two(c, total, next, before, x, y, term, next_term)
    real(wp), intent(in) :: c
    real(wp), intent(in), dimension(n_lanes) :: total, next, before, x, y
    real(wp), intent(out), dimension(n_lanes) :: term, next_term
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      term(l) = min(max(c*(total(l) + x(l)*y(l)), -largest), largest)
      next_term(l) = next(l) + x(l)*before(l)
    end do
  end subroutine put_two

  !> Start an even coefficient of a square without a product; load its first factors.
  pure subroutine begin_square(x, y, total, next, before, ahead)
    real(wp), intent(in), dimension(n_lanes) :: x, y
    real(wp), intent(out), dimension(n_lanes) :: total, next, before, ahead
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = 0.0_wp
      next(l) = 0.0_wp
      before(l) = x(l)
      ahead(l) = y(l)
    end do
  end subroutine begin_square

  !> Add the previous x times y, and x y to the next coefficient; load the y that follows.
  pure subroutine add_two_before(total, next, before, y, x, following)
    real(wp), intent(inout), dimension(n_lanes) :: total, next, before, y
    real(wp), intent(in), dimension(n_lanes) :: x, following
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = total(l) + before(l)*y(l)
      before(l) = x(l)
      next(l) = next(l) + before(l)*y(l)
      y(l) = following(l)
    end do
  end subroutine add_two_before

  !> An odd coefficient of a product: its stored part, and its first and last product.
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

  !> The same for a square.
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

  !> c x, clipped.
  pure subroutine put(c, x, term)
    real(wp), intent(in) :: c, x(n_lanes)
    real(wp), intent(out) :: term(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      term(l) = min(max(c*x(l), -largest), largest)
    end do
  end subroutine put

  !> c (2 x + y^2), clipped.
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

  !> total + x y. Not unrolled, so that gfortran 12 uses whole vector registers.
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
