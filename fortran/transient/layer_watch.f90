!> Detection of thin layers of forces that a run in whole steps may have jumped over.
!!
!! States at the ends of steps are collected, and many of them are checked at once, at a small
!! part of the cost of the steps. A layer may be missed if the arguments of a function change so
!! much from one end to the next that no node of the step needs to be inside the layer.
!!
!! Runs without memory use `see` and are repeated in parts if a layer was missed (in lanes:
!! `viscovib_lane_watch`). Runs with memory `follow` their steps to the
!! end, and report by which factor the steps are too long.
module viscovib_layer_watch
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_law_layers, only: law_layers, unseen
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  implicit none
  private

  public :: layer_watch

  !> Number of states checked together; number shared with the previous group.
  integer, parameter, public :: n_states = 64, n_shared = 2
  type :: layer_watch
    logical :: on = .false.
    integer, private :: n = 0
    real(wp), allocatable, private :: t(:), q(:, :), v(:, :)
    !> For `follow`.
    type(law_layers), private :: layers
    real(wp), private :: thinnest = 0.0_wp
  contains
    procedure :: begin
    procedure :: see
    procedure :: look
    procedure :: begin_to_follow
    procedure :: follow
    procedure :: jump
    procedure :: thinness
    procedure, private :: work
    procedure, private :: forget
    procedure, private :: note
  end type layer_watch

contains

  !> Initialize before the first step.
  subroutine begin(self, system, t, q, v)
    class(layer_watch), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t, q(:), v(:)
    ! Steps that are made in parts check for layers themselves.
    self%on = system%layers%exist() .and. .not. (system%in_parts .or. allocated(system%signals))
    if (.not. self%on) return
    call self%work(size(q))
    call self%note(t, q, v)
  end subroutine begin

  !> Process a step; `missed`: a layer may have been missed.
  subroutine see(self, system, t, q, v, missed)
    class(layer_watch), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t, q(:), v(:)
    logical, intent(out) :: missed
    missed = .false.
    if (self%n == n_states) then
      missed = self%look(system)
      call self%forget()
    end if
    call self%note(t, q, v)
  end subroutine see

  !> True if a layer may have been missed between the collected states.
  logical function look(self, system)
    class(layer_watch), intent(in) :: self
    class(driven_system_type), intent(in) :: system
    look = .false.
    if (.not. self%on .or. self%n < 2) return
    associate (n => self%n)
      look = system%layers%thinness_at(self%t(:n), self%t(:n), self%q(:n, :), self%v(:n, :), &
                                       .true.) > unseen
    end associate
  end function look

  !> Initialize before the first step of a run with memory, or of a structure.
  subroutine begin_to_follow(self, system, t, q, v)
    class(layer_watch), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    !> Time, and the arguments of laws then, with their rates.
    real(wp), intent(in) :: t, q(:), v(:)
    self%on = .false.
    select type (system)
    class is (polynomial_type)
      if (size(system%laws) > 0) then
        call self%layers%find(system%laws)
        self%on = self%layers%exist()
      end if
    end select
    if (.not. self%on) return
    call self%work(size(q))
    call self%note(t, q, v)
  end subroutine begin_to_follow

  !> Process a step.
  subroutine follow(self, t, q, v)
    class(layer_watch), intent(inout) :: self
    real(wp), intent(in) :: t, q(:), v(:)
    if (self%n == n_states) then
      self%thinnest = self%thinness()
      call self%forget()
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

  !> Allocate states of n_dof coordinates.
  subroutine work(self, n_dof)
    class(layer_watch), intent(inout) :: self
    integer, intent(in) :: n_dof
    allocate (self%t(n_states), self%q(n_states, n_dof), self%v(n_states, n_dof))
    self%n = 0
  end subroutine work

  subroutine note(self, t, q, v)
    class(layer_watch), intent(inout) :: self
    real(wp), intent(in) :: t, q(:), v(:)
    self%n = self%n + 1
    self%t(self%n) = t
    self%q(self%n, :) = q
    self%v(self%n, :) = v
  end subroutine note

  !> Discard all states except those shared with the next group.
  subroutine forget(self)
    class(layer_watch), intent(inout) :: self
    self%t(:n_shared) = self%t(n_states - n_shared + 1:)
    self%q(:n_shared, :) = self%q(n_states - n_shared + 1:, :)
    self%v(:n_shared, :) = self%v(n_states - n_shared + 1:, :)
    self%n = n_shared
  end subroutine forget

end module viscovib_layer_watch
