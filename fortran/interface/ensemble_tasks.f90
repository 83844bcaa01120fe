!> Tasks about many motions side by side, and basins.
module viscovib_ensemble_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: ensemble_task

contains

  subroutine ensemble_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine ensemble_task

end module viscovib_ensemble_tasks
