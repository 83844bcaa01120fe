! Optimize: -O3
!> The equations of harmonic balance at one frequency, with their derivatives.
!!
!! Unknowns are the harmonics X_k of u = Im sum_k X_k exp(i k nu t), real and imaginary parts
!! alternating, coordinate by coordinate. With the harmonics W_j of the hereditary variable w_j(u)
!! and the factor f_jk = 1 - Rhat_j of its memory,
!!
!!   R_k = sum_j B(:,j) f_jk W_jk + G_k + (i k nu C - (k nu)^2 M) X_k - s P_k,
!!
!! where G are the harmonics of F(u, v) - B v, in some systems of F(u, u', v, s P) - B v. If w_j
!! depends on rates too, these have the harmonics i k nu X_k. Forces are evaluated at samples of a
!! period. The derivatives are exact for the sampled equations: derivatives of w and F at the
!! samples, between the same two transforms.
module viscovib_harmonic_balance
  use viscovib_counters, only: count_unknowns, count_up, counted_loads, counting
  use viscovib_cycle_terms, only: cycle_term, cycles_of, find_blocks, find_parts, has_kinks, &
    law_of, most_samples
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_law_term, only: law_term
  use viscovib_moment_block, only: add_sandwich_of, rate_columns
  use viscovib_oscillator, only: oscillator_type
  use viscovib_sample_tables, only: new_sample_tables, retain, sample_tables
  implicit none
  private

  public :: balance_type, new_balance

  type :: balance_type
    type(harmonic_set_type) :: set
    !> Number of unknowns of all coordinates.
    integer :: n = 0
    integer, private :: n_dof = 0, n_memory = 0
    !> Coordinates on whose rates variables depend.
    integer, allocatable, private :: rates(:)
    !> True if `slopes` are those of the last motion.
    logical, private :: bent_known = .false.
    !> Laws that are not polynomials, and their contribution to the harmonics of each variable.
    type(cycle_term), allocatable :: cycles(:)
    !> True if laws have kinks or jumps.
    logical :: kinked = .false.
    real(wp), allocatable, private :: lawful(:, :)
    !> Frequency (rad/s), and the load factor s.
    real(wp) :: nu = 0.0_wp, load_factor = 1.0_wp
    type(sample_tables), private :: tables
    !> Dynamic stiffness (n_dof, n_dof, n_orders), and the memory factors 1 - Rhat (n_orders,
    !! n_memory).
    complex(wp), allocatable :: stiffness(:, :, :)
    complex(wp), allocatable, private :: fraction(:, :)
    !> Frequencies of the orders and their speeds, the frequency nu (rad/s), shape (n_orders).
    real(wp), allocatable, private :: mu(:), speeds(:)
    !> The load, and the derivative of its forces by the frequency, shape (n_orders, n_dof).
    complex(wp), allocatable, private :: load(:, :), load_slope(:, :)
    !> True if the load depends on the frequency.
    logical, private :: load_varies = .false.
    !> Harmonics of the remainders w(u) - W u, and of a force, shape (2 n_orders,
    !! n_memory) and (2 n_orders).
    real(wp), allocatable, private :: bent(:, :), kept(:), f_parts(:)
    !> Samples of u and rates, of w - W u or v, of a force, and slopes, at the last motion.
    real(wp), allocatable, private :: u(:, :), w(:, :), f(:, :), slopes(:, :, :), by_u(:, :, :), &
                                      by_v(:, :, :)
    !> For systems that are `moving`: samples of rates and of the load, derivatives by rates, and
    !! the harmonics of the contribution of the full load to F, shape (2 n_orders, n_dof).
    real(wp), allocatable, private :: rate(:, :), push(:, :), by_rate(:, :, :), by_load(:, :)
    !> Moments of a slope, and derivatives of harmonics.
    real(wp), allocatable, private :: c(:), s(:), block(:, :), memory(:, :, :)
  contains
    procedure :: set_frequency
    procedure :: residual
    procedure :: samples_taken
    procedure :: derivatives
    procedure :: load_derivative
    procedure :: frequency_derivative
  end type balance_type

contains

  subroutine new_balance(balance, system, set)
    type(balance_type), intent(out) :: balance
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    integer :: d, m, k, s, seen

    d = system%n_dof()
    seen = d + system%n_rates()
    allocate (balance%rates(0))
    if (seen > d) balance%rates = system%rates
    m = system%n_memory()
    k = size(set%orders)
    balance%set = set
    call cycles_of(system, set, balance%cycles)
    balance%kinked = has_kinks(system)
    call new_sample_tables(balance%tables, set)
    s = balance%tables%n_samples
    balance%n_dof = d
    balance%n_memory = m
    balance%n = 2*k*d
    allocate (balance%stiffness(d, d, k), balance%fraction(k, m), balance%load(k, d), &
              balance%mu(k), balance%speeds(k))
    allocate (balance%u(s, seen), balance%w(s, m), balance%f(s, d), balance%slopes(s, m, seen), &
              balance%by_u(s, d, d), balance%by_v(s, d, m), balance%bent(2*k, m), &
              balance%kept(2*k), balance%f_parts(2*k), balance%block(2*k, 2*k), &
              balance%memory(2*k, 2*k, m), balance%lawful(2*k, m), source=0.0_wp)
    if (system%moving) then
      allocate (balance%rate(s, d), balance%push(s, d), balance%by_rate(s, d, d), &
                balance%by_load(2*k, d), source=0.0_wp)
    end if
    k = balance%tables%reach
    allocate (balance%c(-k:k), balance%s(-k:k), source=0.0_wp)
  end subroutine new_balance

  !> Compute all quantities that depend on the frequency only.
  subroutine set_frequency(self, system, load, nu)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    integer :: j, k
    logical :: moves

    if (counting) call count_unknowns(self%set%orders, self%n_dof, 1)
    if (counting) call count_up(counted_loads, size(load%orders))
    self%nu = nu
    self%mu(:) = self%set%orders*nu
    call system%retained(self%mu, self%fraction)
    self%speeds(:) = nu
    call system%dynamic_stiffness(self%mu, self%speeds, self%fraction, self%stiffness)
    self%load = (0.0_wp, 0.0_wp)
    ! The load of a condensed system is in the system.
    self%load_varies = .not. system%condensed .and. load%varies()
    if (self%load_varies) self%load_slope = 0.0_wp*self%load
    moves = system%condensed
    if (.not. moves) moves = load%moves_base()
    do j = 1, size(load%orders)
      do k = 1, size(self%set%orders)
        if (load%orders(j) /= self%set%orders(k)) cycle
        self%load(k, :) = load%force(:, j)
        if (self%load_varies) call load%add_varying(j, nu, self%load(k, :), self%load_slope(k, :))
        if (.not. moves) cycle
        self%load(k, :) = system%load_coefficient(self%load(k, :), load%shift(system, j), &
                                                  load%orders(j), nu, self%stiffness(:, :, k), &
                                                  self%fraction(k, :))
      end do
    end do
  end subroutine set_frequency

  !> Largest number of samples per period of the forces of the last motion.
  pure integer function samples_taken(self)
    class(balance_type), intent(in) :: self
    samples_taken = self%set%n_samples
    if (self%set%half_wave) samples_taken = 2*samples_taken
    if (size(self%cycles) > 0) then
      samples_taken = max(samples_taken, most_samples(self%cycles, self%set%half_wave))
    end if
  end function samples_taken

  !> R at the harmonics x.
  subroutine residual(self, system, x, r)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(2*size(self%set%orders), self%n_dof)
    real(wp), intent(out) :: r(2*size(self%set%orders), self%n_dof)
    integer :: a, b, j, k
    logical :: together

    self%bent_known = .false.
    call self%tables%all_to_samples(self%n_dof, x, self%u)
    do b = 1, size(self%rates)
      self%kept(1::2) = -self%mu*x(2::2, self%rates(b))
      self%kept(2::2) = self%mu*x(1::2, self%rates(b))
      call self%tables%to_samples(self%kept, self%u(:, self%n_dof + b))
    end do
    do a = 1, self%n_dof
      do k = 1, size(self%set%orders)
        r(2*k - 1, a) = -self%load_factor*real(self%load(k, a))
        r(2*k, a) = -self%load_factor*aimag(self%load(k, a))
        do b = 1, self%n_dof
          associate (d => self%stiffness(a, b, k))
            r(2*k - 1, a) = r(2*k - 1, a) + (real(d)*x(2*k - 1, b) - aimag(d)*x(2*k, b))
            r(2*k, a) = r(2*k, a) + (real(d)*x(2*k, b) + aimag(d)*x(2*k - 1, b))
          end associate
        end do
      end do
    end do
    if (any(system%bent)) call system%sampled_remainder(self%u, self%w)
    if (size(self%cycles) > 0) call find_parts(self%cycles, system, self%set, self%tables, &
                                               self%mu, x, self%u, self%lawful)
    together = all(system%bent)
    if (together) call self%tables%all_to_parts(self%n_memory, self%w, self%bent)
    do j = 1, self%n_memory
      self%kept = 0.0_wp
      if (system%bent(j)) then
        if (.not. together) call self%tables%to_parts(self%w(:, j), self%bent(:, j))
        if (size(self%cycles) > 0) self%bent(:, j) = self%bent(:, j) + self%lawful(:, j)
        self%kept = self%bent(:, j)
        if (system%kernel_of(j) > 0) call retain(self%fraction(:, j), self%kept)
        do a = 1, self%n_dof
          if (abs(system%spread(a, j)) > 0.0_wp) then
            r(:, a) = r(:, a) + system%spread(a, j)*self%kept
          end if
        end do
      end if
      if (system%separable) cycle
      self%f_parts = 0.0_wp
      do b = 1, self%n_dof
        self%f_parts = self%f_parts + system%gather(j, b)*x(:, b)
      end do
      call retain(self%fraction(:, j), self%f_parts)
      self%kept = self%kept + self%f_parts
      call self%tables%to_samples(self%kept, self%w(:, j))
    end do
    if (.not. system%separable) then
      if (system%moving) then
        call find_moving(self, system, x)
      else
        call system%force_remainder(self%u, self%w, self%f)
      end if
      do a = 1, self%n_dof
        call self%tables%to_parts(self%f(:, a), self%f_parts)
        r(:, a) = r(:, a) + self%f_parts
      end do
    end if
    ! The mean has only an imaginary part: its real part is fixed at 0.
    r(:self%set%held(), :) = x(:self%set%held(), :)
  end subroutine residual

  !> F(u, u', v, s P) - B v at the samples, and the contribution of the load to it.
  subroutine find_moving(self, system, x)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(2*size(self%set%orders), self%n_dof)
    real(wp) :: parts(2*size(self%set%orders))
    integer :: b

    do b = 1, self%n_dof
      parts(1::2) = -self%mu*x(2::2, b)
      parts(2::2) = self%mu*x(1::2, b)
      call self%tables%to_samples(parts, self%rate(:, b))
      parts(1::2) = real(self%load(:, b))
      parts(2::2) = aimag(self%load(:, b))
      call self%tables%to_samples(parts, self%push(:, b))
    end do
    ! F is linear in the load.
    call system%moving_remainder(self%u, self%rate, self%w, self%push, self%f)
    do b = 1, self%n_dof
      call self%tables%to_parts(self%f(:, b), self%by_load(:, b))
    end do
    call system%moving_remainder(self%u, self%rate, self%w, 0.0_wp*self%push, self%f)
    do b = 1, self%n_dof
      call self%tables%to_parts(self%f(:, b), parts)
      self%by_load(:, b) = self%by_load(:, b) - parts
    end do
    self%push = self%load_factor*self%push
    call system%moving_remainder(self%u, self%rate, self%w, self%push, self%f)
  end subroutine find_moving

  !> Derivatives of F with respect to u' of coordinate b in the equations of coordinate a.
  subroutine add_rates(self, a, b, jacobian)
    class(balance_type), intent(inout) :: self
    integer, intent(in) :: a, b
    real(wp), intent(inout) :: jacobian(:, :)

    call find_block(self, self%by_rate(:, a, b))
    call add_block(rate_columns(self%mu, self%block), 1.0_wp, a, b, jacobian)
  end subroutine add_rates

  !> dR/dx at the motion of the last call of `residual`.
  subroutine derivatives(self, system, jacobian)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    !> At least (n, n); unknowns in the order of x.
    real(wp), intent(out) :: jacobian(:, :)
    integer :: a, b, j

    jacobian = 0.0_wp
    do b = 1, self%n_dof
      do a = 1, self%n_dof
        call add_stiffness(self, a, b, jacobian)
      end do
    end do
    if (any(system%bent)) call system%sampled_slopes(self%u, self%slopes)
    self%bent_known = .true.
    if (.not. system%separable) call find_slopes(self, system)
    do b = 1, self%n_dof
      if (.not. system%separable) self%memory = 0.0_wp
      do j = 1, self%n_memory
        if (.not. system%bent(j)) cycle
        if (.not. any(abs(self%slopes(:, j, b)) > 0.0_wp)) cycle
        if (system%kernel_of(j) == 0 .and. system%separable) then
          do a = 1, self%n_dof
            call add_sandwich(self, self%slopes(:, j, b), system%spread(a, j), a, b, jacobian)
          end do
        else
          call find_block(self, self%slopes(:, j, b))
          call add_variable(self, system, j, b, jacobian)
        end if
        if (.not. system%separable) self%memory(:, :, j) = self%block
      end do
      if (.not. system%separable) call add_inseparable(self, system, b, jacobian)
    end do
    ! A basic motion sin k nu t has the rate k nu cos k nu t.
    do b = 1, size(self%rates)
      do j = 1, self%n_memory
        if (.not. system%bent(j)) cycle
        if (.not. any(abs(self%slopes(:, j, self%n_dof + b)) > 0.0_wp)) cycle
        call find_block(self, self%slopes(:, j, self%n_dof + b))
        self%block = rate_columns(self%mu, self%block)
        call add_variable(self, system, j, self%rates(b), jacobian)
      end do
    end do
    do j = 1, size(self%cycles)
      call add_cycle(self, system, self%cycles(j), jacobian)
    end do
  end subroutine derivatives

  !> Derivatives of the harmonics of a variable, in `block`, in the equations of all coordinates;
  !! its memory is applied.
  subroutine add_variable(self, system, j, b, jacobian)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    !> Variable, and coordinate of the derivative.
    integer, intent(in) :: j, b
    real(wp), intent(inout) :: jacobian(:, :)
    integer :: a

    call retain_block(self, system, j)
    do a = 1, self%n_dof
      if (.not. abs(system%spread(a, j)) > 0.0_wp) cycle
      call add_block(self%block, system%spread(a, j), a, b, jacobian)
    end do
  end subroutine add_variable

  !> Apply the memory of a variable to its derivatives in `block`.
  subroutine retain_block(self, system, j)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: j
    integer :: k

    if (system%kernel_of(j) == 0) return
    do k = 1, size(self%block, 2)
      call retain(self%fraction(:, j), self%block(:, k))
    end do
  end subroutine retain_block

  !> Add the derivatives of a law that is not a polynomial.
  subroutine add_cycle(self, system, one, jacobian)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(cycle_term), intent(inout) :: one
    real(wp), intent(inout) :: jacobian(:, :)
    type(law_term), pointer :: law
    integer :: j, m

    call find_blocks(one, system, self%set, self%tables, self%nu)
    law => law_of(one, system)
    do j = 1, size(law%variables)
      associate (v => law%variables(j))
        do m = 1, size(one%blocks, 3)
          self%block = one%blocks(:, :, m)
          call retain_block(self, system, v)
          call add_of(system%spread(:, v), law%weights(j)*law%arguments(m, :))
          if (.not. any(abs(law%rates(m, :)) > 0.0_wp)) cycle
          self%block = rate_columns(self%mu, self%block)
          call add_of(system%spread(:, v), law%weights(j)*law%rates(m, :))
        end do
      end associate
    end do

  contains

    subroutine add_of(on, by)
      real(wp), intent(in) :: on(:), by(:)
      integer :: a, b
      do b = 1, size(by)
        do a = 1, size(on)
          if (abs(on(a)*by(b)) > 0.0_wp) call add_block(self%block, on(a)*by(b), a, b, jacobian)
        end do
      end do
    end subroutine add_of

  end subroutine add_cycle

  !> The linear part of coordinate b in the equations of coordinate a.
  pure subroutine add_stiffness(self, a, b, jacobian)
    class(balance_type), intent(in) :: self
    integer, intent(in) :: a, b
    real(wp), intent(inout) :: jacobian(:, :)
    integer :: i, j, k
    do k = 1, size(self%set%orders)
      i = 2*(k + size(self%set%orders)*(a - 1))
      j = 2*(k + size(self%set%orders)*(b - 1))
      jacobian(i, j) = real(self%stiffness(a, b, k))
      if (self%set%orders(k) == 0) then
        jacobian(i - 1, j - 1) = merge(1.0_wp, 0.0_wp, a == b)
      else
        jacobian(i - 1, j - 1) = real(self%stiffness(a, b, k))
        jacobian(i - 1, j) = -aimag(self%stiffness(a, b, k))
        jacobian(i, j - 1) = aimag(self%stiffness(a, b, k))
      end if
    end do
  end subroutine add_stiffness

  pure subroutine add_block(block, factor, a, b, jacobian)
    real(wp), intent(in) :: block(:, :), factor
    integer, intent(in) :: a, b
    real(wp), intent(inout) :: jacobian(:, :)
    integer :: i, j, m
    m = size(block, 1)
    do j = 1, m
      do i = 1, m
        jacobian(i + m*(a - 1), j + m*(b - 1)) = jacobian(i + m*(a - 1), j + m*(b - 1)) &
                                                 + factor*block(i, j)
      end do
    end do
  end subroutine add_block

  !> Add the derivatives of F(u, v) - B v, also through v; on entry, `memory` contains the nonlinear
  !! part of the derivatives of v.
  subroutine add_inseparable(self, system, b, jacobian)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: b
    real(wp), intent(inout) :: jacobian(:, :)
    integer :: a, j, k

    do j = 1, self%n_memory
      do k = 1, size(self%set%orders)
        associate (f => self%fraction(k, j)*system%gather(j, b), v => self%memory(:, :, j))
          v(2*k - 1, 2*k - 1) = v(2*k - 1, 2*k - 1) + real(f)
          v(2*k, 2*k) = v(2*k, 2*k) + real(f)
          v(2*k - 1, 2*k) = v(2*k - 1, 2*k) - aimag(f)
          v(2*k, 2*k - 1) = v(2*k, 2*k - 1) + aimag(f)
        end associate
      end do
    end do
    do a = 1, self%n_dof
      if (any(abs(self%by_u(:, a, b)) > 0.0_wp)) then
        call add_sandwich(self, self%by_u(:, a, b), 1.0_wp, a, b, jacobian)
      end if
      if (system%moving) then
        if (any(abs(self%by_rate(:, a, b)) > 0.0_wp)) call add_rates(self, a, b, jacobian)
      end if
      do j = 1, self%n_memory
        if (.not. any(abs(self%by_v(:, a, j)) > 0.0_wp)) cycle
        call find_block(self, self%by_v(:, a, j))
        call add_block(matmul(self%block, self%memory(:, :, j)), 1.0_wp, a, b, jacobian)
      end do
    end do
  end subroutine add_inseparable

  !> Add harmonics of slope(t) times each basic motion, times a factor, to the block of
  !! coordinates a, b.
  subroutine add_sandwich(self, slope, factor, a, b, jacobian)
    class(balance_type), intent(inout) :: self
    real(wp), intent(in) :: slope(:), factor
    integer, intent(in) :: a, b
    real(wp), intent(inout) :: jacobian(:, :)
    integer :: m

    if (.not. abs(factor) > 0.0_wp) return
    call self%tables%moments(slope, self%c, self%s)
    m = 2*size(self%set%orders)
    call add_sandwich_of(self%set, self%c, self%s, factor, &
                         jacobian(m*(a - 1) + 1:m*a, m*(b - 1) + 1:m*b))
  end subroutine add_sandwich

  !> Derivatives of harmonics of a variable with a given slope at the samples, in `block`.
  subroutine find_block(self, slope)
    class(balance_type), intent(inout) :: self
    real(wp), intent(in) :: slope(:)
    self%block = 0.0_wp
    call add_sandwich(self, slope, 1.0_wp, 1, 1, self%block)
  end subroutine find_block

  !> Derivatives of F at the samples.
  subroutine find_slopes(self, system)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    if (system%moving) then
      call system%moving_slopes(self%u, self%rate, self%w, self%push, self%by_u, self%by_rate, &
                                self%by_v)
    else
      call system%force_slopes(self%u, self%w, self%by_u, self%by_v)
    end if
  end subroutine find_slopes

  !> dR/ds with the load factor s.
  pure subroutine load_derivative(self, slope)
    class(balance_type), intent(in) :: self
    real(wp), intent(out) :: slope(2*size(self%set%orders), self%n_dof)
    slope(1::2, :) = -real(self%load)
    slope(2::2, :) = -aimag(self%load)
    if (allocated(self%by_load)) slope = slope + self%by_load
    slope(:self%set%held(), :) = 0.0_wp
  end subroutine load_derivative

  !> dR/dnu at the motion x of the last call of `residual`.
  subroutine frequency_derivative(self, system, load, x, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: x(2*size(self%set%orders), self%n_dof)
    real(wp), intent(out) :: slope(2*size(self%set%orders), self%n_dof)
    complex(wp) :: total(size(self%set%orders), size(x, 2)), y(size(self%set%orders), size(x, 2))
    complex(wp) :: base(size(load%moved, 1), size(load%orders))
    integer :: a, b, k

    total = (0.0_wp, 0.0_wp)
    do b = 1, self%n_dof
      y(:, b) = cmplx(x(1::2, b), x(2::2, b), wp)
    end do
    base = (0.0_wp, 0.0_wp)
    if (load%moves_base()) then
      do k = 1, size(load%orders)
        base(:, k) = load%shift(system, k)
      end do
    end if
    call system%add_frequency_slope(self%set%orders, self%nu, y, load%orders, load%force, base, &
                                    self%load_factor, total)
    if (self%load_varies) total = total - self%load_factor*self%load_slope
    do a = 1, self%n_dof
      slope(1::2, a) = real(total(:, a))
      slope(2::2, a) = aimag(total(:, a))
    end do
    if (any(system%kernel_of > 0)) call add_memory_slope(self, system, y, slope)
    if (size(self%rates) > 0) call add_rate_slope(self, system, slope)
    do k = 1, size(self%cycles)
      if (size(self%rates) > 0) call add_cycle_slope(self, system, self%cycles(k), slope)
    end do
    if (system%moving) call add_moving_slope(self, system, slope)
    if (system%moving .and. self%load_varies) call add_push_slope(self, system, slope)
    slope(:self%set%held(), :) = 0.0_wp
  end subroutine frequency_derivative

  !> Add the derivative of F by forces that depend on the frequency, in which F is linear.
  subroutine add_push_slope(self, system, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(inout) :: slope(2*size(self%set%orders), self%n_dof)
    real(wp), dimension(size(self%u, 1), self%n_dof) :: push, f, without
    integer :: b

    do b = 1, self%n_dof
      self%kept(1::2) = self%load_factor*real(self%load_slope(:, b))
      self%kept(2::2) = self%load_factor*aimag(self%load_slope(:, b))
      call self%tables%to_samples(self%kept, push(:, b))
    end do
    call system%moving_remainder(self%u, self%rate, self%w, push, f)
    call system%moving_remainder(self%u, self%rate, self%w, 0.0_wp*push, without)
    do b = 1, self%n_dof
      call self%tables%to_parts(f(:, b) - without(:, b), self%f_parts)
      slope(:, b) = slope(:, b) + self%f_parts
    end do
  end subroutine add_push_slope

  !> Add the derivative of a law that is not a polynomial.
  subroutine add_cycle_slope(self, system, one, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(cycle_term), intent(inout) :: one
    real(wp), intent(inout) :: slope(2*size(self%set%orders), self%n_dof)
    type(law_term), pointer :: law
    integer :: a, j

    call find_blocks(one, system, self%set, self%tables, self%nu)
    law => law_of(one, system)
    do j = 1, size(law%variables)
      associate (v => law%variables(j))
        self%kept = law%weights(j)*one%by_nu
        if (system%kernel_of(v) > 0) call retain(self%fraction(:, v), self%kept)
        do a = 1, self%n_dof
          slope(:, a) = slope(:, a) + system%spread(a, v)*self%kept
        end do
      end associate
    end do
  end subroutine add_cycle_slope

  !> Add the contribution of the rates in laws, which are proportional to nu.
  subroutine add_rate_slope(self, system, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(inout) :: slope(2*size(self%set%orders), self%n_dof)
    real(wp) :: samples(size(self%u, 1))
    integer :: a, b, j

    if (.not. self%bent_known) call system%sampled_slopes(self%u, self%slopes)
    self%bent_known = .true.
    do j = 1, self%n_memory
      if (.not. system%bent(j)) cycle
      samples = 0.0_wp
      do b = 1, size(self%rates)
        samples = samples + self%slopes(:, j, self%n_dof + b)*self%u(:, self%n_dof + b)
      end do
      call self%tables%to_parts(samples/self%nu, self%kept)
      if (system%kernel_of(j) > 0) call retain(self%fraction(:, j), self%kept)
      do a = 1, self%n_dof
        slope(:, a) = slope(:, a) + system%spread(a, j)*self%kept
      end do
    end do
  end subroutine add_rate_slope

  !> Add the contribution of the rates in F.
  subroutine add_moving_slope(self, system, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(inout) :: slope(2*size(self%set%orders), self%n_dof)
    real(wp) :: samples(size(self%u, 1))
    integer :: a, b

    call find_slopes(self, system)
    do a = 1, self%n_dof
      samples = 0.0_wp
      do b = 1, self%n_dof
        samples = samples + self%by_rate(:, a, b)*self%rate(:, b)/self%nu
      end do
      call self%tables%to_parts(samples, self%f_parts)
      slope(:, a) = slope(:, a) + self%f_parts
    end do
  end subroutine add_moving_slope

  !> Add the contribution of memory: dv_k/dnu = k f'(k nu) W_k, in B v and in F(u, v) - B v at the
  !! samples.
  subroutine add_memory_slope(self, system, y, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: y(size(self%set%orders), self%n_dof)
    real(wp), intent(inout) :: slope(2*size(self%set%orders), self%n_dof)
    complex(wp) :: by_nu(size(self%set%orders), self%n_memory), v(size(self%set%orders))
    real(wp) :: samples(size(self%u, 1))
    integer :: a, j

    call system%retained_slope(self%set%orders*self%nu, self%fraction, by_nu)
    if (.not. system%separable) call find_slopes(self, system)
    do j = 1, self%n_memory
      if (system%kernel_of(j) == 0) cycle
      v = self%set%orders*by_nu(:, j)*(cmplx(self%bent(1::2, j), self%bent(2::2, j), wp) &
                                       + matmul(y, system%gather(j, :)))
      self%kept(1::2) = real(v)
      self%kept(2::2) = aimag(v)
      do a = 1, self%n_dof
        slope(:, a) = slope(:, a) + system%spread(a, j)*self%kept
      end do
      if (system%separable) cycle
      call self%tables%to_samples(self%kept, samples)
      do a = 1, self%n_dof
        if (.not. any(abs(self%by_v(:, a, j)) > 0.0_wp)) cycle
        call self%tables%to_parts(self%by_v(:, a, j)*samples, self%f_parts)
        slope(:, a) = slope(:, a) + self%f_parts
      end do
    end do
  end subroutine add_memory_slope

end module viscovib_harmonic_balance
