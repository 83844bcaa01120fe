!> A polynomial form about the equilibrium under its constant loads.
!!
!! With y = y_0 + u and A_0 y_0 + N_2(y_0) + N_3(y_0) = load_0 the equations for u have no constant
!! load, and terms of the same degrees: dN/dx is added to A_k, and the second derivatives of N_3 to
!! N_2. So a constant load may have any size, whereas loads in the expansion must be small.
!! The load is increased in steps. Newton's method computes y_0 and the modes at each step.
module viscovib_rest_position
  use viscovib_dense, only: factorize, solve
  use viscovib_kinds, only: wp
  use viscovib_linear_modes, only: find_modes
  use viscovib_polynomial_form, only: polynomial_form_type, term_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: move_to_rest

  integer, parameter :: n_steps = 16, max_rounds = 30
  real(wp), parameter :: rounding = 8.0_wp*epsilon(1.0_wp)

contains

  !> Only for forms without memory, with constant loads on coordinates.
  subroutine move_to_rest(form, rest, status)
    type(polynomial_form_type), intent(inout) :: form
    !> y_0, shape (n).
    real(wp), allocatable, intent(out) :: rest(:)
    type(status_type), intent(out) :: status
    type(polynomial_form_type) :: here
    real(wp) :: load(form%n)
    integer :: k, step
    logical :: found

    call set_ok(status)
    allocate (rest(form%n), source=0.0_wp)
    if (form%has_memory()) return
    load = 0.0_wp
    do k = 1, size(form%drives)
      if (form%drives(k) > 0.0_wp .or. any(abs(form%load(form%n_dof + 1:, k)) > 0.0_wp)) cycle
      load = load + form%load(:, k)
      form%load(:, k) = 0.0_wp
    end do
    if (.not. any(abs(load) > 0.0_wp)) return
    ! The modes of the equilibrium are computed without damping.
    call form%copy_to(here)
    do step = 1, n_steps
      call find_rest(form, load*step/n_steps, rest, found)
      if (found) call expand_about(form, rest, here)
      if (found) call follow_modes(here, found)
      if (found) cycle
      call fail(status, status_input_error, 'load', 'constant load: the position of rest is lost ' &
                //'at '//show(real(step, wp)/n_steps)//' of it; must be one that positions ' &
                //'of rest lead to from 0 on')
      return
    end do
    call here%copy_to(form)
  end subroutine move_to_rest

  subroutine find_rest(form, load, y, found)
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: load(:)
    real(wp), intent(inout) :: y(:)
    logical, intent(out) :: found
    real(wp) :: matrix(form%n, form%n), x(form%n), sides(form%n)
    integer :: pivots(form%n), round
    logical :: singular

    found = .false.
    do round = 1, max_rounds
      call sides_at(form, y, sides, matrix)
      x = load - sides
      call factorize(form%n, matrix, pivots, singular)
      if (singular) return
      call solve(form%n, matrix, pivots, x)
      y = y + x
      if (.not. all(abs(y) <= huge(1.0_wp))) return
      found = maxval(abs(x)) <= rounding*maxval(abs(y))
      if (found) return
    end do
  end subroutine find_rest

  !> Left side at the equilibrium y, and its derivative.
  pure subroutine sides_at(form, y, sides, slope)
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: y(:)
    real(wp), intent(out) :: sides(:), slope(:, :)
    real(wp) :: x(form%n_arguments), rest(3)
    type(term_type) :: t
    integer :: i, q, n, column

    x = at_rest(form, y)
    slope = form%linear(:, :, 0) + form%hereditary
    sides = matmul(slope, y)
    do n = 2, 3
      do i = 1, merge(size(form%quadratic), size(form%cubic), n == 2)
        t = term_of(form, n, i)
        sides(t%row) = sides(t%row) + t%coefficient*product(x(t%at(:n)))
        do q = 1, n
          if (form%derivative(t%at(q)) > 0) cycle
          rest(:n) = x(t%at(:n))
          rest(q) = 1.0_wp
          column = form%source(t%at(q))
          slope(t%row, column) = slope(t%row, column) + t%coefficient*product(rest(:n))
        end do
      end do
    end do
  end subroutine sides_at

  pure function term_of(form, n, i) result(t)
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: n, i
    type(term_type) :: t
    if (n == 2) then
      t = form%quadratic(i)
    else
      t = form%cubic(i)
    end if
  end function term_of

  !> Arguments for constant unknowns y.
  pure function at_rest(form, y) result(x)
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: y(:)
    real(wp) :: x(form%n_arguments)
    x = merge(y(form%source), 0.0_wp, form%derivative == 0)
  end function at_rest

  !> Expand the terms about y, in u = y - y_0; the modes are not changed.
  subroutine expand_about(form, y, here)
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: y(:)
    type(polynomial_form_type), intent(inout) :: here
    real(wp) :: x(form%n_arguments), factor
    type(term_type) :: t
    integer :: i, n, q, other(2)

    x = at_rest(form, y)
    here%linear = form%linear
    here%quadratic = form%quadratic
    here%cubic = form%cubic
    do n = 2, 3
      do i = 1, merge(size(form%quadratic), size(form%cubic), n == 2)
        t = term_of(form, n, i)
        do q = 1, n
          ! Factor q varies, the other factors are constant.
          other(:n - 1) = pack(t%at, [1, 2, 3] /= q .and. [1, 2, 3] <= n)
          factor = t%coefficient*product(x(other(:n - 1)))
          if (.not. abs(factor) > 0.0_wp) cycle
          associate (a => here%linear(t%row, form%source(t%at(q)), form%derivative(t%at(q))))
            a = a + factor
          end associate
        end do
        if (n == 2) cycle
        do q = 1, n
          ! Factor q is constant.
          factor = t%coefficient*x(t%at(q))
          if (.not. abs(factor) > 0.0_wp) cycle
          other = pack(t%at, [1, 2, 3] /= q)
          here%quadratic = [here%quadratic, term_type(t%row, [other, 0], factor)]
        end do
      end do
    end do
  end subroutine expand_about

  !> Update omega, r and l without damping, starting from the present values.
  subroutine follow_modes(form, found)
    type(polynomial_form_type), intent(inout) :: form
    logical, intent(out) :: found
    type(polynomial_form_type) :: free
    type(status_type) :: status
    complex(wp), dimension(form%n, form%n_modes()) :: right, left
    complex(wp) :: s(form%n_modes())

    call form%copy_to(free)
    free%linear(:, :, 1) = 0.0_wp
    call find_modes(free, s, right, left, status)
    found = .not. status%failed()
    if (.not. found) return
    form%omega = aimag(s)
    form%right = real(right)
    form%left = real(left)
  end subroutine follow_modes

end module viscovib_rest_position
