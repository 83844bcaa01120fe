!> Whether runs side by side, made in whole steps, may have jumped over thin layers of their forces:
!! what `viscovib_layer_watch` is for one run.
!!
!! States of all lanes are kept together as they come, and those of a lane looked at many at a time.
module viscovib_lane_watch
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_layers, only: law_layers, unseen
  use viscovib_layer_watch, only: n_shared, n_states
  implicit none
  private

  public :: lane_watch

  !> What counts as unseen by a power series: its terms show a layer ahead, which keeps it from
  !! converging within the step, until rounding hides them, as it does those of tanh from about 18
  !! of its widths on; these are 7 within three steps.
  real(wp), parameter :: unseen_by_series = 5.0_wp

  type :: lane_watch
    logical :: on = .false.
    !> How many times as far as a polynomial follows an operand may go in a step.
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
    !> Shape (n_lanes, n_dof or more), of which those of the motion itself are kept.
    real(wp), intent(in), contiguous :: q(:, :), v(:, :)
    !> Whether steps are made by power series, which look at forces at one place.
    logical, intent(in) :: by_series
    ! Steps that are made in parts see for themselves.
    self%on = system%layers%exist() .and. .not. (system%in_parts .or. allocated(system%signals))
    if (.not. self%on) return
    self%most = merge(unseen_by_series, unseen, by_series)
    allocate (self%q(n_lanes, n_states, system%n_dof), self%v(n_lanes, n_states, system%n_dof))
    call note(self, 0.0_wp, system%n_dof, q, v)
  end subroutine begin

  !> After step i; which of the lanes asked for may have missed a layer.
  subroutine see(self, system, i, h, q, v, asked, missed)
    class(lane_watch), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    !> Steps; lengths of them.
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

  !> Which of the lanes asked for may have missed a layer between the states kept.
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

  !> Lanes that go so little far altogether that they miss nothing.
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

  !> The same of one lane.
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
