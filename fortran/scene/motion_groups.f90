!> The &transient, &spectrum, &free_decay and &shock_spectrum groups of a scene, and its &event
!! groups: functions of the state of a motion in time of which passages through 0 are wanted.
module viscovib_motion_groups
  use viscovib_checks, only: check_increasing
  use viscovib_constants, only: standard_gravity
  use viscovib_driven_system, only: driven_system_type
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_hereditary_job, only: hereditary_job
  use viscovib_kinds, only: wp
  use viscovib_law_faults, only: complain_of_law
  use viscovib_law_functions, only: put_argument
  use viscovib_law_program, only: law_program
  use viscovib_law_text, only: compile_law
  use viscovib_limits, only: largest_start
  use viscovib_load, only: load_type
  use viscovib_load_groups, only: read_frequency
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_motion_choice, only: hereditary_methods, past_names
  use viscovib_motion_job, only: decay_job, event_text, motion_job, spectrum_job
  use viscovib_namelist, only: lower, namelist_type
  use viscovib_near_words, only: listed
  use viscovib_record_doubts, only: doubt_record
  use viscovib_response_groups, only: read_range
  use viscovib_scene_groups, only: place_of
  use viscovib_shock_spectrum, only: check_damping
  use viscovib_shock_spectrum_job, only: shock_spectrum_job
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_subject, only: name_length, subject_type
  use viscovib_timed_groups, only: read_record
  use viscovib_transient_job, only: max_kept, max_steps, transient_job
  implicit none
  private

  public :: read_decay, read_forces, read_hereditary, read_point, read_shock_spectrum, &
    read_spectrum, read_transient, read_events

  !> Default accuracy of a motion with a shaft, relative to the largest value of each coordinate.
  real(wp), parameter :: of_angles = 1.0e-9_wp
  !> Keys of the range that a list of frequencies replaces.
  character(len=*), parameter :: grid_keys(4) = &
    [character(len=7) :: 'from', 'to', 'count', 'spacing']

  integer, parameter :: most_events = 100, most_listed = 6
  !> Of the words of `direction`.
  integer, parameter :: sign_of(3) = [0, 1, -1]

