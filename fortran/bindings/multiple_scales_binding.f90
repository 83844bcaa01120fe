! Flat routines of the method of multiple scales, for f2py. A system is the vector
! described in `viscovib_packed_form` with the numbers of the system itself and two kernels;
! nothing is kept between calls.

!> The pendulum as such a vector.
subroutine pendulum_form(flat, ordering, max_length, packed, length, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_packed_form, only: pack_form
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_form, only: new_pendulum_form
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: status_type
  implicit none
  real(c_double), intent(in) :: flat(14)
  integer(c_int), intent(in) :: ordering, max_length
  real(c_double), intent(out) :: packed(max_length)
  integer(c_int), intent(out) :: length, status
  !f2py threadsafe
  type(pendulum_type) :: system
  type(polynomial_form_type) :: form
  type(status_type) :: outcome
  real(c_double), allocatable :: numbers(:)

  packed = 0.0_c_double
  length = 0
  call make_pendulum(system, flat, outcome)
  if (.not. outcome%failed()) call new_pendulum_form(form, system, ordering, outcome)
  if (.not. outcome%failed()) then
    call pack_form(form, numbers)
    length = min(size(numbers), max_length)
    packed(:length) = numbers(:length)
  end if
  call report(outcome, status)
end subroutine pendulum_form

!> A mount or a polynomial system as such a vector; one load, cosine.
subroutine oscillator_form(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, load, &
                           n_dof, nu, max_length, packed, length, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_system, report
  use viscovib_oscillator, only: oscillator_type
  use viscovib_packed_form, only: pack_form
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: status_type
  use viscovib_system_form, only: new_oscillator_form
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_dof, max_length
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi), load(n_dof), nu
  real(c_double), intent(out) :: packed(max_length)
  integer(c_int), intent(out) :: length, status
  !f2py threadsafe
  class(oscillator_type), allocatable :: system
  type(polynomial_form_type) :: form
  type(status_type) :: outcome
  real(c_double), allocatable :: numbers(:)

  packed = 0.0_c_double
  length = 0
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) call new_oscillator_form(form, system, load, nu, outcome)
  if (.not. outcome%failed()) then
    call pack_form(form, numbers)
    length = size(numbers)
    packed(:min(length, max_length)) = numbers(:min(length, max_length))
  end if
  call report(outcome, status)
end subroutine oscillator_form

