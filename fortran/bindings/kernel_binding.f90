! Flat routines over the relaxation kernels, for f2py. A kernel is its kind
! code and parameters as in `viscovib_catalogue`; nothing is kept between calls.
! `status` is a category of `viscovib_status`; its one line is what `last_message` gives.

!> R_c - i R_s at mu.
subroutine kernel_transform(kind, data, n_data, mu, n, transform, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int
  use viscovib_binding_tools, only: make_kernel, report
  use viscovib_kernel, only: kernel_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind, n_data, n
  real(c_double), intent(in) :: data(n_data), mu(n)
  complex(c_double_complex), intent(out) :: transform(n)
  integer(c_int), intent(out) :: status
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
  call report(outcome, status)
end subroutine kernel_transform

!> Laplace transform at s.
subroutine kernel_laplace(kind, data, n_data, s, n, transform, status)
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
  !f2py threadsafe
  class(kernel_type), allocatable :: kernel
  type(status_type) :: outcome

  call make_kernel(kernel, kind, data, outcome)
  if (.not. outcome%failed()) call kernel%laplace(s, transform)
  call report(outcome, status)
end subroutine kernel_laplace

!> R(t) at t > 0.
subroutine kernel_value(kind, data, n_data, t, n, r, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_kernel, report
  use viscovib_kernel, only: kernel_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind, n_data, n
  real(c_double), intent(in) :: data(n_data), t(n)
  real(c_double), intent(out) :: r(n)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  class(kernel_type), allocatable :: kernel
  type(status_type) :: outcome

  call make_kernel(kernel, kind, data, outcome)
  if (.not. outcome%failed()) call kernel%value(t, r)
  call report(outcome, status)
end subroutine kernel_value

!> integral of R, +infinity where there is none.
subroutine kernel_integral(kind, data, n_data, integral, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_kernel, report
  use viscovib_kernel, only: kernel_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind, n_data
  real(c_double), intent(in) :: data(n_data)
  real(c_double), intent(out) :: integral
  integer(c_int), intent(out) :: status
  class(kernel_type), allocatable :: kernel
  type(status_type) :: outcome

  integral = 0.0_c_double
  call make_kernel(kernel, kind, data, outcome)
  if (.not. outcome%failed()) integral = kernel%integral()
  call report(outcome, status)
end subroutine kernel_integral

!> R(t) as a sum of exponentials, weights(:n_terms) and rates(:n_terms); n_terms is
!! 0 where the kernel has no such sum, and more than n_max where there is no room.
subroutine kernel_exponentials(kind, data, n_data, tolerance, t_min, t_max, n_max, n_terms, &
                               weights, rates, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_kernel, report
  use viscovib_kernel, only: kernel_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind, n_data, n_max
  real(c_double), intent(in) :: data(n_data), tolerance, t_min, t_max
  integer(c_int), intent(out) :: n_terms, status
  real(c_double), intent(out) :: weights(n_max), rates(n_max)
  !f2py threadsafe
  class(kernel_type), allocatable :: kernel
  type(status_type) :: outcome
  real(c_double), allocatable :: w(:), r(:)

  weights = 0.0_c_double
  rates = 0.0_c_double
  n_terms = 0
  call make_kernel(kernel, kind, data, outcome)
  if (.not. outcome%failed()) then
    call kernel%exponentials(tolerance, t_min, t_max, w, r)
    n_terms = size(w)
    weights(:min(n_terms, n_max)) = w(:min(n_terms, n_max))
    rates(:min(n_terms, n_max)) = r(:min(n_terms, n_max))
  end if
  call report(outcome, status)
end subroutine kernel_exponentials

!> integral_0^t R(s) ds at times t > 0.
subroutine kernel_accumulated(kind, data, n_data, t, n, total, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_kernel, report
  use viscovib_kernel, only: kernel_type
  use viscovib_status, only: status_type
  implicit none
  integer(c_int), intent(in) :: kind, n_data, n
  real(c_double), intent(in) :: data(n_data), t(n)
  real(c_double), intent(out) :: total(n)
  integer(c_int), intent(out) :: status
  !f2py threadsafe
  class(kernel_type), allocatable :: kernel
  type(status_type) :: outcome

  total = 0.0_c_double
  call make_kernel(kernel, kind, data, outcome)
  if (.not. outcome%failed()) call kernel%accumulated(t, total)
  call report(outcome, status)
end subroutine kernel_accumulated

!> Integral before the first time of a table that its interpolant lacks; 0 of other kernels.
subroutine kernel_unseen(kind, data, n_data, unseen, status)
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use viscovib_binding_tools, only: make_kernel, report
  use viscovib_kernel, only: kernel_type
  use viscovib_status, only: status_type
  use viscovib_tabulated, only: unseen_integral
  implicit none
  integer(c_int), intent(in) :: kind, n_data
  real(c_double), intent(in) :: data(n_data)
  real(c_double), intent(out) :: unseen
  integer(c_int), intent(out) :: status
  class(kernel_type), allocatable :: kernel
  type(status_type) :: outcome

  unseen = 0.0_c_double
  call make_kernel(kernel, kind, data, outcome)
  if (.not. outcome%failed()) unseen = unseen_integral(kernel)
  call report(outcome, status)
end subroutine kernel_unseen
