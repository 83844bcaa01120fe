! Optimize: -O3
!> The accelerations at the nodes of a collocation step by Newton's method, for systems with
!! derivatives.
!!
!! With the states q, v that accelerations f give at the nodes (h^2 A_q and h A being the sums over
!! nodes), the equations are f = a(q, v). With r = a - f a step is f + (1 - M)^(-1) r,
!!
!!   M d = (da/dq) h^2 A_q d + (da/dv) h A d,
!!
!! so that f becomes a + M r + M^2 r + ..., summed until the terms are small compared with the error
!! of the Newton step. Each term costs only the sums over nodes, much less than a law.
module viscovib_node_newton
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: max_dof, most_sloped, n_lanes
  use viscovib_node_kernels, only: lane_sum, node_states
  implicit none
  private

  public :: newton_nodes, step_start

  !> Largest number of Newton steps, and of terms of the series of one step.
  integer, parameter :: max_steps = 8, max_terms = 30
  !> Number of terms that may grow at first, since the matrix may not be normal.
  integer, parameter :: may_grow = 4
  !> A step usually reduces the relative change to its square; the series is summed to
  !! this part of that, and of the tolerance.
  real(wp), parameter :: fine = 0.1_wp
  !> Safety factor of the error estimate from the squares.
  real(wp), parameter :: margin = 10.0_wp

  !> State at the start of a step, coordinates that are not used being 0; sum of the sizes of
  !! accelerations, tolerance of the change of that sum; rounding error of displacements, and the
  !! square of the step.
  type :: step_start
    real(wp) :: q(max_dof) = 0.0_wp, v(max_dof) = 0.0_wp
    real(wp) :: total = 0.0_wp, wanted = 0.0_wp, lost = 0.0_wp, h_2 = 0.0_wp
  end type step_start

