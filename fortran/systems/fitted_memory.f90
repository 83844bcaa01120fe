! Optimize: -O2
!> Sums of exponentials for kernels, for solutions whose steps end where laws switch
!! (viscovib_hidden_memory).
!!
!! S(t) = sum_q w_q exp(-r_q t) approximates R(t) within a relative error from t_min on, a small
!! fraction of the step h (viscovib_spectral_kernel). D = R - S is confined to t < t_min, but not
!! small where R is singular. For a smooth force g it contributes m_0 g - m_1 g' + ..., for a jump
!! of g the push m_0 from t_min on and the impulse -m_1, with m_k = integral D t^k/k! dt. One extra
!! exponential matches both moments. It is the first Gauss rule of D's spectrum, with Laplace
!! transforms w/(s + r) = R(s) - S(s) at s_1 and s_2. For a slow motion exp(s t) the error is m_2
!! (s - s_1) (s - s_2): a constant fraction of D if both are of the order of 1/h, and of the order
!! (t_min s)^2 if they are of the order of s. Below 1/reach S does not approximate R. Rounding
!! errors of the difference grow as s/s_2.
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

  public :: bound_hidden, copy_system, fit_memory, needs_fit, fit_text

  !> Shortest lag of a sum, as a fraction of the step size.
  real(wp), parameter :: shortest_lag = 1.0e-3_wp
  !> Relative errors of sums, alternating as the step is halved: two runs then show this error.
  real(wp), parameter :: errors(0:1) = [5.0e-14_wp, 1.0e-12_wp]
  !> Largest error that two runs may share: twice the smaller error, which one of them uses.
  real(wp), parameter, public :: shared_error = 1.0e-13_wp
  !> Points s where transforms agree. s_1 is at most `faded`/reach, where exp(-s t) has decayed, and
  !! `most_agreed`/step; s_2 is the geometric mean of s_1 and `resolved`/step.
  real(wp), parameter :: faded = 40.0_wp, most_agreed = 0.5_wp, resolved = 2.0_wp
  !> Step size shown in a plan, as a fraction of the latest time (1/1000 of the run).
  real(wp), parameter :: usual_step = 1.0e-5_wp
  !> Largest number of terms of a sum, assumed before step and end time are known. Kernels with a
  !! sharp spectrum need more; the solver then reports an error.
  integer, parameter :: most_terms = 80

contains

  !> True if an active kernel is not a sum of exponentials.
  pure logical function needs_fit(system)
    class(oscillator_type), intent(in) :: system
    integer :: k
    needs_fit = .false.
    do k = 1, size(system%kernels)
      if (.not. any(system%kernel_of == k)) cycle
      needs_fit = needs_fit .or. .not. fades_by_exponentials(system%kernels(k)%kernel)
    end do
  end function needs_fit

  !> Largest number of memory coordinates; -1: a kernel cannot be fitted.
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

  !> The system with sums fitted for the step size of a run and times up to `reach`.
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

  !> Line of a plan: number of exponentials and accuracy of the fit.
  function fit_text(system, step, reach) result(text)
    type(polynomial_type), intent(in) :: system
    !> 0: not known yet.
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
      ! Two step sizes include one with the smaller error.
      most = 0
      do i = 0, 1
        call fit_memory(system, usual_step*0.5_wp**i*reach, reach, fitted)
        most = max(most, count_hidden(fitted))
      end do
      text = text//'about '//show(most)//' in a thousand steps, within ' &
             //show(maxval(errors))//' of R(t) from '//show(shortest_lag)//' of the step on'
    end if
  end function fit_text

  !> The extra exponential for the part of the kernel before the shortest lag.
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
    ! For a nearly regular kernel the difference is rounding error, which gives no rate.
    if (rest(1) - rest(2) > epsilon(1.0_wp)*abs(rest(1))) then
      rate = max(rate, (rest(2)*s(2) - rest(1)*s(1))/(rest(1) - rest(2)))
    end if
    weight = max(rest(1)*(s(1) + rate), 0.0_wp)
  end subroutine find_rest

  !> Copy component by component because of the kernels (`copy_kernels`).
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
    if (allocated(system%shaft)) other%shaft = system%shaft
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
