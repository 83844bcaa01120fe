!> The nonlinear steady response by Newton's method, frequency by frequency, each
!! from its neighbour: like a slow sweep, it follows the branch it is on as far as
!! that goes.
module viscovib_newton_response
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_stability, only: judge_type, new_judge
  use viscovib_newton_point, only: newton_point, point_from_rest
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged, outcome_singular
  use viscovib_response, only: response_options, response_type
  implicit none
  private

  public :: newton_response

contains

  subroutine newton_response(system, load, nu, set, options, response, cancel)
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequencies (rad/s).
    real(wp), intent(in) :: nu(:)
    !> Harmonics to keep.
    type(harmonic_set_type), intent(in) :: set
    type(response_options), intent(in) :: options
    type(response_type), intent(out) :: response
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile, optional :: cancel
    type(balance_type) :: balance
    real(wp), dimension(2*size(set%orders), system%n_dof()) :: x, last, before
    real(wp) :: last_nu, before_nu
    integer :: i, d, outcome, known

    call response%allocate_for(nu, set%orders, system%n_dof(), 0)
    call new_balance(balance, system, set)
    known = 0
    last = 0.0_wp
    last_nu = 0.0_wp
    do i = 1, size(nu)
      if (present(cancel)) then
        if (cancel /= 0) return
      end if
      call balance%set_frequency(system, load, nu(i))
      outcome = outcome_singular
      if (known >= 2) then
        x = last + (last - before)*((nu(i) - last_nu)/(last_nu - before_nu))
        call newton_point(balance, system, options%tolerance, x, outcome, response%iterations(i))
      end if
      if (outcome /= outcome_converged .and. known >= 1) then
        x = last
        call newton_point(balance, system, options%tolerance, x, outcome, response%iterations(i))
      end if
      if (outcome /= outcome_converged) then
        call point_from_rest(balance, system, load, options%tolerance, x, outcome, &
                             response%iterations(i), cancel)
        known = 0
      end if
      if (outcome /= outcome_converged) then
        call response%discard(i, outcome)
        known = 0
        cycle
      end if
      do d = 1, system%n_dof()
        response%coefficients(:, d, i) = cmplx(x(1::2, d), x(2::2, d), wp)
      end do
      ! Equal frequencies give no direction.
      if (known > 0 .and. .not. abs(nu(i) - last_nu) > 0.0_wp) known = 0
      before = last
      before_nu = last_nu
      last = x
      last_nu = nu(i)
      known = known + 1
    end do
    if (options%stability) call judge_all(system, set, response, cancel)
    call response%add_base_motion(system, load)
  end subroutine newton_response

  !> Stability of the motions found, in coordinates relative to the base.
  subroutine judge_all(system, set, response, cancel)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    type(response_type), intent(inout) :: response
    integer, intent(inout), volatile, optional :: cancel
    type(judge_type) :: judge
    real(wp), allocatable :: x(:, :, :)

    allocate (x(2*size(set%orders), system%n_dof(), size(response%nu)))
    x(1::2, :, :) = real(response%coefficients)
    x(2::2, :, :) = aimag(response%coefficients)
    call new_judge(judge, system, set)
    call judge%judge(system, response%nu, x, response%stability, cancel)
  end subroutine judge_all

end module viscovib_newton_response
