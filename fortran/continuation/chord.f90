! Optimize: -O2
!> Points of a curve between two adjacent points z_0, z_1, z = (x, p). Each point lies on a plane
!! <z_1 - z_0, z - z_0> = sigma <z_1 - z_0, z_1 - z_0>, which also works at folds.
module viscovib_chord
  use viscovib_curve, only: curve_type
  use viscovib_dense, only: factorize, solve
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: chord_type, chord_point, chord_factors, new_chord

  integer, parameter :: max_corrections = 12
  real(wp), parameter :: correction_tolerance = 1.0e-12_wp, as_rounding_lets = 1.0e-6_wp
  !> For an error estimate: tolerance relative to the first correction.
  real(wp), parameter :: part_of_first = 1.0e-5_wp
  !> The factorized derivatives are reused while corrections shrink by at least this factor.
  real(wp), parameter :: fast = 0.1_wp

  type :: chord_point
    real(wp) :: sigma = 0.0_wp, p = 0.0_wp
    !> dp/dsigma of a point that `go_to` computed.
    real(wp) :: slope = 0.0_wp
    !> Estimated next correction: of x relative to its norm, and of p. It is near rounding error.
    real(wp) :: left = 0.0_wp, left_p = 0.0_wp
    !> Unknowns, and dx/dsigma of a point that `go_to` computed, shapes (n).
    real(wp), allocatable :: x(:), x_slope(:)
  end type chord_point

  !> Factors of the bordered derivatives at the last point of a series of nearby points.
  type :: chord_factors
    !> True if the points serve an estimate, which needs the change by the first correction only.
    logical :: estimate = .false.
    !> Relative tolerance of the corrections; < 0: not yet determined.
    real(wp), private :: enough = -1.0_wp
    real(wp), allocatable, private :: matrix(:, :)
    integer, allocatable, private :: pivots(:)
  end type chord_factors

  type :: chord_type
    real(wp) :: p = 0.0_wp
    real(wp), allocatable :: x(:)
    !> Gradient of <z_1 - z_0, z>, and <z_1 - z_0, z_1 - z_0>.
    real(wp), allocatable, private :: normal_x(:)
    real(wp), private :: normal_p = 0.0_wp, length = 0.0_wp
  contains
    procedure :: go_to
    procedure :: sigma_of
    procedure :: border
  end type chord_type

