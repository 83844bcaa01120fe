! Optimize: -O2
!> Stability of motions of a condensed structure: exponents, and the count that judges them.
module viscovib_condensed_stability
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_condensed_hill, only: condensed_hill, new_condensed_hill
  use viscovib_condensed_roots, only: condensed_zeros, new_zeros
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_hill_count, only: count_right
  use viscovib_hill_path, only: hill_path_type, new_hill_path
  use viscovib_hill_roots, only: complete, find_near, twin
  use viscovib_hill_secant, only: follow_exponent
  use viscovib_kinds, only: wp
  use viscovib_cycle_terms, only: has_states
  use viscovib_sorting, only: sort_falling
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: condensed_checker, new_condensed_checker

  !> Error of exponents that only a count uses, of their distance from the line.
  real(wp), parameter :: rough = 1.0e-2_wp
  !> Pieces of the line at first, and those more for zeros not known, at most.
  integer, parameter :: few_pieces = 2, more_pieces = 24

  type :: condensed_checker
    type(condensed_hill), private :: hill
    !> Zeros of the motion checked last, and those of them that belong to no
    !! pole but to memory.
    type(condensed_zeros), private :: zeros
    complex(wp), allocatable, private :: own(:)
  contains
    procedure :: check
    procedure :: follow
    procedure :: none_grows
    procedure :: stays
  end type condensed_checker

