!> Powers (x + i y)^(-alpha) to the last digits.
!!
!! Both the Koltunov-Rzhanitsyn and the fractional-exponential kernels have
!! transforms made of such powers. The textbook form rho^(-alpha) cos(alpha
!! theta) loses every digit of the cosine when alpha is near 1 and x << y;
!! here the angle is measured from whichever axis is nearer, so that the
!! sine and the cosine are always taken of an angle of at most pi/4 or so.
module viscovib_complex_power
  use viscovib_constants, only: half_pi
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: power_of_quadrant, gamma_function

contains

  !> c - i s = factor (x + i y)^(-alpha) for x >= 0, y >= 0, not both 0,
  !! 0 < alpha <= 1. Then c >= 0 and s >= 0, each to a few ulp.
  elemental subroutine power_of_quadrant(factor, alpha, x, y, c, s)
    real(wp), intent(in) :: factor, alpha, x, y
    real(wp), intent(out) :: c, s
    real(wp) :: modulus, angle, turned

    modulus = factor*hypot(x, y)**(-alpha)
    if (y <= x) then
      angle = alpha*atan(y/x)
      turned = half_pi - angle
    else
      turned = (1.0_wp - alpha)*half_pi + alpha*atan(x/y)
      angle = alpha*(half_pi - atan(x/y))
    end if
    if (angle <= turned) then
      c = modulus*cos(angle)
      s = modulus*sin(angle)
    else
      c = modulus*sin(turned)
      s = modulus*cos(turned)
    end if
  end subroutine power_of_quadrant

  !> Gamma(x) rounded correctly but for rare ties: evaluated in quadruple
  !! precision, since the C library's double version errs by several ulp.
  elemental real(wp) function gamma_function(x)
    use, intrinsic :: iso_fortran_env, only: real128
    real(wp), intent(in) :: x
    gamma_function = real(gamma(real(x, real128)), wp)
  end function gamma_function

end module viscovib_complex_power
