! Optimize: -O1
!> Tasks about solutions in time: runs, their preparation, and plans.
module viscovib_motion_tasks
  use viscovib_base_motion, only: base_motion_type
  use viscovib_body_vector, only: mounted_from_vector
  use viscovib_element_forces, only: element_forces_type, find_element_forces, &
    find_forces_by_kernel, find_mount_springs
  use viscovib_system_vector, only: elements_from_vector
  use viscovib_constants, only: pi
  use viscovib_fitted_memory, only: bound_hidden, fit_memory, needs_fit
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_hereditary_job, only: hereditary_job, plan_hereditary
  use viscovib_hidden_memory, only: count_hidden
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: i8, wp
  use viscovib_known_motion, only: known_motion
  use viscovib_load, only: load_type
  use viscovib_located_peaks, only: is_loose, locate_peaks, peak_windows
  use viscovib_memory_pieces, only: oscillator_equations, structure_equations
  use viscovib_mesh, only: extend_ends
  use viscovib_method_catalogue, only: transient_methods
  use viscovib_lanes, only: max_dof
  use viscovib_motion_choice, only: by_modes, choose_equations, driven_coordinates, fastest_rate, &
    hereditary_methods, is_on_shaft, motion_wish, nodes, per_period, switches_in_time, &
    without_memory
  use viscovib_motion_inputs, only: load_of, polynomial_of, read_known, read_known_load, &
    read_past, read_sections, read_tables
  use viscovib_motion_balance, only: accelerations_of, panel_points, recalled_along
  use viscovib_motion_panels, only: panel_ends, panel_times, states_on_panels
  use viscovib_motion_search, only: run_motion
  use viscovib_mount, only: mount_type
  use viscovib_mount_forces, only: find_mount_forces, find_spring_memory, mount_forces_type
  use viscovib_mounted_body, only: mounted_body
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_job, only: plan_pendulum
  use viscovib_point_motion, only: move_point
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_job, only: plan_polynomial
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_reduction, only: moved_coordinates
  use viscovib_shock_shapes, only: find_turn, new_shock, shock_names, shock_type
  use viscovib_search_reason, only: max_kept
  use viscovib_steady_motion_tasks, only: find_motion_extremes, run_period, &
    steady_motion, trace_branch
  use viscovib_spline_integral, only: spline_integral
  use viscovib_status, only: fail, show, status_input_error
  use viscovib_structure_elements, only: element_type
  use viscovib_structure_job, only: rate_seen
  use viscovib_structure_supports, only: support_rows
  use viscovib_step_search, only: max_steps
  use viscovib_task, only: task_type
  use viscovib_time_load, only: time_load_type
  use viscovib_timed_polynomials, only: timed_polynomials
  use viscovib_turning_body, only: row_of
  implicit none
  private

  public :: motion_task

  !> Largest time of continued runs, relative to the run time; a time that represents infinity.
  real(wp), parameter :: furthest = 100.0_wp, ever = 1.0e30_wp

