! Flat routines over polynomial systems, for f2py; the vector is described in
! `viscovib_system_vector`. Responses and branches: see mount_binding.

!> Checks everything that makes up a system.
subroutine polynomial_check(flat, n_flat, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: report
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: status_type
  use viscovib_system_vector, only: polynomial_from_vector
  implicit none
  integer(c_int), intent(in) :: n_flat
  real(c_double), intent(in) :: flat(n_flat)
  integer(c_int), intent(out) :: status
  type(polynomial_type) :: system
  type(status_type) :: outcome
  call polynomial_from_vector(system, flat, outcome)
  call report(outcome, status)
end subroutine polynomial_check

