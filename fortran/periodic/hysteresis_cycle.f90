! Optimize: -O2
!> Elements with hysteresis over a cycle of a deflection d, without sampling error.
!!
!! The states depend only on the deflections at the turning points of d. These determine the
!! periodic cycle (`viscovib_hysteresis_loop`). The force is then integrated over pieces that end
!! where d turns or a state has a kink. In the stretch after a turning point t, a state changes by
!!
!!   dz = p dz_t + z' (dd - dd_t),   p = dz/dz_t,   z' = dz/dd,
!!
!! and a displacement of a turning point in time has no effect, as d' = 0 there.
module viscovib_hysteresis_cycle
  use viscovib_constants, only: pi
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_hysteresis_loop, only: find_start
  use viscovib_kinds, only: wp
  use viscovib_phase_panels, only: add_moments, add_parts, is_resolved, longest_panel, motion_at, &
                                   nodes, panel_type, panel_walk, wave_sum, waves_at, weigh
  use viscovib_phase_roots, only: along_motion, find_phases, phase_list, root
  implicit none
  private

  public :: cycle_sums, find_kinks, find_turns, run_cycle

  !> Shortest piece, in units of the longest one.
  real(wp), parameter :: shortest = 1.0e-4_wp

  !> Sums that give the derivatives of the force along a motion.
  type :: cycle_sums
    !> Moments of the tangent stiffness, shape (-reach:reach), and the contribution of earlier
    !! states to the derivatives of the harmonics, (n_parts, n_parts).
    real(wp), allocatable :: c(:), s(:), past(:, :)
  end type cycle_sums

  !> d' or d - a level along a motion.
  type, extends(along_motion) :: motion_along
    type(harmonic_set_type), pointer :: set => null()
    real(wp), allocatable :: y(:)
    real(wp) :: level = 0.0_wp
  contains
    procedure :: at
  end type motion_along

