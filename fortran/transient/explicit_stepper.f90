! Optimize: -O1
!> One trajectory by an explicit method: every lane computes the same one, which
!! costs no more than a single lane.
module viscovib_explicit_stepper
  use viscovib_driven_system, only: driven_system_type
  use viscovib_explicit, only: explicit_type, new_explicit
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_quadrature, only: gauss_nodes
  use viscovib_step_path, only: new_path, step_path
  use viscovib_stepper, only: stepper_type
  use viscovib_stops, only: in_range, least_between
  implicit none
  private

  public :: explicit_stepper_type, new_explicit_stepper

  type, extends(stepper_type) :: explicit_stepper_type
    type(explicit_type), private :: block
  contains
    procedure :: step
    !> Its loads have advanced.
    procedure :: arrive => put
    procedure :: change_step
    procedure :: put
    procedure :: memory_size
    procedure :: n_of_state
    procedure :: save_memory
    procedure :: load_memory
    procedure :: least_margin
    procedure :: trace
  end type explicit_stepper_type

contains

  !> Start at (q, v) at time `start`.
  subroutine new_explicit_stepper(method, system, which, q, v, start, h)
    type(explicit_stepper_type), intent(out) :: method
    class(driven_system_type), intent(in) :: system
    !> Index in `explicit_names`.
    integer, intent(in) :: which
    real(wp), intent(in) :: q(:), v(:), start, h
    method%explicit = .true.
    method%h = h
    method%q = q
    method%v = v
    call new_explicit(method%block, system%n_dof, which, spread(system%drives, 1, n_lanes), &
                      spread(q, 1, n_lanes), spread(v, 1, n_lanes), start, spread(h, 1, n_lanes))
    if (allocated(system%quarters)) call method%block%turn_phases(system%quarters)
  end subroutine new_explicit_stepper

  subroutine step(self, system, made)
    class(explicit_stepper_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    logical, intent(out) :: made
    real(wp) :: q(n_lanes, size(self%q)), v(n_lanes, size(self%q))

    self%block%since = self%since
    call self%block%step(system)
    call self%block%get_state(q, v)
    self%n_evaluations = self%block%n_evaluations
    made = in_range(system, q(1, :), v(1, :))
    if (.not. made) return
    self%q = q(1, :)
    self%v = v(1, :)
  end subroutine step

  subroutine change_step(self, system, h)
    class(explicit_stepper_type), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: h
    self%h = h
    call self%block%change_steps(spread(system%drives, 1, n_lanes), spread(h, 1, n_lanes))
  end subroutine change_step

  subroutine put(self, q, v)
    class(explicit_stepper_type), intent(inout) :: self
    real(wp), intent(in) :: q(:), v(:)
    integer :: l
    self%q = q
    self%v = v
    do l = 1, n_lanes
      call self%block%set_lane(l, q, v)
    end do
  end subroutine put

  pure integer function memory_size(self)
    class(explicit_stepper_type), intent(in) :: self
    memory_size = self%block%lane_memory_size()
  end function memory_size

  pure integer function n_of_state(self)
    class(explicit_stepper_type), intent(in) :: self
    n_of_state = self%block%lane_memory_size() - 2*self%block%n_drives
  end function n_of_state

  pure function save_memory(self) result(memory)
    class(explicit_stepper_type), intent(in) :: self
    real(wp) :: memory(self%memory_size())
    memory = self%block%save_lane(1)
  end function save_memory

  subroutine load_memory(self, memory)
    class(explicit_stepper_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    real(wp) :: q(n_lanes, size(self%q)), v(n_lanes, size(self%q))
    integer :: l
    do l = 1, n_lanes
      call self%block%load_lane(l, memory)
    end do
    call self%block%get_state(q, v)
    self%q = q(1, :)
    self%v = v(1, :)
  end subroutine load_memory

  !> Path from steps to eight Gauss nodes, one per lane: states inside have the order of the method,
  !! at the cost of one more step.
  subroutine trace(self, system, memory, path)
    class(explicit_stepper_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: memory(:)
    type(step_path), intent(inout) :: path
    type(explicit_type) :: block
    real(wp) :: q(n_lanes, size(self%q)), v(n_lanes, size(self%q)), nodes(n_lanes)
    real(wp) :: weights(n_lanes)
    integer :: l

    call gauss_nodes(n_lanes, nodes, weights)
    if (.not. allocated(path%points)) call new_path(path, [0.0_wp, nodes, 1.0_wp])
    path%h = self%h
    block = self%block
    block%since = self%since
    do l = 1, n_lanes
      call block%load_lane(l, memory)
    end do
    call block%get_state(q, v)
    path%q = spread(q(1, :), 1, n_lanes + 2)
    path%v = spread(v(1, :), 1, n_lanes + 2)
    call block%change_steps(spread(system%drives, 1, n_lanes), self%h*nodes)
    call block%step(system)
    call block%get_state(q, v)
    path%q(2:n_lanes + 1, :) = q
    path%v(2:n_lanes + 1, :) = v
    path%q(n_lanes + 2, :) = self%q
    path%v(n_lanes + 2, :) = self%v
  end subroutine trace

  !> Least margin from both ends of the step and the rates there.
  real(wp) function least_margin(self, system, q_before, v_before) result(least)
    class(explicit_stepper_type), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: q_before(:), v_before(:)
    real(wp) :: q(n_lanes, size(self%q)), margins(n_lanes)

    q = spread(self%q, 1, n_lanes)
    q(2, :) = self%q + self%h*self%v
    q(3, :) = q_before
    q(4, :) = q_before + self%h*v_before
    margins = system%margin(q)
    least = least_between(margins(3), margins(4) - margins(3), margins(1), &
                          margins(2) - margins(1))
  end function least_margin

end module viscovib_explicit_stepper
