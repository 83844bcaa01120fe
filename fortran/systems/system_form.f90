!> Polynomial form of a system (`viscovib_polynomial`) up to third-degree terms, with hereditary
!! variables among the unknowns, as in `new_mount_form`.
module viscovib_system_form
  use viscovib_full_oscillator, only: put_behind
  use viscovib_jet, only: jet_type, operator(-), variables
  use viscovib_jet_form, only: take_terms
  use viscovib_kernel_holder, only: copy_kernels
  use viscovib_kinds, only: wp
  use viscovib_mount, only: mount_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_form, only: polynomial_form_type, term_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_symmetric_modes, only: find_symmetric_modes
  implicit none
  private

  public :: new_oscillator_form

contains

  !> Form of a mount or a polynomial system with one load.
  subroutine new_oscillator_form(form, oscillator, load, nu, status)
    type(polynomial_form_type), intent(out) :: form
    class(oscillator_type), intent(in) :: oscillator
    !> Forces on the coordinates times cos(nu t), shape (n_dof); nu (rad/s).
    real(wp), intent(in) :: load(:), nu
    type(status_type), intent(out) :: status
    integer :: i
    ! Products of a few frequencies must neither vanish nor overflow.
    real(wp), parameter :: slowest = 1.0e-60_wp, fastest = 1.0e60_wp

    call set_ok(status)
    select type (oscillator)
    type is (mount_type)
      call new_mount_form(form, oscillator, load, nu)
    type is (polynomial_type)
      if (size(oscillator%laws) > 0) then
        call fail(status, status_input_error, 'system', 'system: has a force that is no ' &
                  //'polynomial, multiple scales take polynomials only')
        return
      end if
      call new_system_form(form, oscillator, load, nu, status)
    end select
    if (status%failed()) return
    do i = 1, size(form%omega)
      if (form%omega(i) >= slowest .and. form%omega(i) <= fastest &
          .and. all(abs(form%right(:, i)) <= huge(1.0_wp)) &
          .and. all(abs(form%left(:, i)) <= huge(1.0_wp))) cycle
      call fail(status, status_input_error, 'system', 'mode '//show(i)//': its frequency ' &
                //show(form%omega(i))//' must be '//show(slowest)//' to '//show(fastest) &
                //' and its shape finite: take other units')
      return
    end do
  end subroutine new_oscillator_form

  subroutine new_system_form(form, system, load, nu, status)
    type(polynomial_form_type), intent(out) :: form
    type(polynomial_type), intent(in) :: system
    real(wp), intent(in) :: load(:), nu
    type(status_type), intent(out) :: status
    real(wp), allocatable :: squares(:), shapes(:, :), rest(:, :)
    integer :: i, n, m

    call set_ok(status)
    n = system%n_dof()
    m = system%n_memory()
    rest = system%stiffness_at_rest()
    if (any(abs(rest - transpose(rest)) > 1.0e-12_wp*maxval(abs(rest)))) then
      call fail(status, status_input_error, 'stiffness', 'stiffness: must be symmetric for ' &
                //'multiple scales, the sum over all springs')
      return
    end if
    allocate (squares(n), shapes(n, n))
    call find_symmetric_modes(system%mass, rest, squares, shapes)
    if (.not. all(squares > 0.0_wp)) then
      call fail(status, status_input_error, 'stiffness', 'stiffness: M^-1 K has the eigenvalue ' &
                //show(minval(squares))//', all must be greater than 0 for multiple scales')
      return
    end if
    form%n = n + m
    form%n_dof = n
    form%n_arguments = form%n
    form%source = [(i, i=1, form%n)]
    form%derivative = [(0, i=1, form%n)]
    allocate (form%kernel_of(form%n), source=0)
    form%kernel_of(n + 1:) = system%kernel_of
    call copy_kernels(system%kernels, form%kernels)
    allocate (form%linear(form%n, form%n, 0:2), form%hereditary(form%n, form%n), source=0.0_wp)
    form%linear(:n, :n, 1) = system%damping
    form%linear(:n, :n, 2) = system%mass
    form%linear(:n, n + 1:, 0) = system%spread
    do i = 1, m
      form%linear(n + i, n + i, 0) = 1.0_wp
      if (system%kernel_of(i) > 0) then
        form%hereditary(n + i, :n) = -system%gather(i, :)
      else
        form%linear(n + i, :n, 0) = -system%gather(i, :)
      end if
    end do
    call take_monomials(form, system, n)
    allocate (form%load(form%n, 1), source=0.0_wp)
    form%load(:n, 1) = load
    form%drives = [nu]
    form%omega = sqrt(squares)
    allocate (form%right(form%n, n), form%left(form%n, n))
    form%right(:n, :) = shapes
    form%right(n + 1:, :) = matmul(system%gather, shapes)
    form%left(:n, :) = shapes
    form%left(n + 1:, :) = -matmul(transpose(system%spread), shapes)
    call put_behind(form, system)
  end subroutine new_system_form

  !> Copy monomials of degree 2 and 3. Higher degrees are only in the full system.
  subroutine take_monomials(form, system, n)
    type(polynomial_form_type), intent(inout) :: form
    type(polynomial_type), intent(in) :: system
    integer, intent(in) :: n
    type(term_type) :: terms(size(system%monomials))
    integer :: degree(size(system%monomials)), i, j, k

    degree = 0
    do i = 1, size(system%monomials)
      associate (m => system%monomials(i))
        if (sum(m%power) > 3) cycle
        terms(i)%row = n + m%variable
        terms(i)%coefficient = -m%coefficient
        do j = 1, size(m%dof)
          do k = 1, m%power(j)
            degree(i) = degree(i) + 1
            terms(i)%at(degree(i)) = m%dof(j)
          end do
        end do
      end associate
    end do
    form%quadratic = pack(terms, degree == 2)
    form%cubic = pack(terms, degree == 3)
  end subroutine take_monomials

  ! The mount up to third-degree terms, with its hereditary variables among the unknowns:
  !
  !   M u'' + C u' + F(u, v) = load,      v_j - (1 - R_j*) w_j(u) = 0.
  !
  ! Memory acts on every term as in the original equations (docs/explanation).

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

end module viscovib_system_form
