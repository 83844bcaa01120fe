! Optimize: -O1
!> Detection of thin layers of forces that runs in lanes, in whole steps, may have jumped over:
!! the counterpart of `viscovib_layer_watch` for lanes.
!!
!! States of all lanes are stored in order of time, and many states of a lane are checked at once.
module viscovib_lane_watch
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_layers, only: law_layers, unseen
  use viscovib_layer_watch, only: n_shared, n_states
  implicit none
  private

  public :: lane_watch

  !> The bound for power series: their terms detect a layer ahead, which prevents convergence
  !! within the step, until rounding hides it; for tanh from about 18 of its widths on. That
  !! corresponds to 7 within three steps.
  real(wp), parameter :: unseen_by_series = 5.0_wp

  type :: lane_watch
    logical :: on = .false.
    !> Largest change of an operand in a step, in units of the length that a polynomial resolves.
    real(wp), private :: most = unseen
    integer, private :: n = 0
    !> Steps since time 0, and states, shape (n_lanes, n_states, n_dof).
    real(wp), private :: steps(n_states) = 0.0_wp
    real(wp), allocatable, private :: q(:, :, :), v(:, :, :)
  contains
    procedure :: begin
    procedure :: see
    procedure :: look
    procedure, private :: look_at
  end type lane_watch

contains

  !> Before the first step.
  subroutine begin(self, system, q, v, by_series)
    class(lane_watch), intent(out) :: self
    class(driven_system_type), intent(in) :: system
    !> Shape (n_lanes, n_dof or more); only the coordinates of the motion itself are kept.
    real(wp), intent(in), contiguous :: q(:, :), v(:, :)
    !> True for power series, which evaluate forces at one point only.
    logical, intent(in) :: by_series
    ! Steps that are made in parts check for layers themselves.
    self%on = system%layers%exist() .and. .not. (system%in_parts .or. allocated(system%signals))
    if (.not. self%on) return
    self%most = merge(unseen_by_series, unseen, by_series)
    allocate (self%q(n_lanes, n_states, system%n_dof), self%v(n_lanes, n_states, system%n_dof))
    call note(self, 0.0_wp, system%n_dof, q, v)
  end subroutine begin

  !> After step i: mark the selected lanes that may have missed a layer.
  subroutine see(self, system, i, h, q, v, asked, missed)
    class(lane_watch), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    !> Number of steps; their lengths.
    real(wp), intent(in) :: i, h(n_lanes)
    real(wp), intent(in), contiguous :: q(:, :), v(:, :)
    logical, intent(in) :: asked(n_lanes)
    logical, intent(inout) :: missed(n_lanes)
    if (self%n == n_states) then
      call self%look(system, h, asked, missed)
      self%steps(:n_shared) = self%steps(n_states - n_shared + 1:)
      self%q(:, :n_shared, :) = self%q(:, n_states - n_shared + 1:, :)
      self%v(:, :n_shared, :) = self%v(:, n_states - n_shared + 1:, :)
      self%n = n_shared
    end if
    call note(self, i, size(self%q, 3), q, v)
  end subroutine see

  !> Mark the selected lanes that may have missed a layer between the states kept.
  subroutine look(self, system, h, asked, missed)
    class(lane_watch), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: h(n_lanes)
    logical, intent(in) :: asked(n_lanes)
    logical, intent(inout) :: missed(n_lanes)
    logical :: followed(n_lanes)
    integer :: l

    if (self%n < 2) return
    followed = .false.
    if (.not. allocated(system%lane_layers)) call look_at_all(self, system%layers, h, self%q, &
                                                              self%v, followed)
    do l = 1, n_lanes
      if (.not. asked(l) .or. missed(l) .or. followed(l)) cycle
      if (allocated(system%lane_layers)) then
        missed(l) = self%look_at(system%lane_layers(l), h(l), l)
      else
        missed(l) = self%look_at(system%layers, h(l), l)
      end if
    end do
  end subroutine look

  !> Lanes whose total change is so small that they miss nothing.
  subroutine look_at_all(self, layers, h, q, v, followed)
    class(lane_watch), intent(in) :: self
    type(law_layers), intent(in) :: layers
    real(wp), intent(in) :: h(n_lanes), q(n_lanes*n_states, *), v(n_lanes*n_states, *)
    logical, intent(out) :: followed(n_lanes)
    real(wp) :: t(n_lanes*self%n)
    integer :: i, n

    do i = 1, self%n
      t(n_lanes*(i - 1) + 1:n_lanes*i) = self%steps(i)*h
    end do
    n = size(self%q, 3)
    followed = layers%followed(self%n, t, q(:n_lanes*self%n, :n), v(:n_lanes*self%n, :n), self%most)
  end subroutine look_at_all

  !> The same for one lane.
  logical function look_at(self, layers, h, lane) result(missed)
    class(lane_watch), intent(in) :: self
    type(law_layers), intent(in) :: layers
    real(wp), intent(in) :: h
    integer, intent(in) :: lane
    real(wp) :: t(self%n)
    real(wp), dimension(self%n, size(self%q, 3)) :: q, v
    integer :: i

    do i = 1, self%n
      t(i) = self%steps(i)*h
      q(i, :) = self%q(lane, i, :)
      v(i, :) = self%v(lane, i, :)
    end do
    missed = layers%thinness_at(t, t, q, v, .true., self%most) > self%most
  end function look_at

  pure subroutine note(self, i, n, q, v)
    type(lane_watch), intent(inout) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: i, q(n_lanes, n), v(n_lanes, n)
    integer :: d, l
    self%n = self%n + 1
    self%steps(self%n) = i
    do d = 1, n
      do l = 1, n_lanes
        self%q(l, self%n, d) = q(l, d)
        self%v(l, self%n, d) = v(l, d)
      end do
    end do
  end subroutine note

end module viscovib_lane_watch
