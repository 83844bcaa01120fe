!> What a scene may ask for: each result by the name of its group, and what reads it.
!!
!! A new analysis is added here: its group in `scenes.toml`, its case in `read_result`.
module viscovib_scene_results
  use viscovib_backbone_groups, only: read_backbone, read_free, read_structure_backbone
  use viscovib_backbone_job, only: backbone_job
  use viscovib_basins_groups, only: read_basins
  use viscovib_basins_job, only: basins_job
  use viscovib_branch_job, only: branch_job
  use viscovib_campbell_job, only: campbell_job
  use viscovib_characteristic_roots_job, only: characteristic_roots_job
  use viscovib_checks, only: check_positive
  use viscovib_condensed_subject, only: condense_subject
  use viscovib_curve_groups, only: begin_body, begin_mount, check_between, read_branch, &
    read_curve, read_switch
  use viscovib_drive_torus, only: default_bound, largest_bound, lowest_bound, max_unknowns, &
    n_drives, sort_drives, varies_nu
  use viscovib_driven_job, only: driven_job
  use viscovib_ensemble_groups, only: read_ensemble
  use viscovib_equilibrium_job, only: equilibrium_job
  use viscovib_extra_groups, only: read_extra
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_group_reader, only: group_reader
  use viscovib_growing_text, only: growing_text
  use viscovib_hereditary_job, only: hereditary_job
  use viscovib_job, only: job_type
  use viscovib_kinds, only: wp
  use viscovib_load_groups, only: read_frequency
  use viscovib_many_job, only: many_job
  use viscovib_modes_job, only: modes_job
  use viscovib_motion_choice, only: switches_in_time
  use viscovib_motion_groups, only: read_decay, read_events, read_forces, read_hereditary, &
    read_point, read_shock_spectrum, read_spectrum, read_transient
  use viscovib_motion_job, only: motion_job
  use viscovib_namelist, only: lower, namelist_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_repeating_groups, only: read_steady_motion, read_trace_motion
  use viscovib_response_groups, only: read_campbell, read_oscillator_scales, read_pendulum_scales, &
    read_response
  use viscovib_response_job, only: response_job
  use viscovib_scales_job, only: scales_job
  use viscovib_scene_groups, only: find_result, place_of
  use viscovib_status, only: show, status_type
  use viscovib_steady_motion_job, only: steady_motion_job
  use viscovib_structure_model, only: structure_model
  use viscovib_subject, only: subject_type
  use viscovib_trace_motion_job, only: trace_motion_job
  use viscovib_transient_job, only: transient_job
  use viscovib_whole_structure, only: may_be_whole, whole_only
  implicit none
  private

  public :: read_result

  !> Most names that are read.
  integer, parameter :: most = 1000

