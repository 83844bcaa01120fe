!> Loads given as piecewise polynomials in time; zero before the first and after the last break.
module viscovib_timed_polynomials
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: timed_polynomials

  !> Relative jump of a derivative that is a corner, not rounding.
  real(wp), parameter :: smooth = 1.0e-11_wp

  type :: timed_polynomials
    !> Shapes (n) and (n_rows, n_powers, n): sum_p pieces(:, p, i) (t - breaks(i))^(n_powers-p). The
    !! last piece is not used.
    real(wp), allocatable :: breaks(:), pieces(:, :, :)
  contains
    procedure :: between
    procedure :: at
    procedure :: integrals
    procedure :: add
    procedure :: corners
    procedure, private :: place
  end type timed_polynomials

contains

  !> The polynomial of the interval from `from` to `to`, in powers of the time since `from`, shape
  !! (n_rows, n_powers).
  pure function between(self, from, to) result(a)
    class(timed_polynomials), intent(in) :: self
    real(wp), intent(in) :: from, to
    real(wp) :: a(size(self%pieces, 1), size(self%pieces, 2))
    real(wp) :: middle, shift
    integer :: i, k, p

    a = 0.0_wp
    middle = 0.5_wp*(from + to)
    if (middle < self%breaks(1) .or. middle > self%breaks(size(self%breaks))) return
    i = self%place(middle)
    shift = from - self%breaks(i)
    a = self%pieces(:, :, i)
    do k = size(a, 2), 2, -1
      do p = 2, k
        a(:, p) = a(:, p) + shift*a(:, p - 1)
      end do
    end do
  end function between

  !> The piece at a time, at a break the one after it, shape from 1 to n - 1.
  pure integer function place(self, t) result(low)
    class(timed_polynomials), intent(in) :: self
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
    class(timed_polynomials), intent(in) :: self
    real(wp), intent(in) :: t
    real(wp) :: values(size(self%pieces, 1))
    integer :: i, p
    values = 0.0_wp
    if (t < self%breaks(1) .or. t > self%breaks(size(self%breaks))) return
    i = self%place(t)
    do p = 1, size(self%pieces, 2)
      values = values*(t - self%breaks(i)) + self%pieces(:, p, i)
    end do
  end function at

  !> First and second integrals of the loads from the first break on, shape (n_rows, 2).
  pure function integrals(self, t) result(values)
    class(timed_polynomials), intent(in) :: self
    real(wp), intent(in) :: t
    real(wp) :: values(size(self%pieces, 1), 2)
    real(wp) :: x
    integer :: i, m, p

    values = 0.0_wp
    do i = 1, size(self%breaks)
      if (t <= self%breaks(i)) exit
      x = t - self%breaks(i)
      if (i < size(self%breaks)) x = min(t, self%breaks(i + 1)) - self%breaks(i)
      values(:, 2) = values(:, 2) + x*values(:, 1)
      if (i == size(self%breaks)) exit
      do p = 1, size(self%pieces, 2)
        m = size(self%pieces, 2) - p + 1
        values(:, 1) = values(:, 1) + self%pieces(:, p, i)*x**m/m
        values(:, 2) = values(:, 2) + self%pieces(:, p, i)*x**(m + 1)/(m*(m + 1))
      end do
    end do
  end function integrals

  !> Values of polynomials and all their derivatives after a time x, by order.
  pure function derivatives(a, x) result(jets)
    real(wp), intent(in) :: a(:, :), x
    real(wp) :: jets(size(a, 1), size(a, 2))
    integer :: k, n, p
    n = size(a, 2)
    jets = a
    do k = n, 2, -1
      do p = 2, k
        jets(:, p) = jets(:, p) + x*jets(:, p - 1)
      end do
    end do
    jets = jets(:, n:1:-1)
    do k = 2, n
      jets(:, k) = gamma(real(k, wp))*jets(:, k)
    end do
  end function derivatives

  !> Add a table of the same rows.
  pure subroutine add(self, other)
    class(timed_polynomials), intent(inout) :: self
    class(timed_polynomials), intent(in) :: other
    real(wp), allocatable :: breaks(:), pieces(:, :, :)
    real(wp) :: t
    integer :: i, j, m, n

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
    m = max(size(self%pieces, 2), size(other%pieces, 2))
    allocate (pieces(size(self%pieces, 1), m, n), source=0.0_wp)
    do i = 1, n - 1
      call take(self, pieces(:, :, i))
      call take(other, pieces(:, :, i))
    end do
    self%breaks = breaks(:n)
    call move_alloc(pieces, self%pieces)

  contains

    pure subroutine take(table, total)
      class(timed_polynomials), intent(in) :: table
      real(wp), intent(inout) :: total(:, :)
      integer :: first
      first = m - size(table%pieces, 2) + 1
      total(:, first:) = total(:, first:) + table%between(breaks(i), breaks(i + 1))
    end subroutine take

  end subroutine add

  !> Times at which a load or one of its derivatives jumps, and both ends. A jump is relative to the
  !! two adjacent pieces: a steep piece elsewhere does not hide a corner.
  pure function corners(self) result(times)
    class(timed_polynomials), intent(in) :: self
    real(wp), allocatable :: times(:)
    real(wp), dimension(size(self%pieces, 1), size(self%pieces, 2)) :: begin, end, first, last
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

end module viscovib_timed_polynomials
