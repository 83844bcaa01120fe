!> The mount up to third-degree terms, with its hereditary variables among the unknowns:
!!
!!   M u'' + C u' + F(u, v) = load,      v_j - (1 - R_j*) w_j(u) = 0.
!!
!! Memory acts on every term as in the original equations (docs/explanation).
module viscovib_mount_form
  use viscovib_full_oscillator, only: put_behind
  use viscovib_jet, only: jet_type, operator(-), variables
  use viscovib_jet_form, only: take_terms
  use viscovib_kernel_holder, only: copy_kernels
  use viscovib_kinds, only: wp
  use viscovib_mount, only: mount_type
  use viscovib_polynomial_form, only: polynomial_form_type
  implicit none
  private

  public :: new_mount_form

contains

  subroutine new_mount_form(form, mount, load, nu)
    type(polynomial_form_type), intent(out) :: form
    type(mount_type), intent(in) :: mount
    !> Force on x (N) and moment on phi (N m), times cos(nu t); nu (rad/s).
    real(wp), intent(in) :: load(2), nu
    type(jet_type) :: x(2 + mount%n_memory()), w(mount%n_memory())
    type(jet_type) :: equations(2 + mount%n_memory())
    real(wp) :: omega(2), shapes(2, 2)
    integer :: i, m

    m = mount%n_memory()
    form%n = 2 + m
    form%n_dof = 2
    form%n_arguments = form%n
    form%source = [(i, i=1, form%n)]
    form%derivative = [(0, i=1, form%n)]
    form%kernel_of = [0, 0, mount%kernel_of]
    call copy_kernels(mount%kernels, form%kernels)
    x = variables(form%n)
    call mount%jets(x(:2), x(3:), w, equations(:2))
    do i = 1, m
      equations(2 + i) = -w(i)
    end do
    call take_terms(form, equations)
    form%linear(:2, :2, 1) = mount%damping
    form%linear(:2, :2, 2) = mount%mass
    do i = 3, form%n
      form%linear(i, i, 0) = form%linear(i, i, 0) + 1.0_wp
    end do
    allocate (form%load(form%n, 1), source=0.0_wp)
    form%load(:2, 1) = load
    form%drives = [nu]
    call mount%natural_modes(omega, shapes)
    form%omega = omega
    allocate (form%right(form%n, 2), form%left(form%n, 2))
    form%right(:2, :) = shapes
    form%right(3:, :) = matmul(mount%gather, shapes)
    form%left(:2, :) = shapes
    form%left(3:, :) = -matmul(transpose(mount%spread), shapes)
    call put_behind(form, mount)
  end subroutine new_mount_form

end module viscovib_mount_form
