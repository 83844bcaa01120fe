! Optimize: -O1
!> Tasks about branches of periodic solutions of oscillators. System and load are given as in
!! `viscovib_response_tasks`.
module viscovib_branch_tasks
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_binding_tools, only: to_complex
  use viscovib_branch_job, only: plan_along
  use viscovib_crossings, only: crossing_type, find_crossings
  use viscovib_curve_branch, only: curve_branch_type, curve_options, curve_outcomes, curve_table
  use viscovib_family_curve, only: check_systems, new_family_curve, new_plain_curve, &
    system_builder
  use viscovib_free_orders, only: first_chosen, highest_chosen
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: i8, wp
  use viscovib_limits, only: corner_tolerance, max_harmonics, max_time_tolerance, max_tolerance, &
                             min_time_tolerance, min_tolerance, nearly_nothing, smooth_tolerance
  use viscovib_load, only: load_type
  use viscovib_motion_stability, only: stability_checker, new_stability_checker, stability_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: oscillator_curve_type, vary_frequency, vary_load
  use viscovib_outcomes, only: outcome_converged
  use viscovib_response, only: response_options
  use viscovib_response_branch, only: departure_type, follow_response
  use viscovib_response_plan, only: max_iterations_allowed, method_newton, new_response_plan, &
    response_plan_type
  use viscovib_response_tasks, only: given_builder, given_load, given_options, &
    given_variation, planned_orders, put_stability
  use viscovib_sized_curve, only: refitted
  use viscovib_task, only: task_type
  use viscovib_truncated_stability, only: doubt_curve
  implicit none
  private

  public :: branch_task
  public :: given_curve, put_curve, put_crossings

