!> Samples on a torus: samples of the drives, and copies between samples and lanes.
module viscovib_torus_samples
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_torus, only: torus_type
  implicit none
  private

  public :: drive_samples, load, store, within_range

contains

  !> cos of the angle order.theta at the samples.
  pure subroutine drive_samples(torus, order, cosine)
    type(torus_type), intent(in) :: torus
    integer, intent(in) :: order(:)
    real(wp), intent(out) :: cosine(:)
    complex(wp) :: wave(maxval(torus%n_points), 3), across
    real(wp) :: angle
    integer :: i, j, k, s

    wave = (1.0_wp, 0.0_wp)
    do i = 1, size(order)
      do s = 1, torus%n_points(i)
        angle = 2.0_wp*pi*modulo(order(i)*(s - 1), torus%n_points(i))/torus%n_points(i)
        wave(s, i) = cmplx(cos(angle), sin(angle), wp)
      end do
    end do
    s = 0
    do k = 1, torus%n_points(3)
      do j = 1, torus%n_points(2)
        across = wave(j, 2)*wave(k, 3)
        do i = 1, torus%n_points(1)
          cosine(s + i) = real(wave(i, 1))*real(across) - aimag(wave(i, 1))*aimag(across)
        end do
        s = s + torus%n_points(1)
      end do
    end do
  end subroutine drive_samples

  !> Load a block of lanes; if there are fewer values the last one is repeated.
  pure subroutine load(m, values, lanes)
    integer, intent(in) :: m
    real(wp), intent(in) :: values(m)
    real(wp), intent(out) :: lanes(n_lanes)
    integer :: l
    if (m == n_lanes) then
      do l = 1, n_lanes
        lanes(l) = values(l)
      end do
    else
      lanes(:m) = values
      lanes(m + 1:) = values(m)
    end if
  end subroutine load

  !> Store lanes in their rows of an array of samples.
  pure subroutine store(first, m, lanes, samples)
    integer, intent(in) :: first, m
    !> Shapes (n_lanes, n), of which m lanes are valid, and (n_samples, n).
    real(wp), intent(in) :: lanes(:, :)
    real(wp), intent(inout) :: samples(:, :)
    integer :: d, l
    do d = 1, size(lanes, 2)
      if (m == n_lanes) then
        do l = 1, n_lanes
          samples(first - 1 + l, d) = lanes(l, d)
        end do
      else
        samples(first:first + m - 1, d) = lanes(:m, d)
      end if
    end do
  end subroutine store

  !> True within the range of the equations, and far from overflow.
  pure logical function within_range(n, margin, q, v)
    integer, intent(in) :: n
    real(wp), intent(in) :: margin(n_lanes), q(n_lanes, n), v(n_lanes, n)
    real(wp) :: outside(n_lanes)
    integer :: d, l
    do l = 1, n_lanes
      outside(l) = merge(0.0_wp, 1.0_wp, margin(l) > 0.0_wp)
    end do
    do d = 1, n
      do l = 1, n_lanes
        ! NaN is not within the range either.
        outside(l) = outside(l) + merge(0.0_wp, 1.0_wp, abs(q(l, d)) <= 1.0e6_wp &
                                        .and. abs(v(l, d)) <= 1.0e60_wp)
      end do
    end do
    within_range = maxval(outside) < 0.5_wp
  end function within_range

end module viscovib_torus_samples
