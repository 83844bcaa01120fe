!> All steady motions of a slow flow that stands still in its frame, and their stability.
!!
!! Which modes can move at all follows from the terms. Three ways, by what couples them:
!! one mode with its own shift, sigma a + gamma |a|^2 a + g = 0, is a cubic equation for
!! x = |a|^2; several modes that only shift each other are equations of third degree for
!! their squares; the rest is solved for amplitudes and conjugates as independent unknowns.
!! The last two by `viscovib_homotopy`, which finds all solutions.
module viscovib_steady_states
  use viscovib_homotopy, only: family_type, max_unknowns, new_family
  use viscovib_kinds, only: wp
  use viscovib_slow_flow, only: flow_term_type, slow_flow_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: steady_solver_type, new_steady_solver

  integer, parameter, public :: max_steady = 729
  integer, parameter :: kind_none = 0, kind_one = 1, kind_squares = 2, kind_general = 3

  type :: steady_solver_type
    !> Modes that can move, as their numbers.
    integer, allocatable :: active(:)
    integer :: kind = kind_none
    !> Amplitudes are in units of this.
    real(wp) :: unit = 1.0_wp
    type(family_type), private :: family
  contains
    procedure :: solve
    procedure, private :: solve_squares
    procedure, private :: solve_general
  end type steady_solver_type

