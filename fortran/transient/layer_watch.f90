!> Whether a run made in whole steps may have jumped over thin layers of its forces.
!!
!! States at the ends of steps are gathered and looked at many at a time, which costs a small part
!! of the steps. A layer counts as unseen where what a function depends on goes so far from one end
!! to the next that no node of the step needs to lie in the layer.
module viscovib_layer_watch
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_law_layers, only: unseen
  implicit none
  private

  public :: layer_watch

  !> States looked at together; two are shared with those before.
  integer, parameter :: n_states = 64, n_shared = 2

  type :: layer_watch
    logical :: on = .false.
    integer, private :: n = 0
    real(wp), allocatable, private :: t(:), q(:, :), v(:, :)
  contains
    procedure :: begin
    procedure :: see
    procedure :: look
  end type layer_watch

contains

  !> Before the first step.
  subroutine begin(self, system, t, q, v)
    class(layer_watch), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t, q(:), v(:)
    ! Steps that are made in parts see for themselves.
    self%on = system%layers%exist() .and. .not. (system%in_parts .or. allocated(system%signals))
    if (.not. self%on) return
    allocate (self%t(n_states), self%q(n_states, size(q)), self%v(n_states, size(v)))
    self%n = 1
    self%t(1) = t
    self%q(1, :) = q
    self%v(1, :) = v
  end subroutine begin

  !> After a step; `missed`: a layer may have been.
  subroutine see(self, system, t, q, v, missed)
    class(layer_watch), intent(inout) :: self
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: t, q(:), v(:)
    logical, intent(out) :: missed
    missed = .false.
    if (self%n == n_states) then
      missed = self%look(system)
      self%t(:n_shared) = self%t(n_states - n_shared + 1:)
      self%q(:n_shared, :) = self%q(n_states - n_shared + 1:, :)
      self%v(:n_shared, :) = self%v(n_states - n_shared + 1:, :)
      self%n = n_shared
    end if
    self%n = self%n + 1
    self%t(self%n) = t
    self%q(self%n, :) = q
    self%v(self%n, :) = v
  end subroutine see

  !> Whether a layer may have been missed between the states gathered.
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

end module viscovib_layer_watch
