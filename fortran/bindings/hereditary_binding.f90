! Flat routines over motion with memory, for f2py. The system is given as in
! mount_binding.

!> A run from time 0 in steps h; first steps are done already. The load is
!! Im sum_k amplitudes(:,k) exp(i frequencies(k) t) and cubics between breaks. s
!! nodes a step; past: 1 exponentials, 2 step by step; held: the displacement for
!! all t < 0, or before the first of the times `before` with displacements `moved`,
!! ascending to 0. With resume /= 0, `memory` is what an earlier call returned in
!! `kept`(:n_kept); if n_kept > n_memory there was no room for it. resolution: largest
!! last Legendre coefficient of a displacement on a step, relative to its largest value.
!! reason /= 0: no run, see `viscovib_hereditary`.
subroutine mount_simulate(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, &
                          frequencies, amplitudes, n_dof, n_frequencies, breaks, pieces, &
                          n_breaks, s, past, held, before, moved, n_before, initial, h, &
                          t_end, tolerance, first, n_steps, &
                          save_every, resume, memory, n_memory, times, n_times, n_columns, &
                          states, at_times, last, kept, n_kept, n_done, n_reached, ended, &
                          n_iterations, resolution, reason, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int, c_long
  use viscovib_binding_tools, only: make_system, report
  use viscovib_hereditary, only: begun, hereditary_type, new_hereditary
  use viscovib_hereditary_run, only: run_hereditary
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  use viscovib_time_load, only: time_load_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_dof, n_frequencies
  integer(c_int), intent(in) :: n_breaks, s, past, resume, n_before, n_memory, n_times, n_columns
  integer(c_long), intent(in) :: first, n_steps, save_every
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi)
  real(c_double), intent(in) :: frequencies(n_frequencies), breaks(n_breaks)
  complex(c_double_complex), intent(in) :: amplitudes(n_dof, n_frequencies)
  real(c_double), intent(in) :: pieces(n_dof, 4, n_breaks), held(n_dof), initial(2*n_dof)
  real(c_double), intent(in) :: before(n_before), moved(n_dof, n_before)
  real(c_double), intent(in) :: h, t_end, tolerance
  real(c_double), intent(in) :: memory(n_memory), times(n_times)
  real(c_double), intent(out) :: states(2*n_dof, n_columns), at_times(2*n_dof, n_times)
  real(c_double), intent(out) :: last(2*n_dof), kept(n_memory), resolution
  integer(c_long), intent(out) :: n_done
  integer(c_int), intent(out) :: n_kept, n_reached, ended, n_iterations, reason, status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  class(oscillator_type), allocatable :: system
  type(hereditary_type) :: run
  type(time_load_type) :: load
  type(status_type) :: outcome

  kept = 0.0_c_double
  last = initial
  at_times = 0.0_c_double
  n_kept = 0
  n_done = 0
  n_reached = 0
  n_iterations = 0
  resolution = 0.0_c_double
  ended = 0
  reason = begun
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) then
    load%frequencies = frequencies
    load%amplitudes = amplitudes
    load%breaks = breaks
    load%pieces = pieces
    call new_hereditary(run, system, load, s, past, held, initial(1::2), initial(2::2), h, &
                        t_end, tolerance, reason, before, moved)
    if (reason == begun) then
      if (resume /= 0) call run%load_memory(memory)
      call run_hereditary(run, system, load, first, n_steps, save_every, times, states, &
                          at_times, n_done, n_reached, ended)
      last(1::2) = run%u
      last(2::2) = run%v
      n_iterations = run%equations%n_iterations
      resolution = run%resolution()
      n_kept = run%memory_size()
      if (n_kept <= n_memory) kept(:n_kept) = run%save_memory()
    end if
  end if
  call report(outcome, status, message)
end subroutine mount_simulate
