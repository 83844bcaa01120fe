! Optimize: -O1
!> A real function of the circular frequency nu, given as a text, such as 0.002*nu^2: the amplitude
!! of a load that depends on the frequency.
module viscovib_frequency_law
  use viscovib_kinds, only: wp
  use viscovib_law_bounds, only: bounds_of, inside, range_type
  use viscovib_law_functions, only: add, f_where, leaves, multiply, negate, of_one, of_two, &
    operands, put_argument, put_number, square, subtract, wall, within
  use viscovib_law_program, only: law_program
  use viscovib_law_text, only: compile_law
  use viscovib_status, only: clipped, fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: frequency_law, new_frequency_law

  !> A range of frequencies is halved until the law is finite in each part, at most this many times.
  integer, parameter :: most_halvings = 40
  !> Largest depth of the stack of a compiled law.
  integer, parameter :: deepest = 64
  !> Largest number of parts that are examined.
  integer, parameter :: most_parts = 5000

  type :: frequency_law
    character(len=:), allocatable :: text
    type(law_program) :: program
  contains
    procedure :: at
    procedure :: find
    procedure :: check_at
    procedure :: check_between
  end type frequency_law

contains

  !> Compile a text. `fault` describes an error, and is empty otherwise.
  subroutine new_frequency_law(law, text, fault)
    type(frequency_law), intent(out) :: law
    character(len=*), intent(in) :: text
    character(len=:), allocatable, intent(out) :: fault
    character(len=1) :: no_names(0)
    real(wp) :: no_values(0)
    integer :: parity, degree

    law%text = text
    call compile_law(text, ['nu'], no_names, no_values, law%program, parity, degree, fault)
  end subroutine new_frequency_law

  !> The value at a frequency.
  pure real(wp) function at(self, nu)
    class(frequency_law), intent(in) :: self
    real(wp), intent(in) :: nu
    real(wp) :: slope
    call self%find(nu, at, slope)
  end function at

  !> The value at a frequency and its derivative by the frequency, as `law_program%differentiate`
  !! computes them for many samples; without arrays for the stack it takes a tenth of the time.
  pure subroutine find(self, nu, value, slope)
    class(frequency_law), intent(in) :: self
    real(wp), intent(in) :: nu
    real(wp), intent(out) :: value, slope
    real(wp) :: x(deepest), dx(deepest), by(2)
    logical :: outside(deepest)
    integer :: chosen, i, top

    top = 0
    do i = 1, size(self%program%code)
      associate (code => self%program%code(i), number => self%program%number(i))
        top = top - operands(code) + 1
        select case (code)
        case (put_number)
          x(top) = number
          dx(top) = 0.0_wp
          outside(top) = .false.
        case (put_argument)
          x(top) = nu
          dx(top) = 1.0_wp
          outside(top) = .false.
        case (negate)
          x(top) = -x(top)
          dx(top) = -dx(top)
        case (square)
          dx(top) = within(2.0_wp*x(top)*dx(top))
          x(top) = min(x(top)**2, wall)
        case (f_where)
          chosen = top + merge(1, 2, abs(x(top)) > 0.0_wp)
          x(top) = x(chosen)
          dx(top) = dx(chosen)
          outside(top) = outside(top) .or. outside(chosen)
        case default
          outside(top) = outside(top) .or. leaves(code, number, x(top))
          if (operands(code) == 1) then
            call of_one(code, number, x(top), value, by(1))
            dx(top) = within(by(1)*dx(top))
          else
            call combine(code, x(top), x(top + 1), value, by)
            dx(top) = within(by(1)*dx(top)) + within(by(2)*dx(top + 1))
            outside(top) = outside(top) .or. outside(top + 1)
          end if
          x(top) = value
        end select
      end associate
    end do
    value = merge(wall, x(1), outside(1))
    slope = merge(0.0_wp, dx(1), outside(1))
  end subroutine find

  !> A function of two numbers and its derivatives.
  pure subroutine combine(code, x, y, value, by)
    integer, intent(in) :: code
    real(wp), intent(in) :: x, y
    real(wp), intent(out) :: value, by(2)
    select case (code)
    case (add)
      value = x + y
      by = [1.0_wp, 1.0_wp]
    case (subtract)
      value = x - y
      by = [1.0_wp, -1.0_wp]
    case (multiply)
      value = within(x*y)
      by = [y, x]
    case default
      call of_two(code, x, y, value, by)
    end select
  end subroutine combine

  !> Fail if the law has no finite value at a frequency.
  subroutine check_at(self, nu, status)
    class(frequency_law), intent(in) :: self
    real(wp), intent(in) :: nu
    type(status_type), intent(out) :: status
    call set_ok(status)
    if (.not. abs(self%at(nu)) < wall) call fail_at(self, nu, status)
  end subroutine check_at

  !> Fail if the law has a frequency without a finite value, such as a pole, within a range. The
  !! range is halved where interval arithmetic cannot exclude such a frequency.
  subroutine check_between(self, low, high, status)
    class(frequency_law), intent(in) :: self
    real(wp), intent(in) :: low, high
    type(status_type), intent(out) :: status
    !> The ends of the parts still to be examined, the nearest part last.
    real(wp) :: ends(most_halvings + 2), first
    integer :: n, top

    call self%check_at(low, status)
    if (.not. status%failed()) call self%check_at(high, status)
    first = low
    ends(1) = high
    top = 1
    do n = 1, most_parts
      if (status%failed() .or. top == 0) return
      if (is_finite(self, first, ends(top), top > most_halvings)) then
        first = ends(top)
        top = top - 1
      else if (top > most_halvings) then
        call fail_at(self, first, status)
      else
        ends(top + 1) = 0.5_wp*(first + ends(top))
        top = top + 1
        call self%check_at(ends(top), status)
      end if
    end do
  end subroutine check_between

  !> True if the law is finite within a range; with `narrow`, if no pole is in it and its ends,
  !! which are computed already, are finite.
  pure logical function is_finite(self, low, high, narrow)
    class(frequency_law), intent(in) :: self
    real(wp), intent(in) :: low, high
    logical, intent(in) :: narrow
    type(range_type) :: bounds

    call bounds_of(self%program, [range_type(value=[low, high], rate=1.0_wp)], bounds)
    is_finite = all(abs(bounds%value) < wall) .and. (bounds%outside == inside .or. narrow)
  end function is_finite

  subroutine fail_at(self, nu, status)
    class(frequency_law), intent(in) :: self
    real(wp), intent(in) :: nu
    type(status_type), intent(out) :: status
    call fail(status, status_input_error, 'load', "load: '"//clipped(self%text)//"' has no " &
              //'finite value at nu = '//show(nu)//': must be finite at all frequencies')
  end subroutine fail_at

end module viscovib_frequency_law
