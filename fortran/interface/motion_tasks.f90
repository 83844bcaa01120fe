!> Tasks about motions in time: pieces of runs, what goes before them, and what a plan says.
!!
!! A run goes piece by piece. What it needs to go on is `memory`, which a piece finds and the next
!! one is given.
module viscovib_motion_tasks
  use viscovib_fitted_memory, only: bound_hidden, copy_system, fit_memory, needs_fit
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_hereditary_job, only: hereditary_job, plan_hereditary
  use viscovib_hidden_memory, only: count_hidden
  use viscovib_hidden_start, only: begin_hidden
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: max_dof
  use viscovib_load, only: load_type, new_load
  use viscovib_memory_pieces, only: run_structure, run_with_memory
  use viscovib_mesh, only: mesh_type, new_mesh
  use viscovib_method_catalogue, only: new_stepper
  use viscovib_motion_beside, only: motion_beside
  use viscovib_motion_piece, only: from_start, load_of, moves_of, piece_type, polynomial_of, &
    take_up_memory, under_other_loads
  use viscovib_motion_slopes, only: has_slopes
  use viscovib_oscillator, only: oscillator_type
  use viscovib_passage_errors, only: passage_errors
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_job, only: plan_pendulum
  use viscovib_pendulum_spring, only: new_spring, spring_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_job, only: plan_polynomial
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_reduction, only: moved_coordinates, reduce, state_mask
  use viscovib_simulate, only: simulate
  use viscovib_status, only: fail, status_input_error
  use viscovib_stepper, only: stepper_type
  use viscovib_task, only: task_type
  use viscovib_transient_job, only: transient_job
  use viscovib_watch, only: new_watch, renumbered, watch_type
  implicit none
  private

  public :: motion_task

