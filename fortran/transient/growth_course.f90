!> How small disturbances of a motion grow on the way, and how far off their mean rate of growth is
!! for that.
module viscovib_growth_course
  use viscovib_kinds, only: i8, wp
  use viscovib_lanes, only: n_lanes
  implicit none
  private

  public :: growth_course

  !> Looks at their growth, and how far off its mean rate is in units of the range of what it was
  !! off a straight line, over the time: of a random walk 2 is 2.5 standard deviations.
  integer, parameter :: most_looks = 64
  real(wp), parameter :: in_ranges = 2.0_wp, golden = 0.5_wp*(sqrt(5.0_wp) - 1.0_wp)

  !> How disturbances have grown on the way, at places of the time that counts, from its beginning.
  type :: growth_course
    integer :: n = 0
    !> Steps that count, and that of the next look.
    integer(i8) :: steps = 0, next = 0
    !> Parts of that time, and logarithms, shape (n_lanes, n_exponents, 0:most_looks).
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

  !> Looks are not evenly apart, lest they meet all swings at the same phase: parts of the golden
  !! section before even places. The last is at the end.
  pure subroutine place_next(self)
    class(growth_course), intent(inout) :: self
    real(wp) :: k
    k = real(self%n + 1, wp)
    if (self%n + 1 < most_looks) k = k - modulo(k*golden, 1.0_wp)
    self%next = max(self%next + 1, int(self%steps*(k/most_looks), i8))
    if (self%n + 1 == most_looks) self%next = self%steps
  end subroutine place_next

  !> Keep the growth after so many steps, if it is due.
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

  !> How far off the mean rate of growth may be, times the time. Growth that wanders about a
  !! straight line, as near chaos, or settles on one, as after a start, has a mean rate that is
  !! off by a part of what it wandered: of a random walk over a time T the range of what it is off
  !! its chord is 1.25 standard deviations of its end in the mean; of a start that adds C, C.
  pure function unsure(self) result(off)
    class(growth_course), intent(in) :: self
    real(wp) :: off(size(self%growth, 1), size(self%growth, 2))
    real(wp), dimension(size(off, 1), size(off, 2)) :: least, most, beside
    integer :: k
    least = 0.0_wp
    most = 0.0_wp
    do k = 1, self%n
      beside = self%growth(:, :, k) - self%at(k)*self%growth(:, :, self%n)
      least = min(least, beside)
      most = max(most, beside)
    end do
    off = in_ranges*(most - least)
  end function unsure

end module viscovib_growth_course
