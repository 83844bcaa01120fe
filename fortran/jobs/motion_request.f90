!> What a motion in time is asked for.
module viscovib_motion_request
  use viscovib_kinds, only: i8, wp
  use viscovib_trajectory, only: trajectory_type
  implicit none
  private

  public :: transient_job

  real(wp), parameter :: rounding = 1.0e-15_wp
  !> Looks on the way to a last state, first steps between two.
  integer(i8), parameter :: most_looks = 24_i8, least_between = 8_i8
  !> By what steps are shorter than the first from which on a motion that stops is followed to
  !! its stop: those before are given up where they are too large.
  integer, parameter, public :: located_from = 4
  !> Error that is wanted if none is given, as a part of the size of the motion.
  real(wp), parameter, public :: part_of_size = 1.0e-10_wp

  type :: transient_job
    !> (q_1, v_1, q_2, v_2, ...) at time 0.
    real(wp), allocatable :: initial(:)
    real(wp) :: t_end = 0.0_wp
    !> Step, shortened to fit; 0: found by `tolerance`.
    real(wp) :: dt = 0.0_wp
    !> Wanted error of the states; 0: to rounding where dt is given, else relative (`by_size`).
    real(wp) :: tolerance = 0.0_wp
    !> Place in `transient_methods`.
    integer :: method = 1
    !> Steps between states kept.
    integer :: save_every = 1
    !> Keep the state at the end alone; those of so long a time at the end, 0: all.
    logical :: last_only = .false.
    real(wp) :: tail = 0.0_wp
    !> Times at which states are kept, ascending; not allocated: at the ends of steps.
    real(wp), allocatable :: times(:)
    !> Where every state is kept: so many that peaks between them are low.
    logical :: fills = .true.
    !> Wanted error relative to the largest value of each coordinate and velocity, on top
    !! of `tolerance`, which may be 0 then.
    real(wp) :: relative = 0.0_wp
    !> Events to look for, as `new_watch` takes them; not allocated: none.
    real(wp), allocatable :: watched(:)
    !> Whether accelerations of the states kept are wanted; whether a run without memory finds them
    !! at its `times`.
    logical :: wants_accelerations = .false., accelerates = .false.
    !> Displacement relative to the base held for all t < 0, shape (n_dof); not allocated: none.
    real(wp), allocatable :: held(:)
  contains
    procedure :: allowed
    procedure :: by_size
    procedure :: wanted
    procedure :: allowed_at_stop
    procedure, nopass :: steps_between_looks
    procedure :: solved
  end type transient_job

contains

  !> Largest error allowed of a motion that stops: absolute of 1 or of a state that runs away.
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

  !> The smallest error that is wanted, of a motion of size 1; 0: to rounding.
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
    ! A row that is hardly more than rounding of the others is not judged by itself.
    allowed = self%tolerance + self%relative*max(allowed, 1.0e-6_wp*maxval(allowed))
  end function allowed

  !> Steps between states that are looked at on the way to the last of two runs; odd: four of the
  !! first steps may be a period.
  pure integer(i8) function steps_between_looks(n) result(between)
    integer(i8), intent(in) :: n
    between = ior(max(min(least_between, n/4), n/most_looks), 1_i8)
  end function steps_between_looks

  !> Relative error with which equations of steps are solved where they are cheap.
  pure real(wp) function solved(self)
    class(transient_job), intent(in) :: self
    solved = rounding
    ! Where the step is found it alone shall decide the error.
    if (self%dt > 0.0_wp) solved = max(0.1_wp*self%tolerance, rounding)
  end function solved

end module viscovib_motion_request
