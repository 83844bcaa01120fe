! Optimize: -O1
!> Taylor's method of any order in fixed steps, for trajectories in four blocks of lanes:
!! for large ensembles of systems whose forces have power series.
!!
!! Coefficient k of a product costs k + 1 multiplications, far fewer operations than
!! the stages of a Runge-Kutta method of the same order, and all blocks share the interpretation of
!! the forces' program. The results of a lane do not depend on the other lanes.
module viscovib_taylor
  use viscovib_aligned, only: alignment_slack, first_aligned
  use viscovib_kinds, only: wp
  use viscovib_lane_motion, only: lane_motion_type
  use viscovib_lanes, only: n_lanes
  use viscovib_motion_series, only: motion_series, new_motion_series
  use viscovib_phases, only: split_phase, step_phases
  use viscovib_vector_math, only: sine_cosine_lanes
  use viscovib_wide_series, only: n_wide
  implicit none
  private

  public :: new_taylor, taylor_type

  !> Bound of the last terms of a converging series, relative to the motion.
  real(wp), parameter :: most_left = 1.0e-4_wp

  type :: taylor_type
    !> Lanes whose series converged in the last step.
    logical :: made(n_wide) = .true.
    integer, private :: order = 20
    type(motion_series), private :: series
    real(wp), dimension(n_wide), private :: h = 0.0_wp, turning = 0.0_wp
    !> State and its rounding error, shape (n_wide, n_dof).
    real(wp), allocatable, dimension(:, :), private :: q, v, q_rest, v_rest
    !> The load's phase and its growth in a step, in two parts.
    real(wp), dimension(n_wide), private :: high = 0.0_wp, low = 0.0_wp
    real(wp), dimension(n_wide), private :: step_high = 0.0_wp, step_low = 0.0_wp
    !> Coefficients, and the index where they begin.
    real(wp), allocatable, private :: work(:)
    integer, private :: first = 1
  contains
    procedure :: step
    procedure :: expand_first
    procedure :: get_block
    procedure :: get_accelerations
    procedure :: stop_lane
    procedure, private :: step_in_arrays
    procedure, private :: expand_in_arrays
    procedure, private :: accelerations_in_arrays
  end type taylor_type

