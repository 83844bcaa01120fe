!> A scene: the system, its load and the results wanted, as one namelist file.
module viscovib_scene
  use viscovib_branch_job, only: branch_job, read_branch
  use viscovib_checks, only: check_increasing, check_positive
  use viscovib_grids, only: linear_grid, log_grid
  use viscovib_group_reader, only: group_reader
  use viscovib_kernel_groups, only: read_kernels
  use viscovib_hereditary_job, only: hereditary_job
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_mount, only: geometry_cubic, geometry_names, mount_parameters, mount_type, new_mount
  use viscovib_namelist, only: namelist_type, read_namelist
  use viscovib_oscillator, only: kernel_holder, oscillator_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_groups, only: read_pendulum, read_spectrum, read_transient, spectrum_job
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_motion, only: new_polynomial_motion, polynomial_motion_type
  use viscovib_response, only: response_options
  use viscovib_response_plan, only: method_names, method_newton, new_response_plan, &
    response_plan_type
  use viscovib_motion_groups, only: read_frequency, read_hereditary
  use viscovib_scales_job, only: read_scales, scales_job
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_sweep_groups, only: read_sweep
  use viscovib_system_groups, only: name_length, read_system
  use viscovib_transient_job, only: transient_job
  implicit none
  private

  public :: scene_type, read_scene

  type :: scene_type
    character(len=:), allocatable :: path, title
    !> The system is a pendulum, its result a motion in time.
    logical :: is_pendulum = .false.
    type(pendulum_type) :: pendulum
    type(transient_job) :: transient
    type(spectrum_job) :: spectrum
    !> Or its steady motions by multiple scales.
    logical :: wants_scales = .false.
    type(scales_job) :: scales
    !> Or it is a mount or a polynomial system, its result a response, or of the latter a
    !! motion.
    logical :: is_polynomial = .false.
    type(mount_type) :: mount
    type(polynomial_type) :: polynomial
    type(polynomial_motion_type) :: motion
    logical :: wants_motion = .false.
    !> That motion is one of a mount, or of a polynomial system with kernels.
    logical :: has_memory = .false.
    type(hereditary_job) :: hereditary
    !> Names and units of its coordinates.
    character(len=name_length), allocatable :: coordinates(:), units(:)
    type(load_type) :: load
    !> Or a branch, followed through its folds.
    logical :: wants_branch = .false.
    type(branch_job) :: branch
    !> The response: frequencies (rad/s), method, options.
    real(wp), allocatable :: nu(:)
    integer :: method = 0
    type(response_options) :: options
    !> Line of the first &sweep, 0 without: one point is computed, or a grid of them.
    integer :: sweep_line = 0
    !> The scene as it was understood, every default written out; reads back
    !! to the same numbers.
    character(len=:), allocatable :: canonical
  contains
    procedure :: oscillator
    procedure, private :: base_direction
  end type scene_type

  character(len=*), parameter :: group_names(14) = &
    [character(len=15) :: 'scene', 'mount', 'system', 'spring', 'force', 'kernel', 'load', &
     'response', 'branch', 'pendulum', 'transient', 'spectrum', 'multiple_scales', 'sweep']
  !> What belongs to each system.
  character(len=*), parameter :: mount_groups(8) = &
    [character(len=15) :: 'mount', 'system', 'spring', 'force', 'kernel', 'load', 'response', &
     'branch'], &
                                 pendulum_groups(4) = &
    [character(len=15) :: 'pendulum', 'transient', 'spectrum', 'multiple_scales'], &
                                 repeatable(5) = &
    [character(len=15) :: 'kernel', 'load', 'spring', 'force', 'sweep']
  character(len=*), parameter :: grid_keys(4) = &
    [character(len=10) :: 'nu_min', 'nu_max', 'nu_count', 'nu_spacing']
  !> Bounds that stop a slip of the pen before it fills the memory.
  integer, parameter :: max_grid = 1000000, max_order = 100000

