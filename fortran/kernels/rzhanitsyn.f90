! Optimize: -O3
!> The Koltunov-Rzhanitsyn kernel R(t) = A exp(-beta t) t^(alpha-1).
!!
!! The kernel of seed paper 001; weakly singular at t = 0 for alpha < 1.
!! With beta = 0 it is the Abel (power law) kernel, which has no integral.
module viscovib_rzhanitsyn
  use, intrinsic :: ieee_arithmetic, only: ieee_positive_inf, ieee_value
  use viscovib_checks, only: check_fraction, check_not_negative
  use viscovib_complex_power, only: gamma_function, power_of_quadrant
  use viscovib_constants, only: pi
  use viscovib_gauss_points, only: points_16, weights_16
  use viscovib_kernel, only: panel_nodes, vanished
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: gauss_power_nodes
  use viscovib_spectral_kernel, only: ripple_of_power, spectral_kernel_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: rzhanitsyn_kernel, new_rzhanitsyn

  type, extends(spectral_kernel_type) :: rzhanitsyn_kernel
    !> A (1/s^alpha).
    real(wp) :: amplitude = 0.0_wp
    !> Exponent of the singularity, 0 < alpha <= 1.
    real(wp) :: alpha = 1.0_wp
    !> Rate of the exponential factor (1/s), >= 0.
    real(wp) :: beta = 0.0_wp
    !> A Gamma(alpha), the factor of every transform.
    real(wp), private :: factor = 0.0_wp
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
  end type rzhanitsyn_kernel

