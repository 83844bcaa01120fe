!> Slopes of force laws along a motion as Fourier sums that the samples of a period resolve.
!!
!! A slope that jumps at a kink, or varies within a sample, has harmonics that alias: an error of
!! one sample in the phase of the jump. So its Fourier coefficients are integrated between the
!! kinks, over pieces that are halved until sixteen Gauss points resolve them. The samples are
!! replaced by those of the resolved harmonics.
module viscovib_slope_waves
  use viscovib_constants, only: pi
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: find_signals
  use viscovib_law_cycle, only: find_switches
  use viscovib_law_program, only: law_program
  use viscovib_law_term, only: law_term
  use viscovib_oscillator, only: oscillator_type
  use viscovib_phase_panels, only: add_moments, is_resolved, longest_panel, motion_at, nodes, &
                                   panel_type, panel_walk
  use viscovib_phase_roots, only: phase_list
  use viscovib_polynomial, only: polynomial_type
  implicit none
  private

  public :: hold_waves

  !> Largest relative size of the highest harmonics of the samples; largest number of pieces,
  !! relative to the number of longest pieces.
  real(wp), parameter :: silent = 1.0e-10_wp
  integer, parameter :: most_tries = 8

contains

  !> Replace samples of slopes that alias.
  subroutine hold_waves(system, set, mu, x, u, slopes)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    !> Frequencies of the orders, harmonics, shape (2 n_orders, n_dof), and samples of coordinates
    !! and rates.
    real(wp), intent(in) :: mu(:), x(:, :), u(:, :)
    !> Derivatives of the hereditary variables, shape (n_samples, n_memory, n_dof + n_rates).
    real(wp), intent(inout) :: slopes(:, :, :)
    integer :: i

    select type (system)
    class is (polynomial_type)
      do i = 1, size(system%laws)
        if (system%laws(i)%state == 0) call hold_law(system%laws(i), set, mu, x, u, slopes)
      end do
    end select
  end subroutine hold_waves

  !> Replace the samples of one law.
  subroutine hold_law(law, set, mu, x, u, slopes)
    type(law_term), intent(in) :: law
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: mu(:), x(:, :), u(:, :)
    real(wp), intent(inout) :: slopes(:, :, :)
    real(wp), allocatable :: change(:, :)
    integer :: b, j

    call find_change(law, set, mu, x, u, change)
    if (.not. allocated(change)) return
    do b = 1, size(slopes, 3)
      do j = 1, size(law%variables)
        slopes(:, law%variables(j), b) = slopes(:, law%variables(j), b) &
                                         + law%weights(j)*matmul(change, law%seen(:, b))
      end do
    end do
  end subroutine hold_law

  !> Change of the derivatives of a law by its arguments at the samples; not allocated if the
  !! samples are sufficient.
  subroutine find_change(law, set, mu, x, u, change)
    type(law_term), intent(in) :: law
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: mu(:), x(:, :), u(:, :)
    !> Shape (n_samples, n_arguments).
    real(wp), allocatable, intent(out) :: change(:, :)
    type(law_program), allocatable :: signals(:)
    type(phase_list) :: breaks
    real(wp), dimension(size(u, 1), size(law%seen, 1)) :: scan, sampled
    real(wp) :: f(size(u, 1)), y(size(x, 1), size(law%seen, 1)), fast(size(x, 1), size(law%seen, 1))
    real(wp), allocatable :: c(:, :), s(:, :)
    real(wp) :: phase
    integer :: i, k, n, most, none(0)

    n = size(u, 1)
    most = (n - 1)/2
    scan = matmul(u, transpose(law%seen))
    call law%program%differentiate(scan, f, sampled)
    call find_signals(law%program, none, signals)
    if (size(signals) == 0 .and. is_complete(sampled)) return
    fast = matmul(x, transpose(law%rates))
    y = matmul(x, transpose(law%arguments))
    y(1::2, :) = y(1::2, :) - spread(mu, 2, size(y, 2))*fast(2::2, :)
    y(2::2, :) = y(2::2, :) + spread(mu, 2, size(y, 2))*fast(1::2, :)
    call find_switches(signals, set, y, scan, breaks)
    allocate (c(0:most, size(y, 2)), s(0:most, size(y, 2)), source=0.0_wp)
    call integrate(law%program, set, y, breaks, maxval(abs(sampled)), c, s)
    allocate (change(n, size(y, 2)))
    do i = 1, n
      change(i, :) = c(0, :) - sampled(i, :)
      do k = 1, most
        phase = 2.0_wp*pi*modulo(k*(i - 1), n)/n
        change(i, :) = change(i, :) + 2.0_wp*(c(k, :)*cos(phase) + s(k, :)*sin(phase))
      end do
    end do
  end subroutine find_change

  !> True if the highest harmonics of samples are so small that aliasing is negligible.
  pure logical function is_complete(sampled)
    real(wp), intent(in) :: sampled(:, :)
    complex(wp) :: wave(size(sampled, 2))
    real(wp) :: phase
    integer :: i, k, n

    n = size(sampled, 1)
    is_complete = .false.
    do k = max(1, (n - 1)/2 - 3), (n - 1)/2
      wave = (0.0_wp, 0.0_wp)
      do i = 1, n
        phase = 2.0_wp*pi*modulo(k*(i - 1), n)/n
        wave = wave + sampled(i, :)*cmplx(cos(phase), -sin(phase), wp)
      end do
      if (any(abs(wave) > silent*n*maxval(abs(sampled)))) return
    end do
    is_complete = .true.
  end function is_complete

  !> Mean values of the derivatives times the cosines and sines of the period.
  subroutine integrate(program, set, y, breaks, size_of, c, s)
    type(law_program), intent(in) :: program
    type(harmonic_set_type), intent(in) :: set
    !> Harmonics of the arguments, shape (n_parts, n_arguments), and phases of possible jumps.
    real(wp), intent(in) :: y(:, :)
    type(phase_list), intent(in) :: breaks
    real(wp), intent(in) :: size_of
    !> Shape (0:most, n_arguments).
    real(wp), intent(inout) :: c(0:, :), s(0:, :)
    type(panel_type) :: panel
    type(panel_walk) :: walk
    real(wp) :: arguments(nodes, size(y, 2)), f(nodes), by(nodes, size(y, 2)), largest
    integer :: m, top

    top = max(1, maxval(set%orders))
    walk = panel_walk(ending=merge(pi, 2.0_wp*pi, set%half_wave), ends=breaks, &
                      longest=longest_panel(set)*top &
                      /(top + merge(2, 1, set%half_wave)*ubound(c, 1)))
    walk%tries = walk%tries - 1 + most_tries*(ceiling(walk%ending/walk%longest) + breaks%n)
    largest = size_of
    do while (walk%next(set, panel))
      do m = 1, size(y, 2)
        arguments(:, m) = motion_at(panel, y(:, m))
      end do
      call program%differentiate(arguments, f, by)
      walk%accepted = walk%is_last_try()
      if (.not. walk%accepted) then
        walk%accepted = all([(is_resolved(by(:, m), largest), m=1, size(y, 2))])
        if (.not. walk%accepted) cycle
      end if
      largest = max(largest, maxval(abs(by)))
      do m = 1, size(y, 2)
        call add_moments(panel, set, by(:, m), c(:, m), s(:, m))
      end do
    end do
  end subroutine integrate

end module viscovib_slope_waves
