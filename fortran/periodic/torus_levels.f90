! Optimize: -O2 -fvect-cost-model=dynamic
!> Harmonic balance on a torus with very many unknowns, by means of one with few unknowns.
!!
!! The orders of the outer shells affect little but themselves: R(x) = 0 is solved by
!!
!!   x <- x - P^-1 R(x),
!!
!! where P contains the derivatives of the balance of the inner orders, factorized once, and for
!! each outer order the contribution of inertia and of the mean derivatives of the forces,
!!
!!   P_k = -w_k^2 - Q_0 - i w_k V_0.
!!
!! Anderson's acceleration (J. ACM 12 (1965) 547; Walker and Ni, SIAM J. Numer. Anal. 49 (2011)
!! 1715) reduces the effect of the terms that P lacks, by the last steps, like GMRES. An iteration
!! costs one residual: no cost grows with the square of the number of unknowns.
module viscovib_torus_levels
  use viscovib_block_factors, only: factorize_blocks
  use viscovib_dense, only: invert, solve
  use viscovib_kinds, only: wp
  use viscovib_outcomes, only: outcome_converged, outcome_diverged, outcome_stalled
  use viscovib_status, only: status_type
  use viscovib_stopping, only: is_set
  use viscovib_torus_balance, only: torus_balance_type
  implicit none
  private

  public :: torus_levels, new_levels, solve_on_levels

  !> Smallest number of unknowns for two levels, and first limit of those of the inner one.
  integer, parameter, public :: many = 100, few = 70
  integer, parameter :: max_iterations = 150, memory = 60
  !> Corrections must shrink by a factor of ten within this number of iterations.
  integer, parameter :: patience = 40
  !> Target for corrections relative to the tolerance, since they only shrink by a factor.
  real(wp), parameter :: below = 1.0e-3_wp
  !> Number of corrections that do not halve before the remainder counts as rounding error.
  integer, parameter :: max_vain = 6
  !> A correction this much larger than the smallest so far means divergence.
  real(wp), parameter :: growth_limit = 1.0e3_wp

  type :: torus_levels
    !> Balance of the inner orders; not `ready` if no inner set is possible.
    type(torus_balance_type) :: inner
    logical :: ready = .false.
    real(wp), allocatable, private :: factors(:, :)
    integer, allocatable, private :: pivots(:)
    !> Inverse of P_k, shape (n_dof, n_dof, n outside).
    complex(wp), allocatable, private :: compliance(:, :, :)
  contains
    procedure :: match
    procedure :: prepare
    procedure :: within
    procedure :: beyond
    procedure :: correction
  end type torus_levels

