!> How many orders a curve of free motions needs: what those left out would change, and when
!! to follow it again with more.
!!
!! A point with its orders left out as 0 nearly solves the equations of a larger set. The
!! first step of Newton's method there, at right angles to the curve, is what all orders
!! would change, but for its square and for orders beyond the larger set, in which a
!! geometric fall leaves a small part. The step takes the derivatives of the larger set, so
!! that it sees a mode that an order left out resonates with.
module viscovib_free_orders
  use viscovib_block_factors, only: factorize_blocks
  use viscovib_curve, only: curve_type
  use viscovib_dense, only: factorize_padded, solve_padded
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
  !> Unknowns up to which whole vectors pay more than blocks.
  integer, parameter :: small = 64, vector = 8

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

  !> What a step of Newton's method works in.
  type :: newton_step
    integer :: rows = 0
    real(wp), allocatable :: matrix(:, :), r(:), slope(:), change(:)
    integer, allocatable :: pivots(:)
  contains
    procedure :: find
  end type newton_step

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

  !> The highest order of the set that judges the one looked at. Beside kinks, where orders fall off
  !! as k^-4, those of more than twice the highest make less than 1 % of those left out, and those
  !! next to the highest may vanish between two beats.
  pure integer function judging_order(self)
    class(order_search), intent(in) :: self
    judging_order = self%highest + max(fewest_beyond, 2*self%main_order, &
                                       merge(self%highest + 1, 0, self%kinked))
  end function judging_order

  !> What more orders would change of each point of a curve: of the motion relative to its
  !! size, in the norm of the curve's weights, or of the frequency, whichever is larger. And
  !! whether to follow it again, with the orders to `highest`.
  subroutine judge(self, curve, p, x, truncation, again, cancel)
    class(order_search), intent(inout) :: self
    !> Of the larger set; its last unknown is the frequency.
    class(curve_type), intent(inout) :: curve
    !> Points in the order followed, shape (n), and their unknowns, those left out as 0, shape
    !! (curve%n, n).
    real(wp), intent(in) :: p(:), x(:, :)
    !> Shape (n); 1 where the larger set tells nothing; 0 where not judged, as the curve will be
    !! followed again or was given up.
    real(wp), allocatable, intent(out) :: truncation(:)
    logical, intent(out) :: again
    !> May be set from elsewhere to give up.
    integer, intent(inout), optional :: cancel
    type(newton_step) :: newton
    integer :: i, largest

    allocate (truncation(size(p)), source=0.0_wp)
    again = .false.
    if (size(p) == 0) return
    call new_newton_step(newton, curve%n)
    ! Where one point needs more orders, the others need not be judged.
    largest = maxloc([(sum(curve%weights*x(:, i)**2), i=1, size(p))], 1)
    call newton%find(curve, p, x, largest, truncation(largest))
    if (truncation(largest) > self%tolerance) call self%more_wanted(truncation(largest), again)
    if (again) return
    do i = 1, size(p)
      if (present(cancel)) then
        if (is_set(cancel)) return
      end if
      if (i /= largest) call newton%find(curve, p, x, i, truncation(i))
    end do
    if (truncation(largest) <= self%tolerance) call self%more_wanted(maxval(truncation), again)
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

  subroutine new_newton_step(newton, n)
    type(newton_step), intent(out) :: newton
    integer, intent(in) :: n
    newton%rows = n + 1
    if (n < small) newton%rows = (n/vector + 1)*vector
    allocate (newton%matrix(newton%rows, n + 1), source=0.0_wp)
    allocate (newton%pivots(n + 1), newton%r(n), newton%slope(n), newton%change(n + 1))
  end subroutine new_newton_step

  !> The truncation of a point.
  subroutine find(self, curve, p, x, i, truncation)
    class(newton_step), intent(inout) :: self
    class(curve_type), intent(inout) :: curve
    real(wp), intent(in) :: p(:), x(:, :)
    integer, intent(in) :: i
    real(wp), intent(out) :: truncation
    real(wp) :: size_x
    integer :: before, next, n
    logical :: inside, singular

    n = curve%n
    truncation = 1.0_wp
    call curve%equations(x(:, i), p(i), self%r, self%matrix, self%slope, inside)
    size_x = sum(curve%weights*x(:, i)**2)
    if (.not. (inside .and. size_x > 0.0_wp)) return
    self%matrix(:n, n + 1) = self%slope
    ! Across the chord between neighbours.
    before = max(i - 1, 1)
    next = min(i + 1, size(p))
    self%matrix(n + 1, :n) = curve%weights*((x(:, next) - x(:, before))/size_x)
    self%matrix(n + 1, n + 1) = ((p(next) - p(before))/p(i))/p(i)
    if (size(p) == 1) self%matrix(n + 1, n + 1) = 1.0_wp/p(i)
    if (n < small) then
      call factorize_padded(self%rows, n + 1, self%matrix, self%pivots, singular)
    else
      call factorize_blocks(n + 1, self%matrix, self%pivots, singular)
    end if
    if (singular) return
    self%change(:n) = self%r
    self%change(n + 1) = 0.0_wp
    call solve_padded(self%rows, n + 1, self%matrix, self%pivots, self%change)
    truncation = max(norm2(sqrt(curve%weights)*self%change(:n))/sqrt(size_x), &
                     abs(self%change(n)/x(n, i)))
    ! No number either: nearly singular.
    if (.not. truncation <= 1.0_wp) truncation = 1.0_wp
  end subroutine find

end module viscovib_free_orders
