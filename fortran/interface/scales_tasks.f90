!> Tasks about multiple scales.
module viscovib_scales_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: scales_task

contains

  subroutine scales_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine scales_task

end module viscovib_scales_tasks
