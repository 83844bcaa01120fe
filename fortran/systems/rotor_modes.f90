! Optimize: -O3
!> Complex modes of a polynomial system about rest at a speed of its rotor.
!!
!! Eigenvalues and vectors of (M s^2 + C(Omega) s + K(Omega)) x = 0, with the exponentials of memory
!! as additional coordinates. Eigenvalues are those of the state matrix, in units in which masses
!! and the stiffness have the size 1. Vectors are found by inverse iteration.
module viscovib_rotor_modes
  use viscovib_dense, only: invert, solve_complex
  use viscovib_eigenvalue_conditions, only: eigenvalue_conditions
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_hidden_memory, only: count_hidden, unfold_memory
  use viscovib_kinds, only: wp
  use viscovib_polynomial, only: polynomial_type
  use viscovib_sorting, only: order_of
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: check_modes, find_rotor_modes, follow_mode, rotor_modes

  !> Largest rounding error of eigenvalues, in units of their condition.
  real(wp), parameter :: uncertain = 64.0_wp*epsilon(1.0_wp)
  !> Distance between eigenvalues, relative to their size, below which vectors are arbitrary.
  real(wp), parameter :: together = 1.0e-6_wp
  !> Iterations for one mode.
  integer, parameter :: most_passes = 12

  !> The oscillating modes, by increasing frequency.
  type :: rotor_modes
    !> rad/s; largest real part of all eigenvalues (1/s).
    real(wp) :: speed = 0.0_wp, growth = 0.0_wp
    !> True if a real part is positive beyond rounding errors.
    logical :: is_unstable = .false.
    !> Largest number of oscillating modes: one for each coordinate and exponential of memory.
    integer :: most = 0
    !> Eigenvalues with a positive imaginary part (1/s), and the shapes with x^H M x = 1, shapes (k)
    !! and (n_dof, k).
    complex(wp), allocatable :: roots(:), shapes(:, :)
    !> True if no other eigenvalue is so close that the shape is arbitrary, shape (k).
    logical, allocatable :: alone(:)
  end type rotor_modes

