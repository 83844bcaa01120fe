! Optimize: -O3
!> Polynomial systems without memory, with any force laws, one system per vector lane: a
!! `polynomial_motion_type` with different parameters in every lane.
!!
!!   M u'' = s_load Im sum_k P_k exp(i k nu t) - s_damping C u' - s_stiffness K u - s_forces f(u).
!!
!! nu and the scales s differ between lanes; with `take_lane` all other parameters may differ too.
module viscovib_lane_motion
  use viscovib_dense, only: invert
  use viscovib_driven_system, only: differentiable_system_type, range_of_degree
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: multiply_lanes, n_lanes, turn
  use viscovib_law_lanes, only: evaluate_term
  use viscovib_law_program, only: put_number
  use viscovib_law_term, only: law_term
  use viscovib_load, only: load_type
  use viscovib_polynomial, only: highest_degree, monomial_type, multiply, polynomial_type
  implicit none
  private

  public :: lane_motion_type, new_lane_motion

  !> Number of scales of a lane, and the index of each.
  integer, parameter, public :: n_scales = 4
  integer, parameter :: of_load = 1, of_stiffness = 2, of_damping = 3, of_forces = 4

  type, extends(differentiable_system_type) :: lane_motion_type
    type(monomial_type), allocatable :: monomials(:)
    type(law_term), allocatable :: laws(:)
    integer, allocatable :: orders(:)
    !> M^(-1) times K, C, each monomial, each law and both parts of P_k, scaled, lane first. For the
    !! unscaled system: parts of K and C that are scaled (`own`), not scaled (`rest`) or scaled with
    !! the laws (`of_laws`), and plain weights.
    real(wp), allocatable :: stiffness(:, :, :), damping(:, :, :), weights(:, :, :)
    real(wp), allocatable :: law_weights(:, :, :), real_load(:, :, :), load(:, :, :)
    real(wp), allocatable, private :: own(:, :, :), rest(:, :, :), of_laws(:, :, :)
    real(wp), allocatable, private :: plain(:, :), plain_laws(:, :)
    !> M^(-1) times the load at the frequency of the last lane; the load, and M^(-1).
    complex(wp), allocatable, private :: plain_load(:, :)
    type(load_type), private :: given
    real(wp), allocatable, private :: inverse(:, :)
  contains
    procedure :: set_scales
    procedure :: fastest
    procedure :: differs_in_numbers
    procedure :: take_lane
    procedure :: acceleration
    procedure :: tangent
    procedure :: potential
    procedure :: margin
  end type lane_motion_type

