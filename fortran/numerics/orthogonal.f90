!> Orthogonal factors of real matrices: least squares, and singular vectors.
!!
!! Householder's reflections with exchanged columns, and one-sided Jacobi rotations of the
!! triangular factor (Golub and Van Loan, Matrix Computations, 4th ed., 5.4 and 8.6; Drmac and
!! Veselic, SIAM J. Matrix Anal. Appl. 29 (2008) 1322).
module viscovib_orthogonal
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_rows, least_squares, right_vectors

  !> Largest number of sweeps of rotations; cosines between columns that count as 0.
  integer, parameter :: max_sweeps = 40
  real(wp), parameter :: right_angle = 4.0_wp*epsilon(1.0_wp)

contains

  !> Append rows to a triangular factor R, so that R' R increases by rows' rows.
  pure subroutine add_rows(r, rows)
    !> Shape (n, n).
    real(wp), intent(inout) :: r(:, :)
    !> Shape (m, n); overwritten.
    real(wp), intent(inout), contiguous :: rows(:, :)
    real(wp) :: beta, factor, w
    integer :: j, k

    do k = 1, size(r, 2)
      beta = -sign(hypot(r(k, k), norm2(rows(:, k))), r(k, k))
      if (.not. abs(beta) > 0.0_wp) cycle
      factor = (beta - r(k, k))/beta
      rows(:, k) = rows(:, k)/(r(k, k) - beta)
      r(k, k) = beta
      do j = k + 1, size(r, 2)
        w = factor*(r(k, j) + dot(rows(:, k), rows(:, j)))
        r(k, j) = r(k, j) - w
        rows(:, j) = rows(:, j) - w*rows(:, k)
      end do
    end do
  end subroutine add_rows

  !> Singular values and right singular vectors of a triangular or other square matrix, largest
  !! first; those below `least` times the largest are omitted.
  pure subroutine right_vectors(matrix, least, values, vectors)
    !> Shape (n, n).
    real(wp), intent(in) :: matrix(:, :), least
    !> Shapes (k) and (n, k).
    real(wp), allocatable, intent(out) :: values(:), vectors(:, :)
    real(wp) :: a(size(matrix, 1), size(matrix, 2)), scales(size(matrix, 2))
    real(wp), allocatable :: columns(:, :), squares(:)
    integer :: names(size(matrix, 2)), j, k, n, rank

    n = size(matrix, 2)
    a = matrix
    call factorize_columns(a, names, scales, 0.01_wp*least, rank)
    allocate (columns(n, rank), source=0.0_wp)
    do k = 1, rank
      columns(names(k:), k) = a(k, k:)
    end do
    call rotate_columns(columns)
    allocate (squares(rank))
    squares = sum(columns**2, 1)
    allocate (values(0), vectors(n, rank))
    do k = 1, rank
      j = maxloc(squares, 1)
      if (k > 1) then
        if (.not. squares(j) > (least*values(1))**2) exit
      else if (.not. squares(j) > 0.0_wp) then
        exit
      end if
      values = [values, sqrt(squares(j))]
      vectors(:, k) = columns(:, j)/values(k)
      squares(j) = -1.0_wp
    end do
    vectors = vectors(:, :size(values))
  end subroutine right_vectors

  !> Orthogonalize columns, the longer one of two first.
  pure subroutine rotate_columns(a)
    real(wp), intent(inout), contiguous :: a(:, :)
    real(wp) :: squares(size(a, 2)), column(size(a, 1))
    real(wp) :: c, product, s, t, x
    integer :: i, j, sweep
    logical :: changed

    do sweep = 1, max_sweeps
      squares = sum(a**2, 1)
      changed = .false.
      do i = 1, size(a, 2) - 1
        do j = i + 1, size(a, 2)
          product = dot(a(:, i), a(:, j))
          if (squares(j) > squares(i)) then
            column = a(:, i)
            a(:, i) = a(:, j)
            a(:, j) = column
            x = squares(i)
            squares(i) = squares(j)
            squares(j) = x
            changed = .true.
          end if
          if (.not. abs(product) > right_angle*sqrt(squares(i))*sqrt(squares(j))) cycle
          changed = .true.
          x = (squares(j) - squares(i))/(2.0_wp*product)
          t = sign(1.0_wp, x)/(abs(x) + hypot(1.0_wp, x))
          c = 1.0_wp/hypot(1.0_wp, t)
          s = c*t
          column = a(:, i)
          a(:, i) = c*column - s*a(:, j)
          a(:, j) = s*column + c*a(:, j)
          squares(i) = squares(i) - t*product
          squares(j) = max(squares(j) + t*product, 0.0_wp)
        end do
      end do
      if (.not. changed) exit
    end do
  end subroutine rotate_columns

  !> A P = Q R with the longest remaining column first; reflections are stored below the diagonal.
  pure subroutine factorize_columns(a, names, factors, least, rank)
    !> Shape (m, n).
    real(wp), intent(inout), contiguous :: a(:, :)
    !> Index in A of each column of the factor; the factors of reflections, shape (n).
    integer, intent(out) :: names(:)
    real(wp), intent(out) :: factors(:)
    !> Columns below this part of the first end the factorization.
    real(wp), intent(in) :: least
    integer, intent(out) :: rank
    real(wp) :: column(size(a, 1)), squares(size(a, 2)), beta, first, w
    integer :: j, k, m, p

    m = size(a, 1)
    names = [(k, k=1, size(a, 2))]
    factors = 0.0_wp
    first = 0.0_wp
    rank = 0
    do k = 1, min(m, size(a, 2))
      squares(k:) = sum(a(k:, k:)**2, 1)
      p = k - 1 + maxloc(squares(k:), 1)
      beta = sqrt(squares(p))
      if (k == 1) first = beta
      if (.not. beta > least*first) exit
      if (p /= k) then
        column = a(:, p)
        a(:, p) = a(:, k)
        a(:, k) = column
        j = names(p)
        names(p) = names(k)
        names(k) = j
      end if
      rank = k
      beta = -sign(norm2(a(k:, k)), a(k, k))
      factors(k) = (beta - a(k, k))/beta
      a(k + 1:, k) = a(k + 1:, k)/(a(k, k) - beta)
      a(k, k) = beta
      do j = k + 1, size(a, 2)
        w = factors(k)*(a(k, j) + dot(a(k + 1:, k), a(k + 1:, j)))
        a(k, j) = a(k, j) - w
        a(k + 1:, j) = a(k + 1:, j) - w*a(k + 1:, k)
      end do
    end do
  end subroutine factorize_columns

  !> X of least |A X - B|; unknowns that depend on others to rounding are set to 0.
  pure subroutine least_squares(a, b, x)
    !> Shapes (m, n) and (m, k), overwritten.
    real(wp), intent(inout), contiguous :: a(:, :), b(:, :)
    !> Shape (n, k).
    real(wp), intent(out) :: x(:, :)
    real(wp) :: factors(size(a, 2)), w
    integer :: names(size(a, 2)), j, k, rank

    call factorize_columns(a, names, factors, 0.5_wp*size(a, 1)*epsilon(1.0_wp), rank)
    x = 0.0_wp
    do j = 1, size(b, 2)
      do k = 1, rank
        w = factors(k)*(b(k, j) + dot(a(k + 1:, k), b(k + 1:, j)))
        b(k, j) = b(k, j) - w
        b(k + 1:, j) = b(k + 1:, j) - w*a(k + 1:, k)
      end do
      do k = rank, 1, -1
        b(k, j) = (b(k, j) - sum(a(k, k + 1:rank)*b(k + 1:rank, j)))/a(k, k)
        x(names(k), j) = b(k, j)
      end do
    end do
  end subroutine least_squares

  !> sum a b, in eight sums that the vector unit adds at once.
  pure real(wp) function dot(a, b)
    real(wp), intent(in), contiguous :: a(:), b(:)
    real(wp) :: sums(8)
    integer :: i, k

    sums = 0.0_wp
    do i = 1, size(a) - 7, 8
      do k = 1, 8
        sums(k) = sums(k) + a(i + k - 1)*b(i + k - 1)
      end do
    end do
    dot = sum(sums)
    do i = size(a) - mod(size(a), 8) + 1, size(a)
      dot = dot + a(i)*b(i)
    end do
  end function dot

end module viscovib_orthogonal
