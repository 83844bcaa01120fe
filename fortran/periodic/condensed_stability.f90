!> Stability of motions of a condensed structure: exponents, and the count that judges them.
module viscovib_condensed_stability
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_condensed_count, only: condensed_path, count_zeros, new_path
  use viscovib_condensed_hill, only: condensed_hill, new_condensed_hill
  use viscovib_condensed_roots, only: condensed_zeros, exponent_near, new_zeros
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_cycle_terms, only: has_states
  use viscovib_sorting, only: sort_falling
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: condensed_judge, new_condensed_judge

  type :: condensed_judge
    type(condensed_hill), private :: hill
    !> Zeros of the motion judged last.
    type(condensed_zeros), private :: zeros
  contains
    procedure :: judge
    procedure :: follow
  end type condensed_judge

contains

  subroutine new_condensed_judge(self, system, set)
    type(condensed_judge), intent(out) :: self
    class(structure_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    call new_condensed_hill(self%hill, system, set)
    call new_zeros(self%zeros, self%hill)
  end subroutine new_condensed_judge

  !> One motion.
  subroutine judge(self, system, nu, x, exponents, n_growing, slowest)
    class(condensed_judge), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu
    !> Harmonics, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Largest real part first, NaN behind the last; those that grow are complete, or all are NaN.
    complex(wp), intent(out) :: exponents(:)
    !> -1: unknown.
    integer, intent(out) :: n_growing
    !> Whether none decays more slowly than the first exponent.
    logical, intent(out) :: slowest
    type(condensed_path) :: path
    complex(wp), allocatable :: zeros(:), all(:)
    integer :: n

    exponents = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
    n_growing = -1
    slowest = .false.
    ! How elements with states answer a disturbance is not in the determinant.
    if (has_states(system)) return
    call self%hill%along(system, nu, x)
    if (.not. self%hill%ready) return
    associate (hill => self%hill, poles => self%hill%poles)
      call self%zeros%approximate(hill, system)
      call self%zeros%sharpen(hill, system, size(exponents))
      zeros = self%zeros%all_of(hill, .false., 0)
      call new_path(path, hill, system, size(zeros))
      call count_zeros(hill, system, zeros, path, n_growing)
      if (n_growing < 0) return
      if (self%zeros%n_right(hill) + poles%n_growing < n_growing) then
        call self%zeros%sharpen(hill, system, huge(1))
        call self%zeros%search(hill, system, n_growing - poles%n_growing)
      end if
      all = [self%zeros%all_of(hill, .true., 0), poles%exponents]
      if (count(real(all) > hill%line) /= n_growing) return
    end associate
    call sort_falling(all, real(all))
    n = min(size(all), size(exponents))
    if (n_growing > n) return
    exponents(:n) = all(:n)
    slowest = n_growing > 0
  end subroutine judge

  !> One exponent of a motion from the place it had at a motion nearby.
  subroutine follow(self, system, nu, x, start, exponent, made)
    class(condensed_judge), intent(inout) :: self
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: nu, x(:, :)
    complex(wp), intent(in) :: start
    complex(wp), intent(out) :: exponent
    logical, intent(out) :: made
    call self%hill%along(system, nu, x)
    call exponent_near(self%hill, system, start, exponent, made)
  end subroutine follow

end module viscovib_condensed_stability
