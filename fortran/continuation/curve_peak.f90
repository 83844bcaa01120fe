!> The point on a curve of solutions at which a harmonic is largest. The search follows the curve
!! from a solution until the amplitude no longer grows. It passes folds and never changes to another
!! curve.
module viscovib_curve_peak
  use viscovib_curve, only: curve_type
  use viscovib_curve_corrector, only: aim, correct, corrector_type, new_corrector
  use viscovib_curve_point, only: angle_between, copy_point, curve_point, new_point, reverse
  use viscovib_kinds, only: wp
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: harmonic_measure, climb, growth_along

  !> Step sizes relative to the present point: initial, smallest and largest.
  real(wp), parameter :: first_step = 0.02_wp, smallest_step = 1.0e-10_wp, largest_step = 0.1_wp
  !> Largest angle between successive tangents, and its target.
  real(wp), parameter :: largest_angle = 0.4_wp, wanted_angle = 0.12_wp
  integer, parameter :: max_steps = 2000, max_turns = 80

  !> Unknowns that are the components of a harmonic, and their offsets: a constant, and a term
  !! proportional to p, as for a moving base. The amplitude is the norm of the sum.
  type :: harmonic_measure
    integer :: place(2) = 0
    real(wp) :: offset(2) = 0.0_wp, offset_by_p(2) = 0.0_wp
  contains
    procedure :: size_at
    procedure, private :: growth, hides
  end type harmonic_measure

