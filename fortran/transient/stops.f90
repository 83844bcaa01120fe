! Optimize: -O3
!> Detection of the end of a motion: a step that may leave the physical range or the
!! range of numbers is repeated with small steps.
!!
!! Verner's method of order 9 with step doubling, independent of the method of the run:
!! a step is accepted only if two half steps give the same. The last one is then bisected
!! to locate the stop. Systems with a modal frame may have more coordinates than the
!! lanes can store: their small steps use `modal_gauss`. Those of a run with memory are steps of
!! the same run, halved and doubled, so that they share their maps. The memory must be accurate for
!! lags as short as these steps; a sum of exponentials that was not fitted for them causes an
!! additional error.
!!
!! A damped pendulum approaches its pivot in a special way: near it the damping
!! moment -c phi' reduces the angular momentum (1+z)^2 phi' at the rate c/(1+z)^2, and
!! z' stays constant. Explicit steps would shrink with (1+z)^2, so where damping limits
!! them the steps are implicit, of the same order. From a small margin on, the motion is
!! extrapolated by a straight line.
module viscovib_stops
  use, intrinsic :: ieee_arithmetic, only: ieee_all, ieee_get_halting_mode, ieee_set_flag, &
    ieee_set_halting_mode
  use viscovib_driven_system, only: differentiable_system_type, driven_system_type
  use viscovib_explicit, only: explicit_type, new_explicit
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_march, only: march_type
  use viscovib_modal_gauss, only: modal_gauss_type, new_modal_gauss
  use viscovib_quadrature, only: gauss_nodes
  use viscovib_step_path, only: new_path, step_path
  use viscovib_stiff_step, only: fastest_damping, n_nodes, radau_nodes, stiff_step
  use viscovib_time_run, only: run_coarse, run_completed, run_diverged, run_unphysical
  implicit none
  private

  public :: find_stop, find_stop_of_march, in_range, least_between, needs_small_steps
  public :: step_visitor, stop_type

  !> Allowed difference of a step and two half steps, relative to the state: without memory, and of
  !! a run with memory.
  real(wp), parameter :: closeness = 1.0e-12_wp, with_memory = 1.0e-11_wp
  !> A motion with memory that no step follows has escaped if it exceeds the largest earlier
  !! displacement by this factor.
  real(wp), parameter :: far = 1.0e3_wp
  !> If steps shrink to the rounding of time and the margin is below this, the motion is at the
  !! edge of its physical range.
  real(wp), parameter :: edge = 1.0e-6_wp
  !> Small steps after which a step of the run counts as too large, and the same near the edge of
  !! the physical range, where the margin is below `near`.
  integer, parameter :: max_steps = 2000, max_near = 100000
  real(wp), parameter :: near = 0.1_wp
  !> Margin below which damping may be fast.
  real(wp), parameter, public :: within_reach = 0.5_wp
  !> Rate of damping times step above which a step of the run may be wrong; factor of the
  !! relative change of the margin in this bound.
  real(wp), parameter :: fast = 1.0_wp, of_change = 2.5_wp
  !> Rate of damping times step above which small steps are implicit. Explicit steps that accuracy
  !! limits, and not stability, are shorter.
  real(wp), parameter :: stiff = 3.0_wp
  !> Exponent of the step in the difference of a step and two half steps.
  real(wp), parameter :: order = 10.0_wp
  !> Index of the method in `explicit_names`.
  integer, parameter :: method_place = 4
  !> Nodes of a small step with a modal frame, and relative tolerance of its equations.
  integer, parameter :: section_nodes = 8
  real(wp), parameter :: solved = 1.0e-15_wp

  !> End of a motion in a step: outcome, time and state; `run_completed` if it does not end.
  type :: stop_type
    integer :: outcome = run_completed
    !> True if the motion came near the edge of the physical range, where small steps may replace a
    !! step of the run.
    logical :: near_edge = .false.
    !> Time from the start of the step.
    real(wp) :: ahead = 0.0_wp
    real(wp), allocatable :: q(:), v(:)
    !> Lengths of the small steps up to it, of a run with memory.
    real(wp), allocatable :: lengths(:)
  end type stop_type

  !> The equations of a motion without memory with a method for small steps, or a run with memory.
  type :: equations_type
    class(driven_system_type), pointer :: system => null()
    type(explicit_type) :: method
    class(march_type), pointer :: march => null()
  end type equations_type

  !> A visitor that receives the motion inside each of the small steps, in their order.
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

  !> One trajectory in its own lane.
  type :: scout_type
    integer :: lane = 1, n = 0
    real(wp), allocatable :: frequencies(:, :)
    !> Start of the step of the run, and time of the present state after it.
    real(wp) :: start = 0.0_wp, ahead = 0.0_wp
    real(wp), allocatable :: q(:), v(:)
    !> True if its next step is implicit; true if the last step succeeded.
    logical :: implicit = .false., made = .true.
    !> The data that a run with memory needs to continue.
    real(wp), allocatable :: memory(:)
  end type scout_type

