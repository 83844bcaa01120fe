!> The determinant of a complex band matrix with separate real and imaginary parts.
module viscovib_band_elimination
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_column, band_determinant

contains

  !> Determinant by elimination with partial pivoting; the matrix is overwritten.
  pure subroutine band_determinant(n, rows, width, re, im, value)
    !> Order, leading dimension, and diagonals on either side of the main one.
    integer, intent(in) :: n, rows, width
    real(wp), intent(inout) :: re(rows, n), im(rows, n)
    complex(wp), intent(out) :: value
    complex(wp) :: pivot
    real(wp) :: largest, swap
    integer :: i, j, k, m, p, last

    value = (1.0_wp, 0.0_wp)
    last = 0
    do k = 1, n
      m = min(n - k, width)
      p = k
      largest = abs(re(k, k)) + abs(im(k, k))
      do i = k + 1, k + m
        if (abs(re(i, k)) + abs(im(i, k)) > largest) then
          largest = abs(re(i, k)) + abs(im(i, k))
          p = i
        end if
      end do
      pivot = cmplx(re(p, k), im(p, k), wp)
      value = value*pivot
      if (.not. largest > 0.0_wp) return
      ! Row exchanges widen the band.
      last = max(last, min(n, p + width))
      if (p /= k) then
        value = -value
        do j = k, last
          swap = re(p, j)
          re(p, j) = re(k, j)
          re(k, j) = swap
          swap = im(p, j)
          im(p, j) = im(k, j)
          im(k, j) = swap
        end do
      end if
      pivot = 1.0_wp/pivot
      do i = k + 1, k + m
        swap = real(pivot)*re(i, k) - aimag(pivot)*im(i, k)
        im(i, k) = real(pivot)*im(i, k) + aimag(pivot)*re(i, k)
        re(i, k) = swap
      end do
      do j = k + 1, last
        call add_column(m, -cmplx(re(k, j), im(k, j), wp), re(k + 1, k), im(k + 1, k), &
                        re(k + 1, j), im(k + 1, j))
      end do
    end do
  end subroutine band_determinant

  !> Add a complex multiple of one column to another.
  pure subroutine add_column(n, f, from_re, from_im, re, im)
    integer, intent(in) :: n
    complex(wp), intent(in) :: f
    real(wp), intent(in) :: from_re(n), from_im(n)
    real(wp), intent(inout) :: re(n), im(n)
    re = re + (real(f)*from_re - aimag(f)*from_im)
    im = im + (real(f)*from_im + aimag(f)*from_re)
  end subroutine add_column

end module viscovib_band_elimination
