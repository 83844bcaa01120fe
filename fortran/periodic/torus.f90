!> Functions on a torus: real trigonometric sums over a lattice of orders, and their
!! samples on a grid.
!!
!! With the angles theta_i = omega_i t of n_axes base frequencies, 1 to 3,
!!
!!   u = Im sum_k X_k exp(i k.theta),  k in half of the lattice, mean Im X_0,
!!
!! a periodic function for one axis, a quasi-periodic one for more. Unknowns of a
!! coordinate are its mean, then real and imaginary parts of the X_k by turns.
!! Passages go axis by axis through tables; for the few dozen samples an axis takes
!! that is a small part of what the linear algebra costs.
module viscovib_torus
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
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
    complex(wp), allocatable, private :: wave_1(:, :), wave_2(:, :), wave_3(:, :)
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
    call waves(torus%n_points(1), torus%reach(1), torus%wave_1)
    call waves(torus%n_points(2), torus%reach(2), torus%wave_2)
    call waves(torus%n_points(3), torus%reach(3), torus%wave_3)
  end subroutine new_torus

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

  !> Samples of Im sum_k factor_k X_k exp(i k.theta); factors i k.omega give the
  !! derivative with respect to time.
  pure subroutine to_samples(self, x, factor, u)
    class(torus_type), intent(in) :: self
    !> Unknowns of a coordinate, shape (n).
    real(wp), intent(in) :: x(:)
    !> Shape (n_orders).
    complex(wp), intent(in) :: factor(:)
    !> Shape (n_samples), the first axis running first.
    real(wp), intent(out) :: u(:)
    complex(wp), allocatable :: box(:, :, :), along_3(:, :, :), along_2(:, :, :)
    real(wp), allocatable :: re(:, :), im(:, :)
    integer :: i, k(max_axes)

    associate (r => self%reach, n => self%n_points)
      allocate (re(r(1) + 1, n(2)*n(3)), im(r(1) + 1, n(2)*n(3)))
      allocate (box(0:r(1), -r(2):r(2), -r(3):r(3)), source=(0.0_wp, 0.0_wp))
      k = 0
      box(0, 0, 0) = factor(1)*cmplx(0.0_wp, x(1), wp)
      do i = 2, size(factor)
        k(:self%n_axes) = self%orders(:, i)
        box(k(1), k(2), k(3)) = factor(i)*cmplx(x(2*i - 2), x(2*i - 1), wp)
      end do
      if (self%n_axes < 2) then
        re(:, :) = real(box(:, :, 0))
        im(:, :) = aimag(box(:, :, 0))
      else
        allocate (along_3(r(1) + 1, 2*r(2) + 1, n(3)))
        along_3(:, :, :) = reshape(matmul(reshape(box, [(r(1) + 1)*(2*r(2) + 1), 2*r(3) + 1]), &
                                 transpose(self%wave_3(:, -r(3):r(3)))), &
                          [r(1) + 1, 2*r(2) + 1, n(3)])
        allocate (along_2(r(1) + 1, n(2), n(3)))
        do i = 1, n(3)
          along_2(:, :, i) = matmul(along_3(:, :, i), transpose(self%wave_2(:, -r(2):r(2))))
        end do
        re(:, :) = reshape(real(along_2), [r(1) + 1, n(2)*n(3)])
        im(:, :) = reshape(aimag(along_2), [r(1) + 1, n(2)*n(3)])
      end if
      u = reshape(matmul(real(self%wave_1(:, 0:r(1))), im) &
                  + matmul(aimag(self%wave_1(:, 0:r(1))), re), [self%n_samples])
    end associate
  end subroutine to_samples

  !> Mean values of f exp(-i k.theta) for all orders of the box, twice as far as the
  !! lattice reaches.
  pure subroutine moments(self, f, c)
    class(torus_type), intent(in) :: self
    !> Shape (n_samples).
    real(wp), intent(in) :: f(:)
    !> Shape (n_moments).
    complex(wp), intent(out) :: c(:)
    real(wp), allocatable :: sheet(:, :)
    complex(wp), allocatable :: along_1(:, :, :), along_2(:, :, :), half(:, :)
    integer :: i, j, m

    associate (r => self%reach, n => self%n_points)
      m = 2*r(1)
      allocate (sheet(n(1), n(2)*n(3)), half(m + 1, (4*r(2) + 1)*(4*r(3) + 1)))
      sheet(:, :) = reshape(f, [n(1), n(2)*n(3)])/self%n_samples
      if (self%n_axes == 1) then
        half(:, :) = first_axis()
      else
        allocate (along_1(m + 1, n(2), n(3)))
        along_1(:, :, :) = reshape(first_axis(), [m + 1, n(2), n(3)])
        allocate (along_2(m + 1, 4*r(2) + 1, n(3)))
        do i = 1, n(3)
          along_2(:, :, i) = matmul(along_1(:, :, i), conjg(self%wave_2))
        end do
        half(:, :) = reshape(matmul(reshape(along_2, [(m + 1)*(4*r(2) + 1), n(3)]), &
                                    conjg(self%wave_3)), shape(half))
      end if
      ! The other half by c_(-k) = conj c_k.
      do j = 1, size(half, 2)
        i = (j - 1)*(2*m + 1) + m
        c(i + 1:i + m + 1) = half(:, j)
        i = (size(half, 2) - j)*(2*m + 1) + m + 2
        c(i - m - 1:i - 2) = conjg(half(m + 1:2:-1, j))
      end do
    end associate

  contains

    pure function first_axis() result(part)
      complex(wp) :: part(m + 1, size(sheet, 2))
      part = cmplx(matmul(transpose(real(self%wave_1(:, 0:m))), sheet), &
                   -matmul(transpose(aimag(self%wave_1(:, 0:m))), sheet), wp)
    end function first_axis

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
