!> A piece of a run in time, and the equations that it solves.
module viscovib_motion_piece
  use viscovib_fitted_memory, only: needs_fit
  use viscovib_kinds, only: i8, wp
  use viscovib_load, only: load_type
  use viscovib_mesh, only: equal_steps, new_mesh
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: fail, set_ok, status_input_error, status_type
  use viscovib_time_run, only: time_run
  use viscovib_trajectory, only: shaken
  use viscovib_watch, only: new_watch
  implicit none
  private

  public :: check_memory, memory_under_other_loads, motion_equations, piece_type

  !> Start of a run: from a start, continued as before, or continued under other loads.
  integer, parameter, public :: from_start = 0, as_before = 1, under_other_loads = 2

  !> Kinds of numbers in a memory: of time or of the method, times of contact of stops, states of
  !! switches, and all else of the state. The last two grow with a perturbation.
  integer, parameter, public :: not_of_state = 0, of_contact = 1, of_switch = 2, of_state = 3

  !> The memory of a run that has none.
  real(wp), target, public :: nothing(0)

  !> The start of a run, its steps, and its results.
  type, extends(time_run) :: piece_type
    integer :: resume = from_start
    real(wp) :: h = 0.0_wp, tolerance = 0.0_wp
    !> The factor by which steps of a mesh are shorter; the sign of a perturbation, 0: none.
    integer :: factor = 1, sign = 0
    !> True if steps are made in parts that resolve thin layers of forces; largest change of an
    !! argument of a law in a part, relative to the resolved change.
    logical :: in_parts = .false.
    real(wp) :: thin = 1.0_wp
    !> Storage of the past; the shortest step after corners, and true if the base has corners.
    integer :: past = 0
    real(wp) :: shortest = 0.0_wp
    logical :: kinks = .false.
    !> True if a step with memory that is too large ends the run, without locating the stop inside.
    logical :: gives_up = .false.
    real(wp), pointer, contiguous :: initial(:), memory(:)
    !> Ends of steps, as in `new_mesh`, before they are shortened; not allocated: equal steps.
    real(wp), allocatable :: ends(:)
    integer(i8), allocatable :: made_by(:)
    real(wp), allocatable :: last(:), kept(:), phased(:)
    !> True if accelerations are requested, and if the kinds of the numbers in `kept` are.
    logical :: accelerates = .false., marks = .false.
    integer, allocatable :: kinds(:)
    integer(i8) :: counted = 0
    integer :: reason = 0
    real(wp) :: resolution = 0.0_wp, too_long = 0.0_wp
    !> Events, as in `new_watch`; sides not allocated: a run begins.
    logical :: is_watched = .false.
    real(wp), pointer, contiguous :: watched(:)
    integer, allocatable :: sides(:)
  contains
    procedure :: allocate_arrays
    procedure :: begin_watch
    procedure :: set_mesh
  end type piece_type

  !> Equations of motion under loads, with their past.
  type, abstract :: motion_equations
    !> A body with large rotations, whose states have equivalent forms; null: no such body.
    class(oscillator_type), pointer :: turning => null()
    !> Coordinates that move; the others stay 0.
    logical, allocatable :: moves(:)
    !> Loads that are polynomials, shape (n, p, b), between the times `breaks` (b), and the motion
    !! of the base, (p, w, c), w = 1: along the direction of the system; with less than two times:
    !! none.
    real(wp), allocatable :: breaks(:), pieces(:, :, :), base_breaks(:), base_pieces(:, :, :)
    !> The displacement for all t < 0 (n), or before the first of the times `before` (m) with
    !! displacements `moved` (n, m), ascending to 0; for structures the deflections of elements.
    real(wp), allocatable :: held(:), before(:), moved(:, :)
    !> Relative change of the start in shaken runs.
    real(wp) :: change = shaken
    !> True if steps are polynomials through nodes, solved to the tolerance, also between their
    !! ends; the number of nodes.
    logical :: collocated = .false.
    integer :: nodes = 8
    !> True if steps cross kinks of laws; true if kernels are fitted by sums of exponentials.
    logical :: over_kinks = .false., fitted = .false.
    !> True if rounding errors of the energy accumulate; true if modes have their own damping.
    logical :: keeps_energy = .false., damps_modes = .false.
  contains
    procedure(run_interface), deferred :: run
    procedure :: look_at
    procedure :: set_past
    procedure :: set_loads
    procedure :: move_all
    procedure :: n_start
    procedure :: seen_at_start
    procedure :: move_start
  end type motion_equations

  abstract interface

    !> Make the steps of a piece.
    subroutine run_interface(self, piece, status)
      import :: motion_equations, piece_type, status_type
      class(motion_equations), intent(in) :: self
      type(piece_type), intent(inout) :: piece
      type(status_type), intent(out) :: status
    end subroutine run_interface

  end interface

