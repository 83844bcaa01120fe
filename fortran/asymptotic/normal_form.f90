!> The method of multiple scales to third order, as a normal form.
!!
!! The motion is a polynomial in generators Y_a: an amplitude Y_j for each mode, with
!! Y_j' = s_j Y_j + ..., a wave exp(i p t) for each load far from the modes, and the
!! conjugates of all,
!!
!!   y = sum_a r_a Y_a + sum_ab U_ab Y_a Y_b + sum_abc U_abc Y_a Y_b Y_c,
!!   Y_j' = s_j Y_j + sum_ab g_j,ab Y_a Y_b + sum_abc g_j,abc Y_a Y_b Y_c + sum_k g_jk exp(i p_k t).
!!
!! A product M of generators has the exponent s_M, the sum of theirs. Put into the
!! equations of `viscovib_polynomial_form`, each product gives a linear equation
!!
!!   L(s_M) U_M + sum_j g_jM L[s_M, s_j] r_j = R_M,      l_j L[s_M, s_j] U_M = 0,
!!
!! j over the modes that resonate with M; L[s, t] is the divided difference. R_M is the load, or
!! what lower orders put in: -N_2, -2 N_2 and -N_3, and what slow changes of second order do to
!! products of second order. Damping and memory are in s_j and L: their linear effects are exact.
!!
!! What resonates is chosen by what each term does (`viscovib_resonance_choice`), or, with a
!! tolerance, by frequencies that differ by less than this part of the highest of them.
!!
!! Three kinds of exponents. Of free motion: decay included. Where a load keeps a mode moving:
!! i times the frequencies. Of steady motion in a frame W: i W_j, exact since the amplitudes
!! stand still there; for the same reason nothing changes slowly then. A load that resonates with
!! a mode puts g_jk into its change and the rest u_k of its wave into y; u_k is a factor of
!! products where it is not small against the mode's own motion.
!!
!! Sources: Nayfeh, Introduction to perturbation techniques, 1981, chapters 7, 15 (scales);
!! Touze, Vizzaccaro, Thomas, Nonlinear Dyn. 105 (2021) 1141, equations (44)-(60) (normal forms
!! with the same bordered equations). One time scale a degree here gives Nayfeh's equations.
module viscovib_normal_form
  use viscovib_dense, only: solve_complex
  use viscovib_frame_choice, only: frame_choice_type, new_frame_choice
  use viscovib_kinds, only: wp
  use viscovib_linear_modes, only: find_modes
  use viscovib_polynomial_form, only: polynomial_form_type
  use viscovib_resonance_choice, only: candidate_type, default_band, influence, least_influence
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: normal_form_type, new_normal_form, reach_type

  integer, parameter, public :: max_modes = 6, max_loads = 6
  !> In place of a tolerance: choose by what the terms do.
  real(wp), parameter, public :: by_influence = -huge(1.0_wp)
  !> A load farther than this part of a mode's frequency from it never counts as resonant.
  real(wp), parameter :: farthest_load = 0.3_wp
  !> u_k is a factor of products from this part of the mode's motion on.
  real(wp), parameter :: least_rest = 0.1_wp
  !> Nearer than this part of its exponent the linear part of an undamped mode answers nothing.
  real(wp), parameter :: singular_within = 1.0e-9_wp
  !> Stands for amplitudes that nothing limits.
  real(wp), parameter :: boundless = 1.0e50_wp

  !> How far modes can be shifted: the change of exponent of each, over the square of its
  !! amplitude (terms of third order) and over amplitudes (second), shape (n_modes).
  type :: reach_type
    real(wp), allocatable :: cubic(:), quadratic(:)
  end type reach_type

  type :: normal_form_type
    integer :: n_modes = 0, n_generators = 0
    !> Frequencies nearer than this part of the highest of them count as resonant, where that is
    !! not chosen.
    real(wp) :: tolerance = 0.0_wp
    !> Loads whose waves are factors of products (generators n_modes + 1, ...), the others, and
    !! those that are in the modes' changes.
    integer, allocatable :: hard(:), weak(:), direct(:)
    !> Products are those of steady motion; and in a frame chosen for it.
    logical :: steady = .false., framed = .false.
    !> What resonates is chosen by influence.
    logical :: choosing = .false.
    !> That frame, or the natural frequencies.
    real(wp), allocatable :: frame(:)
    !> Terms near a mode, chosen or not; with loads by themselves, products of none, first.
    type(candidate_type), allocatable :: candidates(:)
    !> Generator a + n_generators is the conjugate of a. Exponents of the linear flow and
    !! of products, shape (2 n_generators); vectors, shape (n, 2 n_generators).
    complex(wp), allocatable :: exponents(:), s(:), right(:, :), left(:, :)
    !> Products: factors, exponents, coefficients of y, shape (n, n_products), and of the
    !! modes' changes, shape (2 n_generators, n_products).
    integer, allocatable :: pair(:, :), triple(:, :)
    complex(wp), allocatable :: s_pair(:), s_triple(:)
    complex(wp), allocatable :: u_pair(:, :), u_triple(:, :), g_pair(:, :), g_triple(:, :)
    !> Products that y has at all.
    integer, allocatable :: used_pairs(:), used_triples(:)
    !> Moduli of the coefficients of the coordinates.
    real(wp), allocatable :: size_one(:, :), size_pair(:, :), size_triple(:, :)
    !> Loads near modes: y, shape (n, n_loads), and g, shape (n_modes, n_loads).
    complex(wp), allocatable :: u_load(:, :), g_load(:, :)
    integer, allocatable, private :: pair_at(:, :), triple_at(:, :, :)
    !> Which modes and conjugates resonate, shape (2 n_generators, n_products), and which modes
    !! with loads, shape (n_modes, n_loads).
    logical, allocatable, private :: acts_pair(:, :), acts_triple(:, :), acts_load(:, :)
    !> Arguments x of the terms of first and second order.
    complex(wp), allocatable, private :: x_one(:, :), x_pair(:, :)
    !> N_2 of each product of two, kernels left out, with memory and slow changes alone.
    complex(wp), allocatable, private :: n_pair(:, :)
  contains
    procedure :: conjugate_of
    procedure :: near
    procedure :: near_modes
    procedure :: answer
    procedure :: left_out
    procedure :: wants_more
    procedure, private :: answer_load
    procedure, private :: choose_loads
    procedure, private :: choose_products
    procedure, private :: set_exponents
    procedure, private :: second_sides
    procedure, private :: second_order
    procedure, private :: third_sides
    procedure, private :: third_order
  end type normal_form_type

