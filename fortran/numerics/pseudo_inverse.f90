!> Inverses of matrices that may be singular within rounding error, null vectors and signs of
!! determinants.
!!
!! The singular value decomposition uses one-sided Jacobi rotations (M. R. Hestenes, J. SIAM
!! 6, 1958; Golub and Van Loan, Matrix Computations, 4th ed., 8.6.3).
module viscovib_pseudo_inverse
  use viscovib_dense, only: factorize, solve_columns
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: pseudo_inverse, null_vector, sign_of_determinant

  !> Singular values below this part of the largest count as 0.
  real(wp), parameter :: smallest = epsilon(1.0_wp)
  !> Condition numbers, as products of norms, up to which the inverse is computed by elimination.
  real(wp), parameter :: regular = 1.0e12_wp
  integer, parameter :: max_sweeps = 60

contains

  !> The inverse, or with singular values below rounding error the pseudo-inverse of Moore and
  !! Penrose.
  pure subroutine pseudo_inverse(matrix, inverse)
    !> Shape (n, n), finite.
    real(wp), intent(in) :: matrix(:, :)
    real(wp), allocatable, intent(out) :: inverse(:, :)
    real(wp), allocatable :: factors(:, :), u(:, :), v(:, :), sizes(:)
    integer :: pivots(size(matrix, 1)), i, n
    logical :: singular

    n = size(matrix, 1)
    allocate (factors, source=matrix)
    allocate (inverse(n, n), source=0.0_wp)
    do i = 1, n
      inverse(i, i) = 1.0_wp
    end do
    call factorize(n, factors, pivots, singular)
    if (.not. singular) then
      call solve_columns(n, n, factors, pivots, inverse)
      if (row_norm(matrix)*row_norm(inverse) <= regular) return
    end if
    call decompose(matrix, u, sizes, v)
    do i = 1, n
      if (sizes(i) > smallest*maxval(sizes)) then
        v(:, i) = v(:, i)/sizes(i)
      else
        v(:, i) = 0.0_wp
      end if
    end do
    inverse = matmul(v, transpose(u))
  end subroutine pseudo_inverse

  pure real(wp) function row_norm(matrix)
    real(wp), intent(in) :: matrix(:, :)
    row_norm = maxval(sum(abs(matrix), 2))
  end function row_norm

  !> The unit vector x with the smallest |A x|, for a matrix A with one row less than columns.
  pure subroutine null_vector(matrix, x)
    !> Shape (n - 1, n).
    real(wp), intent(in) :: matrix(:, :)
    real(wp), allocatable, intent(out) :: x(:)
    real(wp), allocatable :: square(:, :), u(:, :), v(:, :), sizes(:)
    integer :: n

    n = size(matrix, 2)
    allocate (square(n, n), source=0.0_wp)
    square(:n - 1, :) = matrix
    call decompose(square, u, sizes, v)
    allocate (x, source=v(:, minloc(sizes, 1)))
  end subroutine null_vector

  !> matrix = sum_k sizes(k) u(:, k) v(:, k)^T with orthonormal v; u(:, k) = 0 with a size of 0.
  pure subroutine decompose(matrix, u, sizes, v)
    real(wp), intent(in) :: matrix(:, :)
    real(wp), allocatable, intent(out) :: u(:, :), sizes(:), v(:, :)
    real(wp) :: a, b, c, cosine, sine, tangent, zeta
    real(wp), allocatable :: column(:)
    integer :: i, j, n, sweep
    logical :: turned

    n = size(matrix, 2)
    allocate (u, source=matrix)
    allocate (v(n, n), source=0.0_wp)
    allocate (sizes(n), column(n))
    do i = 1, n
      v(i, i) = 1.0_wp
    end do
    do sweep = 1, max_sweeps
      turned = .false.
      do i = 1, n - 1
        do j = i + 1, n
          a = dot_product(u(:, i), u(:, i))
          b = dot_product(u(:, j), u(:, j))
          c = dot_product(u(:, i), u(:, j))
          ! The rotation angle of a negligible column would be out of the range of numbers.
          if (.not. abs(c) > max(epsilon(c)*sqrt(a*b), 1.0e-150_wp*max(a, b))) cycle
          turned = .true.
          zeta = (b - a)/(2.0_wp*c)
          tangent = sign(1.0_wp, zeta)/(abs(zeta) + hypot(1.0_wp, zeta))
          cosine = 1.0_wp/sqrt(1.0_wp + tangent**2)
          sine = cosine*tangent
          column = u(:, i)
          u(:, i) = cosine*column - sine*u(:, j)
          u(:, j) = sine*column + cosine*u(:, j)
          column = v(:, i)
          v(:, i) = cosine*column - sine*v(:, j)
          v(:, j) = sine*column + cosine*v(:, j)
        end do
      end do
      if (.not. turned) exit
    end do
    sizes = sqrt(sum(u**2, 1))
    do i = 1, n
      if (sizes(i) > 0.0_wp) u(:, i) = u(:, i)/sizes(i)
    end do
  end subroutine decompose

  !> Sign of the determinant, without overflow: -1, 0 or 1.
  pure real(wp) function sign_of_determinant(matrix)
    real(wp), intent(in) :: matrix(:, :)
    real(wp), allocatable :: factors(:, :)
    integer :: i, pivots(size(matrix, 1))
    logical :: singular

    allocate (factors, source=matrix)
    sign_of_determinant = 0.0_wp
    call factorize(size(pivots), factors, pivots, singular)
    if (singular) return
    sign_of_determinant = 1.0_wp
    do i = 1, size(pivots)
      if (abs(factors(i, i)) <= 0.0_wp) sign_of_determinant = 0.0_wp
      if (factors(i, i) < 0.0_wp .neqv. pivots(i) /= i) sign_of_determinant = -sign_of_determinant
    end do
  end function sign_of_determinant

end module viscovib_pseudo_inverse
