! Optimize: -O3
!> Windows of spectral analysis, periodic (DFT-even) cosine sums
!! w_k = sum_j (-1)^j a_j cos(2 pi j k/n).
!!
!! Harris, On the use of windows for harmonic analysis with the discrete Fourier
!! transform, Proc. IEEE 66 (1978) 51 (Hann, Blackman-Harris); flat top: ISO
!! 18431-2.
module viscovib_windows
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_vector_math, only: sine_cosine_lanes
  implicit none
  private

  public :: window_values, coherent_gain, noise_bandwidth

  integer, parameter, public :: window_rectangular = 1, window_hann = 2, &
                                window_blackman_harris = 3, window_flat_top = 4
  character(len=*), parameter, public :: window_names(4) = &
    [character(len=15) :: 'rectangular', 'hann', 'blackman_harris', 'flat_top']

  real(wp), parameter :: terms(0:4, 4) = reshape( &
                         [1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, &
                          0.5_wp, 0.5_wp, 0.0_wp, 0.0_wp, 0.0_wp, &
                          0.35875_wp, 0.48829_wp, 0.14128_wp, 0.01168_wp, 0.0_wp, &
                          0.21557895_wp, 0.41663158_wp, 0.277263158_wp, 0.083578947_wp, &
                          0.006947368_wp], [5, 4])

contains

  !> Values at k = 0 ... n-1.
  pure subroutine window_values(window, n, values)
    integer, intent(in) :: window, n
    real(wp), intent(out) :: values(n)
    real(wp) :: angles(n_lanes), sines(n_lanes), cosines(n_lanes), part(n_lanes)
    integer :: first, last, k, l

    if (window == window_rectangular) then
      values = 1.0_wp
      return
    end if
    ! The second half mirrors the first.
    do first = 0, n/2, n_lanes
      do l = 1, n_lanes
        angles(l) = 2.0_wp*pi*real(first + l - 1, wp)/real(n, wp)
      end do
      call sine_cosine_lanes(angles, sines, cosines)
      part = clenshaw(terms(:, window), -2.0_wp*cosines)
      last = min(first + n_lanes - 1, n/2)
      values(first + 1:last + 1) = part(:last - first + 1)
      do k = max(first, 1), last
        values(n - k + 1) = part(k - first + 1)
      end do
    end do
  end subroutine window_values

  !> sum_j a_j T_j(c/2) with the signs of the window in c, from the last term to the first.
  pure function clenshaw(a, c) result(total)
    real(wp), intent(in) :: a(0:4), c(n_lanes)
    real(wp), dimension(n_lanes) :: total, b1, b2, b0
    integer :: j
    b1 = 0.0_wp
    b2 = 0.0_wp
    do j = 4, 1, -1
      b0 = a(j) + c*b1 - b2
      b2 = b1
      b1 = b0
    end do
    total = a(0) + 0.5_wp*c*b1 - b2
  end function clenshaw

  !> Mean of the values: factor of a tone's amplitude.
  pure real(wp) function coherent_gain(window)
    integer, intent(in) :: window
    coherent_gain = terms(0, window)
  end function coherent_gain

  !> Equivalent noise bandwidth in bins, n sum w^2/(sum w)^2.
  pure real(wp) function noise_bandwidth(window)
    integer, intent(in) :: window
    noise_bandwidth = (terms(0, window)**2 + 0.5_wp*sum(terms(1:, window)**2)) &
                      /terms(0, window)**2
  end function noise_bandwidth

end module viscovib_windows
