! Optimize: -O2
!> Beats: the frequencies at which the terms of modulation equations rotate in their frame, as
!! integer combinations of a few base frequencies, and functions of their angles as Fourier sums
!!
!!   f(theta) = sum_m F_m exp(i m.theta),      |m_1| + |m_2| + ... <= bound.
!!
!! Products of three such functions are computed at the points of a grid that resolves all
!! orders up to twice the bound in each angle.
module viscovib_beat_lattice
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: beat_lattice_type, find_beats, transform

  integer, parameter, public :: max_beats = 3
  !> Highest multiples in the search, by the number of beats.
  integer, parameter :: farthest(0:max_beats) = [0, 40, 8, 4]
  !> Frequencies that differ by less than this fraction of the highest count as equal.
  real(wp), parameter :: same = 1.0e-10_wp
  real(wp), parameter :: two_pi = 6.283185307179586_wp

  type :: beat_lattice_type
    !> Number of angles, and their frequencies.
    integer :: d = 0
    real(wp) :: beat(max_beats) = 0.0_wp
    !> Each term's multiples, shape (max_beats, n_terms).
    integer, allocatable :: turns(:, :)
    !> Included orders, shape (max_beats, n), the first of them 0; grid points in each angle.
    integer :: bound = 0, points = 1
    integer, allocatable :: orders(:, :)
  contains
    procedure :: set_bound
    procedure :: halve
    procedure :: n_points
    procedure :: angles_of
    procedure :: place_of
    procedure :: lowest_bound
  end type beat_lattice_type

