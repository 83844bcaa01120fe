! Flat routines over the rules of basins of attraction, for f2py.

!> Which orbits the last points of motions repeat, see viscovib_basin_rules; ended(i) /= 0: motion i
!! reached its end. Orbits are shown by motions counted from 0.
subroutine basin_orbits(largest, points, ended, width, n_points, n, most, near, fastest, scale, &
                        labels, periods, moved, shown, n_orbits)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_basin_rules, only: find_orbits
  implicit none
  integer(c_int), intent(in) :: width, n_points, n, ended(n), most
  real(c_double), intent(in) :: largest(width), points(width, n_points, n), near, fastest
  real(c_double), intent(out) :: scale(width), moved(n)
  integer(c_int), intent(out) :: labels(n), periods(n), shown(n), n_orbits
  !f2py threadsafe
  shown = 0
  call find_orbits(largest, points, ended /= 0, most, near, fastest, scale, labels, periods, &
                   moved, shown, n_orbits)
  shown = shown - 1
end subroutine basin_orbits

!> By what orbits are disturbed, of the scale, a column a motion.
subroutine basin_disturbances(near, width, n, pushes)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_basin_rules, only: disturbances
  implicit none
  integer(c_int), intent(in) :: width, n
  real(c_double), intent(in) :: near
  real(c_double), intent(out) :: pushes(width, n)
  !f2py threadsafe
  call disturbances(near, pushes)
end subroutine basin_disturbances

!> True if an orbit attracts, by the ends of perturbed motions; the remaining part of these.
subroutine basin_judge(ends, ended, width, n, orbit, period, scale, near, of_starts, has_kernels, &
                       attracts, rest)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_basin_rules, only: judge_orbit
  implicit none
  integer(c_int), intent(in) :: width, n, ended(n), period, of_starts, has_kernels
  real(c_double), intent(in) :: ends(width, n), orbit(width, period), scale(width), near
  integer(c_int), intent(out) :: attracts
  real(c_double), intent(out) :: rest
  logical :: good
  !f2py threadsafe
  call judge_orbit(ends, ended /= 0, orbit, scale, near, of_starts /= 0, has_kernels /= 0, good, &
                   rest)
  attracts = merge(1, 0, good)
end subroutine basin_judge
