! Optimize: -O1
!> Input and output of tasks about solutions in time.
module viscovib_motion_inputs
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_base_motion, only: base_motion_type
  use viscovib_binding_tools, only: make_load
  use viscovib_kinds, only: wp
  use viscovib_known_motion, only: known_motion
  use viscovib_load, only: load_type
  use viscovib_memory_pieces, only: make_base, oscillator_equations, structure_equations
  use viscovib_motion_choice, only: nodes, without_memory
  use viscovib_motion_piece, only: motion_equations, nothing, piece_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum_spring, only: swings
  use viscovib_plain_pieces, only: part_of_numbers, pendulum_equations, polynomial_equations
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: fail, status_input_error
  use viscovib_task, only: task_type
  use viscovib_time_load, only: time_load_type
  implicit none
  private

  public :: load_of, polynomial_of, read_equations, read_known, read_known_load, read_past, &
    read_piece, read_sections, read_tables

contains

  !> What every run is given: `initial` (m), its state after the `first` steps; `resume`, as of
  !! `piece_type`, with `memory`; `save_every`, `h`, `tolerance`, `times` (n); with events `watched`
  !! and `sides`; where steps end, as of `new_mesh`, `ends` and `made_by`. Some runs have
  !! `in_parts`, `past` (1: exponentials, 2: step by step), `shortest` (steps after corners of the
  !! load, and with `kinks` of the base, are not shorter; 0: there are none). `accelerates`:
  !! accelerations relative to the base, then forces of laws, are found at the times.
  subroutine read_piece(task, piece)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(out) :: piece

    piece%initial => task%get_reals('initial')
    piece%first = task%get_long('first')
    piece%save_every = task%get_long('save_every')
    piece%resume = task%get_integer('resume')
    piece%h = task%get_real('h')
    piece%tolerance = task%get_real('tolerance')
    allocate (piece%times, source=task%get_reals('times'))
    piece%memory => nothing
    if (task%has('memory')) piece%memory => task%get_reals('memory')
    if (task%has('ends')) then
      allocate (piece%ends, source=task%get_reals('ends'))
      allocate (piece%made_by, source=task%get_longs('made_by'))
    end if
    piece%in_parts = task%get_flag('in_parts', .false.)
    piece%past = task%get_integer('past', 0)
    piece%shortest = task%get_real('shortest', 0.0_wp)
    piece%kinks = task%get_flag('kinks', .false.)
    piece%accelerates = task%get_flag('accelerates', .false.)
    piece%is_watched = task%has('watched')
    if (.not. piece%is_watched) return
    piece%watched => task%get_reals('watched')
    allocate (piece%sides, source=task%get_integers('sides'))
  end subroutine read_piece

  !> Read the equations of a task or object, whose name tells their kind.
  subroutine read_equations(task, piece, equations)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(in) :: piece
    class(motion_equations), allocatable, intent(out) :: equations
    select case (task%kind)
    case ('motion of pendulum')
      call read_pendulum(task, piece, equations)
    case ('motion of oscillator')
      if (task%get_integer('equations') == without_memory) then
        call read_polynomial(task, piece, equations)
      else
        call read_oscillator(task, piece, equations)
      end if
    case ('motion of structure')
      call read_structure(task, piece, equations)
    case default
      call task%refuse_kind()
    end select
  end subroutine read_equations

  !> `method`: index in `transient_methods`.
  subroutine read_pendulum(task, piece, equations)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(in) :: piece
    class(motion_equations), allocatable, intent(out) :: equations
    type(pendulum_equations), allocatable :: own
    real(wp), pointer, contiguous :: start(:)
    allocate (own)
    own%system => task%pendulum()
    own%method = task%get_integer('method')
    own%change = part_of_numbers
    start => piece%initial
    if (task%has('begun')) start => task%get_reals('begun')
    call task%check_extents('initial', shape(start), [6])
    if (task%failed()) return
    own%swings = swings(own%system, start) .or. piece%is_watched
    call move_alloc(own, equations)
  end subroutine read_pendulum

  !> The load as `orders` (k) and `series` (n + 1, k) of `make_load`, its frequency `nu`; `method`,
  !! `reach`, `moves` (n) and the other components of `polynomial_equations` by name.
  subroutine read_polynomial(task, piece, equations)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(in) :: piece
    class(motion_equations), allocatable, intent(out) :: equations
    type(polynomial_equations), allocatable :: own
    integer :: n

    allocate (own)
    own%system => polynomial_of(task)
    if (task%failed()) return
    n = own%system%n_dof()
    call load_of(task, n, own%load)
    own%method = task%get_integer('method')
    own%nu = task%get_real('nu')
    own%reach = task%get_real('reach')
    call read_past(task, n, own)
    call read_loads(task, n, piece, own)
    if (task%failed()) return
    call own%look_at(own%system)
    call move_alloc(own, equations)
  end subroutine read_polynomial

  !> The motion before t = 0: `held`, `before` and `moved`; not given: n coordinates are at rest.
  subroutine read_past(task, n, own)
    type(task_type), intent(inout) :: task
    integer, intent(in) :: n
    class(motion_equations), intent(inout) :: own
    if (.not. task%has('before')) then
      call own%set_past(spread(0.0_wp, 1, n))
      return
    end if
    allocate (own%held, source=task%get_reals('held'))
    allocate (own%before, source=task%get_reals('before'))
    allocate (own%moved, source=task%get_matrix('moved'))
  end subroutine read_past

  !> Loads and the motion of the base as polynomials, if there are any, for n coordinates with a
  !! past; `moves` (n).
  subroutine read_loads(task, n, piece, own)
    type(task_type), intent(inout) :: task
    integer, intent(in) :: n
    type(piece_type), intent(in) :: piece
    class(motion_equations), intent(inout) :: own
    allocate (own%moves, source=task%get_integers('moves') /= 0)
    call read_tables(task, n, own)
    call task%check_extents('initial', shape(piece%initial), [2*n])
    call task%check_extents('moves', shape(own%moves), [n])
    call task%check_extents('held', shape(own%held), [n])
    call task%check_extents('moved', shape(own%moved), [n, size(own%before)])
  end subroutine read_loads

  !> The tables of loads, `breaks` and `pieces`, and of the base, `base_breaks` and `base_pieces`.
  subroutine read_tables(task, n, own)
    type(task_type), intent(inout) :: task
    integer, intent(in) :: n
    class(motion_equations), intent(inout) :: own
    if (task%has('breaks')) then
      allocate (own%breaks, source=task%get_reals('breaks'))
      allocate (own%pieces, source=task%get_cube('pieces'))
    else
      own%breaks = [0.0_wp]
      allocate (own%pieces(n, 4, 1), source=0.0_wp)
    end if
    if (task%has('base_breaks')) then
      allocate (own%base_breaks, source=task%get_reals('base_breaks'))
      allocate (own%base_pieces, source=task%get_cube('base_pieces'))
    else
      own%base_breaks = [0.0_wp]
      allocate (own%base_pieces(4, 1, 1), source=0.0_wp)
    end if
    call task%check_extents('pieces', shape(own%pieces), [n, size(own%pieces, 2), size(own%breaks)])
    call task%check_extents('base_pieces', shape(own%base_pieces), &
                            [size(own%base_pieces, 1), &
                             merge(n, 1, size(own%base_pieces, 2) > 1), size(own%base_breaks)])
  end subroutine read_tables

  !> Components of `oscillator_equations` by name, with the load and other values as of
  !! `read_polynomial`; `method`: index in `hereditary_methods`.
  subroutine read_oscillator(task, piece, equations)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(in) :: piece
    class(motion_equations), allocatable, intent(out) :: equations
    type(oscillator_equations), allocatable :: own
    type(load_type) :: load
    integer :: n

    allocate (own)
    own%system => task%system()
    if (task%failed()) return
    n = own%system%n_dof()
    call load_of(task, n, load)
    call own%set_nodes(nodes(task%get_integer('method')))
    own%t_end = task%get_real('reach')
    call read_past(task, n, own)
    call read_loads(task, n, piece, own)
    if (task%failed()) return
    call own%set_load(own%system, load, task%get_real('nu'))
    call own%look_at(own%system)
    call move_alloc(own, equations)
  end subroutine read_oscillator

  !> Components of `structure_equations`: the linear subsystem by `squares`, `rates` (n), `seen` and
  !! `pushed` (n, s); the load Im sum_k `waves`(:, k) exp(i `frequencies`(k) t) on the modes, and
  !! polynomials `pieces` (c, p, b) between `breaks` (b = 1: none), which act on modes by `patterns`
  !! (n, c). The base moves output coordinates by `direction` (m) and modes by `inner` (n); its
  !! motion is `base_waves` (k) and `base_pieces` (p, c) between `base_breaks` (c = 1: none).
  !! Initial values: `start`, `start_rates` and `start_others`. Complex modes, as in
  !! `viscovib_pole_maps`: `poles` (p), one of each conjugate pair; the last `n_at_once` of them
  !! follow their forces statically; `left` (p, s), `right` (p, s + c), `shown_left` (p, m), `sine`
  !! and `cosine` (p, k); `by_base` (p, 2): response to a jump of the base, and of its velocity.
  subroutine read_structure(task, piece, equations)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(in) :: piece
    class(motion_equations), allocatable, intent(out) :: equations
    type(structure_equations), allocatable :: own
    real(wp), pointer, contiguous :: start(:), start_rates(:), kick(:)
    complex(wp), pointer, contiguous :: start_others(:)
    integer :: used

    allocate (own)
    own%system => polynomial_of(task)
    call read_sections(task, own)
    call task%check_extents('initial', shape(piece%initial), [2*size(own%shown, 2)])
    call read_past(task, 0, own)
    start => task%get_reals('start')
    start_rates => task%get_reals('start_rates')
    start_others => task%get_complexes('start_others')
    kick => task%get_reals('kick')
    call own%set_nodes(task%get_integer('nodes'))
    own%t_end = task%get_real('t_end')
    call task%check_extents('kick', shape(kick), [2])
    call task%check_extents('start', shape(start), shape(own%sections%squares))
    call task%check_extents('start_rates', shape(start_rates), shape(own%sections%squares))
    if (task%failed()) return
    own%kick = kick
    used = size(own%sections%others%poles)
    allocate (own%q, source=[start, real(start_others(:used))])
    allocate (own%v, source=[start_rates, aimag(start_others(:used))])
    own%damps_modes = .true.
    call own%look_at(own%system)
    call move_alloc(own, equations)
  end subroutine read_structure

  !> The linear subsystem of a structure, its loads and results.
  subroutine read_sections(task, own)
    type(task_type), intent(inout) :: task
    type(structure_equations), intent(inout) :: own
    real(wp), pointer, contiguous :: frequencies(:), pushed(:, :), patterns(:, :), breaks(:), &
                                     pieces(:, :, :), direction(:), base_breaks(:), &
                                     base_pieces(:, :)
    complex(wp), pointer, contiguous :: waves(:, :), poles(:), left(:, :), right(:, :), &
                                        sine(:, :), cosine(:, :), by_base(:, :), base_waves(:), &
                                        shown_left(:, :)
    integer, allocatable :: some(:)
    integer :: columns, k, n, q, used

    allocate (own%shown, source=task%get_matrix('shown'))
    shown_left => task%get_complex_matrix('shown_left')
    associate (sections => own%sections)
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
      call task%check_extents('pieces', shape(pieces), [shape(pieces(:, :, 1)), size(breaks)])
      call task%check_extents('left', shape(left), [size(poles), q])
      call task%check_extents('right', shape(right), [size(poles)])
      call task%check_extents('sine', shape(sine), [size(poles), size(frequencies)])
      call task%check_extents('cosine', shape(cosine), [size(poles), size(frequencies)])
      call task%check_extents('by_base', shape(by_base), [size(poles), 2])
      call task%check_extents('direction', shape(direction), [size(own%shown, 2)])
      call task%check_extents('base_pieces', shape(base_pieces), &
                              [size(base_pieces, 1), size(base_breaks)])
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
        ! A single pole of 0 means no poles.
        if (used == 1 .and. others%n_at_once == 0) used = count(abs(poles) > 0.0_wp)
        others%poles = poles(:used)
        allocate (own%shown_left, source=shown_left(:used, :))
        others%left = left(:used, :)
        others%right = right(:used, :q + columns)
        others%sine = sine(:used, some)
        others%cosine = cosine(:used, some)
        others%by_base = by_base(:used, 1)
        others%by_base_rate = by_base(:used, 2)
      end associate
    end associate
    allocate (own%load%frequencies(0), own%load%amplitudes(columns, 0))
    own%load%breaks = breaks
    own%load%pieces = pieces(:columns, :, :)
    if (size(base_breaks) == 1 .and. .not. any(abs(base_waves) > 0.0_wp)) return
    call make_base(own%base, direction, frequencies, spread(base_waves, 1, 1), base_breaks, &
                   spread(base_pieces, 2, 1))
  end subroutine read_sections

  !> A motion that is known: `states` (2 n, m) at ascending `times` (m), the first coordinates of
  !! which are wanted, and loads as of `read_known_load`. Forces of laws that are known are the last
  !! rows of `accelerations`; `laws` gives the row of each among these, 0: not known. With memory
  !! the motion until then, as of `set_panels`: `panel_ends`, `panel_states`, `panel_accelerations`,
  !! `before` and `moved`.
  subroutine read_known(task, n_dof, motion)
    type(task_type), intent(inout) :: task
    integer, intent(in) :: n_dof
    type(known_motion), intent(out) :: motion
    type(time_load_type) :: loads
    type(base_motion_type) :: base
    real(wp), pointer, contiguous :: times(:), states(:, :), moved(:, :)
    real(wp), allocatable :: laws(:, :)
    integer :: n

    call read_known_load(task, loads, base)
    times => task%get_reals('times')
    states => task%get_matrix('states')
    if (task%failed()) return
    n = size(loads%amplitudes, 1)
    call task%check_extents('states', shape(states), [max(size(states, 1), 2*n), size(times)])
    if (task%failed()) return
    if (base%moves()) base%amplitudes = base%amplitudes(:n_dof, :)
    if (base%has_corners()) base%pieces = base%pieces(:, :n_dof, :)
    call motion%set_states(times, states, base, n_dof)
    if (task%has('accelerations')) call read_laws('accelerations', motion%laws)
    if (.not. task%has('panel_ends')) return
    if (task%has('panel_accelerations')) call read_laws('panel_accelerations', laws)
    moved => task%get_matrix('moved')
    call motion%set_panels(task%get_reals('panel_ends'), task%get_matrix('panel_states'), laws, &
                           base, task%get_reals('before'), moved(:n_dof, :))

  contains

    subroutine read_laws(name, found)
      character(len=*), intent(in) :: name
      real(wp), allocatable, intent(out) :: found(:, :)
      integer, allocatable :: places(:)
      integer :: j
      if (.not. task%has('laws')) return
      allocate (places, source=task%get_integers('laws'))
      associate (given => task%get_matrix(name))
        allocate (found(size(given, 2), size(places)), &
                  source=ieee_value(0.0_wp, ieee_quiet_nan))
        do j = 1, size(places)
          if (places(j) > 0) found(:, j) = given(n + places(j), :)
        end do
      end associate
    end subroutine read_laws

  end subroutine read_known

  !> Loads on n coordinates relative to the base, `amplitudes` (n, k) with `frequencies` (k), and if
  !! there is a table `pieces` (n, p, m) between `breaks` (m). The base moves by `waves` (n, k), and
  !! by a table `base_pieces` (p, n, m), or (p, 1, m) with a `direction` (n), and `base_breaks` (m).
  subroutine read_known_load(task, load, base)
    type(task_type), intent(inout) :: task
    type(time_load_type), intent(out) :: load
    type(base_motion_type), intent(out) :: base
    real(wp), pointer, contiguous :: base_pieces(:, :, :), direction(:)
    integer :: n

    allocate (load%frequencies, source=task%get_reals('frequencies'))
    allocate (load%amplitudes, source=task%get_complex_matrix('amplitudes'))
    n = size(load%amplitudes, 1)
    call task%check_extents('amplitudes', shape(load%amplitudes), [n, size(load%frequencies)])
    if (task%has('breaks')) then
      allocate (load%breaks, source=task%get_reals('breaks'))
      allocate (load%pieces, source=task%get_cube('pieces'))
    else
      allocate (load%breaks(0), load%pieces(n, 0, 0))
    end if
    call task%check_extents('pieces', shape(load%pieces), &
                            [n, size(load%pieces, 2), size(load%breaks)])
    if (.not. task%has('waves')) return
    base%frequencies = load%frequencies
    allocate (base%amplitudes, source=task%get_complex_matrix('waves'))
    call task%check_extents('waves', shape(base%amplitudes), shape(load%amplitudes))
    if (.not. task%has('base_breaks')) return
    base_pieces => task%get_cube('base_pieces')
    if (task%has('direction')) then
      direction => task%get_reals('direction')
      call task%check_extents('direction', shape(direction), [n])
      if (task%failed()) return
      call base%add_polynomials(n, direction, task%get_reals('base_breaks'), base_pieces)
    else
      call base%add_polynomials(n, [real(wp) ::], task%get_reals('base_breaks'), base_pieces)
    end if
    call task%check_extents('base_pieces', shape(base%pieces), &
                            [size(base_pieces, 1), n, size(base%breaks)])
  end subroutine read_known_load

  !> The polynomial system of a task; fails for another kind of system.
  function polynomial_of(task) result(it)
    type(task_type), intent(inout) :: task
    type(polynomial_type), pointer :: it
    class(oscillator_type), pointer :: system
    nullify (it)
    system => task%system(with_shaft=.true.)
    if (task%failed()) return
    select type (system)
    type is (polynomial_type)
      it => system
    class default
      call fail(task%status, status_input_error, 'system', task%kind//': needs a polynomial system')
    end select
  end function polynomial_of

  !> The periodic load of a task, `orders` (k), `series` (n + 1, k) and `formulas` of `make_load`.
  subroutine load_of(task, n_dof, load)
    type(task_type), intent(inout) :: task
    integer, intent(in) :: n_dof
    type(load_type), intent(out) :: load
    complex(wp), pointer, contiguous :: series(:, :)
    integer, allocatable :: orders(:)
    character(len=:), allocatable :: formulas
    allocate (orders, source=task%get_integers('orders'))
    call task%take_text('formulas', formulas, '')
    series => task%get_complex_matrix('series')
    call task%check_extents('series', shape(series), [n_dof + 1, size(orders)])
    if (task%failed()) return
    call make_load(load, orders, series, formulas, task%status)
  end subroutine load_of

end module viscovib_motion_inputs
