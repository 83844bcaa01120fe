!> Bounds of what callers may ask for, where more than one method has them.
module viscovib_limits
  use viscovib_kinds, only: wp
  implicit none
  private

  !> Relative sizes of a last correction.
  real(wp), parameter, public :: min_tolerance = 1.0e-14_wp, max_tolerance = 0.1_wp

end module viscovib_limits
