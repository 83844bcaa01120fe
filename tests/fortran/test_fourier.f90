!> Discrete Fourier transforms against their definition.
module test_fourier
  use testing, only: begin, check_close
  use viscovib_constants, only: imaginary_unit, pi
  use viscovib_fourier, only: real_spectrum
  use viscovib_kinds, only: wp
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

end module test_fourier
