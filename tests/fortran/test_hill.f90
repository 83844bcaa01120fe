!> Stability with memory: growing exponents along a branch through folds.
module test_hill
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_quiet_nan, ieee_value
  use testing, only: begin, check, check_close, check_ok
  use viscovib_catalogue, only: kernel_rzhanitsyn, new_kernel
  use viscovib_curve_branch, only: curve_branch_type, curve_options, follow_curve
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_hill, only: hill_type, new_hill
  use viscovib_hill_count, only: count_right
  use viscovib_hill_path, only: hill_path_type, new_hill_path
  use viscovib_hill_roots, only: find_exponents
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_mount, only: geometry_cubic, geometry_exact, mount_parameters, mount_type, new_mount
  use viscovib_oscillator_curve, only: new_oscillator_curve, oscillator_curve_type, vary_frequency
  use viscovib_status, only: status_type
  implicit none
  private

  public :: run_hill

contains

  subroutine run_hill()
    if (begin('the part between two folds grows')) then
      call follow(geometry_cubic)
      call follow(geometry_exact)
    end if
    if (begin('without integral of the kernel motions creep')) call creep()
  end subroutine run_hill

  subroutine example(geometry, beta, mount, load)
    integer, intent(in) :: geometry
    real(wp), intent(in) :: beta
    type(mount_type), intent(out) :: mount
    type(load_type), intent(out) :: load
    type(kernel_holder) :: kernels(1)
    type(status_type) :: status

    call new_kernel(kernels(1)%kernel, kernel_rzhanitsyn, [0.048_wp, 0.1_wp, beta], status)
    call check_ok(status)
    call new_mount(mount, mount_parameters(mass=1.0_wp, inertia=0.1_wp, offset=0.5_wp, &
                                           stiffness_x=10.0_wp, stiffness_phi=2.0_wp, &
                                           geometry=geometry, kernel_x=1, kernel_phi=1), &
                   kernels, status)
    call check_ok(status)
    call new_load(load, 2, [1], reshape([(0.5_wp, 0.0_wp), (0.0_wp, 0.0_wp)], [2, 1]), &
                  [(0.0_wp, 0.0_wp)], status)
    call check_ok(status)
  end subroutine example

  !> Where the branch runs backwards, exactly one exponent grows.
  subroutine follow(geometry)
    integer, intent(in) :: geometry
    type(mount_type), target :: mount
    type(load_type), target :: load
    type(harmonic_set_type) :: set
    type(oscillator_curve_type) :: curve
    type(curve_branch_type) :: branch
    type(hill_type) :: hill
    type(hill_path_type) :: path
    real(wp) :: x(20)
    complex(wp) :: exponents(8), near(8), value, nearby
    integer :: i, n_growing, backwards, found, again, total

    call example(geometry, 0.05_wp, mount, load)
    call new_harmonic_set(set, 9, .true., mount%degree)
    call new_oscillator_curve(curve, mount, load, set, vary_frequency)
    x = 0.0_wp
    call follow_curve(curve, curve_options(1.0_wp, 3.0_wp, 1.0e-10_wp, 500, 0.1_wp), x, branch)
    call check(branch%folds%n == 2, 'two folds')
    call new_hill(hill, mount, set)
    backwards = 0
    total = 0
    ! No exponent is known at first.
    near = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
    do i = 1, branch%n_points
      call hill%along(mount, branch%parameter(i), reshape(branch%x(:, i), [10, 2]))
      call count_growing(hill, mount, near(:0), n_growing)
      call check(n_growing == merge(1, 0, branch%direction(i) < 0.0_wp), 'one grows there')
      call new_hill_path(path, hill, mount, 0.0_wp, 4)
      call find_exponents(hill, mount, path, near, exponents)
      call count_right(hill, mount, exponents, path, again)
      call check(again == n_growing, 'and counted if it is known')
      total = total + path%n
      call count_growing(hill, mount, [(0.2_wp, 0.0_wp)], again)
      call check(again == n_growing, 'and if something else is thought to be')
      found = count(.not. ieee_is_nan(real(exponents)))
      call check(count(real(exponents(:found)) > 0.0_wp) == n_growing, 'and is found')
      call hill%determinant(mount, exponents(1), value, .false.)
      call hill%determinant(mount, exponents(1) + 0.01_wp, nearby, .false.)
      call check_close(abs(value), 0.0_wp, 1.0e-6_wp, 'a zero', floor=abs(nearby))
      backwards = backwards + n_growing
      near = exponents
    end do
    call check(backwards > 0, 'some run backwards')
    call check(total <= 6*branch%n_points, 'few determinants decide')
  end subroutine follow

  !> Two springs, two slow exponents at half the period of the determinant.
  subroutine creep()
    type(mount_type) :: mount
    type(load_type) :: load
    type(harmonic_set_type) :: set
    type(hill_type) :: hill
    real(wp) :: x(10, 2)
    complex(wp) :: none(0)
    integer :: n_growing
    logical :: half_wave

    call example(geometry_cubic, 0.0_wp, mount, load)
    x = 0.0_wp
    half_wave = .true.
    call new_harmonic_set(set, 9, half_wave, mount%degree)
    call new_hill(hill, mount, set)
    call hill%along(mount, 1.3_wp, x)
    call count_growing(hill, mount, none, n_growing)
    call check(n_growing == 2, 'odd orders')
    call new_harmonic_set(set, 4, .false., mount%degree)
    call new_hill(hill, mount, set)
    call hill%along(mount, 1.3_wp, x)
    call count_growing(hill, mount, none, n_growing)
    call check(n_growing == 2, 'all orders')
  end subroutine creep

  !> Growing exponents, in addition to the known ones.
  subroutine count_growing(hill, system, known, n_growing)
    type(hill_type), intent(inout) :: hill
    type(mount_type), intent(in) :: system
    complex(wp), intent(in) :: known(:)
    integer, intent(out) :: n_growing
    type(hill_path_type) :: path
    call new_hill_path(path, hill, system, 0.0_wp, 4)
    call count_right(hill, system, known, path, n_growing)
  end subroutine count_growing

end module test_hill
