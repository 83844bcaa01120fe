! Optimize: -O2
!> How many disturbances of a motion of a condensed structure grow, by the argument principle.
!!
!! F, Hill's determinant with m poles of the rest multiplied out, has P poles right of the line
!! Re lambda = sigma, those of the rest that were left in. It is periodic along the line, real at
!! sigma and half a period i d further, and does not wind at large Re lambda, so that
!!
!!   number of zeros = P - [arg F(sigma + i d/2) - arg F(sigma)]/pi.
!!
!! Zeros that are known are divided out, F/[1 - exp(2 pi (lambda_k - lambda)/d)]; those right of the
!! line count on their own, and were one of them no zero, it would count as a pole of what is left.
!! What is left must be seen to change little from node to node. A zero that was not found has no
!! pole near it and turns the argument by pi, of which nodes see nothing only where two zeros lie
!! between the same two: the modulus of the neighbouring intervals shows it, so that an interval
!! counts when it and its neighbours are quiet and none of them is much narrower.
!!
!! Singularities of memory lie left of the line near one of its ends. The interval there is no
!! wider than they are away; sigma is a small part of d, so that the line passes right of the branch
!! point of a kernel without integral.
module viscovib_condensed_count
  use viscovib_condensed_hill, only: condensed_hill
  use viscovib_condensed_poles, only: gap_list, new_gaps
  use viscovib_constants, only: pi
  use viscovib_kinds, only: wp
  use viscovib_path_marks, only: mark_intervals
  use viscovib_polar, only: plain_logarithm
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: condensed_path, count_zeros, new_path

  !> Nodes at most, pieces at first, and those more for zeros not known.
  integer, parameter :: max_nodes = 600, few_pieces = 4, max_pieces = 24
  integer, parameter :: max_passes = 60
  !> A count must be this near to an integer.
  real(wp), parameter :: margin = 0.2_wp
  !> An interval need be no narrower than this, in d, to see past memory.
  real(wp), parameter :: narrowest = 1.0e-12_wp

  type :: condensed_path
    !> Re lambda of the line (1/s).
    real(wp) :: line = 0.0_wp
    integer :: n = 0
    !> Im lambda of the nodes, ascending from 0 to d/2, and F there.
    real(wp), allocatable :: y(:)
    complex(wp), allocatable :: value(:)
  contains
    procedure, private :: split
  end type condensed_path

contains

  subroutine new_path(path, hill, system, n_known)
    type(condensed_path), intent(out) :: path
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    !> Zeros that are known.
    integer, intent(in) :: n_known
    real(wp), allocatable :: y(:)
    real(wp) :: width, away
    integer :: i, n

    path%line = hill%line
    n = few_pieces + max(0, min(hill%poles%n_multiplied - n_known, max_pieces))
    allocate (y(n + 1))
    do i = 0, n
      y(i + 1) = 0.5_wp*hill%period*i/n
    end do
    if (hill%remembers) then
      away = max(hill%fading, narrowest*hill%period)
      width = y(2)
      do while (width > away)
        width = 0.5_wp*width
        if (hill%stride == 2) then
          y = [y(:size(y) - 1), 0.5_wp*hill%period - width, y(size(y))]
        else
          y = [y(1), width, y(2:)]
        end if
      end do
    end if
    path%n = size(y)
    allocate (path%y(path%n), path%value(path%n))
    path%y = y
    do i = 1, path%n
      call evaluate(path, hill, system, y(i), path%value(i))
    end do
  end subroutine new_path

  subroutine evaluate(path, hill, system, y, value)
    class(condensed_path), intent(in) :: path
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    real(wp), intent(in) :: y
    complex(wp), intent(out) :: value
    call hill%determinant(system, cmplx(path%line, y, wp), value, y > 0.25_wp*hill%period)
  end subroutine evaluate

  !> Exponents right of the line in the strip |Im lambda| <= d/2; -1: unknown.
  subroutine count_zeros(hill, system, known, path, n_right)
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    !> Zeros found, both of conjugate pairs.
    complex(wp), intent(in) :: known(:)
    !> Nodes where F is known; more may be added.
    type(condensed_path), intent(inout) :: path
    integer, intent(out) :: n_right
    type(gap_list) :: gaps
    complex(wp), allocatable :: change(:)
    logical, allocatable :: marked(:)
    real(wp) :: turn
    integer :: pass
    logical :: made

    n_right = -1
    call new_gaps(gaps, known, hill%period)
    do pass = 1, max_passes
      call changes(gaps, path, change, made)
      if (.not. made) return
      call mark_intervals(path%y(2:path%n) - path%y(:path%n - 1), change, marked)
      if (.not. any(marked)) exit
      call path%split(hill, system, marked, made)
      if (.not. made) return
    end do
    if (pass > max_passes) return
    turn = sum(aimag(change))/pi
    if (.not. abs(turn - nint(turn)) <= margin) return
    n_right = max(count(real(known) > path%line) + hill%poles%n_growing - nint(turn), -1)
  end subroutine count_zeros

  !> By how much the logarithm of what is left of F changes from node to node.
  pure subroutine changes(known, path, change, made)
    type(gap_list), intent(in) :: known
    type(condensed_path), intent(in) :: path
    complex(wp), allocatable, intent(out) :: change(:)
    !> Not where F is 0 or no number.
    logical, intent(out) :: made
    complex(wp) :: left(path%n)
    integer :: i

    allocate (change(path%n - 1))
    made = .true.
    do i = 1, path%n
      left(i) = path%value(i)
      call known%divide(cmplx(path%line, path%y(i), wp), left(i))
      made = made .and. abs(left(i)) > 0.0_wp .and. abs(left(i)) <= huge(1.0_wp)
    end do
    if (made) change = plain_logarithm(left(2:)/left(:path%n - 1))
  end subroutine changes

  !> Nodes amid the intervals that are marked.
  subroutine split(self, hill, system, marked, made)
    class(condensed_path), intent(inout) :: self
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    logical, intent(in) :: marked(:)
    !> Not where there would be too many, or where numbers do not lie closer.
    logical, intent(out) :: made
    real(wp), allocatable :: y(:)
    complex(wp), allocatable :: value(:)
    integer :: i, k, n

    n = self%n + count(marked)
    made = n <= max_nodes
    if (.not. made) return
    allocate (y(n), value(n))
    k = 0
    do i = 1, self%n
      k = k + 1
      y(k) = self%y(i)
      value(k) = self%value(i)
      if (i == self%n) exit
      if (.not. marked(i)) cycle
      k = k + 1
      y(k) = 0.5_wp*(self%y(i) + self%y(i + 1))
      made = made .and. y(k) - self%y(i) > epsilon(1.0_wp)*hill%period
      call evaluate(self, hill, system, y(k), value(k))
    end do
    self%n = n
    call move_alloc(y, self%y)
    call move_alloc(value, self%value)
  end subroutine split

end module viscovib_condensed_count
