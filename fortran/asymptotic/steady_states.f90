! Optimize: -O2 -fvect-cost-model=dynamic -fstack-arrays
!> All steady motions of a slow flow that is autonomous in its frame.
!!
!! The terms determine which modes are active. There are four cases, by the coupling of modes. One
!! mode with its own shift, sigma a + gamma |a|^2 a + g = 0, is a cubic equation for x = |a|^2.
!! Several modes that only shift each other are equations of third degree for their squares. So are
!! a driven mode and modes that it excites parametrically (`viscovib_parametric_modes`); with one
!! such mode they are a polynomial in one unknown. The general case is solved for amplitudes and
!! conjugates as independent unknowns. `viscovib_homotopy` finds all solutions of several equations,
!! with amplitudes in a natural unit.
module viscovib_steady_states
  use viscovib_homotopy, only: family_type, max_unknowns, new_family
  use viscovib_kinds, only: wp
  use viscovib_parametric_modes, only: find_parametric, max_pairs, pair_type, parametric_type
  use viscovib_polynomial_zeros, only: cubic_roots
  use viscovib_slow_flow, only: flow_term_type, slow_flow_type
  use viscovib_solution_paths, only: infinite, size_of
  use viscovib_sorting, only: order_of
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: steady_solver_type, natural_unit

  integer, parameter, public :: max_steady = 729

  !> All patterns of terms so far: they recur from one value of the varied quantity to the next, and
  !! the former solutions are reused.
  type :: steady_solver_type
    type(family_type), allocatable, private :: families(:)
  contains
    procedure :: solve
    procedure, private :: choose_family
    procedure, private :: solve_parametric
    procedure, private :: solve_squares
  end type steady_solver_type

