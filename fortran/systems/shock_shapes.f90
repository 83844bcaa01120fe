!> Shocks of test standards and sweeps of height 1, as polynomials between times.
!!
!! Straight pieces are exact. Sines are Taylor series about the start of each piece: of s = sin(phi)
!! and c = cos(phi) by s' = phi' c and c' = -phi' s. In a piece phi changes by at most pi/2, and the
!! error is (pi/2)^22/22! = 2e-17; of a sweep 1e-14.
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
  !> Powers of a Taylor series, and pieces of a sweep at least.
  integer, parameter :: n_powers = 22, least = 32
  real(wp), parameter :: most_cycles = 20000.0_wp
  !> A step ends after so long.
  real(wp), parameter :: far = 1.0e15_wp

contains

  !> A shock that begins at t = 0.
  subroutine new_shock(shape, duration, rise, fall, hz, is_logarithmic, times, pieces, status)
    !> Place in `shock_names`.
    integer, intent(in) :: shape
    !> Length; of a step not used. Of a trapezoid the lengths of its flanks. Of a chirp its first
    !! and last frequency (cycles per unit of time), which changes linearly or logarithmically.
    real(wp), intent(in) :: duration, rise, fall, hz(2)
    logical, intent(in) :: is_logarithmic
    !> Shapes (n) and (p, n): sum_k pieces(k, i) (t - times(i))^(p-k), the last one of no effect.
    real(wp), allocatable, intent(out) :: times(:), pieces(:, :)
    type(status_type), intent(out) :: status
    real(wp) :: turns

    call check(shape, duration, rise, fall, hz, is_logarithmic, status)
    if (status%failed()) return
    select case (shape)
    case (half_sine)
      call expand(2)
    case (haversine)
      call expand(4)
    case (chirp)
      turns = 0.0_wp
      if (is_logarithmic) turns = abs(log(hz(2)/hz(1)))
      call expand(max(ceiling(least*(1.0_wp + turns)), ceiling(4.0_wp*maxval(hz)*duration)))
    case (sawtooth)
      call join([0.0_wp, duration], [0.0_wp, 1.0_wp])
    case (trapezoid)
      call join([0.0_wp, rise, duration - fall, duration], [0.0_wp, 1.0_wp, 1.0_wp, 0.0_wp])
    case default
      call join([0.0_wp, far], [1.0_wp, 1.0_wp])
    end select

  contains

    subroutine expand(n)
      integer, intent(in) :: n
      real(wp), dimension(0:n_powers - 1) :: rate, c, s
      integer :: i, k

      allocate (times(n + 1), pieces(n_powers, n + 1), source=0.0_wp)
      do i = 0, n
        times(i + 1) = duration*(real(i, wp)/n)
        call find_phase(shape, times(i + 1), duration, hz, is_logarithmic, rate, s(0), c(0))
        do k = 0, n_powers - 2
          s(k + 1) = dot_product(rate(:k), c(k:0:-1))/(k + 1)
          c(k + 1) = -dot_product(rate(:k), s(k:0:-1))/(k + 1)
        end do
        if (shape == haversine) then
          s = -0.5_wp*c
          ! 0.5 (1 - cos(phi)) = sin(phi/2)^2, without cancellation.
          s(0) = sin(pi*(times(i + 1)/duration))**2
        end if
        if (i == n) s(1:) = 0.0_wp
        pieces(:, i + 1) = s(n_powers - 1:0:-1)
      end do
      if (.not. all(abs(pieces) <= huge(1.0_wp))) then
        call fail(status, status_input_error, 'duration', 'duration = '//show(duration) &
                  //': is too short for the range of numbers')
      end if
    end subroutine expand

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
      allocate (pieces(4, n), source=0.0_wp)
      pieces(4, :) = pack(values, apart)
      pieces(3, :n - 1) = (pieces(4, 2:) - pieces(4, :n - 1))/(times(2:) - times(:n - 1))
    end subroutine join

  end subroutine new_shock

  !> sin(phi), cos(phi) and the Taylor series of phi' at a time.
  pure subroutine find_phase(shape, t, duration, hz, is_logarithmic, rate, s, c)
    integer, intent(in) :: shape
    real(wp), intent(in) :: t, duration, hz(2)
    logical, intent(in) :: is_logarithmic
    real(wp), intent(out) :: rate(0:), s, c
    real(wp) :: growth, phase
    integer :: k

    rate = 0.0_wp
    if (shape == half_sine .or. shape == haversine) then
      rate(0) = merge(2.0_wp, 1.0_wp, shape == haversine)*(pi/duration)
      phase = rate(0)*t
    else if (is_logarithmic .and. abs(hz(2) - hz(1)) > 0.0_wp) then
      growth = log(hz(2)/hz(1))/duration
      rate(0) = 2.0_wp*pi*hz(1)*exp(growth*t)
      phase = (rate(0) - 2.0_wp*pi*hz(1))/growth
      do k = 1, size(rate) - 1
        rate(k) = rate(k - 1)*growth/k
      end do
    else
      rate(:1) = 2.0_wp*pi*[hz(1) + (hz(2) - hz(1))*(t/duration), (hz(2) - hz(1))/duration]
      phase = 2.0_wp*pi*t*(hz(1) + 0.5_wp*(hz(2) - hz(1))*(t/duration))
    end if
    s = sin(phase)
    c = cos(phase)
  end subroutine find_phase

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
