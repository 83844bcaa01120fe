!> Steps along a curve: the corrector of pseudo-arclength continuation, with the unit
!! tangent and the determinant of the bordered derivatives at each point.
module viscovib_curve_corrector
  use viscovib_curve, only: curve_type
  use viscovib_dense, only: factorize_blocks, solve
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: curve_point, corrector_type, new_corrector, correct, null_vector
  public :: normalize, reverse, angle_between, distance

  integer, parameter :: max_iterations = 8

  !> A point of the curve with its unit tangent and what its bordered determinant is.
  type :: curve_point
    real(wp), allocatable :: x(:), slope_x(:)
    real(wp) :: p = 0.0_wp, slope_p = 1.0_wp, log_determinant = 0.0_wp
    integer :: iterations = 0, sign = 1
  end type curve_point

  !> What the corrector works in, and whether it last met the end of the range.
  type :: corrector_type
    real(wp) :: tolerance = 0.0_wp, p_scale = 1.0_wp, largest = 0.0_wp
    logical :: outside = .false.
    real(wp), allocatable :: matrix(:, :), right(:), r(:), slope_p(:), predicted(:)
    integer, allocatable :: pivots(:)
  end type corrector_type

contains

  subroutine new_corrector(corrector, n, tolerance, p_scale, x)
    type(corrector_type), intent(out) :: corrector
    integer, intent(in) :: n
    real(wp), intent(in) :: tolerance
    !> Size of the parameters met.
    real(wp), intent(in) :: p_scale
    real(wp), intent(in) :: x(:)
    allocate (corrector%matrix(n + 1, n + 1), corrector%right(n + 1), corrector%r(n), &
              corrector%slope_p(n), corrector%predicted(n), corrector%pivots(n + 1))
    corrector%tolerance = tolerance
    corrector%p_scale = p_scale
    corrector%largest = sum(x**2)
  end subroutine new_corrector

  !> The point a step along the tangent from `here`, on the curve, with its tangent.
  subroutine correct(curve, c, here, step, next, made)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    type(curve_point), intent(out) :: next
    logical, intent(out) :: made
    real(wp) :: predicted_p, weight_x, weight_p, change
    integer :: n, k
    logical :: singular, inside

    n = curve%n
    made = .false.
    call metric(c, here, weight_x, weight_p)
    c%predicted = here%x + step*here%slope_x
    predicted_p = here%p + step*here%slope_p
    next%x = c%predicted
    next%p = predicted_p
    do k = 1, max_iterations
      call curve%equations(next%x, next%p, c%r, c%matrix, c%slope_p, inside)
      c%outside = .not. inside
      if (.not. inside) return
      c%matrix(:n, n + 1) = c%slope_p
      c%matrix(n + 1, :n) = weight_x*here%slope_x
      c%matrix(n + 1, n + 1) = weight_p*here%slope_p
      c%right(:n) = c%r
      c%right(n + 1) = weight_x*dot_product(here%slope_x, next%x - c%predicted) &
                       + weight_p*here%slope_p*(next%p - predicted_p)
      call factorize_blocks(n + 1, c%matrix, c%pivots, singular)
      if (singular) return
      call solve(n + 1, c%matrix, c%pivots, c%right)
      next%x = next%x - c%right(:n)
      next%p = next%p - c%right(n + 1)
      next%iterations = k
      change = sqrt(weight_x*sum(c%right(:n)**2) + weight_p*c%right(n + 1)**2)
      if (.not. change <= 1.0e3_wp) return
      if (change <= max(c%tolerance, 4.0_wp*epsilon(1.0_wp))) exit
    end do
    if (k > max_iterations) return
    made = .true.
    call determinant(c, n + 1, next)
    ! The tangent: [J, R_p; tangent before] t = (0, 1), by the same factors.
    c%right = 0.0_wp
    c%right(n + 1) = 1.0_wp
    call solve(n + 1, c%matrix, c%pivots, c%right)
    next%slope_x = c%right(:n)
    next%slope_p = c%right(n + 1)
    c%largest = max(c%largest, sum(next%x**2))
    call normalize(c, next)
  end subroutine correct

  !> Sign and logarithm of the determinant, from its factors.
  pure subroutine determinant(c, n, point)
    type(corrector_type), intent(in) :: c
    integer, intent(in) :: n
    type(curve_point), intent(inout) :: point
    integer :: k
    point%sign = 1
    point%log_determinant = 0.0_wp
    do k = 1, n
      if (c%pivots(k) /= k) point%sign = -point%sign
      if (c%matrix(k, k) < 0.0_wp) point%sign = -point%sign
      point%log_determinant = point%log_determinant + log(abs(c%matrix(k, k)))
    end do
  end subroutine determinant

  pure subroutine normalize(c, point)
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(inout) :: point
    real(wp) :: weight_x, weight_p, length
    call metric(c, point, weight_x, weight_p)
    length = sqrt(weight_x*sum(point%slope_x**2) + weight_p*point%slope_p**2)
    point%slope_x = point%slope_x/length
    point%slope_p = point%slope_p/length
  end subroutine normalize

  pure subroutine reverse(point)
    type(curve_point), intent(inout) :: point
    point%slope_x = -point%slope_x
    point%slope_p = -point%slope_p
  end subroutine reverse

  !> Squares are weighed against the size of the solution, at least a tenth of the
  !! largest so far, and of p.
  pure subroutine metric(c, point, weight_x, weight_p)
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: point
    real(wp), intent(out) :: weight_x, weight_p
    real(wp) :: total
    total = max(sum(point%x**2), 0.01_wp*c%largest)
    weight_x = 1.0_wp
    if (total > 0.0_wp) weight_x = 1.0_wp/total
    weight_p = 1.0_wp/max(abs(point%p), 0.1_wp*c%p_scale)**2
  end subroutine metric

  pure real(wp) function angle_between(c, a, b) result(angle)
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: a, b
    real(wp) :: weight_x, weight_p, product, length
    call metric(c, b, weight_x, weight_p)
    product = weight_x*dot_product(a%slope_x, b%slope_x) + weight_p*a%slope_p*b%slope_p
    length = sqrt(weight_x*sum(a%slope_x**2) + weight_p*a%slope_p**2)
    angle = acos(max(-1.0_wp, min(1.0_wp, product/max(length, tiny(length)))))
  end function angle_between

  pure real(wp) function distance(c, a, b)
    type(corrector_type), intent(in) :: c
    type(curve_point), intent(in) :: a, b
    real(wp) :: weight_x, weight_p
    call metric(c, b, weight_x, weight_p)
    distance = sqrt(weight_x*sum((a%x - b%x)**2) + weight_p*(a%p - b%p)**2)
  end function distance

  !> The direction across the branch: null vector of the bordered matrix, by inverse
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
    call curve%equations(point%x, point%p, c%r, c%matrix, c%slope_p, inside)
    singular = .not. inside
    if (inside) then
      c%matrix(:n, n + 1) = c%slope_p
      c%matrix(n + 1, :n) = weight_x*here%slope_x
      c%matrix(n + 1, n + 1) = weight_p*here%slope_p
      call factorize_blocks(n + 1, c%matrix, c%pivots, singular)
    end if
    if (singular) then
      across = 0.0_wp
      return
    end if
    do k = 1, 4
      call solve(n + 1, c%matrix, c%pivots, across)
      across = across/sqrt(sum(across**2))
    end do
  end subroutine null_vector

end module viscovib_curve_corrector
