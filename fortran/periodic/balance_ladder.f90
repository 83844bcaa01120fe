! Optimize: -O3
!> Harmonic balances of one system with increasing numbers of harmonics. Each is created at its
!! first use and kept. `torus_ladder` explains why it has separate levels.
module viscovib_balance_ladder
  use viscovib_dense, only: invert
  use viscovib_harmonic_balance, only: balance_type, new_balance
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: balance_ladder_type, rung_type, lowest_order, new_ladder, one_rung, checking_order

  !> Largest relative truncation error of a motion that the absolute tolerance allows.
  real(wp), parameter :: most_allowed = 0.5_wp

  type :: rung_type
    logical :: ready = .false.
    !> Frequencies for which balance and compliance are valid, 0: none.
    real(wp) :: balance_nu = 0.0_wp, compliance_nu = 0.0_wp
    type(balance_type) :: balance
    !> Inverse dynamic stiffness of the harmonics that the checked rung `checked` omits, shape
    !! (n_dof, n_dof, n omitted).
    integer :: checked = 0
    complex(wp), allocatable :: compliance(:, :, :)
    !> Workspace: the change of all orders, shape (2 n_orders, n_dof).
    real(wp), allocatable :: change(:, :)
  end type rung_type

  type :: balance_ladder_type
    !> Number of rungs for solutions; higher rungs only estimate the truncation error.
    integer :: n_rungs = 0
    !> Absolute error allowed in motions, in the norm of `weighted_norm`.
    real(wp) :: least = 0.0_wp
    logical, private :: half_wave = .false.
    integer, private :: degree = 0, lowest = 1, step = 1
    type(load_type), private :: load
    type(rung_type), allocatable :: rungs(:)
    !> The rung of `far_probe`.
    type(rung_type) :: far
  contains
    procedure :: allowed
    procedure :: highest
    procedure :: n_orders
    procedure :: rung_of
    procedure :: probe_of
    procedure :: prepare
    procedure :: prepare_probe
    procedure :: far_probe
    procedure :: far_rung
    procedure :: forget
  end type balance_ladder_type

