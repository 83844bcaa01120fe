! Optimize: -O2
!> Inverse of a compliance near resonances of lightly damped modes.
!!
!! Near a resonance, H(s) = H_r(s) + sum_m seen_m pushed_m^T/t_m is dominated by the few terms with
!! t_m = squares_m + rates_m s + s^2 close to 0. Rounding errors then dominate its inverse. With the
!! amplitudes a of these modes as extra unknowns, forces h on the other modes and a load (y0, p),
!!
!!   H_r h + seen a = y - y0,   pushed^T h - t a = -p,
!!
!! the matrix is regular. With its inverse X, H^-1 is the upper left block of X.
module viscovib_resonant_compliance
  use viscovib_compliance, only: compliance_type, push_type
  use viscovib_dense, only: invert
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: near_modes, bordered, bordered_matrix, bordered_slope, without_modes

  !> A mode is near resonance if |t_m| is less than this fraction of |squares_m|.
  real(wp), parameter :: near = 1.0e-2_wp

contains

  !> Modes near resonance at s = i mu. Empty for a single deflection, whose compliance is a scalar.
  pure function near_modes(rest, mu) result(modes)
    class(compliance_type), intent(in) :: rest
    real(wp), intent(in) :: mu
    integer, allocatable :: modes(:)
    integer :: m

    allocate (modes(0))
    if (rest%n_seen == 1 .or. .not. rest%has_light) return
    do m = 1, rest%n_modes
      if (abs(rest%squares(m) - mu**2) > near*abs(rest%squares(m))) cycle
      if (abs(rest%losses(m) + rest%rates(m)*mu) > near*abs(rest%squares(m))) cycle
      modes = [modes, m]
    end do
  end function near_modes

  !> The inverse of X at s = i mu, shape (n_seen + size(modes), n_seen + size(modes)).
  pure subroutine bordered_matrix(rest, modes, mu, whole)
    class(compliance_type), intent(in) :: rest
    integer, intent(in) :: modes(:)
    real(wp), intent(in) :: mu
    complex(wp), intent(out) :: whole(:, :)
    integer :: i, q

    q = rest%n_seen
    whole = (0.0_wp, 0.0_wp)
    call rest%evaluate(cmplx(0.0_wp, mu, wp), whole(:q, :q), without=modes)
    whole(:q, q + 1:) = transpose(rest%seen(modes, :))
    whole(q + 1:, :q) = rest%pushed(modes, :)
    do i = 1, size(modes)
      associate (m => modes(i))
        whole(q + i, q + i) = -cmplx(rest%squares(m) - mu**2, rest%losses(m) + rest%rates(m)*mu, wp)
      end associate
    end do
  end subroutine bordered_matrix

  !> X at s = i mu.
  pure subroutine bordered(rest, modes, mu, x)
    class(compliance_type), intent(in) :: rest
    integer, intent(in) :: modes(:)
    real(wp), intent(in) :: mu
    complex(wp), intent(out) :: x(:, :)
    complex(wp), dimension(size(x, 1), size(x, 1)) :: whole
    logical :: singular

    call bordered_matrix(rest, modes, mu, whole)
    call invert(whole, x, singular)
  end subroutine bordered

  !> Derivative of the inverse of X with respect to mu.
  pure subroutine bordered_slope(rest, modes, mu, slope)
    class(compliance_type), intent(in) :: rest
    integer, intent(in) :: modes(:)
    real(wp), intent(in) :: mu
    complex(wp), intent(out) :: slope(:, :)
    complex(wp) :: h(rest%n_seen, rest%n_seen)
    integer :: i, q

    q = rest%n_seen
    slope = (0.0_wp, 0.0_wp)
    call rest%evaluate(cmplx(0.0_wp, mu, wp), h, slope(:q, :q), modes)
    slope(:q, :q) = (0.0_wp, 1.0_wp)*slope(:q, :q)
    do i = 1, size(modes)
      slope(q + i, q + i) = cmplx(2.0_wp*mu, -rest%rates(modes(i)), wp)
    end do
  end subroutine bordered_slope

  !> The load `push` without the given modes.
  pure function without_modes(push, modes) result(others)
    type(push_type), intent(in) :: push
    integer, intent(in) :: modes(:)
    type(push_type) :: others
    others = push
    others%modes(modes) = (0.0_wp, 0.0_wp)
  end function without_modes

end module viscovib_resonant_compliance
