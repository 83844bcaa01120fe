! Optimize: -O3
!> Vectorized evaluation of force laws for a block of vector lanes.
!!
!! Each instruction is a loop over lanes without branches. sin, cos, exp, tanh, log, roots and
!! integer or half-integer powers are vectorized (viscovib_vector_math); other functions are
!! evaluated one by one. gfortran 12 vectorizes these loops fully only if they are not unrolled
!! before (see `viscovib_node_kernels`).
module viscovib_law_lanes
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_functions, only: called
  use viscovib_law_outside, only: call_outside
  use viscovib_law_program, only: add, bounded, divide, f_abs, f_atleast, f_atmost, f_cos, f_exp, &
    f_heaviside, f_less, f_log, f_max, f_min, f_more, f_sign, f_sin, f_sqrt, f_tanh, f_where, &
    first_of_two, held_power, known_power, law_program, leaves, mark_outside, multiply, negate, &
    number_for_one, number_for_two, of_one, of_two, operands, put_argument, put_number, &
    second_of_two, square, steepest, subtract, wall
  use viscovib_law_term, only: law_term
  use viscovib_vector_math, only: exponential_lanes, largest_angle, logarithm_lanes, &
    sine_cosine_lanes, tangent_lanes
  implicit none
  private

  public :: all_small, evaluate_lanes, evaluate_term, read_arguments

  !> Larger powers are computed as real powers.
  real(wp), parameter :: highest_power = 32.0_wp
  !> Stack columns that suffice for most laws, including two columns of workspace.
  integer, parameter :: usual_depth = 16
  !> Arguments that suffice for most laws.
  integer, parameter :: usual_arguments = 8

