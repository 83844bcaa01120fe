!> Where exponents of a curve's solutions cross the imaginary axis, and what is crossed there.
!!
!! Every change of the number of growing exponents between two neighbours is explained: folds and
!! branch points that the continuation has located split the way between them, with the number
!! known on both sides; in the rest the real part of an exponent, by size, is made 0, and what is
!! left on both sides of the place found is searched on. Where nothing changes two crossings may
!! still lie within a step: functions of all exponents that vanish at crossings, smooth along the
!! curve, tell where.
module viscovib_crossing_search
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_chord, only: chord_type, new_chord
  use viscovib_constants, only: pi
  use viscovib_crossing_dips, only: find_dip, n_tests, tests_of
  use viscovib_crossing_nodes, only: look_at, node_type, spectrum_type
  use viscovib_crossing_roots, only: bracket, given_up, on_line
  use viscovib_curve, only: curve_type
  use viscovib_curve_events, only: special_points
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: crossing_type, find_changes

  !> What is crossed: a multiplier 1 where p turns back, or where it does not; -1 of half a
  !! period; -1; a pair.
  integer, parameter, public :: crossing_fold = 1, crossing_branch_point = 2, &
                                crossing_symmetry = 3, crossing_doubling = 4, crossing_pair = 5

  integer, parameter :: max_depth = 12, max_looks = 8
  !> How far to both sides of a place the number is looked at, in sigma: one after the other.
  real(wp), parameter :: beside(4) = [1.0e-3_wp, 1.0e-4_wp, 1.0e-2_wp, 5.0e-2_wp]
  !> Where dp/dsigma is so small a part of what it is at the ends, p turns back.
  real(wp), parameter :: turning = 0.05_wp

  type :: crossing_type
    !> One of those above, and the last point before it.
    integer :: kind = 0, before = 0
    !> Whether p and x are known.
    logical :: located = .false.
    real(wp) :: p = 0.0_wp
    !> Unknowns of the curve.
    real(wp), allocatable :: x(:)
  end type crossing_type

