!> Events in the steps of a run with memory or of a structure. No polynomial of the
!! step represents the motion inside: the first step with memory is singular, and modes that
!! oscillate many times in a step are integrated exactly.
!!
!! A step is searched in parts. In each part the signals are sampled at the Gauss nodes and at
!! both ends. A part is bisected until the interpolants represent the arguments of each signal:
!! the last Legendre coefficients are small. A crossing of the interpolant is then
!! refined on the motion itself: by Newton's method with the slope of the interpolant, if it is
!! accurate enough, else by bisection.
module viscovib_march_events
  use viscovib_base_motion, only: base_motion_type
  use viscovib_event_search, only: signal_along
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: put_argument
  use viscovib_march, only: march_type
  use viscovib_quadrature, only: gauss_nodes, legendre
  use viscovib_step_path, only: new_path, step_path
  use viscovib_time_run, only: run_event
  use viscovib_watch, only: event_point_type, watch_type
  implicit none
  private

  public :: look_inside

  !> Nodes of a part.
  integer, parameter :: n_nodes = 10
  !> Bound of the last coefficients, relative to the largest value of an argument, at which the
  !! interpolant is accepted.
  real(wp), parameter :: resolved = 1.0e-9_wp
  !> Largest number of bisections: a signal with a kink or a jump differs from its interpolant
  !! everywhere near it.
  integer, parameter :: most_halvings = 16
  !> Relative to a part: distance for the slope of an interpolant, largest correction of a
  !! crossing by the motion itself; relative to a position: correction at convergence.
  real(wp), parameter :: closely = 1.0e-4_wp, nearly = 1.0e-6_wp, exactly = 1.0e-12_wp

