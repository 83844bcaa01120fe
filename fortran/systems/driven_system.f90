! Optimize: -O2
!> The abstract system for time integrators:
!!
!!   q'' = a(q, q', cos(p_1 t), ..., cos(p_m t)),
!!
!! evaluated for a block of vector lanes. The lanes are the nodes of a collocation step or different
!! trajectories.
module viscovib_driven_system
  use viscovib_base_motion, only: base_motion_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_branches, only: signal_type
  use viscovib_law_layers, only: law_layers
  use viscovib_modal_frame, only: modal_frame
  use viscovib_steep_laws, only: steep_law
  use viscovib_vector_math, only: largest_angle, sine_cosine_array
  implicit none
  private

  public :: driven_system_type, differentiable_system_type, range_type, range_of_degree

  !> Limits for a coordinate, a velocity and a change of accelerations in an iteration, beyond which
  !! the solution diverges. Defaults: angles and dimensionless quantities.
  type :: range_type
    real(wp) :: coordinate = largest_angle, speed = 1.0e15_wp, push = 1.0e15_wp
  end type range_type

  type, abstract :: driven_system_type
    integer :: n_dof = 0
    !> Number of last coordinates that represent memory; results do not contain them.
    integer :: n_hidden = 0
    !> Initial rates of the memory coordinates; not allocated: 0.
    real(wp), allocatable :: hidden_speeds(:)
    !> Fastest relaxation rate (1/s). After a switch the substeps start shorter than its time scale,
    !! and double.
    real(wp) :: fading = 0.0_wp
    !> Circular frequencies of the loads (rad/s or dimensionless).
    real(wp), allocatable :: drives(:)
    !> Quarter turns ahead of each load, 0 to 3 (3 turns the cosine into a sine). Not allocated:
    !! none.
    integer, allocatable :: quarters(:)
    !> True if the last drive, of frequency 0, is the time since the start of the current interval,
    !! in which the load is smooth.
    logical :: timed = .false.
    !> Start and end of the current interval.
    real(wp) :: present_piece(2) = 0.0_wp
    !> True if the coordinates can leave the domain of the equations.
    logical :: limited = .true.
    !> Limits of the variables.
    type(range_type) :: range
    !> Switching surfaces: sign changes of a signal, where the equations have kinks or jumps. Not
    !! allocated: none.
    type(signal_type), allocatable :: signals(:)
    !> True if `linearise` is implemented and efficient.
    logical :: sloped = .false.
    !> Thin layers of the forces that steps may skip, and whether substeps resolve them.
    type(law_layers) :: layers
    logical :: in_parts = .false.
    !> Layers of each vector lane, if forces differ; not allocated: equal in all.
    type(law_layers), allocatable :: lane_layers(:)
    !> Largest thinness of a layer in a substep.
    real(wp) :: thin = 1.0_wp
    !> Step size of a run.
    real(wp) :: step_length = 0.0_wp
    !> Side of each surface when a run continues, and whether the solution is on the surface; not
    !! allocated: computed from the state.
    integer, allocatable :: sides(:)
    logical, allocatable :: fresh(:)
    !> True if the solution or its load starts with the run; otherwise the longest next substep (0:
    !! any).
    logical :: begins = .true.
    real(wp) :: grade = 0.0_wp
    !> Motion of the base, to which coordinates are relative.
    type(base_motion_type) :: base_motion
    !> Modal coordinates of the linear subsystem, if steps integrate them exactly.
    type(modal_frame), allocatable :: frame
    !> Laws that steps solve for (not allocated: none), their rates by velocities and displacements,
    !! shape (n_steep, n_dof), and the accelerations by unit forces, shape (n_dof, n_steep), also of
    !! a motion that stays on its surfaces; then they are 0 if the rate of the law stays 0.
    type(steep_law), allocatable :: steep(:)
    real(wp), allocatable, dimension(:, :) :: steep_rates, steep_places, steep_pushes, steep_held
    !> Largest acceleration by a law that jumps at rest.
    real(wp) :: jump_at_rest = 0.0_wp
    !> The steep law of each surface, 0: none.
    integer, allocatable :: steep_of(:)
  contains
    procedure :: settle
    procedure :: first_part
    procedure :: linearise
    procedure :: push
    procedure :: steep_forces
    procedure(acceleration_interface), deferred :: acceleration
    procedure(margin_interface), deferred :: margin
    procedure :: margin_within
    procedure :: physical
    procedure :: enter
    procedure :: take_sides
    procedure :: signal_at
    procedure :: meet
    procedure :: jump
    procedure :: jump_on
    procedure :: add_base
    procedure :: start
    procedure :: longest_part
    procedure :: drive_at
    procedure :: n_laws
    procedure :: law_forces
  end type driven_system_type

  !> A system with derivatives.
  type, extends(driven_system_type), abstract :: differentiable_system_type
  contains
    procedure(tangent_interface), deferred :: tangent
    procedure(potential_interface), deferred :: potential
  end type differentiable_system_type

  abstract interface

    !> a(q, q', drive) in every vector lane.
    pure subroutine acceleration_interface(self, q, v, drive, a)
      import :: driven_system_type, n_lanes, wp
      class(driven_system_type), intent(in) :: self
      !> Coordinates and velocities, shape (n_lanes, n_dof).
      real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
      !> cos(p_j t + quarters_j pi/2), shape (n_lanes, size(drives)).
      real(wp), intent(in) :: drive(n_lanes, size(self%drives))
      real(wp), intent(out) :: a(n_lanes, self%n_dof)
    end subroutine acceleration_interface

    !> Accelerations, and their derivative in the direction (dq, dv).
    pure subroutine tangent_interface(self, q, v, drive, dq, dv, a, da)
      import :: differentiable_system_type, n_lanes, wp
      class(differentiable_system_type), intent(in) :: self
      real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
      real(wp), intent(in) :: drive(n_lanes, size(self%drives))
      real(wp), intent(in) :: dq(n_lanes, self%n_dof), dv(n_lanes, self%n_dof)
      real(wp), intent(out) :: a(n_lanes, self%n_dof), da(n_lanes, self%n_dof)
    end subroutine tangent_interface

    !> Potential energy of a state, without the loads, and its derivatives.
    pure subroutine potential_interface(self, q, value, slope)
      import :: differentiable_system_type, wp
      class(differentiable_system_type), intent(in) :: self
      real(wp), intent(in) :: q(self%n_dof)
      real(wp), intent(out) :: value, slope(self%n_dof)
    end subroutine potential_interface

    !> Positive inside the domain of the equations.
    pure function margin_interface(self, q) result(margin)
      import :: driven_system_type, n_lanes, wp
      class(driven_system_type), intent(in) :: self
      real(wp), intent(in) :: q(n_lanes, self%n_dof)
      real(wp) :: margin(n_lanes)
    end function margin_interface

  end interface

contains

  !> Lower bound of the margin within a short time before and after states.
  pure function margin_within(self, q, v, time) result(least)
    class(driven_system_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof), time
    real(wp) :: least(n_lanes)
    real(wp) :: here(n_lanes)
    here = self%margin(q)
    least = here - abs(self%margin(q + time*v) - here)
  end function margin_within

  !> Longest substep that two runs may share, from states in the step.
  real(wp) function longest_part(self, q, v)
    class(driven_system_type), intent(in) :: self
    !> Shape (n, n_dof).
    real(wp), intent(in) :: q(:, :), v(:, :)
    longest_part = huge(1.0_wp)
    if (size(q, 2) /= self%n_dof .or. size(v, 2) /= self%n_dof) longest_part = 0.0_wp
  end function longest_part

  !> Limits for equations in arbitrary units. A diverging solution ends when its time step vanishes;
  !! the limits only prevent overflow of powers.
  pure type(range_type) function range_of_degree(degree, walled) result(range)
    !> Highest power of coordinates and velocities.
    integer, intent(in) :: degree
    !> True if laws end at walls, which a solution reaches with a large velocity.
    logical, intent(in) :: walled
    real(wp) :: largest
    largest = 10.0_wp**(250.0_wp/max(degree, 1))
    range%coordinate = min(1.0e30_wp, largest)
    range%speed = min(merge(1.0e30_wp, 1.0e100_wp, walled), largest)
    range%push = min(1.0e60_wp, largest)
  end function range_of_degree

  !> Start a time interval in which the load is smooth.
  subroutine enter(self, from, to)
    class(driven_system_type), intent(inout) :: self
    real(wp), intent(in) :: from, to
    self%present_piece = [from, to]
  end subroutine enter

  !> Fix a side of each surface, where the equations are smooth. The signals then are those of this
  !! side.
  subroutine take_sides(self, sides)
    class(driven_system_type), intent(inout) :: self
    !> For each signal: 1, -1, 0 (side of the state), or `slides` (stay on the surface).
    integer, intent(in) :: sides(:)
    if (size(sides) > 0) self%signals = self%signals
  end subroutine take_sides

  !> First substep after a switch; 0: any length. It is a fraction of the step, because errors of
  !! substeps independent of the step size are not visible when runs are compared.
  pure real(wp) function first_part(self)
    class(driven_system_type), intent(in) :: self
    real(wp), parameter :: within = 0.5_wp, of_step = 0.25_wp
    first_part = 0.0_wp
    if (self%fading*self%step_length > within) then
      first_part = min(within/self%fading, of_step*self%step_length)
    end if
  end function first_part

  !> Initialize elements with internal state at the start of a solution.
  subroutine settle(self, q, v)
    class(driven_system_type), intent(inout) :: self
    real(wp), intent(in) :: q(:), v(:)
    ! A system without elements has no internal state.
    self%step_length = self%step_length + 0.0_wp*(q(1) + v(1))
  end subroutine settle

  !> Accelerations, and derivatives by coordinates and velocities, (n_lanes, equation, by).
  pure subroutine linearise(self, q, v, drive, a, by_q, by_v)
    class(driven_system_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    real(wp), intent(out), dimension(n_lanes, self%n_dof, self%n_dof) :: by_q, by_v
    ! Only called if `sloped`.
    call self%acceleration(q, v, drive, a)
    by_q = 0.0_wp
    by_v = 0.0_wp
  end subroutine linearise

  !> Accelerations minus those of the linear subsystem and of steep laws, which are given.
  pure subroutine push(self, q, v, drive, rest, a)
    class(driven_system_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives)), rest(n_lanes, self%n_dof)
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    call self%acceleration(q, v, drive, a)
    a = a - rest
  end subroutine push

  !> Forces of a steep law and their derivatives by w (viscovib_steep_laws) at states.
  subroutine steep_forces(self, which, q, v, roots, forces, slopes)
    class(driven_system_type), intent(in) :: self
    integer, intent(in) :: which
    !> Shapes (n, n_dof) and (n).
    real(wp), intent(in) :: q(:, :), v(:, :), roots(:)
    real(wp), intent(out) :: forces(:), slopes(:)
    ! Only called for systems with steep laws.
    forces = 0.0_wp*roots*(q(:, 1) + v(:, 1))*(self%n_dof + which)
    slopes = 0.0_wp
  end subroutine steep_forces

  !> Event function of a surface at states: its signal or, in sliding, a function that is positive
  !! until the solution leaves the surface.
  subroutine signal_at(self, k, t, q, v, g)
    class(driven_system_type), intent(in) :: self
    integer, intent(in) :: k
    !> Shapes (n) and (n, n_dof).
    real(wp), intent(in) :: t(:), q(:, :), v(:, :)
    real(wp), intent(out) :: g(:)
    call self%signals(k)%at(t, q, v, g)
  end subroutine signal_at

  !> Set the sides when the solution reaches or leaves a surface.
  subroutine meet(self, k, t, q, v, sides, touched)
    class(driven_system_type), intent(inout) :: self
    integer, intent(in) :: k
    real(wp), intent(in) :: t, q(:)
    !> Velocities; an impact changes them.
    real(wp), intent(inout) :: v(:)
    !> Sides as for `take_sides`; whether the solution is on each surface.
    integer, intent(inout) :: sides(:)
    logical, intent(inout) :: touched(:)
    touched(k) = .true.
    sides(k) = -sides(k)
    ! A system without elements has no impacts.
    v = v + 0.0_wp*(t*q)
    call self%take_sides(sides)
  end subroutine meet

  !> Set the sides after a jump of the velocities.
  subroutine jump(self, t, q, before, v, sides)
    class(driven_system_type), intent(inout) :: self
    real(wp), intent(in) :: t, q(:), before(:)
    !> As for `meet`.
    real(wp), intent(inout) :: v(:)
    integer, intent(inout) :: sides(:)
    ! Without surfaces there is nothing to leave.
    v = v + 0.0_wp*(t*(q + before))
    call self%take_sides(sides)
  end subroutine jump

  !> Like `jump`, when a run continues with a different base motion. Differences of the size of
  !! rounding errors are no jump.
  subroutine jump_on(self, t, q, before, most, v)
    class(driven_system_type), intent(inout) :: self
    real(wp), intent(in) :: t, q(:), before(:)
    !> Magnitude of the absolute state.
    real(wp), intent(in) :: most
    real(wp), intent(inout) :: v(:)
    real(wp), parameter :: rounding = 1.0e-12_wp
    integer :: sides(size(self%sides))
    if (all(abs(v - before) <= rounding*max(most, maxval(abs(v)), maxval(abs(before))))) then
      v = before
      return
    end if
    sides = self%sides
    call self%jump(t, q, before, v, sides)
    self%sides = sides
  end subroutine jump_on

  !> Convert a relative state to an absolute state; `share` = -1 converts back.
  pure subroutine add_base(self, t, q, v, share)
    class(driven_system_type), intent(in) :: self
    real(wp), intent(in) :: t
    !> All coordinates.
    real(wp), intent(inout) :: q(:), v(:)
    real(wp), intent(in), optional :: share
    integer :: n
    if (.not. self%base_motion%moves()) return
    n = self%n_dof - self%n_hidden
    call self%base_motion%add_to(t, q(:n), v(:n), share)
  end subroutine add_base

  !> Initial coordinates and velocities, relative to the base.
  subroutine start(self, t, body_q, body_v, q, v)
    class(driven_system_type), intent(in) :: self
    !> Absolute state, shape (n_dof - n_hidden).
    real(wp), intent(in) :: t, body_q(:), body_v(:)
    real(wp), intent(out) :: q(:), v(:)
    integer :: n
    n = size(body_q)
    q = 0.0_wp
    v = 0.0_wp
    q(:n) = body_q
    v(:n) = body_v
    if (allocated(self%hidden_speeds)) v(n + 1:) = self%hidden_speeds
    call self%add_base(t, q, v, share=-1.0_wp)
  end subroutine start

  !> How many laws there are whose forces `law_forces` gives.
  pure integer function n_laws(self)
    class(driven_system_type), intent(in) :: self
    n_laws = 0*self%n_dof
  end function n_laws

  !> Accelerations at a state, and the forces of laws, shape (n_laws).
  subroutine law_forces(self, t, q, v, a, force)
    class(driven_system_type), intent(in) :: self
    real(wp), intent(in) :: t, q(self%n_dof), v(self%n_dof)
    real(wp), intent(out) :: a(self%n_dof), force(:)
    real(wp) :: lanes(n_lanes, self%n_dof)
    call self%acceleration(spread(q, 1, n_lanes), spread(v, 1, n_lanes), &
                           self%drive_at(spread(t, 1, n_lanes)), lanes)
    a = lanes(1, :)
    force = 0.0_wp
  end subroutine law_forces

  !> Loads at times.
  pure function drive_at(self, t) result(drive)
    class(driven_system_type), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp) :: drive(size(t), size(self%drives))
    real(wp), dimension(size(t)) :: sine, cosine
    integer :: i, m
    m = size(self%drives)
    do i = 1, m
      drive(:, i) = self%drives(i)*t
      if (all(abs(drive(:, i)) <= largest_angle)) then
        call sine_cosine_array(drive(:, i), sine, cosine)
      else
        sine = sin(drive(:, i))
        cosine = cos(drive(:, i))
      end if
      drive(:, i) = cosine
      if (.not. allocated(self%quarters)) cycle
      if (self%quarters(i) == 3) drive(:, i) = sine
    end do
    if (self%timed) drive(:, m) = t - self%present_piece(1)
  end function drive_at

  !> True if a state is inside the domain of the equations.
  pure logical function physical(self, q)
    class(driven_system_type), intent(in) :: self
    real(wp), intent(in) :: q(self%n_dof)
    real(wp) :: margin(n_lanes)
    margin = self%margin(spread(q, 1, n_lanes))
    physical = margin(1) > 0.0_wp
  end function physical

end module viscovib_driven_system
