!> Loads given as piecewise cubics in time; zero before the first and after the last break.
module viscovib_timed_cubics
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: timed_cubics

  type :: timed_cubics
    !> Shapes (n) and (n_rows, 4, n): sum_p pieces(:, p, i) (t - breaks(i))^(4-p). The last piece is
    !! not used.
    real(wp), allocatable :: breaks(:), pieces(:, :, :)
  contains
    procedure :: between
  end type timed_cubics

contains

  !> The cubic of the interval from `from` to `to`, in powers of the time since `from`, shape
  !! (n_rows, 4).
  pure function between(self, from, to) result(cubic)
    class(timed_cubics), intent(in) :: self
    real(wp), intent(in) :: from, to
    real(wp) :: cubic(size(self%pieces, 1), 4)
    real(wp) :: middle, shift
    integer :: i

    cubic = 0.0_wp
    middle = 0.5_wp*(from + to)
    if (middle < self%breaks(1) .or. middle > self%breaks(size(self%breaks))) return
    i = 1
    do while (i < size(self%breaks) - 1 .and. middle >= self%breaks(i + 1))
      i = i + 1
    end do
    shift = from - self%breaks(i)
    associate (a => self%pieces(:, :, i))
      cubic(:, 1) = a(:, 1)
      cubic(:, 2) = a(:, 2) + 3.0_wp*shift*a(:, 1)
      cubic(:, 3) = a(:, 3) + shift*(2.0_wp*a(:, 2) + 3.0_wp*shift*a(:, 1))
      cubic(:, 4) = a(:, 4) + shift*(a(:, 3) + shift*(a(:, 2) + shift*a(:, 1)))
    end associate
  end function between

end module viscovib_timed_cubics
