! Optimize: -O1
!> Equations of motion with memory, of oscillators and of structures by their modes.
module viscovib_memory_pieces
  use viscovib_base_motion, only: base_motion_type
  use viscovib_hereditary, only: hereditary_type, new_hereditary
  use viscovib_hereditary_run, only: run_hereditary
  use viscovib_histories, only: past_request
  use viscovib_kinds, only: wp
  use viscovib_law_layers, only: unseen_by_node
  use viscovib_load, only: load_type
  use viscovib_march, only: begun, march_type, step_too_large
  use viscovib_modal_maps, only: sections_type
  use viscovib_motion_piece, only: check_memory, from_start, memory_under_other_loads, &
    motion_equations, not_of_state, of_state, piece_type, under_other_loads
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pole_maps, only: pole_rates, seen_of_poles
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: reduce
  use viscovib_status, only: set_ok, status_type
  use viscovib_structure_march, only: new_structure_march, structure_march_type
  use viscovib_time_load, only: time_load_type
  use viscovib_trajectory, only: shaken
  implicit none
  private

  public :: make_base, memory_equations, oscillator_equations, structure_equations

  !> Common data of both kinds of equations.
  type, abstract, extends(motion_equations) :: memory_equations
    !> The end of any run that continues.
    real(wp) :: t_end = 0.0_wp
  contains
    procedure :: set_nodes
    procedure, private :: request
  end type memory_equations

  !> Equations of an oscillator; its past is stored as exponentials or step by step.
  type, extends(memory_equations) :: oscillator_equations
    class(oscillator_type), pointer :: system => null()
    !> The load Im sum_k amplitudes(:, k) exp(i frequencies(k) t), shape (n, k), which already
    !! includes the acceleration of the base; the base by `waves` (n, k).
    real(wp), allocatable :: frequencies(:)
    complex(wp), allocatable :: amplitudes(:, :), waves(:, :)
  contains
    procedure :: run => run_oscillator
    procedure :: set_load
  end type oscillator_equations

  !> Equations of a structure, whose state consists of modes.
  !!
  !! The linear subsystem is a set of sections q'' + rates q' + squares q = pushes, its elements a
  !! polynomial system in the deflections seen^T q. The results are the coordinates `shown`^T q and
  !! their velocities, of a body whose base moves them by the direction of `base`. The start, `q`
  !! and `v`, is relative to the base; for the part without real modes, shown by `shown_left`, they
  !! are real and imaginary parts. Under other loads the base jumps back by `kick`.
  type, extends(memory_equations) :: structure_equations
    type(polynomial_type), pointer :: system => null()
    type(sections_type) :: sections
    type(time_load_type) :: load
    type(base_motion_type) :: base
    real(wp), allocatable :: shown(:, :), q(:), v(:)
    complex(wp), allocatable :: shown_left(:, :)
    real(wp) :: kick(2) = 0.0_wp
  contains
    procedure :: run => run_structure
    procedure :: n_start => n_modal_start
    procedure :: seen_at_start => seen_of_modes
    procedure :: move_start => move_modes
  end type structure_equations

