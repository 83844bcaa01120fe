!> Discrete Fourier transforms of real signals, by FFTW.
!!
!! Plans are made once per length and kept; they take any array of that length.
!! Estimated plans are used, so that results do not vary from run to run; they touch no array.
!! Making a plan is the one thing in FFTW that two threads must not do at once, so that
!! whoever does takes the lock. A plan is given up for another only while no thread uses it.
module viscovib_fourier
  use, intrinsic :: iso_c_binding, only: c_associated, c_double, c_double_complex, c_int, &
    c_null_ptr, c_ptr
  use viscovib_counters, only: count_up, counted_fourier, counting
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: real_spectrum, lock_planner, unlock_planner

  !> FFTW_ESTIMATE, FFTW_UNALIGNED and FFTW_PRESERVE_INPUT of fftw3.h.
  integer(c_int), parameter :: estimate = 64_c_int, unaligned = 2_c_int, preserve_input = 16_c_int
  !> Lengths remembered; the oldest goes first.
  integer, parameter :: max_plans = 32

  !> `users`: threads that use a plan now.
  integer :: lengths(max_plans) = 0, users(max_plans) = 0, oldest = 1
  type(c_ptr) :: plans(max_plans) = c_null_ptr

  interface
    type(c_ptr) function fftw_plan_dft_r2c_1d(n, signal, spectrum, flags) bind(c)
      import :: c_double, c_double_complex, c_int, c_ptr
      integer(c_int), value :: n, flags
      real(c_double), intent(in) :: signal(*)
      complex(c_double_complex), intent(inout) :: spectrum(*)
    end function fftw_plan_dft_r2c_1d

    subroutine fftw_execute_dft_r2c(plan, signal, spectrum) bind(c)
      import :: c_double, c_double_complex, c_ptr
      type(c_ptr), value :: plan
      real(c_double), intent(in) :: signal(*)
      complex(c_double_complex), intent(out) :: spectrum(*)
    end subroutine fftw_execute_dft_r2c

    subroutine fftw_destroy_plan(plan) bind(c)
      import :: c_ptr
      type(c_ptr), value :: plan
    end subroutine fftw_destroy_plan

    subroutine lock_planner() bind(c, name='viscovib_lock_planner')
    end subroutine lock_planner

    subroutine unlock_planner() bind(c, name='viscovib_unlock_planner')
    end subroutine unlock_planner
  end interface

contains

  !> sum_j signal_j exp(-2 pi i j k/n) for k = 0 ... n/2.
  subroutine real_spectrum(signal, spectrum)
    !> Shape (n), n >= 1.
    real(wp), intent(in) :: signal(:)
    !> Shape (n/2 + 1).
    complex(wp), intent(out) :: spectrum(:)
    type(c_ptr) :: plan
    integer :: i

    if (counting) call count_up(counted_fourier, 1)
    call lock_planner()
    i = findloc(lengths, size(signal), 1)
    if (i == 0) then
      plan = fftw_plan_dft_r2c_1d(size(signal), signal, spectrum, &
                                  ior(estimate, ior(unaligned, preserve_input)))
      i = place_of(plan, size(signal))
    else
      plan = plans(i)
    end if
    if (i > 0) users(i) = users(i) + 1
    call unlock_planner()
    call fftw_execute_dft_r2c(plan, signal, spectrum)
    call lock_planner()
    if (i > 0) then
      users(i) = users(i) - 1
    else
      call fftw_destroy_plan(plan)
    end if
    call unlock_planner()
  end subroutine real_spectrum

  !> Keep a plan in place of the oldest that nobody uses, and return where; 0 if all are used.
  !! Called under the lock.
  integer function place_of(plan, length) result(i)
    type(c_ptr), intent(in) :: plan
    integer, intent(in) :: length
    integer :: k

    do k = 1, max_plans
      i = oldest
      oldest = mod(oldest, max_plans) + 1
      if (users(i) > 0) cycle
      if (c_associated(plans(i))) call fftw_destroy_plan(plans(i))
      plans(i) = plan
      lengths(i) = length
      return
    end do
    i = 0
  end function place_of

end module viscovib_fourier