contains

  subroutine motion_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('given')
      ! An object that contains values for the tasks that use it.
      return
    case ('of pendulum', 'of oscillator', 'of structure')
      ! Without steps it is an object, the equations of a part of a run.
      if (task%has('n_steps')) call run_motion(task)
    case ('run')
      call run_motion(task)
    case ('of a period')
      call run_period(task)
    case ('steady')
      call steady_motion(task)
    case ('branch')
      call trace_branch(task)
    case ('extremes')
      call find_motion_extremes(task)
    case ('accelerations')
      call find_accelerations(task)
    case ('mount forces')
      call find_forces_of_mounts(task)
    case ('at point')
      call find_point_motion(task)
    case ('element forces')
      call find_forces_of_elements(task)
    case ('support reactions')
      call find_support_reactions(task)
    case ('peaks')
      call find_peaks(task)
    case ('work')
      call find_work(task)
    case ('shock')
      call find_shock(task)
    case ('sum of tables')
      call add_tables(task)
    case ('table at')
      call evaluate_table(task)
    case ('corners')
      call find_corners(task)
    case ('mesh')
      call extend_mesh(task)
    case ('equations')
      call find_equations(task)
    case ('first steps')
      call find_first_steps(task)
    case ('loads')
      call find_loads(task)
    case ('loads at')
      call find_loads_at(task)
    case ('panels')
      call find_panels(task)
    case ('hidden coordinates')
      call count_hidden_coordinates(task)
    case ('plan of pendulum', 'plan of oscillator')
      call plan_motion(task, name)
    case default
      call task%refuse_kind()
    end select
  end subroutine motion_task

  !> Absolute `accelerations` (n, n_dof) by the equations, of a motion as of `read_known`.
  subroutine find_accelerations(task)
    type(task_type), intent(inout) :: task
    type(known_motion) :: motion
    class(oscillator_type), pointer :: system
    real(wp), allocatable :: a(:, :)

    system => task%system(with_shaft=.true.)
    if (task%failed()) return
    call read_known(task, system%n_dof(), motion)
    if (.not. task%failed()) call accelerate(task, system, motion, a)
    if (task%failed()) return
    a = a + motion%moved(:, :, 3)
    call task%found%put_reals('accelerations', a, shape(a))
  end subroutine find_accelerations

  !> Accelerations relative to the base, a row for each time: `accelerations` (n_dof + k, m) that
  !! the equations gave along the motion, or those of its states. `remembered` (n, n_dof): forces
  !! -R * g on the coordinates, if these are known.
  subroutine accelerate(task, system, motion, a)
    type(task_type), intent(inout) :: task
    class(oscillator_type), intent(in) :: system
    type(known_motion), intent(in) :: motion
    real(wp), allocatable, intent(out) :: a(:, :)
    type(time_load_type) :: loads
    type(base_motion_type) :: base
    real(wp), allocatable :: recalled(:, :), load(:, :)
    logical :: singular

    if (task%has('accelerations')) then
      associate (given => task%get_matrix('accelerations'))
        a = transpose(given(:system%n_dof(), :size(motion%times)))
      end associate
      return
    end if
    call read_known_load(task, loads, base)
    load = loads%at_times(motion%times)
    allocate (recalled(size(motion%times), system%n_memory()), source=0.0_wp)
    if (task%has('remembered')) then
      associate (remembered => task%get_matrix('remembered'))
        call task%check_extents('remembered', shape(remembered), shape(load))
        if (task%failed()) return
        load = load - remembered
      end associate
    else if (allocated(motion%ends)) then
      call recalled_along(system, motion%ends, motion%panel_u, motion%panel_rate, motion%held, &
                          motion%times, recalled)
    end if
    allocate (a(size(load, 1), size(load, 2)))
    call accelerations_of(system, motion%u, motion%rate, load, recalled, a, singular)
    if (.not. singular) return
    call fail(task%status, status_input_error, 'mass', 'mass: is singular, so the equations of ' &
              //'motion give no accelerations')
  end subroutine accelerate

  !> Panels of a run until a time: `panel_ends` and the `panel_times` of their points, as of
  !! `panel_times`; `panel_states` there if the `states` kept at `times` give them. Input: `h` and
  !! `until`; ends of unequal steps, `ends` and `made_by`; `repeats`: states do not give them.
  subroutine find_panels(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: times(:), states(:, :)
    integer(i8), allocatable :: made_by(:)
    real(wp), allocatable :: step_ends(:), ends(:), found(:, :)
    real(wp) :: h, until
    integer(i8) :: n

    times => task%get_reals('times')
    states => task%get_matrix('states')
    if (task%has('ends')) then
      allocate (step_ends, source=task%get_reals('ends'))
      allocate (made_by, source=task%get_longs('made_by'))
    end if
    until = task%get_real('until')
    h = task%get_real('h')
    if (task%failed()) return
    n = ceiling(until/h, i8)
    if (allocated(made_by)) n = made_by(size(made_by))
    if (real(n, wp)*size(states, 1)*(panel_points + 2) > max_kept) then
      call fail(task%status, status_input_error, 'motion', 'a motion of ' &
                //show(int(min(n, int(huge(1), i8))))//' steps with memory and ' &
                //show(size(states, 1)/2)//' coordinates: is too long for its ' &
                //'accelerations and forces: use a shorter run')
      return
    end if
    ends = panel_ends(h, until, step_ends, made_by)
    call task%found%put_reals('panel_ends', ends, shape(ends))
    if (.not. task%get_flag('repeats')) call states_on_panels(ends, times, states, found)
    if (allocated(found)) then
      call task%found%put_reals('panel_states', found, shape(found))
    else
      associate (all_times => panel_times(ends))
        call task%found%put_reals('panel_times', all_times, shape(all_times))
      end associate
    end if
  end subroutine find_panels

  !> Forces of the mounts of a body, `flat` as of `mounted_from_vector` about its static
  !! equilibrium, `exact` (finite rotations), `mount_of` (n_springs) and `center` (3), along a
  !! motion as of `read_known`. Returns what `mount_forces_type` contains, and the forces -R * g on
  !! the coordinates, `remembered` (n, n_dof), of small rotations.
  subroutine find_forces_of_mounts(task)
    type(task_type), intent(inout) :: task
    type(mounted_body) :: body
    type(kernel_holder), allocatable :: kernels(:)
    type(mount_forces_type) :: forces
    type(known_motion) :: motion
    real(wp), pointer, contiguous :: center(:)
    real(wp), allocatable :: memory(:, :), rows(:, :)
    integer, allocatable :: mount_of(:)
    integer :: j, n

    call mounted_from_vector(body, kernels, task%get_reals('flat'), task%status)
    if (task%failed()) return
    n = body%n_dof()
    body%exact = task%get_flag('exact')
    center => task%get_reals('center')
    mount_of = task%get_integers('mount_of')
    call read_known(task, n, motion)
    call task%check_extents('center', shape(center), [3])
    call task%check_extents('mount_of', shape(mount_of), shape(body%springs))
    if (task%failed()) return
    allocate (memory(size(motion%u, 1), size(body%springs)), source=0.0_wp)
    if (allocated(motion%ends)) then
      call find_spring_memory(body%springs, kernels, body%exact, motion%ends, motion%panel_u, &
                              motion%panel_rate, motion%held, motion%times, memory)
    end if
    call find_mount_forces(body%springs, mount_of, body%exact, center, motion%u, motion%rate, &
                           memory, forces)
    call put_parts(task, forces, [size(motion%u, 1), 3, size(forces%point, 3)])
    call task%found%put_reals('moment', forces%moment, shape(forces%point))
    call task%found%put_reals('point', forces%point, shape(forces%point))
    call task%found%put_reals('floor', forces%floor, shape(forces%floor))
    if (body%exact) return
    allocate (rows(size(body%springs), n))
    do j = 1, size(rows, 1)
      rows(j, :) = row_of(body%springs(j), n)
    end do
    rows = matmul(memory, rows)
    call task%found%put_reals('remembered', rows, shape(rows))
  end subroutine find_forces_of_mounts

  !> Forces of the `elements` of a structure (`elements_from_vector`), or else of the springs of the
  !! system, along a motion as of `read_known`. Motions `apart` (n, n_held, 3) of supports, with
  !! their `weights` (n_held, m) in the deflections. Returns what `element_forces_type` contains.
  subroutine find_forces_of_elements(task)
    type(task_type), intent(inout) :: task
    type(known_motion) :: motion
    type(element_forces_type) :: forces
    class(oscillator_type), pointer :: system

    if (task%has('elements')) then
      call find_forces_in_structure(task, forces)
    else
      system => task%system()
      if (task%failed()) return
      call read_known(task, system%n_dof(), motion)
      if (task%failed()) return
      select type (system)
      type is (mount_type)
        call find_mount_springs(system, motion%sampled_motion, forces)
      type is (polynomial_type)
        call find_forces_by_kernel(system, motion%sampled_motion, forces)
      class default
        call task%refuse_kind()
      end select
    end if
    if (task%failed()) return
    call put_parts(task, forces, shape(forces%elastic))
  end subroutine find_forces_of_elements

  subroutine put_parts(task, forces, extents)
    type(task_type), intent(inout) :: task
    class(element_forces_type), intent(in) :: forces
    integer, intent(in) :: extents(:)
    call task%found%put_reals('deflection', forces%deflection, extents)
    call task%found%put_reals('rate', forces%rate, extents)
    call task%found%put_reals('elastic', forces%elastic, extents)
    call task%found%put_reals('damping', forces%damping, extents)
    call task%found%put_reals('memory', forces%memory, extents)
  end subroutine put_parts

  subroutine find_forces_in_structure(task, forces)
    type(task_type), intent(inout) :: task
    type(element_forces_type), intent(out) :: forces
    type(element_type), allocatable :: elements(:)
    type(kernel_holder), allocatable :: kernels(:)
    type(known_motion) :: motion
    real(wp), pointer, contiguous :: apart(:, :, :), weights(:, :), flat(:)
    integer :: j

    flat => task%get_reals('elements')
    call elements_from_vector(elements, kernels, flat, task%status)
    if (task%failed()) return
    call read_known(task, nint(flat(1)), motion)
    if (task%failed()) return
    if (.not. task%has('apart')) then
      call find_element_forces(elements, kernels, motion%sampled_motion, forces)
      return
    end if
    apart => task%get_cube('apart')
    weights => task%get_matrix('weights')
    call task%check_extents('apart', shape(apart), [size(motion%u, 1), size(weights, 1), 3])
    call task%check_extents('weights', shape(weights), [size(weights, 1), size(elements)])
    if (task%failed()) return
    do j = 1, size(elements)
      elements(j)%ends = weights(:, j)
    end do
    call find_element_forces(elements, kernels, motion%sampled_motion, forces, apart)
  end subroutine find_forces_in_structure

  !> Forces `force` (n, n_held) that hold supports, without those of elements, as of `reactions`,
  !! along a motion as of `read_known`: `base` (n, 3), `apart` (n, n_held, 3), and the rows `free`
  !! (n_held, n_free, 3), `held` (n_held, n_held, 3) and `based` (n_held, 3).
  subroutine find_support_reactions(task)
    type(task_type), intent(inout) :: task
    type(known_motion) :: motion
    type(support_rows) :: rows
    class(oscillator_type), pointer :: system
    real(wp), pointer, contiguous :: base(:, :), apart(:, :, :)
    real(wp), allocatable :: a(:, :), force(:, :), moved(:, :, :)
    integer :: n, n_held

    base => task%get_matrix('base')
    apart => task%get_cube('apart')
    allocate (rows%free, source=task%get_cube('free'))
    allocate (rows%held, source=task%get_cube('held'))
    allocate (rows%based, source=task%get_matrix('based'))
    system => task%system(with_shaft=.true.)
    if (task%failed()) return
    call read_known(task, system%n_dof(), motion)
    if (task%failed()) return
    n = size(motion%times)
    n_held = size(rows%based, 1)
    call task%check_extents('base', shape(base), [n, 3])
    call task%check_extents('apart', shape(apart), [n, n_held, 3])
    call task%check_extents('free', shape(rows%free), [n_held, size(motion%u, 2), 3])
    call task%check_extents('held', shape(rows%held), [n_held, n_held, 3])
    call task%check_extents('based', shape(rows%based), [n_held, 3])
    if (task%failed()) return
    call accelerate(task, system, motion, a)
    if (task%failed()) return
    allocate (moved, source=reshape([motion%u, motion%rate, a], [shape(a), 3]))
    force = rows%reactions(moved, base, apart)
    call task%found%put_reals('force', force, shape(force))
  end subroutine find_support_reactions

  !> Displacements, velocities and accelerations `moved` (n, 3, 3) of a point, as of `move_point`:
  !! `arm` (3), `exact`, `u`, `rate` and `push` (n, n_dof).
  subroutine find_point_motion(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: arm(:), u(:, :), rate(:, :), push(:, :)
    real(wp), allocatable :: moved(:, :, :)
    logical :: exact

    arm => task%get_reals('arm')
    exact = task%get_flag('exact')
    u => task%get_matrix('u')
    rate => task%get_matrix('rate')
    push => task%get_matrix('push')
    call task%check_extents('arm', shape(arm), [3])
    call task%check_extents('rate', shape(rate), shape(u))
    call task%check_extents('push', shape(push), shape(u))
    if (task%failed()) return
    moved = move_point(arm, exact, u, rate, push)
    call task%found%put_reals('moved', moved, shape(moved))
  end subroutine find_point_motion

  !> Located `peak` (m) with the time `at` and the `error` of the location, of quantities `values`
  !! (n, m) at ascending times `t` (n). Between `breaks` they are smooth. Quantities that need more
  !! samples are `loose`, as of `peak_windows` with `times_i` and `ends_i`.
  subroutine find_peaks(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: t(:), values(:, :), breaks(:)
    real(wp), allocatable :: peak(:), at(:), error(:), times(:), ends(:)
    integer, allocatable :: loose(:)
    integer :: i

    t => task%get_reals('t')
    values => task%get_matrix('values')
    breaks => task%get_reals('breaks')
    if (task%failed()) return
    call task%check_extents('t', shape(t), [size(values, 1)])
    if (task%failed()) return
    allocate (peak(size(values, 2)), at(size(values, 2)), error(size(values, 2)))
    call locate_peaks(t, values, breaks, peak, at, error)
    call task%found%put_reals('peak', peak, shape(peak))
    call task%found%put_reals('at', at, shape(at))
    call task%found%put_reals('error', error, shape(error))
    loose = pack([(i, i=1, size(peak))], is_loose(peak, error))
    call task%found%put_integers('loose', loose, shape(loose))
    do i = 1, size(loose)
      call peak_windows(t, values(:, loose(i)), times, ends)
      call task%found%put_reals('times_'//show(loose(i)), times, shape(times))
      call task%found%put_reals('ends_'//show(loose(i)), ends, shape(ends))
    end do
  end subroutine find_peaks

  !> `work` (n, m), the integrals of `power` (n, m) over the times `t` (n), as of `spline_integral`.
  subroutine find_work(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: t(:), power(:, :)
    real(wp), allocatable :: work(:, :)
    integer :: j

    t => task%get_reals('t')
    power => task%get_matrix('power')
    if (task%failed()) return
    call task%check_extents('t', shape(t), [size(power, 1)])
    if (task%failed()) return
    allocate (work, mold=power)
    do j = 1, size(power, 2)
      work(:, j) = spline_integral(t, power(:, j))
    end do
    call task%found%put_reals('work', work, shape(work))
  end subroutine find_work

  !> A shock of height 1 by the `shape` of its name and its numbers as of `shock_type`: `times` (n)
  !! and `pieces` (p, n). Of a run-up also `turn_start`, `turn_times` and `turn_pieces`, as of
  !! `find_turn`.
  subroutine find_shock(task)
    type(task_type), intent(inout) :: task
    type(shock_type) :: shock
    real(wp), allocatable :: times(:), pieces(:, :)
    real(wp) :: start(2), ends(2), slopes(1, 2)
    character(len=:), allocatable :: shape_name
    integer :: i

    call task%take_text('shape', shape_name)
    if (task%failed()) return
    do i = 1, size(shock_names) - 1
      if (shock_names(i) == shape_name) exit
    end do
    shock%shape = i
    shock%start = task%get_real('start')
    shock%duration = task%get_real('duration', 0.0_wp)
    shock%rise = task%get_real('rise', 0.0_wp)
    shock%fall = task%get_real('fall', 0.0_wp)
    shock%is_logarithmic = task%get_flag('is_logarithmic', .false.)
    shock%hold = task%get_real('hold', 0.0_wp)
    shock%phase = task%get_real('phase', 0.0_wp)
    if (shape_name == 'chirp') shock%hz = pair('hz')
    if (shape_name == 'run_up') shock%speed = pair('speed')
    if (task%failed()) return
    call new_shock(shock, times, pieces, task%status)
    if (task%failed()) return
    call task%found%put_reals('times', times, shape(times))
    call task%found%put_reals('pieces', pieces, shape(pieces))
    if (shape_name /= 'run_up') return
    call find_turn(shock, start, ends, slopes)
    call task%found%put_reals('turn_start', start, shape(start))
    call task%found%put_reals('turn_times', ends, shape(ends))
    call task%found%put_reals('turn_pieces', slopes, shape(slopes))

  contains

    function pair(name)
      character(len=*), intent(in) :: name
      real(wp) :: pair(2)
      pair = 0.0_wp
      associate (given => task%get_reals(name))
        call task%check_extents(name, shape(given), [2])
        if (.not. task%failed()) pair = given
      end associate
    end function pair

  end subroutine find_shock

  !> The sum of two tables of loads, `breaks` and `pieces`, `other_breaks` and `other_pieces`:
  !! `breaks` and `pieces` as of `timed_polynomials`.
  subroutine add_tables(task)
    type(task_type), intent(inout) :: task
    type(timed_polynomials) :: table, other
    call read_table(task, '', table)
    call read_table(task, 'other_', other)
    if (task%failed()) return
    call task%check_extents('other_pieces', shape(other%pieces), [size(table%pieces, 1), &
                                                size(other%pieces, 2), size(other%breaks)])
    if (task%failed()) return
    call table%add(other)
    call task%found%put_reals('breaks', table%breaks, shape(table%breaks))
    call task%found%put_reals('pieces', table%pieces, shape(table%pieces))
  end subroutine add_tables

  !> The loads of a table, `breaks` and `pieces`, at `times` (n): `values` (n, n_rows).
  subroutine evaluate_table(task)
    type(task_type), intent(inout) :: task
    type(timed_polynomials) :: table
    real(wp), pointer, contiguous :: times(:)
    real(wp), allocatable :: values(:, :)
    integer :: i
    call read_table(task, '', table)
    times => task%get_reals('times')
    if (task%failed()) return
    allocate (values(size(times), size(table%pieces, 1)))
    do i = 1, size(times)
      values(i, :) = table%at(times(i))
    end do
    call task%found%put_reals('values', values, shape(values))
  end subroutine evaluate_table

  !> `times` at which a table of loads, `breaks` and `pieces`, is not smooth, and its ends.
  subroutine find_corners(task)
    type(task_type), intent(inout) :: task
    type(timed_polynomials) :: table
    real(wp), allocatable :: times(:)
    call read_table(task, '', table)
    if (task%failed()) return
    allocate (times, source=table%corners())
    call task%found%put_reals('times', times, shape(times))
  end subroutine find_corners

  subroutine read_table(task, prefix, table)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: prefix
    type(timed_polynomials), intent(out) :: table
    allocate (table%breaks, source=task%get_reals(prefix//'breaks'))
    allocate (table%pieces, source=task%get_cube(prefix//'pieces'))
    call task%check_extents(prefix//'pieces', shape(table%pieces), &
                            [shape(table%pieces(:, :, 1)), size(table%breaks)])
  end subroutine read_table

  !> `ends` (n) and `made_by` (n) extended to the time `end`, as of `extend_ends`, with steps of at
  !! most `h` and the `breaks`.
  subroutine extend_mesh(task)
    type(task_type), intent(inout) :: task
    real(wp), allocatable :: ends(:)
    integer(i8), allocatable :: made_by(:)
    real(wp), pointer, contiguous :: breaks(:)
    real(wp) :: h, end
    allocate (ends, source=task%get_reals('ends'))
    allocate (made_by, source=task%get_longs('made_by'))
    breaks => task%get_reals('breaks')
    h = task%get_real('h')
    end = task%get_real('end')
    call task%check_extents('made_by', shape(made_by), shape(ends))
    if (task%failed()) return
    call extend_ends(ends, made_by, h, breaks, end)
    call task%found%put_reals('ends', ends, shape(ends))
    call task%found%put_reals('made_by', real(made_by, wp), shape(made_by))
  end subroutine extend_mesh

  !> The kind of `equations` of a motion, as of `choose_equations`, or the reason why its steps do
  !! not end at switches, `lack`. Input: `method`, `memory` and `t_end`; `is_held` if a displacement
  !! before the start is given; `may_have_modes`; loads, start and past as of a run. With equations
  !! of coordinates also the `method` by its index, 0: is not one of them; the coordinates that
  !! `moves` (n); `first`: first number of steps of a search; `reach`: the latest time of
  !! any run that continues; `fitted`: whether kernels are fitted; `n_phases`: number of sinusoids.
  subroutine find_equations(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    type(load_type) :: load
    type(motion_wish) :: wish
    type(oscillator_equations) :: equations
    character(len=:), allocatable :: lack
    logical, allocatable :: moves(:)
    real(wp) :: fastest, first, reach
    integer :: kind, method, n
    logical :: all_move, fitted

    system => task%system(with_shaft=.true.)
    if (task%failed()) return
    n = system%n_dof()
    call load_of(task, n, load)
    call task%take_text('method', wish%method)
    call task%take_text('memory', wish%memory)
    wish%t_end = task%get_real('t_end')
    wish%is_held = task%get_flag('is_held')
    wish%may_have_modes = task%get_flag('may_have_modes')
    call read_past(task, n, equations)
    call read_tables(task, n, equations)
    associate (initial => task%get_reals('initial'), given => equations)
      call task%check_extents('initial', shape(initial), [2*n])
      call task%check_extents('moved', shape(given%moved), [n, size(given%before)])
      if (task%failed()) return
      wish%moves_base = load%moves_base() .or. size(given%base_breaks) > 1
      wish%initial = initial
      wish%pushes = maxval(abs(given%pieces(:, 1, :)), 2)
      call wish%take_load(load)
      call choose_equations(system, wish, kind, lack)
      kind = task%get_integer('equations', kind)
      call task%found%put_integer('equations', int(kind, i8))
      if (lack /= '') call task%found%put_text('lack', lack)
      if (kind == by_modes) return
      all_move = system%moving
      if (kind == without_memory) all_move = switches_in_time(system) .or. wish%moves_base &
                                             .or. wish%is_held .or. is_on_shaft(system)
      moves = driven_coordinates(system, load, initial, maxval(abs(given%moved), 2), all_move) &
              .or. any(any(abs(given%pieces) > 0.0_wp, 3), 2)
      if (any(abs(given%base_pieces) > 0.0_wp)) then
        if (size(given%base_pieces, 2) > 1) then
          moves = moves .or. any(any(abs(given%base_pieces) > 0.0_wp, 3), 1)
        else
          moves = moves .or. abs(system%base_direction) > 0.0_wp
        end if
      end if
      moves = moved_coordinates(system, moves)
      fitted = needs_fit(system)
      reach = furthest*wish%t_end
      fastest = 0.0_wp
      if (size(load%orders) > 0) fastest = task%get_real('nu')*maxval(load%orders)
      if (kind == without_memory) then
        reach = ever
        if (fitted) reach = min(furthest*wish%t_end, ever) - given%before(1)
        method = findloc(transient_methods == wish%method, .true., 1)
        fastest = max(fastest, rate_of_motion(task, load))
        first = max(1.0_wp, wish%t_end*fastest/(0.5_wp*pi))
      else
        method = findloc(hereditary_methods == wish%method, .true., 1)
        fastest = max(fastest, fastest_rate(system))
        first = max(4.0_wp, wish%t_end*fastest*per_period(max(method, 1))/(2.0_wp*pi))
      end if
      if (wish%method == 'auto') method = 1
    end associate
    call task%found%put_integer('first', ceiling(min(first, 2.0_wp*max_steps), i8))
    call task%found%put_integer('method', int(method, i8))
    call task%found%put_integers('moves', merge(1, 0, moves), shape(moves))
    call task%found%put_real('reach', reach)
    call task%found%put_integer('fitted', merge(1_i8, 0_i8, fitted))
    call task%found%put_integer('n_phases', size(load%orders, kind=i8))
  end subroutine find_equations

  !> The `first` number of steps of a search for a structure, as of 'motion of structure', with
  !! `nodes` per step to the time `end`.
  subroutine find_first_steps(task)
    type(task_type), intent(inout) :: task
    type(structure_equations) :: equations
    real(wp) :: first
    call read_sections(task, equations)
    if (task%failed()) return
    first = task%get_real('end')*rate_seen(equations)/(2.0_wp*pi) &
            *per_period(findloc(nodes, task%get_integer('nodes'), 1))
    call task%found%put_integer('first', ceiling(min(max(4.0_wp, first), 2.0_wp*max_steps), i8))
  end subroutine find_first_steps

  !> Upper bound of the rates of a system without memory (rad/s).
  real(wp) function rate_of_motion(task, load) result(fastest)
    type(task_type), intent(inout) :: task
    type(load_type), intent(in) :: load
    class(oscillator_type), pointer :: system
    type(polynomial_motion_type) :: motion
    system => task%system(with_shaft=.true.)
    if (system%n_dof() <= max_dof) then
      fastest = fastest_rate(system)
      return
    end if
    ! Step size and times do not affect the rates of coordinates.
    call new_fitted_motion(motion, polynomial_of(task), load, 0.0_wp, 1.0_wp, 1.0_wp, task%status)
    if (.not. task%failed()) fastest = motion%fastest()
  end function rate_of_motion

  !> The sinusoids of loads on an oscillator: their `frequencies` (k), `amplitudes` (n, k) with the
  !! inertia of what is relative to the base, and displacements of the base, `waves` (n, k).
  subroutine find_loads(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    type(load_type) :: load
    type(oscillator_equations) :: equations
    system => task%system(with_shaft=.true.)
    if (task%failed()) return
    call load_of(task, system%n_dof(), load)
    if (task%failed()) return
    call equations%set_load(system, load, task%get_real('nu'))
    call task%found%put_reals('frequencies', equations%frequencies, shape(equations%frequencies))
    call task%found%put_complexes('amplitudes', equations%amplitudes, shape(equations%amplitudes))
    call task%found%put_complexes('waves', equations%waves, shape(equations%waves))
  end subroutine find_loads

  !> Loads as of `read_known_load` at `times` (m): the `load` on coordinates relative to the base,
  !! and `place`, `speed` and `push` by the base, each (m, n).
  subroutine find_loads_at(task)
    type(task_type), intent(inout) :: task
    type(time_load_type) :: loads
    type(base_motion_type) :: base
    real(wp), pointer, contiguous :: times(:)
    real(wp), allocatable :: load(:, :), moved(:, :, :)
    times => task%get_reals('times')
    call read_known_load(task, loads, base)
    if (task%failed()) return
    load = loads%at_times(times)
    moved = base%at_times(size(load, 2), times)
    call task%found%put_reals('load', load, shape(load))
    call task%found%put_reals('place', moved(:, :, 1), shape(load))
    call task%found%put_reals('speed', moved(:, :, 2), shape(load))
    call task%found%put_reals('push', moved(:, :, 3), shape(load))
  end subroutine find_loads_at

  !> Number of memory coordinates `n_hidden` of a system for steps `h` up to the time `reach`;
  !! h = 0: upper bound; -1: a kernel is not, and cannot be fitted by, a sum of exponentials.
  !! `fitted`: whether a kernel is fitted.
  subroutine count_hidden_coordinates(task)
    type(task_type), intent(inout) :: task
    type(polynomial_type), pointer :: system
    type(polynomial_type) :: whole
    real(wp) :: h
    integer :: n_hidden
    system => polynomial_of(task)
    h = task%get_real('h')
    if (task%failed()) return
    if (h > 0.0_wp) then
      call fit_memory(system, h, task%get_real('reach'), whole)
      n_hidden = count_hidden(whole)
    else
      n_hidden = bound_hidden(system)
    end if
    call task%found%put_integer('n_hidden', int(n_hidden, i8))
    call task%found%put_integer('fitted', merge(1_i8, 0_i8, needs_fit(system)))
  end subroutine count_hidden_coordinates

  !> Plan of a motion, a `text`. Input: `initial`, `t_end`, `dt` (0: found by `tolerance` and
  !! `relative`, both 0: by the size of the motion), `method`, `save_every`, `last_only`, `tail`,
  !! `times`; of an oscillator `equations`; without memory `reach`; with memory `held` and `past`,
  !! the index in `past_names`.
  subroutine plan_motion(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    class(oscillator_type), pointer :: system
    type(pendulum_type), pointer :: pendulum
    type(load_type) :: load
    type(hereditary_job) :: job
    character(len=:), allocatable :: text

    allocate (job%initial, source=task%get_reals('initial'))
    job%t_end = task%get_real('t_end')
    job%dt = task%get_real('dt')
    job%tolerance = task%get_real('tolerance')
    job%relative = task%get_real('relative', 0.0_wp)
    job%method = task%get_integer('method')
    job%save_every = task%get_integer('save_every')
    job%last_only = task%get_flag('last_only')
    job%tail = task%get_real('tail', 0.0_wp)
    if (task%has('times')) allocate (job%times, source=task%get_reals('times'))
    if (name == 'plan of pendulum') then
      pendulum => task%pendulum()
      if (task%failed()) return
      text = plan_pendulum(job%transient_job, pendulum)
    else
      system => task%system(with_shaft=.true.)
      if (task%failed()) return
      call load_of(task, system%n_dof(), load)
      if (task%get_integer('equations') /= without_memory) then
        allocate (job%held, source=task%get_reals('held'))
        job%past = task%get_integer('past')
        call task%check_extents('held', shape(job%held), [system%n_dof()])
        if (task%failed()) return
        text = plan_hereditary(job, system, load)
      else
        text = plan_polynomial(job%transient_job, polynomial_of(task), load, &
                               task%get_real('reach'))
      end if
    end if
    if (.not. task%failed()) call task%found%put_text('text', text)
  end subroutine plan_motion

end module viscovib_motion_tasks
