!> Functions on a torus: real trigonometric sums over a lattice of orders, and their
!! samples on a grid.
!!
!! With the angles theta_i = omega_i t of n_axes base frequencies, 1 to 3,
!!
!!   u = Im sum_k X_k exp(i k.theta),  k in half of the lattice, mean Im X_0,
!!
!! a periodic function for one axis, a quasi-periodic one for more. Unknowns of a
!! coordinate are its mean, then real and imaginary parts of the X_k by turns.
!! Passages go axis by axis through tables, the first axis along the lanes, several
!! functions at once; for the few dozen samples an axis takes that is a small part of
!! what the linear algebra costs.
module viscovib_torus
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: lane_product, n_lanes
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: torus_type, new_torus

  integer, parameter, public :: max_axes = 3

  type :: torus_type
    integer :: n_axes = 0
    !> Shape (n_axes, n_orders); the first is 0, the first entry of any other that is
    !! not 0 is positive.
    integer, allocatable :: orders(:, :)
    !> Unknowns of a coordinate; samples in all and along each axis.
    integer :: n = 0, n_samples = 0, n_points(max_axes) = 1
    !> Size of the box of moments, and where in it order 0 lies; an order k lies
    !! `place` further.
    integer :: n_moments = 0, origin = 0
    integer, allocatable :: place(:)
    !> Highest order along each axis.
    integer, private :: reach(max_axes) = 0
    !> exp(i k theta) at the samples of an axis, shape (n_points, -2 reach:2 reach).
    complex(wp), allocatable, private :: wave_2(:, :), wave_3(:, :)
    !> The first axis, blocks of lanes: sin and cos at the samples, shape (n_lanes,
    !! 2 (reach + 1), blocks of samples); cos and -sin over the number of samples, shape
    !! (n_lanes, n_points, blocks of 2 (2 reach + 1) moments).
    real(wp), allocatable, private :: synthesis(:, :, :), analysis(:, :, :)
  contains
    procedure :: to_samples
    procedure :: moments
    procedure :: to_unknowns
    procedure :: frequencies
  end type torus_type

