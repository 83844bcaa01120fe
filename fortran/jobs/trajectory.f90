!> What a motion in time leaves behind, and how much two runs of it differ.
module viscovib_trajectory
  use viscovib_kinds, only: i8, wp
  use viscovib_reduction, only: state_mask
  use viscovib_simulate, only: run_coarse, run_completed, run_diverged
  use viscovib_watch, only: watch_type
  implicit none
  private

  public :: trajectory_type, change_of, compare, grown_of, hopeless, off_of

  !> What halving the step gains of errors where steps go over kinks of forces.
  real(wp), parameter :: gain_at_kinks = 4.0_wp

  !> Relative change of the numbers of a system that tells what their roundings become.
  real(wp), parameter, public :: shaken = 0.5_wp**40

  !> Halvings of the step before a tolerance is given up, and while two runs end unlike each
  !! other.
  integer, parameter :: min_halvings = 5, max_unlike = 9

  type :: trajectory_type
    !> Times of the states kept, the start first; states, a column each.
    real(wp), allocatable :: t(:), states(:, :)
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
    integer(i8) :: n_steps = 0
    !> How many times as long the steps are as those whose nodes see every thin layer of a law.
    real(wp) :: too_long = 0.0_wp
    !> Whether steps go over kinks and jumps of laws, so that errors are no power of the step.
    logical :: over_kinks = .false.
    !> States on the way of a run that keeps the last alone, a column each; not allocated: none.
    real(wp), allocatable :: looks(:, :)
    !> Events that were found, if any were looked for; states are of the coordinates kept.
    type(watch_type), allocatable :: watch
  contains
    procedure :: spread_out
    procedure :: row_of
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

  !> What roundings of a system's numbers become along a run, of each row of states. They are the
  !! same in runs in any steps, whose difference does not tell them. `other`: the run of numbers
  !! that are other by `shaken`, small enough for what becomes of it to be linear.
  pure function grown_of(run, other) result(grown)
    type(trajectory_type), intent(in) :: run, other
    real(wp) :: grown(size(run%states, 1))
    grown = huge(1.0_wp)
    if (other%outcome /= run%outcome) return
    grown = epsilon(1.0_wp)/shaken*maxval(abs(other%states - run%states), 2)
  end function grown_of

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
      hopeless = changes(n) > 0.1_wp*changes(n - 2)
    else
      hopeless = n >= max_unlike
    end if
  end function hopeless

  !> From the coordinates computed to all, the others at rest.
  subroutine spread_out(self, moved)
    class(trajectory_type), intent(inout) :: self
    !> Which were computed, shape (n_dof).
    logical, intent(in) :: moved(:)
    real(wp), allocatable :: states(:, :)
    integer :: i
    allocate (states(2*size(moved), size(self%t)))
    states = 0.0_wp
    states(pack([(i, i=1, size(states, 1))], state_mask(moved)), :) = self%states
    if (allocated(self%last)) then
      self%last = unpack(self%last, state_mask(moved), spread(0.0_wp, 1, size(states, 1)))
    end if
    call move_alloc(states, self%states)
  end subroutine spread_out

  !> Row of the states that holds a coordinate; its velocity is the next.
  pure integer function row_of(self, coordinate) result(row)
    class(trajectory_type), intent(in) :: self
    integer, intent(in) :: coordinate
    row = coordinate
    if (allocated(self%places)) row = findloc(self%places, coordinate, 1)
    row = 2*row - 1
  end function row_of

end module viscovib_trajectory
