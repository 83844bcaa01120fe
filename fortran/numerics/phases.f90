! Optimize: -O3
!> Phases p t of harmonic loads along a run of equal steps, without loss of
!! digits in long runs.
!!
!! Each phase is a sum of two doubles, reduced by whole turns, so
!! that its error stays near the last digit after any number of steps; p t
!! itself would lose a digit with every factor of ten in t.
module viscovib_phases
  use, intrinsic :: iso_c_binding, only: c_double
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_vector_math, only: sine_cosine_lanes
  implicit none
  private

  public :: phases_type, new_phases, split_phase, step_phase, step_phases, turn_phase

  !> 2 pi in two parts.
  real(wp), parameter :: turn_high = 6.283185307179586_wp, turn_low = 2.4492935982947064e-16_wp
  !> 0 to 3 quarters of a turn.
  real(wp), parameter :: quarter_high(0:3) = &
    [0.0_wp, 1.5707963267948966_wp, 3.141592653589793_wp, 4.71238898038469_wp]
  real(wp), parameter :: quarter_low(0:3) = &
    [0.0_wp, 6.123233995736766e-17_wp, 1.2246467991473532e-16_wp, 1.8369701987210297e-16_wp]

  type :: phases_type
    !> Phase at the start of the step and its growth over a step, each in two
    !! parts, shape (n).
    real(wp), allocatable :: high(:), low(:)
    real(wp), allocatable, private :: step_high(:), step_low(:)
    !> cos and sin of p h c_i at the nodes, shape (n_lanes, n_blocks, n).
    real(wp), allocatable, private :: node_cos(:, :, :), node_sin(:, :, :)
  contains
    procedure :: set_step
    procedure :: advance
    procedure :: drives
  end type phases_type

  interface
    pure subroutine c_split_phase(frequency, time, high, low) bind(c, name='viscovib_split_phase')
      import :: c_double
      real(c_double), value :: frequency, time
      real(c_double), intent(out) :: high, low
    end subroutine c_split_phase
  end interface

contains

  !> Phases of cos(p t) from t = start on, in steps h, for the nodes c in [0, 1].
  pure subroutine new_phases(phases, frequencies, start, h, nodes)
    type(phases_type), intent(out) :: phases
    real(wp), intent(in) :: frequencies(:), start, h
    !> Shape (n_lanes, n_blocks).
    real(wp), intent(in) :: nodes(:, :)
    integer :: n

    n = size(frequencies)
    allocate (phases%high(n), phases%low(n), phases%step_high(n), phases%step_low(n))
    call split_phase(frequencies, start, phases%high, phases%low)
    call phases%set_step(frequencies, h, nodes)
  end subroutine new_phases

  !> Continue with steps h.
  pure subroutine set_step(self, frequencies, h, nodes)
    class(phases_type), intent(inout) :: self
    real(wp), intent(in) :: frequencies(:), h, nodes(:, :)
    integer :: j

    call split_phase(frequencies, h, self%step_high, self%step_low)
    self%node_cos = spread(nodes, 3, size(frequencies))
    do j = 1, size(frequencies)
      self%node_cos(:, :, j) = frequencies(j)*h*nodes
    end do
    self%node_sin = sin(self%node_cos)
    self%node_cos = cos(self%node_cos)
  end subroutine set_step

  !> Phase p t without whole turns, in two parts.
  elemental subroutine split_phase(frequency, time, high, low)
    real(wp), intent(in) :: frequency, time
    real(wp), intent(out) :: high, low
    call c_split_phase(frequency, time, high, low)
  end subroutine split_phase

  !> Advance a phase by one step, and subtract a turn if it exceeds one.
  elemental subroutine step_phase(high, low, step_high, step_low)
    real(wp), intent(inout) :: high, low
    real(wp), intent(in) :: step_high, step_low
    real(wp) :: total, part, rest
    total = high + step_high
    part = total - high
    rest = (high - (total - part)) + (step_high - part)
    rest = rest + (low + step_low)
    if (total >= turn_high) then
      total = total - turn_high
      rest = rest - turn_low
    end if
    high = total + rest
    low = rest - (high - total)
  end subroutine step_phase

  !> The same for an array of phases, here so that it is inlined in the loop.
  pure subroutine step_phases(n, high, low, step_high, step_low)
    integer, intent(in) :: n
    real(wp), intent(inout), dimension(n) :: high, low
    real(wp), intent(in), dimension(n) :: step_high, step_low
    call step_phase(high, low, step_high, step_low)
  end subroutine step_phases

  !> Advance a phase by some quarter turns.
  elemental subroutine turn_phase(high, low, quarters)
    real(wp), intent(inout) :: high, low
    !> 0 to 3.
    integer, intent(in) :: quarters
    call step_phase(high, low, quarter_high(quarters), quarter_low(quarters))
  end subroutine turn_phase

  !> Advance to the start of the next step.
  pure subroutine advance(self)
    class(phases_type), intent(inout) :: self
    call step_phase(self%high, self%low, self%step_high, self%step_low)
  end subroutine advance

  !> cos(p t) at the nodes of a block of the present step, one column per load.
  pure subroutine drives(self, block, cosines)
    class(phases_type), intent(in) :: self
    integer, intent(in) :: block
    real(wp), intent(out) :: cosines(n_lanes, size(self%high))
    real(wp) :: angle(n_lanes), s(n_lanes), c(n_lanes)
    integer :: j

    angle = 0.0_wp
    angle(:size(self%high)) = self%high
    call sine_cosine_lanes(angle, s, c)
    do j = 1, size(self%high)
      cosines(:, j) = (c(j) - s(j)*self%low(j))*self%node_cos(:, block, j) &
                      - (s(j) + c(j)*self%low(j))*self%node_sin(:, block, j)
    end do
  end subroutine drives

end module viscovib_phases
