! Optimize: -O2 -fvect-cost-model=dynamic -fstack-arrays
!> Selection of the loads and products in the modulation equations of a normal form, by their
!! effect (`viscovib_normal_products`) or by a tolerance.
!!
!! Terms that are constant in a common frame are selected in sequence. Each term is a linear
!! condition on the frame's frequencies W: the frequency of the driven mode is the sum of the
!! frequencies of the factors, loads included. A term is rejected if its condition contradicts the
!! accepted ones, or if it would couple more modes than the solver accepts. It is then a separate
!! harmonic term, which is not periodic in the frame (quasi-periodic motion).
module viscovib_resonant_terms
  use viscovib_kinds, only: wp
  use viscovib_normal_orders, only: need_side
  use viscovib_normal_products, only: candidate_type, default_band, far, influence, &
    least_influence, normal_form_type, part_of_far, reach_type
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_status, only: set_ok, status_type
  implicit none
  private

  public :: choose_loads, choose_products, far_influence, first_size, frame_choice_type, left_out, &
    list_resonances, new_frame_choice, wants_more

  !> Relative distance from a mode's frequency beyond which a load is never resonant.
  real(wp), parameter :: farthest_load = 0.3_wp
  !> Represents amplitudes without a limit.
  real(wp), parameter :: boundless = 1.0e50_wp
  !> Largest number of coupled modes: the limit of the solver of steady motions.
  integer, parameter :: max_moving = 3
  real(wp), parameter :: same = 1.0e-9_wp

  type :: frame_choice_type
    !> Natural frequencies, and orthonormal conditions on W - natural, a column each.
    real(wp), allocatable :: natural(:), basis(:, :), offset(:)
    integer :: n = 0
    !> For the accepted terms that are not mere shifts: modes that occur, and whether loads occur.
    logical, allocatable, private :: tied(:, :), loaded(:)
    integer, private :: n_tied = 0
  contains
    procedure :: take
    procedure :: frame
    procedure, private :: n_moving
  end type frame_choice_type

