!> A branch of solutions by pseudo-arclength continuation: along the curve (x, p)
!! through folds, noting where others branch off and stopping where told.
!!
!! Steps by the angle between successive tangents (Keller, in: Applications of
!! Bifurcation Theory, Academic Press (1977) 359). The determinant of the bordered
!! matrix [dR; t] keeps its sign at folds and changes it at simple branch points, whose
!! null vector leads onto the other branch.
module viscovib_curve_branch
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_curve, only: curve_type
  use viscovib_curve_corrector, only: aim, angle_between, compare, copy_point, correct, &
    corrector_type, curve_point, distance, new_corrector, new_point, normalize, reverse, &
    rounding_of, truncation_shift
  use viscovib_curve_events, only: empty, locate_branch_point, locate_fold, locate_value, nowhere, &
    special_points
  use viscovib_kinds, only: wp
  use viscovib_sized_curve, only: refitted, sized_curve_type
  use viscovib_stopping, only: stop_wanted
  implicit none
  private

  public :: curve_branch_type, curve_options, follow_curve

  !> How a branch ended: at the wanted end; back where it began; points used up; no
  !! step small enough; out of the range of numbers; at the end of what the equations
  !! describe; closed, back at its first point; the time for it over.
  integer, parameter, public :: curve_completed = 0, curve_returned = 1, curve_step_limit = 2, &
                                curve_stuck = 3, curve_overflow = 4, curve_unphysical = 5, &
                                curve_closed = 6, curve_stopped = 7
  character(len=*), parameter, public :: curve_outcomes(0:7) = &
    [character(len=10) :: 'completed', 'returned', 'step limit', 'stuck', 'overflow', &
     'unphysical', 'closed', 'stopped']

  !> Steps in units of the present point, at first and at least; where the equations
  !! end, steps this short are enough.
  real(wp), parameter :: first_step = 0.01_wp, smallest_step = 1.0e-9_wp, edge_step = 1.0e-5_wp
  !> The determinant may change its sign over a step this long.
  real(wp), parameter :: careful_step = 0.01_wp
  !> Wanted angle between successive tangents.
  real(wp), parameter :: wanted_angle = 0.12_wp
  !> How far a point may lie off its prediction, as a part of each order of the motion, and how
  !! far it is wanted to lie, which goes with the fourth power of the step.
  real(wp), parameter :: most_surprise = 0.3_wp, wanted_surprise = 0.2_wp
  !> How far p may be off its prediction, as a part of its changes.
  real(wp), parameter :: most_drift = 0.5_wp

  type :: curve_options
    !> Where p begins and ends; the branch also ends if p falls back behind its
    !! beginning.
    real(wp) :: start = 0.0_wp, finish = 0.0_wp
    real(wp) :: tolerance = 1.0e-10_wp
    integer :: max_points = 2000
    !> Largest step, as a part of the present point.
    real(wp) :: max_step = 0.1_wp
    !> Values of p at each of which a point of the branch shall lie; none if not
    !! allocated.
    real(wp), allocatable :: stops(:)
  end type curve_options

  type :: curve_branch_type
    integer :: n_points = 0, outcome = curve_completed
    !> Blocks of unknowns.
    integer :: blocks = 1
    !> p, its part of the unit tangent and iterations, shape (max_points); x, shape
    !! (n_unknowns at most, max_points).
    real(wp), allocatable :: parameter(:), direction(:), x(:, :)
    integer, allocatable :: iterations(:)
    !> Estimated error of each point relative to its size: what the last correction and rounding
    !! leave, shape (max_points).
    real(wp), allocatable :: error(:)
    !> Where the number of unknowns is chosen: how many were kept, and what leaving out others
    !! changes, relative to x, shape (max_points).
    integer, allocatable :: kept(:)
    real(wp), allocatable :: truncation(:)
    type(special_points) :: folds, branch_points
    !> Which points are stops.
    integer, allocatable :: stops(:)
  contains
    procedure :: end_with_numbers
    procedure :: end_before
    procedure, private :: add
  end type curve_branch_type

