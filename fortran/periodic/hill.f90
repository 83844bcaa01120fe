!> Hill's determinant of a periodic solution, memory included.
!!
!! A small disturbance y = exp(lambda t) sum_k Y_k exp(i k nu t) of a periodic
!! solution obeys, with s_k = lambda + i k nu, f_j(s) = 1 - epsilon_1 R_j(s) and
!! Laplace transforms R_j of the kernels,
!!
!!   (s_k^2 M + s_k C) Y_k + sum_l A_(k-l) Y_l
!!     + sum_j sum_m b_j,(k-m) f_j(s_m) sum_l w_j,(m-l) Y_l = 0,
!!
!! w_j, b_j and A the Fourier coefficients of dw_j/du, dF/dv_j and dF/du along the
!! solution (Hill, Acta Math. 8 (1886) 1, for equations without memory). Everything
!! is multiplied by M^(-1) and divided by (s_k + a)^2, so that the determinant tends
!! to a periodic function of lambda with period i d that has no poles where
!! Re lambda >= 0 and no winding at large Re lambda. d is nu; under half-wave
!! symmetry slopes have half the period, odd orders k stand for themselves, and d is
!! 2 nu. exp(2 pi lambda/d) are the multipliers of `viscovib_floquet`, h of half a
!! period under half-wave symmetry.
module viscovib_hill
  use viscovib_constants, only: pi
  use viscovib_dense, only: invert
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: hill_type, new_hill

  !> Unknowns of a determinant at most.
  integer, parameter :: max_unknowns = 240
  !> Degree of a force that stands for one that is no polynomial: how many samples.
  integer, parameter :: as_degree = 11

  type :: hill_type
    !> d: exponents matter modulo i d (rad/s).
    real(wp) :: period = 0.0_wp
    !> a, > 0: exponents are sought right of -a.
    real(wp) :: shift = 0.0_wp
    integer :: n_dof = 0
    !> Highest order of the disturbance, and the step from order to order.
    integer :: highest = 0, stride = 1
    !> Whether `along` found a determinant of reasonable size.
    logical :: ready = .false.
    real(wp), private :: nu = 0.0_wp
    type(harmonic_set_type), private :: set
    !> M^(-1), M^(-1) C and M^(-1) B.
    real(wp), allocatable, private :: inverse(:, :), damping(:, :), spread(:, :)
    !> Kernel of each group of hereditary variables; 0: none.
    integer, allocatable, private :: kernel_of_group(:)
    !> Parts of the matrix that each group multiplies, row by row.
    complex(wp), allocatable, private :: springs(:, :, :)
    !> Where F(u, v) is not separable: b, w and A.
    complex(wp), allocatable, private :: outer(:, :), inner(:, :), direct(:, :)
    !> exp(-2 pi i m/n)/n at m = 0, 1, ..., n samples.
    complex(wp), allocatable, private :: waves(:)
    real(wp), allocatable, private :: u(:, :), w(:, :), slopes(:, :, :), by_u(:, :, :)
    real(wp), allocatable, private :: by_v(:, :, :)
  contains
    procedure :: along
    procedure :: determinant
    procedure :: tail
  end type hill_type

