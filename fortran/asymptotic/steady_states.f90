!> All steady motions of a slow flow that is autonomous in its frame.
!!
!! The terms determine which modes are active. There are three cases, by the coupling of modes. One
!! mode with its own shift, sigma a + gamma |a|^2 a + g = 0, is a cubic equation for x = |a|^2.
!! Several modes that only shift each other are equations of third degree for their squares. The
!! general case is solved for amplitudes and conjugates as independent unknowns.
!! `viscovib_homotopy` finds all solutions in the last two cases.
module viscovib_steady_states
  use viscovib_homotopy, only: family_type, max_unknowns, new_family
  use viscovib_kinds, only: wp
  use viscovib_real_cubic, only: cubic_roots
  use viscovib_slow_flow, only: slow_flow_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_steady_equations, only: find_moving, general_terms, natural_unit, shifts, &
    square_terms
  implicit none
  private

  public :: steady_solver_type, new_steady_solver

  integer, parameter, public :: max_steady = 729
  integer, parameter :: kind_none = 0, kind_one = 1, kind_squares = 2, kind_general = 3

  type :: steady_solver_type
    !> Numbers of the active modes.
    integer, allocatable :: active(:)
    integer :: kind = kind_none
    !> Unit of the amplitudes.
    real(wp) :: unit = 1.0_wp
    !> All patterns of terms so far, and the index of the present one: patterns recur.
    type(family_type), allocatable, private :: families(:)
    integer, private :: present = 0
  contains
    procedure :: solve
    procedure, private :: choose_family
    procedure, private :: solve_squares
    procedure, private :: solve_general
  end type steady_solver_type

contains

  !> Prepare from the flow at one value of the varied quantity. Other values have the same terms
  !! with other coefficients. A solver for the same terms reuses its former solutions.
  subroutine new_steady_solver(solver, flow, status, cancel)
    type(steady_solver_type), intent(inout) :: solver
    type(slow_flow_type), intent(in) :: flow
    type(status_type), intent(out) :: status
    !> A value other than 0, possibly set by another thread, cancels the computation.
    integer, intent(inout) :: cancel
    integer, allocatable :: row(:), at(:, :)
    complex(wp), allocatable :: coefficients(:)
    logical :: shifts_only
    integer :: n

    solver%kind = kind_none
    solver%unit = 1.0_wp
    call set_ok(status)
    call find_moving(flow, solver%active, shifts_only)
    n = size(solver%active)
    if (n == 0) return
    if (n == 1 .and. shifts_only) then
      solver%kind = kind_one
    else if (n <= max_unknowns/2) then
      solver%kind = merge(kind_squares, kind_general, shifts_only)
      solver%unit = natural_unit(flow, solver%active)
      if (shifts_only) then
        call square_terms(flow, solver%active, solver%unit, row, at, coefficients)
        call solver%choose_family(n, .false., row, at, cancel)
      else
        call general_terms(flow, solver%active, solver%unit, row, at, coefficients)
        call solver%choose_family(2*n, .true., row, at, cancel)
      end if
    else
      call fail(status, status_input_error, 'system', 'system: '//show(n)//' modes move together ' &
                //'in resonance; steady motions are found for at most '//show(max_unknowns/2))
    end if
  end subroutine new_steady_solver

  subroutine choose_family(self, n, conjugates, row, at, cancel)
    class(steady_solver_type), intent(inout) :: self
    integer, intent(in) :: n, row(:), at(:, :)
    logical, intent(in) :: conjugates
    integer, intent(inout) :: cancel
    type(family_type), allocatable :: more(:)
    integer :: present

    if (.not. allocated(self%families)) allocate (self%families(0))
    do present = 1, size(self%families)
      if (self%families(present)%is_of(n, row, at)) exit
    end do
    self%present = present
    if (present <= size(self%families)) return
    allocate (more(present))
    more(:present - 1) = self%families
    call new_family(more(present), n, conjugates, row, at, cancel)
    call move_alloc(more, self%families)
  end subroutine choose_family

  !> Amplitudes of all steady motions, the smallest first; 0 for inactive modes.
  subroutine solve(self, flow, a, n_found, cancel)
    class(steady_solver_type), intent(inout) :: self
    type(slow_flow_type), intent(in) :: flow
    !> Shape (n_modes, max_steady); columns beyond n_found are not changed.
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    integer, intent(inout) :: cancel

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

    call shifts(flow, self%active, self%unit, sigma, gamma, load)
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

  subroutine solve_squares(self, flow, a, n_found, cancel)
    class(steady_solver_type), intent(inout) :: self
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    integer, intent(inout) :: cancel
    complex(wp) :: sigma(size(self%active)), gamma(size(self%active), size(self%active))
    complex(wp) :: load(size(self%active)), bottom(size(self%active))
    complex(wp), allocatable :: x(:, :)
    complex(wp), allocatable :: coefficients(:)
    integer, allocatable :: row(:), at(:, :)
    integer :: i, n

    call square_terms(flow, self%active, self%unit, row, at, coefficients)
    associate (family => self%families(self%present))
      allocate (x(size(self%active), size(family%solutions, 2)))
      call family%solve_member(coefficients, self%unit**2, x, n, cancel)
    end associate
    call shifts(flow, self%active, self%unit, sigma, gamma, load)
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
    class(steady_solver_type), intent(inout) :: self
    type(slow_flow_type), intent(in) :: flow
    complex(wp), intent(inout) :: a(:, :)
    integer, intent(out) :: n_found
    integer, intent(inout) :: cancel
    complex(wp), allocatable :: x(:, :)
    complex(wp), allocatable :: coefficients(:)
    integer, allocatable :: row(:), at(:, :)
    integer :: i, n, m

    m = size(self%active)
    call general_terms(flow, self%active, self%unit, row, at, coefficients)
    associate (family => self%families(self%present))
      allocate (x(2*m, size(family%solutions, 2)))
      call family%solve_member(coefficients, self%unit, x, n, cancel)
    end associate
    n_found = 0
    do i = 1, n
      if (maxval(abs(x(:m, i) - conjg(x(m + 1:, i)))) > 1.0e-7_wp*max(maxval(abs(x(:, i))), &
                                                                      1.0e-6_wp)) cycle
      if (n_found == size(a, 2)) exit
      n_found = n_found + 1
      a(:, n_found) = (0.0_wp, 0.0_wp)
      a(self%active, n_found) = 0.5_wp*(x(:m, i) + conjg(x(m + 1:, i)))*self%unit
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
