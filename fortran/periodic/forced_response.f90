! Optimize: -O2 -fvect-cost-model=dynamic
!> Forced response of any oscillator, by the method of a plan.
module viscovib_forced_response
  use viscovib_balance_ladder, only: balance_ladder_type, lowest_order, new_ladder, one_rung
  use viscovib_counters, only: count_up, counted_idle, counting
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_linear_response, only: linear_response
  use viscovib_load, only: load_type
  use viscovib_newton_response, only: newton_response
  use viscovib_order_rules, only: times_as_many
  use viscovib_oscillator, only: oscillator_type
  use viscovib_outcomes, only: outcome_converged
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: moved_coordinates, reduce
  use viscovib_response, only: response_type
  use viscovib_response_plan, only: method_auto, method_newton, method_successive, &
                                    response_plan_type
  use viscovib_successive, only: successive_response
  implicit none
  private

  public :: forced_response

  !> Initial highest order if all frequencies have the same number of harmonics.
  integer, parameter :: first_harmonics = 9

contains

  !> Steady response at each frequency. Newton's method starts from the solution at the previous
  !! frequency; the other methods treat frequencies independently. Coordinates that are not excited
  !! are removed from the equations.
  subroutine forced_response(plan, system, load, nu, response, cancel, start)
    !> Plan for the same system, load and method.
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequencies (rad/s), each > 0.
    real(wp), intent(in) :: nu(:)
    type(response_type), intent(out) :: response
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    !> Initial guess for Newton's method, relative to the base: unknowns of all orders that the plan
    !! allows, shape (2 n_orders, n_dof).
    real(wp), intent(in), optional :: start(:, :)
    type(polynomial_type) :: reduced
    type(load_type) :: part
    real(wp), allocatable :: its(:, :)
    integer :: d

    if (all(plan%moved)) then
      call whole_response(plan, system, load, nu, response, cancel, start)
    else
      call reduce(system, plan%moved, reduced)
      call load%take_part(plan%moved, part)
      ! Without a start its part is not allocated, which makes it absent.
      if (present(start)) its = start(:, pack([(d, d=1, size(plan%moved))], plan%moved))
      call whole_response(plan, reduced, part, nu, response, cancel, its)
      call response%spread_out(plan%moved)
    end if
    call response%keep_finite()
    if (.not. allocated(response%method)) allocate (response%method(size(nu)), source=plan%method)
  end subroutine forced_response

  !> The same for a system without removed coordinates.
  subroutine whole_response(plan, system, load, nu, response, cancel, start)
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu(:)
    type(response_type), intent(out) :: response
    integer, intent(inout), optional :: cancel
    real(wp), intent(in), optional :: start(:, :)
    type(response_type) :: found

    if (counting) call count_up(counted_idle, size(plan%set%orders)*size(nu)*count( &
                                .not. moved_coordinates(system, load%drives(system))))
    select case (plan%method)
    case (method_successive)
      call by_successive(plan, system, load, nu, response, cancel)
    case (method_newton)
      call by_newton(plan, system, load, nu, response, cancel, start)
    case (method_auto)
      call by_successive(plan, system, load, nu, response, cancel)
      response%method = merge(method_successive, method_newton, &
                              response%outcome == outcome_converged)
      if (any(response%method == method_newton)) then
        found = response
        call by_newton(plan, system, load, nu, response, cancel, found=found)
      end if
    case default
      call linear_response(system, load, nu, response)
      return
    end select
    call response%add_base_motion(system, load)
  end subroutine whole_response

  !> The response relative to the base.
  subroutine by_successive(plan, system, load, nu, response, cancel)
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu(:)
    type(response_type), intent(out) :: response
    integer, intent(inout), optional :: cancel

    if (plan%chosen) then
      call with_enough_harmonics(plan, system, load, nu, response, cancel)
    else
      call successive_response(system, load, nu, plan%set, plan%options, response, cancel)
    end if
  end subroutine by_successive

  !> The response relative to the base.
  subroutine by_newton(plan, system, load, nu, response, cancel, start, found)
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu(:)
    type(response_type), intent(out) :: response
    integer, intent(inout), optional :: cancel
    real(wp), intent(in), optional :: start(:, :)
    type(response_type), intent(in), optional :: found
    type(balance_ladder_type) :: ladder

    if (plan%chosen) then
      call new_ladder(ladder, system, load, plan%set%half_wave, plan%newton_most)
    else
      call one_rung(ladder, system, load, plan%set)
    end if
    call newton_response(system, load, nu, ladder, plan%options, response, cancel, start, found)
  end subroutine by_newton

  !> Successive approximations for many frequencies at once. Frequencies with a large truncation
  !! error are repeated, all with the number of harmonics of the worst one.
  subroutine with_enough_harmonics(plan, system, load, nu, response, cancel)
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu(:)
    type(response_type), intent(out) :: response
    integer, intent(inout), optional :: cancel
    type(response_type) :: better
    type(harmonic_set_type) :: set
    integer, allocatable :: few(:)
    real(wp) :: worst, times
    integer :: highest, i

    highest = min(max(first_harmonics, 2*lowest_order(load) + 1), plan%most)
    call new_harmonic_set(set, highest, plan%set%half_wave, system%degree)
    call successive_response(system, load, nu, set, plan%options, response, cancel)
    do
      few = pack([(i, i=1, size(nu))], response%outcome == outcome_converged)
      few = pack(few, response%truncation(few) > response%allowed(few))
      if (size(few) == 0 .or. highest == plan%most) return
      worst = maxval(response%truncation(few))
      ! Harmonics decay geometrically: increase the order by extrapolation, with a margin.
      times = min(times_as_many(worst, plan%options%tolerance), 2.0_wp)
      highest = max(highest + 4, ceiling(1.1_wp*highest*times))
      highest = ior(min(highest, 2*set%orders(size(set%orders)) + 1), 1)
      highest = min(highest, plan%most)
      call new_harmonic_set(set, highest, plan%set%half_wave, system%degree)
      call successive_response(system, load, nu(few), set, plan%options, better, cancel)
      call response%replace(few, better)
    end do
  end subroutine with_enough_harmonics

end module viscovib_forced_response
