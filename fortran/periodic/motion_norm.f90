!> What one periodic solution leaves for the next: its size, and the factors of its
!! derivatives.
module viscovib_motion_norm
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: newton_factors, weighted_norm

  !> Factors of the derivatives in the last iteration, as `factorize` leaves them.
  type :: newton_factors
    real(wp), allocatable :: lu(:, :)
    integer, allocatable :: pivots(:)
    !> Relative size of the last correction where rounding kept it above the tolerance; else 0.
    real(wp) :: rounding = 0.0_wp
  end type newton_factors

contains

  !> Largest of sqrt(M_dd) (|Re X| + |Im X|), so that metres and radians weigh by
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
    ! What is not a number may pass unseen through a maximum, but not through a sum.
    norm = norm + poison
  end function weighted_norm

end module viscovib_motion_norm
