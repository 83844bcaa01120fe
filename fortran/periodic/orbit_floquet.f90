! Optimize: -O2 -fvect-cost-model=dynamic
!> Stability of periodic solutions of a driven system: the monodromy matrix of small perturbations
!! (y, y'),
!!
!!   y'' = da/dq y + da/dq' y'  along the solution,
!!
!! by the Dormand-Prince method of order 8 with equal steps, one column in each lane. Its
!! eigenvalues are the Floquet multipliers.
module viscovib_orbit_floquet
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_explicit_tables, only: explicit_table_type, max_stages, new_explicit_table
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof, n_lanes
  use viscovib_orbit_multipliers, only: multipliers_of, distinguished
  use viscovib_product_eigenvalues, only: largest_factor, product_eigenvalues, product_type
  use viscovib_stage_kernels, only: stage_states, stage_sums
  use viscovib_torus_balance, only: torus_balance_type
  implicit none
  private

  public :: orbit_floquet_type

  !> Largest phase angle of a perturbation, or of the highest harmonic of the motion, in a step.
  real(wp), parameter :: phase_a_step = 0.5_wp
  !> Largest number of steps per period; beyond it, time scales are too far apart.
  integer, parameter :: max_steps = 20000
  !> Largest number of steps in a factor of a product; beyond this logarithm a multiplier overflows.
  integer, parameter :: steps_a_factor = 16
  real(wp), parameter :: largest_log = 700.0_wp
  !> Index of the Dormand-Prince method in the tables.
  integer, parameter :: method = 2

  type :: orbit_floquet_type
    integer, private :: n_steps = 0
    type(explicit_table_type), private :: table
    !> From unknowns to samples at the stages of all steps, of a coordinate and of its
    !! derivative with respect to the angle, shape (n, n_stages n_steps).
    real(wp), allocatable, private :: synthesis(:, :), derivative(:, :)
    !> cos of the drives' angles at the stages, shape (n_drives, n_stages n_steps).
    real(wp), allocatable, private :: cosines(:, :)
    real(wp), allocatable, private :: q(:, :), v(:, :)
  contains
    procedure :: multipliers
    procedure, private :: monodromy
    procedure, private :: prepare
  end type orbit_floquet_type

contains

  !> Prepare tables for the required number of steps; nearby solutions reuse them.
  subroutine prepare(self, balance, needed)
    class(orbit_floquet_type), intent(inout) :: self
    type(torus_balance_type), intent(in) :: balance
    real(wp), intent(in) :: needed
    integer :: at, i, j, k, n, s
    real(wp) :: angle

    if (needed <= self%n_steps .and. 2.0_wp*needed > self%n_steps) return
    if (self%n_steps == 0) call new_explicit_table(self%table, method)
    ! A margin, so that nearby solutions can reuse the tables.
    self%n_steps = max(12, ceiling(1.3_wp*needed))
    n = self%n_steps*self%table%n_stages
    if (allocated(self%q)) then
      deallocate (self%synthesis, self%derivative, self%cosines, self%q, self%v)
    end if
    allocate (self%synthesis(balance%torus%n, n), self%derivative(balance%torus%n, n), &
              self%cosines(size(balance%amplitude), n), self%q(n, balance%system%n_dof), &
              self%v(n, balance%system%n_dof), source=0.0_wp)
    do s = 1, self%n_steps
      do i = 1, self%table%n_stages
        at = (s - 1)*self%table%n_stages + i
        angle = 2.0_wp*pi*(s - 1 + self%table%c(i))/self%n_steps
        self%synthesis(1, at) = 1.0_wp
        do k = 2, size(balance%torus%orders, 2)
          associate (order => balance%torus%orders(1, k))
            self%synthesis(2*k - 2, at) = sin(order*angle)
            self%synthesis(2*k - 1, at) = cos(order*angle)
            self%derivative(2*k - 2, at) = order*cos(order*angle)
            self%derivative(2*k - 1, at) = -order*sin(order*angle)
          end associate
        end do
        do j = 1, size(balance%amplitude)
          self%cosines(j, at) = cos(balance%drive_orders(1, j)*angle)
        end do
      end do
    end do
  end subroutine prepare

  !> Multipliers of the solution x of `balance`, which has one axis, at most four coordinates and
  !! was just evaluated at x: largest first; NaN if too many steps are needed or a multiplier
  !! overflows.
  subroutine multipliers(self, balance, x, values)
    class(orbit_floquet_type), intent(inout) :: self
    type(torus_balance_type), intent(in) :: balance
    !> Unknowns, shape (balance%n).
    real(wp), intent(in) :: x(:)
    !> Shape (2 n_dof).
    complex(wp), intent(out) :: values(:)
    real(wp) :: matrix(size(values), size(values))
    complex(wp) :: logs(size(values))
    type(product_type) :: product
    logical :: found

    call self%monodromy(balance, x, matrix)
    call multipliers_of(matrix, values)
    if (distinguished(values)) return
    call self%monodromy(balance, x, matrix, product)
    found = product%n_factors > 0
    if (found) call product_eigenvalues(product, logs, found)
    if (found) found = maxval(real(logs)) <= largest_log
    if (found) values = exp(logs)
  end subroutine multipliers

  !> The monodromy matrix. NaN if too many steps are needed, or if it overflows; `product`: as a
  !! product of factors instead, without factors on failure.
  subroutine monodromy(self, balance, x, matrix, product)
    class(orbit_floquet_type), intent(inout) :: self
    type(torus_balance_type), intent(in) :: balance
    real(wp), intent(in) :: x(:)
    !> Shape (2 n_dof, 2 n_dof): (y, y') to (y, y').
    real(wp), intent(out) :: matrix(:, :)
    type(product_type), intent(out), optional :: product
    real(wp), dimension(n_lanes, max_dof) :: q, v, stage_q, stage_v, in_q, in_v
    real(wp), dimension(n_lanes, balance%system%n_dof) :: motion, speed, a
    real(wp) :: drive(n_lanes, size(balance%amplitude))
    real(wp) :: f(n_lanes, max_dof, max_stages), h(n_lanes), needed
    real(wp) :: y(balance%torus%n, balance%system%n_dof), rate
    integer :: d, i, at, n, s, steps

    n = balance%system%n_dof
    y = balance%expanded(x)
    rate = balance%rate()
    needed = max(2.0_wp*pi*rate/balance%omega(1)/phase_a_step, &
                 1.0_wp*maxval(balance%torus%orders))
    matrix = ieee_value(0.0_wp, ieee_quiet_nan)
    if (.not. needed <= max_steps) return
    call self%prepare(balance, needed)
    do d = 1, n
      self%q(:, d) = matmul(y(:, d), self%synthesis)
      self%v(:, d) = balance%omega(1)*matmul(y(:, d), self%derivative)
    end do
    h = 2.0_wp*pi/balance%omega(1)/self%n_steps
    f = 0.0_wp
    stage_q = 0.0_wp
    stage_v = 0.0_wp
    call begin()
    associate (t => self%table)
      do s = 1, self%n_steps
        do i = 1, t%n_stages
          call stage_sums(n, t%n_terms(i), t%from(1, i), t%weights(1, 1, i), f, in_q, in_v)
          call stage_states(n, t%c(i), h, q, v, in_q, in_v, stage_q, stage_v)
          at = (s - 1)*t%n_stages + i
          motion = spread(self%q(at, :), 1, n_lanes)
          speed = spread(self%v(at, :), 1, n_lanes)
          drive = spread(balance%factor*balance%amplitude*self%cosines(:, at), 1, n_lanes)
          call balance%system%tangent(motion, speed, drive, stage_q, stage_v, a, f(1, 1, i))
        end do
        i = t%n_stages + 1
        call stage_sums(n, t%n_terms(i), t%from(1, i), t%weights(1, 1, i), f, in_q, in_v)
        call stage_states(n, 1.0_wp, h, q, v, in_q, in_v, stage_q, stage_v)
        q(:, :n) = stage_q(:, :n)
        v(:, :n) = stage_v(:, :n)
        if (.not. present(product)) cycle
        steps = steps + 1
        if (max(maxval(abs(q(:, :n))), maxval(abs(v(:, :n)))/rate) <= largest_factor &
            .and. steps < steps_a_factor .and. s < self%n_steps) cycle
        matrix(:n, :) = transpose(q(:2*n, :n))
        matrix(n + 1:, :) = transpose(v(:2*n, :n))
        ! Velocities in units of the coordinates.
        matrix(n + 1:, :) = matrix(n + 1:, :)/rate
        matrix(:, n + 1:) = matrix(:, n + 1:)*rate
        call product%append(matrix)
        call begin()
      end do
    end associate
    if (.not. (all(abs(q) <= 1.0e100_wp) .and. all(abs(v) <= 1.0e100_wp))) then
      matrix = ieee_value(0.0_wp, ieee_quiet_nan)
      return
    end if
    matrix(:n, :) = transpose(q(:2*n, :n))
    matrix(n + 1:, :) = transpose(v(:2*n, :n))

  contains

    !> Unit perturbations, one of each coordinate and velocity.
    subroutine begin()
      q = 0.0_wp
      v = 0.0_wp
      do d = 1, n
        q(d, d) = 1.0_wp
        v(n + d, d) = 1.0_wp
      end do
      steps = 0
    end subroutine begin

  end subroutine monodromy

end module viscovib_orbit_floquet
