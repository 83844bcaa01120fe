! Optimize: -O3 -fstack-arrays
!> The method of multiple scales to third order, as a normal form.
!!
!! The motion is a polynomial in generators Y_a: an amplitude Y_j for each mode, with
!! Y_j' = s_j Y_j + ..., a wave exp(i p t) for each load far from the modes, and the
!! conjugates of all,
!!
!!   y = sum_a r_a Y_a + sum_ab U_ab Y_a Y_b + sum_abc U_abc Y_a Y_b Y_c,
!!   Y_j' = s_j Y_j + sum_ab g_j,ab Y_a Y_b + sum_abc g_j,abc Y_a Y_b Y_c + sum_k g_jk exp(i p_k t).
!!
!! A product M of generators has the exponent s_M, the sum of their exponents. Substitution into
!! the equations of `viscovib_polynomial_form` gives a linear equation for each product,
!!
!!   L(s_M) U_M + sum_j g_jM L[s_M, s_j] r_j = R_M,      l_j L[s_M, s_j] U_M = 0,
!!
!! where j runs over the modes that resonate with M; L[s, t] is the divided difference. R_M is the
!! load or the contribution of lower orders: -N_2, -2 N_2 and -N_3, and the effect of slow changes
!! of second order on products of second order. Damping and memory are contained in s_j and L:
!! their linear effects are exact.
!!
!! Resonant terms are selected by their effect (`viscovib_normal_products`) or, with a tolerance,
!! by frequencies that differ by less than this fraction of the highest of them.
!!
!! There are three kinds of exponents. Free motion: with decay. A mode that a load keeps in motion:
!! i times the frequencies. Steady motion in a frame W: i W_j. This is exact since the amplitudes
!! are constant there; for the same reason there are no slow changes. A load that resonates with a
!! mode contributes g_jk to its rate of change and the remaining response u_k to y; u_k is a factor
!! of products if it is not small compared with the motion of the mode.
!!
!! Sources: Nayfeh, Introduction to perturbation techniques, 1981, chapters 7, 15 (scales);
!! Touze, Vizzaccaro, Thomas, Nonlinear Dyn. 105 (2021) 1141, equations (44)-(60) (normal forms
!! with the same bordered equations). With one time scale for each degree these are Nayfeh's.
module viscovib_normal_form
  use viscovib_kinds, only: wp
  use viscovib_linear_modes, only: find_modes
  use viscovib_normal_orders, only: second_order, second_sides, start_third, third_order
  use viscovib_normal_products, only: candidate_type, default_band, max_modes, normal_form_type, &
    reach_type, renew
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_resonant_terms, only: choose_loads, choose_products, frame_choice_type, &
    new_frame_choice
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: new_normal_form

  integer, parameter, public :: max_loads = 6
  !> Instead of a tolerance: select resonant terms by their effect.
  real(wp), parameter, public :: by_influence = -huge(1.0_wp)
  !> u_k is a factor of products if it exceeds this fraction of the mode's motion.
  real(wp), parameter :: least_rest = 0.1_wp

