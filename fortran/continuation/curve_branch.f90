! Optimize: -O2 -fvect-cost-model=dynamic
!> A branch of solutions by pseudo-arclength continuation: along the curve (x, p)
!! through folds, recording branch points and stopping at requested values.
!!
!! Steps by the angle between successive tangents (Keller, in: Applications of
!! Bifurcation Theory, Academic Press (1977) 359). The determinant of the bordered
!! matrix [dR; t] keeps its sign at folds and changes it at simple branch points, whose
!! null vector leads onto the other branch.
module viscovib_curve_branch
  use viscovib_curve, only: curve_type
  use viscovib_curve_corrector, only: aim, aim_straight, compare, correct, corrector_type, &
    new_corrector
  use viscovib_curve_events, only: drop_last_near, locate_branch_point, locate_fold, &
    locate_value, nowhere, turn_at
  use viscovib_curve_options, only: curve_options, curve_table
  use viscovib_curve_point, only: angle_between, copy_point, curve_point, distance, &
    goes_to_and_fro, haunt_type, is_ahead, new_point, normalize, reverse
  use viscovib_curve_record, only: curve_branch_type, curve_closed, curve_completed, &
    curve_fold_limit, curve_outcomes, curve_overflow, curve_returned, curve_step_limit, &
    curve_stopped, curve_stuck, curve_unphysical
  use viscovib_curve_rounding, only: all_patterns, least_error, rounding_of, truncation_shift
  use viscovib_kinds, only: wp
  use viscovib_sized_curve, only: refitted, sized_curve_type
  use viscovib_stopping, only: begin_piece, is_set, stop_wanted
  implicit none
  private

  public :: follow_curve
  public :: curve_branch_type, curve_options, curve_outcomes, curve_table
  public :: curve_closed, curve_completed, curve_fold_limit, curve_overflow, curve_returned, &
            curve_step_limit, curve_stopped, curve_stuck, curve_unphysical

  !> Step sizes relative to the present point: initial and smallest. At the end of the domain of the
  !! equations, steps of the third size are sufficient.
  real(wp), parameter :: first_step = 0.01_wp, smallest_step = 1.0e-9_wp, edge_step = 1.0e-5_wp
  !> After a longer step a change of sign of the determinant may come from another branch.
  real(wp), parameter :: careful_step = 0.01_wp
  !> Largest distance of a point from its prediction, as a fraction of each harmonic of the
  !! solution, and the target, which scales with the fourth power of the step.
  real(wp), parameter :: most_surprise = 0.3_wp, wanted_surprise = 0.2_wp
  !> Largest deviation of p from its prediction, relative to its changes, and of a vanishing group
  !! of unknowns from its tangents, relative to the group.
  real(wp), parameter :: most_drift = 0.5_wp, most_bend = 0.3_wp
  !> The effect of neglected unknowns counts as rounding error up to this multiple of it.
  real(wp), parameter :: as_rounding = 8.0_wp

  !> State of a continuation.
  type :: follower_type
    class(curve_type), pointer :: curve => null()
    !> The same curve, if the number of unknowns is adapted.
    class(sized_curve_type), pointer :: sized => null()
    type(curve_options) :: options
    type(corrector_type) :: corrector
    type(curve_point) :: points(3), first, stop_point
    type(haunt_type) :: haunt
    !> Three of those points, in turn.
    type(curve_point), pointer :: before => null(), here => null(), next => null()
    !> Requested values, and the steps to those reached since `here`.
    real(wp), allocatable :: stops(:), places(:)
    real(wp) :: step = 0.0_wp, sign_wanted = 1.0_wp
    !> Of the point measured last: size of the neglected unknowns, and the effect of rounding errors
    !! on it.
    real(wp) :: own = 0.0_wp, rounding = 0.0_wp
    !> Of the last step: the angle between its tangents, and the distance from the prediction.
    real(wp) :: angle = 0.0_wp, off = 0.0_wp
    !> True if the curve began by leaving a branch point; if it has left its first point; and if the
    !! last step passes the branch point again, where the branch closes.
    logical :: leaves = .false., away = .false., passes = .false.
    !> The branch point at which the last step turned back, if `turned`.
    type(curve_point) :: turn
    logical :: turned = .false.
  end type follower_type

