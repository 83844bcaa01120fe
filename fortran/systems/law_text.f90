!> Force laws written as text, such as F0*tanh(v/0.01) or k*max(d - gap, 0), compiled.
!!
!!   sum        := term {(+|-) term}
!!   comparison := sum [(<|<=|>|>=) sum]
!!   term       := factor {(*|/) factor}
!!   factor     := {+|-} power
!!   power      := primary [(^|**) factor]
!!   primary    := number | name | function ( comparison {, comparison} ) | ( comparison )
!!
!! Names are arguments of the law or parameters, which are replaced by their values. Constant
!! expressions are evaluated at compile time.
!!
!! Functions of engineering elements are odd in their first operand. Constants follow:
!!
!!   stop(d, gap, exponent)                            (|d| - gap)^exponent beyond the gap
!!   relief(v, coefficient, exponent, limit, slope)    fluid damper with a relief valve
!!   stribeck(v, coulomb, static, velocity, exponent, width)
!!                                                     dry friction with a Stribeck curve
module viscovib_law_text
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: f_atan, f_atan2
  use viscovib_law_program, only: add, degree_of, divide, f_atleast, f_atmost, f_less, f_more, &
    f_pow, first_function, functions, known_power, law_program, multiply, negate, operands, &
    parity_of, power, put_argument, put_number, square, subtract, wall
  use viscovib_near_words, only: means, off_by
  use viscovib_status, only: clipped, show
  use viscovib_text_cursor, only: digits, text_cursor
  implicit none
  private

  public :: compile_law

  !> Limits on nesting, length and stack.
  integer, parameter :: max_depth = 100, max_code = 2000, max_stack = 60
  !> atan2 with a larger number as its second operand becomes atan of the quotient.
  real(wp), parameter :: least_divisor = 1.0e-20_wp
  character(len=*), parameter :: letters = &
                                 'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_'

  type, extends(text_cursor) :: cursor_type
    !> Program, parities and degrees on the stack; length of the program, depth of the stack.
    integer :: code(max_code) = 0, parity(max_stack) = 0, degree(max_stack) = 0
    integer :: n = 0, held = 0
    real(wp) :: number(max_code) = 0.0_wp
  end type cursor_type

  !> Names of the functions, and largest number of constants.
  character(len=8), parameter :: element_functions(3) = ['stop    ', 'relief  ', 'stribeck']
  integer, parameter :: most_constants = 5

  !> Constants of a function: name, smallest and largest value, and default (below the smallest
  !! value: required). A smallest value of `above_0` means greater than 0.
  type :: constant_type
    character(len=11) :: name
    real(wp) :: least, most, default
  end type constant_type

  real(wp), parameter :: above_0 = tiny(1.0_wp), endless = huge(1.0_wp), none = -1.0_wp

