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

  type :: hereditary_type
    real(wp) :: h = 0.0_wp
    !> State, shape (n_dof), and what rounding took from it.
    real(wp), allocatable :: u(:), v(:), u_rest(:), v_rest(:)
    !> Largest last Legendre coefficient of the displacements on a step, and largest
    !! displacement, shape (n_dof): together they tell how well steps resolve the motion.
    real(wp), allocatable :: roughness(:), largest(:)
    type(collocation_type) :: table
    type(step_map_type) :: map
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
  contains
    procedure :: step
    procedure :: inside
    procedure :: resolution
    procedure :: memory_size
    procedure :: save_memory
    procedure :: load_memory
    procedure, private :: add_first_step
    procedure, private :: stand_still
  end type hereditary_type

contains

  !> A run from (u, v) at time 0. `reason`: `begun`, or why it is not.
  subroutine new_hereditary(run, system, load, s, past, held, u, v, h, t_end, tolerance, reason, &
                            before, moved)
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
    call new_step_map(run%map, system, run%channels, run%table, h, singular)
    if (singular) then
      reason = step_too_large
      return
    end if
    if (past == past_exponentials) then
      allocate (exponentials)
      call new_exponential_history(exponentials, system, run%channels, run%table, h, t_end, &
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
    if (present(before) .and. run%map%n_channels > 0) then
      call new_ancient(run%ancient, system, run%channels, before, moved)
      if (run%ancient%is_known()) call run%history%add_ancient(run%ancient)
    end if
    call new_clock(run%clock, load, 0.0_wp, h, run%table%points(1:s))
    run%gather = matmul(run%channels%gather, system%gather)
    run%gather_bends = run%channels%gather(:, run%map%bent)
    allocate (run%points(0:s + 1, size(u)), run%g(0:s + 1, run%map%n_channels))
    run%points = 0.0_wp
    call new_step_equations(run%equations, run%map, run%table, &
                            max(1.0e-2_wp*tolerance, epsilon(1.0_wp)))
    call run%stand_still(system)
  end subroutine new_hereditary

  !> The next step begins at the present state and knows of no step before.
  subroutine stand_still(self, system)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    call self%equations%start_bends(system, self%map, self%u)
    self%points(self%table%s + 1, :) = self%u
    self%rolling = .false.
  end subroutine stand_still

  !> One step; `made` is false, and the state stays, if its equations do not settle.
  subroutine step(self, system, load, n_before, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    !> Steps made before.
    integer(i8), intent(in) :: n_before
    logical, intent(out) :: made
    integer :: d, n, s

    s = self%map%s
    n = self%map%n_dof
    if (n_before == 0) then
      call self%add_first_step(system, load, made)
      if (made) return
    end if
    if (counting) call count_up(counted_coordinates, n)
    associate (z => self%equations%z)
      z(:n) = self%u
      z(n + 1:2*n) = self%v
      call self%clock%at_nodes(load, z(self%map%at_load + 1:self%map%at_memory))
      if (self%map%n_channels > 0) then
        call self%history%recall(z(self%map%at_memory + 1:self%map%at_bend))
        call add_held(s*self%map%n_channels, self%map%held, &
                      z(self%map%at_memory + 1:self%map%at_bend))
      end if
      call self%equations%predict(self%map, self%rolling)
      z(self%map%at_bend + 1:) = self%equations%y_start
    end associate
    call self%equations%iterate(system, self%map, self%u, made)
    if (.not. made) return
    associate (x => self%equations%x)
      do d = 1, n
        self%points(0, d) = self%u(d)
        self%points(1:, d) = self%u(d) + x((d - 1)*(s + 1) + 1:d*(s + 1))
        call judge(s + 2, self%points(:, d), self%table%last_coefficient, self%roughness(d), &
                   self%largest(d))
        call add_up(self%u(d), self%u_rest(d), x(d*(s + 1)))
        call add_up(self%v(d), self%v_rest(d), x(self%map%velocity_row + d - 1))
      end do
    end associate
    if (self%map%n_channels > 0) then
      call gather_channels(s + 2, n, size(self%equations%y_start), self%map%n_channels, &
                           self%points, self%equations%y_start, self%equations%y, self%gather, &
                           self%gather_bends, self%channels%held, self%g)
      if (counting) call count_up(counted_memory, self%map%n_channels)
      call self%history%store(self%g)
    end if
    call self%clock%advance((n_before + 1)*self%h)
    self%rolling = .true.
  end subroutine step

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
    if (self%map%n_channels == 0) return
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
    memory_size = 2 + 4*size(self%u) + size(self%equations%y_start) + size(self%equations%y) &
                  + 2*size(self%clock%high)
    if (self%map%n_channels > 0) memory_size = memory_size + self%history%memory_size()
  end function memory_size

  function save_memory(self) result(memory)
    class(hereditary_type), intent(in) :: self
    real(wp) :: memory(self%memory_size())
    integer :: n

    n = 0
    call push([merge(1.0_wp, 0.0_wp, self%rolling), self%clock%t])
    call push([self%u, self%v, self%u_rest, self%v_rest])
    call push([self%equations%y_start, self%equations%y])
    call push([self%clock%high, self%clock%low])
    if (self%map%n_channels > 0) call push(self%history%save_memory())

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
    n = 2
    call pull(self%u)
    call pull(self%v)
    call pull(self%u_rest)
    call pull(self%v_rest)
    call pull(self%equations%y_start)
    call pull(self%equations%y)
    call pull(self%clock%high)
    call pull(self%clock%low)
    if (self%map%n_channels > 0) call self%history%load_memory(memory(n + 1:))

  contains

    subroutine pull(part)
      real(wp), intent(out) :: part(:)
      part = memory(n + 1:n + size(part))
      n = n + size(part)
    end subroutine pull

  end subroutine load_memory

end module viscovib_hereditary
