!> One lock for tables that threads share: who does not get it at once works without the table.
module viscovib_locks
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none
  private

  public :: take_lock, release_lock

  interface
    integer(c_int) function c_take_lock() bind(c, name='viscovib_take_lock')
      import :: c_int
    end function c_take_lock

    subroutine release_lock() bind(c, name='viscovib_release_lock')
    end subroutine release_lock
  end interface

contains

  !> True if this thread has the lock now.
  logical function take_lock()
    take_lock = c_take_lock() /= 0
  end function take_lock

end module viscovib_locks
