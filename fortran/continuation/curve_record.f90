! Optimize: -O2 -fvect-cost-model=dynamic
!> The result of following a curve: the points of the branch, and how it ended.
module viscovib_curve_record
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_curve_events, only: empty_points, special_points
  use viscovib_curve_point, only: curve_point
  use viscovib_kinds, only: wp
  use viscovib_sized_curve, only: refitted, sized_curve_type
  implicit none
  private

  public :: curve_branch_type

  !> How a branch ended: at the finish; back at the start value; number of points exhausted; no step
  !! small enough; numerical overflow; at the end of the range of the equations; closed at its first
  !! point; time limit; number of folds reached; solution not resolved by the number of unknowns.
  integer, parameter, public :: curve_completed = 0, curve_returned = 1, curve_step_limit = 2, &
                                curve_stuck = 3, curve_overflow = 4, curve_unphysical = 5, &
                                curve_closed = 6, curve_stopped = 7, curve_fold_limit = 8, &
                                curve_unresolved = 9
  character(len=*), parameter, public :: curve_outcomes(0:9) = &
    [character(len=10) :: 'completed', 'returned', 'step limit', 'stuck', 'overflow', &
     'unphysical', 'closed', 'stopped', 'fold limit', 'unresolved']

  !> Largest displacement of a fold, in units of its estimated error.
  real(wp), parameter :: past_fold = 2.0_wp
  !> Distance from a fold, relative to x, within which the curve is a parabola.
  real(wp), parameter :: near_fold = 0.2_wp

  type :: curve_branch_type
    integer :: n_points = 0, outcome = curve_completed
    !> Number of blocks of unknowns.
    integer :: blocks = 1
    !> p, its part of the unit tangent and iterations, shape (max_points); x, shape
    !! (n_unknowns at most, max_points).
    real(wp), allocatable :: parameter(:), direction(:), x(:, :)
    integer, allocatable :: iterations(:)
    !> Errors of each point by the last correction and by rounding: the estimated relative error of
    !! x at its value of p, which is unbounded near a fold, and the distance of (x, p) from the
    !! curve, shape (max_points).
    real(wp), allocatable :: error(:), off(:)
    !> If the number of unknowns is adapted: their number, the relative truncation error of x at its
    !! value of p, which is unbounded near a fold, and the relative truncation error as a distance
    !! from the curve, shape (max_points).
    integer, allocatable :: kept(:)
    real(wp), allocatable :: truncation(:), missed(:)
    !> Allowed relative error at each point, for solutions of an oscillator.
    real(wp), allocatable :: allowed(:)
    type(special_points) :: folds, branch_points
    !> Indices of points that are stops.
    integer, allocatable :: stops(:)
  contains
    procedure :: end_with_numbers
    procedure :: end_before
    procedure :: end_resolved
    procedure :: doubt_near_folds
    procedure :: allocate_arrays
    procedure :: add
  end type curve_branch_type

