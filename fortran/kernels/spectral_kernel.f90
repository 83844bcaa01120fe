!> Kernels with a spectrum of relaxation, and the short sums of exponentials
!! that stand for them.
!!
!!   R(t) = exp(-shift t) integral density(x) exp(-t exp(x)) dx,  x = ln(rate).
!!
!! The trapezoidal rule with spacing h gives weights h density(x_k) > 0 and an
!! error that oscillates evenly in ln(t) (Beylkin and Monzon, Appl. Comput.
!! Harmon. Anal. 28, 2010). Its nodes run on to rates so slow that they no longer
!! tell on [t_min, t_max]; that tail is a positive measure on [0, lambda_0], which
!! a Gauss rule of a few nodes replaces: exp(-t lambda) is nearly a polynomial
!! there, and the error of the rule is known,
!!   t^(2n)/(2n)! times the squared norm of the n-th orthogonal polynomial.
!! For t^(-0.9) on [1e-4, 1e4] this takes 38, 59 and 75 terms for 1e-6, 1e-10 and
!! 1e-13, a tenth more than the best there are, and none of the optimisation.
module viscovib_spectral_kernel
  use viscovib_constants, only: half_pi, pi
  use viscovib_kernel, only: kernel_type, vanished
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: nodes_of_recurrence, recurrence_of
  implicit none
  private

  public :: spectral_kernel_type, ripple_of_power

  type, abstract, extends(kernel_type) :: spectral_kernel_type
    !> The density falls like exp(tail_power x) towards slow rates; 0: there is but
    !! one rate, the shift, and `single` is its weight.
    real(wp) :: tail_power = 0.0_wp, single = 0.0_wp
    !> Rate of a factor of the whole (1/s).
    real(wp) :: shift = 0.0_wp
    !> The density is that power everywhere.
    logical :: self_similar = .false.
  contains
    procedure :: exponentials
    procedure(spectrum_interface), deferred :: spectrum
    procedure(ripple_interface), deferred :: ripple
    procedure, private :: sum_at
  end type spectral_kernel_type

  abstract interface

    subroutine spectrum_interface(self, x, density)
      import :: spectral_kernel_type, wp
      class(spectral_kernel_type), intent(in) :: self
      !> Logarithms of rates.
      real(wp), intent(in) :: x(:)
      real(wp), intent(out) :: density(:)
    end subroutine spectrum_interface

    !> Relative error of the trapezoidal rule with spacing h.
    pure real(wp) function ripple_interface(self, h)
      import :: spectral_kernel_type, wp
      class(spectral_kernel_type), intent(in) :: self
      real(wp), intent(in) :: h
    end function ripple_interface

  end interface

  !> Parts of the tolerance for the spacing and for each end.
  real(wp), parameter :: share_of_spacing = 0.7_wp, share_of_end = 0.15_wp
  !> Most nodes of the Gauss rule, and length of the tail in units of x; of
  !! a power half of it will do, since what is left is known.
  integer, parameter :: most_slow = 16
  !> More terms than any spacing and any times need.
  integer, parameter :: most_fast = 100000
  real(wp), parameter :: tail_length = 40.0_wp
  !> An error bound that has grown so far does not come back.
  real(wp), parameter :: hopeless = 1.0e200_wp
  !> A density so sharp that it needs a smaller spacing is left without a sum.
  real(wp), parameter :: least_spacing = 1.0e-2_wp

