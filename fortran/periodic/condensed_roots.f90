! Optimize: -O3
!> Exponents of a motion of a condensed structure: zeros of F, Hill's determinant with poles of the
!! rest multiplied out.
!!
!! Each pole of the rest that was multiplied out has a zero near the exponent of the system with its
!! mean stiffness along the motion, det(I + H(s) J_0) = 0, which is as quickly evaluated as the
!! elements are few. All of these stand for the zeros until some of them are made sharp by the
!! secant method on F, all others divided out. At a motion nearby a zero is as far from its mean
!! exponent as it was there.
module viscovib_condensed_roots
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_condensed_hill, only: average, condensed_hill, moved_by_waves
  use viscovib_condensed_poles, only: place_of
  use viscovib_hill_determinant, only: gap_list, new_gaps
  use viscovib_hill_secant, only: first_step, folded, local_shape, secant
  use viscovib_kinds, only: wp
  use viscovib_structure, only: structure_type
  implicit none
  private

  public :: condensed_zeros, new_zeros

  integer, parameter :: max_mean_iterations = 8
  !> Last step of an exponent, in d.
  real(wp), parameter :: small_step = 1.0e-10_wp
  !> How far an offset may be extrapolated, in d, and frequencies that are one for that.
  real(wp), parameter :: furthest = 0.02_wp, near = 1.0e-8_wp
  !> Of the distance from the line: how far from their mean exponents zeros may be.
  real(wp), parameter :: safe = 0.1_wp
  !> Of the same distance: how far zeros may move to stay on their side, by the slope of F, and the
  !! step to take that. A zero known is one of these if it is as near, in d.
  real(wp), parameter :: certain = 0.2_wp, least_part = 0.05_wp, same_zero = 0.05_wp
  !> How much further than others a zero may move.
  real(wp), parameter :: as_far = 4.0_wp
  !> Zeros nearer to the line are not certain, in d.
  real(wp), parameter :: too_near = 1.0e-6_wp
  !> Last step to a mean exponent, and how far from its pole it may be, in d.
  real(wp), parameter :: mean_step = 1.0e-4_wp, mean_range = 4.0_wp
  !> A line is separate from the exponents by this part of their distance from the axis at least,
  !! and not further from them than this, in d; further left exponents are not sought.
  real(wp), parameter :: separate = 0.02_wp, wide = 0.1_wp, furthest_left = -1.2_wp

  type :: condensed_zeros
    !> Zeros with 0 <= Im lambda <= d/2, n of them, whether each is sharp, and its pole, 0: none.
    integer :: n = 0
    complex(wp), allocatable :: upper(:)
    logical, allocatable :: sharp(:)
    integer, allocatable, private :: of_pole(:)
    !> Whether one that is not sharp may lie on the other side of the axis.
    logical, allocatable, private :: doubtful(:)
    !> Of each pole: its mean exponent s, and how far the zero is from there, in d; whether there is
    !! one.
    complex(wp), allocatable, private :: mean(:), offset(:)
    !> det(I + H(s) J_0)' near its mean exponent at a motion nearby, the others divided out; 0: not
    !! known.
    complex(wp), allocatable, private :: mean_slope(:)
    integer, private :: n_poles = 0
    logical, allocatable, private :: known(:)
    !> Frequency of each offset, and how fast it changed with that.
    real(wp), allocatable, private :: nu(:)
    complex(wp), allocatable, private :: slope(:)
    !> Of each pole, and of the other zero of a pair that has met on a line of symmetry and parted;
    !! amid the two, near the mean exponent, in d.
    type(local_shape), allocatable, private :: shape_at(:), nearby_shape(:)
    real(wp), allocatable, private :: amid(:)
  contains
    procedure :: approximate
    procedure :: doubt
    procedure :: line_beyond
    procedure :: sharpen
    procedure :: stay
    procedure :: take_known
    procedure :: without_pole
    procedure :: all_of
    procedure :: n_right
    procedure, private :: find_nearby
    procedure, private :: put
  end type condensed_zeros

