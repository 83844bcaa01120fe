!> A branch of solutions by pseudo-arclength continuation: along the curve (x, p)
!! through folds, noting where others branch off.
!!
!! Predictor along the tangent t, corrector by Newton's method on the equations
!! together with <t, z - predicted> = 0; steps by the angle between successive
!! tangents (Keller, in: Applications of Bifurcation Theory, Academic Press (1977)
!! 359). The determinant of the bordered matrix [dR; t] keeps its sign at folds and
!! changes it at simple branch points, whose null vector leads onto the other branch.
module viscovib_curve_branch
  use viscovib_curve, only: curve_type
  use viscovib_dense, only: factorize_blocks, solve
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: curve_branch_type, curve_options, follow_curve

  !> How a branch ended: at the wanted end; back where it began; points used up; no
  !! step small enough; out of the range of numbers; at the end of what the equations
  !! describe; closed, back at its first point.
  integer, parameter, public :: curve_completed = 0, curve_returned = 1, curve_step_limit = 2, &
                                curve_stuck = 3, curve_overflow = 4, curve_unphysical = 5, &
                                curve_closed = 6

  integer, parameter :: max_iterations = 8
  !> Steps in units of the present point, at first and at least; where the equations
  !! end, steps this short are enough.
  real(wp), parameter :: first_step = 0.01_wp, smallest_step = 1.0e-9_wp, edge_step = 1.0e-5_wp
  !> Wanted angle between successive tangents.
  real(wp), parameter :: wanted_angle = 0.12_wp
  real(wp), parameter :: amplitude_limit = 1.0e60_wp

  type :: curve_options
    !> Where p begins and ends; the branch also ends if p falls back behind its
    !! beginning.
    real(wp) :: start = 0.0_wp, finish = 0.0_wp
    real(wp) :: tolerance = 1.0e-10_wp
    integer :: max_points = 2000
    !> Largest step, as a part of the present point.
    real(wp) :: max_step = 0.1_wp
  end type curve_options

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

  type :: curve_branch_type
    integer :: n_points = 0, outcome = curve_completed
    !> p and iterations, shape (max_points); x, shape (n_unknowns, max_points).
    real(wp), allocatable :: parameter(:), x(:, :)
    integer, allocatable :: iterations(:)
    type(special_points) :: folds, branch_points
  contains
    procedure, private :: add
  end type curve_branch_type

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

  !> Follow the branch on from a solution x at p = options%start, or, with `along`,
  !! leave the point (x, p) in that direction.
  subroutine follow_curve(curve, options, x, branch, p, along, cancel)
    class(curve_type), intent(inout) :: curve
    type(curve_options), intent(in) :: options
    !> Shape (n).
    real(wp), intent(in) :: x(:)
    type(curve_branch_type), intent(out) :: branch
    !> Where x lies, if not at the start.
    real(wp), intent(in), optional :: p
    !> Shape (n + 1).
    real(wp), intent(in), optional :: along(:)
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile, optional :: cancel
    type(corrector_type) :: corrector
    type(curve_point) :: here, next, first
    real(wp) :: step, angle, sign_wanted, apart
    integer :: n
    logical :: made, away

    n = curve%n
    allocate (branch%parameter(options%max_points), branch%iterations(options%max_points))
    allocate (branch%x(n, options%max_points))
    call empty(branch%folds, n)
    call empty(branch%branch_points, n)
    call new_corrector(corrector, n, options, x)
    sign_wanted = sign(1.0_wp, options%finish - options%start)
    allocate (here%x, source=x)
    allocate (here%slope_x(n), source=0.0_wp)
    here%p = options%start
    if (present(p)) here%p = p
    here%slope_p = sign_wanted
    step = min(first_step, options%max_step)
    branch%outcome = curve_stuck
    if (present(along)) then
      here%slope_x = along(:n)
      here%slope_p = along(n + 1)
      call normalize(corrector, here)
      call branch%add(here)
    else
      ! Corrected at fixed p, for the tangent.
      call correct(curve, corrector, here, 0.0_wp, next, made)
      if (.not. made) then
        if (corrector%outside) branch%outcome = curve_unphysical
        return
      end if
      if (next%slope_p*sign_wanted < 0.0_wp) call reverse(next)
      ! Once more, so that the determinant belongs to the tangent.
      here = next
      call correct(curve, corrector, here, 0.0_wp, next, made)
      if (.not. made) return
      here = next
      call branch%add(here)
    end if
    branch%outcome = curve_step_limit
    first = here
    away = .false.
    do while (branch%n_points < options%max_points)
      if (present(cancel)) then
        if (cancel /= 0) return
      end if
      call correct(curve, corrector, here, step, next, made)
      if (made) then
        corrector%outside = .false.
        angle = angle_between(corrector, here, next)
        if (angle > 4.0_wp*wanted_angle .and. step > 1.0e3_wp*smallest_step) made = .false.
      end if
      if (.not. made) then
        step = 0.4_wp*step
        if (corrector%outside .and. step < edge_step) then
          branch%outcome = curve_unphysical
          return
        end if
        if (step > smallest_step) cycle
        branch%outcome = curve_stuck
        return
      end if
      if (.not. maxval(abs(next%x)) <= amplitude_limit) then
        branch%outcome = curve_overflow
        return
      end if
      ! The first step off a branch point has nothing to compare with.
      if (.not. (present(along) .and. branch%n_points == 1)) then
        if (here%slope_p*next%slope_p < 0.0_wp) then
          call locate(curve, corrector, here, step, next, .true., branch)
        end if
        if (here%sign*next%sign < 0) then
          call locate(curve, corrector, here, step, next, .false., branch)
        end if
      end if
      if ((next%p - options%finish)*sign_wanted >= 0.0_wp) then
        call finish_at(options%finish, curve_completed)
        return
      end if
      if ((next%p - options%start)*sign_wanted < 0.0_wp) then
        call finish_at(options%start, curve_returned)
        return
      end if
      apart = distance(corrector, first, next)
      if (apart > 3.0_wp*max(step, first_step)) away = .true.
      here = next
      call branch%add(here)
      if (away .and. apart < step) then
        branch%outcome = curve_closed
        return
      end if
      step = step*min(2.0_wp, max(0.5_wp, wanted_angle/max(angle, 1.0e-12_wp)))
      if (here%iterations > 5) step = 0.6_wp*step
      step = min(step, options%max_step)
    end do

  contains

    !> The last point lies at the end itself: shorten the step until it does.
    subroutine finish_at(end, outcome)
      real(wp), intent(in) :: end
      integer, intent(in) :: outcome
      real(wp) :: low, high, low_p, high_p, trial
      integer :: k
      low = 0.0_wp
      low_p = here%p
      high = step
      high_p = next%p
      made = .true.
      do k = 1, 60
        if (abs(next%p - end) <= 1.0e-13_wp*corrector%p_scale) exit
        trial = low + (high - low)*min(0.98_wp, max(0.02_wp, (end - low_p)/(high_p - low_p)))
        call correct(curve, corrector, here, trial, next, made)
        if (.not. made) exit
        if ((next%p - end)*(low_p - end) > 0.0_wp) then
          low = trial
          low_p = next%p
        else
          high = trial
          high_p = next%p
        end if
      end do
      branch%outcome = merge(outcome, curve_stuck, made)
      if (made) then
        next%p = merge(end, next%p, abs(next%p - end) <= 1.0e-12_wp*corrector%p_scale)
        call branch%add(next)
      end if
    end subroutine finish_at

  end subroutine follow_curve

  subroutine empty(points, n)
    type(special_points), intent(out) :: points
    integer, intent(in) :: n
    allocate (points%p(0), points%x(n, 0), points%across(n + 1, 0), points%before(0))
  end subroutine empty

  subroutine new_corrector(corrector, n, options, x)
    type(corrector_type), intent(out) :: corrector
    integer, intent(in) :: n
    type(curve_options), intent(in) :: options
    real(wp), intent(in) :: x(:)
    allocate (corrector%matrix(n + 1, n + 1), corrector%right(n + 1), corrector%r(n), &
              corrector%slope_p(n), corrector%predicted(n), corrector%pivots(n + 1))
    corrector%tolerance = options%tolerance
    corrector%p_scale = max(abs(options%start), abs(options%finish))
    corrector%largest = sum(x**2)
  end subroutine new_corrector

  subroutine add(self, point)
    class(curve_branch_type), intent(inout) :: self
    type(curve_point), intent(in) :: point
    self%n_points = self%n_points + 1
    self%parameter(self%n_points) = point%p
    self%iterations(self%n_points) = point%iterations
    self%x(:, self%n_points) = point%x
  end subroutine add

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

  !> The fold, or the branch point, between `here` and the end of the step.
  subroutine locate(curve, c, here, step, end, fold, branch)
    class(curve_type), intent(inout) :: curve
    type(corrector_type), intent(inout) :: c
    type(curve_point), intent(in) :: here, end
    real(wp), intent(in) :: step
    logical, intent(in) :: fold
    type(curve_branch_type), intent(inout) :: branch
    type(curve_point) :: trial, found
    real(wp) :: low, high, low_value, high_value, at, value
    real(wp), allocatable :: across(:)
    logical :: made
    integer :: k

    low = 0.0_wp
    high = step
    low_value = measure(here)
    high_value = measure(end)
    found = end
    do k = 1, 60
      ! False position, kept off the ends; every third time the middle.
      at = low + (high - low)*min(0.9_wp, max(0.1_wp, low_value/(low_value - high_value)))
      if (mod(k, 3) == 0) at = 0.5_wp*(low + high)
      call correct(curve, c, here, at, trial, made)
      if (.not. made) exit
      found = trial
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
    if (.not. fold) then
      call null_vector(curve, c, here, found, across)
      call keep(branch%branch_points)
    else
      allocate (across(curve%n + 1), source=0.0_wp)
      call keep(branch%folds)
    end if

  contains

    !> What changes its sign.
    pure real(wp) function measure(point)
      type(curve_point), intent(in) :: point
      if (fold) then
        measure = point%slope_p
      else
        measure = point%sign*exp(max(-300.0_wp, min(300.0_wp, point%log_determinant &
                                                    - here%log_determinant)))
      end if
    end function measure

    subroutine keep(points)
      type(special_points), intent(inout) :: points
      points%n = points%n + 1
      points%p = [points%p, found%p]
      points%x = reshape([points%x, found%x], [size(found%x), points%n])
      points%across = reshape([points%across, across], [size(across), points%n])
      points%before = [points%before, branch%n_points]
    end subroutine keep

  end subroutine locate

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

end module viscovib_curve_branch
