!> Options of a motion in time.
module viscovib_motion_request
  use viscovib_gathered, only: single_request
  use viscovib_kinds, only: i8, wp
  use viscovib_trajectory, only: trajectory_type
  implicit none
  private

  public :: transient_job

  !> Smallest relative error of the solution of equations.
  real(wp), parameter, public :: rounding = 1.0e-15_wp
  !> Number of steps whose errors are small together.
  real(wp), parameter :: added_up = 256.0_wp
  !> Largest number of states on the way to a last state; smallest distance in first steps.
  integer(i8), parameter :: most_looks = 24_i8, least_between = 8_i8
  !> Factor by which steps are shorter than the first from which on a stop is located: earlier
  !! runs end where steps are too large.
  integer, parameter, public :: located_from = 4
  !> Default error, relative to the size of the motion.
  real(wp), parameter, public :: part_of_size = 1.0e-10_wp

  type :: transient_job
    !> (q_1, v_1, q_2, v_2, ...) at time 0.
    real(wp), allocatable :: initial(:)
    real(wp) :: t_end = 0.0_wp
    !> Step size, shortened to fit; 0: determined by `tolerance`.
    real(wp) :: dt = 0.0_wp
    !> Allowed error of the states; 0: rounding if dt is given, else relative (`by_size`).
    real(wp) :: tolerance = 0.0_wp
    !> Index in `transient_methods`.
    integer :: method = 1
    !> Number of steps between kept states.
    integer :: save_every = 1
    !> Keep only the state at the end; or the states of the last `tail`, 0: all.
    logical :: last_only = .false.
    real(wp) :: tail = 0.0_wp
    !> Times at which states are kept, ascending; not allocated: at the ends of steps.
    real(wp), allocatable :: times(:)
    !> If every state is kept: keep so many that peaks between them are low.
    logical :: fills = .true.
    !> Allowed error relative to the largest value of each coordinate and velocity, in addition
    !! to `tolerance`, which may then be 0.
    real(wp) :: relative = 0.0_wp
    !> Events, as in `new_watch`; not allocated: none.
    real(wp), allocatable :: watched(:)
    !> Whether mount forces at the states kept, and peaks of all columns are wanted.
    logical :: wants_forces = .false., wants_peaks = .false.
    !> Point of a body whose motion is wanted, from the mass centre at rest; not allocated: none.
    real(wp), allocatable :: point(:)
    !> Whether accelerations of the states kept are wanted; whether a run without memory finds them
    !! at its `times`.
    logical :: wants_accelerations = .false., accelerates = .false.
    !> Displacement relative to the base held for all t < 0, shape (n_dof); not allocated: none.
    real(wp), allocatable :: held(:)
    !> Steps with corners of the load, as of `trajectory_type`; not allocated: by `dt`.
    real(wp), allocatable :: ends(:)
    integer(i8), allocatable :: made_by(:)
    !> What is gathered along the motion instead of its states, with its number of steps; 0: only
    !! the first number of steps of a search is wanted.
    type(single_request), allocatable :: gathers
  contains
    procedure :: allowed
    procedure :: by_size
    procedure :: wanted
    procedure :: allowed_at_stop
    procedure, nopass :: steps_between_looks
    procedure :: solved
    procedure, nopass :: solved_if_smooth
  end type transient_job

contains

  !> Allowed error of a motion that stops, relative to 1 or to its largest number.
  pure real(wp) function allowed_at_stop(self, run) result(allowed)
    class(transient_job), intent(in) :: self
    type(trajectory_type), intent(in) :: run
    real(wp) :: largest
    largest = max(1.0_wp, maxval(abs(run%states)))
    allowed = self%tolerance*largest + self%relative*max(largest, run%t_reached)
    if (self%by_size()) allowed = part_of_size*largest
  end function allowed_at_stop

  !> True if errors are relative to the size of the motion: its largest displacement for
  !! displacements, the largest of all numbers for velocities.
  pure logical function by_size(self)
    class(transient_job), intent(in) :: self
    by_size = .not. max(self%dt, self%tolerance, self%relative) > 0.0_wp
  end function by_size

  !> The smallest allowed error, for a motion of size 1; 0: rounding.
  pure real(wp) function wanted(self)
    class(transient_job), intent(in) :: self
    wanted = self%tolerance
    if (self%relative > 0.0_wp) wanted = self%relative
    if (self%tolerance > 0.0_wp) wanted = min(wanted, self%tolerance)
    if (self%by_size()) wanted = part_of_size
  end function wanted

  !> Errors allowed in each row of states of a run.
  pure function allowed(self, run)
    class(transient_job), intent(in) :: self
    type(trajectory_type), intent(in) :: run
    real(wp) :: allowed(size(run%states, 1))
    allowed = run%sizes()
    if (self%by_size()) then
      allowed(2::2) = part_of_size*maxval(allowed)
      allowed(1::2) = part_of_size*maxval(allowed(1::2))
      return
    end if
    ! A row hardly above the rounding errors of other rows is not checked separately.
    allowed = self%tolerance + self%relative*max(allowed, 1.0e-6_wp*maxval(allowed))
  end function allowed

  !> Steps between states on the way to the last states of two runs; odd, since four of the
  !! first steps may be a period.
  pure integer(i8) function steps_between_looks(n) result(between)
    integer(i8), intent(in) :: n
    between = ior(max(min(least_between, n/4), n/most_looks), 1_i8)
  end function steps_between_looks

  !> Relative error of the solution of the equations of steps, if they are cheap.
  pure real(wp) function solved(self)
    class(transient_job), intent(in) :: self
    solved = rounding
    ! If the step is searched, it alone determines the error.
    if (self%dt > 0.0_wp) solved = max(0.1_wp*self%tolerance, rounding)
  end function solved

  !> The same for the first run of a smooth motion whose step is searched, by the allowed error
  !! relative to the size of the motion: errors of n steps add up.
  pure real(wp) function solved_if_smooth(n, part) result(solved)
    integer(i8), intent(in) :: n
    real(wp), intent(in) :: part
    solved = max(0.1_wp*min(1.0_wp, added_up/real(n, wp))*part, rounding)
  end function solved_if_smooth

end module viscovib_motion_request
