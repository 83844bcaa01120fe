!> Pieces of runs without memory, or with one of exponentials that are coordinates.
module viscovib_plain_pieces
  use viscovib_fitted_memory, only: copy_system
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_hidden_start, only: begin_hidden
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof
  use viscovib_load, only: load_type
  use viscovib_mesh, only: mesh_type
  use viscovib_method_catalogue, only: new_stepper
  use viscovib_motion_piece, only: from_start, load_of, moves_of, piece_type, polynomial_of, &
    take_up_memory, under_other_loads
  use viscovib_pendulum, only: new_pendulum, pendulum_type
  use viscovib_pendulum_job, only: part_of_numbers
  use viscovib_pendulum_spring, only: new_spring, spring_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_reduction, only: reduce, state_mask
  use viscovib_simulate, only: simulate
  use viscovib_stepper, only: stepper_type
  use viscovib_task, only: task_type
  use viscovib_trajectory, only: shaken
  use viscovib_watch, only: new_watch, renumbered
  implicit none
  private

  public :: run_pendulum, run_polynomial

contains

  !> A piece of a run of a pendulum: `initial` (6), `method`: its place in `transient_methods`,
  !! `swings`: false: of the spring alone, phi = psi = 0.
  subroutine run_pendulum(task, piece)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(inout) :: piece
    type(pendulum_type), pointer :: system
    type(pendulum_type), target :: other
    type(spring_type) :: spring
    class(stepper_type), allocatable :: stepper
    real(wp), pointer, contiguous :: initial(:)
    real(wp), allocatable :: states(:, :), at_times(:, :)
    integer :: method
    logical :: swings

    system => task%pendulum()
    initial => piece%initial
    method = task%get_integer('method')
    swings = task%get_flag('swings')
    call task%check_extents('initial', shape(initial), [6])
    if (task%failed()) return
    if (piece%sign /= 0) then
      call new_pendulum(other, system%parameters%shaken(part_of_numbers), task%status)
      if (task%failed()) return
      system => other
    end if
    if (swings) then
      call new_stepper(stepper, system, method, initial(1::2), initial(2::2), &
                       piece%first*piece%h, piece%h, piece%tolerance)
    else
      call new_spring(spring, system)
      call new_stepper(stepper, spring, method, initial(1:1), initial(2:2), &
                       piece%first*piece%h, piece%h, piece%tolerance)
    end if
    if (piece%resume /= from_start) then
      call take_up_memory(task, piece, stepper%memory_size())
      if (task%failed()) return
      call stepper%load_memory(piece%memory(:stepper%memory_size()))
    end if
    if (.not. swings) then
      allocate (states(2, size(piece%states, 2)))
      allocate (at_times(2, size(piece%times)), source=0.0_wp)
      call simulate(stepper, spring, piece%first, piece%n_steps, piece%save_every, piece%times, &
                    states, at_times, piece%n_done, piece%n_reached, piece%t_reached, piece%ended)
      piece%states = 0.0_wp
      piece%states(:2, :) = states
      piece%at_times(:2, :) = at_times
      piece%last(:2) = [stepper%q, stepper%v]
    else
      if (piece%is_watched) then
        allocate (piece%watch)
        call new_watch(piece%watch, piece%watched, piece%sides)
        call simulate(stepper, system, piece%first, piece%n_steps, piece%save_every, piece%times, &
                      piece%states, piece%at_times, piece%n_done, piece%n_reached, &
                      piece%t_reached, piece%ended, watch=piece%watch)
      else
        call simulate(stepper, system, piece%first, piece%n_steps, piece%save_every, piece%times, &
                      piece%states, piece%at_times, piece%n_done, piece%n_reached, &
                      piece%t_reached, piece%ended)
      end if
      piece%last(1::2) = stepper%q
      piece%last(2::2) = stepper%v
    end if
    piece%kept = stepper%save_memory()
    piece%counted = stepper%n_evaluations
  end subroutine run_pendulum

  !> A piece of a run of a polynomial system without memory, or with one of exponentials alone.
  !!
  !! Given: the load as `orders` (k) and `series` (n + 1, k) of `make_load`, its frequency `nu`, its
  !! cubics `pieces` (n, 4, b) between `breaks` (b; less than two: none); the base by `base_breaks`
  !! and `base_pieces` (4, w, c); `held` (n) and what was before, `before` (m) and `moved` (n, m);
  !! `ends` and `made_by` of the steps; `moves` (n); `reach`: latest time of any run that goes on,
  !! for which kernels are fitted; `in_parts`: all steps are made in parts that see thin layers of
  !! forces; `thin`: how thin one may be for a part. The last numbers of `memory`: how long the next
  !! part of a step may be, whether steps were made in parts, and how many numbers are the method's.
  subroutine run_polynomial(task, piece)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(inout) :: piece
    type(polynomial_type), pointer :: system
    type(polynomial_type) :: reduced, taken
    type(polynomial_motion_type) :: motion
    type(load_type) :: load, part
    class(stepper_type), allocatable :: stepper
    type(mesh_type) :: mesh
    real(wp), allocatable :: q(:), v(:)
    real(wp), pointer, contiguous :: initial(:), memory(:)
    logical, allocatable :: moves(:)
    integer, allocatable :: dofs(:), rows(:)
    real(wp) :: start
    integer :: i, n, n_all

    system => polynomial_of(task)
    if (task%failed()) return
    n_all = system%n_dof()
    initial => piece%initial
    call task%check_extents('initial', shape(initial), [2*n_all])
    moves = moves_of(task, piece, n_all)
    if (.not. task%failed()) call load_of(task, n_all, load)
    if (task%failed()) return
    dofs = pack([(i, i=1, n_all)], moves)
    rows = pack([(i, i=1, 2*n_all)], state_mask(moves))
    n = size(dofs)
    if (n == n_all) then
      call copy_system(system, reduced)
      part = load
    else
      call reduce(system, moves, reduced)
      call load%take_part(moves, part)
    end if
    ! With the start forces have other arguments, u/(1 + s), and other values, by 1 + 2 s.
    if (piece%sign /= 0) reduced%mass = reduced%mass*(1.0_wp - 2.0_wp*shaken)
    call new_fitted_motion(motion, reduced, part, task%get_real('nu'), piece%h, &
                           task%get_real('reach'), task%status, taken)
    if (.not. task%failed()) call begin_past(task, motion, reduced, taken, dofs)
    if (.not. task%failed()) call add_tables(task, motion, reduced, dofs)
    if (task%failed()) return
    motion%thin = piece%thin
    motion%in_parts = motion%layers%exist() .and. piece%in_parts
    call piece%mesh(task, mesh)
    start = 0.0_wp
    if (piece%first > 0) start = mesh%time(mesh%piece_of(piece%first - 1), piece%first)
    i = mesh%piece_of(piece%first)
    call motion%base_motion%enter(mesh%beginning(i), mesh%ends(i))
    allocate (q(motion%n_dof), v(motion%n_dof))
    call motion%start(start, initial(2*dofs - 1), initial(2*dofs), q, v)
    if (piece%resume /= from_start) then
      call take_up_memory(task, piece, 2*motion%n_dof + motion%n_switches() + 3)
      if (task%failed()) return
      memory => piece%memory
    end if
    if (piece%resume == under_other_loads) then
      ! What is remembered goes on: all coordinates, then all velocities.
      q(n + 1:) = memory(n + 1:motion%n_dof)
      v(n + 1:) = memory(motion%n_dof + n + 1:2*motion%n_dof)
    end if
    call new_stepper(stepper, motion, task%get_integer('method'), q, v, start, mesh%h(i), &
                     piece%tolerance)
    if (piece%resume /= from_start) then
      call go_on(task, piece, motion, stepper, start, maxval(abs(initial)))
    end if
    if (task%failed()) return
    call make_steps(piece, motion, stepper, mesh, dofs, rows)
    i = stepper%memory_size()
    piece%kept = [stepper%save_memory(), motion%keep_switches(), motion%grade, &
                  merge(1.0_wp, 0.0_wp, motion%in_parts), real(i, wp)]
    q = stepper%q
    v = stepper%v
    call motion%add_base(piece%t_reached, q, v)
    piece%last = initial
    piece%last(2*dofs - 1) = q(:n)
    piece%last(2*dofs) = v(:n)
    piece%counted = stepper%n_evaluations
  end subroutine run_polynomial

  !> Take up what the piece before kept: the method, or under other loads what elements remember.
  subroutine go_on(task, piece, motion, stepper, start, largest)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(in) :: piece
    type(polynomial_motion_type), intent(inout) :: motion
    class(stepper_type), intent(inout) :: stepper
    real(wp), intent(in) :: start
    !> Largest number of the state at the start.
    real(wp), intent(in) :: largest
    real(wp), dimension(motion%n_dof) :: q, v
    integer :: i, n

    associate (memory => piece%memory)
      if (piece%resume /= under_other_loads) then
        call take_up_memory(task, piece, stepper%memory_size() + motion%n_switches() + 3)
        if (task%failed()) return
        call stepper%load_memory(memory(:stepper%memory_size()))
      end if
      ! Behind what the method kept under the loads before, which may have been as many or not.
      n = size(memory)
      i = nint(memory(n))
      if (i < 0 .or. i + motion%n_switches() > n - 3) then
        call take_up_memory(task, piece, n + 1)
        return
      end if
      call motion%recall_switches(memory(i + 1:i + motion%n_switches()))
      motion%begins = piece%resume == under_other_loads
      motion%grade = memory(n - 2)
      if (.not. (motion%begins .and. allocated(motion%sides))) return
      ! The base may go on with another velocity.
      i = merge(max_dof, motion%n_dof, stepper%explicit)
      q = stepper%q
      v = stepper%v
      call motion%jump_on(start, q, memory(i + 1:i + motion%n_dof), largest, v)
      if (any(abs(v - stepper%v) > 0.0_wp)) call stepper%put(q, v)
    end associate
  end subroutine go_on

  !> The steps of a piece, in the coordinates `dofs`, whose numbers of a state are `rows`.
  subroutine make_steps(piece, motion, stepper, mesh, dofs, rows)
    type(piece_type), intent(inout) :: piece
    type(polynomial_motion_type), intent(inout) :: motion
    class(stepper_type), intent(inout) :: stepper
    type(mesh_type), intent(in) :: mesh
    integer, intent(in) :: dofs(:), rows(:)
    real(wp), allocatable :: states(:, :), at_times(:, :)
    integer :: i

    if (piece%is_watched) then
      ! All coordinates are computed then.
      allocate (piece%watch)
      call new_watch(piece%watch, renumbered(piece%watched, size(dofs), [(i, i=1, motion%n_dof)]), &
                     piece%sides)
      call simulate(stepper, motion, piece%first, piece%n_steps, piece%save_every, piece%times, &
                    piece%states, piece%at_times, piece%n_done, piece%n_reached, &
                    piece%t_reached, piece%ended, mesh, piece%watch)
    else if (size(rows) == size(piece%states, 1)) then
      call simulate(stepper, motion, piece%first, piece%n_steps, piece%save_every, piece%times, &
                    piece%states, piece%at_times, piece%n_done, piece%n_reached, &
                    piece%t_reached, piece%ended, mesh)
    else
      allocate (states(size(rows), size(piece%states, 2)))
      allocate (at_times(size(rows), size(piece%times)), source=0.0_wp)
      call simulate(stepper, motion, piece%first, piece%n_steps, piece%save_every, piece%times, &
                    states, at_times, piece%n_done, piece%n_reached, piece%t_reached, &
                    piece%ended, mesh)
      piece%states = 0.0_wp
      piece%states(rows, :) = states
      piece%at_times(rows, :) = at_times
    end if
  end subroutine make_steps

  !> What was before a motion, which hidden coordinates remember.
  subroutine begin_past(task, motion, reduced, taken, dofs)
    type(task_type), intent(inout) :: task
    type(polynomial_motion_type), intent(inout) :: motion
    type(polynomial_type), intent(in) :: reduced, taken
    integer, intent(in) :: dofs(:)
    real(wp), pointer, contiguous :: held(:), before(:), moved(:, :)
    held => task%get_reals('held')
    before => task%get_reals('before')
    moved => task%get_matrix('moved')
    call task%check_extents('held', shape(held), [maxval([dofs, size(held)])])
    call task%check_extents('moved', shape(moved), [size(held), size(before)])
    if (task%failed()) return
    call begin_hidden(motion, reduced, taken, held(dofs), task%status, before, moved(dofs, :))
  end subroutine begin_past

  !> Cubics of the load and of the base.
  subroutine add_tables(task, motion, reduced, dofs)
    type(task_type), intent(inout) :: task
    type(polynomial_motion_type), intent(inout) :: motion
    type(polynomial_type), intent(in) :: reduced
    integer, intent(in) :: dofs(:)
    real(wp), pointer, contiguous :: breaks(:), pieces(:, :, :), base_breaks(:), &
                                     base_pieces(:, :, :)

    breaks => task%get_reals('breaks')
    pieces => task%get_cube('pieces')
    base_breaks => task%get_reals('base_breaks')
    base_pieces => task%get_cube('base_pieces')
    call task%check_extents('pieces', shape(pieces), [size(pieces, 1), 4, size(breaks)])
    call task%check_extents('base_pieces', shape(base_pieces), &
                            [4, size(base_pieces, 2), size(base_breaks)])
    if (task%failed()) return
    if (size(breaks) > 1) call motion%add_table(breaks, pieces(dofs, :, :))
    if (size(base_breaks) < 2) return
    if (size(base_pieces, 2) > 1) then
      call motion%base_motion%add_cubics(size(dofs), [real(wp) ::], base_breaks, &
                                         base_pieces(:, dofs, :))
    else
      call motion%base_motion%add_cubics(size(dofs), reduced%base_direction, base_breaks, &
                                         base_pieces)
    end if
  end subroutine add_tables

end module viscovib_plain_pieces
