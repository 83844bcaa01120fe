!> Small dense linear algebra: inverses against the identity.
module test_dense
  use testing, only: begin, check, check_close
  use viscovib_block_factors, only: factorize_blocks
  use viscovib_curve_factors, only: curve_factors, new_factors
  use viscovib_dense, only: factorize, factorize_padded, invert, solve
  use viscovib_eigenvalue_conditions, only: eigenvalue_conditions
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_pseudo_inverse, only: null_vector, pseudo_inverse, sign_of_determinant
  implicit none
  private

  public :: run_dense

contains

  subroutine run_dense()
    call run_factors()
    if (begin('pseudo-inverses of matrices of lower rank')) call run_pseudo_inverses()
    if (begin('conditions of eigenvalues')) call run_conditions()
  end subroutine run_dense

  !> A A+ A = A, A+ A A+ = A+, and the minimum-norm solution.
  subroutine run_pseudo_inverses()
    real(wp), allocatable :: a(:, :), inverse(:, :), x(:)
    integer :: i, j, k, n, rank

    do n = 1, 7
      do rank = max(n - 2, 1), n
        a = reshape([((sum([(sin(real(i*k + 1, wp))*cos(real(j*k*k, wp)), k=1, rank)]), &
                       i=1, n), j=1, n)], [n, n])
        call pseudo_inverse(a, inverse)
        call check_close(maxval(abs(matmul(a, matmul(inverse, a)) - a)), 0.0_wp, 1.0e-11_wp, &
                         'A A+ A = A', floor=1.0_wp)
        call check_close(maxval(abs(matmul(a, inverse) - transpose(matmul(a, inverse)))), &
                         0.0_wp, 1.0e-9_wp, 'symmetric', floor=1.0_wp)
      end do
    end do
    call null_vector(reshape([1.0_wp, 0.0_wp, 1.0_wp, 1.0_wp, 0.0_wp, 1.0_wp], [2, 3]), x)
    call check_close(abs(x(1) - x(3)), 0.0_wp, 1.0e-15_wp, 'null vector', floor=1.0_wp)
    call check_close(abs(sum(x)), 1.0_wp/sqrt(3.0_wp), 1.0e-15_wp, 'unit vector')
    call check_close(sign_of_determinant(reshape([0.0_wp, 2.0_wp, 3.0_wp, 1.0_wp], [2, 2])), &
                     -1.0_wp, 1.0e-15_wp, 'sign of the determinant')
  end subroutine run_pseudo_inverses

  !> Eigenvalues of [1 c; 0 d] have the condition sqrt(1 + (c/(1 - d))^2), in any orthonormal axes.
  !! A double eigenvalue with two eigenvectors has the condition 1.
  subroutine run_conditions()
    real(wp) :: a(3, 3), turn(3, 3), conditions(3), c
    complex(wp) :: values(3)
    logical :: found
    integer :: i

    turn = reshape([2.0_wp, -1.0_wp, 2.0_wp, 2.0_wp, 2.0_wp, -1.0_wp, -1.0_wp, 2.0_wp, 2.0_wp]/3, &
                   [3, 3])
    do i = 0, 3
      c = 10.0_wp**i
      a = 0.0_wp
      a(1, 1) = 1.0_wp
      a(1, 2) = c
      a(2, 2) = 0.5_wp
      a(3, 3) = -0.2_wp
      a = matmul(turn, matmul(a, transpose(turn)))
      call eigenvalues(a, values, found)
      call eigenvalue_conditions(a, values, conditions)
      call check_close(conditions(1), sqrt(1.0_wp + (c/0.5_wp)**2), 1.0e-6_wp, 'condition')
      call check_close(conditions(3), 1.0_wp, 1.0e-6_wp, 'apart')
    end do
    a = reshape([2.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 2.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [3, 3])
    call eigenvalues(a, values, found)
    call eigenvalue_conditions(a, values, conditions)
    call check_close(maxval(conditions), 1.0_wp, 1.0e-12_wp, 'twice')
  end subroutine run_conditions

  subroutine run_factors()
    complex(wp), allocatable :: a(:, :), b(:, :), product(:, :)
    logical :: singular
    integer :: n, i, j

    if (begin('inverse times matrix is the identity')) then
      do n = 1, 6
        allocate (a(n, n), b(n, n))
        do j = 1, n
          do i = 1, n
            a(i, j) = cmplx(sin(1.0_wp*i*j + n), cos(2.0_wp*i - 3.0_wp*j), wp)
          end do
        end do
        call invert(a, b, singular)
        call check(.not. singular, 'regular')
        product = matmul(a, b)
        do i = 1, n
          product(i, i) = product(i, i) - 1.0_wp
        end do
        call check_close(maxval(abs(product)), 0.0_wp, 1.0e-13_wp, 'residual', floor=1.0_wp)
        deallocate (a, b)
      end do
    end if

    if (begin('factors solve what needs exchanges of rows')) call solve_some()

    if (begin('factors in blocks are the same factors')) call compare_factors()

    if (begin('what is linear is eliminated first')) call compare_bordered()

    if (begin('a zero pivot is exchanged')) then
      a = reshape([(0.0_wp, 0.0_wp), (1.0_wp, 0.0_wp), (0.0_wp, 0.0_wp), (2.0_wp, 0.0_wp), &
                   (0.0_wp, 0.0_wp), (0.0_wp, 0.0_wp), (0.0_wp, 0.0_wp), (0.0_wp, 0.0_wp), &
                   (0.0_wp, 1.0_wp)], [3, 3])
      allocate (b(3, 3))
      call invert(a, b, singular)
      call check(.not. singular, 'regular')
      call check_close(real(b(2, 1)), 0.5_wp, 1.0e-15_wp, 'b_21')
      call check_close(aimag(b(3, 3)), -1.0_wp, 1.0e-15_wp, 'b_33')
      deallocate (b)
    end if

    if (begin('singular matrices are reported')) then
      do n = 1, 4
        a = reshape([((1.0_wp, 1.0_wp), i=1, n*n)], [n, n])
        if (n == 1) a = (0.0_wp, 0.0_wp)
        allocate (b(n, n))
        call invert(a, b, singular)
        call check(singular, 'singular')
        call check(.not. any(abs(b) > 0.0_wp), 'inverse is zero')
        deallocate (b)
      end do
    end if
  end subroutine run_factors

  subroutine solve_some()
    real(wp), allocatable :: matrix(:, :), factors(:, :), x(:), right(:)
    integer, allocatable :: pivots(:)
    logical :: singular
    integer :: n, i, j

    do n = 1, 12
      allocate (matrix(n, n), x(n), pivots(n))
      do j = 1, n
        do i = 1, n
          matrix(i, j) = sin(1.7_wp*i*j + 0.3_wp*n) + merge(0.0_wp, 1.0e-3_wp, i == j)
        end do
        x(j) = cos(1.0_wp*j)
      end do
      right = matmul(matrix, x)
      factors = matrix
      call factorize(n, factors, pivots, singular)
      call check(.not. singular, 'regular')
      call solve(n, factors, pivots, right)
      call check_close(maxval(abs(matmul(matrix, right) - matmul(matrix, x))), 0.0_wp, 1.0e-12_wp, &
                       'residual', floor=1.0_wp)
      deallocate (matrix, x, pivots)
    end do
    allocate (matrix(2, 2), source=1.0_wp)
    allocate (pivots(2))
    call factorize(2, matrix, pivots, singular)
    call check(singular, 'singular')
  end subroutine solve_some

  subroutine compare_factors()
    integer, parameter :: sizes(7) = [1, 9, 47, 48, 49, 130, 205]
    real(wp), allocatable :: matrix(:, :), blocks(:, :)
    integer, allocatable :: pivots(:), other(:)
    logical :: singular
    integer :: n, i, j, k

    do k = 1, size(sizes)
      n = sizes(k)
      allocate (matrix(n, n), blocks(n, n), pivots(n), other(n))
      do j = 1, n
        do i = 1, n
          matrix(i, j) = sin(1.7_wp*i*j + 0.3_wp*n) + merge(0.0_wp, 1.0e-3_wp, i == j)
        end do
      end do
      blocks = matrix
      call factorize_padded(n, n, matrix, pivots, singular)
      call check(.not. singular, 'regular')
      call factorize_blocks(n, blocks, other, singular)
      call check(.not. singular, 'regular in blocks')
      call check(all(pivots == other), 'the same exchanges')
      call check_close(maxval(abs(matrix - blocks)), 0.0_wp, 1.0e-9_wp, 'factors', &
                       floor=maxval(abs(matrix)))
      deallocate (matrix, blocks, pivots, other)
    end do
    allocate (matrix(60, 60), source=1.0_wp)
    allocate (pivots(60))
    call factorize_blocks(60, matrix, pivots, singular)
    call check(singular, 'singular')
  end subroutine compare_factors

  !> Equations in which some blocks couple to all blocks only in pairs, against dense factorization:
  !! solutions, determinants and pivots. In one of three cases a pair is nearly singular.
  subroutine compare_bordered()
    integer, parameter :: blocks = 3, n_pairs = 13, m = 2*n_pairs, n = blocks*m + 1
    type(curve_factors) :: factors
    real(wp) :: whole(n, n), x(n), right(n), sizes(n), logarithm, known, largest, smallest
    integer :: pivots(n), sign, sign_known, draw, i, j, k, pair
    logical :: loose(blocks), is_loose(n), singular

    sizes = 1.0_wp
    do draw = 1, 60
      if (mod(draw, 8) == 7) cycle
      loose = [(mod(draw/2**(i - 1), 2) == 1, i=1, blocks)]
      is_loose = .false.
      do j = 1, blocks
        is_loose((j - 1)*m + 1:j*m) = loose(j)
      end do
      do j = 1, n
        do i = 1, n
          whole(i, j) = sin(1.7_wp*i*j + 0.31_wp*draw + 0.2_wp*i)
          if (max(i, j) == n .or. mod(i - 1, m)/2 == mod(j - 1, m)/2) cycle
          if (is_loose(i) .or. is_loose(j)) whole(i, j) = 0.0_wp
        end do
      end do
      i = findloc(loose, .true., 1)
      ! One pair has small pivots. In every fifth matrix all pairs do, and none is eliminated.
      do pair = 1, merge(n_pairs, 0, i > 0)
        if (mod(draw, 5) /= 0 .and. (mod(draw, 3) /= 0 .or. pair /= mod(draw, n_pairs) + 1)) cycle
        k = (i - 1)*m + 2*pair - 1
        do j = 1, blocks
          if (loose(j)) whole(k:k + 1, k + (j - i)*m:k + (j - i)*m + 1) = 0.0_wp
        end do
        whole(k, k) = 1.0e-15_wp
        whole(k + 1, k + 1) = 1.0e-15_wp
      end do
      x = [(cos(1.0_wp*j), j=1, n)]
      right = matmul(whole, x)
      call new_factors(factors, n - 1, blocks)
      factors%matrix(:n, :) = whole
      call factors%decompose(sizes, singular)
      call check(.not. singular, 'regular')
      call factors%solve(right)
      call factors%determinant(.true., sign, logarithm)
      call factors%pivots_of(sizes, sizes, largest, smallest)
      call check(smallest > 0.0_wp .and. largest < 1.0e3_wp, 'no pivot is large')
      call factorize_padded(n, n, whole, pivots, singular)
      sign_known = product([(merge(-1, 1, pivots(i) /= i .neqv. whole(i, i) < 0.0_wp), i=1, n)])
      known = sum([(log(abs(whole(i, i))), i=1, n)])
      call check(sign == sign_known, 'sign of the determinant')
      call check_close(logarithm, known, 1.0e-11_wp, 'its logarithm')
      call check_close(maxval(abs(right - x)), 0.0_wp, 1.0e-10_wp, 'solution', floor=1.0_wp)
    end do
  end subroutine compare_bordered

end module test_dense
