! Optimize: -O1
!> Tasks about periodic solutions of oscillators. The load is a Fourier series: `orders` (m) and
!! `series` (n_dof + 1, m), forces on the coordinates followed by the base motion, as for
!! `make_load`.
module viscovib_response_tasks
  use viscovib_binding_tools, only: make_load
  use viscovib_curve, only: curve_type
  use viscovib_curve_peak, only: climb, growth_along, harmonic_measure
  use viscovib_family_curve, only: new_family_curve, new_plain_curve, system_builder
  use viscovib_forced_response, only: forced_response
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: i8, wp
  use viscovib_load, only: load_type
  use viscovib_modal_motion, only: modal_finder
  use viscovib_motion_checks, only: errors_of, losses_of, sampling_of
  use viscovib_motion_stability, only: stability_type
  use viscovib_order_rules, only: most_along
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: oscillator_curve_type, vary_frequency, vary_load
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: moved_coordinates, reduce
  use viscovib_response, only: response_options, response_type
  use viscovib_response_plan, only: method_auto, method_names, new_response_plan, &
    response_plan_type
  use viscovib_status, only: fail, status_input_error
  use viscovib_stopping, only: is_set
  use viscovib_structure, only: structure_type
  use viscovib_task, only: task_type
  use viscovib_vector_builder, only: vector_builder
  implicit none
  private

  public :: response_task
  public :: given_builder, given_load, given_options, given_variation, planned_orders, put_stability

  !> Third kind of parameter, after frequency and load factor: system parameters.
  integer, parameter, public :: vary_system = vary_load + 1

