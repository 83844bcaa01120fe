!> The equations of harmonic balance at one frequency, with their derivatives.
!!
!! Unknowns are the harmonics X_k of u = Im sum_k X_k exp(i k nu t), real and
!! imaginary part by turns, coordinate by coordinate. With W_j the harmonics of
!! the hereditary variable w_j(u) and f_jk what memory retains of them,
!!
!!   R_k = sum_j B(:,j) f_jk W_jk + G_k + (i k nu C - (k nu)^2 M) X_k - s P_k,
!!
!! G being the harmonics of F(u, v) - B v. Samples of a period lead there and back;
!! the derivatives are exact ones of the sampled equations: those of w and F at
!! the samples between the same two tables.
module viscovib_harmonic_balance
  use viscovib_constants, only: pi
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: balance_type, new_balance

  !> Relative step of a central difference in the frequency.
  real(wp), parameter :: part = 1.0e-5_wp

  type :: balance_type
    type(harmonic_set_type) :: set
    !> Unknowns of all coordinates.
    integer :: n = 0
    integer, private :: n_dof = 0, n_memory = 0
    !> Frequency (rad/s), and the factor s of the load.
    real(wp) :: nu = 0.0_wp, load_factor = 1.0_wp
    !> Only motions with u(-t) = u(t): the sines are held at 0.
    logical :: even_in_time = .false.
    !> Dynamic stiffness (n_dof, n_dof, n_orders), and what memory retains
    !! (n_orders, n_memory).
    complex(wp), allocatable, private :: stiffness(:, :, :), fraction(:, :)
    !> The load, and its forces alone, shape (n_orders, n_dof); harmonics of the
    !! remainders w(u) - W u.
    complex(wp), allocatable, private :: load(:, :), force(:, :), bent(:, :)
    !> Samples of u, of w - W u or v, and slopes, at the last motion seen.
    real(wp), allocatable :: u(:, :), w(:, :), slopes(:, :, :), by_u(:, :, :), by_v(:, :, :)
    real(wp), allocatable, private :: f(:, :), block(:, :), memory(:, :, :)
    !> cos and sin of m times the phase at the samples, over their number, m = 0, 1
    !! or 2, ... twice the highest order.
    real(wp), allocatable, private :: cosines(:, :), sines(:, :)
    integer, private :: highest = 0, stride = 1
  contains
    procedure :: set_frequency
    procedure :: residual
    procedure :: derivatives
    procedure :: load_derivative
    procedure :: frequency_derivative
  end type balance_type

