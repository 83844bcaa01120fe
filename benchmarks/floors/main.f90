!> Times the plain kernels, and prints a line for each: name, seconds, unit of work.
!!
!! Results are summed and printed, so that the compiler cannot remove the work.
program viscovib_floors
  use, intrinsic :: iso_fortran_env, only: wp => real64
  use floor_clock, only: now, samples, show
  use floor_kernels, only: complex_lu_20, divisions, history_update, lanes, lu_20, multiply_adds, &
    plain_power, real_lu_6, response_iteration, sines, step_products, triad
  use floor_library, only: time_equations_of_library, time_history
  use floor_transform, only: time_fourier
  implicit none

  integer, parameter :: n_small = 1024, n_large = 2**22
  real(wp) :: check

  check = 0.0_wp
  call time_registers()
  call time_functions()
  call time_memory()
  call time_equations()
  call time_steps()
  call time_equations_of_library(check)
  call time_history(check)
  call time_fourier(check)
  print '(a, ",", es22.15, ",", a)', 'check', check, 'sum of results'

contains

  subroutine time_registers()
    real(wp) :: factor(lanes), sums(lanes, 12), begun, best
    integer, parameter :: n = 20000
    integer :: i

    best = huge(1.0_wp)
    factor = 0.5_wp
    sums = 1.0_wp
    do i = 1, samples
      begun = now()
      call multiply_adds(n, factor, sums)
      best = min(best, now() - begun)
    end do
    check = check + sum(sums)
    call show('multiply_add', best/n/12, 'a register of eight')
  end subroutine time_registers

  subroutine time_functions()
    real(wp), allocatable :: x(:), y(:), z(:)
    real(wp) :: begun, best(3)
    integer :: i, k

    allocate (x(n_small), y(n_small), z(n_small))
    x = [(0.5_wp + i/100.0_wp, i=1, n_small)]
    best = huge(1.0_wp)
    do i = 1, samples
      begun = now()
      do k = 1, 20
        call divisions(n_small, x, y)
      end do
      best(1) = min(best(1), now() - begun)
      check = check + y(i)
      begun = now()
      do k = 1, 20
        call sines(n_small, x, y, z)
      end do
      best(2) = min(best(2), now() - begun)
      check = check + y(i)
      begun = now()
      do k = 1, 20
        call plain_power(n_small, 0.05_wp, 0.1_wp, x, y, z)
      end do
      best(3) = min(best(3), now() - begun)
      check = check + y(i)
    end do
    best = best/20*lanes/n_small
    call show('division', best(1), 'a register of eight')
    call show('sine_cosine', best(2), 'a register of eight')
    call show('power', best(3)/lanes, 'one complex power')
  end subroutine time_functions

  subroutine time_memory()
    real(wp), allocatable :: a(:), b(:), c(:)
    real(wp) :: begun, best
    integer :: i, k

    allocate (a(n_large), b(n_large), c(n_large), source=1.0_wp)
    best = huge(1.0_wp)
    do i = 1, 8
      begun = now()
      call triad(n_large, a, b, c, 0.5_wp)
      best = min(best, now() - begun)
      check = check + a(i)
    end do
    call show('memory', best/n_large/24, 'a byte from and to memory')
    best = huge(1.0_wp)
    do i = 1, samples
      begun = now()
      do k = 1, 100
        call triad(n_small, a, b, c, 0.5_wp)
      end do
      best = min(best, now() - begun)
      check = check + a(i)
    end do
    call show('cache', best/100/n_small/24, 'a byte from and to the first cache')
  end subroutine time_memory

  subroutine time_equations()
    real(wp) :: full(24, 20), work(24, 20), imaginary(24, 20), x(24)
    real(wp) :: six(lanes, 6, 6), six_work(lanes, 6, 6), begun, best(3)
    integer :: i, k

    call random_number(full)
    call random_number(six)
    do k = 1, 20
      full(k, k) = full(k, k) + 4.0_wp
    end do
    do k = 1, 6
      six(:, k, k) = six(:, k, k) + 4.0_wp
    end do
    best = huge(1.0_wp)
    do i = 1, samples
      begun = now()
      do k = 1, 20
        work = full
        x = 1.0_wp
        call lu_20(work, x)
      end do
      best(1) = min(best(1), now() - begun)
      check = check + x(1)
      begun = now()
      do k = 1, 20
        work = full
        imaginary = 0.1_wp*full
        call complex_lu_20(work, imaginary)
      end do
      best(2) = min(best(2), now() - begun)
      check = check + imaginary(3, 4)
      begun = now()
      do k = 1, 20
        six_work = six
        call real_lu_6(six_work)
      end do
      best(3) = min(best(3), now() - begun)
      check = check + six_work(1, 6, 6)
    end do
    call show('lu_20', best(1)/20, '20 real equations')
    call show('complex_lu_20', best(2)/20, '20 complex equations')
    call show('lu_6', best(3)/20/lanes, '6 real equations, of eight side by side')
  end subroutine time_equations

  subroutine time_steps()
    real(wp) :: recall(lanes, 32), decay(32), gain(32, 6), g(6, 2), state(32, 2)
    real(wp) :: remembered(lanes, 2), linear(16, 22), bend(16, 10), z(22), y(10), x(16)
    real(wp) :: table(10, 19), compliance(lanes, 2, 2, 10), u(lanes, 10, 2), room(lanes, 19, 2)
    real(wp) :: begun, best(3)
    integer, parameter :: n = 200
    integer :: i, k

    recall = 0.01_wp
    decay = 0.9_wp
    gain = 0.01_wp
    g = 0.1_wp
    state = 0.0_wp
    linear = 0.01_wp
    bend = 0.01_wp
    z = 0.1_wp
    y = 0.1_wp
    table = 0.1_wp
    compliance = 0.1_wp
    u = 0.1_wp
    best = huge(1.0_wp)
    do i = 1, samples
      begun = now()
      do k = 1, n
        call history_update(recall, decay, gain, g, state, remembered)
      end do
      best(1) = min(best(1), now() - begun)
      check = check + remembered(1, 1)
      begun = now()
      do k = 1, n
        call step_products(linear, bend, z, y, x)
      end do
      best(2) = min(best(2), now() - begun)
      check = check + x(1)
      begun = now()
      do k = 1, n
        call response_iteration(table, compliance, u, room)
      end do
      best(3) = min(best(3), now() - begun)
      check = check + u(1, 1, 1)
      u = 0.1_wp
    end do
    best = best/n
    call show('history_update', best(1), '32 terms, two channels, four nodes')
    call show('step_products', best(2), 'four nodes, two coordinates, three iterations')
    call show('response_iteration', best(3), 'eight frequencies')
  end subroutine time_steps

end program viscovib_floors
