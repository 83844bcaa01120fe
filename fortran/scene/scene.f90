!> A scene: the system, its load and the results wanted, as one namelist file.
module viscovib_scene
  use viscovib_backbone_job, only: backbone_job, read_backbone, read_free
  use viscovib_branch_job, only: begin_mount, branch_job, read_branch
  use viscovib_driven_job, only: driven_job, read_driven
  use viscovib_group_reader, only: group_reader
  use viscovib_kernel_groups, only: read_kernels
  use viscovib_hereditary_job, only: hereditary_job
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_load_groups, only: read_loads
  use viscovib_mount, only: mount_parameters, mount_type
  use viscovib_mount_groups, only: read_mount
  use viscovib_namelist, only: namelist_type, read_namelist
  use viscovib_oscillator, only: kernel_holder, oscillator_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_groups, only: read_pendulum, read_spectrum, read_transient, spectrum_job
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_motion, only: new_polynomial_motion, polynomial_motion_type
  use viscovib_response, only: response_options
  use viscovib_response_groups, only: read_response
  use viscovib_response_plan, only: method_newton, new_response_plan, response_plan_type
  use viscovib_motion_groups, only: read_frequency, read_hereditary
  use viscovib_scales_job, only: read_oscillator_scales, read_pendulum_scales, scales_job
  use viscovib_scene_groups, only: check_groups, place_of
  use viscovib_status, only: show, status_type
  use viscovib_sweep_groups, only: read_sweep
  use viscovib_system_groups, only: name_length, read_system
  use viscovib_transient_job, only: transient_job
  use viscovib_wanted_coordinates, only: read_wanted
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
    !> Or a branch of its driven motions.
    type(driven_job) :: driven
    !> Or free motions of any system.
    logical :: wants_backbone = .false.
    type(backbone_job) :: backbone
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
    !> Which of them the table shows, and of which there are spectra.
    integer, allocatable :: wanted(:), transformed(:)
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

