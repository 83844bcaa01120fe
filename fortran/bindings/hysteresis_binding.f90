! Flat routines over elements with hysteresis, for f2py.

!> Forces of an element over cycles of deflections, straight between samples, and what is lost.
subroutine hysteresis_loops(kind, numbers, n_numbers, d, n, n_cycles, force, lost)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_hysteresis_catalogue, only: new_hysteresis
  use viscovib_hysteresis_loop, only: run_loop
  implicit none
  integer(c_int), intent(in) :: kind, n_numbers, n, n_cycles
  real(c_double), intent(in) :: numbers(n_numbers), d(n, n_cycles)
  real(c_double), intent(out) :: force(n, n_cycles), lost(n_cycles)
  !f2py threadsafe
  class(hysteresis_type), allocatable :: element
  integer :: i

  call new_hysteresis(element, kind, numbers)
  do i = 1, n_cycles
    call run_loop(element, d(:, i), force(:, i), lost(i))
  end do
end subroutine hysteresis_loops
