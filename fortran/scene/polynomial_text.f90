!> Polynomials written as text, such as 0.5*(x1 - x2)^3, expanded into monomials.
!!
!!   sum     := term {(+|-) term}
!!   term    := factor {(*|/) factor}
!!   factor  := {+|-} power
!!   power   := primary [(^|**) digits]
!!   primary := number | name | ( sum )
module viscovib_polynomial_text
  use viscovib_kinds, only: wp
  use viscovib_polynomial, only: max_degree
  use viscovib_status, only: clipped, show
  use viscovib_text_cursor, only: digits, text_cursor
  implicit none
  private

  public :: terms_type, expand

  !> Bounds that keep a slip of the pen from filling the memory, and the largest power of a number.
  integer, parameter :: max_terms = 20000, max_depth = 100, max_power = 1000
  !> Largest coefficient.
  real(wp), parameter :: largest = 1.0e300_wp
  character(len=*), parameter :: too_large = 'its coefficients must be at most 1e300'
  character(len=*), parameter :: letters = 'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ_'

  !> A sum of monomials: coefficients, and powers, shape (n, size(coefficients)).
  type :: terms_type
    real(wp), allocatable :: coefficients(:)
    integer, allocatable :: powers(:, :)
  end type terms_type

  type, extends(text_cursor) :: cursor_type
    !> Steps left.
    integer :: effort = 0
  end type cursor_type

