! Optimize: -O3 -fstack-arrays
!> Shock response of oscillators to a base acceleration that is linear between its samples.
!!
!! An oscillator of natural circular frequency w and damping ratio z on a base of acceleration a:
!!
!!     x'' + 2 z w x' + w^2 x = -a,   absolute acceleration  A = -(2 z w x' + w^2 x)
!!
!! with the displacement x relative to the base. In the time theta = w t the quantities X = w^2 x
!! and V = w x' are accelerations. Between two samples the equation has a solution in closed form
!! (the ramp-invariant method of ISO 18431-4), so that the error is rounding error.
!!
!! Both quantities are a straight line and a decaying oscillation. Their second derivative is a
!! decaying oscillation alone: its zeros are known, and between them the first derivative is
!! monotonic, so that every extreme between samples is found.
module viscovib_shock_response
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_stopping, only: stop_wanted
  implicit none
  private

  public :: shock_response

  !> Quantities: X and A.
  integer, parameter, public :: relative_displacement = 1, absolute_acceleration = 2
  !> Oscillators that are computed together.
  integer, parameter :: lanes = 16
  !> Taylor coefficients of the response to a ramp: to rounding for theta <= 1.
  integer, parameter :: last_term = 20
  !> Largest theta of a step for which many steps are examined at once.
  real(wp), parameter :: short = 2.0_wp
  !> Terms of the series of an extreme between samples, for theta up to 0.7 and up to 2; steps of
  !! Newton's method.
  integer, parameter :: few_terms = 11, many_terms = 16, newton_steps = 3
  !> How often a quantity may turn in a step.
  real(wp), parameter :: never = 0.0_wp, once = 1.0_wp, maybe_twice = 2.0_wp

  type :: oscillator
    real(wp) :: z = 0.0_wp, root = 1.0_wp, ramp(3:last_term) = 0.0_wp
  end type oscillator

  !> A step: (X, V) -> (x_x X + x_v V + x_a(1) a_0 + x_a(2) a_1,
  !! -x_v X + v_v V + v_a(1) a_0 + v_a(2) a_1).
  type :: step_map
    real(wp) :: theta = 0.0_wp, x_x = 1.0_wp, x_v = 0.0_wp, v_v = 1.0_wp, x_a(2) = 0.0_wp, &
      v_a(2) = 0.0_wp
  end type step_map

  !> A quantity q = of_x X + of_v X' and its derivatives: q' = of_bend X'' + of_rate X',
  !! q'' = curved X'' + straight (a' + X'), q''' = of_third X''' - straight q'', a' the slope.
  type :: quantity_factors
    real(wp) :: of_x = 1.0_wp, of_v = 0.0_wp, of_bend = 0.0_wp, of_rate = 1.0_wp, &
      curved = 1.0_wp, straight = 0.0_wp, of_third = 1.0_wp
  end type quantity_factors

  !> Steps of `lanes` oscillators side by side, as `step_map`.
  type :: lane_maps
    !> Number of oscillators; the last one is repeated.
    integer :: n = 0
    real(wp), dimension(lanes) :: theta, x_x, x_v, v_v
    real(wp), dimension(lanes, 2) :: x_a, v_a
  end type lane_maps

  !> Largest and smallest values found so far, and the steps that contain them: (X, V) at the begin
  !! and the accelerations of the base at both ends, shape (4, 2, lanes).
  type :: peak_steps
    real(wp) :: top(lanes) = 0.0_wp, bottom(lanes) = 0.0_wp, steps(4, 2, lanes) = 0.0_wp
  end type peak_steps