contains

  !> All crossings between neighbours whose stability is known, in their order.
  subroutine find_changes(curve, spectrum, p, x, eta, n_growing, folds, branch_points, crossings, &
                          cancel)
    class(curve_type), intent(inout) :: curve
    class(spectrum_type), intent(inout) :: spectrum
    !> Points of the curve, shapes (n) and (n_unknowns, n); their exponents, shape (slots, n),
    !! and how many grow, -1: unknown.
    real(wp), intent(in) :: p(:), x(:, :)
    complex(wp), intent(in) :: eta(:, :)
    integer, intent(in) :: n_growing(:)
    type(special_points), intent(in) :: folds, branch_points
    type(crossing_type), allocatable, intent(out) :: crossings(:)
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile, optional :: cancel
    type(chord_type) :: chord
    type(node_type) :: first, last, left, lower, upper
    !> Known places between two neighbours: sigma, p and unknowns.
    real(wp), allocatable :: places(:), place_p(:), place_x(:, :)
    integer, allocatable :: place_kinds(:)
    real(wp) :: tests(n_tests, size(p)), dip
    integer :: i, k, which
    logical :: searched, told

    allocate (crossings(0))
    do i = 1, size(p)
      tests(:, i) = tests_of(eta(:, i))
    end do
    do i = 1, size(p) - 1
      if (given_up(cancel)) exit
      if (minval(n_growing(i:i + 1)) < 0) cycle
      searched = n_growing(i) /= n_growing(i + 1)
      if (folds%n > 0) searched = searched .or. any(folds%before(:folds%n) == i)
      associate (before => branch_points%before(:branch_points%n))
        searched = searched .or. any(before == i)
      end associate
      which = 0
      if (.not. searched) call find_dip(tests, p, x, i, which, dip)
      if (.not. searched .and. which == 0) cycle
      call new_chord(chord, curve, p(i:i + 1), x(:, i:i + 1))
      call put_node(0.0_wp, i, first)
      call put_node(1.0_wp, i + 1, last)
      if (which > 0) then
        call dive(first, last, which, dip)
        cycle
      end if
      call gather()
      if (alone()) then
        call append(place_kinds(1), place_p(1), place_x(:, 1))
        cycle
      end if
      left = first
      do k = 1, size(places)
        call look_around(k, left, lower, upper, told)
        if (.not. told) cycle
        call explain(left, lower, 0)
        call append(place_kinds(k), place_p(k), place_x(:, k))
        left = upper
      end do
      call explain(left, last, 0)
    end do
    call give_folds()

  contains

    !> With few orders exponents vanish a little before or behind where p turns back: a fold that
    !! no change was found at has the nearest branch point that the equations do not know.
    subroutine give_folds()
      logical :: free(size(crossings)), taken
      integer :: j, m
      free = crossings%kind == crossing_branch_point
      do m = 1, branch_points%n
        free = free .and. crossings%before /= branch_points%before(m)
      end do
      do j = 1, folds%n
        taken = .false.
        do m = 1, size(crossings)
          if (crossings(m)%kind == crossing_fold .and. crossings(m)%located) then
            taken = taken .or. .not. abs(crossings(m)%p - folds%p(j)) > 0.0_wp
          end if
        end do
        if (taken .or. .not. any(free)) cycle
        m = minloc(abs(crossings%before - folds%before(j)), 1, free)
        free(m) = .false.
        crossings(m)%kind = crossing_fold
        crossings(m)%located = .true.
        crossings(m)%p = folds%p(j)
        crossings(m)%x = folds%x(:size(x, 1), j)
      end do
    end subroutine give_folds

    !> Whether a known place explains all that changes: only a real multiplier crosses 1.
    logical function alone()
      alone = size(places) == 1 .and. abs(n_growing(i + 1) - n_growing(i)) == 1 &
              .and. spectrum%complete
      if (alone) alone = all((tests(:, i)*tests(:, i + 1) > 0.0_wp) &
                             .eqv. [.false., .true., .true.])
    end function alone

    subroutine put_node(sigma, j, node)
      real(wp), intent(in) :: sigma
      integer, intent(in) :: j
      type(node_type), intent(out) :: node
      node%at%sigma = sigma
      node%at%p = p(j)
      node%at%x = x(:, j)
      node%eta = eta(:, j)
      node%n_growing = n_growing(j)
    end subroutine put_node

    !> The known places behind point i, by sigma.
    subroutine gather()
      integer :: j, m
      places = [real(wp) ::]
      place_p = [real(wp) ::]
      place_kinds = [integer ::]
      place_x = reshape([real(wp) ::], [size(x, 1), 0])
      do j = 1, folds%n
        if (folds%before(j) == i) call put(folds%p(j), folds%x(:size(x, 1), j), crossing_fold)
      end do
      do j = 1, branch_points%n
        if (branch_points%before(j) == i) call put(branch_points%p(j), &
                                                   branch_points%x(:size(x, 1), j), &
                                                   crossing_branch_point)
      end do
      do j = 2, size(places)
        do m = j, 2, -1
          if (places(m) >= places(m - 1)) exit
          places([m - 1, m]) = places([m, m - 1])
          place_p([m - 1, m]) = place_p([m, m - 1])
          place_kinds([m - 1, m]) = place_kinds([m, m - 1])
          place_x(:, [m - 1, m]) = place_x(:, [m, m - 1])
        end do
      end do
    end subroutine gather

    subroutine put(at_p, at_x, kind)
      real(wp), intent(in) :: at_p, at_x(:)
      integer, intent(in) :: kind
      places = [places, chord%sigma_of(at_p, at_x)]
      place_p = [place_p, at_p]
      place_kinds = [place_kinds, kind]
      place_x = reshape([place_x, at_x], [size(at_x), size(places)])
    end subroutine put

    !> Nodes on both sides of the known place k, between which one exponent crosses.
    subroutine look_around(k, left, lower, upper, told)
      integer, intent(in) :: k
      type(node_type), intent(in) :: left
      type(node_type), intent(out) :: lower, upper
      logical, intent(out) :: told
      real(wp) :: end
      integer :: j

      end = last%at%sigma
      if (k < size(places)) end = 0.5_wp*(places(k) + places(k + 1))
      told = .false.
      do j = 1, size(beside)
        call look_at(curve, spectrum, chord, max(left%at%sigma, places(k) - beside(j)), &
                     left, last, lower)
        call look_at(curve, spectrum, chord, min(max(end, left%at%sigma), places(k) &
                                                     + beside(j)), left, last, upper)
        if (min(lower%n_growing, upper%n_growing) < 0) cycle
        told = abs(lower%n_growing - upper%n_growing) == 1
        if (told) return
      end do
    end subroutine look_around

    !> What changes between two nodes.
    recursive subroutine explain(a, b, depth)
      type(node_type), intent(in) :: a, b
      integer, intent(in) :: depth
      type(node_type) :: lo, hi, root
      integer :: kind, width
      logical :: located

      if (a%n_growing == b%n_growing .or. given_up(cancel)) return
      lo = a
      hi = b
      located = .false.
      if (depth < max_depth) call bracket(curve, spectrum, chord, lo, hi, root, located, cancel)
      if (.not. located) then
        call report(a, b)
        return
      end if
      kind = kind_of(root%eta(1), root%at%slope, a, b)
      width = merge(2, 1, kind == crossing_pair)
      if (abs(hi%n_growing - lo%n_growing) /= width .or. .not. spectrum%complete) then
        call look_beside(a, b, root%at%sigma, lo, hi)
      end if
      if (min(lo%n_growing, hi%n_growing) < 0) then
        call report(a, b)
        return
      end if
      call explain(a, lo, depth + 1)
      if (abs(hi%n_growing - lo%n_growing) == width) then
        call append(kind, root%at%p, root%at%x)
      else
        call report(lo, hi)
      end if
      call explain(hi, b, depth + 1)
    end subroutine explain

    !> Nodes close to a place on both sides.
    subroutine look_beside(a, b, sigma, lo, hi)
      type(node_type), intent(in) :: a, b
      real(wp), intent(in) :: sigma
      type(node_type), intent(out) :: lo, hi
      integer :: j
      do j = 1, size(beside)
        call look_at(curve, spectrum, chord, sigma - beside(j)*(b%at%sigma - a%at%sigma), a, b, lo)
        call look_at(curve, spectrum, chord, sigma + beside(j)*(b%at%sigma - a%at%sigma), a, b, hi)
        if (min(lo%n_growing, hi%n_growing) >= 0 .and. lo%n_growing /= hi%n_growing) return
      end do
    end subroutine look_beside

    !> Changes whose places are not found: kinds by the exponents where they grow.
    subroutine report(a, b)
      type(node_type), intent(in) :: a, b
      complex(wp) :: outer(spectrum%n)
      integer :: k, kind

      outer = a%eta
      if (b%n_growing > a%n_growing) outer = b%eta
      k = max(a%n_growing, b%n_growing)
      do while (k > min(a%n_growing, b%n_growing))
        kind = crossing_branch_point
        if (ieee_is_finite(real(outer(k)))) kind = kind_of(outer(k), 1.0_wp, a, b)
        if (kind == crossing_pair .and. k == min(a%n_growing, b%n_growing) + 1) then
          kind = crossing_branch_point
        end if
        crossings = [crossings, crossing_type(kind, i, .false., 0.0_wp, [real(wp) ::])]
        k = k - merge(2, 1, kind == crossing_pair)
      end do
    end subroutine report

    subroutine append(kind, at_p, at_x)
      integer, intent(in) :: kind
      real(wp), intent(in) :: at_p, at_x(:)
      type(crossing_type) :: crossing
      crossing%kind = kind
      crossing%before = i
      crossing%located = .true.
      crossing%p = at_p
      crossing%x = at_x
      crossings = [crossings, crossing]
    end subroutine append

    integer function kind_of(exponent, slope, a, b) result(kind)
      complex(wp), intent(in) :: exponent
      !> dp/dsigma there.
      real(wp), intent(in) :: slope
      type(node_type), intent(in) :: a, b

      if (abs(aimag(exponent)) <= on_line) then
        kind = crossing_branch_point
        if (abs(slope) <= turning*abs((b%at%p - a%at%p)/(b%at%sigma - a%at%sigma))) then
          kind = crossing_fold
        end if
      else if (pi - abs(aimag(exponent)) <= on_line) then
        kind = merge(crossing_symmetry, crossing_doubling, spectrum%half_wave)
      else
        kind = crossing_pair
      end if
    end function kind_of

    !> Two crossings within a step, near the least of a test there.
    subroutine dive(a, b, which, sigma)
      type(node_type), intent(in) :: a, b
      integer, intent(in) :: which
      real(wp), intent(in) :: sigma
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
        call look_at(curve, spectrum, chord, least, left, right, trial)
        if (trial%n_growing < 0) return
        if (trial%n_growing /= a%n_growing) then
          call explain(a, trial, 1)
          call explain(trial, b, 1)
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
        ! The least of the parabola through the three.
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

  end subroutine find_changes

end module viscovib_crossing_search
