! Optimize: -O3
!> Stability of periodic solutions without memory: the monodromy matrices of
!!
!!   M y'' + C(t) y' + K(t) y = 0,   K(t) = dF/du, C(t) = C + dF/du' along the solution,
!!
!! over a period, several solutions side by side in the lanes, by Gauss collocation of order 12
!! in equal steps, as many as the estimated error asks for. Their eigenvalues are the Floquet
!! multipliers. Under half-wave symmetry K and C have half the period, and they are the squares of
!! the eigenvalues h of minus the matrix of half a period: h = 1 at folds, h = -1 where the
!! symmetry breaks.
module viscovib_floquet
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan, ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_dense, only: outer
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_linear_along, only: along_type, new_along
  use viscovib_monodromy_step, only: advance, advance_drag, n_nodes, new_step_table, step_table
  use viscovib_oscillator, only: oscillator_type
  use viscovib_product_eigenvalues, only: largest_factor, product_type
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: floquet_type, new_floquet

  !> Phase that the fastest linear mode turns in a step at first.
  real(wp), parameter :: phase_a_step = 1.1_wp
  !> Relative error that the steps of a period may add up to, by its estimate.
  real(wp), parameter :: wanted_error = 1.0e-11_wp
  !> How often that is let pass, for the estimate wavers.
  real(wp), parameter :: accepted = 4.0_wp
  !> Steps of a period at most, and how often they may be refined: beyond that time
  !! scales are too far apart.
  integer, parameter :: max_steps = 4000, max_attempts = 12
  !> Entries beyond this say nothing any more.
  real(wp), parameter :: largest = 1.0e100_wp
  !> Numbers that the stiffness of the steps taken in one piece may hold.
  integer, parameter :: piece = 1000

  type :: floquet_type
    logical :: half_wave = .false.
    integer, private :: n_steps = 0, n_dof = 0, chunk = 1
    integer, allocatable, private :: orders(:)
    !> Steps that are needed, over those by the phase.
    real(wp), private :: density = 1.0_wp
    type(step_table), private :: table
    !> From harmonics to samples at the nodes of all steps, shape (2 n_orders, n).
    real(wp), allocatable, private :: synthesis(:, :)
    type(along_type), private :: along
    !> Harmonics, states, h D and work for the equations of a step, lane first.
    real(wp), allocatable, private :: x(:, :, :), y(:, :, :), drag(:, :, :), g(:, :, :)
  contains
    procedure :: monodromies
    procedure :: factors
    procedure :: n_states
    procedure, private :: prepare
    procedure, private :: least_steps
    procedure, private :: integrate
  end type floquet_type

