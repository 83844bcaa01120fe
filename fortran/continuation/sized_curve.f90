! Optimize: -O2
!> A curve with an adaptive number of unknowns, as many as a tolerance requires.
!!
!! Unknowns come in blocks of equal length, such as the harmonics of each coordinate. Unknowns
!! beyond that length are 0.
module viscovib_sized_curve
  use viscovib_curve, only: curve_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: sized_curve_type, refitted

  type, abstract, extends(curve_type) :: sized_curve_type
    !> Whether the number is adapted, the number of blocks, and the largest number of unknowns.
    logical :: adaptive = .false.
    integer :: blocks = 1, n_most = 0
  contains
    procedure(left_out_interface), deferred :: left_out
    procedure(choose_interface), deferred :: choose_size
    procedure(resize_interface), deferred :: resize
  end type sized_curve_type

  abstract interface

    !> Effect of the neglected unknowns at a solution (x, p).
    subroutine left_out_interface(self, x, p, pushed, short, own, closely)
      import :: sized_curve_type, wp
      class(sized_curve_type), intent(inout) :: self
      !> Shape (n).
      real(wp), intent(in) :: x(:), p
      !> Their residuals in the included equations, shape (n), and the factor by which these may be
      !! too small.
      real(wp), intent(out) :: pushed(:), short
      !> Their size relative to x.
      real(wp), intent(out) :: own
      !> True if the signs of the residuals matter, not only their size; this costs more.
      logical, intent(in) :: closely
    end subroutine left_out_interface

    !> Choose the number of unknowns; `resize` applies it.
    subroutine choose_interface(self, x, truncation, own, rounding, again)
      import :: sized_curve_type, wp
      class(sized_curve_type), intent(inout) :: self
      real(wp), intent(in) :: x(:)
      !> Truncation error relative to x, and `own` from `left_out`.
      real(wp), intent(in) :: truncation, own
      !> Lower limit of the truncation error for any number of unknowns.
      real(wp), intent(in) :: rounding
      !> True if the point must be solved again with more unknowns.
      logical, intent(out) :: again
    end subroutine choose_interface

    subroutine resize_interface(self)
      import :: sized_curve_type
      class(sized_curve_type), intent(inout) :: self
    end subroutine resize_interface

  end interface

contains

  !> Resize to n unknowns: each block is truncated or padded with zeros.
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
