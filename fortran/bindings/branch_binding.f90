! Flat routines over branches of periodic solutions, for f2py. System and load
! are given as in mount_binding.

!> A branch with the options packed for `curve_options_from`, p being the frequency
!! (parameter = 1) or, at the frequency nu, the factor of the load (2) or the number by which the
!! system's are flat + p direction(:n_flat) + p^2 direction(n_flat + 1:) + ... (3; else
!! `direction` does nothing). n_kept as the plan
!! says, of which n_used are used if orders are chosen at each point (harmonics = 0); with
!! symmetric = 0 the mean
!! and even orders are kept though odd ones would do. With leave = 1 it begins at the point
!! (begin, begin_p) in the direction `along`, or, if that is 0, at a motion near it; with 0 at a
!! solution found at p = start.
!! Stability is judged if n_judged is max_points, not 0.
subroutine mount_branch(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, orders, &
                        series, n_rows, n_series, parameter, direction, n_direction, nu, &
                        curve_packed, n_packed, harmonics, symmetric, max_points, &
                        leave, begin, begin_p, along, n_unknowns, n_judged, n_kept, max_special, &
                        cancel, n_points, ended, n_used, p, iterations, error, off, kept, &
                        truncation, missed, coefficients, is_stop, n_folds, &
                        folds, fold_errors, fold_coefficients, fold_coefficient_errors, &
                        n_branch_points, branch_points, &
                        branch_errors, branch_point_x, across, branch_before, stable, growing, &
                        multipliers, exponents, n_crossings, kinds, before, crossings, &
                        crossing_errors, crossing_coefficients, allowed, status)
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: fill_stability, make_load, make_options, make_system, report, &
    to_complex
  use viscovib_crossings, only: crossing_type, find_crossings
  use viscovib_curve_branch, only: curve_branch_type, curve_options, curve_options_from
  use viscovib_family_curve, only: judge_systems, new_family_curve, new_plain_curve, &
    system_builder
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_load, only: load_type
  use viscovib_motion_stability, only: judge_type, new_judge, stability_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: oscillator_curve_type, vary_frequency, vary_load
  use viscovib_outcomes, only: outcome_converged
  use viscovib_response, only: response_options
  use viscovib_response_branch, only: departure_type, follow_response
  use viscovib_response_plan, only: method_newton, new_response_plan, response_plan_type
  use viscovib_sized_curve, only: refitted
  use viscovib_status, only: status_type
  use viscovib_truncated_stability, only: doubt_curve
  use viscovib_vector_builder, only: vector_at, vector_builder
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_rows, n_series, n_direction
  integer(c_int), intent(in) :: parameter, harmonics, symmetric, n_packed, leave, n_unknowns
  integer(c_int), intent(in) :: orders(n_series), max_points, n_judged, n_kept, max_special
  real(c_double), intent(in) :: flat(n_flat), direction(n_direction), data_x(n_x)
  real(c_double), intent(in) :: nu, curve_packed(n_packed)
  real(c_double), intent(in) :: begin(n_unknowns), begin_p, along(n_unknowns + 1)
  real(c_double), intent(in) :: data_phi(n_phi)
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(out) :: n_points, ended, n_used, n_folds, n_branch_points, status
  real(c_double), intent(out) :: p(max_points)
  integer(c_int), intent(out) :: iterations(max_points), is_stop(max_points)
  !> What the last correction and rounding leave, relative to each motion.
  real(c_double), intent(out) :: error(max_points), off(max_points)
  !> How many orders each point keeps, and the estimated relative error of leaving out the
  !! others.
  integer(c_int), intent(out) :: kept(max_points)
  real(c_double), intent(out) :: truncation(max_points)
  !> How far that is off the curve.
  real(c_double), intent(out) :: missed(max_points)
  !> Relative error that was allowed.
  real(c_double), intent(out) :: allowed(max_points)
  complex(c_double_complex), intent(out) :: coefficients(n_kept, n_rows - 1, max_points)
  !> Of special points, at most max_special of a kind.
  real(c_double), intent(out) :: folds(max_special), fold_errors(max_special)
  real(c_double), intent(out) :: branch_points(max_special), branch_errors(max_special)
  complex(c_double_complex), intent(out) :: fold_coefficients(n_kept, n_rows - 1, max_special)
  real(c_double), intent(out) :: fold_coefficient_errors(max_special)
  real(c_double), intent(out) :: branch_point_x(n_unknowns, max_special)
  real(c_double), intent(out) :: across(n_unknowns + 1, max_special)
  integer(c_int), intent(out) :: branch_before(max_special)
  !> As in `stability_type`, NaN where there are none.
  integer(c_int), intent(out) :: stable(n_judged), growing(n_judged)
  complex(c_double_complex), intent(out) :: multipliers(2*n_rows + 2, n_judged)
  complex(c_double_complex), intent(out) :: exponents(2*n_rows + 2, n_judged)
  !> How many there are, of which the first max_special are given: kinds of
  !! `viscovib_crossings`, points before (from 1), and where, NaN if not located, with errors.
  integer(c_int), intent(out) :: n_crossings, kinds(max_special), before(max_special)
  real(c_double), intent(out) :: crossings(max_special), crossing_errors(max_special)
  complex(c_double_complex), intent(out) :: &
    crossing_coefficients(n_kept, n_rows - 1, max_special)
  !f2py threadsafe
  ! Room for all points is not zeroed: that would take seconds, deaf to Ctrl-C.
  !f2py intent(out, cache) coefficients, multipliers, exponents
  class(oscillator_type), allocatable, target :: system
  type(load_type), target :: load
  type(response_options) :: wanted
  type(response_plan_type) :: plan
  class(oscillator_curve_type), allocatable :: curve
  class(system_builder), allocatable :: builder
  type(curve_options) :: options
  type(curve_branch_type) :: branch
  type(judge_type) :: judge
  type(stability_type) :: stability
  type(crossing_type), allocatable :: found_crossings(:)
  type(status_type) :: outcome
  type(harmonic_set_type) :: set
  real(c_double), allocatable :: motions(:, :, :)
  real(c_double), allocatable :: vector(:)
  integer :: i, j, found
  logical :: varied

  n_points = 0
  n_used = 0
  n_folds = 0
  n_branch_points = 0
  n_crossings = 0
  ended = -1
  options = curve_options_from(curve_packed)
  varied = parameter > vary_load
  vector = flat
  if (varied) vector = vector_at(flat, direction, options%start)
  call make_system(system, vector, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    wanted = make_options(harmonics, [options%tolerance, options%atol], 100, 1.0_c_double, 0)
    wanted%keep_idle = .true.
    wanted%symmetric = symmetric /= 0
    call new_response_plan(plan, system, load, [nu], method_newton, wanted, outcome)
  end if
  if (.not. outcome%failed()) then
    if (.not. varied) then
      call new_plain_curve(curve, system, load, plan%set, parameter, nu)
    else
      allocate (builder, source=vector_builder(flat, direction, data_x, data_phi, kind_x, kind_phi))
      call new_family_curve(curve, builder, options%start, &
                            max(abs(options%start), abs(options%finish)), load, plan%set, nu, &
                            outcome)
    end if
  end if
  if (.not. outcome%failed()) then
    if (leave /= 0) then
      call follow_response(curve, plan, options, branch, set, found, &
                           departure_type(begin, along, begin_p), cancel(1))
    else
      if (parameter == vary_load) curve%balance%load_factor = options%start
      call follow_response(curve, plan, options, branch, set, found, cancel=cancel(1))
    end if
    n_used = size(set%orders)
    if (found == outcome_converged) then
      n_points = branch%n_points
      kept(:n_points) = branch%kept(:n_points)/(2*(n_rows - 1))
      truncation(:n_points) = branch%truncation(:n_points)
      missed(:n_points) = branch%missed(:n_points)
      allowed(:n_points) = branch%allowed
      ended = branch%outcome
      p(:n_points) = branch%parameter(:n_points)
      iterations(:n_points) = branch%iterations(:n_points)
      error(:n_points) = branch%error(:n_points)
      off(:n_points) = branch%off(:n_points)
      call to_complex(branch%x(:, :n_points), coefficients(:n_used, :, :n_points))
      is_stop = 0
      is_stop(branch%stops) = 1
      n_folds = min(branch%folds%n, max_special)
      folds(:n_folds) = branch%folds%p(:n_folds)
      fold_errors(:n_folds) = branch%folds%error(:n_folds)
      fold_coefficient_errors(:n_folds) = branch%folds%error_x(:n_folds)
      call to_complex(branch%folds%x(:, :n_folds), fold_coefficients(:n_used, :, :n_folds))
      n_branch_points = min(branch%branch_points%n, max_special)
      associate (n => n_branch_points)
        branch_points(:n) = branch%branch_points%p(:n)
        branch_errors(:n) = branch%branch_points%error(:n)
        do i = 1, n
          j = size(branch%branch_points%x, 1)
          branch_point_x(:, i) = refitted(curve%blocks, branch%branch_points%x(:, i), n_unknowns)
          across(:, i) = [refitted(curve%blocks, branch%branch_points%across(:j, i), n_unknowns), &
                          branch%branch_points%across(j + 1, i)]
        end do
        branch_before(:n) = branch%branch_points%before(:n)
      end associate
    end if
    if (n_judged > 0 .and. n_points > 0) then
      call new_judge(judge, system, set)
      motions = reshape(branch%x(:, :n_points), [2*n_used, n_rows - 1, n_points])
      if (varied) then
        call judge_systems(judge, curve, nu, p(:n_points), motions, stability, cancel(1))
      else
        call judge%judge(system, [(merge(p(i), nu, parameter == vary_frequency), i=1, n_points)], &
                         motions, stability, cancel(1))
      end if
      call find_crossings(judge, curve, nu, p(:n_points), branch%x(:, :n_points), stability, &
                          branch%folds, branch%branch_points, found_crossings, cancel(1))
      call doubt_curve(judge, curve, nu, p(:n_points), motions, branch%missed(:n_points), &
                       branch%allowed, stability, cancel(1))
      call fill_stability(stability, stable, multipliers, exponents)
      growing(:n_points) = stability%n_growing
      n_crossings = size(found_crossings)
      j = min(n_crossings, max_special)
      kinds(:j) = found_crossings(:j)%kind
      before(:j) = found_crossings(:j)%before
      crossings(:j) = merge(found_crossings(:j)%p, ieee_value(0.0_c_double, ieee_quiet_nan), &
                            found_crossings(:j)%located)
      crossing_errors(:j) = found_crossings(:j)%error
      do i = 1, j
        if (.not. found_crossings(i)%located) cycle
        call to_complex(reshape(found_crossings(i)%x, [size(branch%x, 1), 1]), &
                        crossing_coefficients(:n_used, :, i:i))
      end do
    end if
  end if
  call report(outcome, status)

end subroutine mount_branch

!> The words for how curves end, between commas.
subroutine curve_words(endings)
  use viscovib_curve_branch, only: curve_outcomes
  implicit none
  character(len=512), intent(out) :: endings
  integer :: i

  endings = ''
  do i = lbound(curve_outcomes, 1), ubound(curve_outcomes, 1)
    endings = trim(endings)//trim(curve_outcomes(i))//','
  end do
end subroutine curve_words
