!> The command line of viscovib-solve.
module viscovib_command_line
  use viscovib_counters, only: counting
  use viscovib_status, only: fail, status_input_error, status_type
  use viscovib_version, only: version
  implicit none
  private

  public :: command_line, read_command_line

  type :: command_line
    character(len=:), allocatable :: scene, folder
    logical :: plan = .false., quiet = .false., count = .false.
    !> To print instead of running (--help, --version); else empty.
    character(len=:), allocatable :: text
  end type command_line

  character(len=*), parameter :: usage = &
    'usage: viscovib-solve scene.nml [--plan] [--out DIR] [--quiet] [--count] ' &
    //'[--help] [--version]'

contains

  subroutine read_command_line(command, status)
    type(command_line), intent(out) :: command
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: word
    integer :: i

    command%scene = ''
    command%folder = 'out'
    command%text = ''
    i = 1
    do while (i <= command_argument_count())
      word = argument(i)
      select case (word)
      case ('--plan')
        command%plan = .true.
      case ('--count')
        command%count = .true.
        if (.not. counting) then
          call fail(status, status_input_error, 'count', '--count: this build does not count ' &
                    //'its work, only the one with all checks does')
          return
        end if
      case ('--quiet')
        command%quiet = .true.
      case ('--help', '-h')
        command%text = help()
      case ('--version')
        command%text = 'viscovib-solve '//version
      case ('--out')
        i = i + 1
        ! The argument past the last is empty, like the one of --out "": the
        ! table would go to the root folder.
        command%folder = argument(i)
        if (command%folder == '') then
          call fail(status, status_input_error, 'out', '--out lacks its folder; '//usage)
          return
        end if
      case default
        if (index(word, '-') == 1 .or. command%scene /= '') then
          call fail(status, status_input_error, 'argument', "unknown argument '"//word//"'; " &
                    //usage)
          return
        end if
        command%scene = word
      end select
      i = i + 1
    end do
    if (command%text == '' .and. command%scene == '') then
      call fail(status, status_input_error, 'scene', 'no scene given; '//usage)
    end if
  end subroutine read_command_line

  function argument(i)
    integer, intent(in) :: i
    character(len=:), allocatable :: argument
    integer :: n
    call get_command_argument(i, length=n)
    allocate (character(len=n) :: argument)
    call get_command_argument(i, argument)
  end function argument

  function help()
    character(len=:), allocatable :: help
    character(len=*), parameter :: nl = new_line('a')
    help = usage//nl//nl &
           //'Computes what a scene asks for and writes tables (CSV) into DIR (default: out).'//nl &
           //'  --plan   print what would be computed and what is skipped, and stop'//nl &
           //'  --quiet  print only warnings and errors'//nl &
           //'  --count  print how often each kind of work was done (in the build with all ' &
           //'checks)'//nl//nl &
           //'Exit status: 0 done; 1 some points have no solution (the rows say which);'//nl &
           //'2 bad input; 3 a file cannot be read or written.'
  end function help

end module viscovib_command_line
