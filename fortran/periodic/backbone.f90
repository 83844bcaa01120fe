!> Backbone curves: free periodic motions of a system without losses that emanate from a linear mode
!! (nonlinear normal modes).
!!
!! M u'' + F(u) = 0 is invariant under time reversal, so a free motion that begins at rest, u'(0) =
!! 0, is even in time: u = sum_k a_k cos(k nu t). This condition fixes the phase. The equations of
!! harmonic balance in (a, nu) together with a_1 = p for one coordinate have curves of solutions;
!! one of them emanates from zero amplitude at each linear mode. Rosenberg, Adv. Appl. Mech. 9
!! (1966) 155; Kerschen et al., Mech. Syst. Signal Process. 23 (2009) 170.
module viscovib_backbone
  use viscovib_backbone_plan, only: backbone_plan_type
  use viscovib_curve, only: curve_type
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, follow_curve
  use viscovib_cycle_terms, only: has_kinks
  use viscovib_equation_terms, only: raise_by_inertia
  use viscovib_free_orders, only: order_search
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_oscillator, only: oscillator_type
  use viscovib_sized_curve, only: refitted
  use viscovib_status, only: status_type
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: follow_backbone

  !> If the first point is not found from the linear mode, the curve is followed from 0.1, 0.01, ...
  !! of its amplitude: number of such attempts, and largest number of points.
  integer, parameter :: max_lower = 4, most_below = 1000

  !> Unknowns: the cosine coefficients, coordinate by coordinate, and the frequency as the last one.
  type, extends(curve_type) :: backbone_curve
    !> Balance with cosines and sines; the sines are 0 and satisfy their equations.
    type(balance_type) :: balance
    class(oscillator_type), pointer :: system => null()
    type(load_type) :: no_load
    !> Index of the amplitude that is the parameter.
    integer :: place = 0
    !> Derivatives and equations of the balance, shapes (balance%n, balance%n) and (balance%n).
    real(wp), allocatable, private :: whole(:, :), part(:)
  contains
    procedure :: equations
    procedure :: residual
    procedure :: raise_terms
  end type backbone_curve

