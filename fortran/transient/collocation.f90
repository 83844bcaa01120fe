! Optimize: -O3
!> Gauss collocation of an acceleration: a step of a second-order equation, and
!! the polynomial through the nodes and both ends that represents other quantities.
!!
!! u'' is the polynomial through its values a_j at the nodes c_j, so that
!!   u'(c_i) = v_0 + h sum_j A1_ij a_j,  u(c_k) = u_0 + c_k h v_0 + h^2 sum_j A2_kj a_j
!! (Hairer, Lubich, Wanner, Geometric Numerical Integration, II.1.3).
module viscovib_collocation
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: gauss_nodes, lagrange, lagrange_factors
  implicit none
  private

  public :: collocation_type, new_collocation

  !> Number of equal parts of a step at whose ends weights are kept.
  integer, parameter, public :: parts = 64

  type :: collocation_type
    integer :: s = 0
    !> 0, the nodes, 1; shape (0:s+1).
    real(wp), allocatable :: points(:)
    !> A1, shape (s, s); A2 at the nodes and the end, shape (s+1, s); weights of
    !! u' at the end, shape (s).
    real(wp), allocatable :: a1(:, :), a2(:, :), b(:)
    real(wp), allocatable, private :: factors(:)
    !> Derivatives of the polynomials at the points, shape (0:s+1, 0:s+1), one column per point.
    real(wp), allocatable, private :: derivatives(:, :)
    !> Weights of the values at the points for the last coefficient in Legendre
    !! polynomials, shape (0:s+1).
    real(wp), allocatable :: last_coefficient(:)
    !> Weights at parts of a step that were needed before: `weigh` of the parts, shape
    !! (0:s+1, 2, parts - 1), and which of them are known.
    real(wp), allocatable, private :: weights(:, :, :)
    logical, private :: known(parts - 1) = .false.
  contains
    procedure :: basis
    procedure :: slopes
    procedure :: weigh
  end type collocation_type

contains

  pure subroutine new_collocation(table, s)
    type(collocation_type), intent(out) :: table
    integer, intent(in) :: s
    real(wp) :: c(s), x(s), node_factors(s)
    real(wp) :: leading
    integer :: i, q

    allocate (table%points(0:s + 1), table%a1(s, s), table%a2(s + 1, s), table%b(s))
    table%s = s
    call gauss_nodes(s, c, table%b)
    table%points(0) = 0.0_wp
    table%points(1:s) = c
    table%points(s + 1) = 1.0_wp
    table%factors = lagrange_factors(table%points)
    allocate (table%derivatives(0:s + 1, 0:s + 1))
    do i = 0, s + 1
      table%derivatives(:, i) = derivatives_at(table%points, table%factors, i + 1)
    end do
    node_factors = lagrange_factors(c)
    ! P_m of [0, 1] leads with (2m)!/m!^2 x^m.
    leading = 1.0_wp
    do i = 1, s + 1
      leading = leading*(s + 1 + i)/i
    end do
    table%last_coefficient = table%factors/leading
    ! A1_ij = integral_0^c_i l_j, A2_ij = integral_0^c_i (c_i - x) l_j(x) dx, by the
    ! nodes themselves, exact for these degrees.
    table%a1 = 0.0_wp
    table%a2 = 0.0_wp
    do i = 1, s
      do q = 1, s
        x = c(i)*table%b(q)*lagrange(c, node_factors, c(i)*c(q))
        table%a1(i, :) = table%a1(i, :) + x
        table%a2(i, :) = table%a2(i, :) + c(i)*(1.0_wp - c(q))*x
      end do
    end do
    table%a2(s + 1, :) = table%b*(1.0_wp - c)
  end subroutine new_collocation

  !> Weights, shape (0:s+1), of the values at the points for the value at x.
  pure function basis(self, x)
    class(collocation_type), intent(in) :: self
    real(wp), intent(in) :: x
    real(wp) :: basis(0:self%s + 1)
    basis = lagrange(self%points, self%factors, x)
  end function basis

  !> Weights, shape (0:s+1), of the values at the points for the derivative at x,
  !! by the length of the step.
  pure function slopes(self, x)
    class(collocation_type), intent(in) :: self
    real(wp), intent(in) :: x
    real(wp) :: slopes(0:self%s + 1)
    slopes = matmul(self%derivatives, self%basis(x))
  end function slopes

  !> Both of these weights.
  subroutine weigh(self, x, basis, slopes)
    class(collocation_type), intent(inout) :: self
    real(wp), intent(in) :: x
    !> Shape (0:s+1).
    real(wp), intent(out) :: basis(0:self%s + 1), slopes(0:self%s + 1)
    real(wp) :: below
    integer :: k, part
    part = 0
    if (x > 0.0_wp .and. x < 1.0_wp) part = nint(x*parts)
    if (abs(x*parts - part) > 0.0_wp) part = 0
    if (part > 0) then
      if (self%known(part)) then
        basis = self%weights(:, 1, part)
        slopes = self%weights(:, 2, part)
        return
      end if
    end if
    below = 1.0_wp
    do k = 0, self%s + 1
      basis(k) = below*self%factors(k + 1)
      below = below*(x - self%points(k))
    end do
    below = 1.0_wp
    do k = self%s + 1, 0, -1
      basis(k) = basis(k)*below
      below = below*(x - self%points(k))
    end do
    slopes = 0.0_wp
    do k = 0, self%s + 1
      slopes = slopes + basis(k)*self%derivatives(:, k)
    end do
    if (part == 0) return
    if (.not. allocated(self%weights)) allocate (self%weights(0:self%s + 1, 2, parts - 1))
    self%known(part) = .true.
    self%weights(:, 1, part) = basis
    self%weights(:, 2, part) = slopes
  end subroutine weigh

  !> Derivatives at one of the points of the polynomials that are 1 at one point and 0 at the other
  !! points.
  pure function derivatives_at(points, factors, place) result(slopes)
    real(wp), intent(in) :: points(:), factors(:)
    integer, intent(in) :: place
    real(wp) :: slopes(size(points))
    integer :: k

    slopes(place) = 0.0_wp
    do k = 1, size(points)
      if (k == place) cycle
      slopes(k) = factors(k)/factors(place)/(points(place) - points(k))
      slopes(place) = slopes(place) + 1.0_wp/(points(place) - points(k))
    end do
  end function derivatives_at

end module viscovib_collocation