contains

  !> The group of the result, its file checked.
  subroutine read_result(file, subject, job, canonical, status)
    type(namelist_type), intent(in) :: file
    type(subject_type), intent(inout), target :: subject
    class(job_type), allocatable, intent(out) :: job
    type(growing_text), intent(inout) :: canonical
    type(status_type), intent(out) :: status
    type(group_reader) :: reader
    character(len=:), allocatable :: kind, plan
    logical :: may_condense, stability
    integer :: n

    n = find_result(file)
    call reader%start(file%path, file%groups(n))
    kind = file%groups(n)%name
    if (subject%is_turning .and. any(['backbone       ', 'multiple_scales', 'campbell       '] &
                                     == kind)) then
      call reader%complain(kind, '&'//kind//": of a &body with geometry = 'exact' it is not " &
                           //"computed, must be 'small'")
    end if
    select case (kind)
    case ('response')
      allocate (response_job :: job)
    case ('branch')
      call read_branch_job(reader, subject, job)
    case ('backbone')
      allocate (backbone_job :: job)
    case ('multiple_scales')
      allocate (scales_job :: job)
    case ('modes')
      allocate (modes_job :: job)
    case ('equilibrium')
      allocate (equilibrium_job :: job)
    case ('characteristic_roots')
      allocate (characteristic_roots_job :: job)
    case ('campbell')
      allocate (campbell_job :: job)
    case ('steady_motion')
      allocate (steady_motion_job :: job)
    case ('trace_motion')
      allocate (trace_motion_job :: job)
    case ('ensemble')
      allocate (many_job :: job)
    case ('basins')
      allocate (basins_job :: job)
    case default
      call read_motion_job(reader, subject, job)
    end select
    select type (job)
    type is (response_job)
      call read_response(reader, subject%usual_tolerance(), job%method, job%options, job%nu)
      call read_extra(reader, subject, job%extra)
    type is (backbone_job)
      call read_backbone_job(reader, subject, job)
    type is (scales_job)
      call read_scales_job(reader, subject, job)
    type is (campbell_job)
      call read_campbell(reader, subject%coordinates, job)
    type is (steady_motion_job)
      call read_steady_motion(reader, subject, job)
    type is (trace_motion_job)
      call read_trace_motion(reader, subject, job)
    type is (many_job)
      call read_ensemble(reader, file, subject, job)
    type is (basins_job)
      call read_basins(reader, subject, job)
    end select
    job%kind = kind
    if (any(['characteristic_roots', 'campbell            '] == kind)) then
      ! Its table has no columns of coordinates.
      allocate (job%wanted(0))
    else
      call read_wanted(reader, subject%coordinates, job%wanted, subject%shown())
    end if
    call reader%close(canonical, status)
    if (status%failed()) return
    call read_parts(file, subject, job, canonical, status)
    if (status%failed()) return
    select type (job)
    type is (motion_job)
      call read_events(file, subject%coordinates, job, canonical, status)
      return
    end select
    if (any(kind == ['response     ', 'branch       ', 'equilibrium  ', &
                     'steady_motion', 'trace_motion ', 'campbell     '])) then
      ! What only the whole job shows to be wrong.
      call job%plan(subject, plan, status)
      if (status%failed()) call place_failure(file, subject, kind, status)
    end if
    call job%may_condense(may_condense, stability)
    if (may_condense) call condense_subject(subject, stability)
  end subroutine read_result

  subroutine read_branch_job(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(inout) :: subject
    class(job_type), allocatable, intent(out) :: job
    type(branch_job), allocatable :: own
    type(driven_job), allocatable :: driven

    if (subject%is_pendulum) then
      allocate (driven)
      call read_driven(reader, subject%pendulum, driven)
      call move_alloc(driven, job)
    else
      allocate (own)
      call read_branch(reader, own, subject)
      if (subject%is_body) then
        call begin_body(reader, own, subject)
      else
        call begin_mount(reader, own, subject%mount)
      end if
      call move_alloc(own, job)
    end if
  end subroutine read_branch_job

  subroutine read_backbone_job(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in), target :: subject
    type(backbone_job), intent(out) :: job

    if (subject%is_pendulum) then
      call read_free(reader, subject%pendulum, job)
    else if (subject%is_structure) then
      call read_structure_backbone(reader, subject%model, subject%coordinates, job)
    else
      call read_backbone(reader, subject%oscillator(), subject%coordinates, job)
    end if
  end subroutine read_backbone_job

  subroutine read_scales_job(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(scales_job), intent(out) :: job

    if (subject%is_pendulum) then
      call read_pendulum_scales(reader, job)
    else
      call read_oscillator_scales(reader, subject%load, job)
    end if
  end subroutine read_scales_job

  subroutine read_motion_job(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in), target :: subject
    class(job_type), allocatable, intent(out) :: job
    type(motion_job), allocatable :: own
    type(hereditary_job), allocatable :: hereditary
    type(transient_job), allocatable :: motion
    type(polynomial_motion_type) :: system
    type(status_type) :: status

    allocate (own, motion)
    if (subject%is_pendulum) then
      call read_transient(reader, subject%pendulum, motion)
      call move_alloc(motion, own%motion)
    else if (subject%remembers()) then
      allocate (hereditary)
      call read_hereditary(reader, size(subject%coordinates), subject%load, hereditary)
      if (subject%is_structure) call check_structure(reader, subject%model, hereditary)
      call move_alloc(hereditary, own%motion)
    else
      call read_frequency(reader, subject%load, own%nu)
      if (.not. reader%status%failed()) then
        call new_fitted_motion(system, subject%polynomial, subject%load, own%nu, 1.0_wp, 1.0_wp, &
                               status)
        call reader%place(status)
        ! Structures, systems that switch, and systems that a shock moves may begin at rest.
        if (.not. status%failed()) then
          call read_transient(reader, system, motion, switches_in_time(subject%polynomial) &
                              .or. allocated(subject%model%mass) &
                              .or. allocated(subject%shaft_start), subject%load%has_table(), &
                              subject%shaft_start)
        end if
      end if
      call move_alloc(motion, own%motion)
    end if
    call read_point(reader, subject, own%motion%point)
    call read_forces(reader, subject, own%motion%wants_forces)
    own%motion%wants_peaks = reader%read_yes('peaks')
    if (own%motion%wants_peaks .and. own%motion%last_only) then
      call reader%complain('peaks', "peaks = 'yes': needs the states all along, must be 'no' " &
                           //"with keep = 'last'")
    end if
    call move_alloc(own, job)
  end subroutine read_motion_job

  !> What a structure in time must not have.
  subroutine check_structure(reader, model, job)
    type(group_reader), intent(inout) :: reader
    type(structure_model), intent(in) :: model
    type(hereditary_job), intent(in) :: job
    if (reader%status%failed()) return
    if (abs(model%modal%loss) > 0.0_wp) then
      call reader%complain('transient', '&transient: loss_factor has no meaning in time, must be ' &
                           //'0 for a motion in time (use a kernel, or modal_damping)')
    else if (model%is_reduced .and. any(abs(job%held) > 0.0_wp)) then
      call reader%complain('held', 'held: must be 0 of a structure with shapes, whose ' &
                           //'coordinates do not tell its state')
    else if (model%is_reduced .and. any(abs(job%initial) > 0.0_wp)) then
      call reader%complain('initial', 'initial: must be 0 of a structure with shapes, whose ' &
                           //'coordinates do not tell its state')
    else if (job%wants_accelerations .and. .not. may_be_whole(model)) then
      call reader%complain('acceleration', "acceleration = 'yes': "//whole_only)
    end if
  end subroutine check_structure

  !> The groups &spectrum, &free_decay and &shock_spectrum of a scene with &transient.
  subroutine read_parts(file, subject, job, canonical, status)
    type(namelist_type), intent(in) :: file
    type(subject_type), intent(inout) :: subject
    class(job_type), intent(inout) :: job
    type(growing_text), intent(inout) :: canonical
    type(status_type), intent(inout) :: status
    character(len=*), parameter :: names(3) = &
      [character(len=14) :: 'spectrum', 'free_decay', 'shock_spectrum']
    type(group_reader) :: reader
    integer :: k, n

    select type (job)
    type is (motion_job)
      do k = 1, size(names)
        n = place_of(file, trim(names(k)))
        if (n > size(file%groups)) cycle
        call reader%start(file%path, file%groups(n))
        if (k < 3 .and. subject%load%has_table() .and. .not. job%motion%dt > 0.0_wp) then
          call reader%complain(trim(names(k)), '&'//trim(names(k))//': needs states at equal ' &
                               //'steps, which end on the corners of a shock: must have dt in ' &
                               //'&transient')
        end if
        if (k == 3) then
          call read_shock_spectrum(reader, subject, job%motion, job%shock)
        else if (k == 1) then
          call read_spectrum(reader, job%motion, job%spectrum)
          call read_wanted(reader, subject%coordinates, job%spectrum%transformed, subject%shown())
        else
          call read_decay(reader, job%motion, job%decay)
          call read_wanted(reader, subject%coordinates, job%decay%fitted, subject%shown())
        end if
        call reader%close(canonical, status)
        if (status%failed()) return
      end do
    end select
  end subroutine read_parts

  !> Put the place before the message of a plan that failed: the line to change.
  subroutine place_failure(file, subject, kind, status)
    type(namelist_type), intent(in) :: file
    type(subject_type), intent(in), target :: subject
    character(len=*), intent(in) :: kind
    type(status_type), intent(inout) :: status
    class(oscillator_type), pointer :: system
    character(len=:), allocatable :: name
    integer :: i, n

    name = kind
    n = 1
    if (status%subject == 'beta') then
      system => subject%oscillator()
      name = 'kernel'
      n = system%kernel_without_integral()
    end if
    do i = 1, size(file%groups)
      if (file%groups(i)%name == name) n = n - 1
      if (n == 0) exit
    end do
    status%message = file%path//':'//show(file%groups(i)%line_of(status%subject))//': ' &
                     //status%message
  end subroutine place_failure

  ! The key `coordinates` of a wanted result: which of them its table shows.

  !> Places of the coordinates wanted, ascending; all by default.
  subroutine read_wanted(reader, names, wanted, default)
    type(group_reader), intent(inout) :: reader
    !> All coordinates.
    character(len=*), intent(in) :: names(:)
    integer, allocatable, intent(out) :: wanted(:)
    !> Which of them if the key is absent; all without this.
    logical, intent(in), optional :: default(:)
    character(len=len(names)), allocatable :: words(:)
    logical :: named(size(names))
    integer :: i, j

    allocate (words(0))
    if (present(default)) then
      words = reader%read_words('coordinates', len(names), most, pack(names, default))
    else
      words = reader%read_words('coordinates', len(names), most, names)
    end if
    named = .false.
    do i = 1, size(words)
      j = findloc(names, lower(words(i)), 1)
      if (j == 0) then
        call reader%complain('coordinates', "coordinates: '"//trim(words(i)) &
                             //"' is none of them, must be among "//listed(names))
      else if (named(j)) then
        call reader%complain('coordinates', "coordinates: '"//trim(words(i)) &
                             //"' is there twice: must differ")
      else
        named(j) = .true.
      end if
      if (reader%status%failed()) exit
    end do
    wanted = pack([(i, i=1, size(names))], named)
  end subroutine read_wanted

  pure function listed(names)
    character(len=*), intent(in) :: names(:)
    character(len=:), allocatable :: listed
    integer :: i
    listed = "'"//trim(names(1))//"'"
    do i = 2, size(names)
      listed = listed//", '"//trim(names(i))//"'"
    end do
  end function listed

  ! The &branch group of a scene with a pendulum.

  subroutine read_driven(reader, pendulum, job)
    type(group_reader), intent(inout) :: reader
    type(pendulum_type), intent(in) :: pendulum
    type(driven_job), intent(out) :: job
    type(status_type) :: status
    character(len=:), allocatable :: word
    real(wp) :: frequency(n_drives)
    integer :: most

    word = reader%read_text('parameter', choice=job%parameter)
    job%options%start = reader%read_real('from')
    job%options%finish = reader%read_real('to')
    job%subharmonic = reader%read_integer('subharmonic')
    job%max_denominator = reader%read_integer('max_denominator')
    if (reader%status%failed()) return
    if (job%parameter <= n_drives .or. job%parameter == varies_nu) then
      call check_positive('from', job%options%start, status)
      call reader%place(status)
      call check_positive('to', job%options%finish, status)
      call reader%place(status)
    end if
    if (.not. abs(job%options%finish - job%options%start) > 0.0_wp) then
      call reader%complain('to', 'to = '//show(job%options%finish)//': must differ from from')
    end if
    if (reader%status%failed()) return
    frequency = pendulum%parameters%frequency
    if (job%parameter <= n_drives) frequency(job%parameter) = job%options%start
    call sort_drives(job%torus, frequency, pendulum%parameters%load, job%parameter, &
                     job%subharmonic, job%max_denominator, status)
    call reader%place(status)
    if (reader%status%failed()) return
    most = largest_bound(job%torus%n_axes, 1.0_wp, max_unknowns)
    job%harmonics = default_bound(job%torus)
    call reader%read_count('harmonics', job%harmonics, job%choose_harmonics)
    call check_between(reader, 'harmonics', job%harmonics, lowest_bound(job%torus), most)
    call read_curve(reader, job%options)
    job%stability = reader%read_yes('stability')
    job%symmetric = reader%read_text('symmetry') == 'kept'
    call read_switch(reader, job%switch)
  end subroutine read_driven

end module viscovib_scene_results
