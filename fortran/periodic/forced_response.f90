!> Forced response of any oscillator, as planned.
module viscovib_forced_response
  use viscovib_counters, only: count_up, counted_idle, counting
  use viscovib_kinds, only: wp
  use viscovib_linear_response, only: linear_response
  use viscovib_load, only: load_type
  use viscovib_newton_response, only: newton_response
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: moved_coordinates, reduce
  use viscovib_response, only: response_type
  use viscovib_response_plan, only: method_newton, method_successive, response_plan_type
  use viscovib_successive, only: successive_response
  implicit none
  private

  public :: forced_response

contains

  !> Steady response at each frequency; by Newton's method each follows the one
  !! before, else they are independent. Coordinates that nothing moves are left out of
  !! the equations.
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
    type(polynomial_type) :: reduced
    type(load_type) :: part

    if (all(plan%moved)) then
      call whole_response(plan, system, load, nu, response, cancel)
    else
      call reduce(system, plan%moved, reduced)
      call load%take_part(plan%moved, part)
      call whole_response(plan, reduced, part, nu, response, cancel)
      call response%spread_out(plan%moved)
    end if
  end subroutine forced_response

  !> The same for a system all of which is computed.
  subroutine whole_response(plan, system, load, nu, response, cancel)
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu(:)
    type(response_type), intent(out) :: response
    integer, intent(inout), volatile, optional :: cancel

    if (counting) call count_up(counted_idle, size(plan%set%orders)*size(nu)*count( &
                                .not. moved_coordinates(system, load%drives(system))))
    select case (plan%method)
    case (method_successive)
      call successive_response(system, load, nu, plan%set, plan%options, response)
    case (method_newton)
      call newton_response(system, load, nu, plan%set, plan%options, response, cancel)
    case default
      call linear_response(system, load, nu, response)
    end select
  end subroutine whole_response

end module viscovib_forced_response
