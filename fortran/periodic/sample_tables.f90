! Optimize: -O3
!> Transforms between the harmonics of one motion and its samples: tables arranged so that each
!! product uses whole vectors for any number of harmonics.
module viscovib_sample_tables
  use viscovib_constants, only: pi
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: sample_tables, new_sample_tables, retain

  !> The number of samples is padded with zeros to a multiple of the first number, the rows of
  !! tables to one of the second.
  integer, parameter :: vector = 4, rows_together = 8

  type :: sample_tables
    !> Padded number of samples; number of real and imaginary parts of the harmonics.
    integer :: n_samples = 0, n_parts = 0
    !> Highest index of a moment, and the difference of orders between two moments.
    integer :: reach = 0, stride = 1
    !> Sines and cosines at the samples, shape (n_samples, n_parts), and the inverse transform,
    !! shape (n_parts, n_samples), both with padded rows.
    real(wp), allocatable, private :: waves(:, :), back(:, :)
    !> Cosines and sines of all orders of a product of two harmonics, over the number of samples,
    !! shape (reach + 1, n_samples) with padded rows.
    real(wp), allocatable, private :: cosines(:, :), sines(:, :)
  contains
    procedure :: to_samples
    procedure :: all_to_samples
    procedure :: to_parts
    procedure :: all_to_parts
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
    allocate (tables%waves(padded(tables%n_samples), tables%n_parts), &
              tables%back(padded(tables%n_parts), tables%n_samples), &
              tables%cosines(padded(tables%reach + 1), tables%n_samples), &
              tables%sines(padded(tables%reach + 1), tables%n_samples), source=0.0_wp)
    tables%waves(:n, :) = transpose(set%synthesis)
    tables%back(:tables%n_parts, :n) = transpose(set%analysis)
    period = merge(2, 1, set%half_wave)*n
    allocate (sines(0:period - 1), cosines(0:period - 1))
    do j = 0, period - 1
      sines(j) = sin(2.0_wp*pi*j/period)/n
      cosines(j) = cos(2.0_wp*pi*j/period)/n
    end do
    do s = 1, n
      do m = 0, tables%reach
        j = modulo(m*tables%stride*(s - 1), period)
        tables%cosines(m + 1, s) = cosines(j)
        tables%sines(m + 1, s) = sines(j)
      end do
    end do
  end subroutine new_sample_tables

  !> The next multiple of `rows_together`.
  pure integer function padded(rows)
    integer, intent(in) :: rows
    padded = ((rows + rows_together - 1)/rows_together)*rows_together
  end function padded

  !> Samples of one coordinate.
  pure subroutine to_samples(self, parts, samples)
    class(sample_tables), intent(in) :: self
    real(wp), intent(in) :: parts(self%n_parts)
    real(wp), intent(out) :: samples(self%n_samples)
    call self%all_to_samples(1, parts, samples)
  end subroutine to_samples

  !> Samples of n coordinates.
  pure subroutine all_to_samples(self, n, parts, samples)
    class(sample_tables), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: parts(self%n_parts, n)
    real(wp), intent(out) :: samples(self%n_samples, n)
    call combine(size(self%waves, 1), self%n_parts, self%waves, n, parts, self%n_samples, samples)
  end subroutine all_to_samples

  !> Harmonics of one coordinate, alternating real and imaginary parts.
  pure subroutine to_parts(self, samples, parts)
    class(sample_tables), intent(in) :: self
    real(wp), intent(in) :: samples(self%n_samples)
    real(wp), intent(out) :: parts(self%n_parts)
    call self%all_to_parts(1, samples, parts)
  end subroutine to_parts

  !> Harmonics of n coordinates.
  pure subroutine all_to_parts(self, n, samples, parts)
    class(sample_tables), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: samples(self%n_samples, n)
    real(wp), intent(out) :: parts(self%n_parts, n)
    call combine(size(self%back, 1), self%n_samples, self%back, n, samples, self%n_parts, parts)
  end subroutine all_to_parts

  !> Mean values of a function times cos and sin of m stride phases, |m| <= reach.
  pure subroutine moments(self, samples, c, s)
    class(sample_tables), intent(in) :: self
    real(wp), intent(in) :: samples(self%n_samples)
    real(wp), intent(out) :: c(-self%reach:self%reach), s(-self%reach:self%reach)
    integer :: m
    call combine_one(size(self%cosines, 1), self%n_samples, self%cosines, samples, &
                     self%reach + 1, c(0))
    call combine_one(size(self%sines, 1), self%n_samples, self%sines, samples, self%reach + 1, s(0))
    do m = 1, self%reach
      c(-m) = c(m)
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

  !> The first n rows of Y = A X.
  pure subroutine combine(rows, m, a, n_columns, x, n, y)
    integer, intent(in) :: rows, m, n_columns, n
    real(wp), intent(in) :: a(rows, m), x(m, n_columns)
    real(wp), intent(out) :: y(n, n_columns)
    integer :: k
    do k = 1, n_columns - 1, 2
      call combine_two(rows, m, a, x(1, k), x(1, k + 1), n, y(1, k), y(1, k + 1))
    end do
    if (mod(n_columns, 2) == 1) then
      call combine_one(rows, m, a, x(1, n_columns), n, y(1, n_columns))
    end if
  end subroutine combine

  !> The first n values of A x. The sums of some rows stay in registers, one of every second column,
  !! so that additions need not wait for each other.
  pure subroutine combine_one(rows, m, a, x, n, y)
    integer, intent(in) :: rows, m, n
    real(wp), intent(in) :: a(rows, m), x(m)
    real(wp), intent(out) :: y(n)
    real(wp), dimension(rows_together) :: odd, even
    integer :: first, last, j, l

    do first = 1, rows, rows_together
      last = first + rows_together - 1
      odd = 0.0_wp
      even = 0.0_wp
      do j = 1, m - 1, 2
        !GCC$ unroll 1
        do l = 1, rows_together
          odd(l) = odd(l) + a(first - 1 + l, j)*x(j)
          even(l) = even(l) + a(first - 1 + l, j + 1)*x(j + 1)
        end do
      end do
      if (mod(m, 2) == 1) odd = odd + a(first:last, m)*x(m)
      odd = odd + even
      if (last <= n) then
        y(first:last) = odd
      else
        y(first:n) = odd(:n - first + 1)
      end if
    end do
  end subroutine combine_one

  !> The same of A x_1 and A x_2.
  pure subroutine combine_two(rows, m, a, x_1, x_2, n, y_1, y_2)
    integer, intent(in) :: rows, m, n
    real(wp), intent(in) :: a(rows, m), x_1(m), x_2(m)
    real(wp), intent(out) :: y_1(n), y_2(n)
    real(wp), dimension(rows_together) :: odd_1, even_1, odd_2, even_2
    integer :: first, last, j, l

    do first = 1, rows, rows_together
      last = first + rows_together - 1
      odd_1 = 0.0_wp
      even_1 = 0.0_wp
      odd_2 = 0.0_wp
      even_2 = 0.0_wp
      do j = 1, m - 1, 2
        !GCC$ unroll 1
        do l = 1, rows_together
          odd_1(l) = odd_1(l) + a(first - 1 + l, j)*x_1(j)
          odd_2(l) = odd_2(l) + a(first - 1 + l, j)*x_2(j)
          even_1(l) = even_1(l) + a(first - 1 + l, j + 1)*x_1(j + 1)
          even_2(l) = even_2(l) + a(first - 1 + l, j + 1)*x_2(j + 1)
        end do
      end do
      if (mod(m, 2) == 1) then
        odd_1 = odd_1 + a(first:last, m)*x_1(m)
        odd_2 = odd_2 + a(first:last, m)*x_2(m)
      end if
      odd_1 = odd_1 + even_1
      odd_2 = odd_2 + even_2
      if (last <= n) then
        y_1(first:last) = odd_1
        y_2(first:last) = odd_2
      else
        y_1(first:n) = odd_1(:n - first + 1)
        y_2(first:n) = odd_2(:n - first + 1)
      end if
    end do
  end subroutine combine_two

end module viscovib_sample_tables
