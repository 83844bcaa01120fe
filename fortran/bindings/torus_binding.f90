! Flat routines over the angles of a driven motion, for f2py.

!> Base frequencies of the loads, named(i) the load whose frequency one is, 0: of several;
!! which axis varies, and its multiple that the frequency is. varies: 1 to 3 a frequency, 4 to 6
!! an amplitude, 7 all frequencies together, 0 nothing.
subroutine sort_torus(frequency, amplitude, varies, subharmonic, max_denominator, n_axes, base, &
                      drive_orders, named, axis, multiple, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: report
  use viscovib_drive_torus, only: drive_torus_type, sort_drives
  use viscovib_status, only: status_type
  implicit none
  real(c_double), intent(in) :: frequency(3), amplitude(3)
  integer(c_int), intent(in) :: varies, subharmonic, max_denominator
  integer(c_int), intent(out) :: n_axes, drive_orders(3, 3), named(3), axis, multiple, status
  real(c_double), intent(out) :: base(3)
  type(drive_torus_type) :: torus
  type(status_type) :: problem

  base = 0.0_c_double
  drive_orders = 0
  named = 0
  call sort_drives(torus, frequency, amplitude, varies, subharmonic, max_denominator, problem)
  n_axes = torus%n_axes
  axis = torus%axis
  multiple = torus%multiple
  if (.not. problem%failed()) then
    base(:n_axes) = torus%base
    drive_orders(:n_axes, :) = torus%orders
    named(:n_axes) = torus%named
  end if
  call report(problem, status)
end subroutine sort_torus

!> Largest bound of a lattice of orders, if a share of its unknowns is kept and they need a
!! matrix or not (0).
subroutine lattice_bound(n_axes, share, matrix, bound)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_drive_torus, only: largest_bound, max_unknowns, max_without_matrix
  implicit none
  integer(c_int), intent(in) :: n_axes, matrix
  real(c_double), intent(in) :: share
  integer(c_int), intent(out) :: bound
  bound = largest_bound(n_axes, share, merge(max_unknowns, max_without_matrix, matrix /= 0))
end subroutine lattice_bound

!> Highest orders that a branch must keep for its loads, and does by default.
subroutine lattice_default(drive_orders, n_axes, lowest, bound)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_drive_torus, only: default_bound, drive_torus_type, lowest_bound
  implicit none
  integer(c_int), intent(in) :: n_axes
  integer(c_int), intent(in) :: drive_orders(n_axes, 3)
  integer(c_int), intent(out) :: lowest, bound
  type(drive_torus_type) :: torus
  torus%n_axes = n_axes
  torus%orders = drive_orders
  lowest = lowest_bound(torus)
  bound = default_bound(torus)
end subroutine lattice_default

!> Half of the orders of a lattice, 0 first; if there is no room for them, their number alone.
subroutine lattice_orders(n_axes, bound, max_orders, orders, n_orders)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_drive_torus, only: lattice
  implicit none
  integer(c_int), intent(in) :: n_axes, bound, max_orders
  integer(c_int), intent(out) :: orders(n_axes, max_orders), n_orders
  integer, allocatable :: found(:, :)
  allocate (found, source=lattice(n_axes, bound))
  n_orders = size(found, 2)
  orders = 0
  if (n_orders <= max_orders) orders(:, :n_orders) = found
end subroutine lattice_orders

!> 1 where an order of a coordinate is an unknown of the motion raised from rest.
subroutine lattice_kept(drive_orders, n_axes, orders, n_orders, amplitude, varies, kept)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_drive_torus, only: drive_torus_type, kept_by_symmetry
  implicit none
  integer(c_int), intent(in) :: n_axes, n_orders, varies
  integer(c_int), intent(in) :: drive_orders(n_axes, 3), orders(n_axes, n_orders)
  real(c_double), intent(in) :: amplitude(3)
  integer(c_int), intent(out) :: kept(n_orders, 3)
  type(drive_torus_type) :: torus
  torus%n_axes = n_axes
  torus%orders = drive_orders
  kept = merge(1, 0, kept_by_symmetry(torus, orders, amplitude, varies))
end subroutine lattice_kept
