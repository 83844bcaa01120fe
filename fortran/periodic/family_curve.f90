!> Periodic motions as a curve over a parameter p of the system, at fixed frequency and load. The
!! system is rebuilt at each value.
module viscovib_family_curve
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_curve, only: negligible_at_least
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_limits, only: nearly_nothing
  use viscovib_load, only: load_type
  use viscovib_motion_stability, only: stability_checker, new_stability_checker, stability_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: new_oscillator_curve, oscillator_curve_type, vary_load
  use viscovib_status, only: status_type
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: system_builder, new_plain_curve, new_family_curve, check_systems

  !> Step of a difference of fourth order, relative to the parameter; its nodes, in steps, and
  !! factors: central, forward and backward.
  real(wp), parameter :: part = 1.0e-3_wp
  real(wp), parameter :: places(5, 3) = reshape([ &
                                                -2.0_wp, -1.0_wp, 1.0_wp, 2.0_wp, 0.0_wp, &
                                                0.0_wp, 1.0_wp, 2.0_wp, 3.0_wp, 4.0_wp, &
                                                0.0_wp, -1.0_wp, -2.0_wp, -3.0_wp, -4.0_wp], [5, 3])
  real(wp), parameter :: factors(5, 3) = reshape([ &
                                                 1.0_wp, -8.0_wp, 8.0_wp, -1.0_wp, 0.0_wp, &
                                                 -25.0_wp, 48.0_wp, -36.0_wp, 16.0_wp, -3.0_wp, &
                                                 25.0_wp, -48.0_wp, 36.0_wp, -16.0_wp, 3.0_wp], &
                                                 [5, 3])/12.0_wp

  !> Builds the systems, all with the same terms.
  type, abstract :: system_builder
  contains
    procedure(build_interface), deferred :: build
  end type system_builder

  abstract interface
    !> Build the system at p /= 0; fails where it does not exist.
    subroutine build_interface(self, p, system, status)
      import :: oscillator_type, status_type, system_builder, wp
      class(system_builder), intent(in) :: self
      real(wp), intent(in) :: p
      class(oscillator_type), allocatable, intent(out) :: system
      type(status_type), intent(out) :: status
    end subroutine build_interface
  end interface

  type :: system_holder
    class(oscillator_type), allocatable :: system
  end type system_holder

  type, extends(oscillator_curve_type) :: family_curve_type
    class(system_builder), allocatable :: builder
    !> Frequency of the load (rad/s), and the scale of the parameter.
    real(wp) :: nu = 0.0_wp, p_scale = 1.0_wp
    type(system_holder), pointer, private :: own => null()
  contains
    procedure :: equations
    procedure :: set
    procedure :: left_out
    procedure, private :: make
    final :: discard
  end type family_curve_type

