! Optimize: -O2
!> One step of a structure: solve for the forces of its elements, and advance its modes.
!!
!! The equations of a step are condensed to the deflections of the elements. With w_0 at the start
!! and X = w - w_0 at the nodes and the end,
!!
!!   X = a - H f,   f_k = B (v_k - W w_k),
!!   v_jk = sum_p E_kp (W_j (w_0 + X_p) + y_jp) - (memory),
!!
!! since the linear subsystem contains the springs W w without memory; a is the change of the
!! deflections without the elements, H from `viscovib_modal_maps`, f the forces at the nodes, E and
!! y as in `viscovib_hereditary_maps`. So X = G z + Z y and f = F z + Y y with z = (w_0, a, memory,
!! y at the start): `viscovib_step_equations` solves for X and y.
module viscovib_structure_step
  use viscovib_collocation, only: collocation_type
  use viscovib_dense, only: factorize, solve
  use viscovib_hereditary_kernels, only: add_held, check_resolution, gather_channels, product_of, &
    runs_away
  use viscovib_hereditary_maps, only: lay_out, padded, remember_held, step_map_type
  use viscovib_hereditary_start, only: panel_maker
  use viscovib_kinds, only: wp
  use viscovib_memory_channels, only: channels_type
  use viscovib_modal_maps, only: modal_map_type, new_modal_map, sections_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pole_maps, only: add_pole_points, move_poles
  use viscovib_step_equations, only: new_step_equations, step_equations_type
  use viscovib_structure_kernels, only: free_points, mode_block, move_modes
  use viscovib_structure_state, only: rate_of, state_type
  use viscovib_time_load, only: load_clock, new_swing, time_load_type
  implicit none
  private

  public :: bends_of, lengthen, make_step, maps_holder, new_maps, part_type, step_begin, &
    structure_panels

  !> Share of nonlinear forces in the displacements above which a motion may escape in a step.
  real(wp), parameter :: bending = 1.0e-3_wp

  type :: condensed_map_type
    !> G and Z; displacements are deflections, loads are a, point p of deflection j at
    !! (j-1)(s+1)+p.
    type(step_map_type) :: step
    !> F and Y, shapes (n_forces, n_inputs) and (n_forces, n_bends), rows in whole registers; node
    !! k of force l at (l-1) s + k.
    real(wp), allocatable :: by_input(:, :), by_bend(:, :)
    integer :: n_forces = 0
  end type condensed_map_type

  !> Maps of steps of one length.
  type :: maps_type
    real(wp) :: h = 0.0_wp
    type(modal_map_type) :: modal
    type(condensed_map_type) :: condensed
  end type maps_type

  !> A holder of maps, so that they can be moved.
  type :: maps_holder
    type(maps_type), allocatable :: maps
  end type maps_holder

  !> Data of the motion inside a step: its nodes, start, length, the state there, and forces at
  !! the nodes, shape (s, n_pushed).
  type :: part_type
    integer :: s = 0
    real(wp) :: start = 0.0_wp, length = 0.0_wp
    real(wp), allocatable :: q(:), v(:), forces(:, :)
    complex(wp), allocatable :: z(:)
  end type part_type

  !> True if the step follows one of its own kind, and if a doubtful step is made; largest
  !! deflection in the range of laws.
  type :: step_begin
    logical :: rolling = .false., trusted = .false.
    real(wp) :: bound = huge(1.0_wp)
  end type step_begin

  !> Panels of a singular start.
  type, extends(panel_maker) :: structure_panels
    type(sections_type), pointer :: sections => null()
    type(state_type) :: state
    real(wp) :: bound = huge(1.0_wp), solved = 0.0_wp
    !> The solved panels.
    integer :: n_made = 0
    type(part_type), allocatable :: parts(:)
  contains
    procedure :: make => make_panel
  end type structure_panels

