! Optimize: -O3
!> Hill's determinant of a periodic solution, memory included.
!!
!! A small disturbance (`viscovib_hill_determinant`) obeys, with f_j(s) = 1 - epsilon_1 R_j(s) and
!! Laplace transforms R_j of the kernels,
!!
!!   (s_k^2 M + s_k C) Y_k + sum_l A_(k-l) Y_l
!!     + sum_j sum_m b_j,(k-m) f_j(s_m) sum_l w_j,(m-l) Y_l = 0,
!!
!! w_j, b_j and A the Fourier coefficients of dw_j/du, dF/dv_j and dF/du along the
!! solution (Hill, Acta Math. 8 (1886) 1, for equations without memory). Where w_j depends on
!! rates, those of dw_j/du' times s_l are added to w_j,(m-l); their mean, if it has no memory, joins
!! C, since it alone decides how the determinant converges. Derivatives of F by rates are added to
!! A, times s_l. Everything is multiplied by M^(-1) and divided by (s_k + a)^2, so that the
!! determinant tends to a periodic function of lambda with period i d that has no poles where Re
!! lambda >= 0 and no winding at large Re lambda. exp(2 pi lambda/d) are the multipliers of
!! `viscovib_floquet`, h of half a period under half-wave symmetry.
module viscovib_hill
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_band_elimination, only: band_determinant
  use viscovib_constants, only: pi
  use viscovib_dense, only: invert
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_hill_blocks, only: add_columns, add_products, add_waves, fill_waves, moments_of, &
    reach_of, scale_rows, widths_of
  use viscovib_hill_determinant, only: hill_determinant, retained_of
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polar, only: plain_logarithm
  implicit none
  private

  public :: hill_type, new_hill

  !> Degree of a force that stands for one that is no polynomial: how many samples.
  integer, parameter :: as_degree = 11
  !> Ratio of a determinant of 0 to that of another order.
  real(wp), parameter :: clear = 1.0e-6_wp
  !> Unknowns of a determinant at most.
  integer, parameter :: max_unknowns = 360
  !> Orders are kept until what reaches the next ones is this small: exponents feel its square.
  real(wp), parameter :: accurate = 1.0e-5_wp
  !> Fourier coefficients of the stiffness that are small compared with its mean have no effect.
  real(wp), parameter :: silent = 1.0e-11_wp

  type, extends(hill_determinant) :: hill_type
    !> a, > 0: exponents are sought right of -a.
    real(wp), private :: shift = 0.0_wp
    !> Trace of M^(-1) dF/du', its mean along the solution.
    real(wp), private :: drag = 0.0_wp
    !> M^(-1), M^(-1) C with the mean of what depends on rates, and M^(-1) B.
    real(wp), allocatable :: inverse(:, :), damping(:, :), spread(:, :)
    !> What each group multiplies, Fourier coefficients by the difference of orders, real parts
    !! first, imaginary parts second in the last index, shape (n, -p:p, n, groups, 2).
    real(wp), allocatable, private :: springs(:, :, :, :, :)
    !> M^(-1) C alone; and as `springs` what depends on rates, if anything does, without its mean
    !! where that has no memory.
    real(wp), allocatable, private :: linear_damping(:, :), dampers(:, :, :, :, :)
    !> Where F(u, v) is not separable: Fourier coefficients of M^(-1) dF/dv, dw/du and
    !! M^(-1) dF/du by the difference of orders, shapes (n, -p:p, m, 2), real parts first,
    !! (m, n, -p:p), (n, n, -p:p).
    real(wp), allocatable, private :: outer(:, :, :, :)
    complex(wp), allocatable, private :: inner(:, :, :), direct(:, :, :)
    !> The differences of orders of `outer` that count, for each difference of those of `inner`.
    integer, allocatable, private :: widths(:)
    real(wp), allocatable, private :: w(:, :), by_u(:, :, :), by_v(:, :, :)
    !> Of systems that are `moving`: rates, accelerations and loads, slopes by rates, and their
    !! Fourier coefficients, which multiply s.
    real(wp), allocatable, private :: rate(:, :), push(:, :), by_rate(:, :, :)
    complex(wp), allocatable, private :: swept(:, :, :)
  contains
    procedure :: along
    procedure :: count_from
    procedure :: of_orders
    procedure :: without_poles
    procedure :: mean_system
    procedure :: on_line
    procedure :: root_of
  end type hill_type

