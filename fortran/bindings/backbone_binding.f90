! Flat routines over backbone curves, for f2py. The system is given as in mount_binding.

!> What a backbone computes and skips, and how many orders it may keep. mode is counted from 0,
!! dof from 1 (0: the one that moves most); name is that of dof.
!! chosen = 1: as many orders as the tolerance needs.
subroutine oscillator_backbone_plan(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, &
                                    mode, dof, name, start, finish, harmonics, chosen, tolerance, &
                                    n_kept, text, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_backbone_plan, only: backbone_plan_type, new_backbone_plan
  use viscovib_binding_tools, only: make_system, report
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, mode, dof, harmonics
  integer(c_int), intent(in) :: chosen
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi)
  real(c_double), intent(in) :: start, finish, tolerance
  character(len=*), intent(in) :: name
  integer(c_int), intent(out) :: n_kept, status
  character(len=2048), intent(out) :: text
  class(oscillator_type), allocatable :: system
  type(backbone_plan_type) :: plan
  type(status_type) :: outcome

  n_kept = 0
  text = ''
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) call new_backbone_plan(plan, system, mode, dof, name, harmonics, &
                                                     chosen == 1, tolerance, outcome)
  if (.not. outcome%failed()) then
    n_kept = plan%n_most()
    text = plan%text(start, finish)
  end if
  call report(outcome, status)
end subroutine oscillator_backbone_plan

