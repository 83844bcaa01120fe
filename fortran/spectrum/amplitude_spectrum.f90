! Optimize: -O3
!> One-sided amplitude spectrum of a real signal under a window.
module viscovib_amplitude_spectrum
  use viscovib_fourier, only: real_spectrum
  use viscovib_kinds, only: wp
  use viscovib_windows, only: coherent_gain, window_rectangular, window_values
  implicit none
  private

  public :: amplitude_spectrum

contains

  !> Complex amplitudes X_k, k = 0 ... n/2, at circular frequencies 2 pi k/(n dt):
  !! a tone a cos(omega t + phase) at a bin gives a exp(i phase) there; X_0 is the
  !! mean. The mean under the window is subtracted first, so that a large one does
  !! not leak into neighbouring bins.
  subroutine amplitude_spectrum(signal, window, spectrum)
    !> Shape (n), n >= 1.
    real(wp), intent(in) :: signal(:)
    !> Index in `window_names`.
    integer, intent(in) :: window
    !> Shape (n/2 + 1).
    complex(wp), intent(out) :: spectrum(:)
    real(wp), allocatable :: weights(:), weighted(:)
    real(wp) :: mean
    integer :: n

    n = size(signal)
    allocate (weights(n), weighted(n))
    ! A window needs more points than its number of terms.
    call window_values(merge(window, window_rectangular, n > 9), n, weights)
    mean = sum(weights*signal)/sum(weights)
    weighted = weights*(signal - mean)
    call real_spectrum(weighted, spectrum)
    spectrum = spectrum*(2.0_wp/(n*merge(coherent_gain(window), 1.0_wp, n > 9)))
    spectrum(1) = cmplx(mean, 0.0_wp, wp)
    ! The bin at half the sampling rate has no counterpart at negative frequency.
    if (mod(n, 2) == 0) spectrum(n/2 + 1) = 0.5_wp*spectrum(n/2 + 1)
  end subroutine amplitude_spectrum

end module viscovib_amplitude_spectrum
