! Optimize: -O3 -fstack-arrays
!> The modulation equations of a normal form, in a frame that rotates with each mode:
!!
!!   Y_j = a_j exp(i W_j t),
!!   a_j' = (s_j - i W_j) a_j + sum_k g_jk exp(i (p_k - W_j) t)
!!          + sum_M g_jM a_M exp(i (W_M - W_j) t),
!!
!! where a_M is the product of the amplitudes of M (1 for a load) and W_M the sum of their
!! frequencies. The frame is the nearest one to the natural frequencies in which every exponential
!! is constant, if there is one: then steady motions are the zeros of the right-hand side. The real
!! amplitude of mode j is 2 |a_j|.
module viscovib_slow_flow
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_normal_products, only: normal_form_type
  use viscovib_polynomial_form, only: polynomial_form_type
  implicit none
  private

  public :: slow_flow_type, flow_eigenvalues, flow_term_type, new_slow_flow, real_matrix, turned

  !> Largest relative difference between frame and natural frequency of a mode in free motion.
  real(wp), parameter :: farthest = 0.5_wp

  type :: flow_term_type
    !> Mode that changes, and the factors: amplitude j > 0, its conjugate -j, or 0
    !! if there is none (a load, or a product of two).
    integer :: row = 0, at(3) = 0
    complex(wp) :: coefficient = (0.0_wp, 0.0_wp)
    !> Frequency of the loads among the factors; W_M - W_row.
    real(wp) :: drive = 0.0_wp, turn = 0.0_wp
    !> Loads among the factors: load k with sign, 0: none.
    integer :: loads(3) = 0
  end type flow_term_type

  type :: slow_flow_type
    integer :: n_modes = 0
    complex(wp), allocatable :: s(:)
    type(flow_term_type), allocatable :: terms(:)
    !> W_j; and whether all terms are constant in this frame.
    real(wp), allocatable :: frame(:)
    logical :: autonomous = .true.
  contains
    procedure :: rates
    procedure :: slopes
    procedure :: turn_frame
  end type slow_flow_type

