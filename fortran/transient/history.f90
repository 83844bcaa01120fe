!> Abstract memory of a run: the motion before the present step.
!!
!! The memory of a channel g is (R*g)(t) without the contribution of the present step.
module viscovib_history
  use viscovib_known_past, only: known_past_type
  use viscovib_collocation, only: collocation_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: history_type, past_type, far_nodes

  !> Nodes that represent the whole past except the last panel.
  integer, parameter :: far_nodes = 24

  !> The motion on [0, h] if its first step consisted of panels: point masses that
  !! represent the channels on [0, h/2] for all times beyond h, and the
  !! channels at the points of a step on the last panel, [h/2, h]. Without masses there is no
  !! such past.
  type :: past_type
    !> Times, shape (n); masses, shape (n, n_channels).
    real(wp), allocatable :: times(:), masses(:, :)
    !> Length of the last panel; channels there, shape (0:s+1, n_channels).
    real(wp) :: length = 0.0_wp
    real(wp), allocatable :: last(:, :)
  end type past_type

  type, abstract :: history_type
    !> Shape (n_channels).
    integer, allocatable :: kernel_of(:)
  contains
    procedure(recall_interface), deferred :: recall
    procedure(store_interface), deferred :: store
    procedure(ancient_interface), deferred :: add_known_past
    procedure(begin_interface), deferred :: begin
    procedure(change_interface), deferred :: change_step
    procedure(size_interface), deferred :: memory_size
    procedure(save_interface), deferred :: save_memory
    procedure(load_interface), deferred :: load_memory
  end type history_type

  abstract interface

    !> Memory at the nodes of the present step, node i of channel c at (c-1) s + i.
    subroutine recall_interface(self, remembered)
      import :: history_type, wp
      class(history_type), intent(in) :: self
      real(wp), intent(out), contiguous :: remembered(:)
    end subroutine recall_interface

    !> Store a completed step: the channels at its points, shape (0:s+1, n_channels).
    subroutine store_interface(self, g)
      import :: history_type, wp
      class(history_type), intent(inout) :: self
      real(wp), intent(in), contiguous :: g(0:, :)
    end subroutine store_interface

    !> Add a known motion before t = 0; called before any step.
    subroutine ancient_interface(self, known_past)
      import :: known_past_type, history_type
      class(history_type), intent(inout) :: self
      type(known_past_type), intent(in) :: known_past
    end subroutine ancient_interface

    !> Start with the second step, after a first one made of panels.
    subroutine begin_interface(self, table, past)
      import :: collocation_type, history_type, past_type
      class(history_type), intent(inout) :: self
      type(collocation_type), intent(in) :: table
      type(past_type), intent(in) :: past
    end subroutine begin_interface

    !> Set the step length to h from now on.
    subroutine change_interface(self, h)
      import :: history_type, wp
      class(history_type), intent(inout) :: self
      real(wp), intent(in) :: h
    end subroutine change_interface

    pure integer function size_interface(self)
      import :: history_type
      class(history_type), intent(in) :: self
    end function size_interface

    pure function save_interface(self) result(memory)
      import :: history_type, wp
      class(history_type), intent(in) :: self
      real(wp) :: memory(self%memory_size())
    end function save_interface

    subroutine load_interface(self, memory)
      import :: history_type, wp
      class(history_type), intent(inout) :: self
      real(wp), intent(in) :: memory(:)
    end subroutine load_interface

  end interface

end module viscovib_history
