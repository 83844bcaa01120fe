!> The linear rest of a structure, as some of its coordinates see it:
!!
!!   H(s) = sum_m seen_m pushed_m^T/(squares_m + i losses_m + rates_m s + s^2)
!!          + sum_l left_l right_l^T/(s - poles_l) + flexibility + s flexibility_rate
!!
!! over real modes, which modal damping leaves alone, and over complex ones (each pole and its
!! conjugate), and over what modes left out would add (E^T D(s)^-1 E of the theory of structures,
!! docs/explanation). All loops run along the modes.
module viscovib_compliance
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: compliance_type, push_type

  !> Modes are filled up to a multiple of this by some that nothing sees or pushes.
  integer, parameter, public :: mode_lanes = 8
  !> What is taken for the rest of a difference that is exactly 0, relative.
  real(wp), parameter :: rounding = epsilon(1.0_wp), least = tiny(1.0_wp)**0.25_wp

  type :: compliance_type
    !> Coordinates seen.
    integer :: n_seen = 0
    !> Real modes: omega^2 (1/s^2), 2 zeta omega (1/s), loss factor times omega^2, which has a
    !! meaning above the real axis only (Im s > 0), shape (n); entries at the coordinates, shape
    !! (n, n_seen).
    real(wp), allocatable :: squares(:), rates(:), losses(:), seen(:, :), pushed(:, :)
    !> Complex modes, shape (n) (1/s), and (n, n_seen).
    complex(wp), allocatable :: poles(:), left(:, :), right(:, :)
    !> Of modes left out, shape (n_seen, n_seen).
    real(wp), allocatable :: flexibility(:, :), flexibility_rate(:, :)
    !> The limit of H(s)^-1 at s = 0, which is finite though H may be not (rigid bodies).
    real(wp), allocatable :: stiffness_at_rest(:, :)
    !> seen times pushed, shape (n, n_seen, n_seen).
    real(wp), allocatable, private :: products(:, :, :)
    logical, private :: symmetric = .false.
  contains
    procedure :: complete
    procedure :: evaluate
    procedure :: answer
    procedure :: least_loss
  end type compliance_type

  !> A force of one harmonic as the modes feel it.
  type :: push_type
    !> On real and complex modes, and by the flexibility: deflections of the coordinates.
    complex(wp), allocatable :: modes(:), poles(:), flexible(:), flexible_rate(:)
  end type push_type

