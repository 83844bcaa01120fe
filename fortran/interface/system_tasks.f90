!> Objects that are systems, and their properties.
module viscovib_system_tasks
  use viscovib_binding_tools, only: make_pendulum, make_system
  use viscovib_characteristic_matrix, only: characteristic_matrix, oscillator_matrix
  use viscovib_characteristic_roots, only: find_characteristic_roots, roots_type
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  use viscovib_mount, only: mount_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_pendulum, only: pendulum_type
  use viscovib_task, only: built_pendulum, built_system, task_type
  implicit none
  private

  public :: system_task

contains

  subroutine system_task(task, name)
    type(task_type), intent(inout) :: task
    character(len=*), intent(in) :: name
    select case (name)
    case ('oscillator')
      call build_system(task)
    case ('pendulum')
      call build_pendulum(task)
    case ('modes')
      call find_mount_modes(task)
    case ('dynamic_stiffness')
      call find_stiffness(task)
    case ('roots')
      call find_roots(task)
    case ('pendulum_modes')
      call find_pendulum_modes(task)
    case ('pendulum_frequencies')
      call find_frequencies(task)
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

  !> Natural frequencies `omega` (2) and mode `shapes` (2, 2) of a mount.
  subroutine find_mount_modes(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    real(wp) :: omega(2), shapes(2, 2)

    system => task%system()
    if (task%failed()) return
    select type (system)
    class is (mount_type)
      call system%natural_modes(omega, shapes)
      call task%found%put_reals('omega', omega, shape(omega))
      call task%found%put_reals('shapes', shapes, shape(shapes))
    class default
      call task%refuse_kind()
    end select
  end subroutine find_mount_modes

  !> Dynamic `stiffness` (n_dof, n_dof, n) at frequencies `nu` (n).
  subroutine find_stiffness(task)
    type(task_type), intent(inout) :: task
    class(oscillator_type), pointer :: system
    real(wp), pointer, contiguous :: nu(:)
    complex(wp), allocatable :: fraction(:, :), stiffness(:, :, :)

    system => task%system()
    nu => task%get_reals('nu')
    if (task%failed()) return
    allocate (fraction(size(nu), system%n_memory()))
    allocate (stiffness(system%n_dof(), system%n_dof(), size(nu)))
    call system%retained(nu, fraction)
    call system%dynamic_stiffness(nu, fraction, stiffness)
    call task%found%put_complexes('stiffness', stiffness, shape(stiffness))
  end subroutine find_stiffness

  !> Roots of the characteristic equation: `oscillatory` (n) and `real` (m); `n_unstable` and
  !! `n_missing` by the argument principle, `complete`, and the searched `region`.
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
    call task%found%put_integer('complete', merge(1_i8, 0_i8, roots%complete))
    call task%found%put_text('region', trim(roots%region))
  end subroutine find_roots

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

  !> Natural frequencies `omega` (3, n) of pendulums `flat` (14, n).
  subroutine find_frequencies(task)
    type(task_type), intent(inout) :: task
    type(pendulum_type) :: pendulum
    real(wp), pointer, contiguous :: flat(:, :)
    real(wp), allocatable :: omega(:, :)
    real(wp) :: shapes(3, 3)
    integer :: i

    flat => task%get_matrix('flat')
    call task%check_extents('flat', shape(flat), [14, size(flat, 2)])
    if (task%failed()) return
    allocate (omega(3, size(flat, 2)))
    do i = 1, size(flat, 2)
      call make_pendulum(pendulum, flat(:, i), task%status)
      if (task%failed()) return
      call pendulum%natural_modes(omega(:, i), shapes)
    end do
    call task%found%put_reals('omega', omega, shape(omega))
  end subroutine find_frequencies

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
