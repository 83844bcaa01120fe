! Optimize: -O3
!> Norms of periodic solutions, and data that one solution passes to the next: the factors of its
!! derivatives.
module viscovib_motion_norm
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: largest_norm, newton_factors, share_of_motion, weighted_norm

  !> Factors of the derivatives in the last iteration, from `factorize`.
  type :: newton_factors
    real(wp), allocatable :: lu(:, :)
    integer, allocatable :: pivots(:)
    !> Relative size of the last correction if rounding kept it above the tolerance; else 0.
    real(wp) :: rounding = 0.0_wp
  end type newton_factors

  !> A smaller share of the absolute motion is rounding error of the base motion.
  real(wp), parameter :: least_share = epsilon(1.0_wp)

contains

  !> Largest value of sqrt(M_dd) (|Re X| + |Im X|), so that metres and radians are weighted by
  !! inertia.
  pure real(wp) function weighted_norm(system, x) result(norm)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(:, :)
    real(wp) :: poison, largest
    integer :: d, k
    norm = 0.0_wp
    poison = 0.0_wp
    do d = 1, size(x, 2)
      largest = 0.0_wp
      do k = 1, size(x, 1), 2
        largest = max(largest, abs(x(k, d)) + abs(x(k + 1, d)))
        poison = poison + 0.0_wp*(x(k, d) + x(k + 1, d))
      end do
      norm = max(norm, sqrt(system%mass(d, d))*largest)
    end do
    ! NaN may pass unseen through a maximum, but not through a sum.
    norm = norm + poison
  end function weighted_norm

  !> The norm of the largest amplitude: heavy masses make norms large, not amplitudes.
  pure real(wp) function largest_norm(system)
    class(oscillator_type), intent(in) :: system
    integer :: d
    largest_norm = system%largest_amplitude() &
                   *sqrt(max(1.0_wp, maxval([(system%mass(d, d), d=1, system%n_dof())])))
  end function largest_norm

  !> Norm of the absolute motion relative to that of x, the motion relative to the base; at most 1.
  !! Errors refer to the absolute motion, which may be small although the springs follow the base.
  real(wp) function share_of_motion(system, load, factor, orders, x) result(share)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Load factor.
    real(wp), intent(in) :: factor
    !> Orders of x, shape (2 n_orders, n_dof).
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: x(:, :)
    complex(wp), allocatable :: shift(:)
    real(wp), allocatable :: y(:, :)
    real(wp) :: relative
    integer :: i, j

    share = 1.0_wp
    ! For a structure, errors refer to its deflections.
    if (system%condensed .or. .not. load%moves_base()) return
    allocate (y, source=x)
    do j = 1, size(load%orders)
      i = findloc(orders, load%orders(j), 1)
      if (i == 0) cycle
      shift = factor*load%shift(system, j)
      y(2*i - 1, :) = y(2*i - 1, :) + real(shift)
      y(2*i, :) = y(2*i, :) + aimag(shift)
    end do
    relative = weighted_norm(system, x)
    if (relative > 0.0_wp) share = max(least_share, min(1.0_wp, weighted_norm(system, y)/relative))
  end function share_of_motion

end module viscovib_motion_norm
