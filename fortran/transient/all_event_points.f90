!> All zero crossings of a function of the state inside a step, by interval bounds: none is missed,
!! even if the function is as thin as exp(-(x/1e-6)^2) - 0.5 or as fast as sin(1000*x).
!!
!! The arguments of the function are the polynomials of the step, which are smooth. In a part of
!! the step their ranges follow from three derivatives at its middle and a bound of the next one.
!! These give ranges of the function and of its rate (`viscovib_law_bounds`). A part in which the
!! function keeps its sign has no crossing. If it is monotonic there, the values at the ends
!! decide. Any other part is bisected.
module viscovib_all_event_points
  use viscovib_event_search, only: place_of_change
  use viscovib_kinds, only: wp
  use viscovib_law_bounds, only: bounds_of, inside, nowhere, range_type
  use viscovib_law_branches, only: signal_type
  use viscovib_law_functions, only: put_argument, wall
  use viscovib_law_program, only: law_program
  use viscovib_quadrature, only: lagrange, lagrange_factors
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: event_point_search

  real(wp), parameter :: pi = 3.141592653589793_wp
  !> The shortest part, relative to the step; largest number of parts in a step.
  integer, parameter :: most_halvings = 40, most_parts = 20000
  real(wp), parameter :: shortest = 0.5_wp**most_halvings
  !> Values above this multiple of their rounding error have a sign; rounding of polynomials.
  real(wp), parameter :: certain = 4.0_wp, of_series = 8.0_wp*epsilon(1.0_wp)
  !> Values at the start up to this part of the largest value count as 0; part of the terms by which
  !! the function may exceed 0 undetected in the shortest part.
  real(wp), parameter :: on_surface = 1.0e-13_wp, matters = 1.0e-6_wp

  !> Results of a range: no values, positive, negative, 0 but for rounding, monotonic; or not yet
  !! decided.
  integer, parameter :: no_value = 1, above = 2, below = 3, nothing = 4, one_way = 5, unclear = 6

  type :: event_point_search
    !> Crossings of the last step that was searched, ascending, and the side after each.
    integer :: n = 0
    real(wp), allocatable :: places(:)
    integer, allocatable :: to(:)
    !> True if some may be missing.
    logical :: lost = .false.
    !> Points of the path, and the matrix from values there to Chebyshev coefficients.
    real(wp), allocatable, private :: points(:), matrix(:, :)
    !> For each argument: its series, shape (n, n_arguments); bound of its third derivative; its
    !! rounding error.
    real(wp), allocatable, private :: series(:, :), third(:), noise(:)
  contains
    procedure :: find
    procedure :: change_at
    procedure, private :: prepare
    procedure, private :: take_path
    procedure, private :: bounds
    procedure, private :: value_at
    procedure, private :: stays_zero
    procedure, private :: arguments_at
    procedure, private :: note
  end type event_point_search

