! Optimize: -O3
!> The determinant of a complex band matrix with separate real and imaginary parts.
module viscovib_band_elimination
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_column, band_determinant

contains

  !> Determinant by elimination with partial pivoting; the matrix is overwritten. Columns are
  !! eliminated from those behind them by twos, which are read and written half as often so.
  pure subroutine band_determinant(n, rows, width, re, im, value)
    !> Order, leading dimension, and diagonals on either side of the main one.
    integer, intent(in) :: n, rows, width
    real(wp), intent(inout) :: re(rows, n), im(rows, n)
    complex(wp), intent(out) :: value
    integer :: j, k, l, m, last, next

    value = (1.0_wp, 0.0_wp)
    last = 0
    do k = 1, n, 2
      l = k + 1
      call bring_pivot(n, rows, width, k, k, last, re, im, value)
      if (.not. abs(real(value)) + abs(aimag(value)) > 0.0_wp .or. k == n) return
      if (last > k) then
        call add_column(min(n - k, width), cmplx(re(k, l), im(k, l), wp), re(l, k), im(l, k), &
                        re(l, l), im(l, l))
      end if
      next = last
      call bring_pivot(n, rows, width, l, k, next, re, im, value)
      if (.not. abs(real(value)) + abs(aimag(value)) > 0.0_wp .or. l == n) return
      m = min(n - l, width)
      do j = l + 1, last
        call add_column(1, cmplx(re(k, j), im(k, j), wp), re(l, k), im(l, k), re(l, j), im(l, j))
        call add_two(m, cmplx(re(k, j), im(k, j), wp), cmplx(re(l, j), im(l, j), wp), &
                     re(l + 1, k), im(l + 1, k), re(l + 1, l), im(l + 1, l), re(l + 1, j), &
                     im(l + 1, j))
      end do
      do j = max(last, l) + 1, next
        call add_column(m, cmplx(re(l, j), im(l, j), wp), re(l + 1, l), im(l + 1, l), &
                        re(l + 1, j), im(l + 1, j))
      end do
      last = next
    end do
  end subroutine band_determinant

  !> The largest entry of column k into its diagonal; what is below becomes what its row is to be
  !! multiplied by, up to one row below the band.
  pure subroutine bring_pivot(n, rows, width, k, first, last, re, im, value)
    !> Columns from `first` on have their rows exchanged.
    integer, intent(in) :: n, rows, width, k, first
    !> The last column of the rows so far; row exchanges widen the band.
    integer, intent(inout) :: last
    real(wp), intent(inout) :: re(rows, n), im(rows, n)
    complex(wp), intent(inout) :: value
    complex(wp) :: pivot
    real(wp) :: largest, size_of, swap
    integer :: i, j, p, lowest

    lowest = min(n, k + width)
    p = k
    largest = 0.0_wp
    do i = k, lowest
      size_of = abs(re(i, k)) + abs(im(i, k))
      largest = merge(size_of, largest, size_of > largest)
    end do
    if (abs(re(k, k)) + abs(im(k, k)) < largest) then
      do p = k + 1, lowest - 1
        if (abs(re(p, k)) + abs(im(p, k)) >= largest) exit
      end do
    end if
    pivot = cmplx(re(p, k), im(p, k), wp)
    value = value*pivot
    if (.not. largest > 0.0_wp) return
    last = max(last, min(n, p + width))
    if (p /= k) then
      value = -value
      do j = first, last
        swap = re(p, j)
        re(p, j) = re(k, j)
        re(k, j) = swap
        swap = im(p, j)
        im(p, j) = im(k, j)
        im(k, j) = swap
      end do
    end if
    pivot = -1.0_wp/pivot
    do i = k + 1, lowest
      swap = real(pivot)*re(i, k) - aimag(pivot)*im(i, k)
      im(i, k) = real(pivot)*im(i, k) + aimag(pivot)*re(i, k)
      re(i, k) = swap
    end do
    if (lowest == n) return
    re(lowest + 1, k) = 0.0_wp
    im(lowest + 1, k) = 0.0_wp
  end subroutine bring_pivot

  !> Add complex multiples of two columns to another.
  pure subroutine add_two(n, f, g, f_re, f_im, g_re, g_im, re, im)
    integer, intent(in) :: n
    complex(wp), intent(in) :: f, g
    real(wp), dimension(n), intent(in) :: f_re, f_im, g_re, g_im
    real(wp), intent(inout) :: re(n), im(n)
    re = re + (real(f)*f_re - aimag(f)*f_im) + (real(g)*g_re - aimag(g)*g_im)
    im = im + (real(f)*f_im + aimag(f)*f_re) + (real(g)*g_im + aimag(g)*g_re)
  end subroutine add_two

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
