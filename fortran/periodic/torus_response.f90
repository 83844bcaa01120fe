!> Solutions of harmonic balance on a torus without an initial guess, and near known solutions.
module viscovib_torus_response
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, follow_curve
  use viscovib_curve_newton, only: solve_on_curve, surely_near
  use viscovib_kinds, only: wp
  use viscovib_outcomes, only: outcome_converged, outcome_stalled
  use viscovib_torus_balance, only: torus_balance_type, vary_factor
  use viscovib_torus_levels, only: few, many, new_levels, solve_on_levels, torus_levels
  implicit none
  private

  public :: near_levels, solve_from_rest, solve_near

  !> Largest number of points of a branch in the load if Newton's method fails.
  integer, parameter :: max_load_points = 300
  !> Largest number of unknowns for a full matrix, which takes half a second to factorize.
  integer, parameter :: most_dense = 2000

  !> Two levels for nearby solutions; largest number of unknowns of the inner one.
  type :: near_levels
    type(torus_levels) :: levels
    integer :: most = few
  end type near_levels

contains

  !> Solve at p from zero. With many unknowns the inner orders are solved first, and more of them if
  !! the outer orders then do not converge.
  subroutine solve_from_rest(balance, p, tolerance, x, outcome, iterations, cancel, near)
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, tolerance
    real(wp), intent(out) :: x(:)
    integer, intent(out) :: outcome
    integer, intent(inout) :: iterations
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    !> Receives the sufficient number of inner orders.
    type(near_levels), intent(inout), optional :: near
    type(torus_levels) :: levels
    real(wp), allocatable :: inner(:)
    integer :: most

    most = few
    x = 0.0_wp
    outcome = outcome_stalled
    do while (levels_pay(balance%n, most))
      call new_levels(levels, balance, most)
      if (.not. levels%ready) exit
      call levels%match(balance)
      inner = levels%within(balance, x)
      outcome = outcome_stalled
      if (most > few) call solve_on_curve(levels%inner, p, tolerance, inner, outcome, &
                                          iterations, cancel)
      if (outcome /= outcome_converged) then
        call raise_loads(levels%inner, p, tolerance, inner, outcome, iterations, cancel)
      end if
      if (outcome /= outcome_converged) exit
      x = levels%beyond(balance, inner)
      call solve_on_levels(levels, balance, p, tolerance, x, outcome, iterations, cancel)
      if (outcome == outcome_converged) then
        if (present(near)) near%most = most
        return
      end if
      most = 3*most
    end do
    if (balance%n > most_dense) return
    if (any(abs(x) > 0.0_wp)) then
      call solve_on_curve(balance, p, tolerance, x, outcome, iterations, cancel)
      if (outcome == outcome_converged) return
    end if
    call raise_loads(balance, p, tolerance, x, outcome, iterations, cancel)
  end subroutine solve_from_rest

  !> True if two levels with `most` inner unknowns are efficient for n unknowns.
  pure logical function levels_pay(n, most)
    integer, intent(in) :: n, most
    levels_pay = n > many .and. most < most_dense .and. (most == few .or. n > 2*most)
  end function levels_pay

  !> The solution on the curve that starts at zero without load, at the first point with the full
  !! load, through folds if necessary. If Newton's method from zero converges fast at once, its
  !! solution is that one.
  subroutine raise_loads(balance, p, tolerance, x, outcome, iterations, cancel)
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, tolerance
    real(wp), intent(out) :: x(:)
    integer, intent(out) :: outcome
    integer, intent(inout) :: iterations
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(curve_branch_type) :: branch
    real(wp) :: factor, lowest, second
    integer :: vary

    x = 0.0_wp
    call solve_on_curve(balance, p, tolerance, x, outcome, iterations, cancel, second)
    if (outcome == outcome_converged .and. second <= surely_near) return
    call balance%set_parameter(p)
    vary = balance%vary
    factor = balance%factor
    lowest = balance%lowest
    balance%vary = vary_factor
    balance%lowest = -huge(1.0_wp)
    call follow_curve(balance, curve_options(0.0_wp, factor, 1.0e-8_wp, max_load_points, 0.3_wp), &
                      spread(0.0_wp, 1, balance%n), branch, cancel=cancel)
    iterations = iterations + sum(branch%iterations(:branch%n_points))
    balance%vary = vary
    balance%factor = factor
    balance%lowest = lowest
    if (branch%outcome /= curve_completed) return
    x = branch%x(:, branch%n_points)
    call solve_on_curve(balance, p, tolerance, x, outcome, iterations, cancel)
  end subroutine raise_loads

  !> Solve from x, near a solution, with the last sufficient number of inner orders, or more.
  subroutine solve_near(balance, near, p, tolerance, x, outcome, iterations, cancel, part)
    type(torus_balance_type), intent(inout) :: balance
    !> Levels of this balance, or new ones.
    type(near_levels), intent(inout) :: near
    real(wp), intent(in) :: p, tolerance
    real(wp), intent(inout) :: x(:)
    integer, intent(out) :: outcome
    integer, intent(inout) :: iterations
    integer, intent(inout), optional :: cancel
    !> As in `solve_on_levels`; two levels are then also used for few unknowns.
    real(wp), intent(in), optional :: part

    outcome = outcome_stalled
    do while (levels_pay(balance%n, near%most) .or. (present(part) .and. near%most == few))
      if (.not. near%levels%ready) call new_levels(near%levels, balance, near%most)
      if (.not. near%levels%ready) exit
      call solve_on_levels(near%levels, balance, p, tolerance, x, outcome, iterations, cancel, part)
      if (outcome == outcome_converged) return
      near%levels%ready = .false.
      near%most = 3*near%most
    end do
    near%most = few
    if (balance%n > most_dense) return
    call solve_on_curve(balance, p, tolerance, x, outcome, iterations, cancel)
  end subroutine solve_near

end module viscovib_torus_response
