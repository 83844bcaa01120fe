! Optimize: -O2
!> Discrete Fourier transforms of real signals, by FFTW (fft_fftw.c) or without it (fft_own.c).
!!
!! Plans are made once per length and kept; they accept any array of that length. Results do not
!! vary from run to run. FFTW allows only one thread at a time to make a plan, so a lock
!! protects it. A plan is replaced only while no thread
!! uses it.
module viscovib_fourier
  use, intrinsic :: iso_c_binding, only: c_associated, c_double, c_double_complex, c_int, &
    c_null_ptr, c_ptr
  use viscovib_counters, only: count_up, counted_fourier, counting
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: check_length, real_spectrum, lock_planner, unlock_planner

  !> Number of stored lengths; the oldest is replaced first.
  integer, parameter :: max_plans = 32

  !> `users`: number of threads that use a plan now.
  integer :: lengths(max_plans) = 0, users(max_plans) = 0, oldest = 1
  type(c_ptr) :: plans(max_plans) = c_null_ptr

  interface
    type(c_ptr) function plan_line(n, signal, spectrum) bind(c, name='viscovib_plan_line')
      import :: c_double, c_double_complex, c_int, c_ptr
      integer(c_int), value :: n
      real(c_double), intent(in) :: signal(*)
      complex(c_double_complex), intent(inout) :: spectrum(*)
    end function plan_line

    subroutine transform(plan, signal, spectrum) bind(c, name='viscovib_transform')
      import :: c_double, c_double_complex, c_ptr
      type(c_ptr), value :: plan
      real(c_double), intent(in) :: signal(*)
      complex(c_double_complex), intent(out) :: spectrum(*)
    end subroutine transform

    subroutine free_plan(plan) bind(c, name='viscovib_free_plan')
      import :: c_ptr
      type(c_ptr), value :: plan
    end subroutine free_plan

    subroutine lock_planner() bind(c, name='viscovib_lock_planner')
    end subroutine lock_planner

    subroutine unlock_planner() bind(c, name='viscovib_unlock_planner')
    end subroutine unlock_planner
  end interface

contains

  !> Reject signals that are too long: lengths padded to a power of two must stay integers.
  subroutine check_length(n, status)
    integer, intent(in) :: n
    type(status_type), intent(out) :: status
    integer, parameter :: most = 2**29

    call set_ok(status)
    if (n > most) call fail(status, status_input_error, 'signal', 'signal: '//show(n) &
                            //' samples, must be at most '//show(most))
  end subroutine check_length

  !> sum_j signal_j exp(-2 pi i j k/n) for k = 0 ... n/2; n must pass `check_length`.
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
      plan = plan_line(size(signal), signal, spectrum)
      i = place_of(plan, size(signal))
    else
      plan = plans(i)
    end if
    if (i > 0) users(i) = users(i) + 1
    call unlock_planner()
    call transform(plan, signal, spectrum)
    call lock_planner()
    if (i > 0) then
      users(i) = users(i) - 1
    else
      call free_plan(plan)
    end if
    call unlock_planner()
  end subroutine real_spectrum

  !> Store a plan in place of the oldest unused one, and return its index; 0 if all are in use.
  !! Must be called with the lock.
  integer function place_of(plan, length) result(i)
    type(c_ptr), intent(in) :: plan
    integer, intent(in) :: length
    integer :: k

    do k = 1, max_plans
      i = oldest
      oldest = mod(oldest, max_plans) + 1
      if (users(i) > 0) cycle
      if (c_associated(plans(i))) call free_plan(plans(i))
      plans(i) = plan
      lengths(i) = length
      return
    end do
    i = 0
  end function place_of

end module viscovib_fourier