contains

  subroutine response_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('plan')
      call plan_response(task)
    case ('solve')
      call solve_response(task)
    case ('peak')
      call find_peak(task)
    case ('sampling_errors')
      call find_sampling_errors(task)
    case ('rounding_errors')
      call find_rounding_errors(task)
    case ('losses')
      call find_losses(task)
    case ('modes')
      call find_modal_motions(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine response_task

  subroutine given_load(task, load)
    type(task_type), intent(inout) :: task
    type(load_type), intent(out) :: load
    integer, allocatable :: orders(:)
    character(len=:), allocatable :: formulas
    complex(wp), pointer, contiguous :: series(:, :)

    allocate (orders, source=task%get_integers('orders'))
    series => task%get_complex_matrix('series')
    call task%check_extents('series', shape(series), [size(series, 1), size(orders)])
    if (size(series, 1) < 2 .and. .not. task%failed()) then
      call fail(task%status, status_input_error, 'series', 'series: must have a row for each ' &
                //'coordinate and one for the base')
    end if
    call task%take_text('formulas', formulas, '')
    if (.not. task%failed()) call make_load(load, orders, series, formulas, task%status)
  end subroutine given_load

  !> System and load of a task, with matching sizes.
  subroutine given_system(task, system, load)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer, intent(out) :: system
    type(load_type), intent(out) :: load

    system => task%system(with_speed=.true.)
    if (.not. task%failed()) call given_load(task, load)
    if (.not. task%failed()) call task%check_extents('series', [size(load%force, 1)], &
                                                     [system%n_dof()])
  end subroutine given_system

  !> Kind of the parameter `varies`: "nu", "load_factor", or system parameters (any other name).
  integer function given_variation(task) result(parameter)
    type(task_type), intent(inout) :: task
    character(len=:), allocatable :: varies
    call task%take_text('varies', varies, 'nu')
    select case (varies)
    case ('nu')
      parameter = vary_frequency
    case ('load_factor')
      parameter = vary_load
    case default
      parameter = vary_system
    end select
  end function given_variation

  !> Systems with the vector `flat` (n) + p `direction` (:n) + p^2 `direction` (n + 1:) + ... and
  !! the kernels of the object.
  function given_builder(task) result(builder)
    type(task_type), intent(inout) :: task
    type(vector_builder) :: builder
    real(wp), pointer, contiguous :: flat(:), direction(:), data_x(:), data_phi(:)

    flat => task%get_reals('flat')
    direction => task%get_reals('direction')
    data_x => task%get_reals('data_x')
    data_phi => task%get_reals('data_phi')
    builder = vector_builder(flat, direction, data_x, data_phi, task%get_integer('kind_x'), &
                             task%get_integer('kind_phi'))
    if (size(builder%flat) == 0 .and. .not. task%failed()) then
      call fail(task%status, status_input_error, 'flat', 'flat: must not be empty')
    end if
  end function given_builder

  !> `harmonics` = 0: chosen automatically; `relaxation` = 0: halved if needed.
  function given_options(task) result(options)
    type(task_type), intent(inout) :: task
    type(response_options) :: options
    options%harmonics = task%get_integer('harmonics', 0)
    options%choose_harmonics = options%harmonics == 0
    options%tolerance = task%get_real('tolerance', options%tolerance)
    options%absolute = task%get_real('atol', options%absolute)
    options%max_iterations = task%get_integer('max_iterations', options%max_iterations)
    options%relaxation = task%get_real('relaxation', options%relaxation)
    options%keep_history = task%get_flag('history', .false.)
    options%keep_iterates = task%get_flag('iterates', .false.)
    options%stability = task%get_flag('stability', .false.)
    options%keep_idle = task%get_flag('keep_idle', .false.)
    options%on_branch = task%get_flag('on_branch', .false.)
    options%symmetric = task%get_flag('symmetric', .true.)
  end function given_options

  subroutine new_plan(task, system, load, nu, plan)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer, intent(out) :: system
    type(load_type), intent(out) :: load
    real(wp), pointer, contiguous, intent(out) :: nu(:)
    type(response_plan_type), intent(out) :: plan
    type(response_options) :: options
    character(len=:), allocatable :: method

    call given_system(task, system, load)
    nu => task%get_reals('nu')
    call task%take_text('method', method)
    options = given_options(task)
    if (task%failed()) return
    call new_response_plan(plan, system, load, nu, findloc(method_names == method, .true., 1), &
                           options, task%status)
  end subroutine new_plan

  !> What `solve` would do: the orders kept, or that may be kept, the method, and the plan as text;
  !! `rest`: the lines that are also valid for a branch.
  subroutine plan_response(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    real(wp), pointer, contiguous :: nu(:)
    type(load_type) :: load
    type(response_plan_type) :: plan
    integer, allocatable :: orders(:)

    call new_plan(task, system, load, nu, plan)
    if (task%failed()) return
    allocate (orders, source=planned_orders(plan, system, load))
    call plan%describe(system, load, size(nu))
    call task%found%put_integers('kept', orders, shape(orders))
    call task%found%put_text('method', trim(method_names(plan%method)))
    call task%found%put_text('text', plan%text)
    call task%found%put_text('rest', plan%rest)
  end subroutine plan_response

  !> All orders that a response, or a branch, may keep.
  pure function planned_orders(plan, system, load) result(orders)
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, allocatable :: orders(:)
    integer :: k, most

    orders = plan%set%orders
    if (.not. plan%chosen) return
    most = plan%most
    ! Along a branch fewer orders may be chosen.
    if (plan%options%keep_idle) most = min(most, most_along(system, load))
    orders = [(k, k=merge(1, 0, plan%set%half_wave), most, merge(2, 1, plan%set%half_wave))]
  end function planned_orders

  !> Response at each `nu` (n). `start`: initial value for Newton's method, with unknowns relative
  !! to the base for all orders that the plan allows.
  subroutine solve_response(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    real(wp), pointer, contiguous :: nu(:), start(:)
    type(load_type) :: load
    type(response_plan_type) :: plan
    type(response_type) :: response
    integer :: method

    call new_plan(task, system, load, nu, plan)
    if (task%failed()) return
    if (task%has('start')) then
      start => task%get_reals('start')
      call forced_response(plan, system, load, nu, response, task%cancel, &
                           reshape(start, [size(start)/system%n_dof(), system%n_dof()]))
    else
      call forced_response(plan, system, load, nu, response, task%cancel)
    end if
    ! A cancelled task needs no results.
    if (is_set(task%cancel)) return
    associate (found => task%found)
      call found%put_integers('kept', response%orders, shape(response%orders))
      ! One number per frequency if the methods differ.
      method = plan%method
      if (method == method_auto) then
        if (all(response%method == response%method(1))) then
          method = response%method(1)
        else
          call found%put_integers('methods', response%method - 1, shape(nu))
        end if
      end if
      call found%put_text('method', trim(method_names(method)))
      if (plan%lacks_forces) call found%put_integer('lacks_forces', 1_i8)
      call found%put_complexes('coefficients', response%coefficients, shape(response%coefficients))
      call found%put_integers('outcomes', response%outcome, shape(nu))
      call found%put_integers('iterations', response%iterations, shape(nu))
      call found%put_integers('highest', response%highest, shape(nu))
      call found%put_reals('rate', response%rate, shape(nu))
      call found%put_reals('truncation', response%truncation, shape(nu))
      call found%put_reals('allowed', response%allowed, shape(nu))
      if (allocated(response%iterates)) then
        call found%put_complexes('iterates', response%iterates, shape(response%iterates))
      end if
      if (plan%options%keep_history) then
        call found%put_reals('corrections', response%corrections, shape(response%corrections))
      end if
    end associate
    if (plan%options%stability) call put_stability(task, response%stability, system%n_dof())
  end subroutine solve_response

  !> `stable` is 2 if exponents that decay more slowly may be missing; `multipliers` and `exponents`
  !! are those with the largest growth, NaN if there are none.
  subroutine put_stability(task, stability, n_dof)
    type(task_type), intent(inout) :: task
    type(stability_type), intent(in) :: stability
    integer, intent(in) :: n_dof
    integer :: m

    m = min(size(stability%multipliers, 1), 2*n_dof + 4)
    associate (found => task%found, n => size(stability%stable))
      call found%put_integers('stable', merge(2, stability%stable, stability%stable == 1 &
                                              .and. .not. stability%slowest), [n])
      call found%put_integers('growing', stability%n_growing, [n])
      call found%put_complexes('multipliers', stability%multipliers(:m, :), [m, n])
      call found%put_complexes('exponents', stability%exponents(:m, :), [m, n])
    end associate
  end subroutine put_stability

  !> Largest amplitude of harmonic `place` (in `kept`) of coordinate `dof`, both from 1: at a
  !! solution at `p` (ascending), or at a peak between two (`enclosed` = 1); for a single solution,
  !! the next peak on the branch, between `low` and `high`. With `wide` = 0, only near the largest
  !! solution. `samples`: absolute harmonics (m, n_dof, n).
  subroutine find_peak(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    class(oscillator_type), allocatable, target :: own
    type(load_type), target :: load, part
    type(polynomial_type), target :: reduced
    class(oscillator_curve_type), allocatable :: curve
    class(system_builder), allocatable :: builder
    type(harmonic_set_type) :: set
    type(harmonic_measure) :: measure
    real(wp), pointer, contiguous :: p(:)
    complex(wp), pointer, contiguous :: samples(:, :, :)
    integer, allocatable :: kept(:)
    logical, allocatable :: moved(:)
    real(wp), allocatable :: x(:, :)
    real(wp) :: nu, tolerance, low, high, peak_p, peak_size
    integer :: dof, n, parameter, place
    logical :: summit, wide, keep_idle

    parameter = given_variation(task)
    call given_load(task, load)
    nu = task%get_real('at_nu')
    allocate (kept, source=task%get_integers('kept'))
    keep_idle = task%get_flag('keep_idle')
    tolerance = task%get_real('tolerance')
    p => task%get_reals('p')
    samples => task%get_complex_cube('samples')
    dof = task%get_integer('dof')
    place = task%get_integer('place')
    low = task%get_real('low', 0.0_wp)
    high = task%get_real('high', 0.0_wp)
    wide = task%get_flag('wide', .true.)
    n = size(p)
    if (parameter > vary_load) then
      allocate (builder, source=given_builder(task))
      if (.not. task%failed()) call builder%build(p(1), own, task%status)
      system => own
    else
      system => task%system(with_speed=.true.)
    end if
    if (task%failed()) return
    call task%check_extents('samples', shape(samples), [size(kept), system%n_dof(), n])
    if (task%failed()) return
    call new_harmonic_set(set, kept(size(kept)), kept(1) > 0, system%degree)
    moved = moved_coordinates(system, load%drives(system) .or. keep_idle)
    if (parameter > vary_load) then
      moved = .true.
      call new_family_curve(curve, builder, p(1), max(abs(low), abs(high)), load, set, nu, &
                            task%status)
    else if (all(moved)) then
      call new_plain_curve(curve, system, load, set, parameter, nu)
    else
      call reduce(system, moved, reduced)
      call load%take_part(moved, part)
      call new_plain_curve(curve, reduced, part, set, parameter, nu)
    end if
    if (task%failed()) return
    peak_p = 0.0_wp
    peak_size = -1.0_wp
    summit = .false.
    if (moved(dof)) then
      x = peak_unknowns(system, load, moved, kept, samples, p, parameter, dof, place, measure)
      if (n == 1) then
        peak_p = p(1)
        call climb(curve, measure, tolerance, low, high, x(:, 1), peak_p, summit, task%cancel)
        peak_size = measure%size_at(x(:, 1), peak_p)
      else
        call peak_of_samples(curve, measure, tolerance, p, x, wide, peak_p, peak_size, summit, &
                             task%cancel)
      end if
    end if
    call task%found%put_real('at', peak_p)
    call task%found%put_real('size', peak_size)
    call task%found%put_integer('enclosed', merge(1_i8, 0_i8, summit))
  end subroutine find_peak

  !> Unknowns (relative to the base) of absolute solutions, and the location and offset of the
  !! measured harmonic.
  function peak_unknowns(system, load, moved, kept, samples, p, parameter, dof, place, measure) &
    result(x)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Shapes (n_dof), (m), (m, n_dof, n) and (n).
    logical, intent(in) :: moved(:)
    integer, intent(in) :: kept(:)
    complex(wp), intent(in) :: samples(:, :, :)
    real(wp), intent(in) :: p(:)
    integer, intent(in) :: parameter, dof, place
    type(harmonic_measure), intent(inout) :: measure
    real(wp), allocatable :: x(:, :)
    complex(wp) :: shift(system%n_dof()), base
    real(wp) :: factor(size(p))
    integer :: d, j, k, m, row

    m = 2*size(kept)
    allocate (x(m*count(moved), size(p)))
    factor = 1.0_wp
    if (parameter == vary_load) factor = p
    row = 0
    do d = 1, size(moved)
      if (.not. moved(d)) cycle
      x(row + 1:row + m:2, :) = real(samples(:, d, :))
      x(row + 2:row + m:2, :) = aimag(samples(:, d, :))
      if (d == dof) measure%place = row + 2*place - [1, 0]
      do j = 1, size(load%orders)
        k = findloc(kept, load%orders(j), 1)
        if (k == 0) cycle
        shift = load%shift(system, j)
        base = shift(d)
        x(row + 2*k - 1, :) = x(row + 2*k - 1, :) - factor*real(base)
        x(row + 2*k, :) = x(row + 2*k, :) - factor*aimag(base)
        if (d /= dof .or. k /= place) cycle
        if (parameter == vary_load) then
          measure%offset_by_p = [real(base), aimag(base)]
        else
          measure%offset = [real(base), aimag(base)]
        end if
      end do
      row = row + m
    end do
  end function peak_unknowns

  !> Relative `errors` of solutions due to sampling of their forces, at `p` (n); NaN if unknown.
  subroutine find_sampling_errors(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    class(oscillator_type), allocatable :: own
    type(load_type) :: load
    type(vector_builder) :: builder
    real(wp), pointer, contiguous :: p(:)
    complex(wp), pointer, contiguous :: motions(:, :, :)
    integer, allocatable :: kept(:), highest(:)
    real(wp), allocatable :: errors(:), nu(:), factor(:)
    integer :: i, parameter

    parameter = given_variation(task)
    call given_load(task, load)
    p => task%get_reals('p')
    nu = spread(task%get_real('at_nu'), 1, size(p))
    factor = spread(1.0_wp, 1, size(p))
    if (parameter == vary_frequency) nu = p
    if (parameter == vary_load) factor = p
    call given_motions(task, size(p), kept, highest, motions)
    if (parameter > vary_load) then
      builder = given_builder(task)
    else
      system => task%system(with_speed=.true.)
    end if
    if (task%failed()) return
    allocate (errors(size(p)))
    if (parameter <= vary_load) then
      call sampling_of(system, load, kept, nu, factor, highest, motions, errors, task%cancel)
    else
      do i = 1, size(p)
        call builder%build(p(i), own, task%status)
        if (task%failed()) return
        call sampling_of(own, load, kept, nu(i:i), factor(i:i), highest(i:i), motions(:, :, i:i), &
                         errors(i:i), task%cancel)
      end do
    end if
    call task%found%put_reals('errors', errors, shape(errors))
  end subroutine find_sampling_errors

  !> `motions` (m, n_dof, n) with harmonics `kept` (m), relative to the base, and the `highest`
  !! harmonic of each (n).
  subroutine given_motions(task, n, kept, highest, motions)
    type(task_type), intent(inout) :: task
    integer, intent(in) :: n
    integer, allocatable, intent(out) :: kept(:), highest(:)
    complex(wp), pointer, contiguous, intent(out) :: motions(:, :, :)
    allocate (kept, source=task%get_integers('kept'))
    allocate (highest, source=task%get_integers('highest'))
    motions => task%get_complex_cube('motions')
    call task%check_extents('highest', shape(highest), [n])
    call task%check_extents('motions', shape(motions), [size(kept), size(motions, 2), n])
  end subroutine given_motions

  !> Relative `errors` of solutions at `nu` (n) due to rounding errors in their equations, or in the
  !! linearized equations (`linear`); NaN if unknown.
  subroutine find_rounding_errors(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    type(load_type) :: load
    real(wp), pointer, contiguous :: nu(:)
    complex(wp), pointer, contiguous :: motions(:, :, :)
    integer, allocatable :: kept(:), highest(:)
    real(wp), allocatable :: errors(:)
    logical :: linear

    call given_system(task, system, load)
    nu => task%get_reals('nu')
    call given_motions(task, size(nu), kept, highest, motions)
    linear = task%get_flag('linear')
    if (task%failed()) return
    allocate (errors(size(nu)))
    call errors_of(system, load, kept, nu, highest, linear, motions, errors, task%cancel)
    call task%found%put_reals('errors', errors, shape(errors))
  end subroutine find_rounding_errors

  !> Amplitudes of the `modes` (n_modes, m, n) and `poles` (n_poles, m, n) of a structure, and
  !! `forces` of its elements on the linear subsystem (n_dof, m, n), for solutions `motions` (m,
  !! n_dof, n), relative to the base, with the harmonics `kept` (m) at frequencies `nu` (n) and load
  !! factors `factor` (n); `linear`: solutions of the linearized equations.
  subroutine find_modal_motions(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    type(modal_finder) :: finder
    real(wp), pointer, contiguous :: nu(:), factor(:)
    complex(wp), pointer, contiguous :: motions(:, :, :)
    complex(wp), allocatable :: modes(:, :, :), poles(:, :, :), forces(:, :, :)
    integer, allocatable :: kept(:)
    integer :: i

    system => task%system(with_speed=.true.)
    nu => task%get_reals('nu')
    factor => task%get_reals('factor')
    allocate (kept, source=task%get_integers('kept'))
    motions => task%get_complex_cube('motions')
    finder%linear = task%get_flag('linear')
    call task%check_extents('factor', shape(factor), shape(nu))
    if (task%failed()) return
    call task%check_extents('motions', shape(motions), [size(kept), system%n_dof(), size(nu)])
    if (task%failed()) return
    select type (system)
    class is (structure_type)
      allocate (modes(system%rest%n_modes, size(kept), size(nu)), &
                poles(size(system%rest%poles), size(kept), size(nu)), &
                forces(system%n_dof(), size(kept), size(nu)))
      do i = 1, size(nu)
        if (is_set(task%cancel)) return
        call finder%find(system, nu(i), factor(i), kept, motions(:, :, i), modes(:, :, i), &
                         poles(:, :, i), forces(:, :, i))
      end do
      call task%found%put_complexes('modes', modes, shape(modes))
      call task%found%put_complexes('poles', poles, shape(poles))
      call task%found%put_complexes('forces', forces, shape(forces))
    class default
      call task%refuse_kind()
    end select
  end subroutine find_modal_motions

  !> Energy `lost` per period (J) by solutions at frequencies `nu` (n) and load factors `factor`
  !! (n); NaN if unknown.
  subroutine find_losses(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    type(load_type) :: load
    real(wp), pointer, contiguous :: nu(:), factor(:)
    complex(wp), pointer, contiguous :: motions(:, :, :)
    integer, allocatable :: kept(:), highest(:)
    real(wp), allocatable :: lost(:)
    logical :: linear

    call given_system(task, system, load)
    nu => task%get_reals('nu')
    factor => task%get_reals('factor')
    call given_motions(task, size(nu), kept, highest, motions)
    linear = task%get_flag('linear')
    call task%check_extents('factor', shape(factor), shape(nu))
    if (task%failed()) return
    allocate (lost(size(nu)))
    call losses_of(system, load, kept, nu, factor, highest, linear, motions, lost)
    call task%found%put_reals('lost', lost, shape(lost))
  end subroutine find_losses

  ! The largest amplitude of a harmonic between sampled motions, which may lie on several branches
  ! and far apart.
  !
  ! A resonance between two samples shows in their slopes: the amplitude grows from the left one, or
  ! towards the right one, more than the other sample shows. From there the search climbs along the
  ! branch of the sample, over all maxima up to the adjacent sample; beyond it lies a different
  ! branch. If the slopes do not lead from one sample to the next, the branch is followed too.

  !> The largest amplitude of the samples and of the maxima between them.
  subroutine peak_of_samples(curve, measure, tolerance, p, x, wide, best_p, best, found, cancel)
    class(curve_type), intent(inout) :: curve
    type(harmonic_measure), intent(in) :: measure
    real(wp), intent(in) :: tolerance
    !> Parameters, ascending, shape (n), and the motions there, shape (curve%n, n).
    real(wp), intent(in) :: p(:), x(:, :)
    !> True: search between all samples, not only near the largest one.
    logical, intent(in) :: wide
    real(wp), intent(out) :: best_p, best
    !> True if the best point is a maximum between samples.
    logical, intent(out) :: found
    !> May be set by another thread to cancel the search.
    integer, intent(inout), optional :: cancel
    real(wp) :: sizes(size(p)), slopes(size(x, 1), size(p))
    integer :: trend(size(p)), i, largest
    logical :: there

    sizes = [(measure%size_at(x(:, i), p(i)), i=1, size(p))]
    largest = maxloc(sizes, 1)
    best_p = p(largest)
    best = sizes(largest)
    found = .false.
    trend = 0
    do i = 1, size(p)
      if (.not. wide .and. abs(i - largest) > 1) cycle
      if (is_set(cancel)) return
      call growth_along(curve, measure, tolerance, x(:, i), p(i), trend(i), slopes(:, i))
    end do
    do i = 1, size(p) - 1
      if (.not. wide .and. abs(2*(i - largest) + 1) > 1) cycle
      if (is_set(cancel)) return
      there = .false.
      ! If both slopes agree upwards there is no maximum between the samples.
      if (trend(i) > 0 .and. .not. (trend(i + 1) > 0 .and. sizes(i + 1) >= sizes(i))) then
        call from_sample(i, .false.)
      end if
      if (there) cycle
      if (trend(i + 1) < 0 .and. .not. (trend(i) < 0 .and. sizes(i) >= sizes(i + 1))) then
        call from_sample(i + 1, .false.)
      end if
      if (there) cycle
      if (hides(i)) call from_sample(i, .true.)
    end do

  contains

    !> True if the secant between two samples differs from the mean of their slopes, for all
    !! unknowns or for the harmonic alone, which may be smaller than other coordinates.
    pure logical function hides(at)
      integer, intent(in) :: at
      real(wp) :: secant(size(x, 1)), off(size(x, 1))
      secant = x(:, at + 1) - x(:, at)
      off = secant - 0.5_wp*(p(at + 1) - p(at))*(slopes(:, at) + slopes(:, at + 1))
      hides = norm2(off) > 0.3_wp*norm2(secant) &
              .or. norm2(off(measure%place)) > 0.3_wp*norm2(secant(measure%place))
    end function hides

    subroutine from_sample(from, upwards)
      integer, intent(in) :: from
      logical, intent(in) :: upwards
      real(wp) :: at(size(x, 1)), at_p, top
      logical :: summit
      at = x(:, from)
      at_p = p(from)
      ! Close modes may have several maxima between two samples.
      there = .true.
      call climb(curve, measure, tolerance, p(i), p(i + 1), at, at_p, summit, cancel, there, &
                 upwards)
      if (.not. summit) return
      top = measure%size_at(at, at_p)
      if (top < best) return
      best = top
      best_p = at_p
      found = .true.
    end subroutine from_sample

  end subroutine peak_of_samples

end module viscovib_response_tasks
