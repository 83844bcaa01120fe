!> A system extended by the angle of its shaft, which a motor turns, or whose speed is given.
module viscovib_shaft_system
  use viscovib_dense, only: factorize, solve
  use viscovib_kinds, only: wp
  use viscovib_law_program, only: negate
  use viscovib_law_term, only: law_term, read_rates
  use viscovib_law_text, only: compile_law
  use viscovib_fitted_memory, only: copy_system
  use viscovib_moving_element, only: state_stop
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: clipped, fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: drive_type, put_on_shaft, torque_arguments

  !> Names of the arguments of a torque: speed and angle.
  character(len=*), parameter :: torque_arguments(2) = [character(len=3) :: 'nu', 'phi']

  type :: drive_type
    !> T (N m), a text; not allocated: none.
    character(len=:), allocatable :: torque
    !> J (kg m^2), and u = m e of each coordinate (kg m), shape (n).
    real(wp) :: inertia = 1.0_wp
    complex(wp), allocatable :: unbalance(:)
  end type drive_type

contains

  !> The system with the angle as its last coordinate. Matrices that depend on the speed are those
  !! at the speed of the shaft.
  subroutine put_on_shaft(system, drive, whole, status)
    type(polynomial_type), intent(in) :: system
    type(drive_type), intent(in) :: drive
    type(polynomial_type), intent(out) :: whole
    type(status_type), intent(out) :: status
    integer :: i, m, n

    call check(system, drive, status)
    if (status%failed()) return
    n = system%n_dof()
    m = system%n_memory()
    call copy_system(system, whole)
    allocate (whole%shaft)
    whole%shaft%speed_matrices = system%speed_matrices
    whole%shaft%unbalance = drive%unbalance
    whole%mass = padded(system%mass, n + 1, n + 1)
    whole%mass(n + 1, n + 1) = drive%inertia
    whole%damping = padded(system%damping, n + 1, n + 1)
    if (allocated(system%space_damping)) then
      whole%space_damping = padded(system%space_damping, n + 1, n + 1)
      whole%space_stiffness = padded(system%space_stiffness, n + 1, n + 1)
    end if
    whole%base_direction = [system%base_direction, 0.0_wp]
    ! The torque acts on a variable of its own.
    whole%gather = padded(system%gather, m + 1, n + 1)
    whole%spread = padded(system%spread, n + 1, m + 1)
    whole%spread(n + 1, m + 1) = 1.0_wp
    whole%kernel_of = [system%kernel_of, 0]
    whole%bent = [system%bent, allocated(drive%torque)]
    do i = 1, size(whole%laws)
      associate (law => whole%laws(i))
        law%arguments = padded(law%arguments, size(law%arguments, 1), n + 1)
        law%rates = padded(law%rates, size(law%rates, 1), n + 1)
      end associate
    end do
    whole%odd = .false.
    whole%degree = 0
    if (allocated(drive%torque)) call add_torque(drive%torque, m + 1, whole, status)
    call read_rates(whole%laws, n + 1, whole%rates)
  end subroutine put_on_shaft

  !> Refuse a total inertia that is not positive at every angle.
  subroutine check(system, drive, status)
    type(polynomial_type), intent(in) :: system
    type(drive_type), intent(in) :: drive
    type(status_type), intent(out) :: status
    real(wp), allocatable :: mass(:, :), moved(:, :), both(:, :)
    real(wp) :: squares(2, 2), most
    integer :: pivots(system%n_dof()), i, n
    logical :: singular

    call set_ok(status)
    n = system%n_dof()
    if (size(drive%unbalance) /= n) then
      call fail(status, status_input_error, 'unbalance', 'unbalance: must have '//show(n) &
                //' values, has '//show(size(drive%unbalance)))
      return
    end if
    both = reshape([real(drive%unbalance), aimag(drive%unbalance)], [n, 2])
    mass = system%mass
    moved = both
    call factorize(n, mass, pivots, singular)
    do i = 1, 2
      call solve(n, mass, pivots, moved(:, i))
    end do
    squares = matmul(transpose(both), moved)
    if (any(system%laws%state == state_stop) .and. any(abs(both) > 0.0_wp)) then
      call fail(status, status_input_error, 'unbalance', 'unbalance: must be 0 with rigid stops, ' &
                //'whose impacts would change the speed')
      return
    end if
    most = 0.5_wp*(squares(1, 1) + squares(2, 2)) &
           + hypot(0.5_wp*(squares(1, 1) - squares(2, 2)), squares(1, 2))
    if (drive%inertia > most) return
    call fail(status, status_input_error, 'inertia', 'inertia = '//show(drive%inertia) &
              //': must be greater than '//show(most)//', (m e)^2 of the unbalance divided by ' &
              //'the mass')
  end subroutine check

  !> Add the law -T on the angle.
  subroutine add_torque(text, variable, whole, status)
    character(len=*), intent(in) :: text
    !> Its hereditary variable.
    integer, intent(in) :: variable
    type(polynomial_type), intent(inout) :: whole
    type(status_type), intent(inout) :: status
    type(law_term), allocatable :: laws(:)
    character(len=1) :: no_names(0)
    real(wp) :: no_values(0)
    character(len=:), allocatable :: fault
    integer :: n

    n = size(whole%laws)
    allocate (laws(n + 1))
    laws(:n) = whole%laws
    associate (law => laws(n + 1), angle => whole%n_dof())
      call compile_law(text, torque_arguments, no_names, no_values, law%program, law%parity, &
                       law%degree, fault)
      if (fault /= '') then
        call fail(status, status_input_error, 'torque', "torque = '"//clipped(text)//"': "//fault)
        return
      end if
      law%text = text
      law%degree = 0
      law%program%code = [law%program%code, negate]
      law%program%number = [law%program%number, 0.0_wp]
      call law%program%measure()
      law%arguments = padded(reshape([real(wp) ::], [0, 0]), 2, angle)
      law%rates = law%arguments
      law%rates(1, angle) = 1.0_wp
      law%arguments(2, angle) = 1.0_wp
      call law%drop_unread()
      law%equations = [angle]
      law%weights = [1.0_wp]
      law%variables = [variable]
    end associate
    call move_alloc(laws, whole%laws)
  end subroutine add_torque

  !> A matrix with more rows and columns of zeros.
  pure function padded(matrix, rows, columns) result(wide)
    real(wp), intent(in) :: matrix(:, :)
    integer, intent(in) :: rows, columns
    real(wp) :: wide(rows, columns)
    wide = 0.0_wp
    wide(:size(matrix, 1), :size(matrix, 2)) = matrix
  end function padded

end module viscovib_shaft_system
