! Optimize: -O2
!> Force laws over a cycle, integrated from one kink or jump to the next.
!!
!! Harmonics of f(a(theta)) along a motion a are integrals over the pieces between the phases at
!! which the law changes its branch. Each piece is halved until sixteen Gauss points resolve it. If
!! f jumps at a phase t, g(a(t)) = 0, the harmonics change by the displacement of t, dt =
!! -dg/(dg/dtheta), times the jump.
module viscovib_law_cycle
  use viscovib_constants, only: pi
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_law_functions, only: jumps
  use viscovib_law_program, only: law_program
  use viscovib_phase_panels, only: add_moments, add_parts, is_resolved, longest_panel, motion_at, &
                                   nodes, panel_type, panel_walk, wave_sum, waves_at, weigh
  use viscovib_phase_roots, only: along_motion, find_phases, phase_list
  implicit none
  private

  public :: find_switches, law_parts, law_slopes, law_sums

  !> Distance of evaluations from a jump.
  real(wp), parameter :: nearby = 1.0e-8_wp

  !> Sums that give the derivatives of a law along a motion.
  type :: law_sums
    !> Moments of the derivatives by each argument, shape (-reach:reach, n_arguments).
    real(wp), allocatable :: c(:, :), s(:, :)
    !> Contribution of jumps: derivatives of the harmonics by those of each argument, shape
    !! (n_parts, n_parts, n_arguments).
    real(wp), allocatable :: jumps(:, :, :)
    !> Derivative of the harmonics by the motion `along`, shape (n_parts).
    real(wp), allocatable :: along(:)
  end type law_sums

  type, extends(along_motion) :: signal_along
    type(harmonic_set_type), pointer :: set => null()
    type(law_program), pointer :: program => null()
    real(wp), allocatable :: y(:, :)
  contains
    procedure :: at
  end type signal_along

