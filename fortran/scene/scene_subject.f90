!> The system of a scene with its loads, and the form in which its motions in time are computed.
module viscovib_scene_subject
  use viscovib_body_groups, only: read_body
  use viscovib_condensed_subject, only: condense_in_time
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_kernel_groups, only: read_kernels
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof
  use viscovib_load, only: load_type
  use viscovib_load_groups, only: read_loads
  use viscovib_motion_choice, only: by_modes, choose_equations, most_whole, motion_wish, &
    without_memory
  use viscovib_mount, only: mount_parameters, mount_type, new_mount
  use viscovib_namelist, only: lower, namelist_type
  use viscovib_pendulum, only: new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_scene_groups, only: place_of, place_of_motion
  use viscovib_shaft_groups, only: read_shaft
  use viscovib_status, only: fail, status_input_error, status_type
  use viscovib_stiffness_ratio, only: hidden_springs
  use viscovib_structure_groups, only: read_structure
  use viscovib_structure_model, only: put_load
  use viscovib_subject, only: name_length, subject_type
  use viscovib_system_groups, only: read_system
  use viscovib_whole_structure, only: has_states, may_be_whole, switches, whole_polynomial
  implicit none
  private

  public :: read_subject

contains

  !> The system and its loads.
  subroutine read_subject(file, subject, canonical, status)
    type(namelist_type), intent(in) :: file
    type(subject_type), intent(inout), target :: subject
    type(growing_text), intent(inout) :: canonical
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    type(kernel_holder) :: kernels(2)
    type(mount_parameters) :: parameters
    type(load_type) :: load

    subject%is_pendulum = place_of(file, 'pendulum') <= size(file%groups)
    if (subject%is_pendulum) then
      subject%coordinates = [character(len=name_length) :: 'z', 'phi', 'psi']
      subject%units = [character(len=name_length) :: 'L', 'rad', 'rad']
      call reader%start(file%path, file%groups(place_of(file, 'pendulum')))
      call read_pendulum(reader, subject%pendulum)
      call reader%close(canonical, status)
      return
    end if
    subject%is_polynomial = place_of(file, 'system') <= size(file%groups)
    subject%is_structure = place_of(file, 'structure') <= size(file%groups)
    subject%warned = ''
    if (place_of(file, 'body') <= size(file%groups)) then
      call read_body(file, subject, canonical, status)
    else if (subject%is_structure) then
      call read_structure(file, subject%model, subject%structure, subject%polynomial, &
                          subject%is_polynomial, subject%coordinates, subject%units, canonical, &
                          status)
      subject%is_structure = .not. subject%is_polynomial
    else if (subject%is_polynomial) then
      call read_system(file, subject%polynomial, subject%coordinates, subject%units, canonical, &
                       status)
    else
      subject%coordinates = [character(len=name_length) :: 'x', 'phi']
      subject%units = [character(len=name_length) :: 'm', 'rad']
      call read_kernels(file, kernels, parameters, canonical, status)
      if (status%failed()) return
      call reader%start(file%path, file%groups(place_of(file, 'mount')))
      call read_mount(reader, kernels, parameters, subject%mount)
      call reader%close(canonical, status)
    end if
    if (status%failed()) return
    if (subject%is_structure) then
      subject%warned = subject%warned//subject%model%rest%hidden
    else if (subject%is_polynomial .and. .not. subject%is_turning) then
      subject%warned = subject%warned//hidden_springs(subject%polynomial, 1)
    end if
    call read_loads(file, subject, load, canonical, status)
    if (.not. status%failed()) call read_shaft(file, subject, load, canonical, status)
    if (.not. subject%is_structure .or. status%failed()) then
      subject%load = load
      if (.not. status%failed()) call choose(file, subject)
      return
    end if
    call put_load(subject%model, load, place_of_motion(file) <= size(file%groups), &
                  subject%structure, subject%load, status)
    if (.not. status%failed()) call go_whole(file, load, subject, status)
    if (place_of_motion(file) <= size(file%groups) .and. subject%is_structure .and. &
        .not. status%failed()) then
      if (has_states(subject%model)) call fail(status, status_input_error, 'hysteresis', &
        'hysteresis: a motion in time needs at most 512 coordinates, all with mass, no shapes, ' &
        //'kernels that are sums of exponentials, memory that is not direct, and a method for ' &
        //'steps that end at switches')
    end if
    if (status%failed()) status%message = file%path//': '//status%message
  end subroutine read_subject

  !> In time a small structure goes by its whole equations if modes are not faster, or if its laws
  !! switch, where steps end then; with a given step by its modes, which are exact. So do periodic
  !! motions by shooting, and ensembles whose motions go side by side.
  subroutine go_whole(file, load, subject, status)
    type(namelist_type), intent(in) :: file
    type(load_type), intent(in) :: load
    type(subject_type), intent(inout) :: subject
    type(status_type), intent(inout) :: status
    type(motion_wish) :: wish
    character(len=:), allocatable :: lack
    logical :: is_always_whole, may_have_modes

    is_always_whole = min(place_of(file, 'steady_motion'), place_of(file, 'trace_motion')) &
                      <= size(file%groups)
    if (place_of(file, 'ensemble') <= size(file%groups)) then
      is_always_whole = size(subject%coordinates) <= max_dof .and. .not. switches(subject%model) &
                        .and. .not. any(subject%model%elements%kernel > 0)
    end if
    if (.not. may_be_whole(subject%model)) return
    may_have_modes = .not. (is_always_whole .or. switches(subject%model))
    if (.not. is_always_whole .and. place_of_motion(file) > size(file%groups)) return
    if (may_have_modes) then
      if (place_of(file, 'transient') > size(file%groups)) return
      if (size(subject%coordinates) > most_whole .or. has_step(file)) return
    end if
    call whole_polynomial(subject%model, subject%structure%kernels, subject%polynomial, status)
    if (status%failed()) return
    ! Modes of linear structures are exact.
    if (may_have_modes .and. subject%polynomial%is_linear()) return
    if (place_of_motion(file) <= size(file%groups)) then
      wish = wish_of(file, load, size(subject%coordinates), may_have_modes)
      call choose_equations(subject%polynomial, wish, subject%equations, lack)
      if (subject%equations == by_modes) return
      ! Only these steps end where laws switch.
      if (switches(subject%model) .and. subject%equations /= without_memory) return
    end if
    subject%load = load
    subject%is_structure = .false.
    subject%is_polynomial = .true.
  end subroutine go_whole

  !> True if the step size of a motion is given.
  logical function has_step(file)
    type(namelist_type), intent(in) :: file
    type(group_reader) :: reader
    associate (group => file%groups(place_of(file, 'transient')))
      has_step = group%find('dt') > 0
      if (.not. has_step) return
      call reader%start(file%path, group)
      has_step = reader%read_real('dt') > 0.0_wp
    end associate
  end function has_step

  !> Choose the equations of motions in time.
  subroutine choose(file, subject)
    type(namelist_type), intent(in) :: file
    type(subject_type), intent(inout) :: subject
    type(motion_wish) :: wish
    character(len=:), allocatable :: lack

    if (place_of_motion(file) > size(file%groups)) return
    ! Ensembles, and forces of mounts, are those of all coordinates.
    wish = wish_of(file, subject%load, size(subject%coordinates), &
                   .not. subject%is_body .and. place_of(file, 'transient') <= size(file%groups))
    call choose_equations(subject%oscillator(), wish, subject%equations, lack)
    if (subject%equations /= by_modes) return
    call condense_in_time(subject)
    if (subject%is_structure) return
    wish%may_have_modes = .false.
    call choose_equations(subject%oscillator(), wish, subject%equations, lack)
  end subroutine choose

  !> What the scene asks of its motion in time; the group is read completely later.
  type(motion_wish) function wish_of(file, load, n, may_have_modes) result(wish)
    type(namelist_type), intent(in) :: file
    type(load_type), intent(in) :: load
    !> Number of coordinates.
    integer, intent(in) :: n
    logical, intent(in) :: may_have_modes
    real(wp) :: none(n)
    type(group_reader) :: reader

    none = 0.0_wp
    associate (group => file%groups(place_of_motion(file)))
      wish%method = word_of('method')
      wish%memory = word_of('memory')
      call reader%start(file%path, group)
      if (group%find('held') > 0) then
        wish%is_held = any(abs(reader%read_reals('held', n, none)) > 0.0_wp)
      end if
      wish%moves_base = load%moves_base()
      wish%may_have_modes = may_have_modes .and. group%find('t_end') > 0 &
                            .and. .not. any(abs(load%moved) > 0.0_wp)
      if (.not. wish%may_have_modes) return
      wish%t_end = reader%read_real('t_end', 0.0_wp)
      wish%initial = reader%read_reals('initial', 2*n, [none, none])
      if (reader%status%failed()) wish%initial = [none, none]
      if (allocated(load%force)) call wish%take_load(load)
    end associate

  contains

    function word_of(key) result(word)
      character(len=*), intent(in) :: key
      character(len=:), allocatable :: word
      integer :: i
      word = 'auto'
      i = file%groups(place_of_motion(file))%find(key)
      if (i > 0) word = lower(file%groups(place_of_motion(file))%entries(i)%values(1)%text)
    end function word_of

  end function wish_of

  ! The &mount group of a scene.

  subroutine read_mount(reader, kernels, parameters, mount)
    type(group_reader), intent(inout) :: reader
    type(kernel_holder), intent(in) :: kernels(2)
    !> Knows which kernel acts on which spring already.
    type(mount_parameters), intent(inout) :: parameters
    type(mount_type), intent(out) :: mount
    type(status_type) :: status
    character(len=:), allocatable :: word

    parameters%mass = reader%read_real('mass')
    parameters%inertia = reader%read_real('inertia')
    parameters%offset = reader%read_real('offset')
    parameters%stiffness_x = reader%read_real('stiffness_x')
    parameters%stiffness_phi = reader%read_real('stiffness_phi')
    word = reader%read_text('geometry', choice=parameters%geometry)
    parameters%cubic_scale = reader%read_real('cubic_scale')
    parameters%memory_scale = reader%read_real('memory_scale')
    ! Row by row in the file, as one writes a matrix.
    parameters%damping = reshape(reader%read_reals('damping'), [2, 2], order=[2, 1])
    if (reader%status%failed()) return
    call new_mount(mount, parameters, kernels(:max(parameters%kernel_x, parameters%kernel_phi)), &
                   status)
    call reader%place(status)
  end subroutine read_mount

  ! The &pendulum group of a scene.

  subroutine read_pendulum(reader, pendulum)
    type(group_reader), intent(inout) :: reader
    type(pendulum_type), intent(out) :: pendulum
    type(pendulum_parameters) :: p
    type(status_type) :: built
    character(len=:), allocatable :: word

    p%e = reader%read_real('e')
    p%w2 = reader%read_real('w2')
    p%w3 = reader%read_real('w3')
    p%alpha = reader%read_real('alpha')
    p%damping(1) = reader%read_real('c1')
    p%damping(2) = reader%read_real('c2')
    p%damping(3) = reader%read_real('c3')
    p%load(1) = reader%read_real('f0')
    p%load(2) = reader%read_real('m01')
    p%load(3) = reader%read_real('m02')
    p%frequency(1) = reader%read_real('p1')
    p%frequency(2) = reader%read_real('p2')
    p%frequency(3) = reader%read_real('p3')
    word = reader%read_text('equations', choice=p%equations)
    if (reader%status%failed()) return
    call new_pendulum(pendulum, p, built)
    call reader%place(built)
  end subroutine read_pendulum

end module viscovib_scene_subject