contains

  !> Follow the curve from amplitude options%start to options%finish in the first harmonic of a
  !! coordinate, with the harmonics of the plan or, if `plan%chosen`, with enough harmonics for a
  !! truncation error below the tolerance.
  subroutine follow_backbone(plan, options, branch, orders, cancel)
    type(backbone_plan_type), intent(in), target :: plan
    type(curve_options), intent(in) :: options
    !> Unknowns: cosine coefficients, shape (n_orders n_dof), and the frequency; with the truncation
    !! error of each point.
    type(curve_branch_type), intent(out) :: branch
    !> Harmonic orders used.
    integer, allocatable, intent(out) :: orders(:)
    !> May be set by another thread to cancel the computation.
    integer, intent(inout) :: cancel
    type(order_search) :: search
    type(harmonic_set_type) :: set
    logical :: again

    set = plan%set
    search%highest = set%orders(size(set%orders))
    search%most = merge(plan%most, search%highest, plan%chosen)
    search%tolerance = options%tolerance
    search%kinked = has_kinks(plan%system)
    do
      call follow_with(plan, set, options, branch, cancel)
      call branch%end_with_numbers()
      orders = set%orders
      call check(plan, set, search, branch, again, cancel)
      if (.not. again) exit
      call new_harmonic_set(set, search%highest, plan%set%half_wave, plan%system%degree)
    end do
    call branch%end_resolved()
  end subroutine follow_backbone

  !> Follow the branch with given harmonics.
  subroutine follow_with(plan, set, options, branch, cancel)
    type(backbone_plan_type), intent(in), target :: plan
    type(harmonic_set_type), intent(in) :: set
    type(curve_options), intent(in) :: options
    type(curve_branch_type), intent(out) :: branch
    integer, intent(inout) :: cancel
    type(backbone_curve) :: curve
    type(curve_branch_type) :: below
    type(curve_options) :: lower
    integer :: k

    call new_backbone_curve(curve, plan, set)
    call follow_curve(curve, options, linear(options%start), branch, cancel=cancel)
    ! Far from the linear mode: follow the curve from a smaller amplitude up to the start.
    lower = options
    lower%finish = options%start
    lower%max_points = max(options%max_points, most_below)
    if (allocated(lower%stops)) deallocate (lower%stops)
    do k = 1, max_lower
      if (branch%n_points > 0 .or. is_set(cancel)) return
      lower%start = options%start*0.1_wp**k
      call follow_curve(curve, lower, linear(lower%start), below, cancel=cancel)
      if (below%n_points == 0 .or. below%outcome /= curve_completed) cycle
      call follow_curve(curve, options, below%x(:, below%n_points), branch, cancel=cancel)
    end do

  contains

    !> Unknowns of the linear mode with a given amplitude.
    function linear(amplitude) result(x)
      real(wp), intent(in) :: amplitude
      real(wp) :: x(curve%n)
      integer :: d
      x = 0.0_wp
      do d = 1, size(plan%shape)
        x((d - 1)*size(set%orders) + cosine_of_first(set)) = amplitude*(plan%shape(d) &
                                                                       /plan%shape(plan%dof))
      end do
      x(curve%n) = plan%omega
    end function linear

  end subroutine follow_with

  subroutine new_backbone_curve(curve, plan, set)
    type(backbone_curve), intent(out) :: curve
    type(backbone_plan_type), intent(in), target :: plan
    type(harmonic_set_type), intent(in) :: set
    type(status_type) :: status
    complex(wp) :: nothing(size(plan%shape), 0), still(0)
    integer :: d, rows

    call new_load(curve%no_load, size(plan%shape), [integer ::], nothing, still, status)
    call new_balance(curve%balance, plan%system, set)
    curve%system => plan%system
    curve%n = curve%balance%n/2 + 1
    curve%alone = curve%n
    curve%largest = plan%system%largest_amplitude()
    rows = size(set%orders)
    curve%place = (plan%dof - 1)*rows + cosine_of_first(set)
    ! The frequency does not count in lengths.
    allocate (curve%weights(curve%n), source=0.0_wp)
    allocate (curve%whole(curve%balance%n, curve%balance%n), curve%part(curve%balance%n))
    do d = 1, size(plan%shape)
      curve%weights((d - 1)*rows + 1:d*rows) = plan%system%mass(d, d)
    end do
  end subroutine new_backbone_curve

  !> Index of the cosine of order 1 among the unknowns of a coordinate.
  pure integer function cosine_of_first(set)
    type(harmonic_set_type), intent(in) :: set
    cosine_of_first = findloc(set%orders, 1, 1)
  end function cosine_of_first

  !> Truncation error of each point, and whether to follow the branch again with more harmonics.
  subroutine check(plan, set, search, branch, again, cancel)
    type(backbone_plan_type), intent(in), target :: plan
    type(harmonic_set_type), intent(in) :: set
    type(order_search), intent(inout) :: search
    type(curve_branch_type), intent(inout) :: branch
    logical, intent(out) :: again
    integer, intent(inout) :: cancel
    type(harmonic_set_type) :: larger
    type(backbone_curve) :: curve
    real(wp) :: inertia(size(plan%shape))
    integer :: i, m

    m = size(branch%x, 1) - 1
    inertia = [(plan%system%mass(i, i), i=1, size(inertia))]
    do i = 1, branch%n_points
      call search%look_at(set%orders, reshape(branch%x(:m, i), [size(set%orders), &
                                                                size(plan%shape)]), inertia)
    end do
    call new_harmonic_set(larger, search%checking_order(), set%half_wave, plan%system%degree)
    call new_backbone_curve(curve, plan, larger)
    call search%check(curve, enlarged(branch%x(:, :branch%n_points)), &
                      enlarged(branch%folds%x(:, :branch%folds%n)), branch, again, cancel)

  contains

    !> Extend the unknowns to the larger set.
    pure function enlarged(x) result(y)
      real(wp), intent(in) :: x(:, :)
      real(wp), allocatable :: y(:, :)
      integer :: k
      allocate (y(curve%n, size(x, 2)))
      do k = 1, size(x, 2)
        y(:, k) = [refitted(size(plan%shape), x(:m, k), curve%n - 1), x(m + 1, k)]
      end do
    end function enlarged

  end subroutine check

  subroutine residual(self, x, p, r, inside)
    class(backbone_curve), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    logical, intent(out) :: inside
    inside = x(self%n) > 0.0_wp
    if (.not. inside) return
    call self%balance%set_frequency(self%system, self%no_load, x(self%n))
    call self%balance%residual(self%system, with_sines(x(:self%n - 1)), self%part)
    r(:self%n - 1) = self%part(2::2)
    r(self%n) = x(self%place) - p
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
    n = self%n
    call self%balance%derivatives(self%system, self%whole)
    jacobian(:n - 1, :n - 1) = self%whole(2::2, 2::2)
    call self%balance%frequency_derivative(self%system, self%no_load, with_sines(x(:n - 1)), &
                                           self%part)
    jacobian(:n - 1, n) = self%part(2::2)
    jacobian(n, :n) = 0.0_wp
    jacobian(n, self%place) = 1.0_wp
    slope = 0.0_wp
    slope(n) = -1.0_wp
  end subroutine equations

  subroutine raise_terms(self, x, p, terms)
    class(backbone_curve), intent(in) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(inout) :: terms(:)
    call raise_by_inertia(self%system%mass, self%balance%set%orders*x(self%n), &
                          x(:self%n - 1), terms(:self%n - 1))
    terms(self%n) = max(terms(self%n), abs(p))
  end subroutine raise_terms

  !> Unknowns of the balance, with zero sines.
  pure function with_sines(cosines) result(x)
    real(wp), intent(in) :: cosines(:)
    real(wp) :: x(2*size(cosines))
    x(1::2) = 0.0_wp
    x(2::2) = cosines
  end function with_sines

end module viscovib_backbone
