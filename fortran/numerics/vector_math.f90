! Optimize: -O3
!> Sine, cosine, exponential, hyperbolic tangent and logarithm for the vector unit: no branches, no
!! calls.
module viscovib_vector_math
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: exponential_lanes, logarithm_lanes, sine_cosine_array, sine_cosine_lanes, tangent_lanes

  !> Largest angle for which the reduction below is accurate to the last digit.
  real(wp), parameter, public :: largest_angle = 1.0e6_wp

  !> Adding it rounds to an integer and stores that in the low bits.
  real(wp), parameter :: rounder = 6755399441055744.0_wp
  !> pi/2 in two parts, the first of 33 bits, so that its products with the
  !! multiples used here are exact (Cody and Waite).
  real(wp), parameter :: part_1 = 1.57079632673412561417e0_wp
  real(wp), parameter :: part_2 = 6.077100506506192e-11_wp

  !> log(2) in two parts, the first of 33 bits.
  real(wp), parameter :: log_1 = 6.93147180369123816490e-1_wp, log_2 = 1.90821492927058770002e-10_wp
  !> 1/k!, k = 2 ... 13: the remainder of exp(x) for |x| <= log(2)/2 is 4e-18.
  real(wp), parameter :: inverse(2:13) = [0.5_wp, 1.0_wp/6.0_wp, 1.0_wp/24.0_wp, 1.0_wp/120.0_wp, &
    1.0_wp/720.0_wp, 1.0_wp/5040.0_wp, 1.0_wp/40320.0_wp, 1.0_wp/362880.0_wp, &
    1.0_wp/3628800.0_wp, 1.0_wp/39916800.0_wp, 1.0_wp/479001600.0_wp, 1.0_wp/6227020800.0_wp]

