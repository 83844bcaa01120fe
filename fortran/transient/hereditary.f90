!> Motion with memory in equal steps: Gauss collocation of the accelerations; the history of
!! hereditary variables is stored as polynomials through the nodes and both ends.
!!
!! The maps of a step are in `hereditary_maps`, its nonlinear equations in
!! `step_equations`.
module viscovib_hereditary
  use viscovib_base_motion, only: base_motion_type
  use viscovib_counters, only: count_up, counted_coordinates, counting
  use viscovib_graded_march, only: graded_march_type, n_common, pull, push
  use viscovib_hereditary_kernels, only: add_any, add_held, add_up, check_resolution, runs_away
  use viscovib_hereditary_maps, only: find_map, new_step_map, step_map_type
  use viscovib_hereditary_start, only: direct_panels, march_start, start_type
  use viscovib_histories, only: past_direct, past_exponentials
  use viscovib_kinds, only: wp
  use viscovib_march, only: begun, no_exponentials, no_integral, step_too_large
  use viscovib_oscillator, only: oscillator_type
  use viscovib_step_equations, only: solved_for
  use viscovib_time_load, only: new_clock, time_load_type
  implicit none
  private

  public :: hereditary_type, new_hereditary

  ! Re-exported constants.
  public :: past_exponentials, past_direct, begun, no_exponentials, step_too_large, no_integral

  !> The state consists of the coordinates.
  type, extends(graded_march_type) :: hereditary_type
    !> State, shape (n_dof), and its rounding error.
    real(wp), allocatable :: u(:), v(:), u_rest(:), v_rest(:)
    !> Largest last Legendre coefficient of the displacements on a step, and largest
    !! displacement, shape (n_dof): their ratio shows how well steps resolve the motion.
    real(wp), allocatable :: roughness(:), largest(:)
    !> Maps for each step length, and the index of the present one.
    type(step_map_type), allocatable :: maps(:)
    integer :: now = 1
    type(start_type) :: start
    !> Step lengths of the maps, and their number.
    real(wp), allocatable, private :: lengths(:)
    integer, private :: n_lengths = 0
  contains
    procedure :: take_up
    procedure :: kick
    procedure :: change_step
    procedure :: get_state
    procedure :: observe
    procedure :: inside
    procedure :: furthest
    procedure :: n_observed
    procedure :: resolution
    procedure :: memory_size
    procedure :: save_memory
    procedure :: load_memory
    procedure :: add_first_step
    procedure :: plain_step
    procedure :: stand_still
    procedure :: begin_panels
  end type hereditary_type

  !> Share of nonlinear forces in the displacements above which a motion may escape in a step.
  real(wp), parameter :: bending = 1.0e-3_wp
  !> Largest number of nodes of a step.
  integer, parameter :: most_nodes = 8

