! Optimize: -O3
!> Poles of a linear rest, as Hill's determinant of a condensed structure has them.
!!
!! Elements of stiffness J move a pole p of the section c b^T/(a + r s + s^2) by about
!! |b| |J| |c|/|2 p + r|, or by the root of |b| |J| |c| where two poles meet. Zeros of the
!! determinant next to poles that move little compared with their distance from the axis stay on
!! their side of it.
module viscovib_condensed_poles
  use viscovib_compliance, only: compliance_type
  use viscovib_constants, only: pi
  use viscovib_hill_determinant, only: gap, gap_list, into_strip, new_gaps
  use viscovib_kinds, only: wp
  use viscovib_sorting, only: order_of
  implicit none
  private

  public :: condensed_poles, new_poles, place_of

  !> Of the distance from the axis: how far poles may move that are let be, at most and at least,
  !! and all of them together.
  real(wp), parameter :: much = 0.1_wp, little = 0.02_wp, together = 1.5_wp
  !> Poles right of this, in d, growing ones and those without damping; ones that move less than
  !! the second are exponents.
  real(wp), parameter :: at_axis = 1.0e-9_wp, still = 1.0e-12_wp
  !> So many that decay most slowly are multiplied out in any case, if they are near enough to 0, in
  !! d; of rates as near as this part of the frequency the one of lower frequency.
  integer, parameter :: slow_ones = 2
  real(wp), parameter :: slow_range = 6.0_wp, slope = 1.0e-6_wp
  !> Rates beyond this leave the range of numbers, in d.
  real(wp), parameter :: largest_rate = 40.0_wp

  type :: condensed_poles
    !> Places of those multiplied out, with their conjugates, nearly rigid bodies apart.
    type(gap_list) :: multiplied
    !> All that are multiplied out, and others that grow.
    integer :: n_multiplied = 0, n_growing = 0
    !> Places of those that are exponents.
    complex(wp), allocatable :: exponents(:)
    !> Numbers of those multiplied out that are not below the real axis, the ones first that may
    !! move most.
    integer, allocatable :: order(:)
    !> Largest modulus of those that matter (rad/s).
    real(wp) :: fastest = 0.0_wp
    !> Not below the real axis (1/s), and whether the conjugate is another one.
    complex(wp), allocatable :: pole(:)
    logical, allocatable :: paired(:)
    !> Distance that two poles have from each other, or 1 for complex modes; parts seen and pushed,
    !! shape (n, n_seen); modulus of the pole, or of the larger one.
    real(wp), allocatable, private :: apart(:), seen(:, :), pushed(:, :), reaches(:)
    !> Poles that are not multiplied out.
    logical, allocatable, private :: let_be(:)
    complex(wp), allocatable, private :: rigid(:)
  contains
    procedure :: weigh
    procedure :: count_from
    procedure :: rigid_factor
  end type condensed_poles

