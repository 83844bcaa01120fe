!> Bifurcations along a branch of an oscillator, and their types.
module viscovib_crossings
  use viscovib_constants, only: pi
  use viscovib_crossing_errors, only: exponent_error
  use viscovib_crossing_nodes, only: spectrum_type
  use viscovib_crossing_search, only: crossing_branch_point, crossing_doubling, crossing_fold, &
    crossing_pair, crossing_symmetry, crossing_type, find_changes, unknown
  use viscovib_curve, only: curve_type
  use viscovib_curve_events, only: special_points
  use viscovib_jump_maps, only: may_jump
  use viscovib_kinds, only: wp
  use viscovib_kinked_motion, only: is_kinked
  use viscovib_motion_stability, only: circle, new_stability_checker, stability_checker, &
    stability_type
  use viscovib_oscillator_curve, only: oscillator_curve_type, vary_frequency
  use viscovib_sized_curve, only: refitted
  use viscovib_stopping, only: given_up
  implicit none
  private

  public :: crossing_type, find_crossings
  public :: crossing_fold, crossing_branch_point, crossing_symmetry, crossing_doubling, &
            crossing_pair

  character(len=*), parameter, public :: crossing_names(5) = &
    [character(len=17) :: 'fold', 'branch point', 'symmetry breaking', 'period doubling', &
     'Neimark-Sacker']

  !> Error of exponents by monodromy matrices (`viscovib_floquet`).
  real(wp), parameter :: noise = 1.0e-11_wp
  !> Factors of the error estimate by twice the orders, for harmonics that decay as powers of their
  !! order: laws with kinks, and with jumps.
  real(wp), parameter :: near_kinks = 1.3_wp, near_jumps = 2.0_wp

  !> Exponents of motions; of half a period for half-wave symmetry.
  type, extends(spectrum_type) :: motion_spectrum
    type(stability_checker), pointer :: checker => null()
    !> The frequency if it does not vary (rad/s).
    real(wp) :: nu = 0.0_wp
  contains
    procedure :: look
    procedure :: follow
    procedure, private :: unit
  end type motion_spectrum

