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

!> Free motions of the pendulum, whose damping must be 0, along their amplitude (the
!! cosine of an order of a coordinate, counted from 1) or, for dof = 0, their energy,
!! from start to finish. kept is 1 where an order of a coordinate, 0 to n_orders - 1, is an
!! unknown; unit the base frequency of small motions. With leave = 1 they begin at the
!! cosines `begin`, frequency begin_nu and size begin_p in the direction `along`, else near
!! the cosines `begin`, which are only scaled to size.
!! Monodromy matrices if stability = 1.
subroutine pendulum_backbone(flat, n_orders, kept, unit, dof, order, start, finish, tolerance, &
                             max_points, max_step, stability, leave, begin, begin_nu, begin_p, &
                             along, n_unknowns, max_special, cancel, n_points, ended, nu, &
                             energy, x, matrices, n_folds, folds, n_branch_points, &
                             branch_points, branch_point_nu, branch_point_x, across, before, &
                             status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_curve_branch, only: curve_branch_type, curve_options, follow_curve
  use viscovib_free_curve, only: free_curve_type, new_free_curve
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  use viscovib_torus, only: new_torus, torus_type
  implicit none
  integer(c_int), intent(in) :: n_orders, n_unknowns, max_points, max_special, dof, order
  integer(c_int), intent(in) :: kept(n_orders, 3), stability, leave
  real(c_double), intent(in) :: flat(14), unit, start, finish, tolerance, max_step
  real(c_double), intent(in) :: begin(n_unknowns), begin_nu, begin_p, along(n_unknowns + 2)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(out) :: n_points, ended, n_folds
  real(c_double), intent(out) :: nu(max_points), energy(max_points)
  !> Cosines: n_unknowns = 3 n_orders.
  real(c_double), intent(out) :: x(n_unknowns, max_points)
  real(c_double), intent(out) :: matrices(6, 6, max_points), folds(max_special)
  real(c_double), intent(out) :: branch_points(max_special), branch_point_nu(max_special)
  real(c_double), intent(out) :: branch_point_x(n_unknowns, max_special)
  !> Direction in the cosines, the frequency and the size.
  real(c_double), intent(out) :: across(n_unknowns + 2, max_special)
  integer(c_int), intent(out) :: before(max_special), n_branch_points, status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  type(pendulum_type), target :: system
  type(torus_type) :: torus
  type(free_curve_type) :: curve
  type(curve_options) :: options
  type(curve_branch_type) :: branch
  type(orbit_floquet_type) :: floquet
  type(status_type) :: problem
  real(c_double), allocatable :: at(:), r(:), slope(:), jacobian(:, :), direction(:)
  logical :: inside
  integer :: i

  n_points = 0
  n_folds = 0
  n_branch_points = 0
  ended = -1
  before = 0
  nu = 0.0_c_double
  energy = 0.0_c_double
  x = 0.0_c_double
  matrices = 0.0_c_double
  folds = 0.0_c_double
  branch_points = 0.0_c_double
  branch_point_nu = 0.0_c_double
  branch_point_x = 0.0_c_double
  across = 0.0_c_double
  call make_pendulum(system, flat, problem)
  if (.not. problem%failed()) call new_torus(torus, reshape([(i, i=0, n_orders - 1)], &
                                                            [1, n_orders]), problem)
  if (.not. problem%failed()) then
    call new_free_curve(curve, system, torus, kept /= 0, unit, dof, order)
    options = curve_options(start, finish, tolerance, max_points, max_step)
    at = cosines_only(begin, begin_nu/unit)
    if (leave == 0) then
      associate (cosines => at(:curve%motion%n))
        if (dof > 0) then
          cosines = cosines*(start/cosines(curve%measured))
        else
          cosines = cosines*sqrt(start/curve%energy(at))
        end if
      end associate
      call follow_curve(curve, options, at, branch, cancel=cancel(1))
    else
      direction = [cosines_only(along(:n_unknowns), along(n_unknowns + 1)), along(n_unknowns + 2)]
      call follow_curve(curve, options, at, branch, begin_p, direction, cancel(1))
    end if
    n_points = branch%n_points
    ended = branch%outcome
    n_folds = min(branch%folds%n, max_special)
    folds(:n_folds) = branch%folds%p(:n_folds)
    n_branch_points = min(branch%branch_points%n, max_special)
    do i = 1, n_branch_points
      associate (points => branch%branch_points)
        branch_points(i) = points%p(i)
        branch_point_x(:, i) = cosines_of(points%x(:, i))
        branch_point_nu(i) = curve%frequency(points%x(:, i))
        across(:n_unknowns, i) = cosines_of(points%across(:, i))
        across(n_unknowns + 1:, i) = points%across(curve%n:, i)
        before(i) = points%before(i)
      end associate
    end do
    allocate (r(curve%n), slope(curve%n), jacobian(curve%n, curve%n))
    do i = 1, n_points
      if (cancel(1) /= 0) exit
      associate (point => branch%x(:, i))
        x(:, i) = cosines_of(point)
        nu(i) = curve%frequency(point)
        energy(i) = curve%energy(point)
        if (stability == 0) cycle
        call curve%equations(point, branch%parameter(i), r, jacobian, slope, inside)
        call floquet%monodromy(curve%motion, point(:curve%motion%n), matrices(:, :, i))
      end associate
    end do
  end if
  call report(problem, status, message)

contains

  !> Unknowns of the curve from cosines and the last one.
  function cosines_only(values, last) result(unknowns)
    real(c_double), intent(in) :: values(:), last
    real(c_double), allocatable :: unknowns(:)
    real(c_double) :: y(2*n_orders - 1, 3)
    y = 0.0_c_double
    y(1::2, :) = reshape(values, [n_orders, 3])
    unknowns = [curve%motion%reduced(reshape(y, [size(y)])), last]
  end function cosines_only

  !> The way back.
  function cosines_of(unknowns) result(values)
    real(c_double), intent(in) :: unknowns(:)
    real(c_double) :: values(n_unknowns), y(2*n_orders - 1, 3)
    y = curve%motion%expanded(unknowns(:curve%motion%n))
    values = reshape(y(1::2, :), [n_unknowns])
  end function cosines_of

end subroutine pendulum_backbone
