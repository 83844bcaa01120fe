! Flat routines over periodic and quasi-periodic solutions of the pendulum, for f2py.
! Orders, unknowns and drives as in torus and torus_balance.

!> Solutions at the values p of what varies (vary: 1 a base frequency, 2 an
!! amplitude; which: of which axis or drive), with orders to |k_1| + ... = first, or to as
!! many as the tolerance needs, to `last`; `step` more shells, whose orders are given too,
!! judge them (0: no judgement). With a duration > 0 for stability: Floquet multipliers, NaN
!! where unknown, and how many are outside the unit circle (-1: unknown) if there is one axis,
!! else rates of growth. kept is 1 where an order of a coordinate is an unknown. x is laid out
!! for the n_unknowns of the bound `last`.
subroutine pendulum_balance(flat, orders, n_axes, n_orders, kept, drive_orders, omega, amplitude, &
                            vary, which, p, n_p, tolerance, duration, first, last, step, guess, &
                            cancel, n_unknowns, x, outcome, iterations, highest, truncation, &
                            error, multipliers, growing, rates, rates_off, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_orbit_stability, only: judge_orbits, orbit_circle
  use viscovib_outcomes, only: outcome_converged
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  use viscovib_stopping, only: is_set
  use viscovib_torus_growth, only: growth_rates
  use viscovib_torus_orders, only: new_ladder, torus_ladder, torus_responses
  implicit none
  integer(c_int), intent(in) :: n_axes, n_orders, n_p, n_unknowns, first, last, step
  integer(c_int), intent(in) :: orders(n_axes, n_orders), drive_orders(n_axes, 3), vary, which
  integer(c_int), intent(in) :: kept(n_orders, 3)
  real(c_double), intent(in) :: flat(14), omega(n_axes), amplitude(3), p(n_p), tolerance, duration
  !> Where the first row starts, as x; from rest if 0.
  real(c_double), intent(in) :: guess(n_unknowns)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  real(c_double), intent(out) :: x(n_unknowns, n_p), truncation(n_p), rates(6, n_p)
  !> What the last correction and rounding leave, against the largest unknown.
  real(c_double), intent(out) :: error(n_p)
  !> Estimated errors of the rates.
  real(c_double), intent(out) :: rates_off(6, n_p)
  complex(c_double_complex), intent(out) :: multipliers(6, n_p)
  integer(c_int), intent(out) :: outcome(n_p), iterations(n_p), highest(n_p), growing(n_p), status
  !f2py threadsafe
  type(pendulum_type), target :: system
  type(torus_ladder) :: ladder
  type(orbit_floquet_type) :: floquet
  type(status_type) :: problem
  real(c_double), allocatable :: y(:)
  logical :: inside
  integer :: i, top

  x = 0.0_c_double
  multipliers = (0.0_c_double, 0.0_c_double)
  growing = -1
  rates = 0.0_c_double
  rates_off = 0.0_c_double
  outcome = -1
  iterations = 0
  highest = 0
  truncation = 0.0_c_double
  error = 0.0_c_double
  call make_pendulum(system, flat, problem)
  if (.not. problem%failed()) then
    call new_ladder(ladder, system, orders, kept /= 0, drive_orders, omega, amplitude, vary, &
                    which, first, last, step)
    call torus_responses(ladder, p, tolerance, guess, x, outcome, iterations, highest, truncation, &
                         error, problem, cancel(1))
  end if
  top = maxval(highest)
  if (duration > 0.0_c_double .and. top > 0) then
    associate (balance => ladder%rungs(top)%balance)
      do i = 1, n_p
        if (outcome(i) /= outcome_converged .or. is_set(cancel(1))) cycle
        y = ladder%cropped(top, x(:, i))
        if (n_axes == 1) then
          call judge_orbits(floquet, balance, p(i:i), reshape(y, [size(y), 1]), multipliers(:, i:i))
          growing(i) = count_larger(multipliers(:, i), orbit_circle)
        else
          call balance%visit(y, p(i), .true., inside)
          call growth_rates(balance, y, duration, rates(:, i), rates_off(:, i), cancel(1))
        end if
      end do
    end associate
  end if
  call report(problem, status)
end subroutine pendulum_balance

!> Estimated truncation of the points (x, p) of a branch, the worst of them, found with orders
!! to `bound`, the bound (to `most`) that would bring it below the tolerance, and how far orders
!! left out move its first n_folds folds, of which `fold_before` are the points before, from 1.
!! Arguments as above.
subroutine pendulum_truncation(flat, orders, n_axes, n_orders, kept, drive_orders, omega, &
                               amplitude, vary, which, p, n_p, x, n_unknowns, n_folds, fold_p, &
                               n_room, fold_x, fold_before, tolerance, bound, step, most, cancel, &
                               truncation, next, moved, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_order_rules, only: better_bound
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  use viscovib_torus_orders, only: branch_truncation, fold_truncation, new_ladder, torus_ladder
  implicit none
  integer(c_int), intent(in) :: n_axes, n_orders, n_p, n_unknowns, bound, step, most
  integer(c_int), intent(in) :: n_folds, n_room, fold_before(n_room)
  integer(c_int), intent(in) :: orders(n_axes, n_orders), drive_orders(n_axes, 3), vary, which
  integer(c_int), intent(in) :: kept(n_orders, 3)
  real(c_double), intent(in) :: flat(14), omega(n_axes), amplitude(3), p(n_p), tolerance
  real(c_double), intent(in) :: x(n_unknowns, n_p), fold_p(n_room), fold_x(n_unknowns, n_room)
  integer(c_int), intent(inout) :: cancel(1)
  real(c_double), intent(out) :: truncation, moved(n_room)
  integer(c_int), intent(out) :: next, status
  !f2py threadsafe
  type(pendulum_type), target :: system
  type(torus_ladder) :: ladder
  type(status_type) :: problem

  truncation = 0.0_c_double
  moved = 0.0_c_double
  next = bound
  call make_pendulum(system, flat, problem)
  if (.not. problem%failed()) then
    call new_ladder(ladder, system, orders, kept /= 0, drive_orders, omega, amplitude, vary, &
                    which, bound, bound, step)
    call branch_truncation(ladder, p, x, tolerance, truncation, problem, cancel(1))
    if (truncation > tolerance) next = better_bound(bound, truncation, tolerance, step, most)
    if (.not. problem%failed()) then
      call fold_truncation(ladder, p, x, fold_p(:n_folds), fold_x(:, :n_folds), &
                           fold_before(:n_folds), moved(:n_folds), problem, cancel(1))
    end if
  end if
  call report(problem, status)
end subroutine pendulum_truncation

!> How far off the branch points and crossings of a branch are, found with orders to `bound`, by
!! `step` more shells; points before them, from 1. Arguments as above.
subroutine pendulum_place_errors(flat, orders, n_axes, n_orders, kept, drive_orders, omega, &
                                 amplitude, vary, which, p, n_p, x, n_unknowns, n_room, &
                                 n_branch_points, branch_p, branch_x, branch_before, n_crossings, &
                                 crossing_p, crossing_x, crossing_before, turn, known, bound, &
                                 step, cancel, branch_errors, crossing_errors, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_orbit_errors, only: find_branch_errors, find_crossing_errors
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  use viscovib_torus_orders, only: new_ladder, torus_ladder
  implicit none
  integer(c_int), intent(in) :: n_axes, n_orders, n_p, n_unknowns, n_room, bound, step
  integer(c_int), intent(in) :: n_branch_points, branch_before(n_room)
  integer(c_int), intent(in) :: n_crossings, crossing_before(n_room)
  integer(c_int), intent(in) :: orders(n_axes, n_orders), drive_orders(n_axes, 3), vary, which
  integer(c_int), intent(in) :: kept(n_orders, 3)
  real(c_double), intent(in) :: flat(14), omega(n_axes), amplitude(3), p(n_p)
  real(c_double), intent(in) :: x(n_unknowns, n_p)
  real(c_double), intent(in) :: branch_p(n_room), branch_x(n_unknowns, n_room)
  real(c_double), intent(in) :: crossing_p(n_room), crossing_x(n_unknowns, n_room)
  !> Angles of the multipliers that cross, and errors where these are known, else -1.
  real(c_double), intent(in) :: turn(n_room), known(n_room)
  integer(c_int), intent(inout) :: cancel(1)
  real(c_double), intent(out) :: branch_errors(n_room), crossing_errors(n_room)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  type(pendulum_type), target :: system
  type(torus_ladder) :: ladder
  type(status_type) :: problem

  branch_errors = 0.0_c_double
  crossing_errors = known
  call make_pendulum(system, flat, problem)
  if (.not. problem%failed()) then
    call new_ladder(ladder, system, orders, kept /= 0, drive_orders, omega, amplitude, vary, &
                    which, bound, bound, step)
    associate (n => n_branch_points, m => n_crossings)
      call find_branch_errors(ladder, p, x, branch_p(:n), branch_x(:, :n), branch_before(:n), &
                              branch_errors(:n), problem, cancel(1))
      if (.not. problem%failed()) then
        call find_crossing_errors(ladder, p, x, crossing_p(:m), crossing_x(:, :m), &
                                  crossing_before(:m), turn(:m), crossing_errors(:m), problem, &
                                  cancel(1))
      end if
    end associate
  end if
  call report(problem, status)
end subroutine pendulum_place_errors

!> A branch from p = start to p = finish. With leave = 1 it begins at the point
!! (begin, begin_p) in the direction `along`, with 0 at a solution found at p = start.
!! Stability and `kept` as above.
subroutine pendulum_branch(flat, orders, n_axes, n_orders, kept, drive_orders, omega, &
                           amplitude, vary, which, curve_packed, n_packed, max_points, &
                           duration, leave, begin, begin_p, along, n_unknowns, max_special, &
                           cancel, n_points, ended, p, iterations, error, off, x, is_stop, &
                           multipliers, growing, rates, rates_off, n_folds, folds, fold_errors, &
                           fold_before, fold_x, n_branch_points, &
                           branch_points, branch_point_x, across, branch_before, n_crossings, &
                           kinds, before, crossings, crossing_errors, turns, crossing_x, status)
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_crossings, only: crossing_type
  use viscovib_curve_branch, only: curve_branch_type, curve_options, curve_options_from, &
    follow_curve
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_orbit_stability, only: find_orbit_crossings, judge_orbits, orbit_circle
  use viscovib_outcomes, only: outcome_converged
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  use viscovib_stopping, only: is_set
  use viscovib_torus, only: new_torus, torus_type
  use viscovib_torus_balance, only: new_torus_balance, torus_balance_type, vary_frequency
  use viscovib_torus_growth, only: growth_rates
  use viscovib_torus_response, only: solve_from_rest
  implicit none
  integer(c_int), intent(in) :: n_axes, n_orders, n_unknowns, max_points, max_special, n_packed
  integer(c_int), intent(in) :: orders(n_axes, n_orders), drive_orders(n_axes, 3), vary, which
  integer(c_int), intent(in) :: kept(n_orders, 3), leave
  real(c_double), intent(in) :: flat(14), omega(n_axes), amplitude(3)
  real(c_double), intent(in) :: duration, curve_packed(n_packed)
  real(c_double), intent(in) :: begin(n_unknowns), begin_p, along(n_unknowns + 1)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(out) :: n_points, ended, iterations(max_points), n_folds
  !> 1 where a point lies at one of the stops.
  integer(c_int), intent(out) :: is_stop(max_points)
  real(c_double), intent(out) :: p(max_points), x(n_unknowns, max_points)
  !> What the last correction and rounding leave, at the value of p and off the curve.
  real(c_double), intent(out) :: error(max_points), off(max_points)
  complex(c_double_complex), intent(out) :: multipliers(6, max_points)
  integer(c_int), intent(out) :: growing(max_points)
  real(c_double), intent(out) :: rates(6, max_points), rates_off(6, max_points)
  !> Errors of folds are those of rounding; points before them from 1.
  real(c_double), intent(out) :: folds(max_special), fold_errors(max_special)
  integer(c_int), intent(out) :: fold_before(max_special)
  real(c_double), intent(out) :: fold_x(n_unknowns, max_special), branch_points(max_special)
  real(c_double), intent(out) :: branch_point_x(n_unknowns, max_special)
  real(c_double), intent(out) :: across(n_unknowns + 1, max_special)
  integer(c_int), intent(out) :: branch_before(max_special), n_branch_points
  !> Changes of stability, of which the first max_special are given: kinds of
  !! `viscovib_crossings`, points before (from 1), and where: NaN if not located. Errors of folds
  !! are those of rounding, of other places -1; angles of the multipliers that cross.
  integer(c_int), intent(out) :: n_crossings, kinds(max_special), before(max_special), status
  real(c_double), intent(out) :: crossings(max_special), crossing_errors(max_special)
  real(c_double), intent(out) :: turns(max_special), crossing_x(n_unknowns, max_special)
  !f2py threadsafe
  ! Room for all points is not zeroed: that would take seconds, deaf to Ctrl-C.
  !f2py intent(out, cache) x
  type(pendulum_type), target :: system
  type(torus_type) :: torus
  type(torus_balance_type) :: balance
  type(curve_options) :: options
  type(curve_branch_type) :: branch
  type(orbit_floquet_type) :: floquet
  type(crossing_type), allocatable :: changes(:)
  type(status_type) :: problem
  real(c_double), allocatable :: at(:)
  logical :: inside
  integer :: i, found, made

  n_points = 0
  n_folds = 0
  n_branch_points = 0
  ended = -1
  p = 0.0_c_double
  x = 0.0_c_double
  iterations = 0
  is_stop = 0
  multipliers = (0.0_c_double, 0.0_c_double)
  growing = -1
  rates = 0.0_c_double
  rates_off = 0.0_c_double
  n_crossings = 0
  folds = 0.0_c_double
  fold_errors = 0.0_c_double
  fold_before = 0
  error = 0.0_c_double
  off = 0.0_c_double
  fold_x = 0.0_c_double
  branch_points = 0.0_c_double
  branch_point_x = 0.0_c_double
  across = 0.0_c_double
  call make_pendulum(system, flat, problem)
  if (.not. problem%failed()) call new_torus(torus, orders, problem)
  if (.not. problem%failed()) then
    call new_torus_balance(balance, system, torus, drive_orders, omega, amplitude, kept /= 0)
    balance%vary = vary
    balance%which = which
    if (vary == vary_frequency) balance%lowest = 0.0_c_double
    options = curve_options_from(curve_packed)
    found = outcome_converged
    allocate (at(balance%n))
    if (leave == 0) then
      made = 0
      call solve_from_rest(balance, options%start, options%tolerance, at, found, made, cancel(1))
      if (found == outcome_converged) then
        call follow_curve(balance, options, at, branch, cancel=cancel(1))
      end if
    else
      call follow_curve(balance, options, balance%reduced(begin), branch, begin_p, &
                        [balance%reduced(along(:n_unknowns)), along(n_unknowns + 1)], cancel(1))
    end if
    if (found == outcome_converged) then
      n_points = branch%n_points
      ended = branch%outcome
      p(:n_points) = branch%parameter(:n_points)
      iterations(:n_points) = branch%iterations(:n_points)
      error(:n_points) = branch%error(:n_points)
      off(:n_points) = branch%off(:n_points)
      is_stop(branch%stops) = 1
      call expand(branch%x, n_points, x)
      n_folds = min(branch%folds%n, max_special)
      folds(:n_folds) = branch%folds%p(:n_folds)
      fold_errors(:n_folds) = branch%folds%error(:n_folds)
      fold_before(:n_folds) = branch%folds%before(:n_folds)
      call expand(branch%folds%x, n_folds, fold_x)
      n_branch_points = min(branch%branch_points%n, max_special)
      branch_points(:n_branch_points) = branch%branch_points%p(:n_branch_points)
      call expand(branch%branch_points%x, n_branch_points, branch_point_x)
      call expand(branch%branch_points%across, n_branch_points, across)
      across(n_unknowns + 1, :n_branch_points) &
        = branch%branch_points%across(balance%n + 1, :n_branch_points)
      branch_before(:n_branch_points) = branch%branch_points%before(:n_branch_points)
    end if
    if (duration > 0.0_c_double .and. n_axes == 1) then
      call judge_orbits(floquet, balance, p(:n_points), branch%x(:, :n_points), &
                        multipliers(:, :n_points), cancel(1))
      growing(:n_points) = [(count_larger(multipliers(:, i), orbit_circle), i=1, n_points)]
      call find_orbit_crossings(floquet, balance, p(:n_points), &
                                branch%x(:, :n_points), multipliers(:, :n_points), branch%folds, &
                                branch%branch_points, changes, cancel(1))
      n_crossings = size(changes)
      found = min(n_crossings, max_special)
      kinds(:found) = changes(:found)%kind
      before(:found) = changes(:found)%before
      crossings(:found) = merge(changes(:found)%p, ieee_value(0.0_c_double, ieee_quiet_nan), &
                                changes(:found)%located)
      crossing_errors(:found) = changes(:found)%error
      turns(:found) = aimag(changes(:found)%eta)
      do i = 1, found
        if (.not. changes(i)%located) cycle
        crossing_x(:, i) = reshape(balance%expanded(changes(i)%x), [n_unknowns])
      end do
    else if (duration > 0.0_c_double) then
      do i = 1, n_points
        if (is_set(cancel(1))) exit
        call balance%visit(branch%x(:, i), p(i), .true., inside)
        call growth_rates(balance, branch%x(:, i), duration, rates(:, i), rates_off(:, i), &
                          cancel(1))
      end do
    end if
  end if
  call report(problem, status)

contains

  !> The first m solutions in full.
  subroutine expand(from, m, to)
    real(c_double), intent(in) :: from(:, :)
    integer, intent(in) :: m
    real(c_double), intent(inout) :: to(:, :)
    integer :: j
    do j = 1, m
      to(:n_unknowns, j) = reshape(balance%expanded(from(:balance%n, j)), [n_unknowns])
    end do
  end subroutine expand

end subroutine pendulum_branch
