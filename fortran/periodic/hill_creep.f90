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
!!
!! Rates of monotonic growth of a system with constant stiffness are real s > 0 at which its matrix,
!! such as s^2 M + s C + B [1 - R(s)] W, is singular. They exist if a kernel R has an integral above
!! 1, or none: relaxed springs then push. For fast memory the growth is fast, far above all
!! frequencies of the load, where no other method computes these exponents.
module viscovib_hill_creep
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_constants, only: pi
  use viscovib_dense, only: factorize
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_hill_determinant, only: hill_determinant
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial_zeros, only: polynomial_zeros
  implicit none
  private

  public :: n_slow, n_strips, rates_from_rest, rates_in_strip, strip_of

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
  !> Rounding errors move two zeros close to each other by up to the first distance, and more of
  !! them by up to the second. Zeros of a group are nearer to each other than the third; the circle
  !! about it is larger than the group by the last.
  real(wp), parameter :: side_by_side = 1.0e-4_wp, doubtful = 0.02_wp, together = 0.05_wp
  real(wp), parameter :: larger = 6.0_wp
  !> Largest rate at constant stiffness, and largest slow one, relative to a frequency; factor
  !! between two rates, larger for slow ones.
  real(wp), parameter :: fastest = 1.0e5_wp, slow = 1.0e-3_wp
  real(wp), parameter :: ratio = 1.1_wp, ratio_of_slow = 10.0_wp
  !> Relative tolerance of these rates.
  real(wp), parameter :: close_enough = 1.0e-9_wp
  !> Largest number of coordinates for which eigenvalues are cheap.
  integer, parameter :: most_by_eigenvalues = 8

contains

  !> The strip in which an exponent lies, 1, 2, ...; 0: in none, or unknown (NaN).
  elemental integer function strip_of(hill, exponent)
    class(hill_determinant), intent(in) :: hill
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
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: strip
    complex(wp), allocatable, intent(out) :: exponents(:)
    complex(wp), allocatable :: t(:), closer(:)
    complex(wp) :: middle
    real(wp) :: around
    integer :: i, n

    middle = log(slowest*hill%period) + (strip - 0.5_wp)*width
    call zeros_about(hill, system, real(middle), r, t)
    t = pack(t, abs(aimag(t)) <= doubtful .and. real(t - middle) >= -0.5_wp*width &
             .and. real(t - middle) < 0.5_wp*width)
    ! Circles that are not much larger than a group of zeros separate these.
    do i = 1, size(t)
      associate (group => abs(t - t(i)) <= together)
        n = count(group)
        if (n < 3 .or. any(group(:i - 1))) cycle
        middle = sum(t, group)/n
        around = larger*maxval(abs(t - middle), group)
        call zeros_about(hill, system, real(middle), around, closer)
        closer = pack(closer, abs(closer - middle) <= 0.5_wp*around)
        if (size(closer) == n) t = unpack(closer, group, t)
      end associate
    end do
    t = pack(t, abs(aimag(t)) <= side_by_side)
    exponents = cmplx(exp(real(t)), place(hill), wp)
  end subroutine rates_in_strip

  !> Zeros of D by t in a circle; none where D is no number.
  subroutine zeros_about(hill, system, centre, radius, t)
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: centre, radius
    complex(wp), allocatable, intent(out) :: t(:)
    real(wp) :: series(0:degree)
    complex(wp) :: z(degree)
    logical :: found

    allocate (t(0))
    call taylor(hill, system, centre, radius, series, found)
    if (.not. found) return
    ! Of 1/z.
    call polynomial_zeros(series, z, found)
    if (found) t = centre + radius/pack(z, abs(z) > 1.0_wp)
  end subroutine zeros_about

  !> The series about a centre in powers of (t - c)/r; not found where D is no number.
  subroutine taylor(hill, system, centre, r, series, found)
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: centre, r
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
    class(hill_determinant), intent(in) :: hill
    place = merge(0.5_wp*hill%period, 0.0_wp, hill%stride == 2)
  end function place

  !> Rates, ascending, including close ones: the number of negative eigenvalues changes by the
  !! number of rates between two values.
  subroutine rates_from_rest(hill, system, nu, rates)
    class(hill_determinant), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> A frequency (rad/s) of typical magnitude.
    real(wp), intent(in) :: nu
    real(wp), allocatable, intent(out) :: rates(:)
    real(wp) :: low, high
    integer :: n_low, n_high

    allocate (rates(0))
    high = slowest*nu
    n_high = n_negative(hill, system, high)
    do while (high < fastest*nu)
      low = high
      n_low = n_high
      high = merge(ratio_of_slow, ratio, low < slow*nu)*low
      n_high = n_negative(hill, system, high)
      call part(hill, system, low, n_low, high, n_high, rates)
    end do
  end subroutine rates_from_rest

  !> Add the rates between two values.
  recursive subroutine part(hill, system, low, n_low, high, n_high, rates)
    class(hill_determinant), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: low, high
    integer, intent(in) :: n_low, n_high
    real(wp), allocatable, intent(inout) :: rates(:)
    real(wp) :: middle
    integer :: n_middle, i

    if (n_low == n_high .or. min(n_low, n_high) < 0) return
    if (high - low <= close_enough*low) then
      rates = [rates, (high, i=1, abs(n_high - n_low))]
      return
    end if
    middle = 0.5_wp*(low + high)
    n_middle = n_negative(hill, system, middle)
    ! Exactly at a rate.
    if (n_middle < 0) n_middle = n_high
    call part(hill, system, low, n_low, middle, n_middle, rates)
    call part(hill, system, middle, n_middle, high, n_high, rates)
  end subroutine part

  !> Number of eigenvalues with negative real part; for large systems 1 if it is odd, else 0. -1:
  !! unknown.
  integer function n_negative(hill, system, s)
    class(hill_determinant), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: s
    real(wp), allocatable :: matrix(:, :)
    complex(wp) :: values(system%n_dof())
    integer :: pivots(system%n_dof()), i
    logical :: singular, found

    call hill%mean_system(system, s, matrix)
    n_negative = -1
    if (size(matrix, 1) <= most_by_eigenvalues) then
      call eigenvalues(matrix, values, found)
      if (found) n_negative = count(real(values) < 0.0_wp)
      return
    end if
    call factorize(size(matrix, 1), matrix, pivots, singular)
    if (singular) return
    n_negative = 0
    do i = 1, size(matrix, 1)
      if (pivots(i) /= i) n_negative = n_negative + 1
      if (matrix(i, i) < 0.0_wp) n_negative = n_negative + 1
    end do
    n_negative = mod(n_negative, 2)
  end function n_negative

end module viscovib_hill_creep
