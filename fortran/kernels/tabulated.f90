!> A tabulated kernel: R(t_i), with exact transforms of its interpolant.
!!
!! linear: straight lines between points, R_1 before the first, 0 after the last. exponential:
!! log-linear between points (all R_i > 0), with the first and last rate continued outside.
!!
!! Each piece is integrated in closed form, including oscillations, without truncation. For |s|
!! t_n > 2, where the direct pieces cancel, the integral by parts is used:
!!   L(s) = (R(0) - R(t_n) exp(-s t_n) [linear] + integral R' exp(-s t) dt)/s.
module viscovib_tabulated
  use, intrinsic :: ieee_arithmetic, only: ieee_positive_inf, ieee_value
  use viscovib_checks, only: check_finite, check_increasing, check_not_negative
  use viscovib_constants, only: pi
  use viscovib_gauss_points, only: points_16, weights_16
  use viscovib_kernel, only: kernel_type, shrinking, vanished
  use viscovib_kinds, only: wp
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: tabulated_kernel, new_tabulated, unseen_integral

  integer, parameter, public :: interpolation_linear = 0, interpolation_exponential = 1

  type, extends(kernel_type) :: tabulated_kernel
    integer :: interpolation = interpolation_linear
    !> Knots from 0 on (s) and R there (1/s), shape (n).
    real(wp), allocatable :: times(:), values(:)
    !> Slope (linear) or decay rate (exponential) of each piece, shape (n-1).
    real(wp), allocatable, private :: slopes(:)
    !> Integral of R before the first time that the interpolant omits, estimated from the first
    !! decade of the table; +infinity if it is unbounded.
    real(wp) :: unseen = 0.0_wp
  contains
    procedure :: transform
    procedure :: transform_slope
    procedure :: laplace
    procedure :: value
    procedure :: accumulated
    procedure :: integral
    procedure :: fading_rate
    procedure :: local_rules
    procedure :: lag_rule
    procedure :: exponentials
    procedure, private :: laplace_at
    procedure, private :: tail_rate
    procedure, private :: piece_value
    procedure, private :: piece_integral
  end type tabulated_kernel

  !> Times up to this multiple of the first time are used for the fit.
  real(wp), parameter :: decade = 10.0_wp

contains

  !> Checked constructor; t_1 >= 0, at least 2 points.
  subroutine new_tabulated(kernel, times, values, interpolation, status)
    type(tabulated_kernel), intent(out) :: kernel
    real(wp), intent(in) :: times(:), values(:)
    integer, intent(in) :: interpolation
    type(status_type), intent(out) :: status
    integer :: n
    real(wp) :: start

    n = size(times)
    if (n < 2 .or. size(values) /= n) then
      call fail(status, status_input_error, 'times', 'times and values have '//show(n)//' and ' &
                //show(size(values))//' numbers: must match and be 2 or more')
      return
    end if
    call check_increasing('times', times, status)
    if (status%failed()) return
    call check_not_negative('times (value 1)', times(1), status)
    if (status%failed()) return
    call check_finite('values', values, status)
    if (status%failed()) return
    kernel%interpolation = interpolation
    kernel%times = times
    kernel%values = values
    kernel%unseen = unseen_start(times, values, interpolation == interpolation_exponential)
    select case (interpolation)
    case (interpolation_linear)
      start = values(1)
    case (interpolation_exponential)
      if (minval(values) <= 0.0_wp) then
        call fail(status, status_input_error, 'values', 'values (value '//show(minloc(values, 1)) &
                  //') = '//show(minval(values))//': must be greater than 0 for exponential ' &
                  //'interpolation')
        return
      end if
      call continue_to_zero(times, values, start, status)
      if (status%failed()) return
    case default
      call fail(status, status_input_error, 'interpolation', 'interpolation = ' &
                //show(interpolation)//': must be linear (0) or exponential (1)')
      return
    end select
    if (times(1) > 0.0_wp) then
      kernel%times = [0.0_wp, times]
      kernel%values = [start, values]
      n = n + 1
    end if
    kernel%smooth_until = kernel%times(2)
    associate (t => kernel%times, r => kernel%values)
      if (interpolation == interpolation_linear) then
        kernel%slopes = (r(2:) - r(:n - 1))/(t(2:) - t(:n - 1))
      else
        kernel%slopes = log_ratio(r(:n - 1), r(2:))/(t(2:) - t(:n - 1))
      end if
    end associate
  end subroutine new_tabulated

  !> R(0) extrapolated with the first rate, which is arbitrarily large for two close points with
  !! noise. Fails if it overflows or underflows, since it has no finite transform then.
  subroutine continue_to_zero(times, values, start, status)
    real(wp), intent(in) :: times(:), values(:)
    real(wp), intent(out) :: start
    type(status_type), intent(out) :: status
    real(wp) :: growth, height

    start = values(1)
    if (.not. times(1) > 0.0_wp) return
    ! Finite, since the times differ by at least a rounding error.
    growth = log_ratio(values(1), values(2))*(times(1)/(times(2) - times(1)))
    height = log(values(1)) + growth
    if (height > log(huge(start)) - 1.0_wp .or. height < log(tiny(start)) + 1.0_wp) then
      call fail(status, status_input_error, 'times', 'times (value 1) = '//show(times(1)) &
                //': the first rate, continued to 0, gives a value exp('//show(growth)//') times ' &
                //'the first one, out of the range of numbers: give a value at time 0, or first ' &
                //'values that change less')
      return
    end if
    ! Multiply by quarters, which neither overflow nor underflow.
    start = (values(1)*exp(0.25_wp*growth)**2)*exp(0.25_wp*growth)**2
  end subroutine continue_to_zero

  !> Integral that a kernel omits: for a table, before its first time; otherwise 0.
  pure real(wp) function unseen_integral(kernel)
    class(kernel_type), intent(in) :: kernel
    unseen_integral = 0.0_wp
    select type (kernel)
    type is (tabulated_kernel)
      unseen_integral = kernel%unseen
    end select
  end function unseen_integral

  subroutine transform(self, mu, cosine, sine)
    class(tabulated_kernel), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    real(wp), intent(out) :: cosine(:), sine(:)
    complex(wp) :: z
    integer :: i

    do i = 1, size(mu)
      z = self%laplace_at(cmplx(0.0_wp, mu(i), wp))
      cosine(i) = real(z)
      sine(i) = -aimag(z)
    end do
  end subroutine transform

  !> Derivative by Cauchy's integral over a circle, where the transform of a table is smooth. The
  !! error of the n-point trapezoidal rule is the Taylor term of order n.
  subroutine transform_slope(self, mu, transform, slope)
    class(tabulated_kernel), intent(in) :: self
    real(wp), intent(in) :: mu(:)
    complex(wp), intent(in) :: transform(:)
    complex(wp), intent(out) :: slope(:)
    integer, parameter :: n = 16
    complex(wp) :: ray
    real(wp) :: radius
    integer :: i, k
    slope = (0.0_wp, 0.0_wp)
    do i = 1, size(mu)
      radius = min(0.1_wp*abs(mu(i)), 0.3_wp/self%times(size(self%times)))
      do k = 1, n
        ray = exp(cmplx(0.0_wp, 2.0_wp*pi*k/n, wp))
        slope(i) = slope(i) + (self%laplace_at(cmplx(0.0_wp, mu(i), wp) + radius*ray) &
                               - transform(i))/(n*radius*ray)
      end do
    end do
    slope = slope*(0.0_wp, 1.0_wp)
  end subroutine transform_slope

  subroutine laplace(self, s, transform)
    class(tabulated_kernel), intent(in) :: self
    complex(wp), intent(in) :: s(:)
    complex(wp), intent(out) :: transform(:)
    integer :: i
    do i = 1, size(s)
      transform(i) = self%laplace_at(s(i))
    end do
  end subroutine laplace

  complex(wp) function laplace_at(self, s)
    class(tabulated_kernel), intent(in) :: self
    complex(wp), intent(in) :: s
    complex(wp) :: wave, piece, z, direct, parts
    real(wp) :: h
    integer :: i, n
    logical :: by_parts, linear

    n = size(self%times)
    linear = self%interpolation == interpolation_linear
    by_parts = abs(s)*self%times(n) > 2.0_wp
    direct = (0.0_wp, 0.0_wp)
    parts = cmplx(self%values(1), 0.0_wp, wp)
    do i = 1, n - 1
      h = self%times(i + 1) - self%times(i)
      wave = h*exp(-s*self%times(i))
      if (linear) then
        z = s*h
        piece = wave*mean_wave(z)
        parts = parts + self%slopes(i)*piece
        if (.not. by_parts) direct = direct + self%values(i)*piece &
                                     + (self%values(i + 1) - self%values(i))*wave*mean_ramp(z)
      else
        piece = self%values(i)*wave*mean_wave((s + self%slopes(i))*h)
        parts = parts - self%slopes(i)*piece
        direct = direct + piece
      end if
    end do
    wave = self%values(n)*exp(-s*self%times(n))
    if (linear) then
      parts = parts - wave
    else
      piece = wave/(s + self%tail_rate())
      parts = parts - self%tail_rate()*piece
      direct = direct + piece
    end if
    if (by_parts) direct = parts/s
    laplace_at = direct
  end function laplace_at

  !> integral_0^1 exp(-z u) du = (1 - exp(-z))/z.
  pure complex(wp) function mean_wave(z)
    complex(wp), intent(in) :: z
    integer :: n
    if (abs(z) > 0.5_wp) then
      mean_wave = (1.0_wp - exp(-z))/z
    else
      mean_wave = 1.0_wp
      do n = 16, 2, -1
        mean_wave = 1.0_wp - mean_wave*z/n
      end do
    end if
  end function mean_wave

  !> integral_0^1 u exp(-z u) du = (1 - (1+z) exp(-z))/z^2.
  pure complex(wp) function mean_ramp(z)
    complex(wp), intent(in) :: z
    complex(wp) :: term
    integer :: n
    if (abs(z) > 0.5_wp) then
      mean_ramp = (1.0_wp - (1.0_wp + z)*exp(-z))/z**2
    else
      mean_ramp = 0.5_wp
      term = 1.0_wp
      do n = 1, 16
        term = -term*z/n
        mean_ramp = mean_ramp + term/(n + 2)
      end do
    end if
  end function mean_ramp

  subroutine value(self, t, r)
    class(tabulated_kernel), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    integer :: i, j, n

    n = size(self%times)
    do i = 1, size(t)
      j = piece_of(self%times(2:n - 1), t(i))
      if (self%interpolation == interpolation_linear) then
        r(i) = self%values(j) + self%slopes(j)*(t(i) - self%times(j))
        if (t(i) > self%times(n)) r(i) = 0.0_wp
      else
        r(i) = self%values(j)*exp(-self%slopes(j)*(t(i) - self%times(j)))
      end if
    end do
  end subroutine value

  !> One plus the number of inner knots (ascending) up to t.
  pure integer function piece_of(knots, t) result(j)
    real(wp), intent(in) :: knots(:), t
    integer :: above, middle
    j = 1
    above = size(knots) + 1
    do while (j < above)
      middle = (j + above)/2
      if (knots(middle) <= t) then
        j = middle + 1
      else
        above = middle
      end if
    end do
  end function piece_of

  !> Sum of whole pieces, and the part of the piece that contains t.
  subroutine accumulated(self, t, r)
    class(tabulated_kernel), intent(in) :: self
    real(wp), intent(in) :: t(:)
    real(wp), intent(out) :: r(:)
    real(wp) :: whole(size(self%times))
    integer :: i, j, n

    n = size(self%times)
    whole(1) = 0.0_wp
    do j = 1, n - 1
      whole(j + 1) = whole(j) + self%piece_integral(j, self%times(j + 1))
    end do
    do i = 1, size(t)
      j = piece_of(self%times(2:n), t(i))
      r(i) = whole(j)
      if (j < n .or. self%interpolation /= interpolation_linear) then
        r(i) = r(i) + self%piece_integral(j, t(i))
      end if
    end do
  end subroutine accumulated

  !> Integral of piece k from its start to t; the last piece has no end.
  elemental real(wp) function piece_integral(self, k, t)
    class(tabulated_kernel), intent(in) :: self
    integer, intent(in) :: k
    real(wp), intent(in) :: t
    real(wp) :: h, decay
    integer :: j

    j = min(k, size(self%slopes))
    h = t - self%times(k)
    if (self%interpolation == interpolation_linear) then
      piece_integral = h*(self%values(k) + 0.5_wp*self%slopes(j)*h)
    else
      decay = self%slopes(j)*h
      if (abs(decay) < tiny(decay)) then
        piece_integral = self%values(k)*h
      else
        piece_integral = self%values(k)*h*(shrinking(decay)/decay)
      end if
    end if
  end function piece_integral

  !> +infinity if the last piece of an exponential interpolant does not decay.
  real(wp) function integral(self)
    class(tabulated_kernel), intent(in) :: self
    if (self%interpolation == interpolation_exponential .and. self%tail_rate() <= 0.0_wp) then
      integral = ieee_value(integral, ieee_positive_inf)
    else
      integral = real(self%laplace_at((0.0_wp, 0.0_wp)))
    end if
  end function integral

  !> Rate of the last two points, whose exponential continues; linear interpolants end.
  pure real(wp) function fading_rate(self)
    class(tabulated_kernel), intent(in) :: self
    fading_rate = huge(1.0_wp)
    if (self%interpolation == interpolation_exponential) fading_rate = self%tail_rate()
  end function fading_rate

  pure real(wp) function tail_rate(self)
    class(tabulated_kernel), intent(in) :: self
    tail_rate = self%slopes(size(self%slopes))
  end function tail_rate

  !> A Gauss panel for each piece of the interpolant.
  subroutine lag_rule(self, from, to, nodes, weights)
    class(tabulated_kernel), intent(in) :: self
    real(wp), intent(in) :: from, to
    real(wp), allocatable, intent(out) :: nodes(:), weights(:)
    real(wp) :: left, right
    integer :: k, n

    allocate (nodes(0), weights(0))
    n = size(self%times)
    do k = 1, n
      left = max(from, self%times(k))
      if (k < n) then
        right = min(to, self%times(k + 1))
      else
        right = to
        if (self%interpolation == interpolation_linear) exit
        ! No nodes where R has vanished.
        if (self%tail_rate() > 0.0_wp) right = min(to, left + vanished/self%tail_rate())
      end if
      if (.not. right > left) cycle
      nodes = [nodes, left + (right - left)*points_16]
      weights = [weights, (right - left)*weights_16 &
                 *self%piece_value(k, left + (right - left)*points_16)]
    end do
  end subroutine lag_rule

  !> R on piece k at t.
  elemental real(wp) function piece_value(self, k, t)
    class(tabulated_kernel), intent(in) :: self
    integer, intent(in) :: k
    real(wp), intent(in) :: t
    integer :: j
    j = min(k, size(self%slopes))
    if (self%interpolation == interpolation_linear) then
      piece_value = self%values(j) + self%slopes(j)*(t - self%times(j))
    else
      piece_value = self%values(j)*exp(-self%slopes(j)*(t - self%times(j)))
    end if
  end function piece_value

  subroutine local_rules(self, tau, nodes, weights)
    class(tabulated_kernel), intent(in) :: self
    real(wp), intent(in) :: tau(:)
    real(wp), allocatable, intent(out) :: nodes(:, :), weights(:, :)
    real(wp), allocatable :: x(:), w(:)
    integer :: i

    call self%lag_rule(0.0_wp, maxval(tau), x, w)
    allocate (nodes(size(x), size(tau)), weights(size(x), size(tau)))
    nodes = 0.0_wp
    weights = 0.0_wp
    do i = 1, size(tau)
      call self%lag_rule(0.0_wp, tau(i), x, w)
      nodes(:size(x), i) = x
      weights(:size(x), i) = w
    end do
  end subroutine local_rules

  !> None: a piecewise linear function is not a sum of exponentials.
  subroutine exponentials(self, tolerance, t_min, t_max, weights, rates)
    class(tabulated_kernel), intent(in) :: self
    real(wp), intent(in) :: tolerance, t_min, t_max
    real(wp), allocatable, intent(out) :: weights(:), rates(:)
    associate (any_kernel => self%interpolation, any_tolerance => tolerance, &
               any_start => t_min, any_end => t_max)
      allocate (weights(0), rates(0))
    end associate
  end subroutine exponentials

  ! Behavior of a tabulated kernel before its first time.

  !> log(a/b) for positive a and b, accurate to rounding. For similar a and b the difference a - b
  !! is exact, but the quotient a/b is not. Otherwise a last rate of 1e-3, and the integral, would
  !! lose three digits.
  elemental real(wp) function log_ratio(a, b)
    real(wp), intent(in) :: a, b
    if (a <= 2.0_wp*b .and. b <= 2.0_wp*a) then
      log_ratio = 2.0_wp*atanh((a - b)/(a + b))
    else if (abs(exponent(a) - exponent(b)) > 1000) then
      log_ratio = log(a) - log(b)  ! a/b overflows or underflows
    else
      log_ratio = log(a/b)
    end if
  end function log_ratio

  !> Integral before the first time, extrapolated as c t^p exp(-q t), minus the integral of the
  !! interpolant. This is the part that a table of a singular kernel omits. For R = A t^(alpha-1)
  !! the integral before t_1 is t_1 R(t_1)/alpha.
  pure real(wp) function unseen_start(t, r, exponential)
    real(wp), intent(in) :: t(:), r(:)
    !> The interpolant before the first time: true: an exponential; false: a constant.
    logical, intent(in) :: exponential
    real(wp) :: power, rate, before, known
    integer :: n

    unseen_start = 0.0_wp
    if (size(t) < 3) return
    if (t(1) <= 0.0_wp) return
    n = max(3, count(t <= decade*t(1)))
    if (any(r(:n) <= 0.0_wp)) return
    call fit_start(t(:n), r(:n), power, rate)
    before = ieee_value(before, ieee_positive_inf)
    if (power > -1.0_wp) before = r(1)*t(1)*mean_start(power, rate*t(1))
    known = r(1)*t(1)
    if (exponential) then
      known = known*mean_growth(max(log_ratio(r(1), r(2)), 0.0_wp)*(t(1)/(t(2) - t(1))))
    end if
    unseen_start = max(before - known, 0.0_wp)
  end function unseen_start

  !> Fit p and q of c t^p exp(-q t) to log R, with p <= 0 <= q. p is set to 0 unless it is below 0
  !! by twice its standard error, which follows from the scatter of the table.
  pure subroutine fit_start(t, r, power, rate)
    real(wp), intent(in) :: t(:), r(:)
    real(wp), intent(out) :: power, rate
    real(wp), dimension(size(t)) :: by_power, by_rate, y
    real(wp) :: pp, pq, qq, scatter
    integer :: n
    logical :: alike

    n = size(t)
    by_power = centred(log_ratio(t, spread(t(1), 1, n)))
    by_rate = centred(-t/t(1))
    y = centred(log_ratio(r, spread(r(1), 1, n)))
    pp = dot_product(by_power, by_power)
    pq = dot_product(by_power, by_rate)
    qq = dot_product(by_rate, by_rate)
    power = (dot_product(by_power, y)*qq - dot_product(by_rate, y)*pq)/(pp*qq - pq**2)
    rate = (dot_product(by_rate, y) - power*pq)/qq
    scatter = (pp - pq**2/qq)*max(n - 3, 1)
    if (rate < 0.0_wp) then
      rate = 0.0_wp
      power = dot_product(by_power, y)/pp
      scatter = pp*(n - 2)
    end if
    scatter = sqrt(sum((y - power*by_power - rate*by_rate)**2)/scatter)
    ! Three points always fit: use the better one-parameter fit.
    alike = n == 3 .and. dot_product(by_rate, y)**2*pp > dot_product(by_power, y)**2*qq
    if (power > -2.0_wp*scatter .or. alike) then
      power = 0.0_wp
      rate = max(dot_product(by_rate, y)/qq, 0.0_wp)
    end if
    rate = rate/t(1)
  end subroutine fit_start

  !> Subtract the mean.
  pure function centred(x) result(y)
    real(wp), intent(in) :: x(:)
    real(wp) :: y(size(x))
    y = x - sum(x)/size(x)
  end function centred

  !> integral_0^1 u^p exp(z (1 - u)) du, p > -1, by midpoints in u^(p + 1) (bounded integrand).
  pure real(wp) function mean_start(p, z)
    real(wp), intent(in) :: p, z
    integer, parameter :: n = 200
    real(wp) :: u(n)
    integer :: i
    u = [((i - 0.5_wp)/n, i=1, n)]**(1.0_wp/(1.0_wp + p))
    mean_start = sum(exp(min(z*(1.0_wp - u), 700.0_wp)))/(n*(1.0_wp + p))
  end function mean_start

  !> integral_0^1 exp(z u) du for real z >= 0; `huge` if it overflows.
  pure real(wp) function mean_growth(z)
    real(wp), intent(in) :: z
    if (z > 700.0_wp) then
      mean_growth = huge(z)
    else if (z > 1.0_wp) then
      mean_growth = (exp(z) - 1.0_wp)/z
    else
      mean_growth = mean_start(0.0_wp, z)
    end if
  end function mean_growth

end module viscovib_tabulated
