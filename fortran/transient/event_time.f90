!> The time of an event by separate steps from the start of a step, for functions that may be
!! thin: their slope at one position does not predict the next.
module viscovib_event_time
  use viscovib_driven_system, only: driven_system_type
  use viscovib_event_search, only: signal_along
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: watched_function
  use viscovib_step_path, only: step_path
  use viscovib_stepper, only: stepper_type
  implicit none
  private

  public :: settle_thin

  !> Numbers of corrections along the motion, of enlargements of the search, and of iterations;
  !! first radius of the search relative to the position, factor of enlargement, largest shift.
  integer, parameter :: n_moves = 3, n_reaches = 16, n_turns = 80
  real(wp), parameter :: first_reach = 8.0_wp*epsilon(1.0_wp), growth = 8.0_wp, furthest = 1.0e-3_wp

  !> A signal along the motion that the method computes in a step, positive before the event.
  type :: signal_of_method
    !> The method at the start of the step.
    class(stepper_type), pointer :: start => null()
    class(driven_system_type), pointer :: system => null()
    class(watched_function), pointer :: signal => null()
    type(step_path), pointer :: path => null()
    integer :: side = 1
    !> True if the last step succeeded, and the state there.
    logical :: made = .true.
    real(wp), allocatable :: q(:), v(:)
  contains
    procedure :: go
    procedure :: value
  end type signal_of_method

contains

  !> Position of an event of the method itself, near the event of the polynomial of its step,
  !! and the state there. If there is none, the position is unchanged, and the state is that of the
  !! polynomial.
  subroutine settle_thin(start, system, signal, side, path, place, q, v)
    !> The method at the start of the step.
    class(stepper_type), intent(in), target :: start
    class(driven_system_type), intent(in), target :: system
    class(watched_function), intent(in), target :: signal
    !> The sign of the signal before.
    integer, intent(in) :: side
    type(step_path), intent(in), target :: path
    real(wp), intent(inout) :: place
    real(wp), intent(out) :: q(:), v(:)
    type(signal_of_method) :: along
    real(wp) :: t(1), here(1, size(q)), rate(1, size(q)), low, high, x, reach, ends(2)
    logical :: found
    integer :: i

    along%start => start
    along%system => system
    along%signal => signal
    along%path => path
    along%side = side
    along%q = q
    along%v = v
    call path%at([place], t, here, rate)
    ! The state of the polynomial is a state of the method a little earlier or later.
    x = place
    do i = 1, n_moves
      call along%go(x)
      if (.not. along%made) exit
      reach = sum((along%q - here(1, :))*along%v)/max(path%h*sum(along%v*along%v), tiny(1.0_wp))
      ! At rest this shift is meaningless.
      if (.not. abs(x - reach - place) <= furthest) exit
      x = min(max(x - reach, 0.0_wp), 1.0_wp)
    end do
    along%made = .true.
    found = .false.
    reach = first_reach*max(x, first_reach)
    do i = 1, n_reaches
      low = max(x - reach, 0.0_wp)
      high = min(x + reach, 1.0_wp)
      ends = [along%value(low), along%value(high)]
      found = along%made .and. ends(1) >= 0.0_wp .and. ends(2) < 0.0_wp
      if (found) exit
      reach = growth*reach
    end do
    if (.not. found .and. along%made) call look_about_extremum(along, place, low, high, ends, found)
    q = here(1, :)
    v = rate(1, :)
    if (.not. found) return
    call close_in(along, low, high, ends)
    place = high
    call along%go(high)
    q = along%q
    v = along%v
  end subroutine settle_thin

  !> Near grazing the error of the polynomial may exceed the signal beyond 0: then its
  !! event is far from that of the method, but both are near the same extremum.
  subroutine look_about_extremum(along, place, low, high, ends, found)
    type(signal_of_method), intent(inout) :: along
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
    type(signal_of_method), intent(inout) :: along
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

  !> Advance to a position.
  subroutine go(self, x)
    class(signal_of_method), intent(inout) :: self
    real(wp), intent(in) :: x
    if (x*self%path%h <= 4.0_wp*spacing(self%path%start)) then
      self%q = self%path%q(1, :)
      self%v = self%path%v(1, :)
      self%made = .true.
    else
      call self%start%look_ahead(self%system, x*self%path%h, self%q, self%v, self%made)
    end if
  end subroutine go

  !> The signal at a position.
  real(wp) function value(self, x)
    class(signal_of_method), intent(inout) :: self
    real(wp), intent(in) :: x
    real(wp) :: g(1)
    value = 0.0_wp
    call self%go(x)
    if (.not. self%made) return
    call self%signal%at([self%path%start + x*self%path%h], reshape(self%q, [1, size(self%q)]), &
                        reshape(self%v, [1, size(self%v)]), g)
    value = self%side*g(1)
  end function value

end module viscovib_event_time
