! Flat routines over motion in time, for f2py. A pendulum is a vector as in
! pendulum_binding.

! Events are watched as `viscovib_watch` takes them; sides are those of `watch_type` before and
! after; found: a column each as `passage_errors` takes them, n_found of them even if there is less
! room.

!> A run from time 0 in steps h; first steps are done already; `last` is the state at
!! t_reached, n_reached of the times lie before. method: the
!! place in `transient_methods`. With resume = 1, `memory` is what an earlier call
!! returned in `kept`; else the run begins with `initial`, whatever time it is.
!! swings = 0: of the spring alone, phi = psi = 0.
subroutine pendulum_simulate(flat, method, swings, initial, h, tolerance, first, n_steps, &
                             save_every, resume, memory, n_memory, times, n_times, n_columns, &
                             watched, n_watch, sides, n_sides, most, states, at_times, last, &
                             kept, n_done, n_reached, t_reached, ended, n_evaluations, found, &
                             n_found, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int, c_long
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_method_catalogue, only: new_stepper
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_spring, only: new_spring, spring_type
  use viscovib_simulate, only: simulate
  use viscovib_status, only: status_type
  use viscovib_stepper, only: stepper_type
  use viscovib_watch, only: new_watch, watch_type
  implicit none
  integer(c_int), intent(in) :: method, swings, resume, n_memory, n_times, n_columns
  integer(c_long), intent(in) :: first, n_steps, save_every
  real(c_double), intent(in) :: flat(14), initial(6), h, tolerance, memory(n_memory)
  real(c_double), intent(in) :: times(n_times)
  real(c_double), intent(out) :: states(6, n_columns), at_times(6, n_times), kept(n_memory)
  real(c_double), intent(out) :: last(6), t_reached
  integer(c_long), intent(out) :: n_done, n_evaluations
  integer(c_int), intent(in) :: n_watch, n_sides, most
  real(c_double), intent(in) :: watched(n_watch)
  integer(c_int), intent(inout) :: sides(n_sides)
  real(c_double), intent(out) :: found(13, most)
  integer(c_int), intent(out) :: n_reached, ended, n_found, status
  !f2py threadsafe
  type(pendulum_type) :: system
  type(spring_type) :: spring
  class(stepper_type), allocatable :: stepper
  type(watch_type) :: watch
  type(status_type) :: outcome
  real(c_double), allocatable :: spring_states(:, :), spring_at_times(:, :)

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
  call make_pendulum(system, flat, outcome)
  if (.not. outcome%failed() .and. swings == 0) then
    call new_spring(spring, system)
    call new_stepper(stepper, spring, method, initial(1:1), initial(2:2), first*h, h, &
                     tolerance)
    if (resume == 1) call stepper%load_memory(memory(:stepper%memory_size()))
    allocate (spring_states(2, n_columns), spring_at_times(2, n_times))
    spring_at_times = 0.0_c_double
    call simulate(stepper, spring, first, n_steps, save_every, times, spring_states, &
                  spring_at_times, n_done, n_reached, t_reached, ended)
    states = 0.0_c_double
    states(:2, :) = spring_states
    at_times(:2, :) = spring_at_times
    last = 0.0_c_double
    last(:2) = [stepper%q, stepper%v]
    kept(:stepper%memory_size()) = stepper%save_memory()
    n_evaluations = stepper%n_evaluations
  else if (.not. outcome%failed()) then
    call new_stepper(stepper, system, method, initial(1::2), initial(2::2), first*h, h, &
                     tolerance)
    if (resume == 1) call stepper%load_memory(memory(:stepper%memory_size()))
    if (n_watch > 1) then
      call new_watch(watch, watched, sides)
      call simulate(stepper, system, first, n_steps, save_every, times, states, at_times, n_done, &
                    n_reached, t_reached, ended, watch=watch)
      call watch%hand_over(sides, found, n_found)
    else
      call simulate(stepper, system, first, n_steps, save_every, times, states, at_times, n_done, &
                    n_reached, t_reached, ended)
    end if
    kept(:stepper%memory_size()) = stepper%save_memory()
    last(1::2) = stepper%q
    last(2::2) = stepper%v
    n_evaluations = stepper%n_evaluations
  end if
  call report(outcome, status)
end subroutine pendulum_simulate

!> Many runs from time 0, trajectory i with the pendulum flat(:,i) and step h(i). Peaks and means
!! begin so much of a step `ahead` of the first n_discard.
!! Results that are not wanted have no columns. cancel(1) /= 0 gives up, and
!! may be set by another thread.
subroutine pendulum_ensemble(flat, n, initial, h, method, n_steps, n_discard, ahead, &
                             sample_every, section_every, n_sections, n_moments, n_exponents, &
                             lines, n_lines, n_section_runs, cancel, state, ended, t_reached, &
                             peak, mean, rms, amplitudes, sections, lyapunov, lyapunov_error, &
                             status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int, c_long
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_ensemble, only: check_method, ensemble_block, ensemble_job, run_block
  use viscovib_ensemble_tools, only: empty_block, fill_block
  use viscovib_lanes, only: n_lanes
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  use viscovib_stopping, only: is_set
  implicit none
  integer(c_int), intent(in) :: n, method, n_sections, n_moments, n_exponents, n_lines
  integer(c_int), intent(in) :: n_section_runs
  integer(c_long), intent(in) :: n_steps, n_discard, sample_every, section_every
  real(c_double), intent(in) :: flat(14, n), initial(6, n), h(n), ahead, lines(n_lines)
  integer(c_int), intent(inout) :: cancel(1)
  real(c_double), intent(out) :: state(6, n), peak(6, n_moments), mean(6, n_moments)
  real(c_double), intent(out) :: rms(6, n_moments)
  real(c_double), intent(out), dimension(n_exponents, n) :: lyapunov, lyapunov_error
  complex(c_double_complex), intent(out) :: amplitudes(3, n_lines, n)
  real(c_double), intent(inout) :: sections(6, n_sections, n_section_runs)
  integer(c_int), intent(out) :: ended(n), status
  real(c_double), intent(out) :: t_reached(n)
  !f2py threadsafe
  type(pendulum_type) :: system, other
  type(ensemble_job) :: job
  type(ensemble_block) :: block
  type(status_type) :: outcome
  integer :: first, i, l

  job%method = method
  job%n_steps = n_steps
  job%n_discard = n_discard
  job%ahead = ahead
  job%sample_every = sample_every
  job%section_every = section_every
  job%moments = n_moments > 0
  job%n_exponents = n_exponents
  job%lines = lines
  do first = 1, n, n_lanes
    call fill_block(block, first, 3, n_sections, initial, h, sections)
    call make_pendulum(system, flat(:, first), outcome)
    if (outcome%failed()) exit
    do l = 1, n_lanes
      i = min(first + l - 1, n)
      call make_pendulum(other, flat(:, i), outcome)
      if (outcome%failed()) exit
      call system%set_lane(l, other)
      block%frequencies(l, :) = other%drives
    end do
    if (.not. outcome%failed()) call check_method(job, system, outcome)
    if (outcome%failed()) exit
    call run_block(job, system, block, cancel(1))
    call empty_block(block, first, state, ended, t_reached, peak, mean, rms, amplitudes, sections, &
                     lyapunov, lyapunov_error)
    if (is_set(cancel(1))) exit
  end do
  call report(outcome, status)
end subroutine pendulum_ensemble

!> What a motion of the pendulum computes and skips; last_only /= 0: one state is kept.
subroutine pendulum_plan(flat, initial, t_end, dt, tolerance, method, save_every, last_only, text, &
                         status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_job, only: plan_pendulum
  use viscovib_status, only: status_type
  use viscovib_transient_job, only: transient_job
  implicit none
  real(c_double), intent(in) :: flat(14), initial(6), t_end, dt, tolerance
  integer(c_int), intent(in) :: method, save_every, last_only
  character(len=2048), intent(out) :: text
  integer(c_int), intent(out) :: status
  type(pendulum_type) :: system
  type(status_type) :: outcome

  text = ''
  call make_pendulum(system, flat, outcome)
  if (.not. outcome%failed()) then
    text = plan_pendulum(transient_job(initial, t_end, dt, tolerance, method, save_every, &
                                       last_only /= 0), system)
  end if
  call report(outcome, status)
end subroutine pendulum_plan

!> Errors of passages of a run, as `viscovib_passage_errors` has them.
subroutine event_errors(vector, n_vector, own, n_rows, n_own, other, n_other, times, apart, n_off, &
                        n_times, least, span, compared, errors)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_passage_errors, only: passage_errors
  implicit none
  integer(c_int), intent(in) :: n_vector, n_rows, n_own, n_other, n_off, n_times, compared
  real(c_double), intent(in) :: vector(n_vector), own(n_rows, n_own), other(n_rows, n_other)
  real(c_double), intent(in) :: times(n_times), apart(n_off, n_times), least, span(2)
  real(c_double), intent(out) :: errors(2, n_own)
  !f2py threadsafe
  call passage_errors(vector, own, other, times, apart, least, span, compared /= 0, errors)
end subroutine event_errors
