! Optimize: -O1
!> Modulus, argument and logarithm of complex numbers, bit-identical to the C library.
!!
!! Evaluated one by one: vector functions may differ in the last bit, so tables from Python and from
!! the driver would differ.
module viscovib_polar
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: modulus, argument, plain_logarithm

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

  !> log z up to rounding of 1. The library resolves moduli near 1 further, which takes many times
  !! as long.
  elemental complex(wp) function plain_logarithm(z)
    complex(wp), intent(in) :: z
    plain_logarithm = cmplx(log(modulus(z)), argument(z), wp)
  end function plain_logarithm

end module viscovib_polar
