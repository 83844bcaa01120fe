! Optimize: -O2
!> Coefficients of Gauss-Legendre collocation with s nodes (order 2s), for
!! second-order systems, laid out for the lanes.
!!
!! Hairer, Lubich, Wanner, Geometric Numerical Integration, II.1.3; the matrices
!! use shifted Legendre polynomials P_k, orthogonal at the nodes,
!! which avoids loss of digits.
module viscovib_gauss_table
  use viscovib_gauss_points, only: points_16, points_8, weights_16, weights_8
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_quadrature, only: gauss_nodes, legendre
  implicit none
  private

  public :: gauss_table_type, new_gauss_table

  !> Capacity for 16 nodes. All arrays have fixed sizes, so that the compiler can assume
  !! contiguous sections.
  integer, parameter, public :: max_blocks = 2

  type :: gauss_table_type
    integer :: n_nodes = 0, n_blocks = 0
    !> Nodes, weights of q' and of q, node i in lane and block; lanes after the
    !! last node repeat it, with weight 0.
    real(wp), dimension(n_lanes, max_blocks) :: nodes = 0.0_wp, weights = 0.0_wp, &
                                                weights_q = 0.0_wp
    !> a_ij, its square, and the matrix that predicts the accelerations at the nodes of the
    !! next step from those of this one (least squares by a polynomial). Lane of
    !! i, lane of j, block of j, block of i.
    real(wp), dimension(n_lanes, n_lanes, max_blocks, max_blocks) :: a = 0.0_wp, a_q = 0.0_wp, &
                                                                     extrapolation = 0.0_wp
  end type gauss_table_type

contains

  !> Table for s nodes, extrapolating with a polynomial of the given degree.
  pure subroutine new_gauss_table(table, s, degree)
    type(gauss_table_type), intent(out) :: table
    integer, intent(in) :: s, degree
    real(wp) :: c(s), b(s), a(s, s), square(s, s), next(s, s)
    real(wp) :: p(0:s + 1, s), beyond(0:s + 1, s), start(0:s + 1), integrals(s, 0:s - 1)
    integer :: i, j, k

    select case (s)
    case (8)
      c = points_8
      b = weights_8
    case (16)
      c = points_16
      b = weights_16
    case default
      call gauss_nodes(s, c, b)
    end select
    start = legendre(s + 1, 0.0_wp)
    do i = 1, s
      p(:, i) = legendre(s + 1, c(i))
      beyond(:, i) = legendre(s + 1, 1.0_wp + c(i))
    end do
    ! a_ij = b_j sum_k (2k+1) P_k(c_j) integral_0^c_i P_k, the integral being
    ! [P_(k+1) - P_(k-1)]/(2 (2k+1)) between its limits.
    integrals(:, 0) = c
    do k = 1, s - 1
      integrals(:, k) = 0.5_wp*((p(k + 1, :) - start(k + 1)) - (p(k - 1, :) - start(k - 1)))
    end do
    a = matmul(integrals, p(0:s - 1, :))
    do k = 0, min(degree, s - 1)
      beyond(k, :) = (2*k + 1)*beyond(k, :)
    end do
    next = matmul(transpose(beyond(0:min(degree, s - 1), :)), p(0:min(degree, s - 1), :))
    do j = 1, s
      a(:, j) = b(j)*a(:, j)
      next(:, j) = b(j)*next(:, j)
    end do
    square = matmul(a, a)

    table%n_nodes = s
    table%n_blocks = (s + n_lanes - 1)/n_lanes
    do i = 1, s
      associate (l => mod(i - 1, n_lanes) + 1, to => (i - 1)/n_lanes + 1)
        table%nodes(l, to) = c(i)
        table%weights(l, to) = b(i)
        table%weights_q(l, to) = b(i)*(1.0_wp - c(i))
        do j = 1, s
          associate (m => mod(j - 1, n_lanes) + 1, from => (j - 1)/n_lanes + 1)
            table%a(l, m, from, to) = a(i, j)
            table%a_q(l, m, from, to) = square(i, j)
            table%extrapolation(l, m, from, to) = next(i, j)
          end associate
        end do
      end associate
    end do
    ! Lanes without a node repeat the last one, without weight: their changes equal those
    ! of a node, so that they do not disturb the convergence test.
    if (s < n_lanes) then
      do i = s + 1, n_lanes
        table%nodes(i, 1) = table%nodes(s, 1)
        table%a(i, :, 1, 1) = table%a(s, :, 1, 1)
        table%a_q(i, :, 1, 1) = table%a_q(s, :, 1, 1)
        table%extrapolation(i, :, 1, 1) = table%extrapolation(s, :, 1, 1)
      end do
    end if
  end subroutine new_gauss_table

end module viscovib_gauss_table
