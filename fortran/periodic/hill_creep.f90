!> Slow exponents of a periodic solution that creeps away: zeros of Hill's determinant D at
!! lambda = s, real s > 0 and small (lambda = i d/2 + s under half-wave symmetry).
!!
!! Where the integral of a kernel exceeds 1, or does not exist, a motion creeps at rates that may
!! be many decades below its frequency, near the branch point of memory at s = 0. There D
!! changes with the logarithm of s, t = log(s/d): D(t) is real for real t and has no singularity
!! in |Im t| < pi. So on a circle of radius r < pi about a centre c its Taylor series
!!
!!   D(c + r z) = sum_k a_k z^k,  a_k = (1/N) sum_j D(c + r exp(2 pi i j/N)) exp(-2 pi i j k/N)
!!
!! falls off like (r/pi)^k, and its zeros in the circle are those of the polynomial that is kept
!! (Lyness and Delves, Numer. Math. 10 (1967) 457). They come all at once, those of springs that
!! share a kernel too, which lie close together. Circles stand in a row of strips; each gives the
!! zeros of its own strip, so that none is taken twice.
module viscovib_hill_creep
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_constants, only: pi
  use viscovib_hill, only: hill_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial_zeros, only: polynomial_zeros
  implicit none
  private

  public :: n_slow, n_strips, rates_in_strip, strip_of

  !> Rates of interest in d: nothing slower is counted as growing.
  real(wp), parameter :: slowest = 1.0e-12_wp
  !> Width of strips and radius of circles, in t.
  real(wp), parameter :: width = 1.2_wp, r = 1.0_wp
  !> As many strips reach from the slowest to 0.29 d: the next singularities, of the neighbouring
  !! orders, are at t = +-i pi/2. Rates beyond the slow ones, up to 0.008 d, are found as others
  !! are.
  integer, parameter :: n_strips = 22, n_slow = 19
  !> Values on a circle, of which all but two count twice, and the degree that is kept.
  integer, parameter :: half = 24, degree = 24
  !> Rounding errors separate three zeros close to each other by up to this distance.
  real(wp), parameter :: side_by_side = 1.0e-4_wp

contains

  !> The strip in which an exponent lies, 1, 2, ...; 0: in none, or unknown (NaN).
  elemental integer function strip_of(hill, exponent)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: exponent

    strip_of = 0
    if (ieee_is_nan(real(exponent))) return
    if (abs(aimag(exponent) - place(hill)) > 0.0_wp) return
    if (.not. real(exponent) >= slowest*hill%period) return
    strip_of = 1 + floor(log(real(exponent)/(slowest*hill%period))/width)
    if (strip_of > n_strips) strip_of = 0
  end function strip_of

  !> All exponents in a strip.
  subroutine rates_in_strip(hill, system, strip, exponents)
    type(hill_type), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: strip
    complex(wp), allocatable, intent(out) :: exponents(:)
    real(wp) :: series(0:degree), centre
    complex(wp) :: z(degree)
    integer :: k
    logical :: found

    allocate (exponents(0))
    centre = log(slowest*hill%period) + (strip - 0.5_wp)*width
    call taylor(hill, system, centre, series, found)
    if (.not. found) return
    ! Of 1/z.
    call polynomial_zeros(series, z, found)
    if (.not. found) return
    z = pack(z, abs(z) > 1.0_wp, [(cmplx(0.0_wp, 1.0_wp, wp), k=1, degree)])
    z = r/z
    do k = 1, degree
      if (abs(aimag(z(k))) > side_by_side) cycle
      if (real(z(k)) < -0.5_wp*width .or. real(z(k)) >= 0.5_wp*width) cycle
      exponents = [exponents, cmplx(exp(centre + real(z(k))), place(hill), wp)]
    end do
  end subroutine rates_in_strip

  !> The series about a centre in powers of (t - c)/r; not found where D is no number.
  subroutine taylor(hill, system, centre, series, found)
    type(hill_type), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: centre
    real(wp), intent(out) :: series(0:)
    logical, intent(out) :: found
    complex(wp) :: values(0:half), s
    real(wp) :: angle
    integer :: j, k

    series = 0.0_wp
    do j = 0, half
      s = exp(centre + r*cmplx(cos(pi*j/half), sin(pi*j/half), wp))
      call hill%determinant_from_place(system, s, values(j))
      found = abs(values(j)) <= huge(1.0_wp)
      if (.not. found) return
    end do
    ! The values below the real axis are the conjugates.
    do k = 0, ubound(series, 1)
      series(k) = real(values(0)) + merge(1, -1, modulo(k, 2) == 0)*real(values(half))
      do j = 1, half - 1
        angle = pi*modulo(j*k, 2*half)/half
        series(k) = series(k) + 2.0_wp*real(values(j)*cmplx(cos(angle), -sin(angle), wp))
      end do
    end do
    series = series/(2*half)
    found = abs(series(0)) > 0.0_wp
  end subroutine taylor

  !> Im lambda on the line where the motion creeps.
  pure real(wp) function place(hill)
    type(hill_type), intent(in) :: hill
    place = merge(0.5_wp*hill%period, 0.0_wp, hill%stride == 2)
  end function place

end module viscovib_hill_creep
