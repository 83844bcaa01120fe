! Optimize: -O3
!> How many orders Hill's determinant keeps, by the error that is left.
module viscovib_hill_reach
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: highest_order, norm, norms_of_waves

  !> Unknowns of a determinant at most.
  integer, parameter, public :: max_unknowns = 360
  !> Orders are kept until what reaches the next ones is this small: exponents feel its square.
  real(wp), parameter :: accurate = 1.0e-5_wp
  !> Fourier coefficients of the stiffness that are small compared with its mean have no effect.
  real(wp), parameter :: silent = 1.0e-11_wp

contains

  !> Highest order: beyond the fastest rate along the motion, and until a disturbance of order 1
  !! there hardly reaches the next,
  !!
  !!   Y_k = f_k sum_m |K_m| Y_(k - m)/[(k nu)^2 - f_k |K_0|],
  !!
  !! the stiffness K divided by the mass, and f_k what memory makes of it where that is more. What
  !! lies beyond acts on exponents by the square of that: there and back.
  subroutine highest_order(system, kernel_of_group, nu, stride, fastest, waves, highest)
    class(oscillator_type), intent(in) :: system
    !> Kernel of each group of hereditary variables; 0: none.
    integer, intent(in) :: kernel_of_group(:)
    !> Frequency (rad/s), from order to order, and the fastest rate (rad/s).
    real(wp), intent(in) :: nu, fastest
    integer, intent(in) :: stride
    !> Norms of K_m, orders stride m, m = 0, 1, ... (rad^2/s^2).
    real(wp), intent(in) :: waves(0:)
    !> Beyond `max_unknowns` where these are not enough.
    integer, intent(out) :: highest
    real(wp) :: reached(2*max_unknowns), beyond, more, before
    integer :: i, m, top

    top = findloc(waves(1:) > silent*waves(0), .true., 1, back=.true.)
    highest = ceiling(fastest/nu + 0.5_wp*stride)
    if (stride == 2 .and. mod(highest, 2) == 0) highest = highest + 1
    do while (highest <= max_unknowns)
      more = swelling(system, kernel_of_group, highest*nu)
      if (highest*nu >= fastest*sqrt(more)) exit
      highest = highest + stride
    end do
    if (highest > max_unknowns) return
    do i = 1, size(reached)
      beyond = ((highest + i*stride)*nu)**2 - more*waves(0)
      reached(i) = 0.0_wp
      do m = 1, top
        before = merge(reached(max(i - m, 1)), 1.0_wp, m < i)
        ! Of large motions it grows by factors for many orders.
        reached(i) = min(reached(i) + waves(m)*(more/beyond)*before, 1.0e100_wp)
      end do
      ! None of these reaches further.
      if (all(reached(max(i - top + 1, 1):i) <= accurate)) exit
    end do
    highest = highest + stride*findloc(reached(:min(i, size(reached))) > accurate, .true., 1, &
                                       back=.true.)
  end subroutine highest_order

  !> By how much memory makes a stiffness larger at a frequency (rad/s), 1 at least.
  real(wp) function swelling(system, kernel_of_group, nu) result(factor)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: kernel_of_group(:)
    real(wp), intent(in) :: nu
    complex(wp) :: s(1), kept(1)
    integer :: q

    s = cmplx(0.0_wp, nu, wp)
    factor = 1.0_wp
    do q = 1, size(kernel_of_group)
      if (kernel_of_group(q) == 0) cycle
      call system%kernels(kernel_of_group(q))%laplace(s, kept)
      factor = max(factor, abs(1.0_wp - kept(1)))
    end do
  end function swelling

  !> Norms of the Fourier coefficients of a matrix along a (half) period, m = 0, 1, ...
  subroutine norms_of_waves(phases, matrix, norms)
    !> exp(-2 pi i m/n)/n at m = 0, 1, ..., n - 1.
    complex(wp), intent(in) :: phases(0:)
    !> Shape (n_dof, n_dof, n).
    real(wp), intent(in) :: matrix(:, :, :)
    real(wp), intent(out) :: norms(0:)
    complex(wp) :: wave(size(matrix, 1), size(matrix, 2))
    integer :: m, s, n

    n = size(matrix, 3)
    do m = 0, ubound(norms, 1)
      wave = (0.0_wp, 0.0_wp)
      do s = 1, n
        wave = wave + matrix(:, :, s)*phases(modulo(m*(s - 1), n))
      end do
      norms(m) = norm(wave)
    end do
  end subroutine norms_of_waves

  !> A bound of how much longer a vector becomes: the smaller one of two.
  pure real(wp) function norm(matrix)
    complex(wp), intent(in) :: matrix(:, :)
    norm = min(maxval(sum(abs(matrix), 2)), sqrt(sum(abs(matrix)**2)))
  end function norm

end module viscovib_hill_reach
