! Optimize: -O2
!> Solutions of harmonic balance on a torus at a sequence of values of a parameter, each with as
!! many orders as it needs.
!!
!! The truncation error of a lattice |k_1| + |k_2| + ... <= K is estimated by the change of the
!! solution with the next shells of orders, computed to a tenth of the change by a few residuals of
!! an iteration on two levels. If it is too large, orders are added as their decay suggests; if the
!! outermost shells are idle, the next value begins with fewer.
module viscovib_torus_orders
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_block_factors, only: factorize_blocks
  use viscovib_curve_step, only: curve_step, new_curve_step
  use viscovib_dense, only: largest_in_rows, solve
  use viscovib_driven_system, only: differentiable_system_type
  use viscovib_kinds, only: wp
  use viscovib_order_rules, only: better_bound, idle, max_vain
  use viscovib_outcomes, only: outcome_converged
  use viscovib_status, only: set_ok, status_type
  use viscovib_stopping, only: is_set
  use viscovib_torus, only: new_torus, torus_type
  use viscovib_torus_balance, only: new_torus_balance, torus_balance_type, vary_frequency
  use viscovib_torus_levels, only: new_levels, torus_levels
  use viscovib_torus_response, only: near_levels, solve_from_rest, solve_near
  implicit none
  private

  public :: torus_ladder, new_ladder, torus_responses, branch_truncation, fold_truncation

  !> Largest number of points of a branch that are checked.
  integer, parameter :: max_checked = 5
  !> Relative accuracy of a change that serves as an estimate.
  real(wp), parameter :: checked = 0.1_wp

  type :: torus_rung
    logical :: ready = .false.
    type(torus_balance_type) :: balance
    type(near_levels) :: near
  end type torus_rung

  !> Balances with increasing numbers of shells, each created at its first use.
  !!
  !! `balance_ladder_type` is the equivalent for oscillators with one frequency; the types are
  !! separate. There a rung contains the inverse dynamic stiffness of each omitted order, so one
  !! residual gives the truncation error. A system solved for its accelerations has no such blocks:
  !! here a rung contains the two levels of `near_levels`, whose iteration estimates and solves. The
  !! common rules for adding orders are in `viscovib_order_rules`.
  type :: torus_ladder
    !> Initial and largest bound of the lattice; number of shells that estimate the truncation
    !! error, 0: no estimate.
    integer :: first = 1, last = 1, step = 2
    class(differentiable_system_type), pointer, private :: system => null()
    !> Orders shell by shell, up to last + step; which are unknowns; number of orders in each bound,
    !! shape (0:last + step).
    integer, allocatable, private :: orders(:, :), n_orders(:)
    logical, allocatable, private :: kept(:, :)
    integer, allocatable, private :: drive_orders(:, :)
    real(wp), allocatable, private :: omega(:), amplitude(:)
    integer, private :: vary = vary_frequency, which = 1
    type(torus_rung), allocatable :: rungs(:)
  contains
    procedure :: prepare
    procedure :: cropped
    procedure :: padded
    procedure :: lifted
    procedure, private :: check_truncation
    procedure, private :: enough
    procedure, private :: next_bound
  end type torus_ladder

  !> Rounding error of an equation relative to its largest term, and number of sign patterns.
  real(wp), parameter :: usual = 4.0_wp*epsilon(1.0_wp)
  integer, parameter :: all_signs = 3
  !> Largest number of unknowns for which a full matrix is cheap.
  integer, parameter :: most_dense = 400