contains

  !> Checked constructor.
  subroutine new_rzhanitsyn(kernel, amplitude, alpha, beta, status)
    type(rzhanitsyn_kernel), intent(out) :: kernel
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
    kernel%factor = amplitude*gamma_function(alpha)
    kernel%tail_power = 1.0_wp - alpha
    kernel%shift = beta
    kernel%self_similar = .true.
    kernel%single = amplitude
  end subroutine new_rzhanitsyn

  !> R_c - i R_s = A Gamma(alpha) (beta + i mu)^(-alpha)
  !! (seed paper 001 after (12); Gradshteyn-Ryzhik 3.944).
  subroutine transform(self, mu, cosine, sine)
    class(rzhanitsyn_kernel), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    real(wp), intent(out) :: cosine(:), sine(:)

    call power_of_quadrant(self%factor, self%alpha, self%beta, abs(mu), cosine, sine)
    sine = sign(sine, mu)
  end subroutine transform

  !> -i alpha Rhat/(beta + i mu).
  subroutine transform_slope(self, mu, transform, slope)
    class(rzhanitsyn_kernel), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    complex(wp), intent(in) :: transform(:)
    complex(wp), intent(out) :: slope(:)
    slope = transform*cmplx(0.0_wp, -self%alpha, wp)/cmplx(self%beta, mu, wp)
  end subroutine transform_slope

  !> A Gamma(alpha) (beta + s)^(-alpha), cut along s <= -beta. Points with equal real part, as on a
  !! line or of all orders of a determinant, are evaluated together. Left of -beta:
  !! z^(-alpha) = exp(-i pi alpha) conjg((-conjg(z))^(-alpha)), Im z >= 0.
  subroutine laplace(self, s, transform)
    class(rzhanitsyn_kernel), intent(in) :: self
    complex(wp), intent(in) :: s(:)
    complex(wp), intent(out) :: transform(:)
    integer, parameter :: part = 64
    real(wp) :: cosine(part), sine(part), x
    complex(wp) :: turn
    integer :: first, last, n

    turn = exp(cmplx(0.0_wp, -pi*self%alpha, wp))
    first = 1
    do while (first <= size(s))
      last = first
      do while (last < min(first + part - 1, size(s)))
        if (abs(real(s(last + 1)) - real(s(first))) > 0.0_wp) exit
        last = last + 1
      end do
      n = last - first + 1
      x = self%beta + real(s(first))
      call power_of_quadrant(self%factor, self%alpha, abs(x), abs(aimag(s(first:last))), &
                             cosine(:n), sine(:n))
      associate (values => transform(first:last))
        if (x < 0.0_wp) then
          values = turn*cmplx(cosine(:n), sine(:n), wp)
        else
          values = cmplx(cosine(:n), -sine(:n), wp)
        end if
        values = cmplx(real(values), sign(1.0_wp, aimag(s(first:last)))*aimag(values), wp)
      end associate
      first = last + 1
    end do
  end subroutine laplace

  subroutine value(self, t, r)
    class(rzhanitsyn_kernel), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    r = self%amplitude*exp(-self%beta*t)*t**(self%alpha - 1.0_wp)
  end subroutine value

  !> A beta^(-alpha) gamma(alpha, beta t). For small z = beta t by its series A t^alpha exp(-z)
  !! sum_n z^n/(alpha ... (alpha + n)) with positive terms, otherwise by the continued fraction of
  !! Gamma(alpha, z) (Abramowitz and Stegun 6.5.29, 6.5.31).
  subroutine accumulated(self, t, r)
    class(rzhanitsyn_kernel), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    integer, parameter :: most_terms = 200
    real(wp) :: z, term, total, whole
    integer :: i, n

    whole = 0.0_wp
    if (self%beta > 0.0_wp) whole = self%integral()
    do i = 1, size(t)
      z = self%beta*t(i)
      if (z < 2.0_wp) then
        term = 1.0_wp/self%alpha
        total = term
        do n = 1, most_terms
          term = term*z/(self%alpha + n)
          total = total + term
          if (term <= epsilon(term)*total) exit
        end do
        r(i) = self%amplitude*t(i)**self%alpha*exp(-z)*total
      else if (z < vanished) then
        r(i) = whole - self%amplitude*t(i)**self%alpha*exp(-z)*upper_fraction(self%alpha, z)
      else
        r(i) = whole
      end if
    end do
  end subroutine accumulated

  !> Gamma(alpha, z) exp(z) z^(-alpha) = 1/(z + 1 - alpha - 1 (1 - alpha)/(z + 3 - alpha - ...)),
  !! evaluated backwards from a depth that suffices for z >= 2.
  elemental real(wp) function upper_fraction(alpha, z) result(fraction)
    real(wp), intent(in) :: alpha, z
    integer :: n
    fraction = 0.0_wp
    do n = 10 + int(150.0_wp/z), 1, -1
      fraction = n*(n - alpha)/(z + 2*n + 1 - alpha - fraction)
    end do
    fraction = 1.0_wp/(z + 1.0_wp - alpha - fraction)
  end function upper_fraction

  !> A Gamma(alpha) beta^(-alpha).
  real(wp) function integral(self)
    class(rzhanitsyn_kernel), intent(in) :: self
    if (self%amplitude == 0.0_wp) then
      integral = 0.0_wp
    else if (self%beta > 0.0_wp) then
      integral = self%factor*self%beta**(-self%alpha)
    else
      integral = ieee_value(integral, ieee_positive_inf)
    end if
  end function integral

  !> beta: the branch cut starts at s = -beta.
  pure real(wp) function fading_rate(self)
    class(rzhanitsyn_kernel), intent(in) :: self
    fading_rate = merge(self%beta, huge(1.0_wp), abs(self%amplitude) > 0.0_wp)
  end function fading_rate

  !> Gauss quadrature with the weight t^(alpha-1) in the first panel, where the exponential is
  !! smooth, and Gauss-Legendre panels after it.
  subroutine local_rules(self, tau, nodes, weights)
    class(rzhanitsyn_kernel), intent(in) :: self
    real(wp), intent(in) :: tau(:)
    real(wp), allocatable, intent(out) :: nodes(:, :), weights(:, :)
    !> beta times the length of a panel.
    real(wp), parameter :: smooth = 5.0_wp
    real(wp), dimension(panel_nodes) :: x, w
    real(wp) :: width, left, right
    integer :: i, k, n

    n = max(1, ceiling(min(self%beta*maxval(tau), vanished)/smooth))
    width = maxval(tau)
    if (n > 1) width = smooth/self%beta
    allocate (nodes(n*panel_nodes, size(tau)), weights(n*panel_nodes, size(tau)))
    call gauss_power_nodes(panel_nodes, self%alpha, x, w)
    do i = 1, size(tau)
      right = min(tau(i), width)
      nodes(:panel_nodes, i) = right*x
      weights(:panel_nodes, i) = self%amplitude*right**self%alpha*w*exp(-self%beta*right*x)
      do k = 2, n
        left = right
        right = min(tau(i), k*width)
        associate (here => nodes((k - 1)*panel_nodes + 1:k*panel_nodes, i), &
                   part => weights((k - 1)*panel_nodes + 1:k*panel_nodes, i))
          here = left + (right - left)*points_16
          call self%value(here, part)
          part = (right - left)*weights_16*part
        end associate
      end do
    end do
  end subroutine local_rules

  !> t^(alpha-1) = integral exp((1-alpha) x - t exp(x)) dx/Gamma(1-alpha).
  subroutine spectrum(self, x, density)
    class(rzhanitsyn_kernel), intent(in) :: self
    real(wp), intent(in) :: x(:)
    real(wp), intent(out) :: density(:)
    density = self%amplitude/gamma(self%tail_power)*exp(self%tail_power*x)
  end subroutine spectrum

  pure real(wp) function ripple(self, h)
    class(rzhanitsyn_kernel), intent(in) :: self
    real(wp), intent(in) :: h
    ripple = ripple_of_power(self%tail_power, h)
  end function ripple

end module viscovib_rzhanitsyn
