!> FFTW alone, with a measured plan.
module floor_transform
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int, c_ptr
  use floor_clock, only: now, samples, show
  implicit none
  private

  public :: time_fourier

  integer, parameter :: n = 2**17

  interface
    type(c_ptr) function fftw_plan_dft_r2c_1d(n, signal, spectrum, flags) bind(c)
      import :: c_double, c_double_complex, c_int, c_ptr
      integer(c_int), value :: n, flags
      real(c_double), intent(inout) :: signal(*)
      complex(c_double_complex), intent(inout) :: spectrum(*)
    end function fftw_plan_dft_r2c_1d

    subroutine fftw_execute_dft_r2c(plan, signal, spectrum) bind(c)
      import :: c_double, c_double_complex, c_ptr
      type(c_ptr), value :: plan
      real(c_double), intent(inout) :: signal(*)
      complex(c_double_complex), intent(inout) :: spectrum(*)
    end subroutine fftw_execute_dft_r2c

    subroutine fftw_destroy_plan(plan) bind(c)
      import :: c_ptr
      type(c_ptr), value :: plan
    end subroutine fftw_destroy_plan
  end interface

contains

  subroutine time_fourier(check)
    real(c_double), intent(inout) :: check
    !> Value of FFTW_MEASURE in fftw3.h.
    integer(c_int), parameter :: by_measuring = 0
    type(c_ptr) :: plan
    real(c_double), allocatable :: x(:)
    complex(c_double_complex), allocatable :: y(:)
    real(c_double) :: begun, best
    integer :: i

    allocate (x(n), y(n/2 + 1))
    plan = fftw_plan_dft_r2c_1d(int(n, c_int), x, y, by_measuring)
    best = huge(best)
    do i = 1, samples
      x = 1.0_c_double/i
      begun = now()
      call fftw_execute_dft_r2c(plan, x, y)
      best = min(best, now() - begun)
    end do
    check = check + abs(y(2))
    call fftw_destroy_plan(plan)
    call show('fourier', best, '2^17 samples, planned by measuring')
  end subroutine time_fourier

end module floor_transform
