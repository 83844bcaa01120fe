!> A branch of periodic solutions by pseudo-arclength continuation: along the curve
!! (X, p) through folds, p being the frequency or the factor of the load.
!!
!! Predictor along the tangent, corrector by Newton's method on the equations
!! together with <tangent, z - predicted> = 0; steps by the angle between
!! successive tangents. Keller, in: Applications of Bifurcation Theory, Academic
!! Press (1977) 359.
module viscovib_branch
  use viscovib_dense, only: factorize, solve
  use viscovib_harmonic_balance, only: balance_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: branch_type, branch_options, follow_branch, curve_point, correct, angle_between

  !> What varies along a branch.
  integer, parameter, public :: parameter_frequency = 1, parameter_load = 2
  !> How a branch ended: at the wanted end; back where it began; points used up;
  !! no step small enough; out of the range of numbers.
  integer, parameter, public :: branch_completed = 0, branch_returned = 1, branch_step_limit = 2, &
                                branch_stuck = 3, branch_overflow = 4

  integer, parameter :: max_iterations = 8
  !> Steps in units of the present point, at first and at least.
  real(wp), parameter :: first_step = 0.01_wp
  real(wp), parameter, public :: smallest_step = 1.0e-9_wp
  !> Wanted angle between successive tangents.
  real(wp), parameter, public :: wanted_angle = 0.12_wp

  type :: branch_options
    !> Where p begins and ends; the branch also ends if p falls back behind its
    !! beginning.
    real(wp) :: start = 0.0_wp, finish = 0.0_wp
    real(wp) :: tolerance = 1.0e-10_wp
    integer :: max_points = 2000
    !> Largest step, as a part of the present point.
    real(wp) :: max_step = 0.1_wp
  end type branch_options

  type :: branch_type
    integer :: n_points = 0, outcome = branch_completed
    !> p, its part of the unit tangent, and iterations, shape (max_points).
    real(wp), allocatable :: parameter(:), direction(:)
    integer, allocatable :: iterations(:)
    !> Harmonics, shape (2 n_orders, n_dof, max_points).
    real(wp), allocatable :: x(:, :, :)
    !> Folds: p and harmonics, in the order met.
    integer :: n_folds = 0
    real(wp), allocatable :: fold(:), fold_x(:, :, :)
  contains
    procedure, private :: add
  end type branch_type

  !> A point of the curve with its unit tangent.
  type :: curve_point
    real(wp), allocatable :: x(:, :), slope_x(:, :)
    real(wp) :: p = 0.0_wp, slope_p = 1.0_wp
    !> What counts as a small p: a load factor of 1, but a frequency has units.
    real(wp) :: p_scale = 1.0_wp
    integer :: iterations = 0
  end type curve_point

