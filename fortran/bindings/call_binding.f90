! The routines of the core for f2py: `viscovib_calls` explains their arguments.

!> Do a task, its values packed.
subroutine begin_call(text, integers, n_integers, numbers, n_numbers, cancel, handle, sizes, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int, c_int64_t
  use viscovib_binding_tools, only: report
  use viscovib_calls, only: begin => begin_call
  use viscovib_status, only: status_type
  implicit none
  character(len=*), intent(in) :: text
  integer(c_int), intent(in) :: n_integers, n_numbers
  integer(c_int64_t), intent(in) :: integers(n_integers)
  real(c_double), intent(in) :: numbers(n_numbers)
  integer(c_int), intent(inout) :: cancel(1)
  integer(c_int64_t), intent(out) :: handle, sizes(3)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  type(status_type) :: outcome

  call begin(text, integers, numbers, cancel(1), handle, sizes, outcome)
  call report(outcome, status)
end subroutine begin_call

!> What a task found, packed; its handle is freed where keep is 0.
subroutine end_call(handle, keep, text, n_text, integers, n_integers, numbers, n_numbers, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int, c_int64_t
  use viscovib_binding_tools, only: report
  use viscovib_calls, only: finish => end_call
  use viscovib_status, only: status_type
  implicit none
  integer(c_int64_t), intent(in) :: handle
  integer(c_int), intent(in) :: keep, n_text, n_integers, n_numbers
  character(len=1), intent(out) :: text(n_text)
  integer(c_int64_t), intent(out) :: integers(n_integers)
  real(c_double), intent(out) :: numbers(n_numbers)
  integer(c_int), intent(out) :: status
  type(status_type) :: outcome

  call finish(handle, keep /= 0, text, integers, numbers, outcome)
  call report(outcome, status)
end subroutine end_call

!> Free an object; what builds on it keeps it.
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
