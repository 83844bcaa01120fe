!> Monomials of a system for a block of vector lanes: their accelerations and derivatives.
module viscovib_monomial_lanes
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: add_multiple, multiply_lanes, n_lanes
  use viscovib_polynomial, only: monomial_type
  implicit none
  private

  public :: add_monomial_slopes, take_monomials

contains

  !> a := a - M^(-1) c prod_d u_d^p_d.
  pure subroutine take_monomials(monomials, n_dof, inverse, q, a)
    type(monomial_type), intent(in) :: monomials(:)
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: inverse(n_dof, n_dof), q(n_lanes, n_dof)
    real(wp), intent(inout) :: a(n_lanes, n_dof)
    real(wp) :: product(n_lanes)
    integer :: d, i, j

    do i = 1, size(monomials)
      associate (m => monomials(i))
        product = m%coefficient
        do j = 1, size(m%dof)
          call multiply_lanes(product, q(:, m%dof(j)), m%power(j))
        end do
        do d = 1, n_dof
          if (abs(inverse(d, m%equation)) > 0.0_wp) then
            call add_multiple(a(:, d), -inverse(d, m%equation), product)
          end if
        end do
      end associate
    end do
  end subroutine take_monomials

  !> Add the derivatives of these accelerations with respect to coordinates (product rule).
  pure subroutine add_monomial_slopes(monomials, n_dof, inverse, q, by_q)
    type(monomial_type), intent(in) :: monomials(:)
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: inverse(n_dof, n_dof), q(n_lanes, n_dof)
    !> Shape (n_lanes, equation, by).
    real(wp), intent(inout) :: by_q(n_lanes, n_dof, n_dof)
    real(wp) :: product(n_lanes)
    integer :: d, i, j, k

    do i = 1, size(monomials)
      associate (m => monomials(i))
        do j = 1, size(m%dof)
          product = m%coefficient*m%power(j)
          do k = 1, size(m%dof)
            call multiply_lanes(product, q(:, m%dof(k)), m%power(k) - merge(1, 0, k == j))
          end do
          do d = 1, n_dof
            call add_multiple(by_q(:, d, m%dof(j)), -inverse(d, m%equation), product)
          end do
        end do
      end associate
    end do
  end subroutine add_monomial_slopes

end module viscovib_monomial_lanes
