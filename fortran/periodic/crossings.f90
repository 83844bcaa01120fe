!> Where stability changes along a branch, and what is crossed there.
!!
!! Between two neighbours z_0, z_1 of the branch, z = (X, p), points are found on the planes
!! <z_1 - z_0, z - z_0> = sigma <z_1 - z_0, z_1 - z_0>, also where p turns back. An exponent
!! lambda that grows at one end only has its real part made 0 in sigma, by false position
!! (Illinois: Dowell and Jarratt, BIT 11 (1971) 168).
module viscovib_crossings
  use, intrinsic :: ieee_arithmetic, only: ieee_is_nan
  use viscovib_dense, only: factorize, solve
  use viscovib_hill_count, only: count_growing
  use viscovib_hill_roots, only: follow_exponent
  use viscovib_kinds, only: wp
  use viscovib_motion_stability, only: judge_type, new_judge, stability_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_oscillator_curve, only: oscillator_curve_type, vary_frequency
  implicit none
  private

  public :: crossing_type, known_folds, find_crossings, crossing_kind

  !> What is crossed: a multiplier 1 where p turns back, or where it does not; -1 of half a
  !! period; -1; a pair.
  integer, parameter, public :: crossing_fold = 1, crossing_branch_point = 2, &
                                crossing_symmetry = 3, crossing_doubling = 4, crossing_pair = 5
  character(len=*), parameter, public :: crossing_names(5) = &
    [character(len=17) :: 'fold', 'branch point', 'symmetry breaking', 'period doubling', &
     'Neimark-Sacker']

  integer, parameter :: max_corrections = 12, max_evaluations = 60, max_refinements = 3
  real(wp), parameter :: correction_tolerance = 1.0e-12_wp
  !> Wanted part of the distance between the two neighbours.
  real(wp), parameter :: narrow = 1.0e-11_wp
  !> Parts of d by which Im lambda may be off 0 or d/2.
  real(wp), parameter :: on_line = 1.0e-6_wp
  !> How far off the chord, and beyond its ends, a fold may lie that belongs to it, in its
  !! length: exponents may vanish a little later than p turns back, for they have errors.
  real(wp), parameter :: aside = 0.5_wp, beyond = 0.1_wp
  !> Where dp/dsigma is so small a part of what it is at the ends, p turns back.
  real(wp), parameter :: turning = 0.05_wp
  !> With memory the count is verified so far to both sides, in sigma.
  real(wp), parameter :: beside = 1.0e-4_wp

  type :: crossing_type
    !> One of those above, and the last point before it.
    integer :: kind = 0, before = 0
    !> Whether p and x are known.
    logical :: located = .false.
    real(wp) :: p = 0.0_wp
    !> Harmonics, shape (2 n_orders, n_dof).
    real(wp), allocatable :: x(:, :)
  end type crossing_type

  !> Folds that the continuation has located: p, and harmonics (2 n_orders, n_dof, n).
  type :: known_folds
    real(wp), allocatable :: p(:), x(:, :, :)
  end type known_folds

  !> Two neighbours z_0, z_1 and the point between them found last.
  type :: chord_type
    logical :: in_frequency = .true.
    !> The frequency where that does not vary (rad/s).
    real(wp) :: nu = 0.0_wp
    real(wp) :: ends(2) = 0.0_wp
    !> Shape (2 n_orders, n_dof, 2).
    real(wp), allocatable :: x_ends(:, :, :)
    !> Gradient of <z_1 - z_0, z>, and <z_1 - z_0, z_1 - z_0>.
    real(wp), allocatable :: normal_x(:, :)
    real(wp) :: normal_p = 0.0_wp, length = 0.0_wp
    !> p, dp/dsigma and X.
    real(wp) :: p = 0.0_wp, slope = 0.0_wp
    real(wp), allocatable :: x(:, :)
  contains
    procedure :: frequency
  end type chord_type

