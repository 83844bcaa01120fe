!> How many orders a curve of free motions needs: what those left out would change, and when
!! to follow it again with more.
!!
!! A point with its orders left out as 0 nearly solves the equations of a larger set. The
!! first step of Newton's method there, at right angles to the curve, is what all orders
!! would change, but for its square and for orders beyond the larger set, in which a
!! geometric fall leaves a small part. The step takes the derivatives of the larger set, so
!! that it sees a mode that an order left out resonates with.
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

  !> Orders that are chosen: at first, and at most.
  integer, parameter, public :: first_chosen = 9, highest_chosen = 63

  !> Orders left out that judge those kept, at least.
  integer, parameter :: fewest_beyond = 4

  !> Orders to a highest one, added until they are enough or in vain.
  type :: order_search
    integer :: highest = first_chosen, most = first_chosen
    real(wp) :: tolerance = 0.0_wp
    !> Whether forces have kinks: orders then fall off as a power only, and beat.
    logical :: kinked = .false.
    real(wp), private :: last = huge(1.0_wp)
    integer, private :: vain = 0
    !> The highest of the orders that are the largest of a point.
    integer, private :: main_order = 1
  contains
    procedure :: look_at
    procedure :: judging_order
    procedure :: judge
    procedure, private :: more_wanted
  end type order_search

contains

  !> See which order is the largest of a point: where modes are in internal resonance that may be
  !! a high one, m, the others being its multiples at last. Under odd forces the next order that
  !! counts then lies 2 m further.
  pure subroutine look_at(self, orders, cosines, weights)
    class(order_search), intent(inout) :: self
    !> Orders of the mode's frequency, and the cosines, shape (size(orders), n_dof).
    integer, intent(in) :: orders(:)
    real(wp), intent(in) :: cosines(:, :)
    !> Of the coordinates, shape (n_dof).
    real(wp), intent(in) :: weights(:)
    integer :: k
    k = maxloc(matmul(cosines**2, weights), 1, orders > 0)
    if (k > 0) self%main_order = max(self%main_order, orders(k))
  end subroutine look_at

  !> The highest order of the set that checks the present one. At kinks, where orders fall off
  !! as k^-4, those of more than twice the highest make less than 1 % of those left out, and those
  !! next to the highest may vanish between two beats.
  pure integer function judging_order(self)
    class(order_search), intent(in) :: self
    judging_order = self%highest + max(fewest_beyond, 2*self%main_order, &
                                       merge(self%highest + 1, 0, self%kinked))
  end function judging_order

  !> What more orders would change of each point of a curve: of the motion relative to its
  !! size, in the norm of the curve's weights, or of the frequency, whichever is larger; and of the
  !! places of its folds. And whether to follow it again, with the orders to `highest`.
  subroutine judge(self, curve, x, at_folds, branch, again, cancel)
    class(order_search), intent(inout) :: self
    !> Of the larger set; its last unknown is the frequency.
    class(curve_type), intent(inout) :: curve
    !> Unknowns of the larger set at points and folds, those left out as 0, shapes (curve%n, n) and
    !! (curve%n, n_folds).
    real(wp), intent(in) :: x(:, :), at_folds(:, :)
    !> Its truncation, shape (n), is 1 where the larger set gives no information, 0 where not
    !! estimated, as the curve will be followed again or was given up.
    type(curve_branch_type), intent(inout) :: branch
    logical, intent(out) :: again
    !> May be set from elsewhere to give up.
    integer, intent(inout), optional :: cancel
    type(curve_step) :: newton
    real(wp) :: truncation, moved
    integer :: i, largest

    associate (n => branch%n_points)
      branch%truncation = [(0.0_wp, i=1, n)]
      again = .false.
      if (n == 0) return
      call new_curve_step(newton, curve)
      ! Where one point needs more orders, the others need not be judged.
      largest = maxloc([(sum(curve%weights*x(:, i)**2), i=1, n)], 1)
      call look(largest)
      if (needs(largest)) call self%more_wanted(branch%truncation(largest), again)
      if (again) return
      do i = 1, n
        if (present(cancel)) then
          if (is_set(cancel)) return
        end if
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

    !> Whether more orders bring a point nearer: what they change is neither small enough nor
    !! rounding.
    pure logical function needs(i)
      integer, intent(in) :: i
      needs = branch%truncation(i) > max(self%tolerance, branch%off(i))
    end function needs

    !> Between two points, as far as they are there; along p alone if there is one.
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

  end subroutine judge

  !> Whether to follow the curve again after the largest truncation of its points.
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

  !> The highest order that is chosen of a mode whose motions last some of its periods.
  pure integer function most_chosen(multiple)
    integer, intent(in) :: multiple
    most_chosen = min(highest_chosen, max_harmonics/multiple)
  end function most_chosen

  !> What a plan says of orders that are chosen.
  pure function chosen_text(first) result(text)
    !> Highest order at first.
    integer, intent(in) :: first
    character(len=:), allocatable :: text
    text = 'harmonics chosen to meet the tolerance, '//show(first)//' at first'
  end function chosen_text

end module viscovib_free_orders
