! Optimize: -O3
!> The matrices of small perturbations along periodic solutions without memory,
!!
!!   M y'' + C(t) y' + K(t) y = 0,   K(t) = dF/du, C(t) = C + dF/du' along the solution,
!!
!! for several solutions in the vector lanes, at the nodes of equal steps h: h^2 M^-1 K, and h D
!! with D = M^-1 C. Coordinates times the root of their mass have the same unit.
module viscovib_linear_along
  use viscovib_dense, only: invert
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: lane_product, n_lanes
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: along_type, new_along

  type :: along_type
    integer :: n_dof = 0
    !> Upper bound of the linear frequencies and of the damping rates (1/s).
    real(wp) :: fastest = 0.0_wp
    !> sqrt(M_aa), and D in these units.
    real(wp), allocatable :: unit(:), damping(:, :)
    !> Coordinates of the solution whose rates occur in laws.
    integer, allocatable :: rates(:)
    !> h^2 M^-1 K at the nodes, and h D if it varies, shape (n, n_dof, n_dof).
    real(wp), allocatable :: stiffness(:, :, :), drags(:, :, :)
    !> M^-1, M^-1 B and M^-1 B W.
    real(wp), allocatable, private :: inverse(:, :), spread(:, :), rest(:, :)
    real(wp), allocatable, private :: u(:, :), w(:, :), slopes(:, :, :), by_u(:, :, :)
    real(wp), allocatable, private :: by_v(:, :, :), along(:)
  contains
    procedure :: allocate_arrays
    procedure :: fill
    procedure, private :: inseparable
  end type along_type

