!> Exponents of a periodic solution that grow, counted by the argument principle.
!!
!! Hill's determinant D has no poles right of the imaginary axis, is periodic along
!! it, real at 0 and at half the period i d, and does not wind at large Re lambda.
!! Around the half strip |Im lambda| <= d/2, Re lambda >= 0, the sides along which it
!! is periodic cancel, and
!!
!!   number of zeros = -[arg D(i d/2) - arg D(0)]/pi.
!!
!! Zeros that are known are divided out, D/(1 - exp(2 pi (lambda_k - lambda)/d)), which has all
!! of these properties: what is left turns slowly, also where zeros lie next to the axis. Those
!! with positive real part count on their own; were one of them no zero, it would count as a
!! pole of what is left, so that the sum is right whatever is thought to be known.
!!
!! The logarithm of what is left must be seen to change little from node to node. Two zeros
!! next to the axis between the same two nodes turn it by 2 pi there, of which the nodes see
!! nothing. The modulus tells, beside them: x and y being their places in the interval, 0 to 1,
!! and w the width of the interval before, it changes there by the factor (1 + w/x)(1 + w/y),
!! and alike behind with 1 - x and 1 - y; with w >= 1/2 one of both is 4 or more. So an interval
!! counts when it and its neighbours are quiet, and none of them may be much narrower.
module viscovib_hill_count
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_constants, only: pi
  use viscovib_hill, only: hill_type
  use viscovib_hill_path, only: hill_path_type, new_hill_path
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  implicit none
  private

  public :: count_growing

  !> A quiet interval turns the argument by this at most, and changes the logarithm of the
  !! modulus by that: less than half of what two zeros unseen would do to a neighbour.
  real(wp), parameter :: largest_turn = 0.6_wp, largest_ratio = 0.6_wp
  !> An interval may be so many times as wide as its neighbours.
  real(wp), parameter :: grading = 2.01_wp
  integer, parameter :: max_passes = 60
  !> A count must be this near to an integer.
  real(wp), parameter :: margin = 0.2_wp
  !> Real parts that count as 0, in d.
  real(wp), parameter :: on_axis = 1.0e-13_wp

