! Optimize: -O3
!> Bouc-Wen hysteresis (Wen, J. Eng. Mech. Div. ASCE 102, 1976):
!!
!!   f = elastic d + weight z,   dz/dd = A - (gamma + beta sign(way z)) |z|^n.
!!
!! The state is scaled by (A/|beta + gamma|)^(1/n), its largest value if beta + gamma > 0, and
!! signed along the direction of motion. Then s grows with the path x as ds/dx = 1 - r |s|^n. For
!! s > 0, r is the sign of beta + gamma; for s < 0, r = (gamma - beta)/|gamma + beta|. If
!! beta + gamma = 0 the scale is (A/(2 beta))^(1/n), and r = 0 and -1. For beta + gamma > 0, n = 1
!! and 2 have closed solutions. Otherwise Taylor series in x are summed over short steps, which end
!! at sign changes of s. Near s = 0, where |s|^n is not smooth for noninteger n, the path is a
!! series in s:
!!
!!   x(s) = integral ds/(1 - r |s|^n) = s sum_j (r |s|^n)^j/(n j + 1).
!!
!! For beta + gamma < 0 and n > 1, s becomes infinite after a finite path; it then keeps a large
!! value.
module viscovib_bouc_wen_element
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: bouc_wen_element, new_bouc_wen

  type, extends(hysteresis_type) :: bouc_wen_element
    !> A, n, r for s > 0 and for s < 0, the scale of the state, and the largest scaled state.
    real(wp), private :: rise = 1.0_wp, exponent = 1.0_wp, fore = 1.0_wp, back = 0.0_wp
    real(wp), private :: scale = 1.0_wp, largest = 1.0_wp
    !> n if it is an integer, else 0; n if there is a closed solution, else 0.
    integer, private :: whole = 1, closed = 1
  contains
    procedure :: advance
    procedure :: slope
    procedure :: kinks
  end type bouc_wen_element

  !> Number of series terms. Longest step times the fastest rate, below 0 and above 0, where the
  !! nearest singularity of s(x) is at least pi/n away; longest step relative to |s| if |s|^n is not
  !! smooth at 0; relative distance from the largest state that counts as rounding error.
  integer, parameter :: terms = 18
  real(wp), parameter :: longest = 0.15_wp, longest_above = 0.45_wp, longest_general = 0.1_wp, &
                         of_state = 0.2_wp, saturated = 1.0e-15_wp
  !> Largest |s|^(n - 1) of a state without a largest value.
  real(wp), parameter :: unlimited = 1.0e14_wp
  !> Largest |r| |s|^n for the series of the path in the state.
  real(wp), parameter :: inner = 0.4_wp
  !> n = 2: for smaller |r| the path equals the state.
  real(wp), parameter :: tiny_part = 1.0e-20_wp
  integer, parameter :: path_terms = 41, most_turns = 30

