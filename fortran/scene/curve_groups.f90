!> What groups about curves share: keys that say how they are followed and where others leave.
module viscovib_curve_groups
  use viscovib_curve_branch, only: curve_options
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_status, only: show
  implicit none
  private

  public :: read_curve, read_switch, read_yes, check_between

  integer, parameter, public :: max_curve_points = 100000
  integer, parameter :: max_switches = 20

contains

  !> tolerance, max_points and max_step.
  subroutine read_curve(reader, options)
    type(group_reader), intent(inout) :: reader
    type(curve_options), intent(inout) :: options

    options%tolerance = reader%read_real('tolerance', options%tolerance)
    options%max_points = reader%read_integer('max_points', options%max_points)
    options%max_step = reader%read_real('max_step', options%max_step)
    if (reader%status%failed()) return
    call check_between(reader, 'max_points', options%max_points, 2, max_curve_points)
    if (options%tolerance < 1.0e-14_wp .or. options%tolerance > 0.1_wp) then
      call reader%complain('tolerance', 'tolerance = '//show(options%tolerance) &
                           //': must be in [1e-14, 0.1]')
    end if
    if (options%max_step < 1.0e-4_wp .or. options%max_step > 1.0_wp) then
      call reader%complain('max_step', 'max_step = '//show(options%max_step) &
                           //': must be in [1e-4, 1]')
    end if
  end subroutine read_curve

  !> Branch points to leave at, counted from 1, negative: the other way.
  subroutine read_switch(reader, switch)
    type(group_reader), intent(inout) :: reader
    integer, allocatable, intent(out) :: switch(:)

    switch = reader%read_some_integers('switch', max_switches)
    if (any(switch == 0)) call reader%complain('switch', 'switch = 0: must be the number of a ' &
                                               //'branch point, from 1, or its negative')
  end subroutine read_switch

  !> A key that says 'yes' (the default) or 'no'.
  logical function read_yes(reader, key)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: key
    character(len=:), allocatable :: word
    integer :: choice
    choice = 1
    word = reader%read_text(key, 'yes', [character(len=3) :: 'yes', 'no'], choice)
    read_yes = choice == 1
  end function read_yes

  subroutine check_between(reader, key, value, lowest, highest)
    type(group_reader), intent(inout) :: reader
    character(len=*), intent(in) :: key
    integer, intent(in) :: value, lowest, highest
    if (value < lowest .or. value > highest) then
      call reader%complain(key, key//' = '//show(value)//': must be '//show(lowest)//' to ' &
                           //show(highest))
    end if
  end subroutine check_between

end module viscovib_curve_groups
