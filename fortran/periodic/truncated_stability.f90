! Optimize: -O2
!> Whether the stability of a motion is sure although its harmonics are too few.
!!
!! Multipliers are those of the motion that was found, and this is off by its truncation. So the
!! verdict must be the same for nearby motions, three truncations away: larger and smaller ones,
!! and ones with more and less of the higher half of the orders; and as many disturbances must grow
!! and an odd or even number of them with the period of the motion, the sign of det(M - 1): from a
!! multiplier above 1 to one below -1 the way is through the circle. Where one of them is checked
!! otherwise, or the logarithm of the largest multiplier is below the truncation itself, stability
!! is unknown. Multipliers change by less than 10^4 times the truncation, so that motions far from
!! the circle are not looked at, nor are those whose truncation is allowed. Of condensed structures
!! first-order changes of exponents show first whether any could come near the axis.
!! docs/explanation/stability.md says what wrong verdicts this was measured to find.
module viscovib_truncated_stability
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_is_nan
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_motion_norm, only: weighted_norm
  use viscovib_motion_stability, only: new_stability_checker, stability_checker, stability_type, &
    unknown_by_truncation
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: oscillator_curve_type, vary_frequency
  use viscovib_stopping, only: given_up
  implicit none
  private

  public :: doubt_curve, doubt_motions

  !> Change of a multiplier over that of the motion, at most.
  real(wp), parameter :: steepest = 1.0e4_wp
  !> Distance of the nearby motions, in truncations.
  real(wp), parameter :: as_far = 3.0_wp
  integer, parameter :: n_nearby = 4
  !> Distance up to which exponents change linearly.
  real(wp), parameter :: very_near = 0.05_wp
  !> Frequency below which a disturbance has the period of the motion, of that of the load.
  real(wp), parameter :: on_the_line = 1.0e-6_wp
  !> The verdict is certain, it is not, or nearby motions decide.
  integer, parameter :: sure = 0, lost = 1, doubtful = 2

