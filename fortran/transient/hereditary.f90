! Optimize: -O3
!> Motion with memory in equal steps: Gauss collocation of the accelerations; the history of
!! hereditary variables is stored as polynomials through the nodes and both ends.
!!
!! The maps of a step are in `hereditary_maps`, its nonlinear equations in
!! `step_equations`.
module viscovib_hereditary
  use viscovib_base_motion, only: base_motion_type
  use viscovib_counters, only: count_up, counted_coordinates, counting
  use viscovib_hereditary_kernels, only: add_any, add_held, add_up, check_resolution, runs_away
  use viscovib_hereditary_maps, only: new_step_map, step_map_type
  use viscovib_hereditary_start, only: direct_panels, march_start
  use viscovib_histories, only: past_request
  use viscovib_kinds, only: wp
  use viscovib_march, only: begun, march_type, pull
  use viscovib_oscillator, only: oscillator_type
  use viscovib_time_load, only: time_load_type
  implicit none
  private

  public :: hereditary_type, new_hereditary

  !> The state consists of the coordinates.
  type, extends(march_type) :: hereditary_type
    !> State, shape (n_dof), and its rounding error.
    real(wp), allocatable :: u(:), v(:), u_rest(:), v_rest(:)
    !> Largest last Legendre coefficient of the displacements on a step, and largest
    !! displacement, shape (n_dof): their ratio shows how well steps resolve the motion.
    real(wp), allocatable :: roughness(:), largest(:)
    !> Maps for each step length.
    type(step_map_type), allocatable :: maps(:)
  contains
    procedure :: set_state
    procedure :: get_state
    procedure :: kick
    procedure :: make_maps
    procedure :: observe
    procedure :: inside
    procedure :: furthest
    procedure :: n_observed
    procedure :: resolution
    procedure :: n_saved
    procedure :: n_phases
    procedure :: save_state
    procedure :: saved_of_state
    procedure :: load_state
    procedure :: starts_moving
    procedure :: make_start
    procedure :: plain_step
    procedure :: stand_still
    procedure :: begin_panels
  end type hereditary_type

  !> Share of nonlinear forces in the displacements above which a motion may escape in a step.
  real(wp), parameter :: bending = 1.0e-3_wp
  !> Largest number of nodes of a step.
  integer, parameter :: most_nodes = 8

