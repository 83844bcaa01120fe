! Optimize: -O1
!> Sorting of complex and real numbers.
module viscovib_sorting
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: sort_falling, sort_reals

contains

  !> Sort by decreasing keys; values with equal keys, such as a conjugate pair, keep their order.
  pure subroutine sort_falling(values, keys)
    complex(wp), intent(inout) :: values(:)
    !> Key of each value, same shape.
    real(wp), intent(in) :: keys(:)
    real(wp) :: sorted(size(keys)), key
    complex(wp) :: next
    integer :: i, j

    sorted = keys
    do i = 2, size(values)
      next = values(i)
      key = sorted(i)
      j = i - 1
      do while (j > 0)
        if (sorted(j) >= key) exit
        values(j + 1) = values(j)
        sorted(j + 1) = sorted(j)
        j = j - 1
      end do
      values(j + 1) = next
      sorted(j + 1) = key
    end do
  end subroutine sort_falling

  !> Sort in ascending order, by insertion.
  pure subroutine sort_reals(values)
    real(wp), intent(inout) :: values(:)
    real(wp) :: one
    integer :: i, k
    do i = 2, size(values)
      one = values(i)
      k = i - 1
      do while (k >= 1)
        if (.not. values(k) > one) exit
        values(k + 1) = values(k)
        k = k - 1
      end do
      values(k + 1) = one
    end do
  end subroutine sort_reals

end module viscovib_sorting