contains

  !> Amplitudes of all steady motions, the smallest first; 0 for inactive modes.
  subroutine solve(self, flow, a, n_found, status, cancel)
    class(steady_solver_type), intent(inout) :: self
    type(slow_flow_type), intent(in) :: flow
    !> Shape (n_modes, max_steady); columns beyond n_found are not changed.
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    type(status_type), intent(out) :: status
    !> A value other than 0, possibly set by another thread, cancels the computation.
    integer, intent(inout) :: cancel
    integer, allocatable :: active(:), row(:), at(:, :)
    complex(wp), allocatable :: coefficients(:), x(:, :), sigma(:), gamma(:, :), load(:)
    type(parametric_type) :: modes
    real(wp) :: unit
    integer :: j, n, n_solutions, which
    logical :: shifts_only, is_parametric

    call set_ok(status)
    call find_moving(flow, active, shifts_only)
    n = size(active)
    a(:, 1) = (0.0_wp, 0.0_wp)
    n_found = 1
    if (n == 0) return
    if (n > max_unknowns/2) then
      call fail(status, status_input_error, 'system', 'system: '//show(n)//' modes move together ' &
                //'in resonance; steady motions are found for at most '//show(max_unknowns/2))
      return
    end if
    if (n == 1 .and. shifts_only) then
      call shifts(flow, active, 1.0_wp, sigma, gamma, load)
      if (abs(load(1)) > 0.0_wp) call solve_cubic(sigma(1), gamma(1, 1), load(1), active(1), &
                                                  1.0_wp, a, n_found)
      a(:, :n_found) = a(:, order_of(sum(abs(a(:, :n_found))**2, 1)))
      return
    end if
    unit = natural_unit(flow, active)
    call find_parametric(flow, active, unit, modes, is_parametric)
    if (is_parametric) then
      call self%solve_parametric(modes, unit, a, n_found, cancel)
    else if (shifts_only) then
      call shifts(flow, active, unit, sigma, gamma, load)
      call self%solve_squares(sigma, gamma, load, spread(0, 1, n), [(.true., j=1, n)], unit, x, &
                              n_solutions, cancel)
      call from_squares(sigma, gamma, load, active, unit, real(x(:, :n_solutions)), a, n_found)
    else
      call general_terms(flow, active, unit, row, at, coefficients)
      call self%choose_family(2*n, .true., row, at, which, cancel)
      associate (family => self%families(which))
        allocate (x(family%system%n, size(family%solutions, 2)))
        call family%solve_member(coefficients, unit, x, n_solutions, cancel)
      end associate
      call from_conjugates(active, unit, x(:, :n_solutions), a, n_found)
    end if
    a(:, :n_found) = a(:, order_of(sum(abs(a(:, :n_found))**2, 1)))
  end subroutine solve

  !> The index of the family with these terms.
  subroutine choose_family(self, n, conjugates, row, at, which, cancel)
    class(steady_solver_type), intent(inout) :: self
    integer, intent(in) :: n, row(:), at(:, :)
    logical, intent(in) :: conjugates
    integer, intent(out) :: which
    integer, intent(inout) :: cancel
    type(family_type), allocatable :: more(:)

    if (.not. allocated(self%families)) allocate (self%families(0))
    do which = 1, size(self%families)
      if (self%families(which)%is_of(n, row, at)) return
    end do
    allocate (more(which))
    more(:which - 1) = self%families
    call new_family(more(which), n, conjugates, row, at, cancel)
    call move_alloc(more, self%families)
  end subroutine choose_family

  !> |gamma|^2 x^3 + 2 Re(conj(sigma) gamma) x^2 + |sigma|^2 x - |g|^2 = 0, amplitudes in `unit`.
  pure subroutine solve_cubic(sigma, gamma, load, mode, unit, a, n_found)
    complex(wp), intent(in) :: sigma, gamma, load
    integer, intent(in) :: mode
    real(wp), intent(in) :: unit
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    complex(wp) :: bottom
    real(wp) :: x(3)
    integer :: i, n

    call cubic_roots([abs(gamma)**2, 2.0_wp*real(conjg(sigma)*gamma), abs(sigma)**2, &
                      -abs(load)**2], x, n)
    n_found = 0
    do i = 1, n
      if (x(i) < 0.0_wp) cycle
      bottom = sigma + gamma*x(i)
      if (.not. abs(bottom) > 0.0_wp) cycle
      n_found = n_found + 1
      a(:, n_found) = (0.0_wp, 0.0_wp)
      a(mode, n_found) = -load/bottom*unit
    end do
  end subroutine solve_cubic

  !> A driven mode with and without each of the modes that it excites.
  subroutine solve_parametric(self, modes, unit, a, n_found, cancel)
    class(steady_solver_type), intent(inout) :: self
    type(parametric_type), intent(in) :: modes
    real(wp), intent(in) :: unit
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    integer, intent(inout) :: cancel
    type(pair_type) :: pair
    complex(wp) :: both(2, max_pairs)
    complex(wp), allocatable :: x(:, :)
    integer :: i, j, n, n_solutions

    n = size(modes%modes)
    call solve_cubic(modes%sigma(1), modes%gamma(1, 1), modes%g, modes%modes(1), unit, a, n_found)
    do j = 2, n
      pair = modes%pair(j)
      call pair%both_move(both, n_solutions)
      do i = 1, n_solutions
        call add([modes%modes(1), modes%modes(j)], both(:, i))
      end do
    end do
    if (n == 2) return
    call self%solve_squares(modes%sigma, modes%gamma, [modes%g, modes%k(2:)], [0, modes%m(2:)], &
                            [(j == 1, j=1, n)], unit, x, n_solutions, cancel)
    do i = 1, n_solutions
      if (all(real(x(:, i)) > 0.0_wp)) call add_all(real(x(:, i)))
    end do

  contains

    subroutine add(places, amplitudes)
      integer, intent(in) :: places(:)
      complex(wp), intent(in) :: amplitudes(:)
      if (size_of(amplitudes) > infinite .or. n_found == size(a, 2)) return
      n_found = n_found + 1
      a(:, n_found) = (0.0_wp, 0.0_wp)
      a(places, n_found) = amplitudes*unit
    end subroutine add

    !> All modes move; each excited one has two phases.
    subroutine add_all(squares)
      real(wp), intent(in) :: squares(:)
      complex(wp) :: l(n), moving(n)
      integer :: code, q
      l = modes%sigma + matmul(modes%gamma, squares)
      if (.not. abs(l(1)) > 0.0_wp) return
      moving(1) = -modes%g/l(1)
      moving(2:) = sqrt(-conjg(l(2:)/modes%k(2:))*squares(2:)/conjg(moving(1))**modes%m(2:))
      do code = 0, 2**(n - 1) - 1
        call add(modes%modes, [moving(1), (merge(-moving(q), moving(q), btest(code, q - 2)), &
                                           q=2, n)])
      end do
    end subroutine add_all

  end subroutine solve_parametric

  !> Real x of |L_j|^2 x_j^(1 or 0) = |g_j|^2 x_1^m_j, L_j = sigma_j + sum_k gamma_jk x_k, that are
  !! not negative; x_j is a factor where `times` is true.
  subroutine solve_squares(self, sigma, gamma, load, m, times, unit, x, n_found, cancel)
    class(steady_solver_type), intent(inout) :: self
    complex(wp), intent(in) :: sigma(:), gamma(:, :), load(:)
    integer, intent(in) :: m(:)
    logical, intent(in) :: times(:)
    !> Unit of the amplitudes.
    real(wp), intent(in) :: unit
    complex(wp), allocatable, intent(out) :: x(:, :)
    integer, intent(out) :: n_found
    integer, intent(inout) :: cancel
    integer, allocatable :: row(:), at(:, :)
    complex(wp), allocatable :: coefficients(:)
    integer :: i, n, which

    call square_terms(sigma, gamma, load, m, times, row, at, coefficients)
    call self%choose_family(size(sigma), .false., row, at, which, cancel)
    associate (family => self%families(which))
      allocate (x(family%system%n, size(family%solutions, 2)))
      call family%solve_member(coefficients, unit**2, x, n, cancel)
    end associate
    n_found = 0
    do i = 1, n
      if (maxval(abs(aimag(x(:, i)))) > 1.0e-7_wp*maxval(abs(x(:, i)))) cycle
      if (minval(real(x(:, i))) < -1.0e-9_wp*maxval(abs(x(:, i)))) cycle
      n_found = n_found + 1
      x(:, n_found) = x(:, i)
    end do
  end subroutine solve_squares

  !> Amplitudes from their squares x.
  pure subroutine from_squares(sigma, gamma, load, active, unit, x, a, n_found)
    complex(wp), intent(in) :: sigma(:), gamma(:, :), load(:)
    integer, intent(in) :: active(:)
    real(wp), intent(in) :: unit, x(:, :)
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    complex(wp) :: bottom(size(active))
    integer :: i

    n_found = 0
    do i = 1, size(x, 2)
      bottom = sigma + matmul(gamma, x(:, i))
      if (.not. all(abs(bottom) > 0.0_wp) .or. n_found == size(a, 2)) cycle
      n_found = n_found + 1
      a(:, n_found) = (0.0_wp, 0.0_wp)
      a(active, n_found) = -load/bottom*unit
    end do
  end subroutine from_squares

  !> Amplitudes from x, amplitudes and conjugates: those that are conjugates of each other.
  pure subroutine from_conjugates(active, unit, x, a, n_found)
    integer, intent(in) :: active(:)
    real(wp), intent(in) :: unit
    complex(wp), intent(in) :: x(:, :)
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    integer :: i, m

    m = size(active)
    n_found = 0
    do i = 1, size(x, 2)
      ! Most are not: their sums of parts, at most the root of 2 times the moduli, show it.
      if (size_of(x(:m, i) - conjg(x(m + 1:, i))) > 2.0e-7_wp*max(size_of(x(:, i)), &
                                                                  1.0e-6_wp)) cycle
      if (maxval(abs(x(:m, i) - conjg(x(m + 1:, i)))) > 1.0e-7_wp*max(maxval(abs(x(:, i))), &
                                                                      1.0e-6_wp)) cycle
      if (n_found == size(a, 2)) exit
      n_found = n_found + 1
      a(:, n_found) = (0.0_wp, 0.0_wp)
      a(active, n_found) = 0.5_wp*(x(:m, i) + conjg(x(m + 1:, i)))*unit
    end do
  end subroutine from_conjugates

  !> Find the active modes, and whether their terms only shift exponents.
  pure subroutine find_moving(flow, active, shifts_only)
    type(slow_flow_type), intent(in) :: flow
    integer, allocatable, intent(out) :: active(:)
    logical, intent(out) :: shifts_only
    logical :: moves(flow%n_modes)
    integer :: i, round

    moves = .false.
    do round = 1, flow%n_modes + 1
      do i = 1, size(flow%terms)
        call spread_motion(flow%terms(i), moves)
      end do
    end do
    active = pack([(i, i=1, flow%n_modes)], moves)
    shifts_only = .true.
    do i = 1, size(flow%terms)
      associate (t => flow%terms(i))
        if (.not. moves(t%row)) cycle
        shifts_only = shifts_only .and. (is_shift(t) .or. all(t%at == 0))
      end associate
    end do
  end subroutine find_moving

  !> True for the row itself times squares of moduli or of loads: a shift of the exponent.
  pure logical function is_shift(t)
    type(flow_term_type), intent(in) :: t
    integer :: net(3), q
    net = t%at
    is_shift = .false.
    do q = 1, 3
      if (net(q) /= t%row) cycle
      net(q) = 0
      exit
    end do
    if (q > 3) return
    is_shift = sum(net) == 0 .and. sum(t%loads) == 0 .and. count(net > 0) == count(net < 0) &
               .and. count(t%loads > 0) == count(t%loads < 0)
  end function is_shift

  !> A mode is active if a load acts on it, or if a term other than a shift couples it to an active
  !! mode or to a load.
  pure subroutine spread_motion(t, moves)
    type(flow_term_type), intent(in) :: t
    logical, intent(inout) :: moves(:)
    logical :: alive
    integer :: q
    if (is_shift(t)) return
    alive = moves(t%row) .or. any(t%loads /= 0)
    do q = 1, 3
      if (t%at(q) /= 0) alive = alive .or. moves(abs(t%at(q)))
    end do
    if (.not. alive) return
    moves(t%row) = .true.
    do q = 1, 3
      if (t%at(q) /= 0) moves(abs(t%at(q))) = .true.
    end do
  end subroutine spread_motion

  !> The smallest amplitude at which nonlinear terms of one degree are as large as the loads or the
  !! detuning.
  pure real(wp) function natural_unit(flow, active) result(unit)
    type(slow_flow_type), intent(in) :: flow
    !> Numbers of the active modes.
    integer, intent(in) :: active(:)
    real(wp) :: load, linear, quadratic, cubic
    integer :: i, j

    load = 0.0_wp
    linear = 0.0_wp
    quadratic = 0.0_wp
    cubic = 0.0_wp
    do i = 1, size(active)
      j = active(i)
      linear = max(linear, abs(flow%s(j) - cmplx(0.0_wp, flow%frame(j), wp)))
    end do
    do i = 1, size(flow%terms)
      associate (t => flow%terms(i))
        if (.not. any(active == t%row)) cycle
        select case (count(t%at /= 0))
        case (0)
          load = max(load, abs(t%coefficient))
        case (1)
          linear = max(linear, abs(t%coefficient))
        case (2)
          quadratic = max(quadratic, abs(t%coefficient))
        case default
          cubic = max(cubic, abs(t%coefficient))
        end select
      end associate
    end do
    unit = huge(unit)
    if (quadratic > 0.0_wp) unit = max(sqrt(load/quadratic), linear/quadratic)
    if (cubic > 0.0_wp) unit = min(unit, max((load/cubic)**(1.0_wp/3.0_wp), sqrt(linear/cubic)))
    if (.not. (quadratic > 0.0_wp .or. cubic > 0.0_wp) .and. linear > 0.0_wp) unit = load/linear
    if (.not. (unit > 0.0_wp .and. unit < huge(unit))) unit = 1.0_wp
  end function natural_unit

  !> The equations of `solve_squares`.
  subroutine square_terms(sigma, gamma, load, m_of, times, row, at, coefficients)
    complex(wp), intent(in) :: sigma(:), gamma(:, :), load(:)
    integer, intent(in) :: m_of(:)
    logical, intent(in) :: times(:)
    integer, allocatable, intent(out) :: row(:), at(:, :)
    complex(wp), allocatable, intent(out) :: coefficients(:)
    real(wp) :: scale
    integer :: j, k, l, n, m, own

    n = size(sigma)
    allocate (row(n*(2 + n + n*(n + 1)/2)), at(3, n*(2 + n + n*(n + 1)/2)))
    allocate (coefficients(size(row)))
    m = 0
    do j = 1, n
      own = merge(j, 0, times(j))
      scale = max(abs(sigma(j))**2, maxval(abs(gamma(j, :)))**2, abs(load(j))**2)
      call add(j, [merge(1, 0, m_of(j) > 0), merge(1, 0, m_of(j) > 1), 0], -abs(load(j))**2/scale)
      call add(j, [own, 0, 0], abs(sigma(j))**2/scale)
      do k = 1, n
        call add(j, [own, k, 0], 2.0_wp*real(conjg(sigma(j))*gamma(j, k))/scale)
        do l = k, n
          call add(j, [own, k, l], real(gamma(j, k)*conjg(gamma(j, l)))*merge(1, 2, k == l)/scale)
        end do
      end do
    end do

  contains

    subroutine add(equation, places, value)
      integer, intent(in) :: equation, places(3)
      real(wp), intent(in) :: value
      m = m + 1
      row(m) = equation
      at(:, m) = places
      coefficients(m) = cmplx(value, 0.0_wp, wp)
    end subroutine add

  end subroutine square_terms

  !> sigma_j a_j + sum_k gamma_jk |a_k|^2 a_j + g_j = 0, amplitudes in `unit`.
  pure subroutine shifts(flow, active, unit, sigma, gamma, load)
    type(slow_flow_type), intent(in) :: flow
    !> Numbers of the active modes.
    integer, intent(in) :: active(:)
    !> Unit of the amplitudes.
    real(wp), intent(in) :: unit
    complex(wp), allocatable, intent(out) :: sigma(:), gamma(:, :), load(:)
    integer :: i, j, k, q, n

    n = size(active)
    allocate (sigma(n), gamma(n, n), load(n), source=(0.0_wp, 0.0_wp))
    do j = 1, n
      k = active(j)
      sigma(j) = flow%s(k) - cmplx(0.0_wp, flow%frame(k), wp)
    end do
    do i = 1, size(flow%terms)
      associate (t => flow%terms(i))
        j = findloc(active, t%row, 1)
        if (j == 0) cycle
        select case (count(t%at /= 0))
        case (0)
          load(j) = load(j) + t%coefficient/unit
        case (1)
          sigma(j) = sigma(j) + t%coefficient
        case default
          do q = 1, 3
            if (t%at(q) >= 0) cycle
            k = findloc(active, -t%at(q), 1)
            if (k > 0) gamma(j, k) = gamma(j, k) + t%coefficient*unit**2
          end do
        end select
      end associate
    end do
  end subroutine shifts

  !> The flow of the active modes; unknowns a_1..a_n, followed by their conjugates.
  subroutine general_terms(flow, active, unit, row, at, coefficients)
    type(slow_flow_type), intent(in) :: flow
    !> Numbers of the active modes.
    integer, intent(in) :: active(:)
    !> Unit of the amplitudes.
    real(wp), intent(in) :: unit
    integer, allocatable, intent(out) :: row(:), at(:, :)
    complex(wp), allocatable, intent(out) :: coefficients(:)
    complex(wp) :: value
    real(wp) :: scale(2*size(active))
    integer :: i, j, k, n, m, q, places(3), mirrored(3)
    logical :: inside

    n = size(active)
    allocate (row(2*(n + size(flow%terms))), at(3, 2*(n + size(flow%terms))))
    allocate (coefficients(size(row)))
    m = 0
    do j = 1, n
      k = active(j)
      value = flow%s(k) - cmplx(0.0_wp, flow%frame(k), wp)
      call add(j, [j, 0, 0], value)
      call add(j + n, [j + n, 0, 0], conjg(value))
    end do
    do i = 1, size(flow%terms)
      associate (t => flow%terms(i))
        j = findloc(active, t%row, 1)
        if (j == 0) cycle
        places = 0
        mirrored = 0
        inside = .true.
        do q = 1, 3
          if (t%at(q) == 0) cycle
          k = findloc(active, abs(t%at(q)), 1)
          inside = inside .and. k > 0
          places(q) = merge(k, k + n, t%at(q) > 0)
          mirrored(q) = merge(k + n, k, t%at(q) > 0)
        end do
        if (.not. inside) cycle
        value = t%coefficient*unit**(count(t%at /= 0) - 1)
        call add(j, places, value)
        call add(j + n, mirrored, conjg(value))
      end associate
    end do
    row = row(:m)
    at = at(:, :m)
    coefficients = coefficients(:m)
    scale = 0.0_wp
    do i = 1, m
      scale(row(i)) = max(scale(row(i)), abs(coefficients(i)))
    end do
    coefficients = coefficients/scale(row)

  contains

    subroutine add(equation, which, term)
      integer, intent(in) :: equation, which(3)
      complex(wp), intent(in) :: term
      m = m + 1
      row(m) = equation
      at(:, m) = which
      coefficients(m) = term
    end subroutine add

  end subroutine general_terms

end module viscovib_steady_states
