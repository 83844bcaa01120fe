! Optimize: -O1
!> Results of a motion in time, and differences of two runs.
module viscovib_trajectory
  use viscovib_gathered, only: gathered_type
  use viscovib_kinds, only: i8, wp
  use viscovib_time_run, only: run_coarse, run_completed, run_diverged
  use viscovib_watch, only: watch_type
  implicit none
  private

  public :: trajectory_type, change_of, compare, grown_of, hopeless, off_of, risen
  public :: rounding_of

  !> Reduction of errors by halving the step if steps cross kinks of forces.
  real(wp), parameter :: gain_at_kinks = 4.0_wp

  !> Relative change of the numbers of a run that determines amplified rounding errors; safety
  !! factor, since roundings have many directions and one run tests one of them; relative size up to
  !! which the effect of the change is linear.
  real(wp), parameter, public :: shaken = 0.5_wp**40
  real(wp), parameter :: safety = 8.0_wp, linear = 0.1_wp

  !> Number of parts of a run; factor above rounding at which a difference includes the rounding
  !! errors of a part; largest rise of a difference without amplification.
  integer, parameter :: windows = 8
  real(wp), parameter :: beyond = 1024.0_wp, steady = 16.0_wp
  !> Part of the allowed error below which a difference of two runs shows that rounding errors are
  !! not amplified beyond it.
  real(wp), parameter :: far_below = 1.0_wp/1024.0_wp

  !> Relative change of the period of an undamped motion by the rounding errors of a step, in
  !! units of epsilon: a bound of measured values.
  real(wp), parameter :: drift = 1.0_wp/64.0_wp

  !> Halvings of the step before a tolerance is given up: smallest and largest number, and largest
  !! number while two runs end differently.
  integer, parameter :: min_halvings = 5, max_unlike = 9
  integer, parameter, public :: max_halvings = 12

  type :: trajectory_type
    !> Times of the states kept, the start first; states, a column each.
    real(wp), allocatable :: t(:), states(:, :)
    !> As of `piece_type`; not allocated: not found.
    real(wp), allocatable :: accelerations(:, :)
    !> The state at t_reached, of all coordinates computed; not allocated: not known.
    real(wp), allocatable :: last(:)
    !> Indices of these coordinates; not allocated: all.
    integer, allocatable :: places(:)
    integer :: outcome = run_completed
    real(wp) :: h = 0.0_wp, t_reached = 0.0_wp
    !> Largest change of a state kept when the step was halved; negative if the
    !! step was given.
    real(wp) :: error = -1.0_wp
    !> Relative error of the representation of kernels, which two runs may share.
    real(wp) :: represented = 0.0_wp
    !> Error of states by rounding of precomputed frequencies, which all runs share.
    real(wp) :: by_phases = 0.0_wp
    integer(i8) :: n_steps = 0
    !> Ends of pieces with equal steps, and the number of steps at each; not allocated: all steps
    !! are equal.
    real(wp), allocatable :: ends(:)
    integer(i8), allocatable :: made_by(:)
    !> True if rounding errors of the energy accumulate from step to step.
    logical :: keeps_energy = .false.
    !> Length of the steps relative to that at which nodes resolve every thin layer of a law.
    real(wp) :: too_long = 0.0_wp
    !> True if steps cross kinks and jumps of laws, so that errors are no power of the step.
    logical :: over_kinks = .false.
    !> Relative tolerance of the equations of its steps.
    real(wp) :: solved = 0.0_wp
    !> States on the way of a run that keeps only the last one, a column each; not allocated: none.
    real(wp), allocatable :: looks(:, :)
    !> Events found, if any were requested; their states are those of the coordinates kept.
    type(watch_type), allocatable :: watch
    !> Estimated errors of their times and states, shape (2, n); not allocated: not estimated.
    real(wp), allocatable :: event_point_errors(:, :)
    !> If `states` are only some rows of the computed states: their indices, and all rows.
    integer, allocatable :: rows(:)
    real(wp), allocatable :: whole(:, :)
    !> Data to continue the run, their kinds if requested, and the shortest step for which kernels
    !! are fitted, 0: its steps; counted work; the largest last coefficient of a step's polynomial.
    real(wp), allocatable :: memory(:)
    integer, allocatable :: kinds(:)
    real(wp) :: shortest = 0.0_wp
    integer(i8) :: counted = 0
    real(wp) :: resolution = 0.0_wp
    !> What was gathered along the motion; not allocated: not requested.
    type(gathered_type), allocatable :: gathered
  contains
    procedure :: thin
    procedure :: become
    procedure :: row_of
    procedure :: sizes
  end type trajectory_type

  !> States of a run, as in it.
  type :: many_states
    real(wp), allocatable :: t(:), states(:, :), whole(:, :)
  end type many_states

