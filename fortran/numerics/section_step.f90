! Optimize: -O2 -fvect-cost-model=dynamic
!> Exact response of one mode of a linear system, q'' + rate q' + square q = f, over a unit of time:
!! to its state, to polynomial loads, to loads exp(i mu t). Such an equation is called a section.
!!
!! With g the impulse response, g(0) = 0, g'(0) = 1, the response to the Legendre polynomials
!! is
!!
!!   A_j = integral_0^1 g(1 - x) P_j(2x - 1) dx,   A'_j with g' for g,
!!
!! and g = (exp(l_1 t) - exp(l_2 t))/(l_1 - l_2) with the roots of l^2 + rate l + square:
!!
!!   integral_0^1 exp(z (1 - x)) P_j(2x - 1) dx = (-1)^j exp(z/2) i_j(z/2),
!!
!! i_j the modified spherical Bessel functions (DLMF 10.54.2, 10.47.7). Slow sections use
!! powers of time, sections with nearly equal roots use quadrature. All digits are accurate, from
!! sections that hardly move to those that oscillate thousands of times.
module viscovib_section_step
  use viscovib_gauss_points, only: points_32, weights_32
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: free_section, driven_section, relaxing_section, section_wave
  public :: grown, legendre_moments, slope_of_growth

  !> Size of roots below which powers of time are used; absolute and relative distance of roots
  !! that count as nearly equal; decay exponent after which a response is negligible.
  real(wp), parameter :: slow = 1.5_wp, apart = 0.5_wp, close = 0.2_wp, vanished = 40.0_wp
  !> Powers of time; size above which the upward recurrence of Bessel functions is used.
  integer, parameter :: most_powers = 30
  real(wp), parameter :: far = 30.0_wp

  integer :: power, order
  !> Highest order: panels of a first step have up to ten nodes.
  integer, parameter :: most_orders = 9
  !> Weights of powers: integral_0^1 (1-x)^n/n! P_j(2x-1) dx = (-1)^j n!/((n-j)! (n+j+1)!).
  real(wp), parameter :: weights(0:most_powers, 0:most_orders) = reshape( &
                         [((merge((-1)**order*gamma(power + 1.0_wp) &
                                  /(gamma(max(power - order, 0) + 1.0_wp) &
                                    *gamma(power + order + 2.0_wp)), 0.0_wp, power >= order), &
                            power=0, most_powers), order=0, most_orders)], &
                         [most_powers + 1, most_orders + 1])

