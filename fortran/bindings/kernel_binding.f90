! Flat routines over the relaxation kernels, for f2py. A kernel is its kind
! code and parameters as in `viscovib_catalogue`; nothing is kept between calls.
! `status` is a category of `viscovib_status` and `message` its one line.

!> R_c - i R_s at mu.
subroutine kernel_transform(kind, data, n_data, mu, n, transform, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_kernel, report
  use viscovib_kernel, only: kernel_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind, n_data, n
  real(c_double), intent(in) :: data(n_data), mu(n)
  complex(c_double_complex), intent(out) :: transform(n)
  integer(c_int), intent(out) :: status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  !> Parts small enough to stay in cache between the two passes.
  integer, parameter :: part = 1024
  class(kernel_type), allocatable :: kernel
  type(status_type) :: outcome
  real(c_double) :: cosine(part), sine(part)
  integer :: first, m

  call make_kernel(kernel, kind, data, outcome)
  if (.not. outcome%failed()) then
    do first = 1, n, part
      m = min(part, n - first + 1)
      call kernel%transform(mu(first:first + m - 1), cosine(:m), sine(:m))
      transform(first:first + m - 1) = cmplx(cosine(:m), -sine(:m), c_double_complex)
    end do
  end if
  call report(outcome, status, message)
end subroutine kernel_transform

!> Laplace transform at s.
subroutine kernel_laplace(kind, data, n_data, s, n, transform, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_kernel, report
  use viscovib_kernel, only: kernel_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind, n_data, n
  real(c_double), intent(in) :: data(n_data)
  complex(c_double_complex), intent(in) :: s(n)
  complex(c_double_complex), intent(out) :: transform(n)
  integer(c_int), intent(out) :: status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  class(kernel_type), allocatable :: kernel
  type(status_type) :: outcome

  call make_kernel(kernel, kind, data, outcome)
  if (.not. outcome%failed()) call kernel%laplace(s, transform)
  call report(outcome, status, message)
end subroutine kernel_laplace

!> R(t) at t > 0.
subroutine kernel_value(kind, data, n_data, t, n, r, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_kernel, report
  use viscovib_kernel, only: kernel_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind, n_data, n
  real(c_double), intent(in) :: data(n_data), t(n)
  real(c_double), intent(out) :: r(n)
  integer(c_int), intent(out) :: status
  character(len=512), intent(out) :: message
  !f2py threadsafe
  class(kernel_type), allocatable :: kernel
  type(status_type) :: outcome

  call make_kernel(kernel, kind, data, outcome)
  if (.not. outcome%failed()) call kernel%value(t, r)
  call report(outcome, status, message)
end subroutine kernel_value

!> integral of R, +infinity where there is none.
subroutine kernel_integral(kind, data, n_data, integral, status, message)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_kernel, report
  use viscovib_kernel, only: kernel_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind, n_data
  real(c_double), intent(in) :: data(n_data)
  real(c_double), intent(out) :: integral
  integer(c_int), intent(out) :: status
  character(len=512), intent(out) :: message
  class(kernel_type), allocatable :: kernel
  type(status_type) :: outcome

  integral = 0.0_c_double
  call make_kernel(kernel, kind, data, outcome)
  if (.not. outcome%failed()) integral = kernel%integral()
  call report(outcome, status, message)
end subroutine kernel_integral
