!> Tasks about periodic and quasi-periodic solutions of a pendulum with its loads. `orders`
!! (n_axes, m), `drive_orders` (n_axes, 3), base frequencies `omega` (n_axes) and `amplitude` (3) of
!! the loads are as in torus and torus_balance; `kept` (m, 3) is 1 if an order of a coordinate is an
!! unknown. The parameter is a base frequency (`vary` = 1) or an amplitude (2), with the index
!! `which` of the axis or load.
module viscovib_drive_tasks
  use viscovib_branch_tasks, only: given_curve, put_crossings, put_curve
  use viscovib_crossings, only: crossing_type
  use viscovib_curve_branch, only: curve_branch_type, curve_options, follow_curve
  use viscovib_curve_peak, only: climb, harmonic_measure
  use viscovib_kinds, only: i8, wp
  use viscovib_orbit_errors, only: find_branch_errors, find_crossing_errors
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_orbit_stability, only: find_orbit_crossings, check_orbits, orbit_circle
  use viscovib_order_rules, only: better_bound
  use viscovib_outcomes, only: outcome_converged
  use viscovib_pendulum, only: pendulum_type
  use viscovib_stopping, only: is_set
  use viscovib_task, only: task_type
  use viscovib_torus, only: new_torus, torus_type
  use viscovib_torus_balance, only: new_torus_balance, torus_balance_type, vary_frequency
  use viscovib_torus_growth, only: growth_rates
  use viscovib_torus_orders, only: branch_truncation, fold_truncation, new_ladder, torus_ladder, &
    torus_responses
  use viscovib_torus_response, only: solve_from_rest
  implicit none
  private

  public :: drive_task

  !> Input about the loads and the orders.
  type :: drive_type
    integer, allocatable :: orders(:, :), drive_orders(:, :)
    logical, allocatable :: kept(:, :)
    real(wp), allocatable :: omega(:), amplitude(:)
    integer :: vary = 1, which = 1
  end type drive_type