contains

  subroutine branch_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('limits')
      call put_limits(task)
    case ('plan')
      call plan_branch(task)
    case ('follow')
      call follow_branch(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine branch_task

  !> Bounds for checks of arguments, and the comma-separated words for the ends of curves.
  subroutine put_limits(task)
    type(task_type), intent(inout) :: task
    character(len=:), allocatable :: words
    integer :: i
    words = trim(curve_outcomes(lbound(curve_outcomes, 1)))
    do i = lbound(curve_outcomes, 1) + 1, ubound(curve_outcomes, 1)
      words = words//','//trim(curve_outcomes(i))
    end do
    associate (found => task%found)
      call found%put_text('endings', words)
      call found%put_integer('harmonics', int(max_harmonics, i8))
      call found%put_integer('iterations', int(max_iterations_allowed, i8))
      ! Initial and largest number of orders for free vibrations of a pendulum.
      call found%put_integer('first_free', int(first_chosen, i8))
      call found%put_integer('most_free', int(highest_chosen, i8))
      call found%put_reals('tolerance', [min_tolerance, max_tolerance], [2])
      call found%put_real('smooth_tolerance', smooth_tolerance)
      call found%put_real('corner_tolerance', corner_tolerance)
      call found%put_reals('time_tolerance', [min_time_tolerance, max_time_tolerance], [2])
      ! Replaces 0 in a parameter that varies.
      call found%put_real('nearly_nothing', nearly_nothing)
    end associate
  end subroutine put_limits

  !> First lines of the plan of a branch in `name`, with `n_orders`, or at most `most` orders.
  subroutine plan_branch(task)
    type(task_type), intent(inout) :: task
    character(len=:), allocatable :: name
    call task%take_text('name', name)
    call task%found%put_text( &
      'text', plan_along(name, task%get_real('start'), task%get_real('finish'), &
                         task%get_integer('n_orders', 0), task%get_integer('most', 0), &
                         task%get_flag('stability')))
  end subroutine plan_branch

  !> Options for following a curve: those of `curve_table` by name, `start`, `finish`, and parameter
  !! values at which a point is required, `stops` (n).
  function given_curve(task) result(options)
    type(task_type), intent(inout) :: task
    type(curve_options) :: options
    real(wp), pointer, contiguous :: stops(:)
    real(wp) :: values(size(curve_table))
    integer :: i

    options%start = task%get_real('start')
    options%finish = task%get_real('finish')
    do i = 1, size(curve_table)
      associate (option => curve_table(i))
        if (option%whole) then
          values(i) = task%get_integer(trim(option%name), nint(option%default))
        else
          values(i) = task%get_real(trim(option%name), option%default)
        end if
      end associate
    end do
    call options%set(values)
    allocate (options%stops(0))
    if (.not. task%has('stops')) return
    stops => task%get_reals('stops')
    options%stops = stops
  end function given_curve

  !> Results of every curve: `p`, `iterations`, `error`, `off` of points, outcome `ended`, points at
  !! `stops` (from 1); folds and branch points with errors and the points before them (from 1).
  subroutine put_curve(task, branch)
    type(task_type), intent(inout) :: task
    type(curve_branch_type), intent(in) :: branch

    associate (found => task%found, n => branch%n_points, folds => branch%folds, &
               points => branch%branch_points)
      call found%put_integer('ended', int(branch%outcome, i8))
      call found%put_reals('p', branch%parameter(:n), [n])
      call found%put_integers('iterations', branch%iterations(:n), [n])
      call found%put_reals('error', branch%error(:n), [n])
      call found%put_reals('off', branch%off(:n), [n])
      call found%put_integers('stops', branch%stops, shape(branch%stops))
      call found%put_reals('folds', folds%p(:folds%n), [folds%n])
      call found%put_reals('fold_errors', folds%error(:folds%n), [folds%n])
      call found%put_integers('fold_before', folds%before(:folds%n), [folds%n])
      call found%put_reals('branch_points', points%p(:points%n), [points%n])
      call found%put_reals('branch_errors', points%error(:points%n), [points%n])
      call found%put_integers('branch_before', points%before(:points%n), [points%n])
    end associate
  end subroutine put_curve

  !> Changes of stability: `kinds` as in `viscovib_crossings`, points before them (from 1),
  !! locations, NaN if unknown, with errors.
  subroutine put_crossings(task, crossings)
    type(task_type), intent(inout) :: task
    type(crossing_type), intent(in) :: crossings(:)

    associate (found => task%found, n => size(crossings))
      call found%put_integers('kinds', crossings%kind, [n])
      call found%put_integers('before', crossings%before, [n])
      call found%put_reals('crossings', merge(crossings%p, ieee_value(0.0_wp, ieee_quiet_nan), &
                                              crossings%located), [n])
      call found%put_reals('crossing_errors', crossings%error, [n])
    end associate
  end subroutine put_crossings

  !> Branch of solutions in the parameter `varies`: the frequency, the load factor at the frequency
  !! `at_nu`, or system parameters. `harmonics`: largest number of orders, 0: chosen at each point;
  !! unless `symmetric`, the mean and even orders are kept even if odd ones suffice. The branch
  !! starts at the solution `begin` (2 m n_dof) and `begin_p` in the direction `along` (2 m
  !! n_dof + 1), for all orders that the plan may keep, or near `begin` if `along` is 0. Without
  !! these it starts at a solution found at `start`. If no start is found there are no results.
  subroutine follow_branch(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    class(oscillator_type), allocatable, target :: own
    class(system_builder), allocatable :: builder
    class(oscillator_curve_type), allocatable :: curve
    type(load_type), target :: load
    type(response_options) :: wanted
    type(response_plan_type) :: plan
    type(curve_options) :: options
    type(curve_branch_type) :: branch
    type(harmonic_set_type) :: set
    type(departure_type) :: departure
    real(wp), pointer, contiguous :: begin(:), along(:)
    real(wp) :: nu
    integer :: parameter, found
    logical :: checked

    parameter = given_variation(task)
    options = given_curve(task)
    nu = task%get_real('at_nu')
    call given_load(task, load)
    if (parameter > vary_load) then
      allocate (builder, source=given_builder(task))
      if (.not. task%failed()) call builder%build(options%start, own, task%status)
      system => own
    else
      system => task%system(with_speed=.true.)
    end if
    if (task%failed()) return
    call task%check_extents('series', [size(load%force, 1)], [system%n_dof()])
    wanted = given_options(task)
    wanted%keep_idle = .true.
    wanted%on_branch = .true.
    checked = wanted%stability
    wanted%stability = .false.
    if (.not. task%failed()) then
      call new_response_plan(plan, system, load, [nu], method_newton, wanted, task%status)
    end if
    if (parameter == vary_frequency .and. .not. task%failed()) then
      call load%check_between(options%start, options%finish, task%status)
    end if
    if (task%failed()) return
    if (parameter > vary_load) then
      call new_family_curve(curve, builder, options%start, &
                            max(abs(options%start), abs(options%finish)), load, plan%set, nu, &
                            task%status)
    else
      call new_plain_curve(curve, system, load, plan%set, parameter, nu)
    end if
    if (task%failed()) return
    if (task%has('begin')) then
      begin => task%get_reals('begin')
      along => task%get_reals('along')
      call task%check_extents('along', shape(along), [size(begin) + 1])
      departure = departure_type(begin, along, task%get_real('begin_p'))
      if (task%failed()) return
      call follow_response(curve, plan, options, branch, set, found, departure, task%cancel)
    else
      if (parameter == vary_load) curve%balance%load_factor = options%start
      call follow_response(curve, plan, options, branch, set, found, cancel=task%cancel)
    end if
    if (found /= outcome_converged .or. branch%n_points == 0) return
    call put_branch(task, branch, set, size(planned_orders(plan, system, load)))
    if (checked) call check_branch(task, system, curve, branch, set, parameter, nu)
  end subroutine follow_branch

  !> Points of a branch and its special points. Unknowns at branch points are for all `n_planned`
  !! orders that the branch may keep.
  subroutine put_branch(task, branch, set, n_planned)
    type(task_type), intent(inout) :: task
    type(curve_branch_type), intent(in) :: branch
    type(harmonic_set_type), intent(in) :: set
    integer, intent(in) :: n_planned
    real(wp), allocatable :: x(:, :), across(:, :)
    integer :: i, n, n_all, n_dof, n_orders, m

    n = branch%n_points
    n_orders = size(set%orders)
    m = size(branch%x, 1)
    n_dof = m/(2*n_orders)
    n_all = 2*n_planned*n_dof
    call put_curve(task, branch)
    associate (found => task%found, points => branch%branch_points, folds => branch%folds)
      call found%put_integers('harmonics', set%orders, [n_orders])
      call found%put_integers('highest', set%orders(branch%kept(:n)/(2*n_dof)), [n])
      call found%put_reals('truncation', branch%truncation(:n), [n])
      call found%put_reals('missed', branch%missed(:n), [n])
      call found%put_reals('allowed', branch%allowed, [n])
      call put_motions(task, 'coefficients', branch%x(:, :n), n_orders, n_dof)
      call found%put_reals('fold_coefficient_errors', folds%error_x(:folds%n), [folds%n])
      call put_motions(task, 'fold_coefficients', folds%x(:, :folds%n), n_orders, n_dof)
      call put_motions(task, 'branch_coefficients', points%x(:, :points%n), n_orders, n_dof)
      call put_motions(task, 'branch_directions', points%across(:m, :points%n), n_orders, n_dof)
      allocate (x(n_all, points%n), across(n_all + 1, points%n))
      do i = 1, points%n
        x(:, i) = refitted(n_dof, points%x(:m, i), n_all)
        across(:, i) = [refitted(n_dof, points%across(:m, i), n_all), points%across(m + 1, i)]
      end do
      call found%put_reals('branch_x', x, shape(x))
      call found%put_reals('across', across, shape(across))
    end associate
  end subroutine put_branch

  subroutine put_motions(task, name, x, n_orders, n_dof)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    real(wp), intent(in) :: x(:, :)
    integer, intent(in) :: n_orders, n_dof
    complex(wp), allocatable :: motions(:, :, :)
    allocate (motions(n_orders, n_dof, size(x, 2)))
    call to_complex(x, motions)
    call task%found%put_complexes(name, motions, shape(motions))
  end subroutine put_motions

  !> Stability along a branch, and its changes.
  subroutine check_branch(task, system, curve, branch, set, parameter, nu)
    type(task_type), intent(inout) :: task
    class(oscillator_type), intent(in), target :: system
    class(oscillator_curve_type), allocatable, intent(inout) :: curve
    type(curve_branch_type), intent(in) :: branch
    type(harmonic_set_type), intent(in) :: set
    integer, intent(in) :: parameter
    real(wp), intent(in) :: nu
    type(stability_checker) :: checker
    type(stability_type) :: stability
    type(crossing_type), allocatable :: crossings(:)
    real(wp), allocatable :: motions(:, :, :), places(:, :)
    integer :: i, m, n

    n = branch%n_points
    m = size(branch%x, 1)
    call new_stability_checker(checker, system, set)
    motions = reshape(branch%x(:, :n), [2*size(set%orders), system%n_dof(), n])
    associate (p => branch%parameter(:n))
      if (parameter > vary_load) then
        call check_systems(checker, curve, nu, p, motions, stability, task%cancel)
      else
        call checker%check(system, [(merge(p(i), nu, parameter == vary_frequency), i=1, n)], &
                         motions, stability, task%cancel)
      end if
      call find_crossings(checker, curve, nu, p, branch%x(:, :n), stability, branch%folds, &
                          branch%branch_points, crossings, task%cancel)
      call doubt_curve(checker, curve, nu, p, motions, branch%missed(:n), branch%allowed, &
                       stability, task%cancel)
    end associate
    call put_stability(task, stability, system%n_dof())
    call put_crossings(task, crossings)
    allocate (places(m, size(crossings)), source=0.0_wp)
    do i = 1, size(crossings)
      if (crossings(i)%located) places(:, i) = crossings(i)%x
    end do
    call put_motions(task, 'crossing_coefficients', places, size(set%orders), system%n_dof())
  end subroutine check_branch

end module viscovib_branch_tasks
