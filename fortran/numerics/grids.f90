!> Evenly spaced grids.
module viscovib_grids
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: linear_grid, log_grid

contains

  !> n points from lowest to highest, both exact.
  pure function linear_grid(lowest, highest, n) result(grid)
    real(wp), intent(in) :: lowest, highest
    integer, intent(in) :: n
    real(wp) :: grid(n)
    integer :: i
    do i = 1, n
      grid(i) = lowest + (highest - lowest)*(real(i - 1, wp)/max(n - 1, 1))
    end do
    if (n > 1) grid(n) = highest
  end function linear_grid

  !> n points of constant ratio, both ends exact; lowest > 0.
  pure function log_grid(lowest, highest, n) result(grid)
    real(wp), intent(in) :: lowest, highest
    integer, intent(in) :: n
    real(wp) :: grid(n)
    grid = exp(linear_grid(log(lowest), log(highest), n))
    if (n > 0) grid(1) = lowest
    if (n > 1) grid(n) = highest
  end function log_grid

end module viscovib_grids
