!> A piece of a run in time as tasks have it: what every one is given, and finds.
module viscovib_motion_piece
  use viscovib_binding_tools, only: make_load
  use viscovib_kinds, only: i8, wp
  use viscovib_load, only: load_type
  use viscovib_mesh, only: mesh_type, new_mesh
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: fail, status_input_error
  use viscovib_task, only: task_type
  use viscovib_watch, only: n_told, new_watch, watch_type
  implicit none
  private

  public :: memory_under_other_loads, moves_of, piece_type, polynomial_of, load_of, take_up_memory

  !> How a run goes on: from a start, as before, or under other loads.
  integer, parameter, public :: from_start = 0, as_before = 1, under_other_loads = 2
  !> Columns of what a watch gathers: peaks, integrals of values and of squares.
  integer, parameter :: n_gathered = 3

  !> What all pieces of runs are asked for and find.
  type :: piece_type
    !> Steps made before, steps to make, and steps between states that are kept.
    integer(i8) :: first = 0, n_steps = 0, save_every = 1
    integer :: resume = from_start
    real(wp) :: h = 0.0_wp, tolerance = 0.0_wp
    !> By what the steps of a mesh are shorter than given; the sign of a shake (`shaken`), 0: none.
    integer :: factor = 1, sign = 0
    !> Whether steps are made in parts that see thin layers of forces, and how thin one may be for
    !! a part.
    logical :: in_parts = .false.
    real(wp) :: thin = 1.0_wp
    !> How the past is kept; the shortest step after corners, and whether the base has some.
    integer :: past = 0
    real(wp) :: shortest = 0.0_wp
    logical :: kinks = .false.
    !> Whether a step with memory that is too large ends it, wherever inside the motion may stop.
    logical :: gives_up = .false.
    real(wp), pointer, contiguous :: initial(:), times(:), memory(:)
    real(wp), allocatable :: states(:, :), at_times(:, :), last(:), kept(:), phased(:)
    integer(i8) :: n_done = 0, counted = 0
    integer :: n_reached = 0, ended = 0, reason = 0
    real(wp) :: t_reached = 0.0_wp, resolution = 0.0_wp, too_long = 0.0_wp
    !> Events, as of `new_watch`, and how many passages a piece may find.
    logical :: is_watched = .false.
    real(wp), pointer, contiguous :: watched(:)
    integer, allocatable :: sides(:)
    integer :: most = 0
    type(watch_type), allocatable :: watch
  contains
    procedure :: read => read_piece
    procedure :: make_room
    procedure :: begin_watch
    procedure :: mesh => mesh_of_piece
    procedure :: put => put_piece
  end type piece_type

  ! What a run has that goes on without a memory of its own.
  real(wp), target :: nothing(0)

