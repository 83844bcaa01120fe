!> Tasks about scenes.
module viscovib_scene_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: scene_task

contains

  subroutine scene_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine scene_task

end module viscovib_scene_tasks
