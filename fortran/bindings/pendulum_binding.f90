! Flat routines over the pendulum, for f2py. A pendulum is the vector
! (e, w2, w3, alpha, c1, c2, c3, f0, m01, m02, p1, p2, p3, equations).

!> Natural frequencies, mode shapes, r, z_r; checks the parameters.
subroutine pendulum_modes(flat, omega, shapes, r, z_r, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  implicit none
  real(c_double), intent(in) :: flat(14)
  real(c_double), intent(out) :: omega(3), shapes(3, 3), r, z_r
  integer(c_int), intent(out) :: status
  character(len=512), intent(out) :: message
  type(pendulum_type) :: system
  type(status_type) :: outcome

  omega = 0.0_c_double
  shapes = 0.0_c_double
  call make_pendulum(system, flat, outcome)
  if (.not. outcome%failed()) call system%natural_modes(omega, shapes)
  r = system%r
  z_r = system%z_r
  call report(outcome, status, message)
end subroutine pendulum_modes

!> Accelerations, energy and its rate of change at n states
!! (z, z', phi, phi', psi, psi'); drives are cos(p_j t).
subroutine pendulum_evaluate(flat, drive, state, n, acceleration, energy, power, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_lanes, only: n_lanes
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n
  real(c_double), intent(in) :: flat(14), drive(3, n), state(6, n)
  real(c_double), intent(out) :: acceleration(3, n), energy(n), power(n)
  integer(c_int), intent(out) :: status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  type(pendulum_type) :: system
  type(status_type) :: outcome
  real(c_double), dimension(n_lanes, 3) :: q, v, cosines, a
  integer :: i, d

  call make_pendulum(system, flat, outcome)
  if (.not. outcome%failed()) then
    do i = 1, n
      do d = 1, 3
        q(:, d) = state(2*d - 1, i)
        v(:, d) = state(2*d, i)
        cosines(:, d) = drive(d, i)
      end do
      call system%acceleration(q, v, cosines, a)
      acceleration(:, i) = a(1, :)
      energy(i) = system%energy(q(1, :), v(1, :))
      power(i) = system%power(v(1, :), drive(:, i))
    end do
  end if
  call report(outcome, status, message)
end subroutine pendulum_evaluate

!> A run by Gauss collocation with n_nodes nodes, from `start` in steps h.
!! With resume /= 0, `memory` is what an earlier call returned in `kept`.
subroutine pendulum_simulate(flat, n_nodes, initial, start, h, tolerance, n_steps, save_every, &
                             resume, memory, n_memory, n_columns, states, kept, n_done, ended, &
                             n_evaluations, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_int, c_long
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_gauss, only: gauss_type, new_gauss
  use viscovib_pendulum, only: pendulum_type
  use viscovib_simulate, only: simulate
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_nodes, resume, n_memory, n_columns
  integer(c_long), intent(in) :: n_steps, save_every
  real(c_double), intent(in) :: flat(14), initial(6), start, h, tolerance, memory(n_memory)
  real(c_double), intent(out) :: states(6, n_columns), kept(n_memory)
  integer(c_long), intent(out) :: n_done, n_evaluations
  integer(c_int), intent(out) :: ended, status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  type(pendulum_type) :: system
  type(gauss_type) :: method
  type(status_type) :: outcome

  kept = 0.0_c_double
  n_done = 0
  n_evaluations = 0
  ended = 0
  call make_pendulum(system, flat, outcome)
  if (.not. outcome%failed()) then
    call new_gauss(method, system, n_nodes, initial(1::2), initial(2::2), start, h, tolerance)
    if (resume /= 0) call method%load_memory(memory(:method%memory_size()))
    call simulate(method, system, n_steps, save_every, states, n_done, ended)
    kept(:method%memory_size()) = method%save_memory()
    n_evaluations = method%n_evaluations
  end if
  call report(outcome, status, message)
end subroutine pendulum_simulate
