!> Tasks about motions in time.
module viscovib_motion_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: motion_task

contains

  subroutine motion_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine motion_task

end module viscovib_motion_tasks
