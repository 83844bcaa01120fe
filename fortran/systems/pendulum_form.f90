!> The spring pendulum up to third-degree terms in (q, q', q''), by exact
!! differentiation of its equations in the form that has the loads by themselves:
!!
!!   z'' + e S psi'' - ... = f0 cos(p1 t),
!!   Q phi'' + e G psi'' - ... = m01 cos(p2 t),
!!   psi'' + r (S z'' + H phi'') - ... = m02 cos(p3 t)
!!
!! (docs/theory.md; the letters as in `viscovib_pendulum_equations`).
module viscovib_pendulum_form
  use viscovib_jet, only: cosine, jet_type, operator(*), operator(+), operator(-), sine, variables
  use viscovib_jet_form, only: take_terms
  use viscovib_kinds, only: wp
  use viscovib_pendulum, only: equations_printed, pendulum_type
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: new_pendulum_form

contains

  !> The exact equations and the cubic ones have the same form.
  subroutine new_pendulum_form(form, pendulum, status)
    type(polynomial_form_type), intent(out) :: form
    type(pendulum_type), intent(in) :: pendulum
    type(status_type), intent(out) :: status
    type(jet_type) :: x(9), equations(3)
    real(wp) :: omega(3), shapes(3, 3)
    integer :: i

    associate (p => pendulum%parameters)
      if (.not. p%e > 0.0_wp .and. abs(p%w2 - p%w3) <= 1.0e-8_wp*p%w2) then
        call fail(status, status_input_error, 'w3', 'w3 = '//show(p%w3)//': must differ from ' &
                  //'w2 where e = 0: phi and psi have one mode between them, and psi grows ' &
                  //'without bound')
        return
      end if
    end associate
    x = variables(9)
    if (pendulum%parameters%equations == equations_printed) then
      equations = printed(pendulum, x(1:3), x(4:6), x(7:9))
    else
      equations = exact(pendulum, x(1:3), x(4:6), x(7:9))
    end if
    form%n = 3
    form%n_dof = 3
    form%n_arguments = 9
    form%source = [1, 2, 3, 1, 2, 3, 1, 2, 3]
    form%derivative = [0, 0, 0, 1, 1, 1, 2, 2, 2]
    form%kernel_of = [0, 0, 0]
    allocate (form%kernels(0))
    call take_terms(form, equations)
    allocate (form%load(3, 3), source=0.0_wp)
    do i = 1, 3
      form%load(i, i) = pendulum%parameters%load(i)
    end do
    form%drives = pendulum%drives
    call pendulum%natural_modes(omega, shapes)
    form%omega = omega
    form%right = shapes
    ! The third equation times e/r makes mass and stiffness symmetric.
    form%left = shapes
    form%left(3, :) = shapes(3, :)*pendulum%parameters%e/pendulum%r
    if (.not. pendulum%parameters%e > 0.0_wp) call uncoupled(pendulum%r, form)
  end subroutine new_pendulum_form

  !> Without e the body follows phi, but phi not the body: the mass matrix is a
  !! triangle, and the left vectors are those of its transpose.
  subroutine uncoupled(r, form)
    real(wp), intent(in) :: r
    type(polynomial_form_type), intent(inout) :: form
    real(wp) :: a, b
    integer :: j
    form%left = 0.0_wp
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

  function exact(pendulum, q, v, a) result(equations)
    type(pendulum_type), intent(in) :: pendulum
    type(jet_type), intent(in) :: q(3), v(3), a(3)
    type(jet_type) :: equations(3), s, c, length

    s = sine(q(2) - q(3))
    c = cosine(q(2) - q(3))
    length = 1.0_wp + q(1)
    associate (p => pendulum%parameters, r => pendulum%r)
      equations(1) = a(1) + p%e*(s*a(3) - c*(v(3)*v(3))) + spring(pendulum, q(1), v(1)) &
                     - length*(v(2)*v(2)) - p%w2**2*(cosine(q(2)) - 1.0_wp)
      equations(2) = length*(length*a(2) + p%e*(c*a(3) + s*(v(3)*v(3))) + p%w2**2*sine(q(2)) &
                             + 2.0_wp*(v(1)*v(2))) + p%damping(2)*v(2)
      equations(3) = a(3) + r*(s*a(1) + length*(c*a(2) - s*(v(2)*v(2))) &
                               + 2.0_wp*(c*(v(1)*v(2)))) &
                     + p%w3**2*sine(q(3)) + p%damping(3)*v(3)
    end associate
  end function exact

  function printed(pendulum, q, v, a) result(equations)
    type(pendulum_type), intent(in) :: pendulum
    type(jet_type), intent(in) :: q(3), v(3), a(3)
    type(jet_type) :: equations(3), s, c, length

    s = sine(q(2) - q(3))
    c = cosine(q(2) - q(3))
    length = 1.0_wp + q(1)
    associate (p => pendulum%parameters, r => pendulum%r)
      equations(1) = a(1) + p%e*(s*a(3) - c*(v(3)*v(3))) + spring(pendulum, q(1), v(1)) &
                     - length*(v(2)*v(2)) - p%w2**2*(cosine(q(2)) - 1.0_wp)
      equations(2) = length*(length*a(2) + p%e*(s*(v(3)*v(3)) + c*v(3)) + p%w2**2*sine(q(2))) &
                     + 2.0_wp*(q(1)*(v(1)*v(2))) + p%damping(2)*v(2)
      equations(3) = a(3) + r*(s*a(1) + c*a(2) - length*(s*(v(2)*v(2))) &
                               + 2.0_wp*(c*(v(1)*v(2)))) &
                     + p%w3**2*sine(q(3)) + p%damping(3)*v(3)
    end associate
  end function printed

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
