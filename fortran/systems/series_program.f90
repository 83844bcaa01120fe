!> Compiles force laws to programs for power series in time (`viscovib_series_terms`). Common
!! subexpressions are computed once. Numbers may differ between vector lanes.
module viscovib_series_program
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: add, divide, f_acos, f_acosh, f_asin, f_asinh, f_atan, &
    f_atanh, f_cos, f_cosh, f_exp, f_log, f_sin, f_sinh, f_sqrt, f_tan, f_tanh, known_power, &
    multiply, negate, of_one, of_two, operands, put_argument, put_number, square, subtract, wall
  use viscovib_law_program, only: law_program
  use viscovib_series_terms, only: add_up, bend, grow, over, product_of, quotient, root, scale_up, &
    series_step, shift, square_of, stretch, take_number, take_off, turn
  use viscovib_wide_series, only: n_wide
  implicit none
  private

  public :: series_program

  !> Largest power computed by products; largest number of terms when sums are expanded.
  integer, parameter :: highest_power = 32, most_parts = 64
  real(wp), parameter :: half_pi = 1.57079632679489661923_wp, no_number(n_wide) = 0.0_wp

  type :: series_program
    integer :: n_registers = 0
    type(series_step), allocatable :: steps(:)
  contains
    procedure :: add_law
    procedure :: add_monomial
    procedure :: take_apart
    procedure :: leave_out_unused
    procedure, private :: maker_of
    procedure, private :: register_of
    procedure, private :: apply
    procedure, private :: combine
    procedure, private :: raised
    procedure, private :: inverse_function
    procedure, private :: multiple
  end type series_program

  !> Value on the stack of a law: a register, or (register 0) a constant for each vector lane.
  type :: item_type
    integer :: register = 0
    real(wp) :: number(n_wide) = 0.0_wp
  end type item_type

