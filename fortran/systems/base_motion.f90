!> How the base moves: sinusoids, and a piecewise cubic with corners. The equations are
!! those of coordinates relative to the base; states given and kept are those of the body.
!!
!! A corner of the base is a jump of the relative velocity, of which the body's knows
!! nothing: velocities here are those within the present piece of time, whichever end of it
!! they are asked at.
module viscovib_base_motion
  use viscovib_constants, only: imaginary_unit
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: base_motion_type

  type :: base_motion_type
    !> How the coordinates move with the one displacement of the base, shape (n_dof); not
    !! allocated: the base has a displacement for each coordinate.
    real(wp), allocatable :: direction(:)
    !> Displacements Im sum_k amplitudes(:,k) exp(i frequencies(k) t), shape (q, m); not allocated:
    !! the base is at rest.
    real(wp), allocatable :: frequencies(:)
    complex(wp), allocatable :: amplitudes(:, :)
    !> Besides, cubics sum_p pieces(p,:,i) (t - breaks(i))^(4-p) from each break to the next,
    !! the last for ever; before the first break the base is where it is there. Shapes (n)
    !! and (4, q, n); no breaks: none.
    real(wp), allocatable :: breaks(:), pieces(:, :, :)
    integer, private :: present = 0
  contains
    procedure :: moves
    procedure :: has_corners
    procedure :: enter
    procedure :: n_displacements
    procedure :: along
    procedure :: of_coordinates
    procedure :: add_to
    procedure :: add_cubics
  end type base_motion_type

contains

  pure logical function moves(self)
    class(base_motion_type), intent(in) :: self
    moves = allocated(self%amplitudes)
  end function moves

  !> Whether relative velocities may jump.
  pure logical function has_corners(self)
    class(base_motion_type), intent(in) :: self
    has_corners = .false.
    if (allocated(self%breaks)) has_corners = self%moves() .and. size(self%breaks) > 0
  end function has_corners

  !> A piece of time begins that no corner divides.
  pure subroutine enter(self, from, to)
    class(base_motion_type), intent(inout) :: self
    real(wp), intent(in) :: from, to
    real(wp) :: middle
    integer :: low, high, i

    if (.not. self%has_corners()) return
    middle = from + 0.5_wp*(to - from)
    low = 0
    high = size(self%breaks)
    do while (low < high)
      i = (low + high + 1)/2
      if (self%breaks(i) <= middle) then
        low = i
      else
        high = i - 1
      end if
    end do
    self%present = low
  end subroutine enter

  pure integer function n_displacements(self)
    class(base_motion_type), intent(in) :: self
    n_displacements = 0
    if (self%moves()) n_displacements = size(self%amplitudes, 1)
  end function n_displacements

  !> Displacements of the base and their velocities.
  pure subroutine along(self, t, displacement, velocity)
    class(base_motion_type), intent(in) :: self
    real(wp), intent(in) :: t
    !> Shape (q).
    real(wp), intent(out) :: displacement(:), velocity(:)
    complex(wp) :: wave(size(displacement))
    real(wp) :: x
    integer :: k

    displacement = 0.0_wp
    velocity = 0.0_wp
    if (.not. self%moves()) return
    do k = 1, size(self%frequencies)
      if (.not. any(abs(self%amplitudes(:, k)) > 0.0_wp)) cycle
      wave = self%amplitudes(:, k)*exp(imaginary_unit*(self%frequencies(k)*t))
      displacement = displacement + aimag(wave)
      velocity = velocity + self%frequencies(k)*real(wave)
    end do
    if (.not. self%has_corners()) return
    if (self%present == 0) then
      displacement = displacement + self%pieces(4, :, 1)
      return
    end if
    associate (a => self%pieces(:, :, self%present))
      x = t - self%breaks(self%present)
      displacement = displacement + (((a(1, :)*x + a(2, :))*x + a(3, :))*x + a(4, :))
      velocity = velocity + ((3.0_wp*a(1, :)*x + 2.0_wp*a(2, :))*x + a(3, :))
    end associate
  end subroutine along

  !> What displacements of the base, or their velocities, are to the coordinates.
  pure function of_coordinates(self, values) result(moved)
    class(base_motion_type), intent(in) :: self
    !> Shape (q).
    real(wp), intent(in) :: values(:)
    real(wp), allocatable :: moved(:)
    if (allocated(self%direction)) then
      moved = self%direction*values(1)
    else
      moved = values
    end if
  end function of_coordinates

  !> It moves each of n coordinates by cubics besides.
  subroutine add_cubics(self, n, direction, breaks, pieces)
    class(base_motion_type), intent(inout) :: self
    integer, intent(in) :: n
    !> How the coordinates move with one displacement; none: each has its own.
    real(wp), intent(in) :: direction(:)
    !> Shapes (m) and (4, 1 or n, m).
    real(wp), intent(in) :: breaks(:), pieces(:, :, :)
    integer :: i
    if (.not. self%moves()) then
      allocate (self%frequencies(0), self%amplitudes(n, 0))
    end if
    self%breaks = breaks
    self%pieces = pieces
    if (size(direction) == 0) return
    self%pieces = spread(pieces(:, 1, :), 2, n)
    do i = 1, n
      self%pieces(:, i, :) = direction(i)*pieces(:, 1, :)
    end do
  end subroutine add_cubics

  !> From a state relative to the base to that of the body; `share` -1: back.
  pure subroutine add_to(self, t, u, v, share)
    class(base_motion_type), intent(in) :: self
    real(wp), intent(in) :: t
    !> Shape (n_dof).
    real(wp), intent(inout) :: u(:), v(:)
    real(wp), intent(in), optional :: share
    real(wp), dimension(self%n_displacements()) :: displacement, velocity

    if (.not. self%moves()) return
    call self%along(t, displacement, velocity)
    if (present(share)) then
      displacement = share*displacement
      velocity = share*velocity
    end if
    u = u + self%of_coordinates(displacement)
    v = v + self%of_coordinates(velocity)
  end subroutine add_to

end module viscovib_base_motion
