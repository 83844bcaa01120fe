! Optimize: -O3
!> Harmonics of slope(t) times each basic motion, from the Fourier moments of the slope.
!!
!! Products of two basic motions are sums of two basic motions, so these moments suffice; for the
!! sampled equations this is exact, including aliasing.
module viscovib_moment_block
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: add_sandwich_of, rate_columns

contains

  pure subroutine add_sandwich_of(set, c, s, factor, block)
    type(harmonic_set_type), intent(in) :: set
    !> Mean values of the slope times cos and sin of each stride, from minus to plus their reach.
    real(wp), intent(in) :: c(:), s(:), factor
    !> Shape (n_parts, n_parts).
    real(wp), intent(inout) :: block(:, :)
    real(wp) :: half
    integer :: i, j, k, l, row, column, middle, shift

    middle = (size(c) + 1)/2
    ! Even differences are halved, for strides of 2.
    shift = merge(1, 0, set%half_wave)
    do j = 1, size(set%orders)
      l = set%orders(j)
      column = 2*j
      do i = 1, size(set%orders)
        row = 2*i
        k = set%orders(i)
        half = merge(0.5_wp, 1.0_wp, k == 0)*factor
        associate (minus => middle + shifta(k - l, shift), plus => middle + shifta(k + l, shift))
          block(row - 1, column - 1) = block(row - 1, column - 1) + half*(c(minus) - c(plus))
          block(row, column - 1) = block(row, column - 1) + half*(s(plus) - s(minus))
          block(row - 1, column) = block(row - 1, column) + half*(s(plus) + s(minus))
          block(row, column) = block(row, column) + half*(c(minus) + c(plus))
        end associate
      end do
    end do
  end subroutine add_sandwich_of

  !> Derivatives through rates: sin k nu t has the rate k nu cos k nu t.
  pure function rate_columns(mu, block) result(turned)
    real(wp), intent(in) :: mu(:), block(:, :)
    real(wp) :: turned(size(block, 1), size(block, 2))
    integer :: k
    do k = 1, size(mu)
      turned(:, 2*k - 1) = mu(k)*block(:, 2*k)
      turned(:, 2*k) = -mu(k)*block(:, 2*k - 1)
    end do
  end function rate_columns

end module viscovib_moment_block
