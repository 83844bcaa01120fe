!> Tasks about steady motions of oscillators.
module viscovib_response_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: response_task

contains

  subroutine response_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine response_task

end module viscovib_response_tasks