contains

  !> Follow the branch on from a solution x at p = options%start, or, with `along`,
  !! leave the point (x, p) in that direction.
  subroutine follow_curve(curve, options, x, branch, p, along, cancel)
    class(curve_type), intent(inout), target :: curve
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
    type(curve_point), target :: points(4)
    type(curve_point), pointer :: before, here, next, spare
    type(curve_point) :: stop_point
    !> Wanted values, and the steps to those met since `here`.
    real(wp), allocatable :: stops(:), places(:)
    !> The curve, if the number of unknowns is chosen.
    class(sized_curve_type), pointer :: sized
    real(wp) :: step, angle, sign_wanted, apart, truncation, off, drift
    integer :: n, k
    logical :: made, away, again

    sized => null()
    select type (curve)
    class is (sized_curve_type)
      if (curve%adaptive) sized => curve
    end select
    n = curve%n
    truncation = 0.0_wp
    call allocate_branch()
    allocate (stops(0), places(0))
    if (allocated(options%stops)) stops = options%stops
    call new_corrector(corrector, curve, options%tolerance, &
                       max(abs(options%start), abs(options%finish)), x)
    do k = 1, size(points)
      call new_point(points(k), n)
    end do
    call new_point(stop_point, n)
    before => points(1)
    here => points(2)
    next => points(3)
    sign_wanted = sign(1.0_wp, options%finish - options%start)
    here%x(:) = x
    here%p = options%start
    if (present(p)) here%p = p
    here%slope_p = sign_wanted
    step = min(first_step, options%max_step)
    branch%outcome = curve_stuck
    if (present(along)) then
      here%slope_x(:) = along(:n)
      here%slope_p = along(n + 1)
      call normalize(corrector, here)
    else
      ! Corrected at fixed p, for the tangent.
      call correct(curve, corrector, here, 0.0_wp, next, made, .true.)
      if (.not. made) then
        if (corrector%outside) branch%outcome = curve_unphysical
        return
      end if
      next%p = here%p
      do while (associated(sized))
        call examine(next, again)
        if (.not. again) exit
        call change_size()
        call correct(curve, corrector, here, 0.0_wp, next, made, .true.)
        if (.not. made) return
        next%p = here%p
      end do
      if (next%slope_p*sign_wanted < 0.0_wp) call reverse(next)
      ! Once more, so that the determinant belongs to the tangent.
      call copy_point(next, here)
      call correct(curve, corrector, here, 0.0_wp, next, made, .true.)
      if (.not. made) return
      ! What that moved is rounding.
      next%p = here%p
      call copy_point(next, here)
    end if
    if (.not. present(along)) call blur(here)
    call branch%add(here, any(abs(stops - here%p) <= 0.0_wp), truncation)
    branch%outcome = curve_step_limit
    call copy_point(here, points(4))
    away = .false.
    do while (branch%n_points < options%max_points)
      if (present(cancel)) then
        if (cancel /= 0) return
      end if
      if (stop_wanted()) then
        branch%outcome = curve_stopped
        return
      end if
      call correct(curve, corrector, here, step, next, made, .false.)
      if (made) then
        corrector%outside = .false.
        angle = angle_between(corrector, here, next)
        call compare(curve, corrector, here, step, next, off, drift)
        if ((angle > 4.0_wp*wanted_angle .or. off > most_surprise &
             .or. (drift > most_drift .and. .not. leaving())) &
            .and. step > 1.0e3_wp*smallest_step) made = .false.
        ! A long step may have met another branch, which the determinant tells.
        if (sign_changes() .and. step > careful_step) made = .false.
      end if
      if (made .and. associated(sized)) then
        call examine(next, again)
        if (again) then
          call change_size()
          cycle
        end if
      end if
      if (.not. made) then
        step = 0.4_wp*step
        if (corrector%outside .and. step < edge_step) then
          branch%outcome = curve_unphysical
          if (abs(options%finish - here%p) < 10.0_wp*edge_step*corrector%p_scale) call end_at_edge()
          return
        end if
        if (step > smallest_step) cycle
        branch%outcome = curve_stuck
        return
      end if
      call blur(next)
      if (.not. all(abs(next%x) <= curve%largest)) then
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
      call record_events(step)
      if (branch%n_points == options%max_points) return
      apart = distance(corrector, points(4), next)
      if (apart > 3.0_wp*max(step, first_step)) away = .true.
      call branch%add(next, any(abs(stops - next%p) <= 0.0_wp), truncation)
      if (away .and. apart < step) then
        branch%outcome = curve_closed
        return
      end if
      spare => before
      before => here
      here => next
      next => spare
      if (associated(sized)) call change_size()
      call aim(corrector, before, here)
      step = step*rounded_factor(min(wanted_angle/max(angle, 1.0e-12_wp), &
                                     sqrt(sqrt(wanted_surprise/max(off, 1.0e-12_wp)))))
      if (here%iterations > 6) step = 0.6_wp*step
      step = min(step, options%max_step)
    end do

  contains

    subroutine allocate_branch()
      integer :: most
      most = n
      if (associated(sized)) then
        most = sized%n_most
        branch%blocks = sized%blocks
        allocate (branch%kept(options%max_points), branch%truncation(options%max_points))
      end if
      allocate (branch%parameter(options%max_points), branch%direction(options%max_points), &
                branch%iterations(options%max_points), branch%error(options%max_points), &
                branch%x(most, options%max_points), branch%stops(0))
      call empty(branch%folds, most, branch%blocks)
      call empty(branch%branch_points, most, branch%blocks)
    end subroutine allocate_branch

    !> Whether a point needs more unknowns.
    subroutine examine(point, again)
      type(curve_point), intent(in) :: point
      logical, intent(out) :: again
      real(wp) :: pushed(n), own, moved
      call sized%left_out(point%x, point%p, pushed, own)
      call truncation_shift(corrector, point, pushed, moved)
      truncation = max(own, moved)
      call sized%choose_size(point%x, truncation, own, again)
    end subroutine examine

    !> What rounding leaves of a point just corrected.
    subroutine blur(point)
      type(curve_point), intent(inout) :: point
      real(wp) :: moved
      call rounding_of(curve, corrector, point, moved)
      point%error = max(point%error, moved)
    end subroutine blur

    !> Go on with the number of unknowns chosen.
    subroutine change_size()
      type(curve_point) :: old
      real(wp) :: largest, p_scale
      integer :: i
      call sized%resize()
      if (curve%n == n) return
      n = curve%n
      do i = 1, size(points)
        old = points(i)
        points(i)%x = refitted(sized%blocks, old%x, n)
        points(i)%slope_x = refitted(sized%blocks, old%slope_x, n)
      end do
      stop_point%x = here%x
      stop_point%slope_x = here%slope_x
      largest = corrector%largest
      p_scale = corrector%p_scale
      call new_corrector(corrector, curve, options%tolerance, p_scale, here%x)
      corrector%largest = largest
      if (branch%n_points > 1) call aim(corrector, before, here)
    end subroutine change_size

    !> The first step off a branch point has nothing to compare with.
    logical function leaving()
      leaving = present(along) .and. branch%n_points == 1
    end function leaving

    logical function sign_changes()
      sign_changes = here%sign*next%sign < 0 .and. .not. leaving()
    end function sign_changes

    !> Folds, branch points and stops between `here` and `next`, which lies a step
    !! `ahead`.
    subroutine record_events(ahead)
      real(wp), intent(in) :: ahead
      real(wp) :: at_fold, at_branch_point
      integer :: n_before
      at_fold = nowhere
      at_branch_point = nowhere
      if (here%slope_p*next%slope_p < 0.0_wp .and. .not. leaving()) then
        call locate_fold(curve, corrector, here, ahead, branch%folds, at_fold)
      end if
      if (sign_changes()) then
        call locate_branch_point(curve, corrector, here, ahead, branch%branch_points, &
                                 at_branch_point)
      end if
      n_before = branch%n_points
      places = [real(wp) ::]
      if (size(stops) > 0) then
        if (at_fold > 0.0_wp .and. at_fold < ahead) then
          call add_stops(0.0_wp, at_fold, here%p, branch%folds%p(branch%folds%n))
          call add_stops(at_fold, ahead, branch%folds%p(branch%folds%n), next%p)
        else
          call add_stops(0.0_wp, ahead, here%p, next%p)
        end if
      end if
      if (at_fold < nowhere) then
        branch%folds%before(branch%folds%n) = n_before + passed(at_fold, ahead)
      end if
      if (at_branch_point < nowhere) then
        branch%branch_points%before(branch%branch_points%n) = n_before &
                                                              + passed(at_branch_point, ahead)
      end if
    end subroutine record_events

    !> Points between `here` and a place of the step, which may lie a little off it.
    integer function passed(at, ahead)
      real(wp), intent(in) :: at, ahead
      passed = count(places < at) + merge(1, 0, at > ahead) - merge(1, 0, at < 0.0_wp)
    end function passed

    !> Add the stops between two places of the step, in the order met.
    subroutine add_stops(from, to, p_from, p_to)
      real(wp), intent(in) :: from, to, p_from, p_to
      real(wp) :: last, at
      integer :: k
      last = p_from
      do while (branch%n_points < options%max_points)
        ! The next one strictly between.
        k = minloc(abs(stops - last), 1, (stops - last)*(p_to - stops) > 0.0_wp)
        if (k == 0) return
        last = stops(k)
        call locate_value(curve, corrector, here, from, to, last, stop_point, at, made)
        if (.not. made) return
        places = [places, at]
        call blur(stop_point)
        call branch%add(stop_point, .true., truncation)
      end do
    end subroutine add_stops

    !> The last point lies at the end itself.
    subroutine finish_at(end, outcome)
      real(wp), intent(in) :: end
      integer, intent(in) :: outcome
      real(wp) :: at
      call locate_value(curve, corrector, here, 0.0_wp, step, end, next, at, made)
      branch%outcome = merge(outcome, curve_stuck, made)
      if (.not. made) return
      call blur(next)
      call record_events(at)
      if (branch%n_points < options%max_points) then
        call branch%add(next, any(abs(stops - next%p) <= 0.0_wp), truncation)
      else
        branch%outcome = curve_step_limit
      end if
    end subroutine finish_at

    !> Where the values of p end at the finish nothing lies beyond it: the last point at fixed p.
    subroutine end_at_edge()
      type(curve_point) :: upright
      call new_point(upright, n)
      call copy_point(here, upright)
      upright%p = options%finish
      upright%slope_x = 0.0_wp
      upright%slope_p = sign_wanted
      call correct(curve, corrector, upright, 0.0_wp, next, made, .true.)
      if (.not. made) return
      branch%outcome = curve_completed
      call blur(next)
      next%p = options%finish
      if (next%slope_p*sign_wanted < 0.0_wp) call reverse(next)
      if (branch%n_points < options%max_points) then
        call branch%add(next, any(abs(stops - next%p) <= 0.0_wp), truncation)
      end if
    end subroutine end_at_edge

  end subroutine follow_curve

  !> Between 1/2 and 2, rounded to an eighth power of 2: rounding errors in angles would add
  !! up along a branch, and move its points from build to build.
  elemental real(wp) function rounded_factor(factor)
    real(wp), intent(in) :: factor
    rounded_factor = 2.0_wp**(0.125_wp*anint(8.0_wp*log(min(2.0_wp, max(0.5_wp, factor))) &
                                             /log(2.0_wp)))
  end function rounded_factor

  subroutine add(self, point, stop, truncation)
    class(curve_branch_type), intent(inout) :: self
    type(curve_point), intent(in) :: point
    logical, intent(in) :: stop
    !> Not yet known at the first point off another branch, which has that of the next.
    real(wp), intent(in) :: truncation
    self%n_points = self%n_points + 1
    self%parameter(self%n_points) = point%p
    self%direction(self%n_points) = point%slope_p
    self%iterations(self%n_points) = point%iterations
    self%error(self%n_points) = point%error
    self%x(:, self%n_points) = refitted(self%blocks, point%x, size(self%x, 1))
    if (allocated(self%kept)) then
      self%kept(self%n_points) = size(point%x)
      self%truncation(self%n_points) = truncation
      if (self%n_points == 2 .and. .not. self%truncation(1) > 0.0_wp) then
        self%truncation(1) = truncation
      end if
    end if
    if (stop) self%stops = [self%stops, self%n_points]
  end subroutine add

  !> A point that is no number ends the branch before it.
  subroutine end_with_numbers(self)
    class(curve_branch_type), intent(inout) :: self
    logical :: finite
    integer :: i

    do i = 1, self%n_points
      finite = all(ieee_is_finite([self%parameter(i), self%error(i)]))
      if (finite) finite = all(ieee_is_finite(self%x(:, i)))
      if (finite .and. allocated(self%truncation)) finite = ieee_is_finite(self%truncation(i))
      if (finite) cycle
      call self%end_before(i)
      return
    end do
  end subroutine end_with_numbers

  !> End the branch before a point whose numbers leave their range.
  pure subroutine end_before(self, i)
    class(curve_branch_type), intent(inout) :: self
    integer, intent(in) :: i
    self%n_points = i - 1
    self%outcome = curve_overflow
    self%folds%n = count(self%folds%before(:self%folds%n) < i)
    self%branch_points%n = count(self%branch_points%before(:self%branch_points%n) < i)
    self%stops = pack(self%stops, self%stops < i)
  end subroutine end_before

end module viscovib_curve_branch
