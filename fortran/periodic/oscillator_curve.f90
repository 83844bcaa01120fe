! Optimize: -O2 -fvect-cost-model=dynamic
!> Periodic motions of an oscillator as a curve: the harmonics over the frequency or the load
!! factor.
module viscovib_oscillator_curve
  use viscovib_balance_ladder, only: balance_ladder_type, rung_type
  use viscovib_equation_terms, only: raise_by_inertia
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_motion_norm, only: share_of_motion, weighted_norm
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_modes, only: least_loss
  use viscovib_order_rules, only: better_rung, max_vain, rung_for_next
  use viscovib_sized_curve, only: sized_curve_type
  use viscovib_truncation, only: find_left_out
  implicit none
  private

  public :: oscillator_curve_type, new_oscillator_curve

  !> Types of the parameter.
  integer, parameter, public :: vary_frequency = 1, vary_load = 2

  !> Orders below this fraction of the motion, in units of the loss factor of the least damped mode,
  !! remain small even in resonance and need no separate check; the second value is the largest such
  !! fraction.
  real(wp), parameter :: harmless = 0.05_wp, most_harmless = 1.0e-3_wp

  type, extends(sized_curve_type) :: oscillator_curve_type
    type(balance_type) :: balance
    class(oscillator_type), pointer :: system => null()
    type(load_type), pointer :: load => null()
    integer :: vary = vary_frequency
    !> True if `set` changes the system.
    logical :: changes_system = .false.
    !> The sets of orders if they are adapted, the present rung and the next one.
    type(balance_ladder_type), allocatable :: ladder
    integer :: rung = 1
    integer, private :: next_rung = 1
    !> Tolerance of the truncation error; its previous value, and additions without progress.
    real(wp), private :: tolerance = 0.0_wp, previous = huge(1.0_wp)
    !> `share_of_motion` of the last motion.
    real(wp), private :: share = 1.0_wp
    integer, private :: vain = 0
    !> The balance of the present orders while the curve is enlarged.
    type(balance_type), allocatable, private :: usual
  contains
    procedure :: equations
    procedure :: residual
    procedure :: raise_terms
    procedure :: set
    procedure :: choose_from
    procedure :: stay_with
    procedure :: enlarge
    procedure :: restore
    procedure :: left_out
    procedure :: choose_size
    procedure :: resize
  end type oscillator_curve_type

