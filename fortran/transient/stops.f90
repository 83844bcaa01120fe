!> Where a motion stops: a step that may lead out of what the equations describe, or
!! out of the range of numbers, is made again in steps as small as need be.
!!
!! Verner's method of order 9 with step doubling, independent of the method of the run:
!! a step counts only if two of half its length give the same. The place is then found
!! by bisection of the last of them.
!!
!! A damped pendulum reaches its pivot otherwise than by passing it: near it the damping
!! moment -c phi' takes the angular momentum (1+z)^2 phi' away at the rate c/(1+z)^2, and
!! z' stays as it is. Steps then shrink with (1+z)^2, and the rest of the way is a straight
!! line from where the margin is small enough.
module viscovib_stops
  use, intrinsic :: ieee_arithmetic, only: ieee_all, ieee_get_halting_mode, ieee_set_flag, &
    ieee_set_halting_mode
  use viscovib_driven_system, only: driven_system_type
  use viscovib_explicit, only: explicit_type, new_explicit
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_vector_math, only: largest_angle
  implicit none
  private

  public :: find_stop, stop_type, in_range, least_between

  !> How a run ends: all steps done; a coordinate or velocity leaves the range of
  !! numbers; the state leaves the system's physics; the time for it was over; the motion
  !! goes on, but the steps of the run are too large for it; an event ends the run.
  integer, parameter, public :: run_completed = 0, run_diverged = 1, run_unphysical = 2, &
                                run_stopped = 3, run_coarse = 4, run_event = 5
  character(len=*), parameter, public :: run_names(0:5) = &
    [character(len=14) :: 'completed', 'diverged', 'unphysical', 'stopped', 'step too large', &
     'event']

  !> Beyond this a velocity has run away.
  real(wp), parameter :: largest_speed = 1.0e15_wp
  !> Part of a state by which a step may differ from two of half its length.
  real(wp), parameter :: closeness = 1.0e-12_wp
  !> Where steps become as short as rounding of time, the motion is at the edge of its
  !! physics if its margin is less.
  real(wp), parameter :: edge = 1.0e-6_wp
  !> Steps after which a step of the run is given up as too large, and as many near the
  !! edge of the physics, where the margin is less.
  integer, parameter :: max_steps = 2000, max_near = 100000
  real(wp), parameter, public :: near = 0.1_wp
  !> Order of the difference of a step and two of half its length, in the step.
  real(wp), parameter :: order = 10.0_wp
  !> Place of the method in `explicit_names`.
  integer, parameter :: method_place = 4

  !> How a motion ends in a step, when and where; `run_completed`: it does not.
  type :: stop_type
    integer :: outcome = run_completed
    !> Whether the motion came near the edge of the physics.
    logical :: near_edge = .false.
    !> From the start of the step.
    real(wp) :: ahead = 0.0_wp
    real(wp), allocatable :: q(:), v(:)
  end type stop_type

  !> One trajectory in a lane of its own.
  type :: scout_type
    integer :: lane = 1, n = 0
    real(wp), allocatable :: frequencies(:, :)
    !> Start of the step of the run, and of the present one after it.
    real(wp) :: start = 0.0_wp, ahead = 0.0_wp
    real(wp), allocatable :: q(:), v(:)
  end type scout_type

