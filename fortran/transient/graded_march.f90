!> Runs whose step after a corner of the load consists of panels that double their length: a motion
!! with a steep kernel is not smooth there.
module viscovib_graded_march
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_counters, only: count_up, counted_memory, counting
  use viscovib_hereditary_kernels, only: gather_channels
  use viscovib_hereditary_maps, only: step_map_type
  use viscovib_hereditary_start, only: panel_ends
  use viscovib_histories, only: keeping_type, new_history
  use viscovib_history, only: history_type
  use viscovib_kinds, only: i8, wp
  use viscovib_known_past, only: known_past_type, new_known_past
  use viscovib_march, only: begun, march_type, no_exponentials, no_integral
  use viscovib_memory_channels, only: channels_type, new_channels
  use viscovib_oscillator, only: oscillator_type
  use viscovib_step_equations, only: new_step_equations, step_equations_type
  use viscovib_time_load, only: load_clock, time_load_type
  implicit none
  private

  public :: graded_march_type, pull, push

  !> Length of the saved data of this type.
  integer, parameter, public :: n_common = 4

  type, abstract, extends(march_type) :: graded_march_type
    !> Bound of displacements; beyond it the run has diverged.
    real(wp) :: bound = huge(1.0_wp)
    type(collocation_type) :: table
    type(step_equations_type) :: equations
    !> The memory, and how corners are treated.
    type(channels_type) :: channels
    class(history_type), allocatable :: history
    type(known_past_type) :: known_past
    type(keeping_type) :: keeping
    !> T W, shape (n_channels, n_dof), and T of the bent variables.
    real(wp), allocatable, private :: gather(:, :), gather_bends(:, :)
    !> Displacements at the points of the last step, shape (0:s+1, n_dof); workspace for channels.
    real(wp), allocatable :: points(:, :)
    real(wp), allocatable, private :: g(:, :)
    !> Time, and the load at the nodes of a step.
    type(load_clock) :: clock
    !> True if the next step follows one of its own kind.
    logical :: rolling = .false.
    !> Index of the panel in progress; 0: the whole step.
    integer :: panel = 0
  contains
    procedure :: step
    procedure :: enter
    procedure :: common_memory
    procedure :: take_common
    procedure :: begin_memory
    procedure :: begin_equations
    procedure :: remembers
    procedure :: store_step
    procedure :: sharpen
    procedure, private :: add_graded_step
    procedure(first_interface), deferred :: add_first_step
    procedure(plain_interface), deferred :: plain_step
    procedure(stand_interface), deferred :: stand_still
    procedure(panels_interface), deferred :: begin_panels
  end type graded_march_type

  abstract interface

    !> The first step as panels, where memory makes the start singular; `made` is false if
    !! a plain step suffices.
    subroutine first_interface(self, system, load, made)
      import :: graded_march_type, oscillator_type, time_load_type
      class(graded_march_type), intent(inout), target :: self
      class(oscillator_type), intent(in) :: system
      type(time_load_type), intent(in) :: load
      logical, intent(out) :: made
    end subroutine first_interface

    !> One step to time `until`, as a polynomial.
    subroutine plain_interface(self, system, load, until, made)
      import :: graded_march_type, oscillator_type, time_load_type, wp
      class(graded_march_type), intent(inout) :: self
      class(oscillator_type), intent(in) :: system
      type(time_load_type), intent(in) :: load
      real(wp), intent(in) :: until
      logical, intent(out) :: made
    end subroutine plain_interface

    !> Start the next step at the present state, without extrapolation from the previous step.
    subroutine stand_interface(self, system)
      import :: graded_march_type, oscillator_type
      class(graded_march_type), intent(inout) :: self
      class(oscillator_type), intent(in) :: system
    end subroutine stand_interface

    !> Allocate panels of one step, so that states inside it can be computed.
    subroutine panels_interface(self, ends)
      import :: graded_march_type, wp
      class(graded_march_type), intent(inout) :: self
      !> From the beginning of the step, 0 first.
      real(wp), intent(in) :: ends(0:)
    end subroutine panels_interface

  end interface

