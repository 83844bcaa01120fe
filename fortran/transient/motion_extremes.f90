!> The smallest and largest displacements of a motion that can be evaluated at any time.
module viscovib_motion_extremes
  use viscovib_kinds, only: wp
  use viscovib_sorting, only: sort_reals
  implicit none
  private

  public :: find_extremes, timed_motion

  !> A motion at ascending times, a column each: coordinates and velocities alternately.
  type, abstract :: timed_motion
  contains
    procedure(states_interface), deferred :: states
  end type timed_motion

  abstract interface
    subroutine states_interface(self, t, states)
      import :: timed_motion, wp
      class(timed_motion), intent(in) :: self
      real(wp), intent(in) :: t(:)
      real(wp), allocatable, intent(out) :: states(:, :)
    end subroutine states_interface
  end interface

  !> Corrections of the times of extremes: an impact needs one bisection per bit.
  integer, parameter :: max_turns = 60
  !> Intervals of time below this part of it are rounding error.
  real(wp), parameter :: narrow = 4.0e-16_wp

contains

  !> Zeros of the velocities by the Illinois method, all at once, until the remaining change of a
  !! displacement is at most `tolerance` times its size.
  subroutine find_extremes(motion, times, tolerance, low, high)
    class(timed_motion), intent(in) :: motion
    real(wp), intent(in) :: times(:), tolerance
    !> For each coordinate, shape (n_dof).
    real(wp), allocatable, intent(out) :: low(:), high(:)
    real(wp), allocatable :: t(:), states(:, :), more(:), a(:), b(:), at_a(:), at_b(:)
    real(wp), allocatable :: between(:), found(:, :), here(:), speed(:), size_of(:)
    integer, allocatable :: which(:), last(:)
    logical, allocatable :: same(:), open(:)
    integer :: i, turn

    allocate (t, source=times)
    call motion%states(t, states)
    low = minval(states(1::2, :), 2)
    high = maxval(states(1::2, :), 2)
    t = t(:size(states, 2))
    call hidden_turns(t, states, more)
    if (size(more) > 0) then
      t = [t, more]
      call sort_reals(t)
      call motion%states(t, states)
      t = t(:size(states, 2))
    end if
    call find_turns(t, states, which, a, b, at_a, at_b)
    allocate (last(size(which)), source=0)
    do turn = 1, max_turns
      if (size(which) == 0) return
      between = a + (b - a)*at_a/(at_a - at_b)
      call in_any_order(motion, between, found)
      here = [(found(2*which(i) - 1, i), i=1, size(which))]
      speed = [(found(2*which(i), i), i=1, size(which))]
      do i = 1, size(which)
        low(which(i)) = min(low(which(i)), here(i))
        high(which(i)) = max(high(which(i)), here(i))
      end do
      same = speed*at_a > 0.0_wp
      where (same .and. last == 1) at_b = 0.5_wp*at_b
      where (.not. same .and. last == 2) at_a = 0.5_wp*at_a
      where (same)
        a = between
        at_a = speed
        last = 1
      else where
        b = between
        at_b = speed
        last = 2
      end where
      size_of = [(max(high(which(i)) - low(which(i)), abs(low(which(i))), abs(high(which(i)))), &
                  i=1, size(which))]
      open = abs(speed)*(b - a) > tolerance*size_of .and. b - a > narrow*abs(b)
      which = pack(which, open)
      last = pack(last, open)
      a = pack(a, open)
      b = pack(b, open)
      at_a = pack(at_a, open)
      at_b = pack(at_b, open)
    end do
  end subroutine find_extremes

  !> States at times in any order.
  subroutine in_any_order(motion, t, states)
    class(timed_motion), intent(in) :: motion
    real(wp), intent(in) :: t(:)
    real(wp), allocatable, intent(out) :: states(:, :)
    real(wp), allocatable :: ascending(:), found(:, :)
    integer :: i, k

    allocate (ascending, source=t)
    call sort_reals(ascending)
    call motion%states(ascending, found)
    allocate (states(size(found, 1), size(t)), source=0.0_wp)
    do i = 1, size(t)
      k = min(findloc(ascending >= t(i), .true., 1), size(found, 2))
      if (k > 0) states(:, i) = found(:, k)
    end do
  end subroutine in_any_order

  !> Intervals in which a velocity changes its sign, with the velocities at both ends.
  pure subroutine find_turns(t, states, which, a, b, at_a, at_b)
    real(wp), intent(in) :: t(:), states(:, :)
    integer, allocatable, intent(out) :: which(:)
    real(wp), allocatable, intent(out) :: a(:), b(:), at_a(:), at_b(:)
    integer :: d, i, n, pass

    do pass = 1, 2
      n = 0
      do i = 1, size(t) - 1
        do d = 1, size(states, 1)/2
          if (.not. states(2*d, i)*states(2*d, i + 1) < 0.0_wp) cycle
          n = n + 1
          if (pass == 1) cycle
          which(n) = d
          a(n) = t(i)
          b(n) = t(i + 1)
          at_a(n) = states(2*d, i)
          at_b(n) = states(2*d, i + 1)
        end do
      end do
      if (pass == 1) allocate (which(n), a(n), b(n), at_a(n), at_b(n))
    end do
  end subroutine find_turns

  !> Times at which Hermite's cubic between two states turns back and forth: two extremes that the
  !! signs of the velocities do not show.
  pure subroutine hidden_turns(t, states, times)
    real(wp), intent(in) :: t(:), states(:, :)
    real(wp), allocatable, intent(out) :: times(:)
    real(wp) :: h, slope, b, c, s, bottom
    real(wp) :: found(size(t)*size(states, 1)/2)
    integer :: d, i, n

    n = 0
    do i = 1, size(t) - 1
      h = t(i + 1) - t(i)
      do d = 1, size(states, 1)/2
        associate (v0 => states(2*d, i), v1 => states(2*d, i + 1))
          slope = (states(2*d - 1, i + 1) - states(2*d - 1, i))/h
          ! The velocity of the cubic over s in 0 to 1: v0 + b s + c s^2.
          b = 6.0_wp*slope - 4.0_wp*v0 - 2.0_wp*v1
          c = 3.0_wp*(v0 + v1) - 6.0_wp*slope
          if (.not. (abs(c) > 0.0_wp .and. v0*v1 > 0.0_wp)) cycle
          s = -b/(2.0_wp*c)
          bottom = v0 + 0.5_wp*b*s
          if (.not. (s > 0.0_wp .and. s < 1.0_wp .and. bottom*v0 < 0.0_wp)) cycle
          n = n + 1
          found(n) = t(i) + h*s
        end associate
      end do
    end do
    allocate (times, source=found(:n))
  end subroutine hidden_turns

end module viscovib_motion_extremes
