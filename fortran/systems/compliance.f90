! Optimize: -O2 -fvect-cost-model=dynamic
!> Compliance of the linear subsystem of a structure at some coordinates:
!!
!!   H(s) = sum_m seen_m pushed_m^T/(squares_m + i losses_m + rates_m s + s^2)
!!          + sum_l left_l right_l^T/(s - poles_l) + flexibility + s flexibility_rate.
!!
!! The first sum is over real modes, which modal damping leaves uncoupled; the second is over
!! complex modes (each pole and its conjugate). The flexibility replaces omitted modes (E^T D(s)^-1
!! E of the theory of structures, docs/explanation). All loops run over modes. If the poles of a
!! mode are further from 0 than |s|,
!!
!!   1/(a + b s + s^2) = sum_j c_j s^j,   c_0 = 1/a,   a c_j = -b c_(j-1) - c_(j-2),
!!
!! so all these modes together are one polynomial and only few modes are summed individually.
module viscovib_compliance
  use viscovib_kinds, only: wp
  use viscovib_mode_sums, only: add_polynomial, apart, block, degree, least, mode_lanes, &
    multiply, nearest_pole, resonances, rounding, slopes, total
  implicit none
  private

  public :: compliance_type, push_type

  !> Modes whose poles exceed this multiple of |s| form one polynomial, if they fill at least a
  !! block. The truncation error is far^-(degree + 1).
  real(wp), parameter :: far = 4.0_wp
  !> Largest number of coordinates for such polynomials.
  integer, parameter :: most_seen = 12
  !> Largest loss factor of a lightly damped mode.
  real(wp), parameter :: light = 1.0e-2_wp

  type :: compliance_type
    !> Number of coordinates.
    integer :: n_seen = 0
    !> Number of real modes, without padding.
    integer :: n_modes = 0
    !> Real modes: omega^2 (1/s^2), 2 zeta omega (1/s), loss factor times omega^2 (valid for Im
    !! s > 0 only), shape (n); output and input vectors, shape (n, n_seen).
    real(wp), allocatable :: squares(:), rates(:), losses(:), seen(:, :), pushed(:, :)
    !> Complex modes: poles (1/s), shape (n), and vectors, shape (n, n_seen).
    complex(wp), allocatable :: poles(:), left(:, :), right(:, :)
    !> Contribution of omitted modes, shape (n_seen, n_seen).
    real(wp), allocatable :: flexibility(:, :), flexibility_rate(:, :)
    !> Limit of H(s)^-1 at s = 0, which is finite even if H is not (rigid bodies).
    real(wp), allocatable :: stiffness_at_rest(:, :)
    !> seen times pushed, shape (n, n_seen, n_seen).
    real(wp), allocatable, private :: products(:, :, :)
    logical, private :: symmetric = .false.
    !> True if a mode is lightly damped.
    logical :: has_light = .false.
    !> Numbers of modes summed individually, largest |s| of each level, and the polynomials of the
    !! other modes in s/reach, shape (0:degree, n_seen, n_seen, number of levels).
    integer, allocatable, private :: kept(:)
    real(wp), allocatable, private :: reach(:), tails(:, :, :, :)
  contains
    procedure :: complete
    procedure :: complete_push
    procedure :: evaluate
    procedure :: on_axis
    procedure :: answer
    procedure :: least_loss
    procedure, private :: level_for
  end type compliance_type

  !> A force of one harmonic in modal coordinates.
  type :: push_type
    !> Real and complex modal forces, and the deflections due to the flexibility.
    complex(wp), allocatable :: modes(:), poles(:), flexible(:), flexible_rate(:)
    !> Polynomials of modes not summed individually, shape (0:degree, n_seen, number of levels).
    complex(wp), allocatable, private :: tails(:, :, :)
  end type push_type

