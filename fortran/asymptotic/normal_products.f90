! Optimize: -O2 -fvect-cost-model=dynamic -fstack-arrays
!> Components of a normal form: generators, their products, and the response to a product.
!!
!! `viscovib_normal_form` builds it. A normal form that is built again keeps its arrays.
!!
!! Resonant terms are selected by their effect.
!! A product M of generators whose frequency is near that of mode j adds c M to the change of Y_j, c
!! = l_j R_M/(l_j L[s_M, s_j] r_j), or, if omitted there, c M/(s_M - s_j) to Y_j. This is a small
!! change of variables as long as its derivative by each amplitude is small,
!!
!!   influence = max_f |c| |dM/dY_f|/|s_M - s_j|,
!!
!! where f runs over the modes among the factors. For a mode at rest and oscillating loads this is
!! parametric excitation: the mode grows from rest if |c dM/dY_f| > |s_M - s_j|/2, that is, from an
!! influence of 1/2 on. Products of loads alone are compared with the motion.
module viscovib_normal_products
  use viscovib_dense, only: solve_complex
  use viscovib_kinds, only: wp
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: candidate_type, influence, normal_form_type, reach_type, renew

  integer, parameter, public :: max_modes = 6
  !> Influence from which a term is resonant; below it the error of its effect is of second order.
  real(wp), parameter, public :: least_influence = 0.05_wp
  !> Terms farther from a mode than this fraction of its frequency are not part of the modulation
  !! equations, but may make modes at rest grow. This happens from an influence of 1/2 on. Their
  !! influence is multiplied by 0.6, so that it may be compared with bounds of 0.3, and examined
  !! from 0.24 on.
  real(wp), parameter, public :: far = 0.5_wp, part_of_far = 0.6_wp, least_of_far = 0.24_wp
  !> If no amplitudes are known: this fraction of the highest frequency.
  real(wp), parameter, public :: default_band = 0.05_wp

  type :: candidate_type
    !> Number of factors, index of the product, mode; factors as generators, 0: none.
    integer :: order = 0, at = 0, mode = 0, factors(3) = 0
    real(wp) :: coupling = 0.0_wp, divisor = 0.0_wp
    !> Part of the modulation equations; resonant, but not compatible with their frame.
    logical :: taken = .false., turned_away = .false.
    !> Not compatible with the frame, although loads and this mode alone may sustain a motion.
    logical :: lost = .false.
  end type candidate_type


  !> Possible shifts of modes: the change of the exponent of each, divided by the square of its
  !! amplitude (terms of third order) and by amplitudes (second order), shape (n_modes).
  type :: reach_type
    real(wp), allocatable :: cubic(:), quadratic(:)
    !> Exponents and vectors of `find_modes`: oscillating loads do not change them.
    complex(wp), allocatable :: s(:), right(:, :), left(:, :)
    !> The form about its equilibrium in natural units, its equilibrium and units, as in
    !! `multiple_scales_type`.
    type(polynomial_form_type) :: form
    real(wp), allocatable :: rows(:), columns(:), units(:), rest(:)
  end type reach_type

  type :: normal_form_type
    integer :: n_modes = 0, n_generators = 0
    !> Frequencies that differ by less than this fraction of the highest of them are resonant,
    !! unless resonant terms are selected by influence.
    real(wp) :: tolerance = 0.0_wp
    !> Loads whose responses are factors of products (generators n_modes + 1, ...), the remaining
    !! loads, and loads that occur in the modes' changes.
    integer, allocatable :: hard(:), weak(:), direct(:)
    !> Products are those of steady motion; the same in a selected frame.
    logical :: steady = .false., framed = .false.
    !> Terms far from the modes are included, for the growth of modes at rest: `rests` is true for
    !! these modes and conjugates, shape (2 n_generators), and products of several are left out.
    logical :: with_far = .false.
    logical, allocatable :: rests(:)
    !> Resonant terms are selected by influence.
    logical :: choosing = .false.
    !> The selected frame, or the natural frequencies.
    real(wp), allocatable :: frame(:)
    !> Terms near a mode, selected or not.
    type(candidate_type), allocatable :: candidates(:)
    !> Generator a + n_generators is the conjugate of a. Exponents of the linear flow and
    !! of products, shape (2 n_generators); vectors, shape (n, 2 n_generators).
    complex(wp), allocatable :: exponents(:), s(:), right(:, :), left(:, :)
    !> l_j A_k r_j of each mode, k = 1 and 2.
    complex(wp), allocatable :: weights(:, :)
    !> Products: factors, exponents, coefficients of y, shape (n, n_products), and of the
    !! modes' changes, shape (2 n_generators, n_products).
    integer, allocatable :: pair(:, :), triple(:, :)
    complex(wp), allocatable :: s_pair(:), s_triple(:)
    complex(wp), allocatable :: u_pair(:, :), u_triple(:, :), g_pair(:, :), g_triple(:, :)
    !> Products whose coefficient in y is not 0.
    integer, allocatable :: used_pairs(:), used_triples(:)
    !> R_M of products of three, which of them are computed, and which products have their
    !! coefficient of y. In a frame, products get it by `answer_triples`.
    complex(wp), allocatable :: side_triple(:, :)
    logical, allocatable :: has_side(:), answered(:)
    !> R_M of products of two.
    complex(wp), allocatable :: side_pair(:, :)
    !> Changes of second order affect products of three.
    logical :: slow = .false.
    !> Moduli of the coefficients of the coordinates.
    real(wp), allocatable :: size_one(:, :), size_pair(:, :), size_triple(:, :)
    !> Loads near modes: y, shape (n, n_loads), and g, shape (n_modes, n_loads).
    complex(wp), allocatable :: u_load(:, :), g_load(:, :)
    !> Which modes and conjugates resonate, shape (2 n_generators, n_products), and which modes
    !! with loads, shape (n_modes, n_loads).
    logical, allocatable :: acts_pair(:, :), acts_triple(:, :), acts_load(:, :)
    !> Arguments x of the terms of first and second order.
    complex(wp), allocatable :: x_one(:, :), x_pair(:, :)
    !> N_2 of each product of two, without kernels; only with memory and slow changes.
    complex(wp), allocatable :: n_pair(:, :)
  contains
    procedure :: mirror_of
    procedure :: near
    procedure :: near_modes
    procedure, nopass :: pair_at
    procedure, nopass :: place_of
    procedure :: drive_of
    procedure :: weight
    procedure :: set_exponents
    procedure :: number_products
    procedure :: answer
    procedure :: find_rates
    procedure :: answer_load
  end type normal_form_type

