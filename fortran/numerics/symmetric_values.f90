! Optimize: -O2 -fvect-cost-model=dynamic
!> Eigenvalues of a small symmetric matrix, without vectors.
!!
!! Householder's reflections to tridiagonal form, then implicit QL with Wilkinson's shifts
!! (Golub and Van Loan, Matrix Computations, 4th ed., 8.3).
module viscovib_symmetric_values
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: nodes_of_recurrence
  implicit none
  private

  public :: symmetric_values

contains

  !> Ascending.
  pure subroutine symmetric_values(matrix, values)
    !> Shape (n, n); the lower triangle is read.
    real(wp), intent(in) :: matrix(:, :)
    real(wp), intent(out) :: values(:)
    real(wp) :: a(size(values), size(values)), middle, apart
    real(wp), dimension(size(values)) :: diagonal, off, weights
    integer :: n

    n = size(values)
    if (n == 1) then
      values(1) = matrix(1, 1)
    else if (n == 2) then
      middle = 0.5_wp*(matrix(1, 1) + matrix(2, 2))
      apart = hypot(0.5_wp*(matrix(1, 1) - matrix(2, 2)), matrix(2, 1))
      values(1) = middle - sign(apart, -middle)
      ! The smaller one from the product, which avoids cancellation.
      values(2) = 0.0_wp
      if (abs(values(1)) > 0.0_wp) then
        values(2) = matrix(1, 1)*(matrix(2, 2)/values(1)) - matrix(2, 1)*(matrix(2, 1)/values(1))
      end if
      if (values(1) > values(2)) values = values(2:1:-1)
    else
      a = matrix
      call to_tridiagonal(n, a, diagonal, off)
      call nodes_of_recurrence(n, diagonal, off, values, weights)
    end if
  end subroutine symmetric_values

  !> Diagonal and subdiagonal; off(i) couples diagonal(i) and diagonal(i + 1).
  pure subroutine to_tridiagonal(n, a, diagonal, off)
    integer, intent(in) :: n
    real(wp), intent(inout) :: a(n, n)
    real(wp), intent(out) :: diagonal(n), off(n)
    real(wp) :: v(n), p(n), length, unit
    integer :: j, k

    off = 0.0_wp
    do k = 1, n - 2
      v(k + 1:) = a(k + 1:, k)
      unit = maxval(abs(v(k + 1:)))
      if (.not. maxval(abs(v(k + 2:))) > 0.0_wp) then
        off(k) = v(k + 1)
        cycle
      end if
      v(k + 1:) = v(k + 1:)/unit
      length = sqrt(sum(v(k + 1:)**2))
      off(k) = -sign(length, v(k + 1))*unit
      v(k + 1) = v(k + 1) + sign(length, v(k + 1))
      v(k + 1:) = v(k + 1:)*(sqrt(2.0_wp)/sqrt(sum(v(k + 1:)**2)))
      ! A - v w' - w v' with w = A v - (v' A v/2) v in the trailing part, |v|^2 = 2.
      p(k + 1:) = 0.0_wp
      do j = k + 1, n
        p(j) = p(j) + a(j, j)*v(j) + sum(a(j + 1:, j)*v(j + 1:))
        p(j + 1:) = p(j + 1:) + a(j + 1:, j)*v(j)
      end do
      p(k + 1:) = p(k + 1:) - 0.5_wp*sum(p(k + 1:)*v(k + 1:))*v(k + 1:)
      do j = k + 1, n
        a(j:, j) = a(j:, j) - v(j:)*p(j) - p(j:)*v(j)
      end do
    end do
    off(n - 1) = a(n, n - 1)
    do k = 1, n
      diagonal(k) = a(k, k)
    end do
  end subroutine to_tridiagonal

end module viscovib_symmetric_values
