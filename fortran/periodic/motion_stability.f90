! Optimize: -O2
!> Stability of many periodic solutions of a system, without memory by Floquet multipliers,
!! with memory by the exponents of Hill's determinant.
module viscovib_motion_stability
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_quiet_nan, ieee_value
  use viscovib_condensed_stability, only: condensed_checker, new_condensed_checker
  use viscovib_constants, only: pi
  use viscovib_cycle_terms, only: has_kinks
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_floquet, only: floquet_type, new_floquet
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_hill, only: hill_type, new_hill
  use viscovib_hill_count, only: count_right, on_axis
  use viscovib_hill_path, only: hill_path_type, new_hill_path
  use viscovib_hill_roots, only: complete, find_exponents, find_more
  use viscovib_hill_secant, only: follow_exponent, leftmost
  use viscovib_jump_maps, only: find_jumps, jump_map, may_jump
  use viscovib_kinds, only: wp
  use viscovib_kinked_motion, only: is_kinked
  use viscovib_kinked_stability, only: kinked_multipliers
  use viscovib_lanes, only: n_lanes
  use viscovib_modal_floquet, only: modal_floquet, new_modal_floquet, states_of_modes
  use viscovib_orbit_multipliers, only: logarithm, distinguished
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial_condensation, only: turn_system
  use viscovib_product_eigenvalues, only: product_eigenvalues, product_type
  use viscovib_stopping, only: given_up
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: stability_checker, stability_type, new_stability_checker

  !> Stability that hangs on the orders left out (`viscovib_truncated_stability`).
  integer, parameter, public :: unknown_by_truncation = -2

  !> Multipliers this close to the unit circle count as on it.
  real(wp), parameter, public :: circle = 1.0e-9_wp
  !> The same of motions on whose way a law jumps.
  real(wp), parameter :: jumping_circle = 2.0e-3_wp
  !> Beyond this logarithm a multiplier leaves the range of numbers.
  real(wp), parameter :: largest_log = 700.0_wp
  !> Number of modes up to which integration is faster than counting; limit of squared frequencies
  !! of rigid modes, relative to the largest.
  integer, parameter :: quick_modes = 4
  real(wp), parameter :: rigid = 1.0e-6_wp
  !> Exponents kept beyond two a coordinate: memory has slow ones of its own.
  integer, parameter :: more = 4
  !> How far left of the slowest exponent to count, of that and of d: for a neighbour, and for the
  !! motion itself; and how far memory must fade faster than it, in d.
  real(wp), parameter :: wide(2) = [0.2_wp, 5.0e-3_wp], narrow(2) = [0.05_wp, 1.0e-3_wp]
  real(wp), parameter :: least_size = 1.0e-6_wp
  !> Step along a curve, in the one before, up to which exponents are continued along lines.
  real(wp), parameter :: longest_step = 3.0_wp

  !> Of n solutions.
  type :: stability_type
    !> 1: stable, 0: not, -1: unknown, -2: unknown by truncation; how many disturbances grow,
    !! -1: unknown. Shape (n).
    integer, allocatable :: stable(:), n_growing(:)
    !> Whether none decays more slowly than the first exponent. Shape (n).
    logical, allocatable :: slowest(:)
    !> Of disturbances exp(lambda t) times a periodic function (1/s), modulo i nu, or 2 i nu
    !! under half-wave symmetry; largest real part first. With memory those that grow are
    !! complete, or all NaN; of others some may lack, NaN behind the last. Shape (slots, n).
    complex(wp), allocatable :: exponents(:, :)
    !> exp(2 pi lambda/nu), NaN also where that is too large for a number.
    complex(wp), allocatable :: multipliers(:, :)
  end type stability_type

  type :: stability_checker
    logical :: remembers = .false.
    !> Whether all exponents are always known, else some of those that decay may lack.
    logical :: complete = .true.
    integer :: n_slots = 0
    logical, private :: half_wave = .false.
    !> Laws with kinks, or states: checked between these.
    logical, private :: kinked = .false.
    !> Some law may jump, which Hill's determinant and monodromies do not see.
    logical, private :: jumps = .false.
    type(harmonic_set_type), private :: set
    type(hill_type), private :: hill
    type(floquet_type), private :: floquet
    !> Of linear systems the characteristic roots (1/s) that exponents follow from, how many of them
    !! grow, and whether the first is the slowest: the same for every motion.
    complex(wp), allocatable, private :: roots(:)
    integer, private :: n_growing_roots = -1
    logical, private :: slowest_root = .false.
    !> Of a condensed structure; perturbations of one with few modes may be integrated, and are
    !! counted first if these are more than a few.
    type(condensed_checker), allocatable, private :: condensed
    type(modal_floquet), private :: modes
    logical, private :: modal = .false., counted = .false.
  contains
    procedure :: check
    procedure :: follow
    procedure :: grows_alike
    procedure :: stays
    procedure, private :: by_condensed
    procedure, private :: by_floquet
    procedure, private :: by_hill
    procedure, private :: by_pieces
    procedure, private :: by_roots
    procedure, private :: keep_roots
  end type stability_checker