contains

  !> 2 |Gamma(p + 2 pi i/h)|/Gamma(p), the relative error of the trapezoidal rule for
  !! t^(-p) by Poisson's summation (its first harmonic), with |Gamma(p + i y)| by
  !! Stirling's formula.
  elemental real(wp) function ripple_of_power(p, h) result(ripple)
    real(wp), intent(in) :: p, h
    real(wp) :: y
    y = 2.0_wp*pi/h
    ripple = 2.0_wp*sqrt(2.0_wp*pi)*y**(p - 0.5_wp)*exp(-half_pi*y)/gamma(p)
  end function ripple_of_power

  subroutine exponentials(self, tolerance, t_min, t_max, weights, rates)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: tolerance, t_min, t_max
    real(wp), allocatable, intent(out) :: weights(:), rates(:)
    real(wp) :: h, fastest, last, x(1), density(1), here(most_slow), mass(most_slow)
    real(wp) :: diagonal(most_slow), beside(most_slow), total, chosen, at_end
    real(wp) :: best_diagonal(most_slow), best_beside(most_slow), best_mass
    integer :: k, n, best, n_fast, n_slow, found

    if (.not. self%tail_power > 0.0_wp) then
      weights = [self%single]
      rates = [self%shift]
      return
    end if
    if (.not. self%sum_at(1.0_wp, t_min) > 0.0_wp) then
      ! Amplitude 0: nothing to stand for.
      weights = [0.0_wp]
      rates = [self%shift]
      return
    end if
    last = t_max
    ! What the factor has taken to nothing needs no care.
    if (self%shift > 0.0_wp) last = max(t_min, min(last, vanished/self%shift))
    h = spacing_for(self, share_of_spacing*tolerance)
    if (h < least_spacing) then
      allocate (weights(0), rates(0))
      return
    end if
    fastest = fastest_rate(self, h, t_min, share_of_end*tolerance*self%sum_at(h, t_min))
    at_end = share_of_end*tolerance*self%sum_at(h, last)
    best = most_fast
    n_fast = most_fast
    n_slow = 1
    chosen = fastest
    best_diagonal = 0.0_wp
    best_beside = 0.0_wp
    best_mass = 0.0_wp
    ! Where poles make the spacing small, steps of the usual one find the end.
    do k = 0, most_fast, max(1, nint(0.3_wp/h))
      if (k + 1 >= best) exit
      if (k == 0 .or. .not. self%self_similar) then
        call tail_recurrence(self, h, fastest - k*h, diagonal, beside, found)
      end if
      x = fastest - k*h
      call self%spectrum(x, density)
      total = tail_mass(self, h, x(1))
      n = nodes_needed(beside, found, last*exp(x(1)), total, at_end)
      if (k + n < best) then
        best = k + n
        n_fast = k
        n_slow = n
        chosen = x(1)
        best_diagonal = diagonal
        best_beside = beside
        best_mass = total
      end if
    end do
    call nodes_of_recurrence(n_slow, best_diagonal(:n_slow), best_beside(:n_slow), &
                             here(:n_slow), mass(:n_slow))
    allocate (weights(n_slow + n_fast), rates(n_slow + n_fast))
    weights(:n_slow) = best_mass*mass(:n_slow)
    rates(:n_slow) = exp(chosen)*max(here(:n_slow), 0.0_wp)
    do k = 1, n_fast
      x = chosen + k*h
      call self%spectrum(x, density)
      weights(n_slow + k) = h*density(1)
      rates(n_slow + k) = exp(x(1))
    end do
    rates = rates + self%shift
  end subroutine exponentials

  !> Largest spacing within a relative error.
  pure real(wp) function spacing_for(self, tolerance) result(h)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: tolerance
    h = 1.5_wp
    do while (self%ripple(h) > tolerance .and. h >= least_spacing)
      h = 0.995_wp*h
    end do
  end function spacing_for

  !> Sum over the whole lattice at t: R(t) but for the factor of the shift.
  real(wp) function sum_at(self, h, t) result(total)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, t
    real(wp), dimension(ceiling(tail_length/h) + 10) :: x, density
    integer :: k

    x = [(5.0_wp - log(t) - (k - 1)*h, k=1, size(x))]
    call self%spectrum(x, density)
    total = h*sum(density*exp(-t*exp(x)))
  end function sum_at

  !> Logarithm of the fastest rate kept: the next one is within the tolerance at
  !! t_min, and those beyond it fall faster than any power.
  real(wp) function fastest_rate(self, h, t_min, allowed) result(x)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, t_min, allowed
    real(wp) :: next(1), density(1)

    x = -log(t_min)
    do
      next = x + h
      call self%spectrum(next, density)
      if (1.1_wp*h*density(1)*exp(-t_min*exp(next(1))) <= allowed) return
      x = x + 0.02_wp
    end do
  end function fastest_rate

  pure integer function tail_nodes(self, h)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h
    tail_nodes = ceiling(merge(0.5_wp, 1.0_wp, self%self_similar)*tail_length/h) + 1
  end function tail_nodes

  !> The tail from x down: rates relative to the fastest, and masses h density. The
  !! last one stands for all slower ones, as a power, at their centre.
  subroutine tail_of(self, h, x, rates, masses)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, x
    real(wp), intent(out) :: rates(:), masses(:)
    real(wp) :: fall
    integer :: k, n

    n = size(masses)
    rates = [(exp(-(k - 1)*h), k=1, n)]
    call self%spectrum([(x - (k - 1)*h, k=1, n)], masses)
    masses = h*masses
    fall = self%tail_power*h
    if (.not. self%self_similar) fall = log(masses(n - 1)/masses(n))
    masses(n) = masses(n)/shrinking(fall)
    rates(n) = rates(n)*shrinking(fall)/shrinking(fall + h)
  end subroutine tail_of

  !> 1 - exp(-x), whose digits a small x would take.
  elemental real(wp) function shrinking(x)
    real(wp), intent(in) :: x
    shrinking = 2.0_wp*exp(-0.5_wp*x)*sinh(0.5_wp*x)
  end function shrinking

  !> Mass of the tail from x down.
  real(wp) function tail_mass(self, h, x) result(total)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, x
    real(wp), dimension(tail_nodes(self, h)) :: rates, masses
    call tail_of(self, h, x, rates, masses)
    total = sum(masses)
  end function tail_mass

  subroutine tail_recurrence(self, h, x, diagonal, beside, found)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, x
    real(wp), intent(out) :: diagonal(most_slow), beside(most_slow)
    integer, intent(out) :: found
    real(wp), dimension(tail_nodes(self, h)) :: rates, masses

    call tail_of(self, h, x, rates, masses)
    call recurrence_of(rates, masses, most_slow, diagonal, beside, found)
  end subroutine tail_recurrence

  !> Fewest Gauss nodes whose error for exp(-z y), y in [0, 1], is allowed.
  pure integer function nodes_needed(beside, found, z, total, allowed) result(n)
    real(wp), intent(in) :: beside(most_slow), z, total, allowed
    integer, intent(in) :: found
    real(wp) :: error

    error = total
    do n = 1, found
      error = error*(z*beside(n))**2/real((2*n - 1)*(2*n), wp)
      if (error <= allowed) return
      if (error > hopeless) exit
    end do
    n = most_fast
  end function nodes_needed

end module viscovib_spectral_kernel
