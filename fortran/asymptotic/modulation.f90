! Optimize: -O1
!> Time integration of the modulation equations by the Dormand-Prince pair of orders 5 and 4, with
!! its interpolant between the steps (Hairer, Norsett, Wanner, Solving ordinary differential
!! equations I, 1993, II.4-II.6).
module viscovib_modulation
  use viscovib_kinds, only: wp
  use viscovib_slow_flow, only: slow_flow_type
  use viscovib_stopping, only: is_set, stop_wanted
  implicit none
  private

  public :: modulate

  integer, parameter, public :: modulation_complete = 0, modulation_overflow = 1, &
                                modulation_step_limit = 2, modulation_cancelled = 3
  real(wp), parameter :: nodes(6) = [0.0_wp, 0.2_wp, 0.3_wp, 0.8_wp, 8.0_wp/9.0_wp, 1.0_wp]
  real(wp), parameter :: stage(6, 2:7) = reshape([ &
    0.2_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, &
    3.0_wp/40.0_wp, 9.0_wp/40.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, &
    44.0_wp/45.0_wp, -56.0_wp/15.0_wp, 32.0_wp/9.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, &
    19372.0_wp/6561.0_wp, -25360.0_wp/2187.0_wp, 64448.0_wp/6561.0_wp, -212.0_wp/729.0_wp, &
    0.0_wp, 0.0_wp, &
    9017.0_wp/3168.0_wp, -355.0_wp/33.0_wp, 46732.0_wp/5247.0_wp, 49.0_wp/176.0_wp, &
    -5103.0_wp/18656.0_wp, 0.0_wp, &
    35.0_wp/384.0_wp, 0.0_wp, 500.0_wp/1113.0_wp, 125.0_wp/192.0_wp, -2187.0_wp/6784.0_wp, &
    11.0_wp/84.0_wp], [6, 6])
  real(wp), parameter :: defect(7) = [ &
    71.0_wp/57600.0_wp, 0.0_wp, -71.0_wp/16695.0_wp, 71.0_wp/1920.0_wp, -17253.0_wp/339200.0_wp, &
    22.0_wp/525.0_wp, -1.0_wp/40.0_wp]
  real(wp), parameter :: dense(7) = [ &
    -12715105075.0_wp/11282082432.0_wp, 0.0_wp, 87487479700.0_wp/32700410799.0_wp, &
    -10690763975.0_wp/1880347072.0_wp, 701980252875.0_wp/199316789632.0_wp, &
    -1453857185.0_wp/822651844.0_wp, 69997945.0_wp/29380423.0_wp]

contains

  !> Amplitudes at the requested times, from `start` at time 0.
  subroutine modulate(flow, start, times, tolerance, max_steps, a, n_reached, n_steps, outcome, &
                      cancel)
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(in) :: start(:)
    !> Not negative, ascending.
    real(wp), intent(in) :: times(:)
    !> Tolerance of a step, relative to the largest amplitude.
    real(wp), intent(in) :: tolerance
    integer, intent(in) :: max_steps
    !> Shape (n_modes, size(times)); columns beyond n_reached are 0.
    complex(wp), intent(out) :: a(:, :)
    integer, intent(out) :: n_reached, n_steps, outcome
    integer, intent(inout) :: cancel
    complex(wp) :: now(size(start)), new(size(start)), k(size(start), 7), error(size(start))
    complex(wp) :: c(size(start), 5)
    real(wp) :: t, h, size_of, speed, part, growth, limit
    integer :: i, n

    n = size(times)
    a = (0.0_wp, 0.0_wp)
    now = start
    t = 0.0_wp
    n_reached = 0
    n_steps = 0
    outcome = modulation_complete
    call take_reached()
    if (n_reached == n) return
    call flow%rates(t, now, k(:, 1))
    size_of = maxval(abs(now))
    speed = maxval(abs(k(:, 1)))
    ! From zero amplitudes the error control selects the step size.
    h = merge(times(n), 1.0e-4_wp*times(n), size_of > 0.0_wp)
    if (size_of > 0.0_wp .and. speed > 0.0_wp) h = min(h, 0.01_wp*size_of/speed)
    limit = 1.0e8_wp*max(size_of, speed*times(n))
    do
      if (n_steps >= max_steps) outcome = modulation_step_limit
      if (is_set(cancel)) outcome = modulation_cancelled
      if (stop_wanted()) outcome = modulation_cancelled
      if (outcome /= modulation_complete) return
      n_steps = n_steps + 1
      do i = 2, 7
        new = now + h*matmul(k(:, :i - 1), stage(:i - 1, i))
        call flow%rates(t + nodes(min(i, 6))*h, new, k(:, i))
      end do
      if (.not. all(abs(new) <= limit)) then
        ! Either the step is too long, or an amplitude grows without bound.
        outcome = merge(modulation_overflow, outcome, maxval(abs(now)) > 1.0e-2_wp*limit &
                        .or. t + h <= t)
        if (outcome == modulation_overflow) return
        h = 0.1_wp*h
        cycle
      end if
      error = h*matmul(k, defect)
      size_of = max(maxval(abs(now)), maxval(abs(new)), tiny(1.0_wp))
      part = maxval(abs(error))/(tolerance*size_of)
      growth = min(5.0_wp, max(0.2_wp, 0.9_wp*max(part, 1.0e-10_wp)**(-0.2_wp)))
      if (part <= 1.0_wp) then
        c(:, 1) = now
        c(:, 2) = new - now
        c(:, 3) = h*k(:, 1) - c(:, 2)
        c(:, 4) = c(:, 2) - h*k(:, 7) - c(:, 3)
        c(:, 5) = h*matmul(k, dense)
        now = new
        t = t + h
        call take_reached()
        if (n_reached == n) return
        k(:, 1) = k(:, 7)
      else
        growth = min(growth, 1.0_wp)
        if (t + growth*h <= t) then
          outcome = modulation_overflow
          return
        end if
      end if
      h = growth*h
    end do

  contains

    !> Interpolate at the times that the last step has passed.
    subroutine take_reached()
      real(wp) :: x
      do while (n_reached < n)
        if (times(n_reached + 1) > t) return
        n_reached = n_reached + 1
        if (n_steps == 0) then
          a(:, n_reached) = now
        else
          x = 1.0_wp - (t - times(n_reached))/h
          a(:, n_reached) = c(:, 1) + x*(c(:, 2) + (1.0_wp - x)*(c(:, 3) + x*(c(:, 4) &
                                                                 + (1.0_wp - x)*c(:, 5))))
        end if
      end do
    end subroutine take_reached

  end subroutine modulate

end module viscovib_modulation
