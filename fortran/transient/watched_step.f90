!> Steps that end where the equations have a kink or a jump, and in which events are looked for.
!!
!! Within a step the equations are held on their side of each surface, so that the method sees
!! a smooth right side. Where the motion passes a surface inside the step, the step is made
!! again up to there, then on with the other side held: every part has the order of the method.
module viscovib_watched_step
  use viscovib_driven_system, only: driven_system_type
  use viscovib_event_search, only: first_passage, signal_along
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: signal_type
  use viscovib_step_path, only: step_path
  use viscovib_stepper, only: stepper_type
  use viscovib_stops, only: in_range
  use viscovib_wanted_states, only: wanted_states
  use viscovib_watch, only: passage_type, watch_type
  implicit none
  private

  public :: watched_step_type, step_watched, sides_of

  !> Surfaces passed in one step before the motion counts as one that stays on them.
  integer, parameter :: most_passages = 1000
  !> Corrections of the time of a passage by steps of their own.
  integer, parameter :: most_corrections = 60
  !> How far they may lead, as a part of the step.
  real(wp), parameter :: furthest = 0.1_wp

  !> A step on its way.
  type :: watched_step_type
    !> Where its present part begins, and the step ends.
    real(wp) :: from = 0.0_wp, until = 0.0_wp
    !> State where the present part begins.
    real(wp), allocatable :: q(:), v(:)
    !> Sides of the surfaces of the system.
    integer, allocatable :: sides(:)
    !> The last part was made; an event ends the run; the part of the step that was passed.
    logical :: made = .false., ended = .false.
    !> The motion stays on a surface, as where dry friction sticks: no part leads on.
    logical :: stuck = .false.
    !> Of what was passed last, and how often in this step.
    integer :: last = 0, n_passed = 0
    real(wp), allocatable :: memory(:)
    type(step_path) :: path
  end type watched_step_type