contains

  subroutine new_zeros(zeros, hill)
    type(condensed_zeros), intent(out) :: zeros
    type(condensed_hill), intent(in) :: hill
    allocate (zeros%upper(0), zeros%sharp(0), zeros%of_pole(0), zeros%doubtful(0))
    allocate (zeros%mean(size(hill%poles%pole)), zeros%offset(size(hill%poles%pole)), &
              source=(0.0_wp, 0.0_wp))
    allocate (zeros%slope, zeros%mean_slope, source=zeros%offset)
    allocate (zeros%known(size(hill%poles%pole)), source=.false.)
    allocate (zeros%nu(size(hill%poles%pole)), source=0.0_wp)
    allocate (zeros%shape_at(size(zeros%slope)), zeros%nearby_shape(size(zeros%slope)))
    allocate (zeros%amid(size(zeros%slope)), source=0.0_wp)
  end subroutine new_zeros

  !> A zero for each pole that was multiplied out.
  subroutine approximate(self, hill, system)
    class(condensed_zeros), intent(inout) :: self
    type(condensed_hill), intent(in) :: hill
    class(structure_type), intent(in) :: system
    complex(wp) :: place, further
    integer :: i, m
    logical :: made

    self%n = 0
    if (self%n_poles /= size(hill%poles%order)) self%mean_slope = (0.0_wp, 0.0_wp)
    self%n_poles = size(hill%poles%order)
    do i = 1, size(hill%poles%order)
      m = hill%poles%order(i)
      if (.not. self%known(m)) then
        self%mean(m) = hill%poles%pole(m)
        self%offset(m) = (0.0_wp, 0.0_wp)
        self%slope(m) = (0.0_wp, 0.0_wp)
        self%mean_slope(m) = (0.0_wp, 0.0_wp)
      end if
    end do
    do i = 1, size(hill%poles%order)
      m = hill%poles%order(i)
      call find_mean(self, hill, system, m, made)
      self%known(m) = .true.
      place = place_of(self%mean(m), hill%period, hill%stride)
      further = self%slope(m)*(hill%nu - self%nu(m))
      if (abs(further) > furthest) further = (0.0_wp, 0.0_wp)
      place = cmplx(real(place), abs(aimag(place)), wp) + hill%period*(self%offset(m) + further)
      ! A pole is no zero.
      if (.not. made) place = place + first_step*hill%period*(0.1_wp, 1.0_wp)
      call self%put(hill, place, .false., m)
      self%doubtful(self%n) = .not. made
    end do
  end subroutine approximate

  !> Those that may lie on the other side of the line along which exponents are counted.
  subroutine doubt(self, hill, system)
    class(condensed_zeros), intent(inout) :: self
    type(condensed_hill), intent(in) :: hill
    class(structure_type), intent(in) :: system
    integer :: i

    do i = 1, self%n
      if (self%doubtful(i)) cycle
      associate (m => self%of_pole(i))
        self%doubtful(i) = is_doubtful(hill, system, self%mean(m), &
                                       hill%period*abs(self%offset(m)))
      end associate
    end do
  end subroutine doubt

  !> A line between the exponents that decay most slowly and all others.
  pure subroutine line_beyond(self, hill, wanted, line, fastest, n_right)
    class(condensed_zeros), intent(in) :: self
    type(condensed_hill), intent(in) :: hill
    !> Right of the line, conjugates counted, if there are as many.
    integer, intent(in) :: wanted
    !> (1/s), and the highest frequency of the exponents right of it (rad/s).
    real(wp), intent(out) :: line, fastest
    !> 0: no line separates them.
    integer, intent(out) :: n_right
    logical :: free(self%n)
    real(wp) :: next
    integer :: i, k

    line = 0.0_wp
    fastest = 0.0_wp
    n_right = 0
    free = .true.
    do k = 1, self%n
      i = maxloc(real(self%upper(:self%n)), 1, free)
      free(i) = .false.
      n_right = n_right + merge(2, 1, is_pair(self%upper(i), hill%period))
      if (real(self%upper(i)) < furthest_left*hill%period) exit
      fastest = max(fastest, abs(aimag(self%mean(self%of_pole(i)))))
      if (n_right < wanted .and. k < self%n) cycle
      associate (last => real(self%upper(i)))
        next = last - max(abs(last), wide*hill%period)
        if (k < self%n) next = maxval(real(self%upper(:self%n)), free)
        line = max(0.5_wp*(last + next), last - wide*hill%period)
        if (last - line > separate*abs(last) .and. line < hill%line) return
      end associate
    end do
    n_right = 0
  end subroutine line_beyond

  !> An exponent of the system with its mean stiffness, those of all other poles divided out.
  subroutine find_mean(self, hill, system, m, made)
    class(condensed_zeros), intent(inout) :: self
    type(condensed_hill), intent(in) :: hill
    class(structure_type), intent(in) :: system
    integer, intent(in) :: m
    logical, intent(out) :: made
    complex(wp) :: before, root, value_before, value, step
    integer :: i

    made = .false.
    root = self%mean(m) + 1.0e-5_wp*hill%period*(0.1_wp, 1.0_wp)
    before = root
    if (abs(self%mean_slope(m)) > 0.0_wp) then
      call reduced(before, value_before)
      step = -value_before/self%mean_slope(m)
      made = abs(step) <= mean_step*hill%period
      if (abs(step) <= hill%period) root = before + step
    end if
    if (.not. abs(root - before) > 0.0_wp) then
      before = self%mean(m) + 1.0e-3_wp*hill%period*(1.0_wp, 1.0_wp)
      call reduced(before, value_before)
    end if
    do i = 1, merge(0, max_mean_iterations, made)
      call reduced(root, value)
      if (.not. abs(value - value_before) > 0.0_wp) exit
      self%mean_slope(m) = (value - value_before)/(root - before)
      step = -value/self%mean_slope(m)
      if (.not. abs(step) <= huge(1.0_wp)) return
      if (abs(step) > hill%period) step = hill%period*step/abs(step)
      before = root
      value_before = value
      root = root + step
      made = abs(step) <= mean_step*hill%period
      if (made) exit
    end do
    made = made .and. abs(root - hill%poles%pole(m)) <= mean_range*hill%period
    if (made) self%mean(m) = root

  contains

    subroutine reduced(s, value)
      complex(wp), intent(in) :: s
      complex(wp), intent(out) :: value
      integer :: j
      call average(hill, system, s, value)
      do j = 1, size(hill%poles%order)
        associate (other => hill%poles%order(j))
          value = value*(s - hill%poles%pole(other))
          if (other /= m) value = value/(s - self%mean(other))
        end associate
      end do
    end subroutine reduced

  end subroutine find_mean

  !> Whether a zero may be farther from its mean exponent than that is from the line.
  logical function is_doubtful(hill, system, mean, offset)
    type(condensed_hill), intent(in) :: hill
    class(structure_type), intent(in) :: system
    complex(wp), intent(in) :: mean
    !> What it was at a motion nearby.
    real(wp), intent(in) :: offset
    real(wp) :: moved, distance
    distance = abs(real(mean) - hill%line)
    is_doubtful = .not. offset < safe*distance
    if (is_doubtful) return
    call moved_by_waves(hill, system, mean, 0.1_wp*distance, moved)
    is_doubtful = .not. moved < safe*distance
  end function is_doubtful

  subroutine put(self, hill, zero, sharp, pole)
    class(condensed_zeros), intent(inout) :: self
    type(condensed_hill), intent(in) :: hill
    complex(wp), intent(in) :: zero
    logical, intent(in) :: sharp
    integer, intent(in) :: pole

    if (self%n == size(self%upper)) then
      self%upper = [self%upper, self%upper, (0.0_wp, 0.0_wp)]
      self%sharp = [self%sharp, self%sharp, .false.]
      self%of_pole = [self%of_pole, self%of_pole, 0]
      self%doubtful = [self%doubtful, self%doubtful, .false.]
    end if
    self%n = self%n + 1
    self%upper(self%n) = folded(zero, hill%period)
    self%sharp(self%n) = sharp
    self%of_pole(self%n) = pole
    self%doubtful(self%n) = .false.
  end subroutine put

  !> Whether the conjugate is another one.
  elemental logical function is_pair(upper, d)
    complex(wp), intent(in) :: upper
    real(wp), intent(in) :: d
    is_pair = aimag(upper) > 0.0_wp .and. aimag(upper) < 0.5_wp*d
  end function is_pair

  !> Zeros and their conjugates; sharp ones only, or all but one of them, 0: all.
  pure function all_of(self, hill, sharp_only, but) result(zeros)
    class(condensed_zeros), intent(in) :: self
    type(condensed_hill), intent(in) :: hill
    logical, intent(in) :: sharp_only
    integer, intent(in) :: but
    complex(wp), allocatable :: zeros(:)
    integer :: i, n

    allocate (zeros(2*self%n))
    n = 0
    do i = 1, self%n
      if (i == but .or. (sharp_only .and. .not. self%sharp(i))) cycle
      n = n + 1
      zeros(n) = self%upper(i)
      if (.not. is_pair(self%upper(i), hill%period)) cycle
      n = n + 1
      zeros(n) = conjg(self%upper(i))
    end do
    zeros = zeros(:n)
  end function all_of

  !> How many sharp ones lie right of the line.
  pure integer function n_right(self, hill)
    class(condensed_zeros), intent(in) :: self
    type(condensed_hill), intent(in) :: hill
    n_right = count(real(self%all_of(hill, .true., 0)) > hill%line)
  end function n_right

  !> Make those sharp that are in doubt, and others that are furthest right until `wanted` are,
  !! conjugates counted. Those are in doubt too that lie as near the line as others have moved.
  subroutine sharpen(self, hill, system, wanted, part)
    class(condensed_zeros), intent(inout) :: self
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    integer, intent(in) :: wanted
    !> Largest last step, of the distance from the line.
    real(wp), intent(in) :: part
    logical :: tried(2*size(self%upper) + 2)
    complex(wp) :: root, before, nearby
    real(wp) :: moved
    integer :: i, k, n_sharp
    logical :: made, paired
    logical, allocatable :: left(:)

    tried = .false.
    moved = 0.0_wp
    do k = 1, size(hill%poles%order)
      left = .not. (self%sharp .or. tried(:size(self%sharp)))
      n_sharp = count(self%sharp(:self%n)) &
                + count(self%sharp(:self%n) .and. is_pair(self%upper(:self%n), hill%period))
      if (n_sharp >= wanted) then
        left(:self%n) = left(:self%n) .and. (self%doubtful(:self%n) .or. &
                                             abs(real(self%upper(:self%n)) - hill%line) <= moved)
      end if
      i = maxloc(real(self%upper(:self%n)), 1, left(:self%n))
      if (i == 0) exit
      tried(i) = .true.
      paired = hill%poles%paired(self%of_pole(i))
      call secant(hill, system, self%all_of(hill, .false., i), self%upper(i), &
                  max(small_step, part*abs(real(self%upper(i)) - hill%line)/hill%period), root, &
                  made, self%shape_at(self%of_pole(i)))
      if (.not. made) cycle
      before = self%upper(i)
      self%upper(i) = folded(root, hill%period)
      self%sharp(i) = .true.
      moved = max(moved, as_far*abs(real(self%upper(i) - before)))
      associate (m => self%of_pole(i))
        nearby = place_of(self%mean(m), hill%period, hill%stride)
        nearby = (self%upper(i) - cmplx(real(nearby), abs(aimag(nearby)), wp))/hill%period
        self%slope(m) = (0.0_wp, 0.0_wp)
        if (abs(hill%nu - self%nu(m)) > near*hill%nu .and. self%nu(m) > 0.0_wp) then
          self%slope(m) = (nearby - self%offset(m))/(hill%nu - self%nu(m))
        end if
        self%offset(m) = nearby
        self%nu(m) = hill%nu
      end associate
      ! A pair may meet on the line and part.
      if (paired .and. .not. is_pair(self%upper(i), hill%period)) then
        call self%find_nearby(hill, system, i, before)
      else
        self%nearby_shape(self%of_pole(i))%known = .false.
      end if
    end do
    call drop_doubtful(self)
  end subroutine sharpen

  !> Put zeros that are known in place of approximate ones; the others are added.
  subroutine take_known(self, hill, known)
    class(condensed_zeros), intent(inout) :: self
    type(condensed_hill), intent(in) :: hill
    !> Exponents, conjugates included; NaN for none.
    complex(wp), intent(in) :: known(:)
    complex(wp) :: zero
    real(wp) :: distance
    logical :: parted(self%n)
    integer :: i, j, k

    self%sharp(:self%n) = .false.
    parted = .false.
    do j = 1, size(known)
      if (ieee_is_nan(real(known(j)))) cycle
      zero = folded(known(j), hill%period)
      ! The conjugate of the one before.
      if (any(self%sharp(:self%n) .and. .not. abs(self%upper(:self%n) - zero) > 0.0_wp)) cycle
      k = minloc(abs(self%upper(:self%n) - zero), 1,.not. self%sharp(:self%n))
      distance = 0.0_wp
      if (k > 0) distance = abs(self%upper(k) - zero)
      if (distance > same_zero*hill%period) k = 0
      if (distance > 0.0_wp .and. .not. is_pair(zero, hill%period)) then
        ! Of a pair that has parted one takes the approximation of both, the other one takes none.
        i = findloc(parted .and. .not. abs(aimag(self%upper(:size(parted)) - zero)) > 0.0_wp, &
                    .true., 1)
        if (i > 0) then
          parted(i) = .false.
          k = 0
        else if (k > 0 .and. k <= size(parted)) then
          if (self%of_pole(k) > 0) parted(k) = hill%poles%paired(self%of_pole(k))
        end if
      end if
      if (k == 0) then
        call self%put(hill, zero, .true., 0)
      else
        self%upper(k) = zero
        self%sharp(k) = .true.
      end if
    end do
  end subroutine take_known

  !> True if it is certain that zeros stay on their side of the line at motions very near that of
  !! `hill`: by first-order changes -(F of the other motion - F)/F'. Changes of F are linear there,
  !! so that they are those of motions on the other side too.
  logical function stay(self, hill, system, n_growing, reach, others)
    class(condensed_zeros), intent(inout) :: self
    !> Of the motion; of one of the others afterwards.
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    !> How many exponents grow.
    integer, intent(in) :: n_growing
    !> Zeros further from the line stay for sure (1/s).
    real(wp), intent(in) :: reach
    !> Harmonics, shape (2 n_orders, n_dof, n).
    real(wp), intent(in) :: others(:, :, :)
    type(gap_list) :: gaps(self%n)
    complex(wp) :: value(self%n), slope(self%n), now
    real(wp) :: away(self%n), step
    integer :: j, k, round
    logical :: asked(self%n)

    stay = .false.
    asked = abs(real(self%upper(:self%n)) - hill%line) <= reach
    do k = 1, self%n
      if (asked(k)) call new_gaps(gaps(k), self%all_of(hill, .false., k), hill%period)
    end do
    do k = 1, self%n
      if (.not. asked(k)) cycle
      do round = 1, 2
        away(k) = abs(real(self%upper(k)) - hill%line)
        if (.not. away(k) > too_near*hill%period) return
        step = min(first_step*hill%period, least_part*away(k))
        call reduced(k, (0.0_wp, 0.0_wp), value(k))
        call reduced(k, step*(1.0_wp, 1.0_wp), now)
        slope(k) = (now - value(k))/(step*(1.0_wp, 1.0_wp))
        if (.not. abs(value(k)) <= huge(1.0_wp)*min(abs(slope(k)), 1.0_wp)) return
        if (abs(value(k)) <= certain*away(k)*abs(slope(k))) exit
        if (round == 2 .or. abs(value(k)) > same_zero*hill%period*abs(slope(k))) return
        self%upper(k) = self%upper(k) - value(k)/slope(k)
      end do
    end do
    associate (right => real(self%upper(:self%n)) > hill%line)
      if (count(right) + count(right .and. is_pair(self%upper(:self%n), hill%period)) &
          + hill%poles%n_growing /= n_growing) return
    end associate
    ! Without memory there are as many zeros as poles: of a pair that has parted none lacks.
    if (self%n + count(is_pair(self%upper(:self%n), hill%period)) /= hill%poles%n_multiplied) return
    do j = 1, size(others, 3)
      call hill%vary(system, others(:, :, j))
      if (.not. hill%ready) return
      do k = 1, self%n
        if (.not. asked(k)) cycle
        call reduced(k, (0.0_wp, 0.0_wp), now)
        if (.not. abs(now - value(k)) <= certain*away(k)*abs(slope(k))) return
      end do
    end do
    stay = .true.

  contains

    !> F near zero i, all others divided out.
    subroutine reduced(i, step, value)
      integer, intent(in) :: i
      complex(wp), intent(in) :: step
      complex(wp), intent(out) :: value
      associate (place => self%upper(i))
        call hill%determinant(system, place + step, value, aimag(place) > 0.25_wp*hill%period)
        call gaps(i)%divide(place + step, value)
      end associate
    end subroutine reduced

  end function stay

  !> The other zero of a pair that has met on a line of symmetry and parted.
  subroutine find_nearby(self, hill, system, i, start)
    class(condensed_zeros), intent(inout) :: self
    type(condensed_hill), intent(inout) :: hill
    class(structure_type), intent(in) :: system
    integer, intent(in) :: i
    !> Where zero i was thought to be.
    complex(wp), intent(in) :: start
    complex(wp) :: nearby, root
    logical :: made

    associate (m => self%of_pole(i), d => hill%period)
      if (self%nearby_shape(m)%known) then
        nearby = cmplx(2.0_wp*(real(self%mean(m)) + d*self%amid(m)) - real(self%upper(i)), &
                       aimag(self%upper(i)), wp)
      else
        nearby = cmplx(2.0_wp*real(start) - real(self%upper(i)), aimag(self%upper(i)), wp) &
                 + first_step*d*(0.3_wp, 0.2_wp)
      end if
      call secant(hill, system, self%all_of(hill, .false., 0), nearby, small_step, root, made, &
                  self%nearby_shape(m))
      if (.not. made) return
      self%amid(m) = (0.5_wp*real(root + self%upper(i)) - real(self%mean(m)))/d
      call self%put(hill, root, .true., 0)
    end associate
  end subroutine find_nearby

  !> Without those in doubt that could not be made sharp: with one on the wrong side of the axis
  !! divided out, nothing is seen of the zero.
  pure subroutine drop_doubtful(self)
    class(condensed_zeros), intent(inout) :: self
    integer :: i, n

    n = 0
    do i = 1, self%n
      if (self%doubtful(i) .and. .not. self%sharp(i)) cycle
      n = n + 1
      self%upper(n) = self%upper(i)
      self%sharp(n) = self%sharp(i)
      self%of_pole(n) = self%of_pole(i)
      self%doubtful(n) = self%doubtful(i)
    end do
    self%n = n
  end subroutine drop_doubtful

  !> Zeros that belong to no pole of the rest.
  pure function without_pole(self) result(zeros)
    class(condensed_zeros), intent(in) :: self
    complex(wp), allocatable :: zeros(:)
    zeros = pack(self%upper(:self%n), self%of_pole(:self%n) == 0 .and. self%sharp(:self%n))
  end function without_pole

end module viscovib_condensed_roots
