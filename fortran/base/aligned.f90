! Optimize: -O2
!> Memory aligned to a cache line.
!!
!! A vector register of 64 bytes across two cache lines is stored and loaded at half the speed, and
!! Fortran has no alignment attribute. Arrays of hot loops are therefore sections of longer arrays,
!! starting at the first element on a boundary.
module viscovib_aligned
  use, intrinsic :: iso_c_binding, only: c_intptr_t, c_loc
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: first_aligned, settle

  integer(c_intptr_t), parameter :: line = 64, bytes = storage_size(1.0_wp)/8
  !> Elements to add to a length, so that an aligned section fits.
  integer, parameter, public :: alignment_slack = int(line/bytes) - 1

contains

  !> Index of the first element of x on a boundary of 64 bytes.
  pure integer function first_aligned(x)
    real(wp), intent(in), target :: x(:)
    first_aligned = 1 + int(modulo(-transfer(c_loc(x(1)), 0_c_intptr_t), line)/bytes)
  end function first_aligned

  !> Move the section that starts at `first` to the first boundary, since a copy of an array may
  !! have a different alignment.
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
