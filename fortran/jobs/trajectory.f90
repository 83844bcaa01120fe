!> What a motion in time leaves behind, and how much two runs of it differ.
module viscovib_trajectory
  use viscovib_kinds, only: i8, wp
  use viscovib_simulate, only: run_coarse, run_completed, run_diverged
  use viscovib_watch, only: watch_type
  implicit none
  private

  public :: trajectory_type, change_of, compare, grown_of, hopeless, off_of, risen
  public :: rounding_of

  !> What halving the step gains of errors where steps go over kinks of forces.
  real(wp), parameter :: gain_at_kinks = 4.0_wp

  !> Relative change of what a run computes with that tells what roundings become; roundings of
  !! every step and number have their own directions, of which one run tells one; part of a motion
  !! up to which what becomes of a shake is linear.
  real(wp), parameter, public :: shaken = 0.5_wp**40
  real(wp), parameter :: safety = 8.0_wp, linear = 0.1_wp

  !> Parts of a run that are looked at; how far beyond rounding a difference is that holds what
  !! rounding adds in one of them, and by how much it may rise where nothing grows by itself.
  integer, parameter :: windows = 8
  real(wp), parameter :: beyond = 1024.0_wp, steady = 16.0_wp

  !> Relative change of the period of a motion without damping by the rounding errors of a step, in
  !! units of epsilon: a bound of what is measured.
  real(wp), parameter :: drift = 1.0_wp/64.0_wp

  !> Halvings of the step before a tolerance is given up, at least, at most, and while two runs end
  !! unlike each other.
  integer, parameter :: min_halvings = 5, max_unlike = 9
  integer, parameter, public :: max_halvings = 12

  type :: trajectory_type
    !> Times of the states kept, the start first; states, a column each.
    real(wp), allocatable :: t(:), states(:, :)
    !> As of `piece_type`; not allocated: not found.
    real(wp), allocatable :: accelerations(:, :)
    !> The state at t_reached, of all coordinates computed; not allocated: not known.
    real(wp), allocatable :: last(:)
    !> Which coordinates these are; not allocated: all.
    integer, allocatable :: places(:)
    integer :: outcome = run_completed
    real(wp) :: h = 0.0_wp, t_reached = 0.0_wp
    !> Largest change of a state kept when the step was halved; negative if the
    !! step was given.
    real(wp) :: error = -1.0_wp
    !> Relative error of what stands for kernels, which two runs may share.
    real(wp) :: represented = 0.0_wp
    !> What rounding of frequencies computed beforehand makes of states, which all runs share.
    real(wp) :: by_phases = 0.0_wp
    integer(i8) :: n_steps = 0
    !> True if rounding errors of the energy accumulate from step to step.
    logical :: keeps_energy = .false.
    !> How many times as long the steps are as those whose nodes see every thin layer of a law.
    real(wp) :: too_long = 0.0_wp
    !> Whether steps go over kinks and jumps of laws, so that errors are no power of the step.
    logical :: over_kinks = .false.
    !> Whether polynomials of steps are of the degree that their comparison takes.
    logical :: of_high_degree = .false.
    !> States on the way of a run that keeps the last alone, a column each; not allocated: none.
    real(wp), allocatable :: looks(:, :)
    !> Events that were found, if any were looked for; states are of the coordinates kept.
    type(watch_type), allocatable :: watch
    !> Estimated errors of their times and states, shape (2, n); not allocated: not estimated.
    real(wp), allocatable :: passage_errors(:, :)
    !> Where `states` are some rows of what is computed alone: which ones, and all of it.
    integer, allocatable :: rows(:)
    real(wp), allocatable :: whole(:, :)
    !> What a run needs to go on; work counted; the largest last coefficient of a step's polynomial.
    real(wp), allocatable :: memory(:)
    integer(i8) :: counted = 0
    real(wp) :: resolution = 0.0_wp
  contains
    procedure :: thin
    procedure :: row_of
    procedure :: sizes
  end type trajectory_type

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
    ! Where a coordinate passes its bound it changes faster than any time is known.
    if (fine%outcome == run_diverged .and. fine%t(n) >= fine%t_reached) n = n - 1
    if (n > 0) change = max(change, maxval(abs(fine%states(:, :n) - coarse%states(:, :n))))
  end function change_of

  !> By how much two runs differ, of each row of states: where one stops by all of it.
  pure function off_of(run, fine) result(off)
    type(trajectory_type), intent(in) :: run, fine
    real(wp) :: off(size(fine%states, 1))
    if (run%outcome == run_completed .and. fine%outcome == run_completed) then
      off = maxval(abs(fine%states - run%states), 2)
    else
      off = change_of(run, fine)
    end if
  end function off_of

  !> What roundings become along a run, of each row of states where both are whole. Those of numbers
  !! of a system are the same in runs in any steps, whose difference does not tell them, and of
  !! those of steps one difference may be small by chance. `other`: the run in the same steps of a
  !! system of which numbers, start and arguments of forces are other by `shaken`, small enough for
  !! what becomes of it to be linear.
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
    ! What has become as large as the motion says nothing of what is smaller.
    where (grown <= linear*run%sizes()) grown = part*grown
  end function grown_of

  !> What the difference of two runs tells that roundings become; huge: it does not tell it. Errors
  !! of steps and roundings grow alike: where in every part of a run two differ by far more than
  !! rounding, so do their ends by far more than what becomes of it. Where their difference hardly
  !! rises from any part to a later one, roundings of numbers rise as much at most.
  pure real(wp) function risen(coarse, fine)
    type(trajectory_type), intent(in) :: coarse, fine
    risen = huge(1.0_wp)
    if (coarse%outcome /= run_completed .or. fine%outcome /= run_completed) return
    if (allocated(coarse%looks) .and. allocated(fine%looks)) then
      risen = rise_of(coarse%looks, fine%looks)
    else
      risen = rise_of(coarse%states, fine%states)
    end if
    if (risen < huge(1.0_wp)) risen = safety*epsilon(1.0_wp)*risen*maxval(abs(fine%states))
  end function risen

  !> By how much the difference of states of two runs, a column each, rises at most; huge: by more
  !! than it may.
  pure real(wp) function rise_of(coarse, fine) result(rise)
    real(wp), intent(in) :: coarse(:, :), fine(:, :)
    real(wp) :: off, rounding, least, most
    logical :: is_beyond
    integer :: i, k, n
    rise = huge(1.0_wp)
    n = size(fine, 2)
    if (n <= 2*windows .or. size(coarse, 2) /= n) return
    rise = 0.0_wp
    do i = 1, size(fine, 1)
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
      rise = max(rise, most)
      if (most > steady) rise = huge(1.0_wp)
    end do
  end function rise_of

  !> Rounding error of a motion: of its states, of sums of exponentials, of its phases, and the
  !! change of the motion within the rounding errors of times and frequencies.
  pure real(wp) function rounding_of(run) result(rounding)
    type(trajectory_type), intent(in) :: run
    real(wp) :: pace, of_times
    integer :: i
    rounding = max(4.0_wp*epsilon(1.0_wp), run%represented)*maxval(abs(run%states))
    if (run%outcome /= run_diverged) rounding = max(rounding, run%by_phases)
    if (run%outcome /= run_completed) return
    of_times = epsilon(1.0_wp)
    if (run%keeps_energy) of_times = of_times*max(1.0_wp, run%n_steps*drift)
    do i = 1, size(run%t)
      pace = maxval(abs(run%states(2::2, i)))
      if (i > 1) pace = max(pace, maxval(abs(run%states(:, i) - run%states(:, i - 1))) &
                            /(run%t(i) - run%t(i - 1)))
      rounding = max(rounding, of_times*(pace*run%t(i)))
    end do
  end function rounding_of

  !> Where steps go over kinks two runs may be wrong alike: what a kink spoils in a step depends on
  !! where in it it is, and has either sign. Then the run before, in steps twice as long, differs
  !! from both, and its difference from the coarse one counts, too.
  pure subroutine compare(coarse, fine, allowed, lost, change, met)
    type(trajectory_type), intent(in) :: coarse, fine
    !> Errors allowed in each row of states.
    real(wp), intent(in) :: allowed(:)
    !> What the last differences tell of the run to come, of each row; not allocated: none yet.
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

  !> Whether halving is vain, for chaos or rounding: two gain less than a digit. That two runs
  !! end unlike each other is no measure of what a halving gains.
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

  !> The run with one in k of its states.
  subroutine thin(self, k, some)
    class(trajectory_type), intent(in) :: self
    integer, intent(in) :: k
    type(trajectory_type), intent(out) :: some
    select type (self)
    type is (trajectory_type)
      some = self
    end select
    if (k == 1) return
    some%t = self%t(::k)
    some%states = self%states(:, ::k)
    if (allocated(self%whole)) some%whole = self%whole(:, ::k)
  end subroutine thin

  !> Largest value of each row of states, on the way too.
  pure function sizes(self)
    class(trajectory_type), intent(in) :: self
    real(wp) :: sizes(size(self%states, 1))
    sizes = maxval(abs(self%states), 2)
    if (allocated(self%looks)) sizes = max(sizes, maxval(abs(self%looks), 2))
  end function sizes

  !> Row of the states that holds a coordinate; its velocity is the next.
  pure integer function row_of(self, coordinate) result(row)
    class(trajectory_type), intent(in) :: self
    integer, intent(in) :: coordinate
    row = coordinate
    if (allocated(self%places)) row = findloc(self%places, coordinate, 1)
    row = 2*row - 1
  end function row_of

end module viscovib_trajectory
