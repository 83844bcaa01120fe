! Optimize: -O2
!> Special points between two points of a branch: folds, branch points, and points with a requested
!! parameter.
module viscovib_curve_events
  use viscovib_constants, only: pi
  use viscovib_curve, only: curve_type
  use viscovib_curve_corrector, only: correct, corrector_type, null_vector
  use viscovib_curve_point, only: copy_point, curve_point, distance, metric, new_point
  use viscovib_curve_rounding, only: fold_error, fold_place
  use viscovib_kinds, only: wp
  use viscovib_sized_curve, only: refitted
  implicit none
  private

  public :: special_points, empty_points, locate_fold, locate_branch_point, locate_value, turn_at, &
            drop_last_near

  !> Marks that nothing was found.
  real(wp), parameter, public :: nowhere = huge(1.0_wp)

  integer, parameter :: max_turns = 60
  !> Within this relative distance in p, Newton's method at fixed p converges to the same point.
  real(wp), parameter :: near_enough = 1.0e-6_wp
  !> Relative error of a fold along the curve, and the smallest width of a bracket relative to its
  !! initial width; rounding errors of dp/ds limit it.
  real(wp), parameter :: fold_tolerance = 1.0e-15_wp, narrowest = 1.0e-10_wp
  !> Folds with a smaller relative distance in p are the same.
  real(wp), parameter :: same = 1.0e-10_wp
  !> Nodes that interpolate the determinant, and their smallest number.
  integer, parameter :: n_nodes = 9, enough = 4
  !> Extension of the nodes beyond a step, as a fraction of it.
  real(wp), parameter :: beyond = 0.2_wp
  !> Tangents from kept factors are slightly inaccurate. The sign may change this fraction of a step
  !! before or after it.
  real(wp), parameter :: margins(0:3) = [0.0_wp, 0.1_wp, 0.3_wp, 0.9_wp]
  !> Nodes closer to the zero than this fraction of their reach are dropped: the equations are
  !! nearly singular there and the solution may lie on the other branch.
  real(wp), parameter :: too_near = 0.1_wp
  !> Distance from a branch point at which the branch is examined, as a fraction of a step.
  real(wp), parameter :: next_to = 0.3_wp

  !> Points of one type, in the order met, with the largest number of unknowns.
  type :: special_points
    integer :: n = 0, blocks = 1
    !> p, shape (n); its error if known, else 0; and x, shape (n_unknowns, n).
    real(wp), allocatable :: p(:), error(:), x(:, :)
    !> Error of x at folds, relative to its size, shape (n).
    real(wp), allocatable :: error_x(:)
    !> Null vectors (x, p) at branch points, shape (n_unknowns + 1, n).
    real(wp), allocatable :: across(:, :)
    !> Index of the point of the branch before it.
    integer, allocatable :: before(:)
  end type special_points

  !> Points of the curve as nodes of polynomials in the step.
  type :: nodes_type
    integer :: n = 0
    real(wp), dimension(n_nodes) :: place = 0.0_wp, p = 0.0_wp, value = 0.0_wp, weight = 0.0_wp
    !> Shape (n_unknowns, n_nodes).
    real(wp), allocatable :: x(:, :)
    !> The last sample, and the logarithm of the determinant used as reference.
    type(curve_point) :: trial
    real(wp) :: reference = 0.0_wp
  contains
    procedure :: at_place
  end type nodes_type

