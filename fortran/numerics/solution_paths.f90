! Optimize: -O2 -fvect-cost-model=dynamic -fstack-arrays
!> Path tracking of solutions of small polynomial systems of degree 3 while the coefficients change
!! along a line, or from a product of linear forms (Sommese and Wampler, The numerical solution of
!! systems of polynomials, 2005, chapters 2 and 8).
!!
!! Each step is extrapolated by the cubic through the last two points and their tangents, and
!! corrected by Newton's method; the last matrix of the correction gives the next tangent. The size
!! of a complex number is the sum of the moduli of both parts, without a square root.
module viscovib_solution_paths
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: polynomials_type, follow, correct, size_of, infinite

  integer, parameter, public :: max_unknowns = 6
  integer, parameter :: max_steps = 1000
  !> Solutions larger than this are at infinity.
  real(wp), parameter :: infinite = 1.0e4_wp
  !> Size and remaining t for which a path to random coefficients counts as diverging.
  real(wp), parameter :: large = 1.0e3_wp, late = 1.0e-8_wp
  !> Smallest unit for relative errors of x.
  real(wp), parameter :: least_size = 1.0e-3_wp

  !> sum over terms of coefficient x_i x_j x_k in equation row.
  type :: polynomials_type
    integer :: n = 0
    !> Shape (n_terms) and (3, n_terms); 0: no factor.
    integer, allocatable :: row(:), at(:, :)
  end type polynomials_type

