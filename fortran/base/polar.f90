!> Modulus and argument of complex numbers, to the last bit as the C library has them.
!!
!! One by one: loops over them would be given to vector functions, whose last bit is another, and
!! tables of Python and of the driver would differ.
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
