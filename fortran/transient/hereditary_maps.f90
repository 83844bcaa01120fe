!> The linear part of a step with memory, solved once and for all.
!!
!! Accelerations a at the nodes of a Gauss collocation satisfy
!!
!!   M a_i + C u'_i + sum_j B_j v_ji + r_i = f_i,
!!   v_ji = sum_k E_ik w_jk - (what is remembered from before the step),
!!
!! with w_jk = W_j u_k + y_jk at the points of the step (its start, the nodes, its
!! end), y the nonlinear part, and E = 1 - L, where
!! L_ik = integral_0^(c_i h) R(sigma) l_k(c_i - sigma/h) dsigma acts on the
!! polynomial through the points. Everything but y and r is linear, so that
!!
!!   X = G z + Z y,  X = displacements from the start at the nodes and the end, the
!!                       gain of velocity, and the v_ji if F is not linear in them,
!!                   z = start, load, memories, y at the start
!!
!! and a step is: one product for G z, then X = G z + Z y(X) until it holds.
module viscovib_hereditary_maps
  use viscovib_memory_channels, only: channels_type
  use viscovib_collocation, only: collocation_type
  use viscovib_dense, only: factorize, solve
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: step_map_type, new_step_map, local_weights
  public :: find_map, place_of, padded, remaining_weights, remember_held

  !> Lengths of steps whose maps are kept for when they come again.
  integer, parameter :: most_lengths = 64

  !> Rows are padded to whole registers.
  integer, parameter, public :: row_block = 8

  type :: step_map_type
    integer :: s = 0, n_dof = 0, n_memory = 0, n_channels = 0
    !> Length of the step, and how many rates nonlinear variables depend on.
    real(wp) :: h = 0.0_wp
    integer :: n_rates = 0
    !> Nonlinear hereditary variables, and whether r is there.
    integer, allocatable :: bent(:)
    logical :: separable = .true.
    !> G and Z, shapes (n_rows, n_inputs) and (n_rows, n_bends).
    real(wp), allocatable :: from_input(:, :), from_bend(:, :)
    !> What each node remembers of a displacement held before the start, that is
    !! beyond the motion since, shape (s, n_channels).
    real(wp), allocatable :: held(:, :)
    !> First rows of velocity and of v; rows before those of v, whole registers.
    integer :: velocity_row = 0, variable_row = 0, n_core = 0
    !> Where in z each part begins, less 1.
    integer :: at_u = 0, at_v = 0, at_load = 0, at_memory = 0, at_bend = 0
    !> Where r begins among the nonlinear inputs, less 1.
    integer :: at_remainder = 0
    !> Rates at the nodes from that at the start of the step, shape (s), and from the displacements
    !! at the nodes since, shape (s, s) (1/s).
    real(wp), allocatable :: rate_from_start(:), rate_from_moved(:, :)
  end type step_map_type

