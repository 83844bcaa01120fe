! Optimize: -O1
!> Sorting by insertion: few numbers, or numbers that are nearly sorted.
module viscovib_sorting
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: order_of, sort_falling, sort_reals

contains

  !> Places of keys in ascending order; equal keys keep their order.
  pure function order_of(keys) result(order)
    real(wp), intent(in) :: keys(:)
    integer :: order(size(keys))
    integer :: i, k
    do i = 1, size(keys)
      k = i - 1
      do while (k >= 1)
        if (.not. keys(order(k)) > keys(i)) exit
        order(k + 1) = order(k)
        k = k - 1
      end do
      order(k + 1) = i
    end do
  end function order_of

  !> Sort by decreasing keys; values with equal keys, such as a conjugate pair, keep their order.
  pure subroutine sort_falling(values, keys)
    complex(wp), intent(inout) :: values(:)
    !> Key of each value, same shape.
    real(wp), intent(in) :: keys(:)
    values = values(order_of(-keys))
  end subroutine sort_falling

  !> Sort in ascending order.
  pure subroutine sort_reals(values)
    real(wp), intent(inout) :: values(:)
    values = values(order_of(values))
  end subroutine sort_reals

end module viscovib_sorting
