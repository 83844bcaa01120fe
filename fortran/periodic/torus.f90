! Optimize: -O3
!> Functions on a torus: real trigonometric sums over a lattice of orders, and their
!! samples on a grid.
!!
!! With the angles theta_i = omega_i t of n_axes base frequencies, 1 to 3,
!!
!!   u = Im sum_k X_k exp(i k.theta),  k in half of the lattice, mean Im X_0,
!!
!! a periodic function for one axis, a quasi-periodic one for more. Unknowns of a coordinate are its
!! mean, then alternating real and imaginary parts of the X_k. The transforms are discrete Fourier
!! transforms over all axes by FFTW of c_k = X_k/(2i), c_(-k) = conj c_k, where c_0 is the mean.
module viscovib_torus
  use viscovib_grid_fourier, only: find_plans, from_grid, grid_plans, quick_size, to_grid
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: torus_type, new_torus

  integer, parameter, public :: max_axes = 3

  type :: torus_type
    integer :: n_axes = 0
    !> Shape (n_axes, n_orders); the first order is 0; in all other orders the first nonzero entry
    !! is positive.
    integer, allocatable :: orders(:, :)
    !> Number of unknowns of a coordinate; number of samples, total and along each axis.
    integer :: n = 0, n_samples = 0, n_points(max_axes) = 1
    !> Size of the box of moments, and index of order 0 in it; `place` is the offset of order k.
    integer :: n_moments = 0, origin = 0
    integer, allocatable :: place(:)
    !> Highest order along each axis.
    integer, private :: reach(max_axes) = 0
    type(grid_plans), private :: plans
    !> Workspace of FFTW, and indices in it of c_k and of its conjugate at -k, 0: not in this half,
    !! shape (n_orders).
    complex(wp), allocatable, private :: box(:)
    integer, allocatable, private :: spot(:), mirror(:)
  contains
    procedure :: to_samples
    procedure :: harmonics
    procedure :: moments
    procedure :: frequencies
  end type torus_type

contains

  subroutine new_torus(torus, orders, status)
    type(torus_type), intent(out) :: torus
    !> Shape (n_axes, n_orders).
    integer, intent(in) :: orders(:, :)
    type(status_type), intent(out) :: status
    integer :: i, k, sides(max_axes), whole(max_axes)

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
    ! With 3 K + 2 samples the aliasing error is the square of the omitted orders beyond K.
    do i = 1, torus%n_axes
      torus%n_points(i) = quick_size(merge(6, 3, torus%n_axes == 1)*torus%reach(i) + 2)
    end do
    call find_plans(torus%n_points, torus%plans, status)
    if (status%failed()) return
    torus%n_samples = product(torus%n_points)
    sides = 4*torus%reach + 1
    torus%n_moments = product(sides)
    torus%origin = (torus%n_moments + 1)/2
    allocate (torus%place(size(orders, 2)), source=0)
    do i = 1, torus%n_axes
      torus%place = torus%place + orders(i, :)*product(sides(:i - 1))
    end do
    allocate (torus%spot(size(orders, 2)), torus%mirror(size(orders, 2)))
    whole = 0
    do k = 1, size(orders, 2)
      whole(:torus%n_axes) = orders(:, k)
      torus%spot(k) = place_in_box(torus, whole)
      torus%mirror(k) = place_in_box(torus, -whole)
    end do
    associate (n => torus%n_points)
      allocate (torus%box((n(1)/2 + 1)*n(2)*n(3)))
    end associate
  end subroutine new_torus

  !> Index of c_k in the box; 0 for k_1 < 0.
  pure integer function place_in_box(torus, k) result(place)
    type(torus_type), intent(in) :: torus
    integer, intent(in) :: k(max_axes)
    associate (n => torus%n_points)
      place = 0
      if (k(1) < 0) return
      place = 1 + k(1) + (n(1)/2 + 1)*(modulo(k(2), n(2)) + n(2)*modulo(k(3), n(3)))
    end associate
  end function place_in_box

  !> k.omega for every order.
  pure function frequencies(self, omega) result(values)
    class(torus_type), intent(in) :: self
    real(wp), intent(in) :: omega(self%n_axes)
    real(wp) :: values(size(self%orders, 2))
    integer :: k
    values = [(sum(omega*self%orders(:, k)), k=1, size(values))]
  end function frequencies

  !> Samples of a function Im sum_k factor_k X_k exp(i k.theta); factors i k.omega give
  !! the derivative with respect to time.
  subroutine to_samples(self, x, factor, u)
    class(torus_type), intent(inout) :: self
    !> Unknowns, shape (n); factors, shape (n_orders).
    real(wp), intent(in) :: x(:)
    complex(wp), intent(in) :: factor(:)
    !> Samples, first axis fastest, shape (n_samples).
    real(wp), intent(out), contiguous :: u(:)
    complex(wp) :: c
    integer :: k

    self%box = (0.0_wp, 0.0_wp)
    self%box(1) = real(factor(1))*x(1)
    do k = 2, size(self%spot)
      c = factor(k)*cmplx(0.5_wp*x(2*k - 1), -0.5_wp*x(2*k - 2), wp)
      self%box(self%spot(k)) = c
      if (self%mirror(k) > 0) self%box(self%mirror(k)) = conjg(c)
    end do
    call to_grid(self%plans, self%box, u)
  end subroutine to_samples

  !> The unknowns of a function from its samples.
  subroutine harmonics(self, u, x)
    class(torus_type), intent(inout) :: self
    real(wp), intent(in), contiguous :: u(:)
    real(wp), intent(out) :: x(:)
    integer :: k

    call from_grid(self%plans, u, self%box)
    x(1) = real(self%box(1))/self%n_samples
    do k = 2, size(self%spot)
      x(2*k - 2) = -2.0_wp*aimag(self%box(self%spot(k)))/self%n_samples
      x(2*k - 1) = 2.0_wp*real(self%box(self%spot(k)))/self%n_samples
    end do
  end subroutine harmonics

  !> Mean values of f exp(-i k.theta) at the samples for all orders of a box of twice the reach of
  !! the lattice.
  subroutine moments(self, f, c)
    class(torus_type), intent(inout) :: self
    real(wp), intent(in), contiguous :: f(:)
    complex(wp), intent(out) :: c(:)
    complex(wp) :: value
    integer :: i, k, k_2, k_3, top, side, first, other

    call from_grid(self%plans, f, self%box)
    top = 2*self%reach(1)
    side = 2*top + 1
    i = 0
    do k_3 = -2*self%reach(3), 2*self%reach(3)
      do k_2 = -2*self%reach(2), 2*self%reach(2)
        first = place_in_box(self, [0, k_2, k_3])
        other = place_in_box(self, [0, -k_2, -k_3])
        do k = 0, top
          ! c_k is equal to that of k_1 - n_1, the conjugate of c_(-k).
          if (k <= self%n_points(1)/2) then
            value = self%box(first + k)/self%n_samples
          else
            value = conjg(self%box(other + self%n_points(1) - k))/self%n_samples
          end if
          c(i + top + 1 + k) = value
          c(self%n_moments - i - top - k) = conjg(value)
        end do
        i = i + side
      end do
    end do
  end subroutine moments

end module viscovib_torus
