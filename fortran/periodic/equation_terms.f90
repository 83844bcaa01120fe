! Optimize: -O2 -fvect-cost-model=dynamic
!> The largest terms of the equations of harmonic balance, which determine their rounding errors.
module viscovib_equation_terms
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: raise_by_inertia

contains

  !> Raise the size of the largest term of each equation to that of inertia, which cancels with
  !! stiffness in the derivatives near a resonance; then raise all orders of a coordinate to the
  !! largest, since forces are sums over samples that all orders share.
  pure subroutine raise_by_inertia(mass, rates, x, terms)
    real(wp), intent(in) :: mass(:, :)
    !> Circular frequency of each unknown of a coordinate, shape (n_rows).
    real(wp), intent(in) :: rates(:)
    !> Shape (n_rows size(mass, 1)), coordinate by coordinate, like `terms`.
    real(wp), intent(in) :: x(:)
    real(wp), intent(inout) :: terms(:)
    real(wp) :: largest(size(mass, 1)), most
    integer :: d, rows

    rows = size(rates)
    do d = 1, size(largest)
      largest(d) = maxval(rates**2*abs(x((d - 1)*rows + 1:d*rows)))
    end do
    do d = 1, size(largest)
      most = max(maxval(terms((d - 1)*rows + 1:d*rows)), maxval(abs(mass(d, :))*largest))
      terms((d - 1)*rows + 1:d*rows) = most
    end do
  end subroutine raise_by_inertia

end module viscovib_equation_terms