contains

  !> Look for events in the last step; one that ends the run sets the outcome and its time.
  subroutine look_inside(run, base, watch, from, now, t_reached, outcome)
    class(march_type), intent(inout) :: run
    type(base_motion_type), intent(inout) :: base
    type(watch_type), intent(inout) :: watch
    real(wp), intent(in) :: from, now
    real(wp), intent(inout) :: t_reached
    integer, intent(inout) :: outcome
    real(wp) :: u(run%n_observed()), v(run%n_observed())
    real(wp) :: begin, width, place
    type(step_path) :: path
    type(event_point_type), allocatable :: found(:)
    integer :: i

    if (watch%is_idle()) return
    if (.not. allocated(watch%path)) call prepare(watch, size(u))
    path = watch%path
    begin = 0.0_wp
    width = 1.0_wp
    do while (begin < 1.0_wp)
      call sample()
      do while (width > 0.5_wp**most_halvings .and. .not. follows(watch, path))
        width = 0.5_wp*width
        call sample()
      end do
      call watch%extremes%take(path)
      call watch%look(path, .false., found)
      do i = 1, size(found)
        place = begin + width*found(i)%place
        call settle(run, base, watch, path, found(i), from, now, begin, width, place, u, v)
        t_reached = from + place*(now - from)
        call watch%keep(found(i), t_reached, u, v, nearby_rate(place))
        if (.not. watch%terminal(found(i)%which)) cycle
        outcome = run_event
        return
      end do
      begin = begin + width
      ! Halves of the same part begin at whole multiples of its length.
      if (modulo(begin, 2.0_wp*width) <= 0.0_wp) width = min(2.0_wp*width, 1.0_wp - begin)
    end do

  contains

    !> Accelerations at a position where velocities are v, by a difference quotient.
    function nearby_rate(place) result(a)
      real(wp), intent(in) :: place
      real(wp), dimension(run%n_observed()) :: a, other, speed
      real(wp) :: nearby
      nearby = place - closely*width
      if (nearby < 0.0_wp) nearby = place + closely*width
      call body_at(run, base, from, now, nearby, other, speed)
      a = (v - speed)/((place - nearby)*(now - from))
    end function nearby_rate

    !> Sample the motion of the present part.
    subroutine sample()
      integer :: k
      path%start = from + begin*(now - from)
      path%h = width*(now - from)
      call run%inside_part(begin, width, path%points, watch%reads, path%q, path%v)
      if (.not. base%moves()) return
      do k = 1, n_nodes + 2
        u = 0.0_wp
        v = 0.0_wp
        call base%add_to(path%start + path%points(k)*path%h, u, v)
        path%q(k, :) = path%q(k, :) + u(watch%reads)
        path%v(k, :) = path%v(k, :) + v(watch%reads)
      end do
    end subroutine sample

  end subroutine look_inside

  !> Position of a crossing of the motion itself, near that of the interpolant of a part, and
  !! the state there.
  subroutine settle(run, base, watch, path, event_point, from, now, begin, width, x, u, v)
    class(march_type), intent(inout) :: run
    type(base_motion_type), intent(in) :: base
    type(watch_type), intent(in) :: watch
    !> The part, the crossing in it, ends of the step, the part in the step.
    type(step_path), intent(in) :: path
    type(event_point_type), intent(in) :: event_point
    real(wp), intent(in) :: from, now, begin, width
    real(wp), intent(inout) :: x
    real(wp), intent(out) :: u(:), v(:)
    real(wp) :: low, high, reach, middle, first
    logical :: settled
    integer :: k

    first = x
    call by_slope(x, settled)
    if (settled) return
    x = first
    reach = 4.0_wp*epsilon(1.0_wp)*max(x, width)
    do k = 1, 12
      low = max(x - reach, begin)
      high = min(x + reach, begin + width)
      if (.not. beyond(low) .and. beyond(high)) exit
      reach = 8.0_wp*reach
    end do
    if (k <= 12) then
      do k = 1, 60
        middle = 0.5_wp*(low + high)
        if (middle <= low .or. middle >= high) exit
        if (beyond(middle)) then
          high = middle
        else
          low = middle
        end if
      end do
      x = high
    end if
    call body_at(run, base, from, now, x, u, v)

  contains

    !> Newton's method; `settled`: it has converged, (u, v) is the state at x.
    subroutine by_slope(x, settled)
      real(wp), intent(inout) :: x
      logical, intent(out) :: settled
      real(wp) :: g(2), nearby(2), off, before, ahead
      integer :: k

      settled = .false.
      if (width <= 0.5_wp**most_halvings) return
      associate (local => (x - begin)/width, signal => watch%signals(event_point%which))
        nearby = min(max([local - closely, local + closely], 0.0_wp), 1.0_wp)
        call signal_along(signal, path, nearby, g)
        if (.not. event_point%side*(g(2) - g(1)) < 0.0_wp) return
        ahead = (nearby(2) - nearby(1))*width/(g(2) - g(1))
      end associate
      before = nearly*width
      do k = 1, 4
        off = -value_at(x)*ahead
        if (.not. abs(off) <= before) return
        ! The remainder is below the rounding of time, and changes no digit of the state.
        if (abs(off) <= exactly*max(x, width)) then
          u = u + off*(now - from)*v
          x = x + off
          settled = .true.
          return
        end if
        x = min(max(x + off, begin), begin + width)
        before = 1.0e-2_wp*abs(off)
      end do
    end subroutine by_slope

    !> True if the signal of the present crossing has passed 0 at a position.
    logical function beyond(x)
      real(wp), intent(in) :: x
      beyond = event_point%side*value_at(x) < 0.0_wp
    end function beyond

    !> The signal of the present crossing at a position; the state there is (u, v).
    real(wp) function value_at(x)
      real(wp), intent(in) :: x
      real(wp) :: g(1)
      call body_at(run, base, from, now, x, u, v)
      associate (which => watch%reads, signal => watch%signals(event_point%which))
        call signal%at([from + x*(now - from)], reshape(u(which), [1, size(which)]), &
                       reshape(v(which), [1, size(which)]), g)
      end associate
      value_at = g(1)
    end function value_at

  end subroutine settle

  !> Allocate the sample points of parts, once per run.
  subroutine prepare(watch, n)
    type(watch_type), intent(inout) :: watch
    !> Number of observed coordinates.
    integer, intent(in) :: n
    real(wp) :: nodes(n_nodes)
    integer :: i
    if (.not. allocated(watch%reads)) watch%reads = [(i, i=1, n)]
    allocate (watch%path, watch%last(n_nodes, 2))
    call coefficients_of_nodes(nodes, watch%last)
    call new_path(watch%path, [0.0_wp, nodes, 1.0_wp])
    associate (columns => size(watch%reads))
      allocate (watch%path%q(n_nodes + 2, columns), watch%path%v(n_nodes + 2, columns))
    end associate
  end subroutine prepare

  !> State of the body at a position in the step.
  subroutine body_at(run, base, from, now, x, u, v)
    class(march_type), intent(inout) :: run
    type(base_motion_type), intent(in) :: base
    real(wp), intent(in) :: from, now, x
    real(wp), intent(out) :: u(:), v(:)
    if (x < 1.0_wp) then
      call run%inside(x, u, v)
    else
      call run%observe(u, v)
    end if
    call base%add_to(from + x*(now - from), u, v)
  end subroutine body_at

  !> True if the interpolants of a part show all events.
  logical function follows(watch, path)
    type(watch_type), intent(inout) :: watch
    type(step_path), intent(in) :: path
    integer :: k

    follows = .true.
    if (watch%extremes%wanted) then
      do k = 1, 2*size(path%q, 2)
        if (.not. is_followed(watch, k, path)) follows = .false.
      end do
    end if
    do k = 1, size(watch%signals)
      if (.not. arguments_follow(watch, k, path)) follows = .false.
    end do
  end function follows

  !> True if interpolants represent the arguments of a signal. All its crossings can then be found,
  !! whatever the function.
  logical function arguments_follow(watch, which, path) result(follow)
    type(watch_type), intent(inout) :: watch
    integer, intent(in) :: which
    type(step_path), intent(in) :: path
    integer :: i, k

    follow = .true.
    associate (law => watch%signals(which)%program)
      do i = 1, size(law%code)
        if (law%code(i) /= put_argument) cycle
        k = nint(law%number(i))
        if (k > 2*size(path%q, 2)) cycle
        if (.not. is_followed(watch, k, path)) follow = .false.
      end do
    end associate
  end function arguments_follow

  !> True if the interpolant of a part represents a coordinate or a velocity.
  logical function is_followed(watch, k, path)
    type(watch_type), intent(inout) :: watch
    !> Its index in the state.
    integer, intent(in) :: k
    type(step_path), intent(in) :: path
    real(wp) :: values(n_nodes + 2)

    if (.not. allocated(watch%scales)) allocate (watch%scales(2*size(path%q, 2)), source=0.0_wp)
    if (modulo(k, 2) == 1) then
      values = path%q(:, (k + 1)/2)
    else
      values = path%v(:, k/2)
    end if
    watch%scales(k) = max(watch%scales(k), maxval(abs(values)))
    is_followed = sum(abs(matmul(values(2:n_nodes + 1), watch%last))) <= resolved*watch%scales(k)
  end function is_followed

  !> Nodes of a part, and the matrix from samples of a signal to its last two coefficients.
  subroutine coefficients_of_nodes(nodes, last)
    real(wp), intent(out) :: nodes(n_nodes), last(n_nodes, 2)
    real(wp) :: weights(n_nodes), p(0:n_nodes - 1)
    integer :: i
    call gauss_nodes(n_nodes, nodes, weights)
    do i = 1, n_nodes
      p = legendre(n_nodes - 1, nodes(i))
      last(i, :) = weights(i)*[2*n_nodes - 3, 2*n_nodes - 1]*p(n_nodes - 2:)
    end do
  end subroutine coefficients_of_nodes

end module viscovib_march_events
