!> Memory that starts on a cache line.
!!
!! A vector register of 64 bytes that straddles two cache lines is stored and
!! read back at half the speed, and Fortran has no word for alignment: arrays of
!! hot loops are therefore cut out of a longer one, from the first element that
!! lies on a boundary.
module viscovib_aligned
  use, intrinsic :: iso_c_binding, only: c_intptr_t, c_loc
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: first_aligned, settle

  integer(c_intptr_t), parameter :: line = 64, bytes = storage_size(1.0_wp)/8
  !> Elements to add to a length, so that the wanted ones fit from any start.
  integer, parameter, public :: alignment_slack = int(line/bytes) - 1

contains

  !> Index of the first element of x on a boundary of 64 bytes.
  pure integer function first_aligned(x)
    real(wp), intent(in), target :: x(:)
    first_aligned = 1 + int(modulo(-transfer(c_loc(x(1)), 0_c_intptr_t), line)/bytes)
  end function first_aligned

  !> Bring what begins at `first` to the first boundary: a copy of an array may
  !! lie differently from the original.
  pure subroutine settle(x, first)
    real(wp), intent(inout) :: x(:)
    integer, intent(inout) :: first
    integer :: here
    here = first_aligned(x)
    if (here == first) return
    x = cshift(x, first - here)
    first = here
  end subroutine settle

end module viscovib_aligned
