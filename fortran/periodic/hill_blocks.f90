! Optimize: -O3
!> Complex matrices of Hill's determinant, real and imaginary parts apart.
!!
!! Rows and columns of an order stand together, coordinate by coordinate, so that slopes of few
!! waves make a band matrix. Where forces are separable, each column is a part of one row of Fourier
!! coefficients.
module viscovib_hill_blocks
  use viscovib_band_elimination, only: add_column
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_columns, add_products, add_waves, fill_waves, moments_of, reach_of, scale_rows, &
    widths_of

  !> Rounding error of Fourier coefficients.
  real(wp), parameter :: small = 4.0_wp*epsilon(1.0_wp)

contains

  !> Fourier coefficients of a constant and a slope, of orders stride times the index.
  pure subroutine moments_of(waves, varies, slope, constant, c)
    !> exp(-2 pi i m/n)/n of so many samples.
    complex(wp), intent(in) :: waves(0:)
    logical, intent(in) :: varies
    real(wp), intent(in) :: slope(:), constant
    !> Orders -p to p.
    complex(wp), intent(out) :: c(:)
    complex(wp) :: total
    integer :: m, s, p, n

    n = size(slope)
    p = size(c)/2
    c = (0.0_wp, 0.0_wp)
    if (varies) then
      ! Samples resolve the orders below half their number over a (half) period.
      do m = 0, min(p, (n - 1)/2)
        total = (0.0_wp, 0.0_wp)
        do s = 1, n
          total = total + slope(s)*waves(modulo(m*(s - 1), n))
        end do
        c(p + 1 + m) = total
        c(p + 1 - m) = conjg(total)
      end do
    end if
    c(p + 1) = c(p + 1) + constant
  end subroutine moments_of

  !> Add Fourier coefficients to those of each coordinate.
  pure subroutine add_waves(parts, c, waves)
    !> Of each coordinate, shape (n), and coefficients of orders -p to p.
    real(wp), intent(in) :: parts(:)
    complex(wp), intent(in) :: c(:)
    !> Shape (n, 2 p + 1, 2).
    real(wp), intent(inout) :: waves(:, :, :)
    integer :: i

    do i = 1, size(c)
      waves(:, i, 1) = waves(:, i, 1) + parts*real(c(i))
      waves(:, i, 2) = waves(:, i, 2) + parts*aimag(c(i))
    end do
  end subroutine add_waves

  !> The largest difference of orders whose Fourier coefficients are above rounding errors, those
  !! of entries as large as the product of what is given for their row and their column.
  pure integer function reach_of(waves, rows, columns) result(reach)
    !> Orders 0, 1, ... in the last index; those of -m are conjugates of those of m.
    complex(wp), intent(in) :: waves(:, :, 0:)
    real(wp), intent(in) :: rows(:), columns(:)
    integer :: b

    do reach = ubound(waves, 3), 1, -1
      do b = 1, size(columns)
        if (any(abs(waves(:, b, reach)) > small*rows*columns(b))) return
      end do
    end do
  end function reach_of

  !> The largest differences of orders of one factor, for each difference of the other, whose
  !! products are above rounding errors; -1: none.
  pure function widths_of(one, other) result(widths)
    !> Sizes of the Fourier coefficients of orders 0, 1, ..., relative to the largest.
    real(wp), intent(in) :: one(0:), other(0:)
    integer :: widths(0:ubound(other, 1))
    integer :: k

    do k = 0, ubound(other, 1)
      widths(k) = findloc(one*other(k) > small, .true., 1, back=.true.) - 1
    end do
  end function widths_of

  !> h = sum_q f_q C_q, or h + sum_q f_q C_q s where s are given, f by rows and s by columns, of
  !! orders that differ by at most `reach`. Entries of others that row exchanges use become 0.
  pure subroutine fill_waves(p, n, groups, most, reach, f, waves, h, s)
    !> Orders, coordinates, and the highest difference of orders that is held.
    integer, intent(in) :: p, n, groups, most, reach
    complex(wp), intent(in) :: f(p, groups)
    real(wp), intent(in) :: waves(n, -most:most, n, groups, 2)
    real(wp), intent(inout) :: h(n, p, n, p, 2)
    complex(wp), intent(in), optional :: s(p)
    real(wp), dimension(n, p, groups) :: f_re, f_im, g_re, g_im
    integer :: a, b, first, l, last, q

    do a = 1, n
      f_re(a, :, :) = real(f)
      f_im(a, :, :) = aimag(f)
    end do
    g_re = f_re
    g_im = f_im
    do l = 1, p
      if (present(s)) then
        g_re = real(s(l))*f_re - aimag(s(l))*f_im
        g_im = real(s(l))*f_im + aimag(s(l))*f_re
      end if
      first = max(1, l - reach)
      last = min(p, l + reach)
      if (.not. present(s)) then
        h(:, max(1, l - 2*(reach + 1)):first - 1, :, l, :) = 0.0_wp
        h(:, last + 1:min(p, last + 1), :, l, :) = 0.0_wp
      end if
      do b = 1, n
        do q = 1, groups
          call add_product(n*(last - first + 1), q > 1 .or. present(s), g_re(1, first, q), &
                           g_im(1, first, q), waves(1, first - l, b, q, 1), &
                           waves(1, first - l, b, q, 2), h(1, first, b, l, 1), &
                           h(1, first, b, l, 2))
        end do
      end do
    end do
  end subroutine fill_waves

  !> f c, or h + f c, entry by entry.
  pure subroutine add_product(n, more, f_re, f_im, c_re, c_im, re, im)
    integer, intent(in) :: n
    logical, intent(in) :: more
    real(wp), dimension(n), intent(in) :: f_re, f_im, c_re, c_im
    real(wp), dimension(n), intent(inout) :: re, im

    if (more) then
      re = re + (f_re*c_re - f_im*c_im)
      im = im + (f_re*c_im + f_im*c_re)
    else
      re = f_re*c_re - f_im*c_im
      im = f_re*c_im + f_im*c_re
    end if
  end subroutine add_product

  !> h + b f w of Fourier coefficients b (n, m) and w (m, n): blocks sum_k b_(i-k) f_k w_(k-l).
  pure subroutine add_products(p, n, m, most, widths, f, b, w, h)
    !> Orders, coordinates, variables, the highest difference of orders that is held.
    integer, intent(in) :: p, n, m, most
    !> Largest i - k to be added for each k - l, -1 for none.
    integer, intent(in) :: widths(0:most)
    complex(wp), intent(in) :: f(p, m), w(m, n, -most:most)
    real(wp), intent(in) :: b(n, -most:most, m, 2)
    real(wp), intent(inout) :: h(n, p, n, p, 2)
    complex(wp) :: right
    integer :: a, first, j, k, l, last, width

    do l = 1, p
      do k = 1, p
        width = widths(abs(k - l))
        if (width < 0) cycle
        first = max(1, k - width)
        last = min(p, k + width)
        do a = 1, n
          do j = 1, m
            right = f(k, j)*w(j, a, k - l)
            if (.not. abs(real(right)) + abs(aimag(right)) > 0.0_wp) cycle
            call add_column(n*(last - first + 1), right, b(1, first - k, j, 1), &
                            b(1, first - k, j, 2), h(1, first, a, l, 1), h(1, first, a, l, 2))
          end do
        end do
      end do
    end do
  end subroutine add_products

  !> h + f c of Fourier coefficients c (n, n), f by columns.
  pure subroutine add_columns(p, n, most, reach, f, c, h)
    integer, intent(in) :: p, n, most, reach
    complex(wp), intent(in) :: f(p), c(n, n, -most:most)
    real(wp), intent(inout) :: h(n, p, n, p, 2)
    integer :: i, l

    do l = 1, p
      do i = max(1, l - reach), min(p, l + reach)
        h(:, i, :, l, 1) = h(:, i, :, l, 1) + real(f(l)*c(:, :, i - l))
        h(:, i, :, l, 2) = h(:, i, :, l, 2) + aimag(f(l)*c(:, :, i - l))
      end do
    end do
  end subroutine add_columns

  !> h becomes f h, f by the rows of each order.
  pure subroutine scale_rows(p, n, reach, f, h)
    integer, intent(in) :: p, n, reach
    complex(wp), intent(in) :: f(p)
    real(wp), intent(inout) :: h(n, p, n, p, 2)
    complex(wp) :: block(n, n)
    integer :: i, l

    do l = 1, p
      do i = max(1, l - reach), min(p, l + reach)
        block = f(i)*cmplx(h(:, i, :, l, 1), h(:, i, :, l, 2), wp)
        h(:, i, :, l, 1) = real(block)
        h(:, i, :, l, 2) = aimag(block)
      end do
    end do
  end subroutine scale_rows

end module viscovib_hill_blocks