contains

  !> For a varying load the frequency of the balance must be set afterwards.
  subroutine new_oscillator_curve(curve, system, load, set, vary)
    type(oscillator_curve_type), intent(out) :: curve
    class(oscillator_type), intent(in), target :: system
    type(load_type), intent(in), target :: load
    type(harmonic_set_type), intent(in) :: set
    integer, intent(in) :: vary

    call new_balance(curve%balance, system, set)
    curve%system => system
    curve%load => load
    curve%vary = vary
    curve%largest = system%largest_amplitude()
    if (vary == vary_frequency) curve%lowest = 0.0_wp
    curve%blocks = system%n_dof()
    call measure(curve)
    curve%n_most = curve%n
    curve%negligible = max(curve%negligible, min(most_harmless, harmless*least_loss(system)))
  end subroutine new_oscillator_curve

  subroutine measure(curve)
    class(oscillator_curve_type), intent(inout) :: curve
    integer :: d, rows
    curve%n = curve%balance%n
    rows = curve%n/curve%blocks
    curve%weights = [(spread(curve%system%mass(d, d), 1, rows), d=1, curve%blocks)]
    curve%last_of_group = [(d, d=2, curve%n, 2)]
  end subroutine measure

  !> Adapt the orders at each point, beginning on a rung.
  subroutine choose_from(self, ladder, rung, tolerance)
    class(oscillator_curve_type), intent(inout) :: self
    type(balance_ladder_type), intent(in) :: ladder
    integer, intent(in) :: rung
    !> Tolerance of the truncation error relative to the motion.
    real(wp), intent(in) :: tolerance
    self%ladder = ladder
    self%adaptive = .true.
    self%n_most = 2*ladder%n_orders(ladder%n_rungs)*self%blocks
    self%tolerance = tolerance
    self%previous = huge(1.0_wp)
    self%vain = 0
    self%rung = 0
    self%next_rung = rung
    call self%resize()
  end subroutine choose_from

  !> Continue with n unknowns, without adaptation.
  subroutine stay_with(self, n)
    class(oscillator_curve_type), intent(inout) :: self
    integer, intent(in) :: n
    do while (2*self%ladder%n_orders(self%next_rung)*self%blocks > n)
      self%next_rung = self%next_rung - 1
    end do
    do while (2*self%ladder%n_orders(self%next_rung)*self%blocks < n)
      self%next_rung = self%next_rung + 1
    end do
    call self%resize()
    self%adaptive = .false.
  end subroutine stay_with

  !> Use at least twice the orders until `restore` is called.
  subroutine enlarge(self)
    class(oscillator_curve_type), intent(inout) :: self
    type(rung_type) :: far
    call self%ladder%far_rung(self%rung, self%system, self%load, self%balance%nu, far)
    far%balance%load_factor = self%balance%load_factor
    self%usual = self%balance
    self%balance = far%balance
    call measure(self)
  end subroutine enlarge

  subroutine restore(self)
    class(oscillator_curve_type), intent(inout) :: self
    self%balance = self%usual
    deallocate (self%usual)
    call measure(self)
  end subroutine restore

  !> Set the balance to a value of the parameter, unless that is out of range.
  subroutine set(self, p, inside)
    class(oscillator_curve_type), intent(inout) :: self
    real(wp), intent(in) :: p
    logical, intent(out) :: inside
    inside = p > self%lowest
    if (.not. inside) return
    if (self%vary == vary_frequency) then
      call self%balance%set_frequency(self%system, self%load, p)
    else
      self%balance%load_factor = p
    end if
  end subroutine set

  subroutine residual(self, x, p, r, inside)
    class(oscillator_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    logical, intent(out) :: inside
    call self%set(p, inside)
    if (inside) call self%balance%residual(self%system, x, r)
  end subroutine residual

  subroutine equations(self, x, p, r, jacobian, slope, inside)
    class(oscillator_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: r(:)
    real(wp), intent(inout) :: jacobian(:, :)
    real(wp), intent(out) :: slope(:)
    logical, intent(out) :: inside
    call self%residual(x, p, r, inside)
    if (.not. inside) return
    if (self%vary == vary_frequency) then
      call self%balance%frequency_derivative(self%system, self%load, x, slope)
    else
      call self%balance%load_derivative(slope)
    end if
    call self%balance%derivatives(self%system, jacobian)
  end subroutine equations

  !> Include inertia, which near resonance cancels against stiffness; since all orders share the
  !! rounding errors of samples, each equation has that of the largest order of its coordinate.
  subroutine raise_terms(self, x, p, terms)
    class(oscillator_curve_type), intent(in) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(inout) :: terms(:)
    real(wp) :: nu
    real(wp) :: rates(self%n/self%blocks)
    integer :: d, k, rows

    rows = self%n/self%blocks
    nu = merge(p, self%balance%nu, self%vary == vary_frequency)
    do k = 1, rows
      rates(k) = self%balance%set%orders((k + 1)/2)*nu
    end do
    call raise_by_inertia(self%system%mass, rates, x, terms)
    do d = 1, self%blocks
      terms((d - 1)*rows + 1:(d - 1)*rows + self%balance%set%held()) = 0.0_wp
    end do
  end subroutine raise_terms

  subroutine left_out(self, x, p, pushed, short, own, closely)
    class(oscillator_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), p
    real(wp), intent(out) :: pushed(:), short, own
    logical, intent(in) :: closely
    real(wp) :: nu, factor

    nu = merge(p, self%balance%nu, self%vary == vary_frequency)
    factor = merge(self%balance%load_factor, p, self%vary == vary_frequency)
    if (closely) then
      call self%ladder%far_probe(self%rung, self%system, self%load, nu)
      call look(self%ladder%far, self%system, factor, self%n/self%blocks, self%blocks, x, pushed, &
                own, short, closely)
    else
      call self%ladder%prepare_probe(self%rung, self%system, self%load, nu)
      call look(self%ladder%rungs(self%ladder%probe_of(self%rung)), self%system, factor, &
                self%n/self%blocks, self%blocks, x, pushed, own, short, closely)
    end if
    self%share = 1.0_wp
    if (self%load%moves_base()) then
      self%share = share_of_motion(self%system, self%load, factor, self%balance%set%orders, &
                                   reshape(x, [self%n/self%blocks, self%blocks]))
    end if
    own = own/self%share
    short = short/self%share
  end subroutine left_out

  !> The same by a probe, relative to the base.
  subroutine look(probe, system, factor, rows, blocks, x, pushed, own, short, closely)
    type(rung_type), intent(inout) :: probe
    class(oscillator_type), intent(in) :: system
    !> Load factor.
    real(wp), intent(in) :: factor
    integer, intent(in) :: rows, blocks
    real(wp), intent(in) :: x(rows, blocks)
    real(wp), intent(out) :: pushed(rows, blocks), own, short
    logical, intent(in) :: closely
    probe%balance%load_factor = factor
    call find_left_out(probe%balance, probe%compliance, system, x, probe%change, pushed, own, &
                       short, closely)
  end subroutine look

  !> Like `choose_orders` at one frequency.
  subroutine choose_size(self, x, truncation, own, rounding, again)
    class(oscillator_curve_type), intent(inout) :: self
    real(wp), intent(in) :: x(:), truncation, own, rounding
    logical, intent(out) :: again
    real(wp), allocatable :: motion(:, :)
    real(wp) :: allowed

    again = .false.
    if (self%ladder%n_rungs == 1) return
    motion = reshape(x, [self%n/self%blocks, self%blocks])
    allowed = self%ladder%allowed(self%tolerance, self%share*weighted_norm(self%system, motion))
    allowed = max(rounding/self%share, allowed)
    if (truncation > allowed .and. self%rung < self%ladder%n_rungs) then
      if (truncation > 0.5_wp*self%previous .and. own <= allowed) self%vain = self%vain + 1
      again = self%vain < max_vain
    end if
    if (again) then
      self%previous = truncation
      self%next_rung = better_rung(self%ladder, self%rung, truncation, allowed)
    else
      self%previous = huge(1.0_wp)
      self%vain = 0
      self%next_rung = rung_for_next(self%ladder, self%system, motion, truncation, own, allowed, &
                                     self%rung)
    end if
  end subroutine choose_size

  subroutine resize(self)
    class(oscillator_curve_type), intent(inout) :: self
    real(wp) :: nu, factor
    if (self%next_rung == self%rung) return
    self%rung = self%next_rung
    nu = self%balance%nu
    factor = self%balance%load_factor
    call self%ladder%prepare(self%rung, self%system, self%load, nu)
    self%balance = self%ladder%rungs(self%rung)%balance
    self%balance%load_factor = factor
    call measure(self)
  end subroutine resize

end module viscovib_oscillator_curve
