! Optimize: -O3 -fstack-arrays
!> Second and third order of a normal form: the right-hand sides of its products and the responses,
!! as in `viscovib_normal_form`.
module viscovib_normal_orders
  use viscovib_kinds, only: wp
  use viscovib_normal_products, only: normal_form_type, renew
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: answer_triples, need_side, second_sides, second_order, start_third, third_order

  !> Relative distance to an undamped mode's exponent below which the operator L is singular.
  real(wp), parameter :: singular_within = 1.0e-9_wp

contains

  !> R_M of products of two generators.
  subroutine second_sides(self, form)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    complex(wp) :: load(form%n)
    integer :: i, a, b, other, g

    g = 2*self%n_generators
    call renew(self%side_pair, form%n, size(self%pair, 2))
    call renew(self%x_one, form%n_arguments, g)
    call renew(self%n_pair, form%n, merge(size(self%pair, 2), 0, form%has_memory()))
    do a = 1, g
      self%x_one(:, a) = form%arguments_at(self%s(a), self%right(:, a))
    end do
    if (size(form%quadratic) == 0) return
    do i = 1, size(self%pair, 2)
      a = self%pair(1, i)
      b = self%pair(2, i)
      if (self%rests(a) .and. self%rests(b)) cycle
      other = self%mirror_of(self%pair(:, i))
      if (other < i) then
        self%side_pair(:, i) = conjg(self%side_pair(:, other))
        if (form%has_memory()) self%n_pair(:, i) = conjg(self%n_pair(:, other))
        cycle
      end if
      load = -form%quadratic_at(self%x_one(:, a), self%x_one(:, b))
      if (a /= b) load = 2.0_wp*load
      if (form%has_memory()) then
        self%n_pair(:, i) = -load
        if (any(load /= (0.0_wp, 0.0_wp))) load = load*form%retained(self%s_pair(i))
      end if
      self%side_pair(:, i) = load
    end do
  end subroutine second_sides

  subroutine second_order(self, form, status)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    type(status_type), intent(out) :: status
    integer :: i, other, j, k, g

    call set_ok(status)
    g = 2*self%n_generators
    call renew(self%x_pair, form%n_arguments, size(self%pair, 2))
    call renew(self%u_pair, form%n, size(self%pair, 2))
    call renew(self%g_pair, g, size(self%pair, 2))
    if (size(form%quadratic) == 0) return
    do i = 1, size(self%pair, 2)
      if (all(self%rests(self%pair(:, i)))) cycle
      other = self%mirror_of(self%pair(:, i))
      if (other < i) then
        self%u_pair(:, i) = conjg(self%u_pair(:, other))
        call copy_conjugate(self, self%g_pair, other, i)
        self%x_pair(:, i) = conjg(self%x_pair(:, other))
        cycle
      end if
      call answer_product(self, form, self%s_pair(i), self%pair(:, i), self%side_pair(:, i), &
                          self%acts_pair(:, i), self%u_pair(:, i), self%g_pair(:, i), status)
      if (status%failed()) return
      self%x_pair(:, i) = form%arguments_at(self%s_pair(i), self%u_pair(:, i))
      ! In a frame amplitudes are constant.
      if (self%framed) cycle
      do j = 1, g
        if (self%g_pair(j, i) == (0.0_wp, 0.0_wp)) cycle
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

  !> Begin with the products of three generators: no right-hand side is computed yet.
  subroutine start_third(self, form)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    integer :: m
    m = size(self%triple, 2)
    call renew(self%side_triple, form%n, m)
    call renew(self%u_triple, form%n, m)
    call renew(self%g_triple, 2*self%n_generators, m)
    if (allocated(self%has_side)) then
      if (size(self%has_side) /= m) deallocate (self%size_triple, self%has_side, self%answered)
    end if
    if (.not. allocated(self%has_side)) then
      allocate (self%size_triple(form%n_dof, m), self%has_side(m), self%answered(m))
    end if
    self%size_triple = 0.0_wp
    self%has_side = .false.
    self%answered = .false.
    self%used_triples = [integer ::]
    self%slow = .not. self%framed
    if (self%slow) self%slow = any(self%g_pair /= (0.0_wp, 0.0_wp))
  end subroutine start_third

  !> Compute R_M of a product of three generators.
  subroutine need_side(self, form, i)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: i
    complex(wp) :: load(form%n)
    integer :: t(3), q

    if (self%has_side(i)) return
    self%has_side(i) = .true.
    t = self%triple(:, i)
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
      if (any(load /= (0.0_wp, 0.0_wp))) load = load*form%retained(self%s_triple(i))
    end if
    if (self%slow) call slow_changes(self, form, i, load)
    self%side_triple(:, i) = load
  end subroutine need_side

  !> The changes of modes by products of three. In a frame, the coefficients of y follow later.
  subroutine third_order(self, form, status)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    type(status_type), intent(out) :: status
    integer :: i, other
    logical :: singular

    call set_ok(status)
    if (.not. self%framed) then
      call answer(self, form, [(.true., i=1, size(self%answered))], status)
      return
    end if
    do i = 1, size(self%answered)
      if (.not. any(self%acts_triple(:, i))) cycle
      other = self%mirror_of(self%triple(:, i))
      if (other < i) then
        call copy_conjugate(self, self%g_triple, other, i)
        cycle
      end if
      associate (chosen => self%acts_triple(:, i), s => self%s_triple(i))
        call need_side(self, form, i)
        call self%find_rates(form, s, self%side_triple(:, i), &
                             chosen .or. near_product(self, s, self%triple(:, i)), &
                             self%g_triple(:, i), singular)
        where (.not. chosen) self%g_triple(:, i) = (0.0_wp, 0.0_wp)
      end associate
      if (singular) call no_stiffness(self%s_triple(i), status)
      if (singular) return
    end do
  end subroutine third_order

  !> Answer products of three in which at most `n_rest` factors are modes that do not move.
  subroutine answer_triples(self, form, moves, n_rest, status)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    !> Shape (n_modes).
    logical, intent(in) :: moves(:)
    integer, intent(in) :: n_rest
    type(status_type), intent(out) :: status
    logical :: rests(2*self%n_generators), wanted(size(self%triple, 2))
    integer :: i

    rests = .false.
    rests(:self%n_modes) = .not. moves
    rests(self%n_generators + 1:self%n_generators + self%n_modes) = .not. moves
    do i = 1, size(wanted)
      wanted(i) = .not. self%answered(i)
      if (wanted(i)) wanted(i) = count(rests(self%triple(:, i))) <= n_rest
    end do
    call answer(self, form, wanted, status)
  end subroutine answer_triples

  !> The coefficients of products of three that have none yet.
  subroutine answer(self, form, wanted, status)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    !> The same for a product and its conjugate.
    logical, intent(in) :: wanted(:)
    type(status_type), intent(out) :: status
    integer :: i, other

    call set_ok(status)
    if (.not. any(wanted)) return
    do i = 1, size(wanted)
      if (.not. wanted(i)) cycle
      other = self%mirror_of(self%triple(:, i))
      if (other < i) then
        self%u_triple(:, i) = conjg(self%u_triple(:, other))
        call copy_conjugate(self, self%g_triple, other, i)
      else
        call need_side(self, form, i)
        call answer_product(self, form, self%s_triple(i), self%triple(:, i), &
                            self%side_triple(:, i), self%acts_triple(:, i), self%u_triple(:, i), &
                            self%g_triple(:, i), status)
        if (status%failed()) return
      end if
      self%answered(i) = .true.
      self%size_triple(:, i) = abs(self%u_triple(:form%n_dof, i))
    end do
    self%used_triples = pack([(i, i=1, size(wanted))], any(self%size_triple > 0.0_wp, 1))
  end subroutine answer

  !> The response to the right-hand side of one product; fails if the equations are singular.
  subroutine answer_product(self, form, s, factors, side, chosen, u, g, status)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    complex(wp), intent(in) :: s, side(:)
    integer, intent(in) :: factors(:)
    !> Modes and conjugates selected as resonant.
    logical, intent(in) :: chosen(:)
    complex(wp), intent(out) :: u(:), g(:)
    type(status_type), intent(out) :: status
    logical :: singular
    call set_ok(status)
    call self%answer(form, s, side, chosen .or. near_product(self, s, factors), u, g, singular)
    ! A term that is not constant in the frame contributes no change.
    if (self%framed) where (.not. chosen) g = (0.0_wp, 0.0_wp)
    if (singular) call no_stiffness(s, status)
  end subroutine answer_product

  !> Resonance by the tolerance; in a frame only if the operator L alone is singular.
  pure function near_product(self, s, factors) result(acts)
    class(normal_form_type), intent(in) :: self
    complex(wp), intent(in) :: s
    integer, intent(in) :: factors(:)
    logical :: acts(2*self%n_generators)
    integer :: a
    do a = 1, size(acts)
      if (self%framed) then
        acts(a) = modulo(a - 1, self%n_generators) < self%n_modes .and. &
                  abs(aimag(s - self%exponents(a))) <= singular_within*size_of(self%exponents(a))
        if (acts(a)) then
          acts(a) = abs(s - self%exponents(a)) <= singular_within*abs(self%exponents(a))
        end if
      else
        acts(a) = self%near(s, maxval(abs(aimag(self%s(factors)))), a)
      end if
    end do

  contains

    !> At least the modulus.
    pure real(wp) function size_of(z)
      complex(wp), intent(in) :: z
      size_of = abs(real(z)) + abs(aimag(z))
    end function size_of

  end function near_product

  !> Effect of changes of second order: Y_p Y_q changes by g_p,Q Y_q Y_Q, so that product T = q Q
  !! gets L[s_T, s_pq] U_pq, with memory (1 - R)[s_T, s_pq] N_2,pq, and, if the change of a mode j
  !! contains Y_p Y_q, L[s_T, s_pq, s_j] r_j g_j,pq.
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
        if (rate == (0.0_wp, 0.0_wp)) cycle
        if (p == t(q)) rate = 2.0_wp*rate
        pair = self%pair_at(p, t(q))
        load = load - rate*matmul(form%operator_between(self%s_triple(i), self%s_pair(pair)), &
                                  self%u_pair(:, pair))
        do j = 1, 2*self%n_generators
          if (self%g_pair(j, pair) == (0.0_wp, 0.0_wp)) cycle
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
    call fail(status, status_input_error, 'system', 'system: dynamic stiffness 0 at the combined ' &
              //'frequency '//show(aimag(s))//', which is no resonance of a mode')
  end subroutine no_stiffness

  !> True if t(q) occurred before: each factor is used once.
  pure logical function repeated(t, q)
    integer, intent(in) :: t(3), q
    repeated = any(t(:q - 1) == t(q))
  end function repeated

  !> Number of permutations of the factors.
  pure real(wp) function arrangements(t)
    integer, intent(in) :: t(3)
    arrangements = 6.0_wp
    if (t(1) == t(2) .or. t(2) == t(3)) arrangements = 3.0_wp
    if (t(1) == t(3)) arrangements = 1.0_wp
  end function arrangements

  !> The changes of modes by the conjugate of a product.
  pure subroutine copy_conjugate(self, rates, from, to)
    class(normal_form_type), intent(in) :: self
    complex(wp), intent(inout) :: rates(:, :)
    integer, intent(in) :: from, to
    associate (n => self%n_generators)
      rates(:n, to) = conjg(rates(n + 1:, from))
      rates(n + 1:, to) = conjg(rates(:n, from))
    end associate
  end subroutine copy_conjugate

end module viscovib_normal_orders
