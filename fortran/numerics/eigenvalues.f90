! Optimize: -O3
!> Eigenvalues of a small real matrix.
!!
!! Balancing by powers of 2, elimination to Hessenberg form, Francis's double-shift QR
!! (Golub and Van Loan, Matrix Computations, 4th ed., 7.4 and 7.5).
module viscovib_eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_sorting, only: sort_falling
  implicit none
  private

  public :: eigenvalues

  !> Largest number of sweeps per eigenvalue; sweeps without success before an exceptional shift.
  integer, parameter :: max_sweeps = 60, patience = 10
  !> Largest number of balancing sweeps.
  integer, parameter :: max_balancing = 20

contains

  !> Eigenvalues, largest modulus first, conjugate pairs adjacent, the one with
  !! positive imaginary part first.
  pure subroutine eigenvalues(matrix, values, found)
    !> Shape (n, n), finite.
    real(wp), intent(in) :: matrix(:, :)
    complex(wp), intent(out) :: values(:)
    logical, intent(out) :: found
    real(wp) :: h(size(matrix, 1), size(matrix, 1)), unit
    integer :: n

    n = size(matrix, 1)
    values = (0.0_wp, 0.0_wp)
    unit = maxval(abs(matrix))
    found = unit <= huge(unit)
    if (.not. found .or. .not. unit > 0.0_wp) return
    unit = scale(1.0_wp, max(exponent(unit), minexponent(unit) + 1))
    h = matrix/unit
    call balance(n, h)
    call to_hessenberg(n, h)
    call iterate(n, h, values, found)
    values = values*unit
    call sort_falling(values, abs(values))
  end subroutine eigenvalues

  !> Balance the sizes of rows and columns, by a similarity with powers of 2.
  pure subroutine balance(n, h)
    integer, intent(in) :: n
    real(wp), intent(inout) :: h(n, n)
    real(wp) :: row, column, factor
    integer :: i, sweep
    logical :: changed

    do sweep = 1, max_balancing
      changed = .false.
      do i = 1, n
        row = sum(abs(h(i, :))) - abs(h(i, i))
        column = sum(abs(h(:, i))) - abs(h(i, i))
        if (.not. (row > tiny(row) .and. column > tiny(column))) cycle
        factor = scale(1.0_wp, nint(0.5_wp*real(exponent(row) - exponent(column), wp)))
        if (.not. column*factor + row/factor < 0.95_wp*(column + row)) cycle
        h(:, i) = h(:, i)*factor
        h(i, :) = h(i, :)/factor
        changed = .true.
      end do
      if (.not. changed) return
    end do
  end subroutine balance

  !> Reduce to Hessenberg form by elimination, with row and column exchanges for the largest pivot.
  pure subroutine to_hessenberg(n, h)
    integer, intent(in) :: n
    real(wp), intent(inout) :: h(n, n)
    real(wp) :: line(n), factor
    integer :: i, k, p

    do k = 2, n - 1
      p = k - 1 + maxloc(abs(h(k:, k - 1)), 1)
      if (p /= k) then
        line = h(p, :)
        h(p, :) = h(k, :)
        h(k, :) = line
        line = h(:, p)
        h(:, p) = h(:, k)
        h(:, k) = line
      end if
      if (.not. abs(h(k, k - 1)) > 0.0_wp) cycle
      do i = k + 1, n
        factor = h(i, k - 1)/h(k, k - 1)
        if (.not. abs(factor) > 0.0_wp) cycle
        h(i, k - 1:) = h(i, k - 1:) - factor*h(k, k - 1:)
        h(:, k) = h(:, k) + factor*h(:, i)
      end do
      h(k + 1:, k - 1) = 0.0_wp
    end do
  end subroutine to_hessenberg

  pure subroutine iterate(n, h, values, found)
    integer, intent(in) :: n
    real(wp), intent(inout) :: h(n, n)
    complex(wp), intent(inout) :: values(n)
    logical, intent(out) :: found
    integer :: low, high, sweeps

    found = .true.
    high = n
    sweeps = 0
    do while (high >= 1)
      do low = high, 2, -1
        if (abs(h(low, low - 1)) <= epsilon(1.0_wp)*(abs(h(low - 1, low - 1)) &
                                                     + abs(h(low, low)))) exit
      end do
      if (low == high) then
        values(high) = h(high, high)
      else if (low == high - 1) then
        call pair_of(h(low, low), h(low, high), h(high, low), h(high, high), values(low), &
                     values(high))
      else
        sweeps = sweeps + 1
        found = sweeps <= max_sweeps
        if (.not. found) return
        call francis(n, low, high, mod(sweeps, patience) == 0, h)
        cycle
      end if
      high = low - 1
      sweeps = 0
    end do
  end subroutine iterate

  !> Eigenvalues of a 2 x 2 matrix, without cancellation.
  pure subroutine pair_of(a, b, c, d, first, second)
    !> First row a, b, second c, d.
    real(wp), intent(in) :: a, b, c, d
    complex(wp), intent(out) :: first, second
    real(wp) :: half, product, root

    half = 0.5_wp*(a - d)
    product = b*c
    root = half**2 + product
    if (root >= 0.0_wp) then
      root = half + sign(sqrt(root), half)
      first = d + root
      second = first
      if (abs(root) > 0.0_wp) second = d - product/root
    else
      first = cmplx(d + half, sqrt(-root), wp)
      second = conjg(first)
    end if
  end subroutine pair_of

  !> One implicit double step on rows and columns low to high, at least three, with the
  !! eigenvalues of the last two as shifts; `aside`: with exceptional shifts.
  pure subroutine francis(n, low, high, aside, h)
    integer, intent(in) :: n, low, high
    logical, intent(in) :: aside
    real(wp), intent(inout) :: h(n, n)
    real(wp) :: trace, product, v(3), factor
    complex(wp) :: shifts(2)
    integer :: j, k, m, from, to

    if (aside) then
      factor = abs(h(high, high - 1)) + abs(h(high - 1, high - 2))
      trace = 2.0_wp*h(high, high) + 1.5_wp*factor
      product = 0.25_wp*trace**2 + 0.4375_wp*factor**2
    else
      call pair_of(h(high - 1, high - 1), h(high - 1, high), h(high, high - 1), h(high, high), &
                   shifts(1), shifts(2))
      ! Two real shifts may cycle: use the nearer one twice.
      if (.not. abs(aimag(shifts(1))) > 0.0_wp) then
        shifts = shifts(minloc(abs(shifts - h(high, high)), 1))
      end if
      trace = real(shifts(1) + shifts(2))
      product = real(shifts(1)*shifts(2))
    end if
    v(1) = h(low, low)*(h(low, low) - trace) + h(low, low + 1)*h(low + 1, low) + product
    v(2) = h(low + 1, low)*(h(low, low) + h(low + 1, low + 1) - trace)
    v(3) = h(low + 1, low)*h(low + 2, low + 1)
    do k = low, high - 1
      m = min(3, high - k + 1)
      from = max(k - 1, low)
      to = min(k + 3, high)
      if (k > low) v(:m) = h(k:k + m - 1, k - 1)
      call reflector(m, v, factor)
      do j = from, high
        h(k:k + m - 1, j) = h(k:k + m - 1, j) - (factor*sum(v(:m)*h(k:k + m - 1, j)))*v(:m)
      end do
      do j = low, to
        h(j, k:k + m - 1) = h(j, k:k + m - 1) - (factor*sum(v(:m)*h(j, k:k + m - 1)))*v(:m)
      end do
      if (k > low) h(k + 1:k + m - 1, k - 1) = 0.0_wp
    end do
  end subroutine francis

  !> v and factor of the reflection 1 - factor v v' that maps v to its first axis.
  pure subroutine reflector(m, v, factor)
    integer, intent(in) :: m
    real(wp), intent(inout) :: v(3)
    real(wp), intent(out) :: factor
    real(wp) :: largest, length

    factor = 0.0_wp
    largest = maxval(abs(v(:m)))
    if (.not. largest > 0.0_wp) return
    v(:m) = v(:m)/largest
    length = sqrt(sum(v(:m)**2))
    v(1) = v(1) + sign(length, v(1))
    factor = 2.0_wp/sum(v(:m)**2)
  end subroutine reflector

end module viscovib_eigenvalues
