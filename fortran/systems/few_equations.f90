! Optimize: -O2
!> Solves the small linear systems that keep a solution on switching surfaces.
module viscovib_few_equations
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: wall
  implicit none
  private

  public :: solve

contains

  !> Gaussian elimination with pivoting. A singular matrix gives x = `wall`, which no step accepts.
  pure subroutine solve(m, x)
    real(wp), intent(inout) :: m(:, :), x(:)
    real(wp) :: row(size(x)), factor
    integer :: i, j, p

    do i = 1, size(x)
      p = i - 1 + maxloc(abs(m(i:, i)), 1)
      if (.not. abs(m(p, i)) > 1.0e-14_wp*maxval(abs(m))) then
        x = wall
        return
      end if
      row = m(p, :)
      m(p, :) = m(i, :)
      m(i, :) = row
      factor = x(p)
      x(p) = x(i)
      x(i) = factor
      do j = i + 1, size(x)
        factor = m(j, i)/m(i, i)
        m(j, :) = m(j, :) - factor*m(i, :)
        x(j) = x(j) - factor*x(i)
      end do
    end do
    do i = size(x), 1, -1
      x(i) = (x(i) - dot_product(m(i, i + 1:), x(i + 1:)))/m(i, i)
    end do
  end subroutine solve

end module viscovib_few_equations
