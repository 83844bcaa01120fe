!> Relaxation kernels: transforms against each other and against limits.
module test_kernels
  use testing, only: begin, check_close, check_fails, check_ok
  use viscovib_catalogue, only: kernel_abel, kernel_names, kernel_prony, kernel_rabotnov, &
    kernel_rzhanitsyn, kernel_tabulated, new_kernel
  use viscovib_kernel, only: kernel_type
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

    if (begin('transforms change with frequency at the rate they say')) then
      call compare_slope(kernel_rzhanitsyn, [0.07_wp, 0.1_wp, 0.05_wp])
      call compare_slope(kernel_rzhanitsyn, [0.3_wp, 1.0_wp, 2.0_wp])
      call compare_slope(kernel_abel, [0.2_wp, 0.4_wp])
      call compare_slope(kernel_rabotnov, [0.2_wp, 0.35_wp, 0.5_wp])
      call compare_slope(kernel_rabotnov, [0.2_wp, 0.35_wp, 0.0_wp])
      call compare_slope(kernel_prony, [0.2_wp, 0.1_wp, 0.3_wp, 0.02_wp, 1.0_wp, 40.0_wp])
      call compare_slope(kernel_tabulated, [0.0_wp, 0.1_wp, 1.0_wp, 4.0_wp, 2.0_wp, 1.0_wp, 0.1_wp])
      call compare_slope(kernel_tabulated, [1.0_wp, 0.1_wp, 1.0_wp, 4.0_wp, 2.0_wp, 1.0_wp, 0.1_wp])
    end if

    if (begin('alpha out of range')) then
      call new_rzhanitsyn(kernel, 1.0_wp, 1.5_wp, 0.0_wp, status)
      call check_fails(status, 'alpha = 1.5')
    end if
  end subroutine run_kernels

  !> Against extrapolated central differences with two step sizes.
  subroutine compare_slope(kind, parameters)
    integer, intent(in) :: kind
    real(wp), intent(in) :: parameters(:)
    real(wp), parameter :: mu(5) = [1.0e-3_wp, 0.2_wp, 1.0_wp, 7.0_wp, 30.0_wp]
    class(kernel_type), allocatable :: kernel
    type(status_type) :: status
    complex(wp), dimension(size(mu)) :: slope, coarse, fine
    real(wp) :: h(size(mu))

    call new_kernel(kernel, kind, parameters, status)
    call check_ok(status)
    call kernel%transform_slope(mu, transform_at(mu), slope)
    h = min(1.0e-3_wp*mu, 3.0e-3_wp)
    coarse = (transform_at(mu + h) - transform_at(mu - h))/(2.0_wp*h)
    fine = (transform_at(mu + 0.5_wp*h) - transform_at(mu - 0.5_wp*h))/h
    fine = (4.0_wp*fine - coarse)/3.0_wp
    call check_close(maxval(abs(slope - fine)*mu), 0.0_wp, 1.0e-9_wp, 'slope of a '//trim( &
                     kernel_names(kind))//' kernel', floor=maxval(abs(transform_at(mu))))

  contains

    function transform_at(frequency) result(transform)
      real(wp), intent(in) :: frequency(:)
      complex(wp) :: transform(size(frequency))
      real(wp), dimension(size(frequency)) :: cosine, sine
      call kernel%transform(frequency, cosine, sine)
      transform = cmplx(cosine, -sine, wp)
    end function transform_at

  end subroutine compare_slope

end module test_kernels
