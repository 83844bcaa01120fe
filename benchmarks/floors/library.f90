!> Routines of the library that cannot be timed alone from Python.
module floor_library
  use floor_clock, only: now, samples, show
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_dense, only: factorize, solve
  use viscovib_exponential_history, only: exponential_history_type, new_exponential_history
  use viscovib_kinds, only: wp
  use viscovib_memory_channels, only: channels_type, new_channels
  use viscovib_mount, only: mount_parameters, mount_type, new_mount
  use viscovib_oscillator, only: kernel_holder
  use viscovib_prony, only: new_prony, prony_kernel
  use viscovib_status, only: status_type
  implicit none
  private

  public :: time_equations_of_library, time_history

contains

  !> 20 equations by the routine for any size.
  subroutine time_equations_of_library(check)
    real(wp), intent(inout) :: check
    integer, parameter :: n = 20
    real(wp) :: full(n, n), work(n, n), x(n), begun, best
    integer :: pivots(n), i, k
    logical :: singular

    call random_number(full)
    do k = 1, n
      full(k, k) = full(k, k) + 4.0_wp
    end do
    best = huge(1.0_wp)
    do i = 1, samples
      begun = now()
      do k = 1, 20
        work = full
        x = 1.0_wp
        call factorize(n, work, pivots, singular)
        call solve(n, work, pivots, x)
      end do
      best = min(best, now() - begun)
      check = check + x(1)
    end do
    call show('library_lu_20', best/20, '20 real equations by the library')
  end subroutine time_equations_of_library

  !> Memory of a mount with 32 exponentials, steps of four nodes.
  subroutine time_history(check)
    real(wp), intent(inout) :: check
    integer, parameter :: terms = 32, n = 200
    type(exponential_history_type) :: history
    type(mount_type) :: mount
    type(mount_parameters) :: parameters
    type(prony_kernel) :: prony
    type(kernel_holder) :: kernels(1)
    type(channels_type) :: channels
    type(collocation_type) :: table
    type(status_type) :: status
    real(wp) :: remembered(8), g(0:5, 2), begun, best
    integer :: i, k
    logical :: possible

    call new_prony(prony, [(0.01_wp, i=1, terms)], [(0.1_wp*1.3_wp**i, i=1, terms)], status)
    allocate (kernels(1)%kernel, source=prony)
    parameters = mount_parameters(1.0_wp, 0.1_wp, 0.5_wp, 10.0_wp, 2.0_wp)
    parameters%kernel_x = 1
    parameters%kernel_phi = 1
    call new_mount(mount, parameters, kernels, status)
    call new_collocation(table, 4)
    call new_channels(channels, mount, [0.0_wp, 0.0_wp])
    call new_exponential_history(history, mount, channels, table, 0.125_wp, 0.125_wp, 100.0_wp, &
                                 1.0e-10_wp, possible)
    if (.not. possible .or. status%failed()) error stop 'no history could be made'
    g = 0.1_wp
    best = huge(1.0_wp)
    do i = 1, samples
      begun = now()
      do k = 1, n
        call history%recall(remembered)
        call history%store(g)
      end do
      best = min(best, now() - begun)
      check = check + remembered(1)
    end do
    call show('library_history', best/n, '32 terms, two channels, four nodes, by the library')
  end subroutine time_history

end module floor_library
