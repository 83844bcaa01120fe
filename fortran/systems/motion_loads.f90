!> What drives a motion in time besides its state: a periodic load, piecewise cubics, constants.
module viscovib_motion_loads
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: add_two, n_lanes, turn
  use viscovib_timed_cubics, only: timed_cubics
  implicit none
  private

  public :: motion_loads

  !> Accelerations Im sum_k load(:,k) exp(i orders(k) nu t) + F(t).
  type :: motion_loads
    !> Shape (n_dof, size(orders)), and orders, ascending.
    complex(wp), allocatable :: load(:, :)
    integer, allocatable :: orders(:)
    !> F, and the present piece of it, from `enter` on, shape (n_dof, 4).
    logical :: timed = .false.
    type(timed_cubics) :: table
    real(wp), allocatable :: piece(:, :)
  contains
    procedure :: hold
    procedure :: add_table, enter
    procedure :: highest
    procedure :: add_to
  end type motion_loads

contains

  !> Accelerations for ever, besides the others.
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

  !> A load in time as cubics between breaks.
  subroutine add_table(self, inverse, breaks, pieces)
    class(motion_loads), intent(inout) :: self
    !> M^(-1).
    real(wp), intent(in) :: inverse(:, :)
    !> Forces on the first coordinates; shapes (n) and (m, 4, n), the last one of no effect.
    real(wp), intent(in) :: breaks(:), pieces(:, :, :)
    integer :: i
    self%table%breaks = breaks
    allocate (self%table%pieces(size(inverse, 1), 4, size(breaks)))
    do i = 1, size(breaks)
      self%table%pieces(:, :, i) = matmul(inverse(:, :size(pieces, 1)), pieces(:, :, i))
    end do
    allocate (self%piece(size(inverse, 1), 4), source=0.0_wp)
    self%timed = .true.
  end subroutine add_table

  subroutine enter(self, from, to)
    class(motion_loads), intent(inout) :: self
    real(wp), intent(in) :: from, to
    if (self%timed) self%piece = self%table%between(from, to)
  end subroutine enter

  !> The highest order that pushes anything.
  pure integer function highest(self)
    class(motion_loads), intent(in) :: self
    highest = maxval([self%orders, 0], [any(abs(self%load) > 0.0_wp, 1), .true.])
  end function highest

  !> On top of other accelerations.
  pure subroutine add_to(self, drive, a)
    class(motion_loads), intent(in) :: self
    !> cos(nu t), sin(nu t), and the time in the present piece of a table, shape (n_lanes, 2 or 3).
    real(wp), intent(in) :: drive(:, :)
    !> Shape (n_lanes, n_dof).
    real(wp), intent(inout) :: a(:, :)
    real(wp) :: c(n_lanes), s(n_lanes)
    integer :: d, k, order

    ! cos and sin of the order reached so far.
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
    do d = 1, size(a, 2)
      a(:, d) = a(:, d) + (((self%piece(d, 1)*drive(:, 3) + self%piece(d, 2))*drive(:, 3) &
                            + self%piece(d, 3))*drive(:, 3) + self%piece(d, 4))
    end do
  end subroutine add_to

end module viscovib_motion_loads
