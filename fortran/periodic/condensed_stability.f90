! Optimize: -O2
!> Stability of motions of a condensed structure: exponents, and the count that judges them.
module viscovib_condensed_stability
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_condensed_hill, only: condensed_hill, new_condensed_hill
  use viscovib_condensed_roots, only: condensed_zeros, new_zeros
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_hill_count, only: count_right
  use viscovib_hill_path, only: hill_path_type, new_hill_path
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
  integer, parameter :: few_pieces = 4, more_pieces = 24

  type :: condensed_checker
    type(condensed_hill), private :: hill
    !> Zeros of the motion checked last.
    type(condensed_zeros), private :: zeros
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
    complex(wp), allocatable :: all(:)
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
      call count_zeros(self, system, counted)
      if (counted < 0) return
      ! Certain also where not all exponents are found.
      if (.not. decaying) n_growing = counted
      if (self%zeros%n_right(hill) + poles%n_growing < counted .and. .not. decaying) then
        call self%zeros%sharpen(hill, system, huge(1), 0.0_wp)
        call self%zeros%search(hill, system, counted - poles%n_growing)
      end if
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
    integer :: counted

    none_grows = .false.
    if (has_states(system)) return
    call self%hill%along(system, nu, x, .false.)
    if (.not. self%hill%ready) return
    call self%zeros%approximate(self%hill, system)
    call self%zeros%doubt(self%hill, system)
    call self%zeros%sharpen(self%hill, system, 0, rough)
    call count_zeros(self, system, counted)
    none_grows = counted == 0
  end function none_grows

  !> Exponents right of the line; -1: unknown.
  subroutine count_zeros(self, system, counted)
    class(condensed_checker), intent(inout) :: self
    class(structure_type), intent(in) :: system
    integer, intent(out) :: counted
    type(hill_path_type) :: path
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
