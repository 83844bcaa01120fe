!> The time of an event along the motion itself, near that of the polynomial of a step, for
!! functions that may be thin: their slope at one position does not predict the next.
module viscovib_event_time
  use viscovib_event_search, only: signal_along
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: watched_function
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: signal_in_step

  !> Numbers of corrections along the motion, of enlargements of the search, and of iterations;
  !! first radius of the search relative to the position, factor of enlargement, largest shift.
  integer, parameter :: n_moves = 3, n_reaches = 16, n_turns = 80
  real(wp), parameter :: first_reach = 8.0_wp*epsilon(1.0_wp), growth = 8.0_wp, furthest = 1.0e-3_wp
  !> Relative to a step: distance for the slope of its polynomial, largest correction by this slope;
  !! relative to a position: correction at convergence.
  real(wp), parameter :: closely = 1.0e-4_wp, nearly = 1.0e-6_wp, exactly = 1.0e-12_wp

  !> A signal along the motion in a step or in a part of a step, positive before the event.
  type, abstract :: signal_in_step
    class(watched_function), pointer :: signal => null()
    type(step_path), pointer :: path => null()
    !> Coordinates that the signal and the path receive; not allocated: all of them.
    integer, allocatable :: reads(:)
    !> The sign of the signal before; true if the path represents the motion.
    integer :: side = 1
    logical :: is_smooth = .true.
    !> True if the motion exists at the last position, and its state there.
    logical :: made = .true.
    real(wp), allocatable :: q(:), v(:)
  contains
    procedure(go_interface), deferred :: go
    procedure :: settle
    procedure, private :: value
    procedure, private :: settle_by_slope
  end type signal_in_step

  abstract interface
    !> Advance from the start of the step to a position x in [0, 1] of the path.
    subroutine go_interface(self, x)
      import :: signal_in_step, wp
      class(signal_in_step), intent(inout) :: self
      real(wp), intent(in) :: x
    end subroutine go_interface
  end interface

