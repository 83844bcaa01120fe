! Optimize: -O3
!> Steps that end where the equations have a kink or a jump, with a search for events.
!!
!! Within a step the equations keep their side of each surface, so that the method integrates
!! a smooth right side. If the motion crosses a surface inside the step, the step is repeated
!! up to the surface, and continues with the other side: every part has the order of the method.
!! Near a rough surface, where a law such as max(d, 0)^1.5 is not smooth on its side either,
!! parts are no longer than their distance from it, each half or twice as long as
!! its neighbour, so that the polynomials converge in all of them at the same rate.
module viscovib_watched_step
  use viscovib_driven_system, only: driven_system_type
  use viscovib_event_search, only: first_event_point, rounding_of, signal_along
  use viscovib_event_time, only: signal_in_step
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: slides, watched_function
  use viscovib_law_layers, only: unseen
  use viscovib_nearby_motion, only: nearby_motion
  use viscovib_step_path, only: step_path
  use viscovib_stepper, only: stepper_type
  use viscovib_stops, only: in_range, needs_small_steps
  use viscovib_time_run, only: time_run
  use viscovib_wanted_states, only: keep_between
  use viscovib_watch, only: event_point_type
  implicit none
  private

  public :: watched_step_type, step_watched, begin_graded, begin_small, halve, sides_of

  !> A function of the state of the body, evaluated at states relative to its base.
  type, extends(watched_function) :: body_function
    class(driven_system_type), pointer :: system => null()
    class(watched_function), pointer :: signal => null()
  contains
    procedure :: at
  end type body_function

  !> Crossings in one step above which the motion counts as sticking to surfaces, and corrections of
  !! the time of a crossing by separate steps.
  integer, parameter :: most_event_points = 1000, most_corrections = 60
  !> Largest number of halvings of the parts of a step, and the shortest part relative to the
  !! remainder of the step.
  integer, parameter :: most_halvings = 200
  real(wp), parameter :: shortest = 1.0e-6_wp
  !> Allowed error of the part next to a rough surface: under a force x^p the error is the length
  !! of the part to the power of 2 + p, under a force v^p of a steep law 1 + p.
  real(wp), parameter :: left_there = 1.0e-17_wp, left_of_steep = 1.0e-14_wp
  !> Largest correction of the position of an event, as a part of the step.
  real(wp), parameter :: furthest = 0.1_wp

  !> A signal along the motion that the method computes in a step.
  type, extends(signal_in_step) :: signal_of_method
    !> The method at the start of the step.
    class(stepper_type), pointer :: start => null()
    class(driven_system_type), pointer :: system => null()
  contains
    procedure :: go
  end type signal_of_method

  !> A surface of a system in its present state: its signal, or the end of sliding on it.
  type, extends(watched_function) :: surface_type
    class(driven_system_type), pointer :: system => null()
    integer :: which = 0
  contains
    procedure :: at => surface_at
  end type surface_type

  !> A step in progress.
  type :: watched_step_type
    !> Start of the present part, and end of the step.
    real(wp) :: from = 0.0_wp, until = 0.0_wp
    !> State at the start of the present part.
    real(wp), allocatable :: q(:), v(:)
    !> Sides of the surfaces of the system, or `slides`; true if the motion has just left a surface.
    integer, allocatable :: sides(:)
    logical, allocatable :: fresh(:)
    !> True if the last part succeeded; true if an event ends the run.
    logical :: made = .false., ended = .false.
    !> The part succeeded, but is so near to the edge of the physical range that only small steps
    !! follow the motion. No events of it are stored.
    logical :: near_edge = .false.
    !> The motion stays on a surface, as in sticking dry friction: no part leads further.
    logical :: stuck = .false.
    !> Number of crossings in this step.
    integer :: n_passed = 0
    !> Number of halvings of parts; true if the present part ends before the step does.
    integer :: n_halved = 0
    logical :: short = .false.
    !> True if a part was shortened near a rough surface; largest length of the next part (0: any).
    logical :: graded = .false.
    real(wp) :: grade = 0.0_wp
    real(wp), allocatable :: memory(:)
    type(step_path) :: path
    !> Small perturbations; not allocated if not requested.
    type(nearby_motion), allocatable :: nearby
  end type watched_step_type