contains

  !> Fill up the modes, and multiply what is multiplied at every frequency.
  pure subroutine complete(self)
    class(compliance_type), intent(inout) :: self
    integer :: a, b, n, lacking

    n = size(self%squares)
    lacking = modulo(-n, mode_lanes)
    self%n_seen = size(self%seen, 2)
    self%squares = [self%squares, spread(1.0_wp, 1, lacking)]
    self%rates = [self%rates, spread(1.0_wp, 1, lacking)]
    self%losses = [self%losses, spread(0.0_wp, 1, lacking)]
    self%seen = filled(self%seen, lacking)
    self%pushed = filled(self%pushed, lacking)
    allocate (self%products(n + lacking, self%n_seen, self%n_seen))
    do b = 1, self%n_seen
      do a = 1, self%n_seen
        self%products(:, a, b) = self%seen(:, a)*self%pushed(:, b)
      end do
    end do
    self%symmetric = all(abs(self%seen - self%pushed) <= 0.0_wp)
  end subroutine complete

  pure function filled(rows, lacking) result(whole)
    real(wp), intent(in) :: rows(:, :)
    integer, intent(in) :: lacking
    real(wp) :: whole(size(rows, 1) + lacking, size(rows, 2))
    whole = 0.0_wp
    whole(:size(rows, 1), :) = rows
  end function filled

  !> H(s), and its derivative by s.
  pure subroutine evaluate(self, s, h, slope)
    class(compliance_type), intent(in) :: self
    complex(wp), intent(in) :: s
    !> Shape (n_seen, n_seen).
    complex(wp), intent(out) :: h(:, :)
    complex(wp), intent(out), optional :: slope(:, :)
    real(wp), dimension(size(self%squares)) :: re, im, slope_re, slope_im
    complex(wp) :: t(size(self%poles))
    integer :: a, b, n

    n = size(self%squares)
    call resonances(n, self%squares, self%rates, self%losses, s, re, im)
    if (present(slope)) call slopes(n, self%rates, s, re, im, slope_re, slope_im)
    if (size(t) > 0) t = 1.0_wp/apart(s, self%poles)
    do b = 1, self%n_seen
      do a = merge(b, 1, self%symmetric), self%n_seen
        h(a, b) = total(n, self%products(:, a, b), re, im)
        if (present(slope)) slope(a, b) = total(n, self%products(:, a, b), slope_re, slope_im)
      end do
    end do
    if (self%symmetric) then
      do b = 2, self%n_seen
        h(:b - 1, b) = h(b, :b - 1)
        if (present(slope)) slope(:b - 1, b) = slope(b, :b - 1)
      end do
    end if
    do b = 1, self%n_seen
      if (size(t) > 0) then
        do a = 1, self%n_seen
          h(a, b) = h(a, b) + sum(self%left(:, a)*self%right(:, b)*t)
          if (present(slope)) then
            slope(a, b) = slope(a, b) - sum(self%left(:, a)*self%right(:, b)*t**2)
          end if
        end do
      end if
      h(:, b) = h(:, b) + self%flexibility(:, b) + s*self%flexibility_rate(:, b)
      if (present(slope)) slope(:, b) = slope(:, b) + self%flexibility_rate(:, b)
    end do
  end subroutine evaluate

  !> Deflections under a push, and their derivatives by s.
  pure subroutine answer(self, s, push, y, slope)
    class(compliance_type), intent(in) :: self
    complex(wp), intent(in) :: s
    type(push_type), intent(in) :: push
    !> Shape (n_seen).
    complex(wp), intent(out) :: y(:)
    complex(wp), intent(out), optional :: slope(:)
    real(wp), dimension(size(self%squares)) :: re, im, slope_re, slope_im
    complex(wp) :: t(size(self%poles))
    integer :: a, n

    n = size(self%squares)
    call resonances(n, self%squares, self%rates, self%losses, s, re, im)
    if (present(slope)) then
      call slopes(n, self%rates, s, re, im, slope_re, slope_im)
      call multiply(n, push%modes, slope_re, slope_im)
    end if
    call multiply(n, push%modes, re, im)
    if (size(t) > 0) t = 1.0_wp/apart(s, self%poles)
    do a = 1, self%n_seen
      y(a) = total(n, self%seen(:, a), re, im) + push%flexible(a) + s*push%flexible_rate(a)
      if (size(t) > 0) y(a) = y(a) + sum(self%left(:, a)*push%poles*t)
      if (present(slope)) then
        slope(a) = total(n, self%seen(:, a), slope_re, slope_im) + push%flexible_rate(a)
        if (size(t) > 0) slope(a) = slope(a) - sum(self%left(:, a)*push%poles*t**2)
      end if
    end do
  end subroutine answer

  !> The smallest loss factor of all modes that oscillate: 2 zeta.
  pure real(wp) function least_loss(self) result(loss)
    class(compliance_type), intent(in) :: self
    integer :: i
    loss = huge(loss)
    do i = 1, size(self%squares)
      if (.not. self%squares(i) > 0.0_wp) cycle
      loss = min(loss, self%rates(i)/sqrt(self%squares(i)) + self%losses(i)/self%squares(i))
    end do
    do i = 1, size(self%poles)
      if (abs(self%poles(i)) > 0.0_wp) loss = min(loss, -2.0_wp*real(self%poles(i)) &
                                                  /abs(self%poles(i)))
    end do
    loss = max(loss, 0.0_wp)
  end function least_loss

  !> 1/(squares + i losses + rates s + s^2), real and imaginary part.
  pure subroutine resonances(n, squares, rates, losses, s, re, im)
    integer, intent(in) :: n
    real(wp), intent(in) :: squares(n), rates(n), losses(n)
    complex(wp), intent(in) :: s
    real(wp), intent(out) :: re(n), im(n)
    real(wp) :: x, y, size_of, by_s, on_axis, off_axis
    integer :: i

    by_s = real(s)
    on_axis = real(s)**2 - aimag(s)**2
    off_axis = 2.0_wp*real(s)*aimag(s)
    do i = 1, n
      x = squares(i) + rates(i)*by_s + on_axis
      y = losses(i) + rates(i)*aimag(s) + off_axis
      ! Without damping and in resonance what is left of the difference is rounding.
      x = x + merge(0.0_wp, rounding*abs(squares(i)) + least, abs(x) + abs(y) > 0.0_wp)
      size_of = 1.0_wp/(x*x + y*y)
      re(i) = x*size_of
      im(i) = -y*size_of
    end do
  end subroutine resonances

  !> Their derivatives by s: -(rates + 2 s) t^2.
  pure subroutine slopes(n, rates, s, re, im, slope_re, slope_im)
    integer, intent(in) :: n
    real(wp), intent(in) :: rates(n), re(n), im(n)
    complex(wp), intent(in) :: s
    real(wp), intent(out) :: slope_re(n), slope_im(n)
    real(wp) :: x, y, a
    integer :: i
    do i = 1, n
      x = re(i)*re(i) - im(i)*im(i)
      y = 2.0_wp*re(i)*im(i)
      a = rates(i) + 2.0_wp*real(s)
      slope_re(i) = -(a*x - 2.0_wp*aimag(s)*y)
      slope_im(i) = -(a*y + 2.0_wp*aimag(s)*x)
    end do
  end subroutine slopes

  !> Multiply by complex numbers, of which the last may lack.
  pure subroutine multiply(n, factors, re, im)
    integer, intent(in) :: n
    complex(wp), intent(in) :: factors(n)
    real(wp), intent(inout) :: re(n), im(n)
    real(wp) :: x
    integer :: i
    do i = 1, n
      x = real(factors(i))*re(i) - aimag(factors(i))*im(i)
      im(i) = real(factors(i))*im(i) + aimag(factors(i))*re(i)
      re(i) = x
    end do
  end subroutine multiply

  !> sum w (re + i im), lane by lane; n is a multiple of `mode_lanes`.
  pure complex(wp) function total(n, w, re, im)
    integer, intent(in) :: n
    real(wp), intent(in) :: w(n), re(n), im(n)
    real(wp) :: sum_re(mode_lanes), sum_im(mode_lanes)
    integer :: i, l
    sum_re = 0.0_wp
    sum_im = 0.0_wp
    do i = 0, n - 1, mode_lanes
      do l = 1, mode_lanes
        sum_re(l) = sum_re(l) + w(i + l)*re(i + l)
        sum_im(l) = sum_im(l) + w(i + l)*im(i + l)
      end do
    end do
    total = cmplx(sum(sum_re), sum(sum_im), wp)
  end function total

  !> s - pole, or rounding where that is 0.
  elemental complex(wp) function apart(s, pole)
    complex(wp), intent(in) :: s, pole
    apart = s - pole
    if (.not. abs(apart) > 0.0_wp) apart = rounding*abs(pole) + least
  end function apart

end module viscovib_compliance
