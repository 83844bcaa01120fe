!> Jenkins elements, elastic dry friction, over a cycle: a spring in series with a slider.
!!
!!   f' = k d' where |f| < F_s, else f = +-F_s,
!!
!! run from a slider that has not moved (f = k d, cut off at F_s) until the cycle repeats. Between
!! two samples the deflection is taken to be straight. While it sticks the force follows from the
!! sample q at which it slid last, f = +-F_s + k (d - d_q), so that its derivatives are exact; one
!! that never slides is a spring.
module viscovib_friction_loop
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: friction_loop, run_loop

  !> Cycles at most until it repeats.
  integer, parameter :: max_cycles = 50

  type :: friction_loop
    !> Place of the law among those of the system.
    integer :: law = 0
    !> Of each sample where it slid last (0: never), and -1 where that was half a period before.
    integer, allocatable :: slid(:)
    real(wp), allocatable :: turned(:)
  end type friction_loop

contains

  !> f - k d at the samples of a period, or of half a one.
  pure subroutine run_loop(loop, d, half_wave, stiffness, limit, force)
    type(friction_loop), intent(inout) :: loop
    !> Deflections, shape (n_samples); d(t + T/2) = -d(t) under half-wave symmetry.
    real(wp), intent(in) :: d(:)
    logical, intent(in) :: half_wave
    real(wp), intent(in) :: stiffness, limit
    real(wp), intent(out) :: force(:)
    real(wp) :: last, f, turn, ahead, first(size(d))
    integer :: cycle_number, from, n, s

    n = size(d)
    if (.not. allocated(loop%slid)) allocate (loop%slid(n), loop%turned(n))
    turn = merge(-1.0_wp, 1.0_wp, half_wave)
    last = turn*d(n)
    f = min(max(stiffness*last, -limit), limit)
    from = merge(n, 0, abs(stiffness*last) > limit)
    ahead = turn
    do cycle_number = 1, max_cycles
      do s = 1, n
        f = f + stiffness*(d(s) - last)
        if (abs(f) > limit) then
          f = sign(limit, f)
          from = s
          ahead = 1.0_wp
        end if
        force(s) = f
        loop%slid(s) = from
        loop%turned(s) = ahead
        last = d(s)
      end do
      if (cycle_number > 1) then
        if (maxval(abs(force - first)) <= 4.0_wp*epsilon(1.0_wp)*limit) exit
      end if
      first = force
      last = turn*d(n)
      f = turn*f
      ahead = turn*ahead
    end do
    force = force - stiffness*d
  end subroutine run_loop

end module viscovib_friction_loop
