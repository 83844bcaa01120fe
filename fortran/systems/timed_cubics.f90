!> Loads given as piecewise cubics in time; zero before the first and after the last break.
module viscovib_timed_cubics
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: timed_cubics

  !> Relative jump of a derivative that is a corner, not rounding.
  real(wp), parameter :: smooth = 1.0e-11_wp

  type :: timed_cubics
    !> Shapes (n) and (n_rows, 4, n): sum_p pieces(:, p, i) (t - breaks(i))^(4-p). The last piece is
    !! not used.
    real(wp), allocatable :: breaks(:), pieces(:, :, :)
  contains
    procedure :: between
    procedure :: at
    procedure :: add
    procedure :: corners
    procedure, private :: place
  end type timed_cubics

contains

  !> The cubic of the interval from `from` to `to`, in powers of the time since `from`, shape
  !! (n_rows, 4).
  pure function between(self, from, to) result(cubic)
    class(timed_cubics), intent(in) :: self
    real(wp), intent(in) :: from, to
    real(wp) :: cubic(size(self%pieces, 1), 4)
    real(wp) :: middle, shift
    integer :: i

    cubic = 0.0_wp
    middle = 0.5_wp*(from + to)
    if (middle < self%breaks(1) .or. middle > self%breaks(size(self%breaks))) return
    i = self%place(middle)
    shift = from - self%breaks(i)
    associate (a => self%pieces(:, :, i))
      cubic(:, 1) = a(:, 1)
      cubic(:, 2) = a(:, 2) + 3.0_wp*shift*a(:, 1)
      cubic(:, 3) = a(:, 3) + shift*(2.0_wp*a(:, 2) + 3.0_wp*shift*a(:, 1))
      cubic(:, 4) = a(:, 4) + shift*(a(:, 3) + shift*(a(:, 2) + shift*a(:, 1)))
    end associate
  end function between

  !> The piece at a time, at a break the one after it, shape from 1 to n - 1.
  pure integer function place(self, t) result(low)
    class(timed_cubics), intent(in) :: self
    real(wp), intent(in) :: t
    integer :: high, middle
    low = 1
    high = size(self%breaks) - 1
    do while (low < high)
      middle = (low + high + 1)/2
      if (t >= self%breaks(middle)) then
        low = middle
      else
        high = middle - 1
      end if
    end do
  end function place

  !> Loads at a time, shape (n_rows).
  pure function at(self, t) result(values)
    class(timed_cubics), intent(in) :: self
    real(wp), intent(in) :: t
    real(wp) :: values(size(self%pieces, 1)), jets(size(self%pieces, 1), 4)
    integer :: i
    values = 0.0_wp
    if (t < self%breaks(1) .or. t > self%breaks(size(self%breaks))) return
    i = self%place(t)
    jets = derivatives(self%pieces(:, :, i), t - self%breaks(i))
    values = jets(:, 1)
  end function at

  !> Values of cubics and their derivatives after a time x, shape (n_rows, 4).
  pure function derivatives(a, x) result(jets)
    real(wp), intent(in) :: a(:, :), x
    real(wp) :: jets(size(a, 1), 4)
    jets(:, 1) = ((a(:, 1)*x + a(:, 2))*x + a(:, 3))*x + a(:, 4)
    jets(:, 2) = (3.0_wp*a(:, 1)*x + 2.0_wp*a(:, 2))*x + a(:, 3)
    jets(:, 3) = 6.0_wp*a(:, 1)*x + 2.0_wp*a(:, 2)
    jets(:, 4) = 6.0_wp*a(:, 1)
  end function derivatives

  !> Add a table of the same rows.
  pure subroutine add(self, other)
    class(timed_cubics), intent(inout) :: self
    class(timed_cubics), intent(in) :: other
    real(wp), allocatable :: breaks(:), pieces(:, :, :)
    real(wp) :: t
    integer :: i, j, n

    allocate (breaks(size(self%breaks) + size(other%breaks)))
    i = 1
    j = 1
    n = 0
    do while (i <= size(self%breaks) .or. j <= size(other%breaks))
      t = huge(1.0_wp)
      if (i <= size(self%breaks)) t = self%breaks(i)
      if (j <= size(other%breaks)) t = min(t, other%breaks(j))
      n = n + 1
      breaks(n) = t
      if (i <= size(self%breaks)) i = i + merge(1, 0, self%breaks(i) <= t)
      if (j <= size(other%breaks)) j = j + merge(1, 0, other%breaks(j) <= t)
    end do
    allocate (pieces(size(self%pieces, 1), 4, n), source=0.0_wp)
    do i = 1, n - 1
      pieces(:, :, i) = self%between(breaks(i), breaks(i + 1)) &
                        + other%between(breaks(i), breaks(i + 1))
    end do
    self%breaks = breaks(:n)
    call move_alloc(pieces, self%pieces)
  end subroutine add

  !> Times at which a load or one of its derivatives jumps, and both ends. A jump is relative to the
  !! two adjacent pieces: a steep piece elsewhere does not hide a corner.
  pure function corners(self) result(times)
    class(timed_cubics), intent(in) :: self
    real(wp), allocatable :: times(:)
    real(wp), dimension(size(self%pieces, 1), 4) :: begin, end, first, last
    logical, allocatable :: is_corner(:)
    integer :: i, n

    n = size(self%breaks)
    allocate (is_corner(n), source=.true.)
    do i = 1, n - 1
      begin = derivatives(self%pieces(:, :, i), 0.0_wp)
      end = derivatives(self%pieces(:, :, i), self%breaks(i + 1) - self%breaks(i))
      if (i > 1) is_corner(i) = any(abs(begin - last) > smooth*max(abs(begin), abs(end), &
                                                                   abs(first), abs(last)))
      first = begin
      last = end
    end do
    times = pack(self%breaks, is_corner)
  end function corners

end module viscovib_timed_cubics
