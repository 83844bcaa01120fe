! Optimize: -O3
!> What all forms of Hill's determinant of a periodic solution have in common, and factors of zeros.
!!
!! A small disturbance exp(lambda t) sum_k Y_k exp(i k nu t) of the solution obeys linear equations
!! for the Y_k, with s_k = lambda + i k nu. Their determinant has the period i d in lambda. d is nu;
!! under half-wave symmetry slopes have half the period, odd orders k stand for themselves, and d is
!! 2 nu.
!!
!! Exponents of memory itself are near a rate -r at which memory fades: there what a kernel R leaves
!! of a spring, 1 - R(s), vanishes, or somewhat left of it if other springs remember less. They are
!! real, or at i d/2 where orders are odd.
module viscovib_hill_determinant
  use viscovib_band_elimination, only: band_determinant
  use viscovib_constants, only: pi
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_slope_waves, only: hold_waves
  implicit none
  private

  public :: gap, gap_list, hill_determinant, into_strip, new_gaps, retained_of

  !> Slowest growth that is seen where a kernel has no integral, in d.
  real(wp), parameter, public :: slow = 1.0e-12_wp
  !> Gaps smaller than this need care with rounding errors.
  real(wp), parameter :: small_gap = 1.0e-2_wp
  !> Exponents of memory itself are no faster, in nu.
  real(wp), parameter :: widest = 100.0_wp
  !> How much of the stiffness remembers.
  real(wp), parameter :: parts(2) = [1.0_wp, 0.3_wp]

  type, abstract :: hill_determinant
    !> Frequency, and d: exponents matter modulo i d (rad/s).
    real(wp) :: nu = 0.0_wp, period = 0.0_wp
    !> From order to order; 2 under half-wave symmetry.
    integer :: stride = 1
    !> Coordinates, or deflections of a condensed structure.
    integer :: n_dof = 0
    !> Orders of a perturbation, with the one below the lowest. They reach from -highest to highest,
    !! which mirrors them about Im lambda = 0; with the one below they are mirrored about d/2.
    integer :: n_orders = 0, highest = 0
    !> Largest difference of orders that the slopes couple.
    integer :: reach = 0
    !> Harmonics of the motion with the samples of its slopes, exp(-2 pi i m/n)/n at m = 0, 1, ...,
    !! n samples, and deflections and rates with the slopes of all variables at the samples.
    type(harmonic_set_type) :: set
    complex(wp), allocatable :: waves(:)
    real(wp), allocatable :: u(:, :), slopes(:, :, :)
    !> True if the determinant of a motion is known and of reasonable size.
    logical :: ready = .false.
    !> Exponents that a motion has without memory in |Im lambda| <= d/2; huge: not known.
    integer :: n_without_memory = huge(1)
    !> Exponents right of the line of a count that are no zeros of the determinant.
    integer :: n_apart = 0
    !> True if some kernel is in use, if one of them has no integral, and if relaxed springs push:
    !! some perturbations may grow slowly.
    logical :: remembers = .false., creeps = .false., pushes = .false.
    !> Kernel of each group of hereditary variables, 0: none; group of each variable.
    integer, allocatable :: kernel_of_group(:), group(:)
    !> Static stiffness of each group at rest, shape (n, n, groups), and the determinant of all of
    !! it; 0: not known.
    real(wp), allocatable :: springs_at_rest(:, :, :)
    complex(wp) :: static = (0.0_wp, 0.0_wp)
    !> Width of the interval of a line next to the singularity of memory at first, at most (rad/s).
    real(wp) :: finest = huge(1.0_wp)
    !> The slowest rate at which memory fades (1/s).
    real(wp) :: fading = huge(1.0_wp)
    !> Where memory alone would relax (rad/s, < 0).
    real(wp), allocatable :: relaxing(:)
  contains
    procedure(of_orders_interface), deferred :: of_orders
    procedure(without_poles_interface), deferred :: without_poles
    procedure(on_line_interface), deferred :: on_line
    procedure(mean_interface), deferred :: mean_system
    procedure :: determinant
    procedure :: determinant_from_place
    procedure :: prepare
    procedure :: sample
    procedure :: set_period
    procedure :: relaxation
  end type hill_determinant

  abstract interface

    !> The determinant of the p highest orders, from the lowest of these.
    subroutine of_orders_interface(self, system, p, lowest, lambda, value)
      import :: hill_determinant, oscillator_type, wp
      class(hill_determinant), intent(inout) :: self
      class(oscillator_type), intent(in) :: system
      integer, intent(in) :: p, lowest
      complex(wp), intent(in) :: lambda
      complex(wp), intent(out) :: value
    end subroutine of_orders_interface

    !> Multiply a determinant by factors that vanish at its poles.
    subroutine without_poles_interface(self, lambda, value)
      import :: hill_determinant, wp
      class(hill_determinant), intent(in) :: self
      complex(wp), intent(in) :: lambda
      complex(wp), intent(inout) :: value
    end subroutine without_poles_interface

    !> The determinant on a line Re lambda = constant from Im lambda = 0 to d/2.
    subroutine on_line_interface(self, system, lambda, value)
      import :: hill_determinant, oscillator_type, wp
      class(hill_determinant), intent(inout) :: self
      class(oscillator_type), intent(in) :: system
      complex(wp), intent(in) :: lambda
      complex(wp), intent(out) :: value
    end subroutine on_line_interface

    !> A matrix that is singular at rates s of growth (1/s, real and positive) where stiffness does
    !! not vary.
    subroutine mean_interface(self, system, s, matrix)
      import :: hill_determinant, oscillator_type, wp
      class(hill_determinant), intent(in) :: self
      class(oscillator_type), intent(in) :: system
      real(wp), intent(in) :: s
      real(wp), allocatable, intent(out) :: matrix(:, :)
    end subroutine mean_interface

  end interface

  !> Factors 1 - exp(2 pi (p_k - lambda)/d) of some p_k.
  type :: gap_list
    !> 2 pi/d, 2 pi p_k/d and the exponential of this.
    real(wp), private :: scale = 0.0_wp
    complex(wp), allocatable, private :: place(:), wave(:)
  contains
    procedure :: multiply
    procedure :: divide
    procedure, private :: at
  end type gap_list

