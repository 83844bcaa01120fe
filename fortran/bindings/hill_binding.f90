! Flat routines over the stability of periodic solutions with memory, for f2py. The
! system is given as in mount_binding.

!> Growing exponents of periodic solutions at the frequencies nu, with n_kept
!! harmonics, highest order `harmonics`, relative to the base; half_wave = 1: odd ones.
!! Exponents, at most n_slots a solution, are found from those of the one before.
subroutine oscillator_hill(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, nu, n, &
                           coefficients, n_kept, n_dof, harmonics, half_wave, n_slots, cancel, &
                           n_growing, exponents, evaluations, status, message)
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_system, report
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_hill, only: hill_type, new_hill
  use viscovib_hill_count, only: count_growing
  use viscovib_hill_roots, only: find_exponents
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n, n_kept, n_dof
  integer(c_int), intent(in) :: harmonics, half_wave, n_slots
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi), nu(n)
  complex(c_double_complex), intent(in) :: coefficients(n_kept, n_dof, n)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  !> -1: unknown.
  integer(c_int), intent(out) :: n_growing(n), evaluations(n), status
  complex(c_double_complex), intent(out) :: exponents(n_slots, n)
  character(len=512), intent(out) :: message
  !f2py threadsafe
  class(oscillator_type), allocatable :: system
  type(harmonic_set_type) :: set
  type(hill_type) :: hill
  type(status_type) :: outcome
  real(c_double) :: x(2*n_kept, n_dof)
  complex(c_double_complex) :: near(n_slots)
  integer :: i

  exponents = cmplx(ieee_value(0.0_c_double, ieee_quiet_nan), 0.0_c_double, c_double)
  n_growing = -1
  evaluations = 0
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) then
    call new_harmonic_set(set, harmonics, half_wave /= 0, system%degree)
    call new_hill(hill, system, set)
    do i = 1, n
      if (cancel(1) /= 0) exit
      x(1::2, :) = real(coefficients(:, :, i))
      x(2::2, :) = aimag(coefficients(:, :, i))
      call hill%along(system, nu(i), x)
      call count_growing(hill, system, n_growing(i), evaluations(i))
      if (n_slots >= 2*n_dof) then
        call find_exponents(hill, system, n_growing(i), exponents(:, max(i - 1, 1)), near)
        exponents(:, i) = near
      end if
    end do
  end if
  call report(outcome, status, message)
end subroutine oscillator_hill
