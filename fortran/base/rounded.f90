!> Numbers with few digits, for messages.
module viscovib_rounded
  use viscovib_kinds, only: wp
  use viscovib_status, only: show
  implicit none
  private

  public :: brief, error_digits, six_digits

  !> Sizes for which powers of ten neither overflow nor underflow.
  real(wp), parameter :: least = 1.0e-290_wp, most = 1.0e290_wp

contains

  !> A number with six digits.
  pure function brief(x) result(text)
    real(wp), intent(in) :: x
    character(len=:), allocatable :: text
    text = show(six_digits(x))
  end function brief

  !> An estimated error: two digits.
  pure function error_digits(x) result(text)
    real(wp), intent(in) :: x
    character(len=:), allocatable :: text
    text = show(to_digits(x, 2))
  end function error_digits

  !> Rounded to six digits.
  elemental real(wp) function six_digits(x)
    real(wp), intent(in) :: x
    six_digits = to_digits(x, 6)
  end function six_digits

  !> Rounded to n digits; very small and large numbers as they are.
  elemental real(wp) function to_digits(x, n)
    real(wp), intent(in) :: x
    integer, intent(in) :: n
    integer :: digits
    to_digits = x
    if (.not. (abs(x) > least .and. abs(x) < most)) return
    digits = n - 1 - floor(log10(abs(x)))
    if (digits >= 0) then
      to_digits = anint(x*10.0_wp**digits)/10.0_wp**digits
    else
      to_digits = anint(x/10.0_wp**(-digits))*10.0_wp**(-digits)
    end if
  end function to_digits

end module viscovib_rounded
