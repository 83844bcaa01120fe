! Optimize: -O1
!> Switching surfaces of force laws, and laws with fixed branches.
!!
!! abs, min, max, sign, heaviside and comparisons are smooth on either side of the surface on which
!! the compared values are equal. atan2 is smooth except on the cut of the angle, where its first
!! operand is 0. With fixed sides a law is smooth beyond its surfaces too. A high-order integrator
!! steps up to the surface and continues with the other branch without loss of order. A root or
!! power of a value that is 0 on the surface (viscovib_law_roots) is not smooth there: the surface
!! is rough.
module viscovib_law_branches
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: angle_above, angle_below, f_atan2, f_log, held_log, held_pair, &
                                    power
  use viscovib_law_program, only: branches, f_abs, f_heaviside, f_max, f_min, f_more, f_sign, &
                                  f_sqrt, f_where, first_of_two, held_power, law_program, &
                                  negate, number_for_one, number_for_two, operands, put_number, &
                                  second_of_two, subtract, wall
  use viscovib_law_roots, only: find_roots
  implicit none
  private

  public :: signal_type, watched_function, find_signals, held

  !> Position relative to a surface: side 1 or -1, or `slides` for a position on it.
  integer, parameter, public :: slides = 2

  !> Abstract event function of state and time, whose zeros are located.
  type, abstract :: watched_function
  contains
    procedure(at_interface), deferred :: at
  end type watched_function

  abstract interface
    !> Values of the event function at given states.
    subroutine at_interface(self, t, q, v, g)
      import :: watched_function, wp
      class(watched_function), intent(in) :: self
      !> Shapes (n) and (n, n_dof).
      real(wp), intent(in) :: t(:), q(:, :), v(:, :)
      real(wp), intent(out) :: g(:)
    end subroutine at_interface
  end interface

  !> Event function of a law, which switches its branch where this function is 0.
  type, extends(watched_function) :: signal_type
    type(law_program) :: program
    !> Matrices from coordinates and rates to arguments, shape (n_arguments, n_dof). Not allocated:
    !! the arguments are the state (q_1, v_1, q_2, ...) and the time.
    real(wp), allocatable :: by_q(:, :), by_v(:, :)
    !> Exponent of the law at the surface if it is not smooth on its side (0: smooth).
    real(wp) :: rough = 0.0_wp
  contains
    procedure :: at => signal_at
  end type signal_type

