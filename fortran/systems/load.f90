! Optimize: -O2 -fvect-cost-model=dynamic
!> A periodic load as a Fourier series: forces on the coordinates and motion of the base, both in
!! the form Im sum_k P_k exp(i k nu t). The base moves along the system's base direction, or with
!! one amplitude for each coordinate.
!!
!! The mean (k = 0) is the imaginary part of its coefficient. Forces may depend on the frequency:
!! P_k = P_k0 + sum_j P_kj g_j(nu) with given functions g_j, such as nu^2 for an unbalance.
module viscovib_load
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_frequency_law, only: frequency_law
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_timed_polynomials, only: timed_polynomials
  implicit none
  private

  public :: load_type, new_load, varying_force

  !> Force coefficients that are multiplied by a function of the frequency.
  type :: varying_force
    !> Index of its order.
    integer :: place = 0
    !> Shape (n_dof).
    complex(wp), allocatable :: force(:)
    type(frequency_law) :: law
  end type varying_force

  type :: load_type
    !> Harmonic orders k with a nonzero coefficient, ascending.
    integer, allocatable :: orders(:)
    !> Force coefficients (N, N m), shape (n_dof, size(orders)).
    complex(wp), allocatable :: force(:, :)
    !> Base displacement coefficients (m), shape (size(orders)).
    complex(wp), allocatable :: base(:)
    !> Additional base displacement of each coordinate, shape (n_dof, size(orders)).
    complex(wp), allocatable :: moved(:, :)
    !> Forces that depend on the frequency.
    type(varying_force), allocatable :: varying(:)
    !> Orders given whose terms add up to 0.
    integer :: n_zero = 0
    !> Loads that are not periodic, a row each, and the force on each coordinate per unit of a row,
    !! shape (n_dof, n_rows). A row may be the acceleration of a base to which the coordinates are
    !! relative, and which moves them by `floors` (n_dof, n_rows); of other rows these are 0. Not
    !! allocated: none.
    type(timed_polynomials) :: table
    real(wp), allocatable :: pushes(:, :), floors(:, :)
  contains
    procedure :: has_table
    procedure :: add_row
    procedure :: forces_in_time
    procedure :: corners
    procedure :: is_odd
    procedure :: moves_base
    procedure :: force_at
    procedure :: add_varying
    procedure :: varies
    procedure :: touches
    procedure :: check_at
    procedure :: check_between
    procedure :: scale
    procedure :: shift
    procedure :: coefficient
    procedure :: drives
    procedure :: take_part
  end type load_type

