!> Bounds of a law and of its rate over ranges of its arguments, by interval arithmetic with the
!! instructions of its program (R. E. Moore, R. B. Kearfott, M. J. Cloud, Introduction to Interval
!! Analysis, 2009, chapters 5 and 6).
!!
!! Ranges also contain features that samples may miss, such as a layer of width 1e-6.
module viscovib_law_bounds
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: add, divide, f_abs, f_acos, f_acosh, f_asin, f_asinh, &
    f_atan, f_atan2, f_atanh, f_atleast, f_atmost, f_cos, f_cosh, f_exp, f_heaviside, f_less, &
    f_log, f_max, f_min, f_more, f_sign, f_sin, f_sinh, f_sqrt, f_tan, f_tanh, is_whole, &
    known_power, multiply, negate, of_one, operands, power, put_argument, square, &
    steepest, subtract, wall, within
  use viscovib_law_program, only: law_program
  implicit none
  private

  public :: range_type, bounds_of

  !> Domain of a law within a range: defined everywhere, possibly undefined, undefined everywhere.
  integer, parameter, public :: inside = 0, partly = 1, nowhere = 2

  !> Range of a quantity along a path with one parameter.
  type :: range_type
    !> Lower and upper bound of the value, and of its rate with respect to the parameter.
    real(wp) :: value(2) = 0.0_wp, rate(2) = 0.0_wp
    !> Bound of the rounding error of the value.
    real(wp) :: noise = 0.0_wp
    !> Magnitude of the terms of its sum.
    real(wp) :: size = 0.0_wp
    integer :: outside = inside
    !> True if it may jump or have a pole.
    logical :: jumps = .false.
  end type range_type

  real(wp), parameter :: pi = 3.141592653589793_wp, half_pi = 0.5_wp*pi, &
                         rounding = epsilon(1.0_wp), anything(2) = [-wall, wall]