contains

  subroutine read_hereditary(reader, n_dof, load, job)
    type(group_reader), intent(inout) :: reader
    integer, intent(in) :: n_dof
    type(load_type), intent(in) :: load
    type(hereditary_job), intent(out) :: job
    type(status_type) :: status
    real(wp) :: start(2*n_dof)
    character(len=:), allocatable :: word

    call read_frequency(reader, load, job%nu)
    job%held = reader%read_reals('held', n_dof)
    if (reader%status%failed()) return
    start = 0.0_wp
    start(1::2) = job%held
    job%initial = reader%read_reals('initial', 2*n_dof, start)
    call read_steps(reader, job)
    word = reader%read_text('method', allowed=hereditary_methods, choice=job%method)
    word = reader%read_text('memory', allowed=past_names, choice=job%past)
    call read_keep(reader, job)
    if (reader%status%failed()) return
    call check_times(job, status)
    call reader%place(status)
  end subroutine read_hereditary

  subroutine read_transient(reader, system, job, from_rest, is_pushed, shaft_start)
    type(group_reader), intent(inout) :: reader
    class(driven_system_type), intent(in) :: system
    type(transient_job), intent(out) :: job
    !> Whether it begins at rest where no start is given, which else is needed.
    logical, intent(in), optional :: from_rest
    !> Whether a shock moves it: it begins at rest where no start is given.
    logical, intent(in), optional :: is_pushed
    !> Angle and speed of a shaft, which follow the start that is given; not allocated: no shaft.
    real(wp), allocatable, intent(in), optional :: shaft_start(:)
    type(status_type) :: checked
    character(len=:), allocatable :: word
    real(wp), allocatable :: start(:)
    logical :: may_lack, is_resting, has_shaft

    has_shaft = .false.
    if (present(shaft_start)) has_shaft = allocated(shaft_start)
    allocate (start(2*(system%n_dof - system%n_hidden - merge(1, 0, has_shaft))))
    may_lack = .false.
    is_resting = .false.
    if (present(is_pushed)) is_resting = is_pushed
    start = 0.0_wp
    if (present(from_rest)) may_lack = from_rest
    if (may_lack) then
      job%held = reader%read_reals('held', size(start)/2)
      if (reader%status%failed()) return
      start(1::2) = job%held
      job%initial = reader%read_reals('initial', size(start), start)
    else if (is_resting) then
      job%initial = reader%read_reals('initial', size(start), start)
    else
      job%initial = reader%read_reals('initial', size(start))
    end if
    if (has_shaft .and. .not. reader%status%failed()) then
      if (any(abs(job%held) > 0.0_wp)) call reader%complain('held', 'held: must be 0 while the ' &
                                                            //'speed of a shaft changes')
      deallocate (job%held)
      job%initial = [job%initial, shaft_start]
    end if
    call read_steps(reader, job)
    ! Angles are large.
    if (has_shaft .and. .not. (job%dt > 0.0_wp .or. job%tolerance > 0.0_wp)) then
      job%relative = max(job%relative, of_angles*merge(0.0_wp, 1.0_wp, job%relative > 0.0_wp))
    end if
    word = reader%read_text('method', allowed=transient_methods, choice=job%method)
    ! What remembers does so by exponentials.
    if (may_lack) word = reader%read_text('memory', allowed=past_names(:2))
    call read_keep(reader, job)
    if (reader%status%failed()) return
    call check_transient(job, system, checked)
    call reader%place(checked)
  end subroutine read_transient

  !> The length of a motion, its step, and its accuracy: `tolerance`, or in its place `rtol` and
  !! `atol`. Its start is checked.
  subroutine read_steps(reader, job)
    type(group_reader), intent(inout) :: reader
    class(transient_job), intent(inout) :: job
    real(wp) :: absolute

    call check_start(reader, job%initial)
    job%t_end = reader%read_real('t_end')
    job%dt = reader%read_real('dt')
    job%relative = reader%read_real('rtol')
    absolute = reader%read_real('atol')
    job%tolerance = reader%read_real('tolerance', absolute)
    if (job%relative > 0.0_wp .or. absolute > 0.0_wp) then
      if (abs(job%tolerance - absolute) > 0.0_wp) then
        call reader%complain('tolerance', 'tolerance = '//show(job%tolerance)//': is atol ' &
                             //'alone, must not be given with rtol or atol')
      end if
    end if
  end subroutine read_steps

  !> Whether states are kept all along, at the end only, of the last time, or at given times.
  subroutine read_keep(reader, job)
    type(group_reader), intent(inout) :: reader
    class(transient_job), intent(inout) :: job
    type(status_type) :: status
    character(len=:), allocatable :: word
    integer :: place

    job%save_every = reader%read_integer('save_every')
    job%wants_accelerations = reader%read_yes('acceleration')
    word = reader%read_text('keep', choice=place)
    job%last_only = place == 2
    if (place == 3) then
      job%tail = reader%read_real('tail')
    else if (reader%may_have('tail')) then
      call reader%complain('tail', "tail: must be given with keep = 'tail', and not without it")
    end if
    if (reader%may_have('times')) then
      job%times = reader%read_reals('times')
      if (reader%status%failed()) return
      call check_increasing('times', job%times, status)
      call reader%place(status)
      if (place /= 1 .or. job%save_every /= 1) then
        call reader%complain('times', 'times: cannot be given together with save_every or keep')
      else if (job%times(size(job%times)) > job%t_end) then
        call reader%complain('times', 'times = '//show(job%times(1))//' to ' &
                             //show(job%times(size(job%times)))//': must be between 0 and t_end ' &
                             //'= '//show(job%t_end))
      end if
    end if
    if (job%last_only .and. job%save_every /= 1) then
      call reader%complain('save_every', 'save_every = '//show(job%save_every)//': must be 1 ' &
                           //"with keep = 'last'")
    end if
  end subroutine read_keep

  !> Refuse a start beyond the range of motions.
  subroutine check_start(reader, initial)
    type(group_reader), intent(inout) :: reader
    real(wp), intent(in) :: initial(:)
    if (reader%status%failed()) return
    if (maxval(abs(initial(1::2))) > largest_start) then
      call reader%complain('initial', 'initial: has a displacement of ' &
                           //show(maxval(abs(initial(1::2))))//', must be at most ' &
                           //show(largest_start)//': choose other units')
    end if
  end subroutine check_start

  subroutine read_spectrum(reader, transient, job)
    type(group_reader), intent(inout) :: reader
    class(transient_job), intent(in) :: transient
    type(spectrum_job), intent(out) :: job
    character(len=:), allocatable :: word

    job%wanted = .true.
    word = reader%read_text('window', choice=job%window)
    job%discard = reader%read_real('discard')
    if (reader%status%failed()) return
    if (transient%last_only) then
      call reader%complain('spectrum', "&spectrum: needs the states all along, and &transient " &
                           //"has keep = 'last'")
    end if
    if (allocated(transient%times)) then
      call reader%complain('spectrum', '&spectrum: needs states at equal steps, and &transient ' &
                           //'has times')
    end if
    if (job%discard >= transient%t_end) then
      call reader%complain('discard', 'discard = '//show(job%discard)//': must not be negative ' &
                           //'and less than t_end = '//show(transient%t_end))
    end if
  end subroutine read_spectrum

  subroutine read_decay(reader, transient, job)
    type(group_reader), intent(inout) :: reader
    class(transient_job), intent(in) :: transient
    type(decay_job), intent(out) :: job

    job%wanted = .true.
    job%count = reader%read_integer('count')
    job%start = reader%read_real('start')
    if (reader%status%failed()) return
    if (transient%last_only) then
      call reader%complain('free_decay', "&free_decay: needs the states all along, and " &
                           //"&transient has keep = 'last'")
    else if (job%start >= transient%t_end) then
      call reader%complain('start', 'start = '//show(job%start)//': must not be negative ' &
                           //'and less than t_end = '//show(transient%t_end))
    end if
  end subroutine read_decay

  ! Checks of the options of a motion in time, before it is computed.

  subroutine check_transient(job, system, status)
    class(transient_job), intent(in) :: job
    class(driven_system_type), intent(in) :: system
    type(status_type), intent(out) :: status
    real(wp) :: q(system%n_dof)

    q = 0.0_wp
    q(:size(job%initial)/2) = job%initial(1::2)
    if (.not. system%physical(q)) then
      call fail(status, status_input_error, 'initial', 'initial: this state is outside what the ' &
                //'equations describe (z must be greater than -1)')
      return
    end if
    call check_times(job, status)
  end subroutine check_transient

  !> Check the end, the step, the tolerance and the kept states.
  subroutine check_times(job, status)
    class(transient_job), intent(in) :: job
    type(status_type), intent(out) :: status

    call set_ok(status)
    if (job%dt > job%t_end) then
      call fail(status, status_input_error, 'dt', 'dt = '//show(job%dt)//': must be greater ' &
                //'than 0 and not exceed t_end = '//show(job%t_end)//', or 0 to be found')
    else if (job%relative > 0.0_wp .and. job%dt > 0.0_wp) then
      call fail(status, status_input_error, 'rtol', 'rtol = '//show(job%relative) &
                //': finds the step, must not be given with dt')
    else if (job%dt > 0.0_wp) then
      if (job%t_end/job%dt > max_steps) then
        call fail(status, status_input_error, 'dt', 't_end/dt = '//show(job%t_end/job%dt) &
                  //': must be at most '//show(max_steps))
      else if (job%t_end/job%dt/job%save_every > max_kept) then
        call fail(status, status_input_error, 'save_every', 'save_every = ' &
                  //show(job%save_every)//': would keep more than '//show(max_kept)//' states')
      end if
    end if
  end subroutine check_times

  subroutine read_shock_spectrum(reader, subject, transient, job)
    type(group_reader), intent(inout) :: reader
    !> Its warnings are those of the record, too.
    type(subject_type), intent(inout) :: subject
    class(transient_job), intent(in) :: transient
    type(shock_spectrum_job), intent(out) :: job
    type(status_type) :: status
    character(len=:), allocatable :: word, doubts

    job%wanted = .true.
    word = reader%read_text('kind', choice=job%kind)
    job%damping = reader%read_real('damping')
    if (reader%status%failed()) return
    call check_damping(job%damping, status)
    call reader%place(status)
    call read_frequencies(reader, job%hz)
    if (any([reader%may_have('file'), reader%may_have('times'), reader%may_have('values')])) then
      call reader%refuse(['coordinate'], 'a record is given in its place')
      job%unit = reader%read_text('unit')
      call read_record(reader, job%times, job%values)
      if (reader%status%failed()) return
      call doubt_record('record', merge(standard_gravity, 1.0_wp, job%unit == 'g')*job%values, &
                        job%unit, .true., doubts)
      subject%warned = subject%warned//doubts
      return
    end if
    job%unit = 'm/s^2'
    call reader%refuse(['unit'], 'is the unit of a record')
    associate (names => subject%coordinates)
      if (size(names) == 1) then
        word = reader%read_text('coordinate', trim(names(1)), names, job%place)
      else
        word = reader%read_text('coordinate', allowed=names, choice=job%place)
      end if
    end associate
    if (transient%last_only) then
      call reader%complain('shock_spectrum', "&shock_spectrum: needs the states all along, and " &
                           //"&transient has keep = 'last'")
    else if (subject%is_pendulum) then
      call reader%complain('shock_spectrum', '&shock_spectrum: of a &pendulum, which has no ' &
                           //'units, it is not computed')
    end if
  end subroutine read_shock_spectrum

  !> Either the list `frequencies`, or `from`, `to`, `count` and `spacing`.
  subroutine read_frequencies(reader, hz)
    type(group_reader), intent(inout) :: reader
    real(wp), allocatable, intent(out) :: hz(:)

    if (reader%may_have('frequencies')) then
      hz = reader%read_reals('frequencies')
      call reader%refuse(grid_keys, 'the frequencies are listed in frequencies already')
      return
    end if
    call read_range(reader, '', hz, 'spacing')
  end subroutine read_frequencies

  !> The point of a body whose motion is wanted.
  subroutine read_point(reader, subject, point)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    !> From the mass centre at rest; not allocated: none.
    real(wp), allocatable, intent(out) :: point(:)
    if (.not. subject%is_body) return
    if (.not. reader%may_have('point')) return
    point = reader%read_reals('point')
    if (allocated(subject%shaft_start)) then
      call reader%complain('point', 'point: must be left out while the speed of a shaft changes')
    end if
    if (reader%status%failed()) return
    point = matmul(subject%axes, point - subject%center)
  end subroutine read_point

  !> Whether forces along a motion are wanted.
  subroutine read_forces(reader, subject, wanted)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    logical, intent(out) :: wanted

    wanted = .false.
    if (.not. subject%is_pendulum) wanted = reader%read_yes('forces')
    if (.not. wanted .or. reader%status%failed()) return
    if (allocated(subject%shaft_start)) then
      call reader%complain('forces', "forces = 'yes': must be 'no' while the speed of a shaft " &
                           //'changes')
    else if (subject%model%n_given == 0 .and. .not. allocated(subject%model%supports%names)) then
      call reader%complain('forces', "forces = 'yes': needs an &element or supports")
    else if (allocated(subject%model%supports%turning)) then
      ! The speed is the frequency of the load.
      if (any(abs(subject%model%supports%turning) > 0.0_wp)) then
        call reader%complain('forces', "forces = 'yes': gyroscopic, circulatory or centrifugal " &
                             //'act on supports: give speed')
      end if
    end if
  end subroutine read_forces

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

end module viscovib_motion_groups
