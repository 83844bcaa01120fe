!> The abstract curve that continuation follows: the solutions (x, p) of
!! R(x, p) = 0, n equations in n unknowns and a parameter.
module viscovib_curve
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: curve_type

  type, abstract :: curve_type
    !> Number of unknowns.
    integer :: n = 0
    !> Values of p below which, exclusively, there is nothing.
    real(wp) :: lowest = -huge(1.0_wp)
  contains
    procedure(equations_interface), deferred :: equations
  end type curve_type

  abstract interface

    !> R, dR/dx and dR/dp.
    subroutine equations_interface(self, x, p, r, jacobian, slope, inside)
      import :: curve_type, wp
      class(curve_type), intent(inout) :: self
      !> Shape (n).
      real(wp), intent(in) :: x(:)
      real(wp), intent(in) :: p
      real(wp), intent(out) :: r(:)
      !> At least (n, n); what lies beyond is left alone.
      real(wp), intent(inout) :: jacobian(:, :)
      real(wp), intent(out) :: slope(:)
      !> False, and nothing computed, where the equations describe nothing.
      logical, intent(out) :: inside
    end subroutine equations_interface

  end interface

end module viscovib_curve
