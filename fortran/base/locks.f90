!> A lock for tables shared by threads, which work without the table if the lock is taken, and a
!! lock for texts.
module viscovib_locks
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none
  private

  public :: take_lock, release_lock, lock_texts, unlock_texts

  interface
    integer(c_int) function c_take_lock() bind(c, name='viscovib_take_lock')
      import :: c_int
    end function c_take_lock

    !> Wait until no other thread creates texts of deferred length, whose lengths gfortran keeps in
    !! static memory. A thread that has this lock may acquire it again.
    subroutine lock_texts() bind(c, name='viscovib_lock_texts')
    end subroutine lock_texts

    subroutine unlock_texts() bind(c, name='viscovib_unlock_texts')
    end subroutine unlock_texts

    subroutine release_lock() bind(c, name='viscovib_release_lock')
    end subroutine release_lock
  end interface

contains

  !> True if this thread has the lock now.
  logical function take_lock()
    take_lock = c_take_lock() /= 0
  end function take_lock

end module viscovib_locks
