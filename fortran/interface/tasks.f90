!> All tasks by name. The first word of the name is the family, which has a module.
module viscovib_tasks
  use viscovib_backbone_tasks, only: backbone_task
  use viscovib_branch_tasks, only: branch_task
  use viscovib_drive_tasks, only: drive_task
  use viscovib_ensemble_tasks, only: ensemble_task
  use viscovib_kernel_tasks, only: kernel_task
  use viscovib_lattice_tasks, only: lattice_task
  use viscovib_law_tasks, only: law_task
  use viscovib_locks, only: lock_texts, unlock_texts
  use viscovib_motion_tasks, only: motion_task
  use viscovib_response_tasks, only: response_task
  use viscovib_scales_tasks, only: scales_task
  use viscovib_scene_tasks, only: scene_task
  use viscovib_spectrum_tasks, only: spectrum_task
  use viscovib_system_tasks, only: system_task
  use viscovib_task, only: task_type
  implicit none
  private

  public :: run_task

contains

  !> Run a task by its kind.
  subroutine run_task(task)
    type(task_type), intent(inout) :: task
    character(len=:), allocatable :: name
    integer :: space
    logical :: of_texts

    space = index(task%kind//' ', ' ')
    name = task%kind(space + 1:)
    ! Compiling and planning create many texts.
    of_texts = index(name, 'plan') > 0 .or. index(name, 'compile') > 0
    if (of_texts) call lock_texts()
    select case (task%kind(:space - 1))
    case ('backbone')
      call backbone_task(task, name)
    case ('branch')
      call branch_task(task, name)
    case ('drive')
      call drive_task(task, name)
    case ('ensemble')
      call ensemble_task(task, name)
    case ('kernel')
      call kernel_task(task, name)
    case ('lattice')
      call lattice_task(task, name)
    case ('law')
      call law_task(task, name)
    case ('motion')
      call motion_task(task, name)
    case ('response')
      call response_task(task, name)
    case ('scales')
      call scales_task(task, name)
    case ('scene')
      call scene_task(task, name)
    case ('spectrum')
      call spectrum_task(task, name)
    case ('system')
      call system_task(task, name)
    case default
      call task%refuse_kind()
    end select
    if (of_texts) call unlock_texts()
  end subroutine run_task

end module viscovib_tasks
