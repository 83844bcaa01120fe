! Optimize: -O1
!> Objects that are systems, and their properties.
module viscovib_system_tasks
  use viscovib_binding_tools, only: make_pendulum, make_system
  use viscovib_body_checks, only: check_inertia, doubt_units
  use viscovib_body_vector, only: mounted_from_vector
  use viscovib_campbell, only: campbell_type, find_campbell
  use viscovib_characteristic_matrix, only: characteristic_matrix, oscillator_matrix
  use viscovib_characteristic_roots, only: find_characteristic_roots, roots_type
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  use viscovib_locks, only: lock_texts, unlock_texts
  use viscovib_mount, only: mount_type
  use viscovib_mounted_body, only: mounted_body, preload_stiffness, rest_type, spring_turned
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_modes, only: oscillator_modes
  use viscovib_pendulum, only: pendulum_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_rotation, only: new_rotation
  use viscovib_shaft_system, only: drive_type, put_on_shaft
  use viscovib_spring_about, only: force_of
  use viscovib_status, only: fail, status_input_error
  use viscovib_stiffness_ratio, only: entries_of, entries_type, hidden_modes, hidden_poles, &
    hidden_springs, least_hidden
  use viscovib_task, only: built_pendulum, built_system, task_type
  use viscovib_turning_body, only: row_of
  implicit none
  private

  public :: system_task

  !> Length of the names of mounts in a text.
  integer, parameter :: longest_name = 64

