! Optimize: -O2
!> Bifurcations of a curve: where exponents cross the imaginary axis, and of which type.
!!
!! The search explains every change of the number of growing exponents between adjacent points.
!! Located folds and branch points split the interval, with the number computed on both sides.
!! Elsewhere the search finds a zero of the real part of an exponent and continues on both sides.
!! Two crossings may lie within a step without a change of the number: smooth test functions of all
!! exponents, zero at crossings, show where.
module viscovib_crossing_search
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_chord, only: chord_type, new_chord
  use viscovib_constants, only: pi
  use viscovib_crossing_dips, only: find_dip, lengths_of, n_tests, tests_of
  use viscovib_crossing_nodes, only: look_at, look_between, node_type, spectrum_type
  use viscovib_crossing_roots, only: bracket, on_line
  use viscovib_curve, only: curve_type
  use viscovib_curve_events, only: special_points
  use viscovib_kinds, only: wp
  use viscovib_stopping, only: given_up
  implicit none
  private

  public :: crossing_type, find_changes

  !> Marks an error that has not been computed.
  real(wp), parameter, public :: unknown = -1.0_wp

  !> Types of crossings: a multiplier 1 at a fold, or elsewhere; -1 of half a period; -1; a complex
  !! pair.
  integer, parameter, public :: crossing_fold = 1, crossing_branch_point = 2, &
                                crossing_symmetry = 3, crossing_doubling = 4, crossing_pair = 5

  integer, parameter :: max_depth = 12, max_looks = 8, max_halvings = 6
  !> Distances on both sides of a location at which exponents are counted, in sigma, in order.
  real(wp), parameter :: nearby(4) = [1.0e-3_wp, 1.0e-4_wp, 1.0e-2_wp, 5.0e-2_wp]
  !> Largest distance between a fold and its change: in points, otherwise relative to p and x.
  integer, parameter :: furthest = 1
  real(wp), parameter :: displaced = 0.02_wp, turned = 0.3_wp
  !> A fold is where dp/dsigma is below this fraction of its mean value between the ends.
  real(wp), parameter :: turning = 0.05_wp

  type :: crossing_type
    !> One of the types above, and the index of the last point before it.
    integer :: kind = 0, before = 0
    !> True if p and x are computed.
    logical :: located = .false.
    !> Error of p: set for folds and branch points that the continuation has located. For the other
    !! types `viscovib_crossing_errors` computes it.
    real(wp) :: p = 0.0_wp, error = unknown
    !> Unknowns of the curve.
    real(wp), allocatable :: x(:)
    !> The exponent at the crossing.
    complex(wp) :: eta = (0.0_wp, 0.0_wp)
  end type crossing_type

  !> A search along a branch, and its data between two adjacent points.
  type :: search_type
    class(curve_type), pointer :: curve => null()
    class(spectrum_type), pointer :: spectrum => null()
    type(special_points), pointer :: folds => null(), branch_points => null()
    !> Points and exponents as in find_changes; the test functions at each point.
    real(wp), pointer :: p(:) => null(), x(:, :) => null()
    complex(wp), pointer :: eta(:, :) => null()
    integer, pointer :: n_growing(:) => null()
    real(wp), allocatable :: tests(:, :)
    type(crossing_type), allocatable :: crossings(:)
    !> The current points are i and i + 1, the ends of the chord.
    integer :: i = 0
    type(chord_type) :: chord
    type(node_type) :: first, last
    !> Located folds and branch points between them: sigma, p, errors, unknowns and types.
    real(wp), allocatable :: places(:), place_p(:), place_errors(:), place_x(:, :)
    integer, allocatable :: place_kinds(:)
  end type search_type