contains

  !> True if a state is within the range of numbers of the system.
  pure logical function in_range(system, q, v)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: q(:), v(:)
    in_range = all(abs(q) <= system%range%coordinate) .and. all(abs(v) <= system%range%speed)
  end function in_range

  !> True if a step of the run may be wrong although it succeeded: near the edge of the physical
  !! range motions are fast or stiff.
  logical function needs_small_steps(system, lane, q, v, h, least) result(needs)
    class(driven_system_type), intent(in) :: system
    !> Lane of the block whose parameters are used; state before the step; its length and least
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

  !> Lower bound of a quantity between two points, from its values and its rates times
  !! their distance: the hull of the cubic through them.
  pure elemental real(wp) function least_between(from, rate_from, to, rate_to)
    real(wp), intent(in) :: from, rate_from, to, rate_to
    least_between = min(from, to, from + rate_from/3.0_wp, to - rate_to/3.0_wp)
  end function least_between

  !> End of the motion from (q, v) at time `start` within h, if it ends.
  subroutine find_stop(system, n, lane, frequencies, q, v, start, h, stop, visitor)
    class(driven_system_type), intent(in), target :: system
    !> Coordinates of the motion itself (others may diverge); lane of the block whose
    !! parameters are used; circular frequencies of the loads, shape (n_lanes, n_drives).
    integer, intent(in) :: n, lane
    real(wp), intent(in) :: frequencies(:, :)
    !> Shape (system%n_dof).
    real(wp), intent(in) :: q(:), v(:), start, h
    type(stop_type), intent(out) :: stop
    !> Only if all lanes have the same parameters, and no coordinate diverges.
    class(step_visitor), intent(inout), optional :: visitor
    type(scout_type) :: begin, last
    type(equations_type) :: own

    own%system => system
    ! Component by component: the constructor of gfortran 12 copies arrays with strides wrongly.
    begin%lane = lane
    begin%n = n
    begin%start = start
    begin%frequencies = frequencies
    begin%q = q
    begin%v = v
    if (.not. allocated(system%frame)) then
      call new_explicit(own%method, system%n_dof, method_place, frequencies, &
                        spread(q, 1, n_lanes), spread(v, 1, n_lanes), start, &
                        spread(0.0_wp, 1, n_lanes))
    end if
    call make_small_steps(own, begin, h, last, stop, visitor)
  end subroutine find_stop

  !> The same of a run with memory at time `start`. The run is set to the stop, or remains at its
  !! state if the motion does not stop.
  subroutine find_stop_of_march(march, start, h, stop)
    class(march_type), intent(inout), target :: march
    real(wp), intent(in) :: start, h
    type(stop_type), intent(out) :: stop
    type(scout_type) :: begin, last
    type(equations_type) :: own

    own%march => march
    call march%sharpen()
    begin%start = start
    begin%memory = march%save_memory()
    call march%get_state(begin%q, begin%v)
    begin%n = size(begin%q)
    call make_small_steps(own, begin, h, last, stop)
    if (stop%outcome == run_completed .or. stop%outcome == run_coarse) last = begin
    call march%load_memory(last%memory, .false.)
  end subroutine find_stop_of_march

  !> Small steps up to h or to the stop; `at` is the last state.
  subroutine make_small_steps(own, begin, h, at, stop, visitor)
    type(equations_type), intent(inout) :: own
    type(scout_type), intent(in) :: begin
    real(wp), intent(in) :: h
    type(scout_type), intent(out) :: at
    type(stop_type), intent(out) :: stop
    class(step_visitor), intent(inout), optional :: visitor
    logical :: halting(size(ieee_all))

    at = begin
    ! Steps that are too large may overflow; the result shows it.
    call ieee_get_halting_mode(ieee_all, halting)
    call ieee_set_halting_mode(ieee_all, .false.)
    if (associated(own%march)) then
      call halve_and_double(own, h, at, stop)
    else
      call adapt_steps(own, h, at, stop, visitor)
    end if
    if (.not. allocated(stop%q)) then
      stop%ahead = at%ahead
      stop%q = at%q
      stop%v = at%v
    end if
    call ieee_set_flag(ieee_all, .false.)
    call ieee_set_halting_mode(ieee_all, halting)
  end subroutine make_small_steps

  !> Small steps of a run with memory.
  subroutine halve_and_double(own, h, at, stop)
    type(equations_type), intent(inout) :: own
    real(wp), intent(in) :: h
    type(scout_type), intent(inout) :: at
    type(stop_type), intent(inout) :: stop
    type(scout_type) :: whole, half, rest, double
    real(wp) :: s, shortest, scale_of_motion
    real(wp), allocatable :: parts(:)
    integer :: i

    stop%outcome = run_coarse
    s = 0.5_wp*h
    scale_of_motion = max(maxval(abs(at%q)), own%march%furthest())
    shortest = 4.0_wp*spacing(abs(at%start) + h)
    allocate (stop%lengths(0))
    do i = 1, max_steps
      s = min(s, h - at%ahead)
      if (s <= shortest) then
        if (h - at%ahead > shortest .and. maxval(abs(at%q)) > far*scale_of_motion) then
          stop%outcome = run_diverged
        end if
        return
      end if
      call step_from(own, at, s, whole)
      call step_from(own, at, 0.5_wp*s, half)
      if (at%start + at%ahead > 0.0_wp) then
        call step_from(own, half, 0.5_wp*s, double)
        parts = [0.5_wp, 0.5_wp]
      else
        ! The second half of a first step ends like a first step: it is split in two.
        call step_from(own, half, 0.25_wp*s, rest)
        call step_from(own, rest, 0.25_wp*s, double)
        parts = [0.5_wp, 0.25_wp, 0.25_wp]
      end if
      if (apart(whole, double, s, with_memory) <= 1.0_wp) then
        at = double
        stop%lengths = [stop%lengths, s*parts]
        s = 2.0_wp*s
      else
        s = 0.5_wp*s
      end if
    end do
  end subroutine halve_and_double

  !> Small steps without memory.
  subroutine adapt_steps(own, h, at, stop, visitor)
    type(equations_type), intent(inout) :: own
    real(wp), intent(in) :: h
    type(scout_type), intent(inout) :: at
    type(stop_type), intent(inout) :: stop
    class(step_visitor), intent(inout), optional :: visitor
    type(scout_type) :: whole, half, double
    real(wp) :: s, shortest, miss, margin, lost
    integer :: n_far, n_near

    s = h
    stop%outcome = run_coarse
    shortest = 4.0_wp*max(spacing(abs(at%start) + h), tiny(1.0_wp))
    n_far = 0
    n_near = 0
    do while (n_far < max_steps .and. n_near < max_near)
      s = min(s, h - at%ahead)
      margin = margin_of(own%system, at)
      if (s <= shortest) then
        if (h - at%ahead > shortest) then
          stop%outcome = merge(run_unphysical, run_diverged, margin <= edge)
        else
          stop%outcome = run_completed
        end if
        exit
      end if
      lost = (margin - margin_of(own%system, moved(at, s)))/s
      if (lost > 0.0_wp) then
        if (margin <= edge) then
          ! Straight line to the edge.
          stop%outcome = run_unphysical
          call show_line(at, min(h - at%ahead, margin/lost), visitor)
          at%ahead = min(h, at%ahead + margin/lost)
          exit
        end if
        ! Its start does not depend on the run.
        if (margin <= 2.0_wp*edge) s = min(s, (margin - edge*(1.0_wp - 1.0e-9_wp))/lost)
      end if
      at%implicit = is_stiff(own%system, at, s)
      stop%near_edge = stop%near_edge &
                       .or. needs_small_steps(own%system, at%lane, at%q, at%v, h, margin)
      if (margin > near) n_far = n_far + 1
      if (.not. margin > near) n_near = n_near + 1
      call step_from(own, at, s, whole)
      call step_from(own, at, 0.5_wp*s, half)
      call step_from(own, half, 0.5_wp*s, double)
      miss = apart(whole, double, h, closeness)
      if (.not. miss <= 1.0_wp) then
        s = s*max(0.2_wp, 0.9_wp*miss**(-1.0_wp/order))
      else if (at%implicit .and. leaves(own%system, whole)) then
        ! Go to the start of the straight line: beyond it rounding dominates.
        lost = margin - margin_of(own%system, whole)
        s = s*min(0.9_wp, (margin - 1.5_wp*edge)/lost)
      else if (leaves(own%system, whole)) then
        call bisect(own, at, s, shortest, stop)
        call show_step(own, at, stop%ahead - at%ahead, visitor)
        return
      else if (min(least_margin(own%system, at, half, 0.5_wp*s), &
                   least_margin(own%system, half, double, 0.5_wp*s)) <= 0.0_wp) then
        ! Smaller steps decide whether it leaves in between.
        s = 0.5_wp*s
      else
        call show_step(own, at, s, visitor)
        at = double
        s = s*min(4.0_wp, 0.9_wp*max(miss, tiny(1.0_wp))**(-1.0_wp/order))
      end if
    end do
  end subroutine adapt_steps

  !> The last state before a motion leaves within a resolved step of length s.
  subroutine bisect(own, at, s, shortest, stop)
    type(equations_type), intent(inout) :: own
    type(scout_type), intent(in) :: at
    !> Its length; shorter times are negligible.
    real(wp), intent(in) :: s, shortest
    type(stop_type), intent(out) :: stop
    type(scout_type) :: inside, outside, try
    real(wp) :: low, high, middle
    logical :: at_edge

    low = 0.0_wp
    high = s
    inside = at
    call step_from(own, at, s, outside)
    do
      middle = 0.5_wp*(low + high)
      if (middle <= low .or. middle >= high) exit
      if (high - low <= spacing(at%start + at%ahead + high)) exit
      call step_from(own, at, middle, try)
      if (leaves(own%system, try)) then
        high = middle
        outside = try
      else
        low = middle
        inside = try
      end if
    end do
    ! At the edge of the physical range velocities may be infinite.
    at_edge = in_range(own%system, outside%q(:at%n), outside%v(:at%n)) &
              .or. margin_of(own%system, inside) <= edge
    stop%outcome = merge(run_unphysical, run_diverged, at_edge)
    ! A wall accelerates it strongly in a negligible time.
    if (.not. at_edge .and. low <= shortest) inside = at
    stop%ahead = inside%ahead
    stop%q = inside%q
    stop%v = inside%v
  end subroutine bisect

  !> The same trajectory a time s later.
  subroutine step_from(own, at, s, next)
    type(equations_type), intent(inout) :: own
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: s
    type(scout_type), intent(out) :: next
    real(wp), dimension(n_lanes, size(at%q)) :: q, v
    real(wp), dimension(n_nodes, size(at%q)) :: q_nodes, v_nodes
    real(wp) :: h(n_lanes)
    type(modal_gauss_type) :: sections

    next = at
    next%ahead = at%ahead + s
    if (.not. at%made) return
    if (associated(own%march)) then
      call own%march%load_memory(at%memory, .false.)
      call own%march%change_step(at%start + at%ahead, s, next%made)
      if (next%made) call own%march%step(at%start + next%ahead, next%made)
      call own%march%get_state(next%q, next%v)
      next%memory = own%march%save_memory()
      return
    end if
    if (allocated(own%system%frame)) then
      call new_modal_gauss(sections, own%system, section_nodes, at%q, at%v, at%start + at%ahead, &
                           s, solved)
      if (own%system%timed) sections%since = at%start - own%system%present_piece(1) + at%ahead
      call sections%step(own%system, next%made)
      next%q = sections%q
      next%v = sections%v
      return
    end if
    if (at%implicit) then
      call nodes_of(own%system, at, s, q_nodes, v_nodes, next%made)
      next%q = q_nodes(n_nodes, :)
      next%v = v_nodes(n_nodes, :)
      return
    end if
    h = 0.0_wp
    h(at%lane) = s
    call begin_at(own, at, h)
    call own%method%step(own%system)
    call own%method%get_state(q, v)
    next%q = q(at%lane, :)
    next%v = v(at%lane, :)
  end subroutine step_from

  !> True if the damping of a motion is too fast for an explicit step.
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

  !> States at the nodes of an implicit step; the state at its start if the step fails.
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

  !> Put all lanes at the state of a trajectory, each with its own step.
  subroutine begin_at(own, at, h)
    type(equations_type), intent(inout) :: own
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: h(n_lanes)
    associate (method => own%method, system => own%system)
      call method%begin_again(at%frequencies, spread(at%q, 1, n_lanes), spread(at%v, 1, n_lanes), &
                              at%start + at%ahead, h)
      if (allocated(system%quarters)) call method%turn_phases(system%quarters)
      if (system%timed) method%since = at%start - system%present_piece(1) + at%ahead
    end associate
  end subroutine begin_at

  !> Show a small step to the visitor: by steps to eight Gauss nodes, one per lane, which have the
  !! order of the method; an implicit step by its nodes.
  subroutine show_step(own, at, s, visitor)
    type(equations_type), intent(inout) :: own
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: s
    class(step_visitor), intent(inout), optional :: visitor
    type(scout_type) :: last
    real(wp), dimension(n_lanes, size(at%q)) :: q, v
    real(wp), dimension(n_nodes, size(at%q)) :: q_nodes, v_nodes
    real(wp) :: nodes(n_lanes), weights(n_lanes)

    if (.not. present(visitor)) return
    if (at%implicit) then
      last = at
      call nodes_of(own%system, at, s, q_nodes, v_nodes, last%made)
      last%q = q_nodes(n_nodes, :)
      last%v = v_nodes(n_nodes, :)
      call show(at, s, radau_nodes(:n_nodes - 1), q_nodes(:n_nodes - 1, :), &
                v_nodes(:n_nodes - 1, :), last, visitor)
      return
    end if
    call step_from(own, at, s, last)
    call gauss_nodes(n_lanes, nodes, weights)
    call begin_at(own, at, s*nodes)
    call own%method%step(own%system)
    call own%method%get_state(q, v)
    call show(at, s, nodes, q, v, last, visitor)
  end subroutine show_step

  !> Show the straight line to the visitor.
  subroutine show_line(at, s, visitor)
    type(scout_type), intent(in) :: at
    real(wp), intent(in) :: s
    class(step_visitor), intent(inout), optional :: visitor
    real(wp) :: none(0, size(at%q))
    if (.not. present(visitor)) return
    call show(at, s, none(:, 1), none, none, moved(at, s), visitor)
  end subroutine show_line

  !> Show the motion by its states at both ends of a step and at points between.
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

  !> Difference of two ends of a step in units of the allowed difference; huge if one of them
  !! is not finite.
  pure real(wp) function apart(one, other, h, allowed)
    type(scout_type), intent(in) :: one, other
    !> Time that converts velocities to displacements; difference relative to the state.
    real(wp), intent(in) :: h, allowed
    real(wp) :: size_of
    apart = huge(1.0_wp)
    if (.not. (one%made .and. other%made)) return
    associate (n => one%n)
      ! Test each number: a maximum skips NaN.
      if (.not. (all(abs(one%q(:n)) <= huge(1.0_wp)) .and. all(abs(one%v(:n)) <= huge(1.0_wp)) &
                 .and. all(abs(other%q(:n)) <= huge(1.0_wp)) &
                 .and. all(abs(other%v(:n)) <= huge(1.0_wp)))) return
      size_of = maxval(abs(other%q(:n))) + h*maxval(abs(other%v(:n)))
      size_of = max(size_of, tiny(1.0_wp))
      apart = max(maxval(abs(one%q(:n) - other%q(:n))), &
                  h*maxval(abs(one%v(:n) - other%v(:n))))/(allowed*size_of)
      if (.not. apart <= huge(1.0_wp)) apart = huge(1.0_wp)
    end associate
  end function apart

  !> True if a state is outside of the range of numbers or of the physical range.
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

  !> Lower bound of the margin between two states that are a time s apart.
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