contains

  !> For solutions with the harmonics of `set`.
  subroutine new_hill(hill, system, set)
    type(hill_type), intent(out) :: hill
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    complex(wp) :: inverse(size(system%mass, 1), size(system%mass, 1))
    real(wp), allocatable :: re(:, :), im(:, :)
    logical :: singular
    integer :: j, q, n, m, s

    n = system%n_dof()
    m = system%n_memory()
    hill%n_without_memory = 2*n
    call hill%prepare(system, set, merge(max(2*system%degree - 3, 3), as_degree, &
                                         system%degree > 0))
    call invert(cmplx(system%mass, 0.0_wp, wp), inverse, singular)
    hill%inverse = real(inverse)
    hill%damping = matmul(hill%inverse, system%damping)
    hill%linear_damping = hill%damping
    hill%spread = matmul(hill%inverse, system%spread)
    s = hill%set%n_samples
    allocate (hill%w(s, m), hill%by_u(s, n, n), hill%by_v(s, n, m), hill%by_rate(s, n, n), &
              source=0.0_wp)
    if (system%moving) allocate (hill%rate(s, n), hill%push(s, n), source=0.0_wp)
    allocate (hill%springs_at_rest(n, n, size(hill%kernel_of_group)), im(n, n), source=0.0_wp)
    do j = 1, m
      associate (stiffness => hill%springs_at_rest(:, :, hill%group(j)))
        do q = 1, n
          stiffness(:, q) = stiffness(:, q) + hill%spread(:, j)*system%gather(j, q)
        end do
      end associate
    end do
    re = sum(hill%springs_at_rest, 3)
    call band_determinant(n, n, n, re, im, hill%static)
  end subroutine new_hill

  !> Everything that the solution x at frequency nu (rad/s) decides.
  subroutine along(self, system, nu, x)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu
    !> Harmonics, real and imaginary part by turns, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    real(wp) :: fastest, waves(0:(size(self%u, 1) - 1)/2)
    integer :: b, p

    call self%set_period(system, nu)
    call self%count_from(0.0_wp)
    call self%sample(system, x)
    if (.not. system%separable) then
      call variables_along(self, system, nu, x)
      if (system%moving) then
        call moving_along(self, system, nu, x)
      else
        call system%force_slopes(self%u, self%w, self%by_u, self%by_v)
      end if
    end if
    call find_rates(self, system, fastest, waves)
    if (system%n_rates() > 0) call take_mean_of_rates(self, system)
    self%ready = fastest <= max_unknowns*nu
    if (.not. self%ready) return
    call highest_order(system, self%kernel_of_group, nu, self%stride, fastest, waves, b)
    ! Waves of the damping reach further than those of the stiffness.
    if (system%n_rates() > 0) b = max(b, maxval(self%set%orders) + 2*self%stride)
    p = merge(b + 2, 2*b + 2, self%stride == 2)
    self%ready = p*self%n_dof <= max_unknowns
    if (.not. self%ready) return
    self%highest = b
    call fill(self, system, p)
  end subroutine along

  !> The divisors vanish at -a, left of a line along which exponents are counted.
  subroutine count_from(self, line)
    class(hill_type), intent(inout) :: self
    !> Re lambda of the line (1/s).
    real(wp), intent(in) :: line
    self%shift = 0.5_wp*self%period - line
  end subroutine count_from

  !> Highest order: beyond the fastest rate along the motion, and until a disturbance of order 1
  !! there hardly reaches the next,
  !!
  !!   Y_k = f_k sum_m |K_m| Y_(k - m)/[(k nu)^2 - f_k |K_0|],
  !!
  !! the stiffness K divided by the mass, and f_k what memory makes of it where that is more. What
  !! lies beyond acts on exponents by the square of that: there and back.
  subroutine highest_order(system, kernel_of_group, nu, stride, fastest, waves, highest)
    class(oscillator_type), intent(in) :: system
    !> Kernel of each group of hereditary variables; 0: none.
    integer, intent(in) :: kernel_of_group(:)
    !> Frequency (rad/s), from order to order, and the fastest rate (rad/s).
    real(wp), intent(in) :: nu, fastest
    integer, intent(in) :: stride
    !> Norms of K_m, orders stride m, m = 0, 1, ... (rad^2/s^2).
    real(wp), intent(in) :: waves(0:)
    !> Beyond `max_unknowns` where these are not enough.
    integer, intent(out) :: highest
    real(wp) :: reached(2*max_unknowns), beyond, more, before
    integer :: i, m, top

    top = findloc(waves(1:) > silent*waves(0), .true., 1, back=.true.)
    highest = ceiling(fastest/nu + 0.5_wp*stride)
    if (stride == 2 .and. mod(highest, 2) == 0) highest = highest + 1
    do while (highest <= max_unknowns)
      more = swelling(system, kernel_of_group, highest*nu)
      if (highest*nu >= fastest*sqrt(more)) exit
      highest = highest + stride
    end do
    if (highest > max_unknowns) return
    do i = 1, size(reached)
      beyond = ((highest + i*stride)*nu)**2 - more*waves(0)
      reached(i) = 0.0_wp
      do m = 1, top
        before = merge(reached(max(i - m, 1)), 1.0_wp, m < i)
        ! Of large motions it grows by factors for many orders.
        reached(i) = min(reached(i) + waves(m)*(more/beyond)*before, 1.0e100_wp)
      end do
      ! None of these reaches further.
      if (all(reached(max(i - top + 1, 1):i) <= accurate)) exit
    end do
    highest = highest + stride*findloc(reached(:min(i, size(reached))) > accurate, .true., 1, &
                                       back=.true.)
  end subroutine highest_order

  !> By how much memory makes a stiffness larger at a frequency (rad/s), 1 at least.
  real(wp) function swelling(system, kernel_of_group, nu) result(factor)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: kernel_of_group(:)
    real(wp), intent(in) :: nu
    complex(wp) :: s(1), kept(1)
    integer :: q

    s = cmplx(0.0_wp, nu, wp)
    factor = 1.0_wp
    do q = 1, size(kernel_of_group)
      if (kernel_of_group(q) == 0) cycle
      call system%kernels(kernel_of_group(q))%laplace(s, kept)
      factor = max(factor, abs(1.0_wp - kept(1)))
    end do
  end function swelling

  !> Norms of the Fourier coefficients of a matrix along a (half) period, m = 0, 1, ...
  subroutine norms_of_waves(phases, matrix, norms)
    !> exp(-2 pi i m/n)/n at m = 0, 1, ..., n - 1.
    complex(wp), intent(in) :: phases(0:)
    !> Shape (n_dof, n_dof, n).
    real(wp), intent(in) :: matrix(:, :, :)
    real(wp), intent(out) :: norms(0:)
    complex(wp) :: wave(size(matrix, 1), size(matrix, 2))
    integer :: m, s, n

    n = size(matrix, 3)
    do m = 0, ubound(norms, 1)
      wave = (0.0_wp, 0.0_wp)
      do s = 1, n
        wave = wave + matrix(:, :, s)*phases(modulo(m*(s - 1), n))
      end do
      norms(m) = norm(wave)
    end do
  end subroutine norms_of_waves

  !> A bound of how much longer a vector becomes: the smaller one of two.
  pure real(wp) function norm(matrix)
    complex(wp), intent(in) :: matrix(:, :)
    norm = min(maxval(sum(abs(matrix), 2)), sqrt(sum(abs(matrix)**2)))
  end function norm

  !> v along the solution, in w.
  subroutine variables_along(self, system, nu, x)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu, x(:, :)
    complex(wp) :: fraction(size(self%set%orders), size(self%w, 2)), z(size(self%set%orders))
    real(wp) :: parts(2*size(self%set%orders))
    integer :: j

    call system%retained(self%set%orders*nu, fraction)
    call system%deflection_remainder(self%u, self%w)
    do j = 1, size(self%w, 2)
      parts = matmul(x, system%gather(j, :))
      if (system%bent(j)) parts = parts + matmul(self%w(:, j), self%set%analysis)
      z = fraction(:, j)*cmplx(parts(1::2), parts(2::2), wp)
      parts(1::2) = real(z)
      parts(2::2) = aimag(z)
      self%w(:, j) = matmul(parts, self%set%synthesis)
    end do
  end subroutine variables_along

  !> Slopes of a system whose forces depend on rates and loads.
  subroutine moving_along(self, system, nu, x)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu, x(:, :)
    real(wp) :: acceleration(size(self%u, 1), self%n_dof), parts(size(x, 1))
    integer :: b

    do b = 1, self%n_dof
      parts(1::2) = -self%set%orders*nu*x(2::2, b)
      parts(2::2) = self%set%orders*nu*x(1::2, b)
      self%rate(:, b) = matmul(parts, self%set%synthesis)
      parts(1::2) = -(self%set%orders*nu)**2*x(1::2, b)
      parts(2::2) = -(self%set%orders*nu)**2*x(2::2, b)
      acceleration(:, b) = matmul(parts, self%set%synthesis)
    end do
    call system%load_along(self%u, self%rate, acceleration, self%w, self%push)
    call system%moving_slopes(self%u, self%rate, self%w, self%push, self%by_u, self%by_rate, &
                              self%by_v)
  end subroutine moving_along

  !> An upper bound of frequencies and rates of damping along the solution (rad/s), the trace of
  !! the damping, and how large the waves of the stiffness are.
  subroutine find_rates(self, system, fastest, waves)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(out) :: fastest
    !> Norms of its Fourier coefficients of orders stride m, m = 0, 1, ... (rad^2/s^2).
    real(wp), intent(out) :: waves(0:)
    real(wp) :: stiffness(self%n_dof, self%n_dof, size(self%u, 1))
    real(wp) :: force(self%n_dof, size(self%w, 2)), slope(size(self%w, 2), self%n_dof)
    real(wp) :: scale(self%n_dof, self%n_dof), damping(self%n_dof, self%n_dof), largest, strongest
    integer :: a, b, j, s

    do b = 1, self%n_dof
      do a = 1, self%n_dof
        scale(a, b) = sqrt(system%mass(a, a)/system%mass(b, b))
      end do
    end do
    largest = 0.0_wp
    strongest = 0.0_wp
    self%drag = 0.0_wp
    do s = 1, size(self%u, 1)
      force = system%spread + self%by_v(s, :, :)
      slope = system%gather
      do b = 1, size(self%w, 2)
        if (system%bent(b)) slope(b, :) = slope(b, :) + self%slopes(s, b, :)
      end do
      stiffness(:, :, s) = scale*matmul(self%inverse, matmul(force, slope) + self%by_u(s, :, :))
      largest = max(largest, norm(cmplx(stiffness(:, :, s), 0.0_wp, wp)))
      damping = self%linear_damping + matmul(self%inverse, self%by_rate(s, :, :))
      do b = 1, system%n_rates()
        do j = 1, size(self%w, 2)
          if (.not. system%bent(j)) cycle
          damping(:, system%rates(b)) = damping(:, system%rates(b)) &
                                        + self%spread(:, j)*self%slopes(s, j, self%n_dof + b)
        end do
      end do
      strongest = max(strongest, maxval(sum(abs(scale*damping), 2)))
      do b = 1, self%n_dof
        self%drag = self%drag + damping(b, b)/size(self%u, 1)
      end do
    end do
    fastest = sqrt(largest) + strongest
    call norms_of_waves(self%waves, stiffness, waves)
  end subroutine find_rates

  !> C with the mean of what depends on rates and has no memory.
  subroutine take_mean_of_rates(self, system)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer :: b, j

    self%damping = self%linear_damping
    do b = 1, system%n_rates()
      do j = 1, size(self%w, 2)
        if (.not. system%bent(j) .or. system%kernel_of(j) > 0) cycle
        self%damping(:, system%rates(b)) = self%damping(:, system%rates(b)) + self%spread(:, j) &
                                           *(sum(self%slopes(:, j, self%n_dof + b)) &
                                             /size(self%slopes, 1))
      end do
    end do
  end subroutine take_mean_of_rates

  !> The rest of what depends on rates, for p orders.
  subroutine fill_dampers(self, system, p)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: p
    complex(wp) :: c(-p:p)
    integer :: b, j, q

    call allocate_waves(self, p, self%dampers)
    do j = 1, size(self%w, 2)
      if (.not. system%bent(j)) cycle
      q = self%group(j)
      do b = 1, system%n_rates()
        call moments_of(self%waves, .true., self%slopes(:, j, self%n_dof + b), 0.0_wp, c)
        if (system%kernel_of(j) == 0) c(0) = (0.0_wp, 0.0_wp)
        call add_waves(self%spread(:, j), c, self%dampers(:, -p:p, system%rates(b), q, :))
      end do
    end do
  end subroutine fill_dampers

  !> Fourier coefficients of no wave, for p orders.
  subroutine allocate_waves(self, p, waves)
    class(hill_type), intent(in) :: self
    integer, intent(in) :: p
    real(wp), allocatable, intent(inout) :: waves(:, :, :, :, :)

    if (allocated(waves)) then
      if (ubound(waves, 2) == p) then
        waves = 0.0_wp
        return
      end if
      deallocate (waves)
    end if
    allocate (waves(self%n_dof, -p:p, self%n_dof, size(self%kernel_of_group), 2), source=0.0_wp)
  end subroutine allocate_waves

  !> The parts of the matrix for p orders.
  subroutine fill(self, system, p)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: p
    complex(wp) :: c(-p:p)
    integer :: b, j, n, m

    n = self%n_dof
    m = size(self%w, 2)
    self%n_orders = p
    if (system%n_rates() > 0) call fill_dampers(self, system, p)
    if (system%separable) then
      call allocate_waves(self, p, self%springs)
      do j = 1, m
        do b = 1, n
          call moments_of(self%waves, system%bent(j), self%slopes(:, j, b), system%gather(j, b), c)
          call add_waves(self%spread(:, j), c, self%springs(:, -p:p, b, self%group(j), :))
        end do
      end do
      call reach_of_springs(self, system)
      return
    end if
    call fill_products(self, system, p)
  end subroutine fill

  !> How far springs and dampers couple orders.
  subroutine reach_of_springs(self, system)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp) :: size_of(self%n_dof), scale(self%n_dof)
    integer :: a, q

    self%reach = 0
    do a = 1, self%n_dof
      scale(a) = sqrt(system%mass(a, a))
      size_of(a) = sqrt(maxval(abs(self%springs(a, :, a, :, :))))
    end do
    do q = 1, size(self%kernel_of_group)
      self%reach = max(self%reach, reach_of(of_group(self%springs, q), size_of/scale, &
                                            size_of*scale))
      if (system%n_rates() == 0) cycle
      self%reach = max(self%reach, reach_of(of_group(self%dampers, q), sqrt(size_of)/scale, &
                                            sqrt(size_of)*scale))
    end do
  end subroutine reach_of_springs

  !> Fourier coefficients of a group for the orders 0, 1, ...
  pure function of_group(waves, q)
    real(wp), intent(in) :: waves(:, :, :, :, :)
    integer, intent(in) :: q
    complex(wp) :: of_group(size(waves, 1), size(waves, 1), 0:size(waves, 2)/2)
    integer :: k, p

    p = size(waves, 2)/2
    do k = 0, p
      of_group(:, :, k) = cmplx(waves(:, p + 1 + k, :, q, 1), waves(:, p + 1 + k, :, q, 2), wp)
    end do
  end function of_group

  !> What varies along the solution where F(u, v) is not separable, for p orders.
  subroutine fill_products(self, system, p)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: p
    complex(wp) :: outer(self%n_dof, size(self%w, 2), -p:p)
    real(wp) :: at_rest(self%n_dof, self%n_dof), size_of(self%n_dof), scale(self%n_dof)
    real(wp) :: of_outer(0:p), of_inner(0:p), largest(2)
    integer :: a, j, n, m

    n = self%n_dof
    m = size(self%w, 2)
    if (allocated(self%outer)) then
      if (ubound(self%inner, 3) /= p) deallocate (self%outer, self%inner, self%direct, self%swept)
    end if
    if (.not. allocated(self%outer)) then
      allocate (self%outer(n, -p:p, m, 2), self%inner(m, n, -p:p), self%direct(n, n, -p:p))
      allocate (self%swept(merge(n, 0, system%moving), n, -p:p))
    end if
    do a = 1, n
      do j = 1, m
        call moments_of(self%waves, .true., matmul(self%by_v(:, :, j), self%inverse(a, :)), &
                        self%spread(a, j), outer(a, j, :))
        call moments_of(self%waves, system%bent(j), self%slopes(:, j, a), system%gather(j, a), &
                        self%inner(j, a, :))
      end do
      do j = 1, n
        call moments_of(self%waves, .true., matmul(self%by_u(:, :, j), self%inverse(a, :)), &
                        0.0_wp, self%direct(a, j, :))
        if (.not. system%moving) cycle
        call moments_of(self%waves, .true., matmul(self%by_rate(:, :, j), self%inverse(a, :)), &
                        0.0_wp, self%swept(a, j, :))
      end do
    end do
    scale = [(sqrt(system%mass(j, j)), j=1, n)]
    at_rest = real(matmul(outer(:, :, 0), self%inner(:, :, 0)) + self%direct(:, :, 0))
    size_of = [(sqrt(abs(at_rest(j, j))), j=1, n)]
    self%reach = reach_of(self%direct(:, :, 0:), size_of/scale, size_of*scale)
    if (system%moving) then
      size_of = sqrt(size_of)
      self%reach = max(self%reach, reach_of(self%swept(:, :, 0:), size_of/scale, size_of*scale))
    end if
    ! Each variable has its own unit.
    of_outer = 0.0_wp
    of_inner = 0.0_wp
    do j = 1, m
      self%outer(:, :, j, 1) = real(outer(:, j, :))
      self%outer(:, :, j, 2) = aimag(outer(:, j, :))
      associate (b => matmul(scale, abs(outer(:, j, 0:))), &
                 w => matmul(1.0_wp/scale, abs(self%inner(j, :, 0:))))
        largest = [maxval(b), maxval(w)]
        if (.not. minval(largest) > 0.0_wp) cycle
        of_outer = max(of_outer, b/largest(1))
        of_inner = max(of_inner, w/largest(2))
      end associate
    end do
    self%widths = widths_of(of_outer, of_inner)
    do j = 0, p
      if (self%widths(j + 1) >= 0) self%reach = max(self%reach, min(p, j + self%widths(j + 1)))
    end do
  end subroutine fill_products

  !> The divisors vanish at -a modulo i d, or at -a + i d/2.
  subroutine without_poles(self, lambda, value)
    class(hill_type), intent(in) :: self
    complex(wp), intent(in) :: lambda
    complex(wp), intent(inout) :: value
    value = value*(1.0_wp - merge(-1, 1, self%stride == 2) &
                   *exp(-2.0_wp*pi/self%period*(self%shift + lambda)))**(2*self%n_dof)
  end subroutine without_poles

  !> s^2 M + s C + B [1 - R(s)] W: the system at rest.
  subroutine mean_system(self, system, s, matrix)
    class(hill_type), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: s
    real(wp), allocatable, intent(out) :: matrix(:, :)
    complex(wp) :: kept(1, size(self%kernel_of_group))
    integer :: i, j

    kept = retained_of(system, self%kernel_of_group, [cmplx(s, 0.0_wp, wp)])
    allocate (matrix, source=s**2*system%mass + s*system%damping)
    do j = 1, size(self%group)
      do i = 1, self%n_dof
        matrix(:, i) = matrix(:, i) + real(kept(1, self%group(j))) &
                       *system%spread(:, j)*system%gather(j, i)
      end do
    end do
  end subroutine mean_system

  !> The determinant with the factor of the orders left out.
  subroutine on_line(self, system, lambda, value)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: lambda
    complex(wp), intent(out) :: value
    call self%determinant(system, lambda, value, .false.)
    value = value*tail(self, lambda)
  end subroutine on_line

  !> The root s = lambda + i k nu of a linear system for an exponent lambda: orders k are not
  !! coupled, so one of them alone has a determinant of 0. NaN if this is not clear.
  subroutine root_of(self, system, lambda, root)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: lambda
    complex(wp), intent(out) :: root
    complex(wp) :: value
    real(wp) :: size_of, least, second
    integer :: k

    root = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
    least = huge(least)
    second = huge(second)
    do k = -self%highest, self%highest, self%stride
      call self%of_orders(system, 1, k, lambda, value)
      size_of = abs(value)
      second = min(second, max(least, size_of))
      if (.not. size_of < least) cycle
      least = size_of
      root = lambda + cmplx(0.0_wp, k*self%nu, wp)
    end do
    if (.not. least < clear*second) root = cmplx(ieee_value(0.0_wp, ieee_quiet_nan), 0.0_wp, wp)
  end subroutine root_of

  !> Factor of the orders left out of the determinant, of 1 + (trace(M^(-1) C) - 2 a n)/s_k,
  !! summed over them by the midpoint rule.
  pure complex(wp) function tail(hill, lambda)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: lambda
    complex(wp) :: omega
    real(wp) :: edge, excess

    excess = hill%drag - 2.0_wp*hill%shift*hill%n_dof
    edge = (hill%highest + 0.5_wp*hill%stride)*hill%nu
    omega = cmplx(aimag(lambda), -real(lambda), wp)
    tail = exp(cmplx(0.0_wp, excess/hill%period, wp)*plain_logarithm((edge + omega)/(edge - omega)))
  end function tail

  !> The determinant of the p highest orders, from the lowest of these.
  subroutine of_orders(self, system, p, lowest, lambda, value)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: p, lowest
    complex(wp), intent(in) :: lambda
    complex(wp), intent(out) :: value
    real(wp) :: h(self%n_dof, p, self%n_dof, p, 2)
    complex(wp), dimension(p) :: s, scale
    complex(wp) :: kept(p, size(self%kernel_of_group)), own(p, size(self%group)), entry
    integer :: a, b, i, n, q, all

    n = self%n_dof
    do i = 1, p
      s(i) = lambda + cmplx(0.0_wp, (lowest + (i - 1)*self%stride)*self%nu, wp)
    end do
    scale = 1.0_wp/(s + self%shift)**2
    kept = retained_of(system, self%kernel_of_group, s)
    all = self%n_orders
    if (system%separable) then
      do q = 1, size(kept, 2)
        kept(:, q) = scale*kept(:, q)
      end do
      call fill_waves(p, n, size(kept, 2), all, self%reach, kept, self%springs, h)
      if (system%n_rates() > 0) then
        call fill_waves(p, n, size(kept, 2), all, self%reach, kept, self%dampers, h, s)
      end if
    else
      h = 0.0_wp
      own = kept(:, self%group)
      call add_products(p, n, size(self%group), all, self%widths, own, self%outer, self%inner, h)
      call add_columns(p, n, all, self%reach, spread((1.0_wp, 0.0_wp), 1, p), self%direct, h)
      if (system%moving) call add_columns(p, n, all, self%reach, s, self%swept, h)
      call scale_rows(p, n, self%reach, scale, h)
    end if
    do b = 1, n
      do a = 1, n
        do i = 1, p
          entry = scale(i)*s(i)*(self%damping(a, b) + merge(s(i), (0.0_wp, 0.0_wp), a == b))
          h(a, i, b, i, 1) = h(a, i, b, i, 1) + real(entry)
          h(a, i, b, i, 2) = h(a, i, b, i, 2) + aimag(entry)
        end do
      end do
    end do
    call band_determinant(n*p, n*p, min(n*(self%reach + 1) - 1, n*p), h(:, :, :, :, 1), &
                          h(:, :, :, :, 2), value)
  end subroutine of_orders

end module viscovib_hill
