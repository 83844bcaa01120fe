!> The method of multiple scales to third order, as a normal form.
!!
!! The motion is a polynomial in generators Y_a: an amplitude Y_j for each mode, with
!! Y_j' = s_j Y_j + ..., a wave exp(i p t) for each load far from the modes, and the
!! conjugates of all,
!!
!!   y = sum_a r_a Y_a + sum_ab U_ab Y_a Y_b + sum_abc U_abc Y_a Y_b Y_c,
!!   Y_j' = s_j Y_j + sum_ab g_j,ab Y_a Y_b + sum_abc g_j,abc Y_a Y_b Y_c + sum_k g_jk exp(i p_k t).
!!
!! A product M of generators has the exponent s_M, the sum of theirs. Put into the
!! equations of `viscovib_polynomial_form`, each product gives a linear equation
!!
!!   L(s_M) U_M + sum_j g_jM L[s_M, s_j] r_j = R_M,      l_j L[s_M, s_j] U_M = 0,
!!
!! j over the modes that resonate with M, whose frequencies differ from that of M by
!! less than a tolerance times the highest frequency among both; L[s, t] is the divided
!! difference. So no small divisor is
!! ever divided by, and no order of magnitude is assumed for the divisors kept. R_M is the
!! load, or what lower orders put in: -N_2, -2 N_2 and -N_3, and what slow changes of
!! second order do to products of second order. Damping and memory are in s_j and L: their
!! linear effects are exact. Loads that resonate with a mode count as of third order.
!!
!! The exponents of products are those of free motion, decay included, or, where a load
!! keeps a mode moving, of steady motion, i times the frequencies: both are the same to this
!! order if damping counts as of second order, but each is nearer to its own case if not.
!!
!! Sources: Nayfeh, Introduction to perturbation techniques, 1981, chapters 7, 15 (scales);
!! Touze, Vizzaccaro, Thomas, Nonlinear Dyn. 105 (2021) 1141, equations (44)-(60) (normal forms
!! with the same bordered equations). One time scale a degree here gives Nayfeh's equations.
module viscovib_normal_form
  use viscovib_dense, only: solve_complex
  use viscovib_kinds, only: wp
  use viscovib_linear_modes, only: find_modes
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: normal_form_type, new_normal_form

  integer, parameter, public :: max_modes = 6, max_loads = 6

  type :: normal_form_type
    integer :: n_modes = 0, n_generators = 0
    !> Frequencies nearer than this part of the highest of them count as resonant.
    real(wp) :: tolerance = 0.0_wp
    !> Loads far from the modes (generators n_modes + 1, ...) and near them.
    integer, allocatable :: hard(:), weak(:)
    !> Products are those of steady motion.
    logical :: steady = .false.
    !> Generator a + n_generators is the conjugate of a. Exponents of the linear flow and
    !! of products, shape (2 n_generators); vectors, shape (n, 2 n_generators).
    complex(wp), allocatable :: exponents(:), s(:), right(:, :), left(:, :)
    !> Products: factors, exponents, coefficients of y, shape (n, n_products), and of the
    !! modes' changes, shape (2 n_generators, n_products).
    integer, allocatable :: pair(:, :), triple(:, :)
    complex(wp), allocatable :: s_pair(:), s_triple(:)
    complex(wp), allocatable :: u_pair(:, :), u_triple(:, :), g_pair(:, :), g_triple(:, :)
    !> Products that y has at all.
    integer, allocatable :: used_pairs(:), used_triples(:)
    !> Moduli of the coefficients of the coordinates.
    real(wp), allocatable :: size_one(:, :), size_pair(:, :), size_triple(:, :)
    !> Loads near modes: y, shape (n, n_loads), and g, shape (n_modes, n_loads).
    complex(wp), allocatable :: u_load(:, :), g_load(:, :)
    integer, allocatable, private :: pair_at(:, :), triple_at(:, :, :)
    !> Arguments x of the terms of first and second order.
    complex(wp), allocatable, private :: x_one(:, :), x_pair(:, :)
    !> N_2 of each product of two, kernels left out, with memory and slow changes alone.
    complex(wp), allocatable, private :: n_pair(:, :)
  contains
    procedure :: conjugate_of
    procedure :: near
    procedure :: answer_load
    procedure :: answer
    procedure, private :: second_order
    procedure, private :: third_order
  end type normal_form_type

