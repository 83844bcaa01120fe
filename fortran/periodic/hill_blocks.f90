!> Complex matrices of Hill's determinant, real and imaginary parts apart.
!!
!! Rows and columns of a coordinate stand together, order by order.
module viscovib_hill_blocks
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_columns, add_rates, add_rows, add_toeplitz, copy_blocks, moments_of, scale_rows

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

  !> h + f part, f by the rows of each coordinate; of the part's orders the p highest.
  pure subroutine add_rows(all, p, n, f, re, im, h)
    integer, intent(in) :: all, p, n
    complex(wp), intent(in) :: f(p)
    real(wp), intent(in) :: re(all, n, all, n), im(all, n, all, n)
    real(wp), intent(inout) :: h(p, n, p, n, 2)
    integer :: a, b, i, l, o

    o = all - p
    do b = 1, n
      do l = 1, p
        do a = 1, n
          do i = 1, p
            h(i, a, l, b, 1) = h(i, a, l, b, 1) + (real(f(i))*re(i + o, a, l + o, b) &
                                                   - aimag(f(i))*im(i + o, a, l + o, b))
            h(i, a, l, b, 2) = h(i, a, l, b, 2) + (real(f(i))*im(i + o, a, l + o, b) &
                                                   + aimag(f(i))*re(i + o, a, l + o, b))
          end do
        end do
      end do
    end do
  end subroutine add_rows

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

  !> h + f part s, f and s by the rows and columns of each coordinate.
  pure subroutine add_rates(all, p, n, f, s, re, im, h)
    integer, intent(in) :: all, p, n
    complex(wp), intent(in) :: f(p), s(p)
    real(wp), intent(in) :: re(all, n, all, n), im(all, n, all, n)
    real(wp), intent(inout) :: h(p, n, p, n, 2)
    complex(wp) :: entry
    integer :: a, b, i, l, o

    o = all - p
    do b = 1, n
      do l = 1, p
        do a = 1, n
          do i = 1, p
            entry = f(i)*s(l)*cmplx(re(i + o, a, l + o, b), im(i + o, a, l + o, b), wp)
            h(i, a, l, b, 1) = h(i, a, l, b, 1) + real(entry)
            h(i, a, l, b, 2) = h(i, a, l, b, 2) + aimag(entry)
          end do
        end do
      end do
    end do
  end subroutine add_rates

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
