! Optimize: -O2
!> Taylor series in time of polynomial systems without memory and with function laws, for many
!! trajectories at once in four blocks of vector lanes.
!!
!! With q = sum_k q_k (t/h)^k over a step h,
!!
!!   q_(k+1) = h v_k/(k + 1),  v_(k+1) = h a_k/(k + 1).
!!
!! a_k is the coefficient of the acceleration: a weighted sum of registers for springs, dampers,
!! both parts of each load order, and forces, which a `series_program` computes. Final sums and
!! multiples of a law are merged into the sum of the acceleration.
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

  !> Largest number of coordinates for merging sums. With more equations each sum would be repeated.
  integer, parameter :: most_apart = 3

  type :: motion_series
    integer :: n_dof = 0
    type(series_program) :: program
    !> Orders of the load. Their sines and cosines are in the registers after `before_loads`.
    integer, allocatable, private :: orders(:)
    integer, private :: before_loads = 0
    !> Terms of the accelerations: equation d uses the registers from ends(d - 1) + 1 to ends(d).
    !! `work` contains their weights in all blocks, shape (n_wide, n_terms), from `first` on,
    !! aligned to a cache line.
    integer, allocatable, private :: ends(:), registers(:)
    integer, private :: first = 1
    real(wp), allocatable, private :: work(:)
  contains
    procedure :: expand
    procedure, private :: start_loads
    procedure, private :: turn_loads
  end type motion_series

