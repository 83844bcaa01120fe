! Flat routines over spectra, for f2py. Not `threadsafe`: plans are made under
! Python's lock.

!> Discrete Fourier transform of a real signal, shape (n/2 + 1).
subroutine real_dft(signal, n, spectrum, n_spectrum)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_fourier, only: real_spectrum
  implicit none
  integer(c_int), intent(in) :: n, n_spectrum
  real(c_double), intent(in) :: signal(n)
  complex(c_double_complex), intent(out) :: spectrum(n_spectrum)
  call real_spectrum(signal, spectrum)
end subroutine real_dft
