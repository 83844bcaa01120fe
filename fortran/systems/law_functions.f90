! Optimize: -O2
!> Instructions of force laws: operands, values, derivatives, parity and degree.
!!
!! Outside the domain of a function, and near a zero denominator, the value is `wall`. It is so
!! large that no solution can lie there, and it avoids non-finite numbers. A law with such a value
!! as an operand is `wall` as a whole (viscovib_law_program).
module viscovib_law_functions
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: bounded, branches, degree_of, is_whole, jumps, leaves, of_one, of_two, operands, &
            parity_of, within

  !> The value outside a domain, and the largest argument of exp.
  real(wp), parameter, public :: wall = 1.0e60_wp, steepest = 138.0_wp

  !> Largest degree that counts as a polynomial.
  integer, parameter :: highest_degree = 15

  !> Instructions. The number of `known_power` is its exponent.
  integer, parameter, public :: put_number = 1, put_argument = 2, add = 3, subtract = 4, &
                                multiply = 5, divide = 6, power = 7, square = 8, &
                                known_power = 9, negate = 10
  !> Functions, in the order of their names.
  character(len=9), parameter, public :: functions(27) = [character(len=9) :: &
                              'sin', 'cos', 'tan', 'asin', 'acos', 'atan', 'sinh', 'cosh', 'tanh', &
                              'asinh', 'acosh', 'atanh', 'exp', 'log', 'sqrt', 'abs', 'sign', &
                              'heaviside', 'atan2', 'min', 'max', 'less', 'atmost', 'more', &
                              'atleast', 'where', 'pow']
  integer, parameter, public :: first_function = 11
  !> Replacements of functions with a fixed branch: a number, the first or the second operand.
  integer, parameter, public :: number_for_one = -1, number_for_two = -2, first_of_two = -3, &
                                second_of_two = -4
  !> Replacement of a root or power with a fixed branch of its operand, continued to negative
  !! values: sign(x) |x|^number.
  integer, parameter, public :: held_power = -5
  !> Similar replacements: a power with a variable exponent, where this is above 0; log as log|x|,
  !! with a large finite value at 0, where intervals of smooth motion start.
  integer, parameter, public :: held_pair = -8, held_log = -9
  !> Replacements of atan2 above and below its cut (first operand 0, second negative): the angle is
  !! continued across the cut.
  integer, parameter, public :: angle_above = -6, angle_below = -7
  integer, parameter, public :: f_tan = 13, f_asin = 14, f_acos = 15, f_atan = 16, f_sinh = 17, &
                                f_asinh = 20, f_acosh = 21, f_atanh = 22
  integer, parameter, public :: f_atan2 = 29
  integer, parameter, public :: f_sin = 11, f_cos = 12, f_cosh = 18, f_tanh = 19, f_exp = 23, &
                                f_log = 24, f_sqrt = 25
  integer, parameter, public :: f_abs = 26, f_sign = 27, f_heaviside = 28, f_min = 30, f_max = 31
  integer, parameter, public :: f_less = 32, f_atmost = 33, f_more = 34, f_atleast = 35, &
                                f_where = 36, f_pow = 37
  !> A function outside of the core (viscovib_law_outside) with n operands has the code
  !! `called` + n; its number identifies the function.
  integer, parameter, public :: called = 40, most_called = 8

