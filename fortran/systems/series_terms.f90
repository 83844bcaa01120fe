! Optimize: -O2
!> Taylor coefficients of force laws along a solution, computed one order at a time.
!!
!! With u = sum_k u_k t^k each function of u satisfies a first-order differential equation whose
!! coefficients are sums of products. For y = tanh(u): k y_k = sum_(j=1)^k j u_j w_(k-j),
!! w = 1 - y^2. R. E. Moore, Interval Analysis, 1966, chapter 11; A. Jorba, M. Zou, A software
!! package for the numerical integration of ODEs by means of high-order Taylor methods, Exp. Math.
!! 14, 2005. Each value is a register with all its coefficients so far.
module viscovib_series_terms
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_functions, only: of_one, steepest
  use viscovib_vector_math, only: exponential_lanes, largest_angle, sine_cosine_lanes, tangent_lanes
  use viscovib_wide_series, only: largest, n_wide, next_product, next_products, next_square, &
    product_term, square_term
  implicit none
  private

  public :: run_series, series_step

  !> Instructions: a number, a multiple, a sum with a number, sums, products, and functions defined
  !! by differential equations. `over` is y' = a'/b.
  integer, parameter, public :: take_number = 1, scale_up = 2, shift = 3, add_up = 4, &
                                take_off = 5, product_of = 6, square_of = 7, quotient = 8, &
                                root = 9, grow = 10, turn = 11, stretch = 12, bend = 13, over = 14

  !> One instruction: its code, the register of its value (auxiliary registers follow), its
  !! operands, and a number. For a function the number is the same in all vector lanes.
  type :: series_step
    integer :: code = 0, to = 0, a = 0, b = 0
    real(wp) :: number(n_wide) = 0.0_wp
  end type series_step