contains

  subroutine new_lane_motion(motion, system, load, own)
    type(lane_motion_type), intent(out) :: motion
    type(polynomial_type), intent(in) :: system
    type(load_type), intent(in) :: load
    !> Scaled parts of stiffness and damping, without the linear part of laws, shape (n_dof, n_dof,
    !! 2).
    real(wp), intent(in) :: own(:, :, :)
    complex(wp) :: inverse(system%n_dof(), system%n_dof())
    real(wp) :: m(system%n_dof(), system%n_dof()), by(system%n_dof(), 2)
    logical :: singular
    integer :: d, i, n

    n = system%n_dof()
    motion%n_dof = n
    motion%monomials = system%monomials
    motion%laws = system%laws
    call motion%layers%find(system%laws)
    motion%orders = load%orders
    motion%drives = [0.0_wp, 0.0_wp]
    motion%quarters = [0, 3]
    motion%limited = .false.
    motion%range = range_of_degree(highest_degree(system%monomials), size(system%laws) > 0)
    call invert(cmplx(system%mass, 0.0_wp, wp), inverse, singular)
    m = real(inverse)
    motion%own = own
    motion%rest = own
    do i = 1, 2
      motion%own(:, :, i) = matmul(m, own(:, :, i))
    end do
    motion%rest(:, :, 1) = matmul(m, system%stiffness_at_rest()) - motion%own(:, :, 1)
    motion%rest(:, :, 2) = matmul(m, system%damping) - motion%own(:, :, 2)
    motion%plain_load = matmul(m, load%force)
    motion%given = load
    motion%inverse = m
    allocate (motion%plain(n, size(system%monomials)), motion%plain_laws(n, size(system%laws)))
    do i = 1, size(system%monomials)
      associate (term => system%monomials(i))
        motion%plain(:, i) = m(:, term%equation)*term%coefficient
      end associate
    end do
    allocate (motion%of_laws(n, n, 2), source=0.0_wp)
    do i = 1, size(system%laws)
      motion%plain_laws(:, i) = matmul(m(:, system%laws(i)%equations), system%laws(i)%weights)
      call motion%laws(i)%part_last(by(:, 1), by(:, 2))
      do d = 1, n
        motion%of_laws(d, :, :) = motion%of_laws(d, :, :) + motion%plain_laws(d, i)*by
      end do
    end do
    ! Lanes without parameters stay at rest.
    allocate (motion%stiffness(n_lanes, n, n), motion%damping(n_lanes, n, n), source=0.0_wp)
    allocate (motion%weights(n_lanes, n, size(system%monomials)), source=0.0_wp)
    allocate (motion%law_weights(n_lanes, n, size(system%laws)), source=0.0_wp)
    allocate (motion%real_load(n_lanes, n, size(load%orders)), source=0.0_wp)
    allocate (motion%load(n_lanes, n, size(load%orders)), source=0.0_wp)
  end subroutine new_lane_motion

  !> Set the scales of a lane, and the load at its frequency.
  pure subroutine set_scales(self, lane, scales, nu)
    class(lane_motion_type), intent(inout) :: self
    integer, intent(in) :: lane
    real(wp), intent(in) :: scales(n_scales), nu
    integer :: j

    if (self%given%varies()) then
      do j = 1, size(self%orders)
        self%plain_load(:, j) = matmul(self%inverse, self%given%force_at(j, nu))
      end do
    end if
    self%stiffness(lane, :, :) = self%rest(:, :, 1) + scales(of_stiffness)*self%own(:, :, 1) &
                                 + scales(of_forces)*self%of_laws(:, :, 1)
    self%damping(lane, :, :) = self%rest(:, :, 2) + scales(of_damping)*self%own(:, :, 2) &
                               + scales(of_forces)*self%of_laws(:, :, 2)
    self%weights(lane, :, :) = scales(of_forces)*self%plain
    self%law_weights(lane, :, :) = scales(of_forces)*self%plain_laws
    self%real_load(lane, :, :) = scales(of_load)*real(self%plain_load)
    self%load(lane, :, :) = scales(of_load)*aimag(self%plain_load)
  end subroutine set_scales

  !> Upper bound of the rates of the linear subsystem with these scales (rad/s).
  pure real(wp) function fastest(self, scales)
    class(lane_motion_type), intent(in) :: self
    real(wp), intent(in) :: scales(n_scales)
    fastest = sqrt(abs(scales(of_stiffness))*largest(self%own(:, :, 1)) &
                   + largest(self%rest(:, :, 1))) &
              + abs(scales(of_damping))*largest(self%own(:, :, 2)) + largest(self%rest(:, :, 2))
  contains
    pure real(wp) function largest(matrix)
      real(wp), intent(in) :: matrix(:, :)
      largest = maxval(sum(abs(matrix), 2))
    end function largest
  end function fastest

  !> True if another motion has the same form and differs only in the data that `take_lane` copies.
  pure logical function differs_in_numbers(self, other) result(does)
    class(lane_motion_type), intent(in) :: self
    type(lane_motion_type), intent(in) :: other
    logical, allocatable :: same(:)
    integer :: i

    does = self%n_dof == other%n_dof .and. size(self%monomials) == size(other%monomials) &
           .and. size(self%laws) == size(other%laws) .and. size(self%orders) == size(other%orders)
    if (.not. does) return
    does = all(self%orders == other%orders)
    do i = 1, size(self%monomials)
      associate (own => self%monomials(i), its => other%monomials(i))
        if (size(own%dof) /= size(its%dof)) does = .false.
        if (does) does = all(own%dof == its%dof .and. own%power == its%power)
      end associate
    end do
    do i = 1, size(self%laws)
      associate (own => self%laws(i), its => other%laws(i))
        if (size(own%program%code) /= size(its%program%code) &
            .or. any(shape(own%arguments) /= shape(its%arguments))) does = .false.
        if (.not. does) return
        same = abs(own%program%number - its%program%number) <= 0.0_wp
        does = all(own%program%code == its%program%code) &
               .and. all(same .or. own%program%code == put_number) &
               .and. all(abs(own%arguments - its%arguments) <= 0.0_wp) &
               .and. all(abs(own%rates - its%rates) <= 0.0_wp)
      end associate
    end do
  end function differs_in_numbers

  !> Copy the parameters of the first lane of another motion of the same form.
  subroutine take_lane(self, lane, other)
    class(lane_motion_type), intent(inout) :: self
    integer, intent(in) :: lane
    type(lane_motion_type), intent(in) :: other
    integer :: i

    self%stiffness(lane, :, :) = other%stiffness(1, :, :)
    self%damping(lane, :, :) = other%damping(1, :, :)
    self%weights(lane, :, :) = other%weights(1, :, :)
    self%law_weights(lane, :, :) = other%law_weights(1, :, :)
    self%real_load(lane, :, :) = other%real_load(1, :, :)
    self%load(lane, :, :) = other%load(1, :, :)
    do i = 1, size(self%laws)
      associate (program => self%laws(i)%program)
        if (.not. allocated(program%of_lanes)) then
          program%of_lanes = spread(program%number, 1, n_lanes)
        end if
        program%of_lanes(lane, :) = other%laws(i)%program%number
      end associate
    end do
    if (.not. self%layers%exist()) return
    if (.not. allocated(self%lane_layers)) allocate (self%lane_layers(n_lanes))
    self%lane_layers(lane) = other%layers
  end subroutine take_lane

  pure subroutine acceleration(self, q, v, drive, a)
    class(lane_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    real(wp) :: product(n_lanes)
    integer :: d, i, j

    call linear_part(self, q, v, drive, a)
    do i = 1, size(self%monomials)
      product = 1.0_wp
      associate (term => self%monomials(i))
        do j = 1, size(term%dof)
          call multiply_lanes(product, q(:, term%dof(j)), term%power(j))
        end do
      end associate
      do d = 1, self%n_dof
        call take_product(a(:, d), self%weights(:, d, i), product)
      end do
    end do
    do i = 1, size(self%laws)
      call evaluate_term(self%laws(i), q, v, product)
      do d = 1, self%n_dof
        call take_product(a(:, d), self%law_weights(:, d, i), product)
      end do
    end do
  end subroutine acceleration

  !> Accelerations by loads, dampers and springs.
  pure subroutine linear_part(self, q, v, drive, a)
    class(lane_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    real(wp), dimension(n_lanes) :: c, s
    integer :: d, k, order

    call springs(self, q, v, a)
    order = 0
    c = 1.0_wp
    s = 0.0_wp
    do k = 1, size(self%orders)
      do while (order < self%orders(k))
        if (order == 0) then
          c = drive(:, 1)
          s = drive(:, 2)
        else
          call turn(c, s, drive)
        end if
        order = order + 1
      end do
      do d = 1, self%n_dof
        call add_products(a(:, d), self%real_load(:, d, k), s, self%load(:, d, k), c)
      end do
    end do
  end subroutine linear_part

  pure subroutine springs(self, q, v, a)
    class(lane_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    real(wp) :: total(n_lanes)
    integer :: b, d
    do d = 1, self%n_dof
      total = 0.0_wp
      do b = 1, self%n_dof
        call add_products(total, self%stiffness(:, d, b), q(:, b), self%damping(:, d, b), v(:, b))
      end do
      a(:, d) = -total
    end do
  end subroutine springs

  !> total + (x y + z w), in every vector lane.
  pure subroutine add_products(total, x, y, z, w)
    real(wp), intent(inout) :: total(n_lanes)
    real(wp), intent(in), dimension(n_lanes) :: x, y, z, w
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = total(l) + (x(l)*y(l) + z(l)*w(l))
    end do
  end subroutine add_products

  !> total - x y, in every vector lane.
  pure subroutine take_product(total, x, y)
    real(wp), intent(inout) :: total(n_lanes)
    real(wp), intent(in) :: x(n_lanes), y(n_lanes)
    integer :: l
    !GCC$ unroll 1
    do l = 1, n_lanes
      total(l) = total(l) - x(l)*y(l)
    end do
  end subroutine take_product

  !> Derivatives by the product rule and by the derivatives of laws.
  pure subroutine tangent(self, q, v, drive, dq, dv, a, da)
    class(lane_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(in) :: dq(n_lanes, self%n_dof), dv(n_lanes, self%n_dof)
    real(wp), intent(out) :: a(n_lanes, self%n_dof), da(n_lanes, self%n_dof)
    real(wp) :: product(n_lanes), change(n_lanes), value(n_lanes)
    real(wp), allocatable :: slopes(:, :), turned(:, :)
    integer :: d, i, j, k

    call self%acceleration(q, v, drive, a)
    call springs(self, dq, dv, da)
    do i = 1, size(self%monomials)
      change = 0.0_wp
      associate (term => self%monomials(i))
        do j = 1, size(term%dof)
          product = term%power(j)*dq(:, term%dof(j))
          do k = 1, size(term%dof)
            call multiply(product, q(:, term%dof(k)), term%power(k) - merge(1, 0, k == j))
          end do
          change = change + product
        end do
      end associate
      do d = 1, self%n_dof
        da(:, d) = da(:, d) - self%weights(:, d, i)*change
      end do
    end do
    do i = 1, size(self%laws)
      associate (law => self%laws(i))
        allocate (slopes(n_lanes, size(law%arguments, 1)))
        call law%program%differentiate(law%arguments_of_lanes(q, v), value, slopes)
        turned = slopes*law%arguments_of_lanes(dq, dv)
        change = sum(turned, 2)
        deallocate (slopes)
      end associate
      do d = 1, self%n_dof
        da(:, d) = da(:, d) - self%law_weights(:, d, i)*change
      end do
    end do
  end subroutine tangent

  !> Not needed for integration in time.
  pure subroutine potential(self, q, value, slope)
    class(lane_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(self%n_dof)
    real(wp), intent(out) :: value, slope(self%n_dof)
    value = 0.0_wp
    slope = 0.0_wp*q
  end subroutine potential

  !> The equations are valid everywhere.
  pure function margin(self, q)
    class(lane_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof)
    real(wp) :: margin(n_lanes)
    margin = 1.0_wp + 0.0_wp*q(:, 1)
  end function margin

end module viscovib_lane_motion
