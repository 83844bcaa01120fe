!> The command line of viscovib-solve.
module viscovib_command_line
  use viscovib_counters, only: counting
  use viscovib_files, only: stem
  use viscovib_help_texts, only: apart_note, memory_note, most_memory_note, paths_note, &
    same_names_note, seconds_note, status_note
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: parse_real
  use viscovib_status, only: clipped, fail, status_input_error, status_type
  use viscovib_version, only: version
  implicit none
  private

  public :: command_line, read_command_line

  type :: scene_path
    character(len=:), allocatable :: path
  end type scene_path

  type :: command_line
    !> Scenes in the given order.
    type(scene_path), allocatable :: scenes(:)
    character(len=:), allocatable :: folder
    logical :: plan = .false., quiet = .false., count = .false., allow_paths = .false.
    !> Limits: time (s; 0: none) and memory (bytes; 0: depends on the machine).
    real(wp) :: seconds = 0.0_wp, memory = 0.0_wp
    !> Text to print and exit (--help, --version); otherwise empty.
    character(len=:), allocatable :: text
  end type command_line

  character(len=*), parameter :: usage = &
    'usage: viscovib-solve scene.nml ... [--plan] [--out DIR] [--quiet] [--count] ' &
    //'[--allow-paths] [--max-seconds S] [--max-memory GB] [--help] [--version]'

contains

  subroutine read_command_line(command, status)
    type(command_line), intent(out) :: command
    type(status_type), intent(out) :: status
    character(len=:), allocatable :: word
    integer :: i

    allocate (command%scenes(0))
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
                    //'its work, the debug build does')
          return
        end if
      case ('--allow-paths')
        command%allow_paths = .true.
      case ('--max-seconds')
        i = i + 1
        call read_bound(word, argument(i), command%seconds, status)
        if (status%failed()) return
      case ('--max-memory')
        i = i + 1
        call read_bound(word, argument(i), command%memory, status)
        if (status%failed()) return
        command%memory = 1.0e9_wp*command%memory
      case ('--quiet')
        command%quiet = .true.
      case ('--help', '-h')
        command%text = help()
      case ('--version')
        command%text = 'viscovib-solve '//version
      case ('--out')
        i = i + 1
        ! An argument past the last is empty, like that of --out "". The table would then be
        ! written to the root folder.
        command%folder = argument(i)
        if (len(command%folder) == 0) then
          call fail(status, status_input_error, 'out', '--out needs a folder; '//usage)
          return
        end if
      case default
        if (index(word, '-') == 1 .or. len(word) == 0) then
          call fail(status, status_input_error, 'argument', "unknown argument '"//clipped(word) &
                    //"'; "//usage)
          return
        end if
        call add_scene(command, word, status)
        if (status%failed()) return
      end select
      i = i + 1
    end do
    if (command%text == '' .and. size(command%scenes) == 0) then
      call fail(status, status_input_error, 'scene', 'no scene given; '//usage)
    end if
  end subroutine read_command_line

  !> Add a scene. Its table names must be unique.
  subroutine add_scene(command, path, status)
    type(command_line), intent(inout) :: command
    character(len=*), intent(in) :: path
    type(status_type), intent(out) :: status
    type(scene_path), allocatable :: longer(:)
    integer :: i, n
    n = size(command%scenes)
    do i = 1, n
      if (stem(command%scenes(i)%path) /= stem(path)) cycle
      call fail(status, status_input_error, 'scene', clipped(path)//same_names_note &
                //clipped(command%scenes(i)%path)//apart_note)
      return
    end do
    allocate (longer(n + 1))
    do i = 1, n
      call move_alloc(command%scenes(i)%path, longer(i)%path)
    end do
    longer(n + 1)%path = path
    call move_alloc(longer, command%scenes)
  end subroutine add_scene

  !> Read the number of an option.
  subroutine read_bound(name, word, value, status)
    character(len=*), intent(in) :: name, word
    real(wp), intent(out) :: value
    type(status_type), intent(out) :: status
    logical :: ok
    call parse_real(word, value, ok)
    if (ok .and. value >= 0.01_wp .and. value <= 1.0e8_wp) return
    call fail(status, status_input_error, name, name//" '"//clipped(word)//"': must be a number, " &
              //'0.01 to 1e8')
  end subroutine read_bound

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
           //'Computes what scenes describe; writes tables (CSV) into DIR (default: out).'//nl &
           //'  --plan   print what would be computed and what is skipped, and stop'//nl &
           //'  --quiet  print only warnings and errors'//nl &
           //'  --count  print how often each kind of work was done (only in the debug ' &
           //'build)'//nl &
           //'  --allow-paths   '//paths_note//nl &
           //'  --max-seconds S   '//seconds_note//nl &
           //'  --max-memory GB   '//memory_note//nl &
           //'                    '//most_memory_note//nl//nl &
           //status_note//nl//nl &
           //'Examples:'//nl &
           //'  viscovib-solve mount.nml                     out/mount_response.csv'//nl &
           //'  viscovib-solve mount.nml --plan              what would be computed'//nl &
           //'  viscovib-solve scenes/*.nml --out tables --quiet'
  end function help

end module viscovib_command_line