contains

  !> Change of a state (q, q') in a unit of time: q changes by by_q(1) q + by_v(1) q', its velocity
  !! by by_q(2) q + by_v(2) q'.
  pure subroutine free_section(square, rate, by_q, by_v)
    real(wp), intent(in) :: square, rate
    real(wp), intent(out) :: by_q(2), by_v(2)
    real(wp) :: d, part, theta, faded, s, lost
    complex(wp) :: roots(2)

    d = 0.5_wp*rate
    part = square - d*d
    if (part < -1.0_wp) then
      roots = roots_of(square, rate)
      associate (a => real(roots(1)), b => real(roots(2)))
        by_v(1) = (exp(a) - exp(b))/(a - b)
        by_q(1) = (a*less_one(b) - b*less_one(a))/(a - b)
        by_v(2) = (a*less_one(a) - b*less_one(b))/(a - b)
      end associate
    else
      theta = sqrt(abs(part))
      faded = exp(-d)
      if (part > 0.0_wp) then
        s = faded*over(sin(theta), theta)
        lost = -2.0_wp*faded*sin(0.5_wp*theta)**2 + less_one(-d)
      else
        s = faded*over(sinh(theta), theta)
        lost = 2.0_wp*faded*sinh(0.5_wp*theta)**2 + less_one(-d)
      end if
      by_v(1) = s
      by_q(1) = lost + d*s
      by_v(2) = lost - d*s
    end if
    by_q(2) = -square*by_v(1)
  end subroutine free_section

  !> A and A', shape (0:n-1).
  pure subroutine driven_section(square, rate, by_order, rates)
    real(wp), intent(in) :: square, rate
    real(wp), intent(out) :: by_order(0:), rates(0:)
    complex(wp) :: roots(2), one(0:size(by_order) - 1), other(0:size(by_order) - 1)

    roots = roots_of(square, rate)
    if (maxval(abs(roots)) <= slow) then
      call by_powers(square, rate, maxval(abs(roots)), by_order, rates)
    else if (abs(roots(1) - roots(2)) < max(apart, close*abs(roots(1)))) then
      call by_quadrature(square, rate, by_order, rates)
    else
      call legendre_moments(roots(1), one)
      if (abs(aimag(roots(1))) > 0.0_wp) then
        by_order = aimag(one)/aimag(roots(1))
        rates = aimag(roots(1)*one)/aimag(roots(1))
      else
        call legendre_moments(roots(2), other)
        by_order = real(one - other)/real(roots(1) - roots(2))
        rates = real(roots(1)*one - roots(2)*other)/real(roots(1) - roots(2))
      end if
    end if
  end subroutine driven_section

  !> Response of a section without stiffness, v' + rate v = f: its relative free change, and the
  !! response to Legendre polynomials, shape (0:n-1): `legendre_moments` of a real z = -rate, whose
  !! first value is always the largest. Such sections are frequent, so they have a separate
  !! procedure.
  pure subroutine relaxing_section(rate, gained, by_order)
    real(wp), intent(in) :: rate
    real(wp), intent(out) :: gained, by_order(0:)
    real(wp) :: ratio(0:size(by_order) - 1), far_ratio, y
    integer :: j, n

    n = size(by_order)
    y = -0.5_wp*rate
    gained = less_one(-rate)
    by_order = 0.0_wp
    by_order(0) = 1.0_wp
    if (.not. abs(y) > 1.0e-100_wp) return
    by_order(0) = -gained/rate
    if (n == 1) return
    if (abs(y) > far) then
      by_order(1) = (by_order(0) - (1.0_wp + 0.5_wp*gained))/y
      do j = 1, n - 2
        by_order(j + 1) = by_order(j - 1) + (2*j + 1)/y*by_order(j)
      end do
      return
    end if
    far_ratio = 0.0_wp
    ! Start so far that the remainder is below rounding, for all y up to here.
    do j = n + 5 + int(5.5_wp*sqrt(abs(y))), n - 1, -1
      far_ratio = y/((2*j + 3) + y*far_ratio)
    end do
    ratio(n - 1) = far_ratio
    do j = n - 2, 0, -1
      ratio(j) = y/((2*j + 3) + y*ratio(j + 1))
    end do
    do j = 0, n - 2
      by_order(j + 1) = -ratio(j)*by_order(j)
    end do
  end subroutine relaxing_section

  !> Response to exp(i mu t) from rest, and its velocity.
  pure subroutine section_wave(square, rate, mu, answer, velocity)
    real(wp), intent(in) :: square, rate, mu
    complex(wp), intent(out) :: answer, velocity
    complex(wp) :: d, turned, roots(2), one, other, derivative(2)
    real(wp) :: by_q(2), by_v(2), factor
    integer :: n

    d = cmplx(square - mu**2, mu*rate, wp)
    roots = roots_of(square, rate)
    if (abs(d) >= apart) then
      call free_section(square, rate, by_q, by_v)
      ! exp(i mu) - 1 without cancellation.
      turned = cmplx(-2.0_wp*sin(0.5_wp*mu)**2, sin(mu), wp)
      answer = (turned - cmplx(by_q(1), mu*by_v(1), wp))/d
      velocity = (cmplx(0.0_wp, mu, wp)*turned - cmplx(by_q(2), mu*by_v(2), wp))/d
    else if (maxval(abs(roots)) <= slow) then
      ! Derivatives at 0: q^(n+2) = (i mu)^n - rate q^(n+1) - square q^(n).
      answer = (0.0_wp, 0.0_wp)
      velocity = (0.0_wp, 0.0_wp)
      derivative = (0.0_wp, 0.0_wp)
      turned = (1.0_wp, 0.0_wp)
      factor = 1.0_wp
      do n = 0, most_powers
        derivative = [derivative(2), turned - rate*derivative(2) - square*derivative(1)]
        turned = turned*cmplx(0.0_wp, mu, wp)
        ! Now the derivatives of orders n+1 and n+2; factor: 1/(n+1)!.
        factor = factor/(n + 1)
        velocity = velocity + factor*derivative(2)
        answer = answer + (factor/(n + 2))*derivative(2)
      end do
    else
      one = slope_of_growth(cmplx(0.0_wp, mu, wp), roots(1))
      other = slope_of_growth(cmplx(0.0_wp, mu, wp), roots(2))
      answer = (one - other)/(roots(1) - roots(2))
      velocity = (roots(1)*one - roots(2)*other)/(roots(1) - roots(2))
    end if
  end subroutine section_wave

  !> Roots of l^2 + rate l + square, conjugate or real, each without cancellation.
  pure function roots_of(square, rate) result(roots)
    real(wp), intent(in) :: square, rate
    complex(wp) :: roots(2)
    real(wp) :: d, part, larger

    d = 0.5_wp*rate
    part = square - d*d
    if (part > 0.0_wp) then
      roots = [cmplx(-d, sqrt(part), wp), cmplx(-d, -sqrt(part), wp)]
      return
    end if
    larger = -(d + sign(sqrt(-part), d))
    roots = (0.0_wp, 0.0_wp)
    if (abs(larger) > 0.0_wp) roots = [cmplx(square/larger, 0.0_wp, wp), &
                                       cmplx(larger, 0.0_wp, wp)]
  end function roots_of

  !> Derivatives of g at 0 times `weights`; each further power is smaller at least by the size of
  !! the roots.
  pure subroutine by_powers(square, rate, size_of, by_order, rates)
    !> The size of the roots.
    real(wp), intent(in) :: square, rate, size_of
    real(wp), intent(out) :: by_order(0:), rates(0:)
    real(wp) :: g(0:most_powers + 1)
    integer :: further, j, n

    g(0) = 0.0_wp
    g(1) = 1.0_wp
    do n = 0, most_powers - 1
      g(n + 2) = -rate*g(n + 1) - square*g(n)
    end do
    further = most_powers
    if (size_of < 0.05_wp) further = 14
    if (size_of < 1.0e-3_wp) further = 7
    do j = 0, size(by_order) - 1
      by_order(j) = 0.0_wp
      rates(j) = 0.0_wp
      do n = min(most_powers, j + further), j, -1
        by_order(j) = by_order(j) + weights(n, j)*g(n)
        rates(j) = rates(j) + weights(n, j)*g(n + 1)
      end do
    end do
  end subroutine by_powers

  !> Quadrature over the time in which g is not negligible.
  pure subroutine by_quadrature(square, rate, by_order, rates)
    real(wp), intent(in) :: square, rate
    real(wp), intent(out) :: by_order(0:), rates(0:)
    real(wp) :: length, t, by_q(2), by_v(2), before, here, next, x
    integer :: j, k

    length = 1.0_wp
    if (0.5_wp*rate > vanished) length = 2.0_wp*vanished/rate
    by_order = 0.0_wp
    rates = 0.0_wp
    do k = 1, size(points_32)
      t = length*points_32(k)
      call free_section(square*t*t, rate*t, by_q, by_v)
      x = 1.0_wp - 2.0_wp*t
      before = 0.0_wp
      here = 1.0_wp
      do j = 0, size(by_order) - 1
        by_order(j) = by_order(j) + length*weights_32(k)*t*by_v(1)*here
        rates(j) = rates(j) + length*weights_32(k)*(1.0_wp + by_v(2))*here
        next = ((2*j + 1)*x*here - j*before)/(j + 1)
        before = here
        here = next
      end do
    end do
  end subroutine by_quadrature

  !> integral_0^1 exp(z (1 - x)) P_j(2x - 1) dx, j = 0, 1, ... Downward recurrence of the ratios
  !! i_(j+1)/i_j (Miller), which is stable; upward recurrence for large z.
  pure subroutine legendre_moments(z, moments)
    complex(wp), intent(in) :: z
    complex(wp), intent(out) :: moments(0:)
    complex(wp) :: ratio(0:size(moments) - 1), far_ratio, y, first
    integer :: j, n

    n = size(moments)
    y = 0.5_wp*z
    moments = (0.0_wp, 0.0_wp)
    moments(0) = relative_growth(z)
    if (n == 1 .or. .not. abs(y) > 1.0e-100_wp) return
    first = (0.5_wp*(exp(z) + 1.0_wp) - moments(0))/y
    if (abs(y) > far) then
      moments(1) = -first
      do j = 1, n - 2
        moments(j + 1) = moments(j - 1) + (2*j + 1)/y*moments(j)
      end do
      return
    end if
    far_ratio = (0.0_wp, 0.0_wp)
    do j = n + 24 + int(1.2_wp*abs(y)), n - 1, -1
      far_ratio = y/((2*j + 3) + y*far_ratio)
    end do
    ratio(n - 1) = far_ratio
    do j = n - 2, 0, -1
      ratio(j) = y/((2*j + 3) + y*ratio(j + 1))
    end do
    ! Start from the larger of the first two; the other may nearly vanish.
    moments(1) = -ratio(0)*moments(0)
    if (abs(y) > 1.0_wp .and. abs(first) > abs(moments(0))) moments(1) = -first
    do j = 1, n - 2
      moments(j + 1) = -ratio(j)*moments(j)
    end do
  end subroutine legendre_moments

  !> (exp(a) - exp(b))/(a - b).
  pure complex(wp) function slope_of_growth(a, b)
    complex(wp), intent(in) :: a, b
    if (real(a) > real(b)) then
      slope_of_growth = exp(a)*relative_growth(b - a)
    else
      slope_of_growth = exp(b)*relative_growth(a - b)
    end if
  end function slope_of_growth

  !> exp(z) - 1.
  pure complex(wp) function grown(z)
    complex(wp), intent(in) :: z
    grown = z*relative_growth(z)
  end function grown

  !> (exp(z) - 1)/z.
  pure complex(wp) function relative_growth(z)
    complex(wp), intent(in) :: z
    complex(wp) :: term
    integer :: k

    if (abs(z) >= 0.5_wp) then
      relative_growth = (exp(z) - 1.0_wp)/z
      return
    end if
    term = (1.0_wp, 0.0_wp)
    relative_growth = term
    do k = 2, 16
      term = term*z/k
      relative_growth = relative_growth + term
    end do
  end function relative_growth

  !> exp(x) - 1.
  pure real(wp) function less_one(x)
    real(wp), intent(in) :: x
    if (abs(x) < 1.0_wp) then
      less_one = 2.0_wp*sinh(0.5_wp*x)*exp(0.5_wp*x)
    else
      less_one = exp(x) - 1.0_wp
    end if
  end function less_one

  !> sine/x, also for a hyperbolic sine; 1 at x = 0.
  pure real(wp) function over(sine, x)
    real(wp), intent(in) :: sine, x
    over = 1.0_wp
    if (abs(x) > 0.0_wp) over = sine/x
  end function over

end module viscovib_section_step
