!> One step of Newton's method from a point near a curve, orthogonal to the curve: an estimate of
!! the error of the point.
module viscovib_curve_step
  use viscovib_block_factors, only: factorize_blocks
  use viscovib_curve, only: curve_type
  use viscovib_dense, only: factorize_padded, solve_padded
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: curve_step, new_curve_step

  !> Up to this number of unknowns, vectorized padded columns are faster than blocks.
  integer, parameter :: small = 64, vector = 8

  !> Workspace of a Newton step.
  type :: curve_step
    integer :: rows = 0
    real(wp), allocatable :: matrix(:, :), weights(:), r(:), slope(:), change(:)
    integer, allocatable :: pivots(:)
  contains
    procedure :: find
  end type curve_step

contains

  subroutine new_curve_step(step, curve)
    type(curve_step), intent(out) :: step
    class(curve_type), intent(in) :: curve
    associate (n => curve%n)
      step%rows = n + 1
      if (n < small) step%rows = (n/vector + 1)*vector
      allocate (step%matrix(step%rows, n + 1), source=0.0_wp)
      allocate (step%pivots(n + 1), step%r(n), step%slope(n), step%change(n + 1))
      allocate (step%weights(n), source=1.0_wp)
    end associate
    if (allocated(curve%weights)) step%weights = curve%weights
  end subroutine new_curve_step

  !> Compute the step from a point.
  subroutine find(self, curve, p, x, chord, step, moved)
    class(curve_step), intent(inout) :: self
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p, x(:)
    !> Direction along the curve; the step is orthogonal to it. Shape (n + 1).
    real(wp), intent(in) :: chord(:)
    !> Step in x relative to its size, in the weighted norm, or the relative step of the unknown
    !! `alone`, whichever is larger; and step in p. At most 1 and |p|, which also mark failure.
    real(wp), intent(out) :: step, moved
    real(wp) :: size_x
    integer :: n
    logical :: inside, singular

    n = curve%n
    step = 1.0_wp
    moved = abs(p)
    call curve%equations(x, p, self%r, self%matrix, self%slope, inside)
    size_x = sum(self%weights*x**2)
    if (.not. (inside .and. size_x > 0.0_wp)) return
    self%matrix(:n, n + 1) = self%slope
    self%matrix(n + 1, :n) = self%weights*(chord(:n)/size_x)
    self%matrix(n + 1, n + 1) = (chord(n + 1)/p)/p
    if (n < small) then
      call factorize_padded(self%rows, n + 1, self%matrix, self%pivots, singular)
    else
      call factorize_blocks(n + 1, self%matrix, self%pivots, singular)
    end if
    if (singular) return
    self%change(:n) = self%r
    self%change(n + 1) = 0.0_wp
    call solve_padded(self%rows, n + 1, self%matrix, self%pivots, self%change)
    step = norm2(sqrt(self%weights)*self%change(:n))/sqrt(size_x)
    if (curve%alone > 0) step = max(step, abs(self%change(curve%alone)/x(curve%alone)))
    ! Also NaN: nearly singular.
    if (.not. step <= 1.0_wp) step = 1.0_wp
    if (abs(self%change(n + 1)) < moved) moved = abs(self%change(n + 1))
  end subroutine find

end module viscovib_curve_step