contains

  !> L of a kernel for steps of several lengths, shape (s, 0:s+1, n).
  subroutine local_weights(kernel, table, lengths, weights)
    type(kernel_holder), intent(in) :: kernel
    type(collocation_type), intent(in) :: table
    !> Shape (n).
    real(wp), intent(in) :: lengths(:)
    real(wp), intent(out) :: weights(table%s, 0:table%s + 1, size(lengths))
    real(wp), allocatable :: sigma(:, :), w(:, :)
    real(wp) :: row(0:table%s + 1), taus(table%s*size(lengths))
    integer :: i, k, m, at

    do m = 1, size(lengths)
      taus((m - 1)*table%s + 1:m*table%s) = lengths(m)*table%points(1:table%s)
    end do
    call kernel%local_rules(taus, sigma, w)
    do m = 1, size(lengths)
      do i = 1, table%s
        at = (m - 1)*table%s + i
        row = 0.0_wp
        do k = 1, size(sigma, 1)
          row = row + w(k, at)*table%basis(table%points(i) - sigma(k, at)/lengths(m))
        end do
        weights(i, :, m) = row
      end do
    end do
  end subroutine local_weights

  !> Maps of a step h. `singular`: the step is so large that the equations of its
  !! nodes have no solution.
  subroutine new_step_map(map, system, channels, table, h, singular)
    type(step_map_type), intent(out) :: map
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h
    logical, intent(out) :: singular
    real(wp) :: e(table%s, 0:table%s + 1, 0:size(system%kernels))
    real(wp), allocatable :: right(:, :), equations(:, :)
    integer, allocatable :: pivots(:)
    integer :: j, k, n_a, n_in, n_bends

    map%s = table%s
    map%n_dof = system%n_dof()
    map%n_rates = system%n_rates()
    map%h = h
    map%n_memory = system%n_memory()
    map%n_channels = size(channels%kernel_of)
    map%bent = pack([(j, j=1, map%n_memory)], system%bent)
    map%separable = system%separable
    map%at_v = map%n_dof
    map%at_load = 2*map%n_dof
    map%at_memory = map%at_load + map%s*map%n_dof
    map%at_bend = map%at_memory + map%s*map%n_channels
    n_in = map%at_bend + size(map%bent)
    map%at_remainder = (map%s + 1)*size(map%bent)
    n_bends = map%at_remainder
    map%velocity_row = (map%s + 1)*map%n_dof + 1
    map%n_core = padded(map%velocity_row + map%n_dof - 1)
    map%variable_row = map%n_core + 1
    if (.not. map%separable) n_bends = n_bends + map%s*map%n_dof

    call set_rates(map, table, h)
    call remaining_weights(system, table, h, e)
    call remember_held(map, channels, e)
    n_a = map%s*map%n_dof
    allocate (equations(n_a, n_a), right(n_a, n_in + n_bends), pivots(n_a))
    call set_equations(map, system, table, h, e, equations)
    call set_right_sides(map, system, channels, table, h, e, right)
    call factorize(n_a, equations, pivots, singular)
    if (singular) return
    do k = 1, size(right, 2)
      call solve(n_a, equations, pivots, right(:, k))
    end do
    call set_rows(map, system, channels, table, h, e, right, n_in)
  end subroutine new_step_map

  !> u' = v + h A1 a with a from u - u0 = c h v + h^2 A2 a.
  subroutine set_rates(map, table, h)
    type(step_map_type), intent(inout) :: map
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h
    real(wp) :: rows(table%s, table%s), right(table%s)
    integer :: pivots(table%s), i
    logical :: singular

    ! Rows of A1 A2^-1 are columns of A2^-T A1^T.
    rows = transpose(table%a2(:table%s, :))
    call factorize(table%s, rows, pivots, singular)
    allocate (map%rate_from_moved(table%s, table%s))
    do i = 1, table%s
      right = table%a1(i, :)
      call solve(table%s, rows, pivots, right)
      map%rate_from_moved(i, :) = right/h
    end do
    map%rate_from_start = 1.0_wp - h*matmul(map%rate_from_moved, table%points(1:table%s))
  end subroutine set_rates

  !> Rows in whole registers.
  pure integer function padded(n)
    integer, intent(in) :: n
    padded = (n + row_block - 1)/row_block*row_block
  end function padded

  !> E = 1 - L for each kernel, and for none (place 0).
  subroutine remaining_weights(system, table, h, e)
    class(oscillator_type), intent(in) :: system
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h
    real(wp), intent(out) :: e(table%s, 0:table%s + 1, 0:size(system%kernels))
    real(wp) :: local(table%s, 0:table%s + 1, 1)
    integer :: i, k

    e = 0.0_wp
    do i = 1, table%s
      e(i, i, :) = 1.0_wp
    end do
    do k = 1, size(system%kernels)
      if (.not. any(system%kernel_of == k)) cycle
      call local_weights(system%kernels(k), table, [h], local)
      e(:, :, k) = e(:, :, k) - local(:, :, 1)
    end do
  end subroutine remaining_weights

  !> What nodes remember of a displacement held before the start.
  subroutine remember_held(map, channels, e)
    type(step_map_type), intent(inout) :: map
    type(channels_type), intent(in) :: channels
    !> From `remaining_weights`.
    real(wp), intent(in) :: e(:, 0:, 0:)
    integer :: k
    allocate (map%held(map%s, map%n_channels))
    do k = 1, map%n_channels
      map%held(:, k) = channels%held_recalled(k) - channels%held(k) &
                       *(1.0_wp - sum(e(:, :, channels%kernel_of(k)), 2))
    end do
  end subroutine remember_held

  !> Matrix of the accelerations, equation and unknown (dof-1) s + node.
  subroutine set_equations(map, system, table, h, e, matrix)
    type(step_map_type), intent(in) :: map
    class(oscillator_type), intent(in) :: system
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h, e(table%s, 0:table%s + 1, 0:size(system%kernels))
    real(wp), intent(out) :: matrix(:, :)
    real(wp) :: block(map%s, map%s), pull(map%s, map%s)
    integer :: a, b, i, j

    do b = 1, map%n_dof
      do a = 1, map%n_dof
        block = h*system%damping(a, b)*table%a1
        do i = 1, map%s
          block(i, i) = block(i, i) + system%mass(a, b)
        end do
        do j = 1, map%n_memory
          if (.not. abs(system%spread(a, j)*system%gather(j, b)) > 0.0_wp) cycle
          pull = matmul(e(:, 1:, system%kernel_of(j)), table%a2)
          block = block + h**2*system%spread(a, j)*system%gather(j, b)*pull
        end do
        matrix((a - 1)*map%s + 1:a*map%s, (b - 1)*map%s + 1:b*map%s) = block
      end do
    end do
  end subroutine set_equations

  !> Right sides for a unit of each input, linear ones first.
  subroutine set_right_sides(map, system, channels, table, h, e, right)
    type(step_map_type), intent(in) :: map
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h, e(table%s, 0:table%s + 1, 0:size(system%kernels))
    real(wp), intent(out) :: right(:, :)
    real(wp) :: pull
    integer :: a, b, i, j, k, n, first

    right = 0.0_wp
    n = map%at_bend + size(map%bent)
    do a = 1, map%n_dof
      do i = 1, map%s
        associate (row => right((a - 1)*map%s + i, :))
          do b = 1, map%n_dof
            row(map%at_v + b) = -system%damping(a, b)
            do j = 1, map%n_memory
              pull = system%spread(a, j)*system%gather(j, b)
              row(map%at_u + b) = row(map%at_u + b) - pull*sum(e(i, :, system%kernel_of(j)))
              row(map%at_v + b) = row(map%at_v + b) &
                                  - pull*h*dot_product(e(i, :, system%kernel_of(j)), table%points)
            end do
          end do
          row(map%at_load + (a - 1)*map%s + i) = 1.0_wp
          do k = 1, map%n_channels
            row(map%at_memory + (k - 1)*map%s + i) = channels%spread(a, k)
          end do
          do b = 1, size(map%bent)
            j = map%bent(b)
            row(map%at_bend + b) = -system%spread(a, j)*e(i, 0, system%kernel_of(j))
            first = n + (b - 1)*(map%s + 1)
            row(first + 1:first + map%s + 1) = -system%spread(a, j)*e(i, 1:, system%kernel_of(j))
          end do
          if (.not. map%separable) row(n + map%at_remainder + (a - 1)*map%s + i) = -1.0_wp
        end associate
      end do
    end do
  end subroutine set_right_sides

  !> G and Z from the accelerations for a unit of each input.
  subroutine set_rows(map, system, channels, table, h, e, a, n_in)
    type(step_map_type), intent(inout) :: map
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h, e(table%s, 0:table%s + 1, 0:size(system%kernels))
    real(wp), intent(in) :: a(:, :)
    integer, intent(in) :: n_in
    real(wp), allocatable :: rows(:, :)
    real(wp) :: left(0:table%s + 1)
    integer :: b, i, j, k, first, n_rows

    n_rows = map%n_core
    if (.not. map%separable) n_rows = n_rows + padded(map%s*map%n_memory)
    allocate (rows(n_rows, size(a, 2)))
    rows = 0.0_wp
    do b = 1, map%n_dof
      associate (part => a((b - 1)*map%s + 1:b*map%s, :))
        first = (b - 1)*(map%s + 1)
        rows(first + 1:first + map%s + 1, :) = h**2*matmul(table%a2, part)
        rows(first + 1:first + map%s + 1, map%at_v + b) = &
          rows(first + 1:first + map%s + 1, map%at_v + b) + h*table%points(1:)
        rows(map%velocity_row + b - 1, :) = h*matmul(table%b, part)
      end associate
    end do
    if (.not. map%separable) then
      do j = 1, map%n_memory
        do i = 1, map%s
          left = e(i, :, system%kernel_of(j))
          k = map%variable_row + (j - 1)*map%s + i - 1
          do b = 1, map%n_dof
            first = (b - 1)*(map%s + 1)
            rows(k, :) = rows(k, :) + system%gather(j, b) &
                         *matmul(left(1:), rows(first + 1:first + map%s + 1, :))
            rows(k, map%at_u + b) = rows(k, map%at_u + b) + system%gather(j, b)*sum(left)
          end do
          do b = 1, map%n_channels
            first = map%at_memory + (b - 1)*map%s + i
            rows(k, first) = rows(k, first) - channels%gather(b, j)
          end do
          do b = 1, size(map%bent)
            if (map%bent(b) /= j) cycle
            rows(k, map%at_bend + b) = rows(k, map%at_bend + b) + left(0)
            first = n_in + (b - 1)*(map%s + 1)
            rows(k, first + 1:first + map%s + 1) = rows(k, first + 1:first + map%s + 1) + left(1:)
          end do
        end do
      end do
    end if
    map%from_input = rows(:, :n_in)
    map%from_bend = rows(:, n_in + 1:)
  end subroutine set_rows

  !> The place of the map of steps h, or where it is to be put: `now`.
  subroutine find_map(maps, lengths, n_lengths, h, now)
    type(step_map_type), allocatable, intent(inout) :: maps(:)
    !> Of the steps of each map, as many as there are: n_lengths.
    real(wp), allocatable, intent(inout) :: lengths(:)
    integer, intent(inout) :: n_lengths
    real(wp), intent(in) :: h
    integer, intent(out) :: now
    type(step_map_type), allocatable :: grown(:)

    call place_of(lengths, n_lengths, h, now)
    if (now <= size(maps)) return
    allocate (grown(size(lengths)))
    grown(:now - 1) = maps
    call move_alloc(grown, maps)
  end subroutine find_map

  !> The place of steps h among lengths, or a new one, the next if there is room for more.
  pure subroutine place_of(lengths, n_lengths, h, now)
    !> As many as there are places; n_lengths of them are taken.
    real(wp), allocatable, intent(inout) :: lengths(:)
    integer, intent(inout) :: n_lengths
    real(wp), intent(in) :: h
    integer, intent(out) :: now

    do now = 1, n_lengths
      if (abs(lengths(now) - h) <= 0.0_wp) exit
    end do
    if (now <= size(lengths)) return
    if (now > most_lengths) then
      n_lengths = 0
      now = 1
      return
    end if
    lengths = [lengths, spread(0.0_wp, 1, min(most_lengths, 2*now) - size(lengths))]
  end subroutine place_of

end module viscovib_hereditary_maps
