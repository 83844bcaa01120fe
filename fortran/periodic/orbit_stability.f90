!> Stability along a branch of periodic motions of a driven system, and its bifurcations.
module viscovib_orbit_stability
  use viscovib_crossing_nodes, only: spectrum_type
  use viscovib_crossing_search, only: crossing_type, find_changes
  use viscovib_curve, only: curve_type
  use viscovib_curve_events, only: special_points
  use viscovib_kinds, only: wp
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_multipliers, only: count_larger, logarithm
  use viscovib_stopping, only: is_set
  use viscovib_torus_balance, only: torus_balance_type
  implicit none
  private

  public :: check_orbits, find_orbit_crossings, orbit_spectrum

  !> Multipliers this close to the unit circle count as on it.
  real(wp), parameter, public :: orbit_circle = 1.0_wp + 1.0e-9_wp

  !> Logarithms of the multipliers.
  type, extends(spectrum_type) :: orbit_spectrum
    type(orbit_floquet_type), pointer :: floquet => null()
  contains
    procedure :: look
  end type orbit_spectrum

contains

  !> Multipliers of the solutions x of `balance`, which has one axis, at the parameters p.
  subroutine check_orbits(floquet, balance, p, x, multipliers, cancel)
    type(orbit_floquet_type), intent(inout) :: floquet
    type(torus_balance_type), intent(inout) :: balance
    !> Shapes (n) and (balance%n, n).
    real(wp), intent(in) :: p(:), x(:, :)
    !> Largest first, NaN if unknown, shape (2 n_dof, n).
    complex(wp), intent(out) :: multipliers(:, :)
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    logical :: inside
    integer :: i

    multipliers = (0.0_wp, 0.0_wp)
    do i = 1, size(p)
      if (is_set(cancel)) return
      call balance%visit(x(:, i), p(i), .true., inside)
      call floquet%multipliers(balance, x(:, i), multipliers(:, i))
    end do
  end subroutine check_orbits

  !> All changes between adjacent points with known multipliers. The motion at each is given in the
  !! unknowns of `balance`.
  subroutine find_orbit_crossings(floquet, balance, p, x, multipliers, folds, branch_points, &
                                  crossings, cancel)
    type(orbit_floquet_type), intent(inout), target :: floquet
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p(:), x(:, :)
    complex(wp), intent(in) :: multipliers(:, :)
    !> Points that the continuation has located.
    type(special_points), intent(in) :: folds, branch_points
    type(crossing_type), allocatable, intent(out) :: crossings(:)
    integer, intent(inout), optional :: cancel
    type(orbit_spectrum) :: spectrum
    integer :: i

    spectrum%floquet => floquet
    spectrum%n = size(multipliers, 1)
    spectrum%threshold = log(orbit_circle)
    call find_changes(balance, spectrum, p, x, logarithm(multipliers), &
                      [(count_larger(multipliers(:, i), orbit_circle), i=1, size(p))], folds, &
                      branch_points, crossings, cancel)
  end subroutine find_orbit_crossings

  subroutine look(self, curve, p, x, near, eta, n_growing)
    class(orbit_spectrum), intent(inout) :: self
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p, x(:)
    complex(wp), intent(in) :: near(:)
    complex(wp), intent(out) :: eta(:)
    integer, intent(out) :: n_growing
    complex(wp) :: multipliers(self%n, 1)

    eta = near
    n_growing = -1
    select type (curve)
    class is (torus_balance_type)
      call check_orbits(self%floquet, curve, [p], reshape(x, [size(x), 1]), multipliers)
      eta = logarithm(multipliers(:, 1))
      n_growing = count_larger(multipliers(:, 1), orbit_circle)
    end select
  end subroutine look

end module viscovib_orbit_stability