contains

  !> Largest difference of the states of two runs, and of the times at which they stop.
  pure real(wp) function change_of(coarse, fine) result(change)
    type(trajectory_type), intent(in) :: coarse, fine
    integer :: n
    change = huge(1.0_wp)
    n = min(size(coarse%t), size(fine%t))
    if (coarse%outcome /= fine%outcome .or. fine%outcome == run_coarse) return
    if (max(size(coarse%t), size(fine%t)) > n + merge(0, 1, fine%outcome == run_completed)) return
    change = abs(fine%t_reached - coarse%t_reached)
    ! A coordinate at its bound changes faster than the accuracy of the time.
    if (fine%outcome == run_diverged .and. fine%t(n) >= fine%t_reached) n = n - 1
    if (n > 0) change = max(change, maxval(abs(fine%states(:, :n) - coarse%states(:, :n))))
  end function change_of

  !> Difference of two runs, for each row of states; if one stops, from all rows together.
  pure function off_of(run, fine) result(off)
    type(trajectory_type), intent(in) :: run, fine
    real(wp) :: off(size(fine%states, 1))
    if (run%outcome == run_completed .and. fine%outcome == run_completed) then
      off = maxval(abs(fine%states - run%states), 2)
    else
      off = change_of(run, fine)
    end if
  end function off_of

  !> Amplified rounding errors along a run, for each row of states if both runs are complete.
  !! Rounding errors of the numbers of a system are the same for all step sizes, so that differences
  !! of runs do not show them, and a single difference of the rounding errors of steps may be small
  !! by chance. `other`: the run with the same steps of a system whose numbers, start and arguments
  !! of forces are changed by `shaken`, small enough for a linear effect.
  pure function grown_of(run, other) result(grown)
    type(trajectory_type), intent(in) :: run, other
    real(wp) :: grown(size(run%states, 1))
    real(wp), parameter :: part = safety*epsilon(1.0_wp)/shaken
    grown = huge(1.0_wp)
    if (other%outcome /= run%outcome) return
    if (run%outcome /= run_completed) then
      grown = change_of(run, other)
      if (all(grown < huge(1.0_wp))) grown = part*grown
      return
    end if
    grown = maxval(abs(other%states - run%states), 2)
    ! A change as large as the motion does not determine the effect of a smaller one.
    where (grown <= linear*run%sizes()) grown = part*grown
  end function grown_of

  !> Amplified rounding errors as determined by the difference of two runs; huge if it does not
  !! determine them. Errors of steps and rounding errors are amplified alike: if two runs differ by
  !! far more than rounding in every part, they also do so at their ends. If their difference
  !! hardly rises from any part to a later one, rounding errors of numbers rise at most as much.
  !! If it is far below the allowed errors, so are amplified rounding errors.
  pure real(wp) function risen(coarse, fine, allowed)
    type(trajectory_type), intent(in) :: coarse, fine
    !> For each row of states.
    real(wp), intent(in) :: allowed(:)
    real(wp) :: unit
    risen = huge(1.0_wp)
    if (coarse%outcome /= run_completed .or. fine%outcome /= run_completed) return
    unit = epsilon(1.0_wp)*maxval(abs(fine%states))
    if (allocated(coarse%looks) .and. allocated(fine%looks)) then
      risen = rise_of(coarse%looks, fine%looks, unit, far_below*allowed)
    else
      risen = rise_of(coarse%states, fine%states, unit, far_below*allowed)
    end if
    if (risen < huge(1.0_wp)) risen = safety*risen
  end function risen

  !> Largest rise of the difference of states of two runs, a column each, in units of rounding
  !! errors, or the difference of rows in which it is negligible; huge if the rise exceeds the
  !! limit.
  pure real(wp) function rise_of(coarse, fine, unit, negligible) result(rise)
    real(wp), intent(in) :: coarse(:, :), fine(:, :), unit, negligible(:)
    real(wp) :: off, rounding, least, most
    logical :: is_beyond
    integer :: i, k, n
    rise = huge(1.0_wp)
    n = size(fine, 2)
    if (size(coarse, 2) /= n) return
    rise = 0.0_wp
    do i = 1, size(fine, 1)
      off = maxval(abs(fine(i, :) - coarse(i, :)))
      if (n >= windows .and. off <= negligible(i)) then
        rise = max(rise, off)
        cycle
      end if
      if (n < 2*windows) then
        rise = huge(1.0_wp)
        return
      end if
      rounding = epsilon(1.0_wp)*maxval(abs(fine(i, :)))
      least = huge(1.0_wp)
      most = 0.0_wp
      is_beyond = .true.
      do k = 0, windows - 1
        associate (here => k*n/windows + 1, there => (k + 1)*n/windows)
          off = maxval(abs(fine(i, here:there) - coarse(i, here:there)))
        end associate
        least = min(least, max(off, rounding, 1.0e-300_wp))
        most = max(most, off/least)
        is_beyond = is_beyond .and. off >= beyond*rounding
      end do
      if (is_beyond) cycle
      rise = max(rise, most*unit)
      if (most > steady) rise = huge(1.0_wp)
    end do
  end function rise_of

  !> Rounding error of a motion: of its states, of sums of exponentials, of its phases, and the
  !! change of the motion within the rounding errors of times and frequencies.
  pure real(wp) function rounding_of(run) result(rounding)
    type(trajectory_type), intent(in) :: run
    real(wp) :: pace, of_times
    integer :: i, k
    rounding = max(4.0_wp*epsilon(1.0_wp), run%represented)*maxval(abs(run%states))
    if (run%outcome /= run_diverged) rounding = max(rounding, run%by_phases)
    if (run%outcome /= run_completed) return
    of_times = epsilon(1.0_wp)
    if (run%keeps_energy) of_times = of_times*max(1.0_wp, run%n_steps*drift)
    do i = 1, size(run%t)
      pace = 0.0_wp
      if (i > 1) then
        do k = 1, size(run%states, 1)
          pace = max(pace, abs(run%states(k, i) - run%states(k, i - 1)))
        end do
        pace = pace/(run%t(i) - run%t(i - 1))
      end if
      do k = 2, size(run%states, 1), 2
        pace = max(pace, abs(run%states(k, i)))
      end do
      rounding = max(rounding, of_times*(pace*run%t(i)))
    end do
  end function rounding_of

  !> If steps cross kinks two runs may have the same error: the error of a step depends on the
  !! position of the kink in it, and has either sign. The previous run, with steps twice as long,
  !! differs from both, so its difference from the coarse one counts, too.
  pure subroutine compare(coarse, fine, allowed, lost, change, met)
    type(trajectory_type), intent(in) :: coarse, fine
    !> Errors allowed in each row of states.
    real(wp), intent(in) :: allowed(:)
    !> Error of the next run from the last differences, for each row; not allocated: none yet.
    real(wp), allocatable, intent(inout) :: lost(:)
    real(wp), intent(inout) :: change
    logical, intent(inout) :: met
    met = met .and. allocated(lost)
    if (allocated(lost)) then
      met = met .and. all(lost <= allowed)
      change = max(change, maxval(lost))
    end if
    lost = off_of(coarse, fine)/gain_at_kinks
  end subroutine compare

  !> True if halving is useless, because of chaos or rounding: two halvings gain less than a digit.
  !! Different outcomes of two runs do not measure the gain of a halving.
  pure logical function hopeless(changes)
    real(wp), intent(in) :: changes(:)
    integer :: n
    n = size(changes)
    hopeless = .false.
    if (n < min_halvings) return
    if (changes(n) < huge(1.0_wp)) then
      hopeless = n >= max_halvings .or. changes(n) > 0.1_wp*changes(n - 2)
    else
      hopeless = n >= max_unlike
    end if
  end function hopeless

  !> The run with every k-th state.
  subroutine thin(self, k, some)
    class(trajectory_type), intent(inout) :: self
    integer, intent(in) :: k
    type(trajectory_type), intent(out) :: some
    type(many_states) :: all
    call set_aside(self, all)
    select type (self)
    type is (trajectory_type)
      some = self
    end select
    some%t = all%t(::k)
    some%states = all%states(:, ::k)
    if (allocated(all%whole)) some%whole = all%whole(:, ::k)
    call take_back(self, all)
  end subroutine thin

  !> Make it another run, which then has no states.
  subroutine become(self, other)
    class(trajectory_type), intent(out) :: self
    type(trajectory_type), intent(inout) :: other
    type(many_states) :: all
    call set_aside(other, all)
    select type (self)
    type is (trajectory_type)
      self = other
    end select
    call take_back(self, all)
  end subroutine become

  !> Move the states away, which are many, so that the rest can be copied.
  subroutine set_aside(run, all)
    class(trajectory_type), intent(inout) :: run
    type(many_states), intent(out) :: all
    call move_alloc(run%t, all%t)
    call move_alloc(run%states, all%states)
    call move_alloc(run%whole, all%whole)
  end subroutine set_aside

  subroutine take_back(run, all)
    class(trajectory_type), intent(inout) :: run
    type(many_states), intent(inout) :: all
    call move_alloc(all%t, run%t)
    call move_alloc(all%states, run%states)
    call move_alloc(all%whole, run%whole)
  end subroutine take_back

  !> Largest absolute value of each row of states, including states on the way.
  pure function sizes(self)
    class(trajectory_type), intent(in) :: self
    real(wp) :: sizes(size(self%states, 1))
    sizes = maxval(abs(self%states), 2)
    if (allocated(self%looks)) sizes = max(sizes, maxval(abs(self%looks), 2))
  end function sizes

  !> Row of the states with a coordinate; its velocity is the next row.
  pure integer function row_of(self, coordinate) result(row)
    class(trajectory_type), intent(in) :: self
    integer, intent(in) :: coordinate
    row = coordinate
    if (allocated(self%places)) row = findloc(self%places, coordinate, 1)
    row = 2*row - 1
  end function row_of

end module viscovib_trajectory