contains

  !> Collect the terms of a series; terms of the same order add up, terms
  !! that vanish are dropped.
  subroutine new_load(load, n_dof, orders, force, base, status, moved, laws, law_of)
    type(load_type), intent(out) :: load
    integer, intent(in) :: n_dof
    !> Order of each term, >= 0, shape (n).
    integer, intent(in) :: orders(:)
    !> Shape (n_dof, n) and (n).
    complex(wp), intent(in) :: force(:, :), base(:)
    type(status_type), intent(out) :: status
    !> Base displacement of each coordinate, shape (n_dof, n).
    complex(wp), intent(in), optional :: moved(:, :)
    !> Functions of the frequency, and for each term the index of the function that multiplies its
    !! force, 0: none, shape (n).
    type(frequency_law), intent(in), optional :: laws(:)
    integer, intent(in), optional :: law_of(:)
    complex(wp), dimension(n_dof, size(orders)) :: own, constant
    complex(wp), allocatable :: total_force(:, :), total_base(:), total_moved(:, :)
    integer, allocatable :: place(:), different(:)
    logical, allocatable :: kept(:)
    integer :: by(size(orders)), k, j, n

    own = (0.0_wp, 0.0_wp)
    if (present(moved)) own = moved
    by = 0
    if (present(law_of)) by = law_of
    do j = 1, size(orders)
      if (orders(j) < 0) then
        call fail(status, status_input_error, 'load', 'load order '//show(orders(j)) &
                  //': must be 0 (mean), 1, 2, ...')
        return
      end if
      if (.not. all(finite([force(:, j), own(:, j), base(j)]))) then
        call fail(status, status_input_error, 'load', 'load of order '//show(orders(j)) &
                  //': must be finite numbers')
        return
      end if
      if (orders(j) == 0 .and. any(abs(real([force(:, j), own(:, j), base(j)])) > 0.0_wp)) then
        call fail(status, status_input_error, 'load', 'load of order 0 has a real part: the ' &
                  //'mean is the imaginary part (load = Im sum P_k exp(i k nu t))')
        return
      end if
      if (orders(j) == 0 .and. by(j) > 0) then
        call fail(status, status_input_error, 'load', 'load of order 0: a mean must not depend ' &
                  //'on nu')
        return
      end if
    end do
    allocate (place(0:maxval([orders, 0])), source=0)
    place(orders) = 1
    different = pack([(k, k=0, ubound(place, 1))], place > 0)
    n = size(different)
    place(different) = [(k, k=1, n)]
    allocate (total_force(n_dof, n), total_base(n), total_moved(n_dof, n), source=(0.0_wp, 0.0_wp))
    constant = force*spread(merge(1.0_wp, 0.0_wp, by == 0), 1, n_dof)
    do j = 1, size(orders)
      k = place(orders(j))
      total_force(:, k) = total_force(:, k) + constant(:, j)
      total_base(k) = total_base(k) + base(j)
      total_moved(:, k) = total_moved(:, k) + own(:, j)
    end do
    kept = any(abs(total_force) > 0.0_wp, 1) .or. any(abs(total_moved) > 0.0_wp, 1) &
           .or. abs(total_base) > 0.0_wp
    do j = 1, size(orders)
      if (by(j) > 0) kept(place(orders(j))) = .true.
    end do
    load%n_zero = n - count(kept)
    load%orders = pack(different, kept)
    load%base = pack(total_base, kept)
    associate (which => pack([(k, k=1, n)], kept))
      load%force = total_force(:, which)
      load%moved = total_moved(:, which)
    end associate
    allocate (load%varying(0))
    do j = 1, size(orders)
      if (by(j) > 0) call append(load, orders(j), force(:, j), laws(by(j)))
    end do
  end subroutine new_load

  !> Add forces of one order that depend on the frequency.
  subroutine append(load, order, force, law)
    type(load_type), intent(inout) :: load
    integer, intent(in) :: order
    complex(wp), intent(in) :: force(:)
    type(frequency_law), intent(in) :: law
    type(varying_force), allocatable :: more(:)
    integer :: n

    n = size(load%varying)
    allocate (more(n + 1))
    more(:n) = load%varying
    more(n + 1)%place = findloc(load%orders, order, 1)
    more(n + 1)%force = force
    more(n + 1)%law = law
    call move_alloc(more, load%varying)
  end subroutine append

  elemental logical function finite(z)
    complex(wp), intent(in) :: z
    finite = ieee_is_finite(real(z)) .and. ieee_is_finite(aimag(z))
  end function finite

  pure logical function has_table(self)
    class(load_type), intent(in) :: self
    has_table = allocated(self%pushes)
  end function has_table

  !> Add a load in time.
  subroutine add_row(self, times, pieces, push, floor)
    class(load_type), intent(inout) :: self
    !> Shapes (n) and (n_powers, n), as of `timed_polynomials`.
    real(wp), intent(in) :: times(:), pieces(:, :)
    !> Shape (n_dof).
    real(wp), intent(in) :: push(:), floor(:)
    type(timed_polynomials) :: row
    real(wp), allocatable :: wide(:, :, :)
    integer :: m

    m = 1
    if (self%has_table()) m = size(self%pushes, 2) + 1
    row%breaks = times
    allocate (row%pieces(m, size(pieces, 1), size(times)), source=0.0_wp)
    row%pieces(m, :, :) = pieces
    if (m == 1) then
      self%table = row
      self%pushes = reshape(push, [size(push), 1])
      self%floors = reshape(floor, [size(push), 1])
      return
    end if
    allocate (wide(m, size(self%table%pieces, 2), size(self%table%breaks)), source=0.0_wp)
    wide(:m - 1, :, :) = self%table%pieces
    call move_alloc(wide, self%table%pieces)
    self%pushes = reshape([self%pushes, push], [size(push), m])
    self%floors = reshape([self%floors, floor], [size(push), m])
    call self%table%add(row)
  end subroutine add_row

  !> The loads in time as forces on the coordinates, polynomials of shape (n_dof, n_powers, n)
  !! between breaks (n); n = 1 without any.
  pure subroutine forces_in_time(self, breaks, pieces)
    class(load_type), intent(in) :: self
    real(wp), allocatable, intent(out) :: breaks(:), pieces(:, :, :)
    integer :: i

    if (.not. self%has_table()) then
      allocate (breaks(1), pieces(size(self%force, 1), 4, 1), source=0.0_wp)
      return
    end if
    breaks = self%table%breaks
    allocate (pieces(size(self%pushes, 1), size(self%table%pieces, 2), size(breaks)))
    do i = 1, size(breaks)
      pieces(:, :, i) = matmul(self%pushes, self%table%pieces(:, :, i))
    end do
  end subroutine forces_in_time

  !> Times on which steps end.
  pure function corners(self) result(times)
    class(load_type), intent(in) :: self
    real(wp), allocatable :: times(:)
    type(timed_polynomials) :: forces
    allocate (times(0))
    if (.not. self%has_table()) return
    call self%forces_in_time(forces%breaks, forces%pieces)
    times = forces%corners()
  end function corners

  !> True if every order is odd: the load changes sign after half a period.
  pure logical function is_odd(self)
    class(load_type), intent(in) :: self
    is_odd = all(mod(self%orders, 2) == 1)
  end function is_odd

  pure logical function moves_base(self)
    class(load_type), intent(in) :: self
    moves_base = any(is_set(self%base)) .or. any(is_set(self%moved))
  end function moves_base

  !> True unless z is 0; cheaper than its magnitude.
  elemental logical function is_set(z)
    complex(wp), intent(in) :: z
    is_set = abs(real(z)) > 0.0_wp .or. abs(aimag(z)) > 0.0_wp
  end function is_set

  !> Force coefficients of the order at place j at a frequency, without the base.
  pure function force_at(self, j, nu) result(p)
    class(load_type), intent(in) :: self
    integer, intent(in) :: j
    real(wp), intent(in) :: nu
    complex(wp) :: p(size(self%force, 1))
    integer :: i
    p = self%force(:, j)
    do i = 1, size(self%varying)
      if (self%varying(i)%place == j) p = p + self%varying(i)%law%at(nu)*self%varying(i)%force
    end do
  end function force_at

  !> Add the forces that depend on the frequency, and their derivatives by it, of the order at
  !! place j.
  pure subroutine add_varying(self, j, nu, p, slope)
    class(load_type), intent(in) :: self
    integer, intent(in) :: j
    real(wp), intent(in) :: nu
    complex(wp), intent(inout) :: p(:), slope(:)
    real(wp) :: value, bent
    integer :: i
    do i = 1, size(self%varying)
      if (self%varying(i)%place /= j) cycle
      call self%varying(i)%law%find(nu, value, bent)
      p = p + value*self%varying(i)%force
      slope = slope + bent*self%varying(i)%force
    end do
  end subroutine add_varying

  !> True if a force depends on the frequency.
  pure logical function varies(self)
    class(load_type), intent(in) :: self
    varies = size(self%varying) > 0
  end function varies

  !> Mask of the coordinates on which forces act, without the base.
  pure function touches(self) result(touched)
    class(load_type), intent(in) :: self
    logical :: touched(size(self%force, 1))
    integer :: i
    touched = any(abs(self%force) > 0.0_wp, 2)
    do i = 1, size(self%varying)
      touched = touched .or. abs(self%varying(i)%force) > 0.0_wp
    end do
  end function touches

  !> Fail if a force is not finite at one of these frequencies.
  subroutine check_at(self, nu, status)
    class(load_type), intent(in) :: self
    real(wp), intent(in) :: nu(:)
    type(status_type), intent(out) :: status
    integer :: i, k
    call set_ok(status)
    do i = 1, size(self%varying)
      do k = 1, size(nu)
        call self%varying(i)%law%check_at(nu(k), status)
        if (status%failed()) return
      end do
    end do
  end subroutine check_at

  !> Fail if a force is not finite in a range of frequencies.
  subroutine check_between(self, low, high, status)
    class(load_type), intent(in) :: self
    real(wp), intent(in) :: low, high
    type(status_type), intent(out) :: status
    integer :: i
    call set_ok(status)
    do i = 1, size(self%varying)
      call self%varying(i)%law%check_between(min(low, high), max(low, high), status)
      if (status%failed()) return
    end do
  end subroutine check_between

  !> Multiply the forces.
  pure subroutine scale(self, factor)
    class(load_type), intent(inout) :: self
    real(wp), intent(in) :: factor
    integer :: i
    self%force = factor*self%force
    do i = 1, size(self%varying)
      self%varying(i)%force = factor*self%varying(i)%force
    end do
  end subroutine scale

  !> What the base moves the coordinates of the system by, of the order at place j.
  pure function shift(self, system, j) result(y)
    class(load_type), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: j
    complex(wp) :: y(size(self%moved, 1))
    y = self%moved(:, j)
    if (abs(self%base(j)) > 0.0_wp) y = y + system%base_direction*self%base(j)
  end function shift

  !> Load coefficient of order k on the system coordinates, including base motion.
  pure function coefficient(self, system, order, nu) result(p)
    class(load_type), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    integer, intent(in) :: order
    real(wp), intent(in) :: nu
    complex(wp) :: p(size(self%force, 1))
    integer :: j

    p = (0.0_wp, 0.0_wp)
    do j = 1, size(self%orders)
      if (self%orders(j) /= order) cycle
      p = self%force_at(j, nu)
      if (.not. (self%moves_base() .or. system%condensed)) cycle
      p = system%load_coefficient(p, self%shift(system, j), order, nu)
    end do
  end function coefficient

  !> Mask of the coordinates on which the load acts, including base motion.
  pure function drives(self, system) result(driven)
    class(load_type), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    logical :: driven(size(self%force, 1))
    integer :: j
    driven = self%touches()
    if (self%has_table()) driven = driven .or. any(abs(self%pushes) > 0.0_wp, 2)
    if (.not. self%moves_base()) return
    do j = 1, size(self%orders)
      driven = driven .or. system%moved_by(self%shift(system, j))
    end do
  end function drives

  !> The load on the kept coordinates. It must not act on any other.
  pure subroutine take_part(self, kept, part)
    class(load_type), intent(in) :: self
    !> Shape (n_dof).
    logical, intent(in) :: kept(:)
    type(load_type), intent(out) :: part
    integer :: i
    if (self%has_table()) then
      part%table = self%table
      part%pushes = self%pushes(pack([(i, i=1, size(kept))], kept), :)
      part%floors = self%floors(pack([(i, i=1, size(kept))], kept), :)
    end if
    part%orders = self%orders
    part%base = self%base
    part%moved = self%moved(pack([(i, i=1, size(kept))], kept), :)
    part%force = self%force(pack([(i, i=1, size(kept))], kept), :)
    allocate (part%varying, source=self%varying)
    do i = 1, size(part%varying)
      part%varying(i)%force = pack(self%varying(i)%force, kept)
    end do
  end subroutine take_part

end module viscovib_load