contains

  !> Read and check everything; nothing is computed yet.
  subroutine read_scene(path, scene, status, text)
    character(len=*), intent(in) :: path
    type(scene_type), intent(out) :: scene
    type(status_type), intent(out) :: status
    !> The scene itself, instead of the file; its path then only names it.
    character(len=*), intent(in), optional :: text
    type(namelist_type) :: file

    scene%path = path
    scene%canonical = ''
    call read_namelist(path, file, status, text)
    if (.not. status%failed()) call check_groups(file, scene%is_pendulum, status)
    if (.not. status%failed()) call read_title(file, scene, status)
    if (status%failed()) return
    scene%wants_motion = place_of(file, 'transient') <= size(file%groups)
    if (scene%is_pendulum) then
      scene%coordinates = [character(len=name_length) :: 'z', 'phi', 'psi']
      call read_motion(file, scene, status)
    else
      call read_oscillator(file, scene, status)
    end if
    if (.not. status%failed()) call read_sweeps(file, scene, status)
  end subroutine read_scene

  !> A mount or a polynomial system, its loads and what is wanted of it.
  subroutine read_oscillator(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(status_type), intent(out) :: status
    type(kernel_holder) :: kernels(2)
    type(mount_parameters) :: parameters

    scene%is_polynomial = place_of(file, 'system') <= size(file%groups)
    if (scene%is_polynomial) then
      call read_system(file, scene%polynomial, scene%coordinates, scene%units, scene%canonical, &
                       status)
    else
      scene%coordinates = [character(len=name_length) :: 'x', 'phi']
      scene%units = [character(len=name_length) :: 'm', 'rad']
      call read_kernels(file, kernels, parameters, scene%canonical, status)
      if (.not. status%failed()) call read_mount(file, scene, kernels, parameters, status)
    end if
    if (.not. status%failed()) call read_loads(file, scene, status)
    if (status%failed()) return
    if (scene%wants_motion) then
      scene%has_memory = .true.
      if (scene%is_polynomial) scene%has_memory = any(scene%polynomial%kernel_of > 0)
      call read_motion(file, scene, status)
      return
    end if
    call read_result(file, scene, status)
    if (.not. status%failed()) call check_job(file, scene, status)
  end subroutine read_oscillator

  !> The system that responds: the mount or the polynomial system.
  function oscillator(self)
    class(scene_type), intent(in), target :: self
    class(oscillator_type), pointer :: oscillator
    if (self%is_polynomial) then
      oscillator => self%polynomial
    else
      oscillator => self%mount
    end if
  end function oscillator

  !> How its coordinates move with the base.
  pure function base_direction(self)
    class(scene_type), intent(in) :: self
    real(wp), allocatable :: base_direction(:)
    if (self%is_polynomial) then
      base_direction = self%polynomial%base_direction
    else
      base_direction = self%mount%base_direction
    end if
  end function base_direction

  !> Known groups only, the right number of each, and one system.
  subroutine check_groups(file, is_pendulum, status)
    type(namelist_type), intent(in) :: file
    logical, intent(out) :: is_pendulum
    type(status_type), intent(out) :: status
    logical :: is_polynomial, is_moving
    integer :: i, j, n

    is_pendulum = .false.
    is_polynomial = place_of(file, 'system') <= size(file%groups)
    is_moving = place_of(file, 'transient') <= size(file%groups) &
                .and. (is_polynomial .or. place_of(file, 'mount') <= size(file%groups))
    do i = 1, size(file%groups)
      associate (group => file%groups(i))
        if (.not. any(group_names == group%name)) then
          call refuse_group(i, 'unknown group &'//group%name//': must be one of ' &
                            //listed(group_names))
          return
        end if
        if (group%name == 'pendulum') is_pendulum = .true.
      end associate
    end do
    do j = 1, size(group_names)
      n = 0
      do i = 1, size(file%groups)
        if (file%groups(i)%name /= group_names(j)) cycle
        n = n + 1
        if (n == 2 .and. .not. any(group_names(j) == repeatable)) then
          call refuse_group(i, 'a second &'//trim(group_names(j))//': must be given once')
        else if (is_pendulum .and. any(mount_groups == group_names(j))) then
          call refuse_group(i, '&'//trim(group_names(j))//': belongs to a mount, and this scene ' &
                            //'has &pendulum')
        else if (is_polynomial .and. group_names(j) == 'mount') then
          call refuse_group(i, '&mount: this scene has &system already, give one of them')
        else if (.not. is_polynomial .and. any(group_names(j) == ['spring', 'force '])) then
          call refuse_group(i, '&'//trim(group_names(j))//': needs &system')
        else if (group_names(j) == 'transient' .and. .not. (is_pendulum .or. is_moving)) then
          call refuse_group(i, '&transient: needs &mount, &system or &pendulum')
        else if (.not. is_pendulum .and. any(pendulum_groups == group_names(j)) &
                 .and. .not. (is_moving .and. group_names(j) /= 'multiple_scales')) then
          call refuse_group(i, '&'//trim(group_names(j))//': needs &pendulum')
        else if (is_moving .and. any(group_names(j) == ['response', 'branch  '])) then
          call refuse_group(i, '&'//trim(group_names(j))//': this scene has &transient already, ' &
                            //'give one of them')
        end if
        if (status%failed()) return
      end do
      if (n > 0) cycle
      if (is_pendulum .and. group_names(j) == 'transient') then
        if (place_of(file, 'multiple_scales') <= size(file%groups)) cycle
        call fail(status, status_input_error, 'transient', file%path//': no &transient group: ' &
                  //'a scene with &pendulum needs a wanted result (&transient or ' &
                  //'&multiple_scales)')
      else if (.not. is_pendulum .and. any(group_names(j) == ['mount', 'load ']) &
               .and. .not. (is_polynomial .and. group_names(j) == 'mount') &
               .and. .not. is_moving) then
        call refuse_lack(trim(group_names(j)))
      end if
      if (status%failed()) return
    end do
    if (is_pendulum) then
      n = place_of(file, 'multiple_scales')
      if (n > size(file%groups)) return
      if (place_of(file, 'transient') <= size(file%groups)) then
        call refuse_group(n, '&multiple_scales: this scene has &transient already, give one of ' &
                          //'them')
      else if (place_of(file, 'spectrum') <= size(file%groups)) then
        call refuse_group(place_of(file, 'spectrum'), '&spectrum: needs &transient')
      end if
      return
    end if
    if (is_moving) return
    n = place_of(file, 'branch')
    if (place_of(file, 'response') > size(file%groups)) then
      if (n > size(file%groups)) call refuse_lack('response')
    else if (n <= size(file%groups)) then
      call refuse_group(n, '&branch: this scene has &response already, give one of them')
    end if

  contains

    subroutine refuse_lack(name)
      character(len=*), intent(in) :: name
      call fail(status, status_input_error, name, file%path//': no &'//name//' group: a scene ' &
                //'needs &mount or &system, &load and a wanted result (&response or &branch), or ' &
                //'&mount, &system or &pendulum and &transient')
    end subroutine refuse_lack

    subroutine refuse_group(i, why)
      integer, intent(in) :: i
      character(len=*), intent(in) :: why
      call fail(status, status_input_error, file%groups(i)%name, file%path//':' &
                //show(file%groups(i)%line)//': '//why)
    end subroutine refuse_group

    pure function listed(names)
      character(len=*), intent(in) :: names(:)
      character(len=:), allocatable :: listed
      integer :: k
      listed = '&'//trim(names(1))
      do k = 2, size(names)
        listed = listed//', &'//trim(names(k))
      end do
    end function listed

  end subroutine check_groups

  !> The place of a group; past the last if it is not there.
  pure integer function place_of(file, name) result(i)
    type(namelist_type), intent(in) :: file
    character(len=*), intent(in) :: name
    do i = 1, size(file%groups)
      if (file%groups(i)%name == name) exit
    end do
  end function place_of

  subroutine read_motion(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    integer :: i

    if (scene%is_pendulum) then
      call reader%start(file%path, file%groups(place_of(file, 'pendulum')))
      call read_pendulum(reader, scene%pendulum)
      call close_group(reader, scene, status)
      if (status%failed()) return
      scene%wants_scales = place_of(file, 'multiple_scales') <= size(file%groups)
      if (scene%wants_scales) then
        call reader%start(file%path, file%groups(place_of(file, 'multiple_scales')))
        call read_scales(reader, scene%scales)
        call close_group(reader, scene, status)
        return
      end if
      call reader%start(file%path, file%groups(place_of(file, 'transient')))
      call read_transient(reader, scene%pendulum, scene%transient)
    else
      call reader%start(file%path, file%groups(place_of(file, 'transient')))
      if (scene%has_memory) then
        call read_hereditary(reader, size(scene%coordinates), scene%load, scene%hereditary)
        scene%transient%t_end = scene%hereditary%t_end
      else
        call read_own_motion(reader, scene)
      end if
    end if
    call close_group(reader, scene, status)
    if (status%failed() .or. .not. any([(file%groups(i)%name == 'spectrum', &
                                         i=1, size(file%groups))])) return
    call reader%start(file%path, file%groups(place_of(file, 'spectrum')))
    call read_spectrum(reader, scene%transient, scene%spectrum)
    call close_group(reader, scene, status)
  end subroutine read_motion

  !> The &transient group of a polynomial system without memory.
  subroutine read_own_motion(reader, scene)
    type(group_reader), intent(inout) :: reader
    type(scene_type), intent(inout) :: scene
    type(status_type) :: status
    real(wp) :: nu

    call read_frequency(reader, scene%load, nu)
    if (reader%status%failed()) return
    call new_polynomial_motion(scene%motion, scene%polynomial, scene%load, nu, status)
    call reader%place(status)
    if (.not. status%failed()) call read_transient(reader, scene%motion, scene%transient)
  end subroutine read_own_motion

  subroutine read_title(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    integer :: i

    scene%title = ''
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'scene') cycle
      call reader%start(file%path, file%groups(i))
      scene%title = reader%read_text('title', '')
      call close_group(reader, scene, status)
    end do
  end subroutine read_title

  !> Finish a group: its failure, or its canonical text.
  subroutine close_group(reader, scene, status)
    type(group_reader), intent(inout) :: reader
    type(scene_type), intent(inout) :: scene
    type(status_type), intent(out) :: status
    call reader%finish()
    status = reader%status
    scene%canonical = scene%canonical//reader%echo
  end subroutine close_group

  subroutine read_mount(file, scene, kernels, parameters, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(kernel_holder), intent(in) :: kernels(2)
    type(mount_parameters), intent(inout) :: parameters
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    type(status_type) :: built
    character(len=:), allocatable :: word
    real(wp) :: c(4)

    call reader%start(file%path, file%groups(place_of(file, 'mount')))
    parameters%mass = reader%read_real('mass')
    parameters%inertia = reader%read_real('inertia')
    parameters%offset = reader%read_real('offset')
    parameters%stiffness_x = reader%read_real('stiffness_x')
    parameters%stiffness_phi = reader%read_real('stiffness_phi')
    word = reader%read_text('geometry', trim(geometry_names(geometry_cubic)), geometry_names, &
                            parameters%geometry)
    parameters%cubic_scale = reader%read_real('cubic_scale', 1.0_wp)
    parameters%memory_scale = reader%read_real('memory_scale', 1.0_wp)
    ! Row by row in the file, as one writes a matrix.
    c = reader%read_reals('damping', 4, [0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp])
    parameters%damping = reshape(c, [2, 2], order=[2, 1])
    if (.not. reader%status%failed()) then
      call new_mount(scene%mount, parameters, &
                     kernels(:max(parameters%kernel_x, parameters%kernel_phi)), built)
      call reader%place(built)
    end if
    call close_group(reader, scene, status)
  end subroutine read_mount

  !> Every &load is a term amplitude sin(order nu t + phase); they add up.
  subroutine read_loads(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=:), allocatable :: word
    integer, allocatable :: orders(:)
    complex(wp), allocatable :: force(:, :), base(:)
    real(wp) :: amplitude, phase
    complex(wp) :: term
    integer :: i, n, kind, on

    n = count([(file%groups(i)%name == 'load', i=1, size(file%groups))])
    allocate (orders(n), force(size(scene%coordinates), n), base(n))
    force = (0.0_wp, 0.0_wp)
    base = (0.0_wp, 0.0_wp)
    n = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'load') cycle
      n = n + 1
      kind = 1
      on = 1
      call reader%start(file%path, file%groups(i))
      word = reader%read_text('kind', 'force', [character(len=5) :: 'force', 'base'], kind)
      if (kind == 1) then
        word = reader%read_text('on', trim(scene%coordinates(1)), scene%coordinates, on)
      else
        call reader%refuse(['on'], 'the base moves as a whole; only a force has this key')
        if (.not. any(abs(scene%base_direction()) > 0.0_wp)) then
          call reader%complain('kind', "kind = 'base': needs base_direction in &system")
        end if
      end if
      orders(n) = reader%read_integer('order', 1)
      if (orders(n) < 0 .or. orders(n) > max_order) then
        call reader%complain('order', 'order = '//show(orders(n)) &
                             //': must be 0 (mean), 1, 2, ... '//show(max_order))
      end if
      amplitude = reader%read_real('amplitude')
      if (orders(n) == 0) then
        call reader%refuse(['phase'], 'the mean (order 0) has none')
        term = cmplx(0.0_wp, amplitude, wp)
      else
        phase = reader%read_real('phase', 0.0_wp)
        term = amplitude*cmplx(cos(phase), sin(phase), wp)
      end if
      if (kind == 1) then
        force(on, n) = term
      else
        base(n) = term
      end if
      call close_group(reader, scene, status)
      if (status%failed()) return
    end do
    call new_load(scene%load, size(scene%coordinates), orders, force, base, status)
  end subroutine read_loads

  !> The result wanted of a mount.
  subroutine read_result(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(status_type), intent(out) :: status
    type(group_reader) :: reader

    scene%wants_branch = place_of(file, 'branch') <= size(file%groups)
    if (.not. scene%wants_branch) then
      call read_response(file, scene, status)
      return
    end if
    call reader%start(file%path, file%groups(place_of(file, 'branch')))
    call read_branch(reader, scene%branch)
    call close_group(reader, scene, status)
    scene%method = method_newton
    scene%options = scene%branch%options
    scene%nu = [scene%branch%nu_from]
  end subroutine read_result

  subroutine read_response(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=:), allocatable :: word

    call reader%start(file%path, file%groups(place_of(file, 'response')))
    word = reader%read_text('method', 'successive', method_names, scene%method)
    call reader%read_count('harmonics', scene%options%harmonics, 'auto', &
                           scene%options%choose_harmonics)
    scene%options%tolerance = reader%read_real('tolerance', scene%options%tolerance)
    scene%options%max_iterations = reader%read_integer('max_iterations', &
                                                       scene%options%max_iterations)
    scene%options%relaxation = reader%read_real('relaxation', scene%options%relaxation)
    call read_frequencies(reader, scene%nu)
    call close_group(reader, scene, status)
  end subroutine read_response

  !> Either the list nu, or nu_min, nu_max, nu_count and nu_spacing.
  subroutine read_frequencies(reader, nu)
    type(group_reader), intent(inout) :: reader
    real(wp), allocatable, intent(out) :: nu(:)
    type(status_type) :: status
    character(len=:), allocatable :: word
    real(wp) :: lowest, highest
    integer :: n, spacing

    allocate (nu(0))
    if (reader%has('nu')) then
      call reader%refuse(grid_keys, 'the frequencies are listed in nu already; give either nu, ' &
                         //'or nu_min, nu_max, nu_count and nu_spacing')
      nu = reader%read_reals('nu')
      if (reader%status%failed()) return
      call check_increasing('nu', nu, status)
      call reader%place(status)
      call check_positive('nu', nu(1), status)
      call reader%place(status)
      return
    end if
    spacing = 1
    lowest = reader%read_real('nu_min')
    highest = reader%read_real('nu_max')
    n = reader%read_integer('nu_count')
    word = reader%read_text('nu_spacing', 'linear', [character(len=6) :: 'linear', 'log'], spacing)
    if (reader%status%failed()) return
    call check_positive('nu_min', lowest, status)
    call reader%place(status)
    if (highest <= lowest) call reader%complain('nu_max', 'nu_max = '//show(highest) &
                                                //': must be greater than nu_min = '//show(lowest))
    if (n < 2 .or. n > max_grid) call reader%complain('nu_count', 'nu_count = '//show(n) &
                                                      //': must be 2 to '//show(max_grid))
    if (reader%status%failed()) return
    if (spacing == 1) then
      nu = linear_grid(lowest, highest, n)
    else
      nu = log_grid(lowest, highest, n)
    end if
  end subroutine read_frequencies

  !> Every &sweep is a parameter; no two may be the same.
  subroutine read_sweeps(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=:), allocatable :: key, keys
    integer :: i

    keys = ';'
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'sweep') cycle
      call reader%start(file%path, file%groups(i))
      call read_sweep(reader, scene%canonical, key)
      if (index(keys, ';'//key//';') > 0) then
        call reader%complain('key', "key = '"//key//"': is swept already")
      end if
      keys = keys//key//';'
      if (scene%sweep_line == 0) scene%sweep_line = file%groups(i)%line
      call close_group(reader, scene, status)
      if (status%failed()) return
    end do
  end subroutine read_sweeps

  !> What only the whole job shows to be wrong, with the line to change.
  subroutine check_job(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(in), target :: scene
    type(status_type), intent(out) :: status
    type(response_plan_type) :: plan
    class(oscillator_type), pointer :: system
    character(len=:), allocatable :: name
    integer :: i, n

    system => scene%oscillator()
    call new_response_plan(plan, system, scene%load, scene%nu, scene%method, scene%options, &
                           status)
    if (.not. status%failed()) return
    name = 'response'
    if (scene%wants_branch) name = 'branch'
    n = 1
    if (status%subject == 'beta') then
      name = 'kernel'
      n = system%kernel_without_integral()
    end if
    do i = 1, size(file%groups)
      if (file%groups(i)%name == name) n = n - 1
      if (n == 0) exit
    end do
    status%message = file%path//':'//show(file%groups(i)%line_of(status%subject))//': ' &
                     //status%message
  end subroutine check_job

end module viscovib_scene