contains

  !> All changes of stability between neighbours whose stability is known.
  subroutine find_crossings(judge, curve, nu, p, x, stability, folds, crossings, cancel)
    type(judge_type), intent(inout) :: judge
    !> The branch is a part of it; left as it was found but for its frequency and system.
    class(oscillator_curve_type), intent(inout) :: curve
    !> The frequency where that does not vary (rad/s).
    real(wp), intent(in) :: nu
    !> Points of the branch, shapes (n) and (2 n_orders, n_dof, n), and their stability.
    real(wp), intent(in) :: p(:), x(:, :, :)
    type(stability_type), intent(in) :: stability
    type(known_folds), intent(in) :: folds
    type(crossing_type), allocatable, intent(out) :: crossings(:)
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile, optional :: cancel
    type(chord_type) :: chord
    type(crossing_type) :: crossing
    logical :: stays(judge%n_slots)
    real(wp) :: load_factor, d
    integer :: fewer, i, k, place, inner, outer

    allocate (crossings(0))
    load_factor = curve%balance%load_factor
    do i = 1, size(p) - 1
      if (present(cancel)) then
        if (cancel /= 0) exit
      end if
      associate (growing => stability%n_growing(i:i + 1))
        if (minval(growing) < 0 .or. growing(1) == growing(2)) cycle
        fewer = minval(growing)
        place = maxval(growing)
        outer = merge(i, i + 1, growing(1) > growing(2))
      end associate
      inner = 2*i + 1 - outer
      if (ieee_is_nan(real(stability%exponents(place, outer)))) cycle
      call new_chord(chord, curve%system, curve%vary == vary_frequency, nu, p(i:i + 1), &
                     x(:, :, i:i + 1))
      d = chord%frequency(outer - i)*merge(2, 1, curve%balance%set%half_wave)
      associate (exponents => stability%exponents(:, outer))
        call find_those_that_stay(stability%exponents(:fewer, inner), exponents(:place), d, &
                                  stays(:place))
        do k = place, 1, -1
          if (place <= fewer) exit
          if (stays(k)) cycle
          crossing%before = i
          crossing%located = .false.
          crossing%kind = crossing_kind(exponents(k), d, curve%balance%set%half_wave)
          if (crossing%kind == crossing_fold) call take_fold(chord, folds, crossing)
          if (.not. crossing%located) then
            call locate(chord, judge, curve, &
                        merge(stability%exponents(place, i:i + 1), exponents(k), &
                              .not. judge%remembers), &
                        stability%n_growing(i:i + 1), outer - i, place, crossing, cancel)
          end if
          crossings = [crossings, crossing]
          place = place - 1
          if (crossing%kind /= crossing_pair) cycle
          place = place - 1
          stays(:k) = stays(:k) .or. abs(exponents(:k) - conjg(exponents(k))) <= on_line*d
        end do
      end associate
    end do
    curve%balance%load_factor = load_factor
  end subroutine find_crossings

  !> Which of the exponents at one end go on growing at the other: there they are nearest to
  !! those that do.
  pure subroutine find_those_that_stay(there, here, d, stays)
    complex(wp), intent(in) :: there(:), here(:)
    !> Exponents matter modulo i d.
    real(wp), intent(in) :: d
    logical, intent(out) :: stays(:)
    real(wp) :: distance(size(here)), turns(size(here))
    integer :: j

    stays = .false.
    do j = 1, size(there)
      turns = (aimag(here) - aimag(there(j)))/d
      distance = hypot(real(here - there(j))/d, turns - anint(turns))
      stays(minloc(distance, 1,.not. stays)) = .true.
    end do
  end subroutine find_those_that_stay

  !> What an exponent is about to cross; a fold stands for a branch point too.
  pure integer function crossing_kind(exponent, d, half_wave) result(kind)
    complex(wp), intent(in) :: exponent
    !> Exponents matter modulo i d.
    real(wp), intent(in) :: d
    logical, intent(in) :: half_wave

    if (abs(aimag(exponent)) <= on_line*d) then
      kind = crossing_fold
    else if (abs(abs(aimag(exponent)) - 0.5_wp*d) <= on_line*d) then
      kind = merge(crossing_symmetry, crossing_doubling, half_wave)
    else
      kind = crossing_pair
    end if
  end function crossing_kind

  pure subroutine new_chord(chord, system, in_frequency, nu, p, x)
    type(chord_type), intent(out) :: chord
    class(oscillator_type), intent(in) :: system
    logical, intent(in) :: in_frequency
    real(wp), intent(in) :: nu, p(2), x(:, :, :)
    real(wp) :: total
    integer :: d

    chord%in_frequency = in_frequency
    chord%nu = nu
    chord%ends = p
    chord%x_ends = x
    chord%normal_x = x(:, :, 2) - x(:, :, 1)
    ! Squares are weighed by inertia, and against the size of the motion and of p.
    total = 0.0_wp
    do d = 1, size(x, 2)
      total = total + system%mass(d, d)*sum(x(:, d, :)**2)
    end do
    do d = 1, size(x, 2)
      if (total > 0.0_wp) chord%normal_x(:, d) = chord%normal_x(:, d)*(system%mass(d, d)/total)
    end do
    chord%normal_p = (p(2) - p(1))/maxval(abs(p))**2
    chord%length = sum(chord%normal_x*(x(:, :, 2) - x(:, :, 1))) + chord%normal_p*(p(2) - p(1))
    chord%p = p(1)
    chord%x = x(:, :, 1)
  end subroutine new_chord

  !> At an end, 0 or 1.
  pure real(wp) function frequency(self, at)
    class(chord_type), intent(in) :: self
    integer, intent(in) :: at
    frequency = merge(self%ends(at + 1), self%nu, self%in_frequency)
  end function frequency

  !> A fold that the continuation has found beside the chord.
  pure subroutine take_fold(chord, folds, crossing)
    type(chord_type), intent(in) :: chord
    type(known_folds), intent(in) :: folds
    type(crossing_type), intent(inout) :: crossing
    real(wp), dimension(size(chord%x, 1), size(chord%x, 2)) :: along, off
    real(wp) :: sigma
    integer :: k

    along = chord%x_ends(:, :, 2) - chord%x_ends(:, :, 1)
    do k = 1, size(folds%p)
      off = folds%x(:, :, k) - chord%x_ends(:, :, 1)
      sigma = (sum(chord%normal_x*off) + chord%normal_p*(folds%p(k) - chord%ends(1)))/chord%length
      off = off - sigma*along
      crossing%located = abs(sigma - 0.5_wp) <= 0.5_wp + beyond &
                         .and. norm2(off) < aside*norm2(along)
      if (.not. crossing%located) cycle
      crossing%p = folds%p(k)
      crossing%x = folds%x(:, :, k)
      return
    end do
  end subroutine take_fold

  !> The point of the branch on the plane sigma, by Newton's method.
  subroutine go_to(chord, curve, sigma, made)
    type(chord_type), intent(inout) :: chord
    class(oscillator_curve_type), intent(inout) :: curve
    real(wp), intent(in) :: sigma
    logical, intent(out) :: made
    real(wp) :: matrix(size(chord%x) + 1, size(chord%x) + 1), right(size(chord%x) + 1)
    real(wp) :: change(size(chord%x, 1), size(chord%x, 2)), r(size(chord%x)), by_p(size(chord%x))
    real(wp) :: size_x, last
    integer :: pivots(size(chord%x) + 1), n, k
    logical :: singular, inside

    n = size(chord%x)
    chord%x = chord%x_ends(:, :, 1) + sigma*(chord%x_ends(:, :, 2) - chord%x_ends(:, :, 1))
    chord%p = chord%ends(1) + sigma*(chord%ends(2) - chord%ends(1))
    made = .false.
    last = huge(last)
    do k = 1, max_corrections
      call curve%equations(reshape(chord%x, [n]), chord%p, r, matrix, by_p, inside)
      if (.not. inside) return
      matrix(:n, n + 1) = by_p
      matrix(n + 1, :n) = reshape(chord%normal_x, [n])
      matrix(n + 1, n + 1) = chord%normal_p
      right(:n) = r
      right(n + 1) = sum(chord%normal_x*(chord%x - chord%x_ends(:, :, 1))) &
                     + chord%normal_p*(chord%p - chord%ends(1)) - sigma*chord%length
      call factorize(n + 1, matrix, pivots, singular)
      if (singular) return
      call solve(n + 1, matrix, pivots, right)
      change = reshape(right(:n), shape(change))
      chord%x = chord%x - change
      chord%p = chord%p - right(n + 1)
      size_x = norm2(chord%x)
      if (.not. norm2(change) <= size_x) return
      ! To rounding, or as far as rounding lets it come.
      made = norm2(change) <= correction_tolerance*size_x .and. abs(right(n + 1)) &
             <= correction_tolerance*abs(chord%p)
      made = made .or. (norm2(change) <= 1.0e-8_wp*size_x .and. norm2(change) >= last)
      if (made) exit
      last = norm2(change)
    end do
    if (.not. made) return
    right = 0.0_wp
    right(n + 1) = chord%length
    call solve(n + 1, matrix, pivots, right)
    chord%slope = right(n + 1)
  end subroutine go_to

  !> Where the real part of an exponent vanishes.
  subroutine locate(chord, judge, curve, exponents, n_growing, outer, place, crossing, cancel)
    type(chord_type), intent(inout) :: chord
    type(judge_type), intent(inout) :: judge
    class(oscillator_curve_type), intent(inout) :: curve
    !> The exponents of this place, by size, at both ends; with memory the one at the end where
    !! it grows. How many grow at both, and the end where more do.
    complex(wp), intent(in) :: exponents(0:1)
    integer, intent(in) :: n_growing(0:1), outer, place
    type(crossing_type), intent(inout) :: crossing
    integer, intent(inout), volatile, optional :: cancel
    complex(wp) :: at(0:1), found
    real(wp) :: sigma(0:1), value(0:1), trial, last, slopes(0:1)
    integer :: i, k, side, before, n_beside(2)
    logical :: made

    sigma = [0.0_wp, 1.0_wp]
    at = exponents
    if (judge%remembers) then
      ! Exponents that decay may lack: this one is followed from where it grows.
      ! At once, or in small steps where it runs.
      do k = 0, max_refinements
        at(1 - outer) = at(outer)
        do i = 1, 4**k
          call evaluate(abs(outer - i/4.0_wp**k), at(1 - outer), made)
          if (.not. made) exit
        end do
        if (made .and. real(at(0))*real(at(1)) < 0.0_wp) exit
      end do
      if (.not. made) return
    end if
    value = real(at)
    if (.not. value(0)*value(1) < 0.0_wp) return
    last = huge(last)
    before = -1
    do k = 1, max_evaluations
      if (present(cancel)) then
        if (cancel /= 0) return
      end if
      trial = sigma(0) + (sigma(1) - sigma(0))*value(0)/(value(0) - value(1))
      found = at(0) + (at(1) - at(0))*((trial - sigma(0))/(sigma(1) - sigma(0)))
      call evaluate(trial, found, made)
      if (.not. made) return
      side = merge(0, 1, real(found)*value(0) > 0.0_wp)
      sigma(side) = trial
      at(side) = found
      value(side) = real(found)
      if (side == before) value(1 - side) = 0.5_wp*value(1 - side)
      before = side
      if (abs(trial - last) <= narrow .or. sigma(1) - sigma(0) <= narrow) exit
      if (.not. abs(real(found)) > 0.0_wp) exit
      last = trial
    end do
    if (k > max_evaluations) return
    crossing%p = chord%p
    crossing%x = chord%x
    if (.not. judge%remembers) then
      crossing%kind = crossing_kind(found, merge(chord%p, chord%nu, chord%in_frequency) &
                              *merge(2, 1, curve%balance%set%half_wave), &
                                    curve%balance%set%half_wave)
    end if
    if (crossing%kind == crossing_fold) then
      last = chord%slope
      do k = 0, 1
        call go_to(chord, curve, real(k, wp), made)
        if (.not. made) return
        slopes(k) = chord%slope
      end do
      if (slopes(0)*slopes(1) > 0.0_wp .and. abs(last) > turning*maxval(abs(slopes))) then
        crossing%kind = crossing_branch_point
      end if
    end if
    crossing%located = .true.
    if (.not. judge%remembers) return
    ! The count itself must change here.
    call count_at(max(0.0_wp, trial - beside), n_growing(0), n_beside(1))
    call count_at(min(1.0_wp, trial + beside), n_growing(1), n_beside(2))
    crossing%located = minval(n_beside) >= 0 .and. abs(n_beside(1) - n_beside(2)) &
                       == merge(2, 1, crossing%kind == crossing_pair)

  contains

    !> The exponent at sigma, near what it holds.
    subroutine evaluate(at_sigma, exponent, made)
      real(wp), intent(in) :: at_sigma
      complex(wp), intent(inout) :: exponent
      logical, intent(out) :: made
      type(stability_type) :: stability
      complex(wp) :: start
      real(wp) :: nu

      call go_to(chord, curve, at_sigma, made)
      if (.not. made) return
      nu = merge(chord%p, chord%nu, chord%in_frequency)
      if (curve%changes_system) call new_judge(judge, curve%system, curve%balance%set)
      if (judge%remembers) then
        call judge%hill%along(curve%system, nu, chord%x)
        start = exponent
        call follow_exponent(judge%hill, curve%system, start, exponent, made)
      else
        call judge%judge(curve%system, [nu], reshape(chord%x, [shape(chord%x), 1]), stability)
        exponent = stability%exponents(place, 1)
        made = .not. ieee_is_nan(real(exponent))
      end if
    end subroutine evaluate

    !> How many exponents grow at sigma, -1: unknown; at an end that is known.
    subroutine count_at(at_sigma, at_end, counted)
      real(wp), intent(in) :: at_sigma
      integer, intent(in) :: at_end
      integer, intent(out) :: counted
      complex(wp) :: none(0)
      integer :: evaluations
      logical :: found_there

      counted = at_end
      if (at_sigma <= 0.0_wp .or. at_sigma >= 1.0_wp) return
      counted = -1
      call go_to(chord, curve, at_sigma, found_there)
      if (.not. found_there) return
      if (curve%changes_system) call new_judge(judge, curve%system, curve%balance%set)
      call judge%hill%along(curve%system, merge(chord%p, chord%nu, chord%in_frequency), chord%x)
      call count_growing(judge%hill, curve%system, none, counted, evaluations)
    end subroutine count_at

  end subroutine locate

end module viscovib_crossings
