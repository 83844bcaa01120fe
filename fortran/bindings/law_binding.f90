! Flat routines over force laws, for f2py.

!> Compile a law. Names stand in fields of 64 characters. The program is given as code and number
!! of each instruction; if it is longer than the room given, n_code says what is needed.
subroutine law_compile(text, arguments, n_arguments, names, n_names, values, max_code, code, &
                       number, n_code, parity, degree, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: report
  use viscovib_law_program, only: law_program
  use viscovib_law_text, only: compile_law
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  implicit none
  character(len=*), intent(in) :: text, arguments, names
  integer(c_int), intent(in) :: n_arguments, n_names, max_code
  real(c_double), intent(in) :: values(n_names)
  integer(c_int), intent(out) :: code(max_code), n_code, parity, degree, status
  real(c_double), intent(out) :: number(max_code)
  character(len=64) :: argument_names(n_arguments), parameter_names(n_names)
  character(len=:), allocatable :: fault
  type(law_program) :: law
  type(status_type) :: outcome
  integer :: i

  code = 0
  number = 0.0_c_double
  n_code = 0
  call set_ok(outcome)
  do i = 1, n_arguments
    argument_names(i) = arguments(64*i - 63:64*i)
  end do
  do i = 1, n_names
    parameter_names(i) = names(64*i - 63:64*i)
  end do
  call compile_law(text, argument_names, parameter_names, values, law, parity, degree, fault)
  if (fault /= '') then
    call fail(outcome, status_input_error, 'law', fault)
  else
    n_code = size(law%code)
    i = min(n_code, max_code)
    code(:i) = law%code(:i)
    number(:i) = law%number(:i)
  end if
  call report(outcome, status)
end subroutine law_compile

!> Compile a law for n sets of values of its parameters, as `law_compile` does for one; slopes: its
!! derivatives where all arguments are 0; flaws(i) /= 0: with values i there is no such law, or it
!! has no value on all sides of rest, or is longer than the room given.
subroutine law_compile_many(text, arguments, n_arguments, names, near, max_code, values, n_names, &
                            n, code, number, n_code, parity, degree, slopes, flaws, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: report
  use viscovib_law_program, only: law_program, wall
  use viscovib_law_text, only: compile_law
  use viscovib_status, only: set_ok, status_type
  implicit none
  character(len=*), intent(in) :: text, arguments, names
  integer(c_int), intent(in) :: n_arguments, n_names, n, max_code
  !> How near to rest it must have a value.
  real(c_double), intent(in) :: values(n_names, n), near
  integer(c_int), intent(out) :: code(max_code, n), n_code(n), parity(n), degree(n), flaws(n)
  integer(c_int), intent(out) :: status
  real(c_double), intent(out) :: number(max_code, n), slopes(n_arguments, n)
  !f2py threadsafe
  character(len=64) :: argument_names(n_arguments), parameter_names(n_names)
  character(len=:), allocatable :: fault
  real(c_double) :: at(2*n_arguments + 1, n_arguments), value(2*n_arguments + 1)
  real(c_double) :: rest(1), by(1, n_arguments)
  type(law_program) :: law
  type(status_type) :: outcome
  integer :: i, k

  call set_ok(outcome)
  code = 0
  number = 0.0_c_double
  n_code = 0
  slopes = 0.0_c_double
  flaws = 0
  at = 0.0_c_double
  do i = 1, n_arguments
    argument_names(i) = arguments(64*i - 63:64*i)
    at(1 + i, i) = near
    at(1 + n_arguments + i, i) = -near
  end do
  do i = 1, n_names
    parameter_names(i) = names(64*i - 63:64*i)
  end do
  do i = 1, n
    call compile_law(text, argument_names, parameter_names, values(:, i), law, parity(i), &
                     degree(i), fault)
    flaws(i) = 1
    if (fault /= '') cycle
    k = size(law%code)
    if (k > max_code) cycle
    n_code(i) = k
    code(:k, i) = law%code
    number(:k, i) = law%number
    call law%evaluate(at, value)
    call law%differentiate(at(:1, :), rest, by)
    slopes(:, i) = by(1, :)
    if (all(abs(value) < wall) .and. all(abs(by) < wall)) flaws(i) = 0
  end do
  call report(outcome, status)
end subroutine law_compile_many

!> A law and its derivatives at n samples of its arguments.
subroutine law_values(code, number, n_code, arguments, n, n_arguments, value, slopes)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_law_program, only: law_program
  implicit none
  integer(c_int), intent(in) :: n_code, n, n_arguments
  integer(c_int), intent(in) :: code(n_code)
  real(c_double), intent(in) :: number(n_code), arguments(n, n_arguments)
  real(c_double), intent(out) :: value(n), slopes(n, n_arguments)
  !f2py threadsafe
  type(law_program) :: law

  law%n_arguments = n_arguments
  law%code = code
  law%number = number
  call law%measure()
  call law%differentiate(arguments, value, slopes)
end subroutine law_values

!> The same without derivatives, which take most of the time.
subroutine law_values_alone(code, number, n_code, arguments, n, n_arguments, value)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_law_program, only: law_program
  implicit none
  integer(c_int), intent(in) :: n_code, n, n_arguments
  integer(c_int), intent(in) :: code(n_code)
  real(c_double), intent(in) :: number(n_code), arguments(n, n_arguments)
  real(c_double), intent(out) :: value(n)
  !f2py threadsafe
  type(law_program) :: law

  law%n_arguments = n_arguments
  law%code = code
  law%number = number
  call law%measure()
  call law%evaluate(arguments, value)
end subroutine law_values_alone

!> Tell the core which procedure knows functions outside of it, by its address (see
!! viscovib_law_outside).
subroutine law_set_outside(address)
  use, intrinsic :: iso_c_binding, only: c_funptr, c_int64_t
  use viscovib_law_outside, only: set_outside
  implicit none
  integer(c_int64_t), intent(in) :: address
  type(c_funptr) :: procedure_at

  call set_outside(transfer(address, procedure_at))
end subroutine law_set_outside
