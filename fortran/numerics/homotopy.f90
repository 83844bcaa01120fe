!> All isolated solutions of a small polynomial system of degree 3, by following paths from
!! a system whose solutions are known (Sommese and Wampler, The numerical solution of systems
!! of polynomials, 2005, chapters 2, 7 and 8): first from x_i^d = 1 to a system of the same
!! terms with coefficients at random, and from its finite solutions to any wanted one.
module viscovib_homotopy
  use viscovib_dense, only: solve_complex
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: family_type, new_family

  integer, parameter, public :: max_unknowns = 6
  integer, parameter :: max_steps = 2000
  !> Solutions of the random member larger than this lie at infinity; on the way from it to
  !! another member a path may pass far outside.
  real(wp), parameter :: infinite = 1.0e4_wp, far = 1.0e8_wp

  !> Systems with the same terms: sum over terms of coefficient x_i x_j x_k in equation row.
  type :: family_type
    integer :: n = 0
    !> Shape (n_terms) and (3, n_terms); 0: no factor.
    integer, allocatable :: row(:), at(:, :)
    !> Coefficients and solutions, shape (n, n_solutions), of the member at random.
    complex(wp), allocatable :: generic(:), solutions(:, :)
  contains
    procedure :: solve_member
  end type family_type

contains

  !> Unknowns and coefficients should be scaled to the size 1.
  subroutine new_family(family, n, row, at, cancel)
    type(family_type), intent(out) :: family
    integer, intent(in) :: n, row(:), at(:, :)
    !> Not 0, perhaps set by another thread, gives up.
    integer, intent(inout), volatile :: cancel
    complex(wp) :: from(size(row) + 2*n), to(size(row) + 2*n), x(n), found(n, 3**n)
    integer :: rows(size(row) + 2*n), places(3, size(row) + 2*n), degree(n), part(n)
    integer :: i, k, m, path, rest
    logical :: ended

    family%n = n
    family%row = row
    family%at = at
    m = size(row)
    family%generic = [(wave(0.7548776662466927_wp*i + 0.1_wp) &
                       *(0.6_wp + 0.8_wp*modulo(0.5698402909980532_wp*i, 1.0_wp)), i=1, m)]
    rows(:m) = row
    places(:, :m) = at
    to(:m) = family%generic
    from(:m) = (0.0_wp, 0.0_wp)
    do i = 1, n
      degree(i) = max(1, maxval(count(at > 0, 1), mask=row == i))
      rows(m + 2*i - 1:m + 2*i) = i
      places(:, m + 2*i - 1) = [(merge(i, 0, k <= degree(i)), k=1, 3)]
      places(:, m + 2*i) = 0
      from(m + 2*i - 1) = wave(0.317_wp + 0.231_wp*i)
      from(m + 2*i) = -from(m + 2*i - 1)*wave(0.137_wp*i)
    end do
    to(m + 1:) = (0.0_wp, 0.0_wp)
    k = 0
    do path = 0, product(degree) - 1
      if (cancel /= 0) exit
      rest = path
      do i = 1, n
        part(i) = modulo(rest, degree(i))
        rest = rest/degree(i)
        x(i) = wave((0.137_wp*i + part(i))/degree(i))
      end do
      call follow(n, rows, places, from, to, infinite, x, ended)
      if (.not. ended) cycle
      if (known(found(:, :k), x)) cycle
      k = k + 1
      found(:, k) = x
    end do
    family%solutions = found(:, :k)
  end subroutine new_family

  !> exp(2 pi i turns).
  elemental complex(wp) function wave(turns)
    real(wp), intent(in) :: turns
    real(wp), parameter :: two_pi = 6.283185307179586_wp
    wave = cmplx(cos(two_pi*turns), sin(two_pi*turns), wp)
  end function wave

  pure logical function known(found, x)
    complex(wp), intent(in) :: found(:, :), x(:)
    integer :: i
    known = .true.
    do i = 1, size(found, 2)
      if (maxval(abs(found(:, i) - x)) <= 1.0e-8_wp*max(maxval(abs(x)), 1.0e-3_wp)) return
    end do
    known = .false.
  end function known

  !> The finite solutions for given coefficients.
  subroutine solve_member(self, coefficients, x, n_found, cancel)
    class(family_type), intent(in) :: self
    complex(wp), intent(in) :: coefficients(:)
    !> Shape (n, at least size(solutions, 2)).
    complex(wp), intent(out) :: x(:, :)
    integer, intent(out) :: n_found
    integer, intent(inout), volatile :: cancel
    complex(wp) :: path(self%n)
    integer :: i
    logical :: ended

    n_found = 0
    x = (0.0_wp, 0.0_wp)
    do i = 1, size(self%solutions, 2)
      if (cancel /= 0) exit
      path = self%solutions(:, i)
      call follow(self%n, self%row, self%at, self%generic, coefficients, far, path, ended)
      if (.not. ended) cycle
      if (known(x(:, :n_found), path)) cycle
      n_found = n_found + 1
      x(:, n_found) = path
    end do
  end subroutine solve_member

  !> One path of (1 - t) from + t to = 0, t from 0 to 1: tangent predictor, Newton corrector.
  subroutine follow(n, row, at, from, to, limit, x, ended)
    integer, intent(in) :: n, row(:), at(:, :)
    complex(wp), intent(in) :: from(:), to(:)
    !> A path that leaves this is given up.
    real(wp), intent(in) :: limit
    complex(wp), intent(inout) :: x(n)
    logical, intent(out) :: ended
    complex(wp) :: now(size(from)), f(n), slope(n, n), tangent(n), new(n)
    complex(wp) :: unused(n, n), middle(n)
    real(wp) :: t, h, size_of
    integer :: step, round
    logical :: singular, settled

    t = 0.0_wp
    h = 0.05_wp
    ended = .false.
    do step = 1, max_steps
      if (t >= 1.0_wp) exit
      h = min(h, 1.0_wp - t)
      ! The tangent at the start, then at the middle of the step.
      now = (1.0_wp - t)*from + t*to
      call evaluate(n, row, at, now, x, f, slope)
      call evaluate(n, row, at, from - to, x, tangent, unused)
      call solve_complex(slope, tangent, .false., singular)
      if (singular) return
      middle = x + 0.5_wp*h*tangent
      now = (1.0_wp - t - 0.5_wp*h)*from + (t + 0.5_wp*h)*to
      call evaluate(n, row, at, now, middle, f, slope)
      call evaluate(n, row, at, from - to, middle, tangent, unused)
      call solve_complex(slope, tangent, .false., singular)
      if (singular) return
      new = x + h*tangent
      now = (1.0_wp - t - h)*from + (t + h)*to
      settled = .false.
      do round = 1, 3
        call evaluate(n, row, at, now, new, f, slope)
        call solve_complex(slope, f, .false., singular)
        if (singular) exit
        new = new - f
        size_of = max(maxval(abs(new)), 1.0e-3_wp)
        ! A first correction too large may lead to another path.
        if (.not. maxval(abs(f)) <= 0.02_wp*size_of) exit
        settled = maxval(abs(f)) <= 1.0e-7_wp*size_of
        if (settled) exit
      end do
      if (settled) then
        t = t + h
        x = new
        if (maxval(abs(x)) > limit) return
        if (round <= 2) h = 2.0_wp*h
      else
        h = 0.4_wp*h
        if (h < 1.0e-12_wp) exit
      end if
    end do
    ! A double solution is reached but slowly: near the end is taken as the end.
    if (t < 1.0_wp - 1.0e-7_wp) return
    do round = 1, 5
      call evaluate(n, row, at, to, x, f, slope)
      call solve_complex(slope, f, .false., singular)
      if (singular) exit
      if (.not. maxval(abs(f)) <= 1.0e-2_wp*max(maxval(abs(x)), 1.0e-3_wp)) exit
      x = x - f
    end do
    ended = maxval(abs(x)) <= infinite
  end subroutine follow

  pure subroutine evaluate(n, row, at, coefficients, x, f, slope)
    integer, intent(in) :: n, row(:), at(:, :)
    complex(wp), intent(in) :: coefficients(:), x(n)
    complex(wp), intent(out) :: f(n), slope(n, n)
    complex(wp) :: factor(3)
    integer :: i, q, r

    f = (0.0_wp, 0.0_wp)
    slope = (0.0_wp, 0.0_wp)
    do i = 1, size(row)
      r = row(i)
      factor = (1.0_wp, 0.0_wp)
      do q = 1, 3
        if (at(q, i) > 0) factor(q) = x(at(q, i))
      end do
      f(r) = f(r) + coefficients(i)*factor(1)*factor(2)*factor(3)
      do q = 1, 3
        if (at(q, i) == 0) cycle
        slope(r, at(q, i)) = slope(r, at(q, i)) &
                             + coefficients(i)*factor(modulo(q, 3) + 1)*factor(modulo(q + 1, 3) + 1)
      end do
    end do
  end subroutine evaluate

end module viscovib_homotopy