contains

  !> A run from (u, v) at time 0. `reason`: `begun`, or why the run cannot start.
  subroutine new_hereditary(run, system, load, s, past, held, u, v, h, t_end, tolerance, reason, &
                            before, moved, shortest, kinks)
    type(hereditary_type), intent(out) :: run
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    !> Nodes of a step; `past_exponentials` or `past_direct`.
    integer, intent(in) :: s, past
    !> Displacement held for all t < 0, shape (n_dof).
    real(wp), intent(in) :: held(:)
    !> Start, shape (n_dof); step; latest time; relative error of the kernels as
    !! exponentials and of a step's solution.
    real(wp), intent(in) :: u(:), v(:), h, t_end, tolerance
    integer, intent(out) :: reason
    !> Times ascending to 0 and displacements there, shapes (n) and (n_dof, n), if the
    !! motion before 0 is known; `held` is then the first of these displacements.
    real(wp), intent(in), optional :: before(:), moved(:, :)
    !> Shortest step of a run whose steps change after corners of the load.
    real(wp), intent(in), optional :: shortest
    !> Whether velocities may jump at corners.
    logical, intent(in), optional :: kinks
    logical :: singular

    run%h = h
    run%u = u
    run%v = v
    run%u_rest = 0.0_wp*u
    run%roughness = 0.0_wp*u
    run%largest = 0.0_wp*u
    run%v_rest = 0.0_wp*v
    call run%begin_memory(system, s, past, held, h, t_end, tolerance, reason, before, moved, &
                          shortest, kinks)
    if (reason /= begun) return
    allocate (run%maps(1), run%lengths(1))
    run%lengths = h
    run%n_lengths = 1
    call new_step_map(run%maps(1), system, run%channels, run%table, h, singular)
    if (singular) then
      reason = step_too_large
      return
    end if
    call new_clock(run%clock, load, 0.0_wp, h, run%table%points(1:s))
    call run%begin_equations(run%maps(1), solved_for(tolerance))
    call run%stand_still(system)
  end subroutine new_hereditary

  !> Start the next step at the present state, without extrapolation from the previous step.
  subroutine stand_still(self, system)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    call self%equations%start_bends(system, self%maps(self%now), self%u, self%v)
    self%points(self%table%s + 1, :) = self%u
    self%rolling = .false.
  end subroutine stand_still

  !> Continue at time t from a state, relative to the base, under another load; the memory
  !! is kept. `made` is false if steps are too large.
  subroutine take_up(self, system, load, t, u, v, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: t, u(:), v(:)
    logical, intent(out) :: made

    self%u = u
    self%v = v
    self%u_rest = 0.0_wp*u
    self%v_rest = 0.0_wp*v
    call self%enter(system, load, t, self%h, made)
    call self%stand_still(system)
  end subroutine take_up

  !> Add a jump to the state relative to the base.
  subroutine kick(self, base, displacement, velocity)
    class(hereditary_type), intent(inout) :: self
    type(base_motion_type), intent(in) :: base
    real(wp), intent(in) :: displacement(:), velocity(:)
    call add_any(self%u, self%u_rest, base%of_coordinates(displacement))
    call add_any(self%v, self%v_rest, base%of_coordinates(velocity))
  end subroutine kick

  !> Set the step length to h from time t on.
  subroutine change_step(self, system, load, t, h, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: t, h
    logical, intent(out) :: made
    logical :: singular

    self%h = h
    self%rolling = .false.
    call new_clock(self%clock, load, t, h, self%table%points(1:self%table%s))
    if (self%remembers()) call self%history%change_step(h)
    singular = .false.
    call find_map(self%maps, self%lengths, self%n_lengths, h, self%now)
    if (self%now > self%n_lengths) then
      call new_step_map(self%maps(self%now), system, self%channels, self%table, h, singular)
      self%lengths(self%now) = h
      if (.not. singular) self%n_lengths = self%now
    end if
    made = .not. singular
  end subroutine change_step

  !> One step to time `until`, as a polynomial.
  subroutine plain_step(self, system, load, until, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: until
    logical, intent(out) :: made
    integer :: d, n, s

    s = self%table%s
    n = size(self%u)
    if (counting) call count_up(counted_coordinates, n)
    if (system%moving) call rename_start(self, system)
    associate (z => self%equations%z, map => self%maps(self%now))
      z(:n) = self%u
      z(n + 1:2*n) = self%v
      call self%clock%at_nodes(load, z(map%at_load + 1:map%at_memory))
      if (map%n_channels > 0) then
        call self%history%recall(z(map%at_memory + 1:map%at_bend))
        call add_held(s*map%n_channels, map%held, z(map%at_memory + 1:map%at_bend))
      end if
      call self%equations%predict(map, self%rolling)
      z(map%at_bend + 1:) = self%equations%y_start
      call self%equations%iterate(system, map, self%u, made)
    end associate
    if (.not. made) return
    associate (x => self%equations%x, map => self%maps(self%now))
      do d = 1, n
        made = made .and. abs(self%u(d) + x(d*(s + 1))) <= self%bound &
               .and. abs(self%v(d) + x(map%velocity_row + d - 1)) <= self%bound
      end do
      self%doubtful = .false.
      if (made .and. size(self%equations%y) > 0 .and. .not. self%trusted) then
        self%doubtful = runs_away(s, self%h, self%u, self%v, self%largest, x, &
                                  self%table%last_coefficient)
        ! A linear motion cannot escape, however steep it is.
        if (self%doubtful) self%doubtful = self%equations%nonlinear_share(self%u) > bending
      end if
      made = made .and. .not. self%doubtful
      if (.not. made) return
      self%trusted = .false.
      do d = 1, n
        self%points(0, d) = self%u(d)
        self%points(1:, d) = self%u(d) + x((d - 1)*(s + 1) + 1:d*(s + 1))
        call check_resolution(s + 2, self%points(:, d), self%table%last_coefficient, &
                              self%roughness(d), &
                   self%largest(d))
        call add_up(self%u(d), self%u_rest(d), x(d*(s + 1)))
        call add_up(self%v(d), self%v_rest(d), x(map%velocity_row + d - 1))
      end do
    end associate
    call self%store_step()
    if (self%panel > 0) then
      self%start%begins(:, self%panel) = self%points(0, :)
      self%start%rises(:, :, self%panel) = rises_of(self)
    end if
    call self%clock%advance(until)
    self%rolling = .true.
  end subroutine plain_step

  !> Use an equivalent representation of the same state, if the system has one.
  subroutine rename_start(self, system)
    type(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp) :: u(size(self%u)), v(size(self%u))
    logical :: renamed

    u = self%u + self%u_rest
    v = self%v + self%v_rest
    call system%rename_state(u, v, renamed)
    if (.not. renamed) return
    self%u = u
    self%v = v
    self%u_rest = 0.0_wp
    self%v_rest = 0.0_wp
    call self%stand_still(system)
  end subroutine rename_start

  !> Allocate the panels of a step.
  subroutine begin_panels(self, ends)
    class(hereditary_type), intent(inout) :: self
    real(wp), intent(in) :: ends(0:)

    self%start%table = self%table
    if (allocated(self%start%ends)) deallocate (self%start%ends)
    allocate (self%start%ends, source=ends)
    if (allocated(self%start%rises)) deallocate (self%start%begins, self%start%rises)
    allocate (self%start%begins(size(self%u), size(ends) - 1))
    allocate (self%start%rises(self%table%s + 1, size(self%u), size(ends) - 1))
  end subroutine begin_panels

  !> Largest last Legendre coefficient of a displacement, relative to its largest value.
  pure real(wp) function resolution(self)
    class(hereditary_type), intent(in) :: self
    integer :: d
    resolution = 0.0_wp
    do d = 1, size(self%largest)
      if (self%largest(d) > 0.0_wp) resolution = max(resolution, &
                                                     self%roughness(d)/self%largest(d))
    end do
  end function resolution

  !> The first step as a sequence of panels, where memory makes the start singular;
  !! `made` is false if a plain step suffices.
  subroutine add_first_step(self, system, load, made)
    class(hereditary_type), intent(inout), target :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    logical, intent(out) :: made
    real(wp), dimension(size(self%u)) :: f
    type(direct_panels) :: panels

    made = .false.
    if (.not. self%remembers()) return
    call load%at(0.0_wp, f)
    if (.not. (any(abs(self%u) > 0.0_wp) .or. any(abs(self%v) > 0.0_wp) &
               .or. any(abs(f) > 0.0_wp) .or. self%known_past%is_known())) return
    panels%u = self%u
    panels%v = self%v
    call march_start(self%start, system, self%channels, load, self%known_past, self%h, panels, made)
    if (made) made = all(abs(panels%u) <= self%bound) .and. all(abs(panels%v) <= self%bound)
    if (.not. made) return
    self%u = panels%u
    self%v = panels%v
    call move_alloc(panels%begins, self%start%begins)
    call move_alloc(panels%rises, self%start%rises)
    call self%history%begin(self%start%table, self%start%past)
    call self%clock%advance(self%h)
    call self%stand_still(system)
  end subroutine add_first_step

  pure integer function n_observed(self)
    class(hereditary_type), intent(in) :: self
    n_observed = size(self%u)
  end function n_observed

  pure subroutine get_state(self, u, v)
    class(hereditary_type), intent(in) :: self
    real(wp), allocatable, intent(out) :: u(:), v(:)
    u = self%u
    v = self%v
  end subroutine get_state

  subroutine observe(self, u, v)
    class(hereditary_type), intent(in) :: self
    real(wp), intent(out) :: u(:), v(:)
    u = self%u
    v = self%v
  end subroutine observe

  pure real(wp) function furthest(self)
    class(hereditary_type), intent(in) :: self
    furthest = maxval(self%largest)
  end function furthest

  !> State at a fraction of the last step, by the polynomial of the step.
  subroutine inside(self, theta, u, v)
    class(hereditary_type), intent(inout) :: self
    !> In [0, 1], 1 at the end of the last step.
    real(wp), intent(in) :: theta
    real(wp), intent(out) :: u(:), v(:)
    real(wp), dimension(0:most_nodes + 1) :: basis, slopes
    integer :: d, first, s
    if (self%rolling .or. .not. allocated(self%start%ends)) then
      s = self%table%s
      call self%table%weigh(theta, basis, slopes)
      associate (rises => self%equations%x)
        do d = 1, size(u)
          first = (d - 1)*(s + 1)
          u(d) = self%points(0, d) &
                 + dot_product(basis(1:s + 1), rises(first + 1:first + s + 1))
          v(d) = dot_product(slopes(1:s + 1), rises(first + 1:first + s + 1))/self%h
        end do
      end associate
    else
      call self%start%at(theta*self%h, u, v)
    end if
  end subroutine inside

  !> Change of the coordinates from the start of the last step to its other points, shape
  !! (s+1, n_dof): on short steps differences of the coordinates are too inaccurate for velocities.
  pure function rises_of(self) result(rises)
    class(hereditary_type), intent(in) :: self
    real(wp) :: rises(self%table%s + 1, size(self%u))
    rises = reshape(self%equations%x(:size(rises)), shape(rises))
  end function rises_of

  pure integer function memory_size(self)
    class(hereditary_type), intent(in) :: self
    memory_size = n_common + 6*size(self%u) + size(self%equations%y_start) &
                  + size(self%equations%y) + 2*size(self%clock%high)
    if (self%remembers()) memory_size = memory_size + self%history%memory_size()
  end function memory_size

  function save_memory(self) result(memory)
    class(hereditary_type), intent(in) :: self
    real(wp) :: memory(self%memory_size())
    integer :: n

    memory(:n_common) = self%common_memory()
    n = n_common
    call push(memory, n, [self%u, self%v, self%u_rest, self%v_rest, self%roughness, self%largest])
    call push(memory, n, [self%equations%y_start, self%equations%y])
    if (self%remembers()) call push(memory, n, self%history%save_memory())
    call push(memory, n, [self%clock%high, self%clock%low])

  end function save_memory

  subroutine load_memory(self, memory, other_load)
    class(hereditary_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    !> The load has changed: the saved phases are not used.
    logical, intent(in) :: other_load
    integer :: n

    call self%take_common(memory(:n_common))
    n = n_common
    call pull(memory, n, self%u)
    call pull(memory, n, self%v)
    call pull(memory, n, self%u_rest)
    call pull(memory, n, self%v_rest)
    call pull(memory, n, self%roughness)
    call pull(memory, n, self%largest)
    call pull(memory, n, self%equations%y_start)
    call pull(memory, n, self%equations%y)
    if (self%remembers()) then
      call self%history%load_memory(memory(n + 1:))
      n = n + self%history%memory_size()
    end if
    if (other_load) return
    call pull(memory, n, self%clock%high)
    call pull(memory, n, self%clock%low)

  end subroutine load_memory

end module viscovib_hereditary
