!> Tasks about scenes.
module viscovib_scene_tasks
  use viscovib_grids, only: linear_grid, log_grid
  use viscovib_kinds, only: i8, wp
  use viscovib_run_scene, only: plan_scene, run_scene, scene_report
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_task, only: task_type
  use viscovib_version, only: version
  implicit none
  private

  public :: scene_task

contains

  subroutine scene_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('canonical')
      call write_canonical(task)
    case ('plan')
      call plan_one(task)
    case ('run')
      call run_one(task)
    case ('grid')
      call make_grid(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine scene_task

  !> The scene of a `text`, which `path` names in messages, or of the file `path`; `allow_paths`:
  !! files that it names may be anywhere, not only in its folder or below.
  subroutine read_one(task, scene)
    type(task_type), intent(inout) :: task
    type(scene_type), intent(out) :: scene
    character(len=:), allocatable :: path, text
    logical :: allow_paths

    call task%take_text('path', path)
    allow_paths = task%get_flag('allow_paths', .false.)
    if (task%failed()) return
    if (task%has('text')) then
      call task%take_text('text', text)
      call read_scene(path, scene, task%status, text)
    else
      call read_scene(path, scene, task%status, allow_paths=allow_paths)
    end if
  end subroutine read_one

  !> A scene as a namelist with every default written out: `text`.
  subroutine write_canonical(task)
    type(task_type), intent(inout) :: task
    type(scene_type) :: scene
    call read_one(task, scene)
    if (.not. task%failed()) call task%found%put_text('text', scene%canonical)
  end subroutine write_canonical

  !> What a scene would compute and skip: `plan`.
  subroutine plan_one(task)
    type(task_type), intent(inout) :: task
    type(scene_type) :: scene
    character(len=:), allocatable :: lines
    call read_one(task, scene)
    if (.not. task%failed()) call plan_scene(scene, lines, task%status)
    if (.not. task%failed()) call task%found%put_text('plan', lines)
  end subroutine plan_one

  !> Write the tables of a scene into a `folder`: `summary`, and `complete`, 1 if nothing is
  !! missing.
  subroutine run_one(task)
    type(task_type), intent(inout) :: task
    type(scene_type) :: scene
    type(scene_report) :: report
    character(len=:), allocatable :: folder
    call read_one(task, scene)
    call task%take_text('folder', folder)
    if (.not. task%failed()) call run_scene(scene, folder, version, report, task%status)
    if (task%failed()) return
    call task%found%put_text('summary', report%summary)
    call task%found%put_integer('complete', merge(1_i8, 0_i8, report%complete))
  end subroutine run_one

  !> `values` (n) with equal steps, or equal factors if `logarithmic`, from `first` to `last`.
  subroutine make_grid(task)
    type(task_type), intent(inout) :: task
    real(wp), allocatable :: values(:)
    real(wp) :: first, last
    integer :: n
    logical :: logarithmic

    first = task%get_real('first')
    last = task%get_real('last')
    n = task%get_integer('n')
    logarithmic = task%get_flag('logarithmic')
    if (task%failed()) return
    allocate (values(n))
    if (logarithmic) then
      values = log_grid(first, last, n)
    else
      values = linear_grid(first, last, n)
    end if
    call task%found%put_reals('values', values, shape(values))
  end subroutine make_grid

end module viscovib_scene_tasks
