! Optimize: -O3
!> Accelerations by a shaft whose speed changes in time (viscovib_shaft), in vector lanes.
!!
!! Let p = -Re[u exp(i phi)] and q = Im[u exp(i phi)]. With the accelerations a of the coordinates
!! and a_phi = T/J of the shaft without the angular acceleration of the unbalance,
!!
!!   x'' = a + M^(-1) p phi'',   (J - p . M^(-1) p) phi'' = J a_phi + p . a.
!!
!! A force that keeps a motion on a surface depends on these accelerations. It is linear in them, so
!! that phi'' and the reaction p . x''/J follow from three evaluations of the laws.
module viscovib_shaft_motion
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: add_multiple, add_two, n_lanes
  use viscovib_shaft, only: shaft_type
  use viscovib_switched_laws, only: switched_laws
  use viscovib_vector_math, only: largest_angle, sine_cosine_lanes
  implicit none
  private

  public :: new_shaft_motion, shaft_motion

  type, extends(shaft_type) :: shaft_motion
    !> Index of the angle; 0: no shaft.
    integer :: angle = 0
    logical, private :: is_unbalanced = .false.
    !> M^(-1) u, J, and the products a . M^(-1) a, a . M^(-1) b and b . M^(-1) b of u = a + i b. The
    !! matrices are M^(-1) G, ...
    complex(wp), allocatable, private :: moved(:)
    real(wp), private :: inertia = 0.0_wp, squares(3) = 0.0_wp
  contains
    procedure :: add_forces
    procedure :: add_laws
    procedure :: hold
    procedure, private :: act
    procedure, private :: react
  end type shaft_motion

