!> Tasks about branches of steady motions.
module viscovib_branch_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: branch_task

contains

  subroutine branch_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine branch_task

end module viscovib_branch_tasks
