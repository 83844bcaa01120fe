!> viscovib-solve: runs a scene without Python.
!!
!! Exit status: 0 done; 1 computed, but some points have no solution (the rows
!! say which), a motion stopped early or a bound on time or memory was reached; 2 bad input;
!! 3 a file cannot be read or written. Of several scenes each is tried; the largest counts.
program viscovib_solve
  use, intrinsic :: iso_c_binding, only: c_double
  use, intrinsic :: iso_fortran_env, only: error_unit, output_unit
  use viscovib_command_line, only: command_line, read_command_line
  use viscovib_counters, only: counted, counter_names
  use viscovib_files, only: ignore_file_limit
  use viscovib_run_scene, only: plan_scene, run_scene, scene_report
  use viscovib_scene, only: read_scene, scene_type
  use viscovib_kinds, only: wp
  use viscovib_status, only: one_line, status_type
  use viscovib_stopping, only: cut_short, stop_wanted
  use viscovib_version, only: version
  implicit none

  interface
    !> From app/limits.c.
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
  integer :: i, exit_status

  call ignore_file_limit()
  call read_command_line(command, status)
  if (status%failed()) call tell(status)
  if (status%failed()) stop status%category, quiet=.true.
  if (command%text /= '') then
    write (output_unit, '(a)') command%text
    stop 0, quiet=.true.
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
  stop exit_status, quiet=.true.

contains

  !> Compute a scene, or tell its plan; the exit status if it were the only one.
  integer function status_of(path)
    character(len=*), intent(in) :: path
    type(scene_type) :: scene
    character(len=:), allocatable :: plan
    type(scene_report) :: report
    call read_scene(path, scene, status, allow_paths=command%allow_paths)
    if (.not. status%failed()) call plan_scene(scene, plan, status)
    status_of = status%category
    if (status%failed()) then
      call tell(status)
      return
    end if
    call say(error_unit, 'warning: ', scene%subject%warnings())
    if (command%plan) then
      if (size(command%scenes) > 1) call say(output_unit, '', one_line(path)//':'//new_line('a'))
      call say(output_unit, '', plan)
      return
    end if
    call run_scene(scene, command%folder, version, report, status)
    status_of = status%category
    if (status%failed()) then
      call tell(status)
      return
    end if
    if (.not. command%quiet) then
      write (output_unit, '(a)') one_line(report%path//': '//told_stop(report)//report%summary)
    end if
    if (cut_short()) report%complete = .false.
    if (.not. report%complete) status_of = 1
  end function status_of

  subroutine tell(status)
    type(status_type), intent(in) :: status
    write (error_unit, '(2a)') 'viscovib-solve: ', one_line(status%message)
  end subroutine tell

  !> Words about a bound that was reached.
  function told_stop(report)
    type(scene_report), intent(in) :: report
    character(len=:), allocatable :: told_stop
    told_stop = ''
    if (stop_wanted() .and. .not. report%complete) then
      told_stop = 'stopped: the time limit is reached (--max-seconds); '
    end if
  end function told_stop

  subroutine say_counts()
    integer :: i
    do i = 1, size(counter_names)
      write (output_unit, '(3a,i0)') 'counted: ', trim(counter_names(i)), ': ', counted(i)
    end do
  end subroutine say_counts

  !> Lines of text, each ended by a new-line character.
  subroutine say(unit, prefix, text)
    integer, intent(in) :: unit
    character(len=*), intent(in) :: prefix, text
    integer :: first, last
    if (command%quiet .and. unit == output_unit) return
    first = 1
    do while (first <= len(text))
      last = first + index(text(first:), new_line('a')) - 2
      write (unit, '(2a)') prefix, text(first:last)
      first = last + 2
    end do
  end subroutine say

end program viscovib_solve
