!> Ranges of laws: for random programs in random boxes, no value of a law and no rate lies outside
!! its range.
module test_law_bounds
  use testing, only: begin, check
  use viscovib_kinds, only: wp
  use viscovib_law_bounds, only: bounds_of, inside, nowhere, range_type
  use viscovib_law_functions, only: add, divide, f_abs, f_acos, f_acosh, f_asin, f_asinh, f_atan, &
    f_atan2, f_atanh, f_atmost, f_cos, f_cosh, f_exp, f_heaviside, f_less, f_log, f_max, f_min, &
    f_more, f_sign, f_sin, f_sinh, f_sqrt, f_tan, f_tanh, f_where, first_function, known_power, &
    multiply, negate, operands, power, put_argument, put_number, square, subtract, wall
  use viscovib_law_program, only: law_program
  implicit none
  private

  public :: run_law_bounds

  integer, parameter :: n_arguments = 3, n_points = 40, n_programs = 6000
  !> Rounding error of a value or rate, relative to the largest terms in it.
  real(wp), parameter :: rounding = 1.0e-12_wp
  !> Larger values, and larger arguments of exp, may count as undefined.
  real(wp), parameter :: largest = 1.0e12_wp, far = 130.0_wp
  integer :: seed = 1

contains

  subroutine run_law_bounds()
    if (begin('ranges contain the values of random programs')) call look_into_boxes()
    if (begin('the range of a point is its value')) call look_at_points()
  end subroutine run_law_bounds

  !> Next number in [0, 1) of a reproducible sequence (Park and Miller).
  real(wp) function chance()
    integer, parameter :: a = 16807, m = 2147483647, q = 127773, r = 2836
    seed = a*modulo(seed, q) - r*(seed/q)
    if (seed < 0) seed = seed + m
    chance = real(seed, wp)/m
  end function chance

  !> A random integer from 1 to n.
  integer function one_of(n)
    integer, intent(in) :: n
    one_of = 1 + min(int(n*chance()), n - 1)
  end function one_of

  subroutine look_into_boxes()
    type(law_program) :: law
    type(range_type) :: box(n_arguments), range
    real(wp) :: width
    integer :: i, n_event_rows, n_rates, n_nowhere

    seed = 20
    n_event_rows = 0
    n_rates = 0
    n_nowhere = 0
    do i = 1, n_programs
      call draw_program(law, 4)
      width = 10.0_wp**(6.0_wp*chance() - 5.0_wp)
      call draw_box(width, box)
      call bounds_of(law, box, range)
      call look_at_points_of(law, box, range)
      if (range%outside == inside .and. .not. any(abs(range%value) >= wall)) then
        n_event_rows = n_event_rows + 1
      end if
      if (has_rates_text(range)) n_rates = n_rates + 1
      if (range%outside == nowhere) n_nowhere = n_nowhere + 1
    end do
    ! An infinite range would contain every value.
    call check(n_event_rows > n_programs/3, 'ranges that tell something')
    call check(n_rates > n_programs/4, 'ranges that tell rates')
    call check(n_nowhere > n_programs/100, 'boxes without values')
  end subroutine look_into_boxes

  !> Boxes of zero size.
  subroutine look_at_points()
    type(law_program) :: law
    type(range_type) :: box(n_arguments), range
    integer :: i

    seed = 7
    do i = 1, n_programs
      call draw_program(law, 3)
      call draw_box(0.0_wp, box)
      call bounds_of(law, box, range)
      call look_at_points_of(law, box, range)
      if (range%outside /= inside .or. range%jumps .or. any(abs(range%value) >= wall)) cycle
      call report_to(range%value(2) - range%value(1) <= rounding*maxval(abs(range%value)) &
                + 16.0_wp*range%noise, 'width of a point', law)
    end do
  end subroutine look_at_points

  !> True if the range of rates is valid: finite, and the function has no jumps.
  logical function has_rates_text(range)
    type(range_type), intent(in) :: range
    has_rates_text = range%outside == inside .and. .not. range%jumps &
                  .and. all(abs(range%value) < wall) .and. all(abs(range%rate) < wall)
  end function has_rates_text

  !> Check values and rates at random points of a box.
  subroutine look_at_points_of(law, box, range)
    type(law_program), intent(in) :: law
    type(range_type), intent(in) :: box(:), range
    real(wp) :: at(1, n_arguments), moves(n_arguments), value(1), slopes(1, n_arguments)
    real(wp) :: true, rate, slack
    integer :: i, k
    logical :: defined, known, edge

    do i = 1, n_points
      do k = 1, n_arguments
        at(1, k) = place_in(box(k)%value)
        moves(k) = place_in(box(k)%rate)
      end do
      call evaluate_plainly(law, at(1, :), true, defined, known, edge)
      if (.not. known) cycle
      if (.not. defined) then
        call report_to(range%outside /= inside .or. range%jumps, 'no value', law)
        cycle
      end if
      call report_to(range%outside /= nowhere, 'a value where there is none', law)
      slack = rounding*max(maxval(abs(range%value)), abs(true)) + 4.0_wp*range%noise
      call report_to(true >= range%value(1) - slack .and. true <= range%value(2) + slack, 'value', &
                law)
      if (edge .or. .not. has_rates_text(range)) cycle
      call law%differentiate(at, value, slopes)
      rate = sum(slopes(1, :)*moves)
      slack = (1.0e-9_wp + 1.0e3_wp*range%noise)*(1.0_wp + sum(abs(slopes(1, :)*moves)))
      call report_to(rate >= range%rate(1) - slack .and. rate <= range%rate(2) + slack, 'rate', law)
    end do
  end subroutine look_at_points_of

  !> The value of a law, by Fortran intrinsic functions.
  subroutine evaluate_plainly(law, at, value, defined, known, edge)
    type(law_program), intent(in) :: law
    real(wp), intent(in) :: at(:)
    real(wp), intent(out) :: value
    !> Whether the value exists; whether this is certain (no overflow, no dependence on rounding);
    !! whether a function is at the edge of its domain, where its slope may not exist.
    logical, intent(out) :: defined, known, edge
    real(wp) :: x(law%depth + 2), number
    logical :: has(law%depth + 2), exact(law%depth + 2)
    integer :: i, top

    top = 0
    known = .true.
    edge = .false.
    do i = 1, size(law%code)
      number = law%number(i)
      select case (operands(law%code(i)))
      case (0)
        top = top + 1
        x(top) = number
        if (law%code(i) == put_argument) x(top) = at(nint(number))
        has(top) = .true.
        exact(top) = .true.
      case (1)
        if (.not. exact(top)) known = known .and. .not. at_edge(law%code(i), x(top), rounding)
        exact(top) = exact(top) .and. any(law%code(i) == [negate, f_abs, f_sign, f_heaviside])
        edge = edge .or. at_edge(law%code(i), x(top), 0.0_wp)
        if (has(top)) call of_one_plainly(law%code(i), number, x(top), has(top))
      case (2)
        top = top - 1
        exact(top) = exact(top) .and. exact(top + 1)
        if (law%code(i) >= f_min .and. .not. exact(top)) then
          known = known .and. abs(x(top) - x(top + 1)) > rounding*(1.0_wp + abs(x(top)))
        end if
        exact(top) = exact(top) .and. law%code(i) >= f_min
        has(top) = has(top) .and. has(top + 1)
        if (has(top)) call of_two_plainly(law%code(i), x(top), x(top + 1), has(top))
      case default
        top = top - 2
        known = known .and. (exact(top) .or. abs(x(top)) > rounding)
        exact(top) = all(exact(top:top + 2))
        if (abs(x(top)) > 0.0_wp) then
          has(top) = has(top) .and. has(top + 1)
          x(top) = x(top + 1)
        else
          has(top) = has(top) .and. has(top + 2)
          x(top) = x(top + 2)
        end if
      end select
      if (.not. has(top)) x(top) = 0.0_wp
      if (abs(x(top)) > largest .or. (abs(x(top)) < 1.0_wp/largest .and. abs(x(top)) > 0.0_wp)) then
        known = .false.
        exit
      end if
    end do
    value = x(1)
    defined = has(1)
  end subroutine evaluate_plainly

  !> True if the slope of a function may not exist at a point, or its value next to the point.
  logical function at_edge(code, x, near)
    integer, intent(in) :: code
    real(wp), intent(in) :: x, near
    select case (code)
    case (known_power, f_sqrt, f_log, f_abs, f_sign, f_heaviside)
      at_edge = .not. abs(x) > near
    case (f_asin, f_acos, f_acosh, f_atanh)
      at_edge = .not. abs(abs(x) - 1.0_wp) > near
    case default
      at_edge = .false.
    end select
  end function at_edge

  subroutine of_one_plainly(code, number, x, has)
    integer, intent(in) :: code
    real(wp), intent(in) :: number
    real(wp), intent(inout) :: x
    logical, intent(inout) :: has

    select case (code)
    case (negate)
      x = -x
    case (square)
      x = x*x
    case (known_power)
      if (abs(number - anint(number)) > 0.0_wp) then
        has = x > 0.0_wp .or. (x >= 0.0_wp .and. number > 0.0_wp)
        if (has) x = x**number
      else
        has = abs(x) > 0.0_wp .or. number >= 0.0_wp
        if (has) x = x**nint(number)
      end if
    case (f_sin)
      x = sin(x)
    case (f_cos)
      x = cos(x)
    case (f_tan)
      x = tan(x)
    case (f_asin)
      has = abs(x) <= 1.0_wp
      if (has) x = asin(x)
    case (f_acos)
      has = abs(x) <= 1.0_wp
      if (has) x = acos(x)
    case (f_atan)
      x = atan(x)
    case (f_sinh)
      x = sinh(min(max(x, -far), far))
    case (f_cosh)
      x = cosh(min(max(x, -far), far))
    case (f_tanh)
      x = tanh(x)
    case (f_asinh)
      x = asinh(x)
    case (f_acosh)
      has = x >= 1.0_wp
      if (has) x = acosh(x)
    case (f_atanh)
      has = abs(x) < 1.0_wp
      if (has) x = atanh(x)
    case (f_exp)
      x = exp(min(max(x, -far), far))
    case (f_log)
      has = x > 0.0_wp
      if (has) x = log(x)
    case (f_sqrt)
      has = x >= 0.0_wp
      if (has) x = sqrt(x)
    case (f_abs)
      x = abs(x)
    case (f_sign)
      if (abs(x) > 0.0_wp) x = sign(1.0_wp, x)
    case default
      x = merge(1.0_wp, merge(0.0_wp, 0.5_wp, x < 0.0_wp), x > 0.0_wp)
    end select
  end subroutine of_one_plainly

  subroutine of_two_plainly(code, x, y, has)
    integer, intent(in) :: code
    real(wp), intent(inout) :: x
    real(wp), intent(in) :: y
    logical, intent(inout) :: has

    select case (code)
    case (add)
      x = x + y
    case (subtract)
      x = x - y
    case (multiply)
      x = x*y
    case (divide)
      has = abs(y) > 0.0_wp
      if (has) x = x/y
    case (power)
      has = x > 0.0_wp .or. (x >= 0.0_wp .and. y >= 0.0_wp)
      if (.not. has) return
      if (x > 0.0_wp) then
        x = exp(min(max(y*log(x), -far), far))
      else
        x = merge(0.0_wp, 1.0_wp, y > 0.0_wp)
      end if
    case (f_atan2)
      if (abs(x) > 0.0_wp .or. abs(y) > 0.0_wp) x = atan2(x, y)
    case (f_min)
      x = min(x, y)
    case (f_max)
      x = max(x, y)
    case (f_less)
      x = merge(1.0_wp, 0.0_wp, x < y)
    case (f_atmost)
      x = merge(1.0_wp, 0.0_wp, x <= y)
    case (f_more)
      x = merge(1.0_wp, 0.0_wp, x > y)
    case default
      x = merge(1.0_wp, 0.0_wp, x >= y)
    end select
  end subroutine of_two_plainly

  !> A random point of a range, often one of its ends, its middle or 0.
  real(wp) function place_in(range)
    real(wp), intent(in) :: range(2)
    select case (one_of(8))
    case (1)
      place_in = range(1)
    case (2)
      place_in = range(2)
    case (3)
      place_in = min(max(0.0_wp, range(1)), range(2))
    case default
      place_in = min(max(range(1) + (range(2) - range(1))*chance(), range(1)), range(2))
    end select
  end function place_in

  !> Random ranges of arguments and rates; some begin or end at integers, where kinks are.
  subroutine draw_box(width, box)
    real(wp), intent(in) :: width
    type(range_type), intent(out) :: box(:)
    real(wp) :: middle
    integer :: k

    do k = 1, size(box)
      middle = (2.0_wp*chance() - 1.0_wp)*10.0_wp**(3.0_wp*chance() - 1.5_wp)
      if (one_of(5) == 1) middle = anint(middle)
      box(k)%value = middle + width*[merge(0.0_wp, -chance(), one_of(4) == 1), &
                                     merge(0.0_wp, chance(), one_of(4) == 1)]
      middle = 4.0_wp*chance() - 2.0_wp
      box(k)%rate = middle + chance()*[-1.0_wp, 1.0_wp]
      box(k)%noise = epsilon(1.0_wp)*maxval(abs(box(k)%value))
    end do
  end subroutine draw_box

  !> A random law with at most this number of levels.
  subroutine draw_program(law, levels)
    type(law_program), intent(out) :: law
    integer, intent(in) :: levels
    law%n_arguments = n_arguments
    allocate (law%code(0), law%number(0))
    call draw_part(law, levels, .true.)
    call law%measure()
  end subroutine draw_program

  !> Append a random function and its arguments to the program.
  recursive subroutine draw_part(law, levels, whole)
    type(law_program), intent(inout) :: law
    integer, intent(in) :: levels
    !> A number or an argument alone is not allowed.
    logical, intent(in) :: whole
    integer :: code, i
    real(wp) :: number

    number = 0.0_wp
    if (levels == 0 .or. (.not. whole .and. one_of(4) == 1)) then
      code = put_argument
      number = one_of(n_arguments)
      if (one_of(4) == 1) then
        code = put_number
        number = real(one_of(41) - 21, wp)/merge(1, 8, one_of(2) == 1)
      end if
    else
      ! Sums, products and powers are as frequent as named functions.
      code = 2 + one_of(negate - 2)
      if (one_of(2) == 1) code = first_function - 1 + one_of(f_where - first_function + 1)
      if (code == known_power) then
        number = one_of(9) - 4
        if (one_of(3) == 1) number = number + 0.5_wp
      end if
      do i = 1, operands(code)
        call draw_part(law, levels - 1, .false.)
      end do
    end if
    law%code = [law%code, code]
    law%number = [law%number, number]
  end subroutine draw_part

  !> Check a property of a law; on failure print its instructions.
  subroutine report_to(holds, what, law)
    logical, intent(in) :: holds
    character(len=*), intent(in) :: what
    type(law_program), intent(in) :: law
    character(len=:), allocatable :: text
    character(len=24) :: one
    integer :: i

    if (holds) return
    text = what//' of'
    do i = 1, size(law%code)
      write (one, '(i0,a,g0.6)') law%code(i), ':', law%number(i)
      text = text//' '//trim(one)
    end do
    call check(.false., text)
  end subroutine report_to

end module test_law_bounds
