!> Kernels as sums of exponentials, for motions whose steps end where laws switch
!! (viscovib_hidden_memory).
!!
!! R(t) is S(t) = sum_q w_q exp(-r_q t) within a relative error from t_min on, a small part of a
!! step h (viscovib_spectral_kernel). What is left, D = R - S, is over before t_min, but not small
!! where R is singular. Of a force g that is smooth within t_min it leaves m_0 g - m_1 g' + ..., of
!! a jump of g the push m_0 from t_min on and the impulse -m_1, m_k = integral D t^k/k! dt. One
!! exponential more has both moments, as the first Gauss rule of D's spectrum: Laplace transforms
!! w/(s + r) = R(s) - S(s) at two small s. Of a motion that is slow compared with them, exp(s t),
!! it leaves m_2 (s - s_1) (s - s_2): a constant part of what D pushes if both are of the order of
!! 1/h, and one of (t_min s)^2 if they are of that of the motion. Below 1/reach S says nothing of R;
!! and rounding, in the difference of both, is larger by s/s_2 at s.
module viscovib_fitted_memory
  use viscovib_hidden_memory, only: count_hidden, fades_by_exponentials
  use viscovib_kernel_holder, only: copy_kernels, kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_prony, only: prony_kernel
  use viscovib_status, only: show
  implicit none
  private

  public :: bound_hidden, copy_system, fit_memory, needs_fit, tell_fit

  !> Shortest lag of a sum, as a part of the step.
  real(wp), parameter :: shortest_lag = 1.0e-3_wp
  !> Relative errors of sums, by turns as the step is halved: what two runs differ by tells both.
  real(wp), parameter :: errors(0:1) = [5.0e-14_wp, 1.0e-12_wp]
  !> What two runs may share of a motion: twice the finer one, of which one of them is.
  real(wp), parameter, public :: shared_error = 1.0e-13_wp
  !> Places s at which transforms agree: by the reach of the sum, beyond which it fades as
  !! exp(-s t), and by the step at most; the second between the first and this part of the step.
  real(wp), parameter :: faded = 40.0_wp, most_agreed = 0.5_wp, resolved = 2.0_wp
  !> The step of which a plan tells, as a part of the latest time: a thousandth of the first run.
  real(wp), parameter :: usual_step = 1.0e-5_wp
  !> Terms of a sum, as far as these are counted before step and end are known. Kernels with a
  !! sharp spectrum have more: what does not fit then is refused by the motion.
  integer, parameter :: most_terms = 80

