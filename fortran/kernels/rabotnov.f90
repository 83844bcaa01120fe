! Optimize: -O2 -fvect-cost-model=dynamic
!> Rabotnov's fractional-exponential kernel
!! R(t) = A t^(alpha-1) E_{alpha,alpha}(-beta t^alpha).
!!
!! E is the Mittag-Leffler function; the Laplace transform is A/(s^alpha+beta)
!! (Yu. N. Rabotnov, Elements of Hereditary Solid Mechanics, 1980, where the
!! exponent of the singularity, alpha - 1, is called alpha). With beta = 0 it is
!! an Abel kernel of amplitude A/Gamma(alpha), with alpha = 1 an exponential.
module viscovib_rabotnov
  use, intrinsic :: ieee_arithmetic, only: ieee_positive_inf, ieee_value
  use viscovib_checks, only: check_fraction, check_not_negative
  use viscovib_constants, only: half_pi, pi
  use viscovib_gauss_points, only: points_16, weights_16
  use viscovib_kernel, only: panel_nodes, shrinking
  use viscovib_kinds, only: wp
  use viscovib_spectral_kernel, only: peak_reach, ripple_of_power, spectral_kernel_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: rabotnov_kernel, new_rabotnov

  integer, parameter :: contour_nodes = 26
  !> For larger alpha the spectrum has a sharp peak, where the lattice is refined.
  real(wp), parameter :: sharp = 0.8_wp

  type, extends(spectral_kernel_type) :: rabotnov_kernel
    !> A (1/s^alpha).
    real(wp) :: amplitude = 0.0_wp
    !> Fractional order, 0 < alpha <= 1.
    real(wp) :: alpha = 1.0_wp
    !> (1/s^alpha), >= 0.
    real(wp) :: beta = 0.0_wp
  contains
    procedure :: transform
    procedure :: transform_slope
    procedure :: laplace
    procedure :: value
    procedure :: accumulated
    procedure :: integral
    procedure :: fading_rate
    procedure :: local_rules
    procedure :: spectrum
    procedure :: ripple
  end type rabotnov_kernel