contains

  !> Values of the signal of a surface at states.
  subroutine surface_at(self, t, q, v, g)
    class(surface_type), intent(in) :: self
    real(wp), intent(in) :: t(:), q(:, :), v(:, :)
    real(wp), intent(out) :: g(:)
    call self%system%signal_at(self%which, t, q, v, g)
  end subroutine surface_at

  !> Sign of the signal for a side of a surface.
  integer function sign_of(side)
    integer, intent(in) :: side
    sign_of = merge(1, side, side == slides)
  end function sign_of

  !> Sides of the surfaces at a state.
  function sides_of(system, t, q, v) result(sides)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t, q(:), v(:)
    integer, allocatable :: sides(:)
    real(wp) :: g(1)
    integer :: i
    allocate (sides(0))
    if (.not. allocated(system%signals)) return
    do i = 1, size(system%signals)
      call system%signal_at(i, [t], reshape(q, [1, size(q)]), reshape(v, [1, size(v)]), g)
      sides = [sides, merge(1, -1, g(1) >= 0.0_wp)]
    end do
  end function sides_of

  !> The next part of a step: up to its end, or to the first crossing. `more` is true before the
  !! end of the step. On entry the method is at the start of the part and its step is the remainder.
  subroutine step_watched(at, method, system, run, more)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout), target :: system
    class(time_run), intent(inout), target :: run
    logical, intent(out) :: more
    type(surface_type) :: surface
    real(wp) :: place, length
    integer :: which
    logical :: passes

    more = .false.
    at%q = method%q
    at%v = method%v
    at%memory = method%save_memory()
    call follow_steep(at, system)
    if (at%grade > 0.0_wp .and. at%grade < method%h) call shorten(at, method, system, at%grade)
    if (system%timed) method%since = at%from - system%present_piece(1)
    call method%step(system, at%made)
    if (at%made) at%made = in_range(system, method%q, method%v)
    if (.not. at%made) return
    at%near_edge = system%limited
    if (system%limited) then
      at%near_edge = needs_small_steps(system, 1, at%q, at%v, method%h, &
                                       method%least_margin(system, at%q, at%v))
    end if
    if (at%near_edge) return
    call trace(at, method, system)
    call look_for_layers(at%path, system, at%until, method%h, length)
    if (.not. length < method%h) then
      call first_surface(at, method, system, which, place)
      call look_for_rough(at, method, system, which, place, method%h, length)
      if (which == 0) then
        call look_for_steep(method, system, at%until, length)
      else if (place <= 0.0_wp .and. allocated(system%steep_of)) then
        ! Forces that are not resolved may seem to return a motion to a surface that it left.
        if (any(at%fresh .and. system%steep_of == 0)) then
          call look_for_steep(method, system, at%until, length)
        end if
      end if
      if (which > 0 .or. at%n_passed > 0 .or. at%n_halved > 0) then
        call look_for_stiff(at%path, system, place, method%h, length)
      end if
    end if
    if (length < method%h) then
      call method%load_memory(at%memory)
      call shorten(at, method, system, length)
      more = .true.
      return
    end if
    if (which > 0) then
      call method%load_memory(at%memory)
      surface%system => system
      surface%which = which
      call correct(method, system, surface, sign_of(at%sides(which)), at, place, passes, at%made)
      ! A failed step gives no information about a crossing.
      if (.not. at%made) return
      if (passes) then
        call pass(at, method, system, run, which, place*method%h, more)
        return
      end if
      ! The polynomial touches the surface within its error.
      call method%step(system, at%made)
      if (.not. at%made) return
    end if
    if (allocated(at%nearby)) call at%nearby%follow(system, at%path)
    if (run%wants_state(at%from, method%h)) call keep_before(at, method, system, run)
    call note_events(at, method, system, run, any(at%sides == slides))
    call leave_surfaces(at, system)
    if (at%grade > 0.0_wp) at%grade = 2.0_wp*method%h
    if (at%grade >= system%step_length) at%grade = 0.0_wp
    if (.not. at%short .or. at%ended) return
    at%from = at%from + method%h
    more = at%until - at%from > 4.0_wp*spacing(at%until)
    if (more) call method%change_step(system, min(2.0_wp*method%h, at%until - at%from))
  end subroutine step_watched

  !> A motion has left a surface when it is further from it than rounding errors.
  subroutine leave_surfaces(at, system)
    type(watched_step_type), intent(inout) :: at
    class(driven_system_type), intent(in), target :: system
    type(surface_type) :: surface
    real(wp) :: g(1)
    integer :: i

    surface%system => system
    do i = 1, size(at%fresh)
      if (.not. at%fresh(i)) cycle
      surface%which = i
      call signal_along(surface, at%path, [1.0_wp], g)
      at%fresh(i) = at%sides(i) /= slides .and. abs(g(1)) <= rounding_of(surface, at%path)
    end do
  end subroutine leave_surfaces

  !> Length that the last part should have had because of steep laws, whose forces change fast after
  !! another force has changed.
  subroutine look_for_steep(method, system, until, length)
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    !> End of the step.
    real(wp), intent(in) :: until
    real(wp), intent(inout) :: length
    !> Shortest part relative to the step of the run.
    real(wp), parameter :: least = 1.0e-9_wp

    if (.not. allocated(method%resolved)) return
    if (all(method%resolved)) return
    if (method%h <= max(least*system%step_length, 64.0_wp*spacing(until))) return
    length = min(length, 0.5_wp*method%h)
  end subroutine look_for_steep

  !> True if the last part represents the force of the steep law of a surface, which is then smooth
  !! there: inertia does not matter, and the rate follows from the force.
  logical function is_smooth(method, system, which)
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    integer, intent(in) :: which
    is_smooth = allocated(method%resolved) .and. is_steep(system, which)
    if (is_smooth) is_smooth = method%resolved(system%steep_of(which))
  end function is_smooth

  !> True for the surface of a steep law.
  pure logical function is_steep(system, which)
    class(driven_system_type), intent(in) :: system
    integer, intent(in) :: which
    is_steep = allocated(system%steep_of)
    if (is_steep) is_steep = system%steep_of(which) > 0
  end function is_steep

  !> True if the last part is one of the shortest next to the surface of a steep law and ends on the
  !! side where it began: its polynomial may cross the surface and return within its error.
  logical function returns(at, method, system, which)
    type(watched_step_type), intent(in) :: at
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    integer, intent(in) :: which
    real(wp) :: g(1)
    returns = is_steep(system, which) .and. at%sides(which) /= slides
    if (returns) returns = method%h <= closest(system, which)
    if (.not. returns) return
    call system%signal_at(which, [at%from + method%h], reshape(method%q, [1, size(method%q)]), &
                          reshape(method%v, [1, size(method%v)]), g)
    returns = at%sides(which)*g(1) > 0.0_wp
  end function returns

  !> Set the sides of the surfaces of steep laws, which such a part may cross.
  subroutine follow_steep(at, system)
    type(watched_step_type), intent(inout) :: at
    class(driven_system_type), intent(inout) :: system
    integer :: sides(size(at%sides))

    if (.not. allocated(system%steep_of)) return
    if (.not. any(system%steep_of > 0)) return
    sides = sides_of(system, at%from, at%q, at%v)
    sides = merge(sides, at%sides, system%steep_of > 0 .and. .not. at%fresh &
                  .and. at%sides /= slides)
    if (all(sides == at%sides)) return
    at%sides = sides
    call system%take_sides(sides)
  end subroutine follow_steep

  !> Initialize before the first step: fix the sides. The motion may begin on or near a surface with
  !! friction.
  subroutine begin_graded(at, system, q, v, jumps)
    type(watched_step_type), intent(inout) :: at
    class(driven_system_type), intent(inout) :: system
    real(wp), intent(in) :: q(:), v(:)
    !> True if the load may have a jump or a corner here.
    logical, intent(in) :: jumps
    real(wp) :: g(2), here(2, size(q)), rate(2, size(q)), h
    integer :: i

    call system%take_sides(at%sides)
    if (.not. system%begins) then
      at%grade = system%grade
      if (jumps) call begin_small(at, system%first_part())
      return
    end if
    call begin_small(at, system%first_part())
    if (.not. allocated(system%signals)) return
    h = system%step_length
    rate = spread(v, 1, 2)
    here(1, :) = q
    here(2, :) = q + h*v
    do i = 1, size(system%signals)
      if (.not. system%signals(i)%rough > 0.0_wp) cycle
      call system%signal_at(i, [0.0_wp, h], here, rate, g)
      if (abs(g(1)) >= abs(g(2) - g(1))) cycle
      call begin_small(at, max(closest(system, i), h*abs(g(1)/(g(2) - g(1)))))
    end do
  end subroutine begin_graded

  !> Limit the length of the next part (0: any); subsequent parts double.
  pure subroutine begin_small(at, length)
    type(watched_step_type), intent(inout) :: at
    real(wp), intent(in) :: length
    if (.not. length > 0.0_wp) return
    if (.not. (at%grade > 0.0_wp .and. at%grade < length)) at%grade = length
  end subroutine begin_small

  !> Length that the last part should have had because of rough surfaces ahead.
  subroutine look_for_rough(at, method, system, which, place, h, length)
    type(watched_step_type), intent(in) :: at
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in), target :: system
    !> The surface that it crosses (0: none), and where.
    integer, intent(in) :: which
    real(wp), intent(in) :: place, h
    real(wp), intent(out) :: length
    !> Distance for the difference quotient at the end.
    real(wp), parameter :: short = 1.0e-3_wp
    type(surface_type) :: surface
    real(wp) :: g(2), used
    integer :: i

    length = h
    if (.not. allocated(system%signals)) return
    ! A part ends at its crossing; other surfaces may be next to that one.
    used = place*h
    surface%system => system
    do i = 1, size(system%signals)
      if (.not. system%signals(i)%rough > 0.0_wp .or. is_smooth(method, system, i)) cycle
      if (used <= max(closest(system, i), 64.0_wp*spacing(at%until))) cycle
      if (i == which) length = 0.5_wp*used
      if (i == which .or. at%sides(i) == slides) cycle
      surface%which = i
      call signal_along(surface, at%path, place*[1.0_wp - short, 1.0_wp], g)
      ! It would be crossed within another part of the same length.
      if (at%sides(i)*(g(2) + (g(2) - g(1))/short) < 0.0_wp) length = 0.5_wp*used
    end do
  end subroutine look_for_rough

  !> Length of the part nearest to a rough surface.
  real(wp) function closest(system, which)
    class(driven_system_type), intent(in) :: system
    integer, intent(in) :: which
    associate (p => system%signals(which)%rough)
      closest = left_there**(1.0_wp/(2.0_wp + p))
      if (is_steep(system, which)) closest = left_of_steep**(1.0_wp/(1.0_wp + p))
    end associate
    closest = system%step_length*closest
  end function closest

  !> Shorten the present part.
  subroutine shorten(at, method, system, length)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: length
    call method%change_step(system, length)
    at%short = .true.
    at%graded = .true.
  end subroutine shorten

  !> Repeat the last part with half its length, if possible: steps are too large where a
  !! motion is fast, as near the pivot of a pendulum.
  subroutine halve(at, method, system, again)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    logical, intent(out) :: again
    real(wp) :: length

    length = 0.5_wp*method%h
    again = at%n_halved < most_halvings .and. length > shortest*(at%until - at%from) &
            .and. length > 64.0_wp*spacing(at%until)
    if (.not. again) return
    call method%load_memory(at%memory)
    call method%change_step(system, length)
    at%n_halved = at%n_halved + 1
    at%short = .true.
  end subroutine halve

  !> The polynomial of the last part.
  subroutine trace(at, method, system)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    at%path%start = at%from
    call method%trace(system, at%memory, at%path)
    at%path%cancelled = method%h*(system%jump_at_rest &
                                  + maxval(abs(at%path%q))/system%step_length**2)
  end subroutine trace

  !> Store the requested states inside the last part, from its start.
  subroutine keep_before(at, method, system, run)
    type(watched_step_type), intent(in) :: at
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    class(time_run), intent(inout) :: run
    class(stepper_type), allocatable :: start
    allocate (start, source=method)
    call start%load_memory(at%memory)
    call keep_between(run, start, system, at%from)
  end subroutine keep_before

  !> Advance to a surface, and continue on the other side of it.
  subroutine pass(at, method, system, run, which, length, more)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    class(time_run), intent(inout), target :: run
    integer, intent(in) :: which
    !> From the present state of the method.
    real(wp), intent(in) :: length
    logical, intent(out) :: more

    more = .false.
    at%n_passed = at%n_passed + 1
    at%stuck = at%n_passed > most_event_points
    if (at%stuck) return
    if (length > 4.0_wp*spacing(at%from)) then
      call method%change_step(system, length)
      call keep_between(run, method, system, at%from)
      call method%step(system, at%made)
      if (.not. at%made) return
      call trace(at, method, system)
      if (allocated(at%nearby)) call at%nearby%follow(system, at%path)
      call note_events(at, method, system, run, .true.)
      if (at%ended) return
      at%from = at%from + length
      call leave_surfaces(at, system)
    end if
    call meet(at, method, system, which)
    call begin_small(at, system%first_part())
    if (system%signals(which)%rough > 0.0_wp) call begin_small(at, closest(system, which))
    more = at%until - at%from > 4.0_wp*spacing(at%until)
    at%short = .false.
    if (more) call method%change_step(system, at%until - at%from)
  end subroutine pass

  !> Side and velocities of the motion after it has reached a surface.
  subroutine meet(at, method, system, which)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    integer, intent(in) :: which
    real(wp) :: v(size(method%v))
    v = method%v
    if (allocated(at%nearby)) call at%nearby%arrive(system, which, at%sides(which), at%from, &
                                                    method%q, v)
    call system%meet(which, at%from, method%q, v, at%sides, at%fresh)
    if (allocated(at%nearby)) call at%nearby%depart(system, at%from, method%q, v)
    if (any(abs(v - method%v) > 0.0_wp)) call method%put(method%q, v)
  end subroutine meet

  !> The surface that the last part crosses first; 0: none.
  subroutine first_surface(at, method, system, which, place)
    type(watched_step_type), intent(in) :: at
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in), target :: system
    integer, intent(out) :: which
    real(wp), intent(out) :: place
    type(surface_type) :: surface
    real(wp) :: here
    integer :: i
    logical :: found

    which = 0
    place = 1.0_wp
    if (.not. allocated(system%signals)) return
    surface%system => system
    do i = 1, size(system%signals)
      if (is_smooth(method, system, i)) cycle
      if (returns(at, method, system, i)) cycle
      surface%which = i
      call first_event_point(surface, at%path, 0.0_wp, sign_of(at%sides(i)), at%fresh(i), found, &
                             here)
      if (.not. found .or. (which > 0 .and. here >= place)) cycle
      which = i
      place = here
    end do
  end subroutine first_surface

  !> Position of a crossing by steps from the start of the part, which have the order of the method,
  !! unlike its polynomial: Newton's method with the slope of the polynomial, safeguarded by bounds.
  subroutine correct(method, system, signal, side, at, place, passes, made)
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    class(watched_function), intent(in) :: signal
    !> The sign of the signal before.
    integer, intent(in) :: side
    type(watched_step_type), intent(in) :: at
    real(wp), intent(inout) :: place
    !> True if these steps cross the surface too; true if all of them succeeded.
    logical, intent(out) :: passes, made
    real(wp) :: here(size(at%q)), rate(size(at%q)), g(1), low, high, next, width
    integer :: i

    made = .true.
    passes = .false.
    low = 0.0_wp
    high = 2.0_wp
    width = 1.0_wp
    here = at%q
    rate = at%v
    do i = 1, most_corrections
      passes = .true.
      if (place*method%h <= 4.0_wp*spacing(at%from)) exit
      call method%look_ahead(system, place*method%h, here, rate, made)
      if (.not. made) return
      call signal%at([at%from + place*method%h], reshape(here, [1, size(here)]), &
                     reshape(rate, [1, size(rate)]), g)
      if (side*g(1) < 0.0_wp) then
        high = place
      else
        low = place
      end if
      next = place - g(1)/slope(place)
      if (abs(next - place) <= 2.0_wp*epsilon(1.0_wp)*place) exit
      passes = high <= 1.0_wp .or. place < 1.0_wp
      if (.not. passes) exit
      if (next <= low .or. next >= high .or. abs(next - place) > 0.5_wp*width) then
        if (high <= 1.0_wp) next = 0.5_wp*(low + high)
      end if
      next = min(next, 1.0_wp)
      width = abs(next - place)
      if (next <= low .or. next >= high) exit
      place = next
    end do

  contains

    !> Slope of the polynomial; never 0.
    real(wp) function slope(x)
      real(wp), intent(in) :: x
      real(wp) :: pair(2), d
      d = min(1.0e-4_wp, 0.5_wp*x)
      call signal_along(signal, at%path, [x - d, x + d], pair)
      slope = (pair(2) - pair(1))/(2.0_wp*d)
      if (.not. abs(slope) > tiny(1.0_wp)) slope = -side*tiny(1.0_wp)
    end function slope

  end subroutine correct

  !> Position of an event by steps from the start of the part, and the state there; if there is
  !! none, those of the polynomial.
  subroutine settle(start, system, signal, side, at, place, q, v)
    !> The method at the start of the part.
    class(stepper_type), intent(in), target :: start
    class(driven_system_type), intent(in), target :: system
    class(watched_function), intent(in), target :: signal
    !> The sign of the signal before.
    integer, intent(in) :: side
    type(watched_step_type), intent(in), target :: at
    real(wp), intent(inout) :: place
    real(wp), intent(out) :: q(:), v(:)
    type(signal_of_method) :: along
    real(wp) :: t(1), here(1, size(at%q)), rate(1, size(at%q)), first
    logical :: found

    along%start => start
    along%system => system
    along%signal => signal
    along%path => at%path
    along%side = side
    along%q = at%q
    along%v = at%v
    first = place
    call along%settle(place, found)
    ! Far away is a different event, or one that the steps do not resolve: too many for this step
    ! size.
    if (.not. found .or. abs(place - first) > furthest) then
      place = first
      call at%path%at([place], t, here, rate)
      along%q = here(1, :)
      along%v = rate(1, :)
    end if
    q = along%q
    v = along%v
  end subroutine settle

  !> Advance to a position.
  subroutine go(self, x)
    class(signal_of_method), intent(inout) :: self
    real(wp), intent(in) :: x
    self%made = .true.
    if (x*self%path%h <= 4.0_wp*spacing(self%path%start)) then
      self%q = self%path%q(1, :)
      self%v = self%path%v(1, :)
    else
      call self%start%look_ahead(self%system, x*self%path%h, self%q, self%v, self%made)
    end if
  end subroutine go

  !> Store the events of the last part; at an event that ends the run the method stops there.
  subroutine note_events(at, method, system, run, sticks)
    type(watched_step_type), intent(inout), target :: at
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(in), target :: system
    class(time_run), intent(inout), target :: run
    !> As in `look`.
    logical, intent(in) :: sticks
    type(event_point_type), allocatable :: found(:)
    class(stepper_type), allocatable, target :: start
    type(body_function), target :: signal
    type(step_path) :: body
    real(wp) :: q(size(at%q)), v(size(at%q)), place, here(1, size(at%q))
    real(wp) :: rate(1, size(at%q))
    integer :: i

    if (.not. allocated(run%watch)) return
    body = at%path
    call put_on_base(system, body%start + body%h*body%points, body%q, body%v)
    call run%watch%extremes%take(body)
    if (size(run%watch%signals) == 0) return
    call run%watch%look(body, sticks, found)
    if (size(found) == 0) return
    signal%system => system
    allocate (start, source=method)
    call start%load_memory(at%memory)
    do i = 1, size(found)
      place = found(i)%place
      signal%signal => run%watch%signals(found(i)%which)
      call settle(start, system, signal, found(i)%side, at, place, q, v)
      here(1, :) = q
      rate(1, :) = v
      call put_on_base(system, [at%from + place*start%h], here, rate)
      call run%watch%keep(found(i), at%from + place*start%h, here(1, :), rate(1, :), &
                      body%acceleration_at(place))
      at%ended = run%watch%terminal(found(i)%which)
    end do
    if (.not. at%ended) return
    at%from = at%from + place*start%h
    method%q = q
    method%v = v
  end subroutine note_events

  ! States of a body with a moving base, from the relative states in the equations.

  subroutine at(self, t, q, v, g)
    class(body_function), intent(in) :: self
    real(wp), intent(in) :: t(:), q(:, :), v(:, :)
    real(wp), intent(out) :: g(:)
    real(wp), dimension(size(q, 1), size(q, 2)) :: body_q, body_v
    body_q = q
    body_v = v
    call put_on_base(self%system, t, body_q, body_v)
    call self%signal%at(t, body_q, body_v, g)
  end subroutine at

  !> Convert relative states to states of the body at times, shape (size(t), n_dof).
  subroutine put_on_base(system, t, q, v)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t(:)
    real(wp), intent(inout) :: q(:, :), v(:, :)
    real(wp), dimension(size(q, 2)) :: here, rate
    integer :: i
    if (.not. system%base_motion%moves()) return
    do i = 1, size(t)
      here = q(i, :)
      rate = v(i, :)
      call system%add_base(t(i), here, rate)
      q(i, :) = here
      v(i, :) = rate
    end do
  end subroutine put_on_base

  ! Limits for the length of a part of a step due to the forces on it.

  !> Length that the last part should have had because of thin layers of forces in it. Once a layer
  !! may have been missed, all later parts resolve layers.
  subroutine look_for_layers(path, system, until, h, length)
    type(step_path), intent(in) :: path
    class(driven_system_type), intent(inout) :: system
    !> End of the step; length of the part.
    real(wp), intent(in) :: until, h
    real(wp), intent(out) :: length
    !> Shortest part relative to the step of the run; largest reduction at once.
    real(wp), parameter :: least = 1.0e-12_wp, most = 1.0_wp/32.0_wp
    real(wp) :: thin

    length = h
    if (.not. system%layers%exist()) return
    if (h <= max(least*system%step_length, 64.0_wp*spacing(until))) return
    thin = system%layers%thinness_at(path%start + h*path%points, path%points, path%q, path%v, &
                                     .false.)
    if (thin > unseen) system%in_parts = .true.
    if (system%in_parts .and. thin > system%thin) then
      length = h*min(0.5_wp, max(most, system%thin/thin))
    end if
  end subroutine look_for_layers

  !> The same for stiff forces, up to a position in the part. Parts that end or begin on a
  !! surface, and parts of steps that failed as a whole, may be equal for all step
  !! sizes: a comparison of runs would not show their errors.
  subroutine look_for_stiff(path, system, place, h, length)
    type(step_path), intent(in) :: path
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: place, h
    real(wp), intent(inout) :: length
    !> Largest number of parts.
    real(wp), parameter :: most = 1.0e6_wp
    real(wp) :: longest
    integer :: n
    n = max(1, count(path%points <= place))
    longest = system%longest_part(path%q(:n, :), path%v(:n, :))
    if (place*h > longest) length = min(length, place*h/ceiling(min(place*h/longest, most)))
  end subroutine look_for_stiff

end module viscovib_watched_step
