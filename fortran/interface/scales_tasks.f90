!> Tasks of the method of multiple scales.
module viscovib_scales_tasks
  use viscovib_full_oscillator, only: put_behind
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: i8, wp
  use viscovib_modulation, only: modulate
  use viscovib_multiple_scales, only: multiple_scales_type, new_multiple_scales
  use viscovib_oscillator, only: oscillator_type
  use viscovib_packed_form, only: pack_form, unpack_form
  use viscovib_pendulum, only: pendulum_type
  use viscovib_pendulum_form, only: new_pendulum_form, put_pendulum_behind
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_resonant_terms, only: list_resonances, wants_more
  use viscovib_scales_error, only: motion_errors
  use viscovib_scales_motion, only: amplitudes_of_state, motion_at
  use viscovib_scales_response, only: response_along, steady_points_type
  use viscovib_system_form, only: new_oscillator_form
  use viscovib_task, only: task_type
  implicit none
  private

  public :: scales_task

  !> A system to third order, and its vector as in `viscovib_packed_form`.
  type :: built_form
    type(polynomial_form_type) :: it
    real(wp), allocatable :: packed(:)
  end type built_form

contains

  subroutine scales_task(task, name)
    type(task_type), intent(inout), target :: task
    character(len=*), intent(in) :: name
    type(built_form), pointer :: form

    nullify (form)
    if (allocated(task%parents)) then
      select type (own => task%parents(1)%to%built)
      type is (built_form)
        form => own
      end select
    end if
    if (name == 'form') then
      call build_form(task)
    else if (name == 'resonances') then
      call find_resonances(task)
    else if (associated(form)) then
      call use_form(task, name, form)
    else
      call task%refuse_kind()
    end if
  end subroutine scales_task

  subroutine use_form(task, name, form)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    type(built_form), intent(in) :: form
    select case (name)
    case ('numbers')
      call task%found%put_reals('numbers', form%packed, shape(form%packed))
    case ('equations')
      call find_equations(task, form%it)
    case ('motion')
      call find_motion(task, form%it)
    case ('errors')
      call find_errors(task, form%it)
    case ('response')
      call find_response(task, form%it)
    case default
      call task%refuse_kind()
    end select
  end subroutine use_form

  !> Create an object: a pendulum to third order with an `ordering`; an oscillator with a `load`
  !! (n_dof) times cos(nu t), `nu`; or a system from its vector alone, `packed` (n).
  subroutine build_form(task)
    type(task_type), intent(inout) :: task
    type(built_form), allocatable :: own
    type(polynomial_form_type) :: form
    type(pendulum_type), pointer :: pendulum
    class(oscillator_type), pointer :: oscillator
    type(kernel_holder) :: none(0)
    real(wp), pointer, contiguous :: load(:)
    real(wp) :: nu
    integer :: ordering

    allocate (own)
    if (task%has('packed')) then
      allocate (own%packed, source=task%get_reals('packed'))
      if (task%failed()) return
      call unpack_form(own%packed, none, own%it, task%status)
    else if (task%has('ordering')) then
      pendulum => task%pendulum()
      ordering = task%get_integer('ordering')
      if (task%failed()) return
      call new_pendulum_form(form, pendulum, ordering, task%status)
      if (task%failed()) return
      call pack_form(form, own%packed)
      call unpack_form(own%packed, none, own%it, task%status)
      if (.not. task%failed()) call put_pendulum_behind(own%it, pendulum)
    else
      oscillator => task%system()
      load => task%get_reals('load')
      nu = task%get_real('nu')
      if (task%failed()) return
      call task%check_extents('load', shape(load), [oscillator%n_dof()])
      if (task%failed()) return
      call new_oscillator_form(form, oscillator, load, nu, task%status)
      if (task%failed()) return
      call pack_form(form, own%packed)
      call unpack_form(own%packed, oscillator%kernels, own%it, task%status)
      if (.not. task%failed()) call put_behind(own%it, oscillator)
    end if
    if (.not. task%failed()) call move_alloc(own, task%built)
  end subroutine build_form

  !> Modes, interaction and modulation equations. `tolerance`: bandwidth of resonances. Output:
  !! `exponents` (n_modes), `shapes` (n_unknowns, n_modes), `interaction` (n_modes, n_modes),
  !! `frame` (n_modes), `units` (n_unknowns), `autonomous`, `terms` (7, n), `coefficients` (n).
  subroutine find_equations(task, form)
    type(task_type), intent(inout) :: task
    type(polynomial_form_type), intent(in) :: form
    type(multiple_scales_type) :: scales
    complex(wp), allocatable :: coefficients(:), interaction(:, :), shapes(:, :)
    integer, allocatable :: terms(:, :)
    real(wp) :: tolerance
    integer :: i, n

    tolerance = task%get_real('tolerance')
    if (.not. task%failed()) call new_multiple_scales(scales, form, tolerance, .false., task%status)
    if (task%failed()) return
    n = size(scales%flow%terms)
    allocate (terms(7, n), coefficients(n))
    do i = 1, n
      associate (t => scales%flow%terms(i))
        terms(:, i) = [t%row, t%at, t%loads]
        coefficients(i) = scales%coefficient(i)
      end associate
    end do
    shapes = scales%shapes()
    interaction = scales%interaction()
    call task%found%put_complexes('exponents', scales%flow%s, shape(scales%flow%s))
    call task%found%put_complexes('shapes', shapes, shape(shapes))
    call task%found%put_complexes('interaction', interaction, shape(interaction))
    call task%found%put_reals('frame', scales%flow%frame, shape(scales%flow%frame))
    call task%found%put_reals('units', scales%units, shape(scales%units))
    call task%found%put_integer('autonomous', merge(1_i8, 0_i8, scales%flow%autonomous))
    call task%found%put_integers('terms', terms, shape(terms))
    call task%found%put_complexes('coefficients', coefficients, shape(coefficients))
  end subroutine find_equations

  !> Amplitudes at `times` (n) and the corresponding solution, from amplitudes `start` (n_modes) or,
  !! if not given, from the `state` (n_modes, 2), q and v, at time 0. `tolerance` of resonances,
  !! `accuracy` of a step, `max_steps`. Output for the m times reached: `amplitudes` (n_modes, m),
  !! `motion` (n_modes, 2, m), `sizes` (4, m); amplitudes at time 0, `first` (n_modes); `frame`
  !! (n_modes); amplitudes for which resonances were chosen, `expected` (n_modes), in natural units;
  !! `n_steps`, `outcome`.
  subroutine find_motion(task, form)
    type(task_type), intent(inout) :: task
    type(polynomial_form_type), intent(in) :: form
    type(multiple_scales_type) :: scales
    complex(wp) :: a(form%n_modes()), first(form%n_modes())
    complex(wp), allocatable :: amplitudes(:, :)
    real(wp), pointer, contiguous :: times(:)
    real(wp), allocatable :: motion(:, :, :), sizes(:, :)
    real(wp) :: expected(form%n_modes()), accuracy
    integer :: i, n, n_reached, n_steps, outcome

    n = form%n_modes()
    times => task%get_reals('times')
    accuracy = task%get_real('accuracy')
    call choose_start(task, form, scales, a, expected)
    if (task%failed()) return
    first = a*scales%amplitude_units
    allocate (amplitudes(n, size(times)))
    call modulate(scales%flow, a, times, accuracy, task%get_integer('max_steps'), amplitudes, &
                  n_reached, n_steps, outcome, task%cancel)
    allocate (motion(n, 2, n_reached), sizes(4, n_reached))
    do i = 1, n_reached
      call motion_at(scales, times(i), amplitudes(:, i), motion(:, 1, i), motion(:, 2, i), &
                     sizes(:, i))
      amplitudes(:, i) = amplitudes(:, i)*scales%amplitude_units
    end do
    call task%found%put_complexes('amplitudes', amplitudes(:, :n_reached), [n, n_reached])
    call task%found%put_complexes('first', first, shape(first))
    call task%found%put_reals('motion', motion, shape(motion))
    call task%found%put_reals('sizes', sizes, shape(sizes))
    call task%found%put_reals('frame', scales%flow%frame, shape(scales%flow%frame))
    call task%found%put_reals('expected', expected, shape(expected))
    call task%found%put_integer('n_steps', int(n_steps, i8))
    call task%found%put_integer('outcome', int(outcome, i8))
  end subroutine find_motion

  !> Expansion whose resonances are chosen for the initial amplitudes of a solution, and these
  !! amplitudes in natural units.
  subroutine choose_start(task, form, scales, a, expected)
    type(task_type), intent(inout) :: task
    type(polynomial_form_type), intent(in) :: form
    type(multiple_scales_type), intent(out) :: scales
    complex(wp), intent(out) :: a(:)
    real(wp), intent(out) :: expected(:)
    integer, parameter :: max_rounds = 4
    complex(wp), pointer, contiguous :: start(:)
    real(wp), pointer, contiguous :: state(:, :)
    complex(wp) :: before(size(a))
    real(wp) :: tolerance
    logical :: given
    integer :: round

    given = task%has('start')
    tolerance = task%get_real('tolerance')
    if (given) then
      start => task%get_complexes('start')
      call task%check_extents('start', shape(start), shape(a))
    else
      state => task%get_matrix('state')
      call task%check_extents('state', shape(state), [size(a), 2])
    end if
    expected = 0.0_wp
    before = (0.0_wp, 0.0_wp)
    do round = 1, max_rounds
      if (task%failed()) exit
      call new_multiple_scales(scales, form, tolerance, .false., task%status, sizes=expected)
      if (task%failed()) exit
      if (given) then
        a = start/scales%amplitude_units
      else
        call amplitudes_of_state(scales, state(:, 1), state(:, 2), a, task%status)
      end if
      if (task%failed() .or. .not. scales%normal%choosing) exit
      if (round == 1 .and. .not. wants_more(scales%normal, abs(a))) exit
      ! Choose resonances for the new amplitudes. Equal amplitudes give the same choice.
      if (round > 1 .and. .not. any(abs(a - before) > 0.0_wp)) exit
      if (round == max_rounds) exit
      before = a
      expected = abs(a)
    end do
  end subroutine choose_start

  !> Estimated `errors` (n_dof, n) of a solution at `times` (n), from `amplitudes` (n_modes, n) and
  !! `expected` (n_modes) of `find_motion`; `tolerance` of resonances.
  subroutine find_errors(task, form)
    type(task_type), intent(inout) :: task
    type(polynomial_form_type), intent(in) :: form
    type(multiple_scales_type) :: scales
    complex(wp), pointer, contiguous :: amplitudes(:, :)
    real(wp), pointer, contiguous :: times(:), expected(:)
    real(wp), allocatable :: errors(:, :)
    real(wp) :: tolerance
    integer :: n

    tolerance = task%get_real('tolerance')
    times => task%get_reals('times')
    amplitudes => task%get_complex_matrix('amplitudes')
    expected => task%get_reals('expected')
    n = size(times)
    call task%check_extents('amplitudes', shape(amplitudes), [form%n_modes(), n])
    call task%check_extents('expected', shape(expected), [form%n_modes()])
    if (task%failed()) return
    call new_multiple_scales(scales, form, tolerance, .false., task%status, sizes=expected)
    if (task%failed()) return
    allocate (errors(form%n_dof, n), source=0.0_wp)
    call motion_errors(scales, form%full, times, &
                       amplitudes/spread(scales%amplitude_units, 2, n), errors, task%cancel)
    call task%found%put_reals('errors', errors, shape(errors))
  end subroutine find_errors

  !> Steady solutions for `values` (n) of the frequency (`vary` = 1) or the amplitude (`vary` = 2)
  !! of a `load`; `tolerance` of resonances; `with_errors`: also compute errors. Output for m
  !! solutions: `which` (m) value, `amplitudes` (n_modes, m), `frames` (n_modes, m), `eigenvalues`
  !! (2 n_modes, m), `harmonics` (n_dof, m), `sizes` (4, m), `left_out` (m), `resting` (m), `beats`
  !! (m); with errors `harmonic_errors` and `motion_errors` (n_dof, m) and `growth_errors` (m).
  !! Spectral lines of beating solutions: `line_of` (k), `line_frequencies` (k), `lines` (n_dof, k).
  !! For each value `may_lack` (n), 1 if a solution may be missing.
  subroutine find_response(task, form)
    type(task_type), intent(inout) :: task
    type(polynomial_form_type), intent(in) :: form
    type(steady_points_type) :: points
    real(wp), pointer, contiguous :: values(:)
    real(wp) :: tolerance
    integer :: load, vary, m
    logical :: with_errors

    load = task%get_integer('load')
    vary = task%get_integer('vary')
    values => task%get_reals('values')
    tolerance = task%get_real('tolerance')
    with_errors = task%get_flag('with_errors')
    if (task%failed()) return
    call response_along(form, load, vary, values, tolerance, with_errors, points, task%status, &
                        task%cancel)
    if (task%failed()) return
    m = points%n
    call task%found%put_integers('which', points%value(:m), [m])
    call put_columns('amplitudes', points%a)
    call task%found%put_reals('frames', points%frame(:, :m), [size(points%frame, 1), m])
    call put_columns('eigenvalues', points%eigenvalues)
    call put_columns('harmonics', points%harmonic)
    call task%found%put_reals('sizes', points%sizes(:, :m), [size(points%sizes, 1), m])
    call task%found%put_reals('left_out', points%left_out(:m), [m])
    call task%found%put_reals('resting', points%resting(:m), [m])
    call task%found%put_integers('beats', points%beats(:m), [m])
    call task%found%put_integers('line_of', points%line_of, shape(points%line_of))
    call task%found%put_reals('line_frequencies', points%line_frequency, &
                              shape(points%line_frequency))
    call task%found%put_complexes('lines', points%line, shape(points%line))
    call task%found%put_integers('may_lack', merge(1, 0, points%may_lack), shape(points%may_lack))
    if (.not. with_errors) return
    call task%found%put_reals('harmonic_errors', points%harmonic_errors(:, :m), &
                              [size(points%harmonic_errors, 1), m])
    call task%found%put_reals('motion_errors', points%motion_errors(:, :m), &
                              [size(points%motion_errors, 1), m])
    call task%found%put_reals('growth_errors', points%growth_errors(:m), [m])

  contains

    subroutine put_columns(name, columns)
      character(len=*), intent(in) :: name
      complex(wp), intent(in) :: columns(:, :)
      call task%found%put_complexes(name, columns(:, :m), [size(columns, 1), m])
    end subroutine put_columns

  end subroutine find_response

  !> All resonance conditions up to third order between `natural` (n) frequencies and load
  !! frequencies `drives` (m): `coefficients` (n + m, k), `orders` (k), `divisors` (k).
  subroutine find_resonances(task)
    type(task_type), intent(inout) :: task
    real(wp), pointer, contiguous :: natural(:), drives(:)
    integer, allocatable :: coefficients(:, :), orders(:)
    real(wp), allocatable :: divisors(:)

    natural => task%get_reals('natural')
    drives => task%get_reals('drives')
    if (task%failed()) return
    call list_resonances(natural, drives, coefficients, orders, divisors)
    call task%found%put_integers('coefficients', coefficients, shape(coefficients))
    call task%found%put_integers('orders', orders, shape(orders))
    call task%found%put_reals('divisors', divisors, shape(divisors))
  end subroutine find_resonances

end module viscovib_scales_tasks
