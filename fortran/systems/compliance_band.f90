! Optimize: -O3
!> Compliance of a linear subsystem up to a given frequency, at a cost independent of the number of
!! modes above it.
!!
!! For a mode whose poles are further from 0 than |s|,
!!
!!   1/(a + b s + s^2) = sum_j c_j s^j,   c_0 = 1/a,   a c_j = -b c_(j-1) - c_(j-2),
!!
!! so all these modes together are one polynomial in s. Nearly rigid modes are kept separate: near
!! their poles H(s) has rank-1 parts that hide the other parts.
module viscovib_compliance_band
  use viscovib_compliance, only: compliance_type
  use viscovib_kinds, only: wp
  implicit none
  private

  public :: compliance_band, new_band

  !> Modes whose poles exceed this multiple of the largest |s| are part of the polynomial.
  real(wp), parameter :: beyond = 4.0_wp
  integer, parameter :: n_terms = 24
  !> Avoids division by zero at a pole.
  real(wp), parameter :: least = tiny(1.0_wp)
  !> Ratio of a band's radius to the requested radius, and smallest part of it that it serves.
  real(wp), parameter :: spare = 1.3_wp, least_part = 0.4_wp

  type :: compliance_band
    integer :: n_seen = 0
    !> Largest |s| (0: not set); modes with poles of modulus below `nearness` are nearly rigid.
    real(wp) :: radius = 0.0_wp, nearness = 0.0_wp
    !> Separate modes: squares, rates, shape (n); output and input vectors, shape (n, n_seen).
    real(wp), allocatable :: squares(:), rates(:), seen(:, :), pushed(:, :)
    !> Nearly rigid modes.
    real(wp), allocatable :: rigid_squares(:), rigid_rates(:), rigid_seen(:, :), rigid_pushed(:, :)
    !> Complex modes, and coefficients of the polynomial, shape (n_seen, n_seen, 0:n_terms).
    complex(wp), allocatable, private :: poles(:), left(:, :), right(:, :)
    real(wp), allocatable, private :: terms(:, :, :)
    logical, private :: has_terms = .false.
  contains
    procedure :: contains_all
    procedure :: serves
    procedure :: evaluate
  end type compliance_band

