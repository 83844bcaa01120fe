! Optimize: -O1
!> Motion of a point of a body.
!!
!! With the rotation R of the rotation vector theta and the point a from the mass centre at rest, a
!! point at u + R a has
!!
!!   d = u + R a - a,   d' = u' + R (w x a),   d'' = u'' + R (w' x a + w x (w x a)),
!!
!! w = T theta' the angular velocity in axes of the body (`viscovib_rotation`). For small rotations
!! d = u + theta x a.
module viscovib_point_motion
  use viscovib_kinds, only: wp
  use viscovib_rotation, only: cross, new_rotation, rotation_type
  implicit none
  private

  public :: move_point

  !> Rotations have complex numbers.
  complex(wp), parameter :: one = (1.0_wp, 0.0_wp)

contains

  !> Displacements, velocities and accelerations of a point, shape (n, 3, 3).
  pure function move_point(arm, exact, u, rate, push) result(moved)
    !> From the mass centre at rest.
    real(wp), intent(in) :: arm(3)
    !> True for finite rotations.
    logical, intent(in) :: exact
    !> Coordinates and their derivatives, of which the first six are those of the body, (n, n_dof).
    real(wp), intent(in) :: u(:, :), rate(:, :), push(:, :)
    real(wp) :: moved(size(u, 1), 3, 3)
    type(rotation_type) :: r
    complex(wp), dimension(3) :: a, w, w_rate
    integer :: i

    a = arm
    do i = 1, size(u, 1)
      if (exact) then
        r = new_rotation(one*u(i, 4:6))
        w = r%spin(one*rate(i, 4:6))
        w_rate = r%spin(one*push(i, 4:6)) + r%spin_rate(one*rate(i, 4:6))
        moved(i, :, 1) = real(cross(one*u(i, 4:6), a) + r%moved(a))
        moved(i, :, 2) = real(r%turned(cross(w, a)))
        moved(i, :, 3) = real(r%turned(cross(w_rate, a) + cross(w, cross(w, a))))
      else
        moved(i, :, 1) = real(cross(one*u(i, 4:6), a))
        moved(i, :, 2) = real(cross(one*rate(i, 4:6), a))
        moved(i, :, 3) = real(cross(one*push(i, 4:6), a))
      end if
    end do
    moved(:, :, 1) = moved(:, :, 1) + u(:, :3)
    moved(:, :, 2) = moved(:, :, 2) + rate(:, :3)
    moved(:, :, 3) = moved(:, :, 3) + push(:, :3)
  end function move_point

end module viscovib_point_motion
