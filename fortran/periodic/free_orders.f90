!> Number of harmonics of a curve of free motions: estimate of the truncation error, and decision to
!! follow the curve again with more harmonics.
!!
!! A point, extended by zeros, nearly solves the equations of a larger set. The first step of
!! Newton's method from there, orthogonal to the curve, estimates the effect of all omitted
!! harmonics, except for its square and for orders beyond the larger set, whose effect is small
!! under geometric decay. The step uses the derivatives of the larger set, so it includes a mode
!! that resonates with an omitted harmonic.
module viscovib_free_orders
  use viscovib_curve, only: curve_type
  use viscovib_curve_record, only: curve_branch_type
  use viscovib_curve_step, only: curve_step, new_curve_step
  use viscovib_kinds, only: wp
  use viscovib_limits, only: max_harmonics
  use viscovib_order_rules, only: better_bound, max_vain
  use viscovib_status, only: show
  use viscovib_stopping, only: is_set
  implicit none
  private

  public :: order_search, chosen_text, most_chosen

  !> Highest order if it is adapted: initial and largest value.
  integer, parameter, public :: first_chosen = 9, highest_chosen = 63

  !> Smallest number of additional orders for the estimate of the truncation error.
  integer, parameter :: fewest_beyond = 4

  !> Search of the highest order: increased until the tolerance is met or without progress.
  type :: order_search
    integer :: highest = first_chosen, most = first_chosen
    real(wp) :: tolerance = 0.0_wp
    !> True if forces have kinks: harmonics then decay only as a power of the order, and beat.
    logical :: kinked = .false.
    real(wp), private :: last = huge(1.0_wp)
    integer, private :: vain = 0
    !> Highest order that is the dominant harmonic of a point.
    integer, private :: main_order = 1
  contains
    procedure :: look_at
    procedure :: checking_order
    procedure :: check
    procedure, private :: more_wanted
  end type order_search

contains

  !> Record the dominant harmonic of a point. With an internal resonance of modes it may have a high
  !! order m; other harmonics are then multiples of m. Under odd forces the next significant
  !! harmonic is 2 m orders higher.
  pure subroutine look_at(self, orders, cosines, weights)
    class(order_search), intent(inout) :: self
    !> Orders of the mode's frequency, and the cosine coefficients, shape (size(orders), n_dof).
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: cosines(:, :)
    !> Weights of the coordinates, shape (n_dof).
    real(wp), intent(in) :: weights(:)
    integer :: k
    k = maxloc(matmul(cosines**2, weights), 1, orders > 0)
    if (k > 0) self%main_order = max(self%main_order, orders(k))
  end subroutine look_at

  !> The highest order of the set that checks the present one. With kinks, harmonics decay as k^-4:
  !! harmonics above twice the highest order are less than 1 % of the omitted ones, and those next
  !! to the highest order may vanish between two beats.
  pure integer function checking_order(self)
    class(order_search), intent(in) :: self
    checking_order = self%highest + max(fewest_beyond, 2*self%main_order, &
                                       merge(self%highest + 1, 0, self%kinked))
  end function checking_order

  !> Truncation error of each point of a curve: of the motion relative to its size, in the norm of
  !! the curve's weights, or of the frequency, whichever is larger; and of the parameters at folds.
  !! Also decides whether to follow the curve again, with orders up to `highest`.
  subroutine check(self, curve, x, at_folds, branch, again, cancel)
    class(order_search), intent(inout) :: self
    !> Curve of the larger set; its last unknown is the frequency.
    class(curve_type), intent(inout) :: curve
    !> Unknowns of the larger set at points and folds, extended by zeros, shapes (curve%n, n) and
    !! (curve%n, n_folds).
    real(wp), intent(in) :: x(:, :), at_folds(:, :)
    !> Its `truncation`, shape (n), is 1 if the larger set gives no information, and 0 if not
    !! estimated because the curve will be followed again or the computation was cancelled.
    type(curve_branch_type), intent(inout) :: branch
    logical, intent(out) :: again
    !> May be set by another thread to cancel the computation.
    integer, intent(inout), optional :: cancel
    type(curve_step) :: newton
    real(wp) :: truncation, moved
    integer :: i, largest

    associate (n => branch%n_points)
      branch%truncation = [(0.0_wp, i=1, n)]
      again = .false.
      if (n == 0) return
      call new_curve_step(newton, curve)
      ! If one point needs more orders, the other points need no estimate.
      largest = maxloc([(sum(curve%weights*x(:, i)**2), i=1, n)], 1)
      call look(largest)
      if (needs(largest)) call self%more_wanted(branch%truncation(largest), again)
      if (again) return
      do i = 1, n
        if (is_set(cancel)) return
        if (i /= largest) call look(i)
      end do
      i = maxloc(branch%truncation, 1, [(needs(i), i=1, n)])
      if (i > 0 .and. .not. needs(largest)) call self%more_wanted(branch%truncation(i), again)
      if (again) return
      associate (folds => branch%folds)
        do i = 1, folds%n
          call newton%find(curve, folds%p(i), at_folds(:, i), &
                           chord(folds%before(i), folds%before(i) + 1), truncation, moved)
          folds%error(i) = folds%error(i) + moved
        end do
      end associate
    end associate

  contains

    subroutine look(i)
      integer, intent(in) :: i
      real(wp) :: moved
      call newton%find(curve, branch%parameter(i), x(:, i), chord(i - 1, i + 1), &
                       branch%truncation(i), moved)
    end subroutine look

    !> True if more orders would improve a point: its truncation error exceeds the tolerance and the
    !! rounding error.
    pure logical function needs(i)
      integer, intent(in) :: i
      needs = branch%truncation(i) > max(self%tolerance, branch%off(i))
    end function needs

    !> Direction between two points, as far as they exist; along p if there is only one point.
    pure function chord(from, to) result(way)
      integer, intent(in) :: from, to
      real(wp) :: way(curve%n + 1)
      integer :: first, last
      first = max(from, 1)
      last = min(to, branch%n_points)
      way = [x(:, last) - x(:, first), branch%parameter(last) &
             - branch%parameter(first)]
      if (last == first) way(curve%n + 1) = branch%parameter(first)
    end function chord

  end subroutine check

  !> Decide whether to follow the curve again, from the largest truncation error of its points.
  subroutine more_wanted(self, truncation, again)
    class(order_search), intent(inout) :: self
    real(wp), intent(in) :: truncation
    logical, intent(out) :: again

    again = truncation > self%tolerance .and. self%highest < self%most
    if (.not. again) return
    if (truncation > 0.5_wp*self%last) self%vain = self%vain + 1
    again = self%vain < max_vain
    self%last = truncation
    if (.not. again) return
    self%highest = better_bound(self%highest, truncation, self%tolerance, 2*self%main_order, &
                                self%most)
    self%main_order = 1
  end subroutine more_wanted

  !> Upper limit of the orders of motions whose period is a multiple of the mode's.
  pure integer function most_chosen(multiple)
    integer, intent(in) :: multiple
    most_chosen = min(highest_chosen, max_harmonics/multiple)
  end function most_chosen

  !> Text of a plan about an adapted number of harmonics.
  pure function chosen_text(first) result(text)
    !> Initial highest order.
    integer, intent(in) :: first
    character(len=:), allocatable :: text
    text = 'harmonics chosen to meet the tolerance, '//show(first)//' at first'
  end function chosen_text

end module viscovib_free_orders
