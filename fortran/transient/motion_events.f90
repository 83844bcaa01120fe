!> Bifurcation points between two points of a branch of periodic motions in time.
!!
!! Test functions (Kuznetsov, Elements of Applied Bifurcation Theory, 10.2): for a fold the
!! component of the tangent along the parameter, for a branch point the determinant of the
!! derivatives with the tangent, for a period doubling det(P' + 1), for a Neimark-Sacker point the
!! product of m_i m_j - 1 over the multipliers, for grazing the number of switches.
module viscovib_motion_events
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_polynomial_zeros, only: interpolated, interpolated_roots
  use viscovib_kinds, only: wp
  use viscovib_motion_path, only: motion_path, motion_point
  use viscovib_pseudo_inverse, only: determinant
  use viscovib_stopping, only: given_up
  implicit none
  private

  public :: find_event_errors, find_events, motion_event

  integer, parameter, public :: event_fold = 1, event_branch = 2, event_doubling = 3, &
                                event_pair = 4, event_grazing = 5
  character(len=*), parameter, public :: event_names(5) = &
    [character(len=15) :: 'fold', 'branch point', 'period doubling', 'Neimark-Sacker', 'grazing']
  !> Number of multipliers that cross the unit circle, for each kind.
  integer, parameter :: n_crossing(event_fold:event_pair) = [1, 1, 1, 2]
  !> Distance of the ends between which a crossing is located, relative to the chord.
  real(wp), parameter :: near = 1.0e-13_wp
  !> Distance of motions on both sides, and the remaining part of the test function: a location with
  !! larger values is a corner of the branch.
  real(wp), parameter :: close = 1.0e-10_wp, jump = 1.0e-3_wp
  !> Bisections of the chord between two points whose events do not explain the change of stability.
  integer, parameter :: max_halvings = 6
  !> Iterations of Brent's method.
  integer, parameter :: max_iterations = 100
  !> Points around a location at which Newton's equations are singular, and the allowed difference
  !! of its positions from different numbers of points.
  integer, parameter :: n_nodes = 8
  real(wp), parameter :: agreement = 1.0e-7_wp

  !> An event between two points. It is not located if `has_point` is false.
  type :: motion_event
    integer :: kind = 0
    !> Position on the chord, 0 to 1.
    real(wp) :: part = 0.5_wp
    logical :: has_point = .false.
    type(motion_point) :: point
  end type motion_event

  !> The last points with a test function below, at and above 0.
  type :: seen_points
    type(motion_point) :: points(-1:1)
    real(wp) :: parts(-1:1) = 0.0_wp
    !> Signs in the order of their first points, and their number.
    integer :: order(3) = 0, n = 0
    type(motion_point) :: last
  contains
    procedure :: see
  end type seen_points

contains

  !> The test function of a kind. For grazing it is 1 if there are as many switches as at the end of
  !! the chord, else -1.
  real(wp) function test_function(kind, point, n_passed) result(value)
    integer, intent(in) :: kind, n_passed
    type(motion_point), intent(in) :: point
    real(wp), allocatable :: matrix(:, :)
    logical :: is_pair
    integer :: i

    select case (kind)
    case (event_fold)
      value = point%tangent(size(point%tangent))
    case (event_branch)
      value = determinant(point%bordered())
    case (event_doubling)
      allocate (matrix, source=point%by_start)
      do i = 1, size(matrix, 1)
        matrix(i, i) = matrix(i, i) + 1.0_wp
      end do
      value = determinant(matrix)
    case (event_pair)
      call find_nearest_pair(point, value, is_pair)
    case default
      value = merge(1.0_wp, -1.0_wp, point%n_passed == n_passed)
    end select
  end function test_function

  !> The sign of the product of all m_i m_j - 1, i < j, times the smallest of their sizes; `is_pair`
  !! is true if the smallest factor belongs to a complex pair.
  !!
  !! The value is continuous where a pair of multipliers becomes real, and does not mix pairs.
  subroutine find_nearest_pair(point, value, is_pair)
    type(motion_point), intent(in) :: point
    real(wp), intent(out) :: value
    logical, intent(out) :: is_pair
    complex(wp), allocatable :: m(:)
    complex(wp) :: factor, sign_of
    real(wp) :: least
    integer :: i, j

    allocate (m, source=point%multipliers())
    least = huge(least)
    sign_of = 1.0_wp
    is_pair = .false.
    do i = 1, size(m)
      do j = i + 1, size(m)
        factor = m(i)*m(j) - 1.0_wp
        sign_of = sign_of*(factor/max(abs(factor), tiny(1.0_wp)))
        if (abs(factor) >= least) cycle
        least = abs(factor)
        is_pair = abs(aimag(m(i))) > 0.0_wp .and. abs(m(i) - conjg(m(j))) <= 0.0_wp
      end do
    end do
    value = sign(min(least, huge(1.0_wp)), real(sign_of))
    if (.not. abs(real(sign_of)) > 0.0_wp .or. least <= 0.0_wp) value = 0.0_wp
  end subroutine find_nearest_pair

  !> Errors of the locations of events, relative to the range, from a run with another step size:
  !! huge if that run does not find the event, NaN if an event is not located.
  subroutine find_event_errors(path, one, other, blur, found, errors)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: one, other
    real(wp), intent(in) :: blur
    type(motion_event), intent(in) :: found(:)
    real(wp), allocatable, intent(out) :: errors(:)
    type(motion_path) :: finer
    type(motion_point) :: ends(2)
    type(motion_event), allocatable :: events(:)
    logical :: begins, finishes
    integer :: i, k

    allocate (errors(size(found)), source=ieee_value(0.0_wp, ieee_quiet_nan))
    if (size(found) == 0) return
    finer = path
    finer%n_steps = 2*path%n_steps + 1
    call finer%correct(one%z, one%tangent, ends(1), begins)
    call finer%correct(other%z, other%tangent, ends(2), finishes)
    allocate (events(0))
    if (begins .and. finishes) call find_events(finer, ends(1), ends(2), blur, events)
    do i = 1, size(found)
      if (.not. found(i)%has_point) cycle
      associate (place => found(i)%point%z(size(one%z)))
        errors(i) = huge(1.0_wp)
        do k = 1, size(events)
          if (events(k)%kind /= found(i)%kind .or. .not. events(k)%has_point) cycle
          errors(i) = min(errors(i), abs(events(k)%point%z(size(one%z)) - place))
        end do
        ! The ends differ by rounding, and by the remainder of Newton's method.
        if (errors(i) < huge(1.0_wp)) then
          errors(i) = errors(i) + max(found(i)%point%correction, epsilon(1.0_wp)*abs(place))
        end if
      end associate
    end do
  end subroutine find_event_errors

  !> Events between two points, in their order.
  !!
  !! If they do not explain the number of multipliers that cross the unit circle, some events occur
  !! twice. Then both halves of the chord are searched.
  recursive subroutine find_events(path, one, other, blur, found, halvings)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: one, other
    !> Error of the multipliers.
    real(wp), intent(in) :: blur
    type(motion_event), allocatable, intent(inout) :: found(:)
    !> Remaining number of bisections; absent in the first call.
    integer, intent(in), optional :: halvings
    type(motion_event), allocatable :: first(:), second(:), grazings(:)
    type(motion_event) :: event
    type(motion_point) :: middle
    real(wp) :: value_one, value_other
    integer :: i, kind, left
    logical :: is_pair, made

    left = max_halvings
    if (present(halvings)) left = halvings
    allocate (first(0))
    do kind = event_fold, event_pair
      value_one = test_function(kind, one, 0)
      value_other = test_function(kind, other, 0)
      if (.not. value_one*value_other < 0.0_wp) cycle
      if (kind == event_pair .and. max(abs(value_one), abs(value_other)) <= 2.0_wp*blur) cycle
      call locate(path, one, other, kind, event)
      ! Two real multipliers whose product crosses 1 are on both sides of the circle.
      if (kind == event_pair .and. event%has_point) then
        call find_nearest_pair(event%point, value_one, is_pair)
        if (.not. is_pair) cycle
      end if
      call append(first, [event])
    end do
    if (left > 0 .and. .not. given_up()) then
      if (.not. explains(first%kind, one, other, blur)) then
        call path%between(one, other, 0.5_wp, middle, made)
        if (made) then
          deallocate (first)
          call find_events(path, one, middle, blur, first, left - 1)
          call find_events(path, middle, other, blur, second, left - 1)
          first%part = 0.5_wp*first%part
          second%part = 0.5_wp*(1.0_wp + second%part)
          call append(first, second)
          call move_alloc(first, found)
          return
        end if
      end if
    end if
    call find_grazings(path, one, other, grazings)
    if (size(grazings) == 1) then
      ! At a corner of the branch there are no motions between the two points: events without a
      ! location are at the corner.
      do i = 1, size(first)
        if (first(i)%has_point) cycle
        kind = first(i)%kind
        first(i) = grazings(1)
        first(i)%kind = kind
      end do
    end if
    call append(first, grazings)
    call move_alloc(first, found)
    call sort_events(found)
  end subroutine find_events

  subroutine append(events, more)
    type(motion_event), allocatable, intent(inout) :: events(:)
    type(motion_event), intent(in) :: more(:)
    type(motion_event), allocatable :: all_events(:)
    integer :: n
    n = size(events)
    allocate (all_events(n + size(more)))
    all_events(:n) = events
    all_events(n + 1:) = more
    call move_alloc(all_events, events)
  end subroutine append

  !> Sort by position; equal positions keep their order.
  subroutine sort_events(events)
    type(motion_event), intent(inout) :: events(:)
    type(motion_event) :: next
    integer :: i, k
    do i = 2, size(events)
      next = events(i)
      k = i - 1
      do while (k > 0)
        if (events(k)%part <= next%part) exit
        events(k + 1) = events(k)
        k = k - 1
      end do
      events(k + 1) = next
    end do
  end subroutine sort_events

  !> True if the events can cause the change in the number of multipliers outside the unit circle;
  !! also if a multiplier is too near to the circle.
  logical function explains(kinds, one, other, blur)
    integer, intent(in) :: kinds(:)
    type(motion_point), intent(in) :: one, other
    real(wp), intent(in) :: blur
    integer :: at_one, at_other, i, sums
    logical, allocatable :: possible(:), next(:)

    at_one = n_outside(one, blur)
    at_other = n_outside(other, blur)
    explains = .true.
    if (at_one < 0 .or. at_other < 0) return
    sums = max(sum(n_crossing(kinds)), abs(at_other - at_one))
    allocate (possible(-sums:sums), source=.false.)
    possible(0) = .true.
    do i = 1, size(kinds)
      next = eoshift(possible, n_crossing(kinds(i)), .false.) &
             .or. eoshift(possible, -n_crossing(kinds(i)), .false.)
      possible = next
    end do
    explains = possible(at_other - at_one)
  end function explains

  !> Number of multipliers outside the unit circle; -1 if one is too near to it.
  integer function n_outside(point, blur)
    type(motion_point), intent(in) :: point
    real(wp), intent(in) :: blur
    real(wp), allocatable :: sizes(:)
    allocate (sizes, source=abs(point%multipliers()))
    n_outside = count(sizes > 1.0_wp)
    if (any(abs(sizes - 1.0_wp) <= 2.0_wp*blur)) n_outside = -1
  end function n_outside

  !> Locations where the number of switches changes, in descending order.
  subroutine find_grazings(path, one, other, found)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: one, other
    type(motion_event), allocatable, intent(out) :: found(:)
    type(motion_event) :: event
    type(motion_point) :: ahead
    type(seen_points) :: seen
    real(wp) :: part
    logical :: located

    allocate (found(0))
    ahead = other
    part = 1.0_wp
    do while (one%n_passed /= ahead%n_passed)
      call locate(path, one, ahead, event_grazing, event, seen)
      located = event%has_point
      if (.not. located) then
        call find_last_before_corner(path, one, ahead, event%point, event%has_point)
      end if
      event%part = event%part*part
      call append(found, [event])
      if (.not. event%has_point .or. all(seen%order(:seen%n) /= -1) .or. given_up()) return
      part = part*seen%parts(-1)
      ahead = seen%points(-1)
    end do
  end subroutine find_grazings

  !> The last motion with the same switches, from one of two points towards the other.
  !!
  !! Where an impact begins, the branch has a corner, and there are no motions across the chord
  !! between points on both sides of it. From the side without impact the branch is smooth up to it.
  subroutine find_last_before_corner(path, one, other, last, found)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: one, other
    type(motion_point), intent(out) :: last
    logical, intent(out) :: found
    type(motion_point) :: begin, point
    real(wp) :: ahead(size(one%z)), beyond, middle, reach, there
    logical :: same

    reach = norm2(other%z - one%z)
    if (one%n_passed < other%n_passed) then
      begin = one
      ahead = one%tangent
    else
      begin = other
      ahead = -other%tangent
    end if
    last = begin
    there = 0.0_wp
    beyond = 2.0_wp*reach
    do while (beyond - there > near*max(1.0_wp, maxval(abs(begin%z))))
      if (given_up()) exit
      middle = 0.5_wp*(there + beyond)
      call path%correct(begin%z + middle*ahead, ahead, point, same)
      if (same) same = point%n_passed == begin%n_passed
      if (same) then
        last = point
        there = middle
      else
        beyond = middle
      end if
    end do
    found = there > 0.0_wp .and. beyond < 2.0_wp*reach
  end subroutine find_last_before_corner

  !> Store a point and the sign of its test function.
  subroutine see(self, part, point, value)
    class(seen_points), intent(inout) :: self
    real(wp), intent(in) :: part, value
    type(motion_point), intent(in) :: point
    integer :: s
    s = 0
    if (abs(value) > 0.0_wp) s = nint(sign(1.0_wp, value))
    self%last = point
    self%points(s) = point
    self%parts(s) = part
    if (any(self%order(:self%n) == s)) return
    self%n = self%n + 1
    self%order(self%n) = s
  end subroutine see

  !> Locate the zero of a test function on the chord, by Brent's method.
  subroutine locate(path, one, other, kind, event, points)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: one, other
    integer, intent(in) :: kind
    type(motion_event), intent(out) :: event
    !> The last points of either sign.
    type(seen_points), intent(out), optional :: points
    type(seen_points) :: seen
    real(wp) :: left
    logical :: corner, lost
    integer :: i

    event%kind = kind
    call find_root(path, one, other, kind, event%part, seen, lost)
    if (present(points)) points = seen
    if (lost) then
      call interpolate_event(path, one, other, kind, event)
      return
    end if
    associate (first => seen%points(seen%order(1)), last => seen%points(seen%order(seen%n)))
      corner = maxval(abs(first%z - last%z)) > close
    end associate
    if (kind /= event_grazing) then
      left = minval([(abs(test_function(kind, seen%points(seen%order(i)), 0)), i=1, seen%n)])
      corner = corner .or. left > jump*max(abs(test_function(kind, one, 0)), &
                                           abs(test_function(kind, other, 0)))
    end if
    event%has_point = .not. corner
    if (event%has_point) event%point = seen%last
  end subroutine locate

  !> Brent's method (R. P. Brent, Algorithms for Minimization without Derivatives, 1973, 4). `lost`
  !! is true if Newton's method fails at some position.
  subroutine find_root(path, one, other, kind, root, seen, lost)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: one, other
    integer, intent(in) :: kind
    real(wp), intent(out) :: root
    type(seen_points), intent(inout) :: seen
    logical, intent(out) :: lost
    real(wp) :: before, f_before, f_root, f_opposite, half, opposite, slack, step, step_before
    real(wp) :: trial
    integer :: k

    lost = .false.
    before = 0.0_wp
    root = 1.0_wp
    f_before = test_function(kind, one, other%n_passed)
    call seen%see(0.0_wp, one, f_before)
    f_root = test_function(kind, other, other%n_passed)
    call seen%see(1.0_wp, other, f_root)
    opposite = 0.0_wp
    f_opposite = 0.0_wp
    step = 0.0_wp
    step_before = 0.0_wp
    do k = 1, max_iterations
      if (abs(f_before) > 0.0_wp .and. (f_before > 0.0_wp .neqv. f_root > 0.0_wp)) then
        opposite = before
        f_opposite = f_before
        step = root - before
        step_before = step
      end if
      if (abs(f_opposite) < abs(f_root)) then
        before = root
        root = opposite
        opposite = before
        f_before = f_root
        f_root = f_opposite
        f_opposite = f_before
      end if
      slack = 0.5_wp*(near + 4.0_wp*epsilon(1.0_wp)*abs(root))
      half = 0.5_wp*(opposite - root)
      if (abs(f_root) <= 0.0_wp .or. abs(half) < slack) return
      if (abs(step_before) > slack .and. abs(f_root) < abs(f_before)) then
        trial = interpolated_step()
        if (2.0_wp*abs(trial) < min(abs(step_before), 3.0_wp*abs(half) - slack)) then
          step_before = step
          step = trial
        else
          step_before = half
          step = half
        end if
      else
        step_before = half
        step = half
      end if
      before = root
      f_before = f_root
      if (abs(step) > slack) then
        root = root + step
      else
        root = root + sign(slack, half)
      end if
      call evaluate()
      if (lost) return
    end do

  contains

    !> By a secant, or by inverse quadratic interpolation.
    real(wp) function interpolated_step() result(step)
      real(wp) :: slope_before, slope_opposite
      if (abs(before - opposite) <= 0.0_wp) then
        step = -f_root*(root - before)/(f_root - f_before)
        return
      end if
      slope_before = (f_before - f_root)/(before - root)
      slope_opposite = (f_opposite - f_root)/(opposite - root)
      step = -f_root*(f_opposite*slope_opposite - f_before*slope_before) &
             /(slope_opposite*slope_before*(f_opposite - f_before))
    end function interpolated_step

    subroutine evaluate()
      type(motion_point) :: point
      logical :: made
      call path%between(one, other, root, point, made)
      lost = .not. made
      if (lost) return
      f_root = test_function(kind, point, other%n_passed)
      call seen%see(root, point, f_root)
    end subroutine evaluate

  end subroutine find_root

  !> The zero of a test function by its polynomial through points around it: at a branch point
  !! Newton's equations are singular, and no motion is found next to it.
  subroutine interpolate_event(path, one, other, kind, event)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: one, other
    integer, intent(in) :: kind
    type(motion_event), intent(inout) :: event
    real(wp), parameter :: quarter = acos(-1.0_wp)/n_nodes
    type(motion_point) :: points(n_nodes), point
    real(wp) :: x(n_nodes), values(n_nodes), z(n_nodes, size(one%z)), at(2), part
    real(wp), allocatable :: roots(:), others(:)
    integer :: i, k, n
    logical :: made

    event%part = 0.5_wp
    n = 0
    do i = 1, n_nodes
      part = 0.5_wp - 0.5_wp*cos(quarter*(i - 0.5_wp))
      call path%between(one, other, part, point, made)
      if (.not. made) cycle
      n = n + 1
      points(n) = point
      x(n) = part
      values(n) = test_function(kind, point, other%n_passed)
      z(n, :) = point%z
    end do
    if (n < n_nodes - 2) return
    ! With all points, and without the first point: the difference is the error.
    call interpolated_roots(x(:n), values(:n), roots)
    call interpolated_roots(x(2:n), values(2:n), others)
    roots = [roots, others]
    if (size(roots) /= 2) return
    k = size(one%z)
    at = [(interpolated(x(:n), z(:n, k), roots(i)), i=1, 2)]
    if (abs(at(1) - at(2)) > agreement) return
    event%part = roots(1)
    event%has_point = .true.
    event%point = points(minloc(abs(x(:n) - roots(1)), 1))
    event%point%z = [(interpolated(x(:n), z(:n, i), roots(1)), i=1, k)]
  end subroutine interpolate_event

end module viscovib_motion_events
