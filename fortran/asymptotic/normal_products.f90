!> Components of a normal form: generators, their products, and the response to a product.
!!
!! `viscovib_normal_form` builds it.
module viscovib_normal_products
  use viscovib_dense, only: solve_complex
  use viscovib_kinds, only: wp
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_resonance_choice, only: candidate_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: normal_form_type, reach_type

  integer, parameter, public :: max_modes = 6

  !> Possible shifts of modes: the change of the exponent of each, divided by the square of its
  !! amplitude (terms of third order) and by amplitudes (second order), shape (n_modes).
  type :: reach_type
    real(wp), allocatable :: cubic(:), quadratic(:)
    !> Exponents and vectors of `find_modes`: oscillating loads do not change them.
    complex(wp), allocatable :: s(:), right(:, :), left(:, :)
    !> Include terms far from the modes, for the growth that they cause.
    logical :: with_far = .false.
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
    !> As in `reach_type`.
    logical :: with_far = .false.
    !> Resonant terms are selected by influence.
    logical :: choosing = .false.
    !> The selected frame, or the natural frequencies.
    real(wp), allocatable :: frame(:)
    !> Terms near a mode, selected or not; loads alone (no products) come first.
    type(candidate_type), allocatable :: candidates(:)
    !> Generator a + n_generators is the conjugate of a. Exponents of the linear flow and
    !! of products, shape (2 n_generators); vectors, shape (n, 2 n_generators).
    complex(wp), allocatable :: exponents(:), s(:), right(:, :), left(:, :)
    !> Products: factors, exponents, coefficients of y, shape (n, n_products), and of the
    !! modes' changes, shape (2 n_generators, n_products).
    integer, allocatable :: pair(:, :), triple(:, :)
    complex(wp), allocatable :: s_pair(:), s_triple(:)
    complex(wp), allocatable :: u_pair(:, :), u_triple(:, :), g_pair(:, :), g_triple(:, :)
    !> Products whose coefficient in y is not 0.
    integer, allocatable :: used_pairs(:), used_triples(:)
    !> R_M of products of three, and which of them have their coefficient of y. In a frame, those
    !! that do not act on a mode get it by `answer_triples`.
    complex(wp), allocatable :: side_triple(:, :)
    logical, allocatable :: answered(:)
    !> Moduli of the coefficients of the coordinates.
    real(wp), allocatable :: size_one(:, :), size_pair(:, :), size_triple(:, :)
    !> Loads near modes: y, shape (n, n_loads), and g, shape (n_modes, n_loads).
    complex(wp), allocatable :: u_load(:, :), g_load(:, :)
    integer, allocatable :: pair_at(:, :), triple_at(:, :, :)
    !> Which modes and conjugates resonate, shape (2 n_generators, n_products), and which modes
    !! with loads, shape (n_modes, n_loads).
    logical, allocatable :: acts_pair(:, :), acts_triple(:, :), acts_load(:, :)
    !> Arguments x of the terms of first and second order.
    complex(wp), allocatable :: x_one(:, :), x_pair(:, :)
    !> N_2 of each product of two, without kernels; only with memory and slow changes.
    complex(wp), allocatable :: n_pair(:, :)
  contains
    procedure :: conjugate_of
    procedure :: near
    procedure :: near_modes
    procedure :: place_of
    procedure :: drive_of
    procedure :: weight
    procedure :: set_exponents
    procedure :: number_products
    procedure :: answer
    procedure :: answer_load
  end type normal_form_type

contains

  pure integer function conjugate_of(self, a)
    class(normal_form_type), intent(in) :: self
    integer, intent(in) :: a
    conjugate_of = modulo(a - 1 + self%n_generators, 2*self%n_generators) + 1
  end function conjugate_of

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

  pure integer function place_of(self, a, b, c)
    class(normal_form_type), intent(in) :: self
    integer, intent(in) :: a, b, c
    integer :: low, high
    low = min(a, b, c)
    high = max(a, b, c)
    place_of = self%triple_at(low, a + b + c - low - high, high)
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

  !> l_j L[s, s_j] r_j.
  complex(wp) function weight(self, form, j, s)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: j
    complex(wp), intent(in) :: s
    weight = sum(self%left(:, j)*matmul(form%operator_between(s, self%exponents(j)), &
                                        self%right(:, j)))
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

  !> All products of two and three generators, and their indices.
  subroutine number_products(normal)
    class(normal_form_type), intent(inout) :: normal
    integer :: g, a, b, c, n

    g = 2*normal%n_generators
    allocate (normal%pair(2, g*(g + 1)/2), normal%pair_at(g, g))
    allocate (normal%triple(3, g*(g + 1)*(g + 2)/6), normal%triple_at(g, g, g))
    n = 0
    do b = 1, g
      do a = 1, b
        n = n + 1
        normal%pair(:, n) = [a, b]
        normal%pair_at(a, b) = n
        normal%pair_at(b, a) = n
      end do
    end do
    n = 0
    do c = 1, g
      do b = 1, c
        do a = 1, b
          n = n + 1
          normal%triple(:, n) = [a, b, c]
          normal%triple_at(a, b, c) = n
        end do
      end do
    end do
    allocate (normal%acts_pair(g, size(normal%pair, 2)), source=.false.)
    allocate (normal%acts_triple(g, size(normal%triple, 2)), source=.false.)
  end subroutine number_products

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

end module viscovib_normal_products
