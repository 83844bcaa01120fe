!> Roots, fractional powers and logarithms of a nonnegative branch, such as max(d, 0)^1.5 of Hertz's
!! contact or abs(v)^0.5.
!!
!! On its surface such a law is not smooth on either side: x^1.5 has no second derivative at 0. With
!! the branch fixed, the base is negative beyond the surface, where the power is undefined. It is
!! then continued as -|x|^p, so that a step that overshoots the surface before it is cut has a
!! force. The same holds for a variable exponent; log is continued as log|x|.
module viscovib_law_roots
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: add, branches, divide, f_abs, f_cosh, f_exp, f_heaviside, &
                                    f_less, f_atleast, f_log, f_max, f_min, f_sqrt, f_where, &
                                    is_whole, known_power, multiply, operands, power, &
                                    put_number, square
  implicit none
  private

  public :: find_roots

  !> Known sign of a value.
  integer, parameter :: any_sign = 0, not_negative = 1, positive = 2
  !> Initial exponent used for log and variable exponents, which may grow faster than every x^p.
  real(wp), parameter :: barely = 0.01_wp

contains

  !> Find roots and powers among the instructions of a law, and the initial exponent on each surface
  !! that causes one (0: smooth on either side of the surface).
  pure subroutine find_roots(code, number, roots, rough)
    integer, intent(in) :: code(:)
    real(wp), intent(in) :: number(:)
    !> Shapes: number of instructions, number of surfaces, in their order.
    logical, intent(out) :: roots(:)
    real(wp), intent(out) :: rough(:)
    !> For each value on the stack: its sign, and its first instruction.
    integer :: signs(size(code) + 2), begins(size(code) + 2)
    integer :: ends, first, i, last, n, top
    real(wp) :: exponent

    roots = .false.
    rough = 0.0_wp
    top = 0
    do i = 1, size(code)
      n = operands(code(i))
      top = top - n + 1
      if (n == 0) begins(top) = i
      if (is_broken(code(i), number(i)) .and. signs(top) /= any_sign) then
        ! Last instruction of the base.
        ends = i - 1
        if (n == 2) ends = begins(top + 1) - 1
        roots(i) = any(branches(code(begins(top):ends)))
        if (signs(top) == not_negative) then
          first = count(branches(code(:begins(top) - 1))) + 1
          last = count(branches(code(:ends)))
          exponent = power_of(code(i), number(i))
          where (rough(first:last) > 0.0_wp)
            rough(first:last) = min(rough(first:last), exponent)
          else where
            rough(first:last) = exponent
          end where
        end if
      end if
      signs(top) = sign_of(code(i), number(i), signs(top:top + max(n, 1) - 1))
    end do
  end subroutine find_roots

  !> True for a root, a log, or a power that is not known to be an integer or negative.
  pure logical function is_broken(code, number)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    is_broken = any(code == [f_sqrt, f_log, power]) &
                .or. (code == known_power .and. number > 0.0_wp .and. .not. is_whole(number))
  end function is_broken

  !> Initial exponent of the law.
  pure real(wp) function power_of(code, number)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    select case (code)
    case (f_sqrt)
      power_of = 0.5_wp
    case (known_power)
      power_of = number
    case default
      power_of = barely
    end select
  end function power_of

  !> Sign of a value from the signs of its operands.
  pure integer function sign_of(code, number, signs)
    integer, intent(in) :: code, signs(:)
    real(wp), intent(in) :: number

    select case (code)
    case (put_number)
      sign_of = merge(positive, merge(not_negative, any_sign, number >= 0.0_wp), number > 0.0_wp)
    case (add)
      sign_of = merge(maxval(signs), any_sign, minval(signs) /= any_sign)
    case (multiply, divide, f_min)
      sign_of = minval(signs)
    case (f_max)
      sign_of = maxval(signs)
    case (f_where)
      sign_of = minval(signs(2:))
    case (f_exp, f_cosh)
      sign_of = positive
    case (square)
      sign_of = max(not_negative, signs(1))
    case (power)
      sign_of = signs(1)
    case (known_power)
      sign_of = signs(1)
      if (is_whole(number)) then
        if (mod(nint(number), 2) == 0) sign_of = max(not_negative, signs(1))
      end if
    case (f_sqrt, f_abs)
      sign_of = max(not_negative, signs(1))
    case (f_heaviside, f_less:f_atleast)
      sign_of = not_negative
    case default
      sign_of = any_sign
    end select
  end function sign_of

end module viscovib_law_roots
