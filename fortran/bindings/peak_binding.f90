! Flat routines over the largest size of a harmonic along branches and between sampled
! motions, for f2py. System, load and what varies are given as in branch_binding, motions by
! their absolute harmonics.

!> The largest size of harmonic `place` (in kept) of coordinate `dof`, both from 1: at one of
!! the motions at p, ascending, or at a summit between two of them (found = 1); of a single
!! motion, the summit that the branch leads up to from it between low and high. With wide = 0
!! only next to the largest motion. peak_x are the harmonics at a single motion's summit.
subroutine mount_peak(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, orders, &
                      series, n_rows, n_series, parameter, direction, n_direction, nu, kept, &
                      n_kept, keep_idle, tolerance, p, samples, n, dof, place, low, high, wide, &
                      cancel, &
                      peak_p, peak_size, found, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_load, make_system, report
  use viscovib_curve_peak, only: climb, harmonic_measure
  use viscovib_family_curve, only: new_family_curve, new_plain_curve, system_builder
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: oscillator_curve_type, vary_load
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: moved_coordinates, reduce
  use viscovib_sampled_peak, only: peak_of_samples
  use viscovib_status, only: status_type
  use viscovib_vector_builder, only: vector_at, vector_builder
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_rows, n_series, n, n_kept
  integer(c_int), intent(in) :: orders(n_series), parameter, kept(n_kept), keep_idle, dof, place
  integer(c_int), intent(in) :: wide, n_direction
  real(c_double), intent(in) :: flat(n_flat), direction(n_direction), data_x(n_x)
  real(c_double), intent(in) :: data_phi(n_phi)
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  complex(c_double_complex), intent(in) :: samples(n_kept, n_rows - 1, n)
  real(c_double), intent(in) :: nu, tolerance, p(n), low, high
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  real(c_double), intent(out) :: peak_p, peak_size
  integer(c_int), intent(out) :: found, status
  !f2py threadsafe
  class(oscillator_type), allocatable, target :: system
  type(load_type), target :: load, part
  type(polynomial_type), target :: reduced
  class(oscillator_curve_type), allocatable :: curve
  class(system_builder), allocatable :: builder
  type(harmonic_set_type) :: set
  type(harmonic_measure) :: measure
  type(status_type) :: outcome
  real(c_double), allocatable :: x(:, :)
  logical :: moved(n_rows - 1), summit
  integer :: i, d, row

  peak_p = 0.0_c_double
  peak_size = -1.0_c_double
  found = 0
  moved = .true.
  if (parameter > vary_load) then
    call make_system(system, vector_at(flat, direction, p(1)), kind_x, data_x, kind_phi, &
                     data_phi, outcome)
  else
    call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  end if
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    call new_harmonic_set(set, int(kept(n_kept)), kept(1) > 0, system%degree)
    moved = moved_coordinates(system, load%drives(system) .or. keep_idle /= 0)
    if (parameter > vary_load) then
      moved = .true.
      allocate (builder, source=vector_builder(flat, direction, data_x, data_phi, kind_x, kind_phi))
      call new_family_curve(curve, builder, p(1), max(abs(low), abs(high)), load, set, nu, outcome)
    else if (all(moved)) then
      call new_plain_curve(curve, system, load, set, int(parameter), nu)
    else
      call reduce(system, moved, reduced)
      call load%take_part(moved, part)
      call new_plain_curve(curve, reduced, part, set, int(parameter), nu)
    end if
  end if
  if (.not. outcome%failed() .and. moved(dof)) then
    allocate (x(2*n_kept*count(moved), n))
    row = 0
    do d = 1, n_rows - 1
      if (.not. moved(d)) cycle
      do i = 1, n
        x(row + 1:row + 2*n_kept:2, i) = real(samples(:, d, i))
        x(row + 2:row + 2*n_kept:2, i) = aimag(samples(:, d, i))
      end do
      call take_base_motion(d, row)
      if (d == dof) measure%place = row + 2*place - [1, 0]
      row = row + 2*n_kept
    end do
    if (n == 1) then
      peak_p = p(1)
      call climb(curve, measure, tolerance, low, high, x(:, 1), peak_p, summit, cancel(1))
      peak_size = measure%size_at(x(:, 1), peak_p)
    else
      call peak_of_samples(curve, measure, tolerance, p, x, wide /= 0, peak_p, peak_size, summit, &
                           cancel(1))
    end if
    found = merge(1, 0, summit)
  end if
  call report(outcome, status)

contains

  !> The motion relative to the base, and what the harmonic measured has besides.
  subroutine take_base_motion(coordinate, first)
    integer, intent(in) :: coordinate, first
    complex(c_double_complex) :: base, shift(system%n_dof())
    real(c_double) :: factor(n)
    integer :: j, k

    factor = 1.0_c_double
    if (parameter == vary_load) factor = p
    do j = 1, size(load%orders)
      k = findloc(kept, load%orders(j), 1)
      if (k == 0) cycle
      shift = load%shift(system, j)
      base = shift(coordinate)
      x(first + 2*k - 1, :) = x(first + 2*k - 1, :) - factor*real(base)
      x(first + 2*k, :) = x(first + 2*k, :) - factor*aimag(base)
      if (coordinate /= dof .or. k /= place) cycle
      if (parameter == vary_load) then
        measure%offset_by_p = [real(base), aimag(base)]
      else
        measure%offset = [real(base), aimag(base)]
      end if
    end do
  end subroutine take_base_motion

end subroutine mount_peak

!> The summit of order `place` (from 1) of coordinate `dof` that the branch of the pendulum leads
!! up to from the solution (x, p) between low and high, as in driven_binding.
subroutine pendulum_peak(flat, orders, n_axes, n_orders, kept, drive_orders, omega, amplitude, &
                         vary, which, p, x, n_unknowns, tolerance, dof, place, low, high, cancel, &
                         peak_p, peak_size, found, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_curve_peak, only: climb, harmonic_measure
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  use viscovib_torus, only: new_torus, torus_type
  use viscovib_torus_balance, only: new_torus_balance, torus_balance_type, vary_frequency
  implicit none
  integer(c_int), intent(in) :: n_axes, n_orders, n_unknowns, dof, place
  integer(c_int), intent(in) :: orders(n_axes, n_orders), drive_orders(n_axes, 3), vary, which
  integer(c_int), intent(in) :: kept(n_orders, 3)
  real(c_double), intent(in) :: flat(14), omega(n_axes), amplitude(3), p, x(n_unknowns), tolerance
  real(c_double), intent(in) :: low, high
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  real(c_double), intent(out) :: peak_p, peak_size
  integer(c_int), intent(out) :: found, status
  !f2py threadsafe
  type(pendulum_type), target :: system
  type(torus_type) :: torus
  type(torus_balance_type) :: balance
  type(harmonic_measure) :: measure
  type(status_type) :: problem
  real(c_double), allocatable :: at(:)
  logical :: summit
  integer :: first

  peak_p = p
  peak_size = -1.0_c_double
  found = 0
  call make_pendulum(system, flat, problem)
  if (.not. problem%failed()) call new_torus(torus, orders, problem)
  if (.not. problem%failed()) then
    call new_torus_balance(balance, system, torus, drive_orders, omega, amplitude, kept /= 0)
    balance%vary = vary
    balance%which = which
    if (vary == vary_frequency) balance%lowest = 0.0_c_double
    at = balance%reduced(x)
    ! The mean is one unknown, the other orders two.
    first = (dof - 1)*torus%n + max(1, 2*place - 2)
    measure%place = [row_of(first), row_of(min(first + 1, dof*torus%n))]
    if (place > 1 .and. all(measure%place > 0)) then
      call climb(balance, measure, tolerance, low, high, at, peak_p, summit, cancel(1))
      peak_size = measure%size_at(at, peak_p)
      found = merge(1, 0, summit)
    end if
  end if
  call report(problem, status)

contains

  !> Where an unknown of all is among those kept; 0: it is not.
  integer function row_of(j)
    integer, intent(in) :: j
    real(c_double) :: one(n_unknowns)
    one = 0.0_c_double
    one(j) = 1.0_c_double
    row_of = findloc(balance%reduced(one) > 0.5_c_double, .true., 1)
  end function row_of

end subroutine pendulum_peak
