!> Places between two points of a branch that are found exactly: where the parameter
!! turns back, where another branch leaves, where the parameter has a wanted value.
module viscovib_curve_events
  use viscovib_curve, only: curve_type
  use viscovib_curve_corrector, only: copy_point, correct, corrector_type, curve_point, new_point, &
    null_vector
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: special_points, empty, locate_fold, locate_branch_point, locate_value

  !> Where nothing was found.
  real(wp), parameter, public :: nowhere = huge(1.0_wp)

  integer, parameter :: max_turns = 60
  !> Values in passing are a little off, so that a sign may change this part of a step
  !! before or behind it.
  real(wp), parameter :: margin = 0.1_wp

  !> Points of one kind, in the order met.
  type :: special_points
    integer :: n = 0
    !> p, shape (n), and x, shape (n_unknowns, n).
    real(wp), allocatable :: p(:), x(:, :)
    !> Null vectors (x, p) at branch points, shape (n_unknowns + 1, n).
    real(wp), allocatable :: across(:, :)
    !> The point of the branch before it.
    integer, allocatable :: before(:)
  end type special_points

contains

  subroutine empty(points, n)
    type(special_points), intent(out) :: points
    integer, intent(in) :: n
    allocate (points%p(0), points%x(n, 0), points%across(n + 1, 0), points%before(0))
  end subroutine empty

  !> Where dp/ds vanishes.
  subroutine locate_fold(curve, c, here, step, folds, at)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    !> Added to.
    type(special_points), intent(inout) :: folds
    !> The step to it, or `nowhere`.
    real(wp), intent(out) :: at
    type(curve_point) :: found
    real(wp) :: nothing(curve%n + 1)

    call locate(curve, c, here, step, .true., found, at)
    nothing = 0.0_wp
    if (at < nowhere) call keep(folds, found, nothing)
  end subroutine locate_fold

  !> Where the determinant vanishes, and the null vector there.
  subroutine locate_branch_point(curve, c, here, step, branch_points, at)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    type(special_points), intent(inout) :: branch_points
    real(wp), intent(out) :: at
    type(curve_point) :: found
    real(wp), allocatable :: across(:)

    call locate(curve, c, here, step, .false., found, at)
    if (at >= nowhere) return
    call null_vector(curve, c, here, found, across)
    call keep(branch_points, found, across)
  end subroutine locate_branch_point

  subroutine keep(points, found, across)
    type(special_points), intent(inout) :: points
    type(curve_point), intent(in) :: found
    real(wp), intent(in) :: across(:)
    points%n = points%n + 1
    points%p = [points%p, found%p]
    points%x = reshape([points%x, found%x], [size(found%x), points%n])
    points%across = reshape([points%across, across], [size(across), points%n])
    points%before = [points%before, 0]
  end subroutine keep

  subroutine locate(curve, c, here, step, fold, found, at)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    logical, intent(in) :: fold
    type(curve_point), intent(out) :: found
    real(wp), intent(out) :: at
    type(curve_point) :: trial
    real(wp) :: low, high, low_value, high_value, value, reference
    logical :: made
    integer :: k

    at = nowhere
    call new_point(trial, curve%n)
    call new_point(found, curve%n)
    reference = 0.0_wp
    do k = 0, 1
      low = -k*margin*step
      high = step - low
      call correct(curve, c, here, low, trial, made, .true.)
      if (.not. made) return
      reference = trial%log_determinant
      low_value = measure(trial)
      call correct(curve, c, here, high, trial, made, .true.)
      if (.not. made) return
      high_value = measure(trial)
      if (low_value*high_value < 0.0_wp) exit
    end do
    if (.not. low_value*high_value < 0.0_wp) return
    do k = 1, max_turns
      ! False position, kept off the ends; every third time the middle.
      at = low + (high - low)*min(0.9_wp, max(0.1_wp, low_value/(low_value - high_value)))
      if (mod(k, 3) == 0) at = 0.5_wp*(low + high)
      call correct(curve, c, here, at, trial, made, .true.)
      if (.not. made) exit
      call copy_point(trial, found)
      value = measure(trial)
      if (value*low_value > 0.0_wp) then
        low = at
        low_value = value
      else
        high = at
        high_value = value
      end if
      if (fold) then
        ! p is stationary here: an error of 1e-7 in place is one of 1e-14 in p.
        if (abs(trial%slope_p) <= 1.0e-7_wp*abs(here%p) .or. high - low <= 1.0e-9_wp) exit
      else if (high - low <= 1.0e-11_wp) then
        exit
      end if
    end do
    if (.not. made .and. k == 1) at = nowhere

  contains

    !> What changes its sign.
    pure real(wp) function measure(point)
      type(curve_point), intent(in) :: point
      if (fold) then
        measure = point%slope_p
      else
        measure = point%sign*exp(max(-300.0_wp, min(300.0_wp, point%log_determinant - reference)))
      end if
    end function measure

  end subroutine locate

  !> The point where p has a value it passes between two steps from `here`.
  subroutine locate_value(curve, c, here, from, to, value, found, at, made)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: from, to, value
    type(curve_point), intent(inout) :: found
    !> The step to it.
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
    found%p = merge(value, found%p, abs(found%p - value) <= 1.0e-12_wp*c%p_scale)
  end subroutine locate_value

end module viscovib_curve_events