contains

  !> Parameters: elastic, weight, A, beta, gamma, n.
  pure subroutine new_bouc_wen(element, numbers)
    type(bouc_wen_element), intent(out) :: element
    real(wp), intent(in) :: numbers(:)
    element%elastic = numbers(1)
    element%weight = numbers(2:2)
    element%rise = numbers(3)
    element%exponent = numbers(6)
    element%whole = 0
    if (abs(numbers(6) - anint(numbers(6))) <= 0.0_wp) element%whole = nint(numbers(6))
    ! Since ds/dx contains |s|^n, the force has a term |d|^(n + 1).
    if (element%whole == 0) element%rough = 1.0_wp + element%exponent
    associate (beta => numbers(4), total => numbers(4) + numbers(5))
      element%fore = merge(sign(1.0_wp, total), 0.0_wp, abs(total) > 0.0_wp)
      element%back = -1.0_wp
      if (abs(total) > 0.0_wp) element%back = (numbers(5) - beta)/abs(total)
      element%scale = (numbers(3)/merge(abs(total), 2.0_wp*beta, abs(total) > 0.0_wp)) &
                      **(1.0_wp/numbers(6))
      if (total <= 0.0_wp) element%largest = unlimited**(1.0_wp/max(numbers(6) - 1.0_wp, 0.1_wp))
      element%closed = 0
      if (total > 0.0_wp .and. element%whole <= 2) element%closed = element%whole
    end associate
  end subroutine new_bouc_wen

  pure subroutine advance(self, change, z, by_z, by_d, work)
    class(bouc_wen_element), intent(in) :: self
    real(wp), intent(in) :: change
    real(wp), intent(inout) :: z(:)
    real(wp), intent(out) :: by_z(:), by_d(:), work
    real(wp) :: s, x, first, last, covered
    integer :: way

    way = merge(1, -1, change >= 0.0_wp)
    s = min(max(way*z(1)/self%scale, -self%largest), self%largest)
    x = abs(change)*self%rise/self%scale
    first = rate(self, s)
    covered = 0.0_wp
    if (self%closed == 1) then
      call move_closed(self%back, x, s, covered)
    else if (self%closed == 2) then
      call move_squared(self%back, x, s, covered)
    else
      call move_by_series(self, x, s, covered)
    end if
    last = rate(self, s)
    ! All paths are parts of one trajectory: ds/ds_0 = s'(x)/s'(0).
    if (first > sqrt(epsilon(1.0_wp))) then
      by_z(1) = last/first
    else
      by_z(1) = exp(-self%exponent*x)
    end if
    by_d(1) = self%rise*last
    z(1) = way*self%scale*s
    work = self%weight(1)*covered*self%scale**2/self%rise
  end subroutine advance

  !> ds/dx.
  pure real(wp) function rate(self, s)
    class(bouc_wen_element), intent(in) :: self
    real(wp), intent(in) :: s
    rate = merge(self%fore, self%back, s > 0.0_wp)
    if (self%whole > 0) then
      rate = 1.0_wp - rate*abs(s)**self%whole
    else
      rate = 1.0_wp - rate*abs(s)**self%exponent
    end if
  end function rate

  !> n = 1: with r = -b for s < 0, 1 - b s = exp(-b x) from s = 0 on; then 1 - s = exp(-x).
  pure subroutine move_closed(back, x, s, covered)
    real(wp), intent(in) :: back, x
    real(wp), intent(inout) :: s
    !> Integral of s over x.
    real(wp), intent(out) :: covered
    real(wp) :: left, path, grown

    left = x
    covered = 0.0_wp
    if (s < 0.0_wp) then
      ! ds/dx = 1 + back s, back < 1.
      if (abs(back) > 0.0_wp) then
        path = log(1.0_wp + back*s)/(-back)
      else
        path = -s
      end if
      path = min(path, left)
      if (abs(back) > 0.0_wp) then
        grown = s*exp(back*path) + (exp(back*path) - 1.0_wp)/back
        covered = (grown - s - path)/back
      else
        grown = s + path
        covered = 0.5_wp*(s + grown)*path
      end if
      s = grown
      left = left - path
      if (.not. left > 0.0_wp) return
      s = 0.0_wp
    end if
    grown = 1.0_wp - (1.0_wp - s)*exp(-left)
    covered = covered + left - (grown - s)
    s = grown
  end subroutine move_closed

  !> n = 2: tan(q x)/q with q^2 = -r for s < 0 (tanh for r > 0), then tanh(x).
  pure subroutine move_squared(back, x, s, covered)
    real(wp), intent(in) :: back, x
    real(wp), intent(inout) :: s
    !> Integral of s over x.
    real(wp), intent(out) :: covered
    real(wp) :: left, path, moved, grown

    left = x
    covered = 0.0_wp
    if (s < 0.0_wp) then
      path = path_squared(back, s)
      grown = 0.0_wp
      if (left < path) then
        moved = left
        if (back < -tiny_part) moved = tan(sqrt(-back)*left)/sqrt(-back)
        if (back > tiny_part) moved = tanh(sqrt(back)*left)/sqrt(back)
        grown = min(s + moved*(1.0_wp - back*s*s)/(1.0_wp + back*s*moved), 0.0_wp)
      end if
      covered = 0.5_wp*(grown**2 - s**2)/(1.0_wp - back*s**2)
      covered = covered*log_part(-back*2.0_wp*covered)
      s = grown
      left = left - path
      if (.not. left > 0.0_wp) return
    end if
    if (left < 1.0_wp) then
      moved = sinh(left)*s + 2.0_wp*sinh(0.5_wp*left)**2
      covered = covered + moved*log_part(moved)
    else
      covered = covered + left + log(0.5_wp*(1.0_wp + s + (1.0_wp - s)*exp(-2.0_wp*left)))
    end if
    moved = tanh(left)
    s = min((s + moved)/(1.0_wp + s*moved), 1.0_wp)
  end subroutine move_squared

  !> n = 2: the path from a negative state to 0.
  pure real(wp) function path_squared(back, s) result(path)
    real(wp), intent(in) :: back, s
    path = -s
    if (back < -tiny_part) path = atan(-sqrt(-back)*s)/sqrt(-back)
    if (back > tiny_part) path = atanh(-sqrt(back)*s)/sqrt(back)
  end function path_squared

  !> log(1 + w)/w.
  pure real(wp) function log_part(w) result(part)
    real(wp), intent(in) :: w
    part = 1.0_wp
    if (abs((1.0_wp + w) - 1.0_wp) > 0.0_wp) part = log(1.0_wp + w)/((1.0_wp + w) - 1.0_wp)
  end function log_part

  pure subroutine move_by_series(self, x, s, covered)
    class(bouc_wen_element), intent(in) :: self
    real(wp), intent(in) :: x
    real(wp), intent(inout) :: s
    real(wp), intent(out) :: covered
    real(wp) :: series(0:terms + 1), left, h, fastest, value, area
    integer :: k, side

    left = x
    covered = 0.0_wp
    do while (left > 0.0_wp)
      if (s >= self%largest*(1.0_wp - saturated)) then
        s = min(s, self%largest)
        covered = covered + left*s
        return
      end if
      side = merge(1, -1, s >= 0.0_wp)
      fastest = self%exponent*max(1.0_wp, merge(0.0_wp, -self%back, side > 0))
      h = merge(longest_above, longest, side > 0 .or. self%back > 0.0_wp)
      if (self%fore <= 0.0_wp) then
        fastest = fastest*max(1.0_wp, abs(s))**(self%exponent - 1.0_wp)
        h = longest_general
      end if
      h = min(left, h/fastest)
      if (self%whole == 0 .and. abs(s) < inner_state(self, side)) then
        h = left
        call move_inside(self, h, s, covered)
      else
        if (self%whole == 0) h = min(h, of_state*abs(s)/max(fastest, rate(self, s)))
        call expand(self, s, side, series)
        if (side < 0 .and. self%whole > 0) h = first_zero(series, h)
        value = 0.0_wp
        area = 0.0_wp
        do k = terms + 1, 0, -1
          value = value*h + series(k)
          area = area*h + series(k)/(k + 1)
        end do
        covered = covered + h*area
        s = value
        if (side < 0 .and. self%whole > 0 .and. abs(s) <= 4.0_wp*epsilon(1.0_wp)) s = 0.0_wp
      end if
      left = left - h
      if (left <= epsilon(1.0_wp)*x) exit
    end do
    s = min(s, self%largest)
  end subroutine move_by_series

  !> Largest |s| for which the series of the path is used.
  pure real(wp) function inner_state(self, side)
    class(bouc_wen_element), intent(in) :: self
    integer, intent(in) :: side
    inner_state = (inner/max(1.0_wp, merge(0.0_wp, -self%back, side > 0)))**(1.0_wp/self%exponent)
  end function inner_state

  !> Advance along a path through 0, at most to the limit of the series.
  pure subroutine move_inside(self, h, s, covered)
    class(bouc_wen_element), intent(in) :: self
    !> On entry the requested path length, on return the length covered.
    real(wp), intent(inout) :: h, s, covered
    real(wp) :: x, x_from, area, area_from, goal, low, high, correction
    integer :: turn

    call path_to(self, s, x_from, area_from)
    low = s
    high = inner_state(self, 1)*(1.0_wp + 1.0e-9_wp)
    call path_to(self, high, x, area)
    goal = x_from + h
    if (goal >= x) then
      s = high
      h = x - x_from
    else
      do turn = 1, most_turns
        call path_to(self, s, x, area)
        if (x < goal) low = max(low, s)
        if (x > goal) high = min(high, s)
        x = s + (goal - x)*rate(self, s)
        if (.not. (x >= low .and. x <= high)) x = 0.5_wp*(low + high)
        correction = abs(x - s)
        s = x
        ! The next Newton correction is of the order of its square.
        if (correction <= 1.0e-9_wp*abs(s)) exit
      end do
      call path_to(self, s, x, area)
    end if
    covered = covered + area - area_from
  end subroutine move_inside

  !> The path from 0 to a state, and the integral of the state over the path.
  pure subroutine path_to(self, s, x, area)
    class(bouc_wen_element), intent(in) :: self
    real(wp), intent(in) :: s
    real(wp), intent(out) :: x, area
    real(wp) :: part, power
    integer :: j

    part = merge(self%fore, self%back, s > 0.0_wp)*abs(s)**self%exponent
    power = 1.0_wp
    x = 0.0_wp
    area = 0.0_wp
    do j = 0, path_terms
      x = x + power/(self%exponent*j + 1.0_wp)
      area = area + power/(self%exponent*j + 2.0_wp)
      power = power*part
      if (abs(power) < 0.1_wp*epsilon(1.0_wp)) exit
    end do
    x = x*s
    area = area*s*s
  end subroutine path_to

  !> Taylor coefficients of s over x, on its side of 0.
  pure subroutine expand(self, s, side, series)
    class(bouc_wen_element), intent(in) :: self
    real(wp), intent(in) :: s
    integer, intent(in) :: side
    real(wp), intent(out) :: series(0:)
    real(wp) :: powers(0:terms, 20), factor, total
    integer :: j, k, m

    ! |s|^n, and ds/dx = 1 - factor |s|^n.
    factor = merge(self%fore, self%back, side > 0)
    series = 0.0_wp
    series(0) = s
    do k = 0, terms
      if (self%whole > 0) then
        powers(k, 1) = side*series(k)
        do m = 2, self%whole
          total = 0.0_wp
          do j = 0, k
            total = total + powers(j, m - 1)*powers(k - j, 1)
          end do
          powers(k, m) = total
        end do
        m = self%whole
      else
        m = 1
        if (k == 0) then
          powers(0, 1) = abs(s)**self%exponent
        else
          ! Recurrence from s (s^n)' = n s' s^n.
          total = 0.0_wp
          do j = 1, k
            total = total + (self%exponent*j - (k - j))*series(j)*powers(k - j, 1)
          end do
          powers(k, 1) = total/(k*s)
        end if
      end if
      series(k + 1) = (merge(1.0_wp, 0.0_wp, k == 0) - factor*powers(k, m))/(k + 1)
    end do
  end subroutine expand

  !> Zero of a growing series, at most h.
  pure real(wp) function first_zero(series, h) result(x)
    real(wp), intent(in) :: series(0:), h
    real(wp) :: value, slope
    integer :: k, turn

    ! Start from the largest value.
    x = h
    do turn = 0, 20
      value = 0.0_wp
      slope = 0.0_wp
      do k = ubound(series, 1), 0, -1
        slope = slope*x + value
        value = value*x + series(k)
      end do
      if (turn == 0 .and. value <= 0.0_wp) return
      x = min(max(x - value/slope, 0.0_wp), h)
      if (abs(value) <= epsilon(1.0_wp)) exit
    end do
  end function first_zero

  pure subroutine slope(self, z, way, slopes, by_z)
    class(bouc_wen_element), intent(in) :: self
    real(wp), intent(in) :: z(:)
    integer, intent(in) :: way
    real(wp), intent(out) :: slopes(:), by_z(:)
    real(wp) :: s, r

    s = way*z(1)/self%scale
    slopes(1) = self%rise*rate(self, s)
    r = merge(self%fore, self%back, s > 0.0_wp)
    by_z(1) = 0.0_wp
    if (abs(s) > 0.0_wp) then
      by_z(1) = -self%rise*r*self%exponent*abs(s)**(self%exponent - 1.0_wp)*sign(1.0_wp, s)*way &
                /self%scale
    end if
  end subroutine slope

  !> Path length to the sign change of the state.
  pure subroutine kinks(self, z, way, distances)
    class(bouc_wen_element), intent(in) :: self
    real(wp), intent(in) :: z(:)
    integer, intent(in) :: way
    real(wp), intent(out) :: distances(:)
    real(wp) :: s, covered, done, x
    integer :: turn

    distances = huge(1.0_wp)
    s = way*z(1)/self%scale
    if (s >= 0.0_wp) return
    if (self%closed == 1) then
      done = -s
      if (abs(self%back) > 0.0_wp) done = log(1.0_wp + self%back*s)/(-self%back)
    else if (self%closed == 2) then
      done = path_squared(self%back, s)
    else
      ! ds/dx is at most that at s, or 1, so the zero is at least x away.
      done = 0.0_wp
      do turn = 1, 50
        if (self%whole == 0 .and. -s < inner_state(self, -1)) then
          call path_to(self, s, x, covered)
          done = done - x
          exit
        end if
        x = -s/max(rate(self, s), 1.0_wp)
        call move_by_series(self, x, s, covered)
        done = done + x
        if (s >= -epsilon(1.0_wp)) exit
      end do
    end if
    distances(1) = done*self%scale/self%rise
  end subroutine kinks

end module viscovib_bouc_wen_element
