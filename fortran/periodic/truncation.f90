!> What the orders that a harmonic balance leaves out would change.
!!
!! At a solution x of the orders kept, the balance of a larger set has a residual in
!! those left out, R_out(x): the forces there, from more samples. Each of these orders
!! is near -D(k nu)^-1 R_k, for at high orders inertia outweighs all that is nonlinear.
!! They act back on those kept, by -J^-1 R_kept(x + out) with the derivatives J that the
!! solution has left behind, which includes what nearness to a fold makes of it and, if
!! forces are no polynomials, the aliasing of the fewer samples. The residual left in the
!! orders left out shows how much of them was found: fixed-point iterations of factor
!! rho fall short by 1/(1 - rho).
!!
!! Where a law has kinks or jumps, orders fall off as k^-p only, and those beyond the larger set,
!! K < k <= N, count too. A jump of the force gives p = 3, a corner 4, one of its slope 5; p is
!! measured, and at least 3 or, without jumps, 4. As a sum of squares all orders left out are
!! sqrt(1 + K/((2 p - 1) d)) times the largest, d apart. What order k changes in those kept goes as
!! its rate times what the slope of the force has at k: as k^-q, q = p - 1 where the force jumps,
!! q = p where its slope does, so that all of them make 1/(1 - (K/N)^(q - 1)) times what those up to
!! N do. Several kinks make orders beat, sin(k a) k^-p: the next order is taken as no smaller than
!! the largest of the last third of those kept lets expect.
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

  !> Largest factor between two turns that is believed, and that after which no other is needed.
  real(wp), parameter :: slowest = 0.9_wp, little = 0.02_wp
  !> Turns at most, to look closely.
  integer, parameter :: most_turns = 6
  !> Powers with which harmonics fall off at jumps and kinks of the force, at least; beyond so
  !! much they fall off geometrically.
  real(wp), parameter :: beside_jumps = 3.0_wp, beside_kinks = 4.0_wp, fastest_fall = 12.0_wp
  !> How uncertain that is.
  real(wp), parameter :: safety = 2.0_wp
  !> The most that is made of orders that vanish between two beats.
  real(wp), parameter :: largest_beat = 10.0_wp
  !> Most that orders beyond the larger set are believed to make where laws are smooth.
  real(wp), parameter :: largest_tail = 20.0_wp
  !> Orders that determine a fall.
  integer, parameter :: enough = 8

