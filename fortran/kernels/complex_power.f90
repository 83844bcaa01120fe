! Optimize: -O3
!> Powers (x + i y)^(-alpha) to a few ulp, vectorized for arrays.
!!
!! The transforms of the Koltunov-Rzhanitsyn and Abel kernels consist of such powers. The textbook
!! form rho^(-alpha) cos(alpha theta) loses all digits of the cosine if alpha is near 1 and x << y.
!! Here the angle is measured from the nearer axis, so that sine and cosine have arguments of at
!! most pi/4.
!!
!! The vector routine has no branches or calls in its loops, so that the compiler can vectorize it.
!! Arc tangent, sine, cosine, logarithm and exponential are implemented for the required range only.
!! The logarithm has some 70 bits, since the exponential turns its absolute error into a relative
!! error. Products that must be exact use numbers cut to 26 bits, with or without fused
!! multiply-add.
module viscovib_complex_power
  use, intrinsic :: iso_c_binding, only: c_double
  use viscovib_constants, only: half_pi
  use viscovib_kinds, only: i8, wp
  implicit none
  private

  public :: power_of_quadrant, power_of_quadrant_scalar, gamma_function

  !> Elements computed together, a multiple of 8. Shorter blocks are padded, so that the result of
  !! an element does not depend on its position.
  integer, parameter :: block_size = 64
  !> Outside of this range x^2 + y^2 overflows or underflows.
  real(wp), parameter :: smallest = 1.0e-150_wp, largest = 1.0e150_wp

  !> Adding this number rounds to an integer, which is then in the low bits.
  real(wp), parameter :: rounder = 6755399441055744.0_wp
  !> ln 2 in two parts, the first with 21 zero bits at its end.
  real(wp), parameter :: ln2_high = 6.93147180369123816490e-1_wp
  real(wp), parameter :: ln2_low = 1.90821492927058770002e-10_wp
  !> Keeps the leading 26 bits of a significand.
  integer(i8), parameter :: upper_bits = not(int(z'7FFFFFF', i8))

  interface
    pure real(c_double) function c_gamma(x) bind(c, name='viscovib_gamma')
      import :: c_double
      real(c_double), value :: x
    end function c_gamma
  end interface

