! Optimize: -O3
!> Motion of a structure in time: its linear subsystem by exact maps of a step, the forces of its
!! elements as polynomials through the Gauss nodes, their memory as in
!! `viscovib_hereditary`.
!!
!! The state consists of the modes of the linear subsystem; the unknowns of a step are the
!! deflections of the elements at its nodes and its end (`viscovib_structure_step`). The cost of a
!! step is proportional to the number of modes times the number of nodes.
module viscovib_structure_march
  use viscovib_base_motion, only: base_motion_type
  use viscovib_counters, only: count_up, counted_coordinates, counting
  use viscovib_hereditary_kernels, only: add_any
  use viscovib_hereditary_maps, only: remaining_weights
  use viscovib_hereditary_start, only: march_start
  use viscovib_histories, only: past_request
  use viscovib_kinds, only: wp
  use viscovib_march, only: begun, enter_piece, march_type, pull, set_step, &
    step_too_large
  use viscovib_modal_maps, only: sections_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_phases, only: split_phase
  use viscovib_pole_maps, only: rates_at_once
  use viscovib_quadrature, only: lagrange, lagrange_factors
  use viscovib_step_equations, only: solved_for
  use viscovib_structure_inside, only: places_type
  use viscovib_structure_state, only: padded_rows, padded_sections, set_state, show_state, &
    start_state, state_type
  use viscovib_structure_step, only: bends_of, lengthen, make_step, maps_holder, new_maps, &
    part_type, step_begin, structure_panels
  use viscovib_time_load, only: load_clock, new_swing, time_load_type
  implicit none
  private

  public :: structure_march_type, new_structure_march

  !> Length of the step that determines massless variables, relative to the steps of the run.
  real(wp), parameter :: short = 1.0e-3_wp

  !> Relative error of a frequency: at most half of the rounding of its square, and as much from the
  !! steps.
  real(wp), parameter :: known_to = 2.0_wp*epsilon(1.0_wp)
  !> Bound of motions; larger ones diverge.
  real(wp), parameter :: largest = sqrt(huge(1.0_wp))

  type :: phases_type
    !> Decay times of modes and of the part without real modes; largest t |q'| and t |z| so far.
    real(wp), allocatable, private :: fading(:), fading_others(:), swept(:), swept_others(:)
  contains
    procedure :: follow
    procedure :: errors
  end type phases_type

  !> Iterations for the positions at the start if elements have memory.
  integer, parameter :: n_settling = 5

  !> The state consists of the modes.
  type, extends(march_type) :: structure_march_type
    type(state_type) :: state
    type(sections_type), private :: sections
    !> Coordinates that are observed, by modes, shape (n, n_observed).
    real(wp), allocatable, private :: shown(:, :)
    complex(wp), allocatable, private :: shown_left(:, :)
    real(wp), private :: solved = 0.0_wp
    type(maps_holder), allocatable, private :: maps(:)
    !> All quantities that are harmonic with the load; `clock` evaluates the columns of tables.
    type(load_clock), private :: swing
    !> The last step in parts, and their number.
    type(part_type), allocatable, private :: parts(:)
    integer, private :: n_parts = 0
    !> Coefficients of positions inside steps.
    type(places_type), private :: places
    !> As in `phase_errors`.
    type(phases_type), private :: phases
    !> Workspace for a step.
    real(wp), allocatable, private :: values(:), columns(:), recalled(:)
  contains
    procedure :: set_state => set_modes
    procedure :: get_state, observe
    procedure :: kick
    procedure :: enter => enter_structure
    procedure, private :: settle
    procedure :: change_step
    procedure :: make_maps
    procedure :: read_by_laws, n_read
    procedure :: inside
    procedure :: inside_part
    procedure :: furthest
    procedure :: resolution
    procedure :: phase_errors
    procedure :: n_observed
    procedure :: n_saved
    procedure :: n_phases
    procedure :: save_state
    procedure :: saved_of_state
    procedure :: follow_state
    procedure :: load_state
    procedure :: sharpen
    procedure :: starts_moving
    procedure :: make_start
    procedure :: plain_step
    procedure :: stand_still
    procedure :: begin_panels
  end type structure_march_type