contains

  pure subroutine new_chord(chord, curve, p, x)
    type(chord_type), intent(out) :: chord
    class(curve_type), intent(in) :: curve
    !> The adjacent points, shapes (2) and (n, 2).
    real(wp), intent(in) :: p(2), x(:, :)
    real(wp), allocatable :: weights(:)
    real(wp) :: total

    chord%p = p(1)
    chord%x = x(:, 1)
    allocate (weights(size(x, 1)), source=1.0_wp)
    if (allocated(curve%weights)) weights = curve%weights
    ! Squares are weighted by inertia and scaled by the norm of the solution and by p.
    total = sum(weights*x(:, 2)**2)
    chord%normal_x = x(:, 2) - x(:, 1)
    if (total > 0.0_wp) chord%normal_x = chord%normal_x*weights/total
    chord%normal_p = (p(2) - p(1))/maxval(abs(p))**2
    chord%length = sum(chord%normal_x*(x(:, 2) - x(:, 1))) + chord%normal_p*(p(2) - p(1))
  end subroutine new_chord

  !> The coordinate sigma of the plane through a point.
  pure real(wp) function sigma_of(self, p, x)
    class(chord_type), intent(in) :: self
    real(wp), intent(in) :: p, x(:)
    sigma_of = (sum(self%normal_x*(x - self%x)) + self%normal_p*(p - self%p))/self%length
  end function sigma_of

  !> Border the derivatives by x with those by p and the gradient of sigma, shape (n + 1, n + 1).
  pure subroutine border(self, by_p, matrix)
    class(chord_type), intent(in) :: self
    real(wp), intent(in) :: by_p(:)
    real(wp), intent(inout) :: matrix(:, :)
    integer :: n
    n = size(by_p)
    matrix(:n, n + 1) = by_p
    matrix(n + 1, :n) = self%normal_x
    matrix(n + 1, n + 1) = self%normal_p
  end subroutine border

  !> The point of the curve on the plane sigma, by Newton's method from a guess between a and b. The
  !! factorized derivatives are reused while the corrections shrink fast.
  subroutine go_to(self, curve, sigma, a, b, found, made, factors)
    class(chord_type), intent(in) :: self
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: sigma
    type(chord_point), intent(in) :: a, b
    type(chord_point), intent(out) :: found
    logical, intent(out) :: made
    !> Factors from the previous point, updated.
    type(chord_factors), intent(inout), optional :: factors
    type(chord_factors) :: own
    real(wp) :: part

    part = (sigma - a%sigma)/(b%sigma - a%sigma)
    found%sigma = sigma
    found%x = a%x + part*(b%x - a%x)
    found%p = a%p + part*(b%p - a%p)
    if (present(factors)) then
      call correct(self, curve, found, factors, made)
    else
      call correct(self, curve, found, own, made)
    end if
  end subroutine go_to

  subroutine correct(self, curve, found, factors, made)
    class(chord_type), intent(in) :: self
    class(curve_type), intent(inout) :: curve
    type(chord_point), intent(inout) :: found
    type(chord_factors), intent(inout) :: factors
    logical, intent(out) :: made
    real(wp) :: right(size(found%x) + 1), r(size(found%x)), by_p(size(found%x))
    real(wp) :: size_x, change, last, shrunk
    integer :: n, k
    logical :: singular, inside, factorized

    n = size(found%x)
    made = .false.
    factorized = allocated(factors%matrix)
    if (.not. factorized) allocate (factors%matrix(n + 1, n + 1), factors%pivots(n + 1))
    if (.not. factors%estimate) factors%enough = correction_tolerance
    last = huge(last)
    do k = 1, max_corrections
      if (factorized) then
        call curve%residual(found%x, found%p, r, inside)
      else
        call curve%equations(found%x, found%p, r, factors%matrix, by_p, inside)
      end if
      if (.not. inside) exit
      if (.not. factorized) then
        call self%border(by_p, factors%matrix)
        call factorize(n + 1, factors%matrix, factors%pivots, singular)
        if (singular) exit
      end if
      right(:n) = r
      right(n + 1) = (self%sigma_of(found%p, found%x) - found%sigma)*self%length
      call solve(n + 1, factors%matrix, factors%pivots, right)
      found%x = found%x - right(:n)
      found%p = found%p - right(n + 1)
      size_x = norm2(found%x)
      change = norm2(right(:n))
      if (.not. change <= size_x) exit
      if (factors%enough < 0.0_wp) then
        factors%enough = max(part_of_first*change/size_x, correction_tolerance)
      end if
      ! The next correction shrinks by at least the same factor.
      shrunk = 1.0_wp
      if (k > 1) shrunk = min(change/max(last, tiny(last)), 1.0_wp)
      ! Converged to the tolerance, or to the rounding error.
      made = change*shrunk <= factors%enough*size_x .and. abs(right(n + 1))*shrunk &
             <= factors%enough*abs(found%p)
      made = made .or. (.not. factorized .and. change <= as_rounding_lets*size_x &
                        .and. change >= last)
      found%left = change*shrunk/max(size_x, tiny(size_x))
      found%left_p = abs(right(n + 1))*shrunk
      if (made) exit
      factorized = k == 1 .or. shrunk <= fast
      last = change
    end do
    if (.not. made) then
      deallocate (factors%matrix, factors%pivots)
      return
    end if
    right = 0.0_wp
    right(n + 1) = self%length
    call solve(n + 1, factors%matrix, factors%pivots, right)
    found%slope = right(n + 1)
    found%x_slope = right(:n)
  end subroutine correct

end module viscovib_chord
