! Flat routines over spectra, for f2py.

!> Discrete Fourier transform of a real signal, shape (n/2 + 1).
subroutine real_dft(signal, n, spectrum, n_spectrum, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: report
  use viscovib_fourier, only: check_length, real_spectrum
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n, n_spectrum
  real(c_double), intent(in) :: signal(n)
  complex(c_double_complex), intent(out) :: spectrum(n_spectrum)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  type(status_type) :: outcome
  call check_length(n, outcome)
  if (.not. outcome%failed()) call real_spectrum(signal, spectrum)
  call report(outcome, status)
end subroutine real_dft

!> One-sided complex amplitudes of signals, a column each; n_spectrum = n/2 + 1.
subroutine windowed_spectrum(signals, n, m, window, spectra, n_spectrum, bandwidth, &
                             status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_amplitude_spectrum, only: amplitude_spectrum
  use viscovib_binding_tools, only: report
  use viscovib_fourier, only: check_length
  use viscovib_status, only: status_type
  use viscovib_windows, only: noise_bandwidth
  implicit none
  integer(c_int), intent(in) :: n, m, window, n_spectrum
  real(c_double), intent(in) :: signals(n, m)
  complex(c_double_complex), intent(out) :: spectra(n_spectrum, m)
  real(c_double), intent(out) :: bandwidth
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  type(status_type) :: outcome
  integer :: j
  call check_length(n, outcome)
  if (.not. outcome%failed()) then
    do j = 1, m
      call amplitude_spectrum(signals(:, j), window, spectra(:, j))
    end do
  end if
  call report(outcome, status)
  bandwidth = noise_bandwidth(window)
end subroutine windowed_spectrum

!> Sums of a least squares fit of lines, each a column (omega, decay, a, b), the first
!! n_free frequencies and the rates of decay of the lines named being free; see
!! viscovib_line_fit.
subroutine fit_sums(signal, n, lines, n_lines, mean, n_free, free_decay, n_decay, n_columns, &
                    matrix, right, total)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_line_fit, only: line_sums, lines_type, new_lines
  implicit none
  integer(c_int), intent(in) :: n, n_lines, n_free, n_decay, n_columns
  real(c_double), intent(in) :: signal(n), lines(4, n_lines), mean
  integer(c_int), intent(in) :: free_decay(n_decay)
  real(c_double), intent(out) :: matrix(n_columns, n_columns), right(n_columns), total
  type(lines_type) :: fitted
  !f2py threadsafe
  call new_lines(fitted, lines, mean)
  call line_sums(signal, fitted, n_free, free_decay, matrix, right, total)
end subroutine fit_sums

!> What lines leave of a signal.
subroutine fit_residual(signal, n, lines, n_lines, mean, residual)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_line_fit, only: line_residual, lines_type, new_lines
  implicit none
  integer(c_int), intent(in) :: n, n_lines
  real(c_double), intent(in) :: signal(n), lines(4, n_lines), mean
  real(c_double), intent(out) :: residual(n)
  type(lines_type) :: fitted
  !f2py threadsafe
  call new_lines(fitted, lines, mean)
  call line_residual(signal, fitted, residual)
end subroutine fit_residual

!> Aliased part of a displacement; `told` = 1: it counts as aliased.
subroutine aliased_part(u, v, n, step, share, told)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_aliased_share, only: aliased_share, is_aliased
  implicit none
  integer(c_int), intent(in) :: n
  real(c_double), intent(in) :: u(n), v(n), step
  real(c_double), intent(out) :: share
  integer(c_int), intent(out) :: told
  !f2py threadsafe
  share = aliased_share(u, v, step)
  told = merge(1, 0, is_aliased(share, n))
end subroutine aliased_part
