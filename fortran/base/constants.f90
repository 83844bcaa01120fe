!> Mathematical constants, and standard gravity.
module viscovib_constants
  use viscovib_kinds, only: wp
  implicit none
  private

  real(wp), parameter, public :: pi = 3.14159265358979323846264338327950288_wp
  real(wp), parameter, public :: half_pi = 0.5_wp*pi
  !> In m/s^2.
  real(wp), parameter, public :: standard_gravity = 9.80665_wp
  complex(wp), parameter, public :: imaginary_unit = (0.0_wp, 1.0_wp)

end module viscovib_constants
