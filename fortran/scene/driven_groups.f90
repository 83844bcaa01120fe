!> The &branch group of a scene with a pendulum.
module viscovib_driven_groups
  use viscovib_checks, only: check_positive
  use viscovib_curve_groups, only: check_between, read_curve, read_switch
  use viscovib_drive_torus, only: default_bound, largest_bound, lowest_bound, max_unknowns, &
    n_drives, sort_drives, varies_nu
  use viscovib_driven_job, only: driven_job
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: show, status_type
  implicit none
  private

  public :: read_driven

contains

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

end module viscovib_driven_groups
