!> Motion with memory: quadrature, sums of exponentials, against closed forms.
module test_hereditary
  use testing, only: begin, check, check_close, check_ok
  use viscovib_kernel, only: kernel_type
  use viscovib_kinds, only: wp
  use viscovib_prony, only: new_prony, prony_kernel
  use viscovib_gauss_points, only: points_16, points_32, points_8, weights_16, weights_32, weights_8
  use viscovib_quadrature, only: gauss_nodes, gauss_power_nodes, nodes_of_recurrence, recurrence_of
  use viscovib_rabotnov, only: new_rabotnov, rabotnov_kernel
  use viscovib_rzhanitsyn, only: new_rzhanitsyn, rzhanitsyn_kernel
  use viscovib_status, only: status_type
  use viscovib_tabulated, only: interpolation_linear, new_tabulated, tabulated_kernel
  implicit none
  private

  public :: run_hereditary_suite

contains

  subroutine run_hereditary_suite()
    if (begin('quadrature with a power weight')) call power_weight()
    if (begin('tabulated Gauss rules')) call tabulated_rules()
    if (begin('Gauss rule of a discrete measure')) call discrete_measure()
    if (begin('local rules integrate the kernel')) call local_integrals()
    if (begin('short sums of exponentials')) call short_sums()
  end subroutine run_hereditary_suite

  !> integral x^(alpha-1+k) = 1/(alpha+k) up to degree 2n-1.
  subroutine power_weight()
    real(wp), parameter :: alphas(4) = [0.01_wp, 0.1_wp, 0.5_wp, 1.0_wp]
    real(wp) :: x(12), w(12)
    integer :: i, k
    do i = 1, size(alphas)
      call gauss_power_nodes(12, alphas(i), x, w)
      do k = 0, 23
        call check_close(sum(w*x**k), 1.0_wp/(alphas(i) + k), 2.0e-14_wp, 'moment')
      end do
    end do
  end subroutine power_weight

  subroutine tabulated_rules()
    real(wp) :: x(32), w(32)
    call gauss_nodes(32, x, w)
    call check(maxval(abs(x - points_32)) < 4.0e-16_wp, '32 nodes')
    call check(maxval(abs(w - weights_32)) < 1.0e-15_wp, '32 weights')
    call gauss_nodes(16, x(:16), w(:16))
    call check(maxval(abs(x(:16) - points_16)) < 4.0e-16_wp, '16 nodes')
    call check(maxval(abs(w(:16) - weights_16)) < 1.0e-15_wp, '16 weights')
    call gauss_nodes(8, x(:8), w(:8))
    call check(maxval(abs(x(:8) - points_8)) < 4.0e-16_wp, '8 nodes')
    call check(maxval(abs(w(:8) - weights_8)) < 1.0e-15_wp, '8 weights')
  end subroutine tabulated_rules

  !> The rule has the moments of the measure up to degree 2n-1.
  subroutine discrete_measure()
    real(wp) :: points(150), masses(150), diagonal(10), nearby(10), x(10), w(10)
    integer :: k, found
    points = [(exp(-0.4_wp*k), k=0, 149)]
    masses = [(exp(-0.3_wp*k), k=0, 149)]
    call recurrence_of(points, masses, 10, diagonal, nearby, found)
    call nodes_of_recurrence(found, diagonal, nearby, x, w)
    do k = 0, 19
      call check_close(sum(w*x**k)*sum(masses), sum(masses*points**k), 1.0e-13_wp, 'moment')
    end do
    call recurrence_of([1.0_wp, 2.0_wp], [1.0_wp, 1.0_wp], 10, diagonal, nearby, found)
    call check(found == 2, 'two points have two polynomials')
  end subroutine discrete_measure

  !> From 0 to far beyond the decay of the kernel: its integral. For exp(-t) times R: the
  !! difference of two sums of the rule (Rzhanitsyn with beta + 1).
  subroutine local_integrals()
    class(kernel_type), allocatable :: kernel
    type(rzhanitsyn_kernel) :: rzhanitsyn
    type(rabotnov_kernel) :: rabotnov
    type(prony_kernel) :: prony
    type(tabulated_kernel) :: tabulated
    type(status_type) :: status

    call new_rzhanitsyn(rzhanitsyn, 0.7_wp, 0.05_wp, 3.0_wp, status)
    allocate (kernel, source=rzhanitsyn)
    call compare(20.0_wp, 1.0e-14_wp, 'rzhanitsyn')
    ! With alpha = 1 and z = beta t: A (1 - exp(-z))/beta.
    call new_rabotnov(rabotnov, 0.7_wp, 1.0_wp, 3.0_wp, status)
    deallocate (kernel)
    allocate (kernel, source=rabotnov)
    call compare(15.0_wp, 1.0e-13_wp, 'rabotnov')
    call new_prony(prony, [0.5_wp, 2.0_wp], [1.0_wp, 1000.0_wp], status)
    deallocate (kernel)
    allocate (kernel, source=prony)
    call compare(40.0_wp, 1.0e-14_wp, 'prony')
    call new_tabulated(tabulated, [0.0_wp, 1.0_wp, 3.0_wp], [2.0_wp, 1.0_wp, 0.2_wp], &
                       interpolation_linear, status)
    deallocate (kernel)
    allocate (kernel, source=tabulated)
    call compare(5.0_wp, 1.0e-14_wp, 'tabulated')

  contains

    subroutine compare(tau, tolerance, name)
      real(wp), intent(in) :: tau, tolerance
      character(len=*), intent(in) :: name
      real(wp), allocatable :: nodes(:, :), weights(:, :), x(:), w(:)
      call check_ok(status)
      call kernel%local_rules([tau, 0.3_wp*tau], nodes, weights)
      call check_close(sum(weights(:, 1)), kernel%integral(), tolerance, name)
      ! A rule from 0 to a point and a rule from this point give the whole integral.
      call kernel%lag_rule(0.3_wp*tau, tau, x, w)
      call check_close(sum(weights(:, 2)*nodes(:, 2)) + sum(w*x), sum(weights(:, 1)*nodes(:, 1)), &
                       tolerance, name//' in two pieces')
    end subroutine compare

  end subroutine local_integrals

  subroutine short_sums()
    type(rzhanitsyn_kernel) :: kernel
    type(rabotnov_kernel) :: rabotnov
    type(status_type) :: status
    real(wp), parameter :: tolerances(3) = [1.0e-6_wp, 1.0e-10_wp, 1.0e-13_wp]
    ! Upper bounds, 10 % above the smallest known numbers 34, 52 and 66.
    integer, parameter :: most(3) = [38, 59, 75]
    real(wp), allocatable :: weights(:), rates(:)
    integer :: i

    call new_rzhanitsyn(kernel, 1.0_wp, 0.1_wp, 0.0_wp, status)
    do i = 1, 3
      call kernel%exponentials(tolerances(i), 1.0e-4_wp, 1.0e4_wp, weights, rates)
      call check(size(weights) <= most(i), 'number of terms')
      call check(all(weights > 0.0_wp) .and. all(rates >= 0.0_wp), 'positive')
      call check(error_of(kernel) <= max(tolerances(i), 2.0e-14_wp), 'error')
    end do
    call new_rabotnov(rabotnov, 1.0_wp, 0.6_wp, 0.5_wp, status)
    call rabotnov%exponentials(1.0e-9_wp, 1.0e-3_wp, 1.0e3_wp, weights, rates)
    call check(error_of(rabotnov) <= 1.0e-9_wp, 'error of rabotnov')

  contains

    real(wp) function error_of(k)
      class(kernel_type), intent(in) :: k
      real(wp) :: t(1), exact(1), near
      integer :: j
      error_of = 0.0_wp
      do j = 0, 400
        t = 1.0e-3_wp*10.0_wp**(j*6.0_wp/400)
        call k%value(t, exact)
        near = sum(weights*exp(-min(rates*t(1), 700.0_wp)))
        error_of = max(error_of, abs(near/exact(1) - 1.0_wp))
      end do
    end function error_of

  end subroutine short_sums

end module test_hereditary
