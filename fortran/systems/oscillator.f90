! Optimize: -O3
!> The abstract oscillator that every method works on.
!!
!! A system of n degrees of freedom on hereditary springs is written as
!!
!!   M u'' + C u' + F(u, v) = load(t),   v_j = (1 - R_j*) w_j,   w = w(u),
!!
!! with m hereditary variables: w_j is a spring quantity without memory (a force or a deflection),
!! v_j the same quantity with memory. Near equilibrium w = W u and F = B v, so the linear stiffness
!! of variable j is B(:,j) W(j,:). A system provides the matrices and the two nonlinear remainders
!! for arrays of samples; all linear parts are computed here.
module viscovib_oscillator
  use viscovib_counters, only: count_up, counted_transforms, counting
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_speed_matrices, only: speed_matrices
  implicit none
  private

  ! Also exported for modules that fill `kernels`.
  public :: oscillator_type, kernel_holder

  !> Error of an analysis without a speed.
  character(len=*), parameter, public :: speed_needed = &
    'speed: must be given to the system, whose matrices depend on it; no frequency nu of a load ' &
    //'is the speed here'

  !> The speed of its matrices is the frequency of the load.
  type, abstract, extends(speed_matrices) :: oscillator_type
    !> M and C, shape (n_dof, n_dof).
    real(wp), allocatable :: mass(:, :), damping(:, :)
    !> W, shape (n_memory, n_dof), and B, shape (n_dof, n_memory).
    real(wp), allocatable :: gather(:, :), spread(:, :)
    !> The distinct kernels, and the kernel of each hereditary variable (0: none, no memory).
    type(kernel_holder), allocatable :: kernels(:)
    integer, allocatable :: kernel_of(:)
    !> Numbers of nonlinear terms and kernels with coefficient 0, which are left out.
    integer :: n_zero = 0, n_silent = 0
    !> Coordinates whose rates some w_j depend on; not allocated: none. These rates are additional
    !! columns of samples of u and of derivatives.
    integer, allocatable :: rates(:)
    !> True for each w_j with a nonlinear part, shape (n_memory).
    logical, allocatable :: bent(:)
    !> F = B v exactly; `force_remainder` is then never called.
    logical :: separable = .true.
    !> w(-u) = -w(u) and F(-u,-v) = -F(u,v): odd loads give odd solutions.
    logical :: odd = .false.
    !> Highest power of u in w and F if they are polynomials, else 0.
    integer :: degree = 0
    !> Displacement of u per unit base displacement without spring deformation, shape (n_dof).
    real(wp), allocatable :: base_direction(:)
    !> Forces due to the absolute rates and displacements of a moving base (relative to inertial
    !! space), shape (n_dof, n_dof); not allocated: none.
    real(wp), allocatable :: space_damping(:, :), space_stiffness(:, :)
    !> True if F also depends on rates and loads: `moving_remainder` and `moving_slopes` then apply.
    logical :: moving = .false.
    !> True if other coordinates were eliminated: the load then also depends on the frequency, and
    !! no coordinate can be skipped.
    logical :: condensed = .false.
  contains
    procedure(deflection_remainder_interface), deferred :: deflection_remainder
    procedure(force_remainder_interface), deferred :: force_remainder
    procedure(deflection_slopes_interface), deferred :: deflection_slopes
    procedure(force_slopes_interface), deferred :: force_slopes
    procedure :: sampled_remainder
    procedure :: sampled_slopes
    procedure :: moving_remainder
    procedure :: moving_slopes
    procedure :: load_along
    procedure :: rename_state
    procedure :: weigh
    procedure :: n_dof
    procedure :: n_memory
    procedure :: n_rates
    procedure :: is_linear
    procedure :: set_speed
    procedure :: drop_zero_kernels
    procedure :: coupling
    procedure :: linear_coupling
    procedure :: largest_amplitude
    procedure :: retained
    procedure :: retained_slope
    procedure :: dynamic_stiffness
    procedure :: load_coefficient
    procedure :: moved_by
    procedure :: add_frequency_slope
    procedure :: kernel_without_integral
  end type oscillator_type

  abstract interface

    !> w(u) - W u.
    subroutine deflection_remainder_interface(self, u, w)
      import :: oscillator_type, wp
      class(oscillator_type), intent(in) :: self
      !> Coordinates, and rates, shape (n_samples, n_dof + n_rates).
      real(wp), intent(in), contiguous :: u(:, :)
      !> Remainder, shape (n_samples, n_memory); columns that are not `bent` are unchanged.
      real(wp), intent(inout), contiguous :: w(:, :)
    end subroutine deflection_remainder_interface

    !> F(u, v) - B v.
    subroutine force_remainder_interface(self, u, v, f)
      import :: oscillator_type, wp
      class(oscillator_type), intent(in) :: self
      !> Coordinates (n_samples, n_dof) and hereditary variables
      !! (n_samples, n_memory).
      real(wp), intent(in), contiguous :: u(:, :), v(:, :)
      !> Remainder, shape (n_samples, n_dof).
      real(wp), intent(out), contiguous :: f(:, :)
    end subroutine force_remainder_interface

    !> Derivatives of the remainder w(u) - W u.
    subroutine deflection_slopes_interface(self, u, slopes)
      import :: oscillator_type, wp
      class(oscillator_type), intent(in) :: self
      real(wp), intent(in), contiguous :: u(:, :)
      !> d w_j/d u_b, shape (n_samples, n_memory, n_dof + n_rates); variables that are not `bent`
      !! are unchanged.
      real(wp), intent(inout), contiguous :: slopes(:, :, :)
    end subroutine deflection_slopes_interface

    !> Derivatives of the remainder F(u, v) - B v.
    subroutine force_slopes_interface(self, u, v, by_u, by_v)
      import :: oscillator_type, wp
      class(oscillator_type), intent(in) :: self
      real(wp), intent(in), contiguous :: u(:, :), v(:, :)
      !> Shapes (n_samples, n_dof, n_dof) and (n_samples, n_dof, n_memory).
      real(wp), intent(out), contiguous :: by_u(:, :, :), by_v(:, :, :)
    end subroutine force_slopes_interface

  end interface

