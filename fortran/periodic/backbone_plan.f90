!> Plan of a backbone curve of an oscillator: the system without losses, the linear mode, the
!! coordinate of the amplitude, and the harmonics.
module viscovib_backbone_plan
  use viscovib_free_orders, only: chosen_text, first_chosen, highest_chosen
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_cycle_terms, only: has_states
  use viscovib_load, only: load_type, new_load
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_modes, only: oscillator_modes
  use viscovib_response, only: response_options
  use viscovib_response_plan, only: method_newton, new_response_plan, response_plan_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type, things
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: backbone_plan_type, new_backbone_plan

  !> Relative tolerances: for a frequency of 0, for a coordinate at rest, and for equal sizes.
  real(wp), parameter :: rigid = 1.0e-7_wp, at_rest = 1.0e-6_wp, equal = 1.0e-9_wp

  type :: backbone_plan_type
    !> Without damping and memory.
    class(oscillator_type), allocatable :: system
    !> The linear mode, numbered from 0: its frequency (rad/s) and shape (n_dof).
    integer :: mode = 0
    real(wp) :: omega = 0.0_wp
    real(wp), allocatable :: shape(:)
    !> The coordinate whose amplitude is the parameter.
    integer :: dof = 0
    !> Harmonics; if their number is adapted, the first set, and the highest order `most`.
    type(harmonic_set_type) :: set
    logical :: chosen = .false.
    integer :: most = 0
    !> Lines of the plan's text about omitted harmonics.
    character(len=:), allocatable :: rest
  contains
    procedure :: n_most
    procedure :: text
  end type backbone_plan_type