contains

  subroutine new_slow_flow(flow, normal, form)
    type(slow_flow_type), intent(inout) :: flow
    type(normal_form_type), intent(in) :: normal
    type(polynomial_form_type), intent(in) :: form
    type(flow_term_type), allocatable :: terms(:)
    integer :: pairs(size(normal%pair, 2)), triples(size(normal%triple, 2))
    integer :: i, j, k, n, n_pairs, n_triples

    flow%n_modes = normal%n_modes
    flow%s = normal%exponents(:normal%n_modes)
    call list_changes(normal%g_pair(:normal%n_modes, :), pairs, n_pairs)
    call list_changes(normal%g_triple(:normal%n_modes, :), triples, n_triples)
    allocate (terms(normal%n_modes*(size(normal%direct) + n_pairs + n_triples)))
    n = 0
    do i = 1, size(normal%direct)
      k = normal%direct(i)
      do j = 1, normal%n_modes
        if (.not. abs(normal%g_load(j, k)) > 0.0_wp) cycle
        n = n + 1
        terms(n) = flow_term_type(j, 0, normal%g_load(j, k), form%drives(k), 0.0_wp, [k, 0, 0])
      end do
    end do
    ! Coefficients at the level of rounding errors are set to 0. They are compared with coefficients
    ! of the same number of loads as factors, and so the same units.
    call add_products(normal%pair, normal%g_pair, pairs(:n_pairs))
    call add_products(normal%triple, normal%g_triple, triples(:n_triples))
    flow%terms = terms(:n)
    flow%frame = aimag(flow%s)
    call flow%turn_frame()

  contains

    subroutine add_products(factors, g, which)
      integer, intent(in) :: factors(:, :), which(:)
      complex(wp), intent(in) :: g(:, :)
      !> Largest coefficient of the terms with a given number of loads.
      real(wp) :: largest(0:3), sizes(normal%n_modes, size(which))
      integer :: loads(size(which)), three(3), k
      largest = 0.0_wp
      do k = 1, size(which)
        loads(k) = n_loads(factors(:, which(k)))
        sizes(:, k) = abs(g(:normal%n_modes, which(k)))
        largest(loads(k)) = max(largest(loads(k)), maxval(sizes(:, k)))
      end do
      three = 0
      do k = 1, size(which)
        three(:size(factors, 1)) = factors(:, which(k))
        do j = 1, normal%n_modes
          if (sizes(j, k) > 1.0e-13_wp*largest(loads(k))) call add(three, g(j, which(k)))
        end do
      end do
    end subroutine add_products

    pure integer function n_loads(factors)
      integer, intent(in) :: factors(:)
      n_loads = count(modulo(factors - 1, normal%n_generators) + 1 > normal%n_modes)
    end function n_loads

    subroutine add(factors, coefficient)
      integer, intent(in) :: factors(3)
      complex(wp), intent(in) :: coefficient
      type(flow_term_type) :: new
      integer :: q, place, sign_of, same

      new = flow_term_type(row=j, coefficient=coefficient)
      do q = 1, 3
        if (factors(q) == 0) cycle
        sign_of = merge(1, -1, factors(q) <= normal%n_generators)
        place = modulo(factors(q) - 1, normal%n_generators) + 1
        if (place <= normal%n_modes) then
          new%at(q) = sign_of*place
        else if (aimag(normal%s(place)) > 0.0_wp) then
          ! A constant load is a part of the coefficient.
          new%loads(q) = sign_of*normal%hard(place - normal%n_modes)
          new%drive = new%drive + sign_of*aimag(normal%s(place))
        end if
      end do
      ! Constant loads make terms equal: add their coefficients.
      do same = 1, n
        if (terms(same)%row == j .and. all(terms(same)%at == new%at) &
            .and. all(terms(same)%loads == new%loads)) exit
      end do
      if (same > n) then
        n = n + 1
        terms(n) = new
      else
        terms(same)%coefficient = terms(same)%coefficient + coefficient
      end if
    end subroutine add

  end subroutine new_slow_flow

  !> Products that change a mode.
  pure subroutine list_changes(g, which, n)
    !> Shape (n_modes, n_products).
    complex(wp), intent(in) :: g(:, :)
    integer, intent(out) :: which(:), n
    integer :: k
    n = 0
    do k = 1, size(g, 2)
      if (all(g(:, k) == (0.0_wp, 0.0_wp))) cycle
      n = n + 1
      which(n) = k
    end do
  end subroutine list_changes

  !> The frame nearest to the natural frequencies in which every term is constant: each term
  !! is one linear condition on W - omega. Conditions are added in the order of the terms by
  !! orthogonal projection; after a contradictory one the flow is not autonomous.
  pure subroutine turn_frame(self)
    class(slow_flow_type), intent(inout) :: self
    real(wp) :: basis(self%n_modes, self%n_modes), offset(self%n_modes)
    real(wp) :: condition(self%n_modes), wanted, part
    integer :: i, k, q, n, pass
    logical :: free

    n = 0
    free = all([(all(self%terms(i)%loads == 0), i=1, size(self%terms))])
    self%autonomous = .true.
    self%frame = aimag(self%s)
    do i = 1, size(self%terms)
      associate (t => self%terms(i))
        condition = 0.0_wp
        condition(t%row) = -1.0_wp
        do q = 1, 3
          k = abs(t%at(q))
          if (k > 0) condition(k) = condition(k) + sign(1, t%at(q))
        end do
        wanted = -t%drive - sum(condition*aimag(self%s))
      end associate
      ! A shift is constant in every frame.
      if (.not. any(abs(condition) > 0.0_wp) .and. .not. abs(wanted) > 0.0_wp) cycle
      do pass = 1, 2
        do k = 1, n
          part = sum(basis(:, k)*condition)
          condition = condition - part*basis(:, k)
          wanted = wanted - part*offset(k)
        end do
      end do
      if (norm2(condition) > 1.0e-9_wp) then
        n = n + 1
        offset(n) = wanted/norm2(condition)
        basis(:, n) = condition/norm2(condition)
        ! Without loads, as many conditions as modes admit only a frame of frequencies 0.
        if (free .and. any(abs(matmul(basis(:, :n), offset(:n))) > farthest*aimag(self%s))) then
          n = n - 1
          self%autonomous = .false.
        end if
      else if (abs(wanted) > 1.0e-9_wp*(maxval(aimag(self%s)) + abs(self%terms(i)%drive))) then
        self%autonomous = .false.
      end if
    end do
    do k = 1, n
      self%frame = self%frame + offset(k)*basis(:, k)
    end do
    do i = 1, size(self%terms)
      associate (t => self%terms(i))
        t%turn = t%drive - self%frame(t%row)
        do q = 1, 3
          k = abs(t%at(q))
          if (k > 0) t%turn = t%turn + sign(1, t%at(q))*self%frame(k)
        end do
        ! The remaining frequencies of the constant terms are rounding errors.
        if (self%autonomous) t%turn = 0.0_wp
      end associate
    end do
  end subroutine turn_frame

  !> The rates a'.
  pure subroutine rates(self, t, a, da)
    class(slow_flow_type), intent(in) :: self
    real(wp), intent(in) :: t
    complex(wp), intent(in) :: a(self%n_modes)
    complex(wp), intent(out) :: da(self%n_modes)
    complex(wp) :: value
    integer :: i, q, k

    do i = 1, self%n_modes
      da(i) = (self%s(i) - cmplx(0.0_wp, self%frame(i), wp))*a(i)
    end do
    do i = 1, size(self%terms)
      value = self%terms(i)%coefficient
      do q = 1, 3
        k = self%terms(i)%at(q)
        if (k > 0) value = value*a(k)
        if (k < 0) value = value*conjg(a(-k))
      end do
      if (.not. self%autonomous) value = value*turned(self%terms(i)%turn*t)
      da(self%terms(i)%row) = da(self%terms(i)%row) + value
    end do
  end subroutine rates

  !> da'/da and da'/dconjg(a); at time t if the flow is not autonomous.
  pure subroutine slopes(self, a, by_a, by_conjugate, t)
    class(slow_flow_type), intent(in) :: self
    complex(wp), intent(in) :: a(self%n_modes)
    complex(wp), intent(out), dimension(self%n_modes, self%n_modes) :: by_a, by_conjugate
    real(wp), intent(in), optional :: t
    complex(wp) :: value
    integer :: i, q, k, other

    by_a = (0.0_wp, 0.0_wp)
    by_conjugate = (0.0_wp, 0.0_wp)
    do i = 1, self%n_modes
      by_a(i, i) = self%s(i) - cmplx(0.0_wp, self%frame(i), wp)
    end do
    do i = 1, size(self%terms)
      associate (term => self%terms(i))
        do q = 1, 3
          if (term%at(q) == 0) cycle
          value = term%coefficient
          if (present(t) .and. .not. self%autonomous) value = value*turned(term%turn*t)
          do other = 1, 3
            k = term%at(other)
            if (other == q) cycle
            if (k > 0) value = value*a(k)
            if (k < 0) value = value*conjg(a(-k))
          end do
          k = term%at(q)
          if (k > 0) then
            by_a(term%row, k) = by_a(term%row, k) + value
          else
            by_conjugate(term%row, -k) = by_conjugate(term%row, -k) + value
          end if
        end do
      end associate
    end do
  end subroutine slopes

  !> exp(i angle).
  elemental complex(wp) function turned(angle)
    real(wp), intent(in) :: angle
    turned = cmplx(cos(angle), sin(angle), wp)
  end function turned

  !> Eigenvalues of da' = P da + Q conj(da). An uncoupled mode has s = Re P +- sqrt(|Q|^2 - (Im
  !! P)^2); coupled modes have the eigenvalues of their matrix, NaN if these do not converge.
  pure subroutine flow_eigenvalues(flow, a, values)
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(in) :: a(flow%n_modes)
    complex(wp), intent(out) :: values(2*flow%n_modes)
    complex(wp), dimension(flow%n_modes, flow%n_modes) :: p, q
    complex(wp) :: root
    logical :: alone(flow%n_modes), found
    integer, allocatable :: tied(:)
    real(wp), allocatable :: matrix(:, :)
    integer :: i, k, n

    call flow%slopes(a, p, q)
    n = 0
    do i = 1, flow%n_modes
      alone(i) = .true.
      do k = 1, flow%n_modes
        if (k == i) cycle
        alone(i) = alone(i) .and. .not. (abs(p(i, k)) + abs(q(i, k)) + abs(p(k, i)) &
                                         + abs(q(k, i)) > 0.0_wp)
      end do
      if (.not. alone(i)) cycle
      root = sqrt(cmplx((abs(q(i, i)) - aimag(p(i, i)))*(abs(q(i, i)) + aimag(p(i, i))), 0.0_wp, &
                        wp))
      values(n + 1:n + 2) = real(p(i, i)) + [root, -root]
      n = n + 2
    end do
    tied = pack([(i, i=1, flow%n_modes)],.not. alone)
    if (size(tied) == 0) return
    allocate (matrix(2*size(tied), 2*size(tied)))
    matrix(:, :) = real_matrix(p(tied, tied), q(tied, tied))
    call eigenvalues(matrix, values(n + 1:), found)
    if (.not. found) values(n + 1:) = ieee_value(1.0_wp, ieee_quiet_nan)
  end subroutine flow_eigenvalues

  !> da -> P da + Q conj(da) on real parts, then imaginary ones.
  pure function real_matrix(p, q) result(matrix)
    complex(wp), intent(in) :: p(:, :), q(:, :)
    real(wp) :: matrix(2*size(p, 1), 2*size(p, 1))
    integer :: m
    m = size(p, 1)
    matrix(:m, :m) = real(p + q)
    matrix(:m, m + 1:) = aimag(q - p)
    matrix(m + 1:, :m) = aimag(p + q)
    matrix(m + 1:, m + 1:) = real(p - q)
  end function real_matrix

end module viscovib_slow_flow
