!> Alternating frequency/time transforms: exact round trips and no aliasing of cubic terms.
module test_harmonics
  use testing, only: begin, check, check_close
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: run_harmonics

contains

  subroutine run_harmonics()
    type(harmonic_set_type) :: set
    integer :: highest

    if (begin('orders kept')) then
      call new_harmonic_set(set, 9, .true., 3)
      call check(all(set%orders == [1, 3, 5, 7, 9]), 'odd orders up to 9')
      call check(set%n_samples == 19, 'the fewest samples without aliasing')
      call new_harmonic_set(set, 4, .true., 3)
      call check(all(set%orders == [1, 3]), 'an even highest order is lowered')
      call new_harmonic_set(set, 3, .false., 3)
      call check(all(set%orders == [0, 1, 2, 3]), 'all orders with the mean')
    end if

    if (begin('there and back, and cubes without aliasing')) then
      do highest = 1, 12
        call round_trip(highest, .true.)
        call round_trip(highest, .false.)
      end do
    end if
  end subroutine run_harmonics

  subroutine round_trip(highest, half_wave)
    integer, intent(in) :: highest
    logical, intent(in) :: half_wave
    type(harmonic_set_type) :: set
    real(wp), allocatable :: x(:, :), back(:, :), samples(:, :)
    integer :: i, l, n

    call new_harmonic_set(set, highest, half_wave, 3)
    n = size(set%orders)
    allocate (x(n_lanes, 2*n), back(n_lanes, 2*n), samples(n_lanes, set%n_samples))
    do i = 1, 2*n
      do l = 1, n_lanes
        x(l, i) = sin(3.0_wp*i + l)
      end do
    end do
    if (.not. half_wave) x(:, 1) = 0.0_wp
    call set%to_samples(x, samples)
    call set%to_harmonics(samples, back)
    call check_close(maxval(abs(back - x)), 0.0_wp, 2.0e-15_wp, 'round trip', floor=1.0_wp)

    ! sin^3 of the highest harmonic: 3/4 of it, minus 1/4 of its third harmonic, which is omitted.
    x = 0.0_wp
    x(:, 2*n - 1) = 1.0_wp
    call set%to_samples(x, samples)
    call set%to_harmonics(samples**3, back)
    x(:, 2*n - 1) = 0.75_wp
    call check_close(maxval(abs(back - x)), 0.0_wp, 1.0e-15_wp, 'cube', floor=1.0_wp)
  end subroutine round_trip

end module test_harmonics