contains

  !> Evaluate the law of a system term from coordinates and rates.
  pure subroutine evaluate_term(law, q, v, value)
    type(law_term), intent(in) :: law
    real(wp), intent(in) :: q(n_lanes, size(law%arguments, 2)), v(n_lanes, size(law%arguments, 2))
    real(wp), intent(out) :: value(n_lanes)
    real(wp) :: arguments(n_lanes, usual_arguments)

    if (size(law%arguments, 1) > usual_arguments) then
      call evaluate_lanes(law%program, law%arguments_of_lanes(q, v), value)
    else
      call read_arguments(size(law%arguments, 1), size(law%arguments, 2), law%arguments, &
                          law%rates, q, v, arguments)
      call evaluate_lanes(law%program, arguments, value)
    end if
  end subroutine evaluate_term

  !> A q + A' v in every vector lane. Zero coefficients skip factors that may not be finite.
  pure subroutine read_arguments(m, n_dof, by_q, by_v, q, v, arguments)
    integer, intent(in) :: m, n_dof
    real(wp), intent(in) :: by_q(m, n_dof), by_v(m, n_dof), q(n_lanes, n_dof), v(n_lanes, n_dof)
    real(wp), intent(out) :: arguments(n_lanes, m)
    real(wp) :: total(n_lanes)
    integer :: b, k, l

    do k = 1, m
      total = 0.0_wp
      do b = 1, n_dof
        if (abs(by_q(k, b)) > 0.0_wp) then
          !GCC$ unroll 1
          do l = 1, n_lanes
            total(l) = total(l) + by_q(k, b)*q(l, b)
          end do
        end if
        if (abs(by_v(k, b)) > 0.0_wp) then
          !GCC$ unroll 1
          do l = 1, n_lanes
            total(l) = total(l) + by_v(k, b)*v(l, b)
          end do
        end if
      end do
      arguments(:, k) = total
    end do
  end subroutine read_arguments

  !> Evaluate the law in every vector lane.
  pure subroutine evaluate_lanes(law, arguments, value)
    type(law_program), intent(in) :: law
    !> Shape (n_lanes, n_arguments).
    real(wp), intent(in) :: arguments(n_lanes, *)
    real(wp), intent(out) :: value(n_lanes)
    real(wp) :: x(n_lanes, usual_depth)
    real(wp), allocatable :: deep(:, :)
    logical :: outside(n_lanes, usual_depth)
    logical, allocatable :: deep_outside(:, :)

    ! Use the stack: an allocation takes as long as some instructions.
    if (law%depth + 2 <= usual_depth) then
      call run_law(law, arguments, usual_depth, x, outside)
      value = x(:, 1)
    else
      allocate (deep(n_lanes, law%depth + 2), deep_outside(n_lanes, law%depth + 2))
      call run_law(law, arguments, law%depth + 2, deep, deep_outside)
      value = deep(:, 1)
    end if
  end subroutine evaluate_lanes

  !> Run the law with numbers common to all vector lanes or different in each.
  pure subroutine run_law(law, arguments, m, x, outside)
    type(law_program), intent(in) :: law
    integer, intent(in) :: m
    real(wp), intent(in) :: arguments(n_lanes, *)
    real(wp), intent(inout) :: x(n_lanes, m)
    logical, intent(inout) :: outside(n_lanes, m)

    if (allocated(law%of_lanes)) then
      call run_lanes(size(law%code), law%code, law%number, n_lanes, law%of_lanes, arguments, m, x, &
                     outside)
    else
      call run_lanes(size(law%code), law%code, law%number, 1, law%number, arguments, m, x, outside)
    end if
  end subroutine run_law

  !> Run the instructions. Sums and products are evaluated inline; a number as second operand is
  !! used directly.
  pure subroutine run_lanes(n, code, number, width, put, arguments, m, x, outside)
    integer, intent(in) :: n, code(n), width, m
    !> Constants: equal in all vector lanes (width 1) or one for each.
    real(wp), intent(in) :: number(n), put(width, n), arguments(n_lanes, *)
    real(wp), intent(inout) :: x(n_lanes, m)
    !> Marks of lanes outside of a domain, used once there is such a lane.
    logical, intent(inout) :: outside(n_lanes, m)
    integer :: i, l, next, top
    logical :: left

    left = .false.
    top = 0
    i = 0
    do while (i < n)
      i = i + 1
      select case (code(i))
      case (put_argument)
        top = top + 1
        x(:, top) = arguments(:, int(number(i)))
        if (left) outside(:, top) = .false.
      case (put_number)
        next = put_number
        if (i < n .and. top > 0) next = code(i + 1)
        if (next == multiply .or. next == add .or. next == subtract) then
          if (width == 1) then
            call take_number(next, put(1, i), x(1, top))
          else
            call take_numbers(next, put(1, i), x(1, top))
          end if
          i = i + 1
        else
          top = top + 1
          if (width == 1) then
            x(:, top) = put(1, i)
          else
            x(:, top) = put(:n_lanes, i)
          end if
          if (left) outside(:, top) = .false.
        end if
      case (multiply, add, subtract)
        top = top - 1
        if (left) outside(:, top) = outside(:, top) .or. outside(:, top + 1)
        if (code(i) == multiply) then
          !GCC$ unroll 1
          do l = 1, n_lanes
            x(l, top) = min(max(x(l, top)*x(l, top + 1), -wall), wall)
          end do
        else if (code(i) == add) then
          !GCC$ unroll 1
          do l = 1, n_lanes
            x(l, top) = x(l, top) + x(l, top + 1)
          end do
        else
          !GCC$ unroll 1
          do l = 1, n_lanes
            x(l, top) = x(l, top) - x(l, top + 1)
          end do
        end if
      case default
        top = top - operands(code(i)) + 1
        if (bounded(code(i)) .and. .not. left) then
          left = any(leaves(code(i), number(i), x(:, top)))
          if (left) outside = .false.
        end if
        if (left) call mark_outside(code(i), number(i), n_lanes, x(1, top), outside(1, top))
        if (code(i) > called) then
          call instruct_outside(number(i), operands(code(i)), x(1, top))
        else
          call instruct(code(i), number(i), x(1, top))
        end if
      end select
    end do
    if (left) x(:, 1) = merge(wall, x(:, 1), outside(:, 1))
  end subroutine run_lanes

  !> Product, sum or difference with a number.
  pure subroutine take_number(code, c, x)
    integer, intent(in) :: code
    real(wp), intent(in) :: c
    real(wp), intent(inout) :: x(n_lanes)
    integer :: l

    select case (code)
    case (multiply)
      !GCC$ unroll 1
      do l = 1, n_lanes
        x(l) = min(max(x(l)*c, -wall), wall)
      end do
    case (add)
      !GCC$ unroll 1
      do l = 1, n_lanes
        x(l) = x(l) + c
      end do
    case default
      !GCC$ unroll 1
      do l = 1, n_lanes
        x(l) = x(l) - c
      end do
    end select
  end subroutine take_number

  !> Product, sum or difference with one number for each lane.
  pure subroutine take_numbers(code, c, x)
    integer, intent(in) :: code
    real(wp), intent(in) :: c(n_lanes)
    real(wp), intent(inout) :: x(n_lanes)
    integer :: l

    select case (code)
    case (multiply)
      !GCC$ unroll 1
      do l = 1, n_lanes
        x(l) = min(max(x(l)*c(l), -wall), wall)
      end do
    case (add)
      !GCC$ unroll 1
      do l = 1, n_lanes
        x(l) = x(l) + c(l)
      end do
    case default
      !GCC$ unroll 1
      do l = 1, n_lanes
        x(l) = x(l) - c(l)
      end do
    end select
  end subroutine take_numbers

  !> Execute an instruction. Its operands are the columns of x; the value replaces the first.
  pure subroutine instruct(code, number, x)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    real(wp), intent(inout) :: x(n_lanes, 3)
    integer :: l

    select case (code)
    case (number_for_one, number_for_two)
      x(:, 1) = number
    case (square)
      x(:, 1) = min(x(:, 1)**2, wall)
    case (negate)
      x(:, 1) = -x(:, 1)
    case (divide)
      do l = 1, n_lanes
        x(l, 1) = merge(wall, x(l, 1)/merge(1.0_wp, x(l, 2), abs(x(l, 2)) <= abs(x(l, 1))/wall), &
                        abs(x(l, 2)) <= abs(x(l, 1))/wall)
      end do
    case (first_of_two)
      return
    case (second_of_two)
      x(:, 1) = x(:, 2)
    case (f_where)
      x(:, 1) = merge(x(:, 2), x(:, 3), abs(x(:, 1)) > 0.0_wp)
    case (f_abs)
      x(:, 1) = abs(x(:, 1))
    case (f_min)
      x(:, 1) = merge(x(:, 1), x(:, 2), x(:, 1) <= x(:, 2))
    case (f_max)
      x(:, 1) = merge(x(:, 2), x(:, 1), x(:, 1) <= x(:, 2))
    case (f_less)
      x(:, 1) = merge(1.0_wp, 0.0_wp, x(:, 1) < x(:, 2))
    case (f_atmost)
      x(:, 1) = merge(1.0_wp, 0.0_wp, x(:, 1) <= x(:, 2))
    case (f_more)
      x(:, 1) = merge(1.0_wp, 0.0_wp, x(:, 1) > x(:, 2))
    case (f_atleast)
      x(:, 1) = merge(1.0_wp, 0.0_wp, x(:, 1) >= x(:, 2))
    case (f_sign)
      x(:, 1) = merge(sign(1.0_wp, x(:, 1)), 0.0_wp, abs(x(:, 1)) > 0.0_wp)
    case (f_heaviside)
      x(:, 1) = merge(merge(1.0_wp, 0.0_wp, x(:, 1) > 0.0_wp), 0.5_wp, abs(x(:, 1)) > 0.0_wp)
    case default
      call transcend(code, number, x)
    end select
  end subroutine instruct

  !> Apply a function outside of the core with p operands.
  pure subroutine instruct_outside(number, p, x)
    real(wp), intent(in) :: number
    integer, intent(in) :: p
    real(wp), intent(inout) :: x(n_lanes, p)
    real(wp) :: value(n_lanes), nothing(n_lanes, p)

    call call_outside(number, .false., x, value, nothing)
    x(:, 1) = value
  end subroutine instruct_outside

  !> Functions that need more than a few operations.
  pure subroutine transcend(code, number, x)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    real(wp), intent(inout) :: x(n_lanes, 3)
    real(wp) :: other(n_lanes), by(2)
    logical :: inside(n_lanes)
    integer :: l

    select case (code)
    case (f_sin, f_cos)
      if (all_small(x(1, 1))) then
        call sine_cosine_lanes(x(:, 1), x(:, 2), x(:, 3))
        x(:, 1) = x(:, merge(2, 3, code == f_sin))
        return
      end if
      inside = abs(x(:, 1)) <= largest_angle
      x(:, 2) = merge(x(:, 1), 0.0_wp, inside)
      if (code == f_sin) then
        call sine_cosine_lanes(x(:, 2), other, x(:, 3))
      else
        call sine_cosine_lanes(x(:, 2), x(:, 3), other)
      end if
      ! Lane by lane, so that lanes are independent of each other.
      do l = 1, n_lanes
        if (.not. inside(l)) call of_one(code, number, x(l, 1), other(l), by(1))
      end do
      x(:, 1) = other
      return
    case (f_exp)
      call exponential_lanes(min(max(x(:, 1), -700.0_wp), steepest), other)
      x(:, 1) = merge(wall, other, x(:, 1) > steepest)
      return
    case (f_tanh)
      call tangent_lanes(x(:, 1), x(:, 2))
      x(:, 1) = x(:, 2)
      return
    case (f_log)
      call logarithm_lanes(max(x(:, 1), 1.0_wp/wall), other)
      x(:, 1) = merge(wall, other, x(:, 1) <= 1.0_wp/wall)
      return
    case (f_sqrt)
      other = sqrt(abs(x(:, 1)))
      x(:, 1) = merge(wall, other, x(:, 1) < 0.0_wp)
      return
    case (known_power, held_power)
      if (abs(number) <= highest_power &
          .and. abs(2.0_wp*number - anint(2.0_wp*number)) <= 0.0_wp) then
        other = x(:, 1)
        if (code == held_power) x(:, 1) = abs(other)
        call raise(number, x)
        if (code == held_power) x(:, 1) = sign(x(:, 1), other)
        return
      end if
    case default
      other = 0.0_wp
    end select
    if (operands(code) == 2) then
      do l = 1, n_lanes
        call of_two(code, x(l, 1), x(l, 2), other(l), by)
      end do
    else
      do l = 1, n_lanes
        call of_one(code, number, x(l, 1), other(l), by(1))
      end do
    end if
    x(:, 1) = other
  end subroutine transcend

  !> True if the angles are far inside the vectorized range; otherwise they are checked one by one.
  !! Uses a sum, since a maximum would prevent vectorization.
  pure logical function all_small(x)
    real(wp), intent(in) :: x(n_lanes)
    real(wp) :: sizes(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      sizes(l) = abs(x(l))
    end do
    all_small = ((sizes(1) + sizes(5)) + (sizes(3) + sizes(7))) &
                + ((sizes(2) + sizes(6)) + (sizes(4) + sizes(8))) <= largest_angle
  end function all_small

  !> x^number for integer 2*number, by products if the base is in range. Each lane is independent of
  !! the others.
  pure subroutine raise(number, x)
    real(wp), intent(in) :: number
    real(wp), intent(inout) :: x(n_lanes, 3)
    real(wp) :: product(n_lanes), factor(n_lanes), power, by
    logical :: half, inside(n_lanes)
    integer :: l, n

    n = abs(nint(2.0_wp*number))
    half = mod(n, 2) == 1
    n = n/2
    inside = abs(x(:, 1)) > 1.0e-4_wp .and. abs(x(:, 1)) < 1.0e4_wp
    if (half) inside = inside .and. x(:, 1) > 0.0_wp
    factor = merge(x(:, 1), 1.0_wp, inside)
    product = 1.0_wp
    if (half) product = sqrt(factor)
    do while (n > 0)
      if (mod(n, 2) == 1) product = product*factor
      n = n/2
      if (n > 0) factor = factor*factor
    end do
    if (number < 0.0_wp) product = 1.0_wp/product
    do l = 1, n_lanes
      if (inside(l)) cycle
      call of_one(known_power, number, x(l, 1), power, by)
      product(l) = power
    end do
    x(:, 1) = product
  end subroutine raise

end module viscovib_law_lanes