contains

  real(wp) function at(self, theta)
    class(motion_along), intent(in) :: self
    real(wp), intent(in) :: theta
    at = wave_sum(self%set, self%y, theta) - self%level
  end function at

  !> Harmonics of the force without its linear part at zero deflection, the energy lost in a period,
  !! and derivatives.
  subroutine run_cycle(element, set, y, parts, lost, multiplier, sums)
    class(hysteresis_type), intent(in) :: element
    type(harmonic_set_type), intent(in), target :: set
    !> Harmonics of the deflection, shape (n_parts).
    real(wp), intent(in) :: y(:)
    real(wp), intent(out) :: parts(:), lost
    !> Factor by which a perturbation of a state changes over the cycle, shape (n_states).
    real(wp), intent(out) :: multiplier(:)
    type(cycle_sums), intent(inout), optional :: sums
    type(phase_list) :: turns
    real(wp), allocatable :: d(:), by_d(:, :), waves(:, :)
    real(wp), dimension(element%n_states()) :: z, left, by_z, by_change
    real(wp) :: state_by_y(element%n_states(), size(y)), ending, work, to
    integer :: i, j, n, turn

    turn = merge(-1, 1, set%half_wave)
    ending = merge(pi, 2.0_wp*pi, set%half_wave)
    call find_turns(set, y, turns)
    n = turns%n
    allocate (d(n), by_d(element%n_states(), n), waves(size(y), n + 1))
    do i = 1, n
      waves(:, i) = waves_at(set, turns%theta(i))
      d(i) = sum(waves(:, i)*y)
    end do
    waves(:, n + 1) = turn*waves(:, 1)
    call find_start(element, d, turn, z, by_d, multiplier)
    parts = 0.0_wp
    lost = 0.0_wp
    if (present(sums)) call clear(sums, set)
    state_by_y = matmul(by_d, transpose(waves(:, :n)))
    do i = 1, n
      to = ending
      if (i < n) to = turns%theta(i + 1)
      left = z
      call stretch(element, set, y, turns%theta(i), to, d(i), waves(:, i), z, state_by_y, parts, &
                   sums)
      ! Advance from the turning point to the next one in one step.
      z = left
      if (i < n) then
        call element%advance(d(i + 1) - d(i), z, by_z, by_change, work)
      else
        call element%advance(turn*d(1) - d(i), z, by_z, by_change, work)
      end if
      lost = lost + work
      do j = 1, size(y)
        state_by_y(:, j) = by_z*state_by_y(:, j) + by_change*(waves(j, i + 1) - waves(j, i))
      end do
    end do
    if (set%half_wave) lost = 2.0_wp*lost
    call weigh(set, parts)
    parts = parts + (element%elastic - element%stiffness_at_rest())*y
    if (.not. present(sums)) return
    do j = 1, size(y)
      call weigh(set, sums%past(:, j))
    end do
    sums%c(0) = sums%c(0) + element%elastic - element%stiffness_at_rest()
    do j = 1, ubound(sums%c, 1)
      sums%c(-j) = sums%c(j)
      sums%s(-j) = -sums%s(j)
    end do
  end subroutine run_cycle

  pure subroutine clear(sums, set)
    type(cycle_sums), intent(inout) :: sums
    type(harmonic_set_type), intent(in) :: set
    integer :: n, reach
    n = 2*size(set%orders)
    reach = 2*maxval(set%orders)/merge(2, 1, set%half_wave)
    if (allocated(sums%c)) deallocate (sums%c, sums%s, sums%past)
    allocate (sums%c(-reach:reach), sums%s(-reach:reach), sums%past(n, n), source=0.0_wp)
  end subroutine clear

  !> Phases of the start of the cycle and of the turning points of d.
  subroutine find_turns(set, y, turns)
    type(harmonic_set_type), intent(in), target :: set
    real(wp), intent(in) :: y(:)
    type(phase_list), intent(out) :: turns
    type(motion_along) :: rate
    type(phase_list) :: found
    real(wp) :: g(set%n_samples + 1)
    integer :: i

    rate%set => set
    allocate (rate%y(size(y)))
    rate%y(1::2) = -set%orders*y(2::2)
    rate%y(2::2) = set%orders*y(1::2)
    g(:set%n_samples) = matmul(rate%y, set%synthesis)
    g(size(g)) = merge(-1.0_wp, 1.0_wp, set%half_wave)*g(1)
    call turns%put(0.0_wp, 1)
    call find_phases(rate, set, g, 1, found)
    do i = 1, found%n
      if (found%theta(i) > 0.0_wp) call turns%put(found%theta(i), 1)
    end do
  end subroutine find_turns

  !> From a turning point to the next; on return the states are near its end.
  subroutine stretch(element, set, y, from, to, d_from, waves, z, state_by_y, parts, sums)
    class(hysteresis_type), intent(in) :: element
    type(harmonic_set_type), intent(in), target :: set
    real(wp), intent(in) :: y(:), from, to, d_from
    !> Basis functions at the start of the stretch, shape (n_parts).
    real(wp), intent(in) :: waves(:)
    real(wp), intent(inout) :: z(:)
    !> Derivatives of the initial states by the harmonics, shape (n_states, n_parts).
    real(wp), intent(in) :: state_by_y(:, :)
    real(wp), intent(inout) :: parts(:)
    type(cycle_sums), intent(inout), optional :: sums
    type(panel_walk) :: walk
    type(panel_type) :: panel
    real(wp), dimension(size(z)) :: at_start, by_z, by_change, kept, kept_here
    real(wp) :: of_states(size(y), size(z)), of_start(size(y))
    real(wp) :: d(nodes), f(nodes), tangent(nodes), left(nodes, size(z))
    real(wp) :: last, size_of, work, last_panel
    integer :: j, k

    walk%from = from
    walk%ending = to
    walk%longest = longest_panel(set)
    walk%shortest = shortest
    walk%tries = huge(1)
    call find_kinks(element, set, y, from, to, d_from, z, walk%ends)
    of_states = 0.0_wp
    of_start = 0.0_wp
    last = d_from
    kept = 1.0_wp
    size_of = maxval(abs(element%weight*z))
    do while (walk%next(set, panel))
      d = motion_at(panel, y)
      at_start = z
      kept_here = kept
      last_panel = last
      do j = 1, nodes
        call element%advance(d(j) - last, z, by_z, by_change, work)
        last = d(j)
        kept = kept*by_z
        f(j) = sum(element%weight*z)
        tangent(j) = sum(element%weight*by_change)
        left(j, :) = element%weight*kept
      end do
      walk%accepted = walk%is_last_try()
      if (.not. walk%accepted) walk%accepted = is_resolved(f, size_of)
      if (.not. walk%accepted) then
        z = at_start
        kept = kept_here
        last = last_panel
        cycle
      end if
      size_of = max(size_of, maxval(abs(f)))
      call add_parts(panel, f, parts)
      if (present(sums)) then
        call add_moments(panel, set, tangent, sums%c(0:), sums%s(0:))
        call add_parts(panel, tangent, of_start)
        do k = 1, size(z)
          if (any(abs(left(:, k)) > 0.0_wp)) call add_parts(panel, left(:, k), of_states(:, k))
        end do
      end if
    end do
    if (.not. present(sums)) return
    sums%past = sums%past + matmul(of_states, state_by_y)
    do k = 1, size(y)
      sums%past(:, k) = sums%past(:, k) - of_start*waves(k)
    end do
  end subroutine stretch

  !> Phases of kinks of the states.
  subroutine find_kinks(element, set, y, from, to, d_from, z, ends)
    class(hysteresis_type), intent(in) :: element
    type(harmonic_set_type), intent(in), target :: set
    real(wp), intent(in) :: y(:), from, to, d_from, z(:)
    type(phase_list), intent(out) :: ends
    type(motion_along) :: motion
    real(wp) :: distances(size(z)), d_to, a, b
    integer :: j, way

    motion%set => set
    motion%y = y
    d_to = motion%at(to)
    way = merge(1, -1, d_to >= d_from)
    call element%kinks(z, way, distances)
    do j = 1, size(z)
      if (.not. distances(j) < abs(d_to - d_from)) cycle
      motion%level = d_from + way*distances(j)
      a = motion%at(from)
      b = motion%at(to)
      if ((a > 0.0_wp) .eqv. (b > 0.0_wp)) cycle
      call ends%put(root(motion, from, to, a, b), j)
    end do
  end subroutine find_kinks

end module viscovib_hysteresis_cycle
