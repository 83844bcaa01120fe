! Optimize: -O2
!> Floquet multipliers from the monodromy matrix.
module viscovib_orbit_multipliers
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_negative_inf, ieee_quiet_nan, &
    ieee_value
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: multipliers_of, distinguished, count_larger, logarithm

  !> A larger eigenvalue spoils the accuracy of those near the unit circle; one larger than the
  !! smallest by the second factor spoils the accuracy of the smallest.
  real(wp), parameter :: largest_root = 1.0e6_wp, widest = 1.0e6_wp

contains

  !> Multipliers, largest first; NaN if the matrix is unknown.
  pure subroutine multipliers_of(matrix, multipliers)
    !> Shape (n, n), NaN if unknown.
    real(wp), intent(in) :: matrix(:, :)
    complex(wp), intent(out) :: multipliers(:)
    logical :: found

    found = .not. any(ieee_is_nan(matrix))
    if (found) call eigenvalues(matrix, multipliers, found)
    if (.not. found) multipliers = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
  end subroutine multipliers_of

  !> Logarithm; minus infinity for 0, NaN for NaN.
  elemental complex(wp) function logarithm(z)
    complex(wp), intent(in) :: z
    logarithm = z
    if (ieee_is_nan(real(z))) return
    if (abs(z) > 0.0_wp) then
      logarithm = log(z)
    else
      logarithm = cmplx(ieee_value(0.0_wp, ieee_negative_inf), 0.0_wp, wp)
    end if
  end function logarithm

  !> True if all eigenvalues of a matrix are accurate despite its largest.
  pure logical function distinguished(values)
    complex(wp), intent(in) :: values(:)
    distinguished = .not. any(ieee_is_nan(real(values)))
    if (.not. distinguished) return
    distinguished = maxval(abs(values)) <= min(largest_root, widest*minval(abs(values)))
  end function distinguished

  !> Number of multipliers outside a circle; -1: unknown.
  pure integer function count_larger(multipliers, circle) result(n)
    complex(wp), intent(in) :: multipliers(:)
    real(wp), intent(in) :: circle
    n = -1
    if (.not. any(ieee_is_nan(real(multipliers)))) n = count(abs(multipliers) > circle)
  end function count_larger

end module viscovib_orbit_multipliers