contains

  pure subroutine list_constants(name, constants)
    character(len=*), intent(in) :: name
    type(constant_type), allocatable, intent(out) :: constants(:)
    select case (name)
    case ('stop')
      constants = [constant_type('gap', 0.0_wp, endless, none), &
                   constant_type('exponent', 1.0_wp, 20.0_wp, 1.0_wp)]
    case ('relief')
      constants = [constant_type('coefficient', above_0, endless, none), &
                   constant_type('exponent', 0.1_wp, 2.0_wp, none), &
                   constant_type('limit', above_0, endless, none), &
                   constant_type('slope', 0.0_wp, endless, 0.0_wp)]
    case default
      constants = [constant_type('coulomb', 0.0_wp, endless, none), &
                   constant_type('static', above_0, endless, none), &
                   constant_type('velocity', above_0, endless, none), &
                   constant_type('exponent', 0.5_wp, 4.0_wp, 1.0_wp), &
                   constant_type('width', 0.0_wp, endless, 0.0_wp)]
    end select
  end subroutine list_constants

  !> Check the constants of a function, and append defaults.
  pure subroutine read_constants(name, values, fault)
    character(len=*), intent(in) :: name
    real(wp), allocatable, intent(inout) :: values(:)
    !> Description of an error; empty: none.
    character(len=:), allocatable, intent(out) :: fault
    type(constant_type), allocatable :: constants(:)
    character(len=:), allocatable :: listed
    integer :: i, n

    fault = ''
    listed = ''
    call list_constants(name, constants)
    do i = 1, size(constants)
      listed = listed//', '//trim(constants(i)%name)
    end do
    n = size(values)
    do i = n + 1, size(constants)
      if (constants(i)%default >= constants(i)%least) values = [values, constants(i)%default]
    end do
    if (size(values) /= size(constants)) then
      fault = name//' has '//show(n)//' constants: must be '//name//'(u'//listed//')'
      return
    end if
    do i = 1, size(values)
      associate (one => constants(i))
        if (values(i) >= one%least .and. values(i) <= one%most) cycle
        fault = name//': '//trim(one%name)//' = '//show(values(i))//': must be '
        if (one%most < endless) then
          fault = fault//show(one%least)//' to '//show(one%most)
        else if (one%least > 0.0_wp) then
          fault = fault//'greater than 0'
        else
          fault = fault//'at least 0'
        end if
        return
      end associate
    end do
    if (name == 'stribeck') then
      if (values(2) < values(1)) fault = name//': static = '//show(values(2)) &
                                         //': must be at least coulomb, '//show(values(1))
    end if
  end subroutine read_constants

  !> The law of a function of u in its constants a, b, c, d, e.
  pure function element_function(name, constants) result(text)
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: constants(:)
    character(len=:), allocatable :: text
    select case (name)
    case ('stop')
      text = 'max(u - a, 0)^b - max(-u - a, 0)^b'
    case ('relief')
      ! At exponent 1 the slope at rest is finite.
      text = 'a*sign(u)*abs(u)^b'
      if (abs(constants(2) - 1.0_wp) <= 0.0_wp) text = 'a*u'
      text = 'where(abs(u) < (c/a)^(1/b), '//text//', sign(u)*(c + d*(abs(u) - (c/a)^(1/b))))'
    case default
      text = '(a + (b - a)*exp(-abs(u/c)^d))*'
      if (constants(5) > 0.0_wp) then
        text = text//'tanh(u/e)'
      else
        text = text//'sign(u)'
      end if
    end select
  end function element_function

  !> Compile a text. `fault` describes an error, and is empty otherwise.
  recursive subroutine compile_law(text, arguments, names, values, program, parity, degree, fault)
    character(len=*), intent(in) :: text
    !> Names of arguments, and of parameters with their values.
    character(len=*), intent(in) :: arguments(:), names(:)
    real(wp), intent(in) :: values(:)
    type(law_program), intent(out) :: program
    !> Parity as for `parity_of`; degree as a polynomial, 0 if it is none.
    integer, intent(out) :: parity, degree
    character(len=:), allocatable, intent(out) :: fault
    type(cursor_type) :: cursor

    parity = 0
    degree = 0
    call cursor%begin(text)
    call read_comparison(cursor, arguments, names, values)
    if (cursor%fault == '' .and. cursor%peek() /= ' ') then
      call cursor%expect('an operator or the end')
    end if
    fault = cursor%fault
    if (fault /= '') return
    program%n_arguments = size(arguments)
    program%code = cursor%code(:cursor%n)
    program%number = cursor%number(:cursor%n)
    call program%measure()
    parity = cursor%parity(1)
    degree = max(cursor%degree(1), 0)
  end subroutine compile_law

  !> Append an instruction. Instructions with constant operands are evaluated.
  subroutine emit(cursor, code, number)
    type(cursor_type), intent(inout) :: cursor
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    type(law_program) :: known
    real(wp) :: value(1), nothing(1, 0)
    integer :: first, n

    if (cursor%fault /= '') return
    n = operands(code)
    if (cursor%n >= max_code .or. cursor%held - n + 1 > max_stack) then
      cursor%fault = 'it is too long'
      return
    end if
    cursor%n = cursor%n + 1
    cursor%code(cursor%n) = code
    cursor%number(cursor%n) = number
    first = cursor%held - n + 1
    cursor%parity(first) = parity_of(code, number, cursor%parity(first:cursor%held))
    cursor%degree(first) = degree_of(code, number, cursor%degree(first:cursor%held))
    cursor%held = first
    first = cursor%n - n
    if (n == 0) return
    if (any(cursor%code(first:cursor%n - 1) /= put_number)) return
    known%code = cursor%code(first:cursor%n)
    known%number = cursor%number(first:cursor%n)
    call known%measure()
    call known%evaluate(nothing, value)
    if (abs(value(1)) >= wall) then
      cursor%fault = 'it divides by 0, or takes a function outside its domain'
      return
    end if
    cursor%n = first
    cursor%code(first) = put_number
    cursor%number(first) = value(1)
    cursor%parity(cursor%held) = 1
    cursor%degree(cursor%held) = 0
  end subroutine emit

  recursive subroutine read_comparison(cursor, arguments, names, values)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: arguments(:), names(:)
    real(wp), intent(in) :: values(:)
    integer :: code
    logical :: orequal

    call read_sum(cursor, arguments, names, values)
    if (cursor%fault /= '' .or. scan(cursor%peek(), '<>') == 0) return
    code = merge(f_less, f_more, cursor%peek() == '<')
    cursor%at = cursor%at + 1
    orequal = cursor%text(cursor%at:cursor%at) == '='
    if (orequal) cursor%at = cursor%at + 1
    if (orequal) code = merge(f_atmost, f_atleast, code == f_less)
    call read_sum(cursor, arguments, names, values)
    call emit(cursor, code, 0.0_wp)
  end subroutine read_comparison

  recursive subroutine read_sum(cursor, arguments, names, values)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: arguments(:), names(:)
    real(wp), intent(in) :: values(:)
    integer :: code

    call read_term(cursor, arguments, names, values)
    do while (cursor%fault == '' .and. scan(cursor%peek(), '+-') > 0)
      code = merge(add, subtract, cursor%peek() == '+')
      cursor%at = cursor%at + 1
      call read_term(cursor, arguments, names, values)
      call emit(cursor, code, 0.0_wp)
    end do
  end subroutine read_sum

  recursive subroutine read_term(cursor, arguments, names, values)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: arguments(:), names(:)
    real(wp), intent(in) :: values(:)
    integer :: code, left
    logical :: known

    call read_factor(cursor, arguments, names, values)
    do while (cursor%fault == '' .and. scan(cursor%peek(), '*/') > 0)
      code = merge(multiply, divide, cursor%peek() == '*')
      cursor%at = cursor%at + 1
      left = cursor%n
      call read_factor(cursor, arguments, names, values)
      if (code == multiply .and. cursor%fault == '') call put_number_last(cursor, left)
      if (code == divide .and. cursor%fault == '') then
        known = cursor%code(cursor%n) == put_number
        if (known .and. .not. abs(cursor%number(cursor%n)) > 0.0_wp) cursor%fault &
          = 'it divides by 0'
      end if
      call emit(cursor, code, 0.0_wp)
    end do
  end subroutine read_term

  !> Swap a number and a value that it multiplies. The product is identical and needs less stack.
  subroutine put_number_last(cursor, left)
    type(cursor_type), intent(inout) :: cursor
    !> Last instruction of the first factor (its only one if it is a number).
    integer, intent(in) :: left

    if (cursor%code(left) /= put_number .or. cursor%code(cursor%n) == put_number) return
    associate (n => cursor%n, h => cursor%held)
      cursor%code(left:n) = [cursor%code(left + 1:n), put_number]
      cursor%number(left:n) = [cursor%number(left + 1:n), cursor%number(left)]
      cursor%parity(h - 1:h) = cursor%parity(h:h - 1:-1)
      cursor%degree(h - 1:h) = cursor%degree(h:h - 1:-1)
    end associate
  end subroutine put_number_last

  recursive subroutine read_factor(cursor, arguments, names, values)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: arguments(:), names(:)
    real(wp), intent(in) :: values(:)
    logical :: negative

    negative = .false.
    do while (scan(cursor%peek(), '+-') > 0)
      negative = negative .neqv. cursor%peek() == '-'
      cursor%at = cursor%at + 1
    end do
    call read_power(cursor, arguments, names, values)
    if (negative) call emit(cursor, negate, 0.0_wp)
  end subroutine read_factor

  recursive subroutine read_power(cursor, arguments, names, values)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: arguments(:), names(:)
    real(wp), intent(in) :: values(:)
    call read_primary(cursor, arguments, names, values)
    if (cursor%fault /= '') return
    if (cursor%peek() /= '^' .and. cursor%next_two() /= '**') return
    cursor%at = cursor%at + merge(1, 2, cursor%peek() == '^')
    cursor%depth = cursor%depth + 1
    if (cursor%depth > max_depth) cursor%fault = 'it must not be nested deeper than ' &
                                                 //show(max_depth)
    if (cursor%fault /= '') return
    call read_factor(cursor, arguments, names, values)
    cursor%depth = cursor%depth - 1
    if (cursor%fault /= '') return
    call raise(cursor)
  end subroutine read_power

  !> Raise the value before the last to the last value. A constant exponent becomes part of the
  !! instruction.
  subroutine raise(cursor)
    type(cursor_type), intent(inout) :: cursor
    real(wp) :: exponent

    if (cursor%fault /= '') return
    if (cursor%code(cursor%n) /= put_number) then
      call emit(cursor, power, 0.0_wp)
      return
    end if
    exponent = cursor%number(cursor%n)
    cursor%n = cursor%n - 1
    cursor%held = cursor%held - 1
    call emit(cursor, merge(square, known_power, abs(exponent - 2.0_wp) <= 0.0_wp), exponent)
  end subroutine raise

  !> Angle of the last two values. With a constant > 0 it is atan of the quotient and has no cut.
  subroutine turn(cursor)
    type(cursor_type), intent(inout) :: cursor

    if (cursor%fault /= '') return
    if (cursor%code(cursor%n) == put_number .and. cursor%number(cursor%n) > least_divisor) then
      call emit(cursor, divide, 0.0_wp)
      call emit(cursor, f_atan, 0.0_wp)
    else
      call emit(cursor, f_atan2, 0.0_wp)
    end if
  end subroutine turn

  recursive subroutine read_primary(cursor, arguments, names, values)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: arguments(:), names(:)
    real(wp), intent(in) :: values(:)
    real(wp) :: value
    character :: c

    c = cursor%peek()
    if (c == '(') then
      cursor%at = cursor%at + 1
      call read_inside(cursor, arguments, names, values, 1)
    else if (scan(c, digits//'.') > 0) then
      call cursor%read_digits('eE', value)
      call emit(cursor, put_number, value)
    else if (scan(c, letters) > 0) then
      call read_name(cursor, arguments, names, values)
    else
      call cursor%expect('a number, a name or (')
    end if
  end subroutine read_primary

  !> Read n values in parentheses.
  recursive subroutine read_inside(cursor, arguments, names, values, n)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: arguments(:), names(:)
    real(wp), intent(in) :: values(:)
    integer, intent(in) :: n
    integer :: i

    cursor%depth = cursor%depth + 1
    if (cursor%depth > max_depth) cursor%fault = 'it must not be nested deeper than ' &
                                                 //show(max_depth)
    do i = 1, n
      if (cursor%fault /= '') return
      call read_comparison(cursor, arguments, names, values)
      if (cursor%fault /= '') return
      if (i == n) exit
      if (cursor%peek() /= ',') call cursor%expect(',')
      if (cursor%fault /= '') return
      cursor%at = cursor%at + 1
    end do
    if (cursor%peek() /= ')') call cursor%expect(')')
    if (cursor%fault /= '') return
    cursor%at = cursor%at + 1
    cursor%depth = cursor%depth - 1
  end subroutine read_inside

  recursive subroutine read_name(cursor, arguments, names, values)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: arguments(:), names(:)
    real(wp), intent(in) :: values(:)
    character(len=:), allocatable :: name
    !> Filled in two steps: gfortran 12 allocates too little memory for a joint array constructor.
    character(len=64) :: known(size(arguments) + size(names))
    integer :: code, first, i

    known(:size(arguments)) = arguments
    known(size(arguments) + 1:) = names
    first = cursor%at
    cursor%at = first + verify(cursor%text(first:), letters//digits) - 1
    name = cursor%text(first:cursor%at - 1)
    if (cursor%peek() == '(') then
      if (place_of(name, element_functions) > 0) then
        call read_element_function(cursor, name, arguments, names, values)
        return
      end if
      i = place_of(name, functions)
      if (i == 0) then
        cursor%fault = "'"//clipped(name)//"' is not a known function" &
                       //likely(name, [character(len=9) :: functions, element_functions])
        return
      end if
      code = first_function + i - 1
      cursor%at = cursor%at + 1
      call read_inside(cursor, arguments, names, values, operands(code))
      if (code == f_pow) then
        call raise(cursor)
      else if (code == f_atan2) then
        call turn(cursor)
      else
        call emit(cursor, code, 0.0_wp)
      end if
      return
    end if
    i = place_of(name, arguments)
    if (i > 0) then
      call emit(cursor, put_argument, real(i, wp))
      return
    end if
    i = place_of(name, names)
    if (i > 0) then
      call emit(cursor, put_number, values(i))
    else if (name == 'pi') then
      call emit(cursor, put_number, pi)
    else
      cursor%fault = "'"//clipped(name)//"' is neither a variable nor a parameter" &
                     //likely(name, known)
    end if
  end subroutine read_name

  !> A function of an engineering element: compile its text, and put its first operand in place
  !! of the argument.
  recursive subroutine read_element_function(cursor, name, arguments, names, values)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: name, arguments(:), names(:)
    real(wp), intent(in) :: values(:)
    character, parameter :: letter(most_constants) = ['a', 'b', 'c', 'd', 'e']
    real(wp), allocatable :: constants(:)
    integer, allocatable :: code(:)
    real(wp), allocatable :: number(:)
    type(law_program) :: program
    character(len=:), allocatable :: fault
    integer :: degree, first, i, j, last, parity

    allocate (constants(0))
    first = cursor%n
    last = first
    do
      cursor%at = cursor%at + 1
      call read_comparison(cursor, arguments, names, values)
      if (cursor%fault /= '') return
      if (last == first) then
        last = cursor%n
      else if (any(cursor%code(last + 1:cursor%n) /= put_number) .or. size(constants) &
               == most_constants) then
        cursor%fault = name//': its operands behind the first must be numbers, at most ' &
                       //show(most_constants)
        return
      else
        constants = [constants, cursor%number(cursor%n)]
        cursor%n = last
        cursor%held = cursor%held - 1
      end if
      if (cursor%peek() /= ',') exit
    end do
    if (cursor%peek() /= ')') call cursor%expect(', or )')
    if (cursor%fault /= '') return
    cursor%at = cursor%at + 1
    call read_constants(name, constants, cursor%fault)
    if (cursor%fault /= '') return
    call compile_law(element_function(name, constants), ['u'], letter(:size(constants)), &
                     constants, program, parity, degree, fault)
    cursor%fault = fault
    if (fault /= '') return
    code = cursor%code(first + 1:last)
    number = cursor%number(first + 1:last)
    parity = cursor%parity(cursor%held)
    cursor%n = first
    cursor%held = cursor%held - 1
    do i = 1, size(program%code)
      if (program%code(i) /= put_argument) then
        call emit(cursor, program%code(i), program%number(i))
        cycle
      end if
      do j = 1, size(code)
        call emit(cursor, code(j), number(j))
      end do
    end do
    ! All these functions are odd.
    if (cursor%fault == '') cursor%parity(cursor%held) = parity
  end subroutine read_element_function

  pure integer function place_of(name, names)
    character(len=*), intent(in) :: name, names(:)
    do place_of = size(names), 1, -1
      if (names(place_of) == name) return
    end do
  end function place_of

  !> Suggestion of the most similar name, as a question; empty if none is similar. Among equally
  !! similar names one of equal length is preferred.
  pure function likely(name, names) result(question)
    character(len=*), intent(in) :: name, names(:)
    character(len=:), allocatable :: question
    integer :: best, far, i

    question = ''
    best = 2*max(len(name)/2, 1) + 2
    do i = 1, size(names)
      far = 2*off_by(name, trim(names(i))) &
            + merge(0, 1, len(name) == len_trim(names(i)))
      if (means(name, trim(names(i)))) far = 0
      if (far >= best) cycle
      best = far
      question = ' (did you mean '//trim(names(i))//'?)'
    end do
  end function likely

end module viscovib_law_text