contains

  !> Checked constructor.
  subroutine new_rabotnov(kernel, amplitude, alpha, beta, status)
    type(rabotnov_kernel), intent(out) :: kernel
    real(wp), intent(in) :: amplitude, alpha, beta
    type(status_type), intent(out) :: status

    call check_not_negative('amplitude', amplitude, status)
    if (status%failed()) return
    call check_fraction('alpha', alpha, status)
    if (status%failed()) return
    call check_not_negative('beta', beta, status)
    if (status%failed()) return
    kernel%amplitude = amplitude
    kernel%alpha = alpha
    kernel%beta = beta
    if (alpha == 1.0_wp) then
      kernel%shift = beta
      kernel%single = amplitude
      kernel%tail_power = 0.0_wp
    else
      kernel%tail_power = 1.0_wp + alpha
      if (beta == 0.0_wp) then
        kernel%tail_power = 1.0_wp - alpha
      else if (alpha > sharp) then
        kernel%centre = log(beta)/alpha
        kernel%peak_width = pi*(1.0_wp - alpha)/alpha
      end if
    end if
  end subroutine new_rabotnov

  !> A/((i mu)^alpha + beta). The cosine of alpha pi/2 is computed as the sine of the complement,
  !! which is accurate near alpha = 1.
  subroutine transform(self, mu, cosine, sine)
    class(rabotnov_kernel), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    real(wp), intent(out) :: cosine(:), sine(:)
    real(wp) :: across, along, power, re, im, modulus
    integer :: i

    along = sin((1.0_wp - self%alpha)*half_pi)
    across = sin(self%alpha*half_pi)
    do i = 1, size(mu)
      power = abs(mu(i))**self%alpha
      re = self%beta + power*along
      im = power*across
      modulus = hypot(re, im)
      cosine(i) = self%amplitude*(re/modulus)/modulus
      sine(i) = sign(self%amplitude*(im/modulus)/modulus, mu(i))
    end do
  end subroutine transform

  !> -(alpha/mu) Rhat (i mu)^alpha/((i mu)^alpha + beta).
  subroutine transform_slope(self, mu, transform, slope)
    class(rabotnov_kernel), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    complex(wp), intent(in) :: transform(:)
    complex(wp), intent(out) :: slope(:)
    complex(wp) :: power
    integer :: i
    do i = 1, size(mu)
      power = principal_power(cmplx(0.0_wp, mu(i), wp), self%alpha)
      slope(i) = -(self%alpha/mu(i))*transform(i)*(power/(power + self%beta))
    end do
  end subroutine transform_slope

  !> A/(s^alpha + beta), cut along the negative axis.
  subroutine laplace(self, s, transform)
    class(rabotnov_kernel), intent(in) :: self
    complex(wp), intent(in) :: s(:)
    complex(wp), intent(out) :: transform(:)
    transform = self%amplitude/(principal_power(s, self%alpha) + self%beta)
  end subroutine laplace

  elemental complex(wp) function principal_power(s, alpha)
    complex(wp), intent(in) :: s
    real(wp), intent(in) :: alpha
    real(wp) :: modulus, angle
    modulus = hypot(real(s), aimag(s))**alpha
    angle = alpha*atan2(aimag(s), real(s))
    principal_power = cmplx(modulus*cos(angle), modulus*sin(angle), wp)
  end function principal_power

  subroutine value(self, t, r)
    class(rabotnov_kernel), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    real(wp) :: z(size(t))
    logical :: late(size(t))

    if (self%alpha == 1.0_wp) then
      r = self%amplitude*exp(-self%beta*t)
      return
    end if
    z = self%beta*t**self%alpha
    late = z >= 0.5_wp
    where (.not. late) r = self%amplitude*t**(self%alpha - 1.0_wp)*series(self%alpha, z)
    if (any(late)) call late_values(self, t, late, r)
  end subroutine value

  !> R(t) = integral g(x) exp(-lambda t) dx, lambda = exp(x), over the positive spectrum of
  !! `spectrum`. All terms are positive, so there is no cancellation for small alpha.
  !!
  !! The trapezoidal rule with nodes x_0 + (n + 1/2) h, beta = exp(alpha x_0), has the error
  !! exp(-pi^2/h). The poles of g at z = x_0 +- i y, y = pi (1 - alpha)/alpha, are close to the real
  !! axis for alpha near 1. For y < pi/2 their residues are added: 2 A/(alpha beta) Re exp(z - t
  !! exp(z))/(1 + exp(2 pi y/h)).
  subroutine late_values(self, t, late, r)
    class(rabotnov_kernel), intent(in) :: self
    real(wp), intent(in) :: t(:)
    logical, intent(in) :: late(:)
    real(wp), intent(inout) :: r(:)
    real(wp), parameter :: h = 0.2_wp, lowest = 41.0_wp, highest = 3.8_wp
    real(wp), allocatable :: rates(:), weights(:)
    real(wp) :: middle, y, share, q
    integer :: first, last, n, i

    middle = log(self%beta)/self%alpha
    first = floor((min(0.0_wp, -log(maxval(t, late)) - middle) - lowest)/h)
    last = ceiling((-log(minval(t, late)) + highest - middle)/h)
    allocate (rates(first:last), weights(first:last))
    do n = first, last
      rates(n) = exp(middle + (n + 0.5_wp)*h)
      q = exp(-self%alpha*abs(n + 0.5_wp)*h)
      weights(n) = rates(n)*q/((1.0_wp - q)**2 + 4.0_wp*q*cos(half_pi*self%alpha)**2)
    end do
    weights = weights*(h*self%amplitude/(pi*self%beta)*sin(pi*self%alpha))
    y = pi*(1.0_wp - self%alpha)/self%alpha
    share = 0.0_wp
    if (y < half_pi) then
      share = 2.0_wp*self%amplitude/(self%alpha*self%beta*(1.0_wp + exp(2.0_wp*pi*y/h)))
    end if
    do i = 1, size(t)
      if (.not. late(i)) cycle
      r(i) = 0.0_wp
      do n = first, last
        if (rates(n)*t(i) > 46.0_wp) exit
        r(i) = r(i) + weights(n)*exp(-rates(n)*t(i))
      end do
      if (share > 0.0_wp) r(i) = r(i) + share/t(i)*decayed(cmplx(middle + log(t(i)), y, wp))
    end do
  end subroutine late_values

  !> A t^alpha E_{alpha,alpha+1}(-z), z = beta t^alpha: by its series, and for z >= 1/2 as A/beta
  !! minus the integral from t on.
  subroutine accumulated(self, t, r)
    class(rabotnov_kernel), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    real(wp) :: z(size(t))
    logical :: late(size(t))
    integer :: i

    if (self%alpha == 1.0_wp) then
      r = self%amplitude*t
      if (self%beta > 0.0_wp) r = self%amplitude*(shrinking(self%beta*t)/self%beta)
      return
    end if
    z = self%beta*t**self%alpha
    late = z >= 0.5_wp
    do i = 1, size(t)
      if (.not. late(i)) then
        r(i) = self%amplitude*t(i)**self%alpha*mean_series(self%alpha, z(i))
      end if
    end do
    if (any(late)) call late_remainders(self, t, late, r)
  end subroutine accumulated

  !> Like `late_values`, for integral_t^inf R(s) ds = integral g(x) exp(-lambda t - x) dx, which
  !! decays like exp(-alpha |x|) on both sides. For rates with lambda t < 1e-5 the sums of g/lambda,
  !! g and g lambda suffice; they are computed once for all times.
  subroutine late_remainders(self, t, late, r)
    class(rabotnov_kernel), intent(in) :: self
    real(wp), intent(in) :: t(:)
    logical, intent(in) :: late(:)
    real(wp), intent(inout) :: r(:)
    real(wp), parameter :: h = 0.3_wp, deep = 1.5_wp, highest = 3.8_wp, slow = -11.5_wp
    real(wp), allocatable :: rates(:), weights(:), below(:, :)
    real(wp) :: y, share, q, total, along, place, middle
    integer :: first, last, split, n, i

    middle = log(self%beta)/self%alpha
    first = -ceiling(deep/(self%alpha*h))
    first = min(first, floor((-log(maxval(t, late)) - middle + slow - 30.0_wp)/h))
    last = max(ceiling((-log(minval(t, late)) + highest - middle)/h), first)
    allocate (rates(first:last), weights(first:last), below(3, first - 1:last))
    along = sin(half_pi*(1.0_wp - self%alpha))
    below(:, first - 1) = 0.0_wp
    below(1, first - 1) = slower_weights(self%alpha, h, exp(self%alpha*(first - 0.5_wp)*h))
    do n = first, last
      rates(n) = exp(middle + (n + 0.5_wp)*h)
      q = exp(-self%alpha*abs(n + 0.5_wp)*h)
      weights(n) = q/((1.0_wp - q)**2 + 4.0_wp*q*along**2)
      below(:, n) = below(:, n - 1) + weights(n)*[1.0_wp, rates(n), 0.5_wp*rates(n)**2]
    end do
    y = pi*(1.0_wp - self%alpha)/self%alpha
    share = 0.0_wp
    if (y < half_pi) share = 2.0_wp/(self%alpha*(1.0_wp + exp(2.0_wp*pi*y/h)))
    do i = 1, size(t)
      if (.not. late(i)) cycle
      place = -log(t(i)) - middle
      split = min(max(floor((place + slow)/h), first - 1), last)
      total = below(1, split) - t(i)*(below(2, split) - t(i)*below(3, split))
      do n = split + 1, min(last, ceiling((place + highest)/h))
        total = total + weights(n)*exp(-rates(n)*t(i))
      end do
      total = total*h*sin(pi*(1.0_wp - self%alpha))/pi
      if (share > 0.0_wp .and. place > -6.5_wp) then
        total = total + share*real(exp(-exp(cmplx(-place, y, wp))))
      end if
      r(i) = self%amplitude/self%beta*(1.0_wp - total)
    end do
  end subroutine late_remainders

  !> Sum of q/(1 + 2 q cos(pi alpha) + q^2) over q, q exp(-alpha h), q exp(-2 alpha h), ...:
  !! with sum_k (-1)^(k-1) sin(k pi alpha)/sin(pi alpha) q^k each power is geometric.
  pure real(wp) function slower_weights(alpha, h, q) result(total)
    real(wp), intent(in) :: alpha, h, q
    integer :: k
    total = 0.0_wp
    do k = 1, 30
      total = total + sin(k*pi*(1.0_wp - alpha))/sin(pi*(1.0_wp - alpha)) &
              *q**k/shrinking(k*alpha*h)
    end do
  end function slower_weights

  !> Re exp(w - exp(w)) for |Im w| < pi/2; 0 where exp(w) overflows.
  pure real(wp) function decayed(w)
    complex(wp), intent(in) :: w
    decayed = 0.0_wp
    if (real(w) < 700.0_wp) decayed = real(exp(w - exp(w)))
  end function decayed

  !> E_{alpha,alpha}(-z) = sum_n (-z)^n/Gamma(alpha (n+1)), for z < 1/2.
  elemental real(wp) function series(alpha, z)
    real(wp), intent(in) :: alpha, z
    real(wp) :: power
    integer :: n
    series = 0.0_wp
    power = 1.0_wp
    do n = 1, 60
      if (alpha*n > 170.0_wp .or. abs(power) < 1.0e-18_wp) exit
      series = series + power/gamma(alpha*n)
      power = -power*z
    end do
  end function series

  !> Node k of a modified Talbot contour and its derivative (Weideman, SIAM J.
  !! Numer. Anal. 44, 2006).
  pure subroutine contour_point(k, zeta, slope)
    integer, intent(in) :: k
    complex(wp), intent(out) :: zeta, slope
    real(wp) :: theta, angle
    theta = (2*k - 1)*pi/contour_nodes
    angle = 0.6407_wp*theta
    zeta = contour_nodes*cmplx(0.5017_wp*theta/tan(angle) - 0.6122_wp, 0.2645_wp*theta, wp)
    slope = contour_nodes*cmplx(0.5017_wp/tan(angle) - 0.5017_wp*angle/sin(angle)**2, &
                                0.2645_wp, wp)
  end subroutine contour_point

  !> A/beta.
  real(wp) function integral(self)
    class(rabotnov_kernel), intent(in) :: self
    if (self%amplitude == 0.0_wp) then
      integral = 0.0_wp
    else if (self%beta > 0.0_wp) then
      integral = self%amplitude/self%beta
    else
      integral = ieee_value(integral, ieee_positive_inf)
    end if
  end function integral

  !> 0, since the branch cut starts at s = 0; for a single exponential its rate.
  pure real(wp) function fading_rate(self)
    class(rabotnov_kernel), intent(in) :: self
    fading_rate = merge(self%beta, 0.0_wp, self%alpha >= 1.0_wp)
    if (.not. abs(self%amplitude) > 0.0_wp) fading_rate = huge(1.0_wp)
  end function fading_rate

  !> Gauss-Legendre panels whose lengths halve towards 0. The first piece uses the integral of R, A
  !! t^alpha E_{alpha,alpha+1}(-beta t^alpha).
  subroutine local_rules(self, tau, nodes, weights)
    class(rabotnov_kernel), intent(in) :: self
    real(wp), intent(in) :: tau(:)
    real(wp), allocatable, intent(out) :: nodes(:, :), weights(:, :)
    integer, parameter :: halvings = 52
    real(wp) :: left
    integer :: i, k

    allocate (nodes(halvings*panel_nodes + 1, size(tau)))
    allocate (weights(size(nodes, 1), size(tau)))
    do i = 1, size(tau)
      left = tau(i)
      do k = 1, halvings
        left = 0.5_wp*left
        associate (here => nodes((k - 1)*panel_nodes + 1:k*panel_nodes, i), &
                   part => weights((k - 1)*panel_nodes + 1:k*panel_nodes, i))
          here = left*(1.0_wp + points_16)
          call self%value(here, part)
          part = left*weights_16*part
        end associate
      end do
      nodes(size(nodes, 1), i) = 0.5_wp*left
      weights(size(nodes, 1), i) = self%amplitude*left**self%alpha &
                                   *mean_series(self%alpha, self%beta*left**self%alpha)
    end do
  end subroutine local_rules

  !> E_{alpha,alpha+1}(-z) = sum_n (-z)^n/Gamma(alpha (n+1) + 1), for z < 1/2; else
  !! on the contour, from its Laplace transform 1/(s (s^alpha + z)).
  pure real(wp) function mean_series(alpha, z)
    real(wp), intent(in) :: alpha, z
    real(wp) :: power
    complex(wp) :: zeta, slope
    integer :: n

    mean_series = 0.0_wp
    if (z < 0.5_wp) then
      power = 1.0_wp
      do n = 1, 60
        if (alpha*n > 169.0_wp .or. abs(power) < 1.0e-18_wp) exit
        mean_series = mean_series + power/gamma(alpha*n + 1.0_wp)
        power = -power*z
      end do
    else
      do n = 1, contour_nodes/2
        call contour_point(n, zeta, slope)
        mean_series = mean_series &
                      + aimag(exp(zeta)*slope/(zeta*(principal_power(zeta, alpha) + z)))
      end do
      mean_series = mean_series*2.0_wp/contour_nodes
    end if
  end function mean_series

  !> Spectral density of the Mittag-Leffler function, times exp(x) = lambda
  !! (Gorenflo and Mainardi, 1997): A/pi sin(pi alpha) lambda^(1+alpha)
  !! /(lambda^(2 alpha) + 2 beta lambda^alpha cos(pi alpha) + beta^2); with
  !! beta = exp(alpha m) and q = exp(-alpha |x - m|)
  !! A lambda sin(pi alpha)/(pi beta) q/((1 - q)^2 + 4 q cos(pi alpha/2)^2).
  subroutine spectrum(self, x, density)
    class(rabotnov_kernel), intent(in) :: self
    real(wp), intent(in) :: x(:)
    real(wp), intent(out) :: density(:)
    real(wp) :: factor, along, q, below, middle, d
    integer :: i

    factor = self%amplitude/pi*sin(pi*(1.0_wp - self%alpha))
    if (self%beta == 0.0_wp) then
      density = factor*exp((1.0_wp - self%alpha)*x)
      return
    end if
    along = sin(half_pi*(1.0_wp - self%alpha))
    middle = 0.0_wp
    if (.not. self%peak_width > 0.0_wp) middle = log(self%beta)/self%alpha
    do i = 1, size(x)
      d = abs(x(i) - middle)
      q = exp(-0.5_wp*self%alpha*d)
      below = 2.0_wp*q*sinh(0.5_wp*self%alpha*d)
      density(i) = factor/self%beta*exp(self%centre + x(i)) &
                   *q**2/(below**2 + 4.0_wp*q**2*along**2)
    end do
  end subroutine spectrum

  !> R falls like t^(alpha-1) at first and like t^(-alpha-1) at large t. Poles of the density at Im
  !! x = pi (1-alpha)/alpha add exp(-2 pi Im u/h), where u is x or, for close poles, the coordinate
  !! of the refined lattice.
  pure real(wp) function ripple(self, h)
    class(rabotnov_kernel), intent(in) :: self
    real(wp), intent(in) :: h
    real(wp) :: height
    ripple = max(ripple_of_power(1.0_wp - self%alpha, h), &
                 ripple_of_power(1.0_wp + self%alpha, h))
    if (self%beta > 0.0_wp) then
      height = pi*(1.0_wp - self%alpha)/self%alpha
      if (self%peak_width > 0.0_wp) height = height + peak_reach*half_pi
      ripple = max(ripple, 40.0_wp*exp(-2.0_wp*pi/h*height))
    end if
  end function ripple

end module viscovib_rabotnov
