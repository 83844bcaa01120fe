! Optimize: -O3
!> Small dense linear algebra, for few unknowns.
module viscovib_dense
  use viscovib_block_factors, only: factorize_blocks
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: invert, factorize, factorize_padded, solve, solve_padded
  public :: solve_columns
  public :: solve_complex, equilibrate, largest_in_rows, outer

  !> Number of unknowns from which on blocks of columns are faster.
  integer, parameter :: many = 64
  !> Number of right sides processed together in `solve_columns`.
  integer, parameter :: together = 24

contains

  !> Inverse of a small complex matrix: by the adjugate for n <= 2, else by
  !! Gauss-Jordan elimination with row pivoting.
  pure subroutine invert(matrix, inverse, singular)
    !> Shape (n, n).
    complex(wp), intent(in) :: matrix(:, :)
    complex(wp), intent(out) :: inverse(:, :)
    !> True, and the inverse 0, if a pivot vanishes.
    logical, intent(out) :: singular

    select case (size(matrix, 1))
    case (1)
      singular = vanishes(matrix(1, 1))
      inverse = (0.0_wp, 0.0_wp)
      if (.not. singular) inverse(1, 1) = 1.0_wp/matrix(1, 1)
    case (2)
      call invert_two(matrix, inverse, singular)
    case default
      call invert_many(matrix, inverse, singular)
    end select
  end subroutine invert

  elemental logical function vanishes(z)
    complex(wp), intent(in) :: z
    vanishes = .not. (abs(real(z)) + abs(aimag(z)) > 0.0_wp)
  end function vanishes

  pure subroutine invert_two(matrix, inverse, singular)
    complex(wp), intent(in) :: matrix(2, 2)
    complex(wp), intent(out) :: inverse(2, 2)
    logical, intent(out) :: singular
    complex(wp) :: a(2, 2), determinant, factor
    real(wp) :: scale

    inverse = (0.0_wp, 0.0_wp)
    ! A power of two near the largest entry, so that no product of entries
    ! leaves the range of numbers because of the units.
    scale = maxval(abs(real(matrix)) + abs(aimag(matrix)))
    singular = .not. (scale > 0.0_wp .and. scale <= huge(scale))
    if (singular) return
    scale = 2.0_wp**(-max(exponent(scale), -1000))
    a = matrix*scale
    determinant = a(1, 1)*a(2, 2) - a(1, 2)*a(2, 1)
    singular = vanishes(determinant)
    if (singular) return
    factor = scale/determinant
    inverse(1, 1) = factor*a(2, 2)
    inverse(2, 1) = -factor*a(2, 1)
    inverse(1, 2) = -factor*a(1, 2)
    inverse(2, 2) = factor*a(1, 1)
  end subroutine invert_two

  pure subroutine invert_many(matrix, inverse, singular)
    complex(wp), intent(in) :: matrix(:, :)
    complex(wp), intent(out) :: inverse(:, :)
    logical, intent(out) :: singular
    complex(wp) :: work(size(matrix, 1), 2*size(matrix, 1)), row(2*size(matrix, 1))
    integer :: n, i, j, pivot

    n = size(matrix, 1)
    work = (0.0_wp, 0.0_wp)
    work(:, :n) = matrix
    do i = 1, n
      work(i, n + i) = (1.0_wp, 0.0_wp)
    end do
    do j = 1, n
      pivot = j - 1 + maxloc(abs(work(j:, j)), 1)
      singular = vanishes(work(pivot, j))
      if (singular) then
        inverse = (0.0_wp, 0.0_wp)
        return
      end if
      row = work(pivot, :)
      work(pivot, :) = work(j, :)
      work(j, :) = row/row(j)
      do i = 1, n
        if (i /= j) work(i, :) = work(i, :) - work(i, j)*work(j, :)
      end do
    end do
    inverse = work(:, n + 1:)
  end subroutine invert_many

  !> LU factors in place, rows exchanged for the largest pivot.
  pure subroutine factorize(n, matrix, pivots, singular)
    integer, intent(in) :: n
    real(wp), intent(inout) :: matrix(n, n)
    integer, intent(out) :: pivots(n)
    logical, intent(out) :: singular
    if (n < many) then
      call factorize_padded(n, n, matrix, pivots, singular)
    else
      call factorize_blocks(n, matrix, pivots, singular)
    end if
  end subroutine factorize

  !> The same for a matrix in the first n of `rows` rows: with a multiple of 8 rows the
  !! loops use whole vectors, which for few unknowns saves a quarter of the time.
  pure subroutine factorize_padded(rows, n, matrix, pivots, singular)
    integer, intent(in) :: rows, n
    !> Finite in the rows after the matrix.
    real(wp), intent(inout) :: matrix(rows, n)
    integer, intent(out) :: pivots(n)
    logical, intent(out) :: singular
    real(wp) :: column(rows), factor(4), largest, entry
    integer :: first, i, j, k, p

    singular = .false.
    column = 0.0_wp
    ! Valid row indices, even if a caller solves with a singular matrix.
    pivots = [(k, k=1, n)]
    do k = 1, n
      largest = 0.0_wp
      do i = k, n
        largest = max(largest, abs(matrix(i, k)))
      end do
      ! p > n if an entry is NaN.
      do p = k, n
        if (abs(matrix(p, k)) >= largest) exit
      end do
      singular = .not. (p <= n .and. largest > 0.0_wp .and. largest <= huge(largest))
      if (singular) return
      pivots(k) = p
      if (p /= k) then
        do j = 1, n
          entry = matrix(p, j)
          matrix(p, j) = matrix(k, j)
          matrix(k, j) = entry
        end do
      end if
      entry = 1.0_wp/matrix(k, k)
      do i = k + 1, n
        matrix(i, k) = matrix(i, k)*entry
        column(i) = matrix(i, k)
      end do
      ! Zeros before row k + 1 let the loops begin at a multiple of 4.
      column(k) = 0.0_wp
      first = k - mod(k, 4) + 1
      do j = k + 1, n - 3, 4
        factor = matrix(k, j:j + 3)
        do i = first, rows
          matrix(i, j) = matrix(i, j) - column(i)*factor(1)
          matrix(i, j + 1) = matrix(i, j + 1) - column(i)*factor(2)
          matrix(i, j + 2) = matrix(i, j + 2) - column(i)*factor(3)
          matrix(i, j + 3) = matrix(i, j + 3) - column(i)*factor(4)
        end do
      end do
      do j = n - mod(n - k, 4) + 1, n
        entry = matrix(k, j)
        do i = first, rows
          matrix(i, j) = matrix(i, j) - column(i)*entry
        end do
      end do
    end do
  end subroutine factorize_padded

  !> Solve with the factors of either procedure, in place of the right side.
  pure subroutine solve(n, factors, pivots, x)
    integer, intent(in) :: n, pivots(n)
    real(wp), intent(in) :: factors(n, n)
    real(wp), intent(inout) :: x(n)
    call solve_padded(n, n, factors, pivots, x)
  end subroutine solve

  !> The same with factors in the first n of some rows.
  pure subroutine solve_padded(rows, n, factors, pivots, x)
    integer, intent(in) :: rows, n, pivots(n)
    real(wp), intent(in) :: factors(rows, n)
    real(wp), intent(inout) :: x(n)
    real(wp) :: entry
    integer :: i, k, last, first

    do k = 1, n
      entry = x(pivots(k))
      x(pivots(k)) = x(k)
      x(k) = entry
    end do
    ! Four columns per iteration shorten the chain of dependent operations to a quarter.
    last = n - mod(n, 4)
    do k = 1, last, 4
      x(k + 1) = x(k + 1) - factors(k + 1, k)*x(k)
      x(k + 2) = x(k + 2) - factors(k + 2, k)*x(k) - factors(k + 2, k + 1)*x(k + 1)
      x(k + 3) = x(k + 3) - factors(k + 3, k)*x(k) - factors(k + 3, k + 1)*x(k + 1) &
                 - factors(k + 3, k + 2)*x(k + 2)
      do i = k + 4, n
        x(i) = x(i) - (factors(i, k)*x(k) + factors(i, k + 1)*x(k + 1)) &
               - (factors(i, k + 2)*x(k + 2) + factors(i, k + 3)*x(k + 3))
      end do
    end do
    do k = last + 1, n
      do i = k + 1, n
        x(i) = x(i) - factors(i, k)*x(k)
      end do
    end do
    first = mod(n, 4) + 1
    do k = n - 3, first, -4
      ! Reciprocals do not depend on x, so that no division is in the chain.
      x(k + 3) = x(k + 3)*(1.0_wp/factors(k + 3, k + 3))
      x(k + 2) = (x(k + 2) - factors(k + 2, k + 3)*x(k + 3))*(1.0_wp/factors(k + 2, k + 2))
      x(k + 1) = (x(k + 1) - factors(k + 1, k + 3)*x(k + 3) - factors(k + 1, k + 2)*x(k + 2)) &
                 *(1.0_wp/factors(k + 1, k + 1))
      x(k) = (x(k) - factors(k, k + 3)*x(k + 3) - factors(k, k + 2)*x(k + 2) &
              - factors(k, k + 1)*x(k + 1))*(1.0_wp/factors(k, k))
      do i = 1, k - 1
        x(i) = x(i) - (factors(i, k)*x(k) + factors(i, k + 1)*x(k + 1)) &
               - (factors(i, k + 2)*x(k + 2) + factors(i, k + 3)*x(k + 3))
      end do
    end do
    do k = first - 1, 1, -1
      x(k) = x(k)/factors(k, k)
      do i = 1, k - 1
        x(i) = x(i) - factors(i, k)*x(k)
      end do
    end do
  end subroutine solve_padded

  !> Solve for several right sides, in place: sums are vectorized over the right sides.
  pure subroutine solve_columns(n, m, factors, pivots, x)
    integer, intent(in) :: n, m, pivots(n)
    real(wp), intent(in) :: factors(n, n)
    real(wp), intent(inout) :: x(n, m)
    real(wp) :: across(together, n), sums(together), entry
    integer :: i, j, k, first, last

    do first = 1, m, together
      last = min(first + together - 1, m)
      across = 0.0_wp
      do j = first, last
        do i = 1, n
          across(j - first + 1, i) = x(i, j)
        end do
      end do
      do k = 1, n
        if (pivots(k) == k) cycle
        sums = across(:, pivots(k))
        across(:, pivots(k)) = across(:, k)
        across(:, k) = sums
      end do
      do i = 2, n
        sums = across(:, i)
        do k = 1, i - 1
          sums = sums - factors(i, k)*across(:, k)
        end do
        across(:, i) = sums
      end do
      do i = n, 1, -1
        sums = across(:, i)
        do k = i + 1, n
          sums = sums - factors(i, k)*across(:, k)
        end do
        entry = 1.0_wp/factors(i, i)
        across(:, i) = sums*entry
      end do
      do j = first, last
        do i = 1, n
          x(i, j) = across(j - first + 1, i)
        end do
      end do
    end do
  end subroutine solve_columns

  !> Solve A x = b by elimination with the largest pivot of each column.
  !! `nudge`: a vanishing pivot is replaced by rounding of the largest entry, as
  !! inverse iteration requires.
  pure subroutine solve_complex(matrix, x, nudge, singular)
    !> Shape (n, n).
    complex(wp), intent(in) :: matrix(:, :)
    !> Right side, then solution, shape (n).
    complex(wp), intent(inout) :: x(:)
    logical, intent(in) :: nudge
    logical, intent(out) :: singular
    complex(wp) :: a(size(x), size(x)), entry, factor, pivot
    real(wp) :: smallest, size_of_pivot, largest, here
    integer :: n, i, j, k, p

    n = size(x)
    a = matrix
    smallest = 0.0_wp
    if (nudge) smallest = epsilon(1.0_wp)*maxval(max(abs(real(a)), abs(aimag(a))))
    do k = 1, n
      p = k
      largest = abs(real(a(k, k))) + abs(aimag(a(k, k)))
      do i = k + 1, n
        here = abs(real(a(i, k))) + abs(aimag(a(i, k)))
        if (here > largest) p = i
        if (here > largest) largest = here
      end do
      if (p /= k) then
        do i = k, n
          entry = a(p, i)
          a(p, i) = a(k, i)
          a(k, i) = entry
        end do
        entry = x(p)
        x(p) = x(k)
        x(k) = entry
      end if
      if (nudge .and. .not. abs(a(k, k)) > smallest) a(k, k) = smallest
      size_of_pivot = abs(real(a(k, k))) + abs(aimag(a(k, k)))
      singular = .not. (size_of_pivot > 0.0_wp .and. size_of_pivot <= huge(1.0_wp))
      if (singular) return
      pivot = 1.0_wp/a(k, k)
      do i = k + 1, n
        a(i, k) = a(i, k)*pivot
        x(i) = x(i) - a(i, k)*x(k)
      end do
      a(k, k) = pivot
      do j = k + 1, n
        factor = a(k, j)
        do i = k + 1, n
          a(i, j) = a(i, j) - a(i, k)*factor
        end do
      end do
    end do
    do k = n, 1, -1
      x(k) = x(k)*a(k, k)
      do i = 1, k - 1
        x(i) = x(i) - a(i, k)*x(k)
      end do
    end do
  end subroutine solve_complex

  !> Factors (powers of 2) of rows and columns that remove the effect of units on the size of
  !! the entries of a matrix: the largest entry of each row and column is then near 1 (Ruiz,
  !! A scaling algorithm to equilibrate both rows and columns norms in matrices, RAL
  !! report 2001-034).
  pure subroutine equilibrate(sizes, rows, columns)
    !> Sizes of the entries, shape (n, n), and factors, shape (n).
    real(wp), intent(in) :: sizes(:, :)
    real(wp), intent(out) :: rows(:), columns(:)
    integer, parameter :: max_sweeps = 6
    real(wp) :: scaled(size(rows), size(columns))
    integer :: sweep

    rows = 1.0_wp
    columns = 1.0_wp
    do sweep = 1, max_sweeps
      scaled = sizes*outer(rows, columns)
      rows = rows/sqrt(max(maxval(scaled, 2), tiny(scaled)))
      columns = columns/sqrt(max(maxval(scaled, 1), tiny(scaled)))
    end do
    rows = scale(1.0_wp, exponent(rows))
    columns = scale(1.0_wp, exponent(columns))
  end subroutine equilibrate

  !> The largest entry of each row in n columns scaled by `sizes`. A multiple of 8 rows is fastest.
  pure subroutine largest_in_rows(rows, n, matrix, sizes, largest)
    integer, intent(in) :: rows, n
    real(wp), intent(in) :: matrix(rows, n), sizes(n)
    real(wp), intent(out) :: largest(rows)
    real(wp) :: entry
    integer :: i, j
    largest = 0.0_wp
    do j = 1, n
      do i = 1, rows
        entry = abs(matrix(i, j))*sizes(j)
        largest(i) = merge(entry, largest(i), entry > largest(i))
      end do
    end do
  end subroutine largest_in_rows

  !> a_i b_j.
  pure function outer(a, b) result(product)
    real(wp), intent(in) :: a(:), b(:)
    real(wp) :: product(size(a), size(b))
    product = spread(a, 2, size(b))*spread(b, 1, size(a))
  end function outer

end module viscovib_dense
