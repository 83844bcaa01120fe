!> Motion with memory in equal steps: Gauss collocation of the accelerations, with
!! hereditary variables remembered as polynomials through the nodes and both ends.
!!
!! The maps of a step are in `hereditary_maps`, its nonlinear equations in
!! `step_equations`.
module viscovib_hereditary
  use viscovib_ancient, only: ancient_type, new_ancient
  use viscovib_channels, only: channels_type, new_channels
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_counters, only: count_up, counted_coordinates, counted_memory, counting
  use viscovib_direct_history, only: direct_history_type, new_direct_history
  use viscovib_exponential_history, only: exponential_history_type, new_exponential_history
  use viscovib_hereditary_kernels, only: add_held, add_up, gather_channels, judge
  use viscovib_hereditary_maps, only: new_step_map, step_map_type
  use viscovib_hereditary_start, only: march_start, start_type
  use viscovib_history, only: history_type
  use viscovib_kinds, only: i8, wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_step_equations, only: new_step_equations, step_equations_type
  use viscovib_time_load, only: load_clock, new_clock, time_load_type
  implicit none
  private

  public :: hereditary_type, new_hereditary

  !> How the past is kept: as exponentials, or step by step.
  integer, parameter, public :: past_exponentials = 1, past_direct = 2
  !> Why no run can be made.
  integer, parameter, public :: begun = 0, no_exponentials = 1, step_too_large = 2, no_integral = 3

  !> Doublings from the first panel after a corner or a jump of the load to a step:
  !! accelerations follow it like t^(2+alpha) at most, so that fewer are needed than at a
  !! start, see `viscovib_hereditary_start`.
  integer, parameter :: corner_doublings = 14
  !> Lengths of steps whose maps are kept for when they come again.
  integer, parameter :: most_lengths = 64

  type :: hereditary_type
    real(wp) :: h = 0.0_wp
    !> State, shape (n_dof), and what rounding took from it.
    real(wp), allocatable :: u(:), v(:), u_rest(:), v_rest(:)
    !> Largest last Legendre coefficient of the displacements on a step, and largest
    !! displacement, shape (n_dof): together they tell how well steps resolve the motion.
    real(wp), allocatable :: roughness(:), largest(:)
    type(collocation_type) :: table
    !> Maps by length of step, and the place of the present one.
    type(step_map_type), allocatable :: maps(:)
    integer :: now = 1
    type(step_equations_type) :: equations
    type(channels_type) :: channels
    class(history_type), allocatable :: history
    type(load_clock) :: clock
    type(start_type) :: start
    type(ancient_type) :: ancient
    !> Displacements at the points of the last step, shape (0:s+1, n_dof).
    real(wp), allocatable :: points(:, :)
    !> T W, shape (n_channels, n_dof), and T of the bent variables.
    real(wp), allocatable, private :: gather(:, :), gather_bends(:, :)
    !> Room for a step: channels at the points.
    real(wp), allocatable, private :: g(:, :)
    !> The next step follows one of its own kind.
    logical, private :: rolling = .false.
    !> Lengths of the maps; how many there are; whether some kernel is so steep at the
    !! start that a motion with a corner needs panels after it.
    real(wp), allocatable, private :: lengths(:)
    integer, private :: n_lengths = 0
    logical, private :: steep = .false.
    !> The next step follows a corner of the load.
    logical, private :: at_corner = .false.
  contains
    procedure :: step
    procedure :: enter
    procedure :: inside
    procedure :: resolution
    procedure :: memory_size
    procedure :: save_memory
    procedure :: load_memory
    procedure, private :: add_first_step
    procedure, private :: add_graded_step
    procedure, private :: plain_step
    procedure, private :: change_step
    procedure, private :: stand_still
  end type hereditary_type

