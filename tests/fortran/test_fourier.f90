!> Discrete Fourier transforms against their definition; peaks between samples in closed form.
module test_fourier
  use testing, only: begin, check_close
  use viscovib_constants, only: imaginary_unit, pi
  use viscovib_fourier, only: real_spectrum
  use viscovib_kinds, only: wp
  use viscovib_located_peaks, only: locate_peaks
  implicit none
  private

  public :: run_fourier

contains

  subroutine run_fourier()
    integer :: n

    if (begin('every length, more than are remembered')) then
      do n = 1, 40
        call compare(n)
      end do
      call compare(3)
      call compare(211)
    end if
    if (begin('peaks between samples')) then
      do n = 1, 20
        call locate(0.13_wp + 0.01_wp*n)
      end do
    end if
  end subroutine run_fourier

  subroutine compare(n)
    integer, intent(in) :: n
    real(wp) :: signal(n)
    complex(wp) :: spectrum(n/2 + 1), expected
    integer :: j, k

    signal = [(sin(1.3_wp*j**2), j=0, n - 1)]
    call real_spectrum(signal, spectrum)
    do k = 0, n/2
      expected = sum(signal*[(exp(-2.0_wp*pi*imaginary_unit*modulo(j*k, n)/n), j=0, n - 1)])
      call check_close(abs(spectrum(k + 1) - expected), 0.0_wp, 2.0e-15_wp*n, 'difference', &
                       floor=1.0_wp)
    end do
  end subroutine compare

  !> The peaks of exp(-d t) sin(t), and of a wave that has a corner where a sample is or is not.
  subroutine locate(d)
    real(wp), intent(in) :: d
    integer, parameter :: n = 81
    real(wp) :: t(n), values(n, 3), peak(3), at(3), error(3), corner, top
    integer :: i

    t = [(0.1_wp*i, i=0, n - 1)]
    corner = 1.0_wp + 0.5_wp*d
    values(:, 1) = exp(-d*t)*sin(t)
    values(:, 2) = -values(:, 1)
    values(:, 3) = exp(-3.0_wp*abs(t - corner))
    call locate_peaks(t, values, [corner], peak, at, error)
    top = atan2(1.0_wp, d)
    call check_close(peak(1), exp(-d*top)*sin(top), 1.0e-11_wp, 'peak')
    call check_close(peak(2), -peak(1), 0.0_wp, 'trough')
    call check_close(at(1), top, 1.0e-5_wp, 'time of the peak')
    call check_close(peak(3), 1.0_wp, 1.0e-6_wp, 'peak at a corner')
    call check_close(at(3), corner, 1.0e-9_wp, 'time of the corner')
    call check_close(max(0.0_wp, abs(peak(3) - 1.0_wp) - error(3)), 0.0_wp, 1.0e-15_wp, &
                     'error at the corner', floor=1.0_wp)
  end subroutine locate

end module test_fourier
