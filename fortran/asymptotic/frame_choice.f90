!> Selection of resonant terms that are constant in a common frame, in sequence.
!!
!! Each term is a linear condition on the frame's frequencies W: the frequency of the driven mode is
!! the sum of the frequencies of the factors, loads included. A term is rejected if its condition
!! contradicts the accepted ones, or if it would couple more modes than the solver accepts. It is
!! then a separate harmonic term, which is not periodic in the frame (quasi-periodic motion).
module viscovib_frame_choice
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: frame_choice_type, new_frame_choice

  !> Largest number of coupled modes: the limit of the solver of steady motions.
  integer, parameter :: max_moving = 3
  real(wp), parameter :: same = 1.0e-9_wp

  type :: frame_choice_type
    !> Natural frequencies, and orthonormal conditions on W - natural, a column each.
    real(wp), allocatable :: natural(:), basis(:, :), offset(:)
    integer :: n = 0
    !> For the accepted terms that are not mere shifts: modes that occur, and whether loads occur.
    logical, allocatable, private :: tied(:, :), loaded(:)
    integer, private :: n_tied = 0
  contains
    procedure :: take
    procedure :: frame
    procedure, private :: n_moving
  end type frame_choice_type

contains

  subroutine new_frame_choice(choice, natural)
    type(frame_choice_type), intent(out) :: choice
    !> Frequencies of the modes.
    real(wp), intent(in) :: natural(:)
    choice%natural = natural
    allocate (choice%basis(size(natural), size(natural)), choice%offset(size(natural)))
    allocate (choice%tied(size(natural), 64), choice%loaded(64))
  end subroutine new_frame_choice

  !> Accept a term if its condition is compatible.
  subroutine take(self, row, powers, drive, loaded, taken)
    class(frame_choice_type), intent(inout) :: self
    !> Mode that is driven.
    integer, intent(in) :: row
    !> How often each mode is a factor, conjugates counted negative, shape (n_modes).
    integer, intent(in) :: powers(:)
    !> Frequency of the loads among the factors.
    real(wp), intent(in) :: drive
    !> True if loads are among the factors.
    logical, intent(in) :: loaded
    logical, intent(out) :: taken
    real(wp) :: condition(size(powers)), wanted
    integer :: k, pass

    condition = powers
    condition(row) = condition(row) - 1.0_wp
    ! A shift of the mode's own exponent is constant in every frame.
    taken = .not. any(abs(condition) > 0.0_wp) .and. .not. abs(drive) > 0.0_wp
    if (taken) return
    if (self%n_tied == size(self%loaded)) then
      self%tied = reshape(self%tied, [size(powers), 2*self%n_tied], pad=[.false.])
      self%loaded = [self%loaded, self%loaded]
    end if
    self%n_tied = self%n_tied + 1
    self%tied(:, self%n_tied) = powers /= 0
    self%tied(row, self%n_tied) = .true.
    self%loaded(self%n_tied) = loaded
    wanted = -drive - sum(condition*self%natural)
    do pass = 1, 2
      do k = 1, self%n
        associate (part => sum(self%basis(:, k)*condition))
          wanted = wanted - part*self%offset(k)
          condition = condition - part*self%basis(:, k)
        end associate
      end do
    end do
    if (self%n_moving() > max_moving) then
      taken = .false.
    else if (norm2(condition) > same) then
      taken = .true.
      self%n = self%n + 1
      self%offset(self%n) = wanted/norm2(condition)
      self%basis(:, self%n) = condition/norm2(condition)
    else
      taken = abs(wanted) <= same*(maxval(self%natural) + abs(drive))
    end if
    if (.not. taken) self%n_tied = self%n_tied - 1
  end subroutine take

  !> The frame nearest to the natural frequencies.
  pure function frame(self)
    class(frame_choice_type), intent(in) :: self
    real(wp) :: frame(size(self%natural))
    integer :: k
    frame = self%natural
    do k = 1, self%n
      frame = frame + self%offset(k)*self%basis(:, k)
    end do
  end function frame

  !> Number of modes that loads excite through the accepted terms.
  pure integer function n_moving(self)
    class(frame_choice_type), intent(in) :: self
    logical :: moves(size(self%natural))
    integer :: round, i
    moves = .false.
    do round = 1, size(moves) + 1
      do i = 1, self%n_tied
        if (self%loaded(i) .or. any(moves .and. self%tied(:, i))) then
          moves = moves .or. self%tied(:, i)
        end if
      end do
    end do
    n_moving = count(moves)
  end function n_moving

end module viscovib_frame_choice
