!> Effect of a jump of a force law on perturbations of a motion.
!!
!! Where a signal h(s) crosses zero at the phase theta and the force jumps by f_+ - f_-, the state
!! is continuous and its rate jumps, by dF = -B w (f_+ - f_-). A perturbed motion crosses earlier or
!! later. The perturbation is multiplied by
!!
!!   S = 1 + dF g^T/h'_-,     g = dh/ds,   h'_+ = h'_- + g^T dF
!!
!! (Leine, Nijmeijer, Dynamics and bifurcations of non-smooth mechanical systems, 2004, 7.1). The
!! Fourier series of a rate that jumps converges to the middle of the jump, so h'_-+ are its sum
!! minus and plus half of the jump. If they have opposite signs the motion slides on the surface; if
!! one is small compared with the jump, omitted harmonics matter. The map is then unknown.
module viscovib_jump_maps
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_kinked_motion, only: linear_rest
  use viscovib_law_branches, only: find_signals
  use viscovib_law_cycle, only: find_switches
  use viscovib_law_functions, only: jumps
  use viscovib_law_program, only: law_program
  use viscovib_oscillator, only: oscillator_type
  use viscovib_phase_panels, only: wave_sum
  use viscovib_phase_roots, only: phase_list
  use viscovib_polynomial, only: polynomial_type
  implicit none
  private

  public :: jump_map, find_jumps, may_jump

  !> Distance of the evaluations on both sides of a jump, in radians; smallest jump, relative to the
  !! law's largest value.
  real(wp), parameter :: nearby = 1.0e-7_wp, least_jump = 1.0e-5_wp
  !> A crossing is clear if the rates of its signal exceed this fraction of their jump.
  real(wp), parameter :: clear = 0.05_wp

  !> The matrix S (n, n) of the linear subsystem at a phase.
  type :: jump_map
    real(wp) :: theta = 0.0_wp
    real(wp), allocatable :: s(:, :)
    logical, private :: passed = .false.
    !> True if the map has been applied.
    logical :: done = .false.
  end type jump_map

contains

  !> True if some law of the system can jump.
  pure logical function may_jump(system)
    class(oscillator_type), intent(in) :: system
    integer :: i
    may_jump = .false.
    select type (system)
    class is (polynomial_type)
      do i = 1, size(system%laws)
        if (system%laws(i)%state > 0) cycle
        may_jump = may_jump .or. any(jumps(system%laws(i)%program%code))
      end do
    end select
  end function may_jump

  !> The jumps along a motion. `known` is false if the motion slides on a surface or grazes one, or
  !! if two laws jump at the same phase.
  subroutine find_jumps(system, set, x, mu, maps, known, rest)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    !> Harmonics, shape (2 n_orders, n_dof), and frequencies of the orders.
    real(wp), intent(in) :: x(:, :), mu(:)
    type(jump_map), allocatable, intent(out) :: maps(:)
    logical, intent(out) :: known
    !> If absent, the result only shows whether there are jumps.
    type(linear_rest), intent(in), optional :: rest
    real(wp), allocatable :: y(:, :), scan(:, :), f(:)
    type(law_program), allocatable :: signals(:)
    type(phase_list) :: found
    type(jump_map) :: one
    integer :: i, j, none(0)

    allocate (maps(0))
    known = .true.
    select type (system)
    class is (polynomial_type)
      do i = 1, size(system%laws)
        associate (law => system%laws(i))
          if (law%state > 0) cycle
          if (.not. any(jumps(law%program%code))) cycle
          y = turned(matmul(x, transpose(law%rates)), mu) + matmul(x, transpose(law%arguments))
          call find_signals(law%program, none, signals)
          scan = matmul(transpose(set%synthesis), y)
          allocate (f(size(scan, 1)))
          call law%program%evaluate(scan, f)
          call find_switches(signals, set, y, scan, found)
          do j = 1, found%n
            call one_jump(system, i, set, y, mu, found%theta(j), signals(found%of(j)), &
                          maxval(abs(f)), one, rest)
            if (.not. allocated(one%s)) cycle
            if (any(abs(maps%theta - one%theta) <= 10.0_wp*nearby)) known = .false.
            known = known .and. one%passed
            maps = [maps, one]
          end do
          deallocate (f)
        end associate
      end do
    end select
  end subroutine find_jumps

  !> Harmonics of the time derivative.
  pure function turned(x, mu) result(rate)
    real(wp), intent(in) :: x(:, :), mu(:)
    real(wp) :: rate(size(x, 1), size(x, 2))
    rate(1::2, :) = -spread(mu, 2, size(x, 2))*x(2::2, :)
    rate(2::2, :) = spread(mu, 2, size(x, 2))*x(1::2, :)
  end function turned

  !> The map at a phase where a signal of law i crosses zero; none if the law does not jump there.
  subroutine one_jump(system, i, set, y, mu, theta, signal, size_of, one, rest)
    class(polynomial_type), intent(in) :: system
    integer, intent(in) :: i
    type(harmonic_set_type), intent(in) :: set
    !> Harmonics of the law's arguments, shape (n_parts, n_arguments).
    real(wp), intent(in) :: y(:, :), mu(:), theta, size_of
    type(law_program), intent(in) :: signal
    type(jump_map), intent(out) :: one
    type(linear_rest), intent(in), optional :: rest
    real(wp) :: arguments(3, size(y, 2)), rates(size(y, 2)), f(3), h(3), slopes(3, size(y, 2))
    real(wp), allocatable :: change(:), row(:), fast(:, :)
    real(wp) :: middle, before, after
    integer :: j, k

    fast = turned(y, mu)
    do j = 1, size(y, 2)
      do k = 1, 3
        arguments(k, j) = wave_sum(set, y(:, j), theta + (k - 2)*nearby)
      end do
      rates(j) = wave_sum(set, fast(:, j), theta)
    end do
    associate (law => system%laws(i))
      call law%program%evaluate(arguments, f)
      if (abs(f(3) - f(1)) <= least_jump*size_of) return
      one%theta = theta
      if (.not. present(rest)) then
        allocate (one%s(0, 0))
        return
      end if
      call signal%differentiate(arguments, h, slopes)
      allocate (change(size(rest%a, 1)), row(size(rest%a, 1)), source=0.0_wp)
      do j = 1, size(law%equations)
        change = change - rest%b(:, law%equations(j))*(law%weights(j)*(f(3) - f(1)))
      end do
      row(:) = matmul(matmul(slopes(2, :), law%arguments), rest%y) &
               + matmul(matmul(slopes(2, :), law%rates), rest%rate)
    end associate
    middle = sum(slopes(2, :)*rates)
    before = middle - 0.5_wp*sum(row*change)
    after = middle + 0.5_wp*sum(row*change)
    one%passed = before*after > 0.0_wp .and. &
                 min(abs(before), abs(after)) > clear*abs(after - before)
    allocate (one%s(size(row), size(row)), source=0.0_wp)
    if (.not. one%passed) return
    one%s = spread(change/before, 2, size(row))*spread(row, 1, size(row))
    do j = 1, size(row)
      one%s(j, j) = one%s(j, j) + 1.0_wp
    end do
  end subroutine one_jump

end module viscovib_jump_maps
