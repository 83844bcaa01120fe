!> The map of a state over one or more periods of the load, and its derivative.
!!
!! A state consists of coordinates and velocities alternately, then the rates of hidden states of
!! memory by exponentials. Steps end where laws switch. The derivative is that of the collocation
!! times the jump of perturbations at each switch (viscovib_nearby_motion).
module viscovib_period_map
  use viscovib_constants, only: pi
  use viscovib_fitted_memory, only: bound_hidden, needs_fit
  use viscovib_fitted_motion, only: new_fitted_motion
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: max_dof
  use viscovib_load, only: load_type
  use viscovib_method_catalogue, only: new_stepper
  use viscovib_modal_frame, only: most_in_frame
  use viscovib_nearby_motion, only: nearby_motion
  use viscovib_motion_slopes, only: has_slopes
  use viscovib_polynomial, only: polynomial_type
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_pseudo_inverse, only: pseudo_inverse
  use viscovib_simulate, only: simulate
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_stepper, only: stepper_type
  use viscovib_time_run, only: run_completed, time_run
  implicit none
  private

  public :: new_period_map, period_map, period_run

  !> First number of steps per period of the fastest linear motion, smallest number per period of
  !! the load, and largest total.
  real(wp), parameter :: first_per_period = 4.0_wp, most_first_steps = 1.0e9_wp
  integer, parameter :: least_per_period = 4
  !> Relative change at which the iterations of a step end.
  real(wp), parameter :: of_a_step = 1.0e-15_wp

  type :: period_map
    type(polynomial_type), pointer :: system => null()
    type(load_type) :: load
    !> Frequency of the load, and of the fastest motion (rad/s).
    real(wp) :: nu = 1.0_wp, fastest = 0.0_wp
    !> Periods of the load; the method as in `viscovib_method_catalogue`.
    integer :: n_periods = 1, method = 1
    integer :: n_dof = 0, n_hidden = 0
  contains
    procedure :: period
    procedure :: n_state
    procedure :: weights
    procedure :: size_of
    procedure :: first_steps
    procedure :: run
    procedure :: step_back
  end type period_map

  !> A motion over the time of the map; its states are kept without hidden ones.
  type, extends(time_run) :: period_run
    !> The last state, and its derivatives by the first, 0 if they were not computed.
    real(wp), allocatable :: last(:), by_start(:, :)
    !> Number of switches of laws.
    integer :: n_passed = 0
    !> True if the derivatives exist: at a grazing contact they do not.
    logical :: known = .true.
  contains
    procedure :: is_complete
  end type period_run

