!> Events in the steps of a run with memory or of a structure, whose inside no polynomial of the
!! step follows: the first step with memory is singular, and modes that swing many times in a step
!! go on exactly.
!!
!! A step is searched in parts. Of each the signals are sampled at the nodes of Gauss's rule and at
!! both ends. A part is halved until each signal either is its interpolant, the last coefficients
!! in Legendre polynomials being small, or stays on its side by more than these. A passage found by
!! the interpolant is then found again by the motion itself.
module viscovib_march_events
  use viscovib_base_motion, only: base_motion_type
  use viscovib_kinds, only: wp
  use viscovib_march, only: march_type
  use viscovib_quadrature, only: gauss_nodes, legendre
  use viscovib_simulate, only: run_event
  use viscovib_step_path, only: new_path, step_path
  use viscovib_watch, only: passage_type, watch_type
  implicit none
  private

  public :: look_inside

  !> Nodes of a part.
  integer, parameter :: n_nodes = 10
  !> Last coefficients, relative to the largest value of a signal, at which the interpolant stands
  !! for it; a signal further from 0 than so many times its last coefficients does not pass.
  real(wp), parameter :: resolved = 1.0e-9_wp, clear = 10.0_wp
  !> Halvings at most: a signal with a kink or a jump is its interpolant nowhere beside it.
  integer, parameter :: most_halvings = 16

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
    real(wp) :: nodes(n_nodes), last(n_nodes, 2)
    real(wp) :: largest(size(watch%signals)), begin, width, place
    type(step_path) :: path
    type(passage_type), allocatable :: found(:)
    integer :: i

    if (size(watch%signals) == 0) return
    call coefficients_of_nodes(nodes, last)
    call new_path(path, [0.0_wp, nodes, 1.0_wp])
    allocate (path%q(n_nodes + 2, size(u)), path%v(n_nodes + 2, size(u)))
    largest = watch%largest
    begin = 0.0_wp
    width = 1.0_wp
    do while (begin < 1.0_wp)
      call sample()
      do while (width > 0.5_wp**most_halvings .and. .not. follows(watch, path, last, largest))
        width = 0.5_wp*width
        call sample()
      end do
      call watch%look(path, .false., found)
      do i = 1, size(found)
        place = begin + width*found(i)%place
        call settle(place)
        call body_at(run, base, from, now, place, u, v)
        t_reached = from + place*(now - from)
        call watch%keep(found(i)%which, t_reached, u, v)
        if (.not. watch%terminal(found(i)%which)) cycle
        outcome = run_event
        return
      end do
      begin = begin + width
      ! Halves of the same part begin at whole multiples of its length.
      if (modulo(begin, 2.0_wp*width) <= 0.0_wp) width = min(2.0_wp*width, 1.0_wp - begin)
    end do

  contains

    !> The motion of the present part.
    subroutine sample()
      integer :: k
      path%start = from + begin*(now - from)
      path%h = width*(now - from)
      do k = 1, n_nodes + 2
        call body_at(run, base, from, now, begin + width*path%points(k), u, v)
        path%q(k, :) = u
        path%v(k, :) = v
      end do
    end subroutine sample

    !> The place of a passage by the motion itself, near to that by the interpolant of a part.
    subroutine settle(x)
      real(wp), intent(inout) :: x
      real(wp) :: low, high, reach, middle
      integer :: k

      reach = 4.0_wp*epsilon(1.0_wp)*max(x, width)
      do k = 1, 12
        low = max(x - reach, begin)
        high = min(x + reach, begin + width)
        if (.not. beyond(low) .and. beyond(high)) exit
        reach = 8.0_wp*reach
      end do
      if (k > 12) return
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
    end subroutine settle

    !> Whether the signal of the present passage has passed 0 at a place.
    logical function beyond(x)
      real(wp), intent(in) :: x
      real(wp) :: g(1)
      call body_at(run, base, from, now, x, u, v)
      associate (signal => watch%signals(found(i)%which))
        call signal%at([from + x*(now - from)], reshape(u, [1, size(u)]), &
                       reshape(v, [1, size(v)]), g)
      end associate
      beyond = found(i)%side*g(1) < 0.0_wp
    end function beyond

  end subroutine look_inside

  !> State of the body at a place of the step.
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

  !> Whether the interpolants of a part tell all passages.
  logical function follows(watch, path, last, largest)
    type(watch_type), intent(in) :: watch
    type(step_path), intent(in) :: path
    !> What makes of a signal at the nodes its last coefficients; largest values so far.
    real(wp), intent(in) :: last(:, :)
    real(wp), intent(inout) :: largest(:)
    real(wp) :: g(n_nodes + 2), rest
    integer :: k

    follows = .true.
    do k = 1, size(watch%signals)
      call watch%signals(k)%at(path%start + path%h*path%points, path%q, path%v, g)
      largest(k) = max(largest(k), maxval(abs(g)))
      rest = sum(abs(matmul(g(2:n_nodes + 1), last)))
      if (rest <= resolved*largest(k)) cycle
      if (watch%sides(k) == 0 .or. .not. minval(watch%sides(k)*g) > clear*rest) follows = .false.
    end do
  end function follows

  !> Nodes of a part, and what makes of a signal there its last two coefficients.
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