contains

  !> Find the crossings of a step.
  subroutine find(self, signal, path, floor, largest, side)
    class(event_point_search), intent(inout) :: self
    type(signal_type), intent(in) :: signal
    type(step_path), intent(in) :: path
    !> Values that count as 0; the largest value so far.
    real(wp), intent(in) :: floor, largest
    !> Side of 0 of the signal: at the start on entry, at the end on return; 0: unknown.
    integer, intent(inout) :: side
    type(range_type) :: range
    real(wp) :: from, to, g, scale, zero, ends(most_halvings + 2)
    integer :: n_parts, top

    call self%prepare(path)
    call self%take_path(signal%program, path)
    self%n = 0
    self%lost = .false.
    g = self%value_at(signal, path, 0.0_wp)
    if (abs(g) >= wall) then
      side = 0
    else if (abs(g) > max(floor, on_surface*largest)) then
      call turn_to(merge(1, -1, g > 0.0_wp), 0.0_wp)
    end if
    from = 0.0_wp
    ends(1) = 1.0_wp
    top = 1
    n_parts = 0
    do while (top > 0)
      to = ends(top)
      n_parts = n_parts + 1
      if (n_parts > most_parts) then
        self%lost = .true.
        call look_at_end(from, 1.0_wp, floor)
        return
      end if
      range = self%bounds(signal%program, from, to)
      scale = max(largest, range%size)
      zero = max(floor, certain*range%noise)
      select case (reported_by(range, zero, max(floor, matters*scale)))
      case (no_value)
        side = 0
      case (above)
        call turn_to(1, from)
      case (below)
        call turn_to(-1, from)
      case (nothing)
        continue
      case (one_way)
        call look_at_end(from, to, floor)
      case default
        if (to - from <= shortest) then
          call look_beyond(range, to)
          call look_at_end(from, to, zero)
        else if (.not. self%stays_zero(signal, path, range, from, to, scale)) then
          top = top + 1
          ends(top) = 0.5_wp*(from + to)
          cycle
        end if
      end select
      from = to
      top = top - 1
    end do

  contains

    !> Set the side from a position on; a change of side is a crossing.
    subroutine turn_to(other, place)
      integer, intent(in) :: other
      real(wp), intent(in) :: place
      if (side == -other) call self%note(place, other)
      side = other
    end subroutine turn_to

    !> The side at the end of a part with at most one crossing.
    subroutine look_at_end(a, b, zero)
      real(wp), intent(in) :: a, b, zero
      integer :: other
      g = self%value_at(signal, path, b)
      if (abs(g) >= wall) side = 0
      if (abs(g) >= wall .or. abs(g) <= zero) return
      other = merge(1, -1, g > 0.0_wp)
      if (side == -other) then
        call turn_to(other, place_of_change(signal, path, side, a, b))
      else
        side = other
      end if
    end subroutine look_at_end

    !> Detect whether a part of the shortest length may hide two crossings.
    subroutine look_beyond(range, b)
      type(range_type), intent(in) :: range
      real(wp), intent(in) :: b
      real(wp) :: beyond
      if (range%jumps .or. range%outside /= inside .or. &
          side*self%value_at(signal, path, b) < 0.0_wp) return
      beyond = merge(-range%value(1), range%value(2), side > 0)
      if (beyond > matters*scale) self%lost = .true.
    end subroutine look_beyond

  end subroutine find

  !> True if a function is small in a part, and 0 at all sample points: its terms cancel,
  !! as in x - abs(x).
  logical function stays_zero(self, signal, path, range, from, to, scale)
    class(event_point_search), intent(in) :: self
    type(signal_type), intent(in) :: signal
    type(step_path), intent(in) :: path
    type(range_type), intent(in) :: range
    real(wp), intent(in) :: from, to, scale
    integer :: i
    stays_zero = range%outside == inside .and. maxval(abs(range%value)) <= matters*scale
    do i = 0, 3
      if (.not. stays_zero) return
      stays_zero = abs(self%value_at(signal, path, from + (to - from)*(i/3.0_wp))) &
                   <= of_series*scale
    end do
  end function stays_zero

  !> The signal at a position; at the ends of the step it is that of the neighbouring steps.
  real(wp) function value_at(self, signal, path, x)
    class(event_point_search), intent(in) :: self
    type(signal_type), intent(in) :: signal
    type(step_path), intent(in) :: path
    real(wp), intent(in) :: x
    real(wp) :: g(1)
    if (x <= 0.0_wp) then
      call signal%at([path%start], path%q(:1, :), path%v(:1, :), g)
    else if (x >= 1.0_wp) then
      associate (last => size(path%points))
        call signal%at([path%start + path%h], path%q(last:, :), path%v(last:, :), g)
      end associate
    else
      call signal%program%evaluate(self%arguments_at(x), g)
    end if
    value_at = g(1)
  end function value_at

  !> Conclusion from a range about the crossings in it.
  pure integer function reported_by(range, zero, small)
    type(range_type), intent(in) :: range
    !> Values that count as 0; largest such bound that is conclusive.
    real(wp), intent(in) :: zero, small
    reported_by = unclear
    if (range%outside == nowhere) reported_by = no_value
    if (range%outside /= inside) return
    if (range%value(1) > zero) then
      reported_by = above
    else if (range%value(2) < -zero) then
      reported_by = below
    else if (maxval(abs(range%value)) <= zero .and. zero <= small) then
      reported_by = nothing
    else if (.not. range%jumps .and. (range%rate(1) > 0.0_wp .or. range%rate(2) < 0.0_wp)) then
      reported_by = one_way
    end if
  end function reported_by

  !> Change of a signal at a crossing of the step that was searched last: its rate, and the size of
  !! its second derivative, by time.
  !!
  !! At a jump the bend is -1, and the rate bounds the shift of the crossing: if all arguments
  !! change by some amount, the crossing moves by at most this amount divided by the rate.
  subroutine change_at(self, law, path, x, rate, bend)
    class(event_point_search), intent(in) :: self
    type(law_program), intent(in) :: law
    type(step_path), intent(in) :: path
    real(wp), intent(in) :: x
    real(wp), intent(out) :: rate, bend
    !> Distance of a jump from its computed position, and of compared rates, in parts of the step.
    real(wp), parameter :: there = 1.0e-9_wp, nearby = 1.0e-6_wp
    !> Perturbation of the arguments, relative to their rounding errors.
    real(wp), parameter :: other = 2.0_wp**20
    type(range_type) :: here, one, two
    real(wp) :: low, high, wide, reach

    associate (m => size(self%noise), from => max(x - there, 0.0_wp), to => min(x + there, 1.0_wp))
      here = self%bounds(law, from, to)
      low = max(x - nearby, 0.0_wp)
      high = min(x + nearby, 1.0_wp)
      one = self%bounds(law, low, low)
      two = self%bounds(law, high, high)
      rate = 0.0_wp
      bend = 0.0_wp
      if (here%outside == inside .and. .not. here%jumps) then
        here = self%bounds(law, x, x)
        rate = sum(here%rate)/path%h
        bend = abs(sum(two%rate) - sum(one%rate))/((high - low)*path%h**2)
        if (abs(rate) > 0.0_wp .or. bend > 0.0_wp) return
      end if
      bend = -1.0_wp
      wide = other*maxval(self%noise(:m - 1))
      reach = there
      do while (reach < 1.0_wp)
        low = max(x - reach, 0.0_wp)
        high = min(x + reach, 1.0_wp)
        one = self%bounds(law, low, low, wide)
        two = self%bounds(law, high, high, wide)
        if (is_sure(one) .and. is_sure(two)) then
          rate = wide/(reach*path%h)
          exit
        end if
        reach = 2.0_wp*reach
      end do
    end associate

  contains

    !> True if a range determines the sign, or that there is no value.
    pure logical function is_sure(range)
      type(range_type), intent(in) :: range
      is_sure = range%outside == nowhere
      if (range%outside == inside) is_sure = range%value(1) > range%noise &
                                             .or. range%value(2) < -range%noise
    end function is_sure

  end subroutine change_at

  !> Store a crossing.
  subroutine note(self, place, to)
    class(event_point_search), intent(inout) :: self
    real(wp), intent(in) :: place
    integer, intent(in) :: to
    real(wp), allocatable :: places(:)
    integer, allocatable :: sides(:)

    if (.not. allocated(self%places)) allocate (self%places(8), self%to(8))
    if (self%n == size(self%places)) then
      allocate (places(2*self%n), sides(2*self%n))
      places(:self%n) = self%places
      sides(:self%n) = self%to
      call move_alloc(places, self%places)
      call move_alloc(sides, self%to)
    end if
    self%n = self%n + 1
    self%places(self%n) = place
    self%to(self%n) = to
  end subroutine note

  !> The matrix for the points of a path: interpolation at the zeros of a Chebyshev polynomial, then
  !! their cosine transform.
  subroutine prepare(self, path)
    class(event_point_search), intent(inout) :: self
    type(step_path), intent(in) :: path
    real(wp) :: angle(size(path%points)), factors(size(path%points))
    real(wp) :: basis(size(path%points), size(path%points))
    integer :: k, n

    n = size(path%points)
    if (allocated(self%points)) then
      if (size(self%points) == n) then
        if (all(abs(self%points - path%points) <= 0.0_wp)) return
      end if
    end if
    self%points = path%points
    factors = lagrange_factors(path%points)
    do k = 1, n
      angle(k) = pi*(k - 0.5_wp)/n
      basis(k, :) = lagrange(path%points, factors, 0.5_wp*(1.0_wp + cos(angle(k))))
    end do
    if (allocated(self%matrix)) deallocate (self%matrix)
    allocate (self%matrix(n, n))
    do k = 1, n
      self%matrix(k, :) = matmul(cos((k - 1)*angle), basis)*(merge(1.0_wp, 2.0_wp, k == 1)/n)
    end do
  end subroutine prepare

  !> Series of the arguments of a function.
  subroutine take_path(self, law, path)
    class(event_point_search), intent(inout) :: self
    type(law_program), intent(in) :: law
    type(step_path), intent(in) :: path
    real(wp) :: order(size(path%points))
    integer :: argument, i, n

    n = size(path%points)
    if (allocated(self%series)) deallocate (self%series, self%third, self%noise)
    associate (m => 2*size(path%q, 2) + 1)
      allocate (self%series(n, m), source=0.0_wp)
      allocate (self%third(m), self%noise(m), source=0.0_wp)
      order = [(real(i, wp)**2, i=0, n - 1)]
      do i = 1, size(law%code)
        if (law%code(i) /= put_argument) cycle
        argument = nint(law%number(i))
        if (self%noise(argument) > 0.0_wp) cycle
        associate (c => self%series(:, argument))
          if (argument == m) then
            c(:2) = [path%start + 0.5_wp*path%h, 0.5_wp*path%h]
          else if (modulo(argument, 2) == 1) then
            c = matmul(self%matrix, path%q(:, (argument + 1)/2))
          else
            c = matmul(self%matrix, path%v(:, argument/2))
          end if
          self%noise(argument) = of_series*sum(abs(c)) + tiny(1.0_wp)
          self%third(argument) = sum(abs(c)*order*(order - 1.0_wp)*max(order - 4.0_wp, 0.0_wp)) &
                                 /15.0_wp
        end associate
      end do
    end associate
  end subroutine take_path

  !> Values of all arguments at a position.
  function arguments_at(self, x) result(values)
    class(event_point_search), intent(in) :: self
    real(wp), intent(in) :: x
    real(wp) :: values(1, size(self%series, 2)), t(size(self%series, 1))
    integer :: k
    associate (s => 2.0_wp*x - 1.0_wp)
      t(1) = 1.0_wp
      t(2) = s
      do k = 3, size(t)
        t(k) = 2.0_wp*s*t(k - 1) - t(k - 2)
      end do
    end associate
    values(1, :) = matmul(t, self%series)
  end function arguments_at

  !> The range of a function in a part of the step, and of its rate.
  type(range_type) function bounds(self, law, from, to, wide) result(range)
    class(event_point_search), intent(in) :: self
    type(law_program), intent(in) :: law
    real(wp), intent(in) :: from, to
    !> Perturbation of all arguments, except the time.
    real(wp), intent(in), optional :: wide
    type(range_type) :: arguments(size(self%series, 2))
    real(wp) :: t(size(self%series, 1), 0:2), p(0:2), middle(1, size(arguments)), g(1)
    real(wp) :: half, low, high, rest
    integer :: k

    half = to - from
    call polynomials(from + to - 1.0_wp, t)
    middle = 0.0_wp
    do k = 1, size(arguments)
      if (.not. self%noise(k) > 0.0_wp) cycle
      p = matmul(self%series(:, k), t)
      middle(1, k) = p(0)
      rest = self%third(k)*half**2
      associate (turn => [p(0) - p(1)*half, p(0) + p(1)*half] + 0.5_wp*p(2)*half**2)
        low = minval(turn)
        high = maxval(turn)
      end associate
      if (abs(p(1)) < abs(p(2))*half) then
        low = min(low, p(0) - 0.5_wp*p(1)**2/p(2))
        high = max(high, p(0) - 0.5_wp*p(1)**2/p(2))
      end if
      arguments(k)%value = [low - rest*half/6.0_wp, high + rest*half/6.0_wp]
      arguments(k)%rate = p(1) + (abs(p(2))*half + 0.5_wp*rest)*[-1.0_wp, 1.0_wp]
      arguments(k)%noise = self%noise(k)
      if (present(wide) .and. k < size(arguments)) then
        arguments(k)%value = arguments(k)%value + [-wide, wide]
      end if
    end do
    call bounds_of(law, arguments, range)
    if (present(wide)) return
    if (range%outside /= inside .or. range%jumps) return
    if (range%value(1)*range%value(2) > 0.0_wp) return
    ! The mean value theorem limits the distance from the value in the middle.
    rest = maxval(abs(range%rate))
    if (rest*half > range%value(2) - range%value(1)) return
    call law%evaluate(middle, g)
    range%value = [max(range%value(1), g(1) - rest*half), min(range%value(2), g(1) + rest*half)]
  end function bounds

  !> Chebyshev polynomials and two derivatives.
  pure subroutine polynomials(s, t)
    real(wp), intent(in) :: s
    real(wp), intent(out) :: t(:, 0:)
    integer :: k
    t = 0.0_wp
    t(1, 0) = 1.0_wp
    t(2, 0) = s
    t(2, 1) = 1.0_wp
    do k = 3, size(t, 1)
      t(k, 0) = 2.0_wp*s*t(k - 1, 0) - t(k - 2, 0)
      t(k, 1) = 2.0_wp*(t(k - 1, 0) + s*t(k - 1, 1)) - t(k - 2, 1)
      t(k, 2) = 4.0_wp*t(k - 1, 1) + 2.0_wp*s*t(k - 1, 2) - t(k - 2, 2)
    end do
  end subroutine polynomials

end module viscovib_all_event_points
