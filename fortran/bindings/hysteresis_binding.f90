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

!> How many elements of users there are.
subroutine count_user_elements(n)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_user_elements, only: n_user_elements
  implicit none
  integer(c_int), intent(out) :: n
  n = n_user_elements
end subroutine count_user_elements

!> One of them, from 1 on: its `state`, whether it is odd, its name and those of its numbers.
subroutine describe_user_element(number, state, odd, text)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_hysteresis_catalogue, only: state_user
  use viscovib_user_elements, only: user_element, user_element_is_odd
  implicit none
  integer(c_int), intent(in) :: number
  integer(c_int), intent(out) :: state, odd
  character(len=2048), intent(out) :: text
  state = state_user + number
  odd = merge(1, 0, user_element_is_odd(number))
  text = user_element(number)
end subroutine describe_user_element

!> Whether a user's element may have these numbers.
subroutine check_user_element(state, numbers, n_numbers, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: report
  use viscovib_hysteresis_catalogue, only: state_user
  use viscovib_status, only: fail, status_input_error, status_type
  use viscovib_user_elements, only: user_element_fault
  implicit none
  integer(c_int), intent(in) :: state, n_numbers
  real(c_double), intent(in) :: numbers(n_numbers)
  integer(c_int), intent(out) :: status
  character(len=:), allocatable :: fault
  type(status_type) :: outcome

  fault = user_element_fault(state - state_user, numbers)
  if (len(fault) > 0) call fail(outcome, status_input_error, 'element', fault)
  call report(outcome, status)
end subroutine check_user_element

!> df/dd of an element where nothing has moved yet.
subroutine hysteresis_at_rest(kind, numbers, n_numbers, stiffness)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_hysteresis_catalogue, only: new_hysteresis
  implicit none
  integer(c_int), intent(in) :: kind, n_numbers
  real(c_double), intent(in) :: numbers(n_numbers)
  real(c_double), intent(out) :: stiffness
  class(hysteresis_type), allocatable :: element

  call new_hysteresis(element, kind, numbers)
  stiffness = element%stiffness_at_rest()
end subroutine hysteresis_at_rest
