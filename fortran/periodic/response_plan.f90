! Optimize: -O2 -fvect-cost-model=dynamic
!> Plan of a forced response: what it computes, and what it skips and why.
!!
!! The plan is made first and then executed without changes. It also contains every check of the
!! input that requires the whole job.
module viscovib_response_plan
  use viscovib_balance_ladder, only: lowest_order
  use viscovib_checks, only: check_finite, check_positive
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_cycle_terms, only: has_kinks, has_states
  use viscovib_limits, only: max_harmonics, max_tolerance, min_tolerance, most_harmonics_chosen
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_plan_text, only: report_idle, report_laws, report_zeros
  use viscovib_polynomial, only: polynomial_type
  use viscovib_reduction, only: moved_coordinates, reduce
  use viscovib_response, only: response_options
  use viscovib_status, only: fail, show, status_input_error, status_type, things
  implicit none
  private

  public :: response_plan_type, new_response_plan

  !> `method_auto`, the default: successive approximations where they converge, Newton's method
  !! elsewhere.
  integer, parameter, public :: method_linear = 1, method_successive = 2, &
                                method_newton = 3, method_auto = 4
  character(len=*), parameter, public :: method_names(4) = &
    [character(len=10) :: 'linear', 'successive', 'newton', 'auto']
  !> Bounds of the options.
  integer, parameter, public :: max_iterations_allowed = 100000
  !> Largest number of unknowns of Newton's method: a matrix of 32 MB.
  integer, parameter, public :: max_unknowns = 2000

  type :: response_plan_type
    !> The method that will run.
    integer :: method = method_linear
    !> Harmonics: for a linear response those of the load; if adapted, the smallest set.
    type(harmonic_set_type) :: set
    type(response_options) :: options
    !> Harmonics are adapted, up to the order `most`, or `newton_most` by Newton's method.
    logical :: chosen = .false.
    integer :: most = 0, newton_most = 0
    !> True if a linear response leaves out forces that have no finite slope at rest.
    logical :: lacks_forces = .false.
    !> Computed coordinates, shape (n_dof); the remaining coordinates stay at rest.
    logical, allocatable :: moved(:)
    !> The requested method.
    integer, private :: requested = method_linear
    !> Set by `describe`: lines `computes: ...` and `skips: ...`, separated by new-line characters;
    !! and the lines that also apply to a branch.
    character(len=:), allocatable :: text, rest
  contains
    procedure :: describe
    procedure, private :: say
  end type response_plan_type

