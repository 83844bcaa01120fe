!> The &response group of a scene.
module viscovib_response_groups
  use viscovib_checks, only: check_increasing
  use viscovib_curve_groups, only: read_relative
  use viscovib_grids, only: linear_grid, log_grid
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_response, only: response_options
  use viscovib_status, only: show, status_type
  implicit none
  private

  public :: read_response

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
    character(len=:), allocatable :: spacing
    real(wp) :: lowest, highest
    integer :: i, n

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
    lowest = reader%read_real('nu_from')
    highest = reader%read_real('nu_to')
    n = reader%read_integer('nu_count')
    spacing = reader%read_text('nu_spacing')
    if (reader%status%failed()) return
    if (highest <= lowest) call reader%complain('nu_to', 'nu_to = '//show(highest) &
                                                //': must be greater than nu_from = '//show(lowest))
    if (reader%status%failed()) return
    if (spacing == 'linear') then
      nu = linear_grid(lowest, highest, n)
    else
      nu = log_grid(lowest, highest, n)
    end if
  end subroutine read_frequencies

end module viscovib_response_groups
