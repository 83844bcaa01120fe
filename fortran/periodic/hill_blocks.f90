! Optimize: -O3
!> Complex matrices of Hill's determinant, real and imaginary parts apart.
!!
!! Where forces are separable, rows and columns of an order stand together, coordinate by
!! coordinate, so that each column is a part of one row of Fourier coefficients. Elsewhere those of
!! a coordinate stand together, order by order.
module viscovib_hill_blocks
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_columns, add_toeplitz, add_waves, copy_blocks, fill_waves, moments_of, scale_rows

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

  !> Products with a periodic factor: entries c(i - l).
  pure subroutine add_toeplitz(p, c, rows, re, im)
    integer, intent(in) :: p, rows
    complex(wp), intent(in) :: c(-p:p)
    real(wp), intent(inout) :: re(rows, p), im(rows, p)
    integer :: i, l

    do l = 1, p
      do i = 1, p
        re(i, l) = re(i, l) + real(c(i - l))
        im(i, l) = im(i, l) + aimag(c(i - l))
      end do
    end do
  end subroutine add_toeplitz

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

  !> h = sum_q f_q C_q, or h + sum_q f_q C_q s where s are given, f by rows and s by columns.
  pure subroutine fill_waves(p, n, groups, most, f, waves, h, s)
    !> Orders, coordinates, and the highest difference of orders that is held.
    integer, intent(in) :: p, n, groups, most
    complex(wp), intent(in) :: f(p, groups)
    real(wp), intent(in) :: waves(n, -most:most, n, groups, 2)
    real(wp), intent(inout) :: h(n*p, n, p, 2)
    complex(wp), intent(in), optional :: s(p)
    real(wp), dimension(n, p, groups) :: f_re, f_im, g_re, g_im
    integer :: a, b, l, q

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
      do b = 1, n
        do q = 1, groups
          call add_product(n*p, q > 1 .or. present(s), g_re(1, 1, q), g_im(1, 1, q), &
                           waves(1, 1 - l, b, q, 1), waves(1, 1 - l, b, q, 2), h(1, b, l, 1), &
                           h(1, b, l, 2))
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

  !> h + part f, f by the columns of each coordinate; of the part's orders the p highest.
  pure subroutine add_columns(all, p, n, f, part, h)
    integer, intent(in) :: all, p, n
    complex(wp), intent(in) :: f(p)
    real(wp), intent(in) :: part(all, n, all, n, 2)
    real(wp), intent(inout) :: h(p, n, p, n, 2)
    integer :: b, l, o

    o = all - p
    do b = 1, n
      do l = 1, p
        h(:, :, l, b, 1) = h(:, :, l, b, 1) + (real(f(l))*part(o + 1:, :, o + l, b, 1) &
                                               - aimag(f(l))*part(o + 1:, :, o + l, b, 2))
        h(:, :, l, b, 2) = h(:, :, l, b, 2) + (real(f(l))*part(o + 1:, :, o + l, b, 2) &
                                               + aimag(f(l))*part(o + 1:, :, o + l, b, 1))
      end do
    end do
  end subroutine add_columns

  !> Of a matrix with all orders the blocks of the p highest.
  pure subroutine copy_blocks(all, p, n, from, h)
    integer, intent(in) :: all, p, n
    real(wp), intent(in) :: from(all, n, all, n, 2)
    real(wp), intent(out) :: h(p, n, p, n, 2)
    h = from(all - p + 1:, :, all - p + 1:, :, :)
  end subroutine copy_blocks

  !> h becomes f h, f by the rows of each coordinate.
  pure subroutine scale_rows(p, n, f, h)
    integer, intent(in) :: p, n
    complex(wp), intent(in) :: f(p)
    real(wp), intent(inout) :: h(p, n, p*n, 2)
    real(wp) :: re
    integer :: a, i, l

    do l = 1, p*n
      do a = 1, n
        do i = 1, p
          re = real(f(i))*h(i, a, l, 1) - aimag(f(i))*h(i, a, l, 2)
          h(i, a, l, 2) = real(f(i))*h(i, a, l, 2) + aimag(f(i))*h(i, a, l, 1)
          h(i, a, l, 1) = re
        end do
      end do
    end do
  end subroutine scale_rows

end module viscovib_hill_blocks