contains

  !> Coefficient k of all computed registers, from lower coefficients and those of the solution.
  pure subroutine run_series(n, steps, order, k, s, lost)
    integer, intent(in) :: n, order, k
    type(series_step), intent(in) :: steps(n)
    real(wp), intent(inout) :: s(n_wide, 0:order, *)
    !> Vector lanes in which an argument is not inside the domain of a function.
    logical, intent(inout) :: lost(n_wide)
    integer :: i

    do i = 1, n
      associate (a => steps(i)%a, b => steps(i)%b, to => steps(i)%to, c => steps(i)%number)
        select case (steps(i)%code)
        case (take_number)
          s(:, k, to) = 0.0_wp
          if (k == 0) s(:, 0, to) = c
        case (scale_up)
          call put_multiple(c, s(1, k, a), s(1, k, to))
        case (shift)
          s(:, k, to) = s(:, k, a)
          if (k == 0) s(:, 0, to) = s(:, 0, to) + c
        case (add_up)
          call put_sum(1.0_wp, s(1, k, a), s(1, k, b), s(1, k, to))
        case (take_off)
          call put_sum(-1.0_wp, s(1, k, a), s(1, k, b), s(1, k, to))
        case (product_of)
          call next_product(k, 1.0_wp, s(1, 0, a), s(1, 0, b), s(1, k, to))
        case (square_of)
          call next_square(k, 1.0_wp, s(1, 0, a), s(1, k, to))
        case default
          if (k == 0) then
            call begin_function(steps(i), order, s(1, 0, a), s(1, 0, max(b, 1)), s(1, 0, to), lost)
          else
            call go_on(steps(i)%code, c(1), order, k, s(1, 0, a), s(1, 0, max(b, 1)), s(1, 0, to))
          end if
        end select
        if (k == 0) lost = lost .or. abs(s(:, 0, to)) >= largest
      end associate
    end do
  end subroutine run_series

  !> Order-0 coefficient of a function.
  pure subroutine begin_function(step, order, a, b, y, lost)
    type(series_step), intent(in) :: step
    integer, intent(in) :: order
    real(wp), intent(in) :: a(n_wide), b(n_wide)
    !> Its value and the auxiliary registers of its equation.
    real(wp), intent(inout) :: y(n_wide, 0:order, 3)
    logical, intent(inout) :: lost(n_wide)
    logical :: bad(n_wide)
    integer :: first, last

    bad = .false.
    select case (step%code)
    case (quotient)
      bad = abs(b) <= abs(a)/largest
      y(:, 0, 1) = a/merge(1.0_wp, b, bad)
    case (root)
      bad = a <= 0.0_wp
      y(:, 0, 1) = sqrt(merge(1.0_wp, a, bad))
    case (over)
      bad = abs(b) <= 1.0_wp/largest
      call by_one(nint(step%number(1)), merge(0.5_wp, a, bad), y(1, 0, 1))
    case (stretch)
      bad = abs(a) > steepest
      y(:, 0, 1) = sinh(merge(0.0_wp, a, bad))
      y(:, 0, 2) = cosh(merge(0.0_wp, a, bad))
    case (grow)
      bad = abs(a) > steepest
      do first = 1, n_wide, n_lanes
        last = first + n_lanes - 1
        call exponential_lanes(merge(0.0_wp, a(first:last), bad(first:last)), y(first:last, 0, 1))
      end do
    case (bend)
      if (step%number(1) < 0.0_wp) then
        do first = 1, n_wide, n_lanes
          call tangent_lanes(a(first), y(first, 0, 1))
        end do
      else
        bad = abs(cos(a)) <= 1.0_wp/largest
        y(:, 0, 1) = tan(merge(0.0_wp, a, bad))
      end if
      y(:, 0, 2) = 1.0_wp + step%number(1)*y(:, 0, 1)**2
      if (step%number(1) < 0.0_wp) y(:, 0, 2) = (1.0_wp - y(:, 0, 1))*(1.0_wp + y(:, 0, 1))
      ! Start of the square's next coefficient.
      y(:, 1, 2) = 0.0_wp
    case default
      call sines(a, y(1, 0, 1), y(1, 0, 2))
    end select
    lost = lost .or. bad
  end subroutine begin_function

  !> Evaluate a function element by element.
  pure subroutine by_one(code, x, y)
    integer, intent(in) :: code
    real(wp), intent(in) :: x(n_wide)
    real(wp), intent(out) :: y(n_wide)
    real(wp) :: by
    integer :: l
    do l = 1, n_wide
      call of_one(code, 0.0_wp, x(l), y(l), by)
    end do
  end subroutine by_one

  !> Sines and cosines of any angles. Values of vector lanes are independent of each other.
  pure subroutine sines(a, sine, cosine)
    real(wp), intent(in) :: a(n_wide)
    real(wp), intent(out) :: sine(n_wide), cosine(n_wide)
    real(wp) :: angle(n_lanes)
    integer :: first, l, last

    do first = 1, n_wide, n_lanes
      last = first + n_lanes - 1
      angle = merge(a(first:last), 0.0_wp, abs(a(first:last)) <= largest_angle)
      call sine_cosine_lanes(angle, sine(first:last), cosine(first:last))
    end do
    if (all(abs(a) <= largest_angle)) return
    do l = 1, n_wide
      if (abs(a(l)) <= largest_angle) cycle
      sine(l) = sin(a(l))
      cosine(l) = cos(a(l))
    end do
  end subroutine sines

  !> Coefficient k > 0 of a function, by its differential equation.
  pure subroutine go_on(code, sign_of, order, k, a, b, y)
    integer, intent(in) :: code, order, k
    real(wp), intent(in) :: sign_of, a(n_wide, 0:order), b(n_wide, 0:order)
    real(wp), intent(inout) :: y(n_wide, 0:order, 3)
    real(wp) :: term(n_wide), part

    part = 1.0_wp/k
    select case (code)
    case (quotient)
      y(:, k, 1) = 0.0_wp
      call product_term(k, 1.0_wp, b, y, term)
      y(:, k, 1) = confined((a(:, k) - term)/divisor(b(:, 0)))
    case (root)
      y(:, k, 1) = 0.0_wp
      call square_term(k, 1.0_wp, y, term)
      y(:, k, 1) = confined((a(:, k) - term)/(2.0_wp*y(:, 0, 1)))
    case (over)
      ! The second register contains j y_j, from j = 1 on.
      term = 0.0_wp
      if (k > 1) call product_term(k - 2, 1.0_wp, y(1, 0, 2), b(1, 1), term)
      y(:, k - 1, 2) = confined((k*a(:, k) - term)/divisor(b(:, 0)))
      y(:, k, 1) = part*y(:, k - 1, 2)
    case (grow)
      call put_times(k, a(1, k), y(1, k - 1, 2))
      call next_product(k - 1, part, y(1, 0, 2), y, y(1, k, 1))
    case (bend)
      call put_times(k, a(1, k), y(1, k - 1, 3))
      call next_product(k - 1, part, y(1, 0, 3), y(1, 0, 2), y(1, k, 1))
      call next_square(k, sign_of, y, y(1, k, 2))
    case default
      call put_times(k, a(1, k), y(1, k - 1, 3))
      call next_products(k - 1, part, merge(-part, part, code == turn), y(1, 0, 3), y(1, 0, 2), y, &
                         y(1, k, 1), y(1, k, 2))
    end select
  end subroutine go_on

  !> c x in every vector lane. These loops are not unrolled, as in `viscovib_wide_series`.
  pure subroutine put_multiple(c, x, y)
    real(wp), intent(in) :: c(n_wide), x(n_wide)
    real(wp), intent(out) :: y(n_wide)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_wide
      y(l) = c(l)*x(l)
    end do
  end subroutine put_multiple

  !> k x in every vector lane.
  pure subroutine put_times(k, x, y)
    integer, intent(in) :: k
    real(wp), intent(in) :: x(n_wide)
    real(wp), intent(out) :: y(n_wide)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_wide
      y(l) = k*x(l)
    end do
  end subroutine put_times

  !> a + c b in every vector lane.
  pure subroutine put_sum(c, a, b, y)
    real(wp), intent(in) :: c, a(n_wide), b(n_wide)
    real(wp), intent(out) :: y(n_wide)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_wide
      y(l) = a(l) + c*b(l)
    end do
  end subroutine put_sum

  !> Limit diverging values to finite numbers.
  elemental real(wp) function confined(x)
    real(wp), intent(in) :: x
    confined = min(max(x, -largest), largest)
  end function confined

  !> Divisor, or 1 where division is impossible; such vector lanes are marked as lost.
  elemental real(wp) function divisor(x)
    real(wp), intent(in) :: x
    divisor = merge(x, 1.0_wp, abs(x) > 1.0_wp/largest)
  end function divisor

end module viscovib_series_terms
