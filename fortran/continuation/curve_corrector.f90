! Optimize: -O3
!> Steps along a curve: predictor and corrector of pseudo-arclength continuation, with
!! the unit tangent and the determinant of the bordered derivatives at each point.
!!
!! The predictor is the cubic through the last two points and their tangents. The corrector is
!! Newton's method on the equations together with <t, z - predicted> = 0, with the previous tangent
!! t. With `exact` false it keeps the factors of its first step while they converge fast, so that a
!! point needs one factorization.
module viscovib_curve_corrector
  use viscovib_curve, only: curve_type
  use viscovib_curve_factors, only: curve_factors, new_factors
  use viscovib_curve_point, only: angle_between, curve_metric, curve_point, metric, normalize, &
    off_at_value
  use viscovib_dense, only: largest_in_rows
  use viscovib_kinds, only: wp
  use viscovib_sized_curve, only: sized_curve_type
  use viscovib_stopping, only: given_up
  implicit none
  private

  public :: corrector_type, new_corrector, aim, aim_straight, correct, null_vector, compare, &
            displace

  integer, parameter :: max_iterations = 12, longest = 8
  !> With the factors kept, each correction must shrink by this factor.
  real(wp), parameter :: fast_enough = 0.1_wp
  !> Error of a tangent from kept factors, in units of the rate of convergence.
  real(wp), parameter :: doubtful = 40.0_wp
  real(wp), parameter :: rounding = 4.0_wp*epsilon(1.0_wp)
  !> Relative distance to a nearby point.
  real(wp), parameter :: nearby = 1.0e-9_wp
  !> A last correction below this changes determinant and tangent by rounding error only.
  real(wp), parameter :: nearly_rounding = 1.0e-13_wp
  !> With kept factors: target for the remaining error, relative to the tolerance.
  real(wp), parameter :: far_below = 1.0e-4_wp
  !> Corrections of Newton's method that no longer shrink by this factor are rounding error, if they
  !! are below the second value: the equations are then nearly singular.
  real(wp), parameter :: shrinking = 0.7_wp, small_enough = 1.0e-6_wp
  !> Groups below the first fraction of the solution may deviate more, by the second factor.
  real(wp), parameter :: minor = 1.0e-2_wp, lenience = 1.0_wp/3.0_wp
  !> A group vanishes if a step reduces it below this fraction.
  real(wp), parameter :: vanished = 1.0e-3_wp
  !> Cosine of the largest angle between the solutions at the ends of a step.
  real(wp), parameter :: least_alike = 0.5_wp
  !> With pivots in a wider range, rounding may move a solution by more than the tolerance.
  real(wp), parameter :: wide = 1.0e-5_wp

  !> Workspace of the corrector. `outside`: the last point was outside the range of the equations.
  type, extends(curve_metric) :: corrector_type
    real(wp) :: tolerance = 0.0_wp
    !> Additional absolute tolerance, in the weighted norm.
    real(wp) :: least = 0.0_wp
    logical :: outside = .false.
    !> True if the curve provides its groups of unknowns, so that steps and rounding are checked.
    logical, private :: looks_at_groups = .false.
    !> True if the derivatives factorized last are nearly singular.
    logical :: nearly_singular = .false.
    integer, private :: n = 0
    type(curve_factors), private :: factors
    real(wp), allocatable, private :: right(:), r(:), slope_p(:)
    !> Typical size of each unknown, and the largest term of each equation, to scale pivots.
    real(wp), allocatable, private :: sizes(:), largest_of(:)
    !> The largest term of each equation, by the derivatives factorized last; more rows are unused.
    real(wp), allocatable :: terms(:)
    !> The last correction, and the part of it that remains as error.
    real(wp), allocatable, private :: last(:)
    real(wp), private :: left = 1.0_wp
    !> Prediction, and its terms after the tangent: h^2 second + h^3 third.
    real(wp), allocatable, private :: predicted(:), second(:), third(:)
  end type corrector_type

