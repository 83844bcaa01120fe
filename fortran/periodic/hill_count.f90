! Optimize: -O3
!> Exponents of a periodic solution right of a line, as those that grow, counted by the argument
!! principle.
!!
!! Hill's determinant D has P poles right of the line Re lambda = sigma, of a condensed structure
!! those of its linear rest that were left in. It is periodic along the line, real at sigma and half
!! a period i d further, and does not wind at large Re lambda. Around the half strip
!! |Im lambda| <= d/2, Re lambda >= sigma, the sides along which it is periodic cancel, and
!!
!!   number of zeros = P - [arg D(sigma + i d/2) - arg D(sigma)]/pi.
!!
!! Zeros that are known are divided out, D/(1 - exp(2 pi (lambda_k - lambda)/d)), which has all
!! of these properties: what is left turns slowly, also where zeros lie next to the line. Those
!! right of it count on their own; were one of them no zero, it would count as a
!! pole of what is left, so that the sum is right whatever is thought to be known.
!!
!! The logarithm of what is left must be seen to change little from node to node. Two zeros
!! next to the line between the same two nodes turn it by 2 pi there, of which the nodes see
!! nothing. The modulus near them shows it: x and y being their places in the interval, 0 to 1,
!! and w the width of the interval before, it changes there by the factor (1 + w/x)(1 + w/y),
!! and alike behind with 1 - x and 1 - y; with w >= 1/2 one of both is 4 or more. So an interval
!! counts when it and its neighbours are quiet, and none of them may be much narrower.
!!
!! Singularities of memory lie left of the line near one of its ends, and hide zeros as near to
!! them. Unless all exponents are known that the motion has without memory, and none of memory lies
!! right of the line, the interval at that end is no wider than they are away.
module viscovib_hill_count
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_constants, only: pi
  use viscovib_hill_determinant, only: gap_list, hill_determinant, new_gaps
  use viscovib_hill_path, only: hill_path_type
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polar, only: plain_logarithm
  implicit none
  private

  public :: count_right, may_be_of_memory

  !> No interval is loud where all changes together are less.
  real(wp), parameter :: quiet = 0.6_wp
  integer, parameter :: max_passes = 60
  !> A count must be this near to an integer.
  real(wp), parameter :: margin = 0.2_wp
  !> An interval need be no narrower than this, in d, to see past memory.
  real(wp), parameter :: narrowest = 1.0e-5_wp
  !> Distances from a line that count as 0, in d.
  real(wp), parameter, public :: on_axis = 1.0e-13_wp

  !> Limits of a quiet interval: change of the argument, and of the logarithm of the modulus. They
  !! are less than half of the effect of two unnoticed zeros on an adjacent interval.
  real(wp), parameter :: largest_turn = 0.6_wp, largest_ratio = 0.6_wp
  !> Largest ratio of the widths of adjacent intervals.
  real(wp), parameter :: grading = 2.01_wp

