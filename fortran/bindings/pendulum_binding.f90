! Flat routines over the pendulum, for f2py. A pendulum is the vector
! (e, w2, w3, alpha, c1, c2, c3, f0, m01, m02, p1, p2, p3, equations).

!> Linear undamped frequencies of n pendulums, shape (3, n).
subroutine pendulum_frequencies(flat, n, omega, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n
  real(c_double), intent(in) :: flat(14, n)
  real(c_double), intent(out) :: omega(3, n)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  type(pendulum_type) :: pendulum
  type(status_type) :: outcome
  real(c_double) :: shapes(3, 3)
  integer :: i

  omega = 0.0_c_double
  do i = 1, n
    call make_pendulum(pendulum, flat(:, i), outcome)
    if (outcome%failed()) exit
    call pendulum%natural_modes(omega(:, i), shapes)
  end do
  call report(outcome, status)
end subroutine pendulum_frequencies

!> Natural frequencies, mode shapes, r, z_r; checks the parameters.
subroutine pendulum_modes(flat, omega, shapes, r, z_r, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  implicit none
  real(c_double), intent(in) :: flat(14)
  real(c_double), intent(out) :: omega(3), shapes(3, 3), r, z_r
  integer(c_int), intent(out) :: status
  type(pendulum_type) :: system
  type(status_type) :: outcome

  omega = 0.0_c_double
  shapes = 0.0_c_double
  call make_pendulum(system, flat, outcome)
  if (.not. outcome%failed()) call system%natural_modes(omega, shapes)
  r = system%r
  z_r = system%z_r
  call report(outcome, status)
end subroutine pendulum_modes

!> Accelerations, energy and its rate of change at n states
!! (z, z', phi, phi', psi, psi'); drives are cos(p_j t).
subroutine pendulum_evaluate(flat, drive, state, n, acceleration, energy, power, status)
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
  call report(outcome, status)
end subroutine pendulum_evaluate

!> Jacobian of q'' with respect to (z, z', phi, phi', psi, psi') at n states.
subroutine pendulum_jacobian(flat, drive, state, n, jacobian, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_lanes, only: n_lanes
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n
  real(c_double), intent(in) :: flat(14), drive(3, n), state(6, n)
  real(c_double), intent(out) :: jacobian(3, 6, n)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  type(pendulum_type) :: system
  type(status_type) :: outcome
  real(c_double), dimension(n_lanes, 3) :: q, v, cosines, dq, dv, a, da
  integer :: i, d

  call make_pendulum(system, flat, outcome)
  if (.not. outcome%failed()) then
    dq = 0.0_c_double
    dv = 0.0_c_double
    do d = 1, 3
      dq(2*d - 1, d) = 1.0_c_double
      dv(2*d, d) = 1.0_c_double
    end do
    do i = 1, n
      do d = 1, 3
        q(:, d) = state(2*d - 1, i)
        v(:, d) = state(2*d, i)
        cosines(:, d) = drive(d, i)
      end do
      call system%tangent(q, v, cosines, dq, dv, a, da)
      jacobian(:, :, i) = transpose(da(:6, :))
    end do
  end if
  call report(outcome, status)
end subroutine pendulum_jacobian
