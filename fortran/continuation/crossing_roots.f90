!> Zeros of the real part of an exponent between two points of a curve, by false position
!! (Illinois: Dowell and Jarratt, BIT 11 (1971) 168).
module viscovib_crossing_roots
  use viscovib_chord, only: chord_type
  use viscovib_constants, only: pi
  use viscovib_crossing_nodes, only: look_at, look_between, node_type, put_between, spectrum_type
  use viscovib_curve, only: curve_type
  use viscovib_kinds, only: wp
  use viscovib_stopping, only: given_up
  implicit none
  private

  public :: bracket

  integer, parameter :: max_evaluations = 60, max_halvings = 12
  !> Tolerances: part of the distance between the two end points, and a real part.
  real(wp), parameter :: narrow = 1.0e-11_wp, small = 1.0e-12_wp
  !> The bisection by counts ends at this distance. The real part must then be this small.
  real(wp), parameter :: near = 1.0e-9_wp, vanishing = 1.0e-5_wp
  !> Distance from the real axis, or from i pi, within which an exponent counts as on it.
  real(wp), parameter, public :: on_line = 1.0e-5_wp
  !> Between points this close the curve is straight to rounding error.
  real(wp), parameter :: straight = 1.0e-4_wp
  !> Distances from a singular point at which it is bracketed, in parts of the interval, in order.
  real(wp), parameter :: aside(3) = [1.0e-3_wp, 1.0e-2_wp, 0.1_wp]
  !> Real parts below minus this are set to minus this.
  real(wp), parameter :: deepest = 100.0_wp

