! Optimize: -O2
!> Selection of intervals to halve on a path along which a determinant is followed to count zeros.
module viscovib_path_marks
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: mark_intervals

  !> Limits of a quiet interval: change of the argument, and of the logarithm of the modulus. They
  !! are less than half of the effect of two unnoticed zeros on an adjacent interval.
  real(wp), parameter :: largest_turn = 0.6_wp, largest_ratio = 0.6_wp
  !> Largest ratio of the widths of adjacent intervals.
  real(wp), parameter :: grading = 2.01_wp

contains

  !> Mark intervals that are not quiet, intervals next to these unless they are narrower, and
  !! intervals that are too wide compared with an adjacent one.
  pure subroutine mark_intervals(width, change, marked)
    !> For each interval: its width, and ln of the ratio of the determinant at its ends.
    real(wp), intent(in) :: width(:)
    complex(wp), intent(in) :: change(:)
    logical, allocatable, intent(out) :: marked(:)
    logical :: loud(size(change))
    integer :: n

    n = size(change)
    loud = abs(aimag(change)) > largest_turn .or. abs(real(change)) > largest_ratio
    allocate (marked(n), source=loud)
    if (n == 1) return
    marked(2:) = marked(2:) .or. nearby(width(2:), width(:n - 1), loud(:n - 1))
    marked(:n - 1) = marked(:n - 1) .or. nearby(width(:n - 1), width(2:), loud(2:))
  end subroutine mark_intervals

  elemental logical function nearby(width, next, loud)
    real(wp), intent(in) :: width, next
    logical, intent(in) :: loud
    nearby = width > grading*next .or. (loud .and. grading*width > next)
  end function nearby

end module viscovib_path_marks
