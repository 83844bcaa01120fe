!> The &basins group of a scene.
module viscovib_basins_groups
  use viscovib_basins_job, only: basins_job, length
  use viscovib_grids, only: linear_grid
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_load_groups, only: read_frequency
  use viscovib_namelist, only: lower
  use viscovib_near_words, only: listed
  use viscovib_status, only: show
  use viscovib_subject, only: subject_type
  implicit none
  private

  public :: read_basins

  !> Coordinates of which all are kept.
  integer, parameter :: most_coordinates = 64
  integer, parameter :: most_starts = 1000000, most_periods = 100000000

contains

  subroutine read_basins(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(basins_job), intent(out) :: job

    call check_subject(reader, subject)
    call read_starts(reader, subject, job)
    if (reader%status%failed()) return
    job%initial = reader%read_reals('initial', 2*size(subject%coordinates))
    if (.not. subject%is_pendulum) call read_frequency(reader, subject%load, job%nu)
    call read_length(reader, subject, job)
    job%tolerance = reader%read_real('tolerance')
    job%dt = reader%read_real('dt')
    if (reader%status%failed()) return
    if (job%sections == 0 .and. job%dt > job%t_end) then
      call reader%complain('dt', 'dt = '//show(job%dt)//': must not exceed t_end = ' &
                           //show(job%t_end))
    end if
    if (subject%is_pendulum) call check_springs(reader, job)
  end subroutine read_basins

  !> What has no map of basins.
  subroutine check_subject(reader, subject)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject

    if (size(subject%coordinates) > most_coordinates) then
      call reader%complain('basins', '&basins: takes at most '//show(most_coordinates) &
                           //' coordinates, here are '//show(size(subject%coordinates)))
    else if (subject%is_turning) then
      call reader%complain('basins', "&basins: of a &body with geometry = 'exact' it is not " &
                           //"computed, must be 'small'")
    else if (subject%is_structure) then
      if (abs(subject%model%modal%loss) > 0.0_wp) then
        call reader%complain('basins', '&basins: loss_factor has no meaning in time, must be 0 ' &
                             //'(use a kernel, or modal_damping)')
      else if (subject%model%is_reduced) then
        call reader%complain('basins', '&basins: the coordinates of a structure with shapes do ' &
                             //'not tell its state, must be without')
      end if
    end if
  end subroutine check_subject

  !> Which two numbers of the state vary, and their values.
  subroutine read_starts(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(basins_job), intent(inout) :: job
    character(len=length) :: known(2*size(subject%coordinates))
    character(len=length), allocatable :: names(:)
    real(wp) :: from(2), to(2)
    integer :: counts(2), i

    known(1::2) = subject%coordinates
    do i = 1, size(subject%coordinates)
      known(2*i) = trim(subject%coordinates(i))//'_dot'
    end do
    allocate (names(0))
    names = reader%read_words('vary', length, 2)
    if (reader%status%failed()) return
    if (size(names) /= 2) then
      call reader%complain('vary', 'vary has 1 text: must be two of '//listed(known, "'"))
      return
    end if
    do i = 1, 2
      job%names(i) = lower(names(i))
      job%places(i) = findloc(known, job%names(i), 1)
      if (job%places(i) > 0) cycle
      call reader%complain('vary', "vary = '"//trim(job%names(i))//"': must be two of " &
                           //listed(known, "'"))
    end do
    if (job%places(1) == job%places(2)) then
      call reader%complain('vary', "vary: '"//trim(job%names(1))//"' is there twice: must differ")
    end if
    from = reader%read_reals('from')
    to = reader%read_reals('to')
    counts = reader%read_integers('count', 2)
    if (reader%status%failed()) return
    if (any(counts < 1) .or. product(real(counts, wp)) > most_starts) then
      call reader%complain('count', 'count = '//show(counts(1))//' '//show(counts(2)) &
                           //': must be two numbers, 1 or more, whose product is at most ' &
                           //show(most_starts))
      return
    end if
    job%x = linear_grid(from(1), to(1), counts(1))
    job%y = linear_grid(from(2), to(2), counts(2))
  end subroutine read_starts

  !> Periods under a load, else a time.
  subroutine read_length(reader, subject, job)
    type(group_reader), intent(inout) :: reader
    type(subject_type), intent(in) :: subject
    type(basins_job), intent(inout) :: job
    logical :: repeats

    if (reader%status%failed()) return
    repeats = subject%is_pendulum
    if (.not. repeats) repeats = any(subject%load%orders > 0)
    if (.not. repeats) then
      call reader%refuse(['n_periods ', 'sections  ', 'max_period'], 'is for a load with a ' &
                         //'period, and there is none; the length is t_end')
      job%t_end = reader%read_real('t_end')
      return
    end if
    call reader%refuse(['t_end'], 'the length is n_periods under a load')
    job%sections = 1
    if (subject%is_pendulum) job%sections = reader%read_integer('sections')
    job%max_period = reader%read_integer('max_period')
    job%n_periods = reader%read_integer('n_periods')
    if (reader%status%failed()) return
    if (job%n_periods <= 2*job%max_period .or. job%n_periods > most_periods) then
      call reader%complain('n_periods', 'n_periods = '//show(job%n_periods)//': must be more ' &
                           //'than twice max_period, '//show(2*job%max_period + 1)//' to ' &
                           //show(most_periods))
    end if
  end subroutine read_length

  !> The spring of a pendulum must not be shorter than nothing.
  subroutine check_springs(reader, job)
    type(group_reader), intent(inout) :: reader
    type(basins_job), intent(in) :: job
    real(wp) :: least
    character(len=:), allocatable :: key

    if (reader%status%failed()) return
    key = 'from'
    if (job%places(1) == 1) then
      least = min(job%x(1), job%x(size(job%x)))
    else if (job%places(2) == 1) then
      least = min(job%y(1), job%y(size(job%y)))
    else
      key = 'initial'
      least = job%initial(1)
    end if
    if (least <= -1.0_wp) call reader%complain(key, key//': z = '//show(least) &
                                               //', must be greater than -1')
  end subroutine check_springs

end module viscovib_basins_groups