contains

  !> Locate where the next exponent crosses: nodes on both sides, and the crossing with that
  !! exponent first.
  subroutine bracket(curve, spectrum, chord, lo, hi, root, located, cancel)
    class(curve_type), intent(inout) :: curve
    class(spectrum_type), intent(inout) :: spectrum
    type(chord_type), intent(in) :: chord
    type(node_type), intent(inout) :: lo, hi
    type(node_type), intent(out) :: root
    logical, intent(out) :: located
    !> May be set by another thread to cancel the search.
    integer, intent(inout), optional :: cancel
    type(node_type) :: kept_lo, kept_hi

    if (spectrum%complete) then
      call bracket_by_size(curve, spectrum, chord, lo, hi, root, located, cancel)
    else
      kept_lo = lo
      kept_hi = hi
      call bracket_by_following(curve, spectrum, chord, lo, hi, root, located, cancel)
      if (located .or. given_up(cancel)) return
      ! Exponents may vary too fast to be followed: their number still gives the location.
      lo = kept_lo
      hi = kept_hi
      call bracket_by_count(curve, spectrum, chord, lo, hi, root, located, cancel)
    end if
  end subroutine bracket

  !> Bisection on the number of growing exponents, until the nodes are close; the result is the
  !! middle.
  subroutine bracket_by_count(curve, spectrum, chord, lo, hi, root, located, cancel)
    class(curve_type), intent(inout) :: curve
    class(spectrum_type), intent(inout) :: spectrum
    type(chord_type), intent(in) :: chord
    type(node_type), intent(inout) :: lo, hi
    type(node_type), intent(out) :: root
    logical, intent(out) :: located
    integer, intent(inout), optional :: cancel
    type(node_type) :: middle
    integer :: k, place

    located = .false.
    do k = 1, max_evaluations
      if (given_up(cancel)) return
      if (hi%at%sigma - lo%at%sigma <= near) exit
      call look_between(curve, spectrum, chord, lo, hi, middle)
      if (middle%n_growing < 0) return
      if (middle%n_growing == lo%n_growing) then
        lo = middle
      else
        hi = middle
      end if
    end do
    place = max(lo%n_growing, hi%n_growing)
    call put_between(lo, hi, 0.5_wp*(lo%at%sigma + hi%at%sigma), root)
    root%eta = merge(hi%eta, lo%eta, hi%n_growing == place)
    root%eta(1) = root%eta(place)
    located = abs(real(root%eta(1))) <= vanishing
  end subroutine bracket_by_count

  subroutine bracket_by_size(curve, spectrum, chord, lo, hi, root, located, cancel)
    class(curve_type), intent(inout) :: curve
    class(spectrum_type), intent(inout) :: spectrum
    type(chord_type), intent(in) :: chord
    type(node_type), intent(inout) :: lo, hi
    type(node_type), intent(out) :: root
    logical, intent(out) :: located
    integer, intent(inout), optional :: cancel
    type(node_type) :: trial
    real(wp) :: low, high, sigma, last_sigma, value, level
    integer :: k, place, side, before
    logical :: narrowed

    located = .false.
    place = max(lo%n_growing, hi%n_growing)
    low = height(lo, place)
    high = height(hi, place)
    level = 0.0_wp
    if (.not. low*high < 0.0_wp) then
      ! An exponent is on the axis within rounding error.
      level = spectrum%threshold
      low = low - level
      high = high - level
    end if
    last_sigma = huge(last_sigma)
    before = 0
    do k = 1, max_evaluations
      if (given_up(cancel) .or. .not. low*high < 0.0_wp) return
      sigma = lo%at%sigma + (hi%at%sigma - lo%at%sigma)*low/(low - high)
      if (sigma <= lo%at%sigma .or. sigma >= hi%at%sigma) exit
      call look_at(curve, spectrum, chord, sigma, lo, hi, trial)
      if (trial%n_growing < 0) then
        ! The equations are singular where another branch crosses.
        if (hi%at%sigma - lo%at%sigma > straight) then
          call close_in()
          if (narrowed) cycle
          return
        end if
        call put_between(lo, hi, sigma, root)
        exit
      end if
      root = trial
      value = height(trial, place) - level
      if (value*low > 0.0_wp) then
        lo = trial
        low = value
        side = -1
        if (side == before) high = 0.5_wp*high
      else
        hi = trial
        high = value
        side = 1
        if (side == before) low = 0.5_wp*low
      end if
      before = side
      if (abs(sigma - last_sigma) <= narrow .or. abs(value) <= small) exit
      last_sigma = sigma
    end do
    located = k <= max_evaluations .and. allocated(root%eta)
    if (located) root%eta(1) = root%eta(place)

  contains

    !> Replace the ends by nodes on both sides of sigma, where the equations are singular.
    subroutine close_in()
      type(node_type) :: sides(2)
      integer :: j
      narrowed = .false.
      do j = 1, size(aside)
        associate (distance => aside(j)*(hi%at%sigma - lo%at%sigma))
          call look_at(curve, spectrum, chord, max(lo%at%sigma, sigma - distance), lo, hi, sides(1))
          call look_at(curve, spectrum, chord, min(hi%at%sigma, sigma + distance), lo, hi, sides(2))
        end associate
        if (min(sides(1)%n_growing, sides(2)%n_growing) < 0) cycle
        if (.not. (height(sides(1), place) - level)*low > 0.0_wp) cycle
        if (.not. (height(sides(2), place) - level)*high > 0.0_wp) cycle
        lo = sides(1)
        hi = sides(2)
        low = height(lo, place) - level
        high = height(hi, place) - level
        before = 0
        narrowed = .true.
        return
      end do
    end subroutine close_in

  end subroutine bracket_by_size

  !> Real part of the exponent with number `place`.
  pure real(wp) function height(node, place)
    type(node_type), intent(in) :: node
    integer, intent(in) :: place
    height = max(real(node%eta(place)), -deepest)
  end function height

  !> Search if decaying exponents may be missing: bisection until the growing exponent can be
  !! followed to where it decays, then false position.
  subroutine bracket_by_following(curve, spectrum, chord, lo, hi, root, located, cancel)
    class(curve_type), intent(inout) :: curve
    class(spectrum_type), intent(inout) :: spectrum
    type(chord_type), intent(in) :: chord
    type(node_type), intent(inout) :: lo, hi
    type(node_type), intent(out) :: root
    logical, intent(out) :: located
    integer, intent(inout), optional :: cancel
    type(node_type) :: middle
    complex(wp) :: here, there, found
    real(wp) :: sigma, last_sigma, sides(2), values(2)
    complex(wp) :: ends(2)
    integer :: k, place, side, before
    logical :: made, upward

    located = .false.
    place = max(lo%n_growing, hi%n_growing)
    upward = hi%n_growing == place
    do k = 1, max_halvings
      if (given_up(cancel)) return
      if (upward) then
        here = hi%eta(place)
        call spectrum%follow(curve, lo%at%p, lo%at%x, here, there, made)
      else
        here = lo%eta(place)
        call spectrum%follow(curve, hi%at%p, hi%at%x, here, there, made)
      end if
      if (made) made = real(there) < 0.0_wp .and. real(here) > 0.0_wp &
                       .and. line_of(here) == line_of(there)
      if (made) exit
      call look_between(curve, spectrum, chord, lo, hi, middle)
      if (middle%n_growing < 0) return
      if ((middle%n_growing >= place) .eqv. upward) then
        hi = middle
      else
        lo = middle
      end if
      ! More exponents may grow at the new node than at the end.
      place = max(lo%n_growing, hi%n_growing)
    end do
    if (.not. made) return
    sides = [lo%at%sigma, hi%at%sigma]
    ends = merge([there, here], [here, there], upward)
    values = real(ends)
    last_sigma = huge(last_sigma)
    before = 0
    allocate (root%eta(spectrum%n))
    do k = 1, max_evaluations
      if (given_up(cancel)) return
      sigma = sides(1) + (sides(2) - sides(1))*values(1)/(values(1) - values(2))
      call chord%go_to(curve, sigma, lo%at, hi%at, root%at, made)
      if (.not. made) then
        if (sides(2) - sides(1) > straight) return
        call put_between(lo, hi, sigma, root)
        exit
      end if
      found = ends(1) + (ends(2) - ends(1))*((sigma - sides(1))/(sides(2) - sides(1)))
      call spectrum%follow(curve, root%at%p, root%at%x, found, there, made)
      if (.not. made) return
      side = merge(1, 2, real(there)*values(1) > 0.0_wp)
      sides(side) = sigma
      ends(side) = there
      if (side == 1) lo%at = root%at
      if (side == 2) hi%at = root%at
      values(side) = real(there)
      if (side == before) values(3 - side) = 0.5_wp*values(3 - side)
      before = side
      if (abs(sigma - last_sigma) <= narrow .or. sides(2) - sides(1) <= narrow) exit
      if (.not. abs(real(there)) > 0.0_wp) exit
      last_sigma = sigma
    end do
    located = k <= max_evaluations
    root%eta(1) = there
  end subroutine bracket_by_following

  !> 0 on the real axis, 1 on i pi, 2 elsewhere.
  pure integer function line_of(exponent)
    complex(wp), intent(in) :: exponent
    line_of = 2
    if (abs(aimag(exponent)) <= on_line) line_of = 0
    if (abs(pi - abs(aimag(exponent))) <= on_line) line_of = 1
  end function line_of

end module viscovib_crossing_roots
