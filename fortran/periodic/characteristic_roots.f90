! Optimize: -O2 -fvect-cost-model=dynamic
!> Roots s of det D(s) = 0: decay and frequency of free motion with memory.
!!
!! Oscillatory roots of sums of exponentials are eigenvalues of one matrix, corrected by Newton's
!! method. With other kernels each root of the system without memory is followed while the memory
!! is increased from 0 to 1. The argument principle counts the roots: by the turns of det D along
!! the imaginary axis (Nyquist) and along a ray on the left. Newton's method then searches for
!! missing roots all over the region.
module viscovib_characteristic_roots
  use, intrinsic :: iso_c_binding, only: c_int
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite, ieee_quiet_nan, ieee_value
  use viscovib_characteristic_matrix, only: characteristic_matrix
  use viscovib_constants, only: pi
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_kinds, only: wp
  use viscovib_real_roots, only: find_real_roots
  use viscovib_sorting, only: order_of, sort_reals
  use viscovib_stopping, only: given_up
  implicit none
  private

  public :: roots_type, find_characteristic_roots

  type :: roots_type
    !> Roots with positive imaginary part (1/s), by increasing frequency; double roots twice.
    complex(wp), allocatable :: oscillatory(:)
    !> Real roots (1/s), largest first: roots to the right of the branch cut, or of 0 without a cut.
    real(wp), allocatable :: real(:)
    !> Roots with positive real part, conjugates included, by the argument principle.
    integer :: n_unstable = 0
    !> Oscillatory roots that the argument principle counts in addition to those listed.
    integer :: n_missing = 0
    !> False if rounding errors of det D hide its turns. Then the counts are those of listed roots.
    logical :: is_counted = .true.
    !> True if all roots in the region are listed.
    logical :: complete = .false.
    !> The region that was searched, in words.
    character(len=64) :: region = ''
  end type roots_type

  !> Steps of the memory. A step that moves a root by more than 8 % may lead to another root; it is
  !! divided by four.
  real(wp), parameter :: first_step = 1.0_wp/24.0_wp, least_step = 1.0e-7_wp, far = 0.08_wp
  integer, parameter :: most_steps = 2000
  !> Paths t + bend t (1 - t) of the memory. If two roots meet on the real path, the complex paths
  !! lead round that point.
  complex(wp), parameter :: bends(3) = [(0.0_wp, 0.0_wp), (0.0_wp, 0.4_wp), (0.0_wp, -0.4_wp)]
  complex(wp), parameter :: whole = (1.0_wp, 0.0_wp), none = (0.0_wp, 0.0_wp)
  !> Newton's method: number of steps, and largest relative last step: the error of a double root is
  !! the square root of the rounding error.
  integer, parameter :: newton_steps = 60
  real(wp), parameter :: last_step = 1.0e-6_wp, same = 1.0e-9_wp
  !> Real parts below this fraction of a root count as 0.
  real(wp), parameter :: on_axis = 2.0e-15_wp
  !> Largest damping ratio of roots that are counted to the left of the imaginary axis.
  real(wp), parameter :: most_damped = 0.999_wp
  character(len=*), parameter :: regions(3) = &
    [character(len=64) :: 'the whole plane', 'Re s > 0', &
     'Re s > 0, and Im s != 0 with a damping ratio below 0.999']
  !> Largest state matrix whose eigenvalues give all roots of sums of exponentials.
  integer, parameter :: most_states = 400
  !> Search for missing roots: points per decade, angles, decades outside the natural frequencies.
  integer, parameter :: a_decade = 4, n_angles = 7, outside = 2
  !> Points per decade of the count near the rates of the system, and elsewhere; largest change of
  !! the logarithm between two points, and largest number of halvings.
  integer, parameter :: near_points = 150, far_points = 60, most_halvings = 25
  real(wp), parameter :: largest_change = 0.6_wp

