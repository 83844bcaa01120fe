!> Stability along a branch of periodic motions of a driven system, and where it changes.
!!
!! Between two neighbours, one of which has more Floquet multipliers outside the unit circle, the
!! motion is found at values of the parameter between theirs until the multiplier that crosses has
!! size 1, by false position (Illinois: Dowell and Jarratt, BIT 11 (1971) 168).
module viscovib_orbit_stability
  use viscovib_crossings, only: crossing_branch_point, crossing_doubling, crossing_fold, &
    crossing_pair, crossing_type
  use viscovib_curve_events, only: special_points
  use viscovib_curve_newton, only: solve_on_curve
  use viscovib_kinds, only: wp
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_multipliers, only: count_larger, multipliers_of
  use viscovib_outcomes, only: outcome_converged
  use viscovib_torus_balance, only: torus_balance_type
  implicit none
  private

  public :: judge_orbits, find_orbit_crossings

  !> Multipliers this close to the unit circle count as on it.
  real(wp), parameter, public :: orbit_circle = 1.0_wp + 1.0e-9_wp
  integer, parameter :: max_evaluations = 60
  !> Wanted part of the parameter, and of the distance between the neighbours.
  real(wp), parameter :: narrow = 1.0e-13_wp, narrow_part = 1.0e-11_wp
  !> A multiplier this far off the real axis, as a part of its size, is one of a pair.
  real(wp), parameter :: off_axis = 1.0e-4_wp

