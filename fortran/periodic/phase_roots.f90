! Optimize: -O2
!> Phases at which a function along a periodic motion is 0.
module viscovib_phase_roots
  use viscovib_constants, only: pi
  use viscovib_harmonic_set, only: harmonic_set_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: along_motion, find_phases, phase_list, root

  !> A function along a motion, for a search of its zeros.
  type, abstract :: along_motion
  contains
    procedure(at_interface), deferred :: at
  end type along_motion

  abstract interface
    real(wp) function at_interface(self, theta)
      import :: along_motion, wp
      class(along_motion), intent(in) :: self
      real(wp), intent(in) :: theta
    end function at_interface
  end interface

  !> Phases, ascending, and the number of the function of each.
  type :: phase_list
    integer :: n = 0
    real(wp), allocatable :: theta(:)
    integer, allocatable :: of(:)
  contains
    procedure :: put
  end type phase_list

  integer, parameter :: most_turns = 60, most_parabolas = 4

contains

  !> Insert a phase in order; a phase that is already in the list is not repeated.
  subroutine put(self, theta, of)
    class(phase_list), intent(inout) :: self
    real(wp), intent(in) :: theta
    integer, intent(in) :: of
    real(wp), allocatable :: longer(:)
    integer, allocatable :: wider(:)
    integer :: i

    if (.not. allocated(self%theta)) allocate (self%theta(16), self%of(16))
    do i = self%n, 1, -1
      if (self%theta(i) <= theta) exit
    end do
    if (i > 0) then
      if (theta - self%theta(i) <= 4.0_wp*epsilon(1.0_wp) .and. self%of(i) == of) return
    end if
    if (self%n == size(self%theta)) then
      allocate (longer(2*self%n), wider(2*self%n))
      longer(:self%n) = self%theta
      wider(:self%n) = self%of
      call move_alloc(longer, self%theta)
      call move_alloc(wider, self%of)
    end if
    self%theta(i + 2:self%n + 1) = self%theta(i + 1:self%n)
    self%of(i + 2:self%n + 1) = self%of(i + 1:self%n)
    self%theta(i + 1) = theta
    self%of(i + 1) = of
    self%n = self%n + 1
  end subroutine put

  !> The zeros of a function with given values at the samples of a set and at the end.
  subroutine find_phases(motion, set, g, of, found)
    class(along_motion), intent(in) :: motion
    type(harmonic_set_type), intent(in) :: set
    !> Shape (n_samples + 1).
    real(wp), intent(in) :: g(:)
    integer, intent(in) :: of
    type(phase_list), intent(inout) :: found
    real(wp) :: step, theta, vertex, value, half, summit, left, right
    integer :: i, n

    n = size(g) - 1
    step = merge(pi, 2.0_wp*pi, set%half_wave)/n
    do i = 1, n
      theta = (i - 1)*step
      if (.not. abs(g(i)) > 0.0_wp) then
        call found%put(theta, of)
      else if (abs(g(i + 1)) > 0.0_wp .and. (g(i) > 0.0_wp .neqv. g(i + 1) > 0.0_wp)) then
        call found%put(root(motion, theta, theta + step, g(i), g(i + 1)), of)
      end if
    end do
    do i = 1, n + 1
      theta = (i - 1)*step
      ! Near grazing a function may change sign for less than a sample, also at both ends.
      left = g(max(i - 1, 1))
      right = g(min(i + 1, n + 1))
      if (i == 1) then
        if (abs(g(i)) >= abs(right)) cycle
        left = motion%at(-step)
      else if (i == n + 1) then
        if (abs(g(i)) >= abs(left)) cycle
        right = motion%at(theta + step)
      end if
      if (abs(g(i)) >= min(abs(left), abs(right))) cycle
      if ((left > 0.0_wp) .neqv. (g(i) > 0.0_wp)) cycle
      if ((right > 0.0_wp) .neqv. (g(i) > 0.0_wp)) cycle
      half = left - 2.0_wp*g(i) + right
      vertex = 0.5_wp*(left - right)/half
      if (abs(g(i) + 0.25_wp*(right - left)*vertex) > 0.3_wp*abs(half)) cycle
      call find_summit(motion, theta + vertex*step, step, g(i) > 0.0_wp, summit, value)
      if ((value > 0.0_wp .eqv. g(i) > 0.0_wp) .or. .not. abs(value) > 0.0_wp) cycle
      call put_inside(root(motion, theta - step, summit, left, value))
      call put_inside(root(motion, summit, theta + step, value, right))
    end do

  contains

    !> Zeros beyond an end are found at the other end, or belong to the other half of the period.
    subroutine put_inside(phase)
      real(wp), intent(in) :: phase
      if (phase >= 0.0_wp .and. phase < n*step) call found%put(phase, of)
    end subroutine put_inside

  end subroutine find_phases

  !> The extremum near a phase, by parabolas through closer and closer phases, or the first phase at
  !! which the function has the other sign. Without this precision a grazing contact would be found
  !! or missed by chance, and Newton's method would meet a jump.
  subroutine find_summit(motion, from, step, above, summit, value)
    class(along_motion), intent(in) :: motion
    real(wp), intent(in) :: from, step
    !> True if the function is positive near the extremum.
    logical, intent(in) :: above
    real(wp), intent(out) :: summit, value
    real(wp) :: apart, before, after, half
    integer :: turn

    summit = from
    value = motion%at(summit)
    apart = step
    do turn = 1, most_parabolas
      if ((value > 0.0_wp) .neqv. above) return
      apart = apart/8.0_wp
      before = motion%at(summit - apart)
      after = motion%at(summit + apart)
      half = before - 2.0_wp*value + after
      if (.not. abs(half) > 0.0_wp) return
      ! The value is too far from 0.
      if (abs(value) > abs(half)) return
      summit = summit + max(-1.0_wp, min(0.5_wp*(before - after)/half, 1.0_wp))*apart
      value = motion%at(summit)
    end do
  end subroutine find_summit

  !> A zero between two phases with values of different sign: the Illinois method, then bisection.
  real(wp) function root(motion, from, to, at_from, at_to)
    class(along_motion), intent(in) :: motion
    real(wp), intent(in) :: from, to, at_from, at_to
    real(wp) :: a, b, fa, fb, f, x
    integer :: turn, side

    a = from
    b = to
    fa = at_from
    fb = at_to
    side = 0
    root = 0.5_wp*(a + b)
    do turn = 1, most_turns
      x = (fa*b - fb*a)/(fa - fb)
      if (turn > 20 .or. .not. (x > a .and. x < b)) x = 0.5_wp*(a + b)
      f = motion%at(x)
      root = x
      if (.not. abs(f) > 0.0_wp) return
      if ((f > 0.0_wp) .eqv. (fa > 0.0_wp)) then
        a = x
        fa = f
        if (side == 1) fb = 0.5_wp*fb
        side = 1
      else
        b = x
        fb = f
        if (side == -1) fa = 0.5_wp*fa
        side = -1
      end if
      if (b - a <= 4.0_wp*epsilon(1.0_wp)*max(1.0_wp, abs(b))) return
      if (abs(f) <= 4.0_wp*epsilon(1.0_wp)*max(abs(at_from), abs(at_to))) return
    end do
  end function root

end module viscovib_phase_roots
