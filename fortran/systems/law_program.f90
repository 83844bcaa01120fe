! Optimize: -O3
!> A force law as a stack program for arrays of samples, with exact derivatives.
!!
!! Instructions push numbers and arguments on the stack; functions replace their operands by their
!! value. Each value carries its derivatives by all arguments (forward differentiation by the chain
!! rule). Outside of a function's domain the whole law is undefined and has the value `wall`,
!! regardless of later functions.
module viscovib_law_program
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_functions, only: add, bounded, branches, called, degree_of, divide, f_abs, &
    f_atleast, f_atmost, f_cos, f_exp, f_heaviside, f_less, f_log, f_max, f_min, f_more, f_pow, &
    f_sign, f_sin, f_sqrt, f_tanh, f_where, first_function, first_of_two, functions, held_power, &
    known_power, leaves, most_called, multiply, negate, number_for_one, number_for_two, of_one, &
    of_two, operands, parity_of, power, put_argument, put_number, second_of_two, square, &
    steepest, subtract, wall, within
  use viscovib_law_outside, only: call_outside
  use viscovib_vector_math, only: exponential_lanes, largest_angle, logarithm_lanes, &
    sine_cosine_lanes, tangent_lanes
  implicit none
  private

  public :: law_program, mark_outside
  public :: add, bounded, branches, degree_of, divide, f_abs, f_atleast, f_atmost, f_cos, f_exp, &
            f_heaviside, f_less, f_log, f_max, f_min, f_more, f_pow, f_sign, f_sin, f_sqrt, &
            f_tanh, f_where, first_function, first_of_two, functions, held_power, known_power, &
            leaves, multiply, negate, number_for_one, number_for_two, of_one, of_two, operands, &
            parity_of, power, put_argument, put_number, second_of_two, square, steepest, &
            subtract, wall

  type :: law_program
    integer :: n_arguments = 0
    !> Maximum depth of the stack.
    integer :: depth = 0
    !> Instructions, and a number for each (for an argument, its index).
    integer, allocatable :: code(:)
    real(wp), allocatable :: number(:)
    !> Numbers for each vector lane if parameters differ, shape (n_lanes, n_code). The law can then
    !! only be evaluated for lanes. Not allocated: equal in all lanes.
    real(wp), allocatable :: of_lanes(:, :)
  contains
    procedure :: evaluate
    procedure :: differentiate
    procedure :: measure
    procedure :: n_surfaces
  end type law_program

