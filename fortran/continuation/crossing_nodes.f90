!> Points between two adjacent points of a curve, with their exponents.
module viscovib_crossing_nodes
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use viscovib_chord, only: chord_point, chord_type
  use viscovib_curve, only: curve_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: node_type, spectrum_type, look_at, look_between, put_between

  !> Exponents of the solutions of a curve: logarithms of multipliers, growing ones first, imaginary
  !! parts within pi.
  type, abstract :: spectrum_type
    integer :: n = 0
    !> Exponents with larger real parts count as growing.
    real(wp) :: threshold = 0.0_wp
    !> Error of exponents near the axis if no other exponent grows.
    real(wp) :: noise = 1.0e-12_wp
    !> True if the multipliers are those of half a period.
    logical :: half_wave = .false.
    !> True if all exponents are always computed. Otherwise decaying exponents may be missing.
    logical :: complete = .true.
  contains
    procedure(look_interface), deferred :: look
    procedure :: follow
  end type spectrum_type

  abstract interface

    !> Exponents at a solution (p, x), padded with NaN, and the number that grow, -1: unknown.
    subroutine look_interface(self, curve, p, x, near, eta, n_growing)
      import :: curve_type, spectrum_type, wp
      class(spectrum_type), intent(inout) :: self
      class(curve_type), intent(inout) :: curve
      real(wp), intent(in) :: p, x(:)
      !> Exponents of a nearby solution.
      complex(wp), intent(in) :: near(:)
      complex(wp), intent(out) :: eta(:)
      integer, intent(out) :: n_growing
    end subroutine look_interface

  end interface

  !> A point of a chord with its exponents.
  type :: node_type
    type(chord_point) :: at
    complex(wp), allocatable :: eta(:)
    integer :: n_growing = -1
  end type node_type

contains

  !> The exponent near a given one. By default all exponents are computed.
  subroutine follow(self, curve, p, x, near, eta, made)
    class(spectrum_type), intent(inout) :: self
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p, x(:)
    complex(wp), intent(in) :: near
    complex(wp), intent(out) :: eta
    logical, intent(out) :: made
    complex(wp) :: all(self%n)
    integer :: n

    call self%look(curve, p, x, [near], all, n)
    made = n >= 0
    eta = near
    if (made) eta = all(minloc(abs(all - near), 1))
  end subroutine follow

  !> The point on the plane sigma between nodes a and b, with its exponents.
  subroutine look_at(curve, spectrum, chord, sigma, a, b, node)
    class(curve_type), intent(inout) :: curve
    class(spectrum_type), intent(inout) :: spectrum
    type(chord_type), intent(in) :: chord
    real(wp), intent(in) :: sigma
    type(node_type), intent(in) :: a, b
    type(node_type), intent(out) :: node
    complex(wp) :: near(spectrum%n)
    logical :: made

    if (sigma <= a%at%sigma .or. sigma >= b%at%sigma) then
      if (sigma <= a%at%sigma) then
        node = a
      else
        node = b
      end if
      return
    end if
    allocate (node%eta(spectrum%n))
    node%eta = a%eta
    if (b%at%sigma - sigma < sigma - a%at%sigma) then
      near = between(b%eta, a%eta, (b%at%sigma - sigma)/(b%at%sigma - a%at%sigma))
    else
      near = between(a%eta, b%eta, (sigma - a%at%sigma)/(b%at%sigma - a%at%sigma))
    end if
    call chord%go_to(curve, sigma, a%at, b%at, node%at, made)
    if (.not. made) return
    call spectrum%look(curve, node%at%p, node%at%x, near, node%eta, &
                       node%n_growing)
  end subroutine look_at

  !> The point amid two nodes, or one near it if the exponents there are not known.
  subroutine look_between(curve, spectrum, chord, a, b, node)
    class(curve_type), intent(inout) :: curve
    class(spectrum_type), intent(inout) :: spectrum
    type(chord_type), intent(in) :: chord
    type(node_type), intent(in) :: a, b
    type(node_type), intent(out) :: node
    real(wp), parameter :: parts(2) = [0.5_wp, 0.37_wp]
    integer :: k
    do k = 1, size(parts)
      call look_at(curve, spectrum, chord, a%at%sigma + parts(k)*(b%at%sigma - a%at%sigma), a, b, &
                   node)
      if (node%n_growing >= 0) return
    end do
  end subroutine look_between

  !> Exponents near those of one node, along straight lines to those of another if there is no doubt
  !! which of these is which.
  pure function between(one, other, part) result(near)
    complex(wp), intent(in) :: one(:), other(:)
    !> Of the way to the other node.
    real(wp), intent(in) :: part
    complex(wp) :: near(size(one))
    logical, dimension(size(one)) :: known, others_known
    integer :: i, j

    near = one
    known = ieee_is_finite(real(one))
    others_known = ieee_is_finite(real(other))
    do i = 1, size(one)
      if (.not. known(i)) cycle
      j = minloc(abs(other - one(i)), 1, others_known)
      if (j == 0) cycle
      if (minloc(abs(one - other(j)), 1, known) == i) near(i) = one(i) + part*(other(j) - one(i))
    end do
  end function between

  !> Linear interpolation between two nodes.
  subroutine put_between(a, b, sigma, node)
    type(node_type), intent(in) :: a, b
    real(wp), intent(in) :: sigma
    type(node_type), intent(out) :: node
    real(wp) :: part
    part = (sigma - a%at%sigma)/(b%at%sigma - a%at%sigma)
    node%at%sigma = sigma
    node%at%p = a%at%p + part*(b%at%p - a%at%p)
    node%at%x = a%at%x + part*(b%at%x - a%at%x)
    node%at%slope = (b%at%p - a%at%p)/(b%at%sigma - a%at%sigma)
    node%eta = a%eta
    where (ieee_is_finite(real(a%eta)) .and. ieee_is_finite(real(b%eta)))
      node%eta = a%eta + part*(b%eta - a%eta)
    end where
  end subroutine put_between

end module viscovib_crossing_nodes
