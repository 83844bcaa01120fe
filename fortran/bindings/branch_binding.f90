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
  use viscovib_curve_branch, only: curve_branch_type, curve_options, follow_curve
  use viscovib_floquet, only: floquet_type, new_floquet
  use viscovib_load, only: load_type
  use viscovib_newton_point, only: point_from_rest
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: new_oscillator_curve, oscillator_curve_type, vary_frequency
  use viscovib_outcomes, only: outcome_converged
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
  class(oscillator_type), allocatable, target :: system
  type(load_type), target :: load
  type(response_plan_type) :: plan
  type(oscillator_curve_type) :: curve
  type(curve_options) :: options
  type(curve_branch_type) :: branch
  type(floquet_type) :: floquet
  type(status_type) :: outcome
  real(c_double) :: x(2*n_kept, n_rows - 1)
  integer :: i, d, from, found, iterations_made

  n_points = 0
  n_folds = 0
  half_wave = 0
  ended = -1
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    call new_response_plan(plan, system, load, [nu], method_newton, &
                           make_options(harmonics, tolerance, 100, 1.0_c_double, 0), outcome)
  end if
  if (.not. outcome%failed()) then
    call new_oscillator_curve(curve, system, load, plan%set, parameter)
    half_wave = merge(1, 0, plan%set%half_wave)
    options = curve_options(start, finish, tolerance, max_points, max_step)
    x = 0.0_c_double
    found = outcome_converged
    iterations_made = 0
    if (parameter == vary_frequency) then
      call curve%balance%set_frequency(system, load, start)
      call point_from_rest(curve%balance, system, load, tolerance, x, found, iterations_made, &
                           cancel(1))
    else
      call curve%balance%set_frequency(system, load, nu)
      if (abs(start) > 0.0_c_double) then
        curve%balance%load_factor = start
        call point_from_rest(curve%balance, system, load, tolerance, x, found, iterations_made, &
                             cancel(1))
      end if
    end if
    if (found == outcome_converged) then
      call follow_curve(curve, options, reshape(x, [size(x)]), branch, cancel=cancel(1))
      n_points = branch%n_points
      ended = branch%outcome
      n_folds = branch%folds%n
      p(:n_points) = branch%parameter(:n_points)
      iterations(:n_points) = branch%iterations(:n_points)
      do d = 1, n_rows - 1
        from = 2*n_kept*(d - 1)
        coefficients(:, d, :n_points) = cmplx(branch%x(from + 1:from + 2*n_kept:2, :n_points), &
                                              branch%x(from + 2:from + 2*n_kept:2, :n_points), &
                                              c_double)
        fold_coefficients(:, d, :n_folds) = cmplx(branch%folds%x(from + 1:from + 2*n_kept:2, :), &
                                                  branch%folds%x(from + 2:from + 2*n_kept:2, :), &
                                                  c_double)
      end do
      folds(:n_folds) = branch%folds%p
    end if
    if (with_stability /= 0 .and. n_points > 0) then
      call new_floquet(floquet, system, plan%set)
      do i = 1, n_points
        if (cancel(1) /= 0) exit
        call floquet%monodromy(system, merge(p(i), nu, parameter == vary_frequency), &
                               reshape(branch%x(:, i), shape(x)), matrices(:, :, i))
      end do
    end if
  end if
  call report(outcome, status, message)
end subroutine mount_branch
