! Optimize: -O2 -fvect-cost-model=dynamic -fstack-arrays
!> All steady motions of a mode d that a load drives and of modes q that only the motion of d, or
!! a load, excites parametrically. With x = |a_d|^2, y_q = |a_q|^2 and an m of 0, 1, 2 for each q
!!
!!   g + L_d a_d + sum_q b_q a_q^2 conj(a_d)^(m - 1) = 0,
!!   L_q a_q + k_q a_d^m conj(a_q) = 0,
!!
!! where each L is a constant plus multiples of x and all y. Any q may rest. If a single one moves,
!! the second equation gives conj(a_d)^m a_q^2 = -conj(L_q) y/conj(k), and both together
!!
!!   |L_q|^2 = |k|^2 x^m,     |x L_d - r y conj(L_q)|^2 = |g|^2 x,     r = b/conj(k).
!!
!! The first is quadratic in y, so that the second becomes P(x) + S(x) y = 0, and x a zero of
!! a polynomial of degree 8 (6 if b = 0, when x divides the second equation).
module viscovib_parametric_modes
  use viscovib_kinds, only: wp
  use viscovib_polynomial_zeros, only: polynomial_zeros
  use viscovib_slow_flow, only: flow_term_type, slow_flow_type
  implicit none
  private

  public :: find_parametric, pair_type, parametric_type

  !> Largest degree of a polynomial in x, largest power of y, and largest number of motions in which
  !! both modes move.
  integer, parameter :: highest = 8, powers = 4
  integer, parameter, public :: max_pairs = 2*highest
  !> Relative size of gamma_qq below which the elimination of y loses digits.
  real(wp), parameter :: least_shift = 1.0e-6_wp
  !> Largest imaginary part of a zero, relative to its modulus, that may be rounding error of
  !! a real one, which Newton's method shows; largest relative last correction, which of a double
  !! solution is the root of rounding; relative distance of equal solutions.
  real(wp), parameter :: nearly_real = 1.0e-2_wp, settled = 1.0e-7_wp, same = 1.0e-6_wp
  integer, parameter :: most_corrections = 40

  type :: parametric_type
    !> Indices of the modes, d first, shape (n).
    integer, allocatable :: modes(:)
    !> L_j = sigma_j + sum_k gamma_jk |a_k|^2 in this order, shapes (n) and (n, n).
    complex(wp), allocatable :: sigma(:), gamma(:, :)
    complex(wp) :: g = (0.0_wp, 0.0_wp)
    !> Shape (n), the first not used.
    complex(wp), allocatable :: b(:), k(:)
    integer, allocatable :: m(:)
  contains
    procedure :: pair
    procedure, private :: add_term
  end type parametric_type

  !> d and one other mode.
  type :: pair_type
    integer :: m = 0
    complex(wp) :: g = (0.0_wp, 0.0_wp), b = (0.0_wp, 0.0_wp), k = (0.0_wp, 0.0_wp)
    !> sigma, gamma_.d, gamma_.q of each mode.
    complex(wp) :: of_driven(0:2) = (0.0_wp, 0.0_wp), of_other(0:2) = (0.0_wp, 0.0_wp)
  contains
    procedure :: both_move
    procedure, private :: find_squares
    procedure, private :: equations
    procedure, private :: correct
  end type pair_type