contains

  !> A run from modes (q, v) at time 0. `reason`: `begun`, or why the run cannot start.
  subroutine new_structure_march(run, system, sections, shown, shown_left, load, request, q, v, &
                                 reason)
    type(structure_march_type), intent(out) :: run
    !> The elements, in their deflections; a linear subsystem of n sections.
    class(oscillator_type), intent(in), target :: system
    type(sections_type), intent(in) :: sections
    !> Coordinates observed, by modes, shape (n, n_observed).
    real(wp), intent(in) :: shown(:, :)
    complex(wp), intent(in) :: shown_left(:, :)
    !> Columns of tables, whose forces are the last in `sections%pushed`.
    type(time_load_type), intent(in) :: load
    !> The past is that of the deflections.
    type(past_request), intent(in) :: request
    !> Start, shape (n), then Re z and Im z of the part without real modes.
    real(wp), intent(in) :: q(:), v(:)
    integer, intent(out) :: reason
    logical :: made

    run%solved = solved_for(request%tolerance)
    run%sections = padded_sections(sections)
    run%shown = padded_rows(shown)
    run%shown_left = shown_left
    call run%set_state(q, v)
    call new_phases(run%phases, run%sections)
    allocate (run%maps(1), run%parts(1))
    call run%begin(system, load, request, reason)
    if (reason /= begun) return
    allocate (run%columns(run%table%s*size(load%pieces, 1)))
    allocate (run%recalled(run%table%s*size(run%channels%kernel_of)))
    call run%begin_equations(run%maps(run%now)%maps%condensed%step, request%tolerance)
    call run%settle(0.0_wp, made)
    if (.not. made) reason = step_too_large
  end subroutine new_structure_march

  !> Begin a piece of the mesh, where the load may jump.
  subroutine enter_structure(self, t, h, made)
    class(structure_march_type), intent(inout) :: self
    real(wp), intent(in) :: t, h
    logical, intent(out) :: made
    call enter_piece(self, t, h, made)
    if (made) call self%settle(t, made)
  end subroutine enter_structure

  !> Set the massless variables to their equilibrium at time t.
  subroutine settle(self, t, made)
    class(structure_march_type), intent(inout), target :: self
    real(wp), intent(in) :: t
    logical, intent(out) :: made
    integer :: i

    made = .true.
    if (self%sections%others%n_at_once == 0) return
    if (self%remembers()) call self%history%recall(self%recalled)
    ! The memory of the short step begins at the position found before.
    do i = 1, merge(n_settling, 1, self%remembers())
      call settle_at_once(self, t, made)
      if (.not. made) exit
    end do
    call self%stand_still()
  end subroutine settle

  !> Start the next step without extrapolation from the previous step.
  subroutine stand_still(self)
    class(structure_march_type), intent(inout) :: self
    call bends_of(self%equations, self%system, self%maps(self%now)%maps, self%state)
    self%rolling = .false.
  end subroutine stand_still

  pure subroutine set_modes(self, u, v)
    class(structure_march_type), intent(inout) :: self
    real(wp), intent(in) :: u(:), v(:)
    call set_state(self%state, self%sections, u, v)
  end subroutine set_modes

  subroutine kick(self, base, displacement, velocity)
    class(structure_march_type), intent(inout) :: self
    type(base_motion_type), intent(in) :: base
    real(wp), intent(in) :: displacement(:), velocity(:)
    integer :: n
    ! If a base comes to rest, only these jumps show it.
    associate (inner => self%sections%inner, poles => self%sections%others, &
               not_needed => base%direction, moved => displacement(1), speed => velocity(1))
      n = size(inner)
      call add_any(self%state%q(:n), self%state%q_rest(:n), moved*inner)
      call add_any(self%state%v(:n), self%state%v_rest(:n), speed*inner)
      self%state%z = self%state%z + (moved*poles%by_base + speed*poles%by_base_rate)
    end associate
    call start_state(self%state, self%sections)
  end subroutine kick

  subroutine change_step(self, t, h, made)
    class(structure_march_type), intent(inout) :: self
    real(wp), intent(in) :: t, h
    logical, intent(out) :: made
    call set_step(self, t, h, made)
    if (.not. made) return
    associate (amplitudes => self%maps(self%now)%maps%modal%swing)
      call new_swing(self%swing, self%sections%frequencies, amplitudes, t, h)
      if (.not. allocated(self%values)) allocate (self%values(size(amplitudes, 1)))
    end associate
  end subroutine change_step

  subroutine make_maps(self, singular)
    class(structure_march_type), intent(inout) :: self
    logical, intent(out) :: singular
    real(wp) :: e(self%table%s, 0:self%table%s + 1, 0:size(self%system%kernels))

    if (size(self%lengths) > size(self%maps)) call lengthen(self%maps, size(self%lengths))
    associate (holder => self%maps(self%now))
      if (.not. allocated(holder%maps)) allocate (holder%maps)
      call remaining_weights(self%system, self%table, self%h, e)
      call new_maps(holder%maps, self%system, self%channels, self%sections, self%table, self%h, e, &
                    singular)
    end associate
  end subroutine make_maps

  !> One step to time `until`, with forces as polynomials.
  subroutine plain_step(self, until, made)
    class(structure_march_type), intent(inout) :: self
    real(wp), intent(in) :: until
    logical, intent(out) :: made
    type(time_load_type) :: no_table

    if (counting) call count_up(counted_coordinates, size(self%sections%squares))
    allocate (no_table%breaks(0))
    call self%swing%at_nodes(no_table, self%values)
    call self%clock%at_nodes(self%load, self%columns)
    if (self%remembers()) call self%history%recall(self%recalled)
    self%n_parts = max(self%panel, 1)
    associate (part => self%parts(self%n_parts), maps => self%maps(self%now)%maps)
      part%start = self%swing%t
      call make_step(self%state, self%system, self%sections, self%table, maps, self%equations, &
                     step_begin(self%rolling, self%trusted, self%bound), self%values, &
                     self%columns, self%recalled, part, self%points, made, self%doubtful)
      if (.not. made) return
      self%trusted = .false.
    end associate
    call self%store_step()
    call self%clock%advance(until)
    call self%swing%advance(until)
    call self%phases%follow(self%state, until)
    self%rolling = .true.
  end subroutine plain_step

  !> Allocate the panels of a step.
  subroutine begin_panels(self, ends)
    class(structure_march_type), intent(inout) :: self
    real(wp), intent(in) :: ends(0:)

    if (size(self%parts) >= size(ends) - 1) return
    deallocate (self%parts)
    allocate (self%parts(size(ends) - 1))
  end subroutine begin_panels

  pure logical function starts_moving(self)
    class(structure_march_type), intent(in) :: self
    starts_moving = any(abs(self%state%q) > 0.0_wp) .or. any(abs(self%state%v) > 0.0_wp) &
                    .or. any(abs(self%state%z) > 0.0_wp) &
                    .or. any(abs(self%sections%others%cosine) > 0.0_wp) &
                    .or. any(abs(aimag(sum(self%sections%waves, 2))) > 0.0_wp)
  end function starts_moving

  subroutine make_start(self, made)
    class(structure_march_type), intent(inout), target :: self
    logical, intent(out) :: made
    type(structure_panels) :: panels

    panels%sections => self%sections
    panels%state = self%state
    panels%bound = self%bound
    panels%solved = self%solved
    allocate (panels%parts(64))
    call march_start(self%start, self%system, self%channels, self%load, self%known_past, self%h, &
                     panels, made)
    if (.not. made) return
    self%state = panels%state
    call self%swing%advance(self%h)
    self%n_parts = panels%n_made
    deallocate (self%parts)
    allocate (self%parts(self%n_parts))
    self%parts(:) = panels%parts(:self%n_parts)
  end subroutine make_start

  pure subroutine get_state(self, u, v)
    class(structure_march_type), intent(in) :: self
    real(wp), allocatable, intent(out) :: u(:), v(:)
    u = [self%state%q, real(self%state%z)]
    v = [self%state%v, aimag(self%state%z)]
  end subroutine get_state

  pure integer function n_observed(self)
    class(structure_march_type), intent(in) :: self
    n_observed = size(self%shown, 2)
  end function n_observed

  subroutine observe(self, u, v)
    class(structure_march_type), intent(in) :: self
    real(wp), intent(out) :: u(:), v(:)
    associate (state => self%state)
      call show_state(self%sections, self%shown, self%shown_left, state%q, state%v, state%z, &
                      state%z_rate, u, v)
    end associate
  end subroutine observe

  !> Deflections of elements.
  subroutine read_by_laws(self, u, v)
    class(structure_march_type), intent(in) :: self
    real(wp), intent(out) :: u(:), v(:)
    u = self%state%w
    v = self%state%w_rate
  end subroutine read_by_laws

  pure integer function n_read(self)
    class(structure_march_type), intent(in) :: self
    n_read = size(self%state%w)
  end function n_read

  subroutine inside(self, theta, u, v)
    class(structure_march_type), intent(inout) :: self
    real(wp), intent(in) :: theta
    real(wp), intent(out) :: u(:), v(:)
    integer :: d
    call inside_at(self, theta, [(d, d=1, size(u))], u, v)
  end subroutine inside

  !> As in `march_type`.
  subroutine inside_part(self, begin, width, points, which, u, v)
    class(structure_march_type), intent(inout) :: self
    real(wp), intent(in) :: begin, width, points(:)
    integer, intent(in) :: which(:)
    real(wp), intent(out) :: u(:, :), v(:, :)
    integer :: i
    do i = 1, size(points)
      call inside_at(self, begin + width*points(i), which, u(i, :), v(i, :))
    end do
  end subroutine inside_part

  !> Some observed coordinates and their velocities inside the last step.
  subroutine inside_at(self, theta, which, u, v)
    class(structure_march_type), intent(inout) :: self
    real(wp), intent(in) :: theta
    integer, intent(in) :: which(:)
    real(wp), intent(out) :: u(:), v(:)
    real(wp) :: begin
    integer :: k

    begin = self%parts(1)%start
    k = 1
    do while (k < self%n_parts)
      if (self%parts(k + 1)%start - begin > theta*self%h) exit
      k = k + 1
    end do
    call self%places%look(self%parts(k), self%sections, self%shown, self%shown_left, self%table, &
                          theta*self%h - (self%parts(k)%start - begin), self%n_parts == 1, which, &
                          u, v)
  end subroutine inside_at

  pure real(wp) function furthest(self)
    class(structure_march_type), intent(in) :: self
    furthest = self%state%furthest
  end function furthest

  pure real(wp) function resolution(self)
    class(structure_march_type), intent(in) :: self
    resolution = 0.0_wp
    ! Without forces that depend on deflections, no polynomials are needed.
    if (size(self%equations%y) + size(self%recalled) == 0) return
    resolution = self%state%resolution(self%sections)
  end function resolution

  !> As in `march_type`.
  pure function phase_errors(self) result(errors)
    class(structure_march_type), intent(in) :: self
    real(wp) :: errors(2*self%n_observed())
    errors = self%phases%errors(self%sections, self%shown, self%shown_left)
  end function phase_errors

  subroutine sharpen(self)
    class(structure_march_type), intent(inout) :: self
    call self%equations%sharpen()
    self%solved = min(self%solved, epsilon(1.0_wp))
  end subroutine sharpen

  pure integer function n_saved(self)
    class(structure_march_type), intent(in) :: self
    n_saved = self%state%n_numbers() + self%n_phases()
  end function n_saved

  !> With the massless variables, whose number depends on the load.
  pure integer function n_phases(self)
    class(structure_march_type), intent(in) :: self
    n_phases = 2*size(self%swing%high) + 3*size(self%state%z_rate)
  end function n_phases

  function save_state(self) result(saved)
    class(structure_march_type), intent(in) :: self
    real(wp) :: saved(self%n_saved())
    saved = [self%state%save_numbers(), self%swing%high, self%swing%low, &
             self%state%at_once_numbers()]
  end function save_state

  !> True for the numbers of a saved state but deflections, which follow from modes, their
  !! assessment, and phases.
  function saved_of_state(self) result(flags)
    class(structure_march_type), intent(in) :: self
    logical :: flags(self%n_saved())
    integer :: assessed, n
    n = self%state%n_numbers()
    assessed = n - 4*size(self%state%w)
    flags = .true.
    flags(1) = .false.
    flags(assessed + 1:n + 2*size(self%swing%high)) = .false.
  end function saved_of_state

  subroutine follow_state(self)
    class(structure_march_type), intent(inout) :: self
    call start_state(self%state, self%sections)
  end subroutine follow_state

  subroutine load_state(self, saved, other_load)
    class(structure_march_type), intent(inout) :: self
    real(wp), intent(in) :: saved(:)
    logical, intent(in) :: other_load
    integer :: n

    self%swing%t = self%clock%t
    n = self%state%n_numbers()
    call self%state%load_numbers(saved(:n))
    if (other_load) return
    call pull(saved, n, self%swing%high)
    call pull(saved, n, self%swing%low)
    call self%state%load_at_once(saved(n + 1:n + 3*size(self%state%z_rate)))
  end subroutine load_state

  ! Massless variables at the start of a motion or after a jump of the load: a step so short that
  ! everything else is constant determines the forces, and their polynomials give values and slopes
  ! at its start.

  !> Set them at time `now`.
  subroutine settle_at_once(self, now, made)
    type(structure_march_type), intent(inout), target :: self
    real(wp), intent(in) :: now
    logical, intent(out) :: made
    type(structure_panels) :: panels
    real(wp) :: local(self%table%s, 0:self%table%s + 1, size(self%system%kernels))
    real(wp) :: points(0:self%table%s + 1, size(self%system%gather, 2))
    real(wp) :: g(0:self%table%s + 1, size(self%channels%kernel_of)), h
    real(wp), dimension(size(self%sections%frequencies)) :: high, low
    real(wp) :: e(self%table%s, 0:self%table%s + 1, 0:size(self%system%kernels))
    real(wp) :: early(self%table%s, self%table%s)
    real(wp), dimension(self%table%s) :: weights, factors
    real(wp) :: forces(size(self%sections%pushed, 2))
    integer :: i, m

    h = short*self%h
    associate (c => self%table%points(1:self%table%s))
      factors = lagrange_factors(c)
      weights = lagrange(c, factors, 0.0_wp)
      do i = 1, self%table%s
        early(i, :) = lagrange(c, factors, short*c(i))
      end do
    end associate
    call remaining_weights(self%system, self%table, h, e)
    local = -e(:, :, 1:)
    do i = 1, self%table%s
      local(i, i, :) = local(i, i, :) + 1.0_wp
    end do
    panels%sections => self%sections
    panels%state = self%state
    panels%solved = self%solved
    allocate (panels%parts(1))
    call panels%make(self%system, self%channels, self%load, self%table, local, now, h, &
                     matmul(early, reshape(self%recalled, [self%table%s, size(g, 2)])), points, g, &
                     made)
    if (.not. made) return
    call split_phase(self%sections%frequencies, now, high, low)
    associate (part => panels%parts(1), poles => self%sections%others, state => self%state, &
               phi => high + low)
      forces = matmul(weights, part%forces)
      do i = 1, poles%n_at_once
        m = size(poles%poles) - poles%n_at_once + i
        state%z(m) = sum(real(poles%right(m, :))*forces) &
                     + sum(real(poles%sine(m, :))*sin(phi) + real(poles%cosine(m, :))*cos(phi))
        state%z_rest(m) = (0.0_wp, 0.0_wp)
      end do
      call rates_at_once(poles, self%table, self%sections%frequencies, 0.0_wp, h, part%forces, &
                         phi, state%z_rate)
    end associate
    call start_state(self%state, self%sections)
  end subroutine settle_at_once

  ! Error of the motion of a structure due to rounding of its frequencies and poles.
  !
  ! A frequency omega has the error eps omega. After a time t its mode has the phase error
  ! eps omega t, for any step size, so that no comparison of runs shows it:
  !
  !   |dq| = eps t |q'|,    |dq'| = eps t omega |q'|,    |dz| = eps t |pole z|,                (1)
  !
  ! where t is at most the decay time of the mode, since earlier motion has decayed. For an
  ! oscillating mode the phase of its samples is unknown, so that the largest values of (1) are
  ! used; those of different modes are independent of each other.

  subroutine new_phases(phases, sections)
    type(phases_type), intent(out) :: phases
    type(sections_type), intent(in) :: sections

    associate (squares => sections%squares, rates => sections%rates, poles => sections%others%poles)
      allocate (phases%fading(size(squares)), phases%fading_others(size(poles)), source=largest)
      ! exp(-rate t/2), and exp(-square t/rate) for overdamped modes.
      where (rates > 1.0_wp/largest .and. squares > rates/largest)
        phases%fading = max(2.0_wp/rates, rates/squares)
      end where
      where (-real(poles) > 1.0_wp/largest) phases%fading_others = -1.0_wp/real(poles)
      allocate (phases%swept(size(squares)), phases%swept_others(size(poles)), source=0.0_wp)
    end associate
  end subroutine new_phases

  !> Process a step that ends at time t.
  pure subroutine follow(self, state, t)
    class(phases_type), intent(inout) :: self
    type(state_type), intent(in) :: state
    real(wp), intent(in) :: t
    self%swept = max(self%swept, min(t, self%fading)*min(abs(state%v), largest))
    self%swept_others = max(self%swept_others, min(t, self%fading_others) &
                            *min(abs(state%z), largest))
  end subroutine follow

  !> Errors of the observed values, (u_1, u'_1, ...).
  pure function errors(self, sections, shown, shown_left)
    class(phases_type), intent(in) :: self
    type(sections_type), intent(in) :: sections
    !> By modes, shapes (n, n_shown) and (n_poles, n_shown).
    real(wp), intent(in) :: shown(:, :)
    complex(wp), intent(in) :: shown_left(:, :)
    real(wp) :: errors(2*size(shown, 2))
    integer :: d

    associate (squares => abs(sections%squares), sizes => abs(sections%others%poles))
      do d = 1, size(shown, 2)
        errors(2*d - 1) = norm2([norm2(shown(:, d)*self%swept), &
                                 norm2(abs(shown_left(:, d))*sizes*self%swept_others)])
        errors(2*d) = norm2([norm2(shown(:, d)*sqrt(squares)*self%swept), &
                             norm2(abs(shown_left(:, d))*sizes**2*self%swept_others)])
      end do
    end associate
    errors = known_to*errors
  end function errors

end module viscovib_structure_march
