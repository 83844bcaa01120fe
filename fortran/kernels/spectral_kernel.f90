! Optimize: -O3
!> Kernels with a relaxation spectrum, and their approximation by short sums of exponentials.
!!
!!   R(t) = exp(-shift t) integral density(x) exp(-t exp(x)) dx,  x = ln(rate).
!!
!! The trapezoidal rule with spacing h gives weights h density(x_k) > 0 and an error that oscillates
!! evenly in ln(t) (Beylkin and Monzon, Appl. Comput. Harmon. Anal. 28, 2010). Its slowest nodes
!! have rates that are not resolved on [t_min, t_max]. This tail is a positive measure on [0,
!! lambda_0] and is replaced by a Gauss rule of few nodes. There exp(-t lambda) is nearly a
!! polynomial and the error of the rule is known:
!!   t^(2n)/(2n)! times the squared norm of the n-th orthogonal polynomial.
!! A density with a sharp peak (poles close to the real axis) uses a lattice refined there:
!! u = d + peak_reach asinh(d/peak_width), d = x - centre. It moves the poles at d = +-i peak_width
!! to Im u > peak_reach pi/2, where they do not affect the rule. For t^(-0.9) on [1e-4, 1e4] this
!! takes 38, 59 and 75 terms for 1e-6, 1e-10 and 1e-13, a tenth more than optimal sums, without
!! optimization.
module viscovib_spectral_kernel
  use viscovib_constants, only: half_pi, pi
  use viscovib_kernel, only: kernel_type, shrinking, vanished
  use viscovib_kinds, only: wp
  use viscovib_quadrature, only: nodes_of_recurrence, recurrence_of
  implicit none
  private

  public :: spectral_kernel_type, ripple_of_power

  !> Lattice units gained on either side of a peak, for each factor e of its width.
  real(wp), parameter, public :: peak_reach = 1.1_wp

  type, abstract, extends(kernel_type) :: spectral_kernel_type
    !> The density decays like exp(tail_power x) towards slow rates. 0: the only rate is the shift,
    !! with the weight `single`.
    real(wp) :: tail_power = 0.0_wp, single = 0.0_wp
    !> Rate of the common exponential factor (1/s).
    real(wp) :: shift = 0.0_wp
    !> True if the density is this power everywhere.
    logical :: self_similar = .false.
    !> Location (logarithm of a rate) and width of a sharp peak of the density; width 0: none.
    real(wp) :: centre = 0.0_wp, peak_width = 0.0_wp
  contains
    procedure :: exponentials
    procedure(spectrum_interface), deferred :: spectrum
    procedure(ripple_interface), deferred :: ripple
    procedure, private :: sum_at
    procedure, private :: lattice
  end type spectral_kernel_type

  abstract interface

    subroutine spectrum_interface(self, x, density)
      import :: spectral_kernel_type, wp
      class(spectral_kernel_type), intent(in) :: self
      !> Logarithms of rates, relative to `centre`.
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

  !> Fractions of the tolerance for the spacing and for each end.
  real(wp), parameter :: share_of_spacing = 0.7_wp, share_of_end = 0.15_wp
  !> Largest number of nodes of the Gauss rule. `tail_length`: length of the tail in units of x;
  !! half of it suffices for a power, whose remainder is known.
  integer, parameter :: most_slow = 16
  !> More terms than any spacing and time range need.
  integer, parameter :: most_fast = 100000
  real(wp), parameter :: tail_length = 40.0_wp
  !> An error bound above this value does not decrease again.
  real(wp), parameter :: hopeless = 1.0e200_wp
  !> A density that needs a smaller spacing has no sum.
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
    real(wp), allocatable :: place(:), masses(:)
    real(wp) :: h, fastest, last, here(most_slow), mass(most_slow)
    real(wp) :: diagonal(most_slow), nearby(most_slow), total, at_end
    real(wp) :: best_diagonal(most_slow), best_nearby(most_slow), best_mass
    integer :: k, n, best, n_fast, n_slow, found, n_tail

    if (.not. self%tail_power > 0.0_wp) then
      weights = [self%single]
      rates = [self%shift]
      return
    end if
    if (.not. self%sum_at(1.0_wp, t_min) > 0.0_wp) then
      ! Amplitude 0: the kernel is 0.
      weights = [0.0_wp]
      rates = [self%shift]
      return
    end if
    last = t_max
    ! Times at which the common factor has vanished are ignored.
    if (self%shift > 0.0_wp) last = max(t_min, min(last, vanished/self%shift))
    h = spacing_for(self, share_of_spacing*tolerance)
    if (h < least_spacing) then
      allocate (weights(0), rates(0))
      return
    end if
    fastest = fastest_place(self, h, t_min, share_of_end*tolerance*self%sum_at(h, t_min))
    at_end = share_of_end*tolerance*self%sum_at(h, last)
    n_tail = tail_nodes(self, h)
    n = ceiling((fastest - place_of(self, -log(last) - self%centre - tail_length))/h)
    allocate (place(0:n + n_tail), masses(0:n + n_tail))
    call self%lattice(h, fastest, place, masses)
    best = most_fast
    n_fast = most_fast
    n_slow = 1
    best_diagonal = 0.0_wp
    best_nearby = 0.0_wp
    best_mass = 0.0_wp
    do k = 0, ubound(place, 1) - n_tail
      if (k + 1 >= best) exit
      associate (at => place(k:k + n_tail - 1), held => masses(k:k + n_tail - 1))
        if (k == 0 .or. .not. self%self_similar) then
          call tail_recurrence(self, h, at, held, diagonal, nearby, found)
        end if
        total = tail_mass(self, h, at, held)
      end associate
      n = nodes_needed(nearby, found, last*exp(self%centre + place(k)), total, at_end)
      if (k + n < best) then
        best = k + n
        n_fast = k
        n_slow = n
        best_diagonal = diagonal
        best_nearby = nearby
        best_mass = total
      end if
    end do
    if (best == most_fast) then
      ! No sum exists: masses overflow or underflow.
      allocate (weights(0), rates(0))
      return
    end if
    call nodes_of_recurrence(n_slow, best_diagonal(:n_slow), best_nearby(:n_slow), &
                             here(:n_slow), mass(:n_slow))
    allocate (weights(n_slow + n_fast), rates(n_slow + n_fast))
    weights(:n_slow) = best_mass*mass(:n_slow)
    rates(:n_slow) = exp(self%centre + place(n_fast))*max(here(:n_slow), 0.0_wp)
    weights(n_slow + 1:) = masses(n_fast - 1:0:-1)
    rates(n_slow + 1:) = exp(self%centre + place(n_fast - 1:0:-1))
    rates = rates + self%shift
  end subroutine exponentials

  !> Lattice coordinate u of a logarithm of a rate, relative to the center.
  elemental real(wp) function place_of(self, d) result(u)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: d
    u = d
    if (self%peak_width > 0.0_wp) u = d + peak_reach*asinh(d/self%peak_width)
  end function place_of

  !> Logarithms of rates, relative to the center, at u = from, from - h, ..., and the masses h
  !! density dx/du there. With d = w sinh(s), the function w sinh(s) + peak_reach s is convex for
  !! s > 0, so Newton's method converges monotonically from above.
  subroutine lattice(self, h, from, place, masses)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, from
    real(wp), intent(out) :: place(:), masses(:)
    real(wp) :: u, s, step
    integer :: i, k

    if (self%peak_width > 0.0_wp) then
      associate (w => self%peak_width)
        do i = 1, size(place)
          u = from - (i - 1)*h
          s = min(asinh(abs(u)/w), abs(u)/(w + peak_reach))
          do k = 1, 60
            step = (w*sinh(s) + peak_reach*s - abs(u))/(w*cosh(s) + peak_reach)
            s = s - step
            if (step <= 1.0e-15_wp*s) exit
          end do
          place(i) = sign(w*sinh(s), u)
        end do
        call self%spectrum(place, masses)
        masses = h*masses/(1.0_wp + peak_reach/hypot(place, w))
      end associate
    else
      place = [(from - (i - 1)*h, i=1, size(place))]
      call self%spectrum(place, masses)
      masses = h*masses
    end if
  end subroutine lattice

  !> Largest spacing within a relative error.
  pure real(wp) function spacing_for(self, tolerance) result(h)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: tolerance
    h = 1.5_wp
    do while (self%ripple(h) > tolerance .and. h >= least_spacing)
      h = 0.995_wp*h
    end do
  end function spacing_for

  !> Sum over the whole lattice at t: R(t) without the factor of the shift.
  real(wp) function sum_at(self, h, t) result(total)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, t
    real(wp), allocatable :: place(:), masses(:)
    real(wp) :: first
    integer :: n

    first = 5.0_wp - log(t) - self%centre
    n = ceiling((place_of(self, first) - place_of(self, first - tail_length))/h) + 10
    allocate (place(n), masses(n))
    call self%lattice(h, place_of(self, first), place, masses)
    total = sum(masses*exp(-t*exp(self%centre + place)))
  end function sum_at

  !> Lattice coordinate of the fastest rate. The contribution of the next rate at t_min is within
  !! the tolerance, and further contributions decrease faster than any power.
  real(wp) function fastest_place(self, h, t_min, allowed) result(u)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, t_min, allowed
    real(wp) :: next(1), mass(1)

    u = place_of(self, -log(t_min) - self%centre)
    do
      call self%lattice(h, u + h, next, mass)
      if (1.1_wp*mass(1)*exp(-t_min*exp(self%centre + next(1))) <= allowed) return
      u = u + 0.02_wp
    end do
  end function fastest_place

  pure integer function tail_nodes(self, h)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h
    tail_nodes = ceiling(merge(0.5_wp, 1.0_wp, self%self_similar)*tail_length/h) + 1
  end function tail_nodes

  !> Tail of the lattice: rates relative to the fastest one, and masses. The last entry represents
  !! all slower rates, as a power, at their center of mass.
  subroutine tail_of(self, h, place, held, rates, masses)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, place(:), held(:)
    real(wp), intent(out) :: rates(:), masses(:)
    real(wp) :: fall
    integer :: n

    n = size(masses)
    rates = exp(place - place(1))
    masses = held
    fall = self%tail_power*h
    if (.not. self%self_similar) then
      ! Underflowing masses have no ratio.
      if (masses(n) > tiny(fall)) fall = log(masses(n - 1)/masses(n))
    end if
    masses(n) = masses(n)/shrinking(fall)
    rates(n) = rates(n)*shrinking(fall)/shrinking(fall + h)
  end subroutine tail_of

  !> Mass of a tail.
  real(wp) function tail_mass(self, h, place, held) result(total)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, place(:), held(:)
    real(wp), dimension(size(place)) :: rates, masses
    call tail_of(self, h, place, held, rates, masses)
    total = sum(masses)
  end function tail_mass

  subroutine tail_recurrence(self, h, place, held, diagonal, nearby, found)
    class(spectral_kernel_type), intent(in) :: self
    real(wp), intent(in) :: h, place(:), held(:)
    real(wp), intent(out) :: diagonal(most_slow), nearby(most_slow)
    integer, intent(out) :: found
    real(wp), dimension(size(place)) :: rates, masses

    call tail_of(self, h, place, held, rates, masses)
    call recurrence_of(rates, masses, most_slow, diagonal, nearby, found)
  end subroutine tail_recurrence

  !> Fewest Gauss nodes whose error for exp(-z y), y in [0, 1], is allowed.
  pure integer function nodes_needed(nearby, found, z, total, allowed) result(n)
    real(wp), intent(in) :: nearby(most_slow), z, total, allowed
    integer, intent(in) :: found
    real(wp) :: error

    error = total
    do n = 1, found
      error = error*(z*nearby(n))**2/real((2*n - 1)*(2*n), wp)
      if (error <= allowed) return
      if (error > hopeless) exit
    end do
    n = most_fast
  end function nodes_needed

end module viscovib_spectral_kernel