contains

  !> Largest number of exponents of a solution.
  integer function stability_slots(system)
    class(oscillator_type), intent(in) :: system
    stability_slots = 2*system%n_dof() &
                      + merge(more, 0, any(system%kernel_of > 0) .or. system%moving)
    select type (system)
    class is (structure_type)
      stability_slots = 2*system%n_dof() + more
      if (states_of_modes(system) > 0 .and. .not. counts_first(system)) then
        stability_slots = states_of_modes(system)
      end if
    end select
  end function stability_slots

  !> True if counting exponents is faster than integrating the modes of a structure: with one
  !! deflection, without rigid modes and without kinks.
  logical function counts_first(system)
    class(structure_type), intent(in) :: system
    counts_first = system%rest%n_modes > quick_modes .and. system%n_dof() == 1 &
                   .and. .not. has_kinks(system)
    if (.not. counts_first) return
    associate (squares => system%rest%squares(:system%rest%n_modes))
      counts_first = minval(abs(squares)) > rigid*maxval(abs(squares))
    end associate
  end function counts_first

  !> For solutions with the harmonics of `set`.
  subroutine new_stability_checker(checker, system, set)
    type(stability_checker), intent(out) :: checker
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set

    ! Where masses depend on the motion too.
    checker%remembers = any(system%kernel_of > 0) .or. system%moving
    checker%half_wave = set%half_wave
    checker%n_slots = stability_slots(system)
    checker%kinked = is_kinked(system)
    checker%jumps = may_jump(system)
    checker%set = set
    checker%complete = .not. checker%remembers
    select type (system)
    class is (structure_type)
      allocate (checker%condensed)
      call new_condensed_checker(checker%condensed, system, set)
      checker%modal = states_of_modes(system) > 0 .and. .not. checker%jumps
      checker%kinked = checker%kinked .and. .not. checker%modal
      checker%counted = checker%modal .and. counts_first(system)
      checker%complete = states_of_modes(system) == checker%n_slots
      if (checker%modal) call new_modal_floquet(checker%modes, system, set)
      return
    end select
    if (checker%remembers) then
      call new_hill(checker%hill, system, set)
    else
      call new_floquet(checker%floquet, system, set)
    end if
  end subroutine new_stability_checker

  recursive subroutine check(self, system, nu, x, stability, cancel, near)
    class(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    !> Frequencies (rad/s), shape (n).
    real(wp), intent(in) :: nu(:)
    !> Harmonics, shape (2 n_orders, n_dof, n); NaN: no solution, stability unknown.
    real(wp), intent(in) :: x(:, :, :)
    type(stability_type), intent(out) :: stability
    !> May be set from elsewhere to give up.
    integer, intent(inout), optional :: cancel
    !> Exponents of a neighbour of the first solution, NaN for none; with memory they speed
    !! the search up.
    complex(wp), intent(in), optional :: near(:)
    logical :: jumps(size(nu))

    if (system%depends_on_speed()) then
      call check_at_speeds(self, system, nu, x, stability, cancel, near)
      return
    end if
    allocate (stability%stable(size(nu)), stability%n_growing(size(nu)), source=-1)
    allocate (stability%slowest(size(nu)), source=self%complete)
    allocate (stability%exponents(self%n_slots, size(nu)), &
              stability%multipliers(self%n_slots, size(nu)), source=not_a_number())
    jumps = .false.
    if (self%kinked) call self%by_pieces(system, nu, x, stability, jumps, cancel)
    if (self%jumps .and. .not. self%kinked) call find_jumping(self, system, nu, x, jumps)
    if (self%counted) call self%by_condensed(system, nu, x, stability, jumps, .true., cancel)
    if (self%modal) call self%by_floquet(system, nu, x, stability, jumps, cancel)
    if (allocated(self%condensed)) then
      call self%by_condensed(system, nu, x, stability, jumps, .false., cancel)
    else if (self%remembers) then
      call self%by_hill(system, nu, x, stability, jumps, cancel, near)
    else
      call self%by_floquet(system, nu, x, stability, jumps, cancel)
    end if
    where (jumps) stability%slowest = stability%n_growing >= 0
    where (stability%n_growing >= 0) stability%stable = merge(1, 0, stability%n_growing == 0)
  end subroutine check

  !> Each solution for the system at its speed, the frequency.
  recursive subroutine check_at_speeds(checker, system, nu, x, stability, cancel, near)
    type(stability_checker), intent(inout) :: checker
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu(:), x(:, :, :)
    type(stability_type), intent(out) :: stability
    integer, intent(inout), optional :: cancel
    complex(wp), intent(in), optional :: near(:)
    type(stability_type) :: one
    class(oscillator_type), allocatable :: turned
    complex(wp) :: nearby(checker%n_slots)
    real(wp), allocatable :: motion(:, :)
    integer :: i

    allocate (stability%stable(size(nu)), stability%n_growing(size(nu)), source=-1)
    allocate (stability%slowest(size(nu)), source=.false.)
    allocate (stability%exponents(checker%n_slots, size(nu)), &
              stability%multipliers(checker%n_slots, size(nu)), source=not_a_number())
    nearby = not_a_number()
    if (present(near)) nearby = near
    do i = 1, size(nu)
      if (given_up(cancel)) return
      call turn(checker, system, nu(i), x(:, :, i), turned, motion)
      call checker%check(turned, nu(i:i), reshape(motion, [shape(motion), 1]), one, cancel, nearby)
      stability%stable(i) = one%stable(1)
      stability%n_growing(i) = one%n_growing(1)
      stability%slowest(i) = one%slowest(1)
      stability%exponents(:, i) = one%exponents(:, 1)
      stability%multipliers(:, i) = one%multipliers(:, 1)
      nearby = one%exponents(:, 1)
    end do
  end subroutine check_at_speeds

  !> The system at a speed (rad/s), its checker, and the motion in its coordinates.
  subroutine turn(checker, system, speed, x, turned, motion)
    type(stability_checker), intent(inout) :: checker
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: speed, x(:, :)
    class(oscillator_type), allocatable, intent(out) :: turned
    real(wp), allocatable, intent(out) :: motion(:, :)
    type(harmonic_set_type) :: set
    integer, allocatable :: kept(:)
    integer :: i, slots

    set = checker%set
    slots = checker%n_slots
    call turn_system(system, speed, is_kinked(system), turned, kept)
    allocate (motion(size(x, 1), size(kept)))
    do i = 1, size(kept)
      motion(:, i) = x(:, kept(i))
    end do
    call new_stability_checker(checker, turned, set)
    checker%n_slots = slots
  end subroutine turn

  !> Motions on whose way a law jumps.
  subroutine find_jumping(self, system, nu, x, jumps)
    class(stability_checker), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu(:), x(:, :, :)
    logical, intent(out) :: jumps(:)
    type(jump_map), allocatable :: maps(:)
    integer :: i
    logical :: known

    jumps = .false.
    do i = 1, size(nu)
      if (ieee_is_nan(x(1, 1, i))) cycle
      call find_jumps(system, self%set, x(:, :, i), self%set%orders*nu(i), maps, known)
      jumps(i) = size(maps) > 0
    end do
  end subroutine find_jumping

  !> One exponent (1/s) near that of a neighbour.
  recursive subroutine follow(self, system, nu, x, near, exponent, made)
    class(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu, x(:, :)
    complex(wp), intent(in) :: near
    complex(wp), intent(out) :: exponent
    logical, intent(out) :: made
    class(oscillator_type), allocatable :: turned
    real(wp), allocatable :: motion(:, :)

    if (system%depends_on_speed()) then
      call turn(self, system, nu, x, turned, motion)
      call self%follow(turned, nu, motion, near, exponent, made)
      return
    end if
    if (allocated(self%condensed)) then
      made = .false.
      select type (system)
      class is (structure_type)
        call self%condensed%follow(system, nu, x, near, exponent, made)
      end select
    else
      call self%hill%along(system, nu, x)
      call follow_exponent(self%hill, system, near, exponent, made)
    end if
    ! Conjugates are exponents too; what is found is one of the two.
    if (made) then
      if (abs(conjg(exponent) - near) < abs(exponent - near)) exponent = conjg(exponent)
    end if
  end subroutine follow

  !> True if it is certain, by a count alone, that as many perturbations of a solution grow as of
  !! its neighbour, and an odd or even number of them with its period: exponents are not sought.
  recursive logical function grows_alike(self, system, nu, x, near, n_growing, n_above_one)
    class(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu, x(:, :)
    !> Exponents of the neighbour (1/s), NaN for none.
    complex(wp), intent(in) :: near(:)
    !> Of the neighbour: those that grow, and those of them with a real multiplier above 1.
    integer, intent(in) :: n_growing, n_above_one
    class(oscillator_type), allocatable :: turned
    real(wp), allocatable :: motion(:, :)
    type(hill_path_type) :: path
    integer :: counted

    if (system%depends_on_speed()) then
      call turn(self, system, nu, x, turned, motion)
      grows_alike = self%grows_alike(turned, nu, motion, near, n_growing, n_above_one)
      return
    end if
    grows_alike = .false.
    if (self%kinked .or. self%jumps) return
    if (allocated(self%roots)) then
      grows_alike = n_growing == self%n_growing_roots
      return
    end if
    if (allocated(self%condensed)) then
      if (n_growing > 0 .or. (self%modal .and. .not. self%counted)) return
      select type (system)
      class is (structure_type)
        grows_alike = self%condensed%none_grows(system, nu, x)
      end select
    else if (self%remembers) then
      ! The determinant at 0 is real, and 1 far right.
      if (n_growing > 0 .and. system%kernel_without_integral() /= 0) return
      call self%hill%along(system, nu, x)
      call new_hill_path(path, self%hill, system, 0.0_wp, self%hill%n_dof + 2)
      call count_right(self%hill, system, near, path, counted)
      grows_alike = counted == n_growing
      if (.not. grows_alike .or. n_growing == 0) return
      grows_alike = modulo(n_above_one, 2) == merge(1, 0, real(path%value(1)) < 0.0_wp)
    end if
  end function grows_alike

  !> True if it is certain by first-order changes that as many perturbations grow of solutions very
  !! near one as do of itself, and an odd or even number of them with its period, since no exponent
  !! comes near the axis.
  logical function stays(self, system, nu, x, others, exponents, n_growing, reach)
    class(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu, x(:, :)
    !> Shape (2 n_orders, n_dof, n).
    real(wp), intent(in) :: others(:, :, :)
    !> Of the solution (1/s), NaN for none, and how many grow.
    complex(wp), intent(in) :: exponents(:)
    integer, intent(in) :: n_growing
    !> Exponents further from the axis are not looked at (1/s).
    real(wp), intent(in) :: reach

    stays = .false.
    if (self%kinked .or. self%jumps .or. .not. allocated(self%condensed)) return
    if (self%modal .and. .not. self%counted) return
    select type (system)
    class is (structure_type)
      stays = self%condensed%stays(system, nu, x, others, exponents, n_growing, reach)
    end select
  end function stays

  !> By the argument principle on the determinant of the elements.
  subroutine by_condensed(self, system, nu, x, stability, jumps, decaying, cancel)
    class(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu(:), x(:, :, :)
    type(stability_type), intent(inout) :: stability
    !> Motions that are left alone.
    logical, intent(in) :: jumps(:)
    !> Count left of the slowest exponents.
    logical, intent(in) :: decaying
    integer, intent(inout), optional :: cancel
    integer :: i, n

    select type (system)
    class is (structure_type)
      do i = 1, size(nu)
        if (given_up(cancel)) return
        if (ieee_is_nan(x(1, 1, i)) .or. stability%n_growing(i) >= 0 .or. jumps(i)) cycle
        ! A system at the speed of its load may have more slots.
        n = min(self%n_slots, stability_slots(system))
        associate (exponents => stability%exponents(:n, i))
          call self%condensed%check(system, nu(i), x(:, :, i), decaying, exponents, &
                                    stability%n_growing(i), stability%slowest(i))
          stability%multipliers(:n, i) = multiplier(nu(i), exponents)
        end associate
      end do
    end select
  end subroutine by_condensed

  !> Of motions with kinked laws and states; those that it cannot checker stay unknown here.
  subroutine by_pieces(self, system, nu, x, stability, jumps, cancel)
    class(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu(:), x(:, :, :)
    type(stability_type), intent(inout) :: stability
    !> Motions on whose way a law jumps.
    logical, intent(inout) :: jumps(:)
    integer, intent(inout), optional :: cancel
    complex(wp), allocatable :: roots(:)
    integer :: i, n
    logical :: found

    do i = 1, size(nu)
      if (given_up(cancel)) return
      if (ieee_is_nan(x(1, 1, i))) cycle
      call kinked_multipliers(system, self%set, nu(i), x(:, :, i), roots, found, jumps(i))
      if (.not. found) cycle
      n = min(size(roots), self%n_slots)
      stability%exponents(:n, i) = merge(1.0_wp, 0.5_wp, self%half_wave)*nu(i)/pi &
                                   *logarithm(roots(:n))
      if (self%half_wave) roots = roots**2
      stability%multipliers(:n, i) = roots(:n)
      stability%n_growing(i) = count(abs(roots) > 1.0_wp + circle)
      ! The sum of harmonics gives rates to a few digits only if a law jumps.
      if (jumps(i) .and. any(abs(abs(roots) - 1.0_wp) < jumping_circle)) stability%n_growing(i) = -1
      stability%slowest(i) = .true.
    end do
  end subroutine by_pieces

  !> exp(2 pi/nu lambda); NaN if it leaves the range of numbers, and if lambda (1/s) is not known.
  elemental complex(wp) function multiplier(nu, exponent)
    real(wp), intent(in) :: nu
    complex(wp), intent(in) :: exponent
    multiplier = not_a_number()
    if (ieee_is_nan(real(exponent))) return
    if (real(exponent) > largest_log*nu/(2.0_wp*pi)) return
    multiplier = exp(2.0_wp*pi/nu*exponent)
  end function multiplier

  !> Eigenvalues of monodromy matrices, of half a period under half-wave symmetry.
  subroutine by_floquet(self, system, nu, x, stability, jumps, cancel)
    class(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu(:), x(:, :, :)
    type(stability_type), intent(inout) :: stability
    !> Motions that are left alone.
    logical, intent(in) :: jumps(:)
    integer, intent(inout), optional :: cancel
    real(wp), allocatable :: matrices(:, :, :)
    complex(wp), allocatable :: roots(:), logs(:)
    integer, allocatable :: known(:)
    integer :: first, i, k, n, m
    logical :: found

    m = merge(self%modes%n_states, self%floquet%n_states(), self%modal)
    allocate (matrices(m, m, n_lanes), roots(m), logs(m))
    known = pack([(i, i=1, size(nu))], stability%n_growing < 0 .and. &
                 .not. (jumps .or. ieee_is_nan(x(1, 1, :))))
    do first = 1, size(known), n_lanes
      n = min(n_lanes, size(known) - first + 1)
      associate (these => known(first:first + n - 1))
        call monodromies(self, system, nu(these), x(:, :, these), matrices(:, :, :n), cancel)
      end associate
      if (given_up(cancel)) return
      do k = 1, n
        i = known(first + k - 1)
        found = .not. ieee_is_nan(matrices(1, 1, k))
        if (found) call eigenvalues(matrices(:, :, k), roots, found)
        ! Those that results contain must be accurate.
        if (found) found = distinguished(roots(:min(m, 2*size(x, 2) + more)))
        if (found) then
          logs = logarithm(roots)
        else
          call logs_of_product(self, system, nu(i), x(:, :, i), logs, found, cancel)
          if (.not. found) cycle
          roots = exp(logs)
        end if
        ! The largest of them.
        associate (kept => min(m, self%n_slots))
          stability%exponents(:kept, i) = merge(1.0_wp, 0.5_wp, self%half_wave)*nu(i)/pi &
                                          *logs(:kept)
          if (self%half_wave) roots = roots**2
          stability%multipliers(:kept, i) = roots(:kept)
        end associate
        stability%n_growing(i) = count(abs(roots) > 1.0_wp + circle)
        stability%slowest(i) = .true.
      end do
    end do
  end subroutine by_floquet

  !> Monodromy matrices; NaN where they are not found.
  subroutine monodromies(self, system, nu, x, matrices, cancel)
    type(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu(:), x(:, :, :)
    real(wp), intent(out) :: matrices(:, :, :)
    integer, intent(inout), optional :: cancel
    integer :: i
    logical :: found

    if (.not. self%modal) then
      call self%floquet%monodromies(system, nu, x, matrices, cancel)
      return
    end if
    select type (system)
    class is (structure_type)
      do i = 1, size(nu)
        call self%modes%monodromy(system, nu(i), x(:, :, i), matrices(:, :, i), found, cancel)
        if (.not. found) matrices(:, :, i) = real(not_a_number())
      end do
    end select
  end subroutine monodromies

  !> Logarithms of the same eigenvalues where those of the matrix are lost in the rounding error of
  !! its largest.
  subroutine logs_of_product(self, system, nu, x, logs, found, cancel)
    class(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu, x(:, :)
    complex(wp), intent(out) :: logs(:)
    logical, intent(out) :: found
    integer, intent(inout), optional :: cancel
    type(product_type) :: product
    real(wp) :: last(size(logs), size(logs))

    logs = not_a_number()
    found = .false.
    if (self%modal) then
      select type (system)
      class is (structure_type)
        call self%modes%monodromy(system, nu, x, last, found, cancel, product)
      end select
    else
      call self%floquet%factors(system, nu, x, product, found, cancel)
    end if
    if (found) call product_eigenvalues(product, logs, found)
    if (found) found = maxval(real(logs)) <= merge(0.5_wp, 1.0_wp, self%half_wave)*largest_log
    if (.not. (found .and. self%half_wave)) return
    ! The sign of the matrix.
    logs = cmplx(real(logs), aimag(logs) - sign(pi, aimag(logs)), wp)
  end subroutine logs_of_product

  !> Exponents right of a line are counted by the argument principle and must all be found.
  subroutine by_hill(self, system, nu, x, stability, jumps, cancel, nearby)
    class(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu(:), x(:, :, :)
    type(stability_type), intent(inout) :: stability
    !> Motions that are left alone.
    logical, intent(in) :: jumps(:)
    integer, intent(inout), optional :: cancel
    complex(wp), intent(in), optional :: nearby(:)
    complex(wp), dimension(self%n_slots) :: near, change, ahead
    real(wp) :: last, step, part, period
    integer :: i

    near = not_a_number()
    if (present(nearby)) near = nearby
    change = (0.0_wp, 0.0_wp)
    last = -1.0_wp
    step = 0.0_wp
    period = -1.0_wp
    do i = 1, size(nu)
      if (given_up(cancel)) return
      if (ieee_is_nan(x(1, 1, i)) .or. stability%n_growing(i) >= 0 .or. jumps(i)) cycle
      if (allocated(self%roots)) then
        call self%by_roots(nu(i), i, stability)
        cycle
      end if
      ! Along straight lines, but not after turns and long steps.
      part = 0.0_wp
      if (abs(step) > 0.0_wp) part = (nu(i) - last)/step
      ahead = near
      if (part > 0.0_wp .and. part < longest_step) ahead = near + part*change
      call self%hill%along(system, nu(i), x(:, :, i))
      ! Those at i d/2 stay there.
      where (abs(aimag(near) - 0.5_wp*period) <= 0.0_wp)
        ahead = cmplx(real(ahead), 0.5_wp*self%hill%period, wp)
      end where
      associate (exponents => stability%exponents(:, i))
        call check_by_hill(self%hill, system, into_strip(ahead, near, self%hill%period), &
                           exponents, stability%n_growing(i), stability%slowest(i))
        change = (0.0_wp, 0.0_wp)
        if (last > 0.0_wp) then
          call find_changes(near, period, ahead, exponents, self%hill%period, change)
          step = nu(i) - last
        end if
        near = exponents
        period = self%hill%period
        last = nu(i)
        ! Exponents that are not those counted are not reported, and then none is the slowest.
        if (n_right_of(0.0_wp, exponents) /= stability%n_growing(i)) then
          exponents = not_a_number()
          stability%slowest(i) = .false.
        end if
        stability%multipliers(:, i) = multiplier(nu(i), exponents)
      end associate
      if (system%is_linear() .and. .not. system%moving) call self%keep_roots(system, i, stability)
    end do
  end subroutine by_hill

  !> Keep the roots of a linear system that are known from the i-th solution, if all of its
  !! exponents belong to one order each.
  subroutine keep_roots(self, system, i, stability)
    class(stability_checker), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: i
    type(stability_type), intent(in) :: stability
    complex(wp) :: roots(self%n_slots)
    integer :: k

    associate (exponents => stability%exponents(:, i))
      if (stability%n_growing(i) < 0 .or. ieee_is_nan(real(exponents(1)))) return
      roots = exponents
      do k = 1, size(roots)
        if (ieee_is_nan(real(exponents(k)))) exit
        call self%hill%root_of(system, exponents(k), roots(k))
        if (ieee_is_nan(real(roots(k)))) return
      end do
    end associate
    self%roots = roots
    self%n_growing_roots = stability%n_growing(i)
    self%slowest_root = stability%slowest(i)
  end subroutine keep_roots

  !> Exponents of the i-th solution of a linear system: roots, modulo i d; under half-wave symmetry
  !! orders are odd.
  subroutine by_roots(self, nu, i, stability)
    class(stability_checker), intent(in) :: self
    real(wp), intent(in) :: nu
    integer, intent(in) :: i
    type(stability_type), intent(inout) :: stability
    real(wp) :: period, place(self%n_slots)

    period = merge(2.0_wp, 1.0_wp, self%half_wave)*nu
    place = aimag(self%roots) - merge(nu, 0.0_wp, self%half_wave)
    place = place - period*ceiling(place/period - 0.5_wp)
    stability%exponents(:, i) = cmplx(real(self%roots), place, wp)
    stability%multipliers(:, i) = multiplier(nu, stability%exponents(:, i))
    stability%n_growing(i) = self%n_growing_roots
    stability%slowest(i) = self%slowest_root
  end subroutine by_roots

  !> Into |Im lambda| <= d/2, above the real axis or below it as the exponent was nearby.
  elemental complex(wp) function into_strip(exponent, nearby, period) result(place)
    complex(wp), intent(in) :: exponent, nearby
    real(wp), intent(in) :: period
    real(wp) :: y

    place = exponent
    if (ieee_is_nan(real(exponent))) return
    y = abs(aimag(exponent) - period*anint(aimag(exponent)/period))
    place = cmplx(real(exponent), merge(y, -y, aimag(nearby) >= 0.0_wp), wp)
  end function into_strip

  !> By how much exponents have changed since the solution before; 0 where that is not certain.
  pure subroutine find_changes(before, period_before, ahead, now, period, change)
    !> Those before, where they were expected now, and those now (1/s), NaN for none; both
    !! modulo i times their period.
    complex(wp), intent(in) :: before(:), ahead(:), now(:)
    real(wp), intent(in) :: period_before, period
    complex(wp), intent(out) :: change(:)
    complex(wp) :: image, nearest
    real(wp) :: distance
    integer :: i, j, m

    change = (0.0_wp, 0.0_wp)
    do i = 1, size(now)
      if (ieee_is_nan(real(now(i)))) cycle
      distance = huge(distance)
      do j = 1, size(before)
        if (ieee_is_nan(real(before(j)))) cycle
        ! An exponent that leaves the strip |Im lambda| <= d/2 enters it on the other side.
        do m = -1, 1
          image = ahead(j) + cmplx(0.0_wp, m*period, wp)
          if (abs(now(i) - image) >= distance) cycle
          distance = abs(now(i) - image)
          nearest = image
          change(i) = now(i) - before(j) - cmplx(0.0_wp, m*period_before, wp)
        end do
      end do
      ! Not where another is as near to the former one.
      if (.not. distance < huge(distance)) cycle
      if (any(distance_of(now, nearest) < distance)) change(i) = (0.0_wp, 0.0_wp)
    end do
  end subroutine find_changes

  !> Distances of exponents from one; huge for what is no number.
  pure elemental real(wp) function distance_of(one, other)
    complex(wp), intent(in) :: one, other
    distance_of = huge(1.0_wp)
    if (.not. ieee_is_nan(real(one))) distance_of = abs(one - other)
  end function distance_of

  !> One solution, that of `hill`.
  subroutine check_by_hill(hill, system, near, exponents, n_growing, slowest)
    type(hill_type), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    !> Exponents of a neighbour, NaN for none.
    complex(wp), intent(in) :: near(:)
    complex(wp), intent(out) :: exponents(:)
    integer, intent(out) :: n_growing
    logical, intent(out) :: slowest
    type(hill_path_type) :: path
    real(wp) :: line
    integer :: counted

    ! Left of where the slowest exponent was: one line for both questions.
    line = line_beyond(near, hill, wide)
    call hill%count_from(line)
    call new_hill_path(path, hill, system, line, hill%n_dof + 2)
    call find_exponents(hill, system, path, near, exponents)
    call count_right(hill, system, exponents, path, counted)
    if (counted /= n_right_of(line, exponents)) then
      call find_more(hill, system, path, exponents)
      call count_right(hill, system, exponents, path, counted)
    end if
    if (line < 0.0_wp) then
      slowest = counted > 0 .and. counted == n_right_of(line, exponents)
      n_growing = n_right_of(0.0_wp, exponents)
      if (on_the_axis(hill, exponents)) n_growing = -1
      if (slowest) return
      call hill%count_from(0.0_wp)
      call new_hill_path(path, hill, system, 0.0_wp, hill%n_dof + 2)
      call count_right(hill, system, exponents, path, counted)
    end if
    n_growing = counted
    call complete(hill, system, path, n_growing, exponents)
    ! More found than counted: one of the two is wrong.
    if (n_right_of(0.0_wp, exponents) > n_growing) n_growing = -1
    slowest = n_growing > 0
    if (n_growing /= 0) return
    line = line_beyond(exponents, hill, narrow)
    if (.not. line < 0.0_wp) return
    call hill%count_from(line)
    call new_hill_path(path, hill, system, line, hill%n_dof + 2)
    call count_right(hill, system, exponents, path, counted)
    call complete(hill, system, path, counted, exponents)
    slowest = counted > 0 .and. counted == n_right_of(line, exponents)
    call hill%count_from(0.0_wp)
  end subroutine check_by_hill

  !> A line left of the axis so that the slowest of the exponents is counted and memory does not
  !! fade more slowly (1/s); 0: nowhere, or not needed.
  pure real(wp) function line_beyond(exponents, hill, part) result(line)
    complex(wp), intent(in) :: exponents(:)
    type(hill_type), intent(in) :: hill
    !> Of the slowest exponent, and of d: how far beyond.
    real(wp), intent(in) :: part(2)
    real(wp) :: slowest

    line = 0.0_wp
    if (all(ieee_is_nan(real(exponents)))) return
    slowest = -maxval(merge(-huge(1.0_wp), real(exponents), ieee_is_nan(real(exponents))))
    if (slowest <= 0.0_wp .or. slowest > -leftmost*hill%period) return
    if (.not. hill%fading - slowest > least_size*hill%period) return
    line = -slowest - min(part(1)*slowest + part(2)*hill%period, 0.5_wp*(hill%fading - slowest))
  end function line_beyond

  pure logical function on_the_axis(hill, exponents)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: exponents(:)
    on_the_axis = any(abs(merge(huge(1.0_wp), real(exponents), ieee_is_nan(real(exponents)))) &
                      <= on_axis*hill%period)
  end function on_the_axis

  !> How many exponents lie right of a line.
  pure integer function n_right_of(line, exponents)
    real(wp), intent(in) :: line
    complex(wp), intent(in) :: exponents(:)
    n_right_of = count(merge(-huge(1.0_wp), real(exponents), ieee_is_nan(real(exponents))) > line)
  end function n_right_of

  elemental complex(wp) function not_a_number()
    not_a_number = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
  end function not_a_number

end module viscovib_motion_stability