contains

  subroutine new_condensed_checker(self, system, set)
    type(condensed_checker), intent(out) :: self
    class(structure_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    call new_condensed_hill(self%hill, system, set)
    call new_zeros(self%zeros, self%hill)
    allocate (self%own(0))
  end subroutine new_condensed_checker

  !> One motion.
  subroutine check(self, system, nu, x, decaying, exponents, n_growing, slowest)
    class(condensed_checker), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu
    !> Harmonics, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Count left of the slowest exponents, as many as may be kept, else those that grow.
    logical, intent(in) :: decaying
    !> Largest real part first, NaN behind the last; those that grow are complete, or all are NaN.
    complex(wp), intent(out) :: exponents(:)
    !> -1: unknown.
    integer, intent(out) :: n_growing
    !> Whether none decays more slowly than the first exponent.
    logical, intent(out) :: slowest
    type(hill_path_type) :: path
    complex(wp), allocatable :: all(:), known(:)
    real(wp) :: axis, line, fastest
    integer :: counted, n, wanted

    exponents = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
    n_growing = -1
    slowest = .false.
    ! How elements with states answer a disturbance is not in the determinant.
    if (has_states(system)) return
    call self%hill%along(system, nu, x, decaying)
    if (.not. self%hill%ready) return
    wanted = size(exponents)
    associate (hill => self%hill, poles => self%hill%poles)
      axis = hill%line
      call self%zeros%approximate(hill, system)
      if (decaying) then
        call self%zeros%line_beyond(hill, size(exponents), line, fastest, wanted)
        if (wanted == 0) return
        call hill%count_from(system, line, fastest)
        if (.not. hill%ready) return
      end if
      call self%zeros%doubt(hill, system)
      call self%zeros%sharpen(hill, system, wanted, 0.0_wp)
      call find_own(self, system)
      call count_zeros(self, system, path, counted)
      if (counted < 0) return
      ! Certain also where not all exponents are found.
      if (.not. decaying) n_growing = counted
      if (self%zeros%n_right(hill) + poles%n_growing < counted .and. .not. decaying) then
        call self%zeros%sharpen(hill, system, huge(1), 0.0_wp)
        call known_zeros(self, counted, known)
        call complete(hill, system, path, counted - poles%n_growing, known)
        call self%zeros%take_known(hill, known)
      end if
      if (hill%remembers) self%own = self%zeros%without_pole()
      all = [self%zeros%all_of(hill, .true., 0), poles%exponents]
      if (count(real(all) > hill%line) /= counted) return
    end associate
    call sort_falling(all, real(all))
    n = min(size(all), size(exponents))
    if (count(real(all) > axis) > n) return
    n_growing = count(real(all) > axis)
    exponents(:n) = all(:n)
    slowest = n_growing > 0 .or. decaying
  end subroutine check

  !> True if it is certain that no disturbance of a motion grows. Only exponents that may be near
  !! the axis are sought.
  logical function none_grows(self, system, nu, x)
    class(condensed_checker), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu, x(:, :)
    type(hill_path_type) :: path
    integer :: counted

    none_grows = .false.
    if (has_states(system)) return
    call self%hill%along(system, nu, x, .false.)
    if (.not. self%hill%ready) return
    call self%zeros%approximate(self%hill, system)
    call self%zeros%doubt(self%hill, system)
    call self%zeros%sharpen(self%hill, system, 0, rough)
    call find_own(self, system)
    call count_zeros(self, system, path, counted)
    none_grows = counted == 0
  end function none_grows

  !> Exponents that belonged to no pole at a motion nearby.
  subroutine find_own(self, system)
    class(condensed_checker), intent(inout) :: self
    class(structure_type), intent(in) :: system
    complex(wp), allocatable :: known(:)
    integer :: i

    if (size(self%own) == 0) return
    allocate (known, source=self%zeros%all_of(self%hill, .true., 0))
    ! Some belong to a pole now.
    self%own = pack(self%own, [(.not. any(abs(known - self%own(i)) < twin*self%hill%period), &
                                i=1, size(self%own))])
    call known_zeros(self, 2*size(self%own), known)
    call find_near(self%hill, system, self%own, known)
    call self%zeros%take_known(self%hill, known)
  end subroutine find_own

  !> Zeros that are sharp, and NaN for more.
  subroutine known_zeros(self, more, known)
    class(condensed_checker), intent(in) :: self
    integer, intent(in) :: more
    complex(wp), allocatable, intent(out) :: known(:)

    known = self%zeros%all_of(self%hill, .true., 0)
    known = [known, spread(cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp), 1, more + 1)]
  end subroutine known_zeros

  !> Exponents right of the line; -1: unknown.
  subroutine count_zeros(self, system, path, counted)
    class(condensed_checker), intent(inout) :: self
    class(structure_type), intent(in) :: system
    type(hill_path_type), intent(out) :: path
    integer, intent(out) :: counted
    complex(wp), allocatable :: zeros(:)

    allocate (zeros, source=self%zeros%all_of(self%hill, .false., 0))
    associate (hill => self%hill)
      call new_hill_path(path, hill, system, hill%line, few_pieces &
                         + max(0, min(hill%n_without_memory - size(zeros), more_pieces)))
      call count_right(hill, system, zeros, path, counted)
    end associate
  end subroutine count_zeros

  !> True if it is certain by first-order changes that as many disturbances grow at motions very
  !! near one as do there. Memory has exponents of its own, which a count alone sees.
  logical function stays(self, system, nu, x, others, exponents, n_growing, reach)
    class(condensed_checker), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu, x(:, :)
    !> Shape (2 n_orders, n_dof, n).
    real(wp), intent(in) :: others(:, :, :)
    !> Known of the motion, NaN for none, and how many grow.
    complex(wp), intent(in) :: exponents(:)
    integer, intent(in) :: n_growing
    !> Exponents further from the axis are not looked at (1/s).
    real(wp), intent(in) :: reach

    stays = .false.
    if (has_states(system) .or. self%hill%remembers) return
    call self%hill%along(system, nu, x, .false.)
    if (.not. self%hill%ready) return
    call self%zeros%approximate(self%hill, system)
    call self%zeros%take_known(self%hill, exponents)
    stays = self%zeros%stay(self%hill, system, n_growing, reach, others)
  end function stays

  !> One exponent of a motion from the place it had at a motion nearby.
  subroutine follow(self, system, nu, x, start, exponent, made)
    class(condensed_checker), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu, x(:, :)
    complex(wp), intent(in) :: start
    complex(wp), intent(out) :: exponent
    logical, intent(out) :: made
    call self%hill%along(system, nu, x, .false.)
    call follow_exponent(self%hill, system, start, exponent, made)
  end subroutine follow

end module viscovib_condensed_stability