contains

  subroutine new_normal_form(normal, form, tolerance, steady, status, reach, sizes)
    type(normal_form_type), intent(out) :: normal
    type(polynomial_form_type), intent(in) :: form
    !> In [0, 1), or `by_influence`.
    real(wp), intent(in) :: tolerance
    !> Take steady motion for granted, even if no load is near a mode.
    logical, intent(in) :: steady
    type(status_type), intent(out) :: status
    !> With `by_influence`: choose for steady motion in one frame.
    type(reach_type), intent(in), optional :: reach
    !> With `by_influence`: amplitudes to expect, shape (n_modes); what loads do by themselves is
    !! added to them.
    real(wp), intent(in), optional :: sizes(:)
    type(frame_choice_type) :: choice
    complex(wp) :: s(form%n_modes()), right(form%n, form%n_modes()), left(form%n, form%n_modes())
    complex(wp), allocatable :: sides(:, :)
    real(wp) :: expected(form%n_modes())
    integer :: n

    if (.not. (tolerance >= 0.0_wp .and. tolerance < 1.0_wp) .and. tolerance > by_influence) then
      call fail(status, status_input_error, 'tolerance', 'tolerance = '//show(tolerance) &
                //': must be in [0, 1)')
      return
    end if
    n = form%n_modes()
    if (n > max_modes .or. size(form%drives) > max_loads) then
      call fail(status, status_input_error, 'system', 'system: has '//show(n)//' modes and ' &
                //show(size(form%drives))//' loads: at most '//show(max_modes)//' and ' &
                //show(max_loads)//' are allowed')
      return
    end if
    call find_modes(form, s, right, left, status)
    if (status%failed()) return
    normal%n_modes = n
    normal%n_generators = n
    normal%tolerance = merge(tolerance, default_band, tolerance >= 0.0_wp)
    normal%choosing = tolerance < 0.0_wp
    normal%framed = present(reach) .and. normal%choosing
    normal%s = [s, conjg(s)]
    normal%exponents = normal%s
    normal%frame = aimag(s)
    normal%right = reshape([right, conjg(right)], [form%n, 2*n])
    normal%left = reshape([left, conjg(left)], [form%n, 2*n])
    allocate (normal%candidates(0))
    expected = 0.0_wp
    if (present(sizes)) expected = sizes

    call new_frame_choice(choice, normal%frame)
    call normal%choose_loads(form, choice, expected, status, reach)
    if (.not. status%failed()) call add_waves(normal, form, status)
    if (status%failed()) return
    normal%steady = steady .or. size(normal%weak) > 0
    if (normal%framed) normal%frame = choice%frame()
    call number_products(normal)
    call normal%set_exponents()
    call normal%second_sides(form, sides)
    if (normal%choosing) then
      call normal%choose_products(form, 2, sides, expected, choice)
      if (normal%framed) then
        normal%frame = choice%frame()
        call normal%set_exponents()
        call normal%second_sides(form, sides)
      end if
    end if
    call normal%second_order(form, sides, status)
    if (status%failed()) return
    call normal%third_sides(form, sides)
    if (normal%choosing) then
      n = choice%n
      call normal%choose_products(form, 3, sides, expected, choice)
      if (normal%framed .and. choice%n > n) then
        normal%frame = choice%frame()
        call normal%set_exponents()
        call normal%second_sides(form, sides)
        call normal%second_order(form, sides, status)
        if (status%failed()) return
        call normal%third_sides(form, sides)
      end if
    end if
    call normal%third_order(form, sides, status)
    if (status%failed()) return
    normal%used_pairs = used(form%n_dof, normal%u_pair)
    normal%used_triples = used(form%n_dof, normal%u_triple)
    normal%size_one = abs(normal%right(:form%n_dof, :))
    normal%size_pair = abs(normal%u_pair(:form%n_dof, :))
    normal%size_triple = abs(normal%u_triple(:form%n_dof, :))
  end subroutine new_normal_form

  !> Which loads are in the changes of which modes, and their waves. In a frame: those near
  !! enough for the mode to be shifted to them, or to be shifted by them; the amplitudes they
  !! give rise to are put into `expected`.
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
    allocate (self%acts_load(self%n_modes, size(form%drives)), source=.false.)
    if (.not. self%framed) then
      do k = 1, size(form%drives)
        do j = 1, self%n_modes
          self%acts_load(j, k) = self%near(cmplx(0.0_wp, form%drives(k), wp), form%drives(k), j)
        end do
      end do
    end if
    do k = 1, size(form%drives)
      do j = 1, self%n_modes
        strength(j, k) = abs(drive_of(self, form, j, k))
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
    ! The nearest first.
    do while (any(candidate))
      at = minloc(distance/spread(aimag(self%exponents(:self%n_modes)), 2, size(form%drives)), &
                  mask=candidate)
      candidate(at(1), at(2)) = .false.
      call choice%take(at(1), [(0, j=1, self%n_modes)], form%drives(at(2)), .true., taken)
      self%acts_load(at(1), at(2)) = taken
    end do

  contains

    !> Whether the mode's own terms can bridge the distance, or a part of it that matters.
    pure logical function moves_far(reach, j, k)
      type(reach_type), intent(in) :: reach
      integer, intent(in) :: j, k
      real(wp) :: peak, most
      most = farthest_load*aimag(self%exponents(j))
      moves_far = distance(j, k) <= default_band*form%drives(k)
      if (moves_far) return
      ! At the peak, the decay is all that holds the amplitude.
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

  !> Amplitude under a load of this strength: no larger than what its own terms allow.
  pure real(wp) function limited(reach, j, linear, strength) result(a)
    type(reach_type), intent(in) :: reach
    integer, intent(in) :: j
    real(wp), intent(in) :: linear, strength
    a = linear
    if (reach%cubic(j) > 0.0_wp) a = min(a, (strength/reach%cubic(j))**(1.0_wp/3.0_wp))
    if (reach%quadratic(j) > 0.0_wp) a = min(a, sqrt(strength/reach%quadratic(j)))
  end function limited

  !> l_j F_k/2 over l_j L[i p, s_j] r_j; rounding of a load that does not touch the mode is 0.
  complex(wp) function drive_of(self, form, j, k)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: j, k
    complex(wp) :: part
    real(wp) :: rounding
    drive_of = (0.0_wp, 0.0_wp)
    part = 0.5_wp*sum(self%left(:, j)*form%load(:, k))
    rounding = 0.5e-13_wp*maxval(abs(self%left(:, j)))*maxval(abs(form%load(:, k)))
    if (.not. abs(part) > rounding) return
    drive_of = part/weight(self, form, j, cmplx(0.0_wp, form%drives(k), wp))
  end function drive_of

  !> l_j L[s, s_j] r_j.
  complex(wp) function weight(self, form, j, s)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: j
    complex(wp), intent(in) :: s
    weight = sum(self%left(:, j)*matmul(form%operator_between(s, self%exponents(j)), &
                                        self%right(:, j)))
  end function weight

  !> Waves of the loads; those that are factors of products become generators.
  subroutine add_waves(normal, form, status)
    type(normal_form_type), intent(inout) :: normal
    type(polynomial_form_type), intent(in) :: form
    type(status_type), intent(out) :: status
    complex(wp), allocatable :: wave(:, :), s(:), right(:, :), left(:, :)
    logical :: active(size(form%drives)), acts(size(form%drives)), joins(size(form%drives))
    integer :: n, k, m

    n = normal%n_modes
    call set_ok(status)
    allocate (normal%g_load(n, size(form%drives)), source=(0.0_wp, 0.0_wp))
    allocate (normal%u_load(form%n, size(form%drives)), source=(0.0_wp, 0.0_wp))
    acts = .false.
    joins = .true.
    do k = 1, size(form%drives)
      active(k) = any(abs(form%load(:, k)) > 0.0_wp)
      if (.not. active(k)) cycle
      call normal%answer_load(form, k, form%drives(k), normal%u_load(:, k), normal%g_load(:, k), &
                              status)
      if (status%failed()) return
      acts(k) = any(abs(normal%g_load(:, k)) > 0.0_wp)
      if (acts(k)) joins(k) = normal%framed .and. rest_matters(k)
    end do
    normal%direct = pack([(k, k=1, size(form%drives))], active .and. acts)
    normal%weak = pack([(k, k=1, size(form%drives))], active .and. .not. joins)
    normal%hard = pack([(k, k=1, size(form%drives))], active .and. joins)
    allocate (wave, source=normal%u_load(:, normal%hard))
    allocate (s, source=normal%exponents(:n))
    allocate (right, source=normal%right(:, :n))
    left = normal%left(:, :n)
    m = n + size(normal%hard)
    normal%n_generators = m
    associate (wave_s => cmplx(0.0_wp, form%drives(normal%hard), wp))
      normal%exponents = [s, wave_s, conjg(s), conjg(wave_s)]
      normal%right = reshape([right, wave, conjg(right), conjg(wave)], [form%n, 2*m])
      normal%left = reshape([left, 0.0_wp*wave, conjg(left), 0.0_wp*wave], [form%n, 2*m])
    end associate

  contains

    !> u_k against the linear motion of the modes that the load drives.
    logical function rest_matters(k)
      integer, intent(in) :: k
      real(wp) :: own
      integer :: j
      own = 0.0_wp
      do j = 1, n
        own = own + abs(normal%g_load(j, k))/max(abs(cmplx(0.0_wp, form%drives(k), wp) &
                                                    - normal%exponents(j)), tiny(1.0_wp))
      end do
      rest_matters = maxval(abs(normal%u_load(:form%n_dof, k))) > least_rest*own
    end function rest_matters

  end subroutine add_waves

  !> Exponents of generators and products, in the frame there is.
  subroutine set_exponents(self)
    class(normal_form_type), intent(inout) :: self
    integer :: n, m
    n = self%n_modes
    m = self%n_generators
    self%s = self%exponents
    if (self%steady) self%s = cmplx(0.0_wp, aimag(self%exponents), wp)
    if (self%framed) then
      self%s(:n) = cmplx(0.0_wp, self%frame, wp)
      self%s(m + 1:m + n) = conjg(self%s(:n))
    end if
    self%s_pair = self%s(self%pair(1, :)) + self%s(self%pair(2, :))
    self%s_triple = self%s(self%triple(1, :)) + self%s(self%triple(2, :)) &
                    + self%s(self%triple(3, :))
  end subroutine set_exponents

  !> |Y| of the generators for amplitudes of the modes; and the largest motion of first order.
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

  !> Candidates of this order, the largest influence first: what stands still in the frame with
  !! those before is taken. Without a frame all are, those within the tolerance as well.
  subroutine choose_products(self, form, order, sides, expected, choice)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: order
    complex(wp), intent(in) :: sides(:, :)
    real(wp), intent(in) :: expected(:)
    type(frame_choice_type), intent(inout) :: choice
    type(candidate_type), allocatable :: found(:)
    real(wp), allocatable :: does(:)
    real(wp) :: all_sizes(self%n_generators), reference
    logical, allocatable :: waits(:)
    integer :: i, powers(self%n_modes), n_loads
    real(wp) :: drive

    call sizes_of_generators(self, expected, all_sizes, reference)
    call list_candidates(self, form, order, sides, found)
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
        ! What shifts the mode's own exponent needs no place.
        found(i)%taken = all(powers == 0) .and. .not. abs(drive) > 0.0_wp
        waits(i) = .not. found(i)%taken .and. does(i) >= least_influence
      end do
      do while (any(waits))
        i = maxloc(does, 1, mask=waits)
        waits(i) = .false.
        call net_of(self, found(i), powers, drive, n_loads)
        call choice%take(found(i)%mode, powers, drive, n_loads > 0, found(i)%taken)
        found(i)%turned_away = .not. found(i)%taken
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
        other = place_of(self, f(1), f(2), f(3))
        self%acts_triple(c%mode, c%at) = .true.
        self%acts_triple(c%mode + self%n_generators, other) = .true.
      end if
    end subroutine mark

  end subroutine choose_products

  !> Products of this order within half of a mode's frequency of it, with what they do.
  subroutine list_candidates(self, form, order, sides, found)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: order
    complex(wp), intent(in) :: sides(:, :)
    type(candidate_type), allocatable, intent(out) :: found(:)
    type(candidate_type), allocatable :: some(:)
    complex(wp) :: s, part
    integer :: i, j, n

    allocate (some(self%n_modes*size(sides, 2)))
    n = 0
    do i = 1, size(sides, 2)
      if (.not. any(abs(sides(:, i)) > 0.0_wp)) cycle
      if (order == 2) then
        s = self%s_pair(i)
      else
        s = self%s_triple(i)
      end if
      do j = 1, self%n_modes
        if (abs(aimag(s - self%s(j))) > 0.5_wp*aimag(self%s(j))) cycle
        part = sum(self%left(:, j)*sides(:, i))
        if (.not. abs(part) > 1.0e-13_wp*sum(abs(self%left(:, j)*sides(:, i)))) cycle
        n = n + 1
        some(n)%order = order
        some(n)%at = i
        some(n)%mode = j
        if (order == 2) some(n)%factors(:2) = self%pair(:, i)
        if (order == 3) some(n)%factors = self%triple(:, i)
        some(n)%coupling = abs(part/weight(self, form, j, s))
        some(n)%divisor = abs(s - self%exponents(j))
      end do
    end do
    found = some(:n)
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
    if (abs(drive) <= 1.0e-12_wp*maxval(abs(self%exponents))) drive = 0.0_wp
  end subroutine net_of

  !> The largest influence of what had no place in the frame, at these amplitudes.
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

  !> Whether at these amplitudes more would be chosen.
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

  pure function used(n_dof, u) result(which)
    integer, intent(in) :: n_dof
    complex(wp), intent(in) :: u(:, :)
    integer, allocatable :: which(:)
    logical :: wanted(size(u, 2))
    integer :: i
    do i = 1, size(u, 2)
      wanted(i) = any(abs(u(:n_dof, i)) > 0.0_wp)
    end do
    which = pack([(i, i=1, size(u, 2))], wanted)
  end function used

  pure integer function conjugate_of(self, a)
    class(normal_form_type), intent(in) :: self
    integer, intent(in) :: a
    conjugate_of = modulo(a - 1 + self%n_generators, 2*self%n_generators) + 1
  end function conjugate_of

  !> Whether mode generator a resonates with the exponent s of factors the highest of
  !! whose frequencies is given.
  pure logical function near(self, s, highest, a)
    class(normal_form_type), intent(in) :: self
    complex(wp), intent(in) :: s
    real(wp), intent(in) :: highest
    integer, intent(in) :: a
    near = modulo(a - 1, self%n_generators) < self%n_modes
    if (.not. near) return
    associate (own => aimag(self%s(a)))
      ! Never so far that a mode and its conjugate were near at once.
      near = abs(aimag(s) - own) <= min(max(self%tolerance, 1.0e-10_wp)*max(highest, abs(own)), &
                                        0.5_wp*abs(own))
    end associate
  end function near

  !> The same of all modes and conjugates for a wave that turns at this frequency, whichever
  !! turn with it in the frame included.
  pure function near_modes(self, frequency, band) result(acts)
    class(normal_form_type), intent(in) :: self
    real(wp), intent(in) :: frequency
    !> Instead of the tolerance, in parts of the mode's own frequency.
    real(wp), intent(in), optional :: band
    logical :: acts(2*self%n_generators)
    integer :: a
    do a = 1, size(acts)
      acts(a) = self%near(cmplx(0.0_wp, frequency, wp), abs(frequency), a)
    end do
    if (present(band)) then
      acts(:self%n_modes) = abs(frequency - self%frame) <= band*self%frame
    end if
    acts(:self%n_modes) = acts(:self%n_modes) .or. &
                          abs(frequency - self%frame) <= 1.0e-7_wp*self%frame
  end function near_modes

  !> What load k at frequency p does to first order: its share of y and of the changes of
  !! the modes it resonates with.
  subroutine answer_load(self, form, k, p, u, g, status)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: k
    real(wp), intent(in) :: p
    complex(wp), intent(out) :: u(:), g(:)
    type(status_type), intent(out) :: status
    complex(wp) :: rates(2*self%n_generators), s
    logical :: singular, acts(2*self%n_generators)
    integer :: j

    call set_ok(status)
    s = cmplx(0.0_wp, p, wp)
    acts = .false.
    acts(:self%n_modes) = self%acts_load(:, k)
    call self%answer(form, s, cmplx(0.5_wp*form%load(:, k), 0.0_wp, wp), acts, u, rates, singular)
    if (singular) then
      call fail(status, status_input_error, 'load', 'load '//show(k)//': no response at ' &
                //'frequency '//show(p)//', where the system has no stiffness')
      return
    end if
    g = rates(:self%n_modes)
    do j = 1, self%n_modes
      if (.not. abs(drive_of(self, form, j, k)) > 0.0_wp) g(j) = (0.0_wp, 0.0_wp)
    end do
  end subroutine answer_load

  !> U_M and g_M from R_M: the bordered linear equations.
  subroutine answer(self, form, s, load, acts, u, rates, singular)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    complex(wp), intent(in) :: s, load(:)
    !> Modes and conjugates that resonate, shape (2 n_generators).
    logical, intent(in) :: acts(:)
    complex(wp), intent(out) :: u(:), rates(:)
    logical, intent(out) :: singular
    complex(wp) :: matrix(form%n + 2*max_modes, form%n + 2*max_modes)
    complex(wp) :: x(form%n + 2*max_modes), slope(form%n, form%n)
    integer :: modes(2*max_modes), n, m, a, i

    u = (0.0_wp, 0.0_wp)
    rates = (0.0_wp, 0.0_wp)
    singular = .false.
    if (.not. any(abs(load) > 0.0_wp)) return
    n = form%n
    m = 0
    do a = 1, 2*self%n_generators
      if (.not. acts(a)) cycle
      m = m + 1
      modes(m) = a
    end do
    matrix(:n, :n) = form%operator_at(s)
    x(:n) = load
    do i = 1, m
      slope = form%operator_between(s, self%exponents(modes(i)))
      matrix(:n, n + i) = matmul(slope, self%right(:, modes(i)))
      matrix(n + i, :n) = matmul(self%left(:, modes(i)), slope)
      matrix(n + 1:n + m, n + i) = (0.0_wp, 0.0_wp)
      x(n + i) = (0.0_wp, 0.0_wp)
    end do
    call solve_complex(matrix(:n + m, :n + m), x(:n + m), .false., singular)
    if (singular) return
    u = x(:n)
    do i = 1, m
      rates(modes(i)) = x(n + i)
    end do
  end subroutine answer

  !> All products of two and three generators, and where to find them.
  subroutine number_products(normal)
    type(normal_form_type), intent(inout) :: normal
    integer :: g, a, b, c, n

    g = 2*normal%n_generators
    allocate (normal%pair(2, g*(g + 1)/2), normal%pair_at(g, g))
    allocate (normal%triple(3, g*(g + 1)*(g + 2)/6), normal%triple_at(g, g, g))
    n = 0
    do b = 1, g
      do a = 1, b
        n = n + 1
        normal%pair(:, n) = [a, b]
        normal%pair_at(a, b) = n
        normal%pair_at(b, a) = n
      end do
    end do
    n = 0
    do c = 1, g
      do b = 1, c
        do a = 1, b
          n = n + 1
          normal%triple(:, n) = [a, b, c]
          normal%triple_at(a, b, c) = n
        end do
      end do
    end do
    allocate (normal%acts_pair(g, size(normal%pair, 2)), source=.false.)
    allocate (normal%acts_triple(g, size(normal%triple, 2)), source=.false.)
  end subroutine number_products

  !> R_M of products of two.
  subroutine second_sides(self, form, sides)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    complex(wp), allocatable, intent(out) :: sides(:, :)
    complex(wp) :: load(form%n)
    integer :: i, a, b, other, g

    g = 2*self%n_generators
    allocate (sides(form%n, size(self%pair, 2)), source=(0.0_wp, 0.0_wp))
    if (.not. allocated(self%x_one)) allocate (self%x_one(form%n_arguments, g))
    if (.not. allocated(self%n_pair)) then
      allocate (self%n_pair(form%n, merge(size(self%pair, 2), 0, form%has_memory())))
      self%n_pair = (0.0_wp, 0.0_wp)
    end if
    do a = 1, g
      self%x_one(:, a) = form%arguments_at(self%s(a), self%right(:, a))
    end do
    if (size(form%quadratic) == 0) return
    do i = 1, size(self%pair, 2)
      a = self%pair(1, i)
      b = self%pair(2, i)
      other = self%pair_at(self%conjugate_of(a), self%conjugate_of(b))
      if (other < i) then
        sides(:, i) = conjg(sides(:, other))
        if (form%has_memory()) self%n_pair(:, i) = conjg(self%n_pair(:, other))
        cycle
      end if
      load = -form%quadratic_at(self%x_one(:, a), self%x_one(:, b))
      if (a /= b) load = 2.0_wp*load
      if (form%has_memory()) then
        self%n_pair(:, i) = -load
        if (any(abs(load) > 0.0_wp)) load = load*form%retained(self%s_pair(i))
      end if
      sides(:, i) = load
    end do
  end subroutine second_sides

  subroutine second_order(self, form, sides, status)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    complex(wp), intent(in) :: sides(:, :)
    type(status_type), intent(out) :: status
    integer :: i, other, a, b, j, k, g
    logical :: singular, acts(2*self%n_generators)

    call set_ok(status)
    g = 2*self%n_generators
    if (.not. allocated(self%x_pair)) then
      allocate (self%x_pair(form%n_arguments, size(self%pair, 2)))
      allocate (self%u_pair(form%n, size(self%pair, 2)), self%g_pair(g, size(self%pair, 2)))
    end if
    self%u_pair = (0.0_wp, 0.0_wp)
    self%g_pair = (0.0_wp, 0.0_wp)
    self%x_pair = (0.0_wp, 0.0_wp)
    if (size(form%quadratic) == 0) return
    do i = 1, size(self%pair, 2)
      a = self%pair(1, i)
      b = self%pair(2, i)
      other = self%pair_at(self%conjugate_of(a), self%conjugate_of(b))
      if (other < i) then
        call copy_conjugate(self, self%u_pair, self%g_pair, other, i)
        self%x_pair(:, i) = conjg(self%x_pair(:, other))
        cycle
      end if
      acts = self%acts_pair(:, i) .or. near_product(self, self%s_pair(i), [a, b])
      call self%answer(form, self%s_pair(i), sides(:, i), acts, self%u_pair(:, i), &
                       self%g_pair(:, i), singular)
      ! Without a place in the frame no change can be kept.
      if (self%framed) where (.not. self%acts_pair(:, i)) self%g_pair(:, i) = 0.0_wp
      if (singular) then
        call no_stiffness(self%s_pair(i), status)
        return
      end if
      self%x_pair(:, i) = form%arguments_at(self%s_pair(i), self%u_pair(:, i))
      ! In a frame amplitudes stand still.
      if (self%framed) cycle
      do j = 1, g
        if (.not. abs(self%g_pair(j, i)) > 0.0_wp) cycle
        do k = 1, form%n_arguments
          associate (x => self%x_pair(k, i), r => self%right(form%source(k), j), &
                     rate => self%g_pair(j, i))
            if (form%derivative(k) == 1) x = x + rate*r
            if (form%derivative(k) == 2) x = x + rate*r*(self%s_pair(i) + self%s(j))
          end associate
        end do
      end do
    end do
  end subroutine second_order

  !> By the tolerance; in a frame only what the linear part alone could not answer.
  pure function near_product(self, s, factors) result(acts)
    class(normal_form_type), intent(in) :: self
    complex(wp), intent(in) :: s
    integer, intent(in) :: factors(:)
    logical :: acts(2*self%n_generators)
    integer :: a
    do a = 1, size(acts)
      if (self%framed) then
        acts(a) = modulo(a - 1, self%n_generators) < self%n_modes .and. &
                  abs(s - self%exponents(a)) <= singular_within*abs(self%exponents(a))
      else
        acts(a) = self%near(s, maxval(abs(aimag(self%s(factors)))), a)
      end if
    end do
  end function near_product

  !> R_M of products of three.
  subroutine third_sides(self, form, sides)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    complex(wp), allocatable, intent(out) :: sides(:, :)
    complex(wp) :: load(form%n)
    integer :: i, other, t(3), q
    logical :: slow

    allocate (sides(form%n, size(self%triple, 2)))
    slow = any(abs(self%g_pair) > 0.0_wp) .and. .not. self%framed
    do i = 1, size(self%triple, 2)
      t = self%triple(:, i)
      other = place_of(self, self%conjugate_of(t(1)), self%conjugate_of(t(2)), &
                       self%conjugate_of(t(3)))
      if (other < i) then
        sides(:, i) = conjg(sides(:, other))
        cycle
      end if
      load = (0.0_wp, 0.0_wp)
      if (size(form%cubic) > 0) then
        load = -arrangements(t)*form%cubic_at(self%x_one(:, t(1)), self%x_one(:, t(2)), &
                                              self%x_one(:, t(3)))
      end if
      if (size(form%quadratic) > 0) then
        do q = 1, 3
          if (repeated(t, q)) cycle
          associate (pair => self%pair_at(t(modulo(q, 3) + 1), t(modulo(q + 1, 3) + 1)))
            load = load - 2.0_wp*form%quadratic_at(self%x_one(:, t(q)), self%x_pair(:, pair))
          end associate
        end do
      end if
      if (form%has_memory()) then
        if (any(abs(load) > 0.0_wp)) load = load*form%retained(self%s_triple(i))
      end if
      if (slow) call slow_changes(self, form, i, load)
      sides(:, i) = load
    end do
  end subroutine third_sides

  subroutine third_order(self, form, sides, status)
    class(normal_form_type), intent(inout) :: self
    type(polynomial_form_type), intent(in) :: form
    complex(wp), intent(in) :: sides(:, :)
    type(status_type), intent(out) :: status
    integer :: i, other, t(3), m, g
    logical :: singular, acts(2*self%n_generators)

    call set_ok(status)
    g = 2*self%n_generators
    m = size(self%triple, 2)
    allocate (self%u_triple(form%n, m), self%g_triple(g, m))
    do i = 1, m
      t = self%triple(:, i)
      other = place_of(self, self%conjugate_of(t(1)), self%conjugate_of(t(2)), &
                       self%conjugate_of(t(3)))
      if (other < i) then
        call copy_conjugate(self, self%u_triple, self%g_triple, other, i)
        cycle
      end if
      acts = self%acts_triple(:, i) .or. near_product(self, self%s_triple(i), t)
      call self%answer(form, self%s_triple(i), sides(:, i), acts, self%u_triple(:, i), &
                       self%g_triple(:, i), singular)
      if (self%framed) where (.not. self%acts_triple(:, i)) self%g_triple(:, i) = 0.0_wp
      if (singular) then
        call no_stiffness(self%s_triple(i), status)
        return
      end if
    end do
  end subroutine third_order

  !> What changes of second order do: Y_p Y_q changes by g_p,Q Y_q Y_Q, so that product T = q Q
  !! gets L[s_T, s_pq] U_pq, with memory (1 - R)[s_T, s_pq] N_2,pq and, where Y_p Y_q is itself
  !! in the change of a mode j, L[s_T, s_pq, s_j] r_j g_j,pq.
  subroutine slow_changes(self, form, i, load)
    class(normal_form_type), intent(in) :: self
    type(polynomial_form_type), intent(in) :: form
    integer, intent(in) :: i
    complex(wp), intent(inout) :: load(:)
    complex(wp) :: rate
    integer :: t(3), q, p, rest, pair, j

    t = self%triple(:, i)
    do q = 1, 3
      if (repeated(t, q)) cycle
      rest = self%pair_at(t(modulo(q, 3) + 1), t(modulo(q + 1, 3) + 1))
      do p = 1, 2*self%n_generators
        rate = self%g_pair(p, rest)
        if (.not. abs(rate) > 0.0_wp) cycle
        if (p == t(q)) rate = 2.0_wp*rate
        pair = self%pair_at(p, t(q))
        load = load - rate*matmul(form%operator_between(self%s_triple(i), self%s_pair(pair)), &
                                  self%u_pair(:, pair))
        do j = 1, 2*self%n_generators
          if (.not. abs(self%g_pair(j, pair)) > 0.0_wp) cycle
          load = load - rate*self%g_pair(j, pair)*matmul( &
                 form%second_difference(self%s_triple(i), self%s_pair(pair), self%exponents(j)), &
                 self%right(:, j))
        end do
        if (form%has_memory()) then
          load = load - rate*self%n_pair(:, pair) &
                 *form%retained_between([self%s_triple(i), self%s_pair(pair)])
        end if
      end do
    end do
  end subroutine slow_changes

  subroutine no_stiffness(s, status)
    complex(wp), intent(in) :: s
    type(status_type), intent(out) :: status
    call fail(status, status_input_error, 'system', 'system: no stiffness at the combined ' &
              //'frequency '//show(aimag(s))//', which no resonance of a mode explains')
  end subroutine no_stiffness

  !> The t(q) that stood before is left out: each factor once.
  pure logical function repeated(t, q)
    integer, intent(in) :: t(3), q
    repeated = any(t(:q - 1) == t(q))
  end function repeated

  !> In how many orders the factors can be written.
  pure real(wp) function arrangements(t)
    integer, intent(in) :: t(3)
    arrangements = 6.0_wp
    if (t(1) == t(2) .or. t(2) == t(3)) arrangements = 3.0_wp
    if (t(1) == t(3)) arrangements = 1.0_wp
  end function arrangements

  pure integer function place_of(self, a, b, c)
    class(normal_form_type), intent(in) :: self
    integer, intent(in) :: a, b, c
    integer :: low, high
    low = min(a, b, c)
    high = max(a, b, c)
    place_of = self%triple_at(low, a + b + c - low - high, high)
  end function place_of

  subroutine copy_conjugate(self, u, rates, from, to)
    class(normal_form_type), intent(in) :: self
    complex(wp), intent(inout) :: u(:, :), rates(:, :)
    integer, intent(in) :: from, to
    u(:, to) = conjg(u(:, from))
    rates(:, to) = conjg(cshift(rates(:, from), self%n_generators))
  end subroutine copy_conjugate

end module viscovib_normal_form
