!> What a kernel remembers of a motion that is known already: R*g at any times, of values g at the
!! points of panels that follow each other.
!!
!! On the panel of a time and on the one before it the kernel is integrated with the polynomials
!! through the points. Earlier panels are remembered by exponentials, or, of a kernel that is no
!! sum of these, by the same rules as the last ones.
module viscovib_convolution
  use viscovib_collocation, only: collocation_type
  use viscovib_exponential_history, only: exponential_moments
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_stopping, only: stop_wanted
  implicit none
  private

  public :: convolve

  !> Relative error of sums of exponentials; rules that are kept for times at the same places of
  !! panels.
  real(wp), parameter :: accurate = 1.0e-14_wp
  integer, parameter :: most_rules = 64

  !> Weights of the values at the points of a panel of this length, seen from a time `ahead` of its
  !! begin (`of_own`) or of its end.
  type :: rule_type
    real(wp) :: ahead = -1.0_wp, length = 0.0_wp
    logical :: of_own = .false.
    real(wp), allocatable :: weights(:)
  end type rule_type

  type :: rules_type
    type(rule_type) :: kept(most_rules)
    integer :: n = 0, next = 1, now = 1
  contains
    procedure :: find
  end type rules_type

contains

  !> R*g at times.
  subroutine convolve(kernel, table, ends, g, held, times, recalled)
    type(kernel_holder), intent(in) :: kernel
    type(collocation_type), intent(in) :: table
    !> Ends of the panels, shape (0:n), and g at the points of each, shape (0:s+1, n, m).
    real(wp), intent(in) :: ends(0:), g(0:, :, :)
    !> g before the first panel, shape (m); not 0 only where the kernel has an integral.
    real(wp), intent(in) :: held(:)
    !> Ascending, from ends(0) to ends(n).
    real(wp), intent(in) :: times(:)
    !> Shape (size(times), m).
    real(wp), intent(out) :: recalled(:, :)
    real(wp), allocatable :: terms(:), rates(:), state(:, :), moments(:, :), decay(:), own(:, :, :)
    type(rules_type) :: rules
    real(wp) :: length, moments_of
    integer :: c, i, n, p

    recalled = 0.0_wp
    n = ubound(ends, 1)
    if (n == 0 .or. size(times) == 0) return
    call kernel%exponentials(accurate, minval(ends(1:) - ends(:n - 1)), &
                             max(times(size(times)) - ends(0), 2.0_wp*(ends(1) - ends(0))), &
                             terms, rates)
    allocate (state(size(rates), size(held)), moments(size(rates), 0:table%s + 1), source=0.0_wp)
    allocate (decay(size(rates)))
    ! The values of a panel lie together.
    allocate (own(0:table%s + 1, size(held), n))
    do c = 1, size(held)
      own(:, c, :) = g(:, :, c)
    end do
    moments_of = 0.0_wp
    p = 1
    do i = 1, size(times)
      if (stop_wanted()) return
      do while (p < n)
        if (times(i) <= ends(p) + 4.0_wp*spacing(ends(p))) exit
        p = p + 1
        if (p < 3 .or. size(rates) == 0) cycle
        ! Two panels behind the present one is what exponentials stand for.
        length = ends(p - 2) - ends(p - 3)
        if (abs(length - moments_of) > 4.0_wp*spacing(ends(p))) then
          call exponential_moments(table, length*rates, moments)
          moments_of = length
        end if
        decay = exp(-min(length*rates, 700.0_wp))
        do c = 1, size(held)
          state(:, c) = decay*state(:, c) + length*matmul(moments, own(:, c, p - 2))
        end do
      end do
      call recall_at(i)
    end do

  contains

    !> What is remembered at one time.
    subroutine recall_at(i)
      integer, intent(in) :: i
      real(wp) :: ahead, near, found(size(held))
      integer :: c, first, k

      found = 0.0_wp
      near = 4.0_wp*spacing(times(i))
      ahead = times(i) - ends(p - 1)
      if (ahead > near) then
        call rules%find(kernel, table, ahead, ends(p) - ends(p - 1), .true., near)
        call add_panel(p, found)
      end if
      first = 1
      if (size(rates) > 0) first = max(p - 1, 1)
      do k = first, p - 1
        call rules%find(kernel, table, times(i) - ends(k), ends(k) - ends(k - 1), .false., near)
        call add_panel(k, found)
      end do
      if (p > 2 .and. size(rates) > 0) then
        decay = terms*exp(-min((times(i) - ends(p - 2))*rates, 700.0_wp))
        do c = 1, size(held)
          found(c) = found(c) + dot_product(decay, state(:, c))
        end do
      end if
      if (any(abs(held) > 0.0_wp)) then
        found = found + held*left_of(kernel, times(i) - ends(0), near)
      end if
      recalled(i, :) = found
    end subroutine recall_at

    !> Add the integral over a panel by the present rule.
    subroutine add_panel(k, found)
      integer, intent(in) :: k
      real(wp), intent(inout) :: found(:)
      integer :: c
      do c = 1, size(found)
        found(c) = found(c) + dot_product(rules%kept(rules%now)%weights, own(:, c, k))
      end do
    end subroutine add_panel

  end subroutine convolve

  !> The integral of a kernel from a lag on.
  real(wp) function left_of(kernel, lag, near) result(left)
    type(kernel_holder), intent(in) :: kernel
    real(wp), intent(in) :: lag, near
    real(wp) :: until(1)
    left = kernel%integral()
    if (lag <= near) return
    call kernel%kernel%accumulated([lag], until)
    left = left - kernel%factor*until(1)
  end function left_of

  !> The rule of a place, `now` of those kept.
  subroutine find(self, kernel, table, ahead, length, of_own, near)
    class(rules_type), intent(inout) :: self
    type(kernel_holder), intent(in) :: kernel
    type(collocation_type), intent(in) :: table
    !> Times that differ by `near` are the same.
    real(wp), intent(in) :: ahead, length, near
    logical, intent(in) :: of_own
    real(wp), allocatable :: nodes(:, :), own(:, :), sigma(:), w(:)
    integer :: k

    do k = 1, self%n
      self%now = k
      associate (rule => self%kept(k))
        if ((rule%of_own .eqv. of_own) .and. abs(rule%ahead - ahead) <= near &
            .and. abs(rule%length - length) <= near) return
      end associate
    end do
    self%now = self%next
    self%n = max(self%n, self%next)
    self%next = 1 + mod(self%next, most_rules)
    associate (rule => self%kept(self%now))
      rule%ahead = ahead
      rule%length = length
      rule%of_own = of_own
      rule%weights = 0.0_wp*table%points
      if (of_own) then
        call kernel%local_rules([ahead], nodes, own)
        sigma = nodes(:, 1)
        w = own(:, 1)
      else if (ahead > near) then
        call kernel%lag_rule(ahead, ahead + length, sigma, w)
      else
        call kernel%local_rules([length], nodes, own)
        sigma = nodes(:, 1)
        w = own(:, 1)
      end if
      do k = 1, size(sigma)
        if (of_own) then
          rule%weights = rule%weights + w(k)*table%basis((ahead - sigma(k))/length)
        else
          rule%weights = rule%weights + w(k)*table%basis((ahead + length - sigma(k))/length)
        end if
      end do
    end associate
  end subroutine find

end module viscovib_convolution
