!> Shocks of test standards, sweeps of height 1 and run-ups of an unbalance of 1, as polynomials
!! between times.
!!
!! Straight pieces are exact. Sines are Taylor series about the start of each piece: of s = sin(phi)
!! and c = cos(phi) by s' = phi' c and c' = -phi' s. In a piece phi changes by at most pi/2, and the
!! error is (pi/2)^22/22! = 2e-17; of a sweep 1e-14.
!!
!! An unbalance u at the angle phi of its shaft has the force -u s'' in a direction,
!! u (phi'^2 sin(phi) - phi'' cos(phi)). Its series is that of s, differentiated twice.
module viscovib_shock_shapes
  use, intrinsic :: iso_fortran_env, only: real128
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: find_turn, new_shock

  character(len=*), parameter, public :: shock_names(7) = &
    [character(len=9) :: 'half_sine', 'haversine', 'chirp', 'run_up', 'sawtooth', 'trapezoid', &
     'step']
  integer, parameter :: half_sine = 1, haversine = 2, chirp = 3, run_up = 4, sawtooth = 5, &
                        trapezoid = 6
  !> Powers of a Taylor series, and pieces of a sweep at least.
  integer, parameter :: n_powers = 22, least = 32
  real(wp), parameter :: most_cycles = 20000.0_wp
  !> A step ends after so long.
  real(wp), parameter :: far = 1.0e15_wp
  !> 2 pi. A phase in double precision would have an error of 1e-16 of all cycles.
  real(real128), parameter :: turn = 2.0_real128*acos(-1.0_real128)

  !> A shock by its shape, a place in `shock_names`, and the numbers that this shape uses.
  type, public :: shock_type
    integer :: shape = 0
    real(wp) :: start = 0.0_wp, duration = 0.0_wp
    !> Lengths of the flanks of a trapezoid.
    real(wp) :: rise = 0.0_wp, fall = 0.0_wp
    !> First and last frequency of a chirp (cycles per unit of time), which changes linearly or
    !! logarithmically.
    real(wp) :: hz(2) = 0.0_wp
    logical :: is_logarithmic = .false.
    !> Of a run-up: first and last speed (rad per unit of time), which changes linearly, the time
    !! for which the last speed is kept, and the angle at the start.
    real(wp) :: speed(2) = 0.0_wp, hold = 0.0_wp, phase = 0.0_wp
  end type shock_type

contains

  !> The polynomials of a shock.
  subroutine new_shock(shock, times, pieces, status)
    type(shock_type), intent(in) :: shock
    !> Shapes (n) and (p, n): sum_k pieces(k, i) (t - times(i))^(p-k), the last one of no effect.
    real(wp), allocatable, intent(out) :: times(:), pieces(:, :)
    type(status_type), intent(out) :: status
    real(wp) :: turns

    call check(shock, status)
    if (status%failed()) return
    associate (start => shock%start, duration => shock%duration)
      select case (shock%shape)
      case (half_sine)
        call expand(2, 0)
      case (haversine)
        call expand(4, 0)
      case (chirp)
        turns = 0.0_wp
        if (shock%is_logarithmic) turns = abs(log(shock%hz(2)/shock%hz(1)))
        call expand(max(ceiling(least*(1.0_wp + turns)), &
                        ceiling(4.0_wp*maxval(shock%hz)*duration)), 0)
      case (run_up)
        call expand(max(least, ceiling(maxval(shock%speed)*duration/(0.5_wp*pi))), &
                    ceiling(shock%speed(2)*shock%hold/(0.5_wp*pi)))
      case (sawtooth)
        call join([0.0_wp, duration], [0.0_wp, 1.0_wp])
      case (trapezoid)
        call join([0.0_wp, shock%rise, duration - shock%fall, duration], &
                  [0.0_wp, 1.0_wp, 1.0_wp, 0.0_wp])
      case default
        call join([0.0_wp, far], [1.0_wp, 1.0_wp])
      end select
      if (status%failed()) return
      if (.not. all(times(2:) > times(:size(times) - 1))) then
        call fail(status, status_input_error, 'start', 'start = '//show(start)//', duration = ' &
                  //show(duration)//': times closer than rounding, must start earlier')
      end if
    end associate

  contains

    !> Taylor series in n pieces of the duration, and in m pieces of the time after it.
    subroutine expand(n, m)
      integer, intent(in) :: n, m
      real(wp), dimension(0:n_powers + 1) :: rate, c, s
      integer :: i, k

      allocate (times(n + m + 1), pieces(n_powers, n + m + 1))
      do i = 0, n
        times(i + 1) = shock%duration*(real(i, wp)/n)
      end do
      do i = 1, m
        times(n + i + 1) = shock%duration + shock%hold*(real(i, wp)/m)
      end do
      times = shock%start + times
      do i = 0, n + m
        call find_phase(shock, times(i + 1), i >= n, rate, s(0), c(0))
        do k = 0, n_powers
          s(k + 1) = dot_product(rate(:k), c(k:0:-1))/(k + 1)
          c(k + 1) = -dot_product(rate(:k), s(k:0:-1))/(k + 1)
        end do
        if (shock%shape == haversine) then
          s = -0.5_wp*c
          ! 0.5 (1 - cos(phi)) = sin(phi/2)^2, without cancellation.
          s(0) = sin(pi*((times(i + 1) - shock%start)/shock%duration))**2
        else if (shock%shape == run_up) then
          s(:n_powers - 1) = [(-(k + 2)*(k + 1)*s(k + 2), k=0, n_powers - 1)]
        end if
        if (i == n + m) s(1:) = 0.0_wp
        pieces(:, i + 1) = s(n_powers - 1:0:-1)
      end do
      if (.not. all(abs(pieces) <= huge(1.0_wp))) then
        call fail(status, status_input_error, 'duration', 'duration = '//show(shock%duration) &
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
      times = shock%start + pack(at, apart)
      n = size(times)
      allocate (pieces(4, n), source=0.0_wp)
      pieces(4, :) = pack(values, apart)
      pieces(3, :n - 1) = (pieces(4, 2:) - pieces(4, :n - 1))/(times(2:) - times(:n - 1))
    end subroutine join

  end subroutine new_shock

  !> The angle of the shaft of a run-up: phi and phi' at t = 0, and phi'' as a polynomial of degree
  !! 0 from times (2) on. Before the start the speed is the first one.
  subroutine find_turn(shock, start, times, pieces)
    type(shock_type), intent(in) :: shock
    real(wp), intent(out) :: start(2), times(2), pieces(1, 2)
    real(wp) :: slope, t

    slope = (shock%speed(2) - shock%speed(1))/shock%duration
    times = shock%start + [0.0_wp, shock%duration]
    pieces(1, :) = [slope, 0.0_wp]
    ! Of the run-up until t = 0.
    t = min(max(-shock%start, 0.0_wp), shock%duration)
    start(1) = shock%phase + (shock%speed(1) + 0.5_wp*slope*t)*t &
               - shock%speed(1)*max(shock%start, 0.0_wp) - shock%speed(2)*min(times(2), 0.0_wp)
    start(2) = shock%speed(1) + slope*t
  end subroutine find_turn

  !> sin(phi), cos(phi) and the Taylor series of phi' at a time.
  pure subroutine find_phase(shock, time, holds, rate, s, c)
    type(shock_type), intent(in) :: shock
    real(wp), intent(in) :: time
    !> Whether the duration is over.
    logical, intent(in) :: holds
    real(wp), intent(out) :: rate(0:), s, c
    real(real128) :: phase, slope, t, w(2)
    real(wp) :: growth
    integer :: k

    rate = 0.0_wp
    associate (shape => shock%shape, duration => shock%duration, hz => shock%hz)
      t = real(time, real128) - shock%start
      if (shape == half_sine .or. shape == haversine) then
        rate(0) = merge(2.0_wp, 1.0_wp, shape == haversine)*(pi/duration)
        phase = rate(0)*t
      else if (shock%is_logarithmic .and. abs(hz(2) - hz(1)) > 0.0_wp) then
        growth = log(hz(2)/hz(1))/duration
        rate(0) = 2.0_wp*pi*hz(1)*exp(growth*real(t, wp))
        phase = (rate(0) - 2.0_wp*pi*hz(1))/growth
        do k = 1, size(rate) - 1
          rate(k) = rate(k - 1)*growth/k
        end do
      else
        w = merge(real(shock%speed, real128), turn*hz, shape == run_up)
        slope = (w(2) - w(1))/duration
        phase = shock%phase + (w(1) + 0.5_real128*slope*t)*t
        rate(:1) = real([w(1) + slope*t, slope], wp)
        if (holds) then
          phase = shock%phase + 0.5_real128*(w(1) + w(2))*duration + w(2)*(t - duration)
          rate(:1) = [real(w(2), wp), 0.0_wp]
        end if
      end if
    end associate
    phase = modulo(phase, turn)
    s = sin(real(phase, wp))
    c = cos(real(phase, wp))
  end subroutine find_phase

  subroutine check(shock, status)
    type(shock_type), intent(in) :: shock
    type(status_type), intent(out) :: status

    call set_ok(status)
    associate (shape => shock%shape, duration => shock%duration, rise => shock%rise, &
               fall => shock%fall, hz => shock%hz, speed => shock%speed)
      if (shape <= trapezoid .and. .not. duration > 0.0_wp) then
        call refuse('duration', 'duration = '//show(duration)//': must be greater than 0')
      else if (shape == trapezoid .and. min(rise, fall) < 0.0_wp) then
        call refuse('rise', 'rise, fall = '//show(min(rise, fall))//': must not be negative')
      else if (shape == trapezoid .and. rise + fall > duration*(1.0_wp + epsilon(1.0_wp))) then
        call refuse('rise', 'rise + fall = '//show(rise + fall) &
                    //': must be at most the duration, '//show(duration))
      else if (shape == chirp .and. (minval(hz) < 0.0_wp .or. .not. maxval(hz) > 0.0_wp &
                                     .or. (shock%is_logarithmic &
                                           .and. .not. minval(hz) > 0.0_wp))) then
        call refuse('hz', 'hz = '//show(hz(1))//', '//show(hz(2))//': must be greater than 0')
      else if (shape == run_up .and. (minval(speed) < 0.0_wp .or. .not. maxval(speed) > 0.0_wp)) &
        then
        call refuse('speed', 'speed = '//show(speed(1))//', '//show(speed(2)) &
                    //': must not be negative, and not both 0')
      else if (shape == run_up .and. shock%hold < 0.0_wp) then
        call refuse('hold', 'hold = '//show(shock%hold)//': must not be negative')
      else if (shape == chirp) then
        call limit('hz', maxval(hz)*duration)
      else if (shape == run_up) then
        call limit('speed', maxval(speed)/(2.0_wp*pi)*(duration + shock%hold))
      end if
    end associate

  contains

    subroutine limit(subject, cycles)
      character(len=*), intent(in) :: subject
      real(wp), intent(in) :: cycles
      if (cycles > most_cycles) then
        call refuse(subject, subject//', duration: '//show(cycles)//' cycles, must be at most ' &
                    //show(most_cycles))
      end if
    end subroutine limit

    subroutine refuse(subject, text)
      character(len=*), intent(in) :: subject, text
      call fail(status, status_input_error, subject, text)
    end subroutine refuse

  end subroutine check

end module viscovib_shock_shapes
