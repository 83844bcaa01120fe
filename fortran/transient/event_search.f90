!> Where a function of the state passes 0 inside a step, by the polynomial of the step.
!!
!! A passage is a change of sign between two of the places at which states are known, or between one
!! of them and an extremum that lies beyond 0: contacts near grazing are shorter than a step and
!! leave no trace at its ends.
module viscovib_event_search
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: watched_function
  use viscovib_law_functions, only: wall
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: first_passage, place_of_change, signal_along

  !> Parts in which an interval is searched where an extremum may lie beyond 0, and steps that
  !! find the extremum.
  integer, parameter :: n_parts = 8, n_golden = 40
  real(wp), parameter :: golden = 0.6180339887498949_wp

  !> How far from a known place, as a part of an interval, its slope is looked at.
  real(wp), parameter :: beside = 1.0e-6_wp
  !> The part of the change in an interval that may lie there.
  real(wp), parameter :: smooth = 1.0e-3_wp
  !> Digits of a signal that differences of large numbers may lose.
  real(wp), parameter :: most_lost = 1.0e6_wp

contains

  !> The signal at places of a step.
  subroutine signal_along(signal, path, x, g)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    real(wp), intent(in) :: x(:)
    real(wp), intent(out) :: g(:)
    real(wp) :: t(size(x)), q(size(x), size(path%q, 2)), v(size(x), size(path%q, 2))
    call path%at(x, t, q, v)
    call signal%at(t, q, v, g)
  end subroutine signal_along

  !> The first place after `from` at which a signal leaves its side of 0.
  subroutine first_passage(signal, path, from, side, fresh, found, place)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    real(wp), intent(in) :: from
    !> 1 or -1, the sign at `from`; whether it has just come there from the other side.
    integer, intent(in) :: side
    logical, intent(in) :: fresh
    logical, intent(out) :: found
    real(wp), intent(out) :: place
    real(wp) :: x(size(path%points) + 1), g(size(path%points) + 1), low, high, change, slack
    integer :: j, n

    ! Places that hardly differ from the first one say nothing.
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
      ! What leaves a surface slowly is on either side of it by rounding for a while.
      slack = rounding_of(signal, path)
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
  end subroutine first_passage

  !> What rounding of states makes of a signal in a step.
  real(wp) function rounding_of(signal, path)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    !> What states are other by, relatively.
    real(wp), parameter :: other = 1.0_wp + 4.0_wp*epsilon(1.0_wp)
    real(wp), dimension(size(path%points)) :: times, g, moved
    times = path%start + path%h*path%points
    call signal%at(times, path%q, path%v, g)
    call signal%at(times, other*path%q, other*path%v, moved)
    rounding_of = maxval(abs(moved - g))
  end function rounding_of

  !> Of what begins on the surface, a place where it is on its side, if there is one before x.
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

  !> Whether a signal passes 0 between two places at which it has not.
  subroutine dip(signal, path, side, from, to, fresh, slack, found, low, high)
    class(watched_function), intent(in) :: signal
    type(step_path), intent(in) :: path
    integer, intent(in) :: side
    real(wp), intent(in) :: from, to
    logical, intent(in) :: fresh
    !> As far beyond 0 is no passage.
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
        ! Rounding where it begins is no passage.
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
      ! The extremum may be near a known node; seen from there the signal falls.
      ! Where it begins or ends on 0, rounding falls.
      if (k == 0 .and. fresh .or. g(k) <= lost(signal, path)) return
      at = [a, b] + [beside, -beside]*(b - a)
      call signal_along(signal, path, at, value)
      value = side*value
      i = merge(1, 2, k == 0)
      if (.not. value(i) < g(k)) return
      ! What changes as much there as in all of the interval is rounding.
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

  !> Rounding error of a signal in a step, by how much less states differ there than they
  !! are large.
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

  !> How many times as large numbers are as they differ; at most so many times as may matter.
  pure real(wp) function cancelled(x)
    real(wp), intent(in) :: x(:)
    real(wp) :: size_of, change
    size_of = maxval(abs(x))
    change = maxval(x) - minval(x)
    cancelled = 1.0_wp
    if (size_of > 0.0_wp) cancelled = min(most_lost, size_of/max(change, size_of/most_lost))
  end function cancelled

  !> The place of a change of sign: secants through both ends, that which stays counting half
  !! (Illinois), with bisection where they are slow.
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
      ! Where there is no value on one side, secants say nothing.
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
