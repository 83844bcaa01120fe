!> The &transient group of a system with memory.
module viscovib_motion_groups
  use viscovib_checks, only: check_positive
  use viscovib_group_reader, only: group_reader
  use viscovib_hereditary_job, only: hereditary_job, hereditary_methods, past_names
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_pendulum_groups, only: read_accuracy, read_keep
  use viscovib_status, only: status_type
  use viscovib_transient_job, only: check_times
  implicit none
  private

  public :: read_hereditary, read_frequency

contains

  subroutine read_hereditary(reader, n_dof, load, job)
    type(group_reader), intent(inout) :: reader
    integer, intent(in) :: n_dof
    type(load_type), intent(in) :: load
    type(hereditary_job), intent(out) :: job
    type(status_type) :: status
    real(wp) :: nothing(n_dof), start(2*n_dof)
    character(len=:), allocatable :: word

    call read_frequency(reader, load, job%nu)
    nothing = 0.0_wp
    job%held = reader%read_reals('held', n_dof, nothing)
    if (reader%status%failed()) return
    start = 0.0_wp
    start(1::2) = job%held
    job%initial = reader%read_reals('initial', 2*n_dof, start)
    job%t_end = reader%read_real('t_end')
    job%dt = reader%read_real('dt', 0.0_wp)
    call read_accuracy(reader, job)
    word = reader%read_text('method', 'gauss8', hereditary_methods, job%method)
    word = reader%read_text('memory', 'auto', past_names, job%past)
    job%save_every = reader%read_integer('save_every', 1)
    call read_keep(reader, job)
    if (reader%status%failed()) return
    call check_times(job, status)
    call reader%place(status)
  end subroutine read_hereditary

  !> The frequency nu of a load that has one.
  subroutine read_frequency(reader, load, nu)
    type(group_reader), intent(inout) :: reader
    type(load_type), intent(in) :: load
    real(wp), intent(out) :: nu
    type(status_type) :: status

    nu = 0.0_wp
    if (any(load%orders > 0)) then
      nu = reader%read_real('nu')
      if (reader%status%failed()) return
      call check_positive('nu', nu, status)
      call reader%place(status)
    else
      call reader%refuse(['nu'], 'is the frequency of a load, and none has one')
    end if
  end subroutine read_frequency

end module viscovib_motion_groups
