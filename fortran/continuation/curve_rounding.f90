!> How far off points of a curve are: by equations left out, and by rounding.
module viscovib_curve_rounding
  use viscovib_curve, only: curve_type
  use viscovib_curve_corrector, only: correct, corrector_type, displace
  use viscovib_curve_point, only: curve_point, metric, new_point, off_at_value
  use viscovib_kinds, only: wp
  use viscovib_sized_curve, only: sized_curve_type
  implicit none
  private

  public :: truncation_shift, rounding_of, least_error, all_patterns, fold_error, fold_place

  !> The largest of so many ulps of unknowns determines how far rounding moves a solution.
  real(wp), parameter :: ulps = 4.0_wp
  !> Ways to change unknowns by ulps: what one of them moves little another does not.
  integer, parameter :: all_patterns = 6
  !> Rounding of an equation, a sum of products, in units of its largest term; and how many signs
  !! of these are tried, so that one at least does not cancel.
  real(wp), parameter :: usual_rounding = 4.0_wp*epsilon(1.0_wp)
  integer, parameter :: all_signs = 3
  !> An error this far below the tolerance matters to no one, however it is estimated.
  real(wp), parameter :: far_below = 1.0e-2_wp

  !> A fold: the point, the step to it, and the derivative of dp/ds by the step.
  type :: fold_place
    type(curve_point) :: point
    real(wp) :: at = 0.0_wp, bend = 0.0_wp
  end type fold_place