contains

  !> Arguments as in `new_torus_balance`, with orders up to last + step.
  subroutine new_ladder(ladder, system, orders, kept, drive_orders, omega, amplitude, vary, which, &
                        first, last, step)
    type(torus_ladder), intent(out) :: ladder
    class(differentiable_system_type), intent(in), target :: system
    integer, intent(in) :: orders(:, :), drive_orders(:, :), vary, which, first, last, step
    logical, intent(in) :: kept(:, :)
    real(wp), intent(in) :: omega(:), amplitude(:)
    integer :: bound

    ladder%system => system
    ladder%orders = orders
    ladder%kept = kept
    ladder%drive_orders = drive_orders
    ladder%omega = omega
    ladder%amplitude = amplitude
    ladder%vary = vary
    ladder%which = which
    ladder%first = first
    ladder%last = last
    ladder%step = step
    allocate (ladder%rungs(last + step), ladder%n_orders(0:last + step))
    ladder%n_orders = [(count(sum(abs(orders), 1) <= bound), bound=0, last + step)]
  end subroutine new_ladder

  subroutine prepare(self, bound, status)
    class(torus_ladder), intent(inout) :: self
    integer, intent(in) :: bound
    type(status_type), intent(out) :: status
    type(torus_type) :: torus

    associate (rung => self%rungs(bound), n => self%n_orders(bound))
      if (rung%ready) return
      call new_torus(torus, self%orders(:, :n), status)
      if (status%failed()) return
      call new_torus_balance(rung%balance, self%system, torus, self%drive_orders, self%omega, &
                             self%amplitude, self%kept(:n, :))
      rung%balance%vary = self%vary
      rung%balance%which = self%which
      if (self%vary == vary_frequency) rung%balance%lowest = 0.0_wp
      rung%ready = .true.
    end associate
  end subroutine prepare

  !> Unknowns of a rung from the full unknowns of the last one, shape (torus%n n_dof), and back.
  pure function cropped(self, bound, y) result(x)
    class(torus_ladder), intent(in) :: self
    integer, intent(in) :: bound
    real(wp), intent(in) :: y(:)
    real(wp) :: x(self%rungs(bound)%balance%n)
    real(wp), allocatable :: whole(:, :)
    associate (balance => self%rungs(bound)%balance, d => self%system%n_dof)
      whole = reshape(y, [size(y)/d, d])
      x = balance%reduced(reshape(whole(:balance%torus%n, :), [balance%torus%n*d]))
    end associate
  end function cropped

  pure function padded(self, bound, x, n) result(y)
    class(torus_ladder), intent(in) :: self
    integer, intent(in) :: bound, n
    real(wp), intent(in) :: x(:)
    real(wp) :: y(n)
    real(wp), allocatable :: whole(:, :)
    integer :: m
    associate (balance => self%rungs(bound)%balance, d => self%system%n_dof)
      allocate (whole(n/d, d), source=0.0_wp)
      m = min(balance%torus%n, n/d)
      associate (inner => balance%expanded(x))
        whole(:m, :) = inner(:m, :)
      end associate
      y = reshape(whole, [n])
    end associate
  end function padded

  !> Unknowns of the rung that checks the last one, from the full unknowns of the last one; both
  !! must be prepared. The additional shells are 0.
  pure function lifted(self, whole) result(x)
    class(torus_ladder), intent(in) :: self
    real(wp), intent(in) :: whole(:)
    real(wp), allocatable :: x(:)
    integer :: n
    n = (2*self%n_orders(self%last + self%step) - 1)*self%system%n_dof
    x = self%cropped(self%last + self%step, &
                     self%padded(self%last, self%cropped(self%last, whole), n))
  end function lifted

  !> Each value starts from the previous ones, or from zero; the first one may have a guess.
  subroutine torus_responses(ladder, p, tolerance, guess, x, outcome, iterations, highest, &
                             truncation, error, status, cancel)
    type(torus_ladder), intent(inout) :: ladder
    !> Tolerance of the iteration, and of the truncation if there is a choice of orders.
    real(wp), intent(in) :: p(:), tolerance
    !> Initial guess of the first value, in the layout of x; 0: start from zero.
    real(wp), intent(in) :: guess(:)
    !> Full unknowns of the last rung, shape (torus%n n_dof, size(p)); 0 if no solution was found.
    real(wp), intent(out) :: x(:, :)
    !> `highest`: bound of the orders, 0 if no solution was found; `truncation`: estimated
    !! truncation error relative to the largest unknown.
    integer, intent(out) :: outcome(:), iterations(:), highest(:)
    real(wp), intent(out) :: truncation(:)
    !> Error by the last correction and by rounding, from `torus_error`.
    real(wp), intent(out) :: error(:)
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    integer :: i, known, bound
    real(wp) :: last_p, before_p
    real(wp), allocatable :: here(:), last(:), before(:)

    known = 0
    iterations = 0
    outcome = -1
    highest = 0
    truncation = 0.0_wp
    error = 0.0_wp
    x = 0.0_wp
    last_p = 0.0_wp
    before_p = 0.0_wp
    allocate (last(size(x, 1)), before(size(x, 1)), source=0.0_wp)
    bound = ladder%first
    do i = 1, size(p)
      if (is_set(cancel)) return
      call ladder%prepare(bound, status)
      if (status%failed()) return
      associate (rung => ladder%rungs(bound))
        if (known >= 2) then
          here = ladder%cropped(bound, last + (last - before)*((p(i) - last_p) &
                                                               /(last_p - before_p)))
          call solve_near(rung%balance, rung%near, p(i), tolerance, here, outcome(i), &
                          iterations(i), cancel)
        end if
        if (i == 1 .and. any(abs(guess) > 0.0_wp)) then
          here = ladder%cropped(bound, guess)
          call solve_near(rung%balance, rung%near, p(i), tolerance, here, outcome(i), &
                          iterations(i), cancel)
        end if
        if (outcome(i) /= outcome_converged .and. known >= 1) then
          here = ladder%cropped(bound, last)
          call solve_near(rung%balance, rung%near, p(i), tolerance, here, outcome(i), &
                          iterations(i), cancel)
        end if
        if (outcome(i) /= outcome_converged) then
          known = 0
          if (allocated(here)) deallocate (here)
          allocate (here(rung%balance%n))
          call solve_from_rest(rung%balance, p(i), tolerance, here, outcome(i), iterations(i), &
                               cancel, rung%near)
        end if
      end associate
      if (outcome(i) /= outcome_converged) cycle
      call ladder%enough(p(i), tolerance, bound, here, iterations(i), truncation(i), status, cancel)
      if (status%failed()) return
      associate (rung => ladder%rungs(bound))
        call torus_error(rung%balance, p(i), here, rung%near%most, error(i))
      end associate
      highest(i) = bound
      x(:, i) = ladder%padded(bound, here, size(x, 1))
      ! Equal values give no direction for an extrapolation.
      if (known > 0 .and. .not. abs(p(i) - last_p) > 0.0_wp) known = 0
      before = last
      before_p = last_p
      last = x(:, i)
      last_p = p(i)
      known = known + 1
      bound = ladder%next_bound(bound, last, truncation(i), tolerance)
    end do
  end subroutine torus_responses

  !> Add orders to a solution until the estimate meets the tolerance or the last rung is reached.
  subroutine enough(self, p, tolerance, bound, x, iterations, truncation, status, cancel)
    class(torus_ladder), intent(inout) :: self
    real(wp), intent(in) :: p, tolerance
    integer, intent(inout) :: bound
    real(wp), allocatable, intent(inout) :: x(:)
    integer, intent(inout) :: iterations
    real(wp), intent(out) :: truncation
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    real(wp), allocatable :: y(:), new(:)
    real(wp) :: previous
    integer :: next, outcome, vain

    previous = huge(1.0_wp)
    vain = 0
    do
      call self%check_truncation(p, tolerance, bound, x, y, truncation, status, cancel)
      if (status%failed() .or. truncation <= tolerance .or. bound == self%last) return
      if (truncation > 0.5_wp*previous) vain = vain + 1
      if (vain >= max_vain) return
      previous = truncation
      next = better_bound(bound, truncation, tolerance, self%step, self%last)
      call self%prepare(next, status)
      if (status%failed()) return
      new = self%cropped(next, y)
      associate (rung => self%rungs(next))
        rung%near%most = max(rung%near%most, self%rungs(bound)%near%most)
        call solve_near(rung%balance, rung%near, p, tolerance, new, outcome, iterations, cancel)
      end associate
      if (outcome /= outcome_converged) return
      call move_alloc(new, x)
      bound = next
    end do
  end subroutine enough

  !> Change of the solution x by the next shells; y has the length of the largest unknowns.
  subroutine check_truncation(self, p, tolerance, bound, x, y, truncation, status, cancel)
    class(torus_ladder), intent(inout) :: self
    real(wp), intent(in) :: p, tolerance, x(:)
    integer, intent(in) :: bound
    real(wp), allocatable, intent(inout) :: y(:)
    real(wp), intent(out) :: truncation
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    real(wp), allocatable :: new(:)
    real(wp) :: largest
    integer :: outcome, iterations, n

    truncation = 0.0_wp
    if (self%step == 0) return
    call self%prepare(bound + self%step, status)
    if (status%failed()) return
    n = (2*self%n_orders(self%last + self%step) - 1)*self%system%n_dof
    y = self%padded(bound, x, n)
    iterations = 0
    associate (rung => self%rungs(bound + self%step))
      allocate (new(rung%balance%n))
      new(:) = self%cropped(bound + self%step, y)
      largest = maxval(abs(new))
      rung%near%most = max(rung%near%most, self%rungs(bound)%near%most)
      call solve_near(rung%balance, rung%near, p, tolerance, new, outcome, iterations, cancel, &
                      checked)
      if (outcome /= outcome_converged) then
        ! If the orders cannot be added: use the size of the outermost ones.
        truncation = outer_part(self, bound, y)
        return
      end if
      truncation = min(1.0_wp, maxval(abs(new - self%cropped(bound + self%step, y))) &
                       /max(largest, tiny(1.0_wp)))
      y = self%padded(bound + self%step, new, n)
    end associate
  end subroutine check_truncation

  !> Largest truncation error of points of a branch with the orders of the last rung, among the
  !! points with the largest outermost shells.
  subroutine branch_truncation(ladder, p, x, tolerance, truncation, status, cancel)
    type(torus_ladder), intent(inout) :: ladder
    !> Parameters of the points, and their full unknowns, shape (torus%n n_dof, size(p)).
    real(wp), intent(in) :: p(:), x(:, :), tolerance
    real(wp), intent(out) :: truncation
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    real(wp) :: outer(size(p)), one
    real(wp), allocatable :: y(:)
    integer :: i, j

    truncation = 0.0_wp
    call ladder%prepare(ladder%last, status)
    outer = [(outer_part(ladder, ladder%last, x(:, i)), i=1, size(p))]
    do j = 1, min(max_checked, size(p))
      if (status%failed()) return
      if (is_set(cancel)) return
      i = maxloc(outer, 1)
      outer(i) = -1.0_wp
      call ladder%check_truncation(p(i), tolerance, ladder%last, ladder%cropped(ladder%last, &
                                                                                x(:, i)), y, &
                        one, status, cancel)
      truncation = max(truncation, one)
    end do
  end subroutine branch_truncation

  !> Displacement of the folds of a branch by the next shells: by a step of Newton's method
  !! orthogonal to the branch.
  subroutine fold_truncation(ladder, p, x, fold_p, fold_x, before, moved, status, cancel)
    type(torus_ladder), intent(inout) :: ladder
    !> Points and folds, as in `branch_truncation`.
    real(wp), intent(in) :: p(:), x(:, :), fold_p(:), fold_x(:, :)
    !> Index of the point before each fold, from 1.
    integer, intent(in) :: before(:)
    !> In the unit of p, shape (size(fold_p)).
    real(wp), intent(out) :: moved(:)
    type(status_type), intent(out) :: status
    integer, intent(inout), optional :: cancel
    type(curve_step) :: newton
    real(wp), allocatable :: chord(:)
    real(wp) :: of_x
    integer :: i, from, to

    moved = 0.0_wp
    call set_ok(status)
    if (size(fold_p) == 0) return
    call ladder%prepare(ladder%last, status)
    if (.not. status%failed()) call ladder%prepare(ladder%last + ladder%step, status)
    if (status%failed()) return
    associate (balance => ladder%rungs(ladder%last + ladder%step)%balance)
      call new_curve_step(newton, balance)
      do i = 1, size(fold_p)
        if (is_set(cancel)) return
        from = max(1, before(i))
        to = min(size(p), before(i) + 1)
        chord = [ladder%lifted(x(:, to)) - ladder%lifted(x(:, from)), p(to) - p(from)]
        call newton%find(balance, fold_p(i), ladder%lifted(fold_x(:, i)), chord, of_x, moved(i))
      end do
    end associate
  end subroutine fold_truncation

  !> The largest unknown of the outermost shells relative to the largest of all.
  pure real(wp) function outer_part(self, bound, y)
    class(torus_ladder), intent(in) :: self
    integer, intent(in) :: bound
    real(wp), intent(in) :: y(:)
    real(wp) :: whole(size(y)/self%system%n_dof, self%system%n_dof)
    whole = reshape(y, shape(whole))
    outer_part = maxval(abs(whole(2*self%n_orders(max(0, bound - self%step)):, :))) &
                 /max(maxval(abs(whole)), tiny(1.0_wp))
  end function outer_part

  !> The lowest bound that would still suffice here: all orders beyond it are idle.
  pure integer function next_bound(self, bound, y, truncation, tolerance) result(next)
    class(torus_ladder), intent(in) :: self
    integer, intent(in) :: bound
    real(wp), intent(in) :: y(:), truncation, tolerance
    real(wp) :: whole(size(y)/self%system%n_dof, self%system%n_dof), limit
    integer :: k

    next = bound
    if (truncation > idle*tolerance) return
    whole = reshape(y, shape(whole))
    limit = idle*tolerance*maxval(abs(y))
    k = 2*self%n_orders(bound) - 1
    do while (next > self%first)
      if (any(abs(whole(2*self%n_orders(next - 1):k, :)) > limit)) exit
      next = next - 1
    end do
  end function next_bound

  ! Errors of solutions of harmonic balance on a torus: the remaining correction, and rounding
  ! errors (like `viscovib_motion_checks` for oscillators). With many unknowns both use the
  ! approximate derivatives of `viscovib_torus_levels`.

  !> Error relative to the largest unknown, as for the truncation error.
  subroutine torus_error(balance, p, x, most, error)
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, x(:)
    !> Number of unknowns of the inner balance of the solution.
    integer, intent(in) :: most
    !> NaN if the derivatives are singular.
    real(wp), intent(out) :: error
    type(torus_levels) :: levels
    real(wp) :: r(balance%n, 0:all_signs), norm
    logical :: made

    error = 0.0_wp
    norm = maxval(abs(x))
    if (.not. norm > 0.0_wp) return
    error = ieee_value(error, ieee_quiet_nan)
    if (balance%n > most_dense) call new_levels(levels, balance, most)
    if (levels%ready) then
      call moved_on_levels(levels, balance, p, x, r, made)
    else
      call moved_by_all(balance, p, x, r, made)
    end if
    if (made) error = min(1.0_wp, (maxval(abs(r(:, 0))) + maxval(abs(r(:, 1:))))/norm)
  end subroutine torus_error

  !> Displacements of x by the residual and by its rounding error, with the full matrix.
  subroutine moved_by_all(balance, p, x, moved, made)
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, x(:)
    !> Shape (n, 0:all_signs).
    real(wp), intent(out) :: moved(:, 0:)
    logical, intent(out) :: made
    real(wp) :: matrix(balance%n, balance%n), slope(balance%n), terms(balance%n)
    integer :: pivots(balance%n), i
    logical :: singular

    moved = 0.0_wp
    call balance%equations(x, p, moved(:, 0), matrix, slope, made)
    if (.not. made) return
    terms = terms_of(matrix, slope, x, p)
    call balance%raise_terms(x, p, terms)
    call factorize_blocks(balance%n, matrix, pivots, singular)
    made = .not. singular
    if (.not. made) return
    call add_rounding(terms, moved)
    do i = 0, all_signs
      call solve(balance%n, matrix, pivots, moved(:, i))
    end do
  end subroutine moved_by_all

  !> The same with the derivatives of two levels.
  subroutine moved_on_levels(levels, balance, p, x, moved, made)
    type(torus_levels), intent(inout) :: levels
    type(torus_balance_type), intent(inout) :: balance
    real(wp), intent(in) :: p, x(:)
    real(wp), intent(out) :: moved(:, 0:)
    logical, intent(out) :: made
    real(wp), dimension(levels%inner%n) :: inner, r, slope
    real(wp) :: matrix(levels%inner%n, levels%inner%n), terms(balance%n)
    integer :: i

    moved = 0.0_wp
    call levels%match(balance)
    inner = levels%within(balance, x)
    call levels%inner%equations(inner, p, r, matrix, slope, made)
    if (.not. made) return
    ! `raise_terms` raises all orders of a coordinate to its largest term, inner or not.
    terms = levels%beyond(balance, terms_of(matrix, slope, inner, p))
    call levels%prepare(balance, p, x, made)
    if (.not. made) return
    call balance%raise_terms(x, p, terms)
    call balance%residual(x, p, moved(:, 0), made)
    if (.not. made) return
    call add_rounding(terms, moved)
    do i = 0, all_signs
      call levels%correction(balance, moved(:, i))
    end do
  end subroutine moved_on_levels

  !> The largest term of each equation.
  pure function terms_of(matrix, slope, x, p) result(terms)
    real(wp), intent(in) :: matrix(:, :), slope(:), x(:), p
    real(wp) :: terms(size(x))
    call largest_in_rows(size(x), size(x), matrix, abs(x), terms)
    terms = max(terms, abs(slope*p))
  end function terms_of

  !> Store rounding errors of the equations with several sign patterns in the columns from 1 on.
  pure subroutine add_rounding(terms, r)
    real(wp), intent(in) :: terms(:)
    real(wp), intent(inout) :: r(:, 0:)
    integer :: i, k
    do i = 1, ubound(r, 2)
      do k = 1, size(terms)
        r(k, i) = sign(usual*terms(k), cos(real(i*(k + i)**2, wp)))
      end do
    end do
  end subroutine add_rounding

end module viscovib_torus_orders
