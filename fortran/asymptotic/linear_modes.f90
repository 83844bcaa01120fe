! Optimize: -O2 -fvect-cost-model=dynamic
!> Modes of the linear part, damping and memory included: L(s) r = 0, l L(s) = 0.
!!
!! Iteration from the modes without damping and memory by two-sided Rayleigh quotients: s such
!! that l L(s) r = 0, then L(s) r_new = L'(s) r and likewise l (Ruhe, Algorithms
!! for the nonlinear eigenvalue problem, SIAM J. Numer. Anal. 10 (1973) 674).
!! Vectors that already solve the equations are not changed, so that modes of equal
!! frequencies keep the given shapes.
module viscovib_linear_modes
  use viscovib_dense, only: equilibrate, outer, solve_complex
  use viscovib_kinds, only: wp
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: find_modes

  integer, parameter :: max_rounds = 60, max_steps = 60
  real(wp), parameter :: rounding = 64.0_wp*epsilon(1.0_wp)

contains

  !> For each oscillating mode, the exponent with the positive imaginary part.
  subroutine find_modes(form, s, right, left, status)
    type(polynomial_form_type), intent(in) :: form
    !> Exponents, shape (n_modes).
    complex(wp), intent(out) :: s(:)
    !> A column each, shape (n, n_modes); the largest coordinate of r is 1.
    complex(wp), intent(out) :: right(:, :), left(:, :)
    type(status_type), intent(out) :: status
    integer :: j, k
    logical :: found

    do j = 1, form%n_modes()
      s(j) = cmplx(0.0_wp, form%omega(j), wp)
      right(:, j) = cmplx(form%right(:, j), 0.0_wp, wp)
      left(:, j) = cmplx(form%left(:, j), 0.0_wp, wp)
      call follow(form, s(j), right(:, j), left(:, j), found)
      if (.not. found) then
        call fail(status, status_input_error, 'system', 'mode '//show(j)//' near frequency ' &
                  //show(form%omega(j))//' does not oscillate: the method of multiple scales ' &
                  //'needs damping well below critical')
        return
      end if
      do k = 1, j - 1
        if (abs(s(j) - s(k)) > 1.0e-9_wp*abs(s(j))) cycle
        if (abs(form%omega(j) - form%omega(k)) <= 1.0e-9_wp*form%omega(j)) cycle
        call fail(status, status_input_error, 'system', 'modes '//show(k)//' and '//show(j) &
                  //' are indistinguishable with damping and memory')
        return
      end do
    end do
  end subroutine find_modes

  subroutine follow(form, s, r, l, found)
    type(polynomial_form_type), intent(in) :: form
    complex(wp), intent(inout) :: s, r(:), l(:)
    logical, intent(out) :: found
    complex(wp) :: matrix(form%n, form%n), slope(form%n, form%n), start
    real(wp) :: start_speed, rows(form%n), columns(form%n)
    integer :: round
    logical :: singular

    call find_units(form, abs(s), rows, columns)
    start = s
    start_speed = abs(s)
    call normalize(form%n_dof, r)
    do round = 1, max_rounds
      call rayleigh(form, r, l, s, found)
      if (.not. found) return
      ! In these units lengths and angles, and forces and moments, have similar sizes.
      matrix = form%operator_at(s)*outer(rows, columns)
      r = r/columns
      l = l/rows
      found = residual(matrix, r) <= rounding .and. residual(transpose(matrix), l) <= rounding
      if (found) then
        r = columns*r
        l = rows*l
        exit
      end if
      slope = form%operator_between(s, s)*outer(rows, columns)
      r = matmul(slope, r)
      call solve_complex(matrix, r, .true., singular)
      r = columns*r
      if (.not. singular) call normalize(form%n_dof, r)
      l = matmul(transpose(slope), l)
      if (.not. singular) call solve_complex(transpose(matrix), l, .true., singular)
      l = rows*l
      found = .not. singular .and. all(abs(r) <= huge(1.0_wp)) .and. all(abs(l) <= huge(1.0_wp))
      if (.not. found) return
      l = l/maxval(abs(l))
    end do
    ! A mode with a negligible imaginary part does not oscillate.
    found = found .and. aimag(s) > 0.1_wp*abs(s) .and. aimag(s) > 1.0e-3_wp*start_speed
  end subroutine follow

  !> Units of equations and unknowns, from the magnitudes of the terms of L.
  pure subroutine find_units(form, speed, rows, columns)
    type(polynomial_form_type), intent(in) :: form
    !> Size of the exponent.
    real(wp), intent(in) :: speed
    real(wp), intent(out) :: rows(:), columns(:)
    call equilibrate(abs(form%linear(:, :, 0)) + abs(form%hereditary) &
                     + speed*(abs(form%linear(:, :, 1)) + speed*abs(form%linear(:, :, 2))), &
                     rows, columns)
  end subroutine find_units

  !> |A x| divided by the sum of the moduli of its terms.
  pure real(wp) function residual(a, x)
    complex(wp), intent(in) :: a(:, :), x(:)
    real(wp) :: largest, scale
    integer :: i
    largest = 0.0_wp
    scale = tiny(1.0_wp)
    do i = 1, size(x)
      largest = max(largest, abs(sum(a(i, :)*x)))
      scale = max(scale, sum(abs(a(i, :))*abs(x)))
    end do
    residual = largest/scale
  end function residual

  !> Scale the largest coordinate to 1.
  pure subroutine normalize(n_dof, r)
    integer, intent(in) :: n_dof
    complex(wp), intent(inout) :: r(:)
    complex(wp) :: largest
    largest = r(maxloc(abs(r(:n_dof)), 1))
    if (abs(largest) > 0.0_wp) r = r/largest
  end subroutine normalize

  !> Solve l L(s) r = 0 for s by Newton's method.
  subroutine rayleigh(form, r, l, s, found)
    type(polynomial_form_type), intent(in) :: form
    complex(wp), intent(in) :: r(:), l(:)
    complex(wp), intent(inout) :: s
    logical, intent(out) :: found
    complex(wp) :: value, slope, step
    integer :: i

    found = .false.
    do i = 1, max_steps
      value = sum(l*matmul(form%operator_at(s), r))
      slope = sum(l*matmul(form%operator_between(s, s), r))
      if (.not. abs(slope) > 0.0_wp) return
      step = value/slope
      if (abs(step) > 0.3_wp*abs(s)) step = step*(0.3_wp*abs(s)/abs(step))
      s = s - step
      if (.not. abs(s) <= huge(1.0_wp)) return
      found = abs(step) <= rounding*abs(s)
      if (found) exit
    end do
    ! The last steps may stagnate at rounding errors: the caller checks the residual.
    found = aimag(s) > 0.0_wp
  end subroutine rayleigh

end module viscovib_linear_modes