contains

  !> Expand a text in coordinates of these names; terms that cancel are left out. If
  !! something is wrong, `fault` says what, else it is empty.
  subroutine expand(text, names, terms, fault, effort)
    character(len=*), intent(in) :: text, names(:)
    type(terms_type), intent(out) :: terms
    character(len=:), allocatable, intent(out) :: fault
    !> Comparisons of monomials that may be made; what is left of them.
    integer, intent(inout) :: effort
    type(cursor_type) :: cursor

    call cursor%begin(text)
    cursor%effort = effort
    call read_sum(cursor, names, terms)
    if (cursor%fault == '' .and. cursor%peek() /= ' ') call cursor%expect('+ - * / ^ or the end')
    fault = cursor%fault
    effort = cursor%effort
  end subroutine expand

  recursive subroutine read_sum(cursor, names, total)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: names(:)
    type(terms_type), intent(out) :: total
    type(terms_type) :: next
    real(wp) :: sign_of
    integer :: i, used

    call read_term(cursor, names, total)
    used = size(total%coefficients)
    do while (cursor%fault == '' .and. scan(cursor%peek(), '+-') > 0)
      sign_of = merge(1.0_wp, -1.0_wp, cursor%peek() == '+')
      cursor%at = cursor%at + 1
      call read_term(cursor, names, next)
      do i = 1, size(next%coefficients)
        call add(cursor, total, used, sign_of*next%coefficients(i), next%powers(:, i))
      end do
    end do
    call drop_zeros(total)
  end subroutine read_sum

  recursive subroutine read_term(cursor, names, total)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: names(:)
    type(terms_type), intent(out) :: total
    type(terms_type) :: next
    character :: sign_of

    call read_factor(cursor, names, total)
    do while (cursor%fault == '' .and. scan(cursor%peek(), '*/') > 0)
      sign_of = cursor%peek()
      cursor%at = cursor%at + 1
      call read_factor(cursor, names, next)
      if (cursor%fault /= '') return
      if (sign_of == '*') then
        call multiply(cursor, total, next)
      else if (size(next%coefficients) /= 1 .or. any(next%powers /= 0)) then
        cursor%fault = 'it may be divided only by numbers other than 0'
      else if (any(abs(total%coefficients) &
                   > largest*min(1.0_wp, abs(next%coefficients(1))))) then
        cursor%fault = too_large
      else
        total%coefficients = total%coefficients/next%coefficients(1)
      end if
    end do
  end subroutine read_term

  recursive subroutine read_factor(cursor, names, total)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: names(:)
    type(terms_type), intent(out) :: total
    type(terms_type) :: base
    real(wp) :: sign_of
    integer :: k, n

    sign_of = 1.0_wp
    do while (scan(cursor%peek(), '+-') > 0)
      if (cursor%peek() == '-') sign_of = -sign_of
      cursor%at = cursor%at + 1
    end do
    call read_primary(cursor, names, base)
    n = 1
    if (cursor%fault == '' .and. (cursor%peek() == '^' .or. cursor%next_two() == '**')) then
      call read_power(cursor, names, n)
      if (n > max_degree .and. any(base%powers > 0) .and. cursor%fault == '') then
        cursor%fault = 'powers must be at most '//show(max_degree)
      end if
    end if
    call constant(size(names), sign_of, total)
    if (cursor%fault /= '') return
    do k = 1, n
      call multiply(cursor, total, base)
      if (cursor%fault /= '') return
    end do
  end subroutine read_factor

  !> The power behind ^ or **, a whole number, which may itself have a power.
  recursive subroutine read_power(cursor, names, n)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: names(:)
    integer, intent(out) :: n
    type(terms_type) :: exponent
    real(wp) :: value
    integer :: above

    n = 1
    cursor%at = cursor%at + merge(1, 2, cursor%peek() == '^')
    if (scan(cursor%peek(), digits//'(') == 0) call cursor%expect('a whole power')
    if (cursor%fault == '') call read_primary(cursor, names, exponent)
    if (cursor%fault /= '') return
    value = sum(exponent%coefficients)
    if (any(exponent%powers > 0) .or. value < 0.0_wp .or. value > max_power &
        .or. abs(value - anint(value)) > 0.0_wp) then
      cursor%fault = 'powers must be whole numbers, 0 to '//show(max_degree)
      return
    end if
    n = nint(value)
    if (cursor%peek() /= '^' .and. cursor%next_two() /= '**') return
    call read_power(cursor, names, above)
    if (real(n, wp)**above > max_power) cursor%fault = 'powers must be at most '//show(max_degree)
    if (cursor%fault == '') n = n**above
  end subroutine read_power

  recursive subroutine read_primary(cursor, names, total)
    type(cursor_type), intent(inout) :: cursor
    character(len=*), intent(in) :: names(:)
    type(terms_type), intent(out) :: total
    character :: c
    integer :: i, first

    call constant(size(names), 0.0_wp, total)
    c = cursor%peek()
    first = cursor%at
    if (c == '(') then
      cursor%depth = cursor%depth + 1
      if (cursor%depth > max_depth) then
        cursor%fault = 'parentheses must not be deeper than '//show(max_depth)
        return
      end if
      cursor%at = cursor%at + 1
      call read_sum(cursor, names, total)
      if (cursor%fault /= '') return
      if (cursor%peek() /= ')') call cursor%expect(')')
      if (cursor%fault /= '') return
      cursor%at = cursor%at + 1
      cursor%depth = cursor%depth - 1
    else if (scan(c, digits//'.') > 0) then
      call read_number(cursor, total)
    else if (scan(c, letters) > 0) then
      cursor%at = first + verify(cursor%text(first:), letters//digits) - 1
      associate (name => cursor%text(first:cursor%at - 1))
        do i = 1, size(names)
          if (names(i) == name) exit
        end do
        if (i > size(names)) then
          cursor%fault = "'"//clipped(name)//"' is not a coordinate"
          if (size(names) == 1) cursor%fault = cursor%fault//' (only '//trim(names(1))//' is)'
          cursor%fault = cursor%fault//'; a parameter is written as its number'
        else
          total%coefficients = [1.0_wp]
          total%powers = reshape(merge(1, 0, [(first, first=1, size(names))] == i), &
                                 [size(names), 1])
        end if
      end associate
    else
      call cursor%expect('a number, a coordinate or (')
    end if
  end subroutine read_primary

  !> A number such as 2, .5, 1e-3.
  subroutine read_number(cursor, total)
    type(cursor_type), intent(inout) :: cursor
    type(terms_type), intent(inout) :: total

    total%coefficients = [0.0_wp]
    total%powers = reshape(spread(0, 1, size(total%powers, 1)), [size(total%powers, 1), 1])
    call cursor%read_digits('edED', total%coefficients(1))
    call drop_zeros(total)
  end subroutine read_number

  !> A number; 0 has no terms.
  pure subroutine constant(n, value, terms)
    integer, intent(in) :: n
    real(wp), intent(in) :: value
    type(terms_type), intent(out) :: terms
    integer :: m
    m = merge(1, 0, abs(value) > 0.0_wp)
    allocate (terms%coefficients(m), source=value)
    allocate (terms%powers(n, m), source=0)
  end subroutine constant

  !> Add one monomial to those of the same powers, of which the first are used.
  subroutine add(cursor, total, used, coefficient, powers)
    type(cursor_type), intent(inout) :: cursor
    type(terms_type), intent(inout) :: total
    integer, intent(inout) :: used
    real(wp), intent(in) :: coefficient
    integer, intent(in) :: powers(:)
    integer :: i

    cursor%effort = cursor%effort - used - 1
    if (cursor%effort < 0) then
      if (cursor%fault == '') cursor%fault = 'it takes too long to expand: write it as fewer or ' &
                                             //'smaller products'
      return
    end if
    do i = 1, used
      if (all(total%powers(:, i) == powers)) then
        total%coefficients(i) = total%coefficients(i) + coefficient
        return
      end if
    end do
    if (used >= max_terms) then
      if (cursor%fault == '') cursor%fault = 'it must expand to at most '//show(max_terms) &
                                             //' monomials'
      return
    end if
    used = used + 1
    if (used > size(total%coefficients)) call resize(total, 2*used)
    total%powers(:, used) = powers
    total%coefficients(used) = coefficient
  end subroutine add

  !> Keep the first terms, or append terms of 0.
  subroutine resize(terms, n)
    type(terms_type), intent(inout) :: terms
    integer, intent(in) :: n
    type(terms_type) :: found
    integer :: m

    m = min(n, size(terms%coefficients))
    allocate (found%coefficients(n), source=0.0_wp)
    allocate (found%powers(size(terms%powers, 1), n), source=0)
    found%coefficients(:m) = terms%coefficients(:m)
    found%powers(:, :m) = terms%powers(:, :m)
    terms = found
  end subroutine resize

  subroutine multiply(cursor, total, by)
    type(cursor_type), intent(inout) :: cursor
    type(terms_type), intent(inout) :: total
    type(terms_type), intent(in) :: by
    type(terms_type) :: product
    integer :: i, j, used

    used = 0
    call constant(size(total%powers, 1), 0.0_wp, product)
    do i = 1, size(total%coefficients)
      do j = 1, size(by%coefficients)
        if (sum(total%powers(:, i) + by%powers(:, j)) > max_degree) then
          cursor%fault = 'its degree must be at most '//show(max_degree)
        else if (abs(total%coefficients(i)) > largest/max(1.0_wp, abs(by%coefficients(j))) &
                 .or. abs(by%coefficients(j)) > largest) then
          cursor%fault = too_large
        else
          call add(cursor, product, used, total%coefficients(i)*by%coefficients(j), &
                   total%powers(:, i) + by%powers(:, j))
        end if
        if (cursor%fault /= '') return
      end do
    end do
    call drop_zeros(product)
    total = product
  end subroutine multiply

  subroutine drop_zeros(terms)
    type(terms_type), intent(inout) :: terms
    integer, allocatable :: kept(:)
    integer :: i
    kept = pack([(i, i=1, size(terms%coefficients))], abs(terms%coefficients) > 0.0_wp)
    if (size(kept) == size(terms%coefficients)) return
    terms%powers = terms%powers(:, kept)
    terms%coefficients = terms%coefficients(kept)
  end subroutine drop_zeros

end module viscovib_polynomial_text
