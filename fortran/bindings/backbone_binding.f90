! Flat routines over backbone curves, for f2py. The system is given as in mount_binding.

!> The backbone of a mode (frequency omega, shape) from amplitude start to finish of
!! coordinate dof, counted from 1; of the system, damping and kernels must be absent.
!! Orders to `harmonics`, of which n_kept are kept: all, or the odd ones.
subroutine oscillator_backbone(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, &
                               omega, mode, n_dof, dof, start, finish, harmonics, tolerance, &
                               max_points, max_step, n_kept, cancel, n_points, ended, nu, &
                               coefficients, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_backbone, only: follow_backbone
  use viscovib_binding_tools, only: make_system, report
  use viscovib_curve_branch, only: curve_branch_type, curve_options
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, n_dof, dof, harmonics
  integer(c_int), intent(in) :: max_points, n_kept
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi), omega, mode(n_dof)
  real(c_double), intent(in) :: start, finish, tolerance, max_step
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(out) :: n_points, ended, status
  real(c_double), intent(out) :: nu(max_points)
  complex(c_double_complex), intent(out) :: coefficients(n_kept, n_dof, max_points)
  character(len=512), intent(out) :: message
  !f2py threadsafe
  class(oscillator_type), allocatable, target :: system
  type(harmonic_set_type) :: set
  type(curve_branch_type) :: backbone
  type(status_type) :: outcome
  integer :: d, from

  n_points = 0
  ended = 0
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) then
    call new_harmonic_set(set, harmonics, system%odd, system%degree)
    call follow_backbone(system, set, omega, mode, dof, &
                         curve_options(start, finish, tolerance, max_points, max_step), &
                         backbone, cancel(1))
    n_points = backbone%n_points
    ended = backbone%outcome
    nu(:n_points) = backbone%x(2*n_kept*n_dof + 1, :n_points)
    do d = 1, n_dof
      from = 2*n_kept*(d - 1)
      coefficients(:, d, :n_points) = cmplx(0.0_c_double, &
                                            backbone%x(from + 2:from + 2*n_kept:2, :n_points), &
                                            c_double)
    end do
  end if
  call report(outcome, status, message)
end subroutine oscillator_backbone
