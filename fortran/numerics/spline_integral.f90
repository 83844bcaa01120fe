!> Integrals of sampled quantities by cubic splines (not-a-knot ends).
module viscovib_spline_integral
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: spline_integral

contains

  !> Integral from the first sample to each; NaN for fewer than four samples.
  pure function spline_integral(t, y) result(total)
    !> Strictly ascending, and the samples, shape (n).
    real(wp), intent(in) :: t(:), y(:)
    real(wp) :: total(size(t))
    real(wp) :: h(size(t)), rise(size(t)), slope(size(t)), diagonal(size(t)), upper(size(t)), factor
    integer :: i, n

    n = size(t)
    total = ieee_value(total, ieee_quiet_nan)
    if (n < 4) return
    h(:n - 1) = t(2:) - t(:n - 1)
    rise(:n - 1) = (y(2:) - y(:n - 1))/h(:n - 1)
    ! Slopes at the samples; the third derivative is continuous at the second and the last but one.
    diagonal(1) = h(2)
    upper(1) = h(1) + h(2)
    slope(1) = ((h(1) + 2.0_wp*upper(1))*h(2)*rise(1) + h(1)**2*rise(2))/upper(1)
    do i = 2, n - 1
      factor = h(i)/diagonal(i - 1)
      diagonal(i) = 2.0_wp*(h(i - 1) + h(i)) - factor*upper(i - 1)
      upper(i) = h(i - 1)
      slope(i) = 3.0_wp*(h(i)*rise(i - 1) + h(i - 1)*rise(i)) - factor*slope(i - 1)
    end do
    factor = h(n - 2) + h(n - 1)
    slope(n) = (h(n - 1)**2*rise(n - 2) + (2.0_wp*factor + h(n - 1))*h(n - 2)*rise(n - 1))/factor
    factor = factor/diagonal(n - 1)
    slope(n) = (slope(n) - factor*slope(n - 1))/(h(n - 2) - factor*upper(n - 1))
    do i = n - 1, 1, -1
      slope(i) = (slope(i) - upper(i)*slope(i + 1))/diagonal(i)
    end do
    total(1) = 0.0_wp
    do i = 1, n - 1
      total(i + 1) = total(i) + h(i)*((y(i) + y(i + 1))/2.0_wp + h(i)*(slope(i) - slope(i + 1)) &
                                      /12.0_wp)
    end do
  end function spline_integral

end module viscovib_spline_integral