contains

  !> Follow the branch on from a solution x at p = options%start.
  subroutine follow_branch(balance, system, load, parameter, options, x, branch, cancel)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: parameter
    type(branch_options), intent(in) :: options
    real(wp), intent(in) :: x(:, :)
    type(branch_type), intent(out) :: branch
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile, optional :: cancel
    type(curve_point) :: here, next
    real(wp) :: step, angle, sign_wanted
    logical :: made

    allocate (branch%parameter(options%max_points), branch%direction(options%max_points))
    allocate (branch%iterations(options%max_points))
    allocate (branch%x(size(x, 1), size(x, 2), options%max_points))
    allocate (branch%fold(0), branch%fold_x(size(x, 1), size(x, 2), 0))
    sign_wanted = sign(1.0_wp, options%finish - options%start)
    here%x = x
    here%p = options%start
    here%slope_x = 0.0_wp*x
    here%slope_p = sign_wanted
    if (parameter == parameter_frequency) here%p_scale = 0.1_wp*max(options%start, options%finish)
    ! Corrected at fixed p, for the tangent.
    call correct(balance, system, load, parameter, options, here, 0.0_wp, next, made)
    if (.not. made) then
      branch%outcome = branch_stuck
      return
    end if
    if (next%slope_p*sign_wanted < 0.0_wp) then
      next%slope_x = -next%slope_x
      next%slope_p = -next%slope_p
    end if
    here = next
    call branch%add(here)
    step = min(first_step, options%max_step)
    branch%outcome = branch_step_limit
    do while (branch%n_points < options%max_points)
      if (present(cancel)) then
        if (cancel /= 0) return
      end if
      call correct(balance, system, load, parameter, options, here, step, next, made)
      if (made) then
        angle = angle_between(system, here, next)
        if (angle > 4.0_wp*wanted_angle .and. step > 1.0e3_wp*smallest_step) made = .false.
      end if
      if (.not. made) then
        step = 0.4_wp*step
        if (step > smallest_step) cycle
        branch%outcome = branch_stuck
        return
      end if
      if (.not. maxval(abs(next%x)) <= system%largest_amplitude()) then
        branch%outcome = branch_overflow
        return
      end if
      if (here%slope_p*next%slope_p < 0.0_wp) then
        call locate_fold(balance, system, load, parameter, options, here, step, branch)
      end if
      if ((next%p - options%finish)*sign_wanted >= 0.0_wp) then
        call finish_at(options%finish, branch_completed)
        return
      end if
      if ((next%p - options%start)*sign_wanted < 0.0_wp) then
        call finish_at(options%start, branch_returned)
        return
      end if
      here = next
      call branch%add(here)
      step = step*min(2.0_wp, max(0.5_wp, wanted_angle/max(angle, 1.0e-12_wp)))
      if (here%iterations > 5) step = 0.6_wp*step
      step = min(step, options%max_step)
    end do

  contains

    !> The last point lies at the end itself: shorten the step until it does.
    subroutine finish_at(p, outcome)
      real(wp), intent(in) :: p
      integer, intent(in) :: outcome
      real(wp) :: low, high, low_p, high_p, trial
      integer :: k
      low = 0.0_wp
      low_p = here%p
      high = step
      high_p = next%p
      do k = 1, 60
        if (abs(next%p - p) <= 1.0e-13_wp*max(abs(p), here%p_scale)) exit
        trial = low + (high - low)*min(0.98_wp, max(0.02_wp, (p - low_p)/(high_p - low_p)))
        call correct(balance, system, load, parameter, options, here, trial, next, made)
        if (.not. made) exit
        if ((next%p - p)*(low_p - p) > 0.0_wp) then
          low = trial
          low_p = next%p
        else
          high = trial
          high_p = next%p
        end if
      end do
      branch%outcome = merge(outcome, branch_stuck, made)
      if (made) then
        next%p = merge(p, next%p, abs(next%p - p) <= 1.0e-12_wp*max(abs(p), here%p_scale))
        call branch%add(next)
      end if
    end subroutine finish_at

  end subroutine follow_branch

  subroutine add(self, point)
    class(branch_type), intent(inout) :: self
    type(curve_point), intent(in) :: point
    self%n_points = self%n_points + 1
    self%parameter(self%n_points) = point%p
    self%direction(self%n_points) = point%slope_p
    self%iterations(self%n_points) = point%iterations
    self%x(:, :, self%n_points) = point%x
  end subroutine add

  !> The point a step along the tangent from `here`, on the curve, with its tangent.
  subroutine correct(balance, system, load, parameter, options, here, step, next, made)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: parameter
    type(branch_options), intent(in) :: options
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    type(curve_point), intent(out) :: next
    logical, intent(out) :: made
    real(wp) :: matrix(size(here%x) + 1, size(here%x) + 1), right(size(here%x) + 1)
    real(wp) :: r(size(here%x, 1), size(here%x, 2))
    real(wp), dimension(size(here%x, 1), size(here%x, 2)) :: slope_p, change_x, weights, predicted_x
    real(wp) :: predicted_p, weight_p, change
    integer :: pivots(size(here%x) + 1), n, k
    logical :: singular

    n = size(here%x)
    made = .false.
    call metric(system, here, weights, weight_p)
    predicted_x = here%x + step*here%slope_x
    predicted_p = here%p + step*here%slope_p
    next%x = predicted_x
    next%p = predicted_p
    next%p_scale = here%p_scale
    do k = 1, max_iterations
      if (parameter == parameter_frequency) then
        if (.not. next%p > 0.0_wp) return
        call balance%set_frequency(system, load, next%p)
      else
        balance%load_factor = next%p
      end if
      call balance%residual(system, next%x, r)
      if (parameter == parameter_frequency) then
        call balance%frequency_derivative(system, load, next%x, slope_p)
      else
        call balance%load_derivative(slope_p)
      end if
      call balance%derivatives(system, matrix)
      matrix(:n, n + 1) = reshape(slope_p, [n])
      matrix(n + 1, :n) = reshape(weights*here%slope_x, [n])
      matrix(n + 1, n + 1) = weight_p*here%slope_p
      right(:n) = reshape(r, [n])
      right(n + 1) = sum(weights*here%slope_x*(next%x - predicted_x)) &
                     + weight_p*here%slope_p*(next%p - predicted_p)
      call factorize(n + 1, matrix, pivots, singular)
      if (singular) return
      call solve(n + 1, matrix, pivots, right)
      change_x = reshape(right(:n), shape(change_x))
      next%x = next%x - change_x
      next%p = next%p - right(n + 1)
      next%iterations = k
      change = sqrt(sum(weights*change_x**2) + weight_p*right(n + 1)**2)
      if (.not. change <= 1.0e3_wp) return
      if (change <= max(options%tolerance, 4.0_wp*epsilon(1.0_wp))) exit
    end do
    if (k > max_iterations) return
    made = .true.
    ! The tangent: [J, R_p; tangent before] t = (0, 1), by the same factors.
    right = 0.0_wp
    right(n + 1) = 1.0_wp
    call solve(n + 1, matrix, pivots, right)
    next%slope_x = reshape(right(:n), shape(next%x))
    next%slope_p = right(n + 1)
    call metric(system, next, weights, weight_p)
    change = sqrt(sum(weights*next%slope_x**2) + weight_p*next%slope_p**2)
    next%slope_x = next%slope_x/change
    next%slope_p = next%slope_p/change
  end subroutine correct

  !> Squares are weighed by inertia, and against the size of the motion and of p.
  pure subroutine metric(system, point, weights, weight_p)
    class(oscillator_type), intent(in) :: system
    type(curve_point), intent(in) :: point
    real(wp), intent(out) :: weights(:, :), weight_p
    real(wp) :: total
    integer :: d

    do d = 1, size(weights, 2)
      weights(:, d) = system%mass(d, d)
    end do
    total = sum(weights*point%x**2)
    if (total > 0.0_wp) weights = weights/total
    weight_p = 1.0_wp/max(abs(point%p), 0.1_wp*point%p_scale)**2
  end subroutine metric

  pure real(wp) function angle_between(system, a, b) result(angle)
    class(oscillator_type), intent(in) :: system
    type(curve_point), intent(in) :: a, b
    real(wp) :: weights(size(a%x, 1), size(a%x, 2)), weight_p, product, length
    call metric(system, b, weights, weight_p)
    product = sum(weights*a%slope_x*b%slope_x) + weight_p*a%slope_p*b%slope_p
    length = sqrt(sum(weights*a%slope_x**2) + weight_p*a%slope_p**2)
    angle = acos(max(-1.0_wp, min(1.0_wp, product/max(length, tiny(length)))))
  end function angle_between

  !> The point between `here` and the end of the step where p turns back.
  subroutine locate_fold(balance, system, load, parameter, options, here, step, branch)
    type(balance_type), intent(inout) :: balance
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: parameter
    type(branch_options), intent(in) :: options
    type(curve_point), intent(in) :: here
    real(wp), intent(in) :: step
    type(branch_type), intent(inout) :: branch
    type(curve_point) :: trial
    real(wp) :: low, high, low_slope, high_slope, at
    logical :: made
    integer :: k

    low = 0.0_wp
    low_slope = here%slope_p
    call correct(balance, system, load, parameter, options, here, step, trial, made)
    high = step
    high_slope = trial%slope_p
    do k = 1, 50
      ! False position, kept off the ends.
      at = low + (high - low)*min(0.9_wp, max(0.1_wp, low_slope/(low_slope - high_slope)))
      call correct(balance, system, load, parameter, options, here, at, trial, made)
      if (.not. made) return
      if (trial%slope_p*low_slope > 0.0_wp) then
        low = at
        low_slope = trial%slope_p
      else
        high = at
        high_slope = trial%slope_p
      end if
      ! p is stationary here: an error of 1e-7 in place is one of 1e-14 in p.
      if (abs(trial%slope_p) <= 1.0e-7_wp*abs(here%p) .or. high - low <= 1.0e-9_wp) exit
    end do
    branch%n_folds = branch%n_folds + 1
    branch%fold = [branch%fold, trial%p]
    branch%fold_x = reshape([branch%fold_x, trial%x], [shape(trial%x), branch%n_folds])
  end subroutine locate_fold

end module viscovib_branch
