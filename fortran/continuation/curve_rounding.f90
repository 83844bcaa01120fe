! Optimize: -O2 -fvect-cost-model=dynamic
!> Errors of points of a curve: by neglected equations, and by rounding.
module viscovib_curve_rounding
  use viscovib_curve, only: curve_type
  use viscovib_curve_corrector, only: correct, corrector_type, displace
  use viscovib_curve_point, only: curve_point, metric, new_point, off_at_value
  use viscovib_kinds, only: wp
  use viscovib_sized_curve, only: sized_curve_type
  implicit none
  private

  public :: truncation_shift, rounding_of, least_error, all_patterns, fold_error, fold_place

  !> Perturbation of the unknowns, in ulps, that measures the effect of rounding on a solution.
  real(wp), parameter :: ulps = 4.0_wp
  !> Number of perturbation patterns: one may have a large effect where another has none.
  integer, parameter :: all_patterns = 6
  !> Rounding error of an equation, a sum of products, relative to its largest term; and the number
  !! of sign patterns tried, so that the errors do not cancel in at least one.
  real(wp), parameter :: usual_rounding = 4.0_wp*epsilon(1.0_wp)
  integer, parameter :: all_signs = 3
  !> An error this far below the tolerance needs no closer estimate.
  real(wp), parameter :: far_below = 1.0e-2_wp

  !> A fold: the point, the step to it, and the derivative of dp/ds with respect to the step.
  type :: fold_place
    type(curve_point) :: point
    real(wp) :: at = 0.0_wp, bend = 0.0_wp
  end type fold_place

contains

  !> Displacement of a point on the plane of the last correction, relative to its size, due to
  !! residuals in the equations.
  subroutine truncation_shift(c, point, off, moved, at_value)
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: point
    !> The n residuals, then the displacement, shape (n + 1).
    real(wp), intent(inout) :: off(:)
    real(wp), intent(out) :: moved
    !> Relative displacement of x at its value of p.
    real(wp), intent(out), optional :: at_value
    real(wp) :: weight_x, weight_p
    call displace(c, off)
    call metric(c, point, weight_x, weight_p)
    moved = sqrt(weight_x*sum(c%weights*off(:size(off) - 1)**2) + weight_p*off(size(off))**2)
    if (present(at_value)) at_value = off_at_value(c, point, off)
  end subroutine truncation_shift

  !> Errors of a fold by neglected unknowns, if their number is adapted, and by rounding: of p, and
  !! of x relative to its size. Residuals r displace a point by -M^-1 r with the bordered
  !! derivatives M. The left null vector w of J = dR/dx eliminates x from J x + R_p p = r, so p of
  !! the fold moves by w.r/(w.R_p). The change of this along the curve moves the zero of dp/ds.
  subroutine fold_error(curve, c, here, fold, apart, error, error_x)
    class(curve_type), intent(inout) :: curve
    !> Contains the derivatives at the fold.
    type(corrector_type), intent(inout) :: c
    !> The point where the step to the fold begins.
    type(curve_point), intent(in) :: here
    type(fold_place), intent(in) :: fold
    !> Distance from the fold over which the change along the curve is computed.
    real(wp), intent(in) :: apart
    !> Error in the unit of p, and relative error of x.
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

    !> Displacement of a point just corrected due to the neglected unknowns.
    subroutine push(point, moved, by, size_of)
      type(curve_point), intent(in) :: point
      real(wp), intent(out) :: moved(:), by, size_of
      select type (curve)
      class is (sized_curve_type)
        call curve%left_out(point%x, point%p, moved(:curve%n), by, size_of, .true.)
      end select
      call displace(c, moved)
    end subroutine push

  end subroutine fold_error

  !> Relative error of a point due to the rounding of the equations: of x at its value of p, and of
  !! both from the curve. It is |J^-1| times the unit roundoff times the largest term of each
  !! equation (Higham, Accuracy and Stability of Numerical Algorithms (2002) ch. 7), with a few sign
  !! patterns, or one if the error is far below the tolerance.
  subroutine least_error(curve, c, point, error, off, in_p)
    class(curve_type), intent(in) :: curve
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: point
    real(wp), intent(out) :: error, off
    !> Error of p, in its unit.
    real(wp), intent(out), optional :: in_p
    real(wp) :: terms(curve%n), moved(curve%n + 1), weight_x, weight_p
    integer :: i, k

    terms = c%terms(:curve%n)
    call curve%raise_terms(point%x, point%p, terms)
    call metric(c, point, weight_x, weight_p)
    error = 0.0_wp
    off = 0.0_wp
    if (present(in_p)) in_p = 0.0_wp
    do k = 1, all_signs
      do i = 1, curve%n
        moved(i) = sign(usual_rounding*terms(i), cos(real(k*(i + k)**2, wp)))
      end do
      call displace(c, moved)
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

  !> Displacement of a solution by rounding, relative to its size, from residuals at unknowns that
  !! differ by a few ulps. It is 0 if the derivatives factorized last are not nearly singular,
  !! unless `patterns` is given.
  subroutine rounding_of(curve, c, point, moved, patterns)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: point
    real(wp), intent(out) :: moved
    !> Number of patterns, at most `all_patterns`.
    integer, intent(in), optional :: patterns
    real(wp), allocatable :: r(:), off(:)
    real(wp) :: one
    logical :: inside
    integer :: i, k, n_ways

    moved = 0.0_wp
    n_ways = merge(1, 0, c%nearly_singular)
    if (present(patterns)) n_ways = patterns
    if (n_ways == 0) return
    allocate (r(curve%n), off(curve%n + 1))
    do k = 0, n_ways - 1
      call curve%residual(point%x, point%p, r, inside)
      if (.not. inside) return
      call curve%residual([(point%x(i)*(1.0_wp + ulps*(mod((1 + k/3)*i + k, 3) - 1) &
                                        *epsilon(1.0_wp)), i=1, curve%n)], point%p, &
                          off(:curve%n), inside)
      if (.not. inside) return
      off(:curve%n) = off(:curve%n) - r
      call truncation_shift(c, point, off, one)
      moved = max(moved, one)
    end do
  end subroutine rounding_of

end module viscovib_curve_rounding