contains

  subroutine new_backbone_plan(plan, system, mode, dof, name, harmonics, chosen, &
                               tolerance, status)
    type(backbone_plan_type), intent(out) :: plan
    class(oscillator_type), intent(in) :: system
    !> Mode, numbered from 0. Coordinate, numbered from 1, or 0: the largest of the mode, weighted
    !! by the root of its inertia, so that the choice does not depend on units.
    integer, intent(in) :: mode, dof
    !> Name of the coordinate, for messages.
    character(len=*), intent(in) :: name
    !> Highest order; `chosen`: as many harmonics as the tolerance requires instead.
    integer, intent(in) :: harmonics
    logical, intent(in) :: chosen
    real(wp), intent(in) :: tolerance
    type(status_type), intent(out) :: status
    type(response_plan_type) :: planned
    type(response_options) :: options
    type(load_type) :: load
    real(wp) :: moved(system%n_dof())
    complex(wp) :: unit(system%n_dof(), 1)
    integer :: d, n

    n = system%n_dof()
    call set_ok(status)
    if (system%n_rates() > 0 .or. has_states(system)) then
      call fail(status, status_input_error, 'forces', 'forces: some depend on rates, or have ' &
                //'friction: backbones are of systems without losses')
      return
    end if
    allocate (plan%system, source=system)
    plan%system%damping = 0.0_wp
    plan%system%kernel_of = 0
    plan%mode = mode
    select type (inner => plan%system)
    class is (structure_type)
      call find_structure_mode(inner, mode, plan%omega, plan%shape, status)
    class default
      call find_mode(inner, mode, plan%omega, plan%shape, status)
    end select
    if (status%failed()) return
    moved = abs(plan%shape)*sqrt([(system%mass(d, d), d=1, n)])
    plan%dof = dof
    if (dof == 0) plan%dof = findloc(moved >= (1.0_wp - equal)*maxval(moved), .true., 1)
    if (moved(plan%dof) < at_rest*maxval(moved)) then
      call fail(status, status_input_error, 'dof', "dof = '"//trim(name)//"': does not move in " &
                //'mode '//show(mode))
      return
    end if
    ! Use the harmonics of a load of order 1.
    unit = (1.0_wp, 0.0_wp)
    call new_load(load, n, [1], unit, [(0.0_wp, 0.0_wp)], status)
    options%harmonics = harmonics
    options%choose_harmonics = chosen
    options%tolerance = tolerance
    options%keep_idle = .true.
    ! A linear system keeps its harmonics, as on a branch.
    options%on_branch = .true.
    if (.not. status%failed()) call new_response_plan(planned, plan%system, load, [plan%omega], &
                                                      method_newton, options, status)
    if (status%failed()) return
    plan%set = planned%set
    plan%chosen = chosen
    plan%most = planned%most
    if (chosen) then
      plan%most = min(planned%most, highest_chosen)
      call new_harmonic_set(plan%set, min(first_chosen, plan%most), planned%set%half_wave, &
                            plan%system%degree)
    end if
    call planned%describe(plan%system, load, 1)
    plan%rest = lines_with('harmonics', planned%rest)
  end subroutine new_backbone_plan

  subroutine find_mode(system, mode, omega, shape, status)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: mode
    real(wp), intent(out) :: omega
    real(wp), allocatable, intent(out) :: shape(:)
    type(status_type), intent(inout) :: status
    real(wp) :: omegas(system%n_dof()), shapes(system%n_dof(), system%n_dof())

    omega = 0.0_wp
    call check_mode(mode, size(omegas), status)
    if (.not. status%failed()) call oscillator_modes(system, omegas, shapes, status)
    if (status%failed()) return
    if (omegas(mode + 1) <= rigid*omegas(size(omegas))) call refuse_rigid(mode, status)
    omega = omegas(mode + 1)
    shape = shapes(:, mode + 1)
  end subroutine find_mode

  !> Mode of a structure without losses. Its linear subsystem includes the linear parts of the
  !! elements.
  subroutine find_structure_mode(system, mode, omega, shape, status)
    class(structure_type), intent(in) :: system
    integer, intent(in) :: mode
    real(wp), intent(out) :: omega
    real(wp), allocatable, intent(out) :: shape(:)
    type(status_type), intent(inout) :: status

    omega = 0.0_wp
    call check_mode(mode, system%rest%n_modes, status)
    if (status%failed()) return
    shape = system%rest%seen(mode + 1, :)
    if (.not. system%rest%squares(mode + 1) > 0.0_wp) then
      call refuse_rigid(mode, status)
      return
    end if
    omega = sqrt(system%rest%squares(mode + 1))
  end subroutine find_structure_mode

  subroutine check_mode(mode, n, status)
    integer, intent(in) :: mode, n
    type(status_type), intent(inout) :: status
    if (mode < 0 .or. mode > n - 1) then
      call fail(status, status_input_error, 'mode', 'mode = '//show(mode)//': must be 0 to ' &
                //show(n - 1))
    end if
  end subroutine check_mode

  subroutine refuse_rigid(mode, status)
    integer, intent(in) :: mode
    type(status_type), intent(inout) :: status
    call fail(status, status_input_error, 'mode', 'mode = '//show(mode)//': moves as a rigid ' &
              //'body, its frequency is 0')
  end subroutine refuse_rigid

  !> Largest number of harmonics.
  pure integer function n_most(self)
    class(backbone_plan_type), intent(in) :: self
    n_most = merge((self%most + 1)/2, self%most + 1, self%set%half_wave)
  end function n_most

  !> Text of the plan: what is computed between two amplitudes, and what is skipped.
  function text(self, from, to)
    class(backbone_plan_type), intent(in) :: self
    real(wp), intent(in) :: from, to
    character(len=:), allocatable :: text, kept
    character(len=*), parameter :: nl = new_line('a')
    kept = things(size(self%set%orders), 'harmonic')//' per coordinate'
    if (self%chosen) kept = chosen_text(self%set%orders(size(self%set%orders)))
    text = 'computes: free motions of mode '//show(self%mode)//' from amplitude '//show(from) &
           //' to '//show(to)//', '//kept//nl &
           //'skips: damping, memory and loads (free motions of the system without losses)'//nl &
           //'skips: sines (motions that start at rest are even in time)'//nl//self%rest
  end function text

  pure function lines_with(word, lines) result(kept)
    character(len=*), intent(in) :: word, lines
    character(len=:), allocatable :: kept
    integer :: first, last
    kept = ''
    first = 1
    do while (first <= len(lines))
      last = first + index(lines(first:), new_line('a')) - 1
      if (index(lines(first:last), word) > 0) kept = kept//lines(first:last)
      first = last + 1
    end do
  end function lines_with

end module viscovib_backbone_plan
