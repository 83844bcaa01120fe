!> A periodic load as a Fourier series: forces on the coordinates and motion of the base, both in
!! the form Im sum_k P_k exp(i k nu t). The base moves along the system's base direction, or with
!! one amplitude for each coordinate.
!!
!! The mean (k = 0) is the imaginary part of its coefficient.
module viscovib_load
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: load_type, new_load

  type :: load_type
    !> Harmonic orders k with a nonzero coefficient, ascending.
    integer, allocatable :: orders(:)
    !> Force coefficients (N, N m), shape (n_dof, size(orders)).
    complex(wp), allocatable :: force(:, :)
    !> Base displacement coefficients (m), shape (size(orders)).
    complex(wp), allocatable :: base(:)
    !> Additional base displacement of each coordinate, shape (n_dof, size(orders)).
    complex(wp), allocatable :: moved(:, :)
    !> Force coefficients per (k nu)^2 (kg, kg m), as unbalances have them, shape (n_dof,
    !! size(orders)).
    complex(wp), allocatable :: inertial(:, :)
    !> Orders given whose terms add up to 0.
    integer :: n_zero = 0
  contains
    procedure :: is_odd
    procedure :: moves_base
    procedure :: force_at
    procedure :: grows_with_frequency
    procedure :: scale
    procedure :: shift
    procedure :: coefficient
    procedure :: drives
    procedure :: take_part
  end type load_type

contains

  !> Collect the terms of a series; terms of the same order add up, terms
  !! that vanish are dropped.
  subroutine new_load(load, n_dof, orders, force, base, status, moved, inertial)
    type(load_type), intent(out) :: load
    integer, intent(in) :: n_dof
    !> Order of each term, >= 0, shape (n).
    integer, intent(in) :: orders(:)
    !> Shape (n_dof, n) and (n).
    complex(wp), intent(in) :: force(:, :), base(:)
    type(status_type), intent(out) :: status
    !> Base displacement of each coordinate, shape (n_dof, n).
    complex(wp), intent(in), optional :: moved(:, :)
    !> Forces per (k nu)^2, shape (n_dof, n); of order 0 they are 0.
    complex(wp), intent(in), optional :: inertial(:, :)
    complex(wp), dimension(n_dof, size(orders)) :: own, per_square
    complex(wp), allocatable :: total_force(:, :), total_base(:), total_moved(:, :), &
                                total_square(:, :)
    integer, allocatable :: place(:), different(:)
    integer :: k, j, n

    own = (0.0_wp, 0.0_wp)
    if (present(moved)) own = moved
    per_square = (0.0_wp, 0.0_wp)
    if (present(inertial)) per_square = inertial
    do j = 1, size(orders)
      if (orders(j) < 0) then
        call fail(status, status_input_error, 'load', 'load order '//show(orders(j)) &
                  //': must be 0 (mean), 1, 2, ...')
        return
      end if
      if (.not. all(finite([force(:, j), own(:, j), per_square(:, j), base(j)]))) then
        call fail(status, status_input_error, 'load', 'load of order '//show(orders(j)) &
                  //': must be finite numbers')
        return
      end if
      if (orders(j) == 0 .and. any(abs(real([force(:, j), own(:, j), base(j)])) > 0.0_wp)) then
        call fail(status, status_input_error, 'load', 'load of order 0 has a real part: the ' &
                  //'mean is the imaginary part (load = Im sum P_k exp(i k nu t))')
        return
      end if
    end do
    allocate (place(0:maxval([orders, 0])), source=0)
    place(orders) = 1
    different = pack([(k, k=0, ubound(place, 1))], place > 0)
    n = size(different)
    place(different) = [(k, k=1, n)]
    allocate (total_force(n_dof, n), total_base(n), total_moved(n_dof, n), total_square(n_dof, n), &
              source=(0.0_wp, 0.0_wp))
    do j = 1, size(orders)
      k = place(orders(j))
      total_force(:, k) = total_force(:, k) + force(:, j)
      total_base(k) = total_base(k) + base(j)
      total_moved(:, k) = total_moved(:, k) + own(:, j)
      total_square(:, k) = total_square(:, k) + per_square(:, j)
    end do
    associate (kept => pack([(k, k=1, n)], any(abs(total_force) > 0.0_wp, 1) &
                            .or. any(abs(total_moved) > 0.0_wp, 1) &
                            .or. any(abs(total_square) > 0.0_wp, 1) .or. abs(total_base) > 0.0_wp))
      load%n_zero = n - size(kept)
      load%orders = different(kept)
      load%force = total_force(:, kept)
      load%base = total_base(kept)
      load%moved = total_moved(:, kept)
      load%inertial = total_square(:, kept)
    end associate
  end subroutine new_load

  elemental logical function finite(z)
    complex(wp), intent(in) :: z
    finite = ieee_is_finite(real(z)) .and. ieee_is_finite(aimag(z))
  end function finite

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
    p = self%force(:, j) + (self%orders(j)*nu)**2*self%inertial(:, j)
  end function force_at

  !> Whether a force grows as the square of the frequency.
  pure logical function grows_with_frequency(self)
    class(load_type), intent(in) :: self
    grows_with_frequency = any(abs(self%inertial) > 0.0_wp)
  end function grows_with_frequency

  !> Multiply the forces.
  pure subroutine scale(self, factor)
    class(load_type), intent(inout) :: self
    real(wp), intent(in) :: factor
    self%force = factor*self%force
    self%inertial = factor*self%inertial
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
      p = self%force(:, j) + (order*nu)**2*self%inertial(:, j)
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
    driven = any(abs(self%force) > 0.0_wp, 2) .or. any(abs(self%inertial) > 0.0_wp, 2)
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
    part%orders = self%orders
    part%base = self%base
    part%moved = self%moved(pack([(i, i=1, size(kept))], kept), :)
    part%force = self%force(pack([(i, i=1, size(kept))], kept), :)
    part%inertial = self%inertial(pack([(i, i=1, size(kept))], kept), :)
  end subroutine take_part

end module viscovib_load
