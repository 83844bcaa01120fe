!> Behavior of a tabulated kernel before its first time.
module viscovib_table_start
  use, intrinsic :: ieee_arithmetic, only: ieee_positive_inf, ieee_value
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: log_ratio, unseen_start

  !> Times up to this multiple of the first time are used for the fit.
  real(wp), parameter :: decade = 10.0_wp

contains

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

end module viscovib_table_start
