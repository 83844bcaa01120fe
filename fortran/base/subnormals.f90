! Optimize: -O1
!> Flushes subnormal numbers (below 1e-308) to 0, since operations with them take ten times as long.
module viscovib_subnormals
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none
  private

  public :: flushing_type

  !> A local variable of this type flushes from `begin` until its procedure returns, which restores
  !! the caller's mode.
  type :: flushing_type
    private
    logical :: begun = .false.
    integer(c_int) :: before = 0
  contains
    procedure :: begin
    final :: finish
  end type flushing_type

  interface
    integer(c_int) function c_flush() bind(c, name='viscovib_flush_subnormals')
      import :: c_int
    end function c_flush

    subroutine c_restore(before) bind(c, name='viscovib_restore_subnormals')
      import :: c_int
      integer(c_int), value :: before
    end subroutine c_restore
  end interface

contains

  subroutine begin(self)
    class(flushing_type), intent(inout) :: self
    self%before = c_flush()
    self%begun = .true.
  end subroutine begin

  subroutine finish(self)
    type(flushing_type), intent(inout) :: self
    if (self%begun) call c_restore(self%before)
    self%begun = .false.
  end subroutine finish

end module viscovib_subnormals
