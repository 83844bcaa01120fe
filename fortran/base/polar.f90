!> Modulus and argument of complex numbers, bit-identical to the C library.
!!
!! Evaluated one by one: vector functions may differ in the last bit, so tables from Python and from
!! the driver would differ.
module viscovib_polar
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: modulus, argument

contains

  elemental real(wp) function modulus(z)
    complex(wp), intent(in) :: z
    modulus = hypot(real(z), aimag(z))
  end function modulus

  !> In rad, in (-pi, pi].
  elemental real(wp) function argument(z)
    complex(wp), intent(in) :: z
    argument = atan2(aimag(z), real(z))
  end function argument

end module viscovib_polar
