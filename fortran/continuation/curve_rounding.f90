!> How far off points of a curve are: by equations left out, and by rounding.
module viscovib_curve_rounding
  use viscovib_curve, only: curve_type
  use viscovib_curve_corrector, only: corrector_type, displace
  use viscovib_curve_point, only: curve_point, metric, off_at_value
  use viscovib_kinds, only: wp
  use viscovib_sized_curve, only: sized_curve_type
  implicit none
  private

  public :: truncation_shift, rounding_of, least_error, all_patterns, place_error

  !> The largest of so many ulps of unknowns tells how far rounding moves a solution.
  real(wp), parameter :: ulps = 4.0_wp
  !> Ways to change unknowns by ulps: what one of them moves little another does not.
  integer, parameter :: all_patterns = 6
  !> Rounding of an equation, a sum of products, in units of its largest term; and how many signs
  !! of these are tried, so that one at least does not cancel.
  real(wp), parameter :: usual_rounding = 4.0_wp*epsilon(1.0_wp)
  integer, parameter :: all_signs = 3

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

  !> How far unknowns left out, if their number is chosen, and rounding move the place of a fold: p
  !! as it is moved on any plane that the curve crosses. For w, the left null vector of the
  !! derivatives J by x, takes x out of J x + R_p p = r: p = w.r/(w.R_p).
  subroutine place_error(curve, c, fold, moved)
    class(curve_type), intent(inout) :: curve
    !> With the derivatives at the fold.
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: fold
    !> In the unit of p.
    real(wp), intent(out) :: moved
    real(wp) :: pushed(curve%n), off(curve%n + 1), short, own, error, from_curve, rounded

    moved = 0.0_wp
    select type (curve)
    class is (sized_curve_type)
      if (curve%adaptive) then
        call curve%left_out(fold%x, fold%p, pushed, short, own, .true.)
        call displace(c, pushed, off)
        moved = short*abs(off(curve%n + 1))
      end if
    end select
    call least_error(curve, c, fold, error, from_curve, rounded)
    moved = max(moved, rounded)
  end subroutine place_error

  !> How far off the rounding of the equations alone leaves a point, relative to its size: x at its
  !! value of p, and both from the curve. It is |J^-1| times the unit roundoff times the largest
  !! term of each equation (Higham, Accuracy and Stability of Numerical Algorithms (2002) ch. 7), by
  !! a few choices of signs.
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
      if (present(in_p)) in_p = max(in_p, abs(moved(curve%n + 1)))
    end do
  end subroutine least_error

  !> How far rounding moves a solution relative to its size: what residuals an ulp apart tell.
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