contains

  !> Set the properties of the system that a search for the step needs.
  subroutine look_at(self, system)
    class(motion_equations), intent(inout) :: self
    class(oscillator_type), intent(in), target :: system
    integer :: i

    self%fitted = needs_fit(system)
    if (system%moving) self%turning => system
    select type (system)
    class is (polynomial_type)
      self%over_kinks = self%collocated .and. any([(system%laws(i)%state > 0 &
                            .or. system%laws(i)%program%n_surfaces() > 0, i=1, size(system%laws))])
      self%keeps_energy = size(system%monomials) > 0 .and. size(system%laws) == 0 &
                          .and. .not. self%damps_modes &
                          .and. .not. any(abs(system%damping) > 0.0_wp) &
                          .and. .not. any(system%kernel_of > 0)
    end select
  end subroutine look_at

  !> Set the displacement for all t < 0.
  pure subroutine set_past(self, held)
    class(motion_equations), intent(inout) :: self
    real(wp), intent(in) :: held(:)
    self%held = held
    self%before = [0.0_wp]
    self%moved = reshape(held, [size(held), 1])
  end subroutine set_past

  !> Set the polynomials of a load, and a base without any.
  subroutine set_loads(self, system, load)
    class(motion_equations), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    call load%forces_in_time(self%breaks, self%pieces)
    self%base_breaks = [0.0_wp]
    if (allocated(self%base_pieces)) deallocate (self%base_pieces)
    allocate (self%base_pieces(4, system%n_dof(), 1), source=0.0_wp)
  end subroutine set_loads

  !> Compute all coordinates, also those at rest.
  subroutine move_all(self)
    class(motion_equations), intent(inout) :: self
    if (allocated(self%moves)) self%moves = .true.
  end subroutine move_all

  !> Size of the start of a motion whose state has w numbers. The start are coordinates and
  !! velocities, alternating.
  integer function n_start(self, w)
    class(motion_equations), intent(in) :: self
    integer, intent(in) :: w
    associate (unused => self)
    end associate
    n_start = w
  end function n_start

  !> Change of the w numbers of the state by a change of the start.
  function seen_at_start(self, change, w) result(seen)
    class(motion_equations), intent(in) :: self
    real(wp), intent(in) :: change(:)
    integer, intent(in) :: w
    real(wp) :: seen(w)
    associate (unused => self)
    end associate
    seen = change
  end function seen_at_start

  !> Change a start that is part of the equations.
  subroutine move_start(self, change)
    class(motion_equations), intent(inout) :: self
    real(wp), intent(in) :: change(:)
    associate (unused => self, also => change)
    end associate
  end subroutine move_start

  !> Allocate the results, for this number of states.
  subroutine allocate_arrays(self, columns)
    class(piece_type), intent(inout) :: self
    integer, intent(in) :: columns
    call self%set_mesh()
    call self%allocate_states(size(self%initial), columns, self%h)
    allocate (self%last(size(self%initial)), source=0.0_wp)
  end subroutine allocate_arrays

  !> Start the search for events, whose signals read only some of n coordinates.
  subroutine begin_watch(self, n)
    class(piece_type), intent(inout) :: self
    integer, intent(in) :: n
    allocate (self%watch)
    call new_watch(self%watch, self%watched, self%sides, n)
  end subroutine begin_watch

  !> Mesh of steps shortened by the factor.
  subroutine set_mesh(self)
    class(piece_type), intent(inout) :: self
    if (allocated(self%ends)) then
      call new_mesh(self%mesh, self%h, self%ends, self%factor*self%made_by)
    else
      self%mesh = equal_steps(self%h)
    end if
  end subroutine set_mesh

  !> Fail if a run is to continue with less data than it needs.
  subroutine check_memory(piece, needed, status)
    type(piece_type), intent(in) :: piece
    integer, intent(in) :: needed
    type(status_type), intent(out) :: status
    call set_ok(status)
    if (size(piece%memory) >= needed) return
    call fail(status, status_input_error, 'memory', 'memory: is not that of such a run')
  end subroutine check_memory

  !> The memory of a run that continues under other loads; the numbers not kept before are zero.
  function memory_under_other_loads(piece, needed) result(memory)
    type(piece_type), intent(in) :: piece
    integer, intent(in) :: needed
    real(wp) :: memory(max(needed, size(piece%memory)))
    memory = 0.0_wp
    memory(:size(piece%memory)) = piece%memory
  end function memory_under_other_loads

end module viscovib_motion_piece
