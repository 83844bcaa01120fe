! Optimize: -O3
!> A structure with any number of coordinates, condensed to those with nonlinear forces or memory.
!!
!! M u'' + C u' + K u + Q g(Q^T u) = p with few columns of Q. Harmonic k of y = Q^T u satisfies
!!
!!   H(i k nu)^-1 (Y_k - Y0_k) + G_k = 0,   H(s) = Q^T D(s)^-1 Q,   Y0_k = Q^T D(i k nu)^-1 P_k,
!!
!! equation (1) of the theory of structures multiplied by H^-1. This is an oscillator with the
!! coordinates y, the dynamic stiffness H^-1 and the load H^-1 Y0. All methods based on harmonic
!! balance apply to it. The linear stiffness of elements with a kernel belongs to D, which has no
!! memory; g contains only its hereditary part, -R* kappa y.
module viscovib_structure
  use viscovib_compliance, only: compliance_type, push_type
  use viscovib_dense, only: invert
  use viscovib_frequency_law, only: frequency_law
  use viscovib_kinds, only: wp
  use viscovib_polynomial, only: polynomial_type
  use viscovib_resonant_compliance, only: bordered, bordered_slope, near_modes, without_modes
  use viscovib_static_form, only: static_form
  implicit none
  private

  public :: structure_type, structure_load, varying_push

  !> Finite value that represents an infinite dynamic stiffness.
  real(wp), parameter :: rigid = huge(1.0_wp)**0.25_wp

  !> Forces that are multiplied by a function of the frequency nu.
  type :: varying_push
    type(push_type) :: push
    type(frequency_law) :: law
  end type varying_push

  !> One harmonic of the load: forces, and the load by base motion, divided by mu^2.
  type :: structure_load
    integer :: order = 0
    type(push_type) :: force, base
    logical :: has_force = .true., moves_base = .false.
    !> Forces that depend on the frequency, of an order other than 0.
    type(varying_push), allocatable :: varying(:)
    !> Order 0: the limit of H^-1 Y0, shape (n_dof).
    complex(wp), allocatable :: at_rest(:)
  contains
    procedure :: find_push
    procedure :: find_at_rest
  end type structure_load

  !> Mass and damping of the coordinates do not enter the equations; the mass is only a weight.
  type, extends(polynomial_type) :: structure_type
    type(compliance_type) :: rest
    type(static_form) :: static
    type(structure_load), allocatable :: loads(:)
  contains
    procedure :: dynamic_stiffness
    procedure :: load_coefficient
    procedure :: add_frequency_slope
    procedure :: coupling
  end type structure_type

