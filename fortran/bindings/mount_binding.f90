! Flat routines over the mount, for f2py. A mount is the vector described in
! `viscovib_binding_tools` and two kernels; nothing is kept between calls. Plan and
! response also take a polynomial system: kind_x = -2 and the vector described in
! `viscovib_system_vector`, which holds its kernels.

!> Undamped natural frequencies (rad/s) and mode shapes (columns).
subroutine mount_modes(mount, omega, shapes, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_mount, report
  use viscovib_mount, only: mount_type
  use viscovib_status, only: status_type
  implicit none
  real(c_double), intent(in) :: mount(12)
  real(c_double), intent(out) :: omega(2), shapes(2, 2)
  integer(c_int), intent(out) :: status
  type(mount_type) :: system
  type(status_type) :: outcome

  omega = 0.0_c_double
  shapes = 0.0_c_double
  call make_mount(system, mount, 0, [0.0_c_double], 0, [0.0_c_double], outcome)
  if (.not. outcome%failed()) call system%natural_modes(omega, shapes)
  call report(outcome, status)
end subroutine mount_modes

!> Dynamic stiffness D(nu), shape (2, 2, n).
subroutine mount_dynamic_stiffness(mount, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, nu, n, &
                                   stiffness, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_mount, report
  use viscovib_mount, only: mount_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind_x, n_x, kind_phi, n_phi, n
  real(c_double), intent(in) :: mount(12), data_x(n_x), data_phi(n_phi), nu(n)
  complex(c_double_complex), intent(out) :: stiffness(2, 2, n)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  type(mount_type) :: system
  type(status_type) :: outcome
  complex(c_double_complex), allocatable :: fraction(:, :)

  call make_mount(system, mount, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) then
    allocate (fraction(n, system%n_memory()))
    call system%retained(nu, fraction)
    call system%dynamic_stiffness(nu, fraction, stiffness)
  end if
  call report(outcome, status)
end subroutine mount_dynamic_stiffness

!> What `mount_response` will do: the orders it keeps, or may keep, and the plan in words.
subroutine mount_plan(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, orders, &
                      series, n_rows, n_series, nu, n, method, harmonics, tolerance, &
                      max_iterations, relaxation, keep_history, with_stability, keep_idle, &
                      n_room, n_kept, kept, half_wave, n_samples, plan_method, text, rest, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_load, make_options, make_system, report
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_order_rules, only: most_along
  use viscovib_response, only: response_options
  use viscovib_response_plan, only: new_response_plan, response_plan_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_rows, n_series, n
  integer(c_int), intent(in) :: orders(n_series), method, harmonics, max_iterations, keep_history
  integer(c_int), intent(in) :: with_stability, keep_idle
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi), nu(n)
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  !> Relative, and absolute in coordinates.
  real(c_double), intent(in) :: tolerance(2), relaxation
  !> Most orders there may be: those of the load, or all up to the highest.
  integer(c_int), intent(in) :: n_room
  integer(c_int), intent(out) :: n_kept, kept(n_room), half_wave, n_samples, plan_method
  !> The plan of the responses, and the lines of it that hold for a branch.
  character(len=2048), intent(out) :: text, rest
  integer(c_int), intent(out) :: status
  class(oscillator_type), allocatable :: system
  type(load_type) :: load
  type(response_plan_type) :: plan
  type(response_options) :: options
  type(status_type) :: outcome
  integer :: k

  n_kept = 0
  kept = 0
  half_wave = 0
  n_samples = 0
  plan_method = 0
  text = ''
  rest = ''
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    options = make_options(harmonics, tolerance, max_iterations, relaxation, keep_history)
    options%stability = with_stability /= 0
    options%keep_idle = keep_idle /= 0
    call new_response_plan(plan, system, load, nu, method, options, outcome)
  end if
  if (.not. outcome%failed()) then
    ! Along a branch fewer may be chosen.
    if (options%keep_idle) plan%most = min(plan%most, most_along(system, load))
    if (plan%chosen) plan%set%orders = [(k, k=merge(1, 0, plan%set%half_wave), plan%most, &
                                         merge(2, 1, plan%set%half_wave))]
    n_kept = size(plan%set%orders)
    kept(:n_kept) = plan%set%orders
    half_wave = merge(1, 0, plan%set%half_wave)
    n_samples = plan%set%n_samples
    plan_method = plan%method
    text = plan%text
    rest = plan%rest
  end if
  call report(outcome, status)
end subroutine mount_plan

!> Forced response at each nu. The load is a Fourier series: column j of
!! `series` (forces on the coordinates, then motion of the base) belongs to orders(j).
subroutine mount_response(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, orders, &
                          series, n_rows, n_series, nu, n, method, harmonics, tolerance, &
                          max_iterations, relaxation, n_history, n_judged, begin, n_begin, &
                          coefficients, n_numbers, cancel, n_kept, outcomes, iterations, rate, &
                          highest, truncation, corrections, stable, multipliers, exponents, &
                          allowed, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: fill_stability, make_load, make_options, make_system, report
  use viscovib_forced_response, only: forced_response
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_response, only: response_options, response_type
  use viscovib_response_plan, only: new_response_plan, response_plan_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_rows, n_series, n
  integer(c_int), intent(in) :: orders(n_series), method, harmonics, max_iterations
  !> Rows of `corrections` (0: history not kept), as the plan says.
  integer(c_int), intent(in) :: n_history
  !> n: judge stability; 0: do not.
  integer(c_int), intent(in) :: n_judged
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi), nu(n)
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  !> Relative, and absolute in coordinates.
  real(c_double), intent(in) :: tolerance(2), relaxation
  !> Where Newton's method begins at the first frequency, relative to the base: unknowns of all
  !! orders that the plan allows; from rest if there is but one number.
  integer(c_int), intent(in) :: n_begin
  real(c_double), intent(in) :: begin(n_begin)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(in) :: n_numbers
  !> Room for all orders that the plan allows; an array of shape (n_kept, n_rows - 1, n)
  !! on return, the rest left alone.
  complex(c_double_complex), intent(inout) :: coefficients(n_numbers)
  integer(c_int), intent(out) :: n_kept, outcomes(n), iterations(n), highest(n)
  real(c_double), intent(out) :: rate(n), truncation(n), corrections(n_history, n)
  !> Relative error that was allowed.
  real(c_double), intent(out) :: allowed(n)
  !> As in `stability_type`, NaN where there are none.
  integer(c_int), intent(out) :: stable(n_judged)
  complex(c_double_complex), intent(out) :: multipliers(2*n_rows + 2, n_judged)
  complex(c_double_complex), intent(out) :: exponents(2*n_rows + 2, n_judged)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  class(oscillator_type), allocatable :: system
  type(load_type) :: load
  type(response_plan_type) :: plan
  type(response_options) :: options
  type(response_type) :: response
  type(status_type) :: outcome
  integer :: i, d, first

  n_kept = 0
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    options = make_options(harmonics, tolerance, max_iterations, relaxation, n_history)
    options%stability = n_judged > 0
    call new_response_plan(plan, system, load, nu, method, options, outcome)
  end if
  if (.not. outcome%failed()) then
    if (n_begin > 1) then
      call forced_response(plan, system, load, nu, response, cancel(1), &
                           reshape(begin, [n_begin/(n_rows - 1), n_rows - 1]))
    else
      call forced_response(plan, system, load, nu, response, cancel(1))
    end if
  end if
  ! Nobody waits for what was given up.
  if (.not. outcome%failed() .and. cancel(1) == 0) then
    n_kept = size(response%orders)
    first = 1
    do i = 1, n
      do d = 1, n_rows - 1
        coefficients(first:first + n_kept - 1) = response%coefficients(:, d, i)
        first = first + n_kept
      end do
    end do
    outcomes = response%outcome
    highest = response%highest
    truncation = response%truncation
    allowed = response%allowed
    iterations = response%iterations
    rate = response%rate
    if (size(response%corrections, 1) == n_history) corrections = response%corrections
    if (n_judged > 0) call fill_stability(response%stability, stable, multipliers, exponents)
  end if
  call report(outcome, status)
end subroutine mount_response

!> Bounds and defaults that Python checks arguments by: highest order, iterations, unknowns, orders
!! of free motions of a pendulum at first and at most; lowest and highest tolerance, the same in
!! time, what stands for 0 where a number varies.
subroutine known_limits(counts, sizes)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_limits, only: max_harmonics, max_time_tolerance, max_tolerance, &
    min_time_tolerance, min_tolerance, nearly_nothing
  use viscovib_free_orders, only: first_free => first_chosen, most_free => highest_chosen
  use viscovib_response_plan, only: max_iterations_allowed, max_unknowns
  implicit none
  integer(c_int), intent(out) :: counts(5)
  real(c_double), intent(out) :: sizes(5)

  counts = [max_harmonics, max_iterations_allowed, max_unknowns, first_free, most_free]
  sizes = [min_tolerance, max_tolerance, min_time_tolerance, max_time_tolerance, &
           nearly_nothing]
end subroutine known_limits