contains

  !> All crossings between adjacent points of known stability, in their order.
  subroutine find_changes(curve, spectrum, p, x, eta, n_growing, folds, branch_points, crossings, &
                          cancel)
    class(curve_type), intent(inout), target :: curve
    class(spectrum_type), intent(inout), target :: spectrum
    !> Points of the curve, shapes (n) and (n_unknowns, n); their exponents, shape (slots, n), and
    !! the number of growing exponents, -1: unknown.
    real(wp), intent(in), target :: p(:), x(:, :)
    complex(wp), intent(in), target :: eta(:, :)
    integer, intent(in), target :: n_growing(:)
    type(special_points), intent(in), target :: folds, branch_points
    type(crossing_type), allocatable, intent(out) :: crossings(:)
    !> May be set by another thread to cancel the search.
    integer, intent(inout), optional :: cancel
    type(search_type) :: s
    real(wp), allocatable :: lengths(:)
    real(wp) :: dip
    integer :: i, which
    logical :: changes

    s%curve => curve
    s%spectrum => spectrum
    s%folds => folds
    s%branch_points => branch_points
    s%p => p
    s%x => x
    s%eta => eta
    s%n_growing => n_growing
    allocate (s%crossings(0), s%tests(n_tests, size(p)))
    do i = 1, size(p)
      s%tests(:, i) = tests_of(eta(:, i))
    end do
    allocate (lengths, source=lengths_of(p, x))
    do i = 1, size(p) - 1
      if (given_up(cancel)) exit
      if (minval(n_growing(i:i + 1)) < 0) cycle
      s%i = i
      call find_dip(s%tests, lengths, i, which, dip)
      changes = something_changes(s) .or. (spectrum%complete .and. turn_over(s%tests(:, i), &
                                                                             s%tests(:, i + 1)))
      if (which == 0 .and. .not. changes) cycle
      call new_chord(s%chord, curve, p(i:i + 1), x(:, i:i + 1))
      call put_node(s, 0.0_wp, i, s%first)
      call put_node(s, 1.0_wp, i + 1, s%last)
      if (changes) then
        call explain_all(s, which, dip, cancel)
      else
        call dive(s, s%first, s%last, which, dip, cancel)
      end if
    end do
    call give_folds(s)
    call move_alloc(s%crossings, crossings)
  end subroutine find_changes

  !> True if the number of growing exponents changes between the two points, or a located fold or
  !! branch point lies there.
  pure logical function something_changes(s) result(it_does)
    type(search_type), intent(in) :: s
    it_does = s%n_growing(s%i) /= s%n_growing(s%i + 1)
    if (s%folds%n > 0) it_does = it_does .or. any(s%folds%before(:s%folds%n) == s%i)
    if (s%branch_points%n > 0) then
      it_does = it_does .or. any(s%branch_points%before(:s%branch_points%n) == s%i)
    end if
  end function something_changes

  !> Find the changes between the points; known locations split the interval. Two more crossings may
  !! lie where a test function dips.
  subroutine explain_all(s, which, dip, cancel)
    type(search_type), intent(inout) :: s
    !> Results of find_dip.
    integer, intent(in) :: which
    real(wp), intent(in) :: dip
    integer, intent(inout), optional :: cancel
    type(node_type) :: left, lower, upper
    logical :: description
    integer :: k

    call gather(s)
    if (which == 0 .and. alone(s)) then
      call append(s, s%place_kinds(1), s%place_p(1), s%place_x(:, 1), s%place_errors(1), 0.0_wp)
      return
    end if
    left = s%first
    do k = 1, size(s%places)
      call look_around(s, k, left, lower, upper, description)
      if (.not. description) cycle
      call explain_part(left, lower)
      call append(s, s%place_kinds(k), s%place_p(k), s%place_x(:, k), s%place_errors(k), 0.0_wp)
      left = upper
    end do
    call explain_part(left, s%last)

  contains

    subroutine explain_part(a, b)
      type(node_type), intent(in) :: a, b
      if (a%n_growing == b%n_growing .and. which > 0 .and. dip > a%at%sigma &
          .and. dip < b%at%sigma) then
        call dive(s, a, b, which, dip, cancel)
      else
        call explain(s, a, b, 0, cancel)
      end if
    end subroutine explain_part

  end subroutine explain_all

  !> With few harmonics exponents vanish a little before or after the turning point of p. A fold
  !! without a change gets the nearest change if it is close, belongs to no other fold, and is not
  !! at a branch point of the equations.
  subroutine give_folds(s)
    type(search_type), intent(inout) :: s
    logical :: free(size(s%crossings)), taken
    integer :: j, m
    free = s%crossings%kind == crossing_branch_point
    do m = 1, size(s%crossings)
      if (s%crossings(m)%kind /= crossing_fold) cycle
      free(m) = .not. any(same(s%folds%p(:s%folds%n), s%crossings(m)))
    end do
    do m = 1, s%branch_points%n
      free = free .and. s%crossings%before /= s%branch_points%before(m)
    end do
    do j = 1, s%folds%n
      taken = .false.
      do m = 1, size(s%crossings)
        taken = taken .or. (s%crossings(m)%kind == crossing_fold &
                            .and. same(s%folds%p(j), s%crossings(m)))
      end do
      if (taken .or. .not. any(free)) cycle
      m = minloc(abs(s%crossings%before - s%folds%before(j)), 1, free)
      if (.not. near_fold(s, j, s%crossings(m))) cycle
      free(m) = .false.
      s%crossings(m)%kind = crossing_fold
      s%crossings(m)%located = .true.
      s%crossings(m)%p = s%folds%p(j)
      s%crossings(m)%error = s%folds%error(j)
      s%crossings(m)%x = s%folds%x(:size(s%x, 1), j)
    end do
  end subroutine give_folds

  !> True if a crossing may belong to fold j.
  pure logical function near_fold(s, j, crossing)
    type(search_type), intent(in) :: s
    integer, intent(in) :: j
    type(crossing_type), intent(in) :: crossing
    near_fold = abs(crossing%before - s%folds%before(j)) <= furthest
    if (near_fold .or. .not. crossing%located) return
    associate (x => s%folds%x(:size(s%x, 1), j))
      near_fold = abs(crossing%p - s%folds%p(j)) <= displaced*abs(s%folds%p(j)) &
                  .and. norm2(crossing%x - x) <= turned*norm2(x)
    end associate
  end function near_fold

  !> True if a crossing is at p.
  elemental logical function same(p, crossing)
    real(wp), intent(in) :: p
    type(crossing_type), intent(in) :: crossing
    same = crossing%located
    if (same) same = .not. abs(crossing%p - p) > 0.0_wp
  end function same

  !> True if a located point explains all changes: only one real multiplier crosses 1.
  pure logical function alone(s)
    type(search_type), intent(in) :: s
    alone = size(s%places) == 1 .and. abs(s%n_growing(s%i + 1) - s%n_growing(s%i)) == 1 &
            .and. s%spectrum%complete
    if (alone) alone = all((s%tests(:, s%i)*s%tests(:, s%i + 1) > 0.0_wp) &
                           .eqv. [.false., .true., .true.])
  end function alone

  subroutine put_node(s, sigma, j, node)
    type(search_type), intent(in) :: s
    real(wp), intent(in) :: sigma
    integer, intent(in) :: j
    type(node_type), intent(out) :: node
    node%at%sigma = sigma
    node%at%p = s%p(j)
    node%at%x = s%x(:, j)
    node%eta = s%eta(:, j)
    node%n_growing = s%n_growing(j)
  end subroutine put_node

  !> The located folds and branch points after point i, sorted by sigma.
  subroutine gather(s)
    type(search_type), intent(inout) :: s
    integer :: j, m
    s%places = [real(wp) ::]
    s%place_p = [real(wp) ::]
    s%place_errors = [real(wp) ::]
    s%place_kinds = [integer ::]
    s%place_x = reshape([real(wp) ::], [size(s%x, 1), 0])
    do j = 1, s%folds%n
      if (s%folds%before(j) /= s%i) cycle
      call put(s, s%folds%p(j), s%folds%error(j), s%folds%x(:size(s%x, 1), j), crossing_fold)
    end do
    do j = 1, s%branch_points%n
      if (s%branch_points%before(j) /= s%i) cycle
      call put(s, s%branch_points%p(j), s%branch_points%error(j), &
               s%branch_points%x(:size(s%x, 1), j), crossing_branch_point)
    end do
    do j = 2, size(s%places)
      do m = j, 2, -1
        if (s%places(m) >= s%places(m - 1)) exit
        s%places([m - 1, m]) = s%places([m, m - 1])
        s%place_p([m - 1, m]) = s%place_p([m, m - 1])
        s%place_errors([m - 1, m]) = s%place_errors([m, m - 1])
        s%place_kinds([m - 1, m]) = s%place_kinds([m, m - 1])
        s%place_x(:, [m - 1, m]) = s%place_x(:, [m, m - 1])
      end do
    end do
  end subroutine gather

  subroutine put(s, at_p, error, at_x, kind)
    type(search_type), intent(inout) :: s
    real(wp), intent(in) :: at_p, error, at_x(:)
    integer, intent(in) :: kind
    s%places = [s%places, s%chord%sigma_of(at_p, at_x)]
    s%place_p = [s%place_p, at_p]
    s%place_errors = [s%place_errors, error]
    s%place_kinds = [s%place_kinds, kind]
    s%place_x = reshape([s%place_x, at_x], [size(at_x), size(s%places)])
  end subroutine put

  !> Nodes on both sides of the located point k, between which one exponent crosses.
  subroutine look_around(s, k, left, lower, upper, description)
    type(search_type), intent(inout) :: s
    integer, intent(in) :: k
    type(node_type), intent(in) :: left
    type(node_type), intent(out) :: lower, upper
    logical, intent(out) :: description
    real(wp) :: end
    integer :: j

    end = s%last%at%sigma
    if (k < size(s%places)) end = 0.5_wp*(s%places(k) + s%places(k + 1))
    description = .false.
    do j = 1, size(nearby)
      call look_at(s%curve, s%spectrum, s%chord, max(left%at%sigma, s%places(k) - nearby(j)), &
                   left, s%last, lower)
      call look_at(s%curve, s%spectrum, s%chord, &
                   min(max(end, left%at%sigma), s%places(k) + nearby(j)), left, s%last, upper)
      if (min(lower%n_growing, upper%n_growing) < 0) cycle
      description = abs(lower%n_growing - upper%n_growing) == 1
      if (description) return
    end do
  end subroutine look_around

  !> Find the changes between two nodes.
  recursive subroutine explain(s, a, b, depth, cancel)
    type(search_type), intent(inout) :: s
    type(node_type), intent(in) :: a, b
    integer, intent(in) :: depth
    integer, intent(inout), optional :: cancel
    type(node_type) :: lo, hi, root
    integer :: kind, width
    logical :: located

    if (given_up(cancel)) return
    if (a%n_growing == b%n_growing) then
      ! A multiplier may cross 1 and another one -1, so that their number stays the same.
      if (depth >= max_halvings .or. .not. s%spectrum%complete) return
      if (.not. turn_over(tests_of(a%eta), tests_of(b%eta))) return
      call look_between(s%curve, s%spectrum, s%chord, a, b, root)
      if (root%n_growing < 0) return
      call explain(s, a, root, depth + 1, cancel)
      call explain(s, root, b, depth + 1, cancel)
      return
    end if
    lo = a
    hi = b
    located = .false.
    if (depth < max_depth) call bracket(s%curve, s%spectrum, s%chord, lo, hi, root, located, cancel)
    if (.not. located) then
      call report(s, a, b)
      return
    end if
    kind = kind_of(s%spectrum%half_wave, root%eta(1), root%at%slope, a, b)
    width = merge(2, 1, kind == crossing_pair)
    if (abs(hi%n_growing - lo%n_growing) /= width .or. .not. s%spectrum%complete) then
      call search_nearby(s, a, b, root%at%sigma, lo, hi)
    end if
    if (min(lo%n_growing, hi%n_growing) < 0) then
      call report(s, a, b)
      return
    end if
    call explain(s, a, lo, depth + 1, cancel)
    if (abs(hi%n_growing - lo%n_growing) == width) then
      call append(s, kind, root%at%p, root%at%x, unknown, aimag(root%eta(1)))
    else
      call report(s, lo, hi)
    end if
    call explain(s, hi, b, depth + 1, cancel)
  end subroutine explain

  !> True if the test functions of both multipliers 1 and -1 change their signs.
  pure logical function turn_over(one, other)
    real(wp), intent(in) :: one(:), other(:)
    turn_over = all(one(:2)*other(:2) < 0.0_wp)
  end function turn_over

  !> Nodes close to a location on both sides.
  subroutine search_nearby(s, a, b, sigma, lo, hi)
    type(search_type), intent(inout) :: s
    type(node_type), intent(in) :: a, b
    real(wp), intent(in) :: sigma
    type(node_type), intent(out) :: lo, hi
    real(wp) :: off
    integer :: j
    do j = 1, size(nearby)
      off = nearby(j)*(b%at%sigma - a%at%sigma)
      call look_at(s%curve, s%spectrum, s%chord, sigma - off, a, b, lo)
      call look_at(s%curve, s%spectrum, s%chord, sigma + off, a, b, hi)
      if (min(lo%n_growing, hi%n_growing) >= 0 .and. lo%n_growing /= hi%n_growing) return
    end do
  end subroutine search_nearby

  !> Add changes without a location: types by the exponents on the side where they grow.
  subroutine report(s, a, b)
    type(search_type), intent(inout) :: s
    type(node_type), intent(in) :: a, b
    complex(wp) :: outer(s%spectrum%n)
    integer :: k, kind

    outer = a%eta
    if (b%n_growing > a%n_growing) outer = b%eta
    k = max(a%n_growing, b%n_growing)
    do while (k > min(a%n_growing, b%n_growing))
      kind = crossing_branch_point
      if (ieee_is_finite(real(outer(k)))) then
        kind = kind_of(s%spectrum%half_wave, outer(k), 1.0_wp, a, b)
      end if
      if (kind == crossing_pair .and. k == min(a%n_growing, b%n_growing) + 1) then
        kind = crossing_branch_point
      end if
      s%crossings = [s%crossings, crossing_type(kind, s%i, x=[real(wp) ::])]
      k = k - merge(2, 1, kind == crossing_pair)
    end do
  end subroutine report

  subroutine append(s, kind, at_p, at_x, error, turn)
    type(search_type), intent(inout) :: s
    integer, intent(in) :: kind
    real(wp), intent(in) :: at_p, at_x(:), error
    !> Argument of the multiplier.
    real(wp), intent(in) :: turn
    s%crossings = [s%crossings, crossing_type(kind, s%i, .true., at_p, error, at_x, &
                                              cmplx(0.0_wp, turn, wp))]
  end subroutine append

  pure integer function kind_of(half_wave, exponent, slope, a, b) result(kind)
    logical, intent(in) :: half_wave
    complex(wp), intent(in) :: exponent
    !> dp/dsigma at the crossing.
    real(wp), intent(in) :: slope
    type(node_type), intent(in) :: a, b

    if (abs(aimag(exponent)) <= on_line) then
      kind = crossing_branch_point
      if (abs(slope) <= turning*abs((b%at%p - a%at%p)/(b%at%sigma - a%at%sigma))) then
        kind = crossing_fold
      end if
    else if (pi - abs(aimag(exponent)) <= on_line) then
      kind = merge(crossing_symmetry, crossing_doubling, half_wave)
    else
      kind = crossing_pair
    end if
  end function kind_of

  !> Find two crossings within a step, near the minimum of a test function.
  subroutine dive(s, a, b, which, sigma, cancel)
    type(search_type), intent(inout) :: s
    type(node_type), intent(in) :: a, b
    integer, intent(in) :: which
    real(wp), intent(in) :: sigma
    integer, intent(inout), optional :: cancel
    type(node_type) :: left, middle, right, trial
    real(wp) :: value(3), place(3), least, bottom, curvature, slope, all(n_tests)
    integer :: k

    left = a
    right = b
    all = tests_of(a%eta)
    value(1) = all(which)
    all = tests_of(b%eta)
    value(3) = all(which)
    least = sigma
    do k = 1, max_looks
      call look_at(s%curve, s%spectrum, s%chord, least, left, right, trial)
      if (trial%n_growing < 0) return
      if (trial%n_growing /= a%n_growing) then
        call explain(s, a, trial, 1, cancel)
        call explain(s, trial, b, 1, cancel)
        return
      end if
      all = tests_of(trial%eta)
      if (k == 1) then
        middle = trial
        value(2) = all(which)
      else if (abs(all(which)) < abs(value(2))) then
        if (least < middle%at%sigma) then
          right = middle
          value(3) = value(2)
        else
          left = middle
          value(1) = value(2)
        end if
        middle = trial
        value(2) = all(which)
      else if (least < middle%at%sigma) then
        left = trial
        value(1) = all(which)
      else
        right = trial
        value(3) = all(which)
      end if
      place = [left%at%sigma, middle%at%sigma, right%at%sigma]
      ! The minimum of the parabola through the three points.
      slope = (value(2) - value(1))/(place(2) - place(1))
      curvature = ((value(3) - value(2))/(place(3) - place(2)) - slope)/(place(3) - place(1))
      if (.not. curvature*value(2) > 0.0_wp) return
      least = 0.5_wp*(place(1) + place(2) - slope/curvature)
      bottom = value(1) + (least - place(1))*(slope + curvature*(least - place(2)))
      if (.not. bottom*sign(1.0_wp, value(2)) < 0.6_wp*abs(value(2))) return
      if (.not. (least > place(1) .and. least < place(3))) return
      if (abs(least - place(2)) < 1.0e-3_wp*(place(3) - place(1))) return
    end do
  end subroutine dive

end module viscovib_crossing_search