contains

  !> Multipliers of the solutions x of `balance`, which has one axis, at the parameters p.
  subroutine judge_orbits(floquet, balance, p, x, multipliers, cancel)
    type(orbit_floquet_type), intent(inout) :: floquet
    type(torus_balance_type), intent(inout) :: balance
    !> Shapes (n) and (balance%n, n).
    real(wp), intent(in) :: p(:), x(:, :)
    !> Largest first, NaN where unknown, shape (2 n_dof, n).
    complex(wp), intent(out) :: multipliers(:, :)
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile, optional :: cancel
    real(wp) :: matrix(size(multipliers, 1), size(multipliers, 1))
    logical :: inside
    integer :: i

    multipliers = (0.0_wp, 0.0_wp)
    do i = 1, size(p)
      if (present(cancel)) then
        if (cancel /= 0) return
      end if
      call balance%visit(x(:, i), p(i), .true., inside)
      call floquet%monodromy(balance, x(:, i), matrix)
      call multipliers_of(matrix, multipliers(:, i))
    end do
  end subroutine judge_orbits

  !> All changes between neighbours whose multipliers are known; folds and branch points are
  !! those the continuation has located. Of each the motion is given as all unknowns, those
  !! left out as 0, shape (torus%n, n_dof).
  subroutine find_orbit_crossings(floquet, balance, tolerance, p, x, multipliers, folds, &
                                  branch_points, crossings, cancel)
    type(orbit_floquet_type), intent(inout) :: floquet
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: tolerance, p(:), x(:, :)
    complex(wp), intent(in) :: multipliers(:, :)
    type(special_points), intent(in) :: folds, branch_points
    type(crossing_type), allocatable, intent(out) :: crossings(:)
    integer, intent(inout), volatile, optional :: cancel
    type(crossing_type) :: crossing
    integer :: outside(2), i, k

    allocate (crossings(0))
    do i = 1, size(p) - 1
      if (present(cancel)) then
        if (cancel /= 0) return
      end if
      outside = [count_larger(multipliers(:, i), orbit_circle), &
                 count_larger(multipliers(:, i + 1), orbit_circle)]
      if (minval(outside) < 0 .or. outside(1) == outside(2)) cycle
      crossing%before = i
      crossing%located = .false.
      k = 0
      if (folds%n > 0) k = minloc(abs(folds%before(:folds%n) - i), 1)
      if (k > 0) then
        if (abs(folds%before(k) - i) > 1) k = 0
      end if
      if (k > 0) then
        crossing%kind = crossing_fold
        crossing%located = .true.
        crossing%p = folds%p(k)
        crossing%x = balance%expanded(folds%x(:, k))
      else
        call locate(floquet, balance, tolerance, p(i:i + 1), x(:, i:i + 1), &
                    multipliers(:, i:i + 1), maxval(outside), crossing, cancel)
        if (.not. crossing%located .and. crossing%kind == crossing_branch_point) then
          k = findloc(branch_points%before(:branch_points%n), i, 1)
          if (k > 0) then
            crossing%located = .true.
            crossing%p = branch_points%p(k)
            crossing%x = balance%expanded(branch_points%x(:, k))
          end if
        end if
      end if
      crossings = [crossings, crossing]
    end do
  end subroutine find_orbit_crossings

  !> Where the multiplier of a place, by size, crosses the circle.
  subroutine locate(floquet, balance, tolerance, p, x, multipliers, place, crossing, cancel)
    type(orbit_floquet_type), intent(inout) :: floquet
    type(torus_balance_type), intent(inout) :: balance
    !> Of the two neighbours.
    real(wp), intent(in) :: tolerance, p(0:1), x(:, 0:)
    complex(wp), intent(in) :: multipliers(:, 0:)
    integer, intent(in) :: place
    type(crossing_type), intent(inout) :: crossing
    integer, intent(inout), volatile, optional :: cancel
    complex(wp) :: roots(size(multipliers, 1), 1)
    real(wp) :: at(balance%n, 1), sigma(0:1), value(0:1), trial, last, here
    integer :: k, side, before, outcome, iterations

    value = abs(multipliers(place, :)) - 1.0_wp
    ! Where it is outside, it is the smallest there.
    crossing%kind = kind_of(multipliers(place:place, maxloc(value, 1) - 1))
    if (.not. value(0)*value(1) < 0.0_wp) then
      ! The end that counts as on the circle is where it crosses, as at the first point of
      ! a branch that leaves another.
      side = minloc(abs(value), 1) - 1
      crossing%located = abs(value(side)) <= orbit_circle - 1.0_wp
      if (.not. crossing%located) return
      crossing%p = p(side)
      crossing%x = balance%expanded(x(:, side))
      return
    end if
    sigma = [0.0_wp, 1.0_wp]
    last = huge(last)
    before = -1
    do k = 1, max_evaluations
      trial = sigma(0) + (sigma(1) - sigma(0))*value(0)/(value(0) - value(1))
      here = p(0) + trial*(p(1) - p(0))
      at(:, 1) = x(:, 0) + trial*(x(:, 1) - x(:, 0))
      iterations = 0
      call solve_on_curve(balance, here, tolerance, at(:, 1), outcome, iterations, cancel)
      if (outcome /= outcome_converged) return
      call judge_orbits(floquet, balance, [here], at, roots, cancel)
      if (count_larger(roots(:, 1), orbit_circle) < 0) return
      associate (found => abs(roots(place, 1)) - 1.0_wp)
        side = merge(0, 1, found*value(0) > 0.0_wp)
        sigma(side) = trial
        value(side) = found
        if (side == before) value(1 - side) = 0.5_wp*value(1 - side)
        before = side
        if (.not. abs(found) > 0.0_wp) exit
      end associate
      if (min(abs(trial - last), sigma(1) - sigma(0)) <= narrow_part) exit
      if (abs((trial - last)*(p(1) - p(0))) <= narrow*maxval(abs(p))) exit
      last = trial
    end do
    if (k > max_evaluations) return
    crossing%located = .true.
    crossing%kind = kind_of(roots(:, 1))
    crossing%p = here
    crossing%x = balance%expanded(at(:, 1))
  end subroutine locate

  !> What is crossed, by the one of the multipliers that is nearest to the circle.
  pure integer function kind_of(roots) result(kind)
    complex(wp), intent(in) :: roots(:)
    associate (root => roots(minloc(abs(abs(roots) - 1.0_wp), 1)))
      if (abs(aimag(root)) > off_axis*abs(root)) then
        kind = crossing_pair
      else
        kind = merge(crossing_branch_point, crossing_doubling, real(root) > 0.0_wp)
      end if
    end associate
  end function kind_of

end module viscovib_orbit_stability
