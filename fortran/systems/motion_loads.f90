! Optimize: -O3
!> Loads of a solution in time: a periodic load, piecewise polynomials, constants.
module viscovib_motion_loads
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: add_two, n_lanes, turn
  use viscovib_timed_polynomials, only: timed_polynomials
  implicit none
  private

  public :: motion_loads

  !> Accelerations Im sum_k load(:,k) exp(i orders(k) nu t) + F(t).
  type :: motion_loads
    !> Shape (n_dof, size(orders)), and harmonic orders in ascending order.
    complex(wp), allocatable :: load(:, :)
    integer, allocatable :: orders(:)
    !> F, and its current piece, set by `enter`, shape (n_dof, n_powers); the first power with a
    !! coefficient, n_powers + 1 where there is no load.
    logical :: timed = .false.
    integer, private :: first = 1
    type(timed_polynomials) :: table
    real(wp), allocatable :: piece(:, :)
  contains
    procedure :: hold
    procedure :: add_table, enter
    procedure :: highest
    procedure :: add_to
  end type motion_loads

contains

  !> Add constant accelerations.
  subroutine hold(self, push)
    class(motion_loads), intent(inout) :: self
    real(wp), intent(in) :: push(:)
    complex(wp) :: mean(size(push), 1)

    if (.not. any(abs(push) > 0.0_wp)) return
    mean(:, 1) = cmplx(0.0_wp, push, wp)
    if (any(self%orders == 0)) then
      self%load(:, 1) = self%load(:, 1) + mean(:, 1)
    else
      self%orders = [0, self%orders]
      self%load = reshape([mean, self%load], [size(push), size(self%orders)])
    end if
  end subroutine hold

  !> Add a load given as polynomials between breaks.
  subroutine add_table(self, inverse, breaks, pieces)
    class(motion_loads), intent(inout) :: self
    !> M^(-1).
    real(wp), intent(in) :: inverse(:, :)
    !> Forces on the first coordinates; shapes (n) and (m, n_powers, n). The last piece is not used.
    real(wp), intent(in) :: breaks(:), pieces(:, :, :)
    integer :: i
    self%table%breaks = breaks
    allocate (self%table%pieces(size(inverse, 1), size(pieces, 2), size(breaks)))
    do i = 1, size(breaks)
      self%table%pieces(:, :, i) = matmul(inverse(:, :size(pieces, 1)), pieces(:, :, i))
    end do
    allocate (self%piece(size(inverse, 1), size(pieces, 2)), source=0.0_wp)
    self%timed = .true.
  end subroutine add_table

  subroutine enter(self, from, to)
    class(motion_loads), intent(inout) :: self
    real(wp), intent(in) :: from, to
    if (.not. self%timed) return
    self%piece = self%table%between(from, to)
    self%first = findloc([any(abs(self%piece) > 0.0_wp, 1), .true.], .true., 1)
  end subroutine enter

  !> Highest harmonic order with a nonzero load.
  pure integer function highest(self)
    class(motion_loads), intent(in) :: self
    highest = maxval([self%orders, 0], [any(abs(self%load) > 0.0_wp, 1), .true.])
  end function highest

  !> Add the accelerations of the loads.
  pure subroutine add_to(self, drive, a)
    class(motion_loads), intent(in) :: self
    !> cos(nu t), sin(nu t), and the time in the current piece, shape (n_lanes, 2 or 3).
    real(wp), intent(in) :: drive(:, :)
    !> Shape (n_lanes, n_dof).
    real(wp), intent(inout) :: a(:, :)
    real(wp) :: c(n_lanes), s(n_lanes)
    integer :: d, k, order

    ! cos and sin of the current order.
    order = 0
    c = 1.0_wp
    s = 0.0_wp
    do k = 1, size(self%orders)
      do while (order < self%orders(k))
        if (order == 0) then
          c = drive(:, 1)
          s = drive(:, 2)
        else
          call turn(c, s, drive)
        end if
        order = order + 1
      end do
      do d = 1, size(a, 2)
        call add_two(a(:, d), real(self%load(d, k)), s, aimag(self%load(d, k)), c)
      end do
    end do
    if (.not. self%timed) return
    if (self%first > size(self%piece, 2)) return
    do d = 1, size(a, 2)
      s = self%piece(d, self%first)
      do k = self%first + 1, size(self%piece, 2)
        s = s*drive(:, 3) + self%piece(d, k)
      end do
      a(:, d) = a(:, d) + s
    end do
  end subroutine add_to

end module viscovib_motion_loads
