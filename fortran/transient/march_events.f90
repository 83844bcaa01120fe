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
  use viscovib_event_time, only: signal_in_step
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
  !> Distance for accelerations, relative to a part.
  real(wp), parameter :: closely = 1.0e-4_wp

  !> A signal along a part of the last step of a run.
  type, extends(signal_in_step) :: signal_of_march
    class(march_type), pointer :: run => null()
    type(base_motion_type), pointer :: base => null()
    !> Start of the step and its length; begin and width of the part relative to the step.
    real(wp) :: from = 0.0_wp, length = 0.0_wp, begin = 0.0_wp, width = 1.0_wp
  contains
    procedure :: go
  end type signal_of_march

contains

  !> Look for events in the last step; one that ends the run sets the outcome and its time.
  subroutine look_inside(run, base, watch, from, now, t_reached, outcome)
    class(march_type), intent(inout), target :: run
    type(base_motion_type), intent(inout), target :: base
    type(watch_type), intent(inout), target :: watch
    real(wp), intent(in) :: from, now
    real(wp), intent(inout) :: t_reached
    integer, intent(inout) :: outcome
    real(wp) :: u(run%n_observed()), v(run%n_observed())
    real(wp) :: begin, width, place
    type(step_path), target :: path
    type(signal_of_march) :: along
    logical :: settled
    type(event_point_type), allocatable :: found(:)
    integer :: i

    if (.not. allocated(watch%path)) call prepare(watch, size(u))
    path = watch%path
    along%run => run
    along%base => base
    along%path => path
    along%reads = watch%reads
    along%q = u
    along%v = v
    along%from = from
    along%length = now - from
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
        along%signal => watch%signals(found(i)%which)
        along%side = found(i)%side
        along%begin = begin
        along%width = width
        along%is_smooth = width > 0.5_wp**most_halvings
        place = found(i)%place
        call along%settle(place, settled)
        if (.not. settled) call along%go(place)
        u = along%q
        v = along%v
        t_reached = path%start + place*path%h
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
      real(wp) :: a(run%n_observed()), nearby
      nearby = place - closely
      if (begin + width*nearby < 0.0_wp) nearby = place + closely
      call along%go(nearby)
      a = (v - along%v)/((place - nearby)*path%h)
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

  !> State of the body at a position in the part.
  subroutine go(self, x)
    class(signal_of_march), intent(inout) :: self
    real(wp), intent(in) :: x
    real(wp) :: place
    place = self%begin + self%width*x
    if (place < 1.0_wp) then
      call self%run%inside(place, self%q, self%v)
    else
      call self%run%observe(self%q, self%v)
    end if
    call self%base%add_to(self%from + place*self%length, self%q, self%v)
  end subroutine go

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