contains

  !> Scale the masses by a factor.
  subroutine weigh(self, factor)
    class(oscillator_type), intent(inout) :: self
    real(wp), intent(in) :: factor
    self%mass = factor*self%mass
  end subroutine weigh

  !> Fix the speed: the matrices become constant.
  subroutine set_speed(self, speed)
    class(oscillator_type), intent(inout) :: self
    !> rad/s.
    real(wp), intent(in) :: speed
    integer :: a, j

    if (.not. self%depends_on_speed()) return
    self%damping = self%damping + speed*self%gyroscopic
    ! Each row of the stiffness has a variable without memory.
    do a = 1, self%n_dof()
      do j = 1, self%n_memory()
        if (self%kernel_of(j) > 0 .or. .not. abs(self%spread(a, j)) > 0.0_wp) cycle
        self%gather(j, :) = self%gather(j, :) + speed*self%circulatory(a, :) &
                            + speed**2*self%centrifugal(a, :)
        exit
      end do
    end do
    call self%drop_matrices()
  end subroutine set_speed

  !> Variables with a zero kernel have no memory.
  subroutine drop_zero_kernels(self)
    class(oscillator_type), intent(inout) :: self
    integer :: i
    do i = 1, size(self%kernels)
      if (.not. any(self%kernel_of == i)) cycle
      if (.not. self%kernels(i)%is_zero()) cycle
      where (self%kernel_of == i) self%kernel_of = 0
      self%n_silent = self%n_silent + 1
    end do
  end subroutine drop_zero_kernels

  !> Part of w(u) - W u that harmonic balance evaluates at samples. Default: all; systems may
  !! override it for terms that are integrated differently.
  subroutine sampled_remainder(self, u, w)
    class(oscillator_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: w(:, :)
    call self%deflection_remainder(u, w)
  end subroutine sampled_remainder

  !> Derivatives of `sampled_remainder`.
  subroutine sampled_slopes(self, u, slopes)
    class(oscillator_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: slopes(:, :, :)
    call self%deflection_slopes(u, slopes)
  end subroutine sampled_slopes

  !> F(u, u', v, load) - B v for `moving` systems, otherwise F(u, v) - B v.
  subroutine moving_remainder(self, u, rate, v, load, f)
    class(oscillator_type), intent(in) :: self
    !> Coordinates, rates and loads (n_samples, n_dof), hereditary variables (n_samples, n_memory).
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :), v(:, :), load(:, :)
    !> Shape (n_samples, n_dof).
    real(wp), intent(out), contiguous :: f(:, :)
    call self%force_remainder(u, v, f)
    associate (not_needed => [shape(rate), shape(load)])
    end associate
  end subroutine moving_remainder

  !> Derivatives of `moving_remainder`.
  subroutine moving_slopes(self, u, rate, v, load, by_u, by_rate, by_v)
    class(oscillator_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :), v(:, :), load(:, :)
    !> Shapes (n_samples, n_dof, n_dof) twice, and (n_samples, n_dof, n_memory).
    real(wp), intent(out), contiguous :: by_u(:, :, :), by_rate(:, :, :), by_v(:, :, :)
    call self%force_slopes(u, v, by_u, by_v)
    by_rate = 0.0_wp
    associate (not_needed => [shape(rate), shape(load)])
    end associate
  end subroutine moving_slopes

  !> Load that produces a given motion of a `moving` system; 0 for other systems.
  subroutine load_along(self, u, rate, acceleration, v, load)
    class(oscillator_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :), acceleration(:, :), v(:, :)
    real(wp), intent(out), contiguous :: load(:, :)
    load = 0.0_wp
    associate (not_needed => [self%n_dof(), shape(u), shape(rate), shape(acceleration), shape(v)])
    end associate
  end subroutine load_along

  !> Equivalent state in other coordinates, for systems whose coordinates have a singularity nearby.
  subroutine rename_state(self, u, v, renamed, like)
    class(oscillator_type), intent(in) :: self
    !> Coordinates and rates, shape (n_dof).
    real(wp), intent(inout) :: u(:), v(:)
    logical, intent(out) :: renamed
    !> Choose the state closest to these coordinates, shape (n_dof).
    real(wp), intent(in), optional :: like(:)
    renamed = .false.
    associate (not_needed => [self%n_dof(), size(u), size(v)], nor => present(like))
    end associate
  end subroutine rename_state

  pure integer function n_dof(self)
    class(oscillator_type), intent(in) :: self
    n_dof = size(self%gather, 2)
  end function n_dof

  pure integer function n_memory(self)
    class(oscillator_type), intent(in) :: self
    n_memory = size(self%gather, 1)
  end function n_memory

  !> Number of rates on which some w_j depend.
  pure integer function n_rates(self)
    class(oscillator_type), intent(in) :: self
    n_rates = 0
    if (allocated(self%rates)) n_rates = size(self%rates)
  end function n_rates

  !> True if there is no nonlinear term.
  pure logical function is_linear(self)
    class(oscillator_type), intent(in) :: self
    is_linear = self%separable .and. .not. any(self%bent)
  end function is_linear

  !> Mask of directly coupled coordinates, shape (n_dof, n_dof). A system with unknown nonlinear
  !! terms counts as fully coupled.
  pure function coupling(self) result(coupled)
    class(oscillator_type), intent(in) :: self
    logical :: coupled(size(self%gather, 2), size(self%gather, 2))
    coupled = .true.
    if (self%is_linear()) coupled = self%linear_coupling()
  end function coupling

  !> Coupling by mass, damping and springs alone.
  pure function linear_coupling(self) result(coupled)
    class(oscillator_type), intent(in) :: self
    logical :: coupled(size(self%gather, 2), size(self%gather, 2))
    integer :: j, b

    coupled = abs(self%mass) > 0.0_wp .or. abs(self%damping) > 0.0_wp
    if (self%depends_on_speed()) then
      coupled = coupled .or. abs(self%gyroscopic) > 0.0_wp .or. abs(self%circulatory) > 0.0_wp &
                .or. abs(self%centrifugal) > 0.0_wp
    end if
    do j = 1, self%n_memory()
      do b = 1, self%n_dof()
        if (abs(self%gather(j, b)) > 0.0_wp) then
          coupled(:, b) = coupled(:, b) .or. abs(self%spread(:, j)) > 0.0_wp
        end if
      end do
    end do
    coupled = coupled .or. transpose(coupled)
  end function linear_coupling

  !> Largest amplitude whose powers do not overflow. Beyond it, the `wall` value of a law outside of
  !! its domain could also enter a solution.
  pure real(wp) function largest_amplitude(self)
    class(oscillator_type), intent(in) :: self
    largest_amplitude = 10.0_wp**min(180/max(self%degree, 3), 40)
  end function largest_amplitude

  !> 1 - (R_c - i R_s) at each circular frequency, one column per hereditary variable: the fraction
  !! of the variable that remains with memory.
  subroutine retained(self, mu, fraction)
    class(oscillator_type), intent(in) :: self
    !> Circular frequencies (rad/s), shape (n); 0 uses the integral of the kernel.
    real(wp), intent(in) :: mu(:)
    !> Shape (n, n_memory).
    complex(wp), intent(out) :: fraction(:, :)
    integer :: i, j

    fraction = (1.0_wp, 0.0_wp)
    do i = 1, size(self%kernels)
      if (.not. any(self%kernel_of == i)) cycle
      if (counting) call count_up(counted_transforms, size(mu))
      block
        ! Allocated only if there is a kernel, since allocation is expensive for few frequencies.
        real(wp) :: cosine(size(mu)), sine(size(mu))
        call self%kernels(i)%transform(mu, cosine, sine)
        do j = 1, self%n_memory()
          if (self%kernel_of(j) /= i) cycle
          fraction(:, j) = cmplx(1.0_wp - cosine, sine, wp)
        end do
      end block
    end do
  end subroutine retained

  !> Derivative of `retained` by mu.
  subroutine retained_slope(self, mu, fraction, slope)
    class(oscillator_type), intent(in) :: self
    !> Circular frequencies (rad/s), shape (n); the slope at 0 is set to 0.
    real(wp), intent(in) :: mu(:)
    !> From `retained`, and its derivative (s), shape (n, n_memory).
    complex(wp), intent(in) :: fraction(:, :)
    complex(wp), intent(out) :: slope(:, :)
    complex(wp) :: transform(size(mu)), by_mu(size(mu))
    integer :: i, j, first

    slope = (0.0_wp, 0.0_wp)
    do i = 1, size(self%kernels)
      first = findloc(self%kernel_of, i, 1)
      if (first == 0) cycle
      transform = 1.0_wp - fraction(:, first)
      call self%kernels(i)%transform_slope(merge(mu, 1.0_wp, abs(mu) > 0.0_wp), &
                                                  transform, by_mu)
      where (.not. abs(mu) > 0.0_wp) by_mu = (0.0_wp, 0.0_wp)
      do j = first, self%n_memory()
        if (self%kernel_of(j) == i) slope(:, j) = -by_mu
      end do
    end do
  end subroutine retained_slope

  !> D(mu) = sum_j B(:,j) W(j,:) (1 - Rhat_j(mu)) + i mu C - mu^2 M for
  !! u = Im(X exp(i mu t)), with the matrices at the speed.
  pure subroutine dynamic_stiffness(self, mu, speed, fraction, stiffness)
    class(oscillator_type), intent(in) :: self
    !> Circular frequencies and speeds (rad/s), shape (n).
    real(wp), intent(in), contiguous :: mu(:)
    real(wp), intent(in) :: speed(:)
    !> From `retained`, shape (n, n_memory).
    complex(wp), intent(in), contiguous :: fraction(:, :)
    !> D, shape (n_dof, n_dof, n).
    complex(wp), intent(out), contiguous :: stiffness(:, :, :)
    real(wp) :: part
    integer :: a, b, j, k

    if (size(mu) == 0) return
    do b = 1, size(stiffness, 2)
      ! Elastic part, stored in the slot of the first frequency, which is computed last.
      stiffness(:, b, 1) = (0.0_wp, 0.0_wp)
      do j = 1, size(self%kernel_of)
        part = self%gather(j, b)
        if (self%kernel_of(j) > 0 .or. .not. abs(part) > 0.0_wp) cycle
        do a = 1, size(stiffness, 1)
          stiffness(a, b, 1) = cmplx(real(stiffness(a, b, 1)) + self%spread(a, j)*part, 0.0_wp, wp)
        end do
      end do
      do k = size(mu), 1, -1
        do a = 1, size(stiffness, 1)
          stiffness(a, b, k) = cmplx(real(stiffness(a, b, 1)) - mu(k)**2*self%mass(a, b), &
                                     mu(k)*self%damping(a, b), wp)
        end do
      end do
      do j = 1, size(self%kernel_of)
        if (self%kernel_of(j) == 0 .or. .not. abs(self%gather(j, b)) > 0.0_wp) cycle
        do a = 1, size(stiffness, 1)
          part = self%spread(a, j)*self%gather(j, b)
          if (.not. abs(part) > 0.0_wp) cycle
          do k = 1, size(mu)
            stiffness(a, b, k) = stiffness(a, b, k) + part*fraction(k, j)
          end do
        end do
      end do
    end do
    if (.not. self%depends_on_speed()) return
    do k = 1, size(mu)
      stiffness(:, :, k) = stiffness(:, :, k) &
                           + cmplx(speed(k)*(self%circulatory + speed(k)*self%centrifugal), &
                                   mu(k)*speed(k)*self%gyroscopic, wp)
    end do
  end subroutine dynamic_stiffness

  !> Load of order k for coordinates relative to the moving base: P_k + (k nu)^2 M Y_k - (i k nu
  !! C_s + K_s) Y_k, with the base displacement Y_k of the coordinates.
  pure function load_coefficient(self, force, base, order, nu, stiffness, fraction) result(p)
    class(oscillator_type), intent(in) :: self
    !> P_k and Y_k.
    complex(wp), intent(in) :: force(:), base(:)
    integer, intent(in) :: order
    real(wp), intent(in) :: nu
    !> From `dynamic_stiffness` and `retained` at this order, if available; used for condensed
    !! systems.
    complex(wp), intent(in), optional :: stiffness(:, :), fraction(:)
    complex(wp) :: p(size(force))

    p = force
    if (any(abs(base) > 0.0_wp)) then
      p = p + (order*nu)**2*matmul(self%mass, base)
      if (allocated(self%space_damping)) then
        p = p - cmplx(0.0_wp, order*nu, wp)*matmul(self%space_damping, base) &
            - matmul(self%space_stiffness, base)
      end if
    end if
    associate (not_needed => [present(stiffness), present(fraction)])
    end associate
  end function load_coefficient

  !> Mask of the coordinates that a base displacement loads.
  pure function moved_by(self, base) result(pushed)
    class(oscillator_type), intent(in) :: self
    complex(wp), intent(in) :: base(:)
    logical :: pushed(size(base))
    pushed = abs(matmul(self%mass, base)) > 0.0_wp
    if (allocated(self%space_damping)) then
      pushed = pushed .or. abs(matmul(self%space_damping, base)) > 0.0_wp &
               .or. abs(matmul(self%space_stiffness, base)) > 0.0_wp
    end if
  end function moved_by

  !> Add d(D y - s P)/dnu for each order, without memory: k (i C - 2 k nu M) Y_k - s dP_k/dnu, and
  !! the derivatives of matrices that depend on the speed nu.
  pure subroutine add_frequency_slope(self, orders, nu, y, load_orders, force, base, factor, total)
    class(oscillator_type), intent(in) :: self
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: nu
    !> Harmonics, shape (size(orders), n_dof).
    complex(wp), intent(in) :: y(:, :)
    !> Orders of the load, its forces and base displacements of the coordinates, shapes (n_dof, n),
    !! and its factor s.
    integer, intent(in) :: load_orders(:)
    complex(wp), intent(in) :: force(:, :), base(:, :)
    real(wp), intent(in) :: factor
    complex(wp), intent(inout) :: total(:, :)
    integer :: a, b, j, k

    do b = 1, size(y, 2)
      do a = 1, size(y, 2)
        do k = 1, size(orders)
          total(k, a) = total(k, a) + orders(k) &
                        *cmplx(-2.0_wp*orders(k)*nu*self%mass(a, b), self%damping(a, b), wp)*y(k, b)
        end do
      end do
    end do
    if (self%depends_on_speed()) then
      do k = 1, size(orders)
        total(k, :) = total(k, :) + matmul(cmplx(self%circulatory + 2.0_wp*nu*self%centrifugal, &
                                                 2.0_wp*orders(k)*nu*self%gyroscopic, wp), y(k, :))
      end do
    end if
    associate (not_needed => size(force))
    end associate
    do j = 1, size(load_orders)
      if (.not. any(abs(base(:, j)) > 0.0_wp)) cycle
      k = findloc(orders, load_orders(j), 1)
      if (k == 0) cycle
      total(k, :) = total(k, :) - factor*2.0_wp*load_orders(j)**2*nu*matmul(self%mass, base(:, j))
      if (allocated(self%space_damping)) then
        total(k, :) = total(k, :) + factor*cmplx(0.0_wp, load_orders(j), wp) &
                      *matmul(self%space_damping, base(:, j))
      end if
    end do
  end subroutine add_frequency_slope

  !> First used kernel with an infinite integral (0: none). Such a system has no static response.
  integer function kernel_without_integral(self)
    class(oscillator_type), intent(in) :: self
    integer :: i
    do i = 1, size(self%kernels)
      kernel_without_integral = i
      if (.not. any(self%kernel_of == i)) cycle
      if (abs(self%kernels(i)%integral()) > huge(1.0_wp)) return
    end do
    kernel_without_integral = 0
  end function kernel_without_integral

end module viscovib_oscillator