contains

  !> Compile a law of coordinates and velocities, which are registers 1 ... n and n + 1 ... 2 n.
  subroutine add_law(self, law, numbers, by_q, by_v, result, known)
    class(series_program), intent(inout) :: self
    type(law_program), intent(in) :: law
    !> Constants of its instructions, shape (n_wide, n_code).
    real(wp), intent(in) :: numbers(:, :)
    !> Matrices from coordinates and velocities to arguments, shape (n_arguments, n_dof).
    real(wp), intent(in) :: by_q(:, :), by_v(:, :)
    !> Register of the law's value.
    integer, intent(out) :: result
    !> True if all its functions are supported.
    logical, intent(out) :: known
    type(item_type) :: stack(law%depth + 3), arguments(size(by_q, 1))
    integer :: i, k, top

    do i = 1, size(arguments)
      do k = 1, 2*size(by_q, 2)
        call add_argument(k, merge(by_q(i, min(k, size(by_q, 2))), &
                                   by_v(i, max(k - size(by_q, 2), 1)), k <= size(by_q, 2)))
      end do
    end do
    known = .true.
    top = 0
    do i = 1, size(law%code)
      top = top - operands(law%code(i)) + 1
      select case (law%code(i))
      case (put_number)
        stack(top) = item_type(0, numbers(:, i))
      case (put_argument)
        stack(top) = arguments(nint(law%number(i)))
      case default
        call self%apply(law%code(i), law%number(i), stack(top:), known)
        if (.not. known) return
      end select
    end do
    result = self%register_of(stack(1))

  contains

    !> Add a multiple of a coordinate or a velocity.
    subroutine add_argument(register, factor)
      integer, intent(in) :: register
      real(wp), intent(in) :: factor
      type(item_type) :: term
      if (.not. abs(factor) > 0.0_wp) return
      term = self%multiple(item_type(register), in_all(factor))
      if (arguments(i)%register == 0) then
        arguments(i) = term
      else
        arguments(i) = self%combine(add_up, arguments(i), term)
      end if
    end subroutine add_argument

  end subroutine add_law

  !> Compile a product of powers of coordinates.
  subroutine add_monomial(self, dof, power, result)
    class(series_program), intent(inout) :: self
    integer, intent(in) :: dof(:), power(:)
    integer, intent(out) :: result
    type(item_type) :: value
    integer :: j

    value = item_type(0, in_all(1.0_wp))
    do j = 1, size(dof)
      value = self%combine(product_of, value, self%raised(item_type(dof(j)), power(j)))
    end do
    result = self%register_of(value)
  end subroutine add_monomial

  !> Expand registers that are sums and multiples as far as possible. Equal terms are not merged, so
  !! that the operations are the same in all vector lanes and each lane is independent of the
  !! others' numbers.
  subroutine take_apart(self, sums, registers, places, factors)
    class(series_program), intent(in) :: self
    !> Also expand sums; otherwise only multiples.
    logical, intent(in) :: sums
    !> On return the terms of the sums. `places`: index of the given register to which each term
    !! belongs; `factors`: its factor in every vector lane.
    integer, allocatable, intent(inout) :: registers(:)
    integer, allocatable, intent(out) :: places(:)
    real(wp), allocatable, intent(out) :: factors(:, :)
    real(wp) :: one(n_wide)
    integer :: i, j

    places = [(j, j=1, size(registers))]
    allocate (factors(n_wide, size(registers)), source=1.0_wp)
    one = 1.0_wp
    j = 1
    do while (j <= size(registers))
      i = self%maker_of(registers(j))
      if (i == 0 .or. size(registers) > most_parts) then
        j = j + 1
        cycle
      end if
      associate (step => self%steps(i))
        select case (step%code)
        case (scale_up)
          registers(j) = step%a
          factors(:, j) = factors(:, j)*step%number
        case (add_up, take_off)
          if (.not. sums) then
            j = j + 1
            cycle
          end if
          if (step%code == take_off) one = -1.0_wp
          registers = [registers(:j - 1), step%a, step%b, registers(j + 1:)]
          places = [places(:j), places(j), places(j + 1:)]
          factors = reshape([factors(:, :j), one*factors(:, j), factors(:, j + 1:)], &
                            [n_wide, size(registers)])
          one = 1.0_wp
        case default
          j = j + 1
        end select
      end associate
    end do
  end subroutine take_apart

  !> Index of the step that computes a register; 0: a coordinate, velocity or auxiliary register.
  pure integer function maker_of(self, register)
    class(series_program), intent(in) :: self
    integer, intent(in) :: register
    do maker_of = size(self%steps), 1, -1
      if (self%steps(maker_of)%to == register) return
    end do
  end function maker_of

  !> Remove steps whose values are not needed.
  subroutine leave_out_unused(self, registers)
    class(series_program), intent(inout) :: self
    !> Registers that are needed; larger numbers belong to other programs.
    integer, intent(in) :: registers(:)
    logical :: wanted(0:self%n_registers), used(size(self%steps))
    integer :: i, next

    wanted = .false.
    wanted(pack(registers, registers <= self%n_registers)) = .true.
    next = self%n_registers + 1
    do i = size(self%steps), 1, -1
      associate (step => self%steps(i))
        used(i) = any(wanted(step%to:next - 1))
        if (used(i)) wanted([step%a, step%b]) = .true.
        next = step%to
      end associate
    end do
    self%steps = pack(self%steps, used)
  end subroutine leave_out_unused

  !> Add a step, or find an identical one, and return its register.
  type(item_type) function put(self, code, a, b, number) result(item)
    class(series_program), intent(inout) :: self
    integer, intent(in) :: code, a, b
    real(wp), intent(in) :: number(n_wide)
    integer :: i

    do i = 1, size(self%steps)
      associate (step => self%steps(i))
        item%register = step%to
        if (step%code == code .and. step%a == a .and. step%b == b &
            .and. all(abs(step%number - number) <= 0.0_wp)) return
      end associate
    end do
    item%register = self%n_registers + 1
    self%steps = [self%steps, series_step(code, item%register, a, b, number)]
    ! Additional registers: both functions and the operand's derivative, or parts of equations.
    select case (code)
    case (turn, stretch, bend)
      self%n_registers = self%n_registers + 3
    case (grow, over)
      self%n_registers = self%n_registers + 2
    case default
      self%n_registers = self%n_registers + 1
    end select
  end function put

  !> Register of a value; constants get one.
  integer function register_of(self, item)
    class(series_program), intent(inout) :: self
    type(item_type), intent(in) :: item
    type(item_type) :: number
    register_of = item%register
    if (register_of > 0) return
    number = put(self, take_number, 0, 0, item%number)
    register_of = number%register
  end function register_of

  !> Multiply a value by a number.
  type(item_type) function multiple(self, item, factor)
    class(series_program), intent(inout) :: self
    type(item_type), intent(in) :: item
    real(wp), intent(in) :: factor(n_wide)
    multiple = item
    if (item%register == 0) then
      multiple%number = factor*item%number
    else if (any(abs(factor - 1.0_wp) > 0.0_wp)) then
      multiple = put(self, scale_up, item%register, 0, factor)
    end if
  end function multiple

  !> Sum, difference or product of two values.
  type(item_type) function combine(self, code, x, y) result(item)
    class(series_program), intent(inout) :: self
    integer, intent(in) :: code
    type(item_type), intent(in) :: x, y

    if (code == take_off) then
      if (x%register > 0 .and. y%register > 0) then
        item = put(self, take_off, x%register, y%register, no_number)
      else
        item = self%combine(add_up, x, self%multiple(y, in_all(-1.0_wp)))
      end if
    else if (x%register > 0 .and. y%register > 0) then
      if (code == product_of .and. x%register == y%register) then
        item = put(self, square_of, x%register, 0, no_number)
      else
        item = put(self, code, x%register, y%register, no_number)
      end if
    else if (code == product_of) then
      if (x%register == 0) item = self%multiple(y, x%number)
      if (x%register > 0) item = self%multiple(x, y%number)
    else if (x%register + y%register == 0) then
      item%number = x%number + y%number
    else
      item = put(self, shift, x%register + y%register, 0, &
                 merge(x%number, y%number, x%register == 0))
    end if
  end function combine

  !> x^n by products.
  recursive type(item_type) function raised(self, x, n) result(item)
    class(series_program), intent(inout) :: self
    type(item_type), intent(in) :: x
    integer, intent(in) :: n

    item = x
    if (n == 1) return
    item = self%raised(x, n/2)
    item = self%combine(product_of, item, item)
    if (mod(n, 2) == 1) item = self%combine(product_of, item, x)
  end function raised

  !> Apply an instruction of a law. Its operands are the first entries of the stack; the value
  !! replaces the first.
  subroutine apply(self, code, number, x, known)
    class(series_program), intent(inout) :: self
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    type(item_type), intent(inout) :: x(:)
    logical, intent(inout) :: known
    integer :: n

    select case (code)
    case (add)
      x(1) = self%combine(add_up, x(1), x(2))
    case (subtract)
      x(1) = self%combine(take_off, x(1), x(2))
    case (multiply)
      x(1) = self%combine(product_of, x(1), x(2))
    case (square)
      x(1) = self%combine(product_of, x(1), x(1))
    case (negate)
      x(1) = self%multiple(x(1), in_all(-1.0_wp))
    case default
      if (all(x(:operands(code))%register == 0)) then
        call of_numbers(code, number, x, known)
        return
      end if
      n = 0
      if (code == known_power) n = nint(2.0_wp*max(min(number, 1.0e3_wp), -1.0e3_wp))
      if (code == divide) then
        if (x(2)%register == 0) then
          known = all(abs(x(2)%number) > 1.0_wp/wall)
          if (known) x(1) = self%multiple(x(1), 1.0_wp/x(2)%number)
        else
          x(1) = put(self, quotient, self%register_of(x(1)), x(2)%register, no_number)
        end if
      else if (code == known_power) then
        known = abs(2.0_wp*number - n) <= 0.0_wp .and. n /= 0 .and. abs(n) <= 2*highest_power
        if (known) x(1) = half_power(self, x(1), n)
      else
        call function_of(self, code, x(1), known)
      end if
    end select
  end subroutine apply

  !> x^(n/2).
  type(item_type) function half_power(self, x, n) result(item)
    class(series_program), intent(inout) :: self
    type(item_type), intent(in) :: x
    integer, intent(in) :: n

    item = x
    if (mod(n, 2) /= 0) then
      item = self%raised(put(self, root, x%register, 0, no_number), abs(n))
    else
      item = self%raised(x, abs(n)/2)
    end if
    if (n < 0) then
      item = put(self, quotient, self%register_of(item_type(0, in_all(1.0_wp))), item%register, &
                 no_number)
    end if
  end function half_power

  !> Apply a function of one value.
  subroutine function_of(self, code, x, known)
    class(series_program), intent(inout) :: self
    integer, intent(in) :: code
    type(item_type), intent(inout) :: x
    logical, intent(inout) :: known

    select case (code)
    case (f_sqrt)
      x = put(self, root, x%register, 0, no_number)
    case (f_exp)
      x = put(self, grow, x%register, 0, no_number)
    case (f_sin, f_cos)
      x = put(self, turn, x%register, 0, no_number)
      if (code == f_cos) x%register = x%register + 1
    case (f_sinh, f_cosh)
      x = put(self, stretch, x%register, 0, no_number)
      if (code == f_cosh) x%register = x%register + 1
    case (f_tanh, f_tan)
      x = put(self, bend, x%register, 0, in_all(merge(-1.0_wp, 1.0_wp, code == f_tanh)))
    case (f_log)
      x = put(self, over, x%register, x%register, in_all(real(code, wp)))
    case (f_asin, f_acos, f_atan, f_asinh, f_acosh, f_atanh)
      x = self%inverse_function(code, x)
    case default
      known = .false.
    end select
  end subroutine function_of

  !> Functions whose derivative is the reciprocal of a power of 1 +- x^2.
  type(item_type) function inverse_function(self, code, x) result(item)
    class(series_program), intent(inout) :: self
    integer, intent(in) :: code
    type(item_type), intent(in) :: x

    item = self%combine(product_of, x, x)
    select case (code)
    case (f_asin, f_acos, f_atanh)
      item = self%combine(take_off, item_type(0, in_all(1.0_wp)), item)
    case default
      item = self%combine(add_up, item, &
                          item_type(0, in_all(merge(-1.0_wp, 1.0_wp, code == f_acosh))))
    end select
    if (code /= f_atan .and. code /= f_atanh) then
      item = put(self, root, item%register, 0, no_number)
    end if
    item = put(self, over, x%register, item%register, &
               in_all(real(merge(f_asin, code, code == f_acos), wp)))
    if (code == f_acos) then
      item = self%combine(take_off, item_type(0, in_all(half_pi)), item)
    end if
  end function inverse_function

  !> Evaluate a function of constants.
  subroutine of_numbers(code, number, x, known)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    type(item_type), intent(inout) :: x(:)
    logical, intent(inout) :: known
    real(wp) :: value, by(2)
    integer :: l
    known = operands(code) <= 2
    if (.not. known) return
    do l = 1, n_wide
      if (operands(code) == 2) then
        call of_two(code, x(1)%number(l), x(2)%number(l), value, by)
      else
        call of_one(code, number, x(1)%number(l), value, by(1))
      end if
      x(1)%number(l) = value
    end do
  end subroutine of_numbers

  !> A number repeated for all vector lanes.
  pure function in_all(number) result(numbers)
    real(wp), intent(in) :: number
    real(wp) :: numbers(n_wide)
    numbers = number
  end function in_all

end module viscovib_series_program
