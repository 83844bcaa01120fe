! Optimize: -O3
!> The harmonics of a periodic solution, the number of samples per period, and the transforms
!! between them (alternating frequency/time method).
!!
!! u(t) = Im sum_k X_k exp(i k nu t), where Im X_0 is the mean. With half-wave symmetry, u(t + T/2)
!! = -u(t), the set contains only odd orders and half a period. A force of degree d in harmonics up
!! to K reaches order dK. A period of N samples aliases it below K only for N <= (d+1)K, so N >
!! (d+1)K prevents aliasing of the included harmonics. For the few dozen samples of a period a table
!! of sines is faster than an FFT, above all for several solutions at once.
module viscovib_harmonic_set
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: lane_product, n_lanes
  implicit none
  private

  public :: harmonic_set_type, new_harmonic_set

  !> Samples per period and order, for forces that are not polynomials.
  integer, parameter, public :: samples_of_laws = 8

  type :: harmonic_set_type
    !> Included orders, ascending.
    integer, allocatable :: orders(:)
    logical :: half_wave = .false.
    !> Samples of half a period (half_wave) or of a period.
    integer :: n_samples = 0
    !> Shape (2*size(orders), n_samples), and the inverse transform.
    real(wp), allocatable :: synthesis(:, :), analysis(:, :)
  contains
    procedure :: to_samples
    procedure :: to_harmonics
    procedure :: sample
    procedure :: held
  end type harmonic_set_type

contains

  !> Number of rows without an equation: the mean has no real part, which is fixed at 0.
  pure integer function held(self)
    class(harmonic_set_type), intent(in) :: self
    held = merge(1, 0, self%orders(1) == 0)
  end function held

  pure subroutine new_harmonic_set(set, highest, half_wave, degree)
    type(harmonic_set_type), intent(out) :: set
    !> Highest order K >= 1; lowered by one if even under half-wave symmetry.
    integer, intent(in) :: highest
    logical, intent(in) :: half_wave
    !> Degree of the force; 0: not a polynomial. Then the number of samples is twice that of a
    !! cubic, with an aliasing error of the order of u^7.
    integer, intent(in) :: degree
    real(wp), allocatable :: sines(:), cosines(:)
    integer :: k, s, i, n, period, j

    set%half_wave = half_wave
    if (half_wave) then
      set%orders = [(k, k=1, highest, 2)]
    else
      set%orders = [(k, k=0, highest)]
    end if
    n = size(set%orders)
    period = merge(degree + 1, samples_of_laws, degree > 0)*set%orders(n) + 1
    if (half_wave) then
      set%n_samples = period/2 + 1
      period = 2*set%n_samples
    else
      set%n_samples = period
    end if
    allocate (set%synthesis(2*n, set%n_samples), set%analysis(set%n_samples, 2*n))
    allocate (sines(0:period - 1), cosines(0:period - 1))
    do j = 0, period - 1
      sines(j) = sin(2.0_wp*pi*j/period)
      cosines(j) = cos(2.0_wp*pi*j/period)
    end do
    do s = 1, set%n_samples
      do i = 1, n
        j = modulo(set%orders(i)*(s - 1), period)
        set%synthesis(2*i - 1, s) = sines(j)
        set%synthesis(2*i, s) = cosines(j)
      end do
    end do
    set%analysis = transpose(set%synthesis)*2.0_wp/set%n_samples
    if (.not. half_wave) set%analysis(:, 1:2) = 0.5_wp*set%analysis(:, 1:2)
  end subroutine new_harmonic_set

  !> Samples of one coordinate from its harmonics.
  pure subroutine to_samples(self, harmonics, samples)
    class(harmonic_set_type), intent(in) :: self
    !> Alternating real and imaginary parts, shape (n_lanes, 2*size(orders)).
    real(wp), intent(in) :: harmonics(n_lanes, 2*size(self%orders))
    real(wp), intent(out) :: samples(n_lanes, self%n_samples)
    call lane_product(2*size(self%orders), self%n_samples, harmonics, self%synthesis, samples)
  end subroutine to_samples

  !> Harmonics of one coordinate from its samples.
  pure subroutine to_harmonics(self, samples, harmonics)
    class(harmonic_set_type), intent(in) :: self
    real(wp), intent(in) :: samples(n_lanes, self%n_samples)
    real(wp), intent(out) :: harmonics(n_lanes, 2*size(self%orders))
    call lane_product(self%n_samples, 2*size(self%orders), samples, self%analysis, harmonics)
  end subroutine to_harmonics

  !> A motion at the samples, followed by the rates of some coordinates.
  pure subroutine sample(self, nu, x, u, rates)
    class(harmonic_set_type), intent(in) :: self
    real(wp), intent(in) :: nu
    !> Harmonics, alternating real and imaginary parts, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Shape (n_samples, n_dof + n_rates).
    real(wp), intent(inout), contiguous :: u(:, :)
    !> No rates if absent or not allocated.
    integer, intent(in), optional :: rates(:)
    real(wp) :: parts(size(x, 1))
    integer :: b
    do b = 1, size(x, 2)
      u(:, b) = matmul(x(:, b), self%synthesis)
    end do
    if (.not. present(rates)) return
    do b = 1, size(rates)
      parts(1::2) = -nu*self%orders*x(2::2, rates(b))
      parts(2::2) = nu*self%orders*x(1::2, rates(b))
      u(:, size(x, 2) + b) = matmul(parts, self%synthesis)
    end do
  end subroutine sample

end module viscovib_harmonic_set
