!> The abstract curve that continuation follows: the solutions (x, p) of
!! R(x, p) = 0, n equations in n unknowns and a parameter.
module viscovib_curve
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: curve_type

  !> Lower limit of `negligible`.
  real(wp), parameter, public :: negligible_at_least = 1.0e-5_wp

  type, abstract :: curve_type
    !> Number of unknowns.
    integer :: n = 0
    !> Exclusive lower bound of p.
    real(wp) :: lowest = -huge(1.0_wp)
    !> Limit of the unknowns; beyond it numbers may overflow.
    real(wp) :: largest = 1.0e60_wp
    !> Weights of squared unknowns in lengths, such as inertia, shape (n); 1 if not allocated.
    real(wp), allocatable :: weights(:)
    !> Unknowns that form one amplitude with a phase, such as a harmonic of a coordinate: the index
    !! of the last one of each such group, ascending; not allocated if there are no groups.
    integer, allocatable :: last_of_group(:)
    !> Groups below this fraction of the total are not checked separately.
    real(wp) :: negligible = negligible_at_least
    !> Index of an unknown without a weight whose relative error counts like that of the other
    !! unknowns, such as a frequency; 0: none.
    integer :: alone = 0
    real(wp), allocatable, private :: work(:, :), slope(:)
  contains
    procedure(equations_interface), deferred :: equations
    procedure :: residual
    procedure(terms_interface), deferred :: raise_terms
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
      !> Shape at least (n, n); elements beyond (n, n) are not changed.
      real(wp), intent(inout) :: jacobian(:, :)
      real(wp), intent(out) :: slope(:)
      !> False, without a result, if the equations are not defined at (x, p).
      logical, intent(out) :: inside
    end subroutine equations_interface

    !> Raise the size of the largest term of each equation, which determines its rounding error, by
    !! terms that the derivatives do not show because they cancel or round elsewhere.
    subroutine terms_interface(self, x, p, terms)
      import :: curve_type, wp
      class(curve_type), intent(in) :: self
      real(wp), intent(in) :: x(:), p
      !> Shape (n).
      real(wp), intent(inout) :: terms(:)
    end subroutine terms_interface

  end interface

contains

  !> R alone; a curve overrides this if R alone is cheaper.
  subroutine residual(self, x, p, r, inside)
    class(curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    logical, intent(out) :: inside
    if (.not. allocated(self%work)) allocate (self%work(self%n, self%n), self%slope(self%n))
    call self%equations(x, p, r, self%work, self%slope, inside)
  end subroutine residual

end module viscovib_curve
