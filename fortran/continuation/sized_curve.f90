!> A curve along which the number of unknowns changes: as many as a tolerance needs.
!!
!! Unknowns come in blocks of one length, such as the harmonics of each coordinate. What
!! lies beyond that length is 0.
module viscovib_sized_curve
  use viscovib_curve, only: curve_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: sized_curve_type, refitted

  type, abstract, extends(curve_type) :: sized_curve_type
    !> Whether the number changes at all, the blocks, and unknowns at most.
    logical :: adaptive = .false.
    integer :: blocks = 1, n_most = 0
  contains
    procedure(left_out_interface), deferred :: left_out
    procedure(choose_interface), deferred :: choose_size
    procedure(resize_interface), deferred :: resize
  end type sized_curve_type

  abstract interface

    !> What the unknowns left out do at a solution (x, p).
    subroutine left_out_interface(self, x, p, pushed, short, own, closely)
      import :: sized_curve_type, wp
      class(sized_curve_type), intent(inout) :: self
      !> Shape (n).
      real(wp), intent(in) :: x(:), p
      !> Residuals they leave in the equations of those kept, shape (n), and by what factor these
      !! may fall short.
      real(wp), intent(out) :: pushed(:), short
      !> Their size relative to x.
      real(wp), intent(out) :: own
      !> Whether signs of residuals count, not their size alone: more is spent on them.
      logical, intent(in) :: closely
    end subroutine left_out_interface

    !> How many unknowns to go on with, which `resize` brings about.
    subroutine choose_interface(self, x, truncation, own, rounding, again)
      import :: sized_curve_type, wp
      class(sized_curve_type), intent(inout) :: self
      real(wp), intent(in) :: x(:)
      !> What leaving unknowns out changes, relative to x, and from `left_out`.
      real(wp), intent(in) :: truncation, own
      !> Below this no number of unknowns brings it.
      real(wp), intent(in) :: rounding
      !> The point is to be solved again, with more.
      logical, intent(out) :: again
    end subroutine choose_interface

    subroutine resize_interface(self)
      import :: sized_curve_type
      class(sized_curve_type), intent(inout) :: self
    end subroutine resize_interface

  end interface

contains

  !> Unknowns in n rows instead: each block is cut off, or goes on with zeros.
  pure function refitted(blocks, x, n) result(y)
    integer, intent(in) :: blocks, n
    real(wp), intent(in) :: x(:)
    real(wp) :: y(n)
    integer :: b, old, new, both

    old = size(x)/blocks
    new = n/blocks
    both = min(old, new)
    y = 0.0_wp
    do b = 0, blocks - 1
      y(b*new + 1:b*new + both) = x(b*old + 1:b*old + both)
    end do
  end function refitted

end module viscovib_sized_curve
