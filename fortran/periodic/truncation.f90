! Optimize: -O3
!> Truncation error of a harmonic balance.
!!
!! At a solution x of the included orders, the balance of a larger set has a residual in the omitted
!! orders, R_out(x): the forces there, from more samples. Each of these orders is close to -D(k
!! nu)^-1 R_k, since at high orders inertia dominates the nonlinear terms. They act back on the
!! included orders by -J^-1 R_kept(x + out) with the derivatives J of the solution. This includes
!! the amplification near a fold and, for forces that are not polynomials, the aliasing error of
!! fewer samples. The remaining residual in the omitted orders shows how much of them is missing: a
!! fixed-point iteration of factor rho falls short by 1/(1 - rho).
!!
!! With kinks or jumps, orders decay only as k^-p, and those beyond the larger set, K < k <= N,
!! count too. A jump of the force gives p = 3, a corner 4, a corner of its slope 5; p is measured,
!! and at least 3 or, without jumps, 4. The root sum of squares of all omitted orders is sqrt(1 +
!! K/((2 p - 1) d)) times the largest, for orders d apart. The effect of order k on the included
!! orders is proportional to its rate times the slope of the force at k: as k^-q, q = p - 1 if the
!! force jumps, q = p if its slope does, so the total is 1/(1 - (K/N)^(q - 1)) times the effect up
!! to N. Several kinks make orders beat, sin(k a) k^-p: the next order is at least that expected
!! from the last third of the included orders.
module viscovib_truncation
  use viscovib_dense, only: solve
  use viscovib_harmonic_balance, only: balance_type
  use viscovib_jump_maps, only: may_jump
  use viscovib_kinds, only: wp
  use viscovib_motion_norm, only: newton_factors, weighted_norm
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: estimate_truncation, find_left_out, kinked_tail

  !> Largest factor between two iterations in the estimate, and factor that ends the iteration.
  real(wp), parameter :: slowest = 0.9_wp, little = 0.02_wp
  !> Largest number of iterations for a close estimate.
  integer, parameter :: most_turns = 6
  !> Smallest powers of the decay of harmonics with jumps and kinks of the force; above the third
  !! value the decay counts as geometric.
  real(wp), parameter :: near_jumps = 3.0_wp, near_kinks = 4.0_wp, fastest_fall = 12.0_wp
  !> Safety factor for the decay.
  real(wp), parameter :: safety = 2.0_wp
  !> Largest correction for orders that vanish between two beats.
  real(wp), parameter :: largest_beat = 10.0_wp
  !> Largest factor for orders beyond the larger set with smooth laws.
  real(wp), parameter :: largest_tail = 20.0_wp
  !> Smallest number of orders that determine a decay.
  integer, parameter :: enough = 8