contains

  !> Set to unknown what nearby motions contradict.
  subroutine doubt_motions(checker, system, nu, x, truncation, allowed, stability, cancel)
    type(stability_checker), intent(inout) :: checker
    class(oscillator_type), intent(in) :: system
    !> Frequencies (rad/s); harmonics, shape (2 n_orders, n_dof, n); truncation of each, and what
    !! was allowed (relative): where that is met, nothing is doubted.
    real(wp), intent(in) :: nu(:), x(:, :, :), truncation(:), allowed(:)
    type(stability_type), intent(inout) :: stability
    !> May be set from elsewhere to give up.
    integer, intent(inout), optional :: cancel
    type(stability_type) :: others
    real(wp) :: nearby(size(x, 1), size(x, 2), n_nearby)
    integer :: i, k, m, at_once, look

    ! Monodromies are integrated in lanes; other exponents are sought one by one.
    at_once = merge(2, n_nearby, checker%remembers .or. system%condensed)

    do i = 1, size(nu)
      if (given_up(cancel)) return
      look = first_look(stability, i, nu(i), truncation(i), allowed(i))
      if (look == lost) call set_unknown(stability, i)
      if (look /= doubtful) cycle
      call nearby_motions(system, x(:, :, i), as_far*truncation(i), nearby)
      if (as_far*truncation(i) <= very_near) then
        ! Those that are larger and have more of the higher orders stand for the others.
        if (checker%stays(system, nu(i), x(:, :, i), nearby(:, :, 1:3:2), &
                          stability%exponents(:, i), stability%n_growing(i), &
                          steepest*truncation(i)*nu(i)/(2.0_wp*pi))) cycle
      end if
      do k = 1, n_nearby, at_once
        if (all_by_count(k, k + at_once - 1)) cycle
        call checker%check(system, spread(nu(i), 1, at_once), nearby(:, :, k:k + at_once - 1), &
                           others, cancel, stability%exponents(:, i))
        if (given_up(cancel)) return
        if (all([(alike(stability, i, others, m, nu(i)), m=1, at_once)])) cycle
        call set_unknown(stability, i)
        exit
      end do
    end do

  contains

    !> Whether counts alone show that motions nearby are like motion i.
    logical function all_by_count(from, to)
      integer, intent(in) :: from, to
      integer :: k
      all_by_count = .true.
      do k = from, to
        if (all_by_count) all_by_count = by_count(k)
      end do
    end function all_by_count

    !> Whether a count alone shows that a motion nearby is like motion i.
    logical function by_count(k)
      integer, intent(in) :: k
      associate (exponents => stability%exponents(:, i))
        by_count = stability%n_growing(i) == 0
        if (.not. by_count) by_count = .not. ieee_is_nan(real(exponents(1)))
        if (by_count) by_count = checker%grows_alike(system, nu(i), nearby(:, :, k), exponents, &
                                                   stability%n_growing(i), &
                                                   n_above_one(exponents, nu(i)))
      end associate
    end function by_count

  end subroutine doubt_motions

  !> The same along a curve, whose system may change.
  subroutine doubt_curve(checker, curve, nu, p, x, truncation, allowed, stability, cancel)
    type(stability_checker), intent(inout) :: checker
    class(oscillator_curve_type), intent(inout) :: curve
    !> The frequency (rad/s) unless it varies; points, shapes (n) and (2 n_orders, n_dof, n).
    real(wp), intent(in) :: nu, p(:), x(:, :, :), truncation(:), allowed(:)
    type(stability_type), intent(inout) :: stability
    integer, intent(inout), optional :: cancel
    type(stability_type) :: one
    integer :: i
    logical :: inside

    if (.not. curve%changes_system) then
      call doubt_motions(checker, curve%system, merge(p, spread(nu, 1, size(p)), &
                                                    curve%vary == vary_frequency), &
                         x, truncation, allowed, stability, cancel)
      return
    end if
    do i = 1, size(p)
      if (first_look(stability, i, nu, truncation(i), allowed(i)) == sure) cycle
      call curve%set(p(i), inside)
      if (.not. inside) cycle
      call new_stability_checker(checker, curve%system, curve%balance%set)
      call take(stability, i, one)
      call doubt_motions(checker, curve%system, [nu], x(:, :, i:i), truncation(i:i), &
                        allowed(i:i), one, cancel)
      stability%stable(i) = one%stable(1)
      stability%n_growing(i) = one%n_growing(1)
      stability%slowest(i) = one%slowest(1)
    end do
  end subroutine doubt_curve

  !> Whether motion i of `a` and motion k of `b` can pass into each other while no multiplier
  !! passes the circle.
  pure logical function alike(a, i, b, k, nu)
    type(stability_type), intent(in) :: a, b
    integer, intent(in) :: i, k
    real(wp), intent(in) :: nu

    alike = a%n_growing(i) == b%n_growing(k)
    if (.not. alike .or. a%n_growing(i) == 0) return
    if (ieee_is_nan(real(a%exponents(1, i))) .or. ieee_is_nan(real(b%exponents(1, k)))) return
    alike = modulo(n_above_one(a%exponents(:, i), nu) - n_above_one(b%exponents(:, k), nu), 2) == 0
  end function alike

  !> Growing exponents whose multiplier is real and positive.
  pure integer function n_above_one(exponents, nu)
    complex(wp), intent(in) :: exponents(:)
    real(wp), intent(in) :: nu
    integer :: i
    n_above_one = 0
    do i = 1, size(exponents)
      if (ieee_is_nan(real(exponents(i)))) return
      if (real(exponents(i)) <= 0.0_wp) cycle
      if (abs(aimag(exponents(i))) < on_the_line*nu) n_above_one = n_above_one + 1
    end do
  end function n_above_one

  subroutine set_unknown(stability, i)
    type(stability_type), intent(inout) :: stability
    integer, intent(in) :: i
    stability%stable(i) = unknown_by_truncation
    stability%n_growing(i) = -1
    stability%slowest(i) = .false.
  end subroutine set_unknown

  !> What is known of one motion.
  subroutine take(stability, i, one)
    type(stability_type), intent(in) :: stability
    integer, intent(in) :: i
    type(stability_type), intent(out) :: one
    one%stable = stability%stable(i:i)
    one%n_growing = stability%n_growing(i:i)
    one%slowest = stability%slowest(i:i)
    one%exponents = stability%exponents(:, i:i)
    one%multipliers = stability%multipliers(:, i:i)
  end subroutine take

  !> What is certain of one motion before others are checked: `sure`, `lost` or `doubtful`.
  pure integer function first_look(stability, i, nu, truncation, allowed)
    type(stability_type), intent(in) :: stability
    integer, intent(in) :: i
    real(wp), intent(in) :: nu, truncation, allowed
    real(wp) :: distance

    first_look = sure
    if (stability%n_growing(i) < 0) return
    if (.not. ieee_is_finite(truncation)) return
    if (truncation <= allowed) return
    ! The logarithm of the largest multiplier decides; where none is known, as if at 1.
    distance = 1.0_wp
    if (size(stability%exponents, 1) > 0) then
      associate (growth => real(stability%exponents(1, i)))
        if (.not. ieee_is_nan(growth)) distance = min(distance, abs(growth)*2.0_wp*pi/nu)
      end associate
    end if
    if (truncation > distance/steepest) first_look = doubtful
    if (truncation > distance) first_look = lost
  end function first_look

  !> Larger, smaller, with more and with less of the higher half of the orders.
  subroutine nearby_motions(system, x, away, nearby)
    class(oscillator_type), intent(in) :: system
    !> Shape (2 n_orders, n_dof).
    real(wp), intent(in) :: x(:, :)
    !> Relative to the motion.
    real(wp), intent(in) :: away
    real(wp), intent(out) :: nearby(:, :, :)
    real(wp) :: upper(size(x, 1), size(x, 2)), part, size_of
    integer :: n

    n = size(x, 1)/2
    do while (n > 1)
      if (any(abs(x(2*n - 1:2*n, :)) > 0.0_wp)) exit
      n = n - 1
    end do
    upper = 0.0_wp
    upper(2*((n + 1)/2) + 1:2*n, :) = x(2*((n + 1)/2) + 1:2*n, :)
    part = 0.0_wp
    size_of = weighted_norm(system, upper)
    if (size_of > 0.0_wp) part = min(1.0_wp, away*weighted_norm(system, x)/size_of)
    nearby(:, :, 1) = x + away*x
    nearby(:, :, 2) = x - away*x
    nearby(:, :, 3) = x + part*upper
    nearby(:, :, 4) = x - part*upper
  end subroutine nearby_motions

end module viscovib_truncated_stability
