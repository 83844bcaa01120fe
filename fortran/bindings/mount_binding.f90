! Flat routines over the mount, for f2py. A mount is the vector described in
! `viscovib_binding_tools` and two kernels; nothing is kept between calls.

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
