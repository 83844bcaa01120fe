!> Free motions of a driven system without losses and loads, as a curve in amplitude or energy
!! (nonlinear normal modes).
!!
!! q'' = a(q, q') with a(q, -q') = a(q, q') is invariant under time reversal, so a motion that
!! begins at rest is even in time: q = sum_k a_k cos(k nu t). The unknowns are these cosine
!! coefficients and the frequency. The equations are those of harmonic balance and one for the
!! parameter, the amplitude or energy. Where modes interact the curve may have folds and branch
!! points. Rosenberg, Adv. Appl. Mech. 9 (1966) 155; Kerschen et al., Mech. Syst. Signal Process. 23
!! (2009) 170.
module viscovib_free_curve
  use viscovib_curve, only: curve_type
  use viscovib_driven_system, only: differentiable_system_type
  use viscovib_kinds, only: wp
  use viscovib_torus, only: torus_type
  use viscovib_torus_balance, only: new_torus_balance, torus_balance_type
  implicit none
  private

  public :: free_curve_type, new_free_curve

  !> Unknowns: the cosine coefficients, and the frequency in units of `unit`.
  type, extends(curve_type) :: free_curve_type
    type(torus_balance_type) :: motion
    real(wp) :: unit = 1.0_wp
    !> Index of the unknown that is the amplitude; 0: the energy is the parameter.
    integer :: measured = 0
  contains
    procedure :: equations
    procedure :: residual
    procedure :: raise_terms
    procedure :: at_rest
    procedure :: frequency
    procedure :: energy
    procedure :: n_cosines
    procedure, private :: size_of
  end type free_curve_type

contains

  subroutine new_free_curve(curve, system, torus, kept, unit, dof, order)
    type(free_curve_type), intent(out) :: curve
    !> System without damping; its loads are ignored.
    class(differentiable_system_type), intent(in), target :: system
    !> Torus with one axis.
    type(torus_type), intent(in) :: torus
    !> Orders of each coordinate that are unknowns, shape (n_orders, n_dof).
    logical, intent(in) :: kept(:, :)
    !> Base frequency of small motions.
    real(wp), intent(in) :: unit
    !> The amplitude is that of order `order` of coordinate `dof`, which must be an unknown; dof =
    !! 0: the energy is the parameter.
    integer, intent(in) :: dof, order
    real(wp) :: y(torus%n, system%n_dof), nothing(size(system%drives))
    integer :: silent(1, size(system%drives))

    silent = 0
    nothing = 0.0_wp
    call new_torus_balance(curve%motion, system, torus, silent, [unit], nothing, kept, &
                           even_in_time=.true.)
    curve%motion%lowest = 0.0_wp
    curve%unit = unit
    curve%n = curve%motion%n + 1
    curve%alone = curve%n
    curve%lowest = 0.0_wp
    ! The frequency does not count in lengths.
    allocate (curve%weights(curve%n), source=1.0_wp)
    curve%weights(curve%n) = 0.0_wp
    if (dof == 0) return
    y = 0.0_wp
    y(2*order + 1, dof) = 1.0_wp
    curve%measured = findloc(curve%motion%reduced(reshape(y, [size(y)])) > 0.5_wp, .true., 1)
  end subroutine new_free_curve

  pure real(wp) function frequency(self, x)
    class(free_curve_type), intent(in) :: self
    real(wp), intent(in) :: x(:)
    frequency = self%unit*x(self%n)
  end function frequency

  !> Position at the start of the motion, at rest, shape (n_dof).
  pure function at_rest(self, x) result(q)
    class(free_curve_type), intent(in) :: self
    real(wp), intent(in) :: x(:)
    real(wp) :: q(self%motion%system%n_dof)
    q = sum(self%motion%expanded(x(:self%motion%n)), 1)
  end function at_rest

  pure real(wp) function energy(self, x)
    class(free_curve_type), intent(in) :: self
    real(wp), intent(in) :: x(:)
    real(wp) :: slope(self%motion%system%n_dof)
    call self%motion%system%potential(self%at_rest(x), energy, slope)
  end function energy

  !> Number of cosines of all orders and coordinates, unknown or 0.
  pure integer function n_cosines(self)
    class(free_curve_type), intent(in) :: self
    n_cosines = size(self%motion%torus%orders, 2)*self%motion%system%n_dof
  end function n_cosines

  subroutine equations(self, x, p, r, jacobian, slope, inside)
    class(free_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    real(wp), intent(inout) :: jacobian(:, :)
    real(wp), intent(out) :: slope(:)
    logical, intent(out) :: inside
    real(wp) :: value, force(self%motion%system%n_dof)
    integer :: n

    n = self%motion%n
    call self%motion%equations(x(:n), self%frequency(x), r(:n), jacobian, slope(:n), inside)
    inside = inside .and. p > self%lowest
    if (.not. inside) return
    jacobian(:n, n + 1) = self%unit*slope(:n)
    slope(:n) = 0.0_wp
    slope(n + 1) = -1.0_wp
    jacobian(n + 1, :n + 1) = 0.0_wp
    call self%size_of(x, value, force)
    r(n + 1) = value - p
    if (self%measured > 0) then
      jacobian(n + 1, self%measured) = 1.0_wp
    else
      ! All cosine functions are 1 at the start.
      jacobian(n + 1, :n) = self%motion%reduced(reshape(spread(force, 1, self%motion%torus%n), &
                                                        [self%motion%torus%n*size(force)]))
    end if
  end subroutine equations

  subroutine residual(self, x, p, r, inside)
    class(free_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    logical, intent(out) :: inside
    real(wp) :: value, force(self%motion%system%n_dof)
    integer :: n

    n = self%motion%n
    call self%motion%residual(x(:n), self%frequency(x), r(:n), inside)
    inside = inside .and. p > self%lowest
    if (.not. inside) return
    call self%size_of(x, value, force)
    r(n + 1) = value - p
  end subroutine residual

  subroutine raise_terms(self, x, p, terms)
    class(free_curve_type), intent(in) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(inout) :: terms(:)
    associate (n => self%motion%n)
      call self%motion%raise_to_inertia([self%frequency(x)], x(:n), terms(:n))
    end associate
    terms(self%n) = max(terms(self%n), abs(p))
  end subroutine raise_terms

  !> Amplitude, or energy and its derivative at the start of the motion.
  pure subroutine size_of(self, x, value, force)
    class(free_curve_type), intent(in) :: self
    real(wp), intent(in) :: x(:)
    real(wp), intent(out) :: value, force(:)
    if (self%measured > 0) then
      value = x(self%measured)
      force = 0.0_wp
    else
      call self%motion%system%potential(self%at_rest(x), value, force)
    end if
  end subroutine size_of

end module viscovib_free_curve
