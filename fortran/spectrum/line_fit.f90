! Optimize: -O3
!> Lines of a signal by weighted least squares: the sums of a Gauss-Newton step,
!! in one pass over the samples.
!!
!! Model u(t) = mean + sum_l E_l (a_l cos(omega_l s) + b_l sin(omega_l s)), with s in
!! samples from the middle of the record. The envelope E_l = exp(-decay_l k) of a decaying line
!! counts samples k from the first one, that of a growing line from the
!! last one, so that it is at most 1. Hann weights reduce the influence of parts that the model
!! does not contain (frequency analysis after Laskar, Physica D 67 (1993) 257).
module viscovib_line_fit
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_phases, only: split_phase
  use viscovib_vector_math, only: sine_cosine_array
  implicit none
  private

  public :: line_residual, line_sums, lines_type, new_lines

  !> Lines of a signal, each array of shape (n_lines).
  type :: lines_type
    !> Circular frequencies in rad per sample, in (0, pi).
    real(wp), allocatable :: omega(:)
    !> Decay rates per sample; negative for a growing line.
    real(wp), allocatable :: decay(:)
    !> Amplitudes where the envelope is 1.
    real(wp), allocatable :: a(:), b(:)
    real(wp) :: mean
  end type lines_type

  !> Samples processed at once.
  integer, parameter :: block = 256
  !> Number of separate sums, a divisor of `block`.
  integer, parameter :: lanes = 32

contains

  !> Lines from a table, shape (4, n_lines): omega, decay, a, b of each.
  pure subroutine new_lines(lines, table, mean)
    type(lines_type), intent(out) :: lines
    real(wp), intent(in) :: table(:, :), mean
    allocate (lines%omega, source=table(1, :))
    allocate (lines%decay, source=table(2, :))
    allocate (lines%a, source=table(3, :))
    allocate (lines%b, source=table(4, :))
    lines%mean = mean
  end subroutine new_lines

  !> J^T W J, J^T W r and sum W r^2 for the residual r of the model; columns: mean,
  !! a_1, b_1, a_2, ..., then, if frequencies are free, omega_l (n-1)/2 as parameters; then
  !! likewise the free decay rates.
  subroutine line_sums(signal, lines, n_free, free_decay, matrix, right, total)
    real(wp), intent(in) :: signal(:)
    type(lines_type), intent(in) :: lines
    !> Number of lines if frequencies are free, else 0.
    integer, intent(in) :: n_free
    !> Indices of the lines with a free decay rate.
    integer, intent(in) :: free_decay(:)
    !> Shapes (m, m) and (m), m = 1 + 2 n_lines + n_free + size(free_decay).
    real(wp), intent(out) :: matrix(:, :), right(:), total
    real(wp) :: columns(block, size(right)), residual(block), weights(block), middle
    real(wp) :: angles(block), weighted(block)
    integer :: first, count, i, j, l, m, n_lines

    m = size(right)
    n_lines = size(lines%omega)
    matrix = 0.0_wp
    right = 0.0_wp
    total = 0.0_wp
    middle = 0.5_wp*(size(signal) - 1)
    do first = 0, size(signal) - 1, block
      count = min(block, size(signal) - first)
      do i = 1, block
        angles(i) = (pi/size(signal))*min(first + i - 0.5_wp, real(size(signal), wp))
      end do
      call sine_cosine_array(angles, weights, weighted)
      weights(:count) = weights(:count)**2
      weights(count + 1:) = 0.0_wp
      residual(:count) = signal(first + 1:first + count) - lines%mean
      residual(count + 1:) = 0.0_wp
      columns(:, 1) = 1.0_wp
      do j = 1, n_lines
        associate (c => columns(:, 2*j), s => columns(:, 2*j + 1))
          call line_columns(lines%omega(j), lines%decay(j), first, size(signal), c, s)
          residual = residual - (lines%a(j)*c + lines%b(j)*s)
          if (n_free == 0) cycle
          do i = 1, block
            columns(i, 1 + 2*n_lines + j) = (first + i - 1 - middle)/max(middle, 1.0_wp) &
                                            *(lines%b(j)*c(i) - lines%a(j)*s(i))
          end do
        end associate
      end do
      do l = 1, size(free_decay)
        j = free_decay(l)
        do i = 1, block
          columns(i, 1 + 2*n_lines + n_free + l) = &
            -(first + i - 1 - origin(lines%decay(j), size(signal)))/max(middle, 1.0_wp) &
            *(lines%a(j)*columns(i, 2*j) + lines%b(j)*columns(i, 2*j + 1))
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

  !> Signal minus model.
  subroutine line_residual(signal, lines, residual)
    real(wp), intent(in) :: signal(:)
    type(lines_type), intent(in) :: lines
    !> Shape (n), as the signal.
    real(wp), intent(out) :: residual(:)
    real(wp) :: c(block), s(block)
    integer :: first, count, j

    residual = signal - lines%mean
    do first = 0, size(signal) - 1, block
      count = min(block, size(signal) - first)
      do j = 1, size(lines%omega)
        call line_columns(lines%omega(j), lines%decay(j), first, size(signal), c, s)
        residual(first + 1:first + count) = residual(first + 1:first + count) &
                                            - (lines%a(j)*c(:count) + lines%b(j)*s(:count))
      end do
    end do
  end subroutine line_residual

  !> Sum of products, in separate parts for the vector unit.
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

  !> Envelope times cos and sin of omega s of the samples first, first + 1, ..., counted
  !! from 0; the phase at the start is computed in two parts, so that long records lose no digits.
  subroutine line_columns(omega, decay, first, n, cosine, sine)
    real(wp), intent(in) :: omega, decay
    integer, intent(in) :: first, n
    real(wp), intent(out) :: cosine(block), sine(block)
    real(wp) :: high, low, angles(block), s(block), c(block), envelope
    integer :: i
    call split_phase(omega, first - 0.5_wp*(n - 1), high, low)
    do i = 1, block
      angles(i) = omega*(i - 1)
    end do
    call sine_cosine_array(high + angles, s, c)
    cosine = c - s*low
    sine = s + c*low
    if (abs(decay) <= 0.0_wp) return
    do i = 1, block
      ! Positions after the record have no weight: they must only stay finite.
      envelope = exp(min(-decay*(first + i - 1 - origin(decay, n)), 0.0_wp))
      cosine(i) = cosine(i)*envelope
      sine(i) = sine(i)*envelope
    end do
  end subroutine line_columns

  !> Sample at which the envelope of a line is 1: the first, or the last of a growing line.
  pure real(wp) function origin(decay, n)
    real(wp), intent(in) :: decay
    integer, intent(in) :: n
    origin = 0.0_wp
    if (decay < 0.0_wp) origin = n - 1.0_wp
  end function origin

end module viscovib_line_fit
