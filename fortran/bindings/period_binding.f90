! A flat routine over motions of whole periods, for f2py.

!> A motion of a polynomial system from t = 0, in n_steps equal steps h, and the derivatives of its
!! end: by_start(i, j) is the derivative of number i of the last state by number j of the first.
!! With `beside` = 0 they are not computed, and known is 0: the motion alone takes far less time. A
!! state consists of coordinates and velocities alternately, then the rates of the hidden states,
!! n_wide numbers in total. System, load and method are given as in `polynomial_simulate`.
!! at_times: states at ascending times, n_reached of them, without hidden states. n_passed: number
!! of surfaces crossed; known = 0: the derivatives are unknown.
subroutine polynomial_period(flat, n_flat, orders, series, n_rows, n_series, nu, method, thin, &
                             h, n_steps, tolerance, begin, n_wide, times, n_times, beside, last, &
                             by_start, at_times, n_reached, n_passed, known, ended, t_reached, &
                             status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int, c_long
  use viscovib_binding_tools, only: make_load, report
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_load, only: load_type
  use viscovib_method_catalogue, only: new_stepper
  use viscovib_motion_beside, only: motion_beside
  use viscovib_motion_slopes, only: has_slopes
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_simulate, only: simulate
  use viscovib_status, only: fail, status_input_error, status_type
  use viscovib_stepper, only: stepper_type
  use viscovib_system_vector, only: polynomial_from_vector
  implicit none
  integer(c_int), intent(in) :: n_flat, n_rows, n_series, orders(n_series), method, n_wide
  integer(c_int), intent(in) :: n_times, beside
  integer(c_long), intent(in) :: n_steps
  real(c_double), intent(in) :: flat(n_flat), nu, thin, h, tolerance, begin(n_wide)
  real(c_double), intent(in) :: times(n_times)
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  real(c_double), intent(out) :: last(n_wide), by_start(n_wide, n_wide), t_reached
  real(c_double), intent(out) :: at_times(2*n_rows - 2, n_times)
  integer(c_int), intent(out) :: n_reached, n_passed, known, ended, status
  !f2py threadsafe
  type(polynomial_type) :: system
  type(polynomial_motion_type) :: motion
  type(load_type) :: load
  class(stepper_type), allocatable :: stepper
  type(motion_beside) :: along
  type(status_type) :: outcome
  real(c_double), allocatable :: hidden(:), whole(:, :), none(:, :)
  integer, allocatable :: place(:)
  integer(c_long) :: n_done
  integer :: i, n

  last = begin
  by_start = 0.0_c_double
  at_times = 0.0_c_double
  t_reached = 0.0_c_double
  n_reached = 0
  n_passed = 0
  known = 0
  ended = 0
  call polynomial_from_vector(system, flat, outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    call new_fitted_motion(motion, system, load, nu, h, h*n_steps, outcome)
  end if
  if (.not. outcome%failed()) then
    if (.not. has_slopes(motion)) then
      call fail(outcome, status_input_error, 'system', 'system: has elements that know what ' &
                //'was, or laws of more arguments than are differentiated here')
    end if
  end if
  n = n_rows - 1
  if (.not. outcome%failed() .and. motion%n_hidden /= n_wide - 2*n) then
    call fail(outcome, status_input_error, 'begin', 'begin: has not as many numbers as the state')
  end if
  if (.not. outcome%failed()) then
    ! Displacements that stand for what is remembered act on nothing, and begin with 0.
    allocate (hidden(motion%n_hidden), source=0.0_c_double)
    call new_stepper(stepper, motion, method, [begin(1:2*n:2), hidden], &
                     [begin(2:2*n:2), begin(2*n + 1:)], 0.0_c_double, h, tolerance)
    motion%thin = thin
    allocate (none(2*n, 0))
    if (beside /= 0) then
      call along%begin(motion%n_dof)
      call simulate(stepper, motion, 0_c_long, n_steps, 1_c_long, times, none, at_times, n_done, &
                    n_reached, t_reached, ended, beside=along)
      ! Of all coordinates, then of all velocities, the place of each number of the state.
      allocate (place(2*n + motion%n_hidden))
      place = [([i, motion%n_dof + i], i=1, n), (motion%n_dof + i, i=n + 1, motion%n_dof)]
      allocate (whole(2*motion%n_dof, 2*motion%n_dof))
      whole(:motion%n_dof, :) = along%q
      whole(motion%n_dof + 1:, :) = along%v
      by_start = whole(place, place)
      n_passed = along%n_passed
      known = merge(1, 0, along%known)
    else
      call simulate(stepper, motion, 0_c_long, n_steps, 1_c_long, times, none, at_times, n_done, &
                    n_reached, t_reached, ended)
    end if
    last(1:2*n:2) = stepper%q(:n)
    last(2:2*n:2) = stepper%v(:n)
    last(2*n + 1:) = stepper%v(n + 1:)
  end if
  call report(outcome, status)
end subroutine polynomial_period
