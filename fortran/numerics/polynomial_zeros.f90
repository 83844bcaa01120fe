!> Zeros of a real polynomial.
module viscovib_polynomial_zeros
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: polynomial_zeros

contains

  !> Zeros of c(0) z^n + c(1) z^(n - 1) + ... + c(n), as eigenvalues of its companion matrix. With
  !! the coefficients in reverse order the zeros are 1/z. (Golub and Van Loan, Matrix Computations,
  !! 7.4.6.)
  pure subroutine polynomial_zeros(c, zeros, found)
    !> Shape (0:n), the first not 0.
    real(wp), intent(in) :: c(0:)
    !> Shape (n).
    complex(wp), intent(out) :: zeros(:)
    logical, intent(out) :: found
    real(wp) :: companion(size(zeros), size(zeros))
    integer :: j

    companion = 0.0_wp
    companion(1, :) = -c(1:)/c(0)
    do j = 2, size(zeros)
      companion(j, j - 1) = 1.0_wp
    end do
    call eigenvalues(companion, zeros, found)
  end subroutine polynomial_zeros

end module viscovib_polynomial_zeros
