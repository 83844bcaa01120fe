!> Errors of bifurcation points: crossings of the imaginary axis by exponents, and branch points.
!! Each point is located again on the curve with more unknowns. The difference includes the
!! truncation error and the error of the first search; rounding errors of solutions and exponents
!! are added.
!!
!! The equations may be singular at the point itself. The test function is the real part of the
!! exponent or the determinant of the bordered derivatives. It is computed at nearby points. Its
!! zero is that of the line through two points if the location has moved further than the error of
!! the line, and of the cubic through four points otherwise.
module viscovib_crossing_errors
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_positive_inf, ieee_value
  use viscovib_chord, only: chord_factors, chord_point, chord_type, new_chord
  use viscovib_crossing_nodes, only: spectrum_type
  use viscovib_curve, only: curve_type
  use viscovib_dense, only: factorize
  use viscovib_kinds, only: wp
  use viscovib_stopping, only: given_up
  implicit none
  private

  public :: exponent_error, branch_point_error

  !> Locations of the points in sigma, in units of the reach, in order of computation.
  integer, parameter :: n_nodes = 4, n_line = 2
  real(wp), parameter :: steps(n_nodes) = [-1.0_wp, 1.0_wp, 2.0_wp, -2.0_wp]
  !> Reaches for singular and for regular equations, in order of trial.
  real(wp), parameter :: singular_reaches(3) = [1.0e-3_wp, 1.0e-2_wp, 1.0e-4_wp]
  real(wp), parameter :: regular_reaches(3) = [1.0e-4_wp, 1.0e-3_wp, 1.0e-2_wp]
  !> The equations are nearly singular for exponents smaller than this.
  real(wp), parameter :: nearly_nothing = 1.0e-3_wp
  !> The zero of the cubic is accepted within this many reaches of the centre. The zero of the line
  !! is accepted as an estimate within this distance, in sigma.
  real(wp), parameter :: close = 3.0_wp, close_enough = 0.05_wp
  !> The line is used if the location has moved by this times the squared reach, in sigma. The
  !! squared reach is added to the error.
  real(wp), parameter :: line_serves = 30.0_wp
  !> Largest distance from the first estimate, in sigma, and largest number of iterations.
  real(wp), parameter :: furthest = 2.0_wp
  integer, parameter :: max_turns = 10
  !> Relative change of a solution that measures its effect on an exponent.
  real(wp), parameter :: nudge = 1.0e-5_wp
  !> The effect is measured where the error is below this times the remaining correction.
  real(wp), parameter :: seen = 1.0e4_wp
  !> Noise of determinants near a location, relative to those one reach away.
  real(wp), parameter :: noise_of_determinants = 1.0e-9_wp

  !> A spectrum whose only exponent is the determinant of the bordered derivatives.
  type, extends(spectrum_type) :: determinant_type
    type(chord_type) :: chord
    logical :: referred = .false.
    !> Logarithm of the first determinant, which is scaled to 1.
    real(wp) :: reference = 0.0_wp
  contains
    procedure :: look
  end type determinant_type

