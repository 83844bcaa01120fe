!> A scene: the system, its load and the results wanted, as one namelist file.
module viscovib_scene
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_job, only: job_type
  use viscovib_law_parameters, only: read_parameters
  use viscovib_locks, only: lock_texts, unlock_texts
  use viscovib_namelist, only: group_type, namelist_type, read_namelist
  use viscovib_scene_groups, only: check_groups, find_result
  use viscovib_scene_results, only: read_result
  use viscovib_scene_subject, only: read_subject
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_subject, only: subject_type
  use viscovib_sweep_groups, only: read_sweep
  implicit none
  private

  public :: scene_type, read_scene

  type :: scene_type
    character(len=:), allocatable :: path, title
    type(subject_type) :: subject
    class(job_type), allocatable :: job
    !> Line of the first &sweep, 0 without: one point is computed, or a grid of them.
    integer :: sweep_line = 0
    !> The group of the result. Its lines are part of error messages of the computation.
    type(group_type) :: asked
    !> Whether it was read from a text that stands for the file, whose lines are others.
    logical :: of_text = .false.
    !> The scene as it was understood, every default written out; reads back
    !! to the same numbers.
    character(len=:), allocatable :: canonical
  end type scene_type

contains

  !> Read and check everything; nothing is computed yet.
  subroutine read_scene(path, scene, status, text, allow_paths)
    character(len=*), intent(in) :: path
    type(scene_type), intent(out), target :: scene
    type(status_type), intent(out) :: status
    !> The scene itself, instead of the file; its path then only names it.
    character(len=*), intent(in), optional :: text
    !> Whether files that it names may be anywhere; else in its folder or below.
    logical, intent(in), optional :: allow_paths
    type(namelist_type) :: file
    type(growing_text) :: canonical
    character(len=:), allocatable :: unused

    call lock_texts()
    scene%path = path
    scene%of_text = present(text)
    call read_namelist(path, file, status, text)
    if (present(allow_paths)) file%groups%anywhere = allow_paths
    if (.not. status%failed()) call check_groups(file, status)
    if (.not. status%failed()) call read_title(file, scene, canonical, status)
    if (.not. status%failed()) call read_parameters(file, unused, canonical, status)
    if (.not. status%failed()) call read_subject(file, scene%subject, canonical, status)
    if (.not. status%failed()) then
      scene%asked = file%groups(find_result(file))
      call read_result(file, scene%subject, scene%job, canonical, status)
    end if
    if (.not. status%failed()) call read_sweeps(file, scene, canonical, status)
    if (.not. status%failed() .and. allocated(unused)) then
      if (unused /= '') call fail(status, status_input_error, 'parameters', unused)
    end if
    scene%canonical = canonical%text()
    call unlock_texts()
  end subroutine read_scene

  subroutine read_title(file, scene, canonical, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(growing_text), intent(inout) :: canonical
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    integer :: i

    scene%title = ''
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'scene') cycle
      call reader%start(file%path, file%groups(i))
      scene%title = reader%read_text('title')
      call reader%close(canonical, status)
    end do
  end subroutine read_title

  !> Every &sweep is a parameter; no two may be the same.
  subroutine read_sweeps(file, scene, canonical, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(growing_text), intent(inout) :: canonical
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=:), allocatable :: key, keys
    integer :: i, n
    ! A grid of more is beyond what is computed, and its size beyond what is counted.
    integer, parameter :: max_sweeps = 16

    keys = ';'
    n = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'sweep') cycle
      call reader%start(file%path, file%groups(i))
      call read_sweep(reader, canonical%text(), key)
      n = n + 1
      if (n > max_sweeps) then
        call reader%complain('sweep', '&sweep: must be at most '//show(max_sweeps)//' of them')
      end if
      if (index(keys, ';'//key//';') > 0) then
        call reader%complain('key', "key = '"//key//"': is swept already")
      end if
      keys = keys//key//';'
      if (scene%sweep_line == 0) scene%sweep_line = file%groups(i)%line
      call reader%close(canonical, status)
      if (status%failed()) return
    end do
  end subroutine read_sweeps

end module viscovib_scene
