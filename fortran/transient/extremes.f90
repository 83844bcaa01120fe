!> Largest absolute values of coordinates and velocities along a motion, and integrals of them and
!! of their squares over time, from the polynomials of steps and of their parts, including the
!! interior of steps.
module viscovib_extremes
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: gauss_nodes, lagrange, lagrange_factors
  use viscovib_step_path, only: step_path
  implicit none
  private

  public :: extremes_type

  !> Iterations that find an extremum between two points.
  integer, parameter :: n_golden = 32
  real(wp), parameter :: golden = 0.6180339887498949_wp

  type :: extremes_type
    !> True if they are requested.
    logical :: wanted = .false.
    !> Start time of the evaluation.
    real(wp) :: from = 0.0_wp
    !> For each coordinate and velocity in turn, shape (2 n_dof); not allocated before any step.
    real(wp), allocatable :: peak(:), total(:), squares(:)
    !> Points of the states for which these are valid: values of the Lagrange polynomials at the
    !! nodes of a rule that integrates their squares, and the rule's weights.
    real(wp), allocatable, private :: points(:), factors(:), values(:, :), weights(:)
  contains
    procedure :: take
    procedure, private :: take_in
    procedure, private :: prepare
    procedure, private :: largest
  end type extremes_type

contains

  !> Add a step, or a part of one, from the start time on.
  subroutine take(self, path)
    class(extremes_type), intent(inout) :: self
    type(step_path), intent(in) :: path
    type(step_path) :: late
    real(wp) :: t(size(path%points)), before

    if (.not. self%wanted .or. path%start + path%h <= self%from) return
    before = (self%from - path%start)/path%h
    if (before <= 0.0_wp) then
      call self%take_in(path)
      return
    end if
    late = path
    late%start = self%from
    late%h = (1.0_wp - before)*path%h
    call path%at(before + (1.0_wp - before)*path%points, t, late%q, late%v)
    call self%take_in(late)
  end subroutine take

  subroutine take_in(self, path)
    class(extremes_type), intent(inout) :: self
    type(step_path), intent(in) :: path
    real(wp) :: along(size(path%points))
    integer :: d, k

    if (.not. allocated(self%peak)) then
      allocate (self%peak(2*size(path%q, 2)), source=0.0_wp)
      self%total = self%peak
      self%squares = self%peak
    end if
    call self%prepare(path%points)
    do k = 1, size(self%peak)
      d = (k + 1)/2
      if (modulo(k, 2) == 1) then
        along = path%q(:, d)
      else
        along = path%v(:, d)
      end if
      self%peak(k) = max(self%peak(k), maxval(abs(along)))
      self%peak(k) = self%largest(along, self%peak(k))
      along = matmul(self%values, along)
      self%total(k) = self%total(k) + path%h*dot_product(self%weights, along)
      self%squares(k) = self%squares(k) + path%h*dot_product(self%weights, along**2)
    end do
  end subroutine take_in

  !> Prepare the matrices for the points of a path.
  subroutine prepare(self, points)
    class(extremes_type), intent(inout) :: self
    real(wp), intent(in) :: points(:)
    real(wp) :: nodes(size(points))
    integer :: i, n

    n = size(points)
    if (allocated(self%points)) then
      if (size(self%points) == n) then
        if (all(abs(self%points - points) <= 0.0_wp)) return
      end if
      deallocate (self%values, self%weights)
    end if
    allocate (self%values(n, n), self%weights(n))
    self%points = points
    self%factors = lagrange_factors(points)
    call gauss_nodes(n, nodes, self%weights)
    do i = 1, n
      self%values(i, :) = lagrange(points, self%factors, nodes(i))
    end do
  end subroutine prepare

  !> The largest absolute value of a polynomial if it is above `least`; else `least`.
  real(wp) function largest(self, along, least)
    class(extremes_type), intent(in) :: self
    !> Its values at the points.
    real(wp), intent(in) :: along(:), least
    real(wp) :: low, high, at(2), value(2)
    integer :: i, j, n

    n = size(along)
    largest = least
    do i = 1, n
      ! A maximum is near a node that is above both its neighbours.
      if (abs(along(i)) < maxval(abs(along(max(i - 1, 1):min(i + 1, n))))) cycle
      if (abs(along(i)) + rise(i) <= largest) cycle
      low = self%points(max(i - 1, 1))
      high = self%points(min(i + 1, n))
      at = [high - golden*(high - low), low + golden*(high - low)]
      value = abs([value_at(at(1)), value_at(at(2))])
      do j = 1, n_golden
        if (value(1) > value(2)) then
          high = at(2)
          at = [high - golden*(high - low), at(1)]
          value = abs([value_at(at(1)), value(1)])
        else
          low = at(1)
          at = [at(2), low + golden*(high - low)]
          value = abs([value(2), value_at(at(2))])
        end if
      end do
      largest = max(largest, maxval(value))
    end do

  contains

    real(wp) function value_at(x)
      real(wp), intent(in) :: x
      value_at = dot_product(lagrange(self%points, self%factors, x), along)
    end function value_at

    !> Bound of the rise of the polynomial above its value at a node.
    real(wp) function rise(i)
      integer, intent(in) :: i
      rise = maxval(along(max(i - 1, 1):min(i + 1, n))) - minval(along(max(i - 1, 1):min(i + 1, n)))
    end function rise

  end function largest

end module viscovib_extremes