contains

  !> Set the number of nodes per step.
  pure subroutine set_nodes(self, nodes)
    class(memory_equations), intent(inout) :: self
    integer, intent(in) :: nodes
    self%nodes = nodes
    self%collocated = .true.
  end subroutine set_nodes

  !> Set the sinusoids of a load with the frequency nu (rad/s), and of the base.
  pure subroutine set_load(self, system, load, nu)
    class(oscillator_equations), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    integer :: k, n

    n = size(load%orders)
    self%frequencies = load%orders*nu
    allocate (self%amplitudes(system%n_dof(), n))
    allocate (self%waves(system%n_dof(), n), source=(0.0_wp, 0.0_wp))
    do k = 1, n
      self%amplitudes(:, k) = load%coefficient(system, load%orders(k), nu)
      if (load%moves_base()) self%waves(:, k) = load%shift(system, k)
    end do
  end subroutine set_load

  !> A piece of a run of an oscillator. `reason` (not 0: no run, see `viscovib_hereditary`);
  !! `resolution`: largest last Legendre coefficient of a displacement on a step, relative to its
  !! largest value; `too_long`: length of steps relative to that at which nodes resolve every thin
  !! layer of a law.
  subroutine run_oscillator(self, piece, status)
    class(oscillator_equations), intent(in) :: self
    type(piece_type), intent(inout) :: piece
    type(status_type), intent(out) :: status
    class(oscillator_type), pointer :: system
    type(polynomial_type), target :: reduced
    class(oscillator_type), allocatable, target :: other
    type(hereditary_type) :: run
    type(time_load_type) :: load
    type(base_motion_type) :: base
    real(wp), allocatable :: u(:), v(:)
    integer, allocatable :: dofs(:)
    logical, allocatable :: moves(:)
    integer :: i, n, part

    call set_ok(status)
    system => self%system
    n = system%n_dof()
    moves = self%moves .or. piece%is_watched
    dofs = pack([(i, i=1, n)], moves)
    if (piece%sign /= 0) then
      ! With the changed start, forces have changed arguments, u/(1 + s), and values, by 1 + 2 s.
      allocate (other, source=system)
      call other%weigh(1.0_wp - 2.0_wp*shaken)
      system => other
    end if
    if (size(dofs) < n) then
      call reduce(system, moves, reduced)
      system => reduced
    end if
    call take_loads(self, system, dofs, load, base)
    part = piece%mesh%piece_of(piece%first)
    u = piece%initial(2*dofs - 1)
    v = piece%initial(2*dofs)
    call base%enter(piece%mesh%beginning(part), piece%mesh%ends(part))
    call base%add_to(piece%mesh%start_of(piece%first), u, v, share=-1.0_wp)
    call new_hereditary(run, system, load, self%request(piece, dofs), u, v, piece%reason)
    call resume_run(run, base, piece, [real(wp) ::], u, v, status)
    if (status%failed()) return
    call make_steps(run, base, self%nodes, dofs, piece)
  end subroutine run_oscillator

  !> The past of the coordinates `dofs`, for a run of a piece.
  type(past_request) function request(self, piece, dofs)
    class(memory_equations), intent(in) :: self
    type(piece_type), intent(in) :: piece
    integer, intent(in) :: dofs(:)
    request%nodes = self%nodes
    request%past = piece%past
    request%h = piece%mesh%h(piece%mesh%piece_of(piece%first))
    request%t_end = self%t_end
    request%tolerance = piece%tolerance
    request%shortest = piece%shortest
    request%kinks = piece%kinks
    allocate (request%held, source=self%held(dofs))
    allocate (request%before, source=self%before)
    allocate (request%moved, source=self%moved(dofs, :))
  end function request

  !> Loads and base of the coordinates `dofs`.
  subroutine take_loads(self, system, dofs, load, base)
    class(oscillator_equations), intent(in) :: self
    !> Of these coordinates only.
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: dofs(:)
    type(time_load_type), intent(out) :: load
    type(base_motion_type), intent(out) :: base

    load%frequencies = self%frequencies
    load%amplitudes = self%amplitudes(dofs, :)
    load%breaks = self%breaks
    load%pieces = self%pieces(dofs, :, :)
    if (any(abs(self%waves) > 0.0_wp)) then
      base%frequencies = self%frequencies
      base%amplitudes = self%waves(dofs, :)
    end if
    if (size(self%base_breaks) == 1) return
    if (size(self%base_pieces, 2) > 1) then
      call base%add_polynomials(size(dofs), [real(wp) ::], self%base_breaks, &
                                self%base_pieces(:, dofs, :))
    else
      call base%add_polynomials(size(dofs), system%base_direction, self%base_breaks, &
                                self%base_pieces)
    end if
  end subroutine take_loads

  !> Set a base motion by harmonics and polynomials.
  subroutine make_base(base, direction, frequencies, waves, breaks, pieces)
    type(base_motion_type), intent(inout) :: base
    !> Motion of the coordinates with the base.
    real(wp), intent(in) :: direction(:)
    !> Shapes (n), (m), (4, q, m) and (q, n).
    real(wp), intent(in) :: frequencies(:), breaks(:), pieces(:, :, :)
    complex(wp), intent(in) :: waves(:, :)
    base%direction = direction
    base%frequencies = frequencies
    base%amplitudes = waves
    if (size(breaks) == 1) return
    base%breaks = breaks
    base%pieces = pieces
  end subroutine make_base

  !> A piece of a run of a structure, as of an oscillator. Additional result: `phased`, the
  !! `phase_errors` of the results.
  subroutine run_structure(self, piece, status)
    class(structure_equations), intent(in) :: self
    type(piece_type), intent(inout) :: piece
    type(status_type), intent(out) :: status
    type(structure_march_type) :: run
    type(sections_type) :: pushed
    type(base_motion_type) :: base
    real(wp), allocatable :: u(:), v(:)
    real(wp) :: begin
    integer :: i, n, part

    call set_ok(status)
    n = size(self%shown, 2)
    begin = 1.0_wp + piece%sign*shaken
    pushed = self%sections
    if (piece%sign /= 0) call push_harder(pushed, 1.0_wp + 2.0_wp*shaken)
    part = piece%mesh%piece_of(piece%first)
    base = self%base
    call base%enter(piece%mesh%beginning(part), piece%mesh%ends(part))
    call new_structure_march(run, self%system, pushed, self%shown, self%shown_left, self%load, &
                             self%request(piece, [(i, i=1, size(self%held))]), begin*self%q, &
                             begin*self%v, piece%reason)
    allocate (piece%phased(2*n), source=0.0_wp)
    call resume_run(run, base, piece, self%kick, u, v, status)
    if (status%failed()) return
    call make_steps(run, base, self%nodes, [(i, i=1, n)], piece)
    if (piece%reason == begun) piece%phased = run%phase_errors()
  end subroutine run_structure

  !> The start are modes, then real and imaginary parts of the part without real modes.
  integer function n_modal_start(self, w) result(n)
    class(structure_equations), intent(in) :: self
    integer, intent(in) :: w
    associate (unused => w)
    end associate
    n = 2*size(self%q)
  end function n_modal_start

  function seen_of_modes(self, change, w) result(seen)
    class(structure_equations), intent(in) :: self
    real(wp), intent(in) :: change(:)
    integer, intent(in) :: w
    real(wp) :: seen(w), u(w/2), v(w/2)
    complex(wp) :: z(size(self%sections%others%poles))
    integer :: i, n

    n = size(self%sections%squares)
    z = pole_change(self, change(2*n + 1:))
    do i = 1, w/2
      u(i) = dot_product(self%shown(:, i), change(1:2*n:2)) &
             + seen_of_poles(self%shown_left(:, i), z)
      v(i) = dot_product(self%shown(:, i), change(2:2*n:2)) &
             + pole_rates(self%shown_left(:, i), self%sections%others%poles, z)
    end do
    seen(1::2) = u
    seen(2::2) = v
  end function seen_of_modes

  subroutine move_modes(self, change)
    class(structure_equations), intent(inout) :: self
    real(wp), intent(in) :: change(:)
    complex(wp) :: z(size(self%sections%others%poles))
    integer :: i, n
    n = size(self%sections%squares)
    z = pole_change(self, change(2*n + 1:))
    do i = 1, n
      ! Without real modes there is one that shows nothing.
      if (.not. any(abs(self%shown(i, :)) > 0.0_wp)) cycle
      self%q(i) = self%q(i) + change(2*i - 1)
      self%v(i) = self%v(i) + change(2*i)
    end do
    self%q(n + 1:) = self%q(n + 1:) + real(z)
    self%v(n + 1:) = self%v(n + 1:) + aimag(z)
  end subroutine move_modes

  !> The change of the part without real modes: that of a real pole is real, and massless variables
  !! follow their forces.
  pure function pole_change(self, change) result(z)
    class(structure_equations), intent(in) :: self
    real(wp), intent(in) :: change(:)
    complex(wp) :: z(size(change)/2)
    z = cmplx(change(1::2), change(2::2), wp)
    where (.not. abs(aimag(self%sections%others%poles)) > 0.0_wp) z = real(z)
    z(size(z) - self%sections%others%n_at_once + 1:) = (0.0_wp, 0.0_wp)
  end function pole_change

  !> Continue a run with the memory of the piece before. Under other loads it continues from the
  !! state (u, v), or if this is not allocated, from the state that is kept, after a jump of the
  !! base by -`kick` (displacement, velocity).
  subroutine resume_run(run, base, piece, kick, u, v, status)
    class(march_type), intent(inout) :: run
    type(base_motion_type), intent(in) :: base
    type(piece_type), intent(inout) :: piece
    real(wp), intent(in) :: kick(:)
    real(wp), allocatable, intent(inout) :: u(:), v(:)
    type(status_type), intent(out) :: status
    logical :: made

    call set_ok(status)
    if (piece%reason /= begun .or. piece%resume == from_start) return
    if (piece%resume /= under_other_loads) then
      call check_memory(piece, run%memory_size(), status)
      if (status%failed()) return
      call run%load_memory(piece%memory, .false.)
      if (piece%marks) call run%follow_state()
      return
    end if
    call run%load_memory(memory_under_other_loads(piece, run%memory_size()), .true.)
    if (.not. allocated(u)) then
      call run%kick(base, kick(1:1), kick(2:2))
      call run%get_state(u, v)
    end if
    call run%take_up(piece%mesh%start_of(piece%first), u, v, made)
    if (.not. made) piece%reason = step_too_large
  end subroutine resume_run

  !> Make the steps of a piece, of the coordinates `dofs`; the others stay 0.
  subroutine make_steps(run, base, nodes, dofs, piece)
    class(march_type), intent(inout) :: run
    type(base_motion_type), intent(inout) :: base
    integer, intent(in) :: nodes, dofs(:)
    type(piece_type), intent(inout) :: piece
    real(wp) :: u(size(dofs)), v(size(dofs)), too_long

    piece%last = piece%initial
    if (piece%reason /= begun) return
    run%gives_up = piece%gives_up
    if (2*size(dofs) < size(piece%last)) piece%dofs = dofs
    if (piece%is_watched) call piece%begin_watch(size(dofs))
    call run_hereditary(run, base, piece, piece%resume == under_other_loads, too_long)
    call run%observe(u, v)
    call base%add_to(piece%t_reached, u, v)
    piece%last(2*dofs - 1) = u
    piece%last(2*dofs) = v
    piece%counted = run%equations%n_iterations
    piece%resolution = run%resolution()
    piece%kept = run%save_memory()
    if (piece%marks) piece%kinds = merge(of_state, not_of_state, run%are_of_state())
    piece%too_long = too_long/(unseen_by_node*nodes)
  end subroutine make_steps

  !> Multiply the forces of loads and elements by a factor.
  pure subroutine push_harder(sections, times)
    type(sections_type), intent(inout) :: sections
    real(wp), intent(in) :: times
    sections%pushed = times*sections%pushed
    sections%waves = times*sections%waves
    sections%others%right = times*sections%others%right
    sections%others%sine = times*sections%others%sine
    sections%others%cosine = times*sections%others%cosine
  end subroutine push_harder

end module viscovib_memory_pieces