contains

  !> Highest order of the lowest rung, which must contain all orders of the load.
  pure integer function lowest_order(load)
    type(load_type), intent(in) :: load
    lowest_order = 1
    if (size(load%orders) > 0) lowest_order = max(1, maxval(load%orders))
  end function lowest_order

  !> Number of orders between rungs: an even and an odd one (half-wave: the odd one). While a
  !! symmetry holds, a load whose orders are multiples of g excites only multiples of g: then g
  !! times as many.
  pure integer function order_step(load)
    type(load_type), intent(in) :: load
    integer :: j
    order_step = 0
    do j = 1, size(load%orders)
      order_step = common_divisor(order_step, load%orders(j))
    end do
    order_step = 2*max(order_step, 1)
  end function order_step

  !> The highest order of the larger balance that estimates the truncation error. Harmonics decay in
  !! bands: the response to a load of order l alone, with order k, has the next harmonic k + 2 l for
  !! a cubic force; and a force of degree d directly excites d times the load's highest order. The
  !! number of harmonics is at most about doubled.
  pure integer function checking_order(load, degree, highest) result(order)
    type(load_type), intent(in) :: load
    integer, intent(in) :: degree, highest
    order = max(highest + 2*lowest_order(load), min(degree*lowest_order(load), 2*highest + 1))
  end function checking_order

  pure recursive integer function common_divisor(a, b) result(c)
    integer, intent(in) :: a, b
    c = a
    if (b /= 0) c = common_divisor(b, modulo(a, b))
  end function common_divisor

  !> Create a ladder of all sets of harmonics up to a highest order.
  subroutine new_ladder(ladder, system, load, half_wave, most)
    type(balance_ladder_type), intent(out) :: ladder
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> True: odd orders only.
    logical, intent(in) :: half_wave
    !> Highest order for solutions, at least `lowest_order`.
    integer, intent(in) :: most

    ladder%half_wave = half_wave
    ladder%degree = system%degree
    ladder%lowest = lowest_order(load)
    ladder%step = order_step(load)
    ladder%load = load
    ladder%n_rungs = 1 + max(0, most - ladder%lowest)/ladder%step
    allocate (ladder%rungs(ladder%probe_of(ladder%n_rungs)))
  end subroutine new_ladder

  !> Create a ladder with one given set; higher rungs only estimate its truncation error.
  subroutine one_rung(ladder, system, load, set)
    type(balance_ladder_type), intent(out) :: ladder
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    type(harmonic_set_type), intent(in) :: set
    ladder%n_rungs = 1
    ladder%half_wave = set%half_wave
    ladder%degree = system%degree
    ladder%lowest = set%orders(size(set%orders))
    ladder%step = order_step(load)
    ladder%load = load
    allocate (ladder%rungs(ladder%probe_of(1)))
    call new_balance(ladder%rungs(1)%balance, system, set)
    ladder%rungs(1)%ready = .true.
  end subroutine one_rung

  !> The relative error allowed for a motion of a given norm (`weighted_norm`), at most
  !! `most_allowed` if there is an absolute tolerance.
  pure real(wp) function allowed(self, tolerance, norm)
    class(balance_ladder_type), intent(in) :: self
    real(wp), intent(in) :: tolerance, norm
    allowed = tolerance
    if (.not. self%least > 0.0_wp) return
    allowed = min(most_allowed, tolerance + self%least/max(norm, tiny(norm)**0.5_wp))
  end function allowed

  !> Highest order of a rung.
  pure integer function highest(self, rung)
    class(balance_ladder_type), intent(in) :: self
    integer, intent(in) :: rung
    highest = self%lowest + self%step*(rung - 1)
  end function highest

  !> Number of harmonics of a rung.
  pure integer function n_orders(self, rung)
    class(balance_ladder_type), intent(in) :: self
    integer, intent(in) :: rung
    n_orders = self%highest(rung) + 1
    if (self%half_wave) n_orders = n_orders/2
  end function n_orders

  !> The lowest rung that includes an order, at most the highest one.
  pure integer function rung_of(self, order)
    class(balance_ladder_type), intent(in) :: self
    integer, intent(in) :: order
    rung_of = 1 + max(0, order - self%lowest + self%step - 1)/self%step
    rung_of = min(rung_of, self%n_rungs)
  end function rung_of

  !> The rung that estimates the truncation error of another.
  pure integer function probe_of(self, rung) result(probe)
    class(balance_ladder_type), intent(in) :: self
    integer, intent(in) :: rung
    integer :: beyond
    beyond = checking_order(self%load, self%degree, self%highest(rung)) - self%highest(rung)
    probe = rung + (beyond + self%step - 1)/self%step
  end function probe_of

  !> Prepare a rung for a frequency.
  subroutine prepare(self, rung, system, load, nu)
    class(balance_ladder_type), intent(inout) :: self
    integer, intent(in) :: rung
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    call make_ready(self, self%rungs(rung), rung, system, load, nu)
  end subroutine prepare

  subroutine make_ready(self, here, rung, system, load, nu)
    class(balance_ladder_type), intent(in) :: self
    type(rung_type), intent(inout) :: here
    integer, intent(in) :: rung
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    type(harmonic_set_type) :: set

    if (.not. here%ready) then
      call new_harmonic_set(set, self%highest(rung), self%half_wave, self%degree)
      call new_balance(here%balance, system, set)
      here%ready = .true.
    end if
    if (.not. abs(here%balance_nu - nu) > 0.0_wp) return
    call here%balance%set_frequency(system, load, nu)
    here%balance_nu = nu
  end subroutine make_ready

  !> Prepare the rung that estimates the truncation error of this one.
  subroutine prepare_probe(self, rung, system, load, nu)
    class(balance_ladder_type), intent(inout) :: self
    integer, intent(in) :: rung
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    call self%prepare(self%probe_of(rung), system, load, nu)
    call make_checker(self, self%rungs(self%probe_of(rung)), rung, system, nu)
  end subroutine prepare_probe

  !> Prepare `far`, a rung with at least twice the orders that estimates the truncation error of
  !! this one. It is used where signs matter, as for a fold's displacement: the next harmonics alone
  !! may cancel.
  subroutine far_probe(self, rung, system, load, nu)
    class(balance_ladder_type), intent(inout) :: self
    integer, intent(in) :: rung
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    if (self%far%checked /= rung) self%far = rung_type()
    call make_ready(self, self%far, far_of(self, rung), system, load, nu)
    call make_checker(self, self%far, rung, system, nu)
  end subroutine far_probe

  !> The same rung, to solve with.
  subroutine far_rung(self, rung, system, load, nu, far)
    class(balance_ladder_type), intent(in) :: self
    integer, intent(in) :: rung
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    type(rung_type), intent(out) :: far
    call make_ready(self, far, far_of(self, rung), system, load, nu)
  end subroutine far_rung

  pure integer function far_of(self, rung)
    class(balance_ladder_type), intent(in) :: self
    integer, intent(in) :: rung
    far_of = max(self%probe_of(rung), rung + self%highest(rung)/self%step + 1)
  end function far_of

  subroutine make_checker(self, here, rung, system, nu)
    class(balance_ladder_type), intent(in) :: self
    !> Prepared for the frequency.
    type(rung_type), intent(inout) :: here
    integer, intent(in) :: rung
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu
    integer :: k, d, n, first
    logical :: singular

    if (.not. abs(here%compliance_nu - nu) > 0.0_wp .and. here%checked == rung) return
    d = system%n_dof()
    first = self%n_orders(rung)
    n = size(here%balance%set%orders) - first
    if (here%checked /= rung) then
      if (allocated(here%compliance)) deallocate (here%compliance, here%change)
      allocate (here%compliance(d, d, n), here%change(2*(first + n), d))
      here%checked = rung
    end if
    do k = 1, n
      call invert(here%balance%stiffness(:, :, first + k), here%compliance(:, :, k), singular)
      ! Undamped and in resonance: the omitted harmonic may have any amplitude.
      if (singular) here%compliance(:, :, k) = huge(1.0_wp)**0.25_wp
    end do
    here%compliance_nu = nu
  end subroutine make_checker

  !> Invalidate all rungs after a change of the system.
  pure subroutine forget(self)
    class(balance_ladder_type), intent(inout) :: self
    self%rungs%balance_nu = 0.0_wp
    self%rungs%compliance_nu = 0.0_wp
    self%far%balance_nu = 0.0_wp
    self%far%compliance_nu = 0.0_wp
  end subroutine forget

end module viscovib_balance_ladder
