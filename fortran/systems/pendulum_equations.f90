! Optimize: -O3
!> The equations of the spring pendulum in vector lanes, with their derivatives.
!!
!! q = (z, phi, psi), s = sin(phi-psi), c = cos(phi-psi), Z = 1+z, p = psi'';
!! all three variants read
!!
!!   z''   + e S p            = A1,
!!   Q phi'' + e G p          = A2,
!!   p + r (S z'' + H phi'')  = A3,
!!
!! exact:   S = s, G = H = Z c, Q = Z^2;
!! cubic:   everything expanded to third order, S = d, G = H = 1 + z - d^2/2,
!!          d = phi - psi, Q = Z^2;
!! printed: G = 0 (its psi'' is printed as psi'), H = c, Q = Z^2.
!!
!! Source: "Plane motion of the rigid body with the spring-damper suspension" (seed paper 000), with
!! its misprints corrected (docs/explanation). Derivatives by the chain rule, line by line: d_x is
!! the change of x in the given direction.
module viscovib_pendulum_equations
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_vector_math, only: sine_cosine_lanes
  implicit none
  private

  public :: exact_acceleration, cubic_acceleration
  public :: exact_tangent, cubic_tangent, printed_tangent

  !> Indices of the constants: e, r, w2^2, w3^2, stiffness 1 + 3 alpha z_r^2, 3 alpha z_r, alpha,
  !! damping, loads, 1/(1 - e r).
  integer, parameter, public :: i_e = 1, i_r = 2, i_w2 = 3, i_w3 = 4, i_stiffness = 5, &
                                i_square = 6, i_alpha = 7, i_damping = 8, i_load = 11, &
                                i_inverse = 14, n_constants = 14

contains

  pure subroutine exact_acceleration(k, q, v, drive, a)
    real(wp), intent(in) :: k(n_lanes, n_constants)
    real(wp), intent(in) :: q(n_lanes, 3), v(n_lanes, 3), drive(n_lanes, 3)
    real(wp), intent(out) :: a(n_lanes, 3)
    real(wp), dimension(n_lanes) :: sin_phi, cos_phi, sin_psi, cos_psi
    real(wp) :: length, over_length, a1, a2, a3, s, c, p
    integer :: l

    call sine_cosine_lanes(q(:, 2), sin_phi, cos_phi)
    call sine_cosine_lanes(q(:, 3), sin_psi, cos_psi)
    !GCC$ unroll 1
    do l = 1, n_lanes
      length = 1.0_wp + q(l, 1)
      over_length = 1.0_wp/length
      s = sin_phi(l)*cos_psi(l) - cos_phi(l)*sin_psi(l)
      c = cos_phi(l)*cos_psi(l) + sin_phi(l)*sin_psi(l)
      a1 = k(l, i_load)*drive(l, 1) - k(l, i_damping)*v(l, 1) &
           + k(l, i_w2)*(cos_phi(l) - 1.0_wp) &
           - q(l, 1)*(k(l, i_stiffness) + q(l, 1)*(k(l, i_square) + k(l, i_alpha)*q(l, 1))) &
           + length*v(l, 2)**2 + k(l, i_e)*c*v(l, 3)**2
      a2 = (k(l, i_load + 1)*drive(l, 2) - k(l, i_damping + 1)*v(l, 2))*over_length &
           - k(l, i_w2)*sin_phi(l) - 2.0_wp*v(l, 1)*v(l, 2) - k(l, i_e)*s*v(l, 3)**2
      a3 = k(l, i_load + 2)*drive(l, 3) - k(l, i_damping + 2)*v(l, 3) - k(l, i_w3)*sin_psi(l) &
           - k(l, i_r)*(2.0_wp*c*v(l, 1)*v(l, 2) - length*s*v(l, 2)**2)
      p = (a3 - k(l, i_r)*(s*a1 + c*a2))*k(l, i_inverse)
      a(l, 1) = a1 - k(l, i_e)*s*p
      a(l, 2) = (a2 - k(l, i_e)*c*p)*over_length
      a(l, 3) = p
    end do
  end subroutine exact_acceleration

  pure subroutine cubic_acceleration(k, q, v, drive, a)
    real(wp), intent(in) :: k(n_lanes, n_constants)
    real(wp), intent(in) :: q(n_lanes, 3), v(n_lanes, 3), drive(n_lanes, 3)
    real(wp), intent(out) :: a(n_lanes, 3)
    real(wp) :: length, phi, psi, d, g, over_square, a1, a2, a3, p
    integer :: l

    !GCC$ unroll 1
    do l = 1, n_lanes
      length = 1.0_wp + q(l, 1)
      phi = q(l, 2)
      psi = q(l, 3)
      d = phi - psi
      g = length - 0.5_wp*d**2
      over_square = 1.0_wp/length**2
      a1 = k(l, i_load)*drive(l, 1) - k(l, i_damping)*v(l, 1) - 0.5_wp*k(l, i_w2)*phi**2 &
           - q(l, 1)*(k(l, i_stiffness) + q(l, 1)*(k(l, i_square) + k(l, i_alpha)*q(l, 1))) &
           + length*v(l, 2)**2 + k(l, i_e)*v(l, 3)**2
      a2 = k(l, i_load + 1)*drive(l, 2) - k(l, i_damping + 1)*v(l, 2) &
           - k(l, i_w2)*(phi*length - phi**3/6.0_wp) &
           - 2.0_wp*length*v(l, 1)*v(l, 2) - k(l, i_e)*d*v(l, 3)**2
      a3 = k(l, i_load + 2)*drive(l, 3) - k(l, i_damping + 2)*v(l, 3) &
           - k(l, i_w3)*(psi - psi**3/6.0_wp) &
           - k(l, i_r)*(2.0_wp*v(l, 1)*v(l, 2) - d*v(l, 2)**2)
      p = (a3 - k(l, i_r)*(d*a1 + g*a2*over_square)) &
          /(1.0_wp - k(l, i_e)*k(l, i_r)*(d**2 + g**2*over_square))
      a(l, 1) = a1 - k(l, i_e)*d*p
      a(l, 2) = (a2 - k(l, i_e)*g*p)*over_square
      a(l, 3) = p
    end do
  end subroutine cubic_acceleration

  pure subroutine exact_tangent(k, q, v, drive, dq, dv, a, da)
    real(wp), intent(in) :: k(n_lanes, n_constants)
    real(wp), dimension(n_lanes, 3), intent(in) :: q, v, drive, dq, dv
    real(wp), intent(out) :: a(n_lanes, 3), da(n_lanes, 3)
    real(wp), dimension(n_lanes) :: sin_phi, cos_phi, sin_psi, cos_psi
    real(wp) :: length, over_length, d_over, a1, a2, a3, s, c, p, d_s, d_c, d_a1, d_a2, d_a3, d_p
    real(wp) :: d_product
    integer :: l

    call sine_cosine_lanes(q(:, 2), sin_phi, cos_phi)
    call sine_cosine_lanes(q(:, 3), sin_psi, cos_psi)
    !GCC$ unroll 1
    do l = 1, n_lanes
      length = 1.0_wp + q(l, 1)
      over_length = 1.0_wp/length
      d_over = -over_length**2*dq(l, 1)
      s = sin_phi(l)*cos_psi(l) - cos_phi(l)*sin_psi(l)
      c = cos_phi(l)*cos_psi(l) + sin_phi(l)*sin_psi(l)
      d_s = c*(dq(l, 2) - dq(l, 3))
      d_c = -s*(dq(l, 2) - dq(l, 3))
      d_product = dv(l, 1)*v(l, 2) + v(l, 1)*dv(l, 2)
      a1 = k(l, i_load)*drive(l, 1) - k(l, i_damping)*v(l, 1) &
           + k(l, i_w2)*(cos_phi(l) - 1.0_wp) &
           - q(l, 1)*(k(l, i_stiffness) + q(l, 1)*(k(l, i_square) + k(l, i_alpha)*q(l, 1))) &
           + length*v(l, 2)**2 + k(l, i_e)*c*v(l, 3)**2
      d_a1 = -k(l, i_damping)*dv(l, 1) - k(l, i_w2)*sin_phi(l)*dq(l, 2) &
             - (k(l, i_stiffness) + q(l, 1)*(2.0_wp*k(l, i_square) &
                                             + 3.0_wp*k(l, i_alpha)*q(l, 1)))*dq(l, 1) &
             + dq(l, 1)*v(l, 2)**2 + 2.0_wp*length*v(l, 2)*dv(l, 2) &
             + k(l, i_e)*(d_c*v(l, 3)**2 + 2.0_wp*c*v(l, 3)*dv(l, 3))
      a2 = k(l, i_load + 1)*drive(l, 2) - k(l, i_damping + 1)*v(l, 2)
      d_a2 = a2*d_over - k(l, i_damping + 1)*dv(l, 2)*over_length &
             - k(l, i_w2)*cos_phi(l)*dq(l, 2) - 2.0_wp*d_product &
             - k(l, i_e)*(d_s*v(l, 3)**2 + 2.0_wp*s*v(l, 3)*dv(l, 3))
      a2 = a2*over_length - k(l, i_w2)*sin_phi(l) - 2.0_wp*v(l, 1)*v(l, 2) &
           - k(l, i_e)*s*v(l, 3)**2
      a3 = k(l, i_load + 2)*drive(l, 3) - k(l, i_damping + 2)*v(l, 3) - k(l, i_w3)*sin_psi(l) &
           - k(l, i_r)*(2.0_wp*c*v(l, 1)*v(l, 2) - length*s*v(l, 2)**2)
      d_a3 = -k(l, i_damping + 2)*dv(l, 3) - k(l, i_w3)*cos_psi(l)*dq(l, 3) &
             - k(l, i_r)*(2.0_wp*(d_c*v(l, 1)*v(l, 2) + c*d_product) &
                          - (dq(l, 1)*s + length*d_s)*v(l, 2)**2 &
                          - 2.0_wp*length*s*v(l, 2)*dv(l, 2))
      p = (a3 - k(l, i_r)*(s*a1 + c*a2))*k(l, i_inverse)
      d_p = (d_a3 - k(l, i_r)*(d_s*a1 + s*d_a1 + d_c*a2 + c*d_a2))*k(l, i_inverse)
      a(l, 1) = a1 - k(l, i_e)*s*p
      a(l, 2) = (a2 - k(l, i_e)*c*p)*over_length
      a(l, 3) = p
      da(l, 1) = d_a1 - k(l, i_e)*(d_s*p + s*d_p)
      da(l, 2) = (d_a2 - k(l, i_e)*(d_c*p + c*d_p))*over_length + (a2 - k(l, i_e)*c*p)*d_over
      da(l, 3) = d_p
    end do
  end subroutine exact_tangent

  pure subroutine cubic_tangent(k, q, v, drive, dq, dv, a, da)
    real(wp), intent(in) :: k(n_lanes, n_constants)
    real(wp), dimension(n_lanes, 3), intent(in) :: q, v, drive, dq, dv
    real(wp), intent(out) :: a(n_lanes, 3), da(n_lanes, 3)
    real(wp) :: length, phi, psi, d, g, h, over_square, d_square, a1, a2, a3, p, bottom
    real(wp) :: d_d, d_g, d_h, d_a1, d_a2, d_a3, d_p, d_top, d_bottom, d_product
    integer :: l

    do l = 1, n_lanes
      length = 1.0_wp + q(l, 1)
      phi = q(l, 2)
      psi = q(l, 3)
      d = phi - psi
      d_d = dq(l, 2) - dq(l, 3)
      g = length - 0.5_wp*d**2
      d_g = dq(l, 1) - d*d_d
      over_square = 1.0_wp/length**2
      d_square = 2.0_wp*length*dq(l, 1)
      d_product = dv(l, 1)*v(l, 2) + v(l, 1)*dv(l, 2)
      a1 = k(l, i_load)*drive(l, 1) - k(l, i_damping)*v(l, 1) - 0.5_wp*k(l, i_w2)*phi**2 &
           - q(l, 1)*(k(l, i_stiffness) + q(l, 1)*(k(l, i_square) + k(l, i_alpha)*q(l, 1))) &
           + length*v(l, 2)**2 + k(l, i_e)*v(l, 3)**2
      d_a1 = -k(l, i_damping)*dv(l, 1) - k(l, i_w2)*phi*dq(l, 2) &
             - (k(l, i_stiffness) + q(l, 1)*(2.0_wp*k(l, i_square) &
                                             + 3.0_wp*k(l, i_alpha)*q(l, 1)))*dq(l, 1) &
             + dq(l, 1)*v(l, 2)**2 + 2.0_wp*length*v(l, 2)*dv(l, 2) &
             + 2.0_wp*k(l, i_e)*v(l, 3)*dv(l, 3)
      a2 = k(l, i_load + 1)*drive(l, 2) - k(l, i_damping + 1)*v(l, 2) &
           - k(l, i_w2)*(phi*length - phi**3/6.0_wp) &
           - 2.0_wp*length*v(l, 1)*v(l, 2) - k(l, i_e)*d*v(l, 3)**2
      d_a2 = -k(l, i_damping + 1)*dv(l, 2) &
             - k(l, i_w2)*(dq(l, 2)*(length - 0.5_wp*phi**2) + phi*dq(l, 1)) &
             - 2.0_wp*(dq(l, 1)*v(l, 1)*v(l, 2) + length*d_product) &
             - k(l, i_e)*(d_d*v(l, 3)**2 + 2.0_wp*d*v(l, 3)*dv(l, 3))
      a3 = k(l, i_load + 2)*drive(l, 3) - k(l, i_damping + 2)*v(l, 3) &
           - k(l, i_w3)*(psi - psi**3/6.0_wp) &
           - k(l, i_r)*(2.0_wp*v(l, 1)*v(l, 2) - d*v(l, 2)**2)
      d_a3 = -k(l, i_damping + 2)*dv(l, 3) - k(l, i_w3)*(1.0_wp - 0.5_wp*psi**2)*dq(l, 3) &
             - k(l, i_r)*(2.0_wp*d_product - d_d*v(l, 2)**2 - 2.0_wp*d*v(l, 2)*dv(l, 2))
      h = g*over_square
      d_h = (d_g - h*d_square)*over_square
      bottom = 1.0_wp - k(l, i_e)*k(l, i_r)*(d**2 + g*h)
      d_bottom = -k(l, i_e)*k(l, i_r)*(2.0_wp*d*d_d + d_g*h + g*d_h)
      p = (a3 - k(l, i_r)*(d*a1 + h*a2))/bottom
      d_top = d_a3 - k(l, i_r)*(d_d*a1 + d*d_a1 + d_h*a2 + h*d_a2)
      d_p = (d_top - p*d_bottom)/bottom
      a(l, 1) = a1 - k(l, i_e)*d*p
      a(l, 2) = (a2 - k(l, i_e)*g*p)*over_square
      a(l, 3) = p
      da(l, 1) = d_a1 - k(l, i_e)*(d_d*p + d*d_p)
      da(l, 2) = (d_a2 - k(l, i_e)*(d_g*p + g*d_p) - a(l, 2)*d_square)*over_square
      da(l, 3) = d_p
    end do
  end subroutine cubic_tangent

  pure subroutine printed_tangent(k, q, v, drive, dq, dv, a, da)
    real(wp), intent(in) :: k(n_lanes, n_constants)
    real(wp), dimension(n_lanes, 3), intent(in) :: q, v, drive, dq, dv
    real(wp), intent(out) :: a(n_lanes, 3), da(n_lanes, 3)
    real(wp), dimension(n_lanes) :: sin_phi, cos_phi, sin_psi, cos_psi
    real(wp) :: length, a1, a2, a3, s, c, p, bottom
    real(wp) :: d_s, d_c, d_a1, d_a2, d_a3, d_p, d_product, d_bottom
    integer :: l

    call sine_cosine_lanes(q(:, 2), sin_phi, cos_phi)
    call sine_cosine_lanes(q(:, 3), sin_psi, cos_psi)
    do l = 1, n_lanes
      length = 1.0_wp + q(l, 1)
      s = sin_phi(l)*cos_psi(l) - cos_phi(l)*sin_psi(l)
      c = cos_phi(l)*cos_psi(l) + sin_phi(l)*sin_psi(l)
      d_s = c*(dq(l, 2) - dq(l, 3))
      d_c = -s*(dq(l, 2) - dq(l, 3))
      d_product = dv(l, 1)*v(l, 2) + v(l, 1)*dv(l, 2)
      a1 = k(l, i_load)*drive(l, 1) - k(l, i_damping)*v(l, 1) &
           + k(l, i_w2)*(cos_phi(l) - 1.0_wp) &
           - q(l, 1)*(k(l, i_stiffness) + q(l, 1)*(k(l, i_square) + k(l, i_alpha)*q(l, 1))) &
           + length*v(l, 2)**2 + k(l, i_e)*c*v(l, 3)**2
      d_a1 = -k(l, i_damping)*dv(l, 1) - k(l, i_w2)*sin_phi(l)*dq(l, 2) &
             - (k(l, i_stiffness) + q(l, 1)*(2.0_wp*k(l, i_square) &
                                             + 3.0_wp*k(l, i_alpha)*q(l, 1)))*dq(l, 1) &
             + dq(l, 1)*v(l, 2)**2 + 2.0_wp*length*v(l, 2)*dv(l, 2) &
             + k(l, i_e)*(d_c*v(l, 3)**2 + 2.0_wp*c*v(l, 3)*dv(l, 3))
      a2 = k(l, i_load + 1)*drive(l, 2) - k(l, i_damping + 1)*v(l, 2) &
           - k(l, i_w2)*length*sin_phi(l) - 2.0_wp*q(l, 1)*v(l, 1)*v(l, 2) &
           - k(l, i_e)*length*(s*v(l, 3)**2 + c*v(l, 3))
      d_a2 = -k(l, i_damping + 1)*dv(l, 2) &
             - k(l, i_w2)*(dq(l, 1)*sin_phi(l) + length*cos_phi(l)*dq(l, 2)) &
             - 2.0_wp*(dq(l, 1)*v(l, 1)*v(l, 2) + q(l, 1)*d_product) &
             - k(l, i_e)*(dq(l, 1)*(s*v(l, 3)**2 + c*v(l, 3)) &
                          + length*(d_s*v(l, 3)**2 + 2.0_wp*s*v(l, 3)*dv(l, 3) &
                                    + d_c*v(l, 3) + c*dv(l, 3)))
      a3 = k(l, i_load + 2)*drive(l, 3) - k(l, i_damping + 2)*v(l, 3) - k(l, i_w3)*sin_psi(l) &
           - k(l, i_r)*(2.0_wp*c*v(l, 1)*v(l, 2) - length*s*v(l, 2)**2)
      d_a3 = -k(l, i_damping + 2)*dv(l, 3) - k(l, i_w3)*cos_psi(l)*dq(l, 3) &
             - k(l, i_r)*(2.0_wp*(d_c*v(l, 1)*v(l, 2) + c*d_product) &
                          - (dq(l, 1)*s + length*d_s)*v(l, 2)**2 &
                          - 2.0_wp*length*s*v(l, 2)*dv(l, 2))
      a2 = a2/length**2
      d_a2 = d_a2/length**2 - 2.0_wp*a2*dq(l, 1)/length
      bottom = 1.0_wp - k(l, i_e)*k(l, i_r)*s**2
      d_bottom = -2.0_wp*k(l, i_e)*k(l, i_r)*s*d_s
      p = (a3 - k(l, i_r)*(s*a1 + c*a2))/bottom
      d_p = (d_a3 - k(l, i_r)*(d_s*a1 + s*d_a1 + d_c*a2 + c*d_a2) - p*d_bottom)/bottom
      a(l, 1) = a1 - k(l, i_e)*s*p
      a(l, 2) = a2
      a(l, 3) = p
      da(l, 1) = d_a1 - k(l, i_e)*(d_s*p + s*d_p)
      da(l, 2) = d_a2
      da(l, 3) = d_p
    end do
  end subroutine printed_tangent

end module viscovib_pendulum_equations