contains

  !> Whether a state can be computed with.
  pure logical function in_range(q, v)
    real(wp), intent(in) :: q(:), v(:)
    in_range = all(abs(q) <= largest_angle) .and. all(abs(v) <= largest_speed)
  end function in_range

  !> Lower bound of a quantity between two places, from its values and its rates times
  !! their distance: the hull of the cubic through them.
  pure elemental real(wp) function least_between(from, rate_from, to, rate_to)
    real(wp), intent(in) :: from, rate_from, to, rate_to
    least_between = min(from, to, from + rate_from/3.0_wp, to - rate_to/3.0_wp)
  end function least_between

  !> How the motion from (q, v) at time `start` ends within h, if it does.
  subroutine find_stop(system, n, lane, frequencies, q, v, start, h, stop)
    class(driven_system_type), intent(in) :: system
    !> Coordinates of the motion itself, the others may run away; lane of the block whose
    !! parameters count; circular frequencies of the loads, shape (n_lanes, n_drives).
    integer, intent(in) :: n, lane
    real(wp), intent(in) :: frequencies(:, :)
    !> Shape (system%n_dof).
    real(wp), intent(in) :: q(:), v(:), start, h
    type(stop_type), intent(out) :: stop
    type(scout_type) :: begin
    type(explicit_type) :: method
    logical :: halting(size(ieee_all))

    ! One by one: the constructor of gfortran 12 copies arrays with strides wrongly.
    begin%lane = lane
    begin%n = n
    begin%start = start
    begin%frequencies = frequencies
    begin%q = q
    begin%v = v
    ! Steps that are too large may overflow, which is how they are known.
    call ieee_get_halting_mode(ieee_all, halting)
    call ieee_set_halting_mode(ieee_all, .false.)
    call new_explicit(method, system%n_dof, method_place, frequencies, spread(q, 1, n_lanes), &
                      spread(v, 1, n_lanes), start, spread(0.0_wp, 1, n_lanes))
    call march(system, method, begin, h, stop)
    call ieee_set_flag(ieee_all, .false.)
    call ieee_set_halting_mode(ieee_all, halting)
  end subroutine find_stop

  !> Small steps up to h or to the stop.
  subroutine march(system, method, begin, h, stop)
    class(driven_system_type), intent(in) :: system
    type(explicit_type), intent(inout) :: method
    type(scout_type), intent(in) :: begin
    real(wp), intent(in) :: h
    type(stop_type), intent(out) :: stop
    type(scout_type) :: at, whole, half, double
    real(wp) :: s, shortest, miss, margin, lost
    integer :: n_far, n_near

    at = begin
    s = h
    stop%outcome = run_coarse
    shortest = 4.0_wp*max(spacing(abs(begin%start) + h), tiny(1.0_wp))
    n_far = 0
    n_near = 0
    do while (n_far < max_steps .and. n_near < max_near)
      s = min(s, h - at%ahead)
      margin = margin_of(system, at)
      if (s <= shortest) then
        if (h - at%ahead > shortest) then
          stop%outcome = merge(run_unphysical, run_diverged, margin <= edge)
        else
          stop%outcome = run_completed
        end if
        exit
      end if
      lost = (margin - margin_of(system, moved(at, s)))/s
      if (lost > 0.0_wp) then
        if (margin <= edge) then
          ! The straight rest of the way.
          stop%outcome = run_unphysical
          at%ahead = min(h, at%ahead + margin/lost)
          exit
        end if
        ! Where it begins does not depend on the run.
        if (margin <= 2.0_wp*edge) s = min(s, (margin - edge*(1.0_wp - 1.0e-9_wp))/lost)
      end if
      if (margin > near) n_far = n_far + 1
      if (.not. margin > near) n_near = n_near + 1
      call step_from(system, method, at, s, whole)
      call step_from(system, method, at, 0.5_wp*s, half)
      call step_from(system, method, half, 0.5_wp*s, double)
      miss = apart(whole, double, h)
      if (.not. miss <= 1.0_wp) then
        s = s*max(0.2_wp, 0.9_wp*miss**(-1.0_wp/order))
      else if (leaves(system, whole)) then
        call bisect(system, method, at, s, stop)
        return
      else if (min(least_margin(system, at, half, 0.5_wp*s), &
                   least_margin(system, half, double, 0.5_wp*s)) <= 0.0_wp) then
        ! Whether it leaves between is seen with smaller steps.
        s = 0.5_wp*s
      else
        at = double
        s = s*min(4.0_wp, 0.9_wp*max(miss, tiny(1.0_wp))**(-1.0_wp/order))
      end if
    end do
    stop%near_edge = n_near > 0
    stop%ahead = at%ahead
    stop%q = at%q
    stop%v = at%v
  end subroutine march

  !> The last state before a motion leaves within a step of length s that is resolved.
  subroutine bisect(system, method, at, s, stop)
    class(driven_system_type), intent(in) :: system
    type(explicit_type), intent(inout) :: method
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: s
    type(stop_type), intent(out) :: stop
    type(scout_type) :: inside, outside, try
    real(wp) :: low, high, middle
    logical :: at_edge

    low = 0.0_wp
    high = s
    inside = at
    call step_from(system, method, at, s, outside)
    do
      middle = 0.5_wp*(low + high)
      if (middle <= low .or. middle >= high) exit
      if (high - low <= spacing(at%start + at%ahead + high)) exit
      call step_from(system, method, at, middle, try)
      if (leaves(system, try)) then
        high = middle
        outside = try
      else
        low = middle
        inside = try
      end if
    end do
    ! At the edge of the physics velocities may be infinite.
    at_edge = in_range(outside%q(:at%n), outside%v(:at%n)) .or. margin_of(system, inside) <= edge
    stop%outcome = merge(run_unphysical, run_diverged, at_edge)
    stop%ahead = inside%ahead
    stop%q = inside%q
    stop%v = inside%v
  end subroutine bisect

  !> The same trajectory a time s later.
  subroutine step_from(system, method, at, s, next)
    class(driven_system_type), intent(in) :: system
    type(explicit_type), intent(inout) :: method
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: s
    type(scout_type), intent(out) :: next
    real(wp), dimension(n_lanes, system%n_dof) :: q, v
    real(wp) :: h(n_lanes)

    q = spread(at%q, 1, n_lanes)
    v = spread(at%v, 1, n_lanes)
    h = 0.0_wp
    h(at%lane) = s
    call method%begin_again(at%frequencies, q, v, at%start + at%ahead, h)
    if (allocated(system%quarters)) call method%turn_phases(system%quarters)
    if (system%timed) method%since = at%start - system%present_piece(1) + at%ahead
    call method%step(system)
    call method%get_state(q, v)
    next = at
    next%ahead = at%ahead + s
    next%q = q(at%lane, :)
    next%v = v(at%lane, :)
  end subroutine step_from

  !> By how much two ends of a step differ, 1: as much as they may; huge if one of them
  !! is no number.
  pure real(wp) function apart(one, other, h)
    type(scout_type), intent(in) :: one, other
    !> A time by which velocities count.
    real(wp), intent(in) :: h
    real(wp) :: size_of
    apart = huge(1.0_wp)
    associate (n => one%n)
      ! All of them: a largest one skips what is no number.
      if (.not. (all(abs(one%q(:n)) <= huge(1.0_wp)) .and. all(abs(one%v(:n)) <= huge(1.0_wp)) &
                 .and. all(abs(other%q(:n)) <= huge(1.0_wp)) &
                 .and. all(abs(other%v(:n)) <= huge(1.0_wp)))) return
      size_of = maxval(abs(other%q(:n))) + h*maxval(abs(other%v(:n)))
      size_of = max(size_of, tiny(1.0_wp))
      apart = max(maxval(abs(one%q(:n) - other%q(:n))), &
                  h*maxval(abs(one%v(:n) - other%v(:n))))/(closeness*size_of)
      if (.not. apart <= huge(1.0_wp)) apart = huge(1.0_wp)
    end associate
  end function apart

  !> Whether a state is out of range or out of the physics.
  logical function leaves(system, at)
    class(driven_system_type), intent(in) :: system
    type(scout_type), intent(in) :: at
    leaves = .true.
    if (in_range(at%q(:at%n), at%v(:at%n))) leaves = .not. margin_of(system, at) > 0.0_wp
  end function leaves

  real(wp) function margin_of(system, at)
    class(driven_system_type), intent(in) :: system
    type(scout_type), intent(in) :: at
    real(wp) :: margins(n_lanes)
    margins = system%margin(spread(at%q, 1, n_lanes))
    margin_of = margins(at%lane)
  end function margin_of

  !> Lower bound of the margin between two states s apart.
  real(wp) function least_margin(system, from, to, s)
    class(driven_system_type), intent(in) :: system
    type(scout_type), intent(in) :: from, to
    real(wp), intent(in) :: s
    real(wp) :: here, there
    here = margin_of(system, from)
    there = margin_of(system, to)
    least_margin = least_between(here, rate(from, here), there, rate(to, there))

  contains

    real(wp) function rate(state, margin)
      type(scout_type), intent(in) :: state
      real(wp), intent(in) :: margin
      rate = margin_of(system, moved(state, s)) - margin
    end function rate

  end function least_margin

  !> The state a time s later on a straight line.
  pure type(scout_type) function moved(state, s)
    type(scout_type), intent(in) :: state
    real(wp), intent(in) :: s
    moved = state
    moved%q = state%q + s*state%v
  end function moved

end module viscovib_stops
