!> One solution of the equations of a curve at a fixed parameter, by Newton's method. The factors
!! are kept while corrections shrink fast.
module viscovib_curve_newton
  use viscovib_block_factors, only: factorize_blocks
  use viscovib_curve, only: curve_type
  use viscovib_dense, only: solve
  use viscovib_kinds, only: wp
  use viscovib_outcomes, only: outcome_converged, outcome_diverged, outcome_overflow, &
    outcome_singular, outcome_stalled
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: solve_on_curve

  !> Newton's method converges within a few iterations or not at all.
  integer, parameter :: max_iterations = 25
  !> With the factors kept, each correction must shrink by the first factor. The target for the
  !! remaining error is the second factor times the tolerance.
  real(wp), parameter :: fast_enough = 0.1_wp, far_below = 1.0e-4_wp
  !> A correction this much larger than the smallest so far means divergence.
  real(wp), parameter :: growth_limit = 1.0e4_wp
  real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp)
  !> If the second correction of Newton's method is at most this fraction of the first, a solution
  !! is near, with a margin to the theorem of Kantorovich.
  real(wp), parameter, public :: surely_near = 0.1_wp

contains

  !> Solve from the initial guess x; x is unchanged unless the outcome is converged. Leaving the
  !! range of the equations counts as diverged.
  subroutine solve_on_curve(curve, p, tolerance, x, outcome, iterations, cancel, second)
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p
    !> Tolerance: largest component of the last correction, relative to the largest component of x.
    real(wp), intent(in) :: tolerance
    !> Shape (n).
    real(wp), intent(inout) :: x(:)
    integer, intent(out) :: outcome
    !> Iterations are added to it.
    integer, intent(inout) :: iterations
    !> May be set by another thread to cancel the solution, with outcome stalled.
    integer, intent(inout), optional :: cancel
    !> The second correction relative to the first; 0 if there is none.
    real(wp), intent(out), optional :: second
    real(wp), allocatable :: new(:), step(:), slope(:), jacobian(:, :)
    integer, allocatable :: pivots(:)
    real(wp) :: change, before, smallest, norm
    integer :: k
    logical :: singular, inside, fresh

    allocate (jacobian(curve%n, curve%n), step(curve%n), slope(curve%n), pivots(curve%n))
    allocate (new, source=x)
    smallest = sqrt(huge(1.0_wp))
    before = 0.0_wp
    fresh = .true.
    outcome = outcome_stalled
    if (present(second)) second = 0.0_wp
    do k = 1, max_iterations
      if (is_set(cancel)) return
      if (fresh) then
        call curve%equations(new, p, step, jacobian, slope, inside)
      else
        call curve%residual(new, p, step, inside)
      end if
      if (.not. inside) then
        outcome = outcome_diverged
        return
      end if
      if (fresh) then
        call factorize_blocks(curve%n, jacobian, pivots, singular)
        if (singular) then
          outcome = outcome_singular
          return
        end if
      end if
      call solve(curve%n, jacobian, pivots, step)
      new = new - step
      iterations = iterations + 1
      ! NaN may pass unseen through a maximum, but not through a sum.
      change = maxval(abs(step)) + 0.0_wp*sum(step)
      norm = maxval(abs(new)) + 0.0_wp*sum(new)
      if (present(second) .and. k == 2) second = change/before
      if (.not. norm <= 1.0e60_wp) then
        outcome = outcome_overflow
        return
      end if
      ! With factors kept corrections shrink as a geometric series: estimate its remainder.
      if (fresh .and. change <= tolerance*norm &
          .or. change**2 <= max(far_below*tolerance, rounding)*norm*(before - change)) then
        outcome = outcome_converged
        x = new
        return
      end if
      if (change > growth_limit*smallest) then
        outcome = outcome_diverged
        return
      end if
      smallest = min(smallest, change)
      if (change < fast_enough*before) then
        fresh = .false.
      else
        fresh = k == 1 .or. .not. fresh
      end if
      before = change
    end do
  end subroutine solve_on_curve

end module viscovib_curve_newton
