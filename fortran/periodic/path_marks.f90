!> Which intervals of a path are split, along which a count of zeros follows a determinant.
module viscovib_path_marks
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: mark_intervals

  !> A quiet interval turns the argument by this at most, and changes the logarithm of the
  !! modulus by that: less than half of what two zeros unseen would do to a neighbour.
  real(wp), parameter :: largest_turn = 0.6_wp, largest_ratio = 0.6_wp
  !> An interval may be so many times as wide as its neighbours.
  real(wp), parameter :: grading = 2.01_wp

contains

  !> Those that are not quiet, their neighbours unless these are narrower, and those that are too
  !! wide compared with a neighbour.
  pure subroutine mark_intervals(width, change, marked)
    !> Of each interval: its width, and ln of the ratio of the determinant at its ends.
    real(wp), intent(in) :: width(:)
    complex(wp), intent(in) :: change(:)
    logical, allocatable, intent(out) :: marked(:)
    logical :: loud(size(change))
    integer :: n

    n = size(change)
    loud = abs(aimag(change)) > largest_turn .or. abs(real(change)) > largest_ratio
    allocate (marked(n), source=loud)
    if (n == 1) return
    marked(2:) = marked(2:) .or. beside(width(2:), width(:n - 1), loud(:n - 1))
    marked(:n - 1) = marked(:n - 1) .or. beside(width(:n - 1), width(2:), loud(2:))
  end subroutine mark_intervals

  elemental logical function beside(width, next, loud)
    real(wp), intent(in) :: width, next
    logical, intent(in) :: loud
    beside = width > grading*next .or. (loud .and. grading*width > next)
  end function beside

end module viscovib_path_marks