contains

  subroutine system_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('oscillator')
      call build_system(task)
    case ('on shaft')
      call build_on_shaft(task)
    case ('pendulum')
      call build_pendulum(task)
    case ('body')
      call place_body(task)
    case ('lost modes')
      call find_lost_modes(task)
    case ('lost poles')
      call find_lost_poles(task)
    case ('lost springs')
      call find_lost_springs(task)
    case ('modes')
      call find_modes(task)
    case ('dynamic_stiffness')
      call find_stiffness(task)
    case ('roots')
      call find_roots(task)
    case ('campbell')
      call find_lines(task)
    case ('pendulum_modes')
      call find_pendulum_modes(task)
    case ('pendulum_motion')
      call evaluate_pendulum(task)
    case ('pendulum_jacobian')
      call differentiate_pendulum(task)
    case default
      call task%refuse_kind()
    end select
  end subroutine system_task

  !> An oscillator: `flat` (n), `kind_x`, `data_x` (m), `kind_phi`, `data_phi` (k) as for
  !! `make_system`.
  subroutine build_system(task)
    type(task_type), intent(inout) :: task
    type(built_system), allocatable :: own
    real(wp), pointer, contiguous :: flat(:), data_x(:), data_phi(:)
    integer :: kind_x, kind_phi

    allocate (own)
    flat => task%get_reals('flat')
    kind_x = task%get_integer('kind_x')
    data_x => task%get_reals('data_x')
    kind_phi = task%get_integer('kind_phi')
    data_phi => task%get_reals('data_phi')
    if (task%failed()) return
    call make_system(own%it, flat, kind_x, data_x, kind_phi, data_phi, task%status)
    if (.not. task%failed()) call move_alloc(own, task%built)
  end subroutine build_system

  !> A polynomial system with the angle of its shaft as its last coordinate: `torque`, a text
  !! (empty: none), `inertia` and `unbalance` (n_dof).
  subroutine build_on_shaft(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    type(built_system), allocatable :: own
    type(polynomial_type), allocatable :: whole
    type(drive_type) :: drive

    system => task%system(with_speed=.true.)
    call task%take_text('torque', drive%torque)
    drive%inertia = task%get_real('inertia')
    allocate (drive%unbalance, source=task%get_complexes('unbalance'))
    if (task%failed()) return
    if (drive%torque == '') deallocate (drive%torque)
    allocate (own, whole)
    select type (system)
    type is (polynomial_type)
      call lock_texts()
      call put_on_shaft(system, drive, whole, task%status)
      call unlock_texts()
    class default
      call task%refuse_kind()
    end select
    if (task%failed()) return
    call move_alloc(whole, own%it)
    call move_alloc(own, task%built)
  end subroutine build_on_shaft

  !> A pendulum: `flat` (14) as for `make_pendulum`.
  subroutine build_pendulum(task)
    type(task_type), intent(inout) :: task
    type(built_pendulum), allocatable :: own
    real(wp), pointer, contiguous :: flat(:)

    allocate (own)
    flat => task%get_reals('flat')
    call task%check_extents('flat', shape(flat), [14])
    if (task%failed()) return
    call make_pendulum(own%it, flat, task%status)
    if (.not. task%failed()) call move_alloc(own, task%built)
  end subroutine build_pendulum

  !> Where a body rests: `flat` (n) as of `mounted_from_vector`, `gravity` (3), `exact` (finite
  !! rotations); of its mounts `names`, the `first` spring of each, and `angles` (3, n_mounts).
  !!
  !! Returns lines about numbers that are probably in other units, `doubts`; coordinates `q`,
  !! deflections `d` of the springs and their forces `carried`, and `residual`. `preloads` tells if
  !! springs have forces at d = 0. In axes parallel to the floor: the `axes` of the body (3, 3),
  !! `rows` (n_springs, n_dof) and `arms` (n_springs, 3) of the springs, and the stiffness against
  !! rotations by their forces, `bend` (3, 3).
  subroutine place_body(task)
    type(task_type), intent(inout) :: task
    type(mounted_body) :: body
    type(kernel_holder), allocatable :: kernels(:)
    type(rest_type) :: rest
    character(len=longest_name), allocatable :: names(:)
    character(len=:), allocatable :: text
    real(wp), pointer, contiguous :: gravity(:), angles(:, :)
    real(wp), allocatable :: rows(:, :), arms(:, :)
    real(wp) :: force, slope, axes(3, 3)
    logical :: preloads
    integer :: j

    call task%take_text('names', text)
    gravity => task%get_reals('gravity')
    angles => task%get_matrix('angles')
    call task%check_extents('gravity', shape(gravity), [3])
    if (task%failed()) return
    call mounted_from_vector(body, kernels, task%get_reals('flat'), task%status)
    if (.not. task%failed()) call check_inertia(body%inertia, task%status)
    if (task%failed()) return
    body%gravity = gravity
    body%exact = task%get_flag('exact')
    allocate (names(len(text)/longest_name))
    do j = 1, size(names)
      names(j) = text(longest_name*(j - 1) + 1:longest_name*j)
    end do
    call lock_texts()
    call task%found%put_text('doubts', doubt_units(body, task%get_integers('first'), names, angles))
    call unlock_texts()
    call body%find_rest(kernels, rest, task%status)
    if (task%failed()) return
    preloads = .false.
    allocate (rows(size(body%springs), body%n_dof()), arms(size(body%springs), 3))
    do j = 1, size(body%springs)
      call force_of(body%springs(j), 0.0_wp, force, slope)
      preloads = preloads .or. abs(force) > 0.0_wp
      if (body%exact) then
        body%springs(j) = spring_turned(body%springs(j), &
                                        new_rotation(cmplx(rest%q(4:6), 0.0_wp, wp)))
      end if
      rows(j, :) = row_of(body%springs(j), body%n_dof())
      arms(j, :) = body%springs(j)%arm
    end do
    axes = rest%axes(body%exact)
    call task%found%put_integer('preloads', merge(1_i8, 0_i8, preloads))
    call task%found%put_reals('q', rest%q, shape(rest%q))
    call task%found%put_reals('d', rest%d, shape(rest%d))
    call task%found%put_reals('carried', rest%carried, shape(rest%carried))
    call task%found%put_real('residual', rest%residual)
    call task%found%put_reals('axes', axes, shape(axes))
    call task%found%put_reals('rows', rows, shape(rows))
    call task%found%put_reals('arms', arms, shape(arms))
    call task%found%put_reals('bend', preload_stiffness(body%springs, rest%carried), [3, 3])
  end subroutine place_body

  !> A line about the mode that rounding errors of the stiffness hide most, `note`, or nothing:
  !! `squares` (m), `shapes` (n, m) and the diagonal of the mass, `mass` (n), with the `stiffness`
  !! (n, n) or its entries `values` (k) in `rows` and `columns` from 1; `least`: see `hidden_modes`.
  !! The first mode is mode 0.
  subroutine find_lost_modes(task)
    type(task_type), intent(inout) :: task
    type(entries_type) :: entries
    real(wp), pointer, contiguous :: squares(:), shapes(:, :), mass(:)
    integer :: n

    squares => task%get_reals('squares')
    shapes => task%get_matrix('shapes')
    mass => task%get_reals('mass')
    n = size(mass)
    call task%check_extents('shapes', shape(shapes), [n, size(squares)])
    if (task%has('values')) then
      entries = entries_type(task%get_integers('rows'), task%get_integers('columns'), &
                             task%get_reals('values'))
      if (any(entries%row < 1 .or. entries%row > n) .or. &
          any(entries%column < 1 .or. entries%column > n)) then
        call fail(task%status, status_input_error, 'rows', 'rows: must be those of the matrix')
      end if
    else
      entries = entries_of(task%get_matrix('stiffness'))
    end if
    if (task%failed()) return
    call lock_texts()
    call task%found%put_text('note', hidden_modes(squares, shapes, mass, entries, &
                                                  task%get_real('least', least_hidden), 0))
    call unlock_texts()
  end subroutine find_lost_modes

  !> The same about complex modes: `poles` (p), `left` and `right` (n, p), `stiffness` (n, n).
  subroutine find_lost_poles(task)
    type(task_type), intent(inout) :: task
    complex(wp), pointer, contiguous :: poles(:), left(:, :), right(:, :)
    real(wp), pointer, contiguous :: stiffness(:, :)

    poles => task%get_complexes('poles')
    left => task%get_complex_matrix('left')
    right => task%get_complex_matrix('right')
    stiffness => task%get_matrix('stiffness')
    call task%check_extents('left', shape(left), [size(stiffness, 1), size(poles)])
    call task%check_extents('right', shape(right), [size(stiffness, 1), size(poles)])
    if (task%failed()) return
    call lock_texts()
    call task%found%put_text('note', hidden_poles(poles, left, right, stiffness))
    call unlock_texts()
  end subroutine find_lost_poles

  !> The same about a polynomial system in its coordinates.
  subroutine find_lost_springs(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system

    system => task%system(with_speed=.true.)
    if (task%failed()) return
    call lock_texts()
    select type (system)
    type is (polynomial_type)
      call task%found%put_text('note', hidden_springs(system, 0))
    class default
      call task%refuse_kind()
    end select
    call unlock_texts()
  end subroutine find_lost_springs

  !> Natural frequencies `omega` (n) and mode `shapes` (n, n) of an oscillator.
  subroutine find_modes(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    real(wp), allocatable :: omega(:), shapes(:, :)

    system => task%system(with_speed=.true.)
    if (task%failed()) return
    allocate (omega(system%n_dof()), shapes(system%n_dof(), system%n_dof()))
    select type (system)
    class is (mount_type)
      call system%natural_modes(omega, shapes)
    class default
      call oscillator_modes(system, omega, shapes, task%status)
    end select
    call task%found%put_reals('omega', omega, shape(omega))
    call task%found%put_reals('shapes', shapes, shape(shapes))
  end subroutine find_modes

  !> Dynamic `stiffness` (n_dof, n_dof, n) at frequencies `nu` (n).
  subroutine find_stiffness(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    real(wp), pointer, contiguous :: nu(:)
    complex(wp), allocatable :: fraction(:, :)
    complex(wp), pointer, contiguous :: stiffness(:, :, :), values(:)
    integer :: n

    system => task%system(with_speed=.true.)
    nu => task%get_reals('nu')
    if (task%failed()) return
    allocate (fraction(size(nu), system%n_memory()))
    n = system%n_dof()
    values => task%found%new_complexes('stiffness', [n, n, size(nu)])
    stiffness(1:n, 1:n, 1:size(nu)) => values
    call system%retained(nu, fraction)
    call system%dynamic_stiffness(nu, nu, fraction, stiffness)
  end subroutine find_stiffness

  !> Roots of the characteristic equation: `oscillatory` (n) and `real` (m); `n_unstable` and
  !! `n_missing` by the argument principle if `is_counted`, `complete`, and the searched `region`.
  subroutine find_roots(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    type(characteristic_matrix) :: matrix
    type(roots_type) :: roots

    system => task%system()
    if (.not. task%failed()) call oscillator_matrix(matrix, system, task%status)
    if (task%failed()) return
    call find_characteristic_roots(matrix, roots, task%cancel)
    call task%found%put_complexes('oscillatory', roots%oscillatory, shape(roots%oscillatory))
    call task%found%put_reals('real', roots%real, shape(roots%real))
    call task%found%put_integer('n_unstable', int(roots%n_unstable, i8))
    call task%found%put_integer('n_missing', int(roots%n_missing, i8))
    call task%found%put_integer('is_counted', merge(1_i8, 0_i8, roots%is_counted))
    call task%found%put_integer('complete', merge(1_i8, 0_i8, roots%complete))
    call task%found%put_text('region', trim(roots%region))
  end subroutine find_roots

  !> Modes of a polynomial system over `speeds` (n): `roots` (m, n), `shapes` (n_dof, m, n),
  !! `growth` (n), `threshold`, and the critical speeds of `orders`: `critical` (k), their `mode`
  !! (k) and `order` (k). With two coordinates, `plane` (2): `whirl` (m, n).
  subroutine find_lines(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    type(campbell_type) :: campbell
    real(wp), pointer, contiguous :: speeds(:), orders(:)

    system => task%system(with_speed=.true.)
    speeds => task%get_reals('speeds')
    orders => task%get_reals('orders')
    if (task%failed()) return
    select type (system)
    type is (polynomial_type)
      call find_campbell(system, speeds, orders, campbell, task%status)
    class default
      call task%refuse_kind()
    end select
    if (task%failed()) return
    associate (found => task%found, critical => campbell%critical)
      call found%put_complexes('roots', campbell%roots, shape(campbell%roots))
      call found%put_complexes('shapes', campbell%shapes, shape(campbell%shapes))
      call found%put_reals('growth', campbell%growth, shape(campbell%growth))
      call found%put_real('threshold', campbell%threshold)
      call found%put_reals('critical', critical%speed, shape(critical))
      call found%put_reals('order', critical%order, shape(critical))
      call found%put_integers('mode', critical%mode, shape(critical))
    end associate
    if (task%has('plane')) then
      call task%found%put_reals('whirl', campbell%whirl(task%get_integers('plane')), &
                                shape(campbell%roots))
    end if
  end subroutine find_lines

  !> Natural frequencies `omega` (3) of a pendulum, mode `shapes` (3, 3), `r`, `z_r`.
  subroutine find_pendulum_modes(task)
    type(task_type), intent(inout) :: task
    type(pendulum_type), pointer :: system
    real(wp) :: omega(3), shapes(3, 3)

    system => task%pendulum()
    if (task%failed()) return
    call system%natural_modes(omega, shapes)
    call task%found%put_reals('omega', omega, shape(omega))
    call task%found%put_reals('shapes', shapes, shape(shapes))
    call task%found%put_real('r', system%r)
    call task%found%put_real('z_r', system%z_r)
  end subroutine find_pendulum_modes

  !> Read `state` (6, n), (z, z', phi, phi', psi, psi'), and `drive` (3, n), cos(p_j t).
  subroutine read_states(task, system, drive, state)
    type(task_type), intent(inout) :: task
    type(pendulum_type), pointer, intent(out) :: system
    real(wp), pointer, contiguous, intent(out) :: drive(:, :), state(:, :)
    system => task%pendulum()
    drive => task%get_matrix('drive')
    state => task%get_matrix('state')
    call task%check_extents('state', shape(state), [6, size(state, 2)])
    call task%check_extents('drive', shape(drive), [3, size(state, 2)])
  end subroutine read_states

  !> For states as in `read_states`: `acceleration` (3, n), `energy` (n) and its rate of change,
  !! `power` (n).
  subroutine evaluate_pendulum(task)
    type(task_type), intent(inout) :: task
    type(pendulum_type), pointer :: system
    real(wp), pointer, contiguous :: drive(:, :), state(:, :)
    real(wp), allocatable :: acceleration(:, :), energy(:), power(:)
    real(wp), dimension(n_lanes, 3) :: q, v, cosines, a
    integer :: i, d, n

    call read_states(task, system, drive, state)
    if (task%failed()) return
    n = size(state, 2)
    allocate (acceleration(3, n), energy(n), power(n))
    do i = 1, n
      do d = 1, 3
        q(:, d) = state(2*d - 1, i)
        v(:, d) = state(2*d, i)
        cosines(:, d) = drive(d, i)
      end do
      call system%acceleration(q, v, cosines, a)
      acceleration(:, i) = a(1, :)
      energy(i) = system%energy(q(1, :), v(1, :))
      power(i) = system%power(v(1, :), drive(:, i))
    end do
    call task%found%put_reals('acceleration', acceleration, shape(acceleration))
    call task%found%put_reals('energy', energy, shape(energy))
    call task%found%put_reals('power', power, shape(power))
  end subroutine evaluate_pendulum

  !> For states as in `read_states`: derivatives of the accelerations by the state, `jacobian` (3,
  !! 6, n).
  subroutine differentiate_pendulum(task)
    type(task_type), intent(inout) :: task
    type(pendulum_type), pointer :: system
    real(wp), pointer, contiguous :: drive(:, :), state(:, :)
    real(wp), allocatable :: jacobian(:, :, :)
    real(wp), dimension(n_lanes, 3) :: q, v, cosines, dq, dv, a, da
    integer :: i, d

    call read_states(task, system, drive, state)
    if (task%failed()) return
    allocate (jacobian(3, 6, size(state, 2)))
    dq = 0.0_wp
    dv = 0.0_wp
    do d = 1, 3
      dq(2*d - 1, d) = 1.0_wp
      dv(2*d, d) = 1.0_wp
    end do
    do i = 1, size(state, 2)
      do d = 1, 3
        q(:, d) = state(2*d - 1, i)
        v(:, d) = state(2*d, i)
        cosines(:, d) = drive(d, i)
      end do
      call system%tangent(q, v, cosines, dq, dv, a, da)
      jacobian(:, :, i) = transpose(da(:6, :))
    end do
    call task%found%put_reals('jacobian', jacobian, shape(jacobian))
  end subroutine differentiate_pendulum

end module viscovib_system_tasks
