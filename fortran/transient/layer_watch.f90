! Optimize: -O3
!> Detection of thin layers of forces that a run in whole steps may have jumped over.
!!
!! States at the ends of steps are collected, and many of them are checked at once, at a small
!! part of the cost of the steps. A layer may be missed if the arguments of a function change so
!! much from one end to the next that no node of the step needs to be inside the layer.
!!
!! Runs without memory are repeated in parts if a layer was missed (in lanes:
!! `viscovib_lane_watch`). Runs with memory report by which factor the steps are too long.
module viscovib_layer_watch
  use viscovib_kinds, only: wp
  use viscovib_law_layers, only: law_layers
  implicit none
  private

  public :: layer_watch

  !> Number of states checked together; number shared with the previous group.
  integer, parameter, public :: n_states = 64, n_shared = 2
  type :: layer_watch
    logical :: on = .false.
    integer, private :: n = 0
    real(wp), allocatable, private :: t(:), q(:, :), v(:, :)
    type(law_layers), private :: layers
    !> As `thinness`, of complete groups.
    real(wp) :: thinnest = 0.0_wp
  contains
    procedure :: begin
    procedure :: follow
    procedure :: jump
    procedure :: thinness
    procedure, private :: note
  end type layer_watch

contains

  !> Initialize before the first step.
  subroutine begin(self, layers, t, q, v)
    class(layer_watch), intent(inout) :: self
    type(law_layers), intent(in) :: layers
    !> Time and state, or the arguments of laws then, with their rates.
    real(wp), intent(in) :: t, q(:), v(:)
    self%on = layers%exist()
    if (.not. self%on) return
    self%layers = layers
    allocate (self%t(n_states), self%q(n_states, size(q)), self%v(n_states, size(q)))
    self%n = 0
    call self%note(t, q, v)
  end subroutine begin

  !> Process a step.
  subroutine follow(self, t, q, v)
    class(layer_watch), intent(inout) :: self
    real(wp), intent(in) :: t, q(:), v(:)
    if (self%n == n_states) then
      self%thinnest = self%thinness()
      self%t(:n_shared) = self%t(n_states - n_shared + 1:)
      self%q(:n_shared, :) = self%q(n_states - n_shared + 1:, :)
      self%v(:n_shared, :) = self%v(n_states - n_shared + 1:, :)
      self%n = n_shared
    end if
    call self%note(t, q, v)
  end subroutine follow

  !> Restart after a jump of the state.
  subroutine jump(self, t, q, v)
    class(layer_watch), intent(inout) :: self
    real(wp), intent(in) :: t, q(:), v(:)
    self%thinnest = self%thinness()
    self%n = 0
    call self%note(t, q, v)
  end subroutine jump

  !> Largest change of an argument in a step, in units of the length that a polynomial resolves.
  real(wp) function thinness(self)
    class(layer_watch), intent(in) :: self
    thinness = self%thinnest
    if (.not. self%on .or. self%n < 2) return
    associate (n => self%n)
      thinness = max(thinness, self%layers%thinness_at(self%t(:n), self%t(:n), self%q(:n, :), &
                                                       self%v(:n, :), .true.))
    end associate
  end function thinness

  subroutine note(self, t, q, v)
    class(layer_watch), intent(inout) :: self
    real(wp), intent(in) :: t, q(:), v(:)
    self%n = self%n + 1
    self%t(self%n) = t
    self%q(self%n, :) = q
    self%v(self%n, :) = v
  end subroutine note

end module viscovib_layer_watch
