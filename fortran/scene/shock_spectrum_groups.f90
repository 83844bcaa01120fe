!> The &shock_spectrum group of a scene.
module viscovib_shock_spectrum_groups
  use viscovib_constants, only: standard_gravity
  use viscovib_grids, only: linear_grid, log_grid
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_record_doubts, only: doubt_record
  use viscovib_shock_spectrum, only: check_damping
  use viscovib_shock_spectrum_job, only: shock_spectrum_job
  use viscovib_status, only: show, status_type
  use viscovib_subject, only: subject_type
  use viscovib_timed_groups, only: read_record
  use viscovib_transient_job, only: transient_job
  implicit none
  private

  public :: read_shock_spectrum

  character(len=*), parameter :: grid_keys(4) = &
    [character(len=7) :: 'from', 'to', 'count', 'spacing']

contains

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
    real(wp) :: first, last
    integer :: n

    allocate (hz(0))
    if (reader%may_have('frequencies')) then
      hz = reader%read_reals('frequencies')
      call reader%refuse(grid_keys, 'the frequencies are listed in frequencies already')
      return
    end if
    first = reader%read_real('from')
    last = reader%read_real('to')
    n = reader%read_integer('count')
    if (.not. reader%status%failed() .and. last <= first) then
      call reader%complain('to', 'to = '//show(last)//': must be greater than from = '//show(first))
    end if
    if (reader%read_text('spacing') == 'linear') then
      if (.not. reader%status%failed()) hz = linear_grid(first, last, n)
    else
      if (.not. reader%status%failed()) hz = log_grid(first, last, n)
    end if
  end subroutine read_frequencies

end module viscovib_shock_spectrum_groups