contains

  !> Read and check everything; nothing is computed yet.
  subroutine read_scene(path, scene, status, text, allow_paths)
    character(len=*), intent(in) :: path
    type(scene_type), intent(out) :: scene
    type(status_type), intent(out) :: status
    !> The scene itself, instead of the file; its path then only names it.
    character(len=*), intent(in), optional :: text
    !> Whether files that it names may be anywhere; else in its folder or below.
    logical, intent(in), optional :: allow_paths
    type(namelist_type) :: file

    scene%path = path
    scene%canonical = ''
    call read_namelist(path, file, status, text)
    if (present(allow_paths)) file%groups%anywhere = allow_paths
    if (.not. status%failed()) call check_groups(file, scene%is_pendulum, status)
    if (.not. status%failed()) call read_title(file, scene, status)
    if (status%failed()) return
    scene%wants_motion = place_of(file, 'transient') <= size(file%groups)
    if (scene%is_pendulum) then
      scene%coordinates = [character(len=name_length) :: 'z', 'phi', 'psi']
      scene%units = [character(len=name_length) :: 'L', 'rad', 'rad']
      call read_motion(file, scene, status)
    else
      call read_oscillator(file, scene, status)
    end if
    if (.not. status%failed()) call read_sweeps(file, scene, status)
  end subroutine read_scene

  !> A mount or a polynomial system, its loads and what is wanted of it.
  subroutine read_oscillator(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout), target :: scene
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
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
      if (status%failed()) return
      call reader%start(file%path, file%groups(place_of(file, 'mount')))
      call read_mount(reader, kernels, parameters, scene%mount)
      call close_group(reader, scene, status)
    end if
    if (status%failed()) return
    call read_loads(file, scene%coordinates, scene%base_direction(), scene%load, &
                    scene%canonical, status)
    if (status%failed()) return
    if (scene%wants_motion) then
      scene%has_memory = .true.
      if (scene%is_polynomial) scene%has_memory = any(scene%polynomial%kernel_of > 0) &
                                                   .or. scene%polynomial%n_silent > 0
      call read_motion(file, scene, status)
      return
    end if
    call open_group(reader, file, 'multiple_scales', scene%wants_scales)
    if (scene%wants_scales) then
      call read_oscillator_scales(reader, scene%load, scene%scales)
      call close_group(reader, scene, status)
      return
    end if
    call open_group(reader, file, 'backbone', scene%wants_backbone)
    if (scene%wants_backbone) then
      call read_backbone(reader, scene%oscillator(), scene%coordinates, scene%backbone)
      call read_wanted(reader, scene%coordinates, scene%wanted)
      call close_group(reader, scene, status)
      return
    end if
    call read_result(file, scene, status)
    if (.not. status%failed()) call check_job(file, scene, status)
  end subroutine read_oscillator

  !> Make the reader ready for a group, if there is one.
  subroutine open_group(reader, file, name, found)
    type(group_reader), intent(inout) :: reader
    type(namelist_type), intent(in) :: file
    character(len=*), intent(in) :: name
    logical, intent(out) :: found
    integer :: i
    i = place_of(file, name)
    found = i <= size(file%groups)
    if (found) call reader%start(file%path, file%groups(i))
  end subroutine open_group

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
      call open_group(reader, file, 'multiple_scales', scene%wants_scales)
      if (scene%wants_scales) then
        call read_pendulum_scales(reader, scene%scales)
        call close_group(reader, scene, status)
        return
      end if
      call open_group(reader, file, 'branch', scene%wants_branch)
      if (scene%wants_branch) then
        call read_driven(reader, scene%pendulum, scene%driven)
        call close_group(reader, scene, status)
        return
      end if
      call open_group(reader, file, 'backbone', scene%wants_backbone)
      if (scene%wants_backbone) then
        call read_free(reader, scene%pendulum, scene%backbone)
        call read_wanted(reader, scene%coordinates, scene%wanted)
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
        scene%transient%last_only = scene%hereditary%last_only
      else
        call read_own_motion(reader, scene)
      end if
    end if
    call read_wanted(reader, scene%coordinates, scene%wanted)
    call close_group(reader, scene, status)
    if (status%failed() .or. .not. any([(file%groups(i)%name == 'spectrum', &
                                         i=1, size(file%groups))])) return
    call reader%start(file%path, file%groups(place_of(file, 'spectrum')))
    call read_spectrum(reader, scene%transient, scene%spectrum)
    call read_wanted(reader, scene%coordinates, scene%transformed)
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

  !> The result wanted of a mount.
  subroutine read_result(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(status_type), intent(out) :: status
    type(group_reader) :: reader

    scene%wants_branch = place_of(file, 'branch') <= size(file%groups)
    if (.not. scene%wants_branch) then
      call reader%start(file%path, file%groups(place_of(file, 'response')))
      call read_response(reader, scene%method, scene%options, scene%nu)
      call read_wanted(reader, scene%coordinates, scene%wanted)
      call close_group(reader, scene, status)
      return
    end if
    call reader%start(file%path, file%groups(place_of(file, 'branch')))
    call read_branch(reader, scene%branch, .not. scene%is_polynomial)
    call begin_mount(reader, scene%branch, scene%mount)
    call read_wanted(reader, scene%coordinates, scene%wanted)
    call close_group(reader, scene, status)
    scene%method = method_newton
    scene%options = scene%branch%options
    scene%nu = [scene%branch%nu]
  end subroutine read_result

  !> Every &sweep is a parameter; no two may be the same.
  subroutine read_sweeps(file, scene, status)
    type(namelist_type), intent(in) :: file
    type(scene_type), intent(inout) :: scene
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=:), allocatable :: key, keys
    integer :: i, n
    ! A grid of more is beyond what is computed, and its size beyond what is counted.
    integer, parameter :: max_sweeps = 16

    keys = ';'
    n = 0
    do i = 1, size(file%groups)
      if (file%groups(i)%name /= 'sweep') cycle
      call reader%start(file%path, file%groups(i))
      call read_sweep(reader, scene%canonical, key)
      n = n + 1
      if (n > max_sweeps) then
        call reader%complain('sweep', '&sweep: must be at most '//show(max_sweeps)//' of them')
      end if
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
