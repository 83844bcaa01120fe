!> Undamped modes K r = omega^2 M r of symmetric K and positive definite M.
module viscovib_symmetric_modes
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: find_symmetric_modes

  integer, parameter :: max_sweeps = 40

contains

  !> With M = L L', the eigenvalues of L^-1 K L'^-1 by Jacobi's rotations, which keep small ones
  !! to their last digits where the matrix allows it (Demmel and Veselic, SIAM J. Matrix Anal.
  !! Appl. 13 (1992) 1204).
  pure subroutine find_symmetric_modes(mass, stiffness, squares, shapes)
    !> Shape (n, n).
    real(wp), intent(in) :: mass(:, :), stiffness(:, :)
    !> omega^2, ascending, shape (n); a column each, shape (n, n).
    real(wp), intent(out) :: squares(:), shapes(:, :)
    real(wp) :: l(size(mass, 1), size(mass, 1)), a(size(mass, 1), size(mass, 1))
    real(wp) :: column(size(mass, 1)), value
    integer :: n, i, j, k

    n = size(mass, 1)
    l = 0.0_wp
    do j = 1, n
      l(j, j) = sqrt(mass(j, j) - sum(l(j, :j - 1)**2))
      do i = j + 1, n
        l(i, j) = (mass(i, j) - sum(l(i, :j - 1)*l(j, :j - 1)))/l(j, j)
      end do
    end do
    a = stiffness
    do k = 1, 2
      do j = 1, n
        do i = 1, n
          a(i, j) = (a(i, j) - sum(l(i, :i - 1)*a(:i - 1, j)))/l(i, i)
        end do
      end do
      a = transpose(a)
    end do
    call rotate_to_diagonal(a, shapes)
    do j = 1, n
      squares(j) = a(j, j)
      do i = n, 1, -1
        shapes(i, j) = (shapes(i, j) - sum(l(i + 1:, i)*shapes(i + 1:, j)))/l(i, i)
      end do
    end do
    do j = 2, n
      value = squares(j)
      column = shapes(:, j)
      k = j - 1
      do while (k >= 1)
        if (squares(k) <= value) exit
        squares(k + 1) = squares(k)
        shapes(:, k + 1) = shapes(:, k)
        k = k - 1
      end do
      squares(k + 1) = value
      shapes(:, k + 1) = column
    end do
  end subroutine find_symmetric_modes

  pure subroutine rotate_to_diagonal(a, vectors)
    real(wp), intent(inout) :: a(:, :)
    real(wp), intent(out) :: vectors(:, :)
    real(wp) :: t, c, s, theta, one(size(a, 1)), other(size(a, 1))
    integer :: i, p, q, sweep
    logical :: done

    vectors = 0.0_wp
    do i = 1, size(a, 1)
      vectors(i, i) = 1.0_wp
    end do
    do sweep = 1, max_sweeps
      done = .true.
      do p = 1, size(a, 1) - 1
        do q = p + 1, size(a, 1)
          if (abs(a(p, q)) <= epsilon(1.0_wp)*sqrt(abs(a(p, p)))*sqrt(abs(a(q, q)))) cycle
          done = .false.
          theta = 0.5_wp*(a(q, q) - a(p, p))/a(p, q)
          t = sign(1.0_wp, theta)/(abs(theta) + hypot(1.0_wp, theta))
          c = 1.0_wp/hypot(1.0_wp, t)
          s = t*c
          one = a(:, p)
          other = a(:, q)
          a(:, p) = c*one - s*other
          a(:, q) = s*one + c*other
          one = a(p, :)
          other = a(q, :)
          a(p, :) = c*one - s*other
          a(q, :) = s*one + c*other
          one = vectors(:, p)
          other = vectors(:, q)
          vectors(:, p) = c*one - s*other
          vectors(:, q) = s*one + c*other
        end do
      end do
      if (done) exit
    end do
  end subroutine rotate_to_diagonal

end module viscovib_symmetric_modes
