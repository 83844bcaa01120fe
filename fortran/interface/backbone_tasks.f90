!> Tasks about free vibrations along their amplitude.
module viscovib_backbone_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: backbone_task

contains

  subroutine backbone_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine backbone_task

end module viscovib_backbone_tasks