contains

  !> The curve over the frequency or the factor of the load.
  subroutine new_plain_curve(curve, system, load, set, vary, nu)
    class(oscillator_curve_type), allocatable, intent(out) :: curve
    class(oscillator_type), intent(in), target :: system
    type(load_type), intent(in), target :: load
    type(harmonic_set_type), intent(in) :: set
    integer, intent(in) :: vary
    real(wp), intent(in) :: nu
    allocate (curve)
    call new_oscillator_curve(curve, system, load, set, vary)
    call curve%balance%set_frequency(system, load, nu)
  end subroutine new_plain_curve

  !> The curve over p, starting at p.
  subroutine new_family_curve(curve, builder, p, p_scale, load, set, nu, status)
    class(oscillator_curve_type), allocatable, intent(out) :: curve
    !> Moves into the curve.
    class(system_builder), allocatable, intent(inout) :: builder
    real(wp), intent(in) :: p, p_scale, nu
    type(load_type), intent(in), target :: load
    type(harmonic_set_type), intent(in) :: set
    type(status_type), intent(out) :: status
    type(family_curve_type), allocatable :: family

    allocate (family)
    call move_alloc(builder, family%builder)
    family%nu = nu
    family%p_scale = p_scale
    allocate (family%own)
    call family%make(p, status)
    if (.not. status%failed()) then
      call new_oscillator_curve(family%oscillator_curve_type, family%own%system, load, set, &
                                vary_load)
      family%changes_system = .true.
      ! The damping may vary too.
      family%negligible = negligible_at_least
      call family%balance%set_frequency(family%system, load, nu)
    end if
    call move_alloc(family, curve)
  end subroutine new_family_curve

  subroutine make(self, p, status)
    class(family_curve_type), intent(inout) :: self
    real(wp), intent(in) :: p
    type(status_type), intent(out) :: status
    call self%builder%build(merge(p, nearly_nothing, abs(p) > 0.0_wp), self%own%system, status)
  end subroutine make

  !> Set p; outside the curve if no system exists there.
  subroutine set(self, p, inside)
    class(family_curve_type), intent(inout) :: self
    real(wp), intent(in) :: p
    logical, intent(out) :: inside
    type(status_type) :: status

    call self%make(p, status)
    inside = .not. status%failed()
    if (.not. inside) return
    self%system => self%own%system
    call self%balance%set_frequency(self%system, self%load, self%nu)
    if (self%adaptive) call self%ladder%forget()
  end subroutine set

  !> Stability of each motion, for the system at its p.
  subroutine check_systems(checker, curve, nu, p, x, stability, cancel)
    type(stability_checker), intent(inout) :: checker
    class(oscillator_curve_type), intent(inout) :: curve
    !> The frequency (rad/s); points of the curve, shapes (n) and (2 n_orders, n_dof, n).
    real(wp), intent(in) :: nu, p(:), x(:, :, :)
    type(stability_type), intent(out) :: stability
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(stability_type) :: one
    logical :: inside
    integer :: i, n

    n = size(p)
    allocate (stability%stable(n), stability%n_growing(n), source=-1)
    allocate (stability%slowest(n), source=.false.)
    allocate (stability%exponents(checker%n_slots, n), stability%multipliers(checker%n_slots, n), &
              source=cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp))
    do i = 1, n
      if (is_set(cancel)) return
      call curve%set(p(i), inside)
      if (.not. inside) cycle
      call new_stability_checker(checker, curve%system, curve%balance%set)
      call checker%check(curve%system, [nu], x(:, :, i:i), one, cancel, &
                       stability%exponents(:, max(i - 1, 1)))
      stability%stable(i) = one%stable(1)
      stability%n_growing(i) = one%n_growing(1)
      stability%slowest(i) = one%slowest(1)
      stability%exponents(:, i) = one%exponents(:, 1)
      stability%multipliers(:, i) = one%multipliers(:, 1)
    end do
  end subroutine check_systems

  subroutine equations(self, x, p, r, jacobian, slope, inside)
    class(family_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    real(wp), intent(inout) :: jacobian(:, :)
    real(wp), intent(out) :: slope(:)
    logical, intent(out) :: inside
    real(wp) :: nearby(size(r)), h
    integer :: k, side
    logical :: made

    h = part*max(abs(p), self%p_scale)
    ! One-sided differences at the ends of the range of p.
    do side = 1, size(places, 2)
      slope = 0.0_wp
      do k = 1, size(places, 1)
        call self%residual(x, p + places(k, side)*h, nearby, made)
        if (.not. made) exit
        slope = slope + factors(k, side)/h*nearby
      end do
      if (made) exit
    end do
    inside = made
    call self%residual(x, p, r, made)
    inside = inside .and. made
    if (inside) call self%balance%derivatives(self%system, jacobian)
  end subroutine equations

  subroutine left_out(self, x, p, pushed, short, own, closely)
    class(family_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: pushed(:), short, own
    logical, intent(in) :: closely
    logical :: inside
    call self%set(p, inside)
    call self%oscillator_curve_type%left_out(x, 1.0_wp, pushed, short, own, closely)
  end subroutine left_out

  subroutine discard(self)
    type(family_curve_type), intent(inout) :: self
    if (associated(self%own)) deallocate (self%own)
  end subroutine discard

end module viscovib_family_curve
