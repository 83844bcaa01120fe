!> Discrete Fourier transforms of real functions on a grid of one to three axes.
!!
!! With c_k for k_1 >= 0 in a box, 0 <= k_1 <= n_1/2 and the other indices modulo n_2, n_3,
!!
!!   u = sum_k c_k exp(i k.theta),   n c_k = sum u exp(-i k.theta),
!!
!! theta the angles of a sample and n the total number of samples. Plans are made once for a shape,
!! so that results do not vary, under a lock, and kept permanently; many threads may
!! then execute one. `quick_size` selects grid sizes with fast plans.
module viscovib_grid_fourier
  use, intrinsic :: iso_c_binding, only: c_double, c_double_complex, c_int, c_intptr_t, c_loc, &
    c_null_ptr, c_ptr
  use viscovib_fourier, only: lock_planner, unlock_planner
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: grid_plans, find_plans, quick_size, to_grid, from_grid

  !> FFTW assumes the alignment of the plan's arrays: 16 bytes, the alignment of allocated arrays
  !! without an offset.
  integer(c_intptr_t), parameter :: alignment = 16_c_intptr_t
  integer, parameter :: max_shapes = 1000

  type :: grid_plans
    integer :: n(3) = 0
    type(c_ptr), private :: forward = c_null_ptr, backward = c_null_ptr
  end type grid_plans

  integer :: n_shapes = 0
  type(grid_plans) :: known(max_shapes)

  interface
    type(c_ptr) function plan_box(n_3, n_2, n_1, u, c) &
      bind(c, name='viscovib_plan_box')
      import :: c_double, c_double_complex, c_int, c_ptr
      integer(c_int), value :: n_3, n_2, n_1
      real(c_double), intent(inout) :: u(*)
      complex(c_double_complex), intent(inout) :: c(*)
    end function plan_box

    type(c_ptr) function plan_box_back(n_3, n_2, n_1, c, u) &
      bind(c, name='viscovib_plan_box_back')
      import :: c_double, c_double_complex, c_int, c_ptr
      integer(c_int), value :: n_3, n_2, n_1
      complex(c_double_complex), intent(inout) :: c(*)
      real(c_double), intent(inout) :: u(*)
    end function plan_box_back

    subroutine transform(plan, u, c) bind(c, name='viscovib_transform')
      import :: c_double, c_double_complex, c_ptr
      type(c_ptr), value :: plan
      real(c_double), intent(in) :: u(*)
      complex(c_double_complex), intent(out) :: c(*)
    end subroutine transform

    subroutine transform_back(plan, c, u) &
      bind(c, name='viscovib_transform_back')
      import :: c_double, c_double_complex, c_ptr
      type(c_ptr), value :: plan
      complex(c_double_complex), intent(inout) :: c(*)
      real(c_double), intent(out) :: u(*)
    end subroutine transform_back
  end interface

contains

  !> The next size with a fast plan: other sizes take up to five times as long per sample.
  !! All are even, so that the columns of an array keep its alignment.
  pure integer function quick_size(least) result(n)
    integer, intent(in) :: least
    integer, parameter :: short(12) = [4, 8, 12, 16, 20, 24, 32, 36, 40, 48, 56, 64]
    integer, parameter :: factors(4) = [2, 3, 5, 7]
    integer :: i, rest
    n = short(findloc(short >= min(least, 64), .true., 1))
    if (n >= least) return
    n = 8*((least + 7)/8)
    do
      rest = n
      do i = 1, size(factors)
        do while (mod(rest, factors(i)) == 0)
          rest = rest/factors(i)
        end do
      end do
      if (rest == 1) return
      n = n + 8
    end do
  end function quick_size

  subroutine find_plans(n, plans, status)
    !> Samples along each axis, 1 along missing axes.
    integer, intent(in) :: n(3)
    type(grid_plans), intent(out) :: plans
    type(status_type), intent(out) :: status
    real(wp), allocatable :: u(:)
    complex(wp), allocatable :: box(:)
    integer :: i

    call lock_planner()
    do i = 1, n_shapes
      if (all(known(i)%n == n)) plans = known(i)
    end do
    if (plans%n(1) == 0 .and. n_shapes < max_shapes) then
      allocate (u(product(n)), box((n(1)/2 + 1)*n(2)*n(3)))
      plans%forward = plan_box(n(3), n(2), n(1), u, box)
      plans%backward = plan_box_back(n(3), n(2), n(1), box, u)
      plans%n = n
      n_shapes = n_shapes + 1
      known(n_shapes) = plans
    end if
    call unlock_planner()
    if (plans%n(1) == 0) then
      call fail(status, status_input_error, 'orders', 'orders: '//show(max_shapes) &
                //' shapes of grids have been used, must be no more')
    end if
  end subroutine find_plans

  !> Samples from the box, which is overwritten.
  subroutine to_grid(plans, box, u)
    type(grid_plans), intent(in) :: plans
    !> Allocated, shape ((n_1/2 + 1) n_2 n_3).
    complex(wp), intent(inout), contiguous :: box(:)
    !> Shape (product(n)).
    real(wp), intent(out), target, contiguous :: u(:)
    real(wp), allocatable :: copy(:)
    if (aligned(c_loc(u))) then
      call transform_back(plans%backward, box, u)
    else
      allocate (copy(size(u)))
      call transform_back(plans%backward, box, copy)
      u = copy
    end if
  end subroutine to_grid

  subroutine from_grid(plans, u, box)
    type(grid_plans), intent(in) :: plans
    real(wp), intent(in), target, contiguous :: u(:)
    complex(wp), intent(out), contiguous :: box(:)
    real(wp), allocatable :: copy(:)
    if (aligned(c_loc(u))) then
      call transform(plans%forward, u, box)
    else
      allocate (copy, source=u)
      call transform(plans%forward, copy, box)
    end if
  end subroutine from_grid

  logical function aligned(at)
    type(c_ptr), intent(in) :: at
    aligned = mod(transfer(at, 0_c_intptr_t), alignment) == 0
  end function aligned

end module viscovib_grid_fourier
