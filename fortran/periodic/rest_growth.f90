!> Rates of monotonic growth of a system with constant stiffness: real s > 0 at which its matrix,
!! such as s^2 M + s C + B [1 - R(s)] W, is singular.
!!
!! They exist if a kernel R has an integral above 1, or none: relaxed springs then push. For fast
!! memory the growth is fast, far above all frequencies of the load, where no other method computes
!! these exponents.
module viscovib_rest_growth
  use viscovib_dense, only: factorize
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_hill_determinant, only: hill_determinant
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: rates_from_rest

  !> Range of rates, relative to a frequency, and factor between two rates, larger for slow ones.
  real(wp), parameter :: slowest = 1.0e-12_wp, slow = 1.0e-3_wp, fastest = 1.0e5_wp
  real(wp), parameter :: ratio = 1.1_wp, ratio_of_slow = 10.0_wp
  !> Relative tolerance of rates.
  real(wp), parameter :: close_enough = 1.0e-9_wp
  !> Largest number of coordinates for which eigenvalues are cheap.
  integer, parameter :: most_by_eigenvalues = 8

contains

  !> Rates, ascending, including close ones: the number of negative eigenvalues changes by the
  !! number of rates between two values.
  subroutine rates_from_rest(hill, system, nu, rates)
    class(hill_determinant), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> A frequency (rad/s) of typical magnitude.
    real(wp), intent(in) :: nu
    real(wp), allocatable, intent(out) :: rates(:)
    real(wp) :: low, high
    integer :: n_low, n_high

    allocate (rates(0))
    high = slowest*nu
    n_high = n_negative(hill, system, high)
    do while (high < fastest*nu)
      low = high
      n_low = n_high
      high = merge(ratio_of_slow, ratio, low < slow*nu)*low
      n_high = n_negative(hill, system, high)
      call part(hill, system, low, n_low, high, n_high, rates)
    end do
  end subroutine rates_from_rest

  !> Add the rates between two values.
  recursive subroutine part(hill, system, low, n_low, high, n_high, rates)
    class(hill_determinant), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: low, high
    integer, intent(in) :: n_low, n_high
    real(wp), allocatable, intent(inout) :: rates(:)
    real(wp) :: middle
    integer :: n_middle, i

    if (n_low == n_high .or. min(n_low, n_high) < 0) return
    if (high - low <= close_enough*low) then
      rates = [rates, (high, i=1, abs(n_high - n_low))]
      return
    end if
    middle = 0.5_wp*(low + high)
    n_middle = n_negative(hill, system, middle)
    ! Exactly at a rate.
    if (n_middle < 0) n_middle = n_high
    call part(hill, system, low, n_low, middle, n_middle, rates)
    call part(hill, system, middle, n_middle, high, n_high, rates)
  end subroutine part

  !> Number of eigenvalues with negative real part; for large systems 1 if it is odd, else 0. -1:
  !! unknown.
  integer function n_negative(hill, system, s)
    class(hill_determinant), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: s
    real(wp), allocatable :: matrix(:, :)
    complex(wp) :: values(system%n_dof())
    integer :: pivots(system%n_dof()), i
    logical :: singular, found

    call hill%mean_system(system, s, matrix)
    n_negative = -1
    if (size(matrix, 1) <= most_by_eigenvalues) then
      call eigenvalues(matrix, values, found)
      if (found) n_negative = count(real(values) < 0.0_wp)
      return
    end if
    call factorize(size(matrix, 1), matrix, pivots, singular)
    if (singular) return
    n_negative = 0
    do i = 1, size(matrix, 1)
      if (pivots(i) /= i) n_negative = n_negative + 1
      if (matrix(i, i) < 0.0_wp) n_negative = n_negative + 1
    end do
    n_negative = mod(n_negative, 2)
  end function n_negative

end module viscovib_rest_growth