contains

  subroutine newton_nodes(system, n, blocks, times, sums, drive, start, f, f_new, q, v, &
                          n_evaluations, converged)
    class(driven_system_type), intent(in) :: system
    integer, intent(in) :: n, blocks
    !> As in `node_states`, for each block; loads.
    real(wp), intent(in) :: times(n_lanes, blocks)
    real(wp), intent(in) :: sums(n_lanes, 2, n_lanes*blocks, blocks)
    real(wp), intent(in) :: drive(n_lanes, max_dof, blocks)
    type(step_start), intent(in) :: start
    real(wp), intent(inout) :: f(n_lanes, max_dof, blocks), f_new(n_lanes, max_dof, blocks)
    real(wp), intent(inout) :: q(n_lanes, max_dof, blocks), v(n_lanes, max_dof, blocks)
    integer(i8), intent(inout) :: n_evaluations
    logical, intent(out) :: converged
    real(wp) :: by_q(n_lanes, most_sloped**2, 2), by_v(n_lanes, most_sloped**2, 2)
    real(wp) :: columns(n_lanes, n_lanes), change, before, left, stiff
    integer :: b, k
    logical :: one, summed

    converged = .false.
    before = 0.0_wp
    one = n == 1 .and. blocks == 1
    do k = 1, max_steps
      change = 0.0_wp
      do b = 1, blocks
        call node_states(blocks, n, times(1, b), sums(1, 1, 1, b), f, start%q, start%v, &
                         q(1, 1, b), v(1, 1, b))
        call system%linearise(q(1, 1, b), v(1, 1, b), drive(1, 1, b), f_new(1, 1, b), &
                              by_q(1, 1, b), by_v(1, 1, b))
      end do
      n_evaluations = n_evaluations + blocks
      do b = 1, blocks
        call part(n, f_new(1, 1, b), f(1, 1, b), change)
      end do
      if (.not. change <= system%range%push) return
      if (k > 2 .and. change > before) then
        ! If accelerations are small differences of large terms, only rounding still changes them.
        ! Stiff forces amplify the rounding of displacements by this factor.
        stiff = max(1.0_wp, start%h_2*maxval(abs(by_q(:, :n**2, :blocks))))
        converged = start%h_2*change <= start%lost*stiff
        return
      end if
      left = max(fine*start%wanted, fine*change*(change/max(start%total, change, start%wanted)))
      if (one) then
        call make_columns(sums, by_q(1, 1, 1), by_v(1, 1, 1), columns)
        call add_one_series(columns, left, system%range%push, f, f_new, summed)
      else
        call add_series(n, blocks, times, sums, by_q, by_v, left, system%range%push, f, f_new, &
                        q, v, summed)
      end if
      if (.not. summed) return
      if (change <= start%wanted) exit
      if (k > 1 .and. left <= start%wanted .and. change <= before) then
        if (margin*change*(change/before)**2 <= start%wanted) exit
      end if
      before = change
    end do
    converged = k <= max_steps
    ! The states at the nodes are needed for interpolation.
    do b = 1, blocks
      call node_states(blocks, n, times(1, b), sums(1, 1, 1, b), f, start%q, start%v, &
                       q(1, 1, b), v(1, 1, b))
    end do
  end subroutine newton_nodes

  !> Replace the old accelerations by the new ones, and those by the differences.
  pure subroutine part(n, new, old, change)
    integer, intent(in) :: n
    real(wp), intent(inout) :: new(n_lanes, n), old(n_lanes, n), change
    real(wp) :: sizes(n_lanes), now
    integer :: d, l

    sizes = 0.0_wp
    do d = 1, n
      !GCC$ unroll 1
      do l = 1, n_lanes
        now = new(l, d)
        new(l, d) = now - old(l, d)
        old(l, d) = now
        sizes(l) = sizes(l) + abs(new(l, d))
      end do
    end do
    change = change + lane_sum(sizes)
  end subroutine part

  !> M of one coordinate in one block, one column per node.
  pure subroutine make_columns(sums, by_q, by_v, columns)
    real(wp), intent(in) :: sums(n_lanes, 2, n_lanes), by_q(n_lanes), by_v(n_lanes)
    real(wp), intent(out) :: columns(n_lanes, n_lanes)
    integer :: j, l
    do j = 1, n_lanes
      !GCC$ unroll 1
      do l = 1, n_lanes
        columns(l, j) = by_q(l)*sums(l, 1, j) + by_v(l)*sums(l, 2, j)
      end do
    end do
  end subroutine make_columns

  !> The series of one coordinate in one block: `add_series` with the matrix M.
  pure subroutine add_one_series(columns, left, most, f, r, summed)
    real(wp), intent(in) :: columns(n_lanes, n_lanes), left, most
    real(wp), intent(inout) :: f(n_lanes), r(n_lanes)
    logical, intent(out) :: summed
    real(wp) :: now(n_lanes), sizes(n_lanes), size_of, before, expected
    integer :: i, l

    summed = .false.
    before = 0.0_wp
    do i = 1, max_terms
      !GCC$ unroll 1
      do l = 1, n_lanes
        now(l) = ((columns(l, 1)*r(1) + columns(l, 2)*r(2)) &
                  + (columns(l, 3)*r(3) + columns(l, 4)*r(4))) &
                 + ((columns(l, 5)*r(5) + columns(l, 6)*r(6)) &
                    + (columns(l, 7)*r(7) + columns(l, 8)*r(8)))
        sizes(l) = abs(now(l))
        f(l) = f(l) + now(l)
      end do
      r = now
      size_of = ((sizes(1) + sizes(5)) + (sizes(3) + sizes(7))) &
                + ((sizes(2) + sizes(6)) + (sizes(4) + sizes(8)))
      if (.not. size_of <= most) return
      if (i > may_grow .and. size_of > before) return
      expected = size_of
      if (i > 1 .and. size_of < before) expected = size_of*(size_of/before)
      summed = expected <= left
      if (summed) return
      before = size_of
    end do
  end subroutine add_one_series

  !> f + M r + M^2 r + ..., with the initial content of `r`.
  pure subroutine add_series(n, blocks, times, sums, by_q, by_v, left, most, f, r, q, v, summed)
    integer, intent(in) :: n, blocks
    real(wp), intent(in) :: times(n_lanes, blocks)
    real(wp), intent(in) :: sums(n_lanes, 2, n_lanes*blocks, blocks)
    real(wp), intent(in) :: by_q(n_lanes, most_sloped**2, 2), by_v(n_lanes, most_sloped**2, 2)
    !> Tolerance of the sum; terms above `most` diverge.
    real(wp), intent(in) :: left, most
    real(wp), intent(inout) :: f(n_lanes, max_dof, blocks), r(n_lanes, max_dof, blocks)
    !> Workspace.
    real(wp), intent(inout) :: q(n_lanes, max_dof, blocks), v(n_lanes, max_dof, blocks)
    logical, intent(out) :: summed
    real(wp) :: nothing(max_dof), size_of, before, expected
    integer :: b, i

    nothing = 0.0_wp
    summed = .false.
    before = 0.0_wp
    do i = 1, max_terms
      size_of = 0.0_wp
      do b = 1, blocks
        call node_states(blocks, n, times(1, b), sums(1, 1, 1, b), r, nothing, nothing, &
                         q(1, 1, b), v(1, 1, b))
      end do
      do b = 1, blocks
        call next_term(n, by_q(1, 1, b), by_v(1, 1, b), q(1, 1, b), v(1, 1, b), r(1, 1, b), &
                       f(1, 1, b), size_of)
      end do
      if (.not. size_of <= most) return
      if (i > may_grow .and. size_of > before) return
      expected = size_of
      if (i > 1 .and. size_of < before) expected = size_of*(size_of/before)
      summed = expected <= left
      if (summed) return
      before = size_of
    end do
  end subroutine add_series

  !> Compute the next term of the series in a block, and add it to the sum.
  pure subroutine next_term(n, by_q, by_v, q, v, term, total, size_of)
    integer, intent(in) :: n
    real(wp), intent(in) :: by_q(n_lanes, n, n), by_v(n_lanes, n, n), q(n_lanes, n), v(n_lanes, n)
    real(wp), intent(inout) :: term(n_lanes, n), total(n_lanes, n), size_of
    real(wp) :: sizes(n_lanes), now(n_lanes)
    integer :: b, d, l

    sizes = 0.0_wp
    do d = 1, n
      now = 0.0_wp
      do b = 1, n
        !GCC$ unroll 1
        do l = 1, n_lanes
          now(l) = now(l) + (by_q(l, d, b)*q(l, b) + by_v(l, d, b)*v(l, b))
        end do
      end do
      !GCC$ unroll 1
      do l = 1, n_lanes
        term(l, d) = now(l)
        total(l, d) = total(l, d) + now(l)
        sizes(l) = sizes(l) + abs(now(l))
      end do
    end do
    size_of = size_of + lane_sum(sizes)
  end subroutine next_term

end module viscovib_node_newton
