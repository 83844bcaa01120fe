!> Backbone curves: free periodic motions of a system without losses, grown from a
!! linear mode (nonlinear normal modes).
!!
!! M u'' + F(u) = 0 keeps its form when time runs backwards, so a free motion that
!! begins at rest, u'(0) = 0, is even in time: u = sum_k a_k cos(k nu t). That settles
!! the phase. The equations of harmonic balance in (a, nu) together with
!! a_1 = p for one coordinate have curves of solutions; one of them leaves rest at each
!! linear mode. Rosenberg, Adv. Appl. Mech. 9 (1966) 155; Kerschen et al., Mech. Syst.
!! Signal Process. 23 (2009) 170.
module viscovib_backbone
  use viscovib_curve, only: curve_type
  use viscovib_curve_branch, only: curve_branch_type, curve_options, follow_curve
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: follow_backbone

  !> Unknowns: the harmonics and, last, the frequency.
  type, extends(curve_type) :: backbone_curve
    type(balance_type) :: balance
    class(oscillator_type), pointer :: system => null()
    type(load_type) :: no_load
    !> Place of the amplitude that is the parameter.
    integer :: place = 0
  contains
    procedure :: equations
    procedure :: residual
  end type backbone_curve

contains

  !> From amplitude options%start to options%finish, in the first harmonic of a
  !! coordinate. Unknowns of the branch: harmonics, shape (2 n_orders n_dof), and the
  !! frequency.
  subroutine follow_backbone(system, set, omega, shape_at_rest, dof, options, branch, cancel)
    !> Without damping and memory.
    class(oscillator_type), intent(in), target :: system
    type(harmonic_set_type), intent(in) :: set
    !> Frequency and shape (n_dof) of the linear mode.
    real(wp), intent(in) :: omega, shape_at_rest(:)
    !> The coordinate whose amplitude counts.
    integer, intent(in) :: dof
    type(curve_options), intent(in) :: options
    type(curve_branch_type), intent(out) :: branch
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile :: cancel
    type(backbone_curve) :: curve
    type(status_type) :: status
    complex(wp) :: nothing(size(shape_at_rest), 0), still(0)
    real(wp) :: x(2*size(set%orders)*size(shape_at_rest) + 1)
    integer :: d, rows, cosine

    call new_load(curve%no_load, size(shape_at_rest), [integer ::], nothing, still, status)
    call new_balance(curve%balance, system, set)
    curve%balance%even_in_time = .true.
    curve%system => system
    curve%n = size(x)
    curve%largest = system%largest_amplitude()
    rows = 2*size(set%orders)
    ! The cosine of order 1.
    cosine = 2*findloc(set%orders, 1, 1)
    curve%place = (dof - 1)*rows + cosine
    ! The frequency has no part in lengths.
    allocate (curve%weights(curve%n), source=0.0_wp)
    x = 0.0_wp
    do d = 1, size(shape_at_rest)
      curve%weights((d - 1)*rows + 1:d*rows) = system%mass(d, d)
      x((d - 1)*rows + cosine) = options%start*shape_at_rest(d)/shape_at_rest(dof)
    end do
    x(curve%n) = omega
    call follow_curve(curve, options, x, branch, cancel=cancel)
  end subroutine follow_backbone

  subroutine residual(self, x, p, r, inside)
    class(backbone_curve), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    logical, intent(out) :: inside
    integer :: n
    n = self%balance%n
    inside = x(n + 1) > 0.0_wp
    if (.not. inside) return
    call self%balance%set_frequency(self%system, self%no_load, x(n + 1))
    call self%balance%residual(self%system, x(:n), r(:n))
    r(n + 1) = x(self%place) - p
  end subroutine residual

  subroutine equations(self, x, p, r, jacobian, slope, inside)
    class(backbone_curve), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    real(wp), intent(inout) :: jacobian(:, :)
    real(wp), intent(out) :: slope(:)
    logical, intent(out) :: inside
    integer :: n
    call self%residual(x, p, r, inside)
    if (.not. inside) return
    n = self%balance%n
    call self%balance%derivatives(self%system, jacobian)
    call self%balance%frequency_derivative(self%system, self%no_load, x(:n), slope(:n))
    jacobian(:n, n + 1) = slope(:n)
    jacobian(n + 1, :n + 1) = 0.0_wp
    jacobian(n + 1, self%place) = 1.0_wp
    slope = 0.0_wp
    slope(n + 1) = -1.0_wp
  end subroutine equations

end module viscovib_backbone
