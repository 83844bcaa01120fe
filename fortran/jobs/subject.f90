!> The system of a job: with names and units of its coordinates, and its loads.
module viscovib_subject
  use viscovib_cycle_terms, only: has_kinks
  use viscovib_kernel_doubts, only: doubt_integral, doubt_table
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof
  use viscovib_limits, only: corner_tolerance, smooth_tolerance
  use viscovib_load, only: load_type
  use viscovib_modal_motion, only: modal_finder
  use viscovib_motion_choice, only: with_memory, without_memory
  use viscovib_mount, only: mount_type
  use viscovib_mounted_body, only: mounted_body, rest_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_model, only: structure_model
  use viscovib_turning_body, only: turning_body
  implicit none
  private

  public :: subject_type

  !> Longest name of a coordinate or a unit.
  integer, parameter, public :: name_length = 16
  !> Largest number of coordinates of a structure that are all shown by default.
  integer, parameter :: all_shown = 64

  type :: subject_type
    !> A pendulum with its own loads; else a mount, a polynomial system, a structure or a body
    !! under `load`.
    logical :: is_pendulum = .false., is_polynomial = .false., is_structure = .false.
    !> Kind of the equations of its motions in time, as of `choose_equations`.
    integer :: equations = with_memory
    !> A body with finite rotations; with small rotations it is a polynomial system.
    logical :: is_turning = .false.
    !> True for any body in space: its centre of mass in the axes of the positions, its static
    !! equilibrium, and its rotation there.
    logical :: is_body = .false.
    type(mounted_body) :: body
    type(rest_type) :: rest
    type(kernel_holder), allocatable :: body_kernels(:)
    real(wp) :: center(3) = 0.0_wp, axes(3, 3) = 0.0_wp
    !> Warnings from reading, one per line.
    character(len=:), allocatable :: warned
    type(pendulum_type) :: pendulum
    type(mount_type) :: mount
    type(polynomial_type) :: polynomial
    type(turning_body) :: turning
    !> A structure as given, and condensed to the deflections of its elements, with the condensed
    !! `load`.
    type(structure_model) :: model
    type(structure_type) :: structure
    type(load_type) :: load
    character(len=name_length), allocatable :: coordinates(:), units(:)
    !> Angle and speed at t = 0 of the shaft, whose angle is the last coordinate; not allocated: no
    !! speed changes in time.
    real(wp), allocatable :: shaft_start(:)
  contains
    procedure :: oscillator
    procedure :: whole_load
    procedure :: base_direction
    procedure :: usual_tolerance
    procedure :: remembers
    procedure :: has_kernels
    procedure :: has_hidden_state
    procedure :: goes_side_by_side
    procedure :: warnings
    procedure :: description
    procedure :: show_motions
    procedure :: shown
    procedure :: n_modes
  end type subject_type

