!> Explicit Runge-Kutta in fixed steps, trajectories side by side in the lanes of
!! the vector unit. Each lane may have its own step and its own load frequencies,
!! and does the same arithmetic whatever its neighbours are.
module viscovib_explicit
  use viscovib_aligned, only: alignment_slack, first_aligned, settle
  use viscovib_counters, only: count_up, counted_accelerations, counting
  use viscovib_driven_system, only: driven_system_type
  use viscovib_explicit_tables, only: explicit_table_type, new_explicit_table
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: max_dof, n_lanes
  use viscovib_phases, only: split_phase, step_phase, turn_phase
  use viscovib_stage_kernels, only: end_of_step, stage_states, stage_sums, turn_drives
  use viscovib_vector_math, only: sine_cosine_lanes
  implicit none
  private

  public :: explicit_type, new_explicit

  !> Where things begin in the room of a method, in columns of lanes.
  type :: room_plan
    integer :: h = 1, q = 0, v = 0, q_rest = 0, v_rest = 0, in_q = 0, in_v = 0, stage_q = 0
    integer :: stage_v = 0, drive = 0, cosine = 0, sine = 0, stage_cosine = 0, stage_sine = 0
    integer :: f = 0, n_columns = 0
  end type room_plan

  type :: explicit_type
    type(explicit_table_type) :: table
    integer :: n_dof = 0, n_drives = 0
    !> Time since the present piece of a load began, for a system that asks for it.
    real(wp) :: since = 0.0_wp
    !> Evaluations of a block of lanes, all told.
    integer(i8) :: n_evaluations = 0
    !> Load phases and their growth in a step, in two parts, shape (n_lanes, n).
    real(wp), allocatable, private :: high(:, :), low(:, :), step_high(:, :), step_low(:, :)
    type(room_plan), private :: plan
    real(wp), allocatable, private :: room(:)
    !> Where in it the first column begins.
    integer, private :: first = 1
  contains
    procedure :: begin_again
    procedure :: step
    procedure :: get_state
    procedure :: change_steps
    procedure :: turn_phases
    procedure :: set_lane
    procedure :: scale_lanes
    procedure :: set_from
    procedure :: lane_memory_size
    procedure :: save_lane
    procedure :: load_lane
    procedure :: stop_lane
    procedure, private :: step_in_room
    procedure, private :: place
  end type explicit_type

