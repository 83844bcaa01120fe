!> Growth of small perturbations along a motion, and the error of its mean rate.
module viscovib_growth_course
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: growth_course

  !> Number of samples; error of the mean rate in units of the range of the deviation from a
  !! straight line, over the time: for a random walk a factor of 2 is 2.5 standard deviations.
  integer, parameter :: most_looks = 64
  real(wp), parameter :: in_ranges = 2.0_wp, golden = 0.5_wp*(sqrt(5.0_wp) - 1.0_wp)

  !> Growth of perturbations at samples of the averaging time, from its beginning.
  type :: growth_course
    integer :: n = 0
    !> Number of steps of the averaging time, and step of the next sample.
    integer(i8) :: steps = 0, next = 0
    !> Fractions of that time, and logarithms, shape (n_lanes, n_exponents, 0:most_looks).
    real(wp) :: at(0:most_looks) = 0.0_wp
    real(wp), allocatable :: growth(:, :, :)
  contains
    procedure :: begin
    procedure :: see
    procedure :: unsure
    procedure, private :: place_next
  end type growth_course

contains

  pure subroutine begin(self, n_exponents, steps)
    class(growth_course), intent(inout) :: self
    integer, intent(in) :: n_exponents
    integer(i8), intent(in) :: steps
    allocate (self%growth(n_lanes, n_exponents, 0:most_looks), source=0.0_wp)
    self%steps = steps
    call self%place_next()
  end subroutine begin

  !> Samples are not equidistant, to avoid equal phases of oscillations: each is a fraction from the
  !! golden section before an equidistant time. The last is at the end.
  pure subroutine place_next(self)
    class(growth_course), intent(inout) :: self
    real(wp) :: k
    k = real(self%n + 1, wp)
    if (self%n + 1 < most_looks) k = k - modulo(k*golden, 1.0_wp)
    self%next = max(self%next + 1, int(self%steps*(k/most_looks), i8))
    if (self%n + 1 == most_looks) self%next = self%steps
  end subroutine place_next

  !> Store the growth after `done` steps, if a sample is due.
  pure subroutine see(self, done, growth)
    class(growth_course), intent(inout) :: self
    integer(i8), intent(in) :: done
    real(wp), intent(in) :: growth(:, :)
    if (done /= self%next .and. done /= self%steps) return
    self%n = self%n + 1
    self%at(self%n) = real(done, wp)/real(self%steps, wp)
    self%growth(:, :, self%n) = growth
    call self%place_next()
  end subroutine see

  !> Error of the mean growth rate, times the time. If the growth fluctuates about a straight line,
  !! as near chaos, or approaches one, as after a start, the error of its mean rate is a part of the
  !! deviation: for a random walk over a time T the mean range of the deviation from its chord is
  !! 1.25 standard deviations of its end; for a start that adds C, it is C.
  pure function unsure(self) result(off)
    class(growth_course), intent(in) :: self
    real(wp) :: off(size(self%growth, 1), size(self%growth, 2))
    real(wp), dimension(size(off, 1), size(off, 2)) :: least, most, nearby
    integer :: k
    least = 0.0_wp
    most = 0.0_wp
    do k = 1, self%n
      nearby = self%growth(:, :, k) - self%at(k)*self%growth(:, :, self%n)
      least = min(least, nearby)
      most = max(most, nearby)
    end do
    off = in_ranges*(most - least)
  end function unsure

end module viscovib_growth_course