contains

  !> Pad the modes, and compute products that do not depend on frequency.
  pure subroutine complete(self)
    class(compliance_type), intent(inout) :: self
    integer :: a, b, n, lacking

    n = size(self%squares)
    self%n_modes = n
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
    self%has_light = any(self%rates(:n)*sqrt(abs(self%squares(:n))) + self%losses(:n) &
                         <= light*abs(self%squares(:n)))
    call add_levels(self)
  end subroutine complete

  pure function filled(rows, lacking) result(whole)
    real(wp), intent(in) :: rows(:, :)
    integer, intent(in) :: lacking
    real(wp) :: whole(size(rows, 1) + lacking, size(rows, 2))
    whole = 0.0_wp
    whole(:size(rows, 1), :) = rows
  end function filled

  !> Compute the levels: numbers of modes, doubled each time, and polynomials of the other modes.
  pure subroutine add_levels(self)
    type(compliance_type), intent(inout) :: self
    real(wp) :: nearest(self%n_modes)
    integer :: i, n, a, b

    self%kept = [integer ::]
    self%reach = [real(wp) ::]
    ! With a loss factor there is no such series about 0. For many coordinates it takes too long.
    if (.not. any(abs(self%losses) > 0.0_wp) .and. self%n_seen <= most_seen) then
      do i = 1, self%n_modes
        nearest(i) = nearest_pole(self%squares(i), self%rates(i))
      end do
      n = block/2
      do while (n + block <= self%n_modes)
        self%kept = [self%kept, n]
        self%reach = [self%reach, minval(nearest(n + 1:))/far]
        n = 2*n
      end do
    end if
    allocate (self%tails(0:degree, self%n_seen, self%n_seen, size(self%kept)))
    if (size(self%kept) == 0) return
    do b = 1, self%n_seen
      do a = 1, self%n_seen
        self%tails(:, a, b, :) = tails_of(self, self%products(:, a, b))
      end do
    end do
  end subroutine add_levels

  !> Coefficients of (s/reach)^j of the modes beyond those of each level, weighted.
  pure function tails_of(self, weights) result(c)
    class(compliance_type), intent(in) :: self
    real(wp), intent(in) :: weights(:)
    real(wp) :: c(0:degree, size(self%kept))
    real(wp) :: before(mode_lanes), now(mode_lanes), next(mode_lanes), rate(mode_lanes), &
                square(mode_lanes), ratio
    integer :: i, j, last, level

    c = 0.0_wp
    last = size(self%squares)
    do level = size(self%kept), 1, -1
      if (.not. self%reach(level) > 0.0_wp) return
      if (level < size(self%kept)) then
        ratio = self%reach(level)/self%reach(level + 1)
        c(:, level) = c(:, level + 1)*[(ratio**j, j=0, degree)]
      end if
      do i = self%kept(level), last - 1, mode_lanes
        before = 0.0_wp
        now = 1.0_wp/self%squares(i + 1:i + mode_lanes)
        rate = self%rates(i + 1:i + mode_lanes)*self%reach(level)*now
        square = self%reach(level)*(self%reach(level)*now)
        now = now*weights(i + 1:i + mode_lanes)
        do j = 0, degree
          c(j, level) = c(j, level) + sum(now)
          next = -(rate*now + square*before)
          before = now
          now = next
        end do
      end do
      last = self%kept(level)
    end do
  end function tails_of

  !> Pad a push, and compute its polynomials.
  pure subroutine complete_push(self, push)
    class(compliance_type), intent(in) :: self
    type(push_type), intent(inout) :: push
    integer :: a, n

    n = size(self%squares)
    push%modes = [push%modes, spread((0.0_wp, 0.0_wp), 1, n - size(push%modes))]
    allocate (push%tails(0:degree, self%n_seen, size(self%kept)), source=(0.0_wp, 0.0_wp))
    if (size(self%kept) == 0) return
    if (.not. any(abs(push%modes) > 0.0_wp)) return
    do a = 1, self%n_seen
      push%tails(:, a, :) = cmplx(tails_of(self, self%seen(:, a)*real(push%modes)), &
                                  tails_of(self, self%seen(:, a)*aimag(push%modes)), wp)
    end do
  end subroutine complete_push

  !> The level with the fewest modes that is valid at s; 0: all modes are needed.
  pure integer function level_for(self, s) result(level)
    class(compliance_type), intent(in) :: self
    complex(wp), intent(in) :: s
    integer :: i
    level = 0
    do i = 1, size(self%kept)
      if (abs(s) > self%reach(i)) cycle
      level = i
      return
    end do
  end function level_for

  !> H(s), and its derivative by s.
  pure subroutine evaluate(self, s, h, slope, without)
    class(compliance_type), intent(in) :: self
    complex(wp), intent(in) :: s
    !> Shape (n_seen, n_seen).
    complex(wp), intent(out) :: h(:, :)
    complex(wp), intent(out), optional :: slope(:, :)
    !> Real modes near a resonance at s, which are left out.
    integer, intent(in), optional :: without(:)
    real(wp), dimension(block) :: re, im, slope_re, slope_im
    complex(wp) :: t, bend, value, by_s
    integer :: a, b, i, first, n, last, level

    level = self%level_for(s)
    last = size(self%squares)
    if (level > 0) last = self%kept(level)
    do b = 1, self%n_seen
      do a = 1, self%n_seen
        h(a, b) = self%flexibility(a, b) + s*self%flexibility_rate(a, b)
        if (present(slope)) slope(a, b) = self%flexibility_rate(a, b)
      end do
    end do
    do first = 1, last, block
      n = min(block, last - first + 1)
      call resonances(n, self%squares(first), self%rates(first), self%losses(first), s, re, im)
      if (present(without)) then
        do i = 1, size(without)
          if (without(i) < first .or. without(i) >= first + n) cycle
          re(without(i) - first + 1) = 0.0_wp
          im(without(i) - first + 1) = 0.0_wp
        end do
      end if
      if (present(slope)) call slopes(n, self%rates(first), s, re, im, slope_re, slope_im)
      do b = 1, self%n_seen
        do a = merge(b, 1, self%symmetric), self%n_seen
          h(a, b) = h(a, b) + total(n, self%products(first, a, b), re, im)
          if (present(slope)) slope(a, b) = slope(a, b) + total(n, self%products(first, a, b), &
                                                                slope_re, slope_im)
        end do
      end do
    end do
    if (level > 0) then
      do b = 1, self%n_seen
        do a = merge(b, 1, self%symmetric), self%n_seen
          call add_polynomial(self%tails(:, a, b, level), s/self%reach(level), value, by_s)
          h(a, b) = h(a, b) + value
          if (present(slope)) slope(a, b) = slope(a, b) + by_s/self%reach(level)
        end do
      end do
    end if
    if (self%symmetric) then
      do b = 2, self%n_seen
        do a = 1, b - 1
          h(a, b) = h(b, a)
          if (present(slope)) slope(a, b) = slope(b, a)
        end do
      end do
    end if
    do i = 1, size(self%poles)
      t = 1.0_wp/apart(s, self%poles(i))
      bend = -t**2
      do b = 1, self%n_seen
        do a = 1, self%n_seen
          h(a, b) = h(a, b) + self%left(i, a)*self%right(i, b)*t
          if (present(slope)) slope(a, b) = slope(a, b) + self%left(i, a)*self%right(i, b)*bend
        end do
      end do
    end do
  end subroutine evaluate

  !> H(i mu) at several frequencies, and its derivative by mu.
  pure subroutine on_axis(self, mu, h, slope)
    class(compliance_type), intent(in) :: self
    !> Shape (n).
    real(wp), intent(in) :: mu(:)
    !> Shape (n_seen, n_seen, n).
    complex(wp), intent(out) :: h(:, :, :)
    complex(wp), intent(out), optional :: slope(:, :, :)
    integer :: first, last, k

    if (self%n_seen == 1 .and. size(self%poles) == 0) then
      do first = 1, size(mu), mode_lanes
        last = min(first + mode_lanes - 1, size(mu))
        if (present(slope)) then
          call one_on_axis(self, mu(first:last), h(1, 1, first:last), slope(1, 1, first:last))
        else
          call one_on_axis(self, mu(first:last), h(1, 1, first:last))
        end if
      end do
      return
    end if
    do k = 1, size(mu)
      if (present(slope)) then
        call self%evaluate(cmplx(0.0_wp, mu(k), wp), h(:, :, k), slope(:, :, k))
      else
        call self%evaluate(cmplx(0.0_wp, mu(k), wp), h(:, :, k))
      end if
    end do
    if (present(slope)) slope = (0.0_wp, 1.0_wp)*slope
  end subroutine on_axis

  !> The same for one coordinate without complex modes, vectorized over frequencies.
  pure subroutine one_on_axis(self, mu, h, slope)
    class(compliance_type), intent(in) :: self
    !> At most `mode_lanes` frequencies.
    real(wp), intent(in) :: mu(:)
    complex(wp), intent(out) :: h(:)
    complex(wp), intent(out), optional :: slope(:)
    real(wp), dimension(mode_lanes) :: at, minus, x, y, re, im, sum_re, sum_im, by_re, by_im, &
                                       inverse
    complex(wp) :: value, by_s
    integer :: i, l, level, last

    at = mu(size(mu))
    at(:size(mu)) = mu
    minus = -at**2
    level = self%level_for(cmplx(0.0_wp, maxval(at), wp))
    last = size(self%squares)
    if (level > 0) last = self%kept(level)
    sum_re = 0.0_wp
    sum_im = 0.0_wp
    by_re = 0.0_wp
    by_im = 0.0_wp
    do i = 1, last
      do l = 1, mode_lanes
        x(l) = self%squares(i) + minus(l)
        y(l) = self%losses(i) + self%rates(i)*at(l)
        x(l) = x(l) + merge(0.0_wp, rounding*abs(self%squares(i)) + least, &
                            abs(x(l)) + abs(y(l)) > 0.0_wp)
        inverse(l) = 1.0_wp/(x(l)*x(l) + y(l)*y(l))
        re(l) = x(l)*inverse(l)
        im(l) = -y(l)*inverse(l)
        sum_re(l) = sum_re(l) + self%products(i, 1, 1)*re(l)
        sum_im(l) = sum_im(l) + self%products(i, 1, 1)*im(l)
      end do
      if (.not. present(slope)) cycle
      ! -i (rate + 2 i mu) t^2
      do l = 1, mode_lanes
        x(l) = re(l)*re(l) - im(l)*im(l)
        y(l) = 2.0_wp*re(l)*im(l)
        by_re(l) = by_re(l) + self%products(i, 1, 1)*(2.0_wp*at(l)*x(l) + self%rates(i)*y(l))
        by_im(l) = by_im(l) + self%products(i, 1, 1)*(2.0_wp*at(l)*y(l) - self%rates(i)*x(l))
      end do
    end do
    do l = 1, size(mu)
      value = (0.0_wp, 0.0_wp)
      by_s = (0.0_wp, 0.0_wp)
      if (level > 0) call add_polynomial(self%tails(:, 1, 1, level), &
                                         cmplx(0.0_wp, at(l)/self%reach(level), wp), value, by_s)
      h(l) = cmplx(sum_re(l) + self%flexibility(1, 1), &
                   sum_im(l) + at(l)*self%flexibility_rate(1, 1), wp) + value
      if (.not. present(slope)) cycle
      slope(l) = cmplx(by_re(l), by_im(l) + self%flexibility_rate(1, 1), wp)
      if (level > 0) slope(l) = slope(l) + (0.0_wp, 1.0_wp)*by_s/self%reach(level)
    end do
  end subroutine one_on_axis

  !> Deflections due to a push, and their derivatives by s.
  pure subroutine answer(self, s, push, y, slope)
    class(compliance_type), intent(in) :: self
    complex(wp), intent(in) :: s
    type(push_type), intent(in) :: push
    !> Shape (n_seen).
    complex(wp), intent(out) :: y(:)
    complex(wp), intent(out), optional :: slope(:)
    real(wp), dimension(block) :: re, im, slope_re, slope_im
    complex(wp) :: t, value, by_s, more
    integer :: a, i, first, n, last, level

    level = self%level_for(s)
    last = size(self%squares)
    if (level > 0) last = self%kept(level)
    do a = 1, self%n_seen
      y(a) = push%flexible(a) + s*push%flexible_rate(a)
      if (present(slope)) slope(a) = push%flexible_rate(a)
    end do
    do first = 1, last, block
      n = min(block, last - first + 1)
      call resonances(n, self%squares(first), self%rates(first), self%losses(first), s, re, im)
      if (present(slope)) then
        call slopes(n, self%rates(first), s, re, im, slope_re, slope_im)
        call multiply(n, push%modes(first), slope_re, slope_im)
      end if
      call multiply(n, push%modes(first), re, im)
      do a = 1, self%n_seen
        y(a) = y(a) + total(n, self%seen(first, a), re, im)
        if (present(slope)) slope(a) = slope(a) + total(n, self%seen(first, a), slope_re, slope_im)
      end do
    end do
    if (level > 0) then
      do a = 1, self%n_seen
        call add_polynomial(real(push%tails(:, a, level)), s/self%reach(level), value, by_s)
        y(a) = y(a) + value
        if (present(slope)) slope(a) = slope(a) + by_s/self%reach(level)
        call add_polynomial(aimag(push%tails(:, a, level)), s/self%reach(level), value, by_s)
        y(a) = y(a) + (0.0_wp, 1.0_wp)*value
        if (present(slope)) slope(a) = slope(a) + (0.0_wp, 1.0_wp)*by_s/self%reach(level)
      end do
    end if
    do i = 1, size(self%poles)
      t = 1.0_wp/apart(s, self%poles(i))
      do a = 1, self%n_seen
        more = self%left(i, a)*push%poles(i)*t
        y(a) = y(a) + more
        if (present(slope)) slope(a) = slope(a) - more*t
      end do
    end do
  end subroutine answer

  !> Smallest loss factor 2 zeta of all oscillating modes.
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

end module viscovib_compliance
