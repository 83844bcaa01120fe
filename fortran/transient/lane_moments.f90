!> Largest absolute value, mean and mean square of states, accumulated along trajectories without
!! storing them: one accumulator per lane.
!!
!! The values are those of the motion itself, not of samples. In a step the motion is represented by
!! the polynomial of degree 8 through the coordinates q, their velocities and accelerations at both
!! ends and at the end of a neighbouring step (Hermite's interpolation): its error is
!! (x (x - h) (x + h))^3 q^(9)/9! at x, at most 1.6e-7 h^9 |q^(9)|.
module viscovib_lane_moments
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof, n_lanes
  use viscovib_quadrature, only: gauss_nodes
  implicit none
  private

  public :: moments_type, new_moments

  integer, parameter :: degree = 8
  !> Nodes within a step of the rule that integrates squares.
  integer, parameter :: n_nodes = 6
  !> Iterations of Newton's method for the extremum of a polynomial, from its highest sample.
  integer, parameter :: n_newton = 4

  type :: moments_type
    integer, private :: n_dof = 0
    !> For each lane its step size, and the accumulated time in steps.
    real(wp), dimension(n_lanes), private :: h = 0.0_wp, length = 0.0_wp
    !> Number of known ends of steps, at most 3; part of a step that waits for a neighbouring end.
    integer, private :: n_ends = 0
    real(wp), private :: waiting = 0.0_wp
    !> q, h v and h^2 a at the last ends, the latest last: lane, which, end, coordinate.
    real(wp), private :: ends(n_lanes, 3, 3, max_dof) = 0.0_wp
    !> Lane, coordinate, and q or h v: largest sizes; integrals over the time in steps, and their
    !! rounding errors.
    real(wp), dimension(n_lanes, max_dof, 2), private :: peak = 0.0_wp, total = 0.0_wp
    real(wp), dimension(n_lanes, max_dof, 2), private :: squares = 0.0_wp
    real(wp), dimension(n_lanes, max_dof, 2), private :: total_rest = 0.0_wp, squares_rest = 0.0_wp
    !> Positions in a step from 0 to 1: both ends and nodes between; weights of the nodes.
    real(wp), private :: places(0:n_nodes + 1) = 0.0_wp, weights(n_nodes) = 0.0_wp
  contains
    procedure :: begin
    procedure :: add
    procedure :: hand_over
    procedure, private :: shift
    procedure, private :: take_in
    procedure, private :: take_in_one
  end type moments_type

contains

  pure subroutine new_moments(moments, n_dof, h)
    type(moments_type), intent(out) :: moments
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: h(n_lanes)
    moments%n_dof = n_dof
    moments%h = h
    call gauss_nodes(n_nodes, moments%places(1:n_nodes), moments%weights)
    moments%places(n_nodes + 1) = 1.0_wp
  end subroutine new_moments

  !> Set the start of the first step that counts, or of a step before it.
  pure subroutine begin(self, q, v, a)
    class(moments_type), intent(inout) :: self
    real(wp), dimension(n_lanes, *), intent(in) :: q, v, a
    call self%shift(q, v, a)
  end subroutine begin

  !> Add the last part of a step whose end is given; stopped lanes are left
  !! out.
  pure subroutine add(self, q, v, a, alive, part)
    class(moments_type), intent(inout) :: self
    real(wp), dimension(n_lanes, *), intent(in) :: q, v, a
    logical, intent(in) :: alive(n_lanes)
    !> The part of the step.
    real(wp), intent(in) :: part

    call self%shift(q, v, a)
    if (self%n_ends < 3) then
      self%waiting = part
      return
    end if
    if (self%waiting > 0.0_wp) call self%take_in(0.0_wp, self%waiting, alive)
    self%waiting = 0.0_wp
    call self%take_in(1.0_wp, part, alive)
  end subroutine add

  pure subroutine shift(self, q, v, a)
    class(moments_type), intent(inout) :: self
    real(wp), dimension(n_lanes, *), intent(in) :: q, v, a
    integer :: d

    do d = 1, self%n_dof
      self%ends(:, :, 1, d) = self%ends(:, :, 2, d)
      self%ends(:, :, 2, d) = self%ends(:, :, 3, d)
      self%ends(:, 1, 3, d) = q(:, d)
      self%ends(:, 2, 3, d) = self%h*v(:, d)
      self%ends(:, 3, 3, d) = self%h**2*a(:, d)
    end do
    self%n_ends = min(self%n_ends + 1, 3)
  end subroutine shift

  !> Accumulate the last part of the step that ends at 1, or at 0, of the last steps.
  pure subroutine take_in(self, until, part, alive)
    class(moments_type), intent(inout) :: self
    real(wp), intent(in) :: until, part
    logical, intent(in) :: alive(n_lanes)
    real(wp), dimension(n_lanes, 0:degree) :: of_q, of_v
    real(wp) :: places(0:n_nodes + 1)
    integer :: d, k

    self%length = self%length + merge(part, 0.0_wp, alive)
    places = until - part*(1.0_wp - self%places)
    do d = 1, self%n_dof
      if (self%n_ends == 3) then
        call through_three(self%ends(:, :, :, d), of_q)
      else
        call through_two(self%ends(:, :, 2:, d), of_q)
      end if
      do k = 1, degree
        of_v(:, k - 1) = k*of_q(:, k)
      end do
      of_v(:, degree) = 0.0_wp
      call self%take_in_one(of_q, places, part, alive, d, 1)
      call self%take_in_one(of_v, places, part, alive, d, 2)
    end do
  end subroutine take_in

  !> Coefficients of the polynomial through three ends, at -1, 0 and 1. Even and odd powers from
  !! the third on follow from their sums, and those of their first and second derivatives, at 1.
  pure subroutine through_three(ends, c)
    !> Lane; value, first and second derivative; end.
    real(wp), intent(in) :: ends(n_lanes, 3, 3)
    real(wp), intent(out) :: c(n_lanes, 0:degree)
    real(wp) :: even_1, even_2, even_3, odd_1, odd_2, odd_3
    integer :: l

    !GCC$ unroll 1
    do l = 1, n_lanes
      c(l, 0) = ends(l, 1, 2)
      c(l, 1) = ends(l, 2, 2)
      c(l, 2) = 0.5_wp*ends(l, 3, 2)
      even_1 = 0.5_wp*((ends(l, 1, 3) - ends(l, 1, 2)) + (ends(l, 1, 1) - ends(l, 1, 2))) - c(l, 2)
      even_2 = 0.5_wp*(ends(l, 2, 3) - ends(l, 2, 1)) - 2.0_wp*c(l, 2)
      even_3 = 0.5_wp*(ends(l, 3, 3) + ends(l, 3, 1)) - 2.0_wp*c(l, 2)
      odd_1 = 0.5_wp*(ends(l, 1, 3) - ends(l, 1, 1)) - c(l, 1)
      odd_2 = 0.5_wp*(ends(l, 2, 3) + ends(l, 2, 1)) - c(l, 1)
      odd_3 = 0.5_wp*(ends(l, 3, 3) - ends(l, 3, 1))
      c(l, 8) = 0.125_wp*(even_3 - 9.0_wp*even_2 + 24.0_wp*even_1)
      c(l, 6) = 0.5_wp*(even_2 - 4.0_wp*even_1) - 2.0_wp*c(l, 8)
      c(l, 4) = even_1 - c(l, 6) - c(l, 8)
      c(l, 7) = 0.125_wp*(odd_3 - 7.0_wp*odd_2 + 15.0_wp*odd_1)
      c(l, 5) = 0.5_wp*(odd_2 - 3.0_wp*odd_1) - 2.0_wp*c(l, 7)
      c(l, 3) = odd_1 - c(l, 5) - c(l, 7)
    end do
  end subroutine through_three

  !> The same through two ends, at 0 and 1, for a run of a single step.
  pure subroutine through_two(ends, c)
    real(wp), intent(in) :: ends(n_lanes, 3, 2)
    real(wp), intent(out) :: c(n_lanes, 0:degree)
    real(wp) :: sums(n_lanes, 3)

    c = 0.0_wp
    c(:, 0) = ends(:, 1, 1)
    c(:, 1) = ends(:, 2, 1)
    c(:, 2) = 0.5_wp*ends(:, 3, 1)
    sums(:, 1) = ends(:, 1, 2) - c(:, 0) - c(:, 1) - c(:, 2)
    sums(:, 2) = ends(:, 2, 2) - c(:, 1) - 2.0_wp*c(:, 2)
    sums(:, 3) = ends(:, 3, 2) - 2.0_wp*c(:, 2)
    c(:, 3) = 10.0_wp*sums(:, 1) - 4.0_wp*sums(:, 2) + 0.5_wp*sums(:, 3)
    c(:, 4) = -15.0_wp*sums(:, 1) + 7.0_wp*sums(:, 2) - sums(:, 3)
    c(:, 5) = 6.0_wp*sums(:, 1) - 3.0_wp*sums(:, 2) + 0.5_wp*sums(:, 3)
  end subroutine through_two

  !> Accumulate a coordinate (which = 1) or its velocity (2), from its polynomial.
  pure subroutine take_in_one(self, c, places, part, alive, d, which)
    class(moments_type), intent(inout) :: self
    real(wp), intent(in) :: c(n_lanes, 0:degree), places(0:n_nodes + 1), part
    logical, intent(in) :: alive(n_lanes)
    integer, intent(in) :: d, which
    real(wp) :: x(n_lanes, 0:n_nodes + 1), samples(0:n_nodes + 1), series(0:degree)
    real(wp), dimension(n_lanes) :: mean, square, highest, rise
    integer :: k, l

    call evaluate(c, places, x)
    mean = 0.0_wp
    square = 0.0_wp
    highest = abs(x(:, 0))
    rise = 0.0_wp
    do k = 1, n_nodes + 1
      !GCC$ unroll 1
      do l = 1, n_lanes
        highest(l) = max(highest(l), abs(x(l, k)))
        rise(l) = max(rise(l), abs(x(l, k) - x(l, k - 1)))
      end do
    end do
    do k = 1, n_nodes
      !GCC$ unroll 1
      do l = 1, n_lanes
        mean(l) = mean(l) + part*self%weights(k)*x(l, k)
        square(l) = square(l) + part*self%weights(k)*x(l, k)**2
      end do
    end do
    call add_one(merge(mean, 0.0_wp, alive), self%total(:, d, which), self%total_rest(:, d, which))
    call add_one(merge(square, 0.0_wp, alive), self%squares(:, d, which), &
                 self%squares_rest(:, d, which))
    ! A maximum between samples exceeds the highest sample by less than the samples differ.
    if (.not. any(alive .and. highest + rise > self%peak(:, d, which))) return
    do l = 1, n_lanes
      if (alive(l) .and. highest(l) + rise(l) > self%peak(l, d, which)) then
        samples = x(l, :)
        series = c(l, :)
        call reach(samples, series, places, self%peak(l, d, which))
      end if
    end do
  end subroutine take_in_one

  !> Values of the polynomials of all lanes at the sample positions.
  pure subroutine evaluate(c, places, x)
    real(wp), intent(in) :: c(n_lanes, 0:degree), places(0:n_nodes + 1)
    real(wp), intent(out) :: x(n_lanes, 0:n_nodes + 1)
    integer :: i, k, l
    do i = 0, n_nodes + 1
      x(:, i) = c(:, degree)
    end do
    do k = degree - 1, 0, -1
      do i = 0, n_nodes + 1
        !GCC$ unroll 1
        do l = 1, n_lanes
          x(l, i) = x(l, i)*places(i) + c(l, k)
        end do
      end do
    end do
  end subroutine evaluate

  !> Raise a peak to the largest size of a polynomial with known samples.
  pure subroutine reach(x, c, places, peak)
    real(wp), intent(in) :: x(0:n_nodes + 1), c(0:degree), places(0:n_nodes + 1)
    real(wp), intent(inout) :: peak
    integer :: after, at, before
    at = maxloc(abs(x), 1) - 1
    if (at < 0) return
    peak = max(peak, abs(x(at)))
    before = max(at - 1, 0)
    after = min(at + 1, n_nodes + 1)
    if (2.0_wp*abs(x(at)) - min(abs(x(before)), abs(x(after))) <= peak) return
    peak = max(peak, top(c, places(before), places(at), places(after)))
  end subroutine reach

  !> The largest size of a polynomial near a node, between two other nodes.
  pure real(wp) function top(c, low, place, high)
    real(wp), intent(in) :: c(0:degree), low, place, high
    real(wp) :: x, value, slope, bend
    integer :: i, k

    x = place
    top = 0.0_wp
    do i = 1, n_newton
      value = c(degree)
      slope = 0.0_wp
      bend = 0.0_wp
      do k = degree - 1, 0, -1
        bend = bend*x + 2.0_wp*slope
        slope = slope*x + value
        value = value*x + c(k)
      end do
      top = max(top, abs(value))
      if (.not. abs(bend) > 0.0_wp) return
      x = min(max(x - slope/bend, low), high)
    end do
  end function top

  !> Add with the rounding error of the previous addition.
  pure subroutine add_one(part, total, rest)
    real(wp), intent(in) :: part(n_lanes)
    real(wp), intent(inout) :: total(n_lanes), rest(n_lanes)
    real(wp) :: whole, new
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      whole = part(l) + rest(l)
      new = total(l) + whole
      rest(l) = whole - (new - total(l))
      total(l) = new
    end do
  end subroutine add_one

  !> Largest size, mean and root of the mean square, shapes (n_lanes, n_dof, 2); NaN without a step.
  pure subroutine hand_over(self, peak, mean, rms)
    class(moments_type), intent(inout) :: self
    real(wp), intent(out) :: peak(:, :, :), mean(:, :, :), rms(:, :, :)
    real(wp) :: unit(2)
    integer :: i, l

    if (self%waiting > 0.0_wp) call self%take_in(1.0_wp, self%waiting, spread(.true., 1, n_lanes))
    self%waiting = 0.0_wp
    do l = 1, n_lanes
      if (.not. (self%length(l) > 0.0_wp .and. self%h(l) > 0.0_wp)) then
        peak(l, :, :) = ieee_value(1.0_wp, ieee_quiet_nan)
        mean(l, :, :) = ieee_value(1.0_wp, ieee_quiet_nan)
        rms(l, :, :) = ieee_value(1.0_wp, ieee_quiet_nan)
        cycle
      end if
      unit = [1.0_wp, self%h(l)]
      do i = 1, 2
        peak(l, :, i) = self%peak(l, :self%n_dof, i)/unit(i)
        mean(l, :, i) = self%total(l, :self%n_dof, i)/(unit(i)*self%length(l))
        rms(l, :, i) = sqrt(self%squares(l, :self%n_dof, i)/self%length(l))/unit(i)
      end do
    end do
  end subroutine hand_over

end module viscovib_lane_moments
