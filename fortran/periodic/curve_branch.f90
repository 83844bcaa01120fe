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
  use viscovib_curve_corrector, only: angle_between, correct, corrector_type, curve_point, &
    distance, new_corrector, normalize, null_vector, reverse
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
    call new_corrector(corrector, n, options%tolerance, &
                       max(abs(options%start), abs(options%finish)), x)
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
      if ((next%p - options%finish)*sign_wanted >= 0.0_wp) then
        call finish_at(options%finish, curve_completed)
        return
      end if
      if ((next%p - options%start)*sign_wanted < 0.0_wp) then
        call finish_at(options%start, curve_returned)
        return
      end if
      call note(step)
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

    !> Folds and branch points between `here` and `next`, which lies a step `ahead`.
    subroutine note(ahead)
      real(wp), intent(in) :: ahead
      ! The first step off a branch point has nothing to compare with.
      if (present(along) .and. branch%n_points == 1) return
      if (here%slope_p*next%slope_p < 0.0_wp) then
        call locate(curve, corrector, here, ahead, next, .true., branch)
      end if
      if (here%sign*next%sign < 0) then
        call locate(curve, corrector, here, ahead, next, .false., branch)
      end if
    end subroutine note

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
      trial = step
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
        call note(trial)
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

  subroutine add(self, point)
    class(curve_branch_type), intent(inout) :: self
    type(curve_point), intent(in) :: point
    self%n_points = self%n_points + 1
    self%parameter(self%n_points) = point%p
    self%iterations(self%n_points) = point%iterations
    self%x(:, self%n_points) = point%x
  end subroutine add

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

end module viscovib_curve_branch
