!> Tasks about scenes.
module viscovib_scene_tasks
  use viscovib_grids, only: linear_grid, log_grid
  use viscovib_job, only: job_report, table_sink
  use viscovib_kinds, only: i8, wp
  use viscovib_named_values, only: named_values
  use viscovib_run_scene, only: compute_scene, plan_scene
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_status, only: set_ok, show, status_type
  use viscovib_table, only: table_type
  use viscovib_task, only: task_type
  implicit none
  private

  public :: scene_task

  character(len=*), parameter :: nl = new_line('a')

  !> Tables as named values. For table i, from 1: "name_i", "notes_i", "columns_i" (names, one per
  !! line), "values_i" (rows, columns), "whole_i" (whether a column contains integers) and "words_i"
  !! (for codes 0, 1, ... of each column, one line per word, after the column number, from 1).
  type, extends(table_sink) :: values_sink
    type(named_values), pointer :: found => null()
    integer :: n = 0
  contains
    procedure :: put => put_values
  end type values_sink

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

  !> The scene from `text`, called `path` in messages, or from the file `path`. `allow_paths`: files
  !! that it names may be anywhere, not only in its folder or below.
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

  !> Run a scene. Returns its tables (see `values_sink`), `summary`, and `complete`, 1 if nothing is
  !! missing.
  subroutine run_one(task)
    type(task_type), intent(inout), target :: task
    type(scene_type) :: scene
    type(job_report) :: report
    type(values_sink) :: sink

    call read_one(task, scene)
    if (task%failed()) return
    sink%found => task%found
    call compute_scene(scene, sink, report, task%status)
    if (task%failed()) return
    call task%found%put_text('summary', report%summary)
    call task%found%put_integer('complete', merge(1_i8, 0_i8, report%complete))
    call task%found%put_integer('n_tables', int(sink%n, i8))
  end subroutine run_one

  subroutine put_values(self, name, table, status)
    class(values_sink), intent(inout) :: self
    character(len=*), intent(in) :: name
    type(table_type), intent(in) :: table
    type(status_type), intent(out) :: status
    real(wp) :: values(table%n_rows(), table%n_columns())
    integer :: whole(table%n_columns()), i, j
    character(len=:), allocatable :: columns, words, place

    call set_ok(status)
    columns = ''
    words = ''
    do j = 1, size(whole)
      columns = columns//table%name(j)//nl
      values(:, j) = table%numbers(j)
      whole(j) = merge(1, 0, table%is_whole(j))
      do i = 0, table%n_words(j) - 1
        words = words//show(j)//' '//table%word(j, i)//nl
      end do
    end do
    self%n = self%n + 1
    place = '_'//show(self%n)
    call self%found%put_text('name'//place, name)
    call self%found%put_text('notes'//place, table%all_notes())
    call self%found%put_text('columns'//place, columns)
    call self%found%put_text('words'//place, words)
    call self%found%put_reals('values'//place, values, shape(values))
    call self%found%put_integers('whole'//place, whole, shape(whole))
  end subroutine put_values

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
