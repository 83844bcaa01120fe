!> Harmonic balance on a torus with very many unknowns, by way of one with few.
!!
!! The orders of the outer shells move little else but themselves: R(x) = 0 is solved by
!!
!!   x <- x - P^-1 R(x),
!!
!! P being the derivatives of the balance of the inner orders, factorized once, and for each
!! order outside what inertia and the mean of the forces' derivatives make of it,
!!
!!   P_k = -w_k^2 - Q_0 - i w_k V_0.
!!
!! Anderson's acceleration (J. ACM 12 (1965) 547; Walker and Ni, SIAM J. Numer. Anal. 49
!! (2011) 1715) takes the part that P misses out of the last steps, as GMRES would. An
!! iteration costs a residual: nothing grows with the square of the unknowns.
module viscovib_torus_levels
  use viscovib_dense, only: factorize_blocks, invert, solve
  use viscovib_kinds, only: wp
  use viscovib_outcomes, only: outcome_converged, outcome_diverged, outcome_stalled
  use viscovib_status, only: status_type
  use viscovib_torus_balance, only: torus_balance_type
  implicit none
  private

  public :: torus_levels, new_levels, solve_on_levels

  !> Unknowns from which two levels pay, and of the inner one at most.
  integer, parameter, public :: many = 140
  integer, parameter :: few = 130
  integer, parameter :: max_iterations = 40, memory = 12
  !> Corrections go on to this part of the tolerance, as they shrink by a factor only.
  real(wp), parameter :: below = 1.0e-3_wp
  !> A correction this much larger than the smallest so far leads away.
  real(wp), parameter :: growth_limit = 30.0_wp

  type :: torus_levels
    !> Of the inner orders; without any if there is no room between few and all.
    type(torus_balance_type) :: inner
    logical :: ready = .false.
    real(wp), allocatable, private :: factors(:, :)
    integer, allocatable, private :: pivots(:)
    !> Inverse of P_k, shape (n_dof, n_dof, n outside).
    complex(wp), allocatable, private :: compliance(:, :, :)
  contains
    procedure :: match
    procedure, private :: prepare
    procedure :: within
    procedure :: beyond
    procedure, private :: correction
  end type torus_levels

contains

  !> The inner orders are the first ones of the balance.
  subroutine new_levels(levels, balance)
    type(torus_levels), intent(out) :: levels
    type(torus_balance_type), intent(in) :: balance
    type(status_type) :: status
    integer :: shells(size(balance%torus%orders, 2)), bound, m, inside

    shells = sum(abs(balance%torus%orders), 1)
    inside = 0
    do bound = maxval(sum(abs(balance%drive_orders), 1)), maxval(shells) - 1
      m = count(shells <= bound)
      if (any(shells(:m) > bound)) exit
      if (inside > 0 .and. balance%n_unknowns(m) > few) exit
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

  !> All unknowns from the inner ones, the others 0.
  pure function beyond(self, balance, inner) result(x)
    class(torus_levels), intent(in) :: self
    type(torus_balance_type), intent(in) :: balance
    real(wp), intent(in) :: inner(:)
    real(wp) :: x(balance%n), y(balance%torus%n, balance%system%n_dof)
    y = 0.0_wp
    y(:self%inner%torus%n, :) = self%inner%expanded(inner)
    x = balance%reduced(reshape(y, [size(y)]))
  end function beyond

  !> Give the inner balance the loads of the whole one, and what varies.
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

  !> P near the solution x.
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

  !> -P^-1 r.
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

  !> From x on, near a solution; x is left as it was found unless the outcome is converged.
  subroutine solve_on_levels(levels, balance, p, tolerance, x, outcome, iterations, cancel)
    type(torus_levels), intent(inout) :: levels
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p
    !> Largest part of the last correction, relative to the largest part of x.
    real(wp), intent(in) :: tolerance
    real(wp), intent(inout) :: x(:)
    integer, intent(out) :: outcome
    !> Added to.
    integer, intent(inout) :: iterations
    !> May be set from elsewhere to give up, as stalled.
    integer, intent(inout), volatile, optional :: cancel
    real(wp), dimension(balance%n) :: new, step, last_new, last_step
    real(wp) :: moves(balance%n, memory), steps(balance%n, memory)
    real(wp) :: change, before, smallest, norm
    integer :: k, kept, at
    logical :: inside

    outcome = outcome_diverged
    call levels%prepare(balance, p, x, inside)
    if (.not. inside) return
    new = x
    kept = 0
    smallest = huge(1.0_wp)
    before = huge(1.0_wp)
    do k = 1, max_iterations
      if (present(cancel)) then
        if (cancel /= 0) exit
      end if
      call balance%residual(new, p, step, inside)
      if (.not. inside) return
      call levels%correction(balance, step)
      iterations = iterations + 1
      change = maxval(abs(step))
      norm = maxval(abs(new))
      if (.not. change <= growth_limit*smallest) return
      if (change <= below*tolerance*norm &
          .or. (change <= tolerance*norm .and. change > 0.5_wp*before)) then
        x = new + step
        outcome = outcome_converged
        return
      end if
      smallest = min(smallest, change)
      before = change
      if (k > 1) then
        at = mod(k - 2, memory) + 1
        kept = min(kept + 1, memory)
        moves(:, at) = new - last_new
        steps(:, at) = step - last_step
      end if
      last_new = new
      last_step = step
      call accelerate(kept, moves, steps, step)
      new = last_new + step
    end do
    outcome = outcome_stalled
  end subroutine solve_on_levels

  !> step - (moves + steps) g, g making step - steps g smallest.
  pure subroutine accelerate(m, moves, steps, step)
    integer, intent(in) :: m
    real(wp), intent(in) :: moves(:, :), steps(:, :)
    real(wp), intent(inout) :: step(:)
    !> Sums of squares below this part of their own are directions no longer new.
    real(wp), parameter :: dependent = 1.0e-20_wp
    real(wp) :: basis(size(step), m), images(size(step), m), rest(size(step))
    real(wp) :: along, length, whole
    integer :: i, j

    rest = step
    do j = 1, m
      basis(:, j) = steps(:, j)
      images(:, j) = moves(:, j) + steps(:, j)
      whole = sum(basis(:, j)**2)
      do i = 1, j - 1
        along = sum(basis(:, i)*basis(:, j))
        basis(:, j) = basis(:, j) - along*basis(:, i)
        images(:, j) = images(:, j) - along*images(:, i)
      end do
      length = sum(basis(:, j)**2)
      if (.not. length > dependent*whole) then
        basis(:, j) = 0.0_wp
        cycle
      end if
      basis(:, j) = basis(:, j)/sqrt(length)
      images(:, j) = images(:, j)/sqrt(length)
      along = sum(basis(:, j)*rest)
      rest = rest - along*basis(:, j)
      step = step - along*images(:, j)
    end do
  end subroutine accelerate

end module viscovib_torus_levels
