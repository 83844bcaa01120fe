!> Pieces of runs with memory, of oscillators and of structures.
module viscovib_memory_pieces
  use viscovib_base_motion, only: base_motion_type
  use viscovib_binding_tools, only: make_base
  use viscovib_hereditary, only: begun, hereditary_type, new_hereditary, step_too_large
  use viscovib_hereditary_run, only: run_hereditary
  use viscovib_kinds, only: wp
  use viscovib_law_layers, only: unseen_by_node
  use viscovib_load, only: load_type
  use viscovib_mesh, only: mesh_type
  use viscovib_modal_maps, only: sections_type
  use viscovib_motion_piece, only: from_start, memory_under_other_loads, moves_of, &
    piece_type, polynomial_of, take_up_memory, under_other_loads
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: reduce, state_mask
  use viscovib_structure_march, only: new_structure_march, structure_march_type
  use viscovib_task, only: task_type
  use viscovib_time_load, only: time_load_type
  use viscovib_trajectory, only: shaken
  implicit none
  private

  public :: run_with_memory, run_structure

contains

  !> A piece of a run with memory, its past kept as exponentials or step by step.
  !!
  !! Given besides what pieces are: `initial` (2 n), `frequencies` (k) and `amplitudes` (n, k) of
  !! the load Im sum_k amplitudes(:, k) exp(i frequencies(k) t), its cubics `pieces` (n, 4, b)
  !! between `breaks` (b); the base by `waves` (w, k), w = 1: along the direction of the system, and
  !! by the cubics `base_pieces` (4, w, c) between `base_breaks` (c = 1: none), its acceleration
  !! being in the load already; `ends` and `made_by` of the steps; `nodes` a step; `past`: 1
  !! exponentials, 2 step by step; `held` (n): the displacement for all t < 0, or before the first
  !! of the times `before` (m) with displacements `moved` (n, m), ascending to 0; `moves` (n), see
  !! 'moving coordinates'; `shortest`: steps after corners of the load, and with `kinks` of the
  !! base, are not shorter, 0: there are none; `t_end`: the end of any run that goes on. Found too:
  !! `reason` (not 0: no run, see `viscovib_hereditary`), `resolution`: largest last Legendre
  !! coefficient of a displacement on a step, relative to its largest value; `too_long`: how many
  !! times as long steps are as those whose nodes see every thin layer of a law.
  subroutine run_with_memory(task, piece)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(inout) :: piece
    class(oscillator_type), pointer :: system
    type(polynomial_type), target :: reduced
    class(oscillator_type), allocatable, target :: other
    type(hereditary_type) :: run
    type(time_load_type) :: load
    type(base_motion_type) :: base
    type(mesh_type) :: mesh
    real(wp), pointer, contiguous :: initial(:), held(:), before(:), moved(:, :)
    real(wp), allocatable :: states(:, :), at_times(:, :), u(:), v(:), shortest
    integer, allocatable :: dofs(:), rows(:)
    logical, allocatable :: moves(:), kinks
    real(wp) :: too_long
    integer :: i, n, nodes, part
    logical :: made

    system => task%system()
    if (task%failed()) return
    n = system%n_dof()
    initial => piece%initial
    held => task%get_reals('held')
    before => task%get_reals('before')
    moved => task%get_matrix('moved')
    nodes = task%get_integer('nodes')
    moves = moves_of(task, piece, n)
    call task%check_extents('initial', shape(initial), [2*n])
    call task%check_extents('held', shape(held), [n])
    call task%check_extents('moved', shape(moved), [n, size(before)])
    if (task%failed()) return
    dofs = pack([(i, i=1, n)], moves)
    rows = pack([(i, i=1, 2*n)], state_mask(moves))
    if (piece%sign /= 0) then
      ! With the start forces have other arguments, u/(1 + s), and other values, by 1 + 2 s.
      allocate (other, source=system)
      call other%weigh(1.0_wp - 2.0_wp*shaken)
      system => other
    end if
    if (size(dofs) < n) then
      call reduce(system, moves, reduced)
      system => reduced
    end if
    call loads_with_memory(task, system, dofs, n, load, base)
    if (task%failed()) return
    call piece%mesh(task, mesh)
    part = mesh%piece_of(piece%first)
    u = initial(2*dofs - 1)
    v = initial(2*dofs)
    call base%enter(mesh%beginning(part), mesh%ends(part))
    call base%add_to(mesh%start_of(piece%first), u, v, share=-1.0_wp)
    call take_shortest(piece, shortest, kinks)
    call new_hereditary(run, system, load, nodes, piece%past, held(dofs), u, v, &
                        mesh%h(part), task%get_real('t_end'), piece%tolerance, piece%reason, &
                        before, moved(dofs, :), shortest, kinks)
    if (task%failed()) return
    if (piece%reason == begun .and. piece%resume /= from_start) then
      made = .true.
      if (piece%resume /= under_other_loads) then
        call take_up_memory(task, piece, run%memory_size())
        if (task%failed()) return
        call run%load_memory(piece%memory, .false.)
      else
        call run%load_memory(memory_under_other_loads(piece, run%memory_size()), .true.)
        call run%take_up(system, load, mesh%start_of(piece%first), u, v, made)
      end if
      if (.not. made) piece%reason = step_too_large
    end if
    too_long = 0.0_wp
    piece%last = initial
    run%gives_up = piece%gives_up
    if (piece%reason == begun) then
      if (size(dofs) == n) then
        if (piece%is_watched) call piece%begin_watch(run%n_observed())
        call run_hereditary(run, system, load, base, piece%first, piece%n_steps, &
                            piece%save_every, piece%times, piece%states, piece%at_times, &
                            piece%n_done, piece%n_reached, piece%t_reached, piece%ended, mesh, &
                            piece%resume == under_other_loads, piece%watch, too_long)
      else
        allocate (states(size(rows), size(piece%states, 2)))
        allocate (at_times(size(rows), size(piece%times)), source=0.0_wp)
        call run_hereditary(run, system, load, base, piece%first, piece%n_steps, &
                            piece%save_every, piece%times, states, at_times, piece%n_done, &
                            piece%n_reached, piece%t_reached, piece%ended, mesh, &
                            piece%resume == under_other_loads, thinnest=too_long)
        piece%states = 0.0_wp
        piece%states(rows, :) = states
        piece%at_times(rows, :) = at_times
      end if
      u = run%u
      v = run%v
      call base%add_to(piece%t_reached, u, v)
      piece%last(2*dofs - 1) = u
      piece%last(2*dofs) = v
      piece%counted = run%equations%n_iterations
      piece%resolution = run%resolution()
      piece%kept = run%save_memory()
    end if
    piece%too_long = too_long/(unseen_by_node*nodes)
  end subroutine run_with_memory

  !> The shortest step after corners, and whether the base has some; not allocated: none follows.
  pure subroutine take_shortest(piece, shortest, kinks)
    type(piece_type), intent(in) :: piece
    real(wp), allocatable, intent(out) :: shortest
    logical, allocatable, intent(out) :: kinks
    if (.not. piece%shortest > 0.0_wp) return
    allocate (shortest, source=piece%shortest)
    allocate (kinks, source=piece%kinks)
  end subroutine take_shortest

  !> Loads and base of a run with memory, of the coordinates `dofs` of n.
  subroutine loads_with_memory(task, system, dofs, n, load, base)
    type(task_type), intent(inout) :: task
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: dofs(:), n
    type(time_load_type), intent(out) :: load
    type(base_motion_type), intent(out) :: base
    complex(wp), pointer, contiguous :: amplitudes(:, :), waves(:, :)
    real(wp), pointer, contiguous :: frequencies(:), breaks(:), pieces(:, :, :), base_breaks(:), &
                                     base_pieces(:, :, :)

    frequencies => task%get_reals('frequencies')
    amplitudes => task%get_complex_matrix('amplitudes')
    breaks => task%get_reals('breaks')
    pieces => task%get_cube('pieces')
    waves => task%get_complex_matrix('waves')
    base_breaks => task%get_reals('base_breaks')
    base_pieces => task%get_cube('base_pieces')
    call task%check_extents('amplitudes', shape(amplitudes), [n, size(frequencies)])
    call task%check_extents('pieces', shape(pieces), [n, 4, size(breaks)])
    call task%check_extents('waves', shape(waves), [merge(n, 1, size(waves, 1) > 1), &
                                                    size(frequencies)])
    call task%check_extents('base_pieces', shape(base_pieces), [4, size(waves, 1), &
                                                                size(base_breaks)])
    if (task%failed()) return
    load%frequencies = frequencies
    load%amplitudes = amplitudes(dofs, :)
    load%breaks = breaks
    load%pieces = pieces(dofs, :, :)
    if (.not. (any(abs(waves) > 0.0_wp) .or. size(base_breaks) > 1)) return
    if (size(waves, 1) > 1) then
      call make_base(base, [real(wp) ::], frequencies, waves(dofs, :), base_breaks, &
                     base_pieces(:, dofs, :))
    else
      call make_base(base, system%base_direction, frequencies, waves, base_breaks, base_pieces)
    end if
  end subroutine loads_with_memory

  !> A piece of a run of a structure, as one with memory, whose linear rest are n sections
  !! q'' + `rates` q' + `squares` q = pushes.
  !!
  !! The system is a polynomial one in the s deflections `seen`^T q (n, s), its mass and damping
  !! idle; its forces act on the modes by -`pushed` (n, s). The load is
  !! Im sum_k `waves`(:, k) exp(i `frequencies`(k) t) on the modes, and columns of the cubics
  !! `pieces` (c, 4, b) between `breaks` (b = 1: none), which push them by `patterns` (n, c). Kept
  !! are coordinates `shown`^T q (n, m) and their velocities, of a body whose base moves them by
  !! `direction` (m), and the modes by `inner` (n); the base by `base_waves` (k) and `base_pieces`
  !! (4, c) between `base_breaks` (c = 1: none). The start, `start`, `start_rates` and
  !! `start_others`, is relative to the base. With resume = 2 the base jumps back by `kick`, its
  !! displacement and its velocity. What has no real modes, as `viscovib_pole_maps` takes it, are
  !! `poles` (p), of conjugates one each, the last `n_at_once` of them follow their forces at once;
  !! `left` (p, s), `right` (p, s + c), `shown_left` (p, m), `sine` and `cosine` (p, k); `by_base`
  !! (p, 2): by a jump of the base, and of its velocity. Found besides: `phased`, as `phase_errors`
  !! has it of what is kept.
  subroutine run_structure(task, piece)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(inout) :: piece
    type(polynomial_type), pointer :: system
    type(structure_march_type) :: run
    type(sections_type) :: sections
    type(time_load_type) :: load
    type(base_motion_type) :: base
    type(mesh_type) :: mesh
    real(wp), pointer, contiguous :: shown(:, :), held(:), before(:), moved(:, :), start(:), &
                                     start_rates(:), kick(:)
    complex(wp), pointer, contiguous :: shown_left(:, :), start_others(:)
    real(wp), allocatable :: u(:), v(:), shortest
    logical, allocatable :: kinks
    real(wp) :: begin, too_long
    integer :: n, nodes, part, used
    logical :: made

    system => polynomial_of(task)
    shown => task%get_matrix('shown')
    n = size(shown, 2)
    call task%check_extents('initial', shape(piece%initial), [2*n])
    shown_left => task%get_complex_matrix('shown_left')
    held => task%get_reals('held')
    before => task%get_reals('before')
    moved => task%get_matrix('moved')
    start => task%get_reals('start')
    start_rates => task%get_reals('start_rates')
    start_others => task%get_complexes('start_others')
    kick => task%get_reals('kick')
    nodes = task%get_integer('nodes')
    call read_sections(task, sections, load, base, n)
    call task%check_extents('kick', shape(kick), [2])
    call task%check_extents('start', shape(start), shape(sections%squares))
    call task%check_extents('start_rates', shape(start_rates), shape(sections%squares))
    if (task%failed()) return
    used = size(sections%others%poles)
    begin = 1.0_wp + piece%sign*shaken
    if (piece%sign /= 0) call push_harder(sections, 1.0_wp + 2.0_wp*shaken)
    call piece%mesh(task, mesh)
    part = mesh%piece_of(piece%first)
    call base%enter(mesh%beginning(part), mesh%ends(part))
    call take_shortest(piece, shortest, kinks)
    call new_structure_march(run, system, sections, shown, shown_left(:used, :), load, nodes, &
                             piece%past, held, &
                             begin*[start, real(start_others(:used))], &
                             begin*[start_rates, aimag(start_others(:used))], mesh%h(part), &
                             task%get_real('t_end'), piece%tolerance, piece%reason, before, moved, &
                             shortest, kinks)
    if (task%failed()) return
    if (piece%reason == begun .and. piece%resume /= from_start) then
      made = .true.
      if (piece%resume /= under_other_loads) then
        call take_up_memory(task, piece, run%memory_size())
        if (task%failed()) return
        call run%load_memory(piece%memory, .false.)
      else
        call run%load_memory(memory_under_other_loads(piece, run%memory_size()), .true.)
        call run%kick(base, kick(1:1), kick(2:2))
        call run%get_state(u, v)
        call run%take_up(system, load, mesh%start_of(piece%first), u, v, made)
      end if
      if (.not. made) piece%reason = step_too_large
    end if
    allocate (piece%phased(2*n), source=0.0_wp)
    piece%last = piece%initial
    too_long = 0.0_wp
    if (piece%reason == begun) then
      if (piece%is_watched) call piece%begin_watch(run%n_observed())
      run%gives_up = piece%gives_up
      call run_hereditary(run, system, load, base, piece%first, piece%n_steps, piece%save_every, &
                          piece%times, piece%states, piece%at_times, piece%n_done, &
                          piece%n_reached, piece%t_reached, piece%ended, mesh, &
                          piece%resume == under_other_loads, piece%watch, too_long)
      if (allocated(u)) deallocate (u, v)
      allocate (u(n), v(n))
      call run%observe(u, v)
      call base%add_to(piece%t_reached, u, v)
      piece%last(1::2) = u
      piece%last(2::2) = v
      piece%counted = run%equations%n_iterations
      piece%resolution = run%resolution()
      piece%phased = run%phase_errors()
      piece%kept = run%save_memory()
    end if
    piece%too_long = too_long/(unseen_by_node*nodes)
  end subroutine run_structure

  !> Forces of loads and elements so many times as large.
  pure subroutine push_harder(sections, times)
    type(sections_type), intent(inout) :: sections
    real(wp), intent(in) :: times
    sections%pushed = times*sections%pushed
    sections%waves = times*sections%waves
    sections%others%right = times*sections%others%right
    sections%others%sine = times*sections%others%sine
    sections%others%cosine = times*sections%others%cosine
  end subroutine push_harder

  !> The linear rest of a structure, and what acts on it.
  subroutine read_sections(task, sections, load, base, n_shown)
    type(task_type), intent(inout) :: task
    type(sections_type), intent(out) :: sections
    type(time_load_type), intent(out) :: load
    type(base_motion_type), intent(out) :: base
    integer, intent(in) :: n_shown
    real(wp), pointer, contiguous :: frequencies(:), pushed(:, :), patterns(:, :), breaks(:), &
                                     pieces(:, :, :), direction(:), base_breaks(:), &
                                     base_pieces(:, :)
    complex(wp), pointer, contiguous :: waves(:, :), poles(:), left(:, :), right(:, :), &
                                        sine(:, :), cosine(:, :), by_base(:, :), base_waves(:)
    integer, allocatable :: some(:)
    integer :: columns, k, n, q, used

    allocate (sections%squares, source=task%get_reals('squares'))
    allocate (sections%rates, source=task%get_reals('rates'))
    allocate (sections%seen, source=task%get_matrix('seen'))
    allocate (sections%inner, source=task%get_reals('inner'))
    pushed => task%get_matrix('pushed')
    patterns => task%get_matrix('patterns')
    frequencies => task%get_reals('frequencies')
    waves => task%get_complex_matrix('waves')
    breaks => task%get_reals('breaks')
    pieces => task%get_cube('pieces')
    poles => task%get_complexes('poles')
    left => task%get_complex_matrix('left')
    right => task%get_complex_matrix('right')
    sine => task%get_complex_matrix('sine')
    cosine => task%get_complex_matrix('cosine')
    by_base => task%get_complex_matrix('by_base')
    direction => task%get_reals('direction')
    base_waves => task%get_complexes('base_waves')
    base_breaks => task%get_reals('base_breaks')
    base_pieces => task%get_matrix('base_pieces')
    n = size(sections%squares)
    q = size(pushed, 2)
    columns = merge(size(patterns, 2), 0, size(breaks) > 1)
    call task%check_extents('rates', shape(sections%rates), [n])
    call task%check_extents('seen', shape(sections%seen), [n, q])
    call task%check_extents('pushed', shape(pushed), [n])
    call task%check_extents('patterns', shape(patterns), [n])
    call task%check_extents('waves', shape(waves), [n, size(frequencies)])
    call task%check_extents('pieces', shape(pieces), [size(pieces, 1), 4, size(breaks)])
    call task%check_extents('left', shape(left), [size(poles), q])
    call task%check_extents('right', shape(right), [size(poles)])
    call task%check_extents('sine', shape(sine), [size(poles), size(frequencies)])
    call task%check_extents('cosine', shape(cosine), [size(poles), size(frequencies)])
    call task%check_extents('by_base', shape(by_base), [size(poles), 2])
    call task%check_extents('direction', shape(direction), [n_shown])
    call task%check_extents('base_pieces', shape(base_pieces), [4, size(base_breaks)])
    if (task%failed()) return
    allocate (sections%pushed(n, q + columns))
    sections%pushed(:, :q) = pushed
    sections%pushed(:, q + 1:) = patterns(:, :columns)
    some = pack([(k, k=1, size(frequencies))], [(any(abs(waves(:, k)) > 0.0_wp) &
                                                 .or. any(abs(sine(:, k)) > 0.0_wp) &
                                                 .or. any(abs(cosine(:, k)) > 0.0_wp), &
                                                 k=1, size(frequencies))])
    sections%frequencies = frequencies(some)
    sections%waves = waves(:, some)
    associate (others => sections%others)
      others%n_at_once = task%get_integer('n_at_once')
      used = size(poles)
      ! A single pole of 0 stands for none.
      if (used == 1 .and. others%n_at_once == 0) used = count(abs(poles) > 0.0_wp)
      others%poles = poles(:used)
      others%left = left(:used, :)
      others%right = right(:used, :q + columns)
      others%sine = sine(:used, some)
      others%cosine = cosine(:used, some)
      others%by_base = by_base(:used, 1)
      others%by_base_rate = by_base(:used, 2)
    end associate
    allocate (load%frequencies(0), load%amplitudes(columns, 0))
    load%breaks = breaks
    load%pieces = pieces(:columns, :, :)
    call make_base(base, direction, frequencies, spread(base_waves, 1, 1), base_breaks, &
                   spread(base_pieces, 2, 1))
  end subroutine read_sections

end module viscovib_memory_pieces