contains

  !> The change of all orders according to the larger set, and its relative size in the norm of
  !! `weighted_norm`.
  subroutine estimate_truncation(probe, compliance, system, x, factors, change, whole, outside)
    !> Balance of the larger set, at the same frequency and load.
    type(balance_type), intent(inout) :: probe
    !> Inverse dynamic stiffness of the omitted orders, shape (n_dof, n_dof, n omitted).
    complex(wp), intent(in) :: compliance(:, :, :)
    class(oscillator_type), intent(in) :: system
    !> Solution, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Factorized derivatives of the balance of the included orders, at the solution.
    type(newton_factors), intent(in) :: factors
    !> Shape (2 n_orders of the larger set, n_dof).
    real(wp), intent(out), contiguous :: change(:, :)
    !> Relative sizes of the whole change and of its part in the omitted orders.
    real(wp), intent(out) :: whole, outside
    real(wp), dimension(size(x, 1), size(x, 2)) :: included, back
    real(wp) :: norm, short
    integer :: n

    n = size(x, 1)
    included = x
    call find_left_out(probe, compliance, system, included, change, back, outside, short, .false.)
    call solve(size(back), factors%lu, factors%pivots, back)
    change(:n, :) = -back
    norm = weighted_norm(system, x)
    whole = 0.0_wp
    if (norm > 0.0_wp) whole = max(outside, weighted_norm(system, back)*short/norm)
  end subroutine estimate_truncation

  !> The omitted orders, and their effect on the equations of the included ones.
  subroutine find_left_out(probe, compliance, system, x, change, pushed, outside, short, closely)
    type(balance_type), intent(inout) :: probe
    complex(wp), intent(in) :: compliance(:, :, :)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in), contiguous :: x(:, :)
    !> Change of all orders, 0 for the included ones, and residuals of the included ones.
    real(wp), intent(out), contiguous :: change(:, :), pushed(:, :)
    !> Relative size of the omitted orders, and the factor by which the estimate falls short.
    real(wp), intent(out) :: outside, short
    !> True: iterate to a small remainder.
    logical, intent(in) :: closely
    real(wp) :: r(size(change, 1), size(change, 2))
    real(wp) :: norm, first, rest, before, factor, reach
    integer :: n, turn

    n = size(x, 1)
    change(:n, :) = x
    change(n + 1:, :) = 0.0_wp
    call probe%residual(system, change, r)
    call find_change(compliance, r(n + 1:, :))
    rest = weighted_norm(system, r(n + 1:, :))
    do turn = 1, merge(most_turns, 1, closely)
      before = rest
      change(n + 1:, :) = change(n + 1:, :) + r(n + 1:, :)
      call probe%residual(system, change, r)
      call find_change(compliance, r(n + 1:, :))
      rest = weighted_norm(system, r(n + 1:, :))
      if (.not. (rest > little*before .and. rest < slowest*before)) exit
    end do
    pushed = r(:n, :)
    norm = weighted_norm(system, x)
    first = weighted_norm(system, change(n + 1:, :))
    change(:n, :) = 0.0_wp
    change(n + 1:, :) = change(n + 1:, :) + r(n + 1:, :)
    short = 1.0_wp
    if (first > 0.0_wp) then
      factor = min(rest/before, slowest)
      short = 1.0_wp + before/first*factor/(1.0_wp - factor)
    end if
    if (probe%kinked) then
      first = first*short
      call kinked_tail(system, x, probe%set%orders, first, reach, short)
    else
      short = short*smooth_tail(system, x, probe%set%orders)
      reach = short
    end if
    outside = 0.0_wp
    if (norm > 0.0_wp) outside = first*reach/norm
  end subroutine find_left_out

  !> With kinks: factor from the examined orders to all omitted orders, and factor of their effect
  !! on the included orders.
  pure subroutine kinked_tail(system, x, orders, first, reach, short)
    class(oscillator_type), intent(in) :: system
    !> Shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Orders of the larger set.
    integer, intent(in) :: orders(:)
    !> Norm of the omitted orders that were examined.
    real(wp), intent(in) :: first
    real(wp), intent(out) :: reach
    real(wp), intent(inout) :: short
    real(wp) :: low, high, fall, power, apart, beat
    integer :: i, n
    logical :: jumps

    n = size(x, 1)/2
    reach = 1.0_wp
    jumps = may_jump(system)
    fall = merge(near_jumps, near_kinks, jumps)
    if (n >= enough) then
      low = weighted_norm(system, x(2*(n/4) + 1:2*(n/2), :))
      high = weighted_norm(system, x(2*(n/2) + 1:, :))
      if (.not. high > 0.0_wp) return
      ! Compare the largest orders at twice the distance.
      fall = max(fall, log(low/high)/log(2.0_wp))
      if (fall > fastest_fall) return
    end if
    apart = real(orders(size(orders)) - orders(n), wp)/(size(orders) - n)
    reach = safety*sqrt(1.0_wp + orders(n)/((2.0_wp*fall - 1.0_wp)*apart))
    power = merge(fall - 1.0_wp, fall, jumps)
    ! Sliders with many limits decay more slowly at first.
    if (n < enough) power = near_jumps - 1.0_wp
    short = short*safety/(1.0_wp - (real(orders(n), wp)/orders(size(orders)))**(power - 1.0_wp))
    if (n < enough .or. .not. first > 0.0_wp) return
    ! Two kinks make orders beat: if the next ones vanish, the included orders show the size of
    ! further ones.
    high = 0.0_wp
    do i = (2*n)/3 + 1, n
      low = weighted_norm(system, x(2*i - 1:2*i, :))
      high = max(high, low*(real(orders(i), wp)/orders(n + 1))**fall)
    end do
    beat = max(1.0_wp, min(high/first, largest_beat))
    reach = reach*beat
    short = short*beat
  end subroutine kinked_tail

  !> The same with smooth laws: orders decay as q^k, and those beyond the larger set, of m more
  !! orders, add q^m/(1 - q^m) of the examined ones. If that is much, q itself is uncertain, since
  !! the decay becomes slower towards that of the dominant pole: more is added.
  pure real(wp) function smooth_tail(system, x, orders) result(tail)
    class(oscillator_type), intent(in) :: system
    !> Shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Orders of the larger set.
    integer, intent(in) :: orders(:)
    real(wp) :: low, high, left
    integer :: n

    n = size(x, 1)/2
    tail = 1.0_wp
    if (n < enough) return
    low = weighted_norm(system, x(2*(n/4) + 1:2*(n/2), :))
    high = weighted_norm(system, x(2*(n/2) + 1:, :))
    if (.not. (high > 0.0_wp .and. high < low)) return
    left = real(orders(size(orders)) - orders(n), wp)/(orders(n/2 + 1) - orders(n/4 + 1))
    tail = (high/low)**left
    tail = tail/(1.0_wp - tail)
    tail = min(1.0_wp + tail*(1.0_wp + min(tail, safety)), largest_tail)
  end function smooth_tail

  !> The change -D^-1 r in place of the residuals r.
  pure subroutine find_change(compliance, r)
    complex(wp), intent(in) :: compliance(:, :, :)
    !> Shape (2 n omitted, n_dof).
    real(wp), intent(inout) :: r(:, :)
    complex(wp) :: x(size(r, 2))
    integer :: b, k

    do k = 1, size(compliance, 3)
      x = (0.0_wp, 0.0_wp)
      do b = 1, size(r, 2)
        x = x - compliance(:, b, k)*cmplx(r(2*k - 1, b), r(2*k, b), wp)
      end do
      r(2*k - 1, :) = real(x)
      r(2*k, :) = aimag(x)
    end do
  end subroutine find_change

end module viscovib_truncation
