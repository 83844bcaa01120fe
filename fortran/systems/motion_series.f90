!> Polynomial systems without memory, with laws of functions, as power series in time: many motions
!! side by side, four blocks of lanes.
!!
!! With q = sum_k q_k (t/h)^k over a step h,
!!
!!   q_(k+1) = h v_k/(k + 1),  v_(k+1) = h a_k/(k + 1),
!!
!! a_k being the coefficient of the acceleration, in which loads, springs and dampers are linear and
!! forces are products that a `series_program` finds.
module viscovib_motion_series
  use viscovib_aligned, only: alignment_slack, first_aligned
  use viscovib_kinds, only: wp
  use viscovib_lane_motion, only: lane_motion_type
  use viscovib_lanes, only: n_lanes
  use viscovib_series_program, only: series_program
  use viscovib_series_terms, only: run_series
  use viscovib_wide_series, only: largest, n_blocks, n_wide
  implicit none
  private

  public :: motion_series, new_motion_series

  type :: motion_series
    integer :: n_dof = 0
    type(series_program) :: program
    !> Registers of the products, monomials before laws; orders of the load.
    integer, allocatable, private :: products(:), orders(:)
    !> For each equation the numbers of what its acceleration is a sum of, as in `lane_motion_type`,
    !! of all blocks: stiffness and damping of each coordinate, weights of the products, both parts
    !! of the load; shape (n_wide, n_terms, n_dof) from `first` on, on a cache line.
    integer, private :: n_terms = 0, first = 1
    real(wp), allocatable, private :: room(:)
  contains
    procedure :: expand
  end type motion_series