contains

  !> c - i s = factor (x + i y)^(-alpha) for x >= 0, y >= 0, not both 0,
  !! 0 < alpha <= 1. Then c >= 0 and s >= 0, each to a few ulp.
  pure subroutine power_of_quadrant(factor, alpha, x, y, c, s)
    real(wp), intent(in) :: factor, alpha, x
    !> Shape (n), as c and s.
    real(wp), intent(in) :: y(:)
    real(wp), intent(out) :: c(:), s(:)
    real(wp) :: y_block(block_size), c_block(block_size), s_block(block_size)
    integer :: first, n, i

    do first = 1, size(y), block_size
      n = min(block_size, size(y) - first + 1)
      y_block(:n) = y(first:first + n - 1)
      y_block(n + 1:) = 1.0_wp
      do i = 1, n
        if (.not. in_range(x, y_block(i))) y_block(i) = 1.0_wp
      end do
      call power_of_block(factor, alpha, merge(x, 0.0_wp, x <= largest), (n + 7)/8*8, y_block, &
                          c_block, s_block)
      c(first:first + n - 1) = c_block(:n)
      s(first:first + n - 1) = s_block(:n)
      do i = first, first + n - 1
        if (in_range(x, y(i))) cycle
        call power_of_quadrant_scalar(factor, alpha, x, y(i), c(i), s(i))
      end do
    end do
  end subroutine power_of_quadrant

  elemental logical function in_range(x, y)
    real(wp), intent(in) :: x, y
    in_range = max(x, y) >= smallest .and. max(x, y) <= largest
  end function in_range

  !> The same by the C library, for any x and y.
  elemental subroutine power_of_quadrant_scalar(factor, alpha, x, y, c, s)
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
  end subroutine power_of_quadrant_scalar

  pure subroutine power_of_block(factor, alpha, x, n, y, c, s)
    real(wp), intent(in) :: factor, alpha, x
    !> Number of elements, a multiple of the register length.
    integer, intent(in) :: n
    real(wp), intent(in) :: y(block_size)
    real(wp), intent(out) :: c(block_size), s(block_size)
    real(wp) :: modulus(block_size), angle, turned, slope, sine, cosine
    integer :: i

    do i = 1, n
      modulus(i) = factor*power(x*x + y(i)*y(i), 0.5_wp*alpha)
    end do
    do i = 1, n
      slope = arc_tangent(min(x, y(i)), max(x, y(i)))
      angle = alpha*merge(slope, half_pi - slope, y(i) <= x)
      turned = merge(half_pi - angle, (1.0_wp - alpha)*half_pi + alpha*slope, y(i) <= x)
      call sine_cosine(min(angle, turned), sine, cosine)
      c(i) = modulus(i)*merge(cosine, sine, angle <= turned)
      s(i) = modulus(i)*merge(sine, cosine, angle <= turned)
    end do
  end subroutine power_of_block

  !> atan(b/a) for 0 <= b <= a, in [0, pi/4]: rational approximation of
  !! the Cephes library (Moshier), about pi/4 for the upper half.
  elemental real(wp) function arc_tangent(b, a)
    real(wp), intent(in) :: b, a
    real(wp), parameter :: quarter_pi = 0.5_wp*half_pi, rest = 3.061616997868383e-17_wp
    real(wp) :: t, z, p, q
    logical :: upper

    upper = b > 0.66_wp*a
    t = merge(b - a, b, upper)/merge(b + a, a, upper)
    z = t*t
    p = (((-8.750608600031904122785e-1_wp*z - 1.615753718733365076637e1_wp)*z &
          - 7.500855792314704667340e1_wp)*z - 1.228866684490136173410e2_wp)*z &
        - 6.485021904942025371773e1_wp
    q = ((((z + 2.485846490142306297962e1_wp)*z + 1.650270098316988542046e2_wp)*z &
          + 4.328810604912902668951e2_wp)*z + 4.853903996359136964868e2_wp)*z &
        + 1.945506571482613964425e2_wp
    arc_tangent = t + t*(z*p/q)
    if (upper) arc_tangent = quarter_pi + (arc_tangent + rest)
  end function arc_tangent

  !> Sine and cosine of 0 <= t <= pi/4: polynomials of FDLIBM (Sun Microsystems).
  elemental subroutine sine_cosine(t, sine, cosine)
    real(wp), intent(in) :: t
    real(wp), intent(out) :: sine, cosine
    real(wp) :: z, half, w

    z = t*t
    sine = ((((1.58969099521155010221e-10_wp*z - 2.50507602534068634195e-8_wp)*z &
              + 2.75573137070700676789e-6_wp)*z - 1.98412698298579493134e-4_wp)*z &
            + 8.33333333332248946124e-3_wp)*z - 1.66666666666666324348e-1_wp
    sine = t + t*z*sine
    cosine = ((((-1.13596475577881948265e-11_wp*z + 2.08757232129817482790e-9_wp)*z &
                - 2.75573143513906633035e-7_wp)*z + 2.48015872894767294178e-5_wp)*z &
              - 1.38888888888741095749e-3_wp)*z + 4.16666666666666019037e-2_wp
    half = 0.5_wp*z
    w = 1.0_wp - half
    cosine = w + (((1.0_wp - w) - half) + z*z*cosine)
  end subroutine sine_cosine

  !> q^(-a) for normal q > 0 and 0 < a <= 1/2.
  elemental real(wp) function power(q, a)
    real(wp), intent(in) :: q, a
    integer(i8), parameter :: root_half = transfer(0.70710678118654752440_wp, 0_i8), &
                              rounder_bits = transfer(rounder, 0_i8), &
                              one_bits = transfer(1.0_wp, 0_i8)
    real(wp), parameter :: ln2_inverse = 1.44269504088896340736_wp
    integer(i8) :: bits, exponent_bits
    real(wp) :: k, m, f, d, d_high, d_low, d_rest, s, s_high, s_low, z, p
    real(wp) :: log_high, log_low, a_high, l_high, y_high, y_low, n, r, e

    ! q = 2^k m, sqrt(1/2) <= m < sqrt(2); 1024 keeps the shifted bits positive.
    bits = transfer(q, 0_i8)
    exponent_bits = shiftr(bits - root_half + shiftl(1024_i8, 52), 52)
    k = transfer(exponent_bits + rounder_bits, 0.0_wp) - (rounder + 1024.0_wp)
    m = transfer(bits - shiftl(exponent_bits - 1024_i8, 52), 0.0_wp)

    ! log m = 2 (s + s^3/3 + ...), s = (m-1)/(m+1) in two parts.
    f = m - 1.0_wp
    d = m + 1.0_wp
    d_rest = m - (d - 1.0_wp)
    d_high = cut(d)
    d_low = d - d_high
    s_high = cut(f/d)
    s_low = (((f - s_high*d_high) - s_high*d_low) - s_high*d_rest)/d
    s = s_high + s_low
    z = s*s
    p = 1.0_wp/23.0_wp
    p = p*z + 1.0_wp/21.0_wp
    p = p*z + 1.0_wp/19.0_wp
    p = p*z + 1.0_wp/17.0_wp
    p = p*z + 1.0_wp/15.0_wp
    p = p*z + 1.0_wp/13.0_wp
    p = p*z + 1.0_wp/11.0_wp
    p = p*z + 1.0_wp/9.0_wp
    p = p*z + 1.0_wp/7.0_wp
    p = p*z + 1.0_wp/5.0_wp
    p = p*z + 1.0_wp/3.0_wp
    log_high = k*ln2_high + 2.0_wp*s_high
    log_low = (2.0_wp*s_high - (log_high - k*ln2_high)) &
              + (k*ln2_low + (2.0_wp*s_low + 2.0_wp*s*z*p))

    ! y = -a log q, its first part exact.
    a_high = cut(a)
    l_high = cut(log_high)
    y_high = -a_high*l_high
    y_low = -(a_high*(log_high - l_high) + (a - a_high)*log_high + a*log_low)

    ! exp y = 2^n exp r, |r| <= ln(2)/2.
    n = (y_high + y_low)*ln2_inverse + rounder
    bits = transfer(n, 0_i8)
    n = n - rounder
    r = (y_high - n*ln2_high) + (y_low - n*ln2_low)
    e = 1.0_wp/6227020800.0_wp
    e = e*r + 1.0_wp/479001600.0_wp
    e = e*r + 1.0_wp/39916800.0_wp
    e = e*r + 1.0_wp/3628800.0_wp
    e = e*r + 1.0_wp/362880.0_wp
    e = e*r + 1.0_wp/40320.0_wp
    e = e*r + 1.0_wp/5040.0_wp
    e = e*r + 1.0_wp/720.0_wp
    e = e*r + 1.0_wp/120.0_wp
    e = e*r + 1.0_wp/24.0_wp
    e = e*r + 1.0_wp/6.0_wp
    e = e*r + 0.5_wp
    e = 1.0_wp + (r + r*r*e)
    power = e*transfer(shiftl(bits, 52) + one_bits, 0.0_wp)
  end function power

  !> The leading 26 bits.
  elemental real(wp) function cut(a)
    real(wp), intent(in) :: a
    cut = transfer(iand(transfer(a, 0_i8), upper_bits), 0.0_wp)
  end function cut

  !> Gamma(x), correctly rounded except for rare ties.
  elemental real(wp) function gamma_function(x)
    real(wp), intent(in) :: x
    gamma_function = c_gamma(x)
  end function gamma_function

end module viscovib_complex_power