contains

  !> Band for |s| up to somewhat more than a radius.
  subroutine new_band(band, rest, radius, nearness)
    type(compliance_band), intent(out) :: band
    type(compliance_type), intent(in) :: rest
    !> rad/s.
    real(wp), intent(in) :: radius, nearness
    logical, dimension(size(rest%squares)) :: near, rigid, idle
    real(wp), dimension(size(rest%squares)) :: c, before, next
    real(wp) :: least, most, disc
    integer :: a, b, i, j

    band%radius = spare*radius
    band%nearness = nearness
    band%n_seen = size(rest%seen, 2)
    do i = 1, size(rest%squares)
      disc = 0.25_wp*rest%rates(i)**2 - rest%squares(i)
      most = sqrt(abs(rest%squares(i)))
      least = most
      if (disc > 0.0_wp) then
        most = 0.5_wp*abs(rest%rates(i)) + sqrt(disc)
        least = abs(rest%squares(i))/max(most, tiny(1.0_wp))
      end if
      idle(i) = .not. (any(abs(rest%seen(i, :)) > 0.0_wp) &
                       .and. any(abs(rest%pushed(i, :)) > 0.0_wp))
      rigid(i) = most < nearness
      near(i) = least < beyond*band%radius
    end do
    rigid = rigid .and. .not. idle
    near = near .and. .not. (rigid .or. idle)
    band%squares = pack(rest%squares, near)
    band%rates = pack(rest%rates, near)
    band%seen = rows_of(rest%seen, near)
    band%pushed = rows_of(rest%pushed, near)
    band%rigid_squares = pack(rest%squares, rigid)
    band%rigid_rates = pack(rest%rates, rigid)
    band%rigid_seen = rows_of(rest%seen, rigid)
    band%rigid_pushed = rows_of(rest%pushed, rigid)
    band%poles = rest%poles
    band%left = rest%left
    band%right = rest%right
    allocate (band%terms(band%n_seen, band%n_seen, 0:n_terms), source=0.0_wp)
    near = .not. (near .or. rigid .or. idle)
    band%has_terms = any(near)
    before = 0.0_wp
    c = 0.0_wp
    where (near) c = 1.0_wp/rest%squares
    do j = 0, n_terms
      do b = 1, band%n_seen
        do a = 1, band%n_seen
          band%terms(a, b, j) = sum(rest%seen(:, a)*rest%pushed(:, b)*c)
        end do
      end do
      next = 0.0_wp
      where (near) next = -(rest%rates*c + before)/rest%squares
      before = c
      c = next
    end do
    band%terms(:, :, 0) = band%terms(:, :, 0) + rest%flexibility
    band%terms(:, :, 1) = band%terms(:, :, 1) + rest%flexibility_rate
    band%has_terms = band%has_terms .or. any(abs(band%terms(:, :, :1)) > 0.0_wp)
  end subroutine new_band

  pure function rows_of(whole, kept) result(rows)
    real(wp), intent(in) :: whole(:, :)
    logical, intent(in) :: kept(:)
    real(wp) :: rows(count(kept), size(whole, 2))
    integer :: a
    do a = 1, size(whole, 2)
      rows(:, a) = pack(whole(:, a), kept)
    end do
  end function rows_of

  !> True if the band fits this radius and nearness and is not much larger than needed.
  pure logical function serves(self, radius, nearness)
    class(compliance_band), intent(in) :: self
    real(wp), intent(in) :: radius, nearness
    serves = radius <= self%radius .and. radius >= least_part*self%radius &
             .and. .not. abs(nearness - self%nearness) > 0.0_wp
  end function serves

  !> True if `evaluate` gives all of H at some s.
  pure logical function contains_all(self, s)
    class(compliance_band), intent(in) :: self
    complex(wp), intent(in) :: s(:)
    contains_all = self%radius > 0.0_wp
    if (contains_all) contains_all = size(self%rigid_squares) == 0 &
                                     .and. .not. any(abs(s) > self%radius)
  end function contains_all

  !> H(s) without the nearly rigid modes, at many s within the radius, vectorized over these.
  pure subroutine evaluate(self, s, h)
    class(compliance_band), intent(in) :: self
    !> Shape (n).
    complex(wp), intent(in) :: s(:)
    !> Shape (n, n_seen, n_seen).
    complex(wp), intent(out) :: h(:, :, :)
    real(wp), dimension(size(s), self%n_seen, self%n_seen) :: re, im
    real(wp), dimension(size(s)) :: x, y, mode_re, mode_im
    integer :: a, b, first, i, j, l

    x = real(s)
    y = aimag(s)
    re = 0.0_wp
    im = 0.0_wp
    do j = n_terms, merge(0, n_terms + 1, self%has_terms), -1
      do b = 1, self%n_seen
        do a = 1, self%n_seen
          call horner_step(size(s), self%terms(a, b, j), x, y, re(1, a, b), im(1, a, b))
        end do
      end do
    end do
    first = 1
    if (self%n_seen == 1) then
      do i = 1, size(self%squares) - 1, 2
        call two_resonances(size(s), self%squares(i:i + 1), self%rates(i:i + 1), &
                            self%seen(i:i + 1, 1)*self%pushed(i:i + 1, 1), x, y, re, im)
        first = i + 2
      end do
    end if
    do i = first, size(self%squares)
      call resonance(size(s), self%squares(i), self%rates(i), x, y, mode_re, mode_im)
      do b = 1, self%n_seen
        do a = 1, self%n_seen
          re(:, a, b) = re(:, a, b) + (self%seen(i, a)*self%pushed(i, b))*mode_re
          im(:, a, b) = im(:, a, b) + (self%seen(i, a)*self%pushed(i, b))*mode_im
        end do
      end do
    end do
    h = cmplx(re, im, wp)
    do l = 1, size(self%poles)
      do b = 1, self%n_seen
        do a = 1, self%n_seen
          h(:, a, b) = h(:, a, b) + self%left(l, a)*self%right(l, b)/(s - self%poles(l))
        end do
      end do
    end do
  end subroutine evaluate

  !> (re + i im)(x + i y) + c.
  pure subroutine horner_step(n, c, x, y, re, im)
    integer, intent(in) :: n
    real(wp), intent(in) :: c, x(n), y(n)
    real(wp), intent(inout) :: re(n), im(n)
    real(wp) :: before
    integer :: k
    do k = 1, n
      before = re(k)
      re(k) = before*x(k) - im(k)*y(k) + c
      im(k) = before*y(k) + im(k)*x(k)
    end do
  end subroutine horner_step

  !> 1/(square + rate s + s^2), s = x + i y, real and imaginary part.
  pure subroutine resonance(n, square, rate, x, y, re, im)
    integer, intent(in) :: n
    real(wp), intent(in) :: square, rate, x(n), y(n)
    real(wp), intent(out) :: re(n), im(n)
    real(wp) :: u, v, inverse
    integer :: k
    do k = 1, n
      u = square + rate*x(k) + (x(k)**2 - y(k)**2)
      v = rate*y(k) + 2.0_wp*x(k)*y(k)
      inverse = 1.0_wp/(u*u + v*v + least)
      re(k) = u*inverse
      im(k) = -v*inverse
    end do
  end subroutine resonance

  !> Add sum_i w_i/(square_i + rate_i s + s^2), i = 1, 2, with a single division.
  pure subroutine two_resonances(n, square, rate, w, x, y, re, im)
    integer, intent(in) :: n
    real(wp), intent(in) :: square(2), rate(2), w(2), x(n), y(n)
    real(wp), intent(inout) :: re(n), im(n)
    real(wp) :: u, v, a, b, c, d, e, f, inverse
    integer :: k
    do k = 1, n
      u = x(k)**2 - y(k)**2
      v = 2.0_wp*x(k)*y(k)
      a = square(1) + rate(1)*x(k) + u
      b = rate(1)*y(k) + v
      c = square(2) + rate(2)*x(k) + u
      d = rate(2)*y(k) + v
      e = a*c - b*d
      f = a*d + b*c
      inverse = 1.0_wp/(e*e + f*f + least)
      u = w(1)*c + w(2)*a
      v = w(1)*d + w(2)*b
      re(k) = re(k) + (u*e + v*f)*inverse
      im(k) = im(k) + (v*e - u*f)*inverse
    end do
  end subroutine two_resonances

end module viscovib_compliance_band