contains

  subroutine find_characteristic_roots(matrix, roots, cancel)
    type(characteristic_matrix), intent(in) :: matrix
    type(roots_type), intent(out) :: roots
    !> A value other than 0, possibly set by another thread, cancels the computation.
    integer(c_int), intent(inout), optional :: cancel
    complex(wp), allocatable :: free(:)
    integer :: i, n_found

    if (.not. matrix%remembers()) then
      call matrix%without_memory(free)
      roots%oscillatory = pack(free, aimag(free) > 1.0e-12_wp*abs(free))
      call order_roots(roots%oscillatory)
      roots%real = pack(real(free), .not. abs(aimag(free)) > 0.0_wp)
      roots%n_unstable = count(real(free) > 0.0_wp)
      roots%region = regions(1)
    else
      allocate (roots%oscillatory(0))
      call find_oscillatory(matrix, roots%oscillatory, cancel)
      call find_real_roots(matrix, roots%real, cancel)
      call count_roots(matrix, roots, cancel)
      if (roots%n_missing > 0) then
        call search(matrix, roots%oscillatory, roots%n_missing, cancel)
        call count_roots(matrix, roots, cancel)
      end if
      roots%region = merge(regions(2), regions(3), matrix%has_table)
      roots%real = [roots%real, (0.0_wp, i=1, 2*matrix%n_rigid)]
    end if
    call sort_reals(roots%real)
    roots%real = roots%real(size(roots%real):1:-1)
    n_found = 2*count(real(roots%oscillatory) > 0.0_wp) + count(roots%real > 0.0_wp)
    if (.not. roots%is_counted) roots%n_unstable = n_found
    roots%complete = roots%is_counted .and. n_found == roots%n_unstable .and. roots%n_missing == 0
    do i = 1, size(roots%oscillatory)
      if (.not. is_finite(roots%oscillatory(i))) roots%complete = .false.
    end do
  end subroutine find_characteristic_roots

  elemental logical function is_finite(s)
    complex(wp), intent(in) :: s
    is_finite = ieee_is_finite(real(s)) .and. ieee_is_finite(aimag(s))
  end function is_finite

  subroutine find_oscillatory(matrix, roots, cancel)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), allocatable, intent(inout) :: roots(:)
    integer(c_int), intent(inout), optional :: cancel
    real(wp), allocatable :: states(:, :)
    complex(wp), allocatable :: starts(:)
    logical :: is_sum, found
    integer :: i, n_terms

    call matrix%is_sum_of_exponentials(is_sum, n_terms)
    if (is_sum .and. (2 + n_terms)*matrix%n_dof() <= most_states) then
      call matrix%state_matrix(n_terms, states)
      allocate (starts(size(states, 1)))
      call eigenvalues(states, starts, found)
      do i = 1, size(starts)
        if (aimag(starts(i)) > 1.0e-9_wp*abs(starts(i))) call add_root(matrix, starts(i), roots)
      end do
    else
      call matrix%without_memory(starts)
      do i = 1, size(starts)
        if (.not. aimag(starts(i)) > 1.0e-12_wp*abs(starts(i))) cycle
        if (given_up(cancel)) exit
        call add_followed(matrix, starts(i), roots)
      end do
    end if
    call order_roots(roots)
  end subroutine find_oscillatory

  !> Add the root near a start, if Newton's method finds a new one.
  subroutine add_root(matrix, start, roots)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), intent(in) :: start
    complex(wp), allocatable, intent(inout) :: roots(:)
    complex(wp) :: s

    s = polished(matrix, start, whole, roots(:0))
    if (.not. is_finite(s)) return
    s = cmplx(real(s), abs(aimag(s)), wp)
    if (any(abs(s - roots) < same*abs(s))) then
      call add_twin(matrix, s, roots)
    else if (aimag(s) > 1.0e-9_wp*abs(s)) then
      if (is_root(matrix, s)) roots = [roots, s]
    end if
  end subroutine add_root

  !> Add the root that follows from a root of the system without memory.
  subroutine add_followed(matrix, start, roots)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), intent(in) :: start
    complex(wp), allocatable, intent(inout) :: roots(:)
    complex(wp) :: s
    integer :: k

    do k = 1, size(bends)
      s = with_memory(matrix, start, bends(k))
      if (.not. is_finite(s)) cycle
      s = cmplx(real(s), abs(aimag(s)), wp)
      if (any(abs(s - roots) < same*abs(s)) .or. .not. aimag(s) > 1.0e-9_wp*abs(s)) cycle
      if (.not. is_root(matrix, s)) cycle
      roots = [roots, s]
      return
    end do
    call add_twin(matrix, s, roots)
  end subroutine add_followed

  !> True if det D is small at s relative to its values nearby.
  !!
  !! Far to the left the transforms of kernels of finite duration are so large that all other terms
  !! are lost in rounding errors, of which Newton's method also finds zeros.
  logical function is_root(matrix, s)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), intent(in) :: s
    complex(wp) :: value(3)
    real(wp) :: h, nearby
    integer :: power(3)

    h = 1.0e-4_wp*abs(s)
    call matrix%determinants([s, s + h, s - h], whole, value, power)
    power = power - maxval(power)
    nearby = maxval(scale(abs(value(2:)), power(2:)))
    is_root = all(is_finite(value)) .and. scale(abs(value(1)), power(1)) <= 1.0e-3_wp*nearby
  end function is_root

  !> Add a second root near a known root, or the same root again if it is double.
  subroutine add_twin(matrix, s, roots)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), intent(in) :: s
    complex(wp), allocatable, intent(inout) :: roots(:)
    complex(wp) :: twin

    if (.not. is_finite(s)) return
    if (.not. any(abs(s - roots) < same*abs(s))) return
    twin = polished(matrix, s + 1.0e-3_wp*abs(s)*(1.0_wp, 1.0_wp), whole, roots)
    if (.not. is_finite(twin)) return
    if (abs(twin - s) < last_step*abs(s)) then
      roots = [roots, s]
    else if (abs(twin - s) < far*abs(s) .and. aimag(twin) > 1.0e-9_wp*abs(s)) then
      roots = [roots, twin]
    end if
  end subroutine add_twin

  !> Follow a root from `start` without memory to full memory.
  complex(wp) function with_memory(matrix, start, bend) result(s)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), intent(in) :: start, bend
    complex(wp) :: moved, nothing(0)
    real(wp) :: t, step, wanted
    integer :: k
    logical :: near

    s = polished(matrix, start, none, nothing)
    t = 0.0_wp
    step = first_step
    do k = 1, most_steps
      if (.not. (t < 1.0_wp .and. is_finite(s))) return
      wanted = min(t + step, 1.0_wp)
      moved = polished(matrix, s, wanted + bend*(wanted*(1.0_wp - wanted)), nothing)
      near = is_finite(moved)
      if (near) near = abs(moved - s) <= far*abs(s)
      if (step > least_step .and. .not. near) then
        step = 0.25_wp*step
        cycle
      end if
      s = moved
      t = wanted
      step = min(2.0_wp*step, first_step)
    end do
    s = not_a_number()
  end function with_memory

  !> Newton's method with the derivative by a difference of the analytic function; known roots are
  !! divided out. NaN if it does not converge or overflows.
  complex(wp) function polished(matrix, start, memory, known) result(s)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), intent(in) :: start, memory, known(:)
    complex(wp) :: points(3), value(3), step
    real(wp) :: h, moved, before
    integer :: power(3), i, k

    s = start
    before = huge(1.0_wp)
    do k = 1, newton_steps
      h = 1.0e-6_wp*abs(s)
      points = [s + h, s - h, s]
      call matrix%determinants(points, memory, value, power)
      power = power - maxval(power)
      value = cmplx(scale(real(value), power), scale(aimag(value), power), wp)
      do i = 1, 3
        value(i) = value(i)/product(points(i) - known)
      end do
      step = value(1) - value(2)
      if (.not. abs(step) > 0.0_wp) then
        ! A double root; if all values are 0, a huge term hides the other terms.
        if (abs(value(3)) > 0.0_wp .or. .not. abs(value(1)) > 0.0_wp) s = not_a_number()
        return
      end if
      step = value(3)*(2.0_wp*h/step)
      s = s - step
      if (.not. max(abs(real(s)), abs(aimag(s))) < 1.0e9_wp*matrix%fastest) then
        s = not_a_number()
        return
      end if
      moved = abs(step)
      if (moved <= 4.0e-16_wp*abs(s)) return
      ! Steps that do not become smaller are rounding errors.
      if (moved <= 1.0e-12_wp*abs(s) .and. moved >= 0.5_wp*before) return
      before = moved
    end do
    if (.not. moved <= last_step*abs(s)) s = not_a_number()
  end function polished

  pure complex(wp) function not_a_number()
    real(wp) :: nan
    nan = ieee_value(0.0_wp, ieee_quiet_nan)
    not_a_number = cmplx(nan, nan, wp)
  end function not_a_number

  !> Add roots that Newton's method finds from start points all over the region.
  subroutine search(matrix, roots, n_missing, cancel)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), allocatable, intent(inout) :: roots(:)
    integer, intent(in) :: n_missing
    integer(c_int), intent(inout), optional :: cancel
    real(wp), allocatable :: sizes(:)
    real(wp) :: low, high, angle, first, last
    integer :: i, j, k, n, wanted

    wanted = size(roots) + n_missing
    low = matrix%slowest/10.0_wp**outside
    high = matrix%fastest*10.0_wp**outside
    n = ceiling(a_decade*log10(high/low))
    allocate (sizes(0:n))
    sizes = [(low*(high/low)**(real(i, wp)/n), i=0, n)]
    first = 0.5_wp*pi
    last = pi - acos(most_damped)
    do i = 0, n
      ! Start near the natural frequencies.
      k = minloc(abs(log(sizes/sqrt(matrix%slowest*matrix%fastest))), 1) - 1
      do j = 0, n_angles - 1
        if (size(roots) >= wanted) exit
        if (given_up(cancel)) return
        angle = first + j*(last - first)/(n_angles - 1)
        call add_root(matrix, cmplx(sizes(k)*cos(angle), sizes(k)*sin(angle), wp), roots)
      end do
      sizes(k) = huge(1.0_wp)
    end do
    call order_roots(roots)
  end subroutine search

  !> Count roots to the right of the imaginary axis, and unlisted oscillatory roots to its left.
  !!
  !! Known pairs are divided out: with lightly damped close modes the argument of the determinant
  !! changes by more than pi between two frequencies, however close these are.
  subroutine count_roots(matrix, roots, cancel)
    type(characteristic_matrix), intent(in) :: matrix
    type(roots_type), intent(inout) :: roots
    integer(c_int), intent(inout), optional :: cancel
    complex(wp), parameter :: up = (0.0_wp, 1.0_wp)
    complex(wp) :: left
    real(wp) :: start, low, high, above, below, around, beside, end_angle
    integer :: n_others

    n_others = matrix%n_dof() - size(roots%oscillatory)
    start = 1.0e-14_wp*matrix%slowest
    low = 1.0e-9_wp*matrix%slowest
    high = 1.0e8_wp*matrix%fastest
    roots%n_missing = 0
    roots%is_counted = .true.
    ! Start with a quarter of a small circle: a kernel may be singular at 0.
    call find(arc(start, 0.0_wp, 0.5_wp*pi), around)
    call find(up*graded(matrix, start, low), below)
    call find(up*graded(matrix, low, high), above)
    if (.not. roots%is_counted) return
    roots%n_unstable = nint(n_others - (around + below + above)/pi) &
                       + 2*count(real(roots%oscillatory) > 0.0_wp)
    if (matrix%has_table) return
    ! At infinity det D is s^(2 n) det M; each known pair behaves as s^2. A real root may be 0
    ! within rounding error: the inner arc is well outside.
    end_angle = pi - acos(most_damped)
    left = exp(cmplx(0.0_wp, end_angle, wp))
    call find(left*graded(matrix, low, high), beside)
    call find(arc(low, 0.5_wp*pi, end_angle), around)
    if (.not. roots%is_counted) return
    roots%n_missing = nint((above + 2*n_others*(end_angle - 0.5_wp*pi) - beside - around) &
                           /(2.0_wp*pi))

  contains

    !> Change of the argument along a path.
    subroutine find(path, turn)
      complex(wp), intent(in) :: path(:)
      real(wp), intent(out) :: turn
      turn = 0.0_wp
      if (roots%is_counted) then
        call find_turn(matrix, path, roots%oscillatory, turn, roots%is_counted, cancel)
      end if
    end subroutine find

  end subroutine count_roots

  pure function arc(radius, from, to) result(s)
    real(wp), intent(in) :: radius, from, to
    complex(wp) :: s(64), ray
    integer :: i
    do i = 1, size(s)
      ray = exp(cmplx(0.0_wp, from + (to - from)*(i - 1)/(size(s) - 1), wp))
      s(i) = radius*ray
    end do
  end function arc

  !> Rates between `low` and `high`, most closely spaced near the rates of the system.
  pure function graded(matrix, low, high) result(x)
    type(characteristic_matrix), intent(in) :: matrix
    real(wp), intent(in) :: low, high
    real(wp), allocatable :: x(:)
    real(wp) :: ends(4)
    integer :: i, k, n

    ends = [low, min(max(1.0e-2_wp*matrix%slowest, low), high), &
            max(min(1.0e2_wp*matrix%fastest, high), low), high]
    x = [low]
    do k = 1, 3
      if (.not. ends(k + 1) > ends(k)) cycle
      n = ceiling(merge(near_points, far_points, k == 2)*log10(ends(k + 1)/ends(k)))
      x = [x, (ends(k)*(ends(k + 1)/ends(k))**(real(i, wp)/n), i=1, n)]
    end do
  end function graded

  !> Change of the argument of det D along a path, with known pairs divided out.
  !!
  !! Intervals with a large change, and adjacent ones, are halved: on both sides of a multiple
  !! pole the value may seem to be the same. A large change in the shortest intervals is a rounding
  !! error, as of strong dampers that hide the springs.
  subroutine find_turn(matrix, path, known, turn, is_certain, cancel)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), intent(in) :: path(:), known(:)
    real(wp), intent(out) :: turn
    !> Becomes false at a rounding error.
    logical, intent(inout) :: is_certain
    integer(c_int), intent(inout), optional :: cancel
    integer, parameter :: together = 64
    complex(wp) :: direction(size(path))
    real(wp) :: length(size(path))
    logical :: changes(0:size(path))
    integer :: first, i, last

    turn = 0.0_wp
    do first = 1, size(path), together
      if (given_up(cancel)) is_certain = .false.
      if (.not. is_certain) return
      last = min(first + together - 1, size(path))
      call find_directions(matrix, path(first:last), known, direction(first:last), &
                           length(first:last))
    end do
    changes = .false.
    do i = 1, size(path) - 1
      changes(i) = change(direction(i:i + 1), length(i:i + 1)) > largest_change
    end do
    do i = 1, size(path) - 1
      call add_turn(matrix, path(i:i + 1), direction(i:i + 1), length(i:i + 1), known, &
                    any(changes(i - 1:i + 1)), most_halvings, turn, is_certain)
      if (.not. is_certain) return
    end do
  end subroutine find_turn

  recursive subroutine add_turn(matrix, s, direction, length, known, halve, left, turn, is_certain)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), intent(in) :: s(2), direction(2), known(:)
    real(wp), intent(in) :: length(2)
    logical, intent(in) :: halve
    !> Remaining number of halvings.
    integer, intent(in) :: left
    real(wp), intent(inout) :: turn
    logical, intent(inout) :: is_certain
    complex(wp) :: middle(1), there(1)
    real(wp) :: size_there(1)

    if (.not. (halve .or. change(direction, length) > largest_change)) then
      turn = turn + angle(direction(2)*conjg(direction(1)))
      return
    end if
    is_certain = left > 0
    if (.not. is_certain) return
    middle = s(1)*sqrt(s(2)/s(1))
    call find_directions(matrix, middle, known, there, size_there)
    call add_turn(matrix, [s(1), middle], [direction(1), there], [length(1), size_there], known, &
                  .false., left - 1, turn, is_certain)
    if (.not. is_certain) return
    call add_turn(matrix, [middle, s(2)], [there, direction(2)], [size_there, length(2)], known, &
                  .false., left - 1, turn, is_certain)
  end subroutine add_turn

  pure real(wp) function angle(z)
    complex(wp), intent(in) :: z
    angle = atan2(aimag(z), real(z))
  end function angle

  !> Change of the logarithm of det D.
  pure real(wp) function change(direction, length)
    complex(wp), intent(in) :: direction(2)
    real(wp), intent(in) :: length(2)
    change = abs(angle(direction(2)*conjg(direction(1)))) + abs(length(2) - length(1))
  end function change

  !> Direction of det D and logarithm of its magnitude, with known pairs divided out.
  subroutine find_directions(matrix, s, known, direction, length)
    type(characteristic_matrix), intent(in) :: matrix
    complex(wp), intent(in) :: s(:), known(:)
    complex(wp), intent(out) :: direction(:)
    real(wp), intent(out) :: length(:)
    complex(wp) :: factor
    integer :: i, k, power(size(s))

    call matrix%determinants(s, whole, direction, power)
    length = log(max(abs(direction), tiny(1.0_wp))) + power*log(2.0_wp)
    do i = 1, size(s)
      direction(i) = unit(direction(i))
      do k = 1, size(known)
        factor = (s(i) - known(k))*(s(i) - conjg(known(k)))
        direction(i) = direction(i)*conjg(unit(factor))
        length(i) = length(i) - log(max(abs(factor), tiny(1.0_wp)))
      end do
    end do
  end subroutine find_directions

  elemental complex(wp) function unit(z)
    complex(wp), intent(in) :: z
    real(wp) :: length
    length = hypot(real(z), aimag(z))
    unit = (1.0_wp, 0.0_wp)
    if (.not. length <= 0.0_wp) unit = z/length
  end function unit

  !> Sort by frequency; roots near the imaginary axis are placed exactly on it.
  pure subroutine order_roots(roots)
    complex(wp), intent(inout) :: roots(:)
    where (abs(real(roots)) < on_axis*abs(roots)) roots = cmplx(0.0_wp, aimag(roots), wp)
    roots = roots(order_of(aimag(roots)))
  end subroutine order_roots

end module viscovib_characteristic_roots
