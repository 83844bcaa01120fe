!> The &pendulum, &transient and &spectrum groups of a scene.
module viscovib_pendulum_groups
  use viscovib_driven_system, only: driven_system_type
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_pendulum, only: equations_names, new_pendulum, pendulum_parameters, pendulum_type
  use viscovib_status, only: show, status_type
  use viscovib_transient_job, only: check_transient, transient_job
  use viscovib_windows, only: window_hann, window_names
  implicit none
  private

  public :: spectrum_job, read_pendulum, read_transient, read_accuracy, read_keep
  public :: read_spectrum

  !> Spectra of the coordinates of a motion.
  type :: spectrum_job
    logical :: wanted = .false.
    !> Place in `window_names`.
    integer :: window = window_hann
    !> Time before which nothing counts.
    real(wp) :: discard = 0.0_wp
  end type spectrum_job

contains

  subroutine read_pendulum(reader, pendulum)
    type(group_reader), intent(inout) :: reader
    type(pendulum_type), intent(out) :: pendulum
    type(pendulum_parameters) :: p
    type(status_type) :: built
    character(len=:), allocatable :: word

    p%e = reader%read_real('e')
    p%w2 = reader%read_real('w2')
    p%w3 = reader%read_real('w3')
    p%alpha = reader%read_real('alpha', 0.0_wp)
    p%damping(1) = reader%read_real('c1', 0.0_wp)
    p%damping(2) = reader%read_real('c2', 0.0_wp)
    p%damping(3) = reader%read_real('c3', 0.0_wp)
    p%load(1) = reader%read_real('f0', 0.0_wp)
    p%load(2) = reader%read_real('m01', 0.0_wp)
    p%load(3) = reader%read_real('m02', 0.0_wp)
    p%frequency(1) = reader%read_real('p1', 0.0_wp)
    p%frequency(2) = reader%read_real('p2', 0.0_wp)
    p%frequency(3) = reader%read_real('p3', 0.0_wp)
    word = reader%read_text('equations', 'exact', equations_names, p%equations)
    if (reader%status%failed()) return
    call new_pendulum(pendulum, p, built)
    call reader%place(built)
  end subroutine read_pendulum

  subroutine read_transient(reader, system, job)
    type(group_reader), intent(inout) :: reader
    class(driven_system_type), intent(in) :: system
    type(transient_job), intent(out) :: job
    type(status_type) :: checked
    character(len=:), allocatable :: word

    job%initial = reader%read_reals('initial', 2*system%n_dof)
    job%t_end = reader%read_real('t_end')
    job%dt = reader%read_real('dt', 0.0_wp)
    call read_accuracy(reader, job)
    word = reader%read_text('method', 'gauss8', transient_methods, job%method)
    job%save_every = reader%read_integer('save_every', 1)
    call read_keep(reader, job)
    if (reader%status%failed()) return
    call check_transient(job, system, checked)
    call reader%place(checked)
  end subroutine read_transient

  !> `tolerance`, or in its place `rtol` and `atol`.
  subroutine read_accuracy(reader, job)
    type(group_reader), intent(inout) :: reader
    class(transient_job), intent(inout) :: job
    real(wp) :: absolute

    job%relative = reader%read_real('rtol', 0.0_wp)
    absolute = reader%read_real('atol', 0.0_wp)
    job%tolerance = 1.0e-10_wp
    if (job%dt > 0.0_wp .or. job%relative > 0.0_wp .or. absolute > 0.0_wp) job%tolerance = absolute
    job%tolerance = reader%read_real('tolerance', job%tolerance)
    if (job%relative > 0.0_wp .or. absolute > 0.0_wp) then
      if (abs(job%tolerance - absolute) > 0.0_wp) then
        call reader%complain('tolerance', 'tolerance = '//show(job%tolerance)//': is atol ' &
                             //'alone, must not be given with rtol or atol')
      end if
    end if
  end subroutine read_accuracy

  !> Whether states are kept all along or at the end only.
  subroutine read_keep(reader, job)
    type(group_reader), intent(inout) :: reader
    class(transient_job), intent(inout) :: job
    character(len=:), allocatable :: word
    integer :: place

    place = 1
    word = reader%read_text('keep', 'all', [character(len=4) :: 'all', 'last'], place)
    job%last_only = place == 2
    if (job%last_only .and. job%save_every /= 1) then
      call reader%complain('save_every', 'save_every = '//show(job%save_every)//': must be 1 ' &
                           //"with keep = 'last'")
    end if
  end subroutine read_keep

  subroutine read_spectrum(reader, transient, job)
    type(group_reader), intent(inout) :: reader
    type(transient_job), intent(in) :: transient
    type(spectrum_job), intent(out) :: job
    character(len=:), allocatable :: word

    job%wanted = .true.
    word = reader%read_text('window', 'hann', window_names, job%window)
    job%discard = reader%read_real('discard', 0.0_wp)
    if (reader%status%failed()) return
    if (transient%last_only) then
      call reader%complain('spectrum', "&spectrum: needs the states all along, and &transient " &
                           //"has keep = 'last'")
    end if
    if (job%discard < 0.0_wp .or. job%discard >= transient%t_end) then
      call reader%complain('discard', 'discard = '//show(job%discard)//': must not be negative ' &
                           //'and less than t_end = '//show(transient%t_end))
    end if
  end subroutine read_spectrum

end module viscovib_pendulum_groups