contains

  !> Start at time 0.
  subroutine new_taylor(method, order, motions, frequencies, q, v, h)
    type(taylor_type), intent(out) :: method
    integer, intent(in) :: order
    !> One system per block.
    type(lane_motion_type), intent(in) :: motions(:)
    !> For all lanes: circular frequencies of the loads, states, and steps; shape (n_wide, n_dof).
    real(wp), intent(in) :: frequencies(n_wide), q(:, :), v(:, :), h(n_wide)
    logical :: known

    call new_motion_series(method%series, motions, known)
    method%order = order
    method%q = q
    method%v = v
    method%q_rest = 0.0_wp*q
    method%v_rest = 0.0_wp*v
    method%h = h
    method%turning = frequencies*h
    call split_phase(frequencies, h, method%step_high, method%step_low)
    allocate (method%work(n_wide*(order + 1)*method%series%program%n_registers + alignment_slack), &
              source=0.0_wp)
    method%first = first_aligned(method%work)
  end subroutine new_taylor

  !> One step of every lane.
  subroutine step(self)
    class(taylor_type), intent(inout) :: self
    call self%step_in_arrays(self%work(self%first))
    call step_phases(n_wide, self%high, self%low, self%step_high, self%step_low)
  end subroutine step

  subroutine step_in_arrays(self, s)
    class(taylor_type), intent(inout) :: self
    real(wp), intent(inout) :: s(n_wide, 0:self%order, self%series%program%n_registers)
    real(wp), dimension(n_wide) :: left, size_of
    logical :: lost(n_wide)
    integer :: d, n

    n = self%series%n_dof
    call self%expand_in_arrays(s, lost)
    left = 0.0_wp
    size_of = 0.0_wp
    do d = 1, n
      call add_terms(self%order, s(1, 0, d), self%q(1, d), self%q_rest(1, d), left, size_of, &
                     self%h, .false.)
      call add_terms(self%order, s(1, 0, n + d), self%v(1, d), self%v_rest(1, d), left, size_of, &
                     self%h, .true.)
    end do
    self%made = .not. lost .and. left <= most_left*size_of
  end subroutine step_in_arrays

  !> The series of the first step, for the accelerations at its start only.
  subroutine expand_first(self)
    class(taylor_type), intent(inout) :: self
    logical :: lost(n_wide)
    call self%expand_in_arrays(self%work(self%first), lost)
  end subroutine expand_first

  !> Expand the series at the present state.
  subroutine expand_in_arrays(self, s, lost)
    class(taylor_type), intent(inout) :: self
    real(wp), intent(inout) :: s(n_wide, 0:self%order, self%series%program%n_registers)
    logical, intent(out) :: lost(n_wide)
    real(wp), dimension(n_wide) :: cosine, sine
    integer :: n

    n = self%series%n_dof
    s(:, 0, :n) = self%q
    s(:, 0, n + 1:2*n) = self%v
    call cosines(self%high, self%low, cosine, sine)
    call self%series%expand(self%order, self%h, self%turning, cosine, sine, s, lost)
  end subroutine expand_in_arrays

  !> Accelerations of a block at the end of the step with the present series, or at its start: the
  !! terms of a velocity are v_k = v^(k) h^k/k!, so that h v' = sum_k k v_k.
  subroutine get_accelerations(self, block, at_end, a)
    class(taylor_type), intent(in) :: self
    integer, intent(in) :: block
    logical, intent(in) :: at_end
    !> Shape (n_lanes, n_dof or more).
    real(wp), intent(inout) :: a(:, :)
    call self%accelerations_in_arrays(self%work(self%first), n_lanes*(block - 1), at_end, a)
  end subroutine get_accelerations

  pure subroutine accelerations_in_arrays(self, s, before, at_end, a)
    class(taylor_type), intent(in) :: self
    real(wp), intent(in) :: s(n_wide, 0:self%order, self%series%program%n_registers)
    !> Number of lanes in previous blocks.
    integer, intent(in) :: before
    logical, intent(in) :: at_end
    real(wp), intent(inout) :: a(:, :)
    real(wp) :: total(n_lanes)
    integer :: d, k, l

    do d = 1, self%series%n_dof
      total = 0.0_wp
      do k = merge(self%order, 1, at_end), 1, -1
        total = total + k*s(before + 1:before + n_lanes, k, self%series%n_dof + d)
      end do
      do l = 1, n_lanes
        ! A stopped lane has steps of length 0.
        a(l, d) = 0.0_wp
        if (self%h(before + l) > 0.0_wp) a(l, d) = total(l)/self%h(before + l)
      end do
    end do
  end subroutine accelerations_in_arrays

  !> cos and sin of phases in two parts.
  pure subroutine cosines(high, low, cosine, sine)
    real(wp), intent(in), dimension(n_wide) :: high, low
    real(wp), intent(out), dimension(n_wide) :: cosine, sine
    real(wp), dimension(n_lanes) :: c, s
    integer :: first, last

    do first = 1, n_wide, n_lanes
      last = first + n_lanes - 1
      call sine_cosine_lanes(high(first:last), s, c)
      cosine(first:last) = c - s*low(first:last)
      sine(first:last) = s + c*low(first:last)
    end do
  end subroutine cosines

  !> Add the sum of a series, the smallest terms first, to the state in compensated summation; also
  !! accumulate its last two terms and its size, for a velocity times the step.
  pure subroutine add_terms(order, s, x, rest, left, size_of, h, is_rate)
    integer, intent(in) :: order
    real(wp), intent(in) :: s(n_wide, 0:order), h(n_wide)
    real(wp), intent(inout), dimension(n_wide) :: x, rest, left, size_of
    logical, intent(in) :: is_rate
    real(wp) :: change(n_wide), new, unit
    integer :: k, l

    change = s(:, order)
    do k = order - 1, 1, -1
      !GCC$ unroll 1
      do l = 1, n_wide
        change(l) = change(l) + s(l, k)
      end do
    end do
    !GCC$ unroll 1
    do l = 1, n_wide
      unit = merge(h(l), 1.0_wp, is_rate)
      left(l) = left(l) + unit*(abs(s(l, order)) + abs(s(l, order - 1)))
      size_of(l) = size_of(l) + unit*(abs(x(l)) + abs(change(l)))
      change(l) = change(l) + rest(l)
      new = x(l) + change(l)
      rest(l) = change(l) - (new - x(l))
      x(l) = new
    end do
  end subroutine add_terms

  !> The states of a block, and the lanes in which the last step succeeded.
  pure subroutine get_block(self, block, q, v, made)
    class(taylor_type), intent(in) :: self
    integer, intent(in) :: block
    !> Shape (n_lanes, n_dof).
    real(wp), intent(out) :: q(n_lanes, self%series%n_dof), v(n_lanes, self%series%n_dof)
    logical, intent(out) :: made(n_lanes)
    integer :: before, d, l
    before = n_lanes*(block - 1)
    do d = 1, self%series%n_dof
      do l = 1, n_lanes
        q(l, d) = self%q(before + l, d)
        v(l, d) = self%v(before + l, d)
      end do
    end do
    made = self%made(before + 1:before + n_lanes)
  end subroutine get_block

  !> Stop a lane of a block at rest.
  pure subroutine stop_lane(self, block, lane)
    class(taylor_type), intent(inout) :: self
    integer, intent(in) :: block, lane
    integer :: l
    l = n_lanes*(block - 1) + lane
    self%h(l) = 0.0_wp
    self%q(l, :) = 0.0_wp
    self%v(l, :) = 0.0_wp
    self%q_rest(l, :) = 0.0_wp
    self%v_rest(l, :) = 0.0_wp
  end subroutine stop_lane

end module viscovib_taylor
