! Flat routines over scenes, for f2py.

!> Read a scene and give it back as a namelist with every default written out.
!! If the text is longer than the room given, n_text says what is needed.
subroutine scene_canonical(path, allow_paths, max_text, text, n_text, status)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_binding_tools, only: report, send
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_status, only: status_type
  implicit none
  character(len=*), intent(in) :: path
  !> Files that it names may be anywhere, not only in its folder or below.
  integer(c_int), intent(in) :: allow_paths
  integer(c_int), intent(in) :: max_text
  character(len=1), intent(out) :: text(max_text)
  integer(c_int), intent(out) :: n_text, status
  type(scene_type) :: scene
  type(status_type) :: outcome

  text = ' '
  n_text = 0
  call read_scene(path, scene, outcome, allow_paths=allow_paths /= 0)
  if (.not. outcome%failed()) call send(scene%canonical, text, n_text)
  call report(outcome, status)
end subroutine scene_canonical

!> As scene_canonical, from the text of a scene; `path` only names it in messages.
subroutine scene_canonical_of_text(path, given, max_text, text, n_text, status)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_binding_tools, only: report, send
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_status, only: status_type
  implicit none
  character(len=*), intent(in) :: path, given
  integer(c_int), intent(in) :: max_text
  character(len=1), intent(out) :: text(max_text)
  integer(c_int), intent(out) :: n_text, status
  type(scene_type) :: scene
  type(status_type) :: outcome

  text = ' '
  n_text = 0
  call read_scene(path, scene, outcome, given)
  if (.not. outcome%failed()) call send(scene%canonical, text, n_text)
  call report(outcome, status)
end subroutine scene_canonical_of_text

!> What the scene of a text would compute and skip; `path` only names it in messages.
subroutine scene_plan(path, given, max_text, text, n_text, status)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_binding_tools, only: report, send
  use viscovib_run_scene, only: plan_scene
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_status, only: status_type
  implicit none
  character(len=*), intent(in) :: path, given
  integer(c_int), intent(in) :: max_text
  character(len=1), intent(out) :: text(max_text)
  integer(c_int), intent(out) :: n_text, status
  type(scene_type) :: scene
  type(status_type) :: outcome
  character(len=:), allocatable :: lines

  text = ' '
  n_text = 0
  call read_scene(path, scene, outcome, given)
  if (.not. outcome%failed()) call plan_scene(scene, lines, outcome)
  if (.not. outcome%failed()) call send(lines, text, n_text)
  call report(outcome, status)
end subroutine scene_plan

!> Do what the scene of a text asks for, and write its tables into a folder, as the driver does;
!! `path` names it. complete: 1 if all of it was found.
subroutine scene_run(path, given, folder, max_text, text, n_text, complete, status)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_binding_tools, only: report, send
  use viscovib_run_scene, only: run_scene_at => run_scene, scene_report
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_status, only: status_type
  use viscovib_version, only: version
  implicit none
  character(len=*), intent(in) :: path, given, folder
  integer(c_int), intent(in) :: max_text
  !> What is to be said of it.
  character(len=1), intent(out) :: text(max_text)
  integer(c_int), intent(out) :: n_text, complete, status
  !f2py threadsafe
  type(scene_type) :: scene
  type(scene_report) :: told
  type(status_type) :: outcome

  text = ' '
  n_text = 0
  complete = 0
  call read_scene(path, scene, outcome, given)
  if (.not. outcome%failed()) call run_scene_at(scene, folder, version, told, outcome)
  if (.not. outcome%failed()) then
    call send(told%summary, text, n_text)
    complete = merge(1, 0, told%complete)
  end if
  call report(outcome, status)
end subroutine scene_run

!> Evenly spaced frequencies, as scenes make them.
subroutine frequency_grid(lowest, highest, logarithmic, n, grid)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_grids, only: linear_grid, log_grid
  implicit none
  real(c_double), intent(in) :: lowest, highest
  integer(c_int), intent(in) :: logarithmic, n
  real(c_double), intent(out) :: grid(n)
  if (logarithmic /= 0) then
    grid = log_grid(lowest, highest, n)
  else
    grid = linear_grid(lowest, highest, n)
  end if
end subroutine frequency_grid

!> Ask loops that may take long to end with what they have (1), or to go on (0).
subroutine stop_loops(flag)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_stopping, only: want_stop
  implicit none
  integer(c_int), intent(in) :: flag
  call want_stop(flag /= 0)
end subroutine stop_loops

!> Let loops of this thread end with what they have once another thread sets flag(1), which must
!! exist as long as this thread.
subroutine listen(flag)
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none
  integer(c_int), intent(inout) :: flag(1)
  interface
    subroutine c_listen(flag) bind(c, name='viscovib_listen')
      import :: c_int
      integer(c_int), intent(in) :: flag(1)
    end subroutine c_listen
  end interface
  call c_listen(flag)
end subroutine listen

!> Points of curves and values that loops have begun since the program started.
subroutine pieces_of_work(n)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_stopping, only: pieces_begun
  implicit none
  integer(c_int), intent(out) :: n
  n = pieces_begun()
end subroutine pieces_of_work