contains

  !> Check system, load and frequency.
  subroutine new_period_map(map, system, load, nu, n_periods, method, status)
    type(period_map), intent(out) :: map
    type(polynomial_type), intent(in), target :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    integer, intent(in) :: n_periods, method
    type(status_type), intent(out) :: status
    type(polynomial_motion_type) :: motion
    integer :: k, highest

    map%system => system
    map%load = load
    map%nu = nu
    map%n_periods = n_periods
    map%method = method
    map%n_dof = system%n_dof()
    if (map%n_dof > most_in_frame) then
      call fail(status, status_input_error, 'system', 'system: has '//show(map%n_dof) &
                //' coordinates, must have at most '//show(most_in_frame))
      return
    end if
    map%n_hidden = bound_hidden(system)
    if (map%n_hidden < 0 .or. needs_fit(system) &
        .or. map%n_dof + map%n_hidden > most_in_frame) then
      call fail(status, status_input_error, 'system', 'system: has kernels that are not sums of ' &
                //'exponentials, or too many exponentials: use kernel.sum_of_exponentials(), or ' &
                //'forced_response')
      return
    end if
    if (method > 1 .and. (map%n_dof > max_dof .or. map%n_hidden > 0)) then
      call fail(status, status_input_error, 'method', 'method: must be gauss8 with more than ' &
                //show(max_dof)//' coordinates, or with memory')
      return
    end if
    call load%check_at([nu], status)
    if (status%failed()) return
    call new_fitted_motion(motion, system, load, nu, 1.0_wp, 1.0_wp, status)
    if (status%failed()) return
    if (.not. has_slopes(motion)) then
      call fail(status, status_input_error, 'system', 'system: has hysteresis elements, or laws ' &
                //'of too many arguments for their derivatives (see forced_response)')
      return
    end if
    highest = -1
    do k = 1, size(load%orders)
      if (any(abs(load%force_at(k, nu)) > 0.0_wp)) highest = max(highest, load%orders(k))
    end do
    if (highest < 0) highest = 1
    map%fastest = max(motion%fastest(), nu*highest)
    if (first_steps_of(map) > most_first_steps) then
      call fail(status, status_input_error, 'nu', 'nu = '//show(nu)//': takes ' &
                //show(first_steps_of(map))//' steps of the fastest motion, must be at most ' &
                //show(most_first_steps)//': take a faster load, or softer springs')
    end if
  end subroutine new_period_map

  pure real(wp) function period(self)
    class(period_map), intent(in) :: self
    period = 2.0_wp*pi*self%n_periods/self%nu
  end function period

  pure integer function n_state(self)
    class(period_map), intent(in) :: self
    n_state = 2*self%n_dof + self%n_hidden
  end function n_state

  !> Factors that make velocities comparable with displacements: 1 and 1/nu.
  pure function weights(self)
    class(period_map), intent(in) :: self
    real(wp) :: weights(self%n_state())
    weights = 1.0_wp/self%nu
    weights(1:2*self%n_dof:2) = 1.0_wp
  end function weights

  !> The largest entry of a state or of a difference of states, multiplied by these weights.
  pure real(wp) function size_of(self, state)
    class(period_map), intent(in) :: self
    real(wp), intent(in) :: state(:)
    size_of = maxval(abs(self%weights()*state))
  end function size_of

  pure real(wp) function first_steps_of(map) result(many)
    type(period_map), intent(in) :: map
    many = first_per_period*map%period()*map%fastest/(2.0_wp*pi)
  end function first_steps_of

  !> The number of steps with which a search begins.
  pure integer(i8) function first_steps(self)
    class(period_map), intent(in) :: self
    first_steps = max(int(least_per_period*self%n_periods, i8), &
                      ceiling(min(first_steps_of(self), most_first_steps), i8))
  end function first_steps

  !> True if the end was reached, with the derivatives if requested.
  pure logical function is_complete(self)
    class(period_run), intent(in) :: self
    is_complete = self%ended == run_completed .and. self%known
  end function is_complete

  !> The motion from a state in a given number of steps.
  subroutine run(self, state, n_steps, ran, times, derivatives)
    class(period_map), intent(in) :: self
    real(wp), intent(in) :: state(:)
    integer(i8), intent(in) :: n_steps
    type(period_run), intent(out) :: ran
    !> Ascending times of requested states; whether to compute derivatives (default: yes).
    real(wp), intent(in), optional :: times(:)
    logical, intent(in), optional :: derivatives
    type(polynomial_motion_type) :: motion
    class(stepper_type), allocatable :: stepper
    type(nearby_motion) :: along
    type(status_type) :: status
    real(wp), allocatable :: hidden(:)
    real(wp) :: h
    integer :: n
    logical :: followed

    n = self%n_dof
    h = self%period()/n_steps
    followed = .true.
    if (present(derivatives)) followed = derivatives
    ran%n_steps = n_steps
    if (present(times)) ran%times = times
    call ran%allocate_states(2*n, 0, h)
    allocate (ran%last, source=state)
    allocate (ran%by_start(size(state), merge(size(state), 0, followed)), source=0.0_wp)
    call new_fitted_motion(motion, self%system, self%load, self%nu, h, h*n_steps, status)
    ! For a varied system the checks were made at its first value.
    ran%known = .not. status%failed()
    if (.not. ran%known) return
    ! Displacements that represent memory have no effect, and begin with 0.
    allocate (hidden(motion%n_hidden), source=0.0_wp)
    call new_stepper(stepper, motion, self%method, [state(1:2*n:2), hidden], &
                     [state(2:2*n:2), state(2*n + 1:)], 0.0_wp, h, of_a_step)
    motion%thin = min(1.0_wp, real(self%first_steps(), wp)/n_steps)
    if (followed) then
      call along%begin(motion%n_dof)
      call simulate(stepper, motion, ran, along)
      call take_derivatives(along, n, motion%n_dof, ran)
    else
      call simulate(stepper, motion, ran)
    end if
    ran%last(1:2*n:2) = stepper%q(:n)
    ran%last(2:2*n:2) = stepper%v(:n)
    ran%last(2*n + 1:) = stepper%v(n + 1:)
  end subroutine run

  subroutine take_derivatives(along, n, n_all, ran)
    type(nearby_motion), intent(in) :: along
    !> Number of coordinates, without and with hidden ones.
    integer, intent(in) :: n, n_all
    type(period_run), intent(inout) :: ran
    real(wp) :: whole(2*n_all, 2*n_all)
    integer :: i, place(n + n_all)

    ran%n_passed = along%n_passed
    ran%known = along%known
    if (.not. ran%known) return
    ! Index of each number of the state among all coordinates, then all velocities.
    place(:2*n) = [([i, n_all + i], i=1, n)]
    place(2*n + 1:) = [(n_all + i, i=n + 1, n_all)]
    whole(:n_all, :) = along%q
    whole(n_all + 1:, :) = along%v
    ran%by_start = whole(place, place)
    ran%known = all(abs(ran%by_start) <= huge(1.0_wp))
  end subroutine take_derivatives

  !> Newton's step (1 - P')^-1 left towards a periodic state, and the factor `enlarged` by which the
  !! inverse amplifies errors.
  subroutine step_back(self, by_start, left, step, enlarged)
    class(period_map), intent(in) :: self
    real(wp), intent(in) :: by_start(:, :), left(:)
    real(wp), allocatable, intent(out) :: step(:)
    real(wp), intent(out) :: enlarged
    real(wp), allocatable :: balanced(:, :), inverse(:, :), weights(:)
    integer :: i, n

    n = size(left)
    allocate (weights, source=self%weights())
    ! Balanced, so that the unit of time does not cause small singular values.
    allocate (balanced, source=-spread(weights, 2, n)*by_start/spread(weights, 1, n))
    do i = 1, n
      balanced(i, i) = balanced(i, i) + 1.0_wp
    end do
    call pseudo_inverse(balanced, inverse)
    allocate (step, source=matmul(inverse, weights*left)/weights)
    enlarged = maxval(sum(abs(inverse), 2))
  end subroutine step_back

end module viscovib_period_map
