!> Bounds of input values that more than one method uses.
module viscovib_limits
  use viscovib_kinds, only: wp
  implicit none
  private

  !> Range of the relative size of the last correction.
  real(wp), parameter, public :: min_tolerance = 1.0e-14_wp, max_tolerance = 0.1_wp
  !> Default tolerances of steady motions: for smooth forces, and for laws with corners, whose
  !! harmonics decrease slowly.
  real(wp), parameter, public :: smooth_tolerance = 1.0e-10_wp, corner_tolerance = 1.0e-6_wp
  !> Range of relative errors of solutions in time.
  real(wp), parameter, public :: min_time_tolerance = 1.0e-13_wp, max_time_tolerance = 1.0_wp
  !> Replaces 0 in a parameter that varies, so that no terms are omitted.
  real(wp), parameter, public :: nearly_nothing = 1.0e-200_wp
  !> Smallest mass. With smaller masses products underflow and lose digits.
  real(wp), parameter, public :: least_mass = 1.0e-280_wp
  !> Largest initial displacement. The powers of larger ones overflow.
  real(wp), parameter, public :: largest_start = 1.0e30_wp
  !> Highest harmonic order of a solution, of a load in time, and of all base frequencies together.
  integer, parameter, public :: max_harmonics = 399
  !> Highest order chosen automatically to reach a tolerance, unless the load has higher ones; the
  !! time of a harmonic balance grows as the third power.
  integer, parameter, public :: most_harmonics_chosen = 199

end module viscovib_limits
