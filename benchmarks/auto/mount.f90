! AUTO-07p user file of the reference mount without memory (cubic geometry): M u'' + C u' + K u
! + N(u) = load sin(nu t) on x. The load is the limit cycle s = sin(nu t) of an oscillator,
! s' = s + nu c - s (s^2 + c^2), c' = c - nu s - c (s^2 + c^2). The numbers are those of branch.py.
! PAR(1) = nu (rad/s), PAR(11) = period (s); U = x, x', phi, phi', s, c.

subroutine func(ndim, u, icp, par, ijac, f, dfdu, dfdp)
  implicit none
  integer, intent(in) :: ndim, icp(*), ijac
  double precision, intent(in) :: u(ndim), par(*)
  double precision, intent(out) :: f(ndim)
  double precision, intent(inout) :: dfdu(ndim, ndim), dfdp(ndim, *)
  double precision, parameter :: k11 = 10, k12 = -5, k22 = 4.5d0, eta = 0.02d0, load = 0.5d0
  double precision, parameter :: mass = 1, inertia = 0.1d0
  double precision :: x, v, p, w, s, c, nu, r2

  x = u(1); v = u(2); p = u(3); w = u(4); s = u(5); c = u(6); nu = par(1)
  r2 = s**2 + c**2
  f(1) = v
  f(2) = (load*s - k11*(x + eta*v) - k12*(p + eta*w) - 5*p**3/6)/mass
  f(3) = w
  f(4) = (-k12*(x + eta*v) - k22*(p + eta*w) - 2.5d0*p**2*x + 5*p**3/3)/inertia
  f(5) = s + nu*c - s*r2
  f(6) = c - nu*s - c*r2
  if (ijac == 0) return
  dfdu = 0
  dfdu(1, 2) = 1
  dfdu(2, 1:6) = [-k11, -k11*eta, -k12 - 2.5d0*p**2, -k12*eta, load, 0d0]/mass
  dfdu(3, 4) = 1
  dfdu(4, 1:4) = [-k12 - 2.5d0*p**2, -k12*eta, -k22 - 5*p*x + 5*p**2, -k22*eta]/inertia
  dfdu(5, 5:6) = [1 - r2 - 2*s**2, nu - 2*s*c]
  dfdu(6, 5:6) = [-nu - 2*s*c, 1 - r2 - 2*c**2]
  if (ijac == 1) return
  dfdp(:, 1) = 0
  dfdp(5, 1) = c
  dfdp(6, 1) = -s
end subroutine func

! Start: the linear response at nu = 0.5, over one period, t scaled to [0, 1].
subroutine stpnt(ndim, u, par, t)
  implicit none
  integer, intent(in) :: ndim
  double precision, intent(inout) :: u(ndim), par(*)
  double precision, intent(in) :: t
  double precision, parameter :: two_pi = 8*atan(1d0), load = 0.5d0
  double precision :: nu
  double complex :: a11, a12, a22, turn

  nu = 0.5d0
  par(1) = nu
  par(11) = two_pi/nu
  a11 = 10*cmplx(1d0, 0.02d0*nu, kind(nu)) - nu**2
  a12 = -5*cmplx(1d0, 0.02d0*nu, kind(nu))
  a22 = 4.5d0*cmplx(1d0, 0.02d0*nu, kind(nu)) - 0.1d0*nu**2
  turn = exp(cmplx(0d0, two_pi*t, kind(nu)))*load/(a11*a22 - a12**2)
  u(1) = aimag(a22*turn)
  u(2) = nu*dble(a22*turn)
  u(3) = -aimag(a12*turn)
  u(4) = -nu*dble(a12*turn)
  u(5) = sin(two_pi*t)
  u(6) = cos(two_pi*t)
end subroutine stpnt

subroutine bcnd()
end subroutine bcnd

subroutine icnd()
end subroutine icnd

subroutine fopt()
end subroutine fopt

subroutine pvls()
end subroutine pvls
