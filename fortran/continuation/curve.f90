!> The abstract curve that continuation follows: the solutions (x, p) of
!! R(x, p) = 0, n equations in n unknowns and a parameter.
module viscovib_curve
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: curve_type

  !> Part of all that a group of unknowns may have without being looked at alone, anywhere.
  real(wp), parameter, public :: negligible_at_least = 1.0e-5_wp

  type, abstract :: curve_type
    !> Number of unknowns.
    integer :: n = 0
    !> Values of p below which, exclusively, there is nothing.
    real(wp) :: lowest = -huge(1.0_wp)
    !> What counts as a large unknown: numbers may leave their range beyond it.
    real(wp) :: largest = 1.0e60_wp
    !> By which squares of unknowns weigh in lengths, such as inertia, shape (n); 1 if
    !! not allocated.
    real(wp), allocatable :: weights(:)
    !> Unknowns that are one number with a phase, such as an order of a coordinate: the last of
    !! each such group, ascending; not allocated where that means nothing.
    integer, allocatable :: last_of_group(:)
    !> Groups smaller than this part of all are not looked at alone.
    real(wp) :: negligible = negligible_at_least
    !> An unknown without a weight whose relative error counts as that of the others does, such as
    !! a frequency; 0: none.
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
      !> At least (n, n); what lies beyond is left alone.
      real(wp), intent(inout) :: jacobian(:, :)
      real(wp), intent(out) :: slope(:)
      !> False, and nothing computed, where the equations describe nothing.
      logical, intent(out) :: inside
    end subroutine equations_interface

    !> Raise the size of the largest term of each equation, by which it rounds, to that of terms
    !! that derivatives do not show, for they cancel there or round elsewhere.
    subroutine terms_interface(self, x, p, terms)
      import :: curve_type, wp
      class(curve_type), intent(in) :: self
      real(wp), intent(in) :: x(:), p
      !> Shape (n).
      real(wp), intent(inout) :: terms(:)
    end subroutine terms_interface

  end interface

contains

  !> R alone; a curve for which that is less work than all overrides this.
  subroutine residual(self, x, p, r, inside)
    class(curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    logical, intent(out) :: inside
    if (.not. allocated(self%work)) allocate (self%work(self%n, self%n), self%slope(self%n))
    call self%equations(x, p, r, self%work, self%slope, inside)
  end subroutine residual

end module viscovib_curve