contains

  !> No points yet.
  subroutine empty_points(points, n, blocks)
    type(special_points), intent(out) :: points
    !> Largest number of unknowns, and number of blocks.
    integer, intent(in) :: n, blocks
    points%blocks = blocks
    allocate (points%p(0), points%error(0), points%error_x(0), points%x(n, 0), &
              points%across(n + 1, 0), points%before(0))
  end subroutine empty_points

  !> Locate a zero of dp/ds.
  subroutine locate_fold(curve, c, here, step, folds, at)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    !> The fold is appended.
    type(special_points), intent(inout) :: folds
    !> Step to the fold, or `nowhere`.
    real(wp), intent(out) :: at
    type(fold_place) :: fold
    real(wp) :: nothing(curve%n + 1), error, error_x

    call bracket_fold(curve, c, here, step, fold, at)
    if (at >= nowhere) return
    associate (found => fold%point)
      if (folds%n > 0) then
        ! The second of two changes of sign near a fold finds the same fold again.
        if (abs(found%p - folds%p(folds%n)) <= same*abs(found%p) &
            .and. norm2(found%x - refitted(folds%blocks, folds%x(:, folds%n), curve%n)) &
            <= sqrt(same)*norm2(found%x)) at = nowhere
      end if
      if (at >= nowhere) return
      call fold_error(curve, c, here, fold, 0.1_wp*step, error, error_x)
      nothing = 0.0_wp
      call keep(folds, found, nothing, error, error_x)
    end associate
  end subroutine locate_fold

  !> The fold at a branch point where the branch turns back, such as a branch of broken symmetry
  !! that meets the symmetric branch. The equations are too nearly singular there for `locate_fold`.
  !! A fold located within a step of it is dropped; the errors are those at a nearby point.
  subroutine turn_at(curve, c, here, step, at, p, x, folds, turns, slope_before)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    !> The length of a step, and the step to the branch point.
    real(wp), intent(in) :: step, at
    !> The branch point, shape (n).
    real(wp), intent(in) :: p, x(:)
    !> The fold is appended if the branch turns back.
    type(special_points), intent(inout) :: folds
    logical, intent(out) :: turns
    !> dp/ds before the branch point, if known.
    real(wp), intent(in), optional :: slope_before
    type(fold_place) :: near
    real(wp) :: nothing(curve%n + 1), apart, slope, error, error_x
    logical :: dropped

    apart = next_to*step
    call new_point(near%point, curve%n)
    turns = .true.
    if (present(slope_before)) then
      slope = slope_before
    else
      call correct(curve, c, here, at - apart, near%point, turns, .true.)
      slope = near%point%slope_p
    end if
    near%at = at + apart
    if (turns) call correct(curve, c, here, near%at, near%point, turns, .true.)
    if (turns) turns = near%point%slope_p*slope < 0.0_wp
    if (.not. turns) return
    near%bend = near%point%slope_p/apart
    call fold_error(curve, c, here, near, apart, error, error_x)
    near%point%p = p
    near%point%x(:) = x
    call drop_last_near(curve, c, near%point, step, folds, dropped)
    nothing = 0.0_wp
    call keep(folds, near%point, nothing, error, error_x)
  end subroutine turn_at

  !> Drop the last special point if it lies within a distance of `point`.
  subroutine drop_last_near(curve, c, point, apart, places, dropped)
    class(curve_type), intent(in) :: curve
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: point
    real(wp), intent(in) :: apart
    type(special_points), intent(inout) :: places
    logical, intent(out) :: dropped
    type(curve_point) :: last

    dropped = places%n > 0
    if (.not. dropped) return
    call new_point(last, curve%n)
    last%p = places%p(places%n)
    last%x(:) = refitted(places%blocks, places%x(:, places%n), curve%n)
    dropped = distance(c, point, last) <= apart
    if (.not. dropped) return
    places%n = places%n - 1
    places%p = places%p(:places%n)
    places%error = places%error(:places%n)
    places%error_x = places%error_x(:places%n)
    places%x = places%x(:, :places%n)
    places%across = places%across(:, :places%n)
    places%before = places%before(:places%n)
  end subroutine drop_last_near

  !> Locate a zero of the determinant, and compute the null vector there.
  subroutine locate_branch_point(curve, c, here, step, branch_points, at)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    type(special_points), intent(inout) :: branch_points
    real(wp), intent(out) :: at
    type(curve_point) :: found
    real(wp), allocatable :: across(:)

    call bracket_branch_point(curve, c, here, step, found, at)
    if (at >= nowhere) return
    call null_vector(curve, c, here, found, across)
    call keep(branch_points, found, across, 0.0_wp, 0.0_wp)
  end subroutine locate_branch_point

  subroutine keep(points, found, across, error, error_x)
    type(special_points), intent(inout) :: points
    type(curve_point), intent(in) :: found
    real(wp), intent(in) :: across(:), error, error_x
    integer :: most, n
    most = size(points%x, 1)
    n = size(found%x)
    points%n = points%n + 1
    points%p = [points%p, found%p]
    points%error = [points%error, error]
    points%error_x = [points%error_x, error_x]
    points%x = reshape([points%x, refitted(points%blocks, found%x, most)], [most, points%n])
    points%across = reshape([points%across, refitted(points%blocks, across(:n), most), &
                             across(n + 1)], [most + 1, points%n])
    points%before = [points%before, 0]
  end subroutine keep

  !> The zero of dp/ds by the secant method within a bracket. The last secant step follows the
  !! tangent, so that the error of the solution is also of second order.
  subroutine bracket_fold(curve, c, here, step, fold, at)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    type(fold_place), intent(out) :: fold
    real(wp), intent(out) :: at
    type(curve_point) :: trial
    real(wp) :: low, high, low_value, high_value, width, before, value_before, value
    logical :: made
    integer :: k

    at = nowhere
    call new_point(trial, curve%n)
    call new_point(fold%point, curve%n)
    do k = 0, 3
      low = -margins(k)*step
      high = step - low
      call correct(curve, c, here, low, trial, made, .true.)
      if (.not. made) return
      low_value = trial%slope_p
      call correct(curve, c, here, high, trial, made, .true.)
      if (.not. made) return
      high_value = trial%slope_p
      if (low_value*high_value < 0.0_wp) exit
    end do
    if (.not. low_value*high_value < 0.0_wp) return
    width = high - low
    before = merge(high, low, abs(low_value) < abs(high_value))
    value_before = merge(high_value, low_value, abs(low_value) < abs(high_value))
    fold%at = low + high - before
    value = low_value + high_value - value_before
    do k = 1, max_turns
      at = fold%at - value*(fold%at - before)/(value - value_before)
      if (.not. ((at - low)*(high - at) > 0.0_wp .and. &
                 abs(at - fold%at) <= 0.5_wp*abs(fold%at - before))) at = 0.5_wp*(low + high)
      call correct(curve, c, here, at, trial, made, .true.)
      if (.not. made) exit
      call copy_point(trial, fold%point)
      before = fold%at
      value_before = value
      fold%at = at
      value = trial%slope_p
      if (value*low_value > 0.0_wp) then
        low = at
      else
        high = at
      end if
      fold%bend = (value - value_before)/(at - before)
      ! The error after the next secant step is the product of the last two errors over the width.
      if (abs(value*(at - before)) <= abs(fold%bend)*fold_tolerance*width &
          .or. high - low <= narrowest*width) exit
    end do
    at = nowhere
    if (.not. made .and. k == 1) return
    at = fold%at
    if (abs(value) <= abs(fold%bend)*(high - low)) call step_to_fold(c, here, fold)
  end subroutine bracket_fold

  !> The last secant step, along the tangent.
  subroutine step_to_fold(c, here, fold)
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: here
    type(fold_place), intent(inout) :: fold
    real(wp) :: weight_x, weight_p, along
    call metric(c, here, weight_x, weight_p)
    associate (point => fold%point)
      along = -point%slope_p/fold%bend/(weight_x*sum(c%weights*here%slope_x*point%slope_x) &
                                        + weight_p*here%slope_p*point%slope_p)
      point%x = point%x + along*point%slope_x
      point%p = point%p + 0.5_wp*along*point%slope_p
    end associate
  end subroutine step_to_fold

  !> Zero of the determinant by polynomial interpolation in the step: at the zero itself the
  !! equations are singular. Over the short steps of `follow_curve` there, the error is rounding
  !! error.
  subroutine bracket_branch_point(curve, c, here, step, found, at)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    type(curve_point), intent(out) :: found
    real(wp), intent(out) :: at
    type(nodes_type) :: nodes
    real(wp) :: low, high, low_value, high_value
    logical :: made
    integer :: k, j

    at = nowhere
    call new_point(nodes%trial, curve%n)
    call new_point(found, curve%n)
    allocate (nodes%x(curve%n, n_nodes))
    do k = 0, 3
      low = -margins(k)*step
      high = step - low
      call sample(nodes, curve, c, here, low, low_value, made)
      if (.not. made) return
      nodes%reference = nodes%trial%log_determinant
      low_value = nodes%trial%sign
      call sample(nodes, curve, c, here, high, high_value, made)
      if (.not. made) return
      if (low_value*high_value < 0.0_wp) exit
    end do
    if (.not. low_value*high_value < 0.0_wp) return
    call sample_around(nodes, curve, c, here, 0.5_wp*(low + high), (0.5_wp + beyond)*(high - low))
    call find_zero(nodes, 0.5_wp*(low + high), (0.5_wp + beyond)*(high - low), at)
    if (at >= nowhere) return
    found%p = nodes%at_place(at, nodes%p)
    do j = 1, curve%n
      found%x(j) = nodes%at_place(at, nodes%x(j, :))
    end do
  end subroutine bracket_branch_point

  !> Compute `trial` at a step from `here`, and its determinant relative to the reference.
  subroutine sample(nodes, curve, c, here, step, value, made)
    type(nodes_type), intent(inout) :: nodes
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    real(wp), intent(out) :: value
    logical, intent(out) :: made
    call correct(curve, c, here, step, nodes%trial, made, .true.)
    value = 0.0_wp
    if (made) value = nodes%trial%sign*exp(max(-300.0_wp, min(300.0_wp, &
                                               nodes%trial%log_determinant - nodes%reference)))
  end subroutine sample

  !> Sample nodes within `reach` of a centre.
  subroutine sample_around(nodes, curve, c, here, centre, reach)
    type(nodes_type), intent(inout) :: nodes
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: centre, reach
    real(wp) :: place, value
    logical :: made
    integer :: i, n

    n = 0
    do i = 1, n_nodes
      place = centre - reach*cos(pi*(i - 1)/(n_nodes - 1))
      call sample(nodes, curve, c, here, place, value, made)
      if (.not. made) cycle
      n = n + 1
      nodes%place(n) = place
      nodes%value(n) = value
      nodes%p(n) = nodes%trial%p
      nodes%x(:, n) = nodes%trial%x
    end do
    nodes%n = n
  end subroutine sample_around

  !> The zero of the polynomial through nodes around `centre`. Nodes near the change of sign are
  !! dropped, since they may lie on the other branch.
  subroutine find_zero(nodes, centre, reach, zero)
    type(nodes_type), intent(inout) :: nodes
    real(wp), intent(in) :: centre, reach
    real(wp), intent(out) :: zero
    real(wp) :: near, from, to, from_value
    integer :: i

    zero = nowhere
    associate (n => nodes%n, place => nodes%place, value => nodes%value)
      ! The change of sign nearest to the centre.
      i = minloc(abs(place(:n - 1) + place(2:n) - 2.0_wp*centre), 1, &
                 value(:n - 1)*value(2:n) < 0.0_wp)
      if (i == 0) return
      near = place(i) + (place(i + 1) - place(i))*value(i)/(value(i) - value(i + 1))
      call drop(nodes, abs(place(:n) - near) <= too_near*reach)
      if (n < enough) return
      do i = 1, n
        nodes%weight(i) = 1.0_wp/(product((place(i) - place(:i - 1))/reach) &
                                  *product((place(i) - place(i + 1:n))/reach))
      end do
    end associate
    from = near - 2.0_wp*too_near*reach
    to = near + 2.0_wp*too_near*reach
    from_value = nodes%at_place(from, nodes%value)
    if (.not. from_value*nodes%at_place(to, nodes%value) < 0.0_wp) return
    do i = 1, max_turns
      zero = 0.5_wp*(from + to)
      if (nodes%at_place(zero, nodes%value)*from_value > 0.0_wp) then
        from = zero
      else
        to = zero
      end if
    end do
  end subroutine find_zero

  !> Drop the marked nodes.
  pure subroutine drop(nodes, those)
    type(nodes_type), intent(inout) :: nodes
    logical, intent(in) :: those(:)
    integer :: i, kept
    kept = 0
    do i = 1, size(those)
      if (those(i)) cycle
      kept = kept + 1
      nodes%place(kept) = nodes%place(i)
      nodes%value(kept) = nodes%value(i)
      nodes%p(kept) = nodes%p(i)
      nodes%x(:, kept) = nodes%x(:, i)
    end do
    nodes%n = kept
  end subroutine drop

  !> The polynomial through values at the nodes, in barycentric form.
  pure real(wp) function at_place(self, s, values)
    class(nodes_type), intent(in) :: self
    real(wp), intent(in) :: s, values(:)
    real(wp) :: over(n_nodes)
    integer :: i
    associate (n => self%n)
      i = minloc(abs(self%place(:n) - s), 1)
      at_place = values(i)
      if (.not. abs(self%place(i) - s) > 0.0_wp) return
      over(:n) = self%weight(:n)/(s - self%place(:n))
      at_place = sum(over(:n)*values(:n))/sum(over(:n))
    end associate
  end function at_place

  !> Locate a value of p between two steps from `here`.
  subroutine locate_value(curve, c, here, from, to, value, found, at, made)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: from, to, value
    type(curve_point), intent(inout) :: found
    !> Step to the point.
    real(wp), intent(out) :: at
    logical, intent(out) :: made
    real(wp) :: low, high, low_p, high_p
    integer :: k

    low = from
    high = to
    call correct(curve, c, here, low, found, made, .true.)
    if (.not. made) return
    low_p = found%p
    at = to
    call correct(curve, c, here, at, found, made, .true.)
    high_p = found%p
    do k = 1, max_turns
      if (.not. made .or. abs(found%p - value) <= 1.0e-13_wp*c%p_scale) exit
      at = low + (high - low)*min(0.98_wp, max(0.02_wp, (value - low_p)/(high_p - low_p)))
      call correct(curve, c, here, at, found, made, .true.)
      if ((found%p - value)*(low_p - value) > 0.0_wp) then
        low = at
        low_p = found%p
      else
        high = at
        high_p = found%p
      end if
    end do
    if (.not. made) return
    if (abs(found%p - value) > 1.0e-12_wp*c%p_scale) then
      call at_value(curve, c, value, found, made)
      return
    end if
    ! Remaining distance along the tangent.
    if (abs(found%p - value) <= 1.0e-8_wp*abs(found%slope_p)) then
      found%x = found%x + found%slope_x*((value - found%p)/found%slope_p)
    end if
    found%p = value
  end subroutine locate_value

  !> Correct at a nearby fixed p: where the equations are nearly singular, rounding moves points
  !! along the curve by more than the distance between distinct points.
  subroutine at_value(curve, c, value, found, made)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    real(wp), intent(in) :: value
    type(curve_point), intent(inout) :: found
    logical, intent(out) :: made
    type(curve_point) :: upright
    real(wp) :: direction

    made = abs(found%p - value) <= near_enough*c%p_scale
    if (.not. made) return
    call new_point(upright, curve%n)
    call copy_point(found, upright)
    direction = found%slope_p
    upright%p = value
    upright%slope_x = 0.0_wp
    upright%slope_p = sign(1.0_wp, direction)
    call correct(curve, c, upright, 0.0_wp, found, made, .true.)
    found%p = value
  end subroutine at_value

end module viscovib_curve_events