contains

  !> The forces at mu = k nu. Its flexible motion contains the part with the rate.
  pure subroutine find_push(self, mu, push)
    class(structure_load), intent(in) :: self
    real(wp), intent(in) :: mu
    type(push_type), intent(out) :: push
    integer :: i

    push%modes = 0.0_wp*self%force%modes
    push%poles = 0.0_wp*self%force%poles
    push%flexible = 0.0_wp*self%force%flexible
    call add(1.0_wp, self%force, push)
    call add(mu**2, self%base, push)
    do i = 1, size(self%varying)
      call add(self%varying(i)%law%at(mu/self%order), self%varying(i)%push, push)
    end do

  contains

    pure subroutine add(factor, one, total)
      real(wp), intent(in) :: factor
      type(push_type), intent(in) :: one
      type(push_type), intent(inout) :: total
      total%modes = total%modes + factor*one%modes
      total%poles = total%poles + factor*one%poles
      total%flexible = total%flexible + factor*(one%flexible &
                                                + cmplx(0.0_wp, mu, wp)*one%flexible_rate)
    end subroutine add

  end subroutine find_push

  !> The limit of H^-1 Y0 of the order 0.
  pure subroutine find_at_rest(self, static, rest)
    class(structure_load), intent(inout) :: self
    type(static_form), intent(in) :: static
    type(compliance_type), intent(in) :: rest
    complex(wp), dimension(rest%n_seen) :: at_rest, forces
    complex(wp) :: modes(rest%n_modes), poles(size(rest%poles))

    at_rest = (0.0_wp, 0.0_wp)
    call static%find(rest, at_rest, self%force, forces, modes, poles)
    self%at_rest = -forces
  end subroutine find_at_rest

  !> H(i mu)^-1, plus the hereditary parts sum_j B(:,j) W(j,:) (f_j - 1).
  pure subroutine dynamic_stiffness(self, mu, speed, fraction, stiffness)
    class(structure_type), intent(in) :: self
    !> A structure does not depend on the speed.
    real(wp), intent(in), contiguous :: mu(:)
    real(wp), intent(in) :: speed(:)
    complex(wp), intent(in), contiguous :: fraction(:, :)
    complex(wp), intent(out), contiguous :: stiffness(:, :, :)
    complex(wp) :: h(size(stiffness, 1), size(stiffness, 1), size(mu))
    integer :: b, j, k

    associate (not_needed => size(speed))
    end associate
    call self%rest%on_axis(mu, h)
    do k = 1, size(mu)
      if (abs(mu(k)) > 0.0_wp) then
        call invert_at(self, mu(k), h(:, :, k), stiffness(:, :, k))
      else
        stiffness(:, :, k) = self%rest%stiffness_at_rest
      end if
      do j = 1, size(self%kernel_of)
        if (self%kernel_of(j) == 0) cycle
        do b = 1, size(stiffness, 2)
          if (.not. abs(self%gather(j, b)) > 0.0_wp) cycle
          stiffness(:, b, k) = stiffness(:, b, k) + self%spread(:, j) &
                               *(self%gather(j, b)*(fraction(k, j) - 1.0_wp))
        end do
      end do
    end do
  end subroutine dynamic_stiffness

  !> H(i mu)^-1. It is computed from h unless a mode is near resonance.
  pure subroutine invert_at(self, mu, h, stiffness)
    class(structure_type), intent(in) :: self
    real(wp), intent(in) :: mu
    complex(wp), intent(in) :: h(:, :)
    complex(wp), intent(out) :: stiffness(:, :)
    complex(wp), allocatable :: x(:, :)
    integer, allocatable :: near(:)
    integer :: q

    allocate (near, source=near_modes(self%rest, mu))
    if (size(near) == 0) then
      call invert_compliance(h, stiffness)
      return
    end if
    q = size(h, 1)
    allocate (x(q + size(near), q + size(near)))
    call bordered(self%rest, near, mu, x)
    stiffness = x(:q, :q)
  end subroutine invert_at

  pure subroutine invert_compliance(h, stiffness)
    complex(wp), intent(in) :: h(:, :)
    complex(wp), intent(out) :: stiffness(:, :)
    logical :: singular
    integer :: a
    call invert(h, stiffness, singular)
    if (.not. singular) return
    stiffness = (0.0_wp, 0.0_wp)
    do a = 1, size(h, 1)
      stiffness(a, a) = rigid
    end do
  end subroutine invert_compliance

  !> H^-1 Y0 for one order. If `stiffness` and `fraction` are given: D Y0 minus its hereditary part.
  pure function load_coefficient(self, force, base, order, nu, stiffness, fraction) result(p)
    class(structure_type), intent(in) :: self
    complex(wp), intent(in) :: force(:), base(:)
    integer, intent(in) :: order
    real(wp), intent(in) :: nu
    complex(wp), intent(in), optional :: stiffness(:, :), fraction(:)
    complex(wp) :: p(size(force))
    complex(wp) :: h(size(p), size(p)), inverse(size(p), size(p)), y(size(p))
    integer :: i, j

    ! The load of the coordinates only determines which orders exist.
    p = 0.0_wp*(force + base)
    do j = 1, size(self%loads)
      if (self%loads(j)%order /= order) cycle
      if (order == 0) then
        p = self%loads(j)%at_rest
        return
      end if
      if (size(near_modes(self%rest, order*nu)) > 0) then
        p = near_forces(self, near_modes(self%rest, order*nu), order*nu, 0.0_wp*p, self%loads(j), &
                        -1.0_wp)
        cycle
      end if
      call deflections(self, self%loads(j), order*nu, y)
      if (present(stiffness) .and. present(fraction)) then
        p = matmul(stiffness, y)
        do i = 1, size(self%kernel_of)
          if (self%kernel_of(i) > 0) p = p - self%spread(:, i) &
                                         *((fraction(i) - 1.0_wp)*sum(self%gather(i, :)*y))
        end do
      else
        call self%rest%evaluate(cmplx(0.0_wp, order*nu, wp), h)
        call invert_compliance(h, inverse)
        p = matmul(inverse, y)
      end if
    end do
  end function load_coefficient

  !> H^-1 (Y - s Y0) near resonances, or its derivative by mu.
  pure function near_forces(self, near, mu, y, load, factor, slope) result(forces)
    class(structure_type), intent(in) :: self
    integer, intent(in) :: near(:)
    real(wp), intent(in) :: mu
    complex(wp), intent(in) :: y(:)
    type(structure_load), intent(in) :: load
    real(wp), intent(in) :: factor
    !> If present, return the derivative.
    logical, intent(in), optional :: slope
    complex(wp) :: forces(size(y))
    complex(wp), dimension(size(y) + size(near), size(y) + size(near)) :: x, bend
    complex(wp), dimension(size(y) + size(near)) :: right, right_slope
    type(structure_load) :: others
    type(push_type) :: push
    real(wp) :: value, bent
    integer :: i, q

    q = size(y)
    call bordered(self%rest, near, mu, x)
    others = load
    others%force = without_modes(load%force, near)
    others%base = without_modes(load%base, near)
    do i = 1, size(load%varying)
      others%varying(i)%push = without_modes(load%varying(i)%push, near)
    end do
    call deflections(self, others, mu, right(:q), right_slope(:q))
    call load%find_push(mu, push)
    right(q + 1:) = push%modes(near)
    right_slope(q + 1:) = 2.0_wp*mu*load%base%modes(near)
    do i = 1, size(load%varying)
      call load%varying(i)%law%find(mu/load%order, value, bent)
      right_slope(q + 1:) = right_slope(q + 1:) &
                            + bent/load%order*load%varying(i)%push%modes(near)
    end do
    right = -factor*right
    right_slope = -factor*right_slope
    right(:q) = right(:q) + y
    right = matmul(x, right)
    if (present(slope)) then
      call bordered_slope(self%rest, near, mu, bend)
      right = matmul(x, right_slope - matmul(bend, right))
    end if
    forces = right(:q)
  end function near_forces

  !> Y0 of one harmonic, and its derivative by mu.
  pure subroutine deflections(self, load, mu, y, slope)
    class(structure_type), intent(in) :: self
    type(structure_load), intent(in) :: load
    real(wp), intent(in) :: mu
    complex(wp), intent(out) :: y(:)
    complex(wp), intent(out), optional :: slope(:)
    complex(wp), dimension(size(y)) :: part, part_slope
    real(wp) :: value, bent
    integer :: i

    y = (0.0_wp, 0.0_wp)
    if (present(slope)) slope = (0.0_wp, 0.0_wp)
    if (load%has_force) then
      if (present(slope)) then
        call self%rest%answer(cmplx(0.0_wp, mu, wp), load%force, y, slope)
        slope = (0.0_wp, 1.0_wp)*slope
      else
        call self%rest%answer(cmplx(0.0_wp, mu, wp), load%force, y)
      end if
    end if
    do i = 1, size(load%varying)
      associate (one => load%varying(i))
        if (present(slope)) then
          call one%law%find(mu/load%order, value, bent)
          call self%rest%answer(cmplx(0.0_wp, mu, wp), one%push, part, part_slope)
          slope = slope + bent/load%order*part + value*((0.0_wp, 1.0_wp)*part_slope)
        else
          value = one%law%at(mu/load%order)
          call self%rest%answer(cmplx(0.0_wp, mu, wp), one%push, part)
        end if
        y = y + value*part
      end associate
    end do
    if (.not. load%moves_base) return
    call self%rest%answer(cmplx(0.0_wp, mu, wp), load%base, part, part_slope)
    y = y + mu**2*part
    if (present(slope)) slope = slope + mu*(2.0_wp*part + mu*((0.0_wp, 1.0_wp)*part_slope))
  end subroutine deflections

  !> Add d[H^-1 (Y - s Y0)]/dnu for each order: -k H^-1 [dH/dmu H^-1 (Y - s Y0) + s dY0/dmu].
  pure subroutine add_frequency_slope(self, orders, nu, y, load_orders, force, base, factor, total)
    class(structure_type), intent(in) :: self
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: nu
    complex(wp), intent(in) :: y(:, :)
    integer, intent(in) :: load_orders(:)
    complex(wp), intent(in) :: force(:, :), base(:, :)
    real(wp), intent(in) :: factor
    complex(wp), intent(inout) :: total(:, :)
    complex(wp), dimension(size(y, 2), size(y, 2), size(orders)) :: h, slope
    complex(wp) :: inverse(size(y, 2), size(y, 2))
    complex(wp), dimension(size(y, 2)) :: free, free_slope, moved
    type(structure_load) :: nothing
    integer, allocatable :: near(:)
    integer :: j, k

    call self%rest%on_axis(orders*nu, h, slope)
    do k = 1, size(orders)
      if (orders(k) == 0) cycle
      near = near_modes(self%rest, orders(k)*nu)
      if (size(near) > 0) then
        j = findloc(self%loads%order, orders(k), 1)
        if (j > 0) nothing = self%loads(j)
        if (j == 0) nothing = no_load(self)
        total(k, :) = total(k, :) + orders(k)*near_forces(self, near, orders(k)*nu, y(k, :), &
                                                          nothing, factor, .true.)
        cycle
      end if
      call invert_compliance(h(:, :, k), inverse)
      moved = y(k, :)
      free_slope = (0.0_wp, 0.0_wp)
      do j = 1, size(self%loads)
        if (self%loads(j)%order /= orders(k)) cycle
        call deflections(self, self%loads(j), orders(k)*nu, free, free_slope)
        moved = moved - factor*free
      end do
      total(k, :) = total(k, :) - orders(k)*matmul(inverse, factor*free_slope &
                                                   + matmul(slope(:, :, k), matmul(inverse, moved)))
    end do
    associate (not_needed => [size(load_orders), size(force), size(base)])
    end associate
  end subroutine add_frequency_slope

  pure type(structure_load) function no_load(self)
    class(structure_type), intent(in) :: self
    complex(wp) :: none(size(self%gather, 2))

    none = (0.0_wp, 0.0_wp)
    no_load%force%modes = spread((0.0_wp, 0.0_wp), 1, self%rest%n_modes)
    no_load%force%poles = 0.0_wp*self%rest%poles
    no_load%force%flexible = none
    no_load%force%flexible_rate = none
    call self%rest%complete_push(no_load%force)
    no_load%base = no_load%force
    allocate (no_load%varying(0))
  end function no_load

  !> The linear subsystem couples all coordinates.
  pure function coupling(self) result(coupled)
    class(structure_type), intent(in) :: self
    logical :: coupled(size(self%gather, 2), size(self%gather, 2))
    coupled = .true.
  end function coupling

end module viscovib_structure
