!> viscovib-solve: runs a scene without Python.
!!
!! Exit status: 0 done; 1 computed, but some points have no solution (see the rows), a solution
!! stopped early or a limit on time or memory was reached; 2 invalid input; 3 a file cannot be read
!! or written. All scenes are tried; the largest status is returned.
program viscovib_solve
  use, intrinsic :: iso_c_binding, only: c_double
  use, intrinsic :: iso_fortran_env, only: error_unit
  use viscovib_command_line, only: command_line, read_command_line
  use viscovib_counters, only: counted, counter_names
  use viscovib_files, only: ignore_file_limit, print_line
  use viscovib_run_scene, only: plan_scene, run_scene, scene_report
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_kinds, only: wp
  use viscovib_status, only: one_line, status_type
  use viscovib_stopping, only: cut_short, stop_wanted
  use viscovib_version, only: version
  implicit none

  interface
    !> In app/limits.c.
    subroutine limit_seconds(seconds) bind(c, name='viscovib_limit_seconds')
      import :: c_double
      real(c_double), value :: seconds
    end subroutine limit_seconds

    subroutine limit_memory(bytes) bind(c, name='viscovib_limit_memory')
      import :: c_double
      real(c_double), value :: bytes
    end subroutine limit_memory
  end interface

  type(command_line) :: command
  type(status_type) :: status
  !> First error of writing to standard output.
  type(status_type) :: printed
  integer :: i, exit_status

  call ignore_file_limit()
  call read_command_line(command, status)
  if (status%failed()) call print_status(status)
  if (status%failed()) stop status%category, quiet=.true.
  if (command%text /= '') then
    call put(command%text)
    stop printed%category, quiet=.true.
  end if

  call limit_memory(command%memory)
  if (command%seconds > 0.0_wp) call limit_seconds(command%seconds)
  exit_status = 0
  do i = 1, size(command%scenes)
    if (i > 1 .and. stop_wanted()) then
      write (error_unit, '(3a)') 'viscovib-solve: ', one_line(command%scenes(i)%path), &
        ': not started, the time limit is reached (--max-seconds)'
      exit_status = max(exit_status, 1)
      cycle
    end if
    exit_status = max(exit_status, status_of(command%scenes(i)%path))
  end do
  if (command%count) call say_counts()
  exit_status = max(exit_status, printed%category)
  stop exit_status, quiet=.true.

contains

  !> Run or plan a scene. Returns its exit status.
  integer function status_of(path)
    character(len=*), intent(in) :: path
    type(scene_type) :: scene
    character(len=:), allocatable :: plan, line
    type(scene_report) :: report
    call read_scene(path, scene, status, allow_paths=command%allow_paths)
    if (.not. status%failed()) call plan_scene(scene, plan, status)
    status_of = status%category
    if (status%failed()) then
      call print_status(status)
      return
    end if
    call warn(scene%subject%warnings())
    if (command%plan) then
      if (command%quiet) return
      if (size(command%scenes) > 1) call put(one_line(path)//':')
      call put(plan(:len(plan) - 1))
      return
    end if
    call run_scene(scene, command%folder, version, report, status)
    status_of = status%category
    if (status%failed()) then
      call print_status(status)
      return
    end if
    if (cut_short()) report%complete = .false.
    if (.not. report%complete) status_of = 1
    line = one_line(report%path//': '//stop_text(report)//report%summary)
    if (.not. command%quiet) then
      call put(line)
    else if (.not. report%complete) then
      call warn(line//new_line('a'))
    end if
  end function status_of

  subroutine print_status(status)
    type(status_type), intent(in) :: status
    write (error_unit, '(2a)') 'viscovib-solve: ', one_line(status%message)
  end subroutine print_status

  !> Text about a limit that was reached.
  function stop_text(report)
    type(scene_report), intent(in) :: report
    character(len=:), allocatable :: stop_text
    stop_text = ''
    if (stop_wanted() .and. .not. report%complete) then
      stop_text = 'stopped: the time limit is reached (--max-seconds); '
    end if
  end function stop_text

  subroutine say_counts()
    character(len=80) :: line
    integer :: i
    do i = 1, size(counter_names)
      write (line, '(3a,i0)') 'counted: ', trim(counter_names(i)), ': ', counted(i)
      call put(trim(line))
    end do
  end subroutine say_counts

  !> Print a line to standard output.
  subroutine put(line)
    character(len=*), intent(in) :: line
    type(status_type) :: failed
    if (printed%failed()) return
    call print_line(line, failed)
    if (failed%failed()) call print_status(failed)
    printed = failed
  end subroutine put

  !> Print warnings, each terminated by a new-line character.
  subroutine warn(text)
    character(len=*), intent(in) :: text
    integer :: first, last
    first = 1
    do while (first <= len(text))
      last = first + index(text(first:), new_line('a')) - 2
      write (error_unit, '(2a)') 'warning: ', text(first:last)
      first = last + 2
    end do
  end subroutine warn

end program viscovib_solve
