!> Multipliers without memory against closed forms; eigenvalues of small matrices.
module test_floquet
  use testing, only: begin, check, check_close, check_ok
  use viscovib_constants, only: pi
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_motion_stability, only: stability_checker, new_stability_checker, stability_type
  use viscovib_polynomial, only: new_polynomial, polynomial_parameters, polynomial_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: run_floquet

contains

  subroutine run_floquet()
    if (begin('eigenvalues of a companion matrix are its roots')) call companion()
    if (begin('eigenvalues of matrices far from normal')) call skewed()
    if (begin('eigenvalues that shifts by both of the last two never find')) call stubborn()
    if (begin('multipliers at rest are exponentials')) then
      call at_rest(.true.)
      call at_rest(.false.)
    end if
    if (begin('a Mathieu oscillator on the edge of its first instability')) call mathieu()
  end subroutine run_floquet

  subroutine companion()
    real(wp) :: a(6, 6)
    complex(wp) :: z(6), expected(6)
    logical :: found
    integer :: i

    ! (z - 3)(z + 2)(z^2 - z + 1/2)(z^2 + 1/100).
    a = 0.0_wp
    a(:2, :2) = reshape([1.0_wp, 1.0_wp, 6.0_wp, 0.0_wp], [2, 2])
    a(3:4, 3:4) = reshape([1.0_wp, 1.0_wp, -0.5_wp, 0.0_wp], [2, 2])
    a(5:6, 5:6) = reshape([0.0_wp, 1.0_wp, -0.01_wp, 0.0_wp], [2, 2])
    ! Similarity transformation by unit triangular matrices.
    do i = 2, 6
      a(i, :) = a(i, :) + 0.7_wp*a(i - 1, :)
      a(:, i - 1) = a(:, i - 1) - 0.7_wp*a(:, i)
    end do
    call eigenvalues(a, z, found)
    call check(found, 'found')
    expected = cmplx([3.0_wp, -2.0_wp, 0.5_wp, 0.5_wp, 0.0_wp, 0.0_wp], &
                     [0.0_wp, 0.0_wp, 0.5_wp, -0.5_wp, 0.1_wp, -0.1_wp], wp)
    call check(maxval(abs(z - expected)) <= 1.0e-13_wp, 'roots')
    call eigenvalues(0.0_wp*a, z, found)
    call check(found .and. all(abs(z) <= 0.0_wp), 'of nothing')
    a = 0.0_wp
    do i = 1, 6
      a(i, mod(i, 6) + 1) = 1.0_wp
    end do
    call eigenvalues(a, z, found)
    call check(found, 'roots of one found')
    call check(maxval(abs(z**6 - 1.0_wp)) <= 1.0e-13_wp, 'roots of one')
  end subroutine companion

  !> Trace, sum of squares and largest magnitude, at any scale.
  subroutine skewed()
    real(wp) :: a(4, 4)
    complex(wp) :: z(4)
    logical :: found
    integer :: i, j

    do j = 1, 4
      do i = 1, 4
        a(i, j) = sin(1.0_wp*i + 7.0_wp*j)*10.0_wp**(6*(i - j))
      end do
    end do
    call eigenvalues(a, z, found)
    call check(found, 'found')
    call check_close(real(sum(z)), sum([(a(i, i), i=1, 4)]), 1.0e-13_wp, 'trace')
    call check_close(real(sum(z**2)), sum(a*transpose(a)), 1.0e-12_wp, 'squares')
    call check(all(abs(z(2:)) <= abs(z(:3))), 'sorted')
    call eigenvalues(1.0e200_wp*a, z, found)
    call check_close(real(sum(z))*1.0e-200_wp, sum([(a(i, i), i=1, 4)]), 1.0e-13_wp, 'large')
  end subroutine skewed

  !> Two pairs of multipliers close to each other.
  subroutine stubborn()
    real(wp) :: a(4, 4), b(4, 4), r
    complex(wp) :: z(4)
    logical :: found
    integer :: i, k

    a = reshape([0.68529266_wp, 0.79090594_wp, 0.02263623_wp, 0.22054541_wp, 0.07914337_wp, &
                 0.13173456_wp, 0.02330697_wp, -0.13539662_wp, -0.00965101_wp, -0.01547126_wp, &
                 0.68566448_wp, 0.79667002_wp, -0.00159147_wp, 0.00127742_wp, 0.07950153_wp, &
                 0.1290801_wp], [4, 4])
    r = 0.0_wp
    do k = 1, 300
      b = a
      do i = 1, 4
        r = modulo(r + 0.6180339887_wp, 1.0_wp)
        b(i, 5 - i) = b(i, 5 - i)*(1.0_wp + 0.01_wp*r)
      end do
      call eigenvalues(b, z, found)
      call check(found, 'found')
      call check_close(real(sum(z)), sum([(b(i, i), i=1, 4)]), 1.0e-13_wp, 'trace')
      call check_close(real(sum(z**2)), sum(b*transpose(b)), 1.0e-13_wp, 'squares')
    end do
  end subroutine stubborn

  !> A chain of n masses, polynomial and slightly nonlinear, at rest.
  subroutine chain(n, system)
    integer, intent(in) :: n
    type(polynomial_type), intent(out) :: system
    type(polynomial_parameters) :: p
    type(kernel_holder) :: none(0)
    type(status_type) :: status
    integer :: i

    allocate (p%mass(n, n), p%damping(n, n), p%stiffness(n, n, 1), source=0.0_wp)
    do i = 1, n
      p%mass(i, i) = 1.0_wp/i
      p%stiffness(i, i, 1) = 2.0_wp
      if (i > 1) p%stiffness(i, i - 1, 1) = -1.0_wp
      if (i < n) p%stiffness(i, i + 1, 1) = -1.0_wp
    end do
    p%damping = 0.01_wp*p%stiffness(:, :, 1) + 0.03_wp*p%mass
    p%spring_kernel = [0]
    p%coefficient = [0.3_wp]
    p%on = [1]
    p%monomial_kernel = [0]
    allocate (p%powers(n, 1), source=0)
    p%powers(1, 1) = 3
    allocate (p%base_direction(n), source=0.0_wp)
    call new_polynomial(system, p, none, status)
    call check_ok(status)
  end subroutine chain

  !> One, two and three coordinates at nine frequencies; the last frequency is computed separately.
  subroutine at_rest(half_wave)
    logical, intent(in) :: half_wave
    type(polynomial_type) :: system
    type(harmonic_set_type) :: set
    type(stability_checker) :: checker
    type(stability_type) :: stability
    real(wp), allocatable :: x(:, :, :), flow(:, :)
    complex(wp), allocatable :: lambda(:), expected(:)
    real(wp) :: nu(9), worst
    logical :: found
    integer :: i, k, n

    nu = [(0.3_wp*1.5_wp**i, i=1, 9)]
    do n = 1, 3
      call chain(n, system)
      call new_harmonic_set(set, 7, half_wave, 3)
      allocate (x(2*size(set%orders), n, 9), flow(2*n, 2*n), lambda(2*n), expected(2*n))
      x = 0.0_wp
      call new_stability_checker(checker, system, set)
      call checker%check(system, nu, x, stability)
      call check(all(stability%stable == 1), 'stable')
      flow = 0.0_wp
      do i = 1, n
        flow(i, n + i) = 1.0_wp
        flow(n + i, :n) = -i*matmul(system%spread(i, :), system%gather)
        flow(n + i, n + 1:) = -i*system%damping(i, :)
      end do
      call eigenvalues(flow, lambda, found)
      worst = 0.0_wp
      do k = 1, 9
        expected = exp(2.0_wp*pi/nu(k)*lambda)
        do i = 1, 2*n
          worst = max(worst, minval(abs(stability%multipliers(:, k) - expected(i))), &
                      minval(abs(exp(2.0_wp*pi/nu(k)*stability%exponents(:, k)) - expected(i))))
        end do
      end do
      call check(worst <= 1.0e-11_wp, 'multipliers')
      deallocate (x, flow, lambda, expected)
    end do
  end subroutine at_rest

  !> x'' + k x + 0.3 x^3 along 0.2 sin t gives y'' + (a - 2 q cos 2t) y = 0. At the boundary
  !! a = 1 + q - q^2/8 - q^3/64 - q^4/1536 + 11 q^5/36864 (DLMF 28.6.2) both multipliers are 1.
  subroutine mathieu()
    type(polynomial_type) :: system
    type(harmonic_set_type) :: set
    type(stability_checker) :: checker
    type(stability_type) :: stability
    real(wp) :: x(2, 1, 1), q, a

    call chain(1, system)
    system%damping = 0.0_wp
    call new_harmonic_set(set, 1, .true., 3)
    x(:, 1, 1) = [0.2_wp, 0.0_wp]
    ! 3 * 0.3 * x^2 = 0.018 (1 - cos 2t).
    q = 0.009_wp
    a = 1.0_wp + q - q**2/8.0_wp - q**3/64.0_wp - q**4/1536.0_wp + 11.0_wp*q**5/36864.0_wp
    system%gather = a - 0.018_wp
    call new_stability_checker(checker, system, set)
    call checker%check(system, [1.0_wp], x, stability)
    call check_close(real(sum(stability%multipliers(:, 1))), 2.0_wp, 1.0e-11_wp, 'both are 1')
  end subroutine mathieu

end module test_floquet
