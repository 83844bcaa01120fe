!> Numbers as text: strict reading, exact writing.
module viscovib_number_text
  use, intrinsic :: ieee_arithmetic, only: ieee_get_halting_mode, ieee_is_finite, ieee_is_nan, &
    ieee_is_negative, ieee_overflow, ieee_set_halting_mode
  use, intrinsic :: iso_c_binding, only: c_char, c_double, c_int
  use viscovib_kinds, only: i8, wp
  implicit none
  private

  public :: parse_real, parse_integer, exact, exact_list

  character(len=*), parameter :: digits = '0123456789'
  !> Length of a number with 17 significant digits.
  integer, parameter :: width = 24

  interface
    !> The C library formats numbers several times faster than the compiler's run-time library.
    pure subroutine c_format(value, text, length) bind(c, name='viscovib_format')
      import :: c_char, c_double, c_int
      real(c_double), value :: value
      character(kind=c_char), intent(out) :: text(*)
      integer(c_int), intent(out) :: length
    end subroutine c_format
  end interface

contains

  !> Read a number such as 1, -0.5, .5, 1.e5, 1e-3, 1d-3. Stricter than the compiler's reading,
  !! which accepts 1-2 for 1e-2 and stops at a slash. Also fails for numbers that overflow or
  !! underflow.
  subroutine parse_real(text, value, ok)
    character(len=*), intent(in) :: text
    real(wp), intent(out) :: value
    logical, intent(out) :: ok
    logical :: halting, short
    integer :: mantissa, io

    value = 0.0_wp
    mantissa = scan(text, 'eEdD') - 1
    if (mantissa < 0) mantissa = len(text)
    ok = is_decimal(text(:mantissa))
    if (mantissa < len(text)) ok = ok .and. is_whole(text(mantissa + 2:))
    if (.not. ok) return
    call parse_short(text, mantissa, value, short)
    if (short) return
    ! A number that overflows becomes infinite and is rejected below; do not trap.
    call ieee_get_halting_mode(ieee_overflow, halting)
    call ieee_set_halting_mode(ieee_overflow, .false.)
    read (text, *, iostat=io) value
    call ieee_set_halting_mode(ieee_overflow, halting)
    ok = io == 0
    if (ok) ok = ieee_is_finite(value)
    if (ok .and. .not. abs(value) > 0.0_wp) ok = scan(text(:mantissa), '123456789') == 0
    if (.not. ok) value = 0.0_wp
  end subroutine parse_real

  !> Read a number of at most 15 digits with a small exponent. Digits and power of ten are exact, so
  !! one division or product is rounded correctly, many times faster than the general method.
  pure subroutine parse_short(text, mantissa, value, short)
    !> Decimal up to `mantissa`, followed by an exponent or nothing.
    character(len=*), intent(in) :: text
    integer, intent(in) :: mantissa
    real(wp), intent(inout) :: value
    logical, intent(out) :: short
    integer, parameter :: most_digits = 15, most_power = 22
    integer :: i
    real(wp), parameter :: powers(0:most_power) = [(10.0_wp**i, i=0, most_power)]
    integer(i8) :: whole
    integer :: power, exponent, sign_of

    whole = 0
    power = 0
    short = mantissa <= most_digits .and. len(text) - mantissa <= 4
    if (.not. short) return
    do i = 1, mantissa
      select case (text(i:i))
      case ('0':'9')
        whole = 10*whole + (iachar(text(i:i)) - iachar('0'))
        if (power > 0) power = power + 1
      case ('.')
        power = 1
      case default
        ! A sign.
      end select
    end do
    power = -max(power - 1, 0)
    exponent = 0
    sign_of = 1
    do i = mantissa + 2, len(text)
      select case (text(i:i))
      case ('0':'9')
        exponent = 10*exponent + (iachar(text(i:i)) - iachar('0'))
      case ('-')
        sign_of = -1
      case default
        ! A plus.
      end select
    end do
    power = power + sign_of*exponent
    short = abs(power) <= most_power .and. whole > 0
    if (.not. short) return
    if (power >= 0) then
      value = real(whole, wp)*powers(power)
    else
      value = real(whole, wp)/powers(-power)
    end if
    if (text(1:1) == '-') value = -value
  end subroutine parse_short

  !> Read a default integer; fails if it overflows.
  subroutine parse_integer(text, value, ok)
    character(len=*), intent(in) :: text
    integer, intent(out) :: value
    logical, intent(out) :: ok
    integer :: io
    value = 0
    ok = is_whole(text)
    if (.not. ok) return
    read (text, *, iostat=io) value
    ok = io == 0
    if (.not. ok) value = 0
  end subroutine parse_integer

  !> Position after a sign, if there is one.
  pure integer function after_sign(text)
    character(len=*), intent(in) :: text
    after_sign = 1
    if (len(text) > 0) then
      if (scan(text(1:1), '+-') == 1) after_sign = 2
    end if
  end function after_sign

  !> True for digits with an optional sign.
  pure logical function is_whole(text)
    character(len=*), intent(in) :: text
    integer :: first
    first = after_sign(text)
    is_whole = first <= len(text) .and. verify(text(first:), digits) == 0
  end function is_whole

  !> True for digits with at most one point and an optional sign.
  pure logical function is_decimal(text)
    character(len=*), intent(in) :: text
    integer :: first, point
    first = after_sign(text)
    point = index(text, '.')
    is_decimal = scan(text, digits) > 0 .and. verify(text(first:), digits//'.') == 0
    if (point > 0) is_decimal = is_decimal .and. index(text(point + 1:), '.') == 0
  end function is_decimal

  !> Text that reads back to the same number, in the format of other languages: 17 digits, an
  !! exponent of two or, if necessary, three digits; "nan", "inf".
  pure function exact(value)
    real(wp), intent(in) :: value
    character(len=width) :: exact
    integer(c_int) :: length

    if (.not. ieee_is_finite(value)) then
      exact = 'nan'
      if (.not. ieee_is_nan(value)) exact = merge('-inf', 'inf ', ieee_is_negative(value))
      return
    end if
    call c_format(value, exact, length)
    exact(length + 1:) = ''
  end function exact

  !> Numbers in lines of four, each after a blank, written to one preallocated text, since a list
  !! may have a million.
  pure function exact_list(values) result(text)
    real(wp), intent(in) :: values(:)
    character(len=:), allocatable :: text
    character(len=*), parameter :: next_line = new_line('a')//'    '
    ! Format small integers once, since they dominate in long lists.
    integer, parameter :: n_known = 99
    character(len=width) :: known(0:merge(n_known, 0, size(values) > 1000)), written
    integer :: i, at, whole
    known = [(exact(real(i, wp)), i=0, ubound(known, 1))]
    allocate (character(len=size(values)*(width + 1) &
                        + max(size(values) - 1, 0)/4*len(next_line)) :: text)
    at = 0
    do i = 1, size(values)
      if (i > 1 .and. mod(i, 4) == 1) then
        text(at + 1:at + len(next_line)) = next_line
        at = at + len(next_line)
      end if
      whole = -1
      if (values(i) > 0.0_wp .and. values(i) <= ubound(known, 1)) whole = int(values(i))
      if (whole > 0 .and. abs(values(i) - whole) <= 0.0_wp) then
        written = known(whole)
      else
        written = exact(values(i))
      end if
      text(at + 1:at + width + 1) = ' '//written
      at = at + width + 1
    end do
  end function exact_list

end module viscovib_number_text