contains

  subroutine new_poles(poles, rest)
    type(condensed_poles), intent(out) :: poles
    type(compliance_type), intent(in) :: rest
    real(wp) :: disc
    integer :: i, n, most

    most = 2*size(rest%squares) + size(rest%poles)
    allocate (poles%pole(most), poles%paired(most), poles%apart(most), poles%reaches(most), &
              poles%seen(most, size(rest%seen, 2)), poles%pushed(most, size(rest%seen, 2)))
    n = 0
    do i = 1, rest%n_modes
      disc = 0.25_wp*rest%rates(i)**2 - rest%squares(i)
      if (disc < 0.0_wp) then
        call append(cmplx(-0.5_wp*rest%rates(i), sqrt(-disc), wp), .true., 2.0_wp*sqrt(-disc))
      else
        call append(cmplx(larger(rest%rates(i), disc), 0.0_wp, wp), .false., 2.0_wp*sqrt(disc))
        call append(cmplx(smaller(rest%rates(i), rest%squares(i), disc), 0.0_wp, wp), .false., &
                    2.0_wp*sqrt(disc))
      end if
    end do
    do i = 1, size(rest%poles)
      if (aimag(rest%poles(i)) < 0.0_wp) cycle
      n = n + 1
      poles%pole(n) = rest%poles(i)
      poles%paired(n) = aimag(rest%poles(i)) > 0.0_wp
      poles%apart(n) = 1.0_wp
      poles%reaches(n) = huge(1.0_wp)
      poles%seen(n, :) = abs(rest%left(i, :))
      poles%pushed(n, :) = abs(rest%right(i, :))
    end do
    poles%pole = poles%pole(:n)
    poles%paired = poles%paired(:n)
    poles%apart = poles%apart(:n)
    poles%reaches = poles%reaches(:n)
    poles%seen = poles%seen(:n, :)
    poles%pushed = poles%pushed(:n, :)

  contains

    subroutine append(pole, paired, apart)
      complex(wp), intent(in) :: pole
      logical, intent(in) :: paired
      real(wp), intent(in) :: apart
      n = n + 1
      poles%pole(n) = pole
      poles%paired(n) = paired
      poles%apart(n) = apart
      poles%reaches(n) = abs(pole)
      if (.not. paired) poles%reaches(n) = abs(larger(rest%rates(i), disc))
      poles%seen(n, :) = abs(rest%seen(i, :))
      poles%pushed(n, :) = abs(rest%pushed(i, :))
    end subroutine append

  end subroutine new_poles

  !> Of two real poles the one further from 0, and the other one.
  pure real(wp) function larger(rate, disc)
    real(wp), intent(in) :: rate, disc
    larger = -(0.5_wp*rate + sign(sqrt(disc), rate))
  end function larger

  pure real(wp) function smaller(rate, square, disc)
    real(wp), intent(in) :: rate, square, disc
    smaller = larger(rate, disc)
    if (abs(smaller) > 0.0_wp) smaller = square/smaller
  end function smaller

  !> Which of them matter for a stiffness and a damping.
  subroutine weigh(self, stiffness, damping, period, stride, nearly_rigid, line, ready, all_poles)
    class(condensed_poles), intent(inout) :: self
    !> Largest local stiffness and damping, part by part.
    real(wp), intent(in) :: stiffness(:, :), damping(:, :)
    real(wp), intent(in) :: period
    integer, intent(in) :: stride
    !> Both poles of a section nearer to 0 than this are those of a rigid body (rad/s).
    real(wp), intent(in) :: nearly_rigid
    !> Exponents right of it are counted (1/s).
    real(wp), intent(in) :: line
    !> Not where poles are too far to the right.
    logical, intent(out) :: ready
    !> Multiply out all poles that elements move.
    logical, intent(in) :: all_poles
    real(wp), dimension(size(self%pole)) :: push, moved, weight
    logical, dimension(size(self%pole)) :: kept, rigid, near
    complex(wp) :: place, multiplied(2*size(self%pole))
    real(wp) :: least
    integer :: i, j, n
    ready = maxval(real(self%pole)) <= largest_rate*period
    if (.not. ready) return
    push = 0.0_wp
    do j = 1, size(stiffness, 2)
      do i = 1, size(stiffness, 1)
        push = push + (stiffness(i, j) + abs(self%pole)*damping(i, j)) &
               *self%pushed(:, i)*self%seen(:, j)
      end do
    end do
    moved = sqrt(push)
    where (self%apart > 0.0_wp) moved = min(moved, push/max(self%apart, tiny(1.0_wp)))
    weight = moved/max(abs(real(self%pole)), tiny(1.0_wp)**0.5_wp)
    least = much
    do while (least > little)
      if (sum(weight, weight <= least) <= together) exit
      least = 0.7_wp*least
    end do
    near = real(self%pole) > -at_axis*period
    rigid = self%reaches < nearly_rigid .and. sum(self%seen, 2) > 0.0_wp &
            .and. sum(self%pushed, 2) > 0.0_wp
    kept = weight > least .or. ((near .or. all_poles) .and. moved > still*period) .or. rigid
    self%fastest = maxval(abs(aimag(self%pole)), kept .and. (weight > much .or. near))
    self%fastest = max(self%fastest, 0.0_wp)
    do i = 1, slow_ones
      ! Of equal rates the lowest frequency.
      j = maxloc(real(self%pole) - slope*abs(self%pole), 1, moved > still*period .and. .not. kept &
                 .and. abs(self%pole) <= slow_range*period)
      if (j == 0) cycle
      kept(j) = .true.
      self%fastest = max(self%fastest, abs(aimag(self%pole(j))))
    end do
    self%n_multiplied = count(kept) + count(kept .and. self%paired)
    self%let_be = .not. kept
    call self%count_from(line)
    self%rigid = pack(self%pole, rigid)
    self%rigid = [self%rigid, conjg(pack(self%pole, rigid .and. self%paired))]
    if (allocated(self%exponents)) deallocate (self%exponents)
    near = .not. kept .and. moved <= still*period
    allocate (self%exponents(count(near) + count(near .and. self%paired)))
    n = 0
    j = 0
    do i = 1, size(kept)
      place = place_of(self%pole(i), period, stride)
      if (kept(i) .and. .not. rigid(i)) then
        n = n + 1
        multiplied(n) = place
        if (self%paired(i)) then
          n = n + 1
          multiplied(n) = conjg(place)
        end if
      else if (near(i)) then
        j = j + 1
        self%exponents(j) = place
        if (self%paired(i)) then
          j = j + 1
          self%exponents(j) = conjg(place)
        end if
      end if
    end do
    call new_gaps(self%multiplied, multiplied(:n), period)
    self%order = pack([(i, i=1, size(kept))], kept)
    self%order = self%order(order_of(-weight(self%order)))
  end subroutine weigh

  !> Exponents right of this line are counted (1/s).
  pure subroutine count_from(self, line)
    class(condensed_poles), intent(inout) :: self
    real(wp), intent(in) :: line
    self%n_growing = count(real(self%pole) > line .and. self%let_be) &
                     + count(real(self%pole) > line .and. self%paired .and. self%let_be)
  end subroutine count_from

  !> Of a pole s the exponent lambda = s, or s - i nu where orders are odd.
  elemental complex(wp) function place_of(pole, period, stride)
    complex(wp), intent(in) :: pole
    real(wp), intent(in) :: period
    integer, intent(in) :: stride
    place_of = pole
    if (stride == 2) place_of = pole - cmplx(0.0_wp, 0.5_wp*period, wp)
    place_of = into_strip(place_of, period)
  end function place_of

  !> prod [1 - exp(2 pi (p - s)/d)]/(s - p) over the poles of rigid bodies.
  pure complex(wp) function rigid_factor(self, s, period) result(factor)
    class(condensed_poles), intent(in) :: self
    complex(wp), intent(in) :: s
    real(wp), intent(in) :: period
    complex(wp) :: x
    integer :: i

    factor = (1.0_wp, 0.0_wp)
    do i = 1, size(self%rigid)
      x = 2.0_wp*pi/period*(self%rigid(i) - s)
      factor = factor*(2.0_wp*pi/period)
      if (abs(x) > 0.0_wp) factor = -factor*gap(x)/x
    end do
  end function rigid_factor

end module viscovib_condensed_poles
