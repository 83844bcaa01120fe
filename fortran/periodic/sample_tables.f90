!> Transforms between the harmonics of one motion and its samples: tables arranged so that each
!! product uses whole vectors for any number of harmonics.
module viscovib_sample_tables
  use viscovib_constants, only: pi
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: sample_tables, new_sample_tables, retain

  !> The number of samples is padded with zeros to a multiple of this.
  integer, parameter :: vector = 4

  type :: sample_tables
    !> Padded number of samples; number of real and imaginary parts of the harmonics.
    integer :: n_samples = 0, n_parts = 0
    !> Highest index of a moment, and the difference of orders between two moments.
    integer :: reach = 0, stride = 1
    !> Sines and cosines at the samples, shape (n_samples, n_parts), and the inverse transform,
    !! shape (n_parts, n_samples).
    real(wp), allocatable, private :: waves(:, :), back(:, :)
    !> Cosines, then sines, of all orders of a product of two harmonics, over the number
    !! of samples, shape (2 (reach + 1), n_samples).
    real(wp), allocatable, private :: folded(:, :)
  contains
    procedure :: to_samples
    procedure :: to_parts
    procedure :: moments
  end type sample_tables

contains

  pure subroutine new_sample_tables(tables, set)
    type(sample_tables), intent(out) :: tables
    type(harmonic_set_type), intent(in) :: set
    real(wp), allocatable :: sines(:), cosines(:)
    integer :: j, m, s, n, period

    n = set%n_samples
    tables%n_samples = ((n + vector - 1)/vector)*vector
    tables%n_parts = 2*size(set%orders)
    tables%stride = merge(2, 1, set%half_wave)
    tables%reach = 2*maxval(set%orders)/tables%stride
    allocate (tables%waves(tables%n_samples, tables%n_parts), &
              tables%back(tables%n_parts, tables%n_samples), &
              tables%folded(2*(tables%reach + 1), tables%n_samples), source=0.0_wp)
    tables%waves(:n, :) = transpose(set%synthesis)
    tables%back(:, :n) = transpose(set%analysis)
    period = merge(2, 1, set%half_wave)*n
    allocate (sines(0:period - 1), cosines(0:period - 1))
    do j = 0, period - 1
      sines(j) = sin(2.0_wp*pi*j/period)/n
      cosines(j) = cos(2.0_wp*pi*j/period)/n
    end do
    do s = 1, n
      do m = 0, tables%reach
        j = modulo(m*tables%stride*(s - 1), period)
        tables%folded(m + 1, s) = cosines(j)
        tables%folded(tables%reach + m + 2, s) = sines(j)
      end do
    end do
  end subroutine new_sample_tables

  !> Samples of one coordinate.
  pure subroutine to_samples(self, parts, samples)
    class(sample_tables), intent(in) :: self
    real(wp), intent(in) :: parts(self%n_parts)
    real(wp), intent(out) :: samples(self%n_samples)
    call combine(self%n_samples, self%n_parts, self%waves, parts, samples)
  end subroutine to_samples

  !> Harmonics of one coordinate, alternating real and imaginary parts.
  pure subroutine to_parts(self, samples, parts)
    class(sample_tables), intent(in) :: self
    real(wp), intent(in) :: samples(self%n_samples)
    real(wp), intent(out) :: parts(self%n_parts)
    call combine(self%n_parts, self%n_samples, self%back, samples, parts)
  end subroutine to_parts

  !> Mean values of a function times cos and sin of m stride phases, |m| <= reach.
  pure subroutine moments(self, samples, c, s)
    class(sample_tables), intent(in) :: self
    real(wp), intent(in) :: samples(self%n_samples)
    real(wp), intent(out) :: c(-self%reach:self%reach), s(-self%reach:self%reach)
    real(wp) :: both(2*(self%reach + 1))
    integer :: m
    call combine(2*(self%reach + 1), self%n_samples, self%folded, samples, both)
    do m = 0, self%reach
      c(m) = both(m + 1)
      c(-m) = c(m)
      s(m) = both(self%reach + m + 2)
      s(-m) = -s(m)
    end do
  end subroutine moments

  !> Multiply pairs of real and imaginary parts by complex numbers.
  pure subroutine retain(fraction, parts)
    complex(wp), intent(in) :: fraction(:)
    real(wp), intent(inout) :: parts(2*size(fraction))
    real(wp) :: re
    integer :: k
    do k = 1, size(fraction)
      re = real(fraction(k))*parts(2*k - 1) - aimag(fraction(k))*parts(2*k)
      parts(2*k) = real(fraction(k))*parts(2*k) + aimag(fraction(k))*parts(2*k - 1)
      parts(2*k - 1) = re
    end do
  end subroutine retain

  !> y = A x, four columns at a time.
  pure subroutine combine(n, m, a, x, y)
    integer, intent(in) :: n, m
    real(wp), intent(in) :: a(n, m), x(m)
    real(wp), intent(out) :: y(n)
    integer :: i, j, rest

    rest = mod(m, 4)
    y = 0.0_wp
    do j = 1, rest
      do i = 1, n
        y(i) = y(i) + a(i, j)*x(j)
      end do
    end do
    do j = rest + 1, m, 4
      do i = 1, n
        y(i) = y(i) + (a(i, j)*x(j) + a(i, j + 1)*x(j + 1)) &
               + (a(i, j + 2)*x(j + 2) + a(i, j + 3)*x(j + 3))
      end do
    end do
  end subroutine combine

end module viscovib_sample_tables
