!> Numbers with few digits, for messages.
module viscovib_rounded
  use viscovib_kinds, only: wp
  use viscovib_status, only: show
  implicit none
  private

  public :: brief, six_digits

  !> Sizes for which powers of ten neither overflow nor underflow.
  real(wp), parameter :: least = 1.0e-290_wp, most = 1.0e290_wp

contains

  !> A number with six digits.
  pure function brief(x) result(text)
    real(wp), intent(in) :: x
    character(len=:), allocatable :: text
    text = show(six_digits(x))
  end function brief

  !> Rounded to six digits; very small and large numbers as they are.
  elemental real(wp) function six_digits(x)
    real(wp), intent(in) :: x
    integer :: digits
    six_digits = x
    if (.not. (abs(x) > least .and. abs(x) < most)) return
    digits = 5 - floor(log10(abs(x)))
    if (digits >= 0) then
      six_digits = anint(x*10.0_wp**digits)/10.0_wp**digits
    else
      six_digits = anint(x/10.0_wp**(-digits))*10.0_wp**(-digits)
    end if
  end function six_digits

end module viscovib_rounded
