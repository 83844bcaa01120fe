!> Eigenvalues of the modulation equations at a steady motion.
module viscovib_flow_stability
  use viscovib_kinds, only: wp
  use viscovib_slow_flow, only: slow_flow_type
  implicit none
  private

  public :: flow_eigenvalues, real_matrix

contains

  !> Of da' = P da + Q conj(da). A mode tied to no other has s = Re P +- sqrt(|Q|^2 - (Im P)^2);
  !! the others are the roots of their characteristic polynomial.
  pure subroutine flow_eigenvalues(flow, a, values)
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(in) :: a(flow%n_modes)
    complex(wp), intent(out) :: values(2*flow%n_modes)
    complex(wp), dimension(flow%n_modes, flow%n_modes) :: p, q
    complex(wp) :: root
    logical :: alone(flow%n_modes)
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
    call eigenvalues(matrix, values(n + 1:))
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

  !> By the characteristic polynomial (Faddeev and LeVerrier) and its roots, found all at once
  !! (Aberth, Math. Comp. 27 (1973) 339); for a handful of unknowns of one scale.
  pure subroutine eigenvalues(matrix, values)
    real(wp), intent(in) :: matrix(:, :)
    complex(wp), intent(out) :: values(:)
    real(wp), dimension(size(matrix, 1), size(matrix, 1)) :: scaled, power
    real(wp) :: c(0:size(matrix, 1)), unit
    complex(wp) :: value, slope, step, others
    integer :: n, i, k, round
    logical :: settled

    n = size(matrix, 1)
    values = (0.0_wp, 0.0_wp)
    unit = maxval(sum(abs(matrix), 2))
    if (.not. unit > 0.0_wp) return
    scaled = matrix/unit
    power = 0.0_wp
    c(n) = 1.0_wp
    do k = 1, n
      do i = 1, n
        power(i, i) = power(i, i) + c(n - k + 1)
      end do
      power = matmul(scaled, power)
      c(n - k) = -sum([(power(i, i), i=1, n)])/k
    end do
    do i = 1, n
      values(i) = 0.7_wp*exp(cmplx(0.0_wp, 6.283185307179586_wp*(i - 0.77_wp)/n, wp))
    end do
    do round = 1, 100
      settled = .true.
      do i = 1, n
        value = (1.0_wp, 0.0_wp)
        slope = (0.0_wp, 0.0_wp)
        do k = n - 1, 0, -1
          slope = slope*values(i) + value
          value = value*values(i) + c(k)
        end do
        if (.not. abs(value) > 1.0e-15_wp*sum(abs(c)*abs(values(i))**[(k, k=0, n)])) cycle
        others = (0.0_wp, 0.0_wp)
        do k = 1, n
          if (k /= i .and. abs(values(i) - values(k)) > 0.0_wp) then
            others = others + 1.0_wp/(values(i) - values(k))
          end if
        end do
        others = slope - value*others
        if (.not. abs(others) > 0.0_wp) cycle
        step = value/others
        values(i) = values(i) - step
        settled = settled .and. abs(step) <= 1.0e-15_wp
      end do
      if (settled) exit
    end do
    values = values*unit
  end subroutine eigenvalues

end module viscovib_flow_stability
