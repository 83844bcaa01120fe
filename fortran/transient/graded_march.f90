!> Runs whose step after a corner of the load consists of panels that double their length: a motion
!! with a steep kernel is not smooth there.
module viscovib_graded_march
  use viscovib_hereditary_start, only: panel_ends
  use viscovib_histories, only: keeping_type
  use viscovib_kinds, only: i8, wp
  use viscovib_march, only: march_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_time_load, only: load_clock, time_load_type
  implicit none
  private

  public :: graded_march_type, pull, push

  !> Length of the saved data of this type.
  integer, parameter, public :: n_common = 4

  type, abstract, extends(march_type) :: graded_march_type
    type(keeping_type) :: keeping
    !> Time, and the load at the nodes of a step.
    type(load_clock) :: clock
    !> True if the next step follows one of its own kind.
    logical :: rolling = .false.
    !> Index of the panel in progress; 0: the whole step.
    integer :: panel = 0
  contains
    procedure :: step
    procedure :: enter
    procedure :: common_memory
    procedure :: take_common
    procedure, private :: add_graded_step
    procedure(first_interface), deferred :: add_first_step
    procedure(plain_interface), deferred :: plain_step
    procedure(stand_interface), deferred :: stand_still
    procedure(panels_interface), deferred :: begin_panels
  end type graded_march_type

  abstract interface

    !> The first step as panels, where memory makes the start singular; `made` is false if
    !! a plain step suffices.
    subroutine first_interface(self, system, load, made)
      import :: graded_march_type, oscillator_type, time_load_type
      class(graded_march_type), intent(inout), target :: self
      class(oscillator_type), intent(in) :: system
      type(time_load_type), intent(in) :: load
      logical, intent(out) :: made
    end subroutine first_interface

    !> One step to time `until`, as a polynomial.
    subroutine plain_interface(self, system, load, until, made)
      import :: graded_march_type, oscillator_type, time_load_type, wp
      class(graded_march_type), intent(inout) :: self
      class(oscillator_type), intent(in) :: system
      type(time_load_type), intent(in) :: load
      real(wp), intent(in) :: until
      logical, intent(out) :: made
    end subroutine plain_interface

    !> Start the next step at the present state, without extrapolation from the previous step.
    subroutine stand_interface(self, system)
      import :: graded_march_type, oscillator_type
      class(graded_march_type), intent(inout) :: self
      class(oscillator_type), intent(in) :: system
    end subroutine stand_interface

    !> Allocate panels of one step, so that states inside it can be computed.
    subroutine panels_interface(self, ends)
      import :: graded_march_type, wp
      class(graded_march_type), intent(inout) :: self
      !> From the beginning of the step, 0 first.
      real(wp), intent(in) :: ends(0:)
    end subroutine panels_interface

  end interface

contains

  subroutine step(self, system, load, n_before, until, made)
    class(graded_march_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    integer(i8), intent(in) :: n_before
    real(wp), intent(in) :: until
    logical, intent(out) :: made
    logical :: graded

    graded = self%keeping%at_corner
    self%keeping%at_corner = .false.
    if (n_before == 0) then
      call self%add_first_step(system, load, made)
      if (made) return
    end if
    if (graded) then
      call self%add_graded_step(system, load, until, made)
    else
      call self%plain_step(system, load, until, made)
    end if
    if (made) return
    self%keeping%at_corner = graded
    ! The failed step gives no prediction.
    call self%stand_still(system)
  end subroutine step

  !> One step after a corner of the load. Lengths are powers of 2 except the last, so that
  !! other steps can reuse their maps.
  subroutine add_graded_step(self, system, load, until, made)
    class(graded_march_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: until
    logical, intent(out) :: made
    real(wp) :: from, h
    real(wp), allocatable :: ends(:), memory(:)
    integer :: k, n

    h = self%h
    from = self%clock%t
    allocate (memory, source=self%save_memory())
    n = self%keeping%n_doublings + 1
    allocate (ends(0:n))
    ends(:) = panel_ends(h, self%keeping%n_doublings, self%keeping%between)
    call self%begin_panels(ends)
    do k = 1, n
      self%panel = k
      call self%change_step(system, load, from + ends(k - 1), ends(k) - ends(k - 1), made)
      if (made) call self%plain_step(system, load, from + ends(k), made)
      if (.not. made) exit
    end do
    self%panel = 0
    if (made) then
      call self%change_step(system, load, until, h, made)
    else
      call self%load_memory(memory, .false.)
      call self%change_step(system, load, from, h, made)
      made = .false.
    end if
  end subroutine add_graded_step

  subroutine enter(self, system, load, t, h, made)
    class(graded_march_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    real(wp), intent(in) :: t, h
    logical, intent(out) :: made
    real(wp) :: before

    before = self%h
    call self%change_step(system, load, t, h, made)
    call self%keeping%turn(before, h)
  end subroutine enter

  !> Data of this type that a run needs to continue, shape (n_common).
  pure function common_memory(self) result(memory)
    class(graded_march_type), intent(in) :: self
    real(wp) :: memory(n_common)
    memory = [merge(1.0_wp, 0.0_wp, self%rolling), self%clock%t, &
              merge(1.0_wp, 0.0_wp, self%keeping%at_corner), real(self%keeping%n_doublings, wp)]
  end function common_memory

  pure subroutine take_common(self, memory)
    class(graded_march_type), intent(inout) :: self
    real(wp), intent(in) :: memory(n_common)
    self%rolling = memory(1) > 0.5_wp
    self%clock%t = memory(2)
    self%keeping%at_corner = memory(3) > 0.5_wp
    self%keeping%n_doublings = nint(memory(4))
  end subroutine take_common

  !> Append a part after the first n numbers, and increase n.
  pure subroutine push(memory, n, part)
    real(wp), intent(inout) :: memory(:)
    integer, intent(inout) :: n
    real(wp), intent(in) :: part(:)
    memory(n + 1:n + size(part)) = part
    n = n + size(part)
  end subroutine push

  !> Read the next part, and increase n.
  pure subroutine pull(memory, n, part)
    real(wp), intent(in) :: memory(:)
    integer, intent(inout) :: n
    real(wp), intent(out) :: part(:)
    part = memory(n + 1:n + size(part))
    n = n + size(part)
  end subroutine pull

end module viscovib_graded_march
