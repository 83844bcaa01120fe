!> Detection of two crossings between adjacent points with equal numbers of growing exponents.
!!
!! With multipliers mu the products of (mu - 1)/|mu|^(1/2), (mu + 1)/|mu|^(1/2) and, over pairs,
!! (mu mu' - 1)/|mu mu'|^(1/2) are smooth along a curve, also where multipliers meet, and vanish
!! at folds and branch points, at period doublings and at Neimark-Sacker bifurcations. A cubic
!! through four adjacent points shows whether a product dips toward 0 between the middle two.
module viscovib_crossing_dips
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: tests_of, find_dip

  integer, parameter, public :: n_tests = 3
  !> A dip is examined below the first fraction of the smaller end value, or below the second
  !! fraction of the largest of the four values, the possible error of the cubic.
  real(wp), parameter :: deep = 0.2_wp, wrong = 0.03_wp
  integer, parameter :: n_places = 19
  !> Limits of |log mu| in the scaling of factors, of |log mu| of all multipliers, and of the
  !! products.
  real(wp), parameter :: level = 20.0_wp, largest_log = 300.0_wp, largest = 1.0e100_wp

contains

  !> The three products; 0 if not computable.
  pure function tests_of(eta) result(tests)
    !> Logarithms of multipliers.
    complex(wp), intent(in) :: eta(:)
    real(wp) :: tests(n_tests)
    complex(wp) :: mu(size(eta)), products(n_tests)
    integer :: j, k, n

    tests = 0.0_wp
    n = 0
    do k = 1, size(eta)
      if (.not. ieee_is_finite(real(eta(k)))) cycle
      if (abs(real(eta(k))) > largest_log) return
      n = n + 1
      mu(n) = eta(k)
    end do
    products = 1.0_wp
    do k = 1, n
      products(1) = products(1)*factor_of(mu(k), 1.0_wp)
      products(2) = products(2)*factor_of(mu(k), -1.0_wp)
      do j = 1, k - 1
        products(3) = products(3)*factor_of(mu(k) + mu(j), 1.0_wp)
        if (abs(products(3)) > largest) return
      end do
      if (maxval(abs(products)) > largest) return
    end do
    tests = real(products)
  end function tests_of

  !> (m - m_0)/|m|^(1/2) of m = exp(log_m). Beyond `level` the scaling |m|^(1/2) is kept constant,
  !! so that multipliers far from the unit circle do not overflow.
  pure complex(wp) function factor_of(log_m, m_0)
    complex(wp), intent(in) :: log_m
    real(wp), intent(in) :: m_0
    associate (r => real(log_m))
      factor_of = (exp(log_m) - m_0)*exp(-0.5_wp*max(r, -level) - 0.5_wp*max(r - level, 0.0_wp))
    end associate
  end function factor_of

  !> The test that may vanish between points i and i + 1 (0: none), and its location, 0 to 1.
  pure subroutine find_dip(tests, p, x, i, which, at)
    !> Shape (n_tests, n); the points, shapes (n) and (n_unknowns, n).
    real(wp), intent(in) :: tests(:, :), p(:), x(:, :)
    integer, intent(in) :: i
    integer, intent(out) :: which
    real(wp), intent(out) :: at
    real(wp) :: s(4), length, f, depth, deepest, lower, doubt, weights(4, n_places)
    integer :: first, last, j, k, t, m, n

    which = 0
    at = 0.5_wp
    first = max(1, i - 1)
    last = min(size(p), i + 2)
    if (last - first < 2) return
    s(1) = 0.0_wp
    do j = first, last - 1
      length = norm2(x(:, j + 1) - x(:, j))/max(norm2(x(:, j)), norm2(x(:, j + 1)), tiny(1.0_wp)) &
               + abs(p(j + 1) - p(j))/max(abs(p(j)), abs(p(j + 1)), tiny(1.0_wp))
      if (.not. length > 0.0_wp) return
      s(j - first + 2) = s(j - first + 1) + length
    end do
    ! Lagrange polynomials of the adjacent points, at locations between points i and i + 1.
    n = last - first + 1
    weights = 1.0_wp
    do m = 1, n_places
      f = s(i - first + 1) + m/(n_places + 1.0_wp)*(s(i - first + 2) - s(i - first + 1))
      do j = 1, n
        do k = 1, n
          if (k /= j) weights(j, m) = weights(j, m)*(f - s(k))/(s(j) - s(k))
        end do
      end do
    end do
    deepest = 1.0_wp
    do t = 1, n_tests
      associate (f_of => tests(t, first:last), ends => tests(t, i:i + 1))
        if (.not. all(abs(f_of) > 0.0_wp)) cycle
        if (.not. ends(1)*ends(2) > 0.0_wp) cycle
        lower = minval(abs(ends))
        doubt = max(deep, min(1.0_wp, wrong*maxval(abs(f_of))/lower))
        do m = 1, n_places
          depth = sum(f_of*weights(:n, m))*sign(1.0_wp, ends(1))/lower/doubt
          if (.not. depth < deepest) cycle
          deepest = depth
          which = t
          at = m/(n_places + 1.0_wp)
        end do
      end associate
    end do
  end subroutine find_dip

end module viscovib_crossing_dips
