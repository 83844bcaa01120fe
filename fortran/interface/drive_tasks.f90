!> Tasks about steady motions of a driven pendulum.
module viscovib_drive_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: drive_task

contains

  subroutine drive_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine drive_task

end module viscovib_drive_tasks
