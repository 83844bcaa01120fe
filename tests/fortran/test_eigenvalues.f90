!> Eigenvalues of small matrices and singular vectors, against closed forms.
module test_eigenvalues
  use testing, only: begin, check, check_close
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_orthogonal, only: add_rows, right_vectors
  use viscovib_symmetric_modes, only: symmetric_values
  implicit none
  private

  public :: run_eigenvalues

contains

  subroutine run_eigenvalues()
    if (begin('eigenvalues of a companion matrix are its roots')) call companion()
    if (begin('eigenvalues of matrices far from normal')) call skewed()
    if (begin('eigenvalues that shifts by both of the last two never find')) call stubborn()
    if (begin('eigenvalues of symmetric matrices')) call check_values()
    if (begin('singular vectors of rows in parts are orthonormal')) call check_vectors()
  end subroutine run_eigenvalues

  subroutine companion()
    real(wp) :: a(6, 6)
    complex(wp) :: z(6), expected(6)
    logical :: found
    integer :: i

    ! (z - 3)(z + 2)(z^2 - z + 1/2)(z^2 + 1/100).
    a = 0.0_wp
    a(:2, :2) = reshape([1.0_wp, 1.0_wp, 6.0_wp, 0.0_wp], [2, 2])
    a(3:4, 3:4) = reshape([1.0_wp, 1.0_wp, -0.5_wp, 0.0_wp], [2, 2])
    a(5:6, 5:6) = reshape([0.0_wp, 1.0_wp, -0.01_wp, 0.0_wp], [2, 2])
    ! Similarity transformation by unit triangular matrices.
    do i = 2, 6
      a(i, :) = a(i, :) + 0.7_wp*a(i - 1, :)
      a(:, i - 1) = a(:, i - 1) - 0.7_wp*a(:, i)
    end do
    call eigenvalues(a, z, found)
    call check(found, 'found')
    expected = cmplx([3.0_wp, -2.0_wp, 0.5_wp, 0.5_wp, 0.0_wp, 0.0_wp], &
                     [0.0_wp, 0.0_wp, 0.5_wp, -0.5_wp, 0.1_wp, -0.1_wp], wp)
    call check(maxval(abs(z - expected)) <= 1.0e-13_wp, 'roots')
    call eigenvalues(0.0_wp*a, z, found)
    call check(found .and. all(abs(z) <= 0.0_wp), 'of nothing')
    a = 0.0_wp
    do i = 1, 6
      a(i, mod(i, 6) + 1) = 1.0_wp
    end do
    call eigenvalues(a, z, found)
    call check(found, 'roots of one found')
    call check(maxval(abs(z**6 - 1.0_wp)) <= 1.0e-13_wp, 'roots of one')
  end subroutine companion

  !> Trace, sum of squares and largest magnitude, at any scale.
  subroutine skewed()
    real(wp) :: a(4, 4)
    complex(wp) :: z(4)
    logical :: found
    integer :: i, j

    do j = 1, 4
      do i = 1, 4
        a(i, j) = sin(1.0_wp*i + 7.0_wp*j)*10.0_wp**(6*(i - j))
      end do
    end do
    call eigenvalues(a, z, found)
    call check(found, 'found')
    call check_close(real(sum(z)), sum([(a(i, i), i=1, 4)]), 1.0e-13_wp, 'trace')
    call check_close(real(sum(z**2)), sum(a*transpose(a)), 1.0e-12_wp, 'squares')
    call check(all(abs(z(2:)) <= abs(z(:3))), 'sorted')
    call eigenvalues(1.0e200_wp*a, z, found)
    call check_close(real(sum(z))*1.0e-200_wp, sum([(a(i, i), i=1, 4)]), 1.0e-13_wp, 'large')
  end subroutine skewed

  !> Two pairs of multipliers close to each other.
  subroutine stubborn()
    real(wp) :: a(4, 4), b(4, 4), r
    complex(wp) :: z(4)
    logical :: found
    integer :: i, k

    a = reshape([0.68529266_wp, 0.79090594_wp, 0.02263623_wp, 0.22054541_wp, 0.07914337_wp, &
                 0.13173456_wp, 0.02330697_wp, -0.13539662_wp, -0.00965101_wp, -0.01547126_wp, &
                 0.68566448_wp, 0.79667002_wp, -0.00159147_wp, 0.00127742_wp, 0.07950153_wp, &
                 0.1290801_wp], [4, 4])
    r = 0.0_wp
    do k = 1, 300
      b = a
      do i = 1, 4
        r = modulo(r + 0.6180339887_wp, 1.0_wp)
        b(i, 5 - i) = b(i, 5 - i)*(1.0_wp + 0.01_wp*r)
      end do
      call eigenvalues(b, z, found)
      call check(found, 'found')
      call check_close(real(sum(z)), sum([(b(i, i), i=1, 4)]), 1.0e-13_wp, 'trace')
      call check_close(real(sum(z**2)), sum(b*transpose(b)), 1.0e-13_wp, 'squares')
    end do
  end subroutine stubborn

  !> The second difference matrix: 4 sin^2(k pi/(2 n + 2)).
  subroutine check_values()
    real(wp), allocatable :: a(:, :), values(:)
    integer :: i, n
    do n = 1, 12
      allocate (a(n, n), values(n))
      a = 0.0_wp
      do i = 1, n
        a(i, i) = 2.0_wp
        if (i > 1) a(i, i - 1) = -1.0_wp
        if (i > 1) a(i - 1, i) = -1.0_wp
      end do
      ! The same eigenvalues with a full matrix, after a reflection.
      do i = 1, n - 1
        a = matmul(reflection(n, i), matmul(a, reflection(n, i)))
      end do
      call symmetric_values(a, values)
      do i = 1, n
        call check_close(values(i), 4.0_wp*sin(i*acos(-1.0_wp)/(2*n + 2))**2, 1.0e-13_wp, &
                         'eigenvalue', floor=1.0_wp)
      end do
      deallocate (a, values)
    end do
  end subroutine check_values

  pure function reflection(n, k) result(matrix)
    integer, intent(in) :: n, k
    real(wp) :: matrix(n, n), v(n)
    integer :: i
    v = [(sin(1.0_wp*i*k + 0.3_wp), i=1, n)]
    matrix = -2.0_wp*spread(v, 1, n)*spread(v, 2, n)/sum(v**2)
    do i = 1, n
      matrix(i, i) = matrix(i, i) + 1.0_wp
    end do
  end function reflection

  !> Rows in two parts have the Gram matrix of all rows; these are its eigenvectors.
  subroutine check_vectors()
    integer, parameter :: m = 30, n = 7
    real(wp) :: rows(m, n), r(n, n), part(m/2, n), left(n)
    real(wp), allocatable :: values(:), vectors(:, :)
    integer :: i, j, k

    do j = 1, n
      rows(:, j) = [(sin(0.7_wp*i*j) + 0.1_wp*cos(1.3_wp*i)*j, i=1, m)]*10.0_wp**(-j)
    end do
    r = 0.0_wp
    do k = 0, 1
      part = rows(k*m/2 + 1:(k + 1)*m/2, :)
      call add_rows(r, part)
    end do
    call right_vectors(r, 1.0e-14_wp, values, vectors)
    call check(size(values) == n, 'all of them')
    do k = 1, n
      left = matmul(matmul(rows, vectors(:, k)), rows) - values(k)**2*vectors(:, k)
      call check_close(maxval(abs(left)), 0.0_wp, 1.0e-14_wp, 'residual', floor=values(1)**2)
      left = matmul(vectors(:, k), vectors)
      left(k) = left(k) - 1.0_wp
      call check_close(maxval(abs(left)), 0.0_wp, 1.0e-13_wp, 'orthonormal', floor=1.0_wp)
      if (k > 1) call check(values(k) <= values(k - 1), 'falling')
    end do
  end subroutine check_vectors

end module test_eigenvalues