contains

  !> Refuse a memory that is no sum of exponentials.
  subroutine check_modes(system, status)
    type(polynomial_type), intent(in) :: system
    type(status_type), intent(out) :: status
    integer :: i
    logical :: fits

    call set_ok(status)
    if (.not. any(system%kernel_of > 0)) return
    fits = count_hidden(system) >= 0
    do i = 1, size(system%laws)
      if (system%laws(i)%kernel > 0 .and. any(abs(system%laws(i)%rates) > 0.0_wp)) fits = .false.
    end do
    if (fits) return
    call fail(status, status_input_error, 'kernel', 'kernel: must be a sum of exponentials for ' &
              //'complex modes, and no force in the rates may have one: use characteristic_roots')
  end subroutine check_modes

  !> The modes at a speed.
  subroutine find_rotor_modes(system, speed, modes, status)
    !> As `check_modes` accepts it.
    type(polynomial_type), intent(in) :: system
    !> rad/s.
    real(wp), intent(in) :: speed
    type(rotor_modes), intent(out) :: modes
    type(status_type), intent(out) :: status
    type(polynomial_type) :: turned

    modes%speed = speed
    call turn(system, speed, turned)
    call find_modes(system%n_dof(), turned%mass, turned%damping, &
                    matmul(turned%spread, turned%gather), modes, status)
  end subroutine find_rotor_modes

  !> The system at a speed, with the exponentials of memory as coordinates.
  subroutine turn(system, speed, turned)
    type(polynomial_type), intent(in) :: system
    real(wp), intent(in) :: speed
    type(polynomial_type), intent(out) :: turned
    type(polynomial_type) :: fixed

    turned = system
    call turned%set_speed(speed)
    if (.not. any(system%kernel_of > 0)) return
    fixed = turned
    call unfold_memory(fixed, turned)
  end subroutine turn

  !> One mode at a speed, by inverse iteration from an approximate one (Rayleigh quotients of right
  !! and left vectors).
  subroutine follow_mode(system, speed, root, shape_of, found)
    type(polynomial_type), intent(in) :: system
    real(wp), intent(in) :: speed
    !> Approximation, then the mode, with x^H M x = 1.
    complex(wp), intent(inout) :: root, shape_of(:)
    logical, intent(out) :: found
    type(polynomial_type) :: turned
    real(wp), allocatable :: stiffness(:, :)
    complex(wp), allocatable :: q(:, :), x(:), y(:)
    complex(wp) :: change
    integer :: n, pass
    logical :: singular

    call turn(system, speed, turned)
    stiffness = matmul(turned%spread, turned%gather)
    n = size(shape_of)
    allocate (x(turned%n_dof()), source=(0.0_wp, 0.0_wp))
    x(:n) = shape_of
    y = conjg(x)
    found = .false.
    do pass = 1, most_passes
      q = turned%mass*root**2 + turned%damping*root + stiffness
      call solve_complex(q, x, .true., singular)
      if (singular) return
      call solve_complex(transpose(q), y, .true., singular)
      if (singular .or. .not. (maxval(abs(x)) <= huge(1.0_wp) &
                               .and. maxval(abs(y)) <= huge(1.0_wp))) return
      x = x/maxval(abs(x))
      y = y/maxval(abs(y))
      change = sum(y*matmul(2.0_wp*root*turned%mass + turned%damping, x))
      if (.not. abs(change) > 0.0_wp) return
      change = sum(y*matmul(q, x))/change
      root = root - change
      found = abs(change) <= 8.0_wp*epsilon(1.0_wp)*abs(root)
      if (found) exit
    end do
    shape_of = x(:n)/sqrt(real(dot_product(x(:n), matmul(turned%mass(:n, :n), x(:n)))))
  end subroutine follow_mode

  subroutine find_modes(n_dof, mass, damping, stiffness, modes, status)
    !> Number of coordinates that are no exponentials of memory; they are the first ones.
    integer, intent(in) :: n_dof
    !> Shape (n, n).
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :)
    type(rotor_modes), intent(inout) :: modes
    type(status_type), intent(out) :: status
    real(wp), dimension(size(mass, 1), size(mass, 1)) :: m, c, k, inverse
    real(wp) :: units(size(mass, 1)), rate
    real(wp), allocatable :: state(:, :), errors(:)
    complex(wp) :: full(size(mass, 1), size(mass, 1))
    complex(wp), allocatable :: values(:)
    integer, allocatable :: up(:)
    integer :: i, n
    logical :: bad, found

    call set_ok(status)
    n = size(mass, 1)
    modes%most = n
    units = [(sqrt(mass(i, i)), i=1, n)]
    do i = 1, n
      m(:, i) = mass(:, i)/units/units(i)
      c(:, i) = damping(:, i)/units/units(i)
      k(:, i) = stiffness(:, i)/units/units(i)
    end do
    call invert(cmplx(m, 0.0_wp, wp), full, bad)
    inverse = real(full)
    rate = sqrt(maxval(abs(k)))
    if (.not. rate > 0.0_wp) rate = 1.0_wp
    allocate (state(2*n, 2*n), source=0.0_wp)
    do i = 1, n
      state(i, n + i) = rate
    end do
    state(n + 1:, :n) = -matmul(inverse, k)/rate
    state(n + 1:, n + 1:) = -matmul(inverse, c)
    ! Only the velocities of exponentials have effects.
    up = [(i, i=1, n_dof), (i, i=n + 1, 2*n)]
    state = state(up, up)
    allocate (values(size(up)), errors(size(up)))
    if (.not. bad) bad = .not. maxval(abs(state)) <= huge(1.0_wp)
    found = .false.
    if (.not. bad) call eigenvalues(state, values, found)
    if (.not. found) then
      call fail(status, status_input_error, 'speed', 'speed = '//show(modes%speed)//': the modes ' &
                //'at this speed are not finite numbers: choose other units or speeds')
      return
    end if
    call eigenvalue_conditions(state, values, errors)
    errors = uncertain*maxval(sum(abs(state), 2))*errors
    modes%growth = maxval(real(values))
    modes%is_unstable = any(real(values) > errors)
    up = pack([(i, i=1, size(values))], aimag(values) > errors)
    up = up(order_of(aimag(values(up))))
    modes%roots = values(up)
    allocate (modes%alone(size(up)), modes%shapes(n_dof, size(up)))
    do i = 1, size(up)
      modes%alone(i) = count(abs(values - values(up(i))) <= together*abs(values(up(i)))) == 1
      call find_shape(m, c, k, modes%roots(i), modes%shapes(:, i))
      modes%shapes(:, i) = modes%shapes(:, i)/units(:n_dof)
    end do
  end subroutine find_modes

  !> A vector by inverse iteration.
  pure subroutine find_shape(m, c, k, root, shape_of)
    real(wp), intent(in) :: m(:, :), c(:, :), k(:, :)
    complex(wp), intent(in) :: root
    complex(wp), intent(out) :: shape_of(:)
    complex(wp) :: q(size(m, 1), size(m, 1)), x(size(m, 1))
    real(wp) :: weight
    logical :: singular
    integer :: i, n

    n = size(shape_of)
    q = m*root**2 + c*root + k
    ! Arbitrary, so that no mode is orthogonal to it.
    x = [(cmplx(cos(1.7_wp*i), sin(2.3_wp*i), wp), i=1, size(x))]
    do i = 1, 2
      call solve_complex(q, x, .true., singular)
      if (singular) exit
      x = x/maxval(abs(x))
    end do
    shape_of = x(:n)
    weight = real(dot_product(shape_of, matmul(m(:n, :n), shape_of)))
    if (weight > 0.0_wp) shape_of = shape_of/sqrt(weight)
  end subroutine find_shape

end module viscovib_rotor_modes