contains

  !> Select the loads in the rates of change of each mode. In a frame: loads so near that the mode
  !! can be shifted to them, or that they shift the mode; the amplitudes that they cause are added
  !! to `expected`.
  subroutine choose_loads(self, form, choice, expected, status, reach)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    type(frame_choice_type), intent(inout) :: choice
    real(wp), intent(inout) :: expected(:)
    type(status_type), intent(out) :: status
    type(reach_type), intent(in), optional :: reach
    real(wp), dimension(self%n_modes, size(form%drives)) :: strength, distance, linear
    logical :: candidate(self%n_modes, size(form%drives)), taken
    integer :: k, j, at(2)

    call set_ok(status)
    self%acts_load = spread([(.false., j=1, self%n_modes)], 2, size(form%drives))
    if (.not. self%framed) then
      do k = 1, size(form%drives)
        do j = 1, self%n_modes
          self%acts_load(j, k) = self%near(cmplx(0.0_wp, form%drives(k), wp), form%drives(k), j)
        end do
      end do
    end if
    do k = 1, size(form%drives)
      do j = 1, self%n_modes
        strength(j, k) = abs(self%drive_of(form, j, k))
        distance(j, k) = abs(form%drives(k) - aimag(self%exponents(j)))
        linear(j, k) = strength(j, k)/max(abs(cmplx(0.0_wp, form%drives(k), wp) &
                                              - self%exponents(j)), strength(j, k)/boundless, &
                                          tiny(1.0_wp))
      end do
    end do
    if (.not. present(reach) .or. .not. self%framed) then
      do j = 1, self%n_modes
        expected(j) = max(expected(j), maxval(linear(j, :), mask=strength(j, :) > 0.0_wp))
      end do
      return
    end if
    do k = 1, size(form%drives)
      do j = 1, self%n_modes
        candidate(j, k) = strength(j, k) > 0.0_wp .and. &
                          distance(j, k) <= farthest_load*aimag(self%exponents(j)) .and. &
                          form%drives(k) > 0.0_wp
        if (candidate(j, k)) candidate(j, k) = moves_far(reach, j, k)
        if (strength(j, k) > 0.0_wp) then
          expected(j) = max(expected(j), limited(reach, j, linear(j, k), strength(j, k)))
        end if
      end do
    end do
    ! Begin with the nearest load.
    do while (any(candidate))
      at = minloc(distance/spread(aimag(self%exponents(:self%n_modes)), 2, size(form%drives)), &
                  mask=candidate)
      candidate(at(1), at(2)) = .false.
      call choice%take(at(1), [(0, j=1, self%n_modes)], form%drives(at(2)), .true., taken)
      self%acts_load(at(1), at(2)) = taken
    end do

  contains

    !> True if the mode's own terms can shift it by the distance, or by a considerable part of it.
    pure logical function moves_far(reach, j, k)
      type(reach_type), intent(in) :: reach
      integer, intent(in) :: j, k
      real(wp) :: peak, most
      most = farthest_load*aimag(self%exponents(j))
      moves_far = distance(j, k) <= default_band*form%drives(k)
      if (moves_far) return
      ! At the peak only the decay limits the amplitude.
      peak = strength(j, k)/max(abs(real(self%exponents(j))), tiny(1.0_wp))
      moves_far = min(most, shift(reach, j, peak)) > least_influence*distance(j, k) .and. &
                  shift(reach, j, peak) > 0.5_wp*distance(j, k)
    end function moves_far

  end subroutine choose_loads

  !> Change of the exponent of mode j at an amplitude.
  pure real(wp) function shift(reach, j, a)
    type(reach_type), intent(in) :: reach
    integer, intent(in) :: j
    real(wp), intent(in) :: a
    real(wp) :: b
    b = min(a, boundless)
    shift = reach%cubic(j)*b**2 + reach%quadratic(j)*b
  end function shift

  !> Amplitude under a load of this strength, limited by the mode's own terms.
  pure real(wp) function limited(reach, j, linear, strength) result(a)
    type(reach_type), intent(in) :: reach
    integer, intent(in) :: j
    real(wp), intent(in) :: linear, strength
    a = linear
    if (reach%cubic(j) > 0.0_wp) a = min(a, (strength/reach%cubic(j))**(1.0_wp/3.0_wp))
    if (reach%quadratic(j) > 0.0_wp) a = min(a, sqrt(strength/reach%quadratic(j)))
  end function limited

  !> Select candidates of this order, largest influence first. In a frame, a term is accepted if it
  !! is constant in a frame with the accepted terms. Otherwise all are accepted.
  subroutine choose_products(self, form, order, expected, choice, reach)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: order
    real(wp), intent(in) :: expected(:)
    type(frame_choice_type), intent(inout) :: choice
    type(reach_type), intent(in), optional :: reach
    type(candidate_type), allocatable :: found(:)
    real(wp), allocatable :: does(:)
    real(wp) :: all_sizes(self%n_generators), reference
    logical, allocatable :: waits(:)
    integer :: i, powers(self%n_modes), n_loads
    real(wp) :: drive

    call sizes_of_generators(self, expected, all_sizes, reference)
    call list_candidates(self, form, order, found)
    allocate (does(size(found)))
    do i = 1, size(found)
      does(i) = influence(found(i), all_sizes, self%n_modes, reference)
    end do
    if (.not. self%framed) then
      do i = 1, size(found)
        found(i)%taken = does(i) >= least_influence .or. in_band(found(i))
      end do
    else
      allocate (waits(size(found)))
      do i = 1, size(found)
        call net_of(self, found(i), powers, drive, n_loads)
        powers(found(i)%mode) = powers(found(i)%mode) - 1
        ! A shift of the mode's own exponent is constant in every frame.
        found(i)%taken = all(powers == 0) .and. .not. abs(drive) > 0.0_wp
        waits(i) = .not. found(i)%taken .and. does(i) >= least_influence
        if (n_loads > 0 .and. .not. (found(i)%taken .or. waits(i))) then
          waits(i) = sustains(self, reach, found(i))
        end if
      end do
      do while (any(waits))
        i = maxloc(does, 1, mask=waits)
        waits(i) = .false.
        call net_of(self, found(i), powers, drive, n_loads)
        call choice%take(found(i)%mode, powers, drive, n_loads > 0, found(i)%taken)
        found(i)%turned_away = .not. found(i)%taken
        if (found(i)%turned_away .and. n_loads > 0) found(i)%lost = sustains(self, reach, found(i))
      end do
    end if
    do i = 1, size(found)
      if (found(i)%taken) call mark(found(i))
    end do
    self%candidates = [self%candidates, found]

  contains

    pure logical function in_band(c)
      type(candidate_type), intent(in) :: c
      in_band = self%near(sum(self%s(c%factors(:order))), &
                          maxval(abs(aimag(self%s(c%factors(:order))))), c%mode)
    end function in_band

    subroutine mark(c)
      type(candidate_type), intent(in) :: c
      integer :: other, f(3)
      f = 0
      f(:order) = modulo(c%factors(:order) - 1 + self%n_generators, 2*self%n_generators) + 1
      if (order == 2) then
        other = self%pair_at(f(1), f(2))
        self%acts_pair(c%mode, c%at) = .true.
        self%acts_pair(c%mode + self%n_generators, other) = .true.
      else
        other = self%place_of(f(1), f(2), f(3))
        self%acts_triple(c%mode, c%at) = .true.
        self%acts_triple(c%mode + self%n_generators, other) = .true.
      end if
    end subroutine mark

  end subroutine choose_products

  !> True if loads and the mode itself can sustain an amplitude that shifts the mode's frequency to
  !! that of the product (subharmonic and superharmonic resonance away from the linear one).
  pure logical function sustains(self, reach, c)
    class(normal_form_type), intent(in) :: self
    type(reach_type), intent(in) :: reach
    type(candidate_type), intent(in) :: c
    real(wp) :: decay, distance, a, rate
    integer :: j, powers(self%n_modes), n_loads, n_own, round
    real(wp) :: drive

    j = c%mode
    sustains = .false.
    ! The amplitude of a mode that a load drives is the expected one.
    if (any(self%acts_load(j, :))) return
    n_own = count(c%factors == j .or. c%factors == j + self%n_generators)
    call net_of(self, c, powers, drive, n_loads)
    if (n_own + n_loads /= c%order .or. powers(j) == 1) return
    decay = abs(real(self%exponents(j)))
    distance = abs(drive + (powers(j) - 1)*aimag(self%exponents(j)))/abs(powers(j) - 1)
    if (distance > farthest_load*aimag(self%exponents(j))) return
    ! The equation of the amplitude allows |shift - distance| <= rate, and rate >= decay.
    rate = decay
    do round = 1, 4
      a = amplitude_of_shift(reach, j, distance + rate)
      if (.not. a > 0.0_wp) return
      rate = max(c%coupling*a**(n_own - 1), decay)
    end do
    sustains = c%coupling*a**(n_own - 1) >= decay
  end function sustains

  !> Amplitude at which mode j has this shift; 0 if there is none.
  pure real(wp) function amplitude_of_shift(reach, j, wanted) result(a)
    type(reach_type), intent(in) :: reach
    integer, intent(in) :: j
    real(wp), intent(in) :: wanted
    real(wp) :: slope
    slope = reach%quadratic(j) + sqrt(reach%quadratic(j)**2 + 4.0_wp*reach%cubic(j)*wanted)
    a = 0.0_wp
    if (slope > 0.0_wp) a = 2.0_wp*wanted/slope
  end function amplitude_of_shift

  !> Products of this order that are not too far from a mode, with their effect.
  subroutine list_candidates(self, form, order, found, moves)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: order
    type(candidate_type), allocatable, intent(out) :: found(:)
    !> List only products farther than `far`, with at most one mode at rest among their factors:
    !! others have no influence. Modes at rest have their natural frequencies. Shape (n_modes).
    logical, intent(in), optional :: moves(:)
    type(candidate_type), allocatable :: some(:)
    complex(wp) :: s, part, term, side(form%n), own(2*self%n_generators)
    real(wp) :: sizes, off, farthest
    logical :: rests(2*self%n_generators)
    integer :: i, j, k, n, factors(3)

    own = self%s
    rests = self%rests
    if (present(moves)) then
      do j = 1, self%n_modes
        if (.not. moves(j)) rests([j, j + self%n_generators]) = .true.
      end do
      where (rests) own = cmplx(0.0_wp, aimag(self%exponents), wp)
    end if
    allocate (some(16))
    n = 0
    factors = 0
    do i = 1, merge(size(self%pair, 2), size(self%triple, 2), order == 2)
      if (order == 2) then
        factors(:2) = self%pair(:, i)
      else
        factors = self%triple(:, i)
      end if
      if (count(rests(factors(:order))) > 1) cycle
      s = sum(own(factors(:order)))
      ! In motions under loads, a product with the conjugate of a mode makes modes at rest grow. If
      ! motions are large, this happens far from equal frequencies, almost down to products of
      ! frequency 0.
      farthest = far
      if (present(moves) .or. self%with_far) then
        if ((self%framed .or. self%steady) .and. has_conjugate()) farthest = 0.95_wp
      end if
      if (present(moves) .and. .not. farthest > far) cycle
      do j = 1, self%n_modes
        off = abs(aimag(s - own(j)))
        if (off > farthest*aimag(own(j))) cycle
        if (present(moves) .and. .not. off > far*aimag(own(j))) cycle
        if (order == 2) then
          side = self%side_pair(:, i)
        else
          call need_side(self, form, i)
          side = self%side_triple(:, i)
        end if
        if (all(side == (0.0_wp, 0.0_wp))) exit
        part = (0.0_wp, 0.0_wp)
        sizes = 0.0_wp
        do k = 1, size(side)
          term = self%left(k, j)*side(k)
          part = part + term
          sizes = sizes + abs(real(term)) + abs(aimag(term))
        end do
        if (.not. modulus(part) > 1.0e-13_wp*sizes) cycle
        if (n == size(some)) some = [some, some]
        n = n + 1
        some(n) = candidate_type(order, i, j, coupling=modulus(part/self%weight(form, j, s)), &
                                 divisor=modulus(s - self%exponents(j)), factors=factors)
      end do
    end do
    found = some(:n)

  contains

    !> True if a factor is the conjugate of a mode.
    pure logical function has_conjugate()
      has_conjugate = any(factors > self%n_generators .and. &
                          factors <= self%n_generators + self%n_modes)
    end function has_conjugate

    !> The modulus, without a test for overflow.
    elemental real(wp) function modulus(z)
      complex(wp), intent(in) :: z
      modulus = sqrt(real(z)**2 + aimag(z)**2)
    end function modulus

  end subroutine list_candidates

  !> Powers of the modes among the factors, conjugates negative, and the loads' frequency.
  pure subroutine net_of(self, c, powers, drive, n_loads)
    class(normal_form_type), intent(in) :: self
    type(candidate_type), intent(in) :: c
    integer, intent(out) :: powers(:), n_loads
    real(wp), intent(out) :: drive
    integer :: q, place, sign_of
    powers = 0
    drive = 0.0_wp
    n_loads = 0
    do q = 1, c%order
      place = modulo(c%factors(q) - 1, self%n_generators) + 1
      sign_of = merge(1, -1, c%factors(q) <= self%n_generators)
      if (place <= self%n_modes) then
        powers(place) = powers(place) + sign_of
      else
        drive = drive + sign_of*aimag(self%exponents(place))
        n_loads = n_loads + 1
      end if
    end do
    if (n_loads == 0) return
    if (abs(drive) <= 1.0e-12_wp*maxval(abs(self%exponents))) drive = 0.0_wp
  end subroutine net_of

  !> |Y| of the generators for amplitudes of the modes; and the largest first-order motion.
  pure subroutine sizes_of_generators(self, sizes, all_sizes, reference)
    class(normal_form_type), intent(in) :: self
    real(wp), intent(in) :: sizes(:)
    real(wp), intent(out) :: all_sizes(:), reference
    integer :: a
    all_sizes = 1.0_wp
    all_sizes(:self%n_modes) = sizes
    reference = 0.0_wp
    do a = 1, self%n_generators
      reference = max(reference, all_sizes(a)*maxval(abs(self%right(:, a))))
    end do
  end subroutine sizes_of_generators

  !> The largest first-order motion, for amplitudes of the modes.
  pure real(wp) function first_size(self, sizes)
    class(normal_form_type), intent(in) :: self
    real(wp), intent(in) :: sizes(:)
    real(wp) :: all_sizes(self%n_generators)
    call sizes_of_generators(self, sizes, all_sizes, first_size)
  end function first_size

  !> The largest influence of terms that are not constant in the frame, at these amplitudes.
  pure real(wp) function left_out(self, sizes)
    class(normal_form_type), intent(in) :: self
    real(wp), intent(in) :: sizes(:)
    real(wp) :: all_sizes(self%n_generators), reference
    integer :: i
    call sizes_of_generators(self, sizes, all_sizes, reference)
    left_out = 0.0_wp
    do i = 1, size(self%candidates)
      if (self%candidates(i)%taken) cycle
      left_out = max(left_out, influence(self%candidates(i), all_sizes, self%n_modes, reference))
    end do
  end function left_out

  !> The largest influence on a mode at rest of distant terms that are not resonant, times
  !! `part_of_far`.
  real(wp) function far_influence(self, form, sizes, moving_too)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    real(wp), intent(in) :: sizes(:)
    !> Include the influence on active modes.
    logical, intent(in), optional :: moving_too
    type(candidate_type), allocatable :: found(:)
    real(wp) :: all_sizes(self%n_generators), reference
    integer :: i, order
    call sizes_of_generators(self, sizes, all_sizes, reference)
    far_influence = 0.0_wp
    do order = 2, 3
      if (self%with_far) then
        found = pack(self%candidates, self%candidates%order == order)
      else
        call list_candidates(self, form, order, found, sizes > 0.0_wp)
      end if
      do i = 1, size(found)
        associate (c => found(i))
          if (is_taken(c)) cycle
          if (sizes(c%mode) > 0.0_wp .and. .not. present(moving_too)) cycle
          far_influence = max(far_influence, &
                              part_of_far*influence(c, all_sizes, self%n_modes, reference))
        end associate
      end do
    end do

  contains

    pure logical function is_taken(c)
      type(candidate_type), intent(in) :: c
      if (order == 2) then
        is_taken = self%acts_pair(c%mode, c%at)
      else
        is_taken = self%acts_triple(c%mode, c%at)
      end if
    end function is_taken

  end function far_influence

  !> True if more terms would be selected at these amplitudes.
  pure logical function wants_more(self, sizes)
    class(normal_form_type), intent(in) :: self
    real(wp), intent(in) :: sizes(:)
    real(wp) :: all_sizes(self%n_generators), reference
    integer :: i
    call sizes_of_generators(self, sizes, all_sizes, reference)
    wants_more = .false.
    do i = 1, size(self%candidates)
      associate (c => self%candidates(i))
        if (c%taken .or. c%turned_away) cycle
        wants_more = wants_more .or. influence(c, all_sizes, self%n_modes, reference) &
                     >= least_influence
      end associate
    end do
  end function wants_more

  subroutine new_frame_choice(choice, natural)
    type(frame_choice_type), intent(out) :: choice
    !> Frequencies of the modes.
    real(wp), intent(in) :: natural(:)
    choice%natural = natural
    allocate (choice%basis(size(natural), size(natural)), choice%offset(size(natural)))
    allocate (choice%tied(size(natural), 64), choice%loaded(64))
  end subroutine new_frame_choice

  !> Accept a term if its condition is compatible.
  subroutine take(self, row, powers, drive, loaded, taken)
    class(frame_choice_type), intent(inout) :: self
    !> Mode that is driven.
    integer, intent(in) :: row
    !> How often each mode is a factor, conjugates counted negative, shape (n_modes).
    integer, intent(in) :: powers(:)
    !> Frequency of the loads among the factors.
    real(wp), intent(in) :: drive
    !> True if loads are among the factors.
    logical, intent(in) :: loaded
    logical, intent(out) :: taken
    real(wp) :: condition(size(powers)), wanted
    integer :: k, pass

    condition = powers
    condition(row) = condition(row) - 1.0_wp
    ! A shift of the mode's own exponent is constant in every frame.
    taken = .not. any(abs(condition) > 0.0_wp) .and. .not. abs(drive) > 0.0_wp
    if (taken) return
    if (self%n_tied == size(self%loaded)) then
      self%tied = reshape(self%tied, [size(powers), 2*self%n_tied], pad=[.false.])
      self%loaded = [self%loaded, self%loaded]
    end if
    self%n_tied = self%n_tied + 1
    self%tied(:, self%n_tied) = powers /= 0
    self%tied(row, self%n_tied) = .true.
    self%loaded(self%n_tied) = loaded
    wanted = -drive - sum(condition*self%natural)
    do pass = 1, 2
      do k = 1, self%n
        associate (part => sum(self%basis(:, k)*condition))
          wanted = wanted - part*self%offset(k)
          condition = condition - part*self%basis(:, k)
        end associate
      end do
    end do
    if (self%n_moving() > max_moving) then
      taken = .false.
    else if (norm2(condition) > same) then
      taken = .true.
      self%n = self%n + 1
      self%offset(self%n) = wanted/norm2(condition)
      self%basis(:, self%n) = condition/norm2(condition)
    else
      taken = abs(wanted) <= same*(maxval(self%natural) + abs(drive))
    end if
    if (.not. taken) self%n_tied = self%n_tied - 1
  end subroutine take

  !> The frame nearest to the natural frequencies.
  pure function frame(self)
    class(frame_choice_type), intent(in) :: self
    real(wp) :: frame(size(self%natural))
    integer :: k
    frame = self%natural
    do k = 1, self%n
      frame = frame + self%offset(k)*self%basis(:, k)
    end do
  end function frame

  !> Number of modes that loads excite through the accepted terms.
  pure integer function n_moving(self)
    class(frame_choice_type), intent(in) :: self
    logical :: moves(size(self%natural))
    integer :: round, i
    moves = .false.
    do round = 1, size(moves) + 1
      do i = 1, self%n_tied
        if (self%loaded(i) .or. any(moves .and. self%tied(:, i))) then
          moves = moves .or. self%tied(:, i)
        end if
      end do
    end do
    n_moving = count(moves)
  end function n_moving

  !> The conditions of resonance up to third order among natural frequencies w_j and frequencies of
  !! loads p_k.
  !!
  !! A product of one to three generators, each with its frequency or the opposite, resonates with
  !! mode j if the sum of frequencies equals w_j. Identities for all frequencies (w_j = w_j + w_k -
  !! w_k) are not conditions. Changes of sign or of the side of the equation give the same
  !! condition. The conditions are integer vectors c with sum_i c_i f_i = 0, whose first nonzero
  !! entry is positive, with at least one mode and n = |c_1| + |c_2| + ... = 2 (loads near modes,
  !! modes near each other), 3 or 4; as a condition on a mode, of order n - 1.
  subroutine list_resonances(natural, drives, coefficients, orders, divisors)
    !> Circular frequencies, all > 0.
    real(wp), intent(in) :: natural(:), drives(:)
    !> c, shape (n_natural + n_drives, n), and the order of each.
    integer, allocatable, intent(out) :: coefficients(:, :), orders(:)
    !> |sum c_i f_i|/max(f_i with c_i /= 0), shape (n).
    real(wp), allocatable, intent(out) :: divisors(:)
    real(wp) :: frequencies(size(natural) + size(drives))
    integer :: c(size(natural) + size(drives)), n, total
    logical :: counted

    frequencies = [natural, drives]
    counted = .false.
    call enumerate()
    allocate (coefficients(size(c), n), orders(n), divisors(n))
    counted = .true.
    call enumerate()

  contains

    subroutine enumerate()
      n = 0
      c = 0
      do total = 2, 4
        call place(1, total)
      end do
    end subroutine enumerate

    !> Distribute the remaining sum of moduli over the entries from i on.
    recursive subroutine place(i, left)
      integer, intent(in) :: i, left
      integer :: value
      if (i > size(c)) then
        if (left == 0) call keep()
        return
      end if
      do value = -left, left
        ! The first nonzero entry is positive.
        if (value < 0 .and. all(c(:i - 1) == 0)) cycle
        c(i) = value
        call place(i + 1, left - abs(value))
      end do
      c(i) = 0
    end subroutine place

    subroutine keep()
      logical :: used(size(c))
      used = c /= 0
      if (.not. any(used(:size(natural)))) return
      ! A sum of entries of one sign is never 0; multiples of a condition are omitted.
      if (all(c >= 0) .or. all(modulo(c, 2) == 0)) return
      n = n + 1
      if (.not. counted) return
      coefficients(:, n) = c
      orders(n) = total - 1
      divisors(n) = abs(sum(c*frequencies))/maxval(frequencies, mask=used)
    end subroutine keep

  end subroutine list_resonances

end module viscovib_resonant_terms
