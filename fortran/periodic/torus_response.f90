!> Solutions of harmonic balance on a torus from nothing but the system, and at a row
!! of values of a parameter.
module viscovib_torus_response
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, follow_curve
  use viscovib_curve_newton, only: solve_on_curve
  use viscovib_kinds, only: wp
  use viscovib_outcomes, only: outcome_converged, outcome_stalled
  use viscovib_torus_balance, only: torus_balance_type, vary_factor
  use viscovib_torus_levels, only: few, many, new_levels, solve_on_levels, torus_levels
  implicit none
  private

  public :: solve_from_rest, torus_responses

  !> Points of a branch in the load where Newton fails at once.
  integer, parameter :: max_load_points = 300
  !> Unknowns up to which a matrix of all of them is made; its factors take half a second.
  integer, parameter :: most_dense = 2000

contains

  !> Solve at p from rest: with many unknowns for those of the inner orders first, and for
  !! more of them if the outer ones then do not follow.
  subroutine solve_from_rest(balance, p, tolerance, x, outcome, iterations, cancel)
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, tolerance
    real(wp), intent(out) :: x(:)
    integer, intent(out) :: outcome
    integer, intent(inout) :: iterations
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile, optional :: cancel
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
      if (outcome == outcome_converged) return
      most = 3*most
    end do
    if (balance%n > most_dense) return
    if (any(abs(x) > 0.0_wp)) then
      call solve_on_curve(balance, p, tolerance, x, outcome, iterations, cancel)
      if (outcome == outcome_converged) return
    end if
    call raise_loads(balance, p, tolerance, x, outcome, iterations, cancel)
  end subroutine solve_from_rest

  !> Whether n unknowns are too many for what so many inner ones save.
  pure logical function levels_pay(n, most)
    integer, intent(in) :: n, most
    levels_pay = n > many .and. most < most_dense .and. (most == few .or. n > 2*most)
  end function levels_pay

  !> From rest at once, or, where that is too far away, by following the branch
  !! from no load to the whole, through folds if need be.
  subroutine raise_loads(balance, p, tolerance, x, outcome, iterations, cancel)
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, tolerance
    real(wp), intent(out) :: x(:)
    integer, intent(out) :: outcome
    integer, intent(inout) :: iterations
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile, optional :: cancel
    type(curve_branch_type) :: branch
    real(wp) :: factor, lowest
    integer :: vary

    x = 0.0_wp
    call solve_on_curve(balance, p, tolerance, x, outcome, iterations, cancel)
    if (outcome == outcome_converged) return
    call balance%set_parameter(p)
    vary = balance%vary
    factor = balance%factor
    lowest = balance%lowest
    balance%vary = vary_factor
    balance%lowest = -huge(1.0_wp)
    x = 0.0_wp
    call follow_curve(balance, curve_options(0.0_wp, factor, 1.0e-8_wp, max_load_points, 0.3_wp), &
                      x, branch, cancel=cancel)
    iterations = iterations + sum(branch%iterations(:branch%n_points))
    balance%vary = vary
    balance%factor = factor
    balance%lowest = lowest
    if (branch%outcome /= curve_completed) return
    x = branch%x(:, branch%n_points)
    call solve_on_curve(balance, p, tolerance, x, outcome, iterations, cancel)
  end subroutine raise_loads

  !> Each value starts from the ones before, else from rest; the first may have
  !! a guess.
  subroutine torus_responses(balance, p, tolerance, guess, x, outcome, iterations, cancel)
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p(:), tolerance
    !> Where the first value starts, laid out as x; from rest if 0.
    real(wp), intent(in) :: guess(:)
    !> Unknowns, those left out as 0, shape (torus%n n_dof, size(p)); 0 where no
    !! solution was found.
    real(wp), intent(out) :: x(:, :)
    integer, intent(out) :: outcome(:), iterations(:)
    integer, intent(inout), volatile, optional :: cancel
    integer :: i, known
    real(wp) :: last_p, before_p
    real(wp), allocatable :: here(:), last(:), before(:)
    type(torus_levels) :: levels
    integer :: most

    most = 0
    known = 0
    iterations = 0
    outcome = -1
    x = 0.0_wp
    last_p = 0.0_wp
    before_p = 0.0_wp
    allocate (here(balance%n), last(balance%n), before(balance%n), source=0.0_wp)
    do i = 1, size(p)
      if (present(cancel)) then
        if (cancel /= 0) return
      end if
      if (known >= 2) then
        here = last + (last - before)*((p(i) - last_p)/(last_p - before_p))
        call solve_near(here, i)
      end if
      if (i == 1 .and. any(abs(guess) > 0.0_wp)) then
        here = balance%reduced(guess)
        call solve_near(here, i)
      end if
      if (outcome(i) /= outcome_converged .and. known >= 1) then
        here = last
        call solve_near(here, i)
      end if
      if (outcome(i) /= outcome_converged) then
        known = 0
        call solve_from_rest(balance, p(i), tolerance, here, outcome(i), iterations(i), cancel)
      end if
      if (outcome(i) /= outcome_converged) cycle
      x(:, i) = reshape(balance%expanded(here), [size(x, 1)])
      ! Equal values give no direction.
      if (known > 0 .and. .not. abs(p(i) - last_p) > 0.0_wp) known = 0
      before = last
      before_p = last_p
      last = here
      last_p = p(i)
      known = known + 1
    end do

  contains

    !> The inner orders that sufficed last, or more.
    subroutine solve_near(start, i)
      real(wp), intent(inout) :: start(:)
      integer, intent(in) :: i
      do
        if (.not. levels%ready) then
          most = max(few, 3*most)
          if (.not. levels_pay(balance%n, most)) exit
          call new_levels(levels, balance, most)
          if (.not. levels%ready) exit
        end if
        call solve_on_levels(levels, balance, p(i), tolerance, start, outcome(i), iterations(i), &
                             cancel)
        if (outcome(i) == outcome_converged) return
        levels%ready = .false.
      end do
      most = 0
      if (balance%n > most_dense) return
      call solve_on_curve(balance, p(i), tolerance, start, outcome(i), iterations(i), cancel)
    end subroutine solve_near

  end subroutine torus_responses

end module viscovib_torus_response
