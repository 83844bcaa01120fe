!> Objects that are systems.
module viscovib_system_tasks
  use viscovib_binding_tools, only: make_pendulum, make_system
  use viscovib_kinds, only: wp
  use viscovib_task, only: built_pendulum, built_system, task_type
  implicit none
  private

  public :: system_task

contains

  subroutine system_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('oscillator')
      call build_system(task)
    case ('pendulum')
      call build_pendulum(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine system_task

  !> An oscillator: `flat` (n), `kind_x`, `data_x` (m), `kind_phi`, `data_phi` (k) as of
  !! `make_system`.
  subroutine build_system(task)
    type(task_type), intent(inout) :: task
    type(built_system), allocatable :: own
    real(wp), pointer, contiguous :: flat(:), data_x(:), data_phi(:)
    integer :: kind_x, kind_phi

    allocate (own)
    flat => task%get_reals('flat')
    kind_x = task%get_integer('kind_x')
    data_x => task%get_reals('data_x')
    kind_phi = task%get_integer('kind_phi')
    data_phi => task%get_reals('data_phi')
    if (task%failed()) return
    call make_system(own%it, flat, kind_x, data_x, kind_phi, data_phi, task%status)
    if (.not. task%failed()) call move_alloc(own, task%built)
  end subroutine build_system

  !> A pendulum: `flat` (14) as of `make_pendulum`.
  subroutine build_pendulum(task)
    type(task_type), intent(inout) :: task
    type(built_pendulum), allocatable :: own
    real(wp), pointer, contiguous :: flat(:)

    allocate (own)
    flat => task%get_reals('flat')
    call task%check_extents('flat', shape(flat), [14])
    if (task%failed()) return
    call make_pendulum(own%it, flat, task%status)
    if (.not. task%failed()) call move_alloc(own, task%built)
  end subroutine build_pendulum

end module viscovib_system_tasks
