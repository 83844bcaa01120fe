! Flat routines over polynomial systems, for f2py; the vector is described in
! `viscovib_system_vector`. Responses and branches: see mount_binding.

!> Checks everything that makes up a system.
subroutine polynomial_check(flat, n_flat, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: report
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: status_type
  use viscovib_system_vector, only: polynomial_from_vector
  implicit none
  integer(c_int), intent(in) :: n_flat
  real(c_double), intent(in) :: flat(n_flat)
  integer(c_int), intent(out) :: status
  type(polynomial_type) :: system
  type(status_type) :: outcome
  call polynomial_from_vector(system, flat, outcome)
  call report(outcome, status)
end subroutine polynomial_check

!> Motion of a system without memory, or with one of exponentials alone; held, before, moved and
!! base_breaks, base_pieces as in `mount_simulate`; the load and its frequency
!! as in mount_binding, all else as in `pendulum_simulate`, but resume = 2: under other loads,
!! elements remembering; the last numbers of kept: how long the next part of a step may be, whether
!! steps were made in parts, and how many of it are the method's; in_parts /= 0: all steps are made
!! in parts that see thin layers of forces; thin: how thin one may be for a part. moves, breaks,
!! pieces, ends and made_by as in `mount_simulate`, with less than two breaks there is no load but
!! the periodic one; reach: latest time of any run that goes on, for which kernels are fitted.
subroutine polynomial_simulate(flat, n_flat, reach, orders, series, n_rows, n_series, nu, breaks, &
                               pieces, n_breaks, base_breaks, base_pieces, n_waves, n_base, &
                               held, before, moved, n_before, &
                               ends, made_by, n_ends, method, in_parts, thin, &
                               moves, initial, h, tolerance, first, n_steps, save_every, resume, &
                               memory, n_memory, times, n_times, n_columns, watched, n_watch, &
                               sides, n_sides, most, states, at_times, last, kept, n_done, &
                               n_reached, t_reached, ended, n_evaluations, found, n_found, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int, c_long
  use viscovib_binding_tools, only: make_load, report
  use viscovib_load, only: load_type
  use viscovib_mesh, only: mesh_type, new_mesh
  use viscovib_method_catalogue, only: new_stepper
  use viscovib_polynomial, only: polynomial_type
  use viscovib_fitted_memory, only: copy_system
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_hidden_start, only: begin_hidden
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_reduction, only: reduce, state_mask
  use viscovib_simulate, only: simulate
  use viscovib_status, only: status_type
  use viscovib_stepper, only: stepper_type
  use viscovib_system_vector, only: polynomial_from_vector
  use viscovib_watch, only: new_watch, renumbered, watch_type
  implicit none
  integer(c_int), intent(in) :: n_flat, n_rows, n_series, orders(n_series), n_breaks, n_ends
  integer(c_int), intent(in) :: method, in_parts, resume, n_memory, n_times, n_columns
  integer(c_int), intent(in) :: moves(n_rows - 1), n_base, n_before, n_waves
  integer(c_long), intent(in) :: first, n_steps, save_every, made_by(n_ends)
  real(c_double), intent(in) :: breaks(n_breaks), pieces(n_rows - 1, 4, n_breaks), ends(n_ends)
  real(c_double), intent(in) :: flat(n_flat), reach, nu, initial(2*n_rows - 2), h, tolerance, thin
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  real(c_double), intent(in) :: base_breaks(n_base), base_pieces(4, n_waves, n_base)
  real(c_double), intent(in) :: held(n_rows - 1), before(n_before), moved(n_rows - 1, n_before)
  real(c_double), intent(in) :: memory(n_memory), times(n_times)
  real(c_double), intent(out) :: states(2*n_rows - 2, n_columns), at_times(2*n_rows - 2, n_times)
  real(c_double), intent(out) :: kept(n_memory), last(2*n_rows - 2), t_reached
  integer(c_long), intent(out) :: n_done, n_evaluations
  integer(c_int), intent(in) :: n_watch, n_sides, most
  real(c_double), intent(in) :: watched(n_watch)
  integer(c_int), intent(inout) :: sides(n_sides)
  real(c_double), intent(out) :: found(3*n_rows + 1, most)
  integer(c_int), intent(out) :: n_reached, ended, n_found, status
  !f2py threadsafe
  type(polynomial_type) :: system
  type(polynomial_motion_type) :: motion
  type(load_type) :: load
  class(stepper_type), allocatable :: stepper
  type(watch_type) :: watch
  type(status_type) :: outcome
  type(polynomial_type) :: reduced, taken
  type(load_type) :: part
  type(mesh_type) :: mesh
  real(c_double), allocatable :: some_states(:, :), some_at_times(:, :), q(:), v(:)
  real(c_double) :: start
  integer, allocatable :: dofs(:), rows(:)
  integer :: i, n

  kept = 0.0_c_double
  last = initial
  at_times = 0.0_c_double
  n_done = 0
  n_reached = 0
  t_reached = 0.0_c_double
  n_evaluations = 0
  ended = 0
  found = 0.0_c_double
  n_found = 0
  call polynomial_from_vector(system, flat, outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  dofs = pack([(i, i=1, n_rows - 1)], moves /= 0)
  rows = pack([(i, i=1, 2*n_rows - 2)], state_mask(moves /= 0))
  if (.not. outcome%failed()) then
    if (size(dofs) == n_rows - 1) then
      call copy_system(system, reduced)
      part = load
    else
      call reduce(system, moves /= 0, reduced)
      call load%take_part(moves /= 0, part)
    end if
    call new_fitted_motion(motion, reduced, part, nu, h, reach, outcome, taken)
  end if
  if (.not. outcome%failed()) then
    call begin_hidden(motion, reduced, taken, held(dofs), outcome, before, moved(dofs, :))
  end if
  if (.not. outcome%failed()) then
    motion%thin = thin
    motion%in_parts = motion%layers%exist() .and. in_parts /= 0
    if (n_breaks > 1) call motion%add_table(breaks, pieces(dofs, :, :))
    if (n_waves > 1 .and. n_base > 1) then
      call motion%base_motion%add_cubics(size(dofs), [real(wp) ::], base_breaks, &
                                         base_pieces(:, dofs, :))
    else if (n_base > 1) then
      call motion%base_motion%add_cubics(size(dofs), reduced%base_direction, base_breaks, &
                                         base_pieces)
    end if
    call new_mesh(mesh, h, ends, made_by)
    start = 0.0_c_double
    if (first > 0) start = mesh%time(mesh%piece_of(first - 1), first)
    i = mesh%piece_of(first)
    call motion%base_motion%enter(mesh%beginning(i), mesh%ends(i))
    ! Under other loads what is remembered goes on: all coordinates, then all velocities.
    n = size(dofs)
    allocate (q(motion%n_dof), v(motion%n_dof))
    call motion%start(start, initial(2*dofs - 1), initial(2*dofs), q, v)
    if (resume == 2) then
      q(n + 1:) = memory(n + 1:motion%n_dof)
      v(n + 1:) = memory(motion%n_dof + n + 1:2*motion%n_dof)
    end if
    call new_stepper(stepper, motion, method, q, v, start, mesh%h(i), tolerance)
    if (resume == 1) call stepper%load_memory(memory(:stepper%memory_size()))
    if (resume > 0) then
      ! Behind what the method kept under the loads before, which may have been as many or not.
      i = nint(memory(n_memory))
      call motion%recall_switches(memory(i + 1:i + motion%n_switches()))
      motion%begins = resume == 2
      motion%grade = memory(n_memory - 2)
    end if
    if (resume == 2 .and. allocated(motion%sides)) then
      ! The base may go on with another velocity.
      i = merge(max_dof, motion%n_dof, stepper%explicit)
      call motion%jump_on(start, q, memory(i + 1:i + motion%n_dof), maxval(abs(initial)), v)
      if (any(abs(v - stepper%v) > 0.0_c_double)) call stepper%put(q, v)
    end if
    if (n_watch > 1) then
      ! All coordinates are computed then.
      call new_watch(watch, renumbered(watched, n, [(i, i=1, motion%n_dof)]), sides)
      call simulate(stepper, motion, first, n_steps, save_every, times, states, at_times, n_done, &
                    n_reached, t_reached, ended, mesh, watch)
      call watch%hand_over(sides, found, n_found)
    else if (size(dofs) == n_rows - 1) then
      call simulate(stepper, motion, first, n_steps, save_every, times, states, at_times, n_done, &
                    n_reached, t_reached, ended, mesh)
    else
      allocate (some_states(size(rows), n_columns), some_at_times(size(rows), n_times))
      some_at_times = 0.0_c_double
      call simulate(stepper, motion, first, n_steps, save_every, times, some_states, &
                    some_at_times, n_done, n_reached, t_reached, ended, mesh)
      states = 0.0_c_double
      states(rows, :) = some_states
      at_times(rows, :) = some_at_times
    end if
    i = stepper%memory_size()
    kept(:i) = stepper%save_memory()
    kept(i + 1:i + motion%n_switches()) = motion%keep_switches()
    kept(n_memory - 2) = motion%grade
    kept(n_memory - 1) = merge(1.0_c_double, 0.0_c_double, motion%in_parts)
    kept(n_memory) = i
    q = stepper%q
    v = stepper%v
    call motion%add_base(t_reached, q, v)
    last(2*dofs - 1) = q(:n)
    last(2*dofs) = v(:n)
    n_evaluations = stepper%n_evaluations
  end if
  call report(outcome, status)
end subroutine polynomial_simulate

!> Upper bound of the rates of its linear rest, of as many coordinates as sections take (rad/s).
subroutine polynomial_fastest(flat, n_flat, fastest, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: report
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_polynomial, only: polynomial_type
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_status, only: status_type
  use viscovib_system_vector, only: polynomial_from_vector
  implicit none
  integer(c_int), intent(in) :: n_flat
  real(c_double), intent(in) :: flat(n_flat)
  real(c_double), intent(out) :: fastest
  integer(c_int), intent(out) :: status
  complex(wp), allocatable :: forces(:, :), none(:)
  type(polynomial_type) :: system
  type(load_type) :: load
  type(polynomial_motion_type) :: motion
  type(status_type) :: outcome

  fastest = 0.0_c_double
  call polynomial_from_vector(system, flat, outcome)
  if (.not. outcome%failed()) then
    allocate (forces(system%n_dof(), 0), none(0))
    call new_load(load, system%n_dof(), [integer ::], forces, none, outcome)
    ! Of any steps and times: rates are those of coordinates.
    call new_fitted_motion(motion, system, load, 0.0_wp, 1.0_wp, 1.0_wp, outcome)
    if (.not. outcome%failed()) fastest = motion%fastest()
  end if
  call report(outcome, status)
end subroutine polynomial_fastest

!> What such a motion computes and skips; last_only /= 0: one state is kept.
subroutine polynomial_plan(flat, n_flat, reach, orders, series, n_rows, n_series, initial, t_end, &
                           dt, tolerance, method, save_every, last_only, text, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_load, report
  use viscovib_load, only: load_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_job, only: plan_polynomial
  use viscovib_status, only: status_type
  use viscovib_system_vector, only: polynomial_from_vector
  use viscovib_transient_job, only: transient_job
  implicit none
  integer(c_int), intent(in) :: n_flat, n_rows, n_series, orders(n_series)
  integer(c_int), intent(in) :: method, save_every, last_only
  real(c_double), intent(in) :: flat(n_flat), reach, initial(2*n_rows - 2), t_end, dt, tolerance
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  character(len=2048), intent(out) :: text
  integer(c_int), intent(out) :: status
  type(polynomial_type) :: system
  type(load_type) :: load
  type(status_type) :: outcome

  text = ''
  call polynomial_from_vector(system, flat, outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) then
    text = plan_polynomial(transient_job(initial, t_end, dt, tolerance, method, save_every, &
                                         last_only /= 0), system, load, reach)
  end if
  call report(outcome, status)
end subroutine polynomial_plan

!> How many coordinates the memory of a system takes in such a motion, in steps h; h = 0: at most;
!! -1: not all of its kernels are sums of exponentials, or have any.
subroutine hidden_coordinates(flat, n_flat, h, reach, n_hidden, fitted, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: report
  use viscovib_fitted_memory, only: bound_hidden, fit_memory, needs_fit
  use viscovib_hidden_memory, only: count_hidden
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: status_type
  use viscovib_system_vector, only: polynomial_from_vector
  implicit none
  integer(c_int), intent(in) :: n_flat
  real(c_double), intent(in) :: flat(n_flat), h, reach
  !> fitted: whether some kernel is fitted.
  integer(c_int), intent(out) :: n_hidden, fitted, status
  type(polynomial_type) :: system, whole
  type(status_type) :: outcome
  n_hidden = -1
  fitted = 0
  call polynomial_from_vector(system, flat, outcome)
  if (.not. outcome%failed()) then
    fitted = merge(1, 0, needs_fit(system))
    if (h > 0.0_c_double) then
      call fit_memory(system, h, reach, whole)
      n_hidden = count_hidden(whole)
    else
      n_hidden = bound_hidden(system)
    end if
  end if
  call report(outcome, status)
end subroutine hidden_coordinates
