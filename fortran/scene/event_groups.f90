!> The &event groups of a scene: functions of the state of a motion in time of which passages
!! through 0 are wanted.
module viscovib_event_groups
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kinds, only: wp
  use viscovib_law_faults, only: complain_of_law
  use viscovib_law_functions, only: put_argument
  use viscovib_law_program, only: law_program
  use viscovib_law_text, only: compile_law
  use viscovib_motion_job, only: motion_job, event_text
  use viscovib_namelist, only: lower, namelist_type
  use viscovib_near_words, only: listed
  use viscovib_scene_groups, only: place_of
  use viscovib_status, only: show, status_type
  use viscovib_subject, only: name_length
  implicit none
  private

  public :: read_events

  integer, parameter :: most_events = 100, most_listed = 6
  !> Of the words of `direction`.
  integer, parameter :: sign_of(3) = [0, 1, -1]

contains

  !> All events, for a run (`new_watch`) and for messages.
  subroutine read_events(file, coordinates, job, canonical, status)
    type(namelist_type), intent(in) :: file
    character(len=name_length), intent(in) :: coordinates(:)
    type(motion_job), intent(inout) :: job
    type(growing_text), intent(inout) :: canonical
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=name_length + 4) :: arguments(2*size(coordinates) + 1)
    real(wp), allocatable :: numbers(:)
    type(event_text), allocatable :: description(:)
    integer :: i, n

    n = count([(file%groups(i)%name == 'event', i=1, size(file%groups))])
    if (n == 0) return
    do i = 1, size(coordinates)
      arguments(2*i - 1) = coordinates(i)
      arguments(2*i) = trim(coordinates(i))//'_dot'
    end do
    arguments(size(arguments)) = 't'
    allocate (description(n))
    numbers = [real(n, wp)]
    n = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'event') cycle
      n = n + 1
      call reader%start(file%path, file%groups(i))
      if (n > most_events) then
        call reader%complain('event', '&event: must be at most '//show(most_events)//' of them')
      end if
      call read_event(reader, arguments, numbers, description(n))
      call reader%close(canonical, status)
      if (status%failed()) return
    end do
    call check_parameters(file, arguments, status)
    if (status%failed()) return
    job%motion%watched = numbers
    call move_alloc(description, job%events)
  end subroutine read_events

  subroutine read_event(reader, arguments, numbers, description)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: arguments(:)
    real(wp), allocatable, intent(inout) :: numbers(:)
    type(event_text), intent(out) :: description
    type(law_program) :: program
    character(len=:), allocatable :: text, word, fault
    character(len=len(arguments)) :: none(0)
    real(wp) :: no_values(0)
    logical :: terminal
    integer :: direction, parity, degree, i

    text = reader%read_text('function')
    word = reader%read_text('direction', choice=direction)
    description%text = reader%group%written('function', text)//', '//word
    terminal = reader%read_yes('terminal')
    if (terminal) description%text = description%text//', terminal'
    if (reader%status%failed()) return
    call compile_law(lower(text), arguments, none, no_values, program, parity, degree, fault)
    if (fault == '') then
      if (.not. any(program%code == put_argument)) then
        fault = 'depends on no quantity, must name '//some(arguments)
      end if
    end if
    if (fault /= '') then
      call complain_of_law(reader, 'function', text, fault, arguments)
      return
    end if
    numbers = [numbers, real(sign_of(direction), wp), merge(1.0_wp, 0.0_wp, terminal), &
               real(size(program%code), wp), &
               [(real(program%code(i), wp), program%number(i), i=1, size(program%code))]]
  end subroutine read_event

  !> No parameter has the name of a quantity that events name.
  subroutine check_parameters(file, arguments, status)
    type(namelist_type), intent(in) :: file
    character(len=*), intent(in) :: arguments(:)
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    integer :: at, i

    at = place_of(file, 'parameters')
    if (at > size(file%groups)) return
    call reader%start(file%path, file%groups(at))
    do i = 1, file%groups(at)%n_entries
      associate (name => file%groups(at)%entries(i)%key)
        if (.not. any(arguments == name)) cycle
        call reader%complain(name, name//': is what an &event names, must be another')
        exit
      end associate
    end do
    status = reader%status
  end subroutine check_parameters

  !> The first few names.
  pure function some(names)
    character(len=*), intent(in) :: names(:)
    character(len=:), allocatable :: some
    some = listed(names(:min(size(names), most_listed)), '')
    if (size(names) > most_listed) some = some//', ...'
  end function some

end module viscovib_event_groups
