!> Shocks of test standards and sweeps of height 1, as cubics between times.
!!
!! Straight pieces are exact. Sines are cubics with the values and the slopes of the sine at both
!! ends: the error is h^4/384 of the fourth derivative.
module viscovib_shock_shapes
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: new_shock

  character(len=*), parameter, public :: shock_names(6) = &
    [character(len=9) :: 'half_sine', 'haversine', 'chirp', 'sawtooth', 'trapezoid', 'step']
  integer, parameter :: half_sine = 1, haversine = 2, chirp = 3, sawtooth = 4, trapezoid = 5
  !> Cubics of half a period: an error of 4e-12, of a chirp of 6e-11.
  integer, parameter :: fine = 512, swept = 256
  real(wp), parameter :: most_cycles = 1900.0_wp
  !> A step ends after so long.
  real(wp), parameter :: far = 1.0e15_wp

contains

  !> A shock that begins at t = 0.
  subroutine new_shock(shape, duration, rise, fall, hz, is_logarithmic, times, cubics, status)
    !> Place in `shock_names`.
    integer, intent(in) :: shape
    !> Length; of a step not used. Of a trapezoid the lengths of its flanks. Of a chirp its first
    !! and last frequency (cycles per unit of time), which changes linearly or logarithmically.
    real(wp), intent(in) :: duration, rise, fall, hz(2)
    logical, intent(in) :: is_logarithmic
    !> Shapes (n) and (4, n): sum_p cubics(p, i) (t - times(i))^(4-p), the last one of no effect.
    real(wp), allocatable, intent(out) :: times(:), cubics(:, :)
    type(status_type), intent(out) :: status

    call check(shape, duration, rise, fall, hz, is_logarithmic, status)
    if (status%failed()) return
    select case (shape)
    case (half_sine)
      call sample(fine)
    case (haversine)
      call sample(2*fine)
    case (chirp)
      call sample(max(fine, ceiling(2*swept*maxval(hz)*duration)))
    case (sawtooth)
      call join([0.0_wp, duration], [0.0_wp, 1.0_wp])
    case (trapezoid)
      call join([0.0_wp, rise, duration - fall, duration], [0.0_wp, 1.0_wp, 1.0_wp, 0.0_wp])
    case default
      call join([0.0_wp, far], [1.0_wp, 1.0_wp])
    end select

  contains

    subroutine sample(n)
      integer, intent(in) :: n
      real(wp) :: h, value(0:n), slope(0:n)
      integer :: i

      allocate (times(n + 1), cubics(4, n + 1), source=0.0_wp)
      h = duration/n
      do i = 0, n
        times(i + 1) = duration*(real(i, wp)/n)
        call evaluate(times(i + 1), value(i), slope(i))
      end do
      cubics(1, :n) = (2.0_wp*(value(:n - 1) - value(1:))/h + slope(:n - 1) + slope(1:))/h**2
      cubics(2, :n) = (3.0_wp*(value(1:) - value(:n - 1))/h - 2.0_wp*slope(:n - 1) - slope(1:))/h
      cubics(3, :n) = slope(:n - 1)
      cubics(4, :n) = value(:n - 1)
      cubics(4, n + 1) = value(n)
    end subroutine sample

    pure subroutine evaluate(t, value, slope)
      real(wp), intent(in) :: t
      real(wp), intent(out) :: value, slope
      real(wp) :: phase, rate, growth

      phase = pi*(t/duration)
      rate = pi/duration
      if (shape == haversine) then
        value = sin(phase)**2
        slope = 2.0_wp*rate*sin(phase)*cos(phase)
        return
      else if (shape == chirp .and. is_logarithmic .and. abs(hz(2) - hz(1)) > 0.0_wp) then
        growth = log(hz(2)/hz(1))/duration
        rate = 2.0_wp*pi*hz(1)*exp(growth*t)
        phase = (rate - 2.0_wp*pi*hz(1))/growth
      else if (shape == chirp) then
        phase = 2.0_wp*pi*t*(hz(1) + 0.5_wp*(hz(2) - hz(1))*(t/duration))
        rate = 2.0_wp*pi*(hz(1) + (hz(2) - hz(1))*(t/duration))
      end if
      value = sin(phase)
      slope = rate*cos(phase)
    end subroutine evaluate

    !> Straight lines between points; a flank of no length is a jump.
    subroutine join(at, values)
      real(wp), intent(in) :: at(:), values(:)
      logical :: apart(size(at))
      integer :: i, n

      ! Of two points at one time the inner one stays.
      apart = .true.
      do i = 2, size(at)
        if (at(i) > at(i - 1)) cycle
        if (2*i > size(at) + 1) apart(i) = .false.
        if (2*i <= size(at) + 1) apart(i - 1) = .false.
      end do
      times = pack(at, apart)
      n = size(times)
      allocate (cubics(4, n), source=0.0_wp)
      cubics(4, :) = pack(values, apart)
      cubics(3, :n - 1) = (cubics(4, 2:) - cubics(4, :n - 1))/(times(2:) - times(:n - 1))
    end subroutine join

  end subroutine new_shock

  subroutine check(shape, duration, rise, fall, hz, is_logarithmic, status)
    integer, intent(in) :: shape
    real(wp), intent(in) :: duration, rise, fall, hz(2)
    logical, intent(in) :: is_logarithmic
    type(status_type), intent(out) :: status

    call set_ok(status)
    if (shape <= trapezoid .and. .not. duration > 0.0_wp) then
      call refuse('duration', 'duration = '//show(duration)//': must be greater than 0')
    else if (shape == trapezoid .and. min(rise, fall) < 0.0_wp) then
      call refuse('rise', 'rise, fall = '//show(min(rise, fall))//': must not be negative')
    else if (shape == trapezoid .and. rise + fall > duration*(1.0_wp + epsilon(1.0_wp))) then
      call refuse('rise', 'rise + fall = '//show(rise + fall)//': must be at most the duration, ' &
                  //show(duration))
    else if (shape == chirp .and. (minval(hz) < 0.0_wp .or. .not. maxval(hz) > 0.0_wp &
                                   .or. (is_logarithmic .and. .not. minval(hz) > 0.0_wp))) then
      call refuse('hz', 'hz = '//show(hz(1))//', '//show(hz(2))//': must be greater than 0')
    else if (shape == chirp .and. maxval(hz)*duration > most_cycles) then
      call refuse('hz', 'hz, duration: '//show(maxval(hz)*duration)//' cycles, must be at most ' &
                  //show(most_cycles))
    end if

  contains

    subroutine refuse(subject, text)
      character(len=*), intent(in) :: subject, text
      call fail(status, status_input_error, subject, text)
    end subroutine refuse

  end subroutine check

end module viscovib_shock_shapes
