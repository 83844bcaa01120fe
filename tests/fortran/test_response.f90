!> Forced response of the mount: limits, laws, outcomes.
module test_response
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use testing, only: begin, check, check_close, check_fails, check_ok
  use viscovib_curve_record, only: curve_branch_type
  use viscovib_catalogue, only: kernel_abel, kernel_rzhanitsyn, new_kernel
  use viscovib_forced_response, only: forced_response
  use viscovib_grids, only: linear_grid
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_mount, only: geometry_cubic, geometry_exact, geometry_printed, mount_parameters, &
    mount_type, new_mount
  use viscovib_outcomes, only: outcome_converged, outcome_diverged, outcome_singular
  use viscovib_response, only: response_options, response_type
  use viscovib_response_plan, only: method_linear, method_successive, new_response_plan, &
    response_plan_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: run_response

contains

  subroutine run_response()
    type(response_type) :: linear, response
    type(status_type) :: status
    type(load_type) :: load
    type(curve_branch_type) :: branch
    integer :: geometry

    if (begin('a branch that is stopped before its first point has nothing to doubt')) then
      call branch%doubt_near_folds([1.0_wp])
      call check(branch%n_points == 0, 'points')
    end if

    if (begin('a small load answers linearly, with a cubic remainder')) then
      do geometry = geometry_exact, geometry_printed
        linear = solve(geometry, 1.0e-3_wp, [1.2_wp, 6.0_wp], method_linear)
        response = solve(geometry, 1.0e-3_wp, [1.2_wp, 6.0_wp], method_successive)
        call check(all(response%outcome == outcome_converged), 'converged')
        associate (change => response%coefficients(1, :, :) - linear%coefficients(1, :, :))
          call check_close(maxval(abs(change)), 0.0_wp, 1.0e-7_wp, 'first harmonics', floor=1.0_wp)
        end associate
        call check(maxval(abs(response%coefficients(2, :, :))) > 1.0e-13_wp, 'a third harmonic')
      end do
    end if

    if (begin('third harmonic grows with the cube of the load')) then
      linear = solve(geometry_cubic, 1.0e-3_wp, [1.2_wp], method_successive)
      response = solve(geometry_cubic, 2.0e-3_wp, [1.2_wp], method_successive)
      call check_close(abs(response%coefficients(2, 1, 1)/linear%coefficients(2, 1, 1)), 8.0_wp, &
                       1.0e-4_wp, 'ratio')
    end if

    if (begin('a large load diverges and leaves no number')) then
      response = solve(geometry_cubic, 1.0e4_wp, [1.2_wp, 6.0_wp], method_successive)
      call check(all(response%outcome == outcome_diverged), 'diverged')
      call check(all(ieee_is_nan(real(response%coefficients))), 'all NaN')
      call check(all(response%rate > 1.0_wp), 'rate above 1')
    end if

    if (begin('history holds a number for each iteration')) then
      response = solve(geometry_cubic, 0.1_wp, linear_grid(0.5_wp, 1.2_wp, 30), method_successive)
      call check(all(count(.not. ieee_is_nan(response%corrections), 1) == response%iterations), &
                 'count')
    end if

    if (begin('undamped resonance is singular')) then
      response = resonant()
      call check(all(response%outcome == [outcome_converged, outcome_singular]), 'outcomes')
    end if

    if (begin('terms of one order add up, vanishing ones go')) then
      call new_load(load, 2, [3, 1, 3, 2], &
                    reshape([(1.0_wp, 0.0_wp), (0.0_wp, 0.0_wp), (2.0_wp, 0.0_wp), &
                             (0.0_wp, 1.0_wp), (0.5_wp, 0.0_wp), (0.0_wp, 0.0_wp), &
                             (0.0_wp, 0.0_wp), (0.0_wp, 0.0_wp)], [2, 4]), &
                    spread((0.0_wp, 0.0_wp), 1, 4), status)
      call check_ok(status)
      call check(all(load%orders == [1, 3]), 'orders')
      call check_close(real(load%force(1, 2)), 1.5_wp, 1.0e-15_wp, 'sum')
      call check(load%is_odd(), 'odd')
    end if

    if (begin('an Abel kernel has no mean response')) call abel_mean()
  end subroutine run_response

  function solve(geometry, amplitude, nu, method) result(response)
    integer, intent(in) :: geometry, method
    real(wp), intent(in) :: amplitude, nu(:)
    type(response_type) :: response
    type(mount_type) :: mount
    type(load_type) :: load
    type(response_options) :: options
    type(response_plan_type) :: plan
    type(status_type) :: status

    call reference_mount(geometry, mount)
    call simple_load(1, amplitude, load)
    options%keep_history = .true.
    options%tolerance = 1.0e-13_wp
    call new_response_plan(plan, mount, load, nu, method, options, status)
    call check_ok(status)
    call forced_response(plan, mount, load, nu, response)
  end function solve

  subroutine simple_load(order, amplitude, load)
    integer, intent(in) :: order
    real(wp), intent(in) :: amplitude
    type(load_type), intent(out) :: load
    type(status_type) :: status
    complex(wp) :: force(2, 1)
    force = (0.0_wp, 0.0_wp)
    force(1, 1) = cmplx(merge(0.0_wp, amplitude, order == 0), &
                        merge(amplitude, 0.0_wp, order == 0), wp)
    call new_load(load, 2, [order], force, [(0.0_wp, 0.0_wp)], status)
    call check_ok(status)
  end subroutine simple_load

  subroutine reference_mount(geometry, mount)
    integer, intent(in) :: geometry
    type(mount_type), intent(out) :: mount
    type(mount_parameters) :: p
    type(kernel_holder) :: kernels(1)
    type(status_type) :: status

    p = mount_parameters(mass=1.0_wp, inertia=0.1_wp, offset=0.5_wp, stiffness_x=10.0_wp, &
                         stiffness_phi=2.0_wp, geometry=geometry, kernel_x=1, kernel_phi=1)
    call new_kernel(kernels(1)%kernel, kernel_rzhanitsyn, [0.048_wp, 0.1_wp, 0.05_wp], status)
    call check_ok(status)
    call new_mount(mount, p, kernels, status)
    call check_ok(status)
  end subroutine reference_mount

  !> Uncoupled body with natural frequencies 2 and 3, driven at 1 and 2.
  function resonant() result(response)
    type(response_type) :: response
    type(mount_type) :: mount
    type(mount_parameters) :: p
    type(kernel_holder) :: none(0)
    type(load_type) :: load
    type(response_options) :: options
    type(response_plan_type) :: plan
    type(status_type) :: status

    p = mount_parameters(mass=1.0_wp, inertia=1.0_wp, offset=0.0_wp, stiffness_x=4.0_wp, &
                         stiffness_phi=9.0_wp)
    call new_mount(mount, p, none, status)
    call check_ok(status)
    call simple_load(1, 1.0_wp, load)
    call new_response_plan(plan, mount, load, [1.0_wp, 2.0_wp], method_linear, options, status)
    call check_ok(status)
    call forced_response(plan, mount, load, [1.0_wp, 2.0_wp], response)
  end function resonant

  subroutine abel_mean()
    type(mount_type) :: mount
    type(mount_parameters) :: p
    type(kernel_holder) :: kernels(1)
    type(load_type) :: load
    type(response_options) :: options
    type(response_plan_type) :: plan
    type(status_type) :: status

    p = mount_parameters(mass=1.0_wp, inertia=0.1_wp, offset=0.5_wp, stiffness_x=10.0_wp, &
                         stiffness_phi=2.0_wp, kernel_x=1)
    call new_kernel(kernels(1)%kernel, kernel_abel, [0.1_wp, 0.5_wp], status)
    call new_mount(mount, p, kernels, status)
    call check_ok(status)
    call simple_load(0, 1.0_wp, load)
    call new_response_plan(plan, mount, load, [1.0_wp], method_linear, options, status)
    call check_fails(status, 'no finite integral')
    call simple_load(1, 1.0_wp, load)
    call new_response_plan(plan, mount, load, [1.0_wp], method_linear, options, status)
    call check_ok(status)
  end subroutine abel_mean

end module test_response