contains

  !> The mount, the polynomial system, or the condensed structure.
  function oscillator(self)
    class(subject_type), intent(in), target :: self
    class(oscillator_type), pointer :: oscillator
    if (self%is_structure) then
      oscillator => self%structure
    else if (self%is_turning) then
      oscillator => self%turning
    else if (self%is_polynomial) then
      oscillator => self%polynomial
    else
      oscillator => self%mount
    end if
  end function oscillator

  !> The tolerance of steady motions if none is given.
  real(wp) function usual_tolerance(self)
    class(subject_type), intent(in) :: self
    usual_tolerance = merge(corner_tolerance, smooth_tolerance, has_kinks(self%oscillator()))
  end function usual_tolerance

  !> The load on all coordinates.
  function whole_load(self) result(load)
    class(subject_type), intent(in), target :: self
    type(load_type), pointer :: load
    load => self%load
    if (self%is_structure) load => self%model%load
  end function whole_load

  !> Motion of the coordinates with the base.
  pure function base_direction(self)
    class(subject_type), intent(in) :: self
    real(wp), allocatable :: base_direction(:)
    if (self%is_structure) then
      base_direction = self%model%base_direction
    else if (self%is_turning) then
      base_direction = self%turning%base_direction
    else if (self%is_polynomial) then
      base_direction = self%polynomial%base_direction
    else
      base_direction = self%mount%base_direction
    end if
  end function base_direction

  !> True if its motions in time have equations with memory.
  pure logical function remembers(self)
    class(subject_type), intent(in) :: self
    remembers = .not. self%is_pendulum .and. self%equations /= without_memory
  end function remembers

  !> True if any force has a kernel, for any representation in time.
  logical function has_kernels(self)
    class(subject_type), intent(in), target :: self
    class(oscillator_type), pointer :: system
    has_kernels = .false.
    if (self%is_pendulum) return
    system => self%oscillator()
    has_kernels = any(system%kernel_of > 0)
  end function has_kernels

  !> True if coordinates and velocities are not the whole state: kernels, or laws with states.
  logical function has_hidden_state(self) result(has)
    class(subject_type), intent(in) :: self
    integer :: i
    has = self%has_kernels()
    if (self%is_polynomial) has = has .or. any(self%polynomial%laws%state > 0)
    if (.not. self%is_structure) return
    do i = 1, size(self%model%elements)
      has = has .or. any(self%model%elements(i)%laws%state > 0)
    end do
  end function has_hidden_state

  !> True if its motions can be computed in lanes.
  pure logical function goes_side_by_side(self, disturbed) result(goes)
    class(subject_type), intent(in) :: self
    !> True if Lyapunov exponents are wanted (default: not).
    logical, intent(in), optional :: disturbed
    integer :: i, most
    most = max_dof
    if (present(disturbed)) most = merge(max_dof/2, max_dof, disturbed)
    goes = self%is_pendulum
    if (goes .or. self%is_structure .or. self%is_turning .or. self%remembers()) return
    goes = self%is_polynomial .and. size(self%coordinates) <= most &
           .and. .not. (any(self%polynomial%kernel_of > 0) .or. self%load%moves_base())
    if (.not. goes) return
    do i = 1, size(self%polynomial%laws)
      associate (law => self%polynomial%laws(i))
        if (law%state > 0 .or. law%program%n_surfaces() > 0) goes = .false.
      end associate
    end do
  end function goes_side_by_side

  !> A line of a plan about condensation; empty without condensation.
  function description(self) result(text)
    class(subject_type), intent(in) :: self
    character(len=:), allocatable :: text
    text = ''
    if (self%is_structure) text = self%model%description()
  end function description

  !> Harmonics of the requested coordinates, shape (n_orders, n_wanted, n), from those of the
  !! unknowns, shape (n_orders, n_dof, n).
  subroutine show_motions(self, nu, factor, orders, wanted, absolute, motions, linear)
    class(subject_type), intent(in) :: self
    !> Frequency, and factor of the load, of each motion.
    real(wp), intent(in) :: nu(:), factor(:)
    integer, intent(in) :: orders(:), wanted(:)
    !> True if the results are absolute, including the base motion.
    logical, intent(in) :: absolute
    complex(wp), allocatable, intent(inout) :: motions(:, :, :)
    !> True for motions of the forces linearized at zero (default: not).
    logical, intent(in), optional :: linear
    complex(wp) :: y(size(motions, 1), size(motions, 2)), base
    complex(wp), allocatable :: shown(:, :, :), modes(:, :), poles(:, :), forces(:, :)
    type(modal_finder) :: finder
    integer :: i, j, k

    if (.not. self%is_structure) then
      if (size(wanted) < size(motions, 2)) motions = motions(:, wanted, :)
      return
    end if
    if (present(linear)) finder%linear = linear
    associate (rest => self%model%rest, load => self%load, n => size(orders))
      allocate (shown(n, size(wanted), size(motions, 3)), modes(size(rest%squares), n), &
                poles(size(rest%poles), n), forces(size(y, 2), n))
      do i = 1, size(motions, 3)
        y = motions(:, :, i)
        do j = 1, size(load%orders)
          k = findloc(orders, load%orders(j), 1)
          base = factor(i)*load%base(j)
          if (k > 0 .and. absolute) y(k, :) = y(k, :) - self%structure%base_direction*base
        end do
        call finder%find(self%structure, nu(i), factor(i), orders, y, modes, poles, forces)
        shown(:, :, i) = transpose(matmul(rest%shapes(wanted, :), modes) &
                                   + matmul(rest%left(wanted, :), poles))
        do j = 1, size(load%orders)
          k = findloc(orders, load%orders(j), 1)
          base = factor(i)*load%base(j)
          if (k > 0) shown(k, :, i) = shown(k, :, i) + self%model%base_direction(wanted)*base
        end do
      end do
    end associate
    call move_alloc(shown, motions)
  end subroutine show_motions

  pure integer function n_modes(self)
    class(subject_type), intent(in) :: self
    n_modes = size(self%coordinates)
    if (self%is_structure) n_modes = self%model%rest%n_modes()
  end function n_modes

  !> Coordinates that tables show by default: for a large structure those at which
  !! loads and elements act.
  pure function shown(self)
    class(subject_type), intent(in) :: self
    logical, allocatable :: shown(:)
    integer :: i
    allocate (shown(size(self%coordinates)), source=.true.)
    if (.not. allocated(self%model%elements) .or. size(shown) <= all_shown) return
    shown = self%model%load%touches()
    do i = 1, size(self%model%elements)
      shown = shown .or. abs(self%model%elements(i)%direction) > 0.0_wp
    end do
    if (.not. any(shown)) shown(1) = .true.
  end function shown

  !> A line for each kernel in use whose integral is not between 0 and 1, or not known.
  function warnings(self) result(text)
    class(subject_type), intent(in), target :: self
    character(len=:), allocatable :: text
    class(oscillator_type), pointer :: system
    character(len=:), allocatable :: line
    integer :: i

    text = ''
    if (allocated(self%warned)) text = self%warned
    if (self%is_pendulum) return
    system => self%oscillator()
    do i = 1, size(system%kernels)
      if (.not. any(system%kernel_of == i)) cycle
      call doubt_integral(system%kernels(i)%integral(), line)
      if (line /= '') text = text//line//new_line('a')
      call doubt_table(system%kernels(i)%kernel, line)
      if (line /= '') text = text//line//new_line('a')
    end do
  end function warnings

end module viscovib_subject
