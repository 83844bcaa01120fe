! Optimize: -O2
!> The abstract stepper: one trajectory in fixed steps, for any method.
module viscovib_stepper
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: stepper_type

  type, abstract :: stepper_type
    real(wp) :: h = 0.0_wp
    !> The state, shape (n_dof).
    real(wp), allocatable :: q(:), v(:)
    !> Time since the present piece of the load began, at the start of the step.
    real(wp) :: since = 0.0_wp
    !> True if steps may succeed and still be wrong for stiff motions.
    logical :: explicit = .false.
    !> True for each steep law whose force the last step represents as a polynomial; not allocated:
    !! the step does not solve for steep laws.
    logical, allocatable :: resolved(:)
    !> Total number of evaluations of a block of trajectories.
    integer(i8) :: n_evaluations = 0
  contains
    procedure(step_interface), deferred :: step
    procedure(arrive_interface), deferred :: arrive
    procedure(change_interface), deferred :: change_step
    procedure(put_interface), deferred :: put
    procedure(size_interface), deferred :: memory_size
    procedure(size_interface), deferred :: n_of_state
    procedure(save_interface), deferred :: save_memory
    procedure(load_interface), deferred :: load_memory
    procedure :: least_margin
    procedure(trace_interface), deferred :: trace
    procedure :: look_ahead
  end type stepper_type

  abstract interface

    !> One step. `made` is false, and the state is unchanged, if it fails: the
    !! step is too large.
    subroutine step_interface(self, system, made)
      import :: driven_system_type, stepper_type
      class(stepper_type), intent(inout) :: self
      class(driven_system_type), intent(in) :: system
      logical, intent(out) :: made
    end subroutine step_interface

    !> Set the state at the end of a failed step, from another method.
    subroutine arrive_interface(self, q, v)
      import :: stepper_type, wp
      class(stepper_type), intent(inout) :: self
      real(wp), intent(in) :: q(:), v(:)
    end subroutine arrive_interface

    !> Continue from the present state with another step, as from a start; a
    !! copy of a stepper must be given its step in this way before it is used.
    subroutine change_interface(self, system, h)
      import :: driven_system_type, stepper_type, wp
      class(stepper_type), intent(inout) :: self
      class(driven_system_type), intent(in) :: system
      real(wp), intent(in) :: h
    end subroutine change_interface

    !> Continue from another state at the same time, as after an impact.
    subroutine put_interface(self, q, v)
      import :: stepper_type, wp
      class(stepper_type), intent(inout) :: self
      real(wp), intent(in) :: q(:), v(:)
    end subroutine put_interface

    !> Length of the data that a run needs to continue bit for bit; number of these that belong to
    !! the state, which are the first ones.
    pure integer function size_interface(self)
      import :: stepper_type
      class(stepper_type), intent(in) :: self
    end function size_interface

    pure function save_interface(self) result(memory)
      import :: stepper_type, wp
      class(stepper_type), intent(in) :: self
      real(wp) :: memory(self%memory_size())
    end function save_interface

    !> The motion inside the last step.
    subroutine trace_interface(self, system, memory, path)
      import :: driven_system_type, step_path, stepper_type, wp
      class(stepper_type), intent(in) :: self
      class(driven_system_type), intent(in) :: system
      !> The data saved before the step.
      real(wp), intent(in) :: memory(:)
      !> Everything except its start time is set.
      type(step_path), intent(inout) :: path
    end subroutine trace_interface

    subroutine load_interface(self, memory)
      import :: stepper_type, wp
      class(stepper_type), intent(inout) :: self
      real(wp), intent(in) :: memory(:)
    end subroutine load_interface

  end interface

contains

  !> Lower bound of the system's margin inside the last step, as far as its method provides it:
  !! by default at both ends.
  real(wp) function least_margin(self, system, q_before, v_before)
    class(stepper_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    !> State before the step, shape (n_dof).
    real(wp), intent(in) :: q_before(:), v_before(:)
    real(wp) :: ends(n_lanes, size(self%q))
    ends = spread(self%q, 1, n_lanes)
    ends(2, :) = q_before
    ends(3, :) = self%q - self%h*self%v
    ends(4, :) = q_before + self%h*v_before
    least_margin = minval(system%margin(ends))
  end function least_margin

  !> State after a time h by one step of that length, which has the order of the
  !! method, unlike interpolation inside a step; `self` is unchanged.
  subroutine look_ahead(self, system, h, q, v, made)
    class(stepper_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: h
    real(wp), intent(out) :: q(:), v(:)
    logical, intent(out) :: made
    class(stepper_type), allocatable :: scout
    allocate (scout, source=self)
    call scout%change_step(system, h)
    call scout%step(system, made)
    q = scout%q
    v = scout%v
  end subroutine look_ahead

end module viscovib_stepper
