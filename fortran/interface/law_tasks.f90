!> Tasks about force laws and elements with a state.
module viscovib_law_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: law_task

contains

  subroutine law_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine law_task

end module viscovib_law_tasks