contains

  !> All changes of stability between adjacent points of known stability.
  subroutine find_crossings(checker, curve, nu, p, x, stability, folds, branch_points, crossings, &
                            cancel)
    type(stability_checker), intent(inout), target :: checker
    !> The branch is a part of this curve; unchanged on return except for its frequency and system.
    class(oscillator_curve_type), intent(inout) :: curve
    !> The frequency if it does not vary (rad/s).
    real(wp), intent(in) :: nu
    !> Points of the branch, shapes (n) and (n_unknowns, n), and their stability.
    real(wp), intent(in) :: p(:), x(:, :)
    type(stability_type), intent(in) :: stability
    !> Points that the continuation has located, unknowns as in x.
    type(special_points), intent(in) :: folds, branch_points
    type(crossing_type), allocatable, intent(out) :: crossings(:)
    !> May be set by another thread to cancel the search.
    integer, intent(inout), optional :: cancel
    type(motion_spectrum) :: spectrum
    complex(wp) :: eta(checker%n_slots, size(p))
    real(wp) :: load_factor
    integer :: i

    spectrum%checker => checker
    spectrum%nu = nu
    spectrum%n = checker%n_slots
    spectrum%half_wave = curve%balance%set%half_wave
    spectrum%complete = checker%complete
    if (checker%complete) then
      spectrum%threshold = log(1.0_wp + circle)*merge(0.5_wp, 1.0_wp, spectrum%half_wave)
      spectrum%noise = noise
    end if
    do i = 1, size(p)
      eta(:, i) = scaled(stability%exponents(:, i), 1.0_wp/spectrum%unit(curve, p(i)))
    end do
    load_factor = curve%balance%load_factor
    call find_changes(curve, spectrum, p, x, eta, stability%n_growing, folds, branch_points, &
                      crossings, cancel)
    curve%balance%load_factor = load_factor
    call find_errors(spectrum, curve, p, x, crossings, cancel)
    curve%balance%load_factor = load_factor
  end subroutine find_crossings

  !> Errors of the locations that the continuation has not computed: with twice the orders.
  subroutine find_errors(spectrum, curve, p, x, crossings, cancel)
    type(motion_spectrum), intent(in) :: spectrum
    class(oscillator_curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p(:), x(:, :)
    type(crossing_type), intent(inout) :: crossings(:)
    integer, intent(inout), optional :: cancel
    type(stability_checker), target :: checker
    type(motion_spectrum) :: more
    real(wp), allocatable :: ends(:, :)
    real(wp) :: tail
    integer :: i, j

    if (.not. any(wanted(crossings))) return
    tail = 1.0_wp
    if (is_kinked(curve%system)) tail = near_kinks
    if (may_jump(curve%system)) tail = near_jumps
    call curve%enlarge()
    call new_stability_checker(checker, curve%system, curve%balance%set)
    more = spectrum
    more%checker => checker
    do i = 1, size(crossings)
      if (given_up(cancel)) exit
      associate (c => crossings(i))
        if (.not. wanted(c)) cycle
        ends = reshape([(refitted(curve%blocks, x(:, c%before + j), curve%n), j=0, 1)], &
                       [curve%n, 2])
        call exponent_error(curve, more, p(c%before:c%before + 1), ends, c%p, &
                            refitted(curve%blocks, c%x, curve%n), c%eta, c%error, cancel)
        c%error = tail*c%error
      end associate
    end do
    call curve%restore()
  end subroutine find_errors

  !> True if a crossing has a location whose error is unknown.
  elemental logical function wanted(crossing)
    type(crossing_type), intent(in) :: crossing
    wanted = crossing%located .and. .not. crossing%error > unknown
  end function wanted

  !> The exponent (1/s) of a multiplier e.
  real(wp) function unit(self, curve, p)
    class(motion_spectrum), intent(in) :: self
    class(oscillator_curve_type), intent(in) :: curve
    real(wp), intent(in) :: p
    unit = merge(p, self%nu, curve%vary == vary_frequency)*merge(1.0_wp, 0.5_wp, self%half_wave)/pi
  end function unit

  !> Scale real and imaginary part separately, so that a NaN affects only its own part.
  elemental complex(wp) function scaled(z, factor)
    complex(wp), intent(in) :: z
    real(wp), intent(in) :: factor
    scaled = cmplx(factor*real(z), factor*aimag(z), wp)
  end function scaled

  subroutine look(self, curve, p, x, near, eta, n_growing)
    class(motion_spectrum), intent(inout) :: self
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p, x(:)
    complex(wp), intent(in) :: near(:)
    complex(wp), intent(out) :: eta(:)
    integer, intent(out) :: n_growing
    type(stability_type) :: stability
    real(wp) :: unit

    n_growing = -1
    eta = near
    select type (curve)
    class is (oscillator_curve_type)
      unit = self%unit(curve, p)
      if (curve%changes_system) then
        call new_stability_checker(self%checker, curve%system, curve%balance%set)
      end if
      call self%checker%check(curve%system, [merge(p, self%nu, curve%vary == vary_frequency)], &
                            reshape(x, [size(x)/curve%blocks, curve%blocks, 1]), stability, &
                            near=scaled(near, unit))
      eta = scaled(stability%exponents(:, 1), 1.0_wp/unit)
      n_growing = stability%n_growing(1)
    end select
  end subroutine look

  subroutine follow(self, curve, p, x, near, eta, made)
    class(motion_spectrum), intent(inout) :: self
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p, x(:)
    complex(wp), intent(in) :: near
    complex(wp), intent(out) :: eta
    logical, intent(out) :: made
    real(wp) :: unit

    made = .false.
    eta = near
    select type (curve)
    class is (oscillator_curve_type)
      unit = self%unit(curve, p)
      if (curve%changes_system) then
        call new_stability_checker(self%checker, curve%system, curve%balance%set)
      end if
      call self%checker%follow(curve%system, merge(p, self%nu, curve%vary == vary_frequency), &
                             reshape(x, [size(x)/curve%blocks, curve%blocks]), &
                             scaled(near, unit), eta, made)
      eta = scaled(eta, 1.0_wp/unit)
    end select
  end subroutine follow

end module viscovib_crossings