contains

  subroutine new_along(self, system)
    type(along_type), intent(out) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp) :: inverse(size(system%mass, 1), size(system%mass, 1))
    logical :: singular
    integer :: a

    self%n_dof = system%n_dof()
    allocate (self%rates(0))
    if (system%n_rates() > 0) self%rates = system%rates
    call invert(cmplx(system%mass, 0.0_wp, wp), inverse, singular)
    self%inverse = real(inverse)
    self%unit = [(sqrt(system%mass(a, a)), a=1, self%n_dof)]
    self%damping = matmul(self%inverse, system%damping)
    self%spread = matmul(self%inverse, system%spread)
    self%rest = matmul(self%spread, system%gather)
    do a = 1, self%n_dof
      self%inverse(a, :) = self%unit(a)*self%inverse(a, :)
      self%spread(a, :) = self%unit(a)*self%spread(a, :)
      self%damping(a, :) = self%unit(a)*self%damping(a, :)/self%unit
      self%rest(a, :) = self%unit(a)*self%rest(a, :)/self%unit
    end do
    self%fastest = sqrt(maxval(sum(abs(self%rest), 2))) + maxval(sum(abs(self%damping), 2))
  end subroutine new_along

  !> Allocate arrays for a number of nodes.
  subroutine allocate_arrays(self, system, n_nodes)
    class(along_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: n_nodes
    integer :: d, m, n

    d = self%n_dof
    m = system%n_memory()
    n = n_lanes*n_nodes
    allocate (self%u(n, self%n_dof + size(self%rates)), self%w(n, m), &
              self%slopes(n, m, self%n_dof + size(self%rates)), &
              self%stiffness(n, d, d), self%along(n), source=0.0_wp)
    if (size(self%rates) > 0) allocate (self%drags(n, d, d))
    if (.not. system%separable) then
      allocate (self%by_u(n, d, d), self%by_v(n, d, m), source=0.0_wp)
    end if
  end subroutine allocate_arrays

  !> Compute the matrices at some nodes of the steps h of each lane.
  subroutine fill(self, system, orders, x, synthesis, phase, h)
    class(along_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: orders(:)
    !> Harmonics of the solutions, shape (n_lanes, 2 n_orders, n_dof), and the synthesis matrix to
    !! samples at the nodes, shape (2 n_orders, n).
    real(wp), intent(in), contiguous :: x(:, :, :), synthesis(:, :)
    !> Phase angle of a step (rad).
    real(wp), intent(in) :: phase
    !> 0: no solution in this lane.
    real(wp), intent(in) :: h(n_lanes)
    real(wp) :: rate(n_lanes, size(x, 2)), per_time(n_lanes)
    integer :: a, b, j, k, n

    n = size(synthesis, 2)
    do b = 1, self%n_dof
      call lane_product(size(x, 2), n, x(:, :, b), synthesis, self%u(1, b))
    end do
    per_time = phase/max(h, tiny(1.0_wp))
    where (.not. h > 0.0_wp) per_time = 0.0_wp
    do b = 1, size(self%rates)
      do k = 1, size(orders)
        rate(:, 2*k - 1) = -orders(k)*per_time*x(:, 2*k, self%rates(b))
        rate(:, 2*k) = orders(k)*per_time*x(:, 2*k - 1, self%rates(b))
      end do
      call lane_product(size(x, 2), n, rate, synthesis, self%u(1, self%n_dof + b))
    end do
    if (any(system%bent)) call system%deflection_slopes(self%u, self%slopes)
    if (system%separable) then
      do b = 1, self%n_dof
        do a = 1, self%n_dof
          self%stiffness(:, a, b) = self%rest(a, b)
        end do
        do j = 1, size(self%w, 2)
          if (.not. system%bent(j)) cycle
          call add(self%slopes(:, j, b), b, self%stiffness)
        end do
      end do
    else
      call self%inseparable(system)
    end if
    call scale(h**2, self%stiffness)
    if (size(self%rates) == 0) return
    do b = 1, self%n_dof
      do a = 1, self%n_dof
        self%drags(:, a, b) = self%damping(a, b)
      end do
    end do
    do k = 1, size(self%rates)
      do j = 1, size(self%w, 2)
        if (.not. system%bent(j)) cycle
        call add(self%slopes(:, j, self%n_dof + k), self%rates(k), self%drags)
      end do
    end do
    call scale(h, self%drags)

  contains

    !> Add the effect of variable j under a perturbation of coordinate b.
    pure subroutine add(slope, b, matrices)
      real(wp), intent(in), contiguous :: slope(:)
      integer, intent(in) :: b
      real(wp), intent(inout), contiguous :: matrices(:, :, :)
      integer :: i
      do i = 1, self%n_dof
        if (.not. abs(self%spread(i, j)) > 0.0_wp) cycle
        matrices(:, i, b) = matrices(:, i, b) + (self%spread(i, j)/self%unit(b))*slope
      end do
    end subroutine add

    pure subroutine scale(factors, matrices)
      real(wp), intent(in) :: factors(n_lanes)
      real(wp), intent(inout), contiguous :: matrices(:, :, :)
      integer :: i, c, r
      do c = 1, self%n_dof
        do r = 1, self%n_dof
          do i = 1, n_lanes*n, n_lanes
            matrices(i:i + n_lanes - 1, r, c) = factors*matrices(i:i + n_lanes - 1, r, c)
          end do
        end do
      end do
    end subroutine scale

  end subroutine fill

  !> M^(-1) dF/du if F(u, v) is nonlinear in v too.
  subroutine inseparable(self, system)
    class(along_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer :: a, b, e, j

    call system%deflection_remainder(self%u, self%w)
    do j = 1, size(self%w, 2)
      if (.not. system%bent(j)) self%w(:, j) = 0.0_wp
      do b = 1, self%n_dof
        if (.not. abs(system%gather(j, b)) > 0.0_wp) cycle
        self%w(:, j) = self%w(:, j) + system%gather(j, b)*self%u(:, b)
      end do
    end do
    call system%force_slopes(self%u, self%w, self%by_u, self%by_v)
    self%stiffness = 0.0_wp
    do b = 1, self%n_dof
      do e = 1, self%n_dof
        self%along = self%by_u(:, e, b)
        do j = 1, size(self%w, 2)
          if (system%bent(j)) then
            self%along = self%along + (system%spread(e, j) + self%by_v(:, e, j)) &
                         *(system%gather(j, b) + self%slopes(:, j, b))
          else if (abs(system%gather(j, b)) > 0.0_wp) then
            self%along = self%along + (system%spread(e, j) + self%by_v(:, e, j)) &
                         *system%gather(j, b)
          end if
        end do
        do a = 1, self%n_dof
          if (.not. abs(self%inverse(a, e)) > 0.0_wp) cycle
          self%stiffness(:, a, b) = self%stiffness(:, a, b) + (self%inverse(a, e)/self%unit(b)) &
                                    *self%along
        end do
      end do
    end do
  end subroutine inseparable

end module viscovib_linear_along
