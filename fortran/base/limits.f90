!> Bounds of what callers may ask for, where more than one method has them.
module viscovib_limits
  use viscovib_kinds, only: wp
  implicit none
  private

  !> Relative sizes of a last correction.
  real(wp), parameter, public :: min_tolerance = 1.0e-14_wp, max_tolerance = 0.1_wp
  !> Of steady motions if none is given: of smooth forces, and of laws with corners, whose harmonics
  !! decrease slowly.
  real(wp), parameter, public :: smooth_tolerance = 1.0e-10_wp, corner_tolerance = 1.0e-6_wp
  !> Relative errors of motions in time.
  real(wp), parameter, public :: min_time_tolerance = 1.0e-13_wp, max_time_tolerance = 1.0_wp
  !> Stands for 0 where a number varies: terms would be left out that other values have.
  real(wp), parameter, public :: nearly_nothing = 1.0e-200_wp
  !> Smallest mass: with smaller ones, products are too small for numbers and lose their digits.
  real(wp), parameter, public :: least_mass = 1.0e-280_wp
  !> Largest displacement that a motion may begin with: larger ones leave the range of powers.
  real(wp), parameter, public :: largest_start = 1.0e30_wp
  !> Highest order that may be asked of a motion, of a load in time, of base frequencies together.
  integer, parameter, public :: max_harmonics = 399
  !> Highest order of a motion that is chosen to meet a tolerance, unless the load has higher
  !! ones: a balance costs as the third power.
  integer, parameter, public :: most_harmonics_chosen = 199

end module viscovib_limits
