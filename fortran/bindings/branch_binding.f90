! Flat routines over branches of periodic solutions, for f2py. System and load
! are given as in mount_binding.

!> A branch from p = start to p = finish, p being the frequency (parameter = 1) or
!! the factor of the load (2) at the frequency nu. n_kept as the plan says.
subroutine mount_branch(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, orders, &
                        series, n_rows, n_series, parameter, nu, start, finish, harmonics, &
                        tolerance, max_points, max_step, with_stability, n_kept, cancel, &
                        n_points, ended, p, iterations, coefficients, matrices, half_wave, &
                        n_folds, folds, fold_coefficients, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_load, make_options, make_system, report
  use viscovib_branch, only: branch_options, branch_type, follow_branch, parameter_frequency
  use viscovib_floquet, only: floquet_type, new_floquet
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_load, only: load_type
  use viscovib_newton_point, only: point_from_rest
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged
  use viscovib_response, only: response_options
  use viscovib_response_plan, only: method_newton, new_response_plan, response_plan_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_rows, n_series
  integer(c_int), intent(in) :: parameter, harmonics
  integer(c_int), intent(in) :: orders(n_series), max_points, with_stability, n_kept
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi), nu, start, finish
  real(c_double), intent(in) :: tolerance, max_step
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(out) :: n_points, ended, half_wave, n_folds, status
  real(c_double), intent(out) :: p(max_points), folds(max_points)
  integer(c_int), intent(out) :: iterations(max_points)
  complex(c_double_complex), intent(out) :: coefficients(n_kept, n_rows - 1, max_points)
  complex(c_double_complex), intent(out) :: fold_coefficients(n_kept, n_rows - 1, max_points)
  real(c_double), intent(out) :: matrices(2*n_rows - 2, 2*n_rows - 2, max_points)
  character(len=512), intent(out) :: message
  !f2py threadsafe
  class(oscillator_type), allocatable :: system
  type(load_type) :: load
  type(response_plan_type) :: plan
  type(balance_type) :: balance
  type(branch_options) :: options
  type(response_options) :: wanted
  type(branch_type) :: branch
  type(floquet_type) :: floquet
  type(status_type) :: outcome
  real(c_double) :: x(2*n_kept, n_rows - 1)
  integer :: i, d, found, iterations_made

  n_points = 0
  n_folds = 0
  half_wave = 0
  ended = -1
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    wanted = make_options(harmonics, tolerance, 100, 1.0_c_double, 0)
    wanted%keep_idle = .true.
    call new_response_plan(plan, system, load, [nu], method_newton, wanted, outcome)
  end if
  if (.not. outcome%failed()) then
    call new_balance(balance, system, plan%set)
    half_wave = merge(1, 0, plan%set%half_wave)
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
      call new_floquet(floquet, system, plan%set)
      do i = 1, n_points
        if (cancel(1) /= 0) exit
        call floquet%monodromy(system, merge(p(i), nu, parameter == parameter_frequency), &
                               branch%x(:, :, i), matrices(:, :, i))
      end do
    end if
  end if
  call report(outcome, status, message)
end subroutine mount_branch
