! Optimize: -O3
!> Points of a curve, and lengths and angles along it.
module viscovib_curve_point
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: curve_metric, curve_point
  public :: angle_between, copy_point, distance, goes_to_and_fro, haunt_type, is_ahead, &
            metric, new_point, normalize, off_at_value, reverse

  !> A point of the curve with its unit tangent and its bordered determinant.
  type :: curve_point
    real(wp), allocatable :: x(:), slope_x(:)
    real(wp) :: p = 0.0_wp, slope_p = 1.0_wp
    !> Logarithm of the magnitude of the determinant; set if the point was corrected exactly.
    real(wp) :: log_determinant = 0.0_wp
    integer :: iterations = 0, sign = 1
    !> Error of x at its value of p, and distance of (x, p) from the curve, both relative: error of
    !! the last correction, and rounding error.
    real(wp) :: error = 0.0_wp, off = 0.0_wp
    !> The same errors due to neglected unknowns, if their number is adapted.
    real(wp) :: truncation = 0.0_wp, missed = 0.0_wp
  end type curve_point

  !> The last point the curve moved away from, and the number of points since.
  type :: haunt_type
    type(curve_point) :: anchor
    integer :: n = 0
  end type haunt_type

  !> More points than this within a short distance mean that the steps oscillate: at grazing of a
  !! discontinuous law the curve may turn back on itself, and steps would pass this edge without
  !! end. Steps that shrink to the smallest before an edge and grow after it take about thirty.
  integer, parameter :: most_points = 50
  real(wp), parameter :: hardly_away = 1.0e-5_wp

  !> Metric of lengths: the weight of each unknown, the typical size of the parameter and the
  !! largest solution so far.
  type :: curve_metric
    real(wp), allocatable :: weights(:)
    real(wp) :: p_scale = 1.0_wp, largest = 0.0_wp
    !> An unknown that also counts, by its own relative error; 0: none.
    integer :: alone = 0
  end type curve_metric

contains

  subroutine new_point(point, n)
    type(curve_point), intent(out) :: point
    integer, intent(in) :: n
    allocate (point%x(n), point%slope_x(n), source=0.0_wp)
  end subroutine new_point

  !> Copy without allocating memory.
  pure subroutine copy_point(from, to)
    type(curve_point), intent(in) :: from
    type(curve_point), intent(inout) :: to
    to%x(:) = from%x
    to%slope_x(:) = from%slope_x
    to%p = from%p
    to%slope_p = from%slope_p
    to%log_determinant = from%log_determinant
    to%iterations = from%iterations
    to%sign = from%sign
    to%error = from%error
    to%off = from%off
    to%truncation = from%truncation
    to%missed = from%missed
  end subroutine copy_point

  pure subroutine normalize(c, point)
    class(curve_metric), intent(in) :: c
    type(curve_point), intent(inout) :: point
    real(wp) :: weight_x, weight_p, length
    call metric(c, point, weight_x, weight_p)
    length = sqrt(weight_x*sum(c%weights*point%slope_x**2) + weight_p*point%slope_p**2)
    point%slope_x = point%slope_x/length
    point%slope_p = point%slope_p/length
  end subroutine normalize

  pure subroutine reverse(point)
    type(curve_point), intent(inout) :: point
    point%slope_x = -point%slope_x
    point%slope_p = -point%slope_p
  end subroutine reverse

  !> Weights of squares: relative to the size of the solution, which is at least a tenth of the
  !! largest so far, and relative to p.
  pure subroutine metric(c, point, weight_x, weight_p)
    class(curve_metric), intent(in) :: c
    type(curve_point), intent(in) :: point
    real(wp), intent(out) :: weight_x, weight_p
    real(wp) :: total
    total = max(sum(c%weights*point%x**2), 0.01_wp*c%largest)
    weight_x = 1.0_wp
    if (total > 0.0_wp) weight_x = 1.0_wp/total
    weight_p = 1.0_wp/max(abs(point%p), 0.1_wp*c%p_scale)**2
  end subroutine metric

  pure real(wp) function angle_between(c, a, b) result(angle)
    class(curve_metric), intent(in) :: c
    type(curve_point), intent(in) :: a, b
    real(wp) :: weight_x, weight_p, product, length
    call metric(c, b, weight_x, weight_p)
    product = weight_x*sum(c%weights*a%slope_x*b%slope_x) + weight_p*a%slope_p*b%slope_p
    length = sqrt(weight_x*sum(c%weights*a%slope_x**2) + weight_p*a%slope_p**2)
    angle = acos(max(-1.0_wp, min(1.0_wp, product/max(length, tiny(length)))))
  end function angle_between

  pure real(wp) function distance(c, a, b)
    class(curve_metric), intent(in) :: c
    type(curve_point), intent(in) :: a, b
    real(wp) :: weight_x, weight_p
    call metric(c, b, weight_x, weight_p)
    distance = sqrt(weight_x*sum(c%weights*(a%x - b%x)**2) + weight_p*(a%p - b%p)**2)
  end function distance

  !> True if b is ahead of a, by the tangent there.
  pure logical function is_ahead(c, a, b)
    class(curve_metric), intent(in) :: c
    type(curve_point), intent(in) :: a, b
    real(wp) :: weight_x, weight_p
    call metric(c, b, weight_x, weight_p)
    is_ahead = weight_x*sum(c%weights*a%slope_x*(b%x - a%x)) &
               + weight_p*a%slope_p*(b%p - a%p) > 0.0_wp
  end function is_ahead

  !> True if the curve stays near one point; `point` is counted.
  logical function goes_to_and_fro(haunt, c, point) result(it_does)
    type(haunt_type), intent(inout) :: haunt
    class(curve_metric), intent(in) :: c
    type(curve_point), intent(in) :: point
    logical :: fits

    haunt%n = haunt%n + 1
    fits = allocated(haunt%anchor%x)
    if (fits) fits = size(haunt%anchor%x) == size(point%x)
    if (.not. fits) then
      haunt = haunt_type(point)
    else if (distance(c, haunt%anchor, point) > hardly_away) then
      call copy_point(point, haunt%anchor)
      haunt%n = 0
    end if
    it_does = haunt%n > most_points
  end function goes_to_and_fro

  !> Relative error of x at its value of p, for an error `off` of (x, p). A displacement along the
  !! curve is not an error of x alone; x - t_x p/t_p is, with the tangent t. At a fold, where this
  !! is undefined, it is 1.
  pure real(wp) function off_at_value(c, point, off) result(moved)
    class(curve_metric), intent(in) :: c
    type(curve_point), intent(in) :: point
    !> Shape (n + 1).
    real(wp), intent(in) :: off(:)
    real(wp) :: along, total
    integer :: i
    moved = 0.0_wp
    if (.not. maxval(abs(off)) > 0.0_wp) return
    moved = 1.0_wp
    if (.not. abs(off(size(off))) < abs(point%slope_p)*sqrt(huge(along))) return
    along = off(size(off))/point%slope_p
    moved = 0.0_wp
    total = 0.0_wp
    do i = 1, size(point%x)
      moved = moved + c%weights(i)*(off(i) - point%slope_x(i)*along)**2
      total = total + c%weights(i)*point%x(i)**2
    end do
    moved = merge(sqrt(moved/max(total, tiny(total))), 0.0_wp, moved > 0.0_wp)
    if (c%alone > 0) then
      moved = max(moved, abs((off(c%alone) - point%slope_x(c%alone)*along)/point%x(c%alone)))
    end if
    moved = min(1.0_wp, moved)
  end function off_at_value

end module viscovib_curve_point
