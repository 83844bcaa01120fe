!> Bifurcation points of a branch of periodic motions in time, and its grazings.
!!
!! Multipliers that cross the unit circle are located as on every other curve
!! (`viscovib_crossing_search`), with errors by another step size. At a grazing the number of
!! switches changes. There the branch may have a corner, with no motions across the chord between
!! the points on both sides of it; events without a location are then at the corner.
module viscovib_motion_events
  use, intrinsic :: ieee_arithmetic, only: ieee_positive_inf, ieee_quiet_nan, ieee_value
  use viscovib_crossing_nodes, only: spectrum_type
  use viscovib_crossing_search, only: crossing_type, find_changes
  use viscovib_curve, only: curve_type
  use viscovib_curve_corrector, only: corrector_type, new_corrector
  use viscovib_curve_events, only: empty_points, locate_branch_point, locate_fold, nowhere, &
    special_points, turn_at
  use viscovib_curve_point, only: curve_point, metric, new_point, normalize
  use viscovib_kinds, only: wp
  use viscovib_motion_path, only: difference, motion_path, motion_point
  use viscovib_orbit_multipliers, only: count_larger, logarithm, multipliers_of
  use viscovib_period_map, only: period_run
  use viscovib_sorting, only: order_of
  use viscovib_stopping, only: begin_piece, given_up
  implicit none
  private

  public :: find_events, motion_event

  integer, parameter, public :: event_fold = 1, event_branch = 2, event_doubling = 3, &
                                event_pair = 4, event_grazing = 5
  character(len=*), parameter, public :: event_names(5) = &
    [character(len=15) :: 'fold', 'branch point', 'period doubling', 'Neimark-Sacker', 'grazing']
  !> The events of the types of crossings; without half-wave symmetry no symmetry is broken.
  integer, parameter :: of_crossing(5) = &
    [event_fold, event_branch, event_branch, event_doubling, event_pair]
  !> Multipliers this close to the unit circle count as on it.
  real(wp), parameter :: circle = 1.0e-9_wp
  !> Relative tolerance of motions at folds and branch points.
  real(wp), parameter :: solved = 1.0e-12_wp
  !> Distance of the ends between which a grazing is located, relative to the chord.
  real(wp), parameter :: near = 1.0e-13_wp
  !> Distance of motions on both sides of a grazing: a larger one is a corner of the branch.
  real(wp), parameter :: close = 1.0e-10_wp
  !> Distance of a multiplier from the unit circle: a larger one is that of a corner.
  real(wp), parameter :: jump = 1.0e-3_wp

  !> An event between the point `before` and the next one.
  type :: motion_event
    integer :: kind = 0, before = 0
    !> Position on the chord, 0 to 1.
    real(wp) :: part = 0.5_wp
    !> The point, and the error of its parameter in units of z; not allocated: not located.
    real(wp), allocatable :: z(:)
    real(wp) :: error = 0.0_wp
  end type motion_event

  !> The branch as a curve: states in units of z.
  type, extends(curve_type) :: motion_curve
    type(motion_path) :: path
  contains
    procedure :: equations
    procedure :: residual
    procedure :: raise_terms
  end type motion_curve

  !> Logarithms of the multipliers.
  type, extends(spectrum_type) :: motion_spectrum
  contains
    procedure :: look
  end type motion_spectrum