contains

  !> Series for blocks of trajectories that differ only in their parameters.
  subroutine new_motion_series(series, motions, known)
    type(motion_series), intent(out) :: series
    !> At most one motion per block.
    type(lane_motion_type), intent(in) :: motions(:)
    !> True if all functions of the laws have series here.
    logical, intent(out) :: known
    integer, allocatable :: products(:)
    integer :: i, m, n

    n = motions(1)%n_dof
    m = size(motions(1)%monomials)
    series%n_dof = n
    series%orders = motions(1)%orders
    series%program%n_registers = 2*n
    allocate (series%program%steps(0), products(m + size(motions(1)%laws)))
    do i = 1, m
      associate (term => motions(1)%monomials(i))
        call series%program%add_monomial(term%dof, term%power, products(i))
      end associate
    end do
    known = .true.
    do i = 1, size(motions(1)%laws)
      associate (law => motions(1)%laws(i))
        call series%program%add_law(law%program, numbers_of(motions, i), law%arguments, &
                                    law%rates, products(m + i), known)
      end associate
      if (.not. known) return
    end do
    series%before_loads = series%program%n_registers
    call take_terms(series, motions, products)
    call series%program%leave_out_unused(series%registers)
    series%program%n_registers = series%before_loads + 2*size(series%orders)
  end subroutine new_motion_series

  !> Registers and weights of the accelerations.
  subroutine take_terms(series, motions, products)
    type(motion_series), intent(inout) :: series
    type(lane_motion_type), intent(in) :: motions(:)
    !> Registers of monomials, then of laws.
    integer, intent(in) :: products(:)
    integer, allocatable :: registers(:), places(:)
    real(wp), allocatable :: factors(:, :), plain(:, :), kept(:, :)
    integer :: d, j, k, n

    n = series%n_dof
    allocate (series%ends(0:n), source=0)
    allocate (series%registers(0), kept(n_wide, 0))
    do d = 1, n
      plain = weights_of(motions, d)
      registers = [([j, n + j], j=1, n), (series%before_loads + j, j=1, 2*size(series%orders)), &
                   products]
      call series%program%take_apart(n <= most_apart, registers, places, factors)
      do k = 1, size(registers)
        factors(:, k) = factors(:, k)*plain(:, places(k))
        if (all(abs(factors(:, k)) <= 0.0_wp)) cycle
        series%registers = [series%registers, registers(k)]
        kept = reshape([kept, factors(:, k)], [n_wide, size(series%registers)])
      end do
      series%ends(d) = size(series%registers)
    end do
    allocate (series%work(size(kept) + alignment_slack), source=0.0_wp)
    series%first = first_aligned(series%work)
    series%work(series%first:series%first + size(kept) - 1) = [kept]
  end subroutine take_terms

  !> Constants of law i in every vector lane. Idle blocks repeat the first block.
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

  !> Weights in equation d: stiffness and damping of each coordinate, both parts of each load order,
  !! then products. In every vector lane; 0 in idle blocks.
  pure function weights_of(motions, d) result(weights)
    type(lane_motion_type), intent(in) :: motions(:)
    integer, intent(in) :: d
    real(wp), allocatable :: weights(:, :)
    integer :: b, first, j, k, last, n

    n = motions(1)%n_dof
    associate (m => size(motions(1)%weights, 3), laws => size(motions(1)%law_weights, 3))
      allocate (weights(n_wide, 2*n + m + laws + 2*size(motions(1)%orders)), source=0.0_wp)
      do b = 1, size(motions)
        first = n_lanes*(b - 1) + 1
        last = n_lanes*b
        do j = 1, n
          weights(first:last, 2*j - 1) = -motions(b)%stiffness(:, d, j)
          weights(first:last, 2*j) = -motions(b)%damping(:, d, j)
        end do
        k = 2*n
        do j = 1, size(motions(b)%orders)
          weights(first:last, k + 2*j - 1) = motions(b)%real_load(:, d, j)
          weights(first:last, k + 2*j) = motions(b)%load(:, d, j)
        end do
        k = k + 2*size(motions(b)%orders)
        weights(first:last, k + 1:k + m) = -motions(b)%weights(:, d, :)
        weights(first:last, k + m + 1:) = -motions(b)%law_weights(:, d, :)
      end do
    end associate
  end function weights_of

  !> Coefficients 1 ... order of coordinates and velocities over a step, from those of order 0.
  pure subroutine expand(self, order, h, turning, cosine, sine, s, lost)
    class(motion_series), intent(in) :: self
    integer, intent(in) :: order
    !> Step sizes; phase change of the load over a step; cosine and sine of the phase at the start.
    real(wp), intent(in), dimension(n_wide) :: h, turning, cosine, sine
    !> All registers: coordinates, velocities, then the others.
    real(wp), intent(inout) :: s(n_wide, 0:order, self%program%n_registers)
    !> Vector lanes in which a force has no series.
    logical, intent(out) :: lost(n_wide)
    integer :: d, k, n_terms

    lost = .false.
    call self%start_loads(order, cosine, sine, s)
    do k = 0, order - 1
      call run_series(size(self%program%steps), self%program%steps, order, k, s, lost)
      do d = 1, self%n_dof
        n_terms = self%ends(d) - self%ends(d - 1)
        call next_terms(self%n_dof, n_terms, self%registers(self%ends(d - 1) + 1:self%ends(d)), &
                        order, k, d, h, self%work(self%first + n_wide*self%ends(d - 1)), s)
      end do
      if (size(self%orders) > 0) call self%turn_loads(order, k, turning, s)
    end do
  end subroutine expand

  !> Coefficients k + 1 of a coordinate and its velocity, with four interleaved sums.
  pure subroutine next_terms(n, n_terms, registers, order, k, d, h, weights, s)
    integer, intent(in) :: n, n_terms, registers(n_terms), order, k, d
    real(wp), intent(in) :: h(n_lanes, n_blocks), weights(n_lanes, n_blocks, n_terms)
    real(wp), intent(inout) :: s(n_lanes, n_blocks, 0:order, *)
    real(wp), dimension(n_lanes) :: a1, a2, a3, a4
    real(wp) :: part
    integer :: j, p

    part = 1.0_wp/(k + 1)
    do p = 1, n_blocks, 4
      a1 = 0.0_wp
      a2 = 0.0_wp
      a3 = 0.0_wp
      a4 = 0.0_wp
      do j = 1, n_terms
        call add_product(a1, weights(1, p, j), s(1, p, k, registers(j)))
        call add_product(a2, weights(1, p + 1, j), s(1, p + 1, k, registers(j)))
        call add_product(a3, weights(1, p + 2, j), s(1, p + 2, k, registers(j)))
        call add_product(a4, weights(1, p + 3, j), s(1, p + 3, k, registers(j)))
      end do
      call integrate(part, h(1, p), a1, s(1, p, k + 1, n + d))
      call integrate(part, h(1, p + 1), a2, s(1, p + 1, k + 1, n + d))
      call integrate(part, h(1, p + 2), a3, s(1, p + 2, k + 1, n + d))
      call integrate(part, h(1, p + 3), a4, s(1, p + 3, k + 1, n + d))
    end do
    do p = 1, n_blocks
      call integrate(part, h(1, p), s(1, p, k, n + d), s(1, p, k + 1, d))
    end do
  end subroutine next_terms

  !> sin and cos of each order at the start of the step, by rotation.
  pure subroutine start_loads(self, order, cosine, sine, s)
    class(motion_series), intent(in) :: self
    integer, intent(in) :: order
    real(wp), intent(in), dimension(n_wide) :: cosine, sine
    real(wp), intent(inout) :: s(n_wide, 0:order, *)
    real(wp), dimension(n_wide) :: now, other, before
    integer :: j, turns

    turns = 0
    now = 1.0_wp
    other = 0.0_wp
    do j = 1, size(self%orders)
      do while (turns < self%orders(j))
        before = now
        now = before*cosine - other*sine
        other = other*cosine + before*sine
        turns = turns + 1
      end do
      s(:, 0, self%before_loads + 2*j - 1) = other
      s(:, 0, self%before_loads + 2*j) = now
    end do
  end subroutine start_loads

  !> Coefficients k + 1 of the load's sines and cosines.
  pure subroutine turn_loads(self, order, k, turning, s)
    class(motion_series), intent(in) :: self
    integer, intent(in) :: order, k
    real(wp), intent(in) :: turning(n_wide)
    real(wp), intent(inout) :: s(n_wide, 0:order, *)
    integer :: j
    do j = 1, size(self%orders)
      associate (sine => self%before_loads + 2*j - 1, cosine => self%before_loads + 2*j)
        call turn_on(self%orders(j)/real(k + 1, wp), turning, s(1, k, sine), s(1, k, cosine), &
                     s(1, k + 1, sine), s(1, k + 1, cosine))
      end associate
    end do
  end subroutine turn_loads

  !> Next coefficients of a sine and a cosine.
  pure subroutine turn_on(part, turning, sine, cosine, next_sine, next_cosine)
    real(wp), intent(in) :: part
    real(wp), intent(in), dimension(n_wide) :: turning, sine, cosine
    real(wp), intent(out), dimension(n_wide) :: next_sine, next_cosine
    real(wp) :: by
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_wide
      by = part*turning(l)
      next_sine(l) = by*cosine(l)
      next_cosine(l) = -by*sine(l)
    end do
  end subroutine turn_on

  !> total + x y, as in `viscovib_wide_series`; repeated here so that the compiler inlines it.
  pure subroutine add_product(total, x, y)
    real(wp), intent(inout) :: total(n_lanes)
    real(wp), intent(in) :: x(n_lanes), y(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = total(l) + x(l)*y(l)
    end do
  end subroutine add_product

  !> Next coefficient of an integral, limited to finite numbers.
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
