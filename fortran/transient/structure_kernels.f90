! Optimize: -O3 -fstack-arrays
!> The loops of a step over all modes of a structure, in blocks of eight modes, which is the layout
!! of their arrays: mode (b-1) 8 + i at (i, b).
module viscovib_structure_kernels
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: free_points, move_modes, seen_of

  integer, parameter, public :: mode_block = 8

contains

  !> Add the change of deflections due to the state of the modes, at each point, to a.
  pure subroutine free_points(n_blocks, n_points, r, by_q, by_v, seen, q, v, a)
    integer, intent(in) :: n_blocks, n_points, r
    real(wp), intent(in), dimension(mode_block, n_blocks, n_points) :: by_q, by_v
    real(wp), intent(in) :: seen(mode_block, n_blocks, r)
    real(wp), intent(in), dimension(mode_block, n_blocks) :: q, v
    real(wp), intent(inout) :: a(n_points, r)
    real(wp) :: lanes(mode_block, n_points), x(mode_block, n_blocks)
    integer :: b, j, p

    if (r == 1) then
      call one_deflection(n_blocks, n_points, by_q, by_v, seen, q, v, lanes)
      do p = 1, n_points
        a(p, 1) = a(p, 1) + sum(lanes(:, p))
      end do
    else if (r > 1) then
      do p = 1, n_points
        !GCC$ novector
        do b = 1, n_blocks
          x(:, b) = by_q(:, b, p)*q(:, b) + by_v(:, b, p)*v(:, b)
        end do
        do j = 1, r
          a(p, j) = a(p, j) + seen_of(n_blocks, seen(:, :, j), x)
        end do
      end do
    end if
  end subroutine free_points

  !> Eight sums per point: results in arrays are vectorized, scalar results are not.
  pure subroutine one_deflection(n_blocks, n_points, by_q, by_v, seen, q, v, lanes)
    integer, intent(in) :: n_blocks, n_points
    real(wp), intent(in), dimension(mode_block, n_blocks, n_points) :: by_q, by_v
    real(wp), intent(in), dimension(mode_block, n_blocks) :: seen, q, v
    real(wp), intent(out) :: lanes(mode_block, n_points)
    real(wp), dimension(mode_block) :: of_q, of_v
    integer :: b, p
    do p = 1, n_points
      of_q = 0.0_wp
      of_v = 0.0_wp
      !GCC$ novector
      do b = 1, n_blocks
        of_q = of_q + seen(:, b)*(by_q(:, b, p)*q(:, b))
        of_v = of_v + seen(:, b)*(by_v(:, b, p)*v(:, b))
      end do
      lanes(:, p) = of_q + of_v
    end do
  end subroutine one_deflection

  !> seen . x.
  pure real(wp) function seen_of(n_blocks, seen, x)
    integer, intent(in) :: n_blocks
    real(wp), intent(in), dimension(mode_block, n_blocks) :: seen, x
    real(wp) :: lanes(mode_block, 2*n_blocks)
    call products(n_blocks, seen, x, lanes)
    seen_of = sum(lanes(:, 1))
  end function seen_of

  !> Products of modes in the first column of lanes.
  pure subroutine products(n_blocks, seen, x, lanes)
    integer, intent(in) :: n_blocks
    real(wp), intent(in), dimension(mode_block, n_blocks) :: seen, x
    real(wp), intent(inout) :: lanes(mode_block, 2*n_blocks)
    real(wp) :: total(mode_block)
    integer :: b
    total = 0.0_wp
    !GCC$ novector
    do b = 1, n_blocks
      total = total + seen(:, b)*x(:, b)
    end do
    lanes(:, min(1, n_blocks)) = total
  end subroutine products

  !> Advance the modes to the end of the step, with compensated sums: due to their state, forces at
  !! the nodes, and harmonic loads.
  pure subroutine move_modes(n_blocks, by_state, gain, pushed, forces, n_swings, swing, q, v, &
                             q_rest, v_rest, largest, finite)
    integer, intent(in) :: n_blocks, n_swings
    !> Forces at the nodes, shape (s, n_pushed).
    real(wp), intent(in), contiguous :: forces(:, :)
    !> Gains of modes by q and v, then of their velocities.
    real(wp), intent(in) :: by_state(mode_block, n_blocks, 4)
    !> Node by node within a block, in the order of use; of modes, then of their velocities.
    real(wp), intent(in) :: gain(mode_block, size(forces, 1), n_blocks, 2)
    real(wp), intent(in) :: pushed(mode_block, n_blocks, size(forces, 2))
    !> For the modes, then for their velocities, 2 blocks or none.
    real(wp), intent(in) :: swing(mode_block, n_blocks, n_swings)
    real(wp), intent(inout), dimension(mode_block, n_blocks) :: q, v, q_rest, v_rest
    !> Largest sum of the absolute values of all modes so far.
    real(wp), intent(inout) :: largest
    logical, intent(out) :: finite
    real(wp), dimension(mode_block, n_blocks) :: moved, there
    integer :: b

    do b = 1, n_blocks
      call move_block(b, q(:, b), v(:, b), q_rest(:, b), v_rest(:, b), moved(:, b), there(:, b))
    end do
    !GCC$ novector
    do b = 2, n_blocks
      moved(:, 1) = moved(:, 1) + moved(:, b)
      there(:, 1) = there(:, 1) + there(:, b)
    end do
    finite = .true.
    if (n_blocks == 0) return
    ! A NaN would be lost in a comparison, but not in a sum.
    finite = sum(moved(:, 1)) <= huge(1.0_wp)
    if (finite) largest = max(largest, sum(there(:, 1)))

  contains

    pure subroutine move_block(b, q, v, q_rest, v_rest, moved, there)
      integer, intent(in) :: b
      real(wp), intent(inout), dimension(mode_block) :: q, v, q_rest, v_rest
      real(wp), intent(out), dimension(mode_block) :: moved, there
      real(wp), dimension(mode_block) :: push, dq, dv, sum_of, back
      integer :: k, l

      dq = 0.0_wp
      dv = 0.0_wp
      if (size(forces, 2) == 1) then
        !GCC$ novector
        do k = 1, size(forces, 1)
          dq = dq + gain(:, k, b, 1)*forces(k, 1)
          dv = dv + gain(:, k, b, 2)*forces(k, 1)
        end do
        dq = pushed(:, b, 1)*dq
        dv = pushed(:, b, 1)*dv
      else if (size(forces, 2) > 1) then
        !GCC$ novector
        do k = 1, size(forces, 1)
          push = 0.0_wp
          !GCC$ novector
          do l = 1, size(forces, 2)
            push = push + pushed(:, b, l)*forces(k, l)
          end do
          dq = dq + gain(:, k, b, 1)*push
          dv = dv + gain(:, k, b, 2)*push
        end do
      end if
      dq = q_rest + (by_state(:, b, 1)*q + by_state(:, b, 2)*v) + dq
      dv = v_rest + (by_state(:, b, 3)*q + by_state(:, b, 4)*v) + dv
      if (n_swings > 0) then
        dq = dq + swing(:, b, 1)
        dv = dv + swing(:, b, 2)
      end if
      moved = abs(dq) + abs(dv)
      sum_of = q + dq
      back = sum_of - q
      q_rest = (q - (sum_of - back)) + (dq - back)
      q = sum_of
      there = abs(sum_of)
      sum_of = v + dv
      back = sum_of - v
      v_rest = (v - (sum_of - back)) + (dv - back)
      v = sum_of
    end subroutine move_block

  end subroutine move_modes

end module viscovib_structure_kernels
