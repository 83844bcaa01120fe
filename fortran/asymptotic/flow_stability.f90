!> Eigenvalues of the modulation equations at a steady motion.
module viscovib_flow_stability
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_slow_flow, only: slow_flow_type
  implicit none
  private

  public :: flow_eigenvalues, real_matrix

contains

  !> Eigenvalues of da' = P da + Q conj(da). An uncoupled mode has s = Re P +- sqrt(|Q|^2 - (Im
  !! P)^2); coupled modes have the eigenvalues of their matrix, NaN if these do not converge.
  pure subroutine flow_eigenvalues(flow, a, values)
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(in) :: a(flow%n_modes)
    complex(wp), intent(out) :: values(2*flow%n_modes)
    complex(wp), dimension(flow%n_modes, flow%n_modes) :: p, q
    complex(wp) :: root
    logical :: alone(flow%n_modes), found
    integer, allocatable :: tied(:)
    real(wp), allocatable :: matrix(:, :)
    integer :: i, k, n

    call flow%slopes(a, p, q)
    n = 0
    do i = 1, flow%n_modes
      alone(i) = .true.
      do k = 1, flow%n_modes
        if (k == i) cycle
        alone(i) = alone(i) .and. .not. (abs(p(i, k)) + abs(q(i, k)) + abs(p(k, i)) &
                                         + abs(q(k, i)) > 0.0_wp)
      end do
      if (.not. alone(i)) cycle
      root = sqrt(cmplx((abs(q(i, i)) - aimag(p(i, i)))*(abs(q(i, i)) + aimag(p(i, i))), 0.0_wp, &
                        wp))
      values(n + 1:n + 2) = real(p(i, i)) + [root, -root]
      n = n + 2
    end do
    tied = pack([(i, i=1, flow%n_modes)],.not. alone)
    if (size(tied) == 0) return
    allocate (matrix(2*size(tied), 2*size(tied)))
    matrix(:, :) = real_matrix(p(tied, tied), q(tied, tied))
    call eigenvalues(matrix, values(n + 1:), found)
    if (.not. found) values(n + 1:) = ieee_value(1.0_wp, ieee_quiet_nan)
  end subroutine flow_eigenvalues

  !> da -> P da + Q conj(da) on real parts, then imaginary ones.
  pure function real_matrix(p, q) result(matrix)
    complex(wp), intent(in) :: p(:, :), q(:, :)
    real(wp) :: matrix(2*size(p, 1), 2*size(p, 1))
    integer :: m
    m = size(p, 1)
    matrix(:m, :m) = real(p + q)
    matrix(:m, m + 1:) = aimag(q - p)
    matrix(m + 1:, :m) = aimag(p + q)
    matrix(m + 1:, m + 1:) = real(p - q)
  end function real_matrix

end module viscovib_flow_stability
