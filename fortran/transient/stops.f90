!> Where a motion stops: a step that may lead out of what the equations describe, or
!! out of the range of numbers, is made again in steps as small as need be.
!!
!! Verner's method of order 9 with step doubling, independent of the method of the run:
!! a step counts only if two of half its length give the same. The place is then found
!! by bisection of the last of them. Systems that go by their sections have more coordinates than
!! there is room for in a lane: their small steps are those of sections.
!!
!! A damped pendulum reaches its pivot otherwise than by passing it: near it the damping
!! moment -c phi' takes the angular momentum (1+z)^2 phi' away at the rate c/(1+z)^2, and
!! z' stays as it is. Explicit steps would shrink with (1+z)^2, so where damping is what limits
!! them they are implicit ones, of the same order. The rest of the way is a straight line from
!! where the margin is small enough.
module viscovib_stops
  use, intrinsic :: ieee_arithmetic, only: ieee_all, ieee_get_halting_mode, ieee_set_flag, &
    ieee_set_halting_mode
  use viscovib_driven_system, only: differentiable_system_type, driven_system_type
  use viscovib_explicit, only: explicit_type, new_explicit
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_modal_gauss, only: modal_gauss_type, new_modal_gauss
  use viscovib_quadrature, only: gauss_nodes
  use viscovib_step_path, only: new_path, step_path
  use viscovib_stiff_step, only: fastest_damping, n_nodes, radau_nodes, stiff_step
  implicit none
  private

  public :: find_stop, stop_type, step_visitor, in_range, least_between, needs_small_steps

  !> How a run ends: all steps done; a coordinate or velocity leaves the range of
  !! numbers; the state leaves the system's physics; the time for it was over; the motion
  !! goes on, but the steps of the run are too large for it; an event ends the run.
  integer, parameter, public :: run_completed = 0, run_diverged = 1, run_unphysical = 2, &
                                run_stopped = 3, run_coarse = 4, run_event = 5
  character(len=*), parameter, public :: run_names(0:5) = &
    [character(len=14) :: 'completed', 'diverged', 'unphysical', 'stopped', 'step too large', &
     'event']

  !> Part of a state by which a step may differ from two of half its length.
  real(wp), parameter :: closeness = 1.0e-12_wp
  !> Where steps become as short as rounding of time, the motion is at the edge of its
  !! physics if its margin is less.
  real(wp), parameter :: edge = 1.0e-6_wp
  !> Steps after which a step of the run is given up as too large, and as many near the
  !! edge of the physics, where the margin is less.
  integer, parameter :: max_steps = 2000, max_near = 100000
  real(wp), parameter :: near = 0.1_wp
  !> Margin below which damping may be fast.
  real(wp), parameter, public :: within_reach = 0.5_wp
  !> The rate of damping times the step from which on a step of the run may be wrong, and what of it
  !! belongs to the relative change of the margin.
  real(wp), parameter :: fast = 1.0_wp, of_change = 2.5_wp
  !> Rate of damping times the step beyond which small steps are implicit: explicit ones, where the
  !! motion limits them and not their stability, are shorter.
  real(wp), parameter :: stiff = 3.0_wp
  !> Order of the difference of a step and two of half its length, in the step.
  real(wp), parameter :: order = 10.0_wp
  !> Place of the method in `explicit_names`.
  integer, parameter :: method_place = 4
  !> Nodes of a small step of sections, and to what part of the motion its equations are solved.
  integer, parameter :: section_nodes = 8
  real(wp), parameter :: solved = 1.0e-15_wp

  !> How a motion ends in a step, when and where; `run_completed`: it does not.
  type :: stop_type
    integer :: outcome = run_completed
    !> Whether the motion came near the edge of the physics, where small steps may stand for one of
    !! the run.
    logical :: near_edge = .false.
    !> From the start of the step.
    real(wp) :: ahead = 0.0_wp
    real(wp), allocatable :: q(:), v(:)
  end type stop_type

  !> One that is shown the motion inside each of the small steps, in their order.
  type, abstract :: step_visitor
  contains
    procedure(visit_interface), deferred :: visit
  end type step_visitor

  abstract interface
    subroutine visit_interface(self, path)
      import :: step_path, step_visitor
      class(step_visitor), intent(inout) :: self
      type(step_path), intent(in) :: path
    end subroutine visit_interface
  end interface

  !> One trajectory in a lane of its own.
  type :: scout_type
    integer :: lane = 1, n = 0
    real(wp), allocatable :: frequencies(:, :)
    !> Start of the step of the run, and of the present one after it.
    real(wp) :: start = 0.0_wp, ahead = 0.0_wp
    real(wp), allocatable :: q(:), v(:)
    !> Whether its next step is an implicit one; whether the last one was made.
    logical :: implicit = .false., made = .true.
  end type scout_type