contains

  !> Whether some kernel that acts is no sum of exponentials.
  pure logical function needs_fit(system)
    class(oscillator_type), intent(in) :: system
    integer :: k
    needs_fit = .false.
    do k = 1, size(system%kernels)
      if (.not. any(system%kernel_of == k)) cycle
      needs_fit = needs_fit .or. .not. fades_by_exponentials(system%kernels(k)%kernel)
    end do
  end function needs_fit

  !> How many coordinates memory takes at most; -1: some kernel has no sum of exponentials.
  integer function bound_hidden(system) result(n)
    type(polynomial_type), intent(in) :: system
    type(polynomial_type) :: whole
    real(wp), allocatable :: weights(:), rates(:)
    integer :: k

    n = -1
    if (.not. needs_fit(system)) then
      n = count_hidden(system)
      return
    end if
    call copy_system(system, whole)
    do k = 1, size(system%kernels)
      if (.not. any(system%kernel_of == k)) cycle
      if (fades_by_exponentials(system%kernels(k)%kernel)) cycle
      call system%kernels(k)%exponentials(errors(0), 1.0_wp, 10.0_wp, weights, rates)
      if (size(rates) == 0) return
      call replace(whole%kernels(k), spread(1.0_wp, 1, most_terms), spread(1.0_wp, 1, most_terms))
    end do
    n = count_hidden(whole)
  end function bound_hidden

  !> The same system with sums for steps of a run, and for times until `reach`.
  subroutine fit_memory(system, step, reach, fitted)
    type(polynomial_type), intent(in) :: system
    real(wp), intent(in) :: step, reach
    type(polynomial_type), intent(out) :: fitted
    real(wp), allocatable :: weights(:), rates(:)
    real(wp) :: first, weight, rate
    integer :: k

    call copy_system(system, fitted)
    first = shortest_lag*step
    do k = 1, size(system%kernels)
      if (.not. any(system%kernel_of == k)) cycle
      if (fades_by_exponentials(system%kernels(k)%kernel)) cycle
      call system%kernels(k)%exponentials(errors(modulo(exponent(step), 2)), first, &
                                          max(reach, 2.0_wp*step), weights, rates)
      call find_rest(system%kernels(k), step, reach, weights, rates, weight, rate)
      call replace(fitted%kernels(k), [weights, weight], [rates, rate])
    end do
  end subroutine fit_memory

  !> A line of a plan: how many exponentials there are, and what they leave of kernels.
  function tell_fit(system, step, reach) result(text)
    type(polynomial_type), intent(in) :: system
    !> 0: it is not known yet.
    real(wp), intent(in) :: step, reach
    character(len=:), allocatable :: text
    type(polynomial_type) :: fitted
    integer :: i, most

    text = 'computes: memory by sums of exponentials, fitted for each step: '
    if (step > 0.0_wp) then
      call fit_memory(system, step, reach, fitted)
      text = text//show(count_hidden(fitted))//', within ' &
             //show(errors(modulo(exponent(step), 2)))//' of R(t) from t = ' &
             //show(shortest_lag*step)//' on'
    else
      ! Of two steps, one has the smaller error.
      most = 0
      do i = 0, 1
        call fit_memory(system, usual_step*0.5_wp**i*reach, reach, fitted)
        most = max(most, count_hidden(fitted))
      end do
      text = text//'about '//show(most)//' in a thousand steps, within ' &
             //show(maxval(errors))//' of R(t) from '//show(shortest_lag)//' of the step on'
    end if
  end function tell_fit

  !> The exponential for what is over before the shortest lag.
  subroutine find_rest(kernel, step, reach, weights, rates, weight, rate)
    type(kernel_holder), intent(in) :: kernel
    real(wp), intent(in) :: step, reach, weights(:), rates(:)
    real(wp), intent(out) :: weight, rate
    complex(wp) :: transform(2)
    real(wp) :: s(2), rest(2)
    integer :: i

    s(1) = min(most_agreed/step, faded/reach)
    s(2) = sqrt(s(1)*resolved/step)
    call kernel%laplace(cmplx(s, 0.0_wp, wp), transform)
    rest = [(real(transform(i)) - sum(weights/(s(i) + rates)), i=1, 2)]
    rate = 1.0_wp/(shortest_lag*step)
    ! Of a kernel that is hardly singular the rest is rounding, which has no rate.
    if (rest(1) - rest(2) > epsilon(1.0_wp)*abs(rest(1))) then
      rate = max(rate, (rest(2)*s(2) - rest(1)*s(1))/(rest(1) - rest(2)))
    end if
    weight = max(rest(1)*(s(1) + rate), 0.0_wp)
  end subroutine find_rest

  !> Component by component, for the sake of kernels (`copy_kernels`).
  subroutine copy_system(system, other)
    type(polynomial_type), intent(in) :: system
    type(polynomial_type), intent(out) :: other

    other%mass = system%mass
    other%damping = system%damping
    other%gather = system%gather
    other%spread = system%spread
    call copy_kernels(system%kernels, other%kernels)
    other%kernel_of = system%kernel_of
    other%n_zero = system%n_zero
    other%n_silent = system%n_silent
    if (allocated(system%rates)) other%rates = system%rates
    if (allocated(system%space_damping)) other%space_damping = system%space_damping
    if (allocated(system%space_stiffness)) other%space_stiffness = system%space_stiffness
    other%bent = system%bent
    other%separable = system%separable
    other%odd = system%odd
    other%degree = system%degree
    other%base_direction = system%base_direction
    other%monomials = system%monomials
    other%laws = system%laws
  end subroutine copy_system

  subroutine replace(holder, weights, rates)
    type(kernel_holder), intent(inout) :: holder
    real(wp), intent(in) :: weights(:), rates(:)
    type(prony_kernel), allocatable :: sum_of
    allocate (sum_of)
    sum_of%weights = weights
    sum_of%rates = rates
    holder%factor = 1.0_wp
    call move_alloc(sum_of, holder%kernel)
  end subroutine replace

end module viscovib_fitted_memory
