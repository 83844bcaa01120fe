! Flat routines over motion in time, for f2py. A pendulum is a vector as in
! pendulum_binding.

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
