!> Sine and cosine for the vector unit: no branch, no call.
module viscovib_vector_math
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: sine_cosine, sine_cosine_lanes

  !> Largest angle for which the reduction below keeps every digit.
  real(wp), parameter, public :: largest_angle = 1.0e6_wp

  !> Adding it rounds to an integer and leaves that in the low bits.
  real(wp), parameter :: rounder = 6755399441055744.0_wp
  !> pi/2 in two parts, the first of 33 bits, so that its products with the
  !! multiples met here are exact (Cody and Waite).
  real(wp), parameter :: part_1 = 1.57079632673412561417e0_wp
  real(wp), parameter :: part_2 = 6.077100506506192e-11_wp

contains

  !> The same for a block of lanes: here the compiler sees the loop whole.
  pure subroutine sine_cosine_lanes(x, sine, cosine)
    real(wp), intent(in) :: x(n_lanes)
    real(wp), intent(out) :: sine(n_lanes), cosine(n_lanes)
    integer :: l
    do l = 1, n_lanes
      call sine_cosine(x(l), sine(l), cosine(l))
    end do
  end subroutine sine_cosine_lanes

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
    ! In pairs rather than by Horner: half as long to wait for.
    w = z*z
    s = (-1.66666666666666324348e-1_wp + 8.33333333332248946124e-3_wp*z) &
        + w*((-1.98412698298579493134e-4_wp + 2.75573137070700676789e-6_wp*z) &
             + w*(-2.50507602534068634195e-8_wp + 1.58969099521155010221e-10_wp*z))
    s = t + t*z*s
    c = (4.16666666666666019037e-2_wp - 1.38888888888741095749e-3_wp*z) &
        + w*((2.48015872894767294178e-5_wp - 2.75573143513906633035e-7_wp*z) &
             + w*(2.08757232129817482790e-9_wp - 1.13596475577881948265e-11_wp*z))
    c = (1.0_wp - 0.5_wp*z) + w*c

    ! Quadrants 1 and 3 exchange the two; 2 and 3 turn the sine, 1 and 2 the cosine.
    sine = merge(c, s, btest(quadrant, 0))
    cosine = merge(s, c, btest(quadrant, 0))
    sine = transfer(ieor(transfer(sine, 0_i8), shiftl(iand(quadrant, 2_i8), 62)), 0.0_wp)
    cosine = transfer(ieor(transfer(cosine, 0_i8), shiftl(iand(quadrant + 1_i8, 2_i8), 62)), 0.0_wp)
  end subroutine sine_cosine

end module viscovib_vector_math
