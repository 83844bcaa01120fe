!> Phases p t of harmonic loads along a run of equal steps, without losing
!! digits however long it is.
!!
!! Each phase is kept as a sum of two doubles and turned back by whole turns, so
!! that its error stays near the last digit after any number of steps; p t
!! itself would lose a digit with every factor of ten in t.
module viscovib_phases
  use, intrinsic :: iso_fortran_env, only: real128
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_vector_math, only: sine_cosine_lanes
  implicit none
  private

  public :: phases_type, new_phases

  real(real128), parameter :: turn = 6.28318530717958647692528676655900577_real128
  real(wp), parameter :: turn_high = real(turn, wp)
  real(wp), parameter :: turn_low = real(turn - real(turn_high, real128), wp)

  type :: phases_type
    !> Phase at the start of the step and its growth over a step, each in two
    !! parts, shape (n).
    real(wp), allocatable :: high(:), low(:)
    real(wp), allocatable, private :: step_high(:), step_low(:)
    !> cos and sin of p h c_i at the nodes, shape (n_lanes, n_blocks, n).
    real(wp), allocatable, private :: node_cos(:, :, :), node_sin(:, :, :)
  contains
    procedure :: advance
    procedure :: drives
  end type phases_type

contains

  !> Phases of cos(p t) from t = start on, in steps h, for the nodes c in [0, 1].
  pure subroutine new_phases(phases, frequencies, start, h, nodes)
    type(phases_type), intent(out) :: phases
    real(wp), intent(in) :: frequencies(:), start, h
    !> Shape (n_lanes, n_blocks).
    real(wp), intent(in) :: nodes(:, :)
    real(real128) :: exact
    integer :: j, n, b, l

    n = size(frequencies)
    allocate (phases%high(n), phases%low(n), phases%step_high(n), phases%step_low(n))
    allocate (phases%node_cos(n_lanes, size(nodes, 2), n), &
              phases%node_sin(n_lanes, size(nodes, 2), n))
    do j = 1, n
      exact = modulo(real(frequencies(j), real128)*real(start, real128), turn)
      phases%high(j) = real(exact, wp)
      phases%low(j) = real(exact - real(phases%high(j), real128), wp)
      exact = modulo(real(frequencies(j), real128)*real(h, real128), turn)
      phases%step_high(j) = real(exact, wp)
      phases%step_low(j) = real(exact - real(phases%step_high(j), real128), wp)
      do b = 1, size(nodes, 2)
        do l = 1, n_lanes
          phases%node_cos(l, b, j) = cos(frequencies(j)*h*nodes(l, b))
          phases%node_sin(l, b, j) = sin(frequencies(j)*h*nodes(l, b))
        end do
      end do
    end do
  end subroutine new_phases

  !> To the start of the next step.
  pure subroutine advance(self)
    class(phases_type), intent(inout) :: self
    real(wp) :: total, part, low
    integer :: j
    do j = 1, size(self%high)
      total = self%high(j) + self%step_high(j)
      part = total - self%high(j)
      low = (self%high(j) - (total - part)) + (self%step_high(j) - part)
      low = low + (self%low(j) + self%step_low(j))
      if (total >= turn_high) then
        total = total - turn_high
        low = low - turn_low
      end if
      self%high(j) = total + low
      self%low(j) = low - (self%high(j) - total)
    end do
  end subroutine advance

  !> cos(p t) at the nodes of a block of the present step, a column a load.
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