contains

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
      call system%signals(i)%at([t], reshape(q, [1, size(q)]), reshape(v, [1, size(v)]), g)
      sides = [sides, merge(1, -1, g(1) >= 0.0_wp)]
    end do
  end function sides_of

  !> The next part of a step: up to its end, or to the first surface passed; `more`: not yet at
  !! its end. Before it the method is where the part begins, and would step to the end.
  subroutine step_watched(at, method, system, watch, wanted, more)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    type(watch_type), intent(inout) :: watch
    type(wanted_states), intent(inout) :: wanted
    logical, intent(out) :: more
    real(wp) :: place
    integer :: which
    logical :: passes

    more = .false.
    at%q = method%q
    at%v = method%v
    at%memory = method%save_memory()
    if (system%timed) method%since = at%from - system%present_piece(1)
    call method%step(system, at%made)
    if (at%made) at%made = in_range(method%q, method%v)
    if (.not. at%made) return
    call trace(at, method, system)
    call first_surface(at, system, which, place)
    if (which > 0) then
      call method%load_memory(at%memory)
      call correct(method, system, system%signals(which), at%sides(which), at, place, passes)
      if (passes) then
        call pass(at, method, system, watch, wanted, which, place*method%h, more)
        return
      end if
      ! The polynomial touches the surface within its error.
      call method%step(system, at%made)
      if (.not. at%made) return
    end if
    if (wanted%within(at%from, method%h)) call keep_before(at, method, system, wanted)
    call note_events(at, method, system, watch)
  end subroutine step_watched

  !> The polynomial of the last part.
  subroutine trace(at, method, system)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    at%path%start = at%from
    call method%trace(system, at%memory, at%path)
  end subroutine trace

  !> States wanted inside the last part, from its start.
  subroutine keep_before(at, method, system, wanted)
    type(watched_step_type), intent(in) :: at
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    type(wanted_states), intent(inout) :: wanted
    class(stepper_type), allocatable :: start
    allocate (start, source=method)
    call start%load_memory(at%memory)
    call wanted%keep_between(start, system, at%from)
  end subroutine keep_before

  !> Up to a surface, and on the other side of it.
  subroutine pass(at, method, system, watch, wanted, which, length, more)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(inout) :: system
    type(watch_type), intent(inout) :: watch
    type(wanted_states), intent(inout) :: wanted
    integer, intent(in) :: which
    !> From where the method is.
    real(wp), intent(in) :: length
    logical, intent(out) :: more

    more = .false.
    at%n_passed = at%n_passed + 1
    at%stuck = at%n_passed > most_passages
    if (at%stuck) return
    if (length > 4.0_wp*spacing(at%from)) then
      call method%change_step(system, length)
      call wanted%keep_between(method, system, at%from)
      call method%step(system, at%made)
      if (.not. at%made) return
      call trace(at, method, system)
      call note_events(at, method, system, watch)
      if (at%ended) return
      at%from = at%from + length
    end if
    at%sides(which) = -at%sides(which)
    at%last = which
    call system%take_sides(at%sides)
    more = at%until - at%from > 4.0_wp*spacing(at%until)
    if (more) call method%change_step(system, at%until - at%from)
  end subroutine pass

  !> The surface that the last part passes first; 0: none.
  subroutine first_surface(at, system, which, place)
    type(watched_step_type), intent(in) :: at
    class(driven_system_type), intent(in) :: system
    integer, intent(out) :: which
    real(wp), intent(out) :: place
    real(wp) :: here
    integer :: i
    logical :: found

    which = 0
    place = 1.0_wp
    if (.not. allocated(system%signals)) return
    do i = 1, size(system%signals)
      call first_passage(system%signals(i), at%path, 0.0_wp, at%sides(i), i == at%last, found, here)
      if (.not. found .or. (which > 0 .and. here >= place)) cycle
      which = i
      place = here
    end do
  end subroutine first_surface

  !> The place of a passage by steps of their own from the start of the part, which have the order
  !! of the method where its polynomial has not: Newton's method from the place by the polynomial,
  !! with its slope, kept between places on either side of the surface.
  subroutine correct(method, system, signal, side, at, place, passes, q, v)
    class(stepper_type), intent(in) :: method
    class(driven_system_type), intent(in) :: system
    type(signal_type), intent(in) :: signal
    !> The sign of the signal before.
    integer, intent(in) :: side
    type(watched_step_type), intent(in) :: at
    real(wp), intent(inout) :: place
    !> Whether these steps pass the surface too; and the state there.
    logical, intent(out) :: passes
    real(wp), intent(out), optional :: q(:), v(:)
    real(wp) :: here(size(at%q)), rate(size(at%q)), g(1), low, high, next, width
    integer :: i
    logical :: made

    low = 0.0_wp
    high = 2.0_wp
    width = 1.0_wp
    here = at%q
    rate = at%v
    do i = 1, most_corrections
      passes = .true.
      if (place*method%h <= 4.0_wp*spacing(at%from)) exit
      call method%look_ahead(system, place*method%h, here, rate, made)
      passes = made
      if (.not. made) exit
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
    if (.not. present(q)) return
    q = here
    v = rate

  contains

    !> Of the polynomial; never 0.
    real(wp) function slope(x)
      real(wp), intent(in) :: x
      real(wp) :: pair(2), d
      d = min(1.0e-4_wp, 0.5_wp*x)
      call signal_along(signal, at%path, [x - d, x + d], pair)
      slope = (pair(2) - pair(1))/(2.0_wp*d)
      if (.not. abs(slope) > tiny(1.0_wp)) slope = -side*tiny(1.0_wp)
    end function slope

  end subroutine correct

  !> Events of the last part; one that ends the run leaves the method there.
  subroutine note_events(at, method, system, watch)
    type(watched_step_type), intent(inout) :: at
    class(stepper_type), intent(inout) :: method
    class(driven_system_type), intent(in) :: system
    type(watch_type), intent(inout) :: watch
    type(passage_type), allocatable :: found(:)
    class(stepper_type), allocatable :: start
    real(wp) :: q(size(at%q)), v(size(at%q)), place, t(1), here(1, size(at%q))
    real(wp) :: rate(1, size(at%q))
    integer :: i
    logical :: passes

    if (size(watch%signals) == 0) return
    call watch%look(at%path, found)
    if (size(found) == 0) return
    allocate (start, source=method)
    call start%load_memory(at%memory)
    do i = 1, size(found)
      associate (which => found(i)%which)
        place = found(i)%place
        call correct(start, system, watch%signals(which), found(i)%side, at, place, passes, q, v)
        if (abs(place - found(i)%place) > furthest) then
          ! That is another passage: the step is too large for so many.
          place = found(i)%place
          call at%path%at([place], t, here, rate)
          q = here(1, :)
          v = rate(1, :)
        end if
        call watch%keep(which, at%from + place*start%h, q, v)
        at%ended = watch%terminal(which)
      end associate
    end do
    if (.not. at%ended) return
    at%from = at%from + place*start%h
    method%q = q
    method%v = v
  end subroutine note_events

end module viscovib_watched_step
