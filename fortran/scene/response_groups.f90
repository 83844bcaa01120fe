!> The &response, &campbell and &multiple_scales groups of a scene, and ranges of values.
module viscovib_response_groups
  use viscovib_campbell_job, only: campbell_job
  use viscovib_checks, only: check_increasing, check_positive
  use viscovib_curve_groups, only: read_relative
  use viscovib_grids, only: linear_grid, log_grid
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_namelist, only: lower
  use viscovib_response, only: response_options
  use viscovib_scales_job, only: scales_job
  use viscovib_scales_response, only: vary_amplitude, vary_frequency
  use viscovib_status, only: show, status_type
  implicit none
  private

  public :: read_campbell, read_range, read_response, read_pendulum_scales, read_oscillator_scales

  character(len=*), parameter :: grid_keys(4) = &
    [character(len=10) :: 'nu_from', 'nu_to', 'nu_count', 'nu_spacing']
  !> Names that the ends had before.
  character(len=*), parameter :: former_keys(2) = ['nu_min', 'nu_max']

contains

  subroutine read_response(reader, usual, method, options, nu)
    type(group_reader), intent(inout) :: reader
    !> The tolerance if none is given.
    real(wp), intent(in) :: usual
    integer, intent(out) :: method
    type(response_options), intent(inout) :: options
    !> Frequencies (rad/s).
    real(wp), allocatable, intent(out) :: nu(:)
    character(len=:), allocatable :: word

    word = reader%read_text('method', choice=method)
    call reader%read_count('harmonics', options%harmonics, options%choose_harmonics)
    call read_relative(reader, options%tolerance, usual)
    options%absolute = reader%read_real('atol')
    options%max_iterations = reader%read_integer('max_iterations')
    options%relaxation = reader%read_real('relaxation')
    options%stability = reader%read_yes('stability')
    call read_frequencies(reader, nu)
  end subroutine read_response

  !> Either the list nu, or nu_from, nu_to, nu_count and nu_spacing.
  subroutine read_frequencies(reader, nu)
    type(group_reader), intent(inout) :: reader
    real(wp), allocatable, intent(out) :: nu(:)
    type(status_type) :: status
    integer :: i

    allocate (nu(0))
    call reader%refuse(former_keys, 'the ends are nu_from and nu_to, as of a &branch')
    if (reader%status%failed()) return
    if (reader%has('nu') .or. &
        all([(index(reader%group%entries(i)%key, 'nu') /= 1, i=1, reader%group%n_entries)])) then
      call reader%refuse(grid_keys, 'the frequencies are listed in nu already; give either nu, ' &
                         //'or nu_from, nu_to, nu_count and nu_spacing')
      nu = reader%read_reals('nu')
      if (reader%status%failed()) return
      call check_increasing('nu', nu, status)
      call reader%place(status)
      return
    end if
    call read_range(reader, 'nu_', nu, 'nu_spacing')
  end subroutine read_frequencies

  !> Values of a range: keys that end in `from`, `to` and `count`.
  subroutine read_range(reader, begin, values, spacing)
    type(group_reader), intent(inout) :: reader
    !> Begin of the keys.
    character(len=*), intent(in) :: begin
    !> Size 0 if reading failed.
    real(wp), allocatable, intent(out) :: values(:)
    !> Key of the spacing, linear or logarithmic; absent: linear.
    character(len=*), intent(in), optional :: spacing
    character(len=:), allocatable :: word
    real(wp) :: first, last
    integer :: n

    allocate (values(0))
    first = reader%read_real(begin//'from')
    last = reader%read_real(begin//'to')
    n = reader%read_integer(begin//'count')
    word = 'linear'
    if (present(spacing)) word = reader%read_text(spacing)
    if (reader%status%failed()) return
    if (last <= first) then
      call reader%complain(begin//'to', begin//'to = '//show(last)//': must be greater than ' &
                           //begin//'from = '//show(first))
    else if (word == 'linear') then
      values = linear_grid(first, last, n)
    else
      values = log_grid(first, last, n)
    end if
  end subroutine read_range

  subroutine read_campbell(reader, names, job)
    type(group_reader), intent(inout) :: reader
    !> Coordinates of the system.
    character(len=*), intent(in) :: names(:)
    type(campbell_job), intent(inout) :: job
    character(len=len(names)), allocatable :: words(:)
    integer :: i

    call read_range(reader, 'speed_', job%speeds)
    job%orders = reader%read_reals('orders', default=[1.0_wp])
    if (reader%may_have('plane')) then
      allocate (words(0))
      words = reader%read_words('plane', len(names), 2)
      if (reader%status%failed()) return
      job%plane(:size(words)) = [(findloc(names, lower(words(i)), 1), i=1, size(words))]
      if (any(job%plane == 0) .or. job%plane(1) == job%plane(2)) then
        call reader%complain('plane', 'plane: must be two of the coordinates')
      end if
    end if
  end subroutine read_campbell

  subroutine read_pendulum_scales(reader, job)
    type(group_reader), intent(inout) :: reader
    type(scales_job), intent(out) :: job
    character(len=:), allocatable :: word
    integer :: which

    job%parameter = reader%read_text('parameter', choice=which)
    job%load = modulo(which - 1, 3) + 1
    job%vary = merge(vary_frequency, vary_amplitude, which <= 3)
    call read_values(reader, job)
    word = reader%read_text('ordering', choice=job%ordering)
  end subroutine read_pendulum_scales

  !> The load is the scene's: one frequency, one phase.
  subroutine read_oscillator_scales(reader, load, job)
    type(group_reader), intent(inout) :: reader
    type(load_type), intent(in) :: load
    type(scales_job), intent(out) :: job
    integer :: which

    job%parameter = reader%read_text('parameter', choice=which)
    job%vary = merge(vary_frequency, vary_amplitude, which == 1)
    call read_values(reader, job)
    if (job%vary == vary_amplitude) then
      job%nu = reader%read_real('nu')
    else
      call reader%refuse(['nu'], 'the frequency is what is varied')
    end if
    if (load%varies()) then
      call reader%complain('parameter', '&load: depends on nu, must be constant for ' &
                           //'&multiple_scales')
    end if
    if (load%moves_base()) call reader%complain('parameter', "&load kind = 'base': is for " &
                                                //'&response; must be a force for &multiple_scales')
    if (any(load%orders /= 1) .or. size(load%orders) == 0) then
      call reader%complain('parameter', '&load: must have order 1 alone, and not vanish, for ' &
                           //'&multiple_scales')
    end if
    if (reader%status%failed()) return
    if (any(abs(aimag(load%force)) > 0.0_wp)) then
      call reader%complain('parameter', '&load: must have phase 0 for &multiple_scales; phases ' &
                           //'of the motion are counted from the load')
      return
    end if
    job%force = real(load%force(:, 1))
  end subroutine read_oscillator_scales

  subroutine read_values(reader, job)
    type(group_reader), intent(inout) :: reader
    type(scales_job), intent(inout) :: job
    type(status_type) :: status

    call read_range(reader, '', job%values)
    job%tolerance = reader%read_real('tolerance')
    if (reader%status%failed() .or. job%vary /= vary_frequency) return
    call check_positive('from', job%values(1), status)
    call reader%place(status)
  end subroutine read_values

end module viscovib_response_groups