contains

  !> For motions with the harmonics of `set`.
  subroutine prepare(self, system, set, degree)
    class(hill_determinant), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    !> Degree of the forces of which the slopes are sampled.
    integer, intent(in) :: degree
    integer :: j, s

    self%n_dof = system%n_dof()
    self%stride = merge(2, 1, set%half_wave)
    ! Slopes of a polynomial of degree g reach the order (g - 1) K.
    call new_harmonic_set(self%set, maxval(set%orders), set%half_wave, degree)
    s = self%set%n_samples
    allocate (self%u(s, self%n_dof + system%n_rates()), &
              self%slopes(s, system%n_memory(), self%n_dof + system%n_rates()), source=0.0_wp)
    allocate (self%waves(0:s - 1))
    do j = 0, s - 1
      self%waves(j) = cmplx(cos(2.0_wp*pi*j/s), -sin(2.0_wp*pi*j/s), wp)/s
    end do
    call find_memory(self, system)
  end subroutine prepare

  !> Deflections and slopes along a motion of the present frequency.
  subroutine sample(self, system, x)
    class(hill_determinant), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    !> Harmonics, real and imaginary part by turns, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    call self%set%sample(self%nu, x, self%u, system%rates)
    if (any(system%bent)) call system%deflection_slopes(self%u, self%slopes)
    call hold_waves(system, self%set, self%set%orders*self%nu, x, self%u, self%slopes)
  end subroutine sample

  !> The determinant at lambda, without poles where exponents are sought. It tends to a constant far
  !! to the right. Not on a cut of a kernel.
  subroutine determinant(self, system, lambda, value, about_half)
    class(hill_determinant), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: lambda
    complex(wp), intent(out) :: value
    !> Orders mirrored about Im lambda = d/2, where the determinant is real then, instead of 0.
    logical, intent(in) :: about_half
    integer :: p
    p = self%n_orders - merge(0, 1, about_half)
    call self%of_orders(system, p, self%highest - (p - 1)*self%stride, lambda, value)
    call self%without_poles(lambda, value)
  end subroutine determinant

  !> The determinant at a distance, however small, from where memory is singular: from 0, or i d/2
  !! where orders are odd.
  subroutine determinant_from_place(self, system, distance, value)
    class(hill_determinant), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: distance
    complex(wp), intent(out) :: value
    integer :: p
    p = self%n_orders - merge(0, 1, self%stride == 2)
    call self%of_orders(system, p, self%highest + self%stride/2 - (p - 1)*self%stride, distance, &
                        value)
    call self%without_poles(distance + cmplx(0.0_wp, merge(0.5_wp*self%period, 0.0_wp, &
                                                           self%stride == 2), wp), value)
  end subroutine determinant_from_place

  !> Everything that kernels decide.
  subroutine find_memory(self, system)
    class(hill_determinant), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer :: j, q

    self%remembers = any(system%kernel_of > 0)
    self%creeps = system%kernel_without_integral() /= 0
    self%pushes = self%creeps
    do q = 1, size(system%kernels)
      if (any(system%kernel_of == q) .and. .not. self%pushes) then
        self%pushes = system%kernels(q)%integral() > 1.0_wp
      end if
    end do
    if (self%remembers) self%fading = fading_rate(system)
    allocate (self%kernel_of_group(0))
    do j = 1, system%n_memory()
      q = system%kernel_of(j)
      if (.not. any(self%kernel_of_group == q)) self%kernel_of_group = [self%kernel_of_group, q]
    end do
    self%group = [(findloc(self%kernel_of_group, system%kernel_of(j), 1), j=1, system%n_memory())]
  end subroutine find_memory

  !> For motions of frequency nu (rad/s).
  subroutine set_period(self, system, nu)
    class(hill_determinant), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu

    self%nu = nu
    self%period = self%stride*nu
    if (self%pushes) self%finest = max(self%fading, slow*self%period)
    if (.not. allocated(self%relaxing)) call relaxing_points(system, widest*nu, self%relaxing)
  end subroutine set_period

  !> Where 1 - part R(s) = 0 at real s, -range < s < 0, for every kernel in use.
  subroutine relaxing_points(system, range, points)
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: range
    real(wp), allocatable, intent(out) :: points(:)
    real(wp) :: s
    integer :: i, q
    logical :: made

    allocate (points(0))
    do q = 1, size(system%kernels)
      if (.not. any(system%kernel_of == q)) cycle
      do i = 1, merge(1, size(parts), all(system%kernel_of == q))
        call relaxing(system, q, parts(i), range, s, made)
        if (.not. made) exit
        points = [points, s]
      end do
    end do
  end subroutine relaxing_points

  !> Where part R(s) = 1 at real s, 0 > s > -range: R grows from s = 0 to its first singularity, and
  !! is no positive real number behind it.
  subroutine relaxing(system, q, part, range, s, made)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: q
    real(wp), intent(in) :: part, range
    real(wp), intent(out) :: s
    logical, intent(out) :: made
    complex(wp) :: r(1)
    real(wp) :: low, high, last
    integer :: i

    made = .false.
    s = 0.0_wp
    ! With a factor below 0 springs stiffen: R grows nowhere above 0.
    if (.not. system%kernels(q)%factor > 0.0_wp) return
    if (.not. system%kernels(q)%integral() < 1.0_wp/part) return
    ! Above the root at low, below it, or behind the singularity, at high.
    low = 0.0_wp
    high = 0.0_wp
    last = 0.0_wp
    s = 1.0e-12_wp*range
    do while (s < range)
      call system%kernels(q)%laplace([cmplx(-s, 0.0_wp, wp)], r)
      if (beyond()) then
        high = s
        exit
      end if
      last = real(r(1))
      low = s
      s = 2.0_wp*s
    end do
    if (.not. high > 0.0_wp) return
    do i = 1, 60
      s = 0.5_wp*(low + high)
      call system%kernels(q)%laplace([cmplx(-s, 0.0_wp, wp)], r)
      if (beyond()) then
        high = s
      else
        low = s
        last = real(r(1))
      end if
      if (high - low <= 1.0e-14_wp*high) exit
    end do
    s = -low
    made = .true.

  contains

    logical function beyond()
      beyond = .true.
      if (.not. abs(r(1)) <= huge(1.0_wp)) return
      if (abs(aimag(r(1))) > 1.0e-12_wp*abs(real(r(1)))) return
      beyond = real(r(1)) < last .or. real(r(1))*part > 1.0_wp
    end function beyond

  end subroutine relaxing

  !> What memory leaves of the static stiffness at rest at s = lambda (lambda - i d/2 under
  !! half-wave symmetry), det K(s)/det K without memory; 1 where that vanishes or is not known. Near
  !! s = 0 this is how slow memory enters a determinant: with singularities at its rates, and zeros
  !! near them.
  complex(wp) function relaxation(self, system, lambda) result(ratio)
    class(hill_determinant), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: lambda
    real(wp), allocatable :: re(:, :), im(:, :)
    complex(wp) :: kept(1, size(self%kernel_of_group)), s(1)
    integer :: n, q

    ratio = (1.0_wp, 0.0_wp)
    if (.not. abs(self%static) > 0.0_wp) return
    s(1) = lambda
    if (self%stride == 2) s(1) = lambda - cmplx(0.0_wp, 0.5_wp*self%period, wp)
    n = size(self%springs_at_rest, 1)
    allocate (re(n, n), im(n, n), source=0.0_wp)
    kept = retained_of(system, self%kernel_of_group, s)
    do q = 1, size(self%kernel_of_group)
      re = re + real(kept(1, q))*self%springs_at_rest(:, :, q)
      im = im + aimag(kept(1, q))*self%springs_at_rest(:, :, q)
    end do
    call band_determinant(n, n, n, re, im, ratio)
    ratio = ratio/self%static
  end function relaxation

  !> The slowest rate at which a kernel in use fades (1/s): a determinant has no singularity right
  !! of its negative.
  real(wp) function fading_rate(system) result(rate)
    class(oscillator_type), intent(in) :: system
    integer :: q

    rate = huge(1.0_wp)
    do q = 1, size(system%kernels)
      if (any(system%kernel_of == q)) rate = min(rate, system%kernels(q)%kernel%fading_rate())
    end do
  end function fading_rate

  !> What memory retains of each group, shape (size(s), groups).
  function retained_of(system, kernel_of_group, s) result(kept)
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: kernel_of_group(:)
    complex(wp), intent(in) :: s(:)
    complex(wp) :: kept(size(s), size(kernel_of_group))
    integer :: q

    kept = (1.0_wp, 0.0_wp)
    do q = 1, size(kernel_of_group)
      if (kernel_of_group(q) == 0) cycle
      call system%kernels(kernel_of_group(q))%laplace(s, kept(:, q))
      kept(:, q) = 1.0_wp - kept(:, q)
    end do
  end function retained_of

  elemental complex(wp) function into_strip(lambda, d)
    complex(wp), intent(in) :: lambda
    real(wp), intent(in) :: d
    into_strip = cmplx(real(lambda), aimag(lambda) - d*anint(aimag(lambda)/d), wp)
  end function into_strip

  subroutine new_gaps(gaps, places, period)
    type(gap_list), intent(out) :: gaps
    !> p_k, and d.
    complex(wp), intent(in) :: places(:)
    real(wp), intent(in) :: period
    integer :: k

    gaps%scale = 2.0_wp*pi/period
    gaps%place = gaps%scale*places
    allocate (gaps%wave(size(places)))
    if (size(places) > 0) gaps%wave(1) = exp(gaps%place(1))
    do k = 2, size(places)
      associate (last => conjg(gaps%place(k - 1)), this => gaps%place(k))
        if (abs(real(this - last)) + abs(aimag(this - last)) > 0.0_wp) then
          gaps%wave(k) = exp(this)
        else
          gaps%wave(k) = conjg(gaps%wave(k - 1))
        end if
      end associate
    end do
  end subroutine new_gaps

  !> Multiply a value by all factors at lambda.
  pure subroutine multiply(self, lambda, value)
    class(gap_list), intent(in) :: self
    complex(wp), intent(in) :: lambda
    complex(wp), intent(inout) :: value
    complex(wp) :: back
    integer :: k

    back = exp(-self%scale*lambda)
    do k = 1, size(self%place)
      value = value*self%at(k, lambda, back)
    end do
  end subroutine multiply

  !> Divide a value by all factors at lambda that are not 0.
  pure subroutine divide(self, lambda, value)
    class(gap_list), intent(in) :: self
    complex(wp), intent(in) :: lambda
    complex(wp), intent(inout) :: value
    complex(wp) :: back, factor
    real(wp) :: square
    integer :: k

    back = exp(-self%scale*lambda)
    do k = 1, size(self%place)
      factor = self%at(k, lambda, back)
      square = real(factor)**2 + aimag(factor)**2
      if (square > huge(1.0_wp)) then
        value = value/factor
      else if (square > tiny(1.0_wp)) then
        value = value*(conjg(factor)/square)
      end if
    end do
  end subroutine divide

  !> Factor k at lambda; `back` = exp(-2 pi lambda/d).
  pure complex(wp) function at(self, k, lambda, back) result(factor)
    class(gap_list), intent(in) :: self
    integer, intent(in) :: k
    complex(wp), intent(in) :: lambda, back
    factor = 1.0_wp - self%wave(k)*back
    if (abs(real(factor)) + abs(aimag(factor)) < small_gap) then
      factor = gap(self%place(k) - self%scale*lambda)
    end if
  end function at

  !> 1 - exp(x), to rounding near 0 too.
  elemental complex(wp) function gap(x)
    complex(wp), intent(in) :: x
    real(wp) :: half, less, sine, cosine
    ! exp(a) - 1 = 2 sinh(a/2) exp(a/2) and 1 - cos b = 2 sin(b/2)^2 lose no digits.
    half = 0.5_wp*real(x)
    less = 2.0_wp*sinh(half)*exp(half)
    sine = sin(0.5_wp*aimag(x))
    cosine = cos(0.5_wp*aimag(x))
    gap = cmplx(2.0_wp*(1.0_wp + less)*sine**2 - less, -2.0_wp*(1.0_wp + less)*sine*cosine, wp)
  end function gap

end module viscovib_hill_determinant