contains

  !> Range of a law.
  pure subroutine bounds_of(law, arguments, bounds)
    type(law_program), intent(in) :: law
    type(range_type), intent(in) :: arguments(:)
    type(range_type), intent(out) :: bounds
    type(range_type) :: x(law%depth + 2)
    integer :: i, top

    top = 0
    do i = 1, size(law%code)
      top = top - operands(law%code(i)) + 1
      select case (operands(law%code(i)))
      case (0)
        x(top) = range_type(value=law%number(i))
        if (law%code(i) == put_argument) x(top) = arguments(nint(law%number(i)))
        x(top)%size = maxval(abs(x(top)%value))
      case (1)
        call apply(law%code(i), law%number(i), x(top))
      case (2)
        call combine(law%code(i), x(top), x(top + 1))
      case default
        call choose(x(top), x(top + 1), x(top + 2))
      end select
      if (x(top)%outside == nowhere) x(top)%value = anything
    end do
    bounds = x(1)
  end subroutine bounds_of

  !> Replace a quantity by a function of it.
  pure subroutine apply(code, number, x)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    type(range_type), intent(inout) :: x
    real(wp) :: value(2), by(2), slack

    if (code == negate) then
      x%value = -x%value([2, 1])
      x%rate = -x%rate([2, 1])
      return
    end if
    call clip(code, number, x)
    slack = 0.0_wp
    select case (code)
    case (square)
      call of_whole_power(2, x%value, value, by, x%jumps)
    case (known_power)
      if (is_whole(number)) then
        call of_whole_power(nint(number), x%value, value, by, x%jumps)
      else
        call of_monotone(code, number, x%value, value, by)
      end if
    case (f_sin, f_cos)
      value = sine(x%value + merge(half_pi, 0.0_wp, code == f_cos))
      by = sine(x%value + merge(pi, half_pi, code == f_cos))
      slack = rounding*maxval(abs(x%value))
    case (f_tan)
      call of_tangent(x%value, value, by, x%jumps)
    case (f_abs)
      value = [max(0.0_wp, x%value(1), -x%value(2)), maxval(abs(x%value))]
      by = [merge(1.0_wp, -1.0_wp, x%value(1) >= 0.0_wp), &
            merge(-1.0_wp, 1.0_wp, x%value(2) <= 0.0_wp)]
    case (f_sign, f_heaviside)
      call of_jump(code, x%value, value, by, x%jumps)
    case (f_tanh, f_atan, f_asinh, f_asin, f_acos, f_atanh, f_sinh, f_cosh, f_exp, f_log, f_sqrt, &
          f_acosh)
      call of_monotone(code, number, x%value, value, by)
    case default
      value = anything
      by = anything
      x%jumps = .true.
    end select
    x%noise = within(maxval(abs(by))*min(x%noise, wall)) + rounding*maxval(abs(value)) + slack
    x%rate = times(by, x%rate)
    x%value = value
    x%size = maxval(abs(value))
  end subroutine apply

  !> Restrict a quantity to the domain of a function, excluding poles.
  pure subroutine clip(code, number, x)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    type(range_type), intent(inout) :: x
    real(wp) :: domain(2)

    domain = 2.0_wp*anything
    select case (code)
    case (f_asin, f_acos, f_atanh)
      domain = [-1.0_wp, 1.0_wp]
      if (code == f_atanh) domain = nearest(1.0_wp, -1.0_wp)*domain
    case (f_acosh)
      domain(1) = 1.0_wp
    case (f_log)
      domain(1) = 1.0_wp/wall
    case (f_sqrt)
      domain(1) = 0.0_wp
    case (known_power)
      if (.not. is_whole(number)) domain(1) = merge(0.0_wp, 1.0_wp/wall, number >= 0.0_wp)
    case default
      return
    end select
    if (x%value(2) < domain(1) .or. x%value(1) > domain(2)) then
      x%outside = nowhere
    else if (x%value(1) < domain(1) .or. x%value(2) > domain(2)) then
      x%outside = max(x%outside, partly)
    end if
    x%value = min(max(x%value, domain(1)), domain(2))
  end subroutine clip

  !> Monotone functions, and cosh, with their derivatives. The derivatives have no extremum, except
  !! at 0, where they are 1 or -1.
  pure subroutine of_monotone(code, number, x, value, by)
    integer, intent(in) :: code
    real(wp), intent(in) :: number, x(2)
    real(wp), intent(out) :: value(2), by(2)
    real(wp) :: f(2), d(2)
    logical :: spans
    integer :: k

    do k = 1, 2
      call of_one(code, number, x(k), f(k), d(k))
      if (singular(code, number, x(k))) d(k) = merge(-wall, wall, code == f_acos)
    end do
    ! exp beyond its largest argument is `wall`; a logarithm at 0 is not.
    if (code == f_log .and. x(1) <= 1.0_wp/wall) f(1) = -steepest
    if (code == f_sinh .and. x(1) < -steepest) f(1) = -wall
    value = [minval(f), maxval(f)]
    by = [minval(d), maxval(d)]
    spans = x(1) < 0.0_wp .and. x(2) > 0.0_wp
    if (spans) then
      select case (code)
      case (f_tanh, f_atan, f_asinh, f_asin, f_atanh, f_sinh)
        by = [min(by(1), 1.0_wp), max(by(2), 1.0_wp)]
      case (f_acos)
        by = [min(by(1), -1.0_wp), max(by(2), -1.0_wp)]
      case (f_cosh)
        value(1) = 1.0_wp
      case default
        continue
      end select
    end if
    if (maxval(abs(value)) >= wall) by = anything
  end subroutine of_monotone

  !> True if the slope of a function is infinite at the end of its domain.
  pure logical function singular(code, number, x)
    integer, intent(in) :: code
    real(wp), intent(in) :: number, x
    select case (code)
    case (f_asin, f_acos, f_atanh)
      singular = abs(x) >= 1.0_wp
    case (f_acosh)
      singular = x <= 1.0_wp
    case (f_log, f_sqrt)
      singular = x <= 1.0_wp/wall
    case (known_power)
      singular = x <= 1.0_wp/wall .and. number < 1.0_wp
    case default
      singular = .false.
    end select
  end function singular

  !> x^n.
  pure subroutine of_whole_power(n, x, value, by, jumps)
    integer, intent(in) :: n
    real(wp), intent(in) :: x(2)
    real(wp), intent(out) :: value(2), by(2)
    logical, intent(inout) :: jumps
    real(wp) :: f(2), d(2)
    logical :: spans
    integer :: k

    spans = x(1) <= 0.0_wp .and. x(2) >= 0.0_wp
    if (n < 0 .and. spans) then
      value = anything
      by = anything
      jumps = .true.
      return
    end if
    do k = 1, 2
      call of_one(known_power, real(n, wp), x(k), f(k), d(k))
      ! An overflow has the sign of the power.
      if (abs(f(k)) >= wall .and. modulo(n, 2) == 1) f(k) = sign(f(k), x(k))
    end do
    value = [minval(f), maxval(f)]
    by = [minval(d), maxval(d)]
    if (spans .and. n > 1) then
      if (modulo(n, 2) == 0) then
        value(1) = 0.0_wp
      else
        by(1) = 0.0_wp
      end if
    end if
    if (maxval(abs(value)) >= wall) by = anything
  end subroutine of_whole_power

  pure subroutine of_tangent(x, value, by, jumps)
    real(wp), intent(in) :: x(2)
    real(wp), intent(out) :: value(2), by(2)
    logical, intent(inout) :: jumps

    if (passes(x, half_pi, pi)) then
      value = anything
      by = anything
      jumps = .true.
      return
    end if
    value = within(tan(x))
    by = 1.0_wp + [minval(abs(value)), maxval(abs(value))]**2
    if (passes(x, 0.0_wp, pi)) by(1) = 1.0_wp
  end subroutine of_tangent

  !> sign or heaviside.
  pure subroutine of_jump(code, x, value, by, jumps)
    integer, intent(in) :: code
    real(wp), intent(in) :: x(2)
    real(wp), intent(out) :: value(2), by(2)
    logical, intent(inout) :: jumps
    integer :: k

    by = 0.0_wp
    if (any(abs(x) > 0.0_wp) .and. x(1) <= 0.0_wp .and. x(2) >= 0.0_wp) then
      value = [merge(-1.0_wp, 0.0_wp, code == f_sign), 1.0_wp]
      by = anything
      jumps = .true.
      return
    end if
    do k = 1, 2
      call of_one(code, 0.0_wp, x(k), value(k), by(k))
    end do
    by = 0.0_wp
  end subroutine of_jump

  !> Range of sin.
  pure function sine(x) result(value)
    real(wp), intent(in) :: x(2)
    real(wp) :: value(2)
    value = [minval(sin(x)), maxval(sin(x))]
    if (passes(x, half_pi, 2.0_wp*pi)) value(2) = 1.0_wp
    if (passes(x, -half_pi, 2.0_wp*pi)) value(1) = -1.0_wp
  end function sine

  !> True if a range contains a point `first` + k `period`.
  pure logical function passes(x, first, period)
    real(wp), intent(in) :: x(2), first, period
    real(wp) :: turns(2)
    turns = (x - first)/period
    passes = turns(2) - turns(1) >= 1.0_wp
    if (passes) return
    turns = turns - modulo(turns, 1.0_wp)
    passes = abs(turns(2) - turns(1)) > 0.5_wp
  end function passes

  !> Replace the first of two quantities by a function of both.
  pure subroutine combine(code, x, y)
    integer, intent(in) :: code
    type(range_type), intent(inout) :: x
    type(range_type), intent(in) :: y
    type(range_type) :: z

    z = x
    z%outside = max(x%outside, y%outside)
    z%jumps = x%jumps .or. y%jumps
    z%size = max(x%size, y%size)
    select case (code)
    case (add)
      z%value = x%value + y%value
      z%rate = x%rate + y%rate
      z%noise = x%noise + y%noise + rounding*maxval(abs(z%value))
    case (subtract)
      z%value = x%value - y%value([2, 1])
      z%rate = x%rate - y%rate([2, 1])
      z%noise = x%noise + y%noise + rounding*maxval(abs(z%value))
    case (multiply)
      z%value = times(x%value, y%value)
      z%rate = times(x%rate, y%value) + times(x%value, y%rate)
      z%noise = spread_of(x, y) + rounding*maxval(abs(z%value))
    case (divide)
      call divide_by(x, y, z)
    case (power)
      call raise(x, y, z)
    case (f_atan2)
      call angle(x, y, z)
    case (f_min, f_max)
      call extreme(code, x, y, z)
    case (f_less, f_atmost, f_more, f_atleast)
      call compare(code, x%value - y%value([2, 1]), z)
    case default
      call lose(z)
    end select
    if (any(code == [multiply, divide, power])) z%size = maxval(abs(z%value))
    x = z
  end subroutine combine

  !> Rounding error of a product from the errors of its factors.
  pure real(wp) function spread_of(x, y)
    type(range_type), intent(in) :: x, y
    spread_of = within(maxval(abs(x%value))*min(y%noise, wall)) &
                + within(maxval(abs(y%value))*min(x%noise, wall))
  end function spread_of

  !> Set an unknown range.
  pure subroutine lose(z)
    type(range_type), intent(inout) :: z
    z%value = anything
    z%rate = anything
    z%jumps = .true.
  end subroutine lose

  pure subroutine divide_by(x, y, z)
    type(range_type), intent(in) :: x, y
    type(range_type), intent(inout) :: z
    type(range_type) :: inverse

    if (y%value(1) <= 1.0_wp/wall .and. y%value(2) >= -1.0_wp/wall) then
      call lose(z)
      if (all(abs(y%value) <= 0.0_wp)) z%outside = nowhere
      return
    end if
    inverse%value = 1.0_wp/y%value([2, 1])
    inverse%noise = within(maxval(abs(inverse%value))*within(maxval(abs(inverse%value)) &
                                                             *min(y%noise, wall)))
    z%value = times(x%value, inverse%value)
    z%rate = times(x%rate - lift(times(z%value, y%rate)), inverse%value)
    z%noise = spread_of(x, inverse) + rounding*maxval(abs(z%value))
  end subroutine divide_by

  !> Swap the ends of a range, for a subtraction.
  pure function lift(x) result(turned)
    real(wp), intent(in) :: x(2)
    real(wp) :: turned(2)
    turned = x([2, 1])
  end function lift

  !> x^y.
  pure subroutine raise(x, y, z)
    type(range_type), intent(in) :: x, y
    type(range_type), intent(inout) :: z
    real(wp) :: base(2), logarithm(2)

    if (x%value(2) < 0.0_wp) then
      z%outside = nowhere
      return
    end if
    if (x%value(1) < 0.0_wp) z%outside = max(z%outside, partly)
    if (x%value(1) <= 1.0_wp/wall) then
      call lose(z)
      return
    end if
    base = x%value
    logarithm = log(base)
    z%value = exp(min(max(times(y%value, logarithm), -steepest), steepest))
    z%rate = times(y%rate, logarithm) + times(y%value, times(x%rate, 1.0_wp/base([2, 1])))
    z%rate = times(z%value, z%rate)
    z%noise = within(maxval(abs(logarithm))*min(y%noise, wall)) &
              + within(maxval(abs(y%value))*within(min(x%noise, wall)/base(1))) &
              + rounding*maxval(abs(y%value))*maxval(abs(logarithm))
    z%noise = within(z%value(2)*min(z%noise, wall)) + rounding*z%value(2)
  end subroutine raise

  !> atan2(x, y).
  pure subroutine angle(x, y, z)
    type(range_type), intent(in) :: x, y
    type(range_type), intent(inout) :: z
    real(wp) :: corners(4), size_of(2), weight(2)

    if (x%value(1) <= 0.0_wp .and. x%value(2) >= 0.0_wp .and. y%value(1) <= 0.0_wp) then
      call lose(z)
      z%value = [-pi, pi]
      return
    end if
    corners = atan2(x%value([1, 1, 2, 2]), y%value([1, 2, 1, 2]))
    z%value = [minval(corners), maxval(corners)]
    size_of(1) = max(0.0_wp, x%value(1), -x%value(2))**2 + max(0.0_wp, y%value(1), -y%value(2))**2
    size_of(2) = within(maxval(abs(x%value))**2 + maxval(abs(y%value))**2)
    weight = 1.0_wp/max(size_of([2, 1]), 1.0_wp/wall)
    z%rate = times(times(y%value, x%rate) - lift(times(x%value, y%rate)), weight)
    z%noise = within(min(spread_of(x, y), wall)*weight(2)) + rounding*pi
  end subroutine angle

  pure subroutine extreme(code, x, y, z)
    integer, intent(in) :: code
    type(range_type), intent(in) :: x, y
    type(range_type), intent(inout) :: z

    z%noise = max(x%noise, y%noise)
    if (code == f_min) then
      z%value = min(x%value, y%value)
    else
      z%value = max(x%value, y%value)
    end if
    if (x%value(2) <= y%value(1) .or. y%value(2) <= x%value(1)) then
      ! One of the operands is always the result.
      if ((code == f_min) .eqv. (x%value(1) < y%value(1))) then
        z%rate = x%rate
      else
        z%rate = y%rate
      end if
      if (x%value(2) < y%value(1) .or. y%value(2) < x%value(1)) return
    end if
    z%rate = [min(x%rate(1), y%rate(1)), max(x%rate(2), y%rate(2))]
  end subroutine extreme

  !> Result of a comparison from the range of a difference.
  pure subroutine compare(code, d, z)
    integer, intent(in) :: code
    real(wp), intent(in) :: d(2)
    type(range_type), intent(inout) :: z
    logical :: above, below

    ! atmost and atleast are true for equal values.
    if (code == f_less .or. code == f_atleast) then
      above = d(1) >= 0.0_wp
      below = d(2) < 0.0_wp
    else
      above = d(1) > 0.0_wp
      below = d(2) <= 0.0_wp
    end if
    z%rate = 0.0_wp
    z%noise = 0.0_wp
    if (above .or. below) then
      z%value = merge(1.0_wp, 0.0_wp, above .eqv. (code == f_more .or. code == f_atleast))
    else
      z%value = [0.0_wp, 1.0_wp]
      z%rate = anything
      z%jumps = .true.
    end if
  end subroutine compare

  !> Replace x by where(x, y, z).
  pure subroutine choose(x, y, z)
    type(range_type), intent(inout) :: x
    type(range_type), intent(in) :: y, z
    type(range_type) :: both

    if (x%value(1) > 0.0_wp .or. x%value(2) < 0.0_wp) then
      both = y
    else if (all(abs(x%value) <= 0.0_wp)) then
      both = z
    else
      both%value = [min(y%value(1), z%value(1)), max(y%value(2), z%value(2))]
      both%rate = anything
      both%noise = max(y%noise, z%noise)
      both%jumps = .true.
      both%outside = max(y%outside, z%outside)
      if (min(y%outside, z%outside) < nowhere) both%outside = min(both%outside, partly)
    end if
    both%size = max(y%size, z%size)
    both%jumps = both%jumps .or. x%jumps
    both%outside = max(both%outside, x%outside)
    x = both
  end subroutine choose

  !> Product of two ranges.
  pure function times(x, y) result(z)
    real(wp), intent(in) :: x(2), y(2)
    real(wp) :: z(2), ends(4)
    ends = within([x(1)*y(1), x(1)*y(2), x(2)*y(1), x(2)*y(2)])
    z = [minval(ends), maxval(ends)]
  end function times

end module viscovib_law_bounds
