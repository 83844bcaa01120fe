! Optimize: -O2
!> Runs of motions with memory, and of structures, step by step, for any equations of a step.
!!
!! The step after a corner of the load consists of panels that double their length: a motion with a
!! steep kernel is not smooth there.
module viscovib_march
  use viscovib_base_motion, only: base_motion_type
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_counters, only: count_up, counted_memory, counting
  use viscovib_hereditary_kernels, only: gather_channels
  use viscovib_hereditary_maps, only: place_of, step_map_type
  use viscovib_hereditary_start, only: panel_ends, start_type
  use viscovib_histories, only: keeping_type, new_history, past_request
  use viscovib_history, only: history_type
  use viscovib_kinds, only: wp
  use viscovib_known_past, only: known_past_type, new_known_past
  use viscovib_memory_channels, only: channels_type, new_channels
  use viscovib_oscillator, only: oscillator_type
  use viscovib_step_equations, only: new_step_equations, solved_for, step_equations_type
  use viscovib_time_load, only: load_clock, new_clock, time_load_type
  implicit none
  private

  public :: enter_piece, march_type, pull, set_step

  !> Reason why a run cannot start.
  integer, parameter, public :: begun = 0, no_exponentials = 1, step_too_large = 2, no_integral = 3

  !> Length of the saved data of this type.
  integer, parameter :: n_common = 4

  type, abstract :: march_type
    class(oscillator_type), pointer :: system => null()
    type(time_load_type) :: load
    real(wp) :: h = 0.0_wp
    !> The last step failed only because it may have passed an escape to infinity;
    !! the next step is accepted in spite of that.
    logical :: doubtful = .false., trusted = .false.
    !> True if a run ends where a step is too large, without a search for the stop inside it.
    logical :: gives_up = .false.
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
    !> Panels of the first step.
    type(start_type) :: start
    !> Step lengths of the maps, and index of the present one.
    real(wp), allocatable :: lengths(:)
    integer :: now = 1
    !> Number of valid lengths.
    integer, private :: n_lengths = 0
  contains
    procedure :: begin
    procedure :: begin_equations
    procedure :: remembers
    procedure :: step
    procedure :: enter => enter_piece
    procedure :: take_up
    procedure :: change_step => set_step
    procedure :: store_step
    procedure :: sharpen
    procedure :: memory_size
    procedure :: save_memory
    procedure :: are_of_state
    procedure :: follow_state
    procedure :: load_memory
    procedure :: read_by_laws => read_all
    procedure :: n_read => n_all
    procedure :: inside_part => inside_each
    procedure :: phase_errors => no_errors
    procedure, private :: add_first_step
    procedure, private :: add_graded_step
    procedure(set_interface), deferred :: set_state
    procedure(state_interface), deferred :: get_state
    procedure(kick_interface), deferred :: kick
    procedure(observe_interface), deferred :: observe
    procedure(inside_interface), deferred :: inside
    procedure(size_interface), deferred :: n_observed
    procedure(real_interface), deferred :: furthest
    procedure(real_interface), deferred :: resolution
    procedure(size_interface), deferred :: n_saved
    procedure(size_interface), deferred :: n_phases
    procedure(save_interface), deferred :: save_state
    procedure(flags_interface), deferred :: saved_of_state
    procedure(load_interface), deferred :: load_state
    procedure(maps_interface), deferred :: make_maps
    procedure(first_interface), deferred :: starts_moving
    procedure(start_interface), deferred :: make_start
    procedure(plain_interface), deferred :: plain_step
    procedure(stand_interface), deferred :: stand_still
    procedure(panels_interface), deferred :: begin_panels
  end type march_type

  abstract interface

    !> Set the state: coordinates, or modes, and their velocities, relative to the base.
    pure subroutine set_interface(self, u, v)
      import :: march_type, wp
      class(march_type), intent(inout) :: self
      real(wp), intent(in) :: u(:), v(:)
    end subroutine set_interface

    pure subroutine state_interface(self, u, v)
      import :: march_type, wp
      class(march_type), intent(in) :: self
      real(wp), allocatable, intent(out) :: u(:), v(:)
    end subroutine state_interface

    !> Add a jump to the state relative to the base, which has a corner.
    subroutine kick_interface(self, base, displacement, velocity)
      import :: base_motion_type, march_type, wp
      class(march_type), intent(inout) :: self
      type(base_motion_type), intent(in) :: base
      !> Jumps of the base, old minus new value, one for each base displacement.
      real(wp), intent(in) :: displacement(:), velocity(:)
    end subroutine kick_interface

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

    !> Number of observed coordinates; length of a saved state, and of the phases in it.
    pure integer function size_interface(self)
      import :: march_type
      class(march_type), intent(in) :: self
    end function size_interface

    !> The state with all data that a run needs to continue bit for bit, the phases of loads last.
    function save_interface(self) result(saved)
      import :: march_type, wp
      class(march_type), intent(in) :: self
      real(wp) :: saved(self%n_saved())
    end function save_interface

    function flags_interface(self) result(flags)
      import :: march_type
      class(march_type), intent(in) :: self
      logical :: flags(self%n_saved())
    end function flags_interface

    subroutine load_interface(self, saved, other_load)
      import :: march_type, wp
      class(march_type), intent(inout) :: self
      real(wp), intent(in) :: saved(:)
      !> The load has changed: the saved phases are not used.
      logical, intent(in) :: other_load
    end subroutine load_interface

    !> Compute the maps of steps h, with index `now`. `singular`: such steps are too large.
    subroutine maps_interface(self, singular)
      import :: march_type
      class(march_type), intent(inout) :: self
      logical, intent(out) :: singular
    end subroutine maps_interface

    !> True if the state or its loads at time 0 are not 0, without the table of the load.
    pure logical function first_interface(self)
      import :: march_type
      class(march_type), intent(in) :: self
    end function first_interface

    !> Make the first step as panels. `made` is false, and the state is unchanged, if a plain step
    !! suffices or a panel fails.
    subroutine start_interface(self, made)
      import :: march_type
      class(march_type), intent(inout), target :: self
      logical, intent(out) :: made
    end subroutine start_interface

    !> One step to time `until`, as a polynomial.
    subroutine plain_interface(self, until, made)
      import :: march_type, wp
      class(march_type), intent(inout) :: self
      real(wp), intent(in) :: until
      logical, intent(out) :: made
    end subroutine plain_interface

    !> Start the next step at the present state, without extrapolation from the previous step.
    subroutine stand_interface(self)
      import :: march_type
      class(march_type), intent(inout) :: self
    end subroutine stand_interface

    !> Allocate panels of one step, so that states inside it can be computed.
    subroutine panels_interface(self, ends)
      import :: march_type, wp
      class(march_type), intent(inout) :: self
      !> From the beginning of the step, 0 first.
      real(wp), intent(in) :: ends(0:)
    end subroutine panels_interface

  end interface