contains

  subroutine drive_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('solve')
      call solve_rows(task)
    case ('truncation')
      call find_truncation(task)
    case ('errors')
      call find_errors(task)
    case ('branch')
      call follow_branch(task)
    case ('peak')
      call find_peak(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine drive_task

  subroutine given_drive(task, system, drive)
    type(task_type), intent(inout) :: task
    type(pendulum_type), pointer, intent(out) :: system
    type(drive_type), intent(out) :: drive
    real(wp), pointer, contiguous :: omega(:), amplitude(:)

    system => task%pendulum()
    allocate (drive%orders, source=task%get_integer_matrix('orders'))
    allocate (drive%drive_orders, source=task%get_integer_matrix('drive_orders'))
    allocate (drive%kept, source=task%get_integer_matrix('kept') /= 0)
    omega => task%get_reals('omega')
    amplitude => task%get_reals('amplitude')
    drive%omega = omega
    drive%amplitude = amplitude
    drive%vary = task%get_integer('vary')
    drive%which = task%get_integer('which')
    associate (n_axes => size(drive%orders, 1), n => size(drive%orders, 2))
      call task%check_extents('drive_orders', shape(drive%drive_orders), [n_axes, 3])
      call task%check_extents('kept', shape(drive%kept), [n, 3])
      call task%check_extents('omega', shape(omega), [n_axes])
    end associate
    call task%check_extents('amplitude', shape(amplitude), [3])
  end subroutine given_drive

  subroutine given_balance(task, torus, balance)
    type(task_type), intent(inout) :: task
    type(torus_type), intent(out) :: torus
    type(torus_balance_type), intent(out) :: balance
    type(pendulum_type), pointer :: system
    type(drive_type) :: drive

    call given_drive(task, system, drive)
    if (.not. task%failed()) call new_torus(torus, drive%orders, task%status)
    if (task%failed()) return
    call new_torus_balance(balance, system, torus, drive%drive_orders, drive%omega, &
                           drive%amplitude, drive%kept)
    balance%vary = drive%vary
    balance%which = drive%which
    if (drive%vary == vary_frequency) balance%lowest = 0.0_wp
  end subroutine given_balance

  !> Balances with orders up to |k_1| + ... = `first`, up to `last`, and `step` more shells.
  subroutine given_ladder(task, first, last, drive, ladder)
    type(task_type), intent(inout) :: task
    integer, intent(in) :: first, last
    type(drive_type), intent(out) :: drive
    type(torus_ladder), intent(out) :: ladder
    type(pendulum_type), pointer :: system
    integer :: step

    call given_drive(task, system, drive)
    step = task%get_integer('step')
    if (task%failed()) return
    call new_ladder(ladder, system, drive%orders, drive%kept, drive%drive_orders, drive%omega, &
                    drive%amplitude, drive%vary, drive%which, first, last, step)
  end subroutine given_ladder

  !> X_k (m, 3, n) from unknowns; the mean is the imaginary part.
  subroutine put_harmonics(task, name, x)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: x(:, :)
    complex(wp), allocatable :: harmonics(:, :, :)
    integer :: d, i, m

    m = size(x, 1)/3
    allocate (harmonics((m + 1)/2, 3, size(x, 2)))
    do i = 1, size(x, 2)
      do d = 1, 3
        associate (own => x((d - 1)*m + 1:d*m, i))
          harmonics(1, d, i) = cmplx(0.0_wp, own(1), wp)
          harmonics(2:, d, i) = cmplx(own(2::2), own(3::2), wp)
        end associate
      end do
    end do
    call task%found%put_complexes(name, harmonics, shape(harmonics))
  end subroutine put_harmonics

  !> Solutions at parameter values `p` (n), with orders up to |k_1| + ... = `first`, increased up to
  !! `last` until the tolerance is met. The truncation error is estimated with `step` more shells,
  !! whose orders are also given (0: no estimate). With a `duration` > 0 for stability: for one axis
  !! Floquet `multipliers` (6, n), NaN if unknown, and the number outside of the unit circle (-1:
  !! unknown); otherwise growth `rates` (6, n) and their errors.
  subroutine solve_rows(task)
    type(task_type), intent(inout) :: task
    type(drive_type) :: drive
    type(torus_ladder) :: ladder
    real(wp), pointer, contiguous :: p(:)
    real(wp), allocatable :: x(:, :), truncation(:), error(:), guess(:)
    integer, allocatable :: outcome(:), iterations(:), highest(:)
    real(wp) :: duration, tolerance
    integer :: first, last, n

    p => task%get_reals('p')
    tolerance = task%get_real('tolerance')
    duration = task%get_real('duration', 0.0_wp)
    first = task%get_integer('first')
    last = task%get_integer('last')
    call given_ladder(task, first, last, drive, ladder)
    if (task%failed()) return
    n = size(p)
    allocate (guess(3*(2*count(sum(abs(drive%orders), 1) <= last) - 1)), source=0.0_wp)
    allocate (x(size(guess), n), truncation(n), error(n), outcome(n), iterations(n), highest(n))
    call torus_responses(ladder, p, tolerance, guess, x, outcome, iterations, highest, &
                         truncation, error, task%status, task%cancel)
    if (task%failed()) return
    associate (found => task%found)
      call put_harmonics(task, 'coefficients', x)
      call found%put_integers('outcomes', outcome, [n])
      call found%put_integers('iterations', iterations, [n])
      call found%put_integers('highest', highest, [n])
      call found%put_reals('truncation', truncation, [n])
      call found%put_reals('error', error, [n])
    end associate
    if (duration > 0.0_wp) then
      call check_rows(task, ladder, p, x, outcome, maxval(highest), duration, size(drive%omega))
    end if
  end subroutine solve_rows

  subroutine check_rows(task, ladder, p, x, outcome, top, duration, n_axes)
    type(task_type), intent(inout) :: task
    type(torus_ladder), intent(inout), target :: ladder
    real(wp), intent(in) :: p(:), x(:, :), duration
    integer, intent(in) :: outcome(:), top, n_axes
    type(orbit_floquet_type) :: floquet
    complex(wp) :: multipliers(6, size(p))
    real(wp), allocatable :: rates(:, :), rates_off(:, :), y(:)
    integer :: growing(size(p)), i
    logical :: inside

    multipliers = (0.0_wp, 0.0_wp)
    growing = -1
    allocate (rates(6, size(p)), rates_off(6, size(p)), source=0.0_wp)
    do i = 1, size(p)
      if (outcome(i) /= outcome_converged .or. is_set(task%cancel)) cycle
      associate (balance => ladder%rungs(top)%balance)
        y = ladder%cropped(top, x(:, i))
        if (n_axes == 1) then
          call check_orbits(floquet, balance, p(i:i), reshape(y, [size(y), 1]), multipliers(:, i:i))
          growing(i) = count_larger(multipliers(:, i), orbit_circle)
        else
          call balance%visit(y, p(i), .true., inside)
          call growth_rates(balance, y, duration, rates(:, i), rates_off(:, i), task%cancel)
        end if
      end associate
    end do
    if (n_axes == 1) then
      call put_multipliers(task, multipliers, growing)
    else
      call put_rates(task, rates, rates_off)
    end if
  end subroutine check_rows

  subroutine put_multipliers(task, multipliers, growing)
    type(task_type), intent(inout) :: task
    complex(wp), intent(in) :: multipliers(:, :)
    integer, intent(in) :: growing(:)
    call task%found%put_complexes('multipliers', multipliers, shape(multipliers))
    call task%found%put_integers('growing', growing, shape(growing))
  end subroutine put_multipliers

  subroutine put_rates(task, rates, rates_off)
    type(task_type), intent(inout) :: task
    real(wp), intent(in) :: rates(:, :), rates_off(:, :)
    call task%found%put_reals('rates', rates, shape(rates))
    call task%found%put_reals('rates_off', rates_off, shape(rates_off))
  end subroutine put_rates

  !> Estimated `truncation`: largest error of the points `p` (n), `x` (m, n) of a branch computed
  !! with orders up to `bound`; `next`: the bound (up to `most`) that would meet the tolerance;
  !! errors of its folds `fold_p`, `fold_x` by omitted orders, with the points before them,
  !! `fold_before`, from 1.
  subroutine find_truncation(task)
    type(task_type), intent(inout) :: task
    type(drive_type) :: drive
    type(torus_ladder) :: ladder
    real(wp), pointer, contiguous :: p(:), x(:, :), fold_p(:), fold_x(:, :)
    real(wp), allocatable :: moved(:)
    integer, allocatable :: fold_before(:)
    real(wp) :: tolerance, truncation
    integer :: bound, most, next

    bound = task%get_integer('bound')
    call given_ladder(task, bound, bound, drive, ladder)
    most = task%get_integer('most')
    tolerance = task%get_real('tolerance')
    p => task%get_reals('p')
    x => task%get_matrix('x')
    fold_p => task%get_reals('fold_p')
    fold_x => task%get_matrix('fold_x')
    allocate (fold_before, source=task%get_integers('fold_before'))
    call task%check_extents('x', shape(x), [size(x, 1), size(p)])
    call task%check_extents('fold_x', shape(fold_x), [size(x, 1), size(fold_p)])
    call task%check_extents('fold_before', shape(fold_before), shape(fold_p))
    if (task%failed()) return
    call branch_truncation(ladder, p, x, tolerance, truncation, task%status, task%cancel)
    next = bound
    if (truncation > tolerance) next = better_bound(bound, truncation, tolerance, ladder%step, most)
    if (task%failed()) return
    allocate (moved(size(fold_p)), source=0.0_wp)
    call fold_truncation(ladder, p, x, fold_p, fold_x, fold_before, moved, task%status, task%cancel)
    if (task%failed()) return
    call task%found%put_real('truncation', truncation)
    call task%found%put_integer('next', int(next, i8))
    call task%found%put_reals('moved', moved, shape(moved))
  end subroutine find_truncation

  !> Errors of branch points and crossings of a branch computed with orders up to `bound`, estimated
  !! with `step` more shells; points before them from 1. `turns`: angles of the multipliers that
  !! cross; `known`: errors if known, else -1.
  subroutine find_errors(task)
    type(task_type), intent(inout) :: task
    type(drive_type) :: drive
    type(torus_ladder) :: ladder
    real(wp), pointer, contiguous :: p(:), x(:, :), branch_p(:), branch_x(:, :), crossing_p(:), &
                                     crossing_x(:, :), turns(:), known(:)
    real(wp), allocatable :: branch_errors(:), crossing_errors(:)
    integer, allocatable :: branch_before(:), crossing_before(:)
    integer :: bound

    bound = task%get_integer('bound')
    call given_ladder(task, bound, bound, drive, ladder)
    p => task%get_reals('p')
    x => task%get_matrix('x')
    branch_p => task%get_reals('branch_p')
    branch_x => task%get_matrix('branch_x')
    allocate (branch_before, source=task%get_integers('branch_before'))
    crossing_p => task%get_reals('crossing_p')
    crossing_x => task%get_matrix('crossing_x')
    allocate (crossing_before, source=task%get_integers('crossing_before'))
    turns => task%get_reals('turns')
    known => task%get_reals('known')
    associate (m => size(x, 1))
      call task%check_extents('x', shape(x), [m, size(p)])
      call task%check_extents('branch_x', shape(branch_x), [m, size(branch_p)])
      call task%check_extents('branch_before', shape(branch_before), shape(branch_p))
      call task%check_extents('crossing_x', shape(crossing_x), [m, size(crossing_p)])
      call task%check_extents('crossing_before', shape(crossing_before), shape(crossing_p))
      call task%check_extents('turns', shape(turns), shape(crossing_p))
      call task%check_extents('known', shape(known), shape(crossing_p))
    end associate
    if (task%failed()) return
    allocate (branch_errors(size(branch_p)), source=0.0_wp)
    crossing_errors = known
    call find_branch_errors(ladder, p, x, branch_p, branch_x, branch_before, branch_errors, &
                            task%status, task%cancel)
    if (task%failed()) return
    call find_crossing_errors(ladder, p, x, crossing_p, crossing_x, crossing_before, turns, &
                              crossing_errors, task%status, task%cancel)
    if (task%failed()) return
    call task%found%put_reals('branch_errors', branch_errors, shape(branch_errors))
    call task%found%put_reals('crossing_errors', crossing_errors, shape(crossing_errors))
  end subroutine find_errors

  !> Branch in the parameter. It starts at the point `begin` (m), `begin_p` in the direction `along`
  !! (m + 1), or at a solution found at `start`; without a start it has no points. Stability as
  !! above.
  subroutine follow_branch(task)
    type(task_type), intent(inout) :: task
    type(torus_type) :: torus
    type(torus_balance_type) :: balance
    type(curve_options) :: options
    type(curve_branch_type) :: branch
    real(wp), pointer, contiguous :: begin(:), along(:)
    real(wp), allocatable :: at(:)
    real(wp) :: duration
    integer :: found, made, m

    options = given_curve(task)
    duration = task%get_real('duration', 0.0_wp)
    call given_balance(task, torus, balance)
    if (task%failed()) return
    found = outcome_converged
    if (task%has('begin')) then
      begin => task%get_reals('begin')
      along => task%get_reals('along')
      m = size(begin)
      call task%check_extents('begin', [m], [3*torus%n])
      call task%check_extents('along', shape(along), [m + 1])
      if (task%failed()) return
      call follow_curve(balance, options, balance%reduced(begin), branch, &
                        task%get_real('begin_p'), [balance%reduced(along(:m)), along(m + 1)], &
                        task%cancel)
    else
      made = 0
      allocate (at(balance%n))
      call solve_from_rest(balance, options%start, options%tolerance, at, found, made, task%cancel)
      if (found == outcome_converged) then
        call follow_curve(balance, options, at, branch, cancel=task%cancel)
      end if
    end if
    if (found /= outcome_converged .or. branch%n_points == 0) return
    call put_branch(task, balance, branch)
    if (duration > 0.0_wp) then
      call check_branch(task, balance, branch, duration, size(torus%orders, 1))
    end if
  end subroutine follow_branch

  subroutine put_branch(task, balance, branch)
    type(task_type), intent(inout) :: task
    type(torus_balance_type), intent(in) :: balance
    type(curve_branch_type), intent(in) :: branch
    real(wp), allocatable :: directions(:, :), across(:, :)

    call put_curve(task, branch)
    call put_points(task, '', balance, branch%x(:, :branch%n_points))
    call put_points(task, 'fold_', balance, branch%folds%x(:, :branch%folds%n))
    associate (points => branch%branch_points)
      call put_points(task, 'branch_', balance, points%x(:, :points%n))
      directions = expanded(balance, points%across(:balance%n, :points%n))
      call put_harmonics(task, 'branch_directions', directions)
      allocate (across(size(directions, 1) + 1, points%n))
      across(:size(directions, 1), :) = directions
      across(size(across, 1), :) = points%across(balance%n + 1, :points%n)
      call task%found%put_reals('across', across, shape(across))
    end associate
  end subroutine put_branch

  !> All unknowns of solutions, and their harmonics.
  subroutine put_points(task, prefix, balance, x)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: prefix
    type(torus_balance_type), intent(in) :: balance
    real(wp), intent(in) :: x(:, :)
    real(wp), allocatable :: whole(:, :)
    allocate (whole, source=expanded(balance, x))
    call task%found%put_reals(prefix//'x', whole, shape(whole))
    call put_harmonics(task, prefix//'coefficients', whole)
  end subroutine put_points

  function expanded(balance, x) result(whole)
    type(torus_balance_type), intent(in) :: balance
    real(wp), intent(in) :: x(:, :)
    real(wp), allocatable :: whole(:, :)
    integer :: i, m
    m = 3*balance%torus%n
    allocate (whole(m, size(x, 2)))
    do i = 1, size(x, 2)
      whole(:, i) = reshape(balance%expanded(x(:balance%n, i)), [m])
    end do
  end function expanded

  !> Stability along a branch, and its changes. Errors of folds are rounding errors, of other points
  !! -1; `turns` are the angles of the multipliers that cross.
  subroutine check_branch(task, balance, branch, duration, n_axes)
    type(task_type), intent(inout) :: task
    type(torus_balance_type), intent(inout), target :: balance
    type(curve_branch_type), intent(in) :: branch
    real(wp), intent(in) :: duration
    integer, intent(in) :: n_axes
    type(orbit_floquet_type) :: floquet
    type(crossing_type), allocatable :: changes(:)
    complex(wp) :: multipliers(6, branch%n_points)
    real(wp), allocatable :: rates(:, :), rates_off(:, :), places(:, :)
    integer :: i, n
    logical :: inside

    n = branch%n_points
    associate (p => branch%parameter(:n), x => branch%x(:, :n))
      if (n_axes > 1) then
        allocate (rates(6, n), rates_off(6, n), source=0.0_wp)
        do i = 1, n
          if (is_set(task%cancel)) exit
          call balance%visit(x(:, i), p(i), .true., inside)
          call growth_rates(balance, x(:, i), duration, rates(:, i), rates_off(:, i), task%cancel)
        end do
        call put_rates(task, rates, rates_off)
        return
      end if
      multipliers = (0.0_wp, 0.0_wp)
      call check_orbits(floquet, balance, p, x, multipliers, task%cancel)
      call put_multipliers(task, multipliers, [(count_larger(multipliers(:, i), orbit_circle), &
                                                i=1, n)])
      call find_orbit_crossings(floquet, balance, p, x, multipliers, branch%folds, &
                                branch%branch_points, changes, task%cancel)
    end associate
    call put_crossings(task, changes)
    call task%found%put_reals('turns', aimag(changes%eta), shape(changes))
    allocate (places(balance%n, size(changes)), source=0.0_wp)
    do i = 1, size(changes)
      if (changes(i)%located) places(:, i) = changes(i)%x
    end do
    call put_points(task, 'crossing_', balance, places)
  end subroutine check_branch

  !> Peak of order `place` (from 1) of coordinate `dof` that follows on the branch from the solution
  !! `x` (m), with `p` between `low` and `high`.
  subroutine find_peak(task)
    type(task_type), intent(inout) :: task
    type(torus_type) :: torus
    type(torus_balance_type) :: balance
    type(harmonic_measure) :: measure
    real(wp), pointer, contiguous :: x(:)
    real(wp), allocatable :: at(:)
    real(wp) :: p, peak_size
    integer :: dof, place, first
    logical :: summit

    call given_balance(task, torus, balance)
    x => task%get_reals('x')
    p = task%get_real('p')
    dof = task%get_integer('dof')
    place = task%get_integer('place')
    if (task%failed()) return
    call task%check_extents('x', shape(x), [3*torus%n])
    if (task%failed()) return
    at = balance%reduced(x)
    ! The mean has one unknown, other orders two.
    first = (dof - 1)*torus%n + max(1, 2*place - 2)
    measure%place = [row_of(first), row_of(min(first + 1, dof*torus%n))]
    peak_size = -1.0_wp
    summit = .false.
    if (place > 1 .and. all(measure%place > 0)) then
      call climb(balance, measure, task%get_real('tolerance'), task%get_real('low'), &
                 task%get_real('high'), at, p, summit, task%cancel)
      peak_size = measure%size_at(at, p)
    end if
    call task%found%put_real('at', p)
    call task%found%put_real('size', peak_size)
    call task%found%put_integer('enclosed', merge(1_i8, 0_i8, summit))

  contains

    !> Index of an unknown among the kept unknowns; 0: not kept.
    integer function row_of(j)
      integer, intent(in) :: j
      real(wp) :: one(size(x))
      one = 0.0_wp
      one(j) = 1.0_wp
      row_of = findloc(balance%reduced(one) > 0.5_wp, .true., 1)
    end function row_of

  end subroutine find_peak

end module viscovib_drive_tasks
