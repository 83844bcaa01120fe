! Optimize: -O3
!> Zeros of a function of the state inside a step, by the polynomial of the step.
!!
!! A crossing is a change of sign between two points at which states are known, or between such a
!! point and an extremum beyond 0: contacts near grazing are shorter than a step and cause no
!! change of sign at its ends.
module viscovib_event_search
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: watched_function
  use viscovib_law_functions, only: wall
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: first_event_point, place_of_change, rounding_of, signal_along

  !> Parts in which an interval is searched where an extremum may be beyond 0, and iterations that
  !! find the extremum.
  integer, parameter :: n_parts = 8, n_golden = 40
  real(wp), parameter :: golden = 0.6180339887498949_wp

  !> Distance from a known point, as a part of an interval, at which the slope is checked.
  real(wp), parameter :: nearby = 1.0e-6_wp
  !> Largest part of the change in an interval that may occur within that distance.
  real(wp), parameter :: smooth = 1.0e-3_wp
  !> Largest factor of cancellation in differences of large numbers.
  real(wp), parameter :: most_lost = 1.0e6_wp

contains

  !> The signal at positions x of a step.
  subroutine signal_along(signal, path, x, g)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    real(wp), intent(in) :: x(:)
    real(wp), intent(out) :: g(:)
    real(wp) :: t(size(x)), q(size(x), size(path%q, 2)), v(size(x), size(path%q, 2))
    call path%at(x, t, q, v)
    call signal%at(t, q, v, g)
  end subroutine signal_along

  !> The first position after `from` at which a signal changes its sign.
  subroutine first_event_point(signal, path, from, side, fresh, found, place)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    real(wp), intent(in) :: from
    !> 1 or -1, the sign at `from`; whether the sign has just changed at `from`.
    integer, intent(in) :: side
    logical, intent(in) :: fresh
    logical, intent(out) :: found
    real(wp), intent(out) :: place
    real(wp) :: x(size(path%points) + 1), g(size(path%points) + 1), low, high, change, slack
    integer :: j, n

    ! Points that hardly differ from the first one give no information.
    n = count(path%points > from + 1.0e-9_wp*(1.0_wp - from)) + 1
    x(1) = from
    x(2:n) = path%points(size(path%points) - n + 2:)
    if (from > 0.0_wp) then
      call signal_along(signal, path, x(:n), g(:n))
    else
      call signal%at(path%start + path%h*x(:n), path%q, path%v, g(:n))
    end if
    g(:n) = side*g(:n)
    found = .false.
    place = from
    slack = 0.0_wp
    if (fresh) then
      ! A signal that leaves a surface slowly has rounding errors of either sign at first.
      slack = max(rounding_of(signal, path), -g(1))
      g(1) = max(g(1), 0.0_wp)
      where (g(2:n) < 0.0_wp .and. g(2:n) >= -slack) g(2:n) = 0.0_wp
    end if
    do j = 2, n
      if (g(j) < 0.0_wp) then
        found = .true.
        low = x(j - 1)
        if (fresh .and. j == 2) call leave_start(signal, path, side, from, x(2), low)
        if (g(1) < 0.0_wp .and. j == 2) return
        high = x(j)
        exit
      end if
      change = maxval(abs(g(max(j - 1, 2):min(j + 1, n)) - g(max(j - 2, 1):min(j, n - 1))))
      if (min(g(j - 1), g(j)) > change) cycle
      call dip(signal, path, side, x(j - 1), x(j), fresh .and. j == 2, slack, found, low, high)
      if (found) exit
    end do
    if (found) place = place_of_change(signal, path, side, low, high)
  end subroutine first_event_point

  !> Change of a signal in a step due to rounding of the states and forces. Modes carry the rounding
  !! errors of the largest coordinates to all others.
  real(wp) function rounding_of(signal, path)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    !> Perturbation relative to the largest of the states; polynomials between them amplify it.
    real(wp), parameter :: part = 16.0_wp*epsilon(1.0_wp)
    real(wp), dimension(size(path%points)) :: times, g, moved
    real(wp), dimension(size(path%q, 1), size(path%q, 2)) :: q, v
    integer :: d
    times = path%start + path%h*path%points
    do d = 1, size(q, 2)
      ! Generic factors, so that differences change too.
      q(:, d) = path%q(:, d) + part*sin(1.7_wp + 2.3_wp*d)*maxval(abs(path%q))
      v(:, d) = path%v(:, d) + part*sin(2.9_wp + 1.3_wp*d)*(maxval(abs(path%v)) + path%cancelled)
    end do
    call signal%at(times, path%q, path%v, g)
    call signal%at(times, q, v, moved)
    rounding_of = maxval(abs(moved - g))
  end function rounding_of

  !> For a signal that starts on the surface: a position before x with the right sign, if any.
  subroutine leave_start(signal, path, side, from, x, low)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    integer, intent(in) :: side
    real(wp), intent(in) :: from, x
    real(wp), intent(out) :: low
    real(wp) :: g(1)
    integer :: i
    do i = 1, 20
      low = from + (x - from)*0.5_wp**i
      call signal_along(signal, path, [low], g)
      if (side*g(1) > 0.0_wp) return
    end do
    low = from
  end subroutine leave_start

  !> True if a signal passes 0 between two points at which it has not changed sign.
  subroutine dip(signal, path, side, from, to, fresh, slack, found, low, high)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    integer, intent(in) :: side
    real(wp), intent(in) :: from, to
    logical, intent(in) :: fresh
    !> Values beyond 0 by up to this amount are no crossing.
    real(wp), intent(in) :: slack
    logical, intent(out) :: found
    real(wp), intent(out) :: low, high
    real(wp) :: x(0:n_parts), g(0:n_parts), a, b, at(2), value(2)
    integer :: i, k

    x = [(from + (to - from)*(real(i, wp)/n_parts), i=0, n_parts)]
    call signal_along(signal, path, x, g)
    g = side*g
    if (fresh) g(0) = 0.0_wp
    found = .true.
    do i = 1, n_parts
      if (g(i) >= -slack) cycle
      low = x(i - 1)
      high = x(i)
      if (fresh .and. i == 1) then
        call leave_start(signal, path, side, from, x(1), low)
        ! Rounding at the start is no crossing.
        if (low <= from) cycle
      end if
      return
    end do
    k = minloc(g, 1) - 1
    found = .false.
    low = from
    high = to
    a = x(max(k - 1, 0))
    b = x(min(k + 1, n_parts))
    if (k == 0 .or. k == n_parts) then
      ! The extremum may be near a known node if the signal falls from there.
      ! At a start or end on 0 rounding makes it fall.
      if (k == 0 .and. fresh .or. g(k) <= lost(signal, path)) return
      at = [a, b] + [nearby, -nearby]*(b - a)
      call signal_along(signal, path, at, value)
      value = side*value
      i = merge(1, 2, k == 0)
      if (.not. value(i) < g(k)) return
      ! As large a change next to the node as in the whole interval is rounding.
      if (g(k) - value(i) > smooth*(maxval(g) - g(k))) return
    end if
    do i = 1, n_golden
      at = [b - golden*(b - a), a + golden*(b - a)]
      call signal_along(signal, path, at, value)
      value = side*value
      k = minloc(value, 1)
      if (value(k) < -slack) then
        found = .true.
        low = a
        high = at(k)
        return
      end if
      if (k == 1) then
        b = at(2)
      else
        a = at(1)
      end if
    end do
  end subroutine dip

  !> Rounding error of a signal in a step, from the cancellation in differences of states.
  real(wp) function lost(signal, path)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    real(wp) :: g(size(path%points)), times(size(path%points)), digits
    integer :: d

    times = path%start + path%h*path%points
    call signal%at(times, path%q, path%v, g)
    digits = 1.0_wp
    do d = 1, size(path%q, 2)
      digits = max(digits, cancelled(path%q(:, d)), cancelled(path%v(:, d)))
    end do
    lost = 8.0_wp*epsilon(1.0_wp)*max(maxval(abs(g)), digits*(maxval(g) - minval(g)))
  end function lost

  !> Ratio of the size of numbers to their differences; at most `most_lost`.
  pure real(wp) function cancelled(x)
    real(wp), intent(in) :: x(:)
    real(wp) :: size_of, change
    size_of = maxval(abs(x))
    change = maxval(x) - minval(x)
    cancelled = 1.0_wp
    if (size_of > 0.0_wp) cancelled = min(most_lost, size_of/max(change, size_of/most_lost))
  end function cancelled

  !> Position of a change of sign: secants with the Illinois modification (the end that stays counts
  !! half), and bisection where they converge slowly.
  real(wp) function place_of_change(signal, path, side, from, to) result(x)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    integer, intent(in) :: side
    real(wp), intent(in) :: from, to
    real(wp) :: low, high, ends(2), g(1), width
    logical :: edge
    integer :: i, last

    low = from
    high = to
    call signal_along(signal, path, [low, high], ends)
    ends = side*ends
    last = 0
    width = high - low
    do i = 1, 100
      ! Secants are useless if the signal has no value on one side.
      edge = maxval(abs(ends)) >= wall
      if (edge .or. mod(i, 4) == 0 .and. high - low > 0.25_wp*width &
          .or. ends(1) - ends(2) <= 0.0_wp) then
        x = 0.5_wp*(low + high)
        width = high - low
      else
        x = low + (high - low)*(max(ends(1), 0.0_wp)/(ends(1) - ends(2)))
      end if
      x = min(max(x, low), high)
      if (high - low <= 2.0_wp*epsilon(1.0_wp)) exit
      call signal_along(signal, path, [x], g)
      g = side*g
      if (g(1) < 0.0_wp) then
        high = x
        ends(2) = g(1)
        if (last == 2 .and. .not. edge) ends(1) = 0.5_wp*ends(1)
        last = 2
      else
        if (x <= low .and. i > 1 .and. last == 1 .and. .not. edge) exit
        low = x
        ends(1) = g(1)
        if (last == 1 .and. .not. edge) ends(2) = 0.5_wp*ends(2)
        last = 1
        if (.not. g(1) > 0.0_wp) exit
      end if
    end do
  end function place_of_change

end module viscovib_event_search
