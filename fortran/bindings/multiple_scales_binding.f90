! Flat routines of the method of multiple scales, for f2py. A system is the vector
! described in `viscovib_packed_form` and two kernels; nothing is kept between calls.

!> The pendulum as such a vector.
subroutine pendulum_form(flat, max_length, packed, length, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_packed_form, only: pack_form
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_form, only: new_pendulum_form
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: status_type
  implicit none
  real(c_double), intent(in) :: flat(14)
  integer(c_int), intent(in) :: max_length
  real(c_double), intent(out) :: packed(max_length)
  integer(c_int), intent(out) :: length, status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  type(pendulum_type) :: system
  type(polynomial_form_type) :: form
  type(status_type) :: outcome
  real(c_double), allocatable :: numbers(:)

  packed = 0.0_c_double
  length = 0
  call make_pendulum(system, flat, outcome)
  if (.not. outcome%failed()) call new_pendulum_form(form, system, outcome)
  if (.not. outcome%failed()) then
    call pack_form(form, numbers)
    length = min(size(numbers), max_length)
    packed(:length) = numbers(:length)
  end if
  call report(outcome, status, message)
end subroutine pendulum_form

!> The mount as such a vector; one load, cosine, force on x and moment on phi.
subroutine mount_form(mount, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, load, nu, max_length, &
                      packed, length, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_mount, report
  use viscovib_mount, only: mount_type
  use viscovib_mount_form, only: new_mount_form
  use viscovib_packed_form, only: pack_form
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind_x, n_x, kind_phi, n_phi, max_length
  real(c_double), intent(in) :: mount(12), data_x(n_x), data_phi(n_phi), load(2), nu
  real(c_double), intent(out) :: packed(max_length)
  integer(c_int), intent(out) :: length, status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  type(mount_type) :: system
  type(polynomial_form_type) :: form
  type(status_type) :: outcome
  real(c_double), allocatable :: numbers(:)

  packed = 0.0_c_double
  length = 0
  call make_mount(system, mount, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) then
    call new_mount_form(form, system, load, nu)
    call pack_form(form, numbers)
    length = min(size(numbers), max_length)
    packed(:length) = numbers(:length)
  end if
  call report(outcome, status, message)
end subroutine mount_form

!> Modes, interaction and the terms of the modulation equations.
subroutine scales_form(packed, n_packed, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, &
                       tolerance, n_modes, n_unknowns, max_terms, exponents, shapes, &
                       interaction, frame, autonomous, n_terms, terms, coefficients, status, &
                       message)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: report
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales
  use viscovib_scales_tools, only: make_form
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_packed, kind_x, n_x, kind_phi, n_phi, n_modes, n_unknowns
  integer(c_int), intent(in) :: max_terms
  real(c_double), intent(in) :: packed(n_packed), data_x(n_x), data_phi(n_phi), tolerance
  complex(c_double_complex), intent(out) :: exponents(n_modes), shapes(n_unknowns, n_modes)
  complex(c_double_complex), intent(out) :: interaction(n_modes, n_modes), coefficients(max_terms)
  real(c_double), intent(out) :: frame(n_modes)
  integer(c_int), intent(out) :: autonomous, n_terms, terms(7, max_terms), status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  type(polynomial_form_type) :: form
  type(multiple_scales_type) :: scales
  type(status_type) :: outcome
  integer :: i

  exponents = (0.0_c_double, 0.0_c_double)
  shapes = (0.0_c_double, 0.0_c_double)
  interaction = (0.0_c_double, 0.0_c_double)
  coefficients = (0.0_c_double, 0.0_c_double)
  frame = 0.0_c_double
  autonomous = 0
  n_terms = 0
  terms = 0
  call make_form(packed, kind_x, data_x, kind_phi, data_phi, form, outcome)
  if (.not. outcome%failed()) call new_multiple_scales(scales, form, tolerance, .false., outcome)
  if (.not. outcome%failed()) then
    exponents = scales%flow%s
    shapes = scales%normal%right(:, :n_modes)
    interaction = scales%interaction()
    frame = scales%flow%frame
    autonomous = merge(1, 0, scales%flow%autonomous)
    n_terms = min(size(scales%flow%terms), max_terms)
    do i = 1, n_terms
      associate (t => scales%flow%terms(i))
        terms(:, i) = [t%row, t%at, t%loads]
        coefficients(i) = t%coefficient
      end associate
    end do
  end if
  call report(outcome, status, message)
end subroutine scales_form

!> Amplitudes at times, and the motion that belongs to them. `start` holds the amplitudes at
!! time 0 (given = 1), or they are found from the state (q, v) (given = 0).
subroutine scales_motion(packed, n_packed, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, &
                         tolerance, n_modes, given, start, state, times, n, accuracy, max_steps, &
                         cancel, amplitudes, motion, sizes, frame, n_reached, n_steps, outcome_of, &
                         status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: report
  use viscovib_modulation, only: modulate
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_scales_motion, only: amplitudes_of_state, motion_at
  use viscovib_scales_tools, only: make_form
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_packed, kind_x, n_x, kind_phi, n_phi, n_modes, given, n, max_steps
  real(c_double), intent(in) :: packed(n_packed), data_x(n_x), data_phi(n_phi), tolerance
  complex(c_double_complex), intent(in) :: start(n_modes)
  real(c_double), intent(in) :: state(n_modes, 2), times(n), accuracy
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  complex(c_double_complex), intent(out) :: amplitudes(n_modes, n)
  real(c_double), intent(out) :: motion(n_modes, 2, n), sizes(3, n), frame(n_modes)
  integer(c_int), intent(out) :: n_reached, n_steps, outcome_of, status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  type(polynomial_form_type) :: form
  type(multiple_scales_type) :: scales
  type(status_type) :: outcome
  complex(c_double_complex) :: a(n_modes)
  integer :: i

  amplitudes = (0.0_c_double, 0.0_c_double)
  motion = 0.0_c_double
  sizes = 0.0_c_double
  frame = 0.0_c_double
  n_reached = 0
  n_steps = 0
  outcome_of = 0
  call make_form(packed, kind_x, data_x, kind_phi, data_phi, form, outcome)
  if (.not. outcome%failed()) call new_multiple_scales(scales, form, tolerance, .false., outcome)
  if (.not. outcome%failed()) then
    frame = scales%flow%frame
    a = start
    if (given == 0) call amplitudes_of_state(scales, form, state(:, 1), state(:, 2), a, outcome)
  end if
  if (.not. outcome%failed()) then
    call modulate(scales%flow, a, times, accuracy, max_steps, amplitudes, n_reached, n_steps, &
                  outcome_of, cancel(1))
    do i = 1, n_reached
      call motion_at(scales, form, times(i), amplitudes(:, i), motion(:, 1, i), motion(:, 2, i), &
                     sizes(:, i))
    end do
  end if
  call report(outcome, status, message)
end subroutine scales_motion

!> Steady motions for values of the frequency (vary = 1) or the amplitude (vary = 2) of a load.
subroutine scales_response(packed, n_packed, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, &
                           tolerance, load, vary, values, n, n_modes, max_points, cancel, &
                           n_points, which, amplitudes, frames, eigenvalues, harmonics, sizes, &
                           status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: report
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_scales_response, only: response_along, steady_points_type
  use viscovib_scales_tools, only: make_form
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_packed, kind_x, n_x, kind_phi, n_phi, load, vary, n, n_modes
  integer(c_int), intent(in) :: max_points
  real(c_double), intent(in) :: packed(n_packed), data_x(n_x), data_phi(n_phi), tolerance, values(n)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(out) :: n_points, which(max_points), status
  complex(c_double_complex), intent(out) :: amplitudes(n_modes, max_points)
  complex(c_double_complex), intent(out) :: eigenvalues(2*n_modes, max_points)
  complex(c_double_complex), intent(out) :: harmonics(n_modes, max_points)
  real(c_double), intent(out) :: frames(n_modes, max_points), sizes(3, max_points)
  character(len=512), intent(out) :: message
  !f2py threadsafe
  type(polynomial_form_type) :: form
  type(steady_points_type) :: points
  type(status_type) :: outcome
  integer :: m

  n_points = 0
  call make_form(packed, kind_x, data_x, kind_phi, data_phi, form, outcome)
  if (.not. outcome%failed()) then
    call response_along(form, load, vary, values, tolerance, points, outcome, cancel(1))
  end if
  if (.not. outcome%failed()) then
    n_points = points%n
    m = min(n_points, max_points)
    which(:m) = points%value(:m)
    amplitudes(:, :m) = points%a(:, :m)
    frames(:, :m) = points%frame(:, :m)
    eigenvalues(:, :m) = points%eigenvalues(:, :m)
    harmonics(:, :m) = points%harmonic(:, :m)
    sizes(:, :m) = points%sizes(:, :m)
  end if
  call report(outcome, status, message)
end subroutine scales_response

!> All conditions of resonance up to third order.
subroutine scales_resonances(natural, n_natural, drives, n_drives, max_found, coefficients, &
                             orders, divisors, n)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_resonances, only: list_resonances
  implicit none
  integer(c_int), intent(in) :: n_natural, n_drives, max_found
  real(c_double), intent(in) :: natural(n_natural), drives(n_drives)
  integer(c_int), intent(out) :: coefficients(n_natural + n_drives, max_found)
  integer(c_int), intent(out) :: orders(max_found), n
  real(c_double), intent(out) :: divisors(max_found)
  !f2py threadsafe
  call list_resonances(natural, drives, coefficients, orders, divisors, n)
end subroutine scales_resonances
