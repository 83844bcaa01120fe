! Routines for f2py that return the message of a failed call.

!> Length of the message of the last failed call on this thread.
subroutine last_message_length(n)
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none
  integer(c_int), intent(out) :: n
  interface
    integer(c_int) function kept_length() bind(c, name='viscovib_kept_length')
      import :: c_int
    end function kept_length
  end interface
  n = kept_length()
end subroutine last_message_length

!> Return and delete the message; n is from last_message_length.
subroutine last_message(text, n)
  use, intrinsic :: iso_c_binding, only: c_char, c_int
  implicit none
  integer(c_int), intent(in) :: n
  character(len=1), intent(out) :: text(n)
  interface
    subroutine take_message(work) bind(c, name='viscovib_take_message')
      import :: c_char
      character(kind=c_char), intent(out) :: work(*)
    end subroutine take_message
  end interface
  call take_message(text)
end subroutine last_message