contains

  !> Allocate arrays for `max_points` points of n unknowns, or of the largest number if it is
  !! adapted.
  subroutine allocate_arrays(self, max_points, n, sized)
    class(curve_branch_type), intent(inout) :: self
    integer, intent(in) :: max_points, n
    !> The curve, if the number of unknowns is adapted.
    class(sized_curve_type), pointer, intent(in) :: sized
    integer :: most
    most = n
    if (associated(sized)) then
      most = sized%n_most
      self%blocks = sized%blocks
      allocate (self%kept(max_points), self%truncation(max_points), self%missed(max_points))
    end if
    allocate (self%parameter(max_points), self%direction(max_points), &
              self%iterations(max_points), self%error(max_points), self%off(max_points), &
              self%x(most, max_points), self%stops(0))
    call empty_points(self%folds, most, self%blocks)
    call empty_points(self%branch_points, most, self%blocks)
  end subroutine allocate_arrays

  !> Add a point.
  subroutine add(self, point, stop)
    class(curve_branch_type), intent(inout) :: self
    type(curve_point), intent(in) :: point
    logical, intent(in) :: stop
    self%n_points = self%n_points + 1
    self%parameter(self%n_points) = point%p
    self%direction(self%n_points) = point%slope_p
    self%iterations(self%n_points) = point%iterations
    self%error(self%n_points) = point%error
    self%off(self%n_points) = point%off
    if (size(point%x) == size(self%x, 1)) then
      self%x(:, self%n_points) = point%x
    else
      self%x(:, self%n_points) = refitted(self%blocks, point%x, size(self%x, 1))
    end if
    if (allocated(self%kept)) then
      self%kept(self%n_points) = size(point%x)
      self%truncation(self%n_points) = point%truncation
      self%missed(self%n_points) = point%missed
    end if
    if (self%n_points == 2) call take_from_next(self)
    if (stop) self%stops = [self%stops, self%n_points]
  end subroutine add

  !> If the errors are unknown at the first point off another branch, use those of the next point.
  pure subroutine take_from_next(branch)
    type(curve_branch_type), intent(inout) :: branch
    if (.not. branch%error(1) > 0.0_wp) branch%error(1) = branch%error(2)
    if (.not. branch%off(1) > 0.0_wp) branch%off(1) = branch%off(2)
    if (.not. allocated(branch%truncation)) return
    if (branch%truncation(1) > 0.0_wp) return
    branch%truncation(1) = branch%truncation(2)
    branch%missed(1) = branch%missed(2)
  end subroutine take_from_next

  !> Near a fold, p - p_fold = a s^2 with the distance s of x from it. After a displacement of the
  !! fold by e, the solution at the same p is at s sqrt(1 - e/|p - p_fold|). If the fold may move
  !! past a point, there may be no solution at its p.
  subroutine doubt_near_folds(self, weights)
    class(curve_branch_type), intent(inout) :: self
    !> Weight of each block.
    real(wp), intent(in) :: weights(:)
    real(wp), allocatable :: w(:)
    real(wp) :: apart, last, off
    integer :: i, k, way

    if (.not. allocated(self%truncation)) return
    allocate (w, source=[(spread(weights(k), 1, size(self%x, 1)/size(weights)), &
                          k=1, size(weights))])
    do k = 1, self%folds%n
      associate (error => self%folds%error(k))
        do way = -1, 1, 2
          last = 0.0_wp
          i = self%folds%before(k) + max(way, 0)
          do while (i >= 1 .and. i <= self%n_points)
            apart = abs(self%parameter(i) - self%folds%p(k))
            off = sqrt(sum(w*(self%x(:, i) - self%folds%x(:, k))**2) &
                       /max(sum(w*self%x(:, i)**2), tiny(1.0_wp)))
            if (apart > past_fold*error) then
              if (off > near_fold .or. apart < last) exit
              off = off*(1.0_wp - sqrt(1.0_wp - error/apart))
            else
              off = 1.0_wp
            end if
            self%truncation(i) = max(self%truncation(i), min(off, 1.0_wp))
            last = apart
            i = i + way
          end do
        end do
      end associate
    end do
  end subroutine doubt_near_folds

  !> End the branch before the first point that is not finite.
  subroutine end_with_numbers(self)
    class(curve_branch_type), intent(inout) :: self
    logical :: finite
    integer :: i

    do i = 1, self%n_points
      finite = all(ieee_is_finite([self%parameter(i), self%error(i)]))
      if (finite) finite = all(ieee_is_finite(self%x(:, i)))
      if (finite .and. allocated(self%truncation)) finite = ieee_is_finite(self%truncation(i))
      if (finite) cycle
      call self%end_before(i)
      return
    end do
  end subroutine end_with_numbers

  !> End the branch before point i because of overflow.
  pure subroutine end_before(self, i)
    class(curve_branch_type), intent(inout) :: self
    integer, intent(in) :: i
    self%n_points = i - 1
    self%outcome = curve_overflow
    self%folds%n = count(self%folds%before(:self%folds%n) < i)
    self%branch_points%n = count(self%branch_points%before(:self%branch_points%n) < i)
    self%stops = pack(self%stops, self%stops < i)
  end subroutine end_before

  !> End a branch before the points, up to its end, whose neglected unknowns are as large as the
  !! solution, as near a homoclinic orbit with its unbounded period. They are not solutions.
  pure subroutine end_resolved(self)
    class(curve_branch_type), intent(inout) :: self
    integer :: i

    do i = self%n_points, 2, -1
      if (self%truncation(i) < 1.0_wp) exit
    end do
    if (i >= self%n_points) return
    call self%end_before(i + 1)
    self%outcome = curve_unresolved
  end subroutine end_resolved

end module viscovib_curve_record
