!> Zeros of a real polynomial: all of them, and the real ones of a cubic.
module viscovib_polynomial_zeros
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: polynomial_zeros, cubic_roots

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

  !> Real solutions of c1 x^3 + c2 x^2 + c3 x + c4 = 0, polished by Newton's method.
  pure subroutine cubic_roots(c, x, n)
    real(wp), intent(in) :: c(4)
    real(wp), intent(out) :: x(3)
    integer, intent(out) :: n
    real(wp) :: unit, p(4), a, q, r, angle, root, value, slope, step, work
    real(wp), parameter :: third_turn = 2.0943951023931953_wp
    integer :: i, k, round

    x = 0.0_wp
    n = 1
    ! Scale x so that the outer coefficients have equal size.
    if (.not. c(1) > 0.0_wp) then
      n = merge(1, 0, c(3) > 0.0_wp)
      if (n == 1) x(1) = -c(4)/c(3)
      return
    end if
    unit = max((abs(c(4))/c(1))**(1.0_wp/3.0_wp), sqrt(c(3)/c(1)))
    if (.not. unit > 0.0_wp) return
    p = [1.0_wp, c(2)/c(1)/unit, c(3)/c(1)/unit**2, c(4)/c(1)/unit**3]
    a = p(2)/3.0_wp
    q = (p(2)**2 - 3.0_wp*p(3))/9.0_wp
    r = (2.0_wp*p(2)**3 - 9.0_wp*p(2)*p(3) + 27.0_wp*p(4))/54.0_wp
    if (r**2 < q**3) then
      n = 3
      angle = acos(max(-1.0_wp, min(1.0_wp, r/sqrt(q**3))))
      do i = 1, 3
        x(i) = -2.0_wp*sqrt(q)*cos(angle/3.0_wp + third_turn*(i - 2)) - a
      end do
    else
      root = -sign((abs(r) + sqrt(max(r**2 - q**3, 0.0_wp)))**(1.0_wp/3.0_wp), r)
      x(1) = root - a
      if (abs(root) > 0.0_wp) x(1) = x(1) + q/root
    end if
    ! Small roots have the absolute error of large ones: Newton's method improves them while
    ! its steps decrease, and never beyond half the distance to another root.
    do i = 1, n
      work = 1.0_wp
      do k = 1, n
        if (k /= i) work = min(work, 0.5_wp*abs(x(i) - x(k)))
      end do
      do round = 1, 8
        value = p(4) + x(i)*(p(3) + x(i)*(p(2) + x(i)))
        slope = p(3) + x(i)*(2.0_wp*p(2) + 3.0_wp*x(i))
        if (.not. abs(slope) > 0.0_wp) exit
        step = value/slope
        if (.not. abs(step) <= work) exit
        work = 0.5_wp*work
        x(i) = x(i) - step
        if (abs(step) <= epsilon(step)*abs(x(i))) exit
      end do
    end do
    x = x*unit
  end subroutine cubic_roots

end module viscovib_polynomial_zeros