contains

  !> Create the levels; the inner orders are the first ones of the balance.
  subroutine new_levels(levels, balance, most)
    type(torus_levels), intent(out) :: levels
    type(torus_balance_type), intent(in) :: balance
    !> Largest number of unknowns of the inner balance, if the loads' orders allow it.
    integer, intent(in) :: most
    type(status_type) :: status
    integer :: shells(size(balance%torus%orders, 2)), bound, m, inside

    shells = sum(abs(balance%torus%orders), 1)
    inside = 0
    do bound = maxval(sum(abs(balance%drive_orders), 1)), maxval(shells) - 1
      m = count(shells <= bound)
      if (any(shells(:m) > bound)) exit
      if (inside > 0 .and. balance%n_unknowns(m) > most) exit
      inside = m
    end do
    if (inside == 0) return
    call balance%first_orders(inside, levels%inner, status)
    levels%ready = .not. status%failed()
  end subroutine new_levels

  !> The unknowns of the inner orders.
  pure function within(self, balance, x) result(inner)
    class(torus_levels), intent(in) :: self
    type(torus_balance_type), intent(in) :: balance
    real(wp), intent(in) :: x(:)
    real(wp) :: inner(self%inner%n), y(balance%torus%n, balance%system%n_dof)
    y = balance%expanded(x)
    inner = self%inner%reduced(reshape(y(:self%inner%torus%n, :), &
                                       [self%inner%torus%n*size(y, 2)]))
  end function within

  !> All unknowns from the inner ones; the outer ones are 0.
  pure function beyond(self, balance, inner) result(x)
    class(torus_levels), intent(in) :: self
    type(torus_balance_type), intent(in) :: balance
    real(wp), intent(in) :: inner(:)
    real(wp) :: x(balance%n), y(balance%torus%n, balance%system%n_dof)
    y = 0.0_wp
    y(:self%inner%torus%n, :) = self%inner%expanded(inner)
    x = balance%reduced(reshape(y, [size(y)]))
  end function beyond

  !> Copy the loads and the parameter of the whole balance to the inner one.
  subroutine match(self, balance)
    class(torus_levels), intent(inout) :: self
    type(torus_balance_type), intent(in) :: balance
    self%inner%omega = balance%omega
    self%inner%amplitude = balance%amplitude
    self%inner%factor = balance%factor
    self%inner%vary = balance%vary
    self%inner%which = balance%which
    self%inner%lowest = balance%lowest
  end subroutine match

  !> Compute P near the solution x.
  subroutine prepare(self, balance, p, x, made)
    class(torus_levels), intent(inout) :: self
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, x(:)
    logical, intent(out) :: made
    complex(wp) :: stiffness(balance%system%n_dof, balance%system%n_dof)
    real(wp), dimension(balance%system%n_dof, balance%system%n_dof) :: by_q, by_v
    real(wp) :: w(size(balance%torus%orders, 2))
    real(wp), allocatable :: r(:), slope(:)
    integer :: d, i, k, n, m
    logical :: singular

    n = self%inner%n
    m = size(self%inner%torus%orders, 2)
    d = balance%system%n_dof
    if (.not. allocated(self%factors)) then
      allocate (self%factors(n, n), self%pivots(n), self%compliance(d, d, size(w) - m))
    end if
    allocate (r(n), slope(n))
    call self%match(balance)
    call self%inner%equations(self%within(balance, x), p, r, self%factors, slope, made)
    if (.not. made) return
    call factorize_blocks(n, self%factors, self%pivots, singular)
    made = .not. singular
    if (.not. made) return
    call balance%set_parameter(p)
    w = balance%torus%frequencies(balance%omega)
    call self%inner%mean_slopes(by_q, by_v)
    do k = m + 1, size(w)
      stiffness = -cmplx(by_q, w(k)*by_v, wp)
      do i = 1, d
        stiffness(i, i) = stiffness(i, i) - w(k)**2
      end do
      call invert(stiffness, self%compliance(:, :, k - m), singular)
      made = made .and. .not. singular
    end do
  end subroutine prepare

  !> Replace r by -P^-1 r.
  subroutine correction(self, balance, r)
    class(torus_levels), intent(in) :: self
    type(torus_balance_type), intent(in) :: balance
    real(wp), intent(inout) :: r(:)
    real(wp) :: y(balance%torus%n, balance%system%n_dof), inner(self%inner%n)
    complex(wp) :: x(balance%system%n_dof)
    integer :: k, m

    y = balance%expanded(r)
    m = size(self%inner%torus%orders, 2)
    inner = self%within(balance, r)
    call solve(self%inner%n, self%factors, self%pivots, inner)
    y(:self%inner%torus%n, :) = self%inner%expanded(inner)
    do k = m + 1, size(balance%torus%orders, 2)
      x = matmul(self%compliance(:, :, k - m), cmplx(y(2*k - 2, :), y(2*k - 1, :), wp))
      y(2*k - 2, :) = real(x)
      y(2*k - 1, :) = aimag(x)
    end do
    r = -balance%reduced(reshape(y, [size(y)]))
  end subroutine correction

  !> Solve from x, near a solution; x is unchanged unless the outcome is converged.
  subroutine solve_on_levels(levels, balance, p, tolerance, x, outcome, iterations, cancel, part)
    type(torus_levels), intent(inout) :: levels
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p
    !> Tolerance: largest component of the last correction, relative to the largest component of x.
    real(wp), intent(in) :: tolerance
    real(wp), intent(inout) :: x(:)
    integer, intent(out) :: outcome
    !> Iterations are added to it.
    integer, intent(inout) :: iterations
    !> May be set by another thread to cancel the solution, with outcome stalled.
    integer, intent(inout), optional :: cancel
    !> Also end if a correction is less than this fraction of the total change of x.
    real(wp), intent(in), optional :: part
    real(wp), allocatable :: new(:), step(:), last_new(:), last_step(:)
    !> Orthonormal basis of the changes of steps, and the corresponding moves.
    real(wp), allocatable :: basis(:, :), moves(:, :)
    real(wp) :: change, smallest, norm, aim
    integer :: k, kept, vain
    logical :: inside, near_enough

    outcome = outcome_diverged
    call levels%prepare(balance, p, x, inside)
    if (.not. inside) return
    allocate (new, source=x)
    allocate (step(balance%n), basis(balance%n, memory), moves(balance%n, memory))
    kept = 0
    smallest = sqrt(huge(1.0_wp))
    aim = smallest
    vain = 0
    near_enough = .false.
    do k = 1, max_iterations
      if (is_set(cancel)) exit
      call balance%residual(new, p, step, inside)
      if (.not. inside) return
      call levels%correction(balance, step)
      iterations = iterations + 1
      change = maxval(abs(step))
      norm = maxval(abs(new))
      if (.not. change <= growth_limit*smallest) return
      if (present(part)) then
        near_enough = change <= part*maxval(abs(new - x))
      end if
      vain = merge(0, vain + 1, change < 0.5_wp*smallest)
      if (near_enough .or. change <= below*tolerance*norm &
          .or. (change <= tolerance*norm .and. vain >= max_vain)) then
        x = new + step
        outcome = outcome_converged
        return
      end if
      smallest = min(smallest, change)
      if (mod(k, patience) == 1) then
        if (smallest > aim) exit
        aim = 0.1_wp*smallest
      end if
      if (k > 1) call remember(kept, step - last_step, new - last_new, basis, moves)
      last_new = new
      last_step = step
      call accelerate(kept, basis, moves, step)
      new = last_new + step
    end do
    outcome = outcome_stalled
  end subroutine solve_on_levels

  !> Add a change of the steps and the move that caused it. The stored ones are deleted if the
  !! arrays are full or if they already predict the change: they then belong to other locations.
  pure subroutine remember(m, change, move, basis, moves)
    integer, intent(inout) :: m
    real(wp), intent(in) :: change(:), move(:)
    real(wp), intent(inout) :: basis(:, :), moves(:, :)
    !> A change is dependent if its squared norm after projection is below this fraction.
    real(wp), parameter :: dependent = 1.0e-8_wp
    real(wp) :: along, length
    integer :: i

    if (m == size(basis, 2)) m = 0
    m = m + 1
    basis(:, m) = change
    moves(:, m) = move
    do i = 1, m - 1
      along = sum(basis(:, i)*basis(:, m))
      basis(:, m) = basis(:, m) - along*basis(:, i)
      moves(:, m) = moves(:, m) - along*moves(:, i)
    end do
    length = sum(basis(:, m)**2)
    if (.not. length > dependent*sum(change**2)) then
      m = 1
      basis(:, m) = change
      moves(:, m) = move
      length = sum(change**2)
    end if
    if (length > 0.0_wp) then
      basis(:, m) = basis(:, m)/sqrt(length)
      moves(:, m) = moves(:, m)/sqrt(length)
    else
      m = 0
    end if
  end subroutine remember

  !> Minimize the step over combinations of the stored moves, and add the minimizing move.
  pure subroutine accelerate(m, basis, moves, step)
    integer, intent(in) :: m
    real(wp), intent(in) :: basis(:, :), moves(:, :)
    real(wp), intent(inout) :: step(:)
    real(wp) :: along(m)
    integer :: i
    do i = 1, m
      along(i) = sum(basis(:, i)*step)
      step = step - along(i)*basis(:, i)
    end do
    do i = 1, m
      step = step - along(i)*moves(:, i)
    end do
  end subroutine accelerate

end module viscovib_torus_levels
