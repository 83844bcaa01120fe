!> Tasks about spectra.
module viscovib_spectrum_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: spectrum_task

contains

  subroutine spectrum_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine spectrum_task

end module viscovib_spectrum_tasks
