! Optimize: -O3
!> Vectorized force laws with derivatives by their arguments.
!!
!! Forward differentiation as in `viscovib_law_program`, which is used instead for other
!! instructions or for operands near the boundary of a domain.
module viscovib_law_slopes
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_lanes, only: read_arguments
  use viscovib_law_program, only: add, divide, f_cos, f_exp, f_log, f_sin, f_sqrt, f_tanh, &
    known_power, law_program, multiply, negate, put_argument, put_number, square, steepest, &
    subtract, wall
  use viscovib_law_term, only: law_term
  use viscovib_vector_math, only: exponential_lanes, largest_angle, logarithm_lanes, &
    sine_cosine_lanes, tangent_lanes
  implicit none
  private

  public :: differentiate_term

  !> Largest number of arguments for vectorized differentiation.
  integer, parameter, public :: most_arguments = 4
  !> Stack depth of most laws, and highest power computed by products.
  integer, parameter :: usual_depth = 12, highest_power = 9
  !> Larger bases of such powers are left to `viscovib_law_program`.
  real(wp), parameter :: highest_base = 1.0e4_wp

contains

  !> The law of a term from coordinates and rates, and its derivatives by its arguments.
  pure subroutine differentiate_term(law, q, v, value, slopes)
    type(law_term), intent(in) :: law
    real(wp), intent(in) :: q(n_lanes, size(law%arguments, 2)), v(n_lanes, size(law%arguments, 2))
    !> Shapes (n_lanes) and (n_lanes, n_arguments).
    real(wp), intent(out) :: value(n_lanes), slopes(n_lanes, size(law%arguments, 1))
    real(wp) :: arguments(n_lanes, most_arguments), x(n_lanes, usual_depth)
    real(wp) :: dx(n_lanes, most_arguments, usual_depth)
    logical :: done
    integer :: m

    m = size(law%arguments, 1)
    done = m <= most_arguments .and. law%program%depth < usual_depth
    if (done) then
      call read_arguments(m, size(law%arguments, 2), law%arguments, law%rates, q, v, arguments)
      call run(size(law%program%code), law%program%code, law%program%number, m, arguments, x, dx, &
               done)
    end if
    if (done) then
      value = x(:, 1)
      slopes = dx(:, :m, 1)
    else
      call law%program%differentiate(law%arguments_of_lanes(q, v), value, slopes)
    end if
  end subroutine differentiate_term

  pure subroutine run(n, code, number, m, arguments, x, dx, done)
    integer, intent(in) :: n, code(n), m
    real(wp), intent(in) :: number(n), arguments(n_lanes, m)
    real(wp), intent(inout) :: x(n_lanes, usual_depth), dx(n_lanes, most_arguments, usual_depth)
    !> False if an instruction or operand is not supported here.
    logical, intent(out) :: done
    real(wp) :: slope(n_lanes)
    integer :: i, k, l, next, top

    done = .true.
    top = 0
    i = 0
    do while (i < n)
      i = i + 1
      select case (code(i))
      case (put_argument)
        top = top + 1
        x(:, top) = arguments(:, int(number(i)))
        dx(:, :m, top) = 0.0_wp
        dx(:, int(number(i)), top) = 1.0_wp
      case (put_number)
        next = put_number
        if (i < n .and. top > 0) next = code(i + 1)
        select case (next)
        case (add, subtract, multiply)
          call with_number(next, number(i), m, x(1, top), dx(1, 1, top))
          i = i + 1
        case default
          top = top + 1
          x(:, top) = number(i)
          dx(:, :m, top) = 0.0_wp
        end select
      case (multiply)
        top = top - 1
        do k = 1, m
          !GCC$ unroll 1
          do l = 1, n_lanes
            dx(l, k, top) = min(max(dx(l, k, top)*x(l, top + 1), -wall), wall) &
                            + min(max(dx(l, k, top + 1)*x(l, top), -wall), wall)
          end do
        end do
        !GCC$ unroll 1
        do l = 1, n_lanes
          x(l, top) = min(max(x(l, top)*x(l, top + 1), -wall), wall)
        end do
      case (add, subtract)
        top = top - 1
        call add_up(code(i) == add, m, x(1, top), dx(1, 1, top))
      case default
        if (code(i) == divide) top = top - 1
        call of_lanes(code(i), number(i), m, x(1, top), dx(1, 1, top), slope, done)
        if (.not. done) return
        do k = 1, m
          !GCC$ unroll 1
          do l = 1, n_lanes
            dx(l, k, top) = min(max(slope(l)*dx(l, k, top), -wall), wall)
          end do
        end do
      end select
    end do
  end subroutine run

  !> Sum, difference or product of a value and a number.
  pure subroutine with_number(code, c, m, x, dx)
    integer, intent(in) :: code, m
    real(wp), intent(in) :: c
    real(wp), intent(inout) :: x(n_lanes), dx(n_lanes, most_arguments)
    real(wp) :: term
    integer :: k, l

    if (code /= multiply) then
      term = merge(c, -c, code == add)
      !GCC$ unroll 1
      do l = 1, n_lanes
        x(l) = x(l) + term
      end do
      return
    end if
    !GCC$ unroll 1
    do l = 1, n_lanes
      x(l) = min(max(c*x(l), -wall), wall)
    end do
    do k = 1, m
      !GCC$ unroll 1
      do l = 1, n_lanes
        dx(l, k) = min(max(c*dx(l, k), -wall), wall)
      end do
    end do
  end subroutine with_number

  !> Sum or difference of two values, and of their derivatives.
  pure subroutine add_up(plus, m, x, dx)
    logical, intent(in) :: plus
    integer, intent(in) :: m
    real(wp), intent(inout) :: x(n_lanes, 2), dx(n_lanes, most_arguments, 2)
    real(wp) :: c
    integer :: k, l

    c = merge(1.0_wp, -1.0_wp, plus)
    !GCC$ unroll 1
    do l = 1, n_lanes
      x(l, 1) = x(l, 1) + c*x(l, 2)
    end do
    do k = 1, m
      !GCC$ unroll 1
      do l = 1, n_lanes
        dx(l, k, 1) = dx(l, k, 1) + c*dx(l, k, 2)
      end do
    end do
  end subroutine add_up

  !> Apply a function to its operand in x. Returns its derivative in `slope`.
  pure subroutine of_lanes(code, number, m, x, dx, slope, done)
    integer, intent(in) :: code, m
    real(wp), intent(in) :: number
    real(wp), intent(inout) :: x(n_lanes, 2), dx(n_lanes, most_arguments, 2)
    real(wp), intent(out) :: slope(n_lanes)
    !> False if the function is not supported here, or if it is not smooth at an operand.
    logical, intent(out) :: done
    real(wp) :: value(n_lanes)
    integer :: k

    slope = 0.0_wp
    value = x(:, 1)
    done = .true.
    select case (code)
    case (negate)
      value = -x(:, 1)
      slope = -1.0_wp
    case (square)
      value = min(x(:, 1)**2, wall)
      slope = 2.0_wp*x(:, 1)
    case (f_sin, f_cos)
      done = all(abs(x(:, 1)) <= largest_angle)
      if (.not. done) return
      if (code == f_sin) then
        call sine_cosine_lanes(x(:, 1), value, slope)
      else
        call sine_cosine_lanes(x(:, 1), slope, value)
        slope = -slope
      end if
    case (f_tanh)
      call tangent_lanes(x(:, 1), value)
      slope = (1.0_wp - value)*(1.0_wp + value)
    case (f_exp)
      done = all(abs(x(:, 1)) <= steepest)
      if (.not. done) return
      call exponential_lanes(x(:, 1), value)
      slope = value
    case (f_log)
      done = all(x(:, 1) > 1.0_wp/highest_base)
      if (.not. done) return
      call logarithm_lanes(x(:, 1), value)
      slope = 1.0_wp/x(:, 1)
    case (f_sqrt)
      done = all(x(:, 1) > 1.0_wp/highest_base)
      if (.not. done) return
      value = sqrt(x(:, 1))
      slope = 0.5_wp/value
    case (known_power)
      k = nint(number)
      done = abs(number - k) <= 0.0_wp .and. k > 0 .and. k <= highest_power &
             .and. all(abs(x(:, 1)) <= highest_base)
      if (.not. done) return
      slope = 1.0_wp
      do k = 2, nint(number)
        slope = slope*x(:, 1)
      end do
      value = slope*x(:, 1)
      slope = number*slope
    case (divide)
      done = all(abs(x(:, 2)) > 1.0_wp/highest_base)
      if (.not. done) return
      slope = 1.0_wp/x(:, 2)
      value = min(max(x(:, 1)*slope, -wall), wall)
      do k = 1, m
        dx(:, k, 1) = dx(:, k, 1) - value*dx(:, k, 2)
      end do
      value = x(:, 1)/x(:, 2)
    case default
      done = .false.
    end select
    x(:, 1) = value
  end subroutine of_lanes

end module viscovib_law_slopes
