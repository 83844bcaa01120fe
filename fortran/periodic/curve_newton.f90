!> One solution of the equations of a curve at a fixed parameter, by Newton's method.
module viscovib_curve_newton
  use viscovib_curve, only: curve_type
  use viscovib_dense, only: factorize_blocks, solve
  use viscovib_kinds, only: wp
  use viscovib_outcomes, only: outcome_converged, outcome_diverged, outcome_overflow, &
    outcome_singular, outcome_stalled
  implicit none
  private

  public :: solve_on_curve

  !> Newton either settles within a few iterations or not at all.
  integer, parameter :: max_iterations = 25
  !> A correction this much larger than the smallest so far leads away.
  real(wp), parameter :: growth_limit = 1.0e4_wp

contains

  !> From x on; x is left as it was found unless the outcome is converged. Leaving
  !! the range of the equations counts as diverged.
  subroutine solve_on_curve(curve, p, tolerance, x, outcome, iterations, cancel)
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p
    !> Largest part of the last correction, relative to the largest part of x.
    real(wp), intent(in) :: tolerance
    !> Shape (n).
    real(wp), intent(inout) :: x(:)
    integer, intent(out) :: outcome
    !> Added to.
    integer, intent(inout) :: iterations
    !> May be set from elsewhere to give up, as stalled.
    integer, intent(inout), volatile, optional :: cancel
    real(wp), allocatable :: new(:), step(:), slope(:), jacobian(:, :)
    integer, allocatable :: pivots(:)
    real(wp) :: change, smallest, norm
    integer :: k
    logical :: singular, inside

    allocate (jacobian(curve%n, curve%n), step(curve%n), slope(curve%n), pivots(curve%n))
    allocate (new, source=x)
    smallest = sqrt(huge(1.0_wp))
    outcome = outcome_stalled
    do k = 1, max_iterations
      if (present(cancel)) then
        if (cancel /= 0) return
      end if
      call curve%equations(new, p, step, jacobian, slope, inside)
      if (.not. inside) then
        outcome = outcome_diverged
        return
      end if
      call factorize_blocks(curve%n, jacobian, pivots, singular)
      if (singular) then
        outcome = outcome_singular
        return
      end if
      call solve(curve%n, jacobian, pivots, step)
      new = new - step
      iterations = iterations + 1
      change = maxval(abs(step))
      norm = maxval(abs(new))
      if (.not. norm <= 1.0e60_wp) then
        outcome = outcome_overflow
        return
      end if
      if (change <= tolerance*norm) then
        outcome = outcome_converged
        x = new
        return
      end if
      if (change > growth_limit*smallest) then
        outcome = outcome_diverged
        return
      end if
      smallest = min(smallest, change)
    end do
  end subroutine solve_on_curve

end module viscovib_curve_newton