contains

  !> exp(x) for -700 <= x <= 700, to about an ulp.
  pure subroutine exponential_lanes(x, e)
    real(wp), intent(in) :: x(n_lanes)
    real(wp), intent(out) :: e(n_lanes)
    real(wp) :: part, power
    integer :: l
    do l = 1, n_lanes
      call split_exponential(x(l), part, power)
      e(l) = power + power*part
    end do
  end subroutine exponential_lanes

  !> tanh(x), to about two ulps: t/(t + 2) with t = exp(2 |x|) - 1, which is 1 from |x| = 20 on.
  pure subroutine tangent_lanes(x, y)
    real(wp), intent(in) :: x(n_lanes)
    real(wp), intent(out) :: y(n_lanes)
    real(wp) :: part, power, t
    integer :: l
    do l = 1, n_lanes
      call split_exponential(2.0_wp*min(abs(x(l)), 20.0_wp), part, power)
      t = power*part + (power - 1.0_wp)
      y(l) = sign(t/(t + 2.0_wp), x(l))
    end do
  end subroutine tangent_lanes

  !> exp(x) = power (1 + part), where power is a power of 2: reduction to |x| <= log(2)/2 and Taylor
  !! polynomial.
  elemental subroutine split_exponential(x, part, power)
    real(wp), intent(in) :: x
    real(wp), intent(out) :: part, power
    real(wp) :: turned, n, r, s, low, high
    integer(i8) :: whole

    turned = x*1.44269504088896338700_wp + rounder
    n = turned - rounder
    r = (x - n*log_1) - n*log_2
    s = r*r
    low = (inverse(2) + inverse(3)*r) + s*((inverse(4) + inverse(5)*r) &
                                           + s*(inverse(6) + inverse(7)*r))
    high = (inverse(8) + inverse(9)*r) + s*((inverse(10) + inverse(11)*r) &
                                            + s*(inverse(12) + inverse(13)*r))
    part = r + s*(low + s*s*s*high)
    whole = transfer(turned, 0_i8) - transfer(rounder, 0_i8)
    power = transfer(shiftl(whole + 1023_i8, 52), 0.0_wp)
  end subroutine split_exponential

  !> log(x) for x > 1e-300, to about an ulp: x = 2^k (1 + f), sqrt(1/2) <= 1 + f < sqrt(2), and the
  !! polynomial of FDLIBM (Sun Microsystems) in s = f/(2 + f).
  pure subroutine logarithm_lanes(x, y)
    real(wp), intent(in) :: x(n_lanes)
    real(wp), intent(out) :: y(n_lanes)
    real(wp) :: k, f, s, z, half, r
    integer(i8) :: bits, exponent_bits
    integer :: l
    do l = 1, n_lanes
      bits = transfer(x(l), 0_i8)
      ! 0x3fe6a09e667f3bcd is sqrt(1/2).
      exponent_bits = shifta(bits - 4604544271217802189_i8, 52)
      f = transfer(bits - shiftl(exponent_bits, 52), 0.0_wp) - 1.0_wp
      k = real(exponent_bits, wp)
      s = f/(2.0_wp + f)
      z = s*s
      half = 0.5_wp*f*f
      r = z*(6.666666666666735130e-01_wp + z*(3.999999999940941908e-01_wp &
          + z*(2.857142874366239149e-01_wp + z*(2.222219843214978396e-01_wp &
          + z*(1.818357216161805012e-01_wp + z*(1.531383769920937332e-01_wp &
          + z*1.479819860511658591e-01_wp))))))
      y(l) = k*log_1 - ((half - (s*(half + r) + k*log_2)) - f)
    end do
  end subroutine logarithm_lanes

  !> The same for a block of lanes, as a loop that the compiler can vectorize.
  pure subroutine sine_cosine_lanes(x, sine, cosine)
    real(wp), intent(in) :: x(n_lanes)
    real(wp), intent(out) :: sine(n_lanes), cosine(n_lanes)
    integer :: l
    do l = 1, n_lanes
      call sine_cosine(x(l), sine(l), cosine(l))
    end do
  end subroutine sine_cosine_lanes

  !> The same for any number of angles.
  pure subroutine sine_cosine_array(x, sine, cosine)
    real(wp), intent(in), contiguous :: x(:)
    real(wp), intent(out), contiguous :: sine(:), cosine(:)
    integer :: i
    do i = 1, size(x)
      call sine_cosine(x(i), sine(i), cosine(i))
    end do
  end subroutine sine_cosine_array

  !> sin(x) and cos(x) for |x| <= `largest_angle`, to about an ulp: reduction to
  !! [-pi/4, pi/4] and the polynomials of FDLIBM (Sun Microsystems).
  elemental subroutine sine_cosine(x, sine, cosine)
    real(wp), intent(in) :: x
    real(wp), intent(out) :: sine, cosine
    real(wp) :: turned, n, t, z, w, s, c
    integer(i8) :: quadrant

    turned = x*0.636619772367581343076_wp + rounder
    quadrant = transfer(turned, 0_i8)
    n = turned - rounder
    t = (x - n*part_1) - n*part_2

    z = t*t
    ! Sums in pairs instead of Horner's scheme: half the latency.
    w = z*z
    s = (-1.66666666666666324348e-1_wp + 8.33333333332248946124e-3_wp*z) &
        + w*((-1.98412698298579493134e-4_wp + 2.75573137070700676789e-6_wp*z) &
             + w*(-2.50507602534068634195e-8_wp + 1.58969099521155010221e-10_wp*z))
    s = t + t*z*s
    c = (4.16666666666666019037e-2_wp - 1.38888888888741095749e-3_wp*z) &
        + w*((2.48015872894767294178e-5_wp - 2.75573143513906633035e-7_wp*z) &
             + w*(2.08757232129817482790e-9_wp - 1.13596475577881948265e-11_wp*z))
    c = (1.0_wp - 0.5_wp*z) + w*c

    ! Quadrants 1 and 3 exchange sine and cosine; 2 and 3 negate the sine, 1 and 2 the cosine.
    sine = merge(c, s, btest(quadrant, 0))
    cosine = merge(s, c, btest(quadrant, 0))
    sine = transfer(ieor(transfer(sine, 0_i8), shiftl(iand(quadrant, 2_i8), 62)), 0.0_wp)
    cosine = transfer(ieor(transfer(cosine, 0_i8), shiftl(iand(quadrant + 1_i8, 2_i8), 62)), 0.0_wp)
  end subroutine sine_cosine

end module viscovib_vector_math