contains

  subroutine new_balance(balance, system, set)
    type(balance_type), intent(out) :: balance
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    real(wp) :: angle
    integer :: d, m, k, s, period

    d = system%n_dof()
    m = system%n_memory()
    k = size(set%orders)
    s = set%n_samples
    balance%set = set
    balance%n_dof = d
    balance%n_memory = m
    balance%n = 2*k*d
    allocate (balance%stiffness(d, d, k), balance%fraction(k, m), balance%load(k, d), &
              balance%force(k, d))
    allocate (balance%bent(k, m), source=(0.0_wp, 0.0_wp))
    allocate (balance%u(s, d), balance%w(s, m), balance%slopes(s, m, d), balance%by_u(s, d, d), &
              balance%by_v(s, d, m), balance%f(s, d), &
              balance%block(2*k, 2*k), balance%memory(2*k, 2*k, m), source=0.0_wp)
    balance%highest = maxval(set%orders)
    balance%stride = merge(2, 1, set%half_wave)
    allocate (balance%cosines(s, 0:2*balance%highest), balance%sines(s, 0:2*balance%highest), &
              source=0.0_wp)
    period = merge(2, 1, set%half_wave)*s
    do m = 0, 2*balance%highest
      do k = 1, s
        angle = 2.0_wp*pi*modulo(m*(k - 1), period)/period
        balance%cosines(k, m) = cos(angle)/s
        balance%sines(k, m) = sin(angle)/s
      end do
    end do
  end subroutine new_balance

  !> Everything that depends on the frequency alone.
  subroutine set_frequency(self, system, load, nu)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: nu
    integer :: j, k

    self%nu = nu
    call system%retained(self%set%orders*nu, self%fraction)
    call system%dynamic_stiffness(self%set%orders*nu, self%fraction, self%stiffness)
    do k = 1, size(self%set%orders)
      self%load(k, :) = load%coefficient(system, self%set%orders(k), nu)
      self%force(k, :) = (0.0_wp, 0.0_wp)
      do j = 1, size(load%orders)
        if (load%orders(j) == self%set%orders(k)) self%force(k, :) = load%force(:, j)
      end do
    end do
  end subroutine set_frequency

  !> R at the harmonics x.
  subroutine residual(self, system, x, r)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(2*size(self%set%orders), self%n_dof)
    real(wp), intent(out) :: r(2*size(self%set%orders), self%n_dof)
    complex(wp) :: z(size(self%set%orders), size(self%w, 2)), y(size(self%set%orders), size(x, 2))
    complex(wp) :: total(size(self%set%orders), size(x, 2))
    integer :: a, b, j, k

    do b = 1, self%n_dof
      self%u(:, b) = matmul(x(:, b), self%set%synthesis)
      y(:, b) = cmplx(x(1::2, b), x(2::2, b), wp)
    end do
    total = (0.0_wp, 0.0_wp)
    do b = 1, self%n_dof
      do a = 1, self%n_dof
        total(:, a) = total(:, a) + self%stiffness(a, b, :)*y(:, b)
      end do
    end do
    total = total - self%load_factor*self%load
    z = (0.0_wp, 0.0_wp)
    if (any(system%bent)) call system%deflection_remainder(self%u, self%w)
    do j = 1, self%n_memory
      if (.not. system%bent(j)) cycle
      self%bent(:, j) = harmonics(self, self%w(:, j))
      z(:, j) = self%fraction(:, j)*self%bent(:, j)
      do a = 1, self%n_dof
        if (abs(system%spread(a, j)) > 0.0_wp) then
          total(:, a) = total(:, a) + system%spread(a, j)*z(:, j)
        end if
      end do
    end do
    if (.not. system%separable) then
      do j = 1, self%n_memory
        do b = 1, self%n_dof
          z(:, j) = z(:, j) + self%fraction(:, j)*system%gather(j, b)*y(:, b)
        end do
        self%w(:, j) = samples(self, z(:, j))
      end do
      call system%force_remainder(self%u, self%w, self%f)
      do a = 1, self%n_dof
        total(:, a) = total(:, a) + harmonics(self, self%f(:, a))
      end do
    end if
    ! The mean has an imaginary part only: its real part is held at 0.
    do k = 1, size(self%set%orders)
      if (self%set%orders(k) == 0) total(k, :) = cmplx(real(y(k, :)), aimag(total(k, :)), wp)
    end do
    do a = 1, self%n_dof
      r(1::2, a) = real(total(:, a))
      r(2::2, a) = aimag(total(:, a))
    end do
    if (self%even_in_time) r(1::2, :) = x(1::2, :)
  end subroutine residual

  pure function harmonics(self, signal) result(z)
    class(balance_type), intent(in) :: self
    real(wp), intent(in) :: signal(:)
    complex(wp) :: z(size(self%set%orders))
    real(wp) :: parts(2*size(self%set%orders))
    parts = matmul(signal, self%set%analysis)
    z = cmplx(parts(1::2), parts(2::2), wp)
  end function harmonics

  pure function samples(self, z) result(signal)
    class(balance_type), intent(in) :: self
    complex(wp), intent(in) :: z(:)
    real(wp) :: signal(self%set%n_samples), parts(2*size(z))
    parts(1::2) = real(z)
    parts(2::2) = aimag(z)
    signal = matmul(parts, self%set%synthesis)
  end function samples

  !> dR/dx at the motion that `residual` saw last.
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
    if (any(system%bent)) call system%deflection_slopes(self%u, self%slopes)
    if (.not. system%separable) call system%force_slopes(self%u, self%w, self%by_u, self%by_v)
    do b = 1, self%n_dof
      do j = 1, self%n_memory
        if (.not. system%bent(j)) cycle
        if (.not. any(abs(self%slopes(:, j, b)) > 0.0_wp)) then
          if (.not. system%separable) self%memory(:, :, j) = 0.0_wp
          cycle
        end if
        call sandwich(self, self%slopes(:, j, b), self%block)
        if (system%kernel_of(j) > 0) call retain_rows(self%fraction(:, j), self%block)
        do a = 1, self%n_dof
          if (abs(system%spread(a, j)) > 0.0_wp) then
            call add_block(self%block, system%spread(a, j), a, b, jacobian)
          end if
        end do
        if (.not. system%separable) self%memory(:, :, j) = self%block
      end do
      if (.not. system%separable) call add_inseparable(self, system, b, jacobian)
    end do
    if (self%even_in_time) then
      do j = 1, self%n, 2
        jacobian(:self%n, j) = 0.0_wp
        jacobian(j, :self%n) = 0.0_wp
        jacobian(j, j) = 1.0_wp
      end do
    end if
  end subroutine derivatives

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

  !> The part of F(u, v) - B v, v through memory; `memory` holds the bent part of
  !! the derivatives of v.
  subroutine add_inseparable(self, system, b, jacobian)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: b
    real(wp), intent(inout) :: jacobian(:, :)
    integer :: a, j, k

    do j = 1, self%n_memory
      if (.not. system%bent(j)) self%memory(:, :, j) = 0.0_wp
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
        call sandwich(self, self%by_u(:, a, b), self%block)
        call add_block(self%block, 1.0_wp, a, b, jacobian)
      end if
      do j = 1, self%n_memory
        if (.not. any(abs(self%by_v(:, a, j)) > 0.0_wp)) cycle
        call sandwich(self, self%by_v(:, a, j), self%block)
        call add_block(matmul(self%block, self%memory(:, :, j)), 1.0_wp, a, b, jacobian)
      end do
    end do
  end subroutine add_inseparable

  !> Harmonics of slope(t) times each basic motion. Products of two of these are
  !! sums of two others, so the Fourier moments of the slope are enough; at the
  !! samples that is an identity, aliasing and all.
  pure subroutine sandwich(self, slope, block)
    class(balance_type), intent(in) :: self
    real(wp), intent(in) :: slope(:)
    real(wp), intent(out) :: block(:, :)
    real(wp) :: c(0:2*self%highest), s(-2*self%highest:2*self%highest), half
    integer :: i, j, k, l, m

    do m = 0, 2*self%highest, self%stride
      c(m) = 0.0_wp
      s(m) = 0.0_wp
      do i = 1, size(slope)
        c(m) = c(m) + slope(i)*self%cosines(i, m)
        s(m) = s(m) + slope(i)*self%sines(i, m)
      end do
      s(-m) = -s(m)
    end do
    do j = 1, size(self%set%orders)
      l = self%set%orders(j)
      do i = 1, size(self%set%orders)
        k = self%set%orders(i)
        half = merge(0.5_wp, 1.0_wp, k == 0)
        block(2*i - 1, 2*j - 1) = half*(c(abs(k - l)) - c(k + l))
        block(2*i, 2*j - 1) = half*(s(k + l) + s(l - k))
        block(2*i - 1, 2*j) = half*(s(k + l) + s(k - l))
        block(2*i, 2*j) = half*(c(abs(k - l)) + c(k + l))
      end do
    end do
  end subroutine sandwich

  !> Multiply rows, pairs of real and imaginary parts, by complex numbers.
  pure subroutine retain_rows(fraction, block)
    complex(wp), intent(in) :: fraction(:)
    real(wp), intent(inout) :: block(:, :)
    real(wp) :: re
    integer :: k, l
    do l = 1, size(block, 2)
      do k = 1, size(fraction)
        re = real(fraction(k))*block(2*k - 1, l) - aimag(fraction(k))*block(2*k, l)
        block(2*k, l) = real(fraction(k))*block(2*k, l) + aimag(fraction(k))*block(2*k - 1, l)
        block(2*k - 1, l) = re
      end do
    end do
  end subroutine retain_rows

  !> dR/ds, s the factor of the load.
  pure subroutine load_derivative(self, slope)
    class(balance_type), intent(in) :: self
    real(wp), intent(out) :: slope(2*size(self%set%orders), self%n_dof)
    integer :: k
    slope(1::2, :) = -real(self%load)
    slope(2::2, :) = -aimag(self%load)
    do k = 1, size(self%set%orders)
      if (self%set%orders(k) == 0) slope(2*k - 1, :) = 0.0_wp
    end do
  end subroutine load_derivative

  !> dR/dnu at the motion x that `residual` saw last. What memory retains is
  !! differentiated by a central difference, for kernels give no derivative: the
  !! slope only steers the steps of a continuation.
  subroutine frequency_derivative(self, system, load, x, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: x(2*size(self%set%orders), self%n_dof)
    real(wp), intent(out) :: slope(2*size(self%set%orders), self%n_dof)
    complex(wp) :: total(size(self%set%orders), size(x, 2)), y(size(self%set%orders), size(x, 2))
    complex(wp), dimension(size(self%set%orders), size(self%w, 2)) :: above, below
    real(wp) :: kept_w(size(self%w, 1), size(self%w, 2))
    integer :: a, b, j, k

    if (any(system%kernel_of > 0) .and. .not. system%separable) then
      kept_w = self%w
      call slope_by_difference(self, system, load, x, slope)
      self%w = kept_w
      return
    end if
    total = (0.0_wp, 0.0_wp)
    do b = 1, self%n_dof
      y(:, b) = cmplx(x(1::2, b), x(2::2, b), wp)
      do a = 1, self%n_dof
        do k = 1, size(self%set%orders)
          total(k, a) = total(k, a) + self%set%orders(k) &
                        *cmplx(-2.0_wp*self%set%orders(k)*self%nu*system%mass(a, b), &
                               system%damping(a, b), wp)*y(k, b)
        end do
      end do
    end do
    if (load%moves_base()) then
      total = total - self%load_factor*(self%load - self%force)*(2.0_wp/self%nu)
    end if
    if (any(system%kernel_of > 0)) then
      call system%retained(self%set%orders*self%nu*(1.0_wp + part), above)
      call system%retained(self%set%orders*self%nu*(1.0_wp - part), below)
      do j = 1, self%n_memory
        if (system%kernel_of(j) == 0) cycle
        above(:, j) = (above(:, j) - below(:, j))/(2.0_wp*part*self%nu) &
                      *(self%bent(:, j) + matmul(y, system%gather(j, :)))
        do a = 1, self%n_dof
          total(:, a) = total(:, a) + system%spread(a, j)*above(:, j)
        end do
      end do
    end if
    do k = 1, size(self%set%orders)
      if (self%set%orders(k) == 0) total(k, :) = (0.0_wp, 0.0_wp)
    end do
    do a = 1, self%n_dof
      slope(1::2, a) = real(total(:, a))
      slope(2::2, a) = aimag(total(:, a))
    end do
    if (self%even_in_time) slope(1::2, :) = 0.0_wp
  end subroutine frequency_derivative

  !> The same where memory enters F(u, v) in time.
  subroutine slope_by_difference(self, system, load, x, slope)
    class(balance_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(load_type), intent(in) :: load
    real(wp), intent(in) :: x(2*size(self%set%orders), self%n_dof)
    real(wp), intent(out) :: slope(2*size(self%set%orders), self%n_dof)
    real(wp) :: nu, above(size(x, 1), size(x, 2))

    nu = self%nu
    call self%set_frequency(system, load, nu*(1.0_wp + part))
    call self%residual(system, x, above)
    call self%set_frequency(system, load, nu*(1.0_wp - part))
    call self%residual(system, x, slope)
    slope = (above - slope)/(2.0_wp*part*nu)
    call self%set_frequency(system, load, nu)
  end subroutine slope_by_difference

end module viscovib_harmonic_balance
