!> Polynomials through a few points, and their real zeros from 0 to 1.
module viscovib_interpolated_root
  use viscovib_dense, only: factorize, solve
  use viscovib_kinds, only: wp
  use viscovib_polynomial_zeros, only: polynomial_zeros
  implicit none
  private

  public :: interpolated, interpolated_roots

  !> Largest imaginary part of a zero that counts as real.
  real(wp), parameter :: real_enough = 1.0e-7_wp
  !> Iterations of Newton's method.
  integer, parameter :: max_turns = 3

contains

  !> The value at a position of the polynomial through values at x.
  pure real(wp) function interpolated(x, values, place)
    real(wp), intent(in) :: x(:), values(:), place
    real(wp) :: weight
    integer :: i, k
    interpolated = 0.0_wp
    do i = 1, size(x)
      weight = 1.0_wp
      do k = 1, size(x)
        if (k /= i) weight = weight*(place - x(k))/(x(i) - x(k))
      end do
      interpolated = interpolated + weight*values(i)
    end do
  end function interpolated

  pure subroutine interpolated_roots(x, values, roots)
    !> Ascending.
    real(wp), intent(in) :: x(:), values(:)
    real(wp), allocatable, intent(out) :: roots(:)
    real(wp) :: powers(size(x), size(x)), c(size(x)), middle, half
    complex(wp) :: zeros(size(x) - 1)
    integer :: i, k, n, pivots(size(x))
    logical :: found, singular

    n = size(x)
    middle = 0.5_wp*(x(1) + x(n))
    half = 0.5_wp*(x(n) - x(1))
    do i = 1, n
      powers(:, i) = ((x - middle)/half)**(n - i)
    end do
    c = values
    call factorize(n, powers, pivots, singular)
    if (.not. singular) call solve(n, powers, pivots, c)
    ! Leading coefficients of 0 have no zeros.
    i = findloc(abs(c) > 0.0_wp, .true., 1)
    allocate (roots(0))
    if (singular .or. i == 0 .or. i == n) return
    call polynomial_zeros(c(i:), zeros(i:), found)
    if (.not. found) return
    ! Small leading coefficients enlarge the rounding errors of zeros.
    do k = i, n - 1
      call polish(c, zeros(k))
    end do
    zeros(i:) = middle + half*zeros(i:)
    roots = pack(real(zeros(i:)), abs(aimag(zeros(i:))) < real_enough &
                 .and. real(zeros(i:)) >= 0.0_wp .and. real(zeros(i:)) <= 1.0_wp)
  end subroutine interpolated_roots

  !> Newton's method for a zero.
  pure subroutine polish(c, zero)
    !> Coefficients, that of the highest power first.
    real(wp), intent(in) :: c(:)
    complex(wp), intent(inout) :: zero
    complex(wp) :: slope, value
    integer :: i, turn
    do turn = 1, max_turns
      value = (0.0_wp, 0.0_wp)
      slope = (0.0_wp, 0.0_wp)
      do i = 1, size(c)
        slope = slope*zero + value
        value = value*zero + c(i)
      end do
      if (.not. abs(value) <= abs(slope)*abs(zero)) return
      zero = zero - value/slope
    end do
  end subroutine polish

end module viscovib_interpolated_root
