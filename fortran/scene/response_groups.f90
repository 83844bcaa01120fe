!> The &response group of a scene.
module viscovib_response_groups
  use viscovib_checks, only: check_increasing, check_positive
  use viscovib_curve_groups, only: read_relative
  use viscovib_grids, only: linear_grid, log_grid
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_response, only: response_options
  use viscovib_response_plan, only: method_names
  use viscovib_status, only: show, status_type
  implicit none
  private

  public :: read_response

  character(len=*), parameter :: grid_keys(4) = &
    [character(len=10) :: 'nu_from', 'nu_to', 'nu_count', 'nu_spacing']
  !> Names that the ends had before.
  character(len=*), parameter :: former_keys(2) = ['nu_min', 'nu_max']
  !> Bound that stops a slip of the pen before it fills the memory.
  integer, parameter :: max_grid = 1000000

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
    integer :: judged

    method = 0
    word = reader%read_text('method', 'auto', method_names, method)
    options%choose_harmonics = .true.
    call reader%read_count('harmonics', options%harmonics, options%choose_harmonics)
    call read_relative(reader, options%tolerance, usual)
    options%absolute = reader%read_real('atol', 0.0_wp)
    options%max_iterations = reader%read_integer('max_iterations', options%max_iterations)
    options%relaxation = reader%read_real('relaxation', options%relaxation)
    judged = 1
    word = reader%read_text('stability', 'no', [character(len=3) :: 'no', 'yes'], judged)
    options%stability = judged == 2
    call read_frequencies(reader, nu)
  end subroutine read_response

  !> Either the list nu, or nu_from, nu_to, nu_count and nu_spacing.
  subroutine read_frequencies(reader, nu)
    type(group_reader), intent(inout) :: reader
    real(wp), allocatable, intent(out) :: nu(:)
    type(status_type) :: status
    character(len=:), allocatable :: word
    real(wp) :: lowest, highest
    integer :: i, n, spacing

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
      call check_positive('nu', nu(1), status)
      call reader%place(status)
      return
    end if
    spacing = 1
    lowest = reader%read_real('nu_from')
    highest = reader%read_real('nu_to')
    n = reader%read_integer('nu_count')
    word = reader%read_text('nu_spacing', 'linear', [character(len=6) :: 'linear', 'log'], spacing)
    if (reader%status%failed()) return
    call check_positive('nu_from', lowest, status)
    call reader%place(status)
    if (highest <= lowest) call reader%complain('nu_to', 'nu_to = '//show(highest) &
                                                //': must be greater than nu_from = '//show(lowest))
    if (n < 2 .or. n > max_grid) call reader%complain('nu_count', 'nu_count = '//show(n) &
                                                      //': must be 2 to '//show(max_grid))
    if (reader%status%failed()) return
    if (spacing == 1) then
      nu = linear_grid(lowest, highest, n)
    else
      nu = log_grid(lowest, highest, n)
    end if
  end subroutine read_frequencies

end module viscovib_response_groups
