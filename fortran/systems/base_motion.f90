! Optimize: -O2
!> Motion of the base: sinusoids, and a piecewise polynomial with corners. The equations use
!! coordinates relative to the base; given and stored states are absolute.
!!
!! At a corner of the base motion the relative velocity jumps, but the absolute velocity is
!! continuous. Velocities are those of the current time interval, also at its ends.
module viscovib_base_motion
  use viscovib_constants, only: imaginary_unit
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: base_motion_type

  type :: base_motion_type
    !> Displacement of the coordinates per unit displacement of the base, shape (n_dof). Not
    !! allocated: the base has a displacement for each coordinate.
    real(wp), allocatable :: direction(:)
    !> Displacements Im sum_k amplitudes(:,k) exp(i frequencies(k) t), shape (q, m); not allocated:
    !! the base is at rest.
    real(wp), allocatable :: frequencies(:)
    complex(wp), allocatable :: amplitudes(:, :)
    !> Additional polynomials sum_p pieces(p,:,i) (t - breaks(i))^(n_powers-p), each valid from its
    !! break to the next, the last without end. Before the first break the base has its position at
    !! that break. Shapes (n) and (n_powers, q, n).
    real(wp), allocatable :: breaks(:), pieces(:, :, :)
    integer, private :: present = 0
  contains
    procedure :: moves
    procedure :: has_corners
    procedure :: enter
    procedure :: n_displacements
    procedure :: along
    procedure :: at_times
    procedure :: of_coordinates
    procedure :: add_to
    procedure :: add_polynomials
  end type base_motion_type

contains

  pure logical function moves(self)
    class(base_motion_type), intent(in) :: self
    moves = allocated(self%amplitudes)
  end function moves

  !> True if relative velocities may jump.
  pure logical function has_corners(self)
    class(base_motion_type), intent(in) :: self
    has_corners = .false.
    if (allocated(self%breaks)) has_corners = self%moves() .and. size(self%breaks) > 0
  end function has_corners

  !> Select the polynomial of a time interval that contains no corner.
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

  !> Base displacements, their velocities and accelerations at time t.
  pure subroutine along(self, t, displacement, velocity, acceleration)
    class(base_motion_type), intent(in) :: self
    real(wp), intent(in) :: t
    !> Shape (q).
    real(wp), intent(out) :: displacement(:), velocity(:)
    real(wp), intent(out), optional :: acceleration(:)
    complex(wp) :: wave(size(displacement))
    real(wp), dimension(size(displacement)) :: place, speed, half, push
    real(wp) :: x
    integer :: k, m

    displacement = 0.0_wp
    velocity = 0.0_wp
    push = 0.0_wp
    if (present(acceleration)) acceleration = 0.0_wp
    if (.not. self%moves()) return
    do k = 1, size(self%frequencies)
      if (.not. any(abs(self%amplitudes(:, k)) > 0.0_wp)) cycle
      wave = self%amplitudes(:, k)*exp(imaginary_unit*(self%frequencies(k)*t))
      displacement = displacement + aimag(wave)
      velocity = velocity + self%frequencies(k)*real(wave)
      push = push - self%frequencies(k)**2*aimag(wave)
    end do
    if (present(acceleration)) acceleration = push
    if (.not. self%has_corners()) return
    m = size(self%pieces, 1)
    if (self%present == 0) then
      displacement = displacement + self%pieces(m, :, 1)
      return
    end if
    x = t - self%breaks(self%present)
    place = 0.0_wp
    speed = 0.0_wp
    half = 0.0_wp
    do k = 1, m
      half = half*x + speed
      speed = speed*x + place
      place = place*x + self%pieces(k, :, self%present)
    end do
    displacement = displacement + place
    velocity = velocity + speed
    if (present(acceleration)) acceleration = acceleration + 2.0_wp*half
  end subroutine along

  !> Displacements, velocities and accelerations of n coordinates at times, shape (size(t), n, 3);
  !! at a corner those after it.
  pure function at_times(self, n, t) result(moved)
    class(base_motion_type), intent(in) :: self
    integer, intent(in) :: n
    real(wp), intent(in) :: t(:)
    real(wp) :: moved(size(t), n, 3)
    type(base_motion_type) :: base
    real(wp), dimension(self%n_displacements()) :: displacement, velocity, acceleration
    integer :: i

    moved = 0.0_wp
    if (.not. self%moves()) return
    base = self
    do i = 1, size(t)
      call base%enter(t(i), t(i))
      call base%along(t(i), displacement, velocity, acceleration)
      moved(i, :, 1) = self%of_coordinates(displacement)
      moved(i, :, 2) = self%of_coordinates(velocity)
      moved(i, :, 3) = self%of_coordinates(acceleration)
    end do
  end function at_times

  !> Map base displacements or velocities to the coordinates.
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

  !> Add a base motion of n coordinates given by polynomials.
  subroutine add_polynomials(self, n, direction, breaks, pieces)
    class(base_motion_type), intent(inout) :: self
    integer, intent(in) :: n
    !> Displacement of the coordinates per unit base displacement; empty: one displacement each.
    real(wp), intent(in) :: direction(:)
    !> Shapes (m) and (n_powers, 1 or n, m).
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
  end subroutine add_polynomials

  !> Convert a relative state to an absolute state; `share` = -1 converts back.
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