contains

  !> How far a point moves on the plane of the last correction, relative to its size, if
  !! the equations are pushed by these residuals.
  subroutine truncation_shift(c, point, pushed, moved, at_value)
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: point
    real(wp), intent(in) :: pushed(:)
    real(wp), intent(out) :: moved
    !> How far x moves at its value of p.
    real(wp), intent(out), optional :: at_value
    real(wp) :: weight_x, weight_p, off(size(pushed) + 1)
    call displace(c, pushed, off)
    call metric(c, point, weight_x, weight_p)
    moved = sqrt(weight_x*sum(c%weights*off(:size(pushed))**2) + weight_p*off(size(off))**2)
    if (present(at_value)) at_value = off_at_value(c, point, off)
  end subroutine truncation_shift

  !> Errors of a fold by unknowns left out, if their number is chosen, and by rounding: of p, and of
  !! x relative to its size. Residuals r move a point by -M^-1 r, M being the bordered derivatives.
  !! For w, the left null vector of the derivatives J by x, takes x out of J x + R_p p = r, that
  !! moves p of the fold by w.r/(w.R_p). Its change along the curve moves the zero of dp/ds.
  subroutine fold_error(curve, c, here, fold, apart, error, error_x)
    class(curve_type), intent(inout) :: curve
    !> With the derivatives at the fold.
    type(corrector_type), intent(inout) :: c
    !> Where the step to the fold begins.
    type(curve_point), intent(in) :: here
    type(fold_place), intent(in) :: fold
    !> How far from the fold the change along the curve is found.
    real(wp), intent(in) :: apart
    !> In the unit of p, and relative.
    real(wp), intent(out) :: error, error_x
    type(curve_point) :: trial
    real(wp), dimension(curve%n + 1) :: off, off_apart
    real(wp) :: at_value, from_curve, rounded, short, short_apart, own, total
    logical :: made

    call least_error(curve, c, fold%point, at_value, from_curve, rounded)
    error = rounded
    total = sum(c%weights*fold%point%x**2)
    error_x = from_curve + rounded/abs(fold%bend) &
              *sqrt(sum(c%weights*fold%point%slope_x**2)/max(total, tiny(total)))
    select type (curve)
    class is (sized_curve_type)
      if (curve%adaptive) then
        call push(fold%point, off, short, own)
        error = max(error, short*abs(off(curve%n + 1)))
        call new_point(trial, curve%n)
        call correct(curve, c, here, fold%at + apart, trial, made, .true.)
        if (.not. made) return
        call push(trial, off_apart, short_apart, total)
        off(:curve%n) = off(:curve%n) - (off_apart(curve%n + 1) - off(curve%n + 1)) &
                        /(apart*fold%bend)*fold%point%slope_x
        total = sum(c%weights*fold%point%x**2)
        error_x = error_x + own + short*sqrt(sum(c%weights*off(:curve%n)**2) &
                                             /max(total, tiny(total)))
      end if
    end select
    error_x = min(1.0_wp, error_x)

  contains

    !> How the unknowns left out move a point just corrected.
    subroutine push(point, moved, by, size_of)
      type(curve_point), intent(in) :: point
      real(wp), intent(out) :: moved(:), by, size_of
      real(wp) :: pushed(curve%n)
      select type (curve)
      class is (sized_curve_type)
        call curve%left_out(point%x, point%p, pushed, by, size_of, .true.)
      end select
      call displace(c, pushed, moved)
    end subroutine push

  end subroutine fold_error

  !> How far off the rounding of the equations alone leaves a point, relative to its size: x at its
  !! value of p, and both from the curve. It is |J^-1| times the unit roundoff times the largest
  !! term of each equation (Higham, Accuracy and Stability of Numerical Algorithms (2002) ch. 7), by
  !! a few choices of signs; by one where that is far below the tolerance.
  subroutine least_error(curve, c, point, error, off, in_p)
    class(curve_type), intent(in) :: curve
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: point
    real(wp), intent(out) :: error, off
    !> p from the curve, in its unit.
    real(wp), intent(out), optional :: in_p
    real(wp) :: terms(curve%n), pushed(curve%n), moved(curve%n + 1), weight_x, weight_p
    integer :: i, k

    terms = c%terms
    call curve%raise_terms(point%x, point%p, terms)
    call metric(c, point, weight_x, weight_p)
    error = 0.0_wp
    off = 0.0_wp
    if (present(in_p)) in_p = 0.0_wp
    do k = 1, all_signs
      do i = 1, curve%n
        pushed(i) = sign(usual_rounding*terms(i), cos(real(k*(i + k)**2, wp)))
      end do
      call displace(c, pushed, moved)
      error = max(error, off_at_value(c, point, moved))
      off = max(off, sqrt(weight_x*sum(c%weights*moved(:curve%n)**2) &
                          + weight_p*moved(curve%n + 1)**2))
      if (c%alone > 0) off = max(off, abs(moved(c%alone)/point%x(c%alone)))
      if (present(in_p)) then
        in_p = max(in_p, abs(moved(curve%n + 1)))
      else if (max(error, off) < far_below*c%tolerance) then
        exit
      end if
    end do
  end subroutine least_error

  !> How far rounding moves a solution relative to its size: from residuals an ulp apart.
  !! Where the derivatives factorized last are not nearly singular it is 0, unless patterns are
  !! given.
  subroutine rounding_of(curve, c, point, moved, patterns)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: point
    real(wp), intent(out) :: moved
    !> How many ways to look at, `all_patterns` at most.
    integer, intent(in), optional :: patterns
    real(wp), dimension(curve%n) :: r, beside
    real(wp) :: one
    logical :: inside
    integer :: i, k, n_ways

    moved = 0.0_wp
    n_ways = merge(1, 0, c%nearly_singular)
    if (present(patterns)) n_ways = patterns
    do k = 0, n_ways - 1
      call curve%residual(point%x, point%p, r, inside)
      if (.not. inside) return
      call curve%residual([(point%x(i)*(1.0_wp + ulps*(mod((1 + k/3)*i + k, 3) - 1) &
                                        *epsilon(1.0_wp)), i=1, curve%n)], point%p, beside, inside)
      if (.not. inside) return
      call truncation_shift(c, point, beside - r, one)
      moved = max(moved, one)
    end do
  end subroutine rounding_of

end module viscovib_curve_rounding