contains

  !> Number of switching surfaces of the law.
  pure integer function n_surfaces(self)
    class(law_program), intent(in) :: self
    n_surfaces = count(branches(self%code))
  end function n_surfaces

  !> Compute the maximum depth of the stack.
  subroutine measure(self)
    class(law_program), intent(inout) :: self
    integer :: i, held
    held = 0
    self%depth = 1
    do i = 1, size(self%code)
      held = held - operands(self%code(i)) + 1
      self%depth = max(self%depth, held)
    end do
  end subroutine measure

  !> Values of the law at samples of its arguments.
  pure subroutine evaluate(self, arguments, value)
    class(law_program), intent(in) :: self
    !> Shape (n_samples, n_arguments).
    real(wp), intent(in) :: arguments(:, :)
    !> Shape (n_samples).
    real(wp), intent(out) :: value(:)
    real(wp) :: nothing(size(value), 0)
    call run(self, arguments, value, nothing)
  end subroutine evaluate

  !> Values of the law and its derivatives by all arguments.
  pure subroutine differentiate(self, arguments, value, slopes)
    class(law_program), intent(in) :: self
    real(wp), intent(in) :: arguments(:, :)
    !> Shapes (n_samples) and (n_samples, n_arguments).
    real(wp), intent(out) :: value(:), slopes(:, :)
    call run(self, arguments, value, slopes)
  end subroutine differentiate

  pure subroutine run(self, arguments, value, slopes)
    class(law_program), intent(in) :: self
    real(wp), intent(in) :: arguments(:, :)
    real(wp), intent(out) :: value(:), slopes(:, :)
    real(wp) :: x(size(value), self%depth + 2)
    real(wp) :: dx(size(value), size(slopes, 2), self%depth + 2), work(size(value), 4)
    integer :: i, k, top
    !> True once a sample has left the domain of a function; `outside` marks these samples.
    logical :: left, outside(size(value), self%depth + 2)

    top = 0
    left = .false.
    do i = 1, size(self%code)
      top = top - operands(self%code(i)) + 1
      if (bounded(self%code(i)) .and. .not. left) then
        left = any(leaves(self%code(i), self%number(i), x(:, top)))
        if (left) outside = .false.
      end if
      if (left) call mark_outside(self%code(i), self%number(i), size(value), x(:, top:), &
                                  outside(:, top:))
      call step(self%code(i), self%number(i), arguments, size(value), size(slopes, 2), x(:, top:), &
                dx(:, :, top:), work)
      if (self%code(i) == put_number .and. allocated(self%of_lanes)) x(:, top) = self%of_lanes(:, i)
    end do
    value = x(:, 1)
    slopes = dx(:, :, 1)
    if (.not. left) return
    do k = 1, size(value)
      if (.not. outside(k, 1)) cycle
      value(k) = wall
      slopes(k, :) = 0.0_wp
    end do
  end subroutine run

  !> Mark samples outside of a function's domain before an instruction. Branches that `where` or a
  !! fixed side does not select are ignored.
  pure subroutine mark_outside(code, number, n, x, outside)
    integer, intent(in) :: code, n
    real(wp), intent(in) :: number
    !> Operands of the instruction.
    real(wp), intent(in) :: x(n, *)
    !> Marks of the operands. The first becomes the mark of the value.
    logical, intent(inout) :: outside(n, *)
    integer :: j, k

    select case (code)
    case (put_number, put_argument, number_for_one, number_for_two)
      outside(:, 1) = .false.
    case (first_of_two)
      return
    case (second_of_two)
      outside(:, 1) = outside(:, 2)
    case (f_where)
      do k = 1, n
        outside(k, 1) = outside(k, 1) .or. outside(k, merge(2, 3, abs(x(k, 1)) > 0.0_wp))
      end do
    case default
      if (bounded(code)) outside(:, 1) = outside(:, 1) .or. leaves(code, number, x(:, 1))
      do j = 2, operands(code)
        outside(:, 1) = outside(:, 1) .or. outside(:, j)
      end do
    end select
  end subroutine mark_outside

  !> Execute one instruction. Its operands start in the first column of x, which receives the value.
  pure subroutine step(code, number, arguments, n, m, x, dx, work)
    integer, intent(in) :: code, n, m
    real(wp), intent(in) :: number, arguments(:, :)
    real(wp), intent(inout) :: x(n, *), dx(n, m, *), work(n, 4)
    logical :: two
    integer :: a, k

    select case (code)
    case (put_number)
      x(:, 1) = number
      dx(:, :, 1) = 0.0_wp
    case (put_argument)
      x(:, 1) = arguments(:, nint(number))
      dx(:, :, 1) = 0.0_wp
      if (m > 0) dx(:, nint(number), 1) = 1.0_wp
    case (add)
      x(:, 1) = x(:, 1) + x(:, 2)
      dx(:, :, 1) = dx(:, :, 1) + dx(:, :, 2)
    case (subtract)
      x(:, 1) = x(:, 1) - x(:, 2)
      dx(:, :, 1) = dx(:, :, 1) - dx(:, :, 2)
    case (negate)
      x(:, 1) = -x(:, 1)
      dx(:, :, 1) = -dx(:, :, 1)
    case (number_for_one, number_for_two)
      x(:, 1) = number
      dx(:, :, 1) = 0.0_wp
    case (first_of_two)
      return
    case (second_of_two)
      x(:, 1) = x(:, 2)
      dx(:, :, 1) = dx(:, :, 2)
    case (f_where)
      do k = 1, n
        a = merge(2, 3, abs(x(k, 1)) > 0.0_wp)
        x(k, 1) = x(k, a)
        dx(k, :, 1) = dx(k, :, a)
      end do
    case (called + 1:called + most_called)
      call step_outside(number, n, m, operands(code), x, dx)
    case default
      call of_samples(code, number, n, x, work(:, 1:2), work(:, 3), work(:, 4), m > 0)
      ! Same as `within`, which is in another module; written out for vectorization.
      two = operands(code) == 2
      do a = 1, m
        if (two) then
          do k = 1, n
            dx(k, a, 1) = min(max(work(k, 1)*dx(k, a, 1), -wall), wall) &
                          + min(max(work(k, 2)*dx(k, a, 2), -wall), wall)
          end do
        else
          do k = 1, n
            dx(k, a, 1) = min(max(work(k, 1)*dx(k, a, 1), -wall), wall)
          end do
        end if
      end do
    end select
  end subroutine step

  !> Apply a function outside of the core with p operands.
  pure subroutine step_outside(number, n, m, p, x, dx)
    real(wp), intent(in) :: number
    integer, intent(in) :: n, m, p
    real(wp), intent(inout) :: x(n, p), dx(n, m, p)
    real(wp) :: value(n), by(n, p)
    integer :: a, k

    call call_outside(number, m > 0, x, value, by)
    do a = 1, m
      dx(:, a, 1) = within(by(:, 1)*dx(:, a, 1))
      do k = 2, p
        dx(:, a, 1) = dx(:, a, 1) + within(by(:, k)*dx(:, a, k))
      end do
    end do
    x(:, 1) = value
  end subroutine step_outside

  !> Replace the first operand by the value of a function at samples, and compute its derivatives by
  !! the operands. Vectorized where possible.
  pure subroutine of_samples(code, number, n, x, by, value, other, wanted)
    integer, intent(in) :: code, n
    real(wp), intent(in) :: number
    !> `value` and `other` are workspace.
    real(wp), intent(inout) :: x(n, 3), by(n, 2), value(n), other(n)
    logical, intent(in) :: wanted
    integer :: k

    select case (code)
    case (multiply)
      value = min(max(x(:, 1)*x(:, 2), -wall), wall)
      by(:, 1) = x(:, 2)
      by(:, 2) = x(:, 1)
    case (square)
      value = min(x(:, 1)**2, wall)
      by(:, 1) = 2.0_wp*x(:, 1)
    case (divide)
      do k = 1, n
        by(k, 1) = merge(0.0_wp, 1.0_wp, abs(x(k, 2)) <= abs(x(k, 1))/wall)
        other(k) = merge(x(k, 2), 1.0_wp, by(k, 1) > 0.0_wp)
        value(k) = merge(x(k, 1)/other(k), wall, by(k, 1) > 0.0_wp)
        by(k, 1) = by(k, 1)/other(k)
        by(k, 2) = -value(k)*by(k, 1)
      end do
    case (f_min, f_max)
      ! At equality each operand has the derivative 1/2.
      by(:, 1) = merge(0.5_wp, merge(1.0_wp, 0.0_wp, (x(:, 1) < x(:, 2)) .eqv. (code == f_min)), &
                       .not. abs(x(:, 1) - x(:, 2)) > 0.0_wp)
      by(:, 2) = 1.0_wp - by(:, 1)
      value = merge(min(x(:, 1), x(:, 2)), max(x(:, 1), x(:, 2)), code == f_min)
    case (f_abs)
      value = abs(x(:, 1))
      by(:, 1) = merge(sign(1.0_wp, x(:, 1)), 0.0_wp, abs(x(:, 1)) > 0.0_wp)
    case (f_tanh)
      call by_blocks(code, n, x(:, 1), value, other)
      if (wanted) by(:, 1) = (1.0_wp - value)*(1.0_wp + value)
      ! For large arguments the difference above is only rounding error.
      if (wanted .and. any(abs(x(:, 1)) > 10.0_wp)) then
        where (abs(x(:, 1)) > 10.0_wp) by(:, 1) = 4.0_wp*exp(-2.0_wp*min(abs(x(:, 1)), steepest))
      end if
    case (f_sin, f_cos, f_exp, f_log)
      if (.not. in_range(code, x(:, 1))) then
        call one_by_one(code, number, n, x, value, by)
      else
        call by_blocks(code, n, x(:, 1), value, other)
        by(:, 1) = other
      end if
    case default
      call one_by_one(code, number, n, x, value, by)
    end select
    x(:, 1) = value
  end subroutine of_samples

  pure subroutine one_by_one(code, number, n, x, value, by)
    integer, intent(in) :: code, n
    real(wp), intent(in) :: number, x(n, 3)
    real(wp), intent(out) :: value(n), by(n, 2)
    real(wp) :: pair(2)
    integer :: k
    do k = 1, n
      if (operands(code) == 2) then
        call of_two(code, x(k, 1), x(k, 2), value(k), pair)
        by(k, :) = pair
      else
        call of_one(code, number, x(k, 1), value(k), by(k, 1))
      end if
    end do
  end subroutine one_by_one

  !> True if all operands are in the range of the vectorized functions.
  pure logical function in_range(code, x)
    integer, intent(in) :: code
    real(wp), intent(in) :: x(:)
    select case (code)
    case (f_exp)
      in_range = all(x <= steepest .and. x >= -700.0_wp)
    case (f_log)
      in_range = all(x > 1.0_wp/wall)
    case default
      in_range = all(abs(x) <= largest_angle)
    end select
  end function in_range

  !> A function in blocks of vector lanes, and its derivative (except for tanh).
  pure subroutine by_blocks(code, n, x, value, slope)
    integer, intent(in) :: code, n
    real(wp), intent(in) :: x(n)
    real(wp), intent(out) :: value(n), slope(n)
    real(wp), dimension(n_lanes) :: block, own, other
    integer :: first, last, m

    do first = 1, n, n_lanes
      last = min(first + n_lanes - 1, n)
      m = last - first + 1
      if (m < n_lanes) block = x(first)
      block(:m) = x(first:last)
      select case (code)
      case (f_tanh)
        call tangent_lanes(block, own)
        other = 0.0_wp
      case (f_sin)
        call sine_cosine_lanes(block, own, other)
      case (f_cos)
        call sine_cosine_lanes(block, other, own)
        other = -other
      case (f_exp)
        call exponential_lanes(block, own)
        other = own
      case default
        call logarithm_lanes(block, own)
        other = 1.0_wp/block
      end select
      value(first:last) = own(:m)
      slope(first:last) = other(:m)
    end do
  end subroutine by_blocks

end module viscovib_law_program
