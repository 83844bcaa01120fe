! Optimize: -O3
!> Sensitivity of eigenvalues of a real matrix to its entries: |left| |right|/|left . right| of
!! their eigenvectors (Golub and Van Loan, Matrix Computations, 4th ed., 7.2.2).
!!
!! The vectors are computed by inverse iteration with the matrix in Hessenberg form. The iteration
!! for the left vector starts from the right one, so that for several equal eigenvalues with as many
!! eigenvectors the result is that of their common projector.
module viscovib_eigenvalue_conditions
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: eigenvalue_conditions

  !> Iterations for the right vector.
  integer, parameter :: n_turns = 3

contains

  !> The conditions of one or more eigenvalues.
  pure subroutine eigenvalue_conditions(matrix, values, conditions)
    !> Shape (n, n), finite.
    real(wp), intent(in) :: matrix(:, :)
    complex(wp), intent(in) :: values(:)
    real(wp), intent(out) :: conditions(:)
    real(wp), allocatable :: h(:, :)
    complex(wp), allocatable :: factors(:, :), right(:), left(:)
    logical, allocatable :: exchanged(:)
    integer :: i, k, n

    n = size(matrix, 1)
    allocate (h, source=matrix)
    call to_hessenberg(h)
    allocate (factors(n, n), right(n), left(n), exchanged(n))
    do i = 1, size(values)
      ! The second of a conjugate pair has the same condition.
      if (i > 1 .and. aimag(values(i)) < 0.0_wp) then
        conditions(i) = conditions(max(i - 1, 1))
        cycle
      end if
      call factorize(h, values(i), factors, exchanged)
      right = [(cmplx(1.0_wp, 0.3_wp*modulo(k, 3), wp), k=1, n)]
      do k = 1, n_turns
        call solve(factors, exchanged, right)
        right = right/norm(right)
      end do
      left = right
      call solve_adjoint(factors, exchanged, left)
      left = left/norm(left)
      conditions(i) = 1.0_wp/max(abs(dot_product(left, right)), epsilon(1.0_wp))
    end do
  end subroutine eigenvalue_conditions

  pure real(wp) function norm(x)
    complex(wp), intent(in) :: x(:)
    norm = maxval(abs(x))
    norm = norm*sqrt(sum((abs(x)/norm)**2))
  end function norm

  !> Hessenberg form by reflections.
  pure subroutine to_hessenberg(h)
    real(wp), intent(inout) :: h(:, :)
    real(wp) :: v(size(h, 1)), length
    integer :: k, n

    n = size(h, 1)
    do k = 1, n - 2
      v = 0.0_wp
      v(k + 1:) = h(k + 1:, k)
      length = norm2(v)
      if (.not. length > 0.0_wp) cycle
      v(k + 1) = v(k + 1) + sign(length, v(k + 1))
      v = v/norm2(v)
      h(k + 1:, k:) = h(k + 1:, k:) - 2.0_wp*outer(v(k + 1:), matmul(v(k + 1:), h(k + 1:, k:)))
      h(:, k + 1:) = h(:, k + 1:) - 2.0_wp*outer(matmul(h(:, k + 1:), v(k + 1:)), v(k + 1:))
    end do
  end subroutine to_hessenberg

  pure function outer(x, y) result(product)
    real(wp), intent(in) :: x(:), y(:)
    real(wp) :: product(size(x), size(y))
    product = spread(x, 2, size(y))*spread(y, 1, size(x))
  end function outer

  !> Triangular factors of h - value; zero pivots are replaced by rounding error.
  pure subroutine factorize(h, value, factors, exchanged)
    real(wp), intent(in) :: h(:, :)
    complex(wp), intent(in) :: value
    complex(wp), intent(out) :: factors(:, :)
    !> True if a row was exchanged with the next one.
    logical, intent(out) :: exchanged(:)
    complex(wp) :: row(size(h, 1))
    real(wp) :: least
    integer :: k, n

    n = size(h, 1)
    factors = h
    least = max(epsilon(1.0_wp)*maxval(abs(h)), tiny(1.0_wp)/epsilon(1.0_wp))
    do k = 1, n
      factors(k, k) = factors(k, k) - value
    end do
    exchanged = .false.
    do k = 1, n
      if (k < n) then
        exchanged(k) = abs(factors(k + 1, k)) > abs(factors(k, k))
        if (exchanged(k)) then
          row(k:) = factors(k, k:)
          factors(k, k:) = factors(k + 1, k:)
          factors(k + 1, k:) = row(k:)
        end if
      end if
      if (abs(factors(k, k)) < least) factors(k, k) = least
      if (k == n) exit
      factors(k + 1, k) = factors(k + 1, k)/factors(k, k)
      factors(k + 1, k + 1:) = factors(k + 1, k + 1:) - factors(k + 1, k)*factors(k, k + 1:)
    end do
  end subroutine factorize

  !> x becomes (h - value)^-1 x.
  pure subroutine solve(factors, exchanged, x)
    complex(wp), intent(in) :: factors(:, :)
    logical, intent(in) :: exchanged(:)
    complex(wp), intent(inout) :: x(:)
    integer :: k
    do k = 1, size(x) - 1
      if (exchanged(k)) x(k:k + 1) = x([k + 1, k])
      x(k + 1) = x(k + 1) - factors(k + 1, k)*x(k)
    end do
    do k = size(x), 1, -1
      x(k) = x(k)/factors(k, k)
      x(:k - 1) = x(:k - 1) - factors(:k - 1, k)*x(k)
    end do
  end subroutine solve

  !> The same for the adjoint.
  pure subroutine solve_adjoint(factors, exchanged, x)
    complex(wp), intent(in) :: factors(:, :)
    logical, intent(in) :: exchanged(:)
    complex(wp), intent(inout) :: x(:)
    integer :: k
    do k = 1, size(x)
      x(k) = (x(k) - dot_product(factors(:k - 1, k), x(:k - 1)))/conjg(factors(k, k))
    end do
    do k = size(x) - 1, 1, -1
      x(k) = x(k) - conjg(factors(k + 1, k))*x(k + 1)
      if (exchanged(k)) x(k:k + 1) = x([k + 1, k])
    end do
  end subroutine solve_adjoint

end module viscovib_eigenvalue_conditions
