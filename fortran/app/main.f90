!> viscovib-solve: runs a scene without Python.
!!
!! Exit status: 0 done; 1 computed, but some points have no solution (the rows
!! say which), a motion stopped early or a bound on time or memory was reached; 2 bad input;
!! 3 a file cannot be read or written.
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
  use viscovib_stopping, only: stop_wanted
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
  type(scene_type) :: scene
  character(len=:), allocatable :: plan
  type(scene_report) :: report
  type(status_type) :: status

  call ignore_file_limit()
  call read_command_line(command, status)
  call stop_if_failed()
  if (command%text /= '') then
    write (output_unit, '(a)') command%text
    stop 0, quiet=.true.
  end if

  call limit_memory(command%memory)
  if (command%seconds > 0.0_wp) call limit_seconds(command%seconds)
  call read_scene(command%scene, scene, status, allow_paths=command%allow_paths)
  call stop_if_failed()
  call plan_scene(scene, plan, status)
  call stop_if_failed()
  call say(error_unit, 'warning: ', scene%subject%warnings())
  if (command%plan) then
    call say(output_unit, '', plan)
    stop 0, quiet=.true.
  end if

  call run_scene(scene, command%folder, version, report, status)
  call stop_if_failed()
  if (.not. command%quiet) write (output_unit, '(a)') one_line(report%path//': '//told_stop() &
                                                           //report%summary)
  if (command%count) call say_counts()
  if (.not. report%complete) stop 1, quiet=.true.

contains

  subroutine stop_if_failed()
    if (.not. status%failed()) return
    write (error_unit, '(2a)') 'viscovib-solve: ', one_line(status%message)
    stop status%category, quiet=.true.
  end subroutine stop_if_failed

  !> Words about a bound that was reached.
  function told_stop()
    character(len=:), allocatable :: told_stop
    told_stop = ''
    if (stop_wanted() .and. .not. report%complete) told_stop = 'stopped: time is over ' &
                                                               //'(--max-seconds); '
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
