! Flat routines over many motions of a polynomial system at once, for f2py.

!> Many runs from time 0; run i with the load's frequency nu(i), the scales(:,i) of
!! `viscovib_lane_motion` and the step h(i); own: what is scaled of stiffness and damping. The
!! system and its load as in polynomial_binding: one for all runs, or one for each (n_systems = n),
!! which differ in their numbers only. All else as in `pendulum_ensemble`; missed(i) /= 0: steps of
!! run i may have missed a thin layer of a force.
subroutine polynomial_ensemble(flat, n_flat, n_systems, orders, series, n_rows, n_series, own, nu, &
                               scales, n, &
                               initial, h, method, n_steps, n_discard, ahead, sample_every, &
                               section_every, n_sections, n_moments, n_exponents, lines, n_lines, &
                               n_section_runs, cancel, state, ended, t_reached, peak, mean, rms, &
                               amplitudes, sections, lyapunov, lyapunov_error, missed, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int, c_long
  use viscovib_binding_tools, only: make_load, report
  use viscovib_ensemble, only: blocks_of, check_method, ensemble_block, ensemble_job, &
    run_block, run_together
  use viscovib_ensemble_tools, only: empty_block, fill_block
  use viscovib_lane_motion, only: lane_motion_type, new_lane_motion
  use viscovib_lanes, only: n_lanes
  use viscovib_load, only: load_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: fail, status_input_error, status_type
  use viscovib_stopping, only: is_set
  use viscovib_system_vector, only: polynomial_from_vector
  implicit none
  integer(c_int), intent(in) :: n_flat, n_systems, n_rows, n_series, orders(n_series), n, method
  integer(c_int), intent(in) :: n_sections, n_moments, n_exponents, n_lines, n_section_runs
  integer(c_long), intent(in) :: n_steps, n_discard, sample_every, section_every
  real(c_double), intent(in) :: flat(n_flat, n_systems), own(n_rows - 1, n_rows - 1, 2, n_systems)
  real(c_double), intent(in) :: nu(n), scales(4, n), ahead
  complex(c_double_complex), intent(in) :: series(n_rows, n_series)
  real(c_double), intent(in) :: initial(2*n_rows - 2, n), h(n), lines(n_lines)
  integer(c_int), intent(inout) :: cancel(1)
  real(c_double), intent(out), dimension(2*n_rows - 2, n_moments) :: peak, mean, rms
  real(c_double), intent(out) :: state(2*n_rows - 2, n)
  real(c_double), intent(out), dimension(n_exponents, n) :: lyapunov, lyapunov_error
  complex(c_double_complex), intent(out) :: amplitudes(n_rows - 1, n_lines, n)
  real(c_double), intent(inout) :: sections(2*n_rows - 2, n_sections, n_section_runs)
  integer(c_int), intent(out) :: ended(n), missed(n), status
  real(c_double), intent(out) :: t_reached(n)
  !f2py threadsafe
  type(polynomial_type) :: system
  type(lane_motion_type) :: motion
  type(lane_motion_type), allocatable :: motions(:)
  type(load_type) :: load
  type(ensemble_job) :: job
  type(ensemble_block), allocatable :: blocks(:)
  type(status_type) :: outcome
  integer :: b, begin, first, i, l, many

  job%method = method
  job%n_steps = n_steps
  job%n_discard = n_discard
  job%ahead = ahead
  job%sample_every = sample_every
  job%section_every = section_every
  job%moments = n_moments > 0
  job%n_exponents = n_exponents
  job%lines = lines
  ended = 0
  missed = 0
  t_reached = 0.0_c_double
  call polynomial_from_vector(system, flat(:, 1), outcome)
  if (.not. outcome%failed()) call make_load(load, orders, series, outcome)
  if (.not. outcome%failed()) call new_lane_motion(motion, system, load, own(:, :, :, 1))
  if (.not. outcome%failed()) call check_method(job, motion, outcome)
  allocate (motions(blocks_of(job)), source=motion)
  allocate (blocks(size(motions)))
  do begin = 1, n, n_lanes*size(blocks)
    if (outcome%failed()) exit
    many = min(size(blocks), (n - begin)/n_lanes + 1)
    do b = 1, many
      first = begin + n_lanes*(b - 1)
      call fill_block(blocks(b), first, 2, n_sections, initial, h, sections)
      do l = 1, n_lanes
        i = min(first + l - 1, n)
        if (n_systems == 1) then
          call motions(b)%set_scales(l, scales(:, i))
        else if (.not. outcome%failed()) then
          call take_system(motions(b))
        end if
        blocks(b)%frequencies(l, :) = nu(i)
      end do
    end do
    if (outcome%failed()) exit
    if (size(blocks) > 1) then
      call run_together(job, motions(:many), blocks(:many), cancel(1))
    else
      call run_block(job, motions(1), blocks(1), cancel(1))
    end if
    do b = 1, many
      first = begin + n_lanes*(b - 1)
      do l = 1, min(n_lanes, n - first + 1)
        if (blocks(b)%missed(l)) missed(first + l - 1) = 1
      end do
      call empty_block(blocks(b), first, state, ended, t_reached, peak, mean, rms, amplitudes, &
                       sections, lyapunov, lyapunov_error)
    end do
    if (is_set(cancel(1))) exit
  end do
  call report(outcome, status)

contains

  !> The numbers of run i in lane l.
  subroutine take_system(block_motion)
    type(lane_motion_type), intent(inout) :: block_motion
    type(lane_motion_type) :: other

    call polynomial_from_vector(system, flat(:, i), outcome)
    if (outcome%failed()) return
    call new_lane_motion(other, system, load, own(:, :, :, i))
    if (.not. motion%differs_in_numbers(other)) then
      call fail(outcome, status_input_error, 'system', 'system: runs side by side must differ in ' &
                //'their numbers only')
      return
    end if
    call other%set_scales(1, scales(:, i))
    call block_motion%take_lane(l, other)
  end subroutine take_system

end subroutine polynomial_ensemble