contains

  !> The index of the conjugate of a product of two or three generators.
  pure integer function mirror_of(self, factors)
    class(normal_form_type), intent(in) :: self
    integer, intent(in) :: factors(:)
    integer :: f(3), q
    do q = 1, size(factors)
      f(q) = factors(q) + merge(self%n_generators, -self%n_generators, &
                                factors(q) <= self%n_generators)
    end do
    if (size(factors) == 2) then
      mirror_of = pair_at(f(1), f(2))
    else
      mirror_of = place_of(f(1), f(2), f(3))
    end if
  end function mirror_of

  !> True if mode generator a resonates with the exponent s, for the highest frequency of the
  !! factors.
  pure logical function near(self, s, highest, a)
    class(normal_form_type), intent(in) :: self
    complex(wp), intent(in) :: s
    real(wp), intent(in) :: highest
    integer, intent(in) :: a
    near = modulo(a - 1, self%n_generators) < self%n_modes
    if (.not. near) return
    associate (own => aimag(self%s(a)))
      ! The limit excludes that a mode and its conjugate are near at the same time.
      near = abs(aimag(s) - own) <= min(max(self%tolerance, 1.0e-10_wp)*max(highest, abs(own)), &
                                        0.5_wp*abs(own))
    end associate
  end function near

  !> The same for all modes and conjugates and a term of this frequency, including modes with the
  !! same frequency in the frame.
  pure function near_modes(self, frequency, frame, band) result(acts)
    class(normal_form_type), intent(in) :: self
    !> Frequency of the term, and of the modes.
    real(wp), intent(in) :: frequency, frame(:)
    !> Replaces the tolerance; relative to the mode's own frequency.
    real(wp), intent(in), optional :: band
    logical :: acts(2*self%n_generators)
    integer :: a
    do a = 1, size(acts)
      acts(a) = self%near(cmplx(0.0_wp, frequency, wp), abs(frequency), a)
    end do
    if (present(band)) acts(:self%n_modes) = abs(frequency - frame) <= band*frame
    acts(:self%n_modes) = acts(:self%n_modes) .or. abs(frequency - frame) <= 1.0e-7_wp*frame
  end function near_modes

  !> The index of a product of two generators.
  pure integer function pair_at(a, b)
    integer, intent(in) :: a, b
    pair_at = max(a, b)*(max(a, b) - 1)/2 + min(a, b)
  end function pair_at

  !> The index of a product of three generators.
  pure integer function place_of(a, b, c)
    integer, intent(in) :: a, b, c
    integer :: low, high
    low = min(a, b, c)
    high = max(a, b, c)
    place_of = (high - 1)*high*(high + 1)/6 + pair_at(low, a + b + c - low - high)
  end function place_of

  !> l_j F_k/2 over l_j L[i p, s_j] r_j; 0 if a load acts on the mode by rounding errors only.
  complex(wp) function drive_of(self, form, j, k)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: j, k
    complex(wp) :: part
    real(wp) :: rounding
    drive_of = (0.0_wp, 0.0_wp)
    part = 0.5_wp*sum(self%left(:, j)*form%load(:, k))
    rounding = 0.5e-13_wp*maxval(abs(self%left(:, j)))*maxval(abs(form%load(:, k)))
    if (.not. abs(part) > rounding) return
    drive_of = part/self%weight(form, j, cmplx(0.0_wp, form%drives(k), wp))
  end function drive_of

  !> l_j L[s, s_j] r_j of a mode or its conjugate.
  complex(wp) function weight(self, form, j, s)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: j
    complex(wp), intent(in) :: s
    complex(wp) :: of_slopes(2)
    if (j <= self%n_modes) then
      of_slopes = self%weights(:, j)
    else
      of_slopes = conjg(self%weights(:, j - self%n_generators))
    end if
    weight = of_slopes(1) + (s + self%exponents(j))*of_slopes(2)
    if (.not. form%has_memory()) return
    weight = weight + sum(self%left(:, j)*form%retained_between([s, self%exponents(j)]) &
                          *matmul(form%hereditary, self%right(:, j)))
  end function weight

  !> Exponents of generators and products in the present frame.
  subroutine set_exponents(self)
    class(normal_form_type), intent(inout) :: self
    integer :: n, m
    n = self%n_modes
    m = self%n_generators
    self%s = self%exponents
    if (self%steady) self%s = cmplx(0.0_wp, aimag(self%exponents), wp)
    if (self%framed) then
      self%s(:n) = cmplx(0.0_wp, self%frame, wp)
      self%s(m + 1:m + n) = conjg(self%s(:n))
    end if
    self%s_pair = self%s(self%pair(1, :)) + self%s(self%pair(2, :))
    self%s_triple = self%s(self%triple(1, :)) + self%s(self%triple(2, :)) &
                    + self%s(self%triple(3, :))
  end subroutine set_exponents

  !> All products of two and three generators, in the order of their indices.
  subroutine number_products(normal)
    class(normal_form_type), intent(inout) :: normal
    integer :: g, a, b, c

    g = 2*normal%n_generators
    if (allocated(normal%pair)) then
      if (size(normal%pair, 2) == pair_at(g, g)) then
        normal%acts_pair = .false.
        normal%acts_triple = .false.
        return
      end if
    end if
    normal%pair = reshape([((a, b, a=1, b), b=1, g)], [2, pair_at(g, g)])
    normal%triple = reshape([(((a, b, c, a=1, b), b=1, c), c=1, g)], [3, place_of(g, g, g)])
    normal%acts_pair = spread([(.false., a=1, g)], 2, size(normal%pair, 2))
    normal%acts_triple = spread([(.false., a=1, g)], 2, size(normal%triple, 2))
  end subroutine number_products

  !> Give an array this shape and the value 0.
  pure subroutine renew(x, n, m)
    complex(wp), allocatable, intent(inout) :: x(:, :)
    integer, intent(in) :: n, m
    if (allocated(x)) then
      if (size(x, 1) /= n .or. size(x, 2) /= m) deallocate (x)
    end if
    if (.not. allocated(x)) allocate (x(n, m))
    x = (0.0_wp, 0.0_wp)
  end subroutine renew

  !> U_M and g_M from R_M: the bordered linear equations.
  subroutine answer(self, form, s, load, acts, u, rates, singular)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    complex(wp), intent(in) :: s, load(:)
    !> Modes and conjugates that resonate, shape (2 n_generators).
    logical, intent(in) :: acts(:)
    complex(wp), intent(out) :: u(:), rates(:)
    logical, intent(out) :: singular
    integer :: a

    u = (0.0_wp, 0.0_wp)
    rates = (0.0_wp, 0.0_wp)
    singular = .false.
    if (all(load == (0.0_wp, 0.0_wp))) return
    if (any(acts)) then
      call solve_bordered(pack([(a, a=1, size(acts))], acts))
    else
      u = load
      call solve_complex(form%operator_at(s), u, .false., singular)
      if (singular) u = (0.0_wp, 0.0_wp)
    end if

  contains

    subroutine solve_bordered(modes)
      integer, intent(in) :: modes(:)
      complex(wp) :: matrix(form%n + size(modes), form%n + size(modes)), slope(form%n, form%n)
      complex(wp) :: x(form%n + size(modes))
      integer :: n, i
      n = form%n
      matrix = (0.0_wp, 0.0_wp)
      matrix(:n, :n) = form%operator_at(s)
      x(:n) = load
      x(n + 1:) = (0.0_wp, 0.0_wp)
      do i = 1, size(modes)
        slope = form%operator_between(s, self%exponents(modes(i)))
        matrix(:n, n + i) = matmul(slope, self%right(:, modes(i)))
        matrix(n + i, :n) = matmul(self%left(:, modes(i)), slope)
      end do
      call solve_complex(matrix, x, .false., singular)
      if (singular) return
      u = x(:n)
      rates(modes) = x(n + 1:)
    end subroutine solve_bordered

  end subroutine answer

  !> g_M alone, from l_i R_M = sum_j g_jM l_i L[s_M, s_j] r_j: the bordered equations times l_i,
  !! since l_i L(s_M) U_M = (s_M - s_i) l_i L[s_M, s_i] U_M = 0 for each mode i that resonates.
  subroutine find_rates(self, form, s, load, acts, rates, singular)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    complex(wp), intent(in) :: s, load(:)
    !> As in `answer`.
    logical, intent(in) :: acts(:)
    complex(wp), intent(out) :: rates(:)
    logical, intent(out) :: singular
    complex(wp) :: matrix(count(acts), count(acts)), x(count(acts)), slope(form%n)
    integer :: modes(count(acts)), i, j

    rates = (0.0_wp, 0.0_wp)
    if (size(modes) == 1) then
      j = findloc(acts, .true., 1)
      rates(j) = self%weight(form, j, s)
      singular = .not. abs(rates(j)) > 0.0_wp
      if (.not. singular) rates(j) = sum(self%left(:, j)*load)/rates(j)
      return
    end if
    modes = pack([(i, i=1, size(acts))], acts)
    do j = 1, size(modes)
      slope = matmul(form%operator_between(s, self%exponents(modes(j))), self%right(:, modes(j)))
      do i = 1, size(modes)
        matrix(i, j) = sum(self%left(:, modes(i))*slope)
      end do
      x(j) = sum(self%left(:, modes(j))*load)
    end do
    call solve_complex(matrix, x, .false., singular)
    if (.not. singular) rates(modes) = x
  end subroutine find_rates

  !> First-order effect of load k at frequency p: its contribution to y and to the changes of
  !! the modes it resonates with.
  subroutine answer_load(self, form, k, p, u, g, status)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: k
    real(wp), intent(in) :: p
    complex(wp), intent(out) :: u(:), g(:)
    type(status_type), intent(out) :: status
    complex(wp) :: rates(2*self%n_generators), s
    logical :: singular, acts(2*self%n_generators)
    integer :: j

    call set_ok(status)
    s = cmplx(0.0_wp, p, wp)
    acts = .false.
    acts(:self%n_modes) = self%acts_load(:, k)
    call self%answer(form, s, cmplx(0.5_wp*form%load(:, k), 0.0_wp, wp), acts, u, rates, singular)
    if (singular) then
      call fail(status, status_input_error, 'load', 'load '//show(k)//': no response at ' &
                //'frequency '//show(p)//', where its dynamic stiffness is 0')
      return
    end if
    g = rates(:self%n_modes)
    do j = 1, self%n_modes
      if (.not. abs(self%drive_of(form, j, k)) > 0.0_wp) g(j) = (0.0_wp, 0.0_wp)
    end do
  end subroutine answer_load

  !> Influence for generators of these sizes; the first n_modes of each half are modes.
  pure real(wp) function influence(candidate, sizes, n_modes, reference)
    type(candidate_type), intent(in) :: candidate
    !> Shape (n_generators).
    real(wp), intent(in) :: sizes(:)
    integer, intent(in) :: n_modes
    !> Size of the motion of first order.
    real(wp), intent(in) :: reference
    real(wp) :: slope
    integer :: which(3), q, other

    which(:candidate%order) = modulo(candidate%factors(:candidate%order) - 1, size(sizes)) + 1
    influence = 0.0_wp
    do q = 1, candidate%order
      if (which(q) > n_modes) cycle
      slope = real(count(candidate%factors(:candidate%order) == candidate%factors(q)), wp)
      do other = 1, candidate%order
        if (other /= q) slope = slope*sizes(which(other))
      end do
      influence = max(influence, slope)
    end do
    if (all(which(:candidate%order) > n_modes)) then
      influence = product(sizes(which(:candidate%order)))
      if (reference > 0.0_wp) influence = influence/reference
    end if
    influence = influence*candidate%coupling
    ! Exact resonance without damping.
    if (influence > 0.0_wp) then
      if (candidate%divisor > influence*tiny(1.0_wp)) then
        influence = min(influence/candidate%divisor, huge(1.0_wp))
      else
        influence = huge(1.0_wp)
      end if
    end if
  end function influence

end module viscovib_normal_products
