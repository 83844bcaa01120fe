! Optimize: -O2
!> The linear part of a step with memory, factorized once for each step length.
!!
!! Accelerations a at the nodes of a Gauss collocation satisfy
!!
!!   M a_i + C u'_i + sum_j B_j v_ji + r_i = f_i,
!!   v_ji = sum_k E_ik w_jk - (memory from before the step),
!!
!! with w_jk = W_j u_k + y_jk at the points of the step (its start, the nodes, its
!! end), y the nonlinear part, and E = 1 - L, where
!! L_ik = integral_0^(c_i h) R(sigma) l_k(c_i - sigma/h) dsigma acts on the
!! polynomial through the points. Everything but y and r is linear, so that
!!
!!   X = G z + Z y,  X = displacements from the start at the nodes and the end, the
!!                       change of velocity, and the v_ji if F is not linear in them,
!!                   z = start, load, memories, y at the start
!!
!! and a step consists of the product G z and the iteration X = G z + Z y(X).
module viscovib_hereditary_maps
  use viscovib_memory_channels, only: channels_type
  use viscovib_collocation, only: collocation_type
  use viscovib_dense, only: factorize, solve, solve_columns
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_stopping, only: stop_wanted
  implicit none
  private

  public :: step_map_type, new_step_map, local_weights
  public :: lay_out, place_of, padded, remaining_weights, remember_held

  !> Number of step lengths whose maps are kept.
  integer, parameter :: most_lengths = 64

  !> Rows are padded to whole vector registers.
  integer, parameter, public :: row_block = 8

  type :: step_map_type
    integer :: s = 0, n_dof = 0, n_memory = 0, n_channels = 0
    !> Length of the step, and number of rates in the nonlinear variables.
    real(wp) :: h = 0.0_wp
    integer :: n_rates = 0
    !> Nonlinear hereditary variables; false if there are force remainders r.
    integer, allocatable :: bent(:)
    logical :: separable = .true.
    !> G and Z, shapes (n_rows, n_inputs) and (n_rows, n_bends).
    real(wp), allocatable :: from_input(:, :), from_bend(:, :)
    !> Memory at each node of a displacement held before the start, in excess of
    !! the contribution of the step itself, shape (s, n_channels).
    real(wp), allocatable :: held(:, :)
    !> First rows of velocity and of v; rows before those of v, in whole registers.
    integer :: velocity_row = 0, variable_row = 0, n_core = 0
    !> Offset of each part in z.
    integer :: at_u = 0, at_v = 0, at_load = 0, at_memory = 0, at_bend = 0
    !> Offset of r in the nonlinear inputs.
    integer :: at_remainder = 0
    !> Rates at the nodes from the rate at the start of the step, shape (s), and from the
    !! displacements at the nodes relative to the start, shape (s, s) (1/s).
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
    real(wp) :: row(0:table%s + 1)
    integer :: i, k, m

    weights = 0.0_wp
    do m = 1, size(lengths)
      ! The rules of some kernels take seconds. The caller checks the stop request as well.
      if (stop_wanted()) return
      call kernel%local_rules(lengths(m)*table%points(1:table%s), sigma, w)
      do i = 1, table%s
        row = 0.0_wp
        do k = 1, size(sigma, 1)
          row = row + w(k, i)*table%basis(table%points(i) - sigma(k, i)/lengths(m))
        end do
        weights(i, :, m) = row
      end do
    end do
  end subroutine local_weights

  !> Maps of a step of length h. `singular`: the step is so large that the equations of its
  !! nodes have no solution.
  subroutine new_step_map(map, system, channels, table, h, singular)
    type(step_map_type), intent(out) :: map
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h
    logical, intent(out) :: singular
    real(wp) :: e(table%s, 0:table%s + 1, 0:size(system%kernels))
    real(wp), allocatable :: equations(:, :), answers(:, :)
    integer, allocatable :: pivots(:)
    integer :: k, n_a, n_in, n_bends, n_rows

    call lay_out(map, system, channels, table%s, 2*system%n_dof(), table%s)
    map%h = h
    map%separable = system%separable
    map%at_v = map%n_dof
    n_in = map%at_bend + size(map%bent)
    n_bends = map%at_remainder
    map%velocity_row = (map%s + 1)*map%n_dof + 1
    map%n_core = padded(map%velocity_row + map%n_dof - 1)
    map%variable_row = map%n_core + 1
    if (.not. map%separable) n_bends = n_bends + map%s*map%n_dof

    call set_rates(map, table, h)
    call remaining_weights(system, table, h, e)
    call remember_held(map, channels, e)
    n_a = map%s*map%n_dof
    allocate (equations(n_a, n_a), answers(n_a, n_a), pivots(n_a))
    call set_equations(map, system, table, h, e, equations)
    call factorize(n_a, equations, pivots, singular)
    if (singular) return
    answers = 0.0_wp
    do k = 1, n_a
      answers(k, k) = 1.0_wp
    end do
    call solve_columns(n_a, n_a, equations, pivots, answers)
    n_rows = map%n_core
    if (.not. map%separable) n_rows = n_rows + padded(map%s*map%n_memory)
    allocate (map%from_input(n_rows, n_in), map%from_bend(n_rows, n_bends))
    map%from_input = 0.0_wp
    map%from_bend = 0.0_wp
    call set_core_rows(map, system, channels, table, h, e, answers)
    if (.not. map%separable) call set_variable_rows(map, system, channels, e)
  end subroutine new_step_map

  !> Offsets of the parts of z, y and X.
  subroutine lay_out(map, system, channels, s, at_load, n_loads)
    type(step_map_type), intent(inout) :: map
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    !> Number of nodes; offset of the loads in z, and how many z contains for each coordinate.
    integer, intent(in) :: s, at_load, n_loads
    integer :: j

    map%s = s
    map%n_dof = system%n_dof()
    map%n_rates = system%n_rates()
    map%n_memory = system%n_memory()
    map%n_channels = size(channels%kernel_of)
    map%bent = pack([(j, j=1, map%n_memory)], system%bent)
    map%at_load = at_load
    map%at_memory = at_load + n_loads*map%n_dof
    map%at_bend = map%at_memory + s*map%n_channels
    map%at_remainder = (s + 1)*size(map%bent)
  end subroutine lay_out

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

  !> Number of rows, rounded up to whole registers.
  pure integer function padded(n)
    integer, intent(in) :: n
    padded = (n + row_block - 1)/row_block*row_block
  end function padded

  !> E = 1 - L for each kernel, and without a kernel (index 0).
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

  !> Memory at the nodes of a displacement held before the start.
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
    real(wp) :: stiffness(map%n_dof, map%n_dof), pull(map%s, map%s)
    integer :: a, b, i, k

    do b = 1, map%n_dof
      do a = 1, map%n_dof
        associate (block => matrix((a - 1)*map%s + 1:a*map%s, (b - 1)*map%s + 1:b*map%s))
          block = h*system%damping(a, b)*table%a1
          do i = 1, map%s
            block(i, i) = block(i, i) + system%mass(a, b)
          end do
        end associate
      end do
    end do
    do k = 0, size(system%kernels)
      if (.not. any(system%kernel_of == k)) cycle
      call stiffness_of(system, k, stiffness)
      pull = h**2*matmul(e(:, 1:, k), table%a2)
      do b = 1, map%n_dof
        do a = 1, map%n_dof
          if (.not. abs(stiffness(a, b)) > 0.0_wp) cycle
          associate (block => matrix((a - 1)*map%s + 1:a*map%s, (b - 1)*map%s + 1:b*map%s))
            block = block + stiffness(a, b)*pull
          end associate
        end do
      end do
    end do
  end subroutine set_equations

  !> B W of the variables with one kernel (0: without a kernel).
  subroutine stiffness_of(system, kernel, stiffness)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: kernel
    real(wp), intent(out) :: stiffness(:, :)
    integer :: b, j
    stiffness = 0.0_wp
    do j = 1, system%n_memory()
      if (system%kernel_of(j) /= kernel) cycle
      do b = 1, size(stiffness, 2)
        stiffness(:, b) = stiffness(:, b) + system%spread(:, j)*system%gather(j, b)
      end do
    end do
  end subroutine stiffness_of

  !> Rows of G and Z for displacements and velocities. Columns of loads are the responses to a unit
  !! force at each node; all other inputs are converted to forces.
  subroutine set_core_rows(map, system, channels, table, h, e, answers)
    type(step_map_type), intent(inout) :: map
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h, e(table%s, 0:table%s + 1, 0:size(system%kernels))
    !> Accelerations due to unit forces, shape (s n_dof, s n_dof).
    real(wp), intent(in) :: answers(:, :)
    real(wp) :: by_load(map%n_core, map%s, map%n_dof), by_force(map%n_core, map%s)
    real(wp) :: forces(map%s*map%n_dof, 2*map%n_dof)
    integer :: b, k, first, s

    s = map%s
    by_load = 0.0_wp
    do k = 1, map%n_dof
      do b = 1, map%n_dof
        associate (part => answers((b - 1)*s + 1:b*s, (k - 1)*s + 1:k*s))
          first = (b - 1)*(s + 1)
          by_load(first + 1:first + s + 1, :, k) = h**2*matmul(table%a2, part)
          by_load(map%velocity_row + b - 1, :, k) = h*matmul(table%b, part)
        end associate
      end do
      first = map%at_load + (k - 1)*s
      map%from_input(:map%n_core, first + 1:first + s) = by_load(:, :, k)
      if (map%separable) cycle
      first = map%at_remainder + (k - 1)*s
      map%from_bend(:map%n_core, first + 1:first + s) = -by_load(:, :, k)
    end do
    call start_forces(map, system, table, h, e, forces)
    map%from_input(:map%n_core, :2*map%n_dof) = &
      matmul(reshape(by_load, [map%n_core, s*map%n_dof]), forces)
    do b = 1, map%n_dof
      first = (b - 1)*(s + 1)
      map%from_input(first + 1:first + s + 1, map%at_v + b) = &
        map%from_input(first + 1:first + s + 1, map%at_v + b) + h*table%points(1:)
    end do
    do k = 1, map%n_channels
      first = map%at_memory + (k - 1)*s
      call combine(by_load, channels%spread(:, k), by_force)
      map%from_input(:map%n_core, first + 1:first + s) = by_force
    end do
    do b = 1, size(map%bent)
      first = (b - 1)*(s + 1)
      call combine(by_load, -system%spread(:, map%bent(b)), by_force)
      associate (part => e(:, :, system%kernel_of(map%bent(b))))
        map%from_input(:map%n_core, map%at_bend + b) = matmul(by_force, part(:, 1))
        map%from_bend(:map%n_core, first + 1:first + s + 1) = matmul(by_force, part(:, 2:))
      end associate
    end do
  end subroutine set_core_rows

  !> Forces at the nodes due to a unit of each displacement, then of each velocity at the start.
  subroutine start_forces(map, system, table, h, e, forces)
    type(step_map_type), intent(in) :: map
    class(oscillator_type), intent(in) :: system
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h, e(table%s, 0:table%s + 1, 0:size(system%kernels))
    real(wp), intent(out) :: forces(map%s, map%n_dof, 2*map%n_dof)
    real(wp) :: stiffness(map%n_dof, map%n_dof), held(map%s), moved(map%s)
    integer :: a, b, k

    forces = 0.0_wp
    do b = 1, map%n_dof
      do a = 1, map%n_dof
        forces(:, a, map%at_v + b) = -system%damping(a, b)
      end do
    end do
    do k = 0, size(system%kernels)
      if (.not. any(system%kernel_of == k)) cycle
      call stiffness_of(system, k, stiffness)
      held = sum(e(:, :, k), 2)
      moved = h*matmul(e(:, :, k), table%points)
      do b = 1, map%n_dof
        do a = 1, map%n_dof
          forces(:, a, b) = forces(:, a, b) - stiffness(a, b)*held
          forces(:, a, map%at_v + b) = forces(:, a, map%at_v + b) - stiffness(a, b)*moved
        end do
      end do
    end do
  end subroutine start_forces

  !> Responses to forces that are distributed over coordinates in these parts.
  pure subroutine combine(by_load, parts, by_force)
    real(wp), intent(in) :: by_load(:, :, :), parts(:)
    real(wp), intent(out) :: by_force(:, :)
    integer :: a
    by_force = 0.0_wp
    do a = 1, size(parts)
      if (abs(parts(a)) > 0.0_wp) by_force = by_force + parts(a)*by_load(:, :, a)
    end do
  end subroutine combine

  !> Rows of G and Z for hereditary variables at the nodes.
  subroutine set_variable_rows(map, system, channels, e)
    type(step_map_type), intent(inout) :: map
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    real(wp), intent(in) :: e(map%s, 0:map%s + 1, 0:size(system%kernels))
    real(wp) :: left(0:map%s + 1)
    integer :: b, i, j, k, first

    do j = 1, map%n_memory
      do i = 1, map%s
        left = e(i, :, system%kernel_of(j))
        k = map%variable_row + (j - 1)*map%s + i - 1
        associate (row => map%from_input(k, :), bend_row => map%from_bend(k, :))
          do b = 1, map%n_dof
            first = (b - 1)*(map%s + 1)
            row = row + system%gather(j, b) &
                  *matmul(left(1:), map%from_input(first + 1:first + map%s + 1, :))
            bend_row = bend_row + system%gather(j, b) &
                       *matmul(left(1:), map%from_bend(first + 1:first + map%s + 1, :))
            row(map%at_u + b) = row(map%at_u + b) + system%gather(j, b)*sum(left)
          end do
          do b = 1, map%n_channels
            first = map%at_memory + (b - 1)*map%s + i
            row(first) = row(first) - channels%gather(b, j)
          end do
          do b = 1, size(map%bent)
            if (map%bent(b) /= j) cycle
            row(map%at_bend + b) = row(map%at_bend + b) + left(0)
            first = (b - 1)*(map%s + 1)
            bend_row(first + 1:first + map%s + 1) = bend_row(first + 1:first + map%s + 1) + left(1:)
          end do
        end associate
      end do
    end do
  end subroutine set_variable_rows

  !> Index of step length h among the lengths, or a new index; a full list starts again.
  pure subroutine place_of(lengths, n_lengths, h, now)
    !> Array of step lengths, of which n_lengths are valid.
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