contains

  !> Prepare the nodes, the channels of the memory and its storage. `reason`: `begun`, or why the
  !! run cannot start.
  subroutine begin_memory(self, system, s, past, held, h, t_end, tolerance, reason, before, moved, &
                          shortest, kinks)
    class(graded_march_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    !> Nodes of a step; as in `new_history`.
    integer, intent(in) :: s, past
    !> Displacements held for all t < 0, shape (n_dof); step; latest time; relative error of the
    !! kernels as exponentials.
    real(wp), intent(in) :: held(:), h, t_end, tolerance
    integer, intent(out) :: reason
    !> Times ascending to 0 and displacements there, shapes (n) and (n_dof, n), if the
    !! motion before 0 is known; `held` is then the first of these displacements.
    real(wp), intent(in), optional :: before(:), moved(:, :)
    !> Shortest step of a run whose steps change after corners of the load, and whether velocities
    !! may jump there.
    real(wp), intent(in), optional :: shortest
    logical, intent(in), optional :: kinks
    logical :: possible

    reason = begun
    self%bound = system%largest_amplitude()
    call new_collocation(self%table, s)
    if (any(abs(held) > 0.0_wp) .and. system%kernel_without_integral() > 0) then
      reason = no_integral
      return
    end if
    call new_channels(self%channels, system, held)
    call new_history(self%history, self%keeping, system, self%channels, self%table, past, h, &
                     t_end, tolerance, possible, shortest, kinks)
    if (.not. possible) then
      reason = no_exponentials
      return
    end if
    if (present(before) .and. self%remembers()) then
      call new_known_past(self%known_past, system, self%channels, before, moved)
      if (self%known_past%is_known()) call self%history%add_known_past(self%known_past)
    end if
    self%gather = matmul(self%channels%gather, system%gather)
    allocate (self%points(0:s + 1, size(held)), source=0.0_wp)
    allocate (self%g(0:s + 1, size(self%channels%kernel_of)))
  end subroutine begin_memory

  !> Prepare the nonlinear equations of steps with such a map; `solved` as in `new_step_equations`.
  subroutine begin_equations(self, map, solved)
    class(graded_march_type), intent(inout) :: self
    type(step_map_type), intent(in) :: map
    real(wp), intent(in) :: solved
    self%gather_bends = self%channels%gather(:, map%bent)
    call new_step_equations(self%equations, map, self%table, solved)
  end subroutine begin_equations

  !> True if a force has memory.
  pure logical function remembers(self)
    class(graded_march_type), intent(in) :: self
    remembers = size(self%channels%kernel_of) > 0
  end function remembers

  !> Add the step that has been solved, with `points`, to the memory.
  subroutine store_step(self)
    class(graded_march_type), intent(inout) :: self
    if (.not. self%remembers()) return
    call gather_channels(self%table%s + 2, size(self%points, 2), size(self%equations%y_start), &
                         size(self%g, 2), self%points, self%equations%y_start, self%equations%y, &
                         self%gather, self%gather_bends, self%channels%held, self%g)
    if (counting) call count_up(counted_memory, size(self%g, 2))
    call self%history%store(self%g)
  end subroutine store_step

  subroutine sharpen(self)
    class(graded_march_type), intent(inout) :: self
    call self%equations%sharpen()
  end subroutine sharpen

  subroutine step(self, system, load, n_before, until, made)
    class(graded_march_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    integer(i8), intent(in) :: n_before
    real(wp), intent(in) :: until
    logical, intent(out) :: made
    logical :: graded

    graded = self%keeping%at_corner
    self%keeping%at_corner = .false.
    if (n_before == 0) then
      call self%add_first_step(system, load, made)
      if (made) return
    end if
    if (graded) then
      call self%add_graded_step(system, load, until, made)
    else
      call self%plain_step(system, load, until, made)
    end if
    if (made) return
    self%keeping%at_corner = graded
    ! The failed step gives no prediction.
    call self%stand_still(system)
  end subroutine step

  !> One step after a corner of the load. Lengths are powers of 2 except the last, so that
  !! other steps can reuse their maps.
  subroutine add_graded_step(self, system, load, until, made)
    class(graded_march_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: until
    logical, intent(out) :: made
    real(wp) :: from, h
    real(wp), allocatable :: ends(:), memory(:)
    integer :: k, n

    h = self%h
    from = self%clock%t
    allocate (memory, source=self%save_memory())
    n = self%keeping%n_doublings + 1
    allocate (ends(0:n))
    ends(:) = panel_ends(h, self%keeping%n_doublings, self%keeping%between)
    call self%begin_panels(ends)
    do k = 1, n
      self%panel = k
      call self%change_step(system, load, from + ends(k - 1), ends(k) - ends(k - 1), made)
      if (made) call self%plain_step(system, load, from + ends(k), made)
      if (.not. made) exit
    end do
    self%panel = 0
    if (made) then
      call self%change_step(system, load, until, h, made)
    else
      call self%load_memory(memory, .false.)
      call self%change_step(system, load, from, h, made)
      made = .false.
    end if
  end subroutine add_graded_step

  subroutine enter(self, system, load, t, h, made)
    class(graded_march_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: t, h
    logical, intent(out) :: made
    real(wp) :: before

    before = self%h
    call self%change_step(system, load, t, h, made)
    call self%keeping%turn(before, h)
  end subroutine enter

  !> Data of this type that a run needs to continue, shape (n_common).
  pure function common_memory(self) result(memory)
    class(graded_march_type), intent(in) :: self
    real(wp) :: memory(n_common)
    memory = [merge(1.0_wp, 0.0_wp, self%rolling), self%clock%t, &
              merge(1.0_wp, 0.0_wp, self%keeping%at_corner), real(self%keeping%n_doublings, wp)]
  end function common_memory

  pure subroutine take_common(self, memory)
    class(graded_march_type), intent(inout) :: self
    real(wp), intent(in) :: memory(n_common)
    self%rolling = memory(1) > 0.5_wp
    self%clock%t = memory(2)
    self%keeping%at_corner = memory(3) > 0.5_wp
    self%keeping%n_doublings = nint(memory(4))
  end subroutine take_common

  !> Append a part after the first n numbers, and increase n.
  pure subroutine push(memory, n, part)
    real(wp), intent(inout) :: memory(:)
    integer, intent(inout) :: n
    real(wp), intent(in) :: part(:)
    memory(n + 1:n + size(part)) = part
    n = n + size(part)
  end subroutine push

  !> Read the next part, and increase n.
  pure subroutine pull(memory, n, part)
    real(wp), intent(in) :: memory(:)
    integer, intent(inout) :: n
    real(wp), intent(out) :: part(:)
    part = memory(n + 1:n + size(part))
    n = n + size(part)
  end subroutine pull

end module viscovib_graded_march