contains

  !> Extremes of a quantity of oscillators at rest at the first sample of a record.
  subroutine shock_response(record, steps, omega, z, quantity, extremes)
    !> Acceleration of the base, shape (n), n >= 2, and the times between samples: one, or (n - 1).
    real(wp), intent(in) :: record(:), steps(:)
    !> Circular frequencies, shape (m), and the damping ratio of all oscillators, 0 <= z < 1.
    real(wp), intent(in) :: omega(:), z
    integer, intent(in) :: quantity
    !> Largest and smallest value up to the last sample, and after it, shape (4, m).
    real(wp), intent(out) :: extremes(4, size(omega))
    type(oscillator) :: own
    type(step_map) :: map
    real(wp) :: state(2)
    integer :: i, j

    own = new_oscillator(z)
    extremes = 0.0_wp
    j = 1
    do while (j <= size(omega))
      if (stop_wanted()) return
      if (size(steps) == 1 .and. omega(j)*steps(1) <= short) then
        i = j
        do while (j < size(omega) .and. j < i + lanes - 1)
          if (omega(j + 1)*steps(1) > short) exit
          j = j + 1
        end do
        call respond_together(own, record, omega(i:j)*steps(1), quantity, extremes(:, i:j))
      else
        state = 0.0_wp
        do i = 1, size(record) - 1
          if (i <= size(steps)) map = new_step(own, omega(j)*steps(i))
          call take_step(own, map, record(i:i + 1), quantity, state, extremes(:2, j))
        end do
        call ring_out(own, state, quantity, extremes(3:, j))
      end if
      j = j + 1
    end do
  end subroutine shock_response

  pure type(oscillator) function new_oscillator(z) result(own)
    real(wp), intent(in) :: z
    integer :: k
    own%z = z
    own%root = sqrt((1.0_wp - z)*(1.0_wp + z))
    own%ramp(3) = 1.0_wp/6.0_wp
    own%ramp(4) = -2.0_wp*z*own%ramp(3)/4.0_wp
    do k = 5, last_term
      own%ramp(k) = -(2.0_wp*z*(k - 1)*own%ramp(k - 1) + own%ramp(k - 2))/(k*(k - 1.0_wp))
    end do
  end function new_oscillator

  !> Responses from rest to the unit ramp, step and impulse (each the derivative of the last).
  pure subroutine relax(own, theta, ramp, step, impulse)
    type(oscillator), intent(in) :: own
    real(wp), intent(in) :: theta
    real(wp), intent(out) :: ramp, step, impulse
    real(wp) :: decay, sine, cosine
    integer :: k

    if (theta <= 1.0_wp) then
      ramp = own%ramp(last_term)
      step = last_term*ramp
      impulse = (last_term - 1)*step
      do k = last_term - 1, 3, -1
        ramp = ramp*theta + own%ramp(k)
        step = step*theta + k*own%ramp(k)
        impulse = impulse*theta + k*(k - 1)*own%ramp(k)
      end do
      impulse = impulse*theta
      step = step*theta**2
      ramp = ramp*theta**3
    else
      decay = exp(-own%z*theta)
      sine = sin(own%root*theta)/own%root
      cosine = cos(own%root*theta)
      impulse = decay*sine
      step = 1.0_wp - decay*(cosine + own%z*sine)
      ramp = theta - 2.0_wp*own%z*step - impulse
    end if
  end subroutine relax

  pure type(step_map) function new_step(own, theta) result(map)
    type(oscillator), intent(in) :: own
    real(wp), intent(in) :: theta
    real(wp) :: ramp, step, impulse
    call relax(own, theta, ramp, step, impulse)
    map%theta = theta
    map%x_x = 1.0_wp - step
    map%x_v = impulse
    map%v_v = map%x_x - 2.0_wp*own%z*impulse
    map%x_a = [ramp/theta - step, -ramp/theta]
    map%v_a = [step/theta - impulse, -step/theta]
  end function new_step

  !> A quantity and its first three derivatives by theta, from the state (X, V), the acceleration a
  !! of the base and its slope.
  pure function derivatives(z, quantity, state, a, slope) result(q)
    real(wp), intent(in) :: z, state(2), a, slope
    integer, intent(in) :: quantity
    real(wp) :: q(0:3)
    q(0) = state(1)
    q(1) = state(2)
    q(2) = -(a + 2.0_wp*z*q(1) + q(0))
    q(3) = -(slope + 2.0_wp*z*q(2) + q(1))
    if (quantity == relative_displacement) return
    q(0:2) = -(2.0_wp*z*q(1:3) + q(0:2))
    q(3) = -(2.0_wp*z*q(2) + q(3))
  end function derivatives

  pure type(quantity_factors) function new_factors(quantity, z) result(f)
    integer, intent(in) :: quantity
    real(wp), intent(in) :: z
    if (quantity == absolute_acceleration) then
      f = quantity_factors(-1.0_wp, -2.0_wp*z, -2.0_wp*z, -1.0_wp, 4.0_wp*z**2 - 1.0_wp, 2.0_wp*z, &
                           -1.0_wp)
    end if
  end function new_factors

  !> Go one step on, and widen the range of a quantity by what it reaches.
  pure subroutine take_step(own, map, a, quantity, state, range)
    type(oscillator), intent(in) :: own
    type(step_map), intent(in) :: map
    !> At the begin and at the end of the step.
    real(wp), intent(in) :: a(2)
    integer, intent(in) :: quantity
    real(wp), intent(inout) :: state(2), range(2)
    real(wp) :: q(0:3), after(2), late(2), slope, size, reach, at_end, period
    type(step_map) :: most

    slope = (a(2) - a(1))/map%theta
    q = derivatives(own%z, quantity, state, a(1), slope)
    after = moved(map, state, a)
    at_end = after(1)
    if (quantity == absolute_acceleration) at_end = -(2.0_wp*own%z*after(2) + after(1))
    ! The second derivative is never larger than this, and the oscillation neither.
    size = hypot(q(2), (own%z*q(2) + q(3))/own%root)
    reach = min(map%theta**2/8.0_wp, 2.0_wp)*size
    range(1) = max(range(1), at_end)
    range(2) = min(range(2), at_end)
    if (abs(q(1)) <= map%theta*size .and. (max(q(0), at_end) + reach > range(1) &
                                           .or. min(q(0), at_end) - reach < range(2))) then
      period = 2.0_wp*pi/own%root
      call turn_within(own, q, min(map%theta, period), range)
      if (map%theta > period) then
        ! The extremes of a long step are in its first or in its last period.
        most = new_step(own, max(map%theta - period, tiny(period)))
        late = moved(most, state, [a(1), a(1) + slope*most%theta])
        q = derivatives(own%z, quantity, late, a(1) + slope*most%theta, slope)
        call turn_within(own, q, period, range)
      end if
    end if
    state = after
  end subroutine take_step

  pure function moved(map, state, a) result(after)
    type(step_map), intent(in) :: map
    real(wp), intent(in) :: state(2), a(2)
    real(wp) :: after(2)
    after(1) = map%x_x*state(1) + map%x_v*state(2) + dot_product(map%x_a, a)
    after(2) = map%v_v*state(2) - map%x_v*state(1) + dot_product(map%v_a, a)
  end function moved

  !> Free vibration after the record.
  pure subroutine ring_out(own, state, quantity, range)
    type(oscillator), intent(in) :: own
    real(wp), intent(in) :: state(2)
    integer, intent(in) :: quantity
    real(wp), intent(inout) :: range(2)
    real(wp) :: q(0:3)
    q = derivatives(own%z, quantity, state, 0.0_wp, 0.0_wp)
    range = [max(range(1), q(0)), min(range(2), q(0))]
    call turn_within(own, q, 2.0_wp*pi/own%root, range)
  end subroutine ring_out

  !> Widen a range by the extremes inside of a time theta, at most a period.
  pure subroutine turn_within(own, q, theta, range)
    type(oscillator), intent(in) :: own
    !> A quantity and its derivatives at the begin.
    real(wp), intent(in) :: q(0:3), theta
    real(wp), intent(inout) :: range(2)
    real(wp) :: begin, end, slope_begin, slope_end, value, half
    logical :: ends

    half = pi/own%root
    ! The second derivative is proportional to q(2) cos + (z q(2) + q(3))/root sin of root theta.
    end = modulo(atan2(-q(2), (own%z*q(2) + q(3))/own%root), pi)/own%root
    begin = 0.0_wp
    slope_begin = q(1)
    do
      ends = end >= theta
      if (ends) end = theta
      slope_end = slope_at(end)
      if (slope_begin*slope_end < 0.0_wp) then
        value = value_at(root_between(begin, end, slope_begin, slope_end))
        range = [max(range(1), value), min(range(2), value)]
      end if
      if (ends) exit
      begin = end
      slope_begin = slope_end
      end = end + half
    end do

  contains

    pure real(wp) function slope_at(at)
      real(wp), intent(in) :: at
      real(wp) :: ramp, step, impulse
      call relax(own, at, ramp, step, impulse)
      slope_at = q(1) + q(2)*(impulse + 2.0_wp*own%z*step) + q(3)*step
    end function slope_at

    pure real(wp) function value_at(at)
      real(wp), intent(in) :: at
      real(wp) :: ramp, step, impulse
      call relax(own, at, ramp, step, impulse)
      value_at = q(0) + q(1)*at + q(2)*(step + 2.0_wp*own%z*ramp) + q(3)*ramp
    end function value_at

    !> The zero of the slope, which is monotonic: Newton's method within bounds.
    pure real(wp) function root_between(begin, end, slope_begin, slope_end) result(at)
      real(wp), intent(in) :: begin, end, slope_begin, slope_end
      real(wp) :: low, high, slope, bend, next, ramp, step, impulse
      integer :: k
      low = begin
      high = end
      at = begin + (end - begin)*(slope_begin/(slope_begin - slope_end))
      do k = 1, 60
        call relax(own, at, ramp, step, impulse)
        slope = q(1) + q(2)*(impulse + 2.0_wp*own%z*step) + q(3)*step
        bend = q(2)*(1.0_wp - step) + q(3)*impulse
        if ((slope > 0.0_wp) .eqv. (slope_begin > 0.0_wp)) then
          low = at
        else
          high = at
        end if
        next = 0.5_wp*(low + high)
        if (abs(slope) < abs(bend)*(end - begin)) then
          if (at - slope/bend > low .and. at - slope/bend < high) next = at - slope/bend
        end if
        slope = abs(next - at)
        at = next
        ! The value at an extreme changes by the square of this.
        if (slope <= 1.0e-8_wp*(end - begin)) exit
      end do
    end function root_between
  end subroutine turn_within

  !> Up to `lanes` oscillators on equal short steps: first their values at all samples. In the
  !! blocks of samples that may exceed these, the extremes between samples are estimated, and the
  !! steps with the largest and the smallest are kept. In these they are then computed to rounding.
  subroutine respond_together(own, record, theta, quantity, extremes)
    type(oscillator), intent(in) :: own
    real(wp), intent(in) :: record(:), theta(:)
    integer, intent(in) :: quantity
    real(wp), intent(inout) :: extremes(4, size(theta))
    type(lane_maps) :: maps
    type(peak_steps) :: kept
    ! At the begin of each block (X, V); of each block the largest and the smallest value, and how
    ! far it may go beyond these between samples.
    real(wp), allocatable :: states(:, :, :), ranges(:, :, :)
    real(wp) :: x(lanes), v(lanes), steepest
    integer :: block, first, past, n_blocks, k, l

    block = max(128, size(record)/4096)
    n_blocks = (size(record) - 2)/block + 1
    allocate (states(lanes, 2, n_blocks), ranges(lanes, 3, n_blocks))
    maps = new_lane_maps(own, theta)
    x = 0.0_wp
    v = 0.0_wp
    do k = 1, n_blocks
      first = (k - 1)*block + 1
      past = min(first + block, size(record))
      states(:, 1, k) = x
      states(:, 2, k) = v
      call march(maps, own%z, quantity, record(first:past), x, v, ranges(:, :, k))
      steepest = maxval(abs(record(first + 1:past) - record(first:past - 1)))
      ranges(:, 3, k) = reach_of(own%z, maps%theta, quantity, steepest, ranges(:, 3, k))
    end do
    kept%top = max(0.0_wp, maxval(ranges(:, 1, :), 2))
    kept%bottom = min(0.0_wp, minval(ranges(:, 2, :), 2))
    extremes(1, :) = kept%top(:size(theta))
    extremes(2, :) = kept%bottom(:size(theta))
    do k = 1, n_blocks
      if (.not. any(ranges(:, 1, k) + ranges(:, 3, k) > kept%top &
                    .or. ranges(:, 2, k) - ranges(:, 3, k) < kept%bottom)) cycle
      first = (k - 1)*block + 1
      call find_peaks(own, maps, quantity, record(first:min(first + block, size(record))), &
                      ranges(:, 3, k), states(:, 1, k), states(:, 2, k), kept)
    end do
    do l = 1, size(theta)
      do k = 1, 2
        associate (step => kept%steps(:, k, l))
          call turn_within(own, derivatives(own%z, quantity, step(:2), step(3), &
                                            (step(4) - step(3))/theta(l)), theta(l), &
                           extremes(:2, l))
        end associate
      end do
      call ring_out(own, [x(l), v(l)], quantity, extremes(3:, l))
    end do
  end subroutine respond_together

  type(lane_maps) function new_lane_maps(own, theta) result(maps)
    type(oscillator), intent(in) :: own
    !> At most `lanes` values.
    real(wp), intent(in) :: theta(:)
    type(step_map) :: map
    integer :: l
    maps%n = size(theta)
    do l = 1, lanes
      map = new_step(own, theta(min(l, size(theta))))
      maps%theta(l) = map%theta
      maps%x_x(l) = map%x_x
      maps%x_v(l) = map%x_v
      maps%v_v(l) = map%v_v
      maps%x_a(l, :) = map%x_a
      maps%v_a(l, :) = map%v_a
    end do
  end function new_lane_maps

  !> Oscillators along a block once more. In each step that may exceed the extremes found so far,
  !! the extreme between its samples is estimated to about 1e-12 of its largest second derivative.
  subroutine find_peaks(own, maps, quantity, record, reach, x, v, kept)
    type(oscillator), intent(in) :: own
    type(lane_maps), intent(in) :: maps
    integer, intent(in) :: quantity
    !> Samples of the block, and how far the quantity may go beyond its values at them.
    real(wp), intent(in) :: record(:), reach(lanes)
    !> The state at the begin of the block, later at its end.
    real(wp), intent(inout) :: x(lanes), v(lanes)
    type(peak_steps), intent(inout) :: kept
    ! At both ends of a step: the quantity, its first derivative and X''.
    real(wp), dimension(lanes) :: q_0, q_1, rate_0, rate_1, bend_0, bend_1, x_0, v_0, turns, high, &
      low
    real(wp) :: z, a, b, slope
    type(quantity_factors) :: f
    integer :: i, l, n

    z = own%z
    n = merge(few_terms, many_terms, all(maps%theta < 0.7_wp))
    f = new_factors(quantity, z)
    high = kept%top - reach
    low = kept%bottom + reach
    bend_1 = -(record(1) + 2.0_wp*z*v + x)
    q_1 = f%of_x*x + f%of_v*v
    rate_1 = f%of_bend*bend_1 + f%of_rate*v
    do i = 2, size(record)
      a = record(i - 1)
      b = record(i)
      do l = 1, lanes
        x_0(l) = x(l)
        v_0(l) = v(l)
        q_0(l) = q_1(l)
        rate_0(l) = rate_1(l)
        bend_0(l) = bend_1(l)
        x(l) = maps%x_x(l)*x_0(l) + maps%x_v(l)*v_0(l) + (maps%x_a(l, 1)*a + maps%x_a(l, 2)*b)
        v(l) = maps%v_v(l)*v_0(l) - maps%x_v(l)*x_0(l) + (maps%v_a(l, 1)*a + maps%v_a(l, 2)*b)
        bend_1(l) = -(b + 2.0_wp*z*v(l) + x(l))
        q_1(l) = f%of_x*x(l) + f%of_v*v(l)
        rate_1(l) = f%of_bend*bend_1(l) + f%of_rate*v(l)
        slope = (b - a)/maps%theta(l)
        turns(l) = merge(once, never, sign(1.0_wp, rate_0(l))*rate_1(l) < 0.0_wp)
        turns(l) = merge(maybe_twice, turns(l), &
                         sign(1.0_wp, f%curved*bend_0(l) + f%straight*(slope + v_0(l))) &
                         *(f%curved*bend_1(l) + f%straight*(slope + v(l))) < 0.0_wp)
        turns(l) = merge(turns(l), never, q_0(l) > high(l) .or. q_1(l) > high(l) &
                         .or. q_0(l) < low(l) .or. q_1(l) < low(l))
      end do
      if (.not. any(turns > never)) cycle
      call keep_peaks()
    end do

  contains

    !> Keep the steps that have a new extreme. It is found by a Taylor series about the end of the
    !! step with the smaller first derivative, since the second derivative y solves
    !! y'' + 2 z y' + y = 0.
    subroutine keep_peaks()
      real(wp) :: d(maps%n, 0:many_terms), t(maps%n), news(lanes), range(2), rate, bend, slope
      integer :: l

      do l = 1, maps%n
        slope = (b - a)/maps%theta(l)
        rate = merge(v_0(l), v(l), abs(rate_0(l)) <= abs(rate_1(l)))
        bend = merge(bend_0(l), bend_1(l), abs(rate_0(l)) <= abs(rate_1(l)))
        d(l, 0) = merge(q_0(l), q_1(l), abs(rate_0(l)) <= abs(rate_1(l)))
        d(l, 1) = merge(rate_0(l), rate_1(l), abs(rate_0(l)) <= abs(rate_1(l)))
        d(l, 2) = f%curved*bend + f%straight*(slope + rate)
        d(l, 3) = -f%of_third*(slope + 2.0_wp*z*bend + rate) - f%straight*d(l, 2)
      end do
      call turn_by_series(maps%n, n, z, maps%theta, d, t)
      do l = 1, maps%n
        news(l) = merge(turns(l), never, t(l) > kept%top(l) .or. t(l) < kept%bottom(l) &
                        .or. turns(l) > once)
      end do
      if (.not. any(news(:maps%n) > never)) return
      do l = 1, maps%n
        if (news(l) <= never) cycle
        range = [max(kept%top(l), t(l)), min(kept%bottom(l), t(l))]
        if (turns(l) > once) then
          ! The first derivative is not monotonic in the step.
          range = [kept%top(l), kept%bottom(l)]
          call turn_within(own, derivatives(z, quantity, [x_0(l), v_0(l)], a, &
                                            (b - a)/maps%theta(l)), maps%theta(l), range)
        end if
        if (range(1) > kept%top(l)) kept%steps(:, 1, l) = [x_0(l), v_0(l), a, b]
        if (range(2) < kept%bottom(l)) kept%steps(:, 2, l) = [x_0(l), v_0(l), a, b]
        kept%top(l) = range(1)
        kept%bottom(l) = range(2)
      end do
      high = kept%top - reach
      low = kept%bottom + reach
    end subroutine keep_peaks

  end subroutine find_peaks

  !> Values of m series sum_k d(:, k) t^k/k! where their first derivatives are zero.
  pure subroutine turn_by_series(m, n, z, theta, d, value)
    !> Number of series, and the last term of each; d(:, :3) is given.
    integer, intent(in) :: m, n
    !> Damping ratio, and the largest |t|.
    real(wp), intent(in) :: z, theta(m)
    real(wp), intent(inout) :: d(m, 0:many_terms)
    real(wp), intent(out) :: value(m)
    integer :: i
    real(wp), parameter :: part(many_terms) = [(1.0_wp/i, i=1, many_terms)]
    real(wp) :: t(m), slope(m), bend(m)
    integer :: k, l

    do k = 4, n
      d(:, k) = -(2.0_wp*z*d(:, k - 1) + d(:, k - 2))
    end do
    slope = d(:, 1)
    bend = d(:, 2)
    t = 0.0_wp
    do i = 1, newton_steps
      if (i > 1) then
        slope = d(:, n)
        bend = d(:, n)
        do k = n - 1, 2, -1
          do l = 1, m
            slope(l) = d(l, k) + slope(l)*t(l)*part(k)
            bend(l) = d(l, k) + bend(l)*t(l)*part(k - 1)
          end do
        end do
        slope = d(:, 1) + slope*t
      end if
      do l = 1, m
        t(l) = t(l) - slope(l)/merge(bend(l), 1.0_wp, abs(bend(l)) > 0.0_wp)
        t(l) = merge(t(l), sign(theta(l), t(l)), abs(t(l)) < theta(l))
      end do
    end do
    value = d(:, n)
    do k = n - 1, 0, -1
      value = d(:, k) + value*t*part(k + 1)
    end do
  end subroutine turn_by_series

  !> How far a quantity may go beyond the values at the ends of a step: theta^2/8 of its largest
  !! second derivative, which is at most a combination of those at the ends.
  elemental real(wp) function reach_of(z, theta, quantity, steepest, bend) result(reach)
    !> `steepest`: the largest difference of two samples; `bend`: the largest |X''| at the samples
    !! or, of the absolute acceleration, |X''| (1 + 2 z) + 2 z |V|.
    real(wp), intent(in) :: z, theta, steepest, bend
    integer, intent(in) :: quantity
    real(wp) :: between
    between = exp(z*theta)/cos(0.5_wp*theta)
    reach = theta**2/8.0_wp*between*bend
    if (quantity == absolute_acceleration) then
      reach = reach*(1.0_wp + 2.0_wp*z*theta) + theta*z*steepest/4.0_wp
    end if
  end function reach_of

  !> Oscillators side by side along a piece of a record; of the values at its samples, both ends
  !! included, the largest, the smallest and the largest bend.
  subroutine march(maps, z, quantity, record, x, v, range)
    type(lane_maps), intent(in) :: maps
    real(wp), intent(in) :: z, record(:)
    integer, intent(in) :: quantity
    real(wp), intent(inout) :: x(lanes), v(lanes)
    real(wp), intent(out) :: range(lanes, 3)
    real(wp) :: top(lanes), bottom(lanes), bend(lanes), a, b, next, q, curved, of_q, of_rate
    type(quantity_factors) :: f
    integer :: i, l

    f = new_factors(quantity, z)
    of_q = 1.0_wp
    of_rate = 0.0_wp
    if (quantity == absolute_acceleration) then
      of_q = 1.0_wp + 2.0_wp*z
      of_rate = 2.0_wp*z
    end if
    do l = 1, lanes
      q = f%of_x*x(l) + f%of_v*v(l)
      top(l) = q
      bottom(l) = q
      bend(l) = of_q*abs(record(1) + 2.0_wp*z*v(l) + x(l)) + of_rate*abs(v(l))
    end do
    do i = 2, size(record)
      a = record(i - 1)
      b = record(i)
      do l = 1, lanes
        next = maps%x_x(l)*x(l) + maps%x_v(l)*v(l) + (maps%x_a(l, 1)*a + maps%x_a(l, 2)*b)
        v(l) = maps%v_v(l)*v(l) - maps%x_v(l)*x(l) + (maps%v_a(l, 1)*a + maps%v_a(l, 2)*b)
        x(l) = next
        q = f%of_x*x(l) + f%of_v*v(l)
        top(l) = merge(q, top(l), q > top(l))
        bottom(l) = merge(q, bottom(l), q < bottom(l))
        curved = of_q*abs(b + 2.0_wp*z*v(l) + x(l)) + of_rate*abs(v(l))
        bend(l) = merge(curved, bend(l), curved > bend(l))
      end do
    end do
    range(:, 1) = top
    range(:, 2) = bottom
    range(:, 3) = bend
  end subroutine march

end module viscovib_shock_response