contains

  !> Check the job and choose the method.
  subroutine new_response_plan(plan, system, load, nu, method, options, status)
    type(response_plan_type), intent(out) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Circular frequencies (rad/s), each > 0, in any order.
    real(wp), intent(in) :: nu(:)
    integer, intent(in) :: method
    type(response_options), intent(in) :: options
    type(status_type), intent(out) :: status
    type(polynomial_type) :: reduced
    integer :: i

    do i = 1, size(nu)
      call check_positive('nu', nu(i), status)
      if (status%failed()) return
    end do
    call load%check_at(nu, status)
    if (status%failed()) return
    if (method < 1 .or. method > size(method_names)) then
      call fail(status, status_input_error, 'method', 'method = '//show(method) &
                //': must be linear (1), successive (2), newton (3) or auto (4)')
      return
    end if
    call check_options(options, status)
    if (status%failed()) return
    plan%options = options
    plan%options%least = options%absolute*lightest(system)
    plan%moved = moved_coordinates(system, load%drives(system) .or. options%keep_idle &
                                   .or. options%stability)
    if (all(plan%moved)) then
      call choose(plan, system, load, method, status)
    else
      call reduce(system, plan%moved, reduced)
      call choose(plan, reduced, load, method, status)
    end if
  end subroutine new_response_plan

  !> Method and harmonics for a system without idle coordinates.
  subroutine choose(plan, system, load, method, status)
    type(response_plan_type), intent(inout) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: method
    type(status_type), intent(inout) :: status
    integer :: n, highest

    if (has_states(system) .and. method == method_successive) then
      call fail(status, status_input_error, 'method', "method = 'successive': does not take " &
                //"elements with hysteresis, take 'newton'")
      return
    end if
    plan%requested = method
    plan%method = merge(method_linear, method, system%is_linear() .and. &
                        .not. (plan%options%on_branch .or. plan%options%stability))
    if (plan%method == method_auto .and. (has_states(system) .or. system%moving .or. &
                                          plan%options%stability)) plan%method = method_newton
    if (plan%method == method_linear) then
      plan%set%orders = load%orders
      plan%lacks_forces = method == method_linear .and. lacks_slopes(system)
    else
      plan%chosen = plan%options%choose_harmonics
      highest = merge(lowest_order(load), plan%options%harmonics, plan%chosen)
      plan%most = merge(max(most_harmonics_chosen, highest), highest, plan%chosen)
      if (lowest_order(load) > min(plan%most, max_harmonics)) then
        call fail(status, status_input_error, 'harmonics', 'harmonics = ' &
                  //show(min(plan%most, max_harmonics)) &
                  //': must be at least '//show(lowest_order(load)) &
                  //', the highest order of the load')
        return
      end if
      call new_harmonic_set(plan%set, highest, plan%options%symmetric &
                            .and. system%odd .and. load%is_odd(), system%degree)
    end if
    if (plan%options%stability .and. plan%method /= method_newton) then
      call fail(status, status_input_error, 'stability', 'stability: needs method = newton or auto')
      return
    end if
    call check_mean(plan, system, status)
    if (status%failed()) return
    n = 2*size(plan%set%orders)*system%n_dof()
    if (plan%method == method_auto .and. n > max_unknowns) plan%method = method_successive
    if (plan%chosen) then
      ! Highest order that the largest number of unknowns allows.
      highest = max_unknowns/(2*system%n_dof())
      highest = merge(2*highest - 1, highest - 1, plan%set%half_wave)
      plan%newton_most = max(min(plan%most, highest), plan%set%orders(size(plan%set%orders)))
      if (plan%method == method_newton) plan%most = plan%newton_most
    end if
    if (plan%method == method_newton .and. n > max_unknowns) then
      call fail(status, status_input_error, 'harmonics', 'harmonics = ' &
                //show(plan%options%harmonics)//': makes '//show(n)//' unknowns with ' &
                //show(system%n_dof())//' coordinates, must be at most '//show(max_unknowns))
    end if
  end subroutine choose

  !> True if a force has no finite slope at rest, such as |v|^a with 0 < a < 1 or dry friction: as
  !! motions decrease, the ratio of its nonlinear part to the motion grows without bound.
  logical function lacks_slopes(system)
    class(oscillator_type), intent(in) :: system
    real(wp), parameter :: sizes(2) = [1.0e-10_wp, 1.0e-40_wp], growth = 10.0_wp, &
                           rounding = 1.0e-10_wp
    real(wp) :: u(4, system%n_dof() + system%n_rates()), w(4, system%n_memory())
    real(wp) :: ratios(size(sizes))
    integer :: b, k

    lacks_slopes = .false.
    if (system%is_linear()) return
    do b = 1, size(u, 2)
      do k = 1, size(sizes)
        u = 0.0_wp
        w = 0.0_wp
        u(:, b) = sizes(k)*[0.0_wp, 1.0_wp, 0.0_wp, -1.0_wp]
        call system%deflection_remainder(u, w)
        ratios(k) = maxval(abs(w))/sizes(k)
      end do
      lacks_slopes = ratios(2) > growth*ratios(1) + rounding*maxval(abs(system%gather))
      if (lacks_slopes) return
    end do
  end function lacks_slopes

  !> Smallest root of a mass: a displacement d of any coordinate has a norm (`weighted_norm`) of at
  !! least d times this. The norm does not include coordinates without mass.
  pure real(wp) function lightest(system)
    class(oscillator_type), intent(in) :: system
    integer :: d
    lightest = huge(1.0_wp)
    do d = 1, system%n_dof()
      if (system%mass(d, d) > 0.0_wp) lightest = min(lightest, sqrt(system%mass(d, d)))
    end do
    if (.not. lightest < huge(1.0_wp)) lightest = 1.0_wp
  end function lightest

  subroutine check_options(options, status)
    type(response_options), intent(in) :: options
    type(status_type), intent(out) :: status

    if ((options%harmonics < 1 .or. options%harmonics > max_harmonics) &
        .and. .not. options%choose_harmonics) then
      call fail(status, status_input_error, 'harmonics', 'harmonics = '//show(options%harmonics) &
                //': must be 1 to '//show(max_harmonics)//' (the highest harmonic)')
      return
    end if
    call check_finite('tolerance', options%tolerance, status)
    if (status%failed()) return
    if (options%tolerance < min_tolerance .or. options%tolerance > max_tolerance) then
      call fail(status, status_input_error, 'tolerance', 'tolerance = '//show(options%tolerance) &
                //': must be in ['//show(min_tolerance)//', '//show(max_tolerance)//']')
      return
    end if
    call check_finite('atol', options%absolute, status)
    if (status%failed()) return
    if (options%absolute < 0.0_wp) then
      call fail(status, status_input_error, 'atol', 'atol = '//show(options%absolute) &
                //': must not be negative')
      return
    end if
    if (options%max_iterations < 1 .or. options%max_iterations > max_iterations_allowed) then
      call fail(status, status_input_error, 'max_iterations', 'max_iterations = ' &
                //show(options%max_iterations)//': must be 1 to '//show(max_iterations_allowed))
      return
    end if
    call check_finite('relaxation', options%relaxation, status)
    if (status%failed()) return
    if (options%relaxation < 0.0_wp .or. options%relaxation > 1.0_wp) then
      call fail(status, status_input_error, 'relaxation', 'relaxation = ' &
                //show(options%relaxation)//': must be in (0, 1], or 0 to halve it where needed')
    end if
  end subroutine check_options

  !> A mean requires the integral of every kernel.
  subroutine check_mean(plan, system, status)
    type(response_plan_type), intent(in) :: plan
    class(oscillator_type), intent(in) :: system
    type(status_type), intent(out) :: status

    if (.not. any(plan%set%orders == 0)) return
    if (system%kernel_without_integral() == 0) return
    call fail(status, status_input_error, 'beta', 'a kernel has no finite integral (beta = 0), ' &
              //'which the mean of this response needs: give beta > 0, or a load of odd ' &
              //'harmonics only and odd forces (and keep to their symmetry)')
  end subroutine check_mean

  !> Write the lines of a plan for `n_nu` frequencies. A run does not need them.
  subroutine describe(plan, system, load, n_nu)
    class(response_plan_type), intent(inout) :: plan
    !> System and load of the plan.
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: n_nu
    type(polynomial_type) :: reduced
    character(len=:), allocatable :: zeros

    if (all(plan%moved)) then
      call describe_moving(plan, system, load, n_nu)
    else
      call reduce(system, plan%moved, reduced)
      call describe_moving(plan, reduced, load, n_nu)
    end if
    zeros = report_idle(plan%moved)//report_zeros(system, load)
    plan%text = plan%text//zeros
    plan%rest = plan%rest//zeros
  end subroutine describe

  !> Lines about a system without idle coordinates.
  subroutine describe_moving(plan, system, load, n_nu)
    class(response_plan_type), intent(inout) :: plan
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    integer, intent(in) :: n_nu
    character(len=:), allocatable :: kept, by_turns
    integer :: n_kernels, i

    plan%rest = ''
    n_kernels = count([(any(system%kernel_of == i), i=1, size(system%kernels))])
    if (plan%method == method_linear) then
      if (plan%requested /= method_linear) call plan%say('skips: the iteration (nothing is ' &
                                                         //'nonlinear)')
      call plan%say('skips: harmonics that the load lacks (a linear system does not respond ' &
                    //'at them)')
      if (plan%lacks_forces) call plan%say('skips: forces without a finite slope at rest ' &
                                           //"(method 'linear')")
    else
      if (.not. plan%chosen) then
        call plan%say('computes: '//things(plan%set%n_samples, 'sample')//' of ' &
                      //trim(merge('half a period', 'a period     ', plan%set%half_wave)))
      end if
      if (plan%set%half_wave) call plan%say('skips: even harmonics and half of each period ' &
                                            //'(odd forces, load of odd harmonics)')
      plan%rest = plan%rest//report_laws(system)
      if (has_kinks(system)) call plan%say('computes: to a relative error of ' &
                                           //show(plan%options%tolerance)//' (a law has corners)')
      if (system%separable) call plan%say('skips: hereditary variables in time ' &
                                          //'(memory acts on each term as a whole)')
    end if
    if (n_kernels == 0) then
      call plan%say('skips: kernel transforms (no memory)')
    else
      call plan%say('computes: transforms of '//things(n_kernels, 'kernel'))
    end if
    if (.not. load%moves_base()) call plan%say('skips: base motion (the base is at rest)')
    if (plan%options%stability) call plan%say('computes: stability of each motion (' &
                                              //trim(merge('exponents  ', 'multipliers', &
                                                           n_kernels > 0))//')')
    kept = things(size(plan%set%orders), 'harmonic')//' per coordinate'
    if (plan%chosen) then
      kept = 'harmonics chosen to meet the tolerance, at most '//show(plan%most)
      if (plan%method == method_newton) kept = 'harmonics chosen at each frequency'//kept(17:)
    end if
    by_turns = ''
    if (plan%method == method_auto) by_turns = " (successive approximations, Newton's method " &
                                               //'where they do not converge)'
    plan%text = 'computes: response at '//things(n_nu, 'frequency', 'frequencies') &
                //' by method '//trim(method_names(plan%method)) &
                //by_turns//', '//kept//new_line('a') &
                //plan%rest
    if (.not. plan%options%keep_history) plan%text = plan%text &
                                                     //'skips: history of corrections (not ' &
                                                     //'requested)'//new_line('a')
  end subroutine describe_moving

  subroutine say(self, line)
    class(response_plan_type), intent(inout) :: self
    character(len=*), intent(in) :: line
    self%rest = self%rest//line//new_line('a')
  end subroutine say

end module viscovib_response_plan
