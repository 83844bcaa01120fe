!> Finite rotations by the rotation vector theta: a rotation by the angle |theta| about theta.
!!
!! With S v = theta x v and q = theta . theta = t^2,
!!
!!   R = 1 + a S + b S^2,            a = sin t/t, b = (1 - cos t)/t^2,
!!   omega = T theta',               T = 1 - b S + c S^2, c = (t - sin t)/t^3,
!!   T^-1 = 1 + S/2 + d S^2,         d = (1 - a/(2 b))/q,
!!
!! where omega is the angular velocity in body axes (Cardona and Geradin 1988). All functions are
!! analytic in theta and computed with complex numbers, so that derivatives follow from imaginary
!! parts (complex steps, exact to rounding).
module viscovib_rotation
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: cross, new_rotation, rotation_type

  !> For |q| up to `small` the functions are series with this number of terms.
  real(wp), parameter :: small = 1.0_wp
  integer, parameter :: n_terms = 9
  integer :: i_term
  !> (-1)^n/(2 n + m)! for n = 0, 1, ... and m = 1 to 4.
  real(wp), parameter :: of_a(0:n_terms) = &
    [((-1)**i_term/gamma(2.0_wp*i_term + 2.0_wp), i_term=0, n_terms)]
  real(wp), parameter :: of_b(0:n_terms) = &
    [((-1)**i_term/gamma(2.0_wp*i_term + 3.0_wp), i_term=0, n_terms)]
  real(wp), parameter :: of_c(0:n_terms) = &
    [((-1)**i_term/gamma(2.0_wp*i_term + 4.0_wp), i_term=0, n_terms)]
  real(wp), parameter :: of_e(0:n_terms) = &
    [((-1)**i_term/gamma(2.0_wp*i_term + 5.0_wp), i_term=0, n_terms)]

  type :: rotation_type
    complex(wp) :: theta(3) = (0.0_wp, 0.0_wp)
    !> a, b, c, d, and the derivatives of b and c by q.
    complex(wp) :: a = (1.0_wp, 0.0_wp), b = (0.5_wp, 0.0_wp), c = (0.0_wp, 0.0_wp)
    complex(wp) :: d = (0.0_wp, 0.0_wp), b_slope = (0.0_wp, 0.0_wp), c_slope = (0.0_wp, 0.0_wp)
  contains
    procedure :: moved
    procedure :: turned
    procedure :: turned_back
    procedure :: spin
    procedure :: spin_transposed
    procedure :: unspin
    procedure :: unspin_transposed
    procedure :: spin_rate
  end type rotation_type

contains

  pure function new_rotation(theta) result(r)
    complex(wp), intent(in) :: theta(3)
    type(rotation_type) :: r
    complex(wp) :: q, t, e
    integer :: n

    r%theta = theta
    q = sum(theta*theta)
    if (abs(q) <= small) then
      r%a = (0.0_wp, 0.0_wp)
      r%b = (0.0_wp, 0.0_wp)
      e = (0.0_wp, 0.0_wp)
      do n = n_terms, 0, -1
        r%a = r%a*q + of_a(n)
        r%b = r%b*q + of_b(n)
        r%c = r%c*q + of_c(n)
        e = e*q + of_e(n)
        if (n == 0) cycle
        r%b_slope = r%b_slope*q + n*of_b(n)
        r%c_slope = r%c_slope*q + n*of_c(n)
      end do
      ! a = 1 - q c and 2 b = 1 - 2 q e.
      r%d = (r%c - 2.0_wp*e)/(2.0_wp*r%b)
    else
      t = sqrt(q)
      r%a = sin(t)/t
      r%b = (1.0_wp - cos(t))/q
      r%c = (1.0_wp - r%a)/q
      r%b_slope = (r%a - 2.0_wp*r%b)/(2.0_wp*q)
      r%c_slope = -((cos(t) - r%a)/(2.0_wp*q) + r%c)/q
      r%d = (1.0_wp - r%a/(2.0_wp*r%b))/q
    end if
  end function new_rotation

  pure function cross(u, v) result(w)
    complex(wp), intent(in) :: u(3), v(3)
    complex(wp) :: w(3)
    w = [u(2)*v(3) - u(3)*v(2), u(3)*v(1) - u(1)*v(3), u(1)*v(2) - u(2)*v(1)]
  end function cross

  !> R p - p - theta x p, without cancellation.
  pure function moved(self, p) result(w)
    class(rotation_type), intent(in) :: self
    complex(wp), intent(in) :: p(3)
    complex(wp) :: w(3)
    w = cross(self%theta, p)
    w = self%b*cross(self%theta, w) - sum(self%theta*self%theta)*self%c*w
  end function moved

  !> R v.
  pure function turned(self, v) result(w)
    class(rotation_type), intent(in) :: self
    complex(wp), intent(in) :: v(3)
    complex(wp) :: w(3)
    w = cross(self%theta, v)
    w = v + self%a*w + self%b*cross(self%theta, w)
  end function turned

  !> R^T v.
  pure function turned_back(self, v) result(w)
    class(rotation_type), intent(in) :: self
    complex(wp), intent(in) :: v(3)
    complex(wp) :: w(3)
    w = cross(self%theta, v)
    w = v - self%a*w + self%b*cross(self%theta, w)
  end function turned_back

  !> T v.
  pure function spin(self, v) result(w)
    class(rotation_type), intent(in) :: self
    complex(wp), intent(in) :: v(3)
    complex(wp) :: w(3)
    w = cross(self%theta, v)
    w = v - self%b*w + self%c*cross(self%theta, w)
  end function spin

  !> T^T v.
  pure function spin_transposed(self, v) result(w)
    class(rotation_type), intent(in) :: self
    complex(wp), intent(in) :: v(3)
    complex(wp) :: w(3)
    w = cross(self%theta, v)
    w = v + self%b*w + self%c*cross(self%theta, w)
  end function spin_transposed

  !> T^-1 v.
  pure function unspin(self, v) result(w)
    class(rotation_type), intent(in) :: self
    complex(wp), intent(in) :: v(3)
    complex(wp) :: w(3)
    w = cross(self%theta, v)
    w = v + 0.5_wp*w + self%d*cross(self%theta, w)
  end function unspin

  !> T^-T v.
  pure function unspin_transposed(self, v) result(w)
    class(rotation_type), intent(in) :: self
    complex(wp), intent(in) :: v(3)
    complex(wp) :: w(3)
    w = cross(self%theta, v)
    w = v - 0.5_wp*w + self%d*cross(self%theta, w)
  end function unspin_transposed

  !> (dT/dt) theta' for a rotation with the rate theta'.
  pure function spin_rate(self, rate) result(w)
    class(rotation_type), intent(in) :: self
    complex(wp), intent(in) :: rate(3)
    complex(wp) :: w(3), across(3), change
    across = cross(self%theta, rate)
    change = 2.0_wp*sum(self%theta*rate)
    w = change*(self%c_slope*cross(self%theta, across) - self%b_slope*across) &
        + self%c*cross(rate, across)
  end function spin_rate

end module viscovib_rotation
