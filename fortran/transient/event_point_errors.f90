!> Error estimates of events: from another run with a different step size, and from the effect of
!! errors of states on their times.
!!
!! A function g of the state with error d crosses 0 later or earlier by d/|g'|, near grazing by
!! up to the square root of 2 d/|g''|: there it may not cross 0 at all.
module viscovib_event_point_errors
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_kinds, only: wp
  use viscovib_law_bounds, only: bounds_of, range_type
  use viscovib_law_functions, only: put_argument, wall
  use viscovib_law_program, only: law_program
  use viscovib_watch, only: n_event_rows, new_watch, watch_type
  implicit none
  private

  public :: event_point_errors

  !> Relative rounding error of the arguments of a function.
  real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp)
  !> Number of subsequent events that are compared, too: inside a step the difference of two
  !! polynomials may be small by chance at a single event.
  integer, parameter :: ahead = 2

contains

  !> Errors of the time of each event, and the largest error of its state; NaN if the other run
  !! has no such event although the errors of states do not explain this.
  subroutine event_point_errors(vector, own, other, times, apart, least, span, compared, errors)
    !> Functions, as in `new_watch`.
    real(wp), intent(in) :: vector(:)
    !> Events of this run and of the other, a column each: index of the function, time, state (2 n),
    !! accelerations (n), rate and bend of the function (`change_at`). Ascending for each function.
    real(wp), intent(in) :: own(:, :), other(:, :)
    !> Times, ascending, and differences of the states of the two runs there, a column each.
    real(wp), intent(in) :: times(:), apart(:, :)
    !> Smallest error of states; start and end of the shorter run.
    real(wp), intent(in) :: least, span(2)
    !> True if states at events of both runs can be compared.
    logical, intent(in) :: compared
    !> Shape (2, size(own, 2)).
    real(wp), intent(out) :: errors(:, :)
    type(watch_type) :: watch
    integer :: partner(size(own, 2)), i, n, next, seen
    real(wp) :: off(2*((size(own, 1) - n_event_rows)/3)), pace(size(off)), slack, late
    logical :: may_vanish, known

    call new_watch(watch, vector)
    n = size(off)/2
    call find_partners(own, other, n, partner)
    off = least
    next = 1
    seen = 0
    do i = 1, size(own, 2)
      associate (t => own(2, i), state => own(3:2*n + 2, i), rate => own(3*n + 3, i), &
                 bend => own(3*n + 4, i))
        do while (next <= size(times))
          if (next > 1) then
            if (times(next - 1) > t) exit
          end if
          off = max(off, apart(:, next))
          next = next + 1
        end do
        pace(1::2) = state(2::2)
        pace(2::2) = own(2*n + 3:3*n + 2, i)
        late = 0.0_wp
        if (partner(i) > 0) late = abs(t - other(2, partner(i)))
        do while (compared .and. seen < min(i + ahead, size(own, 2)))
          seen = seen + 1
          if (partner(seen) > 0) call compare(own(:, seen), other(:, partner(seen)), n, off)
        end do
        slack = slack_of(watch%signals(nint(own(1, i)))%program, t, state, off, bend)
        call time_error(slack, rate, bend, errors(1, i), may_vanish)
        known = errors(1, i) < wall
        if (known .and. partner(i) == 0 .and. .not. may_vanish) then
          known = t + 2.0_wp*errors(1, i) >= span(2) .or. t - 2.0_wp*errors(1, i) <= span(1)
          if (.not. known .and. is_of_pair(own, n, i)) then
            ! The other run does not reach 0 where this one crosses it twice.
            known = .true.
            errors(1, i) = abs(rate)/bend
          end if
        end if
        if (.not. known) then
          errors(:, i) = ieee_value(late, ieee_quiet_nan)
          cycle
        end if
        errors(1, i) = max(errors(1, i), late) + 2.0_wp*spacing(t)
        errors(2, i) = maxval(off + abs(pace)*errors(1, i))
      end associate
    end do
  end subroutine event_point_errors

  !> True if a function crosses 0 and returns according to its curvature, on either side of an
  !! extremum.
  pure logical function is_of_pair(own, n, i)
    real(wp), intent(in) :: own(:, :)
    integer, intent(in) :: n, i
    !> Distance of the other event, relative to that of this one from the extremum; ideally 2.
    real(wp), parameter :: across = 4.0_wp
    associate (rate => own(3*n + 3, i), bend => own(3*n + 4, i))
      is_of_pair = bend > 0.0_wp .and. count(nint(own(1, :)) == nint(own(1, i)) &
        .and. bend*abs(own(2, :) - own(2, i)) <= across*abs(rate)) > 1
    end associate
  end function is_of_pair

  !> The matching event of the other run, 0 if none. Both must be nearest to each other.
  pure subroutine find_partners(own, other, n, partner)
    real(wp), intent(in) :: own(:, :), other(:, :)
    integer, intent(in) :: n
    integer, intent(out) :: partner(:)
    integer :: nearest(size(own, 2)), back(size(other, 2)), i

    call find_nearest(own, other, nearest)
    call find_nearest(other, own, back)
    partner = 0
    do i = 1, size(own, 2)
      if (nearest(i) == 0) cycle
      if (back(nearest(i)) /= i) cycle
      ! A rising signal does not match a falling one.
      if (own(3*n + 3, i)*other(3*n + 3, nearest(i)) < 0.0_wp) cycle
      partner(i) = nearest(i)
    end do
  end subroutine find_partners

  !> The nearest event of the other run for the same function; 0 if there is none.
  pure subroutine find_nearest(one, other, nearest)
    real(wp), intent(in) :: one(:, :), other(:, :)
    integer, intent(out) :: nearest(:)
    integer :: places(size(other, 2)), which, i, k, n

    nearest = 0
    if (size(one, 2) == 0) return
    do which = nint(minval(one(1, :))), nint(maxval(one(1, :)))
      n = 0
      do i = 1, size(other, 2)
        if (nint(other(1, i)) /= which) cycle
        n = n + 1
        places(n) = i
      end do
      if (n == 0) cycle
      k = 1
      do i = 1, size(one, 2)
        if (nint(one(1, i)) /= which) cycle
        do while (k < n)
          if (abs(other(2, places(k + 1)) - one(2, i)) > abs(other(2, places(k)) - one(2, i))) exit
          k = k + 1
        end do
        nearest(i) = places(k)
      end do
    end do
  end subroutine find_nearest

  !> Update the differences of two states, corrected for the difference of their times.
  pure subroutine compare(one, other, n, off)
    real(wp), intent(in) :: one(:), other(:)
    integer, intent(in) :: n
    real(wp), intent(inout) :: off(:)
    real(wp) :: later, states(2*n), paces(2*n)
    later = other(2) - one(2)
    states = other(3:2*n + 2) - one(3:2*n + 2)
    paces(1::2) = one(4:2*n + 2:2) + other(4:2*n + 2:2)
    paces(2::2) = one(2*n + 3:3*n + 2) + other(2*n + 3:3*n + 2)
    off = max(off, abs(states - 0.5_wp*later*paces))
  end subroutine compare

  !> Error of a function from errors of a state and rounding; at a jump the largest argument error.
  pure real(wp) function slack_of(law, t, state, off, bend) result(slack)
    type(law_program), intent(in) :: law
    real(wp), intent(in) :: t, state(:), off(:), bend
    type(range_type) :: arguments(size(state) + 1), range
    logical :: is_read(size(arguments))
    integer :: i

    is_read = .false.
    do i = 1, size(law%code)
      if (law%code(i) == put_argument) is_read(nint(law%number(i))) = .true.
    end do
    slack = maxval(off, mask=is_read(:size(off)))
    if (bend < 0.0_wp) return
    slack = 0.0_wp
    do i = 1, size(state)
      arguments(i)%value = state(i)
      arguments(i)%noise = rounding*abs(state(i))
    end do
    arguments(size(arguments))%value = t
    arguments(size(arguments))%noise = spacing(t)
    do i = 1, size(arguments)
      if (.not. is_read(i)) cycle
      arguments(i)%rate = 1.0_wp
      call bounds_of(law, arguments, range)
      if (i <= size(off)) slack = slack + maxval(abs(range%rate))*off(i)
      arguments(i)%rate = 0.0_wp
    end do
    slack = slack + range%noise
  end function slack_of

  !> Error of the zero of a function with the error `slack`.
  pure subroutine time_error(slack, rate, bend, error, may_vanish)
    real(wp), intent(in) :: slack, rate, bend
    real(wp), intent(out) :: error
    !> True if the function may not cross 0 at all.
    logical, intent(out) :: may_vanish
    real(wp) :: rest
    rest = rate**2 - 2.0_wp*max(bend, 0.0_wp)*slack
    may_vanish = rest <= 0.0_wp
    if (.not. may_vanish) then
      error = 2.0_wp*slack/(abs(rate) + sqrt(rest))
    else if (bend > 0.0_wp) then
      error = sqrt(2.0_wp*slack/bend)
    else
      ! It gives no information.
      may_vanish = .false.
      error = wall
    end if
  end subroutine time_error

end module viscovib_event_point_errors