contains

  pure real(wp) function size_at(self, x, p)
    class(harmonic_measure), intent(in) :: self
    real(wp), intent(in) :: x(:), p
    size_at = norm2(x(self%place) + self%offset + self%offset_by_p*p)
  end function size_at

  !> Half the derivative of the squared amplitude along the tangent.
  pure real(wp) function growth(self, point)
    class(harmonic_measure), intent(in) :: self
    type(curve_point), intent(in) :: point
    growth = sum((point%x(self%place) + self%offset + self%offset_by_p*point%p) &
                 *(point%slope_x(self%place) + self%offset_by_p*point%slope_p))
  end function growth

  !> True if the harmonic between two points does not follow its slopes. It may be small compared
  !! with other coordinates, so that its resonance hardly turns the curve.
  pure logical function hides(self, here, next, step)
    class(harmonic_measure), intent(in) :: self
    type(curve_point), intent(in) :: here, next
    real(wp), intent(in) :: step
    real(wp) :: secant(2), mean(2)
    secant = next%x(self%place) - here%x(self%place)
    mean = 0.5_wp*step*(here%slope_x(self%place) + next%slope_x(self%place))
    hides = norm2(secant - mean) > 0.3_wp*norm2(secant)
  end function hides

  !> Whether the amplitude grows (1), is constant (0) or falls (-1) as p increases; also 0 if that
  !! cannot be determined.
  subroutine growth_along(curve, measure, tolerance, x, p, sign_of, slope)
    class(curve_type), intent(inout) :: curve
    type(harmonic_measure), intent(in) :: measure
    real(wp), intent(in) :: tolerance, x(:), p
    integer, intent(out) :: sign_of
    !> dx/dp, shape (n); 0 if it cannot be determined.
    real(wp), intent(out) :: slope(:)
    type(corrector_type) :: corrector
    type(curve_point) :: here
    logical :: made
    real(wp) :: value

    sign_of = 0
    slope = 0.0_wp
    call new_corrector(corrector, curve, tolerance, abs(p), x)
    call stand(curve, corrector, x, p, here, made)
    if (.not. made) return
    value = measure%growth(here)*here%slope_p
    if (value > 0.0_wp) sign_of = 1
    if (value < 0.0_wp) sign_of = -1
    if (abs(here%slope_p) > tiny(value)**0.5_wp) slope = here%slope_x/here%slope_p
  end subroutine growth_along

  !> Climb from a solution (x, p) to the maximum, if it lies between two values of p; otherwise (x,
  !! p) is unchanged. With `through` the curve is followed until it leaves this range, which may
  !! contain several maxima, and (x, p) becomes the highest one.
  subroutine climb(curve, measure, tolerance, low, high, x, p, found, cancel, through, &
                   upwards)
    class(curve_type), intent(inout) :: curve
    type(harmonic_measure), intent(in) :: measure
    !> Relative tolerance of the corrections.
    real(wp), intent(in) :: tolerance, low, high
    !> Shape (n).
    real(wp), intent(inout) :: x(:), p
    logical, intent(out) :: found
    !> May be set by another thread to cancel the search.
    integer, intent(inout), optional :: cancel
    !> True on return if the curve left the range forwards, not back at the side where it started.
    logical, intent(inout), optional :: through
    !> Start towards larger p, even if the amplitude falls there.
    logical, intent(in), optional :: upwards
    type(corrector_type) :: corrector
    type(curve_point), target :: points(3)
    type(curve_point), pointer :: before, here, next, spare
    real(wp) :: step, angle, scale, way, top
    logical :: made, all_of_it, rising
    integer :: k

    found = .false.
    all_of_it = .false.
    if (present(through)) then
      all_of_it = through
      through = .false.
    end if
    scale = max(abs(low), abs(high))
    call new_corrector(corrector, curve, tolerance, scale, x)
    before => points(1)
    here => points(2)
    next => points(3)
    call new_point(before, curve%n)
    call new_point(next, curve%n)
    call stand(curve, corrector, x, p, here, made)
    if (.not. made) return
    if (measure%growth(here) < 0.0_wp) call reverse(here)
    if (present(upwards)) then
      if (upwards .and. here%slope_p < 0.0_wp) call reverse(here)
    end if
    way = here%slope_p
    rising = measure%growth(here) >= 0.0_wp
    step = min(first_step, max(0.25_wp*(high - low)/scale, 1.0e3_wp*smallest_step))
    do k = 1, max_steps
      if (is_set(cancel)) return
      ! Exact: a tangent from kept factors may show the maximum too early.
      call correct(curve, corrector, here, step, next, made, .true.)
      if (made) then
        angle = angle_between(corrector, here, next)
        if (angle > largest_angle) made = .false.
        if (made .and. all_of_it .and. step > 1.0e-6_wp) then
          made = .not. measure%hides(here, next, step)
        end if
      end if
      if (.not. made) then
        step = 0.4_wp*step
        if (step < smallest_step) return
        cycle
      end if
      if (rising .and. measure%growth(next) <= 0.0_wp) then
        call find_summit(curve, corrector, measure, here, step, next, made)
        if (.not. made .or. next%p < low .or. next%p > high) return
        if (found) top = measure%size_at(x, p)
        if (.not. found .or. measure%size_at(next%x, next%p) > top) then
          x = next%x
          p = next%p
        end if
        found = .true.
        if (.not. all_of_it) return
        rising = .false.
      else
        rising = measure%growth(next) > 0.0_wp
      end if
      if (next%p <= low .or. next%p >= high) then
        if (present(through)) through = merge(next%p >= high, next%p <= low, way > 0.0_wp)
        return
      end if
      spare => before
      before => here
      here => next
      next => spare
      call aim(corrector, before, here)
      step = min(largest_step, step*min(2.0_wp, max(0.5_wp, wanted_angle/max(angle, 1.0e-3_wp))))
    end do
  end subroutine climb

  !> The solution at p with its tangent.
  subroutine stand(curve, corrector, x, p, here, made)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: corrector
    real(wp), intent(in) :: x(:), p
    type(curve_point), intent(out) :: here
    logical, intent(out) :: made
    type(curve_point) :: upright

    call new_point(upright, curve%n)
    call new_point(here, curve%n)
    upright%x(:) = x
    upright%p = p
    upright%slope_p = 1.0_wp
    call correct(curve, corrector, upright, 0.0_wp, here, made, .true.)
    if (.not. made) return
    here%p = p
    ! Correct again, so that the determinant belongs to the tangent.
    call copy_point(here, upright)
    call correct(curve, corrector, upright, 0.0_wp, here, made, .true.)
    here%p = p
  end subroutine stand

  !> Zero of the growth within a step, by false position.
  subroutine find_summit(curve, corrector, measure, here, step, found, made)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: corrector
    type(harmonic_measure), intent(in) :: measure
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    type(curve_point), intent(inout) :: found
    logical, intent(out) :: made
    real(wp) :: low, high, low_value, high_value, at, value
    integer :: k

    low = 0.0_wp
    high = step
    low_value = measure%growth(here)
    high_value = measure%growth(found)
    made = .true.
    do k = 1, max_turns
      ! False position, kept off the ends; every third iteration bisects.
      at = low + (high - low)*min(0.95_wp, max(0.05_wp, low_value/(low_value - high_value)))
      if (mod(k, 3) == 0) at = 0.5_wp*(low + high)
      call correct(curve, corrector, here, at, found, made, .true.)
      if (.not. made) return
      value = measure%growth(found)
      if (value > 0.0_wp) then
        low = at
        low_value = value
      else
        high = at
        high_value = value
      end if
      ! The amplitude is stationary here: errors of the location enter squared.
      if (.not. abs(value) > 0.0_wp .or. high - low <= 1.0e-9_wp*max(step, first_step)) exit
    end do
  end subroutine find_summit

end module viscovib_curve_peak