contains

  !> Exponents right of the line of a path in the strip |Im lambda| <= d/2; -1: unknown.
  subroutine count_right(hill, system, known, path, n_right)
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    !> Exponents found, both of conjugate pairs; NaN is passed over.
    complex(wp), intent(in) :: known(:)
    !> Nodes where the determinant is known; more may be added.
    type(hill_path_type), intent(inout) :: path
    integer, intent(out) :: n_right

    n_right = -1
    if (.not. hill%ready) return
    call count_along(hill, system, pack(known,.not. ieee_is_nan(real(known))), path, n_right)
  end subroutine count_right

  subroutine count_along(hill, system, known, path, n_right)
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: known(:)
    type(hill_path_type), intent(inout) :: path
    integer, intent(inout) :: n_right
    type(hill_path_type) :: memory
    complex(wp), allocatable :: divided(:)
    complex(wp) :: none(0)
    real(wp) :: turn, of_memory, away, width
    integer :: i
    logical :: made, relaxed, of_its_own(size(known))

    ! On the line within rounding error: its side is unknown.
    if (any(abs(real(known) - path%line) <= on_axis*hill%period)) return
    call choose(hill, known, path, divided, relaxed)
    away = max(hill%fading + path%line, narrowest*hill%period)
    of_its_own = may_be_of_memory(hill, known)
    width = huge(width)
    if (count(.not. of_its_own) < hill%n_without_memory) width = away
    if (any(of_its_own .and. real(known) > path%line) .and. .not. relaxed) width = away
    call follow(hill, system, divided, relaxed, width, path, turn, made)
    if (.not. made) return
    if (relaxed) then
      call path%path_of_ratio(memory)
      call follow(hill, system, none, .false., away, memory, of_memory, made)
      if (.not. made) return
      turn = turn + of_memory
    end if
    if (.not. abs(turn/pi - nint(turn/pi)) <= margin) return
    i = count(real(divided) > path%line) + hill%n_apart - nint(turn/pi)
    if (i >= 0) n_right = i
  end subroutine count_along

  !> By how much the argument of what is left of D turns along the path, refined until that is
  !! certain.
  subroutine follow(hill, system, divided, relaxed, width, path, turn, made)
    class(hill_determinant), intent(inout) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: divided(:)
    logical, intent(in) :: relaxed
    !> Largest width of the interval near the singularity of memory.
    real(wp), intent(in) :: width
    type(hill_path_type), intent(inout) :: path
    real(wp), intent(out) :: turn
    logical, intent(out) :: made
    complex(wp), allocatable :: change(:)
    logical, allocatable :: marked(:)
    real(wp), allocatable :: widths(:)
    integer :: last, pass

    turn = 0.0_wp
    do pass = 1, max_passes
      call changes(hill, divided, relaxed, path, change, made)
      if (.not. made) return
      turn = sum(aimag(change))
      widths = abs(path%lambda(2:path%n) - path%lambda(:path%n - 1))
      call mark_intervals(widths, change, marked)
      ! The interval near the singularity of memory has a limited width.
      last = merge(path%n - 1, 1, hill%stride == 2)
      marked(last) = marked(last) .or. widths(last) > width
      if (.not. any(marked)) return
      call path%split(hill, system, marked, made)
      if (.not. made) return
    end do
    made = .false.
  end subroutine follow

  !> Which zeros to divide out, and whether also what memory leaves of the static stiffness. Near
  !! exponents of memory the determinant is singular, at the rate at which memory fades; what both
  !! do to it nearly cancels, and is nearly what they do to that stiffness. What changes least from
  !! node to node is taken.
  subroutine choose(hill, known, path, divided, relaxed)
    class(hill_determinant), intent(in) :: hill
    complex(wp), intent(in) :: known(:)
    type(hill_path_type), intent(in) :: path
    complex(wp), allocatable, intent(out) :: divided(:)
    logical, intent(out) :: relaxed
    logical :: kept(size(known)), also(size(known)), beyond
    real(wp) :: least, with_memory

    relaxed = .false.
    if (.not. hill%remembers) then
      divided = known
      return
    end if
    call leave_in(hill, known, path, .false., kept, least)
    ! Of memory right of the line, which would ask for narrow intervals.
    beyond = any(may_be_of_memory(hill, known) .and. real(known) > path%line)
    if (least > quiet .or. beyond) then
      call leave_in(hill, known, path, .true., also, with_memory)
      relaxed = with_memory < least .or. (beyond .and. with_memory <= quiet)
      if (relaxed) kept = also
    end if
    divided = pack(known, kept)
  end subroutine choose

  !> Of exponents that may be of memory those that are left in, and the sum of all changes then.
  subroutine leave_in(hill, known, path, relaxed, kept, least)
    class(hill_determinant), intent(in) :: hill
    complex(wp), intent(in) :: known(:)
    type(hill_path_type), intent(in) :: path
    logical, intent(in) :: relaxed
    logical, intent(out) :: kept(:)
    real(wp), intent(out) :: least
    complex(wp), allocatable :: change(:)
    integer :: k
    logical :: made, left(size(known))

    left = may_be_of_memory(hill, known)
    kept = .true.
    least = huge(least)
    call changes(hill, known, relaxed, path, change, made)
    if (.not. made) return
    least = sum(abs(change))
    do k = 1, size(known)
      if (.not. left(k)) cycle
      kept(k) = .false.
      call changes(hill, pack(known, kept), relaxed, path, change, made)
      if (made) kept(k) = sum(abs(change)) >= least
      if (.not. made) kept(k) = .true.
      if (.not. kept(k)) least = sum(abs(change))
    end do
  end subroutine leave_in

  !> Exponents of memory decay and are real, or at i d/2 where orders are odd; others may be there.
  elemental logical function may_be_of_memory(hill, exponent)
    class(hill_determinant), intent(in) :: hill
    complex(wp), intent(in) :: exponent
    may_be_of_memory = hill%remembers .and. real(exponent) <= 0.0_wp .and. &
                       .not. abs(aimag(exponent) - merge(0.5_wp*hill%period, 0.0_wp, &
                                                         hill%stride == 2)) > 0.0_wp
  end function may_be_of_memory

  !> By how much the logarithm of what is left of D changes from node to node.
  subroutine changes(hill, known, relaxed, path, change, made)
    class(hill_determinant), intent(in) :: hill
    complex(wp), intent(in) :: known(:)
    !> Divided by what memory leaves of the static stiffness.
    logical, intent(in) :: relaxed
    type(hill_path_type), intent(in) :: path
    complex(wp), allocatable, intent(out) :: change(:)
    !> Not where D is 0 or no number.
    logical, intent(out) :: made
    type(gap_list) :: gaps
    complex(wp) :: left(path%n)
    integer :: i

    allocate (change(path%n - 1))
    call new_gaps(gaps, known, hill%period)
    left = path%value
    do i = 1, path%n
      if (relaxed .and. abs(path%ratio(i)) > 0.0_wp) left(i) = left(i)/path%ratio(i)
      call gaps%divide(path%lambda(i), left(i))
      made = abs(left(i)) > 0.0_wp .and. abs(left(i)) <= huge(1.0_wp)
      if (.not. made) return
    end do
    change = plain_logarithm(left(2:)/left(:path%n - 1))
  end subroutine changes

  ! Selection of intervals to halve on a path along which the determinant is followed.

  !> Mark intervals that are not quiet, intervals next to these unless they are narrower, and
  !! intervals that are too wide compared with an adjacent one.
  pure subroutine mark_intervals(width, change, marked)
    !> For each interval: its width, and ln of the ratio of the determinant at its ends.
    real(wp), intent(in) :: width(:)
    complex(wp), intent(in) :: change(:)
    logical, allocatable, intent(out) :: marked(:)
    logical :: loud(size(change))
    integer :: n

    n = size(change)
    loud = abs(aimag(change)) > largest_turn .or. abs(real(change)) > largest_ratio
    allocate (marked(n), source=loud)
    if (n == 1) return
    marked(2:) = marked(2:) .or. nearby(width(2:), width(:n - 1), loud(:n - 1))
    marked(:n - 1) = marked(:n - 1) .or. nearby(width(:n - 1), width(2:), loud(2:))
  end subroutine mark_intervals

  elemental logical function nearby(width, next, loud)
    real(wp), intent(in) :: width, next
    logical, intent(in) :: loud
    nearby = width > grading*next .or. (loud .and. grading*width > next)
  end function nearby

end module viscovib_hill_count