contains

  !> From the flow at one value of what will vary; its terms stay, their coefficients may not.
  !! A solver that was made for the same terms keeps what it knows.
  subroutine new_steady_solver(solver, flow, status, cancel)
    type(steady_solver_type), intent(inout) :: solver
    type(slow_flow_type), intent(in) :: flow
    type(status_type), intent(out) :: status
    !> Not 0, perhaps set by another thread, gives up.
    integer, intent(inout), volatile :: cancel
    integer, allocatable :: row(:), at(:, :)
    complex(wp), allocatable :: coefficients(:)
    logical :: moves(flow%n_modes), shifts_only
    integer :: i, n

    solver%kind = kind_none
    solver%unit = 1.0_wp
    call set_ok(status)
    moves = .false.
    do n = 1, flow%n_modes + 1
      do i = 1, size(flow%terms)
        call spread_motion(flow%terms(i), moves)
      end do
    end do
    solver%active = pack([(i, i=1, flow%n_modes)], moves)
    shifts_only = .true.
    do i = 1, size(flow%terms)
      associate (t => flow%terms(i))
        if (.not. moves(t%row)) cycle
        shifts_only = shifts_only .and. (is_shift(t) .or. all(t%at == 0))
      end associate
    end do
    n = size(solver%active)
    if (n == 0) return
    if (n == 1 .and. shifts_only) then
      solver%kind = kind_one
    else if (n <= max_unknowns/2) then
      solver%kind = merge(kind_squares, kind_general, shifts_only)
      solver%unit = natural_unit(solver, flow)
      if (shifts_only) then
        call square_terms(solver, flow, row, at, coefficients)
        if (.not. same_terms(solver%family, n, row, at)) then
          call new_family(solver%family, n, row, at, cancel)
        end if
      else
        call general_terms(solver, flow, row, at, coefficients)
        n = 2*n
        if (.not. same_terms(solver%family, n, row, at)) then
          call new_family(solver%family, n, row, at, cancel)
        end if
      end if
    else
      call fail(status, status_input_error, 'system', 'system: '//show(n)//' modes move together ' &
                //'in resonance; steady motions are found for at most '//show(max_unknowns/2))
    end if
  end subroutine new_steady_solver

  pure logical function same_terms(family, n, row, at)
    type(family_type), intent(in) :: family
    integer, intent(in) :: n, row(:), at(:, :)
    same_terms = family%n == n .and. allocated(family%row)
    if (same_terms) same_terms = size(family%row) == size(row)
    if (same_terms) same_terms = all(family%row == row) .and. all(family%at == at)
  end function same_terms

  !> row, times squares of moduli and loads against themselves: a shift of the exponent.
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

  !> A mode moves if a load acts on it, or if a term other than a shift ties it to one that
  !! moves or to a load.
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

  !> The amplitude at which nonlinear terms weigh as much as the loads or the detuning.
  pure real(wp) function natural_unit(solver, flow) result(unit)
    type(steady_solver_type), intent(in) :: solver
    type(slow_flow_type), intent(in) :: flow
    real(wp) :: load, linear, quadratic, cubic
    integer :: i, j

    load = 0.0_wp
    linear = 0.0_wp
    quadratic = 0.0_wp
    cubic = 0.0_wp
    do i = 1, size(solver%active)
      j = solver%active(i)
      linear = max(linear, abs(flow%s(j) - cmplx(0.0_wp, flow%frame(j), wp)))
    end do
    do i = 1, size(flow%terms)
      associate (t => flow%terms(i))
        if (.not. any(solver%active == t%row)) cycle
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
    unit = 0.0_wp
    if (quadratic > 0.0_wp) unit = max(sqrt(load/quadratic), linear/quadratic)
    if (cubic > 0.0_wp .and. .not. unit > 0.0_wp) then
      unit = max((load/cubic)**(1.0_wp/3.0_wp), sqrt(linear/cubic))
    end if
    if (.not. unit > 0.0_wp) unit = 1.0_wp
    if (.not. (quadratic > 0.0_wp .or. cubic > 0.0_wp) .and. linear > 0.0_wp) unit = load/linear
    if (.not. unit > 0.0_wp) unit = 1.0_wp
  end function natural_unit

  !> x_j |sigma_j + sum_k gamma_jk x_k|^2 - |g_j|^2 = 0 for the squares in units.
  subroutine square_terms(solver, flow, row, at, coefficients)
    class(steady_solver_type), intent(in) :: solver
    type(slow_flow_type), intent(in) :: flow
    integer, allocatable, intent(out) :: row(:), at(:, :)
    complex(wp), allocatable, intent(out) :: coefficients(:)
    complex(wp) :: sigma(size(solver%active)), gamma(size(solver%active), size(solver%active))
    complex(wp) :: load(size(solver%active))
    real(wp) :: scale
    integer :: j, k, l, n, m

    call shifts(solver, flow, sigma, gamma, load)
    n = size(solver%active)
    allocate (row(n*(2 + n + n*(n + 1)/2)), at(3, n*(2 + n + n*(n + 1)/2)))
    allocate (coefficients(size(row)))
    m = 0
    do j = 1, n
      scale = max(abs(sigma(j))**2, maxval(abs(gamma(j, :)))**2, abs(load(j))**2)
      call add(j, [0, 0, 0], -abs(load(j))**2/scale)
      call add(j, [j, 0, 0], abs(sigma(j))**2/scale)
      do k = 1, n
        call add(j, [j, k, 0], 2.0_wp*real(conjg(sigma(j))*gamma(j, k))/scale)
        do l = k, n
          call add(j, [j, k, l], real(gamma(j, k)*conjg(gamma(j, l)))*merge(1, 2, k == l)/scale)
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

  !> sigma_j a_j + sum_k gamma_jk |a_k|^2 a_j + g_j = 0, amplitudes in units.
  pure subroutine shifts(solver, flow, sigma, gamma, load)
    class(steady_solver_type), intent(in) :: solver
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(out) :: sigma(:), gamma(:, :), load(:)
    integer :: i, j, k, q, n

    n = size(solver%active)
    gamma = (0.0_wp, 0.0_wp)
    load = (0.0_wp, 0.0_wp)
    do j = 1, n
      k = solver%active(j)
      sigma(j) = flow%s(k) - cmplx(0.0_wp, flow%frame(k), wp)
    end do
    do i = 1, size(flow%terms)
      associate (t => flow%terms(i))
        j = findloc(solver%active, t%row, 1)
        if (j == 0) cycle
        select case (count(t%at /= 0))
        case (0)
          load(j) = load(j) + t%coefficient/solver%unit
        case (1)
          sigma(j) = sigma(j) + t%coefficient
        case default
          do q = 1, 3
            if (t%at(q) >= 0) cycle
            k = findloc(solver%active, -t%at(q), 1)
            if (k > 0) gamma(j, k) = gamma(j, k) + t%coefficient*solver%unit**2
          end do
        end select
      end associate
    end do
  end subroutine shifts

  !> The flow of the active modes, unknowns a_1..a_n, conjugates after them.
  subroutine general_terms(solver, flow, row, at, coefficients)
    class(steady_solver_type), intent(in) :: solver
    type(slow_flow_type), intent(in) :: flow
    integer, allocatable, intent(out) :: row(:), at(:, :)
    complex(wp), allocatable, intent(out) :: coefficients(:)
    complex(wp) :: value
    real(wp) :: scale(2*size(solver%active))
    integer :: i, j, k, n, m, q, places(3), mirrored(3)
    logical :: inside

    n = size(solver%active)
    allocate (row(2*(n + size(flow%terms))), at(3, 2*(n + size(flow%terms))))
    allocate (coefficients(size(row)))
    m = 0
    do j = 1, n
      k = solver%active(j)
      value = flow%s(k) - cmplx(0.0_wp, flow%frame(k), wp)
      call add(j, [j, 0, 0], value)
      call add(j + n, [j + n, 0, 0], conjg(value))
    end do
    do i = 1, size(flow%terms)
      associate (t => flow%terms(i))
        j = findloc(solver%active, t%row, 1)
        if (j == 0) cycle
        places = 0
        mirrored = 0
        inside = .true.
        do q = 1, 3
          if (t%at(q) == 0) cycle
          k = findloc(solver%active, abs(t%at(q)), 1)
          inside = inside .and. k > 0
          places(q) = merge(k, k + n, t%at(q) > 0)
          mirrored(q) = merge(k + n, k, t%at(q) > 0)
        end do
        if (.not. inside) cycle
        value = t%coefficient*solver%unit**(count(t%at /= 0) - 1)
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

  !> Amplitudes of all steady motions, the smallest first; modes that cannot move are 0.
  subroutine solve(self, flow, a, n_found, cancel)
    class(steady_solver_type), intent(in) :: self
    type(slow_flow_type), intent(in) :: flow
    !> Shape (n_modes, max_steady); columns beyond n_found are left alone.
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    integer, intent(inout), volatile :: cancel

    a(:, 1) = (0.0_wp, 0.0_wp)
    select case (self%kind)
    case (kind_one)
      call solve_one(self, flow, a, n_found)
    case (kind_squares)
      call self%solve_squares(flow, a, n_found, cancel)
    case (kind_general)
      call self%solve_general(flow, a, n_found, cancel)
    case default
      n_found = 1
    end select
    call sort_by_size(a, n_found)
  end subroutine solve

  !> |gamma|^2 x^3 + 2 Re(conj(sigma) gamma) x^2 + |sigma|^2 x - |g|^2 = 0.
  pure subroutine solve_one(self, flow, a, n_found)
    class(steady_solver_type), intent(in) :: self
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    complex(wp) :: sigma(1), gamma(1, 1), load(1), bottom
    real(wp) :: x(3)
    integer :: i, n

    call shifts(self, flow, sigma, gamma, load)
    n_found = 1
    if (.not. abs(load(1)) > 0.0_wp) return
    call cubic_roots([abs(gamma(1, 1))**2, 2.0_wp*real(conjg(sigma(1))*gamma(1, 1)), &
                      abs(sigma(1))**2, -abs(load(1))**2], x, n)
    n_found = 0
    do i = 1, n
      if (x(i) < 0.0_wp) cycle
      bottom = sigma(1) + gamma(1, 1)*x(i)
      if (.not. abs(bottom) > 0.0_wp) cycle
      n_found = n_found + 1
      a(:, n_found) = (0.0_wp, 0.0_wp)
      a(self%active(1), n_found) = -load(1)/bottom
    end do
  end subroutine solve_one

  !> Real solutions of c1 x^3 + c2 x^2 + c3 x + c4 = 0, polished by Newton's method.
  pure subroutine cubic_roots(c, x, n)
    real(wp), intent(in) :: c(4)
    real(wp), intent(out) :: x(3)
    integer, intent(out) :: n
    real(wp) :: unit, p(4), a, q, r, angle, root, value, slope, step, room
    real(wp), parameter :: third_turn = 2.0943951023931953_wp
    integer :: i, k, round

    x = 0.0_wp
    n = 1
    ! x in a unit that makes the outer coefficients alike.
    if (.not. c(1) > 0.0_wp) then
      n = merge(1, 0, c(3) > 0.0_wp)
      if (n == 1) x(1) = -c(4)/c(3)
      return
    end if
    unit = max((abs(c(4))/c(1))**(1.0_wp/3.0_wp), sqrt(c(3)/c(1)))
    if (.not. unit > 0.0_wp) return
    p = [1.0_wp, c(2)/c(1)/unit, c(3)/c(1)/unit**2, c(4)/c(1)/unit**3]
    a = p(2)/3.0_wp
    q = (p(2)**2 - 3.0_wp*p(3))/9.0_wp
    r = (2.0_wp*p(2)**3 - 9.0_wp*p(2)*p(3) + 27.0_wp*p(4))/54.0_wp
    if (r**2 < q**3) then
      n = 3
      angle = acos(max(-1.0_wp, min(1.0_wp, r/sqrt(q**3))))
      do i = 1, 3
        x(i) = -2.0_wp*sqrt(q)*cos(angle/3.0_wp + third_turn*(i - 2)) - a
      end do
    else
      root = -sign((abs(r) + sqrt(max(r**2 - q**3, 0.0_wp)))**(1.0_wp/3.0_wp), r)
      x(1) = root - a
      if (abs(root) > 0.0_wp) x(1) = x(1) + q/root
    end if
    ! Small roots come out with the absolute error of large ones: they are polished as long as
    ! that helps, and never past half the way to another.
    do i = 1, n
      room = 1.0_wp
      do k = 1, n
        if (k /= i) room = min(room, 0.5_wp*abs(x(i) - x(k)))
      end do
      do round = 1, 8
        value = p(4) + x(i)*(p(3) + x(i)*(p(2) + x(i)))
        slope = p(3) + x(i)*(2.0_wp*p(2) + 3.0_wp*x(i))
        if (.not. abs(slope) > 0.0_wp) exit
        step = value/slope
        if (.not. abs(step) <= room) exit
        room = 0.5_wp*room
        x(i) = x(i) - step
        if (abs(step) <= epsilon(step)*abs(x(i))) exit
      end do
    end do
    x = x*unit
  end subroutine cubic_roots

  subroutine solve_squares(self, flow, a, n_found, cancel)
    class(steady_solver_type), intent(in) :: self
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    integer, intent(inout), volatile :: cancel
    complex(wp) :: sigma(size(self%active)), gamma(size(self%active), size(self%active))
    complex(wp) :: load(size(self%active)), bottom(size(self%active))
    complex(wp) :: x(size(self%active), size(self%family%solutions, 2))
    complex(wp), allocatable :: coefficients(:)
    integer, allocatable :: row(:), at(:, :)
    integer :: i, n

    call square_terms(self, flow, row, at, coefficients)
    call self%family%solve_member(coefficients, x, n, cancel)
    call shifts(self, flow, sigma, gamma, load)
    n_found = 0
    do i = 1, n
      if (maxval(abs(aimag(x(:, i)))) > 1.0e-7_wp*maxval(abs(x(:, i)))) cycle
      if (minval(real(x(:, i))) < -1.0e-9_wp*maxval(abs(x(:, i)))) cycle
      bottom = sigma + matmul(gamma, real(x(:, i)))
      if (.not. all(abs(bottom) > 0.0_wp) .or. n_found == size(a, 2)) cycle
      n_found = n_found + 1
      a(:, n_found) = (0.0_wp, 0.0_wp)
      a(self%active, n_found) = -load/bottom*self%unit
    end do
  end subroutine solve_squares

  subroutine solve_general(self, flow, a, n_found, cancel)
    class(steady_solver_type), intent(in) :: self
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    integer, intent(inout), volatile :: cancel
    complex(wp) :: x(2*size(self%active), size(self%family%solutions, 2))
    complex(wp), allocatable :: coefficients(:)
    integer, allocatable :: row(:), at(:, :)
    integer :: i, n, m

    m = size(self%active)
    call general_terms(self, flow, row, at, coefficients)
    call self%family%solve_member(coefficients, x, n, cancel)
    n_found = 0
    do i = 1, n
      if (maxval(abs(x(:m, i) - conjg(x(m + 1:, i)))) > 1.0e-7_wp*max(maxval(abs(x(:, i))), &
                                                                      1.0e-6_wp)) cycle
      if (n_found == size(a, 2)) exit
      n_found = n_found + 1
      a(:, n_found) = (0.0_wp, 0.0_wp)
      a(self%active, n_found) = 0.5_wp*(x(:m, i) + conjg(x(m + 1:, i)))*self%unit
      ! Rest is found as some tiny number.
      where (abs(a(:, n_found)) < 1.0e-30_wp*self%unit) a(:, n_found) = (0.0_wp, 0.0_wp)
    end do
  end subroutine solve_general

  pure subroutine sort_by_size(a, n)
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(in) :: n
    complex(wp) :: column(size(a, 1))
    integer :: i, k
    do i = 2, n
      column = a(:, i)
      k = i - 1
      do while (k >= 1)
        if (sum(abs(a(:, k))**2) <= sum(abs(column)**2)) exit
        a(:, k + 1) = a(:, k)
        k = k - 1
      end do
      a(:, k + 1) = column
    end do
  end subroutine sort_by_size

end module viscovib_steady_states