contains

  !> Follow one path of (1 - t) from + t to = 0, t from 0 to 1. With linear forms instead of `from`,
  !! of (1 - t) (product of the forms) + t to.
  pure subroutine follow(system, from, to, limit, careful, x, ended, forms)
    type(polynomials_type), intent(in) :: system
    complex(wp), intent(in) :: from(:), to(:)
    !> Bound of x; a larger path is abandoned.
    real(wp), intent(in) :: limit
    !> Use shorter steps, for paths that come close to each other.
    logical, intent(in) :: careful
    complex(wp), intent(inout) :: x(:)
    logical, intent(out) :: ended
    !> For each equation, the constant first, shape (0:n, 3, n).
    complex(wp), intent(in), optional :: forms(0:, :, :)
    complex(wp), dimension(max_unknowns) :: old, old_tangent, tangent, new, f, by_t
    complex(wp) :: slope(max_unknowns**2)
    real(wp) :: t, h, last, error, before, first, largest_first, enough
    integer :: n, step, round
    logical :: singular, settled

    largest_first = merge(2.0e-3_wp, 2.0e-2_wp, careful)
    enough = merge(1.0e-8_wp, 1.0e-6_wp, careful)
    ended = .false.
    t = 0.0_wp
    h = 0.02_wp
    last = 0.0_wp
    n = system%n
    old(:n) = x
    call evaluate_between(n, system, from, to, t, x, f, slope, by_t, forms)
    call solve_two(n, slope, f, by_t, singular)
    if (singular) return
    tangent(:n) = -by_t(:n)
    old_tangent(:n) = tangent(:n)
    do step = 1, max_steps
      if (t >= 1.0_wp) exit
      h = min(h, 1.0_wp - t)
      new(:n) = x + h*tangent(:n)
      if (last > 0.0_wp) call bend(h/last, new)
      settled = .false.
      first = 0.0_wp
      before = 1.0_wp
      do round = 1, 3
        call evaluate_between(n, system, from, to, t + h, new, f, slope, by_t, forms)
        call solve_two(n, slope, f, by_t, singular)
        if (singular) exit
        new(:n) = new(:n) - f(:n)
        error = size_of(f(:n))/max(size_of(new(:n)), least_size)
        if (round == 1) first = error
        ! A large first correction may lead to another path.
        if (.not. error <= largest_first) exit
        ! Convergence is quadratic: the error left is the next correction, error^3/before^2.
        settled = error <= enough
        if (round > 1) settled = settled .or. error*(error/before)**2 <= 0.01_wp*enough
        if (settled) exit
        before = error
      end do
      if (settled) then
        last = h
        old(:n) = x
        old_tangent(:n) = tangent(:n)
        x = new(:n)
        tangent(:n) = -by_t(:n)
        t = t + h
        if (size_of(x) > limit) return
        ! For random coefficients solutions are simple: a path that still grows this late diverges.
        if (present(forms) .and. 1.0_wp - t < late .and. t < 1.0_wp .and. size_of(x) > large) return
        h = h*min(3.0_wp, max(0.5_wp, (0.1_wp*largest_first/max(first, 1.0e-9_wp))**0.25_wp))
      else
        h = 0.4_wp*h
        if (h < 1.0e-12_wp) exit
      end if
    end do
    ! Convergence to a double solution is slow: a point near the end counts as the end.
    if (t < 1.0_wp - merge(0.0_wp, 1.0e-7_wp, present(forms))) return
    do round = 1, 5
      call evaluate(n, system, to, x, f, slope)
      by_t(:n) = f(:n)
      call solve_two(n, slope, f, by_t, singular)
      if (singular) exit
      if (.not. size_of(f(:n)) <= 1.0e-2_wp*max(size_of(x), least_size)) exit
      x = x - f(:n)
    end do
    call clear(x)
    ended = size_of(x) <= infinite

  contains

    !> Add the contribution of the cubic to the tangent, with the step in units of the last one.
    pure subroutine bend(part, new)
      real(wp), intent(in) :: part
      complex(wp), intent(inout) :: new(:)
      complex(wp) :: a, c
      integer :: i
      do i = 1, n
        a = old(i) - x(i) + last*tangent(i)
        c = last*(old_tangent(i) - tangent(i)) + 2.0_wp*a
        new(i) = new(i) + part**2*((a + c) + part*c)
      end do
    end subroutine bend

  end subroutine follow

  !> Newton's method from near a solution; `found` is false if it does not converge at once.
  pure subroutine correct(system, coefficients, x, found)
    type(polynomials_type), intent(in) :: system
    complex(wp), intent(in) :: coefficients(:)
    complex(wp), intent(inout) :: x(:)
    logical, intent(out) :: found
    complex(wp) :: f(max_unknowns), slope(max_unknowns**2), copy(max_unknowns)
    real(wp) :: error, before
    integer :: n, round
    logical :: singular

    found = .false.
    before = 0.2_wp
    n = system%n
    do round = 1, 10
      call evaluate(n, system, coefficients, x, f, slope)
      copy(:n) = f(:n)
      call solve_two(n, slope, f, copy, singular)
      if (singular) return
      x = x - f(:n)
      error = size_of(f(:n))/max(size_of(x), least_size)
      if (.not. error <= before) return
      ! Convergence is quadratic: further corrections are rounding.
      found = error <= 1.0e-8_wp
      if (found) exit
      before = 0.3_wp*error
    end do
    call clear(x)
  end subroutine correct

  !> Set tiny numbers to 0, which represent unknowns at rest.
  pure subroutine clear(x)
    complex(wp), intent(inout) :: x(:)
    where (abs(real(x)) + abs(aimag(x)) <= 1.0e-24_wp) x = (0.0_wp, 0.0_wp)
  end subroutine clear

  !> The largest of |re| + |im|.
  pure real(wp) function size_of(x)
    complex(wp), intent(in) :: x(:)
    size_of = maxval(abs(real(x)) + abs(aimag(x)))
  end function size_of

  !> Evaluate the combined system: value, slope, and derivative by t.
  pure subroutine evaluate_between(n, system, from, to, t, x, f, slope, by_t, forms)
    integer, intent(in) :: n
    type(polynomials_type), intent(in) :: system
    complex(wp), intent(in) :: from(:), to(:), x(n)
    real(wp), intent(in) :: t
    complex(wp), intent(out) :: f(n), slope(n, n), by_t(n)
    complex(wp), intent(in), optional :: forms(0:, :, :)
    complex(wp) :: y(0:max_unknowns), all_slopes(max_unknowns, 0:max_unknowns), c, change, p
    complex(wp) :: values(3)
    integer :: i, q, r

    if (present(forms)) then
      call evaluate(n, system, to, x, f, slope)
      by_t = f
      f = t*f
      slope = t*slope
      do r = 1, n
        do q = 1, 3
          values(q) = forms(0, q, r)
          do i = 1, n
            values(q) = values(q) + forms(i, q, r)*x(i)
          end do
        end do
        p = values(1)*values(2)*values(3)
        f(r) = f(r) + (1.0_wp - t)*p
        by_t(r) = by_t(r) - p
        values = (1.0_wp - t)*[values(2)*values(3), values(1)*values(3), values(1)*values(2)]
        do i = 1, n
          slope(r, i) = slope(r, i) + (forms(i, 1, r)*values(1) + forms(i, 2, r)*values(2) &
                                       + forms(i, 3, r)*values(3))
        end do
      end do
      return
    end if
    y(0) = (1.0_wp, 0.0_wp)
    y(1:n) = x
    f = (0.0_wp, 0.0_wp)
    by_t = (0.0_wp, 0.0_wp)
    all_slopes = (0.0_wp, 0.0_wp)
    do i = 1, size(system%row)
      r = system%row(i)
      change = to(i) - from(i)
      c = from(i) + t*change
      associate (a => system%at(1, i), b => system%at(2, i), d => system%at(3, i))
        p = y(a)*y(b)
        by_t(r) = by_t(r) + change*(p*y(d))
        p = c*p
        f(r) = f(r) + p*y(d)
        all_slopes(r, d) = all_slopes(r, d) + p
        p = c*y(d)
        all_slopes(r, a) = all_slopes(r, a) + p*y(b)
        all_slopes(r, b) = all_slopes(r, b) + p*y(a)
      end associate
    end do
    slope = all_slopes(:n, 1:n)
  end subroutine evaluate_between

  pure subroutine evaluate(n, system, coefficients, x, f, slope)
    integer, intent(in) :: n
    type(polynomials_type), intent(in) :: system
    complex(wp), intent(in) :: coefficients(:), x(n)
    complex(wp), intent(out) :: f(n), slope(n, n)
    complex(wp) :: y(0:max_unknowns), all_slopes(max_unknowns, 0:max_unknowns), p
    integer :: i, r

    y(0) = (1.0_wp, 0.0_wp)
    y(1:n) = x
    f = (0.0_wp, 0.0_wp)
    all_slopes = (0.0_wp, 0.0_wp)
    do i = 1, size(system%row)
      r = system%row(i)
      ! Missing factors are 1; their slopes are not read.
      associate (a => system%at(1, i), b => system%at(2, i), d => system%at(3, i))
        p = coefficients(i)*y(a)*y(b)
        f(r) = f(r) + p*y(d)
        all_slopes(r, d) = all_slopes(r, d) + p
        p = coefficients(i)*y(d)
        all_slopes(r, a) = all_slopes(r, a) + p*y(b)
        all_slopes(r, b) = all_slopes(r, b) + p*y(a)
      end associate
    end do
    slope = all_slopes(:n, 1:n)
  end subroutine evaluate

  !> A x = b and A y = c by elimination with row pivoting; A is overwritten.
  pure subroutine solve_two(n, a, b, c, singular)
    integer, intent(in) :: n
    complex(wp), intent(inout) :: a(n, n), b(n), c(n)
    logical, intent(out) :: singular
    complex(wp) :: factor, other
    real(wp) :: largest, here
    integer :: i, j, k, pivot

    singular = .true.
    do k = 1, n
      pivot = k
      largest = -1.0_wp
      do i = k, n
        here = abs(real(a(i, k))) + abs(aimag(a(i, k)))
        if (here > largest) then
          largest = here
          pivot = i
        end if
      end do
      if (.not. (largest > 0.0_wp .and. largest <= huge(1.0_wp))) return
      factor = a(pivot, k)
      a(pivot, k) = a(k, k)
      a(k, k) = 1.0_wp/factor
      do i = k + 1, n
        a(i, k) = a(i, k)*a(k, k)
      end do
      do j = k + 1, n
        factor = a(pivot, j)
        a(pivot, j) = a(k, j)
        a(k, j) = factor
        do i = k + 1, n
          a(i, j) = a(i, j) - a(i, k)*factor
        end do
      end do
      factor = b(pivot)
      b(pivot) = b(k)
      b(k) = factor
      other = c(pivot)
      c(pivot) = c(k)
      c(k) = other
      do i = k + 1, n
        b(i) = b(i) - a(i, k)*factor
        c(i) = c(i) - a(i, k)*other
      end do
    end do
    do k = n, 1, -1
      b(k) = b(k)*a(k, k)
      c(k) = c(k)*a(k, k)
      do i = 1, k - 1
        b(i) = b(i) - a(i, k)*b(k)
        c(i) = c(i) - a(i, k)*c(k)
      end do
    end do
    singular = .not. (size_of(b) <= huge(1.0_wp) .and. size_of(c) <= huge(1.0_wp))
  end subroutine solve_two

end module viscovib_solution_paths
