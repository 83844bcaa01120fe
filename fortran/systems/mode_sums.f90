! Optimize: -O3
!> Sums over the modes of a structure, vectorized over modes.
module viscovib_mode_sums
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_polynomial, apart, multiply, nearest_pole, resonances, slopes, total

  !> Modes are padded with zeros to a multiple of `mode_lanes` and processed in groups of this size.
  integer, parameter, public :: mode_lanes = 8
  integer, parameter, public :: block = 64
  !> Degree of the polynomials that represent distant modes.
  integer, parameter, public :: degree = 25
  !> Relative and absolute value that replace a difference of exactly 0.
  real(wp), parameter, public :: rounding = epsilon(1.0_wp), least = tiny(1.0_wp)**0.25_wp

contains

  !> Smaller modulus of the roots of s^2 + rate s + square.
  pure real(wp) function nearest_pole(square, rate) result(nearest)
    real(wp), intent(in) :: square, rate
    real(wp) :: under
    nearest = sqrt(abs(square))
    under = 0.25_wp*rate**2 - square
    if (under > 0.0_wp .and. nearest > 0.0_wp) then
      nearest = nearest*(nearest/(0.5_wp*abs(rate) + sqrt(under)))
    end if
  end function nearest_pole

  !> Value and slope of a polynomial with real coefficients. On the imaginary axis even and odd
  !! powers are separate real sums.
  pure subroutine add_polynomial(c, x, value, slope)
    real(wp), intent(in) :: c(0:degree)
    complex(wp), intent(in) :: x
    complex(wp), intent(out) :: value, slope
    real(wp) :: square, even, odd, even_slope, odd_slope
    integer :: j

    if (abs(real(x)) > 0.0_wp) then
      value = (0.0_wp, 0.0_wp)
      slope = (0.0_wp, 0.0_wp)
      do j = degree, 0, -1
        slope = slope*x + value
        value = value*x + c(j)
      end do
      return
    end if
    square = -aimag(x)**2
    even = 0.0_wp
    odd = 0.0_wp
    even_slope = 0.0_wp
    odd_slope = 0.0_wp
    do j = degree - 1, 0, -2
      even_slope = even_slope*square + even
      odd_slope = odd_slope*square + odd
      even = even*square + c(j)
      odd = odd*square + c(j + 1)
    end do
    value = cmplx(even, aimag(x)*odd, wp)
    slope = cmplx(odd + 2.0_wp*square*odd_slope, 2.0_wp*aimag(x)*even_slope, wp)
  end subroutine add_polynomial

  !> 1/(squares + i losses + rates s + s^2), real and imaginary part.
  pure subroutine resonances(n, squares, rates, losses, s, re, im)
    integer, intent(in) :: n
    real(wp), intent(in) :: squares(n), rates(n), losses(n)
    complex(wp), intent(in) :: s
    real(wp), intent(out) :: re(n), im(n)
    real(wp) :: x, y, size_of, by_s, on_axis, off_axis
    integer :: i

    by_s = real(s)
    on_axis = real(s)**2 - aimag(s)**2
    off_axis = 2.0_wp*real(s)*aimag(s)
    do i = 1, n
      x = squares(i) + rates(i)*by_s + on_axis
      y = losses(i) + rates(i)*aimag(s) + off_axis
      ! Without damping and at resonance the difference is only rounding error.
      x = x + merge(0.0_wp, rounding*abs(squares(i)) + least, abs(x) + abs(y) > 0.0_wp)
      size_of = 1.0_wp/(x*x + y*y)
      re(i) = x*size_of
      im(i) = -y*size_of
    end do
  end subroutine resonances

  !> Derivatives of `resonances` by s: -(rates + 2 s) t^2.
  pure subroutine slopes(n, rates, s, re, im, slope_re, slope_im)
    integer, intent(in) :: n
    real(wp), intent(in) :: rates(n), re(n), im(n)
    complex(wp), intent(in) :: s
    real(wp), intent(out) :: slope_re(n), slope_im(n)
    real(wp) :: x, y, a
    integer :: i
    do i = 1, n
      x = re(i)*re(i) - im(i)*im(i)
      y = 2.0_wp*re(i)*im(i)
      a = rates(i) + 2.0_wp*real(s)
      slope_re(i) = -(a*x - 2.0_wp*aimag(s)*y)
      slope_im(i) = -(a*y + 2.0_wp*aimag(s)*x)
    end do
  end subroutine slopes

  !> Multiply by complex factors.
  pure subroutine multiply(n, factors, re, im)
    integer, intent(in) :: n
    complex(wp), intent(in) :: factors(n)
    real(wp), intent(inout) :: re(n), im(n)
    real(wp) :: x
    integer :: i
    do i = 1, n
      x = real(factors(i))*re(i) - aimag(factors(i))*im(i)
      im(i) = real(factors(i))*im(i) + aimag(factors(i))*re(i)
      re(i) = x
    end do
  end subroutine multiply

  !> sum w (re + i im) in vector lanes; n is a multiple of `mode_lanes`.
  pure complex(wp) function total(n, w, re, im)
    integer, intent(in) :: n
    real(wp), intent(in) :: w(n), re(n), im(n)
    real(wp) :: sum_re(mode_lanes), sum_im(mode_lanes)
    integer :: i, l
    sum_re = 0.0_wp
    sum_im = 0.0_wp
    do i = 0, n - 1, mode_lanes
      do l = 1, mode_lanes
        sum_re(l) = sum_re(l) + w(i + l)*re(i + l)
        sum_im(l) = sum_im(l) + w(i + l)*im(i + l)
      end do
    end do
    total = cmplx(sum(sum_re), sum(sum_im), wp)
  end function total

  !> s - pole, or a value of the size of rounding errors where this is 0.
  elemental complex(wp) function apart(s, pole)
    complex(wp), intent(in) :: s, pole
    apart = s - pole
    if (.not. abs(apart) > 0.0_wp) apart = rounding*abs(pole) + least
  end function apart

end module viscovib_mode_sums
