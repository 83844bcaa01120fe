!> The loops of a step over all modes of a structure, eight modes at a time, which is how their
!! arrays are laid out: mode (b-1) 8 + i at (i, b).
module viscovib_structure_kernels
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: free_points, move_modes, seen_of

  integer, parameter, public :: mode_block = 8

contains

  !> a + what deflections gain by the state of the modes alone, at each point.
  pure subroutine free_points(n_blocks, n_points, r, by_q, by_v, seen, q, v, a)
    integer, intent(in) :: n_blocks, n_points, r
    real(wp), intent(in), dimension(mode_block, n_blocks, n_points) :: by_q, by_v
    real(wp), intent(in) :: seen(mode_block, n_blocks, r)
    real(wp), intent(in), dimension(mode_block, n_blocks) :: q, v
    real(wp), intent(inout) :: a(n_points, r)
    real(wp), dimension(mode_block) :: sums, more
    real(wp) :: x(mode_block, n_blocks)
    integer :: b, j, p

    if (r == 0) return
    do p = 1, n_points
      sums = 0.0_wp
      more = 0.0_wp
      if (r == 1) then
        !GCC$ novector
        do b = 1, n_blocks
          sums = sums + seen(:, b, 1)*(by_q(:, b, p)*q(:, b))
          more = more + seen(:, b, 1)*(by_v(:, b, p)*v(:, b))
        end do
        a(p, 1) = a(p, 1) + sum(sums + more)
      else
        !GCC$ novector
        do b = 1, n_blocks
          x(:, b) = by_q(:, b, p)*q(:, b) + by_v(:, b, p)*v(:, b)
        end do
        do j = 1, r
          a(p, j) = a(p, j) + seen_of(n_blocks, seen(:, :, j), x)
        end do
      end if
    end do
  end subroutine free_points

  !> seen . x.
  pure real(wp) function seen_of(n_blocks, seen, x)
    integer, intent(in) :: n_blocks
    real(wp), intent(in), dimension(mode_block, n_blocks) :: seen, x
    real(wp), dimension(mode_block) :: even, odd
    integer :: b
    even = 0.0_wp
    odd = 0.0_wp
    !GCC$ novector
    do b = 1, n_blocks/2
      odd = odd + seen(:, 2*b - 1)*x(:, 2*b - 1)
      even = even + seen(:, 2*b)*x(:, 2*b)
    end do
    if (mod(n_blocks, 2) == 1) odd = odd + seen(:, n_blocks)*x(:, n_blocks)
    seen_of = sum(odd + even)
  end function seen_of

  !> Modes to the end of the step, their sums compensated: by their state, by forces at the nodes,
  !! and by what waves add.
  pure subroutine move_modes(n_blocks, s, n_pushed, by_q, by_v, rate_by_q, rate_by_v, gain, &
                             rate_gain, pushed, forces, n_swings, swing, q, v, q_rest, v_rest, &
                             largest, finite)
    integer, intent(in) :: n_blocks, s, n_pushed, n_swings
    real(wp), intent(in), dimension(mode_block, n_blocks) :: by_q, by_v, rate_by_q, rate_by_v
    real(wp), intent(in), dimension(mode_block, n_blocks, s) :: gain, rate_gain
    real(wp), intent(in) :: pushed(mode_block, n_blocks, n_pushed), forces(s, n_pushed)
    !> Of the modes, then of their velocities, 2 blocks or none.
    real(wp), intent(in) :: swing(mode_block, n_blocks, n_swings)
    real(wp), intent(inout), dimension(mode_block, n_blocks) :: q, v, q_rest, v_rest
    !> Of the modes, so far.
    real(wp), intent(inout) :: largest
    logical, intent(out) :: finite
    real(wp), dimension(mode_block) :: push, dq, dv, here, sum_of, back, total, most
    integer :: b, k, l

    total = 0.0_wp
    most = 0.0_wp
    !GCC$ novector
    do b = 1, n_blocks
      dq = q_rest(:, b) + (by_q(:, b)*q(:, b) + by_v(:, b)*v(:, b))
      dv = v_rest(:, b) + (rate_by_q(:, b)*q(:, b) + rate_by_v(:, b)*v(:, b))
      if (n_swings > 0) then
        dq = dq + swing(:, b, 1)
        dv = dv + swing(:, b, 2)
      end if
      if (n_pushed == 1) then
        push = pushed(:, b, 1)
        here = 0.0_wp
        back = 0.0_wp
        !GCC$ novector
        do k = 1, s
          here = here + gain(:, b, k)*forces(k, 1)
          back = back + rate_gain(:, b, k)*forces(k, 1)
        end do
        dq = dq + push*here
        dv = dv + push*back
      else if (n_pushed > 1) then
        !GCC$ novector
        do k = 1, s
          push = 0.0_wp
          !GCC$ novector
          do l = 1, n_pushed
            push = push + pushed(:, b, l)*forces(k, l)
          end do
          dq = dq + gain(:, b, k)*push
          dv = dv + rate_gain(:, b, k)*push
        end do
      end if
      ! What is no number would be lost in a comparison, but not in a sum.
      total = total + (abs(dq) + abs(dv))
      here = q(:, b)
      sum_of = here + dq
      back = sum_of - here
      q_rest(:, b) = (here - (sum_of - back)) + (dq - back)
      q(:, b) = sum_of
      most = larger(most, abs(sum_of))
      here = v(:, b)
      sum_of = here + dv
      back = sum_of - here
      v_rest(:, b) = (here - (sum_of - back)) + (dv - back)
      v(:, b) = sum_of
    end do
    finite = sum(total) <= huge(1.0_wp)
    if (finite) largest = max(largest, maxval(most))
  end subroutine move_modes

  elemental real(wp) function larger(a, b)
    real(wp), intent(in) :: a, b
    larger = merge(a, b, a > b)
  end function larger

end module viscovib_structure_kernels
