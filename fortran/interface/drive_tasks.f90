!> Tasks about periodic and quasi-periodic solutions of a pendulum with its loads. The loads are
!! sorted by `varies` (from 1, see `varied_names`; 0: nothing), `subharmonic` and `max_denominator`
!! as in `sort_drives`; solutions have orders up to `harmonics`, or as many as they need
!! (`choose`); `symmetric`: only those with the symmetry of system and loads.
module viscovib_drive_tasks
  use viscovib_branch_tasks, only: given_curve, put_crossings, put_curve
  use viscovib_crossings, only: crossing_type
  use viscovib_curve_branch, only: curve_branch_type
  use viscovib_curve_peak, only: climb, harmonic_measure
  use viscovib_drive_torus, only: checking_shells, default_bound, drive_torus_type, largest_bound, &
    lattice, lowest_bound, max_unknowns, max_without_matrix, n_drives, n_unknowns, sort_drives, &
    varied_names
  use viscovib_driven_job, only: driven_job, follow_with_enough, leaving_type, tracing_type
  use viscovib_kinds, only: i8, wp
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_multipliers, only: count_larger
  use viscovib_orbit_stability, only: check_orbits, orbit_circle
  use viscovib_outcomes, only: outcome_converged
  use viscovib_pendulum, only: pendulum_type
  use viscovib_status, only: fail, show, status_input_error
  use viscovib_stopping, only: is_set
  use viscovib_task, only: task_type
  use viscovib_torus_balance, only: torus_balance_type, vary_frequency
  use viscovib_torus_growth, only: growth_rates
  use viscovib_torus_orders, only: new_ladder, torus_ladder, torus_responses
  implicit none
  private

  public :: drive_task

  !> Largest number of numbers of a result.
  integer, parameter :: max_numbers = 50000000
  !> Orders that a response has at first, by the number of axes.
  integer, parameter :: first_bounds(3) = [9, 5, 4]

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

  subroutine given_job(task, job, system)
    type(task_type), intent(inout) :: task
    type(driven_job), intent(out) :: job
    type(pendulum_type), pointer, intent(out) :: system
    real(wp) :: frequency(n_drives)

    system => task%pendulum()
    job%parameter = task%get_integer('varies')
    job%harmonics = task%get_integer('harmonics')
    job%choose_harmonics = task%get_flag('choose')
    job%symmetric = task%get_flag('symmetric')
    job%subharmonic = task%get_integer('subharmonic')
    job%max_denominator = task%get_integer('max_denominator')
    if (task%failed()) return
    frequency = system%parameters%frequency
    ! A varied frequency has a separate axis, so any value is sufficient.
    if (job%parameter >= 1 .and. job%parameter <= n_drives) then
      frequency(job%parameter) = task%get_real('start', 1.0_wp)
    end if
    call sort_drives(job%torus, frequency, system%parameters%load, job%parameter, &
                     job%subharmonic, job%max_denominator, task%status)
  end subroutine given_job

  !> Fail unless the orders up to a bound contain the loads and are at most `most`.
  subroutine check_bound(task, torus, bound, most)
    type(task_type), intent(inout) :: task
    type(drive_torus_type), intent(in) :: torus
    integer, intent(in) :: bound, most
    integer :: least

    least = lowest_bound(torus)
    if (task%failed()) return
    if (least > most) then
      call fail(task%status, status_input_error, 'max_denominator', 'max_denominator: the loads ' &
                //'are up to '//show(least)//' times their base frequencies, must be at most ' &
                //show(most))
    else if (bound < least .or. bound > most) then
      call fail(task%status, status_input_error, 'harmonics', 'harmonics = '//show(bound) &
                //': must be '//show(least)//' to '//show(most))
    end if
  end subroutine check_bound

  !> Fail if n solutions with orders up to a bound exceed the memory.
  subroutine check_size(task, name, n, torus, bound)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    integer, intent(in) :: n, bound
    type(drive_torus_type), intent(in) :: torus
    integer :: most

    most = max_numbers/n_unknowns(torus%n_axes, bound)
    if (n <= most .or. task%failed()) return
    call fail(task%status, status_input_error, name, trim(name)//': '//show(n)//' points, must ' &
              //'be at most '//show(most)//' with so many harmonics')
  end subroutine check_size

  !> Orders that n solutions have at first and at most.
  subroutine choose_bounds(task, job, load, n, first, last)
    type(task_type), intent(inout) :: task
    type(driven_job), intent(in) :: job
    real(wp), intent(in) :: load(n_drives)
    integer, intent(in) :: n
    integer, intent(out) :: first, last
    integer, allocatable :: orders(:, :)
    integer :: least

    first = job%harmonics
    associate (torus => job%torus)
      allocate (orders, source=lattice(torus%n_axes, 3))
      last = largest_bound(torus%n_axes, real(count(job%kept_of(orders, load)), wp) &
                           /(3*size(orders, 2)), max_without_matrix)
      least = lowest_bound(torus)
      if (job%choose_harmonics) first = max(least, min(max(first_bounds(torus%n_axes), &
                                                           2*least + 1), last))
      call check_bound(task, torus, first, last)
      if (.not. job%choose_harmonics) last = first
      ! Most of the unknowns may not be needed: they may take a part of the memory.
      do while (last > first .and. int(n, i8)*n_unknowns(torus%n_axes, last) > max_numbers/4)
        last = last - 1
      end do
      call check_size(task, merge('nu ', varied_names(max(job%parameter, 1)), &
                                  job%parameter == 0), n, torus, last)
    end associate
  end subroutine choose_bounds

  !> Base frequencies (n_axes, n) at values of the varied quantity, which load each of them equals
  !! (`named`, 0: several), the orders (n_axes, k) and which of them are unknowns, `kept` (k, 3).
  subroutine put_lattice(task, job, tracing, p, orders)
    type(task_type), intent(inout) :: task
    type(driven_job), intent(in) :: job
    type(tracing_type), intent(in) :: tracing
    real(wp), intent(in) :: p(:)
    integer, intent(in) :: orders(:, :)
    real(wp) :: base(job%torus%n_axes, size(p))

    base = spread(job%torus%base, 2, size(p))
    if (tracing%vary == vary_frequency) base(tracing%which, :) = p
    associate (found => task%found)
      call found%put_reals('base', base, shape(base))
      call found%put_integers('named', job%torus%named, shape(job%torus%named))
      call found%put_integers('orders', orders, shape(orders))
      call found%put_integers('kept', merge(1, 0, job%kept_of(orders, tracing%load)), &
                              [size(orders, 2), 3])
    end associate
  end subroutine put_lattice

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

  !> Solutions at parameter values `p` (n); if nothing varies, at the base frequency. With a
  !! `duration` > 0 for stability: for one axis Floquet `multipliers` (6, n), NaN if unknown, and
  !! the number outside of the unit circle (-1: unknown); otherwise growth `rates` (6, n) and their
  !! errors. `grows`: 1 if orders may have been added.
  subroutine solve_rows(task)
    type(task_type), intent(inout) :: task
    type(driven_job) :: job
    type(tracing_type), target :: tracing
    type(torus_ladder) :: ladder
    type(pendulum_type), pointer :: system
    real(wp), allocatable :: p(:), x(:, :), truncation(:), error(:), guess(:)
    integer, allocatable :: orders(:, :), outcome(:), iterations(:), highest(:), used(:)
    real(wp) :: duration, tolerance
    integer :: first, i, last, n

    call given_job(task, job, system)
    allocate (p, source=task%get_reals('p'))
    tolerance = task%get_real('tolerance')
    duration = task%get_real('duration', 0.0_wp)
    if (task%failed()) return
    if (job%parameter == 0) p = job%torus%base(:1)
    call tracing%begin(job, system, task%status)
    if (task%failed()) return
    call choose_bounds(task, job, tracing%load, size(p), first, last)
    if (task%failed()) return
    p = p/tracing%unit
    associate (step => checking_shells(job%torus))
      allocate (orders, source=lattice(job%torus%n_axes, last + step))
      call new_ladder(ladder, tracing%system, orders, job%kept_of(orders, tracing%load), &
                      job%torus%orders, job%torus%base, tracing%load, tracing%vary, &
                      tracing%which, first, last, step)
    end associate
    n = size(p)
    allocate (guess(n_unknowns(job%torus%n_axes, last)), source=0.0_wp)
    allocate (x(size(guess), n), truncation(n), error(n), outcome(n), iterations(n), highest(n))
    call torus_responses(ladder, p, tolerance, guess, x, outcome, iterations, highest, &
                         truncation, error, task%status, task%cancel)
    if (task%failed()) return
    used = pack([(i, i=1, size(orders, 2))], sum(abs(orders), 1) <= max(maxval(highest), first))
    call put_lattice(task, job, tracing, p, orders(:, used))
    associate (found => task%found)
      call put_harmonics(task, 'coefficients', x)
      call found%put_integer('grows', merge(1_i8, 0_i8, first < last))
      call found%put_integers('outcomes', outcome, [n])
      call found%put_integers('iterations', iterations, [n])
      call found%put_integers('highest', highest, [n])
      call found%put_reals('truncation', truncation, [n])
      call found%put_reals('error', error, [n])
    end associate
    if (duration > 0.0_wp) then
      call check_rows(task, ladder, p, x, outcome, maxval(highest), duration, &
                      job%torus%n_axes)
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

  !> Branch in the parameter that varies. It starts at a motion found at `start`, or leaves another
  !! branch at `begin` (m) and `begin_p` in the direction `along` (m + 1). With `stability`, for one
  !! axis multipliers as above; over a `duration` > 0, for several axes, rates.
  !!
  !! Also returns the highest order, `bound`, the estimated `truncation`, and the `unit` of the
  !! parameter.
  subroutine follow_branch(task)
    type(task_type), intent(inout) :: task
    type(driven_job) :: job
    type(tracing_type), target :: tracing
    type(curve_branch_type) :: branch
    type(leaving_type), allocatable :: leave
    type(pendulum_type), pointer :: system
    real(wp) :: truncation

    call given_job(task, job, system)
    job%options = given_curve(task)
    job%stability = task%get_flag('stability')
    if (task%has('begin')) then
      allocate (leave)
      allocate (leave%begin, source=task%get_reals('begin'))
      allocate (leave%along, source=task%get_reals('along'))
      leave%parameter = task%get_real('begin_p')
    end if
    if (task%failed()) return
    if (job%choose_harmonics) job%harmonics = default_bound(job%torus)
    if (job%choose_harmonics .and. allocated(leave)) then
      job%choose_harmonics = .false.
      job%harmonics = lowest_bound(job%torus)
      do while (n_unknowns(job%torus%n_axes, job%harmonics) < size(leave%begin))
        job%harmonics = job%harmonics + 1
      end do
    end if
    call check_bound(task, job%torus, job%harmonics, &
                     largest_bound(job%torus%n_axes, 1.0_wp, max_unknowns))
    call check_size(task, 'max_points', job%options%max_points, job%torus, job%harmonics)
    if (allocated(leave)) call check_leave(task, leave, &
                                           n_unknowns(job%torus%n_axes, job%harmonics))
    if (task%failed()) return
    call follow_with_enough(job, system, tracing, branch, truncation, task%status, leave, &
                            task%cancel)
    if (.not. task%failed()) call check_branch(task, job, tracing, branch, &
                                               task%get_real('duration', 0.0_wp))
    if (task%failed()) return
    associate (found => task%found)
      call found%put_integer('bound', int(tracing%bound, i8))
      call found%put_real('truncation', truncation)
      call found%put_real('unit', tracing%unit)
    end associate
    call put_lattice(task, job, tracing, branch%parameter(:branch%n_points), tracing%torus%orders)
    call put_branch(task, tracing%balance, branch)
  end subroutine follow_branch

  subroutine check_leave(task, leave, n)
    type(task_type), intent(inout) :: task
    type(leaving_type), intent(in) :: leave
    integer, intent(in) :: n
    if (size(leave%begin) /= n .and. .not. task%failed()) then
      call fail(task%status, status_input_error, 'leave', 'leave: has '//show(size(leave%begin)) &
                //' unknowns, must have as many as this curve ('//show(n)//'): use the same ' &
                //'harmonics, loads and symmetry')
    end if
    call task%check_extents('along', shape(leave%along), [n + 1])
  end subroutine check_leave

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
      if (.not. duration > 0.0_wp) return
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
    if (.not. job%stability) return
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
  !! `x` (m) at the parameter `p`, between `low` and `high`.
  subroutine find_peak(task)
    type(task_type), intent(inout) :: task
    type(driven_job) :: job
    type(tracing_type), target :: tracing
    type(pendulum_type), pointer :: system
    type(harmonic_measure) :: measure
    real(wp), pointer, contiguous :: x(:)
    real(wp), allocatable :: at(:)
    real(wp) :: p, peak_size
    integer :: dof, place, first
    logical :: summit

    call given_job(task, job, system)
    if (.not. task%failed()) call tracing%begin(job, system, task%status)
    if (.not. task%failed()) call tracing%set_balance(job, task%status)
    x => task%get_reals('x')
    p = task%get_real('p')/tracing%unit
    dof = task%get_integer('dof')
    place = task%get_integer('place')
    if (task%failed()) return
    call task%check_extents('x', shape(x), [3*tracing%torus%n])
    if (task%failed()) return
    at = tracing%balance%reduced(x)
    ! The mean has one unknown, other orders two.
    first = (dof - 1)*tracing%torus%n + max(1, 2*place - 2)
    measure%place = [row_of(first), row_of(min(first + 1, dof*tracing%torus%n))]
    peak_size = -1.0_wp
    summit = .false.
    if (place > 1 .and. all(measure%place > 0)) then
      call climb(tracing%balance, measure, task%get_real('tolerance'), &
                 task%get_real('low')/tracing%unit, task%get_real('high')/tracing%unit, at, p, &
                 summit, task%cancel)
      peak_size = measure%size_at(at, p)
    end if
    call task%found%put_real('at', p*tracing%unit)
    call task%found%put_real('size', peak_size)
    call task%found%put_integer('enclosed', merge(1_i8, 0_i8, summit))

  contains

    !> Index of an unknown among the kept unknowns; 0: not kept.
    integer function row_of(j)
      integer, intent(in) :: j
      real(wp) :: one(size(x))
      one = 0.0_wp
      one(j) = 1.0_wp
      row_of = findloc(tracing%balance%reduced(one) > 0.5_wp, .true., 1)
    end function row_of

  end subroutine find_peak

end module viscovib_drive_tasks