contains

  !> Prepare the memory and the maps of a run from time 0, whose state is set. `reason`: `begun`,
  !! or why the run cannot start.
  subroutine begin(self, system, load, request, reason)
    class(march_type), intent(inout) :: self
    class(oscillator_type), intent(in), target :: system
    type(time_load_type), intent(in) :: load
    type(past_request), intent(in) :: request
    integer, intent(out) :: reason
    logical :: possible

    reason = begun
    self%system => system
    self%load = load
    self%bound = system%largest_amplitude()
    call new_collocation(self%table, request%nodes)
    if (any(abs(request%held) > 0.0_wp) .and. system%kernel_without_integral() > 0) then
      reason = no_integral
      return
    end if
    call new_channels(self%channels, system, request%held)
    call new_history(self%history, self%keeping, system, self%channels, self%table, request, &
                     possible)
    if (.not. possible) then
      reason = no_exponentials
      return
    end if
    if (allocated(request%before) .and. self%remembers()) then
      call new_known_past(self%known_past, system, self%channels, request%before, request%moved)
      if (self%known_past%is_known()) call self%history%add_known_past(self%known_past)
    end if
    self%gather = matmul(self%channels%gather, system%gather)
    allocate (self%points(0:request%nodes + 1, size(request%held)), source=0.0_wp)
    allocate (self%g(0:request%nodes + 1, size(self%channels%kernel_of)))
    allocate (self%lengths(1))
    call self%change_step(0.0_wp, request%h, possible)
    if (.not. possible) reason = step_too_large
  end subroutine begin

  !> Prepare the nonlinear equations of steps with such a map, for a tolerance of the motion.
  subroutine begin_equations(self, map, tolerance)
    class(march_type), intent(inout) :: self
    type(step_map_type), intent(in) :: map
    real(wp), intent(in) :: tolerance
    self%gather_bends = self%channels%gather(:, map%bent)
    call new_step_equations(self%equations, map, self%table, solved_for(tolerance))
    call self%stand_still()
  end subroutine begin_equations

  !> True if a force has memory.
  pure logical function remembers(self)
    class(march_type), intent(in) :: self
    remembers = size(self%channels%kernel_of) > 0
  end function remembers

  !> Add the step that has been solved, with `points`, to the memory.
  subroutine store_step(self)
    class(march_type), intent(inout) :: self
    if (.not. self%remembers()) return
    call gather_channels(self%table%s + 2, size(self%points, 2), size(self%equations%y_start), &
                         size(self%g, 2), self%points, self%equations%y_start, self%equations%y, &
                         self%gather, self%gather_bends, self%channels%held, self%g)
    if (counting) call count_up(counted_memory, size(self%g, 2))
    call self%history%store(self%g)
  end subroutine store_step

  !> Solve the equations of every step to rounding from now on.
  subroutine sharpen(self)
    class(march_type), intent(inout) :: self
    call self%equations%sharpen()
  end subroutine sharpen

  !> One step to time `until`; `made` is false, and the state is unchanged, if its equations do
  !! not converge.
  subroutine step(self, until, made)
    class(march_type), intent(inout) :: self
    real(wp), intent(in) :: until
    logical, intent(out) :: made
    logical :: graded

    graded = self%keeping%at_corner
    self%keeping%at_corner = .false.
    if (.not. self%clock%t > 0.0_wp) then
      call self%add_first_step(made)
      if (made) return
    end if
    if (graded) then
      call self%add_graded_step(until, made)
    else
      call self%plain_step(until, made)
    end if
    if (made) return
    self%keeping%at_corner = graded
    ! The failed step gives no prediction.
    call self%stand_still()
  end subroutine step

  !> One step after a corner of the load. Lengths are powers of 2 except the last, so that
  !! other steps can reuse their maps.
  subroutine add_graded_step(self, until, made)
    class(march_type), intent(inout) :: self
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
      call self%change_step(from + ends(k - 1), ends(k) - ends(k - 1), made)
      if (made) call self%plain_step(from + ends(k), made)
      if (.not. made) exit
    end do
    self%panel = 0
    if (made) then
      call self%change_step(until, h, made)
    else
      call self%load_memory(memory, .false.)
      call self%change_step(from, h, made)
      made = .false.
    end if
  end subroutine add_graded_step

  !> The first step as panels, where memory makes the start singular; `made` is false if a plain
  !! step suffices.
  subroutine add_first_step(self, made)
    class(march_type), intent(inout), target :: self
    logical, intent(out) :: made
    real(wp) :: f(size(self%load%pieces, 1))

    made = .false.
    if (.not. self%remembers()) return
    call self%load%at(0.0_wp, f)
    if (.not. (self%starts_moving() .or. any(abs(f) > 0.0_wp) &
               .or. self%known_past%is_known())) return
    call self%make_start(made)
    if (.not. made) return
    call self%history%begin(self%start%table, self%start%past)
    call self%clock%advance(self%h)
    call self%stand_still()
  end subroutine add_first_step

  !> Begin a piece of the mesh at time t with steps h; the load has a corner. `made` is false if
  !! such steps are too large.
  subroutine enter_piece(self, t, h, made)
    class(march_type), intent(inout) :: self
    real(wp), intent(in) :: t, h
    logical, intent(out) :: made
    real(wp) :: before

    before = self%h
    call self%change_step(t, h, made)
    call self%keeping%turn(before, h)
  end subroutine enter_piece

  !> Continue at time t from a state, relative to the base, under another load; the memory
  !! is kept. `made` is false if steps are too large.
  subroutine take_up(self, t, u, v, made)
    class(march_type), intent(inout) :: self
    real(wp), intent(in) :: t, u(:), v(:)
    logical, intent(out) :: made
    call self%set_state(u, v)
    call self%enter(t, self%h, made)
    call self%stand_still()
  end subroutine take_up

  !> Set the step length to h from time t on. `made` is false if such steps are too large.
  subroutine set_step(self, t, h, made)
    class(march_type), intent(inout) :: self
    real(wp), intent(in) :: t, h
    logical, intent(out) :: made
    logical :: singular

    self%h = h
    self%rolling = .false.
    if (self%remembers()) call self%history%change_step(h)
    singular = .false.
    call place_of(self%lengths, self%n_lengths, h, self%now)
    if (self%now > self%n_lengths) then
      call self%make_maps(singular)
      self%lengths(self%now) = h
      if (.not. singular) self%n_lengths = self%now
    end if
    made = .not. singular
    if (made) call new_clock(self%clock, self%load, t, h, self%table%points(1:self%table%s))
  end subroutine set_step

  !> Length of the data that a run needs to continue bit for bit.
  pure integer function memory_size(self)
    class(march_type), intent(in) :: self
    memory_size = n_common + size(self%equations%y_start) + size(self%equations%y) + self%n_saved()
    if (self%remembers()) memory_size = memory_size + self%history%memory_size()
  end function memory_size

  function save_memory(self) result(memory)
    class(march_type), intent(in) :: self
    real(wp) :: memory(self%memory_size()), state(self%n_saved())
    integer :: n, own

    memory(:n_common) = [merge(1.0_wp, 0.0_wp, self%rolling), self%clock%t, &
                         merge(1.0_wp, 0.0_wp, self%keeping%at_corner), &
                         real(self%keeping%n_doublings, wp)]
    n = n_common
    state = self%save_state()
    own = size(state) - self%n_phases()
    call push(memory, n, state(:own))
    call push(memory, n, [self%equations%y_start, self%equations%y])
    if (self%remembers()) call push(memory, n, self%history%save_memory())
    call push(memory, n, state(own + 1:))
  end function save_memory

  !> True for the numbers of the memory that belong to the state.
  function are_of_state(self)
    class(march_type), intent(in) :: self
    logical :: are_of_state(self%memory_size()), own(self%n_saved())
    integer :: n
    own = self%saved_of_state()
    n = self%n_saved() - self%n_phases()
    are_of_state = .true.
    are_of_state(:n_common) = .false.
    are_of_state(n_common + 1:n_common + n) = own(:n)
    are_of_state(size(are_of_state) - self%n_phases() + 1:) = own(n + 1:)
  end function are_of_state

  !> Compute again what follows from the state of a memory that was changed.
  subroutine follow_state(self)
    class(march_type), intent(inout) :: self
    associate (unused => self)
    end associate
  end subroutine follow_state

  subroutine load_memory(self, memory, other_load)
    class(march_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    !> As in `load_state`.
    logical, intent(in) :: other_load
    real(wp) :: state(self%n_saved())
    integer :: n, own

    self%rolling = memory(1) > 0.5_wp
    self%clock%t = memory(2)
    self%keeping%at_corner = memory(3) > 0.5_wp
    self%keeping%n_doublings = nint(memory(4))
    n = n_common
    own = size(state) - self%n_phases()
    call pull(memory, n, state(:own))
    call pull(memory, n, self%equations%y_start)
    call pull(memory, n, self%equations%y)
    if (self%remembers()) then
      call self%history%load_memory(memory(n + 1:))
      n = n + self%history%memory_size()
    end if
    call pull(memory, n, state(own + 1:))
    call self%load_state(state, other_load)
  end subroutine load_memory

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
