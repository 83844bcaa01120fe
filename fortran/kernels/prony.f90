!> Sum of exponentials R(t) = sum_j w_j exp(-r_j t): generalised Maxwell model.
module viscovib_prony
  use, intrinsic :: ieee_arithmetic, only: ieee_positive_inf, ieee_value
  use viscovib_checks, only: check_not_negative
  use viscovib_gauss_points, only: points_32, weights_32
  use viscovib_kernel, only: decay_nodes, kernel_type, shrinking, vanished
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: prony_kernel, new_prony

  type, extends(kernel_type) :: prony_kernel
    !> w_j >= 0 and r_j >= 0 (1/s), same size.
    real(wp), allocatable :: weights(:), rates(:)
  contains
    procedure :: transform
    procedure :: transform_slope
    procedure :: laplace
    procedure :: value
    procedure :: accumulated
    procedure :: integral
    procedure :: fading_rate
    procedure :: local_rules
    procedure :: exponentials
  end type prony_kernel

contains

  !> Checked constructor.
  subroutine new_prony(kernel, weights, rates, status)
    type(prony_kernel), intent(out) :: kernel
    real(wp), intent(in) :: weights(:), rates(:)
    type(status_type), intent(out) :: status
    integer :: j

    if (size(weights) /= size(rates)) then
      call fail(status, status_input_error, 'weights', 'weights and rates have ' &
                //show(size(weights))//' and '//show(size(rates))//' numbers: must match')
      return
    end if
    do j = 1, size(weights)
      call check_not_negative('weights (value '//show(j)//')', weights(j), status)
      if (status%failed()) exit
      call check_not_negative('rates (value '//show(j)//')', rates(j), status)
      if (status%failed()) exit
    end do
    kernel%weights = weights
    kernel%rates = rates
  end subroutine new_prony

  !> sum_j w_j/(r_j + i mu).
  subroutine transform(self, mu, cosine, sine)
    class(prony_kernel), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    real(wp), intent(out) :: cosine(:), sine(:)
    real(wp) :: factor
    integer :: i, j

    if (.not. (may_square(mu) .and. may_square(self%rates) .and. may_square(self%weights))) then
      call far_transform(self, mu, cosine, sine)
      return
    end if
    cosine = 0.0_wp
    sine = 0.0_wp
    do j = 1, size(self%weights)
      do i = 1, size(mu)
        factor = self%weights(j)/(self%rates(j)**2 + mu(i)**2)
        cosine(i) = cosine(i) + factor*self%rates(j)
        sine(i) = sine(i) + factor*mu(i)
      end do
    end do
  end subroutine transform

  !> True if squares of these numbers and their quotients neither overflow nor underflow.
  pure logical function may_square(x)
    real(wp), intent(in) :: x(:)
    real(wp), parameter :: largest = 1.0e100_wp
    may_square = all(abs(x) <= largest .and. (abs(x) >= 1.0_wp/largest .or. x == 0.0_wp))
  end function may_square

  !> The transform where squares would overflow: r_j and mu are scaled by the larger one.
  pure subroutine far_transform(self, mu, cosine, sine)
    class(prony_kernel), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    real(wp), intent(out) :: cosine(:), sine(:)
    real(wp) :: larger, a, b, scaled
    integer :: i, j

    cosine = 0.0_wp
    sine = 0.0_wp
    do j = 1, size(self%weights)
      if (self%weights(j) == 0.0_wp) cycle
      do i = 1, size(mu)
        larger = max(self%rates(j), abs(mu(i)))
        a = self%rates(j)/larger
        b = mu(i)/larger
        scaled = self%weights(j)/larger/(a**2 + b**2)
        cosine(i) = cosine(i) + scaled*a
        sine(i) = sine(i) + scaled*b
      end do
    end do
  end subroutine far_transform

  !> -i sum_j w_j/(r_j + i mu)^2.
  subroutine transform_slope(self, mu, transform, slope)
    class(prony_kernel), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    complex(wp), intent(in) :: transform(:)
    complex(wp), intent(out) :: slope(:)
    integer :: i
    do i = 1, size(transform)
      associate (over => 1.0_wp/cmplx(self%rates, mu(i), wp))
        slope(i) = cmplx(0.0_wp, -1.0_wp, wp)*sum(self%weights*over**2)
      end associate
    end do
  end subroutine transform_slope

  !> sum_j w_j/(r_j + s), poles at -r_j.
  subroutine laplace(self, s, transform)
    class(prony_kernel), intent(in) :: self
    complex(wp), intent(in) :: s(:)
    complex(wp), intent(out) :: transform(:)
    integer :: j
    transform = (0.0_wp, 0.0_wp)
    do j = 1, size(self%weights)
      transform = transform + self%weights(j)/(self%rates(j) + s)
    end do
  end subroutine laplace

  subroutine value(self, t, r)
    class(prony_kernel), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    integer :: j
    r = 0.0_wp
    do j = 1, size(self%weights)
      r = r + self%weights(j)*exp(-self%rates(j)*t)
    end do
  end subroutine value

  !> sum_j w_j (1 - exp(-r_j t))/r_j; w_j t for a rate of 0.
  subroutine accumulated(self, t, r)
    class(prony_kernel), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    integer :: j
    r = 0.0_wp
    do j = 1, size(self%weights)
      if (self%rates(j) > 0.0_wp) then
        r = r + self%weights(j)*(shrinking(self%rates(j)*t)/self%rates(j))
      else
        r = r + self%weights(j)*t
      end if
    end do
  end subroutine accumulated

  !> sum_j w_j/r_j.
  real(wp) function integral(self)
    class(prony_kernel), intent(in) :: self
    integer :: j
    integral = 0.0_wp
    do j = 1, size(self%weights)
      if (self%weights(j) == 0.0_wp) cycle
      if (self%rates(j) == 0.0_wp) then
        integral = ieee_value(integral, ieee_positive_inf)
        return
      end if
      integral = integral + self%weights(j)/self%rates(j)
    end do
  end function integral

  !> Slowest rate with a nonzero weight.
  pure real(wp) function fading_rate(self)
    class(prony_kernel), intent(in) :: self
    fading_rate = minval(self%rates, abs(self%weights) > 0.0_wp)
  end function fading_rate

  !> A rule for each term, over the part of [0, tau] where the term has not vanished.
  subroutine local_rules(self, tau, nodes, weights)
    class(prony_kernel), intent(in) :: self
    real(wp), intent(in) :: tau(:)
    real(wp), allocatable, intent(out) :: nodes(:, :), weights(:, :)
    real(wp) :: length
    integer :: i, j, first

    allocate (nodes(decay_nodes*size(self%rates), size(tau)))
    allocate (weights(size(nodes, 1), size(tau)))
    do i = 1, size(tau)
      do j = 1, size(self%rates)
        length = tau(i)
        if (self%rates(j)*length > vanished) length = vanished/self%rates(j)
        first = (j - 1)*decay_nodes
        nodes(first + 1:first + decay_nodes, i) = length*points_32
        weights(first + 1:first + decay_nodes, i) = &
          length*weights_32*self%weights(j)*exp(-self%rates(j)*length*points_32)
      end do
    end do
  end subroutine local_rules

  !> The terms of this kernel, exact at all times.
  subroutine exponentials(self, tolerance, t_min, t_max, weights, rates)
    class(prony_kernel), intent(in) :: self
    real(wp), intent(in) :: tolerance, t_min, t_max
    real(wp), allocatable, intent(out) :: weights(:), rates(:)
    associate (any_tolerance => tolerance, any_start => t_min, any_end => t_max)
      weights = self%weights
      rates = self%rates
    end associate
  end subroutine exponentials

end module viscovib_prony
