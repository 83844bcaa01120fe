! Flat routines over branches of periodic solutions, for f2py. System and load
! are given as in mount_binding.

!> A branch from p = start to p = finish, p being the frequency (parameter = 1) or
!! the factor of the load (2) at the frequency nu. n_kept as the plan says.
subroutine mount_branch(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, orders, &
                        series, n_rows, n_series, parameter, nu, start, finish, harmonics, &
                        tolerance, max_points, max_step, with_stability, n_kept, &
                        max_crossings, cancel, n_points, ended, p, iterations, coefficients, &
                        n_folds, folds, fold_coefficients, stable, multipliers, exponents, &
                        n_crossings, kinds, before, crossings, crossing_coefficients, status, &
                        message)
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: fill_stability, make_load, make_options, make_system, report
  use viscovib_branch, only: branch_options, branch_type, follow_branch, parameter_frequency
  use viscovib_crossings, only: crossing_type, find_crossings, known_folds
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_load, only: load_type
  use viscovib_motion_stability, only: judge_type, new_judge, stability_type
  use viscovib_newton_point, only: point_from_rest
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged
  use viscovib_response_plan, only: method_newton, new_response_plan, response_plan_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_rows, n_series
  integer(c_int), intent(in) :: parameter, harmonics
  integer(c_int), intent(in) :: orders(n_series), max_points, with_stability, n_kept
  integer(c_int), intent(in) :: max_crossings
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi), nu, start, finish
  real(c_double), intent(in) :: tolerance, max_step
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(out) :: n_points, ended, n_folds, status
  real(c_double), intent(out) :: p(max_points), folds(max_points)
  integer(c_int), intent(out) :: iterations(max_points)
  complex(c_double_complex), intent(out) :: coefficients(n_kept, n_rows - 1, max_points)
  complex(c_double_complex), intent(out) :: fold_coefficients(n_kept, n_rows - 1, max_points)
  !> As in `stability_type`, NaN where there are none.
  integer(c_int), intent(out) :: stable(max_points)
  complex(c_double_complex), intent(out) :: multipliers(2*n_rows + 2, max_points)
  complex(c_double_complex), intent(out) :: exponents(2*n_rows + 2, max_points)
  !> How many there are, of which the first max_crossings are given: kinds of
  !! `viscovib_crossings`, points before (from 1), and where: NaN if not located.
  integer(c_int), intent(out) :: n_crossings, kinds(max_crossings), before(max_crossings)
  real(c_double), intent(out) :: crossings(max_crossings)
  complex(c_double_complex), intent(out) :: &
    crossing_coefficients(n_kept, n_rows - 1, max_crossings)
  character(len=512), intent(out) :: message
  !f2py threadsafe
  class(oscillator_type), allocatable :: system
  type(load_type) :: load
  type(response_plan_type) :: plan
  type(balance_type) :: balance
  type(branch_options) :: options
  type(branch_type) :: branch
  type(judge_type) :: judge
  type(stability_type) :: stability
  type(crossing_type), allocatable :: found_crossings(:)
  type(status_type) :: outcome
  real(c_double) :: x(2*n_kept, n_rows - 1)
  integer :: i, d, found, iterations_made

  n_points = 0
  n_folds = 0
  n_crossings = 0
  ended = -1
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    call new_response_plan(plan, system, load, [nu], method_newton, &
                           make_options(harmonics, tolerance, 100, 1.0_c_double, 0), outcome)
  end if
  if (.not. outcome%failed()) then
    call new_balance(balance, system, plan%set)
    options = branch_options(start, finish, tolerance, max_points, max_step)
    x = 0.0_c_double
    found = outcome_converged
    iterations_made = 0
    if (parameter == parameter_frequency) then
      call balance%set_frequency(system, load, start)
      call point_from_rest(balance, system, load, tolerance, x, found, iterations_made, &
                           cancel(1))
    else
      call balance%set_frequency(system, load, nu)
      if (abs(start) > 0.0_c_double) then
        balance%load_factor = start
        call point_from_rest(balance, system, load, tolerance, x, found, iterations_made, &
                           cancel(1))
      end if
    end if
    if (found == outcome_converged) then
      call follow_branch(balance, system, load, parameter, options, x, branch, cancel(1))
      n_points = branch%n_points
      ended = branch%outcome
      n_folds = branch%n_folds
      p(:n_points) = branch%parameter(:n_points)
      iterations(:n_points) = branch%iterations(:n_points)
      do d = 1, n_rows - 1
        coefficients(:, d, :n_points) = cmplx(branch%x(1::2, d, :n_points), &
                                              branch%x(2::2, d, :n_points), c_double)
        fold_coefficients(:, d, :n_folds) = cmplx(branch%fold_x(1::2, d, :), &
                                                  branch%fold_x(2::2, d, :), c_double)
      end do
      folds(:n_folds) = branch%fold
    end if
    if (with_stability /= 0 .and. n_points > 0) then
      call new_judge(judge, system, plan%set)
      call judge%judge(system, [(merge(p(i), nu, parameter == parameter_frequency), &
                                 i=1, n_points)], branch%x(:, :, :n_points), stability, cancel(1))
      call fill_stability(stability, stable, multipliers, exponents)
      call find_crossings(judge, balance, system, load, parameter == parameter_frequency, nu, &
                          p(:n_points), branch%x(:, :, :n_points), stability, &
                          known_folds(branch%fold, branch%fold_x), found_crossings, cancel(1))
      n_crossings = size(found_crossings)
      do i = 1, min(n_crossings, max_crossings)
        associate (crossing => found_crossings(i))
          kinds(i) = crossing%kind
          before(i) = crossing%before
          crossings(i) = ieee_value(0.0_c_double, ieee_quiet_nan)
          if (.not. crossing%located) cycle
          crossings(i) = crossing%p
          crossing_coefficients(:, :, i) = cmplx(crossing%x(1::2, :), crossing%x(2::2, :), &
                                                 c_double)
        end associate
      end do
    end if
  end if
  call report(outcome, status, message)
end subroutine mount_branch
