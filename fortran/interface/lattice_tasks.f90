!> Tasks about lattices of several base frequencies.
module viscovib_lattice_tasks
  use viscovib_task, only: task_type
  implicit none
  private

  public :: lattice_task

contains

  subroutine lattice_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case default
      call task%refuse_kind()
    end select
  end subroutine lattice_task

end module viscovib_lattice_tasks
