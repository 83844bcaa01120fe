!> The shaft of a rotor whose speed changes in time.
!!
!! The angle phi of the shaft is the last coordinate of the system:
!!
!!   M x'' + (C + phi' G) x' + (K + phi' K1 + phi'^2 K2) x + f(x, x')
!!       = load + Im[u (phi'^2 - i phi'') exp(i phi)],
!!   J phi'' = T(phi', phi) - Re[u exp(i phi)] . x''.
!!
!! An unbalance of mass m and arms e, u = m e, is at x + Im[e exp(i phi)]; J includes it. These are
!! Lagrange's equations without the torques of G, K1 and K2 on the shaft, which are of second order
!! in x. The torque -T is a law of the system. Source: V. O. Kononenko, Vibrating Systems with a
!! Limited Power Supply, Iliffe 1969.
module viscovib_shaft
  use viscovib_kinds, only: wp
  use viscovib_speed_matrices, only: speed_matrices
  implicit none
  private

  public :: shaft_type

  type, extends(speed_matrices) :: shaft_type
    !> u of the other coordinates (kg m), shape (n). The matrices are of these coordinates, too.
    complex(wp), allocatable :: unbalance(:)
  end type shaft_type

end module viscovib_shaft