contains

  !> Values of the event function at given states.
  subroutine signal_at(self, t, q, v, g)
    class(signal_type), intent(in) :: self
    !> Shapes (n) and (n, n_dof).
    real(wp), intent(in) :: t(:), q(:, :), v(:, :)
    real(wp), intent(out) :: g(:)
    real(wp), allocatable :: state(:, :)
    integer :: d, k

    if (allocated(self%by_q)) then
      allocate (state(size(t), size(self%by_q, 1)), source=0.0_wp)
      do k = 1, size(state, 2)
        do d = 1, size(q, 2)
          if (abs(self%by_q(k, d)) > 0.0_wp) state(:, k) = state(:, k) + self%by_q(k, d)*q(:, d)
          if (abs(self%by_v(k, d)) > 0.0_wp) state(:, k) = state(:, k) + self%by_v(k, d)*v(:, d)
        end do
      end do
      call self%program%evaluate(state, g)
      return
    end if
    allocate (state(size(t), 2*size(q, 2) + 1))
    state(:, 1:2*size(q, 2):2) = q
    state(:, 2:2*size(q, 2):2) = v
    state(:, 2*size(q, 2) + 1) = t
    call self%program%evaluate(state, g)
  end subroutine signal_at

  !> Event functions of a law, in the order of its instructions. Each uses the fixed sides of the
  !! surfaces before it.
  subroutine find_signals(law, sides, signals)
    type(law_program), intent(in) :: law
    !> Side of each surface, 1 or -1 (0: not fixed); size 0: none fixed.
    integer, intent(in) :: sides(:)
    type(law_program), allocatable, intent(out) :: signals(:)
    integer :: i, j, k, first

    allocate (signals(law%n_surfaces()))
    k = 0
    do i = 1, size(law%code)
      if (.not. branches(law%code(i))) cycle
      first = i - 1
      do j = 1, operands(law%code(i))
        first = before(law, first)
      end do
      first = first + 1
      k = k + 1
      call hold(law, first, i - 1, sides, signals(k))
      if (operands(law%code(i)) == 2) then
        ! For an angle use the first operand, which is 0 on its cut.
        signals(k)%code = [signals(k)%code, &
                           merge(first_of_two, subtract, law%code(i) == f_atan2)]
        signals(k)%number = [signals(k)%number, 0.0_wp]
      end if
      call signals(k)%measure()
    end do
  end subroutine find_signals

  !> The law with fixed sides of its surfaces, smooth beyond them.
  type(law_program) function held(law, sides)
    type(law_program), intent(in) :: law
    integer, intent(in) :: sides(:)
    call hold(law, 1, size(law%code), sides, held)
    call held%measure()
  end function held

  !> Copy instructions of a law, with fixed branches where sides are not 0.
  subroutine hold(law, from, to, sides, part)
    type(law_program), intent(in) :: law
    integer, intent(in) :: from, to, sides(:)
    type(law_program), intent(out) :: part
    integer :: i, k, n, side
    logical :: roots(size(law%code))
    real(wp) :: rough(law%n_surfaces())

    part%n_arguments = law%n_arguments
    call find_roots(law%code, law%number, roots, rough)
    allocate (part%code(to - from + 1), source=0)
    allocate (part%number(to - from + 1), source=0.0_wp)
    n = 0
    k = count(branches(law%code(:from - 1)))
    do i = from, to
      side = 0
      if (branches(law%code(i))) then
        k = k + 1
        if (size(sides) > 0) side = sides(k)
      end if
      ! abs of a positive value is the value itself.
      if (side == 1 .and. law%code(i) == f_abs) cycle
      n = n + 1
      part%code(n) = law%code(i)
      part%number(n) = law%number(i)
      if (side /= 0) call take(law%code(i), side, part%code(n), part%number(n))
      if (.not. roots(i)) cycle
      select case (law%code(i))
      case (f_log)
        part%code(n) = held_log
      case (power)
        part%code(n) = held_pair
      case default
        part%code(n) = held_power
        if (law%code(i) == f_sqrt) part%number(n) = 0.5_wp
      end select
    end do
    part%code = part%code(:n)
    part%number = part%number(:n)
    call settle_choices(part)
  end subroutine hold

  !> Replace conditions of `where` that are constant with fixed branches: numbers, or functions that
  !! are 0 only on surfaces, as in where(max(d, 0), a, b) on both sides of d = 0. They become
  !! numbers, because on the surface, where intervals of smooth motion start, the function is 0.
  subroutine settle_choices(part)
    type(law_program), intent(inout) :: part
    integer, parameter :: n = 5
    type(law_program) :: asked
    real(wp) :: places(n, part%n_arguments), value(n)
    integer :: i, j, first, last

    i = 0
    do while (i < size(part%code))
      i = i + 1
      if (part%code(i) /= f_where) cycle
      last = before(part, before(part, i - 1))
      first = before(part, last) + 1
      if (any(branches(part%code(first:last)))) cycle
      asked%n_arguments = part%n_arguments
      asked%code = part%code(first:last)
      asked%number = part%number(first:last)
      call asked%measure()
      ! Evaluate at generic points.
      places = reshape([(sin(1.7_wp*j), j=1, size(places))], shape(places))
      call asked%evaluate(places, value)
      if (any(abs(value) >= wall)) cycle
      part%code = [part%code(:first - 1), put_number, part%code(last + 1:)]
      part%number = [part%number(:first - 1), &
                     merge(1.0_wp, 0.0_wp, any(abs(value) > 0.0_wp)), part%number(last + 1:)]
      i = i - (last - first)
    end do
  end subroutine settle_choices

  !> Position before the instructions that compute the value of this instruction.
  pure integer function before(part, last)
    type(law_program), intent(in) :: part
    integer, intent(in) :: last
    integer :: wanted

    before = last
    wanted = 1
    do while (wanted > 0)
      wanted = wanted - 1 + operands(part%code(before))
      before = before - 1
    end do
  end function before

  !> Replacement of an instruction on one side of its surface.
  pure subroutine take(code, side, taken, number)
    integer, intent(in) :: code, side
    integer, intent(out) :: taken
    real(wp), intent(out) :: number

    number = 0.0_wp
    select case (code)
    case (f_abs)
      taken = negate
    case (f_sign)
      taken = number_for_one
      number = real(side, wp)
    case (f_heaviside)
      taken = number_for_one
      number = real((1 + side)/2, wp)
    case (f_max)
      taken = merge(first_of_two, second_of_two, side == 1)
    case (f_min)
      taken = merge(second_of_two, first_of_two, side == 1)
    case (f_atan2)
      taken = merge(angle_above, angle_below, side == 1)
    case default
      ! Below: less, atmost; above: more, atleast.
      taken = number_for_two
      number = merge(1.0_wp, 0.0_wp, (code >= f_more) .eqv. (side == 1))
    end select
  end subroutine take

end module viscovib_law_branches
