! Optimize: -O3
!> LU factors of a matrix in blocks of columns, so that most of the work is products of
!! matrices: for hundreds of unknowns and more.
module viscovib_block_factors
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: factorize_blocks

  !> Columns of a block, and number of columns that are not halved further.
  integer, parameter :: block_width = 48, narrow = 8
  !> Columns of a product processed together: their sums stay in registers.
  integer, parameter :: summed = 6

contains

  !> LU factors in place, rows exchanged for the largest pivot.
  pure subroutine factorize_blocks(n, matrix, pivots, singular)
    integer, intent(in) :: n
    real(wp), intent(inout) :: matrix(n, n)
    integer, intent(out) :: pivots(n)
    logical, intent(out) :: singular
    integer :: first, last, k

    singular = .false.
    pivots = [(k, k=1, n)]
    do first = 1, n, block_width
      last = min(first + block_width - 1, n)
      call factorize_columns(n, first, last, matrix, pivots, singular)
      if (singular) return
      call exchange_rows(n, first, last, 1, first - 1, pivots, matrix)
      call eliminate(n, first, last, n, matrix, pivots)
    end do
  end subroutine factorize_blocks

  !> Factorize columns first to last, rows from first on, by recursive halving (Toledo, SIAM J.
  !! Matrix Anal. Appl. 18 (1997) 1065).
  pure recursive subroutine factorize_columns(n, first, last, matrix, pivots, singular)
    integer, intent(in) :: n, first, last
    real(wp), intent(inout) :: matrix(n, n)
    integer, intent(inout) :: pivots(n)
    logical, intent(out) :: singular
    integer :: middle

    if (last - first < narrow) then
      call factorize_panel(n, first, last, matrix(:, first:last), pivots, singular)
      return
    end if
    middle = (first + last)/2
    call factorize_columns(n, first, middle, matrix, pivots, singular)
    if (singular) return
    call eliminate(n, first, middle, last, matrix, pivots)
    call factorize_columns(n, middle + 1, last, matrix, pivots, singular)
    if (singular) return
    call exchange_rows(n, middle + 1, last, first, middle, pivots, matrix)
  end subroutine factorize_columns

  !> Update the columns after `last` up to `end` with the factorized columns first to last.
  pure subroutine eliminate(n, first, last, end, matrix, pivots)
    integer, intent(in) :: n, first, last, end, pivots(n)
    real(wp), intent(inout) :: matrix(n, n)
    if (last == end) return
    call exchange_rows(n, first, last, last + 1, end, pivots, matrix)
    call solve_rows(n, first, last, end - last, matrix, matrix(:, last + 1:end))
    call subtract_product(n, n - last, last - first + 1, end - last, matrix(last + 1, first), &
                          matrix(first, last + 1), matrix(last + 1, last + 1))
  end subroutine eliminate

  !> Apply the exchanges of the pivots first to last in the columns `from` to `to`.
  pure subroutine exchange_rows(n, first, last, from, to, pivots, matrix)
    integer, intent(in) :: n, first, last, from, to, pivots(n)
    real(wp), intent(inout) :: matrix(n, n)
    real(wp) :: entry
    integer :: j, k
    do j = from, to
      do k = first, last
        entry = matrix(pivots(k), j)
        matrix(pivots(k), j) = matrix(k, j)
        matrix(k, j) = entry
      end do
    end do
  end subroutine exchange_rows

  !> Solve L x = b in the rows first to last, with L the unit lower triangular factors
  !! there.
  pure recursive subroutine solve_rows(n, first, last, m, factors, x)
    integer, intent(in) :: n, first, last, m
    real(wp), intent(in) :: factors(n, *)
    real(wp), intent(inout) :: x(n, m)
    integer :: i, j, k, middle

    if (last - first < narrow) then
      do j = 1, m
        do k = first, last - 1
          do i = k + 1, last
            x(i, j) = x(i, j) - factors(i, k)*x(k, j)
          end do
        end do
      end do
      return
    end if
    middle = (first + last)/2
    call solve_rows(n, first, middle, m, factors, x)
    call subtract_product(n, last - middle, middle - first + 1, m, factors(middle + 1, first), &
                          x(first, 1), x(middle + 1, 1))
    call solve_rows(n, middle + 1, last, m, factors, x)
  end subroutine solve_rows

  !> c - a b, all parts of one matrix with `rows` rows. Rows are processed in whole registers; their
  !! part of a is copied to be contiguous, so that it is read once for all columns.
  pure subroutine subtract_product(rows, m, k, n, a, b, c)
    !> Shape of a is (m, k), of b (k, n).
    integer, intent(in) :: rows, m, k, n
    real(wp), intent(in) :: a(rows, *), b(rows, *)
    real(wp), intent(inout) :: c(rows, *)
    real(wp) :: part(n_lanes, k)
    real(wp), dimension(n_lanes) :: s1, s2, s3, s4, s5, s6
    integer :: first, i, j, l

    do first = 1, m - n_lanes + 1, n_lanes
      do i = 1, k
        part(:, i) = a(first:first + n_lanes - 1, i)
      end do
      do j = 1, n - summed + 1, summed
        s1 = 0.0_wp
        s2 = 0.0_wp
        s3 = 0.0_wp
        s4 = 0.0_wp
        s5 = 0.0_wp
        s6 = 0.0_wp
        do i = 1, k
          do l = 1, n_lanes
            s1(l) = s1(l) + part(l, i)*b(i, j)
            s2(l) = s2(l) + part(l, i)*b(i, j + 1)
            s3(l) = s3(l) + part(l, i)*b(i, j + 2)
            s4(l) = s4(l) + part(l, i)*b(i, j + 3)
            s5(l) = s5(l) + part(l, i)*b(i, j + 4)
            s6(l) = s6(l) + part(l, i)*b(i, j + 5)
          end do
        end do
        c(first:first + n_lanes - 1, j) = c(first:first + n_lanes - 1, j) - s1
        c(first:first + n_lanes - 1, j + 1) = c(first:first + n_lanes - 1, j + 1) - s2
        c(first:first + n_lanes - 1, j + 2) = c(first:first + n_lanes - 1, j + 2) - s3
        c(first:first + n_lanes - 1, j + 3) = c(first:first + n_lanes - 1, j + 3) - s4
        c(first:first + n_lanes - 1, j + 4) = c(first:first + n_lanes - 1, j + 4) - s5
        c(first:first + n_lanes - 1, j + 5) = c(first:first + n_lanes - 1, j + 5) - s6
      end do
      do j = n - mod(n, summed) + 1, n
        s1 = 0.0_wp
        do i = 1, k
          do l = 1, n_lanes
            s1(l) = s1(l) + part(l, i)*b(i, j)
          end do
        end do
        c(first:first + n_lanes - 1, j) = c(first:first + n_lanes - 1, j) - s1
      end do
    end do
    do j = 1, n
      do i = 1, k
        do l = m - mod(m, n_lanes) + 1, m
          c(l, j) = c(l, j) - a(l, i)*b(i, j)
        end do
      end do
    end do
  end subroutine subtract_product

  !> Factorize columns first to last, rows from first on, of the matrix of n rows.
  pure subroutine factorize_panel(n, first, last, panel, pivots, singular)
    integer, intent(in) :: n, first, last
    real(wp), intent(inout) :: panel(n, first:last)
    integer, intent(inout) :: pivots(n)
    logical, intent(out) :: singular
    real(wp) :: factor, row
    integer :: i, j, k, p

    singular = .false.
    do k = first, last
      p = k
      do i = k + 1, n
        if (abs(panel(i, k)) > abs(panel(p, k))) p = i
      end do
      pivots(k) = p
      singular = .not. (abs(panel(p, k)) > 0.0_wp .and. abs(panel(p, k)) <= huge(factor))
      if (singular) return
      if (p /= k) then
        do j = first, last
          row = panel(p, j)
          panel(p, j) = panel(k, j)
          panel(k, j) = row
        end do
      end if
      factor = 1.0_wp/panel(k, k)
      do i = k + 1, n
        panel(i, k) = panel(i, k)*factor
      end do
      do j = k + 1, last
        factor = panel(k, j)
        do i = k + 1, n
          panel(i, j) = panel(i, j) - panel(i, k)*factor
        end do
      end do
    end do
  end subroutine factorize_panel

end module viscovib_block_factors