contains

  !> Base frequencies of the rotating terms; `known` is false if there are more than max_beats.
  pure subroutine find_beats(turn, scale, lattice, known)
    real(wp), intent(in) :: turn(:)
    !> The highest of the frequencies whose differences are given.
    real(wp), intent(in) :: scale
    type(beat_lattice_type), intent(out) :: lattice
    logical, intent(out) :: known
    logical :: waits(size(turn)), found
    integer :: i, m(max_beats)

    allocate (lattice%turns(max_beats, size(turn)), source=0)
    known = .true.
    waits = abs(turn) > same*scale
    ! Begin with the lowest frequency: higher ones are more likely to be its multiples.
    do while (any(waits))
      i = minloc(abs(turn), 1, mask=waits)
      waits(i) = .false.
      call combine(lattice, turn(i), scale, m, found)
      if (found) cycle
      call divide_a_beat(lattice, abs(turn(i)), scale, found)
      if (found) cycle
      known = lattice%d < max_beats
      if (.not. known) return
      lattice%d = lattice%d + 1
      lattice%beat(lattice%d) = abs(turn(i))
    end do
    do i = 1, size(turn)
      if (.not. abs(turn(i)) > same*scale) cycle
      call combine(lattice, turn(i), scale, lattice%turns(:, i), found)
      known = known .and. found
    end do
  end subroutine find_beats

  !> The lowest integer combination of the beats that equals a frequency.
  pure subroutine combine(lattice, frequency, scale, m, found)
    type(beat_lattice_type), intent(in) :: lattice
    real(wp), intent(in) :: frequency, scale
    integer, intent(out) :: m(max_beats)
    logical, intent(out) :: found
    integer :: k(max_beats), i, j, most, least

    most = farthest(lattice%d)
    found = .false.
    m = 0
    least = huge(least)
    do i = 0, (2*most + 1)**lattice%d - 1
      k = 0
      do j = 1, lattice%d
        k(j) = modulo(i/(2*most + 1)**(j - 1), 2*most + 1) - most
      end do
      if (sum(abs(k)) >= least) cycle
      if (abs(sum(k*lattice%beat) - frequency) > same*scale) cycle
      found = .true.
      m = k
      least = sum(abs(k))
    end do
  end subroutine combine

  !> A frequency that is a fraction of a beat: replace the beat by a lower common base frequency.
  pure subroutine divide_a_beat(lattice, frequency, scale, found)
    type(beat_lattice_type), intent(inout) :: lattice
    real(wp), intent(in) :: frequency, scale
    logical, intent(out) :: found
    integer, parameter :: parts = 6
    real(wp) :: multiple
    integer :: b, q

    found = .false.
    do b = 1, lattice%d
      do q = 2, parts
        multiple = anint(frequency*q/lattice%beat(b))
        if (multiple > farthest(1)) cycle
        found = abs(multiple*lattice%beat(b)/q - frequency) <= same*scale
        if (.not. found) cycle
        lattice%beat(b) = lattice%beat(b)/q
        return
      end do
    end do
  end subroutine divide_a_beat

  !> Add half the sum of some beats as a base frequency: bit i - 1 of the mask selects beat i.
  pure subroutine halve(self, mask)
    class(beat_lattice_type), intent(inout) :: self
    integer, intent(in) :: mask
    integer :: i, j, first

    first = 0
    do i = self%d, 1, -1
      if (btest(mask, i - 1)) first = i
    end do
    if (first == 0) return
    ! beat_first = 2 half - the remaining beats of the sum.
    do j = 1, self%d
      if (j == first .or. .not. btest(mask, j - 1)) cycle
      self%beat(first) = self%beat(first) + self%beat(j)
      self%turns(j, :) = self%turns(j, :) - self%turns(first, :)
    end do
    self%beat(first) = 0.5_wp*self%beat(first)
    self%turns(first, :) = 2*self%turns(first, :)
  end subroutine halve

  !> The lowest bound that includes the orders of the terms themselves.
  pure integer function lowest_bound(self)
    class(beat_lattice_type), intent(in) :: self
    lowest_bound = 0
    if (size(self%turns) > 0) lowest_bound = maxval(sum(abs(self%turns), 1))
  end function lowest_bound

  !> Keep the orders up to a bound.
  pure subroutine set_bound(self, bound)
    class(beat_lattice_type), intent(inout) :: self
    integer, intent(in) :: bound
    integer :: k(max_beats), i, j, n, pass

    self%bound = bound
    self%points = merge(4*bound + 1, 1, self%d > 0)
    do pass = 1, 2
      n = 1
      if (pass == 2) self%orders(:, 1) = 0
      do i = 0, (2*bound + 1)**self%d - 1
        k = 0
        do j = 1, self%d
          k(j) = modulo(i/(2*bound + 1)**(j - 1), 2*bound + 1) - bound
        end do
        if (sum(abs(k)) > bound .or. all(k == 0)) cycle
        n = n + 1
        if (pass == 2) self%orders(:, n) = k
      end do
      if (pass == 2) exit
      if (allocated(self%orders)) deallocate (self%orders)
      allocate (self%orders(max_beats, n))
    end do
  end subroutine set_bound

  !> Points of the grid.
  pure integer function n_points(self)
    class(beat_lattice_type), intent(in) :: self
    n_points = self%points**self%d
  end function n_points

  !> Angles at point i of the grid.
  pure function angles_of(self, i) result(theta)
    class(beat_lattice_type), intent(in) :: self
    integer, intent(in) :: i
    real(wp) :: theta(max_beats)
    integer :: j
    theta = 0.0_wp
    do j = 1, self%d
      theta(j) = two_pi*modulo((i - 1)/self%points**(j - 1), self%points)/self%points
    end do
  end function angles_of

  !> Index of the order m in a transform.
  pure integer function place_of(self, m)
    class(beat_lattice_type), intent(in) :: self
    integer, intent(in) :: m(max_beats)
    integer :: j
    place_of = 1
    do j = 1, self%d
      place_of = place_of + modulo(m(j), self%points)*self%points**(j - 1)
    end do
  end function place_of

  !> F_m from values at the points of the grid, or (back) values from F_m.
  pure subroutine transform(lattice, x, back)
    type(beat_lattice_type), intent(in) :: lattice
    complex(wp), intent(inout) :: x(:)
    logical, intent(in) :: back
    complex(wp) :: root(0:lattice%points - 1), line(0:lattice%points - 1)
    integer :: n, axis, stride, first, i, k, m, at

    n = lattice%points
    do k = 0, n - 1
      root(k) = exp(cmplx(0.0_wp, merge(two_pi, -two_pi, back)*k/n, wp))
    end do
    stride = 1
    do axis = 1, lattice%d
      do i = 0, size(x)/n - 1
        first = modulo(i, stride) + (i/stride)*stride*n + 1
        line = x(first:first + stride*(n - 1):stride)
        do m = 0, n - 1
          at = first + stride*m
          x(at) = (0.0_wp, 0.0_wp)
          do k = 0, n - 1
            x(at) = x(at) + line(k)*root(modulo(m*k, n))
          end do
        end do
      end do
      stride = stride*n
    end do
    if (.not. back) x = x/size(x)
  end subroutine transform

end module viscovib_beat_lattice