contains

  !> Start at (q, v) at time `start`, all lanes together.
  subroutine new_explicit(method, n_dof, which, frequencies, q, v, start, h)
    type(explicit_type), intent(out) :: method
    integer, intent(in) :: n_dof
    !> Place in `explicit_names`.
    integer, intent(in) :: which
    !> Circular frequencies of the loads, shape (n_lanes, n_drives).
    real(wp), intent(in) :: frequencies(:, :)
    !> Shape (n_lanes, n_dof, n_blocks).
    real(wp), intent(in) :: q(:, :), v(:, :)
    real(wp), intent(in) :: start, h(n_lanes)
    integer :: n

    call new_explicit_table(method%table, which)
    method%n_dof = n_dof
    n = size(frequencies, 2)
    method%n_drives = n
    method%plan = new_room_plan(n, method%table%n_stages)
    allocate (method%room(n_lanes*method%plan%n_columns + alignment_slack), source=0.0_wp)
    method%first = first_aligned(method%room)
    allocate (method%high(n_lanes, n), method%low(n_lanes, n))
    allocate (method%step_high(n_lanes, n), method%step_low(n_lanes, n))
    call method%begin_again(frequencies, q, v, start, h)
  end subroutine new_explicit

  !> Start anew as `new_explicit` does, without making the table again, which takes the time of
  !! some steps.
  subroutine begin_again(self, frequencies, q, v, start, h)
    class(explicit_type), intent(inout) :: self
    real(wp), intent(in) :: frequencies(:, :), q(:, :), v(:, :), start, h(n_lanes)
    integer :: i

    self%since = 0.0_wp
    call split_phase(frequencies, start, self%high, self%low)
    do i = 1, n_lanes
      call self%set_lane(i, q(i, :), v(i, :))
    end do
    call self%change_steps(frequencies, h)
  end subroutine begin_again

  !> Go on with other steps.
  subroutine change_steps(self, frequencies, h)
    class(explicit_type), intent(inout) :: self
    real(wp), intent(in) :: frequencies(:, :), h(n_lanes)
    call settle(self%room, self%first)
    call split_phase(frequencies, spread(h, 2, size(frequencies, 2)), self%step_high, &
                     self%step_low)
    call furnish(self%table, self%plan, frequencies, h, self%room(self%first))
  end subroutine change_steps

  !> Let each load run some quarter turns ahead.
  pure subroutine turn_phases(self, quarters)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: quarters(:)
    call turn_phase(self%high, self%low, spread(quarters, 1, n_lanes))
  end subroutine turn_phases

  !> Put steps and the load phases of the stages into the room.
  pure subroutine furnish(table, plan, frequencies, h, room)
    type(explicit_table_type), intent(in) :: table
    type(room_plan), intent(in) :: plan
    real(wp), intent(in) :: frequencies(:, :), h(n_lanes)
    real(wp), intent(inout) :: room(n_lanes, plan%n_columns)
    real(wp) :: angle
    integer :: i, j, k, column

    room(:, plan%h) = h
    do i = 1, table%n_stages
      do j = 1, size(frequencies, 2)
        column = size(frequencies, 2)*(i - 1) + j - 1
        room(:, plan%stage_cosine + column) = 1.0_wp
        room(:, plan%stage_sine + column) = 0.0_wp
        do k = 1, n_lanes
          angle = frequencies(k, j)*(h(k)*table%c(i))
          ! Lanes that stand still, and loads that do: most where one motion is followed.
          if (angle == 0.0_wp) cycle
          room(k, plan%stage_cosine + column) = cos(angle)
          room(k, plan%stage_sine + column) = sin(angle)
        end do
      end do
    end do
  end subroutine furnish

  pure type(room_plan) function new_room_plan(n_drives, n_stages) result(plan)
    integer, intent(in) :: n_drives, n_stages
    plan%q = plan%h + 1
    plan%v = plan%q + max_dof
    plan%q_rest = plan%v + max_dof
    plan%v_rest = plan%q_rest + max_dof
    plan%in_q = plan%v_rest + max_dof
    plan%in_v = plan%in_q + max_dof
    plan%stage_q = plan%in_v + max_dof
    plan%stage_v = plan%stage_q + max_dof
    plan%drive = plan%stage_v + max_dof
    plan%cosine = plan%drive + n_drives
    plan%sine = plan%cosine + n_drives
    plan%stage_cosine = plan%sine + n_drives
    plan%stage_sine = plan%stage_cosine + n_drives*n_stages
    plan%f = plan%stage_sine + n_drives*n_stages
    plan%n_columns = plan%f + max_dof*n_stages - 1
  end function new_room_plan

  !> One step of every lane. Nothing is checked: a lane that overflows holds
  !! infinities and disturbs no other.
  subroutine step(self, system)
    class(explicit_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    call self%step_in_room(system, self%room(self%first))
    call step_phase(self%high, self%low, self%step_high, self%step_low)
    self%n_evaluations = self%n_evaluations + self%table%n_stages
    if (counting) call count_up(counted_accelerations, self%table%n_stages)
  end subroutine step

  subroutine step_in_room(self, system, room)
    class(explicit_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(inout) :: room(n_lanes, self%plan%n_columns)
    integer :: i, n, m

    n = self%n_dof
    m = self%n_drives
    associate (p => self%plan, t => self%table)
      call phase_cosines(m, self%high, self%low, room(1, p%cosine), room(1, p%sine))
      do i = 1, t%n_stages
        call stage_sums(n, t%n_terms(i), t%from(1, i), t%weights(1, 1, i), room(1, p%f), &
                        room(1, p%in_q), room(1, p%in_v))
        call stage_states(n, t%c(i), room(1, p%h), room(1, p%q), room(1, p%v), room(1, p%in_q), &
                          room(1, p%in_v), room(1, p%stage_q), room(1, p%stage_v))
        call turn_drives(m, room(1, p%cosine), room(1, p%sine), &
                         room(1, p%stage_cosine + m*(i - 1)), room(1, p%stage_sine + m*(i - 1)), &
                         room(1, p%drive))
        if (system%timed) room(:, p%drive + m - 1) = self%since + t%c(i)*room(:, p%h)
        call system%acceleration(room(1, p%stage_q), room(1, p%stage_v), room(1, p%drive), &
                                 room(1, p%f + max_dof*(i - 1)))
      end do
      i = t%n_stages + 1
      call stage_sums(n, t%n_terms(i), t%from(1, i), t%weights(1, 1, i), room(1, p%f), &
                      room(1, p%in_q), room(1, p%in_v))
      call end_of_step(n, room(1, p%h), room(1, p%in_q), room(1, p%in_v), room(1, p%q), &
                       room(1, p%v), room(1, p%q_rest), room(1, p%v_rest))
    end associate
  end subroutine step_in_room

  !> cos and sin of phases in two parts.
  pure subroutine phase_cosines(n, high, low, cosine, sine)
    integer, intent(in) :: n
    real(wp), intent(in) :: high(n_lanes, n), low(n_lanes, n)
    real(wp), intent(out) :: cosine(n_lanes, n), sine(n_lanes, n)
    real(wp) :: c(n_lanes), s(n_lanes)
    integer :: j
    do j = 1, n
      call sine_cosine_lanes(high(:, j), s, c)
      cosine(:, j) = c - s*low(:, j)
      sine(:, j) = s + c*low(:, j)
    end do
  end subroutine phase_cosines

  !> States of all lanes, shape (n_lanes, n_dof).
  pure subroutine get_state(self, q, v)
    class(explicit_type), intent(in) :: self
    real(wp), intent(out) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    integer :: d, at
    do d = 1, self%n_dof
      at = self%place(self%plan%q + d - 1)
      q(:, d) = self%room(at + 1:at + n_lanes)
      at = self%place(self%plan%v + d - 1)
      v(:, d) = self%room(at + 1:at + n_lanes)
    end do
  end subroutine get_state

  !> Elements before a column of the room.
  pure integer function place(self, column)
    class(explicit_type), intent(in) :: self
    integer, intent(in) :: column
    place = self%first - 1 + n_lanes*(column - 1)
  end function place

  !> Put another state in a lane; what rounding had left out is forgotten.
  pure subroutine set_lane(self, lane, q, v)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: lane
    real(wp), intent(in) :: q(:), v(:)
    integer :: d
    associate (p => self%plan)
      do d = 1, size(q)
        self%room(self%place(p%q + d - 1) + lane) = q(d)
        self%room(self%place(p%v + d - 1) + lane) = v(d)
        self%room(self%place(p%q_rest + d - 1) + lane) = 0.0_wp
        self%room(self%place(p%v_rest + d - 1) + lane) = 0.0_wp
      end do
    end associate
  end subroutine set_lane

  !> Put other values of coordinates first ... n_dof and their velocities in all lanes.
  pure subroutine set_from(self, first, q, v)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: first
    !> Shape (n_lanes, n_dof).
    real(wp), intent(in) :: q(:, :), v(:, :)
    integer :: d
    associate (p => self%plan, room => self%room)
      do d = first, self%n_dof
        room(self%place(p%q + d - 1) + 1:self%place(p%q + d)) = q(:, d)
        room(self%place(p%v + d - 1) + 1:self%place(p%v + d)) = v(:, d)
        room(self%place(p%q_rest + d - 1) + 1:self%place(p%q_rest + d)) = 0.0_wp
        room(self%place(p%v_rest + d - 1) + 1:self%place(p%v_rest + d)) = 0.0_wp
      end do
    end associate
  end subroutine set_from

  !> Multiply coordinates first ... n_dof, their velocities and rests by a factor
  !! a lane.
  pure subroutine scale_lanes(self, first, factors)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: first
    real(wp), intent(in) :: factors(n_lanes)
    integer :: d, i, at
    do i = 0, 3
      do d = first, self%n_dof
        at = self%place(self%plan%q + max_dof*i + d - 1)
        self%room(at + 1:at + n_lanes) = factors*self%room(at + 1:at + n_lanes)
      end do
    end do
  end subroutine scale_lanes

  !> Length of all that one lane must know to go on bit for bit.
  pure integer function lane_memory_size(self)
    class(explicit_type), intent(in) :: self
    lane_memory_size = 4*max_dof + 2*self%n_drives
  end function lane_memory_size

  !> State, rests and phases of a lane.
  pure function save_lane(self, lane) result(memory)
    class(explicit_type), intent(in) :: self
    integer, intent(in) :: lane
    real(wp) :: memory(self%lane_memory_size())
    integer :: i
    memory = [(self%room(self%place(self%plan%q + i) + lane), i=0, 4*max_dof - 1), &
              self%high(lane, :), self%low(lane, :)]
  end function save_lane

  pure subroutine load_lane(self, lane, memory)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: lane
    real(wp), intent(in) :: memory(:)
    integer :: i
    do i = 0, 4*max_dof - 1
      self%room(self%place(self%plan%q + i) + lane) = memory(i + 1)
    end do
    i = 4*max_dof + self%n_drives
    self%high(lane, :) = memory(4*max_dof + 1:i)
    self%low(lane, :) = memory(i + 1:i + self%n_drives)
  end subroutine load_lane

  !> Let a lane stand still from now on.
  pure subroutine stop_lane(self, lane)
    class(explicit_type), intent(inout) :: self
    integer, intent(in) :: lane
    self%room(self%place(self%plan%h) + lane) = 0.0_wp
  end subroutine stop_lane

end module viscovib_explicit
