!> Characteristic roots and free decay against closed forms, and the linear algebra for them.
module test_roots
  use testing, only: begin, check, check_close, check_fails, check_ok
  use viscovib_catalogue, only: kernel_prony, kernel_rabotnov, kernel_rzhanitsyn, new_kernel
  use viscovib_characteristic_matrix, only: characteristic_matrix, oscillator_matrix
  use viscovib_characteristic_roots, only: find_characteristic_roots, roots_type
  use viscovib_free_decay, only: decay_type, find_free_decay
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_orthogonal, only: add_rows, right_vectors
  use viscovib_polynomial, only: new_polynomial, polynomial_parameters, polynomial_type
  use viscovib_status, only: status_type
  use viscovib_symmetric_modes, only: symmetric_values
  implicit none
  private

  public :: run_roots

contains

  subroutine run_roots()
    if (begin('eigenvalues have the trace and the determinant of shifted matrices')) then
      call check_values()
    end if
    if (begin('modes with one kernel have a scalar equation each')) call check_modes()
    if (begin('roots without memory are those of quadratics')) call check_quadratics()
    if (begin('singular vectors of rows in parts are orthonormal')) call check_vectors()
    if (begin('exponentials are taken apart')) call check_decay()
    if (begin('a kernel with an integral of 1 has a root 0')) call check_neutral()
  end subroutine run_roots

  !> The second difference matrix: 4 sin^2(k pi/(2 n + 2)).
  subroutine check_values()
    real(wp), allocatable :: a(:, :), values(:)
    integer :: i, n
    do n = 1, 12
      allocate (a(n, n), values(n))
      a = 0.0_wp
      do i = 1, n
        a(i, i) = 2.0_wp
        if (i > 1) a(i, i - 1) = -1.0_wp
        if (i > 1) a(i - 1, i) = -1.0_wp
      end do
      ! The same eigenvalues with a full matrix, after a reflection.
      do i = 1, n - 1
        a = matmul(reflection(n, i), matmul(a, reflection(n, i)))
      end do
      call symmetric_values(a, values)
      do i = 1, n
        call check_close(values(i), 4.0_wp*sin(i*acos(-1.0_wp)/(2*n + 2))**2, 1.0e-13_wp, &
                         'eigenvalue', floor=1.0_wp)
      end do
      deallocate (a, values)
    end do
  end subroutine check_values

  pure function reflection(n, k) result(matrix)
    integer, intent(in) :: n, k
    real(wp) :: matrix(n, n), v(n)
    integer :: i
    v = [(sin(1.0_wp*i*k + 0.3_wp), i=1, n)]
    matrix = -2.0_wp*spread(v, 1, n)*spread(v, 2, n)/sum(v**2)
    do i = 1, n
      matrix(i, i) = matrix(i, i) + 1.0_wp
    end do
  end function reflection

  !> n uncoupled coordinates of mass 1 on springs with one kernel.
  subroutine find(squares, damping, kind, numbers, roots)
    real(wp), intent(in) :: squares(:), damping, numbers(:)
    !> Kind of the kernel; 0: none.
    integer, intent(in) :: kind
    type(roots_type), intent(out) :: roots
    type(polynomial_parameters) :: p
    type(polynomial_type) :: system
    type(kernel_holder) :: kernels(merge(1, 0, kind > 0))
    type(characteristic_matrix) :: matrix
    type(status_type) :: status
    integer :: i, n

    n = size(squares)
    allocate (p%mass(n, n), p%damping(n, n), p%stiffness(n, n, 1), source=0.0_wp)
    do i = 1, n
      p%mass(i, i) = 1.0_wp
      p%damping(i, i) = damping
      p%stiffness(i, i, 1) = squares(i)
    end do
    p%spring_kernel = [size(kernels)]
    allocate (p%base_direction(n), source=0.0_wp)
    allocate (p%coefficient(0), p%on(0), p%monomial_kernel(0), p%powers(n, 0))
    if (kind > 0) call new_kernel(kernels(1)%kernel, kind, numbers, status)
    if (kind > 0) call check_ok(status)
    call new_polynomial(system, p, kernels, status)
    call check_ok(status)
    call oscillator_matrix(matrix, system, status)
    call check_ok(status)
    call find_characteristic_roots(matrix, roots)
  end subroutine find

  subroutine check_modes()
    real(wp), parameter :: squares(3) = [0.7_wp, 4.0_wp, 90.0_wp]
    type(roots_type) :: roots
    complex(wp) :: kept, s
    integer :: i

    call find(squares, 0.05_wp, kernel_rzhanitsyn, [0.048_wp, 0.1_wp, 0.05_wp], roots)
    call check(roots%complete .and. size(roots%oscillatory) == 3, 'all of them')
    do i = 1, 3
      s = roots%oscillatory(i)
      kept = 1.0_wp - 0.048_wp*gamma(0.1_wp)*(0.05_wp + s)**(-0.1_wp)
      call check_close(abs(s*s + 0.05_wp*s + squares(i)*kept)/squares(i), 0.0_wp, 1.0e-14_wp, &
                       'residual', floor=1.0_wp)
    end do
    call find(squares, 0.0_wp, kernel_rabotnov, [0.3_wp, 0.6_wp, 0.2_wp], roots)
    call check(roots%complete .and. roots%n_unstable == 3 .and. size(roots%real) == 3, 'growing')
    call find(squares, 0.0_wp, kernel_prony, [0.3_wp, 0.4_wp], roots)
    call check(roots%complete .and. size(roots%oscillatory) == 3, 'exponentials')
    do i = 1, 3
      s = roots%oscillatory(i)
      kept = 1.0_wp - 0.3_wp/(0.4_wp + s)
      call check_close(abs(s*s + squares(i)*kept)/squares(i), 0.0_wp, 1.0e-14_wp, 'residual', &
                       floor=1.0_wp)
    end do
  end subroutine check_modes

  !> s^2 + c s + k.
  subroutine check_quadratics()
    real(wp), parameter :: none(0) = [real(wp) ::]
    type(roots_type) :: roots
    integer :: i

    call find([1.0_wp, 9.0_wp], 4.0_wp, 0, none, roots)
    call check(roots%complete .and. size(roots%oscillatory) == 1, 'one oscillates')
    call check_close(real(roots%oscillatory(1)), -2.0_wp, 1.0e-13_wp, 'decay')
    call check_close(aimag(roots%oscillatory(1)), sqrt(5.0_wp), 1.0e-13_wp, 'frequency')
    do i = 1, 2
      call check_close(roots%real(i), -2.0_wp - (2*i - 3)*sqrt(3.0_wp), 1.0e-12_wp, 'real')
    end do
  end subroutine check_quadratics

  !> A Gamma(1)/beta = 1: s^2 + k s/(s + beta) = s (s (s + beta) + k)/(s + beta).
  subroutine check_neutral()
    type(roots_type) :: roots
    call find([9.0_wp], 0.0_wp, kernel_rzhanitsyn, [0.5_wp, 1.0_wp, 0.5_wp], roots)
    call check(size(roots%real) == 1, 'one real root')
    if (size(roots%real) == 1) call check(.not. abs(roots%real(1)) > 1.0e-15_wp, 'it is 0')
    call check(roots%n_unstable == 0 .and. roots%complete, 'not growing')
    call check_close(real(roots%oscillatory(1)), -0.25_wp, 1.0e-13_wp, 'decay')
  end subroutine check_neutral

  !> Rows in two parts have the Gram matrix of all rows; these are its eigenvectors.
  subroutine check_vectors()
    integer, parameter :: m = 30, n = 7
    real(wp) :: rows(m, n), r(n, n), part(m/2, n), left(n)
    real(wp), allocatable :: values(:), vectors(:, :)
    integer :: i, j, k

    do j = 1, n
      rows(:, j) = [(sin(0.7_wp*i*j) + 0.1_wp*cos(1.3_wp*i)*j, i=1, m)]*10.0_wp**(-j)
    end do
    r = 0.0_wp
    do k = 0, 1
      part = rows(k*m/2 + 1:(k + 1)*m/2, :)
      call add_rows(r, part)
    end do
    call right_vectors(r, 1.0e-14_wp, values, vectors)
    call check(size(values) == n, 'all of them')
    do k = 1, n
      left = matmul(matmul(rows, vectors(:, k)), rows) - values(k)**2*vectors(:, k)
      call check_close(maxval(abs(left)), 0.0_wp, 1.0e-14_wp, 'residual', floor=values(1)**2)
      left = matmul(vectors(:, k), vectors)
      left(k) = left(k) - 1.0_wp
      call check_close(maxval(abs(left)), 0.0_wp, 1.0e-13_wp, 'orthonormal', floor=1.0_wp)
      if (k > 1) call check(values(k) <= values(k - 1), 'falling')
    end do
  end subroutine check_vectors

  !> Two oscillations and creep in two coordinates; the second coordinate is small.
  subroutine check_decay()
    complex(wp), parameter :: s(2) = [(-0.02_wp, 1.5_wp), (-0.3_wp, 5.6_wp)]
    complex(wp), parameter :: a(2, 2) = reshape([(1.0_wp, 0.5_wp), (0.2_wp, -0.1_wp), &
                                                 (1.0e-6_wp, 0.0_wp), (3.0e-7_wp, 2.0e-7_wp)], &
                                                [2, 2])
    real(wp), parameter :: creep(2) = [0.3_wp, 2.0e-6_wp]
    type(decay_type) :: decay
    type(status_type) :: status
    real(wp) :: t(400), q(400, 2)
    integer :: i, j

    t = [(2.0_wp + 0.1_wp*i, i=1, size(t))]
    do j = 1, 2
      q(:, j) = creep(j)*exp(-0.05_wp*t)
      do i = 1, 2
        q(:, j) = q(:, j) + real(a(i, j)*exp(s(i)*t))
      end do
    end do
    call find_free_decay(t, q, 2, decay, status)
    call check_ok(status)
    do i = 1, 2
      call check_close(abs(decay%roots(i) - s(i)), 0.0_wp, 1.0e-9_wp, 'root', floor=1.0_wp)
      do j = 1, 2
        call check_close(abs(decay%amplitudes(i, j) - a(i, j)), 0.0_wp, 1.0e-8_wp, 'amplitude', &
                         floor=abs(a(1, j)))
      end do
    end do
    call check(decay%residual < 1.0e-11_wp, 'residual')
    call find_free_decay(t(:15), q(:15, :), 2, decay, status)
    call check_fails(status, '15 states after start, must be at least 16')
    call find_free_decay(t, 0.0_wp*q, 2, decay, status)
    call check_fails(status, 'is at rest')
    t(400) = t(400) + 0.01_wp
    call find_free_decay(t, q, 2, decay, status)
    call check_fails(status, 'equal steps')
  end subroutine check_decay

end module test_roots
