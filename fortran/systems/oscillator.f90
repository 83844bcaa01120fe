!> The abstract oscillator that every method works on.
!!
!! A system of n degrees of freedom on hereditary springs is written as
!!
!!   M u'' + C u' + F(u, v) = load(t),   v_j = (1 - R_j*) w_j,   w = w(u),
!!
!! with m hereditary variables: w_j is what a spring would do without memory
!! (a force or a deflection), v_j the same with memory. Near rest w = W u and
!! F = B v, so the linear stiffness of variable j is B(:,j) W(j,:). A system
!! gives the matrices and the two nonlinear remainders, for whole arrays of
!! samples at once; all that is linear is done here.
module viscovib_oscillator
  use viscovib_counters, only: count_up, counted_transforms, counting
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  implicit none
  private

  ! The holder too, as those expect who fill `kernels`.
  public :: oscillator_type, kernel_holder

  type, abstract :: oscillator_type
    !> M and C, shape (n_dof, n_dof).
    real(wp), allocatable :: mass(:, :), damping(:, :)
    !> W, shape (n_memory, n_dof), and B, shape (n_dof, n_memory).
    real(wp), allocatable :: gather(:, :), spread(:, :)
    !> The distinct kernels, and which of them each hereditary variable has
    !! (0: none, the variable forgets at once).
    type(kernel_holder), allocatable :: kernels(:)
    integer, allocatable :: kernel_of(:)
    !> Nonlinear terms and kernels that were given as 0 and left out.
    integer :: n_zero = 0, n_silent = 0
    !> Coordinates whose rates some w_j depend on; not allocated: none. Samples of u have these
    !! rates as further columns, derivatives by them too.
    integer, allocatable :: rates(:)
    !> Which w_j have a nonlinear part at all, shape (n_memory).
    logical, allocatable :: bent(:)
    !> F = B v exactly; `force_remainder` is then never called.
    logical :: separable = .true.
    !> w(-u) = -w(u) and F(-u,-v) = -F(u,v): odd loads give odd motion.
    logical :: odd = .false.
    !> Highest power of u in w and F if they are polynomials, else 0.
    integer :: degree = 0
    !> How u moves when the base does, without deforming a spring (n_dof).
    real(wp), allocatable :: base_direction(:)
    !> Forces by the rates and by the displacements that a moving base gives the coordinates, which
    !! hang on space and not on the base, shape (n_dof, n_dof); not allocated: none.
    real(wp), allocatable :: space_damping(:, :), space_stiffness(:, :)
    !> F depends on rates and loads too: `moving_remainder` and `moving_slopes` give it.
    logical :: moving = .false.
    !> Coordinates stand for more that were eliminated: the load depends on the frequency too, and
    !! no coordinate is idle.
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
      !> Remainder, shape (n_samples, n_memory); columns that are not `bent`
      !! are left alone.
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
      !> d w_j/d u_b, shape (n_samples, n_memory, n_dof + n_rates); variables that are not
      !! `bent` are left alone.
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

  !> Masses other by a factor.
  subroutine weigh(self, factor)
    class(oscillator_type), intent(inout) :: self
    real(wp), intent(in) :: factor
    self%mass = factor*self%mass
  end subroutine weigh

  !> Variables with a kernel that is 0 forget at once.
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

  !> What a harmonic balance takes at samples of w(u) - W u: all, unless a system says what is
  !! integrated in another way.
  subroutine sampled_remainder(self, u, w)
    class(oscillator_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: w(:, :)
    call self%deflection_remainder(u, w)
  end subroutine sampled_remainder

  !> Its derivatives.
  subroutine sampled_slopes(self, u, slopes)
    class(oscillator_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: slopes(:, :, :)
    call self%deflection_slopes(u, slopes)
  end subroutine sampled_slopes

  !> F(u, u', v, load) - B v of systems that are `moving`; of others F(u, v) - B v.
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

  !> Its derivatives.
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

  !> The load under which a system that is `moving` moves so; 0 of others, which do not ask for it.
  subroutine load_along(self, u, rate, acceleration, v, load)
    class(oscillator_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :), acceleration(:, :), v(:, :)
    real(wp), intent(out), contiguous :: load(:, :)
    load = 0.0_wp
    associate (not_needed => [self%n_dof(), shape(u), shape(rate), shape(acceleration), shape(v)])
    end associate
  end subroutine load_along

  !> The same state by other numbers, of systems whose coordinates end somewhere, near that place.
  subroutine rename_state(self, u, v, renamed, like)
    class(oscillator_type), intent(in) :: self
    !> Coordinates and rates, shape (n_dof).
    real(wp), intent(inout) :: u(:), v(:)
    logical, intent(out) :: renamed
    !> The numbers wanted are those nearest to these coordinates, shape (n_dof).
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

  !> How many rates some w_j depend on.
  pure integer function n_rates(self)
    class(oscillator_type), intent(in) :: self
    n_rates = 0
    if (allocated(self%rates)) n_rates = size(self%rates)
  end function n_rates

  !> No nonlinear term is left to evaluate.
  pure logical function is_linear(self)
    class(oscillator_type), intent(in) :: self
    is_linear = self%separable .and. .not. any(self%bent)
  end function is_linear

  !> Which coordinates act on each other without another between them, shape
  !! (n_dof, n_dof). Nothing is known here of what is not linear: it may couple all.
  pure function coupling(self) result(coupled)
    class(oscillator_type), intent(in) :: self
    logical :: coupled(size(self%gather, 2), size(self%gather, 2))
    coupled = .true.
    if (self%is_linear()) coupled = self%linear_coupling()
  end function coupling

  !> The same of mass, damping and springs alone.
  pure function linear_coupling(self) result(coupled)
    class(oscillator_type), intent(in) :: self
    logical :: coupled(size(self%gather, 2), size(self%gather, 2))
    integer :: j, b

    coupled = abs(self%mass) > 0.0_wp .or. abs(self%damping) > 0.0_wp
    do j = 1, self%n_memory()
      do b = 1, self%n_dof()
        if (abs(self%gather(j, b)) > 0.0_wp) then
          coupled(:, b) = coupled(:, b) .or. abs(self%spread(:, j)) > 0.0_wp
        end if
      end do
    end do
    coupled = coupled .or. transpose(coupled)
  end function linear_coupling

  !> Amplitudes beyond this have powers that could leave the range of numbers, or lean on the wall
  !! of a law outside its domain.
  pure real(wp) function largest_amplitude(self)
    class(oscillator_type), intent(in) :: self
    largest_amplitude = 10.0_wp**min(180/max(self%degree, 3), 40)
  end function largest_amplitude

  !> 1 - (R_c - i R_s) at each circular frequency, a column for each
  !! hereditary variable: what memory leaves of the variable.
  subroutine retained(self, mu, fraction)
    class(oscillator_type), intent(in) :: self
    !> Circular frequencies (rad/s), shape (n); 0 asks for the integral.
    real(wp), intent(in) :: mu(:)
    !> Shape (n, n_memory).
    complex(wp), intent(out) :: fraction(:, :)
    integer :: i, j

    fraction = (1.0_wp, 0.0_wp)
    do i = 1, size(self%kernels)
      if (.not. any(self%kernel_of == i)) cycle
      if (counting) call count_up(counted_transforms, size(mu))
      block
        ! Made where there is a kernel only: room for a few numbers takes as long as they do.
        real(wp) :: cosine(size(mu)), sine(size(mu))
        call self%kernels(i)%transform(mu, cosine, sine)
        do j = 1, self%n_memory()
          if (self%kernel_of(j) /= i) cycle
          fraction(:, j) = cmplx(1.0_wp - cosine, sine, wp)
        end do
      end block
    end do
  end subroutine retained

  !> What `retained` gave, differentiated by mu.
  subroutine retained_slope(self, mu, fraction, slope)
    class(oscillator_type), intent(in) :: self
    !> Circular frequencies (rad/s), shape (n); at 0 the slope is given as 0.
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
  !! u = Im(X exp(i mu t)).
  pure subroutine dynamic_stiffness(self, mu, fraction, stiffness)
    class(oscillator_type), intent(in) :: self
    !> Circular frequencies (rad/s), shape (n).
    real(wp), intent(in) :: mu(:)
    !> From `retained`, shape (n, n_memory).
    complex(wp), intent(in) :: fraction(:, :)
    !> D, shape (n_dof, n_dof, n).
    complex(wp), intent(out) :: stiffness(:, :, :)
    real(wp) :: part
    integer :: a, b, j, k

    if (size(mu) == 0) return
    do b = 1, size(stiffness, 2)
      ! What is elastic, in place of the first order, which comes last.
      stiffness(:, b, 1) = (0.0_wp, 0.0_wp)
      do j = 1, size(self%kernel_of)
        if (self%kernel_of(j) == 0 .and. abs(self%gather(j, b)) > 0.0_wp) then
          stiffness(:, b, 1) = stiffness(:, b, 1) + self%spread(:, j)*self%gather(j, b)
        end if
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
          if (abs(part) > 0.0_wp) stiffness(a, b, :) = stiffness(a, b, :) + part*fraction(:, j)
        end do
      end do
    end do
  end subroutine dynamic_stiffness

  !> Of order k, on the coordinates relative to the moving base: P_k + (k nu)^2 M Y_k, less what
  !! hangs on space, (i k nu C_s + K_s) Y_k, where the base moves the coordinates by Y_k.
  pure function load_coefficient(self, force, base, order, nu, stiffness, fraction) result(p)
    class(oscillator_type), intent(in) :: self
    !> P_k and Y_k.
    complex(wp), intent(in) :: force(:), base(:)
    integer, intent(in) :: order
    real(wp), intent(in) :: nu
    !> From `dynamic_stiffness` and `retained` at this order, if they are known: of use where
    !! coordinates are condensed.
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

  !> Which coordinates are pushed where the base moves them so.
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

  !> Add d(D y - s P)/dnu of each order, memory apart: k (i C - 2 k nu M) Y_k - s dP_k/dnu.
  pure subroutine add_frequency_slope(self, orders, nu, y, load_orders, force, base, factor, total)
    class(oscillator_type), intent(in) :: self
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: nu
    !> Harmonics, shape (size(orders), n_dof).
    complex(wp), intent(in) :: y(:, :)
    !> Orders of the load, its forces and what the base moves the coordinates by, shapes (n_dof, n),
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

  !> The first kernel in use whose integral does not exist (0: none). Such a
  !! system has no static response.
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