contains

  !> For solutions with the harmonics of `set`.
  subroutine new_hill(hill, system, set)
    type(hill_type), intent(out) :: hill
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    complex(wp) :: inverse(size(system%mass, 1), size(system%mass, 1))
    logical :: singular
    integer :: j, q, n, m, s

    n = system%n_dof()
    m = system%n_memory()
    hill%n_dof = n
    hill%stride = merge(2, 1, set%half_wave)
    call invert(cmplx(system%mass, 0.0_wp, wp), inverse, singular)
    hill%inverse = real(inverse)
    hill%damping = matmul(hill%inverse, system%damping)
    hill%spread = matmul(hill%inverse, system%spread)
    ! Slopes of a polynomial of degree g reach the order (g - 1) K.
    call new_harmonic_set(hill%set, maxval(set%orders), set%half_wave, &
                          merge(max(2*system%degree - 3, 3), as_degree, system%degree > 0))
    s = hill%set%n_samples
    allocate (hill%u(s, n), hill%w(s, m), hill%slopes(s, m, n), hill%by_u(s, n, n), &
              hill%by_v(s, n, m), source=0.0_wp)
    allocate (hill%waves(0:s - 1))
    do j = 0, s - 1
      hill%waves(j) = cmplx(cos(2.0_wp*pi*j/s), -sin(2.0_wp*pi*j/s), wp)/s
    end do
    allocate (hill%kernel_of_group(0))
    do j = 1, m
      q = system%kernel_of(j)
      if (.not. any(hill%kernel_of_group == q)) hill%kernel_of_group = [hill%kernel_of_group, q]
    end do
  end subroutine new_hill

  !> Everything that the solution x at frequency nu (rad/s) decides.
  subroutine along(self, system, nu, x)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu
    !> Harmonics, real and imaginary part by turns, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    real(wp) :: fastest
    integer :: b, p

    self%nu = nu
    self%period = self%stride*nu
    self%shift = 0.5_wp*self%period
    do b = 1, self%n_dof
      self%u(:, b) = matmul(x(:, b), self%set%synthesis)
    end do
    if (any(system%bent)) call system%deflection_slopes(self%u, self%slopes)
    if (.not. system%separable) then
      call variables_along(self, system, nu, x)
      call system%force_slopes(self%u, self%w, self%by_u, self%by_v)
    end if
    ! Orders beyond the fastest mode along the motion, and some more.
    fastest = fastest_rate(self, system)
    self%ready = fastest <= max_unknowns*nu
    if (.not. self%ready) return
    b = ceiling(fastest/nu + 1.5_wp*self%stride)
    if (self%stride == 2 .and. mod(b, 2) == 0) b = b + 1
    b = max(b, maxval(self%set%orders) + 2*self%stride)
    p = merge(b + 1, 2*b + 1, self%stride == 2)
    self%ready = p*self%n_dof <= max_unknowns
    if (.not. self%ready) return
    self%highest = b
    call fill(self, system, p)
  end subroutine along

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

  !> An upper bound of frequencies and rates of damping along the solution (rad/s).
  real(wp) function fastest_rate(self, system)
    class(hill_type), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    real(wp) :: stiffness(self%n_dof, self%n_dof), force(self%n_dof, size(self%w, 2))
    real(wp) :: slope(size(self%w, 2), self%n_dof), scale(self%n_dof, self%n_dof), largest
    integer :: a, b, s

    do b = 1, self%n_dof
      do a = 1, self%n_dof
        scale(a, b) = sqrt(system%mass(a, a)/system%mass(b, b))
      end do
    end do
    largest = 0.0_wp
    do s = 1, size(self%u, 1)
      force = system%spread + self%by_v(s, :, :)
      slope = system%gather
      do b = 1, size(self%w, 2)
        if (system%bent(b)) slope(b, :) = slope(b, :) + self%slopes(s, b, :)
      end do
      stiffness = matmul(self%inverse, matmul(force, slope) + self%by_u(s, :, :))
      largest = max(largest, maxval(sum(abs(scale*stiffness), 2)))
    end do
    fastest_rate = sqrt(largest) + maxval(sum(abs(scale*self%damping), 2))
  end function fastest_rate

  !> The parts of the matrix for p orders.
  subroutine fill(self, system, p)
    class(hill_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: p
    complex(wp) :: c(-p:p)
    integer :: a, b, j, n, m, q

    n = self%n_dof
    m = size(self%w, 2)
    if (allocated(self%springs)) then
      if (size(self%springs, 1) /= p*n) deallocate (self%springs)
    end if
    if (.not. allocated(self%springs)) then
      allocate (self%springs(p*n, p*n, size(self%kernel_of_group)))
    end if
    self%springs = (0.0_wp, 0.0_wp)
    if (system%separable) then
      do j = 1, m
        q = findloc(self%kernel_of_group, system%kernel_of(j), 1)
        do b = 1, n
          call moments_of(self, system%bent(j), self%slopes(:, j, b), system%gather(j, b), c)
          do a = 1, n
            call add_toeplitz(self%spread(a, j)*c, a, b, n, n, self%springs(:, :, q))
          end do
        end do
      end do
      return
    end if
    self%outer = reshape([complex(wp) ::], [p*n, p*m], pad=[(0.0_wp, 0.0_wp)])
    self%inner = reshape([complex(wp) ::], [p*m, p*n], pad=[(0.0_wp, 0.0_wp)])
    self%direct = reshape([complex(wp) ::], [p*n, p*n], pad=[(0.0_wp, 0.0_wp)])
    do a = 1, n
      do j = 1, m
        call moments_of(self, .true., matmul(self%by_v(:, :, j), self%inverse(a, :)), &
                        self%spread(a, j), c)
        call add_toeplitz(c, a, j, n, m, self%outer)
        call moments_of(self, system%bent(j), self%slopes(:, j, a), system%gather(j, a), c)
        call add_toeplitz(c, j, a, m, n, self%inner)
      end do
      do b = 1, n
        call moments_of(self, .true., matmul(self%by_u(:, :, b), self%inverse(a, :)), 0.0_wp, c)
        call add_toeplitz(c, a, b, n, n, self%direct)
      end do
    end do
  end subroutine fill

  !> Fourier coefficients of a constant and a slope, of orders stride times the index.
  pure subroutine moments_of(self, varies, slope, constant, c)
    class(hill_type), intent(in) :: self
    logical, intent(in) :: varies
    real(wp), intent(in) :: slope(:), constant
    !> Orders -p to p.
    complex(wp), intent(out) :: c(:)
    complex(wp) :: total
    integer :: m, s, p, n

    n = size(slope)
    p = size(c)/2
    c = (0.0_wp, 0.0_wp)
    if (varies) then
      ! Samples resolve the orders below half their number over a (half) period.
      do m = 0, min(p, (n - 1)/2)
        total = (0.0_wp, 0.0_wp)
        do s = 1, n
          total = total + slope(s)*self%waves(modulo(m*(s - 1), n))
        end do
        c(p + 1 + m) = total
        c(p + 1 - m) = conjg(total)
      end do
    end if
    c(p + 1) = c(p + 1) + constant
  end subroutine moments_of

  !> Products with a periodic factor of row a and column b: entries c(i - l).
  pure subroutine add_toeplitz(c, a, b, rows, columns, matrix)
    complex(wp), intent(in) :: c(:)
    integer, intent(in) :: a, b, rows, columns
    complex(wp), intent(inout) :: matrix(:, :)
    integer :: i, l, p

    p = size(c)/2
    do l = 1, p
      do i = 1, p
        associate (entry => matrix((i - 1)*rows + a, (l - 1)*columns + b))
          entry = entry + c(p + 1 + i - l)
        end associate
      end do
    end do
  end subroutine add_toeplitz

  !> The determinant at lambda; not to be asked for on a cut of a kernel or at -a.
  subroutine determinant(self, system, lambda, value)
    class(hill_type), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: lambda
    complex(wp), intent(out) :: value
    complex(wp) :: h(size(self%springs, 1), size(self%springs, 1))
    complex(wp) :: s(size(self%springs, 1)/self%n_dof), scale(size(s))
    complex(wp) :: kept(size(s), size(self%kernel_of_group)), right(size(self%w, 2)*size(s), &
                                                                    size(h, 1))
    integer :: a, b, i, j, l, n, m, q, row

    n = self%n_dof
    m = size(self%w, 2)
    do i = 1, size(s)
      s(i) = lambda + cmplx(0.0_wp, ((i - 1)*self%stride - self%highest)*self%nu, wp)
    end do
    scale = 1.0_wp/(s + self%shift)**2
    kept = (1.0_wp, 0.0_wp)
    do q = 1, size(self%kernel_of_group)
      if (self%kernel_of_group(q) == 0) cycle
      call system%kernels(self%kernel_of_group(q))%kernel%laplace(s, kept(:, q))
      kept(:, q) = 1.0_wp - system%memory_scale*kept(:, q)
    end do
    if (system%separable) then
      do l = 1, size(h, 1)
        do i = 1, size(s)
          do a = 1, n
            row = (i - 1)*n + a
            h(row, l) = kept(i, 1)*self%springs(row, l, 1)
            do q = 2, size(kept, 2)
              h(row, l) = h(row, l) + kept(i, q)*self%springs(row, l, q)
            end do
          end do
        end do
      end do
    else
      do i = 1, size(s)
        do j = 1, m
          row = (i - 1)*m + j
          right(row, :) = kept(i, findloc(self%kernel_of_group, system%kernel_of(j), 1)) &
                          *self%inner(row, :)
        end do
      end do
      h = self%direct + matmul(self%outer, right)
    end if
    do i = 1, size(s)
      l = (i - 1)*n
      do b = 1, n
        do a = 1, n
          h(l + a, l + b) = h(l + a, l + b) + s(i)*self%damping(a, b)
        end do
        h(l + b, l + b) = h(l + b, l + b) + s(i)**2
      end do
    end do
    do l = 1, size(h, 1)
      do i = 1, size(s)
        h((i - 1)*n + 1:i*n, l) = scale(i)*h((i - 1)*n + 1:i*n, l)
      end do
    end do
    call eliminate(size(h, 1), h, value)
  end subroutine determinant

  !> Determinant by elimination, rows exchanged for the largest pivot.
  pure subroutine eliminate(n, h, value)
    integer, intent(in) :: n
    complex(wp), intent(inout) :: h(n, n)
    complex(wp), intent(out) :: value
    complex(wp) :: factor, row(n)
    real(wp) :: largest, here
    integer :: i, j, k, p

    value = (1.0_wp, 0.0_wp)
    do k = 1, n
      p = k
      largest = abs(real(h(k, k))) + abs(aimag(h(k, k)))
      do i = k + 1, n
        here = abs(real(h(i, k))) + abs(aimag(h(i, k)))
        if (here > largest) then
          largest = here
          p = i
        end if
      end do
      value = value*h(p, k)
      if (.not. largest > 0.0_wp) return
      if (p /= k) then
        value = -value
        row(k:) = h(p, k:)
        h(p, k:) = h(k, k:)
        h(k, k:) = row(k:)
      end if
      factor = 1.0_wp/h(k, k)
      do i = k + 1, n
        h(i, k) = h(i, k)*factor
      end do
      do j = k + 1, n
        factor = h(k, j)
        if (.not. abs(real(factor)) + abs(aimag(factor)) > 0.0_wp) cycle
        do i = k + 1, n
          h(i, j) = h(i, j) - h(i, k)*factor
        end do
      end do
    end do
  end subroutine eliminate

  !> Phase at i omega of the orders left out of the determinant: of
  !! 1 + (trace(M^(-1) C) - 2 a n)/s_k, summed over them by the midpoint rule.
  pure real(wp) function tail(self, omega)
    class(hill_type), intent(in) :: self
    real(wp), intent(in) :: omega
    real(wp) :: edge, excess
    integer :: a

    excess = -2.0_wp*self%shift*self%n_dof
    do a = 1, self%n_dof
      excess = excess + self%damping(a, a)
    end do
    edge = (self%highest + 0.5_wp*self%stride)*self%nu
    tail = excess/self%period*log((edge + omega)/(edge - omega))
  end function tail

end module viscovib_hill