contains

  !> A signal at a phase.
  real(wp) function at(self, theta)
    class(signal_along), intent(in) :: self
    real(wp), intent(in) :: theta
    real(wp) :: value(1)
    call self%program%evaluate(arguments_at(self%set, self%y, theta), value)
    at = value(1)
  end function at

  !> Arguments at a phase, as one sample.
  pure function arguments_at(set, y, theta) result(arguments)
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: y(:, :), theta
    real(wp) :: arguments(1, size(y, 2))
    integer :: m
    do m = 1, size(y, 2)
      arguments(1, m) = wave_sum(set, y(:, m), theta)
    end do
  end function arguments_at

  !> Phases at which a law has a kink or jumps.
  subroutine find_switches(signals, set, y, scan, found)
    type(law_program), intent(in), target :: signals(:)
    type(harmonic_set_type), intent(in), target :: set
    real(wp), intent(in) :: y(:, :), scan(:, :)
    type(phase_list), intent(out) :: found
    type(signal_along) :: motion
    real(wp) :: g(size(scan, 1) + 1), ends(1)
    integer :: i

    motion%set => set
    motion%y = y
    do i = 1, size(signals)
      call signals(i)%evaluate(scan, g(:size(scan, 1)))
      call signals(i)%evaluate(merge(-1.0_wp, 1.0_wp, set%half_wave)*scan(:1, :), ends)
      g(size(g)) = ends(1)
      motion%program => signals(i)
      call find_phases(motion, set, g, i, found)
    end do
  end subroutine find_switches

  !> Harmonics of a law along a motion, and its switching phases.
  subroutine law_parts(program, signals, set, y, scan, parts, found)
    type(law_program), intent(in) :: program, signals(:)
    type(harmonic_set_type), intent(in) :: set
    !> Harmonics of its arguments, shape (n_parts, n_arguments), and the arguments at the samples of
    !! the set, (n_samples, n_arguments).
    real(wp), intent(in) :: y(:, :), scan(:, :)
    !> Shape (n_parts).
    real(wp), intent(out) :: parts(:)
    type(phase_list), intent(out) :: found
    type(law_sums) :: none

    call find_switches(signals, set, y, scan, found)
    parts = 0.0_wp
    call over_pieces(program, set, y, scan, found, parts, none)
    call weigh(set, parts)
  end subroutine law_parts

  !> Derivatives of the harmonics of a law.
  subroutine law_slopes(program, signals, set, y, along, scan, found, sums)
    type(law_program), intent(in) :: program, signals(:)
    type(harmonic_set_type), intent(in) :: set
    !> As in `law_parts`; and a change of the arguments, shape (n_parts, n_arguments).
    real(wp), intent(in) :: y(:, :), along(:, :), scan(:, :)
    !> From `law_parts` of this motion.
    type(phase_list), intent(in) :: found
    type(law_sums), intent(out) :: sums
    real(wp) :: none(0)
    integer :: m, reach

    reach = 2*maxval(set%orders)/merge(2, 1, set%half_wave)
    allocate (sums%c(-reach:reach, size(y, 2)), sums%s(-reach:reach, size(y, 2)), &
              sums%along(size(y, 1)), source=0.0_wp)
    call over_pieces(program, set, y, scan, found, none, sums, along)
    call weigh(set, sums%along)
    do m = 1, reach
      sums%c(-m, :) = sums%c(m, :)
      sums%s(-m, :) = -sums%s(m, :)
    end do
    if (.not. any(jumps(program%code))) return
    allocate (sums%jumps(size(y, 1), size(y, 1), size(y, 2)), source=0.0_wp)
    call add_jumps(program, signals, set, y, along, found, sums)
  end subroutine law_slopes

  !> Integrate between switches.
  subroutine over_pieces(program, set, y, scan, found, parts, sums, along)
    type(law_program), intent(in) :: program
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: y(:, :), scan(:, :)
    type(phase_list), intent(in) :: found
    real(wp), intent(inout) :: parts(:)
    type(law_sums), intent(inout) :: sums
    !> If present, derivatives are computed instead of `parts`.
    real(wp), intent(in), optional :: along(:, :)
    type(panel_type) :: panel
    type(panel_walk) :: walk
    real(wp) :: arguments(nodes, size(y, 2)), f(nodes), slopes(nodes, size(y, 2)), moved(nodes)
    real(wp) :: size_of, samples(size(scan, 1))
    integer :: m, reach

    call program%evaluate(scan, samples)
    size_of = maxval(abs(samples))
    reach = 0
    if (present(along)) reach = ubound(sums%c, 1)
    walk = panel_walk(ending=merge(pi, 2.0_wp*pi, set%half_wave), longest=longest_panel(set), &
                      ends=found)
    do while (walk%next(set, panel))
      do m = 1, size(y, 2)
        arguments(:, m) = motion_at(panel, y(:, m))
      end do
      if (present(along)) then
        call program%differentiate(arguments, f, slopes)
      else
        call program%evaluate(arguments, f)
      end if
      walk%accepted = walk%is_last_try()
      if (.not. walk%accepted) walk%accepted = is_resolved(f, size_of)
      if (.not. walk%accepted) cycle
      size_of = max(size_of, maxval(abs(f)))
      if (.not. present(along)) then
        call add_parts(panel, f, parts)
        cycle
      end if
      moved = 0.0_wp
      do m = 1, size(y, 2)
        call add_moments(panel, set, slopes(:, m), sums%c(0:reach, m), sums%s(0:reach, m))
        moved = moved + slopes(:, m)*motion_at(panel, along(:, m))
      end do
      call add_parts(panel, moved, sums%along)
    end do
  end subroutine over_pieces

  !> Add the contribution of jumps to the derivatives.
  subroutine add_jumps(program, signals, set, y, along, found, sums)
    type(law_program), intent(in) :: program, signals(:)
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(in) :: y(:, :), along(:, :)
    type(phase_list), intent(in) :: found
    type(law_sums), intent(inout) :: sums
    real(wp) :: waves(size(y, 1)), turned(size(y, 1)), weighed(size(y, 1)), g(1), f(2)
    real(wp) :: by(1, size(y, 2)), slope
    integer :: i, j, m

    do i = 1, found%n
      call program%evaluate(arguments_at(set, y, found%theta(i) - nearby), f(1:1))
      call program%evaluate(arguments_at(set, y, found%theta(i) + nearby), f(2:2))
      call signals(found%of(i))%differentiate(arguments_at(set, y, found%theta(i)), g, by)
      waves = waves_at(set, found%theta(i))
      turned(1::2) = set%orders*waves(2::2)
      turned(2::2) = -set%orders*waves(1::2)
      slope = sum(by(1, :)*matmul(turned, y))
      if (abs(slope) <= tiny(1.0_wp)) cycle
      weighed = waves
      call weigh(set, weighed)
      weighed = -weighed*(f(1) - f(2))/slope
      do m = 1, size(y, 2)
        sums%along = sums%along + weighed*(by(1, m)*sum(waves*along(:, m)))
        do j = 1, size(waves)
          sums%jumps(:, j, m) = sums%jumps(:, j, m) + weighed*(by(1, m)*waves(j))
        end do
      end do
    end do
  end subroutine add_jumps

end module viscovib_law_cycle