contains

  !> Exponents with positive real part in the strip |Im lambda| <= d/2; -1: unknown.
  subroutine count_growing(hill, system, known, n_growing, evaluations, path)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    !> Exponents found, both of conjugate pairs; NaN is passed over.
    complex(wp), intent(in) :: known(:)
    integer, intent(out) :: n_growing
    !> Determinants that it took.
    integer, intent(out) :: evaluations
    !> Nodes where the determinant is known; more may be added.
    type(hill_path_type), intent(inout), optional :: path
    type(hill_path_type) :: own

    n_growing = -1
    evaluations = 0
    if (.not. hill%ready) return
    if (present(path)) then
      evaluations = -path%n
      call count_along(hill, system, pack(known,.not. ieee_is_nan(real(known))), path, n_growing)
      evaluations = evaluations + path%n
    else
      call new_hill_path(own, hill, system)
      call count_along(hill, system, pack(known,.not. ieee_is_nan(real(known))), own, n_growing)
      evaluations = own%n
    end if
  end subroutine count_growing

  subroutine count_along(hill, system, known, path, n_growing)
    type(hill_type), intent(in) :: hill
    class(oscillator_type), intent(in) :: system
    complex(wp), intent(in) :: known(:)
    type(hill_path_type), intent(inout) :: path
    integer, intent(inout) :: n_growing
    complex(wp), allocatable :: change(:), divided(:)
    logical, allocatable :: marked(:)
    real(wp) :: counted
    integer :: i, pass
    logical :: made

    ! On the axis to rounding: who could tell.
    if (any(abs(real(known)) <= on_axis*hill%period)) return
    call choose(hill, known, path, divided)
    made = .false.
    do pass = 1, max_passes
      call changes(hill, divided, path, change, made)
      if (.not. made) return
      call mark(path, change, marked)
      made = .not. any(marked)
      if (made) exit
      call path%split(hill, system, marked, made)
      if (.not. made) return
    end do
    if (.not. made) return
    counted = -sum(aimag(change))/pi
    if (.not. abs(counted - nint(counted)) <= margin) return
    i = nint(counted) + count(real(divided) > 0.0_wp)
    if (i >= 0) n_growing = i
  end subroutine count_along

  !> Which zeros to divide out. Beside exponents of memory the determinant is singular, at the
  !! rate at which memory fades; what both do to it nearly cancels. They are left in where less
  !! is changed then from node to node.
  pure subroutine choose(hill, known, path, divided)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: known(:)
    type(hill_path_type), intent(in) :: path
    complex(wp), allocatable, intent(out) :: divided(:)
    complex(wp), allocatable :: change(:)
    complex(wp) :: place
    logical :: kept(size(known)), made
    real(wp) :: least
    integer :: k

    place = cmplx(0.0_wp, merge(0.5_wp*hill%period, 0.0_wp, hill%stride == 2), wp)
    kept = .true.
    divided = known
    call changes(hill, known, path, change, made)
    if (.not. made) return
    least = sum(abs(change))
    do k = 1, size(known)
      if (real(known(k)) > 0.0_wp .or. abs(aimag(known(k) - place)) > 0.0_wp) cycle
      kept(k) = .false.
      call changes(hill, pack(known, kept), path, change, made)
      if (made) kept(k) = sum(abs(change)) >= least
      if (.not. made) kept(k) = .true.
      if (.not. kept(k)) least = sum(abs(change))
    end do
    divided = pack(known, kept)
  end subroutine choose

  !> By how much the logarithm of what is left of D changes from node to node.
  pure subroutine changes(hill, known, path, change, made)
    type(hill_type), intent(in) :: hill
    complex(wp), intent(in) :: known(:)
    type(hill_path_type), intent(in) :: path
    complex(wp), allocatable, intent(out) :: change(:)
    !> Not where D is 0 or no number.
    logical, intent(out) :: made
    complex(wp) :: left(path%n), multipliers(size(known)), z
    integer :: i, k

    allocate (change(path%n - 1))
    multipliers = exp(2.0_wp*pi/hill%period*known)
    do i = 1, path%n
      left(i) = path%value(i)
      z = exp(-2.0_wp*pi/hill%period*path%lambda(i))
      do k = 1, size(known)
        left(i) = left(i)/(1.0_wp - multipliers(k)*z)
      end do
      made = abs(left(i)) > 0.0_wp .and. abs(left(i)) <= huge(1.0_wp)
      if (.not. made) return
    end do
    change = log(left(2:)/left(:path%n - 1))
  end subroutine changes

  !> Intervals to be split: those that are not quiet, their neighbours unless these are
  !! narrower, and those that are too wide beside a neighbour.
  pure subroutine mark(path, change, marked)
    type(hill_path_type), intent(in) :: path
    complex(wp), intent(in) :: change(:)
    logical, allocatable, intent(out) :: marked(:)
    logical :: loud(size(change))
    real(wp) :: width(size(change))
    integer :: n

    n = size(change)
    loud = abs(aimag(change)) > largest_turn .or. abs(real(change)) > largest_ratio
    allocate (marked(n), source=loud)
    if (n == 1) return
    width = abs(path%lambda(2:n + 1) - path%lambda(:n))
    marked(2:) = marked(2:) .or. beside(width(2:), width(:n - 1), loud(:n - 1))
    marked(:n - 1) = marked(:n - 1) .or. beside(width(:n - 1), width(2:), loud(2:))
  end subroutine mark

  elemental logical function beside(width, next, loud)
    real(wp), intent(in) :: width, next
    logical, intent(in) :: loud
    beside = width > grading*next .or. (loud .and. grading*width > next)
  end function beside

end module viscovib_hill_count
