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
  use viscovib_kernel, only: kernel_type
  use viscovib_kinds, only: wp
  use viscovib_status, only: status_type
  implicit none
  private

  public :: rabotnov_kernel, new_rabotnov

  type, extends(kernel_type) :: rabotnov_kernel
    !> A (1/s^alpha).
    real(wp) :: amplitude = 0.0_wp
    !> Fractional order, 0 < alpha <= 1.
    real(wp) :: alpha = 1.0_wp
    !> (1/s^alpha), >= 0.
    real(wp) :: beta = 0.0_wp
  contains
    procedure :: transform
    procedure :: laplace
    procedure :: value
    procedure :: integral
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
  end subroutine new_rabotnov

  !> A/((i mu)^alpha + beta); the cosine of alpha pi/2 is taken as a sine of
  !! the complement, which keeps its digits near alpha = 1.
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
    real(wp) :: z
    integer :: i

    do i = 1, size(t)
      z = self%beta*t(i)**self%alpha
      if (self%alpha == 1.0_wp) then
        r(i) = self%amplitude*exp(-z)
      else if (z < 0.5_wp) then
        r(i) = self%amplitude*t(i)**(self%alpha - 1.0_wp)*series(self%alpha, z)
      else
        r(i) = self%amplitude/(self%beta*t(i))*contour(self%alpha, z)
      end if
    end do
  end subroutine value

  !> E_{alpha,alpha}(-z) = sum_n (-z)^n/Gamma(alpha (n+1)), for z < 1/2.
  pure real(wp) function series(alpha, z)
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

  !> z E_{alpha,alpha}(-z) by inverting the Laplace transform on a modified
  !! Talbot contour (Weideman, SIAM J. Numer. Anal. 44, 2006): the transform
  !! less its value at s = 0, -s^alpha/(s^alpha+z), whose digits survive large z.
  pure real(wp) function contour(alpha, z)
    real(wp), intent(in) :: alpha, z
    integer, parameter :: n = 26
    real(wp) :: theta, angle
    complex(wp) :: zeta, slope, power
    integer :: k

    contour = 0.0_wp
    do k = 1, n/2
      theta = (2*k - 1)*pi/n
      angle = 0.6407_wp*theta
      zeta = n*cmplx(0.5017_wp*theta/tan(angle) - 0.6122_wp, 0.2645_wp*theta, wp)
      slope = n*cmplx(0.5017_wp/tan(angle) - 0.5017_wp*angle/sin(angle)**2, 0.2645_wp, wp)
      power = principal_power(zeta, alpha)
      ! Conjugate nodes double the imaginary part.
      contour = contour - aimag(exp(zeta)*slope*power/(power + z))
    end do
    contour = contour*2.0_wp/n
  end function contour

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

end module viscovib_rabotnov