contains

  !> Whether a state can be computed with.
  pure logical function in_range(system, q, v)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: q(:), v(:)
    in_range = all(abs(q) <= system%range%coordinate) .and. all(abs(v) <= system%range%speed)
  end function in_range

  !> Whether a step of the run may be wrong that seems to be made: near the edge of the physical
  !! range motions are fast or stiff.
  logical function needs_small_steps(system, lane, q, v, h, least) result(needs)
    class(driven_system_type), intent(in) :: system
    !> Lane of the block whose parameters count; state before the step; its length and least
    !! margin.
    integer, intent(in) :: lane
    real(wp), intent(in) :: q(:), v(:), h, least
    real(wp), dimension(n_lanes) :: here, moved_on
    needs = .not. least > near
    if (needs .or. least > within_reach) return
    select type (system)
    class is (differentiable_system_type)
      here = system%margin(spread(q, 1, n_lanes))
      moved_on = system%margin(spread(q + h*v, 1, n_lanes))
      needs = h*fastest_damping(system, lane, q, v) &
              > fast + of_change*abs(moved_on(lane) - here(lane))/here(lane)
    end select
  end function needs_small_steps

  !> Lower bound of a quantity between two places, from its values and its rates times
  !! their distance: the hull of the cubic through them.
  pure elemental real(wp) function least_between(from, rate_from, to, rate_to)
    real(wp), intent(in) :: from, rate_from, to, rate_to
    least_between = min(from, to, from + rate_from/3.0_wp, to - rate_to/3.0_wp)
  end function least_between

  !> How the motion from (q, v) at time `start` ends within h, if it does.
  subroutine find_stop(system, n, lane, frequencies, q, v, start, h, stop, visitor)
    class(driven_system_type), intent(in) :: system
    !> Coordinates of the motion itself, the others may run away; lane of the block whose
    !! parameters count; circular frequencies of the loads, shape (n_lanes, n_drives).
    integer, intent(in) :: n, lane
    real(wp), intent(in) :: frequencies(:, :)
    !> Shape (system%n_dof).
    real(wp), intent(in) :: q(:), v(:), start, h
    type(stop_type), intent(out) :: stop
    !> Only where all lanes have the same parameters, and no coordinate runs away.
    class(step_visitor), intent(inout), optional :: visitor
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
    if (.not. allocated(system%frame)) then
      call new_explicit(method, system%n_dof, method_place, frequencies, spread(q, 1, n_lanes), &
                        spread(v, 1, n_lanes), start, spread(0.0_wp, 1, n_lanes))
    end if
    call march(system, method, begin, h, stop, visitor)
    call ieee_set_flag(ieee_all, .false.)
    call ieee_set_halting_mode(ieee_all, halting)
  end subroutine find_stop

  !> Small steps up to h or to the stop.
  subroutine march(system, method, begin, h, stop, visitor)
    class(driven_system_type), intent(in) :: system
    type(explicit_type), intent(inout) :: method
    type(scout_type), intent(in) :: begin
    real(wp), intent(in) :: h
    type(stop_type), intent(out) :: stop
    class(step_visitor), intent(inout), optional :: visitor
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
          call show_line(at, min(h - at%ahead, margin/lost), visitor)
          at%ahead = min(h, at%ahead + margin/lost)
          exit
        end if
        ! Where it begins does not depend on the run.
        if (margin <= 2.0_wp*edge) s = min(s, (margin - edge*(1.0_wp - 1.0e-9_wp))/lost)
      end if
      at%implicit = is_stiff(system, at, s)
      stop%near_edge = stop%near_edge &
                       .or. needs_small_steps(system, at%lane, at%q, at%v, h, margin)
      if (margin > near) n_far = n_far + 1
      if (.not. margin > near) n_near = n_near + 1
      call step_from(system, method, at, s, whole)
      call step_from(system, method, at, 0.5_wp*s, half)
      call step_from(system, method, half, 0.5_wp*s, double)
      miss = apart(whole, double, h)
      if (.not. miss <= 1.0_wp) then
        s = s*max(0.2_wp, 0.9_wp*miss**(-1.0_wp/order))
      else if (at%implicit .and. leaves(system, whole)) then
        ! To where the straight rest of the way begins: beyond it rounding is all there is.
        lost = margin - margin_of(system, whole)
        s = s*min(0.9_wp, (margin - 1.5_wp*edge)/lost)
      else if (leaves(system, whole)) then
        call bisect(system, method, at, s, shortest, stop)
        call show_step(system, method, at, stop%ahead - at%ahead, visitor)
        return
      else if (min(least_margin(system, at, half, 0.5_wp*s), &
                   least_margin(system, half, double, 0.5_wp*s)) <= 0.0_wp) then
        ! Whether it leaves between is seen with smaller steps.
        s = 0.5_wp*s
      else
        call show_step(system, method, at, s, visitor)
        at = double
        s = s*min(4.0_wp, 0.9_wp*max(miss, tiny(1.0_wp))**(-1.0_wp/order))
      end if
    end do
    stop%ahead = at%ahead
    stop%q = at%q
    stop%v = at%v
  end subroutine march

  !> The last state before a motion leaves within a step of length s that is resolved.
  subroutine bisect(system, method, at, s, shortest, stop)
    class(driven_system_type), intent(in) :: system
    type(explicit_type), intent(inout) :: method
    type(scout_type), intent(in) :: at
    !> Its length; what is shorter is no time.
    real(wp), intent(in) :: s, shortest
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
    at_edge = in_range(system, outside%q(:at%n), outside%v(:at%n)) &
              .or. margin_of(system, inside) <= edge
    stop%outcome = merge(run_unphysical, run_diverged, at_edge)
    ! A wall throws it far in less time than counts.
    if (.not. at_edge .and. low <= shortest) inside = at
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
    real(wp), dimension(n_nodes, system%n_dof) :: q_nodes, v_nodes
    real(wp) :: h(n_lanes)
    type(modal_gauss_type) :: sections

    if (allocated(system%frame)) then
      next = at
      call new_modal_gauss(sections, system, section_nodes, at%q, at%v, at%start + at%ahead, s, &
                           solved)
      if (system%timed) sections%since = at%start - system%present_piece(1) + at%ahead
      call sections%step(system, next%made)
      next%ahead = at%ahead + s
      next%q = sections%q
      next%v = sections%v
      return
    end if
    if (at%implicit) then
      next = at
      call nodes_of(system, at, s, q_nodes, v_nodes, next%made)
      next%ahead = at%ahead + s
      next%q = q_nodes(n_nodes, :)
      next%v = v_nodes(n_nodes, :)
      return
    end if
    h = 0.0_wp
    h(at%lane) = s
    call begin_at(system, method, at, h)
    call method%step(system)
    call method%get_state(q, v)
    next = at
    next%ahead = at%ahead + s
    next%q = q(at%lane, :)
    next%v = v(at%lane, :)
  end subroutine step_from

  !> Whether the damping of a motion is faster than an explicit step can follow.
  logical function is_stiff(system, at, s)
    class(driven_system_type), intent(in) :: system
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: s
    is_stiff = .false.
    select type (system)
    class is (differentiable_system_type)
      is_stiff = s*fastest_damping(system, at%lane, at%q, at%v) > stiff
    end select
  end function is_stiff

  !> States at the nodes of an implicit step; those at its start where it cannot be made.
  subroutine nodes_of(system, at, s, q, v, made)
    class(driven_system_type), intent(in) :: system
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: s
    real(wp), intent(out) :: q(:, :), v(:, :)
    logical, intent(out) :: made
    made = .false.
    select type (system)
    class is (differentiable_system_type)
      call stiff_step(system, at%lane, at%frequencies(at%lane, :), at%start + at%ahead, s, at%q, &
                      at%v, q, v, made)
    end select
    if (made) return
    q = spread(at%q, 1, n_nodes)
    v = spread(at%v, 1, n_nodes)
  end subroutine nodes_of

  !> Put all lanes where a trajectory is, each with a step of its own.
  subroutine begin_at(system, method, at, h)
    class(driven_system_type), intent(in) :: system
    type(explicit_type), intent(inout) :: method
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: h(n_lanes)
    call method%begin_again(at%frequencies, spread(at%q, 1, n_lanes), spread(at%v, 1, n_lanes), &
                            at%start + at%ahead, h)
    if (allocated(system%quarters)) call method%turn_phases(system%quarters)
    if (system%timed) method%since = at%start - system%present_piece(1) + at%ahead
  end subroutine begin_at

  !> Show a small step: by steps of eight parts of its length, one a lane, which have the order of
  !! the method; an implicit one by its nodes.
  subroutine show_step(system, method, at, s, visitor)
    class(driven_system_type), intent(in) :: system
    type(explicit_type), intent(inout) :: method
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: s
    class(step_visitor), intent(inout), optional :: visitor
    type(scout_type) :: last
    real(wp), dimension(n_lanes, system%n_dof) :: q, v
    real(wp), dimension(n_nodes, system%n_dof) :: q_nodes, v_nodes
    real(wp) :: nodes(n_lanes), weights(n_lanes)

    if (.not. present(visitor)) return
    if (at%implicit) then
      last = at
      call nodes_of(system, at, s, q_nodes, v_nodes, last%made)
      last%q = q_nodes(n_nodes, :)
      last%v = v_nodes(n_nodes, :)
      call show(at, s, radau_nodes(:n_nodes - 1), q_nodes(:n_nodes - 1, :), &
                v_nodes(:n_nodes - 1, :), last, visitor)
      return
    end if
    call step_from(system, method, at, s, last)
    call gauss_nodes(n_lanes, nodes, weights)
    call begin_at(system, method, at, s*nodes)
    call method%step(system)
    call method%get_state(q, v)
    call show(at, s, nodes, q, v, last, visitor)
  end subroutine show_step

  !> Show the straight rest of the way.
  subroutine show_line(at, s, visitor)
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: s
    class(step_visitor), intent(inout), optional :: visitor
    real(wp) :: none(0, size(at%q))
    if (.not. present(visitor)) return
    call show(at, s, none(:, 1), none, none, moved(at, s), visitor)
  end subroutine show_line

  !> Show the motion by its states at both ends of a step and at places between.
  subroutine show(at, s, places, q, v, last, visitor)
    type(scout_type), intent(in) :: at, last
    real(wp), intent(in) :: s, places(:), q(:, :), v(:, :)
    class(step_visitor), intent(inout) :: visitor
    type(step_path) :: path
    integer :: m

    m = size(places)
    call new_path(path, [0.0_wp, places, 1.0_wp])
    path%start = at%start + at%ahead
    path%h = s
    allocate (path%q(m + 2, size(at%q)), path%v(m + 2, size(at%q)))
    path%q(1, :) = at%q
    path%v(1, :) = at%v
    path%q(2:m + 1, :) = q
    path%v(2:m + 1, :) = v
    path%q(m + 2, :) = last%q
    path%v(m + 2, :) = last%v
    call visitor%visit(path)
  end subroutine show

  !> By how much two ends of a step differ, 1: as much as they may; huge if one of them
  !! is no number.
  pure real(wp) function apart(one, other, h)
    type(scout_type), intent(in) :: one, other
    !> A time by which velocities count.
    real(wp), intent(in) :: h
    real(wp) :: size_of
    apart = huge(1.0_wp)
    if (.not. (one%made .and. other%made)) return
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
    if (in_range(system, at%q(:at%n), at%v(:at%n))) leaves = .not. margin_of(system, at) > 0.0_wp
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
