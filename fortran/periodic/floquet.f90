!> Stability of periodic solutions without memory: the monodromy matrix of
!!
!!   M y'' + C y' + K(t) y = 0,   K(t) = dF/du along the solution,
!!
!! over a period, by Dormand and Prince's method of order 8 in equal steps. Its
!! eigenvalues are the Floquet multipliers. Under half-wave symmetry K has half the
!! period, and they are the squares of the eigenvalues h of minus the matrix of half
!! a period: h = 1 at folds, h = -1 where the symmetry breaks.
module viscovib_floquet
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use viscovib_constants, only: pi
  use viscovib_dense, only: invert
  use viscovib_explicit_tables, only: explicit_table_type, max_stages, new_explicit_table
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: floquet_type, new_floquet

  !> Phase that the fastest linear mode turns in a step, at most.
  real(wp), parameter :: phase_a_step = 0.6_wp
  !> Steps of a period at most, and how often they may be refined: beyond that time
  !! scales are too far apart.
  integer, parameter :: max_steps = 4000, max_refinements = 6
  !> Place of Dormand and Prince's method in the tables.
  integer, parameter :: method = 2

  type :: floquet_type
    logical :: half_wave = .false.
    integer, private :: n_steps = 0, n_dof = 0
    integer, allocatable, private :: orders(:)
    real(wp), private :: fastest = 0.0_wp
    type(explicit_table_type), private :: table
    !> From harmonics to samples at the stages of all steps, shape (2 n_orders,
    !! n_samples).
    real(wp), allocatable, private :: synthesis(:, :)
    !> M^(-1) and M^(-1) C.
    real(wp), allocatable, private :: inverse(:, :), damping(:, :)
    real(wp), allocatable, private :: u(:, :), w(:, :), slopes(:, :, :), by_u(:, :, :)
    real(wp), allocatable, private :: by_v(:, :, :), stiffness(:, :, :)
  contains
    procedure :: monodromy
    procedure, private :: stiffness_along
    procedure, private :: columns
  end type floquet_type