contains

  !> What every piece is given: `initial` (m), `first`, `n_steps`, `save_every`, `resume`, `h`,
  !! `tolerance`, `times` (n), `columns`: states kept; with resume > 0 `memory`; with events
  !! `watched`, `sides` and `most`: passages found at most. Some pieces have `in_parts`, `thin`,
  !! `past`, `shortest` and `kinks`.
  subroutine read_piece(self, task)
    class(piece_type), intent(out) :: self
    type(task_type), intent(inout) :: task

    self%initial => task%get_reals('initial')
    self%first = task%get_long('first')
    self%n_steps = task%get_long('n_steps')
    self%save_every = task%get_long('save_every')
    self%resume = task%get_integer('resume')
    self%h = task%get_real('h')
    self%tolerance = task%get_real('tolerance')
    self%times => task%get_reals('times')
    self%memory => nothing
    if (task%has('memory')) self%memory => task%get_reals('memory')
    self%in_parts = task%get_flag('in_parts', .false.)
    self%thin = task%get_real('thin', 1.0_wp)
    self%past = task%get_integer('past', 0)
    self%shortest = task%get_real('shortest', 0.0_wp)
    self%kinks = task%get_flag('kinks', .false.)
    self%is_watched = task%has('watched')
    if (.not. self%is_watched) return
    self%watched => task%get_reals('watched')
    allocate (self%sides, source=task%get_integers('sides'))
    self%most = task%get_integer('most')
  end subroutine read_piece

  !> Room for what it finds, of so many states.
  subroutine make_room(self, columns)
    class(piece_type), intent(inout) :: self
    integer, intent(in) :: columns
    integer :: n_rows
    n_rows = size(self%initial)
    allocate (self%states(n_rows, columns))
    allocate (self%at_times(n_rows, size(self%times)), self%last(n_rows), source=0.0_wp)
  end subroutine make_room

  !> Look for events, whose signals read some of n coordinates alone.
  subroutine begin_watch(self, n)
    class(piece_type), intent(inout) :: self
    integer, intent(in) :: n
    allocate (self%watch)
    call new_watch(self%watch, self%watched, self%sides, n)
  end subroutine begin_watch

  !> Where steps end: `ends` (n) and `made_by` (n) of the task, with steps shorter by the factor.
  subroutine mesh_of_piece(self, task, mesh)
    class(piece_type), intent(in) :: self
    type(task_type), intent(inout) :: task
    type(mesh_type), intent(out) :: mesh
    call new_mesh(mesh, self%h, task%get_reals('ends'), self%factor*task%get_longs('made_by'))
  end subroutine mesh_of_piece

  subroutine put_piece(self, task)
    class(piece_type), intent(inout) :: self
    type(task_type), intent(inout) :: task
    real(wp), allocatable :: found(:, :)
    integer :: n, n_found

    if (task%failed()) return
    call task%found%put_reals('states', self%states, shape(self%states))
    call task%found%put_reals('at_times', self%at_times, shape(self%at_times))
    call task%found%put_reals('last', self%last, shape(self%last))
    if (.not. allocated(self%kept)) allocate (self%kept(0))
    call task%found%put_reals('memory', self%kept, shape(self%kept))
    call task%found%put_integer('made', self%n_done)
    call task%found%put_integer('n_reached', int(self%n_reached, i8))
    call task%found%put_real('reached', self%t_reached)
    call task%found%put_integer('ended', int(self%ended, i8))
    call task%found%put_integer('counted', self%counted)
    call task%found%put_integer('reason', int(self%reason, i8))
    call task%found%put_real('resolution', self%resolution)
    call task%found%put_real('too_long', self%too_long)
    if (.not. allocated(self%phased)) allocate (self%phased(0))
    call task%found%put_reals('phased', self%phased, shape(self%phased))
    if (.not. self%is_watched) return
    allocate (found(n_told + 3*(size(self%initial)/2), self%most), source=0.0_wp)
    n_found = 0
    if (allocated(self%watch)) call self%watch%hand_over(self%sides, found, n_found)
    ! Behind the passages stands what was gathered along the motion.
    n = min(n_found + n_gathered, size(found, 2))
    call task%found%put_reals('found', found(:, :n), [size(found, 1), n])
    call task%found%put_integer('n_found', int(n_found, i8))
    call task%found%put_integers('sides', self%sides, shape(self%sides))
  end subroutine put_piece

  !> Which of n coordinates move, `moves` (n); all of watched motions are computed.
  function moves_of(task, piece, n) result(moves)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(in) :: piece
    integer, intent(in) :: n
    logical, allocatable :: moves(:)
    allocate (moves, source=task%get_integers('moves') /= 0)
    call task%check_extents('moves', shape(moves), [n])
    if (piece%is_watched) moves = .true.
  end function moves_of

  !> A failure where a run is to go on with less than it needs.
  subroutine take_up_memory(task, piece, needed)
    type(task_type), intent(inout) :: task
    type(piece_type), intent(in) :: piece
    integer, intent(in) :: needed
    if (size(piece%memory) >= needed) return
    call fail(task%status, status_input_error, 'memory', 'memory: is not that of such a run')
  end subroutine take_up_memory

  !> What a run needs to go on under other loads: zeros for what was not kept before.
  function memory_under_other_loads(piece, needed) result(memory)
    type(piece_type), intent(in) :: piece
    integer, intent(in) :: needed
    real(wp) :: memory(max(needed, size(piece%memory)))
    memory = 0.0_wp
    memory(:size(piece%memory)) = piece%memory
  end function memory_under_other_loads

  !> The polynomial system of a task; a failure if its system is another one.
  function polynomial_of(task) result(it)
    type(task_type), intent(inout) :: task
    type(polynomial_type), pointer :: it
    class(oscillator_type), pointer :: system
    nullify (it)
    system => task%system()
    if (task%failed()) return
    select type (system)
    type is (polynomial_type)
      it => system
    class default
      call fail(task%status, status_input_error, 'system', task%kind//': needs a polynomial system')
    end select
  end function polynomial_of

  !> The periodic load of a task, `orders` (k) and `series` (n + 1, k).
  subroutine load_of(task, n_dof, load)
    type(task_type), intent(inout) :: task
    integer, intent(in) :: n_dof
    type(load_type), intent(out) :: load
    complex(wp), pointer, contiguous :: series(:, :)
    integer, allocatable :: orders(:)
    allocate (orders, source=task%get_integers('orders'))
    series => task%get_complex_matrix('series')
    call task%check_extents('series', shape(series), [n_dof + 1, size(orders)])
    if (task%failed()) return
    call make_load(load, orders, series, task%status)
  end subroutine load_of

end module viscovib_motion_piece