!> Modes, interaction and the terms of the modulation equations; n_terms may exceed the room.
subroutine scales_form(packed, n_packed, flat, n_flat, kind_x, data_x, n_x, kind_phi, &
                       data_phi, n_phi, &
                       tolerance, n_modes, n_unknowns, max_terms, exponents, shapes, &
                       interaction, frame, units, autonomous, n_terms, terms, coefficients, &
                       status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: report
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales
  use viscovib_scales_tools, only: make_form
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_packed, n_flat, kind_x, n_x, kind_phi, n_phi, n_modes, n_unknowns
  integer(c_int), intent(in) :: max_terms
  real(c_double), intent(in) :: packed(n_packed), flat(n_flat)
  real(c_double), intent(in) :: data_x(n_x), data_phi(n_phi), tolerance
  complex(c_double_complex), intent(out) :: exponents(n_modes), shapes(n_unknowns, n_modes)
  complex(c_double_complex), intent(out) :: interaction(n_modes, n_modes), coefficients(max_terms)
  real(c_double), intent(out) :: frame(n_modes), units(n_unknowns)
  integer(c_int), intent(out) :: autonomous, n_terms, terms(7, max_terms), status
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
  units = 0.0_c_double
  autonomous = 0
  n_terms = 0
  terms = 0
  call make_form(packed, flat, kind_x, data_x, kind_phi, data_phi, form, outcome)
  if (.not. outcome%failed()) call new_multiple_scales(scales, form, tolerance, .false., outcome)
  if (.not. outcome%failed()) then
    exponents = scales%flow%s
    shapes = scales%shapes()
    interaction = scales%interaction()
    frame = scales%flow%frame
    units = scales%units
    autonomous = merge(1, 0, scales%flow%autonomous)
    n_terms = size(scales%flow%terms)
    do i = 1, min(n_terms, max_terms)
      associate (t => scales%flow%terms(i))
        terms(:, i) = [t%row, t%at, t%loads]
        coefficients(i) = scales%coefficient(i)
      end associate
    end do
  end if
  call report(outcome, status)
end subroutine scales_form

!> Amplitudes at times, and the motion that belongs to them. `start` holds the amplitudes at
!! time 0 (given = 1), or they are found from the state (q, v) (given = 0).
subroutine scales_motion(packed, n_packed, flat, n_flat, kind_x, data_x, n_x, kind_phi, &
                         data_phi, n_phi, &
                         tolerance, n_modes, given, start, state, times, n, accuracy, max_steps, &
                         cancel, amplitudes, first, motion, sizes, frame, expected, n_reached, &
                         n_steps, outcome_of, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: report
  use viscovib_modulation, only: modulate
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_resonant_terms, only: wants_more
  use viscovib_scales_motion, only: amplitudes_of_state, motion_at
  use viscovib_scales_tools, only: make_form
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_packed, n_flat, kind_x, n_x, kind_phi, n_phi, n_modes, given, n
  integer(c_int), intent(in) :: max_steps
  real(c_double), intent(in) :: packed(n_packed), flat(n_flat)
  real(c_double), intent(in) :: data_x(n_x), data_phi(n_phi), tolerance
  complex(c_double_complex), intent(in) :: start(n_modes)
  real(c_double), intent(in) :: state(n_modes, 2), times(n), accuracy
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  complex(c_double_complex), intent(out) :: amplitudes(n_modes, n), first(n_modes)
  real(c_double), intent(out) :: motion(n_modes, 2, n), sizes(4, n), frame(n_modes)
  !> Amplitudes that resonances were chosen for, in natural units: `scales_errors` needs them.
  real(c_double), intent(out) :: expected(n_modes)
  integer(c_int), intent(out) :: n_reached, n_steps, outcome_of, status
  !f2py threadsafe
  type(polynomial_form_type) :: form
  type(multiple_scales_type) :: scales
  type(status_type) :: outcome
  integer, parameter :: max_rounds = 4
  complex(c_double_complex) :: a(n_modes), before(n_modes)
  integer :: i, round

  amplitudes = (0.0_c_double, 0.0_c_double)
  first = (0.0_c_double, 0.0_c_double)
  motion = 0.0_c_double
  sizes = 0.0_c_double
  frame = 0.0_c_double
  n_reached = 0
  n_steps = 0
  outcome_of = 0
  call make_form(packed, flat, kind_x, data_x, kind_phi, data_phi, form, outcome)
  expected = 0.0_c_double
  before = (0.0_c_double, 0.0_c_double)
  do round = 1, max_rounds
    if (outcome%failed()) exit
    call new_multiple_scales(scales, form, tolerance, .false., outcome, sizes=expected)
    if (outcome%failed()) exit
    frame = scales%flow%frame
    a = start/scales%amplitude_units
    if (given == 0) call amplitudes_of_state(scales, state(:, 1), state(:, 2), a, outcome)
    if (outcome%failed() .or. .not. scales%normal%choosing) exit
    if (round == 1 .and. .not. wants_more(scales%normal, abs(a))) exit
    ! What resonates is chosen for the amplitudes that follow: the same ones choose the same.
    if (round > 1 .and. .not. any(abs(a - before) > 0.0_c_double)) exit
    if (round == max_rounds) exit
    before = a
    expected = abs(a)
  end do
  if (.not. outcome%failed()) then
    first = a*scales%amplitude_units
    call modulate(scales%flow, a, times, accuracy, max_steps, amplitudes, n_reached, n_steps, &
                  outcome_of, cancel(1))
    do i = 1, n_reached
      call motion_at(scales, times(i), amplitudes(:, i), motion(:, 1, i), motion(:, 2, i), &
                     sizes(:, i))
      amplitudes(:, i) = amplitudes(:, i)*scales%amplitude_units
    end do
  end if
  call report(outcome, status)
end subroutine scales_motion

!> Errors of a motion at times, from the amplitudes there: `scales_motion` gave them.
subroutine scales_errors(packed, n_packed, flat, n_flat, kind_x, data_x, n_x, kind_phi, &
                         data_phi, n_phi, &
                         tolerance, n_modes, n_dof, times, n, amplitudes, expected, cancel, &
                         errors, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: report
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_scales_error, only: motion_errors
  use viscovib_scales_tools, only: make_form
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_packed, n_flat, kind_x, n_x, kind_phi, n_phi, n_modes, n_dof, n
  real(c_double), intent(in) :: packed(n_packed), flat(n_flat)
  real(c_double), intent(in) :: data_x(n_x), data_phi(n_phi), tolerance
  real(c_double), intent(in) :: times(n), expected(n_modes)
  complex(c_double_complex), intent(in) :: amplitudes(n_modes, n)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  real(c_double), intent(out) :: errors(n_dof, n)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  type(polynomial_form_type) :: form
  type(multiple_scales_type) :: scales
  type(status_type) :: outcome

  errors = 0.0_c_double
  call make_form(packed, flat, kind_x, data_x, kind_phi, data_phi, form, outcome)
  if (.not. outcome%failed()) call new_multiple_scales(scales, form, tolerance, .false., outcome, &
                                                            sizes=expected)
  if (.not. outcome%failed()) then
    call motion_errors(scales, form%full, times, &
                       amplitudes/spread(scales%amplitude_units, 2, n), errors, cancel(1))
  end if
  call report(outcome, status)
end subroutine scales_errors

!> Steady motions for values of the frequency (vary = 1) or the amplitude (vary = 2) of a load.
subroutine scales_response(packed, n_packed, flat, n_flat, kind_x, data_x, n_x, kind_phi, &
                           data_phi, n_phi, &
                           tolerance, load, vary, values, n, with_errors, n_modes, n_dof, &
                           max_points, max_lines, cancel, n_points, which, amplitudes, frames, &
                           eigenvalues, harmonics, sizes, left_out, resting, harmonic_errors, &
                           motion_errors, growth_errors, beats, n_lines, line_of, &
                           line_frequencies, lines, may_lack, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: report
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_scales_response, only: response_along, steady_points_type
  use viscovib_scales_tools, only: make_form
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_packed, n_flat, kind_x, n_x, kind_phi, n_phi, load, vary, n
  integer(c_int), intent(in) :: n_modes, n_dof, max_points, max_lines, with_errors
  real(c_double), intent(in) :: packed(n_packed), flat(n_flat)
  real(c_double), intent(in) :: data_x(n_x), data_phi(n_phi), tolerance, values(n)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(out) :: n_points, which(max_points), status
  complex(c_double_complex), intent(out) :: amplitudes(n_modes, max_points)
  complex(c_double_complex), intent(out) :: eigenvalues(2*n_modes, max_points)
  complex(c_double_complex), intent(out) :: harmonics(n_dof, max_points)
  real(c_double), intent(out) :: frames(n_modes, max_points), sizes(4, max_points)
  real(c_double), intent(out) :: left_out(max_points), resting(max_points)
  real(c_double), intent(out) :: harmonic_errors(n_dof, max_points), &
                                 motion_errors(n_dof, max_points), growth_errors(max_points)
  !> Of motions that beat: how many beats, and their lines, each with the point it belongs to.
  integer(c_int), intent(out) :: beats(max_points), n_lines, line_of(max_lines)
  real(c_double), intent(out) :: line_frequencies(max_lines)
  complex(c_double_complex), intent(out) :: lines(n_dof, max_lines)
  !> 1: a motion may be missing at this value.
  integer(c_int), intent(out) :: may_lack(n)
  !f2py threadsafe
  type(polynomial_form_type) :: form
  type(steady_points_type) :: points
  type(status_type) :: outcome
  integer :: m

  n_points = 0
  n_lines = 0
  call make_form(packed, flat, kind_x, data_x, kind_phi, data_phi, form, outcome)
  if (.not. outcome%failed()) then
    call response_along(form, load, vary, values, tolerance, with_errors /= 0, points, outcome, &
                        cancel(1))
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
    left_out(:m) = points%left_out(:m)
    resting(:m) = points%resting(:m)
    beats(:m) = points%beats(:m)
    n_lines = size(points%line_of)
    may_lack = merge(1, 0, points%may_lack)
    m = min(n_lines, max_lines)
    line_of(:m) = points%line_of(:m)
    line_frequencies(:m) = points%line_frequency(:m)
    lines(:, :m) = points%line(:, :m)
    m = min(n_points, max_points)
    if (with_errors /= 0) then
      harmonic_errors(:, :m) = points%harmonic_errors(:, :m)
      motion_errors(:, :m) = points%motion_errors(:, :m)
      growth_errors(:m) = points%growth_errors(:m)
    end if
  end if
  call report(outcome, status)
end subroutine scales_response

!> All conditions of resonance up to third order; n may exceed the room.
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