contains

  subroutine new_normal_form(normal, form, tolerance, steady, status, reach, sizes, with_far)
    !> Its arrays are kept if their shapes are the same.
    type(normal_form_type), intent(inout) :: normal
    type(polynomial_form_type), intent(in) :: form
    !> In [0, 1), or `by_influence`.
    real(wp), intent(in) :: tolerance
    !> Assume steady motion, even if no load is near a mode.
    logical, intent(in) :: steady
    type(status_type), intent(out) :: status
    !> With `by_influence`: choose for steady motion in one frame.
    type(reach_type), intent(in), optional :: reach
    !> With `by_influence`: expected amplitudes, shape (n_modes); the response to loads alone is
    !! added to them.
    real(wp), intent(in), optional :: sizes(:)
    !> Include terms far from the modes, for the growth that they cause of modes without `sizes`.
    logical, intent(in), optional :: with_far
    type(frame_choice_type) :: choice
    complex(wp) :: s(form%n_modes()), right(form%n, form%n_modes()), left(form%n, form%n_modes())
    real(wp) :: expected(form%n_modes())
    integer :: i, j, n

    if (.not. (tolerance >= 0.0_wp .and. tolerance < 1.0_wp) .and. tolerance > by_influence) then
      call fail(status, status_input_error, 'tolerance', 'tolerance = '//show(tolerance) &
                //': must be in [0, 1)')
      return
    end if
    n = form%n_modes()
    if (n > max_modes .or. size(form%drives) > max_loads) then
      call fail(status, status_input_error, 'system', 'system: has '//show(n)//' modes and ' &
                //show(size(form%drives))//' loads: at most '//show(max_modes)//' and ' &
                //show(max_loads)//' are allowed')
      return
    end if
    if (has_modes(reach)) then
      call set_ok(status)
      s = reach%s
      right = reach%right
      left = reach%left
    else
      call find_modes(form, s, right, left, status)
      if (status%failed()) return
    end if
    normal%n_modes = n
    normal%n_generators = n
    normal%tolerance = merge(tolerance, default_band, tolerance >= 0.0_wp)
    normal%choosing = tolerance < 0.0_wp
    normal%framed = present(reach) .and. normal%choosing
    normal%with_far = present(with_far)
    normal%s = [s, conjg(s)]
    normal%exponents = normal%s
    normal%frame = aimag(s)
    call renew(normal%right, form%n, 2*n)
    call renew(normal%left, form%n, 2*n)
    normal%right(:, :n) = right
    normal%left(:, :n) = left
    normal%right(:, n + 1:) = conjg(right)
    normal%left(:, n + 1:) = conjg(left)
    normal%weights = reshape([((sum(left(:, j)*matmul(form%linear(:, :, i), right(:, j))), &
                                i=1, 2), j=1, n)], [2, n])
    normal%candidates = [candidate_type ::]
    expected = 0.0_wp
    if (present(sizes)) expected = sizes
    call new_frame_choice(choice, normal%frame)
    call choose_loads(normal, form, choice, expected, status, reach)
    if (.not. status%failed()) call add_waves(normal, form, status)
    if (status%failed()) return
    call mark_rests(normal, sizes)
    normal%steady = steady .or. size(normal%weak) > 0
    if (normal%framed) normal%frame = choice%frame()
    call normal%number_products()
    call normal%set_exponents()
    call second_sides(normal, form)
    n = choice%n
    if (normal%choosing) call choose_products(normal, form, 2, expected, choice, reach)
    if (normal%framed .and. choice%n > n) call change_frame()
    call second_order(normal, form, status)
    if (status%failed()) return
    call start_third(normal, form)
    n = choice%n
    if (normal%choosing) call choose_products(normal, form, 3, expected, choice, reach)
    if (normal%framed .and. choice%n > n) then
      call change_frame()
      call second_order(normal, form, status)
      if (status%failed()) return
      call start_third(normal, form)
    end if
    normal%size_one = abs(normal%right(:form%n_dof, :))
    normal%size_pair = abs(normal%u_pair(:form%n_dof, :))
    normal%used_pairs = pack([(i, i=1, size(normal%pair, 2))], any(normal%size_pair > 0.0_wp, 1))
    call third_order(normal, form, status)

  contains

    subroutine change_frame()
      normal%frame = choice%frame()
      call normal%set_exponents()
      call second_sides(normal, form)
    end subroutine change_frame

  end subroutine new_normal_form

  !> Mark the modes without `sizes` if terms far from the modes are included.
  pure subroutine mark_rests(normal, sizes)
    type(normal_form_type), intent(inout) :: normal
    real(wp), intent(in), optional :: sizes(:)
    integer :: i
    normal%rests = [(.false., i=1, 2*normal%n_generators)]
    if (.not. normal%with_far) return
    associate (n => normal%n_modes, m => normal%n_generators)
      normal%rests(:n) = .not. sizes > 0.0_wp
      normal%rests(m + 1:m + n) = normal%rests(:n)
    end associate
  end subroutine mark_rests

  !> True if the modes are given.
  pure logical function has_modes(reach)
    type(reach_type), intent(in), optional :: reach
    has_modes = .false.
    if (present(reach)) has_modes = allocated(reach%s)
  end function has_modes

  !> Responses to the loads; those that are factors of products become generators.
  subroutine add_waves(normal, form, status)
    type(normal_form_type), intent(inout) :: normal
    type(polynomial_form_type), intent(in) :: form
    type(status_type), intent(out) :: status
    complex(wp), allocatable :: wave(:, :), s(:), right(:, :), left(:, :)
    logical :: active(size(form%drives)), acts(size(form%drives)), joins(size(form%drives))
    integer :: n, k, m

    n = normal%n_modes
    call set_ok(status)
    call renew(normal%g_load, n, size(form%drives))
    call renew(normal%u_load, form%n, size(form%drives))
    acts = .false.
    joins = .true.
    do k = 1, size(form%drives)
      active(k) = any(abs(form%load(:, k)) > 0.0_wp)
      if (.not. active(k)) cycle
      call normal%answer_load(form, k, form%drives(k), normal%u_load(:, k), normal%g_load(:, k), &
                              status)
      if (status%failed()) return
      acts(k) = any(abs(normal%g_load(:, k)) > 0.0_wp)
      if (acts(k)) joins(k) = normal%framed .and. rest_matters(k)
    end do
    normal%direct = pack([(k, k=1, size(form%drives))], active .and. acts)
    normal%weak = pack([(k, k=1, size(form%drives))], active .and. .not. joins)
    normal%hard = pack([(k, k=1, size(form%drives))], active .and. joins)
    if (size(normal%hard) == 0) return
    allocate (wave, source=normal%u_load(:, normal%hard))
    allocate (s, source=normal%exponents(:n))
    allocate (right, source=normal%right(:, :n))
    allocate (left, source=normal%left(:, :n))
    m = n + size(normal%hard)
    normal%n_generators = m
    associate (wave_s => cmplx(0.0_wp, form%drives(normal%hard), wp))
      normal%exponents = [s, wave_s, conjg(s), conjg(wave_s)]
      normal%right = reshape([right, wave, conjg(right), conjg(wave)], [form%n, 2*m])
      normal%left = reshape([left, 0.0_wp*wave, conjg(left), 0.0_wp*wave], [form%n, 2*m])
    end associate

  contains

    !> u_k relative to the linear motion of the modes that the load drives.
    logical function rest_matters(k)
      integer, intent(in) :: k
      real(wp) :: own
      integer :: j
      own = 0.0_wp
      do j = 1, n
        own = own + abs(normal%g_load(j, k))/max(abs(cmplx(0.0_wp, form%drives(k), wp) &
                                                    - normal%exponents(j)), tiny(1.0_wp))
      end do
      rest_matters = maxval(abs(normal%u_load(:form%n_dof, k))) > least_rest*own
    end function rest_matters

  end subroutine add_waves

end module viscovib_normal_form
