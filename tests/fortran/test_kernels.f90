!> Relaxation kernels: transforms against each other and against limits.
module test_kernels
  use testing, only: begin, check_close, check_fails, check_ok
  use viscovib_kinds, only: wp
  use viscovib_rzhanitsyn, only: new_rzhanitsyn, rzhanitsyn_kernel
  use viscovib_status, only: status_type
  implicit none
  private

  public :: run_kernels

contains

  subroutine run_kernels()
    type(rzhanitsyn_kernel) :: kernel
    type(status_type) :: status
    real(wp) :: cosine(1), sine(1)

    if (begin('integral of the paper''s strongest kernel')) then
      call new_rzhanitsyn(kernel, 0.078_wp, 0.1_wp, 0.05_wp, status)
      call check_ok(status)
      call check_close(kernel%integral(), 1.001240195203881_wp, 1.0e-15_wp, 'integral')
    end if

    if (begin('alpha = 1 is a Maxwell element')) then
      call new_rzhanitsyn(kernel, 2.0_wp, 1.0_wp, 3.0_wp, status)
      call kernel%transform([4.0_wp], cosine, sine)
      call check_close(cosine(1), 6.0_wp/25.0_wp, 1.0e-15_wp, 'R_c')
      call check_close(sine(1), 8.0_wp/25.0_wp, 1.0e-15_wp, 'R_s')
    end if

    if (begin('alpha out of range')) then
      call new_rzhanitsyn(kernel, 1.0_wp, 1.5_wp, 0.0_wp, status)
      call check_fails(status, 'alpha = 1.5')
    end if
  end subroutine run_kernels

end module test_kernels