contains

  !> Maps with E as in `remaining_weights`. `singular`: the step is too large.
  subroutine new_maps(maps, system, channels, sections, table, h, e, singular)
    type(maps_type), intent(out) :: maps
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(sections_type), intent(in) :: sections
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: h, e(:, 0:, 0:)
    logical, intent(out) :: singular
    integer :: r

    r = size(sections%seen, 2)
    maps%h = h
    call new_modal_map(maps%modal, sections, table, h)
    call new_condensed_map(maps%condensed, system, channels, table, &
                           maps%modal%answer(:, :table%s*r), e, singular)
    maps%condensed%step%h = h
  end subroutine new_maps

  !> Enlarge an array of maps to n.
  subroutine lengthen(maps, n)
    type(maps_holder), allocatable, intent(inout) :: maps(:)
    integer, intent(in) :: n
    type(maps_holder), allocatable :: grown(:)
    integer :: k

    allocate (grown(n))
    do k = 1, size(maps)
      call move_alloc(maps(k)%maps, grown(k)%maps)
    end do
    call move_alloc(grown, maps)
  end subroutine lengthen

  !> Nonlinear part of hereditary variables at the start of the next step.
  subroutine bends_of(equations, system, maps, state)
    type(step_equations_type), intent(inout) :: equations
    class(oscillator_type), intent(in) :: system
    type(maps_type), intent(in) :: maps
    type(state_type), intent(in) :: state
    call equations%start_bends(system, maps%condensed%step, state%w, state%w_rate)
  end subroutine bends_of

  !> Make a step. `made` is false, and the state is unchanged, if its equations do not converge, or
  !! if it may have passed an escape to infinity (`doubtful`) and `begin` does not trust it.
  subroutine make_step(state, system, sections, table, maps, equations, begin, swing, columns, &
                       remembered, part, points, made, doubtful)
    type(state_type), intent(inout) :: state
    class(oscillator_type), intent(in) :: system
    type(sections_type), intent(in) :: sections
    type(collocation_type), intent(in) :: table
    type(maps_type), intent(in) :: maps
    type(step_equations_type), intent(inout) :: equations
    type(step_begin), intent(in) :: begin
    !> Contributions of harmonic loads, rows as in `swing` of the modal map; columns of tables at
    !! the nodes; memory at the nodes.
    real(wp), intent(in), contiguous :: swing(:), columns(:), remembered(:)
    !> The part, whose q, v and forces are set; deflections at the points, shape (0:s+1, n_seen).
    type(part_type), intent(inout) :: part
    real(wp), intent(out), contiguous :: points(0:, :)
    logical, intent(out) :: made, doubtful
    real(wp), dimension(size(maps%condensed%by_input, 1)) :: linear, forces
    integer :: at_poles, j, n, n_rows, n_swings, r, s

    s = table%s
    n = size(state%q)/mode_block
    r = size(state%w)
    n_rows = (s + 1)*r
    n_swings = 0
    if (size(sections%frequencies) > 0) n_swings = 2
    ! Without harmonic loads `swing` is empty there.
    at_poles = size(swing)
    if (n_swings > 0) at_poles = n_rows + n_swings*n*mode_block
    doubtful = .false.
    associate (map => maps%condensed%step, z => equations%z, modal => maps%modal)
      associate (a => z(map%at_load + 1:map%at_load + n_rows))
        a = swing(:n_rows)
        if (size(columns) > 0) a = a + matmul(modal%answer(:, s*r + 1:), columns)
        call free_points(n, s + 1, r, modal%by_q, modal%by_v, sections%seen, state%q, state%v, a)
        call add_pole_points(modal%poles, sections%others, state%z, a)
      end associate
      z(:r) = state%w
      z(map%at_memory + 1:map%at_bend) = remembered
      call add_held(s*map%n_channels, map%held, z(map%at_memory + 1:map%at_bend))
      call equations%predict(map, begin%rolling)
      z(map%at_bend + 1:) = equations%y_start
      call equations%iterate(system, map, state%w, made)
      if (.not. made) return
      do j = 1, r
        points(0, j) = state%w(j)
        points(1:, j) = state%w(j) + equations%x((j - 1)*(s + 1) + 1:j*(s + 1))
        made = made .and. abs(points(s + 1, j)) <= begin%bound
      end do
      if (made .and. size(equations%y) > 0 .and. .not. begin%trusted) then
        doubtful = runs_away(s, maps%h, state%w, state%w_rate, state%largest, equations%x, &
                             table%last_coefficient)
        ! A linear motion cannot escape, however steep it is.
        if (doubtful) doubtful = equations%nonlinear_share(state%w) > bending
      end if
      made = made .and. .not. doubtful
      if (.not. made) return
      forces = 0.0_wp
      call product_of(size(forces), size(z), maps%condensed%by_input, z, forces, linear)
      call product_of(size(forces), size(equations%y), maps%condensed%by_bend, equations%y, &
                      linear, forces)
      call allocate_arrays(part, s, size(sections%pushed, 2))
      part%s = s
      part%length = maps%h
      part%q = state%q
      part%v = state%v
      part%z = state%z
      part%forces(:, :r) = -reshape(forces(:s*r), [s, r])
      part%forces(:, r + 1:) = reshape(columns, [s, size(columns)/s])
      call move_modes(n, modal%by_state, modal%gain, sections%pushed, part%forces, n_swings, &
                      swing(n_rows + 1:), state%q, state%v, state%q_rest, state%v_rest, &
                      state%furthest, made)
      if (made) call move_poles(modal%poles, sections%others, part%forces, &
                                swing(at_poles + 1:), state%z, &
                                state%z_rest, state%z_rate, made)
    end associate
    if (.not. made) then
      state%q = part%q
      state%v = part%v
      state%z = part%z
      return
    end if
    do j = 1, r
      call check_resolution(s + 2, points(:, j), table%last_coefficient, state%roughness(j), &
                            state%largest(j))
      state%w(j) = points(s + 1, j)
      if (size(equations%y) > 0) state%w_rate(j) = rate_of(state, sections, j)
    end do
  end subroutine make_step

  !> Allocate the forces of a step with s nodes.
  pure subroutine allocate_arrays(part, s, n_pushed)
    type(part_type), intent(inout) :: part
    integer, intent(in) :: s, n_pushed
    if (allocated(part%forces)) then
      if (size(part%forces, 1) == s) return
      deallocate (part%forces)
    end if
    allocate (part%forces(s, n_pushed))
  end subroutine allocate_arrays

  !> Solve a panel, with maps for its own length.
  subroutine make_panel(self, system, channels, load, table, local, now, length, remembered, &
                        points, g, made)
    class(structure_panels), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(time_load_type), intent(in) :: load
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: local(table%s, 0:table%s + 1, size(system%kernels))
    real(wp), intent(in) :: now, length, remembered(:, :)
    real(wp), intent(out) :: points(0:table%s + 1, size(system%gather, 2)), g(0:, :)
    logical, intent(out) :: made
    type(maps_type) :: maps
    type(step_equations_type) :: equations
    type(load_clock) :: clock
    type(time_load_type) :: no_table
    real(wp) :: e(table%s, 0:table%s + 1, 0:size(system%kernels))
    real(wp), allocatable :: swing(:), columns(:), values(:)
    integer :: i, s
    logical :: singular, doubtful

    s = table%s
    e = 0.0_wp
    do i = 1, s
      e(i, i, :) = 1.0_wp
    end do
    e(:, :, 1:) = e(:, :, 1:) - local
    call new_maps(maps, system, channels, self%sections, table, length, e, singular)
    made = .not. singular
    if (singular) return
    call new_step_equations(equations, maps%condensed%step, table, self%solved)
    call bends_of(equations, system, maps, self%state)
    call new_swing(clock, self%sections%frequencies, maps%modal%swing, now, length)
    allocate (swing(size(maps%modal%swing, 1)), no_table%breaks(0))
    call clock%at_nodes(no_table, swing)
    allocate (columns(s*size(load%pieces, 1)), values(size(load%pieces, 1)))
    do i = 1, s
      call load%at(now + table%points(i)*length, values)
      columns(i::s) = values
    end do
    self%n_made = self%n_made + 1
    associate (part => self%parts(self%n_made))
      part%start = now
      call make_step(self%state, system, self%sections, table, maps, equations, &
                     step_begin(.false., .true., self%bound), swing, columns, &
                     reshape(remembered, [size(remembered)]), part, points, made, doubtful)
    end associate
    if (.not. made) return
    call gather_channels(s + 2, size(points, 2), size(equations%y_start), size(g, 2), points, &
                         equations%y_start, equations%y, matmul(channels%gather, system%gather), &
                         channels%gather(:, maps%condensed%step%bent), channels%held, g)
  end subroutine make_panel

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

    call lay_out(map%step, system, channels, table%s, system%n_dof(), table%s + 1)
    map%step%n_core = padded((table%s + 1)*map%step%n_dof)
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

end module viscovib_structure_step