contains

  !> Follow the branch from a solution x at p = options%start, or, with `along`, leave the point (x,
  !! p) in that direction.
  subroutine follow_curve(curve, options, x, branch, p, along, cancel)
    class(curve_type), intent(inout), target :: curve
    type(curve_options), intent(in) :: options
    !> Shape (n).
    real(wp), intent(in) :: x(:)
    type(curve_branch_type), intent(out) :: branch
    !> Parameter of x, if not the start.
    real(wp), intent(in), optional :: p
    !> Shape (n + 1).
    real(wp), intent(in), optional :: along(:)
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(follower_type), target :: f
    logical :: made, ended

    call prepare(f, curve, options, x)
    if (present(p)) f%here%p = p
    call branch%allocate_arrays(options%max_points, curve%n, f%sized)
    if (present(along)) then
      f%leaves = .true.
      f%here%slope_x(:) = along(:curve%n)
      f%here%slope_p = along(curve%n + 1)
      call normalize(f%corrector, f%here)
    else
      call begin(f, branch, made)
      if (.not. made) return
    end if
    call branch%add(f%here, at_stop(f, f%here%p))
    branch%outcome = curve_step_limit
    call copy_point(f%here, f%first)
    do while (branch%n_points < options%max_points)
      if (is_set(cancel)) return
      if (stop_wanted()) then
        branch%outcome = curve_stopped
        return
      end if
      call begin_piece()
      call make_step(f, branch, made, ended)
      if (ended) return
      if (.not. made) cycle
      call take_step(f, branch, ended)
      if (ended) return
      call go_on(f, branch)
    end do
  end subroutine follow_curve

  !> Initialize a follower, without correcting the first point.
  subroutine prepare(f, curve, options, x)
    type(follower_type), intent(inout), target :: f
    class(curve_type), intent(inout), target :: curve
    type(curve_options), intent(in) :: options
    real(wp), intent(in) :: x(:)
    integer :: k
    f%curve => curve
    select type (curve)
    class is (sized_curve_type)
      if (curve%adaptive) f%sized => curve
    end select
    f%options = options
    allocate (f%stops(0), f%places(0))
    if (allocated(options%stops)) f%stops = options%stops
    call new_corrector(f%corrector, curve, options%tolerance, &
                       max(abs(options%start), abs(options%finish)), x, options%atol)
    do k = 1, size(f%points)
      call new_point(f%points(k), curve%n)
    end do
    call new_point(f%first, curve%n)
    call new_point(f%stop_point, curve%n)
    call new_point(f%turn, curve%n)
    f%before => f%points(1)
    f%here => f%points(2)
    f%next => f%points(3)
    f%sign_wanted = sign(1.0_wp, options%finish - options%start)
    f%here%x(:) = x
    f%here%p = options%start
    f%here%slope_p = f%sign_wanted
    f%step = min(first_step, options%max_step)
  end subroutine prepare

  !> The first point, corrected at fixed p, with its tangent.
  subroutine begin(f, branch, made)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(inout) :: branch
    logical, intent(out) :: made
    logical :: again

    branch%outcome = curve_stuck
    call correct_upright(f, made)
    if (.not. made) then
      if (f%corrector%outside) branch%outcome = curve_unphysical
      return
    end if
    do while (associated(f%sized))
      call examine(f, again)
      if (.not. again) exit
      call change_size(f, branch)
      call correct_upright(f, made)
      if (.not. made) return
    end do
    if (f%next%slope_p*f%sign_wanted < 0.0_wp) call reverse(f%next)
    ! Correct again, so that the determinant belongs to the tangent.
    call copy_point(f%next, f%here)
    call correct_upright(f, made)
    if (.not. made) return
    call copy_point(f%next, f%here)
    call blur(f, f%here)
  end subroutine begin

  !> Correct `here` as `next` at fixed p; the change of p is rounding error.
  subroutine correct_upright(f, made)
    type(follower_type), intent(inout) :: f
    logical, intent(out) :: made
    call correct(f%curve, f%corrector, f%here, 0.0_wp, f%next, made, .true.)
    f%next%p = f%here%p
  end subroutine correct_upright

  !> Try a step: `next` is on the curve, or the step is shortened, or the number of unknowns is
  !! changed, or the branch ends here.
  subroutine make_step(f, branch, made, ended)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(inout) :: branch
    logical, intent(out) :: made, ended
    logical :: again

    ended = .false.
    call correct(f%curve, f%corrector, f%here, f%step, f%next, made, .false.)
    if (made) then
      f%corrector%outside = .false.
      made = is_on_course(f, branch)
    end if
    if (made .and. associated(f%sized)) then
      call examine(f, again)
      if (again) then
        call change_size(f, branch)
        made = .false.
        return
      end if
    end if
    if (made) return
    f%step = 0.4_wp*f%step
    if (f%corrector%outside .and. f%step < edge_step) then
      ended = .true.
      branch%outcome = curve_unphysical
      if (abs(f%options%finish - f%here%p) < 10.0_wp*edge_step*f%corrector%p_scale) then
        call end_at_edge(f, branch)
      end if
    else if (f%step <= smallest_step) then
      ended = .true.
      branch%outcome = curve_stuck
    end if
  end subroutine make_step

  !> True if tangent, prediction and determinant show that the point is on the same branch.
  logical function is_on_course(f, branch) result(it_is)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(in) :: branch
    real(wp) :: drift, bend
    f%angle = angle_between(f%corrector, f%here, f%next)
    call compare(f%curve, f%corrector, f%here, f%step, f%next, f%off, drift, bend)
    it_is = f%step <= 1.0e3_wp*smallest_step .or. .not. ( &
            f%angle > 4.0_wp*f%options%angle .or. f%off > most_surprise &
            .or. ((bend > most_bend .or. drift > most_drift) .and. .not. leaving(f, branch)))
    if (f%step > careful_step) it_is = it_is .and. .not. sign_changes(f, branch)
  end function is_on_course

  !> Add the new point and the events before it, or end the branch with it.
  subroutine take_step(f, branch, ended)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(inout) :: branch
    logical, intent(out) :: ended
    real(wp) :: apart
    logical :: closed

    ended = .true.
    call blur(f, f%next)
    if (.not. all(abs(f%next%x) <= f%curve%largest)) then
      branch%outcome = curve_overflow
      return
    end if
    if ((f%next%p - f%options%finish)*f%sign_wanted >= 0.0_wp) then
      call finish_at(f, branch, f%options%finish, curve_completed)
      return
    end if
    if ((f%next%p - f%options%start)*f%sign_wanted < 0.0_wp) then
      call finish_at(f, branch, f%options%start, curve_returned)
      return
    end if
    apart = distance(f%corrector, f%first, f%next)
    if (apart > 3.0_wp*max(f%step, first_step)) f%away = .true.
    closed = f%away .and. apart < f%step
    f%passes = closed .and. f%leaves
    if (f%passes) f%passes = is_ahead(f%corrector, f%first, f%next)
    call record_events(f, branch, f%step)
    if (branch%n_points == f%options%max_points) return
    call branch%add(f%next, at_stop(f, f%next%p))
    ended = closed
    if (ended) call close_branch(f, branch)
    if (.not. ended .and. goes_to_and_fro(f%haunt, f%corrector, f%next)) then
      ended = .true.
      branch%outcome = curve_stuck
    end if
    if (branch%folds%n >= f%options%max_folds .and. .not. ended) then
      ended = .true.
      branch%outcome = curve_fold_limit
    end if
  end subroutine take_step

  !> Begin the next step at the end of the last one, and choose its size.
  subroutine go_on(f, branch)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(in) :: branch
    type(curve_point), pointer :: spare
    spare => f%before
    f%before => f%here
    f%here => f%next
    f%next => spare
    if (associated(f%sized)) call change_size(f, branch)
    call aim(f%corrector, f%before, f%here)
    f%step = f%step*rounded_factor(min(f%options%angle/max(f%angle, 1.0e-12_wp), &
                                       sqrt(sqrt(wanted_surprise/max(f%off, 1.0e-12_wp)))))
    if (f%here%iterations > 6) f%step = 0.6_wp*f%step
    f%step = min(f%step, f%options%max_step)
  end subroutine go_on

  !> True (`again`) if `next` needs more unknowns.
  subroutine examine(f, again)
    type(follower_type), intent(inout) :: f
    logical, intent(out) :: again
    call measure(f, f%next)
    call f%sized%choose_size(f%next%x, f%next%missed, f%own, f%rounding, again)
  end subroutine examine

  !> Truncation error of a point just corrected, if the number of unknowns is adapted.
  subroutine measure(f, point)
    type(follower_type), intent(inout) :: f
    type(curve_point), intent(inout) :: point
    real(wp) :: shift(f%curve%n + 1), short, moved, at_value, blurred, error, off
    if (.not. associated(f%sized)) return
    call f%sized%left_out(point%x, point%p, shift(:f%curve%n), short, f%own, .false.)
    call truncation_shift(f%corrector, point, shift, moved, at_value)
    point%missed = max(f%own, short*moved)
    point%truncation = max(point%missed, min(1.0_wp, short*at_value))
    f%rounding = 0.0_wp
    ! If the neglected unknowns are tiny, their effect may be rounding error.
    if (point%missed > f%options%tolerance .and. f%own <= f%options%tolerance) then
      call rounding_of(f%curve, f%corrector, point, blurred, all_patterns)
      call least_error(f%curve, f%corrector, point, error, off)
      if (moved <= max(as_rounding*blurred, off)) then
        f%rounding = max(moved, blurred)
        point%missed = max(f%own, f%rounding)
      end if
    end if
  end subroutine measure

  !> Rounding error of a point just corrected.
  subroutine blur(f, point)
    type(follower_type), intent(inout) :: f
    type(curve_point), intent(inout) :: point
    real(wp) :: moved, error, off
    call rounding_of(f%curve, f%corrector, point, moved)
    call least_error(f%curve, f%corrector, point, error, off)
    point%off = max(point%off, moved, f%rounding, off)
    point%error = max(point%error, point%off, error)
  end subroutine blur

  !> Change to the chosen number of unknowns.
  subroutine change_size(f, branch)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(in) :: branch
    real(wp) :: largest, p_scale
    integer :: i
    call f%sized%resize()
    if (f%curve%n == size(f%here%x)) return
    do i = 1, size(f%points)
      call refit(f%sized%blocks, f%curve%n, f%points(i))
    end do
    call refit(f%sized%blocks, f%curve%n, f%first)
    call refit(f%sized%blocks, f%curve%n, f%turn)
    f%stop_point%x = f%here%x
    f%stop_point%slope_x = f%here%slope_x
    largest = f%corrector%largest
    p_scale = f%corrector%p_scale
    call new_corrector(f%corrector, f%curve, f%options%tolerance, p_scale, f%here%x, &
                       f%options%atol)
    f%corrector%largest = largest
    if (branch%n_points > 1) call aim(f%corrector, f%before, f%here)
  end subroutine change_size

  !> Resize a point to n unknowns.
  pure subroutine refit(blocks, n, point)
    integer, intent(in) :: blocks, n
    type(curve_point), intent(inout) :: point
    point%x = refitted(blocks, point%x, n)
    point%slope_x = refitted(blocks, point%slope_x, n)
  end subroutine refit

  !> True on the first step from a branch point, which has no previous step to compare with.
  pure logical function leaving(f, branch)
    type(follower_type), intent(in) :: f
    type(curve_branch_type), intent(in) :: branch
    leaving = f%leaves .and. branch%n_points == 1
  end function leaving

  pure logical function sign_changes(f, branch)
    type(follower_type), intent(in) :: f
    type(curve_branch_type), intent(in) :: branch
    sign_changes = f%here%sign*f%next%sign < 0 .and. .not. leaving(f, branch)
  end function sign_changes

  !> True if a value of p is a stop.
  pure logical function at_stop(f, p)
    type(follower_type), intent(in) :: f
    real(wp), intent(in) :: p
    at_stop = any(abs(f%stops - p) <= 0.0_wp)
  end function at_stop

  !> True if the change of sign of dp/ds in the step is that at the branch point it passes.
  pure logical function turns_at_first(f)
    type(follower_type), intent(in) :: f
    turns_at_first = f%passes .and. abs(f%first%slope_p) &
                     < min(abs(f%here%slope_p), abs(f%next%slope_p))
  end function turns_at_first

  !> End at the first point. It is a fold if the branch turns back there, whether or not the last
  !! step has passed it.
  subroutine close_branch(f, branch)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(inout) :: branch
    real(wp) :: slope
    logical :: turns
    branch%outcome = curve_closed
    if (.not. f%leaves) return
    slope = merge(f%here%slope_p, f%next%slope_p, f%passes)
    call aim_straight(f%corrector)
    call turn_at(f%curve, f%corrector, f%first, first_step, 0.0_wp, f%first%p, f%first%x, &
                 branch%folds, turns, slope)
    if (turns) branch%folds%before(branch%folds%n) = branch%n_points - 1
  end subroutine close_branch

  !> Folds, branch points and stops between `here` and `next`, at distance `ahead`. The branch point
  !! at which the branch began is not recorded again when the branch closes; `close_branch` finds
  !! the fold there.
  subroutine record_events(f, branch, ahead)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(inout) :: branch
    real(wp), intent(in) :: ahead
    real(wp) :: at_fold, at_branch_point
    integer :: n_before
    at_branch_point = nowhere
    if (sign_changes(f, branch) .and. .not. f%passes) then
      call locate_branch_point(f%curve, f%corrector, f%here, ahead, branch%branch_points, &
                               at_branch_point)
    end if
    call find_fold(f, branch, ahead, at_branch_point, at_fold)
    n_before = branch%n_points
    f%places = [real(wp) ::]
    if (size(f%stops) > 0) then
      if (at_fold > 0.0_wp .and. at_fold < ahead) then
        call add_stops(f, branch, 0.0_wp, at_fold, f%here%p, branch%folds%p(branch%folds%n))
        call add_stops(f, branch, at_fold, ahead, branch%folds%p(branch%folds%n), f%next%p)
      else
        call add_stops(f, branch, 0.0_wp, ahead, f%here%p, f%next%p)
      end if
    end if
    if (at_fold < nowhere) then
      branch%folds%before(branch%folds%n) = n_before + passed(f, at_fold, ahead)
    end if
    if (at_branch_point < nowhere) then
      branch%branch_points%before(branch%branch_points%n) = n_before &
                                                            + passed(f, at_branch_point, ahead)
    end if
  end subroutine record_events

  !> Find a fold of the step: at its branch point, or elsewhere.
  subroutine find_fold(f, branch, ahead, at_branch_point, at)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(inout) :: branch
    real(wp), intent(in) :: ahead, at_branch_point
    real(wp), intent(out) :: at
    logical :: turned, again

    at = nowhere
    turned = .false.
    if (at_branch_point < nowhere) then
      associate (points => branch%branch_points)
        f%turn%p = points%p(points%n)
        f%turn%x(:) = refitted(points%blocks, points%x(:, points%n), f%curve%n)
      end associate
      call turn_at(f%curve, f%corrector, f%here, ahead, at_branch_point, f%turn%p, f%turn%x, &
                   branch%folds, turned)
    end if
    if (turned) then
      at = at_branch_point
    else if (f%here%slope_p*f%next%slope_p < 0.0_wp .and. .not. (leaving(f, branch) &
                                                                 .or. turns_at_first(f))) then
      call locate_fold(f%curve, f%corrector, f%here, ahead, branch%folds, at)
      if (f%turned .and. at < nowhere) then
        call drop_last_near(f%curve, f%corrector, f%turn, ahead, branch%folds, again)
        if (again) at = nowhere
      end if
    end if
    f%turned = turned
  end subroutine find_fold

  !> Number of points between `here` and a location of the step, which may lie slightly outside it.
  pure integer function passed(f, at, ahead)
    type(follower_type), intent(in) :: f
    real(wp), intent(in) :: at, ahead
    passed = count(f%places < at) + merge(1, 0, at > ahead) - merge(1, 0, at < 0.0_wp)
  end function passed

  !> Add the stops between two locations of the step, in the order met.
  subroutine add_stops(f, branch, from, to, p_from, p_to)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(inout) :: branch
    real(wp), intent(in) :: from, to, p_from, p_to
    real(wp) :: last, at
    logical :: made
    integer :: k
    last = p_from
    do while (branch%n_points < f%options%max_points)
      ! The next stop strictly between.
      k = minloc(abs(f%stops - last), 1, (f%stops - last)*(p_to - f%stops) > 0.0_wp)
      if (k == 0) return
      last = f%stops(k)
      call locate_value(f%curve, f%corrector, f%here, from, to, last, f%stop_point, at, made)
      if (.not. made) return
      f%places = [f%places, at]
      call measure(f, f%stop_point)
      call blur(f, f%stop_point)
      call branch%add(f%stop_point, .true.)
    end do
  end subroutine add_stops

  !> Compute the last point exactly at the end of the range of p.
  subroutine finish_at(f, branch, end, outcome)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(inout) :: branch
    real(wp), intent(in) :: end
    integer, intent(in) :: outcome
    real(wp) :: at
    logical :: made
    call locate_value(f%curve, f%corrector, f%here, 0.0_wp, f%step, end, f%next, at, made)
    branch%outcome = merge(outcome, curve_stuck, made)
    if (.not. made) return
    call measure(f, f%next)
    call blur(f, f%next)
    call record_events(f, branch, at)
    if (branch%n_points < f%options%max_points) then
      call branch%add(f%next, at_stop(f, f%next%p))
    else
      branch%outcome = curve_step_limit
    end if
  end subroutine finish_at

  !> If the equations are not defined beyond the finish: compute the last point at fixed p.
  subroutine end_at_edge(f, branch)
    type(follower_type), intent(inout) :: f
    type(curve_branch_type), intent(inout) :: branch
    type(curve_point) :: upright
    logical :: made
    call new_point(upright, f%curve%n)
    call copy_point(f%here, upright)
    upright%p = f%options%finish
    upright%slope_x = 0.0_wp
    upright%slope_p = f%sign_wanted
    call correct(f%curve, f%corrector, upright, 0.0_wp, f%next, made, .true.)
    if (.not. made) return
    branch%outcome = curve_completed
    call measure(f, f%next)
    call blur(f, f%next)
    f%next%p = f%options%finish
    if (f%next%slope_p*f%sign_wanted < 0.0_wp) call reverse(f%next)
    if (branch%n_points < f%options%max_points) then
      call branch%add(f%next, at_stop(f, f%next%p))
    end if
  end subroutine end_at_edge

  !> Between 1/2 and 2, rounded to an eighth power of 2: otherwise rounding errors in angles would
  !! accumulate along a branch and move its points between builds.
  elemental real(wp) function rounded_factor(factor)
    real(wp), intent(in) :: factor
    rounded_factor = 2.0_wp**(0.125_wp*anint(8.0_wp*log(min(2.0_wp, max(0.5_wp, factor))) &
                                             /log(2.0_wp)))
  end function rounded_factor

end module viscovib_curve_branch