contains

  !> Error of the location where an exponent crosses the imaginary axis.
  subroutine exponent_error(curve, spectrum, p, x, at_p, at_x, eta, error, cancel)
    !> A curve with more unknowns than that of the search, and its exponents.
    class(curve_type), intent(inout) :: curve
    class(spectrum_type), intent(inout) :: spectrum
    !> The adjacent points on the curve, shapes (2) and (n, 2), and the crossing; all in the
    !! unknowns of this curve, shape (n).
    real(wp), intent(in) :: p(2), x(:, :), at_p, at_x(:)
    !> The exponent that crosses.
    complex(wp), intent(in) :: eta
    !> In the unit of p; infinite if no crossing is found nearby.
    real(wp), intent(out) :: error
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(chord_type) :: chord
    call new_chord(chord, curve, p, x)
    call find_error(curve, spectrum, chord, p, x, at_p, at_x, eta, error, cancel)
  end subroutine exponent_error

  !> Error of a branch point; arguments as above.
  subroutine branch_point_error(curve, p, x, at_p, at_x, error, cancel)
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p(2), x(:, :), at_p, at_x(:)
    real(wp), intent(out) :: error
    integer, intent(inout), optional :: cancel
    type(determinant_type) :: spectrum
    spectrum%n = 1
    spectrum%noise = noise_of_determinants
    ! A large determinant is not a growth that amplifies rounding errors.
    spectrum%complete = .false.
    call new_chord(spectrum%chord, curve, p, x)
    call find_error(curve, spectrum, spectrum%chord, p, x, at_p, at_x, (0.0_wp, 0.0_wp), error, &
                    cancel)
  end subroutine branch_point_error

  subroutine find_error(curve, spectrum, chord, p, x, at_p, at_x, eta, error, cancel)
    class(curve_type), intent(inout) :: curve
    class(spectrum_type), intent(inout) :: spectrum
    type(chord_type), intent(in) :: chord
    real(wp), intent(in) :: p(2), x(:, :), at_p, at_x(:)
    complex(wp), intent(in) :: eta
    real(wp), intent(out) :: error
    integer, intent(inout), optional :: cancel
    type(chord_point) :: here, there, nodes(n_nodes)
    type(chord_factors) :: factors
    complex(wp) :: last, values(n_nodes)
    real(wp) :: reaches(3), begun, centre, reach, off, moved, slope, by_p, left, growth
    real(wp) :: growths(n_nodes)
    !> Of the nodes: sigma and the parameter.
    real(wp) :: s(n_nodes), there_p(n_nodes)
    logical :: made
    integer :: turn, n, k, try

    error = ieee_value(error, ieee_positive_inf)
    here%sigma = chord%sigma_of(at_p, at_x)
    here%p = at_p
    here%x = at_x
    ! The end with the larger distance.
    k = merge(1, 2, here%sigma > 0.5_wp)
    there%sigma = k - 1.0_wp
    there%p = p(k)
    there%x = x(:, k)
    begun = here%sigma
    centre = begun
    last = eta
    reaches = regular_reaches
    if (abs(eta) < nearly_nothing) reaches = singular_reaches
    factors%estimate = .true.
    try = 1
    turn = 0
    do while (turn < max_turns)
      if (given_up(cancel)) return
      turn = turn + 1
      reach = reaches(try)
      n = n_line
      call take_nodes(1, n_line)
      if (made) then
        off = zero_of(s(:n), real(values(:n))) - centre
        moved = abs(centre + off - begun)
        if (abs(off) <= close*reach .and. moved < line_serves*reach**2) then
          n = n_nodes
          call take_nodes(n_line + 1, n_nodes)
          if (made) off = zero_of(s, real(values)) - centre
        end if
      end if
      if (.not. made) then
        try = try + 1
        if (try > size(reaches)) return
        cycle
      end if
      if (.not. abs(off) < huge(off)) return
      if (abs(off) <= max(close*reach, close_enough)) exit
      centre = centre + sign(min(abs(off), 0.5_wp), off)
      if (abs(centre - begun) > furthest) return
      last = values(2)
      here = nodes(2)
      there = along_tangent(here)
    end do
    if (turn >= max_turns) return
    by_p = (there_p(2) - there_p(1))/(s(2) - s(1))
    slope = (real(values(2)) - real(values(1)))/(s(2) - s(1))
    error = abs(polynomial_at(centre + off, s(:n), differences(s(:n), there_p(:n))) - at_p)
    left = maxval(nodes(:n)%left)
    off = 0.0_wp
    if (error <= seen*left*abs(at_p)) then
      call exponent_at(curve, spectrum, nodes(2)%p, nodes(2)%x*(1.0_wp + nudge), values(2), last, &
                       growth, made)
      if (made) off = abs(real(last) - real(values(2)))/nudge*left
    end if
    if (n == n_line) off = off + reach**2*abs(slope)
    growth = maxval(growths(:n))
    off = (off + spectrum%noise*exp(max(0.0_wp, min(growth, 100.0_wp))))/abs(slope)
    error = error + abs(by_p)*off + maxval(nodes(:n)%left_p) + epsilon(1.0_wp)*abs(at_p)

  contains

    !> Points of the curve around the centre and the exponents there. Each search starts on the
    !! tangent at the previous point.
    subroutine take_nodes(first, final)
      integer, intent(in) :: first, final
      integer :: i
      do i = first, final
        call chord%go_to(curve, centre + steps(i)*reach, here, there, nodes(i), made, factors)
        if (made) call exponent_at(curve, spectrum, nodes(i)%p, nodes(i)%x, last, values(i), &
                                   growths(i), made)
        if (.not. made) return
        s(i) = nodes(i)%sigma
        there_p(i) = nodes(i)%p
        here = nodes(i)
        there = along_tangent(here)
      end do
    end subroutine take_nodes

  end subroutine find_error

  !> The exponent nearest to `near`, and the largest real part of all exponents.
  subroutine exponent_at(curve, spectrum, p, x, near, eta, growth, made)
    class(curve_type), intent(inout) :: curve
    class(spectrum_type), intent(inout) :: spectrum
    real(wp), intent(in) :: p, x(:)
    complex(wp), intent(in) :: near
    complex(wp), intent(out) :: eta
    real(wp), intent(out) :: growth
    logical, intent(out) :: made
    complex(wp) :: all(spectrum%n), nearby(spectrum%n)
    integer :: n_growing, i

    eta = near
    growth = 0.0_wp
    made = .false.
    if (.not. spectrum%complete) call spectrum%follow(curve, p, x, near, eta, made)
    if (made) return
    nearby = near
    call spectrum%look(curve, p, x, nearby, all, n_growing)
    made = n_growing >= 0
    if (.not. made) return
    i = minloc(abs(all - near), 1, ieee_is_finite(real(all)))
    made = i > 0
    if (.not. made) return
    eta = all(i)
    if (spectrum%complete) growth = maxval(real(all), ieee_is_finite(real(all)))
  end subroutine exponent_at

  !> A point on the tangent of the curve at a point that `go_to` computed.
  pure type(chord_point) function along_tangent(point) result(next)
    type(chord_point), intent(in) :: point
    next%sigma = point%sigma + 1.0_wp
    next%p = point%p + point%slope
    ! Allocated explicitly: gfortran 12 otherwise warns about an uninitialized use.
    allocate (next%x, source=point%x + point%x_slope)
  end function along_tangent

  !> Divided differences of values v at nodes s.
  pure function differences(s, v) result(d)
    real(wp), intent(in) :: s(:), v(:)
    real(wp) :: d(size(s))
    integer :: i, k
    d = v
    do k = 1, size(s) - 1
      do i = size(s), k + 1, -1
        d(i) = (d(i) - d(i - 1))/(s(i) - s(i - k))
      end do
    end do
  end function differences

  !> The polynomial with divided differences d, and its derivative.
  pure real(wp) function polynomial_at(at, s, d) result(value)
    real(wp), intent(in) :: at, s(:), d(:)
    integer :: k
    value = d(size(s))
    do k = size(s) - 1, 1, -1
      value = d(k) + (at - s(k))*value
    end do
  end function polynomial_at

  pure real(wp) function tilt_at(at, s, d) result(tilt)
    real(wp), intent(in) :: at, s(:), d(:)
    real(wp) :: value
    integer :: k
    value = d(size(s))
    tilt = 0.0_wp
    do k = size(s) - 1, 1, -1
      tilt = value + (at - s(k))*tilt
      value = d(k) + (at - s(k))*value
    end do
  end function tilt_at

  !> The zero of the polynomial through values v at nodes s that is nearest to the zero of the line
  !! through the first two; `huge` if this line is constant.
  pure real(wp) function zero_of(s, v) result(zero)
    real(wp), intent(in) :: s(:), v(:)
    real(wp) :: d(size(s)), tilt
    integer :: k

    d = differences(s, v)
    zero = huge(zero)
    if (.not. abs(d(2)) > 0.0_wp) return
    zero = s(1) - d(1)/d(2)
    do k = 1, 4
      tilt = tilt_at(zero, s, d)
      if (.not. tilt*d(2) > 0.0_wp) return
      zero = zero - polynomial_at(zero, s, d)/tilt
    end do
  end function zero_of

  subroutine look(self, curve, p, x, near, eta, n_growing)
    class(determinant_type), intent(inout) :: self
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p, x(:)
    complex(wp), intent(in) :: near(:)
    complex(wp), intent(out) :: eta(:)
    integer, intent(out) :: n_growing
    real(wp) :: matrix(size(x) + 1, size(x) + 1), r(size(x)), by_p(size(x)), logarithm
    integer :: pivots(size(x) + 1), i, sign_of
    logical :: inside, singular

    eta = near
    n_growing = -1
    call curve%equations(x, p, r, matrix, by_p, inside)
    if (.not. inside) return
    call self%chord%border(by_p, matrix)
    call factorize(size(x) + 1, matrix, pivots, singular)
    n_growing = 0
    eta(1) = (0.0_wp, 0.0_wp)
    if (singular) return
    logarithm = 0.0_wp
    sign_of = 1
    do i = 1, size(pivots)
      if (pivots(i) /= i) sign_of = -sign_of
      if (matrix(i, i) < 0.0_wp) sign_of = -sign_of
      logarithm = logarithm + log(abs(matrix(i, i)))
    end do
    if (.not. self%referred) self%reference = logarithm
    self%referred = .true.
    eta(1) = sign_of*exp(max(-300.0_wp, min(300.0_wp, logarithm - self%reference)))
  end subroutine look

end module viscovib_crossing_errors