contains

  subroutine new_corrector(corrector, curve, tolerance, p_scale, x, absolute)
    type(corrector_type), intent(out) :: corrector
    class(curve_type), intent(in) :: curve
    real(wp), intent(in) :: tolerance
    !> Typical size of the parameter.
    real(wp), intent(in) :: p_scale
    real(wp), intent(in) :: x(:)
    !> Additional absolute error of the unknowns, in their units.
    real(wp), intent(in), optional :: absolute
    real(wp) :: lightest
    integer :: blocks, n

    n = curve%n
    corrector%n = n
    blocks = 1
    select type (curve)
    class is (sized_curve_type)
      blocks = curve%blocks
    end select
    call new_factors(corrector%factors, n, blocks)
    allocate (corrector%right(n + 1), corrector%r(n), corrector%slope_p(n), &
              corrector%predicted(n + 1))
    allocate (corrector%second(n + 1), corrector%third(n + 1), source=0.0_wp)
    allocate (corrector%terms(corrector%factors%rows), corrector%last(n + 1), source=0.0_wp)
    allocate (corrector%weights(n), source=1.0_wp)
    if (allocated(curve%weights)) corrector%weights = curve%weights
    corrector%alone = curve%alone
    allocate (corrector%sizes(n + 1), corrector%largest_of(corrector%factors%rows), source=1.0_wp)
    corrector%tolerance = tolerance
    if (present(absolute)) then
      ! Half: for a complex pair, |Re| + |Im| is at most sqrt(2) times its length.
      lightest = minval(corrector%weights, corrector%weights > 0.0_wp)
      if (absolute > 0.0_wp) corrector%least = absolute*sqrt(0.5_wp*lightest)
    end if
    corrector%looks_at_groups = allocated(curve%last_of_group)
    corrector%p_scale = p_scale
    corrector%largest = sum(corrector%weights*x**2)
  end subroutine new_corrector

  !> Predict from `here` with the curvature since `before`: the cubic through both points and
  !! tangents, with the length measured as at `here`.
  subroutine aim(c, before, here)
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: before, here
    real(wp) :: weight_x, weight_p, length, chord, angle
    integer :: n

    n = c%n
    call metric(c, here, weight_x, weight_p)
    chord = sqrt(weight_x*sum(c%weights*(here%x - before%x)**2) &
                 + weight_p*(here%p - before%p)**2)
    length = sqrt(weight_x*sum(c%weights*before%slope_x**2) + weight_p*before%slope_p**2)
    angle = angle_between(c, before, here)
    if (.not. (chord > 0.0_wp .and. length > 0.0_wp)) then
      call aim_straight(c)
      return
    end if
    ! Length of an arc over its chord.
    chord = chord*(1.0_wp + angle**2/24.0_wp)
    call bend(n, chord, length, before%x, before%slope_x, here%x, here%slope_x, c%second, c%third)
    call bend(1, chord, length, [before%p], [before%slope_p], [here%p], [here%slope_p], &
              c%second(n + 1:), c%third(n + 1:))
  end subroutine aim

  pure subroutine bend(n, chord, length, z_0, t_0, z_1, t_1, second, third)
    integer, intent(in) :: n
    real(wp), intent(in) :: chord, length, z_0(n), t_0(n), z_1(n), t_1(n)
    real(wp), intent(out) :: second(n), third(n)
    integer :: i
    do i = 1, n
      if (.not. (abs(z_0(i)) > 0.0_wp .or. abs(t_0(i)) > 0.0_wp)) then
        ! This unknown was not included before.
        second(i) = 0.0_wp
        third(i) = 0.0_wp
        cycle
      end if
      second(i) = (2.0_wp*t_1(i) + t_0(i)/length - 3.0_wp*(z_1(i) - z_0(i))/chord)/chord
      third(i) = (t_1(i) + t_0(i)/length - 2.0_wp*(z_1(i) - z_0(i))/chord)/chord**2
    end do
  end subroutine bend

  !> Predict along the tangent only.
  pure subroutine aim_straight(c)
    type(corrector_type), intent(inout) :: c
    c%second = 0.0_wp
    c%third = 0.0_wp
  end subroutine aim_straight

  !> Compute the point on the curve at a step from `here`, with its tangent.
  subroutine correct(curve, c, here, step, next, made, exact)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    !> From `new_point`, or reused.
    type(curve_point), intent(inout) :: next
    logical, intent(out) :: made
    !> Recompute the derivatives in each iteration, for a point and tangent to rounding error.
    logical, intent(in) :: exact
    real(wp) :: weight_x, weight_p, change, before, rate, allowed
    integer :: k
    logical :: fresh, was_fresh, inside, singular, settled

    made = .false.
    call metric(c, here, weight_x, weight_p)
    call predict(c, here, step, next)
    fresh = .true.
    was_fresh = .false.
    before = 0.0_wp
    rate = 0.0_wp
    do k = 1, max_iterations
      if (.not. exact .and. given_up()) return
      if (fresh) then
        call curve%equations(next%x, next%p, c%r, c%factors%matrix, c%slope_p, inside)
      else
        call curve%residual(next%x, next%p, c%r, inside)
      end if
      c%outside = .not. inside
      if (.not. inside) return
      if (fresh) then
        call decompose(c, here, next, weight_x, weight_p, singular)
        if (singular) return
      end if
      call move(c, here, weight_x, weight_p, next, change)
      if (.not. change <= 1.0e3_wp) return
      if (was_fresh) rate = change/before
      ! Only rounding error is left to correct.
      settled = fresh .and. k > 4 .and. change > shrinking*before &
                .and. max(change, before) <= small_enough
      was_fresh = fresh
      c%left = 1.0_wp
      if (change <= rounding .or. settled) exit
      allowed = allowed_at(c, next)
      ! Determinant and tangent are those of the point before the last correction.
      if (fresh .and. change <= allowed .and. (.not. exact .or. change <= nearly_rounding &
                                                   .or. (k > 1 .and. change &
                                                         > fast_enough*before))) exit
      if (.not. exact .and. k >= longest) return
      if (.not. exact .and. k > 1) then
        ! Corrections shrink as a geometric series: estimate its remainder.
        if (c%nearly_singular) then
          ! Kept factors may miss the direction that hardly changes the equations.
          fresh = .true.
        else if (change < fast_enough*before) then
          if (change**2 <= max(far_below*allowed, rounding)*(before - change)) then
            ! The factors of the first step reduced an error a to b a^2; each later step multiplies
            ! it by 2 b a.
            c%left = 2.0_wp*change/(before - change)
            exit
          end if
          fresh = .false.
        else
          ! Kept factors did not converge fast, so a small correction by them would not show the
          ! remaining error.
          fresh = .true.
        end if
      else
        fresh = exact
      end if
      before = change
    end do
    if (k > max_iterations) return
    made = .true.
    next%iterations = k
    c%last = c%right
    call find_tangent(c, exact, next)
    next%off = c%left*change
    next%error = c%left*off_at_value(c, next, c%last)
    c%largest = max(c%largest, sum(c%weights*next%x**2))
    call normalize(c, next)
    if (exact .or. k == 1) return
    ! Kept factors make the second correction this part of the first, and the tangent as inaccurate:
    ! enough for the next prediction, but not to decide whether this is a fold.
    call metric(c, next, weight_x, weight_p)
    if (sqrt(weight_p)*abs(next%slope_p) > doubtful*rate) return
    call metric(c, here, weight_x, weight_p)
    call curve%equations(next%x, next%p, c%r, c%factors%matrix, c%slope_p, inside)
    call decompose(c, here, next, weight_x, weight_p, singular)
    made = inside .and. .not. singular
    if (.not. made) return
    call find_tangent(c, exact, next)
    call normalize(c, next)
  end subroutine correct

  !> Largest accepted correction, in the units of `metric`. It applies the tolerance to the solution
  !! itself, even if that is smaller than other unknowns.
  pure real(wp) function allowed_at(c, point) result(allowed)
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: point
    real(wp) :: weight_x, weight_p, own
    call metric(c, point, weight_x, weight_p)
    own = min(1.0_wp, sqrt(weight_x*sum(c%weights*point%x**2)))
    allowed = c%tolerance*own + c%least*sqrt(weight_x)
  end function allowed_at

  !> Predict a point at a step on the cubic.
  pure subroutine predict(c, here, step, next)
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    type(curve_point), intent(inout) :: next
    integer :: n, i
    n = c%n
    do i = 1, n
      c%predicted(i) = here%x(i) + step*(here%slope_x(i) + step*(c%second(i) + step*c%third(i)))
    end do
    c%predicted(n + 1) = here%p + step*(here%slope_p + step*(c%second(n + 1) &
                                                             + step*c%third(n + 1)))
    next%x(:) = c%predicted(:n)
    next%p = c%predicted(n + 1)
  end subroutine predict

  !> One correction with the present residuals and factors, and its norm.
  subroutine move(c, here, weight_x, weight_p, next, change)
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: weight_x, weight_p
    type(curve_point), intent(inout) :: next
    real(wp), intent(out) :: change
    integer :: n, i
    n = c%n
    c%right(:n) = c%r
    c%right(n + 1) = weight_p*here%slope_p*(next%p - c%predicted(n + 1))
    do i = 1, n
      c%right(n + 1) = c%right(n + 1) + weight_x*c%weights(i)*here%slope_x(i) &
                       *(next%x(i) - c%predicted(i))
    end do
    call c%factors%solve(c%right)
    next%p = next%p - c%right(n + 1)
    change = weight_p*c%right(n + 1)**2
    do i = 1, n
      next%x(i) = next%x(i) - c%right(i)
      change = change + weight_x*c%weights(i)*c%right(i)**2
    end do
    change = sqrt(change)
  end subroutine move

  !> [J, R_p; previous tangent] t = (0, 1), with the present factors; also their determinant.
  subroutine find_tangent(c, exact, point)
    type(corrector_type), intent(inout) :: c
    logical, intent(in) :: exact
    type(curve_point), intent(inout) :: point
    call determinant(c, exact, point)
    c%right = 0.0_wp
    c%right(c%n + 1) = 1.0_wp
    call c%factors%solve(c%right)
    point%slope_x(:) = c%right(:c%n)
    point%slope_p = c%right(c%n + 1)
  end subroutine find_tangent

  !> Displacement (x, p) of a point on the plane of the last correction due to residuals in the
  !! equations.
  subroutine displace(c, off)
    type(corrector_type), intent(in) :: c
    !> The n residuals, then the displacement, shape (n + 1).
    real(wp), intent(inout) :: off(:)
    off(c%n + 1) = 0.0_wp
    call c%factors%solve(off)
  end subroutine displace

  !> Border the derivatives by slope and tangent, and factorize them.
  subroutine decompose(c, here, next, weight_x, weight_p, singular)
    type(corrector_type), intent(inout) :: c
    !> The previous point, and that of the derivatives.
    type(curve_point), intent(in) :: here, next
    real(wp), intent(in) :: weight_x, weight_p
    logical, intent(out) :: singular
    integer :: n, i
    n = c%n
    associate (matrix => c%factors%matrix)
      c%right(:n) = abs(next%x)
      call largest_in_rows(c%factors%rows, n, matrix, c%right, c%terms)
      c%terms(:n) = max(c%terms(:n), abs(c%slope_p*next%p))
      matrix(:n, n + 1) = c%slope_p
      do i = 1, n
        matrix(n + 1, i) = weight_x*c%weights(i)*here%slope_x(i)
      end do
      matrix(n + 1, n + 1) = weight_p*here%slope_p
      if (c%looks_at_groups) then
        ! In units of the typical size of each unknown and equation.
        do i = 1, n
          c%sizes(i) = 1.0_wp/sqrt(weight_x*c%weights(i))
        end do
        c%sizes(n + 1) = 1.0_wp/sqrt(weight_p)
        call largest_in_rows(c%factors%rows, n + 1, matrix, c%sizes, c%largest_of)
      end if
    end associate
    call c%factors%decompose(c%sizes, singular)
    c%nearly_singular = .false.
    if (c%looks_at_groups .and. .not. singular) c%nearly_singular = has_small_pivots(c)
  end subroutine decompose

  !> True if the pivots, in the units of `sizes` and `largest_of`, spread too widely.
  logical function has_small_pivots(c) result(small_ones)
    type(corrector_type), intent(inout) :: c
    real(wp) :: largest, smallest
    call c%factors%pivots_of(c%sizes, c%largest_of(:c%n + 1), largest, smallest)
    small_ones = .not. smallest > wide*largest
  end function has_small_pivots

  !> Sign and, if requested, logarithm of the determinant, from its factors.
  subroutine determinant(c, wanted, point)
    type(corrector_type), intent(in) :: c
    logical, intent(in) :: wanted
    type(curve_point), intent(inout) :: point
    call c%factors%determinant(wanted, point%sign, point%log_determinant)
  end subroutine determinant

  !> Compare the point at a step from `here` with its prediction. `surprise` is the largest relative
  !! deviation of a group of unknowns, such as a harmonic of a coordinate; `drift` that of p
  !! relative to its changes at both ends. Both are small along one curve; `surprise` is of order 1
  !! on another part of it. A prediction straight through zero can jump across a resonance whose
  !! width is the light damping: then the solution reverses its sign, or p decreases although it
  !! increases at both ends. `bend` is the deviation of a vanishing group from the mean of its
  !! tangents, relative to the group: about 1/2 or more if a step reaches the symmetric branch,
  !! where the group and its tangent are 0.
  pure subroutine compare(curve, c, here, step, next, surprise, drift, bend)
    class(curve_type), intent(in) :: curve
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: here, next
    real(wp), intent(in) :: step
    real(wp), intent(out) :: surprise, drift, bend
    real(wp) :: off, largest, unit, size_here, size_next, total, total_here, alike, jump
    integer :: first, last, g, i

    surprise = 0.0_wp
    bend = 0.0_wp
    drift = 0.0_wp
    if (.not. allocated(curve%last_of_group)) return
    total = 0.0_wp
    total_here = 0.0_wp
    alike = 0.0_wp
    do i = 1, c%n
      total = total + c%weights(i)*next%x(i)**2
      total_here = total_here + c%weights(i)*here%x(i)**2
      alike = alike + c%weights(i)*here%x(i)*next%x(i)
    end do
    if (alike < least_alike*sqrt(total*total_here)) surprise = 1.0_wp
    first = 1
    do g = 1, size(curve%last_of_group)
      last = curve%last_of_group(g)
      off = 0.0_wp
      jump = 0.0_wp
      size_here = 0.0_wp
      size_next = 0.0_wp
      do i = first, last
        jump = jump + (next%x(i) - here%x(i) &
                       - 0.5_wp*step*(here%slope_x(i) + next%slope_x(i)))**2
        off = off + (next%x(i) - c%predicted(i))**2
        size_here = size_here + here%x(i)**2
        size_next = size_next + next%x(i)**2
      end do
      first = last + 1
      ! A group that was 0, as before symmetry breaking or before it was included, is new anyway.
      if (.not. size_here > 0.0_wp) cycle
      unit = total/c%weights(last)
      largest = max(size_here, size_next)
      if (size_next < vanished**2*size_here .and. total > 0.5_wp*total_here) then
        bend = max(bend, jump/max(largest, curve%negligible**2*unit))
      end if
      off = off/max(largest, curve%negligible**2*unit)
      if (largest < minor**2*unit) off = lenience**2*off
      surprise = max(surprise, off)
    end do
    surprise = sqrt(surprise)
    bend = sqrt(bend)
    drift = abs(next%p - c%predicted(c%n + 1)) &
            /max(step*max(abs(here%slope_p), abs(next%slope_p)), &
                 10.0_wp*c%tolerance*max(abs(next%p), 0.1_wp*c%p_scale))
  end subroutine compare

  !> The direction of the bifurcating branch: null vector of the bordered matrix, by inverse
  !! iteration; 0 if that fails.
  subroutine null_vector(curve, c, here, point, across)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here, point
    real(wp), allocatable, intent(out) :: across(:)
    real(wp) :: weight_x, weight_p
    integer :: n, k
    logical :: singular, inside

    n = curve%n
    across = [(1.0_wp + 0.3_wp*sin(1.7_wp*k), k=1, n + 1)]
    call metric(c, here, weight_x, weight_p)
    ! If the matrix is exactly singular, use one of a nearby point.
    do k = 0, 2
      call curve%equations(point%x*(1.0_wp + k*nearby), point%p + k*nearby*c%p_scale, c%r, &
                           c%factors%matrix, c%slope_p, inside)
      singular = .not. inside
      if (inside) call decompose(c, here, point, weight_x, weight_p, singular)
      if (.not. singular) exit
    end do
    if (singular) then
      across = 0.0_wp
      return
    end if
    do k = 1, 4
      call c%factors%solve(across)
      across = across/sqrt(sum(across**2))
    end do
  end subroutine null_vector

end module viscovib_curve_corrector
