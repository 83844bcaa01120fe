! Optimize: -O2
!> The spring pendulum up to third-degree terms in (q, q', q''), by exact differentiation of its
!! equations in the form with separate loads:
!!
!!   z'' + e S psi'' - ... = f0 cos(p1 t),
!!   Q phi'' + e G psi'' - ... = m01 cos(p2 t),
!!   psi'' + r (S z'' + H phi'') - ... = m02 cos(p3 t)
!!
!! (docs/explanation; notation of `viscovib_pendulum_equations`).
!!
!! With the weak-coupling ordering e is of the order of the amplitude. It is multiplied by a fourth
!! unknown that a constant load keeps at 1, so every power of e adds a degree. The linear part has
!! e = 0 (z and phi uncoupled, psi driven by phi); frequency shifts are correct to e^2. Terms of
!! fourth order are dropped: e times cubic, e^2 times quadratic and e^3 times linear terms.
module viscovib_pendulum_form
  use viscovib_jet, only: constant_jet, cosine, jet_type, operator(*), operator(+), &
    operator(-), sine, variables
  use viscovib_jet_form, only: take_terms
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_pendulum, only: equations_printed, pendulum_type
  use viscovib_polynomial_form, only: full_system_type, polynomial_form_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: new_pendulum_form, put_pendulum_behind

  integer, parameter, public :: ordering_general = 1, ordering_weak = 2
  character(len=*), parameter, public :: ordering_names(2) = &
    [character(len=13) :: 'general', 'weak_coupling']

  !> The full pendulum: M(q) (q'' - a(q, q', t)), which for the `exact` equations equals their left
  !! sides minus loads.
  type, extends(full_system_type) :: full_pendulum_type
    type(pendulum_type) :: pendulum
  contains
    procedure :: sides
  end type full_pendulum_type

contains

  !> Polynomial form of the exact or the printed (cubic) equations.
  subroutine new_pendulum_form(form, pendulum, ordering, status)
    type(polynomial_form_type), intent(out) :: form
    type(pendulum_type), intent(in) :: pendulum
    !> Index in `ordering_names`.
    integer, intent(in) :: ordering
    type(status_type), intent(out) :: status
    type(pendulum_type) :: linear
    type(jet_type) :: x(9 + ordering - ordering_general), equations(3 + ordering - ordering_general)
    type(jet_type) :: e
    real(wp) :: omega(3), shapes(3, 3)
    logical :: weak
    integer :: i

    weak = ordering == ordering_weak
    linear = pendulum
    if (weak) linear%parameters%e = 0.0_wp
    associate (p => linear%parameters)
      if (.not. p%e > 0.0_wp .and. abs(p%w2 - p%w3) <= 1.0e-8_wp*p%w2) then
        call fail(status, status_input_error, 'w3', 'w3 = '//show(p%w3)//': must differ from ' &
                  //'w2 where e = 0 or coupling is weak: phi and psi have one mode between them, ' &
                  //'and psi grows without bound')
        return
      end if
    end associate
    x = variables(size(x))
    e = constant_jet(pendulum%parameters%e, size(x))
    if (weak) e = pendulum%parameters%e*x(10)
    equations(:3) = sides_of(pendulum, e, x(1:3), x(4:6), x(7:9))
    if (weak) equations(4) = x(10)
    form%n = size(equations)
    form%n_dof = 3
    form%n_arguments = size(x)
    form%source = [1, 2, 3, 1, 2, 3, 1, 2, 3, (4, i=10, size(x))]
    form%derivative = [0, 0, 0, 1, 1, 1, 2, 2, 2, (0, i=10, size(x))]
    allocate (form%kernel_of(form%n), source=0)
    allocate (form%kernels(0))
    call take_terms(form, equations)
    allocate (form%load(form%n, form%n), source=0.0_wp)
    do i = 1, 3
      form%load(i, i) = pendulum%parameters%load(i)
    end do
    if (weak) form%load(4, 4) = 1.0_wp
    form%drives = [pendulum%drives, (0.0_wp, i=4, form%n)]
    call linear%natural_modes(omega, shapes)
    form%omega = omega
    allocate (form%right(form%n, 3), form%left(form%n, 3), source=0.0_wp)
    form%right(:3, :) = shapes
    if (linear%parameters%e > 0.0_wp) then
      ! The third equation times e/r makes mass and stiffness symmetric.
      form%left(:3, :) = shapes
      form%left(3, :) = shapes(3, :)*pendulum%parameters%e/pendulum%r
    else
      call uncoupled(pendulum%r, form)
    end if
    call put_pendulum_behind(form, pendulum)
  end subroutine new_pendulum_form

  subroutine put_pendulum_behind(form, pendulum)
    type(polynomial_form_type), intent(inout) :: form
    type(pendulum_type), intent(in) :: pendulum
    type(full_pendulum_type), allocatable :: full
    allocate (full)
    full%pendulum = pendulum
    call move_alloc(full, form%full)
  end subroutine put_pendulum_behind

  subroutine sides(self, y, load, e)
    class(full_pendulum_type), intent(in) :: self
    real(wp), intent(in), contiguous :: y(:, :, 0:), load(:, :)
    real(wp), intent(out), contiguous :: e(:, :)
    real(wp), dimension(n_lanes, 3) :: q, v, drive, a
    real(wp), dimension(n_lanes) :: s, c, length
    integer :: at, n, i

    ! Weak coupling: the unknown with the value 1.
    if (size(e, 2) > 3) e(:, 4) = y(:, 4, 0) - load(:, 4)
    do at = 1, size(y, 1), n_lanes
      n = min(n_lanes, size(y, 1) - at + 1)
      ! Unused vector lanes are at rest.
      q = 0.0_wp
      v = 0.0_wp
      drive = 0.0_wp
      q(:n, :) = y(at:at + n - 1, :3, 0)
      v(:n, :) = y(at:at + n - 1, :3, 1)
      drive(:n, :) = load(at:at + n - 1, :3)
      call self%pendulum%acceleration(q, v, drive, a)
      do i = 1, 3
        a(:n, i) = y(at:at + n - 1, i, 2) - a(:n, i)
      end do
      s = sin(q(:, 2) - q(:, 3))
      c = cos(q(:, 2) - q(:, 3))
      length = 1.0_wp + q(:, 1)
      associate (p => self%pendulum%parameters, r => self%pendulum%r, last => at + n - 1)
        e(at:last, 1) = a(:n, 1) + p%e*s(:n)*a(:n, 3)
        e(at:last, 2) = length(:n)*(length(:n)*a(:n, 2) + p%e*c(:n)*a(:n, 3))
        e(at:last, 3) = a(:n, 3) + r*(s(:n)*a(:n, 1) + length(:n)*c(:n)*a(:n, 2))
      end associate
    end do
  end subroutine sides

  !> Left vectors for e = 0: phi drives psi but not the reverse, so the mass matrix is triangular
  !! and the left vectors are those of its transpose.
  subroutine uncoupled(r, form)
    real(wp), intent(in) :: r
    type(polynomial_form_type), intent(inout) :: form
    real(wp) :: a, b
    integer :: j
    form%left(1, 1) = 1.0_wp
    a = form%linear(2, 2, 0)
    b = form%linear(3, 3, 0)
    do j = 2, 3
      associate (square => form%omega(j)**2)
        if (abs(square - a) <= abs(square - b)) then
          form%left(2, j) = 1.0_wp
        else
          form%left(3, j) = 1.0_wp
          form%left(2, j) = r*square/(a - square)
        end if
      end associate
    end do
  end subroutine uncoupled

  !> The exact equations, or the printed ones.
  function sides_of(pendulum, e, q, v, a) result(equations)
    type(pendulum_type), intent(in) :: pendulum
    type(jet_type), intent(in) :: e, q(3), v(3), a(3)
    type(jet_type) :: equations(3), s, c, length, swing

    s = sine(q(2) - q(3))
    c = cosine(q(2) - q(3))
    length = 1.0_wp + q(1)
    associate (p => pendulum%parameters, r => pendulum%r)
      equations(1) = a(1) + e*(s*a(3) - c*(v(3)*v(3))) + spring(pendulum, q(1), v(1)) &
                     - length*(v(2)*v(2)) - p%w2**2*(cosine(q(2)) - 1.0_wp)
      if (p%equations == equations_printed) then
        equations(2) = length*(length*a(2) + e*(s*(v(3)*v(3)) + c*v(3)) + p%w2**2*sine(q(2))) &
                       + 2.0_wp*(q(1)*(v(1)*v(2))) + p%damping(2)*v(2)
        swing = c*a(2) - length*(s*(v(2)*v(2)))
      else
        equations(2) = length*(length*a(2) + e*(c*a(3) + s*(v(3)*v(3))) + p%w2**2*sine(q(2)) &
                               + 2.0_wp*(v(1)*v(2))) + p%damping(2)*v(2)
        swing = length*(c*a(2) - s*(v(2)*v(2)))
      end if
      equations(3) = a(3) + r*(s*a(1) + swing + 2.0_wp*(c*(v(1)*v(2)))) + p%w3**2*sine(q(3)) &
                     + p%damping(3)*v(3)
    end associate
  end function sides_of

  !> Spring and damper: c1 z' + (1 + 3 al z_r^2) z + 3 al z_r z^2 + al z^3.
  function spring(pendulum, z, v) result(force)
    type(pendulum_type), intent(in) :: pendulum
    type(jet_type), intent(in) :: z, v
    type(jet_type) :: force
    associate (p => pendulum%parameters)
      force = p%damping(1)*v + pendulum%stiffness*z &
              + z*z*((3.0_wp*p%alpha*pendulum%z_r) + p%alpha*z)
    end associate
  end function spring

end module viscovib_pendulum_form
