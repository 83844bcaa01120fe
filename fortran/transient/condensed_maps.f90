! Optimize: -O2
!> The equations of a step of a structure, condensed to the deflections of its elements.
!!
!! With w_0 at the start and X = w - w_0 at the nodes and the end,
!!
!!   X = a - H f,   f_k = B (v_k - W w_k),
!!   v_jk = sum_p E_kp (W_j (w_0 + X_p) + y_jp) - (memory),
!!
!! since the linear subsystem contains the springs W w without memory; a is the change of the
!! deflections without the elements, H from `viscovib_modal_maps`, f the forces at the nodes, E and
!! y as in `viscovib_hereditary_maps`. So X = G z + Z y and f = F z + Y y with z = (w_0, a, memory,
!! y at the start): `viscovib_step_equations` solves for X and y.
module viscovib_condensed_maps
  use viscovib_collocation, only: collocation_type
  use viscovib_dense, only: factorize, solve
  use viscovib_hereditary_maps, only: padded, remember_held, step_map_type
  use viscovib_kinds, only: wp
  use viscovib_memory_channels, only: channels_type
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: condensed_map_type, new_condensed_map

  type :: condensed_map_type
    !> G and Z; displacements are deflections, loads are a, point p of deflection j at
    !! (j-1)(s+1)+p.
    type(step_map_type) :: step
    !> F and Y, shapes (n_forces, n_inputs) and (n_forces, n_bends), rows in whole registers; node
    !! k of force l at (l-1) s + k.
    real(wp), allocatable :: by_input(:, :), by_bend(:, :)
    integer :: n_forces = 0
  end type condensed_map_type

contains

  !> `singular`: the step is so large that its equations have no solution.
  subroutine new_condensed_map(map, system, channels, table, answer, e, singular)
    type(condensed_map_type), intent(out) :: map
    !> The elements, in their deflections.
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    !> H, shape ((s+1) n_seen, s n_forces), and E, shape (s, 0:s+1, 0:n_kernels).
    real(wp), intent(in) :: answer(:, :), e(:, 0:, 0:)
    logical, intent(out) :: singular
    real(wp), allocatable :: by_x(:, :), by_input(:, :), by_bend(:, :), matrix(:, :), right(:, :)
    integer, allocatable :: pivots(:)
    integer :: i, k, n, n_in, n_bends

    call lay_out(map%step, system, channels, table)
    call remember_held(map%step, channels, e)
    n = size(answer, 1)
    map%n_forces = size(answer, 2)
    n_in = map%step%at_bend + size(map%step%bent)
    n_bends = map%step%at_remainder
    allocate (by_x(map%n_forces, n), by_input(map%n_forces, n_in), by_bend(map%n_forces, n_bends))
    call set_forces(map%step, system, channels, e, by_x, by_input, by_bend)
    allocate (matrix(n, n), right(n, n_in + n_bends), pivots(n))
    matrix = matmul(answer, by_x)
    right(:, :n_in) = -matmul(answer, by_input)
    right(:, n_in + 1:) = -matmul(answer, by_bend)
    do i = 1, n
      matrix(i, i) = matrix(i, i) + 1.0_wp
      right(i, map%step%at_load + i) = right(i, map%step%at_load + i) + 1.0_wp
    end do
    call factorize(n, matrix, pivots, singular)
    if (singular) return
    do k = 1, size(right, 2)
      call solve(n, matrix, pivots, right(:, k))
    end do
    allocate (map%step%from_input(map%step%n_core, n_in), source=0.0_wp)
    allocate (map%step%from_bend(map%step%n_core, n_bends), source=0.0_wp)
    map%step%from_input(:n, :) = right(:, :n_in)
    map%step%from_bend(:n, :) = right(:, n_in + 1:)
    allocate (map%by_input(padded(map%n_forces), n_in), source=0.0_wp)
    allocate (map%by_bend(padded(map%n_forces), n_bends), source=0.0_wp)
    map%by_input(:map%n_forces, :) = by_input + matmul(by_x, right(:, :n_in))
    map%by_bend(:map%n_forces, :) = by_bend + matmul(by_x, right(:, n_in + 1:))
  end subroutine new_condensed_map

  !> Offsets of the parts of z, y and X.
  subroutine lay_out(map, system, channels, table)
    type(step_map_type), intent(inout) :: map
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    integer :: j

    map%s = table%s
    map%n_dof = system%n_dof()
    map%n_rates = system%n_rates()
    map%n_memory = system%n_memory()
    map%n_channels = size(channels%kernel_of)
    map%bent = pack([(j, j=1, map%n_memory)], system%bent)
    map%at_load = map%n_dof
    map%at_memory = map%at_load + (map%s + 1)*map%n_dof
    map%at_bend = map%at_memory + map%s*map%n_channels
    map%at_remainder = (map%s + 1)*size(map%bent)
    map%n_core = padded((map%s + 1)*map%n_dof)
  end subroutine lay_out

  !> Forces of the elements at the nodes by X, by z except a, and by y at the nodes and the end.
  pure subroutine set_forces(map, system, channels, e, by_x, by_input, by_bend)
    type(step_map_type), intent(in) :: map
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    real(wp), intent(in) :: e(:, 0:, 0:)
    real(wp), intent(out) :: by_x(:, :), by_input(:, :), by_bend(:, :)
    real(wp) :: left(0:map%s + 1), pull
    integer :: a, b, c, j, k, row, first

    by_x = 0.0_wp
    by_input = 0.0_wp
    by_bend = 0.0_wp
    do a = 1, map%n_dof
      do k = 1, map%s
        row = (a - 1)*map%s + k
        do j = 1, map%n_memory
          left = e(k, :, system%kernel_of(j))
          left(k) = left(k) - 1.0_wp
          do b = 1, map%n_dof
            pull = system%spread(a, j)*system%gather(j, b)
            first = (b - 1)*(map%s + 1)
            by_x(row, first + 1:first + map%s + 1) = by_x(row, first + 1:first + map%s + 1) &
                                                     + pull*left(1:)
            by_input(row, b) = by_input(row, b) + pull*sum(left)
          end do
        end do
        do c = 1, map%n_channels
          by_input(row, map%at_memory + (c - 1)*map%s + k) = -channels%spread(a, c)
        end do
        do b = 1, size(map%bent)
          j = map%bent(b)
          left = e(k, :, system%kernel_of(j))
          by_input(row, map%at_bend + b) = system%spread(a, j)*left(0)
          first = (b - 1)*(map%s + 1)
          by_bend(row, first + 1:first + map%s + 1) = system%spread(a, j)*left(1:)
        end do
      end do
    end do
  end subroutine set_forces

end module viscovib_condensed_maps
