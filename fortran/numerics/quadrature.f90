! Optimize: -O3
!> Gauss quadrature: for polynomials on [0, 1], for a power weight, and for any
!! positive measure that is given as points and masses.
module viscovib_quadrature
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: gauss_nodes, gauss_power_nodes, legendre, lagrange, lagrange_factors
  public :: legendre_of_nodes
  public :: recurrence_of, nodes_of_recurrence

contains

  !> Gauss-Legendre nodes and weights on [0, 1]: Newton's method on the Legendre
  !! polynomial.
  pure subroutine gauss_nodes(s, c, b)
    integer, intent(in) :: s
    real(wp), intent(out) :: c(s), b(s)
    real(wp) :: x, p(0:s), slope
    integer :: i, k

    do i = 1, s
      x = cos(pi*(i - 0.25_wp)/(s + 0.5_wp))
      ! The start is accurate to three digits, and each iteration doubles their number.
      do k = 1, 4
        p = legendre(s, 0.5_wp*(1.0_wp + x))
        slope = s*(x*p(s) - p(s - 1))/(x**2 - 1.0_wp)
        x = x - p(s)/slope
      end do
      p = legendre(s, 0.5_wp*(1.0_wp + x))
      slope = s*(x*p(s) - p(s - 1))/(x**2 - 1.0_wp)
      c(s + 1 - i) = 0.5_wp*(1.0_wp + x)
      b(s + 1 - i) = 1.0_wp/((1.0_wp - x**2)*slope**2)
    end do
  end subroutine gauss_nodes

  !> Shifted Legendre polynomials P_0 ... P_n at t, orthogonal on [0, 1].
  pure function legendre(n, t) result(p)
    integer, intent(in) :: n
    real(wp), intent(in) :: t
    real(wp) :: p(0:n), x
    integer :: k
    x = 2.0_wp*t - 1.0_wp
    p(0) = 1.0_wp
    if (n > 0) p(1) = x
    do k = 1, n - 1
      p(k + 1) = ((2*k + 1)*x*p(k) - k*p(k - 1))/(k + 1)
    end do
  end function legendre

  !> Factors of `lagrange`: 1/product_(j/=k) (x_k - x_j).
  pure function lagrange_factors(points) result(factors)
    real(wp), intent(in) :: points(:)
    real(wp) :: factors(size(points))
    integer :: j, k
    factors = 1.0_wp
    do k = 1, size(points)
      do j = 1, size(points)
        if (j /= k) factors(k) = factors(k)/(points(k) - points(j))
      end do
    end do
  end function lagrange_factors

  !> Values at x of the polynomials that are 1 at one of the points and 0 at the
  !! other points.
  pure function lagrange(points, factors, x) result(basis)
    !> Points, and their `lagrange_factors`.
    real(wp), intent(in) :: points(:), factors(:), x
    real(wp) :: basis(size(points)), product
    integer :: k
    product = 1.0_wp
    do k = 1, size(points)
      basis(k) = product*factors(k)
      product = product*(x - points(k))
    end do
    product = 1.0_wp
    do k = size(points), 1, -1
      basis(k) = basis(k)*product
      product = product*(x - points(k))
    end do
  end function lagrange

  !> Legendre coefficients on [0, 1] of l_i(x c), with l_i the polynomials that are 1 at one of the
  !! Gauss nodes and 0 at the others, shape (0:s-1, s).
  pure function legendre_of_nodes(nodes, weights, c) result(coefficients)
    real(wp), intent(in) :: nodes(:), weights(:)
    !> End of the interval, relative to that of the nodes.
    real(wp), intent(in) :: c
    real(wp) :: coefficients(0:size(nodes) - 1, size(nodes))
    real(wp) :: factors(size(nodes)), orders(0:size(nodes)), values(size(nodes))
    integer :: j, k

    coefficients = 0.0_wp
    factors = lagrange_factors(nodes)
    do k = 1, size(nodes)
      orders = legendre(size(nodes), nodes(k))
      values = lagrange(nodes, factors, c*nodes(k))
      do j = 0, size(nodes) - 1
        coefficients(j, :) = coefficients(j, :) + (2*j + 1)*weights(k)*orders(j)*values
      end do
    end do
  end function legendre_of_nodes

  !> Gauss nodes and weights for the integral of x^(alpha-1) f(x) over [0, 1],
  !! alpha > 0, by the recurrence of the Jacobi polynomials (Abramowitz and
  !! Stegun, 22.7.15, exponents 0 and alpha - 1).
  pure subroutine gauss_power_nodes(n, alpha, x, w)
    integer, intent(in) :: n
    real(wp), intent(in) :: alpha
    real(wp), intent(out) :: x(n), w(n)
    real(wp) :: diagonal(n), nearby(n), b, m
    integer :: k

    b = alpha - 1.0_wp
    ! Nodes are (1 + t)/2 of those on [-1, 1].
    diagonal(1) = alpha/(alpha + 1.0_wp)
    do k = 1, n - 1
      m = 2*k + b
      diagonal(k + 1) = 0.5_wp*(1.0_wp + b**2/(m*(m + 2.0_wp)))
      nearby(k) = 0.5_wp*sqrt(4.0_wp*k**2*(k + b)**2/(m**2*(m + 1.0_wp)*(m - 1.0_wp)))
    end do
    ! m - 1 = alpha for k = 1 cancels one factor of (k + b)^2 = alpha^2.
    if (n > 1) nearby(1) = sqrt(alpha/(2.0_wp + alpha))/(1.0_wp + alpha)
    call nodes_of_recurrence(n, diagonal, nearby, x, w)
    w = w/alpha
  end subroutine gauss_power_nodes

  !> Recurrence coefficients of the polynomials orthogonal with positive masses:
  !! Lanczos's method with full orthogonalisation (Gragg and Harrod, Numer. Math.
  !! 44, 1984, for the problem).
  pure subroutine recurrence_of(points, masses, n, diagonal, nearby, found)
    !> Shape (m); masses > 0.
    real(wp), intent(in) :: points(:), masses(:)
    integer, intent(in) :: n
    !> Shape (n); `nearby(k)` couples k and k + 1.
    real(wp), intent(out) :: diagonal(n), nearby(n)
    !> Number of polynomials, less than n if there are fewer points.
    integer, intent(out) :: found
    real(wp) :: basis(size(points), n), v(size(points))
    integer :: k, j

    diagonal = 0.0_wp
    nearby = 0.0_wp
    v = sqrt(masses/sum(masses))
    do k = 1, n
      found = k
      basis(:, k) = v
      v = points*basis(:, k)
      diagonal(k) = dot_product(v, basis(:, k))
      do j = k, 1, -1
        v = v - dot_product(v, basis(:, j))*basis(:, j)
      end do
      nearby(k) = norm2(v)
      if (k == size(points)) return
      if (.not. nearby(k) > epsilon(1.0_wp)**2*maxval(abs(points))) return
      v = v/nearby(k)
    end do
  end subroutine recurrence_of

  !> Gauss nodes, ascending, and weights of mass 1 from recurrence coefficients:
  !! eigenvalues and first components of the eigenvectors of the tridiagonal
  !! matrix by implicit QL (Golub and Welsch, Math. Comp. 23, 1969).
  pure subroutine nodes_of_recurrence(n, diagonal, nearby, nodes, weights)
    integer, intent(in) :: n
    real(wp), intent(in) :: diagonal(n), nearby(n)
    real(wp), intent(out) :: nodes(n), weights(n)
    integer, parameter :: max_turns = 60
    real(wp) :: d(n), e(n), z(n), g, r, s, c, p, f, b
    integer :: i, k, m, turn

    d = diagonal
    e = nearby
    e(n) = 0.0_wp
    z = 0.0_wp
    z(1) = 1.0_wp
    do k = 1, n
      do turn = 1, max_turns
        do m = k, n - 1
          if (abs(e(m)) <= epsilon(1.0_wp)*(abs(d(m)) + abs(d(m + 1)))) exit
        end do
        if (m == k) exit
        g = (d(k + 1) - d(k))/(2.0_wp*e(k))
        r = hypot(g, 1.0_wp)
        g = d(m) - d(k) + e(k)/(g + sign(r, g))
        s = 1.0_wp
        c = 1.0_wp
        p = 0.0_wp
        do i = m - 1, k, -1
          f = s*e(i)
          b = c*e(i)
          r = hypot(f, g)
          e(i + 1) = r
          if (.not. r > 0.0_wp) then
            d(i + 1) = d(i + 1) - p
            e(m) = 0.0_wp
            exit
          end if
          s = f/r
          c = g/r
          g = d(i + 1) - p
          r = (d(i) - g)*s + 2.0_wp*c*b
          p = s*r
          d(i + 1) = g + p
          g = c*r - b
          f = z(i + 1)
          z(i + 1) = s*z(i) + c*f
          z(i) = c*z(i) - s*f
        end do
        if (i >= k) cycle
        d(k) = d(k) - p
        e(k) = g
        e(m) = 0.0_wp
      end do
    end do
    do k = 1, n
      i = minloc(d, 1)
      nodes(k) = d(i)
      weights(k) = z(i)**2
      d(i) = huge(1.0_wp)
    end do
  end subroutine nodes_of_recurrence

end module viscovib_quadrature
