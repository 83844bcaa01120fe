!> Lines of a signal by weighted least squares: the sums that a step of
!! Gauss-Newton needs, in one pass over the samples.
!!
!! Model u(t) = mean + sum_l a_l cos(omega_l s) + b_l sin(omega_l s), s counted in
!! samples from the middle of the record; weights of Hann, so that what the model
!! lacks disturbs little (frequency analysis after Laskar, Physica D 67 (1993) 257).
module viscovib_line_fit
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_phases, only: split_phase
  use viscovib_vector_math, only: sine_cosine
  implicit none
  private

  public :: line_residual, line_sums

  !> Samples taken at once.
  integer, parameter :: block = 256
  !> Sums kept apart, a divisor of `block`.
  integer, parameter :: lanes = 32

contains

  !> J^T W J, J^T W r and sum W r^2 for the residual r of the model; columns: mean,
  !! a_1, b_1, a_2, ..., then, if frequencies are free, omega_l half the record
  !! long: the parameter omega_l (n-1)/2.
  subroutine line_sums(signal, omega, a, b, mean, n_free, matrix, right, total)
    real(wp), intent(in) :: signal(:)
    !> Circular frequencies in rad a sample, in (0, pi); amplitudes.
    real(wp), intent(in) :: omega(:), a(:), b(:), mean
    !> size(omega) if frequencies are free, else 0.
    integer, intent(in) :: n_free
    !> Shapes (m, m) and (m), m = 1 + 2 size(omega) + n_free.
    real(wp), intent(out) :: matrix(:, :), right(:), total
    real(wp) :: columns(block, size(right)), residual(block), weights(block), middle
    real(wp) :: weighted(block)
    integer :: first, count, i, j, m

    m = size(right)
    matrix = 0.0_wp
    right = 0.0_wp
    total = 0.0_wp
    middle = 0.5_wp*(size(signal) - 1)
    do first = 0, size(signal) - 1, block
      count = min(block, size(signal) - first)
      weights = 0.0_wp
      residual = 0.0_wp
      do i = 1, count
        weights(i) = sin(pi*(first + i - 0.5_wp)/size(signal))**2
        residual(i) = signal(first + i) - mean
      end do
      columns(:, 1) = 1.0_wp
      do j = 1, size(omega)
        call line_columns(omega(j), first - middle, columns(:, 2*j), columns(:, 2*j + 1))
        residual = residual - (a(j)*columns(:, 2*j) + b(j)*columns(:, 2*j + 1))
        if (n_free == 0) cycle
        do i = 1, block
          columns(i, 1 + 2*size(omega) + j) = (first + i - 1 - middle)/max(middle, 1.0_wp) &
                                              *(b(j)*columns(i, 2*j) - a(j)*columns(i, 2*j + 1))
        end do
      end do
      weighted = weights*residual
      total = total + dot(weighted, residual)
      do j = 1, m
        right(j) = right(j) + dot(weighted, columns(:, j))
      end do
      do j = 1, m
        weighted = weights*columns(:, j)
        do i = 1, j
          matrix(i, j) = matrix(i, j) + dot(weighted, columns(:, i))
        end do
      end do
    end do
    do j = 1, m
      matrix(j, :j) = matrix(:j, j)
    end do
  end subroutine line_sums

  !> What the model leaves of the signal.
  subroutine line_residual(signal, omega, a, b, mean, residual)
    real(wp), intent(in) :: signal(:), omega(:), a(:), b(:), mean
    real(wp), intent(out) :: residual(:)
    real(wp) :: cosine(block), sine(block)
    integer :: first, count, j

    residual = signal - mean
    do first = 0, size(signal) - 1, block
      count = min(block, size(signal) - first)
      do j = 1, size(omega)
        call line_columns(omega(j), first - 0.5_wp*(size(signal) - 1), cosine, sine)
        residual(first + 1:first + count) = residual(first + 1:first + count) &
                                            - (a(j)*cosine(:count) + b(j)*sine(:count))
      end do
    end do
  end subroutine line_residual

  !> Sum of products, in as many parts as a vector unit adds at once.
  pure real(wp) function dot(x, y)
    real(wp), intent(in) :: x(block), y(block)
    real(wp) :: parts(lanes)
    integer :: i
    parts = 0.0_wp
    do i = 1, block, lanes
      parts = parts + x(i:i + lanes - 1)*y(i:i + lanes - 1)
    end do
    dot = sum(parts)
  end function dot

  !> cos and sin of omega s at s = start, start + 1, ...; the phase of the start is
  !! taken exactly, so that long records lose no digits.
  subroutine line_columns(omega, start, cosine, sine)
    real(wp), intent(in) :: omega, start
    real(wp), intent(out) :: cosine(block), sine(block)
    real(wp) :: high, low, angles(block), s(block), c(block)
    integer :: i
    call split_phase(omega, start, high, low)
    do i = 1, block
      angles(i) = omega*(i - 1)
    end do
    call sine_cosine(high + angles, s, c)
    cosine = c - s*low
    sine = s + c*low
  end subroutine line_columns

end module viscovib_line_fit
