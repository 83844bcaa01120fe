! Optimize: -O3
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

  public :: tests_of, find_dip, lengths_of

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
    complex(wp) :: products(n_tests)
    !> Multipliers and their logarithms.
    complex(wp) :: m(size(eta))
    real(wp) :: logs(size(eta))
    integer :: j, k, n

    tests = 0.0_wp
    n = 0
    do k = 1, size(eta)
      if (.not. ieee_is_finite(real(eta(k)))) cycle
      if (abs(real(eta(k))) > largest_log) return
      n = n + 1
      m(n) = exp(eta(k))
      logs(n) = real(eta(k))
    end do
    products = 1.0_wp
    do k = 1, n
      products(1) = products(1)*((m(k) - 1.0_wp)*scale_of(logs(k)))
      products(2) = products(2)*((m(k) + 1.0_wp)*scale_of(logs(k)))
      do j = 1, k - 1
        products(3) = products(3)*((m(k)*m(j) - 1.0_wp)*scale_of(logs(k) + logs(j)))
        if (abs(products(3)) > largest) return
      end do
      if (maxval(abs(products)) > largest) return
    end do
    tests = real(products)
  end function tests_of

  !> |m|^(-1/2) by log |m|; below -`level` constant, above `level` a constant over |m|, so that
  !! multipliers far from the unit circle do not overflow.
  pure real(wp) function scale_of(log_m)
    real(wp), intent(in) :: log_m
    scale_of = exp(-0.5_wp*max(log_m, -level) - 0.5_wp*max(log_m - level, 0.0_wp))
  end function scale_of

  !> Lengths of the steps between adjacent points, relative to them; 0 if two are the same.
  pure function lengths_of(p, x) result(lengths)
    !> The points, shapes (n) and (n_unknowns, n).
    real(wp), intent(in) :: p(:), x(:, :)
    real(wp) :: lengths(size(p) - 1)
    real(wp) :: squares(size(p))
    integer :: j

    do j = 1, size(p)
      squares(j) = sum(x(:, j)**2)
    end do
    do j = 1, size(lengths)
      lengths(j) = sqrt(sum((x(:, j + 1) - x(:, j))**2) &
                        /max(squares(j), squares(j + 1), tiny(1.0_wp))) &
                   + abs(p(j + 1) - p(j))/max(abs(p(j)), abs(p(j + 1)), tiny(1.0_wp))
    end do
  end function lengths_of

  !> The test that may vanish between points i and i + 1 (0: none), and its location, 0 to 1.
  pure subroutine find_dip(tests, lengths, i, which, at)
    !> Shape (n_tests, n), and the lengths between the n points.
    real(wp), intent(in) :: tests(:, :), lengths(:)
    integer, intent(in) :: i
    integer, intent(out) :: which
    real(wp), intent(out) :: at
    real(wp) :: depth, deepest, lower, limit, bend(2), part
    integer :: first, last, m, t

    which = 0
    at = 0.5_wp
    first = max(1, i - 1)
    last = min(size(tests, 2), i + 2)
    if (last - first < 2) return
    if (.not. all(lengths(first:last - 1) > 0.0_wp)) return
    deepest = 1.0_wp
    do t = 1, n_tests
      associate (f => tests(t, first:last), ends => tests(t, i:i + 1))
        if (.not. all(abs(f) > 0.0_wp)) cycle
        if (.not. ends(1)*ends(2) > 0.0_wp) cycle
        lower = minval(abs(ends))
        limit = lower*max(deep, min(1.0_wp, wrong*maxval(abs(f))/lower))
        bend = sign(1.0_wp, ends(1))*bends(f, lengths(first:last - 1), i - first)
        ! At least the smaller end value less the largest deviation from the chord.
        if (lower - 0.25_wp*max(bend(1), bend(2)) > limit*deepest) cycle
        do m = 1, n_places
          part = m/(n_places + 1.0_wp)
          depth = ((1.0_wp - part)*abs(ends(1)) + part*abs(ends(2)) &
                   - part*(1.0_wp - part)*((1.0_wp - part)*bend(1) + part*bend(2)))/limit
          if (.not. depth < deepest) cycle
          deepest = depth
          which = t
          at = part
        end do
      end associate
    end do
  end subroutine find_dip

  !> The polynomial through adjacent points, between two of them, where u grows from 0 to 1, is (1 -
  !! u) f_1 + u f_2 - u (1 - u) ((1 - u) b_1 + u b_2) with the bends b, by divided differences.
  pure function bends(f, lengths, before) result(b)
    !> Values at 3 or 4 points, and the lengths between them.
    real(wp), intent(in) :: f(:), lengths(:)
    !> Number of points before the two, 0 or 1.
    integer, intent(in) :: before
    real(wp) :: b(2)
    real(wp) :: slopes(3), second(2), third
    integer :: k, n

    n = size(lengths)
    do k = 1, n
      slopes(k) = (f(k + 1) - f(k))/lengths(k)
    end do
    do k = 1, n - 1
      second(k) = (slopes(k + 1) - slopes(k))/(lengths(k) + lengths(k + 1))
    end do
    b = second(1)
    associate (h => lengths(before + 1))
      if (n == 3) then
        ! second(1) and second(2) are those at the first and last of the four points.
        third = (second(2) - second(1))/sum(lengths)
        b = second(1) + third*[lengths(1), lengths(1) + h]
      end if
      b = h**2*b
    end associate
  end function bends

end module viscovib_crossing_dips
