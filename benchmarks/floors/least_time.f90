!> A clock, and a line of the table.
module floor_clock
  use, intrinsic :: iso_fortran_env, only: i8 => int64, wp => real64
  implicit none
  private

  public :: now, show

  !> Number of samples. The least time counts, because other processes only add time.
  integer, parameter, public :: samples = 40

contains

  real(wp) function now()
    integer(i8) :: ticks, rate
    call system_clock(ticks, rate)
    now = real(ticks, wp)/rate
  end function now

  subroutine show(name, seconds, what)
    character(len=*), intent(in) :: name, what
    real(wp), intent(in) :: seconds
    print '(a, ",", es12.5, ",", a)', name, seconds, what
  end subroutine show

end module floor_clock