contains

  !> Of blocks of motions that differ in their numbers only.
  subroutine new_motion_series(series, motions, known)
    type(motion_series), intent(out) :: series
    !> As many as there are blocks, or less.
    type(lane_motion_type), intent(in) :: motions(:)
    !> Whether all functions of the laws have series here.
    logical, intent(out) :: known
    integer :: b, i, m, n

    n = motions(1)%n_dof
    m = size(motions(1)%monomials)
    series%n_dof = n
    series%orders = motions(1)%orders
    series%program%n_registers = 2*n
    allocate (series%program%steps(0), series%products(m + size(motions(1)%laws)))
    do i = 1, m
      associate (term => motions(1)%monomials(i))
        call series%program%add_monomial(term%dof, term%power, series%products(i))
      end associate
    end do
    known = .true.
    do i = 1, size(motions(1)%laws)
      associate (law => motions(1)%laws(i))
        call series%program%add_law(law%program, numbers_of(motions, i), law%arguments, &
                                    law%rates, series%products(m + i), known)
      end associate
      if (.not. known) return
    end do
    series%n_terms = 2*n + size(series%products) + 2*size(series%orders)
    allocate (series%room(n_wide*series%n_terms*n + alignment_slack), source=0.0_wp)
    series%first = first_aligned(series%room)
    do b = 1, min(size(motions), n_blocks)
      call furnish(motions(b), b, n, series%n_terms, series%room(series%first))
    end do
  end subroutine new_motion_series

  !> Numbers that law i puts on its stack, in every lane; in idle blocks those of the first.
  pure function numbers_of(motions, i) result(numbers)
    type(lane_motion_type), intent(in) :: motions(:)
    integer, intent(in) :: i
    real(wp) :: numbers(n_wide, size(motions(1)%laws(i)%program%code))
    integer :: b, first

    do b = 1, n_blocks
      first = n_lanes*(b - 1) + 1
      associate (program => motions(merge(b, 1, b <= size(motions)))%laws(i)%program)
        if (allocated(program%of_lanes)) then
          numbers(first:first + n_lanes - 1, :) = program%of_lanes
        else
          numbers(first:first + n_lanes - 1, :) = spread(program%number, 1, n_lanes)
        end if
      end associate
    end do
  end function numbers_of

  !> The numbers of a block.
  pure subroutine furnish(motion, block, n, n_terms, terms)
    type(lane_motion_type), intent(in) :: motion
    integer, intent(in) :: block, n, n_terms
    real(wp), intent(inout) :: terms(n_lanes, n_blocks, n_terms, n)
    integer :: d, j, k

    do d = 1, n
      do j = 1, n
        terms(:, block, 2*j - 1, d) = -motion%stiffness(:, d, j)
        terms(:, block, 2*j, d) = -motion%damping(:, d, j)
      end do
      k = 2*n
      do j = 1, size(motion%weights, 3)
        terms(:, block, k + j, d) = -motion%weights(:, d, j)
      end do
      k = k + size(motion%weights, 3)
      do j = 1, size(motion%law_weights, 3)
        terms(:, block, k + j, d) = -motion%law_weights(:, d, j)
      end do
      k = k + size(motion%law_weights, 3)
      do j = 1, size(motion%load, 3)
        terms(:, block, k + 2*j - 1, d) = motion%real_load(:, d, j)
        terms(:, block, k + 2*j, d) = motion%load(:, d, j)
      end do
    end do
  end subroutine furnish

  !> Coefficients 1 ... order of coordinates and velocities over a step, from those of order 0.
  pure subroutine expand(self, order, h, turning, cosine, sine, s, lost)
    class(motion_series), intent(in) :: self
    integer, intent(in) :: order
    !> Steps; how far the load's phase turns in them; its cosine and sine at the start.
    real(wp), intent(in), dimension(n_wide) :: h, turning, cosine, sine
    !> All registers, first coordinates, then velocities.
    real(wp), intent(inout) :: s(n_wide, 0:order, self%program%n_registers)
    !> Lanes in which a force has no series.
    logical, intent(out) :: lost(n_wide)
    !> sin and cos of each order of the load.
    real(wp) :: loads(n_wide, 2, size(self%orders))
    integer :: d, j, k

    lost = .false.
    call loads_at_start(self%orders, cosine, sine, loads)
    do k = 0, order - 1
      call run_series(size(self%program%steps), self%program%steps, order, k, s, lost)
      do d = 1, self%n_dof
        call next_terms(self%n_dof, self%products, size(self%orders), order, k, d, h, &
                        self%room(self%first + n_wide*self%n_terms*(d - 1)), loads, s)
      end do
      do j = 1, size(self%orders)
        call turn_on(self%orders(j)/real(k + 1, wp), turning, loads(1, 2, j), loads(1, 1, j))
      end do
    end do
  end subroutine expand

  !> Coefficients k + 1 of a coordinate and its velocity; blocks by turns, so that no sum waits.
  pure subroutine next_terms(n, products, n_orders, order, k, d, h, terms, loads, s)
    integer, intent(in) :: n, products(:), n_orders, order, k, d
    real(wp), intent(in) :: h(n_lanes, n_blocks), terms(n_lanes, n_blocks, *)
    real(wp), intent(in) :: loads(n_lanes, n_blocks, 2*n_orders)
    real(wp), intent(inout) :: s(n_lanes, n_blocks, 0:order, *)
    real(wp), dimension(n_lanes) :: a1, a2, a3, a4
    real(wp) :: part
    integer :: j, m

    part = 1.0_wp/(k + 1)
    m = 2*n + size(products)
    a1 = 0.0_wp
    a2 = 0.0_wp
    a3 = 0.0_wp
    a4 = 0.0_wp
    do j = 1, n
      call add_product(a1, terms(1, 1, 2*j - 1), s(1, 1, k, j))
      call add_product(a2, terms(1, 2, 2*j - 1), s(1, 2, k, j))
      call add_product(a3, terms(1, 3, 2*j - 1), s(1, 3, k, j))
      call add_product(a4, terms(1, 4, 2*j - 1), s(1, 4, k, j))
      call add_product(a1, terms(1, 1, 2*j), s(1, 1, k, n + j))
      call add_product(a2, terms(1, 2, 2*j), s(1, 2, k, n + j))
      call add_product(a3, terms(1, 3, 2*j), s(1, 3, k, n + j))
      call add_product(a4, terms(1, 4, 2*j), s(1, 4, k, n + j))
    end do
    do j = 1, size(products)
      call add_product(a1, terms(1, 1, 2*n + j), s(1, 1, k, products(j)))
      call add_product(a2, terms(1, 2, 2*n + j), s(1, 2, k, products(j)))
      call add_product(a3, terms(1, 3, 2*n + j), s(1, 3, k, products(j)))
      call add_product(a4, terms(1, 4, 2*n + j), s(1, 4, k, products(j)))
    end do
    do j = 1, 2*n_orders
      call add_product(a1, terms(1, 1, m + j), loads(1, 1, j))
      call add_product(a2, terms(1, 2, m + j), loads(1, 2, j))
      call add_product(a3, terms(1, 3, m + j), loads(1, 3, j))
      call add_product(a4, terms(1, 4, m + j), loads(1, 4, j))
    end do
    call integrate(part, h(1, 1), s(1, 1, k, n + d), s(1, 1, k + 1, d))
    call integrate(part, h(1, 2), s(1, 2, k, n + d), s(1, 2, k + 1, d))
    call integrate(part, h(1, 3), s(1, 3, k, n + d), s(1, 3, k + 1, d))
    call integrate(part, h(1, 4), s(1, 4, k, n + d), s(1, 4, k + 1, d))
    call integrate(part, h(1, 1), a1, s(1, 1, k + 1, n + d))
    call integrate(part, h(1, 2), a2, s(1, 2, k + 1, n + d))
    call integrate(part, h(1, 3), a3, s(1, 3, k + 1, n + d))
    call integrate(part, h(1, 4), a4, s(1, 4, k + 1, n + d))
  end subroutine next_terms

  !> sin and cos of each order at the start, by rotation.
  pure subroutine loads_at_start(orders, cosine, sine, loads)
    integer, intent(in) :: orders(:)
    real(wp), intent(in), dimension(n_wide) :: cosine, sine
    real(wp), intent(out) :: loads(n_wide, 2, size(orders))
    real(wp), dimension(n_wide) :: now, other, before
    integer :: j, order

    order = 0
    now = 1.0_wp
    other = 0.0_wp
    do j = 1, size(orders)
      do while (order < orders(j))
        before = now
        now = before*cosine - other*sine
        other = other*cosine + before*sine
        order = order + 1
      end do
      loads(:, 1, j) = other
      loads(:, 2, j) = now
    end do
  end subroutine loads_at_start

  !> The next coefficients of cos and sin.
  pure subroutine turn_on(part, turning, c, s)
    real(wp), intent(in) :: part, turning(n_wide)
    real(wp), intent(inout) :: c(n_wide), s(n_wide)
    real(wp) :: by, before
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_wide
      by = part*turning(l)
      before = c(l)
      c(l) = -by*s(l)
      s(l) = by*before
    end do
  end subroutine turn_on

  !> total + x y: as in `viscovib_wide_series`, here so that it is made part of the loop above.
  pure subroutine add_product(total, x, y)
    real(wp), intent(inout) :: total(n_lanes)
    real(wp), intent(in) :: x(n_lanes), y(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = total(l) + x(l)*y(l)
    end do
  end subroutine add_product

  !> The next coefficient of an integral; what runs away stays a number.
  pure subroutine integrate(part, h, rate, next)
    real(wp), intent(in) :: part, h(n_lanes), rate(n_lanes)
    real(wp), intent(out) :: next(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      next(l) = min(max(h(l)*part*rate(l), -largest), largest)
    end do
  end subroutine integrate

end module viscovib_motion_series