contains

  !> Position of an event of the motion itself, near the event of the polynomial of its step,
  !! and the state there. If it is not found, the position is unchanged.
  subroutine settle(self, place, found)
    class(signal_in_step), intent(inout) :: self
    real(wp), intent(inout) :: place
    logical, intent(out) :: found
    real(wp), dimension(1, size(self%path%q, 2)) :: here, rate, q, v
    real(wp) :: t(1), low, high, x, reach, ends(2)
    integer :: i

    self%made = .true.
    call self%settle_by_slope(place, found)
    if (found .or. .not. self%made) return
    call self%path%at([place], t, here, rate)
    ! The state of the polynomial is a state of the motion a little earlier or later.
    x = place
    do i = 1, n_moves
      call self%go(x)
      if (.not. self%made) exit
      call read_state(self, q, v)
      reach = sum((q - here)*v)/max(self%path%h*sum(v*v), tiny(1.0_wp))
      ! At rest this shift is meaningless.
      if (.not. abs(x - reach - place) <= furthest) exit
      x = min(max(x - reach, 0.0_wp), 1.0_wp)
    end do
    self%made = .true.
    reach = first_reach*max(x, first_reach)
    do i = 1, n_reaches
      low = max(x - reach, 0.0_wp)
      high = min(x + reach, 1.0_wp)
      ends = [self%value(low), self%value(high)]
      found = self%made .and. ends(1) >= 0.0_wp .and. ends(2) < 0.0_wp
      if (found) exit
      reach = growth*reach
    end do
    if (.not. found .and. self%made) call look_about_extremum(self, place, low, high, ends, found)
    if (.not. found) return
    call close_in(self, low, high, ends)
    place = high
    call self%go(high)
  end subroutine settle

  !> The same by Newton's method with the slope of the polynomial, if it is accurate enough.
  subroutine settle_by_slope(self, place, found)
    class(signal_in_step), intent(inout) :: self
    real(wp), intent(inout) :: place
    logical, intent(out) :: found
    real(wp) :: ends(2), g(2), x, off, before
    integer :: k

    found = .false.
    if (.not. self%is_smooth) return
    ends = min(max([place - closely, place + closely], 0.0_wp), 1.0_wp)
    call signal_along(self%signal, self%path, ends, g)
    g = self%side*g
    if (.not. g(2) < g(1)) return
    x = place
    before = nearly
    do k = 1, 4
      off = self%value(x)*(ends(2) - ends(1))/(g(1) - g(2))
      if (.not. (self%made .and. abs(off) <= before)) return
      found = abs(off) <= exactly
      x = min(max(x + off, 0.0_wp), 1.0_wp)
      if (found) then
        place = x
        call self%go(place)
        found = self%made
        return
      end if
      before = 1.0e-2_wp*abs(off)
    end do
  end subroutine settle_by_slope

  !> Near grazing the error of the polynomial may exceed the signal beyond 0: then its
  !! event is far from that of the method, but both are near the same extremum.
  subroutine look_about_extremum(along, place, low, high, ends, found)
    class(signal_in_step), intent(inout) :: along
    !> The event of the polynomial; bracket of the event of the method, and values at its ends.
    real(wp), intent(in) :: place
    real(wp), intent(inout) :: low, high, ends(2)
    logical, intent(out) :: found
    !> Distance of the samples that determine an extremum, relative to the step, its largest
    !! shift, number of refinements, and number of search steps for the other side.
    real(wp), parameter :: nearby = 1.0e-4_wp, widest = 0.1_wp
    integer, parameter :: n_takes = 3, n_looks = 8
    real(wp) :: s(3), centre, wide, move, reach, there
    integer :: k

    found = .false.
    centre = min(max(place, nearby), 1.0_wp - nearby)
    call signal_along(along%signal, along%path, centre + [-nearby, 0.0_wp, nearby], s)
    s = along%side*s
    wide = nearby
    do k = 1, n_takes
      if (.not. abs(s(1) - 2.0_wp*s(2) + s(3)) > 0.0_wp) return
      move = -0.5_wp*wide*(s(3) - s(1))/(s(1) - 2.0_wp*s(2) + s(3))
      if (.not. abs(move) <= widest) return
      centre = centre + move
      if (k == 1) wide = max(abs(move), first_reach)
      if (centre - wide <= 0.0_wp .or. centre + wide >= 1.0_wp) return
      s = [along%value(centre - wide), along%value(centre), along%value(centre + wide)]
      if (.not. along%made) return
    end do
    reach = merge(-wide, wide, s(2) < 0.0_wp)
    do k = 1, n_looks
      if (centre + reach <= 0.0_wp .or. centre + reach >= 1.0_wp) return
      there = along%value(centre + reach)
      low = centre + min(reach, 0.0_wp)
      high = centre + max(reach, 0.0_wp)
      ends = merge([there, s(2)], [s(2), there], reach < 0.0_wp)
      found = along%made .and. ends(1) >= 0.0_wp .and. ends(2) < 0.0_wp
      if (found .or. .not. along%made) return
      reach = 2.0_wp*reach
    end do
  end subroutine look_about_extremum

  !> Reduce the bracket of an event.
  subroutine close_in(along, low, high, ends)
    class(signal_in_step), intent(inout) :: along
    real(wp), intent(inout) :: low, high, ends(2)
    real(wp) :: x, g
    integer :: i, last

    last = 0
    do i = 1, n_turns
      x = low + (high - low)*(ends(1)/(ends(1) - ends(2)))
      ! If the signal is 0 at an end but for rounding, secants stay there.
      if (modulo(i, 3) == 0 .or. x <= low .or. x >= high) x = 0.5_wp*(low + high)
      if (high - low <= 2.0_wp*epsilon(1.0_wp)*high .or. x <= low .or. x >= high) exit
      g = along%value(x)
      if (g < 0.0_wp) then
        high = x
        ends(2) = g
        if (last == 2) ends(1) = 0.5_wp*ends(1)
        last = 2
      else
        low = x
        ends(1) = g
        if (last == 1) ends(2) = 0.5_wp*ends(2)
        last = 1
      end if
    end do
  end subroutine close_in

  !> The signal at a position.
  real(wp) function value(self, x)
    class(signal_in_step), intent(inout) :: self
    real(wp), intent(in) :: x
    real(wp), dimension(1, size(self%path%q, 2)) :: q, v
    real(wp) :: g(1)
    value = 0.0_wp
    call self%go(x)
    if (.not. self%made) return
    call read_state(self, q, v)
    call self%signal%at([self%path%start + x*self%path%h], q, v, g)
    value = self%side*g(1)
  end function value

  !> The part of the present state that the signal receives.
  pure subroutine read_state(self, q, v)
    class(signal_in_step), intent(in) :: self
    real(wp), intent(out) :: q(:, :), v(:, :)
    if (allocated(self%reads)) then
      q(1, :) = self%q(self%reads)
      v(1, :) = self%v(self%reads)
    else
      q(1, :) = self%q
      v(1, :) = self%v
    end if
  end subroutine read_state

end module viscovib_event_time
