!> Aliasing: states too far apart for the frequencies of a motion.
module viscovib_aliased_share
  use viscovib_constants, only: pi
  use viscovib_fourier, only: real_spectrum
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: aliased_share, is_aliased

  !> Allowed folded part of a displacement; error of the window itself, times n^2.
  real(wp), parameter :: folded = 0.01_wp, of_window = 30.0_wp

contains

  !> The part of a displacement u that has been folded to other frequencies, from its rate v.
  !!
  !! Below the Nyquist frequency w_N = pi/step, the derivative of the windowed displacement from
  !! its spectrum is w v + w' u. A part of amplitude A above it has been folded by a multiple of
  !! 2 w_N, and violates this by at least 2 w_N A. The sizes are compared by Parseval's sum.
  real(wp) function aliased_share(u, v, step) result(share)
    !> Shape (n), n >= 2, step apart.
    real(wp), intent(in) :: u(:), v(:), step
    real(wp), allocatable :: window(:), slope(:), swing(:)
    complex(wp), allocatable :: own(:), rate(:)
    real(wp) :: size_of_u
    integer :: k, n

    n = size(u)
    allocate (window(n), slope(n), swing(n))
    window(:) = [(sin(pi*(k + 0.5_wp)/n)**2, k=0, n - 1)]
    slope(:) = [(pi/(n*step)*sin(2.0_wp*pi*(k + 0.5_wp)/n), k=0, n - 1)]
    swing(:) = u - dot_product(window, u)/sum(window)
    allocate (own(0:n/2), rate(0:n/2))
    call real_spectrum(window*swing, own)
    call real_spectrum(slope*swing + window*v, rate)
    do k = 0, n/2
      if (2*k == n) own(k) = 0.0_wp
      rate(k) = cmplx(0.0_wp, 2.0_wp*pi*k/(n*step), wp)*own(k) - rate(k)
      ! All bins except the first and the last of an even length represent two.
      if (k > 0 .and. 2*k < n) rate(k) = sqrt(2.0_wp)*rate(k)
    end do
    size_of_u = norm2(window*swing)*2.0_wp*pi/step
    share = 0.0_wp
    if (size_of_u > 0.0_wp) share = norm2([abs(rate)])/sqrt(real(n, wp))/size_of_u
  end function aliased_share

  !> True if this part of n states counts as aliased.
  pure logical function is_aliased(share, n)
    real(wp), intent(in) :: share
    integer, intent(in) :: n
    is_aliased = share > max(folded, of_window/real(n, wp)**2)
  end function is_aliased

end module viscovib_aliased_share
