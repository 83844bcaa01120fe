!> What groups about curves share: keys that say how they are followed and where others leave.
module viscovib_curve_groups
  use viscovib_curve_branch, only: curve_options, curve_table
  use viscovib_group_reader, only: group_reader
  use viscovib_kinds, only: wp
  use viscovib_limits, only: smooth_tolerance
  use viscovib_status, only: show
  implicit none
  private

  public :: read_curve, read_relative, read_switch, check_between

  integer, parameter :: max_switches = 20

contains

  !> The options of curves, each by its name in `curve_table`.
  subroutine read_curve(reader, options, usual)
    type(group_reader), intent(inout) :: reader
    type(curve_options), intent(inout) :: options
    !> The tolerance if none is given.
    real(wp), intent(in), optional :: usual
    character(len=:), allocatable :: key
    real(wp) :: values(size(curve_table))
    integer :: i

    values = options%values()
    do i = 1, size(curve_table)
      key = trim(curve_table(i)%name)
      if (key == 'tolerance') then
        call read_relative(reader, values(i), usual)
      else if (curve_table(i)%whole) then
        values(i) = reader%read_integer(key)
      else
        values(i) = reader%read_real(key)
      end if
    end do
    if (.not. reader%status%failed()) call options%set(values)
  end subroutine read_curve

  !> `tolerance`, or its other name `rtol`.
  subroutine read_relative(reader, tolerance, usual)
    type(group_reader), intent(inout) :: reader
    real(wp), intent(out) :: tolerance
    !> The value if neither is given; that of smooth laws if missing.
    real(wp), intent(in), optional :: usual
    real(wp) :: relative

    tolerance = smooth_tolerance
    if (present(usual)) tolerance = usual
    relative = reader%read_real('rtol')
    if (relative > 0.0_wp) tolerance = relative
    tolerance = reader%read_real('tolerance', tolerance)
    if (reader%status%failed() .or. .not. abs(relative) > 0.0_wp) return
    if (abs(tolerance - relative) > 0.0_wp) then
      call reader%complain('rtol', 'rtol = '//show(relative)//': is another name of tolerance, ' &
                           //'must not be given with it')
    end if
  end subroutine read_relative

  !> Branch points to leave at, counted from 1, negative: the other way.
  subroutine read_switch(reader, switch)
    type(group_reader), intent(inout) :: reader
    integer, allocatable, intent(out) :: switch(:)

    switch = reader%read_some_integers('switch', max_switches)
    if (any(switch == 0)) call reader%complain('switch', 'switch = 0: must be the number of a ' &
                                               //'branch point, from 1, or its negative')
  end subroutine read_switch

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