contains

  !> A run from (u, v) at time 0, shape (n_dof). `reason`: `begun`, or why the run cannot start.
  subroutine new_hereditary(run, system, load, request, u, v, reason)
    type(hereditary_type), intent(out) :: run
    class(oscillator_type), intent(in), target :: system
    type(time_load_type), intent(in) :: load
    type(past_request), intent(in) :: request
    real(wp), intent(in) :: u(:), v(:)
    integer, intent(out) :: reason

    call run%set_state(u, v)
    run%roughness = 0.0_wp*u
    run%largest = 0.0_wp*u
    allocate (run%maps(1))
    call run%begin(system, load, request, reason)
    if (reason == begun) call run%begin_equations(run%maps(run%now), request%tolerance)
  end subroutine new_hereditary

  !> Start the next step at the present state, without extrapolation from the previous step.
  subroutine stand_still(self)
    class(hereditary_type), intent(inout) :: self
    call self%equations%start_bends(self%system, self%maps(self%now), self%u, self%v)
    self%points(self%table%s + 1, :) = self%u
    self%rolling = .false.
  end subroutine stand_still

  pure subroutine set_state(self, u, v)
    class(hereditary_type), intent(inout) :: self
    real(wp), intent(in) :: u(:), v(:)
    self%u = u
    self%v = v
    self%u_rest = 0.0_wp*u
    self%v_rest = 0.0_wp*v
  end subroutine set_state

  !> Add a jump to the state relative to the base.
  subroutine kick(self, base, displacement, velocity)
    class(hereditary_type), intent(inout) :: self
    type(base_motion_type), intent(in) :: base
    real(wp), intent(in) :: displacement(:), velocity(:)
    call add_any(self%u, self%u_rest, base%of_coordinates(displacement))
    call add_any(self%v, self%v_rest, base%of_coordinates(velocity))
  end subroutine kick

  subroutine make_maps(self, singular)
    class(hereditary_type), intent(inout) :: self
    logical, intent(out) :: singular
    type(step_map_type), allocatable :: grown(:)

    if (self%now > size(self%maps)) then
      allocate (grown(size(self%lengths)))
      grown(:self%now - 1) = self%maps
      call move_alloc(grown, self%maps)
    end if
    call new_step_map(self%maps(self%now), self%system, self%channels, self%table, self%h, singular)
  end subroutine make_maps

  !> One step to time `until`, as a polynomial.
  subroutine plain_step(self, until, made)
    class(hereditary_type), intent(inout) :: self
    real(wp), intent(in) :: until
    logical, intent(out) :: made
    integer :: d, n, s

    s = self%table%s
    n = size(self%u)
    if (counting) call count_up(counted_coordinates, n)
    if (self%system%moving) call rename_start(self)
    associate (z => self%equations%z, map => self%maps(self%now))
      z(:n) = self%u
      z(n + 1:2*n) = self%v
      call self%clock%at_nodes(self%load, z(map%at_load + 1:map%at_memory))
      if (map%n_channels > 0) then
        call self%history%recall(z(map%at_memory + 1:map%at_bend))
        call add_held(s*map%n_channels, map%held, z(map%at_memory + 1:map%at_bend))
      end if
      call self%equations%predict(map, self%rolling)
      z(map%at_bend + 1:) = self%equations%y_start
      call self%equations%iterate(self%system, map, self%u, made)
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
  subroutine rename_start(self)
    class(hereditary_type), intent(inout) :: self
    real(wp) :: u(size(self%u)), v(size(self%u))
    logical :: renamed

    u = self%u + self%u_rest
    v = self%v + self%v_rest
    call self%system%rename_state(u, v, renamed)
    if (.not. renamed) return
    call self%set_state(u, v)
    call self%stand_still()
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

  pure logical function starts_moving(self)
    class(hereditary_type), intent(in) :: self
    starts_moving = any(abs(self%u) > 0.0_wp) .or. any(abs(self%v) > 0.0_wp)
  end function starts_moving

  subroutine make_start(self, made)
    class(hereditary_type), intent(inout), target :: self
    logical, intent(out) :: made
    type(direct_panels) :: panels

    panels%u = self%u
    panels%v = self%v
    call march_start(self%start, self%system, self%channels, self%load, self%known_past, self%h, &
                     panels, made)
    if (made) made = all(abs(panels%u) <= self%bound) .and. all(abs(panels%v) <= self%bound)
    if (.not. made) return
    self%u = panels%u
    self%v = panels%v
    call move_alloc(panels%begins, self%start%begins)
    call move_alloc(panels%rises, self%start%rises)
  end subroutine make_start

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

  pure integer function n_saved(self)
    class(hereditary_type), intent(in) :: self
    n_saved = 6*size(self%u) + self%n_phases()
  end function n_saved

  pure integer function n_phases(self)
    class(hereditary_type), intent(in) :: self
    n_phases = 2*size(self%clock%high)
  end function n_phases

  function save_state(self) result(saved)
    class(hereditary_type), intent(in) :: self
    real(wp) :: saved(self%n_saved())
    saved = [self%u, self%v, self%u_rest, self%v_rest, self%roughness, self%largest, &
             self%clock%high, self%clock%low]
  end function save_state

  !> True for the numbers of a saved state but those of its assessment and phases.
  function saved_of_state(self) result(flags)
    class(hereditary_type), intent(in) :: self
    logical :: flags(self%n_saved())
    flags = .false.
    flags(:4*size(self%u)) = .true.
  end function saved_of_state

  subroutine load_state(self, saved, other_load)
    class(hereditary_type), intent(inout) :: self
    real(wp), intent(in) :: saved(:)
    logical, intent(in) :: other_load
    integer :: n

    n = 0
    call pull(saved, n, self%u)
    call pull(saved, n, self%v)
    call pull(saved, n, self%u_rest)
    call pull(saved, n, self%v_rest)
    call pull(saved, n, self%roughness)
    call pull(saved, n, self%largest)
    if (other_load) return
    call pull(saved, n, self%clock%high)
    call pull(saved, n, self%clock%low)
  end subroutine load_state

end module viscovib_hereditary
