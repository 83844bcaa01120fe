! Flat routine over what samples leave of error in periodic motions, for f2py. System, load and
! what varies are given as in branch_binding.

!> Relative errors of motions by the samples of their forces: n of them at p, of harmonics relative
!! to the base, of which the first n_used(i) are kept; -1 where that is not known. cancel(1) /= 0,
!! perhaps set by another thread, gives up.
subroutine sampling_errors(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, orders, &
                           series, n_rows, n_series, parameter, direction, n_direction, nu, kept, &
                           n_kept, p, samples, n, n_used, cancel, errors, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_load, make_system, report
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: vary_frequency, vary_load
  use viscovib_sampling_error, only: sampling_judge
  use viscovib_status, only: status_type
  use viscovib_stopping, only: is_set
  use viscovib_vector_builder, only: vector_at
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_rows, n_series, n, n_kept
  integer(c_int), intent(in) :: orders(n_series), parameter, kept(n_kept), n_direction, n_used(n)
  real(c_double), intent(in) :: flat(n_flat), direction(n_direction), data_x(n_x)
  real(c_double), intent(in) :: data_phi(n_phi), nu, p(n)
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  complex(c_double_complex), intent(in) :: samples(n_kept, n_rows - 1, n)
  integer(c_int), intent(inout) :: cancel(1)
  real(c_double), intent(out) :: errors(n)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  class(oscillator_type), allocatable :: system
  type(load_type) :: load
  type(sampling_judge) :: judge
  type(status_type) :: outcome
  real(c_double), allocatable :: x(:, :)
  real(c_double) :: at, factor
  integer :: i, m

  errors = -1.0_c_double
  call make_load(load, orders, series, outcome)
  ! What varies may have no value in the vector: it is made anew at each motion.
  if (.not. outcome%failed() .and. parameter <= vary_load) then
    call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  end if
  do i = 1, n
    if (outcome%failed()) exit
    if (is_set(cancel(1))) exit
    at = nu
    factor = 1.0_c_double
    if (parameter == vary_frequency) at = p(i)
    if (parameter == vary_load) factor = p(i)
    if (parameter > vary_load) then
      call make_system(system, vector_at(flat, direction, p(i)), kind_x, data_x, kind_phi, &
                       data_phi, outcome)
      if (outcome%failed()) exit
      call judge%forget()
    end if
    m = n_used(i)
    if (m == 0) cycle
    allocate (x(2*m, n_rows - 1))
    x(1::2, :) = real(samples(:m, :, i))
    x(2::2, :) = aimag(samples(:m, :, i))
    call judge%error_of(system, load, at, factor, kept(1) > 0, x, errors(i))
    deallocate (x)
  end do
  call report(outcome, status)
end subroutine sampling_errors

!> Relative errors of motions at frequencies `nu` as solutions of their equations, or of those next
!! to rest: n of harmonics relative to the base, of which the first n_used(i) are kept; -1 where
!! that is not known. cancel(1) /= 0, perhaps set by another thread, gives up.
subroutine rounding_errors(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, orders, &
                           series, n_rows, n_series, linear, kept, n_kept, nu, motions, n, &
                           n_used, cancel, errors, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_load, make_system, report
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_rounding_error, only: rounding_judge
  use viscovib_status, only: status_type
  use viscovib_stopping, only: is_set
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_rows, n_series, n, n_kept
  integer(c_int), intent(in) :: orders(n_series), linear, kept(n_kept), n_used(n)
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi), nu(n)
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  complex(c_double_complex), intent(in) :: motions(n_kept, n_rows - 1, n)
  integer(c_int), intent(inout) :: cancel(1)
  real(c_double), intent(out) :: errors(n)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  class(oscillator_type), allocatable :: system
  type(load_type) :: load
  type(rounding_judge) :: judge
  type(status_type) :: outcome
  real(c_double), allocatable :: x(:, :)
  integer :: i, m

  errors = -1.0_c_double
  call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  end if
  do i = 1, n
    if (outcome%failed()) exit
    if (is_set(cancel(1))) exit
    m = n_used(i)
    if (m == 0) cycle
    allocate (x(2*m, n_rows - 1))
    x(1::2, :) = real(motions(:m, :, i))
    x(2::2, :) = aimag(motions(:m, :, i))
    call judge%error_of(system, load, nu(i), kept(1) > 0, linear /= 0, x, errors(i))
    deallocate (x)
  end do
  call report(outcome, status)
end subroutine rounding_errors

!> Energy lost in a period (J) by motions of a system at frequencies `nu` and factors of its load,
!! shape (n): harmonics relative to the base; NaN where it is not known.
subroutine motion_losses(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, orders, &
                         series, n_rows, n_series, kept, n_kept, nu, factor, highest, linear, &
                         motions, n, lost, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_load, make_system, report
  use viscovib_load, only: load_type
  use viscovib_motion_checks, only: losses_of
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_rows, n_series, n, n_kept
  integer(c_int), intent(in) :: orders(n_series), kept(n_kept), highest(n), linear
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi), nu(n), factor(n)
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  complex(c_double_complex), intent(in) :: motions(n_kept, n_rows - 1, n)
  real(c_double), intent(out) :: lost(n)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  class(oscillator_type), allocatable :: system
  type(load_type) :: load
  type(status_type) :: outcome

  lost = 0.0_c_double
  call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  end if
  if (.not. outcome%failed()) then
    call losses_of(system, load, kept, nu, factor, highest, linear /= 0, motions, lost)
  end if
  call report(outcome, status)
end subroutine motion_losses