contains

  subroutine new_normal_form(normal, form, tolerance, steady, status)
    type(normal_form_type), intent(out) :: normal
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: tolerance
    !> Take steady motion for granted, even if no load is near a mode.
    logical, intent(in) :: steady
    type(status_type), intent(out) :: status
    complex(wp) :: s(form%n_modes()), right(form%n, form%n_modes()), left(form%n, form%n_modes())
    complex(wp) :: wave(form%n, size(form%drives))
    integer :: n, k, m
    logical :: is_weak(size(form%drives)), active(size(form%drives))

    if (.not. (tolerance >= 0.0_wp .and. tolerance < 1.0_wp)) then
      call fail(status, status_input_error, 'tolerance', 'tolerance = '//show(tolerance) &
                //': must be in [0, 1)')
      return
    end if
    n = form%n_modes()
    if (n > max_modes .or. size(form%drives) > max_loads) then
      call fail(status, status_input_error, 'system', 'system: has '//show(n)//' modes and ' &
                //show(size(form%drives))//' loads: at most '//show(max_modes)//' and ' &
                //show(max_loads)//' are allowed')
      return
    end if
    call find_modes(form, s, right, left, status)
    if (status%failed()) return
    normal%n_modes = n
    normal%n_generators = n
    normal%tolerance = tolerance
    normal%s = [s, conjg(s)]
    normal%exponents = normal%s
    normal%right = reshape([right, conjg(right)], [form%n, 2*n])
    normal%left = reshape([left, conjg(left)], [form%n, 2*n])

    ! Loads: those that drive a mode near its frequency are of third order.
    allocate (normal%g_load(n, size(form%drives)), normal%u_load(form%n, size(form%drives)))
    do k = 1, size(form%drives)
      active(k) = any(abs(form%load(:, k)) > 0.0_wp)
      normal%g_load(:, k) = (0.0_wp, 0.0_wp)
      normal%u_load(:, k) = (0.0_wp, 0.0_wp)
      if (.not. active(k)) cycle
      call normal%answer_load(form, k, form%drives(k), normal%u_load(:, k), normal%g_load(:, k), &
                              status)
      if (status%failed()) return
    end do
    wave = normal%u_load
    is_weak = [(any(abs(normal%g_load(:, k)) > 0.0_wp), k=1, size(form%drives))]
    normal%weak = pack([(k, k=1, size(form%drives))], active .and. is_weak)
    normal%hard = pack([(k, k=1, size(form%drives))], active .and. .not. is_weak)

    m = n + size(normal%hard)
    normal%n_generators = m
    associate (wave_s => cmplx(0.0_wp, form%drives(normal%hard), wp), hard => wave(:, normal%hard))
      normal%exponents = [s, wave_s, conjg(s), conjg(wave_s)]
      normal%right = reshape([right, hard, conjg(right), conjg(hard)], [form%n, 2*m])
      normal%left = reshape([left, 0.0_wp*hard, conjg(left), 0.0_wp*hard], [form%n, 2*m])
    end associate
    normal%steady = steady .or. size(normal%weak) > 0
    normal%s = normal%exponents
    if (normal%steady) normal%s = cmplx(0.0_wp, aimag(normal%exponents), wp)
    call number_products(normal)
    call normal%second_order(form, status)
    if (.not. status%failed()) call normal%third_order(form, status)
    if (status%failed()) return
    normal%used_pairs = used(form%n_dof, normal%u_pair)
    normal%used_triples = used(form%n_dof, normal%u_triple)
    normal%size_one = abs(normal%right(:form%n_dof, :))
    normal%size_pair = abs(normal%u_pair(:form%n_dof, :))
    normal%size_triple = abs(normal%u_triple(:form%n_dof, :))
  end subroutine new_normal_form

  pure function used(n_dof, u) result(which)
    integer, intent(in) :: n_dof
    complex(wp), intent(in) :: u(:, :)
    integer, allocatable :: which(:)
    logical :: wanted(size(u, 2))
    integer :: i
    do i = 1, size(u, 2)
      wanted(i) = any(abs(u(:n_dof, i)) > 0.0_wp)
    end do
    which = pack([(i, i=1, size(u, 2))], wanted)
  end function used

  pure integer function conjugate_of(self, a)
    class(normal_form_type), intent(in) :: self
    integer, intent(in) :: a
    conjugate_of = modulo(a - 1 + self%n_generators, 2*self%n_generators) + 1
  end function conjugate_of

  !> Whether mode generator a resonates with the exponent s of factors the highest of
  !! whose frequencies is given.
  pure logical function near(self, s, highest, a)
    class(normal_form_type), intent(in) :: self
    complex(wp), intent(in) :: s
    real(wp), intent(in) :: highest
    integer, intent(in) :: a
    near = modulo(a - 1, self%n_generators) < self%n_modes
    if (.not. near) return
    associate (own => aimag(self%s(a)))
      ! Never so far that a mode and its conjugate were near at once.
      near = abs(aimag(s) - own) <= min(max(self%tolerance, 1.0e-10_wp)*max(highest, abs(own)), &
                                        0.5_wp*abs(own))
    end associate
  end function near

  !> What load k at frequency p does to first order: its share of y and of the changes of
  !! the modes near p, or near the frequency of `reference`.
  subroutine answer_load(self, form, k, p, u, g, status, reference)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: k
    real(wp), intent(in) :: p
    complex(wp), intent(out) :: u(:), g(:)
    type(status_type), intent(out) :: status
    real(wp), intent(in), optional :: reference
    complex(wp) :: rates(2*self%n_generators), s
    real(wp) :: strength
    integer :: j
    logical :: singular

    s = cmplx(0.0_wp, p, wp)
    call self%answer(form, s, p, cmplx(0.5_wp*form%load(:, k), 0.0_wp, wp), u, rates, singular, &
                     reference)
    if (singular) then
      call fail(status, status_input_error, 'load', 'load '//show(k)//': no response at ' &
                //'frequency '//show(p)//', where the system has no stiffness')
      return
    end if
    g = rates(:self%n_modes)
    do j = 1, self%n_modes
      ! Rounding of a load that does not touch the mode.
      strength = 0.5_wp*sum(abs(self%left(:, j)*form%load(:, k)))
      if (.not. strength > 0.0_wp) then
        g(j) = (0.0_wp, 0.0_wp)
      else if (abs(sum(self%left(:, j)*0.5_wp*form%load(:, k))) &
               <= 1.0e-13_wp*maxval(abs(self%left(:, j)))*maxval(abs(form%load(:, k)))) then
        g(j) = (0.0_wp, 0.0_wp)
      end if
    end do
  end subroutine answer_load

  !> U_M and g_M from R_M: the bordered linear equations.
  subroutine answer(self, form, s, highest, load, u, rates, singular, reference)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    complex(wp), intent(in) :: s, load(:)
    real(wp), intent(in) :: highest
    complex(wp), intent(out) :: u(:), rates(:)
    logical, intent(out) :: singular
    !> Modes near this frequency, instead of that of s, count as resonant.
    real(wp), intent(in), optional :: reference
    complex(wp) :: matrix(form%n + 2*max_modes, form%n + 2*max_modes), place
    real(wp) :: widest
    complex(wp) :: x(form%n + 2*max_modes), slope(form%n, form%n)
    integer :: modes(2*max_modes), n, m, a, i

    u = (0.0_wp, 0.0_wp)
    rates = (0.0_wp, 0.0_wp)
    singular = .false.
    if (.not. any(abs(load) > 0.0_wp)) return
    n = form%n
    place = s
    widest = highest
    if (present(reference)) then
      place = cmplx(0.0_wp, reference, wp)
      widest = reference
    end if
    m = 0
    do a = 1, 2*self%n_generators
      if (.not. self%near(place, widest, a)) cycle
      m = m + 1
      modes(m) = a
    end do
    matrix(:n, :n) = form%operator_at(s)
    x(:n) = load
    do i = 1, m
      slope = form%operator_between(s, self%exponents(modes(i)))
      matrix(:n, n + i) = matmul(slope, self%right(:, modes(i)))
      matrix(n + i, :n) = matmul(self%left(:, modes(i)), slope)
      matrix(n + 1:n + m, n + i) = (0.0_wp, 0.0_wp)
      x(n + i) = (0.0_wp, 0.0_wp)
    end do
    call solve_complex(matrix(:n + m, :n + m), x(:n + m), .false., singular)
    if (singular) return
    u = x(:n)
    do i = 1, m
      rates(modes(i)) = x(n + i)
    end do
  end subroutine answer

  !> All products of two and three generators, and where to find them.
  subroutine number_products(normal)
    type(normal_form_type), intent(inout) :: normal
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
    normal%s_pair = normal%s(normal%pair(1, :)) + normal%s(normal%pair(2, :))
    normal%s_triple = normal%s(normal%triple(1, :)) + normal%s(normal%triple(2, :)) &
                      + normal%s(normal%triple(3, :))
  end subroutine number_products

  subroutine second_order(self, form, status)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    type(status_type), intent(out) :: status
    complex(wp) :: load(form%n)
    integer :: i, other, a, b, j, k, g
    logical :: singular

    g = 2*self%n_generators
    allocate (self%x_one(form%n_arguments, g), self%x_pair(form%n_arguments, size(self%pair, 2)))
    allocate (self%u_pair(form%n, size(self%pair, 2)), self%g_pair(g, size(self%pair, 2)))
    do a = 1, g
      self%x_one(:, a) = form%arguments_at(self%s(a), self%right(:, a))
    end do
    self%u_pair = (0.0_wp, 0.0_wp)
    self%g_pair = (0.0_wp, 0.0_wp)
    self%x_pair = (0.0_wp, 0.0_wp)
    allocate (self%n_pair(form%n, merge(size(self%pair, 2), 0, form%has_memory())))
    self%n_pair = (0.0_wp, 0.0_wp)
    if (size(form%quadratic) == 0) return
    do i = 1, size(self%pair, 2)
      a = self%pair(1, i)
      b = self%pair(2, i)
      other = self%pair_at(self%conjugate_of(a), self%conjugate_of(b))
      if (other < i) then
        call copy_conjugate(self, self%u_pair, self%g_pair, other, i)
        self%x_pair(:, i) = conjg(self%x_pair(:, other))
        if (form%has_memory()) self%n_pair(:, i) = conjg(self%n_pair(:, other))
        cycle
      end if
      load = -form%quadratic_at(self%x_one(:, a), self%x_one(:, b))
      if (a /= b) load = 2.0_wp*load
      if (form%has_memory()) then
        self%n_pair(:, i) = -load
        if (any(abs(load) > 0.0_wp)) load = load*form%retained(self%s_pair(i))
      end if
      call self%answer(form, self%s_pair(i), maxval(abs(aimag(self%s([a, b])))), load, &
                       self%u_pair(:, i), self%g_pair(:, i), singular)
      if (singular) then
        call no_stiffness(self%s_pair(i), status)
        return
      end if
      self%x_pair(:, i) = form%arguments_at(self%s_pair(i), self%u_pair(:, i))
      do j = 1, g
        if (.not. abs(self%g_pair(j, i)) > 0.0_wp) cycle
        do k = 1, form%n_arguments
          associate (x => self%x_pair(k, i), r => self%right(form%source(k), j), &
                     rate => self%g_pair(j, i))
            if (form%derivative(k) == 1) x = x + rate*r
            if (form%derivative(k) == 2) x = x + rate*r*(self%s_pair(i) + self%s(j))
          end associate
        end do
      end do
    end do
  end subroutine second_order

  subroutine third_order(self, form, status)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    type(status_type), intent(out) :: status
    complex(wp) :: load(form%n)
    integer :: i, other, t(3), q, m, g
    logical :: singular, slow

    g = 2*self%n_generators
    m = size(self%triple, 2)
    allocate (self%u_triple(form%n, m), self%g_triple(g, m))
    slow = any(abs(self%g_pair) > 0.0_wp)
    do i = 1, m
      t = self%triple(:, i)
      other = place_of(self, self%conjugate_of(t(1)), self%conjugate_of(t(2)), &
                       self%conjugate_of(t(3)))
      if (other < i) then
        call copy_conjugate(self, self%u_triple, self%g_triple, other, i)
        cycle
      end if
      load = (0.0_wp, 0.0_wp)
      if (size(form%cubic) > 0) then
        load = -arrangements(t)*form%cubic_at(self%x_one(:, t(1)), self%x_one(:, t(2)), &
                                              self%x_one(:, t(3)))
      end if
      if (size(form%quadratic) > 0) then
        do q = 1, 3
          if (repeated(t, q)) cycle
          associate (pair => self%pair_at(t(modulo(q, 3) + 1), t(modulo(q + 1, 3) + 1)))
            load = load - 2.0_wp*form%quadratic_at(self%x_one(:, t(q)), self%x_pair(:, pair))
          end associate
        end do
      end if
      if (form%has_memory()) then
        if (any(abs(load) > 0.0_wp)) load = load*form%retained(self%s_triple(i))
      end if
      if (slow) call slow_changes(self, form, i, load)
      call self%answer(form, self%s_triple(i), maxval(abs(aimag(self%s(t)))), load, &
                       self%u_triple(:, i), self%g_triple(:, i), singular)
      if (singular) then
        call no_stiffness(self%s_triple(i), status)
        return
      end if
    end do
  end subroutine third_order

  !> What changes of second order do: Y_p Y_q changes by g_p,Q Y_q Y_Q, so that product T = q Q
  !! gets L[s_T, s_pq] U_pq, with memory (1 - R)[s_T, s_pq] N_2,pq and, where Y_p Y_q is itself
  !! in the change of a mode j, L[s_T, s_pq, s_j] r_j g_j,pq.
  subroutine slow_changes(self, form, i, load)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: i
    complex(wp), intent(inout) :: load(:)
    complex(wp) :: rate
    integer :: t(3), q, p, rest, pair, j

    t = self%triple(:, i)
    do q = 1, 3
      if (repeated(t, q)) cycle
      rest = self%pair_at(t(modulo(q, 3) + 1), t(modulo(q + 1, 3) + 1))
      do p = 1, 2*self%n_generators
        rate = self%g_pair(p, rest)
        if (.not. abs(rate) > 0.0_wp) cycle
        if (p == t(q)) rate = 2.0_wp*rate
        pair = self%pair_at(p, t(q))
        load = load - rate*matmul(form%operator_between(self%s_triple(i), self%s_pair(pair)), &
                                  self%u_pair(:, pair))
        do j = 1, 2*self%n_generators
          if (.not. abs(self%g_pair(j, pair)) > 0.0_wp) cycle
          load = load - rate*self%g_pair(j, pair)*matmul( &
                 form%second_difference(self%s_triple(i), self%s_pair(pair), self%exponents(j)), &
                 self%right(:, j))
        end do
        if (form%has_memory()) then
          load = load - rate*self%n_pair(:, pair) &
                 *form%retained_between([self%s_triple(i), self%s_pair(pair)])
        end if
      end do
    end do
  end subroutine slow_changes

  subroutine no_stiffness(s, status)
    complex(wp), intent(in) :: s
    type(status_type), intent(out) :: status
    call fail(status, status_input_error, 'system', 'system: no stiffness at the combined ' &
              //'frequency '//show(aimag(s))//', which no resonance of a mode explains')
  end subroutine no_stiffness

  !> The t(q) that stood before is left out: each factor once.
  pure logical function repeated(t, q)
    integer, intent(in) :: t(3), q
    repeated = any(t(:q - 1) == t(q))
  end function repeated

  !> In how many orders the factors can be written.
  pure real(wp) function arrangements(t)
    integer, intent(in) :: t(3)
    arrangements = 6.0_wp
    if (t(1) == t(2) .or. t(2) == t(3)) arrangements = 3.0_wp
    if (t(1) == t(3)) arrangements = 1.0_wp
  end function arrangements

  pure integer function place_of(self, a, b, c)
    class(normal_form_type), intent(in) :: self
    integer, intent(in) :: a, b, c
    integer :: low, high
    low = min(a, b, c)
    high = max(a, b, c)
    place_of = self%triple_at(low, a + b + c - low - high, high)
  end function place_of

  subroutine copy_conjugate(self, u, rates, from, to)
    class(normal_form_type), intent(in) :: self
    complex(wp), intent(inout) :: u(:, :), rates(:, :)
    integer, intent(in) :: from, to
    u(:, to) = conjg(u(:, from))
    rates(:, to) = conjg(cshift(rates(:, from), self%n_generators))
  end subroutine copy_conjugate

end module viscovib_normal_form
