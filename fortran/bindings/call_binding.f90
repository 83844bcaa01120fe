! Routines of the core for f2py; see `viscovib_calls` for their arguments.

!> Run a task and pack its values. The status is -1 after a signal; no result is kept then.
subroutine begin_call(text, integers, n_integers, numbers, n_numbers, keep, cancel, handle, sizes, &
                      status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int, c_int64_t
  use viscovib_binding_tools, only: report
  use viscovib_calls, only: begin => begin_call, free => free_object
  use viscovib_status, only: status_type
  implicit none
  character(len=*), intent(in) :: text
  integer(c_int), intent(in) :: n_integers, n_numbers
  integer(c_int64_t), intent(in) :: integers(n_integers)
  real(c_double), intent(in) :: numbers(n_numbers)
  integer(c_int), intent(in) :: keep
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int64_t), intent(out) :: handle, sizes(4)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  type(status_type) :: outcome
  logical :: hears

  interface
    integer(c_int) function hear() bind(c, name='viscovib_hear')
      import :: c_int
    end function hear
    integer(c_int) function heard() bind(c, name='viscovib_heard')
      import :: c_int
    end function heard
  end interface

  hears = hear() /= 0
  call begin(text, integers, numbers, keep /= 0, cancel(1), handle, sizes, outcome)
  call report(outcome, status)
  if (.not. hears) return
  if (heard() == 0) return
  if (handle /= 0) call free(handle, outcome)
  handle = 0
  status = -1
end subroutine begin_call

!> Return the packed results of a task and free its handle. If n_numbers is 0 and the task has
!! numbers, the handle keeps them at their address.
subroutine end_call(handle, text, n_text, integers, n_integers, numbers, n_numbers, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int, c_int64_t
  use viscovib_binding_tools, only: report
  use viscovib_calls, only: finish => end_call
  use viscovib_status, only: status_type
  implicit none
  integer(c_int64_t), intent(in) :: handle
  integer(c_int), intent(in) :: n_text, n_integers, n_numbers
  character(len=1), intent(out) :: text(n_text)
  integer(c_int64_t), intent(out) :: integers(n_integers)
  real(c_double), intent(out) :: numbers(n_numbers)
  integer(c_int), intent(out) :: status
  type(status_type) :: outcome

  call finish(handle, text, integers, numbers, outcome)
  call report(outcome, status)
end subroutine end_call

!> Free an object. Objects that depend on it keep it alive.
subroutine free_object(handle, status)
  use, intrinsic :: iso_c_binding, only: c_int, c_int64_t
  use viscovib_binding_tools, only: report
  use viscovib_calls, only: free => free_object
  use viscovib_status, only: status_type
  implicit none
  integer(c_int64_t), intent(in) :: handle
  integer(c_int), intent(out) :: status
  type(status_type) :: outcome

  call free(handle, outcome)
  call report(outcome, status)
end subroutine free_object

!> Request long loops to stop with partial results (1), or to continue (0).
subroutine stop_loops(flag)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_stopping, only: want_stop
  implicit none
  integer(c_int), intent(in) :: flag
  call want_stop(flag /= 0)
end subroutine stop_loops

!> Stop loops of this thread with partial results when another thread sets flag(1), which must exist
!! as long as this thread.
subroutine listen(flag)
  use, intrinsic :: iso_c_binding, only: c_int
  implicit none
  integer(c_int), intent(inout) :: flag(1)
  interface
    subroutine c_listen(flag) bind(c, name='viscovib_listen')
      import :: c_int
      integer(c_int), intent(in) :: flag(1)
    end subroutine c_listen
  end interface
  call c_listen(flag)
end subroutine listen

!> Number of curve points and values that loops have started so far.
subroutine pieces_of_work(n)
  use, intrinsic :: iso_c_binding, only: c_int
  use viscovib_stopping, only: pieces_begun
  implicit none
  integer(c_int), intent(out) :: n
  n = pieces_begun()
end subroutine pieces_of_work

!> Set the procedure that evaluates functions of Python, by its address (see
!! viscovib_law_outside).
subroutine law_set_outside(address)
  use, intrinsic :: iso_c_binding, only: c_funptr, c_int64_t
  use viscovib_law_outside, only: set_outside
  implicit none
  integer(c_int64_t), intent(in) :: address
  type(c_funptr) :: procedure_at

  call set_outside(transfer(address, procedure_at))
end subroutine law_set_outside
