! Optimize: -O3
!> The matrices of small perturbations along periodic solutions without memory,
!!
!!   M y'' + C(t) y' + K(t) y = 0,   K(t) = dF/du, C(t) = C + dF/du' along the solution,
!!
!! for several solutions in the vector lanes, at the nodes of equal steps h: h^2 M^-1 K, and h D
!! with D = M^-1 C. Coordinates times the root of their mass have the same unit.
!!
!! For a condensed structure y are its few coordinates in units of mass 1, or its real modes. They
!! deflect its elements by d = S^T y, whose forces are -P g(d, d'), so that
!!
!!   y'' + C y' + K y + P [dg/dd S^T y + dg/dd' S^T y'] = 0.
module viscovib_linear_along
  use viscovib_cycle_terms, only: has_states
  use viscovib_dense, only: invert
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: lane_product, n_lanes
  use viscovib_oscillator, only: oscillator_type
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: along_type, counts_first, few_modes_of, new_along

  !> Largest number of modes of a structure whose perturbations are integrated, and the additional
  !! number for each deflection beyond the first.
  integer, parameter :: few_modes = 12, modes_a_deflection = 6, most_modes = 24
  !> Up to this number of modes integration is faster than counting exponents; limit of squared
  !! frequencies of rigid modes, relative to the largest.
  integer, parameter :: quick_modes = 4
  real(wp), parameter :: rigid = 1.0e-6_wp

  type :: along_type
    !> Number of perturbed coordinates, and of coordinates of the solution.
    integer :: n_dof = 0, n_seen = 0
    !> Upper bound of the linear frequencies and of the damping rates (1/s).
    real(wp) :: fastest = 0.0_wp
    !> sqrt(M_aa), and D in these units.
    real(wp), allocatable :: unit(:), damping(:, :)
    !> Coordinates of the solution whose rates occur in laws.
    integer, allocatable :: rates(:)
    !> h^2 M^-1 K at the nodes, and h D if it varies, shape (n, n_dof, n_dof).
    real(wp), allocatable :: stiffness(:, :, :), drags(:, :, :)
    !> M^-1, M^-1 B and M^-1 B W; of a structure S, shape (n_dof, n_seen), P B and K.
    real(wp), allocatable, private :: inverse(:, :), spread(:, :), rest(:, :), modes(:, :)
    real(wp), allocatable, private :: u(:, :), w(:, :), slopes(:, :, :), by_u(:, :, :)
    real(wp), allocatable, private :: by_v(:, :, :), along(:)
  contains
    procedure :: allocate_arrays
    procedure :: fill
    procedure, private :: take_coordinates
    procedure, private :: take_modes
    procedure, private :: slope
    procedure, private :: inseparable
  end type along_type

contains

  !> Number of coordinates or real modes for the perturbations of a structure; 0: too many, or
  !! memory, or states of elements.
  integer function few_modes_of(system) result(n)
    class(structure_type), intent(in) :: system
    integer :: work

    n = 0
    if (any(system%kernel_of > 0) .or. system%moving .or. has_states(system)) return
    associate (rest => system%rest)
      if (allocated(system%few%stiffness)) then
        n = size(system%few%stiffness, 1)
      else if (size(rest%poles) == 0 &
               .and. .not. any(abs(rest%losses(:rest%n_modes)) > 0.0_wp) &
               .and. .not. any(abs(rest%flexibility) > 0.0_wp) &
               .and. .not. any(abs(rest%flexibility_rate) > 0.0_wp)) then
        n = rest%n_modes
      end if
    end associate
    work = min(few_modes + modes_a_deflection*(system%n_dof() - 1), most_modes)
    if (n > work) n = 0
  end function few_modes_of

  !> True if counting exponents is faster than integrating the modes of a structure: with one
  !! deflection, and without rigid modes.
  logical function counts_first(system)
    class(structure_type), intent(in) :: system
    counts_first = few_modes_of(system) > quick_modes .and. system%n_dof() == 1
    if (.not. counts_first) return
    associate (squares => system%rest%squares(:system%rest%n_modes))
      counts_first = size(squares) > 0
      if (counts_first) counts_first = minval(abs(squares)) > rigid*maxval(abs(squares))
    end associate
  end function counts_first

  subroutine new_along(self, system)
    type(along_type), intent(out) :: self
    class(oscillator_type), intent(in) :: system

    self%n_seen = system%n_dof()
    allocate (self%rates(0))
    if (system%n_rates() > 0) self%rates = system%rates
    select type (system)
    class is (structure_type)
      call self%take_modes(system)
    class default
      call self%take_coordinates(system)
    end select
    self%fastest = sqrt(maxval(sum(abs(self%rest), 2))) + maxval(sum(abs(self%damping), 2))
  end subroutine new_along

  subroutine take_coordinates(self, system)
    class(along_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    complex(wp) :: inverse(size(system%mass, 1), size(system%mass, 1))
    logical :: singular
    integer :: a

    self%n_dof = self%n_seen
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
  end subroutine take_coordinates

  subroutine take_modes(self, system)
    class(along_type), intent(inout) :: self
    class(structure_type), intent(in) :: system
    integer :: i

    if (allocated(system%few%stiffness)) then
      self%n_dof = size(system%few%stiffness, 1)
      self%modes = system%few%seen
      self%spread = matmul(system%few%pushed, system%spread)
      self%rest = system%few%stiffness
      self%damping = system%few%damping
    else
      self%n_dof = system%rest%n_modes
      self%modes = system%rest%seen(:self%n_dof, :)
      self%spread = matmul(system%rest%pushed(:self%n_dof, :), system%spread)
      allocate (self%rest(self%n_dof, self%n_dof), self%damping(self%n_dof, self%n_dof), &
                source=0.0_wp)
      do i = 1, self%n_dof
        self%rest(i, i) = system%rest%squares(i)
        self%damping(i, i) = system%rest%rates(i)
      end do
    end if
    self%unit = spread(1.0_wp, 1, self%n_dof)
    self%rest = self%rest + matmul(self%spread, matmul(system%gather, transpose(self%modes)))
  end subroutine take_modes

  !> Allocate arrays for a number of nodes.
  subroutine allocate_arrays(self, system, n_nodes)
    class(along_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: n_nodes
    integer :: d, m, n

    d = self%n_dof
    m = system%n_memory()
    n = n_lanes*n_nodes
    allocate (self%u(n, self%n_seen + size(self%rates)), self%w(n, m), &
              self%slopes(n, m, self%n_seen + size(self%rates)), &
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
    !> Harmonics of the solutions, shape (n_lanes, 2 n_orders, n_seen), and the synthesis matrix to
    !! samples at the nodes, shape (2 n_orders, n).
    real(wp), intent(in), contiguous :: x(:, :, :), synthesis(:, :)
    !> Phase angle of a step (rad).
    real(wp), intent(in) :: phase
    !> 0: no solution in this lane.
    real(wp), intent(in) :: h(n_lanes)
    real(wp) :: rate(n_lanes, size(x, 2)), per_time(n_lanes)
    integer :: a, b, j, k, n

    n = size(synthesis, 2)
    do b = 1, self%n_seen
      call lane_product(size(x, 2), n, x(:, :, b), synthesis, self%u(1, b))
    end do
    per_time = phase/max(h, tiny(1.0_wp))
    where (.not. h > 0.0_wp) per_time = 0.0_wp
    do b = 1, size(self%rates)
      do k = 1, size(orders)
        rate(:, 2*k - 1) = -orders(k)*per_time*x(:, 2*k, self%rates(b))
        rate(:, 2*k) = orders(k)*per_time*x(:, 2*k - 1, self%rates(b))
      end do
      call lane_product(size(x, 2), n, rate, synthesis, self%u(1, self%n_seen + b))
    end do
    if (any(system%bent)) call system%deflection_slopes(self%u, self%slopes)
    if (system%separable) then
      do b = 1, self%n_dof
        do a = 1, self%n_dof
          self%stiffness(:, a, b) = self%rest(a, b)
        end do
        do j = 1, size(self%w, 2)
          if (.not. system%bent(j)) cycle
          if (allocated(self%modes)) then
            call add(self%slope(j, b), b, self%stiffness)
          else
            call add(self%slopes(:, j, b), b, self%stiffness)
          end if
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
        if (allocated(self%modes)) then
          do b = 1, self%n_dof
            call add(self%modes(b, self%rates(k))*self%slopes(:, j, self%n_seen + k), b, self%drags)
          end do
        else
          call add(self%slopes(:, j, self%n_seen + k), self%rates(k), self%drags)
        end if
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

  !> Derivative of variable j by mode b at the nodes.
  pure function slope(self, j, b)
    class(along_type), intent(in) :: self
    integer, intent(in) :: j, b
    real(wp) :: slope(size(self%slopes, 1))
    integer :: a

    slope = 0.0_wp
    do a = 1, self%n_seen
      if (abs(self%modes(b, a)) > 0.0_wp) slope = slope + self%modes(b, a)*self%slopes(:, j, a)
    end do
  end function slope

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