contains

  !> Collect the coefficients, with amplitudes in `unit`; `found` is false if the flow has other
  !! terms, or if its motions are not found from the squares.
  subroutine find_parametric(flow, active, unit, modes, found)
    type(slow_flow_type), intent(in) :: flow
    !> Numbers of the moving modes.
    integer, intent(in) :: active(:)
    real(wp), intent(in) :: unit
    type(parametric_type), intent(out) :: modes
    logical, intent(out) :: found
    integer :: i, d, n

    n = size(active)
    d = 0
    found = .false.
    do i = 1, size(flow%terms)
      if (any(flow%terms(i)%at /= 0) .or. .not. any(active == flow%terms(i)%row)) cycle
      if (d > 0 .and. flow%terms(i)%row /= d) return
      d = flow%terms(i)%row
    end do
    if (d == 0 .or. n < 2) return
    modes%modes = [d, pack(active, active /= d)]
    modes%sigma = flow%s(modes%modes) - cmplx(0.0_wp, flow%frame(modes%modes), wp)
    allocate (modes%gamma(n, n), modes%b(n), modes%k(n), source=(0.0_wp, 0.0_wp))
    allocate (modes%m(n), source=-1)
    do i = 1, size(flow%terms)
      if (.not. any(active == flow%terms(i)%row)) cycle
      call modes%add_term(flow%terms(i), flow%terms(i)%coefficient &
                          *unit**(count(flow%terms(i)%at /= 0) - 1), found)
      if (.not. found) return
    end do
    found = abs(modes%g) > 0.0_wp .and. all(abs(modes%k(2:)) > 0.0_wp) &
            .and. .not. (n > 2 .and. any(abs(modes%b(2:)) > 0.0_wp))
    do i = 2, n
      found = found .and. abs(modes%gamma(i, i)) &
              > least_shift*max(abs(modes%sigma(i)), maxval(abs(modes%gamma(i, :))), &
                                abs(modes%k(i)))
    end do
  end subroutine find_parametric

  !> Add a term to its coefficient; false if it is of another kind.
  subroutine add_term(self, term, c, fits)
    class(parametric_type), intent(inout) :: self
    type(flow_term_type), intent(in) :: term
    complex(wp), intent(in) :: c
    logical, intent(out) :: fits
    !> Numbers of factors that are the amplitude of each mode, or its conjugate.
    integer, dimension(size(self%modes)) :: plain, conjugate, net
    integer :: i, j, n

    plain = [(count(term%at == self%modes(i)), i=1, size(plain))]
    conjugate = [(count(term%at == -self%modes(i)), i=1, size(plain))]
    n = count(term%at /= 0)
    j = findloc(self%modes, term%row, 1)
    net = plain - conjugate
    net(j) = net(j) - 1
    fits = .true.
    ! Other amplitudes are 0.
    if (n > sum(plain + conjugate)) return
    if (n == 0) then
      self%g = self%g + c
    else if (all(net == 0)) then
      i = findloc(conjugate, 1, 1)
      if (i == 0) then
        self%sigma(j) = self%sigma(j) + c
      else
        self%gamma(j, i) = self%gamma(j, i) + c
      end if
    else if (j == 1) then
      i = findloc(plain, 2, 1)
      fits = i > 1 .and. conjugate(1) == n - 2
      if (fits) call add(i, n - 1, self%b(i))
    else
      fits = conjugate(j) == 1 .and. plain(1) == n - 1
      if (fits) call add(j, n - 1, self%k(j))
    end if

  contains

    !> Each mode has one m.
    subroutine add(i, m, coefficient)
      integer, intent(in) :: i, m
      complex(wp), intent(inout) :: coefficient
      fits = self%m(i) < 0 .or. self%m(i) == m
      self%m(i) = m
      coefficient = coefficient + c
    end subroutine add

  end subroutine add_term

  !> Mode d and the mode in place i.
  pure type(pair_type) function pair(self, i)
    class(parametric_type), intent(in) :: self
    integer, intent(in) :: i
    pair = pair_type(self%m(i), self%g, self%b(i), self%k(i), &
                     [self%sigma(1), self%gamma(1, [1, i])], &
                     [self%sigma(i), self%gamma(i, [1, i])])
  end function pair

  !> Amplitudes of d and q, in the unit of the coefficients, of all motions in which both move; a_q
  !! and -a_q are two of them.
  pure subroutine both_move(self, a, n)
    class(pair_type), intent(in) :: self
    complex(wp), intent(out) :: a(2, max_pairs)
    integer, intent(out) :: n
    real(wp) :: squares(2, highest)
    complex(wp) :: l_d, l_q, partner
    integer :: i, n_squares

    call self%find_squares(squares, n_squares)
    n = 0
    do i = 1, n_squares
      associate (x => squares(1, i), y => squares(2, i))
        l_d = value_of(self%of_driven, x, y)
        l_q = value_of(self%of_other, x, y)
        ! conj(a_d)^m a_q^2.
        partner = -conjg(l_q)*y/conjg(self%k)
        a(1, n + 1) = -conjg((x*l_d + self%b*partner)/self%g)
        a(2, n + 1) = sqrt(partner/conjg(a(1, n + 1))**self%m)
        a(:, n + 2) = [a(1, n + 1), -a(2, n + 1)]
        n = n + 2
      end associate
    end do
  end subroutine both_move

  !> All x > 0 and y > 0, shape (2, n).
  pure subroutine find_squares(self, squares, n)
    class(pair_type), intent(in) :: self
    real(wp), intent(out) :: squares(:, :)
    integer, intent(out) :: n
    !> Coefficients by powers of x. The power j of y is p(:, j) + s(:, j) y.
    real(wp), dimension(0:highest) :: c0, c1, p_sum, s_sum, eliminated
    real(wp), dimension(0:highest, 0:powers) :: e, p, s
    complex(wp) :: zeros(highest), root
    real(wp) :: unit, x, middle, at(2)
    integer :: low, high, i, j
    logical :: found

    n = 0
    call self%equations(c0, c1, e)
    p = 0.0_wp
    s = 0.0_wp
    p(0, 0) = 1.0_wp
    s(0, 1) = 1.0_wp
    p_sum = e(:, 0)
    s_sum = e(:, 1)
    do j = 2, powers
      p(:, j) = -product_of(s(:, j - 1), c0)
      s(:, j) = p(:, j - 1) - product_of(s(:, j - 1), c1)
      p_sum = p_sum + product_of(e(:, j), p(:, j))
      s_sum = s_sum + product_of(e(:, j), s(:, j))
    end do
    eliminated = product_of(p_sum, p_sum) - product_of(c1, product_of(p_sum, s_sum)) &
                 + product_of(c0, product_of(s_sum, s_sum))
    high = findloc(abs(eliminated) > 0.0_wp, .true., 1, back=.true.) - 1
    low = findloc(abs(eliminated) > 0.0_wp, .true., 1) - 1
    if (high <= low) return
    ! Scale x so that the outer coefficients have equal size.
    unit = abs(eliminated(low)/eliminated(high))**(1.0_wp/(high - low))
    call polynomial_zeros([(eliminated(i)*unit**(i - high), i=high, low, -1)], &
                          zeros(:high - low), found)
    if (.not. found) return
    do i = 1, high - low
      x = unit*real(zeros(i))
      if (.not. x > 0.0_wp .or. abs(aimag(zeros(i))) > nearly_real*abs(zeros(i))) cycle
      middle = -0.5_wp*along(c1, x)
      root = sqrt(cmplx(middle**2 - along(c0, x), 0.0_wp, wp))
      do j = -1, 1, 2
        at = [x, middle + j*real(root)]
        call self%correct(at, found)
        if (.not. found) cycle
        if (any(maxval(abs(squares(:, :n) - spread(at, 2, n)), 1) <= same*maxval(at))) cycle
        if (n == size(squares, 2)) return
        n = n + 1
        squares(:, n) = at
      end do
    end do
  end subroutine find_squares

  !> Coefficients by powers of x of both equations, y^2 + c1 y + c0 = 0 and sum_j e_j y^j = 0.
  pure subroutine equations(self, c0, c1, e)
    class(pair_type), intent(in) :: self
    real(wp), intent(out) :: c0(0:), c1(0:), e(0:, 0:)
    !> sum_j w_j y^j is x L_d - r y conj(L_q), or L_d if r = 0, by powers of x.
    complex(wp) :: w(0:2, 0:2), r
    integer :: i, j, k, l

    associate (a => self%of_other)
      c0 = 0.0_wp
      c1 = 0.0_wp
      c0(0) = abs(a(0))**2
      c0(1) = 2.0_wp*real(conjg(a(0))*a(1))
      c0(2) = abs(a(1))**2
      c0(self%m) = c0(self%m) - abs(self%k)**2
      c1(:1) = 2.0_wp*real(conjg(a(2))*a(:1))
      c0 = c0/abs(a(2))**2
      c1 = c1/abs(a(2))**2
      r = self%b/conjg(self%k)
      w = (0.0_wp, 0.0_wp)
      k = merge(1, 0, abs(r) > 0.0_wp)
      w(k:k + 1, 0) = self%of_driven(:1)
      w(k, 1) = self%of_driven(2)
      w(:1, 1) = w(:1, 1) - r*conjg(a(:1))
      w(0, 2) = -r*conjg(a(2))
    end associate
    e = 0.0_wp
    do j = 0, 2
      do i = 0, 2
        do l = 0, 2
          ! Without r the second equation is divided by x, x |L_d|^2 = |g|^2.
          associate (rows => e(l + 1 - k:l + 3 - k, i + j))
            rows = rows + real(w(l, i)*conjg(w(:, j)))
          end associate
        end do
      end do
    end do
    e(k, 0) = e(k, 0) - abs(self%g)**2
  end subroutine equations

  !> Newton's method for x and y.
  pure subroutine correct(self, at, found)
    class(pair_type), intent(in) :: self
    real(wp), intent(inout) :: at(2)
    !> True if it converges to x > 0, y > 0.
    logical, intent(out) :: found
    complex(wp) :: l_d, l_q, w, slope(2), r
    real(wp) :: f(2), by(2, 2), step(2), determinant, change
    integer :: round

    r = self%b/conjg(self%k)
    change = huge(change)
    do round = 1, most_corrections
      associate (x => at(1), y => at(2), d => self%of_driven, q => self%of_other)
        l_d = value_of(d, x, y)
        l_q = value_of(q, x, y)
        f(1) = abs(l_q)**2 - abs(self%k)**2*x**self%m
        by(1, :) = 2.0_wp*real(conjg(l_q)*q(1:))
        if (self%m > 0) by(1, 1) = by(1, 1) - self%m*abs(self%k)**2*x**(self%m - 1)
        if (abs(r) > 0.0_wp) then
          w = x*l_d - r*y*conjg(l_q)
          slope = x*d(1:) - r*y*conjg(q(1:)) + [l_d, -r*conjg(l_q)]
          f(2) = abs(w)**2 - abs(self%g)**2*x
          by(2, :) = 2.0_wp*real(conjg(w)*slope) - [abs(self%g)**2, 0.0_wp]
        else
          f(2) = x*abs(l_d)**2 - abs(self%g)**2
          by(2, :) = 2.0_wp*x*real(conjg(l_d)*d(1:)) + [abs(l_d)**2, 0.0_wp]
        end if
      end associate
      determinant = by(1, 1)*by(2, 2) - by(1, 2)*by(2, 1)
      if (.not. abs(determinant) > 0.0_wp) exit
      step = [by(2, 2)*f(1) - by(1, 2)*f(2), by(1, 1)*f(2) - by(2, 1)*f(1)]/determinant
      at = at - step
      change = maxval(abs(step))/maxval(abs(at))
      if (.not. change <= 10.0_wp) exit
      if (change <= 4.0_wp*epsilon(change)) exit
    end do
    found = change <= settled .and. all(at > 0.0_wp)
  end subroutine correct

  pure complex(wp) function value_of(coefficients, x, y)
    complex(wp), intent(in) :: coefficients(0:2)
    real(wp), intent(in) :: x, y
    value_of = coefficients(0) + coefficients(1)*x + coefficients(2)*y
  end function value_of

  !> Product of polynomials in x, whose degree is at most `highest`.
  pure function product_of(one, other) result(both)
    real(wp), intent(in) :: one(0:highest), other(0:highest)
    real(wp) :: both(0:highest)
    integer :: i
    both = 0.0_wp
    do i = 0, highest
      if (abs(one(i)) > 0.0_wp) both(i:) = both(i:) + one(i)*other(:highest - i)
    end do
  end function product_of

  pure real(wp) function along(polynomial, x)
    real(wp), intent(in) :: polynomial(0:highest), x
    integer :: i
    along = 0.0_wp
    do i = highest, 0, -1
      along = along*x + polynomial(i)
    end do
  end function along

end module viscovib_parametric_modes
