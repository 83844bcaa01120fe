!> The time of a passage by steps of their own from the start of a step, of functions that may be
!! thin: their slope at one place says nothing of the next.
module viscovib_passage_time
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: watched_function
  use viscovib_step_path, only: step_path
  use viscovib_stepper, only: stepper_type
  implicit none
  private

  public :: settle_thin

  !> Moves along the motion to where its polynomial has the passage; the first reach about it, as a
  !! part of it, how often it grows and how much; parts of the reach at most.
  integer, parameter :: n_moves = 3, n_reaches = 16, n_turns = 80
  real(wp), parameter :: first_reach = 8.0_wp*epsilon(1.0_wp), growth = 8.0_wp, furthest = 1.0e-3_wp

contains

  !> The place at which the method itself has a passage, beside that of the polynomial of its step,
  !! and the state there. Where there is none, the place stays, and the state is that of the
  !! polynomial.
  subroutine settle_thin(start, system, signal, side, path, place, q, v)
    !> The method where the step begins.
    class(stepper_type), intent(in) :: start
    class(driven_system_type), intent(in) :: system
    class(watched_function), intent(in) :: signal
    !> The sign of the signal before.
    integer, intent(in) :: side
    type(step_path), intent(in) :: path
    real(wp), intent(inout) :: place
    real(wp), intent(out) :: q(:), v(:)
    real(wp) :: g(1), t(1), here(1, size(q)), rate(1, size(q)), first, low, high, x, reach
    real(wp) :: ends(2)
    logical :: made
    integer :: i, last

    call path%at([place], t, here, rate)
    first = place
    ! The state of the polynomial is one of the method a little earlier or later.
    x = place
    do i = 1, n_moves
      call go(x)
      if (.not. made) exit
      reach = sum((q - here(1, :))*v)/max(path%h*sum(v*v), tiny(1.0_wp))
      ! At rest it says nothing.
      if (.not. abs(x - reach - first) <= furthest) exit
      x = min(max(x - reach, 0.0_wp), 1.0_wp)
    end do
    made = .true.
    reach = first_reach*max(x, first_reach)
    do i = 1, n_reaches
      low = max(x - reach, 0.0_wp)
      high = min(x + reach, 1.0_wp)
      ends = [value(low), value(high)]
      if (made .and. ends(1) >= 0.0_wp .and. ends(2) < 0.0_wp) exit
      reach = growth*reach
    end do
    if (i > n_reaches .or. .not. made) then
      q = here(1, :)
      v = rate(1, :)
      return
    end if
    last = 0
    do i = 1, n_turns
      x = low + (high - low)*(ends(1)/(ends(1) - ends(2)))
      ! Where the signal is 0 at an end but for rounding, secants stay there.
      if (modulo(i, 3) == 0 .or. x <= low .or. x >= high) x = 0.5_wp*(low + high)
      if (high - low <= 2.0_wp*epsilon(1.0_wp)*high .or. x <= low .or. x >= high) exit
      g = value(x)
      if (g(1) < 0.0_wp) then
        high = x
        ends(2) = g(1)
        if (last == 2) ends(1) = 0.5_wp*ends(1)
        last = 2
      else
        low = x
        ends(1) = g(1)
        if (last == 1) ends(2) = 0.5_wp*ends(2)
        last = 1
      end if
    end do
    place = high
    call go(high)

  contains

    !> The state at a place.
    subroutine go(x)
      real(wp), intent(in) :: x
      if (x*path%h <= 4.0_wp*spacing(path%start)) then
        q = path%q(1, :)
        v = path%v(1, :)
        made = .true.
      else
        call start%look_ahead(system, x*path%h, q, v, made)
      end if
    end subroutine go

    !> The signal there, on its side above 0.
    real(wp) function value(x)
      real(wp), intent(in) :: x
      real(wp) :: g(1)
      value = 0.0_wp
      call go(x)
      if (.not. made) return
      call signal%at([path%start + x*path%h], reshape(q, [1, size(q)]), reshape(v, [1, size(v)]), g)
      value = side*g(1)
    end function value

  end subroutine settle_thin

end module viscovib_passage_time