contains

  subroutine new_torus(torus, orders, status)
    type(torus_type), intent(out) :: torus
    !> Shape (n_axes, n_orders).
    integer, intent(in) :: orders(:, :)
    type(status_type), intent(out) :: status
    integer :: i, k, sides(max_axes)

    torus%n_axes = size(orders, 1)
    if (torus%n_axes < 1 .or. torus%n_axes > max_axes) then
      call fail(status, status_input_error, 'frequencies', 'frequencies: '//show(torus%n_axes) &
                //' of them do not go together, must be 1 to '//show(max_axes))
      return
    end if
    do k = 1, size(orders, 2)
      i = findloc(orders(:, k) /= 0, .true., 1)
      if (i == 0 .and. k == 1) cycle
      if (i == 0 .or. k == 1) i = 1
      if (orders(i, k) <= 0) then
        call fail(status, status_input_error, 'orders', 'orders: the first must be 0, and each &
        &other begin with a positive number')
        return
      end if
    end do
    torus%orders = orders
    torus%n = 2*size(orders, 2) - 1
    torus%reach(:torus%n_axes) = max(1, maxval(abs(orders), 2))
    ! Moments reach 2 K. More samples leave less aliasing of what is no polynomial.
    torus%n_points(:torus%n_axes) = merge(6, 4, torus%n_axes == 1)*torus%reach(:torus%n_axes) + 2
    torus%n_samples = product(torus%n_points)
    sides = 4*torus%reach + 1
    torus%n_moments = product(sides)
    torus%origin = (torus%n_moments + 1)/2
    allocate (torus%place(size(orders, 2)), source=0)
    do i = 1, torus%n_axes
      torus%place = torus%place + orders(i, :)*product(sides(:i - 1))
    end do
    call first_axis(torus)
    call waves(torus%n_points(2), torus%reach(2), torus%wave_2)
    call waves(torus%n_points(3), torus%reach(3), torus%wave_3)
  end subroutine new_torus

  pure subroutine first_axis(torus)
    type(torus_type), intent(inout) :: torus
    real(wp) :: angle
    integer :: k, s, i, n, r

    n = torus%n_points(1)
    r = torus%reach(1)
    allocate (torus%synthesis(n_lanes, 2*(r + 1), (n + n_lanes - 1)/n_lanes), source=0.0_wp)
    allocate (torus%analysis(n_lanes, n, (2*(2*r + 1) + n_lanes - 1)/n_lanes), source=0.0_wp)
    do s = 0, n - 1
      do k = 0, 2*r
        angle = 2.0_wp*pi*modulo(k*s, n)/n
        if (k <= r) then
          associate (block => torus%synthesis(:, :, s/n_lanes + 1), lane => mod(s, n_lanes) + 1)
            block(lane, 2*k + 1) = sin(angle)
            block(lane, 2*k + 2) = cos(angle)
          end associate
        end if
        do i = 2*k, 2*k + 1
          torus%analysis(mod(i, n_lanes) + 1, s + 1, i/n_lanes + 1) &
            = merge(cos(angle), -sin(angle), i == 2*k)/torus%n_samples
        end do
      end do
    end do
  end subroutine first_axis

  pure subroutine waves(n, reach, table)
    integer, intent(in) :: n, reach
    complex(wp), allocatable, intent(out) :: table(:, :)
    real(wp) :: angle
    integer :: k, s
    allocate (table(n, -2*reach:2*reach))
    do k = -2*reach, 2*reach
      do s = 1, n
        angle = 2.0_wp*pi*modulo(k*(s - 1), n)/n
        table(s, k) = cmplx(cos(angle), sin(angle), wp)
      end do
    end do
  end subroutine waves

  !> k.omega for every order.
  pure function frequencies(self, omega) result(values)
    class(torus_type), intent(in) :: self
    real(wp), intent(in) :: omega(self%n_axes)
    real(wp) :: values(size(self%orders, 2))
    values = matmul(omega, self%orders)
  end function frequencies

  !> Samples of m functions Im sum_k factor_k X_k exp(i k.theta); factors i k.omega give
  !! the derivative with respect to time.
  pure subroutine to_samples(self, m, x, factor, u)
    class(torus_type), intent(in) :: self
    integer, intent(in) :: m
    !> Unknowns, shape (n, m).
    real(wp), intent(in) :: x(self%n, m)
    complex(wp), intent(in) :: factor(size(self%orders, 2), m)
    !> The first axis runs first.
    real(wp), intent(out) :: u(self%n_points(1), self%n_samples/self%n_points(1), m)
    complex(wp), allocatable :: box(:, :, :), along_3(:, :, :), along_2(:, :, :)
    real(wp), allocatable :: columns(:, :, :), sums(:, :, :)
    integer :: f, i, j, s, k(max_axes), last

    associate (r => self%reach, n => self%n_points)
      allocate (columns(2*(r(1) + 1), n(2)*n(3), m), sums(n_lanes, n(2)*n(3), m))
      allocate (box(0:r(1), -r(2):r(2), -r(3):r(3)))
      allocate (along_3(r(1) + 1, 2*r(2) + 1, n(3)), along_2(r(1) + 1, n(2), n(3)))
      do f = 1, m
        box = (0.0_wp, 0.0_wp)
        k = 0
        box(0, 0, 0) = factor(1, f)*cmplx(0.0_wp, x(1, f), wp)
        do i = 2, size(factor, 1)
          k(:self%n_axes) = self%orders(:, i)
          box(k(1), k(2), k(3)) = factor(i, f)*cmplx(x(2*i - 2, f), x(2*i - 1, f), wp)
        end do
        if (self%n_axes == 1) then
          along_2(:, 1, 1) = box(:, 0, 0)
        else
          along_3(:, :, :) = reshape(matmul(reshape(box, [(r(1) + 1)*(2*r(2) + 1), 2*r(3) + 1]), &
                                            transpose(self%wave_3(:, -r(3):r(3)))), shape(along_3))
          do i = 1, n(3)
            along_2(:, :, i) = matmul(along_3(:, :, i), transpose(self%wave_2(:, -r(2):r(2))))
          end do
        end if
        do j = 1, n(2)*n(3)
          associate (column => along_2(:, mod(j - 1, n(2)) + 1, (j - 1)/n(2) + 1))
            columns(1::2, j, f) = real(column)
            columns(2::2, j, f) = aimag(column)
          end associate
        end do
      end do
      do i = 1, size(self%synthesis, 3)
        call lane_product(2*(r(1) + 1), m*n(2)*n(3), self%synthesis(:, :, i), columns, sums)
        s = n_lanes*(i - 1)
        last = min(n_lanes, n(1) - s)
        u(s + 1:s + last, :, :) = sums(:last, :, :)
      end do
    end associate
  end subroutine to_samples

  !> Mean values of f exp(-i k.theta) for m functions and all orders of the box, twice as
  !! far as the lattice reaches.
  pure subroutine moments(self, m, f, c)
    class(torus_type), intent(in) :: self
    integer, intent(in) :: m
    real(wp), intent(in) :: f(self%n_samples, m)
    complex(wp), intent(out) :: c(self%n_moments, m)
    complex(wp), allocatable :: along_1(:, :, :), along_2(:, :, :), half(:, :)
    real(wp), allocatable :: sums(:, :, :), parts(:, :, :)
    integer :: g, i, j, last, top

    associate (r => self%reach, n => self%n_points)
      top = 2*r(1)
      allocate (sums(n_lanes, n(2)*n(3), m), parts(2*(top + 1), n(2)*n(3), m))
      do i = 1, size(self%analysis, 3)
        call lane_product(n(1), m*n(2)*n(3), self%analysis(:, :, i), f, sums)
        j = n_lanes*(i - 1)
        last = min(n_lanes, size(parts, 1) - j)
        parts(j + 1:j + last, :, :) = sums(:last, :, :)
      end do
      allocate (half(top + 1, (4*r(2) + 1)*(4*r(3) + 1)))
      allocate (along_1(top + 1, n(2), n(3)), along_2(top + 1, 4*r(2) + 1, n(3)))
      do g = 1, m
        if (self%n_axes == 1) then
          half(:, 1) = cmplx(parts(1::2, 1, g), parts(2::2, 1, g), wp)
        else
          along_1(:, :, :) = reshape(cmplx(parts(1::2, :, g), parts(2::2, :, g), wp), &
                                     shape(along_1))
          do i = 1, n(3)
            along_2(:, :, i) = matmul(along_1(:, :, i), conjg(self%wave_2))
          end do
          half(:, :) = reshape(matmul(reshape(along_2, [(top + 1)*(4*r(2) + 1), n(3)]), &
                                      conjg(self%wave_3)), shape(half))
        end if
        ! The other half by c_(-k) = conj c_k.
        do j = 1, size(half, 2)
          i = (j - 1)*(2*top + 1) + top
          c(i + 1:i + top + 1, g) = half(:, j)
          i = (size(half, 2) - j)*(2*top + 1) + top + 2
          c(i - top - 1:i - 2, g) = conjg(half(top + 1:2:-1, j))
        end do
      end do
    end associate
  end subroutine moments

  !> The unknowns of a function from its moments: X_k = 2 i c_k, the mean c_0.
  pure subroutine to_unknowns(self, c, x)
    class(torus_type), intent(in) :: self
    complex(wp), intent(in) :: c(:)
    real(wp), intent(out) :: x(:)
    integer :: k
    x(1) = real(c(self%origin))
    do k = 2, size(self%place)
      x(2*k - 2) = -2.0_wp*aimag(c(self%origin + self%place(k)))
      x(2*k - 1) = 2.0_wp*real(c(self%origin + self%place(k)))
    end do
  end subroutine to_unknowns

end module viscovib_torus