contains

  subroutine motion_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('given')
      ! An object that holds values for the tasks that build on it.
      return
    case ('of pendulum')
      call run_pendulum(task)
    case ('without memory')
      call run_polynomial(task)
    case ('with memory')
      call run_with_memory(task)
    case ('of structure')
      call run_structure(task)
    case ('of a period')
      call run_period(task)
    case ('moving coordinates')
      call find_moving(task)
    case ('hidden coordinates')
      call count_hidden_coordinates(task)
    case ('fastest rate')
      call find_fastest(task)
    case ('plan of pendulum')
      call plan_of_pendulum(task)
    case ('plan without memory')
      call plan_without_memory(task)
    case ('plan with memory')
      call plan_with_memory(task)
    case ('event errors')
      call find_event_errors(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine motion_task

  !> A piece of a run of a pendulum: `initial` (6), `method`: its place in `transient_methods`,
  !! `swings`: false: of the spring alone, phi = psi = 0.
  subroutine run_pendulum(task)
    type(task_type), intent(inout) :: task
    type(pendulum_type), pointer :: system
    type(piece_type) :: piece
    type(spring_type) :: spring
    class(stepper_type), allocatable :: stepper
    type(watch_type) :: watch
    real(wp), pointer, contiguous :: initial(:)
    real(wp), allocatable :: states(:, :), at_times(:, :)
    integer :: method
    logical :: swings

    system => task%pendulum()
    call piece%read(task, 6, 13)
    initial => task%get_reals('initial')
    method = task%get_integer('method')
    swings = task%get_flag('swings')
    call task%check_extents('initial', shape(initial), [6])
    if (task%failed()) return
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
        call new_watch(watch, piece%watched, piece%sides)
        call simulate(stepper, system, piece%first, piece%n_steps, piece%save_every, piece%times, &
                      piece%states, piece%at_times, piece%n_done, piece%n_reached, &
                      piece%t_reached, piece%ended, watch=watch)
        call piece%hand_over(watch)
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
    call piece%put(task)
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
  subroutine run_polynomial(task)
    type(task_type), intent(inout) :: task
    type(piece_type) :: piece
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
    call piece%read(task, 2*n_all, 3*n_all + 4)
    initial => task%get_reals('initial')
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
    call new_fitted_motion(motion, reduced, part, task%get_real('nu'), piece%h, &
                           task%get_real('reach'), task%status, taken)
    if (.not. task%failed()) call begin_past(task, motion, reduced, taken, dofs)
    if (.not. task%failed()) call add_tables(task, motion, reduced, dofs)
    if (task%failed()) return
    motion%thin = task%get_real('thin')
    motion%in_parts = motion%layers%exist() .and. task%get_flag('in_parts')
    call new_mesh(mesh, piece%h, task%get_reals('ends'), task%get_longs('made_by'))
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
    call piece%put(task)
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
    type(watch_type) :: watch
    real(wp), allocatable :: states(:, :), at_times(:, :)
    integer :: i

    if (piece%is_watched) then
      ! All coordinates are computed then.
      call new_watch(watch, renumbered(piece%watched, size(dofs), [(i, i=1, motion%n_dof)]), &
                     piece%sides)
      call simulate(stepper, motion, piece%first, piece%n_steps, piece%save_every, piece%times, &
                    piece%states, piece%at_times, piece%n_done, piece%n_reached, &
                    piece%t_reached, piece%ended, mesh, watch)
      call piece%hand_over(watch)
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

  !> A motion of a polynomial system from t = 0, in `n_steps` equal steps `h`, and the derivatives
  !! of its end: `by_start`(i, j) is the derivative of number i of the last state by number j of the
  !! first. Without `neighbours` they are not computed, and `known` is 0: the motion alone takes far
  !! less time. A state are coordinates and velocities alternately, then the rates of hidden states;
  !! `begin` is the first. The load as of a run without memory. `at_times`: states at the ascending
  !! `times`, `n_reached` of them, without hidden states. `n_passed`: surfaces crossed; `known` = 0:
  !! the derivatives are unknown.
  subroutine run_period(task)
    type(task_type), intent(inout) :: task
    type(polynomial_type), pointer :: system
    type(polynomial_motion_type) :: motion
    type(load_type) :: load
    class(stepper_type), allocatable :: stepper
    type(motion_beside) :: along
    real(wp), pointer, contiguous :: begin(:), times(:)
    real(wp), allocatable :: hidden(:), whole(:, :), none(:, :), at_times(:, :), last(:), &
                             by_start(:, :)
    integer, allocatable :: place(:)
    real(wp) :: h, t_reached
    integer(i8) :: n_done, n_steps
    integer :: i, n, n_reached, ended, n_passed
    logical :: known

    system => polynomial_of(task)
    if (task%failed()) return
    n = system%n_dof()
    h = task%get_real('h')
    n_steps = task%get_long('n_steps')
    begin => task%get_reals('begin')
    times => task%get_reals('times')
    call load_of(task, n, load)
    if (task%failed()) return
    call new_fitted_motion(motion, system, load, task%get_real('nu'), h, h*n_steps, task%status)
    if (task%failed()) return
    if (.not. has_slopes(motion)) then
      call fail(task%status, status_input_error, 'system', 'system: has elements that know what ' &
                //'was, or laws of more arguments than are differentiated here')
      return
    end if
    call task%check_extents('begin', shape(begin), [2*n + motion%n_hidden])
    if (task%failed()) return
    ! Displacements that stand for what is remembered act on nothing, and begin with 0.
    allocate (hidden(motion%n_hidden), source=0.0_wp)
    call new_stepper(stepper, motion, task%get_integer('method'), [begin(1:2*n:2), hidden], &
                     [begin(2:2*n:2), begin(2*n + 1:)], 0.0_wp, h, task%get_real('tolerance'))
    motion%thin = task%get_real('thin')
    allocate (none(2*n, 0))
    allocate (at_times(2*n, size(times)), by_start(size(begin), size(begin)), source=0.0_wp)
    n_passed = 0
    known = .false.
    if (task%get_flag('neighbours')) then
      call along%begin(motion%n_dof)
      call simulate(stepper, motion, 0_i8, n_steps, 1_i8, times, none, at_times, n_done, &
                    n_reached, t_reached, ended, beside=along)
      ! Of all coordinates, then of all velocities, the place of each number of the state.
      allocate (place, source=[([i, motion%n_dof + i], i=1, n), &
                               (motion%n_dof + i, i=n + 1, motion%n_dof)])
      allocate (whole(2*motion%n_dof, 2*motion%n_dof))
      whole(:motion%n_dof, :) = along%q
      whole(motion%n_dof + 1:, :) = along%v
      by_start = whole(place, place)
      n_passed = along%n_passed
      known = along%known
    else
      call simulate(stepper, motion, 0_i8, n_steps, 1_i8, times, none, at_times, n_done, &
                    n_reached, t_reached, ended)
    end if
    allocate (last, source=begin)
    last(1:2*n:2) = stepper%q(:n)
    last(2:2*n:2) = stepper%v(:n)
    last(2*n + 1:) = stepper%v(n + 1:)
    associate (found => task%found)
      call found%put_reals('last', last, shape(last))
      call found%put_reals('by_start', by_start, shape(by_start))
      call found%put_reals('at_times', at_times, shape(at_times))
      call found%put_integer('n_reached', int(n_reached, i8))
      call found%put_integer('n_passed', int(n_passed, i8))
      call found%put_integer('known', merge(1_i8, 0_i8, known))
      call found%put_integer('ended', int(ended, i8))
      call found%put_real('reached', t_reached)
    end associate
  end subroutine run_period

  !> Which coordinates move (1) if those with `driven` /= 0 (n) are driven: `moves` (n).
  subroutine find_moving(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    integer, allocatable :: driven(:), moves(:)
    system => task%system()
    allocate (driven, source=task%get_integers('driven'))
    if (task%failed()) return
    call task%check_extents('driven', shape(driven), [system%n_dof()])
    if (task%failed()) return
    allocate (moves, source=merge(1, 0, moved_coordinates(system, driven /= 0)))
    call task%found%put_integers('moves', moves, shape(moves))
  end subroutine find_moving

  !> How many coordinates the memory of a system takes in a motion without memory, in steps `h` to
  !! the time `reach`: `n_hidden`; h = 0: at most; -1: not all of its kernels are sums of
  !! exponentials, or have any. `fitted`: whether some kernel is fitted.
  subroutine count_hidden_coordinates(task)
    type(task_type), intent(inout) :: task
    type(polynomial_type), pointer :: system
    type(polynomial_type) :: whole
    real(wp) :: h
    integer :: n_hidden
    system => polynomial_of(task)
    h = task%get_real('h')
    if (task%failed()) return
    if (h > 0.0_wp) then
      call fit_memory(system, h, task%get_real('reach'), whole)
      n_hidden = count_hidden(whole)
    else
      n_hidden = bound_hidden(system)
    end if
    call task%found%put_integer('n_hidden', int(n_hidden, i8))
    call task%found%put_integer('fitted', merge(1_i8, 0_i8, needs_fit(system)))
  end subroutine count_hidden_coordinates

  !> Upper bound of the rates of the linear rest of a polynomial system (rad/s): `fastest`.
  subroutine find_fastest(task)
    type(task_type), intent(inout) :: task
    type(polynomial_type), pointer :: system
    type(load_type) :: load
    type(polynomial_motion_type) :: motion
    complex(wp), allocatable :: forces(:, :), none(:)
    system => polynomial_of(task)
    if (task%failed()) return
    allocate (forces(system%n_dof(), 0), none(0))
    call new_load(load, system%n_dof(), [integer ::], forces, none, task%status)
    ! Of any steps and times: rates are those of coordinates.
    call new_fitted_motion(motion, system, load, 0.0_wp, 1.0_wp, 1.0_wp, task%status)
    if (.not. task%failed()) call task%found%put_real('fastest', motion%fastest())
  end subroutine find_fastest

  !> What plans are given: `initial`, `t_end`, `dt` (0: it is found by `tolerance`), `method`,
  !! `save_every`, `last_only`. Their `text` is found.
  subroutine read_plan(task, job)
    type(task_type), intent(inout) :: task
    class(transient_job), intent(inout) :: job
    allocate (job%initial, source=task%get_reals('initial'))
    job%t_end = task%get_real('t_end')
    job%dt = task%get_real('dt')
    job%tolerance = task%get_real('tolerance')
    job%method = task%get_integer('method')
    job%save_every = task%get_integer('save_every')
    job%last_only = task%get_flag('last_only')
  end subroutine read_plan

  subroutine plan_of_pendulum(task)
    type(task_type), intent(inout) :: task
    type(pendulum_type), pointer :: system
    type(transient_job) :: job
    system => task%pendulum()
    call read_plan(task, job)
    if (.not. task%failed()) call task%found%put_text('text', plan_pendulum(job, system))
  end subroutine plan_of_pendulum

  subroutine plan_without_memory(task)
    type(task_type), intent(inout) :: task
    type(polynomial_type), pointer :: system
    type(load_type) :: load
    type(transient_job) :: job
    real(wp) :: reach
    system => polynomial_of(task)
    if (task%failed()) return
    call load_of(task, system%n_dof(), load)
    call read_plan(task, job)
    reach = task%get_real('reach')
    if (task%failed()) return
    call task%found%put_text('text', plan_polynomial(job, system, load, reach))
  end subroutine plan_without_memory

  !> `past`: the place in `past_names`.
  subroutine plan_with_memory(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    type(load_type) :: load
    type(hereditary_job) :: job
    system => task%system()
    if (task%failed()) return
    call load_of(task, system%n_dof(), load)
    call read_plan(task, job)
    allocate (job%held, source=task%get_reals('held'))
    job%past = task%get_integer('past')
    call task%check_extents('held', shape(job%held), [system%n_dof()])
    if (task%failed()) return
    call task%found%put_text('text', plan_hereditary(job, system, load))
  end subroutine plan_with_memory

  !> Errors of passages of a run, as `viscovib_passage_errors` has them: `errors` (2, m) of the m
  !! columns of `own`.
  subroutine find_event_errors(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: watched(:), own(:, :), other(:, :), times(:), apart(:, :), &
                                     span(:)
    real(wp), allocatable :: errors(:, :)
    watched => task%get_reals('watched')
    own => task%get_matrix('own')
    other => task%get_matrix('other')
    times => task%get_reals('times')
    apart => task%get_matrix('apart')
    span => task%get_reals('span')
    call task%check_extents('span', shape(span), [2])
    call task%check_extents('apart', shape(apart), [size(apart, 1), size(times)])
    if (task%failed()) return
    allocate (errors(2, size(own, 2)))
    call passage_errors(watched, own, other, times, apart, task%get_real('least'), span, &
                        task%get_flag('compared'), errors)
    call task%found%put_reals('errors', errors, shape(errors))
  end subroutine find_event_errors

end module viscovib_motion_tasks
