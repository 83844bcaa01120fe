!> Forced response of any oscillator, as planned.
module viscovib_forced_response
  use viscovib_kinds, only: wp
  use viscovib_linear_response, only: linear_response
  use viscovib_load, only: load_type
  use viscovib_newton_response, only: newton_response
  use viscovib_oscillator, only: oscillator_type
  use viscovib_response, only: response_type
  use viscovib_response_plan, only: method_newton, method_successive, response_plan_type
  use viscovib_successive, only: successive_response
  implicit none
  private

  public :: forced_response

contains

  !> Steady response at each frequency; by Newton's method each follows the one
  !! before, else they are independent.
  subroutine forced_response(plan, system, load, nu, response, cancel)
    !> Made for the same system, load and method.
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequencies (rad/s), each > 0.
    real(wp), intent(in) :: nu(:)
    type(response_type), intent(out) :: response
    !> May be set from elsewhere to give up; only Newton's method, which takes all
    !! frequencies in one piece, looks at it.
    integer, intent(inout), volatile, optional :: cancel

    select case (plan%method)
    case (method_successive)
      call successive_response(system, load, nu, plan%set, plan%options, response)
    case (method_newton)
      call newton_response(system, load, nu, plan%set, plan%options, response, cancel)
    case default
      call linear_response(system, load, nu, response)
    end select
  end subroutine forced_response

end module viscovib_forced_response
