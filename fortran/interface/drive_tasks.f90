!> Tasks about periodic and quasi-periodic solutions of a pendulum with its loads. `orders`
!! (n_axes, m), `drive_orders` (n_axes, 3), base frequencies `omega` (n_axes) and `amplitude` (3) of
!! the loads are as in torus and torus_balance; `kept` (m, 3) is 1 if an order of a coordinate is an
!! unknown. The parameter is a base frequency (`vary` = 1) or an amplitude (2), with the index
!! `which` of the axis or load.
module viscovib_drive_tasks
  use viscovib_branch_tasks, only: given_curve, put_crossings, put_curve
  use viscovib_crossings, only: crossing_type
  use viscovib_curve_branch, only: curve_branch_type
  use viscovib_curve_peak, only: climb, harmonic_measure
  use viscovib_drive_torus, only: lattice, sort_drives
  use viscovib_driven_job, only: driven_job, follow_with_enough, leaving_type, tracing_type
  use viscovib_kinds, only: i8, wp
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_orbit_stability, only: check_orbits, orbit_circle
  use viscovib_outcomes, only: outcome_converged
  use viscovib_pendulum, only: pendulum_type
  use viscovib_stopping, only: is_set
  use viscovib_task, only: task_type
  use viscovib_torus, only: new_torus, torus_type
  use viscovib_torus_balance, only: new_torus_balance, torus_balance_type, vary_frequency
  use viscovib_torus_growth, only: growth_rates
  use viscovib_torus_orders, only: new_ladder, torus_ladder, torus_responses
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

  !> Branch in the parameter `varies` (from 1, see `varied_names`), with orders up to `harmonics`,
  !! or more if they are to `choose`, of loads as of `sort_drives` with `subharmonic` and
  !! `max_denominator`; `symmetric`: only motions with the symmetry of system and loads. It starts
  !! at a motion found at `start`, or leaves another branch at `begin` (m) and `begin_p` in the
  !! direction `along` (m + 1). Stability over a `duration` > 0 as above.
  !!
  !! Also returns the highest order, `bound`, the estimated `truncation`, `base` frequencies
  !! (n_axes, n), the `orders` (n_axes, k) and which of them are `kept` (k, 3), and the `unit` of
  !! the parameter.
  subroutine follow_branch(task)
    type(task_type), intent(inout) :: task
    type(driven_job) :: job
    type(tracing_type), target :: tracing
    type(curve_branch_type) :: branch
    type(leaving_type), allocatable :: leave
    type(pendulum_type), pointer :: system
    real(wp), allocatable :: base(:, :)
    real(wp) :: duration, truncation
    integer :: n

    system => task%pendulum()
    job%options = given_curve(task)
    job%parameter = task%get_integer('varies')
    job%harmonics = task%get_integer('harmonics')
    job%choose_harmonics = task%get_flag('choose')
    job%symmetric = task%get_flag('symmetric')
    duration = task%get_real('duration', 0.0_wp)
    if (task%has('begin')) then
      allocate (leave)
      allocate (leave%begin, source=task%get_reals('begin'))
      allocate (leave%along, source=task%get_reals('along'))
      leave%parameter = task%get_real('begin_p')
      call task%check_extents('along', shape(leave%along), [size(leave%begin) + 1])
    end if
    if (task%failed()) return
    call sort_drives(job%torus, system%parameters%frequency, system%parameters%load, &
                     job%parameter, task%get_integer('subharmonic'), &
                     task%get_integer('max_denominator'), task%status)
    if (task%failed()) return
    if (allocated(leave)) call task%check_extents('begin', shape(leave%begin), &
                               [3*(2*size(lattice(job%torus%n_axes, job%harmonics), 2) - 1)])
    if (.not. task%failed()) call follow_with_enough(job, system, tracing, branch, truncation, &
                                                     task%status, leave, task%cancel)
    if (task%failed()) return
    n = branch%n_points
    if (duration > 0.0_wp) call check_branch(task, job, tracing, branch, duration)
    if (task%failed()) return
    allocate (base, source=spread(job%torus%base, 2, n))
    if (tracing%balance%vary == vary_frequency) base(tracing%balance%which, :) = &
      branch%parameter(:n)
    associate (found => task%found, orders => tracing%torus%orders)
      call found%put_reals('base', base, shape(base))
      call found%put_integer('bound', int(tracing%bound, i8))
      call found%put_real('truncation', truncation)
      call found%put_real('unit', tracing%unit)
      call found%put_integers('orders', orders, shape(orders))
      call found%put_integers('kept', merge(1, 0, job%kept_of(orders, tracing%load)), &
                              [size(orders, 2), 3])
    end associate
    call put_branch(task, tracing%balance, branch)
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

  !> Stability along a branch, and its changes.
  subroutine check_branch(task, job, tracing, branch, duration)
    type(task_type), intent(inout) :: task
    type(driven_job), intent(in) :: job
    type(tracing_type), target, intent(inout) :: tracing
    type(curve_branch_type), intent(in) :: branch
    real(wp), intent(in) :: duration
    type(crossing_type), allocatable :: changes(:)
    complex(wp) :: multipliers(6, branch%n_points)
    real(wp), allocatable :: rates(:, :), rates_off(:, :), places(:, :)
    integer :: i, n
    logical :: inside

    n = branch%n_points
    if (job%torus%n_axes > 1) then
      allocate (rates(6, n), rates_off(6, n), source=0.0_wp)
      associate (p => branch%parameter, x => branch%x, balance => tracing%balance)
        do i = 1, n
          if (is_set(task%cancel)) exit
          call balance%visit(x(:, i), p(i), .true., inside)
          call growth_rates(balance, x(:, i), duration, rates(:, i), rates_off(:, i), task%cancel)
        end do
      end associate
      call put_rates(task, rates, rates_off)
      return
    end if
    multipliers = (0.0_wp, 0.0_wp)
    call tracing%find_stability(job, branch, multipliers, changes, task%status, task%cancel)
    if (task%failed()) return
    call put_multipliers(task, multipliers, [(count_larger(multipliers(:, i), orbit_circle), &
                                              i=1, n)])
    call put_crossings(task, changes)
    allocate (places(tracing%balance%n, size(changes)), source=0.0_wp)
    do i = 1, size(changes)
      if (changes(i)%located) places(:, i) = changes(i)%x
    end do
    call put_points(task, 'crossing_', tracing%balance, places)
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