contains

  !> Order of the matrices.
  pure integer function n_states(self)
    class(floquet_type), intent(in) :: self
    n_states = 2*self%n_dof
  end function n_states

  subroutine new_floquet(floquet, system, set)
    type(floquet_type), intent(out) :: floquet
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    integer :: d

    floquet%half_wave = set%half_wave
    floquet%orders = set%orders
    call new_along(floquet%along, system)
    d = floquet%along%n_dof
    floquet%n_dof = d
    call new_step_table(floquet%table)
    floquet%chunk = max(1, piece/(n_lanes*n_nodes*d**2))
    call floquet%along%allocate_arrays(system, n_nodes*floquet%chunk)
    allocate (floquet%x(n_lanes, 2*size(set%orders), d), floquet%y(n_lanes, 2*d, 2*d), &
              floquet%drag(n_lanes, d, d), &
              floquet%g(n_lanes, n_nodes*d, (n_nodes + 2)*d), source=0.0_wp)
  end subroutine new_floquet

  !> For each solution x at frequency nu the matrix that takes (y, y') over a period;
  !! under half-wave symmetry minus that of half a period. NaN if time scales are so
  !! far apart that it would take too many steps, or where it leaves the range of numbers.
  subroutine monodromies(self, system, nu, x, matrices, cancel)
    class(floquet_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    !> Frequencies (rad/s), shape (n).
    real(wp), intent(in) :: nu(:)
    !> Harmonics, shape (2 n_orders, n_dof, n).
    real(wp), intent(in) :: x(:, :, :)
    !> Shape (2 n_dof, 2 n_dof, n).
    real(wp), intent(out) :: matrices(:, :, :)
    !> May be set from elsewhere to give up.
    integer, intent(inout), optional :: cancel
    integer :: first, count

    matrices = ieee_value(0.0_wp, ieee_quiet_nan)
    do first = 1, size(nu), n_lanes
      count = min(n_lanes, size(nu) - first + 1)
      call block_of(self, system, nu(first:first + count - 1), x(:, :, first:first + count - 1), &
                    matrices(:, :, first:first + count - 1), cancel)
      if (is_set(cancel)) return
    end do
  end subroutine monodromies

  !> As many solutions as there are lanes, or fewer.
  subroutine block_of(self, system, nu, x, matrices, cancel, product)
    class(floquet_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu(:), x(:, :, :)
    real(wp), intent(inout) :: matrices(:, :, :)
    integer, intent(inout), optional :: cancel
    !> Factors of the matrix of one solution, of which `matrices` is then the last.
    type(product_type), intent(inout), optional :: product
    real(wp) :: turn, needed, h(n_lanes), error(n_lanes), worst
    logical :: pending(n_lanes)
    integer :: attempt, l

    turn = merge(pi, 2.0_wp*pi, self%half_wave)
    do l = 1, n_lanes
      self%x(l, :, :) = x(:, :, min(l, size(nu)))
      h(l) = turn/nu(min(l, size(nu)))
    end do
    pending = h*self%along%fastest/phase_a_step <= max_steps .or. present(product)
    pending(size(nu) + 1:) = .false.
    if (.not. any(pending)) return
    where (.not. pending) h = 0.0_wp
    needed = self%least_steps(maxval(h))
    do attempt = 1, max_attempts
      if (.not. self%density*needed <= max_steps) exit
      call self%prepare(ceiling(self%density*needed))
      if (present(product)) product%n_factors = 0
      call self%integrate(system, h/self%n_steps, error, pending, cancel, product)
      if (is_set(cancel)) return
      worst = maxval(error, pending)
      do l = 1, size(nu)
        if (.not. (pending(l) .and. error(l) <= accepted*wanted_error)) cycle
        call to_matrix(self, l, h(l)/self%n_steps, matrices(:, :, l))
        pending(l) = .false.
        if (present(product)) return
      end do
      self%density = self%n_steps/needed*max(0.5_wp, min(2.0_wp, (worst/wanted_error) &
                                                         **(0.5_wp/n_nodes)))
      if (.not. any(pending)) return
    end do
    ! Where that was in vain, neighbours begin anew.
    self%density = 1.0_wp
  end subroutine block_of

  !> The same matrix of one solution as a product, whose eigenvalues are known where those of
  !! the matrix are lost in the rounding error of its largest, or where it leaves the range of
  !! numbers.
  subroutine factors(self, system, nu, x, product, found, cancel)
    class(floquet_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    !> Frequency (rad/s); harmonics, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: nu, x(:, :)
    !> Under half-wave symmetry without the sign.
    type(product_type), intent(out) :: product
    !> Not if it would take too many steps.
    logical, intent(out) :: found
    integer, intent(inout), optional :: cancel
    real(wp) :: last(2*self%n_dof, 2*self%n_dof, 1)

    last = ieee_value(0.0_wp, ieee_quiet_nan)
    call block_of(self, system, [nu], reshape(x, [shape(x), 1]), last, cancel, product)
    found = .not. ieee_is_nan(last(1, 1, 1))
  end subroutine factors

  !> So many steps of a period, or half of one, of length h that samples resolve the highest order
  !! of K apart.
  pure real(wp) function least_steps(self, h)
    class(floquet_type), intent(in) :: self
    real(wp), intent(in) :: h
    least_steps = max(h*self%along%fastest/phase_a_step, merge(1.0_wp, 2.0_wp, self%half_wave) &
                      *maxval(self%orders)/n_nodes, 2.0_wp)
  end function least_steps

  !> The state of a lane in the units of the coordinates.
  pure subroutine to_matrix(self, l, h, matrix)
    class(floquet_type), intent(in) :: self
    integer, intent(in) :: l
    real(wp), intent(in) :: h
    real(wp), intent(inout) :: matrix(:, :)
    real(wp) :: unit(2*self%n_dof)

    unit = [self%along%unit, self%along%unit*h]
    matrix = self%y(l, :, :)*outer(1.0_wp/unit, unit)
    if (self%half_wave) matrix = -matrix
  end subroutine to_matrix

  !> Tables for at least so many steps.
  subroutine prepare(self, needed)
    class(floquet_type), intent(inout) :: self
    integer, intent(in) :: needed
    complex(wp) :: at_node(n_nodes), wave, turn, factor
    real(wp) :: angle
    integer :: n, s, i, k

    ! Rounded up to four binary digits, so that neighbours often have the same.
    n = max(1, 2**(exponent(real(needed, wp)) - 4))
    n = n*((needed + n - 1)/n)
    if (n == self%n_steps) return
    self%n_steps = n
    angle = merge(pi, 2.0_wp*pi, self%half_wave)/n
    if (allocated(self%synthesis)) deallocate (self%synthesis)
    allocate (self%synthesis(2*size(self%orders), n_nodes*n))
    at_node = exp(cmplx(0.0_wp, angle*self%table%c, wp))
    do s = 1, n
      factor = exp(cmplx(0.0_wp, angle*(s - 1), wp))
      do i = 1, n_nodes
        wave = (factor*at_node(i))**self%orders(1)
        turn = (factor*at_node(i))**merge(2, 1, self%half_wave)
        do k = 1, size(self%orders)
          self%synthesis(2*k - 1, (s - 1)*n_nodes + i) = aimag(wave)
          self%synthesis(2*k, (s - 1)*n_nodes + i) = real(wave)
          wave = wave*turn
        end do
      end do
    end do
  end subroutine prepare

  !> Over all steps h, with the estimated errors; lanes that leave the range of numbers are no
  !! longer pending. With `product` the matrix of the first lane is cut into factors.
  subroutine integrate(self, system, h, error, pending, cancel, product)
    class(floquet_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: h(n_lanes)
    real(wp), intent(out) :: error(n_lanes)
    logical, intent(inout) :: pending(n_lanes)
    integer, intent(inout), optional :: cancel
    type(product_type), intent(inout), optional :: product
    !> Minus the logarithm of the determinant of a factor, by Liouville's formula.
    real(wp) :: shrunk
    integer :: a, b, first, l, last, s

    call begin(self)
    shrunk = 0.0_wp
    do b = 1, self%n_dof
      do a = 1, self%n_dof
        self%drag(:, a, b) = h*self%along%damping(a, b)
      end do
    end do
    error = 0.0_wp
    do first = 1, self%n_steps, self%chunk
      if (is_set(cancel)) return
      last = min(first + self%chunk - 1, self%n_steps)
      call self%along%fill(system, self%orders, self%x, &
                           self%synthesis(:, (first - 1)*n_nodes + 1:last*n_nodes), &
                           merge(pi, 2.0_wp*pi, self%half_wave)/self%n_steps, h)
      do s = 1, last - first + 1
        if (size(self%along%rates) > 0) then
          call advance_drag(self%table, self%n_dof, n_nodes*self%chunk, (s - 1)*n_nodes + 1, &
                            self%along%stiffness, self%along%drags, self%y, self%g, error)
        else
          call advance(self%table, self%n_dof, n_nodes*self%chunk, (s - 1)*n_nodes + 1, &
                       self%along%stiffness, self%drag, self%y, self%g, error)
        end if
        if (.not. present(product)) cycle
        shrunk = shrunk + shrinking(self, s)
        if (maxval(abs(self%y(1, :, :))) <= largest_factor .and. shrunk <= log(largest_factor) &
            .and. first + s <= self%n_steps) cycle
        call product%append(self%y(1, :, :))
        call begin(self)
        shrunk = 0.0_wp
      end do
      do l = 1, n_lanes
        if (all(abs(self%y(l, :, :)) <= largest)) cycle
        self%y(l, :, :) = 0.0_wp
        pending(l) = .false.
      end do
    end do
  end subroutine integrate

  !> The trace of h D in the first lane, its mean over a step of those stored.
  pure real(wp) function shrinking(self, s)
    class(floquet_type), intent(in) :: self
    integer, intent(in) :: s
    integer :: a, i
    shrinking = sum([(self%drag(1, a, a), a=1, self%n_dof)])
    if (size(self%along%rates) == 0) return
    shrinking = 0.0_wp
    do i = 1, n_nodes
      do a = 1, self%n_dof
        shrinking = shrinking + self%table%b(i) &
                    *self%along%drags(((s - 1)*n_nodes + i - 1)*n_lanes + 1, a, a)
      end do
    end do
  end function shrinking

  !> Disturbances of size 1, one of each coordinate and velocity.
  pure subroutine begin(self)
    class(floquet_type), intent(inout) :: self
    integer :: a
    self%y = 0.0_wp
    do a = 1, 2*self%n_dof
      self%y(:, a, a) = 1.0_wp
    end do
  end subroutine begin

end module viscovib_floquet