contains

  subroutine new_floquet(floquet, system, set)
    type(floquet_type), intent(out) :: floquet
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    complex(wp) :: inverse(size(system%mass, 1), size(system%mass, 1))
    logical :: singular

    floquet%n_dof = system%n_dof()
    floquet%half_wave = set%half_wave
    floquet%orders = set%orders
    call invert(cmplx(system%mass, 0.0_wp, wp), inverse, singular)
    floquet%inverse = real(inverse)
    floquet%damping = matmul(floquet%inverse, system%damping)
    ! Upper bounds of the linear frequencies and of the rates of damping.
    floquet%fastest = sqrt(maxval(sum(abs(matmul(floquet%inverse, &
                                                 matmul(system%spread, system%gather))), 2))) &
                      + maxval(sum(abs(floquet%damping), 2))
    call new_explicit_table(floquet%table, method)
  end subroutine new_floquet

  !> Tables for as many steps as are needed; they are kept for neighbours.
  subroutine prepare(self, system, needed)
    class(floquet_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: needed
    real(wp) :: turn, time
    integer :: d, m, n, s, i, k, at

    turn = merge(pi, 2.0_wp*pi, self%half_wave)
    if (needed <= self%n_steps .and. 2.0_wp*needed > self%n_steps) return
    ! Some more than needed, so that neighbours can use them too.
    self%n_steps = max(12, ceiling(1.3_wp*needed))
    d = self%n_dof
    m = system%n_memory()
    n = self%n_steps*self%table%n_stages
    self%synthesis = reshape([real(wp) ::], [2*size(self%orders), n], pad=[0.0_wp])
    do s = 1, self%n_steps
      do i = 1, self%table%n_stages
        at = (s - 1)*self%table%n_stages + i
        time = turn*(s - 1 + self%table%c(i))/self%n_steps
        do k = 1, size(self%orders)
          self%synthesis(2*k - 1, at) = sin(self%orders(k)*time)
          self%synthesis(2*k, at) = cos(self%orders(k)*time)
        end do
      end do
    end do
    if (allocated(self%u)) deallocate (self%u, self%w, self%slopes, self%by_u, self%by_v, &
                                       self%stiffness)
    allocate (self%u(n, d), self%w(n, m), self%slopes(n, m, d), self%by_u(n, d, d), &
              self%by_v(n, d, m), self%stiffness(d, d, n), source=0.0_wp)
  end subroutine prepare

  !> The matrix that takes (y, y') over a period of the solution x at frequency nu;
  !! under half-wave symmetry minus that of half a period. NaN if time scales are so
  !! far apart that it would take too many steps.
  subroutine monodromy(self, system, nu, x, matrix)
    class(floquet_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: nu
    !> Harmonics, shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Shape (2 n_dof, 2 n_dof).
    real(wp), intent(out) :: matrix(:, :)
    real(wp) :: rate, along, needed
    integer :: i, first

    rate = self%fastest
    do i = 1, max_refinements
      needed = merge(pi, 2.0_wp*pi, self%half_wave)*rate/nu/phase_a_step
      if (.not. needed <= max_steps .or. i == max_refinements) then
        matrix = ieee_value(0.0_wp, ieee_quiet_nan)
        return
      end if
      call prepare(self, system, needed)
      call self%stiffness_along(system, x)
      ! Along a large motion the springs may be far stiffer than at rest.
      along = self%fastest + sqrt(maxval(sum(abs(self%stiffness), 2)))
      if (along <= 2.0_wp*rate) exit
      rate = along
    end do
    do first = 1, 2*self%n_dof, n_lanes
      call self%columns(first, min(n_lanes, 2*self%n_dof - first + 1), &
                        merge(pi, 2.0_wp*pi, self%half_wave)/nu/self%n_steps, matrix)
    end do
    if (self%half_wave) matrix = -matrix
  end subroutine monodromy

  !> Columns first ... first + count - 1 of the matrix, one a lane, in steps h.
  subroutine columns(self, first, count, h, matrix)
    class(floquet_type), intent(in) :: self
    integer, intent(in) :: first, count
    real(wp), intent(in) :: h
    real(wp), intent(inout) :: matrix(:, :)
    ! Coordinates are taken two at a time.
    real(wp), dimension(n_lanes, self%n_dof + mod(self%n_dof, 2)) :: q, v, stage_q, stage_v
    real(wp) :: f(n_lanes, self%n_dof + mod(self%n_dof, 2), max_stages)
    integer :: s, i, n, width

    n = self%n_dof
    width = size(q, 2)
    q = 0.0_wp
    v = 0.0_wp
    f = 0.0_wp
    do i = 1, count
      if (first + i - 1 <= n) then
        q(i, first + i - 1) = 1.0_wp
      else
        v(i, first + i - 1 - n) = 1.0_wp
      end if
    end do
    associate (t => self%table)
      do s = 1, self%n_steps
        do i = 1, t%n_stages
          call stage(width, t%n_terms(i), t%from(1, i), t%weights(1, 1, i), f, t%c(i), h, q, v, &
                     stage_q, stage_v)
          call acceleration(n, self%stiffness(1, 1, (s - 1)*t%n_stages + i), self%damping, &
                            stage_q, stage_v, f(1, 1, i))
        end do
        i = t%n_stages + 1
        call stage(width, t%n_terms(i), t%from(1, i), t%weights(1, 1, i), f, 1.0_wp, h, q, v, &
                   stage_q, stage_v)
        q = stage_q
        v = stage_v
      end do
    end associate
    matrix(:n, first:first + count - 1) = transpose(q(:count, :n))
    matrix(n + 1:, first:first + count - 1) = transpose(v(:count, :n))
  end subroutine columns

  !> State at a stage: q + h (c v + h sum a_q f) and v + h sum a f. Why the loops are
  !! written so: see `viscovib_node_kernels`.
  pure subroutine stage(width, n_terms, from, weights, f, c, h, q, v, stage_q, stage_v)
    integer, intent(in) :: width, n_terms, from(n_terms)
    real(wp), intent(in) :: weights(2, n_terms), f(n_lanes, width, *), c, h
    real(wp), dimension(n_lanes, width), intent(in) :: q, v
    real(wp), dimension(n_lanes, width), intent(out) :: stage_q, stage_v
    real(wp), dimension(n_lanes) :: q_1, q_2, v_1, v_2
    integer :: d, i

    do d = 1, width, 2
      q_1 = 0.0_wp
      q_2 = 0.0_wp
      v_1 = 0.0_wp
      v_2 = 0.0_wp
      !GCC$ novector
      do i = 1, n_terms
        q_1 = q_1 + weights(1, i)*f(:, d, from(i))
        v_1 = v_1 + weights(2, i)*f(:, d, from(i))
        q_2 = q_2 + weights(1, i)*f(:, d + 1, from(i))
        v_2 = v_2 + weights(2, i)*f(:, d + 1, from(i))
      end do
      stage_q(:, d) = q(:, d) + h*(c*v(:, d) + h*q_1)
      stage_q(:, d + 1) = q(:, d + 1) + h*(c*v(:, d + 1) + h*q_2)
      stage_v(:, d) = v(:, d) + h*v_1
      stage_v(:, d + 1) = v(:, d + 1) + h*v_2
    end do
  end subroutine stage

  !> -K q - D v in every lane.
  pure subroutine acceleration(n, stiffness, damping, q, v, f)
    integer, intent(in) :: n
    real(wp), intent(in) :: stiffness(n, n), damping(n, n)
    real(wp), intent(in) :: q(n_lanes, n), v(n_lanes, n)
    real(wp), intent(out) :: f(n_lanes, n)
    real(wp) :: total(n_lanes)
    integer :: a, b
    do a = 1, n
      total = 0.0_wp
      !GCC$ novector
      do b = 1, n
        total = total - (stiffness(a, b)*q(:, b) + damping(a, b)*v(:, b))
      end do
      f(:, a) = total
    end do
  end subroutine acceleration

  !> M^(-1) dF/du at the stages, without memory: v = w(u).
  subroutine stiffness_along(self, system, x)
    class(floquet_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(:, :)
    real(wp) :: along(size(self%u, 1))
    integer :: a, b, j

    do b = 1, self%n_dof
      self%u(:, b) = matmul(x(:, b), self%synthesis)
    end do
    if (any(system%bent)) call system%deflection_slopes(self%u, self%slopes)
    if (.not. system%separable) then
      call system%deflection_remainder(self%u, self%w)
      do j = 1, size(self%w, 2)
        if (.not. system%bent(j)) self%w(:, j) = 0.0_wp
        self%w(:, j) = self%w(:, j) + matmul(self%u, system%gather(j, :))
      end do
      call system%force_slopes(self%u, self%w, self%by_u, self%by_v)
    end if
    do b = 1, self%n_dof
      do a = 1, self%n_dof
        along = self%by_u(:, a, b)
        do j = 1, size(self%w, 2)
          if (system%separable .and. .not. abs(system%spread(a, j)) > 0.0_wp) cycle
          if (abs(system%gather(j, b)) > 0.0_wp) then
            along = along + (system%spread(a, j) + self%by_v(:, a, j))*system%gather(j, b)
          end if
          if (system%bent(j)) then
            along = along + (system%spread(a, j) + self%by_v(:, a, j))*self%slopes(:, j, b)
          end if
        end do
        self%stiffness(a, b, :) = along
      end do
    end do
    do j = 1, size(self%u, 1)
      call premultiply(self%n_dof, self%inverse, self%stiffness(:, :, j))
    end do
  end subroutine stiffness_along

  !> k becomes m k.
  pure subroutine premultiply(n, m, k)
    integer, intent(in) :: n
    real(wp), intent(in) :: m(n, n)
    real(wp), intent(inout) :: k(n, n)
    real(wp) :: column(n)
    integer :: a, b
    do b = 1, n
      column = k(:, b)
      do a = 1, n
        k(a, b) = sum(m(a, :)*column)
      end do
    end do
  end subroutine premultiply

end module viscovib_floquet