contains

  !> Events between adjacent points, in their order.
  subroutine find_events(path, points, blur, found)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: points(:)
    !> Errors of the multipliers at the points.
    real(wp), intent(in) :: blur(:)
    type(motion_event), allocatable, intent(out) :: found(:)
    type(motion_event), allocatable :: events(:)
    complex(wp), allocatable :: eta(:, :)
    integer :: first, i, last

    allocate (found(0))
    if (size(points) == 0) return
    allocate (eta(size(points(1)%z) - 1, size(points)))
    do i = 1, size(points)
      eta(:, i) = logarithm(points(i)%multipliers())
    end do
    do i = 1, size(points) - 1
      if (given_up()) return
      call begin_piece()
      ! The neighbours only show where two crossings may lie between the points.
      first = max(1, i - 1)
      last = min(size(points), i + 2)
      associate (near => points(first:last), at => i - first + 1)
        call find_between(path, near, eta(:, first:last), at, maxval(blur(i:i + 1)), events)
        call find_errors(path, near, eta(:, first:last), at, maxval(blur(i:i + 1)), events)
      end associate
      events%before = i
      call append(found, events)
    end do
  end subroutine find_events

  !> Events between the point `at` and the next one.
  subroutine find_between(path, points, eta, at, blur, events)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: points(:)
    !> Logarithms of the multipliers at the points.
    complex(wp), intent(in) :: eta(:, :)
    integer, intent(in) :: at
    !> Error of the multipliers.
    real(wp), intent(in) :: blur
    type(motion_event), allocatable, intent(out) :: events(:)
    type(motion_event), allocatable :: grazings(:)
    integer :: k

    associate (one => points(at), other => points(at + 1))
      call find_crossings(path, points, eta, at, blur, events)
      call find_grazings(path, one, other, grazings)
      ! Behind a corner multipliers may differ without a bifurcation.
      if (size(grazings) > 0) then
        events = pack(events, [(allocated(events(k)%z) .or. events(k)%kind /= event_branch &
                                .or. crosses(one, other), k=1, size(events))])
      end if
      do k = 1, size(events)
        if (allocated(events(k)%z) .or. size(grazings) /= 1) cycle
        events(k)%part = grazings(1)%part
        if (allocated(grazings(1)%z)) events(k)%z = grazings(1)%z
        events(k)%error = grazings(1)%error
      end do
      call append(events, grazings)
      events = events(order_of([(events(k)%part, k=1, size(events))]))
    end associate
  end subroutine find_between

  !> Errors of the locations of events, from a run with another step size: infinite if that run does
  !! not find the event.
  subroutine find_errors(path, points, eta, at, blur, events)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: points(:)
    complex(wp), intent(in) :: eta(:, :)
    integer, intent(in) :: at
    real(wp), intent(in) :: blur
    type(motion_event), intent(inout) :: events(:)
    type(motion_path) :: finer
    type(motion_point) :: near(size(points))
    type(motion_event), allocatable :: others(:)
    complex(wp) :: also(size(eta, 1), size(points))
    real(wp) :: apart
    integer :: i, k, n
    logical :: made

    if (size(events) == 0) return
    n = size(points(at)%z)
    finer = path
    finer%n_steps = 2*path%n_steps + 1
    near = points
    also = eta
    allocate (others(0))
    do k = at, at + 1
      call finer%correct(points(k)%z, points(k)%tangent, near(k), made)
      if (.not. made) exit
      also(:, k) = logarithm(near(k)%multipliers())
    end do
    if (made) call find_between(finer, near, also, at, blur, others)
    do i = 1, size(events)
      if (.not. allocated(events(i)%z)) cycle
      apart = ieee_value(apart, ieee_positive_inf)
      do k = 1, size(others)
        if (others(k)%kind /= events(i)%kind .or. .not. allocated(others(k)%z)) cycle
        apart = min(apart, abs(others(k)%z(n) - events(i)%z(n)))
      end do
      ! The ends differ by rounding, and by the remainder of Newton's method.
      events(i)%error = apart + max(events(i)%error, epsilon(1.0_wp)*abs(events(i)%z(n)))
    end do
  end subroutine find_errors

  !> Crossings of the unit circle between the point `at` and the next one, folds and branch points.
  subroutine find_crossings(path, points, eta, at, blur, events)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: points(:)
    complex(wp), intent(in) :: eta(:, :)
    integer, intent(in) :: at
    real(wp), intent(in) :: blur
    type(motion_event), allocatable, intent(out) :: events(:)
    type(motion_curve) :: curve
    type(motion_spectrum) :: spectrum
    type(special_points) :: folds, branch_points
    type(crossing_type), allocatable :: crossings(:)
    type(motion_event) :: event
    real(wp) :: p(size(points)), x(size(eta, 1), size(points))
    integer :: n_growing(size(points)), k, n

    n = size(eta, 1)
    curve%n = n
    curve%path = path
    spectrum%n = n
    spectrum%threshold = log(1.0_wp + max(circle, 2.0_wp*blur))
    n_growing = -1
    do k = 1, size(points)
      p(k) = points(k)%z(n + 1)
      x(:, k) = points(k)%z(:n)
      if (k == at .or. k == at + 1) then
        n_growing(k) = count_larger(exp(eta(:, k)), exp(spectrum%threshold))
      end if
    end do
    call locate(curve, points(at), points(at + 1), folds, branch_points)
    folds%before = folds%before + at
    branch_points%before = branch_points%before + at
    call find_changes(curve, spectrum, p, x, eta, n_growing, folds, branch_points, crossings)
    allocate (events(0))
    do k = 1, size(crossings)
      associate (c => crossings(k))
        event = motion_event(of_crossing(c%kind))
        ! The derivatives locate folds and branch points more accurately.
        if (folds%n + branch_points%n > 0 .and. event%kind <= event_branch) cycle
        if (is_on_circle(spectrum, curve, c)) call put_at(c%x, c%p)
        call append(events, [event])
      end associate
    end do
    do k = 1, folds%n
      event = motion_event(event_fold)
      call put_at(folds%x(:, k), folds%p(k))
      call append(events, [event])
    end do
    do k = 1, branch_points%n
      event = motion_event(event_branch)
      call put_at(branch_points%x(:, k), branch_points%p(k))
      call append(events, [event])
    end do
    call match_folds(turns_back(points(at), points(at + 1)), events)

  contains

    subroutine put_at(at_x, at_p)
      real(wp), intent(in) :: at_x(:), at_p
      event%z = [at_x, at_p]
      associate (chord => points(at + 1)%z - points(at)%z)
        event%part = dot_product(chord, event%z - points(at)%z)/dot_product(chord, chord)
      end associate
    end subroutine put_at

  end subroutine find_crossings

  !> Fold and branch point between two points, by the derivatives of the branch.
  subroutine locate(curve, one, other, folds, branch_points)
    type(motion_curve), intent(inout) :: curve
    type(motion_point), intent(in) :: one, other
    type(special_points), intent(out) :: folds, branch_points
    type(corrector_type) :: corrector
    type(curve_point) :: here
    real(wp) :: at, step, weight_x, weight_p
    integer :: n
    logical :: turned

    n = curve%n
    call empty_points(folds, n, 1)
    call empty_points(branch_points, n, 1)
    if (.not. (crosses(one, other) .or. turns_back(one, other))) return
    call new_corrector(corrector, curve, solved, 1.0_wp, one%z(:n))
    call new_point(here, n)
    here%x(:) = one%z(:n)
    here%p = one%z(n + 1)
    here%slope_x(:) = one%tangent(:n)
    here%slope_p = one%tangent(n + 1)
    call normalize(corrector, here)
    call metric(corrector, here, weight_x, weight_p)
    step = weight_x*dot_product(here%slope_x, other%z(:n) - here%x) &
           + weight_p*here%slope_p*(other%z(n + 1) - here%p)
    turned = .false.
    if (crosses(one, other)) then
      call locate_branch_point(curve, corrector, here, step, branch_points, at)
      if (at < nowhere) call turn_at(curve, corrector, here, step, at, branch_points%p(1), &
                                     branch_points%x(:, 1), folds, turned)
    end if
    if (turned .or. .not. turns_back(one, other)) return
    call locate_fold(curve, corrector, here, step, folds, at)
  end subroutine locate

  !> True if the parameter turns back between two points.
  pure logical function turns_back(one, other)
    type(motion_point), intent(in) :: one, other
    turns_back = one%tangent(size(one%z))*other%tangent(size(one%z)) < 0.0_wp
  end function turns_back

  !> True if the determinant of the derivatives with the tangent changes its sign.
  logical function crosses(one, other)
    type(motion_point), intent(in) :: one, other
    crosses = one%orientation()*other%orientation() < 0.0_wp
  end function crosses

  !> True if a crossing is located, and a multiplier there is on the unit circle: at a corner
  !! multipliers jump.
  logical function is_on_circle(spectrum, curve, crossing)
    type(motion_spectrum), intent(inout) :: spectrum
    type(motion_curve), intent(inout) :: curve
    type(crossing_type), intent(in) :: crossing
    complex(wp) :: eta(spectrum%n)
    integer :: n_growing

    is_on_circle = crossing%located
    if (.not. is_on_circle) return
    call spectrum%look(curve, crossing%p, crossing%x, [crossing%eta], eta, n_growing)
    is_on_circle = n_growing >= 0
    if (is_on_circle) is_on_circle = any(abs(exp(eta) - exp(crossing%eta)) <= jump)
  end function is_on_circle

  !> A branch that turns back between two points has a fold there, also at a corner; one that does
  !! not turn back has none, or two.
  subroutine match_folds(turns, events)
    logical, intent(in) :: turns
    type(motion_event), allocatable, intent(inout) :: events(:)
    integer :: k

    if (turns .eqv. modulo(count(events%kind == event_fold), 2) == 1) return
    do k = 1, size(events)
      if (turns .and. (events(k)%kind /= event_branch .or. allocated(events(k)%z))) cycle
      if (.not. turns .and. events(k)%kind /= event_fold) cycle
      events(k)%kind = merge(event_fold, event_branch, turns)
      return
    end do
    call append(events, [motion_event(event_fold)])
  end subroutine match_folds

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

  !> Locations where the number of switches changes, in descending order.
  subroutine find_grazings(path, one, other, found)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: one, other
    type(motion_event), allocatable, intent(out) :: found(:)
    type(motion_event) :: event
    type(motion_point) :: ahead, before
    real(wp) :: low, part

    allocate (found(0))
    ahead = other
    part = 1.0_wp
    do while (one%n_passed /= ahead%n_passed)
      call bisect(path, one, ahead, event, before, low)
      if (.not. allocated(event%z)) call find_last_before_corner(path, one, ahead, event)
      event%part = event%part*part
      call append(found, [event])
      if (.not. allocated(event%z) .or. given_up()) return
      part = part*low
      ahead = before
    end do
  end subroutine find_grazings

  !> Locate the first motion on a chord that has as many switches as those behind it.
  subroutine bisect(path, one, other, event, before, low)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: one, other
    type(motion_event), intent(out) :: event
    !> The last motion before it, and its position.
    type(motion_point), intent(out) :: before
    real(wp), intent(out) :: low
    type(motion_point) :: after, point
    logical :: made

    event%kind = event_grazing
    before = one
    after = other
    low = 0.0_wp
    event%part = 1.0_wp
    do while (event%part - low > near)
      call path%between(one, other, 0.5_wp*(low + event%part), point, made)
      if (.not. made) return
      if (point%n_passed == other%n_passed) then
        after = point
        event%part = 0.5_wp*(low + event%part)
      else
        before = point
        low = 0.5_wp*(low + event%part)
      end if
    end do
    if (maxval(abs(before%z - after%z)) <= close) event%z = after%z
    event%error = after%correction
  end subroutine bisect

  !> The last motion with the same switches, from one of two points towards the other.
  !!
  !! Where an impact begins, the branch has a corner, and there are no motions across the chord
  !! between points on both sides of it. From the side without impact the branch is smooth up to it.
  subroutine find_last_before_corner(path, one, other, event)
    type(motion_path), intent(in) :: path
    type(motion_point), intent(in) :: one, other
    type(motion_event), intent(inout) :: event
    type(motion_point) :: begin, last, point
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
    if (.not. (there > 0.0_wp .and. beyond < 2.0_wp*reach)) return
    event%z = last%z
    event%error = last%correction
  end subroutine find_last_before_corner

  subroutine equations(self, x, p, r, jacobian, slope, inside)
    class(motion_curve), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    real(wp), intent(inout) :: jacobian(:, :)
    real(wp), intent(out) :: slope(:)
    logical, intent(out) :: inside
    type(period_run) :: ran
    real(wp), allocatable :: by_p(:), slopes(:, :)
    real(wp) :: distance

    distance = difference
    call self%path%find_slopes([x, p], .false., by_p, distance, ran, slopes, inside)
    if (.not. inside) return
    r = ran%last/self%path%units(:self%n) - x
    jacobian(:self%n, :self%n) = slopes(:, :self%n)
    slope = slopes(:, self%n + 1)
  end subroutine equations

  subroutine residual(self, x, p, r, inside)
    class(motion_curve), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    logical, intent(out) :: inside
    type(period_run) :: ran
    call self%path%run_at(self%path%state_of([x, p]), self%path%parameter_of([x, p]), ran, .false.)
    inside = ran%is_complete()
    if (inside) r = ran%last/self%path%units(:self%n) - x
  end subroutine residual

  subroutine raise_terms(self, x, p, terms)
    class(motion_curve), intent(in) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(inout) :: terms(:)
    associate (unused => self, unused_too => p)
    end associate
    terms = max(terms, abs(x))
  end subroutine raise_terms

  subroutine look(self, curve, p, x, near, eta, n_growing)
    class(motion_spectrum), intent(inout) :: self
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p, x(:)
    complex(wp), intent(in) :: near(:)
    complex(wp), intent(out) :: eta(:)
    integer, intent(out) :: n_growing
    complex(wp) :: multipliers(self%n)
    type(period_run) :: ran

    associate (unused => near)
    end associate
    eta = cmplx(ieee_value(p, ieee_quiet_nan), 0.0_wp, wp)
    n_growing = -1
    select type (curve)
    class is (motion_curve)
      call curve%path%run_at(curve%path%state_of([x, p]), curve%path%parameter_of([x, p]), ran, &
                             .true.)
      if (.not. ran%is_complete()) return
      call multipliers_of(ran%by_start, multipliers)
      eta = logarithm(multipliers)
      n_growing = count_larger(multipliers, exp(self%threshold))
    end select
  end subroutine look

end module viscovib_motion_events