!> The backbone of a mode, counted from 0, with the options packed for `curve_options_from`, by
!! the amplitude of coordinate dof, counted from 1 (0: the one that moves most). n_kept as its
!! plan says; n_used of them are kept.
subroutine oscillator_backbone(flat, n_flat, kind_x, data_x, n_x, kind_phi, data_phi, n_phi, &
                               mode, dof, curve_packed, n_packed, harmonics, chosen, max_points, &
                               n_kept, n_dof, max_special, cancel, n_points, ended, &
                               n_used, kept, nu, truncation, error, off, coefficients, n_folds, &
                               folds, fold_errors, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_backbone, only: follow_backbone
  use viscovib_backbone_plan, only: backbone_plan_type, new_backbone_plan
  use viscovib_binding_tools, only: make_system, report
  use viscovib_curve_branch, only: curve_branch_type, curve_options, curve_options_from
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_flat, kind_x, n_x, kind_phi, n_phi, mode, dof, harmonics
  integer(c_int), intent(in) :: chosen, max_points, n_kept, n_dof, max_special, n_packed
  real(c_double), intent(in) :: flat(n_flat), data_x(n_x), data_phi(n_phi)
  real(c_double), intent(in) :: curve_packed(n_packed)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(out) :: n_points, ended, n_used, kept(n_kept), n_folds, status
  !> Folds are amplitudes.
  real(c_double), intent(out) :: nu(max_points), truncation(max_points), folds(max_special)
  !> What the last correction and rounding leave, at the value of what varies and off the curve.
  real(c_double), intent(out) :: error(max_points), off(max_points), fold_errors(max_special)
  complex(c_double_complex), intent(out) :: coefficients(n_kept, n_dof, max_points)
  !f2py threadsafe
  ! Room for all points is not zeroed: that would take seconds, deaf to Ctrl-C.
  !f2py intent(out, cache) coefficients
  class(oscillator_type), allocatable :: system
  type(backbone_plan_type), target :: plan
  type(curve_branch_type) :: backbone
  type(curve_options) :: options
  type(status_type) :: outcome
  integer, allocatable :: orders(:)
  integer :: d, from

  n_points = 0
  n_used = 0
  n_folds = 0
  ended = 0
  options = curve_options_from(curve_packed)
  call make_system(system, flat, kind_x, data_x, kind_phi, data_phi, outcome)
  if (.not. outcome%failed()) call new_backbone_plan(plan, system, mode, dof, '', harmonics, &
                                                     chosen == 1, options%tolerance, outcome)
  if (.not. outcome%failed()) then
    call follow_backbone(plan, options, backbone, orders, cancel(1))
    n_used = size(orders)
    kept(:n_used) = orders
    n_points = backbone%n_points
    ended = backbone%outcome
    nu(:n_points) = backbone%x(n_used*n_dof + 1, :n_points)
    truncation(:n_points) = backbone%truncation(:n_points)
    error(:n_points) = backbone%error(:n_points)
    off(:n_points) = backbone%off(:n_points)
    do d = 1, n_dof
      from = n_used*(d - 1)
      coefficients(:n_used, d, :n_points) = cmplx(0.0_c_double, &
                                                  backbone%x(from + 1:from + n_used, :n_points), &
                                                  c_double)
    end do
    n_folds = min(backbone%folds%n, max_special)
    folds(:n_folds) = backbone%folds%p(:n_folds)
    fold_errors(:n_folds) = backbone%folds%error(:n_folds)
  end if
  call report(outcome, status)
end subroutine oscillator_backbone

!> Free motions of the pendulum, whose damping must be 0, along their amplitude (the
!! cosine of an order of a coordinate, counted from 1) or, for dof = 0, their energy,
!! from start to finish. pattern is 1 where an order of a coordinate is an unknown, and repeats
!! from order 0 on; unit the base frequency of small motions. Orders go to `harmonics` times
!! `order`, or as far as the tolerance needs, to `most` times `order`. With leave = 1 they begin
!! at the cosines `begin`, frequency begin_nu and size begin_p in the direction `along`, else
!! near the cosines `begin`, which are only scaled to size; both to `harmonics` times `order`.
!! Floquet multipliers if stability = 1.
subroutine pendulum_backbone(flat, n_pattern, pattern, unit, dof, order, harmonics, most, &
                             curve_packed, n_packed, max_points, stability, leave, n_begin, &
                             begin, begin_nu, begin_p, along, n_unknowns, max_special, cancel, &
                             n_points, ended, highest, nu, energy, truncation, error, off, x, &
                             multipliers, growing, n_folds, folds, fold_errors, n_branch_points, &
                             branch_points, branch_point_nu, branch_point_x, across, before, &
                             status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_pendulum, report
  use viscovib_curve_branch, only: curve_options_from
  use viscovib_free_family, only: follow_family, free_circle, free_family_type, free_options
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: n_pattern, n_begin, n_unknowns, max_points, max_special, dof, order
  integer(c_int), intent(in) :: n_packed
  integer(c_int), intent(in) :: pattern(n_pattern, 3), harmonics, most, stability, leave
  real(c_double), intent(in) :: flat(14), unit, curve_packed(n_packed)
  real(c_double), intent(in) :: begin(n_begin), begin_nu, begin_p, along(n_begin + 2)
  !> cancel(1) /= 0, perhaps set by another thread, gives up.
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int), intent(out) :: n_points, ended, n_folds
  !> Order of the mode's frequency that was kept.
  integer(c_int), intent(out) :: highest
  real(c_double), intent(out) :: nu(max_points), energy(max_points), truncation(max_points)
  !> What the last correction and rounding leave, at the value of what varies and off the curve.
  real(c_double), intent(out) :: error(max_points), off(max_points)
  !> Cosines: of 3 (most order + 1) those to the order kept come first.
  real(c_double), intent(out) :: x(n_unknowns, max_points)
  real(c_double), intent(out) :: folds(max_special), fold_errors(max_special)
  !> Largest first, NaN where unknown; how many are outside the circle, -1: unknown.
  complex(c_double_complex), intent(out) :: multipliers(6, max_points)
  integer(c_int), intent(out) :: growing(max_points)
  real(c_double), intent(out) :: branch_points(max_special), branch_point_nu(max_special)
  real(c_double), intent(out) :: branch_point_x(n_unknowns, max_special)
  !> Direction in the cosines, the frequency and the size.
  real(c_double), intent(out) :: across(n_unknowns + 2, max_special)
  integer(c_int), intent(out) :: before(max_special), n_branch_points, status
  !f2py threadsafe
  ! Room for all points is not zeroed: that would take seconds, deaf to Ctrl-C.
  !f2py intent(out, cache) x
  type(pendulum_type), target :: system
  type(free_options) :: options
  type(free_family_type) :: family
  type(status_type) :: problem
  integer :: i, m, n

  n_points = 0
  highest = 0
  n_folds = 0
  n_branch_points = 0
  ended = -1
  call make_pendulum(system, flat, problem)
  if (.not. problem%failed()) then
    options%pattern = pattern /= 0
    options%highest = harmonics
    options%most = most
    options%unit = unit
    options%dof = dof
    options%order = order
    options%curve = curve_options_from(curve_packed)
    options%stability = stability /= 0
    if (leave == 0) then
      call follow_family(family, system, options, begin, problem, cancel(1))
    else
      call follow_family(family, system, options, begin, problem, cancel(1), begin_nu, begin_p, &
                         along)
    end if
  end if
  if (.not. problem%failed()) then
    n = size(family%parameter)
    n_points = n
    ended = family%outcome
    nu(:n) = family%nu
    energy(:n) = family%energy
    truncation(:n) = family%truncation
    error(:n) = family%error
    off(:n) = family%off
    highest = family%highest
    m = size(family%x, 1)
    x(:m, :n) = family%x
    if (options%stability) then
      multipliers(:, :n) = family%multipliers
      growing(:n) = [(count_larger(family%multipliers(:, i), free_circle), i=1, n)]
    end if
    n_folds = min(size(family%folds), max_special)
    folds(:n_folds) = family%folds(:n_folds)
    fold_errors(:n_folds) = family%fold_errors(:n_folds)
    n = min(size(family%branch_p), max_special)
    n_branch_points = n
    branch_points(:n) = family%branch_p(:n)
    branch_point_nu(:n) = family%branch_nu(:n)
    branch_point_x(:m, :n) = family%branch_x(:, :n)
    across(:m + 2, :n) = family%across(:, :n)
    before(:n) = family%branch_before(:n)
  end if
  call report(problem, status)
end subroutine pendulum_backbone