contains

  !> The change of all orders that the larger set suggests, and its relative size in the
  !! norm of `weighted_norm`.
  subroutine estimate_truncation(probe, compliance, system, x, factors, change, whole, outside)
    !> Balance of the larger set, at the same frequency and load.
    type(balance_type), intent(inout) :: probe
    !> Inverse dynamic stiffness of the orders left out, shape (n_dof, n_dof, n left out).
    complex(wp), intent(in) :: compliance(:, :, :)
    class(oscillator_type), intent(in) :: system
    !> Solution, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Derivatives of the balance of the orders kept, at the solution.
    type(newton_factors), intent(in) :: factors
    !> Shape (2 n_orders of the larger set, n_dof).
    real(wp), intent(out) :: change(:, :)
    !> Relative sizes of the whole change and of its part in the orders left out.
    real(wp), intent(out) :: whole, outside
    real(wp) :: back(size(x, 1), size(x, 2)), norm, short
    integer :: n

    n = size(x, 1)
    call find_left_out(probe, compliance, system, x, change, back, outside, short, .false.)
    call solve(size(back), factors%lu, factors%pivots, back)
    change(:n, :) = -back
    norm = weighted_norm(system, x)
    whole = 0.0_wp
    if (norm > 0.0_wp) whole = max(outside, weighted_norm(system, back)*short/norm)
  end subroutine estimate_truncation

  !> The orders left out, and what they do to the equations of those kept.
  subroutine find_left_out(probe, compliance, system, x, change, pushed, outside, short, closely)
    type(balance_type), intent(inout) :: probe
    complex(wp), intent(in) :: compliance(:, :, :)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(:, :)
    !> Of all orders, that of those kept being 0, and residuals of those kept.
    real(wp), intent(out) :: change(:, :), pushed(:, :)
    !> Relative size of the orders left out, and by what factor this falls short of all.
    real(wp), intent(out) :: outside, short
    !> To iterate until little is left.
    logical, intent(in) :: closely
    real(wp), dimension(size(change, 1), size(change, 2)) :: y, r
    real(wp) :: norm, first, rest, before, factor, reach
    integer :: n, turn

    n = size(x, 1)
    y(:n, :) = x
    y(n + 1:, :) = 0.0_wp
    call probe%residual(system, y, r)
    change = 0.0_wp
    call add_left_out(compliance, r(n + 1:, :), change(n + 1:, :))
    rest = weighted_norm(system, change(n + 1:, :))
    do turn = 1, merge(most_turns, 1, closely)
      before = rest
      y(n + 1:, :) = change(n + 1:, :)
      call probe%residual(system, y, r)
      call add_left_out(compliance, r(n + 1:, :), change(n + 1:, :))
      rest = weighted_norm(system, change(n + 1:, :) - y(n + 1:, :))
      if (.not. (rest > little*before .and. rest < slowest*before)) exit
    end do
    pushed = r(:n, :)
    norm = weighted_norm(system, x)
    first = weighted_norm(system, y(n + 1:, :))
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

  !> At kinks: how many times the orders that were looked at all orders left out are, and how
  !! many times more than those they change.
  pure subroutine kinked_tail(system, x, orders, first, reach, short)
    class(oscillator_type), intent(in) :: system
    !> Shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Of the larger set.
    integer, intent(in) :: orders(:)
    !> Size of the orders left out that were looked at.
    real(wp), intent(in) :: first
    real(wp), intent(out) :: reach
    real(wp), intent(inout) :: short
    real(wp) :: low, high, fall, power, apart, beat
    integer :: i, n
    logical :: jumps

    n = size(x, 1)/2
    reach = 1.0_wp
    jumps = may_jump(system)
    fall = merge(beside_jumps, beside_kinks, jumps)
    if (n >= enough) then
      low = weighted_norm(system, x(2*(n/4) + 1:2*(n/2), :))
      high = weighted_norm(system, x(2*(n/2) + 1:, :))
      if (.not. high > 0.0_wp) return
      ! The largest of orders twice as far out.
      fall = max(fall, log(low/high)/log(2.0_wp))
      if (fall > fastest_fall) return
    end if
    apart = real(orders(size(orders)) - orders(n), wp)/(size(orders) - n)
    reach = safety*sqrt(1.0_wp + orders(n)/((2.0_wp*fall - 1.0_wp)*apart))
    power = merge(fall - 1.0_wp, fall, jumps)
    ! Sliders of many limits fall off more slowly at first.
    if (n < enough) power = beside_jumps - 1.0_wp
    short = short*safety/(1.0_wp - (real(orders(n), wp)/orders(size(orders)))**(power - 1.0_wp))
    if (n < enough .or. .not. first > 0.0_wp) return
    ! Two kinks make orders beat: where the next ones vanish, those kept show how large other orders
    ! are.
    high = 0.0_wp
    do i = (2*n)/3 + 1, n
      low = weighted_norm(system, x(2*i - 1:2*i, :))
      high = max(high, low*(real(orders(i), wp)/orders(n + 1))**fall)
    end do
    beat = max(1.0_wp, min(high/first, largest_beat))
    reach = reach*beat
    short = short*beat
  end subroutine kinked_tail

  !> The same where laws are smooth: the orders fall off as q^k, and those beyond the larger set,
  !! of m more orders, add q^m/(1 - q^m) of those looked at. Where that is much, q itself is
  !! uncertain, for orders fall ever more slowly towards the pole that rules them: more is added.
  pure real(wp) function smooth_tail(system, x, orders) result(tail)
    class(oscillator_type), intent(in) :: system
    !> Shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Of the larger set.
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

  !> Subtract -D^-1 r.
  pure subroutine add_left_out(compliance, r, change)
    complex(wp), intent(in) :: compliance(:, :, :)
    !> Shape (2 n left out, n_dof).
    real(wp), intent(in) :: r(:, :)
    real(wp), intent(inout) :: change(:, :)
    complex(wp) :: x
    integer :: a, b, k

    do k = 1, size(compliance, 3)
      do a = 1, size(r, 2)
        x = (0.0_wp, 0.0_wp)
        do b = 1, size(r, 2)
          x = x + compliance(a, b, k)*cmplx(r(2*k - 1, b), r(2*k, b), wp)
        end do
        change(2*k - 1, a) = change(2*k - 1, a) - real(x)
        change(2*k, a) = change(2*k, a) - aimag(x)
      end do
    end do
  end subroutine add_left_out

end module viscovib_truncation
