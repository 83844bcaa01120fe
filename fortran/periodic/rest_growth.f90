!> Rates at which a system creeps away from rest: real s > 0 with
!! det(s^2 M + s C + B [1 - R(s)] W) = 0.
!!
!! There are such where a kernel R has an integral above 1, or none: then springs push where
!! they have relaxed. The faster memory acts the faster that is, far beyond all frequencies of
!! the load, where nothing else tells of these exponents.
module viscovib_rest_growth
  use viscovib_dense, only: factorize
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: rates_from_rest

  !> Rates looked at, as parts of a frequency, and the factor between two.
  real(wp), parameter :: slowest = 1.0e-3_wp, fastest = 1.0e5_wp, ratio = 1.1_wp
  !> Rates are found to this part.
  real(wp), parameter :: close_enough = 1.0e-9_wp

contains

  !> Ascending. Two within a tenth of each other are not told apart, and left out.
  subroutine rates_from_rest(system, nu, rates)
    class(oscillator_type), intent(in) :: system
    !> A frequency (rad/s) that counts as neither slow nor fast.
    real(wp), intent(in) :: nu
    real(wp), allocatable, intent(out) :: rates(:)
    real(wp) :: at, low, high, s
    integer :: sign_low, sign_high

    allocate (rates(0))
    at = slowest*nu
    sign_low = sign_at(system, at)
    do while (at < fastest*nu)
      low = at
      at = ratio*at
      high = at
      sign_high = sign_at(system, high)
      if (sign_low*sign_high < 0) then
        do while (high - low > close_enough*low)
          s = 0.5_wp*(low + high)
          if (sign_at(system, s)*sign_high > 0) then
            high = s
          else
            low = s
          end if
        end do
        rates = [rates, high]
      end if
      sign_low = sign_high
    end do
  end subroutine rates_from_rest

  !> Of the determinant; 0 if it vanishes or is no number.
  integer function sign_at(system, s) result(sign_of)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: s
    real(wp) :: matrix(system%n_dof(), system%n_dof())
    complex(wp) :: kept(1)
    integer :: pivots(system%n_dof()), i, j, q
    logical :: singular

    matrix = s**2*system%mass + s*system%damping
    do j = 1, size(system%kernel_of)
      kept = (0.0_wp, 0.0_wp)
      q = system%kernel_of(j)
      if (q > 0) call system%kernels(q)%kernel%laplace([cmplx(s, 0.0_wp, wp)], kept)
      do i = 1, size(matrix, 2)
        matrix(:, i) = matrix(:, i) + (1.0_wp - system%memory_scale*real(kept(1))) &
                       *system%spread(:, j)*system%gather(j, i)
      end do
    end do
    sign_of = 0
    call factorize(size(matrix, 1), matrix, pivots, singular)
    if (singular) return
    sign_of = 1
    do i = 1, size(matrix, 1)
      if (pivots(i) /= i) sign_of = -sign_of
      if (matrix(i, i) < 0.0_wp) sign_of = -sign_of
    end do
  end function sign_at

end module viscovib_rest_growth