contains

  !> Number of operands of an instruction.
  elemental integer function operands(code)
    integer, intent(in) :: code
    select case (code)
    case (put_number, put_argument)
      operands = 0
    case (add, subtract, multiply, divide, power, f_atan2:f_atleast, f_pow, &
          second_of_two:number_for_two, held_pair:angle_above)
      operands = 2
    case (f_where)
      operands = 3
    case (called + 1:called + most_called)
      operands = code - called
    case default
      operands = 1
    end select
  end function operands

  !> True for an instruction with a kink or jump where its operand (of atan2 the first) is 0, or
  !! where both operands are equal.
  elemental logical function branches(code)
    integer, intent(in) :: code
    branches = any(code == [f_abs, f_min, f_max]) .or. jumps(code)
  end function branches

  !> True for a jump.
  elemental logical function jumps(code)
    integer, intent(in) :: code
    jumps = any(code == [f_sign, f_heaviside, f_atan2]) &
            .or. (code >= f_less .and. code <= f_atleast)
  end function jumps

  !> True for an instruction with a bounded domain, outside of which it is undefined.
  elemental logical function bounded(code)
    integer, intent(in) :: code
    bounded = any(code == [power, known_power, f_asin, f_acos, f_acosh, f_atanh, f_log, f_sqrt])
  end function bounded

  !> True if the operand (the first of two) is outside of the domain.
  elemental logical function leaves(code, number, x)
    integer, intent(in) :: code
    real(wp), intent(in) :: number, x
    select case (code)
    case (f_asin, f_acos)
      leaves = abs(x) > 1.0_wp
    case (f_acosh)
      leaves = x < 1.0_wp
    case (f_atanh)
      leaves = abs(x) >= 1.0_wp
    case (known_power)
      leaves = x < 0.0_wp .and. .not. is_whole(number)
    case default
      leaves = x < 0.0_wp .and. bounded(code)
    end select
  end function leaves

  !> Limit a value to +-`wall`, so that a product of two values is finite.
  elemental real(wp) function within(x)
    real(wp), intent(in) :: x
    within = min(max(x, -wall), wall)
  end function within

  !> Value and derivatives of a function of two numbers.
  pure subroutine of_two(code, x, y, value, by)
    integer, intent(in) :: code
    real(wp), intent(in) :: x, y
    real(wp), intent(out) :: value, by(2)
    real(wp) :: size_of

    by = 0.0_wp
    value = wall
    select case (code)
    case (divide)
      if (abs(y) <= abs(x)/wall) return
      value = x/y
      by = [1.0_wp/y, -value/y]
    case (power)
      call of_pair(x, y, value, by)
    case (held_pair)
      call of_pair(merge(abs(x), x, y > 0.0_wp), y, value, by)
      if (y > 0.0_wp) value = sign(value, x)
      if (y > 0.0_wp) by(2) = sign(1.0_wp, x)*by(2)
    case (f_atan2, angle_above, angle_below)
      size_of = x*x + y*y
      value = 0.0_wp
      if (.not. size_of > 0.0_wp) return
      value = atan2(x, y)
      if (y < 0.0_wp) then
        if (code == angle_above .and. value < 0.0_wp) value = value + 2.0_wp*pi
        if (code == angle_below .and. value > 0.0_wp) value = value - 2.0_wp*pi
      end if
      by = [y/size_of, -x/size_of]
    case (f_min, f_max)
      ! At equality each operand has the derivative 1/2.
      size_of = merge(0.5_wp, 1.0_wp, .not. abs(x - y) > 0.0_wp)
      if ((code == f_min) .eqv. (x <= y)) then
        value = x
        by = [size_of, 1.0_wp - size_of]
      else
        value = y
        by = [1.0_wp - size_of, size_of]
      end if
    case (f_less)
      value = merge(1.0_wp, 0.0_wp, x < y)
    case (f_atmost)
      value = merge(1.0_wp, 0.0_wp, x <= y)
    case (f_more)
      value = merge(1.0_wp, 0.0_wp, x > y)
    case default
      value = merge(1.0_wp, 0.0_wp, x >= y)
    end select
  end subroutine of_two

  !> Value and derivative of a function of one number, or of its power.
  pure subroutine of_one(code, number, x, value, by)
    integer, intent(in) :: code
    real(wp), intent(in) :: number, x
    real(wp), intent(out) :: value, by

    value = wall
    by = 0.0_wp
    select case (code)
    case (known_power)
      call of_power(x, number, value, by)
    case (held_power)
      call of_power(abs(x), number, value, by)
      value = sign(value, x)
    case (f_sin)
      value = sin(x)
      by = cos(x)
    case (f_cos)
      value = cos(x)
      by = -sin(x)
    case (f_tan)
      if (abs(cos(x)) <= 1.0_wp/wall) return
      value = tan(x)
      by = 1.0_wp + value*value
    case (f_asin, f_acos)
      if (abs(x) >= 1.0_wp) then
        if (abs(x) <= 1.0_wp) value = merge(asin(x), acos(x), code == f_asin)
        return
      end if
      value = merge(asin(x), acos(x), code == f_asin)
      by = merge(1.0_wp, -1.0_wp, code == f_asin)/sqrt((1.0_wp - x)*(1.0_wp + x))
    case (f_atan)
      value = atan(x)
      by = 1.0_wp/(1.0_wp + min(x*x, wall))
    case (f_sinh, f_cosh)
      if (abs(x) > steepest) return
      value = merge(sinh(x), cosh(x), code == f_sinh)
      by = merge(cosh(x), sinh(x), code == f_sinh)
    case (f_tanh)
      value = tanh(x)
      by = (1.0_wp - value)*(1.0_wp + value)
      ! For large arguments the difference above is only rounding error.
      if (abs(x) > 10.0_wp) by = 4.0_wp*exp(-2.0_wp*min(abs(x), steepest))
    case (f_asinh)
      value = asinh(x)
      by = 1.0_wp/sqrt(1.0_wp + min(x*x, wall))
    case (f_acosh)
      if (x < 1.0_wp) return
      value = acosh(x)
      if (x > 1.0_wp) by = 1.0_wp/sqrt((x - 1.0_wp)*(x + 1.0_wp))
    case (f_atanh)
      if (abs(x) >= 1.0_wp) return
      value = atanh(x)
      by = 1.0_wp/((1.0_wp - x)*(1.0_wp + x))
    case (f_exp)
      if (x > steepest) return
      value = exp(max(x, -700.0_wp))
      by = value
    case (f_log)
      if (x <= 1.0_wp/wall) return
      value = log(x)
      by = 1.0_wp/x
    case (held_log)
      value = log(max(abs(x), 1.0_wp/wall))
      if (abs(x) > 1.0_wp/wall) by = 1.0_wp/x
    case (f_sqrt)
      if (x < 0.0_wp) return
      value = sqrt(x)
      if (x > 1.0_wp/wall) by = 0.5_wp/value
    case (f_abs)
      value = abs(x)
      by = merge(0.0_wp, sign(1.0_wp, x), .not. abs(x) > 0.0_wp)
    case (f_sign)
      value = merge(0.0_wp, sign(1.0_wp, x), .not. abs(x) > 0.0_wp)
    case default
      value = merge(0.5_wp, merge(1.0_wp, 0.0_wp, x > 0.0_wp), .not. abs(x) > 0.0_wp)
    end select
  end subroutine of_one

  !> x^number; a negative x has integer powers only.
  pure subroutine of_power(x, number, value, by)
    real(wp), intent(in) :: x, number
    real(wp), intent(inout) :: value, by

    if (.not. abs(number) > 0.0_wp) then
      value = 1.0_wp
    else if (.not. abs(x) > 0.0_wp) then
      if (number > 0.0_wp) value = 0.0_wp
      if (abs(number - 1.0_wp) <= 0.0_wp) by = 1.0_wp
    else if (x > 0.0_wp .or. is_whole(number)) then
      if (abs(number*log(abs(x))) > steepest) then
        ! Overflow (`wall`) or underflow (0).
        if (number*log(abs(x)) < 0.0_wp) value = 0.0_wp
      else if (abs((number - 1.0_wp)*log(abs(x))) > steepest) then
        ! The same of the slope.
        value = x**number
        if ((number - 1.0_wp)*log(abs(x)) > 0.0_wp) by = sign(wall, number)
      else if (is_whole(number)) then
        value = x**nint(number)
        by = number*x**(nint(number) - 1)
      else
        value = x**number
        by = number*x**(number - 1.0_wp)
      end if
    end if
  end subroutine of_power

  !> x^y; undefined for negative x.
  pure subroutine of_pair(x, y, value, by)
    real(wp), intent(in) :: x, y
    real(wp), intent(inout) :: value, by(2)

    if (x <= 0.0_wp) then
      if (abs(x) > 0.0_wp .or. y < 0.0_wp) return
      value = merge(0.0_wp, 1.0_wp, y > 0.0_wp)
    else if (abs(y*log(x)) > steepest) then
      ! Overflow (`wall`) or underflow (0).
      if (y*log(x) < 0.0_wp) value = 0.0_wp
    else
      value = x**y
      by = [y*x**(y - 1.0_wp), value*log(x)]
    end if
  end subroutine of_pair

  elemental logical function is_whole(number)
    real(wp), intent(in) :: number
    is_whole = abs(number - anint(number)) <= 0.0_wp .and. abs(number) < 1.0e6_wp
  end function is_whole

  !> Parity of a law when all its arguments change sign, from the parities of its operands. 1: even,
  !! -1: odd, 0: unknown.
  pure integer function parity_of(code, number, parities) result(parity)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    !> Shape (operands(code)).
    integer, intent(in) :: parities(:)

    parity = 0
    select case (code)
    case (put_number)
      parity = 1
    case (put_argument)
      parity = -1
    case (add, subtract)
      if (parities(1) == parities(2)) parity = parities(1)
    case (multiply, divide)
      parity = product(parities)
    case (negate, f_sin, f_tan, f_asin, f_atan, f_sinh, f_tanh, f_asinh, f_atanh, f_sign)
      parity = parities(1)
    case (square)
      parity = parities(1)**2
    case (known_power)
      if (is_whole(number)) then
        parity = merge(parities(1)**2, parities(1), mod(nint(number), 2) == 0)
      else if (parities(1) == 1) then
        parity = 1
      end if
    case (f_cos, f_cosh, f_abs)
      parity = parities(1)**2
    case (f_where)
      if (parities(1) == 1 .and. parities(2) == parities(3)) parity = parities(2)
    case default
      if (all(parities == 1)) parity = 1
    end select
  end function parity_of

  !> Degree of a law as a polynomial in its arguments, from those of its operands; -1: none.
  pure integer function degree_of(code, number, degrees) result(degree)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    !> Shape (operands(code)).
    integer, intent(in) :: degrees(:)

    degree = -1
    if (any(degrees < 0)) return
    select case (code)
    case (put_number)
      degree = 0
    case (put_argument)
      degree = 1
    case (add, subtract)
      degree = maxval(degrees)
    case (multiply)
      degree = sum(degrees)
    case (divide)
      if (degrees(2) == 0) degree = degrees(1)
    case (negate)
      degree = degrees(1)
    case (square)
      degree = 2*degrees(1)
    case (known_power)
      if (is_whole(number) .and. number >= 0.0_wp) degree = degrees(1)*nint(number)
    case default
      if (all(degrees == 0)) degree = 0
    end select
    if (degree > highest_degree) degree = -1
  end function degree_of

end module viscovib_law_functions
