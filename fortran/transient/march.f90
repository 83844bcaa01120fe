!> Common interface of runs of motions with memory, for any equations of a step.
module viscovib_march
  use viscovib_base_motion, only: base_motion_type
  use viscovib_kinds, only: i8, wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_time_load, only: time_load_type
  implicit none
  private

  public :: march_type, inside_each

  !> Reason why a run cannot start.
  integer, parameter, public :: begun = 0, no_exponentials = 1, step_too_large = 2, no_integral = 3

  type, abstract :: march_type
    real(wp) :: h = 0.0_wp
    !> The last step failed only because it may have passed an escape to infinity;
    !! the next step is accepted in spite of that.
    logical :: doubtful = .false., trusted = .false.
    !> True if a run ends where a step is too large, without a search for the stop inside it.
    logical :: gives_up = .false.
  contains
    procedure(step_interface), deferred :: step
    procedure(enter_interface), deferred :: enter
    procedure(take_up_interface), deferred :: take_up
    procedure(enter_interface), deferred :: change_step
    procedure(kick_interface), deferred :: kick
    procedure(state_interface), deferred :: get_state
    procedure(observe_interface), deferred :: observe
    procedure :: read_by_laws => read_all
    procedure :: n_read => n_all
    procedure(inside_interface), deferred :: inside
    procedure :: inside_part => inside_each
    procedure(real_interface), deferred :: furthest
    procedure(real_interface), deferred :: resolution
    procedure :: phase_errors => no_errors
    procedure(size_interface), deferred :: n_observed
    procedure(size_interface), deferred :: memory_size
    procedure(save_interface), deferred :: save_memory
    procedure(load_interface), deferred :: load_memory
    procedure(sharpen_interface), deferred :: sharpen
  end type march_type

  abstract interface

    !> Solve the equations of every step to rounding from now on.
    subroutine sharpen_interface(self)
      import :: march_type
      class(march_type), intent(inout) :: self
    end subroutine sharpen_interface

    !> One step to time `until`; `made` is false, and the state is unchanged, if its equations do
    !! not converge.
    subroutine step_interface(self, system, load, n_before, until, made)
      import :: i8, march_type, oscillator_type, time_load_type, wp
      class(march_type), intent(inout) :: self
      class(oscillator_type), intent(in) :: system
      type(time_load_type), intent(in) :: load
      !> Number of steps before.
      integer(i8), intent(in) :: n_before
      real(wp), intent(in) :: until
      logical, intent(out) :: made
    end subroutine step_interface

    !> Set the step length to h from time t on; `enter`: a piece of the mesh begins there, the load
    !! has a corner. `made` is false if such steps are too large.
    subroutine enter_interface(self, system, load, t, h, made)
      import :: march_type, oscillator_type, time_load_type, wp
      class(march_type), intent(inout) :: self
      class(oscillator_type), intent(in) :: system
      type(time_load_type), intent(in) :: load
      real(wp), intent(in) :: t, h
      logical, intent(out) :: made
    end subroutine enter_interface

    !> Continue at time t from a state, relative to the base, under another load; the memory
    !! is kept. `made` is false if steps are too large.
    subroutine take_up_interface(self, system, load, t, u, v, made)
      import :: march_type, oscillator_type, time_load_type, wp
      class(march_type), intent(inout) :: self
      class(oscillator_type), intent(in) :: system
      type(time_load_type), intent(in) :: load
      real(wp), intent(in) :: t, u(:), v(:)
      logical, intent(out) :: made
    end subroutine take_up_interface

    !> Add a jump to the state relative to the base, which has a corner.
    subroutine kick_interface(self, base, displacement, velocity)
      import :: base_motion_type, march_type, wp
      class(march_type), intent(inout) :: self
      type(base_motion_type), intent(in) :: base
      !> Jumps of the base, old minus new value, one for each base displacement.
      real(wp), intent(in) :: displacement(:), velocity(:)
    end subroutine kick_interface

    !> State: coordinates, or modes, and their velocities.
    pure subroutine state_interface(self, u, v)
      import :: march_type, wp
      class(march_type), intent(in) :: self
      real(wp), allocatable, intent(out) :: u(:), v(:)
    end subroutine state_interface

    !> The observed part of the state, shape (n_observed).
    subroutine observe_interface(self, u, v)
      import :: march_type, wp
      class(march_type), intent(in) :: self
      real(wp), intent(out) :: u(:), v(:)
    end subroutine observe_interface

    !> The same inside the last step.
    subroutine inside_interface(self, theta, u, v)
      import :: march_type, wp
      class(march_type), intent(inout) :: self
      !> In [0, 1], 1 at the end of the last step.
      real(wp), intent(in) :: theta
      real(wp), intent(out) :: u(:), v(:)
    end subroutine inside_interface

    !> `furthest`: the largest displacement so far, measured like the state; `resolution`: the
    !! largest last Legendre coefficient of a displacement, relative to its largest value.
    pure real(wp) function real_interface(self)
      import :: march_type, wp
      class(march_type), intent(in) :: self
    end function real_interface

    !> Number of observed coordinates; length of the data that a run needs to continue bit for bit.
    pure integer function size_interface(self)
      import :: march_type
      class(march_type), intent(in) :: self
    end function size_interface

    function save_interface(self) result(memory)
      import :: march_type, wp
      class(march_type), intent(in) :: self
      real(wp) :: memory(self%memory_size())
    end function save_interface

    subroutine load_interface(self, memory, other_load)
      import :: march_type, wp
      class(march_type), intent(inout) :: self
      real(wp), intent(in) :: memory(:)
      !> The load has changed: the saved phases are not used.
      logical, intent(in) :: other_load
    end subroutine load_interface

  end interface

contains

  !> Arguments of laws and their rates, shape (n_read).
  subroutine read_all(self, u, v)
    class(march_type), intent(in) :: self
    real(wp), intent(out) :: u(:), v(:)
    call self%observe(u, v)
  end subroutine read_all

  pure integer function n_all(self)
    class(march_type), intent(in) :: self
    n_all = self%n_observed()
  end function n_all

  !> Errors of the observed values, (u_1, u'_1, ...), due to rounding of frequencies that
  !! were computed beforehand.
  pure function no_errors(self) result(errors)
    class(march_type), intent(in) :: self
    real(wp) :: errors(2*self%n_observed())
    errors = 0.0_wp
  end function no_errors

  !> Some coordinates and their velocities at positions in a part of the last step.
  subroutine inside_each(self, begin, width, points, which, u, v)
    class(march_type), intent(inout) :: self
    !> The part, in [0, 1], and positions in it, in [0, 1] too.
    real(wp), intent(in) :: begin, width, points(:)
    !> Indices of the coordinates in the result of `observe`.
    integer, intent(in) :: which(:)
    !> Shape (size(points), size(which)).
    real(wp), intent(out) :: u(:, :), v(:, :)
    real(wp) :: all_u(self%n_observed()), all_v(self%n_observed()), x
    integer :: i
    do i = 1, size(points)
      x = begin + width*points(i)
      if (x < 1.0_wp) then
        call self%inside(x, all_u, all_v)
      else
        call self%observe(all_u, all_v)
      end if
      u(i, :) = all_u(which)
      v(i, :) = all_v(which)
    end do
  end subroutine inside_each

end module viscovib_march