contains

  pure subroutine new_shaft_motion(motion, shaft, mass, inverse)
    type(shaft_motion), intent(out) :: motion
    type(shaft_type), intent(in) :: shaft
    !> M and M^(-1) of all coordinates.
    real(wp), intent(in) :: mass(:, :), inverse(:, :)
    integer :: n

    motion%shaft_type = shaft
    n = size(shaft%unbalance)
    motion%angle = n + 1
    motion%inertia = mass(n + 1, n + 1)
    if (motion%depends_on_speed()) then
      motion%gyroscopic = matmul(inverse(:n, :n), shaft%gyroscopic)
      motion%circulatory = matmul(inverse(:n, :n), shaft%circulatory)
      motion%centrifugal = matmul(inverse(:n, :n), shaft%centrifugal)
    end if
    motion%is_unbalanced = any(abs(shaft%unbalance) > 0.0_wp)
    motion%moved = matmul(inverse(:n, :n), shaft%unbalance)
    associate (u => shaft%unbalance, x => motion%moved)
      motion%squares = [sum(real(u)*real(x)), sum(real(u)*aimag(x)), sum(aimag(u)*aimag(x))]
    end associate
  end subroutine new_shaft_motion

  !> Add the accelerations by the speed: of the matrices and of the centrifugal force.
  pure subroutine add_forces(self, n_dof, q, v, a)
    class(shaft_motion), intent(in) :: self
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: q(n_lanes, n_dof), v(n_lanes, n_dof)
    real(wp), intent(inout) :: a(n_lanes, n_dof)
    real(wp), dimension(n_lanes) :: sine, cosine, square, total
    integer :: b, d

    associate (speed => v(:, self%angle))
      if (self%depends_on_speed()) then
        do d = 1, size(self%moved)
          total = 0.0_wp
          do b = 1, size(self%moved)
            call add_two(total, self%gyroscopic(d, b), v(:, b), self%circulatory(d, b), q(:, b))
            call add_multiple(total, self%centrifugal(d, b), speed*q(:, b))
          end do
          a(:, d) = a(:, d) - speed*total
        end do
      end if
      if (.not. self%is_unbalanced) return
      call sine_cosine(q(:, self%angle), sine, cosine)
      square = speed**2
      do d = 1, size(self%moved)
        call add_two(a(:, d), real(self%moved(d)), square*sine, aimag(self%moved(d)), &
                     square*cosine)
      end do
    end associate
  end subroutine add_forces

  !> Add the accelerations by the laws and by the angular acceleration of the unbalance.
  pure subroutine add_laws(self, laws, n_dof, q, v, a, but)
    class(shaft_motion), intent(in) :: self
    type(switched_laws), intent(in) :: laws
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: q(n_lanes, n_dof), v(n_lanes, n_dof)
    !> All other accelerations before.
    real(wp), intent(inout) :: a(n_lanes, n_dof)
    !> As of `switched_laws`.
    integer, intent(in), optional :: but(:)
    real(wp), dimension(n_lanes) :: sine, cosine, left, torque
    real(wp) :: pushes(n_lanes, 2)

    call self%hold(laws, n_dof, q, v, a, but)
    call laws%add(q, v, a, but=but)
    if (.not. self%is_unbalanced .or. laws%n_slides() > 0) return
    call sine_cosine(q(:, self%angle), sine, cosine)
    left = self%inertia - self%squares(1)*cosine**2 - self%squares(3)*sine**2 &
           + 2.0_wp*self%squares(2)*sine*cosine
    torque = a(:, self%angle)
    pushes(:, 1) = self%inertia*(torque + self%react(n_dof, sine, cosine, a))/left
    pushes(:, 2) = pushes(:, 1) - torque
    call self%act(n_dof, sine, cosine, pushes, a)
  end subroutine add_laws

  !> If laws keep the motion on surfaces: add the accelerations by the angular acceleration of the
  !! unbalance, without which their forces are not known.
  pure subroutine hold(self, laws, n_dof, q, v, a, but)
    class(shaft_motion), intent(in) :: self
    type(switched_laws), intent(in) :: laws
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: q(n_lanes, n_dof), v(n_lanes, n_dof)
    real(wp), intent(inout) :: a(n_lanes, n_dof)
    integer, intent(in), optional :: but(:)
    real(wp) :: trial(n_lanes, n_dof), pushes(n_lanes, 2), off(n_lanes, 2, 0:2)
    real(wp), dimension(n_lanes) :: sine, cosine, determinant
    integer :: i

    if (.not. self%is_unbalanced .or. laws%n_slides() == 0) return
    call sine_cosine(q(:, self%angle), sine, cosine)
    do i = 0, 2
      pushes = 0.0_wp
      if (i > 0) pushes(:, i) = 1.0_wp
      trial = a
      call self%act(n_dof, sine, cosine, pushes, trial)
      call laws%add(q, v, trial, but=but)
      off(:, 1, i) = trial(:, self%angle) - pushes(:, 1)
      off(:, 2, i) = self%react(n_dof, sine, cosine, trial) - pushes(:, 2)
      if (i > 0) off(:, :, i) = off(:, :, i) - off(:, :, 0)
    end do
    determinant = off(:, 1, 1)*off(:, 2, 2) - off(:, 1, 2)*off(:, 2, 1)
    pushes(:, 1) = (off(:, 1, 2)*off(:, 2, 0) - off(:, 2, 2)*off(:, 1, 0))/determinant
    pushes(:, 2) = (off(:, 2, 1)*off(:, 1, 0) - off(:, 1, 1)*off(:, 2, 0))/determinant
    call self%act(n_dof, sine, cosine, pushes, a)
  end subroutine hold

  !> Add M^(-1) p times an angular acceleration, and a reaction on the shaft, the two `pushes`.
  pure subroutine act(self, n_dof, sine, cosine, pushes, a)
    class(shaft_motion), intent(in) :: self
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: sine(n_lanes), cosine(n_lanes), pushes(n_lanes, 2)
    real(wp), intent(inout) :: a(n_lanes, n_dof)
    integer :: d
    do d = 1, size(self%moved)
      call add_two(a(:, d), -real(self%moved(d)), cosine*pushes(:, 1), aimag(self%moved(d)), &
                   sine*pushes(:, 1))
    end do
    a(:, self%angle) = a(:, self%angle) + pushes(:, 2)
  end subroutine act

  !> p . a/J.
  pure function react(self, n_dof, sine, cosine, a) result(push)
    class(shaft_motion), intent(in) :: self
    integer, intent(in) :: n_dof
    real(wp), intent(in) :: sine(n_lanes), cosine(n_lanes), a(n_lanes, n_dof)
    real(wp) :: push(n_lanes)
    integer :: d
    push = 0.0_wp
    do d = 1, size(self%moved)
      call add_two(push, -real(self%unbalance(d))/self%inertia, cosine*a(:, d), &
                   aimag(self%unbalance(d))/self%inertia, sine*a(:, d))
    end do
  end function react

  !> Sine and cosine of any angle.
  pure subroutine sine_cosine(angle, sine, cosine)
    real(wp), intent(in) :: angle(n_lanes)
    real(wp), intent(out) :: sine(n_lanes), cosine(n_lanes)
    if (all(abs(angle) <= largest_angle)) then
      call sine_cosine_lanes(angle, sine, cosine)
    else
      sine = sin(angle)
      cosine = cos(angle)
    end if
  end subroutine sine_cosine

end module viscovib_shaft_motion