contains

  !> A run from (u, v) at time 0. `reason`: `begun`, or why it is not.
  subroutine new_hereditary(run, system, load, s, past, held, u, v, h, t_end, tolerance, reason, &
                            before, moved, shortest)
    type(hereditary_type), intent(out) :: run
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    !> Nodes of a step; `past_exponentials` or `past_direct`.
    integer, intent(in) :: s, past
    !> Displacement held for all t < 0, shape (n_dof): what is remembered.
    real(wp), intent(in) :: held(:)
    !> Start, shape (n_dof); step; latest time; relative error of the kernels as
    !! exponentials and of a step's solution.
    real(wp), intent(in) :: u(:), v(:), h, t_end, tolerance
    integer, intent(out) :: reason
    !> Times ascending to 0 and displacements there, shapes (n) and (n_dof, n), if the
    !! motion before 0 is known; `held` is the first of them then.
    real(wp), intent(in), optional :: before(:), moved(:, :)
    !> Shortest step of a run whose steps change after corners of the load.
    real(wp), intent(in), optional :: shortest
    real(wp) :: least
    type(exponential_history_type), allocatable :: exponentials
    type(direct_history_type), allocatable :: direct
    logical :: possible, singular

    reason = begun
    run%h = h
    run%u = u
    run%v = v
    run%u_rest = 0.0_wp*u
    run%roughness = 0.0_wp*u
    run%largest = 0.0_wp*u
    run%v_rest = 0.0_wp*v
    call new_collocation(run%table, s)
    if (any(abs(held) > 0.0_wp) .and. system%kernel_without_integral() > 0) then
      reason = no_integral
      return
    end if
    call new_channels(run%channels, system, held)
    allocate (run%maps(1), run%lengths(1))
    run%lengths = h
    run%n_lengths = 1
    call new_step_map(run%maps(1), system, run%channels, run%table, h, singular)
    if (singular) then
      reason = step_too_large
      return
    end if
    least = h
    if (present(shortest)) then
      run%steep = is_steep(system, run%channels, h)
      least = min(h, shortest)
      if (run%steep) least = scale(least, -corner_doublings - 1)
    end if
    if (past == past_exponentials) then
      allocate (exponentials)
      call new_exponential_history(exponentials, system, run%channels, run%table, h, least, t_end, &
                                   max(tolerance, 1.0e-14_wp), possible)
      if (.not. possible) then
        reason = no_exponentials
        return
      end if
      call move_alloc(exponentials, run%history)
    else
      allocate (direct)
      call new_direct_history(direct, system, run%channels, run%table, h)
      call move_alloc(direct, run%history)
    end if
    if (present(before) .and. run%maps(1)%n_channels > 0) then
      call new_ancient(run%ancient, system, run%channels, before, moved)
      if (run%ancient%is_known()) call run%history%add_ancient(run%ancient)
    end if
    call new_clock(run%clock, load, 0.0_wp, h, run%table%points(1:s))
    run%gather = matmul(run%channels%gather, system%gather)
    run%gather_bends = run%channels%gather(:, run%maps(1)%bent)
    allocate (run%points(0:s + 1, size(u)), run%g(0:s + 1, run%maps(1)%n_channels))
    run%points = 0.0_wp
    call new_step_equations(run%equations, run%maps(1), run%table, &
                            max(1.0e-2_wp*tolerance, epsilon(1.0_wp)))
    call run%stand_still(system)
  end subroutine new_hereditary

  !> The next step begins at the present state and knows of no step before.
  subroutine stand_still(self, system)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    call self%equations%start_bends(system, self%maps(self%now), self%u)
    self%points(self%table%s + 1, :) = self%u
    self%rolling = .false.
  end subroutine stand_still

  !> Whether a kernel grows without bound towards 0, or falls off well within a step h.
  logical function is_steep(system, channels, h)
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    real(wp), intent(in) :: h
    real(wp) :: values(2)
    integer :: k

    is_steep = .false.
    do k = 1, size(system%kernels)
      if (.not. any(channels%kernel_of == k)) cycle
      call system%kernels(k)%kernel%value([1.0e-9_wp*h, 1.0e-2_wp*h], values)
      is_steep = is_steep .or. abs(values(1) - values(2)) > 0.1_wp*abs(values(2))
    end do
  end function is_steep

  !> A piece of the mesh begins at time t, in steps h: the load has a corner there.
  !! `made` is false where such steps are too large.
  subroutine enter(self, system, load, t, h, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: t, h
    logical, intent(out) :: made
    call self%change_step(system, load, t, h, made)
    self%at_corner = self%steep
  end subroutine enter

  !> Steps from time t on are h long.
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
    if (self%maps(1)%n_channels > 0) call self%history%change_step(h)
    singular = .false.
    call find_map(self, h)
    if (self%now > self%n_lengths) then
      call new_step_map(self%maps(self%now), system, self%channels, self%table, h, singular)
      self%lengths(self%now) = h
      if (.not. singular) self%n_lengths = self%now
    end if
    made = .not. singular
  end subroutine change_step

  !> The place of the map of steps h, or where it is to be put: `now`.
  subroutine find_map(self, h)
    class(hereditary_type), intent(inout) :: self
    real(wp), intent(in) :: h
    type(step_map_type), allocatable :: grown(:)
    integer :: n

    do n = 1, self%n_lengths
      if (abs(self%lengths(n) - h) <= 0.0_wp) exit
    end do
    self%now = n
    if (n <= size(self%maps)) return
    if (n > most_lengths) then
      self%n_lengths = 0
      self%now = 1
      return
    end if
    allocate (grown(min(most_lengths, 2*n)))
    grown(:n - 1) = self%maps
    call move_alloc(grown, self%maps)
    self%lengths = [self%lengths, spread(0.0_wp, 1, size(self%maps) - size(self%lengths))]
  end subroutine find_map

  !> One step to time `until`; `made` is false, and the state stays, if its equations do
  !! not settle.
  subroutine step(self, system, load, n_before, until, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    !> Steps made before.
    integer(i8), intent(in) :: n_before
    real(wp), intent(in) :: until
    logical, intent(out) :: made
    logical :: graded

    graded = self%at_corner
    self%at_corner = .false.
    if (n_before == 0) then
      call self%add_first_step(system, load, made)
      if (made) return
    end if
    if (graded) then
      call self%add_graded_step(system, load, until, made)
    else
      call self%plain_step(system, load, until, made)
    end if
  end subroutine step

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
        self%points(0, d) = self%u(d)
        self%points(1:, d) = self%u(d) + x((d - 1)*(s + 1) + 1:d*(s + 1))
        call judge(s + 2, self%points(:, d), self%table%last_coefficient, self%roughness(d), &
                   self%largest(d))
        call add_up(self%u(d), self%u_rest(d), x(d*(s + 1)))
        call add_up(self%v(d), self%v_rest(d), x(map%velocity_row + d - 1))
      end do
      if (map%n_channels > 0) then
        call gather_channels(s + 2, n, size(self%equations%y_start), map%n_channels, &
                             self%points, self%equations%y_start, self%equations%y, self%gather, &
                             self%gather_bends, self%channels%held, self%g)
        if (counting) call count_up(counted_memory, map%n_channels)
        call self%history%store(self%g)
      end if
    end associate
    call self%clock%advance(until)
    self%rolling = .true.
  end subroutine plain_step

  !> One step after a corner of the load, as panels that double their length: a motion
  !! remembered by a steep kernel is not smooth there. Lengths are powers of 2 but for
  !! the last, so that other steps find their maps again.
  subroutine add_graded_step(self, system, load, until, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: until
    logical, intent(out) :: made
    real(wp), dimension(size(self%u)) :: u, v
    real(wp) :: from, h, ends(0:corner_doublings + 1)
    integer :: k, n

    h = self%h
    from = self%clock%t
    u = self%u
    v = self%v
    ends = panel_ends(h)
    n = ubound(ends, 1)
    self%start%table = self%table
    self%start%ends = ends
    if (allocated(self%start%points)) deallocate (self%start%points)
    allocate (self%start%points(0:self%table%s + 1, size(u), n))
    do k = 1, n
      call self%change_step(system, load, from + ends(k - 1), ends(k) - ends(k - 1), made)
      if (made) call self%plain_step(system, load, from + ends(k), made)
      if (.not. made) then
        self%u = u
        self%v = v
        return
      end if
      self%start%points(:, :, k) = self%points
    end do
    call self%change_step(system, load, until, h, made)
  end subroutine add_graded_step

  !> 0, then powers of 2 that double, then h.
  pure function panel_ends(h) result(ends)
    real(wp), intent(in) :: h
    real(wp) :: ends(0:corner_doublings + 1)
    integer :: k
    ends(0) = 0.0_wp
    do k = 1, corner_doublings
      ends(k) = scale(1.0_wp, exponent(h) - 1 - corner_doublings + k)
    end do
    ! The last power of 2 is at most 3 h/4.
    if (ends(corner_doublings) > 0.75_wp*h) ends(1:corner_doublings) = &
      0.5_wp*ends(1:corner_doublings)
    ends(corner_doublings + 1) = h
  end function panel_ends

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
  !! `made` is false where a plain step will do.
  subroutine add_first_step(self, system, load, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    logical, intent(out) :: made
    real(wp) :: f(size(self%u))

    made = .false.
    if (self%maps(1)%n_channels == 0) return
    call load%at(0.0_wp, f)
    if (.not. (any(abs(self%u) > 0.0_wp) .or. any(abs(self%v) > 0.0_wp) &
               .or. any(abs(f) > 0.0_wp) .or. self%ancient%is_known())) return
    call march_start(self%start, system, self%channels, load, self%ancient, self%h, self%u, &
                     self%v, made)
    if (.not. made) return
    call self%history%begin(self%start%table, self%start%past)
    call self%clock%advance(self%h)
    call self%stand_still(system)
  end subroutine add_first_step

  !> State a fraction of a step back from its end, by the polynomial of the step.
  subroutine inside(self, theta, u, v)
    class(hereditary_type), intent(in) :: self
    !> In [0, 1], 1 at the end of the last step.
    real(wp), intent(in) :: theta
    real(wp), intent(out) :: u(:), v(:)
    if (self%rolling .or. .not. allocated(self%start%ends)) then
      u = matmul(self%table%basis(theta), self%points)
      v = matmul(self%table%slopes(theta), self%points)/self%h
    else
      call self%start%at(theta*self%h, u, v)
    end if
  end subroutine inside

  pure integer function memory_size(self)
    class(hereditary_type), intent(in) :: self
    memory_size = 3 + 4*size(self%u) + size(self%equations%y_start) + size(self%equations%y) &
                  + 2*size(self%clock%high)
    if (self%maps(1)%n_channels > 0) memory_size = memory_size + self%history%memory_size()
  end function memory_size

  function save_memory(self) result(memory)
    class(hereditary_type), intent(in) :: self
    real(wp) :: memory(self%memory_size())
    integer :: n

    n = 0
    call push([merge(1.0_wp, 0.0_wp, self%rolling), self%clock%t, &
               merge(1.0_wp, 0.0_wp, self%at_corner)])
    call push([self%u, self%v, self%u_rest, self%v_rest])
    call push([self%equations%y_start, self%equations%y])
    call push([self%clock%high, self%clock%low])
    if (self%maps(1)%n_channels > 0) call push(self%history%save_memory())

  contains

    subroutine push(part)
      real(wp), intent(in) :: part(:)
      memory(n + 1:n + size(part)) = part
      n = n + size(part)
    end subroutine push

  end function save_memory

  subroutine load_memory(self, memory)
    class(hereditary_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    integer :: n

    self%rolling = memory(1) > 0.5_wp
    self%clock%t = memory(2)
    self%at_corner = memory(3) > 0.5_wp
    n = 3
    call pull(self%u)
    call pull(self%v)
    call pull(self%u_rest)
    call pull(self%v_rest)
    call pull(self%equations%y_start)
    call pull(self%equations%y)
    call pull(self%clock%high)
    call pull(self%clock%low)
    if (self%maps(1)%n_channels > 0) call self%history%load_memory(memory(n + 1:))

  contains

    subroutine pull(part)
      real(wp), intent(out) :: part(:)
      part = memory(n + 1:n + size(part))
      n = n + size(part)
    end subroutine pull

  end subroutine load_memory

end module viscovib_hereditary
